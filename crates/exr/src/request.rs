//! Which files and layers to read.

use std::path::{Path, PathBuf};

#[cfg(feature = "programs")]
use clap::builder::{OsStringValueParser, TypedValueParser};
use serde::{Deserialize, Serialize};

use crate::along::{AlphaEncoding, Aovs};
use crate::layer_ref::LayerRef;
#[cfg(feature = "programs")]
use crate::layer_ref::feature;
use crate::picture_file::PngEncoding;

/// Which files and layers to read. All fields except the input, its layer and `payload_halves` are options of programs
/// by their names, such as `--half-a FILE::LAYER`.
///
/// The halves and the variance of a feature of another file are read from that file: from `LAYER_halfA` and so on, or
/// from plain `halfA`, `halfB`, `variance` if the feature is the file's main layer.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "programs", derive(clap::Args), command(next_help_heading = "Layers"))]
#[serde(default)]
pub struct BufferSetRequest {
    /// The file with the noisy colour; halves, variance and features are looked for in it unless they are named below.
    #[cfg_attr(feature = "programs", arg(skip))]
    pub input: PathBuf,
    /// The colour's layer; `None` takes the picture that the layout says, or all of them if the file holds several.
    #[cfg_attr(feature = "programs", arg(skip))]
    pub layer: Option<String>,
    /// Colour of the first half of the samples
    #[cfg_attr(feature = "programs", arg(long, value_name = "FILE[::LAYER]"))]
    pub half_a: Option<LayerRef>,
    /// Colour of the other half of the samples
    #[cfg_attr(feature = "programs", arg(long, value_name = "FILE[::LAYER]"))]
    pub half_b: Option<LayerRef>,
    /// Variance of the colour's mean (of the pixel, not of one sample)
    #[cfg_attr(feature = "programs", arg(long, value_name = "FILE[::LAYER]"))]
    pub variance: Option<LayerRef>,
    /// A feature under another name or from another file, such as albedo=aux.exr::albedo; its halves and variance are
    /// taken from the same file; may be repeated
    #[cfg_attr(
        feature = "programs",
        arg(long = "feature", value_name = "NAME=FILE[::LAYER]", value_parser = of_feature())
    )]
    pub features: Vec<(String, LayerRef)>,
    /// A feature of the input to leave out: by its whole name, or by the last part of it in all view layers; may be
    /// repeated
    #[cfg_attr(feature = "programs", arg(long = "skip-feature", value_name = "NAME"))]
    pub skip_features: Vec<String>,
    /// Use no features of the input but those in `features`.
    #[cfg_attr(feature = "programs", arg(long, help = "Use no features of the input but those given with --feature"))]
    pub no_features: bool,
    /// Half A of a feature from another file; may be repeated
    #[cfg_attr(feature = "programs", arg(long, value_name = "NAME=FILE[::LAYER]", value_parser = of_feature()))]
    pub feature_half_a: Vec<(String, LayerRef)>,
    /// Half B of a feature from another file; may be repeated
    #[cfg_attr(feature = "programs", arg(long, value_name = "NAME=FILE[::LAYER]", value_parser = of_feature()))]
    pub feature_half_b: Vec<(String, LayerRef)>,
    /// Variance of the mean of a feature from another file; may be repeated
    #[cfg_attr(feature = "programs", arg(long, value_name = "NAME=FILE[::LAYER]", value_parser = of_feature()))]
    pub feature_variance: Vec<(String, LayerRef)>,
    /// Layers to denoise along with the colour, by the colour's own weights: `all` colours of the file that guide
    /// nothing, `none`, or a list of names such as key,fill_*: whole names, or the last part of them in all view
    /// layers. Numbers of objects stay as they are [default: lights, the layers that the layout knows as parts of the
    /// light]
    #[cfg_attr(
        feature = "programs",
        arg(long, value_name = "all|none|LIST", default_value_t = Aovs::Lights, hide_default_value = true)
    )]
    pub aovs: Aovs,
    /// Leave alpha as it is, or as the mean of the seeds; without this option it is denoised along with the colour
    #[cfg_attr(feature = "programs", arg(long))]
    pub no_alpha: bool,
    /// Whether the colours of the input are multiplied by their alpha [default: as the layout says, or premultiplied]
    #[cfg_attr(feature = "programs", arg(long, value_enum, value_name = "straight|premultiplied"))]
    pub alpha: Option<AlphaEncoding>,
    /// Whether frames get the halves of the layers that are denoised along, which NLM alone uses.
    #[cfg_attr(feature = "programs", arg(skip))]
    pub payload_halves: bool,
    /// Another render of the same frame with another seed, to be merged with the input; may be repeated
    #[cfg_attr(feature = "programs", arg(id = "seed", long, value_name = "FILE"))]
    pub seeds: Vec<PathBuf>,
    /// Samples per pixel of the input, or of each seed [default: as the file says]
    #[cfg_attr(
        feature = "programs",
        arg(long, value_name = "N", value_parser = samples)
    )]
    pub samples: Option<u32>,
    /// Layout of the input: a name that `stein layouts` lists, or a TOML file [default: as the file shows]
    #[cfg_attr(feature = "programs", arg(long, value_name = "NAME|FILE"))]
    pub layout: Option<String>,
    /// Meaning of the values in PNG files that are read and written
    #[cfg_attr(feature = "programs", arg(long, value_enum, value_name = "CURVE", default_value_t = PngEncoding::Srgb))]
    pub png_encoding: PngEncoding,
    /// Use no files beside the input but those that are named.
    #[cfg_attr(
        feature = "programs",
        arg(
            long,
            help = "Use no files beside the input, such as albedo.exr beside color.exr, but those that are named"
        )
    )]
    pub no_siblings: bool,
}

/// Returns a parser of a feature's name and a layer.
#[cfg(feature = "programs")]
fn of_feature() -> impl TypedValueParser<Value = (String, LayerRef)> {
    OsStringValueParser::new().try_map(feature)
}

/// Parses a number of samples.
#[cfg(feature = "programs")]
fn samples(text: &str) -> Result<u32, String> {
    text.parse().ok().filter(|count| *count > 0).ok_or_else(|| "it must be a whole number above 0".into())
}

impl BufferSetRequest {
    fn of_features(&self) -> [&Vec<(String, LayerRef)>; 4] {
        [&self.features, &self.feature_half_a, &self.feature_half_b, &self.feature_variance]
    }

    /// Returns all files that are named, the input first; a file that is named twice is listed twice.
    pub fn files(&self) -> impl Iterator<Item = &Path> {
        let named = [&self.half_a, &self.half_b, &self.variance]
            .into_iter()
            .flatten()
            .chain(self.of_features().into_iter().flatten().map(|(_, layer)| layer));
        let inputs = std::iter::once(&self.input).chain(&self.seeds).map(PathBuf::as_path);
        inputs.chain(named.map(|layer| layer.file.as_path()))
    }

    /// Returns the same layers of other files, such as the files of another frame of a shot.
    #[must_use]
    pub fn map_files(&self, file: impl Fn(&Path) -> PathBuf) -> Self {
        let seeds = self.seeds.iter().map(|seed| file(seed)).collect();
        Self { input: file(&self.input), seeds, ..self.map_others(|layer| layer.map_file(&file)) }
    }

    /// Takes the whole texts as the paths of the files, see [`LayerRef::literal`]. The input and its layer stay.
    #[must_use]
    pub fn literal(&self) -> Self {
        self.map_others(|layer| layer.clone().literal())
    }

    /// Replaces each reference to a file beside the input.
    fn map_others(&self, other: impl Fn(&LayerRef) -> LayerRef) -> Self {
        let named = |layers: &Vec<(String, LayerRef)>| {
            layers.iter().map(|(name, layer)| (name.clone(), other(layer))).collect::<Vec<_>>()
        };
        let [features, feature_half_a, feature_half_b, feature_variance] = self.of_features().map(named);
        let [half_a, half_b, variance] =
            [&self.half_a, &self.half_b, &self.variance].map(|layer| layer.as_ref().map(&other));
        Self { half_a, half_b, variance, features, feature_half_a, feature_half_b, feature_variance, ..self.clone() }
    }
}
