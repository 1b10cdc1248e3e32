//! The float64 reference is judged by its properties, since nothing else can judge it.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use stein_reference as reference;

use reference::candidates::{Candidate, analytic_derivative, candidate, finite_difference, finite_difference_step};
use reference::dfc::{Dfc, DfcParams, Frame, Pass, dfc};
use reference::gaussian::{gaussian, gaussian_neighbours, gaussian_variance};
use reference::gem::{Scale, bias_weight, scaled, step};
use reference::nlm::{CentreWeight, Feature, FilterParams, Guide, nlm_filter, window_weights};
use reference::prefilter::{gradient_squared, prefilter};
use reference::random::Random;
use reference::select::{Evidence, Guard, select, share};
use reference::sure::sure;
use reference::variance::{BoxWeight, Signal, spread_of_halves, variance_scale};
use reference::{Grid, Planes, Point, square};

/// Both presets with a small radius; they differ in every switch.
fn presets() -> [(&'static str, DfcParams); 2] {
    let small = |params| DfcParams { window_radius: 4, ..params };
    [("default", small(DfcParams::default())), ("thesis", small(DfcParams::thesis()))]
}

fn row(values: &[f64]) -> Grid {
    Grid { width: values.len(), height: 1, values: values.to_vec() }
}

fn planes(count: usize, mut plane: impl FnMut() -> Grid) -> Planes {
    (0..count).map(|_| plane()).collect()
}

fn filter_params(symmetric: bool, centre: CentreWeight) -> FilterParams {
    FilterParams {
        window_radius: 3,
        patch_radius: 1,
        k_color: 0.45,
        k_feature: 0.6,
        tau: 1e-2,
        symmetric_features: symmetric,
        blend_pairs: symmetric,
        centre,
    }
}

fn assert_close(actual: f64, expected: f64, tolerance: f64, what: &str) {
    assert!((actual - expected).abs() <= tolerance, "{what}: {actual} instead of {expected} ± {tolerance}");
}

fn assert_planes_close(actual: &[Grid], expected: &[Grid], what: &str) {
    assert_eq!(actual.len(), expected.len(), "{what}: channels");
    for (actual, expected) in actual.iter().zip(expected) {
        for (&actual, &expected) in actual.values.iter().zip(&expected.values) {
            assert_close(actual, expected, 1e-12, what);
        }
    }
}

fn every_output(result: &Dfc) -> Vec<(&'static str, &Pass)> {
    let mut passes = vec![("pass 1", &result.pass1)];
    passes.extend(result.pass2.as_ref().map(|pass| ("pass 2", pass)));
    passes
}

/// A frame of Gaussian noise around `mean`, with halves, sample variances and one feature with noise.
fn noisy_frame(mean: &[Grid], sigma: f64, seed: u64) -> Frame {
    let mut random = Random(seed);
    let (width, height) = (mean[0].width, mean[0].height);
    let mut noisy = |clean: &Grid, sigma: f64| {
        // Halves with twice the variance of their mean.
        let half = sigma * 2f64.sqrt();
        let mut half = || {
            let noise = random.gaussian_grid(width, height, 0.0, half);
            clean.like(|p| clean.at(p) + noise.at(p))
        };
        let (a, b) = (half(), half());
        let mean = a.like(|p| (a.at(p) + b.at(p)) / 2.0);
        (mean, spread_of_halves(&a, &b, 1.0, 1.0))
    };
    let mut signal = |clean: &[Grid], sigma: f64| {
        let (mean, spread) = clean.iter().map(|plane| noisy(plane, sigma)).unzip();
        Signal {
            mean,
            spread: Some(spread),
            sample_variance: Some(clean.iter().map(|p| p.like(|_| sigma * sigma)).collect()),
        }
    };
    Frame { color: signal(mean, sigma), features: vec![signal(&mean[..1], sigma / 10.0)], explaining: Vec::new() }
}

// Examples small enough to compute by hand.

#[test]
fn a_pair_of_pixels_has_the_weight_of_equation_8_2() {
    let (mean, variance) = ([row(&[1.0, 2.0])], [row(&[0.2, 0.3])]);
    let params = FilterParams { patch_radius: 0, k_color: 0.5, ..filter_params(false, CentreWeight::One) };
    let guide = Guide { mean: &mean, variance: &variance };
    let weight_at = |x| {
        let p = Point { x, y: 0 };
        window_weights(&mean[0], p, Some(guide), &[], &params).neighbours[0].1
    };
    // The cancellation is 2·0.2 from the less noisy pixel's side and 0.3 + 0.2 from the other's.
    let scale: f64 = 0.25 * 0.5;
    assert_close(weight_at(0), (-(1.0 - 0.4) / scale).exp(), 1e-12, "w(0, 1)");
    assert_close(weight_at(1), (-(1.0 - 0.5) / scale).exp(), 1e-12, "w(1, 0)");
}

#[test]
fn a_patch_at_the_border_averages_the_pairs_that_exist() {
    let (mean, variance) = ([row(&[0.0, 0.0, 1.0])], [row(&[0.5, 0.5, 0.5])]);
    let guide = Guide { mean: &mean, variance: &variance };
    let params = FilterParams { k_color: 1.0, window_radius: 1, ..filter_params(false, CentreWeight::One) };
    let p = Point { x: 0, y: 0 };
    let weights = window_weights(&mean[0], p, Some(guide), &[], &params);
    assert_eq!(weights.neighbours.len(), 1);
    // (0, 1): (0 − 1)/1 and (1, 2): (1 − 1)/1; their mean is below 0.
    assert_close(weights.neighbours[0].1, 1.0, 1e-9, "clamped distance");
    let p = Point { x: 2, y: 0 };
    let mean = [row(&[0.0, 0.0, 2.0])];
    let guide = Guide { mean: &mean, ..guide };
    let weights = window_weights(&mean[0], p, Some(guide), &[], &params);
    // (2, 1): 4 − 1 and (1, 0): 0 − 1.
    assert_close(weights.neighbours[0].1, (-1f64).exp(), 1e-9, "mean of two pairs");
}

#[test]
fn a_ramp_is_averaged_across_only_by_symmetric_weights() {
    let (mean, variance) = ([row(&[0.0, 1.0, 2.0])], [row(&[0.1, 0.1, 0.1])]);
    let guide = Guide { mean: &mean, variance: &variance };
    let p = Point { x: 1, y: 0 };
    let weights_of = |symmetric| {
        let params =
            FilterParams { patch_radius: 0, k_color: 1.0, ..filter_params(symmetric, CentreWeight::LargestNeighbour) };
        window_weights(&mean[0], p, Some(guide), &[], &params)
    };
    let plain = (-0.8f64 / 0.2).exp();
    for (_, weight) in weights_of(false).iter() {
        assert_close(weight, plain, 1e-9, "plain, and the centre after its largest neighbour");
    }
    for (_, weight) in weights_of(true).iter() {
        assert_close(weight, 1.0, 1e-12, "the mean of the pair equals p");
    }
}

#[test]
fn the_blend_of_a_pair_has_the_share_of_its_excess() {
    // d1 = d2 = 0.8/0.2·s with k² = 1/s chosen so that w1 = w2 = 0.4: the share is 1/0.8 − 1 = 1/4.
    let distance = -(0.4f64.ln());
    let k = (0.8 / 0.2 / distance).sqrt();
    let (mean, variance) = ([row(&[0.0, 1.0, 2.0])], [row(&[0.1, 0.1, 0.1])]);
    let guide = Guide { mean: &mean, variance: &variance };
    let params = FilterParams { patch_radius: 0, k_color: k, ..filter_params(true, CentreWeight::One) };
    let p = Point { x: 1, y: 0 };
    let weights = window_weights(&mean[0], p, Some(guide), &[], &params);
    for (_, weight) in weights.neighbours {
        assert_close(weight, 0.25 + 0.75 * 0.4, 1e-7, "share 1/4");
    }
}

#[test]
fn a_feature_has_the_weight_of_equation_8_3() {
    let feature = Feature {
        mean: vec![row(&[0.5, 0.9]), row(&[0.5, 0.5])],
        residual_variance: vec![row(&[0.02, 0.03]), row(&[0.0, 0.0])],
        gradient_squared: vec![row(&[0.0, 0.04]), row(&[0.0, 0.0])],
    };
    let weight = |symmetric| {
        let params = filter_params(symmetric, CentreWeight::One);
        let p = Point { x: 0, y: 0 };
        let feature = std::slice::from_ref(&feature);
        window_weights(&feature[0].mean[0], p, None, feature, &params).neighbours[0].1
    };
    let literal: f64 = (0.16 - 0.05) / (0.36 * 0.02) / 2.0;
    assert_close(weight(false), (-literal).exp(), 1e-12, "as printed");
    let symmetric: f64 = (0.16 - 0.04) / (0.36 * 0.06) / 2.0;
    assert_close(weight(true), (-symmetric).exp(), 1e-12, "from both pixels");
}

/// The two neighbours differ from p a lot and in opposite directions, their mean does so a little.
#[test]
fn a_pair_has_the_weight_of_equation_7_6_unless_a_neighbour_is_too_far() {
    let (mean, variance) = (vec![row(&[-3.0, 0.4, 3.0])], vec![row(&[0.04, 0.01, 0.005])]);
    let p = Point { x: 1, y: 0 };
    let params = FilterParams {
        patch_radius: 0,
        k_color: 5.0,
        k_feature: 5.0,
        tau: 0.008,
        ..filter_params(true, CentreWeight::One)
    };
    let guide = Some(Guide { mean: &mean, variance: &variance });
    let numerator: f64 = 0.16 - (0.01 + (0.005 + 0.01) / 4.0);

    let expected = (-numerator / (25.0 * (0.01 + 0.045 / 4.0))).exp();
    for (_, weight) in window_weights(&mean[0], p, guide, &[], &params).neighbours {
        assert_close(weight, expected, 1e-9, "colour");
    }
    // The distance to the right neighbour is 6.745/(16·0.015) = 28.
    let stricter = FilterParams { k_color: 4.0, ..params };
    let weights = window_weights(&mean[0], p, guide, &[], &stricter).neighbours;
    assert!(weights.iter().all(|(_, weight)| *weight < 1e-5), "{weights:?}");

    let feature =
        Feature { gradient_squared: vec![row(&[0.0; 3])], residual_variance: variance.clone(), mean: mean.clone() };
    // The right neighbour's contrast is τ.
    let expected = (-numerator / (25.0 * (0.01 + (0.04 + 0.008) / 4.0))).exp();
    for (_, weight) in window_weights(&mean[0], p, None, &[feature], &params).neighbours {
        assert_close(weight, expected, 1e-9, "feature");
    }
}

#[test]
fn the_gradient_takes_the_flatter_side_of_each_axis() {
    let plane = Grid::from_fn(3, 3, |p| match p.x {
        0 => 0.0,
        1 => 1.0,
        _ => 5.0,
    });
    let gradient = gradient_squared(&plane);
    let at = |x| gradient.at(Point { x, y: 1 });
    assert_eq!([at(0), at(1), at(2)], [0.25, 0.25, 4.0]);
    let both = gradient_squared(&Grid::from_fn(3, 3, |p| 2.0 * p.x as f64 + 4.0 * p.y as f64));
    assert!(both.values.iter().all(|&v| v == 1.0 + 4.0));
}

#[test]
fn the_finite_difference_step_is_never_zero() {
    assert_eq!(finite_difference_step(2.0, 0.0, 2.0), 0.02);
    assert_eq!(finite_difference_step(-2.0, 0.0, 2.0), -0.02);
    assert_eq!(finite_difference_step(0.0, 4.0, 0.0), 0.02);
    assert_eq!(finite_difference_step(-1e-3, 4.0, 1.0), -0.02);
    assert_eq!(finite_difference_step(0.0, 0.0, 3.0), 3e-6);
    assert_eq!(finite_difference_step(0.0, -1.0, 0.0), 1e-18);
}

const FIRST: usize = 0;
const SECOND: usize = 1;
const THIRD: usize = 2;
/// SECOND is the rival of FIRST.
const RIVALS: [Option<usize>; 3] = [Some(SECOND), None, None];

#[test]
fn the_least_error_wins_and_ties_go_to_the_later_candidate() {
    let inf = f64::INFINITY;
    // r, g, b, whether FIRST filters more, winner.
    let cases = [
        (1.0, 2.0, 3.0, true, FIRST),
        (1.0, 2.0, 3.0, false, SECOND),
        (1.0, 3.0, 2.0, false, THIRD),
        (2.0, 1.0, 3.0, true, SECOND),
        (3.0, 2.0, 1.0, true, THIRD),
        (1.0, 1.0, 2.0, true, SECOND),
        (1.0, 1.0, 1.0, true, THIRD),
        (-inf, 2.0, 3.0, true, SECOND),
        (f64::NAN, f64::NAN, 3.0, true, THIRD),
        (1.0, f64::NAN, inf, true, FIRST),
        (inf, inf, inf, true, THIRD),
    ];
    for (i, (r, g, b, more, winner)) in cases.into_iter().enumerate() {
        let errors = [r, g, b].map(|e| row(&[e]));
        let (low, high) = ([row(&[0.1])], [row(&[0.2])]);
        let derivatives: [&[Grid]; 3] = if more { [&low, &high, &low] } else { [&high, &high, &low] };
        let maps = select(&errors, &derivatives, &RIVALS);
        let expected = [FIRST, SECOND, THIRD].map(|k| f64::from(k == winner));
        assert_eq!([maps[0].values[0], maps[1].values[0], maps[2].values[0]], expected, "case {i}");
    }
}

#[test]
fn a_rival_need_not_take_part() {
    let inf = f64::INFINITY;
    // FIRST filters less than SECOND; SECOND is its rival or not.
    for (errors, rivals, winner) in [
        ([1.0, 2.0], [Some(1), None], 1),
        ([3.0, 2.0], [Some(1), None], 1),
        ([inf, inf], [Some(1), None], 1),
        ([1.0, 2.0], [None, None], 0),
        ([inf, 0.0], [None, None], 1),
    ] {
        let (low, high) = ([row(&[0.1])], [row(&[0.2])]);
        let maps = select(&errors.map(|error| row(&[error])), &[&high, &low], &rivals);
        assert_eq!(maps[winner].values[0], 1.0, "{errors:?} {rivals:?}");
    }
    let one = select(&[row(&[inf])], &[&[row(&[0.2])]], &[None]);
    assert_eq!(one[0].values[0], 1.0);
}

#[test]
fn any_number_of_candidates_may_be_chosen_from() {
    let errors = [4.0, 3.0, 1.0, 2.0, 1.0, 9.0].map(|error| row(&[error]));
    let derivative = [row(&[0.5])];
    let maps = select(&errors, &[&derivative[..]; 6], &[None; 6]);
    assert_eq!(maps.iter().map(|map| map.values[0]).collect::<Vec<_>>(), [0.0, 0.0, 0.0, 0.0, 1.0, 0.0]);
}

/// One pixel, in which SECOND has won.
fn guarded(maps: [f64; 3], errors: [f64; 3], sure: [f64; 3], filtered: [f64; 3], rule: Guard) -> [f64; 3] {
    let grids = |values: [f64; 3]| values.map(|value| row(&[value]));
    let (maps, errors, sure, binary_maps, filtered) =
        (grids(maps), grids(errors), grids(sure), grids([0.0, 1.0, 0.0]), grids(filtered));
    let candidates = filtered.each_ref().map(std::slice::from_ref);
    let variance = [row(&[4.0])];
    let evidence = Evidence {
        errors: &errors,
        binary_maps: &binary_maps,
        sure: &sure,
        candidates: &candidates,
        variance: &variance,
    };
    let maps = share(&maps, evidence, Some(&rule));
    [maps[0].values[0], maps[1].values[0], maps[2].values[0]]
}

#[test]
fn the_guard_removes_what_is_much_worse_than_the_winner() {
    // The allowance is 2·|1| + 0.25·4.
    let rule = Guard { smoothed_error: 2.0, smoothed_noise: 0.25, own_sigmas: 0.0, own_noise: 1e9 };
    let guarded = |maps, errors| guarded(maps, errors, [0.0, -1.0, 0.0], [0.0; 3], rule);
    assert_eq!(guarded([0.25, 0.25, 0.5], [4.0, 1.0, 4.1]), [0.5, 0.5, 0.0]);
    // A loser may have the least error, as FIRST where it filters too little.
    assert_eq!(guarded([0.25, 0.5, 0.25], [-9.0, 1.0, 3.5]), [0.25, 0.5, 0.25]);
    assert_eq!(guarded([0.0, 0.0, 1.0], [3.0, 1.0, 9.0]), [0.0, 1.0, 0.0]);
    assert_eq!(guarded([0.5, 0.25, 0.25], [f64::NAN, 1.0, f64::INFINITY]), [0.0, 1.0, 0.0]);
}

#[test]
fn the_guard_removes_what_the_pixels_own_error_is_sure_about() {
    // FIRST has the least. SECOND is 3 away from it, a deviation of 2·√(4·9) = 12, and THIRD 1: 4. Two of them and
    // 0.5·4 are allowed: 26 and 10.
    let rule = Guard { smoothed_error: 1e9, smoothed_noise: 0.0, own_sigmas: 2.0, own_noise: 0.5 };
    let guarded = |sure| guarded([0.25, 0.25, 0.5], [1.0; 3], sure, [5.0, 8.0, 4.0], rule);
    assert_eq!(guarded([-1.0, 25.0, 9.0]), [0.25, 0.25, 0.5]);
    assert_eq!(guarded([-1.0, 25.5, 9.0]), [1.0 / 3.0, 0.0, 2.0 / 3.0]);
    assert_eq!(guarded([-1.0, 25.0, 9.5]), [0.5, 0.5, 0.0]);
    assert_eq!(guarded([-1.0, 99.0, 99.0]), [1.0, 0.0, 0.0]);
}

// Variances.

#[test]
fn a_gaussian_keeps_a_constant_and_is_normalised_at_the_border() {
    let plane = Grid::filled(5, 4, 3.0);
    for value in gaussian(&plane, 0.5, 2).values {
        assert_close(value, 3.0, 1e-12, "constant");
    }
    let smoothed = gaussian(&row(&[1.0, 0.0]), 0.5, 2);
    let weight = (-2f64).exp();
    assert_close(smoothed.values[0], 1.0 / (1.0 + weight), 1e-12, "border");
}

/// Equation 6.2 gives the noise of an average, also at the border.
#[test]
fn a_gaussian_of_noise_has_the_variance_of_its_squared_weights() {
    let deviation = Grid::from_fn(9, 7, |p| 0.5 + 0.1 * (p.x + p.y) as f64);
    let expected = gaussian_variance(&deviation.like(|p| deviation.at(p).powi(2)), 1.3, 4);
    let mut random = Random(91);
    let mut squares = deviation.like(|_| 0.0);
    const RUNS: usize = 4000;
    for _ in 0..RUNS {
        let noise = random.gaussian_grid(9, 7, 0.0, 1.0);
        let smoothed = gaussian(&noise.like(|p| noise.at(p) * deviation.at(p)), 1.3, 4);
        squares = squares.like(|p| squares.at(p) + smoothed.at(p).powi(2) / RUNS as f64);
    }
    for (actual, expected) in squares.values.iter().zip(&expected.values) {
        // Relative deviation √(2/4000), of 63 values the largest.
        assert_close(actual / expected, 1.0, 4.0 * 0.0224, "variance");
    }
}

#[test]
fn neighbours_are_averaged_without_the_centre() {
    assert_eq!(gaussian_neighbours(&row(&[7.0]), 1.0, 3).values, [7.0]);
    let smoothed = gaussian_neighbours(&row(&[0.0, 9.0, 0.0]), 1.0, 3);
    assert_close(smoothed.values[1], 0.0, 1e-12, "centre");
    assert_close(smoothed.values[0], 9.0 / (1.0 + (-1.5f64).exp()), 1e-12, "beside it");
}

// Greedy error minimisation.

/// Section 6.2.2: if the image is quadratic, the bias term is the difference of the squared biases, although it does
/// not know the truth. Gaussians that end at 3σ have biases in a ratio of their scales within 2 %.
#[test]
fn the_bias_term_knows_the_biases_of_a_quadratic() {
    let truth = Grid::from_fn(81, 81, |p| {
        0.3 + 0.02 * p.x as f64 - 0.01 * (p.x - 40).pow(2) as f64 + 0.03 * (p.y - 38).pow(2) as f64
    });
    let zero = truth.like(|_| 0.0);
    let three = |grid: &Grid| vec![grid.clone(); 3];
    let pixel = Scale {
        sigma: 0.0,
        mean: three(&truth),
        spread: three(&zero),
        variance: three(&zero),
        samples: zero.clone(),
        pixels: zero.like(|_| 1.0),
    };
    let centre = Point { x: 40, y: 40 };
    for (fine, coarse) in [
        (scaled(&pixel, 2.0), scaled(&pixel, 4.0)),
        (scaled(&pixel, 4.0), scaled(&pixel, 32f64.sqrt())),
        (pixel.clone(), scaled(&pixel, 2.0)),
    ] {
        let squared_bias = |scale: &Scale| 3.0 * (scale.mean[0].at(centre) - truth.at(centre)).powi(2);
        let expected = squared_bias(&coarse) - squared_bias(&fine);
        assert!(expected > 0.0);
        assert_close(step(&fine, &coarse, 1.0).bias_term.at(centre) / expected, 1.0, 0.02, "bias term");
    }
}

#[test]
fn more_tolerance_of_errors_weighs_the_bias_more() {
    let weights: Vec<f64> = [0.01, 0.05, 0.1, 0.2, 0.3, 0.39].into_iter().map(bias_weight).collect();
    assert!(weights.is_sorted() && weights[0] > 0.0, "{weights:?}");
    assert_close(weights[3], 0.7022, 1e-4, "z(0.2)");
}

#[test]
fn variance_scaling_keeps_the_structure_and_corrects_the_magnitude() {
    let mut random = Random(1);
    let truth = random.uniform_grid(40, 40, 0.5, 2.0);
    let noise = random.gaussian_grid(40, 40, 0.0, 1.0);
    let spread = truth.like(|p| truth.at(p).sqrt() * noise.at(p));
    // Low-discrepancy samples: the sample variance claims three times too much.
    let claimed = truth.like(|p| 3.0 * truth.at(p));
    for weight in [BoxWeight::Even, BoxWeight::Deviation] {
        let scaled = variance_scale(std::slice::from_ref(&claimed), std::slice::from_ref(&spread), 10, weight);
        for p in square(5).map(|o| o + Point { x: 20, y: 20 }) {
            // 441 squared normals have a relative deviation of √(2/441) = 0.07.
            let ratio = scaled[0].at(p) / truth.at(p);
            assert_close(ratio, 1.0, 4.0 * 0.07, "scaled variance over the true one");
        }
        let none = variance_scale(&[row(&[0.0; 5])], &[row(&[1.0; 5])], 2, weight);
        assert_eq!(none[0], row(&[0.0; 5]));
    }
}

/// An outlier whose halves agree by accident takes all variance of its box where pixels count alike.
#[test]
fn an_outlier_does_not_decide_how_the_variances_around_it_are_scaled() {
    let mut random = Random(4);
    let noise = random.gaussian_grid(40, 40, 0.0, 1.0);
    let is_outlier = |p: Point| p == Point { x: 20, y: 20 };
    let spread = noise.like(|p| if is_outlier(p) { 0.0 } else { noise.at(p) });
    let claimed = noise.like(|p| if is_outlier(p) { 1e6 } else { 1.0 });
    let beside = |weight: BoxWeight| {
        variance_scale(std::slice::from_ref(&claimed), std::slice::from_ref(&spread), 10, weight)[0]
            .at(Point { x: 22, y: 21 })
    };
    assert!(beside(BoxWeight::Even) < 1e-3, "{}", beside(BoxWeight::Even));
    // It counts as a thousand of the 440 others.
    assert_close(beside(BoxWeight::Deviation), 440.0 / 1440.0, 0.1, "variance beside an outlier");
}

/// All later stages depend on this: mixing up the two gives a factor of two that no other test finds.
#[test]
fn the_squared_spread_is_the_variance_of_the_mean_and_the_squared_difference_halved_that_of_a_half() {
    let (width, height, sigma) = (64, 64, 0.7);
    let mut random = Random(2);
    let mut half = |samples: f64| random.gaussian_grid(width, height, 5.0, sigma / samples.sqrt());
    let mean_square = |plane: Grid| plane.like(|p| plane.at(p) * plane.at(p)).mean();
    // 4096 squared normals: relative deviation √(2/4096) = 0.022.
    let tolerance = 4.0 * 0.022;

    let (a, b) = (half(8.0), half(8.0));
    let of_mean = sigma * sigma / 16.0;
    let squared_spread = mean_square(spread_of_halves(&a, &b, 8.0, 8.0));
    assert_close(squared_spread / of_mean, 1.0, tolerance, "variance of the mean");
    let of_half = sigma * sigma / 8.0;
    let delta = mean_square(a.like(|p| a.at(p) - b.at(p))) / 2.0;
    assert_close(delta / of_half, 1.0, tolerance, "variance of one half");

    let (a, b) = (half(4.0), half(12.0));
    let squared_spread = mean_square(spread_of_halves(&a, &b, 4.0, 12.0));
    assert_close(squared_spread / of_mean, 1.0, tolerance, "unequal halves");
}

/// Filtering the spread with the mean's weights and squaring it estimates the variance of the filtered mean.
#[test]
fn the_filtered_spread_knows_the_residual_variance() {
    let (width, height) = (48, 48);
    let clean = [Grid::filled(width, height, 1.0)];
    let frame = noisy_frame(&clean, 0.2, 3);
    let params = FilterParams { k_feature: f64::INFINITY, ..filter_params(false, CentreWeight::One) };
    // No guide: a box of 7×7.
    let payload = [&frame.color.mean[0], frame.color.spread.as_ref().unwrap().first().unwrap()];
    let filtered = nlm_filter(&payload.map(Grid::clone), None, &[], &params).planes;
    let error = filtered[0].like(|p| (filtered[0].at(p) - 1.0).powi(2)).mean();
    let residual = filtered[1].like(|p| filtered[1].at(p).powi(2)).mean();
    // Neighbouring windows overlap: about 47 independent ones, so each mean has a relative deviation of √(2/47) = 0.2.
    assert_close(residual / error, 1.0, 4.0 * 0.2 * 2f64.sqrt(), "residual variance over squared error");
    assert!(error < 0.04 / 20.0, "49 pixels were averaged: {error}");
}

#[test]
fn a_feature_without_variance_is_left_alone() {
    let mut random = Random(4);
    let mean = planes(2, || random.uniform_grid(9, 7, 0.0, 1.0));
    let signal = Signal { mean: mean.clone(), spread: None, sample_variance: None };
    let result = prefilter(&signal, true, CentreWeight::LargestNeighbour, BoxWeight::Deviation);
    assert_eq!(result.feature.mean, mean);
    assert!(result.feature.residual_variance.iter().all(|plane| plane.mean() == 0.0));
    assert!(result.spread.is_none());
}

#[test]
fn a_feature_with_noise_ends_with_less_of_it_however_the_noise_is_known() {
    let frame = noisy_frame(&[Grid::filled(20, 20, 0.5)], 0.1, 5);
    let known = frame.color;
    let (spread, variance) = (known.spread, known.sample_variance);
    for (spread, sample_variance) in [(spread.clone(), variance.clone()), (spread, None), (None, variance)] {
        let signal = Signal { mean: known.mean.clone(), spread, sample_variance };
        let feature = prefilter(&signal, true, CentreWeight::LargestNeighbour, BoxWeight::Deviation).feature;
        let error = feature.mean[0].like(|p| (feature.mean[0].at(p) - 0.5).powi(2)).mean();
        let claimed = feature.residual_variance[0].mean();
        assert!(error < 0.002, "0.01 before the filter, {error} after");
        assert!(claimed > error / 4.0 && claimed < error * 4.0, "claims {claimed} of {error}");
    }
}

// The derivative.

/// Smooth colour with noise, a noisy variance, and two features, one of which is a step.
fn derivative_scene(seed: u64) -> (Planes, Planes, Vec<Feature>) {
    let (width, height) = (11, 9);
    let mut random = Random(seed);
    let mean = planes(3, || {
        let noise = random.gaussian_grid(width, height, 0.0, 0.2);
        noise.like(|p| 1.0 + 0.05 * p.x as f64 + noise.at(p))
    });
    let variance = planes(3, || random.uniform_grid(width, height, 0.02, 0.06));
    let step = Grid::from_fn(width, height, |p| if p.x < 6 { 0.3 } else { 0.4 });
    let soft = random.uniform_grid(width, height, 0.4, 0.6);
    let features = [step, soft]
        .into_iter()
        .map(|plane| Feature {
            residual_variance: vec![random.uniform_grid(width, height, 0.0, 0.002)],
            gradient_squared: vec![gradient_squared(&plane)],
            mean: vec![plane],
        })
        .collect();
    (mean, variance, features)
}

#[test]
fn the_finite_difference_approaches_the_analytic_derivative() {
    let (mean, variance, features) = derivative_scene(6);
    for symmetric in [false, true] {
        for centre in [CentreWeight::One, CentreWeight::LargestNeighbour] {
            for patch_radius in [1, 3] {
                let params = FilterParams { patch_radius, ..filter_params(symmetric, centre) };
                let (mut kinks, mut largest, mut count) = (0, 0f64, 0);
                for (y, x) in (0..9).flat_map(|y| (0..11).map(move |x| (y, x))) {
                    let (p, i) = (Point { x, y }, (x % 3) as usize);
                    let difference = |step| finite_difference(&mean, &variance, &features, &params, p, i, step);
                    let (forward, backward) = (difference(1e-6), difference(-1e-6));
                    let expected = analytic_derivative(&mean, &variance, &features, &params, p, i);
                    count += 1;
                    if (forward - backward).abs() > 1e-3 {
                        kinks += 1;
                        continue;
                    }
                    let what = format!("{params:?}, pixel {x}, {y}");
                    assert_close((forward + backward) / 2.0, expected, 1e-6, &what);
                    largest = largest.max(expected.abs());
                }
                assert!(kinks * 20 <= count, "{kinks} kinks in {count} pixels");
                assert!(largest > 0.1, "a derivative of {largest} proves nothing");
            }
        }
    }
}

#[test]
fn the_derivative_of_third_is_the_centre_weights_share() {
    let (mean, variance, features) = derivative_scene(7);
    for centre in [CentreWeight::One, CentreWeight::LargestNeighbour] {
        let params = FilterParams { k_color: f64::INFINITY, ..filter_params(true, centre) };
        let third = candidate(&mean, None, &variance, &features, &params);
        let p = Point { x: 4, y: 5 };
        let mut moved = mean.clone();
        let at = moved[1].index(p);
        moved[1].values[at] += 1.0;
        let filtered = nlm_filter(&moved, None, &features, &params).planes;
        let rise = filtered[1].at(p) - third.mean[1].at(p);
        assert_close(third.derivative[1].at(p), rise, 1e-12, "a filter that is linear");
        if centre == CentreWeight::One {
            let expected = 1.0 / third.weight_sum.at(p);
            assert_close(third.derivative[1].at(p), expected, 1e-15, "1/C");
        }
        let analytic = analytic_derivative(&mean, &variance, &features, &params, p, 1);
        assert_close(third.derivative[1].at(p), analytic, 1e-12, "analytic");
    }
}

/// Eq. 8.5 does not hold for a single pixel, but its mean over many pixels is the mean squared error.
#[test]
fn sure_is_unbiased_for_every_candidate() {
    const SEEDS: u64 = 10;
    let (width, height, sigma) = (24, 24, 0.1);
    for (preset, params) in presets() {
        for (k, own) in params.candidates.iter().enumerate() {
            let filter = FilterParams {
                window_radius: 3,
                patch_radius: own.patch_radius.min(2),
                k_color: own.k_color,
                ..filter_params(params.symmetric, params.centre)
            };
            // The mean difference of each seed, in units of the variance of a pixel.
            let differences: Vec<f64> = (0..SEEDS)
                .map(|seed| {
                    let mut random = Random(100 + seed);
                    let mean = planes(3, || random.gaussian_grid(width, height, 1.0, sigma));
                    let variance = planes(3, || Grid::filled(width, height, sigma * sigma));
                    let Candidate { mean: filtered, derivative, .. } = candidate(&mean, None, &variance, &[], &filter);
                    let estimate = sure(&mean, &variance, &filtered, &derivative, 1.0);
                    let error = estimate.like(|p| filtered.iter().map(|plane| (plane.at(p) - 1.0).powi(2)).sum());
                    (estimate.mean() - error.mean()) / (3.0 * sigma * sigma)
                })
                .collect();
            let n = SEEDS as f64;
            let bias = differences.iter().sum::<f64>() / n;
            let deviation = differences.iter().map(|d| (d - bias).powi(2)).sum::<f64>() / (n - 1.0);
            let of_the_mean = (deviation / n).sqrt();
            // The deviation is itself estimated, from ten values: 4.8 is Student's t for one false alarm in a thousand.
            let what = format!("{preset}, candidate {k}: bias in units of the variance");
            assert_close(bias, 0.0, 4.8 * of_the_mean, &what);
            assert!(of_the_mean < 0.02, "{what} is known to ± {of_the_mean} only");
        }
    }
}

// The whole.

#[test]
fn a_constant_image_stays_constant() {
    let mut random = Random(8);
    let (width, height) = (12, 10);
    let values = [0.0, 0.25, 7.0];
    let frame = Frame {
        color: Signal {
            mean: values.map(|v| Grid::filled(width, height, v)).to_vec(),
            spread: Some(planes(3, || random.gaussian_grid(width, height, 0.0, 0.1))),
            sample_variance: Some(planes(3, || random.uniform_grid(width, height, 0.0, 0.02))),
        },
        features: vec![Signal { mean: vec![Grid::filled(width, height, 0.5)], spread: None, sample_variance: None }],
        explaining: Vec::new(),
    };
    for (preset, params) in presets() {
        let result = dfc(&frame, &params);
        for (name, pass) in every_output(&result) {
            for (plane, value) in pass.mean.iter().zip(values) {
                for &actual in &plane.values {
                    assert_close(actual, value, 1e-12, &format!("{preset}, {name}"));
                }
            }
        }
    }
}

/// Every pixel differs in colour from all others, so only the pixel itself has weight in filters that compare the
/// colour. THIRD, which does not, has an error.
#[test]
fn an_image_without_noise_is_left_alone() {
    let mut random = Random(9);
    let mean = planes(3, || random.uniform_grid(12, 10, 0.1, 2.0));
    let zero = || Some(planes(3, || Grid::filled(12, 10, 0.0)));
    let frame = Frame {
        color: Signal { mean: mean.clone(), spread: zero(), sample_variance: zero() },
        features: Vec::new(),
        explaining: Vec::new(),
    };
    for (preset, params) in presets() {
        let result = dfc(&frame, &params);
        for (name, pass) in every_output(&result) {
            assert_planes_close(&pass.mean, &mean, &format!("{preset}, {name}"));
        }
        for k in [FIRST, SECOND] {
            assert_planes_close(&result.candidates[k].mean, &mean, &format!("{preset}, candidate {k}"));
        }
    }
}

#[test]
fn noise_is_reduced_and_maps_sum_to_one() {
    let (width, height, sigma) = (24, 20, 0.1);
    let clean =
        [0.4, 0.8, 1.0].map(|level| Grid::from_fn(width, height, |p| if p.x < 11 { level } else { level / 2.0 }));
    let frame = noisy_frame(&clean, sigma, 10);
    for (preset, params) in presets() {
        let result = dfc(&frame, &params);
        for p in (0..width * height).map(|i| Point { x: (i % width) as isize, y: (i / width) as isize }) {
            let sum = |maps: &Planes| maps.iter().map(|map| map.at(p)).sum::<f64>();
            assert_eq!(sum(&result.binary_maps), 1.0, "{preset}");
            assert_close(sum(&result.smoothed_maps), 1.0, 1e-12, preset);
            assert_close(sum(&result.maps), 1.0, 1e-12, preset);
        }
        for (name, pass) in every_output(&result) {
            let error: f64 =
                pass.mean.iter().zip(&clean).map(|(a, b)| a.like(|p| (a.at(p) - b.at(p)).powi(2)).mean()).sum();
            let before = 3.0 * sigma * sigma;
            assert!(error < before / 4.0, "{preset}, {name}: {error} of {before}");
        }
    }
}

#[test]
fn the_smallest_images_have_a_result() {
    for (width, height) in [(1, 1), (1, 5), (5, 1), (2, 2)] {
        let mut random = Random(11);
        let clean = planes(3, || random.uniform_grid(width, height, 0.0, 1.0));
        let mut frame = noisy_frame(&clean, 0.1, 12);
        for halves in [true, false] {
            if !halves {
                frame.color.spread = None;
                frame.features[0].spread = None;
            }
            for (preset, params) in presets() {
                let result = dfc(&frame, &params);
                assert_eq!(result.pass2.is_some(), halves, "{preset}");
                for (name, pass) in every_output(&result) {
                    let finite = pass.mean.iter().flat_map(|plane| &plane.values);
                    assert_eq!(finite.filter(|v| v.is_finite()).count(), 3 * width * height, "{name}");
                }
            }
        }
    }
}
