//! How a user points at a layer, and how the program says what it took a layer for.

use std::convert::Infallible;
use std::ffi::OsString;
use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// A file and, optionally, a layer inside it, written `file.exr` or `file.exr::layer`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LayerRef {
    /// The file.
    pub file: PathBuf,
    /// The layer, named as in the file; `None` leaves the choice to the reader.
    pub layer: Option<String>,
}

impl LayerRef {
    /// A file of which the reader chooses the layer.
    pub fn whole(file: impl Into<PathBuf>) -> Self {
        Self { file: file.into(), layer: None }
    }

    /// The same layer of another file.
    #[must_use]
    pub fn map_file(&self, file: impl FnOnce(&Path) -> PathBuf) -> Self {
        Self { file: file(&self.file), layer: self.layer.clone() }
    }
}

impl FromStr for LayerRef {
    type Err = Infallible;

    /// Splits at the last `::`. Any text is a valid reference; whether the file exists shows when it is read.
    fn from_str(text: &str) -> Result<Self, Infallible> {
        Ok(match text.rsplit_once("::") {
            Some((file, layer)) if !file.is_empty() && !layer.is_empty() => Self { file: file.into(), layer: Some(layer.to_owned()) },
            _ => Self::whole(text),
        })
    }
}

impl From<OsString> for LayerRef {
    /// As the text; one that is not Unicode names a file alone.
    fn from(text: OsString) -> Self {
        text.into_string().map_or_else(Self::whole, |text| {
            let Ok(layer) = text.parse();
            layer
        })
    }
}

impl fmt::Display for LayerRef {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.file.display())?;
        self.layer.as_ref().map_or(Ok(()), |layer| write!(f, "::{layer}"))
    }
}

/// A feature's name and where it is, written `NAME=FILE` or `NAME=FILE::LAYER`.
pub(super) fn feature(text: &str) -> Result<(String, LayerRef), String> {
    match text.split_once('=') {
        Some((name, layer)) if !name.is_empty() && !layer.is_empty() => {
            let Ok(layer) = layer.parse();
            Ok((name.to_owned(), layer))
        }
        _ => Err("it must look like NAME=FILE or NAME=FILE::LAYER, as in albedo=aux.exr".into()),
    }
}

/// Which of a signal's images a layer holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum SignalPart {
    /// The mean of all samples.
    Mean,
    /// The mean of the first half of the samples.
    HalfA,
    /// The mean of the other half.
    HalfB,
    /// The sample variance of the mean, s²/n.
    Variance,
}

/// What a layer is used as.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub enum Role {
    /// The noisy colour: what will be denoised.
    Color,
    /// The colour of the first half of the samples.
    HalfA,
    /// The colour of the other half.
    HalfB,
    /// The sample variance of the colour's mean.
    Variance,
    /// A feature's mean, half or variance; the name is the feature's.
    Feature(String, SignalPart),
    /// Samples per pixel.
    Samples,
    /// Not used; an output keeps it as it is.
    Untouched,
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Color => f.write_str("colour"),
            Self::HalfA => f.write_str("half A"),
            Self::HalfB => f.write_str("half B"),
            Self::Variance => f.write_str("variance"),
            Self::Feature(name, SignalPart::Mean) => write!(f, "feature {name}"),
            Self::Feature(name, SignalPart::HalfA) => write!(f, "feature {name}, half A"),
            Self::Feature(name, SignalPart::HalfB) => write!(f, "feature {name}, half B"),
            Self::Feature(name, SignalPart::Variance) => write!(f, "feature {name}, variance"),
            Self::Samples => f.write_str("samples per pixel"),
            Self::Untouched => f.write_str("not used"),
        }
    }
}

/// How a channel's samples are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum SampleKind {
    /// 16-bit float.
    Half,
    /// 32-bit float.
    Float,
    /// 32-bit unsigned integer.
    Uint,
    /// Not the same for all channels of the layer.
    Mixed,
}

impl fmt::Display for SampleKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Half => "half",
            Self::Float => "float",
            Self::Uint => "uint",
            Self::Mixed => "mixed",
        })
    }
}

/// One layer of one file, and what it is used as.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LayerUse {
    /// The file that holds the layer.
    pub file: PathBuf,
    /// The layer, named as in the file; empty for channels without a layer name, such as plain `R G B`.
    pub layer: String,
    /// The channels' names without the layer's, in the order red, green, blue or x, y, z.
    pub channels: Vec<String>,
    /// How the samples are stored.
    pub sample_kind: SampleKind,
    /// What the layer is used as.
    pub role: Role,
    /// NaN and infinite values in the file.
    pub non_finite_values: usize,
    /// Why a layer that looks useful is not used, or what is remarkable about its use.
    pub note: Option<String>,
}

impl fmt::Display for LayerUse {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = if self.layer.is_empty() { "(no layer name)" } else { &self.layer };
        write!(f, "{name} [{}] {}: {}", self.channels.join(" "), self.sample_kind, self.role)?;
        if self.non_finite_values > 0 {
            write!(f, ", {} values not finite", self.non_finite_values)?;
        }
        self.note.as_ref().map_or(Ok(()), |note| write!(f, " ({note})"))
    }
}
