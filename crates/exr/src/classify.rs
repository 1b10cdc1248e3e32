//! The meaning of each layer, as a layout says it.

use exr::prelude::SampleType;

use crate::file::ExrFile;
use crate::layers::FileLayer;
use crate::layout::{Quantity, RoleName, Rule};
use crate::names;

/// A layer of one of the files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct LayerId {
    pub(crate) file: usize,
    pub(crate) layer: usize,
}

/// How well a rule fits: smaller ranks are preferred.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Rank {
    /// Whether the pattern fits any name.
    pub(crate) is_any: bool,
    /// Position of the rule.
    pub(crate) rule: usize,
    /// Position of the pattern in the rule.
    pub(crate) pattern: usize,
}

/// The meaning of a layer.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Meaning {
    pub(crate) rank: Rank,
    /// The prefix that the layer shares with other layers of the same picture.
    pub(crate) group: String,
    /// The layer that this one describes.
    pub(crate) of: Option<LayerId>,
    pub(crate) role: Option<RoleName>,
    pub(crate) quantity: Quantity,
}

impl Meaning {
    pub(crate) fn new(rank: Rank, rule: &Rule, group: String, of: Option<LayerId>) -> Self {
        Self { rank, group, of, role: rule.role, quantity: rule.quantity }
    }

    /// Whether the layer is the mean of this role.
    pub(crate) fn is_mean_of(&self, role: impl Fn(RoleName) -> bool) -> bool {
        self.quantity == Quantity::Mean && self.of.is_none() && self.role.is_some_and(role)
    }
}

/// Meanings of a file's layers.
#[derive(Clone, Debug, Default)]
pub(crate) struct Classified {
    /// One for each layer; `None` for layers that no rule fits.
    pub(crate) meanings: Vec<Option<Meaning>>,
    /// Layers that would describe another one that is not in the file, and its name.
    pub(crate) orphans: Vec<(usize, String)>,
}

/// Finds the rule for each layer of a file. `index` is the position of the file in the set. Layers may describe layers
/// of `input`, if the file belongs to it.
pub(crate) fn classify(rules: &[Rule], file: &ExrFile, index: usize, input: Option<&ExrFile>) -> Classified {
    let mut classified = Classified::default();
    for (layer, own) in file.layers.iter().enumerate() {
        // Results of an earlier run.
        if own.name.split('.').any(|component| component == crate::estimate::PREFIX) {
            classified.meanings.push(None);
            continue;
        }
        let mut orphan = None;
        let mut meaning = meaning(rules, (file, index), input, layer, &own.key, &mut orphan);
        // The part's own layer is plain `R G B` if the part is a picture of its own and its name means nothing.
        if meaning.is_none() && own.is_own && own.scope_part.is_some() {
            meaning = self::meaning(rules, (file, index), input, layer, "", &mut None);
        }
        if let (None, Some(of)) = (&meaning, orphan) {
            classified.orphans.push((layer, of));
        }
        classified.meanings.push(meaning);
    }
    classified
}

fn meaning(
    rules: &[Rule],
    (file, index): (&ExrFile, usize),
    input: Option<&ExrFile>,
    layer: usize,
    key: &str,
    orphan: &mut Option<String>,
) -> Option<Meaning> {
    // A layout may give a meaning to any other layer, but a name that says more comes first, also if only the usual names
    // have it.
    let find = |is_any: bool, orphan: &mut Option<String>| {
        fitting(rules, (file, index), input, layer, key, is_any, orphan)
    };
    find(false, orphan).or_else(|| find(true, orphan))
}

#[expect(clippy::too_many_arguments, reason = "a helper of `meaning`")]
fn fitting(
    rules: &[Rule],
    (file, index): (&ExrFile, usize),
    input: Option<&ExrFile>,
    layer: usize,
    key: &str,
    is_any: bool,
    orphan: &mut Option<String>,
) -> Option<Meaning> {
    let own = &file.layers[layer];
    let named = rules.iter().enumerate().filter(|(_, rule)| rule.files.is_empty() && rule.fits_channels(own));
    for (position, rule) in named {
        let names = rule.names.iter().enumerate().filter(|(_, name)| name.is_any() == is_any);
        for (pattern, fit) in names.filter_map(|(index, name)| Some((index, name.fit(key)?))) {
            let of = match fit.of {
                None => None,
                Some(of) => match described(file, own, &of)
                    .map(|of| LayerId { file: index, layer: of })
                    .or_else(|| Some(LayerId { file: 0, layer: described(input?, own, &of)? }))
                {
                    Some(of) => Some(of),
                    None if rule.role.is_some() => None,
                    None => {
                        orphan.get_or_insert(of);
                        continue;
                    }
                },
            };
            return Some(Meaning::new(Rank { is_any, rule: position, pattern }, rule, fit.group, of));
        }
    }
    None
}

/// Returns the layer of that name in the same part and view.
fn described(file: &ExrFile, own: &FileLayer, of: &str) -> Option<usize> {
    file.layers.iter().position(|other| {
        other.key.eq_ignore_ascii_case(of)
            && !other.key.is_empty()
            && (other.scope_part, &other.view) == (own.scope_part, &own.view)
            && other.name != own.name
    })
}

/// The picture that a layer belongs to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Scope {
    pub(crate) part: Option<usize>,
    /// The shared prefix of the layers' names, with its dot.
    pub(crate) group: String,
    pub(crate) view: Option<String>,
}

impl Scope {
    pub(crate) fn of(layer: &FileLayer, meaning: Option<&Meaning>) -> Self {
        let group = match meaning {
            Some(meaning) => meaning.group.clone(),
            None => names::group(&layer.key).to_owned(),
        };
        Self { part: layer.scope_part, group, view: layer.view.clone() }
    }
}

/// Whether a layer holds whole numbers, which are never colours or features.
pub(crate) fn is_whole_numbers(file: &ExrFile, layer: usize) -> bool {
    let own = &file.layers[layer];
    (0..own.channels.len()).any(|channel| file.sample_type(own, channel) == SampleType::U32)
}
