//! Parameters of GEM.

use std::ops::Bound;

use serde::Serialize;

use crate::error::Result;
use crate::method::Spikes;
use crate::parameters::{Parameter, Values, check, choices, list, parameters, real};
use crate::stage::gaussian::Gaussian;

parameters! {
    /// Parameters of GEM (thesis chapter 6), in [a table](crate::parameters#gem). [`GemParams::default`] measured best,
    /// [`GemParams::thesis`] made the results of the chapter.
    ///
    /// | phase | σ of the scales, in pixels | maps smoothed by | outliers |
    /// | --- | --- | --- | --- |
    /// | sampling | 1, 2, 4, 8 | the coarse scale of the pair | removed both ways |
    /// | final | √2, 2, √8, 4 … 16 | `final_outlier_size` times the coarse scale | changes to the coarser scale only |
    ///
    /// Measured, as geometric means of the relative MSE, on ten renders (four scenes at 8 to 128 samples per pixel) and
    /// six of the built-in scenes at 32:
    ///
    /// | γ | size 1 | size 2 |
    /// | --- | --- | --- |
    /// | 0.1 | 0.0064 | 0.0078 |
    /// | 0.15 | 0.0060 | 0.0066 |
    /// | 0.2 | 0.0069 | 0.0070 |
    ///
    /// The larger filter takes the stopping maps along edges for outliers; without the rule that only changes towards
    /// the coarser scale count, spikes stay (0.1 in place of 0.009 on `caustic_ring` at 32).
    ///
    /// The pixel filter is the finest scale of both phases. Gaussians end at 3σ, rounded up. The samples per pixel of
    /// the frame correct for the variance of few samples (ρ = 1 − 1/n); without them, nothing is corrected.
    #[derive(Clone, Copy, Debug, PartialEq, Serialize)]
    pub struct GemParams {
        /// γ: the share of wrong decisions for the finer scale in a constant region. Lower is smoother, higher is
        /// sharper and more spotted.
        pub gamma: f32 => real((Bound::Excluded(0.0), Bound::Excluded(0.4))),
        /// What the result is for: which scales there are, and how outliers are removed from the stopping maps.
        pub phase: Phase,
        /// Size of the filter that removes outliers from the stopping maps for the final image, in sizes of the pair's
        /// coarse scale.
        pub final_outlier_size: f32 => real(0.5..=4.0),
        /// Whether a variance of the mean that is not given is estimated: pooled from the halves of pixels that are
        /// alike, or, where there are no halves either, from the image itself. Otherwise the squared half spread is
        /// smoothed, and an image alone is refused.
        pub pooled_variance: bool,
        /// What becomes of spikes: pixels that stand out from those of their kind and rest on very few samples.
        pub spikes: Spikes,
        /// Whether pixels whose samples show no noise stay as they are, however noisy their neighbours. Black pixels
        /// stay only where everything around them is black: elsewhere their samples may all have missed the light.
        pub keep_clean: bool,
    }
}

choices! {
    /// Purpose of the result.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
    #[serde(rename_all = "lowercase")]
    pub enum Phase {
        /// To tell where samples are missing: fewer scales, and clusters of outliers are left to be sampled.
        Sampling => "sampling",
        /// To be looked at (thesis 6.4, final reconstruction).
        Final => "final",
    }
}

impl Phase {
    /// Returns σ of the scales from fine to coarse, in pixels, without the pixel filter.
    pub fn sigmas(self) -> &'static [f32] {
        const SQRT_2: f32 = std::f32::consts::SQRT_2;
        match self {
            Self::Sampling => &[1.0, 2.0, 4.0, 8.0],
            Self::Final => &[SQRT_2, 2.0, 2.0 * SQRT_2, 4.0, 4.0 * SQRT_2, 8.0, 8.0 * SQRT_2, 16.0],
        }
    }

    /// Returns the largest σ, in pixels.
    pub(super) fn coarsest(self) -> f32 {
        self.sigmas().iter().copied().fold(0.0, f32::max)
    }

    /// Returns whether smoothing a stopping map may move pixels only to the coarser scale (thesis 6.4).
    pub(super) fn coarser_only(self) -> bool {
        self == Self::Final
    }
}

impl Default for GemParams {
    fn default() -> Self {
        Self {
            gamma: 0.15,
            final_outlier_size: 1.0,
            spikes: Spikes::Spread,
            keep_clean: true,
            pooled_variance: true,
            ..Self::thesis()
        }
    }
}

impl GemParams {
    /// Returns the parameters of the published results (thesis 6.4, 6.5).
    pub fn thesis() -> Self {
        Self {
            gamma: 0.1,
            phase: Phase::Final,
            final_outlier_size: 2.0,
            spikes: Spikes::Keep,
            keep_clean: false,
            pooled_variance: false,
        }
    }

    /// Returns the filter that smooths the stopping map of the step to a scale (thesis 6.2.4).
    pub(super) fn outlier_filter(&self, sigma: f32) -> Gaussian {
        match self.phase {
            Phase::Sampling => Gaussian::new(sigma),
            Phase::Final => Gaussian::new(self.final_outlier_size * sigma),
        }
    }

    /// Returns the radius of the coarsest Gaussian, in pixels.
    pub(crate) fn window_radius(&self) -> u32 {
        Gaussian::new(self.phase.coarsest()).radius
    }

    /// Returns z(γ), the weight of the selector's bias term (thesis 6.2.3). It was found by experiment, so that the
    /// selector errs at the rate γ in constant regions.
    pub fn bias_weight(&self) -> f32 {
        let wrong = (1.9 * f64::from(self.gamma)).powf(std::f64::consts::FRAC_1_SQRT_2);
        -(1.0 - wrong).ln() as f32
    }

    /// Returns the parameters, with their documentation and ranges.
    pub fn parameters(&self) -> Vec<Parameter> {
        list(Values { value: Some(*self), default: Some(Self::default()), thesis: Some(Self::thesis()) })
    }

    /// Checks the ranges.
    ///
    /// # Errors
    /// [`Error::Request`](crate::Error::Request) naming the parameter and its range.
    pub fn validate(&self) -> Result<()> {
        check(&self.parameters())
    }
}
