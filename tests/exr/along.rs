//! Layers that are denoised along with the colour: lights and alpha.

use std::sync::LazyLock;

use stein::frame::PayloadKind;
use stein::gpu::DeviceChoice;
use stein::{DenoisedLayer, Denoiser, Estimate, Frame, Gpu, Method, NlmParams, PayloadLeft};
use stein_exr::{AlphaEncoding, Aovs, LayerRef, Written, write_estimate};

use super::*;

/// An estimate of another frame, whose images each test replaces.
static TEMPLATE: LazyLock<Estimate> = LazyLock::new(|| {
    let gpu = Gpu::open(&DeviceChoice::Auto).unwrap();
    let folder = folder();
    let frame = read(&write(folder.path(), "in.exr", vec![Part::native()])).to_frame().unwrap().0;
    let method = Method::Nlm(NlmParams { window_radius: 1, ..NlmParams::default() });
    Denoiser::new(&gpu, method).unwrap().denoise(&frame).unwrap()
});

/// Returns an estimate with the frame's own colour. `change` denoises the values of the layers.
fn estimate(frame: &Frame, change: impl Fn(&str, f32) -> f32) -> Estimate {
    let layer = |layer: &stein::frame::PayloadLayer| {
        let mut image = layer.mean.clone();
        image.planes.iter_mut().flatten().for_each(|value| *value = change(&layer.name, *value));
        DenoisedLayer { name: layer.name.clone(), image, left: None }
    };
    Estimate {
        color: frame.color().mean.clone(),
        half_spread: frame.color().half_spread.clone(),
        error: None,
        payload: frame.payload().iter().map(layer).collect(),
        layers: Vec::new(),
        ..TEMPLATE.clone()
    }
}

/// Denoises the layers beside the colour by `change`, and writes `out.exr` beside the input.
fn denoised(request: &BufferSetRequest, change: impl Fn(&str, f32) -> f32) -> (PathBuf, Written) {
    let mut set = BufferSet::read(request).unwrap();
    let (frame, _) = set.take_frame().unwrap();
    let output = request.input.with_file_name("out.exr");
    let written = write_estimate(&estimate(&frame, change), set, &output, &[], &Method::default()).unwrap();
    (output, written)
}

fn along(request: &BufferSetRequest) -> Vec<String> {
    BufferSet::read(request).unwrap().payload(0).map(|(name, _)| name.to_owned()).collect()
}

fn plane(values: impl Fn(usize) -> f32) -> FlatSamples {
    FlatSamples::F32((0..PIXELS).map(values).collect())
}

impl Part {
    fn and(mut self, name: &str, samples: FlatSamples) -> Self {
        self.channels.push((name.to_owned(), samples));
        self
    }
}

/// A layer of each kind: lights with and without alpha, an unknown colour, motion, numbers, a texture.
fn render() -> Part {
    Part::new()
        .with("", "RGBA", 1.0)
        .with("diffuse", "RGB", 10.0)
        .with("specular", "RGBA", 20.0)
        .with("wet", "RGB", 30.0)
        .with("mask", "Y", 35.0)
        .with("motionvector", "RGB", 40.0)
        .with("albedo", "RGB", 50.0)
        .with("CryptoObject00", "RGBA", 60.0)
        .with("beauty_denoised", "RGB", 70.0)
        .with("uv", "XY", 80.0)
        .and("whole.Y", FlatSamples::U32(vec![3; PIXELS]))
}

#[test]
fn the_request_says_which_layers_are_denoised_along() {
    let folder = folder();
    let input = write(folder.path(), "in.exr", vec![render()]);
    let aovs = |text: &str| BufferSetRequest { aovs: text.parse().unwrap(), ..request(&input) };
    let lights = ["diffuse", "specular", "specular.A", "A"];
    assert_eq!(along(&request(&input)), lights);
    assert_eq!(along(&aovs("lights")), lights);
    assert_eq!(along(&aovs("none")), ["A"]);
    assert_eq!(along(&aovs("all")), ["diffuse", "mask", "specular", "specular.A", "wet", "A"]);
    assert_eq!(along(&aovs("wet,spec*")), ["specular", "specular.A", "wet", "A"]);
    assert_eq!(along(&BufferSetRequest { no_alpha: true, ..aovs("specular") }), ["specular"]);
    let set = BufferSet::read(&aovs("wet")).unwrap();
    assert!(set.layer_uses().iter().any(|layer| layer.layer == "wet" && layer.is_along && layer.role == Role::Light));
    assert!(set.layer_uses().iter().all(|layer| layer.layer != "diffuse" || !layer.is_along));
}

#[test]
fn layers_that_are_not_there_or_hold_numbers_are_refused_with_the_way_out() {
    let folder = folder();
    let input = write(folder.path(), "in.exr", vec![render()]);
    let refused = |text: &str, words: &[&str]| {
        let message = failure(&BufferSetRequest { aovs: text.parse().unwrap(), ..request(&input) });
        for word in words {
            assert!(message.contains(word), "{word}: {message}");
        }
    };
    refused("difuse", &["in.exr", "'difuse'", "diffuse"]);
    refused("diffuse,CryptoObject00", &["in.exr", "CryptoObject00", "numbers of objects"]);
    refused("whole", &["whole numbers"]);
    refused("albedo", &["guides the filter"]);
    refused("uv", &["no channels R, G and B"]);
    // A pattern may fit such layers, too.
    assert_eq!(along(&BufferSetRequest { aovs: "*e*".parse().unwrap(), ..request(&input) }).len(), 6);
}

#[test]
fn denoised_layers_replace_those_of_the_input_in_their_own_type() {
    let folder = folder();
    let mut part = render();
    part.channels.iter_mut().filter(|(name, _)| name.starts_with("diffuse")).for_each(|(_, samples)| {
        let FlatSamples::F32(values) = &*samples else { return };
        *samples = FlatSamples::F16(values.iter().map(|value| f16::from_f32(*value)).collect());
    });
    let input = write(folder.path(), "in.exr", vec![part]);
    let (output, written) = denoised(&request(&input), |name, value| if name == "A" { 0.25 } else { value + 1.0 });
    assert_eq!(written.along, ["diffuse", "specular", "specular.A", "A"]);
    let expected = FlatSamples::F16(ramp(111.0, PIXELS).into_iter().map(f16::from_f32).collect());
    assert_eq!(stored(&output, "diffuse.G"), expected);
    assert_eq!(stored(&output, "specular.B"), FlatSamples::F32(ramp(221.0, PIXELS)));
    // Alphas lie within 0 to 1.
    assert_eq!(stored(&output, "specular.A"), plane(|_| 1.0));
    assert_eq!(stored(&output, "A"), plane(|_| 0.25));
    for channel in ["wet.R", "albedo.R", "CryptoObject00.R", "CryptoObject00.A", "uv.X", "whole.Y", "R"] {
        assert_eq!(stored(&output, channel), stored(&input, channel), "{channel}");
    }
}

#[test]
fn layers_that_no_filter_changed_stay_to_the_bit() {
    let folder = folder();
    let mut part = render();
    let damaged = |pixel: usize| if pixel == 3 { f32::NAN } else { 0.1 + pixel as f32 };
    part.channels.retain(|(name, _)| name != "A" && name != "diffuse.R");
    let part = part.and("A", plane(|pixel| pixel as f32 * 0.3 - 1.0)).and("diffuse.R", plane(damaged));
    let input = write(folder.path(), "in.exr", vec![part]);
    let mut set = read(&input);
    let (frame, _) = set.take_frame().unwrap();
    let mut estimate = estimate(&frame, |_, value| value);
    for (index, layer) in estimate.payload.iter_mut().enumerate() {
        layer.left = Some(if index == 0 { PayloadLeft::LackedBeside } else { PayloadLeft::NoNoise });
    }
    let output = folder.path().join("out.exr");
    let written = write_estimate(&estimate, set, &output, &[], &Method::default()).unwrap();
    assert_eq!(written.along, Vec::<String>::new());
    assert_eq!(written.notes.iter().filter(|note| note.contains("a frame beside lacks them: diffuse")).count(), 1);
    let bits = |path: &Path, channel: &str| match stored(path, channel) {
        FlatSamples::F32(values) => values.into_iter().map(f32::to_bits).collect::<Vec<_>>(),
        other => panic!("{other:?}"),
    };
    for channel in ["A", "diffuse.R", "diffuse.G", "specular.A", "specular.R"] {
        assert_eq!(bits(&output, channel), bits(&input, channel), "{channel}");
    }
}

#[test]
fn without_alpha_its_bits_stay() {
    let folder = folder();
    let input = write(folder.path(), "in.exr", vec![render()]);
    for encoding in [AlphaEncoding::Premultiplied, AlphaEncoding::Straight] {
        let request = BufferSetRequest { no_alpha: true, alpha: Some(encoding), ..request(&input) };
        let (output, written) = denoised(&request, |_, value| value);
        assert_eq!(written.along, ["diffuse", "specular"]);
        for channel in ["A", "specular.A", "specular.R", "R"] {
            assert_eq!(stored(&output, channel), stored(&input, channel), "{encoding:?} {channel}");
        }
    }
}

#[test]
fn a_layer_without_a_usable_value_is_left_as_it_was_and_said() {
    let folder = folder();
    let mut part = render();
    for (_, samples) in part.channels.iter_mut().filter(|(name, _)| name.starts_with("diffuse")) {
        *samples = plane(|_| f32::NAN);
    }
    let input = write(folder.path(), "in.exr", vec![part]);
    let mut set = read(&input);
    let (frame, repairs) = set.take_frame().unwrap();
    let is_said = |note: &String| note.contains("diffuse") && note.contains("not one pixel has a usable value");
    assert!(repairs.notes.iter().any(is_said), "{:?}", repairs.notes);
    let output = folder.path().join("out.exr");
    write_estimate(&estimate(&frame, |_, value| value), set, &output, &[], &Method::default()).unwrap();
    let FlatSamples::F32(values) = stored(&output, "diffuse.R") else { panic!("another type") };
    assert!(values.iter().all(|value| value.is_nan()));
}

/// Straight colours: alpha is 0 in pixel 2, with garbage in the colours, and otherwise a half.
fn straight(seed: f32) -> Part {
    let alpha = |pixel: usize| if pixel == 2 { 0.0 } else { 0.5 };
    let colour = move |pixel: usize| match pixel {
        2 => f32::NAN,
        _ => seed + pixel as f32,
    };
    let rgb = |part: Part, layer: &str| {
        ["R", "G", "B"].into_iter().fold(part, |part, channel| part.and(&format!("{layer}{channel}"), plane(colour)))
    };
    let part = rgb(rgb(rgb(Part::new(), ""), "diffuse."), "variance.");
    part.and("A", plane(alpha)).with("normal", "XYZ", 5.0).attribute("samples", AttributeValue::I32(8))
}

#[test]
fn straight_colours_are_multiplied_by_alpha_inside_and_divided_in_the_output() {
    let folder = folder();
    let input = write(folder.path(), "in.exr", vec![straight(1.0)]);
    let request = BufferSetRequest { alpha: Some(AlphaEncoding::Straight), ..request(&input) };
    let set = BufferSet::read(&request).unwrap();
    let color = set.color();
    assert_eq!(color.mean.planes[0][..4], [0.5, 1.0, 0.0, 2.0]);
    assert_eq!(color.variance_of_mean.unwrap().planes[0][..4], [0.25, 0.5, 0.0, 1.0]);
    let (frame, repairs) = set.to_frame().unwrap();
    assert!(repairs.layers.is_empty(), "{repairs}");
    assert_eq!(frame.payload()[0].mean.planes[0][..4], [0.5, 1.0, 0.0, 2.0]);
    assert_eq!(set.read_reference(0, &LayerRef::whole(&input)).unwrap(), color.mean);

    // The denoised alpha, a quarter, divides.
    let change = |name: &str, value: f32| if name == "A" { value / 2.0 } else { value };
    let (output, written) = denoised(&request, change);
    assert_eq!(written.along, ["diffuse", "A"]);
    for channel in ["R", "diffuse.B"] {
        let doubled = |pixel: usize| if pixel == 2 { 0.0 } else { 2.0 * (1.0 + pixel as f32) };
        assert_eq!(stored(&output, channel), plane(doubled), "{channel}");
    }
    assert_eq!(stored(&output, "A"), plane(|pixel| if pixel == 2 { 0.0 } else { 0.25 }));
}

#[test]
fn straight_seeds_are_multiplied_by_their_own_alphas_before_they_are_merged() {
    let folder = folder();
    let other = straight(3.0);
    let opaque =
        |(name, samples): (String, FlatSamples)| if name == "A" { (name, plane(|_| 1.0)) } else { (name, samples) };
    let mut other = Part { channels: other.channels.into_iter().map(opaque).collect(), ..other };
    for (_, samples) in &mut other.channels {
        if let FlatSamples::F32(values) = samples {
            values.iter_mut().filter(|value| value.is_nan()).for_each(|value| *value = 7.0);
        }
    }
    let (first, second) =
        (write(folder.path(), "1.exr", vec![straight(1.0)]), write(folder.path(), "2.exr", vec![other]));
    let request = BufferSetRequest {
        alpha: Some(AlphaEncoding::Straight),
        seeds: vec![second],
        payload_halves: true,
        ..request(&first)
    };
    let set = BufferSet::read(&request).unwrap();
    let color = set.color();
    // (1·0.5 + 3·1)/2, and the garbage of the first seed counts as 0.
    assert_eq!((color.mean.planes[0][0], color.mean.planes[0][2]), (1.75, 3.5));
    assert_eq!((color.half_a.unwrap().planes[0][0], color.half_b.unwrap().planes[0][0]), (0.5, 3.0));
    // (0.25·1 + 1·3)/4.
    assert_eq!(color.variance_of_mean.unwrap().planes[0][0], 3.25 / 4.0);
    let (frame, _) = set.to_frame().unwrap();
    let light = &frame.payload()[0];
    assert_eq!((light.mean.planes[0][0], light.half_spread.as_ref().unwrap().planes[0][0]), (1.75, -1.25));
    let alpha = &frame.payload()[1];
    assert_eq!((alpha.kind, alpha.mean.planes[0][0]), (PayloadKind::Alpha, 0.75));

    // Layers that no filter changed are divided again, too.
    let mut taken = BufferSet::read(&request).unwrap();
    let (frame, _) = taken.take_frame().unwrap();
    let mut estimate = estimate(&frame, |_, value| value);
    estimate.payload.iter_mut().for_each(|layer| layer.left = Some(PayloadLeft::NoNoise));
    let output = folder.path().join("out.exr");
    write_estimate(&estimate, taken, &output, &[], &Method::default()).unwrap();
    for channel in ["R", "diffuse.R"] {
        let FlatSamples::F32(values) = stored(&output, channel) else { panic!("another type") };
        assert!((values[0] - 1.75 / 0.75).abs() < 1e-6, "{channel}: {}", values[0]);
    }
    assert_eq!(stored(&output, "A"), plane(|pixel| if pixel == 2 { 0.5 } else { 0.75 }));
}

#[test]
fn pixels_without_hits_are_misses_of_the_features_and_stay_black() {
    let folder = folder();
    let empty = |pixel: usize| pixel == 4;
    let value = move |pixel: usize| if empty(pixel) { 0.0 } else { 1.0 + pixel as f32 };
    let part = ["R", "G", "B", "halfA.R", "halfA.G", "halfA.B", "halfB.R", "halfB.G", "halfB.B"]
        .into_iter()
        .fold(Part::new(), |part, name| part.and(name, plane(value)));
    let part = part
        .and("A", plane(move |pixel| f32::from(!empty(pixel))))
        .with("depth", "Z", 3.0)
        .with("albedo", "RGB", 0.5)
        .with("diffuse", "RGB", 1.0);
    let input = write(folder.path(), "in.exr", vec![part]);
    let (frame, _) = read(&input).to_frame().unwrap();
    let feature = |frame: &Frame, name: &str| frame.features().iter().find(|it| it.name == name).unwrap().clone();
    assert_eq!(feature(&frame, "depth").misses.iter().position(|miss| *miss), Some(4));
    let (kept, _) =
        BufferSet::read(&BufferSetRequest { no_alpha: true, ..request(&input) }).unwrap().to_frame().unwrap();
    assert!(feature(&kept, "depth").misses.is_empty());

    let mut set = read(&input);
    let (frame, _) = set.take_frame().unwrap();
    let mut estimate = estimate(&frame, |name, value| if name == "A" { value } else { 0.5 });
    estimate.color.planes.iter_mut().for_each(|plane| plane[4] = 0.125);
    let output = folder.path().join("out.exr");
    write_estimate(&estimate, set, &output, &[], &Method::default()).unwrap();
    let at = |channel: &str, pixel: usize| stored(&output, channel).values_as_f32().nth(pixel).unwrap();
    for channel in ["R", "halfA.G", "diffuse.B"] {
        assert_eq!(at(channel, 4), 0.0, "{channel}");
        assert!(at(channel, 5) != 0.0, "{channel}");
    }
}

#[test]
fn a_seed_without_alpha_gives_its_colours() {
    let folder = folder();
    let with = Part::new().with("", "RGBA", 1.0).with("light_key", "RGB", 1.0);
    let without = Part::new().with("", "RGB", 3.0).with("light_key", "RGB", 3.0);
    let (with, without) = (write(folder.path(), "1.exr", vec![with]), write(folder.path(), "2.exr", vec![without]));
    for (first, second) in [(&with, &without), (&without, &with)] {
        let set = BufferSet::read(&BufferSetRequest { seeds: vec![second.clone()], ..request(first) }).unwrap();
        let (frame, _) = set.to_frame().unwrap();
        let light = frame.payload().iter().find(|layer| layer.name == "light_key").unwrap();
        assert_eq!(frame.color().mean, light.mean, "the lights add up");
        let half = |of: &Path| read(of).color().mean.planes[1][2];
        assert_eq!(light.mean.planes[1][2], (half(&with) + half(&without)) / 2.0);
    }
}

#[test]
fn alpha_that_is_not_finite_is_repaired_and_counted() {
    let folder = folder();
    for (value, encoding) in [
        (f32::NEG_INFINITY, AlphaEncoding::Straight),
        (f32::INFINITY, AlphaEncoding::Premultiplied),
        (f32::NAN, AlphaEncoding::Straight),
    ] {
        let alpha = plane(move |pixel| if pixel == 1 { value } else { 0.5 + 0.01 * pixel as f32 });
        let part = Part::new().with("", "RGB", 1.0).and("A", alpha);
        let input = write(folder.path(), "in.exr", vec![part]);
        let set = BufferSet::read(&BufferSetRequest { alpha: Some(encoding), ..request(&input) }).unwrap();
        let (frame, repairs) = set.to_frame().unwrap();
        let of_alpha = repairs.layer("A").unwrap_or_else(|| panic!("{value}: {repairs}"));
        assert_eq!(of_alpha.nan_values + of_alpha.infinite_values, 1, "{value}");
        let alpha = frame.payload()[0].mean.planes[0][1];
        assert!((0.5..0.7).contains(&alpha), "{value}: alpha {alpha}");
        assert!(frame.color().mean.planes[0][1] > 0.1, "{value}: {}", frame.color().mean.planes[0][1]);
    }
}

#[test]
fn a_straight_picture_without_any_opacity_is_said_to_be_black() {
    let folder = folder();
    let part = Part::new().with("", "RGB", 1.0).and("A", plane(|_| 0.0));
    let input = write(folder.path(), "in.exr", vec![part]);
    let straight = BufferSetRequest { alpha: Some(AlphaEncoding::Straight), ..request(&input) };
    let notes = |request: &BufferSetRequest| BufferSet::read(request).unwrap().to_frame().unwrap().1.to_string();
    assert!(notes(&straight).contains("alpha is 0 everywhere"), "{}", notes(&straight));
    assert!(!notes(&request(&input)).contains("alpha is 0 everywhere"));
}

#[test]
fn alpha_guides_the_filter_if_its_noise_is_known() {
    let folder = folder();
    let alpha = |seed: f32| plane(move |pixel| (seed + pixel as f32) / PIXELS as f32);
    let part = |seed: f32| Part::new().with("", "RGB", 1.0 + seed).and("A", alpha(seed)).with("albedo", "RGB", 0.1);
    let counted = part(0.25).attribute("samples", AttributeValue::I32(8));
    let inputs = [("1.exr", part(0.0)), ("2.exr", part(0.5)), ("n.exr", counted)]
        .map(|(name, part)| write(folder.path(), name, vec![part]));
    let [first, second, counted] = &inputs;
    let guide = |request: BufferSetRequest| {
        let (frame, _) = BufferSet::read(&request).unwrap().to_frame().unwrap();
        frame.features().iter().find(|feature| feature.name == "alpha").cloned()
    };
    // Nothing tells the noise of a single alpha.
    assert!(guide(request(first)).is_none());
    let of_seeds = BufferSetRequest { seeds: vec![second.clone()], ..request(first) };
    let found = guide(of_seeds.clone()).unwrap();
    assert!(found.signal.half_spread.is_some() && found.signal.mean.channels() == 1);
    let found = guide(request(counted)).unwrap();
    assert!(found.signal.half_spread.is_none() && found.signal.variance_of_mean.is_some());
    for without in [
        BufferSetRequest { no_alpha: true, ..of_seeds.clone() },
        BufferSetRequest { no_features: true, ..of_seeds.clone() },
        BufferSetRequest { skip_features: vec!["alpha".into()], ..of_seeds.clone() },
    ] {
        assert!(guide(without.clone()).is_none(), "{without:?}");
    }
}

#[test]
fn cropped_parts_are_aligned_and_written_into_their_own_window() {
    let folder = folder();
    let color = Part::named("rgba").with("", "RGBA", 1.0);
    let small = Part { position: (1, 1), size: (2, 1), ..Part::named("diffuse").with("", "RGB", 0.0) };
    let small = Part { channels: Vec::new(), ..small }.with("diffuse", "RGB", 10.0);
    let large = Part { position: (-1, 0), size: (7, 3), channels: Vec::new(), ..Part::named("specular") };
    let large = large.with("specular", "RGB", 20.0);
    let elsewhere =
        Part { position: (50, 50), channels: Vec::new(), ..Part::named("glossy") }.with("glossy", "RGB", 30.0);
    let input = write(folder.path(), "in.exr", vec![color, small, large, elsewhere]);
    let set = read(&input);
    let (frame, _) = set.to_frame().unwrap();
    let names: Vec<&str> = frame.payload().iter().map(|layer| layer.name.as_str()).collect();
    assert_eq!(names, ["diffuse", "specular", "rgba.A"]);
    assert!(note(&set, "glossy").contains("data window"), "{}", note(&set, "glossy"));
    assert_eq!(frame.payload()[0].mean.planes[0][..8], [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 10.0, 11.0]);
    assert_eq!(frame.payload()[1].mean.planes[0][..6], [21.0, 22.0, 23.0, 24.0, 25.0, 28.0]);

    let (output, _) = denoised(&request(&input), |_, value| value + 1.0);
    let written = read_all_flat_layers_from_file(&output).unwrap();
    let values = |part: usize| match &written.layer_data[part].channel_data.list[2].sample_data {
        FlatSamples::F32(values) => values.clone(),
        other => panic!("{other:?}"),
    };
    assert_eq!(values(1), [11.0, 12.0]);
    // What lies outside of the picture stays.
    assert_eq!(values(2)[..8], [20.0, 22.0, 23.0, 24.0, 25.0, 26.0, 26.0, 27.0]);
    assert_eq!(values(3), ramp(30.0, PIXELS));
}

#[test]
fn noise_of_denoised_layers_is_left_out_and_serves_as_halves_on_request() {
    let folder = folder();
    let part = render()
        .with("diffuse_halfA", "RGB", 9.0)
        .with("diffuse_halfB", "RGB", 11.0)
        .with("diffuse_variance", "RGB", 1.0)
        .with("specular_mse", "RGBA", 2.0);
    let input = write(folder.path(), "in.exr", vec![part]);
    let (frame, _) = read(&input).to_frame().unwrap();
    assert_eq!(frame.payload()[0].half_spread, None);
    let with_halves = BufferSetRequest { payload_halves: true, ..request(&input) };
    let set = BufferSet::read(&with_halves).unwrap();
    assert!(set.to_frame().is_ok());

    let (output, written) = denoised(&with_halves, |_, value| value);
    assert_eq!(written.dropped_layers, ["diffuse_halfA", "diffuse_halfB", "diffuse_variance", "specular_mse"]);
    assert!(written.notes.iter().any(|note| note.contains("specular_mse")), "{:?}", written.notes);
    let channels = &read_all_flat_layers_from_file(&output).unwrap().layer_data[0].channel_data;
    assert!(
        !channels
            .list
            .iter()
            .any(|channel| channel.name.to_string().contains('_') && !channel.name.to_string().contains("denoised"))
    );
    let (output, written) = denoised(&BufferSetRequest { aovs: Aovs::None, ..with_halves }, |_, value| value);
    assert_eq!(written.dropped_layers, Vec::<String>::new());
    assert_eq!(stored(&output, "specular_mse.R"), stored(&input, "specular_mse.R"));
}

#[test]
fn merged_lights_have_the_halves_of_their_seeds_on_request() {
    let folder = folder();
    let seed = |name: &str, start: f32| {
        let part = Part::new().with("", "RGBA", start).with("diffuse", "RGB", 2.0 * start);
        write(folder.path(), name, vec![part.attribute("samples", AttributeValue::I32(8))])
    };
    let (first, second) = (seed("1.exr", 1.0), seed("2.exr", 3.0));
    let merged = BufferSetRequest { seeds: vec![second], payload_halves: true, ..request(&first) };
    let mut set = BufferSet::read(&merged).unwrap();
    let (frame, _) = set.take_frame().unwrap();
    let light = &frame.payload()[0];
    assert_eq!((&light.mean, light.half_spread.as_ref().unwrap().planes[0][3]), (&rgb(4.0), -2.0));
    let output = folder.path().join("out.exr");
    write_estimate(&estimate(&frame, |_, value| value / 2.0), set, &output, &[], &Method::default()).unwrap();
    assert_eq!(stored(&output, "diffuse.R").values_as_f32().next(), Some(2.0));
    let plain = BufferSet::read(&BufferSetRequest { payload_halves: false, ..merged }).unwrap();
    assert_eq!(plain.to_frame().unwrap().0.payload()[0].half_spread, None);
}

#[test]
fn pictures_take_the_layers_of_their_own_scope() {
    let folder = folder();
    let part = ["near", "far"].into_iter().fold(Part::new(), |part, view| {
        let part = part.with(&format!("{view}.Combined"), "RGBA", 1.0);
        part.with(&format!("{view}.Combined_key"), "RGB", 2.0)
    });
    let part = part.attribute("BlenderMultiChannel", AttributeValue::Text("Blender".into()));
    let set = read(&write(folder.path(), "in.exr", vec![part]));
    let names = |picture: usize| set.payload(picture).map(|(name, _)| name.to_owned()).collect::<Vec<_>>();
    let pictures: Vec<String> = set.pictures().map(str::to_owned).collect();
    for (index, picture) in pictures.iter().enumerate() {
        assert_eq!(names(index), [format!("{picture}_key"), format!("{picture}.A")]);
    }
}

#[test]
fn pictures_in_other_formats_hold_the_denoised_alpha() {
    let folder = folder();
    let input = write(folder.path(), "in.exr", vec![straight(0.25)]);
    for encoding in [AlphaEncoding::Straight, AlphaEncoding::Premultiplied] {
        let mut set = BufferSet::read(&BufferSetRequest { alpha: Some(encoding), ..request(&input) }).unwrap();
        let (frame, _) = set.take_frame().unwrap();
        let estimate = estimate(&frame, |_, value| value / 2.0);
        let output = folder.path().join("out.pfm");
        let written = write_estimate(&estimate, set, &output, &[], &Method::default()).unwrap();
        assert_eq!(written.along, ["A"]);
        let again = read(&output);
        let alpha = again.to_frame().unwrap().0.payload()[0].mean.planes[0][0];
        // The denoised alpha is a quarter; the colour was a quarter, times a half if it is straight.
        let expected = if encoding == AlphaEncoding::Straight { 0.5 } else { 0.25 };
        assert_eq!((again.color().mean.planes[0][0], alpha), (expected, 0.25));
    }
}

#[test]
fn a_layout_says_that_colours_are_straight() {
    let folder = folder();
    let layout = folder.path().join("mine.toml");
    std::fs::write(&layout, "title = \"Mine\"\nalpha = \"straight\"\n[[layer]]\nname = \"\"\nrole = \"color\"\n")
        .unwrap();
    let input = write(folder.path(), "in.exr", vec![straight(1.0)]);
    let by_layout = BufferSetRequest { layout: Some(layout.to_str().unwrap().to_owned()), ..request(&input) };
    assert_eq!(BufferSet::read(&by_layout).unwrap().color().mean.planes[0][0], 0.5);
    let premultiplied = BufferSetRequest { alpha: Some(AlphaEncoding::Premultiplied), ..by_layout };
    assert_eq!(BufferSet::read(&premultiplied).unwrap().color().mean.planes[0][0], 1.0);
}

#[test]
fn references_have_the_layers_that_are_denoised_along() {
    let folder = folder();
    let input = write(folder.path(), "in.exr", vec![straight(1.0)]);
    let truth = Part {
        channels: straight(2.0).channels.into_iter().filter(|(name, _)| !name.starts_with("variance")).collect(),
        ..straight(2.0)
    };
    let truth = LayerRef::whole(write(folder.path(), "truth.exr", vec![truth]));
    let set = BufferSet::read(&BufferSetRequest { alpha: Some(AlphaEncoding::Straight), ..request(&input) }).unwrap();
    let references = set.read_references(0, &truth).unwrap();
    assert_eq!(references.color, set.read_reference(0, &truth).unwrap());
    let found: Vec<(&str, f32)> =
        references.payload.iter().map(|(name, image)| (name.as_str(), image.planes[0][0])).collect();
    assert_eq!(found, [("diffuse", 1.0), ("A", 0.5)]);
    assert_eq!(references.alpha, Some(1));
    // The colour of a reference may have another name.
    let other = LayerRef::whole(write(folder.path(), "other.exr", vec![Part::new().with("beauty", "RGBA", 0.25)]));
    let references = set.read_references(0, &other).unwrap();
    assert_eq!((references.payload.len(), references.alpha), (1, Some(0)));
}

#[test]
fn colours_of_materials_are_no_light() {
    let folder = folder();
    let names = ["diffuse_albedo", "diffuse_color", "specular_color", "volume_opacity", "transmission_albedo"];
    let part = names.into_iter().fold(Part::new().with("", "RGB", 1.0), |part, name| part.with(name, "RGB", 2.0));
    let part = part.with("volume_z", "Z", 3.0).with("specular_direct", "RGB", 4.0);
    let set = read(&write(folder.path(), "in.exr", vec![part]));
    assert_eq!(set.payload(0).map(|(name, _)| name).collect::<Vec<_>>(), ["specular_direct"]);
    assert_eq!(set.feature_names().collect::<Vec<_>>(), ["albedo"]);
    assert!(note(&set, "volume_z").contains("not light"), "{}", note(&set, "volume_z"));
}

#[test]
fn straight_halves_have_alphas_of_their_own() {
    let folder = folder();
    let layer = |part: Part, name: &str, colour: f32, alpha: f32| {
        let part = ["R", "G", "B"]
            .into_iter()
            .fold(part, |part, channel| part.and(&format!("{name}{channel}"), plane(|pixel| colour + pixel as f32)));
        part.and(&format!("{name}A"), plane(move |_| alpha))
    };
    let part = layer(layer(layer(Part::new(), "", 2.0, 0.5), "halfA.", 1.0, 0.25), "halfB.", 4.0, 0.75);
    let input = write(folder.path(), "in.exr", vec![part]);
    let straight = BufferSetRequest { alpha: Some(AlphaEncoding::Straight), ..request(&input) };
    let color = BufferSet::read(&straight).unwrap().color();
    let first = |image: &Planes| image.planes[0][0];
    assert_eq!([&color.mean, &color.half_a.unwrap(), &color.half_b.unwrap()].map(first), [1.0, 0.25, 3.0]);

    let at = |path: &Path, channel: &str| stored(path, channel).values_as_f32().next().unwrap();
    let kept = BufferSetRequest { no_alpha: true, ..straight.clone() };
    let (output, _) = denoised(&kept, |_, value| value);
    // The frame has the half spread (0.25 - 3)/2 around the mean 1.
    assert_eq!([at(&output, "halfA.R"), at(&output, "halfA.A")], [(1.0 - 1.375) / 0.25, 0.25]);
    let (output, _) = denoised(&straight, |_, _| 0.5);
    assert_eq!([at(&output, "halfA.R"), at(&output, "halfA.A")], [(1.0 - 1.375) / 0.5, 0.5]);
}

/// A layout in which `colour` multiplies `direct` and `indirect`.
fn with_factor(folder: &Path) -> Option<String> {
    let layout = folder.join("factor.toml");
    let text = r#"
        title = "Mine"
        [[layer]]
        name = ""
        role = "color"
        [[layer]]
        name = ["{group}direct", "{group}indirect"]
        role = "light"
        factor = ["{group}hue", "{group}colour"]
        [[layer]]
        name = "{group}colour"
        role = "ignore"
    "#;
    std::fs::write(&layout, text).unwrap();
    Some(layout.to_str().unwrap().to_owned())
}

/// A light of `light` in red, twice as much in green and thrice in blue, with a colour that is 0 in pixel 1, negative
/// in pixel 2, infinite in pixel 3 and not a number in pixel 4. Elsewhere the colour is `factor` in red, a half of it in
/// green and a fourth in blue.
fn quotient(light: f32, factor: f32) -> Part {
    let factor_at = move |pixel: usize| match pixel {
        1 => 0.0,
        2 => -1.0,
        3 => f32::INFINITY,
        4 => f32::NAN,
        _ => factor,
    };
    let channels = [("R", 1.0, 1.0), ("G", 2.0, 0.5), ("B", 3.0, 0.25)];
    channels.into_iter().fold(Part::new().with("", "RGB", light), |part, (channel, times, share)| {
        part.and(&format!("direct.{channel}"), plane(|pixel| (light + pixel as f32) * times))
            .and(&format!("colour.{channel}"), plane(|pixel| factor_at(pixel) * share))
    })
}

#[test]
fn lights_are_denoised_as_products_with_their_factor() {
    let folder = folder();
    let input = write(folder.path(), "in.exr", vec![quotient(1.0, 0.5)]);
    let request = BufferSetRequest { layout: with_factor(folder.path()), ..request(&input) };
    assert_eq!(along(&request), ["direct"]);
    let set = BufferSet::read(&request).unwrap();
    assert!(note(&set, "colour").contains("as a factor of layers"), "{}", note(&set, "colour"));
    let (frame, repairs) = set.to_frame().unwrap();
    assert!(repairs.layers.is_empty(), "{repairs}");
    let planes = &frame.payload()[0].mean.planes;
    assert_eq!(planes[0][..6], [0.5, 0.0, 0.0, 0.0, 0.0, 3.0]);
    assert_eq!([planes[1][0], planes[2][0]], [2.0 * 0.25, 3.0 * 0.125]);
    let references = set.read_references(0, &LayerRef::whole(&input)).unwrap();
    assert_eq!(references.payload[0].1, frame.payload()[0].mean);

    let (output, written) = denoised(&request, |_, value| value + 1.0);
    assert_eq!(written.along, ["direct"]);
    assert_eq!(written.non_finite_values, 0);
    let FlatSamples::F32(red) = stored(&output, "direct.R") else { panic!("another type") };
    assert_eq!(red[..6], [1.5 / 0.5, 0.0, 0.0, 0.0, 0.0, 4.0 / 0.5]);
    assert_eq!(stored(&output, "direct.B").values_as_f32().next(), Some((0.375 + 1.0) / 0.125));
    // The factor stays, also where its values are no numbers.
    for channel in ["colour.R", "colour.G"] {
        let (before, after) = (stored(&input, channel), stored(&output, channel));
        let bits = |samples: &FlatSamples| samples.values_as_f32().map(f32::to_bits).collect::<Vec<_>>();
        assert_eq!(bits(&after), bits(&before), "{channel}");
    }
    // A light that no filter changed stays to the bit.
    let mut set = BufferSet::read(&request).unwrap();
    let (frame, _) = set.take_frame().unwrap();
    let mut unchanged = estimate(&frame, |_, value| value);
    unchanged.payload[0].left = Some(PayloadLeft::NoNoise);
    write_estimate(&unchanged, set, &output, &[], &Method::default()).unwrap();
    assert_eq!(stored(&output, "direct.R"), stored(&input, "direct.R"));
}

#[test]
fn a_factor_is_no_light_and_a_light_without_its_factor_is_denoised_as_it_is() {
    let folder = folder();
    let part = quotient(1.0, 0.5);
    let input = write(folder.path(), "in.exr", vec![part.clone()]);
    let layout = with_factor(folder.path());
    let with = |aovs: &str, input: &Path| BufferSetRequest {
        aovs: aovs.parse().unwrap(),
        layout: layout.clone(),
        ..request(input)
    };
    assert_eq!(along(&with("all", &input)), ["direct"]);
    assert!(failure(&with("colour", &input)).contains("other layers are multiplied by it"));
    let channels = part.channels.into_iter().filter(|(name, _)| !name.starts_with("colour")).collect();
    let without = write(folder.path(), "without.exr", vec![Part { channels, ..Part::new() }]);
    let (frame, _) = BufferSet::read(&with("lights", &without)).unwrap().to_frame().unwrap();
    assert_eq!(frame.payload()[0].mean.planes[1][..2], [2.0, 4.0]);
    // A reference without the factor has no product to compare with.
    let set = BufferSet::read(&with("lights", &input)).unwrap();
    assert!(set.read_references(0, &LayerRef::whole(&without)).unwrap().payload.is_empty());
    // The first name is preferred.
    let first = quotient(1.0, 0.5).with("hue", "Y", 2.0);
    let first = write(folder.path(), "first.exr", vec![first]);
    let (frame, _) = BufferSet::read(&with("lights", &first)).unwrap().to_frame().unwrap();
    assert_eq!(frame.payload()[0].mean.planes[1][..2], [2.0 * 2.0, 4.0 * 3.0]);
}

#[test]
fn products_of_seeds_are_merged_and_divided_by_the_merged_factor() {
    let folder = folder();
    let first = write(folder.path(), "1.exr", vec![quotient(1.0, 0.5)]);
    let second = write(folder.path(), "2.exr", vec![quotient(3.0, 0.25)]);
    let request = BufferSetRequest {
        layout: with_factor(folder.path()),
        seeds: vec![second],
        payload_halves: true,
        ..request(&first)
    };
    let (frame, _) = BufferSet::read(&request).unwrap().to_frame().unwrap();
    let light = &frame.payload()[0];
    // Products 0.5 and 0.75 in red, and 0.375 and 0.5625 in blue.
    assert_eq!((light.mean.planes[0][0], light.half_spread.as_ref().unwrap().planes[0][0]), (0.625, -0.125));
    assert_eq!(light.mean.planes[2][0], 0.46875);
    for is_changed in [true, false] {
        let mut set = BufferSet::read(&request).unwrap();
        let (frame, _) = set.take_frame().unwrap();
        let mut estimate = estimate(&frame, |_, value| value);
        estimate.payload[0].left = (!is_changed).then_some(PayloadLeft::NoNoise);
        let output = folder.path().join("out.exr");
        write_estimate(&estimate, set, &output, &[], &Method::default()).unwrap();
        let at = |channel: &str| stored(&output, channel).values_as_f32().next().unwrap();
        assert_eq!([at("colour.R"), at("colour.B")], [0.375, 0.09375]);
        assert!((at("direct.R") * at("colour.R") - 0.625).abs() < 1e-6, "{}", at("direct.R"));
        assert!((at("direct.B") * at("colour.B") - 0.46875).abs() < 1e-6, "{}", at("direct.B"));
    }
}

#[test]
fn halves_of_a_light_have_the_halves_of_its_factor() {
    let folder = folder();
    let part = quotient(1.0, 0.5)
        .with("halfA", "RGB", 0.5)
        .with("halfB", "RGB", 1.5)
        .with("direct_halfA", "RGB", 2.0)
        .with("direct_halfB", "RGB", 4.0)
        .with("colour_halfA", "RGB", 0.25)
        .with("colour_halfB", "RGB", 0.75);
    let layout = with_factor(folder.path());
    let spread = |part: Part| {
        let input = write(folder.path(), "in.exr", vec![part]);
        let request = BufferSetRequest { layout: layout.clone(), payload_halves: true, ..request(&input) };
        let (frame, _) = BufferSet::read(&request).unwrap().to_frame().unwrap();
        frame.payload()[0].half_spread.as_ref().unwrap().planes[0][0]
    };
    assert_eq!(spread(part.clone()), (2.0 * 0.25 - 4.0 * 0.75) / 2.0);
    // Without halves, the mean of the factor multiplies both.
    let channels = part.channels.into_iter().filter(|(name, _)| !name.starts_with("colour_half")).collect();
    assert_eq!(spread(Part { channels, ..Part::new() }), (2.0 - 4.0) * 0.5 / 2.0);
}

#[test]
fn straight_lights_are_multiplied_by_their_factor_and_their_alpha() {
    let folder = folder();
    let seed = |name: &str, light: f32, factor: f32, alpha: f32| {
        write(folder.path(), name, vec![quotient(light, factor).and("A", plane(move |_| alpha))])
    };
    let (first, second) = (seed("1.exr", 1.0, 0.5, 0.5), seed("2.exr", 3.0, 0.25, 1.0));
    let request = BufferSetRequest {
        layout: with_factor(folder.path()),
        alpha: Some(AlphaEncoding::Straight),
        seeds: vec![second],
        ..request(&first)
    };
    let (frame, _) = BufferSet::read(&request).unwrap().to_frame().unwrap();
    // (1·0.5·0.5 + 3·0.25·1)/2.
    assert_eq!(frame.payload()[0].mean.planes[0][..2], [0.5, 0.0]);
    let (output, _) = denoised(&request, |_, value| value);
    let at = |channel: &str| stored(&output, channel).values_as_f32().next().unwrap();
    assert_eq!([at("colour.R"), at("A")], [0.375, 0.75]);
    assert!((at("direct.R") * at("colour.R") * at("A") - 0.5).abs() < 1e-6);
    let single = BufferSetRequest { seeds: Vec::new(), ..request };
    let (output, _) = denoised(&single, |_, value| value);
    assert_eq!(stored(&output, "direct.R").values_as_f32().next(), Some(1.0));
}

#[test]
fn blender_has_its_factors_in_the_same_part_or_in_parts_of_their_own() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("testdata/layouts/cycles");
    for (file, light, factor) in [
        ("5_0.exr", "ViewLayer.Diffuse Direct", "ViewLayer.Diffuse Color"),
        ("2_90.exr", "View Layer.DiffDir", "View Layer.DiffCol"),
    ] {
        let input = folder.join(file);
        let [quotient, factor] =
            [light, factor].map(|layer| stein_exr::read_reference(&input, Some(layer)).unwrap().planes[1][5]);
        let (frame, _) = read(&input).to_frame().unwrap();
        let layer = frame.payload().iter().find(|layer| layer.name == light).unwrap();
        assert_eq!(layer.mean.planes[1][5], quotient * factor, "{file}");
    }
}

#[test]
fn what_no_filter_has_seen_of_merged_seeds_is_written_as_quotients() {
    let folder = folder();
    let seed = |name: &str, light: f32, factor: f32| {
        let part = ["near", "far"].into_iter().fold(Part::new(), |part, group| {
            let part = part.with(&format!("{group}.Combined"), "RGB", light);
            ["R", "G", "B"].into_iter().fold(part, |part, channel| {
                part.and(&format!("{group}.Diffuse Direct.{channel}"), plane(|_| light))
                    .and(&format!("{group}.Diffuse Color.{channel}"), plane(|_| factor))
            })
        });
        write(folder.path(), name, vec![part.attribute("BlenderMultiChannel", AttributeValue::Text("x".into()))])
    };
    let (first, second) = (seed("1.exr", 1.0, 0.5), seed("2.exr", 3.0, 0.25));
    let request = BufferSetRequest { seeds: vec![second], ..request(&first) };
    let output = folder.path().join("out.exr");
    let check = |what: &str| {
        for group in ["near", "far"] {
            let at = |layer: &str| stored(&output, &format!("{group}.{layer}.G")).values_as_f32().next().unwrap();
            assert_eq!(at("Diffuse Color"), 0.375);
            assert!((at("Diffuse Direct") - 0.625 / 0.375).abs() < 1e-6, "{what}: {group} {}", at("Diffuse Direct"));
        }
    };
    // The frame is of one of the pictures.
    let mut set = BufferSet::read(&request).unwrap();
    let (frame, _) = set.take_frame().unwrap();
    write_estimate(&estimate(&frame, |_, value| value), set, &output, &[], &Method::default()).unwrap();
    check("take_frame");
    // The estimate is of one of the pictures.
    let set = BufferSet::read(&request).unwrap();
    write_estimate(&estimate(&frame, |_, value| value), set, &output, &[], &Method::default()).unwrap();
    check("write_estimate");
    // The estimate lacks the layer.
    let none = Estimate { payload: Vec::new(), ..estimate(&frame, |_, value| value) };
    let set = BufferSet::read(&request).unwrap();
    write_estimate(&none, set, &output, &[], &Method::default()).unwrap();
    check("an estimate without the layer");
    let set = BufferSet::read(&request).unwrap();
    let color = frame.color().mean.clone();
    write_denoised(set, &output, &replace_color(&color)).unwrap();
    check("write_denoised");
}

#[test]
fn pixels_beside_the_picture_stay_quotients() {
    let folder = folder();
    let seed = |name: &str, light: f32, factor: f32| {
        let channels = |part: Part, layer: &str, value: f32| {
            ["R", "G", "B"].into_iter().fold(part, |mut part, channel| {
                let pixels = part.size.0 * part.size.1;
                part.channels.push((format!("{layer}.{channel}"), FlatSamples::F32(vec![value; pixels])));
                part
            })
        };
        let color = Part::named("color").with("", "RGB", light);
        let wide = Part { size: (SIZE.0 + 1, SIZE.1), ..Part::named("wide") };
        let wide = channels(channels(wide, "direct", light), "colour", factor);
        write(folder.path(), name, vec![color, wide])
    };
    let (first, second) = (seed("1.exr", 1.0, 0.5), seed("2.exr", 3.0, 0.25));
    let request = BufferSetRequest { seeds: vec![second], layout: with_factor(folder.path()), ..request(&first) };
    assert_eq!(along(&request), ["direct"]);
    let (output, _) = denoised(&request, |_, value| 2.0 * value);
    let written = read_all_flat_layers_from_file(&output).unwrap();
    let channels = &written.layer_data[1].channel_data.list;
    let red = channels.iter().find(|channel| channel.name.to_string() == "direct.R").unwrap();
    let red: Vec<f32> = red.sample_data.values_as_f32().collect();
    assert!((red[0] - 2.0 * 0.625 / 0.375).abs() < 1e-6, "{}", red[0]);
    assert!((red[SIZE.0] - 0.625 / 0.375).abs() < 1e-6, "{}", red[SIZE.0]);
}
