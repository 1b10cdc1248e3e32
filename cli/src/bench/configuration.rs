//! How the sets are denoised: every combination of the axes that a method has.

use clap::ValueEnum;
use stein::frame::NoiseKnowledge;
use stein::parameters::Value;
use stein::{Method, Preset};

use super::super::Failure;
use super::super::filter::{CANDIDATES, Choices, Chosen, WINDOW_RADIUS, not_theirs};
use super::Axes;
use super::external::External;
use super::results::{self, Parameters};

/// Name of the parameter of `--second-pass`.
const SECOND_PASS: &str = "second_pass";

/// A way to denoise a set.
pub(super) struct Configuration {
    pub(super) described: results::Configuration,
    pub(super) how: How,
}

pub(super) enum How {
    Stein {
        method: Method,
        /// Whether steps that a frame does not need run as well.
        everything: bool,
        noise: NoiseAxis,
    },
    External(External),
}

/// Returns all configurations, and notes on options that some of the methods do not have.
pub(super) fn configurations(axes: &Axes) -> Result<(Vec<Configuration>, Vec<String>), Failure> {
    let file = axes.tuning.file()?;
    if let Some(file) = &file {
        file.agrees("--methods", axes.methods.iter().map(Method::name), file.chosen.method.name())?;
        file.agrees("--presets", axes.presets.iter().map(|preset| preset.name()), file.chosen.preset.name())?;
    }
    let file = file.map(|file| file.chosen);
    let methods = distinct(&axes.methods, &[file.map(|file| file.method).unwrap_or_default()]);
    let presets = distinct(&axes.presets, &file.map_or_else(|| Preset::ALL.to_vec(), |file| vec![file.preset]));
    let radii = choices(&axes.radii);
    let candidates = choices(&axes.candidates);
    let second_passes = choices(&axes.second_pass);
    let everything = distinct(&axes.everything, &[Switch::Off]);
    let noise = distinct(&axes.noise, &[NoiseAxis::Given]);
    axes.tuning.check(&methods)?;
    let mut notes = Vec::new();
    // A method without the option is measured once, whatever the values of the option.
    let mut check = |option: &str, is_given: bool, parameter: &str| {
        let without: Vec<_> =
            methods.iter().filter(|method| !method.has_parameter(parameter)).map(Method::name).collect();
        match without.len() {
            0 => Ok(()),
            _ if !is_given => Ok(()),
            all if all == methods.len() => Err(not_theirs(option, &methods)),
            _ => {
                notes.push(format!("{option} is no option of {}, measured once", without.join(" and ")));
                Ok(())
            }
        }
    };
    check("--radii", !axes.radii.is_empty(), WINDOW_RADIUS)?;
    check("--candidates", !axes.candidates.is_empty(), CANDIDATES)?;
    check("--second-pass", !axes.second_pass.is_empty(), SECOND_PASS)?;

    let mut configurations = Vec::new();
    // Axes that all methods have.
    let frames = || noise.iter().flat_map(|noise| everything.iter().map(|everything| (*noise, *everything)));
    for &method in &methods {
        for &preset in &presets {
            for (noise, everything) in frames() {
                for &candidates in of(&candidates, method.has_parameter(CANDIDATES)) {
                    for &second_pass in of(&second_passes, method.has_parameter(SECOND_PASS)) {
                        for &radius in of(&radii, method.has_parameter(WINDOW_RADIUS)) {
                            let base = file.unwrap_or(Chosen::of(method, preset));
                            let method = axes.tuning.applied_to(base.method, Choices { radius, candidates })?;
                            configurations.push(configuration(
                                Chosen { method, ..base },
                                second_pass,
                                everything,
                                noise,
                            )?);
                        }
                    }
                }
            }
        }
    }
    for external in &axes.externals {
        if configurations.iter().any(|other| other.described.name == external.name) {
            let name = &external.name;
            return Err(Failure::usage(format_args!(
                "--external: there are two configurations of the name {name}\n  remedy: choose another name"
            )));
        }
        configurations.push(Configuration { described: external.described(), how: How::External(external.clone()) });
    }
    Ok((configurations, notes))
}

/// On or off.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum Switch {
    On,
    Off,
}

/// What the methods are told of the noise.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum NoiseAxis {
    /// All that the set has
    Given,
    /// The halves alone, of colour and features
    Halves,
    /// Nothing but the image
    Image,
}

impl NoiseAxis {
    /// Returns the noise knowledge that is left of a frame; `None` if all of it is left.
    pub(super) fn knowledge(self) -> Option<NoiseKnowledge> {
        match self {
            Self::Given => None,
            Self::Halves => Some(NoiseKnowledge::HalvesOnly),
            Self::Image => Some(NoiseKnowledge::ImageOnly),
        }
    }

    pub(super) fn name(self) -> &'static str {
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
pub(super) fn distinct<T: Copy + PartialEq>(given: &[T], default: &[T]) -> Vec<T> {
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
    Chosen { mut method, preset }: Chosen,
    second_pass: Option<Switch>,
    everything: Switch,
    noise: NoiseAxis,
) -> Result<Configuration, Failure> {
    if let Some(second_pass) = second_pass {
        method = method.with_parameter(SECOND_PASS, second_pass == Switch::On)?;
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
            (CANDIDATES, Value::Set(names)) => {
                let names = names.join("+");
                if differs {
                    series += &format!(" {names}");
                }
                candidates = Some(names);
            }
            (SECOND_PASS, Value::Flag(is_there)) => {
                if !is_there {
                    series += " one pass";
                }
                has_second_pass = Some(is_there);
            }
            ("spikes", value) if differs => series += &format!(" spikes {value}"),
            // The radius comes at the end of the name.
            (WINDOW_RADIUS, _) => {}
            (name, value) if differs => series += &format!(" {name} {value}"),
            _ => {}
        }
    }
    let everything = everything == Switch::On;
    if everything {
        series += " everything";
    }
    if noise != NoiseAxis::Given {
        series += &format!(" noise {}", noise.name());
    }
    let window_radius = method.has_parameter(WINDOW_RADIUS).then(|| method.window_radius());
    let name = window_radius.map_or_else(|| series.clone(), |radius| format!("{series} R{radius}"));
    let stein = Parameters {
        method: method.name().into(),
        preset: preset.name().into(),
        window_radius,
        second_pass: has_second_pass,
        candidates,
        everything,
        noise: noise.name().into(),
        all: serde_json::to_value(method).map_err(|error| Failure::output(format_args!("the parameters: {error}")))?,
    };
    let described = results::Configuration { name, series, stein: Some(stein), command: None };
    Ok(Configuration { described, how: How::Stein { method, everything, noise } })
}
