//! Denoising by combining colour and feature filters (thesis chapter 8): Algorithm 1 from above to below, what is
//! prepared, pass 1, pass 2, the error of the result.

mod kernels;
mod params;
mod plan;

use std::sync::Arc;

use glam::IVec2;

use super::common::{Auxiliary, guide_variance, with_input_kept};
use super::estimate::{GpuEstimate, Intermediate, Keeper, Lane, RGB, Shares, Unit};
use super::frame::FeatureInput;
use super::noise::estimate_noise;
use super::plan::{Plan, Step};
use super::spikes::Found;
use super::{FrameInput, GpuSignal, Spikes};
use crate::error::Result;
use crate::gpu::{Buffer, Recorder};
use crate::stage::candidate::{CandidateBeside, CandidateFilter, Candidates, CandidatesInTime, Needed, candidates};
use crate::stage::candidate_set::CandidateSet;
use crate::stage::error::{
    ErrorParts, MadeOf, error_blend, error_blend_more, error_difference, error_spikes, error_sure,
};
use crate::stage::exact::Region;
use crate::stage::feature::{Features, feature_pack};
use crate::stage::nlm::{Beside, Guide, Lanes, Payload, Schedule, nlm_filter};
use crate::stage::sample::{GpuSamples, sample_density};
use crate::stage::select::{
    Evidence, HARM, Noisy, Significance, WithColorOnly, select_blend, select_color_only, select_frames, select_least,
    select_pass, select_share,
};
use crate::stage::variance::{BoxWeight, Floor, RESIDUAL_SMOOTHING, variance_floor, variance_smooth};

pub(super) use kernels::kernels;
pub use params::{DfcParams, SecondPass};
pub(super) use plan::plan;

/// Algorithm 1 line 7.
const PREFILTER: Auxiliary = Auxiliary { window_radius: 5, patch_radius: 3, k: 1.0 };
/// Line 19.
const ERROR_SMOOTHING: Auxiliary = Auxiliary { window_radius: 1, patch_radius: 1, k: 1.0 };
/// Line 28.
const SELECTION_SMOOTHING: Auxiliary = Auxiliary { window_radius: 5, patch_radius: 1, k: 1.0 };
/// Thesis 8.6: the error estimate is noisy, and filtered aggressively.
const DENSITY_SMOOTHING: Auxiliary = Auxiliary { window_radius: 10, patch_radius: 1, k: 1.0 };

pub(super) const INTERMEDIATES: [Intermediate; 9] = [
    Intermediate::Spikes,
    Intermediate::Variance,
    Intermediate::Features,
    Intermediate::Candidates,
    Intermediate::Derivatives,
    Intermediate::Sure,
    Intermediate::Selection,
    Intermediate::Pass1,
    Intermediate::Density,
];

const BY_CANDIDATE: [&str; 3] = CandidateSet::NAMES;

/// Runs Algorithm 1. Without halves, it takes the variances as they are and has no second pass. Without a sample
/// variance, the pooled or smoothed two-buffer variance takes its place. Steps that the plan leaves out do not run.
///
/// The frames `beside` must have the units and features of `frame`. `progress` receives the share of the work that is
/// recorded, 0 to 1.
///
/// # Errors
/// Errors of the recorder.
pub(crate) fn dfc(
    rec: &mut Recorder,
    frame: FrameInput,
    beside: Vec<FrameInput>,
    params: &DfcParams,
    plan: &Plan,
    schedule: Schedule,
    progress: impl FnMut(&mut Recorder, f32) -> Result<()>,
) -> Result<GpuEstimate> {
    let mut keeper = Keeper::new(&plan.keep);
    let work = Work { params, plan, schedule, wanted: Wanted::default() };
    let mut prepared = Prepared::new(rec, frame, beside, work, &mut keeper)?;
    let Pass1 { candidates, selection, color_only, blend: pass1 } =
        Pass1::new(rec, &mut prepared, work, &mut keeper, progress)?;
    let Prepared { extent, color, variance, spikes, samples, .. } = &prepared;
    let extent = *extent;

    // Second pass filtering.
    let mut result = pass1.clone();
    if let Some(pass2) = Pass2::new(rec, extent, &pass1, variance, work)? {
        keeper.keep(Intermediate::Pass1, "pass1", &RGB, Unit::Color, &pass1, 0);
        result = pass2.result;
    }

    // What is left of the error, of which SURE tells little more than the order of the candidates.
    let mut error = None;
    if plan.begins(rec, Step::Error) {
        let made_of = match &selection {
            Shares::Maps(maps) => MadeOf::Shares(maps),
            Shares::Only(only) => MadeOf::Only(*only),
        };
        let parts = ErrorParts::measured(color.has_halves, params.several_can_win());
        let mut errors = error_blend(rec, extent, &result, variance, &candidates, made_of, parts)?;
        if let Some(ColorOnly { candidates, shares }) = &color_only {
            errors = error_blend_more(rec, extent, &result, variance, candidates, shares, parts, errors)?;
        }
        if let Some(spikes) = spikes.as_ref().filter(|_| params.spikes == Spikes::Spread) {
            errors = error_spikes(rec, extent, errors, &spikes.spikes, parts)?;
        }
        error = Some(Arc::new(errors));
    }
    drop((candidates, color_only));

    // Adaptive sampling (thesis 8.6).
    if plan.begins(rec, Step::Density) {
        let density = sample_density(rec, extent, &pass1, error.as_deref().filter(|_| !color.has_halves), samples)?;
        let density = prepared.smooth(rec, Step::Density, &density, &DENSITY_SMOOTHING, work)?;
        keeper.keep(Intermediate::Density, "density", &["V"], Unit::Number, &Arc::new(density), 0);
    }

    let error = error.map(|buffer| Lane { buffer, plane: 0, component: 0 });
    Ok(GpuEstimate {
        signal: with_input_kept(rec, extent, color, spikes.as_ref(), result, error.as_ref(), plan)?,
        error,
        // Σ w is that of pass 1.
        weight_sum: Lane { buffer: pass1, plane: 0, component: 3 },
        selection: Some(selection),
        spikes: spikes.as_ref().map(|found| found.spikes.clone()),
        kept: keeper.into_kept(),
    })
}

/// Parameters and plan of the work on a frame.
#[derive(Clone, Copy)]
struct Work<'a> {
    params: &'a DfcParams,
    plan: &'a Plan,
    schedule: Schedule,
    wanted: Wanted,
}

impl Work<'_> {
    fn is_grey(&self) -> bool {
        !self.plan.runs(&Step::Channels)
    }
}

/// Region to compute for each output; `None` computes the whole frame.
#[derive(Clone, Copy, Default)]
struct Wanted {
    /// Region of the prefiltered features.
    features: Option<Region>,
    /// Region of the candidates and of the selection among them.
    candidates: Option<Region>,
    /// Region of the second pass.
    result: Option<Region>,
}

fn candidate_filter(params: &DfcParams) -> CandidateFilter {
    CandidateFilter {
        window_radius: params.window_radius,
        color_k: params.color_k,
        first_patch_radius: params.first_patch_radius,
        second_patch_radius: params.second_patch_radius,
        feature_k: params.feature_k,
        feature_tau: params.feature_tau,
        feature_tau_third: params.feature_tau_third,
        weighting: params.weighting,
    }
}

/// Input of the candidates.
struct Prepared {
    extent: IVec2,
    /// Colour of the own frame, without spikes.
    color: GpuSignal,
    variance: Arc<Buffer>,
    /// Prefiltered features of the own frame, then of the frames beside; empty without features.
    features: Vec<Features>,
    /// Spikes and lights that were taken out of the own frame.
    spikes: Option<Found>,
    samples: GpuSamples,
    colors_beside: Vec<GpuSignal>,
    variances_beside: Vec<Arc<Buffer>>,
}

impl Prepared {
    fn new(
        rec: &mut Recorder,
        frame: FrameInput,
        beside: Vec<FrameInput>,
        work: Work,
        keeper: &mut Keeper,
    ) -> Result<Self> {
        let Work { params, plan, .. } = work;
        let FrameInput { extent, mut color, mut features, samples, .. } = frame;
        // Space-time filtering (8.6): the window gains frames. What belongs to a pixel comes from its own frame.
        let (mut colors_beside, mut features_beside): (Vec<_>, Vec<_>) =
            beside.into_iter().map(|frame| (frame.color, frame.features)).unzip();

        // What is known of the noise.
        if plan.begins(rec, Step::Noise) {
            estimate_noise(rec, extent, &mut color, &mut features, params.pooling())?;
            for (color, features) in colors_beside.iter_mut().zip(&mut features_beside) {
                estimate_noise(rec, extent, color, features, params.pooling())?;
            }
        }

        // Feature prefiltering.
        let features =
            prefilter(rec, extent, std::iter::once(features).chain(features_beside).collect(), work, keeper)?;

        // Spikes.
        let mut spikes = None;
        if plan.begins(rec, Step::Spikes) {
            (color, spikes) = params.spikes.repair(rec, extent, color, features.first())?;
            for (index, color) in colors_beside.iter_mut().enumerate() {
                *color = params.spikes.repair(rec, extent, color.clone(), features.get(1 + index))?.0;
            }
        }
        if let Some(spikes) = &spikes {
            keeper.keep(Intermediate::Spikes, "spikes", &RGB, Unit::Color, &spikes.spikes, 0);
        }

        // Sample variance scaling.
        plan.begins(rec, Step::Variance);
        let variance_of = |rec: &mut Recorder, color: &GpuSignal| {
            guide_variance(rec, extent, color, params.box_weight, Floor::of_color(params.keep_clean))
        };
        let variance = variance_of(rec, &color)?;
        keeper.keep(Intermediate::Variance, "scaled_variance", &RGB, Unit::ColorSquared, &variance, 0);
        let variances_beside = colors_beside.iter().map(|color| variance_of(rec, color)).collect::<Result<Vec<_>>>()?;
        Ok(Self { extent, color, variance, features, spikes, samples, colors_beside, variances_beside })
    }

    /// Drops the buffers that only the candidates need.
    fn forget_neighbours(&mut self) {
        self.features.clear();
        self.colors_beside.clear();
        self.variances_beside.clear();
    }

    /// Smooths a plane with weights from the colour.
    fn smooth(
        &self,
        rec: &mut Recorder,
        step: Step,
        payload: &Buffer,
        filter: &Auxiliary,
        work: Work,
    ) -> Result<Buffer> {
        let Work { params, plan, schedule, wanted } = work;
        let guide = filter.guide(&self.color.signal, &self.variance, 3);
        let guide = Guide { grey: work.is_grey(), exact: plan.exact(&step), wanted: wanted.candidates, ..guide };
        plan.begins(rec, step);
        let filtered = nlm_filter(
            rec,
            self.extent,
            &guide,
            &Payload::new(payload, 1),
            filter.window_radius,
            params.weighting,
            false,
            schedule,
        )?;
        Ok(filtered.planes)
    }
}

/// The candidates, and their average by the selection maps.
struct Pass1 {
    candidates: Candidates,
    /// The candidates' shares in the blend.
    selection: Shares,
    /// Filter by the colour only, if it takes part in the blend.
    color_only: Option<ColorOnly>,
    blend: Arc<Buffer>,
}

/// The filter by the colour only: SECOND without features.
struct ColorOnly {
    candidates: Candidates,
    /// Its share in the blend, in y of one plane.
    shares: Arc<Buffer>,
}

const SECOND_ONLY: CandidateSet = CandidateSet { first: false, second: true, third: false };

impl Pass1 {
    /// Makes the candidates and blends them. Drops the neighbours' buffers from `prepared`.
    fn new(
        rec: &mut Recorder,
        prepared: &mut Prepared,
        work: Work,
        keeper: &mut Keeper,
        progress: impl FnMut(&mut Recorder, f32) -> Result<()>,
    ) -> Result<Self> {
        let Work { params, plan, schedule, wanted } = work;
        let Prepared { extent, color, variance, features, colors_beside, variances_beside, .. } = &*prepared;
        let (extent, signal) = (*extent, &color.signal);

        // Candidate filters.
        plan.begins(rec, Step::Candidates);
        let neighbours = colors_beside.iter().zip(variances_beside).enumerate();
        let neighbours = neighbours.map(|(index, (color, variance_of_mean))| CandidateBeside {
            signal: &color.signal,
            variance_of_mean,
            features: features.get(1 + index),
        });
        let neighbours: Vec<_> = neighbours.collect();
        let needed = Needed {
            candidates: plan.candidates(),
            derivatives: plan.runs(&Step::Derivatives),
            half_spread: plan.runs(&Step::HalfSpread),
            alone: plan.runs(&Step::Frames),
            channels: plan.runs(&Step::Channels),
            exact: plan.exact(&Step::Candidates),
            wanted: wanted.candidates,
        };
        let CandidatesInTime { together: candidates, alone } = candidates(
            rec,
            extent,
            signal,
            variance,
            features.first(),
            &neighbours,
            &candidate_filter(params),
            needed,
            schedule,
            progress,
        )?;
        if let Some(alone) = alone.as_ref().filter(|_| plan.begins(rec, Step::Frames)) {
            select_frames(rec, extent, Noisy { signal, variance_of_mean: variance }, alone, &candidates, HARM)?;
        }
        drop(alone);
        prepared.forget_neighbours();
        let Prepared { color, variance, .. } = &*prepared;
        let signal = &color.signal;
        for (plane, (name, candidate)) in (0..).zip(BY_CANDIDATE.into_iter().zip(&candidates.signals)) {
            let Some(candidate) = candidate else { continue };
            keeper.keep(Intermediate::Candidates, name, &RGB, Unit::Color, candidate, 0);
            if let Some(derivatives) = &candidates.derivatives {
                keeper.keep(
                    Intermediate::Derivatives,
                    format!("{name}_derivative"),
                    &RGB,
                    Unit::Number,
                    derivatives,
                    plane,
                );
            }
        }

        // Filtered SURE error estimates.
        let mut judged = None;
        if plan.begins(rec, Step::Sure) {
            let sure = Arc::new(error_sure(rec, extent, signal, variance, &candidates, params.covariance)?);
            let errors = Arc::new(prepared.smooth(rec, Step::SureSmoothing, &sure, &ERROR_SMOOTHING, work)?);
            keeper.keep(Intermediate::Sure, "sure", &BY_CANDIDATE, Unit::ColorSquared, &sure, 0);
            keeper.keep(Intermediate::Sure, "sure_smoothed", &BY_CANDIDATE, Unit::ColorSquared, &errors, 0);
            judged = Some((sure, errors));
        }

        let Some((sure, errors)) = judged.as_ref().filter(|_| plan.begins(rec, Step::Selection)) else {
            // Nothing to choose from.
            let Some((only, candidate)) = candidates.first_of_all() else {
                unreachable!("a plan holds at least one candidate")
            };
            return Ok(Self { blend: candidate.clone(), selection: Shares::Only(only), color_only: None, candidates });
        };
        // Binary selection maps.
        let selected = Arc::new(select_least(rec, extent, errors, &candidates)?);
        // Filter selection maps.
        let smoothed = prepared.smooth(rec, Step::SelectionSmoothing, &selected, &SELECTION_SMOOTHING, work)?;
        // Candidate filter averaging.
        plan.begins(rec, Step::Blend);
        let evidence =
            Evidence { selected: &selected, errors, sure, variance_of_mean: variance, candidates: &candidates };
        let selection = Arc::new(select_share(rec, extent, smoothed, evidence, params.guard)?);
        let mut blend = Arc::new(select_blend(rec, extent, &selection, &candidates)?);
        let mut color_only = None;
        if plan.begins(rec, Step::ColorOnly) {
            let (found, blended) = ColorOnly::new(rec, prepared, &candidates, &selection, &blend, work, keeper)?;
            (color_only, blend) = (Some(found), blended);
        }
        keeper.keep(Intermediate::Selection, "selected", &BY_CANDIDATE, Unit::Number, &selected, 0);
        keeper.keep(Intermediate::Selection, "selection", &BY_CANDIDATE, Unit::Number, &selection, 0);
        Ok(Self { candidates, selection: Shares::Maps(selection), color_only, blend })
    }
}

impl ColorOnly {
    /// Filters the own frame by its colour, and returns the filter with the new blend. Lowers the shares of the
    /// candidates in `joint` by the share of this filter.
    fn new(
        rec: &mut Recorder,
        prepared: &Prepared,
        joint: &Candidates,
        selection: &Buffer,
        blend: &Buffer,
        work: Work,
        keeper: &mut Keeper,
    ) -> Result<(Self, Arc<Buffer>)> {
        let Work { params, plan, schedule, wanted } = work;
        let Prepared { extent, color, variance, .. } = prepared;
        let (extent, signal) = (*extent, &color.signal);
        let needed = Needed {
            candidates: SECOND_ONLY,
            derivatives: true,
            half_spread: plan.runs(&Step::HalfSpread),
            alone: false,
            channels: plan.runs(&Step::Channels),
            exact: plan.exact(&Step::Candidates),
            wanted: wanted.candidates,
        };
        let alone = candidates(
            rec,
            extent,
            signal,
            variance,
            None,
            &[],
            &candidate_filter(params),
            needed,
            schedule,
            |_, _| Ok(()),
        )?
        .together;
        let Some((_, filtered)) = alone.first_of_all() else { unreachable!("SECOND takes part") };
        let differences =
            error_difference(rec, extent, signal, variance, blend, selection, joint, &alone, params.covariance)?;
        let WithColorOnly { blended, shares } =
            select_color_only(rec, extent, &differences, blend, filtered, selection, Significance::MEASURED)?;
        let shares = Arc::new(shares);
        keeper.keep(Intermediate::Candidates, "color_only", &RGB, Unit::Color, filtered, 0);
        keeper.keep(Intermediate::Selection, "color_only_share", &["V"], Unit::Number, &shares, 0);
        Ok((Self { candidates: alone, shares }, Arc::new(blended)))
    }
}

/// Result of the second pass.
struct Pass2 {
    filter: Auxiliary,
    /// Variance of the noise that pass 1 left.
    left_variance: Buffer,
    /// Pass 1 filtered by itself.
    filtered: Arc<Buffer>,
    /// `filtered`, but pass 1 where the change would exceed the limit.
    result: Arc<Buffer>,
}

impl Pass2 {
    /// Filters pass 1. Returns `None` if the plan has no second pass.
    fn new(rec: &mut Recorder, extent: IVec2, pass1: &Buffer, variance: &Buffer, work: Work) -> Result<Option<Self>> {
        let Work { params, plan, schedule, wanted } = work;
        let Some(second_pass) = params.second_pass.filter(|_| plan.begins(rec, Step::SecondPass)) else {
            return Ok(None);
        };
        let SecondPass { clamp_to_input, most_sigmas, .. } = second_pass;
        let left_variance =
            variance_smooth(rec, extent, pass1, RESIDUAL_SMOOTHING, clamp_to_input.then_some(variance))?;
        let left_variance = variance_floor(rec, extent, pass1, &left_variance, Floor::of_color(params.keep_clean))?;
        let (filter, grey) = (second_pass_filter(&second_pass, params.window_radius), work.is_grey());
        let guide = Guide {
            grey,
            exact: plan.exact(&Step::SecondPass),
            wanted: wanted.result,
            ..filter.guide(pass1, &left_variance, 3)
        };
        let payload = Payload { lanes: if grey { Lanes::Grey } else { Lanes::All }, ..Payload::new(pass1, 2) };
        let filtered = Arc::new(
            nlm_filter(rec, extent, &guide, &payload, filter.window_radius, params.weighting, false, schedule)?.planes,
        );
        let result = match most_sigmas {
            Some(sigmas) => Arc::new(select_pass(rec, extent, pass1, &filtered, variance, sigmas)?),
            None => filtered.clone(),
        };
        Ok(Some(Self { filter, left_variance, filtered, result }))
    }
}

fn second_pass_filter(second_pass: &SecondPass, window_radius: u32) -> Auxiliary {
    Auxiliary {
        window_radius: second_pass.window_radius(window_radius),
        patch_radius: second_pass.patch_radius,
        k: second_pass.color_k,
    }
}

/// Prefilters each feature by itself (Algorithm 1 lines 4 to 10) and packs them for the candidates. Packs features
/// without noise as they are. Returns an empty list without features.
///
/// `frames` holds the features of all frames of the window in time, the one to denoise first, and each is prefiltered
/// with the help of all. Measured on three frames of the built-in scenes in which nothing moves, 8 and 32 samples per
/// pixel: against one frame alone they leave .46 to .67 of the error, with features that are prefiltered frame by frame
/// .60 to .77, and .46 to .53 if all the samples were in one frame.
fn prefilter(
    rec: &mut Recorder,
    extent: IVec2,
    frames: Vec<Vec<FeatureInput>>,
    work: Work,
    keeper: &mut Keeper,
) -> Result<Vec<Features>> {
    let Work { params: &DfcParams { weighting, box_weight, .. }, plan, schedule, wanted } = work;
    let channels: Vec<u32> = frames[0].iter().map(|feature| feature.channels).collect();
    if channels.is_empty() {
        return Ok(Vec::new());
    }
    let packed = frames.iter().map(|_| Features::take(rec, extent, &channels)).collect::<Result<Vec<_>>>()?;
    let slots = packed[0].packing.slots.clone();
    for index in packed[0].packing.order() {
        let FeatureInput { name, channels, .. } = &frames[0][index];
        let step = Step::Prefilter(name.clone());
        let exact = plan.exact(&step);
        let has_noise = plan.begins(rec, step.clone());
        let features = frames.iter().map(|features| features[index].fetch(rec, extent)).collect::<Result<Vec<_>>>()?;
        let variances = features
            .iter()
            .map(|signal| if has_noise { noise(rec, extent, signal, box_weight) } else { Ok(None) })
            .collect::<Result<Vec<_>>>()?;
        let mut prefiltered = Vec::new();
        for (frame, signal) in features.iter().enumerate() {
            let others = || features.iter().zip(&variances).enumerate().filter(|(other, _)| *other != frame);
            prefiltered.push(match &variances[frame] {
                Some(variance) => {
                    let beside: Vec<_> = others()
                        .filter_map(|(_, (other, variance))| {
                            Some(Beside { signal: &other.signal, variance_of_mean: variance.as_ref()? })
                        })
                        .collect();
                    let payloads: Vec<_> = beside.iter().map(|beside| beside.signal).collect();
                    let guide = Guide {
                        beside: &beside,
                        exact,
                        wanted: wanted.features,
                        ..PREFILTER.guide(&signal.signal, variance, *channels)
                    };
                    let lanes = if *channels == 1 { Lanes::First } else { Lanes::All };
                    let payload = Payload {
                        planes: &signal.signal,
                        count: if signal.has_halves { 2 } else { 1 },
                        beside: &payloads,
                        lanes,
                    };
                    let filtered = nlm_filter(
                        rec,
                        extent,
                        &guide,
                        &payload,
                        PREFILTER.window_radius,
                        weighting,
                        !signal.has_halves,
                        schedule,
                    )?;
                    let residual = match filtered.residual_variance {
                        Some(residual) => residual,
                        None => variance_smooth(rec, extent, &filtered.planes, RESIDUAL_SMOOTHING, None)?,
                    };
                    (Arc::new(filtered.planes), Some(Arc::new(residual)))
                }
                None => (signal.signal.clone(), None),
            });
        }
        plan.begins(rec, Step::Features);
        for ((filtered, residual_variance), packed) in prefiltered.iter().zip(&packed) {
            feature_pack(rec, extent, packed, slots[index], filtered, residual_variance.as_deref())?;
        }
        let (filtered, residual_variance) = &prefiltered[0];
        let names = &["x", "y", "z"][..*channels as usize];
        // Without noise, the half spread is 0 as well.
        let (residual_variance, plane) =
            residual_variance.as_ref().map_or((&features[0].signal, 1), |variance| (variance, 0));
        keeper.keep(Intermediate::Features, format!("{name}_prefiltered"), names, Unit::Feature(index), filtered, 0);
        keeper.keep(
            Intermediate::Features,
            format!("{name}_residual_variance"),
            names,
            Unit::FeatureSquared(index),
            residual_variance,
            plane,
        );
    }
    Ok(packed)
}

/// Variance of a signal's mean. `None` if the noise of the signal is unknown.
fn noise(rec: &mut Recorder, extent: IVec2, signal: &GpuSignal, box_weight: BoxWeight) -> Result<Option<Arc<Buffer>>> {
    let noisy = signal.has_halves || signal.variance_of_mean.is_some();
    noisy.then(|| guide_variance(rec, extent, signal, box_weight, Floor::Absolute)).transpose()
}

/// How far the shares of the candidates depend on the candidates, in pixels.
fn reach_of_choice() -> u32 {
    [ERROR_SMOOTHING, SELECTION_SMOOTHING].iter().map(|filter| filter.window_radius + filter.patch_radius).sum()
}
