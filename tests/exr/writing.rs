//! Outputs: the layers that are replaced; all others stay.

use std::path::Path;

use stein::Frame;
use stein::error::Error;
use stein::image::{Extent, Image as Planes, Window};
use stein_exr::{DenoisedLayers, NamedLayer, Role, SampleKind, write_denoised};

use super::draft::{CHANNELS, Draft};
use super::*;

#[test]
fn mixed_sample_types_are_read_and_kept() {
    let folder = folder();
    let mut part = Part::native();
    part.channels[0].1 = FlatSamples::F16(vec![f16::from_f32(0.5); PIXELS]);
    part.channels.push(("id".into(), FlatSamples::U32(vec![7; PIXELS])));
    let set = read(&write(folder.path(), "in.exr", vec![part]));
    assert_eq!(set.color().mean.planes[0], vec![0.5; PIXELS]);
    let main = set.layer_uses().iter().find(|found| found.layer.is_empty()).unwrap();
    assert_eq!(main.sample_kind, SampleKind::Mixed);
    let output = folder.path().join("out.exr");
    let mut color = rgb(10.0);
    color.planes[0][3] = 1e6;
    let report = write_denoised(set.clone(), &output, &replace_color(&color)).unwrap();
    assert_eq!(report.clamped_values, 1);
    let FlatSamples::F16(red) = stored(&output, "R") else { panic!("red is not half") };
    assert_eq!((red[0].to_f32(), red[3].to_f32()), (10.0, 65504.0));
    assert_eq!(stored(&output, "G"), FlatSamples::F32(ramp(110.0, PIXELS)));
    assert_eq!(stored(&output, "id"), FlatSamples::U32(vec![7; PIXELS]));
}

#[test]
fn alpha_and_unknown_layers_pass_through_untouched() {
    let folder = folder();
    let part = Part::native().with("", "A", 0.25).with("matte", "RGB", 30.0);
    let part = part.attribute("camera", AttributeValue::FloatVec3((1.0, 2.0, 3.0)));
    let input = write(folder.path(), "in.exr", vec![part]);
    let set = read(&input);
    assert_eq!(role(&set, "matte"), Role::Untouched);
    let output = folder.path().join("out.exr");
    write_denoised(set.clone(), &output, &replace_color(&rgb(50.0))).unwrap();
    let before = read_all_flat_layers_from_file(&input).unwrap();
    let mut after = read_all_flat_layers_from_file(&output).unwrap();
    let old_channels = &before.layer_data[0].channel_data.list;
    for (channel, old) in after.layer_data[0].channel_data.list.iter_mut().zip(old_channels) {
        let replaced = ["R", "G", "B"].iter().any(|name| channel.name == **name);
        assert_eq!(channel.sample_data != old.sample_data, replaced, "{}", channel.name);
        channel.sample_data = old.sample_data.clone();
    }
    assert_eq!(after, before, "header or layout changed");
}

#[test]
fn a_cropped_render_keeps_both_windows() {
    let folder = folder();
    let part = Part { position: (-3, 7), ..Part::native() };
    let path = folder.path().join("crop.exr");
    image_of(vec![part], IntegerBounds::new((0, 0), (64, 48))).write().to_file(&path).unwrap();
    let set = read(&path);
    let data = Window { x: -3, y: 7, extent: Extent { width: 5, height: 3 } };
    let whole = Window { x: 0, y: 0, extent: Extent { width: 64, height: 48 } };
    assert_eq!((set.data_window(), set.display_window()), (data, whole));
    let output = folder.path().join("out.exr");
    write_denoised(set.clone(), &output, &replace_color(&rgb(50.0))).unwrap();
    let again = read(&output);
    assert_eq!((again.data_window(), again.display_window()), (data, whole));
    assert_eq!(again.color().mean, rgb(50.0));
}

#[test]
fn every_writable_compression_is_kept() {
    let folder = folder();
    use Compression::*;
    for compression in [Uncompressed, RLE, ZIP1, ZIP16, PIZ, PXR24, DWAA(None), DWAB(Some(30.0))] {
        let is_lossy = matches!(compression, DWAA(_) | DWAB(_));
        let part = if is_lossy { Part::new().with("", "RGB", 1.0) } else { Part::native() };
        let set = read(&write(folder.path(), "in.exr", vec![Part { compression, ..part }]));
        let output = folder.path().join("out.exr");
        write_denoised(set.clone(), &output, &replace_color(&rgb(50.0))).unwrap();
        let written = read_all_flat_layers_from_file(&output).unwrap();
        assert_eq!(written.layer_data[0].encoding.compression, compression);
        let again = read(&output).color().mean;
        let close = |(a, b): (&f32, &f32)| (a - b).abs() <= 0.02 * b.abs();
        assert!(again.planes.iter().flatten().zip(rgb(50.0).planes.iter().flatten()).all(close), "{compression}");
    }
}

#[test]
fn a_sun_near_the_largest_half_float_stays_bright_under_dwa() {
    let folder = folder();
    let (input, output) = (folder.path().join("in.exr"), folder.path().join("out.exr"));
    let size = (32, 32);
    let is_sun = |pixel: usize| (12..20).contains(&(pixel % 32)) && (12..20).contains(&(pixel / 32));
    // Uneven values, so that the waves overshoot.
    let value =
        |pixel: usize| if is_sun(pixel) { 60_000.0 + 5504.0 * (pixel * 7919 % 101) as f32 / 100.0 } else { 1.0 };
    let plane: Vec<f16> = (0..32 * 32).map(|pixel| f16::from_f32(value(pixel))).collect();
    let mut overshot = 0;
    for level in [45.0, 90.0, 300.0] {
        let channels = ["R", "G", "B"].map(|name| (name.to_owned(), FlatSamples::F16(plane.clone()))).to_vec();
        let part = Part { size, channels, compression: Compression::DWAA(Some(level)), ..Part::new() };
        let distance =
            FlatSamples::F32((0..32 * 32).map(|pixel| if pixel == 5 { f32::INFINITY } else { 1.0 }).collect());
        let part = Part { channels: [part.channels.clone(), vec![("depth.Z".into(), distance)]].concat(), ..part };
        write(folder.path(), "in.exr", vec![part]);
        let FlatSamples::F16(decoded) = stored(&input, "R") else { panic!("another type") };
        overshot += decoded.iter().filter(|value| !value.is_finite()).count();
        let set = read(&input);
        let color = set.color().mean;
        for (pixel, value) in color.planes[0].iter().enumerate() {
            assert!(
                if is_sun(pixel) { (3e4..=65_504.0).contains(value) } else { *value < 3.0 },
                "level {level}: {value} at {pixel}"
            );
        }
        let report = write_denoised(set, &output, &replace_color(&color)).unwrap();
        assert!(report.to_string().contains("ZIP is used instead"), "{report}");
        assert_eq!(read(&output).color().mean, color, "what is written reads back as it was meant");
        let FlatSamples::F32(distances) = stored(&output, "depth.Z") else { panic!("another type") };
        assert!(distances[5].is_infinite(), "what is stored without loss may be infinite");
    }
    assert!(overshot > 0, "the case is none");
}

#[test]
fn lines_and_tiles_may_stand_in_any_order() {
    let folder = folder();
    for blocks in [Blocks::ScanLines, Blocks::Tiles(Vec2(2, 2))] {
        for line_order in [LineOrder::Increasing, LineOrder::Decreasing, LineOrder::Unspecified] {
            let mut image = image_of(
                vec![Part { compression: Compression::ZIP1, ..Part::native() }],
                IntegerBounds::from_dimensions(SIZE),
            );
            image.layer_data[0].encoding.blocks = blocks;
            image.layer_data[0].encoding.line_order = line_order;
            let (path, output) = (folder.path().join("in.exr"), folder.path().join("out.exr"));
            image.write().skip_compatibility_checks().to_file(&path).unwrap();
            let set = read(&path);
            assert_eq!(set.color().half_a, Some(rgb(2.0)));
            write_denoised(set, &output, &replace_color(&rgb(50.0))).unwrap();
            assert_eq!((read(&output).color().mean, read(&output).color().half_a), (rgb(50.0), Some(rgb(2.0))));
        }
    }
}

#[test]
fn a_compression_whose_encoder_is_not_sound_becomes_zip() {
    let folder = folder();
    let (input, output) = (folder.path().join("in.exr"), folder.path().join("out.exr"));
    // B44 and B44A blocks that did not shrink and are stored uncompressed. The encoder has too little room for an image
    // of one row.
    for (method, width) in [(6, 4), (7, 3000)] {
        let values = (0..CHANNELS.len() * width)
            .flat_map(|at| f16::from_f32(if at % 2 == 0 { -6e4 } else { 6e4 }).to_le_bytes());
        std::fs::write(
            &input,
            Draft::compressed(method, values.collect()).window([0, 0, width as i32 - 1, 0]).bytes().0,
        )
        .unwrap();
        let set = read(&input);
        let color = set.color().mean;
        assert_eq!(color.extent, Extent { width: width as u32, height: 1 });
        let report = write_denoised(set, &output, &replace_color(&color)).unwrap();
        assert!(report.to_string().contains("ZIP"), "{report}");
        assert_eq!(read(&output).color().mean, color);
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
    write_denoised(set.clone(), &output, &replace_color(&rgb(50.0))).unwrap();
    let written = read_all_flat_layers_from_file(&output).unwrap();
    assert_eq!(written.layer_data[0].encoding.blocks, Blocks::Tiles(Vec2(2, 2)));
}

#[test]
fn results_replace_stale_halves_and_extra_layers_are_added() {
    let folder = folder();
    let set = read(&write(folder.path(), "in.exr", vec![Part::native().with("halfA", "A", 0.5)]));
    let color = rgb(50.0);
    let extra = [NamedLayer { name: "error".into(), channels: vec!["V".into()], image: single(0.5) }];
    let replacements = [("halfA".to_owned(), rgb(60.0)), ("variance".to_owned(), rgb(70.0))];
    let attributes = [("denoiser".to_owned(), "stein".to_owned())];
    let output = folder.path().join("out.exr");
    let layers = DenoisedLayers {
        color: &color,
        replacements: &replacements,
        dropped: &[],
        extra: &extra,
        attributes: &attributes,
    };
    let report = write_denoised(set.clone(), &output, &layers).unwrap();
    assert_eq!(report, Default::default());
    let again = read(&output).color();
    assert_eq!(again.half_a, Some(rgb(60.0)));
    assert_eq!(again.half_b, Some(rgb(3.0)));
    assert_eq!(again.variance_of_mean, Some(rgb(70.0)));
    assert_eq!(stored(&output, "halfA.A"), FlatSamples::F32(ramp(0.5, PIXELS)));
    assert_eq!(stored(&output, "error.V"), FlatSamples::F32(ramp(0.5, PIXELS)));
    let written = read_all_flat_layers_from_file(&output).unwrap();
    let attribute = &written.layer_data[0].attributes.other[&Text::from("denoiser")];
    assert_eq!(*attribute, AttributeValue::Text("stein".into()));
}

#[test]
fn layers_that_would_be_wrong_are_left_out() {
    let folder = folder();
    let other_part = vec![Part::named("variance").with("", "RGB", 4.0), Part::named("rgba").with("", "RGB", 1.0)];
    for (parts, left) in [(vec![Part::native()], true), (other_part, false)] {
        let set = read(&write(folder.path(), "in.exr", parts));
        assert!(set.color().variance_of_mean.is_some());
        let (color, output) = (rgb(50.0), folder.path().join("out.exr"));
        let layers = DenoisedLayers { dropped: &["variance".to_owned()], ..replace_color(&color) };
        write_denoised(set.clone(), &output, &layers).unwrap();
        let again = read(&output);
        assert_eq!(again.color().mean, color);
        assert_eq!(again.color().variance_of_mean, None);
        assert_eq!(again.color().half_a.is_some(), left);
        assert_eq!(again.feature_names().len(), usize::from(left));
    }
}

#[test]
fn a_failed_write_leaves_nothing_behind_and_the_old_file_alone() {
    let folder = folder();
    let input = write(folder.path(), "in.exr", vec![Part::native()]);
    let set = read(&input);
    let before = std::fs::read(&input).unwrap();
    let color = rgb(50.0);
    let wrong = Planes::filled(Extent { width: 2, height: 2 }, 3, 0.0);
    assert!(write_denoised(set.clone(), &input, &replace_color(&wrong)).is_err());
    let extra = [NamedLayer { name: "normal".into(), channels: vec!["X".into()], image: single(0.0) }];
    let clash = DenoisedLayers { extra: &extra, ..replace_color(&color) };
    let message = write_denoised(set.clone(), &input, &clash).unwrap_err().to_string();
    assert!(message.contains("normal.X"), "{message}");
    let replacements = [("nowhere".to_owned(), rgb(0.0))];
    let lost = DenoisedLayers { replacements: &replacements, ..replace_color(&color) };
    assert!(write_denoised(set.clone(), &input, &lost).unwrap_err().to_string().contains("nowhere"));
    let missing = folder.path().join("no such folder").join("out.exr");
    assert!(matches!(write_denoised(set.clone(), &missing, &replace_color(&color)), Err(Error::File { .. })));
    // The target is a folder, so that only the last step, the renaming, fails.
    let occupied = folder.path().join("occupied");
    std::fs::create_dir_all(occupied.join("inside")).unwrap();
    assert!(write_denoised(set.clone(), &occupied, &replace_color(&color)).is_err());
    assert_eq!(std::fs::read(&input).unwrap(), before);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2, "a temporary file was left");
}

#[test]
fn the_same_image_is_the_same_file() {
    let folder = folder();
    let attributes = |part: Part| {
        ["one", "two", "three", "four", "five"]
            .into_iter()
            .fold(part, |part, name| part.attribute(name, AttributeValue::I32(1)))
    };
    let parts = vec![
        attributes(Part::named("beauty").with("", "RGB", 1.0)),
        attributes(Part::named("variance").with("", "RGB", 2.0)),
    ];
    let set = read(&write(folder.path(), "in.exr", parts));
    let more = ["six", "seven", "eight"].map(|name| (name.to_owned(), name.to_owned()));
    let (color, output) = (rgb(50.0), folder.path().join("out.exr"));
    let mut written = Vec::new();
    for _ in 0..4 {
        write_denoised(set.clone(), &output, &DenoisedLayers { attributes: &more, ..replace_color(&color) }).unwrap();
        written.push(std::fs::read(&output).unwrap());
    }
    assert!(written.iter().all(|bytes| *bytes == written[0]));
    assert_eq!(read(&output).text_attribute("seven").as_deref(), Some("seven"));
}

#[test]
fn a_time_code_of_60_frames_in_a_second_does_not_cost_the_work() {
    let folder = folder();
    let good = Draft::good().and("timeCode", "timecode", vec![0x35, 0x12, 0x34, 0x12, 0, 0, 0, 0]);
    let input = folder.path().join("in.exr");
    std::fs::write(&input, good.bytes().0).unwrap();
    let (set, output) = (read(&input), folder.path().join("out.exr"));
    let color = Planes::filled(set.extent(), 3, 0.5);
    let report = write_denoised(set, &output, &replace_color(&color)).unwrap();
    assert!(report.to_string().contains("time code"), "{report}");
    assert_eq!(read(&output).color().mean, color);
}

#[test]
fn the_input_can_be_overwritten() {
    let folder = folder();
    let input = write(folder.path(), "in.exr", vec![Part::native()]);
    write_denoised(read(&input), &input, &replace_color(&rgb(50.0))).unwrap();
    assert_eq!(read(&input).color().mean, rgb(50.0));
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        let plain = folder.path().join("plain");
        std::fs::write(&plain, "").unwrap();
        let mode = |path: &Path| std::fs::metadata(path).unwrap().permissions().mode();
        assert_eq!(mode(&input), mode(&plain), "an output is as readable as any other file");
    }
}

fn assert_alike(a: &Frame, b: &Frame) {
    let signals = |frame: &Frame| {
        let features = frame.features().iter().map(|feature| feature.signal.clone());
        std::iter::once(frame.color().clone())
            .chain(features)
            .map(|signal| (signal.mean, signal.half_spread, signal.variance_of_mean))
            .collect::<Vec<_>>()
    };
    assert_eq!(signals(a), signals(b));
    assert_eq!(a.samples_per_pixel(), b.samples_per_pixel());
}

fn halves_of(samples: FlatSamples) -> FlatSamples {
    match samples {
        FlatSamples::F32(values) => FlatSamples::F16(values.into_iter().map(f16::from_f32).collect()),
        other => other,
    }
}

#[test]
fn a_set_that_gave_its_samples_away_makes_the_same_frame_and_output() {
    let folder = folder();
    let mut as_halves = Part::native();
    as_halves.channels.iter_mut().for_each(|(_, samples)| *samples = halves_of(samples.clone()));
    let with_more_in_a_half = Part::native().with("halfA", "Q", 9.0);
    for (index, part) in [Part::native(), as_halves, with_more_in_a_half].into_iter().enumerate() {
        let input = write(folder.path(), &format!("in_{index}.exr"), vec![part]);
        let (whole, mut taken) = (read(&input), read(&input));
        let expected = whole.to_frame().unwrap().0;
        assert_alike(&taken.take_frame().unwrap().0, &expected);

        let (color, halves) = (rgb(50.0), [("halfA".to_owned(), rgb(51.0)), ("halfB".to_owned(), rgb(52.0))]);
        let replaced = if index == 2 { &halves[1..] } else { &halves[..] };
        let layers =
            DenoisedLayers { replacements: replaced, dropped: &["variance".to_owned()], ..replace_color(&color) };
        let outputs = ["whole", "taken"].map(|name| folder.path().join(format!("{name}_{index}.exr")));
        for (set, output) in [whole, taken].into_iter().zip(&outputs) {
            write_denoised(set, output, &layers).unwrap();
        }
        assert_eq!(std::fs::read(&outputs[0]).unwrap(), std::fs::read(&outputs[1]).unwrap());
    }
}

#[test]
fn halves_that_a_frame_has_no_use_for_are_written_as_they_were() {
    let without_variance = |part: Part| {
        let channels = part.channels.into_iter().filter(|(name, _)| !name.starts_with("variance."));
        Part { channels: channels.collect(), ..part }
    };
    for part in [Part::native(), without_variance(Part::native())] {
        written_with_an_empty_half(part);
    }
}

fn written_with_an_empty_half(mut part: Part) {
    let folder = folder();
    for (name, samples) in &mut part.channels {
        if name.starts_with("halfB.") {
            *samples = FlatSamples::F32(vec![0.0; PIXELS]);
        }
    }
    let input = write(folder.path(), "in.exr", vec![part]);
    let mut set = read(&input);
    assert!(set.take_frame().unwrap().0.color().half_spread.is_none());
    let output = folder.path().join("out.exr");
    write_denoised(set, &output, &replace_color_without_variance(&rgb(50.0))).unwrap();
    for channel in ["halfA.R", "halfA.B", "halfB.G", "normal.X"] {
        assert_eq!(stored(&output, channel), stored(&input, channel), "{channel}");
    }
}

#[test]
fn samples_that_are_gone_are_not_written_as_if_they_were_there() {
    let folder = folder();
    let mut set = read(&write(folder.path(), "in.exr", vec![Part::native()]));
    set.take_frame().unwrap();
    let output = folder.path().join("out.exr");
    let refused = write_denoised(set, &output, &replace_color_without_variance(&rgb(50.0))).unwrap_err().to_string();
    assert!(refused.contains("out.exr") && refused.contains("not in memory any more"), "{refused}");
    assert!(!output.exists());
}

fn replace_color_without_variance(color: &Planes) -> DenoisedLayers<'_> {
    static VARIANCE: std::sync::LazyLock<Vec<String>> = std::sync::LazyLock::new(|| vec!["variance".to_owned()]);
    DenoisedLayers { dropped: &VARIANCE, ..replace_color(color) }
}
