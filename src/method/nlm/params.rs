//! Parameters of NLM: what chapter 7 prints, with what measurements made of it.

use serde::Serialize;

use crate::error::Result;
use crate::method::Spikes;
use crate::method::common::{LARGEST_PATCH_RADIUS, LARGEST_WINDOW_RADIUS};
use crate::parameters::{Parameter, Values, above, check, choices, list, parameters, pixels, real};
use crate::stage::nlm::{CentreWeight, Symmetry, Weighting};

parameters! {
    /// Parameters of NLM (thesis chapter 7), in [a table](crate::parameters#nlm). [`NlmParams::default`] measured best,
    /// [`NlmParams::thesis`] is the chapter to the letter.
    ///
    /// A frame without halves is filtered with its own weights, whatever `dual_buffer` says.
    #[derive(Clone, Copy, Debug, PartialEq, Serialize)]
    pub struct NlmParams {
        /// r, the radius of the window: a pixel is averaged over (2r+1)² pixels. Work grows with its square.
        pub window_radius: u32 => pixels(1..=LARGEST_WINDOW_RADIUS),
        /// f, the radius of the patches: patches of (2f+1)² pixels are compared. Radius 0 compares single pixels, as
        /// the bilateral filter does.
        pub patch_radius: u32 => pixels(0..=LARGEST_PATCH_RADIUS),
        /// How large a difference counts, in standard deviations. More filters more.
        pub k: f32 => above(0.0).of("σ"),
        /// α: how much of the variance is cancelled from squared differences (eq. 7.4). More filters more.
        pub alpha: f32 => real(0.0..),
        /// How distances become weights.
        pub weighting: Weighting,
        /// Whether a weight is the mean of the weights of all pairs of pixels in the two patches. Otherwise pixels are
        /// weighed by their own patches alone.
        pub patchwise: bool,
        /// Weights below this value become 0.
        pub cut: f32 => real(0.0..=1.0),
        /// Whether each half is filtered with the weights of the other; needs halves. Otherwise it is the original
        /// NL-means, where a pixel's noise helps to choose what it is averaged with.
        pub dual_buffer: bool,
        /// What is taken for the variance of the pixel means.
        pub variance: NlmVariance,
        /// Whether a variance of the mean that is not given is estimated: pooled from the halves of pixels that are
        /// alike, or, where there are no halves either, from the image itself. Otherwise the squared half spread is
        /// smoothed, and an image alone is refused.
        pub pooled_variance: bool,
        /// What becomes of spikes: pixels that stand out from those of their kind and rest on very few samples.
        pub spikes: Spikes,
        /// Whether, over several frames, those that harm a pixel, by its SURE, are left out there. Needs two buffers
        /// and a centre of weight one.
        pub guard_frames: bool,
        /// Whether pixels whose samples show no noise stay as they are, however noisy their neighbours. Black pixels
        /// stay only where everything around them is black: elsewhere their samples may all have missed the light.
        pub keep_clean: bool,
    }
}

choices! {
    /// Source of the variance of the pixel means. Without halves, the sample variance replaces all sources but the
    /// uniform one; without a sample variance, the smoothed two-buffer variance does.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
    #[serde(rename_all = "kebab-case")]
    pub enum NlmVariance {
        /// The sample variance, brought to the magnitude of the two-buffer variance where that is lower (thesis 8.2).
        /// Low-discrepancy samples are never noisier than random ones, so that a ratio above 1 is an accident of few
        /// pixels.
        Scaled => "scaled",
        /// The two-buffer variance, filtered with NL-means weights from the sample variance and held below it (thesis
        /// 7.1.1).
        CrossFiltered => "cross-filtered",
        /// The same everywhere, as in the original NL-means: the mean over the image, per channel (figure 7.11).
        Uniform => "uniform",
    }
}

impl Default for NlmParams {
    fn default() -> Self {
        Self {
            variance: NlmVariance::Scaled,
            spikes: Spikes::Spread,
            guard_frames: true,
            keep_clean: true,
            pooled_variance: true,
            ..Self::thesis()
        }
    }
}

impl NlmParams {
    /// Returns the parameters of thesis 7.2 for the final image.
    pub fn thesis() -> Self {
        Self {
            window_radius: 10,
            patch_radius: 3,
            k: 0.45,
            alpha: 1.0,
            weighting: Weighting { symmetric: Symmetry::Hard, centre: CentreWeight::One },
            patchwise: true,
            cut: 0.05,
            dual_buffer: true,
            variance: NlmVariance::CrossFiltered,
            spikes: Spikes::Keep,
            guard_frames: false,
            keep_clean: false,
            pooled_variance: false,
        }
    }

    /// Returns the parameters for sampling: spikes stay, and r and α are at most 7 and 0.5. So the filter filters less,
    /// and the error that is left is noise and not bias (thesis 7.2).
    #[must_use]
    pub fn while_sampling(self) -> Self {
        Self {
            window_radius: self.window_radius.min(7),
            alpha: self.alpha.min(0.5),
            spikes: Spikes::Keep,
            keep_clean: false,
            ..self
        }
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
