//! The NL-means filter of chapter 7, where it differs from chapter 8 (cancellation, rule for pairs, patchwise weights,
//! their cut), and the stages around it.

use stein::gpu::Gpu;
use stein::stage::error::error_halves;
use stein::stage::half::{half_join, half_split};
use stein::stage::nlm::{CentreWeight, Filtered, Guide, Payload, Schedule, Symmetry, Weighting, nlm_filter};
use stein::stage::sample::{GpuSamples, sample_attach};
use stein::stage::variance::{variance_clamp, variance_pair};

use crate::FILTERED;
use crate::common::{
    Scene, assert_near, bits, calm_scene, checked_gpu, extent_of, gpu, own_size, packed_signal, read, rounded, run,
    scene, schedules, upload,
};
use crate::nlm::twin_of;
use crate::reference::nlm::WindowWeights;
use crate::reference::nlm_method::{self, Filter, local_variance};
use crate::reference::random::Random;
use crate::reference::variance::{Floor, floored};
use crate::reference::{self, Grid, Planes};

#[derive(Clone, Copy, Debug)]
struct Case {
    width: usize,
    height: usize,
    window_radius: u32,
    patch_radius: u32,
    alpha: f32,
    symmetric: Symmetry,
    patchwise: bool,
    cut: f32,
    centre: CentreWeight,
    residual: bool,
}

const THESIS: Case = Case {
    width: 24,
    height: 20,
    window_radius: 10,
    patch_radius: 3,
    alpha: 1.0,
    symmetric: Symmetry::Hard,
    patchwise: true,
    cut: 0.05,
    centre: CentreWeight::One,
    residual: false,
};
const SCHEDULE: Schedule = Schedule { scratch_bytes: 1 << 20, block_rows: 16, ..Schedule::SOFTWARE };
const K: f32 = 0.45;

/// Rounding may change two decisions in one of millions of weights: whether the weight of a pair is replaced, and
/// whether it is cut. Patchwise, a replaced weight enters the weights of all pixels whose patches hold it.
const FLIPPED: f64 = 0.01;

fn filtered(gpu: &Gpu, case: Case, guide: &Scene, payload: &[Grid], schedule: Schedule) -> Filtered {
    let extent = extent_of(&guide.mean[0]);
    run(gpu, |rec| {
        let (signal, variance_of_mean, payload) =
            (upload(rec, &guide.mean)?, upload(rec, &guide.variance)?, upload(rec, payload)?);
        let guide = Guide {
            signal: &signal,
            variance_of_mean: &variance_of_mean,
            channels: 3,
            k: K,
            alpha: case.alpha,
            patch_radius: case.patch_radius,
            small_patch_radius: None,
            patchwise: case.patchwise,
            cut: case.cut,
            beside: &[],
            grey: false,
            exact: None,
            wanted: None,
        };
        let weighting = Weighting { symmetric: case.symmetric, centre: case.centre };
        nlm_filter(
            rec,
            extent,
            &guide,
            &Payload::new(&payload, 1),
            case.window_radius,
            weighting,
            case.residual,
            schedule,
        )
    })
}

fn twin_filter(case: Case) -> Filter {
    Filter {
        window_radius: case.window_radius as usize,
        patch_radius: case.patch_radius as usize,
        k: K.into(),
        alpha: case.alpha.into(),
        symmetric: match case.symmetric {
            Symmetry::Off => nlm_method::Symmetry::Off,
            Symmetry::Blended => nlm_method::Symmetry::Blended,
            Symmetry::Hard => nlm_method::Symmetry::Hard,
        },
        patchwise: case.patchwise,
        cut: case.cut.into(),
        centre: twin_of(case.centre),
    }
}

fn check(gpu: &Gpu, case: Case) {
    for Scene { mean, spread, variance } in
        [scene(case.width, case.height, 71), calm_scene(case.width, case.height, 72)]
    {
        // Variances as the distances get them: between pixels without variance, float32 and float64 differ by rounding.
        let variance = floored(&mean, &variance, Floor::Printed).into_iter().map(rounded).collect();
        check_guide(gpu, case, &Scene { mean, spread, variance });
    }
}

fn check_guide(gpu: &Gpu, case: Case, guide: &Scene) {
    let payload = scene(case.width, case.height, 73).mean;
    let actual = filtered(gpu, case, guide, &payload, SCHEDULE);
    let extent = extent_of(&guide.mean[0]);
    let windows =
        nlm_method::windows(reference::nlm::Guide { mean: &guide.mean, variance: &guide.variance }, &twin_filter(case));
    let plane =
        |value: &dyn Fn(&WindowWeights) -> f64| Grid { values: windows.iter().map(value).collect(), ..guide.mean[0] };
    let expected: Planes = payload.iter().map(|of| plane(&|window| window.average(of))).collect();
    // The mean distance of a pixel's neighbours to it, as for chapter 8's weights.
    let span = |of: &Grid| {
        plane(&|window| {
            let centre = of.at(window.centre.0);
            window.iter().map(|(q, w)| w * (of.at(q) - centre).abs()).sum::<f64>() / window.sum()
                + 0.01 * centre.abs()
                + 1e-28
        })
    };
    let spans: Planes = payload.iter().map(span).collect();
    assert_near(
        &format!("{case:?}"),
        &read(gpu, &actual.planes, extent).remove(0),
        &expected,
        &spans,
        FILTERED,
        FLIPPED,
    );
    let weight_sum = [plane(&WindowWeights::sum)];
    let what = format!("{case:?}: Σ w");
    assert_near(
        &what,
        &read(gpu, &actual.weights, extent).remove(0),
        &weight_sum,
        &own_size(&weight_sum, 0.0),
        FILTERED,
        FLIPPED,
    );
    if let Some(residual) = &actual.residual_variance {
        let expected: Planes =
            guide.variance.iter().map(|of| plane(&|window| window.variance_of_average(of))).collect();
        let what = format!("{case:?}: residual variance");
        assert_near(
            &what,
            &read(gpu, residual, extent).remove(0),
            &expected,
            &own_size(&expected, 1e-26),
            4.0 * FILTERED,
            FLIPPED,
        );
    }
}

#[test]
fn as_the_chapter_says() {
    check(gpu(), THESIS);
    check(gpu(), Case { residual: true, centre: CentreWeight::LargestNeighbour, ..THESIS });
}

#[test]
fn every_rule_by_itself() {
    let plain = Case { window_radius: 4, symmetric: Symmetry::Off, patchwise: false, cut: 0.0, ..THESIS };
    check(gpu(), Case { alpha: 4.0, ..plain });
    check(gpu(), Case { alpha: 0.0, ..plain });
    check(gpu(), Case { symmetric: Symmetry::Hard, ..plain });
    check(gpu(), Case { patchwise: true, ..plain });
    check(gpu(), Case { cut: 0.05, ..plain });
    check(gpu(), Case { symmetric: Symmetry::Blended, patchwise: true, alpha: 0.5, ..plain });
}

#[test]
fn odd_sizes() {
    let small = Case { window_radius: 2, patch_radius: 1, ..THESIS };
    check(gpu(), Case { width: 257, height: 89, ..small });
    check(gpu(), Case { width: 7, height: 300, window_radius: 3, ..THESIS });
    for (width, height) in [(1, 1), (1, 9), (9, 1), (2, 2)] {
        check(gpu(), Case { width, height, ..THESIS });
    }
}

/// The bilateral limit (figure 7.10): a patch of one pixel has one weight.
#[test]
fn single_pixels_have_no_patch() {
    let case = Case { width: 33, height: 21, patch_radius: 0, ..THESIS };
    check(gpu(), case);
    let guide = calm_scene(33, 21, 74);
    let planes =
        |patchwise| bits(gpu(), &filtered(gpu(), Case { patchwise, ..case }, &guide, &guide.mean, SCHEDULE).planes);
    assert!(planes(true) == planes(false));
}

#[test]
fn checked_kernels_agree() {
    check(checked_gpu(), Case { width: 17, height: 23, residual: true, ..THESIS });
}

#[test]
fn every_schedule_gives_the_same_bits() {
    let case = Case { width: 29, height: 37, window_radius: 4, ..THESIS };
    let guide = scene(29, 37, 75);
    let result = |schedule| {
        let filtered = filtered(gpu(), case, &guide, &guide.spread, schedule);
        [bits(gpu(), &filtered.planes), bits(gpu(), &filtered.weights)].concat()
    };
    let whole = result(Schedule { scratch_bytes: 64 << 20, block_rows: 16, ..Schedule::SOFTWARE });
    for schedule in schedules() {
        assert!(result(schedule) == whole, "{schedule:?}");
    }
}

/// p lies between two neighbours of which only the mean is like p: the weight of the mean, e⁰, exceeds the sum of
/// theirs, and both get it. If one of them alone is like p, no weight is replaced: no weight exceeds 1 + w.
#[test]
fn pairs_are_replaced_only_where_their_mean_is_better_than_both() {
    let case = Case { width: 3, height: 1, window_radius: 1, patch_radius: 0, patchwise: false, cut: 0.0, ..THESIS };
    let row = |values: [f64; 3]| vec![Grid { width: 3, height: 1, values: values.to_vec() }; 3];
    let weight_sum = |mean: [f64; 3]| {
        let guide = Scene { mean: row(mean), spread: row([0.0; 3]), variance: row([1e-2; 3]) };
        read(gpu(), &filtered(gpu(), case, &guide, &guide.mean, SCHEDULE).weights, extent_of(&guide.mean[0]))
            .remove(0)
            .remove(0)
            .values[1]
    };
    assert_eq!(weight_sum([0.0, 1.0, 2.0]), 3.0);
    // The distance of 1 is (1 − 0.02)/(0.45²·0.02), so its weight vanishes.
    assert!((weight_sum([1.0, 1.0, 2.0]) - 2.0).abs() < 1e-6);
}

/// A neighbour whose weight is just below the cut has none.
#[test]
fn weights_below_the_cut_do_not_count() {
    // (d² − 0.02)/(0.45²·0.02) = −ln w, for weights of 0.06 and 0.04.
    let [more, less] = [0.06f64, 0.04].map(|w| (0.02 - w.ln() * 0.45f64.powi(2) * 0.02).sqrt());
    let case = Case { width: 3, height: 1, window_radius: 1, patch_radius: 0, symmetric: Symmetry::Off, ..THESIS };
    let row = |values: [f64; 3]| vec![Grid { width: 3, height: 1, values: values.to_vec() }; 3];
    let guide = Scene { mean: row([-more, 0.0, less]), spread: row([0.0; 3]), variance: row([1e-2; 3]) };
    let weights = |cut| {
        read(
            gpu(),
            &filtered(gpu(), Case { cut, ..case }, &guide, &guide.mean, SCHEDULE).weights,
            extent_of(&guide.mean[0]),
        )
        .remove(0)
        .remove(0)
    };
    for (cut, expected) in [(0.0, 1.10), (0.05, 1.06), (0.07, 1.0)] {
        let found = weights(cut).values[1];
        assert!((found - expected).abs() < 1e-5, "cut {cut}: {found} instead of {expected}");
    }
}

#[test]
fn halves_are_split_and_joined() {
    for (gpu, width, height) in [(gpu(), 257, 89), (gpu(), 7, 300), (gpu(), 1, 1), (checked_gpu(), 31, 9)] {
        let scene = scene(width, height, 76);
        let extent = extent_of(&scene.mean[0]);
        let sums =
            [Random(77).uniform_grid(width, height, 1.0, 400.0), Random(78).uniform_grid(width, height, 1.0, 400.0)];
        let (halves, joined) = run(gpu, |rec| {
            let signal = rec.upload("signal", &packed_signal(&scene.mean, &scene.spread))?;
            let variance = upload(rec, &scene.variance)?;
            let halves = half_split(rec, extent, &signal, &variance)?;
            let filtered = |rec: &mut stein::gpu::Recorder, planes: &[Grid], sum: &Grid| {
                Ok::<_, stein::Error>(Filtered {
                    planes: upload(rec, planes)?,
                    weights: upload(rec, std::slice::from_ref(sum))?,
                    residual_variance: None,
                })
            };
            let (a, b) = (filtered(rec, &scene.mean, &sums[0])?, filtered(rec, &scene.spread, &sums[1])?);
            let joined = half_join(rec, extent, [&a, &b])?;
            Ok((halves, joined))
        });
        let combined = |a: f64, b: f64| -> Planes {
            scene
                .mean
                .iter()
                .zip(&scene.spread)
                .map(|(mean, spread)| mean.like(|p| a * mean.at(p) + b * spread.at(p)))
                .collect()
        };
        // Differences of values up to 10⁴.
        let size: Planes = scene
            .mean
            .iter()
            .zip(&scene.spread)
            .map(|(mean, spread)| mean.like(|p| mean.at(p).abs() + spread.at(p).abs()))
            .collect();
        let near = |what: &str, actual: &[Grid], expected: &[Grid], size: &[Grid]| {
            assert_near(&format!("{what}, {width}×{height}"), actual, expected, size, 3e-7, 0.0);
        };
        near("half A", &read(gpu, &halves.a, extent)[0], &combined(1.0, 1.0), &size);
        near("half B", &read(gpu, &halves.b, extent)[0], &combined(1.0, -1.0), &size);
        // Chapter 7 uses the variance of one half.
        let of_half: Planes = scene.variance.iter().map(|grid| grid.like(|p| 2.0 * grid.at(p))).collect();
        near("variance of a half", &read(gpu, &halves.variance, extent)[0], &of_half, &own_size(&of_half, 0.0));
        let signal = read(gpu, &joined.planes, extent);
        near("joined mean", &signal[0], &combined(0.5, 0.5), &size);
        near("joined half spread", &signal[1], &combined(0.5, -0.5), &size);
        let weights = [sums[0].like(|p| (sums[0].at(p) + sums[1].at(p)) / 2.0)];
        near("Σ w", &read(gpu, &joined.weights, extent)[0], &weights, &own_size(&weights, 0.0));
    }
}

#[test]
fn variance_of_the_sample_variance_and_its_bound() {
    for (gpu, width, height) in [(gpu(), 257, 89), (gpu(), 7, 300), (gpu(), 1, 1), (checked_gpu(), 31, 9)] {
        let scene = scene(width, height, 79);
        let extent = extent_of(&scene.mean[0]);
        let (pair, clamped) = run(gpu, |rec| {
            let signal = rec.upload("signal", &packed_signal(&scene.mean, &scene.spread))?;
            let variance = upload(rec, &scene.variance)?;
            let pair = variance_pair(rec, extent, &signal, &variance)?;
            let clamped = variance_clamp(rec, extent, &pair.two_buffer_variance, &variance)?;
            Ok((pair, clamped))
        });
        let near = |what: &str, actual: &[Grid], expected: &[Grid]| {
            assert_near(&format!("{what}, {width}×{height}"), actual, expected, &own_size(expected, 1e-12), 2e-5, 0.0);
        };
        let squared: Planes = scene.spread.iter().map(|grid| grid.like(|p| grid.at(p).powi(2))).collect();
        near("two-buffer variance", &read(gpu, &pair.two_buffer_variance, extent)[0], &squared);
        near(
            "uncertainty",
            &read(gpu, &pair.uncertainty, extent)[0],
            &scene.variance.iter().map(local_variance).collect::<Vec<_>>(),
        );
        let least: Planes = squared
            .iter()
            .zip(&scene.variance)
            .map(|(squared, bound)| squared.like(|p| squared.at(p).min(bound.at(p))))
            .collect();
        near("clamped", &read(gpu, &clamped, extent)[0], &least);
    }
}

/// Eq. of section 7.1.2, from the halves themselves.
#[test]
fn errors_of_the_halves() {
    for (gpu, width, height) in [(gpu(), 257, 89), (gpu(), 7, 300), (gpu(), 1, 1), (checked_gpu(), 31, 9)] {
        let scene = scene(width, height, 80);
        let extent = extent_of(&scene.mean[0]);
        let sum = Random(81).uniform_grid(width, height, 1.0, 400.0);
        let counts = Grid::from_fn(width, height, |p| ((p.x + 2 * p.y) % 50) as f64);
        for halves in [true, false] {
            let errors = run(gpu, |rec| {
                let mean = [scene.mean.as_slice(), std::slice::from_ref(&counts)].concat();
                let planes = rec.upload("signal", &packed_signal(&mean, &scene.spread))?;
                let weights = upload(rec, std::slice::from_ref(&sum))?;
                let residual_variance = if halves { None } else { Some(upload(rec, &scene.variance)?) };
                error_halves(rec, extent, &Filtered { planes, weights, residual_variance })
            });
            let expected = scene.mean[0].like(|p| {
                let channel = |i: usize| {
                    let (mean, spread) = (scene.mean[i].at(p), if halves { scene.spread[i].at(p) } else { 0.0 });
                    let (a, b) = (mean + spread, mean - spread);
                    let squared = if halves { (a - b).powi(2) } else { 4.0 * scene.variance[i].at(p) };
                    squared / (1e-3 + a * a) + squared / (1e-3 + b * b)
                };
                (0..3).map(channel).sum::<f64>() / 3.0 * sum.at(p) / (1.0 + sum.at(p) * counts.at(p))
            });
            let left = scene.mean[0].like(|p| {
                (0..3).map(|i| if halves { scene.spread[i].at(p).powi(2) } else { scene.variance[i].at(p) }).sum()
            });
            let expected = [expected, left];
            // A half may be the small difference of mean and spread.
            let what = format!("halves {halves}, {width}×{height}");
            assert_near(&what, &read(gpu, &errors, extent)[0], &expected, &own_size(&expected, 1e-12), 1e-4, 0.001);
        }
    }
}

#[test]
fn samples_go_along_with_the_colour() {
    for (gpu, width, height) in [(gpu(), 257, 89), (gpu(), 1, 1), (checked_gpu(), 31, 9)] {
        let scene = scene(width, height, 82);
        let extent = extent_of(&scene.mean[0]);
        let counts = Grid::from_fn(width, height, |p| ((p.x + 2 * p.y) % 50) as f64);
        for vary in [false, true] {
            let attached = run(gpu, |rec| {
                let signal = rec.upload("signal", &packed_signal(&scene.mean, &scene.spread))?;
                let samples = if vary {
                    GpuSamples::PerPixel(upload(rec, std::slice::from_ref(&counts))?)
                } else {
                    GpuSamples::Uniform(16.0)
                };
                sample_attach(rec, extent, &signal, &samples)
            });
            let planes = read(gpu, &attached, extent);
            assert!(planes[0][..3] == scene.mean && planes[1][..3] == scene.spread);
            assert!(planes[0][3] == counts.like(|p| if vary { counts.at(p).max(1.0) } else { 16.0 }));
        }
    }
}
