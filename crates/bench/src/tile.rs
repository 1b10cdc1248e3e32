//! An image made to cover another size.

use stein::frame::{Feature, SamplesPerPixel, Signal};
use stein::{Extent, Frame, Image, Result};

/// Covers `extent` with the image, mirrored at each seam so that the seams add no edges. Cuts off an image that is
/// larger.
pub(crate) fn cover(image: &Image, extent: Extent) -> Image {
    let mirrored = |position: usize, size: usize| {
        let within = position % (2 * size);
        if within < size { within } else { 2 * size - 1 - within }
    };
    let (width, height) = (image.extent.width as usize, image.extent.height as usize);
    let columns: Vec<usize> = (0..extent.width as usize).map(|x| mirrored(x, width)).collect();
    let rows: Vec<usize> = (0..extent.height as usize).map(|y| mirrored(y, height)).collect();
    let cover_plane =
        |plane: &Vec<f32>| rows.iter().flat_map(|&y| columns.iter().map(move |&x| plane[y * width + x])).collect();
    Image { extent, planes: image.planes.iter().map(cover_plane).collect() }
}

/// Returns a frame of another size with the statistics of this one.
pub(crate) fn cover_frame(frame: &Frame, extent: Extent) -> Result<Frame> {
    let cover_signal = |signal: &Signal, scale: f32, offset: f32| Signal {
        mean: cover(&mapped(&signal.mean, scale, offset), extent),
        half_spread: signal.half_spread.as_ref().map(|image| cover(&mapped(image, scale, 0.0), extent)),
        variance_of_mean: signal
            .variance_of_mean
            .as_ref()
            .map(|image| cover(&mapped(image, scale * scale, 0.0), extent)),
    };
    // Signals are in the units of the file, which decide what a feature means.
    let in_file_units = |feature: &Feature| {
        (feature.name.clone(), cover_signal(&feature.signal, feature.unit_scale, feature.unit_offset))
    };
    let features = frame.features().iter().map(in_file_units).collect();
    let (frame, _) = Frame::new(cover_signal(frame.color(), 1.0, 0.0), features, SamplesPerPixel::Unknown)?;
    Ok(frame)
}

fn mapped(image: &Image, scale: f32, offset: f32) -> Image {
    let plane = |plane: &Vec<f32>| plane.iter().map(|value| value * scale + offset).collect();
    Image { extent: image.extent, planes: image.planes.iter().map(plane).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_covered_frame_keeps_what_its_features_are() {
        let extent = Extent { width: 4, height: 1 };
        let image = |plane: [f32; 4]| Image { extent, planes: vec![plane.to_vec(); 3] };
        let signal = |mean: [f32; 4], spread: f32| Signal {
            mean: image(mean),
            half_spread: Some(image([spread; 4])),
            variance_of_mean: None,
        };
        // In unit range, the halves of the brightest albedo exceed 1.
        let features = vec![
            ("albedo".to_owned(), signal([0.0, 0.125, 0.25, 0.5], 0.0625)),
            ("normal".to_owned(), signal([-0.5, 0.0, 0.25, 0.5], 0.0)),
            ("depth".to_owned(), signal([3.0, 4.0, 5.0, 7.0], 0.5)),
        ];
        let settled = Frame::new(signal([1.0, 2.0, 3.0, 4.0], 0.5), features, SamplesPerPixel::Unknown);
        let frame = settled.unwrap_or_else(|error| panic!("{error}")).0;
        let covered =
            cover_frame(&frame, Extent { width: 8, height: 1 }).unwrap_or_else(|failure| panic!("{failure:?}"));
        for (feature, covered) in frame.features().iter().zip(covered.features()) {
            assert_eq!(
                (&feature.name, feature.unit_scale, feature.unit_offset),
                (&covered.name, covered.unit_scale, covered.unit_offset)
            );
            let first = |image: &Image| image.planes.iter().map(|plane| plane[..4].to_vec()).collect::<Vec<_>>();
            assert_eq!(first(&covered.signal.mean), feature.signal.mean.planes);
            let spreads = [&covered, &feature].map(|feature| feature.signal.half_spread.as_ref().map(first));
            assert_eq!(spreads[0], spreads[1], "{}", feature.name);
        }
    }

    #[test]
    fn an_image_is_mirrored_at_its_seams() {
        let image = Image { extent: Extent { width: 3, height: 1 }, planes: vec![vec![1.0, 2.0, 3.0]] };
        let covered = cover(&image, Extent { width: 8, height: 2 });
        let row = [1.0, 2.0, 3.0, 3.0, 2.0, 1.0, 1.0, 2.0];
        assert_eq!(covered.planes, [[row, row].concat()]);
        assert_eq!(cover(&image, Extent { width: 2, height: 1 }).planes, [[1.0, 2.0]]);
    }
}
