//! The operator at one pixel: the weight of each existing neighbour, and the distances behind it.

use super::Point;
use super::nlm::{
    self, Feature, FilterParams, Guide, Pair, color_weights, feature_distance, feature_weights, window_weights,
};
use super::nlm_method::{self, Filter, pair_weights, windows};

pub struct Neighbour {
    pub at: Point,
    /// The weight in the average.
    pub weight: f64,
    /// Distances by the colour first, then by each feature.
    pub distances: Vec<Distance>,
}

/// A distance, and the weight that it would give alone.
pub struct Distance {
    pub distance: f64,
    pub weight: f64,
}

/// Distances of a candidate: by the colour, if it compares the colour, then by each feature.
pub fn candidate_window(guide: Guide, features: &[Feature], params: &FilterParams, p: Point) -> Vec<Neighbour> {
    let like = &guide.mean[0];
    let neighbour = |(q, weight): (Point, f64)| {
        let pair = Pair::new(like, p, q - p);
        let color = params.k_color.is_finite().then(|| Distance {
            distance: nlm::patch_distance((guide, guide), params.k_color, params.patch_radius, p, q),
            weight: color_weights((guide, guide), &pair, params)[0],
        });
        let of_feature = |feature: &Feature| Distance {
            distance: feature_distance((feature, feature), params, p, q),
            weight: feature_weights([std::slice::from_ref(feature); 2], &pair, params)[0],
        };
        Neighbour { at: q, weight, distances: color.into_iter().chain(features.iter().map(of_feature)).collect() }
    };
    window_weights(like, p, Some(guide), features, params).neighbours.into_iter().map(neighbour).collect()
}

/// Distances of the filter of chapter 7.
pub fn nlm_window(guide: Guide, filter: &Filter, p: Point) -> Vec<Neighbour> {
    let window = windows(guide, filter).swap_remove(guide.mean[0].index(p));
    let neighbour = |(q, weight): (Point, f64)| {
        let alone = Distance {
            distance: nlm_method::patch_distance(guide, p, &[q], filter),
            weight: pair_weights(guide, p, q - p, filter)[0],
        };
        Neighbour { at: q, weight, distances: vec![alone] }
    };
    window.neighbours.into_iter().map(neighbour).collect()
}
