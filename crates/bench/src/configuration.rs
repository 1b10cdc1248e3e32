//! How the sets are denoised: every combination of the axes that a method has.

use stein::frame::NoiseKnowledge;
use stein::method::dfc::CandidateSet;
use stein::parameters::{Choice, Value};
use stein::{Method, Preset};

use crate::external::External;
use crate::results::{self, Parameters};
use crate::{Error, Result};

/// A way to denoise a set.
pub struct PreparedConfiguration {
    pub(crate) described: results::Configuration,
    pub(crate) how: How,
}

pub(crate) enum How {
    Stein {
        method: Method,
        /// Whether steps that a frame does not need run as well.
        everything: bool,
        noise: NoiseAxis,
    },
    External(External),
}

impl PreparedConfiguration {
    /// Returns the method with its parameters; `None` for another denoiser.
    pub fn method(&self) -> Option<&Method> {
        match &self.how {
            How::Stein { method, .. } => Some(method),
            How::External(_) => None,
        }
    }
}

/// Values whose combinations are measured. A method is combined with the axes that it has. An empty axis, except the
/// methods, stands for the value that the parameters hold, or for the first of its values.
#[derive(Clone, Debug, Default)]
pub struct Axes {
    /// Methods with their parameters, and the presets that these are based on.
    pub methods: Vec<(Method, Preset)>,
    /// Radii of the window, in pixels.
    pub radii: Vec<u32>,
    /// Candidates that take part.
    pub candidates: Vec<CandidateSet>,
    /// Whether the second pass runs.
    pub second_passes: Vec<bool>,
    /// Whether steps that a frame does not need run as well; empty: they do not.
    pub everything: Vec<bool>,
    /// Noise knowledge of the methods; empty: all that a set has.
    pub noise: Vec<NoiseAxis>,
    /// Other denoisers.
    pub externals: Vec<External>,
}

impl Axes {
    /// Returns all configurations. `tune` changes further parameters of a method.
    ///
    /// # Errors
    /// Errors of `tune`; [`Error::Stein`] for impossible parameters, [`Error::SameName`] for two configurations of one
    /// name.
    pub fn configurations<E: From<Error>>(
        &self,
        tune: impl Fn(Method) -> std::result::Result<Method, E>,
    ) -> std::result::Result<Vec<PreparedConfiguration>, E> {
        let radii = choices(&self.radii);
        let candidates = choices(&self.candidates);
        let second_passes = choices(&self.second_passes);
        let everything = distinct(&self.everything, &[false]);
        let noise = distinct(&self.noise, &[NoiseAxis::Given]);
        let mut configurations = Vec::new();
        // Axes that all methods have.
        let frames = || noise.iter().flat_map(|noise| everything.iter().map(|everything| (*noise, *everything)));
        for (base, preset) in distinct(&self.methods, &[]) {
            for (noise, everything) in frames() {
                for &candidates in of(&candidates, base.has_parameter(Method::CANDIDATES)) {
                    for &second_pass in of(&second_passes, base.has_parameter(Method::SECOND_PASS)) {
                        for &radius in of(&radii, base.has_parameter(Method::WINDOW_RADIUS)) {
                            let method = radius.map_or(base, |radius| base.with_window_radius(radius));
                            let method = candidates.map_or(method, |candidates| method.with_candidates(candidates));
                            let method = tune(method)?;
                            configurations.push(configuration(method, preset, second_pass, everything, noise)?);
                        }
                    }
                }
            }
        }
        for external in &self.externals {
            if configurations.iter().any(|other| other.described.name == external.name) {
                return Err(Error::SameName { name: external.name.clone() }.into());
            }
            configurations
                .push(PreparedConfiguration { described: external.described(), how: How::External(external.clone()) });
        }
        Ok(configurations)
    }
}

/// What the methods are told of the noise.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NoiseAxis {
    /// All that the set has.
    Given,
    /// The halves alone, of colour and features.
    Halves,
    /// Nothing but the image.
    Image,
}

impl NoiseAxis {
    /// All values.
    pub const ALL: [Self; 3] = [Self::Given, Self::Halves, Self::Image];

    /// Returns the names and meanings of [`NoiseAxis::ALL`].
    pub fn choices() -> [Choice; 3] {
        let about = |noise| match noise {
            Self::Given => "All that the set has.",
            Self::Halves => "The halves alone, of colour and features.",
            Self::Image => "Nothing but the image.",
        };
        Self::ALL.map(|noise| Choice { name: noise.name(), documentation: about(noise).into() })
    }

    /// Returns the noise knowledge that is left of a frame; `None` if all of it is left.
    pub(crate) fn knowledge(self) -> Option<NoiseKnowledge> {
        match self {
            Self::Given => None,
            Self::Halves => Some(NoiseKnowledge::HalvesOnly),
            Self::Image => Some(NoiseKnowledge::ImageOnly),
        }
    }

    /// Returns the name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Given => "given",
            Self::Halves => "halves",
            Self::Image => "image",
        }
    }
}

/// Returns the given values without repetitions, or a single `None`, which stands for the preset's own value.
fn choices<T: Copy + PartialEq>(given: &[T]) -> Vec<Option<T>> {
    if given.is_empty() { vec![None] } else { distinct(given, &[]).into_iter().map(Some).collect() }
}

/// Returns the given values without repetitions, or the default values if none are given.
pub fn distinct<T: Copy + PartialEq>(given: &[T], default: &[T]) -> Vec<T> {
    let mut values = Vec::new();
    for &value in if given.is_empty() { default } else { given } {
        if !values.contains(&value) {
            values.push(value);
        }
    }
    values
}

/// Returns `choices` if the method has the parameter, else a single `None`.
fn of<T: Copy>(choices: &[Option<T>], has: bool) -> &[Option<T>] {
    if has { choices } else { &[None] }
}

/// Builds a configuration. Its name states everything that differs from the default, so that the name means the same in
/// every report.
fn configuration(
    mut method: Method,
    preset: Preset,
    second_pass: Option<bool>,
    everything: bool,
    noise: NoiseAxis,
) -> Result<PreparedConfiguration> {
    if let Some(second_pass) = second_pass {
        method = method.with_parameter(Method::SECOND_PASS, second_pass)?;
    }
    let mut series = method.name().to_owned();
    if preset != Preset::Default {
        series += &format!(" {}", preset.name());
    }
    let mut candidates = None;
    let mut has_second_pass = None;
    for (parameter, of_preset) in method.parameters().into_iter().zip(method.of_preset(preset).parameters()) {
        // The parameter belongs to a group that is left out.
        let Some(value) = parameter.value else { continue };
        let differs = Some(&value) != of_preset.value.as_ref();
        match (parameter.name.as_str(), value) {
            (Method::CANDIDATES, Value::Set(names)) => {
                let names = names.join("+");
                if differs {
                    series += &format!(" {names}");
                }
                candidates = Some(names);
            }
            (Method::SECOND_PASS, Value::Flag(is_there)) => {
                if !is_there {
                    series += " one pass";
                }
                has_second_pass = Some(is_there);
            }
            ("spikes", value) if differs => series += &format!(" spikes {value}"),
            // The radius comes at the end of the name.
            (Method::WINDOW_RADIUS, _) => {}
            (name, value) if differs => series += &format!(" {name} {value}"),
            _ => {}
        }
    }
    if everything {
        series += " everything";
    }
    if noise != NoiseAxis::Given {
        series += &format!(" noise {}", noise.name());
    }
    let window_radius = method.has_parameter(Method::WINDOW_RADIUS).then(|| method.window_radius());
    let name = window_radius.map_or_else(|| series.clone(), |radius| format!("{series} R{radius}"));
    let stein = Parameters {
        method: method.name().into(),
        preset: preset.name().into(),
        window_radius,
        second_pass: has_second_pass,
        candidates,
        everything,
        noise: noise.name().into(),
        all: serde_json::to_value(method)
            .map_err(|error| Error::Part { part: "the parameters", reason: error.to_string() })?,
    };
    let described = results::Configuration { name, series, stein: Some(stein), command: None };
    Ok(PreparedConfiguration { described, how: How::Stein { method, everything, noise } })
}
