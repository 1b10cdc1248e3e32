//! Choosing among the candidates and averaging them (thesis 8.4, Algorithm 1 lines 23 to 33), between windows of one
//! frame and of several (8.6), and between the passes (lines 34 to 37).

use glam::{IVec2, IVec4};
use serde::Serialize;

use super::candidate::{Candidates, planes_of_numbers};
use super::candidate_filter::rivals;
use super::gaussian::{Averaging, Gaussian, gaussian};
use super::nlm::Filtered;
use super::{per_pixel, plane_bytes};
use crate::error::Result;
use crate::gpu::{Buffer, Definition, Recorder, bindings, uniforms};
use crate::parameters::{Group, parameters, real};

uniforms! {
    struct SelectLeastParams { extent: IVec2, rivals: [IVec4; 2] }
    struct SelectFramesParams { extent: IVec2, own_sigmas: f32, own_noise: f32 }
    struct SelectPassParams { extent: IVec2, squared_sigmas: f32 }
    struct SelectShareParams {
        extent: IVec2, smoothed_error: f32, smoothed_noise: f32, own_sigmas: f32, own_noise: f32,
    }
    struct SelectBlendParams { extent: IVec2 }
    struct SelectColorOnlyParams { extent: IVec2, pixels: f32, least: f32, most: f32, planes: i32 }
}

bindings! {
    struct SelectLeast<'a> { uniform params: SelectLeastParams, read errors, optional derivatives, write selected }
    struct SelectFrames<'a> {
        uniform params: SelectFramesParams, read signal, read variance_of_mean, read alone, read alone_derivatives,
        write together, write derivatives, read alone_spreads, write spreads,
    }
    struct SelectFramesOfFiltered<'a> {
        uniform params: SelectFramesParams, read signal, read variance_of_mean, read alone, read alone_derivatives,
        write together, write derivatives,
    }
    struct SelectPass<'a> {
        uniform params: SelectPassParams, read pass1, read pass2, read variance_of_mean, write result,
    }
    struct SelectShare<'a> {
        uniform params: SelectShareParams,
        read selected, optional errors, optional sure, optional variance_of_mean, optional means, write selection,
    }
    struct SelectColorOnly<'a> {
        uniform params: SelectColorOnlyParams, read differences, read candidates, read means, read spreads,
        write blended, write shares, write color_only_shares,
    }
    struct SelectBlend<'a> {
        uniform params: SelectBlendParams, optional shares, read means, read spreads, write blended,
    }
}

/// Returns the binary selection maps: 1 for the candidate with the least smoothed error, 0 for the others. On ties the
/// later, more robust candidate wins; a candidate with a rival may win only where its mean derivative is below the
/// rival's; an error that is not finite cannot win. One plane for four candidates, one component for each.
///
/// # Errors
/// [`Error::Shader`](crate::Error::Shader) where candidates with rivals come without derivatives; otherwise as
/// [`Recorder::take`] and [`Recorder::dispatch`].
pub fn select_least(rec: &mut Recorder, extent: IVec2, errors: &Buffer, candidates: &Candidates) -> Result<Buffer> {
    let selected = rec.take("binary selection maps", plane_bytes(extent, planes_of_numbers(candidates.count())))?;
    let rivals = rivals(&candidates.filters);
    let has_rivals = rivals.iter().any(Option::is_some);
    let derivatives = has_rivals.then(|| candidates.derivatives_for("select_least")).transpose()?;
    let mut of_each = [IVec4::splat(-1); 2];
    for (candidate, rival) in rivals.into_iter().enumerate() {
        of_each[candidate / 4][candidate % 4] = rival.map_or(-1, |rival| rival as i32);
    }
    let definitions = [candidates.definition(), ("RIVALS", has_rivals.into())];
    let params = SelectLeastParams { extent, rivals: of_each };
    let bound = SelectLeast { params, errors, derivatives, selected: &selected };
    rec.dispatch("select_least", &definitions, &bound, per_pixel(extent))?;
    Ok(selected)
}

parameters! {
    /// Limits on the candidates that take part in the blend of a pixel: a candidate is left out where it is clearly
    /// worse than another one, by the smoothed errors or by the pixel's own SURE.
    ///
    /// Measured on three renders at 8, 32 and 128 spp. The first pair saves scenes with a visible lamp (relative MSE of
    /// `cornell` at 32 spp 0.038 without, 0.0005 with), the second single clean pixels beside bright noise
    /// (`caustic_ring` at 32 spp 0.018 without, 0.0053 with; `dof_spheres` 0.0033 without, 0.0031 with).
    #[derive(Clone, Copy, Debug, PartialEq, Serialize)]
    pub struct Guard {
        /// A candidate's smoothed error may exceed the winner's by this many times the winner's magnitude, plus
        /// `guard.smoothed_noise`.
        pub smoothed_error: f32 => real(0.0..),
        /// How many times the pixel's variance is added to what `guard.smoothed_error` allows.
        pub smoothed_noise: f32 => real(0.0..),
        /// A candidate's own SURE at the pixel may exceed the least one by this many standard deviations of their
        /// difference, plus `guard.own_noise`.
        pub own_sigmas: f32 => real(0.0..).of("σ"),
        /// How many times the pixel's variance is added to what `guard.own_sigmas` allows.
        pub own_noise: f32 => real(0.0..),
    }
}

impl Default for Guard {
    fn default() -> Self {
        Self { smoothed_error: 4.0, smoothed_noise: 0.3, own_sigmas: 8.0, own_noise: 4.0 }
    }
}

impl Group for Guard {}

/// Harm, beyond the harm that chance explains, from which on a pixel leaves out the frames beside. Measured on a shot
/// with a moving lamp, relative MSE of its middle frames: .00129 and .00103 with 8 standard deviations and 4 times the
/// noise, .00123 and .00095 with these values and with half of them, .0013 and .033 if no frames are left out.
#[derive(Clone, Copy, Debug)]
pub struct Harm {
    /// Standard deviations of the difference in SURE …
    pub sigmas: f32,
    /// … plus this share of the pixel's variance.
    pub noise: f32,
}

impl Harm {
    fn params(self, extent: IVec2) -> SelectFramesParams {
        SelectFramesParams { extent, own_sigmas: self.sigmas, own_noise: self.noise }
    }
}

/// Limits that measured best.
pub const HARM: Harm = Harm { sigmas: 4.0, noise: 1.0 };

/// Inputs of SURE from a pixel's own frame.
#[derive(Clone, Copy, Debug)]
pub struct Noisy<'a> {
    /// Signal of the frame.
    pub signal: &'a Buffer,
    /// Variance of the mean of the signal, one plane.
    pub variance_of_mean: &'a Buffer,
}

/// Replaces pixels of `together`, the candidates filtered over several frames, by pixels of `alone`, the candidates
/// filtered over the own frame, where the pixel's own SURE of `together` is larger by more than `harm` allows.
///
/// # Errors
/// [`Error::Shader`](crate::Error::Shader) where the candidates come without derivatives; otherwise as
/// [`Recorder::dispatch`].
pub fn select_frames(
    rec: &mut Recorder,
    extent: IVec2,
    noisy: Noisy,
    alone: &Candidates,
    together: &Candidates,
    harm: Harm,
) -> Result<()> {
    let Noisy { signal, variance_of_mean } = noisy;
    let bound = SelectFrames {
        params: harm.params(extent),
        signal,
        variance_of_mean,
        alone: &alone.means,
        alone_derivatives: alone.derivatives_for("select_frames")?,
        together: &together.means,
        derivatives: together.derivatives_for("select_frames")?,
        alone_spreads: &alone.spreads,
        spreads: &together.spreads,
    };
    rec.dispatch("select_frames", &[together.definition()], &bound, per_pixel(extent))
}

/// As [`select_frames`], for one filter whose weights do not depend on the noise of the averaged image and whose centre
/// weighs 1.
///
/// # Errors
/// As [`Recorder::dispatch`].
pub fn select_frames_of_filtered(
    rec: &mut Recorder,
    extent: IVec2,
    noisy: Noisy,
    alone: &Filtered,
    together: &Filtered,
    harm: Harm,
) -> Result<()> {
    let Noisy { signal, variance_of_mean } = noisy;
    let bound = SelectFramesOfFiltered {
        params: harm.params(extent),
        signal,
        variance_of_mean,
        alone: &alone.planes,
        alone_derivatives: &alone.weights,
        together: &together.planes,
        derivatives: &together.weights,
    };
    let definitions = [("CANDIDATES", Definition::Int(1)), ("WEIGHT_SUMS", true.into())];
    rec.dispatch("select_frames", &definitions, &bound, per_pixel(extent))
}

/// Images from which the shares of the candidates are computed.
#[derive(Clone, Copy, Debug)]
pub struct Evidence<'a> {
    /// The binary selection maps.
    pub selected: &'a Buffer,
    /// Smoothed SURE, laid out as the maps: one plane for four candidates, one component for each.
    pub errors: &'a Buffer,
    /// SURE as computed, laid out as the maps.
    pub sure: &'a Buffer,
    /// Variance of the pixel mean, one plane.
    pub variance_of_mean: &'a Buffer,
    /// Candidates to average.
    pub candidates: &'a Candidates,
}

/// Turns `smoothed`, the smoothed selection maps of the candidates, into their shares, in place. The shares sum to 1; a
/// guard, if there is one, leaves candidates out. One plane for four candidates, one component for each.
///
/// # Errors
/// As [`Recorder::dispatch`].
pub fn select_share(
    rec: &mut Recorder,
    extent: IVec2,
    smoothed: Buffer,
    evidence: Evidence,
    guard: Option<Guard>,
) -> Result<Buffer> {
    let Evidence { selected, errors, sure, variance_of_mean, candidates } = evidence;
    let definitions = [candidates.definition(), ("GUARDED", guard.is_some().into())];
    let guarded = |buffer| guard.map(|_| buffer);
    let (errors, sure, variance_of_mean) = (guarded(errors), guarded(sure), guarded(variance_of_mean));
    let means = guarded(&candidates.means);
    let rule = guard.map(|guard| [guard.smoothed_error, guard.smoothed_noise, guard.own_sigmas, guard.own_noise]);
    let [smoothed_error, smoothed_noise, own_sigmas, own_noise] = rule.unwrap_or_default();
    let params = SelectShareParams { extent, smoothed_error, smoothed_noise, own_sigmas, own_noise };
    let bound = SelectShare { params, selected, errors, sure, variance_of_mean, means, selection: &smoothed };
    rec.dispatch("select_share", &definitions, &bound, per_pixel(extent))?;
    Ok(smoothed)
}

/// Averages the candidates by their shares; without shares, the only candidate is the average. A signal; the blended Σ
/// w in the w of the mean.
///
/// # Errors
/// As [`Recorder::take`] and [`Recorder::dispatch`].
pub fn select_blend(
    rec: &mut Recorder,
    extent: IVec2,
    shares: Option<&Buffer>,
    candidates: &Candidates,
) -> Result<Buffer> {
    let blended = rec.take("blend", plane_bytes(extent, 2))?;
    let definitions = [candidates.definition(), ("SHARED", shares.is_some().into())];
    let Candidates { means, spreads, .. } = candidates;
    let bound = SelectBlend { params: SelectBlendParams { extent }, shares, means, spreads, blended: &blended };
    rec.dispatch("select_blend", &definitions, &bound, per_pixel(extent))?;
    Ok(blended)
}

/// Returns the signal `pass2`, except for pixels whose mean differs from the mean of `pass1` by more than `sigmas`
/// standard deviations of the noise that the pixel may have; these pixels are copied from `pass1`. The noise is the
/// `variance_of_mean` of the input plus the squared spread of `pass1`. Distances and variances are summed over the
/// channels.
///
/// # Errors
/// As [`Recorder::take`] and [`Recorder::dispatch`].
pub fn select_pass(
    rec: &mut Recorder,
    extent: IVec2,
    pass1: &Buffer,
    pass2: &Buffer,
    variance_of_mean: &Buffer,
    sigmas: f32,
) -> Result<Buffer> {
    let result = rec.take("selected pass", plane_bytes(extent, 2))?;
    let params = SelectPassParams { extent, squared_sigmas: sigmas * sigmas };
    rec.dispatch(
        "select_pass",
        &[],
        &SelectPass { params, pass1, pass2, variance_of_mean, result: &result },
        per_pixel(extent),
    )?;
    Ok(result)
}

/// Significance with which the filter by the colour only must be better.
#[derive(Clone, Copy, Debug)]
pub struct Significance {
    /// Gaussian that averages the differences of SURE over the pixels around.
    pub smoothing: Gaussian,
    /// Number of standard errors of the average difference from which on the filter gets a share …
    pub least: f32,
    /// … and from which on the filter gets the whole pixel.
    pub most: f32,
}

impl Significance {
    /// Values that measured best. On a blurred edge under features without blur, the error falls to a seventh. Without
    /// information about the noise of their features, `cornell`, `dof_spheres` and `caustic_ring` at 8, 32 and 128 spp
    /// have between 0.4 % less error and 0.4 % more.
    pub const MEASURED: Self = Self { smoothing: Gaussian { sigma: 3.0, radius: 9 }, least: 1.5, most: 3.0 };
}

/// A blend of candidates in which the filter by the colour only takes part.
#[derive(Debug)]
pub struct WithColorOnly {
    /// A signal; the blended Σ w in the w of the mean.
    pub blended: Buffer,
    /// One plane, x: the share of that filter, from 0 to 1.
    pub shares: Buffer,
}

/// Gives the only candidate in `color_only` a share where `differences` (see
/// [`error_difference`](super::error::error_difference)) show that its error is significantly less than the error of
/// `blend`. `blend` is a signal, made of this many candidates by their `shares`; the shares are scaled to the rest.
///
/// # Errors
/// As [`Recorder::dispatch`].
#[expect(clippy::too_many_arguments, reason = "they are the operator's definition; a struct would only rename them")]
pub fn select_color_only(
    rec: &mut Recorder,
    extent: IVec2,
    differences: &Buffer,
    blend: &Buffer,
    candidates: usize,
    color_only: &Candidates,
    shares: &Buffer,
    significance: Significance,
) -> Result<WithColorOnly> {
    let Significance { smoothing, least, most } = significance;
    let differences = &gaussian(rec, extent, differences, 1, smoothing, Averaging::Mean)?;
    let blended = rec.take("blend with the colour only", plane_bytes(extent, 2))?;
    let color_only_shares = rec.take("shares of the colour only", plane_bytes(extent, 1))?;
    // Σ w² of the Gaussian is 1/(4πσ²).
    let pixels = 4.0 * std::f32::consts::PI * smoothing.sigma * smoothing.sigma;
    let planes = planes_of_numbers(candidates) as i32;
    let params = SelectColorOnlyParams { extent, pixels, least, most, planes };
    let bound = SelectColorOnly {
        params,
        differences,
        candidates: blend,
        means: &color_only.means,
        spreads: &color_only.spreads,
        blended: &blended,
        shares,
        color_only_shares: &color_only_shares,
    };
    rec.dispatch("select_color_only", &[], &bound, per_pixel(extent))?;
    Ok(WithColorOnly { blended, shares: color_only_shares })
}
