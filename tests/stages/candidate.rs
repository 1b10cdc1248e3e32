//! `candidate_accumulate` and `candidate_resolve`: FIRST, SECOND and THIRD with their derivatives.

use stein::gpu::Gpu;
use stein::stage::candidate::{CandidateFilter, Candidates, candidates};
use stein::stage::nlm::{CentreWeight, Schedule, Weighting};

use crate::common::{Scene, assert_near, bits, calm_scene, checked_gpu, extent_of, gpu, own_size, packed_signal, read, run, scene, upload};
use crate::feature::{features, pack};
use crate::nlm::{rule_of, twin_of};
use crate::reference::candidates::{analytic_derivative, candidate, finite_difference, finite_difference_step};
use crate::reference::nlm::{Feature, FilterParams, Guide};
use crate::reference::{Grid, Planes};
use crate::{FILTERED, filtered_twin};

/// A derivative is a difference of two filtered values over the step between them: errors of a millionth of a span, divided by the step. Rounding errors of the
/// distances are the same in both values and cancel, so that this is less than [`FILTERED`].
const DERIVATIVE: f64 = 2e-5;

#[derive(Clone, Copy, Debug)]
struct Case {
    width: usize,
    height: usize,
    window_radius: u32,
    patch_radii: [u32; 2],
    /// Numbers of channels.
    features: &'static [usize],
    symmetric: bool,
    centre: CentreWeight,
}

const NAMES: [&str; 3] = ["FIRST", "SECOND", "THIRD"];
const SCHEDULE: Schedule = Schedule { scratch_bytes: 1 << 20, block_rows: 16 };

fn filter(case: Case) -> CandidateFilter {
    CandidateFilter {
        window_radius: case.window_radius,
        color_k: 0.45,
        first_patch_radius: case.patch_radii[0],
        second_patch_radius: case.patch_radii[1],
        feature_k: 0.6,
        feature_tau: 1e-2,
        feature_tau_third: 5e-4,
        weighting: Weighting { symmetric: rule_of(case.symmetric), centre: case.centre },
    }
}

fn twin_params(case: Case) -> [FilterParams; 3] {
    let filter = filter(case);
    let first = FilterParams {
        window_radius: case.window_radius as usize,
        patch_radius: case.patch_radii[0] as usize,
        k_color: f64::from(filter.color_k),
        k_feature: f64::from(filter.feature_k),
        tau: f64::from(filter.feature_tau),
        symmetric_features: case.symmetric,
        blend_pairs: case.symmetric,
        centre: twin_of(case.centre),
    };
    let second = FilterParams { patch_radius: case.patch_radii[1] as usize, ..first };
    [first, second, FilterParams { k_color: f64::INFINITY, tau: f64::from(filter.feature_tau_third), blend_pairs: false, ..first }]
}

fn filtered(gpu: &Gpu, case: Case, scene: &Scene, features: &[Feature], schedule: Schedule) -> Candidates {
    let extent = extent_of(&scene.mean[0]);
    run(gpu, |rec| {
        let signal = rec.upload("signal", &packed_signal(&scene.mean, &scene.spread))?;
        let variance = upload(rec, &scene.variance)?;
        let features = if features.is_empty() { None } else { Some(pack(rec, features)?) };
        candidates(rec, extent, &signal, &variance, features.as_ref(), &filter(case), schedule, |_, _| Ok(()))
    })
}

fn check_scene(gpu: &Gpu, case: Case, scene: &Scene) {
    let features = features(case.width, case.height, case.features, 31);
    let actual = filtered(gpu, case, scene, &features, SCHEDULE);
    let extent = extent_of(&scene.mean[0]);
    let derivatives = read(gpu, &actual.derivatives, extent);
    let guide = Guide { mean: &scene.mean, variance: &scene.variance };
    for (k, params) in twin_params(case).into_iter().enumerate() {
        let what = |part: &str| format!("{case:?}: {} {part}", NAMES[k]);
        let signal = read(gpu, &actual.signals[k], extent);
        let payload = [scene.mean.as_slice(), &scene.spread].concat();
        let expected = filtered_twin(&payload, Some(guide), &features, &params);
        let (mean, spread) = expected.planes.split_at(3);
        let (mean_span, spread_span) = expected.span.split_at(3);
        assert_near(&what("mean"), &signal[0][..3], mean, mean_span, FILTERED, 0.0);
        assert_near(&what("half spread"), &signal[1][..3], spread, spread_span, FILTERED, 0.0);
        let weight_sum = [expected.weight_sum];
        assert_near(&what("Σ w"), &signal[0][3..], &weight_sum, &own_size(&weight_sum, 0.0), FILTERED, 0.0);

        let twin = candidate(&scene.mean, None, &scene.variance, &features, &params);
        let per_step = |i: usize| {
            let step = |p| finite_difference_step(scene.mean[i].at(p), scene.variance[i].at(p)).abs();
            mean_span[i].like(|p| 1.0 + twin.derivative[i].at(p).abs() + mean_span[i].at(p) / step(p))
        };
        let scale: Planes = (0..3).map(per_step).collect();
        assert_near(&what("derivative"), &derivatives[k][..3], &twin.derivative, &scale, DERIVATIVE, 0.0);
    }
}

fn check(gpu: &Gpu, case: Case) {
    check_scene(gpu, case, &scene(case.width, case.height, 32));
    if case.width * case.height < 3000 {
        check_scene(gpu, case, &calm_scene(case.width, case.height, 35));
    }
}

const LITERAL: Case = Case { width: 257, height: 89, window_radius: 2, patch_radii: [0, 1], features: &[], symmetric: false, centre: CentreWeight::One };
const BEST: Case = Case { symmetric: true, centre: CentreWeight::LargestNeighbour, ..LITERAL };
/// The method's own radii, and windows that reach beyond the image on both sides.
const WIDE: Case = Case { width: 24, height: 20, window_radius: 10, patch_radii: [1, 3], ..BEST };

#[test]
fn without_features() {
    check(gpu(), LITERAL);
    check(gpu(), BEST);
}

#[test]
fn with_one_feature() {
    check(gpu(), Case { width: 7, height: 300, window_radius: 3, patch_radii: [1, 3], features: &[1], ..BEST });
    check(gpu(), Case { width: 7, height: 300, window_radius: 3, patch_radii: [1, 3], features: &[3], ..LITERAL });
}

#[test]
fn with_four_features_at_the_full_radius() {
    check(gpu(), Case { features: &[3, 3, 1, 1], ..WIDE });
    check(gpu(), Case { features: &[3, 3, 1, 1], symmetric: false, centre: CentreWeight::One, ..WIDE });
}

#[test]
fn with_eight_features() {
    check(gpu(), Case { width: 23, height: 17, window_radius: 3, features: &[1, 2, 3, 1, 2, 3, 1, 1], ..WIDE });
    check(gpu(), Case { width: 23, height: 17, window_radius: 3, features: &[3; 8], symmetric: false, ..WIDE });
}

#[test]
fn with_patches_of_one_size_and_of_one_pixel() {
    check(gpu(), Case { width: 31, height: 22, window_radius: 3, patch_radii: [2, 2], features: &[1], ..WIDE });
    check(gpu(), Case { width: 31, height: 22, window_radius: 3, patch_radii: [0, 0], centre: CentreWeight::One, ..WIDE });
}

#[test]
fn of_one_pixel_one_row_and_one_column() {
    for (width, height) in [(1, 1), (1, 9), (9, 1), (2, 2)] {
        check(gpu(), Case { width, height, features: &[3], ..WIDE });
        check(gpu(), Case { width, height, features: &[], symmetric: false, centre: CentreWeight::One, ..WIDE });
    }
}

#[test]
fn from_checked_kernels() {
    check(checked_gpu(), Case { width: 19, height: 14, window_radius: 4, features: &[3, 1, 1], ..WIDE });
    check(checked_gpu(), Case { width: 19, height: 14, window_radius: 4, features: &[], symmetric: false, ..WIDE });
}

/// What is computed must not depend on how the work is cut up: strips of rows, chunks of pairs, blocks of rows in one invocation.
#[test]
fn every_schedule_gives_the_same_bits() {
    for case in [Case { window_radius: 4, height: 37, features: &[3, 1, 1], ..WIDE }, Case { window_radius: 4, height: 37, symmetric: false, ..WIDE }] {
        let scene = scene(case.width, case.height, 33);
        let features = features(case.width, case.height, case.features, 34);
        let result = |schedule| {
            let candidates = filtered(gpu(), case, &scene, &features, schedule);
            candidates.signals.iter().chain([&candidates.derivatives]).map(|buffer| bits(gpu(), buffer)).collect::<Vec<_>>()
        };
        let whole = result(Schedule { scratch_bytes: 64 << 20, block_rows: 16 });
        for scratch_bytes in [16, 1 << 12, 30_000, 1 << 18] {
            for block_rows in [1, 5, 32] {
                let schedule = Schedule { scratch_bytes, block_rows };
                assert!(result(schedule) == whole, "{case:?} with {schedule:?}");
            }
        }
    }
}

/// The finite difference with the step that the text prescribes against the derivative itself. A step of 1 % of the value sees the curvature of F and may cross
/// one of its kinks (a weight that reaches 1, a blend that begins); the step backwards sees the other side of it. So the two may differ by twice what the steps in both
/// directions differ by, and by f32's part; kinks on both sides within 1 % are left for the half percent.
#[test]
fn finite_differences_approach_the_analytic_derivative() {
    let (width, height) = (24, 18);
    let scene = calm_scene(width, height, 35);
    let extent = extent_of(&scene.mean[0]);
    for symmetric in [false, true] {
        for centre in [CentreWeight::One, CentreWeight::LargestNeighbour] {
            let case = Case { width, height, window_radius: 3, patch_radii: [1, 3], features: &[3, 1], symmetric, centre };
            let features = features(width, height, case.features, 36);
            let derivatives = run(gpu(), |rec| {
                let signal = rec.upload("signal", &packed_signal(&scene.mean, &scene.spread))?;
                let variance = upload(rec, &scene.variance)?;
                let packed = pack(rec, &features)?;
                candidates(rec, extent, &signal, &variance, Some(&packed), &filter(case), SCHEDULE, |_, _| Ok(()))
            })
            .derivatives;
            for (k, (actual, params)) in read(gpu(), &derivatives, extent).into_iter().zip(twin_params(case)).enumerate() {
                let plane = |i: usize| {
                    scene.mean[i].like(|p| {
                        let step = finite_difference_step(scene.mean[i].at(p), scene.variance[i].at(p));
                        let difference = |step| finite_difference(&scene.mean, &scene.variance, &features, &params, p, i, step);
                        2.0 * (difference(step) - difference(-step)).abs() + 1e-3
                    })
                };
                let scale: Planes = (0..3).map(plane).collect();
                let expected: Planes =
                    (0..3).map(|i| scene.mean[i].like(|p| analytic_derivative(&scene.mean, &scene.variance, &features, &params, p, i))).collect();
                assert_near(&format!("{case:?}: {} against the analytic derivative", NAMES[k]), &actual[..3], &expected, &scale, 1.0, 0.005);
                let mean = |planes: &[Grid]| planes.iter().map(Grid::mean).sum::<f64>() / 3.0;
                assert!(mean(&scale) < 0.05, "a tolerance of {} proves nothing", mean(&scale));
                assert!(mean(&expected) > 0.02, "a derivative of {} proves nothing", mean(&expected));
            }
        }
    }
}
