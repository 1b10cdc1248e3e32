//! A check of meaning: whether halves and variance of the colour are what a frame takes them for.

use std::fmt;

use rayon::prelude::*;
use serde::Serialize;

use super::image_noise::{Residuals, WINDOW_RADIUS, around};
use super::sources::{self, two_digits};
use super::{Frame, SamplesPerPixel};
use crate::error::{Error, Remedy, RequestCause, Result};
use crate::image::Image;

/// Distances in pixels over which residuals are taken. Noise that neighbours share makes residuals of near neighbours
/// too small, texture makes those of far ones too large; the largest estimate counts, because only too little noise in
/// the image says something.
const STEPS: [usize; 2] = [1, 3];
/// The same for the difference of the halves, which has no texture of its own if they differ by noise alone.
const STEPS_OF_HALVES: [usize; 3] = [1, 3, 6];
/// Factor from which on sources contradict each other. Under a Gaussian pixel filter with a standard deviation of half
/// a pixel, the variance of the samples is 3 to 4 times that of the mean.
const CONTRADICTION: f64 = 5.0;
/// Least number of values, over all pixels and channels, from which a median is taken: 8×8 pixels of three channels.
const LEAST_VALUES: usize = 192;
/// Most pixels of which a median is taken; of larger images every n-th row is looked at. Medians of fewer values stay
/// within a few hundredths, and the check takes little time beside the reading of a file.
const MOST_PIXELS: usize = 1 << 16;
/// Most pixels in the boxes in which halves are looked at; of larger images every n-th row of boxes is. Boxes are fewer
/// than pixels, and halves may differ in a part of the image alone.
const MOST_PIXELS_OF_BOXES: usize = 1 << 17;
/// Largest variance, as a share of the squared mean, that may be round-off or quantisation rather than noise.
const CLEAN: f64 = 1e-6;
/// Side of the boxes in which the structure of the halves is looked for, in pixels.
const BOX: usize = 16;
/// Least number of pixels with noise in such a box.
const LEAST_IN_BOX: usize = 64;
/// Least number of boxes, over all channels, from which a quantile is taken.
const LEAST_BOXES: usize = 12;
/// Share of the boxes that have less structure than [`NoiseCheck::structure_of_halves`].
const QUANTILE: f64 = 0.9;
/// Structure from which on halves differ by more than noise. Halves of renders stay below 1.2; with one of them exposed
/// 1.5 times as long, renders with 8 and more samples per pixel reach 1.8 to 200.
const STRUCTURE: f64 = 1.6;
/// Factor from which on messages give no number.
const MOST_SHOWN: f64 = 1e6;
/// Least share of the values with a variance of at least the squared mean in a second moment; round-off may cost a few.
const BEYOND_SQUARE: f64 = 0.995;

/// Ratios between the sources from which the noise of the colour is known: halves, variance, and an estimate from the
/// image itself. All are 1 if the sources agree.
///
/// Texture makes the estimate from the image too large, so that ratios to that estimate say nothing if they are small.
/// A ratio is `None` without its sources, or where too few values have noise.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct NoiseCheck {
    /// Median over pixels and channels of the variance divided by the estimate from the image, both averaged over 5×5
    /// pixels; above 0.
    pub variance_over_image: Option<f64>,
    /// Median over boxes of 16×16 pixels of the mean squared half spread divided by the mean variance; at least 0.
    pub halves_over_variance: Option<f64>,
    /// As `variance_over_image`, for the squared half spread in place of the variance.
    pub halves_over_image: Option<f64>,
    /// Mean squared half spread divided by the noise that is estimated from the half spread as an image, the 90th
    /// percentile over boxes of 16×16 pixels: 1 if halves differ by noise alone, larger if they differ in brightness or
    /// content.
    pub structure_of_halves: Option<f64>,
    /// Share of the values whose variance is at least their squared mean, 0 to 1: 1 for second moments.
    pub variance_beyond_square: Option<f64>,
    /// Median number of samples per pixel, where known.
    pub samples_per_pixel: Option<f64>,
}

/// A contradiction between the sources from which noise is known. Factors are between variances or squares, at least 1.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
#[non_exhaustive]
pub enum Contradiction {
    /// The variance is too large for the noise in the image.
    VarianceTooLarge {
        /// Factor by which the variance is too large: from the halves if there are any, else at least this much.
        factor: f64,
        /// Likely meaning of the variance.
        meaning: LargeVariance,
    },
    /// The variance is too small for the difference of the halves.
    VarianceTooSmall {
        /// Factor by which the variance is too small.
        factor: f64,
    },
    /// The halves differ by more than noise.
    HalvesTooDifferent {
        /// Factor by which their squared difference is too large, at least in a tenth of the image.
        factor: f64,
    },
    /// The halves differ by less than the variance tells.
    HalvesTooAlike {
        /// Factor by which their squared difference is too small.
        factor: f64,
    },
    /// The image has less noise than its halves tell, and than the variance tells if there is one.
    ImageTooSmooth {
        /// Factor by which the image has too little noise.
        factor: f64,
    },
}

/// Likely meaning of a variance that is too large.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
#[non_exhaustive]
pub enum LargeVariance {
    /// The variance of one sample in place of the mean's: the factor is near the number of samples, or that is unknown.
    OneSample {
        /// Samples per pixel, where known.
        samples: Option<f64>,
    },
    /// The mean of the squared samples: it is nowhere less than the squared mean.
    SecondMoment,
    /// Another quantity; the factor is far from the number of samples.
    Unknown {
        /// Samples per pixel.
        samples: f64,
    },
}

impl Frame {
    /// Compares the sources from which the noise of the colour is known.
    ///
    /// Of images with more than 65 536 pixels, estimates from the image take every n-th row; of those with
    /// more than 131 072 pixels, comparisons of the halves take every n-th row of boxes.
    pub fn check_of_noise(&self) -> NoiseCheck {
        let mean = &self.color.mean;
        let (spread, variance) = (self.color.half_spread.as_ref(), self.color.variance_of_mean.as_ref());
        let square = |value: f32| f64::from(value).powi(2);
        let every = self.extent.pixels().div_ceil(MOST_PIXELS_OF_BOXES).max(1);
        NoiseCheck {
            variance_over_image: variance.and_then(|variance| over_image(variance, f64::from, mean, mean)),
            halves_over_variance: spread
                .zip(variance)
                .and_then(|(spread, variance)| sources::halves_over_variance(mean, spread, variance, every)),
            halves_over_image: spread.and_then(|spread| over_image(spread, square, mean, mean)),
            structure_of_halves: spread.and_then(|spread| structure(spread, mean)),
            variance_beyond_square: variance.and_then(|variance| beyond_square(mean, variance)),
            samples_per_pixel: match &self.samples_per_pixel {
                SamplesPerPixel::Unknown => None,
                SamplesPerPixel::Uniform(count) => Some(f64::from(*count)),
                SamplesPerPixel::PerPixel(counts) => median(counts.planes[0].clone()),
            },
        }
    }
}

impl NoiseCheck {
    /// Returns the contradiction between the sources. `None` if they agree within a factor of five, or do not tell.
    ///
    /// Evenly spread samples, texture, spikes and usual pixel filters change the ratios of right sources by less than
    /// that. So the variance of one sample is not always found with fewer than eight samples per pixel. Halves of views
    /// or exposures that differ by less than the noise are not found either.
    ///
    /// A filter that spreads samples over several pixels makes the variance of the samples larger than that of the
    /// mean. From a Gaussian with a standard deviation of about 0.6 pixels on, that counts as a contradiction.
    pub fn contradiction(&self) -> Option<Contradiction> {
        let (of_variance, of_halves) = (self.variance_over_image, self.halves_over_image);
        let different = || self.structure_of_halves.filter(|structure| *structure >= STRUCTURE);
        let smooth = |factor: f64| (factor >= CONTRADICTION).then_some(Contradiction::ImageTooSmooth { factor });
        let Some(ratio) = self.halves_over_variance else {
            // One source, or two of which no box has enough pixels.
            let large = of_variance.filter(|factor| *factor >= CONTRADICTION && of_halves.is_none());
            return different()
                .map(|factor| Contradiction::HalvesTooDifferent { factor })
                .or_else(|| of_halves.and_then(smooth))
                .or_else(|| large.map(|factor| self.variance_too_large(factor)));
        };
        if ratio * CONTRADICTION <= 1.0 {
            let factor = 1.0 / ratio.max(f64::MIN_POSITIVE);
            // The image decides which of both is wrong.
            let halves_fit = of_halves.is_some_and(|ratio| ratio * CONTRADICTION >= 1.0);
            let variance_fits = of_variance.is_none_or(|ratio| ratio < CONTRADICTION);
            return Some(if variance_fits && !halves_fit {
                Contradiction::HalvesTooAlike { factor }
            } else {
                self.variance_too_large(factor)
            });
        }
        if let Some(structure) = different() {
            return Some(Contradiction::HalvesTooDifferent { factor: structure.max(ratio) });
        }
        if ratio >= CONTRADICTION {
            return Some(Contradiction::VarianceTooSmall { factor: ratio });
        }
        smooth(of_variance?.min(of_halves?))
    }

    /// Refuses sources that contradict each other, for callers to whom a remark is not enough.
    ///
    /// # Errors
    /// [`Error::Request`] with the contradiction and its remedies.
    pub fn require_agreement(&self) -> Result<()> {
        self.contradiction().map_or(Ok(()), |contradiction| Err(Error::Request(contradiction.into())))
    }

    /// Makes the contradiction; `factor` is from the halves if there are any.
    fn variance_too_large(&self, factor: f64) -> Contradiction {
        // Texture lowers a factor from the image, a wide pixel filter raises it.
        let tolerance = if self.halves_over_variance.is_some() { 2.0 } else { 4.0 };
        let is_near = |samples: f64| (samples / tolerance..=samples * tolerance).contains(&factor);
        let meaning = if self.variance_beyond_square.is_some_and(|share| share >= BEYOND_SQUARE) {
            LargeVariance::SecondMoment
        } else {
            match self.samples_per_pixel {
                Some(samples) if !is_near(samples) => LargeVariance::Unknown { samples },
                samples => LargeVariance::OneSample { samples },
            }
        };
        Contradiction::VarianceTooLarge { factor, meaning }
    }
}

impl Contradiction {
    /// Returns the factor between two sources, at least 1.
    pub fn factor(&self) -> f64 {
        match *self {
            Self::VarianceTooLarge { factor, .. }
            | Self::VarianceTooSmall { factor }
            | Self::HalvesTooDifferent { factor }
            | Self::HalvesTooAlike { factor }
            | Self::ImageTooSmooth { factor } => factor,
        }
    }

    /// Returns actions that help the user if the likely cause is the true one, the best action first.
    pub fn remedies(&self) -> Vec<Remedy> {
        match self {
            Self::VarianceTooLarge { meaning: LargeVariance::OneSample { .. }, .. } => {
                vec![Remedy::SayQuantity { quantity: "variance of one sample" }, Remedy::GiveSamples]
            }
            Self::VarianceTooLarge { meaning: LargeVariance::SecondMoment, .. } => {
                vec![Remedy::SayQuantity { quantity: "second moment" }]
            }
            Self::VarianceTooLarge { meaning: LargeVariance::Unknown { .. }, .. } => {
                vec![Remedy::GiveSamples, Remedy::GiveVariance, Remedy::GiveUnfiltered]
            }
            Self::VarianceTooSmall { .. } => vec![Remedy::GiveVariance, Remedy::GiveSamples],
            Self::HalvesTooDifferent { .. } | Self::HalvesTooAlike { .. } => vec![Remedy::RenderHalvesAgain],
            Self::ImageTooSmooth { .. } => vec![Remedy::GiveUnfiltered],
        }
    }
}

impl From<Contradiction> for RequestCause {
    fn from(contradiction: Contradiction) -> Self {
        Self::Contradiction(contradiction)
    }
}

impl fmt::Display for Contradiction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let factor = if self.factor() < MOST_SHOWN { two_digits(self.factor()) } else { "more than a million".into() };
        match self {
            Self::VarianceTooLarge { meaning, .. } => {
                write!(f, "the variance is {factor} times too large for the noise in the image{meaning}")
            }
            Self::VarianceTooSmall { .. } => write!(
                f,
                "the variance is {factor} times too small for the difference of the halves: is it divided by the \
                 number of samples twice, or relative to the brightness?"
            ),
            Self::HalvesTooDifferent { .. } => write!(
                f,
                "the halves differ by more than noise, in places {factor} times (squared): are they two unfiltered \
                 renders of the same frame, with the same view and exposure?"
            ),
            Self::HalvesTooAlike { .. } => write!(
                f,
                "the squared difference of the halves is {factor} times too small for the variance: are they copies, \
                 renders with the same seed, or is the variance too large?"
            ),
            Self::ImageTooSmooth { .. } => {
                write!(f, "the image has {factor} times less noise than its halves tell: is it filtered already?")
            }
        }
    }
}

/// Displays as the end of a sentence.
impl fmt::Display for LargeVariance {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::OneSample { samples: None } => f.write_str(
                ": is it the variance of one sample, not of the pixel's mean? Or is the image filtered already?",
            ),
            Self::OneSample { samples: Some(samples) } => write!(
                f,
                ": is it the variance of one sample, not of the pixel's mean, which is the average of {} samples? Or \
                 is the image filtered already?",
                count(*samples)
            ),
            Self::SecondMoment => f.write_str(
                ", and nowhere less than the squared mean: is it the mean of the squared samples, from which the \
                 squared mean is not subtracted?",
            ),
            Self::Unknown { samples } => write!(
                f,
                ", a factor far from the {} samples per pixel: is it another quantity than the variance of the mean, \
                 is the image filtered already, or does the variance of the samples overstate the noise, as with \
                 evenly spread samples under a wide pixel filter?",
                count(*samples)
            ),
        }
    }
}

/// Formats a number of samples without needless digits.
fn count(samples: f64) -> String {
    if samples.fract() == 0.0 { format!("{samples}") } else { format!("{samples:.1}") }
}

/// Returns the median over pixels and channels of a declared variance divided by the variance that is estimated from
/// `image`, both averaged over the same windows: the least of the medians over [`STEPS`].
///
/// `declared` becomes a variance by `to_variance`. Pixels are left out that have no variance beyond round-off of the
/// mean, or whose estimate is 0. `None` if too few pixels remain.
fn over_image(declared: &Image, to_variance: fn(f32) -> f64, mean: &Image, image: &Image) -> Option<f64> {
    let extent = mean.extent;
    let (width, height) = (extent.width as usize, extent.height as usize);
    let every = extent.pixels().div_ceil(MOST_PIXELS).max(1);
    let ratios_over = |step: usize| -> Vec<f32> {
        let ratios_of_row = |channel: usize, y: usize| {
            let [declared, mean] = [declared, mean].map(|image| &image.planes[channel]);
            let estimates = Residuals::new(&image.planes[channel], extent, step).variances_of_row(y);
            let mut columns = vec![0.0; width];
            let rows = around(y, WINDOW_RADIUS, height);
            for row in rows.clone() {
                let values = &declared[row * width..(row + 1) * width];
                columns.iter_mut().zip(values).for_each(|(sum, value)| *sum += to_variance(*value));
            }
            let ratio = move |x: usize| {
                let near = around(x, WINDOW_RADIUS, width);
                let average = columns[near.clone()].iter().sum::<f64>() / (near.len() * rows.len()) as f64;
                let pixel = y * width + x;
                let is_noisy = declared[pixel] != 0.0 && average > CLEAN * f64::from(mean[pixel]).powi(2);
                (is_noisy && estimates[x] > 0.0).then(|| (average / f64::from(estimates[x])) as f32)
            };
            (0..width).filter_map(ratio).collect::<Vec<_>>()
        };
        (0..mean.channels())
            .flat_map(|channel| (0..height).step_by(every).map(move |y| (channel, y)))
            .collect::<Vec<_>>()
            .into_par_iter()
            .flat_map_iter(|(channel, y)| ratios_of_row(channel, y))
            .collect()
    };
    // Most pixels must have both neighbours.
    let steps = STEPS.into_iter().filter(|step| width.min(height) > 2 * step);
    let ratios = steps.map(ratios_over).filter(|ratios| ratios.len() >= LEAST_VALUES);
    ratios.filter_map(median).reduce(f64::min)
}

/// Returns [`NoiseCheck::structure_of_halves`]. `None` if too few boxes have noise.
fn structure(spread: &Image, mean: &Image) -> Option<f64> {
    let extent = spread.extent;
    let (width, height) = (extent.width as usize, extent.height as usize);
    let every = extent.pixels().div_ceil(MOST_PIXELS_OF_BOXES).max(1);
    let steps: Vec<usize> = STEPS_OF_HALVES.into_iter().filter(|step| width.min(height) > 2 * step).collect();
    if steps.is_empty() {
        return None;
    }
    let ratios_of_boxes = |channel: usize, top: usize| {
        let [spread, mean] = [spread, mean].map(|image| &image.planes[channel]);
        let mut boxes = vec![StructureBox::default(); width.div_ceil(BOX)];
        for y in top..(top + BOX).min(height) {
            let row = y * width..(y + 1) * width;
            for (x, (spread, mean)) in spread[row.clone()].iter().zip(&mean[row]).enumerate() {
                boxes[x / BOX].add(f64::from(*spread).powi(2), f64::from(*mean).powi(2));
            }
            for (index, step) in steps.iter().enumerate() {
                let squares = Residuals::new(spread, extent, *step).squares_of_row(y);
                squares.iter().enumerate().for_each(|(x, square)| boxes[x / BOX].noise[index] += square);
            }
        }
        boxes.iter().filter_map(StructureBox::ratio).map(|ratio| ratio as f32).collect::<Vec<_>>()
    };
    let ratios: Vec<f32> = (0..spread.channels())
        .flat_map(|channel| (0..height).step_by(BOX * every).map(move |top| (channel, top)))
        .collect::<Vec<_>>()
        .into_par_iter()
        .flat_map_iter(|(channel, top)| ratios_of_boxes(channel, top))
        .collect();
    if ratios.len() < LEAST_BOXES { None } else { quantile(ratios, QUANTILE) }
}

/// Sums over the pixels of a box.
#[derive(Clone, Default)]
struct StructureBox {
    noisy: usize,
    squares: f64,
    squared_mean: f64,
    /// Σ of the noise estimated over each of [`STEPS_OF_HALVES`]; 0 for a step that is too long for the image.
    noise: [f64; STEPS_OF_HALVES.len()],
}

impl StructureBox {
    fn add(&mut self, square: f64, squared_mean: f64) {
        self.noisy += usize::from(square > 0.0);
        self.squares += square;
        self.squared_mean += squared_mean;
    }

    /// Returns the squares divided by the largest estimate of their noise. `None` without enough noise.
    fn ratio(&self) -> Option<f64> {
        let noise = self.noise.iter().copied().fold(0.0, f64::max);
        let has_noise = self.noisy >= LEAST_IN_BOX && self.squares > CLEAN * self.squared_mean && noise > 0.0;
        has_noise.then(|| self.squares / noise)
    }
}

/// Returns the share of the values with noise whose variance is at least their squared mean, within round-off. `None`
/// if too few values have noise.
fn beyond_square(mean: &Image, variance: &Image) -> Option<f64> {
    let (mut noisy, mut beyond) = (0usize, 0usize);
    let (width, every) = (mean.extent.width as usize, mean.extent.pixels().div_ceil(MOST_PIXELS).max(1));
    for (mean, variance) in mean.planes.iter().zip(&variance.planes) {
        let rows = mean.chunks(width).zip(variance.chunks(width)).step_by(every);
        for (mean, variance) in rows.flat_map(|(mean, variance)| mean.iter().zip(variance)) {
            let (square, variance) = (f64::from(*mean).powi(2), f64::from(*variance));
            if variance > CLEAN * square {
                noisy += 1;
                beyond += usize::from(variance >= square * 0.998);
            }
        }
    }
    (noisy >= LEAST_VALUES).then(|| beyond as f64 / noisy as f64)
}

fn median(values: Vec<f32>) -> Option<f64> {
    quantile(values, 0.5)
}

fn quantile(mut values: Vec<f32>, share: f64) -> Option<f64> {
    let index = (values.len() as f64 * share) as usize;
    (!values.is_empty()).then(|| (*values.select_nth_unstable_by(index, f32::total_cmp).1).into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::{NoiseKnowledge, Signal, half_spread};
    use crate::image::Extent;

    const EXTENT: Extent = Extent { width: 64, height: 48 };
    const SAMPLES: usize = 32;

    /// Statistics of samples with an exponential distribution, whose expectation rises from left to right.
    struct Render {
        mean: Image,
        half_a: Image,
        half_b: Image,
        variance_of_mean: Image,
        second_moment: Image,
    }

    /// Renders with the first `in_a` of [`SAMPLES`] in half A.
    fn render(extent: Extent, in_a: usize) -> Render {
        let mut state = 0x9e37_79b9_7f4a_7c15u64;
        let mut uniform = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            ((state >> 40) as f64 + 0.5) / (1u64 << 24) as f64
        };
        let image = Image::filled(extent, 3, 0.0);
        let [mut half_a, mut half_b, mut mean, mut variance_of_mean, mut second_moment] =
            [(); 5].map(|()| image.clone());
        for channel in 0..3 {
            for pixel in 0..extent.pixels() {
                let expectation = 1.0 + (pixel % extent.width as usize) as f64 / 32.0;
                let samples: Vec<f64> = (0..SAMPLES).map(|_| -expectation * uniform().ln()).collect();
                let average = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
                let (a, b) = samples.split_at(in_a);
                let all = average(&samples);
                let squares = samples.iter().map(|sample| (sample - all).powi(2)).sum::<f64>();
                half_a.planes[channel][pixel] = average(a) as f32;
                half_b.planes[channel][pixel] = average(b) as f32;
                mean.planes[channel][pixel] = all as f32;
                variance_of_mean.planes[channel][pixel] = (squares / ((SAMPLES - 1) * SAMPLES) as f64) as f32;
                second_moment.planes[channel][pixel] = (squares / SAMPLES as f64 + all * all) as f32;
            }
        }
        Render { mean, half_a, half_b, variance_of_mean, second_moment }
    }

    impl Render {
        fn spread(&self) -> Image {
            half_spread(&self.half_a, &self.half_b, 1.0, 1.0)
        }
    }

    fn mapped(image: &Image, map: impl Fn(usize, f32) -> f32) -> Image {
        let plane = |plane: &Vec<f32>| plane.iter().enumerate().map(|(pixel, value)| map(pixel, *value)).collect();
        Image { extent: image.extent, planes: image.planes.iter().map(plane).collect() }
    }

    fn frame(mean: &Image, half_spread: Option<Image>, variance_of_mean: Option<Image>) -> Frame {
        let color = Signal { mean: mean.clone(), half_spread, variance_of_mean };
        let samples = SamplesPerPixel::Uniform(SAMPLES as f32);
        Frame::new(color, vec![], samples).unwrap_or_else(|error| panic!("{error}")).0
    }

    fn contradiction(mean: &Image, half_spread: Option<Image>, variance: Option<Image>) -> Option<Contradiction> {
        frame(mean, half_spread, variance).check_of_noise().contradiction()
    }

    fn near(ratio: Option<f64>, expected: f64) -> bool {
        ratio.is_some_and(|ratio| (0.8..1.25).contains(&(ratio / expected)))
    }

    #[test]
    fn right_sources_agree() {
        let render = render(EXTENT, SAMPLES / 2);
        let both = frame(&render.mean, Some(render.spread()), Some(render.variance_of_mean.clone()));
        let check = both.check_of_noise();
        assert!(near(check.variance_over_image, 1.0) && near(check.halves_over_image, 1.0), "{check:?}");
        assert!(near(check.halves_over_variance, 1.0) && near(check.structure_of_halves, 1.0), "{check:?}");
        assert_eq!((check.variance_beyond_square, check.samples_per_pixel), (Some(0.0), Some(32.0)));
        for knowledge in [
            NoiseKnowledge::HalvesAndVariance,
            NoiseKnowledge::HalvesOnly,
            NoiseKnowledge::VarianceOnly,
            NoiseKnowledge::ImageOnly,
        ] {
            let reduced = both.with_noise_known_from(knowledge).map(|frame| frame.check_of_noise().contradiction());
            assert_eq!(reduced, Some(None), "{knowledge}");
        }
    }

    #[test]
    fn the_variance_of_one_sample_is_found() {
        let render = render(EXTENT, SAMPLES / 2);
        let variance = mapped(&render.variance_of_mean, |_, value| value * SAMPLES as f32);
        for spread in [None, Some(render.spread())] {
            let found = contradiction(&render.mean, spread, Some(variance.clone()));
            let Some(Contradiction::VarianceTooLarge { factor, meaning }) = found else { panic!("{found:?}") };
            assert!((25.0..40.0).contains(&factor), "{factor}");
            assert_eq!(meaning, LargeVariance::OneSample { samples: Some(32.0) });
        }
        let unknown = NoiseCheck { variance_over_image: Some(13.0), ..NoiseCheck::default() };
        assert_eq!(
            unknown.contradiction().map(|found| found.to_string()).as_deref(),
            Some(
                "the variance is 13 times too large for the noise in the image: is it the variance of one sample, not \
                 of the pixel's mean? Or is the image filtered already?"
            )
        );
    }

    #[test]
    fn second_moments_are_found() {
        let render = render(EXTENT, SAMPLES / 2);
        for spread in [None, Some(render.spread())] {
            let found = contradiction(&render.mean, spread, Some(render.second_moment.clone()));
            assert!(
                matches!(
                    found,
                    Some(Contradiction::VarianceTooLarge { factor, meaning: LargeVariance::SecondMoment })
                        if (45.0..90.0).contains(&factor)
                ),
                "{found:?}"
            );
        }
    }

    #[test]
    fn a_factor_far_from_the_number_of_samples_is_told() {
        let render = render(EXTENT, SAMPLES / 2);
        let variance = mapped(&render.variance_of_mean, |_, value| value * 7.0);
        for spread in [None, Some(render.spread())] {
            let found = contradiction(&render.mean, spread, Some(variance.clone()));
            let Some(Contradiction::VarianceTooLarge { factor, meaning }) = found else { panic!("{found:?}") };
            assert!((5.5..8.5).contains(&factor), "{factor}");
            assert_eq!(meaning, LargeVariance::Unknown { samples: 32.0 });
        }
    }

    #[test]
    fn a_variance_that_is_too_small_is_found_with_halves_only() {
        let render = render(EXTENT, SAMPLES / 2);
        let variance = mapped(&render.variance_of_mean, |_, value| value / SAMPLES as f32);
        let found = contradiction(&render.mean, Some(render.spread()), Some(variance.clone()));
        assert!(
            matches!(found, Some(Contradiction::VarianceTooSmall { factor }) if (25.0..40.0).contains(&factor)),
            "{found:?}"
        );
        assert_eq!(contradiction(&render.mean, None, Some(variance)), None);
    }

    #[test]
    fn unequal_halves_agree_if_their_samples_are_counted() {
        let render = render(EXTENT, 8);
        let spread = half_spread(&render.half_a, &render.half_b, 8.0, 24.0);
        let check = frame(&render.mean, Some(spread), Some(render.variance_of_mean.clone())).check_of_noise();
        assert!(near(check.halves_over_variance, 1.0), "{check:?}");
        assert_eq!(check.contradiction(), None);
        // Taken as equal, (1/8 + 1/24)/4 in place of 1/32.
        let check = frame(&render.mean, Some(render.spread()), Some(render.variance_of_mean)).check_of_noise();
        assert!(near(check.halves_over_variance, 4.0 / 3.0), "{check:?}");
        assert_eq!(check.contradiction(), None);
    }

    #[test]
    fn halves_of_another_exposure_or_view_are_found() {
        let render = render(EXTENT, SAMPLES / 2);
        let width = EXTENT.width as usize;
        let brighter = mapped(&render.half_b, |_, value| 1.5 * value);
        let mirrored = Image {
            extent: EXTENT,
            planes: render
                .half_b
                .planes
                .iter()
                .map(|plane| plane.chunks(width).flat_map(|row| row.iter().rev().copied()).collect())
                .collect(),
        };
        for half_b in [brighter, mirrored] {
            let other = Render { half_b, ..self::render(EXTENT, SAMPLES / 2) };
            for variance in [None, Some(render.variance_of_mean.clone())] {
                let found = contradiction(&render.mean, Some(other.spread()), variance);
                assert!(matches!(found, Some(Contradiction::HalvesTooDifferent { .. })), "{found:?}");
            }
        }
    }

    #[test]
    fn copies_are_found() {
        let render = render(EXTENT, SAMPLES / 2);
        let copy = mapped(&render.half_a, |pixel, value| value * (1.0 + 1e-4 * (pixel % 7) as f32));
        let copied = half_spread(&render.half_a, &copy, 1.0, 1.0);
        let found = contradiction(&render.half_a, Some(copied), Some(render.variance_of_mean.clone()));
        assert!(matches!(found, Some(Contradiction::HalvesTooAlike { factor }) if factor > 1000.0), "{found:?}");
        // A frame leaves out halves that are equal to the bit.
        let equal = frame(&render.mean, Some(Image::filled(EXTENT, 3, 0.0)), Some(render.variance_of_mean));
        assert_eq!(equal.noise_knowledge(), NoiseKnowledge::VarianceOnly);
        assert_eq!(equal.check_of_noise().contradiction(), None);
    }

    #[test]
    fn a_filtered_image_is_found() {
        let render = render(EXTENT, SAMPLES / 2);
        let filtered = mapped(&Image::filled(EXTENT, 3, 0.0), |pixel, _| {
            let noise = (pixel * 7919 % 101) as f32 / 101.0 - 0.5;
            1.0 + (pixel % 64) as f32 / 32.0 + 0.01 * noise
        });
        for variance in [None, Some(render.variance_of_mean.clone())] {
            let found = contradiction(&filtered, Some(render.spread()), variance);
            assert!(matches!(found, Some(Contradiction::ImageTooSmooth { .. })), "{found:?}");
        }
        let found = contradiction(&filtered, None, Some(render.variance_of_mean));
        assert!(matches!(found, Some(Contradiction::VarianceTooLarge { .. })), "{found:?}");
    }

    #[test]
    fn small_images_agree() {
        for (width, height) in [(1, 1), (1, 9), (9, 1), (2, 2), (3, 3), (4, 4), (5, 7), (8, 8), (500, 1), (1, 500)] {
            let render = render(Extent { width, height }, SAMPLES / 2);
            let both = frame(&render.mean, Some(render.spread()), Some(render.variance_of_mean));
            for knowledge in
                [NoiseKnowledge::HalvesAndVariance, NoiseKnowledge::HalvesOnly, NoiseKnowledge::VarianceOnly]
            {
                let check = both.with_noise_known_from(knowledge).map(|frame| frame.check_of_noise());
                assert_eq!(check.map(|check| check.contradiction()), Some(None), "{width}×{height}: {check:?}");
            }
        }
    }

    #[test]
    fn images_without_noise_tell_nothing() {
        let zero = Image::filled(EXTENT, 3, 0.0);
        let one_pixel = mapped(&zero, |pixel, _| f32::from(pixel == 1000));
        for (mean, noise) in [(&zero, &zero), (&one_pixel, &zero), (&one_pixel, &one_pixel), (&zero, &one_pixel)] {
            for spread in [None, Some(noise.clone())] {
                let check = frame(mean, spread, Some(noise.clone())).check_of_noise();
                let expected = NoiseCheck { samples_per_pixel: check.samples_per_pixel, ..NoiseCheck::default() };
                assert_eq!(check, expected);
                assert_eq!(check.contradiction(), None);
            }
        }
        // Round-off of a variance that is the difference of two squares, and half floats.
        let ramp = mapped(&zero, |pixel, _| 1.0 + (pixel % 64) as f32 / 1024.0);
        let round_off = mapped(&ramp, |pixel, value| value * value * 1e-7 * (pixel % 3) as f32);
        assert_eq!(contradiction(&ramp, None, Some(round_off)), None);
    }

    #[test]
    fn one_noisy_pixel_in_texture_agrees() {
        let texture = mapped(&Image::filled(EXTENT, 3, 0.0), |pixel, _| 1.0 + (pixel * 7919 % 101) as f32 / 101.0);
        let variance = mapped(&texture, |pixel, _| if pixel == 1000 { 5.0 } else { 0.0 });
        assert_eq!(contradiction(&texture, None, Some(variance)), None);
    }

    #[test]
    fn texture_alone_is_no_contradiction() {
        let render = render(EXTENT, SAMPLES / 2);
        let textured = mapped(&render.mean, |pixel, value| value + (pixel * 7919 % 101) as f32 / 25.0);
        let both = frame(&textured, Some(render.spread()), Some(render.variance_of_mean));
        let check = both.check_of_noise();
        assert!(check.variance_over_image.is_some_and(|ratio| ratio < 0.25), "{check:?}");
        assert_eq!(check.contradiction(), None);
    }

    #[test]
    fn checks_can_be_read_by_programs() {
        let check = NoiseCheck {
            variance_over_image: Some(30.0),
            halves_over_variance: Some(1.0 / 32.0),
            halves_over_image: Some(1.0),
            samples_per_pixel: Some(32.0),
            ..NoiseCheck::default()
        };
        let json = |value: serde_json::Result<serde_json::Value>| value.unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(
            json(serde_json::to_value(check)),
            serde_json::json!({
                "variance_over_image": 30.0,
                "halves_over_variance": 0.03125,
                "halves_over_image": 1.0,
                "structure_of_halves": null,
                "variance_beyond_square": null,
                "samples_per_pixel": 32.0,
            })
        );
        assert_eq!(
            json(serde_json::to_value(check.contradiction())),
            serde_json::json!({
                "kind": "variance_too_large",
                "factor": 32.0,
                "meaning": { "kind": "one_sample", "samples": 32.0 },
            })
        );
    }

    #[test]
    fn factors_beyond_measure_are_told_without_a_number() {
        let alike = Contradiction::HalvesTooAlike { factor: f64::INFINITY };
        assert!(alike.to_string().contains("more than a million times too small"), "{alike}");
    }
}
