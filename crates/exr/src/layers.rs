//! The layers that the names of a file's channels form.

use exr::prelude::*;

use crate::layout::Join;
use crate::names;
use stein::text;

/// Channels of one part whose names share everything before the last dot.
#[derive(Clone, Debug)]
pub(crate) struct FileLayer {
    /// Name of the layer, which no other layer of the file has; empty for the channels of a single-part file that have
    /// no dot.
    pub(crate) name: String,
    /// The name that layouts compare: without the part's prefix and without the view.
    pub(crate) key: String,
    /// The view that the layer belongs to, such as `left`; `None` in a file without views.
    pub(crate) view: Option<String>,
    /// The part, if several parts of the file have layers of the same name: such a part is a picture of its own.
    pub(crate) scope_part: Option<usize>,
    /// Whether the layer is named after its part, since its channels have no dot.
    pub(crate) is_own: bool,
    pub(crate) part: usize,
    /// Channels in the order red, green, blue or x, y, z; alphabetical if the names say neither.
    pub(crate) channels: Vec<FileChannel>,
}

#[derive(Clone, Debug)]
pub(crate) struct FileChannel {
    /// Position in the part's list of channels.
    pub(crate) index: usize,
    /// The name after the last dot.
    pub(crate) suffix: String,
}

impl FileChannel {
    /// Whether the channel is the wanted one, such as `R`, however it is spelt: `R`, `r` or `red`.
    pub(crate) fn is(&self, wanted: &str) -> bool {
        self.letter().eq_ignore_ascii_case(wanted)
    }

    /// Returns the suffix, or the letter of a colour that is spelt as a word.
    pub(crate) fn letter(&self) -> &str {
        letter(&self.suffix)
    }
}

/// Returns the letter of a colour's channel that is spelt as a word; other suffixes stay.
fn letter(suffix: &str) -> &str {
    const WORDS: [(&str, &str); 4] = [("red", "R"), ("green", "G"), ("blue", "B"), ("alpha", "A")];
    WORDS.iter().find(|(word, _)| suffix.eq_ignore_ascii_case(word)).map_or(suffix, |(_, letter)| letter)
}

impl FileLayer {
    /// Returns the layer's name, or its channels if it has none, for messages.
    pub(crate) fn title(&self) -> String {
        match self.name.as_str() {
            "" => self.channels.iter().map(|channel| channel.suffix.as_str()).collect::<Vec<_>>().join(" "),
            name => name.to_owned(),
        }
    }

    /// Formats the layer's name and channels, for messages.
    pub(crate) fn described(&self) -> String {
        let channels: Vec<_> = self.channels.iter().map(|channel| text::name(&channel.suffix)).collect();
        let channels = channels.join(" ");
        if self.name.is_empty() { channels } else { format!("'{}' ({channels})", text::name(&self.name)) }
    }

    pub(crate) fn channel(&self, wanted: &str) -> Option<usize> {
        self.channels.iter().find(|channel| channel.is(wanted)).map(|channel| channel.index)
    }

    /// Returns red, green and blue; `None` if one of them is missing.
    pub(crate) fn rgb(&self) -> Option<Vec<usize>> {
        ["R", "G", "B"].into_iter().map(|name| self.channel(name)).collect()
    }

    /// Returns all channels but the alpha.
    pub(crate) fn without_alpha(&self) -> Vec<usize> {
        let is_alpha = |channel: &&FileChannel| self.channels.len() > 1 && channel.is("A");
        self.channels.iter().filter(|channel| !is_alpha(channel)).map(|channel| channel.index).collect()
    }
}

/// Groups a file's channels into layers: names are split at their last dot.
///
/// Channels without a dot, or with one at the start alone, belong to the part. In a part with R, G and B (or a
/// luminance Y) those and the alpha are the part's own layer and every other channel, such as `Z` or `samples`, is a
/// layer of its own. The part's own layer has no name in a file of one part, else the part's.
///
/// Layers are told apart by the bytes of their names: two encodings may spell the same text.
pub(crate) fn layers_of(image: &FlatImage) -> Vec<FileLayer> {
    let views = Views::of(image);
    let mut layers: Vec<(&[u8], FileLayer)> = Vec::new();
    for (part, layer) in image.layer_data.iter().enumerate() {
        let part_name = layer.attributes.layer_name.as_ref().map_or(&[][..], Text::as_slice);
        let own_name = if image.layer_data.len() > 1 { part_name } else { &[] };
        let stored: Vec<&[u8]> = layer.channel_data.list.iter().map(|channel| channel.name.as_slice()).collect();
        let is_there = |wanted: &str| {
            let spelt = |name: &[u8]| letter(&names::decoded(name)).eq_ignore_ascii_case(wanted);
            stored.iter().any(|name| spelt(name) || name.strip_prefix(b".").is_some_and(spelt))
        };
        let has_color = is_there("Y") && !is_there("X") || ["R", "G", "B"].into_iter().all(is_there);
        for (index, &name) in stored.iter().enumerate() {
            let (layer_name, suffix) = match name.iter().rposition(|byte| *byte == b'.') {
                // A second set of channels, beside those without a dot.
                Some(0) if stored.contains(&&name[1..]) => (&b"."[..], &name[1..]),
                Some(0) => (own_name, &name[1..]),
                Some(dot) => (&name[..dot], &name[dot + 1..]),
                None => {
                    let decoded = names::decoded(name);
                    let is_color =
                        ["R", "G", "B", "A", "Y"].iter().any(|color| letter(&decoded).eq_ignore_ascii_case(color));
                    let is_own = if has_color { is_color } else { decoded.chars().count() == 1 };
                    (if is_own { own_name } else { name }, name)
                }
            };
            let channel = FileChannel { index, suffix: names::decoded(suffix) };
            if let Some((_, found)) =
                layers.iter_mut().find(|(other, found)| found.part == part && *other == layer_name)
            {
                found.channels.push(channel);
                continue;
            }
            let name = names::decoded(layer_name);
            let (key, view) = views.split(&name, layer.attributes.view_name.as_ref());
            let is_own = layer_name == own_name;
            let layer = FileLayer { name, key, view, scope_part: None, is_own, part, channels: vec![channel] };
            layers.push((layer_name, layer));
        }
    }
    let mut layers: Vec<FileLayer> = layers.into_iter().map(|(_, layer)| layer).collect();
    for layer in &mut layers {
        layer.channels.sort_by_key(|channel| (channel_rank(&channel.suffix), channel.suffix.clone()));
    }
    tell_parts_apart(image, &mut layers);
    layers
}

/// Makes one layer of layers with one channel each. Does nothing unless all of them are in one part.
pub(crate) fn join(layers: &mut Vec<FileLayer>, join: &Join) {
    let is_it = |layer: &FileLayer, name: &String| layer.key == *name && layer.channels.len() == 1;
    let Some(first) = join.channels.first().and_then(|name| layers.iter().find(|layer| is_it(layer, name))) else {
        return;
    };
    let mut joined = first.clone();
    joined.channels.clear();
    for (name, letter) in join.channels.iter().zip(join.letters.chars()) {
        let Some(found) = layers.iter().find(|layer| is_it(layer, name) && layer.part == joined.part) else { return };
        joined.channels.push(FileChannel { index: found.channels[0].index, suffix: letter.into() });
    }
    (joined.name, joined.key) = (join.name.clone(), join.name.clone());
    let part = joined.part;
    layers.retain(|layer| layer.part != part || !join.channels.iter().any(|name| is_it(layer, name)));
    layers.push(joined);
}

/// Marks parts that have layers of the same name, and gives each of these layers a name of its own.
fn tell_parts_apart(image: &FlatImage, layers: &mut [FileLayer]) {
    let has_double = |layer: &FileLayer| {
        let is_double =
            |other: &FileLayer| other.part != layer.part && other.key == layer.key && other.view == layer.view;
        layers.iter().any(is_double)
    };
    let mut parts: Vec<usize> = layers.iter().filter(|layer| has_double(layer)).map(|layer| layer.part).collect();
    parts.dedup();
    for index in 0..layers.len() {
        let part = layers[index].part;
        layers[index].scope_part = Some(part).filter(|part| parts.contains(part));
        // Within a part, names that differ in their encoding alone may look the same.
        let is_taken = |name: &str| layers[..index].iter().any(|other| other.part != part && other.name == name);
        if !is_taken(&layers[index].name) {
            continue;
        }
        let part_name = image.layer_data[part].attributes.layer_name.as_ref().map_or(&[][..], Text::as_slice);
        let part_name = names::decoded(part_name);
        let prefixed = format!("{part_name}.{}", layers[index].name);
        let same_part = layers[..index].iter().find(|other| other.part != part && other.name == part_name);
        let numbered = || (2..).map(|number| format!("{}#{number}", layers[index].name)).find(|name| !is_taken(name));
        let name = if layers[index].is_own || same_part.is_some() || is_taken(&prefixed) { numbered() } else { None };
        layers[index].name = name.unwrap_or(prefixed);
    }
}

/// The views of a file, such as `left` and `right`.
struct Views {
    names: Vec<String>,
    /// The view of layers that name none.
    hero: Option<String>,
}

impl Views {
    fn of(image: &FlatImage) -> Self {
        let mut names: Vec<String> = Vec::new();
        let mut hero = None;
        for layer in &image.layer_data {
            let listed = layer.attributes.multi_view_names.iter().flatten().chain(&layer.attributes.view_name);
            for view in listed.map(|view| names::decoded(view.as_slice())) {
                if !names.contains(&view) {
                    names.push(view);
                }
            }
            let first = layer.attributes.multi_view_names.as_ref().and_then(|views| views.first());
            hero = hero.or_else(|| first.map(|view| names::decoded(view.as_slice())));
        }
        Self { names, hero }
    }

    /// Splits a layer's name into the name without the view, and the view.
    fn split(&self, name: &str, of_part: Option<&Text>) -> (String, Option<String>) {
        let of_part = of_part.map(|view| names::decoded(view.as_slice()));
        let is_view = |component: &str| match &of_part {
            Some(view) => component == view,
            None => self.names.iter().any(|view| view == component),
        };
        let components: Vec<&str> = name.split('.').collect();
        match components.iter().rposition(|component| is_view(component)) {
            Some(at) => {
                let others = components.iter().enumerate().filter(|(index, _)| *index != at);
                let key = others.map(|(_, component)| *component).collect::<Vec<_>>().join(".");
                (key, Some(components[at].to_owned()))
            }
            None => (name.to_owned(), of_part.or_else(|| self.hero.clone())),
        }
    }
}

fn channel_rank(suffix: &str) -> usize {
    let order = ["r", "g", "b", "x", "y", "z", "u", "v", "w"];
    order.iter().position(|known| letter(suffix).eq_ignore_ascii_case(known)).unwrap_or(order.len())
}
