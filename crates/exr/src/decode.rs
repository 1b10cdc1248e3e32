//! Finds an OpenEXR file's blocks by its offset tables, and decompresses them.

use std::io::{BufRead, Seek, SeekFrom};
use std::panic::{AssertUnwindSafe, catch_unwind};

use exr::block::UncompressedBlock;
use exr::block::chunk::{Chunk, CompressedBlock, CompressedScanLineBlock, CompressedTileBlock, TileCoordinates};
use exr::meta::header::Header;
use exr::meta::{BlockDescription, compute_block_count};
use exr::prelude::*;
use rayon::prelude::*;

use crate::header::{Head, MOST_PIXELS_PER_SIDE, Trouble};
use stein::error::FileCause;
use stein::host_memory::{FreeMemory, Shortage, try_filled};

/// Size of the decoded blocks that are in memory beside the image, in bytes; more if one block per thread is more.
const BATCH_BYTES: usize = 16 << 20;

type Decoded<T> = std::result::Result<T, Trouble>;
type Parts = Layers<AnyChannels<FlatSamples>>;

impl From<Shortage> for Trouble {
    fn from(shortage: Shortage) -> Self {
        Self(FileCause::NoMemory { doing: "held", shortage })
    }
}

impl From<exr::error::Error> for Trouble {
    fn from(error: exr::error::Error) -> Self {
        match error {
            exr::error::Error::Io(error) => error.into(),
            exr::error::Error::NotSupported(what) => Self::unsupported(what),
            error => Self::damaged(error),
        }
    }
}

/// Decodes the largest level of every part of a file of `file_bytes` bytes.
pub(crate) fn decode(file: &mut (impl BufRead + Seek), file_bytes: u64) -> Decoded<FlatImage> {
    let head = Head::read(file, file_bytes)?;
    head.check(file)?;
    file.rewind()?;
    // The decoder has assertions, and computes with sizes before it checks them, so that it may panic.
    let meta = catch_unwind(AssertUnwindSafe(|| {
        let meta = MetaData::read_from_buffered(&mut *file, true)?;
        MetaData::validate(&meta.headers, false)?;
        Ok::<_, exr::error::Error>(meta)
    }));
    let meta = meta.map_err(|_| Trouble::damaged("the attributes in its header contradict each other"))??;
    let bytes = check_size(&meta.headers, file_bytes)?;
    let places = places(file, &meta, head.end, file_bytes)?;
    // A header may claim blocks that are larger than the image.
    let largest_block =
        meta.headers.iter().map(|header| header.max_block_byte_size().min(part_bytes(header))).max().unwrap_or(0);
    // Enough blocks at once to keep every thread busy, and so few that the whole compressed and the whole decoded file
    // are never in memory together.
    let blocks_at_once = (BATCH_BYTES / largest_block.max(1)).max(rayon::current_num_threads()).min(places.len());
    // The blocks of a batch are in memory twice: compressed and decoded.
    FreeMemory::now().check((bytes + 2 * blocks_at_once * largest_block) as u64)?;

    let mut layers = meta.headers.iter().map(empty_layer).collect::<Decoded<Parts>>()?;
    for batch in places.chunks(blocks_at_once.max(1)) {
        let chunks = batch.iter().map(|place| place.read(file, &meta, file_bytes)).collect::<Decoded<Vec<_>>>()?;
        let blocks = chunks.into_par_iter().map(|chunk| decompress(chunk, &meta)).collect::<Decoded<Vec<_>>>()?;
        for block in &blocks {
            store(block, &meta.headers[block.index.layer], &mut layers[block.index.layer])?;
        }
    }
    Ok(FlatImage { attributes: meta.headers[0].shared_attributes.clone(), layer_data: layers })
}

/// Refuses headers that claim more than the file can hold, before anything of that size is allocated. Returns the
/// number of bytes that all samples take.
fn check_size(headers: &[Header], file_bytes: u64) -> Decoded<usize> {
    let too_large = || Trouble::damaged("its header claims an image larger than the file can hold");
    let (mut bytes, mut stored) = (0_usize, 0_u64);
    for header in headers {
        let Vec2(width, height) = header.layer_size;
        let Vec2(block_width, block_height) = block_size(header);
        if [width, height, block_width, block_height].iter().any(|side| !(1..=MOST_PIXELS_PER_SIDE).contains(side)) {
            return Err(too_large());
        }
        let part = part_bytes(header);
        bytes = bytes.checked_add(part).ok_or_else(too_large)?;
        stored += (part / most_bytes_from_one(header.compression)) as u64;
        // Every chunk has an entry of 8 bytes in the offset table and 8 bytes or more of its own.
        stored += 16 * header.chunk_count as u64;
        if stored > file_bytes {
            return Err(too_large());
        }
    }
    Ok(bytes)
}

/// Returns the bytes of all samples of a part. The product cannot overflow: sides are at most 2²⁰, with a few thousand
/// channels of four bytes.
fn part_bytes(header: &Header) -> usize {
    header.layer_size.area() * header.channels.bytes_per_pixel
}

/// Returns the largest number of bytes of pixels that one byte of a file can become.
fn most_bytes_from_one(compression: Compression) -> usize {
    /// The longest repetition, of 258 bytes, takes two bits.
    const DEFLATE: usize = 1032;
    match compression {
        Compression::Uncompressed => 1,
        // Up to 128 equal bytes take two bytes.
        Compression::RLE => 64,
        Compression::ZIP1 | Compression::ZIP16 => DEFLATE,
        // Three of a float's four bytes are deflated.
        Compression::PXR24 => DEFLATE * 4 / 3,
        // Up to 256 equal pairs of bytes take ten bits.
        Compression::PIZ => 512,
        // 32 bytes take 14 bytes, or 3 for a flat block.
        Compression::B44 => 3,
        Compression::B44A => 11,
        // An even block of 8×8 pixels takes two bytes, which are deflated.
        _ => 64 * 4 / 2 * DEFLATE * 2,
    }
}

fn block_size(header: &Header) -> Vec2<usize> {
    match header.blocks {
        BlockDescription::ScanLines => Vec2(header.layer_size.0, header.compression.scan_lines_per_block()),
        BlockDescription::Tiles(tiles) => tiles.tile_size,
    }
}

/// Position of a block of the largest level in the file, and the block that must be there.
struct Place {
    offset: u64,
    part: usize,
    /// Numbers of blocks to its left and above it.
    block: Vec2<usize>,
}

/// Reads the offset tables, which begin at `start`. Returns the blocks in the order of the file.
fn places(file: &mut (impl BufRead + Seek), meta: &MetaData, start: u64, file_bytes: u64) -> Decoded<Vec<Place>> {
    file.seek(SeekFrom::Start(start))?;
    let mut places = Vec::new();
    let mut entry = [0; 8];
    let ended = || Trouble::damaged("it ends in its table of offsets");
    for (part, header) in meta.headers.iter().enumerate() {
        let size = block_size(header);
        let columns = compute_block_count(header.layer_size.0, size.0);
        // The largest level comes first.
        let blocks = columns * compute_block_count(header.layer_size.1, size.1);
        for block in 0..header.chunk_count {
            file.read_exact(&mut entry).map_err(|_| ended())?;
            if block < blocks {
                places.push(Place {
                    offset: u64::from_le_bytes(entry),
                    part,
                    block: Vec2(block % columns, block / columns),
                });
            }
        }
    }
    let tables_end = file.stream_position()?;
    places.sort_by_key(|place| place.offset);
    for (index, place) in places.iter().enumerate() {
        let Place { offset, block: Vec2(x, y), .. } = place;
        if *offset == 0 {
            return Err(Trouble::damaged(format_args!("block ({x}, {y}) is missing")));
        }
        if *offset < tables_end || *offset >= file_bytes {
            return Err(Trouble::damaged(format_args!(
                "block ({x}, {y}) is said to stand at byte {offset}, but none can: the file has {file_bytes}"
            )));
        }
        if index > 0 && places[index - 1].offset == *offset {
            return Err(Trouble::damaged(format_args!("two blocks are said to stand at byte {offset}")));
        }
    }
    Ok(places)
}

impl Place {
    /// Reads the compressed block at this position. Refuses a block of another position, and one that goes beyond the
    /// end of the file, before memory is allocated for it.
    fn read(&self, file: &mut (impl BufRead + Seek), meta: &MetaData, file_bytes: u64) -> Decoded<Chunk> {
        let Self { offset, part, block: Vec2(x, y) } = *self;
        let header = &meta.headers[part];
        let wrong = |problem: &str| Trouble::damaged(format_args!("block ({x}, {y}) at byte {offset} {problem}"));
        if file.stream_position()? != offset {
            file.seek(SeekFrom::Start(offset))?;
        }
        let mut number = || {
            let mut bytes = [0; 4];
            file.read_exact(&mut bytes).map_err(|_| wrong("ends too early"))?;
            Ok::<_, Trouble>(i32::from_le_bytes(bytes))
        };
        let is = |number: i32, expected: usize| usize::try_from(number) == Ok(expected);
        let mut is_expected = !meta.requirements.has_multiple_layers || is(number()?, part);
        let mut top = 0;
        match header.blocks {
            BlockDescription::ScanLines => {
                top = number()?;
                let first = i64::from(header.own_attributes.layer_position.1);
                is_expected &= i64::from(top) == first + (y * header.compression.scan_lines_per_block()) as i64;
            }
            BlockDescription::Tiles(_) => {
                for expected in [x, y, 0, 0] {
                    is_expected &= is(number()?, expected);
                }
            }
        }
        if !is_expected {
            return Err(wrong("is another one"));
        }
        let size = usize::try_from(number()?).map_err(|_| wrong("has a negative size"))?;
        if size > header.max_block_byte_size() {
            return Err(wrong("claims to be larger than its pixels"));
        }
        if file.stream_position()? + size as u64 > file_bytes {
            return Err(wrong("ends too early"));
        }
        let mut compressed_pixels_le = vec![0; size];
        file.read_exact(&mut compressed_pixels_le)?;
        let compressed_block = match header.blocks {
            BlockDescription::ScanLines => {
                CompressedBlock::ScanLine(CompressedScanLineBlock { y_coordinate: top, compressed_pixels_le })
            }
            BlockDescription::Tiles(_) => {
                let coordinates = TileCoordinates { tile_index: self.block, level_index: Vec2(0, 0) };
                CompressedBlock::Tile(CompressedTileBlock { coordinates, compressed_pixels_le })
            }
        };
        Ok(Chunk { layer_index: part, compressed_block })
    }
}

/// Decompresses a block. Catches panics for each block: a panic in a thread of the decoder's own pool would end the
/// process.
fn decompress(chunk: Chunk, meta: &MetaData) -> Decoded<UncompressedBlock> {
    check_dwa_counters(&chunk, &meta.headers[chunk.layer_index])?;
    let block = catch_unwind(AssertUnwindSafe(|| UncompressedBlock::decompress_chunk(chunk, meta, false)));
    Ok(block.map_err(|_| Trouble::damaged("a block cannot be decompressed"))??)
}

/// Refuses a DWA block that claims too much data. The block begins with eleven 64-bit sizes, and the decoder allocates
/// what they say: a failed allocation ends the process and cannot be caught.
fn check_dwa_counters(chunk: &Chunk, header: &Header) -> Decoded<()> {
    let bytes = match (&chunk.compressed_block, header.compression) {
        (CompressedBlock::ScanLine(block), Compression::DWAA(_) | Compression::DWAB(_)) => &block.compressed_pixels_le,
        (CompressedBlock::Tile(block), Compression::DWAA(_) | Compression::DWAB(_)) => &block.compressed_pixels_le,
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
    // The first counter is the version, the eleventh one chooses a method.
    let sizes = bytes.chunks_exact(8).skip(1).take(9);
    let mut sizes = sizes.map(|size| size.iter().rev().fold(0_u64, |value, byte| value << 8 | u64::from(*byte)));
    if sizes.any(|size| size > limit as u64) {
        return Err(Trouble::damaged("a block claims more data than the image has"));
    }
    Ok(())
}

fn empty_layer(header: &Header) -> Decoded<Layer<AnyChannels<FlatSamples>>> {
    let size = header.layer_size;
    let pixels = size.0 * size.1;
    let channel = |channel: &ChannelDescription| {
        Ok::<_, Trouble>(AnyChannel {
            name: channel.name.clone(),
            sample_data: match channel.sample_type {
                SampleType::F16 => FlatSamples::F16(try_filled(pixels, f16::ZERO)?),
                SampleType::F32 => FlatSamples::F32(try_filled(pixels, 0.0)?),
                SampleType::U32 => FlatSamples::U32(try_filled(pixels, 0)?),
            },
            quantize_linearly: channel.quantize_linearly,
            sampling: channel.sampling,
        })
    };
    Ok(Layer {
        channel_data: AnyChannels { list: header.channels.list.iter().map(channel).collect::<Decoded<_>>()? },
        attributes: header.own_attributes.clone(),
        size,
        encoding: Encoding {
            compression: header.compression,
            blocks: match header.blocks {
                BlockDescription::ScanLines => Blocks::ScanLines,
                BlockDescription::Tiles(tiles) => Blocks::Tiles(tiles.tile_size),
            },
            line_order: header.line_order,
        },
    })
}

fn store(block: &UncompressedBlock, header: &Header, layer: &mut Layer<AnyChannels<FlatSamples>>) -> Decoded<()> {
    if block.data.len() != block.index.pixel_size.area() * header.channels.bytes_per_pixel {
        return Err(Trouble::damaged("a block holds fewer pixels than it should"));
    }
    for line in block.lines(&header.channels) {
        let start = line.location.position.1 * layer.size.0 + line.location.position.0;
        let range = start..start + line.location.sample_count;
        match &mut layer.channel_data.list[line.location.channel].sample_data {
            FlatSamples::F16(values) => line.read_samples_into_slice(&mut values[range])?,
            FlatSamples::F32(values) => line.read_samples_into_slice(&mut values[range])?,
            FlatSamples::U32(values) => line.read_samples_into_slice(&mut values[range])?,
        }
    }
    Ok(())
}
