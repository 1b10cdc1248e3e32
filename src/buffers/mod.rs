//! OpenEXR files to buffer sets and back.
//!
//! A [`BufferSet`] is what the files said: which layer is the colour, which are its halves, its variance and its features. Nothing in it has been
//! checked for NaN or meaning; [`Frame::from_buffer_set`](crate::frame::Frame::from_buffer_set) does that.
//!
//! The native layout: `R G B`, `halfA.*`, `halfB.*`, `variance.*` (sample variance of the mean) and for every feature F `F.*`, `F_halfA.*`,
//! `F_halfB.*`, `F_variance.*`; the samples per pixel in a header attribute or a channel `samples`. One part or many, channels in any order and of any
//! type. Each of these layers can also come from a file of its own: see [`BufferSetRequest`].

mod assign;
mod decode;
mod file;
mod header;
mod layer_ref;
pub(crate) mod names;
mod request;
mod uses;
mod write;

use std::path::Path;

pub use layer_ref::{LayerRef, LayerUse, Role, SampleKind, SignalPart};
pub use request::BufferSetRequest;
pub use write::{DenoisedLayers, NamedLayer, WriteReport, write_denoised, write_layers};

use crate::error::Result;
use crate::frame::SamplesPerPixel;
use crate::image::{Extent, Image, Window};
pub(crate) use file::ExrFile;

/// The most features that a frame takes; the text's scenes use up to five.
pub const MAX_FEATURES: usize = 8;

/// A mean and what the files hold of its noise, as stored: may contain anything that a float can be. All images have the same extent and channels.
#[derive(Clone, Debug, PartialEq)]
pub struct RawSignal {
    /// The mean of all samples.
    pub mean: Image,
    /// The mean of the first half of the samples.
    pub half_a: Option<Image>,
    /// The mean of the other half.
    pub half_b: Option<Image>,
    /// Sample variance of the mean, s²/n.
    pub variance_of_mean: Option<Image>,
}

/// Some channels of one part of one of the set's files.
#[derive(Clone, Debug, PartialEq)]
struct Planes {
    file: usize,
    layer: usize,
    /// Positions in the part's list of channels, one for each plane; a luminance stands three times.
    channels: Vec<usize>,
}

#[derive(Clone, Debug, PartialEq)]
struct SignalSource {
    mean: Planes,
    half_a: Option<Planes>,
    half_b: Option<Planes>,
    variance: Option<Planes>,
}

/// What the files said. Keeps the files' whole content in memory, so that an output can carry over what was not denoised.
#[derive(Clone, Debug)]
pub struct BufferSet {
    files: Vec<ExrFile>,
    color: SignalSource,
    features: Vec<(String, SignalSource)>,
    samples: Option<Planes>,
    layer_uses: Vec<LayerUse>,
}

impl BufferSet {
    /// Reads the files and decides which layer is what.
    ///
    /// # Errors
    /// A file that is missing, damaged or of a kind that cannot be read; a requested layer that does not exist; layers
    /// whose data windows differ from the colour's; a half of the colour without the other, or halves and variance of
    /// other channels, where nothing else tells the colour's noise; more than [`MAX_FEATURES`] requested features; one
    /// to skip that the input does not have. Halves and variances that cannot be used are else left out, and
    /// [`BufferSet::layer_uses`] says why.
    pub fn read(request: &BufferSetRequest) -> Result<Self> {
        assign::read(request)
    }

    /// The input's path.
    pub fn input(&self) -> &Path {
        &self.files[0].path
    }

    /// Width and height of the data window: of all images of the set.
    pub fn extent(&self) -> Extent {
        self.data_window().extent
    }

    /// Where the pixels lie in the input's coordinates.
    pub fn data_window(&self) -> Window {
        self.files[0].data_window(self.color_part())
    }

    /// The whole picture, of which the data window may be a part, or which it may exceed.
    pub fn display_window(&self) -> Window {
        self.files[0].display_window()
    }

    /// The noisy colour: always three planes, equal ones for a luminance-only image.
    pub fn color(&self) -> RawSignal {
        self.raw(&self.color)
    }

    /// The name of the colour's layer; empty for plain `R G B`.
    pub fn color_layer(&self) -> &str {
        &self.files[0].layers[self.color.mean.layer].name
    }

    /// The names of the features, in the order of their indices.
    pub fn feature_names(&self) -> impl ExactSizeIterator<Item = &str> {
        self.features.iter().map(|(name, _)| name.as_str())
    }

    /// All features with their names, decoded one at a time.
    pub fn features(&self) -> impl ExactSizeIterator<Item = (&str, RawSignal)> {
        self.features.iter().map(|(name, source)| (name.as_str(), self.raw(source)))
    }

    /// Samples per pixel: from a channel if there is one, else from the header (attribute `samples` or `samplesPerPixel`), else unknown.
    pub fn samples_per_pixel(&self) -> SamplesPerPixel {
        if let Some(planes) = &self.samples {
            return SamplesPerPixel::PerPixel(self.planes(planes));
        }
        let named = |name| self.files[0].number_attribute(self.color_part(), name);
        named("samples").or_else(|| named("samplesPerPixel")).map_or(SamplesPerPixel::Unknown, SamplesPerPixel::Uniform)
    }

    /// A text in the input's header, of the colour's part or of the whole file.
    pub fn text_attribute(&self, name: &str) -> Option<String> {
        self.files[0].text_attribute(self.color_part(), name)
    }

    /// Every layer of every file, and what it is used as.
    pub fn layer_uses(&self) -> &[LayerUse] {
        &self.layer_uses
    }

    fn color_part(&self) -> usize {
        self.files[0].layers[self.color.mean.layer].part
    }

    fn planes(&self, planes: &Planes) -> Image {
        let file = &self.files[planes.file];
        file.planes(file.layers[planes.layer].part, &planes.channels)
    }

    fn raw(&self, source: &SignalSource) -> RawSignal {
        let planes = |planes: &Option<Planes>| planes.as_ref().map(|planes| self.planes(planes));
        RawSignal {
            mean: self.planes(&source.mean),
            half_a: planes(&source.half_a),
            half_b: planes(&source.half_b),
            variance_of_mean: planes(&source.variance),
        }
    }
}

/// The colour of a reference image: three planes, R, G, B (equal ones for a luminance-only image).
///
/// # Errors
/// As [`BufferSet::read`] for a file or layer that cannot be read.
pub fn read_reference(path: &Path, layer: Option<&str>) -> Result<Image> {
    let file = ExrFile::read(path)?;
    let found = assign::color_layer(&file, layer)?;
    let channels = assign::color_channels(&file, found)?;
    Ok(file.planes(file.layers[found].part, &channels))
}
