//! What the methods have in common.

use std::sync::Arc;

use glam::IVec2;

use super::GpuSignal;
use super::estimate::Lane;
use super::plan::PlannedStep;
use super::spikes::Found;
use crate::error::Result;
use crate::gpu::{Buffer, Recorder};
use crate::stage::keep_clean::{CleanRule, Input, keep_clean};
use crate::stage::nlm::Guide;
use crate::stage::spike::light_return;
use crate::stage::variance::{BoxWeight, Floor, INPUT_SMOOTHING, variance_floor, variance_scale, variance_smooth};

/// Half width of the box over which variances are brought to scale (thesis 8.2: 21×21), in pixels.
pub(super) const SCALE_RADIUS: u32 = 10;

/// The window radius beyond which work and halos make no sense any more, in pixels.
pub(super) const LARGEST_WINDOW_RADIUS: u32 = 64;
/// The largest patch radius: a window of distances of 2f+1 rows lives in registers.
pub(crate) const LARGEST_PATCH_RADIUS: u32 = 5;

/// A filter by colour patches alone.
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

/// The variance of the mean as the filters want it (thesis 8.2), from what there is.
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

/// The variance of the mean as distances want it: [`input_variance`], held above a floor.
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

/// A result in which pixels of the colour without noise are as they were, if the step runs, and in which lights of
/// few pixels are, if anybody looked for any; `error` becomes that of what is kept. `color` is without spikes and
/// lights.
pub(super) fn with_input_kept(
    rec: &mut Recorder,
    extent: IVec2,
    color: &GpuSignal,
    found: Option<&Found>,
    mut result: Arc<Buffer>,
    error: Option<&Lane>,
    clean: &PlannedStep,
) -> Result<Arc<Buffer>> {
    let errors = error.map(|lane| (&*lane.buffer, lane.component));
    if clean.runs {
        clean.begin(rec);
        let input = Input { signal: &color.signal, sample_variance: color.variance_of_mean.as_deref() };
        result = Arc::new(keep_clean(rec, extent, input, &result, errors, CleanRule::DEFAULT)?);
    }
    if let Some(found) = found {
        result = Arc::new(light_return(rec, extent, &found.lights, &result, errors)?);
    }
    Ok(result)
}
