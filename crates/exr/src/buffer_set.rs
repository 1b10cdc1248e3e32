//! A set of layers from one file or several.

use std::path::Path;

use stein::error::FileCause;
use stein::frame::{RawSignal, Repairs, SamplesPerPixel};
use stein::host_memory::{FreeMemory, Shortage};
use stein::image::Window;
use stein::text;
use stein::{Error, Extent, Frame, Image, Result};

use crate::assign;
use crate::file::ExrFile;
use crate::layer_ref::{LayerRef, LayerUse};
use crate::request::BufferSetRequest;
use crate::write::colored_channels;

/// Bytes per pixel for making a signal of a frame, besides its planes: marks of pixels to repair, of misses, and of
/// usable neighbours.
const STATE_BYTES: u64 = 6;

/// Some channels of one part of one of the set's files.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Planes {
    pub(crate) file: usize,
    pub(crate) layer: usize,
    /// Positions in the part's list of channels, one for each plane; a luminance is listed three times.
    pub(crate) channels: Vec<usize>,
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct SignalSource {
    pub(crate) mean: Planes,
    pub(crate) half_a: Option<Planes>,
    pub(crate) half_b: Option<Planes>,
    pub(crate) variance: Option<Planes>,
}

/// The layers of the input files and their use. Keeps the whole content of the files in memory, so that an output can
/// carry over everything that was not denoised.
#[derive(Clone, Debug)]
pub struct BufferSet {
    pub(crate) files: Vec<ExrFile>,
    pub(crate) color: SignalSource,
    pub(crate) features: Vec<(String, SignalSource)>,
    pub(crate) samples: Option<Planes>,
    pub(crate) layer_uses: Vec<LayerUse>,
}

impl BufferSet {
    /// Reads the files and decides the use of each layer.
    ///
    /// # Errors
    /// [`Error::File`] for a file that is missing, damaged or of a kind that cannot be read, for a file in which no
    /// layer or several can be the colour, and for a feature to skip that the input does not have. [`Error::Layer`] for
    /// a requested layer that does not exist, for a layer whose data window differs from the colour's, and for a half
    /// of the colour without the other or halves and variance of other channels, if nothing else tells the colour's
    /// noise. [`Error::Request`] for a feature that is given twice, and for more than
    /// [`MAX_FEATURES`](stein::frame::MAX_FEATURES). All other halves and variances that cannot be used are left out,
    /// and [`BufferSet::layer_uses`] says why.
    pub fn read(request: &BufferSetRequest) -> Result<Self> {
        assign::read(request)
    }

    /// Returns the input's path.
    pub fn input(&self) -> &Path {
        &self.files[0].path
    }

    /// Returns width and height of the data window, which all images of the set share.
    pub fn extent(&self) -> Extent {
        self.data_window().extent
    }

    /// Returns the data window: the position of the pixels in the input's coordinates.
    pub fn data_window(&self) -> Window {
        self.files[0].data_window(self.color_part())
    }

    /// Returns the display window: the whole picture. The data window may be a part of it, or exceed it.
    pub fn display_window(&self) -> Window {
        self.files[0].display_window()
    }

    /// Returns the noisy colour: always three planes, equal ones for a luminance-only image.
    pub fn color(&self) -> RawSignal {
        self.raw(&self.color)
    }

    /// Returns the name of the colour's layer; empty for plain `R G B`.
    pub fn color_layer(&self) -> &str {
        &self.files[0].layers[self.color.mean.layer].name
    }

    /// Returns the names of the features, in the order of their indices.
    pub fn feature_names(&self) -> impl ExactSizeIterator<Item = &str> {
        self.features.iter().map(|(name, _)| name.as_str())
    }

    /// Returns all features with their names, decoded one at a time.
    pub fn features(&self) -> impl ExactSizeIterator<Item = (&str, RawSignal)> {
        self.features.iter().map(|(name, source)| (name.as_str(), self.raw(source)))
    }

    /// Returns the samples per pixel: from a channel if there is one, else from the header (attribute `samples` or
    /// `samplesPerPixel`), else unknown.
    pub fn samples_per_pixel(&self) -> SamplesPerPixel {
        if let Some(planes) = &self.samples {
            return SamplesPerPixel::PerPixel(self.planes(planes));
        }
        let named = |name| self.files[0].number_attribute(self.color_part(), name);
        named("samples").or_else(|| named("samplesPerPixel")).map_or(SamplesPerPixel::Unknown, SamplesPerPixel::Uniform)
    }

    /// Returns a text in the input's header, of the colour's part or of the whole file.
    pub fn text_attribute(&self, name: &str) -> Option<String> {
        self.files[0].text_attribute(self.color_part(), name)
    }

    /// Returns every layer of every file, and its use.
    pub fn layer_uses(&self) -> &[LayerUse] {
        &self.layer_uses
    }

    /// Makes a frame: settles the meaning of the layers. The halves are taken to have equal numbers of samples, since
    /// no file says otherwise.
    ///
    /// # Errors
    /// As [`Frame::new`]; [`Error::File`] if there is not enough memory.
    pub fn to_frame(&self) -> Result<(Frame, Repairs)> {
        self.check_memory_for_frame(false)?;
        self.settle(self.color())
    }

    /// Makes a frame as [`BufferSet::to_frame`] does, with less memory: the set frees the stored samples of the colour
    /// and its noise, and of all files other than the input. The rest of the set serves
    /// [`write_estimate`](crate::write_estimate).
    ///
    /// # Errors
    /// As [`Frame::new`]; [`Error::File`] if there is not enough memory, or if the input is gone.
    pub fn take_frame(&mut self) -> Result<(Frame, Repairs)> {
        self.check_memory_for_frame(true)?;
        let color = self.take_color()?;
        let (frame, repairs) = self.settle(color)?;
        self.forget_other_files();
        if frame.color().half_spread.is_none() {
            self.restore_halves()?;
        }
        Ok((frame, repairs))
    }

    fn settle(&self, color: RawSignal) -> Result<(Frame, Repairs)> {
        Frame::from_raw(color, self.features().map(|(name, raw)| (name.to_owned(), raw)), self.samples_per_pixel())
    }

    /// Returns the colour as [`BufferSet::color`] does. Frees the samples of the colour and its noise if nothing but
    /// the colour is made of them: an output replaces them or leaves them out.
    ///
    /// # Errors
    /// [`Error::File`] if there is not enough memory.
    fn take_color(&mut self) -> Result<RawSignal> {
        let source = self.color.clone();
        let mut take = |planes: &Planes| {
            let part = self.part(planes);
            let needed_again = self.channels_needed_again(planes);
            let taken =
                self.files[planes.file].take_planes(part, &planes.channels, |channel| needed_again.contains(&channel));
            taken.map_err(|shortage| self.no_memory(shortage))
        };
        Ok(RawSignal {
            mean: take(&source.mean)?,
            half_a: source.half_a.as_ref().map(&mut take).transpose()?,
            half_b: source.half_b.as_ref().map(&mut take).transpose()?,
            variance_of_mean: source.variance.as_ref().map(&mut take).transpose()?,
        })
    }

    /// Reads the halves of the colour again if [`BufferSet::take_color`] freed them: an output shows them as they were
    /// if the frame has no use for them.
    ///
    /// # Errors
    /// [`Error::File`] if the input cannot be read any more.
    fn restore_halves(&mut self) -> Result<()> {
        for planes in [self.color.half_a.clone(), self.color.half_b.clone()]
            .into_iter()
            .flatten()
            .filter(|planes| planes.file == 0)
        {
            let part = self.part(&planes);
            self.files[0].restore(part, &planes.channels)?;
        }
        Ok(())
    }

    /// Frees the samples of files other than the input, except the samples that [`BufferSet::samples_per_pixel`] needs.
    fn forget_other_files(&mut self) {
        let samples = self.samples.clone();
        for (index, file) in self.files.iter_mut().enumerate().skip(1) {
            let kept = samples
                .as_ref()
                .filter(|planes| planes.file == index)
                .map(|planes| (file.layers[planes.layer].part, planes.channels.clone()));
            file.forget_samples(|part, channel| {
                kept.as_ref().is_some_and(|(kept_part, channels)| *kept_part == part && channels.contains(&channel))
            });
        }
    }

    /// Refuses to make a frame of the set if there is not enough memory for planes of f32 beside the stored samples. If
    /// the samples of the colour are `taken`, their memory is free again.
    ///
    /// # Errors
    /// [`Error::File`] with the needed and the free memory.
    fn check_memory_for_frame(&self, taken: bool) -> Result<()> {
        let pixels = self.extent().pixels() as u64;
        let count = |planes: &Option<Planes>| planes.as_ref().map_or(0, |planes| planes.channels.len() as u64);
        // The half spread replaces half A, and half B is freed.
        let kept =
            |source: &SignalSource| source.mean.channels.len() as u64 + count(&source.half_a) + count(&source.variance);
        let let_go = |source: &SignalSource| count(&source.half_b);
        let stored = |planes: &Planes| {
            let file = &self.files[planes.file];
            planes
                .channels
                .iter()
                .map(|channel| file.bytes_per_sample(file.layers[planes.layer].part, *channel))
                .sum::<u64>()
        };
        let color = [
            Some(&self.color.mean),
            self.color.half_a.as_ref(),
            self.color.half_b.as_ref(),
            self.color.variance.as_ref(),
        ];
        let stored = if taken { color.into_iter().flatten().map(stored).sum() } else { 0 };
        let while_color = (4 * (kept(&self.color) + let_go(&self.color))).saturating_sub(stored);
        let features = self.features.iter().map(|(_, source)| kept(source)).sum::<u64>();
        let one_feature = self.features.iter().map(|(_, source)| let_go(source)).max().unwrap_or(0);
        let with_features =
            (4 * (kept(&self.color) + features + one_feature + count(&self.samples))).saturating_sub(stored);
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

    /// Returns the channels of `planes` whose stored samples are needed again: something else is made of them, too, or
    /// they share a layer of the input with others, so that an output shows the layer as it was.
    fn channels_needed_again(&self, planes: &Planes) -> Vec<usize> {
        let layer = &self.files[planes.file].layers[planes.layer];
        if planes != &self.color.mean
            && colored_channels(layer).iter().any(|channel| !planes.channels.contains(channel))
        {
            return planes.channels.clone();
        }
        let of_signal = |source: &SignalSource| {
            [Some(source.mean.clone()), source.half_a.clone(), source.half_b.clone(), source.variance.clone()]
        };
        let signals = std::iter::once(&self.color).chain(self.features.iter().map(|(_, source)| source));
        let all: Vec<Planes> = signals.flat_map(of_signal).chain([self.samples.clone()]).flatten().collect();
        let users = |channel: usize| {
            let uses = |other: &&Planes| {
                other.file == planes.file && self.part(other) == self.part(planes) && other.channels.contains(&channel)
            };
            all.iter().filter(uses).count()
        };
        planes.channels.iter().copied().filter(|channel| users(*channel) > 1).collect()
    }

    pub(crate) fn color_part(&self) -> usize {
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

/// Reads the colour of a reference image: three planes, R, G, B (equal ones for a luminance-only image).
///
/// # Errors
/// As [`BufferSet::read`] for a file or layer that cannot be read.
pub fn read_reference(path: &Path, layer: Option<&str>) -> Result<Image> {
    let file = ExrFile::read(path)?;
    let found = assign::color_layer(&file, layer)?;
    let channels = assign::color_channels(&file, found)?;
    Ok(file.planes(file.layers[found].part, &channels))
}

/// Reads the reference of a file that has this extent.
///
/// # Errors
/// As [`read_reference`]; [`Error::File`] for a reference of another extent.
pub fn read_reference_for(input: &Path, extent: Extent, reference: &LayerRef) -> Result<Image> {
    let image = read_reference(&reference.file, reference.layer.as_deref())?;
    if image.extent == extent {
        return Ok(image);
    }
    Err(Error::File {
        path: reference.file.clone(),
        cause: FileCause::Other {
            problem: format!("is of {}, but {} of {extent}", image.extent, text::path(input)),
            remedy: "give a reference with the same resolution and crop".into(),
        },
    })
}
