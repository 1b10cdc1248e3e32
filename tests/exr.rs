//! OpenEXR files as renderers, crops, broken disks and users leave them.

use std::path::{Path, PathBuf};

use exr::prelude::*;
use stein::buffers::{
    BufferSet, BufferSetRequest, DenoisedLayers, LayerRef, NamedLayer, Role, SampleKind,
    SignalPart, read_reference, write_denoised,
};
use stein::error::Error;
use stein::frame::{Frame, SamplesPerPixel};
use stein::image::{Extent, Image as Planes, Window};

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
        Self {
            name: Some(name),
            ..Self::new()
        }
    }

    /// Adds channels `layer.suffix`, each a ramp; the first starts at `start`, the next 100 above it.
    fn with(mut self, layer: &str, suffixes: &str, start: f32) -> Self {
        let pixels = self.size.0 * self.size.1;
        for (index, suffix) in suffixes.chars().enumerate() {
            let name = if layer.is_empty() {
                suffix.to_string()
            } else {
                format!("{layer}.{suffix}")
            };
            self.channels.push((
                name,
                FlatSamples::F32(ramp(start + 100.0 * index as f32, pixels)),
            ));
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
        let channels = part
            .channels
            .into_iter()
            .map(|(name, samples)| AnyChannel::new(name.as_str(), samples));
        let mut attributes = LayerAttributes {
            layer_name: part.name.map(Text::from),
            layer_position: Vec2(part.position.0, part.position.1),
            ..LayerAttributes::default()
        };
        attributes.other.extend(
            part.attributes
                .into_iter()
                .map(|(name, value)| (Text::from(name), value)),
        );
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
    FlatImage {
        attributes: ImageAttributes::new(display),
        layer_data: parts.into_iter().map(layer_of).collect(),
    }
}

fn write(folder: &Path, name: &str, parts: Vec<Part>) -> PathBuf {
    let size = parts[0].size;
    let path = folder.join(name);
    image_of(parts, IntegerBounds::from_dimensions(size))
        .write()
        .to_file(&path)
        .unwrap();
    path
}

fn folder() -> tempfile::TempDir {
    tempfile::tempdir().unwrap()
}

fn request(input: &Path) -> BufferSetRequest {
    BufferSetRequest {
        input: input.to_owned(),
        ..BufferSetRequest::default()
    }
}

fn read(input: &Path) -> BufferSet {
    BufferSet::read(&request(input)).unwrap()
}

fn failure(request: &BufferSetRequest) -> String {
    BufferSet::read(request)
        .map(|_| ())
        .unwrap_err()
        .to_string()
}

fn role(set: &BufferSet, layer: &str) -> Role {
    set.layer_uses()
        .iter()
        .find(|found| found.layer == layer)
        .unwrap()
        .role
        .clone()
}

fn note(set: &BufferSet, layer: &str) -> String {
    set.layer_uses()
        .iter()
        .find(|found| found.layer == layer)
        .unwrap()
        .note
        .clone()
        .unwrap_or_default()
}

/// What `Part::with(_, "RGB", start)` holds.
fn rgb(start: f32) -> Planes {
    let extent = Extent {
        width: SIZE.0 as u32,
        height: SIZE.1 as u32,
    };
    Planes {
        extent,
        planes: (0..3)
            .map(|c| ramp(start + 100.0 * c as f32, PIXELS))
            .collect(),
    }
}

fn single(start: f32) -> Planes {
    Planes {
        planes: vec![ramp(start, PIXELS)],
        ..rgb(0.0)
    }
}

fn replace_color(color: &Planes) -> DenoisedLayers<'_> {
    DenoisedLayers {
        color,
        replacements: &[],
        extra: &[],
        attributes: &[],
    }
}

fn stored(path: &Path, channel: &str) -> FlatSamples {
    let image = read_all_flat_layers_from_file(path).unwrap();
    let mut channels = image.layer_data[0].channel_data.list.iter();
    channels
        .find(|found| found.name == *channel)
        .unwrap()
        .sample_data
        .clone()
}

#[test]
fn the_native_layout_is_read_whole() {
    let folder = folder();
    let set = read(&write(folder.path(), "in.exr", vec![Part::native()]));
    let color = set.color();
    assert_eq!(color.mean, rgb(1.0));
    assert_eq!(color.half_a, Some(rgb(2.0)));
    assert_eq!(color.half_b, Some(rgb(3.0)));
    assert_eq!(color.variance_of_mean, Some(rgb(4.0)));
    let (name, normal) = set.features().next().unwrap();
    assert_eq!((name, &normal.mean), ("normal", &rgb(5.0)));
    assert_eq!(normal.variance_of_mean, Some(rgb(8.0)));
    assert_eq!(set.samples_per_pixel(), SamplesPerPixel::Uniform(32.0));
    assert_eq!(role(&set, "halfB"), Role::HalfB);
    assert_eq!(
        role(&set, "normal_halfA"),
        Role::Feature("normal".into(), SignalPart::HalfA)
    );
    assert_eq!(set.layer_uses()[0].sample_kind, SampleKind::Float);
}

#[test]
fn a_half_float_file_with_lower_case_shuffled_channels_reads_the_same() {
    let folder = folder();
    let mut part = Part::native();
    for (name, samples) in &mut part.channels {
        let FlatSamples::F32(values) = samples else {
            unreachable!()
        };
        *samples = FlatSamples::F16(values.iter().map(|&value| f16::from_f32(value)).collect());
        *name = match name.rsplit_once('.') {
            // Files are sorted by name, capitals first: G, b, r.
            Some((layer, suffix)) => {
                format!("{layer}.{}", suffix.replace('R', "r").replace('B', "b"))
            }
            None => name.to_lowercase(),
        };
    }
    let set = read(&write(folder.path(), "half.exr", vec![part]));
    assert_eq!(set.color().half_a, Some(rgb(2.0)));
    assert_eq!(set.color().mean, rgb(1.0));
    assert_eq!(set.color().variance_of_mean, Some(rgb(4.0)));
    assert_eq!(set.layer_uses()[0].sample_kind, SampleKind::Half);
}

#[test]
fn mixed_sample_types_are_read_and_kept() {
    let folder = folder();
    let mut part = Part::native();
    part.channels[0].1 = FlatSamples::F16(vec![f16::from_f32(0.5); PIXELS]);
    part.channels
        .push(("id".into(), FlatSamples::U32(vec![7; PIXELS])));
    let set = read(&write(folder.path(), "in.exr", vec![part]));
    assert_eq!(set.color().mean.planes[0], vec![0.5; PIXELS]);
    let main = set
        .layer_uses()
        .iter()
        .find(|found| found.layer.is_empty())
        .unwrap();
    assert_eq!(main.sample_kind, SampleKind::Mixed);
    let output = folder.path().join("out.exr");
    let mut color = rgb(10.0);
    color.planes[0][3] = 1e6;
    let report = write_denoised(&set, &output, &replace_color(&color)).unwrap();
    assert_eq!(report.clamped_values, 1);
    let FlatSamples::F16(red) = stored(&output, "R") else {
        panic!("red is not half")
    };
    assert_eq!((red[0].to_f32(), red[3].to_f32()), (10.0, 65504.0));
    assert_eq!(stored(&output, "G"), FlatSamples::F32(ramp(110.0, PIXELS)));
    assert_eq!(stored(&output, "id"), FlatSamples::U32(vec![7; PIXELS]));
}

#[test]
fn a_multi_part_file_reads_like_a_single_part_one_and_keeps_its_parts() {
    let folder = folder();
    let parts = vec![
        Part::named("beauty").with("", "RGBA", 1.0),
        Part::named("halfA").with("", "RGB", 2.0),
        Part::named("halfB").with("", "RGB", 3.0),
        Part::named("variance").with("", "RGB", 4.0),
        Part::named("albedo").with("", "RGB", 5.0),
        Part::named("albedo_variance").with("", "RGB", 6.0),
    ];
    let set = read(&write(folder.path(), "parts.exr", parts));
    assert_eq!(set.color_layer(), "beauty");
    assert_eq!(set.color().half_b, Some(rgb(3.0)));
    assert_eq!(set.color().variance_of_mean, Some(rgb(4.0)));
    assert_eq!(
        set.features().next().unwrap().1.variance_of_mean,
        Some(rgb(6.0))
    );
    let output = folder.path().join("out.exr");
    write_denoised(&set, &output, &replace_color(&rgb(50.0))).unwrap();
    let again = read(&output);
    assert_eq!(again.color().mean, rgb(50.0));
    assert_eq!(again.color().half_a, Some(rgb(2.0)));
    let mut expected = set.layer_uses().to_vec();
    expected
        .iter_mut()
        .for_each(|layer| layer.file.clone_from(&output));
    assert_eq!(again.layer_uses(), expected);
}

#[test]
fn cycles_layers_are_split_at_the_last_dot() {
    let folder = folder();
    let part = Part::new()
        .with("ViewLayer.Combined", "RGBA", 9.0)
        .with("ViewLayer.Noisy Image", "RGBA", 1.0)
        .with("ViewLayer.Denoising Albedo", "RGB", 2.0)
        .with("ViewLayer.Denoising Depth", "Z", 3.0)
        .with("ViewLayer.Debug Sample Count", "X", 4.0);
    let set = read(&write(folder.path(), "cycles.exr", vec![part]));
    assert_eq!(set.color().mean, rgb(1.0));
    assert_eq!(
        set.feature_names().collect::<Vec<_>>(),
        ["Denoising Albedo", "Denoising Depth"]
    );
    assert!(note(&set, "ViewLayer.Debug Sample Count").contains("fraction"));
}

#[test]
fn a_chosen_layer_does_not_take_the_beautys_halves() {
    let folder = folder();
    let part = Part::native().with("diffuse", "RGB", 20.0);
    let part = part
        .with("diffuse_halfA", "RGB", 21.0)
        .with("diffuse_halfB", "RGB", 22.0);
    let mut request = request(&write(folder.path(), "in.exr", vec![part]));
    request.layer = Some("diffuse".into());
    let set = BufferSet::read(&request).unwrap();
    assert_eq!(set.color().mean, rgb(20.0));
    assert_eq!(set.color().half_a, Some(rgb(21.0)));
    assert_eq!(set.color().variance_of_mean, None);
    request.layer = Some("specular".into());
    let message = failure(&request);
    assert!(
        message.contains("specular") && message.contains("'diffuse' (R G B)"),
        "{message}"
    );
}

#[test]
fn alpha_and_unknown_layers_pass_through_untouched() {
    let folder = folder();
    let part = Part::native()
        .with("", "A", 0.25)
        .with("matte", "RGB", 30.0);
    let part = part.attribute("camera", AttributeValue::FloatVec3((1.0, 2.0, 3.0)));
    let input = write(folder.path(), "in.exr", vec![part]);
    let set = read(&input);
    assert_eq!(role(&set, "matte"), Role::Untouched);
    let output = folder.path().join("out.exr");
    write_denoised(&set, &output, &replace_color(&rgb(50.0))).unwrap();
    let before = read_all_flat_layers_from_file(&input).unwrap();
    let mut after = read_all_flat_layers_from_file(&output).unwrap();
    let old_channels = &before.layer_data[0].channel_data.list;
    for (channel, old) in after.layer_data[0]
        .channel_data
        .list
        .iter_mut()
        .zip(old_channels)
    {
        let replaced = ["R", "G", "B"].iter().any(|name| channel.name == **name);
        assert_eq!(
            channel.sample_data != old.sample_data,
            replaced,
            "{}",
            channel.name
        );
        channel.sample_data = old.sample_data.clone();
    }
    assert_eq!(after, before, "header or layout changed");
}

#[test]
fn a_cropped_render_keeps_both_windows() {
    let folder = folder();
    let part = Part {
        position: (-3, 7),
        ..Part::native()
    };
    let path = folder.path().join("crop.exr");
    image_of(vec![part], IntegerBounds::new((0, 0), (64, 48)))
        .write()
        .to_file(&path)
        .unwrap();
    let set = read(&path);
    let data = Window {
        x: -3,
        y: 7,
        extent: Extent {
            width: 5,
            height: 3,
        },
    };
    let whole = Window {
        x: 0,
        y: 0,
        extent: Extent {
            width: 64,
            height: 48,
        },
    };
    assert_eq!((set.data_window(), set.display_window()), (data, whole));
    let output = folder.path().join("out.exr");
    write_denoised(&set, &output, &replace_color(&rgb(50.0))).unwrap();
    let again = read(&output);
    assert_eq!((again.data_window(), again.display_window()), (data, whole));
    assert_eq!(again.color().mean, rgb(50.0));
}

#[test]
fn halves_variance_and_features_come_from_separate_files() {
    let folder = folder();
    let one = |name: &str, part: Part| write(folder.path(), name, vec![part]);
    let input = one("color.exr", Part::new().with("", "RGB", 1.0));
    let half_a = one("a.exr", Part::new().with("", "RGB", 2.0));
    let seeds = vec![
        Part::named("seed1").with("", "RGB", 9.0),
        Part::named("seed2").with("", "RGB", 3.0),
    ];
    let half_b = write(folder.path(), "b.exr", seeds);
    let variance = one("variance.exr", Part::new().with("variance", "RGB", 4.0));
    let albedo = one(
        "albedo.exr",
        Part::new()
            .with("", "RGB", 5.0)
            .with("albedo_variance", "RGB", 6.0),
    );
    let depth = one(
        "depth.exr",
        Part::new().with("", "Y", 7.0).with("variance", "Y", 8.0),
    );
    let whole = |file: PathBuf| LayerRef { file, layer: None };
    let set = BufferSet::read(&BufferSetRequest {
        half_a: Some(whole(half_a)),
        half_b: Some(format!("{}::seed2", half_b.display()).parse().unwrap()),
        variance: Some(LayerRef {
            file: variance,
            layer: Some("variance".into()),
        }),
        features: vec![
            ("albedo".into(), whole(albedo)),
            ("depth".into(), whole(depth)),
        ],
        ..request(&input)
    })
    .unwrap();
    let color = set.color();
    assert_eq!(color.half_a, Some(rgb(2.0)));
    assert_eq!(color.half_b, Some(rgb(3.0)));
    assert_eq!(color.variance_of_mean, Some(rgb(4.0)));
    let features: Vec<_> = set.features().map(|(_, signal)| signal).collect();
    assert_eq!(features[0].mean, rgb(5.0));
    assert_eq!(features[0].variance_of_mean, Some(rgb(6.0)));
    assert_eq!(features[1].mean, single(7.0));
    assert_eq!(features[1].variance_of_mean, Some(single(8.0)));
}

#[test]
fn a_feature_of_another_size_names_its_file_and_both_windows() {
    let folder = folder();
    let input = write(folder.path(), "in.exr", vec![Part::native()]);
    let small = Part {
        size: (4, 3),
        ..Part::new()
    }
    .with("", "RGB", 1.0);
    let file = write(folder.path(), "small.exr", vec![small]);
    let features = vec![("albedo".to_owned(), LayerRef { file, layer: None })];
    let message = failure(&BufferSetRequest {
        features,
        ..request(&input)
    });
    for part in ["small.exr", "4×3", "5×3", "remedy"] {
        assert!(message.contains(part), "{message}");
    }
}

#[test]
fn one_half_alone_is_an_error() {
    let folder = folder();
    let part = Part::new().with("", "RGB", 1.0).with("halfB", "RGB", 2.0);
    let message = failure(&request(&write(folder.path(), "in.exr", vec![part])));
    assert!(
        message.contains("half A is missing") && message.contains("--half-a"),
        "{message}"
    );
}

#[test]
fn the_input_given_as_its_own_variance_asks_for_a_layer() {
    let folder = folder();
    let input = write(folder.path(), "in.exr", vec![Part::native()]);
    let variance = Some(LayerRef {
        file: input.clone(),
        layer: None,
    });
    let message = failure(&BufferSetRequest {
        variance,
        ..request(&input)
    });
    assert!(message.contains("FILE::LAYER"), "{message}");
}

#[test]
fn neither_halves_nor_variance_explains_the_ways_out() {
    let folder = folder();
    let set = read(&write(
        folder.path(),
        "in.exr",
        vec![Part::new().with("", "RGB", 1.0)],
    ));
    let message = Frame::from_buffer_set(&set)
        .map(|_| ())
        .unwrap_err()
        .to_string();
    for way in ["--half-a", "--variance", "seeds"] {
        assert!(message.contains(way), "{message}");
    }
}

#[test]
fn moments_and_heuristics_are_not_taken_for_variances() {
    let folder = folder();
    let part = Part::new()
        .with("", "RGB", 1.0)
        .with("m2_img", "RGB", 2.0)
        .with("m2_img.albedo", "RGB", 2.0)
        .with("noiseLevel", "RGB", 3.0)
        .with("Variance", "RGB", 4.0)
        .with("albedo", "RGB", 5.0);
    let set = read(&write(folder.path(), "in.exr", vec![part]));
    assert_eq!(set.color().variance_of_mean, None);
    assert_eq!(set.feature_names().collect::<Vec<_>>(), ["albedo"]);
    assert!(note(&set, "m2_img").contains("second moment"));
    assert!(note(&set, "noiseLevel").contains("heuristic"));
    assert!(note(&set, "Variance").contains("one sample"));
}

#[test]
fn more_than_eight_features_are_left_out_by_name() {
    let folder = folder();
    let mut part = Part::native();
    for index in 0..9 {
        part = part.with(&format!("aov{index}"), "RGB", 1.0).with(
            &format!("aov{index}_variance"),
            "RGB",
            1.0,
        );
    }
    let input = write(folder.path(), "in.exr", vec![part]);
    let set = read(&input);
    assert_eq!(set.features().len(), 8);
    assert!(
        note(&set, "aov8").contains("at most 8"),
        "{:?}",
        set.layer_uses()
    );
    let skip_features = vec!["aov0".to_owned(), "aov3".to_owned()];
    let set = BufferSet::read(&BufferSetRequest {
        skip_features,
        ..request(&input)
    })
    .unwrap();
    assert_eq!(
        set.feature_names()
            .filter(|name| *name == "normal" || *name == "aov8")
            .count(),
        2
    );
    assert!(note(&set, "aov3").contains("request"));
    let none = BufferSet::read(&BufferSetRequest {
        no_features: true,
        ..request(&input)
    })
    .unwrap();
    assert_eq!(none.features().len(), 0);
}

#[test]
fn samples_per_pixel_come_from_a_channel_or_any_kind_of_attribute() {
    let folder = folder();
    let colored = || Part::new().with("", "RGB", 1.0);
    for value in [
        AttributeValue::I32(16),
        AttributeValue::F32(16.0),
        AttributeValue::Text(" 16 ".into()),
    ] {
        let set = read(&write(
            folder.path(),
            "in.exr",
            vec![colored().attribute("samples", value)],
        ));
        assert_eq!(set.samples_per_pixel(), SamplesPerPixel::Uniform(16.0));
    }
    let mut part = colored().attribute("samples", AttributeValue::I32(16));
    part.channels.push((
        "samples".into(),
        FlatSamples::U32((1..=PIXELS as u32).collect()),
    ));
    let set = read(&write(folder.path(), "in.exr", vec![part]));
    assert_eq!(
        set.samples_per_pixel(),
        SamplesPerPixel::PerPixel(single(1.0))
    );
    assert_eq!(role(&set, "samples"), Role::Samples);
    let set = read(&write(folder.path(), "in.exr", vec![colored()]));
    assert_eq!(set.samples_per_pixel(), SamplesPerPixel::Unknown);
}

#[test]
fn a_luminance_only_image_is_three_equal_planes_and_stays_one_channel() {
    let folder = folder();
    let part = Part::new().with("", "Y", 1.0).with("variance", "Y", 2.0);
    let set = read(&write(folder.path(), "y.exr", vec![part]));
    assert_eq!(set.color().mean.planes, vec![ramp(1.0, PIXELS); 3]);
    assert_eq!(
        set.color().variance_of_mean.unwrap().planes,
        vec![ramp(2.0, PIXELS); 3]
    );
    let output = folder.path().join("out.exr");
    write_denoised(&set, &output, &replace_color(&rgb(0.0))).unwrap();
    // The mean of ramps from 0, 100 and 200.
    let FlatSamples::F32(written) = stored(&output, "Y") else {
        panic!("not a float")
    };
    assert!(
        written
            .iter()
            .zip(ramp(100.0, PIXELS))
            .all(|(a, b)| (a - b).abs() < 1e-3),
        "{written:?}"
    );
}

#[test]
fn every_writable_compression_is_kept() {
    let folder = folder();
    use Compression::*;
    for compression in [
        Uncompressed,
        RLE,
        ZIP1,
        ZIP16,
        PIZ,
        PXR24,
        B44,
        B44A,
        DWAA(None),
        DWAB(Some(30.0)),
    ] {
        let set = read(&write(
            folder.path(),
            "in.exr",
            vec![Part {
                compression,
                ..Part::native()
            }],
        ));
        let output = folder.path().join("out.exr");
        write_denoised(&set, &output, &replace_color(&rgb(50.0))).unwrap();
        let written = read_all_flat_layers_from_file(&output).unwrap();
        assert_eq!(written.layer_data[0].encoding.compression, compression);
        let again = read(&output).color().mean;
        let close = |(a, b): (&f32, &f32)| (a - b).abs() <= 0.02 * b.abs();
        assert!(
            again
                .planes
                .iter()
                .flatten()
                .zip(rgb(50.0).planes.iter().flatten())
                .all(close),
            "{compression}"
        );
    }
}

#[test]
fn tiles_are_read_and_kept() {
    let folder = folder();
    let mut image = image_of(vec![Part::native()], IntegerBounds::from_dimensions(SIZE));
    image.layer_data[0].encoding.blocks = Blocks::Tiles(Vec2(2, 2));
    let path = folder.path().join("tiles.exr");
    image.write().to_file(&path).unwrap();
    let set = read(&path);
    assert_eq!(set.color().half_a, Some(rgb(2.0)));
    let output = folder.path().join("out.exr");
    write_denoised(&set, &output, &replace_color(&rgb(50.0))).unwrap();
    let written = read_all_flat_layers_from_file(&output).unwrap();
    assert_eq!(
        written.layer_data[0].encoding.blocks,
        Blocks::Tiles(Vec2(2, 2))
    );
}

#[test]
fn results_replace_stale_halves_and_extra_layers_are_added() {
    let folder = folder();
    let set = read(&write(
        folder.path(),
        "in.exr",
        vec![Part::native().with("halfA", "A", 0.5)],
    ));
    let color = rgb(50.0);
    let extra = [NamedLayer {
        name: "error".into(),
        channels: vec!["V".into()],
        image: single(0.5),
    }];
    let replacements = [
        ("halfA".to_owned(), rgb(60.0)),
        ("variance".to_owned(), rgb(70.0)),
    ];
    let attributes = [("denoiser".to_owned(), "stein".to_owned())];
    let output = folder.path().join("out.exr");
    let layers = DenoisedLayers {
        color: &color,
        replacements: &replacements,
        extra: &extra,
        attributes: &attributes,
    };
    let report = write_denoised(&set, &output, &layers).unwrap();
    assert_eq!(report, Default::default());
    let again = read(&output).color();
    assert_eq!(again.half_a, Some(rgb(60.0)));
    assert_eq!(again.half_b, Some(rgb(3.0)));
    assert_eq!(again.variance_of_mean, Some(rgb(70.0)));
    assert_eq!(
        stored(&output, "halfA.A"),
        FlatSamples::F32(ramp(0.5, PIXELS))
    );
    assert_eq!(
        stored(&output, "error.V"),
        FlatSamples::F32(ramp(0.5, PIXELS))
    );
    let written = read_all_flat_layers_from_file(&output).unwrap();
    let attribute = &written.layer_data[0].attributes.other[&Text::from("denoiser")];
    assert_eq!(*attribute, AttributeValue::Text("stein".into()));
}

#[test]
fn a_failed_write_leaves_nothing_behind_and_the_old_file_alone() {
    let folder = folder();
    let input = write(folder.path(), "in.exr", vec![Part::native()]);
    let set = read(&input);
    let before = std::fs::read(&input).unwrap();
    let color = rgb(50.0);
    let wrong = Planes::filled(
        Extent {
            width: 2,
            height: 2,
        },
        3,
        0.0,
    );
    assert!(write_denoised(&set, &input, &replace_color(&wrong)).is_err());
    let extra = [NamedLayer {
        name: "normal".into(),
        channels: vec!["X".into()],
        image: single(0.0),
    }];
    let clash = DenoisedLayers {
        extra: &extra,
        ..replace_color(&color)
    };
    let message = write_denoised(&set, &input, &clash)
        .unwrap_err()
        .to_string();
    assert!(message.contains("normal.X"), "{message}");
    let replacements = [("nowhere".to_owned(), rgb(0.0))];
    let lost = DenoisedLayers {
        replacements: &replacements,
        ..replace_color(&color)
    };
    assert!(
        write_denoised(&set, &input, &lost)
            .unwrap_err()
            .to_string()
            .contains("nowhere")
    );
    let missing = folder.path().join("no such folder").join("out.exr");
    assert!(matches!(
        write_denoised(&set, &missing, &replace_color(&color)),
        Err(Error::File { .. })
    ));
    // The target is a folder, so that only the last step, the renaming, fails.
    let occupied = folder.path().join("occupied");
    std::fs::create_dir_all(occupied.join("inside")).unwrap();
    assert!(write_denoised(&set, &occupied, &replace_color(&color)).is_err());
    assert_eq!(std::fs::read(&input).unwrap(), before);
    assert_eq!(
        std::fs::read_dir(folder.path()).unwrap().count(),
        2,
        "a temporary file was left"
    );
}

#[test]
fn the_input_can_be_overwritten() {
    let folder = folder();
    let input = write(folder.path(), "in.exr", vec![Part::native()]);
    write_denoised(&read(&input), &input, &replace_color(&rgb(50.0))).unwrap();
    assert_eq!(read(&input).color().mean, rgb(50.0));
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        let plain = folder.path().join("plain");
        std::fs::write(&plain, "").unwrap();
        let mode = |path: &Path| std::fs::metadata(path).unwrap().permissions().mode();
        assert_eq!(
            mode(&input),
            mode(&plain),
            "an output is as readable as any other file"
        );
    }
}

#[test]
fn a_truncated_file_names_itself() {
    let folder = folder();
    let input = write(folder.path(), "in.exr", vec![Part::native()]);
    let whole = std::fs::read(&input).unwrap();
    for length in (1..whole.len()).step_by(37).chain([whole.len() - 1]) {
        std::fs::write(&input, &whole[..length]).unwrap();
        let message = failure(&request(&input));
        assert!(
            message.contains("in.exr") && message.contains("remedy"),
            "at {length}: {message}"
        );
    }
}

#[test]
fn flipped_bytes_never_panic() {
    let folder = folder();
    for compression in [
        Compression::ZIP16,
        Compression::PIZ,
        Compression::Uncompressed,
        Compression::DWAA(None),
    ] {
        let input = write(
            folder.path(),
            "in.exr",
            vec![Part {
                compression,
                ..Part::native()
            }],
        );
        let whole = std::fs::read(&input).unwrap();
        for at in (4..whole.len()).step_by(11) {
            for value in [0, 0x7f, 0xff] {
                let mut bytes = whole.clone();
                bytes[at] = value;
                std::fs::write(&input, &bytes).unwrap();
                // Many of these are still readable; the rest must say which file it is.
                if let Err(error) = BufferSet::read(&request(&input)) {
                    assert!(error.to_string().contains("in.exr"), "{error}");
                }
            }
        }
    }
}

#[test]
fn empty_missing_and_foreign_files_name_themselves() {
    let folder = folder();
    let path = folder.path().join("x.exr");
    assert!(failure(&request(&path)).contains("x.exr"));
    std::fs::write(&path, "").unwrap();
    assert!(failure(&request(&path)).contains("is empty"));
    std::fs::write(&path, "\u{89}PNG and so on").unwrap();
    assert!(failure(&request(&path)).contains("not an OpenEXR file"));
    assert!(failure(&request(folder.path())).contains("cannot be read"));
}

#[test]
fn unreadable_kinds_of_exr_are_named_with_a_way_out() {
    let folder = folder();
    let input = write(folder.path(), "in.exr", vec![Part::native()]);
    let whole = std::fs::read(&input).unwrap();
    let behind = |marker: &[u8]| {
        whole
            .windows(marker.len())
            .position(|window| window == marker)
            .unwrap()
            + marker.len()
    };
    let spoilt = |changes: &[(usize, u8)]| {
        let mut bytes = whole.clone();
        changes.iter().for_each(|(at, value)| bytes[*at] = *value);
        std::fs::write(&input, &bytes).unwrap();
        failure(&request(&input))
    };
    let compression = behind(b"compression\0compression\0\x01\0\0\0");
    for (number, name) in [(10, "HTJ2K"), (11, "HTJ2K"), (12, "ZSTD"), (99, "99")] {
        let message = spoilt(&[(compression, number)]);
        assert!(
            message.contains(name) && message.contains("ZIP"),
            "{message}"
        );
    }
    assert!(spoilt(&[(5, whole[5] | 0x08)]).contains("deep data"));
    // Behind a channel's name stand its type, its linearity, and the sampling in x and y.
    let sampling = behind(b"\0R\0\x02\0\0\0") + 4;
    let message = spoilt(&[(sampling, 5), (sampling + 4, 3)]);
    assert!(message.contains("subsampled"), "{message}");
}

#[test]
fn a_reference_is_read_without_anything_else() {
    let folder = folder();
    let part = Part::new().with("", "RGBA", 1.0).with("beauty", "RGB", 5.0);
    let path = write(folder.path(), "ref.exr", vec![part]);
    assert_eq!(read_reference(&path, None).unwrap(), rgb(1.0));
    assert_eq!(read_reference(&path, Some("beauty")).unwrap(), rgb(5.0));
    assert!(read_reference(&path, Some("other")).is_err());
}

#[test]
fn a_layer_reference_is_split_at_its_last_double_colon() {
    let parse = |text: &str| text.parse::<LayerRef>().unwrap();
    assert_eq!(
        parse("a.exr"),
        LayerRef {
            file: "a.exr".into(),
            layer: None
        }
    );
    assert_eq!(
        parse("a::b.exr::v.N"),
        LayerRef {
            file: "a::b.exr".into(),
            layer: Some("v.N".into())
        }
    );
    assert_eq!(
        parse("::x"),
        LayerRef {
            file: "::x".into(),
            layer: None
        }
    );
}

#[test]
fn the_test_renders_are_native_layout() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("testdata");
    let renders = [
        ("cornell_8spp", 8.0),
        ("cornell_32spp", 32.0),
        ("dof_spheres_32spp", 32.0),
        ("caustic_ring_32spp", 32.0),
    ];
    for (name, samples) in renders {
        let set = read(&folder.join(format!("{name}.exr")));
        assert_eq!(
            set.feature_names().collect::<Vec<_>>(),
            ["albedo", "depth", "normal", "visibility"],
            "{name}"
        );
        assert!(
            set.features()
                .all(|(_, signal)| signal.half_a.is_some() && signal.variance_of_mean.is_some())
        );
        assert_eq!(set.samples_per_pixel(), SamplesPerPixel::Uniform(samples));
        assert_eq!(
            set.extent(),
            Extent {
                width: 96,
                height: 96
            }
        );
    }
}
