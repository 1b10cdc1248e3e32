//! What the tests of the window share: a window on the denoiser's own device.

#![allow(dead_code, reason = "each test uses its part")]
#![expect(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use eframe::egui::{DroppedFile, DroppedFileHandle};
use egui_kittest::Harness;
use stein::Gpu;
use stein::gpu::DeviceChoice;
use stein_viewer::document::Source;
use stein_viewer::{Start, Viewer, device};

/// Longest that the worker may take.
pub(crate) const PATIENCE: Duration = Duration::from_secs(300);

/// A file of `testdata/`.
pub(crate) fn testdata(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../testdata").join(name)
}

/// A window of 1280×720 points, once the worker is idle.
pub(crate) fn window(start: Start) -> Harness<'static, Viewer> {
    window_of([1280.0, 720.0], 1.0, start)
}

/// A window of this many points, each of `scale` pixels, once the worker is idle.
pub(crate) fn window_of(size: [f32; 2], scale: f32, start: Start) -> Harness<'static, Viewer> {
    let gpu = Gpu::open(&DeviceChoice::Auto).unwrap();
    let setup = device::setup(&gpu).unwrap();
    let mut harness = Harness::builder()
        .with_size(size)
        .with_pixels_per_point(scale)
        .wgpu_setup(setup)
        .build_eframe(move |creation| Viewer::in_window(creation, &gpu, start).unwrap());
    settle(&mut harness);
    harness
}

/// A window with a file, and its reference if there is one.
pub(crate) fn window_with(input: &str, reference: Option<&str>) -> Harness<'static, Viewer> {
    window(Start { source: Some(Source::whole(testdata(input), reference.map(testdata))), ..Default::default() })
}

/// Files that are dropped on the window.
pub(crate) fn drop_files(harness: &mut Harness<'static, Viewer>, files: &[PathBuf]) {
    #[derive(Debug)]
    struct Dropped(PathBuf);
    impl DroppedFile for Dropped {
        fn path(&self) -> &Path {
            &self.0
        }
        fn bytes(&self) -> Result<Vec<u8>, String> {
            Err("the viewer reads files by their paths".into())
        }
    }
    let dropped = files.iter().map(|file| Arc::new(Dropped(file.clone())) as DroppedFileHandle);
    harness.input_mut().dropped_files.extend(dropped);
    settle(harness);
}

/// Draws frames until nothing is at work.
pub(crate) fn settle(harness: &mut Harness<'static, Viewer>) {
    let start = Instant::now();
    loop {
        harness.step();
        if harness.state().is_idle() {
            break;
        }
        assert!(start.elapsed() < PATIENCE, "the worker is still at it: {:?}", harness.state().progress);
        std::thread::sleep(Duration::from_millis(10));
    }
    // What the last reply changed is laid out in the frame after it.
    harness.run_steps(2);
}
