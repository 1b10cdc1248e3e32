//! DFC in the situations of its callers: in strips, twice, on frames of several sizes, inside a renderer, and
//! cancelled.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use glam::IVec2;
use stein::error::{DeviceCause, Remedy};
use stein::frame::FeatureKind;
use stein::frame::{PayloadKind, PayloadLayer, Signal};
use stein::gpu::{Gpu, GpuOptions, Pace};
use stein::image::Extent;
use stein::method::{GpuFeature, GpuFrame, GpuPayload, GpuSignal, Intermediate, Spikes};
use stein::stage::nlm::Schedule;
use stein::stage::payload::PayloadGroup;
use stein::stage::sample::GpuSamples;
use stein::{Denoiser, DfcParams, Error, Estimate, Frame, Image, Options};

use crate::common::{Scene, calm_scene, gpu, limited_gpu, open, packed, packed_signal, read, scene};
use crate::frames::{EVERYTHING, Keep, error_of, frame, new_frame, noisy};
use crate::reference::{Grid, Planes};

fn params() -> DfcParams {
    DfcParams { window_radius: 4, ..DfcParams::default() }
}

fn denoiser(gpu: &Gpu, params: DfcParams) -> Denoiser {
    Denoiser::new(gpu, params).unwrap_or_else(|error| panic!("{error}"))
}

pub(crate) fn denoised(denoiser: &Denoiser, frame: &Frame) -> Estimate {
    denoiser.denoise(frame).unwrap_or_else(|error| panic!("{error}"))
}

pub(crate) fn image(planes: &[Grid]) -> Image {
    let extent = Extent { width: planes[0].width as u32, height: planes[0].height as u32 };
    Image { extent, planes: planes.iter().map(|grid| grid.values.iter().map(|v| *v as f32).collect()).collect() }
}

/// A frame of random colour with spikes, and a feature with halves only.
pub(crate) fn random_frame(width: usize, height: usize, factor: f32) -> Frame {
    frame_of([51, 52].map(|seed| scene(width, height, seed)), factor)
}

/// The same frame without spikes: filters then average over all pixels that they reach, so that missing ones show.
pub(crate) fn calm_frame(width: usize, height: usize) -> Frame {
    frame_of([51, 52].map(|seed| calm_scene(width, height, seed)), 1.0)
}

fn frame_of([color, feature]: [Scene; 2], factor: f32) -> Frame {
    let scaled = |planes: &[Grid], factor: f32| {
        let mut image = image(planes);
        image.planes.iter_mut().flatten().for_each(|value| *value *= factor);
        image
    };
    // A frame takes values above 10¹⁸ for damage; no factor may reach this limit here.
    let variance: Planes = color.variance.iter().map(|grid| grid.like(|p| grid.at(p).min(1e5))).collect();
    let color = Signal {
        mean: scaled(&color.mean, factor),
        half_spread: Some(scaled(&color.spread, factor)),
        variance_of_mean: Some(scaled(&variance, factor * factor)),
    };
    // Noise within the unit range.
    let calm =
        |planes: &[Grid]| -> Planes { planes.iter().map(|grid| grid.like(|p| grid.at(p).clamp(-1.0, 2.0))).collect() };
    let feature = Signal {
        mean: image(&calm(&feature.mean)),
        half_spread: Some(scaled(&calm(&feature.spread), 0.1)),
        variance_of_mean: None,
    };
    new_frame(color, vec![("paint".into(), feature)])
}

fn selection(estimate: &Estimate) -> &Image {
    estimate.selection.as_ref().unwrap_or_else(|| panic!("DFC has selection maps"))
}

/// All results of a method for a frame with halves, each with its power of the colour's unit.
fn images(estimate: &Estimate) -> Vec<(&str, i32, &Image)> {
    let Some(half_spread) = &estimate.half_spread else { panic!("the frame has halves") };
    let mut images = vec![
        ("colour", 1, &estimate.color),
        ("half spread", 1, half_spread),
        ("error", 2, error_of(estimate)),
        ("Σ w", 0, &estimate.weight_sum),
    ];
    images.extend(estimate.selection.as_ref().map(|selection| ("selection", 0, selection)));
    images
}

/// Compares bits, except for the sign of 0. `factor` is the factor of the colour, a power of two; 1 for equal results.
pub(crate) fn assert_same(what: &str, actual: &Estimate, expected: &Estimate, factor: f32) {
    for ((name, power, actual), (_, _, expected)) in images(actual).into_iter().zip(images(expected)) {
        let factor = factor.powi(power);
        assert_eq!((actual.extent, actual.channels()), (expected.extent, expected.channels()), "{what}: {name}");
        let width = expected.extent.width as usize;
        for (channel, (actual, expected)) in actual.planes.iter().zip(&expected.planes).enumerate() {
            let differing = actual.iter().zip(expected).position(|(a, e)| a.to_bits() != (e * factor + 0.0).to_bits());
            if let Some(pixel) = differing {
                let (x, y, expected) = (pixel % width, pixel / width, expected[pixel] * factor);
                panic!("{what}: {name}: x {x}, y {y}, channel {channel}: {} instead of {expected}", actual[pixel]);
            }
        }
    }
}

/// Returns about the largest memory limit with which a frame is cut into so many strips.
pub(crate) fn memory_for_strips(denoiser: &Denoiser, frame: &Frame, strips: usize, keep: &[Intermediate]) -> u64 {
    memory_for_strips_of_window(denoiser, &[frame], strips, keep)
}

/// As [`memory_for_strips`], for the first frame of a window.
pub(crate) fn memory_for_strips_of_window(
    denoiser: &Denoiser,
    frames: &[&Frame],
    strips: usize,
    keep: &[Intermediate],
) -> u64 {
    let strips_in = |denoiser: &Denoiser| {
        let options = Options { keep, ..Options::default() };
        denoiser.requirements(frames, 0, &options).unwrap_or_else(|error| panic!("{strips} strips: {error}"))
    };
    let mut limit = strips_in(denoiser).peak_bytes;
    while strips_in(&denoiser.clone().with_max_memory(limit)).strips < strips {
        limit -= limit / 40;
    }
    limit
}

#[test]
fn strips_give_the_bits_of_the_whole() {
    for frame in [random_frame(24, 300, 1.0), calm_frame(24, 300)] {
        let whole = denoised(&denoiser(gpu(), params()), &frame);
        assert_eq!(whole.strips, 1);
        for strips in [3, 5] {
            let limit = memory_for_strips(&denoiser(gpu(), params()), &frame, strips, &[]);
            let estimate = denoised(&denoiser(gpu(), params()).with_max_memory(limit), &frame);
            assert!(estimate.strips >= strips, "{} strips in {limit} bytes", estimate.strips);
            assert_same(&format!("{} strips", estimate.strips), &estimate, &whole, 1.0);
        }
    }
}

/// The adapter with the limits that every WebGPU device has, such as 8 storage buffers.
fn least_gpu() -> Gpu {
    limited_gpu(|_| {})
}

#[test]
fn the_least_of_devices_gives_the_same_bits() {
    // Small sizes: a software driver compiles kernels again for other values in their uniform buffers.
    let (least, params) = (least_gpu(), DfcParams { window_radius: 1, ..DfcParams::default() });
    assert_eq!(least.wgpu_device().limits().max_storage_buffers_per_shader_stage, 8);
    let frames = [random_frame(16, 12, 1.0), calm_frame(16, 12)];
    let window = |gpu: &Gpu| {
        denoiser(gpu, params)
            .denoise_window(&frames.each_ref(), 0, Options::default())
            .unwrap_or_else(|error| panic!("{error}"))
    };
    assert_same("the least of devices", &window(&least), &window(gpu()), 1.0);
}

#[test]
fn strips_keep_to_the_memory_allowed() {
    // A device of its own: buffers of other tests would count.
    let gpu = open(GpuOptions::default());
    let frame = random_frame(24, 300, 1.0);
    for strips in [3, 5] {
        let limit = memory_for_strips(&denoiser(&gpu, params()), &frame, strips, &[]);
        let peak = denoised(&denoiser(&gpu, params()).with_max_memory(limit), &frame).peak_bytes;
        assert!(peak <= limit, "{peak} bytes where {limit} were allowed");
    }
    let too_little = denoiser(&gpu, params()).with_max_memory(100_000).denoise(&frame);
    match too_little.map(drop) {
        Err(error @ Error::Device(DeviceCause::StripTooLarge { needed, allowed: 100_000, .. })) => {
            assert!(needed > 100_000 && error.remedies().contains(&Remedy::RaiseMemoryLimit), "{error}");
        }
        other => panic!("100 kB are enough? {other:?}"),
    }
}

#[test]
fn schedules_and_repetition_do_not_change_a_bit() {
    let frame = random_frame(37, 41, 1.0);
    let plain = denoiser(gpu(), params());
    let first = denoised(&plain, &frame);
    assert_same("the second run", &denoised(&plain, &frame), &first, 1.0);
    let schedule = Schedule { scratch_bytes: 20_000, block_rows: 5, ..Schedule::SOFTWARE };
    assert_same("another schedule", &denoised(&plain.clone().with_schedule(schedule), &frame), &first, 1.0);
}

#[test]
fn frames_of_other_sizes_leave_nothing_behind() {
    let gpu = open(GpuOptions::default());
    let denoiser = denoiser(&gpu, params());
    let (small, large) = (random_frame(33, 21, 1.0), random_frame(65, 47, 1.0));
    let first = denoised(&denoiser, &small);
    denoised(&denoiser, &large);
    let kernels = gpu.kernel_count();
    gpu.trim();
    assert_eq!(gpu.memory().bytes_in_use, 0);
    for _ in 0..3 {
        let again = denoised(&denoiser, &small);
        assert_same("the first frame again", &again, &first, 1.0);
        assert_eq!(again.peak_bytes, first.peak_bytes);
        denoised(&denoiser, &large);
    }
    gpu.trim();
    assert_eq!((gpu.kernel_count(), gpu.memory().bytes_in_use, gpu.memory().bytes_idle), (kernels, 0, 0));
}

/// The buffers and the encoder of a renderer, without an upload or a read.
#[test]
fn a_renderer_that_keeps_its_buffers_gets_the_same_bits() {
    let gpu = open(GpuOptions::default());
    let denoiser = denoiser(&gpu, params());
    // The median brightness is between 1 and 2, so the exposure is 1.
    let (color, paint) = (scene(45, 31, 53), scene(45, 31, 54));
    let brighter =
        |planes: &[Grid]| -> Planes { planes.iter().map(|grid| grid.like(|p| 0.5 * grid.at(p) + 0.5)).collect() };
    let color_mean = brighter(&color.mean);
    let mut brightest: Vec<f64> =
        (0..45 * 31).map(|pixel| color_mean.iter().map(|grid| grid.values[pixel].abs()).fold(0.0, f64::max)).collect();
    brightest.sort_by(f64::total_cmp);
    assert!((1.0..2.0).contains(&brightest[45 * 31 / 2]), "{}", brightest[45 * 31 / 2]);
    let unit = |planes: &[Grid]| -> Planes {
        planes.iter().map(|grid| grid.like(|p| f64::from(grid.at(p).clamp(0.0, 1.0) as f32))).collect()
    };
    let paint_mean = unit(&paint.mean);
    let signal = |mean: &[Grid]| Signal {
        mean: image(mean),
        half_spread: Some(image(&color.spread)),
        variance_of_mean: Some(image(&color.variance)),
    };
    let frame = new_frame(signal(&color_mean), vec![("paint".into(), signal(&paint_mean))]);
    // A layer of three channels, and a number that finds room beside them.
    let numbers = &paint_mean[..1];
    let layers = [("light", &color_mean[..]), ("number", numbers)];
    let layers = layers.map(|(name, mean)| PayloadLayer {
        name: name.into(),
        kind: PayloadKind::Light,
        mean: image(mean),
        half_spread: None,
    });
    let (frame, _) = frame.with_payload(layers.into()).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(
        (frame.features()[0].unit_scale, frame.features()[0].unit_offset),
        (1.0, 0.0),
        "the feature is in unit range as it is"
    );
    let expected = denoised(&denoiser, &frame);

    let own = |data: &[f32]| {
        let usage = wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST;
        let buffer = gpu.wgpu_device().create_buffer(&wgpu::BufferDescriptor {
            label: None,
            size: 4 * data.len() as u64,
            usage,
            mapped_at_creation: false,
        });
        let bytes: Vec<u8> = data.iter().flat_map(|value| value.to_le_bytes()).collect();
        gpu.wgpu_queue().write_buffer(&buffer, 0, &bytes);
        gpu.import("a renderer's", buffer).unwrap_or_else(|error| panic!("{error}"))
    };
    let gpu_signal = |mean: &[Grid]| GpuSignal {
        signal: Arc::new(own(&packed_signal(mean, &color.spread))),
        variance_of_mean: Some(Arc::new(own(&packed(&color.variance)))),
        has_halves: true,
    };
    let features = vec![GpuFeature {
        name: "paint".into(),
        kind: FeatureKind::Other,
        signal: gpu_signal(&paint_mean),
        channels: 3,
    }];
    let gpu_frame = GpuFrame {
        extent: IVec2::new(45, 31),
        color: gpu_signal(&color_mean),
        features,
        samples: GpuSamples::Uniform(1.0),
        mean_variance: None,
        payload: vec![GpuPayload {
            mean: PayloadGroup {
                buffer: Arc::new(own(&packed(&[color_mean.as_slice(), numbers].concat()))),
                planes: 1,
            },
            half_spread: None,
        }],
    };
    let mut rec = gpu.record_whole();
    let estimate = denoiser.record(&mut rec, gpu_frame, Vec::new()).unwrap_or_else(|error| panic!("{error}"));
    let mut encoder = gpu.wgpu_device().create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    rec.encode_into(&mut encoder).unwrap_or_else(|error| panic!("{error}"));
    gpu.wgpu_queue().submit([encoder.finish()]);

    let values = gpu.read(&estimate.signal).unwrap_or_else(|error| panic!("{error}"));
    let half_spread = expected.half_spread.as_ref().map(|image| &image.planes);
    let planes = expected.color.planes.iter().enumerate().chain((4..).zip(half_spread.into_iter().flatten()));
    for (channel, plane) in planes {
        let actual = values[channel / 4 * (values.len() / 2)..].iter().skip(channel % 4).step_by(4);
        for (pixel, (actual, expected)) in actual.zip(plane).enumerate() {
            // On the device a frame has no −0.
            let actual = actual + 0.0;
            assert_eq!(
                actual.to_bits(),
                expected.to_bits(),
                "x {}, y {}, channel {channel}: {actual} instead of {expected}",
                pixel % 45,
                pixel / 45
            );
        }
    }
    let layers = read(&gpu, &estimate.payload[0].buffer, IVec2::new(45, 31)).remove(0);
    let expected = expected.payload.iter().flat_map(|layer| &layer.image.planes);
    for (actual, expected) in layers.iter().zip(expected) {
        let same = |(actual, expected): (&f64, &f32)| *actual == f64::from(*expected);
        assert!(actual.values.iter().zip(expected).all(same), "the layers along");
    }
}

/// Beside a window the bits are the same, and a run can be cancelled without a report of progress.
#[test]
fn sharing_the_device_changes_nothing_and_can_be_ended() {
    let frame = random_frame(37, 41, 1.0);
    let denoiser = denoiser(gpu(), params());
    let expected = denoised(&denoiser, &frame);
    let cancelled = Arc::<AtomicBool>::default();
    for dispatches in [1, 7] {
        let pace = Some(Pace { dispatches, cancelled: cancelled.clone() });
        let estimate = denoiser
            .denoise_with(&frame, Options { pace, ..Options::default() })
            .unwrap_or_else(|error| panic!("{error}"));
        assert!(
            estimate.color == expected.color && estimate.error == expected.error,
            "{dispatches} dispatches at once"
        );
    }
    cancelled.store(true, Ordering::Relaxed);
    let result =
        denoiser.denoise_with(&frame, Options { pace: Some(Pace { dispatches: 1, cancelled }), ..Options::default() });
    assert!(matches!(result, Err(Error::Cancelled)), "{result:?}");
    assert!(denoised(&denoiser, &frame).color == expected.color);
}

#[test]
fn cancelling_ends_the_work_and_not_the_denoiser() {
    let frame = random_frame(37, 41, 1.0);
    let denoiser = denoiser(gpu(), params()).with_schedule(Schedule {
        scratch_bytes: 60_000,
        block_rows: 4,
        ..Schedule::SOFTWARE
    });
    let expected = denoised(&denoiser, &frame);
    for ended_at in [1, 3] {
        let mut calls = 0;
        let mut progress = |_: f32| {
            calls += 1;
            if calls == ended_at { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        };
        let result = denoiser.denoise_with(&frame, Options { progress: Some(&mut progress), ..Options::default() });
        assert!(matches!(result, Err(Error::Cancelled)), "{result:?}");
        assert_eq!(calls, ended_at);
    }
    let mut shares = Vec::new();
    let mut progress = |share: f32| {
        shares.push(share);
        ControlFlow::Continue(())
    };
    let result = denoiser.denoise_with(&frame, Options { progress: Some(&mut progress), ..Options::default() });
    assert_same("after a cancelled run", &result.unwrap_or_else(|error| panic!("{error}")), &expected, 1.0);
    assert!(
        shares.is_sorted() && shares.len() > 3 && shares.iter().all(|share| (0.0..=1.0).contains(share)),
        "{shares:?}"
    );
}

/// One device may serve several threads; each gets its own results.
#[test]
fn threads_share_a_device() {
    let gpu = open(GpuOptions::default());
    let frames = [random_frame(29, 33, 1.0), random_frame(33, 29, 1.0)];
    std::thread::scope(|scope| {
        for frame in &frames {
            let denoiser = denoiser(&gpu, params());
            let gpu = &gpu;
            scope.spawn(move || {
                let first = denoised(&denoiser, frame);
                for _ in 0..10 {
                    assert_same("beside another thread", &denoised(&denoiser, frame), &first, 1.0);
                }
                // Each of the two threads may run the driver's callbacks for the other.
                let one = crate::common::run(gpu, |rec| rec.upload("one", &[1.0]));
                for _ in 0..2000 {
                    assert_eq!(crate::common::bits(gpu, &one), [1.0f32.to_bits()]);
                }
            });
        }
    });
}

/// Two denoisers at once on one device: each has limits, peaks and times of its own.
#[test]
fn runs_share_a_device_and_nothing_else() {
    let gpu = open(GpuOptions::default());
    gpu.set_timing(true);
    let (small, large) = (random_frame(24, 400, 1.0), random_frame(96, 80, 1.0));
    let narrow = DfcParams {
        pooled_variance: false,
        color_only: false,
        spikes: Spikes::Keep,
        window_radius: 3,
        ..DfcParams::default()
    };
    let narrow = denoiser(&gpu, narrow);
    let limit = memory_for_strips(&narrow, &small, 3, &[]);
    let limited = narrow.with_max_memory(limit);
    let free = denoiser(&gpu, params());
    let alone = [denoised(&limited, &small), denoised(&free, &large)];
    assert!(
        alone[0].strips > 1 && alone[1].peak_bytes > limit,
        "{} strips, {} bytes",
        alone[0].strips,
        alone[1].peak_bytes
    );
    std::thread::scope(|scope| {
        for (denoiser, frame, alone) in [(&limited, &small, &alone[0]), (&free, &large, &alone[1])] {
            scope.spawn(move || {
                for _ in 0..5 {
                    let beside = denoised(denoiser, frame);
                    assert_same("beside another run", &beside, alone, 1.0);
                    let stages = |estimate: &Estimate| {
                        estimate
                            .stage_times
                            .iter()
                            .flatten()
                            .map(|time| (time.stage.clone(), time.dispatches))
                            .collect::<Vec<_>>()
                    };
                    assert_eq!((beside.strips, stages(&beside)), (alone.strips, stages(alone)));
                    assert!(
                        alone.strips == 1 || beside.peak_bytes <= limit,
                        "{} bytes where {limit} are allowed",
                        beside.peak_bytes
                    );
                }
            });
        }
    });
}

#[test]
fn a_constant_image_stays_constant() {
    let noise = scene(40, 30, 55);
    let values = [0.0, 0.3, 7.0];
    let mean = image(&values.map(|value| Grid::filled(40, 30, value)));
    let frame = new_frame(
        Signal {
            mean: mean.clone(),
            half_spread: Some(image(&noise.spread)),
            variance_of_mean: Some(image(&noise.variance)),
        },
        Vec::new(),
    );
    for preset in [params(), DfcParams { window_radius: 4, ..DfcParams::thesis() }] {
        let estimate = denoised(&denoiser(gpu(), preset), &frame);
        for (plane, expected) in estimate.color.planes.iter().zip([0.0, 0.3f32, 7.0]) {
            // Each filter gives the constant to the bit; the shares of the blend sum to 1 within the last digits.
            assert!(plane.iter().all(|value| (value - expected).abs() <= 3e-7 * expected), "{expected}");
        }
    }
}

#[test]
fn a_black_image_stays_black() {
    let zero = || Image::filled(Extent { width: 31, height: 17 }, 3, 0.0);
    let frame =
        new_frame(Signal { mean: zero(), half_spread: Some(zero()), variance_of_mean: Some(zero()) }, Vec::new());
    for preset in [params(), DfcParams { window_radius: 4, ..DfcParams::thesis() }] {
        let estimate = denoised(&denoiser(gpu(), preset), &frame);
        for (name, _, image) in images(&estimate).into_iter().take(3) {
            assert!(image.planes.iter().flatten().all(|value| *value == 0.0), "{name}");
        }
        assert!(estimate.weight_sum.planes[0].iter().all(|sum| sum.is_finite() && *sum >= 1.0));
    }
}

/// Powers of two change no digit, so the result must not either: the method's small constants are not in the caller's
/// unit.
#[test]
fn the_unit_of_radiance_does_not_matter() {
    let expected = denoised(&denoiser(gpu(), params()), &random_frame(37, 41, 1.0));
    for factor in [2f32.powi(-20), 2f32.powi(20)] {
        let estimate = denoised(&denoiser(gpu(), params()), &random_frame(37, 41, factor));
        assert_same(&format!("radiance times {factor:e}"), &estimate, &expected, factor);
    }
}

/// The known noise of a frame decides which steps run; in every case the result is finite.
#[test]
fn every_kind_of_frame_has_a_result() {
    let set = noisy("caustic_ring_32spp");
    for (halves, variance) in [(true, true), (true, false), (false, true)] {
        for features in [&[][..], &["visibility"], EVERYTHING.features] {
            let frame = frame(&set, [30, 40, 33, 18], Keep { halves, variance, features });
            let estimate = denoised(&denoiser(gpu(), params()), &frame);
            assert_eq!(estimate.half_spread.is_some(), halves);
            let all = [&estimate.color, error_of(&estimate), &estimate.weight_sum, selection(&estimate)];
            assert!(
                all.iter().flat_map(|image| &image.planes).flatten().all(|value| value.is_finite()),
                "{halves} {variance} {features:?}"
            );
            for pixel in 0..33 * 18 {
                let sum: f32 = selection(&estimate).planes.iter().map(|plane| plane[pixel]).sum();
                assert!((sum - 1.0).abs() < 1e-6, "the shares of pixel {pixel} sum to {sum}");
            }
        }
    }
}
