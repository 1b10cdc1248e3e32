//! A set of layers, out of one file or several.

use std::path::Path;

use stein::frame::{RawSignal, Repairs, SamplesPerPixel};
use stein::host_memory::{FreeMemory, Shortage};
use stein::image::Window;
use stein::{Error, Extent, Frame, Image, Result};

use crate::assign;
use crate::file::ExrFile;
use crate::layer_ref::LayerUse;
use crate::request::BufferSetRequest;
use crate::write::colored_channels;

/// Bytes per pixel that settling a signal takes besides its planes: marks of pixels to repair, of misses, of neighbours
/// that are usable.
const STATE_BYTES: u64 = 6;

/// Some channels of one part of one of the set's files.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Planes {
    pub(crate) file: usize,
    pub(crate) layer: usize,
    /// Positions in the part's list of channels, one for each plane; a luminance stands three times.
    pub(crate) channels: Vec<usize>,
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct SignalSource {
    pub(crate) mean: Planes,
    pub(crate) half_a: Option<Planes>,
    pub(crate) half_b: Option<Planes>,
    pub(crate) variance: Option<Planes>,
}

/// What the files said. Keeps the files' whole content in memory, so that an output can carry over what was not
/// denoised.
#[derive(Clone, Debug)]
pub struct BufferSet {
    pub(crate) files: Vec<ExrFile>,
    pub(crate) color: SignalSource,
    pub(crate) features: Vec<(String, SignalSource)>,
    pub(crate) samples: Option<Planes>,
    pub(crate) layer_uses: Vec<LayerUse>,
}

impl BufferSet {
    /// Reads the files and decides which layer is what.
    ///
    /// # Errors
    /// A file that is missing, damaged or of a kind that cannot be read; a requested layer that does not exist; layers
    /// whose data windows differ from the colour's; a half of the colour without the other, or halves and variance of
    /// other channels, where nothing else tells the colour's noise; more than
    /// [`MAX_FEATURES`](stein::frame::MAX_FEATURES) requested features; one to skip that the input does not have.
    /// Halves and variances that cannot be used are else left out, and [`BufferSet::layer_uses`] says why.
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

    /// Samples per pixel: from a channel if there is one, else from the header (attribute `samples` or
    /// `samplesPerPixel`), else unknown.
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

    /// Settles the meaning of what the files said. The halves are taken to have equal numbers of samples, since no file
    /// says otherwise.
    ///
    /// # Errors
    /// As [`Frame::new`]; [`Error::File`] where memory would end.
    pub fn to_frame(&self) -> Result<(Frame, Repairs)> {
        self.check_memory_for_frame(false)?;
        self.settle(self.color())
    }

    /// As [`BufferSet::to_frame`], for large frames: the set lets go of the stored samples of the colour and its noise,
    /// and of all other files than the input. What is left of the set serves [`write_estimate`](crate::write_estimate).
    ///
    /// # Errors
    /// As [`Frame::new`]; [`Error::File`] where memory ends, or where the input is gone.
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

    /// As [`BufferSet::color`]. Samples of the colour and its noise are let go of where nothing but the colour is made
    /// of them: an output replaces them or leaves them out.
    ///
    /// # Errors
    /// [`Error::File`] where memory ends.
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

    /// Reads the halves of the colour again where [`BufferSet::take_color`] let go of them: an output shows them as
    /// they were where the frame has no use for them.
    ///
    /// # Errors
    /// [`Error::File`] where the input cannot be read any more.
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

    /// Lets go of what neither an output nor [`BufferSet::samples_per_pixel`] is made of: other files than the input.
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

    /// Refuses to make a frame of the set where memory would end: planes of f32 beside the stored samples, of which
    /// those of the colour go where they are `taken`.
    ///
    /// # Errors
    /// [`Error::File`] with what is needed and what is free.
    fn check_memory_for_frame(&self, taken: bool) -> Result<()> {
        let pixels = self.extent().pixels() as u64;
        let count = |planes: &Option<Planes>| planes.as_ref().map_or(0, |planes| planes.channels.len() as u64);
        // The half spread takes the place of half A, and half B goes.
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
        // What a pixel is to the repair of others.
        let needed = pixels * (while_color.max(with_features) + STATE_BYTES);
        FreeMemory::now().check(needed).map_err(|shortage| self.no_memory(shortage))
    }

    fn no_memory(&self, shortage: Shortage) -> Error {
        let problem = format!("cannot be made ready in memory: that {shortage}");
        Error::File { path: self.input().to_owned(), problem, remedy: Shortage::REMEDY.into() }
    }

    pub(crate) fn part(&self, planes: &Planes) -> usize {
        self.files[planes.file].layers[planes.layer].part
    }

    /// Channels among those of `planes` whose stored samples are needed again: something else is made of them, too, or
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
