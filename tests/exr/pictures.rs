//! Pictures in PFM and PNG files, made byte by byte.

use std::path::{Path, PathBuf};

use stein::error::Error;
use stein::image::{Extent, Image};
use stein_exr::picture_file::{Format, PngEncoding, WriteCounts, write};
use stein_exr::{BufferSet, BufferSetRequest, LayerRef, read_reference, write_denoised};

use super::{failure, folder, replace_color, request, stored};

fn image(width: u32, height: u32, planes: Vec<Vec<f32>>) -> Image {
    Image { extent: Extent { width, height }, planes }
}

fn file(folder: &Path, name: &str, bytes: &[u8]) -> PathBuf {
    let path = folder.join(name);
    std::fs::write(&path, bytes).unwrap();
    path
}

/// Returns the planes of a picture, the alpha last, as they stand in an output that has the colour replaced by itself.
fn planes(path: &Path, channels: &[&str]) -> Vec<Vec<f32>> {
    let set = BufferSet::read(&request(path)).unwrap();
    let color = set.color().mean;
    let output = path.with_extension("out.exr");
    write_denoised(set, &output, &replace_color(&color)).unwrap();
    channels.iter().map(|channel| stored(&output, channel).values_as_f32().collect()).collect()
}

/// A PFM file of pixels that stand as in the file: red, green and blue side by side, the lowest row first.
fn pfm(header: &str, values: &[f32]) -> Vec<u8> {
    let mut bytes = header.as_bytes().to_vec();
    bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    bytes
}

/// A PNG file.
#[derive(Clone)]
struct Png {
    extent: [u32; 2],
    depth: u8,
    color: u8,
    is_interlaced: bool,
    palette: Vec<u8>,
    transparency: Vec<u8>,
    /// Samples of each pixel, the topmost row first.
    samples: Vec<u16>,
}

const GREY: u8 = 0;
const RGB: u8 = 2;
const PALETTE: u8 = 3;
const GREY_ALPHA: u8 = 4;
const RGBA: u8 = 6;

impl Png {
    /// Makes a picture of 5×3 pixels with samples from the whole range.
    fn new(color: u8, depth: u8) -> Self {
        let most = (1_u32 << depth) - 1;
        let channels = match color {
            RGB => 3,
            GREY_ALPHA => 2,
            RGBA => 4,
            _ => 1,
        };
        let last = 15 * channels - 1;
        let samples = (0..=last).map(|at| (at * 7 % (last + 1) * most / last) as u16).collect();
        let (palette, transparency) = (Vec::new(), Vec::new());
        Self { extent: [5, 3], depth, color, is_interlaced: false, palette, transparency, samples }
    }

    fn interlaced(self) -> Self {
        Self { is_interlaced: true, ..self }
    }

    fn raw(&self) -> Vec<u8> {
        let [width, height] = self.extent.map(|side| side as usize);
        let channels = self.samples.len() / (width * height);
        // Of each pass: the first column and row, and the steps to the next ones.
        let passes: &[[usize; 4]] = match self.is_interlaced {
            false => &[[0, 0, 1, 1]],
            true => &[[0, 0, 8, 8], [4, 0, 8, 8], [0, 4, 4, 8], [2, 0, 4, 4], [0, 2, 2, 4], [1, 0, 2, 2], [0, 1, 1, 2]],
        };
        let mut raw = Vec::new();
        for &[left, top, right, down] in passes {
            if left >= width {
                continue;
            }
            for y in (top..height).step_by(down) {
                let columns = (left..width).step_by(right);
                let samples = columns.flat_map(|x| &self.samples[(y * width + x) * channels..][..channels]);
                let bits: Vec<u8> = samples
                    .flat_map(|&sample| (0..self.depth).rev().map(move |bit| (sample >> bit & 1) as u8))
                    .collect();
                raw.push(0);
                raw.extend(
                    bits.chunks(8)
                        .map(|bits| bits.iter().enumerate().fold(0, |byte, (at, bit)| byte | bit << (7 - at))),
                );
            }
        }
        raw
    }

    fn bytes(&self) -> Vec<u8> {
        let mut header: Vec<u8> = self.extent.iter().flat_map(|side| side.to_be_bytes()).collect();
        header.extend([self.depth, self.color, 0, 0, u8::from(self.is_interlaced)]);
        let mut bytes = b"\x89PNG\r\n\x1a\n".to_vec();
        bytes.extend(chunk(b"IHDR", &header));
        if !self.palette.is_empty() {
            bytes.extend(chunk(b"PLTE", &self.palette));
        }
        if !self.transparency.is_empty() {
            bytes.extend(chunk(b"tRNS", &self.transparency));
        }
        bytes.extend(chunk(b"IDAT", &zlib(&self.raw())));
        bytes.extend(chunk(b"IEND", &[]));
        bytes
    }
}

fn chunk(name: &[u8; 4], content: &[u8]) -> Vec<u8> {
    let named = [name, content].concat();
    let crc = !named.iter().fold(!0_u32, |crc, byte| {
        (0..8).fold(crc ^ u32::from(*byte), |crc, _| crc >> 1 ^ if crc & 1 == 1 { 0xedb8_8320 } else { 0 })
    });
    [&(content.len() as u32).to_be_bytes()[..], &named, &crc.to_be_bytes()].concat()
}

/// Makes all checksums of a PNG file right again, so that a decoder looks at what they protect.
fn sealed(bytes: &[u8]) -> Vec<u8> {
    let (mut sealed, mut rest) = (bytes[..8].to_vec(), &bytes[8..]);
    while let Some((length, _)) = rest.split_first_chunk::<4>() {
        let end = u32::from_be_bytes(*length) as usize + 8;
        let Some(name) = rest[4..].first_chunk::<4>().filter(|_| end + 4 <= rest.len()) else { break };
        sealed.extend(chunk(name, &rest[8..end]));
        rest = &rest[end + 4..];
    }
    [&sealed, rest].concat()
}

/// Bytes in one block that is not compressed.
fn zlib(bytes: &[u8]) -> Vec<u8> {
    let length = bytes.len() as u16;
    let (a, b) = bytes.iter().fold((1, 0), |(a, b), byte| {
        let a = (a + u32::from(*byte)) % 65_521;
        (a, (a + b) % 65_521)
    });
    let sum = (b << 16 | a).to_be_bytes();
    [&[0x78, 1, 1][..], &length.to_le_bytes(), &(!length).to_le_bytes(), bytes, &sum].concat()
}

fn srgb_to_linear(value: f64) -> f64 {
    if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
}

fn linear_to_srgb(value: f64) -> f64 {
    if value <= 0.003_130_8 { value * 12.92 } else { 1.055 * value.powf(1.0 / 2.4) - 0.055 }
}

fn assert_close(found: &[Vec<f32>], expected: &[Vec<f64>], within: f64, name: &str) {
    assert_eq!(found.len(), expected.len(), "{name}");
    for (found, expected) in found.iter().zip(expected) {
        assert_eq!(found.len(), expected.len(), "{name}");
        for (found, expected) in found.iter().zip(expected) {
            assert!((f64::from(*found) - expected).abs() <= within, "{name}: {found} is not {expected}");
        }
    }
}

#[test]
fn a_pfm_file_is_read_from_its_lowest_row_in_both_byte_orders() {
    let folder = folder();
    let values: Vec<f32> = (0..12).map(|value| value as f32 - 3.25).collect();
    let rows = |channel: usize| [6, 9, 0, 3].map(|at| values[at + channel]).to_vec();
    let expected = image(2, 2, (0..3).map(rows).collect());
    let little = file(folder.path(), "little.pfm", &pfm("PF\n2 2\n-1.0\n", &values));
    assert_eq!(read_reference(&little, None).unwrap(), expected);
    let swapped: Vec<f32> = values.iter().map(|value| f32::from_bits(value.to_bits().swap_bytes())).collect();
    let big = file(folder.path(), "big.pfm", &pfm("PF 2 2 1\n", &swapped));
    assert_eq!(read_reference(&big, None).unwrap(), expected);
    // The content decides, not the name.
    let misnamed = file(folder.path(), "misnamed.exr", &pfm("PF\n2 2\n-1.0\n", &values));
    assert_eq!(read_reference(&misnamed, None).unwrap(), expected);
    let denoised = planes(&little, &["R", "G", "B"]);
    assert_eq!(denoised, expected.planes);
}

#[test]
fn a_pfm_file_may_be_grey_have_an_alpha_a_scale_and_line_ends_of_windows() {
    let folder = folder();
    let grey = file(folder.path(), "grey.pfm", &pfm("Pf\n2 1\n-1\n", &[0.5, 8.0]));
    assert_eq!(planes(&grey, &["Y"]), [[0.5, 8.0]]);
    let alpha = file(folder.path(), "alpha.pfm", &pfm("PF4\n1 1\n-1\n", &[0.5, 8.0, -2.0, 0.25]));
    assert_eq!(planes(&alpha, &["R", "G", "B", "A"]), [[0.5], [8.0], [-2.0], [0.25]]);
    let scaled = file(folder.path(), "scaled.pfm", &pfm("PF\n1 1\n-2.5e0\n", &[0.5, 8.0, -2.0]));
    assert_eq!(read_reference(&scaled, None).unwrap().planes, [[1.25], [20.0], [-5.0]]);
    let windows = file(folder.path(), "windows.pfm", &pfm("PF\r\n1 1\r\n-1.0\r\n", &[0.5, 8.0, -2.0]));
    assert_eq!(read_reference(&windows, None).unwrap().planes, [[0.5], [8.0], [-2.0]]);
    // The first pixel may begin with a byte that is white space elsewhere.
    let first = f32::from_le_bytes([b'\n', 0, 0, 0x40]);
    let spaced = file(folder.path(), "spaced.pfm", &pfm("PF 1\t1 -1.0 ", &[first, 8.0, -2.0]));
    assert_eq!(read_reference(&spaced, None).unwrap().planes, [[first], [8.0], [-2.0]]);
}

#[test]
fn an_odd_pfm_header_is_refused_with_what_is_odd() {
    let folder = folder();
    let spaces = format!("PF\n{}1 1\n-1\n", " ".repeat(2000));
    let digits = format!("PF\n{} 1\n-1\n", "9".repeat(100));
    for (header, said) in [
        ("PF\n0 1\n-1\n", "claims 0×1 pixels"),
        ("PF\n-1 1\n-1\n", "claims -1×1 pixels"),
        ("PF\n1 -99999999999999999999\n-1\n", "claims 1×-99999999999999999999 pixels"),
        ("PF\n99999999999999999999 1\n-1\n", "claims 99999999999999999999×1 pixels"),
        ("PF\n1048577 1\n-1\n", "claims 1048577×1 pixels"),
        ("PF\n1048576 1048576\n-1\n", "in 13194139533312 bytes, but 12 bytes follow"),
        ("PF\n1e3 1\n-1\n", "'1e3' as its width"),
        ("PF\nx y\n-1\n", "'x' as its width"),
        ("PF\n# a comment\n1 1\n-1\n", "'#' as its width"),
        ("PF\n1 1\n0\n", "'0' as its scale factor"),
        ("PF\n1 1\nnan\n", "'nan' as its scale factor"),
        ("PF\n1 1\n-inf\n", "'-inf' as its scale factor"),
        ("PF\n1 1\nlittle\n", "'little' as its scale factor"),
        ("PF\n1 1\n", "scale factor"),
        ("PF\n1 1\n-1.0 of the scene\n", "but 25 bytes follow"),
        ("PF\n1 2\n-1\n", "in 24 bytes, but 12 bytes follow"),
        ("Pf\n1 1\n-1\n", "in 4 bytes, but 12 bytes follow"),
        (&spaces, "as its width"),
        (&digits, "as its width"),
    ] {
        let path = file(folder.path(), "odd.pfm", &pfm(header, &[1.0, 2.0, 3.0]));
        let message = failure(&request(&path));
        assert!(message.contains(said) && message.contains("remedy: "), "{header}: {message}");
    }
    let path = file(folder.path(), "half.phm", &pfm("PH\n1 1\n-1\n", &[1.0, 2.0, 3.0]));
    assert!(failure(&request(&path)).contains("is not an OpenEXR file, nor a PFM or PNG file"));
}

#[test]
fn a_written_pfm_file_holds_every_bit() {
    let folder = folder();
    let path = folder.path().join("out.pfm");
    let odd = [f32::NAN, f32::from_bits(0xffc0_1234), f32::INFINITY, -0.0, f32::from_bits(1), f32::MIN];
    let odd_image = image(3, 2, (0..3).map(|_| odd.to_vec()).collect());
    assert_eq!(write(&path, &odd_image, Format::Pfm, PngEncoding::Srgb).unwrap(), WriteCounts::default());
    let bottom_up = [3, 4, 5, 0, 1, 2].map(|at| [odd[at]; 3]).concat();
    assert_eq!(std::fs::read(&path).unwrap(), pfm("PF\n3 2\n-1.0\n", &bottom_up));
    let read = read_reference(&path, None).unwrap();
    let bits = |image: &Image| image.planes.iter().flatten().map(|value| value.to_bits()).collect::<Vec<_>>();
    assert_eq!(bits(&read), bits(&odd_image));
    let written = |planes: &[f32]| {
        let planes = planes.iter().map(|&value| vec![value]).collect();
        write(&path, &image(1, 1, planes), Format::Pfm, PngEncoding::Srgb).unwrap();
        std::fs::read(&path).unwrap()
    };
    assert_eq!(written(&[0.5]), pfm("Pf\n1 1\n-1.0\n", &[0.5]));
    assert_eq!(written(&[0.5, 0.25]), pfm("PF4\n1 1\n-1.0\n", &[0.5, 0.5, 0.5, 0.25]));
    assert_eq!(written(&[1.0, 2.0, 3.0, 4.0]), pfm("PF4\n1 1\n-1.0\n", &[1.0, 2.0, 3.0, 4.0]));
}

#[test]
fn png_files_of_all_colours_and_depths_are_read() {
    let folder = folder();
    let mut files = Vec::new();
    for (color, depths) in [
        (GREY, &[1, 2, 4, 8, 16][..]),
        (RGB, &[8, 16]),
        (PALETTE, &[1, 2, 4, 8]),
        (GREY_ALPHA, &[8, 16]),
        (RGBA, &[8, 16]),
    ] {
        for &depth in depths {
            let mut png = Png::new(color, depth);
            if color == PALETTE {
                // As many colours as there are numbers, the second one transparent.
                png.palette = (0..3 << depth).map(|at: u32| (at * 37 + 11) as u8).collect();
                png.transparency = vec![255, 51];
            }
            files.push((format!("{color} {depth} interlaced"), png.clone().interlaced()));
            files.push((format!("{color} {depth}"), png));
        }
    }
    for (name, png) in files {
        let path = file(folder.path(), "in.png", &png.bytes());
        let most = f64::from((1_u32 << png.depth) - 1);
        let channels = png.samples.len() / 15;
        let mut expected: Vec<Vec<f64>> = (0..channels)
            .map(|channel| {
                let samples = png.samples.iter().skip(channel).step_by(channels);
                samples.map(|&sample| f64::from(sample) / most).collect()
            })
            .collect();
        let names: &[&str] = match png.color {
            GREY => &["Y"],
            GREY_ALPHA => &["Y", "A"],
            RGB => &["R", "G", "B"],
            _ => &["R", "G", "B", "A"],
        };
        if png.color == PALETTE {
            let color = |channel: usize| {
                let colors = png.samples.iter().map(|&at| png.palette[3 * usize::from(at) + channel]);
                colors.map(|value| f64::from(value) / 255.0).collect()
            };
            let alpha = png.samples.iter().map(|&at| if at == 1 { 0.2 } else { 1.0 }).collect();
            expected = vec![color(0), color(1), color(2), alpha];
        }
        let alpha = if names.contains(&"A") { expected.pop() } else { None };
        for plane in &mut expected {
            plane.iter_mut().for_each(|value| *value = srgb_to_linear(*value));
            // In an OpenEXR image, the colour is multiplied by the alpha.
            if let Some(alpha) = &alpha {
                plane.iter_mut().zip(alpha).for_each(|(value, alpha)| *value *= alpha);
            }
        }
        expected.extend(alpha);
        assert_close(&planes(&path, names), &expected, 2e-7, &name);
    }
}

#[test]
fn a_transparent_colour_of_a_png_file_is_an_alpha() {
    let folder = folder();
    let png = Png { transparency: vec![0, 255], samples: vec![0, 255], extent: [2, 1], ..Png::new(GREY, 8) };
    let path = file(folder.path(), "in.png", &png.bytes());
    assert_eq!(planes(&path, &["Y", "A"]), [[0.0, 0.0], [1.0, 0.0]]);
}

#[test]
fn a_written_png_file_holds_what_16_bits_can() {
    let folder = folder();
    let path = folder.path().join("out.png");
    let pixels = 41 * 25;
    let value = |at: usize| (at as f32 / (pixels - 1) as f32).powi(3);
    let alpha: Vec<f32> = (0..pixels).map(|at| (at * 7 % pixels) as f32 / (pixels - 1) as f32).collect();
    let under = |plane: Vec<f32>| plane.iter().zip(&alpha).map(|(value, alpha)| value * alpha).collect::<Vec<_>>();
    let plane = |shift: usize| (0..pixels).map(|at| value((at + shift) % pixels)).collect::<Vec<_>>();
    for (planes, names) in [
        (vec![plane(0)], &["Y"][..]),
        (vec![plane(0), plane(300), plane(900)], &["R", "G", "B"]),
        (vec![under(plane(5)), alpha.clone()], &["Y", "A"]),
        (vec![under(plane(0)), under(plane(300)), under(plane(900)), alpha.clone()], &["R", "G", "B", "A"]),
    ] {
        let picture = image(41, 25, planes);
        let counts = write(&path, &picture, Format::Png, PngEncoding::Srgb).unwrap();
        assert_eq!(counts, WriteCounts::default(), "{names:?}");
        let bytes = std::fs::read(&path).unwrap();
        write(&path, &picture, Format::Png, PngEncoding::Srgb).unwrap();
        assert_eq!(bytes, std::fs::read(&path).unwrap(), "{names:?}");
        let read = self::planes(&path, names);
        let as_encoded =
            |plane: &Vec<f32>| plane.iter().map(|&value| linear_to_srgb(value.into())).collect::<Vec<f64>>();
        if !names.contains(&"A") {
            let encoded: Vec<Vec<f32>> =
                read.iter().map(|plane| as_encoded(plane).into_iter().map(|value| value as f32).collect()).collect();
            let expected: Vec<_> = picture.planes.iter().map(as_encoded).collect();
            assert_close(&encoded, &expected, 0.51 / 65_535.0, "encoded");
        }
        // The curve is steepest at 1, with 2.28; the alpha is rounded as well.
        let expected: Vec<Vec<f64>> =
            picture.planes.iter().map(|plane| plane.iter().map(|&value| value.into()).collect()).collect();
        assert_close(&read, &expected, 1.7 / 65_535.0, "linear");
    }
}

#[test]
fn a_png_file_is_named_by_its_encoding_and_read_by_its_curve() {
    let folder = folder();
    let path = folder.path().join("out.png");
    let ramp = image(5, 1, vec![vec![0.0, 0.002, 0.214_041_14, 0.5, 1.0]]);
    let samples = |encoding| {
        write(&path, &ramp, Format::Png, encoding).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let has = |name: &[u8]| bytes.windows(4).any(|window| window == name);
        (planes(&path, &["Y"]).concat(), [has(b"sRGB"), has(b"gAMA")])
    };
    let (read, chunks) = samples(PngEncoding::Srgb);
    assert!(chunks[0]);
    assert_close(&[read], &[ramp.planes[0].iter().map(|&value| value.into()).collect()], 1.2 / 65_535.0, "sRGB");
    // Linear samples are still read by the curve of sRGB.
    let (read, chunks) = samples(PngEncoding::Linear);
    assert_eq!(chunks, [false, true]);
    let expected = ramp.planes[0].iter().map(|&value| srgb_to_linear((f64::from(value) * 65_535.0).round() / 65_535.0));
    assert_close(&[read], &[expected.collect()], 1e-7, "linear");
}

/// A normal and a distance are no light, nor are their halves and variances; an albedo is.
#[test]
fn the_curve_of_png_applies_to_features_of_light_alone() {
    let folder = folder();
    let input = folder.path().join("color.pfm");
    write(&input, &image(1, 1, vec![vec![1.0]; 3]), Format::Pfm, PngEncoding::Srgb).unwrap();
    let value = 0.25_f32;
    let files = ["mean", "a", "b", "variance"].map(|part| {
        ["albedo", "normal", "depth"].map(|name| {
            let path = folder.path().join(format!("{name}_{part}.png"));
            write(&path, &image(1, 1, vec![vec![value]; 3]), Format::Png, PngEncoding::Linear).unwrap();
            (name.to_owned(), LayerRef { file: path, layer: None })
        })
    });
    let [features, feature_half_a, feature_half_b, feature_variance] = files.map(Vec::from);
    let set = BufferSet::read(&BufferSetRequest {
        features,
        feature_half_a,
        feature_half_b,
        feature_variance,
        ..request(&input)
    })
    .unwrap();
    for (name, signal) in set.features() {
        let expected = if name == "albedo" { srgb_to_linear(value.into()) } else { value.into() };
        let parts = [Some(signal.mean), signal.half_a, signal.half_b, signal.variance_of_mean];
        for part in parts {
            let planes = part.unwrap().planes;
            assert!(!planes.is_empty());
            assert_close(&planes, &vec![vec![expected]; planes.len()], 1e-5, name);
        }
    }
    assert_eq!(set.features().len(), 3);
}

#[test]
fn values_that_png_cannot_hold_are_clamped_and_counted() {
    let folder = folder();
    let path = folder.path().join("out.png");
    let values = vec![-0.5, 1.5, f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 0.0, 1.0];
    let counts = write(&path, &image(7, 1, vec![values]), Format::Png, PngEncoding::Srgb).unwrap();
    assert_eq!(counts, WriteCounts { clamped_values: 2, non_finite_values: 3 });
    assert_eq!(planes(&path, &["Y"]), [[0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]]);
    // Light without cover, light above its cover, no light, an alpha above 1, one that is not finite.
    let (light, alpha) = (vec![0.5, 0.5, 0.0, 0.5, 0.0], vec![0.0, 0.25, 0.25, 2.0, f32::NAN]);
    let counts = write(&path, &image(5, 1, vec![light, alpha]), Format::Png, PngEncoding::Linear).unwrap();
    assert_eq!(counts, WriteCounts { clamped_values: 3, non_finite_values: 1 });
    assert_close(
        &planes(&path, &["A"]),
        &[vec![0.0, (0.25_f64 * 65_535.0).round() / 65_535.0, 0.25, 1.0, 0.0]],
        1.0 / 65_535.0,
        "alpha",
    );
}

#[test]
fn a_picture_of_one_pixel_survives_every_format() {
    let folder = folder();
    let pixel = image(1, 1, vec![vec![0.25], vec![0.5], vec![1.0]]);
    for name in ["one.exr", "one.pfm", "one.PNG"] {
        let path = folder.path().join(name);
        let format = Format::from_extension(&path).unwrap();
        write(&path, &pixel, format, PngEncoding::Srgb).unwrap();
        let read = read_reference(&path, None).unwrap();
        assert_eq!(read.extent, pixel.extent);
        let expected: Vec<Vec<f64>> = pixel.planes.iter().map(|plane| vec![plane[0].into()]).collect();
        assert_close(&read.planes, &expected, 1.2 / 65_535.0, name);
    }
    assert_eq!(Format::from_extension(Path::new("one.tiff")), None);
    assert_eq!(Format::from_extension(Path::new("exr")), None);
    assert_eq!(folder.path().read_dir().unwrap().count(), 3);
}

#[test]
fn what_is_no_picture_is_not_written() {
    let folder = folder();
    let path = folder.path().join("out.png");
    for odd in
        [image(1, 1, vec![]), image(1, 1, vec![vec![0.0]; 5]), image(2, 1, vec![vec![0.0]]), image(0, 0, vec![vec![]])]
    {
        for format in [Format::OpenExr, Format::Pfm, Format::Png] {
            let error = write(&path, &odd, format, PngEncoding::Srgb).unwrap_err();
            assert!(matches!(error, Error::Request(_)), "{error}");
        }
    }
    let lost = folder.path().join("nowhere/out.pfm");
    let error = write(&lost, &image(1, 1, vec![vec![0.0]]), Format::Pfm, PngEncoding::Srgb).unwrap_err();
    assert!(error.to_string().contains("out.pfm") && matches!(error, Error::File { .. }), "{error}");
    assert_eq!(folder.path().read_dir().unwrap().count(), 0);
}

#[test]
fn a_png_file_that_claims_too_much_is_refused() {
    let folder = folder();
    let claims = |width, height| Png { extent: [width, height], samples: Vec::new(), ..Png::new(RGB, 16) };
    for (png, said) in [
        (claims(0, 1), ""),
        (claims(i32::MAX as u32, 1), "claims 2147483647×1 pixels"),
        (claims(1 << 20, (1 << 20) + 1), "claims 1048576×1048577 pixels"),
        (claims(1 << 20, 1 << 20), "larger than the file can hold"),
        (claims(1 << 20, 1), "larger than the file can hold"),
        (claims(50, 50), "is damaged"),
        (Png { depth: 3, ..Png::new(GREY, 4) }, "is damaged"),
        (Png { color: 5, ..Png::new(GREY, 4) }, "is damaged"),
        (Png::new(PALETTE, 4), "is damaged"),
    ] {
        let mut header: Vec<u8> = png.extent.iter().flat_map(|side| side.to_be_bytes()).collect();
        header.extend([png.depth, png.color, 0, 0, 0]);
        let samples = if png.samples.is_empty() { vec![0; 600] } else { png.raw() };
        let mut bytes = b"\x89PNG\r\n\x1a\n".to_vec();
        bytes.extend([chunk(b"IHDR", &header), chunk(b"IDAT", &zlib(&samples)), chunk(b"IEND", &[])].concat());
        let message = failure(&request(&file(folder.path(), "in.png", &bytes)));
        assert!(message.contains(said) && message.contains("in.png") && message.contains("remedy: "), "{message}");
    }
}

/// Valid files of all kinds.
fn valid() -> Vec<(&'static str, Vec<u8>)> {
    let values: Vec<f32> = (0..24).map(|value| value as f32).collect();
    let mut palette = Png::new(PALETTE, 4).interlaced();
    palette.palette = (0..48).collect();
    palette.transparency = vec![9];
    vec![
        ("PF.pfm", pfm("PF\n2 4\n-1.0\n", &values)),
        ("PF4.pfm", pfm("PF4\r\n3 2\r\n1.0\r\n", &values)),
        ("grey.png", Png::new(GREY, 1).bytes()),
        ("palette.png", palette.bytes()),
        ("rgba.png", Png::new(RGBA, 8).interlaced().bytes()),
    ]
}

#[test]
fn a_picture_is_refused_wherever_it_ends() {
    let folder = folder();
    for (name, whole) in valid() {
        let path = file(folder.path(), name, &whole);
        BufferSet::read(&request(&path)).unwrap();
        for length in 0..whole.len() {
            std::fs::write(&path, &whole[..length]).unwrap();
            let message = failure(&request(&path));
            assert!(message.contains(name) && message.contains("remedy: "), "{length} bytes: {message}");
        }
    }
}

#[test]
fn flipped_bytes_of_pictures_never_panic() {
    let folder = folder();
    for (name, whole) in valid() {
        let path = folder.path().join(name);
        for at in 0..whole.len() {
            for value in [0, b' ', 0x7f, 0xff, whole[at] ^ 1, whole[at] ^ 0x10] {
                let mut bytes = whole.clone();
                bytes[at] = value;
                let is_png = name.ends_with("png");
                let sealed = is_png.then(|| sealed(&bytes));
                for bytes in [Some(bytes), sealed].into_iter().flatten() {
                    std::fs::write(&path, &bytes).unwrap();
                    // Many of these files are still readable; the errors of the others must name the file.
                    if let Err(error) = BufferSet::read(&request(&path)) {
                        let message = error.to_string();
                        assert!(message.contains(name) && message.contains("remedy: "), "{message}");
                        assert!(!message.contains("ChunkType"), "{message}");
                    }
                }
            }
        }
    }
}
