//! Settings that are kept from one start to the next.

use std::path::Path;

use serde::{Deserialize, Serialize};
use stein::parameters::{Parameter, Value};
use stein::{Method, Preset, Result};

use crate::document::Source;
use crate::view::Display;

/// Number of recent files that are kept.
const RECENT: usize = 10;

/// Settings that are kept from one start to the next.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct Settings {
    /// Sources that were open, newest first. They are stored under another name, because the field's own name once held
    /// another type.
    #[serde(rename = "sources")]
    pub recent: Vec<Source>,
    /// Exposure and other settings of the display; not the scales of layers, which belong to a file.
    pub display: Display,
    /// Parameters in use, in the format of [`Parameters::to_toml`].
    pub parameters: Option<String>,
    /// Parameters of [`Earlier`], in the same format.
    pub earlier: Vec<String>,
}

impl Settings {
    /// Key under which the settings are stored.
    pub const KEY: &str = "stein-viewer";

    /// Puts a source in front of the others, and removes the same buffer set with another reference. Ignores sources
    /// whose file names are not Unicode, because they cannot be stored.
    pub fn remember(&mut self, source: &Source) {
        let source = source.absolute();
        if source.files().any(|file| file.to_str().is_none()) {
            return;
        }
        self.recent.retain(|other| other.request != source.request);
        self.recent.insert(0, source);
        self.recent.truncate(RECENT);
    }
}

/// Parameters that were replaced by those of another method or preset: the last ones of each method and preset.
#[derive(Clone, Debug, Default)]
pub struct Earlier(Vec<Parameters>);

impl Earlier {
    /// Reads parameters from stored texts; ignores texts that are not valid.
    pub fn from_toml(texts: &[String]) -> Self {
        Self(texts.iter().filter_map(|text| Parameters::from_toml(text).ok()).collect())
    }

    /// Returns the parameters as texts to store.
    pub fn to_toml(&self) -> Vec<String> {
        self.0.iter().map(|left| left.to_toml()).collect()
    }

    /// Keeps parameters, and removes earlier ones with the same method and preset.
    pub fn keep(&mut self, left: Parameters) {
        self.0.retain(|other| !other.is_like(left));
        self.0.push(left);
    }

    /// Returns the parameters that were kept for the method and preset of `fresh`, or else `fresh`.
    pub fn take_up(&self, fresh: Parameters) -> Parameters {
        self.0.iter().find(|left| left.is_like(fresh)).copied().unwrap_or(fresh)
    }
}

/// A method with its parameters, and the preset that they started from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parameters {
    /// Preset that a reset returns to.
    pub preset: Preset,
    /// The method and its parameters.
    pub method: Method,
}

impl Default for Parameters {
    fn default() -> Self {
        Self { preset: Preset::Default, method: Method::default() }
    }
}

impl Parameters {
    /// Names of the methods.
    pub const METHODS: [&str; 3] = Method::NAMES;

    /// Returns a method with the parameters of a preset; `None` if no method has this name.
    pub fn of(method: &str, preset: Preset) -> Option<Self> {
        let method = Method::all().into_iter().find(|known| known.name() == method)?;
        Some(Self { preset, method: method.of_preset(preset) })
    }

    /// Returns whether method and preset are the same.
    fn is_like(self, other: Self) -> bool {
        (self.method.name(), self.preset) == (other.method.name(), other.preset)
    }

    /// Returns method and preset, with all parameters as the preset has them.
    #[must_use]
    pub fn reset(self) -> Self {
        Self { method: self.method.of_preset(self.preset), ..self }
    }

    /// Returns the value of a parameter in the preset. If the preset leaves out the parameter's group, returns the
    /// value that the parameter has when the group is added.
    pub fn preset_value(self, parameter: &Parameter) -> Option<Value> {
        let own = match self.preset {
            Preset::Default => &parameter.default,
            Preset::Thesis => &parameter.thesis,
        };
        own.as_ref().or(parameter.default.as_ref()).cloned()
    }

    /// Returns whether a parameter differs from the preset.
    pub fn differs(self, parameter: &Parameter) -> bool {
        parameter.value.is_some() && parameter.value != self.preset_value(parameter)
    }

    /// Returns the text of a file that `stein denoise --params` accepts.
    pub fn to_toml(self) -> String {
        self.method.to_toml(self.preset)
    }

    /// Reads parameters from the text of such a file.
    ///
    /// # Errors
    /// As [`Method::from_toml`].
    pub fn from_toml(text: &str) -> Result<Self> {
        Method::from_toml(text).map(|(method, preset)| Self { preset, method })
    }

    /// Reads parameters from such a file.
    ///
    /// # Errors
    /// As [`Method::read_toml`].
    pub fn read(path: &Path) -> Result<Self> {
        Method::read_toml(path).map(|(method, preset)| Self { preset, method })
    }
}
