//! PNG files of every colour type and depth, interlaced or not. Of an animation, the still picture is read.

use std::fs::File;
use std::io::{BufRead, BufWriter, Error, Seek, Write};

use png::{
    BitDepth, ColorType, Decoder, DecodingError, Encoder, EncodingError, Limits, ScaledFloat, SrgbRenderingIntent,
    Transformations,
};

use super::{PngEncoding, WriteCounts, checked_extent, empty_image};
use crate::header::Trouble;
use stein::error::FileCause;
use stein::host_memory::try_filled;
use stein::image::{Extent, Image};

type Decoded<T> = std::result::Result<T, Trouble>;

/// Largest number of bytes that one byte of deflated data can become: the longest repetition, of 258 bytes, takes two
/// bits.
const MOST_BYTES_FROM_ONE: u64 = 1032;

/// Limit on the memory that the decoder takes beside the picture, in bytes: a row and chunks of metadata.
const MOST_DECODER_BYTES: usize = 64 << 20;

/// The largest sample of 16 bits.
const MOST: f64 = 65_535.0;

impl From<DecodingError> for Trouble {
    fn from(error: DecodingError) -> Self {
        match error {
            DecodingError::IoError(error) => error.into(),
            DecodingError::LimitsExceeded => Self(FileCause::Unsupported {
                what: format!("has metadata of more than {} MiB", MOST_DECODER_BYTES >> 20),
                form: "without metadata",
            }),
            error => Self::damaged(plain(&error.to_string())),
        }
    }
}

/// Shortens a message of the decoder, which prints all fields of a chunk's type, to the chunk's name.
fn plain(message: &str) -> String {
    let shortened = || {
        let (before, rest) = message.split_once("ChunkType { type: ")?;
        let (name, rest) = rest.split_once(", critical: ")?;
        let (_, after) = rest.split_once(" }")?;
        Some(format!("{before}{name}{after}"))
    };
    shortened().unwrap_or_else(|| message.to_owned())
}

/// Decodes a file of `file_bytes` bytes. The colour becomes linear and is multiplied by the alpha, as in OpenEXR.
pub(super) fn decode(file: &mut (impl BufRead + Seek), file_bytes: u64, encoding: PngEncoding) -> Decoded<Image> {
    let mut decoder = Decoder::new_with_limits(file, Limits { bytes: MOST_DECODER_BYTES });
    decoder.set_ignore_text_chunk(true);
    decoder.set_ignore_iccp_chunk(true);
    // Palettes become colours, transparent colours an alpha, and samples of less than 8 bits samples of 8.
    decoder.set_transformations(Transformations::EXPAND);
    let header = decoder.read_header_info()?;
    let extent = checked_extent(header.width.into(), header.height.into())?;
    let raw_bits = extent.pixels() as u64 * header.bits_per_pixel() as u64;
    if raw_bits / 8 / MOST_BYTES_FROM_ONE > file_bytes {
        return Err(Trouble::damaged("its header claims an image larger than the file can hold"));
    }
    let mut reader = decoder.read_info()?;
    let (color, depth) = reader.output_color_type();
    let channels = color.samples();
    let buffer_bytes = reader.output_buffer_size().ok_or(DecodingError::LimitsExceeded)?;
    let mut image = empty_image(extent, channels, buffer_bytes as u64)?;
    let mut buffer = try_filled(buffer_bytes, 0_u8)?;
    let frame = reader.next_frame(&mut buffer)?;
    if (frame.width, frame.height) != (extent.width, extent.height) {
        return Err(Trouble::damaged("its first picture is smaller than its header claims"));
    }
    // Reads to the end, so that a file that is cut is refused wherever it is cut.
    reader.finish()?;
    let has_alpha = matches!(color, ColorType::GrayscaleAlpha | ColorType::Rgba);
    match depth {
        BitDepth::Sixteen => {
            let (samples, _) = buffer.as_chunks::<2>();
            let samples = samples.iter().map(|&bytes| u16::from_be_bytes(bytes));
            fill(&mut image, samples, u16::MAX, has_alpha, encoding);
        }
        _ => fill(&mut image, buffer.iter().map(|&byte| byte.into()), u8::MAX.into(), has_alpha, encoding),
    }
    Ok(image)
}

/// Fills the planes with samples of 0 to `most`, which come pixel by pixel.
fn fill(image: &mut Image, mut samples: impl Iterator<Item = u16>, most: u16, has_alpha: bool, encoding: PngEncoding) {
    let fraction = |sample: u16| f64::from(sample) / f64::from(most);
    let linear: Vec<f32> = (0..=most).map(|sample| decoded(fraction(sample), encoding) as f32).collect();
    let (pixels, channels) = (image.extent.pixels(), image.channels());
    let alpha = channels - 1;
    for pixel in 0..pixels {
        // Ends with the last plane, without a further sample.
        for (channel, (plane, sample)) in image.planes.iter_mut().zip(&mut samples).enumerate() {
            let is_alpha = has_alpha && channel == alpha;
            plane[pixel] = if is_alpha { fraction(sample) as f32 } else { linear[usize::from(sample)] };
        }
    }
    if let (true, Some((alpha, colors))) = (has_alpha, image.planes.split_last_mut()) {
        for color in colors {
            color.iter_mut().zip(&*alpha).for_each(|(value, alpha)| *value *= alpha);
        }
    }
}

/// Writes a picture of 1 to 4 planes; see [`write()`](super::write()).
pub(super) fn encode(
    file: &mut File,
    image: &Image,
    encoding: PngEncoding,
    counts: &mut WriteCounts,
) -> std::io::Result<()> {
    let failed = |error| match error {
        EncodingError::IoError(error) => error,
        error => Error::other(error.to_string()),
    };
    let Extent { width, height } = image.extent;
    let (color, colors, alpha) = match image.planes.as_slice() {
        [grey] => (ColorType::Grayscale, std::slice::from_ref(grey), None),
        [grey, alpha] => (ColorType::GrayscaleAlpha, std::slice::from_ref(grey), Some(alpha)),
        [colors @ .., alpha] if colors.len() == 3 => (ColorType::Rgba, colors, Some(alpha)),
        colors => (ColorType::Rgb, colors, None),
    };
    let mut file = BufWriter::new(file);
    let mut encoder = Encoder::new(&mut file, width, height);
    encoder.set_color(color);
    encoder.set_depth(BitDepth::Sixteen);
    match encoding {
        PngEncoding::Srgb => encoder.set_source_srgb(SrgbRenderingIntent::Perceptual),
        PngEncoding::Linear => encoder.set_source_gamma(ScaledFloat::new(1.0)),
    }
    let mut writer = encoder.write_header().map_err(failed)?;
    let mut rows = writer.stream_writer().map_err(failed)?;
    let mut row = Vec::with_capacity(2 * image.channels() * width as usize);
    for y in 0..height as usize {
        row.clear();
        for pixel in y * width as usize..(y + 1) * width as usize {
            let alpha = alpha.map(|plane| counts.unit(plane[pixel].into()));
            for plane in colors {
                let value = counts.unit(straight(plane[pixel].into(), alpha.unwrap_or(1.0)));
                row.extend(quantized(encoded(value, encoding)));
            }
            row.extend(alpha.into_iter().flat_map(quantized));
        }
        rows.write_all(&row)?;
    }
    rows.finish().map_err(failed)?;
    writer.finish().map_err(failed)?;
    // Without this, a full disk would lose the last bytes in silence.
    file.flush()
}

impl WriteCounts {
    /// Returns the nearest value within 0..=1, or 0 for a value that is not finite, and counts changes.
    fn unit(&mut self, value: f64) -> f64 {
        if !value.is_finite() {
            self.non_finite_values += 1;
            return 0.0;
        }
        self.clamped_values += usize::from(!(0.0..=1.0).contains(&value));
        value.clamp(0.0, 1.0)
    }
}

/// Returns a colour that is not multiplied by the alpha. Where the alpha is 0, any light is beyond the largest colour.
fn straight(value: f64, alpha: f64) -> f64 {
    match (value, alpha) {
        (value, 1.0) => value,
        (0.0, _) => 0.0,
        (value, 0.0) if value.is_finite() => f64::MAX.copysign(value),
        (value, alpha) => value / alpha,
    }
}

fn quantized(value: f64) -> [u8; 2] {
    ((value * MOST).round() as u16).to_be_bytes()
}

/// Returns the linear value of an encoded one. Both are in 0..=1.
fn decoded(value: f64, encoding: PngEncoding) -> f64 {
    match encoding {
        PngEncoding::Linear => value,
        PngEncoding::Srgb if value <= 0.040_45 => value / 12.92,
        PngEncoding::Srgb => ((value + 0.055) / 1.055).powf(2.4),
    }
}

/// Returns the encoded value of a linear one. Both are in 0..=1.
fn encoded(value: f64, encoding: PngEncoding) -> f64 {
    match encoding {
        PngEncoding::Linear => value,
        PngEncoding::Srgb if value <= 0.003_130_8 => value * 12.92,
        PngEncoding::Srgb => 1.055 * value.powf(1.0 / 2.4) - 0.055,
    }
}
