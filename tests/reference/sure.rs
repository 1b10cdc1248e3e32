//! The error of a candidate, without a reference (section 8.4).

use super::nlm::{FilterParams, Guide, nlm_filter};
use super::{Grid, Planes};

/// Eq. 8.5, the sum over the channels. It may be negative: only its expectation is the squared error.
pub fn sure(u: &[Grid], variance: &[Grid], filtered: &[Grid], derivative: &[Grid]) -> Grid {
    u[0].like(|p| {
        (0..u.len())
            .map(|i| {
                let residual = filtered[i].at(p) - u[i].at(p);
                let v = variance[i].at(p);
                residual * residual - v + 2.0 * v * derivative[i].at(p)
            })
            .sum()
    })
}

/// Lines 19 to 22 of Algorithm 1: just enough smoothing to tell the candidates apart. `aside` gives what is the same in all
/// filters, the treatment of pairs and of the centre.
pub fn smooth_errors(sure: &[Grid], guide: Guide, aside: &FilterParams) -> Planes {
    let params = FilterParams { window_radius: 1, patch_radius: 1, k_color: 1.0, k_feature: f64::INFINITY, ..*aside };
    nlm_filter(sure, Some(guide), &[], &params).planes
}

/// What keeps dark pixels from taking all samples (section 7.1.2).
const RELATIVE_FLOOR: f64 = 1e-3;

/// Section 8.6: an error, summed over the channels and 0 where it is negative, relative to the squared value, times the weight that one more sample has.
pub fn sample_density(mean: &[Grid], error: &Grid, weight_sum: &Grid, samples_per_pixel: f64) -> Grid {
    error.like(|p| {
        let squared: f64 = mean.iter().map(|plane| plane.at(p) * plane.at(p) + RELATIVE_FLOOR).sum();
        error.at(p).max(0.0) / squared * weight_sum.at(p) / (1.0 + samples_per_pixel)
    })
}
