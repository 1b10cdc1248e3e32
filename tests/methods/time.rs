//! Windows over several frames of a shot (thesis 7.3 and 8.6).

use glam::IVec2;
use stein::error::RequestCause;
use stein::frame::FeatureKind;
use stein::frame::{SamplesPerPixel, Signal};
use stein::gpu::{Gpu, GpuOptions, Recorder};
use stein::method::{GpuFeature, GpuFrame, GpuPayload, GpuSignal};
use stein::sampling::{SampleCounts, Sampler};
use stein::stage::payload::PayloadGroup;
use stein::stage::sample::GpuSamples;
use stein::{Denoiser, DfcParams, Error, Estimate, Extent, Frame, GemParams, Image, Method, NlmParams, Options};
use stein_metric as metric;
use stein_stub::{Sequence, StubSampler, scene};

use crate::behaviour::memory_for_strips_of_window;
use crate::common::{gpu, open};

const EXTENT: Extent = Extent { width: 40, height: 40 };

/// A still of the built-in scene `dof`; another seed is another frame of a shot in which nothing moves.
fn still(samples: u32, seed: u64) -> Frame {
    let scene = scene("dof").unwrap_or_else(|| panic!("no such scene"));
    let counts = SampleCounts::uniform(EXTENT, samples).unwrap_or_else(|error| panic!("{error}"));
    let samples = StubSampler::new(scene, EXTENT, seed, Sequence::Random)
        .sample(&counts, None)
        .unwrap_or_else(|error| panic!("{error}"));
    samples.to_frame().unwrap_or_else(|error| panic!("{error}")).0
}

fn denoiser(gpu: &Gpu) -> Denoiser {
    with_method(gpu, DfcParams { window_radius: 5, ..DfcParams::default() })
}

fn nlm(gpu: &Gpu) -> Denoiser {
    with_method(gpu, NlmParams { window_radius: 5, ..NlmParams::default() })
}

fn with_method(gpu: &Gpu, method: impl Into<Method>) -> Denoiser {
    Denoiser::new(gpu, method).unwrap_or_else(|error| panic!("{error}"))
}

fn window(denoiser: &Denoiser, frames: &[&Frame], centre: usize) -> Estimate {
    denoiser.denoise_window(frames, centre, Options::default()).unwrap_or_else(|error| panic!("{error}"))
}

fn error(image: &Image, reference: &Frame) -> f64 {
    metric::relative_mse(image, &reference.color().mean).unwrap_or_else(|error| panic!("{error}"))
}

#[test]
fn a_static_shot_of_n_frames_is_as_good_as_n_times_the_samples() {
    let reference = still(2048, 1000);
    // Differences are judged by the noise of single frames (in NLM by that of their halves), so the result is not quite
    // as good.
    as_good_as_n_times_the_samples(&denoiser(gpu()), &reference, 1.3);
    as_good_as_n_times_the_samples(&nlm(gpu()), &reference, 1.6);
}

fn as_good_as_n_times_the_samples(denoiser: &Denoiser, reference: &Frame, most: f64) {
    let (mut alone, mut together, mut at_once) = (0.0, 0.0, 0.0);
    for shot in 0..3 {
        let frames: Vec<Frame> = (0..3).map(|frame| still(8, 10 * shot + frame)).collect();
        alone += error(&denoiser.denoise(&frames[1]).unwrap_or_else(|error| panic!("{error}")).color, reference);
        together += error(&window(denoiser, &frames.iter().collect::<Vec<_>>(), 1).color, reference);
        at_once += error(&window(denoiser, &[&still(24, 10 * shot + 5)], 0).color, reference);
    }
    assert!(together < 0.65 * alone, "{alone} became {together}");
    assert!(together < most * at_once, "three frames: {together}, their samples in one: {at_once}");
}

/// With a centre weight of 1, copies of a frame multiply every weight sum and change no average.
#[test]
fn copies_of_a_frame_change_nothing() {
    let frame = still(8, 1);
    // The guard may find rounding errors harmful.
    let params = NlmParams { window_radius: 4, guard_frames: false, ..NlmParams::default() };
    for params in [params, NlmParams { patchwise: false, ..params }, NlmParams { dual_buffer: false, ..params }] {
        let denoiser = with_method(gpu(), params);
        let (alone, together) = (window(&denoiser, &[&frame], 0), window(&denoiser, &[&frame, &frame, &frame], 1));
        let near = |actual: &Image, expected: &Image, factor: f32, what: &str| {
            let values = actual.planes.iter().flatten().zip(expected.planes.iter().flatten());
            let worst = values
                .map(|(actual, expected)| (actual - factor * expected).abs() / (factor * expected).abs().max(1e-3))
                .fold(0.0, f32::max);
            assert!(worst < 1e-4, "{what} is off by {worst} with {params:?}");
        };
        near(&together.color, &alone.color, 1.0, "the colour");
        near(&together.weight_sum, &alone.weight_sum, 3.0, "Σ w");
    }
}

#[test]
fn strips_in_time_give_the_bits_of_the_whole_and_keep_to_the_memory_allowed() {
    let frames: Vec<Frame> = (0..3).map(|seed| tall(&still(4, seed))).collect();
    let frames: Vec<&Frame> = frames.iter().collect();
    strips_are_the_whole(denoiser, &frames);
    strips_are_the_whole(nlm, &frames);
}

fn strips_are_the_whole(method: fn(&Gpu) -> Denoiser, frames: &[&Frame]) {
    let whole = window(&method(gpu()), frames, 0);
    assert_eq!(whole.strips, 1);
    // A device of its own: buffers of other tests would count.
    let gpu = open(GpuOptions::default());
    let limit = memory_for_strips_of_window(&method(&gpu), frames, 2, &[]);
    let in_strips = window(&method(&gpu).with_max_memory(limit), frames, 0);
    assert!(in_strips.strips >= 2, "{} strips", in_strips.strips);
    assert!(in_strips.peak_bytes <= limit, "{} bytes where {limit} were allowed", in_strips.peak_bytes);
    assert!(in_strips.color == whole.color && in_strips.error == whole.error);
}

/// The image mirrored to seven times its height.
fn tall(frame: &Frame) -> Frame {
    let stack = |image: &Image| {
        let (width, height) = (image.extent.width as usize, image.extent.height as usize);
        let mirrored =
            |row: usize| if (row / height).is_multiple_of(2) { row % height } else { height - 1 - row % height };
        let planes = image
            .planes
            .iter()
            .map(|plane| (0..7 * height).flat_map(|row| plane[mirrored(row) * width..][..width].to_vec()).collect());
        Image { extent: Extent { height: 7 * image.extent.height, ..image.extent }, planes: planes.collect() }
    };
    changed(frame, |_, signal| Signal {
        mean: stack(&signal.mean),
        half_spread: signal.half_spread.as_ref().map(stack),
        variance_of_mean: signal.variance_of_mean.as_ref().map(stack),
    })
}

/// The frame with each signal changed by `change`; the colour's name is "colour".
fn changed(frame: &Frame, mut change: impl FnMut(&str, Signal) -> Signal) -> Frame {
    let color = change("colour", frame.color().clone());
    let features = frame
        .features()
        .iter()
        .map(|feature| (feature.name.clone(), change(&feature.name, feature.signal.clone())))
        .collect();
    Frame::new(color, features, SamplesPerPixel::Unknown).unwrap_or_else(|error| panic!("{error}")).0
}

/// One far pixel shrinks all other depths of its frame within the unit range; those of the window must be compared as
/// they were.
#[test]
fn features_of_a_window_are_compared_in_the_units_of_one_frame() {
    let [centre, beside] = [1, 2].map(|seed| still(8, seed));
    // All frames are made again, from the same units.
    let same = |_: &str, signal: Signal| signal;
    let far = |name: &str, mut signal: Signal| {
        if name == "depth" {
            signal.mean.planes[0][0] = 20.0;
        }
        signal
    };
    let centre = changed(&centre, same);
    let mean_weight_sum = |frames: &[&Frame]| {
        let weight_sum = window(&denoiser(gpu()), frames, 0).weight_sum;
        weight_sum.planes[0].iter().sum::<f32>() / weight_sum.planes[0].len() as f32
    };
    let (alone, as_it_was) = (mean_weight_sum(&[&centre]), mean_weight_sum(&[&centre, &changed(&beside, same)]));
    assert!(as_it_was > 1.5 * alone, "{alone} {as_it_was}");
    let ratio = mean_weight_sum(&[&centre, &changed(&beside, far)]) / as_it_was;
    assert!((ratio - 1.0).abs() < 0.02, "Σ w changed by a factor of {ratio}");
}

#[test]
fn a_feature_that_one_frame_lacks_is_left_out_of_the_window() {
    let [centre, beside] = [1, 2].map(|seed| still(8, seed));
    let same = |_: &str, signal: Signal| signal;
    let without_depth = |name: &str, signal: Signal| {
        // The same everywhere: such a feature is dropped.
        if name == "depth" {
            Signal { mean: Image::filled(EXTENT, 1, 0.5), half_spread: None, variance_of_mean: None }
        } else {
            signal
        }
    };
    let without = changed(&beside, without_depth);
    assert!(without.features().len() + 1 == beside.features().len());
    let one = window(&denoiser(gpu()), &[&changed(&centre, same), &without], 0);
    let both = window(&denoiser(gpu()), &[&changed(&centre, without_depth), &without], 0);
    assert!(one.color == both.color);
}

/// The frames of a renderer are checked too, as far as the host knows them.
#[test]
fn frames_on_the_gpu_that_do_not_fit_together_are_refused() {
    let frame = |rec: &mut Recorder, width: i32, has_halves: bool, features: usize| {
        let mut signal = |has_halves: bool| {
            let signal = rec.upload("signal", &vec![0.5; 8 * width as usize]).unwrap_or_else(|error| panic!("{error}"));
            GpuSignal { signal: signal.into(), variance_of_mean: None, has_halves }
        };
        let features = (0..features)
            .map(|index| GpuFeature {
                name: index.to_string(),
                kind: FeatureKind::Other,
                signal: signal(true),
                channels: 1,
            })
            .collect();
        GpuFrame {
            extent: IVec2::new(width, 1),
            color: signal(has_halves),
            features,
            samples: GpuSamples::Uniform(1.0),
            mean_variance: None,
            payload: Vec::new(),
        }
    };
    // Groups of no planes, and of too many.
    for planes in [0, 5] {
        let mut rec = gpu().record_whole();
        let mut own = frame(&mut rec, 2, true, 1);
        let buffer = rec.upload("payload", &[0.5; 40]).unwrap_or_else(|error| panic!("{error}"));
        let mean = PayloadGroup { buffer: buffer.into(), planes };
        own.payload = vec![GpuPayload { mean, half_spread: None }];
        let refused = denoiser(gpu()).record(&mut rec, own, Vec::new());
        assert!(matches!(refused, Err(Error::Request { .. })), "{planes} planes");
    }
    for (denoiser, width, has_halves, features, fits) in [
        (denoiser(gpu()), 2, true, 1, true),
        (denoiser(gpu()), 3, true, 1, false),
        (denoiser(gpu()), 2, false, 1, false),
        (denoiser(gpu()), 2, true, 0, false),
        (nlm(gpu()), 2, true, 0, true),
        (nlm(gpu()), 2, false, 1, false),
    ] {
        let mut rec = gpu().record_whole();
        let (own, other) = (frame(&mut rec, 2, true, 1), frame(&mut rec, width, has_halves, features));
        match denoiser.record(&mut rec, own, vec![other]) {
            Ok(_) => assert!(fits, "{width} {has_halves} {features}"),
            Err(error) => {
                assert!(!fits && matches!(error, Error::Request { .. }), "{width} {has_halves} {features}: {error}");
            }
        }
    }
}

#[test]
fn frames_that_do_not_fit_together_are_refused() {
    let frame = still(4, 1);
    let other_extent = tall(&frame);
    let no_halves = changed(&frame, |_, signal| Signal { half_spread: None, ..signal });
    let refused = |method: &Denoiser, frames: &[&Frame], centre| match method
        .denoise_window(frames, centre, Options::default())
        .map(drop)
    {
        Err(Error::Request(cause)) => cause,
        other => panic!("{other:?}"),
    };
    let dfc = denoiser(gpu());
    let cause = refused(&dfc, &[&frame, &other_extent], 0);
    assert!(matches!(cause, RequestCause::FrameExtent { index: 1, extent, .. } if extent == other_extent.extent()));
    assert_eq!(refused(&dfc, &[&frame, &no_halves], 0), RequestCause::FrameNoise { index: 1 });
    assert_eq!(refused(&dfc, &[&frame], 1), RequestCause::NoSuchFrame { centre: 1, frames: 1 });
    let gem = with_method(gpu(), GemParams::default());
    assert_eq!(refused(&gem, &[&frame, &frame], 0), RequestCause::NotInTime { method: "gem" });
}
