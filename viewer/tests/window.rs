//! The window, driven by its widgets' names.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

mod common;

use common::{settle, testdata, window, window_with};
use eframe::egui::{Key, Modifiers};
use egui_kittest::kittest::Queryable;
use stein::parameters::Value;
use stein_viewer::document::Source;
use stein_viewer::view::Compare;
use stein_viewer::{Start, panel::Panel};

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
    harness.state_mut().open(Source { input: testdata("broken/cut_in_block_1.exr"), reference: None });
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
    let mut harness =
        window(Start { source: Some(Source { input: testdata("cornell_8spp.exr"), reference: None }), panel: Panel::Parameters, ..Default::default() });
    for radius in [3, 4, 5] {
        let viewer = harness.state_mut();
        assert!(viewer.edits.set(&mut viewer.parameters, "window_radius", Value::Integer(radius)));
        viewer.run();
    }
    settle(&mut harness);
    let document = harness.state().document.as_ref().unwrap();
    assert_eq!(document.denoised.as_ref().unwrap().method.window_radius(), 5);
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
