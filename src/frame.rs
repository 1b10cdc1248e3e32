//! Frames: the input of the denoiser in one fixed meaning. Everything is finite, all images have one extent, variances
//! are variances of the pixel mean, halves are one spread, features are in unit range.

mod albedo;
mod correlation;
mod image_noise;
mod kind;
mod knowledge;
mod meaning;
mod noise;
mod normals;
mod payload;
mod range;
mod repairs;
mod sanitise;
mod sources;
mod unit_range;

use rayon::prelude::*;

use crate::error::{Error, RequestCause, Result};
use crate::image::{self, Extent, Image, Window};
pub use image_noise::{fill_unknown_variance, variance_from_image};
pub use kind::FeatureKind;
pub use knowledge::{IMAGE_ONLY, NoiseKnowledge};
pub use meaning::{Contradiction, LargeVariance, NoiseCheck};
pub(crate) use noise::{NoiseTiles, TILE};
pub use payload::{PayloadKind, PayloadLayer};
use repairs::Layer;
pub use repairs::{Damage, DamagedImage, LayerRepairs, Repairs};
use sanitise::Sanitised;
use unit_range::UnitRange;

/// ε of the relative measures of error, (x − ref)²/(ref² + ε): keeps dark pixels from counting without bound (thesis
/// 6.5).
pub const RELATIVE_EPSILON: f64 = 0.01;

/// The most features that a frame takes; the text's scenes use up to five.
pub const MAX_FEATURES: usize = 8;

/// Number of values that a thread looks at before it checks whether another thread has already found a difference.
const VALUES_AT_ONCE: usize = 1 << 16;

/// A mean with the noise statistics of the files, as stored: it may contain anything that a float can be. All images
/// have the same extent and channels.
#[derive(Clone, Debug, PartialEq)]
pub struct RawSignal {
    /// The mean of all samples.
    pub mean: Image,
    /// The mean of the first half of the samples.
    pub half_a: Option<Image>,
    /// The mean of the other half.
    pub half_b: Option<Image>,
    /// Sample variance of the mean, s²/n.
    pub variance_of_mean: Option<Image>,
}

/// A noisy mean with statistics of its noise. All images have the same extent and number of channels.
#[derive(Clone, Debug, PartialEq)]
pub struct Signal {
    /// The mean of all samples of each pixel.
    pub mean: Image,
    /// `(A − B)·√(n_A·n_B)/n` of the two half-buffer means A and B: a signal with zero expectation, the variance of the
    /// mean's noise, and uncorrelated with it. With equal halves it is `(A − B)/2`, and the halves are
    /// `mean ± half_spread`. Its square is the two-buffer estimate of the variance of the mean (thesis 8.2). `None`
    /// without halves.
    pub half_spread: Option<Image>,
    /// Sample variance of the mean, s²/n. `None` where the renderer gave none.
    pub variance_of_mean: Option<Image>,
}

/// A feature buffer, brought to unit range by one affine map for all its channels.
#[derive(Clone, Debug)]
pub struct Feature {
    /// Name of the layer, such as `albedo`.
    pub name: String,
    /// Quantity that the feature measures.
    pub kind: FeatureKind,
    /// 1 to 3 channels in unit range; variances are scaled with the square of the map's factor. Outliers and far
    /// clusters, which the range leaves out, lie outside of 0 to 1. Values beyond −1 and 2 are pulled towards the range
    /// by a logarithm, with their noise, and stay within ±200.
    pub signal: Signal,
    /// `value in the file = unit value · unit_scale + unit_offset`, for unit values from −1 to 2.
    pub unit_scale: f32,
    /// Offset of the map; see `unit_scale`.
    pub unit_offset: f32,
    /// Whether the rays of each pixel hit nothing; such misses have the value 1, without noise. Empty where there are
    /// no misses.
    pub misses: Vec<bool>,
}

/// Samples that each pixel's mean was computed from.
#[derive(Clone, Debug, PartialEq)]
pub enum SamplesPerPixel {
    /// The file does not say.
    Unknown,
    /// One number for all pixels.
    Uniform(f32),
    /// One number per pixel (one plane).
    PerPixel(Image),
}

impl Signal {
    /// Returns whether all channels are equal to the bit, in the mean and in all statistics of its noise.
    pub fn is_grey(&self) -> bool {
        let same = |a: &Vec<f32>, b: &Vec<f32>| {
            let pairs = a.par_chunks(VALUES_AT_ONCE).zip(b.par_chunks(VALUES_AT_ONCE));
            pairs
                .into_par_iter()
                .all(|(a, b)| bytemuck::cast_slice::<f32, u32>(a) == bytemuck::cast_slice::<f32, u32>(b))
        };
        self.images().all(|image| image.planes.iter().skip(1).all(|plane| same(&image.planes[0], plane)))
    }

    fn images(&self) -> impl Iterator<Item = &Image> {
        [Some(&self.mean), self.half_spread.as_ref(), self.variance_of_mean.as_ref()].into_iter().flatten()
    }
}

/// Returns `(A − B)·√(n_A·n_B)/n` with n = n_A + n_B: see [`Signal::half_spread`].
///
/// Its square estimates the variance of the *mean of both halves* (thesis 8.2), which is half of the variance of one
/// half, (A − B)²/2, that chapter 7 uses. The images must have the same shape; `n_a` and `n_b` are the halves' sample
/// counts, of which only the ratio matters.
pub fn half_spread(a: &Image, b: &Image, n_a: f32, n_b: f32) -> Image {
    into_half_spread(a.clone(), b, n_a, n_b)
}

/// As [`half_spread`], in the memory of half A.
fn into_half_spread(mut a: Image, b: &Image, n_a: f32, n_b: f32) -> Image {
    let factor = (n_a * n_b).sqrt() / (n_a + n_b);
    for (a, b) in a.planes.iter_mut().zip(&b.planes) {
        a.iter_mut().zip(b).for_each(|(a, b)| *a = (*a - b) * factor);
    }
    a
}

/// Input of the denoisers. Only `Frame::from_raw` and `Frame::new` make a frame, so a frame is always finite and
/// consistent.
#[derive(Clone, Debug)]
pub struct Frame {
    extent: Extent,
    color: Signal,
    features: Vec<Feature>,
    constant_features: Vec<String>,
    samples_per_pixel: SamplesPerPixel,
    payload: Vec<PayloadLayer>,
}

impl Frame {
    /// Makes a frame from means and halves as they were rendered. The halves count as having equal numbers of samples.
    /// Features are requested one by one, so that no more than one of them is in memory both raw and converted.
    ///
    /// Halves are left out if one of them is 0 everywhere and the other is not.
    ///
    /// # Errors
    /// As [`Frame::new`].
    pub fn from_raw(
        color: RawSignal,
        features: impl IntoIterator<Item = (String, RawSignal)>,
        samples_per_pixel: SamplesPerPixel,
    ) -> Result<(Self, Repairs)> {
        let mut notes = Vec::new();
        if empty_half(&color).is_none() {
            notes.extend(mean_beside_halves(&color));
        }
        let color = signal("colour", color, &mut notes);
        let settled = |(name, raw): (String, RawSignal)| {
            let signal = signal(&name, raw, &mut notes);
            (name, signal)
        };
        let features = features.into_iter().map(settled).collect();
        let (frame, mut repairs) = Self::new(color, features, samples_per_pixel)?;
        repairs.notes.splice(0..0, notes);
        Ok((frame, repairs))
    }

    /// Makes a frame from raw values: colour in scene-linear radiance (three planes), features in any units (one to
    /// three planes each, not yet in unit range), variances of the mean.
    ///
    /// Everything in the frame is finite: damaged values become the average of their neighbours, negative variances
    /// become 0. Halves or variance are left out if they do not fit the mean, if they have no usable value, or if they
    /// are 0 where the other source shows noise. Identical halves of a colour without a variance are left out, too. A
    /// colour whose noise is unknown is [`NoiseKnowledge::ImageOnly`]. Albedo is clamped to 1. Features are brought to
    /// unit range; left out are features that are constant or unusable, and all after the first [`MAX_FEATURES`]. All
    /// changes are reported.
    ///
    /// # Errors
    /// [`Error::Request`] for images of different extents, for images without pixels, for a colour that does not have
    /// three channels or has a channel without a usable pixel, and for sample counts of another shape.
    pub fn new(
        mut color: Signal,
        features: Vec<(String, Signal)>,
        samples_per_pixel: SamplesPerPixel,
    ) -> Result<(Self, Repairs)> {
        let extent = color.mean.extent;
        check_shape("colour", &color, extent)?;
        if color.mean.channels() != 3 {
            return Err(Error::Request(RequestCause::ColorChannels { channels: color.mean.channels() }));
        }
        let mut repairs = Repairs::default();
        settle_color(&mut color, &mut repairs)?;

        let mut kept = Vec::new();
        let mut constant_features = Vec::new();
        for (name, mut signal) in features {
            check_shape(&name, &signal, extent)?;
            if !(1..=3).contains(&signal.mean.channels()) {
                repairs.drop_feature(name, &format!("it has {} channels, not 1 to 3", signal.mean.channels()));
                continue;
            }
            if kept.len() == MAX_FEATURES {
                repairs.drop_feature(name, &format!("at most {MAX_FEATURES} features can be used"));
                continue;
            }
            let kind = FeatureKind::from_name(&name);
            let Some(misses) = settle_feature(&name, kind, &mut signal, &mut repairs) else {
                repairs.drop_feature(name, "not one pixel has a usable value");
                continue;
            };
            if kind == FeatureKind::Albedo {
                repairs.notes.extend(albedo::clamp_to_one(&name, &mut signal));
            }
            match unit_range::to_unit_range(&name, kind, &mut signal, &misses) {
                Some(UnitRange { scale: unit_scale, offset: unit_offset, notes }) => {
                    repairs.notes.extend(notes);
                    let misses = if misses.contains(&true) { misses } else { Vec::new() };
                    kept.push(Feature { name, kind, signal, unit_scale, unit_offset, misses });
                }
                None => {
                    constant_features.push(name.clone());
                    repairs.drop_feature(name, "the same everywhere");
                }
            }
        }
        let samples_per_pixel = sanitise::sanitise_samples(samples_per_pixel, extent, &mut repairs)?;
        let payload = Vec::new();
        Ok((Self { extent, color, features: kept, constant_features, samples_per_pixel, payload }, repairs))
    }

    /// Returns a part of the frame, in the same units, without its payload.
    pub(crate) fn cropped(&self, part: Window) -> Self {
        let crop = |signal: &Signal| {
            let [half_spread, variance_of_mean] = [&signal.half_spread, &signal.variance_of_mean]
                .map(|image| image.as_ref().map(|image| image.cropped(part)));
            Signal { mean: signal.mean.cropped(part), half_spread, variance_of_mean }
        };
        let features = self.features.iter().map(|feature| {
            let misses =
                if feature.misses.is_empty() { Vec::new() } else { image::cropped(&feature.misses, self.extent, part) };
            Feature { signal: crop(&feature.signal), misses, name: feature.name.clone(), ..*feature }
        });
        let samples_per_pixel = match &self.samples_per_pixel {
            SamplesPerPixel::PerPixel(counts) => SamplesPerPixel::PerPixel(counts.cropped(part)),
            SamplesPerPixel::Uniform(count) => SamplesPerPixel::Uniform(*count),
            SamplesPerPixel::Unknown => SamplesPerPixel::Unknown,
        };
        Self {
            extent: part.extent,
            color: crop(&self.color),
            features: features.collect(),
            constant_features: self.constant_features.clone(),
            samples_per_pixel,
            payload: Vec::new(),
        }
    }

    /// Returns width and height of all images of the frame.
    pub fn extent(&self) -> Extent {
        self.extent
    }

    /// Returns the noisy colour: three planes of finite scene-linear radiance.
    pub fn color(&self) -> &Signal {
        &self.color
    }

    /// Returns the features, in unit range; at most [`MAX_FEATURES`], possibly none.
    pub fn features(&self) -> &[Feature] {
        &self.features
    }

    /// Returns the names of features that were given but are constant. They cannot tell pixels apart, so the frame does
    /// not keep them.
    pub fn constant_features(&self) -> &[String] {
        &self.constant_features
    }

    /// Returns the samples per pixel, positive and finite where known.
    pub fn samples_per_pixel(&self) -> &SamplesPerPixel {
        &self.samples_per_pixel
    }
}

/// Makes a signal. Halves of which one is empty are left out.
fn signal(name: &str, raw: RawSignal, notes: &mut Vec<String>) -> Signal {
    let empty = empty_half(&raw);
    if let Some(half) = empty {
        notes.push(format!("{name}: half {half} is empty, so that the halves are not used"));
    }
    let halves = raw.half_a.zip(raw.half_b).filter(|_| empty.is_none());
    let half_spread = halves.map(|(a, b)| into_half_spread(a, &b, 1.0, 1.0));
    Signal { mean: raw.mean, half_spread, variance_of_mean: raw.variance_of_mean }
}

/// Returns the name of the half that got no samples, as in a render with one sample per pixel: 0 everywhere, unlike the
/// other half.
fn empty_half(raw: &RawSignal) -> Option<&'static str> {
    let is_empty = |image: &Image| image.planes.iter().flatten().all(|value| *value == 0.0);
    match raw.half_a.as_ref().zip(raw.half_b.as_ref()).map(|(a, b)| (is_empty(a), is_empty(b)))? {
        (true, false) => Some("A"),
        (false, true) => Some("B"),
        _ => None,
    }
}

/// Returns a remark if the mean is not the average of the halves, as when one render is given beside two renders with
/// other seeds.
fn mean_beside_halves(raw: &RawSignal) -> Option<String> {
    let (a, b) = raw.half_a.as_ref().zip(raw.half_b.as_ref())?;
    let mut differing = 0;
    let mut values = 0;
    for (mean, (a, b)) in raw.mean.planes.iter().zip(a.planes.iter().zip(&b.planes)) {
        values += mean.len();
        let differs = |(mean, (a, b)): &(&f32, (&f32, &f32))| {
            let average = (*a + *b) / 2.0;
            // Half floats round by 2^-11; denormals by more.
            (*mean - average).abs() > 0.01 * (mean.abs() + average.abs()) + 1e-4
        };
        differing += mean.iter().zip(a.iter().zip(b)).filter(differs).count();
    }
    (differing * 10 > values).then(|| {
        let percent = 100 * differing / values;
        format!(
            "colour: in {percent} % of its values the input is not the average of the halves; their difference then \
             tells little about its noise"
        )
    })
}

fn check_shape(name: &str, signal: &Signal, extent: Extent) -> Result<()> {
    let cause = if extent.pixels() == 0 {
        RequestCause::NoPixels { signal: name.into() }
    } else if signal.images().any(|image| image.extent != extent) {
        RequestCause::ImageExtents { signal: name.into(), extent }
    } else if signal.images().flat_map(|image| &image.planes).any(|plane| plane.len() != extent.pixels()) {
        RequestCause::PlaneLength { signal: name.into(), extent }
    } else {
        return Ok(());
    };
    Err(Error::Request(cause))
}

/// Makes the colour finite and decides from which source its noise is known.
fn settle_color(color: &mut Signal, repairs: &mut Repairs) -> Result<()> {
    let layer = Layer::COLOR;
    let mut notes = Vec::new();
    sources::leave_out_unusable(layer, color, &mut notes);
    // Measured before the repair, because repaired pixels share the noise of their neighbours.
    let shared_noise = color.half_spread.as_ref().and_then(correlation::shared_noise);
    let Sanitised { found, unusable, .. } = sanitise::sanitise(layer, color, false);
    if !unusable.is_empty() {
        return Err(Error::Request(RequestCause::NoUsableValue {
            channels: layer.in_channels(&unusable, color.mean.channels()),
        }));
    }
    sources::settle(layer, color, &mut notes);
    if color.known_from() == NoiseKnowledge::HalvesOnly && sources::is_silent(color) {
        notes.push(
            "colour: the two halves are identical (rendered with the same seed?), so that they say nothing about the \
             noise; they are left out"
                .into(),
        );
        color.half_spread = None;
    }
    if let Some(correlation) = shared_noise.filter(|_| color.half_spread.is_some()) {
        notes.push(format!(
            "colour: neighbouring pixels share their noise (the halves' difference has a correlation of \
             {correlation:.2} from pixel to pixel), so that more of it stays than its variance tells, as grain larger \
             than a pixel; render with a box pixel filter of one pixel's width and independent pixels"
        ));
    }
    let knowledge = color.known_from();
    match knowledge {
        NoiseKnowledge::VarianceOnly => {
            notes.push("colour: no halves, so the variance is taken as it is and there is no second pass".into());
        }
        NoiseKnowledge::ImageOnly => notes.push(knowledge::IMAGE_ONLY.into()),
        NoiseKnowledge::HalvesAndVariance | NoiseKnowledge::HalvesOnly => {}
    }
    if knowledge != NoiseKnowledge::ImageOnly && sources::is_silent(color) {
        let silent =
            if knowledge.has_halves() { "neither the halves nor the variance tell" } else { "the variance tells" };
        notes.push(format!("colour: {silent} of no noise at all, so that nothing is filtered"));
    }
    repairs.add(found);
    repairs.notes.extend(notes);
    Ok(())
}

/// Makes a feature finite, decides from which source its noise is known, and returns its misses. `None` if not one
/// pixel has a usable value.
fn settle_feature(name: &str, kind: FeatureKind, signal: &mut Signal, repairs: &mut Repairs) -> Option<Vec<bool>> {
    let layer = Layer::feature(name);
    let channels = signal.mean.channels();
    sources::leave_out_unusable(layer, signal, &mut repairs.notes);
    let Sanitised { found, misses, unusable } = sanitise::sanitise(layer, signal, kind == FeatureKind::Distance);
    if unusable.len() == channels {
        return None;
    }
    repairs.add(found);
    if !unusable.is_empty() {
        repairs.notes.push(format!(
            "{layer}: not one pixel has a usable value{}, taken as 0",
            layer.in_channels(&unusable, channels)
        ));
    }
    sources::settle(layer, signal, &mut repairs.notes);
    if signal.noise_knowledge().is_none() {
        repairs.notes.push(format!("{layer}: neither halves nor variance, taken as free of noise"));
    }
    Some(misses)
}
