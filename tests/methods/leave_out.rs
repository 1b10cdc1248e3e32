//! Steps that a plan leaves out do not change the result, compared with a run of everything. The steps that run are
//! those of the plan.

use stein::frame::Signal;
use stein::gpu::{Gpu, GpuOptions};
use stein::image::Extent;
use stein::method::dfc::CandidateSet;
use stein::method::{DfcPlan, Intermediate, MethodPlan, Plan, PlannedStep};
use stein::stage::nlm::Schedule;
use stein::{Denoiser, DfcParams, Estimate, Frame, GemParams, Image, Method, NlmParams, Options};

use crate::behaviour::{assert_same, image, memory_for_strips, memory_for_strips_of_window};
use crate::common::{calm_scene, gpu, open};
use crate::frames::{EVERYTHING, Keep, error_of, frame, new_frame, noisy};
use crate::reference::{Grid, Point};

/// The schedule whose kernels compile fastest: most of them run once here.
fn denoiser(gpu: &Gpu, method: impl Into<Method>) -> Denoiser {
    let schedule = Schedule { pixels: 1, offset_rows: 1, ..Schedule::SOFTWARE };
    Denoiser::new(gpu, method).unwrap_or_else(|error| panic!("{error}")).with_schedule(schedule)
}

fn small(params: DfcParams) -> DfcParams {
    DfcParams { window_radius: 4, ..params }
}

fn run(denoiser: &Denoiser, frame: &Frame, options: Options) -> Estimate {
    denoiser.denoise_with(frame, options).unwrap_or_else(|error| panic!("{error}"))
}

/// Denoises as planned, and with everything on.
fn both(method: impl Into<Method>, frame: &Frame, keep: &[Intermediate], error: bool) -> [Estimate; 2] {
    let planned = denoiser(gpu(), method);
    [&planned, &planned.clone().with_everything()]
        .map(|denoiser| run(denoiser, frame, Options { keep, error, ..Options::default() }))
}

fn left_out(estimate: &Estimate) -> Vec<String> {
    estimate.plan.steps().iter().filter(|planned| !planned.runs).map(|planned| planned.name.clone()).collect()
}

/// The plan of DFC.
pub(crate) fn dfc(plan: &Plan) -> &DfcPlan {
    match &plan.method {
        MethodPlan::Dfc(plan) => plan,
        other => panic!("a plan of another method: {other:?}"),
    }
}

/// The step that prefilters a feature.
fn prefilter<'a>(plan: &'a Plan, feature: &str) -> &'a PlannedStep {
    let name = format!("prefilter {feature}");
    dfc(plan).prefilters.iter().find(|step| step.name == name).unwrap_or_else(|| panic!("no step {name}"))
}

fn crop(features: &'static [&'static str]) -> Frame {
    frame(&noisy("cornell_8spp"), [8, 56, 48, 40], Keep { features, ..EVERYTHING })
}

/// The same signal, known to have no noise.
fn exact(signal: &Signal) -> Signal {
    let zero = || Some(Image::filled(signal.mean.extent, signal.mean.channels(), 0.0));
    Signal { mean: signal.mean.clone(), half_spread: zero(), variance_of_mean: zero() }
}

/// The frame with these features marked as free of noise. Their values keep the noise, which is the hardest case.
fn with_exact_features(frame: &Frame, names: &[&str]) -> Frame {
    let features = frame.features().iter().map(|feature| {
        let signal =
            if names.contains(&feature.name.as_str()) { exact(&feature.signal) } else { feature.signal.clone() };
        (feature.name.clone(), signal)
    });
    new_frame(frame.color().clone(), features.collect())
}

/// The largest difference between two values of images.
fn farthest(a: &Image, b: &Image) -> f32 {
    a.planes.iter().flatten().zip(b.planes.iter().flatten()).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

fn root_mean_square(a: &Image, b: &Image) -> f64 {
    let squares = a.planes.iter().flatten().zip(b.planes.iter().flatten()).map(|(a, b)| f64::from(a - b).powi(2));
    (squares.sum::<f64>() / (a.channels() * a.extent.pixels()) as f64).sqrt()
}

/// Two pixels without variance whose patches differ by more than a distance of 25 have no weight that counts: e⁻²⁵
/// each, even hundreds of them against a centre of 10⁻³. The distance is the mean over the channels and the (2f+1)²
/// pixels of δ²/10⁻¹⁰, to which the pixel itself contributes its part.
fn resolution(channels: usize, patch_radius: u32) -> f64 {
    1.01 * (25.0 * channels as f64 * f64::from(2 * patch_radius + 1).powi(2) * 1e-10).sqrt()
}

/// A feature without noise, filtered by its own values, is an average of values that differ by no more than the filter
/// resolves. This changes the distances of features (in squares of the unit range, divided by at least k_f²·2τ =
/// 3.6·10⁻⁴) by a seventh where weights count, such as for two values 0.02 apart. Single pixels on an edge may take
/// other neighbours, but over all pixels the change is a hundredth of the filter's correction.
#[test]
fn features_without_noise_are_not_prefiltered() {
    let names: [&str; 2] = ["albedo", "depth"];
    let frame = with_exact_features(&crop(&["albedo", "depth", "normal"]), &names);
    for params in [small(DfcParams::default()), small(DfcParams::thesis())] {
        let [planned, everything] = both(params, &frame, &[Intermediate::Features], true);
        assert!(names.iter().all(|name| !prefilter(&planned.plan, name).runs), "{:?}", left_out(&planned));
        assert!(prefilter(&planned.plan, "normal").runs, "{:?}", planned.plan);
        assert!(prefilter(&everything.plan, "albedo").runs, "{:?}", everything.plan);
        for (layer, of_everything) in planned.layers.iter().zip(&everything.layers) {
            let Some(feature) = frame.features().iter().find(|feature| layer.name.starts_with(&feature.name)) else {
                panic!("{}", layer.name)
            };
            let is_exact = names.contains(&feature.name.as_str());
            let most = if is_exact && layer.name.ends_with("prefiltered") {
                resolution(feature.signal.mean.channels(), 3)
            } else {
                0.0
            };
            let off = f64::from(farthest(&layer.image, &of_everything.image)) / f64::from(feature.unit_scale.abs());
            assert!(off <= most, "{}: {off} where {most} is the most", layer.name);
        }
        let (changed, filtered) = (
            root_mean_square(&planned.color, &everything.color),
            root_mean_square(&planned.color, &frame.color().mean),
        );
        assert!(changed <= 0.01 * filtered, "{changed} of {filtered}");
    }
}

/// A feature of unknown noise, and a feature that is known to have no noise: the results are equal.
#[test]
fn a_feature_without_known_noise_is_as_one_without_noise() {
    let frame = crop(&["depth", "normal"]);
    let known = with_exact_features(&frame, &["depth", "normal"]);
    let features = frame.features().iter().map(|feature| {
        (feature.name.clone(), Signal { half_spread: None, variance_of_mean: None, ..feature.signal.clone() })
    });
    let unknown = new_frame(frame.color().clone(), features.collect());
    let [known, unknown] =
        [known, unknown].map(|frame| run(&denoiser(gpu(), small(DfcParams::default())), &frame, Options::default()));
    assert_same("noise that is 0 or unknown", &known, &unknown, 1.0);
}

#[test]
fn features_that_are_not_used_are_explained() {
    let frame = crop(&["albedo", "normal"]);
    let mut features: Vec<_> =
        frame.features().iter().map(|feature| (feature.name.clone(), feature.signal.clone())).collect();
    let without = new_frame(frame.color().clone(), features.clone());
    features.push((
        "paint".into(),
        exact(&Signal { mean: Image::filled(frame.extent(), 1, 0.5), half_spread: None, variance_of_mean: None }),
    ));
    let with_constant = new_frame(frame.color().clone(), features);
    let [with_constant, without] = [&with_constant, &without]
        .map(|frame| run(&denoiser(gpu(), small(DfcParams::default())), frame, Options::default()));
    assert_same("a constant feature", &with_constant, &without, 1.0);
    let [step] = dfc(&with_constant.plan).unused_features.as_slice() else { panic!("{:?}", with_constant.plan) };
    assert!(step.name == "feature paint" && !step.runs && step.why.contains("same everywhere"), "{step:?}");
    let none = run(&denoiser(gpu(), small(DfcParams::default())), &crop(&[]), Options::default());
    assert!(left_out(&none).contains(&"features".to_owned()), "{:?}", none.plan);
}

/// FIRST with the patches of SECOND has the derivative of SECOND, but wins only with a smaller one.
#[test]
fn first_with_the_patches_of_second_is_left_out() {
    let frame = crop(&["albedo", "normal"]);
    for params in [small(DfcParams::default()), small(DfcParams::thesis())] {
        let [planned, everything] = both(DfcParams { first_patch_radius: 3, ..params }, &frame, &[], true);
        assert!(
            left_out(&planned).contains(&"first".to_owned()) && !left_out(&everything).contains(&"first".to_owned())
        );
        assert_same("without FIRST", &planned, &everything, 1.0);
    }
}

#[test]
fn one_candidate_is_not_chosen() {
    let frame = crop(&["albedo", "normal"]);
    let none = CandidateSet { first: false, second: false, third: false };
    for candidates in [
        CandidateSet { first: true, ..none },
        CandidateSet { second: true, ..none },
        CandidateSet { third: true, ..none },
    ] {
        for params in [small(DfcParams::default()), small(DfcParams::thesis())] {
            let params = DfcParams { candidates, ..params };
            let [planned, everything] = both(params, &frame, &[], true);
            assert!(
                ["selection", "selection smoothing", "blend"]
                    .iter()
                    .all(|step| left_out(&planned).contains(&(*step).to_owned()))
            );
            assert_same(&format!("{candidates} alone"), &planned, &everything, 1.0);
            let shares: Vec<f32> = planned
                .selection
                .iter()
                .flat_map(|maps| &maps.planes)
                .map(|plane| plane.iter().sum::<f32>() / plane.len() as f32)
                .collect();
            assert_eq!(shares, candidates.flags().map(|takes_part| f32::from(u8::from(takes_part))));

            let [without_error, _] = both(params, &frame, &[], false);
            assert!(
                ["SURE", "SURE smoothing"].iter().all(|step| left_out(&without_error).contains(&(*step).to_owned()))
            );
            assert!(
                without_error.error.is_none()
                    && without_error.color == planned.color
                    && without_error.weight_sum == planned.weight_sum
            );
        }
    }
}

#[test]
fn without_its_error_the_result_is_the_same() {
    let frame = crop(&["albedo"]);
    let without_halves = new_frame(Signal { half_spread: None, ..frame.color().clone() }, Vec::new());
    for method in [
        small(DfcParams::default()).into(),
        NlmParams { window_radius: 4, ..NlmParams::default() }.into(),
        GemParams::default().into(),
    ] {
        let method: Method = method;
        let denoiser = denoiser(gpu(), method);
        let [with, without] =
            [true, false].map(|error| run(&denoiser, &frame, Options { error, ..Options::default() }));
        assert!(without.error.is_none() && with.error.is_some());
        assert!(
            with.color == without.color
                && with.half_spread == without.half_spread
                && with.weight_sum == without.weight_sum,
            "{}",
            method.name()
        );
        // Without halves, the remaining variance serves the error alone.
        let [with, without] =
            [true, false].map(|error| run(&denoiser, &without_halves, Options { error, ..Options::default() }));
        assert!(
            with.color == without.color && with.weight_sum == without.weight_sum,
            "{} without halves",
            method.name()
        );
        // The sampling density needs the error.
        let [with, without] = [true, false].map(|error| {
            run(&denoiser, &frame, Options { error, keep: &[Intermediate::Density], ..Options::default() })
        });
        assert_eq!(with.layers[0].image, without.layers[0].image, "{}", method.name());
    }
}

/// Ramps that differ by less and by more than the filter resolves. The features are equal, so THIRD would average over
/// all of them.
fn noise_free_frame() -> Frame {
    let color = (0..3).map(|channel| {
        let step = [1e-5, 1e-3, 0.2][channel];
        Grid::from_fn(48, 40, |p: Point| {
            0.5 + step * (p.x as f64 + 0.3 * p.y as f64) + if p.x / 12 % 2 == 1 { 0.7 } else { 0.0 }
        })
    });
    let feature = calm_scene(48, 40, 71);
    let color = exact(&Signal { mean: image(&color.collect::<Vec<_>>()), half_spread: None, variance_of_mean: None });
    new_frame(
        color,
        vec![(
            "paint".into(),
            Signal { mean: image(&feature.mean), half_spread: Some(image(&feature.spread)), variance_of_mean: None },
        )],
    )
}

#[test]
fn a_frame_without_noise_is_copied() {
    let frame = noise_free_frame();
    let [planned, everything] = both(small(DfcParams::default()), &frame, &[], true);
    assert!(planned.plan.steps().iter().all(|planned| !planned.runs), "{:?}", planned.plan);
    assert!(planned.color == frame.color().mean && planned.half_spread == frame.color().half_spread);
    assert!(
        error_of(&planned).planes[0]
            .iter()
            .chain(&planned.half_spread.iter().flat_map(|image| image.planes.concat()).collect::<Vec<_>>())
            .all(|v| *v == 0.0)
    );
    // The brightest channel of the median pixel is between 2 and 4, so that the frame is halved on the device; the
    // second pass resolves by larger patches.
    let most = 4.0 * (resolution(3, 1) + resolution(3, 3));
    let off = f64::from(farthest(&planned.color, &everything.color));
    assert!(off <= most, "{off} where {most} is the most");
    let off = f64::from(farthest(error_of(&planned), error_of(&everything)));
    assert!(off <= 3.0 * most * most, "an error of {off}");

    // A frame whose result may differ from a copy is not copied.
    let third = CandidateSet { first: false, second: false, third: true };
    let other = [small(DfcParams::thesis()), DfcParams { candidates: third, ..small(DfcParams::default()) }];
    for params in other {
        assert!(dfc(&run(&denoiser(gpu(), params), &frame, Options::default()).plan).candidates.runs);
    }
    let kept = run(
        &denoiser(gpu(), small(DfcParams::default())),
        &frame,
        Options { keep: &[Intermediate::Pass1], ..Options::default() },
    );
    assert_eq!(kept.layers.len(), 1);
}

/// A render whose left part is empty and without noise, in the colour and in all features.
fn half_empty_frame() -> Frame {
    let render =
        frame(&noisy("cornell_8spp"), [0, 32, 96, 64], Keep { features: &["albedo", "depth", "normal"], ..EVERYTHING });
    let emptied = |signal: &Signal| {
        let cleared = |image: &Image| {
            let mut image = image.clone();
            image.planes.iter_mut().flat_map(|plane| plane.chunks_exact_mut(96)).for_each(|row| row[..56].fill(0.0));
            image
        };
        Signal {
            mean: cleared(&signal.mean),
            half_spread: signal.half_spread.as_ref().map(cleared),
            variance_of_mean: signal.variance_of_mean.as_ref().map(cleared),
        }
    };
    let features = render.features().iter().map(|feature| (feature.name.clone(), emptied(&feature.signal)));
    new_frame(emptied(render.color()), features.collect())
}

/// Tiles that no noise reaches are copied. Other pixels change only by the prefilter of exact features, and copied
/// pixels differ by no more than the filters resolve.
#[test]
fn tiles_without_noise_are_copied() {
    let frame = half_empty_frame();
    let [planned, everything] = both(small(DfcParams::default()), &frame, &[], true);
    let steps = |estimate: &Estimate| {
        let DfcPlan { candidates, sure_smoothing, selection_smoothing, second_pass, .. } = dfc(&estimate.plan).clone();
        [candidates, sure_smoothing, selection_smoothing, second_pass, prefilter(&estimate.plan, "depth").clone()]
    };
    for (step, of_everything) in steps(&planned).into_iter().zip(steps(&everything)) {
        assert!((0.2..0.6).contains(&step.skipped) && of_everything.skipped == 0.0, "{step:?}");
    }
    // The window, the patch and the smoothing reach 15 pixels, and so two tiles.
    let copied = |image: &Image| {
        image
            .planes
            .iter()
            .flat_map(|plane| plane.chunks_exact(96))
            .flat_map(|row| row[..40].to_vec())
            .collect::<Vec<_>>()
    };
    assert_eq!(copied(&planned.color), copied(&frame.color().mean));
    assert!(copied(&planned.weight_sum).iter().all(|sum| *sum == 1.0));
    let (changed, filtered) =
        (root_mean_square(&planned.color, &everything.color), root_mean_square(&planned.color, &frame.color().mean));
    assert!(changed <= 0.002 * filtered, "{changed} of {filtered}");
    // If only the colour is compared, only the copies differ.
    let plain = new_frame(frame.color().clone(), Vec::new());
    let [planned, everything] = both(small(DfcParams::default()), &plain, &[], true);
    let most = f64::from(frame.color().mean.planes.iter().flatten().fold(0.0f32, |most, value| most.max(value.abs())));
    let off = f64::from(farthest(&planned.color, &everything.color));
    assert!(off <= 1e-6 * most, "{off} of {most}");

    // The image before the second pass is copied as well, so that requesting it changes nothing.
    let keeping = run(
        &denoiser(gpu(), small(DfcParams::default())),
        &plain,
        Options { keep: &[Intermediate::Pass1], ..Options::default() },
    );
    assert_same("keeping pass 1", &keeping, &planned, 1.0);
    assert!(
        keeping.plan.steps() == planned.plan.steps() && copied(&keeping.layers[0].image) == copied(&plain.color().mean)
    );
    // Intermediates that differ in exact tiles are computed there.
    let kept = run(
        &denoiser(gpu(), small(DfcParams::default())),
        &frame,
        Options { keep: &[Intermediate::Candidates], ..Options::default() },
    );
    assert_eq!(dfc(&kept.plan).candidates.skipped, 0.0);
}

#[test]
fn tiles_are_those_of_the_frame_in_every_strip() {
    let tall = stacked(&half_empty_frame());
    let whole = run(&denoiser(gpu(), small(DfcParams::default())), &tall, Options::default());
    assert!(dfc(&whole.plan).candidates.skipped > 0.2);
    // A device of its own: buffers of other tests would count.
    let gpu = open(GpuOptions::default());
    let in_strips = denoiser(&gpu, small(DfcParams::default()));
    let limit = memory_for_strips(&in_strips, &tall, 2, &[]);
    let in_strips = run(&in_strips.with_max_memory(limit), &tall, Options::default());
    assert!(
        in_strips.strips >= 2 && in_strips.peak_bytes <= limit,
        "{} strips, {} bytes",
        in_strips.strips,
        in_strips.peak_bytes
    );
    assert_same("in strips", &in_strips, &whole, 1.0);
}

/// In a window of frames, noise in any of them counts; with candidates left out, and in strips as well.
#[test]
fn tiles_of_a_window_have_no_noise_in_any_of_its_frames() {
    let tall = stacked(&half_empty_frame());
    let plain = |frame: &Frame, columns: usize| {
        let noise = |image: &Image| {
            let mut image = image.clone();
            image
                .planes
                .iter_mut()
                .flat_map(|plane| plane.chunks_exact_mut(96))
                .for_each(|row| row[columns..56].fill(0.01));
            image
        };
        let color = frame.color();
        let [half_spread, variance_of_mean] =
            [&color.half_spread, &color.variance_of_mean].map(|image| image.as_ref().map(noise));
        new_frame(Signal { mean: color.mean.clone(), half_spread, variance_of_mean }, Vec::new())
    };
    let (own, beside) = (plain(&tall, 56), plain(&tall, 40));
    let params =
        DfcParams { candidates: CandidateSet { first: false, ..CandidateSet::ALL }, ..small(DfcParams::default()) };
    let window = |denoiser: &Denoiser| {
        denoiser.denoise_window(&[&own, &beside], 0, Options::default()).unwrap_or_else(|error| panic!("{error}"))
    };
    let planned = denoiser(gpu(), params);
    let (whole, everything) = (window(&planned), window(&planned.clone().with_everything()));
    let alone = planned.plan(&[&own], 0, &Options::default()).unwrap_or_else(|error| panic!("{error}"));
    let share = |plan: &Plan| dfc(plan).candidates.skipped;
    assert!(
        0.2 < share(&whole.plan) && share(&whole.plan) < share(&alone) - 0.1,
        "{} {}",
        share(&whole.plan),
        share(&alone)
    );
    let most = f64::from(own.color().mean.planes.iter().flatten().fold(0.0f32, |most, value| most.max(value.abs())));
    let off = f64::from(farthest(&whole.color, &everything.color));
    assert!(off <= 1e-6 * most, "{off} of {most}");

    // A device of its own: buffers of other tests would count.
    let gpu = open(GpuOptions::default());
    let in_strips = denoiser(&gpu, params);
    let limit = memory_for_strips_of_window(&in_strips, &[&own, &beside], 2, &[]);
    let in_strips = window(&in_strips.with_max_memory(limit));
    assert!(in_strips.strips >= 2, "{} strips", in_strips.strips);
    assert_same("in strips", &in_strips, &whole, 1.0);
}

#[test]
fn a_grey_frame_is_filtered_by_one_channel() {
    let grey = |image: &Image| Image { planes: vec![image.planes[1].clone(); 3], ..image.clone() };
    let crop = crop(&["depth"]);
    let color = crop.color();
    let color = Signal {
        mean: grey(&color.mean),
        half_spread: color.half_spread.as_ref().map(grey),
        variance_of_mean: color.variance_of_mean.as_ref().map(grey),
    };
    let frame = new_frame(
        color,
        crop.features().iter().map(|feature| (feature.name.clone(), feature.signal.clone())).collect(),
    );
    let [planned, everything] = both(
        small(DfcParams::default()),
        &frame,
        &[Intermediate::Candidates, Intermediate::Derivatives, Intermediate::Density],
        true,
    );
    assert!(
        left_out(&planned).contains(&"three channels".to_owned())
            && !left_out(&everything).contains(&"three channels".to_owned())
    );
    assert_same("a grey frame", &planned, &everything, 1.0);
    for (layer, of_everything) in planned.layers.iter().zip(&everything.layers) {
        assert_eq!(layer.image, of_everything.image, "{}", layer.name);
    }
    let window = |everything: bool| {
        let denoiser = denoiser(gpu(), small(DfcParams::default()));
        let denoiser = if everything { denoiser.with_everything() } else { denoiser };
        denoiser.denoise_window(&[&frame, &frame], 0, Options::default()).unwrap_or_else(|error| panic!("{error}"))
    };
    assert_same("a grey window", &window(false), &window(true), 1.0);
}

#[test]
fn in_strips_less_is_left_out_of_the_same_bits() {
    let (extent, names) = ([16, 0, 24, 96], ["albedo", "depth"]);
    let frame = with_exact_features(
        &frame(&noisy("cornell_8spp"), extent, Keep { features: &["albedo", "depth", "normal"], ..EVERYTHING }),
        &names,
    );
    let tall = stacked(&frame);
    let params =
        DfcParams { candidates: CandidateSet { first: false, ..CandidateSet::ALL }, ..small(DfcParams::default()) };
    let whole = run(&denoiser(gpu(), params), &tall, Options::default());
    // A device of its own: buffers of other tests would count.
    let gpu = open(GpuOptions::default());
    let in_strips = denoiser(&gpu, params);
    let limit = memory_for_strips(&in_strips, &tall, 2, &[]);
    let in_strips = run(&in_strips.with_max_memory(limit), &tall, Options::default());
    assert!(in_strips.strips >= 2 && in_strips.strips == in_strips.plan.strips, "{}", in_strips.strips);
    assert!(in_strips.peak_bytes <= limit, "{} bytes", in_strips.peak_bytes);
    assert_same("in strips", &in_strips, &whole, 1.0);
}

/// A signal of four times the height.
fn stacked(frame: &Frame) -> Frame {
    let stack = |image: &Image| Image {
        extent: Extent { height: 4 * image.extent.height, ..image.extent },
        planes: image.planes.iter().map(|plane| plane.repeat(4)).collect(),
    };
    let signal = |signal: &Signal| Signal {
        mean: stack(&signal.mean),
        half_spread: signal.half_spread.as_ref().map(stack),
        variance_of_mean: signal.variance_of_mean.as_ref().map(stack),
    };
    new_frame(
        signal(frame.color()),
        frame.features().iter().map(|feature| (feature.name.clone(), signal(&feature.signal))).collect(),
    )
}

/// Every step that the plan runs takes time, except the single candidates, which are parts of one step. Steps that are
/// left out take no time.
#[test]
fn times_are_those_of_the_plan() {
    let gpu = open(GpuOptions::default());
    if !gpu.set_timing(true) {
        return;
    }
    let full = crop(&["albedo", "normal"]);
    let with = |halves, variance| {
        frame(&noisy("cornell_8spp"), [16, 20, 24, 20], Keep { halves, variance, features: &["depth"] })
    };
    let frames = [with_exact_features(&full, &["albedo"]), with(false, true), with(true, false), crop(&[])];
    let first = DfcParams {
        candidates: CandidateSet { second: false, third: false, ..CandidateSet::ALL },
        ..small(DfcParams::default())
    };
    let nlm = NlmParams { window_radius: 3, ..NlmParams::default() };
    let methods: [Method; 5] = [
        small(DfcParams::default()).into(),
        first.into(),
        nlm.into(),
        NlmParams { dual_buffer: false, ..nlm }.into(),
        GemParams::default().into(),
    ];
    for method in methods {
        let denoiser = denoiser(&gpu, method);
        for frame in &frames {
            for (keep, error) in [(&[][..], false), (&[Intermediate::Density][..], true)] {
                times_are_of(&run(&denoiser, frame, Options { keep, error, ..Options::default() }), method.name());
            }
        }
        if method.filters_in_time() {
            let window = denoiser
                .denoise_window(&[&full, &full], 0, Options::default())
                .unwrap_or_else(|error| panic!("{error}"));
            times_are_of(&window, method.name());
        }
    }
}

fn times_are_of(estimate: &Estimate, what: &str) {
    let Some(times) = &estimate.step_times else { panic!("{what}: no times") };
    let mut timed: Vec<&str> = times.iter().map(|time| time.step.as_str()).collect();
    timed.dedup();
    timed.sort_unstable();
    timed.dedup();
    let parts = ["first", "second", "third", "derivatives", "half spread", "three channels"];
    let mut planned: Vec<String> = estimate
        .plan
        .steps()
        .iter()
        .filter(|planned| planned.runs && !parts.contains(&planned.name.as_str()))
        .map(|planned| planned.name.clone())
        .collect();
    planned.sort_unstable();
    assert_eq!(timed, planned, "{what}: {:?}", estimate.plan);
    let sum = |seconds: &mut dyn Iterator<Item = f64>| seconds.sum::<f64>();
    let stages = estimate.stage_times.iter().flatten().map(|time| time.seconds);
    let difference = sum(&mut times.iter().map(|time| time.time.seconds)) - sum(&mut stages.into_iter());
    assert!(difference.abs() < 1e-9, "{what}: {difference} s");
}
