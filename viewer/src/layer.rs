//! Layers: every image that can be looked at, with the data that is needed to show and to explain it.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use stein::Image;

/// Longest side of a thumbnail, in pixels.
const THUMBNAIL_SIDE: usize = 96;
/// Largest number of pixels that a range and a histogram are made of.
const SAMPLED_PIXELS: usize = 1 << 16;
/// Largest number of decades that a logarithmic range shows.
const DECADES: f32 = 6.0;

/// Group of a layer in the strip.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Group {
    /// Results, and the images that they are compared with.
    Result,
    /// The noisy colour and the knowledge about its noise.
    Input,
    /// Layers that are denoised along with the colour, before and after.
    Along,
    /// Features before and after prefiltering.
    Features,
    /// FIRST, SECOND and THIRD with the estimates that judge them; the scales of GEM.
    Candidates,
    /// Shares of the candidates.
    Selection,
    /// Errors of the result, and where samples should go.
    Error,
}

impl Group {
    /// All groups, in the order of the strip.
    pub const ALL: [Self; 7] =
        [Self::Result, Self::Input, Self::Along, Self::Features, Self::Candidates, Self::Selection, Self::Error];

    /// Returns the title that users read.
    pub fn title(self) -> &'static str {
        match self {
            Self::Result => "Result",
            Self::Input => "Input",
            Self::Along => "Denoised along",
            Self::Features => "Features",
            Self::Candidates => "Candidates",
            Self::Selection => "Selection",
            Self::Error => "Error and sampling",
        }
    }
}

/// How values are spread over a false-colour scale.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub enum Scale {
    /// Evenly from the low to the high end.
    Linear,
    /// Evenly in the logarithm; values at or below 0 are at the low end.
    Log,
    /// Evenly, with two colours that meet in the middle.
    Diverging,
}

/// Meaning of the values of a layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Scene-linear colour.
    Color,
    /// A vector with components from −1 to 1, such as a normal.
    Direction,
    /// Numbers, shown in false colour; several channels are reduced to their mean or to one of them.
    Scalar(Scale),
    /// Shares of FIRST, SECOND and THIRD, shown in red, green and blue.
    Shares,
}

/// Ends of a false-colour scale.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Range {
    /// Value of the first colour.
    pub low: f32,
    /// Value of the last colour.
    pub high: f32,
}

/// Everything about a layer except for its values.
#[derive(Clone, Debug)]
pub struct Description {
    /// Name in files and on the command line, such as `albedo_prefiltered`; unique among the layers of a document.
    pub name: String,
    /// Title for people.
    pub title: String,
    /// Explanation of the layer, in a sentence.
    pub about: String,
    /// Group in the strip.
    pub group: Group,
    /// Meaning of the values.
    pub kind: Kind,
    /// Unit of the values; empty for pure numbers.
    pub unit: &'static str,
}

/// An image with an identifier, under which its texture is kept.
#[derive(Clone, Debug)]
pub struct Shown {
    /// Identifier, different for any two images of this process.
    pub id: u64,
    /// Image with one to three planes.
    pub image: Arc<Image>,
}

impl Shown {
    /// Gives an image a new identifier.
    pub fn new(image: Arc<Image>) -> Self {
        static NEXT: AtomicU64 = AtomicU64::new(1);
        Self { id: NEXT.fetch_add(1, Ordering::Relaxed), image }
    }
}

/// An image that can be looked at.
#[derive(Debug)]
pub struct Layer {
    /// Everything about the layer except for its values.
    pub description: Description,
    /// Image with one to three planes.
    pub shown: Shown,
    /// The image, reduced to at most 96 pixels along its longer side.
    pub thumbnail: Shown,
    /// Range of a false-colour scale that shows most of the values.
    pub range: Range,
    /// Histogram of the values.
    pub histogram: Histogram,
}

impl Layer {
    /// Creates a layer. Computes the range from the values if `range` is `None`.
    pub fn new(description: Description, image: Arc<Image>, range: Option<Range>) -> Self {
        let range = range.unwrap_or_else(|| automatic_range(&image, description.kind));
        let thumbnail = Shown::new(Arc::new(thumbnail(&image)));
        let histogram = Histogram::of(&image, matches!(description.kind, Kind::Color | Kind::Scalar(Scale::Log)));
        Self { description, shown: Shown::new(image), thumbnail, range, histogram }
    }

    /// Returns the same image under another description.
    pub fn renamed(&self, description: Description) -> Self {
        Self {
            description,
            shown: self.shown.clone(),
            thumbnail: self.thumbnail.clone(),
            range: self.range,
            histogram: self.histogram.clone(),
        }
    }

    /// Returns the image with the values.
    pub fn image(&self) -> &Image {
        &self.shown.image
    }

    /// Returns the name.
    pub fn name(&self) -> &str {
        &self.description.name
    }

    /// Returns the values of a pixel, one per plane; `None` outside of the image.
    pub fn values(&self, x: u32, y: u32) -> Option<Vec<f32>> {
        let extent = self.image().extent;
        let inside = x < extent.width && y < extent.height;
        inside.then(|| {
            self.image().planes.iter().map(|plane| plane[y as usize * extent.width as usize + x as usize]).collect()
        })
    }

    /// Returns the names of the planes, one letter or word each.
    pub fn channel_names(&self) -> &'static [&'static str] {
        match (self.description.kind, self.image().channels()) {
            (Kind::Shares, _) => &["FIRST", "SECOND", "THIRD"],
            (_, 1) => &[""],
            (Kind::Direction, _) | (_, 2) => &["x", "y", "z"],
            _ => &["R", "G", "B"],
        }
    }
}

/// Frequencies of the values, per plane.
#[derive(Clone, Debug, PartialEq)]
pub struct Histogram {
    /// Whether the bins are even in log₂ of the value.
    pub logarithmic: bool,
    /// Lower edge of the first bin: a value, or its log₂.
    pub first: f32,
    /// Upper edge of the last bin.
    pub last: f32,
    /// Numbers of finite values in each bin, one vector per plane. A large image is counted by an even sample of at
    /// most 65536 pixels; all other fields cover all values.
    pub counts: Vec<Vec<u32>>,
    /// Smallest finite value.
    pub least: f32,
    /// Largest finite value.
    pub most: f32,
    /// Mean of the finite values.
    pub mean: f64,
    /// Number of values that are NaN or infinite.
    pub not_finite: usize,
}

impl Histogram {
    /// Number of bins.
    pub const BINS: usize = 128;

    fn of(image: &Image, logarithmic: bool) -> Self {
        let finite = || image.planes.iter().flatten().copied().filter(|value| value.is_finite());
        let (mut least, mut most, mut sum, mut count) = (f32::INFINITY, f32::NEG_INFINITY, 0.0, 0_usize);
        for value in finite() {
            (least, most, sum, count) = (least.min(value), most.max(value), sum + f64::from(value), count + 1);
        }
        if count == 0 {
            (least, most) = (0.0, 0.0);
        }
        let (first, last) = if logarithmic {
            let last = most.max(f32::MIN_POSITIVE).log2().ceil().clamp(-60.0, 60.0);
            (last - 20.0, last)
        } else {
            (least, if most > least { most } else { least + 1.0 })
        };
        let bin = |value: f32| {
            let place = if logarithmic { value.max(f32::MIN_POSITIVE).log2() } else { value };
            (((place - first) / (last - first) * Self::BINS as f32) as usize).min(Self::BINS - 1)
        };
        let counts = image.planes.iter().map(|plane| {
            let mut counts = vec![0; Self::BINS];
            sample(image)
                .map(|pixel| plane[pixel])
                .filter(|value| value.is_finite())
                .for_each(|value| counts[bin(value)] += 1);
            counts
        });
        let counts = counts.collect();
        let not_finite = image.planes.len() * image.extent.pixels() - count;
        Self { logarithmic, first, last, counts, least, most, mean: sum / count.max(1) as f64, not_finite }
    }
}

/// Returns an even sample of the pixels, which stands for all.
fn sample(image: &Image) -> impl Iterator<Item = usize> {
    let pixels = image.extent.pixels();
    // An odd step, so that an even width does not reduce the sample to a few columns.
    (0..pixels).step_by(pixels.div_ceil(SAMPLED_PIXELS) | 1)
}

/// Computes the range of a false-colour scale that shows most of an image, from a sample of its pixels.
fn automatic_range(image: &Image, kind: Kind) -> Range {
    let mean = |pixel: usize| image.planes.iter().map(|plane| plane[pixel]).sum::<f32>() / image.channels() as f32;
    let mut values: Vec<f32> = sample(image).map(mean).filter(|value| value.is_finite()).collect();
    range_of(&mut values, kind)
}

/// Computes the range that shows most of the values: half a percent is left out at each end. On a logarithmic scale, 2
/// % of the positive values are left out at the lower end.
pub(crate) fn range_of(values: &mut [f32], kind: Kind) -> Range {
    if values.is_empty() {
        return Range { low: 0.0, high: 1.0 };
    }
    values.sort_unstable_by(f32::total_cmp);
    let at = |share: f32| values[((values.len() - 1) as f32 * share) as usize];
    let (low, high) = (at(0.005), at(0.995));
    let or_one = |value: f32| if value > 0.0 { value } else { 1.0 };
    match kind {
        Kind::Scalar(Scale::Diverging) => {
            let most = or_one(low.abs().max(high.abs()));
            Range { low: -most, high: most }
        }
        Kind::Scalar(Scale::Log) => {
            let high = or_one(high);
            let first_positive = values.partition_point(|value| *value <= 0.0);
            let low = values.get(first_positive + (values.len() - first_positive) / 50).copied().unwrap_or(high);
            Range { low: low.clamp(high * 10.0_f32.powf(-DECADES), high * 0.1), high }
        }
        _ if high > low => Range { low, high },
        _ => Range { low, high: low + or_one(low.abs()) },
    }
}

/// Averages boxes of pixels, so that no side is longer than [`THUMBNAIL_SIDE`].
fn thumbnail(image: &Image) -> Image {
    let (width, height) = (image.extent.width as usize, image.extent.height as usize);
    let factor = width.max(height).div_ceil(THUMBNAIL_SIDE).max(1);
    let extent = stein::Extent { width: width.div_ceil(factor) as u32, height: height.div_ceil(factor) as u32 };
    let shrunk = |plane: &Vec<f32>| {
        let mut shrunk = Vec::with_capacity(extent.pixels());
        for top in (0..height).step_by(factor) {
            for left in (0..width).step_by(factor) {
                let rows = top..(top + factor).min(height);
                let columns = left..(left + factor).min(width);
                let count = rows.len() * columns.len();
                let sum: f32 = rows.flat_map(|y| &plane[y * width + columns.start..y * width + columns.end]).sum();
                shrunk.push(sum / count as f32);
            }
        }
        shrunk
    };
    Image { extent, planes: image.planes.iter().map(shrunk).collect() }
}

/// Returns one plane of an image as an image.
pub fn single_plane(image: &Image, plane: usize) -> Image {
    Image { extent: image.extent, planes: vec![image.planes[plane].clone()] }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_histogram_of_a_large_image_is_that_of_a_sample_and_its_ends_are_those_of_all() {
        let extent = stein::Extent { width: 512, height: 512 };
        // Stripes that are one pixel wide.
        let mut plane: Vec<f32> = (0..extent.pixels()).map(|pixel| (pixel % 2) as f32).collect();
        (plane[1234], plane[5678], plane[4321]) = (-2.0, 6.0, f32::NAN);
        let Histogram { counts, least, most, not_finite, mean, .. } =
            Histogram::of(&Image { extent, planes: vec![plane] }, false);
        assert_eq!((least, most, not_finite), (-2.0, 6.0, 1));
        assert!((mean - 0.5).abs() < 1e-3, "{mean}");
        // On a scale from −2 to 6, 0 lies at one quarter and 1 at three eighths.
        let [zeros, ones] = [Histogram::BINS / 4, Histogram::BINS * 3 / 8].map(|bin| counts[0][bin]);
        assert!(zeros + ones > 40_000 && zeros + ones <= 1 << 16 && zeros.abs_diff(ones) < 100, "{zeros} and {ones}");
    }
}
