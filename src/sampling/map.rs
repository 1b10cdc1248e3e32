//! From a density to whole numbers of samples (thesis 7.1.3, 8.6).

use super::SampleCounts;
use crate::error::{Error, RequestCause, Result};
use crate::image::Image;

/// A budget of samples, handed out where they pay most.
#[derive(Clone, Debug)]
pub struct SamplingMap {
    /// One plane: expected samples per pixel, not rounded. They sum to the budget and never exceed the cap.
    pub density: Image,
    /// Whole numbers of samples, equal for both halves. They sum to exactly the budget rounded to pairs.
    pub counts: SampleCounts,
}

impl SamplingMap {
    /// Default cap, in multiples of the average. Without a cap, a pixel whose estimate an outlier spoils can take all
    /// samples (thesis 8.6).
    pub const DEFAULT_CAP: u32 = 8;

    /// Hands out `samples_per_pixel` samples on average, in proportion to `density` (one plane, in any unit, at least
    /// 0) and at most `cap` in one pixel. Samples that the cap cuts off go to the other pixels in proportion. If all
    /// other pixels have density 0 or are at the cap, the rest is spread evenly. Rounding errors are carried from pixel
    /// to pixel. The same input gives the same map.
    ///
    /// # Errors
    /// [`Error::Request`] where the budget is negative or not finite, where the cap cannot hold the budget, or where a
    /// density is negative or not finite.
    pub fn new(density: &Image, samples_per_pixel: f64, cap: Option<u32>) -> Result<Self> {
        let misuse = |problem, change| Err(Error::Request(RequestCause::Misuse { problem, change }));
        if density.channels() != 1 {
            return misuse(
                format!("a sampling density has one plane, not {}", density.channels()),
                "give the density alone",
            );
        }
        let weights = &density.planes[0];
        if let Some(bad) = weights.iter().find(|weight| !(weight.is_finite() && **weight >= 0.0)) {
            return misuse(
                format!("the sampling density holds the value {bad}"),
                "give densities that are finite and at least 0",
            );
        }
        let pixels = weights.len();
        let most = cap.map_or(f64::from(u32::MAX / 2), |cap| f64::from(cap / 2));
        let pairs = (samples_per_pixel * pixels as f64 / 2.0).round();
        if !(pairs.is_finite() && pairs >= 0.0) {
            return Err(Error::Request(RequestCause::Budget { samples_per_pixel }));
        }
        if pairs > most * pixels as f64 {
            return Err(Error::Request(RequestCause::BudgetAboveCap { samples_per_pixel, cap: 2.0 * most }));
        }
        let real = share_out(weights, pairs, most);
        let whole = carry(&real, pairs as u64, most as u32);
        let extent = density.extent;
        let density = Image { extent, planes: vec![real.iter().map(|pairs| (2.0 * pairs) as f32).collect()] };
        Ok(Self { density, counts: SampleCounts::from_pairs(extent, whole)? })
    }
}

/// Returns shares of `total` in proportion to `weights`, none above `most`. `total` must fit.
fn share_out(weights: &[f32], total: f64, most: f64) -> Vec<f64> {
    let mut shares = vec![0.0; weights.len()];
    let mut open: Vec<usize> = (0..weights.len()).filter(|&pixel| weights[pixel] > 0.0).collect();
    let mut left = total;
    // Each round closes the pixels that reach the cap; samples that they cannot take go to the open pixels.
    while !open.is_empty() && left > 0.0 {
        let sum: f64 = open.iter().map(|&pixel| f64::from(weights[pixel])).sum();
        let scale = left / sum;
        let full = |pixel: usize| f64::from(weights[pixel]) * scale >= most;
        if !open.iter().any(|&pixel| full(pixel)) {
            for &pixel in &open {
                shares[pixel] = f64::from(weights[pixel]) * scale;
            }
            return shares;
        }
        open.retain(|&pixel| {
            if full(pixel) {
                shares[pixel] = most;
                left -= most;
            }
            !full(pixel)
        });
    }
    // All pixels with weight are at the cap: the rest goes to the pixels without weight.
    let without: Vec<usize> = (0..weights.len()).filter(|&pixel| shares[pixel] == 0.0).collect();
    for &pixel in &without {
        shares[pixel] = (left.max(0.0) / without.len() as f64).min(most);
    }
    shares
}

/// Rounds shares to whole numbers that sum to `total`, handing each rounding error to the next pixel.
fn carry(shares: &[f64], total: u64, most: u32) -> Vec<u32> {
    let mut error = 0.0;
    let mut whole: Vec<u32> = shares
        .iter()
        .map(|share| {
            let wanted = share + error;
            let given = wanted.round().clamp(0.0, f64::from(most));
            error = wanted - given;
            given as u32
        })
        .collect();
    // The rest is the error of the last pixel and the rounding of the sums.
    let mut handed_out: u64 = whole.iter().map(|&pairs| u64::from(pairs)).sum();
    while handed_out != total {
        for pairs in whole.iter_mut().rev() {
            if handed_out < total && *pairs < most {
                *pairs += 1;
                handed_out += 1;
            } else if handed_out > total && *pairs > 0 {
                *pairs -= 1;
                handed_out -= 1;
            }
            if handed_out == total {
                break;
            }
        }
    }
    whole
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Extent;

    fn density(values: Vec<f32>) -> Image {
        Image { extent: Extent { width: values.len() as u32, height: 1 }, planes: vec![values] }
    }

    fn samples(map: &SamplingMap) -> Vec<u32> {
        map.counts.pairs().iter().map(|pairs| 2 * pairs).collect()
    }

    #[test]
    fn samples_follow_the_density() {
        let map = SamplingMap::new(&density(vec![0.0, 1.0, 3.0, 4.0]), 8.0, None).expect("a valid density");
        assert_eq!(samples(&map), [0, 4, 12, 16]);
    }

    #[test]
    fn what_a_cap_cuts_off_goes_to_the_others() {
        let map = SamplingMap::new(&density(vec![0.0, 1.0, 1.0, 100.0]), 4.0, Some(8)).expect("a valid density");
        assert_eq!(samples(&map), [0, 4, 4, 8]);
        assert!((map.density.planes[0].iter().sum::<f32>() - 16.0).abs() < 1e-4);
    }

    #[test]
    fn a_cap_that_cannot_hold_the_budget_is_refused() {
        assert!(matches!(SamplingMap::new(&density(vec![1.0, 1.0]), 9.0, Some(8)), Err(Error::Request { .. })));
    }

    #[test]
    fn a_density_of_nothing_spreads_evenly() {
        let map = SamplingMap::new(&density(vec![0.0; 5]), 4.0, None).expect("a valid density");
        assert_eq!(samples(&map), [4; 5]);
    }

    #[test]
    fn densities_that_are_no_numbers_are_refused() {
        for bad in [f32::NAN, f32::INFINITY, -1.0] {
            assert!(SamplingMap::new(&density(vec![1.0, bad]), 4.0, None).is_err());
        }
        assert!(SamplingMap::new(&density(vec![1.0]), f64::NAN, None).is_err());
    }

    #[test]
    fn budgets_are_met_exactly_on_a_thousand_random_maps() {
        let mut state = 1u64;
        let mut random = || {
            // splitmix64
            state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
            let mut bits = state;
            bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            (bits ^ (bits >> 31)) as f64 / u64::MAX as f64
        };
        for _ in 0..1000 {
            let pixels = 1 + (random() * 400.0) as usize;
            // Densities over many orders of magnitude, a third of them 0.
            let values: Vec<f32> = (0..pixels)
                .map(|_| if random() < 0.33 { 0.0 } else { 10f64.powf(12.0 * random() - 6.0) as f32 })
                .collect();
            let budget = random() * 64.0;
            let cap = (random() < 0.7).then(|| (budget * (1.0 + 4.0 * random())) as u32 + 4);
            let map = SamplingMap::new(&density(values.clone()), budget, cap).expect("a valid density");
            let expected = 2 * (budget * pixels as f64 / 2.0).round() as u64;
            assert_eq!(map.counts.total_samples(), expected);
            if let Some(cap) = cap {
                assert!(samples(&map).iter().all(|&count| count <= cap));
            }
            let real: f64 = map.density.planes[0].iter().map(|&value| f64::from(value)).sum();
            assert!((real - expected as f64).abs() <= 1e-4 * expected as f64 + 1e-3, "{real} is not {expected}");
            let again = SamplingMap::new(&density(values), budget, cap).expect("a valid density");
            assert_eq!(map.counts.pairs(), again.counts.pairs());
        }
    }
}
