//! How names are stored, and the meaning of layers' names. Nothing here looks at pixels.

use exr::prelude::Text;

use crate::layer_ref::SignalPart;
use stein::text;

/// The longest name of a channel, an attribute or a type, in bytes. Readers refuse longer ones.
pub(crate) const LONGEST_NAME: usize = 255;

/// Decodes a stored name. The format stores bytes: they are UTF-8 if they are valid UTF-8, else Latin-1, in which every
/// byte is valid.
pub(crate) fn decoded(stored: &[u8]) -> String {
    str::from_utf8(stored).map_or_else(|_| stored.iter().copied().map(char::from).collect(), str::to_owned)
}

/// Encodes a new name in UTF-8, or returns the reason why it cannot be stored.
pub(crate) fn encoded(name: &str) -> Result<Text, String> {
    if name.is_empty() {
        return Err("a name is empty".into());
    }
    if name.contains('\0') {
        return Err(format!("the name '{}' holds a zero, which ends a name in OpenEXR", text::name(name)));
    }
    if name.len() > LONGEST_NAME {
        let start = text::beginning(name, name.len());
        return Err(format!("the name {start} is longer than the {LONGEST_NAME} bytes that OpenEXR stores"));
    }
    Ok(Text::from_slice_unchecked(name.as_bytes()))
}

/// Names of layers that are a picture's colour wherever they occur, the best one first; compared without case, by their
/// last dotted component. `noisy image` comes before `combined`: Cycles stores the denoised picture in the latter when
/// it has denoised already.
const COLOR_NAMES: &[&str] = &[
    "",
    "noisy image",
    "combined",
    "rgba",
    "rgb",
    "beauty",
    "color",
    "colour",
    "c",
    "ci",
    "main",
    "image",
    "composite",
];

/// Names of layers that are features even without halves and variance.
const FEATURE_NAMES: &[&str] = &[
    "albedo",
    "alb",
    "denoise_albedo",
    "denoising albedo",
    "normal",
    "normals",
    "nrm",
    "n",
    "sh_normal",
    "denoising normal",
    "depth",
    "z",
    "zfiltered",
    "denoising depth",
    "visibility",
    "vis",
    "caustic",
    "caustics",
    "cau",
    "position",
    "pos",
    "p",
];

const SAMPLE_COUNT_NAMES: &[&str] = &["samples", "samplecount"];

/// Returns the part of a layer's name after its last dot.
pub(crate) fn last_component(name: &str) -> &str {
    name.rsplit_once('.').map_or(name, |(_, last)| last)
}

/// Returns everything up to the last dot, with the dot: layers of one render share it.
pub(crate) fn group(name: &str) -> &str {
    name.rfind('.').map_or("", |dot| &name[..=dot])
}

/// Returns the rank of a layer as the colour: a smaller rank is better; `None` if the name does not suggest the colour.
pub(crate) fn color_rank(name: &str) -> Option<usize> {
    COLOR_NAMES.iter().position(|known| last_component(name).eq_ignore_ascii_case(known))
}

pub(crate) fn is_feature_name(name: &str) -> bool {
    FEATURE_NAMES.iter().any(|known| last_component(name).eq_ignore_ascii_case(known))
}

pub(crate) fn is_sample_count_name(name: &str) -> bool {
    SAMPLE_COUNT_NAMES.iter().any(|known| last_component(name).eq_ignore_ascii_case(known))
}

/// Whether `candidate` is a name under which the half or variance of the layer `base` is looked for.
///
/// A bare `variance` must be spelt in lower case: pbrt's `Variance` is the variance of one sample.
pub(crate) fn is_companion(candidate: &str, base: &str, part: SignalPart, bare_too: bool) -> bool {
    let suffixes: &[&str] = match part {
        SignalPart::Mean => return false,
        SignalPart::HalfA => &["halfA"],
        SignalPart::HalfB => &["halfB"],
        SignalPart::Variance => &["variance", "var", "mse"],
    };
    suffixes.iter().any(|suffix| {
        let joined = !base.is_empty() && candidate.eq_ignore_ascii_case(&format!("{base}_{suffix}"));
        let bare_name = candidate.strip_prefix(group(base));
        let bare = bare_too
            && bare_name.is_some_and(|name| {
                if part == SignalPart::Variance { name == *suffix } else { name.eq_ignore_ascii_case(suffix) }
            });
        joined || bare
    })
}

/// Returns the layer that a name such as `albedo_halfA` belongs to, and which part of it the name means.
pub(crate) fn companion_base(name: &str) -> Option<(&str, SignalPart)> {
    let (base, suffix) = name.rsplit_once('_')?;
    let part = match suffix.to_ascii_lowercase().as_str() {
        "halfa" => SignalPart::HalfA,
        "halfb" => SignalPart::HalfB,
        "variance" | "var" | "mse" => SignalPart::Variance,
        _ => return None,
    };
    Some((base, part))
}

/// Whether a layer is a half of the file's colour, whichever layer that is.
pub(crate) fn is_bare_half(name: &str) -> bool {
    ["halfA", "halfB"].iter().any(|half| last_component(name).eq_ignore_ascii_case(half))
}

/// Returns the reason why a layer whose name mentions noise is not taken for a variance of the mean; `None` for all
/// others.
pub(crate) fn why_not_a_variance(name: &str) -> Option<&'static str> {
    let last = last_component(name);
    let is = |known: &str| last.eq_ignore_ascii_case(known);
    if name.starts_with("m2_") {
        Some("a raw second moment E[x²], not a variance: it would have to become (m2 − mean²)/(n − 1)")
    } else if is("noiseLevel") || is("noise") {
        Some("a renderer's noise heuristic, not a variance")
    } else if is("RelativeVariance") {
        Some("variance divided by the mean, not the variance of the mean")
    } else if last == "Variance" {
        Some("taken for pbrt's variance of one sample: divide it by the samples per pixel and give it as the variance")
    } else if is("Debug Sample Count") {
        Some("a fraction of the header's sample count, not a count")
    } else {
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_bytes() {
        for (stored, name) in
            [(&b"plain.R"[..], "plain.R"), ("Größe".as_bytes(), "Größe"), (b"Gr\xf6\xdfe", "Größe"), (b"\xff", "ÿ")]
        {
            assert_eq!(decoded(stored), name);
        }
        assert_eq!(encoded("Größe").map(|stored| stored.as_slice().to_vec()), Ok("Größe".as_bytes().to_vec()));
        assert!(encoded(&"x".repeat(255)).is_ok());
        for (name, why) in
            [("", "empty"), ("a\0b", "a zero"), (&"ö".repeat(128), "(256 bytes) is longer than the 255 bytes")]
        {
            assert!(encoded(name).is_err_and(|problem| problem.contains(why)), "{name}");
        }
    }

    #[test]
    fn companions_are_found_beside_their_layer_only() {
        assert!(is_companion("albedo_halfA", "albedo", SignalPart::HalfA, false));
        assert!(is_companion("v1.albedo_variance", "v1.albedo", SignalPart::Variance, false));
        assert!(!is_companion("v2.albedo_variance", "v1.albedo", SignalPart::Variance, false));
        assert!(!is_companion("halfA", "diffuse", SignalPart::HalfA, false));
        assert!(is_companion("halfA", "beauty", SignalPart::HalfA, true));
        assert!(is_companion("ViewLayer.halfb", "ViewLayer.Combined", SignalPart::HalfB, true));
    }

    #[test]
    fn the_variance_of_one_sample_and_moments_are_not_the_variance_of_the_mean() {
        assert!(is_companion("variance", "", SignalPart::Variance, true));
        assert!(!is_companion("Variance", "", SignalPart::Variance, true));
        for name in ["Variance", "m2_nested.image", "noiseLevel", "RelativeVariance"] {
            assert!(why_not_a_variance(name).is_some(), "{name}");
        }
        assert!(why_not_a_variance("variance").is_none());
    }
}
