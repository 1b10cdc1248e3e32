//! Samples per pixel, from a channel or from the header.

use stein::frame::SamplesPerPixel;
use stein::image::Window;

use crate::file::ExrFile;
use crate::layout::Layout;
use crate::source::{self, Planes};

/// Header attributes of any renderer that hold the samples per pixel.
const USUAL_ATTRIBUTES: [&str; 2] = ["samples", "samplesPerPixel"];

/// Returns the samples per pixel of a picture with this data window, and the layer if they come from one. `header` is
/// the number in the header; `counted` is the layer that counts samples, which holds a fraction of that number if
/// `is_fraction`.
pub(crate) fn known(
    files: &[ExrFile],
    window: Window,
    header: Option<f32>,
    counted: Option<Planes>,
    is_fraction: bool,
) -> (SamplesPerPixel, Option<Planes>) {
    let counts = |planes: &Planes| {
        let file = &files[planes.file];
        let part = file.layers[planes.layer].part;
        let own = source::window_of(file, part, window);
        source::covers(own, window).then(|| source::aligned(file.planes(part, &planes.channels), own, window, 0.0))
    };
    match (counted, header) {
        (Some(planes), Some(most)) if is_fraction => {
            let Some(mut counts) = counts(&planes) else { return (SamplesPerPixel::Uniform(most), None) };
            // The fraction of a whole number of samples, rounded to a float.
            counts.planes.iter_mut().flatten().for_each(|count| *count = (*count * most).round());
            (SamplesPerPixel::PerPixel(counts), Some(planes))
        }
        (Some(planes), _) if !is_fraction => match (counts(&planes), header) {
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
    let names = layout.sample_attributes(group).chain(USUAL_ATTRIBUTES.map(str::to_owned));
    let number = |name: String| {
        // Blender writes the numbers of all view layers into the header of the first part.
        let mut parts = std::iter::once(part).chain(0..file.parts());
        parts.find_map(|part| file.number_attribute(part, &name))
    };
    names.filter_map(number).find(|count| *count > 0.0)
}
