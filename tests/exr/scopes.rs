//! Pictures of one file: view layers, views and parts; and windows that differ.

use stein_exr::{LayerRef, SignalPart};

use super::*;

/// A view layer whose colour starts at `start`, and its albedo just above.
fn view_layer(part: Part, name: &str, start: f32) -> Part {
    part.with(&format!("{name}.Combined"), "RGBA", start).with(&format!("{name}.albedo"), "RGB", start + 1.0)
}

#[test]
fn every_view_layer_is_a_picture_with_its_own_features() {
    let folder = folder();
    let part = view_layer(view_layer(Part::new(), "near", 1.0), "far", 5.0).with("Composite.Combined", "RGBA", 9.0);
    let part = part.attribute("BlenderMultiChannel", AttributeValue::Text("Blender".into()));
    let input = write(folder.path(), "in.exr", vec![part]);
    let mut set = read(&input);
    assert_eq!(set.pictures().collect::<Vec<_>>(), ["far.Combined", "near.Combined"]);
    assert_eq!(role(&set, "Composite.Combined"), Role::Untouched);
    for name in ["far.albedo", "near.albedo"] {
        assert_eq!(role(&set, name), Role::Feature("albedo".into(), SignalPart::Mean));
    }
    let frames = set.take_frames().unwrap();
    let first = |index: usize| frames[index].0.color().mean.planes[0][0];
    assert_eq!((first(0), first(1)), (5.0, 1.0));
    // A named layer is the only picture.
    let set = BufferSet::read(&BufferSetRequest { layer: Some("near.Combined".into()), ..request(&input) }).unwrap();
    assert_eq!((set.pictures().collect::<Vec<_>>(), set.color().mean), (vec!["near.Combined"], rgb(1.0)));
    let mut named = request(&input);
    named.half_a = Some(LayerRef { file: input.clone(), layer: Some("far.Combined".into()) });
    named.half_b.clone_from(&named.half_a);
    assert!(failure(&named).contains("holds 2 pictures"));
}

#[test]
fn the_picture_after_compositing_is_denoised_if_there_is_no_other() {
    let folder = folder();
    let part = Part::new()
        .with("Composite.Combined", "RGBA", 9.0)
        .attribute("BlenderMultiChannel", AttributeValue::Text("Blender".into()));
    let set = read(&write(folder.path(), "in.exr", vec![part]));
    assert_eq!(set.pictures().collect::<Vec<_>>(), ["Composite.Combined"]);
}

#[test]
fn both_eyes_are_pictures_wherever_the_view_stands_in_the_name() {
    let folder = folder();
    for [left, right] in [["", "right"], ["Combined.left", "Combined.right"], ["left.Combined", "right.Combined"]] {
        let feature =
            |colour: &str| if colour.is_empty() { "depth".into() } else { colour.replace("Combined", "depth") };
        let right_feature = if right == "right" { "right.depth".to_owned() } else { feature(right) };
        let part = Part::new().with(left, "RGB", 1.0).with(&feature(left), "Z", 2.0).with(right, "RGB", 5.0).with(
            &right_feature,
            "Z",
            6.0,
        );
        let mut image = image_of(vec![part], IntegerBounds::from_dimensions(SIZE));
        image.layer_data[0].attributes.multi_view_names = Some(vec!["left".into(), "right".into()]);
        let input = folder.path().join("in.exr");
        image.write().to_file(&input).unwrap();
        let mut set = read(&input);
        assert_eq!(set.pictures().collect::<Vec<_>>(), [left, right]);
        let frames = set.take_frames().unwrap();
        assert!(frames.iter().all(|(frame, _)| frame.features().len() == 1), "{left}");
        let output = folder.path().join("out.exr");
        write_denoised(read(&input), &output, &replace_color(&rgb(50.0))).unwrap();
        assert_eq!(read(&output).color().mean, rgb(50.0));
    }
}

#[test]
fn parts_with_the_same_layers_are_pictures_of_their_own() {
    let folder = folder();
    let part = |name, start: f32| Part::named(name).with("", "RGB", start).with("albedo", "RGB", start + 1.0);
    let set = read(&write(folder.path(), "in.exr", vec![part("one", 1.0), part("two", 5.0)]));
    assert_eq!(set.pictures().collect::<Vec<_>>(), ["one", "two"]);
    let set = read(&write(folder.path(), "in.exr", vec![part("rgba", 1.0), part("rgba", 5.0)]));
    let names: Vec<_> = set.pictures().collect();
    assert_eq!(names.len(), 2);
    assert_ne!(names[0], names[1]);
    let mut request = request(set.input());
    request.layer = Some(names[1].to_owned());
    let second = BufferSet::read(&request).unwrap();
    assert_eq!((second.color().mean, second.features().next().unwrap().1.mean), (rgb(5.0), rgb(6.0)));
}

#[test]
fn a_cropped_feature_is_padded_with_misses_and_a_larger_one_is_cropped() {
    let folder = folder();
    let depth = Part { position: (1, 1), size: (3, 2), ..Part::named("depth") }.with("depth", "Z", 1.0);
    let albedo = Part { position: (-2, -1), size: (9, 6), ..Part::named("albedo") }.with("albedo", "RGB", 0.0);
    let input = write(folder.path(), "in.exr", vec![Part::named("rgba").with("", "RGB", 1.0), depth, albedo]);
    let set = read(&input);
    let features: Vec<_> = set.features().map(|(name, raw)| (name.to_owned(), raw.mean)).collect();
    let inf = f32::INFINITY;
    let padded = vec![inf, inf, inf, inf, inf, inf, 1.0, 2.0, 3.0, inf, inf, 4.0, 5.0, 6.0, inf];
    assert_eq!(features[0], ("depth".into(), Planes { planes: vec![padded], ..rgb(0.0) }));
    let cropped: Vec<f32> = (1..4).flat_map(|row| (2..7).map(move |column| (9 * row + column) as f32)).collect();
    assert_eq!(features[1].1.planes[0], cropped);
    // Each part keeps its window.
    let output = folder.path().join("out.exr");
    write_denoised(set, &output, &replace_color(&rgb(50.0))).unwrap();
    let windows = |path: &Path| {
        let parts = read_all_flat_layers_from_file(path).unwrap().layer_data;
        parts.iter().map(|part| (part.attributes.layer_position, part.size)).collect::<Vec<_>>()
    };
    assert_eq!(windows(&output), windows(&input));
}

#[test]
fn parts_that_are_views_may_have_any_name() {
    let folder = folder();
    let mut image = image_of(
        vec![Part::named("l").with("", "RGB", 1.0), Part::named("r").with("", "RGB", 5.0)],
        IntegerBounds::from_dimensions(SIZE),
    );
    image.layer_data[0].attributes.view_name = Some("left".into());
    image.layer_data[1].attributes.view_name = Some("right".into());
    let input = folder.path().join("in.exr");
    image.write().to_file(&input).unwrap();
    assert_eq!(read(&input).pictures().collect::<Vec<_>>(), ["l", "r"]);
}

#[test]
fn another_resolution_is_no_crop() {
    let folder = folder();
    let input = write(folder.path(), "in.exr", vec![Part::new().with("", "RGB", 1.0)]);
    let large = Part { size: (10, 6), ..Part::new() }.with("", "RGB", 2.0);
    let file = LayerRef::whole(write(folder.path(), "large.exr", vec![large]));
    let features = vec![("albedo".to_owned(), file.clone())];
    for message in [
        failure(&BufferSetRequest { features, ..request(&input) }),
        read(&input).read_reference(0, &file).unwrap_err().to_string(),
        failure(&BufferSetRequest { seeds: vec![file.file.clone()], ..request(&input) }),
    ] {
        for words in ["large.exr", "another resolution", "10×6", "5×3"] {
            assert!(message.contains(words), "{message}");
        }
    }
}

#[test]
fn halves_elsewhere_are_refused_with_both_windows() {
    let folder = folder();
    let input = write(folder.path(), "in.exr", vec![Part { position: (-17, -9), ..Part::new() }.with("", "RGB", 1.0)]);
    let half = |name: &str, position: (i32, i32)| {
        LayerRef::whole(write(folder.path(), name, vec![Part { position, ..Part::new() }.with("", "RGB", 2.0)]))
    };
    for position in [(0, 0), (-16, -9)] {
        let (half_a, half_b) = (Some(half("a.exr", position)), Some(half("b.exr", position)));
        let message = failure(&BufferSetRequest { half_a, half_b, ..request(&input) });
        for words in ["a.exr", "(-17, -9)", &format!("({}, {})", position.0, position.1)] {
            assert!(message.contains(words), "{message}");
        }
    }
    let (half_a, half_b) = (Some(half("a.exr", (-17, -9))), Some(half("b.exr", (-17, -9))));
    let set = BufferSet::read(&BufferSetRequest { half_a, half_b, ..request(&input) }).unwrap();
    assert_eq!(set.color().half_a, Some(rgb(2.0)));
    assert!(set.read_reference(0, &half("ref.exr", (3, 3))).is_err());
}
