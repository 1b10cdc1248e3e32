//! Sample statistics to and from files in the native layout (see [`crate::buffers`]).

use std::path::Path;

use super::{SampleCounts, Samples};
use crate::buffers::{BufferSet, NamedLayer, RawSignal, write_layers};
use crate::error::{Error, Result};
use crate::frame::SamplesPerPixel;
use crate::image::Image;

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
        let mut layers = Vec::new();
        push_signal(&mut layers, &["R", "G", "B"], self.color(), ["", "halfA", "halfB", "variance"].map(str::to_owned));
        for (name, raw) in self.features() {
            let suffixes = suffixes(name, raw.mean.channels());
            push_signal(&mut layers, suffixes, raw, ["", "_halfA", "_halfB", "_variance"].map(|part| format!("{name}{part}")));
        }
        let mut texts = attributes.to_vec();
        match self.samples_per_pixel() {
            SamplesPerPixel::Uniform(samples) => texts.push(("samples".into(), samples.to_string())),
            SamplesPerPixel::PerPixel(samples) => layers.push(layer("", &["samples"], samples)),
            SamplesPerPixel::Unknown => {}
        }
        write_layers(path, &layers, &texts)
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

fn push_signal(layers: &mut Vec<NamedLayer>, suffixes: &[&str], raw: RawSignal, names: [String; 4]) {
    let images = [Some(raw.mean), raw.half_a, raw.half_b, raw.variance_of_mean];
    layers.extend(names.iter().zip(images).filter_map(|(name, image)| image.map(|image| layer(name, suffixes, image))));
}

pub(super) fn layer(name: &str, channels: &[&str], image: Image) -> NamedLayer {
    NamedLayer { name: name.to_owned(), channels: channels.iter().map(|&channel| channel.to_owned()).collect(), image }
}
