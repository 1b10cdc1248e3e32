//! The list of all layers and their use.

use exr::prelude::SampleType;

use crate::buffer_set::{BufferSet, Planes};
use crate::file::{ExrFile, FileLayer};
use crate::layer_ref::{LayerUse, Role, SampleKind, SignalPart};
use crate::names;

/// Returns every layer in use, with its role.
pub(crate) fn used_planes(set: &BufferSet) -> Vec<(&Planes, Role)> {
    let mut used = vec![(&set.color.mean, Role::Color)];
    used.extend(set.color.half_a.as_ref().map(|planes| (planes, Role::HalfA)));
    used.extend(set.color.half_b.as_ref().map(|planes| (planes, Role::HalfB)));
    used.extend(set.color.variance.as_ref().map(|planes| (planes, Role::Variance)));
    for (name, source) in &set.features {
        let role = |part| Role::Feature(name.clone(), part);
        used.push((&source.mean, role(SignalPart::Mean)));
        used.extend(source.half_a.as_ref().map(|planes| (planes, role(SignalPart::HalfA))));
        used.extend(source.half_b.as_ref().map(|planes| (planes, role(SignalPart::HalfB))));
        used.extend(source.variance.as_ref().map(|planes| (planes, role(SignalPart::Variance))));
    }
    used.extend(set.samples.as_ref().map(|planes| (planes, Role::Samples)));
    used
}

/// The reason why a layer is not used.
pub(crate) struct Note {
    pub(crate) file: usize,
    pub(crate) layer: usize,
    pub(crate) text: String,
}

/// Returns every layer of every file with its role, or with the reason why it has none.
pub(crate) fn layer_uses(set: &BufferSet, notes: &[Note]) -> Vec<LayerUse> {
    let used = used_planes(set);
    let mut uses = Vec::new();
    for (file_index, file) in set.files.iter().enumerate() {
        for (layer_index, layer) in file.layers.iter().enumerate() {
            let role = used
                .iter()
                .find(|(planes, _)| planes.file == file_index && planes.layer == layer_index)
                .map(|(_, role)| role.clone());
            let noted = notes
                .iter()
                .find(|note| (note.file, note.layer) == (file_index, layer_index))
                .map(|note| note.text.clone());
            let note = match &role {
                None => noted.or_else(|| names::why_not_a_variance(&layer.name).map(str::to_owned)),
                Some(_) => None,
            };
            uses.push(LayerUse {
                file: file.path.clone(),
                layer: layer.name.clone(),
                channels: layer.channels.iter().map(|channel| channel.suffix.clone()).collect(),
                sample_kind: sample_kind(file, layer),
                role: role.unwrap_or(Role::Untouched),
                non_finite_values: file.non_finite_values(layer),
                note,
            });
        }
    }
    uses
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
