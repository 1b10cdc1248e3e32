//! One candidate filter and the derivative of its output by its input (section 8.4).

use super::nlm::{
    CentreWeight, Feature, FilterParams, Guide, Pair, blendable, distance_to_mean_scale, feature_weights, half_window,
    nlm_filter, patch_distance, patch_distance_to_mean, pixel_distance_scale, weight, window_weights,
};
use super::variance::brightness_around;
use super::{Grid, Planes, Point, square};

/// δ = 0.01·u of section 8.4.
const RELATIVE_STEP: f64 = 0.01;
/// If u is close to 0 that step vanishes. Then the step is this share of the standard deviation …
const NOISE_STEP: f64 = 0.01;
/// … and if that vanishes too, a step that float32 can still distinguish from the brightness around the pixel, or from
/// 0.
const STEP_AROUND: f64 = 1e-6;
const SMALLEST_STEP: f64 = 1e-18;

#[derive(Clone)]
pub struct Candidate {
    /// F.
    pub mean: Planes,
    /// The halves' spread, filtered with the same weights.
    pub spread: Option<Planes>,
    /// dF_i/du_i.
    pub derivative: Planes,
    /// C of eq. 8.1.
    pub weight_sum: Grid,
}

/// A candidate: the colour filtered with weights from itself and from the features.
pub fn candidate(
    mean: &[Grid],
    spread: Option<&[Grid]>,
    variance: &[Grid],
    features: &[Feature],
    params: &FilterParams,
) -> Candidate {
    let guide = Some(Guide { mean, variance });
    let payload = [mean, spread.unwrap_or_default()].concat();
    let filtered = nlm_filter(&payload, guide, features, params);
    let mut planes = filtered.planes;
    let filtered_spread = planes.split_off(mean.len());
    let around = brightness_around(mean);
    let derivative = (0..mean.len())
        .map(|i| {
            mean[i].like(|p| {
                let step = finite_difference_step(mean[i].at(p), variance[i].at(p), around.at(p));
                if params.k_color.is_infinite() {
                    return finite_difference(mean, variance, features, params, p, i, step);
                }
                (perturbed(mean, variance, features, params, p, i, step) - planes[i].at(p)) / step
            })
        })
        .collect();
    Candidate { mean: planes, spread: spread.map(|_| filtered_spread), derivative, weight_sum: filtered.weight_sum }
}

/// δ of section 8.4, with the sign of u and never 0.
pub fn finite_difference_step(u: f64, variance: f64, brightness_around: f64) -> f64 {
    let size = (RELATIVE_STEP * u.abs())
        .max(NOISE_STEP * variance.max(0.0).sqrt())
        .max(STEP_AROUND * brightness_around)
        .max(SMALLEST_STEP);
    if u < 0.0 { -size } else { size }
}

/// dF_i(p)/du_i(p) of section 8.4. Weights that do not depend on the colour leave w(p, p)/C, which is exact.
pub fn finite_difference(
    mean: &[Grid],
    variance: &[Grid],
    features: &[Feature],
    params: &FilterParams,
    p: Point,
    i: usize,
    step: f64,
) -> f64 {
    if params.k_color.is_infinite() {
        let weights = window_weights(&mean[0], p, None, features, params);
        return weights.centre.1 / weights.sum();
    }
    let filtered = window_weights(&mean[0], p, Some(Guide { mean, variance }), features, params).average(&mean[i]);
    (perturbed(mean, variance, features, params, p, i, step) - filtered) / step
}

/// F_i(p) in an image in which only u_i(p) is changed.
fn perturbed(
    mean: &[Grid],
    variance: &[Grid],
    features: &[Feature],
    params: &FilterParams,
    p: Point,
    i: usize,
    step: f64,
) -> f64 {
    let mut perturbed = mean.to_vec();
    let at = perturbed[i].index(p);
    perturbed[i].values[at] += step;
    let guide = Some(Guide { mean: &perturbed, variance });
    window_weights(&mean[0], p, guide, features, params).average(&perturbed[i])
}

/// dF_i(p)/du_i(p) where it exists: (Σ w'(p, q)·(u_i(q) − F_i(p)) + w(p, p))/C(p), the sum including q = p. This is not
/// part of the pipeline; it checks the finite difference.
pub fn analytic_derivative(
    mean: &[Grid],
    variance: &[Grid],
    features: &[Feature],
    params: &FilterParams,
    p: Point,
    i: usize,
) -> f64 {
    let guide = Guide { mean, variance };
    let weights = window_weights(&mean[0], p, Some(guide), features, params);
    let filtered = weights.average(&mean[i]);

    let mut neighbours = Vec::new();
    for offset in half_window(params.window_radius) {
        let pair = Pair::new(&mean[0], p, offset);
        let slopes = color_weight_slopes(guide, &pair, params, i);
        let caps = feature_weights([features; 2], &pair, params);
        for ((q, (w, slope)), cap) in pair.neighbours().zip(slopes).zip(caps) {
            if let Some(q) = q {
                // A weight that the features limit does not change with the colour.
                neighbours.push((q, w.min(cap), if w < cap { slope } else { 0.0 }));
            }
        }
    }
    let centre_slope = match params.centre {
        CentreWeight::One => 0.0,
        CentreWeight::LargestNeighbour => {
            neighbours.iter().find(|&&(_, w, _)| w == weights.centre.1).map_or(0.0, |&(_, _, slope)| slope)
        }
    };
    let through_weights: f64 = neighbours.iter().map(|&(q, _, slope)| slope * (mean[i].at(q) - filtered)).sum();
    let through_centre = centre_slope * (mean[i].at(p) - filtered);
    (through_weights + through_centre + weights.centre.1) / weights.sum()
}

/// The colour weights of a pair, each with its slope in u_i(p).
fn color_weight_slopes(guide: Guide, pair: &Pair, params: &FilterParams, i: usize) -> [(f64, f64); 2] {
    if params.k_color.is_infinite() {
        return [(1.0, 0.0); 2];
    }
    let (f, k, p) = (params.patch_radius, params.k_color, pair.p);
    // The weight is exp(−max(0, d)): flat where d is negative.
    let weight_slope = |d: f64, slope: f64| (weight(d), if d > 0.0 { -weight(d) * slope } else { 0.0 });

    let [d1, d2] = [pair.q1, pair.q2].map(|q| q.map_or(f64::INFINITY, |q| patch_distance((guide, guide), k, f, p, q)));
    let [(w1, slope1), (w2, slope2)] = [(pair.q1, d1), (pair.q2, d2)]
        .map(|(q, d)| q.map_or((0.0, 0.0), |q| weight_slope(d, patch_distance_slope(guide, k, f, p, q, i))));
    let (Some(q1), Some(q2)) = (pair.q1, pair.q2) else {
        return [(w1, slope1), (w2, slope2)];
    };
    if !params.blend_pairs || !blendable(d1, d2) {
        return [(w1, slope1), (w2, slope2)];
    }

    let (w_mean, mean_slope) = weight_slope(
        patch_distance_to_mean((guide, guide), k, f, p, q1, q2),
        patch_distance_to_mean_slope(guide, k, f, p, q1, q2, i),
    );
    let unclamped = w_mean / (w1 + w2) - 1.0;
    let share = unclamped.clamp(0.0, 1.0);
    let share_slope = if share == unclamped {
        (mean_slope * (w1 + w2) - w_mean * (slope1 + slope2)) / ((w1 + w2) * (w1 + w2))
    } else {
        0.0
    };
    [(w1, slope1), (w2, slope2)].map(|(w, slope)| {
        (share * w_mean + (1.0 - share) * w, share_slope * (w_mean - w) + share * mean_slope + (1.0 - share) * slope)
    })
}

/// The slope of `patch_distance` in u_i(p): p takes part in the patch around itself, and, if q is near, in the patch
/// around q.
fn patch_distance_slope(guide: Guide, k: f64, f: usize, p: Point, q: Point, i: usize) -> f64 {
    let (u, v) = (&guide.mean[i], &guide.variance[i]);
    let (mut slope, mut count) = (0.0, 0.0);
    for n in square(f) {
        let (a, b) = (p + n, q + n);
        if u.contains(a) && u.contains(b) {
            let motion = is(a, p) - is(b, p);
            slope += 2.0 * (u.at(a) - u.at(b)) * motion / pixel_distance_scale(v.at(a), v.at(b), k);
            count += guide.mean.len() as f64;
        }
    }
    slope / count
}

/// The slope of `patch_distance_to_mean` in u_i(p).
fn patch_distance_to_mean_slope(guide: Guide, k: f64, f: usize, p: Point, q1: Point, q2: Point, i: usize) -> f64 {
    let (u, v) = (&guide.mean[i], &guide.variance[i]);
    let (mut slope, mut count) = (0.0, 0.0);
    for n in square(f) {
        let (a, b1, b2) = (p + n, q1 + n, q2 + n);
        if u.contains(a) && u.contains(b1) && u.contains(b2) {
            let motion = is(a, p) - (is(b1, p) + is(b2, p)) / 2.0;
            let difference = u.at(a) - (u.at(b1) + u.at(b2)) / 2.0;
            let scale = distance_to_mean_scale(v.at(a), v.at(b1), v.at(b2), k);
            slope += 2.0 * difference * motion / scale;
            count += guide.mean.len() as f64;
        }
    }
    slope / count
}

fn is(a: Point, b: Point) -> f64 {
    f64::from(u8::from(a == b))
}
