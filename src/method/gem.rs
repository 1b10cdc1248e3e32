//! Denoising by greedy error minimisation (thesis chapter 6): for each pixel the Gaussian scale that trades bias for
//! variance best.

mod params;

use std::sync::Arc;

use glam::IVec2;

use super::common::{input_variance, with_input_kept};
use super::estimate::{GpuEstimate, Intermediate, Keeper, Lane, RGB, Unit};
use super::kernels::{KernelOnGpu, WeightsOnGpu};
use super::noise::estimate_noise;
use super::payload::Payload;
use super::plan::{Facts, PlannedStep, Planner, Wishes, impossible, method_plan};
use super::spikes::Found;
use super::{FrameInput, GpuSignal, Method};
use crate::error::Result;
use crate::gpu::Recorder;
use crate::stage::gaussian::{Averaging, Gaussian, gaussian};
use crate::stage::payload::{PAYLOAD_STEP, PayloadGroup, payload_copy, payload_scale};
use crate::stage::sample::GpuSamples;
use crate::stage::scale::{Scale, Selected, scale_advance, scale_gaussian, scale_pixel, scale_reduction, scale_stop};
use crate::stage::variance::BoxWeight;

pub use params::{GemParams, Phase};

pub(super) const INTERMEDIATES: [Intermediate; 5] =
    [Intermediate::Spikes, Intermediate::Variance, Intermediate::Stopping, Intermediate::Scale, Intermediate::Density];

/// Greedy error minimisation. Uses no features. Every pixel is the mean of its own samples and counts once, whatever
/// its sample count, so that no sub-pixel grid is needed.
///
/// `progress` is called with the share of the work that is recorded.
///
/// # Errors
/// Errors of the recorder.
pub(crate) fn gem(
    rec: &mut Recorder,
    frame: FrameInput,
    plan: &GemPlan,
    progress: impl FnMut(&mut Recorder, f32) -> Result<()>,
) -> Result<GpuEstimate> {
    let extent = frame.extent;
    let mut keeper = Keeper::new(&plan.keep);
    let Repaired { color, samples, spikes, payload } = Repaired::new(rec, frame, plan)?;
    if let Some(spikes) = &spikes {
        keeper.keep(Intermediate::Spikes, "spikes", &RGB, Unit::Color, &spikes.spikes, 0);
    }
    let (selected, layers) = select(rec, extent, &color, samples, &payload, plan, &mut keeper, progress)?;

    // Sample distribution (6.3): quantities by which the host ranks the pixels, once it knows the number of samples to
    // draw.
    if plan.density.runs {
        plan.density.begin(rec);
        let reduction = Arc::new(scale_reduction(rec, extent, &selected)?);
        keeper.keep(
            Intermediate::Density,
            "reduction",
            &["relative_mse", "support", "sigma"],
            Unit::Number,
            &reduction,
            0,
        );
    }
    let Selected { signal, choice } = selected;
    let (signal, choice) = (Arc::new(signal), Arc::new(choice));
    keeper.keep(Intermediate::Scale, "scale", &["V"], Unit::Number, &choice, 0);
    let error = Lane { buffer: choice, plane: 0, component: 2 };
    let weight_sum = Lane { buffer: signal.clone(), plane: 0, component: 3 };
    let (result, clean, found) = ((signal, layers), &plan.keep_clean, spikes.as_ref());
    let (signal, layers) = with_input_kept(rec, extent, &color, &payload, found, result, Some(&error), clean)?;
    Ok(GpuEstimate {
        signal,
        weight_sum,
        error: Some(error),
        selection: None,
        spikes: spikes.map(|found| found.spikes),
        payload: layers,
        kept: keeper.into_kept(),
    })
}

/// Returns the kernel at a pixel: the Gaussian of the scale that was chosen there.
pub(super) fn kernels(rec: &mut Recorder, frame: FrameInput, plan: &GemPlan) -> Result<Vec<KernelOnGpu>> {
    let extent = frame.extent;
    let Repaired { color, samples, .. } = Repaired::new(rec, frame, plan)?;
    let averaged = color.signal.clone();
    let (payload, keeper) = (Payload::default(), &mut Keeper::new(&[]));
    let (Selected { choice, .. }, _) = select(rec, extent, &color, samples, &payload, plan, keeper, |_, _| Ok(()))?;
    let weights = WeightsOnGpu::Gaussian(Lane { buffer: Arc::new(choice), plane: 0, component: 0 });
    Ok(vec![KernelOnGpu { name: "scale", averaged, weights, share: None }])
}

/// A frame without spikes. A renderer may hand over features; none are used.
struct Repaired {
    color: GpuSignal,
    samples: GpuSamples,
    spikes: Option<Found>,
    payload: Payload,
}

impl Repaired {
    fn new(rec: &mut Recorder, frame: FrameInput, plan: &GemPlan) -> Result<Self> {
        let params = &plan.params;
        let FrameInput { extent, mut color, features, samples, payload, .. } = frame;
        let mut payload = Payload::new(payload);
        drop(features);
        if let Some(noise) = plan.noise.as_ref().filter(|noise| noise.runs) {
            noise.begin(rec);
            estimate_noise(rec, extent, &mut color, &mut [], Method::from(*params).pooling())?;
        }
        if !plan.spikes.runs {
            return Ok(Self { color, samples, spikes: None, payload });
        }
        plan.spikes.begin(rec);
        let (color, spikes) = params.spikes.repair(rec, extent, color, None, &mut payload)?;
        Ok(Self { color, samples, spikes, payload })
    }
}

/// Chooses the scale of each pixel. Returns the payload at these scales, too.
#[expect(clippy::too_many_arguments, reason = "they are the data of chapter 6; a struct would only rename them")]
fn select(
    rec: &mut Recorder,
    extent: IVec2,
    color: &GpuSignal,
    samples: GpuSamples,
    payload: &Payload,
    plan: &GemPlan,
    keeper: &mut Keeper,
    mut progress: impl FnMut(&mut Recorder, f32) -> Result<()>,
) -> Result<(Selected, Vec<PayloadGroup>)> {
    // Mean variances of the pixels (eq. 6.3). Where halves scale them, they do not require purely random samples.
    plan.variance.begin(rec);
    let variance = input_variance(rec, extent, color, BoxWeight::Even)?;
    keeper.keep(Intermediate::Variance, "scaled_variance", &RGB, Unit::ColorSquared, &variance, 0);

    plan.scales.begin(rec);
    let (pixel, mut selected) = scale_pixel(rec, extent, &color.signal, &variance, &samples)?;
    drop((variance, samples));
    let layers = rec.in_step(PAYLOAD_STEP, |rec| payload_copy(rec, extent, &payload.repaired))?;
    let params = &plan.params;
    let sigmas = params.phase.sigmas();
    let work: f32 = sigmas.iter().sum();
    let mut done = 0.0;
    let mut finer: Option<Scale> = None;
    for (step, &sigma) in (1..).zip(sigmas) {
        let fine = finer.as_ref().unwrap_or(&pixel);
        // Computation of scales and their statistics (6.4).
        let coarse = scale_gaussian(rec, extent, &pixel, sigma)?;
        // Incremental MSE minimisation (6.2.1), from noisy data (6.2.3).
        let stops = Arc::new(scale_stop(rec, extent, fine, &coarse, params.bias_weight())?);
        // Post-processing the filter selection (6.2.4).
        let smoothed = Arc::new(gaussian(rec, extent, &stops, 1, params.outlier_filter(sigma), Averaging::Neighbours)?);
        scale_advance(rec, extent, &mut selected, fine, &coarse, &stops, &smoothed, params.phase.coarser_only())?;
        rec.in_step(PAYLOAD_STEP, |rec| {
            payload.repaired.iter().zip(&layers).try_for_each(|(group, layers)| {
                let (of_payload, planes) = (Gaussian::new(sigma), group.planes);
                let coarse = gaussian(rec, extent, &group.buffer, planes, of_payload, Averaging::Mean)?;
                payload_scale(rec, extent, &selected.choice, sigma, &coarse, layers)
            })
        })?;
        keeper.keep(Intermediate::Stopping, format!("stopping_{step}"), &["V"], Unit::Number, &stops, 0);
        keeper.keep(Intermediate::Stopping, format!("stopping_{step}_smoothed"), &["V"], Unit::Number, &smoothed, 0);
        finer = Some(coarse);
        done += sigma;
        progress(rec, done / work)?;
    }
    Ok((selected, layers))
}

method_plan! {
    /// Plan of GEM.
    pub struct GemPlan of GemParams {
        /// Estimates of variances that the frame lacks; `None` if it lacks none.
        noise: Option<PlannedStep>,
        /// Spikes taken out of the colour.
        spikes: PlannedStep,
        /// The variance of the colour's mean (thesis 8.2).
        variance: PlannedStep,
        /// The scales and their choice (thesis 6.2).
        scales: PlannedStep,
        /// The quantities of the sampling density (thesis 6.3).
        density: PlannedStep,
        /// Layers filtered along with the colour; `None` if the frame has none.
        payload: Option<PlannedStep>,
        /// Pixels without noise put back.
        keep_clean: PlannedStep,
    }
}

/// Plans [`gem`]. Without variance, GEM still smooths its decisions over the pixels around. So a frame without noise is
/// not simply copied.
pub(super) fn plan(params: &GemParams, facts: &Facts, wishes: &Wishes) -> GemPlan {
    let planner = Planner::new(wishes);
    let unasked = [impossible(!wishes.keeps(Intermediate::Density), "it is not asked for")];
    GemPlan {
        params: *params,
        keep: wishes.keep.to_vec(),
        noise: planner.noise(Method::from(*params).pooling(), facts),
        spikes: planner.spikes(params.spikes, facts),
        variance: planner.variance(Method::from(*params).pooling(), facts),
        scales: planner.step("scales", "from fine to coarse", &[]),
        density: planner.step("sampling density", "it is asked for", &unasked).beside_kernels(),
        payload: planner.payload(facts),
        keep_clean: planner.keep_clean(params.keep_clean),
    }
}

impl From<GemParams> for Method {
    fn from(params: GemParams) -> Self {
        Self::Gem(params)
    }
}
