//! Recognising the layout of a file: by attributes of its header, by its layers, and by its name and the files
//! beside it.

use std::path::Path;

use serde::Deserialize;

use super::{Layout, LayoutUse, Pattern, RecognisedBy, Texts, native};
use crate::file::ExrFile;
use crate::siblings::FileName;
use stein::text;

/// Signs of a layout, as the TOML document spells them.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SignDocument {
    #[serde(default)]
    attributes: Texts,
    #[serde(default)]
    layers: Texts,
    #[serde(default)]
    file: Texts,
    #[serde(default)]
    siblings: Texts,
}

/// Signs that all have to be there.
#[derive(Clone, Debug)]
pub(super) struct Sign {
    attributes: Vec<AttributeSign>,
    layers: Vec<Pattern>,
    /// Patterns of the input's name, of which one is enough.
    file: Vec<Pattern>,
    siblings: Vec<Pattern>,
}

/// An attribute, and its value if that matters.
#[derive(Clone, Debug)]
struct AttributeSign {
    name: Pattern,
    value: Option<Pattern>,
}

impl SignDocument {
    pub(super) fn sign(self) -> Result<Sign, String> {
        let attribute = |sign: String| match sign.split_once('=') {
            Some((name, value)) => {
                Ok(AttributeSign { name: Pattern::of_text(name)?, value: Some(Pattern::of_text(value)?) })
            }
            None => Ok(AttributeSign { name: Pattern::of_text(&sign)?, value: None }),
        };
        let attributes = self.attributes.texts().into_iter().map(attribute).collect::<Result<_, String>>()?;
        let sign = Sign {
            attributes,
            layers: self.layers.patterns(false)?,
            file: self.file.patterns(false)?,
            siblings: self.siblings.patterns(false)?,
        };
        let is_empty =
            sign.attributes.is_empty() && sign.layers.is_empty() && sign.file.is_empty() && sign.siblings.is_empty();
        if is_empty { Err("a table `recognise` names nothing".into()) } else { Ok(sign) }
    }
}

/// A recognised layout.
#[derive(Clone, Debug)]
pub(crate) struct Recognised {
    pub(crate) layout: Layout,
    /// The part of the input's name that a `{stem}` stands for.
    pub(crate) stem: Option<String>,
    pub(crate) by: LayoutUse,
}

impl Recognised {
    /// Returns a layout that was chosen by the user.
    pub(crate) fn requested(layout: Layout, input: &Path) -> Self {
        let stem = layout.stem_of(input);
        Self::new(layout, stem, RecognisedBy::Request)
    }

    fn new(layout: Layout, stem: Option<String>, recognised_by: RecognisedBy) -> Self {
        let by = LayoutUse { name: layout.name.clone(), title: layout.title.clone(), recognised_by };
        Self { layout, stem, by }
    }
}

/// Returns the layout with the strongest sign: one with attributes before others, then the one of most conditions.
/// Without any sign, returns the native layout, which knows the usual names.
pub(crate) fn recognise(file: &ExrFile, look_beside: bool) -> Recognised {
    let mut best: Option<((bool, bool, usize), &Layout, Found)> = None;
    // A header may hold megabytes, such as the names of all objects.
    let attributes = file.attributes();
    for layout in Layout::built_in() {
        for sign in &layout.recognise {
            let Some(found) = sign.found(file, &attributes, look_beside) else { continue };
            let names = usize::from(!sign.file.is_empty()) + sign.siblings.len();
            let (attributes, layers) = (sign.attributes.len(), sign.layers.len());
            let strength = (attributes > 0, layers > 0, attributes + layers + names);
            if best.as_ref().is_none_or(|(other, ..)| strength > *other) {
                best = Some((strength, layout, found));
            }
        }
    }
    match best {
        Some((_, layout, found)) => Recognised::new(layout.clone(), found.stem, RecognisedBy::Signs(found.by)),
        None => Recognised::new(native().clone(), None, RecognisedBy::UsualNames),
    }
}

struct Found {
    stem: Option<String>,
    by: String,
}

impl Sign {
    fn found(&self, file: &ExrFile, attributes: &[(String, String)], look_beside: bool) -> Option<Found> {
        let mut told = Vec::new();
        for sign in &self.attributes {
            let is_it = |(name, value): &&(String, String)| {
                sign.name.fit(name).is_some()
                    && sign.value.as_ref().is_none_or(|wanted| wanted.fit(value.trim()).is_some())
            };
            let (name, _) = attributes.iter().find(is_it)?;
            told.push(format!("attribute {}", text::name(name)));
        }
        for pattern in &self.layers {
            let layer = file.layers.iter().find(|layer| pattern.fit(&layer.key).is_some())?;
            told.push(format!("layer {}", layer.described()));
        }
        let name = FileName::of(&file.path);
        let mut stem = None;
        if !self.file.is_empty() {
            let fit = self.file.iter().find_map(|pattern| pattern.fit(&name.stem))?;
            told.push("the file's name".into());
            stem = fit.stem;
        }
        for pattern in &self.siblings {
            let stem = stem.as_deref().unwrap_or(&name.stem);
            let beside = name.existing(&pattern.filled(&[("{stem}", stem)])).filter(|_| look_beside)?;
            told.push(format!("{} beside it", text::path(beside.file_name().map_or(&beside, Path::new))));
        }
        Some(Found { stem, by: told.join(", ") })
    }
}

impl Layout {
    /// Returns the part of the input's name that a `{stem}` stands for.
    pub(crate) fn stem_of(&self, input: &Path) -> Option<String> {
        let name = FileName::of(input);
        let mut patterns = self.recognise.iter().flat_map(|sign| &sign.file);
        patterns.find_map(|pattern| pattern.fit(&name.stem))?.stem
    }
}
