//! OpenEXR files as renderers, crops, broken disks and users leave them.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

mod along;
mod broken;
mod draft;
mod layouts;
mod names;
mod pictures;
mod quantities;
mod reading;
mod scopes;
mod seeds;
mod trouble;
mod writing;

use std::path::{Path, PathBuf};

use exr::prelude::*;
use stein::image::{Extent, Image as Planes};
use stein_exr::{BufferSet, BufferSetRequest, DenoisedLayers, Role, write_denoised};

const SIZE: (usize, usize) = (5, 3);
const PIXELS: usize = SIZE.0 * SIZE.1;

/// A part of a test file.
#[derive(Clone)]
struct Part {
    name: Option<&'static str>,
    position: (i32, i32),
    size: (usize, usize),
    channels: Vec<(String, FlatSamples)>,
    attributes: Vec<(&'static str, AttributeValue)>,
    compression: Compression,
}

impl Part {
    fn new() -> Self {
        Self {
            name: None,
            position: (0, 0),
            size: SIZE,
            channels: Vec::new(),
            attributes: Vec::new(),
            compression: Compression::ZIP16,
        }
    }

    fn named(name: &'static str) -> Self {
        Self { name: Some(name), ..Self::new() }
    }

    /// Adds channels `layer.suffix`, each a ramp; the first starts at `start`, the next 100 above it.
    fn with(mut self, layer: &str, suffixes: &str, start: f32) -> Self {
        let pixels = self.size.0 * self.size.1;
        for (index, suffix) in suffixes.chars().enumerate() {
            let name = if layer.is_empty() { suffix.to_string() } else { format!("{layer}.{suffix}") };
            self.channels.push((name, FlatSamples::F32(ramp(start + 100.0 * index as f32, pixels))));
        }
        self
    }

    fn attribute(mut self, name: &'static str, value: AttributeValue) -> Self {
        self.attributes.push((name, value));
        self
    }

    fn native() -> Self {
        Self::new()
            .with("", "RGB", 1.0)
            .with("halfA", "RGB", 2.0)
            .with("halfB", "RGB", 3.0)
            .with("variance", "RGB", 4.0)
            .with("normal", "XYZ", 5.0)
            .with("normal_halfA", "XYZ", 6.0)
            .with("normal_halfB", "XYZ", 7.0)
            .with("normal_variance", "XYZ", 8.0)
            .attribute("samples", AttributeValue::Text("32".into()))
    }
}

fn ramp(start: f32, pixels: usize) -> Vec<f32> {
    (0..pixels).map(|pixel| start + pixel as f32).collect()
}

fn image_of(parts: Vec<Part>, display: IntegerBounds) -> FlatImage {
    let layer_of = |part: Part| {
        let channels = part.channels.into_iter().map(|(name, samples)| AnyChannel::new(name.as_str(), samples));
        let mut attributes = LayerAttributes {
            layer_name: part.name.map(Text::from),
            layer_position: Vec2(part.position.0, part.position.1),
            ..LayerAttributes::default()
        };
        attributes.other.extend(part.attributes.into_iter().map(|(name, value)| (Text::from(name), value)));
        Layer {
            channel_data: AnyChannels::sort(channels.collect()),
            attributes,
            size: Vec2(part.size.0, part.size.1),
            encoding: Encoding {
                compression: part.compression,
                blocks: Blocks::ScanLines,
                line_order: LineOrder::Increasing,
            },
        }
    };
    FlatImage { attributes: ImageAttributes::new(display), layer_data: parts.into_iter().map(layer_of).collect() }
}

fn write(folder: &Path, name: &str, parts: Vec<Part>) -> PathBuf {
    let size = parts[0].size;
    let path = folder.join(name);
    let image = image_of(parts, IntegerBounds::from_dimensions(size));
    // Renderers write what the checks of the encoder refuse, such as two parts of one name.
    let bytes = std::fs::File::create(&path).unwrap();
    image.write().skip_compatibility_checks().to_buffered(std::io::BufWriter::new(bytes)).unwrap();
    path
}

fn folder() -> tempfile::TempDir {
    tempfile::tempdir().unwrap()
}

fn request(input: &Path) -> BufferSetRequest {
    BufferSetRequest { input: input.to_owned(), ..BufferSetRequest::default() }
}

fn read(input: &Path) -> BufferSet {
    BufferSet::read(&request(input)).unwrap()
}

fn failure(request: &BufferSetRequest) -> String {
    BufferSet::read(request).map(|_| ()).unwrap_err().to_string()
}

fn role(set: &BufferSet, layer: &str) -> Role {
    set.layer_uses().iter().find(|found| found.layer == layer).unwrap().role.clone()
}

fn note(set: &BufferSet, layer: &str) -> String {
    set.layer_uses().iter().find(|found| found.layer == layer).unwrap().note.clone().unwrap_or_default()
}

/// The planes of `Part::with(_, "RGB", start)`.
fn rgb(start: f32) -> Planes {
    let extent = Extent { width: SIZE.0 as u32, height: SIZE.1 as u32 };
    Planes { extent, planes: (0..3).map(|c| ramp(start + 100.0 * c as f32, PIXELS)).collect() }
}

fn single(start: f32) -> Planes {
    Planes { planes: vec![ramp(start, PIXELS)], ..rgb(0.0) }
}

fn replace_color(color: &Planes) -> DenoisedLayers<'_> {
    DenoisedLayers { color, replacements: &[], dropped: &[], extra: &[], attributes: &[] }
}

fn stored(path: &Path, channel: &str) -> FlatSamples {
    let image = read_all_flat_layers_from_file(path).unwrap();
    let mut channels = image.layer_data[0].channel_data.list.iter();
    channels.find(|found| found.name == *channel).unwrap().sample_data.clone()
}
