//! The use of each layer, and its values.

use std::path::{Path, PathBuf};

use stein::frame::SamplesPerPixel;
use stein::image::Extent;
use stein_exr::{BufferSet, BufferSetRequest, LayerRef, Role, SampleKind, SignalPart, read_reference, write_denoised};

use super::*;

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
    assert_eq!(role(&set, "normal_halfA"), Role::Feature("normal".into(), SignalPart::HalfA));
    assert_eq!(set.layer_uses()[0].sample_kind, SampleKind::Float);
}

#[test]
fn a_half_float_file_with_lower_case_shuffled_channels_reads_the_same() {
    let folder = folder();
    let mut part = Part::native();
    for (name, samples) in &mut part.channels {
        let FlatSamples::F32(values) = samples else { unreachable!() };
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
    assert_eq!(set.features().next().unwrap().1.variance_of_mean, Some(rgb(6.0)));
    let output = folder.path().join("out.exr");
    write_denoised(set.clone(), &output, &replace_color(&rgb(50.0))).unwrap();
    let again = read(&output);
    assert_eq!(again.color().mean, rgb(50.0));
    assert_eq!(again.color().half_a, Some(rgb(2.0)));
    let mut expected = set.layer_uses().to_vec();
    expected.iter_mut().for_each(|layer| layer.file.clone_from(&output));
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
    assert_eq!(set.feature_names().collect::<Vec<_>>(), ["albedo", "depth"]);
    assert!(note(&set, "ViewLayer.Debug Sample Count").contains("fraction"));
}

#[test]
fn a_chosen_layer_does_not_take_the_beautys_halves() {
    let folder = folder();
    let part = Part::native().with("diffuse", "RGB", 20.0);
    let part = part.with("diffuse_halfA", "RGB", 21.0).with("diffuse_halfB", "RGB", 22.0);
    let mut request = request(&write(folder.path(), "in.exr", vec![part]));
    request.layer = Some("diffuse".into());
    let set = BufferSet::read(&request).unwrap();
    assert_eq!(set.color().mean, rgb(20.0));
    assert_eq!(set.color().half_a, Some(rgb(21.0)));
    assert_eq!(set.color().variance_of_mean, None);
    request.layer = Some("specular".into());
    let message = failure(&request);
    assert!(message.contains("specular") && message.contains("'diffuse' (R G B)"), "{message}");
}

#[test]
fn a_layer_of_a_file_is_written_behind_two_colons() {
    let of = |file: &str, layer: Option<&str>| LayerRef { file: file.into(), layer: layer.map(str::to_owned) };
    for (text, expected) in
        [("a.exr", of("a.exr", None)), ("b::c.exr::d.e", of("b::c.exr", Some("d.e"))), ("a.exr::", of("a.exr::", None))]
    {
        let Ok(read) = text.parse::<LayerRef>();
        assert_eq!((read.to_string().as_str(), &read), (text, &expected));
        assert_eq!(LayerRef::from(std::ffi::OsString::from(text)), expected);
    }
    #[cfg(unix)]
    {
        let name: std::ffi::OsString = std::os::unix::ffi::OsStringExt::from_vec(b"\xff.exr::a".to_vec());
        let file: std::ffi::OsString = std::os::unix::ffi::OsStringExt::from_vec(b"\xff.exr".to_vec());
        assert_eq!(LayerRef::from(name.clone()), LayerRef { file: file.into(), layer: Some("a".into()) });
        assert_eq!(LayerRef::from(name.clone()).literal(), LayerRef::whole(name));
    }
}

#[test]
fn the_disk_decides_where_a_text_is_split() {
    let folder = folder();
    let inside = |path: &str| folder.path().join(path).to_str().unwrap().to_owned();
    std::fs::create_dir(inside("a::b")).unwrap();
    for file in ["x::y.exr", "a::b/in.exr", "plain", "in.exr"] {
        std::fs::write(inside(file), "").unwrap();
    }
    for (text, file, layer) in [
        ("x::y.exr", "x::y.exr", None),
        ("x::y.exr::z", "x::y.exr", Some("z")),
        ("a::b/in.exr", "a::b/in.exr", None),
        ("a::b/in.exr::z", "a::b/in.exr", Some("z")),
        ("a::b/missing.exr", "a::b/missing.exr", None),
        ("a::b/shot.####.exr::z", "a::b/shot.####.exr", Some("z")),
        ("plain::z", "plain", Some("z")),
        ("in.exr::y::z", "in.exr", Some("y::z")),
        ("missing::z", "missing", Some("z")),
    ] {
        let Ok(found) = inside(text).parse::<LayerRef>();
        let expected = LayerRef { file: inside(file).into(), layer: layer.map(str::to_owned) };
        assert_eq!(found, expected, "{text}");
        assert_eq!(found.literal(), LayerRef::whole(inside(text)), "{text}");
    }
}

#[test]
fn halves_variance_and_features_come_from_separate_files() {
    let folder = folder();
    let one = |name: &str, part: Part| write(folder.path(), name, vec![part]);
    let input = one("color.exr", Part::new().with("", "RGB", 1.0));
    let half_a = one("a.exr", Part::new().with("", "RGB", 2.0));
    let seeds = vec![Part::named("seed1").with("", "RGB", 9.0), Part::named("seed2").with("", "RGB", 3.0)];
    let half_b = write(folder.path(), "b.exr", seeds);
    let variance = one("variance.exr", Part::new().with("variance", "RGB", 4.0));
    let albedo = one("albedo.exr", Part::new().with("", "RGB", 5.0).with("albedo_variance", "RGB", 6.0));
    let depth = one("depth.exr", Part::new().with("", "Y", 7.0).with("variance", "Y", 8.0));
    let whole = |file: PathBuf| LayerRef { file, layer: None };
    let set = BufferSet::read(&BufferSetRequest {
        half_a: Some(whole(half_a)),
        half_b: Some(format!("{}::seed2", half_b.display()).parse().unwrap()),
        variance: Some(LayerRef { file: variance, layer: Some("variance".into()) }),
        features: vec![("albedo".into(), whole(albedo)), ("depth".into(), whole(depth))],
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
        part = part.with(&format!("aov{index}"), "RGB", 1.0).with(&format!("aov{index}_variance"), "RGB", 1.0);
    }
    let input = write(folder.path(), "in.exr", vec![part]);
    let set = read(&input);
    assert_eq!(set.features().len(), 8);
    assert!(note(&set, "aov8").contains("at most 8"), "{:?}", set.layer_uses());
    let skip_features = vec!["aov0".to_owned(), "aov3".to_owned()];
    let set = BufferSet::read(&BufferSetRequest { skip_features, ..request(&input) }).unwrap();
    assert_eq!(set.feature_names().filter(|name| *name == "normal" || *name == "aov8").count(), 2);
    assert!(note(&set, "aov3").contains("request"));
    let none = BufferSet::read(&BufferSetRequest { no_features: true, ..request(&input) }).unwrap();
    assert_eq!(none.features().len(), 0);
}

#[test]
fn samples_per_pixel_come_from_a_channel_or_any_kind_of_attribute() {
    let folder = folder();
    let colored = || Part::new().with("", "RGB", 1.0);
    for value in [AttributeValue::I32(16), AttributeValue::F32(16.0), AttributeValue::Text(" 16 ".into())] {
        let set = read(&write(folder.path(), "in.exr", vec![colored().attribute("samples", value)]));
        assert_eq!(set.samples_per_pixel(), SamplesPerPixel::Uniform(16.0));
    }
    let mut part = colored().attribute("samples", AttributeValue::I32(16));
    part.channels.push(("samples".into(), FlatSamples::U32((1..=PIXELS as u32).collect())));
    let set = read(&write(folder.path(), "in.exr", vec![part]));
    assert_eq!(set.samples_per_pixel(), SamplesPerPixel::PerPixel(single(1.0)));
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
    assert_eq!(set.color().variance_of_mean.unwrap().planes, vec![ramp(2.0, PIXELS); 3]);
    let output = folder.path().join("out.exr");
    write_denoised(set.clone(), &output, &replace_color(&rgb(0.0))).unwrap();
    // The mean of ramps from 0, 100 and 200.
    let FlatSamples::F32(written) = stored(&output, "Y") else { panic!("not a float") };
    assert!(written.iter().zip(ramp(100.0, PIXELS)).all(|(a, b)| (a - b).abs() < 1e-3), "{written:?}");
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
    assert_eq!(parse("a.exr"), LayerRef { file: "a.exr".into(), layer: None });
    assert_eq!(parse("a::b.exr::v.N"), LayerRef { file: "a::b.exr".into(), layer: Some("v.N".into()) });
    assert_eq!(parse("::x"), LayerRef { file: "::x".into(), layer: None });
}

#[test]
fn usual_names_in_a_file_of_another_renderer_keep_their_meaning() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("testdata/mitsuba");
    let set = read(&folder.join("iteration_1.exr"));
    assert_eq!(set.layout().name, "mitsuba");
    let color = set.color();
    assert!(color.half_a.is_some() && color.half_b.is_some() && color.variance_of_mean.is_some());
    assert_eq!(set.feature_names().collect::<Vec<_>>(), ["albedo", "depth", "normal"]);
    assert!(set.features().all(|(_, signal)| signal.half_a.is_some() && signal.variance_of_mean.is_some()));
}

#[test]
fn the_test_renders_are_native_layout() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("testdata");
    let renders =
        [("cornell_8spp", 8.0), ("cornell_32spp", 32.0), ("dof_spheres_32spp", 32.0), ("caustic_ring_32spp", 32.0)];
    for (name, samples) in renders {
        let set = read(&folder.join(format!("{name}.exr")));
        assert_eq!(set.feature_names().collect::<Vec<_>>(), ["albedo", "depth", "normal", "visibility"], "{name}");
        assert!(set.features().all(|(_, signal)| signal.half_a.is_some() && signal.variance_of_mean.is_some()));
        assert_eq!(set.samples_per_pixel(), SamplesPerPixel::Uniform(samples));
        assert_eq!(set.extent(), Extent { width: 96, height: 96 });
    }
}
