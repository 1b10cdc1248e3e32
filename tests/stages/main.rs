//! Every stage on the GPU, compared with its float64 twin, on this machine's adapter. Without an adapter these tests
//! fail with the remedy.
//!
//! Both sides get the same float32 numbers, and every buffer that a kernel is to fill is poisoned before. Tolerances
//! are relative to the terms of a value: for a filtered value, to the weighted mean distance of its neighbours,
//! [`FilteredTwin::span`]. The relative error of a weight exp(−d) is the absolute error of d. Where the weight counts,
//! d < 20 is a mean of at most 147 pixel distances, which f32 sums to about 10⁻⁵. So the tolerance of filtered values
//! is 10⁻⁴ spans.

#[allow(dead_code, unreachable_pub, reason = "every test includes all shared pieces and uses a part of them")]
#[path = "../common/mod.rs"]
mod common;

mod candidate;
mod chapter7;
mod exact;
mod feature;
mod gaussian;
mod keep_clean;
mod nlm;
mod noise;
mod payload;
mod reach;
mod scale;
mod select;
mod spike;
mod variance;
mod window;

use stein_reference as reference;

use reference::nlm::{Feature, FilterParams, Guide, window_weights};
use reference::{Grid, Planes, map_pixels};

/// Tolerance of filtered values, relative to [`FilteredTwin::span`].
pub(crate) const FILTERED: f64 = 1e-4;

/// In f32 exp(−87) is the last weight that is not 0; payloads are at most some 10⁴.
const VANISHING: f64 = 1e-28;

/// A payload filtered in float64.
pub(crate) struct FilteredTwin {
    pub(crate) planes: Planes,
    pub(crate) weight_sum: Grid,
    /// The weighted mean distance of a pixel's neighbours to it, on which relative errors of the weights act. Added are
    /// [`VANISHING`] and a hundredth of the pixel's own value, so that 10⁻⁴ of the span is still eight times the unit
    /// of f32's last digit.
    pub(crate) span: Planes,
}

pub(crate) fn filtered_twin(
    payload: &[Grid],
    guide: Option<Guide>,
    features: &[Feature],
    params: &FilterParams,
) -> FilteredTwin {
    let like = &payload[0];
    let windows = map_pixels(like.width, like.height, |p| {
        let weights = window_weights(like, p, guide, features, params);
        let sum = weights.sum();
        let span = |plane: &Grid| {
            let centre = plane.at(p);
            weights.iter().map(|(q, w)| w * (plane.at(q) - centre).abs()).sum::<f64>() / sum
                + 0.01 * centre.abs()
                + VANISHING
        };
        let of_planes: Vec<(f64, f64)> = payload.iter().map(|plane| (weights.average(plane), span(plane))).collect();
        (of_planes, sum)
    });
    let plane = |values: Vec<f64>| Grid { values, ..*like };
    let planes = |value: fn(&(f64, f64)) -> f64| {
        (0..payload.len()).map(|i| plane(windows.iter().map(|(of, _)| value(&of[i])).collect())).collect()
    };
    FilteredTwin {
        planes: planes(|of| of.0),
        span: planes(|of| of.1),
        weight_sum: plane(windows.iter().map(|of| of.1).collect()),
    }
}
