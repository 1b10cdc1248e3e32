//! Small pictures of inputs, results and references, for the page.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use stein::{Extent, Image};
use stein_metric as metric;

use crate::measure::{Case, Outcome};
use crate::{Error, Result};

/// Largest length of the longer side, in pixels.
const LARGEST_SIDE: u32 = 384;

/// Lengths of the longer side, in pixels, to try until all pictures together are small enough.
const SIDES: [u32; 6] = [LARGEST_SIDE, 320, 256, 192, 128, 96];

/// Largest size of all pictures together, in bytes.
const BUDGET: usize = 6 << 20;

/// Number of results that are shown for each set: the best, by relative MSE.
const SHOWN: usize = 4;

/// Pictures of all sets.
#[derive(Debug, Default)]
pub struct Gallery {
    sets: Vec<Pictures>,
}

/// Pictures of one set.
#[derive(Debug)]
struct Pictures {
    set: String,
    pictures: Vec<Picture>,
}

#[derive(Debug)]
struct Picture {
    caption: String,
    shown: Shown,
}

/// A picture for the page.
pub(super) struct Thumbnail {
    pub(super) caption: String,
    /// PNG, as a `data:` address.
    pub(super) source: String,
    pub(super) extent: Extent,
}

/// An image as a display shows it.
#[derive(Clone, Debug, PartialEq)]
struct Shown {
    extent: Extent,
    /// Red, green and blue of each pixel.
    bytes: Vec<u8>,
}

impl Gallery {
    /// Adds the input, the results and the reference of a set.
    pub(super) fn add(&mut self, case: &Case<'_>, outcomes: &[Outcome]) -> Result<()> {
        let picture = |caption: String, image: &Image| {
            Ok::<_, Error>(Picture { caption, shown: Shown::of(image)?.within(LARGEST_SIDE) })
        };
        let mut best: Vec<&Outcome> = outcomes.iter().collect();
        best.sort_by(|a, b| {
            let error = |outcome: &Outcome| outcome.row.relative_mse().unwrap_or(f64::INFINITY);
            error(a).total_cmp(&error(b))
        });
        let mut pictures = vec![picture("noisy".into(), &case.frame.color().mean)?];
        for outcome in best.into_iter().take(SHOWN) {
            pictures.push(picture(outcome.row.configuration.clone(), &outcome.image)?);
        }
        if let Some(reference) = case.reference {
            pictures.push(picture("reference".into(), reference)?);
        }
        self.sets.push(Pictures { set: case.set.name.clone(), pictures });
        Ok(())
    }

    /// Returns the name of each set with its pictures. All pictures have the largest size that keeps the page small;
    /// sets that do not fit even at the smallest size are left out.
    pub(super) fn thumbnails(&self) -> Result<Vec<(&str, Vec<Thumbnail>)>> {
        let mut made = Vec::new();
        for side in SIDES {
            made = self.of_side(side)?;
            let bytes: usize =
                made.iter().flat_map(|(_, thumbnails)| thumbnails).map(|thumbnail| thumbnail.source.len()).sum();
            if bytes <= BUDGET {
                return Ok(made);
            }
        }
        let mut left = BUDGET;
        made.retain(|(_, thumbnails)| {
            let bytes = thumbnails.iter().map(|thumbnail| thumbnail.source.len()).sum();
            let fits = bytes <= left;
            left -= if fits { bytes } else { 0 };
            fits
        });
        Ok(made)
    }

    fn of_side(&self, side: u32) -> Result<Vec<(&str, Vec<Thumbnail>)>> {
        let thumbnail = |picture: &Picture| {
            let shown = picture.shown.within(side);
            Ok(Thumbnail { caption: picture.caption.clone(), source: shown.png()?, extent: shown.extent })
        };
        self.sets
            .iter()
            .map(|set| Ok((set.set.as_str(), set.pictures.iter().map(thumbnail).collect::<Result<_>>()?)))
            .collect()
    }
}

impl Shown {
    fn of(image: &Image) -> Result<Self> {
        Ok(Self { extent: image.extent, bytes: metric::display_bytes(image)? })
    }

    /// Returns a copy whose longer side is at most `side`. Each pixel is the mean of the displayed values that it
    /// covers, so noise looks like noise seen from afar, and one bright pixel stays a bright pixel.
    fn within(&self, side: u32) -> Self {
        let Extent { width, height } = self.extent;
        let longest = width.max(height);
        if longest <= side {
            return self.clone();
        }
        let shorter = |length: u32| (u64::from(length) * u64::from(side)).div_ceil(longest.into()) as u32;
        let extent = Extent { width: shorter(width), height: shorter(height) };
        let range = |position: u32, to: u32, from: u32| {
            let first = (u64::from(position) * u64::from(from) / u64::from(to)) as usize;
            let end = (u64::from(position + 1) * u64::from(from)).div_ceil(to.into()) as usize;
            first..end
        };
        let mut bytes = Vec::with_capacity(extent.pixels() * 3);
        for y in 0..extent.height {
            for x in 0..extent.width {
                let (rows, columns) = (range(y, extent.height, height), range(x, extent.width, width));
                let count = (rows.len() * columns.len()) as u32;
                let mut sums = [0u32; 3];
                for row in rows {
                    for pixel in
                        self.bytes[(row * width as usize + columns.start) * 3..][..columns.len() * 3].chunks_exact(3)
                    {
                        sums.iter_mut().zip(pixel).for_each(|(sum, byte)| *sum += u32::from(*byte));
                    }
                }
                bytes.extend(sums.map(|sum| ((sum + count / 2) / count) as u8));
            }
        }
        Self { extent, bytes }
    }

    fn png(&self) -> Result<String> {
        let failed = |error: png::EncodingError| Error::Part { part: "a thumbnail", reason: error.to_string() };
        let mut file = Vec::new();
        let mut encoder = png::Encoder::new(&mut file, self.extent.width, self.extent.height);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_compression(png::Compression::High);
        let mut writer = encoder.write_header().map_err(failed)?;
        writer.write_image_data(&self.bytes).map_err(failed)?;
        writer.finish().map_err(failed)?;
        Ok(format!("data:image/png;base64,{}", STANDARD.encode(file)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_large_picture_is_averaged_and_a_small_one_stays() {
        let shown =
            Shown { extent: Extent { width: 4, height: 2 }, bytes: (0..8).flat_map(|i| [i * 10, 0, 255]).collect() };
        assert_eq!(shown.within(4), shown);
        let half = shown.within(2);
        assert_eq!(half.extent, Extent { width: 2, height: 1 });
        assert_eq!(half.bytes, [25, 0, 255, 45, 0, 255]);
        assert_eq!(shown.within(3).extent, Extent { width: 3, height: 2 });
    }
}
