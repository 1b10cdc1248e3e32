//! How the sets are denoised: every combination of the axes that a method has.

use clap::ValueEnum;
use stein::Method;
use stein::method::Spikes;
use stein::stage::candidate_set::CandidateSet;

use super::super::Failure;
use super::super::options::{Choices, MethodName, PresetName, not_theirs};
use super::Axes;
use super::external::External;
use super::results::{self, Parameters};

/// A way to denoise a set.
pub(super) struct Configuration {
    pub(super) described: results::Configuration,
    pub(super) how: How,
}

pub(super) enum How {
    Stein {
        method: Method,
        /// Also what a frame does not need.
        everything: bool,
    },
    External(External),
}

/// All of them, and what is to say of options that some of the methods do not have.
pub(super) fn configurations(axes: &Axes) -> Result<(Vec<Configuration>, Vec<String>), Failure> {
    let methods = distinct(&axes.methods, &[MethodName::Dfc]);
    let presets = distinct(&axes.presets, PresetName::value_variants());
    let radii = choices(&axes.radii);
    let candidates = choices(&axes.candidates);
    let second_passes = choices(&axes.second_pass);
    let everything = distinct(&axes.everything, &[Switch::Off]);
    axes.tuning.check(&methods)?;
    let mut notes = Vec::new();
    // An option that only some have makes no further configurations of the others.
    let mut check = |option: &str, is_given: bool, has: fn(MethodName) -> bool| {
        let without: Vec<_> = methods.iter().filter(|method| !has(**method)).map(|method| method.name()).collect();
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
    check("--radii", !axes.radii.is_empty(), MethodName::has_radius)?;
    check("--candidates", !axes.candidates.is_empty(), MethodName::has_candidates)?;
    check("--second-pass", !axes.second_pass.is_empty(), MethodName::has_second_pass)?;

    let mut configurations = Vec::new();
    for &method in &methods {
        for &preset in &presets {
            for &everything in &everything {
                for &candidates in of(&candidates, method.has_candidates()) {
                    for &second_pass in of(&second_passes, method.has_second_pass()) {
                        for &radius in of(&radii, method.has_radius()) {
                            let choices = Choices { radius, candidates };
                            let way = Way { method, preset, second_pass, everything };
                            configurations.push(way.configuration(axes.tuning.method(method, preset, choices)?)?);
                        }
                    }
                }
            }
        }
    }
    for external in &axes.externals {
        if configurations.iter().any(|other| other.described.name == external.name) {
            let name = &external.name;
            return Err(Failure::usage(format_args!("--external: there are two configurations of the name {name}\n  remedy: choose another name")));
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

/// What was given, or the preset's own.
fn choices<T: Copy + PartialEq>(given: &[T]) -> Vec<Option<T>> {
    if given.is_empty() { vec![None] } else { distinct(given, &[]).into_iter().map(Some).collect() }
}

/// What was given, without repetitions, or the default where nothing was.
fn distinct<T: Copy + PartialEq>(given: &[T], default: &[T]) -> Vec<T> {
    let mut values = Vec::new();
    for &value in if given.is_empty() { default } else { given } {
        if !values.contains(&value) {
            values.push(value);
        }
    }
    values
}

/// The choices of a method that has any, or the only one.
fn of<T: Copy>(choices: &[Option<T>], has: bool) -> &[Option<T>] {
    if has { choices } else { &[None] }
}

/// What a configuration is made of, besides the method's parameters.
struct Way {
    method: MethodName,
    preset: PresetName,
    second_pass: Option<Switch>,
    everything: Switch,
}

impl Way {
    /// Its name says all that differs from the default, so that it means the same in every report.
    fn configuration(&self, mut parameters: Method) -> Result<Configuration, Failure> {
        let &Self { method, preset, second_pass, everything } = self;
        let mut candidates = None;
        let mut series = method.name().to_owned();
        if preset != PresetName::Default {
            series += &format!(" {}", preset.name());
        }
        if let Method::Dfc(params) = &mut parameters {
            candidates = Some(params.candidates.names().join("+"));
            if params.candidates != CandidateSet::ALL {
                series += &format!(" {}", params.candidates.names().join("+"));
            }
            if second_pass == Some(Switch::Off) {
                params.second_pass = None;
                series += " one pass";
            }
        }
        series += match parameters.spikes() {
            spikes if spikes == preset.spikes() => "",
            Spikes::Keep => " spikes keep",
            Spikes::Spread => " spikes spread",
            Spikes::Clamp => " spikes clamp",
        };
        let everything = everything == Switch::On;
        if everything {
            series += " everything";
        }
        let window_radius = method.has_radius().then(|| parameters.window_radius());
        let name = window_radius.map_or_else(|| series.clone(), |radius| format!("{series} R{radius}"));
        let stein = Parameters {
            method: method.name().into(),
            preset: preset.name().into(),
            window_radius,
            second_pass: method.has_second_pass().then_some(second_pass != Some(Switch::Off)),
            candidates,
            everything,
            all: serde_json::to_value(parameters).map_err(|error| Failure::output(format_args!("the parameters: {error}")))?,
        };
        let described = results::Configuration { name, series, stein: Some(stein), command: None };
        Ok(Configuration { described, how: How::Stein { method: parameters, everything } })
    }
}
