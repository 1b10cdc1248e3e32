//! Comparison of planes with their expected values.

use super::{Grid, Planes};

/// Tolerance of a comparison.
#[derive(Clone, Copy, Debug)]
pub struct Tolerance {
    /// Tolerance relative to the scale of each value.
    pub relative: f64,
    /// Absolute tolerance, added to the relative one.
    pub least: f64,
    /// The share of values that may be further off, because rounding may change a decision.
    pub share: f64,
}

/// The value that is farthest off, apart from the allowed share.
#[derive(Clone, Copy, Debug)]
pub struct Worst {
    /// Error in tolerances: up to 1 is near. Infinite if one of both values is NaN.
    pub off: f64,
    pub x: usize,
    pub y: usize,
    pub channel: usize,
    pub actual: f64,
    pub expected: f64,
}

/// Compares value by value. `scale` holds for each value the size of a relative error of 1. Returns `None` for no
/// values.
pub fn worst(actual: &[Grid], expected: &[Grid], scale: &[Grid], tolerance: Tolerance) -> Option<Worst> {
    let mut errors = Vec::new();
    for (channel, (actual, (expected, scale))) in actual.iter().zip(expected.iter().zip(scale)).enumerate() {
        for (pixel, ((a, e), s)) in actual.values.iter().zip(&expected.values).zip(&scale.values).enumerate() {
            // Both may be infinite by overflow.
            let is_same = a == e || (a.is_nan() && e.is_nan());
            let off = if is_same { 0.0 } else { (a - e).abs() / (tolerance.relative * s + tolerance.least) };
            errors.push((if off.is_nan() { f64::INFINITY } else { off }, channel, pixel));
        }
    }
    let skipped = (tolerance.share * errors.len() as f64) as usize;
    if skipped >= errors.len() {
        return None;
    }
    let &mut (off, channel, pixel) = errors.select_nth_unstable_by(skipped, |a, b| b.0.total_cmp(&a.0)).1;
    let width = expected[channel].width;
    let (actual, expected) = (actual[channel].values[pixel], expected[channel].values[pixel]);
    Some(Worst { off, x: pixel % width, y: pixel / width, channel, actual, expected })
}

/// A constant scale.
pub fn flat(like: &[Grid], scale: f64) -> Planes {
    like.iter().map(|grid| grid.like(|_| scale)).collect()
}

/// The size of each value as its scale, at least `floor`.
pub fn own_size(planes: &[Grid], floor: f64) -> Planes {
    planes.iter().map(|grid| grid.like(|p| grid.at(p).abs() + floor)).collect()
}

impl std::fmt::Display for Worst {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { x, y, channel, actual, expected, .. } = self;
        write!(f, "x {x}, y {y}, channel {channel}: {actual:e} in place of {expected:e}")
    }
}
