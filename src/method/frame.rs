//! A frame on the GPU.

use std::ops::Range;
use std::sync::Arc;

use glam::{IVec2, Vec3};
use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::frame::{Feature, FeatureKind, Frame, SamplesPerPixel, Signal};
use crate::gpu::{Buffer, Recorder};
use crate::image::Image;
use crate::stage::feature::Slot;
use crate::stage::frames::Frames;
use crate::stage::noise::{Pooled, noise_unpack};
use crate::stage::payload::PayloadGroup;
use crate::stage::plane_bytes;
use crate::stage::sample::GpuSamples;

use super::payload::Packing;
use super::plan::Plan;
use super::{Method, Strip};

/// A noisy signal on the GPU.
#[derive(Clone, Debug)]
pub struct GpuSignal {
    /// Two planes of one vec4 per pixel, rows from the top: the mean in x, y, z (unused channels 0), behind it the half
    /// spread `(A − B)·√(n_A·n_B)/n`, all 0 without halves. Everything finite.
    pub signal: Arc<Buffer>,
    /// One plane: sample variance of the mean, s²/n.
    pub variance_of_mean: Option<Arc<Buffer>>,
    /// Whether the second plane of `signal` holds a half spread.
    pub has_halves: bool,
}

impl GpuSignal {
    /// Returns whether nothing but the image itself tells the noise.
    pub(super) fn is_image_only(&self) -> bool {
        !self.has_halves && self.variance_of_mean.is_none()
    }
}

/// A feature on the GPU, in unit range.
#[derive(Debug)]
pub struct GpuFeature {
    /// Name of the feature in dumps.
    pub name: String,
    /// Quantity that the feature measures.
    pub kind: FeatureKind,
    /// Values of the feature, with halves and variance where the renderer gives them.
    pub signal: GpuSignal,
    /// Number of channels, 1 to 3.
    pub channels: u32,
}

/// Layers on the GPU that are filtered along with the colour: up to four planes of one vec4 per pixel.
#[derive(Clone, Debug)]
pub struct GpuPayload {
    /// Means. Channels in x, y and z belong to the colour's channels: spikes are taken out of them where the colour's
    /// channel has one. The number in w, such as alpha, belongs to all channels. Everything finite.
    pub mean: PayloadGroup,
    /// Half spreads, as many planes. Only NLM uses them; without them, both halves equal the mean.
    pub half_spread: Option<Arc<Buffer>>,
}

/// A frame on the GPU, handed over by a renderer that keeps its buffers there.
#[derive(Debug)]
pub struct GpuFrame {
    /// Width and height in pixels.
    pub extent: IVec2,
    /// Colour: three channels, of the order of 1, because the small constants of the methods are absolute.
    pub color: GpuSignal,
    /// Features, 0 to 8.
    pub features: Vec<GpuFeature>,
    /// Samples per pixel. GEM corrects the variances of few samples by them; DFC and NLM use them only for the sampling
    /// density.
    pub samples: GpuSamples,
    /// Variance of the colour's mean, averaged over the whole image, per channel; from the halves, where there are any.
    /// Only [`NlmVariance::Uniform`](super::nlm::NlmVariance) uses it.
    pub mean_variance: Option<Vec3>,
    /// Layers that are filtered along with the colour, in the same groups in all frames of a window; possibly none.
    pub payload: Vec<GpuPayload>,
}

impl GpuFrame {
    /// Makes a frame of one pixel with a payload and two features: one with halves, and one whose noise is unknown. Its
    /// values are arbitrary.
    pub(super) fn least(rec: &mut Recorder, has_halves: bool, has_variance: bool) -> Result<Self> {
        let extent = IVec2::ONE;
        let mut signal = |has_halves: bool, has_variance: bool| {
            let variance_of_mean =
                has_variance.then(|| rec.take("variance", plane_bytes(extent, 1))).transpose()?.map(Arc::new);
            let signal = Arc::new(rec.take("signal", plane_bytes(extent, 2))?);
            Ok::<_, Error>(GpuSignal { signal, variance_of_mean, has_halves })
        };
        let color = signal(has_halves, has_variance)?;
        let mut feature = |name: &str, has_noise: bool| {
            let (name, signal) = (name.to_owned(), signal(has_noise, false)?);
            Ok::<_, Error>(GpuFeature { name, kind: FeatureKind::Albedo, signal, channels: 3 })
        };
        let features = vec![feature("noisy", true)?, feature("exact", false)?];
        let samples = GpuSamples::Uniform(0.0);
        let mut plane = || Ok::<_, Error>(Arc::new(rec.take("payload", plane_bytes(extent, 1))?));
        let mean = PayloadGroup { buffer: plane()?, planes: 1 };
        let payload = vec![GpuPayload { mean, half_spread: Some(plane()?) }];
        Ok(Self { extent, color, features, samples, mean_variance: Some(Vec3::ZERO), payload })
    }
}

/// Input of a method: a frame whose colour is on the device. Its features are on the device, too, or are uploaded one
/// by one, so that the raw features of a frame are never in memory all at once.
pub(crate) struct FrameInput<'a> {
    /// As [`GpuFrame::extent`].
    pub(crate) extent: IVec2,
    /// As [`GpuFrame::color`].
    pub(super) color: GpuSignal,
    /// As [`GpuFrame::features`].
    pub(super) features: Vec<FeatureInput<'a>>,
    /// As [`GpuFrame::samples`].
    pub(super) samples: GpuSamples,
    /// As [`GpuFrame::mean_variance`].
    pub(super) mean_variance: Option<Vec3>,
    /// As [`GpuFrame::payload`].
    pub(super) payload: Vec<GpuPayload>,
}

/// A feature that is on the device or is uploaded later.
pub(super) struct FeatureInput<'a> {
    pub(super) name: String,
    pub(super) kind: FeatureKind,
    /// Number of channels, 1 to 3.
    pub(super) channels: u32,
    source: Source<'a>,
    /// Pooled variances, and the slot of this feature in them; `None` where its variance was not estimated.
    pub(super) pooled: Option<(Arc<Pooled>, Slot)>,
}

enum Source<'a> {
    Device(GpuSignal),
    Host { signal: &'a Signal, strip: Strip, map: Affine<'a>, noise: Noise },
}

impl FeatureInput<'_> {
    /// Returns the feature on the device, uploading it if it is not there.
    pub(super) fn fetch(&self, rec: &mut Recorder, extent: IVec2) -> Result<GpuSignal> {
        let mut signal = match &self.source {
            Source::Device(signal) => signal.clone(),
            Source::Host { signal, strip, map, noise } => upload_signal(rec, &self.name, signal, strip, *map, *noise)?,
        };
        if let Some((pooled, slot)) = &self.pooled {
            signal.variance_of_mean = Some(Arc::new(noise_unpack(rec, extent, pooled, Some(*slot))?));
        }
        Ok(signal)
    }
}

impl From<GpuFrame> for FrameInput<'_> {
    fn from(frame: GpuFrame) -> Self {
        let GpuFrame { extent, color, features, samples, mean_variance, payload } = frame;
        let features = features.into_iter().map(|GpuFeature { name, kind, signal, channels }| FeatureInput {
            name,
            kind,
            channels,
            source: Source::Device(signal),
            pooled: None,
        });
        Self { extent, color, features: features.collect(), samples, mean_variance, payload }
    }
}

impl<'a> FrameInput<'a> {
    /// Returns the same frame for a dry run, without its payload.
    pub(super) fn dry(&self, rec: &mut Recorder) -> Result<Self> {
        let mut signal = |GpuSignal { signal, variance_of_mean, has_halves }: &GpuSignal| {
            let mut twin = |buffer: &Buffer| rec.take(buffer.label(), buffer.bytes());
            Ok(GpuSignal {
                signal: Arc::new(twin(signal)?),
                variance_of_mean: variance_of_mean.as_deref().map(twin).transpose()?.map(Arc::new),
                has_halves: *has_halves,
            })
        };
        let mut feature = |FeatureInput { name, kind, channels, source, .. }: &FeatureInput<'a>| {
            let source = match source {
                Source::Device(of_device) => Source::Device(signal(of_device)?),
                Source::Host { signal, strip, map, noise } => {
                    Source::Host { signal, strip: *strip, map: *map, noise: *noise }
                }
            };
            Ok(FeatureInput { name: name.clone(), kind: *kind, channels: *channels, source, pooled: None })
        };
        let features = self.features.iter().map(&mut feature).collect::<Result<_>>()?;
        let color = signal(&self.color)?;
        let samples = match &self.samples {
            GpuSamples::Uniform(count) => GpuSamples::Uniform(*count),
            GpuSamples::PerPixel(counts) => GpuSamples::PerPixel(rec.take(counts.label(), counts.bytes())?),
        };
        let mean_variance = self.mean_variance;
        Ok(Self { extent: self.extent, color, features, samples, mean_variance, payload: Vec::new() })
    }
}

/// Units in which frames are uploaded. All frames of a window in time have the units of the frame to denoise.
pub(crate) struct Units<'a> {
    /// Factor of the colour.
    pub(crate) exposure: f32,
    /// Features to upload. The features of every frame are mapped to the unit range of these.
    pub(crate) features: Vec<&'a Feature>,
    /// Layers to filter along.
    pub(crate) payload: Packing<'a>,
}

impl<'a> Units<'a> {
    /// Returns the units of the own frame for this method. They list its features if the method uses features, and only
    /// features that all frames have.
    pub(crate) fn of_window(window: &Frames<&'a Frame>, method: &Method, exposure: f32) -> Self {
        let with_features = method.uses_features();
        let alike = |a: &Feature, b: &Feature| a.name == b.name && a.signal.mean.channels() == b.signal.mean.channels();
        let everywhere =
            |feature: &&Feature| window.iter().all(|frame| frame.features().iter().any(|other| alike(feature, other)));
        let own = if with_features { window.own.features() } else { &[] };
        let payload = Packing::of_window(window, method.filters_halves());
        Self { exposure, features: own.iter().filter(everywhere).collect(), payload }
    }
}

impl<'a> FrameInput<'a> {
    /// Uploads the rows of a strip and its halo. Features are uploaded later, when the method fetches them, with the
    /// noise that the plan needs. `frame` has all features and layers that `units` lists. Of the layers, these `groups`
    /// are uploaded. `mean_variance` belongs to the whole frame, so that all strips agree.
    pub(crate) fn upload(
        rec: &mut Recorder,
        frame: &'a Frame,
        mean_variance: Option<Vec3>,
        strip: &Strip,
        units: &Units,
        groups: Range<usize>,
        plan: &Plan,
    ) -> Result<Self> {
        let mut features = Vec::with_capacity(units.features.len());
        for (index, wanted) in units.features.iter().enumerate() {
            let Some(feature) = frame.features().iter().find(|feature| feature.name == wanted.name) else { continue };
            let map = Affine {
                factor: feature.unit_scale / wanted.unit_scale,
                shift: (feature.unit_offset - wanted.unit_offset) / wanted.unit_scale,
                fixed: &feature.misses,
            };
            let noise = if plan.reads_noise_of_feature(index) { Noise::Told } else { Noise::Absent };
            let source = Source::Host { signal: &feature.signal, strip: *strip, map, noise };
            let channels = feature.signal.mean.channels() as u32;
            features.push(FeatureInput {
                name: feature.name.clone(),
                kind: feature.kind,
                channels,
                source,
                pooled: None,
            });
        }
        let extent = IVec2::new(frame.extent().width as i32, strip.rows_with_halo() as i32);
        let samples = match frame.samples_per_pixel() {
            SamplesPerPixel::Unknown => GpuSamples::Uniform(0.0),
            SamplesPerPixel::Uniform(count) => GpuSamples::Uniform(*count),
            SamplesPerPixel::PerPixel(counts) => {
                let pixels = strip.pixels(counts.extent.width as usize);
                GpuSamples::PerPixel(upload_planes(
                    rec,
                    "samples per pixel",
                    &[Some((counts, Affine::scale(1.0)))],
                    &pixels,
                )?)
            }
        };
        let color = upload_signal(rec, "colour", frame.color(), strip, Affine::scale(units.exposure), Noise::Told)?;
        let payload = units.payload.upload(rec, frame, strip, groups)?;
        Ok(Self { extent, color, features, samples, mean_variance, payload })
    }
}

/// Map of values on their way to the GPU. With factor 1 and shift 0, values stay the same to the bit.
#[derive(Clone, Copy)]
struct Affine<'a> {
    factor: f32,
    shift: f32,
    /// Whether each pixel keeps its value; empty where no pixel does.
    fixed: &'a [bool],
}

impl Affine<'_> {
    fn scale(factor: f32) -> Self {
        Self { factor, shift: 0.0, fixed: &[] }
    }

    fn of(self, value: f32, pixel: usize) -> f32 {
        if self.fixed.get(pixel).is_some_and(|fixed| *fixed) { value } else { value * self.factor + self.shift }
    }
}

/// Whether halves and variance of a signal are uploaded with it.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Noise {
    Told,
    /// The noise is 0 or unknown, or no filter reads it.
    Absent,
}

fn upload_signal(
    rec: &mut Recorder,
    label: &str,
    signal: &Signal,
    strip: &Strip,
    map: Affine,
    noise: Noise,
) -> Result<GpuSignal> {
    let [half_spread, variance] =
        [&signal.half_spread, &signal.variance_of_mean].map(|image| image.as_ref().filter(|_| noise == Noise::Told));
    let factor = map.factor;
    let pixels = strip.pixels(signal.mean.extent.width as usize);
    let variance_of_mean = match variance {
        None => None,
        Some(variance) => {
            let label = format!("variance of {label}");
            Some(Arc::new(upload_planes(rec, &label, &[Some((variance, Affine::scale(factor * factor)))], &pixels)?))
        }
    };
    let planes = [Some((&signal.mean, map)), half_spread.map(|half_spread| (half_spread, Affine::scale(factor)))];
    Ok(GpuSignal {
        signal: Arc::new(upload_planes(rec, label, &planes, &pixels)?),
        variance_of_mean,
        has_halves: half_spread.is_some(),
    })
}

/// Uploads the same pixels of images, each to a plane of its own, mapped. A plane without an image is 0.
fn upload_planes(
    rec: &mut Recorder,
    label: &str,
    planes: &[Option<(&Image, Affine)>],
    pixels: &std::ops::Range<usize>,
) -> Result<Buffer> {
    let count = pixels.len();
    rec.upload_with(label, planes.len() * count * 4, |first, mut piece| {
        let mut first = first / 4;
        // A piece may hold the end of one plane and the beginning of the next.
        while !piece.is_empty() {
            let (plane, at) = (first / count, first % count);
            let (packed, rest) = piece.split_at_mut(4 * (count - at).min(piece.len() / 4));
            let packed_pixels = packed.len() / 4;
            if let Some((image, map)) = planes[plane] {
                let start = pixels.start + at;
                interleave(&image.planes, &(start..start + packed_pixels), map, packed);
            }
            first += packed_pixels;
            piece = rest;
        }
    })
}

/// Returns the variance of the colour's mean, averaged over a frame, as [`GpuFrame::mean_variance`]; `None` where
/// neither halves nor a variance tell it.
pub(crate) fn mean_variance(frame: &Frame, exposure: f32) -> Option<Vec3> {
    let signal = frame.color();
    let mean = |plane: &Vec<f32>, value: fn(f64) -> f64| {
        (plane.iter().map(|v| value(f64::from(*v))).sum::<f64>() / plane.len() as f64) as f32
    };
    let means: Vec<f32> = match (&signal.half_spread, &signal.variance_of_mean) {
        (Some(half_spread), _) => {
            half_spread.planes.iter().map(|plane| mean(plane, |spread| spread * spread)).collect()
        }
        (None, Some(variance)) => variance.planes.iter().map(|plane| mean(plane, |variance| variance)).collect(),
        (None, None) => return None,
    };
    let in_file_units = means.try_into().ok().map(Vec3::from_array);
    in_file_units.map(|variance| variance * exposure * exposure)
}

/// Number of pixels that are interleaved at one time: few enough to stay in the cache from the first channel to the
/// last.
const PIXELS_AT_ONCE: usize = 4096;

fn interleave(planes: &[Vec<f32>], pixels: &std::ops::Range<usize>, map: Affine, packed: &mut [f32]) {
    packed.par_chunks_mut(4 * PIXELS_AT_ONCE).zip(pixels.clone().into_par_iter().step_by(PIXELS_AT_ONCE)).for_each(
        |(packed, first)| {
            for (channel, plane) in planes.iter().enumerate() {
                for (to, pixel) in packed.chunks_exact_mut(4).zip(first..) {
                    to[channel] = map.of(plane[pixel], pixel);
                }
            }
        },
    );
}
