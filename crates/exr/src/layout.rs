//! Layouts: the names that renderers give to the layers of their files, and the meanings of these layers. A layout is a
//! TOML file; `docs/layouts.md` describes the format.

mod pattern;
mod recognise;
mod rule;

use std::fmt;
use std::path::Path;
use std::sync::LazyLock;

use serde::{Deserialize, Serialize, Serializer};

use crate::along::AlphaEncoding;
pub(crate) use pattern::{Breadth, Pattern};
pub(crate) use recognise::{Recognised, recognise};
pub(crate) use rule::Rule;
pub use rule::{Quantity, RoleName, Unit};
use stein::error::{Error, FileCause, Result};

/// The layouts that come with this library: names and TOML documents.
const BUILT_IN: &[(&str, &str)] = include!(concat!(env!("OUT_DIR"), "/layouts.rs"));

/// The layout of files that no other layout recognises.
const FALLBACK: &str = "native";

/// Names and meanings of the layers in a renderer's files.
#[derive(Clone, Debug)]
pub struct Layout {
    name: String,
    title: String,
    document: String,
    recognise: Vec<recognise::Sign>,
    sample_attributes: Vec<String>,
    /// How the colours of the files relate to their alpha.
    pub(crate) alpha: AlphaEncoding,
    pub(crate) joins: Vec<Join>,
    pub(crate) rules: Vec<Rule>,
}

/// Channels without a common name that form one layer, such as `Nx`, `Ny`, `Nz`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Join {
    /// Name of the layer that they form.
    pub(crate) name: String,
    /// Names of the channels, which would be layers of their own.
    pub(crate) channels: Vec<String>,
    /// New names of the channels, one letter each, such as `XYZ`.
    pub(crate) letters: String,
    /// The file beside the input that has them, as in a rule; in any file if there is none.
    pub(crate) file: Option<String>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Document {
    title: String,
    #[serde(default)]
    alpha: AlphaEncoding,
    #[serde(default)]
    recognise: Vec<recognise::SignDocument>,
    #[serde(default)]
    samples: Samples,
    #[serde(default)]
    join: Vec<Join>,
    #[serde(default)]
    layer: Vec<rule::RuleDocument>,
}

#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct Samples {
    attributes: Vec<String>,
}

/// A pattern or a list of patterns.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(untagged)]
enum Texts {
    #[default]
    None,
    One(String),
    Many(Vec<String>),
}

impl Texts {
    fn texts(self) -> Vec<String> {
        match self {
            Self::None => Vec::new(),
            Self::One(text) => vec![text],
            Self::Many(texts) => texts,
        }
    }

    fn patterns(self, is_exact: bool) -> std::result::Result<Vec<Pattern>, String> {
        self.texts().iter().map(|text| Pattern::new(text, is_exact)).collect()
    }
}

impl Layout {
    /// Returns the layouts that come with this library, in the order of their names.
    pub fn built_in() -> &'static [Self] {
        static LAYOUTS: LazyLock<Vec<Layout>> = LazyLock::new(|| {
            // A test reads each of them.
            BUILT_IN.iter().filter_map(|(name, document)| Layout::parse(name, document).ok()).collect()
        });
        &LAYOUTS
    }

    /// Returns the built-in layout of that name, or reads the layout from a TOML file.
    ///
    /// # Errors
    /// [`Error::File`] for a file that cannot be read or is not a layout, and for a name that no built-in layout has.
    pub fn named(name: &str) -> Result<Self> {
        let refuse = |problem: String, remedy: &str| Error::File {
            path: name.into(),
            cause: FileCause::Other { problem, remedy: remedy.to_owned() },
        };
        if let Some(layout) = Self::built_in().iter().find(|layout| layout.name == name) {
            return Ok(layout.clone());
        }
        let path = Path::new(name);
        if !path.is_file() {
            let names: Vec<&str> = BUILT_IN.iter().map(|(name, _)| *name).collect();
            let problem = format!("is neither a layout nor a file; the layouts are {}", names.join(", "));
            return Err(refuse(problem, "choose one of these, or name a TOML file"));
        }
        let document = std::fs::read_to_string(path)
            .map_err(|error| refuse(format!("cannot be read: {error}"), "check the path and its permissions"))?;
        let stem = path.file_stem().map_or_else(String::new, |stem| stem.to_string_lossy().into_owned());
        Self::parse(&stem, &document).map_err(|problem| {
            refuse(
                format!("is no layout: {problem}"),
                "start from a built-in one (`stein layouts --show NAME` prints it)",
            )
        })
    }

    /// Reads a layout from a TOML document. Returns the problem and its place if it is none.
    ///
    /// # Errors
    /// The problem and its place.
    fn parse(name: &str, document: &str) -> std::result::Result<Self, String> {
        let parsed: Document = toml::from_str(document).map_err(|error| error.to_string().trim_end().to_owned())?;
        let rules = parsed.layer.into_iter().map(rule::RuleDocument::rule).collect::<std::result::Result<_, _>>()?;
        if let Some(join) = parsed.join.iter().find(|join| join.channels.len() != join.letters.chars().count()) {
            return Err(format!("join '{}' does not have a letter for each channel", join.name));
        }
        let signs = parsed.recognise.into_iter().map(recognise::SignDocument::sign);
        Ok(Self {
            name: name.to_owned(),
            title: parsed.title,
            document: document.to_owned(),
            recognise: signs.collect::<std::result::Result<_, _>>()?,
            sample_attributes: parsed.samples.attributes,
            alpha: parsed.alpha,
            joins: parsed.join,
            rules,
        })
    }

    /// Returns the name, such as `cycles`.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Returns the name of the renderer and the kind of its files, such as `pbrt-v4 (GBufferFilm)`.
    pub fn title(&self) -> &str {
        &self.title
    }

    /// Returns the TOML document.
    pub fn document(&self) -> &str {
        &self.document
    }

    /// Returns the header attributes that may hold the samples per pixel of the pictures of a group.
    pub(crate) fn sample_attributes(&self, group: &str) -> impl Iterator<Item = String> {
        self.sample_attributes.iter().map(move |name| name.replace("{group}", group))
    }
}

/// Returns the layout that knows the usual names.
pub(crate) fn native() -> &'static Layout {
    let found = Layout::built_in().iter().find(|layout| layout.name == FALLBACK);
    let Some(layout) = found else { unreachable!("a test reads the native layout") };
    layout
}

/// How the layout of a file was found.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct LayoutUse {
    /// Name of the layout, such as `cycles`.
    pub name: String,
    /// Name of the renderer and the kind of its files.
    pub title: String,
    /// How it was recognised.
    pub recognised_by: RecognisedBy,
}

/// How a layout was recognised. Displays, and is serialised, as a phrase.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RecognisedBy {
    /// By attributes, layers or files of these names.
    Signs(String),
    /// The user chose it.
    Request,
    /// Not at all: layers are taken by their usual names.
    UsualNames,
}

impl fmt::Display for RecognisedBy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Signs(signs) => signs,
            Self::Request => "chosen on request",
            Self::UsualNames => "no sign of a renderer: by the usual names of layers",
        })
    }
}

impl Serialize for RecognisedBy {
    fn serialize<S: Serializer>(&self, serializer: S) -> std::result::Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_built_in_layout_can_be_read() {
        for (name, document) in BUILT_IN {
            if let Err(problem) = Layout::parse(name, document) {
                panic!("{name}: {problem}");
            }
        }
        assert!(BUILT_IN.iter().any(|(name, _)| *name == FALLBACK));
    }

    #[test]
    fn a_faulty_layout_is_refused_with_its_place() {
        for (document, why) in [
            ("title = \"x\"\nlayers = 1", "unknown field `layers`"),
            ("", "missing field `title`"),
            ("title = \"x\"\n[[layer]]\nname = \"a\"\nrole = \"colour\"", "unknown variant `colour`"),
            ("title = \"x\"\nalpha = \"none\"", "unknown variant `none`"),
            ("title = \"x\"\n[[layer]]\nname = \"a\"", "has no role"),
            ("title = \"x\"\n[[layer]]\nrole = \"color\"", "has neither name nor file"),
            ("title = \"x\"\n[[layer]]\nname = \"a\"\nrole = \"ignore\"\nquantity = \"not a variance\"", "why"),
            ("title = \"x\"\n[[layer]]\nname = \"{nothing}\"\nrole = \"color\"", "is none of"),
            ("title = \"x\"\n[[layer]]\nname = \"a\"\nrole = \"color\"\nfactor = \"b\"", "is no light"),
            ("title = \"x\"\n[[layer]]\nname = \"a\"\nrole = \"light\"\nfactor = \"{of}b\"", "other than {group}"),
        ] {
            let problem = Layout::parse("x", document).err().unwrap_or_default();
            assert!(problem.contains(why), "{document}: {problem}");
        }
    }
}
