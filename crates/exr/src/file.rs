//! One file in memory, OpenEXR or as if it were: every part and channel as it was stored, and the layers that the
//! channel names form.

use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};

use exr::meta::attribute::Matrix4x4;
use exr::prelude::*;

use crate::header::Trouble;
use crate::layers::{FileChannel, FileLayer, layers_of};
use crate::names;
use crate::picture_file::{self, Format, PngEncoding};
use stein::error::{Error, FileCause, Result};
use stein::host_memory::{Shortage, try_collected};
use stein::image::{Extent, Image, Window};
use stein::text;

/// The whole content of a file. Samples keep the type in which they were stored, so that everything that is not
/// replaced can be written back bit by bit.
#[derive(Clone, Debug)]
pub(crate) struct ExrFile {
    pub(crate) path: PathBuf,
    pub(crate) image: FlatImage,
    pub(crate) layers: Vec<FileLayer>,
    /// How the samples of each channel of each part are stored in the file; in memory they may be of another type.
    pub(crate) stored_types: Vec<Vec<SampleType>>,
    pub(crate) format: Format,
}

impl ExrFile {
    /// Reads everything in the file. Never panics, whatever the bytes are, and takes no more memory than the bytes can
    /// be decoded to.
    pub(crate) fn read(path: &Path, encoding: PngEncoding) -> Result<Self> {
        let (mut image, format) =
            read(path, encoding).map_err(|Trouble(cause)| Error::File { path: path.to_owned(), cause })?;
        image.layer_data.iter_mut().for_each(mend_overshoots);
        Ok(Self::of_image(path.to_owned(), image, format))
    }

    fn of_image(path: PathBuf, image: FlatImage, format: Format) -> Self {
        let layers = layers_of(&image);
        let types = |layer: &Layer<AnyChannels<FlatSamples>>| {
            layer.channel_data.list.iter().map(|channel| type_of(&channel.sample_data)).collect()
        };
        let stored_types = image.layer_data.iter().map(types).collect();
        Self { path, image, layers, stored_types, format }
    }

    /// Returns the file with all names and types, but without any samples.
    pub(crate) fn clone_without_samples(&self) -> Self {
        let emptied = |layer: &Layer<AnyChannels<FlatSamples>>| {
            let channel = |channel: &AnyChannel<FlatSamples>| AnyChannel {
                name: channel.name.clone(),
                sample_data: empty(type_of(&channel.sample_data)),
                ..*channel
            };
            Layer {
                channel_data: AnyChannels { list: layer.channel_data.list.iter().map(channel).collect() },
                attributes: layer.attributes.clone(),
                ..*layer
            }
        };
        let layer_data = self.image.layer_data.iter().map(emptied).collect();
        Self {
            path: self.path.clone(),
            image: FlatImage { attributes: self.image.attributes.clone(), layer_data },
            layers: self.layers.clone(),
            stored_types: self.stored_types.clone(),
            format: self.format,
        }
    }

    /// Whether the format knows windows; in other formats the first pixel is at (0, 0).
    pub(crate) fn has_windows(&self) -> bool {
        self.format == Format::OpenExr
    }

    /// Returns the number of parts.
    pub(crate) fn parts(&self) -> usize {
        self.image.layer_data.len()
    }

    /// Returns one channel of a part, as f32.
    pub(crate) fn plane(&self, part: usize, channel: usize) -> Vec<f32> {
        to_f32(&self.image.layer_data[part].channel_data.list[channel].sample_data)
    }

    /// Returns the names of the cryptomattes that the header lists.
    pub(crate) fn cryptomattes(&self) -> Vec<String> {
        let attributes = self.attributes().into_iter();
        let listed = attributes.filter(|(name, _)| name.starts_with("cryptomatte/") && name.ends_with("/name"));
        listed.map(|(_, value)| value).filter(|value| !value.is_empty()).collect()
    }

    /// Returns the camera matrices of the first part, if the header has them.
    pub(crate) fn cameras(&self) -> [Option<Matrix4x4>; 2] {
        let attributes = &self.image.layer_data[0].attributes;
        [attributes.world_to_camera, attributes.world_to_normalized_device]
    }

    /// Returns the view that the first part shows, if the header says so.
    pub(crate) fn view(&self) -> Option<String> {
        // A file of several views is told apart by its layers.
        let views = self.image.layer_data.iter().map(|layer| layer.attributes.view_name.as_ref());
        let first = views.clone().next().flatten()?;
        let is_only = views.into_iter().all(|view| view.is_none_or(|view| view == first));
        is_only.then(|| names::decoded(first.as_slice()))
    }

    /// Replaces the samples of a channel in memory.
    pub(crate) fn set_plane(&mut self, part: usize, channel: usize, plane: Vec<f32>) {
        self.image.layer_data[part].channel_data.list[channel].sample_data = FlatSamples::F32(plane);
    }

    pub(crate) fn data_window(&self, part: usize) -> Window {
        let layer = &self.image.layer_data[part];
        let position = layer.attributes.layer_position;
        Window { x: position.0, y: position.1, extent: extent(layer.size) }
    }

    pub(crate) fn display_window(&self) -> Window {
        let bounds = self.image.attributes.display_window;
        Window { x: bounds.position.0, y: bounds.position.1, extent: extent(bounds.size) }
    }

    /// Returns the planes of some channels of a part, as f32.
    pub(crate) fn planes(&self, part: usize, channels: &[usize]) -> Image {
        let layer = &self.image.layer_data[part];
        let planes = channels.iter().map(|&channel| to_f32(&layer.channel_data.list[channel].sample_data)).collect();
        Image { extent: extent(layer.size), planes }
    }

    /// Returns the planes of some channels of a part, as f32. Frees the stored samples of each channel for which
    /// `is_kept` is false, and leaves an empty vector of their type.
    pub(crate) fn take_planes(
        &mut self,
        part: usize,
        channels: &[usize],
        is_kept: impl Fn(usize) -> bool,
    ) -> std::result::Result<Image, Shortage> {
        let layer = &mut self.image.layer_data[part];
        let mut planes = Vec::with_capacity(channels.len());
        for (position, &channel) in channels.iter().enumerate() {
            let samples = &mut layer.channel_data.list[channel].sample_data;
            let is_needed_again = channels[position + 1..].contains(&channel);
            planes.push(match samples {
                FlatSamples::F32(values) if !is_needed_again && !is_kept(channel) => std::mem::take(values),
                samples => {
                    let plane = try_to_f32(samples)?;
                    if !is_needed_again && !is_kept(channel) {
                        forget(samples);
                    }
                    plane
                }
            });
        }
        Ok(Image { extent: extent(layer.size), planes })
    }

    /// Frees the stored samples of all channels, except those for which `is_kept`, called with part and channel, is
    /// true.
    pub(crate) fn forget_samples(&mut self, is_kept: impl Fn(usize, usize) -> bool) {
        for (part, layer) in self.image.layer_data.iter_mut().enumerate() {
            let channels = layer.channel_data.list.iter_mut().enumerate();
            channels
                .filter(|(channel, _)| !is_kept(part, *channel))
                .for_each(|(_, channel)| forget(&mut channel.sample_data));
        }
    }

    /// Whether the samples of a channel were freed.
    pub(crate) fn is_freed(&self, part: usize, channel: usize) -> bool {
        self.image.layer_data[part].channel_data.list[channel].sample_data.len() == 0
    }

    /// Whether all samples of a channel are equal.
    pub(crate) fn is_constant(&self, part: usize, channel: usize) -> bool {
        fn are_equal<T: PartialEq>(values: &[T]) -> bool {
            values.windows(2).all(|pair| pair[0] == pair[1])
        }
        match &self.image.layer_data[part].channel_data.list[channel].sample_data {
            FlatSamples::F16(values) => are_equal(values),
            FlatSamples::F32(values) => are_equal(values),
            FlatSamples::U32(values) => are_equal(values),
        }
    }

    /// Reads the freed samples of some channels of a part again.
    ///
    /// # Errors
    /// As [`ExrFile::read`], and if the file has changed since.
    pub(crate) fn restore(&mut self, part: usize, channels: &[usize]) -> Result<()> {
        let changed = || Error::File { path: self.path.clone(), cause: FileCause::Changed };
        // Halves beside the colour are in OpenEXR files alone.
        let mut again = Self::read(&self.path, PngEncoding::Srgb)?;
        for &channel in channels {
            let layer = &self.image.layer_data[part];
            let found = again.image.layer_data.get_mut(part).filter(|found| found.size == layer.size);
            let found = found
                .and_then(|found| found.channel_data.list.get_mut(channel))
                .filter(|found| found.name == layer.channel_data.list[channel].name);
            let samples = std::mem::replace(&mut found.ok_or_else(changed)?.sample_data, FlatSamples::F16(Vec::new()));
            self.image.layer_data[part].channel_data.list[channel].sample_data = samples;
        }
        Ok(())
    }

    pub(crate) fn sample_type(&self, layer: &FileLayer, channel: usize) -> SampleType {
        self.stored_types[layer.part][layer.channels[channel].index]
    }

    pub(crate) fn bytes_per_sample(&self, part: usize, channel: usize) -> u64 {
        match self.image.layer_data[part].channel_data.list[channel].sample_data {
            FlatSamples::F16(_) => 2,
            FlatSamples::F32(_) | FlatSamples::U32(_) => 4,
        }
    }

    pub(crate) fn non_finite_values(&self, layer: &FileLayer) -> usize {
        let channels = &self.image.layer_data[layer.part].channel_data.list;
        let count = |channel: &FileChannel| match &channels[channel.index].sample_data {
            FlatSamples::F16(values) => values.iter().filter(|value| !value.is_finite()).count(),
            FlatSamples::F32(values) => values.iter().filter(|value| !value.is_finite()).count(),
            FlatSamples::U32(_) => 0,
        };
        layer.channels.iter().map(count).sum()
    }

    fn attribute(&self, part: usize, name: &str) -> Option<&AttributeValue> {
        let key = Text::new_or_none(name)?;
        let part = &self.image.layer_data[part].attributes.other;
        part.get(&key).or_else(|| self.image.attributes.other.get(&key))
    }

    /// Returns the names and values of all attributes of all parts that no reader of the format has to know. The value
    /// of an attribute that is no text is empty.
    pub(crate) fn attributes(&self) -> Vec<(String, String)> {
        let parts = self.image.layer_data.iter().map(|layer| &layer.attributes);
        let others = parts.clone().map(|attributes| &attributes.other).chain([&self.image.attributes.other]);
        let text = |value: &AttributeValue| match value {
            AttributeValue::Text(text) => names::decoded(text.as_slice()),
            AttributeValue::I32(value) => value.to_string(),
            AttributeValue::F32(value) => value.to_string(),
            AttributeValue::F64(value) => value.to_string(),
            _ => String::new(),
        };
        let mut all: Vec<(String, String)> =
            others.flatten().map(|(name, value)| (names::decoded(name.as_slice()), text(value))).collect();
        // The decoder has fields for these.
        for attributes in parts {
            let known = [
                ("Software", &attributes.software_name),
                ("owner", &attributes.owner),
                ("comments", &attributes.comments),
            ];
            for (name, value) in known {
                all.extend(value.iter().map(|value| (name.to_owned(), names::decoded(value.as_slice()))));
            }
        }
        all.sort();
        all
    }

    /// Returns a text that the header stores under `name`, for the given part or for the whole file.
    pub(crate) fn text_attribute(&self, part: usize, name: &str) -> Option<String> {
        match self.attribute(part, name)? {
            AttributeValue::Text(text) => Some(names::decoded(text.as_slice())),
            _ => None,
        }
    }

    /// Returns a number that the header stores under `name`, as text, whole number or float, for the given part or for
    /// the whole file.
    pub(crate) fn number_attribute(&self, part: usize, name: &str) -> Option<f32> {
        match self.attribute(part, name)? {
            AttributeValue::Text(text) => text.to_string().trim().parse().ok(),
            AttributeValue::I32(value) => Some(*value as f32),
            AttributeValue::F32(value) => Some(*value),
            AttributeValue::F64(value) => Some(*value as f32),
            _ => None,
        }
    }

    /// Replaces a number that the header stores under `name`, wherever it does.
    pub(crate) fn set_number_attribute(&mut self, name: &str, number: f32) {
        let Some(key) = Text::new_or_none(name) else { return };
        let parts = self.image.layer_data.iter_mut().map(|layer| &mut layer.attributes.other);
        for attributes in parts.chain([&mut self.image.attributes.other]) {
            if let Some(value) = attributes.get_mut(&key) {
                match value {
                    AttributeValue::Text(text) => {
                        *text = Text::from_slice_unchecked(number.to_string().as_bytes());
                    }
                    AttributeValue::I32(value) => *value = number as i32,
                    AttributeValue::F32(value) => *value = number,
                    AttributeValue::F64(value) => *value = number.into(),
                    _ => {}
                }
            }
        }
    }

    /// Formats the names of the first layers, for messages.
    pub(crate) fn layer_list(&self) -> String {
        text::list(self.layers.iter().map(FileLayer::described))
    }

    /// Formats the layers as [`Self::layer_list`] does, but first the layers whose names are most like `wanted`, which
    /// is missing.
    pub(crate) fn layers_like(&self, wanted: &str) -> String {
        let wanted = wanted.to_lowercase();
        let likeness = |layer: &FileLayer| {
            let name = layer.name.to_lowercase();
            let last = names::last_component(&name);
            strsim::jaro_winkler(&name, &wanted).max(strsim::jaro_winkler(last, &wanted))
        };
        let mut layers: Vec<(f64, &FileLayer)> = self.layers.iter().map(|layer| (likeness(layer), layer)).collect();
        // Among equals, the order of the file stays.
        layers.sort_by(|(a, _), (b, _)| b.total_cmp(a));
        text::list(layers.into_iter().map(|(_, layer)| layer.described()))
    }
}

fn read(path: &Path, encoding: PngEncoding) -> std::result::Result<(FlatImage, Format), Trouble> {
    // Checks the kind before the file is opened: opening a pipe would block.
    let kind = path.metadata()?;
    if kind.is_dir() {
        return Err(Trouble(FileCause::Folder));
    }
    if !kind.is_file() {
        return Err(Trouble(FileCause::Stream));
    }
    let file = File::open(path)?;
    let bytes = file.metadata()?.len();
    let mut file = BufReader::new(file);
    let format = Format::from_content(file.fill_buf()?);
    Ok((picture_file::decode(&mut file, bytes, format, encoding)?, format))
}

/// Whether a channel is stored as waves, with a loss: under DWA, by its name. All other channels are stored without a
/// loss.
pub(crate) fn is_lossy(compression: Compression, name: &Text) -> bool {
    let name = name.as_slice();
    let suffix = name.iter().rposition(|byte| *byte == b'.').map_or(name, |dot| &name[dot + 1..]);
    let is_dwa = matches!(compression, Compression::DWAA(_) | Compression::DWAB(_));
    is_dwa && [&b"R"[..], b"G", b"B", b"Y", b"RY", b"BY"].iter().any(|known| suffix.eq_ignore_ascii_case(known))
}

/// Replaces infinite values of lossy channels. DWA stores no infinity, but waves, whose sum may overshoot the largest
/// half float if the values were near it. Such a value becomes the largest half float again, which is nearest to the
/// stored value.
fn mend_overshoots(layer: &mut Layer<AnyChannels<FlatSamples>>) {
    let compression = layer.encoding.compression;
    let lossy = layer.channel_data.list.iter_mut().filter(|channel| is_lossy(compression, &channel.name));
    for channel in lossy {
        match &mut channel.sample_data {
            FlatSamples::F16(values) => {
                let infinite = values.iter_mut().filter(|value| value.is_infinite());
                infinite.for_each(|value| *value = if value.is_sign_positive() { f16::MAX } else { f16::MIN });
            }
            FlatSamples::F32(values) => {
                let most = f16::MAX.to_f32();
                values.iter_mut().filter(|value| value.is_infinite()).for_each(|value| *value = most.copysign(*value));
            }
            FlatSamples::U32(_) => {}
        }
    }
}

fn extent(size: Vec2<usize>) -> Extent {
    // Larger sizes were refused when the file was decoded.
    Extent { width: size.0 as u32, height: size.1 as u32 }
}

fn forget(samples: &mut FlatSamples) {
    *samples = empty(type_of(samples));
}

pub(crate) fn type_of(samples: &FlatSamples) -> SampleType {
    match samples {
        FlatSamples::F16(_) => SampleType::F16,
        FlatSamples::F32(_) => SampleType::F32,
        FlatSamples::U32(_) => SampleType::U32,
    }
}

fn empty(kind: SampleType) -> FlatSamples {
    match kind {
        SampleType::F16 => FlatSamples::F16(Vec::new()),
        SampleType::F32 => FlatSamples::F32(Vec::new()),
        SampleType::U32 => FlatSamples::U32(Vec::new()),
    }
}

fn try_to_f32(samples: &FlatSamples) -> std::result::Result<Vec<f32>, Shortage> {
    match samples {
        FlatSamples::F16(values) => try_collected(values.iter().map(|value| value.to_f32())),
        FlatSamples::F32(values) => try_collected(values.iter().copied()),
        FlatSamples::U32(values) => try_collected(values.iter().map(|&value| value as f32)),
    }
}

fn to_f32(samples: &FlatSamples) -> Vec<f32> {
    match samples {
        FlatSamples::F16(values) => values.iter().map(|value| value.to_f32()).collect(),
        FlatSamples::F32(values) => values.clone(),
        FlatSamples::U32(values) => values.iter().map(|&value| value as f32).collect(),
    }
}
