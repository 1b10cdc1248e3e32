//! A set of layers from one file or several.

use std::path::{Path, PathBuf};

use stein::error::{FileCause, LayerCause};
use stein::frame::{RawSignal, Repairs, SamplesPerPixel};
use stein::host_memory::{FreeMemory, Shortage};
use stein::image::Window;
use stein::{Error, Extent, Frame, Image, Result};

use crate::assign;
use crate::file::ExrFile;
use crate::layer_ref::{LayerRef, LayerUse};
use crate::layout::LayoutUse;
use crate::picture_file::PngEncoding;
use crate::request::BufferSetRequest;
use crate::source::{self, Picture, Planes, SignalSource, VarianceSource};
use crate::write::Windows;

/// Bytes per pixel for making a signal of a frame, besides its planes: marks of pixels to repair, of misses, and of
/// usable neighbours.
const STATE_BYTES: u64 = 6;

/// The layers of the input files and their use. Keeps the whole content of the files in memory, so that an output can
/// carry over everything that was not denoised.
///
/// A file may hold several pictures, such as view layers or the views of both eyes: each is a colour with its own
/// features. Methods that do not name a picture mean the first.
#[derive(Clone, Debug)]
pub struct BufferSet {
    pub(crate) files: Vec<ExrFile>,
    pub(crate) pictures: Vec<Picture>,
    pub(crate) layout: LayoutUse,
    /// Remarks on the files, such as a file beside the input that cannot be used.
    pub(crate) notes: Vec<String>,
    /// Files that were found beside the input.
    pub(crate) siblings: Vec<PathBuf>,
    /// Renders of the same frame with other seeds, which were merged with the input.
    pub(crate) seeds: Vec<PathBuf>,
    /// Files that were found beside the seeds.
    pub(crate) seed_files: Vec<PathBuf>,
    /// Layers of the input that an output leaves out, because they belong to one seed alone.
    pub(crate) stale: Vec<usize>,
    /// Whether layers are left out because the number of samples is not known.
    pub(crate) lacks_samples: bool,
    /// Meaning of the values in PNG files.
    pub(crate) png_encoding: PngEncoding,
    pub(crate) layer_uses: Vec<LayerUse>,
}

impl BufferSet {
    /// Reads the files and decides the use of each layer.
    ///
    /// # Errors
    /// [`Error::File`] for a file that is missing, damaged or of a kind that cannot be read, for a file in which no
    /// layer or several can be the colour, for a feature to skip that the input does not have, for an unknown layout,
    /// and for seeds that do not show one frame. [`Error::Layer`] for a requested layer that does not exist, for a
    /// requested layer that does not cover the colour's pixels, for a half of the colour without the other or halves
    /// and variance of other channels, if nothing else tells the colour's noise, and for a variance of one sample
    /// without the number of samples. [`Error::Request`] for a feature that is given twice, for more than
    /// [`MAX_FEATURES`](stein::frame::MAX_FEATURES), and for layers that are given for one of several pictures. All
    /// other halves and variances that cannot be used are left out, and [`BufferSet::layer_uses`] says why.
    pub fn read(request: &BufferSetRequest) -> Result<Self> {
        assign::read(request)
    }

    /// Returns the input's path.
    pub fn input(&self) -> &Path {
        &self.files[0].path
    }

    /// Returns the layout by which the input was read.
    pub fn layout(&self) -> &LayoutUse {
        &self.layout
    }

    /// Returns the files that were found beside the input and belong to it.
    pub fn siblings(&self) -> &[PathBuf] {
        &self.siblings
    }

    /// Returns all files that were read.
    pub fn files(&self) -> impl Iterator<Item = &Path> {
        let of_seeds = self.seeds.iter().chain(&self.seed_files).map(PathBuf::as_path);
        self.files.iter().map(|file| file.path.as_path()).chain(of_seeds)
    }

    /// Returns remarks on the files.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// Returns the renders with other seeds that were merged with the input.
    pub fn seeds(&self) -> &[PathBuf] {
        &self.seeds
    }

    /// Returns the colours' layers of all pictures. A name is empty for plain `R G B`.
    pub fn pictures(&self) -> impl ExactSizeIterator<Item = &str> {
        self.pictures.iter().map(|picture| self.files[0].layers[picture.color.mean.layer].name.as_str())
    }

    /// Returns width and height of the data window of the first picture.
    pub fn extent(&self) -> Extent {
        self.data_window().extent
    }

    /// Returns the data window: the position of the first picture's pixels in the input's coordinates.
    pub fn data_window(&self) -> Window {
        self.data_window_of(0)
    }

    /// Returns the data window of a picture.
    pub fn data_window_of(&self, picture: usize) -> Window {
        self.files[0].data_window(self.color_part(picture))
    }

    /// Returns the display window: the whole picture. The data window may be a part of it, or exceed it.
    pub fn display_window(&self) -> Window {
        self.files[0].display_window()
    }

    /// Returns both windows of the first picture.
    pub fn windows(&self) -> Windows {
        Windows { data: self.data_window(), display: self.display_window() }
    }

    /// Returns the noisy colour: always three planes, equal ones for a luminance-only image.
    pub fn color(&self) -> RawSignal {
        self.raw(0, &self.pictures[0].color)
    }

    /// Returns the name of the colour's layer; empty for plain `R G B`.
    pub fn color_layer(&self) -> &str {
        &self.files[0].layers[self.pictures[0].color.mean.layer].name
    }

    /// Returns the names of the features, in the order of their indices.
    pub fn feature_names(&self) -> impl ExactSizeIterator<Item = &str> {
        self.pictures[0].features.iter().map(|(name, _)| name.as_str())
    }

    /// Returns all features with their names, decoded one at a time.
    pub fn features(&self) -> impl ExactSizeIterator<Item = (&str, RawSignal)> {
        self.features_of(0)
    }

    fn features_of(&self, picture: usize) -> impl ExactSizeIterator<Item = (&str, RawSignal)> {
        let features = self.pictures[picture].features.iter();
        features.map(move |(name, source)| (name.as_str(), self.raw(picture, source)))
    }

    /// Returns the samples per pixel: as requested, else from a channel, else from the header, else unknown.
    pub fn samples_per_pixel(&self) -> SamplesPerPixel {
        self.pictures[0].samples.clone()
    }

    /// Returns whether variances are left out because the samples per pixel are not known.
    pub fn lacks_samples(&self) -> bool {
        self.lacks_samples
    }

    /// Returns a text in the input's header, of the colour's part or of the whole file.
    pub fn text_attribute(&self, name: &str) -> Option<String> {
        self.files[0].text_attribute(self.color_part(0), name)
    }

    /// Returns every layer of every file, and its use.
    pub fn layer_uses(&self) -> &[LayerUse] {
        &self.layer_uses
    }

    /// Returns the alpha of the first picture, if its layer has one.
    pub(crate) fn alpha(&self) -> Option<Image> {
        let layer = &self.files[0].layers[self.pictures[0].color.mean.layer];
        let alpha = layer.channel("A").filter(|_| layer.channels.len() > 1)?;
        Some(self.files[0].planes(layer.part, &[alpha]))
    }

    /// Returns the uses of the layers in the input itself.
    pub(crate) fn uses_in_input(&self) -> &[LayerUse] {
        // They come first.
        &self.layer_uses[..self.files[0].layers.len()]
    }

    /// Makes a frame of the first picture: settles the meaning of the layers. The halves are taken to have equal
    /// numbers of samples, since no file says otherwise.
    ///
    /// # Errors
    /// As [`Frame::new`]; [`Error::File`] if there is not enough memory.
    pub fn to_frame(&self) -> Result<(Frame, Repairs)> {
        self.check_memory_for_frame(0, false)?;
        self.settle(0, self.color())
    }

    /// Makes a frame of the first picture as [`BufferSet::to_frame`] does, with less memory: the set frees the stored
    /// samples of the colour and its noise, and of all files other than the input. The rest of the set serves
    /// [`write_estimate`](crate::write_estimate).
    ///
    /// # Errors
    /// As [`Frame::new`]; [`Error::File`] if there is not enough memory, or if the input is gone.
    pub fn take_frame(&mut self) -> Result<(Frame, Repairs)> {
        self.pictures.truncate(1);
        let mut frames = self.take_frames()?;
        Ok(frames.swap_remove(0))
    }

    /// Makes a frame of each picture, as [`BufferSet::take_frame`] does of the first.
    ///
    /// # Errors
    /// As [`BufferSet::take_frame`].
    pub fn take_frames(&mut self) -> Result<Vec<(Frame, Repairs)>> {
        let mut frames = Vec::with_capacity(self.pictures.len());
        for picture in 0..self.pictures.len() {
            self.check_memory_for_frame(picture, true)?;
            let color = self.take_color(picture)?;
            frames.push(self.settle(picture, color)?);
        }
        self.forget_other_files();
        for (picture, (frame, _)) in frames.iter().enumerate() {
            if frame.color().half_spread.is_none() {
                self.restore_halves(picture)?;
            }
        }
        Ok(frames)
    }

    /// Reads the pixels of a reference that a picture shows. If no layer of the reference is named, a layer with the
    /// name of the picture's colour is the reference, or else the file's colour.
    ///
    /// # Errors
    /// As [`read_reference`]; [`Error::Layer`] for a reference that lacks some of the pixels.
    pub fn read_reference(&self, picture: usize, reference: &LayerRef) -> Result<Image> {
        let window = self.data_window_of(picture);
        let like = &self.files[0].layers[self.pictures[picture].color.mean.layer];
        let file = ExrFile::read(&reference.file, self.png_encoding)?;
        let layer = assign::same_or_color(&file, like, self.pictures.len() == 1, reference.layer.as_deref())?;
        let part = file.layers[layer].part;
        let own = source::window_of(&file, part, window);
        let refuse =
            |cause| Err(Error::Layer { path: reference.file.clone(), layer: file.layers[layer].title(), cause });
        if let Some(cause) = source::other_resolution(&self.files[0], window, &file, part) {
            return refuse(cause);
        }
        if source::covers(own, window) {
            let image = file.planes(part, &assign::color_channels(&file, layer)?);
            return Ok(source::aligned(image, own, window, 0.0));
        }
        let (found, expected) = (own.to_string(), window.to_string());
        refuse(LayerCause::DataWindow { found, expected, color_file: self.input().to_owned() })
    }

    fn settle(&self, picture: usize, color: RawSignal) -> Result<(Frame, Repairs)> {
        let features = self.features_of(picture).map(|(name, raw)| (name.to_owned(), raw));
        let samples = self.pictures[picture].samples.clone();
        let (frame, mut repairs) = Frame::from_raw(color, features, samples)?;
        repairs.notes.splice(0..0, self.notes.iter().cloned());
        Ok((frame, repairs))
    }

    /// Returns the colour as [`BufferSet::color`] does. Frees the samples of the colour and its noise if nothing but
    /// the colour is made of them: an output replaces them or leaves them out.
    ///
    /// # Errors
    /// [`Error::File`] if there is not enough memory.
    fn take_color(&mut self, picture: usize) -> Result<RawSignal> {
        let Picture { color, samples, .. } = self.pictures[picture].clone();
        let window = self.data_window_of(picture);
        source::settled_from(&color, &samples, &mut |planes: &Planes, outside| {
            let part = self.part(planes);
            let needed_again = self.channels_needed_again(picture, planes);
            let own = source::window_of(&self.files[planes.file], part, window);
            let taken =
                self.files[planes.file].take_planes(part, &planes.channels, |channel| needed_again.contains(&channel));
            taken.map(|image| source::aligned(image, own, window, outside)).map_err(|shortage| self.no_memory(shortage))
        })
    }

    /// Reads the halves of the colour again if [`BufferSet::take_color`] freed them: an output shows them as they were
    /// if the frame has no use for them.
    ///
    /// # Errors
    /// [`Error::File`] if the input cannot be read any more.
    fn restore_halves(&mut self, picture: usize) -> Result<()> {
        let color = &self.pictures[picture].color;
        let halves = [color.half_a.clone(), color.half_b.clone()].into_iter().flatten();
        for planes in halves.filter(|planes| planes.file == 0) {
            let part = self.part(&planes);
            self.files[0].restore(part, &planes.channels)?;
        }
        Ok(())
    }

    /// Frees the samples of files other than the input.
    fn forget_other_files(&mut self) {
        self.files.iter_mut().skip(1).for_each(|file| file.forget_samples(|_, _| false));
    }

    /// Refuses to make a frame of the set if there is not enough memory for planes of f32 beside the stored samples. If
    /// the samples of the colour are `taken`, their memory is free again.
    ///
    /// # Errors
    /// [`Error::File`] with the needed and the free memory.
    fn check_memory_for_frame(&self, picture: usize, taken: bool) -> Result<()> {
        let pixels = self.data_window_of(picture).extent.pixels() as u64;
        let Picture { color, features, samples_layer, .. } = &self.pictures[picture];
        let count = |planes: &Option<Planes>| planes.as_ref().map_or(0, |planes| planes.channels.len() as u64);
        let of_variance = |variance: &Option<VarianceSource>| {
            variance.as_ref().map_or(0, |variance| variance.planes.channels.len() as u64)
        };
        // The half spread replaces half A, and half B is freed.
        let kept = |source: &SignalSource| {
            source.mean.channels.len() as u64 + count(&source.half_a) + of_variance(&source.variance)
        };
        let let_go = |source: &SignalSource| count(&source.half_b);
        let stored = |planes: &Planes| {
            let file = &self.files[planes.file];
            let bytes = |channel: &usize| file.bytes_per_sample(file.layers[planes.layer].part, *channel);
            planes.channels.iter().map(bytes).sum::<u64>()
        };
        let stored = if taken { color.planes().map(stored).sum() } else { 0 };
        let while_color = (4 * (kept(color) + let_go(color))).saturating_sub(stored);
        let all_features = features.iter().map(|(_, source)| kept(source)).sum::<u64>();
        let one_feature = features.iter().map(|(_, source)| let_go(source)).max().unwrap_or(0);
        let with_features =
            (4 * (kept(color) + all_features + one_feature + count(samples_layer))).saturating_sub(stored);
        // Adds the marks for the repair of pixels.
        let needed = pixels * (while_color.max(with_features) + STATE_BYTES);
        FreeMemory::now().check(needed).map_err(|shortage| self.no_memory(shortage))
    }

    fn no_memory(&self, shortage: Shortage) -> Error {
        let cause = FileCause::NoMemory { doing: "made ready", shortage };
        Error::File { path: self.input().to_owned(), cause }
    }

    pub(crate) fn part(&self, planes: &Planes) -> usize {
        self.files[planes.file].layers[planes.layer].part
    }

    /// Returns the channels of `planes`, which belong to a colour, whose stored samples are needed again: something
    /// else is made of them, too, or they share a layer of the input with others, so that an output shows the layer as
    /// it was.
    fn channels_needed_again(&self, picture: usize, planes: &Planes) -> Vec<usize> {
        let color = &self.pictures[picture].color;
        let is_replaced = |other: &Planes| {
            let replaced = [Some(&color.mean), color.half_a.as_ref(), color.half_b.as_ref()];
            let variance = color.variance.as_ref().map(|variance| &variance.planes);
            replaced.into_iter().chain([variance]).flatten().any(|replaced| replaced == other)
        };
        // Means of second moments stay in the output.
        if !is_replaced(planes) {
            return planes.channels.clone();
        }
        let layer = &self.files[planes.file].layers[planes.layer];
        if planes != &color.mean && layer.without_alpha().iter().any(|channel| !planes.channels.contains(channel)) {
            return planes.channels.clone();
        }
        let signals = self.pictures.iter().flat_map(Picture::signals).flat_map(SignalSource::planes);
        let all: Vec<&Planes> = signals.collect();
        let users = |channel: usize| {
            let uses = |other: &&&Planes| {
                other.file == planes.file && self.part(other) == self.part(planes) && other.channels.contains(&channel)
            };
            all.iter().filter(uses).count()
        };
        planes.channels.iter().copied().filter(|channel| users(*channel) > 1).collect()
    }

    pub(crate) fn color_part(&self, picture: usize) -> usize {
        self.files[0].layers[self.pictures[picture].color.mean.layer].part
    }

    fn raw(&self, picture: usize, source: &SignalSource) -> RawSignal {
        let window = self.data_window_of(picture);
        source::settled(source, &self.pictures[picture].samples, &|planes: &Planes, outside| {
            let file = &self.files[planes.file];
            let part = file.layers[planes.layer].part;
            let image = file.planes(part, &planes.channels);
            source::aligned(image, source::window_of(file, part, window), window, outside)
        })
    }
}

/// Returns what people call a picture by its layer: plain `R G B` has no name.
pub fn picture_name(layer: &str) -> &str {
    if layer.is_empty() { "R G B" } else { layer }
}

/// Reads the colour of a reference image: three planes, R, G, B (equal ones for a luminance-only image). The values of
/// a PNG file follow the curve of sRGB.
///
/// # Errors
/// As [`BufferSet::read`] for a file or layer that cannot be read.
pub fn read_reference(path: &Path, layer: Option<&str>) -> Result<Image> {
    let file = ExrFile::read(path, PngEncoding::Srgb)?;
    let found = assign::color_layer_of(&file, layer)?;
    let channels = assign::color_channels(&file, found)?;
    Ok(file.planes(file.layers[found].part, &channels))
}
