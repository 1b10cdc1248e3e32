//! `nlm_distance` and `nlm_filter`: one operator, so they are tested together.

use stein::gpu::Gpu;
use stein::stage::nlm::{Beside, CentreWeight, Filtered, Guide, Payload, Schedule, Symmetry, Weighting, nlm_filter};

use crate::common::{
    Scene, assert_near, bits, calm_scene, checked_gpu, extent_of, gpu, own_size, packed, read, run, scene, schedules,
    upload,
};
use crate::reference::random::Random;
use crate::reference::{self, Grid, Planes, Point};
use crate::{FILTERED, filtered_twin};

#[derive(Clone, Copy, Debug)]
struct Case {
    width: usize,
    height: usize,
    window_radius: u32,
    patch_radius: u32,
    channels: usize,
    payload_planes: usize,
    symmetric: bool,
    centre: CentreWeight,
    residual: bool,
}

const SCHEDULE: Schedule = Schedule { scratch_bytes: 1 << 20, block_rows: 16, ..Schedule::SOFTWARE };
const K: f32 = 0.45;

/// Four channels for every plane: the kernel writes all of a vec4.
fn payload(case: Case, of: &Scene) -> Vec<Planes> {
    let mut random = Random(11);
    let noise = |random: &mut Random| crate::common::rounded(random.gaussian_grid(case.width, case.height, -2.0, 1.0));
    [&of.mean, &of.spread]
        .into_iter()
        .take(case.payload_planes)
        .map(|planes| [planes.as_slice(), &[noise(&mut random)]].concat())
        .collect()
}

fn filtered(gpu: &Gpu, case: Case, guide: &Scene, payload: &[Planes], schedule: Schedule) -> Filtered {
    let extent = extent_of(&guide.mean[0]);
    run(gpu, |rec| {
        let signal = upload(rec, &guide.mean[..case.channels])?;
        let variance_of_mean = upload(rec, &guide.variance[..case.channels])?;
        let payload = rec.upload("payload", &payload.iter().map(|plane| packed(plane)).collect::<Vec<_>>().concat())?;
        let guide = Guide {
            signal: &signal,
            variance_of_mean: &variance_of_mean,
            channels: case.channels as u32,
            k: K,
            alpha: 1.0,
            patch_radius: case.patch_radius,
            small_patch_radius: None,
            patchwise: false,
            cut: 0.0,
            beside: &[],
            grey: false,
            exact: None,
            wanted: None,
        };
        let weighting = Weighting { symmetric: rule_of(case.symmetric), centre: case.centre };
        nlm_filter(
            rec,
            extent,
            &guide,
            &Payload::new(&payload, case.payload_planes as u32),
            case.window_radius,
            weighting,
            case.residual,
            schedule,
        )
    })
}

pub(crate) fn rule_of(symmetric: bool) -> Symmetry {
    if symmetric { Symmetry::Blended } else { Symmetry::Off }
}

pub(crate) fn twin_of(centre: CentreWeight) -> reference::nlm::CentreWeight {
    match centre {
        CentreWeight::One => reference::nlm::CentreWeight::One,
        CentreWeight::LargestNeighbour => reference::nlm::CentreWeight::LargestNeighbour,
    }
}

fn twin_params(case: Case) -> reference::nlm::FilterParams {
    reference::nlm::FilterParams {
        window_radius: case.window_radius as usize,
        patch_radius: case.patch_radius as usize,
        k_color: f64::from(K),
        k_feature: f64::INFINITY,
        tau: 0.0,
        symmetric_features: case.symmetric,
        blend_pairs: case.symmetric,
        centre: twin_of(case.centre),
    }
}

fn check(gpu: &Gpu, case: Case) {
    check_guide(gpu, case, &scene(case.width, case.height, 5));
    if case.width * case.height < 3000 {
        check_guide(gpu, case, &calm_scene(case.width, case.height, 10));
    }
}

fn check_guide(gpu: &Gpu, case: Case, guide: &Scene) {
    let payload = payload(case, &scene(case.width, case.height, 6));
    let actual = filtered(gpu, case, guide, &payload, SCHEDULE);
    let extent = extent_of(&guide.mean[0]);
    let twin_guide =
        reference::nlm::Guide { mean: &guide.mean[..case.channels], variance: &guide.variance[..case.channels] };
    let params = twin_params(case);
    let expected = filtered_twin(&payload.concat(), Some(twin_guide), &[], &params);
    assert_near(
        &format!("{case:?}"),
        &read(gpu, &actual.planes, extent).concat(),
        &expected.planes,
        &expected.span,
        FILTERED,
        0.0,
    );
    let weight_sum = [expected.weight_sum];
    let what = format!("{case:?}: Σ w");
    assert_near(
        &what,
        &read(gpu, &actual.weights, extent).remove(0),
        &weight_sum,
        &own_size(&weight_sum, 0.0),
        FILTERED,
        0.0,
    );
    assert_eq!(actual.residual_variance.is_some(), case.residual);
    if let Some(residual) = &actual.residual_variance {
        let expected = reference::nlm::nlm_variance(twin_guide.variance, Some(twin_guide), &[], &params);
        // Weights are squared, and divided by their squared sum; squares below 10⁻³⁸ vanish.
        let what = format!("{case:?}: residual variance");
        assert_near(
            &what,
            &read(gpu, residual, extent).remove(0),
            &expected,
            &own_size(&expected, 1e-26),
            4.0 * FILTERED,
            0.0,
        );
    }
}

/// Neighbours from a frame beside, with the residual variance: the feature prefilter of a window in time.
fn check_in_time(gpu: &Gpu, case: Case) {
    let guides = [20, 21].map(|seed| calm_scene(case.width, case.height, seed));
    let payloads = [22, 23].map(|seed| payload(case, &scene(case.width, case.height, seed)));
    let like = &guides[0].mean[0];
    let extent = extent_of(like);
    let actual = run(gpu, |rec| {
        let signals = [upload(rec, &guides[0].mean[..case.channels])?, upload(rec, &guides[1].mean[..case.channels])?];
        let variances =
            [upload(rec, &guides[0].variance[..case.channels])?, upload(rec, &guides[1].variance[..case.channels])?];
        let packed = |payload: &[Planes]| payload.iter().map(|plane| packed(plane)).collect::<Vec<_>>().concat();
        let payloads =
            [rec.upload("payload", &packed(&payloads[0]))?, rec.upload("payload beside", &packed(&payloads[1]))?];
        let guide = Guide {
            signal: &signals[0],
            variance_of_mean: &variances[0],
            channels: case.channels as u32,
            k: K,
            alpha: 1.0,
            patch_radius: case.patch_radius,
            small_patch_radius: None,
            patchwise: false,
            cut: 0.0,
            beside: &[Beside { signal: &signals[1], variance_of_mean: &variances[1] }],
            grey: false,
            exact: None,
            wanted: None,
        };
        let weighting = Weighting { symmetric: rule_of(case.symmetric), centre: case.centre };
        let payload = Payload { beside: &[&payloads[1]], ..Payload::new(&payloads[0], case.payload_planes as u32) };
        nlm_filter(rec, extent, &guide, &payload, case.window_radius, weighting, case.residual, SCHEDULE)
    });

    let params = twin_params(case);
    let twin = |frame: usize| reference::nlm::Guide {
        mean: &guides[frame].mean[..case.channels],
        variance: &guides[frame].variance[..case.channels],
    };
    let beside = [reference::nlm::Beside { guide: Some(twin(1)), features: &[] }];
    let windows = reference::map_pixels(case.width, case.height, |p| {
        let (own, others) = reference::nlm::window_weights_in_time(like, p, Some(twin(0)), &[], &beside, &params);
        [own.iter().collect::<Vec<_>>(), others[0].clone()]
    });
    // Σ over both frames of a function of frame, position and weight.
    let sum = |term: &dyn Fn(usize, Point, f64) -> f64| {
        let of = |window: &[Vec<(Point, f64)>; 2]| {
            (0..2).flat_map(|frame| window[frame].iter().map(move |(q, w)| term(frame, *q, *w))).sum()
        };
        Grid { values: windows.iter().map(of).collect(), ..*like }
    };
    let weight_sum = sum(&|_, _, w| w);
    let planes: [Planes; 2] = payloads.map(|planes| planes.concat());
    let mean = |plane: usize| {
        let sums = sum(&|frame, q, w| w * planes[frame][plane].at(q));
        like.like(|p| sums.at(p) / weight_sum.at(p))
    };
    let span = |plane: usize| {
        let at = |p: Point, window: &[Vec<(Point, f64)>; 2]| {
            let centre = planes[0][plane].at(p);
            let terms = (0..2).flat_map(|frame| window[frame].iter().map(move |(q, w)| (frame, *q, *w)));
            terms.map(|(frame, q, w)| w * (planes[frame][plane].at(q) - centre).abs()).sum::<f64>() / weight_sum.at(p)
                + 0.01 * centre.abs()
        };
        like.like(|p| at(p, &windows[like.index(p)]))
    };
    let count = 0..planes[0].len();
    let (means, spans): (Planes, Planes) = (count.clone().map(mean).collect(), count.map(span).collect());
    assert_near(
        &format!("{case:?} in time"),
        &read(gpu, &actual.planes, extent).concat(),
        &means,
        &spans,
        FILTERED,
        0.0,
    );
    let (what, sums) = (format!("{case:?} in time: Σ w"), std::slice::from_ref(&weight_sum));
    assert_near(&what, &read(gpu, &actual.weights, extent).remove(0), sums, &own_size(sums, 0.0), FILTERED, 0.0);
    if let Some(residual) = &actual.residual_variance {
        let of_channel = |channel: usize| {
            let sums = sum(&|frame, q, w| w * w * guides[frame].variance[channel].at(q));
            like.like(|p| sums.at(p) / weight_sum.at(p).powi(2))
        };
        let expected: Planes = (0..case.channels).map(of_channel).collect();
        let what = format!("{case:?} in time: residual variance");
        assert_near(
            &what,
            &read(gpu, residual, extent).remove(0),
            &expected,
            &own_size(&expected, 1e-26),
            4.0 * FILTERED,
            0.0,
        );
    }
}

const PLAIN: Case = Case {
    width: 257,
    height: 89,
    window_radius: 2,
    patch_radius: 1,
    channels: 3,
    payload_planes: 1,
    symmetric: false,
    centre: CentreWeight::One,
    residual: false,
};
const BEST: Case = Case { symmetric: true, centre: CentreWeight::LargestNeighbour, payload_planes: 2, ..PLAIN };
/// Windows that reach beyond the image on both sides.
const WIDE: Case = Case { width: 24, height: 20, window_radius: 10, patch_radius: 3, ..BEST };

#[test]
fn plain_weights() {
    check(gpu(), PLAIN);
    check(gpu(), Case { width: 7, height: 300, window_radius: 3, patch_radius: 3, payload_planes: 2, ..PLAIN });
    check(gpu(), Case { symmetric: false, centre: CentreWeight::One, ..WIDE });
    check(gpu(), Case { symmetric: false, payload_planes: 1, ..WIDE });
}

#[test]
fn symmetric_weights() {
    check(gpu(), BEST);
    check(gpu(), Case { width: 7, height: 300, window_radius: 3, patch_radius: 3, ..BEST });
    check(gpu(), WIDE);
    check(gpu(), Case { centre: CentreWeight::One, ..WIDE });
}

#[test]
fn guides_of_one_to_three_channels_with_residual_variance() {
    for channels in 1..=3 {
        check(gpu(), Case { width: 40, height: 31, window_radius: 5, channels, residual: true, ..WIDE });
        check(gpu(), Case { channels, residual: true, symmetric: false, centre: CentreWeight::One, ..WIDE });
    }
}

#[test]
fn single_pixels_have_no_patch() {
    check(gpu(), Case { width: 33, height: 21, patch_radius: 0, ..WIDE });
}

#[test]
fn images_of_one_pixel_one_row_and_one_column() {
    for (width, height) in [(1, 1), (1, 9), (9, 1), (2, 2)] {
        check(gpu(), Case { width, height, residual: true, ..WIDE });
        check(gpu(), Case { width, height, residual: true, ..PLAIN });
    }
}

#[test]
fn windows_over_two_frames() {
    let case = Case { width: 31, height: 18, window_radius: 4, ..WIDE };
    check_in_time(gpu(), Case { residual: true, ..case });
    check_in_time(gpu(), Case { channels: 1, symmetric: false, centre: CentreWeight::One, payload_planes: 1, ..case });
    check_in_time(checked_gpu(), Case { width: 1, height: 9, ..case });
}

#[test]
fn checked_kernels_agree() {
    check(checked_gpu(), Case { width: 17, height: 23, residual: true, ..WIDE });
    check(checked_gpu(), Case { width: 17, height: 23, window_radius: 3, ..PLAIN });
}

#[test]
fn every_schedule_gives_the_same_bits() {
    for case in [
        Case { width: 29, height: 37, window_radius: 4, residual: true, ..WIDE },
        Case { width: 29, height: 37, window_radius: 4, ..PLAIN },
    ] {
        let guide = scene(case.width, case.height, 7);
        let payload = payload(case, &scene(case.width, case.height, 8));
        let result = |schedule| {
            let filtered = filtered(gpu(), case, &guide, &payload, schedule);
            let residual = filtered.residual_variance.iter().flat_map(|residual| bits(gpu(), residual));
            [bits(gpu(), &filtered.planes), bits(gpu(), &filtered.weights)]
                .concat()
                .into_iter()
                .chain(residual)
                .collect::<Vec<_>>()
        };
        let whole = result(Schedule { scratch_bytes: 64 << 20, block_rows: 16, ..Schedule::SOFTWARE });
        for schedule in schedules() {
            assert!(result(schedule) == whole, "{case:?} with {schedule:?}");
        }
    }
}

/// With any weights, the average of a constant image is the image, to the last digit.
#[test]
fn a_constant_payload_stays_as_it_is() {
    let case = Case { width: 33, height: 29, ..WIDE };
    let payload = vec![vec![Grid::filled(33, 29, f64::from(0.1f32)); 4]; 2];
    let planes = filtered(gpu(), case, &scene(33, 29, 9), &payload, SCHEDULE).planes;
    assert!(bits(gpu(), &planes).into_iter().all(|bits| bits == 0.1f32.to_bits()));
}
