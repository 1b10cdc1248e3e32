//! Parameters of DFC: the table of Algorithm 1, with what measurements made of it.

use serde::Serialize;

use crate::error::{Error, Result};
use crate::method::Spikes;
use crate::method::common::{LARGEST_PATCH_RADIUS, LARGEST_WINDOW_RADIUS, refused};
use crate::stage::candidate_set::CandidateSet;
use crate::stage::nlm::{CentreWeight, Symmetry, Weighting};
use crate::stage::select::Guard;
use crate::stage::variance::BoxWeight;

/// Parameters of DFC (thesis chapter 8). [`DfcParams::default`] is what measured best, [`DfcParams::thesis`] is Algorithm 1 to the letter.
///
/// | parameter | default | thesis | range | meaning |
/// | --- | --- | --- | --- | --- |
/// | `window_radius` | 10 | 10 | 1–64 pixels | R: candidates average over 2R+1 squared pixels; work grows with its square |
/// | `candidates` | all | all | at least one | which of FIRST, SECOND and THIRD take part; FIRST has to filter more than SECOND where both do |
/// | `color_k` | 0.45 | 0.45 | > 0 | k_c of FIRST and SECOND |
/// | `first_patch_radius` | 1 | 1 | 0–5 pixels | f of FIRST, at most that of SECOND |
/// | `second_patch_radius` | 3 | 3 | 0–5 pixels | f of SECOND |
/// | `feature_k` | 0.6 | 0.6 | > 0 | k_f of all candidates |
/// | `feature_tau` | 10⁻² | 10⁻² | > 0 | τ of FIRST and SECOND, in squares of the unit range |
/// | `feature_tau_third` | 5·10⁻⁴ | 10⁻³ | > 0 | τ of THIRD |
/// | `weighting.symmetric` | blended | off | not hard | pairs of opposite neighbours (eq. 7.6) for colour and features; feature distances scaled by both pixels |
/// | `weighting.centre` | largest neighbour | one | | weight of a pixel in its own average |
/// | `box_weight` | deviation | even | | how pixels count where sample variances are scaled by the halves |
/// | `covariance` | 1.5 | 1 | > 0 | how often the derivative's term of SURE counts |
/// | `guard` | 4, 0.3; 8, 4 | none | ≥ 0 | keeps candidates out of the blend that are clearly worse, by the smoothed errors and by the pixel's own |
/// | `spikes` | spread | keep | | what becomes of pixels that stand out and rest on few samples |
/// | `second_pass` | ⌈R/2⌉, f 3, clamped, 4σ | R, f 1 | | filters what noise pass 1 left; needs halves |
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct DfcParams {
    /// R, in pixels.
    pub window_radius: u32,
    /// Which candidates take part: the others have no share in the result, and are not computed.
    pub candidates: CandidateSet,
    /// k_c of FIRST and SECOND.
    pub color_k: f32,
    /// f of FIRST, in pixels.
    pub first_patch_radius: u32,
    /// f of SECOND, in pixels.
    pub second_patch_radius: u32,
    /// k_f.
    pub feature_k: f32,
    /// τ of FIRST and SECOND.
    pub feature_tau: f32,
    /// τ of THIRD. Where distances are symmetric they are scaled by p and q together, so that half of the printed value means the same.
    pub feature_tau_third: f32,
    /// How distances become weights, in every filter.
    pub weighting: Weighting,
    /// How the pixels of a box count where the sample variances in it are scaled by the halves.
    pub box_weight: BoxWeight,
    /// How often the last term of SURE counts, 2σ²·dF/du (eq. 8.5). It stands for the covariance of noise and filtered value, and reads low: a pixel that came out low claims
    /// little variance, so that the filter follows it. Measured on nine scenes at 8 and 32 samples per pixel, pass 1 has 2 % less error with 1.5 than with 1 on average (6 % on
    /// `cornell` and on the spiky one, none more than 1 % more); with 2 some lose 5 %.
    pub covariance: f32,
    /// `None`: the smoothed selection maps decide alone.
    pub guard: Option<Guard>,
    /// What becomes of spikes.
    pub spikes: Spikes,
    /// `None`: pass 1 is the result.
    pub second_pass: Option<SecondPass>,
}

/// The filter of the residual noise (Algorithm 1 lines 34 to 37).
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SecondPass {
    /// Window of radius ⌈R/2⌉ in place of R: less blur where pass 1 has kept texture.
    pub half_window: bool,
    /// f, in pixels.
    pub patch_radius: u32,
    /// k_c.
    pub color_k: f32,
    /// Hold the two-buffer variance of pass 1 below the input's variance: what was filtered cannot be noisier than what it was made from.
    pub clamp_to_input: bool,
    /// Pixels that it would change by more than this many standard deviations of their noise stay as pass 1 left them; `None`: all take it.
    pub most_sigmas: Option<f32>,
}

impl SecondPass {
    pub(super) fn window_radius(&self, window_radius: u32) -> u32 {
        if self.half_window { window_radius.div_ceil(2) } else { window_radius }
    }
}

impl Default for DfcParams {
    fn default() -> Self {
        Self {
            feature_tau_third: 5e-4,
            weighting: Weighting { symmetric: Symmetry::Blended, centre: CentreWeight::LargestNeighbour },
            box_weight: BoxWeight::Deviation,
            covariance: 1.5,
            guard: Some(Guard { smoothed_error: 4.0, smoothed_noise: 0.3, own_sigmas: 8.0, own_noise: 4.0 }),
            spikes: Spikes::Spread,
            second_pass: Some(SecondPass { half_window: true, patch_radius: 3, color_k: 0.45, clamp_to_input: true, most_sigmas: Some(4.0) }),
            ..Self::thesis()
        }
    }
}

impl DfcParams {
    /// Algorithm 1 to the letter, its misprint in line 26 mended. It prints τ as 10E−3 and 10E−4.
    pub fn thesis() -> Self {
        Self {
            window_radius: 10,
            candidates: CandidateSet::ALL,
            color_k: 0.45,
            first_patch_radius: 1,
            second_patch_radius: 3,
            feature_k: 0.6,
            feature_tau: 1e-2,
            feature_tau_third: 1e-3,
            weighting: Weighting { symmetric: Symmetry::Off, centre: CentreWeight::One },
            box_weight: BoxWeight::Even,
            covariance: 1.0,
            guard: None,
            spikes: Spikes::Keep,
            second_pass: Some(SecondPass { half_window: false, patch_radius: 1, color_k: 0.45, clamp_to_input: false, most_sigmas: None }),
        }
    }

    /// Whether more than one candidate can have a share: with the patches of SECOND, FIRST has the derivative of SECOND, below which its own must be.
    pub(super) fn several_can_win(&self) -> bool {
        self.candidates.count() > 1 + usize::from(self.first_cannot_win())
    }

    pub(super) fn first_cannot_win(&self) -> bool {
        self.candidates.first && self.candidates.second && self.first_patch_radius == self.second_patch_radius
    }

    /// Checks the ranges of the table above.
    ///
    /// # Errors
    /// [`Error::Request`] naming the parameter and its range.
    pub fn validate(&self) -> Result<()> {
        if !(1..=LARGEST_WINDOW_RADIUS).contains(&self.window_radius) {
            return refused("the window radius", self.window_radius, &format!("from 1 to {LARGEST_WINDOW_RADIUS} pixels"));
        }
        if self.candidates.count() == 0 {
            return Err(Error::Request { problem: "no candidate takes part".into(), remedy: "choose at least one of FIRST, SECOND and THIRD".into() });
        }
        let second_pass = self.second_pass.map_or(0, |pass| pass.patch_radius);
        for (name, radius) in [("the patch radius of SECOND", self.second_patch_radius), ("the patch radius of the second pass", second_pass)] {
            if radius > LARGEST_PATCH_RADIUS {
                return refused(name, radius, &format!("from 0 to {LARGEST_PATCH_RADIUS} pixels"));
            }
        }
        if self.first_patch_radius > self.second_patch_radius {
            return refused("the patch radius of FIRST", self.first_patch_radius, "no larger than that of SECOND");
        }
        if self.weighting.symmetric == Symmetry::Hard {
            return Err(Error::Request {
                problem: "the weights of opposite neighbours are replaced at once, so that SURE cannot differentiate them".into(),
                remedy: "choose `Symmetry::Blended`, or NLM as the method".into(),
            });
        }
        let positive = [
            ("k_c", self.color_k),
            ("k_f", self.feature_k),
            ("τ", self.feature_tau),
            ("τ of THIRD", self.feature_tau_third),
            ("the weight of SURE's covariance", self.covariance),
            ("k_c of the second pass", self.second_pass.map_or(1.0, |pass| pass.color_k)),
            ("the second pass's limit", self.second_pass.and_then(|pass| pass.most_sigmas).unwrap_or(1.0)),
        ];
        for (name, value) in positive {
            if !(value.is_finite() && value > 0.0) {
                return refused(name, value, "finite and above 0");
            }
        }
        if let Some(guard) = self.guard {
            let Guard { smoothed_error, smoothed_noise, own_sigmas, own_noise } = guard;
            for (name, value) in [("smoothed error", smoothed_error), ("smoothed noise", smoothed_noise), ("own sigmas", own_sigmas), ("own noise", own_noise)]
            {
                if !(value.is_finite() && value >= 0.0) {
                    return refused(&format!("the guard's {name}"), value, "finite and at least 0");
                }
            }
        }
        Ok(())
    }
}
