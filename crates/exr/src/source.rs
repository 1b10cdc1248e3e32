//! Places of a picture's signals in the files, and how their values are brought to one meaning.

use stein::error::LayerCause;
use stein::frame::{PayloadKind, RawSignal, SamplesPerPixel, fill_unknown_variance};
use stein::image::{Image, Window};

use crate::classify::{LayerId, Scope};
use crate::file::ExrFile;
use crate::layout::{Quantity, Unit};
use crate::multiplier::Multiplier;

/// The variance of a pixel of which it is not known. No variance is below 0 by more than round-off.
const UNKNOWN: f32 = f32::NEG_INFINITY;

/// Some channels of one part of one of the set's files.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Planes {
    pub(crate) file: usize,
    pub(crate) layer: usize,
    /// Positions in the part's list of channels, one for each plane; a luminance is listed three times.
    pub(crate) channels: Vec<usize>,
}

impl Planes {
    pub(crate) fn id(&self) -> LayerId {
        LayerId { file: self.file, layer: self.layer }
    }
}

/// Returns a half without the other one, and the name of that.
pub(crate) fn single_half<'a>(half_a: &'a Option<Planes>, half_b: &'a Option<Planes>) -> Option<(&'a Planes, char)> {
    match (half_a, half_b) {
        (Some(half), None) => Some((half, 'B')),
        (None, Some(half)) => Some((half, 'A')),
        _ => None,
    }
}

/// The layer from which a signal's variance of the mean is known.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct VarianceSource {
    pub(crate) planes: Planes,
    pub(crate) quantity: Quantity,
    /// For second moments: the means that belong to them.
    pub(crate) mean: Option<Planes>,
    /// The value that means that the variance is not known.
    pub(crate) unknown: Option<f32>,
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct SignalSource {
    pub(crate) mean: Planes,
    pub(crate) half_a: Option<Planes>,
    pub(crate) half_b: Option<Planes>,
    pub(crate) variance: Option<VarianceSource>,
    /// The value that means that a ray hit nothing.
    pub(crate) miss: Option<f32>,
    /// The value of pixels outside of the layer's data window.
    pub(crate) outside: f32,
    pub(crate) unit: Option<Unit>,
    /// The layers by which the stored values are multiplied, in this order. An output is divided by them.
    pub(crate) multipliers: Vec<Multiplier>,
    /// Whether the values in memory are products already, because seeds were merged.
    pub(crate) is_product: bool,
}

impl SignalSource {
    /// Returns the source of a mean without noise and multipliers.
    pub(crate) fn new(mean: Planes) -> Self {
        Self {
            mean,
            half_a: None,
            half_b: None,
            variance: None,
            miss: None,
            outside: 0.0,
            unit: None,
            multipliers: Vec::new(),
            is_product: false,
        }
    }

    /// Returns the layers by which the values in memory are still to be multiplied.
    pub(crate) fn pending_multipliers(&self) -> &[Multiplier] {
        if self.is_product { &[] } else { &self.multipliers }
    }

    /// Returns all planes, the mean first.
    pub(crate) fn planes(&self) -> impl Iterator<Item = &Planes> {
        let variance = self.variance.as_ref();
        let of_variance = [variance.map(|variance| &variance.planes), variance.and_then(|it| it.mean.as_ref())];
        std::iter::once(&self.mean)
            .chain([self.half_a.as_ref(), self.half_b.as_ref()].into_iter().chain(of_variance).flatten())
    }
}

/// A layer of the input that is filtered along with the colour, or an alpha in it.
#[derive(Clone, Debug)]
pub(crate) struct PayloadSource {
    /// Name in frames and reports, which no other layer has.
    pub(crate) name: String,
    pub(crate) kind: PayloadKind,
    pub(crate) signal: SignalSource,
    /// Layers of the input with halves and variances, which do not belong to the denoised layer.
    pub(crate) stale: Vec<usize>,
}

/// A picture: a colour with its features.
#[derive(Clone, Debug)]
pub(crate) struct Picture {
    pub(crate) scope: Scope,
    /// Whether the input holds no other picture.
    pub(crate) is_only: bool,
    pub(crate) color: SignalSource,
    pub(crate) features: Vec<(String, SignalSource)>,
    pub(crate) samples: SamplesPerPixel,
    /// The layer from which the samples are known, if it is one.
    pub(crate) samples_layer: Option<Planes>,
    /// The layers that are filtered along with the colour. An alpha comes behind the lights that it belongs to.
    pub(crate) payload: Vec<PayloadSource>,
    /// The alpha of the colour in the input.
    pub(crate) alpha: Option<Planes>,
    /// Whether the files hold colours that are not multiplied by their alpha.
    pub(crate) is_straight: bool,
    /// Whether alpha stays as it was.
    pub(crate) keeps_alpha: bool,
    /// Whether alpha is a feature, too, if its noise is known.
    pub(crate) alpha_guides: bool,
    /// The pixels without hits, once the colour's samples are given away; `None` without an alpha.
    pub(crate) empty: Option<Vec<bool>>,
}

impl Picture {
    /// Returns the colour and the features.
    pub(crate) fn signals(&self) -> impl Iterator<Item = &SignalSource> {
        std::iter::once(&self.color).chain(self.features.iter().map(|(_, source)| source))
    }

    /// Returns the layers that are filtered along with the colour.
    pub(crate) fn payload_signals(&self) -> impl Iterator<Item = &SignalSource> {
        self.payload.iter().map(|source| &source.signal)
    }

    /// Returns the alpha of the colour as a layer that is filtered along.
    pub(crate) fn own_alpha(&self) -> Option<&PayloadSource> {
        let is_own = |source: &&PayloadSource| self.alpha.as_ref() == Some(&source.signal.mean);
        self.payload.iter().filter(|source| source.kind == PayloadKind::Alpha).find(is_own)
    }

    /// Whether a layer tells the noise of one that is filtered along with the colour.
    pub(crate) fn is_stale(&self, id: LayerId) -> bool {
        id.file == 0 && self.payload.iter().any(|source| source.stale.contains(&id.layer))
    }

    /// Whether the colour or a layer that is filtered along with it is multiplied by a layer.
    pub(crate) fn is_multiplier(&self, id: LayerId) -> bool {
        let signals = std::iter::once(&self.color).chain(self.payload_signals());
        signals.flat_map(|signal| &signal.multipliers).any(|multiplier| multiplier.mean.id() == id)
    }

    /// Whether a layer is filtered along with the colour.
    pub(crate) fn is_payload(&self, id: LayerId) -> bool {
        self.payload_signals().any(|signal| signal.mean.id() == id)
    }
}

/// Converts the variance of one sample, or the second moment, to the variance of the mean. `mean` belongs to a second
/// moment. A variance below 0 by round-off becomes 0.
pub(crate) fn to_variance_of_mean(
    values: &mut Image,
    quantity: Quantity,
    mean: Option<&Image>,
    samples: &SamplesPerPixel,
) {
    let count = |pixel: usize| match samples {
        SamplesPerPixel::Unknown => f64::NAN,
        SamplesPerPixel::Uniform(count) => f64::from(*count),
        SamplesPerPixel::PerPixel(counts) => f64::from(counts.planes[0][pixel]),
    };
    for (channel, plane) in values.planes.iter_mut().enumerate() {
        for (pixel, value) in plane.iter_mut().enumerate() {
            let given = f64::from(*value);
            let count = count(pixel);
            let variance = match (quantity, mean) {
                (Quantity::VarianceOfSample, _) => given / count,
                (Quantity::SecondMoment, Some(mean)) => {
                    let mean = f64::from(mean.planes[channel][pixel]);
                    // One sample has no variance; the result is 0/0, and the pixel is repaired.
                    (given - mean * mean).max(0.0) / (count - 1.0)
                }
                _ => given,
            };
            *value = variance as f32;
        }
    }
}

/// Returns a raw signal with one meaning: variances of the mean, misses at infinity, all in the picture's window.
pub(crate) fn settled(
    source: &SignalSource,
    samples: &SamplesPerPixel,
    planes: &impl Fn(&Planes, f32) -> Image,
) -> RawSignal {
    settled_from(source, samples, &mut |wanted, outside| Ok::<_, std::convert::Infallible>(planes(wanted, outside)))
        .unwrap_or_else(|never| match never {})
}

/// As [`settled`], for a way to get the planes that may fail.
pub(crate) fn settled_from<E>(
    source: &SignalSource,
    samples: &SamplesPerPixel,
    planes: &mut impl FnMut(&Planes, f32) -> Result<Image, E>,
) -> Result<RawSignal, E> {
    let variance_of_mean = match &source.variance {
        None => None,
        Some(variance) => {
            let mean = variance.mean.as_ref().map(|mean| planes(mean, 0.0)).transpose()?;
            let mut values = planes(&variance.planes, 0.0)?;
            if let Some(unknown) = variance.unknown {
                let all = values.planes.iter_mut().flatten();
                all.filter(|value| **value == unknown).for_each(|value| *value = UNKNOWN);
            }
            to_variance_of_mean(&mut values, variance.quantity, mean.as_ref(), samples);
            for multiplier in source.pending_multipliers() {
                multiplier.kind.multiply_variance(&mut values, &planes(&multiplier.mean, 0.0)?);
            }
            Some(values)
        }
    };
    let mut product = |stored: &Planes, of_half: fn(&Multiplier) -> &Option<Planes>| {
        let mut image = planes(stored, source.outside)?;
        for multiplier in source.pending_multipliers() {
            let by = of_half(multiplier).as_ref().unwrap_or(&multiplier.mean);
            multiplier.kind.multiply(&mut image, &planes(by, 0.0)?);
        }
        Ok(image)
    };
    let mut signal = RawSignal {
        mean: product(&source.mean, |_| &None)?,
        half_a: source.half_a.as_ref().map(|half| product(half, |by| &by.half_a)).transpose()?,
        half_b: source.half_b.as_ref().map(|half| product(half, |by| &by.half_b)).transpose()?,
        variance_of_mean,
    };
    let unknown = source.variance.as_ref().and_then(|variance| variance.unknown);
    if let Some(variance) = signal.variance_of_mean.as_mut().filter(|_| unknown.is_some()) {
        fill_unknown_variance(variance, &signal.mean, |value| value == UNKNOWN);
    }
    if let Some(miss) = source.miss {
        // Where one half alone missed, the mean is a distance, if an uncertain one. A position may have the value in
        // one of its coordinates.
        let planes = &mut signal.mean.planes;
        for pixel in 0..planes.first().map_or(0, Vec::len) {
            if planes.iter().all(|plane| plane[pixel] == miss) {
                planes.iter_mut().for_each(|plane| plane[pixel] = f32::INFINITY);
            }
        }
    }
    Ok(signal)
}

/// Returns the pixels of `window` of an image whose data window is `own`; pixels outside of it are `outside`.
pub(crate) fn aligned(image: Image, own: Window, window: Window, outside: f32) -> Image {
    if own == window {
        return image;
    }
    let planes = vec![vec![outside; window.extent.pixels()]; image.planes.len()];
    let mut aligned = Image { extent: window.extent, planes };
    overlay(&mut aligned, window, &image, own);
    aligned
}

/// Replaces the pixels of `image`, whose data window is `window`, that `other` has in its data window `own`.
pub(crate) fn overlay(image: &mut Image, window: Window, other: &Image, own: Window) {
    let (width, own_width) = (i64::from(window.extent.width), i64::from(own.extent.width));
    let (right, down) = (i64::from(own.x) - i64::from(window.x), i64::from(own.y) - i64::from(window.y));
    // The columns of the window that the other image covers.
    let (first, last) = (right.clamp(0, width), (right + own_width).clamp(0, width));
    for y in 0..i64::from(window.extent.height) {
        let own_y = y - down;
        if first >= last || !(0..i64::from(own.extent.height)).contains(&own_y) {
            continue;
        }
        let to = (y * width + first) as usize..(y * width + last) as usize;
        let from = (own_y * own_width + first - right) as usize..(own_y * own_width + last - right) as usize;
        for (plane, source) in image.planes.iter_mut().zip(&other.planes) {
            plane[to.clone()].copy_from_slice(&source[from.clone()]);
        }
    }
}

/// Whether `own` covers all of `window`.
pub(crate) fn covers(own: Window, window: Window) -> bool {
    overlap(own, window) == window.extent.pixels() as u64
}

/// Returns the number of pixels that both windows have.
pub(crate) fn overlap(a: Window, b: Window) -> u64 {
    let side = |a: i32, a_size: u32, b: i32, b_size: u32| {
        let (a, b) = (i64::from(a), i64::from(b));
        ((a + i64::from(a_size)).min(b + i64::from(b_size)) - a.max(b)).max(0) as u64
    };
    side(a.x, a.extent.width, b.x, b.extent.width) * side(a.y, a.extent.height, b.y, b.extent.height)
}

/// Returns part and channels in another file of the layer of the same name; `None` if a channel is not there.
pub(crate) fn same_layer(own: &ExrFile, other: &ExrFile, planes: &Planes) -> Option<(usize, Vec<usize>)> {
    let layer = &own.layers[planes.layer];
    let found = other.layers.iter().find(|candidate| candidate.name == layer.name)?;
    let channel = |index: &usize| {
        let letter = layer.channels.iter().find(|channel| channel.index == *index)?.letter();
        found.channel(letter)
    };
    Some((found.part, planes.channels.iter().map(channel).collect::<Option<_>>()?))
}

/// Returns the cause if a part of `other` has another resolution than the picture `window` of `own`. Files without
/// windows show the whole picture or its crop.
pub(crate) fn other_resolution(own: &ExrFile, window: Window, other: &ExrFile, part: usize) -> Option<LayerCause> {
    let (expected, found) = match own.has_windows() && other.has_windows() {
        true => (own.display_window(), other.display_window()),
        false => (window, other.data_window(part)),
    };
    let cause = || LayerCause::Resolution { found: found.extent.to_string(), expected: expected.extent.to_string() };
    (expected.extent != found.extent).then(cause)
}

/// Returns the data window of a file's part as it relates to the picture's window: files without windows, such as PNG,
/// show the same pixels if they have the same extent.
pub(crate) fn window_of(file: &ExrFile, part: usize, picture: Window) -> Window {
    let own = file.data_window(part);
    if !file.has_windows() && own.extent == picture.extent { picture } else { own }
}

#[cfg(test)]
mod tests {
    use stein::image::Extent;

    use super::*;

    fn window(x: i32, y: i32, width: u32, height: u32) -> Window {
        Window { x, y, extent: Extent { width, height } }
    }

    #[test]
    fn images_are_aligned_by_their_windows() {
        let own = window(-1, 2, 3, 2);
        let image = Image { extent: own.extent, planes: vec![vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0]] };
        let at = |wanted: Window| aligned(image.clone(), own, wanted, 9.0).planes[0].clone();
        assert_eq!(at(window(0, 2, 2, 1)), [2.0, 3.0]);
        assert_eq!(at(window(1, 1, 2, 3)), [9.0, 9.0, 3.0, 9.0, 6.0, 9.0]);
        assert_eq!(at(window(-2, 3, 5, 1)), [9.0, 4.0, 5.0, 6.0, 9.0]);
        assert_eq!(at(window(50, 50, 1, 2)), [9.0, 9.0]);
        assert_eq!(overlap(own, window(1, 1, 2, 3)), 2);
        assert!(covers(own, window(0, 2, 2, 1)) && !covers(own, window(0, 2, 3, 1)));
        assert_eq!(overlap(window(i32::MIN, 0, 5, 1), window(i32::MAX, 0, 5, 1)), 0);
    }

    #[test]
    fn quantities_become_the_variance_of_the_mean() {
        let image = |value: f32| Image::filled(Extent { width: 1, height: 1 }, 1, value);
        let converted = |value: f32, quantity, mean: Option<f32>, samples| {
            let mut values = image(value);
            to_variance_of_mean(&mut values, quantity, mean.map(image).as_ref(), &SamplesPerPixel::Uniform(samples));
            values.planes[0][0]
        };
        assert_eq!(converted(8.0, Quantity::VarianceOfMean, None, 32.0), 8.0);
        assert_eq!(converted(8.0, Quantity::VarianceOfSample, None, 32.0), 0.25);
        // Samples 1 and 3: mean 2, E[x²] 5, s² 2, s²/n 1.
        assert_eq!(converted(5.0, Quantity::SecondMoment, Some(2.0), 2.0), 1.0);
        assert_eq!(converted(3.99, Quantity::SecondMoment, Some(2.0), 2.0), 0.0);
        assert!(converted(4.0, Quantity::SecondMoment, Some(2.0), 1.0).is_nan());
    }
}
