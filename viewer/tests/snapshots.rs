//! Pictures of the window's main states, against those in `snapshots/`.
//!
//! Renew them with `UPDATE_SNAPSHOTS=1 cargo test --test snapshots`, and look at what has changed before it is
//! committed.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

mod common;

use common::{settle, testdata, window_of};
use egui_kittest::SnapshotOptions;
use stein_viewer::Start;
use stein_viewer::document::Source;
use stein_viewer::panel::Panel;
use stein_viewer::settings::Parameters;
use stein_viewer::view::Compare;

/// Pixels of 640×360 that may differ: drivers place edges and round colours in their own way.
const MAY_DIFFER: usize = 640 * 360 / 100;
/// How far two pixels may be apart before they differ, in the measure of dify.
const TOLERANCE: f32 = 2.0;

#[test]
fn the_main_states_look_as_they_did() {
    let Parameters { preset, method } = Parameters::default();
    let parameters = Some(Parameters { preset, method: method.with_parameter("window_radius", 3).unwrap() });
    let source = Source::whole(testdata("dof_spheres_32spp.exr"), Some(testdata("dof_spheres_reference.exr")));
    let mut harness = window_of(
        [1280.0, 720.0],
        0.5,
        Start { source: Some(source), parameters, layer: Some("result".into()), ..Default::default() },
    );
    settle(&mut harness);
    let options = SnapshotOptions::new()
        .threshold(TOLERANCE)
        .max_failed_pixels(MAY_DIFFER)
        .output_path(std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/snapshots"));
    let states = [
        ("single", "result", Compare::Single, Panel::Display),
        ("wipe", "noisy", Compare::Wipe, Panel::Pixel),
        ("selection", "selection", Compare::SideBySide, Panel::Display),
        ("parameters", "error", Compare::Single, Panel::Parameters),
    ];
    for (name, layer, compare, panel) in states {
        let viewer = harness.state_mut();
        (viewer.view.layer, viewer.panel, viewer.view.pinned) = (layer.into(), panel, Some([40, 30]));
        viewer.view.other = Some("reference".into());
        viewer.compare(compare);
        viewer.scrolls_to_layer = true;
        // Times are never the same.
        viewer.document.as_mut().unwrap().denoised.as_mut().unwrap().seconds = 1.0;
        harness.run_steps(4);
        harness.snapshot_options(name, &options);
    }
}
