//! The error of a candidate, without a reference (section 8.4).

use super::nlm::{FilterParams, Guide, nlm_filter};
use super::{Grid, Planes};

/// Eq. 8.5, the sum over the channels. It may be negative: only its expectation is the squared error.
/// The term of the derivative counts `covariance` times.
pub fn sure(u: &[Grid], variance: &[Grid], filtered: &[Grid], derivative: &[Grid], covariance: f64) -> Grid {
    u[0].like(|p| {
        (0..u.len())
            .map(|i| {
                let residual = filtered[i].at(p) - u[i].at(p);
                let v = variance[i].at(p);
                residual * residual - v + 2.0 * covariance * v * derivative[i].at(p)
            })
            .sum()
    })
}

/// Lines 19 to 22 of Algorithm 1: just enough smoothing to distinguish the candidates. `aside` has the parameters that
/// all filters share: the treatment of pairs and of the centre.
pub fn smooth_errors(sure: &[Grid], guide: Guide, aside: &FilterParams) -> Planes {
    let params = FilterParams { window_radius: 1, patch_radius: 1, k_color: 1.0, k_feature: f64::INFINITY, ..*aside };
    nlm_filter(sure, Some(guide), &[], &params).planes
}

/// Factors of the parts of the blend's error.
#[derive(Clone, Copy, Debug)]
pub struct ErrorParts {
    pub spread: f64,
    pub disagreement: f64,
    pub own_noise: f64,
    pub spikes: f64,
}

impl ErrorParts {
    /// As measured, for frames with and without halves, and for one candidate or several.
    pub fn measured(has_halves: bool, several: bool) -> ErrorParts {
        let [spread, disagreement, own_noise] = match (has_halves, several) {
            (true, true) => [1.0, 1.5, 0.5],
            (true, false) => [1.7, 0.0, 0.74],
            (false, true) => [0.0, 2.2, 0.53],
            (false, false) => [0.0, 0.0, 1.2],
        };
        ErrorParts { spread, disagreement, own_noise, spikes: 6.0 }
    }
}

/// One of the candidates that a blend is made of.
#[derive(Clone, Copy)]
pub struct Part<'a> {
    pub share: &'a Grid,
    pub mean: &'a [Grid],
    pub derivative: &'a [Grid],
}

/// The squared error of a blend: the noise that its halves show, the distance of its candidates from it, the part of
/// each pixel's noise that its own weight leaves, and the squares of the energy that it got from spikes.
pub fn error_blend(
    mean: &[Grid],
    spread: Option<&[Grid]>,
    variance: &[Grid],
    made_of: &[Part],
    squares: Option<&Grid>,
    parts: ErrorParts,
) -> Grid {
    mean[0].like(|p| {
        let left: f64 = spread.iter().flat_map(|spread| spread.iter()).map(|plane| plane.at(p).powi(2)).sum();
        let of_each = made_of.iter().filter(|part| part.share.at(p) > 0.0).map(|part| {
            let apart: f64 = part.mean.iter().zip(mean).map(|(own, blend)| (own.at(p) - blend.at(p)).powi(2)).sum();
            let noise: f64 = part
                .derivative
                .iter()
                .zip(variance)
                .map(|(derivative, variance)| variance.at(p) * derivative.at(p).clamp(0.0, 1.0))
                .sum();
            part.share.at(p) * (parts.disagreement * apart + parts.own_noise * noise)
        });
        parts.spread * left + of_each.sum::<f64>() + parts.spikes * squares.map_or(0.0, |squares| squares.at(p))
    })
}

/// ε that keeps dark pixels from taking all samples (section 7.1.2).
const RELATIVE_FLOOR: f64 = 1e-3;

/// Section 8.6: an error, summed over the channels, relative to the squared value, times the weight that one more
/// sample has.
pub fn sample_density(mean: &[Grid], error: &Grid, weight_sum: &Grid, samples_per_pixel: f64) -> Grid {
    error.like(|p| {
        let squared: f64 = mean.iter().map(|plane| plane.at(p) * plane.at(p) + RELATIVE_FLOOR).sum();
        error.at(p) / squared * weight_sum.at(p) / (1.0 + samples_per_pixel)
    })
}
