//! Noise that neighbouring pixels share.

use std::f64::consts::FRAC_PI_2;

use crate::image::Image;

/// Correlation from which neighbours are said to share noise. Independent pixels stay below .03 on renders of 36 000
/// pixels.
const CORRELATED: f64 = 0.1;
/// Least size of a correlation that is no accident, in standard deviations of its estimate.
const SIGMAS: f64 = 5.0;

/// Returns the correlation of the half spread between a pixel and its right or lower neighbour, whichever is larger:
/// from 0.1 to 1. `None` if the correlation may be an accident, as for independent pixels and for images of too few
/// pixels.
///
/// Compares only signs, so that no spike counts for more than other pixels. For Gaussian noise with correlation r,
/// signs have the correlation 2·arcsin(r)/π. Values that are 0 or not a number are left out.
pub(super) fn shared_noise(half_spread: &Image) -> Option<f64> {
    let width = half_spread.extent.width as usize;
    let mut right = Signs::default();
    let mut down = Signs::default();
    for plane in &half_spread.planes {
        plane.chunks_exact(width).for_each(|row| row.iter().zip(&row[1..]).for_each(|pair| right.add(pair)));
        plane.iter().zip(&plane[width..]).for_each(|pair| down.add(pair));
    }
    let correlations = [right, down].map(|signs| signs.correlation(half_spread.channels()));
    correlations.into_iter().flatten().reduce(f64::max)
}

/// Sums over pairs of neighbours.
#[derive(Default)]
struct Signs {
    /// Number of pairs in which both values have a sign.
    pairs: i64,
    /// Σ of the products of both signs.
    products: i64,
    /// Σ of all signs.
    balance: i64,
}

impl Signs {
    fn add(&mut self, (a, b): (&f32, &f32)) {
        let sign = |value: f32| i64::from(value > 0.0) - i64::from(value < 0.0);
        let (a, b) = (sign(*a), sign(*b));
        if a != 0 && b != 0 {
            self.pairs += 1;
            self.products += a * b;
            self.balance += a + b;
        }
    }

    /// Returns the correlation of the values; `None` if it may be an accident.
    fn correlation(&self, channels: usize) -> Option<f64> {
        if self.pairs == 0 {
            return None;
        }
        let pairs = self.pairs as f64;
        // One half may be brighter than the other everywhere.
        let mean_square = (self.balance as f64 / (2.0 * pairs)).powi(2);
        if mean_square == 1.0 {
            return None;
        }
        let of_signs = (self.products as f64 / pairs - mean_square) / (1.0 - mean_square);
        let of_values = (FRAC_PI_2 * of_signs.clamp(-1.0, 1.0)).sin();
        // The channels of a pixel share their noise.
        let accident = SIGMAS / (pairs / channels as f64).sqrt();
        (of_values >= CORRELATED.max(accident)).then_some(of_values)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Extent;

    /// Uniform noise from −½ to ½; every hundredth value a thousand times larger.
    fn noise(extent: Extent) -> Vec<f32> {
        let mut state = 0x9e37_79b9_7f4a_7c15u64;
        let mut next = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f32 / (1u64 << 24) as f32 - 0.5
        };
        (0..extent.pixels()).map(|pixel| next() * if pixel % 100 == 0 { 1000.0 } else { 1.0 }).collect()
    }

    fn image(extent: Extent, plane: Vec<f32>) -> Image {
        Image { extent, planes: vec![plane; 3] }
    }

    #[test]
    fn independent_pixels_share_no_noise_and_blurred_ones_do() {
        let extent = Extent { width: 96, height: 64 };
        let plane = noise(extent);
        assert_eq!(shared_noise(&image(extent, plane.clone())), None);
        // One half brighter than the other.
        assert_eq!(shared_noise(&image(extent, plane.iter().map(|value| value + 0.4).collect())), None);
        let beside = |step: usize| {
            plane.iter().enumerate().map(|(at, value)| value + plane[(at + step) % plane.len()]).collect()
        };
        for step in [1, 96] {
            let found = shared_noise(&image(extent, beside(step)));
            assert!(found.is_some_and(|correlation| (0.4..0.6).contains(&correlation)), "{found:?}");
        }
    }

    #[test]
    fn few_pixels_or_none_with_noise_tell_nothing() {
        for (width, height) in [(1, 1), (1, 9), (9, 1), (3, 3)] {
            let extent = Extent { width, height };
            assert_eq!(shared_noise(&Image::filled(extent, 3, 1.0)), None);
            assert_eq!(shared_noise(&Image::filled(extent, 3, 0.0)), None);
            assert_eq!(shared_noise(&Image::filled(extent, 3, f32::NAN)), None);
        }
    }
}
