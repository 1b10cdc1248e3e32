//! Estimated variances of the mean: from two halves, or from the image alone, pooled over similar pixels.

use std::f64::consts::FRAC_PI_2;

use super::gaussian::gaussian;
use super::variance::Signal;
use super::{Grid, Planes, Point, channel_mean, lower_median, square};

/// Which pixels are pooled, and how.
#[derive(Clone, Copy, Debug)]
pub struct NoiseParams {
    /// Largest ratio of the brightness around a pixel to its own that counts.
    pub darker: f64,
    pub least_magnitude: f64,
    pub guess_sigma: f64,
    pub guess_radius: usize,
    pub feature_radius: usize,
    pub window_radius: usize,
    /// Pixels whose magnitudes differ by more than this factor are not pooled.
    pub gate: f64,
    /// The same factor for pooling a sample variance beside halves. None: it stays as it is.
    pub given_gate: Option<f64>,
    pub largest_distance: f64,
    pub k_feature: f64,
    pub tau: f64,
    /// Weight of the pooled variance; the pixel's own has weight 1.
    pub pooled_share: f64,
    /// Noise below which a pixel counts as free of noise, relative to its value.
    pub least_noise: f64,
}

impl NoiseParams {
    /// A variance that is given stays as it is.
    pub fn where_lacking() -> NoiseParams {
        NoiseParams { given_gate: None, ..NoiseParams::default() }
    }
}

/// The parameters that measured best on renders.
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
            given_gate: Some(4.0),
            largest_distance: 12.0,
            k_feature: 1.2,
            tau: 0.01,
            pooled_share: 8.0,
            least_noise: 1e-3,
        }
    }
}

/// Variances of the mean.
pub struct Pooled {
    pub color: Planes,
    /// Variances of each feature; meaningless for a feature without halves.
    pub features: Vec<Planes>,
}

/// A frame in which the colour, and every feature with halves, has a sample variance. The sample variance of a colour
/// with halves becomes steadier. The features `explaining` may explain the texture of an image without halves and
/// variance.
pub fn completed(
    color: &Signal,
    features: &[Signal],
    explaining: &[usize],
    params: &NoiseParams,
) -> (Signal, Vec<Signal>) {
    if color.spread.is_none() && color.sample_variance.is_none() {
        let variance = of_image(&color.mean, features, explaining, &ImageParams::default());
        return (Signal { sample_variance: Some(variance), ..color.clone() }, features.to_vec());
    }
    let lacks = |signal: &Signal| signal.sample_variance.is_none() && signal.spread.is_some();
    let pools_color = lacks(color) || params.given_gate.is_some();
    if color.spread.is_none() || !(pools_color || features.iter().any(lacks)) {
        return (color.clone(), features.to_vec());
    }
    let gate = params.given_gate.filter(|_| !lacks(color)).unwrap_or(params.gate);
    let pooled = pooled(color, features, &NoiseParams { gate, ..*params });
    let with = |signal: &Signal, replaces: bool, variance: Planes| {
        let sample_variance = if replaces { Some(variance) } else { signal.sample_variance.clone() };
        Signal { sample_variance, ..signal.clone() }
    };
    let features =
        features.iter().zip(pooled.features).map(|(signal, variance)| with(signal, lacks(signal), variance)).collect();
    (with(color, pools_color, pooled.color), features)
}

pub fn pooled(color: &Signal, features: &[Signal], params: &NoiseParams) -> Pooled {
    let zero = |signal: &Signal| -> Planes { signal.mean.iter().map(|grid| grid.like(|_| 0.0)).collect() };
    let spread = color.spread.clone().unwrap_or_else(|| zero(color));
    let magnitude = magnitude(&color.mean, params);
    let guess = first_guess(&spread, &magnitude, params);
    let spreads: Vec<Planes> =
        features.iter().map(|signal| signal.spread.clone().unwrap_or_else(|| zero(signal))).collect();
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
    let weights =
        super::map_pixels(like.width, like.height, |p| window(p).map(|q| (q, weight(p, q))).collect::<Vec<_>>());
    let mean_of = |deviation: &Grid, p: Point| {
        let weights = &weights[deviation.index(p)];
        weights.iter().map(|(q, w)| w * deviation.at(*q).abs()).sum::<f64>()
            / weights.iter().map(|(_, w)| w).sum::<f64>()
    };
    // Of Gaussian noise, E|D| = σ·√(2/π).
    let pool = |spread: &Grid| spread.like(|p| FRAC_PI_2 * mean_of(spread, p).powi(2));
    let share = params.pooled_share;
    let own: Planes = color
        .sample_variance
        .clone()
        .unwrap_or_else(|| spread.iter().map(|plane| plane.like(|p| plane.at(p).powi(2))).collect());
    let estimate: Planes = if color.sample_variance.is_some() {
        let deviations = own.iter().map(|variance| variance.like(|p| variance.at(p).sqrt()));
        deviations
            .zip(&own)
            .map(|(deviation, own)| own.like(|p| (mean_of(&deviation, p).powi(2) + own.at(p)) / 2.0))
            .collect()
    } else {
        // The pixel's own halves count a little.
        let pooled: Planes = spread.iter().map(pool).collect();
        let ratio = like.like(|p| {
            own.iter().zip(&pooled).map(|(own, v)| own.at(p) / v.at(p).max(1e-30)).sum::<f64>() / own.len() as f64
        });
        pooled.iter().map(|v| v.like(|p| v.at(p) * (share + ratio.at(p)) / (share + 1.0))).collect()
    };
    // Pixels with almost no noise keep it.
    let kept =
        |(v, own): (&Grid, &Grid)| v.like(|p| if has_noise(color, &spread, p, params) { v.at(p) } else { own.at(p) });
    let color = estimate.iter().zip(&own).map(kept).collect();
    let of_feature = |spread: &Grid| {
        let pooled = pool(spread);
        spread.like(|p| (share * pooled.at(p) + spread.at(p).powi(2)) / (share + 1.0))
    };
    Pooled { color, features: spreads.iter().map(|planes| planes.iter().map(of_feature).collect()).collect() }
}

/// Halves may agree by accident, so the neighbours' halves count too; all samples of a black pixel may have missed the
/// light.
fn has_noise(color: &Signal, spread: &[Grid], p: Point, params: &NoiseParams) -> bool {
    let largest = |planes: &[Grid], q: Point| planes.iter().map(|plane| plane.at(q).abs()).fold(0.0, f64::max);
    let value = largest(&color.mean, p);
    if let Some(variance) = &color.sample_variance {
        return largest(spread, p).max(largest(variance, p).sqrt()) > params.least_noise * value;
    }
    let beside = square(1).filter(|o| o.x == 0 || o.y == 0).map(|o| p + o).filter(|&q| spread[0].contains(q));
    let deviation = beside.map(|q| largest(spread, q)).fold(0.0, f64::max);
    value == 0.0 || deviation > params.least_noise * value
}

/// The brightness around a pixel, without single bright pixels.
pub fn magnitude(mean: &[Grid], params: &NoiseParams) -> Grid {
    let medians = medians(mean);
    medians.like(|p| medians.at(p).min(params.darker * channel_mean(mean, p).abs()).max(params.least_magnitude))
}

/// The median brightness of 3×3 pixels; of an even number the lower one of the two in the middle.
pub fn medians(mean: &[Grid]) -> Grid {
    mean[0].like(|p| {
        lower_median(
            square(1).map(|o| p + o).filter(|&q| mean[0].contains(q)).map(|q| channel_mean(mean, q).abs()).collect(),
        )
    })
}

/// The squared half spread, smoothed in parts of the magnitude.
pub fn first_guess(spread: &[Grid], magnitude: &Grid, params: &NoiseParams) -> Planes {
    let relative = |plane: &Grid| plane.like(|p| (plane.at(p) / magnitude.at(p)).powi(2));
    let smoothed = spread.iter().map(|plane| gaussian(&relative(plane), params.guess_sigma, params.guess_radius));
    smoothed.map(|plane| plane.like(|p| plane.at(p) * magnitude.at(p).powi(2))).collect()
}

/// The noise of a feature in a small box, from its halves, or from its variance without halves.
pub fn noise_around(signal: &Signal, params: &NoiseParams) -> Planes {
    let squares = |spread: &Grid| spread.like(|p| spread.at(p).powi(2));
    let noise: Planes = match (&signal.spread, &signal.sample_variance) {
        (Some(spread), _) => spread.iter().map(squares).collect(),
        (None, Some(variance)) => variance.clone(),
        (None, None) => signal.mean.iter().map(|grid| grid.like(|_| 0.0)).collect(),
    };
    let average = |plane: &Grid| {
        plane.like(|p| {
            let around: Vec<f64> = square(params.feature_radius)
                .map(|o| p + o)
                .filter(|&q| plane.contains(q))
                .map(|q| plane.at(q))
                .collect();
            around.iter().sum::<f64>() / around.len() as f64
        })
    };
    noise.iter().map(average).collect()
}

/// The mean over the channels of the squared difference less its noise, divided by a scale.
fn distance(mean: &[Grid], variance: &[Grid], p: Point, q: Point, scale: impl Fn(f64) -> f64) -> f64 {
    let of_channel = |(mean, variance): (&Grid, &Grid)| {
        let (of_p, of_q) = (variance.at(p), variance.at(q));
        ((mean.at(p) - mean.at(q)).powi(2) - (of_p + of_p.min(of_q))) / scale(of_p + of_q)
    };
    mean.iter().zip(variance).map(of_channel).sum::<f64>() / mean.len() as f64
}

/// Parameters for estimating noise from an image alone.
#[derive(Clone, Copy, Debug)]
pub struct ImageParams {
    pub fit_radius: usize,
    pub ridge: f64,
    pub fitted_share: f64,
    pub largest: f64,
    pub jump: f64,
    pub jump_radius: usize,
    pub hold_radius: usize,
    pub pool: NoiseParams,
}

/// The parameters that measured best on renders.
impl Default for ImageParams {
    fn default() -> ImageParams {
        let pool = NoiseParams { gate: 4.0, k_feature: 0.6, ..NoiseParams::default() };
        ImageParams {
            fit_radius: 4,
            ridge: 1e-3,
            fitted_share: 0.2,
            largest: 3.0,
            jump: 100.0,
            jump_radius: 2,
            hold_radius: 4,
            pool,
        }
    }
}

/// The variance of a colour without halves and variance. The features `explaining` may explain its texture.
pub fn of_image(mean: &[Grid], features: &[Signal], explaining: &[usize], params: &ImageParams) -> Planes {
    let spread = residual(mean, features, explaining, params);
    let color = Signal { mean: mean.to_vec(), spread: Some(spread), sample_variance: None };
    let pooled = pooled(&color, features, &params.pool).color;
    let magnitude = magnitude(mean, &params.pool);
    let medians = medians(mean);
    let around = |p: Point, radius: usize| square(radius).map(move |o| p + o).filter(|&q| mean[0].contains(q));
    let jumps = |p: Point| {
        let median = |q: Point| medians.at(q).max(params.pool.least_magnitude);
        let brightest = around(p, params.jump_radius).map(median).fold(0.0, f64::max);
        brightest > params.jump * around(p, params.jump_radius).map(median).fold(f64::INFINITY, f64::min)
    };
    let relative = |plane: &Grid, q: Point| plane.at(q) / magnitude.at(q).powi(2);
    let held = |plane: &Grid| {
        plane.like(|p| {
            if !jumps(p) {
                return plane.at(p);
            }
            let calm: Vec<Point> = around(p, params.hold_radius).filter(|&q| !jumps(q)).collect();
            let most = if calm.is_empty() {
                1.0
            } else {
                calm.iter().map(|&q| relative(plane, q)).sum::<f64>() / calm.len() as f64
            };
            plane.at(p).min(most * magnitude.at(p).powi(2))
        })
    };
    pooled.iter().map(held).collect()
}

const AXES: [Point; 2] = [Point { x: 1, y: 0 }, Point { x: 0, y: 1 }];

/// The differences of pixels from their two neighbours, along the axis with the smaller one; partly without the part
/// that features explain.
pub fn residual(mean: &[Grid], features: &[Signal], explaining: &[usize], params: &ImageParams) -> Planes {
    let magnitude = magnitude(mean, &params.pool);
    let terms: Vec<&Grid> = explaining.iter().flat_map(|&index| &features[index].mean).collect();
    // An axis without neighbours gives no difference.
    let axes: Vec<Point> = AXES
        .into_iter()
        .filter(|axis| mean[0].width as isize * axis.x + mean[0].height as isize * axis.y > 1)
        .collect();
    let lesser = |left: [f64; 2]| {
        (0..2).filter(|&a| axes.contains(&AXES[a])).map(|a| left[a].abs()).reduce(f64::min).unwrap_or(0.0)
    };
    // E|D| of the smaller of two residuals equals that of a half spread.
    let scale = 1.0 / (1.5f64.sqrt() * (2.0 - ((10.0f64 / 3.0).sqrt() + (2.0f64 / 3.0).sqrt()) / 2.0));
    mean.iter()
        .map(|channel| {
            channel.like(|p| {
                let own = AXES.map(|axis| stands_out(channel, p, axis));
                let mut noise = lesser(own);
                if !terms.is_empty() {
                    let coefficients = fit_around(channel, &terms, &magnitude, p, params);
                    let explained = |axis: Point| -> f64 {
                        terms.iter().zip(&coefficients).map(|(term, c)| c * stands_out(term, p, axis)).sum()
                    };
                    let left = lesser([own[0] - explained(AXES[0]), own[1] - explained(AXES[1])]);
                    noise = left.powf(params.fitted_share) * noise.powf(1.0 - params.fitted_share);
                }
                noise *= scale;
                if own.iter().all(|own| *own > 0.0) { noise } else { noise.min(params.largest * magnitude.at(p)) }
            })
        })
        .collect()
}

/// The difference from the mean of the two neighbours along an axis; at the border one neighbour stands for both.
fn stands_out(plane: &Grid, p: Point, axis: Point) -> f64 {
    let beside: Vec<f64> =
        [p - axis, p + axis].into_iter().filter(|&q| plane.contains(q)).map(|q| plane.at(q)).collect();
    if beside.is_empty() { 0.0 } else { plane.at(p) - beside.iter().sum::<f64>() / beside.len() as f64 }
}

/// Ridge regression of a channel's differences on those of the terms, along both axes, over the pixels around.
fn fit_around(channel: &Grid, terms: &[&Grid], magnitude: &Grid, p: Point, params: &ImageParams) -> Vec<f64> {
    let n = terms.len();
    let (mut matrix, mut right, mut weights) = (vec![vec![0.0; n]; n], vec![0.0; n], 0.0);
    for q in square(params.fit_radius).map(|o| p + o).filter(|&q| channel.contains(q)) {
        let w = 1.0 / magnitude.at(q).powi(2);
        weights += w;
        for axis in AXES {
            let z: Vec<f64> = terms.iter().map(|term| stands_out(term, q, axis)).collect();
            for i in 0..n {
                right[i] += w * z[i] * stands_out(channel, q, axis);
                (0..n).for_each(|j| matrix[i][j] += w * z[i] * z[j]);
            }
        }
    }
    (0..n).for_each(|i| matrix[i][i] += params.ridge * weights);
    // Gauss's elimination: the ridge keeps the pivots away from 0.
    for i in 0..n {
        for k in i + 1..n {
            let factor = matrix[k][i] / matrix[i][i];
            (i..n).for_each(|j| matrix[k][j] -= factor * matrix[i][j]);
            right[k] -= factor * right[i];
        }
    }
    for i in (0..n).rev() {
        let known: f64 = (i + 1..n).map(|j| matrix[i][j] * right[j]).sum();
        right[i] = (right[i] - known) / matrix[i][i];
    }
    right
}
