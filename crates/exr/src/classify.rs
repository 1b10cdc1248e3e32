//! The meaning of each layer, as a layout says it.

use exr::prelude::SampleType;

use crate::file::ExrFile;
use crate::layers::FileLayer;
use crate::layout::{Breadth, Layout, Quantity, RoleName, Rule, native};
use crate::names;

/// A layer of one of the files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct LayerId {
    pub(crate) file: usize,
    pub(crate) layer: usize,
}

/// The rules by which layers are read.
#[derive(Clone, Debug)]
pub(crate) struct Rules {
    pub(crate) list: Vec<Rule>,
    /// Number of rules of the layout itself. Those of the native layout, which knows the usual names, come behind.
    own: usize,
}

impl Rules {
    pub(crate) fn of(layout: &Layout) -> Self {
        let mut list = layout.rules.clone();
        let native = native();
        if layout.name() != native.name() {
            // Files beside the input are named by the layout alone.
            list.extend(native.rules.iter().filter(|rule| rule.files.is_empty()).cloned());
        }
        list.push(Rule::of_ids());
        Self { list, own: layout.rules.len() }
    }

    /// Returns the position of the rule for layers that the header lists as numbers of objects.
    fn of_ids(&self) -> usize {
        self.list.len() - 1
    }

    /// Returns the step in which a pattern of a rule is compared. The layout comes first, but a pattern of it that fits
    /// many names comes behind names that say more.
    fn step(&self, rule: usize, breadth: Breadth) -> usize {
        match (rule < self.own, breadth) {
            (true, Breadth::Named | Breadth::OfAnother) => 0,
            (false, Breadth::OfAnother) => 1,
            (true, Breadth::Similar) => 2,
            (false, _) => 3,
            (true, Breadth::Any) => 4,
        }
    }
}

const STEPS: usize = 5;

/// How well a rule fits: smaller ranks are preferred.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Rank {
    /// Step in which the rule was found.
    pub(crate) step: usize,
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
pub(crate) fn classify(rules: &Rules, file: &ExrFile, index: usize, input: Option<&ExrFile>) -> Classified {
    let mut classified = Classified::default();
    for (layer, own) in file.layers.iter().enumerate() {
        // Results of an earlier run.
        if own.name.split('.').any(|component| component == crate::estimate::PREFIX) {
            classified.meanings.push(None);
            continue;
        }
        let mut orphan = None;
        let meaning = meaning(rules, (file, index), input, layer, &own.key, &mut orphan);
        if let (None, Some(of)) = (&meaning, orphan) {
            classified.orphans.push((layer, of));
        }
        classified.meanings.push(meaning);
    }
    // The own layer of a part is plain `R G B` if the part is a picture or a view of its own and its name means
    // nothing, as in parts called `left` and `right`; but not beside a part of the same view that is called `beauty`.
    let may_be_plain = |layer: &FileLayer| layer.is_own && (layer.scope_part.is_some() || layer.view.is_some());
    let named: Vec<Option<String>> = file
        .layers
        .iter()
        .zip(&classified.meanings)
        .filter(|(own, meaning)| {
            let is_color = |meaning: &Meaning| meaning.is_mean_of(|role| role == RoleName::Color);
            may_be_plain(own) && meaning.as_ref().is_some_and(is_color)
        })
        .map(|(own, _)| own.view.clone())
        .collect();
    for (layer, own) in file.layers.iter().enumerate().filter(|(_, own)| may_be_plain(own)) {
        if classified.meanings[layer].is_none() && !named.contains(&own.view) {
            classified.meanings[layer] = meaning(rules, (file, index), input, layer, "", &mut None);
        }
    }
    // The header says which layers are of cryptomatte, whatever they are called.
    for name in file.cryptomattes() {
        for (layer, own) in file.layers.iter().enumerate() {
            let rank = own.name.strip_prefix(&name).or_else(|| own.key.strip_prefix(&name));
            if rank.is_some_and(|rank| rank.chars().all(|digit| digit.is_ascii_digit())) {
                let rule = rules.of_ids();
                let rank = Rank { rule, ..Rank::default() };
                classified.meanings[layer] = Some(Meaning::new(rank, &rules.list[rule], String::new(), None));
            }
        }
    }
    classified
}

fn meaning(
    rules: &Rules,
    (file, index): (&ExrFile, usize),
    input: Option<&ExrFile>,
    layer: usize,
    key: &str,
    orphan: &mut Option<String>,
) -> Option<Meaning> {
    (0..STEPS).find_map(|step| fitting(rules, (file, index), input, layer, key, step, &mut *orphan))
}

fn fitting(
    rules: &Rules,
    (file, index): (&ExrFile, usize),
    input: Option<&ExrFile>,
    layer: usize,
    key: &str,
    step: usize,
    orphan: &mut Option<String>,
) -> Option<Meaning> {
    let own = &file.layers[layer];
    let named = rules.list.iter().enumerate().filter(|(_, rule)| rule.files.is_empty() && rule.fits_channels(own));
    for (position, rule) in named {
        let names = rule.names.iter().enumerate().filter(|(_, name)| rules.step(position, name.breadth()) == step);
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
            return Some(Meaning::new(Rank { step, rule: position, pattern }, rule, fit.group, of));
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
