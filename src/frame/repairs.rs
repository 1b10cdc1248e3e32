//! Changes that were made to build a frame, for people and programs.

use std::fmt;

use serde::Serialize;

/// Damage and changes in one signal: its mean, halves and variance.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct LayerRepairs {
    /// `colour` or the feature's name.
    pub layer: String,
    /// Values that are not a number, over all channels of mean, halves and variance.
    pub nan_values: usize,
    /// Values that are infinite.
    pub infinite_values: usize,
    /// Finite values beyond ±10¹⁸, whose squares overflow, and variances beyond 10³⁶.
    pub oversized_values: usize,
    /// Where the damaged values are: one entry for each channel of each image that has any.
    pub damage: Vec<Damage>,
    /// Pixels of which at least one channel's mean and halves (and variance) were replaced by their neighbours'
    /// average. Sound channels stay.
    pub pixels_replaced: usize,
    /// Pixels of which at least one channel's variance was replaced, and no mean.
    pub variances_replaced: usize,
    /// Variance values below zero, set to 0.
    pub negative_variances: usize,
    /// Pixels that hit nothing, set to the far end of the feature's range. Not damage.
    pub misses: usize,
}

/// The damaged values of one channel of one image.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Damage {
    /// The image.
    pub image: DamagedImage,
    /// `R`, `G` or `B` of the colour; of a feature its number from 1, as in `channel 2`.
    pub channel: String,
    /// Values that are not a number, infinite, or beyond the limits of [`LayerRepairs::oversized_values`].
    pub values: usize,
}

/// An image of a signal.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum DamagedImage {
    /// The mean of all samples.
    Mean,
    /// The difference of both halves, which either may have spoilt.
    Halves,
    /// The variance of the mean.
    Variance,
    /// The samples per pixel.
    Counts,
}

impl fmt::Display for DamagedImage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Mean => "mean",
            Self::Halves => "halves",
            Self::Variance => "variance",
            Self::Counts => "counts",
        })
    }
}

impl LayerRepairs {
    /// Returns whether nothing was found.
    pub fn is_empty(&self) -> bool {
        *self == Self { layer: self.layer.clone(), ..Self::default() }
    }
}

impl fmt::Display for LayerRepairs {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let counted = [
            (self.nan_values, "values NaN"),
            (self.infinite_values, "values infinite"),
            (self.oversized_values, "values beyond 1e18, variances beyond 1e36"),
            (self.pixels_replaced, "pixels replaced by their neighbours' average, in the damaged channels"),
            (self.variances_replaced, "variances replaced by their neighbours' average"),
            (self.negative_variances, "negative variances set to 0"),
            (self.misses, "pixels without a hit set to the far end"),
        ];
        let mut parts: Vec<_> =
            counted.iter().filter(|(count, _)| *count > 0).map(|(count, what)| format!("{count} {what}")).collect();
        if !self.damage.is_empty() {
            let places: Vec<_> = self
                .damage
                .iter()
                .map(|Damage { image, channel, values }| format!("{image} {channel} {values}"))
                .collect();
            parts.push(format!("damaged values: {}", places.join(", ")));
        }
        write!(f, "{}: {}", self.layer, if parts.is_empty() { "nothing to repair".into() } else { parts.join(", ") })
    }
}

/// All changes and remarks from the making of a frame. Displays with a line for each.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Repairs {
    /// Layers in which something was found; the sample counts are called `samples`.
    pub layers: Vec<LayerRepairs>,
    /// Features that were left out because they are constant or cannot be used; the notes say why.
    pub dropped_features: Vec<String>,
    /// Remarks for people.
    pub notes: Vec<String>,
}

impl Repairs {
    /// Returns whether there is nothing to report.
    pub fn is_empty(&self) -> bool {
        self.layers.is_empty() && self.dropped_features.is_empty() && self.notes.is_empty()
    }

    /// Returns the repairs of one layer; `None` if there were none.
    pub fn layer(&self, name: &str) -> Option<&LayerRepairs> {
        self.layers.iter().find(|layer| layer.layer == name)
    }

    pub(super) fn add(&mut self, layer: LayerRepairs) {
        if !layer.is_empty() {
            self.layers.push(layer);
        }
    }

    /// Leaves a feature out and notes the reason.
    pub(super) fn drop_feature(&mut self, name: String, why: &str) {
        self.notes.push(format!("feature {name}: {why}, left out"));
        self.dropped_features.push(name);
    }
}

impl fmt::Display for Repairs {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let lines: Vec<_> = self.layers.iter().map(ToString::to_string).chain(self.notes.iter().cloned()).collect();
        f.write_str(&lines.join("\n"))
    }
}

/// The signal that a remark is about. Displays as `colour`, `feature albedo` or `layer diffuse`.
#[derive(Clone, Copy)]
pub(super) struct Layer<'a> {
    pub(super) name: &'a str,
    pub(super) is_color: bool,
    /// Kind of signal before the name, with a space behind it; empty for the colour.
    kind: &'static str,
}

impl Layer<'_> {
    pub(super) const COLOR: Layer<'static> = Layer { name: "colour", is_color: true, kind: "" };

    pub(super) fn feature(name: &str) -> Layer<'_> {
        Layer { name, is_color: false, kind: "feature " }
    }

    pub(super) fn payload(name: &str) -> Layer<'_> {
        Layer { name, is_color: false, kind: "layer " }
    }

    /// Returns the name of a channel, which is counted from 0.
    pub(super) fn channel(self, channel: usize) -> String {
        match ["R", "G", "B"].get(channel).filter(|_| self.is_color) {
            Some(name) => (*name).to_owned(),
            None => format!("channel {}", channel + 1),
        }
    }

    /// Returns ` in R and G`, or nothing if `which` lists all channels.
    pub(super) fn in_channels(self, which: &[usize], channels: usize) -> String {
        let names: Vec<_> = which.iter().map(|channel| self.channel(*channel)).collect();
        if names.len() == channels { String::new() } else { format!(" in {}", names.join(" and ")) }
    }
}

impl fmt::Display for Layer<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}{}", self.kind, self.name)
    }
}
