//! Noise that is the same on every machine: splitmix64 and Box–Muller.

use super::Grid;
use std::f64::consts::TAU;

/// A stream of random numbers; the seed is all its state.
pub struct Random(pub u64);

impl Random {
    /// The next number of splitmix64.
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Uniform in [0, 1): the upper 53 bits, all that a float64 can hold.
    pub fn uniform(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Zero mean, unit variance.
    pub fn gaussian(&mut self) -> f64 {
        // 1 − uniform is in (0, 1]: its logarithm is finite.
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        radius * (TAU * self.uniform()).cos()
    }

    /// A plane of independent Gaussian values.
    pub fn gaussian_grid(&mut self, width: usize, height: usize, mean: f64, sigma: f64) -> Grid {
        let values = (0..width * height).map(|_| mean + sigma * self.gaussian()).collect();
        Grid { width, height, values }
    }

    /// A plane of independent values, uniform in [low, high).
    pub fn uniform_grid(&mut self, width: usize, height: usize, low: f64, high: f64) -> Grid {
        let values = (0..width * height).map(|_| low + (high - low) * self.uniform()).collect();
        Grid { width, height, values }
    }
}
