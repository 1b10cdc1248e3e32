//! How a user names a layer, and how the program reports the use of a layer.

use std::convert::Infallible;
use std::ffi::{OsStr, OsString};
use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::layout::{Quantity, Unit};
use stein::text;

/// A file and, optionally, a layer inside it, written `file.exr` or `file.exr::layer`.
///
/// Names of files and layers may hold `::` too. So the existing files decide where a text is split: see
/// [`LayerRef::from`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LayerRef {
    /// Path of the file.
    pub file: PathBuf,
    /// Name of the layer, as in the file; `None` leaves the choice to the reader.
    pub layer: Option<String>,
}

/// Whether both paths lead to the same file, however they are spelt.
pub fn same_file(a: &Path, b: &Path) -> bool {
    let canonical = |path: &Path| -> Option<PathBuf> { path.canonicalize().ok() };
    a == b || canonical(a).is_some_and(|a| canonical(b) == Some(a))
}

/// Separator between a file and its layer.
const SEPARATOR: &str = "::";

impl LayerRef {
    /// Returns a reference to a file whose layer the reader chooses.
    pub fn whole(file: impl Into<PathBuf>) -> Self {
        Self { file: file.into(), layer: None }
    }

    /// Returns a reference whose whole text is the path of the file: the part that was taken for a layer belongs to the
    /// name.
    #[must_use]
    pub fn literal(self) -> Self {
        let Some(layer) = self.layer else { return self };
        let mut file = self.file.into_os_string();
        file.push(SEPARATOR);
        file.push(layer);
        Self::whole(file)
    }

    /// Returns a reference to the same layer of another file.
    #[must_use]
    pub fn map_file(&self, file: impl FnOnce(&Path) -> PathBuf) -> Self {
        Self { file: file(&self.file), layer: self.layer.clone() }
    }
}

impl FromStr for LayerRef {
    type Err = Infallible;

    /// Converts a text as [`LayerRef::from`] does.
    fn from_str(text: &str) -> Result<Self, Infallible> {
        Ok(OsString::from(text).into())
    }
}

impl From<OsString> for LayerRef {
    /// Converts a text. If the text is the path of something that exists, it names that file. Otherwise it is split at
    /// a `::`: at the last one behind a file that exists, else at the last one behind a name that ends in `.exr`, such
    /// as the name of a pattern, else at the last one of all. Any text is a reference; reading it shows whether the
    /// file exists.
    fn from(text: OsString) -> Self {
        if Path::new(&text).exists() {
            return Self::whole(text);
        }
        let is_exr = |file: &Path| file.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("exr"));
        let mut splits = splits(&text);
        // A layer with a path separator comes from a folder with `::` in its name that does not hold the file.
        let is_path = |layer: &str| layer.contains(std::path::is_separator);
        let chosen = splits.iter().position(|(file, _)| file.is_file());
        let chosen = chosen.or_else(|| splits.iter().position(|(file, _)| is_exr(file)));
        let chosen = chosen.or_else(|| splits.first().filter(|(_, layer)| !is_path(layer)).map(|_| 0));
        match chosen {
            Some(chosen) => {
                let (file, layer) = splits.swap_remove(chosen);
                Self { file, layer: Some(layer) }
            }
            None => Self::whole(text),
        }
    }
}

/// Returns a file and a layer for each `::` with text on both sides, from the last one on. The file need not be
/// Unicode.
fn splits(text: &OsStr) -> Vec<(PathBuf, String)> {
    let places = text
        .as_encoded_bytes()
        .windows(SEPARATOR.len())
        .enumerate()
        .filter(|(_, found)| *found == SEPARATOR.as_bytes());
    let mut splits: Vec<_> = places.filter_map(|(at, _)| parted(text, at, SEPARATOR.len())).collect();
    splits.retain(|(file, layer)| !file.is_empty() && !layer.is_empty());
    let named = |(file, layer): (OsString, OsString)| Some((file.into(), layer.into_string().ok()?));
    splits.into_iter().rev().filter_map(named).collect()
}

/// Returns the texts before and behind a separator.
fn parted(text: &OsStr, at: usize, length: usize) -> Option<(OsString, OsString)> {
    #[cfg(unix)]
    {
        use std::os::unix::ffi::OsStrExt;
        let (before, behind) = (&text.as_bytes()[..at], &text.as_bytes()[at + length..]);
        Some((OsStr::from_bytes(before).to_owned(), OsStr::from_bytes(behind).to_owned()))
    }
    #[cfg(not(unix))]
    {
        let text = text.to_str()?;
        Some((text[..at].into(), text[at + length..].into()))
    }
}

impl fmt::Display for LayerRef {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&text::path(&self.file))?;
        self.layer.as_ref().map_or(Ok(()), |layer| write!(f, "{SEPARATOR}{}", text::name(layer)))
    }
}

/// Parses a feature's name and location, written `NAME=FILE` or `NAME=FILE::LAYER`. The file's name may hold `=` as
/// well.
#[cfg(feature = "programs")]
pub(crate) fn feature(text: OsString) -> Result<(String, LayerRef), String> {
    let first = text.as_encoded_bytes().iter().position(|byte| *byte == b'=');
    let named = first.and_then(|at| {
        let (name, file) = parted(&text, at, 1)?;
        Some((name.into_string().ok()?, file))
    });
    match named {
        Some((name, file)) if !name.is_empty() && !file.is_empty() => Ok((name, file.into())),
        _ => Err("it must look like NAME=FILE or NAME=FILE::LAYER, as in albedo=aux.exr".into()),
    }
}

/// Kind of a signal's image that a layer holds.
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

/// Use of a layer.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub enum Role {
    /// The noisy colour, which will be denoised.
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
    /// Opacity.
    Alpha,
    /// A part of the colour, such as the light of one lamp, or another layer that is denoised along with the colour on
    /// request.
    Light,
    /// Numbers of objects; an output keeps them as they are.
    Id,
    /// A picture that the renderer has denoised; an output keeps it as it is.
    Denoised,
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
            Self::Feature(name, part) => {
                let part = match part {
                    SignalPart::Mean => "",
                    SignalPart::HalfA => ", half A",
                    SignalPart::HalfB => ", half B",
                    SignalPart::Variance => ", variance",
                };
                write!(f, "feature {}{part}", text::name(name))
            }
            Self::Samples => f.write_str("samples per pixel"),
            Self::Alpha => f.write_str("alpha"),
            Self::Light => f.write_str("light"),
            Self::Id => f.write_str("id"),
            Self::Denoised => f.write_str("denoised by the renderer"),
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
    /// Different kinds among the channels of the layer.
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

/// One layer of one file, and its use.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LayerUse {
    /// Path of the file that holds the layer.
    #[serde(serialize_with = "text::serialize_path")]
    pub file: PathBuf,
    /// Name of the layer, as in the file; empty for channels without a layer name, such as plain `R G B`.
    pub layer: String,
    /// Names of the channels without the layer's name, in the order red, green, blue or x, y, z.
    pub channels: Vec<String>,
    /// Kind of the stored samples.
    pub sample_kind: SampleKind,
    /// Use of the layer.
    pub role: Role,
    /// Index of the picture that the layer belongs to; `None` for layers that are not used, or belong to all pictures.
    /// The noise of layers that are denoised along, which an output leaves out, belongs to their picture.
    pub picture: Option<usize>,
    /// Whether the layer, a light or an alpha, is denoised along with the colour. An output keeps other lights and
    /// alphas as they are. The alpha of the colour's own layer is in
    /// [`BufferSet::payload`](crate::BufferSet::payload) alone.
    pub is_along: bool,
    /// Quantity of a variance that is converted: a variance of one sample or a second moment; of a layer that is not
    /// used, if it is easily mistaken for a variance.
    pub quantity: Option<Quantity>,
    /// Unit of the layer, if it is a remarkable one.
    pub unit: Option<Unit>,
    /// Number of NaN and infinite values in the file's layer.
    pub non_finite_values: usize,
    /// Reason why a layer that looks useful is not used, or a remark on its use.
    pub note: Option<String>,
}

impl fmt::Display for LayerUse {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = if self.layer.is_empty() { "(no layer name)" } else { &text::name(&self.layer) };
        let channels = self.channels.join(" ");
        write!(f, "{name} [{}] {}: {}", text::name(&channels), self.sample_kind, self.role)?;
        // The note says why something is not a variance.
        if let Some(quantity) = self.quantity.filter(|quantity| *quantity != Quantity::NotAVariance) {
            write!(f, ", a {quantity}")?;
        }
        if self.is_along {
            f.write_str(", denoised along")?;
        }
        if self.non_finite_values > 0 {
            write!(f, ", {} values not finite", self.non_finite_values)?;
        }
        self.note.as_ref().map_or(Ok(()), |note| write!(f, " ({note})"))
    }
}
