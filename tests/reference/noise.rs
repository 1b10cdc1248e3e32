//! Variances of the mean that no renderer gave: from two halves, pooled over pixels that are alike.

use std::f64::consts::FRAC_PI_2;

use super::gaussian::gaussian;
use super::variance::Signal;
use super::{Grid, Planes, Point, channel_mean, square};

/// Which pixels are pooled, and how.
#[derive(Clone, Copy, Debug)]
pub struct NoiseParams {
    /// How many times brighter than itself a pixel takes its surroundings to be at the most.
    pub darker: f64,
    pub least_magnitude: f64,
    pub guess_sigma: f64,
    pub guess_radius: usize,
    pub feature_radius: usize,
    pub window_radius: usize,
    /// Magnitudes that differ by more than this factor are not pooled.
    pub gate: f64,
    pub largest_distance: f64,
    pub k_feature: f64,
    pub tau: f64,
    /// How often the pooled variance counts, against once the pixel's own.
    pub pooled_share: f64,
}

/// What renders turned out to want.
impl Default for NoiseParams {
    fn default() -> NoiseParams {
        NoiseParams {
            darker: 4.0,
            least_magnitude: 1e-3,
            guess_sigma: 2.0,
            guess_radius: 5,
            feature_radius: 2,
            window_radius: 7,
            gate: 16.0,
            largest_distance: 12.0,
            k_feature: 0.6,
            tau: 0.01,
            pooled_share: 4.0,
        }
    }
}

/// Variances of the mean.
pub struct Pooled {
    pub color: Planes,
    /// Of each feature; of one without halves they mean nothing.
    pub features: Vec<Planes>,
}

/// A frame in which everything with halves has a sample variance.
pub fn completed(color: &Signal, features: &[Signal], params: &NoiseParams) -> (Signal, Vec<Signal>) {
    let lacks = |signal: &Signal| signal.sample_variance.is_none() && signal.spread.is_some();
    if color.spread.is_none() || !(lacks(color) || features.iter().any(lacks)) {
        return (color.clone(), features.to_vec());
    }
    let pooled = pooled(color, features, params);
    let with = |signal: &Signal, variance: Planes| {
        let sample_variance = if lacks(signal) { Some(variance) } else { signal.sample_variance.clone() };
        Signal { sample_variance, ..signal.clone() }
    };
    let features = features.iter().zip(pooled.features).map(|(signal, variance)| with(signal, variance)).collect();
    (with(color, pooled.color), features)
}

pub fn pooled(color: &Signal, features: &[Signal], params: &NoiseParams) -> Pooled {
    let zero = |signal: &Signal| -> Planes { signal.mean.iter().map(|grid| grid.like(|_| 0.0)).collect() };
    let spread = color.spread.clone().unwrap_or_else(|| zero(color));
    let magnitude = magnitude(&color.mean, params);
    let guess = first_guess(&spread, &magnitude, params);
    let spreads: Vec<Planes> = features.iter().map(|signal| signal.spread.clone().unwrap_or_else(|| zero(signal))).collect();
    let noise: Vec<Planes> = features.iter().map(|signal| noise_around(signal, params)).collect();

    let weight = |p: Point, q: Point| {
        if p == q {
            return 1.0;
        }
        let of_features = features.iter().zip(&noise).map(|(signal, noise)| {
            let scale = |sum: f64| params.k_feature.powi(2) * sum.max(params.tau);
            distance(&signal.mean, noise, p, q, scale)
        });
        let distance = of_features.fold(distance(&color.mean, &guess, p, q, |sum| sum.max(1e-30)), f64::max);
        let (bright, dark) = (magnitude.at(p).max(magnitude.at(q)), magnitude.at(p).min(magnitude.at(q)));
        let is_alike = distance <= params.largest_distance && bright <= params.gate * dark;
        if is_alike { (-distance.max(0.0)).exp() } else { 0.0 }
    };
    let like = &color.mean[0];
    let window = |p: Point| square(params.window_radius).map(move |o| p + o).filter(|&q| like.contains(q));
    let weights = super::map_pixels(like.width, like.height, |p| window(p).map(|q| (q, weight(p, q))).collect::<Vec<_>>());
    // Of Gaussian noise, E|D| = σ·√(2/π).
    let pool = |spread: &Grid| {
        spread.like(|p| {
            let weights = &weights[spread.index(p)];
            let sum: f64 = weights.iter().map(|(q, w)| w * spread.at(*q).abs()).sum();
            FRAC_PI_2 * (sum / weights.iter().map(|(_, w)| w).sum::<f64>()).powi(2)
        })
    };
    // What the pixel's own halves say counts a little.
    let share = params.pooled_share;
    let pooled: Planes = spread.iter().map(pool).collect();
    let own = like.like(|p| spread.iter().zip(&pooled).map(|(d, v)| d.at(p).powi(2) / v.at(p).max(1e-30)).sum::<f64>() / spread.len() as f64);
    let color = pooled.iter().map(|v| v.like(|p| v.at(p) * (share + own.at(p)) / (share + 1.0))).collect();
    let of_feature = |spread: &Grid| {
        let pooled = pool(spread);
        spread.like(|p| (share * pooled.at(p) + spread.at(p).powi(2)) / (share + 1.0))
    };
    Pooled { color, features: spreads.iter().map(|planes| planes.iter().map(of_feature).collect()).collect() }
}

/// The brightness around a pixel, without single bright pixels.
pub fn magnitude(mean: &[Grid], params: &NoiseParams) -> Grid {
    let brightness = mean[0].like(|p| channel_mean(mean, p).abs());
    brightness.like(|p| {
        let mut around: Vec<f64> = square(1).map(|o| p + o).filter(|&q| brightness.contains(q)).map(|q| brightness.at(q)).collect();
        around.sort_by(f64::total_cmp);
        let median = around[(around.len() - 1) / 2];
        median.min(params.darker * brightness.at(p)).max(params.least_magnitude)
    })
}

/// The squared half spread, smoothed in parts of the magnitude.
pub fn first_guess(spread: &[Grid], magnitude: &Grid, params: &NoiseParams) -> Planes {
    let relative = |plane: &Grid| plane.like(|p| (plane.at(p) / magnitude.at(p)).powi(2));
    let smoothed = spread.iter().map(|plane| gaussian(&relative(plane), params.guess_sigma, params.guess_radius));
    smoothed.map(|plane| plane.like(|p| plane.at(p) * magnitude.at(p).powi(2))).collect()
}

/// What the halves of a feature, or its variance without halves, tell of its noise in a small box.
pub fn noise_around(signal: &Signal, params: &NoiseParams) -> Planes {
    let squares = |spread: &Grid| spread.like(|p| spread.at(p).powi(2));
    let noise: Planes = match (&signal.spread, &signal.sample_variance) {
        (Some(spread), _) => spread.iter().map(squares).collect(),
        (None, Some(variance)) => variance.clone(),
        (None, None) => signal.mean.iter().map(|grid| grid.like(|_| 0.0)).collect(),
    };
    let average = |plane: &Grid| {
        plane.like(|p| {
            let around: Vec<f64> = square(params.feature_radius).map(|o| p + o).filter(|&q| plane.contains(q)).map(|q| plane.at(q)).collect();
            around.iter().sum::<f64>() / around.len() as f64
        })
    };
    noise.iter().map(average).collect()
}

/// The mean over the channels of the squared difference, less what noise explains of it, over a scale.
fn distance(mean: &[Grid], variance: &[Grid], p: Point, q: Point, scale: impl Fn(f64) -> f64) -> f64 {
    let of_channel = |(mean, variance): (&Grid, &Grid)| {
        let (of_p, of_q) = (variance.at(p), variance.at(q));
        ((mean.at(p) - mean.at(q)).powi(2) - (of_p + of_p.min(of_q))) / scale(of_p + of_q)
    };
    mean.iter().zip(variance).map(of_channel).sum::<f64>() / mean.len() as f64
}
