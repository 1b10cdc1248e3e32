//! How far planes are from what they should be.

use super::{Grid, Planes};

/// What counts as near.
#[derive(Clone, Copy, Debug)]
pub struct Tolerance {
    /// In parts of the scale that stands beside each value.
    pub relative: f64,
    /// Added to that: what the numbers cannot tell apart.
    pub least: f64,
    /// The share of values that may be further off, for decisions that rounding may turn over.
    pub share: f64,
}

/// The value that is farthest off, but for the share that may be.
#[derive(Clone, Copy, Debug)]
pub struct Worst {
    /// In tolerances: up to 1 is near. Infinite where one of both is not a number.
    pub off: f64,
    pub x: usize,
    pub y: usize,
    pub channel: usize,
    pub actual: f64,
    pub expected: f64,
}

/// Compares value by value. `scale` says for each value what a relative error of 1 would be. `None` of no values.
pub fn worst(actual: &[Grid], expected: &[Grid], scale: &[Grid], tolerance: Tolerance) -> Option<Worst> {
    let mut errors = Vec::new();
    for (channel, (actual, (expected, scale))) in actual.iter().zip(expected.iter().zip(scale)).enumerate() {
        for (pixel, ((a, e), s)) in actual.values.iter().zip(&expected.values).zip(&scale.values).enumerate() {
            // Both may have overflowed.
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

/// A scale that is the same everywhere.
pub fn flat(like: &[Grid], scale: f64) -> Planes {
    like.iter().map(|grid| grid.like(|_| scale)).collect()
}

/// Each value's own size, as a scale; `floor` where it vanishes.
pub fn own_size(planes: &[Grid], floor: f64) -> Planes {
    planes.iter().map(|grid| grid.like(|p| grid.at(p).abs() + floor)).collect()
}

impl std::fmt::Display for Worst {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { x, y, channel, actual, expected, .. } = self;
        write!(f, "x {x}, y {y}, channel {channel}: {actual:e} in place of {expected:e}")
    }
}
