//! Code that the methods share.

use std::sync::Arc;

use glam::IVec2;

use super::GpuSignal;
use super::estimate::Lane;
use super::payload::Payload;
use super::plan::PlannedStep;
use super::spikes::Found;
use crate::error::Result;
use crate::gpu::{Buffer, Recorder};
use crate::stage::keep_clean::{CleanRule, Input, keep_clean};
use crate::stage::nlm::Guide;
use crate::stage::payload::{MixShare, PAYLOAD_STEP, PayloadGroup, payload_mix};
use crate::stage::spike::light_return;
use crate::stage::variance::{BoxWeight, Floor, INPUT_SMOOTHING, variance_floor, variance_scale, variance_smooth};

/// Half width of the box over which variances are scaled (thesis 8.2: 21×21), in pixels.
pub(super) const SCALE_RADIUS: u32 = 10;

/// Largest window radius, in pixels. A larger window would cost far more work and memory than it gains.
pub(super) const LARGEST_WINDOW_RADIUS: u32 = 64;
/// Largest patch radius, in pixels: the last 2f+1 distances live in registers.
pub(crate) const LARGEST_PATCH_RADIUS: u32 = 5;

/// A filter that compares patches of the colour and nothing else.
pub(super) struct Auxiliary {
    pub(super) window_radius: u32,
    pub(super) patch_radius: u32,
    pub(super) k: f32,
}

impl Auxiliary {
    pub(super) fn guide<'a>(&self, signal: &'a Buffer, variance_of_mean: &'a Buffer, channels: u32) -> Guide<'a> {
        Guide::new(signal, variance_of_mean, channels, self.k, self.patch_radius)
    }
}

/// Returns the variance of the mean that the filters use (thesis 8.2), from the statistics that the signal has.
pub(super) fn input_variance(
    rec: &mut Recorder,
    extent: IVec2,
    signal: &GpuSignal,
    weight: BoxWeight,
) -> Result<Arc<Buffer>> {
    let variance = match (&signal.variance_of_mean, signal.has_halves) {
        (Some(sample_variance), true) => {
            variance_scale(rec, extent, &signal.signal, sample_variance, SCALE_RADIUS, weight)?
        }
        (None, _) => variance_smooth(rec, extent, &signal.signal, INPUT_SMOOTHING, None)?,
        (Some(sample_variance), false) => return Ok(sample_variance.clone()),
    };
    Ok(Arc::new(variance))
}

/// Returns the variance of the mean that distances use: [`input_variance`], held above a floor.
pub(super) fn guide_variance(
    rec: &mut Recorder,
    extent: IVec2,
    signal: &GpuSignal,
    weight: BoxWeight,
    floor: Floor,
) -> Result<Arc<Buffer>> {
    let variance = input_variance(rec, extent, signal, weight)?;
    Ok(Arc::new(variance_floor(rec, extent, &signal.signal, &variance, floor)?))
}

/// Returns the result with some pixels as they were in the input: pixels without noise, if the plan runs that step, and
/// lights of few pixels, if the method looked for them. `error` is changed to the error of these pixels. `color` is the
/// input without spikes and lights, `payload` the layers that are filtered along with it. The layers in `result` keep
/// the same pixels.
#[expect(clippy::too_many_arguments, reason = "they are the data of the last steps; a struct would only rename them")]
pub(super) fn with_input_kept(
    rec: &mut Recorder,
    extent: IVec2,
    color: &GpuSignal,
    payload: &Payload,
    found: Option<&Found>,
    result: (Arc<Buffer>, Vec<PayloadGroup>),
    error: Option<&Lane>,
    clean: &PlannedStep,
) -> Result<(Arc<Buffer>, Vec<PayloadGroup>)> {
    let (mut result, mut layers) = result;
    let errors = error.map(|lane| (&*lane.buffer, lane.component));
    if clean.runs {
        clean.begin(rec);
        let input = Input { signal: &color.signal, sample_variance: color.variance_of_mean.as_deref() };
        result = Arc::new(keep_clean(rec, extent, input, &result, errors, CleanRule::DEFAULT)?);
        layers = rec.in_step(PAYLOAD_STEP, |rec| {
            payload_mix(rec, extent, payload.repaired.clone(), layers, MixShare::OfSignal(&result))
        })?;
    }
    if let Some(found) = found {
        result = Arc::new(light_return(rec, extent, &found.lights, &result, errors)?);
        layers = rec.in_step(PAYLOAD_STEP, |rec| {
            payload_mix(rec, extent, layers, payload.means(), MixShare::OfSignal(&result))
        })?;
    }
    Ok((result, layers))
}
