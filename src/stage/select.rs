//! Choosing among the candidates and averaging them (thesis 8.4, Algorithm 1 lines 23 to 33).

use glam::IVec2;
use serde::Serialize;

use super::candidate::Candidates;
use super::{per_pixel, plane_bytes};
use crate::error::Result;
use crate::gpu::{Buffer, Recorder, bindings, uniforms};

uniforms! {
    struct SelectLeastParams { extent: IVec2 }
    struct SelectBlendParams { extent: IVec2, guard_error: f32, guard_noise: f32 }
}

bindings! {
    struct SelectLeast<'a> { uniform params: SelectLeastParams, read errors, read derivatives, write selected }
    struct SelectBlend<'a> {
        uniform params: SelectBlendParams,
        read smoothed, read selected, read errors, read variance_of_mean, read first, read second, read third, write selection, write blended,
    }
}

/// Binary selection maps: 1 for the candidate with the least smoothed error, 0 for the others. On ties the later, more robust one wins; FIRST may win only where its
/// mean derivative is below SECOND's; an error that is not finite cannot win. One plane, x: FIRST, y: SECOND, z: THIRD.
pub fn select_least(rec: &mut Recorder, extent: IVec2, errors: &Buffer, derivatives: &Buffer) -> Result<Buffer> {
    let selected = rec.take("binary selection maps", plane_bytes(extent, 1))?;
    let kernel = rec.gpu().kernel::<SelectLeast>("select_least", &[])?;
    let bound = SelectLeast { params: SelectLeastParams { extent }, errors, derivatives, selected: &selected };
    rec.dispatch(&kernel, &bound, per_pixel(extent))?;
    Ok(selected)
}

/// Which candidates may take part in the blend of a pixel: those whose smoothed error e exceeds the winner's by at most
/// `error_factor`·|e_winner| + `noise_factor`·Σ_i σ_i².
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Guard {
    /// Share of the winner's error, at least 0.
    pub error_factor: f32,
    /// Share of the pixel's variance, at least 0.
    pub noise_factor: f32,
}

/// The average of the candidates.
#[derive(Debug)]
pub struct Blend {
    /// One plane: shares of FIRST, SECOND and THIRD (sum 1), and in w the blended error Σ share·error, in the square of the colour's unit.
    pub selection: Buffer,
    /// A signal; the blended Σ w in the w of the mean.
    pub signal: Buffer,
}

/// Averages the candidates by the smoothed selection maps, normalised to sum 1, under a guard if there is one.
#[expect(clippy::too_many_arguments, reason = "they are the operator's definition; a struct would only rename them")]
pub fn select_blend(
    rec: &mut Recorder,
    extent: IVec2,
    smoothed: &Buffer,
    selected: &Buffer,
    errors: &Buffer,
    variance_of_mean: &Buffer,
    candidates: &Candidates,
    guard: Option<Guard>,
) -> Result<Blend> {
    let selection = rec.take("selection maps", plane_bytes(extent, 1))?;
    let signal = rec.take("blend", plane_bytes(extent, 2))?;
    let [first, second, third] = &candidates.signals;
    // A negative factor tells the shader that there is no guard.
    let guard = guard.unwrap_or(Guard { error_factor: -1.0, noise_factor: 0.0 });
    let params = SelectBlendParams { extent, guard_error: guard.error_factor, guard_noise: guard.noise_factor };
    let kernel = rec.gpu().kernel::<SelectBlend>("select_blend", &[])?;
    let bound = SelectBlend { params, smoothed, selected, errors, variance_of_mean, first, second, third, selection: &selection, blended: &signal };
    rec.dispatch(&kernel, &bound, per_pixel(extent))?;
    Ok(Blend { selection, signal })
}
