//! Rules of a layout: which layers mean what.

use serde::{Deserialize, Serialize};

use super::{Pattern, Texts};
use crate::layers::FileLayer;

/// What a layer shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum RoleName {
    /// The picture, which is denoised.
    Color,
    /// Reflectance of the surface.
    Albedo,
    /// Direction of the surface.
    Normal,
    /// Distance of the surface.
    Depth,
    /// Position of the surface.
    Position,
    /// Share of the lights that are seen.
    Visibility,
    /// Light through caustics.
    Caustic,
    /// Any other feature.
    Feature,
    /// Opacity.
    Alpha,
    /// A part of the colour, such as the light of one lamp.
    Light,
    /// Numbers of objects, such as cryptomatte.
    Id,
    /// Number of samples.
    Samples,
    /// A picture that the renderer has denoised.
    Denoised,
    /// Nothing that the denoiser uses.
    Ignore,
    /// A file with further layers of the same render.
    More,
    /// A file with another render of the same frame, with another seed.
    Seed,
}

impl RoleName {
    /// Whether layers of this role guide the filter.
    pub(crate) fn is_feature(self) -> bool {
        self.feature_name().is_some() || self == Self::Feature
    }

    /// Returns the name of the feature; `None` for features that are named like their layer, and for all else.
    pub(crate) fn feature_name(self) -> Option<&'static str> {
        Some(match self {
            Self::Albedo => "albedo",
            Self::Normal => "normal",
            Self::Depth => "depth",
            Self::Position => "position",
            Self::Visibility => "visibility",
            Self::Caustic => "caustic",
            _ => return None,
        })
    }
}

/// The quantity that a layer holds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Quantity {
    /// The mean of all samples.
    #[default]
    #[serde(rename = "mean")]
    Mean,
    /// The mean of the first half of the samples.
    #[serde(rename = "half a")]
    HalfA,
    /// The mean of the other half.
    #[serde(rename = "half b")]
    HalfB,
    /// The variance of the mean, s²/n.
    #[serde(rename = "variance of the mean")]
    VarianceOfMean,
    /// The variance of one sample, s².
    #[serde(rename = "variance of one sample")]
    VarianceOfSample,
    /// The raw second moment `E[x²]`.
    #[serde(rename = "second moment")]
    SecondMoment,
    /// A number of samples.
    #[serde(rename = "count")]
    Count,
    /// A fraction of the number of samples in the header.
    #[serde(rename = "fraction")]
    Fraction,
    /// Something that is easily mistaken for a variance.
    #[serde(rename = "not a variance")]
    NotAVariance,
}

impl Quantity {
    pub(crate) fn is_variance(self) -> bool {
        matches!(self, Self::VarianceOfMean | Self::VarianceOfSample | Self::SecondMoment)
    }
}

impl std::fmt::Display for Quantity {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Mean => "mean",
            Self::HalfA => "half A",
            Self::HalfB => "half B",
            Self::VarianceOfMean => "variance of the mean",
            Self::VarianceOfSample => "variance of one sample",
            Self::SecondMoment => "second moment",
            Self::Count => "count",
            Self::Fraction => "fraction of the count",
            Self::NotAVariance => "not a variance",
        })
    }
}

/// Units that need a remark or a conversion.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Unit {
    /// Directions or positions relative to the camera.
    Camera,
    /// Directions or positions in the scene.
    World,
    /// CIE XYZ in place of red, green, blue. The denoiser treats X, Y and Z as any three channels.
    Xyz,
}

/// A rule as the TOML document spells it.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RuleDocument {
    #[serde(default)]
    name: Texts,
    #[serde(default)]
    file: Texts,
    channels: Option<String>,
    role: Option<RoleName>,
    #[serde(default)]
    quantity: Quantity,
    unit: Option<Unit>,
    miss: Option<f32>,
    unknown: Option<f32>,
    #[serde(default)]
    factor: Texts,
    why: Option<String>,
    #[serde(default)]
    fallback: bool,
    #[serde(default)]
    copy: bool,
    #[serde(default)]
    exact: bool,
}

/// Layers, or files beside the input, and their meaning.
#[derive(Clone, Debug)]
pub(crate) struct Rule {
    /// Patterns of the layers; earlier ones are preferred.
    pub(crate) names: Vec<Pattern>,
    /// Patterns of files beside the input.
    pub(crate) files: Vec<Pattern>,
    /// Channels that the layer must have, in capitals, besides an alpha.
    channels: Option<String>,
    /// `None` for a layer that describes another one: it has the other's role.
    pub(crate) role: Option<RoleName>,
    pub(crate) quantity: Quantity,
    pub(crate) unit: Option<Unit>,
    /// The value of a depth or position where nothing was hit.
    pub(crate) miss: Option<f32>,
    /// The value of a variance that is not known.
    pub(crate) unknown: Option<f32>,
    /// Patterns of the layer by which this light is multiplied; earlier ones are preferred.
    pub(crate) factors: Vec<Pattern>,
    /// The reason why the layer is not used.
    pub(crate) why: Option<String>,
    /// Whether this colour is used only if the file has no other.
    pub(crate) is_fallback: bool,
    /// Whether this colour is the same picture as the colour of the file, so that its noise is the colour's noise.
    pub(crate) is_copy: bool,
}

impl RuleDocument {
    pub(super) fn rule(self) -> Result<Rule, String> {
        let names = self.name.patterns(self.exact)?;
        let files = self.file.patterns(self.exact)?;
        let factors = self.factor.patterns(self.exact)?;
        let Some(first) = names.iter().chain(&files).next().map(|pattern| pattern.text.clone()) else {
            return Err("a layer has neither name nor file".into());
        };
        let describes_another = names.iter().chain(&files).any(|pattern| pattern.has("{of}"));
        if self.role.is_none() && !describes_another {
            return Err(format!("layer '{first}' has no role, and no {{of}} for the layer that it describes"));
        }
        if self.miss.is_some_and(f32::is_nan) || self.unknown.is_some_and(f32::is_nan) {
            return Err(format!("layer '{first}': no value equals nan"));
        }
        if self.quantity == Quantity::NotAVariance && self.why.is_none() {
            return Err(format!("layer '{first}' does not say why it is not a variance"));
        }
        if !factors.is_empty() && self.role != Some(RoleName::Light) {
            return Err(format!("layer '{first}' has a factor, but is no light"));
        }
        if let Some(factor) = factors.iter().find(|factor| factor.has("{of}") || factor.has("{stem}")) {
            return Err(format!("layer '{first}': its factor '{}' has a place other than {{group}}", factor.text));
        }
        Ok(Rule {
            names,
            files,
            channels: self.channels.map(|channels| channels.to_uppercase()),
            role: self.role,
            quantity: self.quantity,
            unit: self.unit,
            miss: self.miss,
            unknown: self.unknown,
            factors,
            why: self.why,
            is_fallback: self.fallback,
            is_copy: self.copy,
        })
    }
}

impl Rule {
    /// Returns the rule for layers that a file's header lists as numbers of objects. It fits no name.
    pub(crate) fn of_ids() -> Self {
        Self {
            names: Vec::new(),
            files: Vec::new(),
            channels: None,
            role: Some(RoleName::Id),
            quantity: Quantity::Mean,
            unit: None,
            miss: None,
            unknown: None,
            factors: Vec::new(),
            why: None,
            is_fallback: false,
            is_copy: false,
        }
    }

    /// Whether the layer has the channels that the rule asks for.
    pub(crate) fn fits_channels(&self, layer: &FileLayer) -> bool {
        let Some(wanted) = &self.channels else { return true };
        let letters: Vec<String> = wanted.chars().map(String::from).collect();
        let has_alpha = usize::from(letters.iter().all(|letter| letter != "A") && layer.channel("A").is_some());
        letters.iter().all(|letter| layer.channel(letter).is_some())
            && layer.channels.len() == letters.len() + if letters.len() > 1 { has_alpha } else { 0 }
    }
}
