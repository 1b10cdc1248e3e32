//! Error estimates of filtered images (thesis 8.4).

use glam::IVec2;

use super::candidate::Candidates;
use super::{per_pixel, plane_bytes};
use crate::error::Result;
use crate::gpu::{Buffer, Recorder, bindings, uniforms};

uniforms! { struct SureParams { extent: IVec2 } }
bindings! {
    struct ErrorSure<'a> { uniform params: SureParams, read signal, read variance_of_mean, read first, read second, read third, read derivatives, write errors }
}

/// Stein's unbiased risk estimate of the three candidates (eq. 8.5), summed over the channels, in the square of the colour's unit; may be negative. One plane, x:
/// FIRST, y: SECOND, z: THIRD.
pub fn error_sure(rec: &mut Recorder, extent: IVec2, signal: &Buffer, variance_of_mean: &Buffer, candidates: &Candidates) -> Result<Buffer> {
    let errors = rec.take("SURE", plane_bytes(extent, 1))?;
    let [first, second, third] = &candidates.signals;
    let kernel = rec.gpu().kernel::<ErrorSure>("error_sure", &[])?;
    let params = SureParams { extent };
    let bound = ErrorSure { params, signal, variance_of_mean, first, second, third, derivatives: &candidates.derivatives, errors: &errors };
    rec.dispatch(&kernel, &bound, per_pixel(extent))?;
    Ok(errors)
}
