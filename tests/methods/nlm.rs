//! NLM on the GPU: compared with float64 on parts of renders, in the situations of its callers, and compared with the
//! claims of chapter 7.

use stein::error::RequestCause;
use stein::frame::{Frame, SamplesPerPixel, Signal};
use stein::gpu::GpuOptions;
use stein::image::{Extent, Image};
use stein::method::nlm::NlmVariance;
use stein::method::{GpuFrame, GpuSignal, Method};
use stein::stage::nlm::{CentreWeight, Schedule, Symmetry, Weighting};
use stein::stage::sample::GpuSamples;
use stein::{Denoiser, DfcParams, Error, Estimate, NlmParams, Options};

use crate::behaviour::{calm_frame, image, memory_for_strips, random_frame};
use crate::bridge::{self, exposure, grids, nlm_params};
use crate::common::{assert_near, gpu, open, own_size};
use crate::frames::{EVERYTHING, Keep, error_of, frame, new_frame, noisy};
use crate::reference::keep_clean::CleanParams;
use crate::reference::nlm_method::{self, NlmParams as TwinParams, Variance};
use crate::reference::noise::NoiseParams;
use crate::reference::random::Random;
use crate::reference::spike::SpikeParams;
use crate::reference::{Grid, Planes};
use crate::twin::layer;

fn small(params: NlmParams) -> NlmParams {
    NlmParams { window_radius: 4, ..params }
}

fn denoised(params: NlmParams, frame: &Frame) -> Estimate {
    denoised_by(&Denoiser::new(gpu(), params).unwrap_or_else(|error| panic!("{error}")), frame)
}

fn denoised_by(denoiser: &Denoiser, frame: &Frame) -> Estimate {
    denoiser
        .denoise_with(frame, Options { keep: denoiser.method().intermediates(), ..Options::default() })
        .unwrap_or_else(|error| panic!("{error}"))
}

/// All images of an estimate, with names.
fn images(estimate: &Estimate) -> Vec<(&str, &Image)> {
    let named = [("colour", &estimate.color), ("error", error_of(estimate)), ("Σ w", &estimate.weight_sum)];
    let layers = estimate.layers.iter().map(|layer| (layer.name.as_str(), &layer.image));
    named.into_iter().chain(estimate.half_spread.as_ref().map(|image| ("half spread", image))).chain(layers).collect()
}

fn assert_same(what: &str, actual: &Estimate, expected: &Estimate) {
    for ((name, actual), (_, expected)) in images(actual).into_iter().zip(images(expected)) {
        let bits = |image: &Image| image.planes.iter().flatten().map(|value| value.to_bits()).collect::<Vec<_>>();
        assert!(bits(actual) == bits(expected), "{what}: {name}");
    }
    assert_eq!(images(actual).len(), images(expected).len(), "{what}");
}

/// Compares the parameters one by one: both tables come from the same text.
#[test]
fn the_presets_are_those_of_the_reference() {
    let twin = TwinParams::thesis();
    let measured = TwinParams {
        variance: Variance::Scaled,
        spikes: Some(SpikeParams::default()),
        keep_clean: Some(CleanParams::default()),
        noise: Some(NoiseParams::where_lacking()),
        ..twin
    };
    for (preset, twin) in [(NlmParams::thesis(), twin), (NlmParams::default(), measured)] {
        let mut shown = nlm_params(&preset);
        // 0.45 as a float32 is not 0.45.
        [&mut shown.filter.k, &mut shown.filter.cut]
            .into_iter()
            .for_each(|value| *value = format!("{value:.4e}").parse().unwrap_or(f64::NAN));
        assert_eq!(format!("{shown:?}"), format!("{twin:?}"));
    }
    let sampling = NlmParams::thesis().while_sampling();
    assert_eq!((sampling.window_radius, sampling.alpha), (7, 0.5));
    assert_eq!(small(NlmParams::thesis()).while_sampling().window_radius, 4);
    assert_eq!(Method::from(NlmParams::default()).while_sampling(), NlmParams::default().while_sampling().into());
}

/// Tolerance of filtered values, relative to their distance from the input.
const FILTERED: f64 = 2e-4;

/// The share of values in which rounding changes a decision: whether a pair is replaced, whether a weight is cut.
const FLIPPED: f64 = 0.01;

fn check(what: &str, frame: &Frame, params: NlmParams) {
    let estimate = denoised(params, frame);
    let exposure = exposure(frame);
    let (input, samples) = (bridge::signal(frame.color(), exposure), bridge::samples(frame, 1.0));
    let twin = nlm_method::nlm(&input, &nlm_params(&params), &samples);
    let near = |part: &str, actual: &[Grid], expected: &[Grid], size: &[Grid], relative: f64, share: f64| {
        assert_near(&format!("{what}: {part}"), actual, expected, size, relative, share);
    };
    near(
        "variance",
        &layer(&estimate, "variance_of_mean", exposure * exposure),
        &twin.variance,
        &own_size(&twin.variance, 1e-9),
        FILTERED,
        FLIPPED,
    );
    // The scale: the change of the pixel, its noise, and a hundredth of its value.
    let size = |i: usize| {
        let (u, f, v) = (&input.mean[i], &twin.mean[i], &twin.variance[i]);
        u.like(|p| (f.at(p) - u.at(p)).abs() + v.at(p).sqrt() + 0.01 * u.at(p).abs())
    };
    let size: Planes = (0..3).map(size).collect();
    near("colour", &grids(&estimate.color, exposure), &twin.mean, &size, FILTERED, FLIPPED);
    assert_eq!(estimate.half_spread.is_some(), twin.spread.is_some(), "{what}");
    if let (Some(spread), Some(expected)) =
        (estimate.half_spread.as_ref().map(|image| grids(image, exposure)), &twin.spread)
    {
        near("half spread", &spread, expected, &size, FILTERED, FLIPPED);
        let half = |sign: f64| -> Planes {
            twin.mean
                .iter()
                .zip(expected)
                .map(|(mean, spread)| mean.like(|p| mean.at(p) + sign * spread.at(p)))
                .collect()
        };
        near("half A", &layer(&estimate, "half_a", exposure), &half(1.0), &size, FILTERED, FLIPPED);
        near("half B", &layer(&estimate, "half_b", exposure), &half(-1.0), &size, FILTERED, FLIPPED);
    }
    let one = |part: &str, actual: Planes, expected: &Grid, floor: f64| {
        let expected = std::slice::from_ref(expected);
        near(part, &actual, expected, &own_size(expected, floor), 2e-3, FLIPPED);
    };
    one("Σ w", grids(&estimate.weight_sum, 1.0), &twin.weight_sum, 0.0);
    one("error", grids(error_of(&estimate), exposure * exposure), &twin.error, 0.01 * twin.error.mean());
    one("density", layer(&estimate, "density", 1.0), &twin.density, 0.01 * twin.density.mean());
}

const NO_FEATURES: Keep = Keep { features: &[], ..EVERYTHING };

#[test]
fn everything_with_the_default_preset() {
    check("cornell, default", &frame(&noisy("cornell_32spp"), [16, 20, 40, 40], NO_FEATURES), NlmParams::default());
}

#[test]
fn everything_with_the_thesis_preset() {
    check(
        "depth of field, thesis",
        &frame(&noisy("dof_spheres_32spp"), [40, 30, 40, 33], EVERYTHING),
        small(NlmParams::thesis()),
    );
}

#[test]
fn frames_that_know_less_of_their_noise() {
    let set = noisy("caustic_ring_32spp");
    for params in [NlmParams::default(), NlmParams::thesis()] {
        check("halves only", &frame(&set, [20, 30, 33, 30], Keep { variance: false, ..NO_FEATURES }), small(params));
        check("variance only", &frame(&set, [20, 30, 33, 30], Keep { halves: false, ..NO_FEATURES }), small(params));
    }
}

#[test]
fn the_original_filter() {
    let frame = frame(&noisy("cornell_32spp"), [16, 20, 33, 30], NO_FEATURES);
    check("single buffer", &frame, small(NlmParams { dual_buffer: false, ..NlmParams::default() }));
    let plain = Weighting { symmetric: Symmetry::Off, centre: CentreWeight::LargestNeighbour };
    let original = NlmParams {
        dual_buffer: false,
        variance: NlmVariance::Uniform,
        patchwise: false,
        cut: 0.0,
        weighting: plain,
        ..NlmParams::default()
    };
    check("uniform variance", &frame, small(original));
    check("bilateral", &frame, small(NlmParams { patch_radius: 0, ..NlmParams::default() }));
}

#[test]
fn pixels_with_their_own_number_of_samples() {
    let set = noisy("cornell_32spp");
    let cropped = frame(&set, [16, 20, 33, 30], NO_FEATURES);
    let counts =
        Image { extent: cropped.extent(), planes: vec![(0..33 * 30).map(|pixel| (2 + pixel % 61) as f32).collect()] };
    let (frame, _) = Frame::new(cropped.color().clone(), Vec::new(), SamplesPerPixel::PerPixel(counts))
        .unwrap_or_else(|error| panic!("{error}"));
    for dual_buffer in [true, false] {
        check("samples per pixel", &frame, small(NlmParams { dual_buffer, ..NlmParams::default() }));
    }
}

const OPTIONS: [NlmVariance; 3] = [NlmVariance::Scaled, NlmVariance::CrossFiltered, NlmVariance::Uniform];

#[test]
fn strips_and_schedules_give_the_bits_of_the_whole() {
    let frame = calm_frame(24, 300);
    for variance in OPTIONS {
        for dual_buffer in [true, false] {
            let denoiser = Denoiser::new(gpu(), small(NlmParams { variance, dual_buffer, ..NlmParams::default() }))
                .unwrap_or_else(|error| panic!("{error}"));
            let whole = denoised_by(&denoiser, &frame);
            assert_eq!(whole.strips, 1);
            let limit = memory_for_strips(&denoiser, &frame, 3, &[]);
            let strips = denoised_by(&denoiser.clone().with_max_memory(limit), &frame);
            assert!(strips.strips >= 3, "{} strips", strips.strips);
            assert_same(&format!("{variance:?}, {} strips", strips.strips), &strips, &whole);
            let schedule = Schedule { scratch_bytes: 20_000, block_rows: 5, ..Schedule::SOFTWARE };
            assert_same("another schedule", &denoised_by(&denoiser.with_schedule(schedule), &frame), &whole);
        }
    }
}

#[test]
fn strips_keep_to_the_memory_allowed() {
    // A device of its own: buffers of other tests would count.
    let gpu = open(GpuOptions::default());
    let frame = random_frame(24, 300, 1.0);
    for variance in OPTIONS {
        for dual_buffer in [true, false] {
            let denoiser = Denoiser::new(&gpu, small(NlmParams { variance, dual_buffer, ..NlmParams::default() }))
                .unwrap_or_else(|error| panic!("{error}"));
            let limit = memory_for_strips(&denoiser, &frame, 3, &[]);
            let peak = denoised_by(&denoiser.with_max_memory(limit), &frame).peak_bytes;
            assert!(peak <= limit, "{variance:?}: {peak} bytes where {limit} were allowed");
        }
    }
}

#[test]
fn whatever_the_frame_the_result_is_finite() {
    for (width, height) in [(33, 29), (1, 1), (1, 40), (2, 2)] {
        let frame = random_frame(width, height, 1.0);
        for variance in OPTIONS {
            let estimate = denoised(small(NlmParams { variance, ..NlmParams::default() }), &frame);
            for (name, image) in images(&estimate) {
                assert!(
                    image.planes.iter().flatten().all(|value| value.is_finite()),
                    "{width}×{height}, {variance:?}: {name}"
                );
            }
        }
    }
    let zero = || Image::filled(Extent { width: 31, height: 17 }, 3, 0.0);
    let black =
        new_frame(Signal { mean: zero(), half_spread: Some(zero()), variance_of_mean: Some(zero()) }, Vec::new());
    for variance in OPTIONS {
        let estimate = denoised(small(NlmParams { variance, ..NlmParams::default() }), &black);
        assert!(
            estimate.color.planes.iter().chain(&error_of(&estimate).planes).flatten().all(|value| *value == 0.0),
            "{variance:?}"
        );
        assert!(estimate.weight_sum.planes[0].iter().all(|sum| *sum >= 1.0), "{variance:?}");
    }
}

/// A known image with Gaussian noise of a known variance, and its error.
struct Noisy {
    truth: Grid,
    frame: Frame,
}

impl Noisy {
    fn new(truth: Grid, sigma: f64) -> Self {
        let (width, height) = (truth.width, truth.height);
        let mut random = Random(91);
        let mut noise = || -> Planes { (0..3).map(|_| random.gaussian_grid(width, height, 0.0, sigma)).collect() };
        let (of_mean, spread) = (noise(), noise());
        let mean: Planes = of_mean.iter().map(|noise| noise.like(|p| truth.at(p) + noise.at(p))).collect();
        let variance = vec![Grid::filled(width, height, sigma * sigma); 3];
        let color =
            Signal { mean: image(&mean), half_spread: Some(image(&spread)), variance_of_mean: Some(image(&variance)) };
        Self { truth, frame: new_frame(color, Vec::new()) }
    }

    /// Mean squared error and mean Σ w, far from the border.
    fn filtered(&self, params: NlmParams) -> (f64, f64) {
        let estimate = denoised(params, &self.frame);
        let (width, height) = (self.truth.width, self.truth.height);
        let inner: Vec<usize> = (0..width * height)
            .filter(|pixel| (16..width - 16).contains(&(pixel % width)) && (16..height - 16).contains(&(pixel / width)))
            .collect();
        let squared = |pixel: &usize| {
            estimate
                .color
                .planes
                .iter()
                .map(|plane| (f64::from(plane[*pixel]) - self.truth.values[*pixel]).powi(2))
                .sum::<f64>()
                / 3.0
        };
        let mean = |value: &dyn Fn(&usize) -> f64| inner.iter().map(value).sum::<f64>() / inner.len() as f64;
        (mean(&squared), mean(&|pixel| estimate.weight_sum.planes[0][*pixel].into()))
    }
}

/// Figure 7.6: on a ramp only neighbours across the gradient are similar; pairs of opposite neighbours are equally
/// good.
#[test]
fn symmetric_distances_widen_the_filter_on_a_ramp() {
    let ramp = Noisy::new(Grid::from_fn(64, 64, |p| 1.0 + 0.05 * p.x as f64), 0.1);
    let [(plain_error, plain_support), (error, support)] = [Symmetry::Off, Symmetry::Hard].map(|symmetric| {
        ramp.filtered(NlmParams {
            weighting: Weighting { symmetric, centre: CentreWeight::One },
            ..NlmParams::thesis()
        })
    });
    println!("Σ w {plain_support:.1} and {support:.1}, MSE {plain_error:.2e} and {error:.2e}");
    assert!(support > 1.5 * plain_support, "Σ w {support} with pairs, {plain_support} without");
    assert!(error < 0.8 * plain_error, "MSE {error} with pairs, {plain_error} without");
}

/// Figure 7.3: weights computed from the same noise that they average keep some of it.
#[test]
fn two_buffers_leave_less_noise_than_one() {
    let uniform = Noisy::new(Grid::filled(64, 64, 1.0), 0.2);
    let [(one, _), (two, _)] =
        [false, true].map(|dual_buffer| uniform.filtered(NlmParams { dual_buffer, ..NlmParams::thesis() }));
    println!("MSE {one:.2e} with one buffer, {two:.2e} with two");
    assert!(two < 0.9 * one, "MSE {two} with two buffers, {one} with one");
}

/// Figure 7.11.
#[test]
fn a_uniform_variance_is_that_of_the_image() {
    let uniform = Noisy::new(Grid::filled(64, 64, 1.0), 0.2);
    let estimate = denoised(NlmParams { variance: NlmVariance::Uniform, ..NlmParams::default() }, &uniform.frame);
    for plane in layer(&estimate, "variance_of_mean", 1.0) {
        assert!(plane.values.iter().all(|value| *value == plane.values[0]));
        // 4096 squared normals: a relative deviation of √(2/4096).
        assert!((plane.values[0] / 0.04 - 1.0).abs() < 0.1, "{}", plane.values[0]);
    }
}

#[test]
fn parameters_out_of_range_are_refused() {
    let wrong = [
        (NlmParams { window_radius: 0, ..NlmParams::default() }, "`window_radius` cannot be 0"),
        (NlmParams { window_radius: 65, ..NlmParams::default() }, "`window_radius` cannot be 65"),
        (NlmParams { patch_radius: 6, ..NlmParams::default() }, "`patch_radius` cannot be 6"),
        (NlmParams { k: 0.0, ..NlmParams::default() }, "`k` cannot be 0"),
        (NlmParams { alpha: f32::NAN, ..NlmParams::default() }, "`alpha` cannot be NaN"),
        (NlmParams { cut: 1.5, ..NlmParams::default() }, "`cut` cannot be 1.5"),
    ];
    for (params, said) in wrong {
        let refused = Denoiser::new(gpu(), params).map(drop);
        let Err(error @ Error::Request(RequestCause::ParameterValue { .. })) = refused else {
            panic!("{params:?} is accepted")
        };
        assert_eq!(error.problem(), said);
    }
    let hard = Weighting { symmetric: Symmetry::Hard, centre: CentreWeight::One };
    assert!(matches!(
        Denoiser::new(gpu(), DfcParams { weighting: hard, ..DfcParams::default() }),
        Err(Error::Request { .. })
    ));
}

/// A renderer's own frame must state the mean variance of its image for the uniform variance.
#[test]
fn a_uniform_variance_that_nobody_knows_is_refused() {
    let denoiser = Denoiser::new(gpu(), NlmParams { variance: NlmVariance::Uniform, ..NlmParams::default() })
        .unwrap_or_else(|error| panic!("{error}"));
    let mut rec = gpu().record_whole();
    let signal = rec.upload("signal", &[0.5; 8]).unwrap_or_else(|error| panic!("{error}"));
    let color = GpuSignal { signal: signal.into(), variance_of_mean: None, has_halves: true };
    let frame = GpuFrame {
        extent: glam::IVec2::ONE,
        color,
        features: Vec::new(),
        samples: GpuSamples::Uniform(1.0),
        mean_variance: None,
        payload: Vec::new(),
    };
    let refused = denoiser.record(&mut rec, frame, Vec::new()).map(drop);
    assert!(
        matches!(refused, Err(Error::Request(RequestCause::Misuse { .. }))),
        "a variance out of nowhere: {refused:?}"
    );
}
