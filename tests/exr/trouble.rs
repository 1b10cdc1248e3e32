//! Files and requests that cannot be served: the message names the file or the option, and a remedy.

use stein::error::Remedy;
use stein::frame::NoiseKnowledge;
use stein_exr::{BufferSet, BufferSetRequest, LayerRef};

use super::*;

#[test]
fn a_feature_of_other_pixels_names_its_file_and_both_windows() {
    let folder = folder();
    let input = write(folder.path(), "in.exr", vec![Part::native()]);
    let small = Part { size: (4, 3), position: (50, 0), ..Part::new() }.with("", "RGB", 1.0);
    let file = write(folder.path(), "small.exr", vec![small]);
    let features = vec![("albedo".to_owned(), LayerRef { file, layer: None })];
    let message = failure(&BufferSetRequest { features, ..request(&input) });
    for part in ["small.exr", "4×3", "5×3", "remedy"] {
        assert!(message.contains(part), "{message}");
    }
}

#[test]
fn a_feature_to_skip_that_the_input_lacks_is_named_with_those_that_it_has() {
    let folder = folder();
    let input = write(
        folder.path(),
        "in.exr",
        vec![Part::new().with("v.Combined", "RGB", 1.0).with("v.albedo", "RGB", 2.0).with("v.depth", "Z", 3.0)],
    );
    let skipping = |name: &str| BufferSetRequest { skip_features: vec![name.to_owned()], ..request(&input) };
    for (skipped, left) in [("albedo", "depth"), ("depth", "albedo"), ("v.depth", "albedo")] {
        let set = BufferSet::read(&skipping(skipped)).unwrap();
        assert_eq!(set.feature_names().collect::<Vec<_>>(), [left], "without {skipped}");
    }
    let error = BufferSet::read(&skipping("albdo")).map(drop).unwrap_err();
    for part in ["in.exr", "'albdo'", "'v.albedo'"] {
        assert!(error.to_string().contains(part), "{error}");
    }
    assert_eq!(error.remedies(), [Remedy::NameFeatureToSkip]);
    // If no feature is used, the name of a feature that does not exist is still an error.
    assert_eq!(
        BufferSet::read(&BufferSetRequest { no_features: true, ..skipping("depth") }).unwrap().feature_names().len(),
        0
    );
    assert!(failure(&BufferSetRequest { no_features: true, ..skipping("albdo") }).contains("'albdo'"));
}

#[test]
fn a_feature_of_two_view_layers_is_skipped_in_both_or_by_its_whole_name() {
    let folder = folder();
    let view = |part: Part, name: &str| {
        part.with(&format!("{name}.Combined"), "RGB", 1.0).with(&format!("{name}.albedo"), "RGB", 2.0).with(
            &format!("{name}.depth"),
            "Z",
            3.0,
        )
    };
    let input = write(folder.path(), "in.exr", vec![view(view(Part::new(), "near"), "far")]);
    let left = |skipped: &str| {
        let request = BufferSetRequest {
            layer: Some("near.Combined".to_owned()),
            skip_features: vec![skipped.to_owned()],
            ..request(&input)
        };
        let set = BufferSet::read(&request).unwrap();
        let mut names: Vec<String> = set.feature_names().map(str::to_owned).collect();
        names.sort_unstable();
        names
    };
    // Features come from the view layer of the colour alone.
    assert_eq!(left("albedo"), ["depth"]);
    assert_eq!(left("near.albedo"), ["depth"]);
    assert_eq!(left("far.albedo"), ["albedo", "depth"]);
}

#[test]
fn what_is_there_but_no_feature_cannot_be_skipped() {
    let folder = folder();
    let part = Part::new()
        .with("view.Combined", "RGB", 1.0)
        .with("view.albedo", "RGB", 2.0)
        .with("view.albedo_halfA", "RGB", 2.0)
        .with("view.albedo_halfB", "RGB", 2.0);
    let input = write(folder.path(), "in.exr", vec![part]);
    for name in ["albedo_halfA", "view.albedo_halfB", "Combined", "view.Combined", "lbedo", ""] {
        let message = failure(&BufferSetRequest { skip_features: vec![name.to_owned()], ..request(&input) });
        assert!(message.contains(&format!("there is no feature '{name}' to skip")), "{message}");
    }
}

#[test]
fn one_half_alone_is_an_error() {
    let folder = folder();
    let part = Part::new().with("", "RGB", 1.0).with("halfB", "RGB", 2.0);
    let error = BufferSet::read(&request(&write(folder.path(), "in.exr", vec![part]))).map(drop).unwrap_err();
    assert!(error.to_string().contains("half A is missing"), "{error}");
    assert_eq!(error.remedies(), [Remedy::GiveOtherHalf { half: 'A' }]);
}

#[test]
fn what_is_optional_and_cannot_be_used_is_left_out_and_named() {
    let folder = folder();
    let colour = || Part::new().with("", "RGB", 1.0).with("halfA", "RGB", 2.0).with("halfB", "RGB", 3.0);
    let features = colour()
        .with("albedo", "RGB", 4.0)
        .with("albedo_halfA", "RGB", 5.0)
        .with("normal", "XYZ", 6.0)
        .with("normal_variance", "Q", 7.0);
    let with_variance = Part::new().with("", "RGB", 1.0).with("halfB", "RGB", 2.0).with("variance", "RGB", 3.0);
    let odd_variance = colour().with("variance", "PQ", 4.0);
    let cases: [(Part, &[(&str, &str)]); 3] = [
        (features, &[("albedo_halfA", "half B is missing"), ("normal_variance", "do not match")]),
        (with_variance, &[("halfB", "half A is missing")]),
        (odd_variance, &[("variance", "do not match")]),
    ];
    for (part, left_out) in cases {
        let set = read(&write(folder.path(), "in.exr", vec![part]));
        for (layer, problem) in left_out {
            let found = set.layer_uses().iter().find(|found| found.layer == *layer).unwrap();
            assert!(
                found.role == Role::Untouched && found.note.as_ref().is_some_and(|note| note.contains(problem)),
                "{found:?}"
            );
        }
        assert!(set.to_frame().is_ok());
    }
    // A half that was requested by name needs the other half, even beside a variance.
    let part = Part::new().with("", "RGB", 1.0).with("first", "RGB", 2.0).with("variance", "RGB", 3.0);
    let input = write(folder.path(), "named.exr", vec![part]);
    let half_a = Some(LayerRef { file: input.clone(), layer: Some("first".into()) });
    let message = failure(&BufferSetRequest { half_a, ..request(&input) });
    assert!(message.contains("half B is missing"), "{message}");
}

#[test]
fn the_input_given_as_its_own_variance_asks_for_a_layer() {
    let folder = folder();
    let input = write(folder.path(), "in.exr", vec![Part::native()]);
    let variance = Some(LayerRef { file: input.clone(), layer: None });
    let message = failure(&BufferSetRequest { variance, ..request(&input) });
    assert!(message.contains("FILE::LAYER"), "{message}");
}

#[test]
fn neither_halves_nor_variance_explains_the_ways_out() {
    let folder = folder();
    let set = read(&write(folder.path(), "in.exr", vec![Part::new().with("", "RGB", 1.0)]));
    let (frame, repairs) = set.to_frame().unwrap();
    assert_eq!(frame.noise_knowledge(), NoiseKnowledge::ImageOnly);
    let error = frame.require_noise(&repairs).unwrap_err();
    assert_eq!(error.remedies(), [Remedy::GiveHalves, Remedy::GiveVariance]);
}

#[test]
fn a_truncated_file_names_itself() {
    let folder = folder();
    let input = write(folder.path(), "in.exr", vec![Part::native()]);
    let whole = std::fs::read(&input).unwrap();
    for length in (1..whole.len()).step_by(37).chain([whole.len() - 1]) {
        std::fs::write(&input, &whole[..length]).unwrap();
        let message = failure(&request(&input));
        assert!(message.contains("in.exr") && message.contains("remedy"), "at {length}: {message}");
    }
}

#[test]
fn flipped_bytes_never_panic() {
    let folder = folder();
    for compression in [Compression::ZIP16, Compression::PIZ, Compression::Uncompressed, Compression::DWAA(None)] {
        let input = write(folder.path(), "in.exr", vec![Part { compression, ..Part::native() }]);
        let whole = std::fs::read(&input).unwrap();
        for at in (4..whole.len()).step_by(11) {
            for value in [0, 0x7f, 0xff] {
                let mut bytes = whole.clone();
                bytes[at] = value;
                std::fs::write(&input, &bytes).unwrap();
                // Many of these files are still readable; the errors of the others must name the file.
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
    let behind =
        |marker: &[u8]| whole.windows(marker.len()).position(|window| window == marker).unwrap() + marker.len();
    let spoilt = |changes: &[(usize, u8)]| {
        let mut bytes = whole.clone();
        changes.iter().for_each(|(at, value)| bytes[*at] = *value);
        std::fs::write(&input, &bytes).unwrap();
        failure(&request(&input))
    };
    let compression = behind(b"compression\0compression\0\x01\0\0\0");
    for (number, name) in [(10, "HTJ2K"), (11, "HTJ2K"), (12, "ZSTD"), (99, "99")] {
        let message = spoilt(&[(compression, number)]);
        assert!(message.contains(name) && message.contains("ZIP"), "{message}");
    }
    let deep = spoilt(&[(5, whole[5] | 0x08)]);
    assert!(deep.contains("deep data") && deep.contains("out of scope") && deep.contains("flatten it"), "{deep}");
    // The name of a channel is followed by its type, its linearity, and its sampling in x and y.
    let sampling = behind(b"\0R\0\x02\0\0\0") + 4;
    let message = spoilt(&[(sampling, 5), (sampling + 4, 3)]);
    assert!(message.contains("subsampled"), "{message}");
}
