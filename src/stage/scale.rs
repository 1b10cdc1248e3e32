//! Choosing among the pixel filter and Gaussians of growing scale (thesis chapter 6).

use glam::IVec2;

use super::gaussian::{Averaging, Gaussian, gaussian};
use super::sample::{GpuSamples, RELATIVE_FLOOR};
use super::{per_pixel, plane_bytes};
use crate::error::Result;
use crate::gpu::{Buffer, Recorder, bindings, uniforms};

uniforms! {
    struct ScalePixelParams { extent: IVec2, samples_per_pixel: f32 }
    struct ScaleStopParams { extent: IVec2, bias_factor: f32, bias_weight: f32 }
    struct ScaleAdvanceParams { extent: IVec2, sigma: f32 }
    struct ScaleReductionParams { extent: IVec2, relative_floor: f32 }
}

bindings! {
    struct ScalePixel<'a> {
        uniform params: ScalePixelParams,
        read input, read variance_of_mean, optional samples, write signal, write variance, write selected, write choice,
    }
    struct ScaleStop<'a> {
        uniform params: ScaleStopParams, read fine, read fine_variance, read coarse, read coarse_variance, write stops,
    }
    struct ScaleAdvance<'a> {
        uniform params: ScaleAdvanceParams,
        read stops, read smoothed, read fine_variance, read coarse, read coarse_variance, write selected, write choice,
    }
    struct ScaleReduction<'a> { uniform params: ScaleReductionParams, read selected, read choice, write reduction }
}

/// The image at one scale.
#[derive(Debug)]
pub struct Scale {
    /// σ of its Gaussian in pixels; 0 for the pixel filter.
    pub sigma: f32,
    /// A signal; the w of the mean holds the mean number of samples per pixel, 0 if it is unknown.
    pub signal: Buffer,
    /// One plane: the variance of the mean; w holds 1 / number of pixels that take part.
    pub variance: Buffer,
}

/// Selection of a scale in each pixel, so far.
#[derive(Debug)]
pub struct Selected {
    /// Signal at the selected scale of each pixel. The w of the mean holds the number of pixels that take part: 1/Σw²
    /// of the normalised weights. Other methods store Σ w there.
    pub signal: Buffer,
    /// One plane. x: σ of the selected scale in pixels, y: 1 while coarser scales may follow, z: estimated squared
    /// error, summed over the channels, w: number of samples that take part.
    pub choice: Buffer,
}

/// Returns the finest scale, the pixel filter, and the selection that starts with it (thesis 6.4). A count of 0 in
/// `samples` is unknown.
///
/// # Errors
/// As [`Recorder::take`] and [`Recorder::dispatch`].
pub fn scale_pixel(
    rec: &mut Recorder,
    extent: IVec2,
    signal: &Buffer,
    variance_of_mean: &Buffer,
    samples: &GpuSamples,
) -> Result<(Scale, Selected)> {
    let pixel = Scale {
        sigma: 0.0,
        signal: rec.take("pixel filter", plane_bytes(extent, 2))?,
        variance: rec.take("its variance", plane_bytes(extent, 1))?,
    };
    let selected = Selected {
        signal: rec.take("selected scale", plane_bytes(extent, 2))?,
        choice: rec.take("choice of scale", plane_bytes(extent, 1))?,
    };
    let (samples_per_pixel, samples) = samples.parts();
    let bound = ScalePixel {
        params: ScalePixelParams { extent, samples_per_pixel },
        input: signal,
        variance_of_mean,
        samples,
        signal: &pixel.signal,
        variance: &pixel.variance,
        selected: &selected.signal,
        choice: &selected.choice,
    };
    rec.dispatch("scale_pixel", &[("SAMPLES_VARY", samples.is_some().into())], &bound, per_pixel(extent))?;
    Ok((pixel, selected))
}

/// Returns the image at a coarser scale: means and half spreads are filtered by a Gaussian, variances by its square
/// (eq. 6.2), which holds where pixels are independent.
///
/// # Errors
/// As [`gaussian`].
pub fn scale_gaussian(rec: &mut Recorder, extent: IVec2, pixel: &Scale, sigma: f32) -> Result<Scale> {
    let signal = gaussian(rec, extent, &pixel.signal, 2, Gaussian::new(sigma), Averaging::Mean)?;
    let variance = gaussian(rec, extent, &pixel.variance, 1, Gaussian::new(sigma), Averaging::Variance)?;
    Ok(Scale { sigma, signal, variance })
}

/// Returns the binary stopping map of a pair of scales: 1 where the selector (eq. 6.1) is positive, so that the fine
/// scale has less error. The bias term is weighted by `bias_weight` and by 1 − 1/n for n samples per pixel (thesis
/// 6.2.3), or by 1 if n is unknown. For the step from the pixel filter, the bias term is (c − f)². One plane, x: the
/// map, y: the weighted bias term, summed over the channels.
///
/// # Errors
/// As [`Recorder::take`] and [`Recorder::dispatch`].
pub fn scale_stop(rec: &mut Recorder, extent: IVec2, fine: &Scale, coarse: &Scale, bias_weight: f32) -> Result<Buffer> {
    let [fine_squared, coarse_squared] = [fine.sigma * fine.sigma, coarse.sigma * coarse.sigma];
    // The pixel filter is unbiased (thesis 6.4): with σ = 0, the quotient is 1 by itself.
    let bias_factor = (coarse_squared + fine_squared) / (coarse_squared - fine_squared);
    let stops = rec.take("stopping map", plane_bytes(extent, 1))?;
    let bound = ScaleStop {
        params: ScaleStopParams { extent, bias_factor, bias_weight },
        fine: &fine.signal,
        fine_variance: &fine.variance,
        coarse: &coarse.signal,
        coarse_variance: &coarse.variance,
        stops: &stops,
    };
    rec.dispatch("scale_stop", &[], &bound, per_pixel(extent))?;
    Ok(stops)
}

/// Moves the pixels of `selected` that have reached the fine scale on to the coarse one. Pixels whose map `stops` is 1
/// after smoothing and rounding (thesis 6.2.4) stay at their scale for good. With `coarser_only`, a map value that
/// smoothing turned from 0 to 1 counts as 0 (thesis 6.4).
///
/// # Errors
/// As [`Recorder::dispatch`].
#[expect(clippy::too_many_arguments, reason = "they are the operator's definition; a struct would only rename them")]
pub fn scale_advance(
    rec: &mut Recorder,
    extent: IVec2,
    selected: &mut Selected,
    fine: &Scale,
    coarse: &Scale,
    stops: &Buffer,
    smoothed: &Buffer,
    coarser_only: bool,
) -> Result<()> {
    let bound = ScaleAdvance {
        params: ScaleAdvanceParams { extent, sigma: coarse.sigma },
        stops,
        smoothed,
        fine_variance: &fine.variance,
        coarse: &coarse.signal,
        coarse_variance: &coarse.variance,
        selected: &selected.signal,
        choice: &selected.choice,
    };
    rec.dispatch("scale_advance", &[("COARSER_ONLY", coarser_only.into())], &bound, per_pixel(extent))
}

/// Returns the parts of the reduction of relative MSE by new samples (thesis 6.3). One plane, x: relative MSE, y:
/// samples in the filter's support, 0 if unknown, z: σ of the filter in pixels.
///
/// # Errors
/// As [`Recorder::take`] and [`Recorder::dispatch`].
pub fn scale_reduction(rec: &mut Recorder, extent: IVec2, selected: &Selected) -> Result<Buffer> {
    let reduction = rec.take("reduction of relative MSE", plane_bytes(extent, 1))?;
    let params = ScaleReductionParams { extent, relative_floor: RELATIVE_FLOOR };
    let bound = ScaleReduction { params, selected: &selected.signal, choice: &selected.choice, reduction: &reduction };
    rec.dispatch("scale_reduction", &[], &bound, per_pixel(extent))?;
    Ok(reduction)
}
