//! Sample statistics to and from files in the native layout (see [the crate](crate)).

use std::path::Path;

use stein::error::FileCause;
use stein::frame::{RawSignal, SamplesPerPixel};
use stein::sampling::{SampleCounts, Samples};
use stein::{Error, Image, Result};

use crate::{BufferSet, NamedLayer, write_layers};

impl BufferSet {
    /// Continues a render from its file, so that more samples can be merged into it. Needs the samples per pixel,
    /// halves and variances; the features are those that the set uses.
    ///
    /// # Errors
    /// [`Error::File`] for unknown, odd or fractional sample counts; otherwise as [`Samples::from_signals`].
    pub fn to_samples(&self) -> Result<Samples> {
        let count = |samples: f32| {
            let whole = samples >= 0.0 && samples % 2.0 == 0.0 && samples <= u32::MAX as f32;
            whole.then_some(samples as u32 / 2).ok_or_else(|| Error::File {
                path: self.input().to_owned(),
                cause: FileCause::UnevenSamples { samples },
            })
        };
        let extent = self.extent();
        let pairs = match self.samples_per_pixel() {
            SamplesPerPixel::Uniform(samples) => vec![count(samples)?; extent.pixels()],
            SamplesPerPixel::PerPixel(samples) => {
                samples.planes[0].iter().map(|&samples| count(samples)).collect::<Result<_>>()?
            }
            SamplesPerPixel::Unknown => {
                return Err(Error::File { path: self.input().to_owned(), cause: FileCause::NoSampleCounts });
            }
        };
        let counts = SampleCounts::from_pairs(extent, pairs)?;
        let features = self.features().map(|(name, raw)| (name.to_owned(), raw)).collect();
        Samples::from_signals(self.color(), features, &counts)
    }
}

/// Writes everything in the native layout: 32-bit floats, ZIP. The samples per pixel go into the header if all pixels
/// have the same number, else into a channel `samples`; pixels without samples hold NaN. `attributes` are further texts
/// for the header.
///
/// The file appears under its name only when it is complete; an existing one is replaced.
///
/// # Errors
/// As [`write_layers`].
pub fn write_samples(samples: &Samples, path: &Path, attributes: &[(String, String)]) -> Result<()> {
    let mut layers = Vec::new();
    push_signal(&mut layers, &["R", "G", "B"], samples.color(), ["", "halfA", "halfB", "variance"].map(str::to_owned));
    for (name, raw) in samples.features() {
        let suffixes = suffixes(name, raw.mean.channels());
        push_signal(
            &mut layers,
            suffixes,
            raw,
            ["", "_halfA", "_halfB", "_variance"].map(|part| format!("{name}{part}")),
        );
    }
    let mut texts = attributes.to_vec();
    match samples.samples_per_pixel() {
        SamplesPerPixel::Uniform(count) => texts.push(("samples".into(), count.to_string())),
        SamplesPerPixel::PerPixel(counts) => layers.push(layer("", &["samples"], counts)),
        SamplesPerPixel::Unknown => {}
    }
    write_layers(path, &layers, &texts)
}

/// Returns the usual names of channels: x, y, z for directions, z for a distance.
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

pub(crate) fn layer(name: &str, channels: &[&str], image: Image) -> NamedLayer {
    NamedLayer { name: name.to_owned(), channels: channels.iter().map(|&channel| channel.to_owned()).collect(), image }
}
