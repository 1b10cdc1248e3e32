//! Error estimates of filtered images (thesis 7.1.2 and 8.4).

use glam::IVec2;

use super::candidate::Candidates;
use super::nlm::Filtered;
use super::sample::RELATIVE_FLOOR;
use super::{per_pixel, plane_bytes};
use crate::error::{Error, Result};
use crate::gpu::{Buffer, Recorder, bindings, uniforms};

uniforms! {
    struct SureParams { extent: IVec2, covariance: f32 }
    struct ErrorDifferenceParams { extent: IVec2, covariance: f32, other_candidate: i32 }
    struct ErrorBlendParams { extent: IVec2, spread: f32, disagreement: f32, own_noise: f32, candidate: i32 }
    struct ErrorSpikesParams { extent: IVec2, spikes: f32 }
    struct ErrorHalvesParams { extent: IVec2, relative_floor: f32 }
}
bindings! {
    struct ErrorSure<'a> {
        uniform params: SureParams, read signal, read variance_of_mean, optional first, optional second, optional third,
        optional derivatives, write errors,
    }
    struct ErrorDifference<'a> {
        uniform params: ErrorDifferenceParams,
        read signal, read variance_of_mean, read blended, read shares, read derivatives, read other,
        read other_derivatives, write differences,
    }
    struct ErrorBlend<'a> {
        uniform params: ErrorBlendParams,
        read blended, read variance_of_mean, read derivatives, optional shares, optional first, optional second,
        optional third, write errors,
    }
    struct ErrorSpikes<'a> { uniform params: ErrorSpikesParams, read spikes, write errors }
    struct ErrorHalves<'a> {
        uniform params: ErrorHalvesParams, read signal, read weights, write errors, optional residual_variance,
    }
}

/// Stein's unbiased risk estimate of the three candidates (eq. 8.5), summed over the channels, in the square of the
/// colour's unit; may be negative. One plane, x: FIRST, y: SECOND, z: THIRD; 0 for those that take no part. The term of
/// the derivative, 2σ²·dF/du, counts `covariance` times; eq. 8.5 has 1.
///
/// # Errors
/// Those of recording; [`Error::Shader`] where the candidates come without derivatives.
pub fn error_sure(
    rec: &mut Recorder,
    extent: IVec2,
    signal: &Buffer,
    variance_of_mean: &Buffer,
    candidates: &Candidates,
    covariance: f32,
) -> Result<Buffer> {
    let errors = rec.take("SURE", plane_bytes(extent, 1))?;
    let [first, second, third] = candidates.buffers();
    let kernel = rec.gpu().kernel::<ErrorSure>("error_sure", &candidates.set().definitions())?;
    let params = SureParams { extent, covariance };
    let bound = ErrorSure {
        params,
        signal,
        variance_of_mean,
        first,
        second,
        third,
        derivatives: candidates.derivatives.as_deref(),
        errors: &errors,
    };
    rec.dispatch(&kernel, &bound, per_pixel(extent))?;
    Ok(errors)
}

/// What the parts of [`error_blend`] and [`error_spikes`] count, as numbers of at least 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ErrorParts {
    /// The squared half spread of the blend.
    pub spread: f32,
    /// The squared distances of the candidates from the blend, by their shares.
    pub disagreement: f32,
    /// σ²·dF/du of the candidates, by their shares.
    pub own_noise: f32,
    /// The squares of what the pixel got of spikes around.
    pub spikes: f32,
}

impl ErrorParts {
    /// What was measured: the squared error of the final image is regressed on the parts, as means of 16×16 pixels of
    /// nine scenes at 8, 32 and 128 samples per pixel, by least squares of the logarithm.
    ///
    /// Root mean square of the base-2 logarithm of estimated over true, averaged over the images: .98 with all parts,
    /// 1.02 without disagreement, .99 without halves, 1.12 without spikes; of SURE 4.6, what is not positive counting
    /// as 2⁻⁶. Each scene with what was fitted to the others: 1.01. On 19 images of low-discrepancy samples, to which
    /// nothing was fitted: .92. Those without halves and of one candidate alone are older: fitted where spikes stayed,
    /// the latter as what the blend needs without disagreement.
    pub const fn measured(has_halves: bool, shared: bool) -> Self {
        let (spread, disagreement, own_noise) = match (has_halves, shared) {
            (true, true) => (1.0, 1.5, 0.5),
            (true, false) => (1.7, 0.0, 0.74),
            (false, true) => (0.0, 2.2, 0.53),
            (false, false) => (0.0, 0.0, 1.2),
        };
        Self { spread, disagreement, own_noise, spikes: 6.0 }
    }
}

/// Of what, and by which shares, a filtered signal was made.
#[derive(Clone, Copy, Debug)]
pub enum MadeOf<'a> {
    /// Of several candidates by these shares. One plane, x: FIRST, y: SECOND, z: THIRD.
    Shares(&'a Buffer),
    /// It is one of the candidates, counted from 0.
    Only(usize),
}

/// The estimated squared error of a blend of candidates, summed over the channels, in the square of the colour's unit;
/// at least 0. Not smoothed. One plane, x.
///
/// # Errors
/// Those of recording; [`Error::Shader`] where the candidates come without derivatives.
pub fn error_blend(
    rec: &mut Recorder,
    extent: IVec2,
    blended: &Buffer,
    variance_of_mean: &Buffer,
    candidates: &Candidates,
    made_of: MadeOf,
    parts: ErrorParts,
) -> Result<Buffer> {
    let errors = rec.take("errors of the blend", plane_bytes(extent, 1))?;
    error_blend_into(rec, extent, blended, variance_of_mean, candidates, made_of, parts, &errors, false)?;
    Ok(errors)
}

/// Adds to the errors of [`error_blend`] what further candidates, that share in the blend too, stand for: their
/// disagreement and own noise.
///
/// # Errors
/// As [`error_blend`].
#[expect(clippy::too_many_arguments, reason = "they are the operator's definition; a struct would only rename them")]
pub fn error_blend_more(
    rec: &mut Recorder,
    extent: IVec2,
    blended: &Buffer,
    variance_of_mean: &Buffer,
    candidates: &Candidates,
    shares: &Buffer,
    parts: ErrorParts,
    errors: Buffer,
) -> Result<Buffer> {
    // The spread of the blend is in the errors already.
    let parts = ErrorParts { spread: 0.0, ..parts };
    error_blend_into(rec, extent, blended, variance_of_mean, candidates, MadeOf::Shares(shares), parts, &errors, true)?;
    Ok(errors)
}

#[expect(clippy::too_many_arguments, reason = "they are the operator's definition; a struct would only rename them")]
fn error_blend_into(
    rec: &mut Recorder,
    extent: IVec2,
    blended: &Buffer,
    variance_of_mean: &Buffer,
    candidates: &Candidates,
    made_of: MadeOf,
    parts: ErrorParts,
    errors: &Buffer,
    added: bool,
) -> Result<()> {
    let Some(derivatives) = candidates.derivatives.as_deref() else {
        return Err(Error::Shader {
            stage: "error_blend".into(),
            problem: "the candidates come without derivatives".into(),
        });
    };
    let (shares, candidate) = match made_of {
        MadeOf::Shares(shares) => (Some(shares), 0),
        MadeOf::Only(candidate) => (None, candidate as i32),
    };
    let [first, second, third] = candidates.buffers().map(|signal| signal.filter(|_| shares.is_some()));
    let ErrorParts { spread, disagreement, own_noise, .. } = parts;
    let params = ErrorBlendParams { extent, spread, disagreement, own_noise, candidate };
    let [with_first, with_second, with_third] = candidates.set().definitions();
    let definitions =
        [("SHARED", shares.is_some().into()), ("ADDED", added.into()), with_first, with_second, with_third];
    let kernel = rec.gpu().kernel::<ErrorBlend>("error_blend", &definitions)?;
    let bound = ErrorBlend { params, blended, variance_of_mean, derivatives, shares, first, second, third, errors };
    rec.dispatch(&kernel, &bound, per_pixel(extent))
}

/// By how much SURE of the only candidate in `other` exceeds SURE of a blend, summed over the channels, in the square
/// of the colour's unit. The blend was made of `candidates` by `shares` (one plane, x: FIRST, y: SECOND, z: THIRD). The
/// last term of SURE counts `covariance` times. One plane, x: the difference, y: its square.
///
/// # Errors
/// Those of recording; [`Error::Shader`] where candidates come without derivatives, or `other` holds none.
#[expect(clippy::too_many_arguments, reason = "they are the operator's definition; a struct would only rename them")]
pub fn error_difference(
    rec: &mut Recorder,
    extent: IVec2,
    signal: &Buffer,
    variance_of_mean: &Buffer,
    blended: &Buffer,
    shares: &Buffer,
    candidates: &Candidates,
    other: &Candidates,
    covariance: f32,
) -> Result<Buffer> {
    let found = (candidates.derivatives.as_deref(), other.derivatives.as_deref(), other.first_of_all());
    let (Some(derivatives), Some(other_derivatives), Some((other_candidate, other))) = found else {
        return Err(Error::Shader {
            stage: "error_difference".into(),
            problem: "the candidates come without derivatives".into(),
        });
    };
    let differences = rec.take("differences of SURE", plane_bytes(extent, 1))?;
    let kernel = rec.gpu().kernel::<ErrorDifference>("error_difference", &[])?;
    let params = ErrorDifferenceParams { extent, covariance, other_candidate: other_candidate as i32 };
    let bound = ErrorDifference {
        params,
        signal,
        variance_of_mean,
        blended,
        shares,
        derivatives,
        other,
        other_derivatives,
        differences: &differences,
    };
    rec.dispatch(&kernel, &bound, per_pixel(extent))?;
    Ok(differences)
}

/// Adds to the errors of [`error_blend`] what spikes around a pixel leave in it: the squares of what it got of each,
/// from the buffer that [`spike_spread`](super::spike::spike_spread) has filled, times what [`ErrorParts::spikes`]
/// says. One that fell elsewhere would have left nothing there.
pub fn error_spikes(
    rec: &mut Recorder,
    extent: IVec2,
    errors: Buffer,
    spikes: &Buffer,
    parts: ErrorParts,
) -> Result<Buffer> {
    let kernel = rec.gpu().kernel::<ErrorSpikes>("error_spikes", &[])?;
    let params = ErrorSpikesParams { extent, spikes: parts.spikes };
    rec.dispatch(&kernel, &ErrorSpikes { params, spikes, errors: &errors }, per_pixel(extent))?;
    Ok(errors)
}

/// The noise left in a filtered signal, and what a sample drawn in each pixel is expected to gain (thesis 7.1.2): the
/// squared relative difference of the two halves times W(p) = Σ w / (1 + n_p), where n_p = Σ w·n are the samples that
/// contribute to the filtered value; the filtered signal has n_p / Σ w in the w of its mean
/// ([`sample_attach`](super::sample::sample_attach)). Where there is a residual variance, it stands for the halves. Not
/// smoothed. One plane, x: the gain, in no unit, y: the squared error summed over the channels, in the square of the
/// colour's unit.
///
/// Measured in the adaptive loop at 32 samples per pixel, three seeds each, against the pixel's own count for n_p: 4 %
/// less error on `dof`, 8 % more on `caustic`, the same within 2 % on `motion`, `soft` and `texture`; on `spikes` the
/// seed decides. So the text decides.
pub fn error_halves(rec: &mut Recorder, extent: IVec2, filtered: &Filtered) -> Result<Buffer> {
    let errors = rec.take("errors of the halves", plane_bytes(extent, 1))?;
    let params = ErrorHalvesParams { extent, relative_floor: RELATIVE_FLOOR };
    let residual_variance = filtered.residual_variance.as_ref();
    let kernel = rec.gpu().kernel::<ErrorHalves>("error_halves", &[("HALVES", residual_variance.is_none().into())])?;
    let bound = ErrorHalves {
        params,
        signal: &filtered.planes,
        weights: &filtered.weights,
        errors: &errors,
        residual_variance,
    };
    rec.dispatch(&kernel, &bound, per_pixel(extent))?;
    Ok(errors)
}
