//! Variances of the mean, pooled over pixels that are alike: from the sample variances if the renderer gives them,
//! otherwise from the difference between the halves of each pixel.
//!
//! The halves of one pixel measure its noise with one degree of freedom. Pixels of one kind, by colour and by features,
//! have about the same noise, so that about a hundred of them give an estimate of it. Measured on twenty renders,
//! denoising with this estimate leaves 1.02 times the error that denoising leaves with the renderer's own sample
//! variance.

use glam::{IVec2, Vec4};

use super::feature::{MAX_GROUPS, Packing, Slot};
use super::gaussian::Gaussian;
use super::variance::LEAST_NOISE;
use super::{per_pixel, per_run, plane_bytes};
use crate::error::Result;
use crate::gpu::{Buffer, Definition, Recorder, bindings, uniforms};

uniforms! {
    struct NoiseParams {
        extent: IVec2,
        darker: f32,
        least_magnitude: f32,
        guess_exponent: f32,
        guess_radius: i32,
        feature_radius: i32,
        window_radius: i32,
        gate: f32,
        largest_distance: f32,
        squared_feature_k: f32,
        feature_tau: f32,
        least_noise: f32,
        pooled_share: f32,
        triple_weights: [Vec4; MAX_GROUPS],
    }
    struct NoiseFeatureParams { extent: IVec2, radius: i32, group: i32, single: i32 }
    struct NoiseHighpassParams { extent: IVec2, groups: IVec2 }
    struct NoiseResidualParams {
        extent: IVec2, fit_radius: i32, ridge: f32, fitted_share: f32, largest: f32, scale: f32,
    }
    struct NoiseHoldParams { extent: IVec2, jump_radius: i32, jump: f32, least_magnitude: f32, radius: i32 }
    struct NoiseUnpackParams { extent: IVec2, plane: i32, single: i32 }
}

bindings! {
    struct NoiseMagnitude<'a> { uniform params: NoiseParams, around signal, write relative_spread }
    struct NoiseGuess<'a> { uniform params: NoiseParams, around relative_spread, write guess }
    struct NoiseFeature<'a> {
        uniform params: NoiseFeatureParams, around signal, optional_around sample_variance, change features,
    }
    struct NoisePool<'a> {
        uniform params: NoiseParams, around signal, around guess, optional_around features,
        optional_around sample_variance, write pooled_variance,
    }
    struct NoiseHighpass<'a> {
        uniform params: NoiseHighpassParams,
        around signal,
        read relative_spread,
        optional_around features,
        write highpass,
    }
    struct NoiseResidual<'a> {
        uniform params: NoiseResidualParams, read signal, around highpass, write residual, change relative_spread,
    }
    struct NoiseJump<'a> {
        uniform params: NoiseHoldParams, around relative_spread, read pooled_variance, write relative_variance,
    }
    struct NoiseHold<'a> {
        uniform params: NoiseHoldParams, read relative_spread, around relative_variance, write variance,
    }
    struct NoiseUnpack<'a> { uniform params: NoiseUnpackParams, read pooled_variance, write variance }
}

/// Rule for which pixels are pooled, and how.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NoiseRule {
    /// Largest ratio of the brightness around a pixel to its own brightness; a larger ratio is cut to this one.
    pub darker: f32,
    /// Least brightness by which noise is divided for a comparison. The frame's median is of the order of 1.
    pub least_magnitude: f32,
    /// Gaussian that smooths the squared half spreads, in parts of the brightness around, to a first guess.
    pub guess: Gaussian,
    /// Half width of the box over which the noise of features is averaged, in pixels.
    pub feature_radius: u32,
    /// Half width of the window, in pixels.
    pub window_radius: u32,
    /// Ratio of the brightness around two pixels above which they are of different kinds.
    pub gate: f32,
    /// Distance above which pixels are of different kinds.
    pub largest_distance: f32,
    /// k_f of the features.
    pub feature_k: f32,
    /// τ of the features, in squares of the unit range.
    pub feature_tau: f32,
    /// Weight of the pooled variance, relative to a weight of 1 for the variance of the pixel's own halves.
    pub pooled_share: f32,
}

impl NoiseRule {
    /// Rule for two halves. Measured: with half of `pooled_share`, or of `feature_k`, `cornell` at 32 spp has 3 % more
    /// error, `dof_spheres` at 128 spp 4 %, `cycles_interior` 2 %.
    pub const HALVES: Self = Self {
        darker: 4.0,
        least_magnitude: 1e-3,
        guess: Gaussian { sigma: 2.0, radius: 5 },
        feature_radius: 2,
        window_radius: 7,
        gate: 16.0,
        largest_distance: 12.0,
        feature_k: 1.2,
        feature_tau: 0.01,
        pooled_share: 8.0,
    };

    /// Rule for sample variances beside two halves. Measured at 8, 32 and 128 spp, pooling them leaves .96, 1.00 and
    /// .99 of the error of `cornell`, .98, .99 and 1.00 of `dof_spheres`, .86, .92 and .89 of `caustic_ring`.
    pub const VARIANCE: Self = Self { gate: 4.0, ..Self::HALVES };

    /// Rule for noise that is estimated from an image alone, which is rougher.
    pub const IMAGE: Self = Self { gate: 4.0, feature_k: 0.6, ..Self::HALVES };

    fn params(&self, extent: IVec2, features: Option<&NoisyFeatures>) -> NoiseParams {
        NoiseParams {
            extent,
            darker: self.darker,
            least_magnitude: self.least_magnitude,
            guess_exponent: self.guess.exponent(),
            guess_radius: self.guess.radius as i32,
            feature_radius: self.feature_radius as i32,
            window_radius: self.window_radius as i32,
            gate: self.gate,
            largest_distance: self.largest_distance,
            squared_feature_k: self.feature_k * self.feature_k,
            feature_tau: self.feature_tau,
            least_noise: LEAST_NOISE,
            pooled_share: self.pooled_share,
            triple_weights: features.map_or([Vec4::ZERO; MAX_GROUPS], |features| features.packing.triple_weights()),
        }
    }
}

/// Features as they were rendered, on the GPU, by which pixels are compared.
#[derive(Debug)]
pub struct NoisyFeatures {
    /// Three planes per group: value, variance, half spread.
    pub buffer: Buffer,
    /// Group and component of each feature.
    pub packing: Packing,
    /// Whether the noise of the features is pooled as well; `false` at first.
    pub are_pooled: bool,
}

impl NoisyFeatures {
    /// Takes a buffer for features with these numbers of channels. [`noise_feature`] fills it, in any order in which
    /// the triple of a group comes before its single.
    ///
    /// # Errors
    /// As [`Recorder::take`].
    pub fn take(rec: &mut Recorder, extent: IVec2, channels: &[u32]) -> Result<Self> {
        let packing = Packing::new(channels);
        Ok(Self {
            buffer: rec.take("noisy features", plane_bytes(extent, 3 * packing.groups))?,
            packing,
            are_pooled: false,
        })
    }
}

/// Writes one feature (unit range, two planes) to its slot, with the variance that its halves show in a small box, or
/// with the `sample_variance` if it has no halves.
///
/// # Errors
/// As [`Recorder::dispatch`].
pub fn noise_feature(
    rec: &mut Recorder,
    extent: IVec2,
    features: &NoisyFeatures,
    slot: Slot,
    signal: &Buffer,
    sample_variance: Option<&Buffer>,
    rule: &NoiseRule,
) -> Result<()> {
    let Slot { group, single } = slot;
    let params =
        NoiseFeatureParams { extent, radius: rule.feature_radius as i32, group: group as i32, single: single.into() };
    let definitions = [("VARIANCE", sample_variance.is_some().into()), ("PIXELS", Definition::Int(PIXELS as i32))];
    // The front of the packed features holds their values, which are copied from the pixel itself.
    let bound = NoiseFeature {
        params,
        signal: signal.within(rule.feature_radius).but_for_the_front(),
        sample_variance: sample_variance.map(|buffer| buffer.within(rule.feature_radius).but_for_the_front()),
        features: features.buffer.in_parts(),
    };
    rec.dispatch("noise_feature", &definitions, &bound, per_run(extent, PIXELS))
}

/// Pooled variances.
#[derive(Debug)]
pub struct Pooled {
    /// Variance of the colour's mean in the first plane; behind it one plane per group of features, if their noise is
    /// pooled.
    pub buffer: Buffer,
}

/// Pools the noise of a colour, and of the features of the same pixels, over pixels that are alike: averages the
/// standard deviations that these pixels claim, and squares the mean. A pixel claims the magnitude of its half spread;
/// for the colour it claims the square root of `sample_variance` (one plane, s²/n), if there is one. The result blends
/// in the pixel's own variance: by half with a `sample_variance`, by little without.
///
/// Pixels whose noise is less than a thousandth of their value keep their own variance.
///
/// # Errors
/// As [`Recorder::dispatch`].
pub fn noise_pool(
    rec: &mut Recorder,
    extent: IVec2,
    signal: &Buffer,
    sample_variance: Option<&Buffer>,
    features: Option<&NoisyFeatures>,
    rule: &NoiseRule,
) -> Result<Pooled> {
    let relative_spread = noise_magnitude(rec, extent, signal, rule)?;
    pool(rec, extent, signal, &relative_spread, sample_variance, features, rule)
}

/// Pools as [`noise_pool`] does, with the `relative_spread` that [`noise_magnitude`] returned.
fn pool(
    rec: &mut Recorder,
    extent: IVec2,
    signal: &Buffer,
    relative_spread: &Buffer,
    sample_variance: Option<&Buffer>,
    features: Option<&NoisyFeatures>,
    rule: &NoiseRule,
) -> Result<Pooled> {
    let params = rule.params(extent, features);
    let groups = features.map_or(0, |features| features.packing.groups);
    let pools_features = features.is_some_and(|features| features.are_pooled);
    let buffer = rec.take("pooled variance", plane_bytes(extent, if pools_features { 1 + groups } else { 1 }))?;
    let guess = &rec.take("first guess of the variance", plane_bytes(extent, 1))?;

    rec.dispatch(
        "noise_guess",
        &[("PIXELS", Definition::Int(PIXELS as i32))],
        &NoiseGuess { params, relative_spread: relative_spread.within(rule.guess.radius).front(), guess },
        per_run(extent, PIXELS),
    )?;
    // The values of more than two groups would not fit into registers.
    let pixels = if groups <= 2 { PIXELS } else { 1 };
    let definitions = [
        ("FEATURE_GROUPS", Definition::Int(groups as i32)),
        ("FEATURE_NOISE", pools_features.into()),
        ("PIXELS", Definition::Int(pixels as i32)),
        ("VARIANCE", sample_variance.is_some().into()),
    ];
    rec.dispatch(
        "noise_pool",
        &definitions,
        &NoisePool {
            params,
            signal: signal.within(rule.window_radius),
            guess: guess.within(rule.window_radius),
            features: features.map(|features| features.buffer.within(rule.window_radius)),
            sample_variance: sample_variance.map(|buffer| buffer.within(rule.window_radius)),
            pooled_variance: &buffer,
        },
        per_run(extent, pixels),
    )?;
    Ok(Pooled { buffer })
}

/// Number of adjacent pixels in a row that one invocation computes, where neighbours share loads.
const PIXELS: u32 = 4;

/// Returns two planes. The first holds the half spread of a colour in parts of the magnitude, which is the brightness
/// around each pixel, and the magnitude in w. The second holds the median brightness of the 3×3 pixels in x.
fn noise_magnitude(rec: &mut Recorder, extent: IVec2, signal: &Buffer, rule: &NoiseRule) -> Result<Buffer> {
    let relative_spread = rec.take("relative half spread", plane_bytes(extent, 2))?;
    let params = rule.params(extent, None);
    let bound = NoiseMagnitude { params, signal: signal.within(1), relative_spread: &relative_spread };
    rec.dispatch("noise_magnitude", &[], &bound, per_pixel(extent))?;
    Ok(relative_spread)
}

/// Rule for estimating noise from an image alone.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImageRule {
    /// Half width of the window over which features are fitted to the colour, in pixels.
    pub fit_radius: u32,
    /// Ridge of the fit: added to the diagonal of its normal equations, in parts of the sum of its weights.
    pub ridge: f32,
    /// Weight of the residual of the fit in its geometric mean with the difference without a fit. Measured at 32 spp:
    /// with one half, `dof_spheres`, whose features are noisy, has 5 % more error; with 0, `cycles_interior`, whose
    /// wood the features explain, has 2 % more.
    pub fitted_share: f32,
    /// The largest noise of a pixel that is no brighter than its neighbours, in magnitudes.
    pub largest: f32,
    /// Brightness jumps where medians within `jump_radius` pixels differ by this factor.
    pub jump: f32,
    /// Half width of the box in which `jump` compares medians, in pixels.
    pub jump_radius: u32,
    /// Half width of the box by which the variance near a jump is judged, in pixels.
    pub hold_radius: u32,
    /// Rule for which pixels are pooled.
    pub pool: NoiseRule,
}

impl ImageRule {
    /// Values that measured best.
    pub const DEFAULT: Self = Self {
        fit_radius: 4,
        ridge: 1e-3,
        fitted_share: 0.2,
        largest: 3.0,
        jump: 100.0,
        jump_radius: 2,
        hold_radius: 4,
        pool: NoiseRule::IMAGE,
    };
}

/// Factor that brings the lesser of the two residuals of Gaussian noise to the size of a half spread: E|D| = σ·√(2/π).
///
/// Each residual has the variance 1.5·σ², and their correlation is 2/3. For two normal variables with variance 1 and
/// correlation ρ, E min(|a|, |b|) = √(2/π)·(2 − (√(2 + 2ρ) + √(2 − 2ρ))/2).
const RESIDUAL_SCALE: f32 = 1.202_67;

/// Estimates the variance of a colour from the image alone: the difference by which pixels stand out from their
/// neighbours counts as noise and is pooled. `explaining` holds the indices of the features of three channels that may
/// explain such differences, at most two. One plane.
///
/// # Errors
/// As [`Recorder::dispatch`].
pub fn noise_of_image(
    rec: &mut Recorder,
    extent: IVec2,
    signal: &Buffer,
    features: Option<&NoisyFeatures>,
    explaining: &[usize],
    rule: &ImageRule,
) -> Result<Buffer> {
    let slot = |index: &usize| features.map(|features| features.packing.slots[*index]).filter(|slot| !slot.single);
    let groups: Vec<i32> = explaining.iter().filter_map(slot).map(|slot| slot.group as i32).take(2).collect();
    let regressors = [("REGRESSORS", Definition::Int(groups.len() as i32))];
    let of_group = |index: usize| groups.get(index).copied().unwrap_or(0);
    let bytes = |planes: u32| plane_bytes(extent, planes);

    let relative_spread = &noise_magnitude(rec, extent, signal, &rule.pool)?;
    let highpass = &rec.take("what pixels stand out by", bytes(2 + 2 * groups.len() as u32))?;
    let params = NoiseHighpassParams { extent, groups: IVec2::new(of_group(0), of_group(1)) };
    let buffer = features.filter(|_| !groups.is_empty()).map(|features| &features.buffer);
    rec.dispatch(
        "noise_highpass",
        &regressors,
        &NoiseHighpass {
            params,
            signal: signal.within(1).front(),
            relative_spread,
            features: buffer.map(|values| values.within(1).front()),
            highpass,
        },
        per_pixel(extent),
    )?;
    let residual = &rec.take("colour and its residual", bytes(2))?;
    let ImageRule { fit_radius, ridge, fitted_share, largest, jump, jump_radius, hold_radius, pool } = *rule;
    let params = NoiseResidualParams {
        extent,
        fit_radius: fit_radius as i32,
        ridge,
        fitted_share,
        largest,
        scale: RESIDUAL_SCALE,
    };
    rec.dispatch(
        "noise_residual",
        &regressors,
        &NoiseResidual {
            params,
            signal,
            // Without features nothing is fitted.
            highpass: highpass.within(if groups.is_empty() { 0 } else { fit_radius }),
            residual,
            relative_spread: relative_spread.within(0).front(),
        },
        per_pixel(extent),
    )?;

    let pooled_variance = &self::pool(rec, extent, residual, relative_spread, None, features, &pool)?.buffer;
    let relative_variance = &rec.take("relative variance", bytes(1))?;
    let variance = rec.take("variance of an image", bytes(1))?;
    let params = NoiseHoldParams {
        extent,
        jump_radius: jump_radius as i32,
        jump,
        least_magnitude: pool.least_magnitude,
        radius: hold_radius as i32,
    };
    rec.dispatch(
        "noise_jump",
        &[],
        &NoiseJump {
            params,
            // The medians.
            relative_spread: relative_spread.within(jump_radius).back(),
            pooled_variance,
            relative_variance,
        },
        per_pixel(extent),
    )?;
    rec.dispatch(
        "noise_hold",
        &[],
        &NoiseHold {
            params,
            relative_spread,
            relative_variance: relative_variance.within(hold_radius),
            variance: &variance,
        },
        per_pixel(extent),
    )?;
    Ok(variance)
}

/// Returns the pooled variance of the feature in this slot, or of the colour, as a plane of its own.
///
/// # Errors
/// As [`Recorder::dispatch`].
pub fn noise_unpack(rec: &mut Recorder, extent: IVec2, pooled: &Pooled, slot: Option<Slot>) -> Result<Buffer> {
    let variance = rec.take("pooled variance of one", plane_bytes(extent, 1))?;
    let (plane, single) = slot.map_or((0, false), |Slot { group, single }| (1 + group, single));
    let params = NoiseUnpackParams { extent, plane: plane as i32, single: single.into() };
    rec.dispatch(
        "noise_unpack",
        &[],
        &NoiseUnpack { params, pooled_variance: &pooled.buffer, variance: &variance },
        per_pixel(extent),
    )?;
    Ok(variance)
}
