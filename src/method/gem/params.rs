//! Parameters of GEM.

use serde::Serialize;

use crate::error::{Error, Result};
use crate::stage::gaussian::Gaussian;

/// Parameters of GEM (thesis chapter 6).
///
/// | parameter | default | thesis | range | meaning |
/// | --- | --- | --- | --- | --- |
/// | `gamma` | 0.2 | 0.1 | above 0, below 0.4 | γ: the share of wrong decisions for the finer scale in a constant region; lower is smoother, higher is sharper and more spotted |
/// | `phase` | final | final | | which scales, and how outliers are removed from the stopping maps |
///
/// | phase | σ of the scales, in pixels | maps smoothed by | outliers |
/// | --- | --- | --- | --- |
/// | sampling | 1, 2, 4, 8 | the coarse scale of the pair | removed both ways |
/// | final | √2, 2, √8, 4 … 16 | twice the coarse scale | only changes towards the coarser scale |
///
/// The pixel filter is the finest scale of both. Gaussians end at 3σ, rounded up. The samples per pixel of the frame correct for the variance of few samples
/// (ρ = 1 − 1/n); where the frame does not know them, nothing is corrected.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct GemParams {
    /// γ.
    pub gamma: f32,
    /// Which scales, and how outliers are removed.
    pub phase: Phase,
}

/// What the result is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Phase {
    /// To tell where samples are missing: fewer scales, and clusters of outliers are left to be sampled.
    Sampling,
    /// To be looked at (thesis 6.4, final reconstruction).
    Final,
}

impl Phase {
    /// σ of the scales from fine to coarse, in pixels, without the pixel filter.
    pub fn sigmas(self) -> &'static [f32] {
        const SQRT_2: f32 = std::f32::consts::SQRT_2;
        match self {
            Self::Sampling => &[1.0, 2.0, 4.0, 8.0],
            Self::Final => &[SQRT_2, 2.0, 2.0 * SQRT_2, 4.0, 4.0 * SQRT_2, 8.0, 8.0 * SQRT_2, 16.0],
        }
    }

    pub(super) fn coarsest(self) -> f32 {
        self.sigmas().iter().copied().fold(0.0, f32::max)
    }

    /// What smooths the stopping map of the step to a scale.
    pub(super) fn outlier_filter(self, sigma: f32) -> Gaussian {
        match self {
            Self::Sampling => Gaussian::new(sigma),
            Self::Final => Gaussian::new(2.0 * sigma),
        }
    }

    pub(super) fn coarser_only(self) -> bool {
        self == Self::Final
    }
}

impl Default for GemParams {
    fn default() -> Self {
        Self { gamma: 0.2, phase: Phase::Final }
    }
}

impl GemParams {
    /// As the published results were made (thesis 6.5).
    pub fn thesis() -> Self {
        Self { gamma: 0.1, phase: Phase::Final }
    }

    /// Radius of the coarsest Gaussian, in pixels.
    pub(crate) fn window_radius(&self) -> u32 {
        Gaussian::new(self.phase.coarsest()).radius
    }

    /// z(γ), the weight of the selector's bias term (thesis 6.2.3): found by experiment, so that the selector errs at the rate γ in constant regions.
    pub fn bias_weight(&self) -> f32 {
        let wrong = (1.9 * f64::from(self.gamma)).powf(std::f64::consts::FRAC_1_SQRT_2);
        -(1.0 - wrong).ln() as f32
    }

    /// Checks the range of γ.
    ///
    /// # Errors
    /// [`Error::Request`] naming the parameter and its range.
    pub fn validate(&self) -> Result<()> {
        if self.gamma > 0.0 && self.gamma < 0.4 {
            return Ok(());
        }
        Err(Error::Request { problem: format!("γ is {}, outside its range", self.gamma), remedy: "choose it above 0 and below 0.4".into() })
    }
}
