//! A set of layers from one file or several.

use std::path::{Path, PathBuf};

use stein::error::{FileCause, LayerCause};
use stein::frame::{PayloadKind, PayloadLayer, RawSignal, Repairs, SamplesPerPixel, half_spread};
use stein::host_memory::{FreeMemory, Shortage};
use stein::image::Window;
use stein::{Error, Extent, Frame, Image, Result};

use crate::alpha;
use crate::assign;
use crate::classify::LayerId;
use crate::file::ExrFile;
use crate::layer_ref::{LayerRef, LayerUse};
use crate::layout::LayoutUse;
use crate::multiplier::{Multiplier, MultiplierKind};
use crate::picture_file::{Format, PngEncoding};
use crate::request::BufferSetRequest;
use crate::source::{self, PayloadSource, Picture, Planes, SignalSource, VarianceSource};
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

    /// Returns the layers that are denoised along with the colour of a picture: names and quantities, lights before
    /// the alphas that belong to them. The alpha of a layer with other channels is called like its channel, such as
    /// `A` or `beauty.A`.
    pub fn payload(&self, picture: usize) -> impl Iterator<Item = (&str, PayloadKind)> {
        self.pictures[picture].payload.iter().map(|source| (source.name.as_str(), source.kind))
    }

    /// Returns the noisy colour: always three planes, equal ones for a luminance-only image. It is multiplied by its
    /// alpha, also if the file holds straight colours.
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

    /// Returns the uses of the layers in the input itself.
    pub(crate) fn uses_in_input(&self) -> &[LayerUse] {
        // They come first.
        &self.layer_uses[..self.files[0].layers.len()]
    }

    /// Makes a frame of the first picture: settles the meaning of the layers. The halves are taken to have equal
    /// numbers of samples, since no file says otherwise. The frame gets the layers that are denoised along.
    ///
    /// # Errors
    /// As [`Frame::new`]; [`Error::File`] if there is not enough memory.
    pub fn to_frame(&self) -> Result<(Frame, Repairs)> {
        self.check_memory_for_frame(0, false)?;
        let color = self.color();
        let empty = self.empty_pixels(0, &color);
        let settled = self.settle(0, color, empty.as_deref())?;
        let layer = |source: &PayloadSource| payload_layer(source, self.raw(0, &source.signal));
        with_payload(settled, self.pictures[0].payload.iter().map(layer).collect())
    }

    /// Makes a frame of the first picture as [`BufferSet::to_frame`] does, with less memory: the set frees the stored
    /// samples of the colour and its noise, of the layers that are denoised along, and of all files other than the
    /// input. The rest of the set serves [`write_estimate`](crate::write_estimate).
    ///
    /// # Errors
    /// As [`Frame::new`]; [`Error::File`] if there is not enough memory, or if the input is gone.
    pub fn take_frame(&mut self) -> Result<(Frame, Repairs)> {
        // An output has the other pictures as they are.
        self.divide_products(|picture, _| picture > 0);
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
            let color = self.take_signal(picture, Taken::Color)?;
            let empty = self.empty_pixels(picture, &color);
            let settled = self.settle(picture, color, empty.as_deref())?;
            self.pictures[picture].empty = empty;
            let mut layers = Vec::new();
            for index in 0..self.pictures[picture].payload.len() {
                let raw = self.take_signal(picture, Taken::Payload(index))?;
                layers.push(payload_layer(&self.pictures[picture].payload[index], raw));
            }
            frames.push(with_payload(settled, layers)?);
        }
        self.forget_other_files();
        for (picture, (frame, _)) in frames.iter().enumerate() {
            if frame.color().half_spread.is_none() {
                self.restore_halves(picture)?;
            }
            // A layer that the frame does not have stays as it was.
            let is_left_out = |source: &&PayloadSource| !frame.payload().iter().any(|layer| layer.name == source.name);
            let left_out = self.pictures[picture].payload.iter().filter(is_left_out);
            let left_out: Vec<Planes> = left_out.map(|source| source.signal.mean.clone()).collect();
            left_out.iter().try_for_each(|planes| self.restore(planes))?;
        }
        Ok(frames)
    }

    /// Reads the pixels of a reference that a picture shows. If no layer of the reference is named, a layer with the
    /// name of the picture's colour is the reference, or else the file's colour. Straight colours are multiplied by
    /// their alpha.
    ///
    /// # Errors
    /// As [`read_reference`]; [`Error::Layer`] for a reference that lacks some of the pixels.
    pub fn read_reference(&self, picture: usize, reference: &LayerRef) -> Result<Image> {
        let file = ExrFile::read(&reference.file, self.png_encoding)?;
        self.color_of_reference(picture, reference, &file).map(|(color, _)| color)
    }

    /// Reads a reference as [`BufferSet::read_reference`] does, and its layers and alphas with the names of those that
    /// are denoised along, without the layers that lack some of the pixels.
    ///
    /// # Errors
    /// As [`BufferSet::read_reference`].
    pub fn read_references(&self, picture: usize, reference: &LayerRef) -> Result<References> {
        let file = ExrFile::read(&reference.file, self.png_encoding)?;
        let (color, color_layer) = self.color_of_reference(picture, reference, &file)?;
        let window = self.data_window_of(picture);
        let aligned = |planes: &Planes| {
            let (part, channels) = match file.layers[color_layer].channel("A") {
                // The colour of the reference may have another name.
                Some(alpha) if planes.layer == self.pictures[picture].color.mean.layer => {
                    (file.layers[color_layer].part, vec![alpha])
                }
                _ => source::same_layer(&self.files[0], &file, planes)?,
            };
            let own = source::window_of(&file, part, window);
            let covers = source::covers(own, self.window(planes, window)) || source::covers(own, window);
            covers.then(|| source::aligned(file.planes(part, &channels), own, window, 0.0))
        };
        let layer = |source: &PayloadSource| {
            let mut image = aligned(&source.signal.mean)?;
            for Multiplier { kind, mean, .. } in &source.signal.multipliers {
                match (kind, aligned(mean)) {
                    (MultiplierKind::Alpha, _) if !has_straight(&file) => {}
                    (_, Some(by)) => kind.multiply(&mut image, &by),
                    (MultiplierKind::Alpha, None) => {}
                    // Without its factor, a light is no product to compare.
                    (MultiplierKind::Factor, None) => return None,
                }
            }
            Some((source.name.clone(), image))
        };
        let own = &self.pictures[picture];
        let payload: Vec<(String, Image)> = own.payload.iter().filter_map(layer).collect();
        let is_alpha = |source: &&PayloadSource| Some(&source.signal.mean) == own.alpha.as_ref();
        let alpha = own.payload.iter().find(is_alpha);
        let alpha = alpha.and_then(|source| payload.iter().position(|(name, _)| *name == source.name));
        Ok(References { color, payload, alpha })
    }

    /// Returns the colour of a reference and its layer.
    fn color_of_reference(&self, picture: usize, reference: &LayerRef, file: &ExrFile) -> Result<(Image, usize)> {
        let window = self.data_window_of(picture);
        let like = &self.files[0].layers[self.pictures[picture].color.mean.layer];
        let layer = assign::same_or_color(file, like, self.pictures.len() == 1, reference.layer.as_deref())?;
        let part = file.layers[layer].part;
        let own = source::window_of(file, part, window);
        let refuse =
            |cause| Err(Error::Layer { path: reference.file.clone(), layer: file.layers[layer].title(), cause });
        if let Some(cause) = source::other_resolution(&self.files[0], window, file, part) {
            return refuse(cause);
        }
        if source::covers(own, window) {
            let mut image = file.planes(part, &assign::color_channels(file, layer)?);
            let alpha = file.layers[layer].channel("A").map(|alpha| (part, alpha));
            let alpha = alpha.or_else(|| {
                let (part, channels) =
                    source::same_layer(&self.files[0], file, self.pictures[picture].alpha.as_ref()?)?;
                (file.data_window(part) == own).then_some((part, channels[0]))
            });
            if let Some((part, alpha)) = alpha.filter(|_| self.pictures[picture].is_straight && has_straight(file)) {
                MultiplierKind::Alpha.multiply(&mut image, &file.planes(part, &[alpha]));
            }
            return Ok((source::aligned(image, own, window, 0.0), layer));
        }
        let (found, expected) = (own.to_string(), window.to_string());
        refuse(LayerCause::DataWindow { found, expected, color_file: self.input().to_owned() })
    }

    fn settle(&self, picture: usize, color: RawSignal, empty: Option<&[bool]>) -> Result<(Frame, Repairs)> {
        let features = self.features_of(picture).map(|(name, mut raw)| {
            if let Some(empty) = empty {
                alpha::leave_without_hits(name, &mut raw, empty);
            }
            (name.to_owned(), raw)
        });
        let own = &self.pictures[picture];
        let samples = own.samples.clone();
        let alpha = own.own_alpha().filter(|_| own.alpha_guides).map(|source| self.raw(picture, &source.signal));
        let alpha = alpha.and_then(|alpha| alpha::feature(&alpha, &samples));
        let features = features.chain(alpha.map(|alpha| (alpha::ALPHA.to_owned(), alpha)));
        let (frame, mut repairs) = Frame::from_raw(color, features, samples)?;
        repairs.notes.splice(0..0, self.notes.iter().cloned());
        if own.is_straight && empty.is_some_and(|empty| empty.iter().all(|empty| *empty)) {
            repairs.notes.push(
                "alpha is 0 everywhere, so that the whole picture is black; colours that are multiplied by alpha \
                 already are read with --alpha premultiplied"
                    .into(),
            );
        }
        Ok((frame, repairs))
    }

    /// Returns the pixels of a picture without hits; `None` without an alpha, or if alpha is left alone.
    pub(crate) fn empty_pixels(&self, picture: usize, color: &RawSignal) -> Option<Vec<bool>> {
        let own = &self.pictures[picture];
        let alpha = own.alpha.as_ref().filter(|_| !own.keeps_alpha)?;
        Some(alpha::empty_pixels(color, &self.image(picture, alpha, 0.0).planes[0]))
    }

    /// Returns a signal as [`BufferSet::color`] does. Frees the samples if nothing but the signal is made of them: an
    /// output replaces them or leaves them out.
    ///
    /// # Errors
    /// [`Error::File`] if there is not enough memory.
    fn take_signal(&mut self, picture: usize, taken: Taken) -> Result<RawSignal> {
        let own = &self.pictures[picture];
        let signal = match taken {
            Taken::Color => &own.color,
            Taken::Payload(index) => &own.payload[index].signal,
        };
        let (signal, samples) = (signal.clone(), own.samples.clone());
        let window = self.data_window_of(picture);
        source::settled_from(&signal, &samples, &mut |planes: &Planes, outside| {
            let part = self.part(planes);
            let needed_again = match taken {
                Taken::Color => self.channels_needed_again(picture, planes),
                Taken::Payload(index) => self.payload_needed_again(picture, index, planes),
            };
            let own = self.window(planes, window);
            let taken =
                self.files[planes.file].take_planes(part, &planes.channels, |channel| needed_again.contains(&channel));
            taken.map(|image| source::aligned(image, own, window, outside)).map_err(|shortage| self.no_memory(shortage))
        })
    }

    /// Reads the halves of the colour again if [`BufferSet::take_signal`] freed them: an output shows them as they were
    /// if the frame has no use for them.
    ///
    /// # Errors
    /// [`Error::File`] if the input cannot be read any more.
    fn restore_halves(&mut self, picture: usize) -> Result<()> {
        let color = &self.pictures[picture].color;
        let halves = [color.half_a.clone(), color.half_b.clone()].into_iter().flatten();
        halves.filter(|planes| planes.file == 0).try_for_each(|planes| self.restore(&planes))
    }

    /// Reads the layers that are denoised along again if their samples were given away and `is_wanted`, called with the
    /// picture and the layer, is true. Layers that were merged from seeds are in no file, and stay as they are.
    ///
    /// # Errors
    /// [`Error::File`] if the input cannot be read any more.
    pub(crate) fn restore_payload(&mut self, is_wanted: impl Fn(usize, &PayloadSource) -> bool) -> Result<()> {
        if !self.seeds.is_empty() {
            return Ok(());
        }
        let mut wanted = Vec::new();
        for (index, picture) in self.pictures.iter().enumerate() {
            let sources = picture.payload.iter().filter(|source| is_wanted(index, source));
            wanted.extend(sources.map(|source| source.signal.mean.clone()));
        }
        wanted.iter().try_for_each(|planes| self.restore(planes))
    }

    /// Reads channels of the input again if their samples were freed.
    ///
    /// # Errors
    /// [`Error::File`] if the input cannot be read any more.
    pub(crate) fn restore(&mut self, planes: &Planes) -> Result<()> {
        let part = self.part(planes);
        let is_freed = |channel: &usize| self.files[0].is_freed(part, *channel);
        let freed: Vec<usize> = planes.channels.iter().copied().filter(is_freed).collect();
        if freed.is_empty() { Ok(()) } else { self.files[0].restore(part, &freed) }
    }

    /// Frees the samples of files other than the input.
    fn forget_other_files(&mut self) {
        self.files.iter_mut().skip(1).for_each(|file| file.forget_samples(|_, _| false));
    }

    /// Notes that the values of a layer in memory are multiplied by its multipliers.
    pub(crate) fn mark_products(&mut self, id: LayerId) {
        for picture in &mut self.pictures {
            let payload = picture.payload.iter_mut().map(|source| &mut source.signal);
            let signals = std::iter::once(&mut picture.color).chain(payload).filter(|signal| signal.mean.id() == id);
            signals.for_each(|signal| signal.is_product = !signal.multipliers.is_empty());
        }
    }

    /// Divides layers in memory that are products by their multipliers if no filter changes them. `is_wanted` is called
    /// with the picture and the layer that is denoised along with its colour, or `None` for the colour.
    pub(crate) fn divide_products(&mut self, is_wanted: impl Fn(usize, Option<&PayloadSource>) -> bool) {
        for index in 0..self.pictures.len() {
            let own = &self.pictures[index];
            let payload = own.payload.iter().map(|source| (Some(source), &source.signal));
            let signals = std::iter::once((None, &own.color)).chain(payload);
            let is_product = |signal: &SignalSource| {
                let part = self.part(&signal.mean);
                signal.is_product && !signal.mean.channels.iter().any(|channel| self.files[0].is_freed(part, *channel))
            };
            let divided: Vec<(Planes, Image)> = signals
                .filter(|(source, signal)| is_product(signal) && is_wanted(index, *source))
                .map(|(_, signal)| (signal.mean.clone(), self.quotient(signal)))
                .collect();
            for (planes, image) in divided {
                let part = self.part(&planes);
                for (channel, plane) in planes.channels.iter().zip(image.planes) {
                    self.files[0].set_plane(part, *channel, plane);
                }
                let own = &mut self.pictures[index];
                let payload = own.payload.iter_mut().map(|source| &mut source.signal);
                let signals = std::iter::once(&mut own.color).chain(payload);
                signals.filter(|signal| signal.mean == planes).for_each(|signal| signal.is_product = false);
            }
        }
    }

    /// Returns the mean of a signal of the input as the input stores it, in its own window.
    pub(crate) fn quotient(&self, signal: &SignalSource) -> Image {
        let image = |planes: &Planes| self.files[0].planes(self.part(planes), &planes.channels);
        let window = |planes: &Planes| self.files[0].data_window(self.part(planes));
        let multipliers = signal.multipliers.iter().rev().filter(|_| signal.is_product);
        multipliers.fold(image(&signal.mean), |product, Multiplier { kind, mean, .. }| {
            let by = source::aligned(image(mean), window(mean), window(&signal.mean), 0.0);
            kind.divided(&product, &by)
        })
    }

    /// Refuses to make a frame of the set if there is not enough memory for planes of f32 beside the stored samples. If
    /// the samples of the colour are `taken`, their memory is free again.
    ///
    /// # Errors
    /// [`Error::File`] with the needed and the free memory.
    fn check_memory_for_frame(&self, picture: usize, taken: bool) -> Result<()> {
        let pixels = self.data_window_of(picture).extent.pixels() as u64;
        let Picture { color, features, samples_layer, payload, alpha, .. } = &self.pictures[picture];
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
        // The half spread of a layer that is denoised along is made while its mean and both halves are there.
        let along = payload.iter().map(|source| kept(&source.signal)).sum::<u64>();
        let multiplier = |source: &SignalSource| {
            let multipliers = source.pending_multipliers().iter();
            multipliers.map(|multiplier| multiplier.mean.channels.len() as u64).max().unwrap_or(0)
        };
        let one_layer = payload
            .iter()
            .map(|PayloadSource { signal, .. }| count(&signal.half_a) + let_go(signal) + multiplier(signal));
        let one_layer = one_layer.max();
        let with_payload = kept(color) + all_features + count(samples_layer) + along + one_layer.unwrap_or(0);
        let with_payload = (4 * with_payload).saturating_sub(stored);
        // Adds the marks for the repair of pixels and for pixels without hits, a copy of alpha, and alpha as a feature.
        let marks = STATE_BYTES + alpha.as_ref().map_or(0, |_| 5 + 12);
        let needed = pixels * (while_color.max(with_features).max(with_payload) + marks);
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
        self.channels_of_others(planes)
    }

    /// Returns the channels of `planes`, which belong to a layer that is denoised along, whose stored samples are
    /// needed again: something else is made of them, or an output does not replace all of them.
    fn payload_needed_again(&self, picture: usize, index: usize, planes: &Planes) -> Vec<usize> {
        let source = &self.pictures[picture].payload[index];
        let window = self.data_window_of(picture);
        let part = self.part(planes);
        // No filter changes a constant layer, so that it stays as it is.
        let is_constant = || planes.channels.iter().all(|channel| self.files[planes.file].is_constant(part, *channel));
        if *planes != source.signal.mean || !source::covers(window, self.window(planes, window)) || is_constant() {
            return planes.channels.clone();
        }
        self.channels_of_others(planes)
    }

    /// Returns the channels of `planes` that more than one signal is made of.
    fn channels_of_others(&self, planes: &Planes) -> Vec<usize> {
        let signals = self.pictures.iter().flat_map(|picture| picture.signals().chain(picture.payload_signals()));
        let all: Vec<&Planes> = signals.flat_map(SignalSource::planes).collect();
        let users = |channel: usize| {
            let uses = |other: &&&Planes| {
                other.file == planes.file && self.part(other) == self.part(planes) && other.channels.contains(&channel)
            };
            all.iter().filter(uses).count()
        };
        planes.channels.iter().copied().filter(|channel| users(*channel) > 1).collect()
    }

    /// Returns the data window of planes, which belong to a picture with the data window `picture`.
    pub(crate) fn window(&self, planes: &Planes, picture: Window) -> Window {
        source::window_of(&self.files[planes.file], self.part(planes), picture)
    }

    pub(crate) fn color_part(&self, picture: usize) -> usize {
        self.files[0].layers[self.pictures[picture].color.mean.layer].part
    }

    pub(crate) fn raw(&self, picture: usize, source: &SignalSource) -> RawSignal {
        let samples = &self.pictures[picture].samples;
        source::settled(source, samples, &|planes: &Planes, outside| self.image(picture, planes, outside))
    }

    /// Returns planes in the window of a picture.
    pub(crate) fn image(&self, picture: usize, planes: &Planes, outside: f32) -> Image {
        let window = self.data_window_of(picture);
        let image = self.files[planes.file].planes(self.part(planes), &planes.channels);
        source::aligned(image, self.window(planes, window), window, outside)
    }
}

/// A signal whose samples are given away.
#[derive(Clone, Copy)]
enum Taken {
    Color,
    /// The layer at this position among those that are denoised along.
    Payload(usize),
}

/// Noise-free images for a picture, multiplied by their alpha.
#[derive(Clone, Debug)]
pub struct References {
    /// The colour: three planes.
    pub color: Image,
    /// Names and images of layers that are denoised along, in the order of [`BufferSet::payload`].
    pub payload: Vec<(String, Image)>,
    /// Index of the colour's alpha in `payload`; `None` without one.
    pub alpha: Option<usize>,
}

/// Whether a file may hold straight colours: the decoder multiplies those of PNG files by their alpha.
fn has_straight(file: &ExrFile) -> bool {
    file.format != Format::Png
}

fn payload_layer(source: &PayloadSource, raw: RawSignal) -> PayloadLayer {
    let half_spread = raw.half_a.as_ref().zip(raw.half_b.as_ref()).map(|(a, b)| half_spread(a, b, 1.0, 1.0));
    let mut mean = raw.mean;
    if source.kind == PayloadKind::Alpha {
        alpha::clamp(&mut mean);
    }
    PayloadLayer { name: source.name.clone(), kind: source.kind, mean, half_spread }
}

/// Adds layers to a frame and their repairs to those of the frame.
fn with_payload((frame, mut repairs): (Frame, Repairs), layers: Vec<PayloadLayer>) -> Result<(Frame, Repairs)> {
    let (frame, more) = frame.with_payload(layers)?;
    repairs.layers.extend(more.layers);
    repairs.notes.extend(more.notes);
    Ok((frame, repairs))
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
