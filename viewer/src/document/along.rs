//! Layers that are denoised along with the colour, before and after: light groups, AOVs and alpha.

use std::sync::Arc;

use stein::frame::{PayloadKind, PayloadLayer};
use stein::{DenoisedLayer, Frame, Image, PayloadLeft, text};

use super::{RADIANCE, describe};
use crate::layer::{Group, Kind, Layer, Range, Scale};

/// Prefix of the names of layers as they were rendered. It keeps the name `result` of a light apart from the result.
const BEFORE: &str = "along.";
/// Prefix of the names of denoised layers.
const AFTER: &str = "denoised.";

/// Range of alpha, the same before and after so that both are shown on one scale.
const OPACITY: Range = Range { low: 0.0, high: 1.0 };

/// Makes the layers of a frame's payload as they were rendered.
pub(super) fn rendered_layers(frame: &Frame) -> impl Iterator<Item = Arc<Layer>> {
    let prefix = shared_prefix(frame.payload());
    frame.payload().iter().map(move |layer| {
        let title = text::name(&layer.name[prefix..]);
        let about = format!("{} as it was rendered.", quantity(layer));
        along_layer(layer, BEFORE, &title, &about, &layer.mean)
    })
}

/// Makes the layers of a denoised payload. `frame` is the frame that was denoised.
pub(super) fn denoised_layers(frame: &Frame, denoised: &[DenoisedLayer]) -> impl Iterator<Item = Arc<Layer>> {
    let prefix = shared_prefix(frame.payload());
    // Both have the same order.
    frame.payload().iter().zip(denoised).map(move |(layer, DenoisedLayer { image, left, .. })| {
        let quantity = quantity(layer);
        let (suffix, about) = match left.map(reason) {
            None => ("denoised", format!("{quantity}, filtered with the weights of the colour.")),
            Some(reason) => ("left as it was", format!("{quantity} as it was rendered, because {reason}.")),
        };
        let title = format!("{}, {suffix}", text::name(&layer.name[prefix..]));
        along_layer(layer, AFTER, &title, &about, image)
    })
}

fn along_layer(layer: &PayloadLayer, prefix: &str, title: &str, about: &str, image: &Image) -> Arc<Layer> {
    let (kind, unit, range) = match layer.kind {
        PayloadKind::Light => (Kind::Color, RADIANCE, None),
        PayloadKind::Alpha => (Kind::Scalar(Scale::Linear), "opacity", Some(OPACITY)),
    };
    let name = format!("{prefix}{}", layer.name);
    Arc::new(Layer::new(describe(name, title, about, Group::Along, kind, unit), Arc::new(image.clone()), range))
}

/// Returns the length of the parts that all names begin with, such as `ViewLayer.`: titles do without them.
fn shared_prefix(payload: &[PayloadLayer]) -> usize {
    let first = payload.first().map_or("", |layer| &layer.name);
    let is_shared = |prefix: &&str| {
        payload.iter().all(|layer| layer.name.strip_prefix(*prefix).is_some_and(|rest| !rest.is_empty()))
    };
    first.rmatch_indices('.').map(|(dot, _)| &first[..=dot]).find(is_shared).map_or(0, str::len)
}

/// Returns the words for a layer at the start of a sentence.
fn quantity(layer: &PayloadLayer) -> String {
    let kind = match layer.kind {
        PayloadKind::Light => "The light layer",
        PayloadKind::Alpha => "The alpha",
    };
    format!("{kind} {}", text::name(&layer.name))
}

/// Returns the reason why no filter changed a layer, for the end of a sentence.
fn reason(left: PayloadLeft) -> &'static str {
    match left {
        PayloadLeft::Constant => "all its pixels are equal",
        PayloadLeft::LackedBeside => "a frame beside lacks it",
        PayloadLeft::NoNoise => "no pixel of the colour has noise",
    }
}

/// Returns the name in the file of a layer of the window; `None` if the layer is not denoised along.
pub(super) fn name_in_file(name: &str) -> Option<&str> {
    name.strip_prefix(BEFORE).or_else(|| name.strip_prefix(AFTER))
}

/// Returns the name of the layer with the same quantity after denoising, or before for a denoised layer; `None` if the
/// layer is not denoised along.
pub fn counterpart(name: &str) -> Option<String> {
    let after = |name| format!("{AFTER}{name}");
    name.strip_prefix(BEFORE).map(after).or_else(|| Some(format!("{BEFORE}{}", name.strip_prefix(AFTER)?)))
}
