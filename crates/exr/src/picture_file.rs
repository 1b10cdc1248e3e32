//! Pictures in PFM and PNG files, which hold one colour and no statistics, as OpenEXR images in memory and back.
//!
//! A picture becomes an image of one part at (0, 0) with 32-bit floats: channels R, G, B, or Y for a grey picture, and
//! A if the picture has an alpha. As in every OpenEXR image, the colour is linear.

mod pfm;
mod png;

use std::fs::File;
use std::io::{BufRead, Seek};
use std::path::Path;

use exr::prelude::{
    AnyChannel, AnyChannels, Encoding, FlatImage, FlatSamples, ImageAttributes, IntegerBounds, Layer, LayerAttributes,
    Vec2,
};

use serde::{Deserialize, Serialize};

use crate::header::{MOST_PIXELS_PER_SIDE, Trouble};
use crate::{atomic_file, samples, write_layers};
use stein::error::{Error, FileCause, RequestCause, Result};
use stein::host_memory::{FreeMemory, try_filled};
use stein::image::{Extent, Image};

/// Format of a picture in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// OpenEXR.
    OpenExr,
    /// Portable float map, as `oidnDenoise` reads and writes it: `PF` (red, green, blue), `Pf` (grey) or `PF4` (red,
    /// green, blue, alpha), 32-bit floats.
    Pfm,
    /// Portable Network Graphics.
    Png,
}

/// Meaning of the colour values in a PNG file. Alpha is always linear.
///
/// The caller chooses it. What a file says about its colours (chunks `gAMA`, `cHRM`, `sRGB`, `iCCP` and `cICP`) is
/// ignored.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "programs", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum PngEncoding {
    /// The curve of sRGB (IEC 61966-2-1): pictures for displays.
    #[default]
    Srgb,
    /// Values proportional to light, or no light at all: normals and other features.
    Linear,
}

/// Numbers of values that a file cannot hold as they were.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct WriteCounts {
    /// Number of values outside 0..=1, written as 0 or 1. With an alpha, a colour counts if it is above the
    /// alpha.
    pub clamped_values: usize,
    /// Number of values that were not finite, written as 0.
    pub non_finite_values: usize,
}

impl WriteCounts {
    /// Returns remarks for people; none if the file holds every value.
    pub fn notes(&self) -> impl Iterator<Item = String> + use<> {
        let changed = [
            (self.clamped_values, "values are outside of 0 to 1 and were written as 0 or 1"),
            (self.non_finite_values, "values were not finite and were written as 0"),
        ];
        changed.into_iter().filter(|(count, _)| *count > 0).map(|(count, what)| format!("{count} {what}"))
    }
}

impl Format {
    /// Tells the format from the beginning of a file. Everything that is neither PFM nor PNG is taken for OpenEXR,
    /// whose reader refuses the rest.
    pub(crate) fn from_content(start: &[u8]) -> Self {
        let first_word = start.split(u8::is_ascii_whitespace).next();
        if first_word.is_some_and(|word| pfm::channels(word).is_some()) {
            return Self::Pfm;
        }
        // The rest of the signature shows damage, which the decoder names.
        if start.starts_with(b"\x89PNG") { Self::Png } else { Self::OpenExr }
    }

    /// Returns the format that the extension of a path names: `exr`, `pfm` or `png` in lower or upper case.
    pub fn from_extension(path: &Path) -> Option<Self> {
        let extension = path.extension()?;
        let is = |known: &str| extension.eq_ignore_ascii_case(known);
        let formats = [("exr", Self::OpenExr), ("pfm", Self::Pfm), ("png", Self::Png)];
        formats.into_iter().find(|(known, _)| is(known)).map(|(_, format)| format)
    }
}

/// Decodes a picture of `file_bytes` bytes. Never panics, whatever the bytes are, and takes no more memory than the
/// bytes can be decoded to.
pub(crate) fn decode(
    file: &mut (impl BufRead + Seek),
    file_bytes: u64,
    format: Format,
    encoding: PngEncoding,
) -> std::result::Result<FlatImage, Trouble> {
    let image = match format {
        Format::OpenExr => return crate::decode::decode(file, file_bytes),
        Format::Pfm => pfm::decode(file, file_bytes)?,
        Format::Png => png::decode(file, file_bytes, encoding)?,
    };
    let names = channel_names(image.channels());
    let channels = names.iter().zip(image.planes).map(|(&name, plane)| AnyChannel::new(name, FlatSamples::F32(plane)));
    let size = Vec2(image.extent.width as usize, image.extent.height as usize);
    let channels = AnyChannels::sort(channels.collect());
    let part = Layer::new(size, LayerAttributes::default(), Encoding::SMALL_LOSSLESS, channels);
    Ok(FlatImage::from_layers(ImageAttributes::new(IntegerBounds::from_dimensions(size)), vec![part]))
}

/// Writes a picture. The image has planes R, G, B, or one plane Y for a grey picture, and behind them a plane A if
/// there is an alpha. The colour is linear and, as OpenEXR has it, multiplied by the alpha.
///
/// * [`Format::OpenExr`]: 32-bit floats with ZIP compression, every value as it is.
/// * [`Format::Pfm`]: little-endian, every value as it is. A grey picture with an alpha becomes `PF4` with three equal
///   channels, because the format has no other.
/// * [`Format::Png`]: 16 bits, in the given encoding, which the file names. The colour is divided by the alpha, as the
///   format demands. Values outside 0..=1 are clamped, values that are not finite become 0, and both are counted.
///
/// The file appears under its name only when it is complete; an existing one is replaced. The same image gives the same
/// bytes.
///
/// # Errors
/// [`Error::Request`] for an image without pixels, of other planes or with incomplete ones; [`Error::File`] for errors
/// of the file system.
pub fn write(path: &Path, image: &Image, format: Format, encoding: PngEncoding) -> Result<WriteCounts> {
    let is_complete = image.planes.iter().all(|plane| plane.len() == image.extent.pixels());
    if !(1..=4).contains(&image.channels()) || !is_complete || image.extent.pixels() == 0 {
        return Err(Error::Request(RequestCause::Misuse {
            problem: format!("{} planes of {} are no picture", image.channels(), image.extent),
            change: "give complete planes R, G, B or Y, and an alpha behind them if there is one",
        }));
    }
    let mut counts = WriteCounts::default();
    if format == Format::OpenExr {
        write_layers(path, &[samples::layer("", channel_names(image.channels()), image.clone())], &[])?;
        return Ok(counts);
    }
    let write = |file: &mut File| match format {
        Format::Png => png::encode(file, image, encoding, &mut counts),
        _ => pfm::encode(file, image),
    };
    let mut builder = tempfile::Builder::new();
    atomic_file::replace(path, atomic_file::readable(builder.prefix(".stein-").suffix(".part")), write).map_err(
        |error| Error::File { path: path.to_owned(), cause: FileCause::Unwritable { reason: error.to_string() } },
    )?;
    Ok(counts)
}

fn channel_names(channels: usize) -> &'static [&'static str] {
    match channels {
        1 => &["Y"],
        2 => &["Y", "A"],
        3 => &["R", "G", "B"],
        _ => &["R", "G", "B", "A"],
    }
}

/// Returns the extent of a picture whose file claims these sides.
fn checked_extent(width: u64, height: u64) -> std::result::Result<Extent, Trouble> {
    let sides = 1..=MOST_PIXELS_PER_SIDE as u64;
    if !sides.contains(&width) || !sides.contains(&height) {
        return Err(Trouble::damaged(format_args!("its header claims {width}×{height} pixels")));
    }
    Ok(Extent { width: width as u32, height: height as u32 })
}

/// Makes the planes of a picture, if they and `further_bytes` fit into memory.
fn empty_image(extent: Extent, channels: usize, further_bytes: u64) -> std::result::Result<Image, Trouble> {
    FreeMemory::now().check(4 * extent.pixels() as u64 * channels as u64 + further_bytes)?;
    let planes = (0..channels).map(|_| try_filled(extent.pixels(), 0.0)).collect::<std::result::Result<_, _>>()?;
    Ok(Image { extent, planes })
}
