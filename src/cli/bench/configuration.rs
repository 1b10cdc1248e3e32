//! How the sets are denoised: every combination of the axes that a method has.

use clap::ValueEnum;
use stein::Method;

use super::super::Failure;
use super::super::options::{MethodName, PresetName, not_theirs};
use super::Axes;
use super::external::External;
use super::results::{self, Parameters};

/// A way to denoise a set.
pub(super) struct Configuration {
    pub(super) described: results::Configuration,
    pub(super) how: How,
}

pub(super) enum How {
    Stein(Method),
    External(External),
}

/// All of them, and what is to say of options that some of the methods do not have.
pub(super) fn configurations(axes: &Axes) -> Result<(Vec<Configuration>, Vec<String>), Failure> {
    let methods = distinct(&axes.methods, &[MethodName::Dfc]);
    let presets = distinct(&axes.presets, PresetName::value_variants());
    let radii = distinct(&axes.radii, &[]);
    let second_passes: Vec<bool> = distinct(&axes.second_pass, &[Switch::On]).into_iter().map(|switch| switch == Switch::On).collect();
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
    check("--radii", !radii.is_empty(), MethodName::has_radius)?;
    check("--second-pass", !axes.second_pass.is_empty(), has_second_pass)?;

    let mut configurations = Vec::new();
    for &method in &methods {
        // `None`: the preset's own.
        let radii: Vec<Option<u32>> = if method.has_radius() && !radii.is_empty() { radii.iter().map(|&radius| Some(radius)).collect() } else { vec![None] };
        let second_passes = if has_second_pass(method) { &second_passes[..] } else { &[true] };
        for &preset in &presets {
            for &with_second_pass in second_passes {
                for &radius in &radii {
                    let mut parameters = axes.tuning.method(method, preset, radius)?;
                    if let (Method::Dfc(params), false) = (&mut parameters, with_second_pass) {
                        params.second_pass = None;
                    }
                    let second_pass = has_second_pass(method).then_some(with_second_pass);
                    configurations.push(Configuration { described: described(method, preset, second_pass, &parameters)?, how: How::Stein(parameters) });
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

fn has_second_pass(method: MethodName) -> bool {
    method == MethodName::Dfc
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

/// Its name says all that differs from the default, so that it means the same in every report.
fn described(method: MethodName, preset: PresetName, second_pass: Option<bool>, parameters: &Method) -> Result<results::Configuration, Failure> {
    let mut series = method.name().to_owned();
    if preset != PresetName::Default {
        series += &format!(" {}", preset.name());
    }
    if second_pass == Some(false) {
        series += " one pass";
    }
    let window_radius = method.has_radius().then(|| parameters.window_radius());
    let name = window_radius.map_or_else(|| series.clone(), |radius| format!("{series} R{radius}"));
    let parameters = serde_json::to_value(parameters).map_err(|error| Failure::output(format_args!("the parameters: {error}")))?;
    let parameters = Parameters { method: method.name().into(), preset: preset.name().into(), window_radius, second_pass, all: parameters };
    Ok(results::Configuration { name, series, stein: Some(parameters), command: None })
}
