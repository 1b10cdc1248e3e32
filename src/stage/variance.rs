//! Variances of the pixel mean (thesis 7.1.1, 8.2 and 8.3).

use glam::IVec2;
use serde::Serialize;

use super::gaussian::Gaussian;
use super::{per_pixel, per_run, plane_bytes};
use crate::error::Result;
use crate::gpu::{Buffer, Definition, Recorder, bindings, uniforms};
use crate::parameters::choices;

uniforms! {
    struct VarianceScaleParams { extent: IVec2, radius: i32 }
    struct VariancePairParams { extent: IVec2 }
    struct VarianceClampParams { extent: IVec2 }
    struct VarianceFloorParams { extent: IVec2, own: f32, around: f32, absolute: f32 }
    struct VarianceSmoothParams { extent: IVec2, radius: i32, exponent: f32 }
}

bindings! {
    struct VarianceRows<'a> {
        uniform params: VarianceScaleParams,
        around signal,
        around sample_variance,
        write spread_rows,
        write sample_rows,
    }
    struct VarianceScale<'a> {
        uniform params: VarianceScaleParams, around spread_rows, around sample_rows, read sample_variance,
        write scaled_variance,
    }
    struct VariancePairStage<'a> {
        uniform params: VariancePairParams, read signal, around sample_variance, write two_buffer_variance,
        write uncertainty,
    }
    struct VarianceClamp<'a> {
        uniform params: VarianceClampParams, read variance, read upper_bound, write clamped_variance,
    }
    struct VarianceFloor<'a> {
        uniform params: VarianceFloorParams,
        around signal,
        read variance,
        write floored_variance,
    }
    struct VarianceSmooth<'a> {
        uniform params: VarianceSmoothParams, around signal, write smoothed_variance, optional upper_bound,
    }
}

/// Number of neighbouring pixels that one invocation of the box sums computes: their boxes share most of their pixels.
const BOX_PIXELS: u32 = 4;

choices! {
    /// Weight of the pixels of a box whose variances are scaled to the differences of their halves.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
    #[serde(rename_all = "lowercase")]
    pub enum BoxWeight {
        /// Equal weights (thesis 8.2). An outlier whose halves agree by accident takes the variance of all other pixels
        /// in its box away; an outlier whose halves differ lends them its own.
        Even => "even",
        /// One over the standard deviation that the pixel claims. Measured on 46 images, `dfc` has 1.6 % less error on
        /// average (15 % less to 9 % more), on 18 `nlm` 1.9 % (11 % less to 3 % more). `gem` would have 1 % less too,
        /// but loses on extreme frames, and keeps equal weights. A pixel that came out with little variance counts more
        /// than it should: for Gaussian noise, by the moments of χ², the ratio is some 15 % high at 8 samples per pixel
        /// and 3 % at 32.
        Deviation => "deviation",
    }
}

/// Scales `sample_variance` (one plane, s²/n) to the magnitude of the two-buffer variance: multiplies it by the ratio
/// of the means of spread² and of sample variance over a box of 2·`radius`+1 pixels; 0 where the box holds no sample
/// variance (thesis 8.2). One plane.
///
/// # Errors
/// As [`Recorder::take`] and [`Recorder::dispatch`].
pub fn variance_scale(
    rec: &mut Recorder,
    extent: IVec2,
    signal: &Buffer,
    sample_variance: &Buffer,
    radius: u32,
    weight: BoxWeight,
) -> Result<Buffer> {
    let params = VarianceScaleParams { extent, radius: radius as i32 };
    let bytes = plane_bytes(extent, 1);
    let scaled_variance = rec.take("scaled variance", bytes)?;
    let spread_rows = &rec.take("box sums of spread²", bytes)?;
    let sample_rows = &rec.take("box sums of sample variance", bytes)?;
    let [width, height, _] = per_pixel(extent);
    let pixels = ("PIXELS", Definition::Int(BOX_PIXELS as i32));
    rec.dispatch(
        "variance_rows",
        &[pixels, ("BY_DEVIATION", (weight == BoxWeight::Deviation).into())],
        &VarianceRows {
            params,
            signal: signal.within_columns_and_rows(radius, 0).back(),
            sample_variance: sample_variance.within_columns_and_rows(radius, 0),
            spread_rows,
            sample_rows,
        },
        per_run(extent, BOX_PIXELS),
    )?;
    let bound = VarianceScale {
        params,
        spread_rows: spread_rows.within_columns_and_rows(0, radius),
        sample_rows: sample_rows.within_columns_and_rows(0, radius),
        sample_variance,
        scaled_variance: &scaled_variance,
    };
    rec.dispatch("variance_scale", &[pixels], &bound, [width, height.div_ceil(BOX_PIXELS), 1])?;
    Ok(scaled_variance)
}

/// Smooths the residual two-buffer variance of a filtered signal (thesis 8.3: σ = 0.5 pixels).
pub const RESIDUAL_SMOOTHING: Gaussian = Gaussian { sigma: 0.5, radius: 2 };

/// Smooths the two-buffer variance of an input that has no sample variance. Measured on `cornell`, `dof_spheres` and
/// `caustic_ring` with σ = 1, 2, 3: 1 leaves spikes that claim no variance, 3 blurs it over edges.
pub const INPUT_SMOOTHING: Gaussian = Gaussian { sigma: 2.0, radius: 5 };

/// Returns the two-buffer variance of a signal, spread², smoothed with a normalised Gaussian over the existing pixels,
/// and held below `upper_bound` if one is given. One plane.
///
/// # Errors
/// As [`Recorder::take`] and [`Recorder::dispatch`].
pub fn variance_smooth(
    rec: &mut Recorder,
    extent: IVec2,
    signal: &Buffer,
    gaussian: Gaussian,
    upper_bound: Option<&Buffer>,
) -> Result<Buffer> {
    let params = VarianceSmoothParams { extent, radius: gaussian.radius as i32, exponent: gaussian.exponent() };
    let smoothed_variance = rec.take("two-buffer variance", plane_bytes(extent, 1))?;
    let signal = signal.within(gaussian.radius).back();
    let bound = VarianceSmooth { params, signal, smoothed_variance: &smoothed_variance, upper_bound };
    rec.dispatch("variance_smooth", &[("CLAMPED", upper_bound.is_some().into())], &bound, per_pixel(extent))?;
    Ok(smoothed_variance)
}

/// Inputs for filtering the two-buffer variance of a signal by its sample variance (thesis 7.1.1).
#[derive(Debug)]
pub struct VariancePair {
    /// Two-buffer variance of the mean of both halves, spread². One plane.
    pub two_buffer_variance: Buffer,
    /// Variance of the sample variance, estimated over the 3×3 pixels around. One plane.
    pub uncertainty: Buffer,
}

/// Returns the two-buffer variance and the uncertainty of `sample_variance` (one plane, s²/n).
///
/// The source takes the squared difference of the halves' own sample variances as the uncertainty; files do not have
/// these. Measured on six renders, the variance over 3×3 pixels is as good as the variance for Gaussian samples,
/// 2Σ²/(n−1), multiplied by four or sixteen for the kurtosis of rendered samples, and better than that variance itself.
///
/// # Errors
/// As [`Recorder::take`] and [`Recorder::dispatch`].
pub fn variance_pair(
    rec: &mut Recorder,
    extent: IVec2,
    signal: &Buffer,
    sample_variance: &Buffer,
) -> Result<VariancePair> {
    let two_buffer_variance = rec.take("two-buffer variance", plane_bytes(extent, 1))?;
    let uncertainty = rec.take("variance of the sample variance", plane_bytes(extent, 1))?;
    let params = VariancePairParams { extent };
    let bound = VariancePairStage {
        params,
        signal,
        sample_variance: sample_variance.within(1),
        two_buffer_variance: &two_buffer_variance,
        uncertainty: &uncertainty,
    };
    rec.dispatch("variance_pair", &[], &bound, per_pixel(extent))?;
    Ok(VariancePair { two_buffer_variance, uncertainty })
}

/// Holds a variance below an upper bound, channel by channel. One plane each.
///
/// # Errors
/// As [`Recorder::take`] and [`Recorder::dispatch`].
pub fn variance_clamp(rec: &mut Recorder, extent: IVec2, variance: &Buffer, upper_bound: &Buffer) -> Result<Buffer> {
    let clamped_variance = rec.take("clamped variance", plane_bytes(extent, 1))?;
    let bound = VarianceClamp {
        params: VarianceClampParams { extent },
        variance,
        upper_bound,
        clamped_variance: &clamped_variance,
    };
    rec.dispatch("variance_clamp", &[], &bound, per_pixel(extent))?;
    Ok(clamped_variance)
}

/// Noise below which a pixel counts as almost without noise: its standard deviation in parts of its value.
pub const LEAST_NOISE: f32 = 1e-3;

/// Lower bound of a variance, so that eq. 7.4 does not divide by zero: its ε.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Floor {
    /// The square of [`LEAST_NOISE`] times a brightness: the largest magnitude of any channel in the pixel, or a
    /// ten-thousandth of the largest magnitude in the 3×3 pixels around it if that is more. For radiance, whose dark
    /// parts count as much as its bright ones. Measured at 8 spp against the ε of 10⁻¹⁰: `cornell` has 0.9 % less
    /// error, `caustic_ring` 0.1 % more. With less, a few pixels beside the lamp of `cornell` decide, and it has up to
    /// 6 % more; with three times as much around, `caustic_ring` has 2 % more.
    Relative,
    /// The square of 10⁻⁵ times the brightness around the pixel: the ε of eq. 7.4, where the brightness is of the order
    /// of 1.
    Printed,
    /// (10⁻⁵)²: for features in unit range.
    Absolute,
}

impl Floor {
    /// Returns the floor of the colour's variance. Where pixels without noise are kept, noise below a thousandth of the
    /// value needs no distinction.
    pub fn of_color(keep_clean: bool) -> Self {
        if keep_clean { Self::Relative } else { Self::Printed }
    }
}

/// Holds the variance of a signal above a floor, channel by channel. One plane; its w is the brightness around each
/// pixel, as defined in [`Floor::Relative`], from which the candidates take the least step of their finite differences.
///
/// # Errors
/// As [`Recorder::dispatch`].
pub fn variance_floor(
    rec: &mut Recorder,
    extent: IVec2,
    signal: &Buffer,
    variance: &Buffer,
    floor: Floor,
) -> Result<Buffer> {
    let (own, around, absolute) = match floor {
        Floor::Relative => (LEAST_NOISE, 1e-4, 0.0),
        Floor::Printed => (0.0, 1e-5, 0.0),
        Floor::Absolute => (0.0, 0.0, 1e-5),
    };
    let floored_variance = rec.take("floored variance", plane_bytes(extent, 1))?;
    let params = VarianceFloorParams { extent, own, around, absolute };
    rec.dispatch(
        "variance_floor",
        &[],
        &VarianceFloor { params, signal: signal.within(1).front(), variance, floored_variance: &floored_variance },
        per_pixel(extent),
    )?;
    Ok(floored_variance)
}
