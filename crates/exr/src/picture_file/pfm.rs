//! Portable float maps: three lines of text, then 32-bit floats, the lowest row first.

use std::fs::File;
use std::io::{BufRead, BufWriter, Read, Seek, SeekFrom, Write};

use super::{checked_extent, empty_image};
use crate::header::{Trouble, shown};
use stein::image::{Extent, Image};

type Decoded<T> = std::result::Result<T, Trouble>;

/// Largest size of a header in bytes. Usual headers have about 20 bytes; some writers pad them with spaces.
const MOST_HEADER_BYTES: u64 = 1024;

/// Longest number in a header, in bytes.
const LONGEST_WORD: usize = 64;

/// The header of a file.
struct Head {
    extent: Extent,
    channels: usize,
    is_big_endian: bool,
    /// Factor for all values, above 0.
    scale: f32,
    /// Position of the first pixel in the file.
    end: u64,
}

/// Returns the number of channels that the first word of a file announces. `None` for other files.
pub(super) fn channels(first_word: &[u8]) -> Option<usize> {
    match first_word {
        b"PF" => Some(3),
        b"Pf" => Some(1),
        b"PF4" => Some(4),
        _ => None,
    }
}

/// Decodes a file of `file_bytes` bytes. The magnitude of the scale factor multiplies all values, as in `oidnDenoise`.
pub(super) fn decode(file: &mut (impl BufRead + Seek), file_bytes: u64) -> Decoded<Image> {
    let head = Head::read(file, file_bytes)?;
    let Head { extent, channels, scale, .. } = head;
    let row_bytes = 4 * extent.width as usize * channels;
    let mut image = empty_image(extent, channels, row_bytes as u64)?;
    file.seek(SeekFrom::Start(head.end))?;
    let mut row = vec![0; row_bytes];
    for y in (0..extent.height as usize).rev() {
        file.read_exact(&mut row)?;
        let first = y * extent.width as usize;
        let (values, _) = row.as_chunks::<4>();
        for (x, pixel) in values.chunks_exact(channels).enumerate() {
            for (plane, &bytes) in image.planes.iter_mut().zip(pixel) {
                let value = if head.is_big_endian { f32::from_be_bytes(bytes) } else { f32::from_le_bytes(bytes) };
                // A factor of 1 must leave every bit, also those of NaN.
                plane[first + x] = if scale == 1.0 { value } else { value * scale };
            }
        }
    }
    Ok(image)
}

impl Head {
    /// Reads the header, and refuses one that claims other than `file_bytes` bytes for the whole file. So no memory is
    /// taken for pixels that do not exist, and a header that is misread never shifts the pixels.
    fn read(file: &mut (impl BufRead + Seek), file_bytes: u64) -> Decoded<Self> {
        let mut start = Vec::new();
        file.by_ref().take(MOST_HEADER_BYTES).read_to_end(&mut start)?;
        let mut words = Words { start: &start, at: 0 };
        let kind = words.next("kind")?;
        let Some(channels) = channels(kind.as_bytes()) else {
            return Err(misplaced(&kind, "kind"));
        };
        let mut side = |what| {
            let word = words.next(what)?;
            // A number beyond 64 bits is too large as well.
            word.parse::<i128>().map_err(|_| misplaced(&word, what))
        };
        let (width, height) = (side("width")?, side("height")?);
        let (Ok(known_width), Ok(known_height)) = (u64::try_from(width), u64::try_from(height)) else {
            return Err(Trouble::damaged(format_args!("its header claims {width}×{height} pixels")));
        };
        let extent = checked_extent(known_width, known_height)?;
        let word = words.next("scale factor")?;
        let scale = word.parse().ok().filter(|scale: &f32| scale.is_finite() && *scale != 0.0);
        let scale = scale.ok_or_else(|| misplaced(&word, "scale factor"))?;
        let pixel_bytes = 4 * extent.pixels() as u64 * channels as u64;
        // One character of white space ends the header, or a line end of Windows; whatever follows is of a pixel.
        let end = words.at as u64 + if start[words.at..].starts_with(b"\r\n") { 2 } else { 1 };
        if end + pixel_bytes != file_bytes {
            return Err(Trouble::damaged(format_args!(
                "its header claims {extent} pixels in {pixel_bytes} bytes, but {} bytes follow it",
                file_bytes.saturating_sub(end)
            )));
        }
        Ok(Self { extent, channels, is_big_endian: scale > 0.0, scale: scale.abs(), end })
    }
}

/// The words of a header, with white space between them.
struct Words<'a> {
    start: &'a [u8],
    /// Position behind the last word.
    at: usize,
}

impl Words<'_> {
    /// Returns the next word; `what` names it in messages.
    fn next(&mut self, what: &str) -> Decoded<String> {
        let rest = &self.start[self.at..];
        let spaces = rest.iter().take_while(|byte| byte.is_ascii_whitespace()).count();
        let rest = &rest[spaces..];
        let length = rest.iter().position(u8::is_ascii_whitespace);
        match length {
            Some(length) if length <= LONGEST_WORD => {
                self.at += spaces + length;
                Ok(shown(&rest[..length]))
            }
            None if (self.start.len() as u64) < MOST_HEADER_BYTES => {
                Err(Trouble::damaged(format_args!("it ends in its header, before the end of its {what}")))
            }
            _ => Err(misplaced(&shown(&rest[..LONGEST_WORD.min(rest.len())]), what)),
        }
    }
}

fn misplaced(word: &str, what: &str) -> Trouble {
    Trouble::damaged(format_args!("its header has '{word}' as its {what}"))
}

/// Writes a picture of 1 to 4 planes; see [`write()`](super::write()).
pub(super) fn encode(file: &mut File, image: &Image) -> std::io::Result<()> {
    let Extent { width, height } = image.extent;
    let (kind, planes) = match image.planes.as_slice() {
        [grey] => ("Pf", vec![grey]),
        [grey, alpha] => ("PF4", vec![grey, grey, grey, alpha]),
        [red, green, blue] => ("PF", vec![red, green, blue]),
        planes => ("PF4", planes.iter().collect()),
    };
    let mut file = BufWriter::new(file);
    write!(file, "{kind}\n{width} {height}\n-1.0\n")?;
    for y in (0..height as usize).rev() {
        for pixel in y * width as usize..(y + 1) * width as usize {
            for plane in &planes {
                file.write_all(&plane[pixel].to_le_bytes())?;
            }
        }
    }
    // Without this, a full disk would lose the last bytes in silence.
    file.flush()
}
