//! The kernels at a pixel: they reproduce the result of the method, and describe the neighbours.

use stein::error::{Remedy, RequestCause};
use stein::frame::Signal;
use stein::image::{Extent, Image};
use stein::kernels::{Compared, WeightRule};
use stein::method::dfc::CandidateSet;
use stein::method::dfc::SecondPass;
use stein::method::nlm::NlmVariance;
use stein::method::{Intermediate, Method, Spikes};
use stein::stage::nlm::{CentreWeight, Schedule, Symmetry, Weighting};
use stein::{Denoiser, DfcParams, Error, Estimate, FilterKernel, Frame, GemParams, Kernels, NlmParams, Options};

use crate::behaviour::{calm_frame, random_frame};
use crate::common::gpu;
use crate::frames::{EVERYTHING, Keep, frame, new_frame, noisy};
use crate::leave_out::dfc;

/// The schedule whose kernels compile fastest.
fn denoiser(method: impl Into<Method>) -> Denoiser {
    let schedule = Schedule { pixels: 1, offset_rows: 1, ..Schedule::SOFTWARE };
    Denoiser::new(gpu(), method).unwrap_or_else(|error| panic!("{error}")).with_schedule(schedule)
}

fn small(params: DfcParams) -> DfcParams {
    DfcParams { window_radius: 4, ..params }
}

fn kernels(denoiser: &Denoiser, frame: &Frame, (x, y): (u32, u32), keep: &[Intermediate]) -> Kernels {
    denoiser.kernels(frame, x, y, &Options { keep, ..Options::default() }).unwrap_or_else(|error| panic!("{error}"))
}

fn denoised(denoiser: &Denoiser, frame: &Frame, keep: &[Intermediate]) -> Estimate {
    denoiser.denoise_with(frame, Options { keep, ..Options::default() }).unwrap_or_else(|error| panic!("{error}"))
}

fn at(image: &Image, (x, y): (u32, u32)) -> Vec<f32> {
    image.planes.iter().map(|plane| plane[(y * image.extent.width + x) as usize]).collect()
}

fn at_cell(image: &Image, cell: usize) -> Vec<f32> {
    image.planes.iter().map(|plane| plane[cell]).collect()
}

fn layer<'a>(estimate: &'a Estimate, name: &str) -> &'a Image {
    &estimate.layers.iter().find(|layer| layer.name == name).unwrap_or_else(|| panic!("no layer {name}")).image
}

/// Corners, edges and inner pixels.
fn places(extent: Extent) -> Vec<(u32, u32)> {
    let (right, bottom) = (extent.width - 1, extent.height - 1);
    let mut places = vec![
        (0, 0),
        (right, 0),
        (0, bottom),
        (right, bottom),
        (right / 2, 0),
        (right, bottom / 3),
        (right / 2, bottom / 2),
        (right / 3, 2 * bottom / 3),
    ];
    places.sort_unstable();
    places.dedup();
    places
}

/// Tolerance of a weighted average in float32 against one in float64, relative to the averaged values: some hundred
/// rounded terms.
const ROUNDING: f64 = 3e-6;

/// Checks that the weights give the value, that the value is that of the method, and that the images agree.
#[track_caller]
fn check(what: &str, kernel: &FilterKernel, expected: &[f32], place: (u32, u32), extent: Extent) {
    let what = format!("{what}: {} at {place:?}", kernel.name);
    let weights = &kernel.weights.planes[0];
    let (side, middle) = (kernel.side(), weights.len() / 2);
    assert_eq!((side, weights.len()), (2 * kernel.window_radius as usize + 1, side * side), "{what}");
    assert_eq!(kernel.pixel(middle), Some(place), "{what}");
    assert!(weights[middle] > 0.0, "{what}: the pixel weighs {}", weights[middle]);
    for (cell, &weight) in weights.iter().enumerate() {
        let (dx, dy) = (
            (cell % side) as i64 - i64::from(kernel.window_radius),
            (cell / side) as i64 - i64::from(kernel.window_radius),
        );
        let (x, y) = (i64::from(place.0) + dx, i64::from(place.1) + dy);
        let is_inside = (0..i64::from(extent.width)).contains(&x) && (0..i64::from(extent.height)).contains(&y);
        assert_eq!(kernel.pixel(cell), is_inside.then_some((x as u32, y as u32)), "{what}: {dx}, {dy}");
        let distances = kernel
            .distances
            .iter()
            .map(|distance| (distance.distances.planes[0][cell], distance.weights.planes[0][cell]));
        if !is_inside {
            assert_eq!(weight, 0.0, "{what}: {dx}, {dy}");
            assert!(
                distances.into_iter().all(|(distance, weight)| distance == f32::INFINITY && weight == 0.0),
                "{what}: {dx}, {dy}"
            );
        } else if cell == middle {
            assert!(distances.into_iter().all(|(distance, weight)| distance == 0.0 && weight == 1.0), "{what}");
            assert!(kernel.decided_by(cell).is_none(), "{what}");
        } else {
            assert!(
                distances.clone().all(|(distance, weight)| distance.is_finite() && (0.0..=1.0).contains(&weight)),
                "{what}: {dx}, {dy}"
            );
            if kernel.rule == WeightRule::Least {
                assert_eq!(weight, distances.map(|(_, weight)| weight).fold(1.0, f32::min), "{what}: {dx}, {dy}");
            }
            let least = kernel.decided_by(cell).map_or(1.0, |distance| distance.weights.planes[0][cell]);
            assert!(kernel.rule != WeightRule::Least || weight == least, "{what}: {dx}, {dy}");
        }
    }

    let sum: f64 = weights.iter().map(|weight| f64::from(*weight)).sum();
    assert!(
        (f64::from(kernel.weight_sum) - sum).abs() <= 1e-6 * sum,
        "{what}: Σ w is {} and not {sum}",
        kernel.weight_sum
    );
    for (channel, (colors, expected)) in kernel.colors.planes.iter().zip(expected).enumerate() {
        let centre = f64::from(colors[middle]);
        let average = |value: &dyn Fn(f64) -> f64| {
            colors.iter().zip(weights).map(|(u, w)| f64::from(*w) * value(f64::from(*u) - centre)).sum::<f64>() / sum
        };
        let (mean, span) = (centre + average(&|off| off), average(&f64::abs) + 0.01 * centre.abs());
        for (of, value) in [("itself", kernel.value[channel]), ("the method", *expected)] {
            let off = (f64::from(value) - mean).abs();
            assert!(
                off <= ROUNDING * span + 1e-7 * centre.abs() + f64::from(f32::MIN_POSITIVE),
                "{what}, channel {channel}: {mean} from the weights, {value} of {of}: {} of a span of {span}",
                off / span
            );
        }
    }
}

/// Names of the filters: the candidates that take part, and the second pass.
#[track_caller]
fn check_dfc(what: &str, frame: &Frame, params: DfcParams) {
    check_dfc_of(what, frame, &denoiser(params), params.candidates);
}

#[track_caller]
fn check_dfc_of(what: &str, frame: &Frame, denoiser: &Denoiser, expected: CandidateSet) {
    let keep = [Intermediate::Candidates, Intermediate::Pass1];
    let estimate = denoised(denoiser, frame, &keep);
    for place in places(frame.extent()) {
        let kernels = kernels(denoiser, frame, place, &keep);
        assert_eq!((kernels.x, kernels.y), place);
        assert_eq!(kernels.plan.method, estimate.plan.method, "{what}");
        let second_pass = kernels.filters.iter().position(|filter| filter.name == "second_pass");
        assert_eq!(second_pass.is_some(), dfc(&estimate.plan).second_pass.runs, "{what}");
        let (candidates, second_pass) = kernels.filters.split_at(second_pass.unwrap_or(kernels.filters.len()));
        check_blend(what, &estimate, candidates, place);
        for filter in second_pass {
            check_second_pass(what, denoiser.method(), &estimate, filter, place);
        }
        assert_eq!(candidates.iter().map(|filter| filter.name).collect::<Vec<_>>(), expected.names(), "{what}");
        for filter in candidates {
            let compared: Vec<_> = filter.distances.iter().map(|distance| distance.of.name().to_owned()).collect();
            let color = (filter.name != "third").then_some("colour".to_owned());
            assert_eq!(
                compared,
                color.into_iter().chain(estimate.features.iter().cloned()).collect::<Vec<_>>(),
                "{what}: {}",
                filter.name
            );
            check(what, filter, &at(layer(&estimate, filter.name), place), place, frame.extent());
            for (cell, color) in (0..filter.weights.extent.pixels()).map(|cell| (cell, at_cell(&filter.colors, cell))) {
                // With a search for spikes, spikes may be anywhere.
                let as_given = filter.pixel(cell).map_or(vec![0.0; 3], |pixel| at(&frame.color().mean, pixel));
                assert!(
                    denoiser.method().spikes() != Spikes::Keep || color == as_given,
                    "{what}: the colour of cell {cell} is {color:?} and not {as_given:?}"
                );
            }
        }
    }
}

fn crop(render: &str, keep: Keep) -> Frame {
    frame(&noisy(render), [16, 20, 40, 33], keep)
}

/// Checks that the shares are those of the run, and blend the values of the candidates to its pass 1.
#[track_caller]
fn check_blend(what: &str, estimate: &Estimate, candidates: &[FilterKernel], place: (u32, u32)) {
    let pass1 = if dfc(&estimate.plan).second_pass.runs { layer(estimate, "pass1") } else { &estimate.color };
    let selection = at(estimate.selection.as_ref().unwrap_or_else(|| panic!("{what}: there is a selection")), place);
    let share = |filter: &FilterKernel| filter.share.unwrap_or_else(|| panic!("{what}: {} has a share", filter.name));
    for filter in candidates {
        let candidate = CandidateSet::NAMES
            .iter()
            .position(|name| *name == filter.name)
            .unwrap_or_else(|| panic!("{what}: {}", filter.name));
        assert_eq!(share(filter), selection[candidate], "{what}: the share of {} at {place:?}", filter.name);
    }
    for (channel, expected) in at(pass1, place).iter().map(|value| f64::from(*value)).enumerate() {
        let terms = candidates.iter().map(|filter| f64::from(share(filter)) * f64::from(filter.value[channel]));
        let (blend, span) = terms.fold((0.0, 0.0), |(sum, span), term| (sum + term, span + term.abs()));
        assert!(
            (blend - expected).abs() <= 1e-5 * span + f64::from(f32::MIN_POSITIVE),
            "{what} at {place:?}, channel {channel}: {blend} and not {expected}"
        );
    }
}

/// Checks that the second pass averages pass 1 and gives the result.
#[track_caller]
fn check_second_pass(what: &str, method: &Method, estimate: &Estimate, filter: &FilterKernel, place: (u32, u32)) {
    let Method::Dfc(DfcParams { window_radius, second_pass: Some(second_pass), .. }) = method else {
        panic!("{what}: there is a second pass")
    };
    let pass1 = layer(estimate, "pass1");
    let radius = if second_pass.half_window { window_radius.div_ceil(2) } else { *window_radius };
    assert_eq!((filter.window_radius, filter.share), (radius, None), "{what}");
    if filter.rule != WeightRule::Exact {
        let [of_color] = filter.distances.as_slice() else {
            panic!("{what}: the colour tells neighbours apart, and nothing else")
        };
        assert_eq!(
            of_color.of,
            Compared::Color { patch_radius: second_pass.patch_radius, k: second_pass.color_k },
            "{what}"
        );
    }
    for cell in 0..filter.weights.extent.pixels() {
        let expected = filter.pixel(cell).map_or(vec![0.0; 3], |pixel| at(pass1, pixel));
        assert_eq!(at_cell(&filter.colors, cell), expected, "{what}: pass 1 in cell {cell} at {place:?}");
    }
    if let WeightRule::Refused { sigmas } = filter.rule {
        assert_eq!(
            (Some(sigmas), at(&estimate.color, place)),
            (second_pass.most_sigmas, at(pass1, place)),
            "{what}: refused at {place:?}"
        );
    }
    check(what, filter, &at(&estimate.color, place), place, pass1.extent);
}

#[test]
fn of_the_candidates_with_all_there_is() {
    let frame = crop("cornell_32spp", Keep { features: &["albedo", "depth", "normal"], ..EVERYTHING });
    check_dfc("default", &frame, small(DfcParams::default()));
    check_dfc("thesis", &frame, small(DfcParams::thesis()));
    check_dfc("with spikes", &random_frame(33, 21, 1e3), small(DfcParams::default()));
}

#[test]
fn of_the_candidates_with_less() {
    let params = small(DfcParams::default());
    check_dfc("no features", &crop("cornell_8spp", Keep { features: &[], ..EVERYTHING }), params);
    check_dfc("halves only", &crop("caustic_ring_32spp", Keep { variance: false, ..EVERYTHING }), params);
    check_dfc("variance only", &crop("dof_spheres_32spp", Keep { halves: false, ..EVERYTHING }), params);
    let frame = crop("cornell_8spp", Keep { features: &["normal"], ..EVERYTHING });
    for candidates in
        [CandidateSet { first: false, ..CandidateSet::ALL }, CandidateSet { first: false, second: false, third: true }]
    {
        check_dfc("some candidates", &frame, DfcParams { candidates, ..params });
    }
    check_dfc(
        "FIRST alone",
        &frame,
        DfcParams { candidates: CandidateSet { first: true, second: false, third: false }, ..params },
    );
}

/// The window of a grey frame, of a tiny one, of one pixel.
#[test]
fn of_the_candidates_of_unusual_frames() {
    let params = small(DfcParams::default());
    for (width, height) in [(1, 1), (1, 7), (5, 2)] {
        check_dfc("tiny", &calm_frame(width, height), DfcParams { window_radius: 10, ..params });
    }
    let frame = crop("cornell_8spp", Keep { features: &["normal"], ..EVERYTHING });
    let grey = |image: &Image| Image { extent: image.extent, planes: vec![image.planes[0].clone(); 3] };
    let Signal { mean, half_spread, variance_of_mean } = frame.color();
    let color = Signal {
        mean: grey(mean),
        half_spread: half_spread.as_ref().map(grey),
        variance_of_mean: variance_of_mean.as_ref().map(grey),
    };
    let frame = new_frame(color, Vec::new());
    assert!(!dfc(&denoised(&denoiser(params), &frame, &[]).plan).channels.runs);
    check_dfc("grey", &frame, params);
}

/// The frame is larger than the region that the kernels depend on, so only a part is computed; with spikes all around.
#[test]
fn a_part_of_the_frame_tells_what_all_of_it_does() {
    let params = DfcParams { window_radius: 2, ..DfcParams::default() };
    let frame = random_frame(150, 181, 1.0);
    for params in [params, DfcParams { spikes: Spikes::Keep, ..params }] {
        assert!(denoiser(params).reach().expect("it runs dry") < 180, "a part of the frame is all of it");
        check_dfc("large", &frame, params);
    }
}

/// If the second pass would change a pixel by more than its noise explains, the kernel says that pass 1 is the result.
#[test]
fn a_second_pass_that_goes_too_far_is_refused() {
    let frame = crop("cornell_8spp", Keep { features: &["normal"], ..EVERYTHING });
    let (mut refused, mut told) = (Vec::new(), 0);
    for most_sigmas in [Some(1e-6), Some(0.05), None] {
        let params = small(DfcParams {
            second_pass: Some(SecondPass { most_sigmas, ..SecondPass::default() }),
            ..DfcParams::default()
        });
        check_dfc("limited", &frame, params);
        let denoiser = denoiser(params);
        let is_refused = |place: &&(u32, u32)| {
            let kernels = kernels(&denoiser, &frame, **place, &[]);
            let filter = kernels.filter("second_pass").unwrap_or_else(|| panic!("there is a second pass"));
            let is_refused = matches!(filter.rule, WeightRule::Refused { .. });
            if is_refused {
                // The distances are reported all the same, with neighbours of weight 0.
                let weights = &filter.weights.planes[0];
                assert!(
                    filter.weight_sum == 1.0 && weights.iter().filter(|weight| **weight != 0.0).count() == 1,
                    "{place:?}"
                );
                told += (0..weights.len()).filter(|cell| filter.decided_by(*cell).is_some()).count();
            }
            is_refused
        };
        refused.push(places(frame.extent()).iter().filter(is_refused).count());
    }
    assert!(told > 0, "neighbours differ");
    assert!(refused[0] == places(frame.extent()).len() && refused[1] < refused[0] && refused[2] == 0, "{refused:?}");
}

/// Without the second pass the blend is the result; with one candidate, that candidate is.
#[test]
fn without_a_second_pass() {
    let frame = crop("cornell_8spp", Keep { features: &["normal"], ..EVERYTHING });
    let params = small(DfcParams { second_pass: None, ..DfcParams::default() });
    check_dfc("none", &frame, params);
    let candidates = CandidateSet { first: false, second: true, third: false };
    check_dfc("none, and one candidate", &frame, DfcParams { candidates, ..params });
}

/// For neighbours that form a pair, the weight of each by itself is less than that of the pair.
#[test]
fn opposite_neighbours_are_told() {
    let frame = crop("dof_spheres_32spp", Keep { features: &["normal"], ..EVERYTHING });
    let denoiser = denoiser(small(DfcParams::default()));
    let mut stand_in = 0;
    for place in places(frame.extent()) {
        for filter in &kernels(&denoiser, &frame, place, &[]).filters {
            for cell in 0..filter.weights.extent.pixels() {
                let opposite = filter.opposite(cell);
                let (side, radius) = (filter.side(), filter.window_radius);
                let mirrored = |pixel: (u32, u32)| {
                    let along = |at: u32, middle: u32, size: u32| {
                        (2 * i64::from(middle) - i64::from(at)).try_into().ok().filter(|at: &u32| *at < size)
                    };
                    Some((
                        along(pixel.0, place.0, frame.extent().width)?,
                        along(pixel.1, place.1, frame.extent().height)?,
                    ))
                };
                if let Some(pixel) = filter.pixel(cell) {
                    assert_eq!(
                        opposite.and_then(|cell| filter.pixel(cell)),
                        mirrored(pixel),
                        "{place:?}, cell {cell} of {side}² with radius {radius}"
                    );
                }
                for distance in &filter.distances {
                    let (own, shown) = (distance.own_weight(cell), distance.weights.planes[0][cell]);
                    let rounding = 1e-4 * own + 1e-9;
                    assert!(shown >= own - rounding, "{place:?}: {own} by itself, {shown} with its opposite");
                    assert!(
                        opposite.is_some() || shown <= own + rounding,
                        "{place:?}: {own} by itself, and {shown} without an opposite"
                    );
                    stand_in += usize::from(shown > 1.01 * own + 1e-6);
                }
            }
        }
    }
    assert!(stand_in > 0);
}

/// Beyond the reach of noise nothing is filtered, and a frame without any is copied.
#[test]
fn what_is_left_as_it_is_weighs_itself_alone() {
    let noisy = calm_frame(150, 40);
    let (width, dark) = (150, 64);
    let without_noise_on_the_left = |image: &Image| {
        let value = |(i, v): (usize, &f32)| if i % width < dark { 0.0 } else { *v };
        Image {
            extent: image.extent,
            planes: image.planes.iter().map(|plane| plane.iter().enumerate().map(value).collect()).collect(),
        }
    };
    let color = noisy.color();
    let [half_spread, variance_of_mean] =
        [&color.half_spread, &color.variance_of_mean].map(|image| image.as_ref().map(without_noise_on_the_left));
    let frame = new_frame(Signal { mean: color.mean.clone(), half_spread, variance_of_mean }, Vec::new());
    let denoiser = denoiser(DfcParams { window_radius: 2, ..DfcParams::default() });
    // Pass 1 is the same in tiles that are copied.
    let keep = [Intermediate::Pass1];
    let estimate = denoised(&denoiser, &frame, &keep);
    // Tiles are copied up to column 48, and windows beside them hold both kinds.
    for (place, is_exact) in [
        ((3, 7), true),
        ((30, 39), true),
        ((47, 0), true),
        ((48, 11), false),
        ((50, 39), false),
        ((60, 20), false),
        ((149, 0), false),
    ] {
        let kernels = kernels(&denoiser, &frame, place, &keep);
        check_blend("exact", &estimate, &kernels.filters[..3], place);
        check_second_pass("exact", denoiser.method(), &estimate, &kernels.filters[3], place);
        for filter in &kernels.filters {
            assert_eq!(filter.rule == WeightRule::Exact, is_exact, "{place:?}");
            if is_exact {
                assert_eq!(
                    (filter.weight_sum, filter.value.as_slice()),
                    (1.0, at(&color.mean, place).as_slice()),
                    "{place:?}"
                );
                check("exact", filter, &at(&estimate.color, place), place, frame.extent());
            }
        }
        assert_eq!(kernels.filters.len(), 4);
    }
    // If the candidates are requested, they are filtered everywhere.
    let keep = [Intermediate::Candidates];
    assert!(kernels(&denoiser, &frame, (3, 7), &keep).filters.iter().all(|filter| filter.rule == WeightRule::Least));
    check_dfc_of("exact where asked for", &frame, &denoiser, CandidateSet::ALL);

    let zero = || Some(Image::filled(color.mean.extent, 3, 0.0));
    let clean =
        new_frame(Signal { mean: color.mean.clone(), half_spread: zero(), variance_of_mean: zero() }, Vec::new());
    let kernels = kernels(&denoiser, &clean, (3, 7), &[]);
    assert!(
        kernels.filters.is_empty()
            && kernels.filter("first").is_none()
            && kernels.plan.steps().iter().all(|step| !step.runs)
    );
}

#[track_caller]
fn check_nlm(what: &str, frame: &Frame, params: NlmParams) {
    let denoiser = denoiser(params);
    let estimate = denoised(&denoiser, frame, &[Intermediate::Halves]);
    for place in places(frame.extent()) {
        let kernels = kernels(&denoiser, frame, place, &[]);
        let has_halves = frame.color().half_spread.is_some() && params.dual_buffer;
        let expected: Vec<_> = if has_halves {
            vec![("half_a", layer(&estimate, "half_a")), ("half_b", layer(&estimate, "half_b"))]
        } else {
            vec![("filter", &estimate.color)]
        };
        assert_eq!(
            kernels.filters.iter().map(|filter| filter.name).collect::<Vec<_>>(),
            expected.iter().map(|(name, _)| *name).collect::<Vec<_>>(),
            "{what}"
        );
        for (filter, (_, image)) in kernels.filters.iter().zip(&expected) {
            let rule = if params.patchwise {
                WeightRule::PatchMean { cut: params.cut }
            } else {
                WeightRule::Cut { cut: params.cut }
            };
            assert_eq!(
                (filter.rule, &filter.distances[0].of),
                (rule, &Compared::Color { patch_radius: params.patch_radius, k: params.k }),
                "{what}"
            );
            check(what, filter, &at(image, place), place, frame.extent());
        }
        // Both halves together.
        let sum = kernels.filters.iter().map(|filter| filter.weight_sum).sum::<f32>() / kernels.filters.len() as f32;
        let expected = at(&estimate.weight_sum, place)[0];
        assert!((sum - expected).abs() <= 1e-5 * expected, "{what} at {place:?}: Σ w is {sum} and not {expected}");
    }
}

#[test]
fn of_nlm() {
    let small = |params: NlmParams| NlmParams { window_radius: 3, ..params };
    let frame = crop("cornell_8spp", Keep { features: &["normal"], ..EVERYTHING });
    check_nlm("default", &frame, small(NlmParams::default()));
    check_nlm("thesis", &frame, small(NlmParams::thesis()));
    let weighting = Weighting { symmetric: Symmetry::Blended, centre: CentreWeight::LargestNeighbour };
    check_nlm(
        "one buffer",
        &frame,
        NlmParams { dual_buffer: false, patchwise: false, cut: 0.0, weighting, ..small(NlmParams::default()) },
    );
    check_nlm("no halves", &crop("cornell_8spp", Keep { halves: false, ..EVERYTHING }), small(NlmParams::default()));
    check_nlm(
        "spikes, uniform variance",
        &random_frame(110, 40, 1.0),
        NlmParams { variance: NlmVariance::Uniform, ..small(NlmParams::default()) },
    );
    for (width, height) in [(1, 1), (1, 7), (5, 2)] {
        check_nlm("tiny", &calm_frame(width, height), NlmParams::default());
    }
}

#[test]
fn of_gem() {
    for (frame, params) in [
        (crop("cornell_8spp", EVERYTHING), GemParams::default()),
        (crop("caustic_ring_32spp", Keep { halves: false, ..EVERYTHING }), GemParams::thesis()),
        (random_frame(70, 20, 1.0), GemParams { phase: stein::method::gem::Phase::Sampling, ..GemParams::default() }),
        (calm_frame(1, 1), GemParams::default()),
    ] {
        let denoiser = denoiser(params);
        let estimate = denoised(&denoiser, &frame, &[Intermediate::Scale]);
        for place in places(frame.extent()) {
            let kernels = kernels(&denoiser, &frame, place, &[]);
            let [filter] = kernels.filters.as_slice() else { panic!("one filter") };
            assert_eq!(
                (filter.name, filter.rule),
                ("scale", WeightRule::Gaussian { sigma: at(layer(&estimate, "scale"), place)[0] })
            );
            check("GEM", filter, &at(&estimate.color, place), place, frame.extent());
        }
    }
}

#[test]
fn a_pixel_outside_of_the_frame_is_refused() {
    let frame = calm_frame(9, 5);
    for (x, y) in [(9, 0), (0, 5), (u32::MAX, u32::MAX)] {
        let refused = denoiser(DfcParams::default()).kernels(&frame, x, y, &Options::default()).map(drop);
        let Err(error @ Error::Request(RequestCause::PixelOutside { .. })) = refused else { panic!("({x}, {y})") };
        assert_eq!(error.problem(), format!("pixel ({x}, {y}) lies outside of a frame of 9×5 pixels"));
        let rule = "a column from 0 to 8 and a row from 0 to 4".into();
        assert_eq!(error.remedies(), [Remedy::ChooseValue { rule }]);
    }
}
