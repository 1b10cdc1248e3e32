//! What is remembered from one start to the next.

use std::path::Path;

use serde::{Deserialize, Serialize};
use stein::parameters::{Parameter, Value};
use stein::{Method, Preset, Result};

use crate::document::Source;
use crate::view::Display;

/// Recent files that are kept.
const RECENT: usize = 10;

/// What is remembered.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct Settings {
    /// What was open, newest first. What stood under the field's own name was of another type.
    #[serde(rename = "sources")]
    pub recent: Vec<Source>,
    /// Exposure and the like; not the scales of layers, which belong to a file.
    pub display: Display,
    /// How was denoised, as [`Parameters::to_toml`] has it.
    pub parameters: Option<String>,
    /// [`Earlier`], in the same way.
    pub earlier: Vec<String>,
}

impl Settings {
    /// Under which key they are kept.
    pub const KEY: &str = "stein-viewer";

    /// Puts what is open in front of the others, in place of the same with another reference. Names of files that are
    /// not Unicode cannot be kept.
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

/// Parameters that were left for those of another method or preset: of each method and preset the last.
#[derive(Clone, Debug, Default)]
pub struct Earlier(Vec<Parameters>);

impl Earlier {
    /// Out of what is remembered.
    pub fn from_toml(texts: &[String]) -> Self {
        Self(texts.iter().filter_map(|text| Parameters::from_toml(text).ok()).collect())
    }

    /// To be remembered.
    pub fn to_toml(&self) -> Vec<String> {
        self.0.iter().map(|left| left.to_toml()).collect()
    }

    /// Keeps parameters that are left.
    pub fn keep(&mut self, left: Parameters) {
        self.0.retain(|other| !other.is_like(left));
        self.0.push(left);
    }

    /// A method and preset with the parameters that were left, or else with those of the preset.
    pub fn take_up(&self, fresh: Parameters) -> Parameters {
        self.0.iter().find(|left| left.is_like(fresh)).copied().unwrap_or(fresh)
    }
}

/// How is denoised: a method with its parameters, and the preset that they started from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parameters {
    /// What a reset goes back to.
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

    /// A method with the parameters of a preset. `None` where there is no method of that name.
    pub fn of(method: &str, preset: Preset) -> Option<Self> {
        let method = Method::all().into_iter().find(|known| known.name() == method)?;
        Some(Self { preset, method: method.of_preset(preset) })
    }

    /// Whether method and preset are the same.
    fn is_like(self, other: Self) -> bool {
        (self.method.name(), self.preset) == (other.method.name(), other.preset)
    }

    /// The method's parameters as its preset has them.
    #[must_use]
    pub fn reset(self) -> Self {
        Self { method: self.method.of_preset(self.preset), ..self }
    }

    /// What a parameter is in the preset; of one in a group that the preset leaves out, what it is where the group is
    /// put in.
    pub fn preset_value(self, parameter: &Parameter) -> Option<Value> {
        let own = match self.preset {
            Preset::Default => &parameter.default,
            Preset::Thesis => &parameter.thesis,
        };
        own.as_ref().or(parameter.default.as_ref()).cloned()
    }

    /// Whether a parameter is something else than in the preset.
    pub fn differs(self, parameter: &Parameter) -> bool {
        parameter.value.is_some() && parameter.value != self.preset_value(parameter)
    }

    /// As a file that `stein denoise --params` accepts.
    pub fn to_toml(self) -> String {
        self.method.to_toml(self.preset)
    }

    /// Out of such a file's text.
    ///
    /// # Errors
    /// As [`Method::from_toml`].
    pub fn from_toml(text: &str) -> Result<Self> {
        Method::from_toml(text).map(|(method, preset)| Self { preset, method })
    }

    /// Out of such a file.
    ///
    /// # Errors
    /// As [`Method::read_toml`].
    pub fn read(path: &Path) -> Result<Self> {
        Method::read_toml(path).map(|(method, preset)| Self { preset, method })
    }
}
