//! Quantities that features measure.

use serde::Serialize;

/// Quantity that a feature measures. It decides how the values are repaired and scaled, and what they may explain.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
pub enum FeatureKind {
    /// A reflectance: no surface has more than 1.
    Albedo,
    /// A direction of length 1.
    Normal,
    /// A distance or position: infinity or a huge number means that the ray hit nothing.
    Distance,
    /// Anything else.
    Other,
}

impl FeatureKind {
    /// Returns the kind for the part of a layer's name after its last dot: `ViewLayer.Denoising Albedo` is an albedo.
    pub fn from_name(name: &str) -> Self {
        let last = name.rsplit_once('.').map_or(name, |(_, last)| last).to_ascii_lowercase();
        let contains = |words: &[&str]| words.iter().any(|word| last.contains(word));
        let is = |words: &[&str]| words.contains(&last.as_str());
        if contains(&["albedo"]) || is(&["alb"]) {
            Self::Albedo
        } else if contains(&["normal"]) || is(&["n", "nrm", "ns"]) {
            Self::Normal
        } else if contains(&["depth", "distance", "position"]) || is(&["z", "zfiltered", "pos", "p"]) {
            Self::Distance
        } else {
            Self::Other
        }
    }
}

#[cfg(test)]
mod tests {
    use super::FeatureKind::{self, Albedo, Distance, Normal, Other};

    #[test]
    fn the_last_part_of_a_name_tells_the_kind() {
        for name in
            ["albedo", "Denoising Albedo", "ViewLayer.Denoising Albedo", "denoise_albedo", "diffuse_albedo", "view.ALB"]
        {
            assert_eq!(FeatureKind::from_name(name), Albedo, "{name}");
        }
        for (name, kind) in [
            ("sh_normal", Normal),
            ("albedo.N", Normal),
            ("Z", Distance),
            ("view.Denoising Depth", Distance),
            ("P", Distance),
        ] {
            assert_eq!(FeatureKind::from_name(name), kind, "{name}");
        }
        for name in ["album", "", "Combined", "visibility", "caustic"] {
            assert_eq!(FeatureKind::from_name(name), Other, "{name}");
        }
    }
}
