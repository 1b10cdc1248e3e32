//! Frames from the test renders.

use std::path::{Path, PathBuf};
use stein::frame::RawSignal;

use stein::frame::{Signal, half_spread};
use stein::image::{Extent, Image};
use stein::{Estimate, Frame, frame::SamplesPerPixel};
use stein_exr::{BufferSet, BufferSetRequest, read_reference};

fn path(file: &str) -> PathBuf {
    // Tests of the library and of the programs, in different folders, use this file.
    let mut folders = Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().map(|folder| folder.join("testdata"));
    folders.find(|folder| folder.is_dir()).unwrap_or_else(|| panic!("no folder testdata")).join(file)
}

/// The noisy render `testdata/<name>.exr`.
pub fn noisy(name: &str) -> BufferSet {
    BufferSet::read(&BufferSetRequest { input: path(&format!("{name}.exr")), ..Default::default() })
        .unwrap_or_else(|error| panic!("{error}"))
}

/// The converged render of a scene.
pub fn converged(scene: &str) -> Image {
    read_reference(&path(&format!("{scene}_reference.exr")), None).unwrap_or_else(|error| panic!("{error}"))
}

/// A rectangle of an image.
pub fn cropped(image: &Image, left: usize, top: usize, width: usize, height: usize) -> Image {
    let stride = image.extent.width as usize;
    let rows =
        |plane: &Vec<f32>| (top..top + height).flat_map(|y| plane[y * stride + left..][..width].to_vec()).collect();
    Image {
        extent: Extent { width: width as u32, height: height as u32 },
        planes: image.planes.iter().map(rows).collect(),
    }
}

/// Parts of a render that a frame keeps.
#[derive(Clone, Copy)]
pub struct Keep {
    pub halves: bool,
    pub variance: bool,
    /// Names of features.
    pub features: &'static [&'static str],
}

pub const EVERYTHING: Keep =
    Keep { halves: true, variance: true, features: &["albedo", "depth", "normal", "visibility"] };

/// A rectangle of a render as a frame.
pub fn frame(set: &BufferSet, [left, top, width, height]: [usize; 4], keep: Keep) -> Frame {
    let crop = |image: &Image| cropped(image, left, top, width, height);
    let signal = |raw: RawSignal| Signal {
        mean: crop(&raw.mean),
        half_spread: raw
            .half_a
            .zip(raw.half_b)
            .filter(|_| keep.halves)
            .map(|(a, b)| half_spread(&crop(&a), &crop(&b), 1.0, 1.0)),
        variance_of_mean: raw.variance_of_mean.as_ref().filter(|_| keep.variance).map(crop),
    };
    let features = set
        .features()
        .filter(|(name, _)| keep.features.contains(name))
        .map(|(name, raw)| (name.to_owned(), signal(raw)));
    new_frame(signal(set.color()), features.collect())
}

/// The estimated error. Panics if it was not requested.
pub fn error_of(estimate: &Estimate) -> &Image {
    estimate.error.as_ref().unwrap_or_else(|| panic!("there is no estimated error"))
}

pub fn new_frame(color: Signal, features: Vec<(String, Signal)>) -> Frame {
    Frame::new(color, features, SamplesPerPixel::Unknown).unwrap_or_else(|error| panic!("{error}")).0
}
