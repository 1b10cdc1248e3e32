//! Renders of one frame with different seeds, merged into one.

use stein::frame::{SamplesPerPixel, half_spread};

use super::*;

/// A render of some samples: colour and albedo with noise of its own, an id and a light.
fn render(seed: f32, samples: i32) -> Part {
    Part::new()
        .with("", "RGBA", seed)
        .with("albedo", "RGB", 2.0 * seed)
        .with("diffuse", "RGB", 3.0 * seed)
        .with("CryptoObject00", "RGBA", 4.0 * seed)
        .attribute("samples", AttributeValue::I32(samples))
}

fn merged(folder: &Path, parts: Vec<Part>) -> stein::Result<BufferSet> {
    let mut files: Vec<PathBuf> =
        parts.into_iter().enumerate().map(|(index, part)| write(folder, &format!("{index}.exr"), vec![part])).collect();
    let input = files.remove(0);
    BufferSet::read(&BufferSetRequest { seeds: files, ..request(&input) })
}

fn close(found: &Planes, expected: &Planes) -> bool {
    let values = found.planes.iter().flatten().zip(expected.planes.iter().flatten());
    found.extent == expected.extent
        && values.into_iter().all(|(found, expected)| (found - expected).abs() <= 1e-5 * expected.abs() + 1e-5)
}

#[test]
fn two_seeds_give_their_mean_and_their_halves() {
    let folder = folder();
    let set = merged(folder.path(), vec![render(1.0, 8), render(3.0, 8)]).unwrap();
    let color = set.color();
    assert_eq!((color.mean, color.half_a, color.half_b), (rgb(2.0), Some(rgb(1.0)), Some(rgb(3.0))));
    let (name, albedo) = set.features().next().unwrap();
    assert_eq!((name, albedo.mean, albedo.half_a, albedo.half_b), ("albedo", rgb(4.0), Some(rgb(2.0)), Some(rgb(6.0))));
    assert_eq!(set.samples_per_pixel(), SamplesPerPixel::Uniform(16.0));

    let input = set.input().to_owned();
    let output = folder.path().join("out.exr");
    write_denoised(set, &output, &replace_color(&rgb(50.0))).unwrap();
    // Lights and alpha are means of the seeds; numbers of objects have none.
    assert_eq!(stored(&output, "diffuse.R"), FlatSamples::F32(ramp(6.0, PIXELS)));
    assert_eq!(stored(&output, "A"), FlatSamples::F32(ramp(302.0, PIXELS)));
    assert_eq!(stored(&output, "CryptoObject00.R"), stored(&input, "CryptoObject00.R"));
}

#[test]
fn unequal_seeds_are_weighted_and_their_halves_are_uncorrelated_with_the_mean() {
    let folder = folder();
    let set = merged(folder.path(), vec![render(1.0, 8), render(3.0, 24)]).unwrap();
    let color = set.color();
    assert!(close(&color.mean, &rgb(2.5)), "{:?}", color.mean);
    assert_eq!(set.samples_per_pixel(), SamplesPerPixel::Uniform(32.0));
    // The frame takes halves as equal ones.
    let spread = half_spread(color.half_a.as_ref().unwrap(), color.half_b.as_ref().unwrap(), 1.0, 1.0);
    assert!(close(&spread, &half_spread(&rgb(1.0), &rgb(3.0), 8.0, 24.0)), "{spread:?}");
}

#[test]
fn three_seeds_share_out_to_both_halves_and_counts_of_pixels_add_up() {
    let folder = folder();
    let counted = |seed: f32, count: f32| {
        let mut part = render(seed, 1);
        part.channels.push(("sampleCount".into(), FlatSamples::F32(vec![count; PIXELS])));
        part
    };
    let set = merged(folder.path(), vec![counted(1.0, 4.0), counted(2.0, 2.0), counted(5.0, 2.0)]).unwrap();
    assert_eq!(
        set.samples_per_pixel(),
        SamplesPerPixel::PerPixel(Planes { planes: vec![vec![8.0; PIXELS]], ..single(0.0) })
    );
    let color = set.color();
    // (4·1 + 2·2 + 2·5)/8; half A is the first seed alone, half B the mean of the two others.
    assert!(close(&color.mean, &rgb(2.25)), "{:?}", color.mean);
    assert!(close(&color.half_b.unwrap(), &rgb(3.5)));
}

#[test]
fn variances_are_those_of_the_merged_mean() {
    let folder = folder();
    let with_variance = |variance: f32| render(1.0 + variance, 8).with("variance", "RGB", variance);
    let set = merged(folder.path(), vec![with_variance(4.0), with_variance(8.0)]).unwrap();
    // (4 + 8)/4, and the ramp in both.
    let expected: Vec<f32> = ramp(0.0, PIXELS).iter().map(|value| (12.0 + 2.0 * value) / 4.0).collect();
    assert_eq!(set.color().variance_of_mean.unwrap().planes[0], expected);
    let moments = |mean: f32, moment: f32| {
        Part::new()
            .with("", "RGB", mean)
            .with("nested.img", "RGBA", mean)
            .with("m2_nested.img", "RGBA", moment)
            .attribute("generatedBy", AttributeValue::Text("Mitsuba version 3.9.1".into()))
    };
    let first = write(folder.path(), "m1.exr", vec![moments(1.0, 90_000.0)]);
    let second = write(folder.path(), "m2.exr", vec![moments(2.0, 90_000.0)]);
    let set = BufferSet::read(&BufferSetRequest { seeds: vec![second], samples: Some(8), ..request(&first) }).unwrap();
    let variance = set.color().variance_of_mean.unwrap().planes[0][0];
    assert!((variance - (90_000.0 - 1.5 * 1.5) / 15.0).abs() < 0.01, "{variance}");
}

#[test]
fn files_that_are_no_seeds_of_one_frame_are_refused() {
    let folder = folder();
    let fails = |parts: Vec<Part>, words: &[&str]| {
        let message = merged(folder.path(), parts).map(drop).unwrap_err().to_string();
        for word in words {
            assert!(message.contains(word), "{word}: {message}");
        }
    };
    fails(vec![render(1.0, 8), render(1.0, 8)], &["1.exr", "the same pixels"]);
    let shifted = Part { position: (1, 0), ..render(2.0, 8) };
    fails(vec![render(1.0, 8), shifted], &["1.exr", "(1, 0)", "0.exr"]);
    let frame = |seed: f32, frame: &str| render(seed, 8).attribute("Frame", AttributeValue::Text(frame.into()));
    fails(vec![frame(1.0, "001"), frame(2.0, "002")], &["Frame", "'002'", "'001'"]);
    fails(vec![render(1.0, 8), Part::new().with("depth", "Z", 1.0)], &["1.exr", "R G B", "no such layer"]);
    // A feature that one seed lacks has no halves, and that is said.
    let set = merged(folder.path(), vec![render(1.0, 8), Part::new().with("", "RGBA", 2.0)]).unwrap();
    assert_eq!(set.features().next().unwrap().1.half_a, None);
    for layer in ["albedo", "diffuse"] {
        let is_said = |note: &String| note.contains(layer) && note.contains("of the input alone");
        assert!(set.notes().iter().any(is_said), "{:?}", set.notes());
    }
}

#[test]
fn values_that_are_not_finite_leave_the_pixel_to_the_other_seeds() {
    let folder = folder();
    let mut damaged = render(3.0, 8);
    for (name, samples) in &mut damaged.channels {
        if let ("R", FlatSamples::F32(values)) = (name.as_str(), samples) {
            values[7] = f32::NAN;
        }
    }
    let set = merged(folder.path(), vec![render(1.0, 8), damaged]).unwrap();
    let color = set.color();
    assert_eq!((color.mean.planes[0][7], color.mean.planes[0][6]), (rgb(1.0).planes[0][7], rgb(2.0).planes[0][6]));
    assert!(color.half_a.unwrap().planes[0][7].is_finite() && color.half_b.unwrap().planes[0][7].is_finite());
    assert!(set.notes().iter().any(|note| note.contains("1 values of the colour are not finite")), "{:?}", set.notes());
    let nothing = Part::new().with("", "RGBA", f32::NAN);
    let message = merged(folder.path(), vec![render(1.0, 8), nothing]).map(drop).unwrap_err().to_string();
    assert!(message.contains("1.exr") && message.contains("usable value"), "{message}");
}

#[test]
fn files_beside_seeds_are_merged_with_the_same_files_beside_the_input() {
    let folder = folder();
    let one = |name: &str, suffixes: &str, start: f32| {
        write(folder.path(), name, vec![Part::new().with("", suffixes, start)]);
    };
    for (set, start) in [("a_", 1.0), ("b_", 3.0)] {
        one(&format!("{set}color.exr"), "RGB", start);
        one(&format!("{set}colorVariance.exr"), "RGB", 10.0 * start);
        one(&format!("{set}albedo.exr"), "RGB", 20.0 * start);
        one(&format!("{set}albedoVariance.exr"), "RGB", 30.0 * start);
    }
    let at = |name: &str| folder.path().join(name);
    let seeds = || BufferSetRequest { seeds: vec![at("b_color.exr")], samples: Some(8), ..request(&at("a_color.exr")) };
    let set = BufferSet::read(&seeds()).unwrap();
    let quarter = |sum: f32| (sum + 2.0 * 7.0) / 4.0;
    assert_eq!(set.color().variance_of_mean.unwrap().planes[0][7], quarter(40.0));
    let (_, albedo) = set.features().next().unwrap();
    assert_eq!(albedo.mean, rgb(40.0));
    assert_eq!(albedo.variance_of_mean.unwrap().planes[0][7], quarter(120.0));
    assert!(albedo.half_a.is_some());
    for name in ["a_albedo.exr", "b_albedo.exr", "b_albedoVariance.exr"] {
        assert!(set.files().any(|file| file == at(name)), "{name}");
    }
    // Without the variance of one seed there is none, and that is said.
    std::fs::remove_file(at("b_albedoVariance.exr")).unwrap();
    let set = BufferSet::read(&seeds()).unwrap();
    assert!(set.color().variance_of_mean.is_some());
    assert_eq!(set.features().next().unwrap().1.variance_of_mean, None);
    assert!(set.notes().iter().any(|note| note.contains("feature albedo") && note.contains("lacks its variance")));
}

#[test]
fn cropped_layers_are_weighted_by_the_counts_of_their_own_pixels() {
    let folder = folder();
    let parts = |name: &str, start: f32, count: f32| {
        let mut colour = Part::named("rgba").with("", "RGB", start);
        let mut counts = vec![1.0; PIXELS];
        counts[SIZE.0 + 1] = count;
        colour.channels.push(("sampleCount".into(), FlatSamples::F32(counts)));
        let depth = Part { position: (1, 1), size: (3, 2), ..Part::named("depth") }.with("depth", "Z", start);
        write(folder.path(), name, vec![colour, depth])
    };
    let (first, second) = (parts("1.exr", 10.0, 3.0), parts("2.exr", 20.0, 1.0));
    let set = BufferSet::read(&BufferSetRequest { seeds: vec![second], ..request(&first) }).unwrap();
    let (_, depth) = set.features().next().unwrap();
    // (3·10 + 20)/4 in the first pixel of the crop, and (11 + 21)/2 in the next.
    assert_eq!(depth.mean.planes[0][SIZE.0 + 1..SIZE.0 + 3], [12.5, 16.0]);
}

#[test]
fn half_floats_stay_half_floats() {
    let folder = folder();
    let half = |seed: f32| {
        let mut part = render(seed, 8);
        for (_, samples) in &mut part.channels {
            let FlatSamples::F32(values) = samples else { unreachable!() };
            *samples = FlatSamples::F16(values.iter().map(|&value| f16::from_f32(value)).collect());
        }
        part
    };
    let set = merged(folder.path(), vec![half(1.0), half(3.0)]).unwrap();
    let output = folder.path().join("out.exr");
    write_denoised(set, &output, &replace_color(&rgb(50.0))).unwrap();
    for channel in ["R", "A", "diffuse.R", "albedo.R"] {
        assert!(matches!(stored(&output, channel), FlatSamples::F16(_)), "{channel}");
    }
}
