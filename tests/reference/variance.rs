//! Variances from the known noise (sections 8.2 and 8.3). Every variance is that of a pixel's mean, never that of a
//! sample.

use super::gaussian::gaussian;
use super::{Grid, Planes, Point, square};

/// Radius of the 21×21 box of section 8.2.
pub const SCALE_RADIUS: usize = 10;

/// With halves but no sample variance there is only the two-buffer variance: one squared normal variable per pixel, so
/// that a usable estimate needs about fifty pixels.
const HALVES_ONLY_SIGMA: f64 = 2.0;
const HALVES_ONLY_RADIUS: usize = 5;

/// The "small Gaussian kernel with standard deviation of 0.5 pixels" of section 8.3.
const BUFFER_SIGMA: f64 = 0.5;
const BUFFER_RADIUS: usize = 2;

/// A noisy mean and its known noise.
#[derive(Clone, Debug)]
pub struct Signal {
    pub mean: Planes,
    /// See `spread_of_halves`. The halves are `mean ± spread`.
    pub spread: Option<Planes>,
    /// s²/n of each pixel.
    pub sample_variance: Option<Planes>,
}

/// Weights of the pixels of a box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BoxWeight {
    Even,
    /// One over the claimed standard deviation, or over a tenth of the half spread if that is larger.
    Deviation,
}

/// Carries two half-buffer means as one plane, `(A − B)·√(n_A·n_B)/n`: its square is the two-buffer estimate of the
/// variance of the mean of all samples. For equal halves it is (A − B)/2, and the square (A − B)²/4; chapter 7's Δ = (A
/// − B)²/2 is the variance of *one half*.
pub fn spread_of_halves(a: &Grid, b: &Grid, samples_a: f64, samples_b: f64) -> Grid {
    let scale = (samples_a * samples_b).sqrt() / (samples_a + samples_b);
    a.like(|p| (a.at(p) - b.at(p)) * scale)
}

/// The best variance that a signal allows: the sample variance scaled by the halves; the sample variance alone without
/// halves; the two-buffer variance without sample variance. A signal with neither claims to be free of noise.
pub fn input_variance(signal: &Signal, weight: BoxWeight) -> Planes {
    match (&signal.sample_variance, &signal.spread) {
        (Some(variance), Some(spread)) => variance_scale(variance, spread, SCALE_RADIUS, weight),
        (Some(variance), None) => variance.clone(),
        (None, Some(spread)) => {
            spread.iter().map(|spread| gaussian(&squared(spread), HALVES_ONLY_SIGMA, HALVES_ONLY_RADIUS)).collect()
        }
        (None, None) => signal.mean.iter().map(|mean| mean.like(|_| 0.0)).collect(),
    }
}

/// Lower limit of a variance, in place of an ε in eq. 7.4.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Floor {
    /// For radiance, where pixels without noise are kept.
    Relative,
    /// For radiance: the ε of eq. 7.4.
    Printed,
    /// For features in unit range.
    Absolute,
}

/// The floor of the colour.
pub fn of_color(keep_clean: bool) -> Floor {
    if keep_clean { Floor::Relative } else { Floor::Printed }
}

/// The variance of a mean, held above the square of a thousandth of a pixel's brightness or of a ten-thousandth of that
/// around it; the variance of a feature is held above a tiny constant.
pub fn floored(mean: &[Grid], variance: &[Grid], floor: Floor) -> Planes {
    let around = brightness_around(mean);
    let own = |p: Point| mean.iter().map(|plane| plane.at(p).abs()).fold(0.0, f64::max);
    let least_deviation = |p: Point| match floor {
        Floor::Relative => (1e-3 * own(p)).max(1e-4 * around.at(p)),
        Floor::Printed => 1e-5 * around.at(p),
        Floor::Absolute => 1e-5,
    };
    variance.iter().map(|variance| variance.like(|p| variance.at(p).max(least_deviation(p).powi(2)))).collect()
}

/// The largest magnitude of any channel in the 3×3 pixels around each pixel.
pub fn brightness_around(mean: &[Grid]) -> Grid {
    mean[0].like(|p| {
        let around = square(1).map(|offset| p + offset).filter(|&q| mean[0].contains(q));
        around.flat_map(|q| mean.iter().map(move |plane| plane.at(q).abs())).fold(0.0, f64::max)
    })
}

/// `scale_svar` of Algorithm 1: gives the sample variance, which knows the structure of the noise, the magnitude of the
/// two-buffer variance, which is unbiased for low-discrepancy samples too.
pub fn variance_scale(sample_variance: &[Grid], spread: &[Grid], radius: usize, weight: BoxWeight) -> Planes {
    sample_variance
        .iter()
        .zip(spread)
        .map(|(sample_variance, spread)| {
            let two_buffer = squared(spread);
            let weights = sample_variance.like(|q| match weight {
                BoxWeight::Even => 1.0,
                BoxWeight::Deviation if sample_variance.at(q) == 0.0 => 0.0,
                BoxWeight::Deviation => 1.0 / sample_variance.at(q).max(two_buffer.at(q) / 100.0).max(1e-30).sqrt(),
            });
            let weighted = |plane: &Grid| plane.like(|q| weights.at(q) * plane.at(q));
            let (weighted_sample, weighted_two_buffer) = (weighted(sample_variance), weighted(&two_buffer));
            sample_variance.like(|p| {
                let claimed = box_sum(&weighted_sample, p, radius);
                if claimed == 0.0 {
                    return 0.0;
                }
                sample_variance.at(p) * box_sum(&weighted_two_buffer, p, radius) / claimed
            })
        })
        .collect()
}

/// `buffer_var` of Algorithm 1: the smoothed two-buffer variance of each plane.
pub fn buffer_var(spread: &[Grid]) -> Planes {
    spread.iter().map(|spread| gaussian(&squared(spread), BUFFER_SIGMA, BUFFER_RADIUS)).collect()
}

fn box_sum(plane: &Grid, p: Point, radius: usize) -> f64 {
    square(radius).map(|offset| p + offset).filter(|&q| plane.contains(q)).map(|q| plane.at(q)).sum()
}

fn squared(plane: &Grid) -> Grid {
    plane.like(|p| plane.at(p) * plane.at(p))
}
