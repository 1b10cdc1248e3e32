//! What is remembered from one start to the next.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use stein::{DfcParams, GemParams, Method, NlmParams, Preset};

use crate::document::Source;
use crate::view::Display;

/// Recent files that are kept.
const RECENT: usize = 10;

/// What is remembered.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct Settings {
    /// Newest first, each with its reference.
    pub recent: Vec<(PathBuf, Option<PathBuf>)>,
    /// Exposure and the like; not the scales of layers, which belong to a file.
    pub display: Display,
}

impl Settings {
    /// Under which key they are kept.
    pub const KEY: &str = "stein-viewer";

    /// Puts a file in front of the others.
    pub fn remember(&mut self, source: &Source) {
        let absolute = |path: &Path| std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
        let entry = (absolute(&source.input), source.reference.as_deref().map(absolute));
        self.recent.retain(|(input, _)| *input != entry.0);
        self.recent.insert(0, entry);
        self.recent.truncate(RECENT);
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
    pub const METHODS: [&str; 3] = ["dfc", "nlm", "gem"];

    /// A method with the parameters of a preset. `None` where there is no method of that name.
    pub fn of(method: &str, preset: Preset) -> Option<Self> {
        let thesis = preset == Preset::Thesis;
        let method = match method {
            "dfc" => Method::Dfc(if thesis { DfcParams::thesis() } else { DfcParams::default() }),
            "nlm" => Method::Nlm(if thesis { NlmParams::thesis() } else { NlmParams::default() }),
            "gem" => Method::Gem(if thesis { GemParams::thesis() } else { GemParams::default() }),
            _ => return None,
        };
        Some(Self { preset, method })
    }

    /// The method's parameters as its preset has them.
    #[must_use]
    pub fn reset(self) -> Self {
        Self::of(self.method.name(), self.preset).unwrap_or_default()
    }

    /// The radius of the window, where the method has one that can be set.
    pub fn radius_mut(&mut self) -> Option<&mut u32> {
        match &mut self.method {
            Method::Dfc(params) => Some(&mut params.window_radius),
            Method::Nlm(params) => Some(&mut params.window_radius),
            Method::Gem(_) => None,
        }
    }
}
