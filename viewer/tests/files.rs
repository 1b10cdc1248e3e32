//! The window with every file of `testdata/`, and with every layer.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

mod common;

use std::path::{Path, PathBuf};

use common::{drop_files, settle, testdata, window};
use eframe::egui::Key;
use egui_kittest::Harness;
use egui_kittest::kittest::Queryable;
use stein::Preset;
use stein_viewer::document::Source;
use stein_viewer::files::{is_reference, short_name};
use stein_viewer::panel::Panel;
use stein_viewer::settings::Parameters;
use stein_viewer::{Start, Viewer};

/// A method that is done soon.
fn quick(method: &str) -> Option<Parameters> {
    let parameters = Parameters::of(method, Preset::Default).unwrap();
    match parameters.method.with_parameter("window_radius", 2) {
        Ok(method) => Some(Parameters { method, ..parameters }),
        Err(_) => Some(parameters),
    }
}

/// OpenEXR files of a folder, in order.
fn files(folder: &Path) -> Vec<PathBuf> {
    let mut files: Vec<_> = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.retain(|path| path.extension().is_some_and(|extension| extension == "exr"));
    files.sort();
    files
}

#[test]
fn every_buffer_set_is_opened_and_denoised() {
    let folders = ["", "anim", "mitsuba"].map(testdata);
    let (references, inputs): (Vec<_>, Vec<_>) = folders.iter().flat_map(|folder| files(folder)).partition(|path| is_reference(path));
    assert!(inputs.len() >= 12 && references.len() >= 8, "{inputs:?} {references:?}");
    let mut harness = window(Start { parameters: quick("dfc"), ..Default::default() });
    for input in inputs {
        // cornell_8spp.exr and cornell_reference.exr; shot.0001.exr and reference.0001.exr.
        let (name, folder) = (short_name(&input), input.parent());
        let stem = name.rsplit_once('_').map_or(name.as_str(), |(stem, _)| stem);
        let belongs = |path: &&PathBuf| {
            let other = short_name(path);
            path.parent() == folder && (other == format!("{stem}_reference.exr") || other == name.replace("shot", "reference"))
        };
        let reference = references.iter().find(belongs).cloned();
        harness.state_mut().open(Source { input: input.clone(), reference: reference.clone() });
        settle(&mut harness);
        let viewer = harness.state();
        assert!(viewer.trouble.is_none(), "{}: {:?}", input.display(), viewer.trouble);
        let document = viewer.document.as_ref().unwrap();
        assert_eq!(document.opened.source.as_ref().unwrap().input, input);
        let denoised = document.denoised.as_ref().unwrap();
        assert!(denoised.estimate.color.planes.iter().flatten().all(|value| value.is_finite()), "{}", input.display());
        assert_eq!(denoised.error.is_some(), reference.is_some(), "{}", input.display());
    }
}

#[test]
fn every_layer_of_each_method_is_shown_and_its_pixel_told() {
    let input = Some(Source { input: testdata("anim/shot.0001.exr"), reference: Some(testdata("anim/reference.0001.exr")) });
    for method in Parameters::METHODS {
        let start = Start { source: input.clone(), parameters: quick(method), panel: Panel::Pixel, layer: Some("result".into()), ..Default::default() };
        let mut harness = window(start);
        let names: Vec<_> = harness.state().document.as_ref().unwrap().layers().iter().map(|layer| layer.name().to_owned()).collect();
        assert!(names.len() > 15, "{method}: {names:?}");
        for (place, name) in names.iter().enumerate() {
            if place > 0 {
                harness.key_press(Key::Period);
                harness.run_steps(1);
            }
            assert_eq!(harness.state().view.layer, *name, "{method}");
        }
        harness.key_press(Key::Comma);
        harness.state_mut().view.pinned = Some([7, 21]);
        harness.run_steps(2);
        assert_eq!(harness.state().view.layer, names[names.len() - 2]);
        harness.get_by_label("Pixel (7, 21)");
        // A picture of the last one comes from the device without an error.
        harness.render().unwrap();
    }
}

#[test]
fn broken_files_are_told_and_the_window_goes_on() {
    let start = Start { source: Some(Source { input: testdata("anim/shot.0000.exr"), reference: None }), parameters: quick("gem"), ..Default::default() };
    let mut harness = window(start);
    let mut refused = 0;
    let broken = files(&testdata("broken"));
    assert!(broken.len() > 40, "{broken:?}");
    for input in broken {
        let name = short_name(&input);
        harness.state_mut().open(Source { input: input.clone(), reference: None });
        settle(&mut harness);
        let viewer = harness.state();
        // What can be repaired is opened.
        let is_open = viewer.document.as_ref().unwrap().opened.source.as_ref().unwrap().input == input;
        assert_ne!(viewer.trouble.is_some(), is_open, "{name}: {:?}", viewer.trouble);
        assert!(viewer.document.as_ref().unwrap().denoised.is_some(), "{name}");
        if !is_open {
            refused += 1;
            let (_, error) = viewer.trouble.as_ref().unwrap();
            assert!(error.to_string().contains(&name), "{error}");
            harness.get_by_label_contains("Remedy:");
            harness.get_by_label("Dismiss").click();
            harness.run_steps(2);
            assert!(harness.query_by_label("Dismiss").is_none());
        }
    }
    assert!(refused > 30, "{refused}");
    let reference = testdata("cornell_reference.exr");
    harness.state_mut().open(Source { input: testdata("anim/shot.0000.exr"), reference: Some(reference) });
    settle(&mut harness);
    harness.get_by_label_contains("the reference has 96×96 pixels");
}

#[test]
fn files_that_are_dropped_are_opened_and_a_reference_is_told_by_its_name() {
    let mut harness = window(Start { parameters: quick("gem"), ..Default::default() });
    let [first, second, reference] = ["anim/shot.0000.exr", "anim/shot.0001.exr", "anim/reference.0001.exr"].map(testdata);
    let is_open = |harness: &Harness<'static, Viewer>, input: &PathBuf, reference: Option<&PathBuf>| {
        let document = harness.state().document.as_ref().unwrap();
        let source = document.opened.source.as_ref().unwrap();
        assert_eq!((&source.input, source.reference.as_ref()), (input, reference));
        assert_eq!(document.denoised.as_ref().unwrap().error.is_some(), reference.is_some());
    };
    harness.get_by_label("Drop an OpenEXR buffer set here");
    drop_files(&mut harness, std::slice::from_ref(&first));
    is_open(&harness, &first, None);
    // In whichever order they come.
    for files in [[&second, &reference], [&reference, &second]] {
        drop_files(&mut harness, &files.map(PathBuf::clone));
        is_open(&harness, &second, Some(&reference));
        drop_files(&mut harness, std::slice::from_ref(&first));
        is_open(&harness, &first, None);
    }
    // By itself it is that of what is open, and stays nowhere else.
    drop_files(&mut harness, std::slice::from_ref(&reference));
    is_open(&harness, &first, Some(&reference));

    let broken = testdata("broken/cut_in_block_1.exr");
    drop_files(&mut harness, std::slice::from_ref(&broken));
    harness.get_by_label_contains("cut_in_block_1.exr");
    is_open(&harness, &first, Some(&reference));
    drop_files(&mut harness, &[second.clone(), broken]);
    assert!(harness.state().trouble.is_none(), "one file is opened, the first");
    harness.get_by_label("One file is open at a time, left out: cut_in_block_1.exr");
    is_open(&harness, &second, None);

    // With nothing to compare with, it is taken for a frame, and is none.
    let mut harness = window(Start { parameters: quick("gem"), ..Default::default() });
    drop_files(&mut harness, &[reference]);
    harness.get_by_label_contains("reference.0001.exr: nothing is known of the colour's noise");
    assert!(harness.state().document.is_none());
}
