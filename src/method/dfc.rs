//! Denoising by combining colour and feature filters (thesis chapter 8). The file follows Algorithm 1 from top to
//! bottom: preparation, pass 1, pass 2, error of the result.

mod candidate_set;
mod kernels;
mod params;
mod plan;

use std::sync::Arc;

use glam::IVec2;

use super::common::{Auxiliary, guide_variance, with_input_kept};
use super::estimate::{GpuEstimate, Intermediate, Keeper, Lane, RGB, Share, Unit};
use super::frame::FeatureInput;
use super::noise::estimate_noise;
use super::payload::Payload as Along;
use super::plan::PlannedStep;
use super::spikes::Found;
use super::{FrameInput, GpuSignal, Method, Spikes};
use crate::error::{Error, Result};
use crate::gpu::{Buffer, Recorder};
use crate::stage::candidate::{
    CandidateFrame, CandidateWindow, Candidates, CandidatesInTime, Needed, candidates, planes_of_numbers,
};
use crate::stage::candidate_filter::CandidateFilter;
use crate::stage::error::{ErrorParts, error_blend, error_blend_more, error_difference, error_spikes, error_sure};
use crate::stage::exact::Region;
use crate::stage::feature::{Features, feature_pack};
use crate::stage::frames::Frames;
use crate::stage::nlm::{Beside, Guide, Lanes, Payload, Schedule, nlm_filter, nlm_filter_all};
use crate::stage::payload::{MixShare, PAYLOAD_STEP, PayloadGroup, payload_blend, payload_mix};
use crate::stage::sample::{GpuSamples, sample_density};
use crate::stage::select::{
    Evidence, HARM, Noisy, Significance, WithColorOnly, select_blend, select_color_only, select_frames, select_least,
    select_pass, select_share,
};
use crate::stage::variance::{BoxWeight, Floor, RESIDUAL_SMOOTHING, variance_floor, variance_smooth};

pub use candidate_set::CandidateSet;
pub(super) use kernels::kernels;
pub use params::{DfcParams, SecondPass};
pub use plan::DfcPlan;
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

/// Runs Algorithm 1. Without halves, it takes the variances as they are and has no second pass. Without a sample
/// variance, the pooled or smoothed two-buffer variance takes its place. Steps that the plan leaves out do not run.
///
/// All frames must have the units and features of the own frame. `progress` receives the share of the work that is
/// recorded, 0 to 1.
///
/// # Errors
/// Errors of the recorder.
pub(crate) fn dfc(
    rec: &mut Recorder,
    frames: Frames<FrameInput>,
    plan: &DfcPlan,
    schedule: Schedule,
    progress: impl FnMut(&mut Recorder, f32) -> Result<()>,
) -> Result<GpuEstimate> {
    let mut keeper = Keeper::new(&plan.keep);
    let params = &plan.params;
    let work = Work { params, plan, schedule, wanted: Wanted::default() };
    let mut prepared = Prepared::new(rec, frames, work, &mut keeper)?;
    let Pass1 { candidates, selection, color_only, blend: pass1, mut layers } =
        Pass1::new(rec, &mut prepared, work, &mut keeper, progress)?;
    let Prepared { extent, own: PreparedFrame { color, variance, payload, .. }, spikes, samples, .. } = &prepared;
    let extent = *extent;

    // Second pass filtering.
    let mut result = pass1.clone();
    if let Some(pass2) = Pass2::new(rec, extent, &pass1, &mut layers, variance, work)? {
        keeper.keep(Intermediate::Pass1, "pass1", &RGB, Unit::Color, &pass1, 0);
        result = pass2.result;
    }

    // Error that remains. SURE tells little more than the order of the candidates, so parts of the error are added up.
    let mut error = None;
    if plan.error.runs {
        plan.error.begin(rec);
        let parts = ErrorParts::measured(color.has_halves, params.several_can_win());
        let shares = selection.as_deref();
        let mut errors = error_blend(rec, extent, &result, variance, &candidates, shares, parts)?;
        if let Some(ColorOnly { candidates, shares }) = &color_only {
            errors = error_blend_more(rec, extent, &result, variance, candidates, shares, parts, errors)?;
        }
        if let Some(spikes) = spikes.as_ref().filter(|_| params.spikes == Spikes::Spread) {
            errors = error_spikes(rec, extent, errors, &spikes.spikes, parts)?;
        }
        error = Some(Arc::new(errors));
    }
    let selection = shares_by_name(params, &candidates, selection.as_ref());
    drop((candidates, color_only));

    // Adaptive sampling (thesis 8.6).
    if plan.density.runs {
        plan.density.begin(rec);
        let density = sample_density(rec, extent, &pass1, error.as_deref().filter(|_| !color.has_halves), samples)?;
        let density = prepared.smooth(rec, &plan.density, &density, 1, &DENSITY_SMOOTHING, work)?;
        keeper.keep(Intermediate::Density, "density", &["V"], Unit::Number, &Arc::new(density), 0);
    }

    let error = error.map(|buffer| Lane { buffer, plane: 0, component: 0 });
    let (result, clean, found) = ((result, layers), &plan.keep_clean, spikes.as_ref());
    let (signal, layers) = with_input_kept(rec, extent, color, payload, found, result, error.as_ref(), clean)?;
    Ok(GpuEstimate {
        signal,
        error,
        // Σ w as blended in pass 1.
        weight_sum: Lane { buffer: pass1, plane: 0, component: 3 },
        selection: Some(selection),
        spikes: spikes.as_ref().map(|found| found.spikes.clone()),
        payload: layers,
        kept: keeper.into_kept(),
    })
}

/// Returns the share of each candidate in the blend, from the maps in `selection`. Without maps, the only candidate has
/// the whole pixel.
fn shares_by_name(
    params: &DfcParams,
    candidates: &Candidates,
    selection: Option<&Arc<Buffer>>,
) -> Vec<(&'static str, Share)> {
    let share = |place: usize| match selection {
        Some(maps) => Share::Lane(Lane { buffer: maps.clone(), plane: place as u32 / 4, component: place as u32 % 4 }),
        None => Share::Whole,
    };
    let of_filter = |(filter, _): (CandidateFilter, bool)| {
        let place = candidates.filters.iter().position(|computed| computed.name == filter.name);
        (filter.name, place.map_or(Share::None, share))
    };
    params.filters().into_iter().map(of_filter).collect()
}

/// Parameters and plan of the work on a frame.
#[derive(Clone, Copy)]
struct Work<'a> {
    params: &'a DfcParams,
    plan: &'a DfcPlan,
    schedule: Schedule,
    wanted: Wanted,
}

impl<'a> Work<'a> {
    /// Outputs of the candidates that the plan needs.
    fn needed(&self) -> Needed<'a> {
        let plan = self.plan;
        Needed {
            derivatives: plan.derivatives.runs,
            half_spread: plan.half_spread.runs,
            alone: plan.frames.runs,
            channels: plan.channels.runs,
            exact: plan.candidates.exact.as_ref(),
            wanted: self.wanted.candidates,
        }
    }

    fn is_grey(&self) -> bool {
        !self.plan.channels.runs
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

impl DfcParams {
    fn window(&self) -> CandidateWindow {
        CandidateWindow { radius: self.window_radius, weighting: self.weighting }
    }
}

/// Candidates that the plan computes and compares.
fn planned_filters(plan: &DfcPlan) -> Vec<CandidateFilter> {
    let filters = plan.params.filters().into_iter().zip(&plan.filters);
    filters.filter_map(|((filter, _), step)| step.runs.then_some(filter)).collect()
}

/// The filter by the colour only: SECOND without features.
fn color_only_filter(params: &DfcParams) -> CandidateFilter {
    CandidateFilter { name: "color_only", features: None, ..params.second() }
}

/// Input of the candidates.
struct Prepared {
    extent: IVec2,
    own: PreparedFrame,
    /// Frames beside the own frame; empty after the candidates are computed.
    beside: Vec<PreparedFrame>,
    /// Spikes and lights that were taken out of the own frame.
    spikes: Option<Found>,
    samples: GpuSamples,
}

/// A frame of the window in time.
struct PreparedFrame {
    /// Colour without spikes.
    color: GpuSignal,
    variance: Arc<Buffer>,
    /// Prefiltered features; `None` without features, and after the candidates are computed.
    features: Option<Features>,
    /// Layers that are filtered along with the colour.
    payload: Along,
}

impl PreparedFrame {
    fn candidate_frame(&self) -> CandidateFrame<'_> {
        CandidateFrame {
            payload: &self.color.signal,
            guide: None,
            variance_of_mean: &self.variance,
            features: self.features.as_ref(),
            layers: &self.payload.repaired,
        }
    }
}

impl Prepared {
    fn new(rec: &mut Recorder, frames: Frames<FrameInput>, work: Work, keeper: &mut Keeper) -> Result<Self> {
        let Work { params, plan, .. } = work;
        // Space-time filtering (8.6): the window gains frames. The sample counts come from the own frame.
        let Frames { own: FrameInput { extent, color, features, samples, payload, .. }, beside } = frames;
        let beside = beside.into_iter().map(|frame| ((frame.color, frame.features), Along::new(frame.payload)));
        let frames = Frames { own: ((color, features), Along::new(payload)), beside: beside.collect() };
        let (mut frames, payloads) = frames.unzip();

        // Variances that the frames lack.
        if let Some(noise) = plan.noise.as_ref().filter(|noise| noise.runs) {
            noise.begin(rec);
            frames = frames.try_map(|(mut color, mut features)| {
                estimate_noise(rec, extent, &mut color, &mut features, Method::from(*params).pooling())?;
                Ok::<_, Error>((color, features))
            })?;
        }

        // Feature prefiltering.
        let (colors, features) = frames.unzip();
        let features = prefilter(rec, extent, features, work, keeper)?;
        let mut frames = colors.zip(features).zip(payloads);

        // Spikes.
        let mut of_each = None;
        if plan.spikes.runs {
            plan.spikes.begin(rec);
            frames = frames.try_map(|((color, features), mut payload)| {
                let (color, found) = params.spikes.repair(rec, extent, color, features.as_ref(), &mut payload)?;
                // The own frame comes first. Spikes of other frames are repaired, but not reported.
                of_each.get_or_insert(found);
                Ok::<_, Error>(((color, features), payload))
            })?;
        }
        let spikes = of_each.flatten();
        if let Some(spikes) = &spikes {
            keeper.keep(Intermediate::Spikes, "spikes", &RGB, Unit::Color, &spikes.spikes, 0);
        }

        // Sample variance scaling.
        plan.variance.begin(rec);
        let frames = frames.try_map(|((color, features), payload)| {
            let floor = Floor::of_color(params.keep_clean);
            let variance = guide_variance(rec, extent, &color, params.box_weight, floor)?;
            Ok::<_, Error>(PreparedFrame { color, variance, features, payload })
        })?;
        let Frames { own, beside } = frames;
        keeper.keep(Intermediate::Variance, "scaled_variance", &RGB, Unit::ColorSquared, &own.variance, 0);
        Ok(Self { extent, own, beside, spikes, samples })
    }

    /// Drops the buffers that only the candidates need.
    fn forget_neighbours(&mut self) {
        self.own.features = None;
        self.beside.clear();
    }

    /// Smooths planes with weights from the colour.
    fn smooth(
        &self,
        rec: &mut Recorder,
        step: &PlannedStep,
        payload: &Buffer,
        planes: u32,
        filter: &Auxiliary,
        work: Work,
    ) -> Result<Buffer> {
        let Work { params, schedule, wanted, .. } = work;
        let PreparedFrame { color, variance, .. } = &self.own;
        let guide = filter.guide(&color.signal, variance, 3);
        let guide = Guide { grey: work.is_grey(), exact: step.exact.as_ref(), wanted: wanted.candidates, ..guide };
        step.begin(rec);
        let payload = Payload::new(payload, planes);
        let (radius, weighting) = (filter.window_radius, params.weighting);
        Ok(nlm_filter(rec, self.extent, &guide, &payload, radius, weighting, false, schedule)?.planes)
    }
}

/// The candidates, and their average by the selection maps.
struct Pass1 {
    candidates: Candidates,
    /// The candidates' shares in the blend; `None` where there is one candidate.
    selection: Option<Arc<Buffer>>,
    /// Filter by the colour only, if it takes part in the blend.
    color_only: Option<ColorOnly>,
    blend: Arc<Buffer>,
    /// Layers, averaged as the colour is.
    layers: Vec<PayloadGroup>,
}

/// The filter by the colour only: SECOND without features.
struct ColorOnly {
    candidates: Candidates,
    /// Its share in the blend, in x of one plane.
    shares: Arc<Buffer>,
}

impl Pass1 {
    /// Makes the candidates and blends them. Drops the neighbours' buffers from `prepared`.
    fn new(
        rec: &mut Recorder,
        prepared: &mut Prepared,
        work: Work,
        keeper: &mut Keeper,
        progress: impl FnMut(&mut Recorder, f32) -> Result<()>,
    ) -> Result<Self> {
        let Work { params, plan, schedule, .. } = work;
        let extent = prepared.extent;

        // Candidate filters.
        plan.candidates.begin(rec);
        let needed = work.needed();
        let CandidatesInTime { together: mut candidates, alone } = {
            let frames = Frames {
                own: prepared.own.candidate_frame(),
                beside: prepared.beside.iter().map(PreparedFrame::candidate_frame).collect(),
            };
            let (filters, window) = (planned_filters(plan), params.window());
            candidates(rec, extent, &frames, &filters, window, needed, schedule, progress)?
        };
        if let Some(alone) = &alone {
            plan.frames.begin(rec);
            let PreparedFrame { color, variance, .. } = &prepared.own;
            let noisy = Noisy { signal: &color.signal, variance_of_mean: variance };
            select_frames(rec, extent, noisy, alone, &candidates, HARM)?;
        }
        let (sums, sums_alone) = (std::mem::take(&mut candidates.payload), alone.map(|alone| alone.payload));
        prepared.forget_neighbours();
        let PreparedFrame { color, variance, payload, .. } = &prepared.own;
        let blend_layers = |rec: &mut Recorder, shares: Option<&Buffer>| {
            rec.in_step(PAYLOAD_STEP, |rec| {
                payload_blend(rec, extent, shares, &candidates, &payload.repaired, sums, sums_alone)
            })
        };
        let signal = &color.signal;
        let names: Vec<&str> = candidates.filters.iter().map(|filter| filter.name).collect();
        for (place, name) in names.iter().copied().enumerate() {
            let plane = place as u32;
            keeper.keep(Intermediate::Candidates, name, &RGB, Unit::Color, &candidates.means, plane);
            if let Some(derivatives) = &candidates.derivatives {
                let name = format!("{name}_derivative");
                keeper.keep(Intermediate::Derivatives, name, &RGB, Unit::Number, derivatives, plane);
            }
        }

        // Filtered SURE error estimates.
        let planes = planes_of_numbers(candidates.count());
        let mut judged = None;
        if plan.sure.runs {
            plan.sure.begin(rec);
            let sure = Arc::new(error_sure(rec, extent, signal, variance, &candidates, params.covariance)?);
            let errors = Arc::new(prepared.smooth(rec, &plan.sure_smoothing, &sure, planes, &ERROR_SMOOTHING, work)?);
            keeper.keep_numbers(Intermediate::Sure, "sure", &names, Unit::ColorSquared, &sure);
            keeper.keep_numbers(Intermediate::Sure, "sure_smoothed", &names, Unit::ColorSquared, &errors);
            judged = Some((sure, errors));
        }

        let Some((sure, errors)) = judged.as_ref().filter(|_| plan.selection.runs) else {
            // Nothing to choose from.
            let blend = Arc::new(select_blend(rec, extent, None, &candidates)?);
            let layers = blend_layers(rec, None)?;
            return Ok(Self { blend, layers, selection: None, color_only: None, candidates });
        };
        // Binary selection maps.
        plan.selection.begin(rec);
        let selected = Arc::new(select_least(rec, extent, errors, &candidates)?);
        // Filter selection maps.
        let smoothed =
            prepared.smooth(rec, &plan.selection_smoothing, &selected, planes, &SELECTION_SMOOTHING, work)?;
        // Candidate filter averaging.
        plan.blend.begin(rec);
        let evidence =
            Evidence { selected: &selected, errors, sure, variance_of_mean: variance, candidates: &candidates };
        let selection = Arc::new(select_share(rec, extent, smoothed, evidence, params.guard)?);
        let mut blend = Arc::new(select_blend(rec, extent, Some(&selection), &candidates)?);
        let mut layers = blend_layers(rec, Some(&selection))?;
        let mut color_only = None;
        if plan.color_only.runs {
            plan.color_only.begin(rec);
            let (mut found, blended) = ColorOnly::new(rec, prepared, &candidates, &selection, &blend, work, keeper)?;
            layers = rec.in_step(PAYLOAD_STEP, |rec| found.payload(rec, extent, &payload.repaired, layers))?;
            (color_only, blend) = (Some(found), blended);
        }
        keeper.keep_numbers(Intermediate::Selection, "selected", &names, Unit::Number, &selected);
        keeper.keep_numbers(Intermediate::Selection, "selection", &names, Unit::Number, &selection);
        Ok(Self { candidates, selection: Some(selection), color_only, blend, layers })
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
        let Work { params, schedule, .. } = work;
        let (extent, frame) = (prepared.extent, prepared.own.candidate_frame());
        let needed = Needed { derivatives: true, alone: false, ..work.needed() };
        let (filters, window) = ([color_only_filter(params)], params.window());
        let frames = Frames::one(frame);
        let found = candidates(rec, extent, &frames, &filters, window, needed, schedule, |_, _| Ok(()))?;
        let (filtered, signal, variance) = (found.together, frame.payload, frame.variance_of_mean);
        let covariance = params.covariance;
        let differences =
            error_difference(rec, extent, signal, variance, blend, selection, joint, &filtered, covariance)?;
        let (count, significance) = (joint.count(), Significance::MEASURED);
        let WithColorOnly { blended, shares } =
            select_color_only(rec, extent, &differences, blend, count, &filtered, selection, significance)?;
        let shares = Arc::new(shares);
        keeper.keep(Intermediate::Candidates, "color_only", &RGB, Unit::Color, &filtered.means, 0);
        keeper.keep(Intermediate::Selection, "color_only_share", &["V"], Unit::Number, &shares, 0);
        Ok((Self { candidates: filtered, shares }, Arc::new(blended)))
    }

    /// Returns the layers of the blend with this filter, from the layers of the blend without.
    fn payload(
        &mut self,
        rec: &mut Recorder,
        extent: IVec2,
        given: &[PayloadGroup],
        blend: Vec<PayloadGroup>,
    ) -> Result<Vec<PayloadGroup>> {
        let sums = std::mem::take(&mut self.candidates.payload);
        let own = payload_blend(rec, extent, None, &self.candidates, given, sums, None)?;
        payload_mix(rec, extent, blend, own, MixShare::Plane(&self.shares))
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
    /// Filters pass 1, and its layers in place. Returns `None` if the plan has no second pass.
    fn new(
        rec: &mut Recorder,
        extent: IVec2,
        pass1: &Buffer,
        layers: &mut Vec<PayloadGroup>,
        variance: &Buffer,
        work: Work,
    ) -> Result<Option<Self>> {
        let Work { params, plan, schedule, wanted } = work;
        let Some(second_pass) = params.second_pass.filter(|_| plan.second_pass.runs) else { return Ok(None) };
        plan.second_pass.begin(rec);
        let SecondPass { clamp_to_input, most_sigmas, .. } = second_pass;
        let left_variance =
            variance_smooth(rec, extent, pass1, RESIDUAL_SMOOTHING, clamp_to_input.then_some(variance))?;
        let left_variance = variance_floor(rec, extent, pass1, &left_variance, Floor::of_color(params.keep_clean))?;
        let (filter, grey) = (second_pass_filter(&second_pass, params.window_radius), work.is_grey());
        let guide = Guide {
            grey,
            exact: plan.second_pass.exact.as_ref(),
            wanted: wanted.result,
            ..filter.guide(pass1, &left_variance, 3)
        };
        let color = Payload { lanes: if grey { Lanes::Grey } else { Lanes::All }, ..Payload::new(pass1, 2) };
        let payloads: Vec<_> = std::iter::once(color).chain(layers.iter().map(PayloadGroup::payload)).collect();
        let (radius, weighting) = (filter.window_radius, params.weighting);
        let mut all = nlm_filter_all(rec, extent, &guide, &payloads, radius, weighting, false, schedule)?;
        let filtered = Arc::new(all.remove(0).planes);
        let along = layers.iter().zip(all).map(|(group, filtered)| group.with_planes(filtered.planes));
        let mut along: Vec<PayloadGroup> = along.collect();
        let result = match most_sigmas {
            Some(sigmas) => Arc::new(select_pass(rec, extent, pass1, &filtered, variance, sigmas)?),
            None => filtered.clone(),
        };
        if most_sigmas.is_some() {
            along = rec.in_step(PAYLOAD_STEP, |rec| {
                payload_mix(rec, extent, std::mem::take(layers), along, MixShare::OfSignal(&result))
            })?;
        }
        *layers = along;
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
/// without noise as they are. Returns `None` for frames without features.
///
/// Each frame of the window in time is prefiltered with the help of all frames. Measured on three frames of the
/// built-in scenes in which nothing moves, 8 and 32 samples per pixel: the error is .46 to .67 of the error with one
/// frame alone. It is .60 to .77 if features are prefiltered frame by frame, and .46 to .53 if all samples are in one
/// frame.
fn prefilter(
    rec: &mut Recorder,
    extent: IVec2,
    frames: Frames<Vec<FeatureInput>>,
    work: Work,
    keeper: &mut Keeper,
) -> Result<Frames<Option<Features>>> {
    let Work { params: &DfcParams { weighting, box_weight, .. }, plan, schedule, wanted } = work;
    let channels: Vec<u32> = frames.own.iter().map(|feature| feature.channels).collect();
    if channels.is_empty() {
        return Ok(frames.map(|_| None));
    }
    let packed = frames.as_ref().try_map(|_| Features::take(rec, extent, &channels))?;
    let slots = packed.own.packing.slots.clone();
    for index in packed.own.packing.order() {
        let FeatureInput { name, channels, .. } = &frames.own[index];
        let step = &plan.prefilters[index];
        let (exact, has_noise) = (step.exact.as_ref(), step.runs);
        step.begin(rec);
        let signals = frames.as_ref().try_map(|features| features[index].fetch(rec, extent))?;
        let noisy = signals.try_map(|signal| {
            let variance = if has_noise { noise(rec, extent, &signal, box_weight)? } else { None };
            Ok::<_, Error>((signal, variance))
        })?;
        let compared: Vec<_> = noisy
            .iter()
            .map(|(signal, variance)| {
                variance.as_ref().map(|variance| Beside { signal: &signal.signal, variance_of_mean: variance })
            })
            .collect();
        let mut frame = 0..;
        let prefiltered = noisy.as_ref().try_map(|(signal, variance)| {
            let frame = frame.next().unwrap_or_default();
            let Some(variance) = variance else { return Ok((signal.signal.clone(), None)) };
            let others = compared.iter().enumerate().filter(|(other, _)| *other != frame);
            let beside: Vec<_> = others.filter_map(|(_, compared)| *compared).collect();
            let payloads: Vec<_> = beside.iter().map(|beside| beside.signal).collect();
            let guide = Guide {
                beside: &beside,
                exact,
                wanted: wanted.features,
                ..PREFILTER.guide(&signal.signal, variance, *channels)
            };
            let payload = Payload {
                planes: &signal.signal,
                count: if signal.has_halves { 2 } else { 1 },
                beside: &payloads,
                lanes: if *channels == 1 { Lanes::First } else { Lanes::All },
            };
            let (radius, with_residual) = (PREFILTER.window_radius, !signal.has_halves);
            let filtered = nlm_filter(rec, extent, &guide, &payload, radius, weighting, with_residual, schedule)?;
            let residual = match filtered.residual_variance {
                Some(residual) => residual,
                None => variance_smooth(rec, extent, &filtered.planes, RESIDUAL_SMOOTHING, None)?,
            };
            Ok::<_, Error>((Arc::new(filtered.planes), Some(Arc::new(residual))))
        })?;
        plan.features.begin(rec);
        for ((filtered, residual_variance), packed) in prefiltered.iter().zip(packed.iter()) {
            feature_pack(rec, extent, packed, slots[index], filtered, residual_variance.as_deref())?;
        }
        let (filtered, residual_variance) = &prefiltered.own;
        let names = &["x", "y", "z"][..*channels as usize];
        // Without noise, the half spread is 0 as well.
        let (residual_variance, plane) =
            residual_variance.as_ref().map_or((&noisy.own.0.signal, 1), |variance| (variance, 0));
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
    Ok(packed.map(Some))
}

/// Variance of a signal's mean. `None` if the noise of the signal is unknown.
fn noise(rec: &mut Recorder, extent: IVec2, signal: &GpuSignal, box_weight: BoxWeight) -> Result<Option<Arc<Buffer>>> {
    let noisy = signal.has_halves || signal.variance_of_mean.is_some();
    noisy.then(|| guide_variance(rec, extent, signal, box_weight, Floor::Absolute)).transpose()
}

/// Returns how far around a pixel its shares depend on the candidates, in pixels.
fn reach_of_choice() -> u32 {
    [ERROR_SMOOTHING, SELECTION_SMOOTHING].iter().map(|filter| filter.window_radius + filter.patch_radius).sum()
}
