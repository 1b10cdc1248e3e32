//! Which files and layers to read.

use std::path::{Path, PathBuf};

#[cfg(feature = "programs")]
use clap::builder::{OsStringValueParser, TypedValueParser};
use serde::{Deserialize, Serialize};

use crate::layer_ref::LayerRef;
#[cfg(feature = "programs")]
use crate::layer_ref::feature;

/// Which files and layers to read. All fields except the input and its layer are options of programs by their names,
/// such as `--half-a FILE::LAYER`.
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
    /// The colour's layer; `None` takes `R G B` or a layer with a usual name such as `Combined` or `beauty`.
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
        arg(
            long = "feature",
            value_name = "NAME=FILE[::LAYER]",
            value_parser = OsStringValueParser::new().try_map(feature)
        )
    )]
    pub features: Vec<(String, LayerRef)>,
    /// A feature of the input to leave out: by its whole name, or by the last part of it in all view layers; may be
    /// repeated
    #[cfg_attr(feature = "programs", arg(long = "skip-feature", value_name = "NAME"))]
    pub skip_features: Vec<String>,
    /// Use no features of the input but those in `features`.
    #[cfg_attr(feature = "programs", arg(long, help = "Use no features of the input but those given with --feature"))]
    pub no_features: bool,
}

impl BufferSetRequest {
    /// Returns all files that are read, the input first; a file that is named twice is listed twice.
    pub fn files(&self) -> impl Iterator<Item = &Path> {
        let named = [&self.half_a, &self.half_b, &self.variance]
            .into_iter()
            .flatten()
            .chain(self.features.iter().map(|(_, layer)| layer));
        std::iter::once(self.input.as_path()).chain(named.map(|layer| layer.file.as_path()))
    }

    /// Returns the same layers of other files, such as the files of another frame of a shot.
    #[must_use]
    pub fn map_files(&self, file: impl Fn(&Path) -> PathBuf) -> Self {
        Self { input: file(&self.input), ..self.map_others(|layer| layer.map_file(&file)) }
    }

    /// Takes the whole texts as the paths of the files, see [`LayerRef::literal`]. The input and its layer stay.
    #[must_use]
    pub fn literal(&self) -> Self {
        self.map_others(|layer| layer.clone().literal())
    }

    /// Replaces each reference to a file beside the input.
    fn map_others(&self, other: impl Fn(&LayerRef) -> LayerRef) -> Self {
        let features = self.features.iter().map(|(name, layer)| (name.clone(), other(layer))).collect();
        let [half_a, half_b, variance] =
            [&self.half_a, &self.half_b, &self.variance].map(|layer| layer.as_ref().map(&other));
        Self { half_a, half_b, variance, features, ..self.clone() }
    }
}
