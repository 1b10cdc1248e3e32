//! Features in unit range, so that one filter parameter fits albedo, normals and depth alike.

use super::Signal;
use crate::buffers::names;
use crate::image::Image;

/// Brings a sanitised signal to unit range by one affine map for all its channels and returns `(scale, offset)` of
/// `value before = unit value · scale + offset`. Spreads are divided by the scale, variances by its square. Misses get the value 1, without noise.
///
/// Normals are mapped by (n + 1)/2, everything else from its least to its greatest value among the hits. `None`, and nothing changed, where there
/// are no misses and no channel varies by more than round-off: such a feature cannot tell pixels apart.
pub(super) fn to_unit_range(name: &str, signal: &mut Signal, misses: &[bool]) -> Option<(f32, f32)> {
    let ranges: Vec<(f32, f32)> = signal.mean.planes.iter().map(|plane| range_of_hits(plane, misses)).collect();
    // Rounding makes a constant depth vary in its last digits.
    let varies = |(least, greatest): &(f32, f32)| greatest - least > 1e-6 * least.abs().max(greatest.abs()) && greatest - least > 1e-30;
    let constant = !ranges.iter().any(varies);
    // Flat, but with holes in it: hits become 0 and misses 1, a difference worth having.
    let holes = misses.contains(&true) && misses.contains(&false);
    if constant && !holes {
        return None;
    }
    let least = ranges.iter().map(|range| range.0).fold(f32::INFINITY, f32::min);
    let greatest = ranges.iter().map(|range| range.1).fold(f32::NEG_INFINITY, f32::max);
    let normal = names::is_normal_name(name) && signal.mean.channels() == 3 && least >= -1.0001 && greatest <= 1.0001;
    let (scale, offset) = match (normal, constant) {
        (true, _) => (2.0, -1.0),
        (false, true) => (1.0, least),
        (false, false) => (greatest - least, least),
    };

    let per_unit = 1.0 / f64::from(scale);
    map(&mut signal.mean, |value| ((f64::from(value) - f64::from(offset)) * per_unit).clamp(0.0, 1.0));
    for plane in &mut signal.mean.planes {
        plane.iter_mut().zip(misses).filter(|(_, miss)| **miss).for_each(|(value, _)| *value = 1.0);
    }
    if let Some(spread) = &mut signal.half_spread {
        map(spread, |value| (f64::from(value) * per_unit).clamp(-LARGEST, LARGEST));
    }
    if let Some(variance) = &mut signal.variance_of_mean {
        map(variance, |value| (f64::from(value) * per_unit * per_unit).min(LARGEST));
    }
    Some((scale, offset))
}

/// Dividing by a tiny range must not make anything infinite.
const LARGEST: f64 = 1e18;

fn map(image: &mut Image, settle: impl Fn(f32) -> f64) {
    image.planes.iter_mut().flatten().for_each(|value| *value = settle(*value) as f32);
}

/// Least and greatest value among the hits; (∞, −∞) if there are none.
fn range_of_hits(plane: &[f32], misses: &[bool]) -> (f32, f32) {
    let hits = plane.iter().zip(misses).filter(|(_, miss)| !**miss).map(|(value, _)| *value);
    hits.fold((f32::INFINITY, f32::NEG_INFINITY), |(least, greatest), value| (least.min(value), greatest.max(value)))
}
