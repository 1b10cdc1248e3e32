//! The variance of the mean where no renderer gives one: pooled over pixels that are alike, from what the halves of each
//! differ by.
//!
//! One pixel's halves tell its noise with one degree of freedom. Pixels of one kind, by colour and by features, have
//! about the same noise, so that some hundred of them make an estimate of it. Measured on twenty renders, denoising
//! with this estimate leaves 1.02 times the error that it leaves with the renderer's own sample variance.

use glam::{IVec2, Vec4};

use super::feature::{MAX_GROUPS, Packing, Slot};
use super::gaussian::Gaussian;
use super::{per_pixel, plane_bytes};
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
        pooled_share: f32,
        triple_weights: [Vec4; MAX_GROUPS],
    }
    struct NoiseFeatureParams { extent: IVec2, radius: i32, group: i32, single: i32 }
    struct NoiseUnpackParams { extent: IVec2, plane: i32, single: i32 }
}

bindings! {
    struct NoiseMagnitude<'a> { uniform params: NoiseParams, read signal, write relative_spread }
    struct NoiseGuess<'a> { uniform params: NoiseParams, read relative_spread, write guess }
    struct NoiseFeature<'a> { uniform params: NoiseFeatureParams, read signal, optional sample_variance, write features }
    struct NoisePool<'a> { uniform params: NoiseParams, read signal, read guess, optional features, write pooled_variance }
    struct NoiseUnpack<'a> { uniform params: NoiseUnpackParams, read pooled_variance, write variance }
}

/// Which pixels are pooled, and how.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NoiseRule {
    /// How many times brighter than itself a pixel takes its surroundings to be at the most.
    pub darker: f32,
    /// The least brightness that noise is compared by. The frame's median is of the order of 1.
    pub least_magnitude: f32,
    /// Smooths the squared half spreads, in parts of the brightness around, to a first guess.
    pub guess: Gaussian,
    /// Half width of the box over which the noise of features is averaged, in pixels.
    pub feature_radius: u32,
    /// Half width of the window, in pixels.
    pub window_radius: u32,
    /// Pixels whose surroundings are that much brighter or darker are of another kind.
    pub gate: f32,
    /// The distance from which on pixels are of another kind.
    pub largest_distance: f32,
    /// k_f of the features.
    pub feature_k: f32,
    /// τ of the features, in squares of the unit range.
    pub feature_tau: f32,
    /// How often what was pooled counts, against once what the pixel's own halves say.
    pub pooled_share: f32,
}

impl NoiseRule {
    /// Of two halves.
    pub const HALVES: Self = Self {
        darker: 4.0,
        least_magnitude: 1e-3,
        guess: Gaussian { sigma: 2.0, radius: 5 },
        feature_radius: 2,
        window_radius: 7,
        gate: 16.0,
        largest_distance: 12.0,
        feature_k: 0.6,
        feature_tau: 0.01,
        pooled_share: 4.0,
    };

    /// How far a pixel's variance depends on what is around it, in pixels.
    pub const fn reach(&self) -> u32 {
        let guess = self.guess.radius + 1;
        self.window_radius + if guess > self.feature_radius { guess } else { self.feature_radius }
    }

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
            pooled_share: self.pooled_share,
            triple_weights: features.map_or([Vec4::ZERO; MAX_GROUPS], |features| features.packing.triple_weights()),
        }
    }
}

/// Features as they were rendered, on the GPU, to compare pixels by.
#[derive(Debug)]
pub struct NoisyFeatures {
    /// Three planes per group: value, variance, half spread.
    pub buffer: Buffer,
    /// Who sits where.
    pub packing: Packing,
}

impl NoisyFeatures {
    /// Room for features with these numbers of channels, to be filled by [`noise_feature`], in any order except that a
    /// group's triple comes before its single.
    pub fn take(rec: &mut Recorder, extent: IVec2, channels: &[u32]) -> Result<Self> {
        let packing = Packing::new(channels);
        Ok(Self { buffer: rec.take("noisy features", plane_bytes(extent, 3 * packing.groups))?, packing })
    }
}

/// Writes one feature (unit range, two planes) to its slot, with the variance that its halves show in a small box, or
/// the `sample_variance` where it has no halves.
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
    let params = NoiseFeatureParams { extent, radius: rule.feature_radius as i32, group: group as i32, single: single.into() };
    let kernel = rec.gpu().kernel::<NoiseFeature>("noise_feature", &[("VARIANCE", sample_variance.is_some().into())])?;
    rec.dispatch(&kernel, &NoiseFeature { params, signal, sample_variance, features: &features.buffer }, per_pixel(extent))
}

/// Variances that were pooled.
#[derive(Debug)]
pub struct Pooled {
    /// Of the colour's mean in the first plane; behind it one plane per group of features.
    pub buffer: Buffer,
}

/// Pools the squared half spread of a colour, and of the features of the same pixels, over pixels that are alike.
///
/// # Errors
/// As [`Recorder::dispatch`].
pub fn noise_pool(rec: &mut Recorder, extent: IVec2, signal: &Buffer, features: Option<&NoisyFeatures>, rule: &NoiseRule) -> Result<Pooled> {
    let params = rule.params(extent, features);
    let groups = features.map_or(0, |features| features.packing.groups);
    let buffer = rec.take("pooled variance", plane_bytes(extent, 1 + groups))?;
    let guess = &rec.take("first guess of the variance", plane_bytes(extent, 1))?;
    let relative_spread = &rec.take("relative half spread", plane_bytes(extent, 1))?;

    let kernel = rec.gpu().kernel::<NoiseMagnitude>("noise_magnitude", &[])?;
    rec.dispatch(&kernel, &NoiseMagnitude { params, signal, relative_spread }, per_pixel(extent))?;
    let kernel = rec.gpu().kernel::<NoiseGuess>("noise_guess", &[])?;
    rec.dispatch(&kernel, &NoiseGuess { params, relative_spread, guess }, per_pixel(extent))?;
    let definitions = [("FEATURE_GROUPS", Definition::Int(groups as i32))];
    let kernel = rec.gpu().kernel::<NoisePool>("noise_pool", &definitions)?;
    let features = features.map(|features| &features.buffer);
    rec.dispatch(&kernel, &NoisePool { params, signal, guess, features, pooled_variance: &buffer }, per_pixel(extent))?;
    Ok(Pooled { buffer })
}

/// The pooled variance of the feature in this slot, or of the colour, as a plane of its own.
///
/// # Errors
/// As [`Recorder::dispatch`].
pub fn noise_unpack(rec: &mut Recorder, extent: IVec2, pooled: &Pooled, slot: Option<Slot>) -> Result<Buffer> {
    let variance = rec.take("pooled variance of one", plane_bytes(extent, 1))?;
    let kernel = rec.gpu().kernel::<NoiseUnpack>("noise_unpack", &[])?;
    let (plane, single) = slot.map_or((0, false), |Slot { group, single }| (1 + group, single));
    let params = NoiseUnpackParams { extent, plane: plane as i32, single: single.into() };
    rec.dispatch(&kernel, &NoiseUnpack { params, pooled_variance: &pooled.buffer, variance: &variance }, per_pixel(extent))?;
    Ok(variance)
}
