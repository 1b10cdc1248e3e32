//! Candidate filters as data, and their distribution over passes over the window.

use glam::Vec4;
use serde::Serialize;

use super::feature::{Features, MAX_GROUPS};
use crate::gpu::{Definition, uniforms};

uniforms! {
    pub(super) struct CandidateParams {
        inverse_feature_k_squared: f32,
        feature_tau: f32,
        feature_tau_alone: f32,
        triple_weights: [Vec4; MAX_GROUPS],
    }
}

/// The largest number of candidates.
pub const MOST_CANDIDATES: usize = 8;

/// One candidate: a filter whose weight is the smaller of the weight by the colour and the weight by the features (eq.
/// 8.4). A filter that compares neither is a mean over the window.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct CandidateFilter {
    /// Name of the filter, different from the names of all other candidates.
    pub name: &'static str,
    /// Comparison of the colour (eq. 8.2); `None` for a filter that does not compare it.
    pub color: Option<ByColor>,
    /// Comparison of the features (eq. 8.3); `None` for a filter that does not compare them.
    pub features: Option<ByFeatures>,
    /// Name of the filter's rival. The filter may win a pixel only where it filters more than the rival, that is, where
    /// its mean derivative is less. Without effect where the rival takes no part.
    pub rival: Option<&'static str>,
}

/// Comparison of patches of the colour.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ByColor {
    /// k_c: how large a difference counts, in standard deviations.
    pub k: f32,
    /// f: patches are 2f+1 pixels wide.
    pub patch_radius: u32,
}

/// Comparison of features.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ByFeatures {
    /// k_f: how large a difference counts, in standard deviations.
    pub k: f32,
    /// τ: the least scale of a squared difference, in squares of the unit range.
    pub tau: f32,
}

/// Returns the index of each filter's rival among these filters; `None` without a rival that takes part.
pub(super) fn rivals(filters: &[CandidateFilter]) -> Vec<Option<usize>> {
    let place = |name: &str| filters.iter().position(|filter| filter.name == name);
    filters.iter().map(|filter| place(filter.rival?)).collect()
}

/// Filters that one pass over the window computes, each by its index among the candidates. The pass computes their
/// common parts once. The three candidates of Algorithm 1 fit into one pass.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Pass {
    /// A filter with smaller patches than `large`, and equal in all else.
    pub(super) small: Option<usize>,
    /// A filter with patches of the colour.
    pub(super) large: Option<usize>,
    /// A filter without patches.
    pub(super) alone: Option<usize>,
    color: Option<ByColor>,
    small_patch_radius: u32,
    /// Comparison of the features in `small` and `large`.
    beside_color: Option<ByFeatures>,
    /// Comparison of the features in `alone`.
    by_features: Option<ByFeatures>,
}

/// Distributes filters over passes.
pub(super) fn passes(filters: &[CandidateFilter]) -> Vec<Pass> {
    let mut passes: Vec<Pass> = Vec::new();
    for (place, filter) in filters.iter().enumerate() {
        let joined = passes.iter_mut().find_map(|pass| pass.with(place, filter).map(|joined| *pass = joined));
        if joined.is_none() {
            passes.extend(Pass::default().with(place, filter));
        }
    }
    passes
}

impl Pass {
    /// Returns the pass with one more filter, if the filter can share the pass.
    fn with(&self, place: usize, filter: &CandidateFilter) -> Option<Self> {
        let CandidateFilter { color, features, .. } = *filter;
        let Some(own) = color else {
            let shares = self.large.is_none() || shared(self.beside_color, features);
            return (self.alone.is_none() && shares).then_some(Self {
                alone: Some(place),
                by_features: features,
                ..*self
            });
        };
        if self.alone.is_some() && !shared(features, self.by_features) {
            return None;
        }
        match (self.large, self.color) {
            (None, _) => Some(Self { large: Some(place), color, beside_color: features, ..*self }),
            (Some(large), Some(other)) if self.small.is_none() && other.k == own.k && self.beside_color == features => {
                // With patches of equal size, the earlier filter counts as the one with small patches.
                Some(if own.patch_radius < other.patch_radius {
                    Self { small: Some(place), small_patch_radius: own.patch_radius, ..*self }
                } else {
                    Self {
                        small: Some(large),
                        small_patch_radius: other.patch_radius,
                        large: Some(place),
                        color,
                        ..*self
                    }
                })
            }
            _ => None,
        }
    }

    /// Returns whether the pass compares the colour.
    pub(super) fn by_color(&self) -> bool {
        self.large.is_some()
    }

    /// Returns whether the pass compares features, if there are any.
    pub(super) fn by_features(&self) -> bool {
        self.beside_color.is_some() || self.by_features.is_some()
    }

    /// Returns k_c; 1 for a pass that does not compare the colour.
    pub(super) fn color_k(&self) -> f32 {
        self.color.map_or(1.0, |color| color.k)
    }

    /// Returns f of the large patches; 0 for a pass that does not compare the colour.
    pub(super) fn patch_radius(&self) -> u32 {
        self.color.map_or(0, |color| color.patch_radius)
    }

    /// Returns f of the small patches, if there are any.
    pub(super) fn small_patch_radius(&self) -> Option<u32> {
        self.small.map(|_| self.small_patch_radius)
    }

    /// Returns the number of values of four numbers that hold the weights of a pair of neighbours: one for the filters
    /// by colour, one for the filter by features alone.
    pub(super) fn weight_values(&self) -> u32 {
        u32::from(self.by_color()) + u32::from(self.alone.is_some())
    }

    /// Returns the definitions of the filters that take part.
    pub(super) fn definitions(&self) -> [(&'static str, Definition); 6] {
        [
            ("PATCH_RADIUS", Definition::Int(self.patch_radius() as i32)),
            ("SMALL_PATCH_RADIUS", Definition::Int(self.small_patch_radius as i32)),
            ("COLOR", self.by_color().into()),
            ("SMALL", self.small.is_some().into()),
            ("LARGE", self.large.is_some().into()),
            ("FEATURES_ALONE", self.alone.is_some().into()),
        ]
    }

    /// Returns the parameters of the comparison of features.
    pub(super) fn params(&self, features: Option<&Features>) -> CandidateParams {
        let tau = |of: Option<ByFeatures>| of.or(self.beside_color).or(self.by_features).map_or(1.0, |of| of.tau);
        let k = self.beside_color.or(self.by_features).map_or(1.0, |features| features.k);
        CandidateParams {
            inverse_feature_k_squared: 1.0 / (k * k),
            feature_tau: tau(self.beside_color),
            feature_tau_alone: tau(self.by_features),
            triple_weights: features.map_or([Vec4::ZERO; MAX_GROUPS], |features| features.packing.triple_weights()),
        }
    }
}

/// Returns whether filters with these comparisons of features can share numerators: both or none compare, with equal
/// k_f.
fn shared(a: Option<ByFeatures>, b: Option<ByFeatures>) -> bool {
    a.map(|a| a.k) == b.map(|b| b.k)
}

#[cfg(test)]
mod tests {
    use super::*;

    const FEATURES: Option<ByFeatures> = Some(ByFeatures { k: 0.6, tau: 1e-2 });
    const PLAIN: CandidateFilter = CandidateFilter { name: "", color: None, features: FEATURES, rival: None };

    fn by_color(patch_radius: u32) -> CandidateFilter {
        CandidateFilter { color: Some(ByColor { k: 0.45, patch_radius }), ..PLAIN }
    }

    fn places(filters: &[CandidateFilter]) -> Vec<[Option<usize>; 3]> {
        passes(filters).iter().map(|pass| [pass.small, pass.large, pass.alone]).collect()
    }

    #[test]
    fn the_three_of_the_thesis_are_one_pass() {
        let third = CandidateFilter { features: Some(ByFeatures { k: 0.6, tau: 1e-3 }), ..PLAIN };
        assert_eq!(places(&[by_color(1), by_color(3), third]), [[Some(0), Some(1), Some(2)]]);
        assert_eq!(places(&[third, by_color(3), by_color(1)]), [[Some(2), Some(1), Some(0)]]);
        assert_eq!(places(&[by_color(2), by_color(2)]), [[Some(0), Some(1), None]]);
        assert_eq!(places(&[by_color(1)]), [[None, Some(0), None]]);
        let [pass] = passes(&[by_color(1), by_color(3), third])[..] else { panic!("one pass") };
        assert_eq!((pass.patch_radius(), pass.small_patch_radius()), (3, Some(1)));
        assert_eq!((pass.params(None).feature_tau, pass.params(None).feature_tau_alone), (1e-2, 1e-3));
    }

    #[test]
    fn what_cannot_be_shared_is_another_pass() {
        let other_k = CandidateFilter { color: Some(ByColor { k: 1.0, patch_radius: 2 }), ..PLAIN };
        let colour_only = CandidateFilter { features: None, ..by_color(3) };
        let other_features = CandidateFilter { features: Some(ByFeatures { k: 1.0, tau: 1e-2 }), ..PLAIN };
        assert_eq!(
            places(&[by_color(1), by_color(3), PLAIN, other_k, colour_only, other_features, by_color(2)]),
            [
                [Some(0), Some(1), Some(2)],
                [None, Some(3), None],
                [None, Some(4), None],
                [None, None, Some(5)],
                [None, Some(6), None]
            ]
        );
    }

    #[test]
    fn a_rival_that_takes_no_part_is_none() {
        let first = CandidateFilter { name: "first", rival: Some("second"), ..by_color(1) };
        let second = CandidateFilter { name: "second", ..by_color(3) };
        assert_eq!(rivals(&[first, second]), [Some(1), None]);
        assert_eq!(rivals(&[second, first]), [None, Some(0)]);
        assert_eq!(rivals(&[first]), [None]);
    }
}
