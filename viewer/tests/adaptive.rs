//! The adaptive loop in the window.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

mod common;

use std::time::{Duration, Instant};

use common::{PATIENCE, settle, window};
use eframe::egui::Key;
use egui_kittest::kittest::Queryable;
use stein::Extent;
use stein::sampling::{SampleSchedule, adapt};
use stein_stub::{Sequence, StubSampler, scene};
use stein_viewer::Start;
use stein_viewer::adaptive::Setup;
use stein_viewer::document::Source;
use stein_viewer::panel::Panel;
use stein_viewer::settings::Parameters;

fn small() -> (Setup, Parameters) {
    let setup = Setup {
        scene: "dof".into(),
        extent: Extent { width: 40, height: 24 },
        samples_per_pixel: 12,
        iterations: 3,
        seed: 5,
        reference_samples: 64,
    };
    let Parameters { preset, method } = Parameters::default();
    (setup, Parameters { preset, method: method.with_parameter("window_radius", 3).unwrap() })
}

#[test]
fn iterations_are_those_of_the_library_and_can_be_chosen() {
    let (setup, parameters) = small();
    let start = Start {
        adapt: Some(setup.clone()),
        parameters: Some(parameters),
        panel: Panel::Sampling,
        ..Default::default()
    };
    let mut harness = window(start);
    let viewer = harness.state();
    assert!(viewer.trouble.is_none(), "{:?}", viewer.trouble);
    assert!(!viewer.adaptive.is_running);
    assert_eq!(
        viewer.adaptive.iterations.iter().map(|iteration| iteration.samples_per_pixel).collect::<Vec<_>>(),
        [4.0, 8.0, 12.0]
    );

    let mut sampler = StubSampler::new(scene("dof").unwrap(), setup.extent, 5, Sequence::Random);
    let schedule = SampleSchedule::new(12, 3, None).unwrap().with_default_cap();
    let denoiser = stein::Denoiser::new(&viewer.gpu, parameters.method).unwrap();
    let outcome = adapt(&mut sampler, &denoiser, &schedule, None, |_| Ok::<_, stein::Error>(())).unwrap();
    let document = viewer.document.as_ref().unwrap();
    assert_eq!(document.layer("result").unwrap().image(), &outcome.estimate.color);
    let drawn = document.layer("drawn").unwrap().image();
    assert_eq!(drawn.planes[0].iter().sum::<f32>(), 4.0 * setup.extent.pixels() as f32);
    for name in ["noisy", "samples", "density", "error", "selection", "before", "reference", "true_error"] {
        assert!(document.layer(name).is_some(), "{name}");
    }
    let errors: Vec<_> = viewer.adaptive.iterations.iter().map(|iteration| iteration.denoised.error.unwrap()).collect();
    assert!(errors[2] < errors[0], "{errors:?}");
    assert!(document.denoised.as_ref().unwrap().error.unwrap() < document.opened.noisy_error.unwrap());

    let last = document.layer("result").unwrap().image().clone();
    harness.get_by_label("iteration 1").click();
    harness.run_steps(2);
    assert_eq!(harness.state().adaptive.shown, Some(1));
    let first = harness.state().document.as_ref().unwrap().layer("result").unwrap().image().clone();
    assert_ne!(first, last);
    harness.key_press(Key::PageDown);
    harness.run_steps(2);
    assert_eq!(harness.state().adaptive.shown, Some(2));
    assert_eq!(harness.state().document.as_ref().unwrap().layer("before").unwrap().image(), &first);
    harness.get_by_label_contains("plot: relative MSE");

    // The frame of an iteration is one like any other.
    harness.state_mut().run();
    settle(&mut harness);
    assert!(harness.state().document.as_ref().unwrap().denoised.as_ref().unwrap().error.is_some());
}

#[test]
fn runs_of_an_iteration_are_compared_with_a_reference_that_comes_later() {
    let (mut setup, parameters) = small();
    let mut harness = window(Start { parameters: Some(parameters), ..Default::default() });
    let context = harness.ctx.clone();
    // The first run is done before the reference is there, the second waits while it is drawn.
    for (complete, reference_samples) in [(1, 1 << 10), (3, 1 << 12)] {
        setup.reference_samples = reference_samples;
        harness.state_mut().adaptive.setup = setup.clone();
        harness.state_mut().adapt();
        let start = Instant::now();
        while harness.state().adaptive.iterations.len() < complete {
            assert!(harness.state().trouble.is_none() && start.elapsed() < PATIENCE, "{:?}", harness.state().trouble);
            // A frame could take longer than what is left.
            harness.state_mut().poll(&context);
            std::thread::sleep(Duration::from_millis(1));
        }
        assert!(harness.state().adaptive.is_running, "after {complete} iterations");
        let number = harness.state().adaptive.shown;
        harness.state_mut().run();
        settle(&mut harness);
        let viewer = harness.state();
        assert!(!viewer.adaptive.is_running && viewer.adaptive.shown == number, "after {complete} iterations");
        assert!(viewer.adaptive.iterations.iter().all(|iteration| iteration.denoised.error.is_some()));
        let document = viewer.document.as_ref().unwrap();
        assert!(
            document.history.len() > 1 && document.history.last().unwrap().error.is_some(),
            "{:?}",
            document.history
        );
        assert_eq!(document.denoised.as_ref().unwrap().parameters, parameters);
        for name in ["before", "reference", "true_error"] {
            assert_eq!(document.layers().iter().filter(|layer| layer.name() == name).count(), 1, "{name}");
        }
    }
}

#[test]
fn a_loop_ends_when_it_is_stopped_started_again_or_a_file_is_opened() {
    let (mut setup, parameters) = small();
    (setup.samples_per_pixel, setup.reference_samples) = (400, 1 << 14);
    let mut harness = window(Start { parameters: Some(parameters), panel: Panel::Sampling, ..Default::default() });
    harness.state_mut().adaptive.setup = setup.clone();
    harness.get_by_label("Start").click();
    harness.run_steps(2);
    assert!(harness.state().adaptive.is_running);
    harness.get_by_label("Stop").click();
    settle(&mut harness);
    assert!(!harness.state().adaptive.is_running && harness.state().adaptive.iterations.len() < 3);

    harness.state_mut().adapt();
    harness.state_mut().adaptive.setup = Setup { samples_per_pixel: 6, reference_samples: 0, ..setup };
    harness.state_mut().adapt();
    settle(&mut harness);
    assert_eq!(
        harness.state().adaptive.iterations.iter().map(|iteration| iteration.samples_per_pixel).collect::<Vec<_>>(),
        [2.0, 4.0, 6.0]
    );
    assert!(harness.state().document.as_ref().unwrap().opened.reference.is_none());

    harness.state_mut().adaptive.setup.reference_samples = 1 << 14;
    harness.state_mut().adapt();
    harness.run_steps(2);
    harness.state_mut().open(Source::whole(common::testdata("anim/shot.0000.exr"), None));
    settle(&mut harness);
    assert!(harness.state().adaptive.iterations.is_empty() && harness.state().adaptive.shown.is_none());
    assert!(harness.state().document.as_ref().unwrap().opened.source.is_some());

    harness.state_mut().adaptive.setup.scene = "nowhere".into();
    harness.state_mut().adapt();
    settle(&mut harness);
    harness.get_by_label_contains("there is no scene 'nowhere'");
    assert!(harness.state().document.is_some());
}
