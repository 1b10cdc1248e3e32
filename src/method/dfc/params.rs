//! Parameters of DFC: the table of Algorithm 1, with what measurements made of it.

use serde::Serialize;

use super::candidate_set::CandidateSet;
use crate::error::{Error, RequestCause, Result};
use crate::method::Spikes;
use crate::method::common::{LARGEST_PATCH_RADIUS, LARGEST_WINDOW_RADIUS};
use crate::parameters::{Group, Parameter, Values, Without, above, check, list, parameters, pixels};
use crate::stage::candidate_filter::{ByColor, ByFeatures, CandidateFilter, MOST_CANDIDATES};
use crate::stage::nlm::{CentreWeight, Symmetry, Weighting};
use crate::stage::select::Guard;
use crate::stage::variance::BoxWeight;

parameters! {
    /// Parameters of DFC (thesis chapter 8), in [a table](crate::parameters#dfc). [`DfcParams::default`] measured best,
    /// [`DfcParams::thesis`] is Algorithm 1 to the letter.
    #[derive(Clone, Copy, Debug, PartialEq, Serialize)]
    pub struct DfcParams {
        /// R, the radius of the window: candidates average over (2R+1)² pixels. Work grows with its square.
        pub window_radius: u32 => pixels(1..=LARGEST_WINDOW_RADIUS),
        /// Which candidates take part: the others have no share in the result, and are not computed. FIRST has to
        /// filter more than SECOND where both do.
        pub candidates: CandidateSet,
        /// Candidates that take part besides these, after them in their order: at most five. Programs and presets set
        /// them, parameter files do not.
        #[serde(skip_serializing_if = "<[_]>::is_empty")]
        pub further: &'static [CandidateFilter],
        /// k_c of FIRST and SECOND: how large a difference of colour counts, in standard deviations. More filters more.
        pub color_k: f32 => above(0.0).of("σ"),
        /// f of FIRST, the radius of its patches, at most the radius of SECOND.
        pub first_patch_radius: u32 => pixels(0..=LARGEST_PATCH_RADIUS),
        /// f of SECOND, the radius of its patches.
        pub second_patch_radius: u32 => pixels(0..=LARGEST_PATCH_RADIUS),
        /// k_f of all candidates: how large a difference of features counts, in standard deviations. More filters more.
        pub feature_k: f32 => above(0.0).of("σ"),
        /// τ of FIRST and SECOND: the least scale of squared differences of features, besides k_f², in squares of the
        /// unit range that features are brought to. More filters more.
        pub feature_tau: f32 => above(0.0),
        /// τ of THIRD, as `feature_tau`.
        ///
        /// Where distances are symmetric they are scaled by p and q together, so that half of the printed value has the
        /// same effect.
        pub feature_tau_third: f32 => above(0.0),
        /// How distances become weights, in every filter.
        pub weighting: Weighting => Some(Without {
            parameter: "symmetric",
            choice: "hard",
            because: "the weights of opposite neighbours would be replaced at once, so that SURE could not \
                      differentiate them.",
        }),
        /// How the pixels of a box are weighted where their variances are scaled to the differences of their halves.
        pub box_weight: BoxWeight,
        /// Factor of the last term of SURE, 2σ²·dF/du (eq. 8.5).
        ///
        /// The term stands for the covariance of noise and filtered value, and is too low: a pixel that came out low
        /// claims little variance, so that the filter follows it. Measured on nine scenes at 8 and 32 samples per
        /// pixel, pass 1 has 2 % less error with 1.5 than with 1 on average (6 % on `cornell` and on the spiky one,
        /// none more than 1 % more); with 2 some lose 5 %.
        pub covariance: f32 => above(0.0),
        /// Keeps candidates out of the blend that are clearly worse, by the smoothed errors and by the pixel's own.
        /// Left out, the smoothed selection maps decide alone.
        pub guard: Option<Guard>,
        /// Whether variances of the mean are pooled over pixels that are alike. A missing variance is then estimated
        /// from the halves, or, without halves, from the image itself; a variance that is given beside halves becomes
        /// steadier. Otherwise the squared half spread is smoothed, and an image alone is refused.
        pub pooled_variance: bool,
        /// What becomes of spikes: pixels that stand out from those of their kind and rest on very few samples.
        pub spikes: Spikes,
        /// Filters what noise pass 1 left (Algorithm 1 lines 34 to 37); needs halves. Left out, pass 1 is the result.
        pub second_pass: Option<SecondPass>,
        /// Whether a filter that compares only the colour takes part where a feature has no noise, or unknown noise,
        /// and where this filter is clearly better. Such features have edges of their own, sharp where motion or
        /// defocus blurs the colour. With a single candidate it takes no part.
        pub color_only: bool,
        /// Whether pixels whose samples show no noise stay as they are, however noisy their neighbours. Black pixels
        /// stay only where everything around them is black: elsewhere their samples may all have missed the light.
        pub keep_clean: bool,
    }
}

parameters! {
    /// The filter of the residual noise (Algorithm 1 lines 34 to 37).
    #[derive(Clone, Copy, Debug, PartialEq, Serialize)]
    pub struct SecondPass {
        /// Whether the window's radius is ⌈R/2⌉ in place of R: less blur where pass 1 has kept texture.
        pub half_window: bool,
        /// f, the radius of the patches.
        pub patch_radius: u32 => pixels(0..=LARGEST_PATCH_RADIUS),
        /// k_c: how large a difference of colour counts, in standard deviations. More filters more.
        pub color_k: f32 => above(0.0).of("σ"),
        /// Whether the two-buffer variance of pass 1 is held below the input's variance: what was filtered cannot be
        /// noisier than what it was made from.
        pub clamp_to_input: bool,
        /// Largest correction of a pixel, in standard deviations of its noise: pixels that would change by more stay as
        /// pass 1 left them. Left out, there is no limit.
        pub most_sigmas: Option<f32> => above(0.0).of("σ"),
    }
}

impl Default for SecondPass {
    fn default() -> Self {
        Self { half_window: true, patch_radius: 3, color_k: 0.45, clamp_to_input: true, most_sigmas: Some(4.0) }
    }
}

impl Group for SecondPass {}

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
            guard: Some(Guard::default()),
            spikes: Spikes::Spread,
            second_pass: Some(SecondPass::default()),
            color_only: true,
            keep_clean: true,
            pooled_variance: true,
            ..Self::thesis()
        }
    }
}

impl DfcParams {
    /// Returns Algorithm 1 to the letter, with the misprint in line 26 corrected. It prints τ as 10E−3 and 10E−4.
    pub fn thesis() -> Self {
        Self {
            window_radius: 10,
            candidates: CandidateSet::ALL,
            further: &[],
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
            second_pass: Some(SecondPass {
                half_window: false,
                patch_radius: 1,
                color_k: 0.45,
                clamp_to_input: false,
                most_sigmas: None,
            }),
            color_only: false,
            keep_clean: false,
            pooled_variance: false,
        }
    }

    /// Returns the candidates in their order, and whether each takes part: of equal errors, the later one wins.
    pub fn filters(&self) -> Vec<(CandidateFilter, bool)> {
        let [first, second, third] = CandidateSet::NAMES;
        let by_color = |patch_radius| Some(ByColor { k: self.color_k, patch_radius });
        let by_features = |tau| Some(ByFeatures { k: self.feature_k, tau });
        let of_thesis = [
            CandidateFilter {
                name: first,
                color: by_color(self.first_patch_radius),
                features: by_features(self.feature_tau),
                rival: Some(second),
            },
            self.second(),
            CandidateFilter { name: third, color: None, features: by_features(self.feature_tau_third), rival: None },
        ];
        let further = self.further.iter().map(|filter| (*filter, true));
        of_thesis.into_iter().zip(self.candidates.flags()).chain(further).collect()
    }

    /// SECOND.
    pub(super) fn second(&self) -> CandidateFilter {
        let [_, name, _] = CandidateSet::NAMES;
        CandidateFilter {
            name,
            color: Some(ByColor { k: self.color_k, patch_radius: self.second_patch_radius }),
            features: Some(ByFeatures { k: self.feature_k, tau: self.feature_tau }),
            rival: None,
        }
    }

    /// Returns f of the largest patches, in pixels.
    pub(super) fn largest_patch_radius(&self) -> u32 {
        self.filters().iter().filter_map(|(filter, _)| filter.color).map(|color| color.patch_radius).max().unwrap_or(0)
    }

    /// Returns whether more than one candidate can have a share. If FIRST has the patches of SECOND, it cannot win: its
    /// derivative would have to be below the derivative of SECOND, which is the same.
    pub(super) fn several_can_win(&self) -> bool {
        let taking_part = self.filters().iter().filter(|(_, takes_part)| *takes_part).count();
        taking_part > 1 + usize::from(self.first_cannot_win())
    }

    pub(super) fn first_cannot_win(&self) -> bool {
        self.candidates.first && self.candidates.second && self.first_patch_radius == self.second_patch_radius
    }

    /// Returns the parameters, with their documentation and ranges.
    pub fn parameters(&self) -> Vec<Parameter> {
        list(Values { value: Some(*self), default: Some(Self::default()), thesis: Some(Self::thesis()) })
    }

    /// Checks the ranges, and that the patches of FIRST are no larger than those of SECOND.
    ///
    /// # Errors
    /// [`Error::Request`] naming the parameter and its range.
    pub fn validate(&self) -> Result<()> {
        check(&self.parameters())?;
        let Self { first_patch_radius: first, second_patch_radius: second, .. } = self;
        if first > second {
            return Err(Error::Request(RequestCause::PatchRadii { first: *first, second: *second }));
        }
        let filters = self.filters();
        if filters.len() > MOST_CANDIDATES {
            return Err(Error::Request(RequestCause::TooManyCandidates { count: filters.len() }));
        }
        for (place, (filter, _)) in filters.iter().enumerate() {
            let numbers = [
                filter.color.map(|color| color.k),
                filter.features.map(|features| features.k),
                filter.features.map(|features| features.tau),
            ];
            let in_range = numbers.into_iter().flatten().all(|number| number > 0.0 && number.is_finite())
                && filter.color.is_none_or(|color| color.patch_radius <= LARGEST_PATCH_RADIUS);
            if !in_range || filters[..place].iter().any(|(other, _)| other.name == filter.name) {
                return Err(Error::Request(RequestCause::Candidate { name: filter.name }));
            }
        }
        Ok(())
    }
}
