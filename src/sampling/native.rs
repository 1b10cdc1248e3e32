//! Sample statistics to and from files in the native layout (see [`crate::buffers`]).

use std::path::Path;

use exr::prelude::*;

use super::{SampleCounts, Samples};
use crate::buffers::{BufferSet, RawSignal};
use crate::error::{Error, Result};
use crate::frame::SamplesPerPixel;
use crate::image;

impl Samples {
    /// Takes up a render where its file left off, so that more samples can be merged into it. Needs the samples per pixel, halves and variances; the features
    /// are those that the set uses.
    ///
    /// # Errors
    /// Unknown, odd or fractional sample counts, and as [`Samples::from_signals`].
    pub fn from_buffer_set(set: &BufferSet) -> Result<Self> {
        let count = |samples: f32| {
            let whole = samples >= 0.0 && samples % 2.0 == 0.0 && samples <= u32::MAX as f32;
            whole.then_some(samples as u32 / 2).ok_or_else(|| Error::File {
                path: set.input().to_owned(),
                problem: format!("has {samples} samples in some pixel, which are not two equal halves"),
                remedy: "render with even sample counts, half of them for each half buffer".into(),
            })
        };
        let extent = set.extent();
        let pairs = match set.samples_per_pixel() {
            SamplesPerPixel::Uniform(samples) => vec![count(samples)?; extent.pixels()],
            SamplesPerPixel::PerPixel(samples) => samples.planes[0].iter().map(|&samples| count(samples)).collect::<Result<_>>()?,
            SamplesPerPixel::Unknown => {
                return Err(Error::File {
                    path: set.input().to_owned(),
                    problem: "does not say how many samples its pixels have, so that further samples cannot be added".into(),
                    remedy: "let the renderer write a header attribute or a channel `samples`".into(),
                });
            }
        };
        let counts = SampleCounts::from_pairs(extent, pairs)?;
        let features = set.features().map(|(name, raw)| (name.to_owned(), raw)).collect();
        Self::from_signals(set.color(), features, &counts)
    }

    /// Writes everything in the native layout: 32-bit floats, ZIP. The samples per pixel go into the header where they are the same everywhere, else into a
    /// channel `samples`; pixels without samples hold NaN. `attributes` are further texts for the header.
    ///
    /// The file appears under its name only when it is complete; an existing one is replaced.
    ///
    /// # Errors
    /// Attributes that OpenEXR cannot store, and whatever the file system reports.
    pub fn write(&self, path: &Path, attributes: &[(String, String)]) -> Result<()> {
        let mut channels = SmallVec::new();
        push_signal(&mut channels, "", &["R", "G", "B"], self.color(), ["halfA", "halfB", "variance"].map(str::to_owned));
        for (name, raw) in self.features() {
            let suffixes = suffixes(name, raw.mean.channels());
            push_signal(&mut channels, name, suffixes, raw, ["halfA", "halfB", "variance"].map(|part| format!("{name}_{part}")));
        }
        let mut texts = attributes.to_vec();
        match self.samples_per_pixel() {
            SamplesPerPixel::Uniform(samples) => texts.push(("samples".into(), samples.to_string())),
            SamplesPerPixel::PerPixel(samples) => push_planes(&mut channels, "", &["samples"], samples),
            SamplesPerPixel::Unknown => {}
        }

        let extent = self.extent();
        let size = Vec2(extent.width as usize, extent.height as usize);
        let mut layer = Layer::new(size, LayerAttributes::default(), Encoding::SMALL_LOSSLESS, AnyChannels::sort(channels));
        for (name, value) in &texts {
            let (Some(name), Some(value)) = (Text::new_or_none(name), Text::new_or_none(value)) else {
                return Err(Error::Request {
                    problem: format!("the attribute '{name}' holds characters that OpenEXR cannot store"),
                    remedy: "use Latin-1 characters".into(),
                });
            };
            layer.attributes.other.insert(name, AttributeValue::Text(value));
        }
        write_then_rename(&Image::from_layer(layer), path)
    }
}

/// Channel names by custom: directions have x, y, z, a distance z.
fn suffixes(name: &str, channels: usize) -> &'static [&'static str] {
    match (name, channels) {
        ("depth", 1) => &["Z"],
        (_, 1) => &["V"],
        ("normal" | "position", 3) => &["X", "Y", "Z"],
        (_, 2) => &["X", "Y"],
        _ => &["R", "G", "B"],
    }
}

fn push_signal(channels: &mut SmallVec<[AnyChannel<FlatSamples>; 4]>, name: &str, suffixes: &[&str], raw: RawSignal, companions: [String; 3]) {
    push_planes(channels, name, suffixes, raw.mean);
    for (name, image) in companions.iter().zip([raw.half_a, raw.half_b, raw.variance_of_mean]) {
        if let Some(image) = image {
            push_planes(channels, name, suffixes, image);
        }
    }
}

fn push_planes(channels: &mut SmallVec<[AnyChannel<FlatSamples>; 4]>, layer: &str, suffixes: &[&str], image: image::Image) {
    for (suffix, plane) in suffixes.iter().zip(image.planes) {
        let name = if layer.is_empty() { (*suffix).to_owned() } else { format!("{layer}.{suffix}") };
        channels.push(AnyChannel::new(name.as_str(), FlatSamples::F32(plane)));
    }
}

fn write_then_rename(image: &Image<Layer<AnyChannels<FlatSamples>>>, path: &Path) -> Result<()> {
    let failed = |message: String| Error::File {
        path: path.to_owned(),
        problem: format!("cannot be written: {message}"),
        remedy: "check that the folder exists, may be written to and has space left".into(),
    };
    let folder = match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    let mut builder = tempfile::Builder::new();
    builder.prefix(".stein-").suffix(".exr.part");
    // Temporary files are private by default; an output is as readable as the user's other files.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    let mut file = builder.tempfile_in(folder).map_err(|error| failed(error.to_string()))?;
    image.write().to_unbuffered(file.as_file_mut()).map_err(|error| failed(error.to_string()))?;
    file.persist(path).map_err(|error| failed(error.error.to_string()))?;
    Ok(())
}
