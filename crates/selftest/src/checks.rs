//! The checks of every result, and their figures.

use std::path::Path;

use serde::{Deserialize, Serialize};
use stein::error::RequestCause;
use stein::parameters::Choice;
use stein::{Denoiser, DfcParams, Error, Estimate, Frame, GemParams, Gpu, Image, Method, NlmParams, Options};
use stein_metric::mean;
use stein_twin as bridge;

use crate::cases::{Case, Expected};
use crate::picture::Picture;
use crate::{Error as SuiteError, twin};

/// A method with the parameters that it is looked at with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Subject {
    /// DFC with its default parameters.
    Dfc,
    /// DFC to the letter of the published algorithm.
    DfcThesis,
    /// NLM with its default parameters.
    Nlm,
    /// GEM with its default parameters.
    Gem,
}

impl Subject {
    /// All of them, in the order of results.
    pub const ALL: [Self; 4] = [Self::Dfc, Self::DfcThesis, Self::Nlm, Self::Gem];

    /// Returns the names and meanings of [`Subject::ALL`].
    pub fn choices() -> [Choice; 4] {
        let about = |subject| match subject {
            Self::Dfc => "DFC with its default parameters.",
            Self::DfcThesis => "DFC to the letter of the published algorithm.",
            Self::Nlm => "NLM with its default parameters.",
            Self::Gem => "GEM with its default parameters.",
        };
        Self::ALL.map(|subject| Choice { name: subject.name(), documentation: about(subject).into() })
    }

    /// Returns the name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Dfc => "dfc",
            Self::DfcThesis => "dfc-thesis",
            Self::Nlm => "nlm",
            Self::Gem => "gem",
        }
    }

    /// Returns the method. GEM has scales in place of a window, and ignores the radius.
    fn method(self, window_radius: u32) -> Method {
        match self {
            Self::Dfc => DfcParams { window_radius, ..DfcParams::default() }.into(),
            Self::DfcThesis => DfcParams { window_radius, ..DfcParams::thesis() }.into(),
            Self::Nlm => NlmParams { window_radius, ..NlmParams::default() }.into(),
            Self::Gem => GemParams::default().into(),
        }
    }
}

/// One property of a result. Its figure is 0 or small if all is well, and has a bound.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Check {
    /// Whether the frame is made, or refused if it must be.
    Door,
    /// Number of values that are not finite, in everything that a caller gets.
    Finite,
    /// Change of the mean colour, relative to the mean magnitude of the input; the largest over the channels.
    Energy,
    /// Loss of the mean colour against the truth or the input, whichever is darker, relative to the mean magnitude of
    /// the truth.
    Dark,
    /// Error, divided by the error of the noisy input.
    Error,
    /// Number of values out of reach of a damaged pixel that change nevertheless.
    Reach,
    /// Distance to the float64 reference, in tolerances.
    Twin,
    /// Correction of the input at a sixteenth of the noise, divided by the correction at the full noise: the output
    /// must become the input as the noise vanishes.
    Limit,
    /// Number of values that differ from run to run, or if the image is processed in strips.
    Bits,
}

impl Check {
    /// All checks, in the order of results.
    pub const ALL: [Self; 9] = [
        Self::Door,
        Self::Finite,
        Self::Energy,
        Self::Dark,
        Self::Error,
        Self::Reach,
        Self::Twin,
        Self::Limit,
        Self::Bits,
    ];

    /// Returns the name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Door => "door",
            Self::Finite => "finite",
            Self::Energy => "energy",
            Self::Dark => "dark",
            Self::Error => "error",
            Self::Reach => "reach",
            Self::Twin => "twin",
            Self::Limit => "limit",
            Self::Bits => "bits",
        }
    }
}

/// Figure that a check found.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Figure {
    /// Check that found the figure.
    pub check: Check,
    /// Value of the figure; `None` if it is not finite.
    pub value: Option<f64>,
    /// Largest value within bounds.
    pub bound: f64,
    /// Whether the value is within bounds.
    pub passed: bool,
    /// Location of the worst value.
    #[serde(skip_serializing_if = "String::is_empty", default)]
    pub detail: String,
}

impl Figure {
    fn new(check: Check, value: f64, bound: f64, detail: String) -> Self {
        Self { check, value: finite_or_none(value), bound, passed: value <= bound, detail }
    }

    fn count(check: Check, count: usize, detail: String) -> Self {
        Self::new(check, count as f64, 0.0, detail)
    }
}

fn finite_or_none(value: f64) -> Option<f64> {
    Some(value).filter(|value| value.is_finite())
}

/// Figures of one case with one method.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Row {
    /// Name of the case.
    pub case: String,
    /// Name of the method; `all` for a frame that no method gets.
    pub method: String,
    /// Whether all figures are within bounds.
    pub passed: bool,
    /// Figures of the checks.
    pub figures: Vec<Figure>,
    /// Summary of the result; `None` without a result.
    pub result: Option<Summary>,
}

impl Row {
    fn new(case: &Case, method: &str, figures: Vec<Figure>, result: Option<Summary>) -> Self {
        Self {
            case: case.name.clone(),
            method: method.to_owned(),
            passed: figures.iter().all(|figure| figure.passed),
            figures,
            result,
        }
    }

    /// Returns the figure of a check; the worst one of several.
    pub fn figure(&self, check: Check) -> Option<&Figure> {
        let figures = self.figures.iter().filter(|figure| figure.check == check);
        figures.max_by(|a, b| a.value.unwrap_or(f64::INFINITY).total_cmp(&b.value.unwrap_or(f64::INFINITY)))
    }
}

/// Figures by which runs on two adapters are compared. Values are `None` if they are not finite, which JSON cannot
/// express.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// Checksum of the bits of the denoised colour.
    pub checksum: String,
    /// Mean of the denoised colour; the next three fields belong to the denoised colour as well.
    pub mean: Option<f64>,
    /// Root of the mean square.
    pub root_mean_square: Option<f64>,
    /// Least value.
    pub least: Option<f64>,
    /// Largest value.
    pub most: Option<f64>,
    /// Mean of the estimated error.
    pub error: Option<f64>,
    /// Mean number of pixels that took part in an average.
    pub weight_sum: Option<f64>,
}

impl Summary {
    fn new(estimate: &Estimate) -> Self {
        let values = || estimate.color.planes.iter().flatten();
        let count = values().count() as f64;
        // FNV-1a.
        let checksum = values().fold(0xcbf2_9ce4_8422_2325u64, |hash, value| {
            (hash ^ u64::from(value.to_bits())).wrapping_mul(0x0000_0100_0000_01b3)
        });
        let mean_of = |image: Option<&Image>| finite_or_none(image.map_or(0.0, |image| mean(&image.planes[0])));
        Self {
            checksum: format!("{checksum:016x}"),
            mean: finite_or_none(values().map(|value| f64::from(*value)).sum::<f64>() / count),
            root_mean_square: finite_or_none(
                (values().map(|value| f64::from(*value).powi(2)).sum::<f64>() / count).sqrt(),
            ),
            least: finite_or_none(values().fold(f32::INFINITY, |least, value| least.min(*value)).into()),
            most: finite_or_none(values().fold(f32::NEG_INFINITY, |most, value| most.max(*value)).into()),
            error: mean_of(estimate.error.as_ref()),
            weight_sum: mean_of(Some(&estimate.weight_sum)),
        }
    }
}

/// The device under test.
pub(super) struct DeviceUnderTest<'a> {
    pub(super) gpu: &'a Gpu,
    /// Memory limit in bytes that the user chose.
    pub(super) max_memory: Option<u64>,
    /// Folder for files.
    pub(super) folder: &'a Path,
}

/// Frames of a case, which all methods share.
struct Prepared {
    picture: Picture,
    frame: Frame,
    beside: Vec<Frame>,
    /// The frame with less and less noise, each time a sixteenth of the noise before.
    calmer: Vec<Frame>,
    /// The frame before it was damaged.
    sound: Option<Frame>,
}

/// Factors of the noise: a sixteenth, and a sixteenth of a sixteenth.
const CALMER: [f64; 2] = [1.0 / 16.0, 1.0 / 256.0];

/// Distance up to which two pixels without noise are taken for one, for values of the order of 1: √(25·3·7²·10⁻¹⁰).
/// Smaller corrections do not count.
const INDISTINCT: f64 = 6.1e-4;

impl DeviceUnderTest<'_> {
    /// Runs all checks of a case with each of the methods.
    ///
    /// # Errors
    /// A failure of the device: what it does from then on says nothing about it.
    pub(super) fn run(&self, case: &Case, subjects: &[Subject]) -> Result<Vec<Row>, SuiteError> {
        let subjects = subjects.iter().filter(|subject| case.methods.contains(subject));
        let prepared = self.prepare(case);
        if let Expected::Refusal = &case.expected {
            let figure = match prepared {
                Ok(_) => Figure::count(Check::Door, 1, "the frame was taken".into()),
                Err(error @ Error::Request(RequestCause::NoUsableValue { .. })) => {
                    Figure::count(Check::Door, 0, error.to_string())
                }
                Err(error) => Figure::count(Check::Door, 1, error.to_string()),
            };
            return Ok(vec![Row::new(case, "all", vec![figure], None)]);
        }
        match prepared {
            Ok(prepared) => subjects.map(|subject| self.look_at(case, &prepared, *subject)).collect(),
            Err(error) => Ok(vec![Row::new(case, "all", vec![Figure::count(Check::Door, 1, error.to_string())], None)]),
        }
    }

    fn prepare(&self, case: &Case) -> stein::Result<Prepared> {
        let picture = case.picture(1.0)?;
        let frame = |picture: &Picture| picture.frame(self.folder);
        Ok(Prepared {
            frame: frame(&picture)?,
            beside: case.beside.iter().map(|beside| frame(&beside(1.0))).collect::<stein::Result<_>>()?,
            calmer: if case.has_limit {
                CALMER.into_iter().map(|noise| frame(&case.picture(noise)?)).collect::<stein::Result<_>>()?
            } else {
                Vec::new()
            },
            sound: case.damage.as_ref().map(|_| frame(&case.sound(1.0)?)).transpose()?,
            picture,
        })
    }

    fn look_at(&self, case: &Case, prepared: &Prepared, subject: Subject) -> Result<Row, SuiteError> {
        match self.figures(case, prepared, subject) {
            Ok((figures, estimate)) => Ok(Row::new(case, subject.name(), figures, Some(Summary::new(&estimate)))),
            Err(error @ Error::Device(_)) => {
                Err(SuiteError::Device { case: case.name.clone(), method: subject.name(), error: Box::new(error) })
            }
            // The error is a shader's: an unusable input would not have become a frame.
            Err(error) => {
                Ok(Row::new(case, subject.name(), vec![Figure::count(Check::Finite, 1, error.to_string())], None))
            }
        }
    }

    fn figures(&self, case: &Case, prepared: &Prepared, subject: Subject) -> stein::Result<(Vec<Figure>, Estimate)> {
        let method = subject.method(case.window_radius);
        let denoiser = Denoiser::new(self.gpu, method)?;
        let denoiser = if let Some(bytes) = self.max_memory { denoiser.with_max_memory(bytes) } else { denoiser };
        let Prepared { picture, frame, beside, calmer, sound } = prepared;
        let frames: Vec<&Frame> = std::iter::once(frame).chain(beside).collect();
        let window = |denoiser: &Denoiser| denoiser.denoise_window(&frames, 0, Options::default());
        let bound = |check| case.bound(subject, check);

        let estimate = window(&denoiser)?;
        let with_everything =
            denoiser.denoise_window(&frames, 0, Options { keep: method.intermediates(), ..Options::default() })?;
        let mut figures = vec![finite(&estimate, &with_everything), energy(frame, &estimate, bound(Check::Energy))];
        if let Some(truth) = &picture.truth {
            figures.push(dark(frame, &estimate, truth, bound(Check::Dark)));
            figures.push(error(frame, &estimate, truth, picture.unit, bound(Check::Error)));
        }
        if let (Some(damage), Some(sound)) = (&case.damage, sound) {
            figures.extend(if same_units(frame, sound) {
                reach(&estimate, &denoiser.denoise(sound)?, &damage.pixels, denoiser.reach()? as usize)
            } else {
                (!damage.moves_units).then(|| {
                    Figure::count(
                        Check::Reach,
                        1,
                        "the damage changes the unit of the colour or the range of a feature".into(),
                    )
                })
            });
        }
        if beside.is_empty() {
            let parts = twin::compare(frame, &method, &with_everything);
            // NaN is the worst of all.
            if let Some(worst) = parts.into_iter().max_by(|a, b| a.off.total_cmp(&b.off)) {
                figures.push(Figure::new(
                    Check::Twin,
                    worst.off,
                    bound(Check::Twin),
                    format!("{}, {}", worst.name, worst.detail),
                ));
            }
        }
        if !calmer.is_empty() {
            let of = |frame: &Frame, estimate: &Estimate| correction(frame, estimate, picture);
            let mut corrections = vec![of(frame, &estimate)];
            for frame in calmer {
                corrections.push(of(frame, &denoiser.denoise(frame)?));
            }
            let ratio = |pair: &[f64]| pair[1] / pair[0].max(INDISTINCT);
            let worst = corrections.windows(2).map(ratio).fold(0.0, f64::max);
            figures.push(Figure::new(
                Check::Limit,
                worst,
                bound(Check::Limit),
                format!("corrections of {corrections:.5?}"),
            ));
        }
        if case.is_repeated {
            figures.push(Figure::count(
                Check::Bits,
                differing(&window(&denoiser)?, &estimate, |_| true),
                "in another run".into(),
            ));
        }
        if case.in_strips {
            let in_strips = window(&cut_into_strips(&denoiser, &frames)?)?;
            let differing = differing(&in_strips, &estimate, |_| true) + usize::from(in_strips.strips < 2);
            figures.push(Figure::count(Check::Bits, differing, format!("in {} strips", in_strips.strips)));
        }
        Ok((figures, estimate))
    }
}

/// The denoiser with so little memory that it cuts the frames into several strips, or with hardly any.
fn cut_into_strips(denoiser: &Denoiser, frames: &[&Frame]) -> stein::Result<Denoiser> {
    let requirements = |denoiser: &Denoiser| denoiser.requirements(frames, 0, &Options::default());
    let mut bytes = requirements(denoiser)?.peak_bytes;
    loop {
        let limited = denoiser.clone().with_max_memory(bytes);
        if bytes == 0 || requirements(&limited)?.strips > 1 {
            return Ok(limited);
        }
        bytes -= bytes.div_ceil(40);
    }
}

/// Lists all images that a caller gets.
fn images(estimate: &Estimate) -> Vec<(&'static str, &Image)> {
    let optional =
        [("half spread", &estimate.half_spread), ("error", &estimate.error), ("selection", &estimate.selection)];
    let optional = optional.into_iter().filter_map(|(name, image)| Some((name, image.as_ref()?)));
    [("colour", &estimate.color), ("Σ w", &estimate.weight_sum)].into_iter().chain(optional).collect()
}

fn finite(estimate: &Estimate, with_everything: &Estimate) -> Figure {
    // Leaves out all intermediates but one, because squares of spikes may overflow in the errors of candidates that do
    // not take part.
    let density = with_everything
        .layers
        .iter()
        .filter(|layer| ["density", "reduction"].contains(&layer.name.as_str()))
        .map(|layer| ("density", &layer.image));
    let bad = |image: &Image| image.planes.iter().flatten().filter(|value| !value.is_finite()).count();
    let found: Vec<_> = images(estimate)
        .into_iter()
        .chain(density)
        .map(|(name, image)| (name, bad(image)))
        .filter(|(_, bad)| *bad > 0)
        .collect();
    let names = found.iter().map(|(name, bad)| format!("{bad} of {name}")).collect::<Vec<_>>().join(", ");
    Figure::count(Check::Finite, found.iter().map(|(_, bad)| bad).sum(), names)
}

fn energy(frame: &Frame, estimate: &Estimate, bound: f64) -> Figure {
    let before = &frame.color().mean;
    let size = magnitude(before);
    let change = before
        .planes
        .iter()
        .zip(&estimate.color.planes)
        .map(|(before, after)| (mean(after) - mean(before)).abs())
        .fold(0.0, f64::max);
    Figure::new(Check::Energy, if change == 0.0 { 0.0 } else { change / size }, bound, String::new())
}

fn dark(frame: &Frame, estimate: &Estimate, truth: &Image, bound: f64) -> Figure {
    let size = magnitude(truth);
    // Noise may have darkened the input below the truth.
    let least = |truth: &Vec<f32>, input: &Vec<f32>| mean(truth).min(mean(input));
    let planes = truth.planes.iter().zip(&frame.color().mean.planes).zip(&estimate.color.planes);
    let lost = planes.map(|((truth, input), after)| least(truth, input) - mean(after)).fold(0.0, f64::max);
    Figure::new(Check::Dark, if lost == 0.0 { 0.0 } else { lost / size }, bound, String::new())
}

fn error(frame: &Frame, estimate: &Estimate, truth: &Image, unit: f64, bound: f64) -> Figure {
    let (noisy, denoised) =
        (relative_square(&frame.color().mean, truth, unit), relative_square(&estimate.color, truth, unit));
    // An input without error may change by differences that cannot be told apart.
    Figure::new(
        Check::Error,
        denoised / (noisy + INDISTINCT * INDISTINCT),
        bound,
        format!("relative MSE {denoised:.3e}, of the input {noisy:.3e}"),
    )
}

/// Returns by how much the input was changed, relative to the truth.
fn correction(frame: &Frame, estimate: &Estimate, picture: &Picture) -> f64 {
    let input = &frame.color().mean;
    relative_square_by(&estimate.color, input, picture.truth.as_ref().unwrap_or(input), picture.unit).sqrt()
}

/// Returns the mean over pixels and channels of (x − ref)²/(ref² + 0.01·unit²).
fn relative_square(image: &Image, reference: &Image, unit: f64) -> f64 {
    relative_square_by(image, reference, reference, unit)
}

fn relative_square_by(image: &Image, reference: &Image, size: &Image, unit: f64) -> f64 {
    let in_unit =
        |image: &Image| image.planes.iter().flatten().map(|value| f64::from(*value) / unit).collect::<Vec<_>>();
    let (image, reference, size) = (in_unit(image), in_unit(reference), in_unit(size));
    let relative = image
        .iter()
        .zip(&reference)
        .zip(&size)
        .map(|((x, reference), size)| (x - reference).powi(2) / (size.powi(2) + 0.01));
    relative.sum::<f64>() / image.len() as f64
}

/// Counts the values out of reach that the damage changed; `None` if no pixel is out of reach, or the damage is
/// everywhere.
fn reach(damaged: &Estimate, sound: &Estimate, pixels: &[(usize, usize)], reach: usize) -> Option<Figure> {
    let extent = damaged.color.extent;
    let width = extent.width as usize;
    if pixels.is_empty() {
        return None;
    }
    let far = |pixel: usize| {
        pixels.iter().all(|(x, y)| (pixel % width).abs_diff(*x).max((pixel / width).abs_diff(*y)) > reach)
    };
    let count = (0..extent.pixels()).filter(|pixel| far(*pixel)).count();
    (count > 0).then(|| {
        Figure::count(
            Check::Reach,
            differing(damaged, sound, far),
            format!("in {count} pixels that are more than {reach} away"),
        )
    })
}

/// Counts the values that are not the same to the bit.
fn differing(a: &Estimate, b: &Estimate, of: impl Fn(usize) -> bool) -> usize {
    let (a, b) = (images(a), images(b));
    let differing = |(a, b): (&Image, &Image)| {
        let planes = a.planes.iter().zip(&b.planes);
        planes
            .map(|(a, b)| {
                a.iter().zip(b).enumerate().filter(|(pixel, (a, b))| of(*pixel) && a.to_bits() != b.to_bits()).count()
            })
            .sum::<usize>()
    };
    let images = a.iter().zip(&b).map(|((_, a), (_, b))| differing((a, b)));
    images.sum::<usize>() + a.len().abs_diff(b.len())
}

/// Returns the mean magnitude of the brightest channel, so that a channel without light may get some.
fn magnitude(image: &Image) -> f64 {
    image
        .planes
        .iter()
        .map(|plane| plane.iter().map(|value| f64::from(value.abs())).sum::<f64>() / plane.len() as f64)
        .fold(0.0, f64::max)
}

/// Whether both frames have the same units on the device: a pixel that changes the units has an influence on all
/// others.
fn same_units(a: &Frame, b: &Frame) -> bool {
    let ranges = |frame: &Frame| {
        frame.features().iter().map(|feature| (feature.unit_scale, feature.unit_offset)).collect::<Vec<_>>()
    };
    bridge::exposure(a) == bridge::exposure(b) && ranges(a) == ranges(b)
}
