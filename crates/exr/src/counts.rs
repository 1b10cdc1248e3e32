//! Samples per pixel, from a channel or from the header.

use stein::frame::SamplesPerPixel;
use stein::image::Window;

use crate::classify::{Classified, Scope};
use crate::file::ExrFile;
use crate::layout::{Layout, Quantity, RoleName};
use crate::source::{self, Planes};

/// Header attributes of any renderer that hold the samples per pixel.
const USUAL_ATTRIBUTES: [&str; 2] = ["samples", "samplesPerPixel"];

/// A layer that counts samples.
pub(crate) struct Counted {
    planes: Planes,
    /// Whether it holds fractions of the number in the header.
    is_fraction: bool,
}

/// Returns the layer that counts the samples of a picture, in the files of these positions. Files beside the input
/// belong to its picture if `is_only`.
pub(crate) fn layer(
    files: &[ExrFile],
    classified: &[Classified],
    own_files: &[usize],
    scope: &Scope,
    is_only: bool,
) -> Option<Counted> {
    let layers = own_files.iter().flat_map(|&file| (0..files[file].layers.len()).map(move |layer| (file, layer)));
    layers.into_iter().find_map(|(file, layer)| {
        let meaning = classified[file].meanings[layer].as_ref().filter(|it| it.role == Some(RoleName::Samples))?;
        let found = &files[file].layers[layer];
        let own = Scope::of(found, Some(meaning));
        // A count without a group belongs to all pictures of its part.
        let is_shared = own.group.is_empty() && (own.part, &own.view) == (scope.part, &scope.view);
        (own == *scope || is_shared || file > 0 && is_only).then(|| Counted {
            planes: Planes { file, layer, channels: vec![found.channels[0].index] },
            is_fraction: meaning.quantity == Quantity::Fraction,
        })
    })
}

/// Returns the samples per pixel of a picture with this data window, and the layer if they come from one. `header` is
/// the number in the header.
pub(crate) fn known(
    files: &[ExrFile],
    window: Window,
    header: Option<f32>,
    counted: Option<Counted>,
) -> (SamplesPerPixel, Option<Planes>) {
    let counts = |planes: &Planes| {
        let file = &files[planes.file];
        let part = file.layers[planes.layer].part;
        let own = source::window_of(file, part, window);
        source::covers(own, window).then(|| source::aligned(file.planes(part, &planes.channels), own, window, 0.0))
    };
    match (counted, header) {
        (Some(Counted { planes, is_fraction: true }), Some(most)) => {
            let Some(mut counts) = counts(&planes) else { return (SamplesPerPixel::Uniform(most), None) };
            // The fraction of a whole number of samples, rounded to a float.
            counts.planes.iter_mut().flatten().for_each(|count| *count = (*count * most).round());
            (SamplesPerPixel::PerPixel(counts), Some(planes))
        }
        (Some(Counted { planes, is_fraction: false }), _) => match (counts(&planes), header) {
            (Some(counts), _) => (SamplesPerPixel::PerPixel(counts), Some(planes)),
            (None, Some(count)) => (SamplesPerPixel::Uniform(count), None),
            (None, None) => (SamplesPerPixel::Unknown, None),
        },
        (_, Some(count)) => (SamplesPerPixel::Uniform(count), None),
        _ => (SamplesPerPixel::Unknown, None),
    }
}

/// Returns the number in the header, for the picture of this part and group or for the whole file.
pub(crate) fn in_header(file: &ExrFile, part: usize, layout: &Layout, group: &str) -> Option<f32> {
    let mut names = attributes(layout, group);
    let number = |name: String| {
        // Blender writes the numbers of all view layers into the header of the first part.
        let mut parts = std::iter::once(part).chain(0..file.parts());
        parts.find_map(|part| file.number_attribute(part, &name))
    };
    names.find_map(|name| number(name).filter(|count| *count > 0.0))
}

/// Returns the names of the header attributes that may hold the samples per pixel.
pub(crate) fn attributes(layout: &Layout, group: &str) -> impl Iterator<Item = String> {
    layout.sample_attributes(group).chain(USUAL_ATTRIBUTES.map(str::to_owned))
}
