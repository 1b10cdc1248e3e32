//! Features are denoised before they guide (section 8.3).

use super::nlm::{CentreWeight, Feature, FilterParams, Filtered, Guide, nlm_filter, nlm_variance};
use super::variance::{BoxWeight, Floor, Signal, buffer_var, floored, input_variance};
use super::{Grid, Planes, Point};

/// The gradient is measured over half a pixel: the distance from a pixel's centre to its edge.
pub const GRADIENT_STEP: f64 = 0.5;

/// Line 7 of Algorithm 1.
const WINDOW_RADIUS: usize = 5;
const PATCH_RADIUS: usize = 3;
const SENSITIVITY: f64 = 1.0;

pub struct Prefiltered {
    /// The variance of the input, which the filter used.
    pub variance: Planes,
    pub feature: Feature,
    /// The filtered spread, if the feature has halves.
    pub spread: Option<Planes>,
}

/// Lines 9 and 10 of Algorithm 1. The halves are filtered with the weights of the full data, and their remaining
/// difference is the residual variance. Without halves the residual variance comes from the weights. A feature without
/// halves and variance is taken to be exact and stays unchanged.
pub fn prefilter(signal: &Signal, symmetric: bool, centre: CentreWeight, box_weight: BoxWeight) -> Prefiltered {
    let mut variance = input_variance(signal, box_weight);
    if signal.spread.is_some() || signal.sample_variance.is_some() {
        variance = floored(&signal.mean, &variance, Floor::Absolute);
    }
    let params = FilterParams {
        window_radius: WINDOW_RADIUS,
        patch_radius: PATCH_RADIUS,
        k_color: SENSITIVITY,
        k_feature: f64::INFINITY,
        tau: 0.0,
        symmetric_features: symmetric,
        blend_pairs: symmetric,
        centre,
    };
    let guide = Some(Guide { mean: &signal.mean, variance: &variance });
    let filter = |payload: &[Grid]| -> Filtered { nlm_filter(payload, guide, &[], &params) };

    let (mean, spread, residual_variance) = match (&signal.spread, &signal.sample_variance) {
        (Some(spread), _) => {
            let mut mean = filter(&[signal.mean.as_slice(), spread].concat()).planes;
            let spread = mean.split_off(signal.mean.len());
            let residual_variance = buffer_var(&spread);
            (mean, Some(spread), residual_variance)
        }
        (None, Some(_)) => (filter(&signal.mean).planes, None, nlm_variance(&variance, guide, &[], &params)),
        (None, None) => (signal.mean.clone(), None, variance.clone()),
    };
    let gradient_squared = mean.iter().map(gradient_squared).collect();
    Prefiltered { variance, feature: Feature { mean, residual_variance, gradient_squared }, spread }
}

/// ‖Grad‖² of section 8.3. Per axis the smaller of the two one-sided differences: beside an edge, the flat side shows
/// the contrast of the pixel itself.
pub fn gradient_squared(plane: &Grid) -> Grid {
    plane.like(|p| {
        [Point { x: 1, y: 0 }, Point { x: 0, y: 1 }]
            .into_iter()
            .map(|axis| {
                let slope = [p + axis, p - axis]
                    .into_iter()
                    .filter(|&q| plane.contains(q))
                    .map(|q| GRADIENT_STEP * (plane.at(q) - plane.at(p)).abs())
                    .reduce(f64::min)
                    .unwrap_or(0.0);
                slope * slope
            })
            .sum()
    })
}
