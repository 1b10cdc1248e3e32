//! Which layers are denoised along with the colour, and how alpha relates to the colours.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::layout::Pattern;
use crate::names;

/// Layers that are denoised along with the colour. Numbers of objects, such as cryptomatte, never are.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Aovs {
    /// The layers that the layout knows as parts of the light.
    #[default]
    Lights,
    /// The lights, and all other colours of floats that guide nothing.
    All,
    /// No layers.
    None,
    /// Layers by their whole names, or by the last part of them in all view layers; `*` stands for any text without a
    /// dot.
    Named(Vec<String>),
}

impl FromStr for Aovs {
    type Err = &'static str;

    /// Reads `lights`, `all`, `none` or a list of names with commas between them.
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        Ok(match text {
            "lights" => Self::Lights,
            "all" => Self::All,
            "none" => Self::None,
            list => {
                let names = list.split(',').map(str::trim).filter(|name| !name.is_empty());
                let names: Vec<String> = names.map(str::to_owned).collect();
                if names.is_empty() {
                    return Err("it names no layer; `none` stands for no layers");
                }
                Self::Named(names)
            }
        })
    }
}

impl fmt::Display for Aovs {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Lights => "lights",
            Self::All => "all",
            Self::None => "none",
            Self::Named(names) => return f.write_str(&names.join(",")),
        })
    }
}

/// Whether `wanted` names the layer `name`: it is the whole name, or the part behind one of its dots.
pub(crate) fn is_named(wanted: &str, name: &str) -> bool {
    let pattern = wanted.contains('*').then(|| Pattern::new(&format!("{{group}}{wanted}"), true).ok()).flatten();
    pattern.map_or_else(|| names::ends_with(name, wanted), |pattern| pattern.fit(name).is_some())
}

/// How colours relate to their alpha.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "programs", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum AlphaEncoding {
    /// Colours are multiplied by their alpha, as OpenEXR demands.
    #[default]
    Premultiplied,
    /// Colours are not multiplied by their alpha.
    Straight,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn layers_are_named_wholly_or_by_their_last_part() {
        for (wanted, name, fits) in [
            ("key", "key", true),
            ("key", "fg.key", true),
            ("fg.key", "fg.key", true),
            ("key", "fg.monkey", false),
            ("Combined_*", "fg.Combined_key", true),
            ("Combined_*", "Combined.key", false),
            ("*", "fg.key", true),
            ("a{b", "x.a{b", true),
        ] {
            assert_eq!(is_named(wanted, name), fits, "{wanted} {name}");
        }
    }

    #[test]
    fn a_list_is_read_as_it_is_shown() {
        for text in ["lights", "all", "none", "key,fill_*"] {
            assert_eq!(text.parse::<Aovs>().map(|aovs| aovs.to_string()).as_deref(), Ok(text));
        }
        assert_eq!("key, fill,".parse(), Ok(Aovs::Named(vec!["key".into(), "fill".into()])));
        assert!("".parse::<Aovs>().is_err() && ", ".parse::<Aovs>().is_err());
    }
}
