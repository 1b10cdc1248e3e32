//! Writes the denoised picture in the layout of its input: the same header, parts, windows and layers, but other
//! pixels.

use std::collections::HashMap;
use std::io::{BufWriter, Write};
use std::path::Path;

use exr::meta::attribute::TimeCode;
use exr::prelude::*;

use crate::BufferSet;
use crate::atomic_file;
use crate::file::{ExrFile, is_lossy};
use crate::header::settle;
use crate::names::{LONGEST_NAME, encoded};
use stein::error::{Error, FileCause, LayerCause, RequestCause, Result};
use stein::image::{Extent, Image, Window};
use stein::text;

/// A layer to add to an output.
#[derive(Clone, Debug)]
pub struct NamedLayer {
    /// Name of the layer, which a dot joins with the names of the channels.
    pub name: String,
    /// Names of the channels, one for each plane, such as `R`, `G`, `B`.
    pub channels: Vec<String>,
    /// Pixels, of the input's extent.
    pub image: Image,
}

/// Layers that an output replaces, leaves out or adds, compared with its input.
#[derive(Clone, Debug)]
pub struct DenoisedLayers<'a> {
    /// Three planes R, G, B for the colour. If the input has only a luminance, their mean replaces it.
    pub color: &'a Image,
    /// Names and images of the input's layers that are replaced; the names are as in
    /// [`LayerUse::layer`](super::LayerUse::layer). An image has as many planes as the layer has channels without its
    /// alpha, in the order of [`LayerUse::channels`](super::LayerUse::channels). Useful for halves and variance, which
    /// do not belong to the denoised colour.
    pub replacements: &'a [(String, Image)],
    /// Names of the input's layers that are left out, as in [`LayerUse::layer`](super::LayerUse::layer): layers that
    /// would be wrong beside the denoised colour.
    pub dropped: &'a [String],
    /// Layers that the input does not have; written as 32-bit floats into the colour's part.
    pub extra: &'a [NamedLayer],
    /// Text attributes added to the header of the colour's part.
    pub attributes: &'a [(String, String)],
}

/// Channels of the input that an output replaces by planes in the data window of their part.
pub(crate) struct ReplacedChannels {
    /// Name of the layer, for messages.
    pub(crate) layer: String,
    pub(crate) part: usize,
    /// Positions in the part's list of channels, one for each plane.
    pub(crate) channels: Vec<usize>,
    pub(crate) image: Image,
}

/// Values and layers that could not be written as they were.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct WriteReport {
    /// Number of values beyond the largest half float, written as ±65504.
    pub clamped_values: usize,
    /// Number of values that were not finite, written as 0.
    pub non_finite_values: usize,
    /// Names of extra layers that were left out, because no reader opens a file with names as long as theirs.
    pub left_out: Vec<String>,
    /// Other remarks, such as a changed compression.
    pub notes: Vec<String>,
}

impl std::fmt::Display for WriteReport {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let mut lines = self.notes.clone();
        if !self.left_out.is_empty() {
            let names = self.left_out.iter().map(|name| text::beginning(name, name.len()));
            let remedy = "give the feature a shorter name to keep them";
            lines.push(format!(
                "layers whose names are too long for OpenEXR are left out: {}; {remedy}",
                text::list(names)
            ));
        }
        if self.clamped_values > 0 {
            lines.push(format!(
                "{} values are too large for half floats and were written as ±65504",
                self.clamped_values
            ));
        }
        if self.non_finite_values > 0 {
            lines.push(format!("{} values were not finite and were written as 0", self.non_finite_values));
        }
        f.write_str(&lines.join("\n"))
    }
}

/// Writes the input of `set` with its colour replaced. Header, parts, windows, alpha and all layers that are not
/// replaced stay as they were; replaced channels keep their sample type. Mip levels are not kept. The set is used up:
/// its layers are handed on, not copied.
///
/// The file appears under its name only when it is complete; an existing file is replaced, even if it is the input. An
/// extra layer whose name is too long to be stored is left out, see [`WriteReport::left_out`].
///
/// # Errors
/// [`Error::Layer`] for images of another extent or number of channels than the layers that they replace, and for extra
/// layers that exist already; [`Error::Request`] for replacements of layers that do not exist; [`Error::File`] for
/// errors of the file system.
pub fn write_denoised(mut set: BufferSet, output: &Path, denoised: &DenoisedLayers<'_>) -> Result<WriteReport> {
    set.restore_payload(|_, _| true)?;
    set.divide_products(|_, source| source.is_some());
    write_pictures(set, output, std::slice::from_ref(denoised), Vec::new())
}

/// Writes as [`write_denoised`] does, with the layers of the set's pictures in their order, and with other channels.
/// Pictures behind the last one given stay as they were.
///
/// # Errors
/// As [`write_denoised`].
pub(crate) fn write_pictures(
    set: BufferSet,
    output: &Path,
    denoised: &[DenoisedLayers<'_>],
    others: Vec<ReplacedChannels>,
) -> Result<WriteReport> {
    let places: Vec<(usize, Extent)> =
        (0..set.pictures.len()).map(|index| (set.color_part(index), set.data_window_of(index).extent)).collect();
    let BufferSet { files, pictures, .. } = set;
    let Some(ExrFile { path, mut image, layers, stored_types, .. }) = files.into_iter().next() else {
        unreachable!("a set has an input")
    };
    let mut writer = Writer { report: WriteReport::default(), output, stored_types, replaced: Vec::new() };

    for ((picture, (part, extent)), denoised) in pictures.iter().zip(&places).zip(denoised) {
        let channels = &picture.color.mean.channels;
        let luminance = channels.iter().all(|channel| *channel == channels[0]).then(|| mean_plane(denoised.color));
        let color = luminance.as_ref().map_or((&channels[..], denoised.color), |plane| (&channels[..1], plane));
        writer.replace(&mut image, *part, color.0, *extent, color.1, "the colour")?;
        for (name, replacement) in denoised.replacements {
            let layer = layers.iter().find(|layer| layer.name == *name).ok_or_else(|| {
                Error::Request(RequestCause::Misuse {
                    problem: format!(
                        "layer '{}' cannot be replaced: {} has no such layer",
                        text::name(name),
                        text::path(&path)
                    ),
                    change: "add it as an extra layer instead",
                })
            })?;
            let channels = layer.without_alpha();
            let luminance = (channels.len() == 1 && replacement.channels() == 3).then(|| mean_plane(replacement));
            let replacement = luminance.as_ref().unwrap_or(replacement);
            writer.replace(&mut image, layer.part, &channels, *extent, replacement, name)?;
        }
    }
    for ReplacedChannels { layer, part, channels, image: planes } in others {
        let size = image.layer_data[part].size;
        let extent = Extent { width: size.0 as u32, height: size.1 as u32 };
        writer.replace(&mut image, part, &channels, extent, &planes, &layer)?;
    }
    writer.store_as_before(&mut image);
    // Removes layers before others are added: layers know their channels by their positions in the input.
    let is_dropped = |name: &String| denoised.iter().any(|denoised| denoised.dropped.contains(name));
    let mut is_kept_lossy = Vec::new();
    for (index, part) in image.layer_data.iter_mut().enumerate() {
        let dropped = layers.iter().filter(|layer| layer.part == index && is_dropped(&layer.name));
        let channels: Vec<usize> =
            dropped.flat_map(|layer| layer.channels.iter().map(|channel| channel.index)).collect();
        let compression = part.encoding.compression;
        let kept = part.channel_data.list.iter().enumerate().filter(|(channel, _)| !channels.contains(channel));
        is_kept_lossy.push(kept.into_iter().any(|(channel, stored)| {
            is_lossy(compression, &stored.name) && !writer.replaced.contains(&(index, channel))
        }));
        let mut position = 0..;
        part.channel_data.list.retain(|_| position.next().is_some_and(|position| !channels.contains(&position)));
    }
    for ((part, extent), denoised) in places.iter().zip(denoised) {
        for extra in denoised.extra {
            writer.add(&mut image.layer_data[*part], *extent, extra)?;
        }
        add_attributes(&mut image.layer_data[*part].attributes, denoised.attributes)?;
    }
    for (layer, is_kept_lossy) in image.layer_data.iter_mut().zip(is_kept_lossy) {
        writer.settle_attributes(&mut None, &mut layer.attributes.other);
        writer.settle_encoding(layer, is_kept_lossy);
    }
    image.layer_data.retain(|part| !part.channel_data.list.is_empty());
    writer.settle_attributes(&mut image.attributes.time_code, &mut image.attributes.other);
    let is_complete = |layer: &Layer<AnyChannels<FlatSamples>>| {
        layer.channel_data.list.iter().all(|channel| channel.sample_data.len() == layer.size.area())
    };
    if !image.layer_data.iter().all(is_complete) {
        return Err(Error::File {
            path: output.to_owned(),
            cause: FileCause::Defect {
                problem: "cannot be written: the samples of a layer that stays as it was are not in memory any more"
                    .into(),
                with: "the output of `stein info`",
            },
        });
    }
    write_then_rename(&image, output)?;
    Ok(writer.report)
}

/// Whether a lossy compression may bring a value beyond the largest half float, which the reader gets as infinity. The
/// errors of the compression are relative, of a factor of two at the highest levels.
fn may_overshoot(compression: Compression, channel: &AnyChannel<FlatSamples>) -> bool {
    const MOST: f32 = 16_376.0;
    is_lossy(compression, &channel.name) && channel.sample_data.values_as_f32().any(|value| value.abs() > MOST)
}

fn mean_plane(image: &Image) -> Image {
    let weight = 1.0 / image.channels() as f32;
    let mut mean = Image::filled(image.extent, 1, 0.0);
    for plane in &image.planes {
        mean.planes[0].iter_mut().zip(plane).for_each(|(sum, value)| *sum += value * weight);
    }
    mean
}

struct Writer<'a> {
    report: WriteReport,
    output: &'a Path,
    /// How the input stores the channels of each part.
    stored_types: Vec<Vec<SampleType>>,
    /// Part and channel of all that was replaced.
    replaced: Vec<(usize, usize)>,
}

impl Writer<'_> {
    fn check(&self, image: &Image, channels: usize, extent: Extent, name: &str) -> Result<()> {
        let complete = image.planes.iter().all(|plane| plane.len() == image.extent.pixels());
        if image.extent == extent && image.channels() == channels && complete {
            return Ok(());
        }
        Err(Error::Layer {
            path: self.output.to_owned(),
            layer: name.to_owned(),
            cause: LayerCause::PlanesDoNotFit {
                problem: format!(
                    "{} planes of {} do not fit {channels} channels of {extent}",
                    image.channels(),
                    image.extent
                ),
            },
        })
    }

    fn replace(
        &mut self,
        file: &mut FlatImage,
        part: usize,
        channels: &[usize],
        extent: Extent,
        image: &Image,
        name: &str,
    ) -> Result<()> {
        self.check(image, channels.len(), extent, name)?;
        for (&channel, plane) in channels.iter().zip(&image.planes) {
            let stored = self.stored(part, channel, plane);
            file.layer_data[part].channel_data.list[channel].sample_data = stored;
            self.replaced.push((part, channel));
        }
        Ok(())
    }

    /// Returns values in the type in which the input stores the channel.
    fn stored(&mut self, part: usize, channel: usize, plane: &[f32]) -> FlatSamples {
        match self.stored_types[part][channel] {
            SampleType::F16 => FlatSamples::F16(plane.iter().map(|&value| self.half(value)).collect()),
            SampleType::F32 => FlatSamples::F32(plane.iter().map(|&value| self.finite(value)).collect()),
            SampleType::U32 => FlatSamples::U32(plane.iter().map(|&value| self.finite(value).round() as u32).collect()),
        }
    }

    /// Converts channels that were averaged over seeds to the types in which the input stores them.
    fn store_as_before(&mut self, image: &mut FlatImage) {
        for (part, layer) in image.layer_data.iter_mut().enumerate() {
            for (channel, stored) in layer.channel_data.list.iter_mut().enumerate() {
                if let FlatSamples::F32(values) = &stored.sample_data
                    && self.stored_types[part][channel] == SampleType::F16
                {
                    let halves = values.iter().map(|value| f16::from_f32(*value)).collect();
                    stored.sample_data = FlatSamples::F16(halves);
                }
            }
        }
    }

    fn add(&mut self, layer: &mut Layer<AnyChannels<FlatSamples>>, extent: Extent, extra: &NamedLayer) -> Result<()> {
        self.check(&extra.image, extra.channels.len(), extent, &extra.name)?;
        let list = &mut layer.channel_data.list;
        let names: Vec<String> = extra.channels.iter().map(|suffix| full_name(extra, suffix)).collect();
        if names.iter().any(|name| name.len() > LONGEST_NAME) {
            // A feature's name may make them too long. The picture is not given up for one of its intermediates.
            self.report.left_out.push(extra.name.clone());
            return Ok(());
        }
        for (full, plane) in names.iter().zip(&extra.image.planes) {
            let refused = |reason: String| Error::Layer {
                path: self.output.to_owned(),
                layer: full.clone(),
                cause: LayerCause::UnusableName { reason },
            };
            let name = encoded(full).map_err(refused)?;
            if list.iter().any(|channel| channel.name == name) {
                return Err(refused("the input has a channel of that name".into()));
            }
            let samples = plane.iter().map(|&value| self.finite(value)).collect();
            list.push(AnyChannel::new(name, FlatSamples::F32(samples)));
        }
        Ok(())
    }

    fn finite(&mut self, value: f32) -> f32 {
        if value.is_finite() {
            return value;
        }
        self.report.non_finite_values += 1;
        0.0
    }

    fn half(&mut self, value: f32) -> f16 {
        let value = self.finite(value);
        let half = f16::from_f32(value);
        if half.is_finite() {
            return half;
        }
        self.report.clamped_values += 1;
        if value > 0.0 { f16::MAX } else { f16::MIN }
    }

    /// Adds a remark, unless another part has led to it already.
    fn note(&mut self, note: String) {
        if !self.report.notes.contains(&note) {
            self.report.notes.push(note);
        }
    }

    /// Leaves out time codes that the encoder refuses, such as those of more than 30 frames in a second.
    fn settle_attributes(&mut self, time_code: &mut Option<TimeCode>, others: &mut HashMap<Text, AttributeValue>) {
        let is_writable = |code: &TimeCode| code.pack_time_as_tv60_u32().is_ok();
        let before = others.len() + usize::from(time_code.is_some());
        *time_code = time_code.filter(is_writable);
        others.retain(|_, value| !matches!(value, AttributeValue::TimeCode(code) if !is_writable(code)));
        if others.len() + usize::from(time_code.is_some()) < before {
            self.report.notes.push(
                "a time code beyond 29 frames, 59 seconds, 59 minutes or 23 hours cannot be written: it is left out"
                    .into(),
            );
        }
    }

    /// Keeps the input's encoding if it can be written. `has_lossy`: a layer that stays as it was would lose more of
    /// its bits if it were compressed again.
    fn settle_encoding(&mut self, layer: &mut Layer<AnyChannels<FlatSamples>>, has_lossy: bool) {
        if layer.encoding.blocks == Blocks::ScanLines && layer.encoding.line_order == LineOrder::Unspecified {
            layer.encoding.line_order = LineOrder::Increasing;
        }
        let integers = layer.channel_data.list.iter().any(|channel| matches!(channel.sample_data, FlatSamples::U32(_)));
        let writable = match layer.encoding.compression {
            Compression::HTJ2K32 | Compression::HTJ2K256 => false,
            // The encoder writes some blocks that do not read back, and panics on narrow images.
            Compression::B44 | Compression::B44A => false,
            Compression::DWAA(_) | Compression::DWAB(_) => !integers,
            _ => true,
        };
        if !writable {
            self.note(format!("{} cannot be written: ZIP is used instead", layer.encoding.compression));
            layer.encoding.compression = Compression::ZIP16;
        }
        if has_lossy {
            let compression = layer.encoding.compression;
            self.note(format!("{compression} would change layers that stay as they were: ZIP is used instead"));
            layer.encoding.compression = Compression::ZIP16;
        }
        if layer.channel_data.list.iter().any(|channel| may_overshoot(layer.encoding.compression, channel)) {
            let compression = layer.encoding.compression;
            self.note(format!("{compression} would make infinities of the largest values: ZIP is used instead"));
            layer.encoding.compression = Compression::ZIP16;
        }
        // The input may have had its channels in any order, but the format requires them sorted.
        layer.channel_data.list.sort_by(|a, b| a.name.cmp(&b.name));
    }
}

/// Writes a file of these layers alone: one part, 32-bit floats, ZIP. The channels of a layer without a name keep their
/// own names; `attributes` are texts for the header.
///
/// The file appears under its name only when it is complete; an existing one is replaced. Values that are not finite
/// stay as they are.
///
/// # Errors
/// [`Error::Request`] for no layers, for layers of different extents, and for names that OpenEXR cannot store;
/// [`Error::File`] for errors of the file system.
pub fn write_layers(output: &Path, layers: &[NamedLayer], attributes: &[(String, String)]) -> Result<()> {
    write_layers_in(None, output, layers, attributes)
}

/// Data window and display window of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Windows {
    /// Position of the pixels in the file's coordinates. Its extent is the layers' extent.
    pub data: Window,
    /// The whole picture.
    pub display: Window,
}

/// Writes as [`write_layers`] does, with these windows; without any, both begin at (0, 0).
///
/// # Errors
/// As [`write_layers`].
pub fn write_layers_in(
    windows: Option<Windows>,
    output: &Path,
    layers: &[NamedLayer],
    attributes: &[(String, String)],
) -> Result<()> {
    let misuse = |problem, change| Err(Error::Request(RequestCause::Misuse { problem, change }));
    let unusable = |reason| Error::Request(RequestCause::UnusableName { what: "a channel".into(), reason });
    let Some(extent) = layers.first().map(|layer| layer.image.extent) else {
        return misuse("a file without layers cannot be written".into(), "give at least one");
    };
    let mut channels: SmallVec<[AnyChannel<FlatSamples>; 4]> = SmallVec::new();
    for layer in layers {
        let complete =
            layer.image.extent == extent && layer.image.planes.iter().all(|plane| plane.len() == extent.pixels());
        if !complete || layer.channels.len() != layer.image.channels() {
            let name = text::name(&layer.name);
            return misuse(
                format!("layer '{name}' does not have a full plane of {extent} for each of its channels"),
                "give layers of one extent",
            );
        }
        for (suffix, plane) in layer.channels.iter().zip(&layer.image.planes) {
            let full = full_name(layer, suffix);
            let name = encoded(&full).map_err(unusable)?;
            if channels.iter().any(|other| other.name == name) {
                return Err(unusable(format!("the name '{}' exists twice", text::name(&full))));
            }
            channels.push(AnyChannel::new(name, FlatSamples::F32(plane.clone())));
        }
    }
    let size = Vec2(extent.width as usize, extent.height as usize);
    let mut part = Layer::new(size, LayerAttributes::default(), Encoding::SMALL_LOSSLESS, AnyChannels::sort(channels));
    add_attributes(&mut part.attributes, attributes)?;
    let mut bounds = IntegerBounds::new(part.attributes.layer_position, part.size);
    if let Some(Windows { data, display }) = windows {
        part.attributes.layer_position = Vec2(data.x, data.y);
        let size = Vec2(display.extent.width as usize, display.extent.height as usize);
        bounds = IntegerBounds::new(Vec2(display.x, display.y), size);
    }
    write_then_rename(&FlatImage::from_layers(ImageAttributes::new(bounds), vec![part]), output)
}

fn full_name(layer: &NamedLayer, suffix: &str) -> String {
    if layer.name.is_empty() { suffix.to_owned() } else { format!("{}.{suffix}", layer.name) }
}

fn add_attributes(header: &mut LayerAttributes, attributes: &[(String, String)]) -> Result<()> {
    for (name, value) in attributes {
        let name = encoded(name)
            .map_err(|reason| Error::Request(RequestCause::UnusableName { what: "an attribute".into(), reason }))?;
        // The format stores the length of a value, so that a value may hold anything.
        header.other.insert(name, AttributeValue::Text(Text::from_slice_unchecked(value.as_bytes())));
    }
    Ok(())
}

fn write_then_rename(image: &FlatImage, output: &Path) -> Result<()> {
    let mut builder = tempfile::Builder::new();
    let written =
        atomic_file::replace(output, atomic_file::readable(builder.prefix(".stein-").suffix(".exr.part")), |file| {
            let mut buffered = BufWriter::new(&mut *file);
            // Oddities of the input's header were no reason to refuse it, and are none here.
            image.write().skip_compatibility_checks().to_buffered(&mut buffered).map_err(|error| match error {
                exr::error::Error::Io(error) => error,
                error => std::io::Error::other(error.to_string()),
            })?;
            // Without this, a full disk would lose the last bytes in silence.
            buffered.flush()?;
            drop(buffered);
            settle(file)
        });
    written.map_err(|error| Error::File {
        path: output.to_owned(),
        cause: FileCause::Unwritable { reason: error.to_string() },
    })
}
