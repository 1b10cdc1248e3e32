//! Denoising by combining colour and feature filters (thesis chapter 8): Algorithm 1 as one straight function.

use std::sync::Arc;

use glam::IVec2;

use super::{GpuFeature, GpuFrame, GpuSignal, Params};
use crate::error::Result;
use crate::gpu::{Buffer, Recorder};
use crate::stage::candidate::{CandidateFilter, candidates};
use crate::stage::error::error_sure;
use crate::stage::feature::{Features, feature_pack};
use crate::stage::nlm::{Guide, Schedule, Weighting, nlm_filter};
use crate::stage::sample::sample_density;
use crate::stage::select::{select_blend, select_least};
use crate::stage::variance::{INPUT_SMOOTHING, RESIDUAL_SMOOTHING, variance_scale, variance_smooth};

/// Half width of the box over which variances are brought to scale (thesis 8.2: 21×21), in pixels.
pub(super) const SCALE_RADIUS: u32 = 10;

/// A filter by colour patches alone.
pub(super) struct Auxiliary {
    pub(super) window_radius: u32,
    pub(super) patch_radius: u32,
    pub(super) k: f32,
}

impl Auxiliary {
    fn guide<'a>(&self, signal: &'a Buffer, variance_of_mean: &'a Buffer, channels: u32) -> Guide<'a> {
        Guide { signal, variance_of_mean, channels, k: self.k, patch_radius: self.patch_radius, small_patch_radius: None }
    }
}

/// Algorithm 1 line 7.
pub(super) const PREFILTER: Auxiliary = Auxiliary { window_radius: 5, patch_radius: 3, k: 1.0 };
/// Line 19.
pub(super) const ERROR_SMOOTHING: Auxiliary = Auxiliary { window_radius: 1, patch_radius: 1, k: 1.0 };
/// Line 28.
pub(super) const SELECTION_SMOOTHING: Auxiliary = Auxiliary { window_radius: 5, patch_radius: 1, k: 1.0 };
/// Thesis 8.6: the error estimate is noisy, and filtered aggressively.
pub(super) const DENSITY_SMOOTHING: Auxiliary = Auxiliary { window_radius: 10, patch_radius: 1, k: 1.0 };

/// Intermediates that can be kept for inspection.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Intermediate {
    /// Scaled variance of the colour's mean.
    Variance,
    /// Prefiltered features and their residual variances.
    Features,
    /// FIRST, SECOND and THIRD.
    Candidates,
    /// dF_i/du_i of the candidates.
    Derivatives,
    /// SURE of the candidates, as computed and smoothed.
    Sure,
    /// Selection maps: binary, and as they entered the blend.
    Selection,
    /// The blend before the second pass.
    Pass1,
    /// Where the next samples pay most.
    Density,
}

impl Intermediate {
    /// All of them.
    pub const ALL: [Self; 8] = [Self::Variance, Self::Features, Self::Candidates, Self::Derivatives, Self::Sure, Self::Selection, Self::Pass1, Self::Density];

    /// Its name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Variance => "variance",
            Self::Features => "features",
            Self::Candidates => "candidates",
            Self::Derivatives => "derivatives",
            Self::Sure => "sure",
            Self::Selection => "selection",
            Self::Pass1 => "pass1",
            Self::Density => "density",
        }
    }
}

/// What the values of a kept plane mean, so that they can be brought back to the units of the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unit {
    /// As the colour.
    Color,
    /// As the square of the colour.
    ColorSquared,
    /// As the unit-range value of this feature.
    Feature(usize),
    /// As the square of the unit-range value of this feature.
    FeatureSquared(usize),
    /// A pure number.
    Number,
}

/// One plane that was kept.
#[derive(Debug)]
pub struct KeptPlane {
    /// Layer name.
    pub layer: String,
    /// Names of the channels in x, y, z.
    pub channels: Vec<String>,
    /// What the values mean.
    pub unit: Unit,
    /// Where it is.
    pub buffer: Arc<Buffer>,
    /// Which plane of the buffer.
    pub plane: u32,
}

/// What DFC knows of the true image, on the GPU.
#[derive(Debug)]
pub struct GpuEstimate {
    /// The denoised signal: mean, behind it the half spread (0 without halves).
    pub signal: Buffer,
    /// One plane: the shares of FIRST, SECOND and THIRD, and in w the blended error: the estimated Σ_i (F_i − true value)², before the second pass. May be negative.
    pub selection: Arc<Buffer>,
    /// Signal before the second pass, with Σ w in the w of the mean. `None`: there was no second pass, `signal` is it.
    pub pass1: Option<Arc<Buffer>>,
    /// What was asked for.
    pub kept: Vec<KeptPlane>,
}

/// Collects the planes that were asked for.
struct Keeper<'a> {
    wanted: &'a [Intermediate],
    kept: Vec<KeptPlane>,
}

impl Keeper<'_> {
    fn wants(&self, intermediate: Intermediate) -> bool {
        self.wanted.contains(&intermediate)
    }

    fn keep(&mut self, layer: impl Into<String>, channels: &[&str], unit: Unit, buffer: &Arc<Buffer>, plane: u32) {
        let channels = channels.iter().map(ToString::to_string).collect();
        self.kept.push(KeptPlane { layer: layer.into(), channels, unit, buffer: buffer.clone(), plane });
    }
}

const RGB: [&str; 3] = ["R", "G", "B"];
const BY_CANDIDATE: [&str; 3] = ["first", "second", "third"];

/// Algorithm 1. Degrades by what the frame knows of its noise: without halves the variances are taken as they are and there is no second pass; without sample variance
/// the smoothed two-buffer variance takes its place.
///
/// `progress` is called with the share of the work that is recorded.
///
/// # Errors
/// Those of recording.
pub fn dfc(
    rec: &mut Recorder,
    frame: GpuFrame,
    params: &Params,
    wanted: &[Intermediate],
    schedule: Schedule,
    progress: impl FnMut(&mut Recorder, f32) -> Result<()>,
) -> Result<GpuEstimate> {
    let GpuFrame { extent, color, features, samples } = frame;
    let weighting = params.weighting;
    let mut keeper = Keeper { wanted, kept: Vec::new() };

    // Sample variance scaling.
    let variance = input_variance(rec, extent, &color)?;
    let signal = &color.signal;
    if keeper.wants(Intermediate::Variance) {
        keeper.keep("scaled_variance", &RGB, Unit::ColorSquared, &variance, 0);
    }

    // Feature prefiltering.
    let features = prefilter(rec, extent, features, weighting, schedule, &mut keeper)?;

    // Candidate filters.
    let filter = CandidateFilter {
        window_radius: params.window_radius,
        color_k: params.color_k,
        first_patch_radius: params.first_patch_radius,
        second_patch_radius: params.second_patch_radius,
        feature_k: params.feature_k,
        feature_tau: params.feature_tau,
        feature_tau_third: params.feature_tau_third,
        weighting,
    };
    let candidates = candidates(rec, extent, signal, &variance, features.as_ref(), &filter, schedule, progress)?;
    drop(features);
    if keeper.wants(Intermediate::Candidates) {
        for (name, candidate) in BY_CANDIDATE.iter().zip(&candidates.signals) {
            keeper.keep(*name, &RGB, Unit::Color, candidate, 0);
        }
    }
    if keeper.wants(Intermediate::Derivatives) {
        for (plane, name) in (0..).zip(BY_CANDIDATE) {
            keeper.keep(format!("{name}_derivative"), &RGB, Unit::Number, &candidates.derivatives, plane);
        }
    }

    // Filtered SURE error estimates.
    let sure = Arc::new(error_sure(rec, extent, signal, &variance, &candidates)?);
    let guide = |filter: &Auxiliary| filter.guide(signal, &variance, 3);
    let errors = nlm_filter(rec, extent, &guide(&ERROR_SMOOTHING), &sure, 1, ERROR_SMOOTHING.window_radius, weighting, false, schedule)?;
    let errors = Arc::new(errors.planes);
    if keeper.wants(Intermediate::Sure) {
        keeper.keep("sure", &BY_CANDIDATE, Unit::ColorSquared, &sure, 0);
        keeper.keep("sure_smoothed", &BY_CANDIDATE, Unit::ColorSquared, &errors, 0);
    }

    // Binary selection maps.
    let selected = Arc::new(select_least(rec, extent, &errors, &candidates.derivatives)?);
    // Filter selection maps.
    let smoothed = nlm_filter(rec, extent, &guide(&SELECTION_SMOOTHING), &selected, 1, SELECTION_SMOOTHING.window_radius, weighting, false, schedule)?;
    // Candidate filter averaging.
    let blend = select_blend(rec, extent, &smoothed.planes, &selected, &errors, &sure, &variance, &candidates, params.guard)?;
    let selection = Arc::new(blend.selection);
    if keeper.wants(Intermediate::Selection) {
        keeper.keep("selected", &BY_CANDIDATE, Unit::Number, &selected, 0);
        keeper.keep("selection", &BY_CANDIDATE, Unit::Number, &selection, 0);
    }
    drop((candidates, smoothed, errors, sure, selected));

    // Adaptive sampling (thesis 8.6).
    if keeper.wants(Intermediate::Density) {
        let density = sample_density(rec, extent, &blend.signal, (!color.has_halves).then_some(&*selection), &samples)?;
        let smoothed = nlm_filter(rec, extent, &guide(&DENSITY_SMOOTHING), &density, 1, DENSITY_SMOOTHING.window_radius, weighting, false, schedule)?;
        keeper.keep("density", &["V"], Unit::Number, &Arc::new(smoothed.planes), 0);
    }

    // Second pass filtering.
    let Some(second_pass) = params.second_pass.filter(|_| color.has_halves) else {
        return Ok(GpuEstimate { signal: blend.signal, selection, pass1: None, kept: keeper.kept });
    };
    let upper_bound = second_pass.clamp_to_input.then_some(&*variance);
    let left_variance = variance_smooth(rec, extent, &blend.signal, RESIDUAL_SMOOTHING, upper_bound)?;
    let filter = Auxiliary { window_radius: second_pass.window_radius(params.window_radius), patch_radius: second_pass.patch_radius, k: second_pass.color_k };
    let guide = filter.guide(&blend.signal, &left_variance, 3);
    let pass2 = nlm_filter(rec, extent, &guide, &blend.signal, 2, filter.window_radius, weighting, false, schedule)?;
    let pass1 = Arc::new(blend.signal);
    if keeper.wants(Intermediate::Pass1) {
        keeper.keep("pass1", &RGB, Unit::Color, &pass1, 0);
    }
    Ok(GpuEstimate { signal: pass2.planes, selection, pass1: Some(pass1), kept: keeper.kept })
}

/// The variance of the mean as the filters want it (thesis 8.2), from what there is.
fn input_variance(rec: &mut Recorder, extent: IVec2, signal: &GpuSignal) -> Result<Arc<Buffer>> {
    let variance = match (&signal.variance_of_mean, signal.has_halves) {
        (Some(sample_variance), true) => variance_scale(rec, extent, &signal.signal, sample_variance, SCALE_RADIUS)?,
        (None, _) => variance_smooth(rec, extent, &signal.signal, INPUT_SMOOTHING, None)?,
        (Some(sample_variance), false) => return Ok(sample_variance.clone()),
    };
    Ok(Arc::new(variance))
}

/// Prefilters each feature by itself (Algorithm 1 lines 4 to 10) and packs them for the candidates. Features without any noise are taken as they are.
fn prefilter(
    rec: &mut Recorder,
    extent: IVec2,
    features: Vec<GpuFeature>,
    weighting: Weighting,
    schedule: Schedule,
    keeper: &mut Keeper,
) -> Result<Option<Features>> {
    if features.is_empty() {
        return Ok(None);
    }
    let channels: Vec<u32> = features.iter().map(|feature| feature.channels).collect();
    let packed = Features::take(rec, extent, &channels)?;
    // A group's triple clears the group, so it goes first.
    let mut order: Vec<_> = features.into_iter().enumerate().collect();
    order.sort_by_key(|(index, _)| packed.packing.slots[*index].single);
    for (index, GpuFeature { name, signal, channels }) in order {
        let noisy = signal.has_halves || signal.variance_of_mean.is_some();
        let (filtered, residual_variance) = if noisy {
            let variance = input_variance(rec, extent, &signal)?;
            let guide = PREFILTER.guide(&signal.signal, &variance, channels);
            let filtered = nlm_filter(rec, extent, &guide, &signal.signal, 2, PREFILTER.window_radius, weighting, !signal.has_halves, schedule)?;
            let residual = match filtered.residual_variance {
                Some(residual) => residual,
                None => variance_smooth(rec, extent, &filtered.planes, RESIDUAL_SMOOTHING, None)?,
            };
            (filtered.planes, residual)
        } else {
            // The half spread is 0, so this is 0.
            let residual = variance_smooth(rec, extent, &signal.signal, RESIDUAL_SMOOTHING, None)?;
            (signal.signal, residual)
        };
        feature_pack(rec, extent, &packed, packed.packing.slots[index], &filtered, &residual_variance)?;
        if keeper.wants(Intermediate::Features) {
            let (filtered, residual_variance) = (Arc::new(filtered), Arc::new(residual_variance));
            let names = &["x", "y", "z"][..channels as usize];
            keeper.keep(format!("{name}_prefiltered"), names, Unit::Feature(index), &filtered, 0);
            keeper.keep(format!("{name}_residual_variance"), names, Unit::FeatureSquared(index), &residual_variance, 0);
        }
    }
    Ok(Some(packed))
}
