//! Error estimates of filtered images (thesis 7.1.2 and 8.4).

use glam::IVec2;

use super::candidate::Candidates;
use super::nlm::Filtered;
use super::sample::{GpuSamples, RELATIVE_FLOOR};
use super::{per_pixel, plane_bytes};
use crate::error::Result;
use crate::gpu::{Buffer, Recorder, bindings, uniforms};

uniforms! {
    struct SureParams { extent: IVec2 }
    struct ErrorHalvesParams { extent: IVec2, samples_per_pixel: f32, relative_floor: f32 }
}
bindings! {
    struct ErrorSure<'a> { uniform params: SureParams, read signal, read variance_of_mean, read first, read second, read third, read derivatives, write sure }
    struct ErrorHalves<'a> { uniform params: ErrorHalvesParams, read signal, read weights, write errors, optional residual_variance, optional samples }
}

/// Stein's unbiased risk estimate of the three candidates (eq. 8.5), summed over the channels, in the square of the colour's unit; may be negative. One plane, x:
/// FIRST, y: SECOND, z: THIRD.
pub fn error_sure(rec: &mut Recorder, extent: IVec2, signal: &Buffer, variance_of_mean: &Buffer, candidates: &Candidates) -> Result<Buffer> {
    let sure = rec.take("SURE", plane_bytes(extent, 1))?;
    let [first, second, third] = &candidates.signals;
    let kernel = rec.gpu().kernel::<ErrorSure>("error_sure", &[])?;
    let params = SureParams { extent };
    let bound = ErrorSure { params, signal, variance_of_mean, first, second, third, derivatives: &candidates.derivatives, sure: &sure };
    rec.dispatch(&kernel, &bound, per_pixel(extent))?;
    Ok(sure)
}

/// The noise left in a filtered signal, and what a sample drawn in each pixel is expected to gain (thesis 7.1.2): the squared relative difference of the two halves times
/// W(p) = Σ w / (1 + n_p), n_p the samples of the pixel. Where there is a residual variance, it stands for the halves. Not smoothed. One plane, x: the gain, in no unit,
/// y: the squared error summed over the channels, in the square of the colour's unit.
pub fn error_halves(rec: &mut Recorder, extent: IVec2, filtered: &Filtered, samples: &GpuSamples) -> Result<Buffer> {
    let errors = rec.take("errors of the halves", plane_bytes(extent, 1))?;
    let (samples_per_pixel, samples) = samples.parts();
    let params = ErrorHalvesParams { extent, samples_per_pixel, relative_floor: RELATIVE_FLOOR };
    let residual_variance = filtered.residual_variance.as_ref();
    let definitions = [("SAMPLES_VARY", samples.is_some().into()), ("HALVES", residual_variance.is_none().into())];
    let kernel = rec.gpu().kernel::<ErrorHalves>("error_halves", &definitions)?;
    let bound = ErrorHalves { params, signal: &filtered.planes, weights: &filtered.weights, errors: &errors, residual_variance, samples };
    rec.dispatch(&kernel, &bound, per_pixel(extent))?;
    Ok(errors)
}
