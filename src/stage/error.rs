//! Error estimates of filtered images (thesis 7.1.2 and 8.4).

use glam::IVec2;

use super::candidate::{Candidates, planes_of_numbers};
use super::nlm::Filtered;
use super::sample::RELATIVE_FLOOR;
use super::{per_pixel, plane_bytes};
use crate::error::Result;
use crate::gpu::{Buffer, Recorder, bindings, uniforms};

uniforms! {
    struct SureParams { extent: IVec2, covariance: f32 }
    struct ErrorDifferenceParams { extent: IVec2, covariance: f32 }
    struct ErrorBlendParams { extent: IVec2, spread: f32, disagreement: f32, own_noise: f32 }
    struct ErrorSpikesParams { extent: IVec2, spikes: f32 }
    struct ErrorHalvesParams { extent: IVec2, relative_floor: f32 }
}
bindings! {
    struct ErrorSure<'a> {
        uniform params: SureParams, read signal, read variance_of_mean, read means, read derivatives,
        write errors,
    }
    struct ErrorDifference<'a> {
        uniform params: ErrorDifferenceParams,
        read signal, read variance_of_mean, read blended, read shares, read derivatives, read other_means,
        read other_derivatives, write differences,
    }
    struct ErrorBlend<'a> {
        uniform params: ErrorBlendParams, read blended, read variance_of_mean, read derivatives, optional shares,
        optional means, write errors,
    }
    struct ErrorSpikes<'a> { uniform params: ErrorSpikesParams, read spikes, write errors }
    struct ErrorHalves<'a> {
        uniform params: ErrorHalvesParams, read signal, read weights, write errors, optional residual_variance,
    }
}

/// Returns Stein's unbiased risk estimate of the candidates (eq. 8.5), summed over the channels, in the square of the
/// colour's unit; may be negative. One plane for four candidates, one component for each; 0 in components that no
/// candidate has. The term of the derivative, 2σ²·dF/du, counts `covariance` times; eq. 8.5 has 1.
///
/// # Errors
/// Errors of the recorder; [`Error::Shader`](crate::Error::Shader) where the candidates come without derivatives.
pub fn error_sure(
    rec: &mut Recorder,
    extent: IVec2,
    signal: &Buffer,
    variance_of_mean: &Buffer,
    candidates: &Candidates,
    covariance: f32,
) -> Result<Buffer> {
    let derivatives = candidates.derivatives_for("error_sure")?;
    let errors = rec.take("SURE", plane_bytes(extent, planes_of_numbers(candidates.count())))?;
    let (params, means) = (SureParams { extent, covariance }, &*candidates.means);
    let bound = ErrorSure { params, signal, variance_of_mean, means, derivatives, errors: &errors };
    rec.dispatch("error_sure", &[candidates.definition()], &bound, per_pixel(extent))?;
    Ok(errors)
}

/// Weights of the parts of [`error_blend`] and [`error_spikes`], each at least 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ErrorParts {
    /// The squared half spread of the blend.
    pub spread: f32,
    /// The squared distances of the candidates from the blend, by their shares.
    pub disagreement: f32,
    /// σ²·dF/du of the candidates, by their shares.
    pub own_noise: f32,
    /// The squares of the amounts that the pixel got from the spikes around it.
    pub spikes: f32,
}

impl ErrorParts {
    /// Returns the measured weights: the squared error of the final image is regressed on the parts, as means of 16×16
    /// pixels of nine scenes at 8, 32 and 128 samples per pixel, by least squares of the logarithm.
    ///
    /// Root mean square of the base-2 logarithm of estimated over true, averaged over the images: .98 with all parts,
    /// 1.02 without disagreement, .99 without halves, 1.12 without spikes; 4.6 for SURE, where values that are not
    /// positive count as 2⁻⁶. With each scene estimated by weights fitted to the others: 1.01. On 19 images of
    /// low-discrepancy samples, to which nothing was fitted: .92. The weights without halves and the weights for one
    /// candidate alone are older: they were fitted while spikes stayed in the image, the latter as the blend needs them
    /// without disagreement.
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

/// Returns the estimated squared error of a blend of candidates, summed over the channels, in the square of the
/// colour's unit; at least 0. Not smoothed. One plane, x. `shares` are those of the candidates, as
/// [`select_share`](super::select::select_share) returns them; without shares, the only candidate is the blend.
///
/// # Errors
/// Errors of the recorder; [`Error::Shader`](crate::Error::Shader) where the candidates come without derivatives.
pub fn error_blend(
    rec: &mut Recorder,
    extent: IVec2,
    blended: &Buffer,
    variance_of_mean: &Buffer,
    candidates: &Candidates,
    shares: Option<&Buffer>,
    parts: ErrorParts,
) -> Result<Buffer> {
    let errors = rec.take("errors of the blend", plane_bytes(extent, 1))?;
    error_blend_into(rec, extent, blended, variance_of_mean, candidates, shares, parts, &errors, false)?;
    Ok(errors)
}

/// Adds to the errors of [`error_blend`] the parts of further candidates that also share in the blend: their
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
    error_blend_into(rec, extent, blended, variance_of_mean, candidates, Some(shares), parts, &errors, true)?;
    Ok(errors)
}

#[expect(clippy::too_many_arguments, reason = "they are the operator's definition; a struct would only rename them")]
fn error_blend_into(
    rec: &mut Recorder,
    extent: IVec2,
    blended: &Buffer,
    variance_of_mean: &Buffer,
    candidates: &Candidates,
    shares: Option<&Buffer>,
    parts: ErrorParts,
    errors: &Buffer,
    added: bool,
) -> Result<()> {
    let derivatives = candidates.derivatives_for("error_blend")?;
    let ErrorParts { spread, disagreement, own_noise, .. } = parts;
    let params = ErrorBlendParams { extent, spread, disagreement, own_noise };
    let definitions = [candidates.definition(), ("SHARED", shares.is_some().into()), ("ADDED", added.into())];
    let means = shares.map(|_| &*candidates.means);
    let bound = ErrorBlend { params, blended, variance_of_mean, derivatives, shares, means, errors };
    rec.dispatch("error_blend", &definitions, &bound, per_pixel(extent))
}

/// Returns by how much SURE of the only candidate in `other` exceeds SURE of a blend, summed over the channels, in the
/// square of the colour's unit. The blend was made of `candidates` by `shares`. The last term of SURE counts
/// `covariance` times. One plane, x: the difference, y: its square.
///
/// # Errors
/// Errors of the recorder; [`Error::Shader`](crate::Error::Shader) where candidates come without derivatives.
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
    let derivatives = candidates.derivatives_for("error_difference")?;
    let differences = rec.take("differences of SURE", plane_bytes(extent, 1))?;
    let params = ErrorDifferenceParams { extent, covariance };
    let bound = ErrorDifference {
        params,
        signal,
        variance_of_mean,
        blended,
        shares,
        derivatives,
        other_means: &other.means,
        other_derivatives: other.derivatives_for("error_difference")?,
        differences: &differences,
    };
    rec.dispatch("error_difference", &[candidates.definition()], &bound, per_pixel(extent))?;
    Ok(differences)
}

/// Adds to the errors of [`error_blend`] the error that spikes around a pixel leave in it: the squares of the amounts
/// that the pixel got from each, from the buffer that [`spike_spread`](super::spike::spike_spread) has filled, times
/// [`ErrorParts::spikes`]. A spike that had fallen elsewhere would have left nothing in the pixel.
///
/// # Errors
/// As [`Recorder::dispatch`].
pub fn error_spikes(
    rec: &mut Recorder,
    extent: IVec2,
    errors: Buffer,
    spikes: &Buffer,
    parts: ErrorParts,
) -> Result<Buffer> {
    let params = ErrorSpikesParams { extent, spikes: parts.spikes };
    rec.dispatch("error_spikes", &[], &ErrorSpikes { params, spikes, errors: &errors }, per_pixel(extent))?;
    Ok(errors)
}

/// Returns the gain to be expected from a sample drawn in each pixel (thesis 7.1.2), and the noise left in a filtered
/// signal. The gain is the squared relative difference of the two halves times W(p) = Σ w / (1 + n_p), where n_p = Σ
/// w·n is the number of samples that contribute to the filtered value; the filtered signal holds n_p / Σ w in the w of
/// its mean ([`sample_attach`](super::sample::sample_attach)). A residual variance, if there is one, replaces the
/// halves. Not smoothed. One plane, x: the gain, in no unit, y: the squared error summed over the channels, in the
/// square of the colour's unit.
///
/// Measured in the adaptive loop at 32 samples per pixel, three seeds each, compared with the pixel's own count as n_p:
/// 4 % less error on `dof`, 8 % more on `caustic`, the same within 2 % on `motion`, `soft` and `texture`; on `spikes`
/// the result depends on the seed. So the code keeps to the text of the thesis.
///
/// # Errors
/// As [`Recorder::take`] and [`Recorder::dispatch`].
pub fn error_halves(rec: &mut Recorder, extent: IVec2, filtered: &Filtered) -> Result<Buffer> {
    let errors = rec.take("errors of the halves", plane_bytes(extent, 1))?;
    let params = ErrorHalvesParams { extent, relative_floor: RELATIVE_FLOOR };
    let residual_variance = filtered.residual_variance.as_ref();
    let bound = ErrorHalves {
        params,
        signal: &filtered.planes,
        weights: &filtered.weights,
        errors: &errors,
        residual_variance,
    };
    rec.dispatch("error_halves", &[("HALVES", residual_variance.is_none().into())], &bound, per_pixel(extent))?;
    Ok(errors)
}
