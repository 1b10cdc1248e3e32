//! The list of all layers and their use.

use exr::prelude::SampleType;

use crate::buffer_set::BufferSet;
use crate::classify::{Classified, LayerId};
use crate::file::ExrFile;
use crate::layer_ref::{LayerUse, Role, SampleKind, SignalPart};
use crate::layers::FileLayer;
use crate::layout::{Quantity, RoleName, Rule, Unit};
use crate::source::SignalSource;

/// The reason why a layer is not used, or a remark on its use.
pub(crate) struct Note {
    pub(crate) id: LayerId,
    pub(crate) text: String,
}

/// The role of a layer in a picture.
struct Used {
    id: LayerId,
    picture: usize,
    role: Role,
    quantity: Option<Quantity>,
    unit: Option<Unit>,
}

/// Returns every layer in use, with its role.
fn used(set: &BufferSet) -> Vec<Used> {
    let mut used = Vec::new();
    for (picture, of_picture) in set.pictures.iter().enumerate() {
        let colour = |part| match part {
            SignalPart::Mean => Role::Color,
            SignalPart::HalfA => Role::HalfA,
            SignalPart::HalfB => Role::HalfB,
            SignalPart::Variance => Role::Variance,
        };
        add(&mut used, picture, &of_picture.color, &colour);
        for (name, source) in &of_picture.features {
            add(&mut used, picture, source, &|part| Role::Feature(name.clone(), part));
        }
        used.extend(of_picture.samples_layer.as_ref().map(|planes| Used {
            id: planes.id(),
            picture,
            role: Role::Samples,
            quantity: None,
            unit: None,
        }));
    }
    used
}

fn add(used: &mut Vec<Used>, picture: usize, source: &SignalSource, role: &dyn Fn(SignalPart) -> Role) {
    let variance = source.variance.as_ref();
    let parts = [
        (Some(&source.mean), SignalPart::Mean),
        (source.half_a.as_ref(), SignalPart::HalfA),
        (source.half_b.as_ref(), SignalPart::HalfB),
        (variance.map(|variance| &variance.planes), SignalPart::Variance),
    ];
    for (planes, part) in parts {
        let Some(planes) = planes else { continue };
        let quantity = variance
            .map(|variance| variance.quantity)
            .filter(|quantity| part == SignalPart::Variance && *quantity != Quantity::VarianceOfMean);
        let id = planes.id();
        let unit = source.unit.filter(|_| part == SignalPart::Mean);
        used.push(Used { id, picture, role: role(part), quantity, unit });
    }
}

/// Returns every layer of every file with its role, or with the reason why it has none.
pub(crate) fn layer_uses(set: &BufferSet, classified: &[Classified], rules: &[Rule], notes: &[Note]) -> Vec<LayerUse> {
    let used = used(set);
    let mut uses = Vec::new();
    for (file_index, file) in set.files.iter().enumerate() {
        for (layer_index, layer) in file.layers.iter().enumerate() {
            let id = LayerId { file: file_index, layer: layer_index };
            let used = used.iter().find(|used| used.id == id);
            // Of the merged halves of seeds, only the layers in use are in memory.
            let Some(own) = classified.get(file_index) else {
                if let Some(used) = used {
                    uses.push(layer_use(file, layer, Some(used), None));
                }
                continue;
            };
            let meaning = own.meanings[layer_index].as_ref();
            let rule = meaning.map(|meaning| &rules[meaning.rank.rule]);
            let noted = notes.iter().find(|note| note.id == id).map(|note| note.text.clone());
            let mut found = layer_use(file, layer, used, noted);
            if used.is_none() {
                let of = meaning.and_then(|meaning| meaning.of);
                let described = of.and_then(|of| classified[of.file].meanings[of.layer].as_ref());
                let quantity = meaning.map_or(Quantity::Mean, |meaning| meaning.quantity);
                found.role = match meaning.and_then(|meaning| meaning.role.or_else(|| described.and_then(|it| it.role)))
                {
                    Some(RoleName::Light) => Role::Light,
                    Some(RoleName::Alpha) if quantity == Quantity::Mean => Role::Alpha,
                    Some(RoleName::Id) if quantity == Quantity::Mean => Role::Id,
                    Some(RoleName::Denoised) if quantity == Quantity::Mean => Role::Denoised,
                    _ => Role::Untouched,
                };
                found.quantity = Some(quantity).filter(|quantity| match found.role {
                    Role::Light => *quantity != Quantity::Mean,
                    Role::Untouched => *quantity == Quantity::NotAVariance,
                    _ => false,
                });
                if let Some(picture) = set.pictures.iter().position(|picture| picture.is_payload(id)) {
                    (found.picture, found.is_along) = (Some(picture), true);
                    found.role = if found.role == Role::Alpha { Role::Alpha } else { Role::Light };
                }
                if let Some(picture) = set.pictures.iter().position(|picture| picture.is_stale(id)) {
                    found.picture = Some(picture);
                    found.note =
                        Some("left out of an output: a half or variance of a layer that is denoised along".into());
                }
                if found.role == Role::Untouched && set.pictures.iter().any(|picture| picture.is_multiplier(id)) {
                    found.note.get_or_insert_with(|| "only as a factor of layers that are denoised along".into());
                }
                // The reason why a layer is not used is none where a request wants it.
                let why = rule.filter(|_| !found.is_along).and_then(|rule| rule.why.clone());
                found.note = found.note.or(why);
            }
            uses.push(found);
        }
    }
    uses
}

fn layer_use(file: &ExrFile, layer: &FileLayer, used: Option<&Used>, note: Option<String>) -> LayerUse {
    LayerUse {
        file: file.path.clone(),
        layer: layer.name.clone(),
        channels: layer.channels.iter().map(|channel| channel.suffix.clone()).collect(),
        sample_kind: sample_kind(file, layer),
        role: used.map_or(Role::Untouched, |used| used.role.clone()),
        picture: used.map(|used| used.picture),
        is_along: false,
        quantity: used.and_then(|used| used.quantity),
        unit: used.and_then(|used| used.unit),
        non_finite_values: file.non_finite_values(layer),
        note,
    }
}

fn sample_kind(file: &ExrFile, layer: &FileLayer) -> SampleKind {
    let kind = |channel| match file.sample_type(layer, channel) {
        SampleType::F16 => SampleKind::Half,
        SampleType::F32 => SampleKind::Float,
        SampleType::U32 => SampleKind::Uint,
    };
    let first = kind(0);
    if (1..layer.channels.len()).all(|channel| kind(channel) == first) { first } else { SampleKind::Mixed }
}
