//! What had to be changed to make a frame, for people and programs.

use std::fmt;

use serde::Serialize;

/// What was found and changed in one signal: its mean, halves and variance.
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
    /// Pixels whose mean and halves (and variance) were replaced by their neighbours' average.
    pub pixels_replaced: usize,
    /// Pixels of which only the variance was replaced.
    pub variances_replaced: usize,
    /// Variance values below zero, set to 0.
    pub negative_variances: usize,
    /// Pixels that hit nothing, set to the far end of the feature's range. Not damage.
    pub misses: usize,
}

impl LayerRepairs {
    /// Whether nothing was found.
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
            (self.pixels_replaced, "pixels replaced by their neighbours' average"),
            (self.variances_replaced, "variances replaced by their neighbours' average"),
            (self.negative_variances, "negative variances set to 0"),
            (self.misses, "pixels without a hit set to the far end"),
        ];
        let parts: Vec<_> = counted.iter().filter(|(count, _)| *count > 0).map(|(count, what)| format!("{count} {what}")).collect();
        write!(f, "{}: {}", self.layer, if parts.is_empty() { "nothing to repair".into() } else { parts.join(", ") })
    }
}

/// Everything that was changed, left out or is worth knowing about a frame's making. Displays as one line for each.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Repairs {
    /// The layers in which something was found; the sample counts are called `samples`.
    pub layers: Vec<LayerRepairs>,
    /// Features left out because they are the same everywhere.
    pub dropped_features: Vec<String>,
    /// Remarks for people.
    pub notes: Vec<String>,
}

impl Repairs {
    /// Whether there is nothing to say.
    pub fn is_empty(&self) -> bool {
        self.layers.is_empty() && self.dropped_features.is_empty() && self.notes.is_empty()
    }

    /// What was found in one layer, if anything was.
    pub fn layer(&self, name: &str) -> Option<&LayerRepairs> {
        self.layers.iter().find(|layer| layer.layer == name)
    }

    pub(super) fn add(&mut self, layer: LayerRepairs) {
        if !layer.is_empty() {
            self.layers.push(layer);
        }
    }
}

impl fmt::Display for Repairs {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let lines: Vec<_> = self.layers.iter().map(ToString::to_string).chain(self.notes.iter().cloned()).collect();
        f.write_str(&lines.join("\n"))
    }
}
