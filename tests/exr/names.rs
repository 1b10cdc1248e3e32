//! Names of layers, channels and attributes: any bytes, up to the length that the format allows.

use std::fs;

use stein_exr::{LayerRef, NamedLayer, write_denoised, write_layers};

use super::*;

/// Returns the text whose Latin-1 bytes are the UTF-8 bytes of `name`: the encoder of the tests turns it into those
/// bytes.
fn as_utf8(name: &str) -> String {
    name.bytes().map(char::from).collect()
}

/// Returns the stored bytes of all channel names.
fn stored_names(path: &Path) -> Vec<Vec<u8>> {
    let image = read_all_flat_layers_from_file(path).unwrap();
    let channels = image.layer_data.iter().flat_map(|part| part.channel_data.list.iter());
    channels.map(|channel| channel.name.as_slice().to_vec()).collect()
}

/// Whether the file has the flag for long names.
fn has_flag(path: &Path) -> bool {
    fs::read(path).unwrap()[5] & 0x04 != 0
}

fn with_extra<'a>(color: &'a Planes, extra: &'a [NamedLayer]) -> DenoisedLayers<'a> {
    DenoisedLayers { extra, ..replace_color(color) }
}

#[test]
fn names_in_utf8_and_latin_1_are_read_found_and_kept_to_the_byte() {
    let folder = folder();
    let part = Part::new()
        .with(&as_utf8("Größe.Combined"), "RGB", 1.0)
        .with(&as_utf8("Größe.halfA"), "RGB", 2.0)
        .with(&as_utf8("Größe.halfB"), "RGB", 3.0)
        .with(&as_utf8("Größe.normal"), "XYZ", 4.0)
        .with(&as_utf8("深度"), "Z", 5.0)
        // Valid Latin-1, but not UTF-8.
        .with("Stra\u{df}e", "RGB", 6.0);
    let input = write(folder.path(), "in.exr", vec![part]);
    let set = read(&input);
    assert_eq!((set.color_layer(), set.color().half_a), ("Größe.Combined", Some(rgb(2.0))));
    assert_eq!(set.feature_names().collect::<Vec<_>>(), ["normal"]);
    for layer in ["深度", "Straße"] {
        assert_eq!(role(&set, layer), Role::Untouched);
    }
    let own = |layer: &str| LayerRef { file: input.clone(), layer: Some(layer.to_owned()) };
    let asked = BufferSetRequest {
        layer: Some("Straße".into()),
        half_a: Some(own("Größe.halfA")),
        half_b: Some(own("Größe.halfB")),
        features: vec![("tiefe".into(), own("深度"))],
        skip_features: vec!["Größe.normal".into()],
        ..request(&input)
    };
    let found = BufferSet::read(&asked).unwrap();
    assert_eq!((found.color().mean, found.feature_names().collect::<Vec<_>>()), (rgb(6.0), vec!["tiefe"]));

    let output = folder.path().join("out.exr");
    let extra = [NamedLayer { name: "stein.Größe".into(), channels: vec!["V".into()], image: single(0.5) }];
    write_denoised(set, &output, &with_extra(&rgb(50.0), &extra)).unwrap();
    let mut expected = stored_names(&input);
    expected.push("stein.Größe.V".as_bytes().to_vec());
    expected.sort();
    assert_eq!(stored_names(&output), expected);
    assert_eq!(role(&read(&output), "stein.Größe"), Role::Untouched);
}

#[test]
fn layers_whose_names_differ_by_their_encoding_alone_are_two() {
    let folder = folder();
    let part = Part::native().with(&as_utf8("é"), "RGB", 20.0).with("é", "RGB", 30.0);
    let input = write(folder.path(), "in.exr", vec![part]);
    let set = read(&input);
    let twins: Vec<_> = set.layer_uses().iter().filter(|layer| layer.layer == "é").collect();
    assert_eq!((twins.len(), twins[0].channels.len()), (2, 3));
    let message = failure(&BufferSetRequest { layer: Some("é".into()), ..request(&input) });
    assert!(message.contains("'é' (R G B), 'é' (R G B)"), "{message}");
}

#[test]
fn names_of_up_to_255_bytes_are_kept_with_their_flag() {
    let folder = folder();
    let (color, output) = (rgb(50.0), folder.path().join("out.exr"));
    for (length, is_long) in [(20, false), (31, false), (32, true), (120, true), (255, true)] {
        let mut part = Part::native();
        part.channels.push((format!("{}.V", "x".repeat(length - 2)), FlatSamples::F32(ramp(9.0, PIXELS))));
        let input = write(folder.path(), "in.exr", vec![part]);
        let set = read(&input);
        write_denoised(set, &output, &replace_color(&color)).unwrap();
        assert_eq!((stored_names(&output), has_flag(&output)), (stored_names(&input), is_long), "{length}");
        read(&output);
        let layer = NamedLayer { name: String::new(), channels: vec!["y".repeat(length)], image: single(0.5) };
        write_layers(&output, std::slice::from_ref(&layer), &[]).unwrap();
        assert_eq!(has_flag(&output), is_long, "{length}");
    }
    let attributes = [("a".repeat(40), "text".to_owned())];
    let layer = NamedLayer { name: String::new(), channels: vec!["Y".into()], image: single(0.5) };
    write_layers(&output, &[layer], &attributes).unwrap();
    assert!(has_flag(&output));
}

#[test]
fn longer_names_are_refused_by_name_and_never_written() {
    let folder = folder();
    let (color, output) = (rgb(50.0), folder.path().join("out.exr"));
    let mut part = Part::native();
    part.channels.push((format!("{}.V", "x".repeat(254)), FlatSamples::F32(ramp(9.0, PIXELS))));
    let message = failure(&request(&write(folder.path(), "in.exr", vec![part])));
    for words in ["in.exr", "channel", "xxxx", "(256 bytes)", "255", "remedy: "] {
        assert!(message.contains(words), "{message}");
    }
    assert!(message.len() < 400, "{message}");

    // A layer whose name becomes too long by prefix and suffix.
    let set = read(&write(folder.path(), "in.exr", vec![Part::native()]));
    let long = NamedLayer {
        name: format!("stein.{}_prefiltered", "x".repeat(240)),
        channels: vec!["x".into()],
        image: single(0.5),
    };
    let short = NamedLayer { name: "stein.error".into(), channels: vec!["V".into()], image: single(0.5) };
    let report = write_denoised(set, &output, &with_extra(&color, &[long.clone(), short])).unwrap();
    assert_eq!(report.left_out, std::slice::from_ref(&long.name));
    assert!(report.to_string().contains("too long"), "{report}");
    let names = stored_names(&output);
    assert!(names.contains(&b"stein.error.V".to_vec()) && names.iter().all(|name| name.len() < 256));

    let message = write_layers(&output, &[long], &[]).unwrap_err().to_string();
    assert!(message.contains("255") && message.contains("remedy: "), "{message}");
    let layer = NamedLayer { name: "a\0b".into(), channels: vec!["V".into()], image: single(0.5) };
    let message = write_layers(&output, &[layer], &[]).unwrap_err().to_string();
    assert!(message.contains("a\\u{0}b"), "{message}");
}

#[test]
fn names_are_shown_without_what_a_terminal_would_obey() {
    let folder = folder();
    let part = Part::new().with("bad\u{1b}[31m\nname", "RGB", 1.0).with("other", "RGB", 2.0);
    let message = failure(&request(&write(folder.path(), "in\u{7}.exr", vec![part])));
    assert!(message.contains(r"in\u{7}.exr") && message.contains(r"'bad\u{1b}[31m\nname' (R G B)"), "{message}");
    assert!(message.chars().all(|character| character == '\n' || !character.is_control()), "{message:?}");
}

#[test]
fn thousands_of_layers_make_a_short_message() {
    let folder = folder();
    let mut part = Part::native();
    for index in 0..2000 {
        part.channels.push((format!("pass{index}.V"), FlatSamples::F32(ramp(1.0, PIXELS))));
    }
    let input = write(folder.path(), "in.exr", vec![part]);
    let message = failure(&BufferSetRequest { layer: Some("pass1777x".into()), ..request(&input) });
    assert!(
        message.contains("'pass1777' (V)") && message.contains(" and 1998 more"),
        "those first that are most like it: {message}"
    );
    assert!(message.len() < 1000, "{}", message.len());
    let message = failure(&BufferSetRequest { skip_features: vec!["pass".into()], ..request(&input) });
    assert!(message.contains(" more") && message.len() < 1000, "{}", message.len());
}

#[test]
fn what_is_not_replaced_keeps_every_bit() {
    let folder = folder();
    let bits: Vec<u32> = [0x7f80_0001, 0x7fc0_0123, 0xffff_ffff, 0x0000_02ca, 0x8000_0000, 0x0000_0001, 0x7f80_0000]
        .repeat(3)[..PIXELS]
        .to_vec();
    let mut part = Part::native();
    part.channels.push(("id.R".into(), FlatSamples::F32(bits.iter().map(|bits| f32::from_bits(*bits)).collect())));
    let halves: Vec<u16> = [0x7c01_u16, 0x7e55, 0xffff, 0x0001, 0x8000].repeat(3)[..PIXELS].to_vec();
    part.channels.push(("matte.A".into(), FlatSamples::F16(halves.iter().map(|bits| f16::from_bits(*bits)).collect())));
    let set = read(&write(folder.path(), "in.exr", vec![part]));
    let output = folder.path().join("out.exr");
    let report = write_denoised(set, &output, &replace_color(&rgb(50.0))).unwrap();
    assert_eq!(report.non_finite_values, 0, "what is not replaced is not looked at");
    let FlatSamples::F32(ids) = stored(&output, "id.R") else { panic!("another type") };
    assert_eq!(ids.iter().map(|id| id.to_bits()).collect::<Vec<_>>(), bits);
    let FlatSamples::F16(mattes) = stored(&output, "matte.A") else { panic!("another type") };
    assert_eq!(mattes.iter().map(|matte| matte.to_bits()).collect::<Vec<_>>(), halves);
}
