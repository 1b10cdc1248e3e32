//! Samples per pixel, from a channel or from the header.

use stein::frame::SamplesPerPixel;

use crate::file::ExrFile;
use crate::layout::Layout;
use crate::source::Planes;

/// Header attributes of any renderer that hold the samples per pixel.
const USUAL_ATTRIBUTES: [&str; 2] = ["samples", "samplesPerPixel"];

/// Returns the samples per pixel of a picture, and the layer if they come from one. `part` and `group` are the
/// picture's; `counted` is the layer that counts samples, which holds a fraction of the header's number if
/// `is_fraction`.
pub(crate) fn known(
    file: &ExrFile,
    part: usize,
    layout: &Layout,
    group: &str,
    counted: Option<Planes>,
    is_fraction: bool,
) -> (SamplesPerPixel, Option<Planes>) {
    let header = in_header(file, part, layout, group);
    match (counted, header) {
        (Some(planes), Some(most)) if is_fraction => {
            let mut counts = file.planes(file.layers[planes.layer].part, &planes.channels);
            // The fraction of a whole number of samples, rounded to a float.
            counts.planes.iter_mut().flatten().for_each(|count| *count = (*count * most).round());
            (SamplesPerPixel::PerPixel(counts), Some(planes))
        }
        (Some(planes), _) if !is_fraction => {
            let counts = file.planes(file.layers[planes.layer].part, &planes.channels);
            (SamplesPerPixel::PerPixel(counts), Some(planes))
        }
        (_, Some(count)) => (SamplesPerPixel::Uniform(count), None),
        _ => (SamplesPerPixel::Unknown, None),
    }
}

/// Returns the number in the header, for the picture of this part and group or for the whole file.
fn in_header(file: &ExrFile, part: usize, layout: &Layout, group: &str) -> Option<f32> {
    let names = layout.sample_attributes(group).chain(USUAL_ATTRIBUTES.map(str::to_owned));
    let number = |name: String| {
        // Blender writes the numbers of all view layers into the header of the first part.
        let mut parts = std::iter::once(part).chain(0..file.parts());
        parts.find_map(|part| file.number_attribute(part, &name))
    };
    names.filter_map(number).find(|count| *count > 0.0)
}
