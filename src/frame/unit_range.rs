//! Features in unit range, so that one filter parameter fits albedo, normals and depth alike.

use std::ops::RangeInclusive;

use super::Signal;
use super::normals::{self, Encoding};
use super::range::{Range, range_of_hits};
use crate::frame::FeatureKind;

/// Length beyond 1 that normals may have because of noise.
const NORMAL_TOLERANCE: f32 = 0.0001;

/// Map that brought a feature to unit range.
pub(super) struct UnitRange {
    /// `value before = unit value · scale + offset`.
    pub(super) scale: f32,
    pub(super) offset: f32,
    /// Remarks for people.
    pub(super) notes: Vec<String>,
}

/// Brings a sanitised signal to unit range by one affine map for all its channels. Spreads are divided by the scale,
/// variances by its square. Misses get the value 1, without noise. Values that lie farther outside than the range is
/// wide are pulled towards it, with their noise.
///
/// Normals n are mapped by (n + 1)/2; encoded ones, which are (n + 1)/2 already, are decoded first. Everything else is
/// mapped from its least to its greatest value, outliers and far clusters not counted. `None`, with the signal
/// unchanged, if there are no misses and no channel varies by more than round-off: such a feature cannot tell pixels
/// apart.
pub(super) fn to_unit_range(name: &str, kind: FeatureKind, signal: &mut Signal, misses: &[bool]) -> Option<UnitRange> {
    // Rounding may change a constant depth in its last digits.
    let varies = |least: f32, greatest: f32| {
        greatest - least > 1e-6 * least.abs().max(greatest.abs()) && greatest - least > 1e-30
    };
    let constant = !signal.mean.planes.iter().any(|plane| {
        let (least, greatest) = extremes(plane, misses);
        varies(least, greatest)
    });
    // A constant feature with holes: hits become 0 and misses 1, a difference worth having.
    let holes = misses.contains(&true) && misses.contains(&false);
    if constant && !holes {
        return None;
    }
    let may_be_normals = kind == FeatureKind::Normal && signal.mean.channels() == 3;
    let encoding = if may_be_normals { normals::encoding(&signal.mean) } else { Encoding::Plain };
    let mut notes = Vec::new();
    if encoding == Encoding::Halved {
        normals::decode(signal);
        notes.push(format!("feature {name}: stored as (n + 1)/2, taken as the normals n"));
    }
    let Range { mut least, mut greatest, outside, all } =
        range_of_hits(&signal.mean, misses, kind == FeatureKind::Distance);
    if outside > 0 && !varies(least, greatest) {
        (least, greatest) = all;
    } else if outside > 0 {
        notes.push(format!(
            "feature {name}: {outside} of {} values lie far outside of {least} to {greatest} ({} to {} in all); its \
             range is taken without them",
            signal.mean.channels() * (misses.len() - misses.iter().filter(|miss| **miss).count()),
            all.0,
            all.1,
        ));
    }
    let is_normal = may_be_normals && least >= -1.0 - NORMAL_TOLERANCE && greatest <= 1.0 + NORMAL_TOLERANCE;
    let (scale, offset) = match (is_normal, constant) {
        (true, _) => (2.0, -1.0),
        (false, true) => (1.0, least),
        (false, false) => (greatest - least, least),
    };
    map(signal, f64::from(scale), f64::from(offset), least..=greatest);
    for plane in &mut signal.mean.planes {
        plane.iter_mut().zip(misses).filter(|(_, miss)| **miss).for_each(|(value, _)| *value = 1.0);
    }
    let (scale, offset) =
        if encoding == Encoding::Halved { (scale / 2.0, (offset + 1.0) / 2.0) } else { (scale, offset) };
    Some(UnitRange { scale, offset, notes })
}

/// Largest value of a map: dividing by a tiny range must not make anything infinite.
const LARGEST: f64 = 1e18;

/// Distance from the unit range up to which values are not pulled.
const LINEAR: f64 = 1.0;

/// Strength of differences farther outside: values become this times the logarithm of their distance to the range.
const FAR: f64 = 0.25;

/// Returns a unit value, pulled towards [0, 1] if it is far outside. The result rises with the value; values from −1 to
/// 2 stay as they are.
fn pulled(value: f64) -> f64 {
    let beyond = (value - 1.0).max(-value);
    let near = |beyond: f64| if beyond <= LINEAR { beyond } else { LINEAR + FAR * (beyond / LINEAR).ln() };
    match value {
        value if beyond <= LINEAR => value,
        value if value > 0.0 => 1.0 + near(beyond),
        _ => -near(beyond),
    }
}

/// Maps mean, spread and variance. Values `inside` come to the unit range whatever the rounding.
fn map(signal: &mut Signal, scale: f64, offset: f64, inside: RangeInclusive<f32>) {
    let per_unit = 1.0 / scale;
    let unit = |value: f32| {
        let unit = (f64::from(value) - offset) * per_unit;
        if inside.contains(&value) { unit.clamp(0.0, 1.0) } else { unit }
    };
    // Half the difference between the pulled values one deviation above and below a value far outside: its deviation
    // after the pull.
    let pulled_deviation = |mean: f64, deviation: f64| (pulled(mean + deviation) - pulled(mean - deviation)) / 2.0;
    for (channel, mean) in signal.mean.planes.iter_mut().enumerate() {
        for (pixel, mean) in mean.iter_mut().enumerate() {
            let value = unit(*mean);
            *mean = pulled(value) as f32;
            let is_far = pulled(value) != value;
            if let Some(spread) = &mut signal.half_spread {
                let spread = &mut spread.planes[channel][pixel];
                let linear = (f64::from(*spread) * per_unit).clamp(-LARGEST, LARGEST);
                *spread = if is_far { pulled_deviation(value, linear) } else { linear } as f32;
            }
            if let Some(variance) = &mut signal.variance_of_mean {
                let variance = &mut variance.planes[channel][pixel];
                let linear = (f64::from(*variance) * per_unit * per_unit).min(LARGEST);
                *variance = if is_far { pulled_deviation(value, linear.sqrt()).powi(2) } else { linear } as f32;
            }
        }
    }
}

/// Returns the least and the greatest value among the hits; (∞, −∞) if there are none.
fn extremes(plane: &[f32], misses: &[bool]) -> (f32, f32) {
    let hits = plane.iter().zip(misses).filter(|(_, miss)| !**miss).map(|(value, _)| *value);
    hits.fold((f32::INFINITY, f32::NEG_INFINITY), |(least, greatest), value| (least.min(value), greatest.max(value)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_pull_rises_without_a_step_and_leaves_the_unit_range_alone() {
        let values: Vec<f64> = (-4000..=4000).map(|step| f64::from(step) / 1000.0).collect();
        for pair in values.windows(2) {
            let (low, high) = (pulled(pair[0]), pulled(pair[1]));
            assert!(low < high && high - low <= 1.001e-3, "{pair:?} {low} {high}");
        }
        assert!(values.iter().filter(|value| (-1.0..=2.0).contains(*value)).all(|value| pulled(*value) == *value));
        assert!(pulled(1e300) < 200.0 && pulled(-1e300) > -200.0);
    }
}
