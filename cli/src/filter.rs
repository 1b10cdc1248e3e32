//! How to filter: the options of all methods, and files of parameters.

use std::path::{Path, PathBuf};

use clap::builder::PossibleValuesParser;
use stein::method::Spikes;
use stein::method::nlm::NlmVariance;
use stein::stage::candidate_set::CandidateSet;
use stein::stage::nlm::{Symmetry, Weighting};
use stein::text;
use stein::{DfcParams, GemParams, Method, NlmParams, Preset};
use stein_exr::options::{choice, possible};

use super::Failure;

/// The parameter of `--radius`.
pub(crate) const WINDOW_RADIUS: &str = "window_radius";
/// The parameter of `--candidates`.
pub(crate) const CANDIDATES: &str = "candidates";

/// How to filter.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Filter")]
pub(crate) struct Filter {
    /// Parameters [default: default, or that of --params]
    #[arg(long, value_name = "NAME", value_parser = choice(Preset::ALL, &Preset::choices()))]
    preset: Option<Preset>,
    /// Method [default: dfc, or that of --params]
    #[arg(long, value_parser = choice(&Method::all(), &Method::choices()))]
    method: Option<Method>,
    /// Of dfc and nlm: radius of the window that is averaged over, in pixels [default: 10]
    #[arg(long, value_name = "PIXELS")]
    radius: Option<u32>,
    /// Of dfc: which candidates take part; the others are not computed [default: first,second,third]
    #[arg(long, value_name = "NAME", value_delimiter = ',', value_parser = PossibleValuesParser::new(CandidateSet::choices().iter().map(possible)))]
    candidates: Vec<String>,
    #[command(flatten)]
    tuning: Tuning,
}

/// A method with the parameters that were asked for, and the preset that they set out from.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Chosen {
    pub(crate) method: Method,
    pub(crate) preset: Preset,
}

/// What may be set of every method, and of one alone.
#[derive(Clone, Debug, PartialEq, clap::Args)]
#[command(next_help_heading = "Filter")]
pub(crate) struct Tuning {
    /// TOML file with method, preset and parameters, such as `stein params` writes; the other options go before it
    #[arg(long, value_name = "FILE")]
    params: Option<PathBuf>,
    /// What becomes of spikes: pixels that stand out from those of their kind and rest on very few samples [default: spread; of the preset thesis: keep]
    #[arg(long, value_name = "RULE", value_parser = choice(Spikes::ALL, &Spikes::choices()))]
    spikes: Option<Spikes>,
    /// Of gem: share of wrong decisions for a sharper filter where the image is constant, above 0 and below 0.4; lower is smoother [default: 0.15]
    #[arg(long, value_name = "SHARE")]
    gamma: Option<f32>,
    #[command(flatten)]
    nlm: NlmChoice,
}

/// What may be set of NLM alone.
#[derive(Clone, Debug, PartialEq, clap::Args)]
#[command(next_help_heading = "Filter")]
struct NlmChoice {
    /// Of nlm: radius of the patches that are compared, in pixels; 0 compares single pixels [default: 3]
    #[arg(long, value_name = "PIXELS")]
    patch_radius: Option<u32>,
    /// Of nlm: how large a difference counts, in standard deviations; more filters more [default: 0.45]
    #[arg(long, value_name = "NUMBER")]
    k: Option<f32>,
    /// Of nlm: how much of the variance is cancelled from differences; more filters more [default: 1]
    #[arg(long, value_name = "NUMBER")]
    alpha: Option<f32>,
    /// Of nlm: whether the mean of opposite neighbours may stand for both, which keeps gradients [default: hard]
    #[arg(long, value_name = "RULE", value_parser = choice(Symmetry::ALL, &Symmetry::choices()))]
    symmetric: Option<Symmetry>,
    /// Of nlm: weights below this one become 0 [default: 0.05]
    #[arg(long, value_name = "WEIGHT")]
    cut: Option<f32>,
    /// Of nlm: weigh pixels by their own patches alone, not by the mean over all patches that they share
    #[arg(long)]
    pixelwise: bool,
    /// Of nlm: filter the whole with its own weights, not each half with those of the other
    #[arg(long)]
    single_buffer: bool,
    /// Of nlm: take the image's mean variance for every pixel
    #[arg(long)]
    uniform_variance: bool,
}

impl Filter {
    /// Whether it is said what becomes of spikes.
    pub(crate) fn sets_spikes(&self) -> bool {
        self.tuning.spikes.is_some()
    }

    /// The parameters of the file or of the preset, but for those that were set. Options that the method does not have are not ignored.
    pub(crate) fn chosen(&self) -> Result<Chosen, Failure> {
        let base = match self.tuning.file()? {
            Some(file) => {
                file.agrees("--method", self.method.iter().map(Method::name), file.chosen.method.name())?;
                file.agrees("--preset", self.preset.iter().map(|preset| preset.name()), file.chosen.preset.name())?;
                file.chosen
            }
            None => Chosen::of(self.method.unwrap_or_default(), self.preset.unwrap_or(Preset::Default)),
        };
        let given = [("--radius", WINDOW_RADIUS, self.radius.is_some()), ("--candidates", CANDIDATES, !self.candidates.is_empty())];
        if let Some((option, ..)) = given.iter().find(|(_, parameter, is_given)| *is_given && !base.method.has_parameter(parameter)) {
            return Err(not_theirs(option, &[base.method]));
        }
        self.tuning.check(&[base.method])?;
        let candidates = (!self.candidates.is_empty()).then(|| CandidateSet::of_names(&self.candidates));
        let method = self.tuning.applied_to(base.method, Choices { radius: self.radius, candidates })?;
        Ok(Chosen { method, ..base })
    }
}

impl Chosen {
    pub(crate) fn of(method: Method, preset: Preset) -> Self {
        Self { method: method.of_preset(preset), preset }
    }
}

/// What may be set of several methods, or of which `stein bench` measures several; `None` is the preset's own.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Choices {
    pub(crate) radius: Option<u32>,
    pub(crate) candidates: Option<CandidateSet>,
}

impl Tuning {
    /// What the file says, where there is one.
    pub(crate) fn file(&self) -> Result<Option<ParamsFile<'_>>, Failure> {
        self.params.as_deref().map(ParamsFile::read).transpose()
    }

    /// Refuses options that none of the methods has.
    pub(crate) fn check(&self, methods: &[Method]) -> Result<(), Failure> {
        let of_gem = [("--gamma", self.gamma.is_some())];
        for (owner, options) in [("gem", &of_gem[..]), ("nlm", &self.nlm.given()[..])] {
            let given = options.iter().find(|(_, is_given)| *is_given);
            if let (Some((option, _)), false) = (given, methods.iter().any(|method| method.name() == owner)) {
                return Err(not_theirs(option, methods));
            }
        }
        Ok(())
    }

    /// A method with its parameters, but for those that were set.
    pub(crate) fn applied_to(&self, method: Method, Choices { radius, candidates }: Choices) -> Result<Method, Failure> {
        let method = match method {
            Method::Dfc(params) => {
                Method::from(DfcParams { window_radius: radius.unwrap_or(params.window_radius), candidates: candidates.unwrap_or(params.candidates), ..params })
            }
            Method::Gem(params) => Method::from(GemParams { gamma: self.gamma.unwrap_or(params.gamma), ..params }),
            Method::Nlm(params) => Method::from(self.nlm.applied_to(NlmParams { window_radius: radius.unwrap_or(params.window_radius), ..params })),
        };
        let method = self.spikes.map_or(method, |spikes| method.with_spikes(spikes));
        method.validate().map_err(Failure::usage)?;
        Ok(method)
    }
}

impl NlmChoice {
    /// Every option, and whether it is given.
    fn given(&self) -> [(&'static str, bool); 8] {
        [
            ("--patch-radius", self.patch_radius.is_some()),
            ("--k", self.k.is_some()),
            ("--alpha", self.alpha.is_some()),
            ("--symmetric", self.symmetric.is_some()),
            ("--cut", self.cut.is_some()),
            ("--pixelwise", self.pixelwise),
            ("--single-buffer", self.single_buffer),
            ("--uniform-variance", self.uniform_variance),
        ]
    }

    fn applied_to(&self, params: NlmParams) -> NlmParams {
        NlmParams {
            patch_radius: self.patch_radius.unwrap_or(params.patch_radius),
            k: self.k.unwrap_or(params.k),
            alpha: self.alpha.unwrap_or(params.alpha),
            weighting: Weighting { symmetric: self.symmetric.unwrap_or(params.weighting.symmetric), ..params.weighting },
            cut: self.cut.unwrap_or(params.cut),
            patchwise: params.patchwise && !self.pixelwise,
            dual_buffer: params.dual_buffer && !self.single_buffer,
            variance: if self.uniform_variance { NlmVariance::Uniform } else { params.variance },
            ..params
        }
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

    /// Refuses an option that says something else than the file.
    pub(crate) fn agrees(&self, option: &str, given: impl IntoIterator<Item = &'static str>, own: &str) -> Result<(), Failure> {
        match given.into_iter().find(|given| *given != own) {
            None => Ok(()),
            Some(other) => {
                let (path, key) = (text::path(self.path), option.trim_start_matches('-').trim_end_matches('s'));
                Err(Failure::usage(format_args!(
                    "{option} {other}: {path} is for {own}\n  remedy: leave the option out, or write `{key} = \"{other}\"` into the file"
                )))
            }
        }
    }
}

/// An option that none of the methods has is not ignored.
pub(crate) fn not_theirs(option: &str, methods: &[Method]) -> Failure {
    let names = methods.iter().map(Method::name).collect::<Vec<_>>().join(" or ");
    Failure::usage(format_args!("{option} is no option of the method {names}\n  remedy: leave it out, or choose another --method"))
}

/// Candidates joined by plus signs, as in first+second, or all.
pub(crate) fn candidates(text: &str) -> Result<CandidateSet, String> {
    if text == "all" {
        return Ok(CandidateSet::ALL);
    }
    let names: Vec<_> = text.split('+').map(|name| name.trim().to_ascii_lowercase()).collect();
    let are_known = names.iter().all(|name| CandidateSet::NAMES.contains(&name.as_str()));
    are_known.then(|| CandidateSet::of_names(&names)).ok_or_else(|| "it must be all, or look like first+second, of first, second and third".to_owned())
}
