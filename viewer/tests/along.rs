//! Layers that are denoised along with the colour: two lights and an alpha, before and after.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

mod common;

use std::path::{Path, PathBuf};

use common::{settle, testdata, window};
use eframe::egui::Key;
use egui_kittest::Harness;
use egui_kittest::kittest::Queryable;
use stein::{Image, Preset};
use stein_exr::{Aovs, BufferSet, BufferSetRequest, NamedLayer, write_estimate, write_layers};
use stein_viewer::document::Source;
use stein_viewer::files::Purpose;
use stein_viewer::layer::{Group, Kind, Layer, Scale};
use stein_viewer::panel::Panel;
use stein_viewer::settings::Parameters;
use stein_viewer::view::Compare;
use stein_viewer::{Start, Viewer};

/// Returns a number from 0 to 1 for each pixel, without any order among neighbours.
fn noise(pixel: usize) -> f32 {
    ((pixel as u32).wrapping_mul(0x9e37_79b9).rotate_left(13).wrapping_mul(0x85eb_ca6b) >> 8) as f32 / (1 << 24) as f32
}

/// Writes a frame whose colour is the sum of the lights `key` and `fill`, with a noisy alpha and a layer `even`, whose
/// pixels are all equal.
fn write_frame(folder: &Path) -> PathBuf {
    let set = BufferSet::read(&BufferSetRequest { input: testdata("cornell_8spp.exr"), ..Default::default() }).unwrap();
    let color = set.color();
    let [half_a, half_b] = [color.half_a.unwrap(), color.half_b.unwrap()];
    let scaled = |image: &Image, factor: f32| {
        let planes = image.planes.iter().map(|plane| plane.iter().map(|value| value * factor).collect()).collect();
        Image { extent: image.extent, planes }
    };
    let alpha: Vec<f32> = (0..set.extent().pixels()).map(|pixel| (0.3 + noise(pixel)).min(1.0)).collect();
    let mut with_alpha = color.mean.clone();
    with_alpha.planes.push(alpha);
    let layer = |name: &str, channels: &str, image: Image| NamedLayer {
        name: name.into(),
        channels: channels.chars().map(String::from).collect(),
        image,
    };
    let layers = [
        layer("", "RGBA", with_alpha),
        layer("halfA", "RGB", half_a.clone()),
        layer("halfB", "RGB", half_b.clone()),
        layer("key", "RGB", scaled(&color.mean, 0.75)),
        layer("key_halfA", "RGB", scaled(&half_a, 0.75)),
        layer("key_halfB", "RGB", scaled(&half_b, 0.75)),
        layer("fill", "RGB", scaled(&color.mean, 0.25)),
        layer("even", "RGB", Image::filled(set.extent(), 3, 0.5)),
    ];
    let path = folder.join("lights.exr");
    write_layers(&path, &layers, &[]).unwrap();
    path
}

fn quick(method: &str) -> Parameters {
    let parameters = Parameters::of(method, Preset::Default).unwrap();
    Parameters { method: parameters.method.with_parameter("window_radius", 2).unwrap(), ..parameters }
}

fn layer<'a>(harness: &'a Harness<'static, Viewer>, name: &str) -> &'a Layer {
    harness.state().document.as_ref().unwrap().layer(name).unwrap()
}

/// Mean absolute difference of pixels that are side by side.
fn roughness(layer: &Layer) -> f32 {
    let plane = &layer.image().planes[0];
    plane.windows(2).map(|pair| (pair[0] - pair[1]).abs()).sum::<f32>() / plane.len() as f32
}

#[test]
fn lights_and_alpha_are_shown_before_and_after_and_saved() {
    let folder = tempfile::tempdir().unwrap();
    let input = write_frame(folder.path());
    let aovs = Aovs::Named(["key", "fill", "even"].map(String::from).into());
    let request = BufferSetRequest { input, aovs, ..Default::default() };
    let source = Some(Source { request: request.clone(), reference: None });
    let parameters = quick("dfc");
    let mut harness =
        window(Start { source, parameters: Some(parameters), panel: Panel::Report, ..Default::default() });
    assert!(harness.state().trouble.is_none(), "{:?}", harness.state().trouble);
    harness.get_by_label("layers denoised along: key,fill,even");
    let payload: Vec<String> = {
        let frame = &harness.state().document.as_ref().unwrap().opened.frame;
        frame.payload().iter().map(|layer| layer.name.clone()).collect()
    };
    harness.get_by_label(&format!("denoised along: {}", payload.join(", ")));

    // Before and after are side by side in the strip, and have the values of the library.
    let document = harness.state().document.as_ref().unwrap();
    let along: Vec<_> = document.layers().iter().filter(|layer| layer.description.group == Group::Along).collect();
    let expected = payload.iter().flat_map(|name| [format!("along.{name}"), format!("denoised.{name}")]);
    assert!(along.iter().map(|layer| layer.name()).eq(expected), "{payload:?}");
    let estimate = document.denoised.as_ref().unwrap().estimate.clone();
    for (pair, (before, after)) in along.chunks(2).zip(document.opened.frame.payload().iter().zip(&estimate.payload)) {
        assert!(*pair[0].image() == before.mean && *pair[1].image() == after.image, "{}", before.name);
        assert_eq!(pair[0].description.kind, pair[1].description.kind);
    }
    for name in ["key", "fill", "A"] {
        let [before, after] = ["along", "denoised"].map(|part| roughness(layer(&harness, &format!("{part}.{name}"))));
        assert!(after < 0.8 * before, "{name}: {before} {after}");
    }
    let even = layer(&harness, "denoised.even");
    assert_eq!(even.description.title, "even, left as it was");
    assert!(even.description.about.contains("all its pixels are equal"), "{}", even.description.about);
    assert_eq!(layer(&harness, "along.key").description.kind, Kind::Color);
    let alpha = layer(&harness, "denoised.A");
    assert_eq!(alpha.description.kind, Kind::Scalar(Scale::Linear));
    assert!(alpha.image().planes[0].iter().all(|alpha| (0.0..=1.0).contains(alpha)));
    let range = alpha.range;
    assert_eq!((range.low, range.high, range), (0.0, 1.0, layer(&harness, "along.A").range));

    // The strip selects a layer, a key its counterpart; a comparison takes that as layer B.
    harness.get_by_label("key").click();
    harness.run_steps(2);
    assert_eq!(harness.state().view.layer, "along.key");
    for shown in ["denoised.key", "along.key"] {
        harness.key_press(Key::C);
        harness.run_steps(2);
        assert_eq!(harness.state().view.layer, shown);
    }
    harness.key_press(Key::W);
    harness.run_steps(2);
    assert_eq!(
        (harness.state().view.compare, harness.state().view.other.as_deref()),
        (Compare::Wipe, Some("denoised.key"))
    );
    harness.render().unwrap();
    for (shown, other) in [("result", "noisy"), ("noisy", "result")] {
        harness.state_mut().view.layer = other.into();
        harness.key_press(Key::C);
        harness.run_steps(2);
        assert_eq!(harness.state().view.layer, shown);
    }
    harness.state_mut().view.pinned = Some([7, 21]);
    harness.state_mut().panel = Panel::Pixel;
    harness.run_steps(2);
    assert_eq!(harness.query_all_by_label("A, denoised").count(), 2, "in the strip and in the panel");

    // The files are those of the library.
    let context = harness.ctx.clone();
    for name in ["result.exr", "result.pfm", "result.png"] {
        let (own, expected) = (folder.path().join(name), folder.path().join(format!("library_{name}")));
        harness.state_mut().take_file(Purpose::SaveResult, own.clone(), &context);
        settle(&mut harness);
        harness.get_by_label_contains(&format!("Wrote {name}"));
        write_estimate(&estimate, BufferSet::read(&request).unwrap(), &expected, &[], &parameters.method).unwrap();
        assert!(std::fs::read(&own).unwrap() == std::fs::read(&expected).unwrap(), "{name}: other bytes");
        let set = BufferSet::read(&BufferSetRequest { input: own, ..Default::default() }).unwrap();
        assert!(set.payload(0).any(|(name, _)| name == "A"), "{name} has no alpha");
    }

    // NLM uses the halves of the layers. The file is not opened again.
    let spread = |viewer: &Viewer| {
        let frame = &viewer.document.as_ref().unwrap().opened.frame;
        let has_spread =
            |name: &str| frame.payload().iter().find(|layer| layer.name == name).unwrap().half_spread.is_some();
        ["key", "fill"].map(has_spread)
    };
    let before = layer(&harness, "denoised.key").image().clone();
    harness.state_mut().take_parameters(quick("nlm"));
    settle(&mut harness);
    assert_eq!(spread(harness.state()), [true, false]);
    assert!(*layer(&harness, "denoised.key").image() != before, "the layer of another method");
}
