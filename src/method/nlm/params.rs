//! Parameters of NLM: what chapter 7 prints, with what measurements made of it.

use serde::Serialize;

use crate::error::Result;
use crate::method::Spikes;
use crate::method::common::{LARGEST_PATCH_RADIUS, LARGEST_WINDOW_RADIUS, refused};
use crate::stage::nlm::{CentreWeight, Symmetry, Weighting};

/// Parameters of NLM (thesis chapter 7). [`NlmParams::default`] is what measured best, [`NlmParams::thesis`] is the chapter to the letter.
///
/// | parameter | default | thesis | range | meaning |
/// | --- | --- | --- | --- | --- |
/// | `window_radius` | 10 | 10 | 1–64 pixels | r: a pixel is averaged over (2r+1)² pixels; work grows with its square |
/// | `patch_radius` | 3 | 3 | 0–5 pixels | f: patches of (2f+1)² pixels are compared; 0 compares single pixels, as the bilateral filter does |
/// | `k` | 0.45 | 0.45 | > 0 | how large a difference counts, in standard deviations; more filters more |
/// | `alpha` | 1 | 1 | ≥ 0 | α: how much of the variance is cancelled from squared differences (eq. 7.4) |
/// | `weighting.symmetric` | hard | hard | | whether the mean of opposite neighbours may stand for both (eq. 7.6) |
/// | `weighting.centre` | one | one | | weight of a pixel in its own average |
/// | `patchwise` | yes | yes | | a weight is the mean of the weights of all pairs of pixels in the two patches |
/// | `cut` | 0.05 | 0.05 | 0–1 | weights below it become 0 |
/// | `dual_buffer` | yes | yes | | each half is filtered with the weights of the other; needs halves |
/// | `variance` | scaled | cross-filtered | | what is taken for the variance of the pixel means |
/// | `spikes` | spread | keep | | what becomes of pixels that stand out and rest on few samples |
/// | `guard_frames` | yes | no | | over several frames, whether those that harm a pixel, by its SURE, are left out there; needs two buffers and a centre of weight one |
///
/// A frame without halves is filtered with its own weights, whatever `dual_buffer` says.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct NlmParams {
    /// r, in pixels.
    pub window_radius: u32,
    /// f, in pixels.
    pub patch_radius: u32,
    /// k.
    pub k: f32,
    /// α.
    pub alpha: f32,
    /// How distances become weights.
    pub weighting: Weighting,
    /// Whether weights are averaged over the patches.
    pub patchwise: bool,
    /// Smallest weight that counts.
    pub cut: f32,
    /// `false`: the original NL-means, where a pixel's noise helps to choose what it is averaged with.
    pub dual_buffer: bool,
    /// What is taken for the variance of the pixel means.
    pub variance: NlmVariance,
    /// What becomes of spikes.
    pub spikes: Spikes,
    /// Whether frames beside that harm a pixel are left out there.
    pub guard_frames: bool,
}

/// What is taken for the variance of the pixel means. Without halves the sample variance stands for all but the uniform one, without sample variance the smoothed
/// two-buffer variance does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum NlmVariance {
    /// The sample variance, brought to the magnitude of the two-buffer variance where that is lower (thesis 8.2). Low-discrepancy samples are never noisier than random ones, so
    /// that a ratio above 1 is an accident of few pixels.
    Scaled,
    /// The two-buffer variance, filtered with NL-means weights from the sample variance and held below it (thesis 7.1.1).
    CrossFiltered,
    /// The same everywhere, as in the original NL-means: the mean over the image, per channel (figure 7.11).
    Uniform,
}

impl Default for NlmParams {
    fn default() -> Self {
        Self { variance: NlmVariance::Scaled, spikes: Spikes::Spread, guard_frames: true, ..Self::thesis() }
    }
}

impl NlmParams {
    /// The parameters of thesis 7.2 for the final image.
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
        }
    }

    /// Spikes stay. Filters less, so that the error that is left is noise and not bias (thesis 7.2): r and α are 7 and 0.5 at the most.
    #[must_use]
    pub fn while_sampling(self) -> Self {
        Self { window_radius: self.window_radius.min(7), alpha: self.alpha.min(0.5), spikes: Spikes::Keep, ..self }
    }

    /// Checks the ranges of the table above.
    ///
    /// # Errors
    /// [`Error::Request`](crate::Error::Request) naming the parameter and its range.
    pub fn validate(&self) -> Result<()> {
        if !(1..=LARGEST_WINDOW_RADIUS).contains(&self.window_radius) {
            return refused("the window radius", self.window_radius, &format!("from 1 to {LARGEST_WINDOW_RADIUS} pixels"));
        }
        if self.patch_radius > LARGEST_PATCH_RADIUS {
            return refused("the patch radius", self.patch_radius, &format!("from 0 to {LARGEST_PATCH_RADIUS} pixels"));
        }
        if !(self.k.is_finite() && self.k > 0.0) {
            return refused("k", self.k, "finite and above 0");
        }
        if !(self.alpha.is_finite() && self.alpha >= 0.0) {
            return refused("α", self.alpha, "finite and at least 0");
        }
        if !(0.0..=1.0).contains(&self.cut) {
            return refused("the smallest weight", self.cut, "from 0 to 1");
        }
        Ok(())
    }
}
