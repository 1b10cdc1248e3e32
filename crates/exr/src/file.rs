//! One file in memory, OpenEXR or as if it were: every part and channel as it was stored, and the layers that the
//! channel names form.

use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};

use exr::prelude::*;

use crate::header::Trouble;
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
}

/// Channels of one part whose names share everything before the last dot.
#[derive(Clone, Debug)]
pub(crate) struct FileLayer {
    /// Name of the layer; empty for the channels of a single-part file that have no dot.
    pub(crate) name: String,
    pub(crate) part: usize,
    /// Channels in the order red, green, blue or x, y, z; alphabetical if the names say neither.
    pub(crate) channels: Vec<FileChannel>,
}

#[derive(Clone, Debug)]
pub(crate) struct FileChannel {
    /// Position in the part's list of channels.
    pub(crate) index: usize,
    /// The name after the last dot.
    pub(crate) suffix: String,
}

impl ExrFile {
    /// Reads everything in the file. Never panics, whatever the bytes are, and takes no more memory than the bytes can
    /// be decoded to.
    pub(crate) fn read(path: &Path) -> Result<Self> {
        let mut image = read(path).map_err(|Trouble(cause)| Error::File { path: path.to_owned(), cause })?;
        image.layer_data.iter_mut().for_each(mend_overshoots);
        let layers = layers_of(&image);
        Ok(Self { path: path.to_owned(), image, layers })
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

    /// Reads the freed samples of some channels of a part again.
    ///
    /// # Errors
    /// As [`ExrFile::read`], and if the file has changed since.
    pub(crate) fn restore(&mut self, part: usize, channels: &[usize]) -> Result<()> {
        let changed = || Error::File { path: self.path.clone(), cause: FileCause::Changed };
        let mut again = Self::read(&self.path)?;
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
        match self.image.layer_data[layer.part].channel_data.list[layer.channels[channel].index].sample_data {
            FlatSamples::F16(_) => SampleType::F16,
            FlatSamples::F32(_) => SampleType::F32,
            FlatSamples::U32(_) => SampleType::U32,
        }
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

impl FileLayer {
    /// Formats the layer's name and channels, for messages.
    pub(crate) fn described(&self) -> String {
        let channels: Vec<_> = self.channels.iter().map(|channel| text::name(&channel.suffix)).collect();
        let channels = channels.join(" ");
        if self.name.is_empty() { channels } else { format!("'{}' ({channels})", text::name(&self.name)) }
    }
}

fn read(path: &Path) -> std::result::Result<FlatImage, Trouble> {
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
    picture_file::decode(&mut file, bytes, format, PngEncoding::Srgb)
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
    match samples {
        FlatSamples::F16(values) => *values = Vec::new(),
        FlatSamples::F32(values) => *values = Vec::new(),
        FlatSamples::U32(values) => *values = Vec::new(),
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

/// Groups a file's channels into layers: names are split at their last dot.
///
/// Channels without a dot belong to the part. In a part with R, G and B (or a luminance Y) those and the alpha are the
/// part's own layer and every other channel, such as `Z` or `samples`, is a layer of its own. The part's own layer has
/// no name in a file of one part, else the part's.
///
/// Layers are told apart by the bytes of their names: two encodings may spell the same text.
fn layers_of(image: &FlatImage) -> Vec<FileLayer> {
    let many_parts = image.layer_data.len() > 1;
    let mut layers: Vec<(&[u8], FileLayer)> = Vec::new();
    for (part, layer) in image.layer_data.iter().enumerate() {
        let part_name = layer.attributes.layer_name.as_ref().map_or(&[][..], Text::as_slice);
        let own_name = if many_parts { part_name } else { &[] };
        let stored: Vec<&[u8]> = layer.channel_data.list.iter().map(|channel| channel.name.as_slice()).collect();
        let has = |wanted: &[u8]| stored.iter().any(|name| name.eq_ignore_ascii_case(wanted));
        let has_color = has(b"Y") && !has(b"X") || has(b"R") && has(b"G") && has(b"B");
        for (index, &name) in stored.iter().enumerate() {
            let (layer_name, suffix) = match name.iter().rposition(|byte| *byte == b'.') {
                Some(dot) => (&name[..dot], &name[dot + 1..]),
                None => {
                    let color = [b"R", b"G", b"B", b"A", b"Y"].iter().any(|color| name.eq_ignore_ascii_case(*color));
                    let own = if has_color { color } else { names::decoded(name).chars().count() == 1 };
                    (if own { own_name } else { name }, name)
                }
            };
            let channel = FileChannel { index, suffix: names::decoded(suffix) };
            if let Some((_, found)) =
                layers.iter_mut().find(|(other, found)| found.part == part && *other == layer_name)
            {
                found.channels.push(channel);
                continue;
            }
            let mut name = names::decoded(layer_name);
            if layers.iter().any(|(_, other)| other.part != part && other.name == name) {
                name = format!("{}.{name}", names::decoded(part_name));
            }
            layers.push((layer_name, FileLayer { name, part, channels: vec![channel] }));
        }
    }
    let mut layers: Vec<FileLayer> = layers.into_iter().map(|(_, layer)| layer).collect();
    for layer in &mut layers {
        layer.channels.sort_by_key(|channel| (channel_rank(&channel.suffix), channel.suffix.clone()));
    }
    layers
}

fn channel_rank(suffix: &str) -> usize {
    let order = ["r", "g", "b", "x", "y", "z", "u", "v", "w"];
    order.iter().position(|known| suffix.eq_ignore_ascii_case(known)).unwrap_or(order.len())
}
