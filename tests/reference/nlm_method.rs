//! Chapter 7: the filter with all its rules, and the method made of it.

use super::gaussian::gaussian;
use super::keep_clean::{CleanParams, Kept, keep_clean};
use super::nlm::{CentreWeight, Guide, Pair, WindowWeights, blendable, half_window, weight};
use super::noise::{NoiseParams, completed};
use super::spike::{self, SpikeParams};
use super::variance::{BoxWeight, Floor, Signal, floored, input_variance, of_color};
use super::{Grid, Planes, Point, map_pixels, square};

/// ε of eq. 7.4.
const EPSILON: f64 = 1e-30;
/// ε of section 7.1.2.
const RELATIVE_FLOOR: f64 = 1e-3;
/// The centre's weight if no neighbour is similar.
const SMALLEST_CENTRE_WEIGHT: f64 = 1e-3;

/// Treatment of opposite neighbours.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Symmetry {
    Off,
    /// By degrees, for chapter 8.
    Blended,
    /// As in section 7.1.1.
    Hard,
}

#[derive(Clone, Copy, Debug)]
pub struct Filter {
    pub window_radius: usize,
    pub patch_radius: usize,
    pub k: f64,
    pub alpha: f64,
    pub symmetric: Symmetry,
    pub patchwise: bool,
    pub cut: f64,
    pub centre: CentreWeight,
}

/// The weights of all windows, pixel by pixel.
pub fn windows(guide: Guide, filter: &Filter) -> Vec<WindowWeights> {
    let like = &guide.mean[0];
    let pixel = |i: usize| Point { x: (i % like.width) as isize, y: (i / like.width) as isize };
    let mut windows: Vec<_> =
        (0..like.values.len()).map(|i| WindowWeights { centre: (pixel(i), 1.0), neighbours: Vec::new() }).collect();
    let is_inside = |o: &Point| o.x.unsigned_abs() < like.width && o.y.unsigned_abs() < like.height;
    for offset in half_window(filter.window_radius).filter(is_inside) {
        let weights = map_pixels(like.width, like.height, |p| pair_weights(guide, p, offset, filter));
        let weights = if filter.patchwise { patch_means(like, &weights, offset, filter.patch_radius) } else { weights };
        for (window, weights) in windows.iter_mut().zip(weights) {
            let pair = Pair::new(like, window.centre.0, offset);
            let kept =
                pair.neighbours().zip(weights).filter_map(|(q, w)| Some((q?, if w < filter.cut { 0.0 } else { w })));
            window.neighbours.extend(kept);
        }
    }
    if filter.centre == CentreWeight::LargestNeighbour {
        for window in &mut windows {
            window.centre.1 = window.neighbours.iter().fold(SMALLEST_CENTRE_WEIGHT, |largest, (_, w)| w.max(largest));
        }
    }
    windows
}

/// w(p, p + o) and w(p, p − o), 0 for a neighbour that does not exist.
pub(super) fn pair_weights(guide: Guide, p: Point, offset: Point, filter: &Filter) -> [f64; 2] {
    let pair = Pair::new(&guide.mean[0], p, offset);
    let distance = |q: Option<Point>| q.map_or(f64::INFINITY, |q| patch_distance(guide, p, &[q], filter));
    let (d1, d2) = (distance(pair.q1), distance(pair.q2));
    let (w1, w2) = (weight(d1), weight(d2));
    let (Some(q1), Some(q2)) = (pair.q1, pair.q2) else { return [w1, w2] };
    let w_mean = || weight(patch_distance(guide, p, &[q1, q2], filter));
    match filter.symmetric {
        Symmetry::Hard if w_mean() > w1 + w2 => [w_mean(); 2],
        Symmetry::Blended if blendable(d1, d2) => {
            let share = (w_mean() / (w1 + w2) - 1.0).clamp(0.0, 1.0);
            [w1, w2].map(|w| share * w_mean() + (1.0 - share) * w)
        }
        _ => [w1, w2],
    }
}

/// Eq. 7.4 averaged over the patch (eq. 7.3); q is one pixel, or the mean of two (eq. 7.6).
pub(super) fn patch_distance(guide: Guide, p: Point, q: &[Point], filter: &Filter) -> f64 {
    let (mut sum, mut count, members) = (0.0, 0, q.len() as f64);
    for n in square(filter.patch_radius) {
        if !guide.mean[0].contains(p + n) || !q.iter().all(|q| guide.mean[0].contains(*q + n)) {
            continue;
        }
        for (u, v) in guide.mean.iter().zip(guide.variance) {
            let mean = |value: &dyn Fn(Point) -> f64| q.iter().map(|q| value(*q + n)).sum::<f64>() / members;
            let v_p = v.at(p + n);
            let u_q = mean(&|q| u.at(q));
            let v_q = mean(&|q| v.at(q)) / members;
            let v_qp = mean(&|q| v.at(q).min(v_p)) / members;
            sum += ((u.at(p + n) - u_q).powi(2) - filter.alpha * (v_p + v_qp))
                / (EPSILON + filter.k * filter.k * (v_p + v_q));
            count += 1;
        }
    }
    sum / f64::from(count)
}

/// W(p, q) of section 7.1.1: the mean of w(p + n, q + n) over the patch.
fn patch_means(like: &Grid, weights: &[[f64; 2]], offset: Point, patch_radius: usize) -> Vec<[f64; 2]> {
    let minus = Point { x: -offset.x, y: -offset.y };
    map_pixels(like.width, like.height, |p| {
        [(0, offset), (1, minus)].map(|(side, offset)| {
            let pairs: Vec<f64> = square(patch_radius)
                .filter(|&n| like.contains(p + n) && like.contains(p + n + offset))
                .map(|n| weights[like.index(p + n)][side])
                .collect();
            pairs.iter().sum::<f64>() / pairs.len().max(1) as f64
        })
    })
}

pub fn filtered(payload: &[Grid], windows: &[WindowWeights]) -> Planes {
    payload
        .iter()
        .map(|plane| Grid { values: windows.iter().map(|window| window.average(plane)).collect(), ..*plane })
        .collect()
}

fn weight_sums(like: &Grid, windows: &[WindowWeights]) -> Grid {
    Grid { values: windows.iter().map(WindowWeights::sum).collect(), ..*like }
}

/// Source of the variance.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Variance {
    Scaled,
    CrossFiltered,
    Uniform,
}

#[derive(Clone, Copy, Debug)]
pub struct NlmParams {
    pub filter: Filter,
    pub dual_buffer: bool,
    pub variance: Variance,
    /// None: spikes stay.
    pub spikes: Option<SpikeParams>,
    /// None: pixels without noise are filtered like all others.
    pub keep_clean: Option<CleanParams>,
    /// None: missing variances are smoothed squares of the half spread.
    pub noise: Option<NoiseParams>,
}

impl NlmParams {
    /// Section 7.2, final image.
    pub fn thesis() -> NlmParams {
        let filter = Filter {
            window_radius: 10,
            patch_radius: 3,
            k: 0.45,
            alpha: 1.0,
            symmetric: Symmetry::Hard,
            patchwise: true,
            cut: 0.05,
            centre: CentreWeight::One,
        };
        NlmParams {
            filter,
            dual_buffer: true,
            variance: Variance::CrossFiltered,
            spikes: None,
            keep_clean: None,
            noise: None,
        }
    }
}

pub struct Nlm {
    /// Of the mean of both halves.
    pub variance: Planes,
    pub mean: Planes,
    /// None without halves.
    pub spread: Option<Planes>,
    pub weight_sum: Grid,
    /// Summed over the channels.
    pub error: Grid,
    pub density: Grid,
}

pub fn nlm(color: &Signal, params: &NlmParams, samples: &Grid) -> Nlm {
    let completed = params.noise.map(|noise| completed(color, &[], &[], &noise).0);
    let raw = completed.as_ref().unwrap_or(color);
    let repaired = params.spikes.map(|params| spike::repaired(raw, &[], &params));
    let color = repaired.as_ref().map_or(raw, |repaired| &repaired.signal);
    let like = &color.mean[0];
    let variance = match params.variance {
        Variance::Scaled => at_most_claimed(input_variance(color, BoxWeight::Deviation), color),
        Variance::CrossFiltered => cross_filtered(color, &params.filter),
        Variance::Uniform => {
            let of_channel = |i: usize| {
                raw.spread.as_ref().map_or_else(
                    || raw.sample_variance.as_ref().map_or(0.0, |v| v[i].mean()),
                    |s| squared(&s[i]).mean(),
                )
            };
            (0..3).map(|i| Grid::filled(like.width, like.height, of_channel(i))).collect()
        }
    };

    let variance = floored(&color.mean, &variance, of_color(params.keep_clean.is_some()));

    // Section 7.1.1, dual-buffer filtering.
    // With it, Σ w·n / Σ w: the samples that contribute to a filtered value, per pixel of its support.
    let samples_of = |windows: &[WindowWeights]| filtered(std::slice::from_ref(samples), windows).remove(0);
    let (mean, spread, weight_sum, samples, left) = match &color.spread {
        Some(spread) if params.dual_buffer => {
            let half = |sign: f64| -> Planes {
                color
                    .mean
                    .iter()
                    .zip(spread)
                    .map(|(mean, spread)| mean.like(|p| mean.at(p) + sign * spread.at(p)))
                    .collect()
            };
            let (a, b) = (half(1.0), half(-1.0));
            let of_half: Planes = variance.iter().map(|plane| plane.like(|p| 2.0 * plane.at(p))).collect();
            let (from_a, from_b) = (
                windows(Guide { mean: &a, variance: &of_half }, &params.filter),
                windows(Guide { mean: &b, variance: &of_half }, &params.filter),
            );
            let (a, b) = (filtered(&a, &from_b), filtered(&b, &from_a));
            let both = |combine: fn(f64, f64) -> f64| -> Planes {
                a.iter().zip(&b).map(|(a, b)| a.like(|p| combine(a.at(p), b.at(p)) / 2.0)).collect()
            };
            let (sum_a, sum_b) = (weight_sums(like, &from_a), weight_sums(like, &from_b));
            let [counts_a, counts_b] = [&from_a, &from_b].map(|windows| samples_of(windows));
            let contributing = like.like(|p| (counts_a.at(p) + counts_b.at(p)) / 2.0);
            let spread = both(|a, b| a - b);
            let left: Planes = spread.iter().map(squared).collect();
            (both(|a, b| a + b), Some(spread), like.like(|p| (sum_a.at(p) + sum_b.at(p)) / 2.0), contributing, left)
        }
        _ => {
            let windows = windows(Guide { mean: &color.mean, variance: &variance }, &params.filter);
            let spread = color.spread.as_ref().map(|spread| filtered(spread, &windows));
            let left = match &spread {
                Some(spread) => spread.iter().map(squared).collect(),
                None => variance
                    .iter()
                    .map(|v| Grid {
                        values: windows.iter().map(|window| window.variance_of_average(v)).collect(),
                        ..*v
                    })
                    .collect(),
            };
            (filtered(&color.mean, &windows), spread, weight_sums(like, &windows), samples_of(&windows), left)
        }
    };

    // Section 7.1.2, and the smoothing of 7.1.3.
    let density = like.like(|p| {
        let relative = |sign: f64| -> f64 {
            let channel = |i: usize| {
                let value = mean[i].at(p) + sign * spread.as_ref().map_or(0.0, |spread| spread[i].at(p));
                // (Â − B̂)² is four times the variance of the mean.
                4.0 * left[i].at(p) / (RELATIVE_FLOOR + value * value)
            };
            (0..3).map(channel).sum::<f64>() / 3.0
        };
        (relative(1.0) + relative(-1.0)) * weight_sum.at(p) / (1.0 + weight_sum.at(p) * samples.at(p))
    });
    let error = like.like(|p| left.iter().map(|plane| plane.at(p)).sum());
    let (error, density) = (gaussian(&error, 0.8, 3), gaussian(&density, 0.8, 3));
    let kept = match params.keep_clean {
        Some(clean) => keep_clean(color, &mean, spread.as_deref(), &error, clean),
        None => Kept { mean, spread, error },
    };
    let Kept { mean, spread, error } = match &repaired {
        Some(repaired) => repaired.lights.added_to(kept),
        None => kept,
    };
    Nlm { variance, mean, spread, weight_sum, error, density }
}

/// Section 7.1.1, variance estimation. The uncertainty of Σ is its variance over 3×3 pixels; the source has one from
/// each half.
pub fn cross_filtered(color: &Signal, filter: &Filter) -> Planes {
    let (Some(claimed), Some(spread)) = (&color.sample_variance, &color.spread) else {
        return input_variance(color, BoxWeight::Deviation);
    };
    let two_buffer: Planes = spread.iter().map(squared).collect();
    let uncertainty: Planes = claimed.iter().map(local_variance).collect();
    let uncertainty = floored(claimed, &uncertainty, Floor::Printed);
    let own = Filter { window_radius: 1, patch_radius: 3, k: 0.45, alpha: 4.0, patchwise: false, cut: 0.0, ..*filter };
    at_most_claimed(filtered(&two_buffer, &windows(Guide { mean: claimed, variance: &uncertainty }, &own)), color)
}

/// Variance over the existing pixels of the 3×3 pixels around.
pub fn local_variance(plane: &Grid) -> Grid {
    plane.like(|p| {
        let around: Vec<f64> = square(1).map(|o| p + o).filter(|q| plane.contains(*q)).map(|q| plane.at(q)).collect();
        let mean = around.iter().sum::<f64>() / around.len() as f64;
        around.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / around.len() as f64
    })
}

/// The variance, held below the sample variance if there is one beside the halves.
fn at_most_claimed(variance: Planes, color: &Signal) -> Planes {
    match (&color.sample_variance, &color.spread) {
        (Some(claimed), Some(_)) => variance
            .iter()
            .zip(claimed)
            .map(|(variance, claimed)| variance.like(|p| variance.at(p).min(claimed.at(p))))
            .collect(),
        _ => variance,
    }
}

fn squared(plane: &Grid) -> Grid {
    plane.like(|p| plane.at(p) * plane.at(p))
}
