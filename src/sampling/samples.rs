//! Statistics of samples, pixel by pixel, that can be added up.

use std::collections::BTreeSet;

use super::SampleCounts;
use crate::error::{Error, RequestCause, Result};
use crate::frame::{Frame, RawSignal, Repairs, SamplesPerPixel, Signal, half_spread};
use crate::image::{Extent, Image};

/// Statistics of some samples per pixel: the number of samples, and for the colour and every feature the means of both
/// halves and the spread of all samples.
///
/// Both halves of a pixel hold the same number of samples; the number differs from pixel to pixel. Two sets merge into
/// the set that one pass over all their samples would give, so a set can be stored, read back and continued.
///
/// Adaptive sampling makes the number of samples depend on the samples of earlier passes. The merged mean is then no
/// longer exactly unbiased: a few samples that are dark by luck lead to few more samples. Each pass on its own is
/// unbiased.
#[derive(Clone, Debug)]
pub struct Samples {
    extent: Extent,
    /// Number of samples in each half, per pixel.
    pairs: Vec<u32>,
    color: Statistics,
    features: Vec<(String, Statistics)>,
}

/// Statistics of one layer. Where a pixel has no samples, all values are 0.
#[derive(Clone, Debug)]
struct Statistics {
    half_a: Image,
    half_b: Image,
    /// Sample variance of the mean, s²/n, as files store it: a set that was written and read back is equal to the bit.
    variance: Image,
}

/// Returns the divisor that turns Σ(x − mean)² into the variance of the mean; `pairs` is not 0.
fn divisor(pairs: u32) -> f64 {
    let n = 2.0 * f64::from(pairs);
    n * (n - 1.0)
}

impl Statistics {
    fn none(extent: Extent, channels: usize) -> Self {
        let zero = Image::filled(extent, channels, 0.0);
        Self { half_a: zero.clone(), half_b: zero.clone(), variance: zero }
    }

    fn channels(&self) -> usize {
        self.half_a.channels()
    }

    /// Adds the samples of another set by the formula of Chan, Golub and LeVeque for the moments of a union, which
    /// loses no digits to large means.
    fn merge(&mut self, own: &[u32], other: &Self, added: &[u32]) {
        for channel in 0..self.channels() {
            let (a, b) = (&mut self.half_a.planes[channel], &mut self.half_b.planes[channel]);
            let variance = &mut self.variance.planes[channel];
            for pixel in 0..own.len() {
                let (n, m) = (f64::from(own[pixel]), f64::from(added[pixel]));
                if m == 0.0 {
                    continue;
                }
                let share = m / (n + m);
                let own_squares = if own[pixel] == 0 { 0.0 } else { f64::from(variance[pixel]) * divisor(own[pixel]) };
                let added_squares = f64::from(other.variance.planes[channel][pixel]) * divisor(added[pixel]);
                let (a1, b1) = (f64::from(a[pixel]), f64::from(b[pixel]));
                let (a2, b2) =
                    (f64::from(other.half_a.planes[channel][pixel]), f64::from(other.half_b.planes[channel][pixel]));
                let step = (a2 - a1 + b2 - b1) / 2.0;
                a[pixel] = (a1 + (a2 - a1) * share) as f32;
                b[pixel] = (b1 + (b2 - b1) * share) as f32;
                // The factor is twice n·m/(n + m), because n and m count the samples of one half.
                let between = step * step * n * share * 2.0;
                variance[pixel] = ((own_squares + added_squares + between) / divisor(own[pixel] + added[pixel])) as f32;
            }
        }
    }

    /// Returns the signal as stored in files; NaN where a pixel has no samples.
    fn raw(&self, pairs: &[u32]) -> RawSignal {
        let unknown = |image: &Image| map(image, |value, pixel| if pairs[pixel] == 0 { f32::NAN } else { value });
        let mut mean = unknown(&self.half_a);
        for (mean, b) in mean.planes.iter_mut().zip(&self.half_b.planes) {
            mean.iter_mut().zip(b).for_each(|(mean, b)| *mean = ((f64::from(*mean) + f64::from(*b)) / 2.0) as f32);
        }
        let [half_a, half_b, variance] = [&self.half_a, &self.half_b, &self.variance].map(|image| Some(unknown(image)));
        RawSignal { mean, half_a, half_b, variance_of_mean: variance }
    }

    /// Inverts [`Self::raw`].
    fn from_raw(name: &str, raw: RawSignal, pairs: &[u32]) -> Result<Self> {
        let missing = |missing| Error::Request(RequestCause::MissingStatistics { signal: name.into(), missing });
        let half_a = raw.half_a.ok_or_else(|| missing("half A"))?;
        let half_b = raw.half_b.ok_or_else(|| missing("half B"))?;
        let variance = raw.variance_of_mean.ok_or_else(|| missing("variance"))?;
        for image in [&raw.mean, &half_a, &half_b, &variance] {
            let complete =
                image.extent.pixels() == pairs.len() && image.planes.iter().all(|plane| plane.len() == pairs.len());
            if !complete || image.channels() != raw.mean.channels() {
                return Err(Error::Request(RequestCause::LayerShape {
                    layer: name.into(),
                    channels: raw.mean.channels(),
                    values: pairs.len(),
                }));
            }
        }
        check_halves(name, &raw.mean, &half_a, &half_b)?;
        let known = |image: &Image| map(image, |value, pixel| if pairs[pixel] == 0 { 0.0 } else { value });
        // Some renderers' variances are negative by round-off.
        let variance =
            map(&variance, |variance, pixel| if pairs[pixel] == 0 || variance < 0.0 { 0.0 } else { variance });
        Ok(Self { half_a: known(&half_a), half_b: known(&half_b), variance })
    }
}

/// Checks that the mean is the average of its halves: nothing else is kept of the mean.
fn check_halves(name: &str, mean: &Image, half_a: &Image, half_b: &Image) -> Result<()> {
    let values = || {
        mean.planes
            .iter()
            .zip(half_a.planes.iter().zip(&half_b.planes))
            .flat_map(|(mean, (a, b))| mean.iter().zip(a.iter().zip(b)))
    };
    let differs = |(mean, (a, b)): &(&f32, (&f32, &f32))| {
        let average = (**a + **b) / 2.0;
        // Half floats round by 2^-11; denormals by more.
        (**mean - average).abs() > 0.01 * (mean.abs() + average.abs()) + 1e-4
    };
    let differing = values().filter(differs).count();
    if differing * 10 > values().count() {
        return Err(Error::Request(RequestCause::NotHalves { signal: name.into(), differing }));
    }
    Ok(())
}

fn map(image: &Image, value: impl Fn(f32, usize) -> f32) -> Image {
    let plane = |plane: &Vec<f32>| plane.iter().enumerate().map(|(pixel, &old)| value(old, pixel)).collect();
    Image { extent: image.extent, planes: image.planes.iter().map(plane).collect() }
}

impl Samples {
    /// Makes a set without samples: a colour of three channels and these features, each a name and 1 to 3 channels.
    pub fn none(extent: Extent, features: &[(&str, usize)]) -> Self {
        let features =
            features.iter().map(|(name, channels)| ((*name).to_owned(), Statistics::none(extent, *channels))).collect();
        Self { extent, pairs: vec![0; extent.pixels()], color: Statistics::none(extent, 3), features }
    }

    /// Makes a set from the statistics of a file or a renderer: means, halves and variances of the mean, and the
    /// numbers of samples that they were made of. Values of pixels without samples are ignored. Other values that are
    /// not finite are kept, and [`Frame::new`] repairs them.
    ///
    /// # Errors
    /// [`Error::Request`] for missing halves or variance, for images of different shapes, and for a mean that is not
    /// the average of its halves.
    pub fn from_signals(color: RawSignal, features: Vec<(String, RawSignal)>, counts: &SampleCounts) -> Result<Self> {
        let pairs = counts.pairs();
        let color = Statistics::from_raw("colour", color, pairs)?;
        let features = features
            .into_iter()
            .map(|(name, raw)| Ok((name.clone(), Statistics::from_raw(&format!("feature {name}"), raw, pairs)?)));
        Ok(Self { extent: counts.extent(), pairs: pairs.to_vec(), color, features: features.collect::<Result<_>>()? })
    }

    /// Returns width and height of the image.
    pub fn extent(&self) -> Extent {
        self.extent
    }

    /// Returns the numbers of samples drawn so far.
    pub fn counts(&self) -> SampleCounts {
        // A set always has one count for each pixel.
        SampleCounts::from_pairs(self.extent, self.pairs.clone())
            .unwrap_or_else(|_| unreachable!("one count for each pixel"))
    }

    /// Returns the names of the features, in their order.
    pub fn feature_names(&self) -> impl ExactSizeIterator<Item = &str> {
        self.features.iter().map(|(name, _)| name.as_str())
    }

    /// Returns mean, halves and variance of the mean of the colour; NaN in pixels without samples.
    ///
    /// The variance is s²/n with Bessel's correction, from all samples as if they were independent: low-discrepancy
    /// samples vary less than that.
    pub fn color(&self) -> RawSignal {
        self.color.raw(&self.pairs)
    }

    /// Returns the same statistics as [`Self::color`] for every feature, made one at a time.
    pub fn features(&self) -> impl ExactSizeIterator<Item = (&str, RawSignal)> {
        self.features.iter().map(|(name, statistics)| (name.as_str(), statistics.raw(&self.pairs)))
    }

    /// Returns the number of samples in each pixel.
    pub fn samples_per_pixel(&self) -> SamplesPerPixel {
        match self.pairs.first() {
            Some(&first) if self.pairs.iter().all(|&pairs| pairs == first) => {
                SamplesPerPixel::Uniform(2.0 * first as f32)
            }
            _ => SamplesPerPixel::PerPixel(Image {
                extent: self.extent,
                planes: vec![self.pairs.iter().map(|&pairs| 2.0 * pairs as f32).collect()],
            }),
        }
    }

    /// Returns the input of the denoiser and its repairs: pixels without samples become the average of their
    /// neighbours. The features are sorted by name, so that a set that was written and read back gives the same frame.
    ///
    /// # Errors
    /// As [`Frame::new`], and for a set without a single sample.
    pub fn to_frame(&self) -> Result<(Frame, Repairs)> {
        let mut features: Vec<_> = self.features().map(|(name, raw)| (name.to_owned(), signal(raw))).collect();
        features.sort_by(|(a, _), (b, _)| a.cmp(b));
        Frame::new(signal(self.color()), features, self.samples_per_pixel())
    }

    /// Adds the samples of another pass. The order of passes has no influence except for rounding; the features of
    /// `other` may be in another order.
    ///
    /// # Errors
    /// [`Error::Request`] for another extent or other features; this set is then unchanged.
    pub fn merge(&mut self, other: &Self) -> Result<()> {
        let shape = |set: &Self| {
            set.features.iter().map(|(name, statistics)| (name.clone(), statistics.channels())).collect::<BTreeSet<_>>()
        };
        if self.extent != other.extent || shape(self) != shape(other) || self.color.channels() != other.color.channels()
        {
            return Err(Error::Request(RequestCause::PassesDiffer { own: self.extent, other: other.extent }));
        }
        let overflowing = self.pairs.iter().zip(&other.pairs).any(|(own, added)| own.checked_add(*added).is_none());
        if overflowing {
            return Err(Error::Request(RequestCause::TooManySamples));
        }
        self.color.merge(&self.pairs, &other.color, &other.pairs);
        for (name, own) in &mut self.features {
            for (_, added) in other.features.iter().filter(|(other, _)| other == name) {
                own.merge(&self.pairs, added, &other.pairs);
            }
        }
        self.pairs.iter_mut().zip(&other.pairs).for_each(|(own, added)| *own += added);
        Ok(())
    }

    /// Sets one pixel, whose index is `y * width + x`, to the accumulated statistics. Channels run through the colour
    /// and then the features in their order.
    ///
    /// # Panics
    /// If the pixel lies outside of the image, or if the set has another number of channels.
    pub fn set<const CHANNELS: usize>(&mut self, pixel: usize, accumulated: &PixelAccumulator<CHANNELS>) {
        self.pairs[pixel] = accumulated.pairs;
        let statistics =
            std::iter::once(&mut self.color).chain(self.features.iter_mut().map(|(_, statistics)| statistics));
        let mut from = 0;
        for statistics in statistics {
            for channel in 0..statistics.channels() {
                let (a, b, squares) = accumulated.channel(from);
                statistics.half_a.planes[channel][pixel] = a as f32;
                statistics.half_b.planes[channel][pixel] = b as f32;
                statistics.variance.planes[channel][pixel] =
                    if accumulated.pairs == 0 { 0.0 } else { (squares / divisor(accumulated.pairs)) as f32 };
                from += 1;
            }
        }
        assert_eq!(from, CHANNELS, "the accumulator has other channels than the set");
    }
}

fn signal(raw: RawSignal) -> Signal {
    let half_spread = raw.half_a.as_ref().zip(raw.half_b.as_ref()).map(|(a, b)| half_spread(a, b, 1.0, 1.0));
    Signal { mean: raw.mean, half_spread, variance_of_mean: raw.variance_of_mean }
}

/// Running statistics of the samples of one pixel, in double precision: Welford's method for each half.
#[derive(Clone, Debug)]
pub struct PixelAccumulator<const CHANNELS: usize> {
    pairs: u32,
    means: [[f64; CHANNELS]; 2],
    squared_deviations: [[f64; CHANNELS]; 2],
}

impl<const CHANNELS: usize> Default for PixelAccumulator<CHANNELS> {
    fn default() -> Self {
        Self { pairs: 0, means: [[0.0; CHANNELS]; 2], squared_deviations: [[0.0; CHANNELS]; 2] }
    }
}

impl<const CHANNELS: usize> PixelAccumulator<CHANNELS> {
    /// Adds one sample to half A and one to half B.
    pub fn add_pair(&mut self, samples: [&[f32; CHANNELS]; 2]) {
        self.pairs += 1;
        let weight = 1.0 / f64::from(self.pairs);
        for (half, sample) in samples.into_iter().enumerate() {
            let (means, squares) = (&mut self.means[half], &mut self.squared_deviations[half]);
            for channel in 0..CHANNELS {
                let value = f64::from(sample[channel]);
                let before = value - means[channel];
                means[channel] += before * weight;
                squares[channel] += before * (value - means[channel]);
            }
        }
    }

    /// Returns the means of the halves, and the sum of squared deviations of all samples from their common mean.
    fn channel(&self, channel: usize) -> (f64, f64, f64) {
        let (a, b) = (self.means[0][channel], self.means[1][channel]);
        let within = self.squared_deviations[0][channel] + self.squared_deviations[1][channel];
        (a, b, within + (a - b).powi(2) * f64::from(self.pairs) / 2.0)
    }
}
