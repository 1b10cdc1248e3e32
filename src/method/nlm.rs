//! Denoising by non-local means (thesis chapter 7): two halves of the samples, each filtered with the weights of the
//! other.

mod params;

use std::sync::Arc;

use glam::IVec2;

use super::common::{input_variance, with_input_kept};
use super::estimate::{GpuEstimate, Intermediate, Keeper, Lane, RGB, Unit};
use super::kernels::{Compared, KernelOnGpu, WeightRule, WeightsOnGpu};
use super::noise::estimate_noise;
use super::payload::Payload as Along;
use super::plan::{Facts, PlannedStep, Planner, Wishes, impossible, method_plan, needless};
use super::spikes::Found;
use super::{FrameInput, GpuPayload, GpuSignal, Method};
use crate::error::{Error, RequestCause, Result};
use crate::gpu::{Buffer, Recorder};
use crate::stage::error::error_halves;
use crate::stage::frames::Frames;
use crate::stage::gaussian::{Averaging, Gaussian, gaussian};
use crate::stage::half::{Halves, half_join, half_split};
use crate::stage::nlm::{
    Beside, CentreWeight, Filtered, Guide, Payload, Schedule, Weighting, nlm_filter, nlm_filter_all,
};
use crate::stage::payload::{Half, MixShare, PAYLOAD_STEP, PayloadGroup, payload_half, payload_mix};
use crate::stage::sample::sample_attach;
use crate::stage::select::{HARM, Noisy, select_frames_of_filtered};
use crate::stage::variance::{BoxWeight, Floor, VariancePair, variance_clamp, variance_floor, variance_pair};
use crate::stage::window::{NLM_DISTANCE, NLM_WEIGHT, nlm_window};

pub use params::{NlmParams, NlmVariance};

pub(super) const INTERMEDIATES: [Intermediate; 4] =
    [Intermediate::Spikes, Intermediate::Variance, Intermediate::Halves, Intermediate::Density];

/// Thesis 7.1.3: pixels that missed a rare event are sampled where their neighbours recorded it.
const ERROR_SMOOTHING_SIGMA: f32 = 0.8;

/// Thesis 7.1.1: the small window keeps the peaks of the variance where the spikes are; α of 4 disregards differences
/// below two standard deviations.
const VARIANCE_WINDOW_RADIUS: u32 = 1;
const VARIANCE_PATCH_RADIUS: u32 = 3;
const VARIANCE_K: f32 = 0.45;
const VARIANCE_ALPHA: f32 = 4.0;

/// Non-local means. Uses no features. The window also covers the frames beside, if there are any (thesis 7.3); they
/// must have the units of the own frame.
///
/// `progress` is called with the share of the work that is recorded.
///
/// # Errors
/// Errors of the recorder; [`Error::Request`] where the variance is to be uniform and a frame has no mean variance.
pub(crate) fn nlm(
    rec: &mut Recorder,
    frames: Frames<FrameInput>,
    plan: &NlmPlan,
    schedule: Schedule,
    mut progress: impl FnMut(&mut Recorder, f32) -> Result<()>,
) -> Result<GpuEstimate> {
    let params = &plan.params;
    let extent = frames.own.extent;
    let has_halves = frames.own.color.has_halves;
    let mut keeper = Keeper::new(&plan.keep);

    // Variance estimation.
    let Frames { own, beside } = frames.try_map(|frame| Prepared::new(rec, frame, plan, schedule))?;
    let Prepared { color, signal, variance, halves, spikes, payload, .. } = &own;
    if let Some(spikes) = spikes {
        keeper.keep(Intermediate::Spikes, "spikes", &RGB, Unit::Color, &spikes.spikes, 0);
    }
    keeper.keep(Intermediate::Variance, "variance_of_mean", &RGB, Unit::ColorSquared, variance, 0);

    // Dual-buffer filtering; without halves, and for comparison, the original with one buffer.
    let mut filtered_with = |rec: &mut Recorder, beside: &[Prepared], from: f32, to: f32| {
        let window = Frames { own: &own, beside: beside.iter().collect() };
        let filtered = if halves.is_some() {
            let a = filter(rec, extent, &window, Some(Half::A), params, false, schedule)?;
            progress(rec, (from + to) / 2.0)?;
            let b = filter(rec, extent, &window, Some(Half::B), params, false, schedule)?;
            FilteredFrame {
                color: half_join(rec, extent, [&a.color, &b.color])?,
                layers: rec
                    .in_step(PAYLOAD_STEP, |rec| payload_mix(rec, extent, a.layers, b.layers, MixShare::Even(0.5)))?,
            }
        } else {
            filter(rec, extent, &window, None, params, !has_halves && plan.error.runs, schedule)?
        };
        progress(rec, to)?;
        Ok::<_, Error>(filtered)
    };
    // Weights from the other half do not depend on the noise of the averaged half, so that SURE costs nothing. `share`
    // is the part of the whole work that the own frame alone takes.
    let guarded = plan.filter_alone.runs;
    plan.filter_alone.begin(rec);
    let share = if guarded { 1.0 / (beside.len() as f32 + 2.0) } else { 0.0 };
    let alone = guarded.then(|| filtered_with(rec, &[], 0.0, share)).transpose()?;
    plan.filter.begin(rec);
    let FilteredFrame { color: filtered, mut layers } = filtered_with(rec, &beside, share, 1.0)?;
    if let Some(FilteredFrame { color: alone, layers: layers_alone }) = alone {
        plan.frames.begin(rec);
        let noisy = Noisy { signal, variance_of_mean: variance };
        select_frames_of_filtered(rec, extent, noisy, &alone, &filtered, HARM)?;
        layers = rec.in_step(PAYLOAD_STEP, |rec| {
            payload_mix(rec, extent, layers, layers_alone, MixShare::OfSignal(&filtered.planes))
        })?;
    }
    drop(beside);

    // Error estimation, and where the next samples pay (thesis 7.1.3).
    let mut error = None;
    if plan.error.runs {
        plan.error.begin(rec);
        let errors = error_halves(rec, extent, &filtered)?;
        let errors =
            Arc::new(gaussian(rec, extent, &errors, 1, Gaussian::new(ERROR_SMOOTHING_SIGMA), Averaging::Mean)?);
        keeper.keep(Intermediate::Density, "density", &["V"], Unit::Number, &errors, 0);
        error = Some(Lane { buffer: errors, plane: 0, component: 1 });
    }

    let Filtered { planes, weights, .. } = filtered;
    let (result, clean, found) = ((Arc::new(planes), layers), &plan.keep_clean, spikes.as_ref());
    let (signal, layers) = with_input_kept(rec, extent, color, payload, found, result, error.as_ref(), clean)?;
    if keeper.wants(Intermediate::Halves) && has_halves {
        plan.filter.begin(rec);
        let Halves { a, b, .. } = half_split(rec, extent, &signal, variance)?;
        keeper.keep(Intermediate::Halves, "half_a", &RGB, Unit::Color, &Arc::new(a), 0);
        keeper.keep(Intermediate::Halves, "half_b", &RGB, Unit::Color, &Arc::new(b), 0);
    }
    Ok(GpuEstimate {
        signal,
        error,
        weight_sum: Lane { buffer: Arc::new(weights), plane: 0, component: 0 },
        selection: None,
        spikes: spikes.as_ref().map(|found| found.spikes.clone()),
        payload: layers,
        kept: keeper.into_kept(),
    })
}

/// A filtered frame.
struct FilteredFrame {
    color: Filtered,
    /// Layers, filtered with the same weights.
    layers: Vec<PayloadGroup>,
}

/// Filters the own frame over the window: a half with the weights of the other half, or the mean with its own weights.
fn filter(
    rec: &mut Recorder,
    extent: IVec2,
    window: &Frames<&Prepared>,
    half: Option<Half>,
    params: &NlmParams,
    with_residual_variance: bool,
    schedule: Schedule,
) -> Result<FilteredFrame> {
    let Frames { own, beside } = window;
    let buffers = own.buffers(half);
    let others: Vec<Buffers> = beside.iter().map(|frame| frame.buffers(half)).collect();
    let neighbours: Vec<_> =
        others.iter().map(|other| Beside { signal: other.guide, variance_of_mean: other.variance }).collect();
    let guide = Guide { beside: &neighbours, ..buffers.guide(params) };
    let colors: Vec<_> = others.iter().map(|other| other.payload).collect();
    let layers = own.layers(rec, extent, half)?;
    let layers_beside = beside.iter().map(|frame| frame.layers(rec, extent, half)).collect::<Result<Vec<_>>>()?;
    let of_group = |index: usize| layers_beside.iter().map(|layers| &*layers[index].buffer).collect::<Vec<_>>();
    let neighbours_of_layers: Vec<Vec<&Buffer>> = (0..layers.len()).map(of_group).collect();
    let payloads: Vec<Payload> =
        std::iter::once(Payload { beside: &colors, ..Payload::new(buffers.payload, buffers.payload_planes) })
            .chain(
                layers.iter().zip(&neighbours_of_layers).map(|(group, beside)| Payload { beside, ..group.payload() }),
            )
            .collect();
    let (radius, weighting) = (params.window_radius, params.weighting);
    let mut filtered =
        nlm_filter_all(rec, extent, &guide, &payloads, radius, weighting, with_residual_variance, schedule)?;
    let color = filtered.remove(0);
    let layers = layers.iter().zip(filtered).map(|(group, filtered)| group.with_planes(filtered.planes)).collect();
    Ok(FilteredFrame { color, layers })
}

/// Input of one run of the filter, from one frame.
struct Buffers<'a> {
    guide: &'a Buffer,
    variance: &'a Buffer,
    payload: &'a Buffer,
    payload_planes: u32,
}

impl Buffers<'_> {
    /// Filters half A with the weights of half B; half B is filtered the other way round.
    fn of_half_a(halves: &Halves) -> Buffers<'_> {
        Buffers { guide: &halves.b, variance: &halves.variance, payload: &halves.a, payload_planes: 1 }
    }

    fn of_half_b(halves: &Halves) -> Buffers<'_> {
        Buffers { guide: &halves.a, variance: &halves.variance, payload: &halves.b, payload_planes: 1 }
    }
}

impl<'a> Buffers<'a> {
    /// Filters the signal with its own weights.
    fn of_signal(signal: &'a Buffer, variance: &'a Buffer) -> Self {
        Self { guide: signal, variance, payload: signal, payload_planes: 2 }
    }

    fn guide(&self, params: &NlmParams) -> Guide<'a> {
        Guide {
            alpha: params.alpha,
            patchwise: params.patchwise,
            cut: params.cut,
            ..Guide::new(self.guide, self.variance, 3, params.k, params.patch_radius)
        }
    }
}

/// Returns the kernels at a pixel: two where the halves are filtered by each other, otherwise one.
pub(super) fn kernels(
    rec: &mut Recorder,
    frame: FrameInput,
    pixel: IVec2,
    plan: &NlmPlan,
    schedule: Schedule,
) -> Result<Vec<KernelOnGpu>> {
    let params = &plan.params;
    let extent = frame.extent;
    let Prepared { signal, variance, halves, .. } = Prepared::new(rec, frame, plan, schedule)?;
    plan.filter.begin(rec);
    let mut weights = |buffers: Buffers| {
        let cells =
            nlm_window(rec, extent, pixel, &buffers.guide(params), params.window_radius, params.weighting, schedule)?;
        let color = Compared::Color { patch_radius: params.patch_radius, k: params.k };
        Ok::<_, Error>(WeightsOnGpu::Cells {
            cells: Arc::new(cells),
            window_radius: params.window_radius,
            weight: NLM_WEIGHT,
            distances: vec![(color, NLM_DISTANCE)],
            rule: if params.patchwise {
                WeightRule::PatchMean { cut: params.cut }
            } else {
                WeightRule::Cut { cut: params.cut }
            },
            centre: params.weighting.centre,
            limit: None,
        })
    };
    Ok(match halves {
        Some(halves) => {
            let (of_a, of_b) = (weights(Buffers::of_half_a(&halves))?, weights(Buffers::of_half_b(&halves))?);
            let Halves { a, b, .. } = halves;
            vec![
                KernelOnGpu { name: "half_a", averaged: Arc::new(a), weights: of_a, share: None },
                KernelOnGpu { name: "half_b", averaged: Arc::new(b), weights: of_b, share: None },
            ]
        }
        None => {
            let weights = weights(Buffers::of_signal(&signal, &variance))?;
            vec![KernelOnGpu { name: "filter", averaged: Arc::new(signal), weights, share: None }]
        }
    })
}

/// Input of the filter from one frame.
struct Prepared {
    /// Colour without spikes.
    color: GpuSignal,
    /// Signal with the number of samples of each pixel in the w of its mean.
    signal: Buffer,
    variance: Arc<Buffer>,
    /// Halves, where they are filtered by each other.
    halves: Option<Halves>,
    /// Spikes and lights that were taken out.
    spikes: Option<Found>,
    /// Layers that are filtered along with the colour.
    payload: Along,
    /// Colour with its spikes, two planes; `None` if there are no layers.
    given: Option<Arc<Buffer>>,
}

impl Prepared {
    /// Returns the buffers that filter a half, or the whole.
    fn buffers(&self, half: Option<Half>) -> Buffers<'_> {
        match (&self.halves, half) {
            (Some(halves), Some(Half::A)) => Buffers::of_half_a(halves),
            (Some(halves), Some(Half::B)) => Buffers::of_half_b(halves),
            _ => Buffers::of_signal(&self.signal, &self.variance),
        }
    }

    /// Returns a half of the layers; the mean where there is no half, or no half spread tells it.
    fn layers(&self, rec: &mut Recorder, extent: IVec2, half: Option<Half>) -> Result<Vec<PayloadGroup>> {
        let Along { given, repaired } = &self.payload;
        let of_group = |(repaired, given): (&PayloadGroup, &GpuPayload)| match (half, &given.half_spread, &self.given) {
            (Some(half), Some(spread), Some(color)) => rec.in_step(PAYLOAD_STEP, |rec| {
                payload_half(rec, extent, half, repaired, spread, [color, &self.color.signal])
            }),
            _ => Ok(repaired.clone()),
        };
        repaired.iter().zip(given).map(of_group).collect()
    }

    fn new(rec: &mut Recorder, frame: FrameInput, plan: &NlmPlan, schedule: Schedule) -> Result<Self> {
        let params = &plan.params;
        let FrameInput { extent, mut color, features: _, samples, mean_variance, payload } = frame;
        let given = (!payload.is_empty()).then(|| color.signal.clone());
        let mut payload = Along::new(payload);
        if let Some(noise) = plan.noise.as_ref().filter(|noise| noise.runs) {
            noise.begin(rec);
            estimate_noise(rec, extent, &mut color, &mut [], Method::from(*params).pooling())?;
        }
        let mut spikes = None;
        if plan.spikes.runs {
            plan.spikes.begin(rec);
            (color, spikes) = params.spikes.repair(rec, extent, color, None, &mut payload)?;
        }
        plan.variance.begin(rec);
        let variance = match params.variance {
            NlmVariance::Scaled => scaled_variance(rec, extent, &color)?,
            NlmVariance::CrossFiltered => cross_filtered_variance(rec, extent, &color, params.weighting, schedule)?,
            NlmVariance::Uniform => {
                let of_channels = mean_variance.ok_or_else(|| {
                    Error::Request(RequestCause::Misuse {
                        problem: "the variance is to be the same everywhere, but the frame does not say its mean"
                            .into(),
                        change: "set `GpuFrame::mean_variance`, or choose another `NlmParams::variance`",
                    })
                })?;
                let values = 4 * extent.element_product() as usize;
                let of_pixel = of_channels.extend(0.0).to_array();
                Arc::new(rec.upload_with("uniform variance", values, |_, piece| {
                    piece.chunks_exact_mut(4).for_each(|pixel| pixel.copy_from_slice(&of_pixel));
                })?)
            }
        };
        let variance =
            Arc::new(variance_floor(rec, extent, &color.signal, &variance, Floor::of_color(params.keep_clean))?);
        let signal = sample_attach(rec, extent, &color.signal, &samples)?;
        plan.halves.begin(rec);
        let halves = plan.halves.runs.then(|| half_split(rec, extent, &signal, &variance)).transpose()?;
        Ok(Self { color, signal, variance, halves, spikes, payload, given })
    }
}

/// Returns the variance scaled as in thesis 8.2 and held below the sample variance as in 7.1.1. Measured on six renders
/// with 8 and 32 samples per pixel: the bound saves single dark pixels beside bright noise (relative MSE of
/// `caustic_ring` at 32 spp 0.0199 without, 0.0075 with; `dof_spheres` 0.0050 and 0.0048) and changes no other by more
/// than 2 %.
fn scaled_variance(rec: &mut Recorder, extent: IVec2, color: &GpuSignal) -> Result<Arc<Buffer>> {
    let scaled = input_variance(rec, extent, color, BoxWeight::Deviation)?;
    match color.variance_of_mean.as_ref().filter(|_| color.has_halves) {
        Some(sample_variance) => Ok(Arc::new(variance_clamp(rec, extent, &scaled, sample_variance)?)),
        None => Ok(scaled),
    }
}

/// Returns the two-buffer variance, filtered with weights from the sample variance and held below it. The two-buffer
/// variance is unbiased and very noisy; the sample variance has the same structure. Both belong to the mean of both
/// halves, whereas the source speaks of one half; all quantities scale alike, so the filter is the same.
fn cross_filtered_variance(
    rec: &mut Recorder,
    extent: IVec2,
    color: &GpuSignal,
    weighting: Weighting,
    schedule: Schedule,
) -> Result<Arc<Buffer>> {
    let Some(sample_variance) = color.variance_of_mean.as_ref().filter(|_| color.has_halves) else {
        return input_variance(rec, extent, color, BoxWeight::Deviation);
    };
    let VariancePair { two_buffer_variance, uncertainty } = variance_pair(rec, extent, &color.signal, sample_variance)?;
    let uncertainty = variance_floor(rec, extent, sample_variance, &uncertainty, Floor::Printed)?;
    let guide = Guide {
        alpha: VARIANCE_ALPHA,
        ..Guide::new(sample_variance, &uncertainty, 3, VARIANCE_K, VARIANCE_PATCH_RADIUS)
    };
    let filtered = nlm_filter(
        rec,
        extent,
        &guide,
        &Payload::new(&two_buffer_variance, 1),
        VARIANCE_WINDOW_RADIUS,
        weighting,
        false,
        schedule,
    )?;
    Ok(Arc::new(variance_clamp(rec, extent, &filtered.planes, sample_variance)?))
}

impl From<NlmParams> for Method {
    fn from(params: NlmParams) -> Self {
        Self::Nlm(params)
    }
}

method_plan! {
    /// Plan of NLM.
    pub struct NlmPlan of NlmParams {
        /// Estimates of variances that the frame lacks; `None` if it lacks none.
        noise: Option<PlannedStep>,
        /// Spikes taken out of the colour.
        spikes: PlannedStep,
        /// The variance of the colour's mean, as the parameters say.
        variance: PlannedStep,
        /// Halves split, to be filtered by each other (thesis 7.1.1).
        halves: PlannedStep,
        /// The filter over the own frame alone, against which the frames beside are judged.
        filter_alone: PlannedStep,
        /// The filter.
        filter: PlannedStep,
        /// Frames beside left out of pixels that they harm.
        frames: PlannedStep,
        /// The estimated error of the result.
        error: PlannedStep,
        /// Layers filtered along with the colour; `None` if the frame has none.
        payload: Option<PlannedStep>,
        /// Pixels without noise put back.
        keep_clean: PlannedStep,
    }
}

/// Plans [`nlm`]. A frame without noise is not simply copied: where a patch leaves the image, opposite neighbours that
/// stand in for each other get unequal weights, so that even exact pixels change.
pub(super) fn plan(params: &NlmParams, facts: &Facts, wishes: &Wishes) -> NlmPlan {
    let planner = Planner::new(wishes);
    let variance = match params.variance {
        NlmVariance::Uniform => "the mean of the image, everywhere",
        NlmVariance::Scaled | NlmVariance::CrossFiltered => "what the filters judge differences by",
    };
    let unless = [
        impossible(!params.dual_buffer, "the parameters leave it out"),
        impossible(!facts.has_halves, "the frame has none: it is filtered with its own weights"),
    ];
    let halves = planner.step("halves", "each is filtered with the weights of the other", &unless);
    let guard = [
        impossible(facts.beside == 0, "there are no frames beside"),
        impossible(!params.guard_frames, "there is no guard"),
        impossible(
            !halves.runs || params.weighting.centre != CentreWeight::One,
            "the guard needs weights from the other half, and a centre of weight one",
        ),
    ];
    let unwanted = !wishes.error && !wishes.keeps(Intermediate::Density);
    let unwanted = [needless(unwanted, "neither the error nor the sampling density is wanted")];
    NlmPlan {
        params: *params,
        keep: wishes.keep.to_vec(),
        noise: planner.noise(Method::from(*params).pooling(), facts),
        spikes: planner.spikes(params.spikes, facts),
        variance: planner.step("variance", variance, &[]),
        halves,
        filter_alone: planner.step("filter over one frame", "to judge the frames beside by", &guard).beside_kernels(),
        filter: planner.step("filter", "makes the result", &[]),
        frames: planner
            .step("frames that harm", "where they harm, frames beside are left out", &guard)
            .beside_kernels(),
        error: planner.step("error", "what the filtered halves, or weights, show", &unwanted).beside_kernels(),
        payload: planner.payload(facts),
        keep_clean: planner.keep_clean(params.keep_clean),
    }
}
