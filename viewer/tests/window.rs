//! The window, driven by its widgets' names.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

mod common;

use common::{settle, testdata, window, window_with};
use eframe::egui::{Key, Modifiers, Pos2, Rect, Theme, Vec2};
use egui_kittest::Harness;
use egui_kittest::kittest::Queryable;
use stein::parameters::Value;
use stein::{Method, Preset};
use stein_viewer::document::Source;
use stein_viewer::layer::{Range, Scale};
use stein_viewer::panel::Panel;
use stein_viewer::screenshot::{self, Shot};
use stein_viewer::settings::Parameters;
use stein_viewer::view::Compare;
use stein_viewer::view::colormap::Colormap;
use stein_viewer::{Start, Viewer};

#[test]
fn a_frame_is_opened_denoised_and_compared() {
    let mut harness = window_with("cornell_8spp.exr", Some("cornell_reference.exr"));
    let viewer = harness.state();
    assert!(viewer.trouble.is_none(), "{:?}", viewer.trouble);
    let denoised = viewer.document.as_ref().unwrap().denoised.as_ref().unwrap();
    assert!(denoised.error.unwrap() < viewer.document.as_ref().unwrap().opened.noisy_error.unwrap());

    harness.get_by_label("wipe").click();
    harness.run_steps(2);
    assert_eq!(harness.state().view.compare, Compare::Wipe);
    assert_eq!(harness.state().view.other.as_deref(), Some("reference"));
    harness.get_by_label("noisy").click();
    harness.run_steps(2);
    assert_eq!(harness.state().view.layer, "noisy");

    harness.key_press(Key::Num7);
    harness.run_steps(2);
    assert_eq!(harness.state().view.layer, "selection");
    harness.key_press_modifiers(Modifiers::SHIFT, Key::E);
    harness.run_steps(2);
    assert_eq!(harness.state().view.display.exposure, -0.5);
    for panel in Panel::ALL {
        harness.get_by_label(panel.title()).click();
        harness.run_steps(2);
        assert_eq!(harness.state().panel, panel);
    }
}

#[test]
fn a_broken_file_is_told_and_what_is_open_stays() {
    let mut harness = window_with("cornell_8spp.exr", None);
    harness.state_mut().open(Source::whole(testdata("broken/cut_in_block_1.exr"), None));
    settle(&mut harness);
    harness.get_by_label_contains("cut_in_block_1.exr");
    harness.get_by_label_contains("Remedy:");
    assert!(harness.state().document.as_ref().unwrap().denoised.is_some());
    harness.get_by_label("Dismiss").click();
    harness.run_steps(2);
    assert!(harness.state().trouble.is_none() && harness.query_by_label("Dismiss").is_none());
}

#[test]
fn a_change_of_parameters_runs_again_and_keeps_the_run_before() {
    let mut harness = window(Start {
        source: Some(Source::whole(testdata("cornell_8spp.exr"), None)),
        panel: Panel::Parameters,
        ..Default::default()
    });
    for radius in [3, 4, 5] {
        let viewer = harness.state_mut();
        assert!(viewer.edits.set(&mut viewer.parameters, "window_radius", Value::Integer(radius)));
        viewer.run();
    }
    settle(&mut harness);
    let document = harness.state().document.as_ref().unwrap();
    assert_eq!(document.denoised.as_ref().unwrap().parameters.method.window_radius(), 5);
    assert!(document.layer("before").is_some());
    harness.get_by_label("thesis").click();
    settle(&mut harness);
    assert!(harness.state().document.as_ref().unwrap().history.len() >= 3);
}

#[test]
fn nothing_is_open_at_first_and_the_help_lists_the_keys() {
    let mut harness = window(Start::default());
    harness.get_by_label("Open…");
    harness.key_press(Key::H);
    // It is in its place once its size is known.
    harness.run_steps(5);
    harness.get_by_label("half a stop brighter");
    harness.get_by_label("Close").click();
    harness.run_steps(2);
    assert!(harness.query_by_label("half a stop brighter").is_none());
}

/// What the shader makes of a number.
fn false_colour(value: f32, (range, scale): (Range, Scale)) -> [f32; 3] {
    let place = match scale {
        Scale::Log => (value / range.low).log2() / (range.high / range.low).log2(),
        _ => (value - range.low) / (range.high - range.low),
    };
    Colormap::Viridis.color(place).map(|channel| 255.0 * channel)
}

/// Checks the colours of B, at the right, and of A, on these scales.
fn check_sides(harness: &mut Harness<'static, Viewer>, scales: [(Range, Scale); 2]) {
    let picture = harness.render().unwrap();
    let canvas = harness.get_by_label_contains("image: ").rect();
    let (viewer, middle) = (harness.state(), canvas.center().x);
    let left = Rect::from_min_max(canvas.min, Pos2::new(middle - 1.0, canvas.max.y));
    let right = Rect::from_min_max(Pos2::new(middle + 1.0, canvas.min.y), canvas.max);
    let layers = [viewer.layer().unwrap(), viewer.other().unwrap()];
    for ((side, layer), scale) in [left, right].into_iter().zip(layers).zip(scales) {
        let image = layer.image();
        let mut checked = 0;
        for pixel in (0..image.extent.pixels()).step_by(53) {
            let (x, y) = (pixel % image.extent.width as usize, pixel / image.extent.width as usize);
            let place = viewer.view.camera.to_screen(side, Vec2::new(x as f32 + 0.5, y as f32 + 0.5));
            // Names and legends lie over the others.
            if !side.shrink(45.0).contains(place) {
                continue;
            }
            let found = picture.get_pixel(place.x as u32, place.y as u32).0;
            let expected = false_colour(image.planes[0][pixel], scale);
            let off = found
                .iter()
                .zip(expected)
                .map(|(found, expected)| (f32::from(*found) - expected).abs())
                .fold(0.0, f32::max);
            assert!(off <= 2.0, "{} at ({x}, {y}) is {found:?}, not {expected:?}", layer.name());
            checked += 1;
        }
        assert!(checked > 50, "{checked}");
    }
}

#[test]
fn one_scale_for_both_layers_recolours_b_alone() {
    let mut harness = window_with("cornell_8spp.exr", None);
    let viewer = harness.state_mut();
    (viewer.view.layer, viewer.view.other) = ("error".into(), Some("density".into()));
    harness.key_press(Key::S);
    harness.run_steps(2);
    let viewer = harness.state();
    let own = [viewer.layer().unwrap(), viewer.other().unwrap()].map(|layer| viewer.view.display.scale_of(layer));
    assert_ne!(own[0], own[1]);
    check_sides(&mut harness, own);
    harness.key_press(Key::L);
    harness.run_steps(2);
    check_sides(&mut harness, [own[0]; 2]);
    harness.key_press(Key::L);
    harness.run_steps(2);
    check_sides(&mut harness, own);
}

#[test]
fn what_is_named_at_the_start_and_not_there_is_told_once_and_the_window_goes_on() {
    let gem = Parameters::of("gem", Preset::Default);
    let source = || Some(Source::whole(testdata("anim/shot.0000.exr"), None));
    // FIRST is a candidate, but of another method.
    let start = Start {
        source: source(),
        parameters: gem,
        layer: Some("first".into()),
        other: Some("nonsense".into()),
        compare: Compare::SideBySide,
        panel: Panel::Pixel,
        pixel: Some([3, 1000]),
        ..Default::default()
    };
    let mut harness = window(start.clone());
    harness.get_by_label_contains("there is no layer 'first' or 'nonsense'; there is no pixel (3, 1000)");
    harness.get_by_label_contains("Remedy: choose one of result, ");
    let view = &harness.state().view;
    assert_eq!((view.layer.as_str(), view.other.as_deref(), view.pinned), ("result", Some("noisy"), None));
    harness.get_by_label("Dismiss").click();
    harness.run_steps(2);
    harness.key_press(Key::F5);
    settle(&mut harness);
    harness.state_mut().open(source().unwrap());
    settle(&mut harness);
    assert!(harness.state().trouble.is_none() && harness.query_by_label("Dismiss").is_none());

    // A picture of something else would be taken for what was named: there is none.
    let gpu = harness.state().gpu.clone();
    let refused = |start: Start| {
        let shot = Shot { start, size: [640.0, 480.0], scale: 1.0, theme: Theme::Dark };
        screenshot::take(&gpu, &shot, |_| {}).unwrap_err()
    };
    let error = refused(start.clone());
    assert!(
        matches!(error, stein::Error::Request { .. })
            && error.to_string().contains("there is no layer 'first' or 'nonsense'; there is no pixel"),
        "{error}"
    );

    // A neighbour, of a pixel that is there, in both ways.
    let parameters = Some(Parameters {
        method: Method::default().with_parameter("window_radius", 2).unwrap(),
        ..Parameters::default()
    });
    let start = Start {
        parameters,
        layer: Some("first".into()),
        other: None,
        panel: Panel::Kernel,
        pixel: Some([3, 4]),
        neighbour: Some([-3, 0]),
        ..start
    };
    let told = "the window has no neighbour (-3, 0) in the image";
    let error = refused(start.clone());
    assert!(error.to_string().starts_with(told), "{error}");
    let harness = window(Start { ..start.clone() });
    harness.get_by_label(told);
    assert_eq!((harness.state().view.layer.as_str(), harness.state().inspector.kept), ("first", None));
    let harness = window(Start { neighbour: Some([-2, 0]), ..start });
    assert!(harness.state().trouble.is_none());
    assert_eq!(harness.state().inspector.kept, Some([-2, 0]));
}
