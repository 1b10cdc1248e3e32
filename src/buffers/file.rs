//! One OpenEXR file in memory: every part and channel as it was stored, and the layers that the channel names spell.

use std::fs::File;
use std::io::{BufReader, Read};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};

use exr::block::UncompressedBlock;
use exr::block::chunk::Chunk;
use exr::block::reader::ChunksReader;
use exr::prelude::*;
use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::image::{Extent, Image, Window};

/// A file's whole content. Samples stay in the type they were stored in, so that what is not replaced can be written back bit by bit.
#[derive(Clone, Debug)]
pub(crate) struct ExrFile {
    pub(crate) path: PathBuf,
    pub(crate) image: FlatImage,
    pub(crate) layers: Vec<FileLayer>,
}

/// Channels of one part whose names share everything before the last dot.
#[derive(Clone, Debug)]
pub(crate) struct FileLayer {
    /// Empty for the channels of a single-part file that have no dot.
    pub(crate) name: String,
    pub(crate) part: usize,
    /// In the order red, green, blue or x, y, z; alphabetical where the names say neither.
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
    /// Reads everything in the file. Never panics, whatever the bytes are.
    pub(crate) fn read(path: &Path) -> Result<Self> {
        check_beginning(path)?;
        // The decoders assert here and there; damaged data must not take the program down with them.
        let image = catch_unwind(AssertUnwindSafe(|| read_image(path)))
            .unwrap_or_else(|_| Err(exr::error::Error::Invalid("its data contradict each other".into())))
            .map_err(|error| explain(path, &error))?;
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

    /// The planes of some of a part's channels, as f32.
    pub(crate) fn planes(&self, part: usize, channels: &[usize]) -> Image {
        let layer = &self.image.layer_data[part];
        let planes = channels.iter().map(|&channel| to_f32(&layer.channel_data.list[channel].sample_data)).collect();
        Image { extent: extent(layer.size), planes }
    }

    pub(crate) fn sample_type(&self, layer: &FileLayer, channel: usize) -> SampleType {
        match self.image.layer_data[layer.part].channel_data.list[layer.channels[channel].index].sample_data {
            FlatSamples::F16(_) => SampleType::F16,
            FlatSamples::F32(_) => SampleType::F32,
            FlatSamples::U32(_) => SampleType::U32,
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

    /// A text stored in the header under `name`, in the given part or for the whole file.
    pub(crate) fn text_attribute(&self, part: usize, name: &str) -> Option<String> {
        match self.attribute(part, name)? {
            AttributeValue::Text(text) => Some(text.to_string()),
            _ => None,
        }
    }

    /// A number stored in the header under `name`, as text, whole number or float; in the given part or for the whole file.
    pub(crate) fn number_attribute(&self, part: usize, name: &str) -> Option<f32> {
        match self.attribute(part, name)? {
            AttributeValue::Text(text) => text.to_string().trim().parse().ok(),
            AttributeValue::I32(value) => Some(*value as f32),
            AttributeValue::F32(value) => Some(*value),
            AttributeValue::F64(value) => Some(*value as f32),
            _ => None,
        }
    }

    /// The names of all layers, for messages.
    pub(crate) fn layer_list(&self) -> String {
        let names: Vec<_> = self
            .layers
            .iter()
            .map(|layer| {
                let channels: Vec<_> = layer.channels.iter().map(|channel| channel.suffix.as_str()).collect();
                if layer.name.is_empty() { channels.join(" ") } else { format!("'{}' ({})", layer.name, channels.join(" ")) }
            })
            .collect();
        names.join(", ")
    }
}

fn extent(size: Vec2<usize>) -> Extent {
    // `check_size` has refused anything that does not fit.
    Extent { width: size.0 as u32, height: size.1 as u32 }
}

fn to_f32(samples: &FlatSamples) -> Vec<f32> {
    match samples {
        FlatSamples::F16(values) => values.iter().map(|value| value.to_f32()).collect(),
        FlatSamples::F32(values) => values.clone(),
        FlatSamples::U32(values) => values.iter().map(|&value| value as f32).collect(),
    }
}

/// Looks at the first bytes for what the decoder would only report in passing, or not at all.
fn check_beginning(path: &Path) -> Result<()> {
    let file_error = |problem: String, remedy: &str| Error::File { path: path.to_owned(), problem, remedy: remedy.to_owned() };
    let mut beginning = Vec::new();
    File::open(path)
        .and_then(|file| file.take(1 << 16).read_to_end(&mut beginning))
        .map_err(|error| file_error(format!("cannot be read: {error}"), "check the path and its permissions"))?;
    if beginning.is_empty() {
        return Err(file_error("is empty".into(), "render or copy it again: the writer was probably interrupted"));
    }
    if !beginning.starts_with(&[0x76, 0x2f, 0x31, 0x01]) {
        return Err(file_error("is not an OpenEXR file".into(), "give an .exr file, or convert the image to OpenEXR first"));
    }
    if beginning.get(5).is_some_and(|flags| flags & 0x08 != 0) {
        return Err(file_error(
            "holds deep data, that is many samples per pixel at different depths, which cannot be denoised here".into(),
            "flatten it first, or let the renderer write a flat image as well",
        ));
    }
    let marker = b"compression\0compression\0\x01\0\0\0";
    let compression = beginning.windows(marker.len()).position(|window| window == marker).and_then(|at| beginning.get(at + marker.len()));
    let name = match compression {
        Some(0..=9) | None => return Ok(()),
        Some(10 | 11) => "HTJ2K (high-throughput JPEG 2000)".to_owned(),
        Some(12) => "ZSTD".to_owned(),
        Some(other) => format!("unknown (number {other})"),
    };
    Err(file_error(
        format!("is compressed with a method that cannot be read here: {name}"),
        "write it with ZIP, PIZ or DWAA compression, or convert it, for example with `exrmetrics --convert -z zip in.exr -o out.exr`",
    ))
}

fn explain(path: &Path, error: &exr::error::Error) -> Error {
    let message = error.to_string();
    let (problem, remedy) = match error {
        exr::error::Error::Io(_) => (format!("cannot be read: {message}"), "check the path and its permissions"),
        _ if message.contains("subsampling") => (
            "has subsampled channels, probably luminance and chroma (Y, RY, BY), which cannot be read here".into(),
            "write R, G and B at full resolution, or convert the file",
        ),
        _ if message.contains("deep") => {
            ("holds deep data, which cannot be denoised here".into(), "flatten it first, or let the renderer write a flat image as well")
        }
        exr::error::Error::NotSupported(_) => {
            (format!("uses a part of OpenEXR that cannot be read here: {message}"), "write it as a flat scan line image with ZIP compression")
        }
        _ => (format!("is damaged or incomplete: {message}"), "render or copy it again; check whether the disk was full or the writer was interrupted"),
    };
    Error::File { path: path.to_owned(), problem, remedy: remedy.to_owned() }
}

/// Decodes the largest level of every part. Blocks are decompressed in parallel, each guarded on its own: a panic in a thread of the decoder's own pool
/// would end the process.
fn read_image(path: &Path) -> exr::error::Result<FlatImage> {
    let file = File::open(path)?;
    let file_bytes = file.metadata()?.len();
    let reader = exr::block::read(BufReader::new(file), false)?;
    check_size(reader.headers(), file_bytes)?;
    let chunks = reader.filter_chunks(false, |_, tile, _| tile.level_index == Vec2(0, 0))?;
    let meta = chunks.meta_data().clone();
    let mut layers: Layers<AnyChannels<FlatSamples>> = meta.headers.iter().map(empty_layer).collect();

    let mut chunks = chunks.into_iter();
    loop {
        // Enough at once to keep every thread busy, little enough that the compressed and the decoded file are never in memory together.
        let batch: Vec<Chunk> = chunks.by_ref().take(256).collect::<exr::error::Result<_>>()?;
        if batch.is_empty() {
            break;
        }
        let blocks: Vec<_> = batch
            .into_par_iter()
            .map(|chunk| {
                catch_unwind(AssertUnwindSafe(|| {
                    check_dwa_counters(&chunk, &meta)?;
                    UncompressedBlock::decompress_chunk(chunk, &meta, false)
                }))
                .unwrap_or_else(|_| Err(exr::error::Error::Invalid("a block cannot be decompressed".into())))
            })
            .collect::<exr::error::Result<_>>()?;
        for block in &blocks {
            store(block, &meta, &mut layers)?;
        }
    }
    let attributes = meta.headers.first().map(|header| header.shared_attributes.clone());
    let attributes = attributes.ok_or(exr::error::Error::Invalid("it has no parts".into()))?;
    Ok(FlatImage { attributes, layer_data: layers })
}

fn store(block: &UncompressedBlock, meta: &MetaData, layers: &mut Layers<AnyChannels<FlatSamples>>) -> exr::error::Result<()> {
    let missing = || exr::error::Error::Invalid("a block lies outside the image".into());
    let header = meta.headers.get(block.index.layer).ok_or_else(missing)?;
    let layer = layers.get_mut(block.index.layer).ok_or_else(missing)?;
    for line in block.lines(&header.channels) {
        let start = line.location.position.1 * layer.size.0 + line.location.position.0;
        let range = start..start + line.location.sample_count;
        let channel = layer.channel_data.list.get_mut(line.location.channel).ok_or_else(missing)?;
        match &mut channel.sample_data {
            FlatSamples::F16(values) => {
                line.read_samples_into_slice(values.get_mut(range).ok_or_else(missing)?)?;
            }
            FlatSamples::F32(values) => {
                line.read_samples_into_slice(values.get_mut(range).ok_or_else(missing)?)?;
            }
            FlatSamples::U32(values) => {
                line.read_samples_into_slice(values.get_mut(range).ok_or_else(missing)?)?;
            }
        }
    }
    Ok(())
}

/// A DWA block begins with eleven 64-bit sizes, and the decoder allocates what they say: a failed allocation ends the process and cannot be caught.
fn check_dwa_counters(chunk: &Chunk, meta: &MetaData) -> exr::error::Result<()> {
    use exr::block::chunk::CompressedBlock::{ScanLine, Tile};
    let Some(header) = meta.headers.get(chunk.layer_index) else {
        return Err(exr::error::Error::Invalid("a block belongs to no part".into()));
    };
    let bytes = match (&chunk.compressed_block, header.compression) {
        (ScanLine(block), Compression::DWAA(_) | Compression::DWAB(_)) => &block.compressed_pixels_le,
        (Tile(block), Compression::DWAA(_) | Compression::DWAB(_)) => &block.compressed_pixels_le,
        _ => return Ok(()),
    };
    let tile = header.get_block_data_indices(&chunk.compressed_block)?;
    let pixels = header.get_absolute_block_pixel_coordinates(tile)?.size;
    if bytes.len() == pixels.area() * header.channels.bytes_per_pixel {
        // A block that did not shrink is stored as it is, without counters.
        return Ok(());
    }
    // No section is larger than the pixels that it holds; the rest is room for padding to blocks of 8×8.
    let limit = (pixels.0 + 8) * (pixels.1 + 8) * header.channels.bytes_per_pixel * 2 + (1 << 16);
    // The first counter is the version, the eleventh a choice of method.
    let sizes = bytes.chunks_exact(8).skip(1).take(9);
    let mut sizes = sizes.map(|size| size.iter().rev().fold(0_u64, |value, byte| value << 8 | u64::from(*byte)));
    if sizes.any(|size| size > limit as u64) {
        return Err(exr::error::Error::Invalid("a block claims more data than the image has".into()));
    }
    Ok(())
}

fn empty_layer(header: &exr::meta::header::Header) -> Layer<AnyChannels<FlatSamples>> {
    let size = header.layer_size;
    let pixels = size.0 * size.1;
    let channel = |channel: &ChannelDescription| AnyChannel {
        name: channel.name.clone(),
        sample_data: match channel.sample_type {
            SampleType::F16 => FlatSamples::F16(vec![f16::ZERO; pixels]),
            SampleType::F32 => FlatSamples::F32(vec![0.0; pixels]),
            SampleType::U32 => FlatSamples::U32(vec![0; pixels]),
        },
        quantize_linearly: channel.quantize_linearly,
        sampling: channel.sampling,
    };
    Layer {
        channel_data: AnyChannels { list: header.channels.list.iter().map(channel).collect() },
        attributes: header.own_attributes.clone(),
        size,
        encoding: Encoding {
            compression: header.compression,
            blocks: match header.blocks {
                exr::meta::BlockDescription::ScanLines => Blocks::ScanLines,
                exr::meta::BlockDescription::Tiles(tiles) => Blocks::Tiles(tiles.tile_size),
            },
            line_order: header.line_order,
        },
    }
}

/// Refuses headers that claim more than the file can hold, before anything of that size is allocated.
fn check_size(headers: &[exr::meta::header::Header], file_bytes: u64) -> exr::error::Result<()> {
    let too_large = || exr::error::Error::Invalid("its header claims an image larger than the file can hold".into());
    let mut bytes = 0_usize;
    for header in headers {
        // One side of more than 2^20 pixels fits no texture, no film and no buffer.
        if header.layer_size.0 > 1 << 20 || header.layer_size.1 > 1 << 20 || header.layer_size.0 == 0 || header.layer_size.1 == 0 {
            return Err(too_large());
        }
        // Every chunk has an entry of 8 bytes in the offset table and 8 bytes or more of its own.
        if header.chunk_count as u64 > file_bytes / 16 {
            return Err(too_large());
        }
        let part = (header.layer_size.0 * header.layer_size.1).checked_mul(header.channels.bytes_per_pixel);
        bytes = part.and_then(|part| bytes.checked_add(part)).ok_or_else(too_large)?;
    }
    let mut probe: Vec<u8> = Vec::new();
    probe.try_reserve_exact(bytes).map_err(|_| exr::error::Error::Invalid(format!("its header claims {bytes} bytes of pixels").into()))
}

/// Groups a file's channels into layers: names are split at their last dot.
///
/// Channels without a dot belong to the part. In a part with R, G and B (or a luminance Y) those and the alpha are the part's own layer and every other
/// channel, such as `Z` or `samples`, is a layer of its own. The part's own layer has no name in a file of one part, else the part's.
fn layers_of(image: &FlatImage) -> Vec<FileLayer> {
    let many_parts = image.layer_data.len() > 1;
    let mut layers: Vec<FileLayer> = Vec::new();
    for (part, layer) in image.layer_data.iter().enumerate() {
        let part_name = layer.attributes.layer_name.as_ref().map(ToString::to_string).unwrap_or_default();
        let own_name = if many_parts { part_name.as_str() } else { "" };
        let names: Vec<String> = layer.channel_data.list.iter().map(|channel| channel.name.to_string()).collect();
        let has = |wanted: &str| names.iter().any(|name| name.eq_ignore_ascii_case(wanted));
        let has_color = has("Y") && !has("X") || has("R") && has("G") && has("B");
        for (index, name) in names.iter().enumerate() {
            let (layer_name, suffix) = match name.rsplit_once('.') {
                Some((layer_name, suffix)) => (layer_name, suffix),
                None => {
                    let color = ["R", "G", "B", "A", "Y"].iter().any(|color| name.eq_ignore_ascii_case(color));
                    let own = if has_color { color } else { name.chars().count() == 1 };
                    (if own { own_name } else { name.as_str() }, name.as_str())
                }
            };
            let channel = FileChannel { index, suffix: suffix.to_owned() };
            let taken = layers.iter().any(|other| other.part != part && other.name == layer_name);
            let full_name = if taken { format!("{part_name}.{layer_name}") } else { layer_name.to_owned() };
            match layers.iter_mut().find(|other| other.part == part && other.name == full_name) {
                Some(found) => found.channels.push(channel),
                None => layers.push(FileLayer { name: full_name, part, channels: vec![channel] }),
            }
        }
    }
    for layer in &mut layers {
        layer.channels.sort_by_key(|channel| (channel_rank(&channel.suffix), channel.suffix.clone()));
    }
    layers
}

fn channel_rank(suffix: &str) -> usize {
    let order = ["r", "g", "b", "x", "y", "z", "u", "v", "w"];
    order.iter().position(|known| suffix.eq_ignore_ascii_case(known)).unwrap_or(order.len())
}
