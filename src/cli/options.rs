//! Options that several subcommands share.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use clap::ValueEnum;
use stein::buffers::{BufferSet, BufferSetRequest, LayerRef};
use stein::gpu::{DeviceChoice, GpuOptions};
use stein::method::Spikes;
use stein::method::nlm::NlmVariance;
use stein::stage::candidate_set::CandidateSet;
use stein::stage::nlm::{Symmetry, Weighting};
use stein::{Denoiser, DfcParams, Extent, GemParams, Gpu, Method, NlmParams, Preset};

use super::Failure;

/// How to filter.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Filter")]
pub(crate) struct Filter {
    /// Parameters
    #[arg(long, value_enum, default_value = "default")]
    preset: PresetName,
    #[command(flatten)]
    choice: Choice,
}

impl Filter {
    /// The named set that was chosen.
    pub(crate) fn preset(&self) -> Preset {
        self.preset.preset()
    }

    /// Whether it is said what becomes of spikes.
    pub(crate) fn sets_spikes(&self) -> bool {
        self.choice.tuning.spikes.is_some()
    }

    /// The method, with the parameters that were asked for.
    pub(crate) fn method(&self) -> Result<Method, Failure> {
        self.choice.method(self.preset)
    }
}

/// The method and what may be set of it.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Filter")]
struct Choice {
    /// Method
    #[arg(long, value_enum, default_value = "dfc")]
    method: MethodName,
    /// Of dfc and nlm: radius of the window that is averaged over, in pixels [default: 10]
    #[arg(long, value_name = "PIXELS")]
    radius: Option<u32>,
    /// Of dfc: which candidates take part; the others are not computed [default: first,second,third]
    #[arg(long, value_enum, value_name = "NAME", value_delimiter = ',')]
    candidates: Vec<CandidateName>,
    #[command(flatten)]
    tuning: Tuning,
}

/// What may be set of every method, and of one alone.
#[derive(Clone, Debug, PartialEq, clap::Args)]
#[command(next_help_heading = "Filter")]
pub(crate) struct Tuning {
    /// What becomes of spikes: pixels that stand out from those of their kind and rest on very few samples [default: spread; of the preset thesis: keep]
    #[arg(long, value_enum, value_name = "RULE")]
    spikes: Option<SpikesName>,
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
    #[arg(long, value_enum, value_name = "RULE")]
    symmetric: Option<SymmetryName>,
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

impl Choice {
    /// The method with the parameters of a preset, but for those that were set. Options that it does not have are not ignored.
    fn method(&self, preset: PresetName) -> Result<Method, Failure> {
        if self.radius.is_some() && !self.method.has_radius() {
            return Err(not_theirs("--radius", &[self.method]));
        }
        if !self.candidates.is_empty() && !self.method.has_candidates() {
            return Err(not_theirs("--candidates", &[self.method]));
        }
        self.tuning.check(&[self.method])?;
        let candidates = CandidateName::set(&self.candidates);
        self.tuning.method(self.method, preset, Choices { radius: self.radius, candidates })
    }
}

/// What may be set of several methods, or of which `stein bench` measures several; `None` is the preset's own.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Choices {
    pub(crate) radius: Option<u32>,
    pub(crate) candidates: Option<CandidateSet>,
}

impl Tuning {
    /// Refuses options that none of the methods has.
    pub(crate) fn check(&self, methods: &[MethodName]) -> Result<(), Failure> {
        let of_gem = [("--gamma", self.gamma.is_some())];
        for (owner, options) in [(MethodName::Gem, &of_gem[..]), (MethodName::Nlm, &self.nlm.given()[..])] {
            let given = options.iter().find(|(_, is_given)| *is_given);
            if let (Some((option, _)), false) = (given, methods.contains(&owner)) {
                return Err(not_theirs(option, methods));
            }
        }
        Ok(())
    }

    /// A method with the parameters of a preset, but for those that were set.
    pub(crate) fn method(&self, method: MethodName, preset: PresetName, Choices { radius, candidates }: Choices) -> Result<Method, Failure> {
        let method = match method {
            MethodName::Dfc => {
                let params = preset.choose(DfcParams::default, DfcParams::thesis);
                Method::from(DfcParams { window_radius: radius.unwrap_or(params.window_radius), candidates: candidates.unwrap_or(params.candidates), ..params })
            }
            MethodName::Gem => {
                let params = preset.choose(GemParams::default, GemParams::thesis);
                Method::from(GemParams { gamma: self.gamma.unwrap_or(params.gamma), ..params })
            }
            MethodName::Nlm => {
                let params = preset.choose(NlmParams::default, NlmParams::thesis);
                Method::from(self.nlm.applied_to(NlmParams { window_radius: radius.unwrap_or(params.window_radius), ..params }))
            }
        };
        let method = self.spikes.map_or(method, |spikes| method.with_spikes(spikes.rule()));
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
        let symmetric = self.symmetric.map_or(params.weighting.symmetric, SymmetryName::rule);
        NlmParams {
            patch_radius: self.patch_radius.unwrap_or(params.patch_radius),
            k: self.k.unwrap_or(params.k),
            alpha: self.alpha.unwrap_or(params.alpha),
            weighting: Weighting { symmetric, ..params.weighting },
            cut: self.cut.unwrap_or(params.cut),
            patchwise: params.patchwise && !self.pixelwise,
            dual_buffer: params.dual_buffer && !self.single_buffer,
            variance: if self.uniform_variance { NlmVariance::Uniform } else { params.variance },
            ..params
        }
    }
}

/// The methods, as [`Method`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum MethodName {
    /// Combined colour and feature filters
    Dfc,
    /// Greedy error minimisation over Gaussian scales; needs no features
    Gem,
    /// Non-local means, each half of the samples filtered with the weights of the other; needs no features
    Nlm,
}

impl MethodName {
    /// As on the command line.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Dfc => "dfc",
            Self::Gem => "gem",
            Self::Nlm => "nlm",
        }
    }

    /// Whether it has a window whose radius can be set.
    pub(crate) fn has_radius(self) -> bool {
        self != Self::Gem
    }

    /// Whether it has candidates of which some can be left out.
    pub(crate) fn has_candidates(self) -> bool {
        self == Self::Dfc
    }

    /// Whether it has a second pass.
    pub(crate) fn has_second_pass(self) -> bool {
        self == Self::Dfc
    }
}

/// An option that none of the methods has is not ignored.
pub(crate) fn not_theirs(option: &str, methods: &[MethodName]) -> Failure {
    let names = methods.iter().map(|method| method.name()).collect::<Vec<_>>().join(" or ");
    Failure::usage(format_args!("{option} is no option of the method {names}\n  remedy: leave it out, or choose another --method"))
}

/// The candidates of DFC, as [`CandidateSet`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum CandidateName {
    /// Small patches: sharp
    First,
    /// Large patches: smooth
    Second,
    /// Features alone
    Third,
}

impl CandidateName {
    /// Those that are named; `None` if none is.
    fn set(names: &[Self]) -> Option<CandidateSet> {
        let [first, second, third] = [Self::First, Self::Second, Self::Third].map(|name| names.contains(&name));
        (!names.is_empty()).then_some(CandidateSet { first, second, third })
    }
}

/// Candidates joined by plus signs, as in first+second, or all.
pub(crate) fn candidates(text: &str) -> Result<CandidateSet, String> {
    if text == "all" {
        return Ok(CandidateSet::ALL);
    }
    let names = text.split('+').map(|name| CandidateName::from_str(name.trim(), true)).collect::<Result<Vec<_>, _>>();
    names.ok().and_then(|names| CandidateName::set(&names)).ok_or_else(|| "it must be all, or look like first+second, of first, second and third".to_owned())
}

/// As [`Spikes`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum SpikesName {
    /// They are filtered like everything else
    Keep,
    /// What stands out goes to the pixels around, as far as that is likely
    Spread,
    /// What stands out is cut off
    Clamp,
}

impl SpikesName {
    fn rule(self) -> Spikes {
        match self {
            Self::Keep => Spikes::Keep,
            Self::Spread => Spikes::Spread,
            Self::Clamp => Spikes::Clamp,
        }
    }
}

/// As [`Symmetry`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum SymmetryName {
    /// Each neighbour stands for itself
    Off,
    /// By degrees
    Blended,
    /// Wherever its weight exceeds the sum of theirs
    Hard,
}

impl SymmetryName {
    fn rule(self) -> Symmetry {
        match self {
            Self::Off => Symmetry::Off,
            Self::Blended => Symmetry::Blended,
            Self::Hard => Symmetry::Hard,
        }
    }
}

/// Where colour, noise and features are found.
#[derive(Clone, Debug, PartialEq, clap::Args)]
#[command(next_help_heading = "Layers")]
pub(crate) struct Source {
    /// Layer with the noisy colour [default: plain R G B, or one with a usual name such as `Combined` or `beauty`]
    #[arg(long, value_name = "NAME")]
    layer: Option<String>,
    /// Colour of the first half of the samples
    #[arg(long, value_name = "FILE[::LAYER]")]
    half_a: Option<LayerRef>,
    /// Colour of the other half of the samples
    #[arg(long, value_name = "FILE[::LAYER]")]
    half_b: Option<LayerRef>,
    /// Variance of the colour's mean (of the pixel, not of one sample)
    #[arg(long, value_name = "FILE[::LAYER]")]
    variance: Option<LayerRef>,
    /// A feature under another name or from another file, with its halves and variance beside it; may be repeated
    #[arg(long = "feature", value_name = "NAME=FILE[::LAYER]", value_parser = feature)]
    features: Vec<(String, LayerRef)>,
    /// A feature of the input that is not to be used; may be repeated
    #[arg(long = "skip-feature", value_name = "NAME")]
    skip_features: Vec<String>,
    /// Use no features of the input but those given with --feature
    #[arg(long)]
    no_features: bool,
}

impl Source {
    /// Reads an input with everything that was named beside it.
    pub(crate) fn read(&self, input: &Path) -> Result<BufferSet, Failure> {
        let request = BufferSetRequest {
            input: input.to_owned(),
            layer: self.layer.clone(),
            half_a: self.half_a.clone(),
            half_b: self.half_b.clone(),
            variance: self.variance.clone(),
            features: self.features.clone(),
            no_features: self.no_features,
            skip_features: self.skip_features.clone(),
        };
        let set = BufferSet::read(&request).map_err(|error| Failure::in_file(input, error))?;
        for skipped in &self.skip_features {
            let known = |layer: &str| layer == skipped || layer.ends_with(&format!(".{skipped}"));
            if !set.layer_uses().iter().any(|layer| known(&layer.layer)) {
                return Err(Failure::input(format_args!(
                    "{}: there is no feature '{skipped}' to skip\n  remedy: `stein info` lists the layers",
                    input.display()
                )));
            }
        }
        Ok(set)
    }

    /// The same with other files, as of another frame of a shot.
    pub(crate) fn map_files(&self, file: impl Fn(&LayerRef) -> LayerRef) -> Self {
        let features = self.features.iter().map(|(name, layer)| (name.clone(), file(layer))).collect();
        let [half_a, half_b, variance] = [&self.half_a, &self.half_b, &self.variance].map(|layer| layer.as_ref().map(&file));
        Self { half_a, half_b, variance, features, ..self.clone() }
    }

    /// Options that the method has no use for are not ignored.
    pub(crate) fn check(&self, method: &Method) -> Result<(), Failure> {
        let given = self.features.first().map(|(feature, _)| format!("--feature {feature}"));
        let given = given.or_else(|| self.skip_features.first().map(|feature| format!("--skip-feature {feature}")));
        match given.filter(|_| !method.uses_features()) {
            Some(option) => {
                let name = method.name();
                Err(Failure::usage(format_args!("{option}: {name} uses no features\n  remedy: leave it out, or choose another --method")))
            }
            None => Ok(()),
        }
    }

    /// What the method reads: features that it does not use are not told of as used.
    pub(crate) fn for_method(&self, method: &Method) -> Self {
        Self { no_features: self.no_features || !method.uses_features(), ..self.clone() }
    }

    /// Files besides the input, none of which an output may replace.
    pub(crate) fn files(&self) -> impl Iterator<Item = &Path> {
        let named = [&self.half_a, &self.half_b, &self.variance].into_iter().flatten();
        named.chain(self.features.iter().map(|(_, layer)| layer)).map(|layer| layer.file.as_path())
    }
}

fn feature(text: &str) -> Result<(String, LayerRef), String> {
    match text.split_once('=') {
        Some((name, layer)) if !name.is_empty() && !layer.is_empty() => {
            let Ok(layer) = layer.parse();
            Ok((name.to_owned(), layer))
        }
        _ => Err("it must look like NAME=FILE or NAME=FILE::LAYER, as in albedo=aux.exr".into()),
    }
}

/// Names the folder in which compiled pipelines are kept.
pub(crate) const CACHE_VARIABLE: &str = "STEIN_CACHE";

/// Which device works, and with how much of its memory.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Device")]
pub(crate) struct Device {
    /// Adapter, by its index or a part of its name [default: the fastest kind]
    #[arg(long, value_name = "NAME|INDEX")]
    device: Option<DeviceChoice>,
    /// List the adapters, as `stein devices`, and do nothing else
    #[arg(long)]
    pub(crate) list_devices: bool,
    /// Most memory to use on the device, such as 2G, 512M or a number of bytes; larger images are worked on in strips, with the same result
    #[arg(long, value_name = "SIZE", value_parser = memory_size)]
    pub(crate) max_memory: Option<u64>,
}

impl Device {
    pub(crate) fn open(&self) -> Result<Gpu, Failure> {
        let options = GpuOptions { pipeline_folder: pipeline_folder(std::env::var_os(CACHE_VARIABLE), dirs::cache_dir()), ..GpuOptions::default() };
        Ok(Gpu::open_with(self.device.as_ref().unwrap_or(&DeviceChoice::Auto), options)?)
    }

    pub(crate) fn denoiser(&self, gpu: &Gpu, method: Method) -> Result<Denoiser, Failure> {
        let denoiser = Denoiser::new(gpu, method).map_err(Failure::usage)?;
        Ok(match self.max_memory {
            Some(bytes) => denoiser.with_max_memory(bytes),
            None => denoiser,
        })
    }
}

/// The folder that is asked for, or one among the user's other caches. None where that is asked for, or where no user has any.
fn pipeline_folder(asked_for: Option<OsString>, caches: Option<PathBuf>) -> Option<PathBuf> {
    match asked_for {
        Some(folder) => (!folder.is_empty()).then(|| folder.into()),
        None => caches.map(|caches| caches.join("stein")),
    }
}

/// A number of bytes with K, M, G or T (of 1024), which B or iB may follow.
fn memory_size(text: &str) -> Result<u64, String> {
    let wrong = || "it must be a positive number of bytes, or one with K, M, G or T, as in 512M or 1.5GiB".to_owned();
    let text = text.trim();
    let digits = text.find(|character: char| !character.is_ascii_digit() && character != '.').unwrap_or(text.len());
    let (number, unit) = text.split_at(digits);
    let power = match unit.trim().to_ascii_lowercase().as_str() {
        "" | "b" => 0,
        "k" | "kb" | "kib" => 1,
        "m" | "mb" | "mib" => 2,
        "g" | "gb" | "gib" => 3,
        "t" | "tb" | "tib" => 4,
        _ => return Err(wrong()),
    };
    let number: f64 = number.parse().map_err(|_| wrong())?;
    let bytes = number * 1024.0_f64.powi(power);
    if bytes >= 1.0 { Ok(bytes as u64) } else { Err(wrong()) }
}

/// Named parameter sets, as [`Preset`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum PresetName {
    /// What measured best
    Default,
    /// The published algorithm to the letter
    Thesis,
}

impl PresetName {
    /// A method's parameters of this name.
    fn choose<P>(self, default: fn() -> P, thesis: fn() -> P) -> P {
        match self {
            Self::Default => default(),
            Self::Thesis => thesis(),
        }
    }

    /// What parameters of this name do about spikes, which is the same of all methods.
    pub(crate) fn spikes(self) -> Spikes {
        self.choose(DfcParams::default, DfcParams::thesis).spikes
    }

    pub(crate) fn preset(self) -> Preset {
        match self {
            Self::Default => Preset::Default,
            Self::Thesis => Preset::Thesis,
        }
    }

    /// As on the command line.
    pub(crate) fn name(self) -> &'static str {
        self.choose(|| "default", || "thesis")
    }
}

/// A width and a height, as in 1024x768.
pub(crate) fn size(text: &str) -> Result<Extent, String> {
    let sides = text.split_once(['x', 'X', '×']).and_then(|(width, height)| Some((width.parse().ok()?, height.parse().ok()?)));
    match sides {
        Some((width @ 1..=65_536, height @ 1..=65_536)) => Ok(Extent { width, height }),
        _ => Err("it must look like 1024x1024".into()),
    }
}

/// The same file, whichever way the paths are spelt.
pub(crate) fn same_file(a: &Path, b: &Path) -> bool {
    let canonical = |path: &Path| -> Option<PathBuf> { path.canonicalize().ok() };
    a == b || canonical(a).is_some_and(|a| canonical(b) == Some(a))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pipelines_are_kept_where_the_user_says() {
        let caches = || Some(PathBuf::from("/caches"));
        assert_eq!(pipeline_folder(None, caches()), Some(PathBuf::from("/caches/stein")));
        assert_eq!(pipeline_folder(Some("/elsewhere".into()), caches()), Some(PathBuf::from("/elsewhere")));
        assert_eq!((pipeline_folder(Some(OsString::new()), caches()), pipeline_folder(None, None)), (None, None));
    }

    #[test]
    fn memory_is_counted_in_powers_of_1024() {
        for (text, bytes) in [("4096", 4096), ("512M", 512 << 20), ("1.5GiB", 3 << 29), ("2 kb", 2048), ("1T", 1 << 40)] {
            assert_eq!(memory_size(text), Ok(bytes), "{text}");
        }
        for text in ["", "G", "-1", "0", "5 bananas", "1.2.3M"] {
            assert!(memory_size(text).is_err(), "{text}");
        }
    }
}
