//! Spikes: pixels that stand out from the pixels of their kind by an excess that rests on very few samples.

use glam::{IVec2, Vec4};
use serde::Serialize;

use super::feature::{Features, MAX_GROUPS};
use super::variance::LEAST_NOISE;
use super::{per_pixel, plane_bytes};
use crate::error::Result;
use crate::gpu::{Buffer, Definition, Recorder, bindings, uniforms};

uniforms! {
    struct LightReturnParams { extent: IVec2, error_component: i32 }
    pub(super) struct SpikeParams {
        extent: IVec2,
        window_radius: i32,
        spread_radius: i32,
        least_neighbours: f32,
        prominence: f32,
        most_samples: f32,
        light_samples: f32,
        least_noise: f32,
        share_limit: f32,
        inverse_feature_k_squared: f32,
        feature_tau: f32,
        triple_weights: [Vec4; MAX_GROUPS],
    }
}

bindings! {
    struct SpikeFind<'a> {
        uniform params: SpikeParams, around signal, optional_around features, change repaired, change spikes,
        change lights,
    }
    struct SpikeFindVariance<'a> {
        uniform params: SpikeParams, around signal, optional_around features, around sample_variance,
        write repaired_variance, change repaired, change spikes, change lights,
    }
    struct SpikeLevel<'a> { uniform params: SpikeParams, around repaired, read spikes, write levels }
    struct SpikeShare<'a> { uniform params: SpikeParams, write spikes, optional_around features, around levels }
    struct SpikeRows<'a> { uniform params: SpikeParams, write spikes }
    struct LightReturn<'a> { uniform params: LightReturnParams, read lights, read filtered, write lit }
    struct LightReturnError<'a> {
        uniform params: LightReturnParams, read lights, read filtered, write lit, write errors,
    }
    struct SpikeSpread<'a> {
        uniform params: SpikeParams, change spikes, optional_around features, around levels, change repaired,
    }
}

/// Rule for finding and spreading spikes. [`SpikeRule::DEFAULT`] measured best: `docs/robustness.md` has the table.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SpikeRule {
    /// Half width of the window that a pixel is judged in, in pixels.
    pub window_radius: u32,
    /// Half width of the window that a spike is spread over, in pixels.
    pub spread_radius: u32,
    /// Least number of neighbours of its kind that are needed to judge a pixel.
    pub least_neighbours: u32,
    /// Least height of a spike above the level of its neighbours, in multiples of the distance from that level to the
    /// third brightest neighbour.
    pub prominence: f32,
    /// Largest number of samples that the excess of a spike rests on: the square of the excess over its variance.
    pub most_samples: f32,
    /// Least number of samples that the excess of a light of few pixels rests on; a pixel between both limits is
    /// filtered like others. Measured with 25, no development scene has more than 0.6 % more error than without lights;
    /// with 12, `cornell` at 8 spp from two seeds alone has 9 % more.
    pub light_samples: f32,
    /// Amount that a spike may add to the level of its neighbours, in parts of that level, before half of the spike is
    /// left out.
    pub share_limit: f32,
    /// k_f of the features, as for the candidates: pixels are of one kind where no feature's distance (eq. 8.3) is
    /// above 1.
    pub feature_k: f32,
    /// τ of the features, in squares of the unit range.
    pub feature_tau: f32,
}

impl SpikeRule {
    /// Values that measured best.
    pub const DEFAULT: Self = Self {
        window_radius: 3,
        spread_radius: 13,
        least_neighbours: 12,
        prominence: 3.0,
        most_samples: 2.0,
        light_samples: 25.0,
        share_limit: 0.1,
        feature_k: 0.6,
        feature_tau: 0.1,
    };

    pub(super) fn params(&self, extent: IVec2, features: Option<&Features>) -> SpikeParams {
        SpikeParams {
            extent,
            window_radius: self.window_radius as i32,
            spread_radius: self.spread_radius as i32,
            least_neighbours: self.least_neighbours as f32,
            prominence: self.prominence,
            most_samples: self.most_samples,
            light_samples: self.light_samples,
            least_noise: LEAST_NOISE,
            share_limit: self.share_limit,
            inverse_feature_k_squared: 1.0 / (self.feature_k * self.feature_k),
            feature_tau: self.feature_tau,
            triple_weights: features.map_or([Vec4::ZERO; MAX_GROUPS], |features| features.packing.triple_weights()),
        }
    }
}

/// A signal without its spikes.
#[derive(Debug)]
pub struct Repaired {
    /// The signal; a spike is replaced by the mean of its neighbours.
    pub signal: Buffer,
    /// Sample variance of the signal, if there is one; a spike gets the mean of its neighbours' variances.
    pub variance_of_mean: Option<Buffer>,
    /// Three planes. The first holds the amount taken from each pixel, 0 for a pixel that is no spike. [`spike_spread`]
    /// writes the rest: the w of the first becomes the part of the amount that the pixels around get; the second holds
    /// the amount that one of them would get at the position of the spike; the third holds, in x, the squares of the
    /// amounts that each pixel got, summed over spikes and channels, and in y the number of pixels that a spike is
    /// spread over. The z of the third is the brightness of the brightest neighbour that counts for the level.
    pub spikes: Buffer,
    /// Two planes for [`light_return`]: mean and half spread of lights of few pixels. The w of the first holds their
    /// variance, summed over the channels; the w of the second is 1 for a light, else 0.
    pub lights: Buffer,
}

pub(super) fn feature_groups(features: Option<&Features>) -> (&'static str, Definition) {
    ("FEATURE_GROUPS", Definition::Int(features.map_or(0, |features| features.packing.groups as i32)))
}

/// Finds spikes in a signal, using its sample variance (one plane, s²/n) if there is one, and replaces them, and lights
/// of few pixels, by the level of their neighbours. Neighbours are compared by `features`, if there are any.
///
/// # Errors
/// As [`Recorder::dispatch`].
pub fn spike_find(
    rec: &mut Recorder,
    extent: IVec2,
    signal: &Buffer,
    sample_variance: Option<&Buffer>,
    features: Option<&Features>,
    rule: &SpikeRule,
) -> Result<Repaired> {
    let params = rule.params(extent, features);
    let repaired = rec.take("signal without spikes", plane_bytes(extent, 2))?;
    let repaired_variance =
        sample_variance.map(|_| rec.take("its sample variance", plane_bytes(extent, 1))).transpose()?;
    let spikes = rec.take("spikes", plane_bytes(extent, 3))?;
    let lights = rec.take("lights", plane_bytes(extent, 2))?;
    let definitions = [feature_groups(features), ("VARIANCE", sample_variance.is_some().into())];
    let features = features.map(|features| features.buffer.within(rule.window_radius));
    let signal = signal.within(rule.window_radius);
    match (sample_variance, &repaired_variance) {
        (Some(sample_variance), Some(repaired_variance)) => {
            let bound = SpikeFindVariance {
                params,
                signal,
                features,
                // The front of the output, which is the repaired mean, depends on the variance of the pixel alone.
                sample_variance: sample_variance.within(rule.window_radius).but_for_the_front(),
                repaired_variance,
                repaired: repaired.in_parts(),
                spikes: spikes.in_parts(),
                lights: lights.in_parts(),
            };
            rec.dispatch("spike_find", &definitions, &bound, per_pixel(extent))?;
        }
        _ => {
            rec.dispatch(
                "spike_find",
                &definitions,
                &SpikeFind {
                    params,
                    signal,
                    features,
                    repaired: repaired.in_parts(),
                    spikes: spikes.in_parts(),
                    lights: lights.in_parts(),
                },
                per_pixel(extent),
            )?;
        }
    }
    Ok(Repaired { signal: repaired, variance_of_mean: repaired_variance, spikes, lights })
}

/// Gives parts of each spike to the pixels around it: to all pixels of its kind that have noise and are about as
/// bright, less to pixels further away. `repaired` is the result of [`spike_find`]. Returns the brightness around each
/// pixel and whether the pixel has noise, by which the parts were found.
///
/// # Errors
/// As [`Recorder::take`] and [`Recorder::dispatch`].
pub fn spike_spread(
    rec: &mut Recorder,
    extent: IVec2,
    features: Option<&Features>,
    rule: &SpikeRule,
    repaired: &mut Repaired,
) -> Result<Buffer> {
    let params = rule.params(extent, features);
    let Repaired { signal: repaired, spikes, .. } = repaired;
    let groups = [feature_groups(features)];
    let features = features.map(|features| features.buffer.within(rule.spread_radius));
    let made = rec.take("brightness around each pixel", plane_bytes(extent, 1))?;

    let bound = SpikeLevel { params, repaired: repaired.within(1).front(), spikes, levels: &made };
    rec.dispatch("spike_level", &[], &bound, per_pixel(extent))?;
    let levels = made.within(rule.spread_radius);
    rec.dispatch("spike_share", &groups, &SpikeShare { params, spikes, features, levels }, per_pixel(extent))?;
    // The stage reads a whole row of amounts, which depend on the pixels within `window_radius`. The shares beside them
    // already reach at least as far, so its reach need not be declared.
    rec.dispatch("spike_rows", &[], &SpikeRows { params, spikes }, per_pixel(extent))?;
    let bound = SpikeSpread {
        params,
        spikes: spikes.within(rule.spread_radius).back(),
        features,
        levels,
        repaired: repaired.within(0).front(),
    };
    rec.dispatch("spike_spread", &groups, &bound, per_pixel(extent))?;
    Ok(made)
}

/// Returns a filtered signal with the `lights` that [`spike_find`] set aside.
///
/// `errors`: a plane and the component of it, 0 to 3, that holds squared errors of the filtered signal, summed over the
/// channels; the error of a light becomes the variance of the light.
///
/// # Errors
/// As [`Recorder::dispatch`].
pub fn light_return(
    rec: &mut Recorder,
    extent: IVec2,
    lights: &Buffer,
    filtered: &Buffer,
    errors: Option<(&Buffer, u32)>,
) -> Result<Buffer> {
    let lit = rec.take("result with lights", plane_bytes(extent, 2))?;
    let params = LightReturnParams { extent, error_component: errors.map_or(0, |(_, component)| component as i32) };
    match errors {
        Some((errors, _)) => {
            rec.dispatch(
                "light_return",
                &[("ERROR", true.into())],
                &LightReturnError { params, lights, filtered, lit: &lit, errors },
                per_pixel(extent),
            )?;
        }
        None => {
            rec.dispatch("light_return", &[], &LightReturn { params, lights, filtered, lit: &lit }, per_pixel(extent))?;
        }
    }
    Ok(lit)
}
