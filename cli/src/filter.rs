//! Filter options of all methods, and files of parameters.

use std::path::{Path, PathBuf};

use clap::builder::PossibleValuesParser;
use stein::method::Spikes;
use stein::method::dfc::CandidateSet;
use stein::text;
use stein::{Method, Preset};
use stein_exr::options::{choice, possible};

use super::Failure;

/// Method and parameters.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Filter")]
pub(crate) struct Filter {
    /// Set of parameters to start from [default: default, or the preset of --params]
    #[arg(long, value_name = "NAME", value_parser = choice(Preset::ALL, &Preset::choices()))]
    preset: Option<Preset>,
    /// Denoising method [default: dfc, or the method of --params]
    #[arg(long, value_parser = choice(&Method::all(), &Method::choices()))]
    method: Option<Method>,
    /// For dfc and nlm: radius of the window that is averaged, in pixels [default: 10]
    #[arg(long, value_name = "PIXELS")]
    radius: Option<u32>,
    /// For dfc: candidates to use, such as first,second; the others are not computed [default: first,second,third]
    #[arg(
        long,
        value_name = "NAME",
        value_delimiter = ',',
        value_parser = PossibleValuesParser::new(CandidateSet::choices().iter().map(possible))
    )]
    candidates: Vec<String>,
    #[command(flatten)]
    tuning: Tuning,
}

/// A method with the requested parameters, and the preset that they are based on.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Chosen {
    pub(crate) method: Method,
    pub(crate) preset: Preset,
}

/// Options of every method.
#[derive(Clone, Debug, PartialEq, clap::Args)]
#[command(next_help_heading = "Filter")]
pub(crate) struct Tuning {
    /// TOML file with method, preset and parameters, as `stein params` writes; other options override it
    #[arg(long, value_name = "FILE")]
    params: Option<PathBuf>,
    /// Treatment of spikes: pixels that stand out from similar ones and rest on very few samples [default: spread; for
    /// the preset thesis: keep]
    #[arg(long, value_name = "RULE", value_parser = choice(Spikes::ALL, &Spikes::choices()))]
    spikes: Option<Spikes>,
    /// Value for a parameter of the method, such as guard=false or second_pass.color_k=0.4; may be repeated. `stein
    /// params --list` lists them all
    #[arg(long = "set", value_name = "NAME=VALUE", value_parser = setting)]
    settings: Vec<(String, String)>,
}

/// Parses the name and the value of a parameter.
fn setting(text: &str) -> Result<(String, String), String> {
    let parts = text.split_once('=').filter(|(name, _)| !name.trim().is_empty());
    let (name, value) = parts.ok_or("it must look like NAME=VALUE, such as window_radius=20")?;
    Ok((name.trim().to_owned(), value.trim().to_owned()))
}

impl Filter {
    /// Whether `--spikes` is given.
    pub(crate) fn sets_spikes(&self) -> bool {
        self.tuning.spikes.is_some()
    }

    /// Returns the method with the parameters of the file or of the preset, changed by the given options. Refuses
    /// options that the method does not have.
    pub(crate) fn chosen(&self) -> Result<Chosen, Failure> {
        let base = match self.tuning.file()? {
            Some(file) => {
                file.agrees("--method", self.method.iter().map(Method::name), file.chosen.method.name())?;
                file.agrees("--preset", self.preset.iter().map(|preset| preset.name()), file.chosen.preset.name())?;
                file.chosen
            }
            None => Chosen::of(self.method.unwrap_or_default(), self.preset.unwrap_or(Preset::Default)),
        };
        let given = [
            ("--radius", Method::WINDOW_RADIUS, self.radius.is_some()),
            ("--candidates", Method::CANDIDATES, !self.candidates.is_empty()),
        ];
        if let Some((option, ..)) =
            given.iter().find(|(_, parameter, is_given)| *is_given && !base.method.has_parameter(parameter))
        {
            return Err(not_theirs(option, &[base.method]));
        }
        self.tuning.check(&[base.method])?;
        let candidates = (!self.candidates.is_empty()).then(|| CandidateSet::of_names(&self.candidates));
        let method = self.radius.map_or(base.method, |radius| base.method.with_window_radius(radius));
        let method = candidates.map_or(method, |candidates| method.with_candidates(candidates));
        let method = self.tuning.applied_to(method)?;
        Ok(Chosen { method, ..base })
    }
}

impl Chosen {
    pub(crate) fn of(method: Method, preset: Preset) -> Self {
        Self { method: method.of_preset(preset), preset }
    }
}

impl Tuning {
    /// Reads the file of parameters; `None` without `--params`.
    pub(crate) fn file(&self) -> Result<Option<ParamsFile<'_>>, Failure> {
        self.params.as_deref().map(ParamsFile::read).transpose()
    }

    /// Refuses parameters that none of the methods has.
    pub(crate) fn check(&self, methods: &[Method]) -> Result<(), Failure> {
        let unknown = self.settings.iter().find(|(name, _)| !methods.iter().any(|method| method.has_parameter(name)));
        match (unknown, methods.first()) {
            (Some((name, value)), Some(method)) => {
                method.with_settings([(name.as_str(), value.as_str())]).map(drop).map_err(Failure::usage)
            }
            _ => Ok(()),
        }
    }

    /// Returns the method with the given parameters changed.
    pub(crate) fn applied_to(&self, method: Method) -> Result<Method, Failure> {
        let method = self.spikes.map_or(method, |spikes| method.with_spikes(spikes));
        let own = self.settings.iter().filter(|(name, _)| method.has_parameter(name));
        method.with_settings(own.map(|(name, value)| (name.as_str(), value.as_str()))).map_err(Failure::usage)
    }
}

/// A file of parameters.
pub(crate) struct ParamsFile<'a> {
    path: &'a Path,
    pub(crate) chosen: Chosen,
}

impl<'a> ParamsFile<'a> {
    fn read(path: &'a Path) -> Result<Self, Failure> {
        let (method, preset) = Method::read_toml(path)?;
        Ok(Self { path, chosen: Chosen { method, preset } })
    }

    /// Refuses an option that contradicts the file.
    pub(crate) fn agrees(
        &self,
        option: &str,
        given: impl IntoIterator<Item = &'static str>,
        own: &str,
    ) -> Result<(), Failure> {
        match given.into_iter().find(|given| *given != own) {
            None => Ok(()),
            Some(other) => {
                let (path, key) = (text::path(self.path), option.trim_start_matches('-').trim_end_matches('s'));
                Err(Failure::usage(format_args!(
                    "{option} {other}: {path} is for {own}\
                     \n  remedy: leave the option out, or write `{key} = \"{other}\"` into the file"
                )))
            }
        }
    }
}

/// Returns the failure for an option that none of the methods has.
pub(crate) fn not_theirs(option: &str, methods: &[Method]) -> Failure {
    let names = methods.iter().map(Method::name).collect::<Vec<_>>().join(" or ");
    Failure::usage(format_args!(
        "{option} is no option of the method {names}\n  remedy: leave it out, or choose another --method"
    ))
}

/// Parses candidates joined by plus signs, as in first+second, or all.
pub(crate) fn candidates(text: &str) -> Result<CandidateSet, String> {
    if text == "all" {
        return Ok(CandidateSet::ALL);
    }
    let names: Vec<_> = text.split('+').map(|name| name.trim().to_ascii_lowercase()).collect();
    let are_known = names.iter().all(|name| CandidateSet::NAMES.contains(&name.as_str()));
    are_known
        .then(|| CandidateSet::of_names(&names))
        .ok_or_else(|| "it must be all, or look like first+second, of first, second and third".to_owned())
}
