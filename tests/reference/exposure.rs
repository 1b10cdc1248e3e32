//! The unit of radiance: the filters' small constants are meant for colours of the order of 1.

use super::Grid;

/// Squares of scaled values are summed in float32.
const LARGEST: f64 = 1e17;

/// The power of two that brings the median brightness between 1 and 2, a pixel's brightness being the largest of its
/// channels. Black pixels do not count, those that are too small for a normal float32 among them. The largest value,
/// the largest standard deviation and the largest half spread stay within what float32 can square and sum.
pub fn exposure(mean: &[Grid], spread: &[Grid], variance: &[Grid]) -> f64 {
    let brightest = |pixel: usize| mean.iter().map(|plane| plane.values[pixel].abs()).fold(0.0, f64::max);
    let mut brightness: Vec<f64> =
        (0..mean[0].values.len()).map(brightest).filter(|value| *value > f64::from(f32::MIN_POSITIVE)).collect();
    if brightness.is_empty() {
        return 1.0;
    }
    brightness.sort_by(f64::total_cmp);
    let median = brightness[brightness.len() / 2];
    let deviations = variance.iter().flat_map(|plane| &plane.values).map(|variance| variance.sqrt());
    let spreads = spread.iter().flat_map(|plane| &plane.values).map(|spread| spread.abs());
    let most = brightness.iter().copied().chain(deviations).chain(spreads).fold(0.0, f64::max);
    (-median.log2().floor()).clamp(-60.0, 60.0).min((LARGEST / most).log2().floor()).exp2()
}
