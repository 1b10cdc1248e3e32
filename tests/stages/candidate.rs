//! `candidate_accumulate` and `candidate_resolve`: any number of candidates with their derivatives.

use glam::IVec2;
use stein::error::Result;
use stein::gpu::{Buffer, Gpu, Recorder};
use stein::stage::candidate::{CandidateFrame, CandidateWindow, Candidates, CandidatesInTime, Needed, candidates};
use stein::stage::candidate_filter::{ByColor, ByFeatures, CandidateFilter};
use stein::stage::exact::Region;
use stein::stage::feature::Features;
use stein::stage::frames::Frames;
use stein::stage::nlm::{CentreWeight, Schedule, Weighting};

use crate::common::{
    Scene, assert_near, bits, calm_scene, checked_gpu, extent_of, gpu, own_size, packed_signal, read, rounded, run,
    scene, schedules, upload,
};
use crate::exact;
use crate::feature::{features, pack};
use crate::nlm::{rule_of, twin_of};
use crate::reference::candidates::{analytic_derivative, candidate, finite_difference, finite_difference_step};
use crate::reference::nlm::{Beside, Feature, FilterParams, Guide, window_weights, window_weights_in_time};
use crate::reference::variance::brightness_around;
use crate::reference::{Grid, Planes, Point, map_pixels};
use crate::{FILTERED, filtered_twin};

/// A derivative is a difference of two filtered values over the step between them: errors of a millionth of a span,
/// divided by the step. Rounding errors of the distances are equal in both values and cancel, so this tolerance is less
/// than [`FILTERED`].
const DERIVATIVE: f64 = 2e-5;

#[derive(Clone, Copy, Debug)]
pub(crate) struct Case {
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) window_radius: u32,
    pub(crate) patch_radii: [u32; 2],
    /// Numbers of channels.
    pub(crate) features: &'static [usize],
    pub(crate) symmetric: bool,
    pub(crate) centre: CentreWeight,
}

const SCHEDULE: Schedule = Schedule { scratch_bytes: 1 << 20, block_rows: 16, ..Schedule::SOFTWARE };

/// FIRST, SECOND and THIRD.
pub(crate) fn filters(case: Case) -> Vec<CandidateFilter> {
    let by_color = |patch_radius| Some(ByColor { k: 0.45, patch_radius });
    let features = Some(ByFeatures { k: 0.6, tau: 1e-2 });
    let of_third = Some(ByFeatures { k: 0.6, tau: 5e-4 });
    let [first, second] = case.patch_radii;
    vec![
        CandidateFilter { name: "first", color: by_color(first), features, rival: Some("second") },
        CandidateFilter { name: "second", color: by_color(second), features, rival: None },
        CandidateFilter { name: "third", color: None, features: of_third, rival: None },
    ]
}

/// The filters among FIRST, SECOND and THIRD that take part.
pub(crate) fn some_filters(case: Case, takes_part: [bool; 3]) -> Vec<CandidateFilter> {
    filters(case).into_iter().zip(takes_part).filter_map(|(filter, takes_part)| takes_part.then_some(filter)).collect()
}

pub(crate) fn window_of(case: Case) -> CandidateWindow {
    let weighting = Weighting { symmetric: rule_of(case.symmetric), centre: case.centre };
    CandidateWindow { radius: case.window_radius, weighting }
}

/// The filter as the reference calls it.
pub(crate) fn twin_params(case: Case, filter: &CandidateFilter) -> FilterParams {
    FilterParams {
        window_radius: case.window_radius as usize,
        patch_radius: filter.color.map_or(0, |color| color.patch_radius as usize),
        k_color: filter.color.map_or(f64::INFINITY, |color| color.k.into()),
        k_feature: filter.features.map_or(f64::INFINITY, |features| features.k.into()),
        tau: filter.features.map_or(1.0, |features| features.tau.into()),
        symmetric_features: case.symmetric,
        blend_pairs: case.symmetric && filter.color.is_some(),
        centre: twin_of(case.centre),
    }
}

/// The planes of all candidates.
struct Found {
    /// The means, with Σ w.
    means: Vec<Planes>,
    spreads: Vec<Planes>,
    /// Empty if no derivatives are computed.
    derivatives: Vec<Planes>,
}

fn found(gpu: &Gpu, candidates: &Candidates, extent: IVec2) -> Found {
    let derivatives = candidates.derivatives.as_ref().map(|derivatives| read(gpu, derivatives, extent));
    Found {
        means: read(gpu, &candidates.means, extent),
        spreads: read(gpu, &candidates.spreads, extent),
        derivatives: derivatives.unwrap_or_default(),
    }
}

/// The bits of all buffers, the derivatives last.
fn all_bits(gpu: &Gpu, Candidates { means, spreads, derivatives, .. }: &Candidates) -> Vec<u32> {
    [Some(means), Some(spreads), derivatives.as_ref()]
        .into_iter()
        .flatten()
        .flat_map(|buffer| bits(gpu, buffer))
        .collect()
}

/// A variance as `variance_floor` leaves it, with the brightness around each pixel in w.
pub(crate) fn upload_variance(rec: &mut Recorder, scene: &Scene) -> Result<Buffer> {
    let around = [rounded(brightness_around(&scene.mean))];
    upload(rec, &[scene.variance.as_slice(), &around].concat())
}

fn filtered(gpu: &Gpu, case: Case, scene: &Scene, features: &[Feature], schedule: Schedule) -> Candidates {
    filtered_as_needed(gpu, case, &filters(case), scene, features, Needed::EVERYTHING, schedule)
}

fn filtered_as_needed(
    gpu: &Gpu,
    case: Case,
    filters: &[CandidateFilter],
    scene: &Scene,
    features: &[Feature],
    needed: Needed,
    schedule: Schedule,
) -> Candidates {
    let extent = extent_of(&scene.mean[0]);
    let filtered = run(gpu, |rec| {
        let payload = &rec.upload("signal", &packed_signal(&scene.mean, &scene.spread))?;
        let variance_of_mean = &upload_variance(rec, scene)?;
        let features = if features.is_empty() { None } else { Some(pack(rec, features)?) };
        let frame = CandidateFrame { payload, guide: None, variance_of_mean, features: features.as_ref(), layers: &[] };
        candidates(rec, extent, &Frames::one(frame), filters, window_of(case), needed, schedule, |_, _| Ok(()))
    });
    assert!(filtered.alone.is_none(), "there is one frame only");
    filtered.together
}

fn check_scene(gpu: &Gpu, case: Case, scene: &Scene) {
    check_filters(gpu, case, &filters(case), scene);
}

fn check_filters(gpu: &Gpu, case: Case, filters: &[CandidateFilter], scene: &Scene) {
    let features = features(case.width, case.height, case.features, 31);
    let actual = filtered_as_needed(gpu, case, filters, scene, &features, Needed::EVERYTHING, SCHEDULE);
    let actual = found(gpu, &actual, extent_of(&scene.mean[0]));
    let guide = Guide { mean: &scene.mean, variance: &scene.variance };
    for (k, filter) in filters.iter().enumerate() {
        let params = twin_params(case, filter);
        let what = |part: &str| format!("{case:?}: {} {part}", filter.name);
        let payload = [scene.mean.as_slice(), &scene.spread].concat();
        let expected = filtered_twin(&payload, Some(guide), &features, &params);
        let (mean, spread) = expected.planes.split_at(3);
        let (mean_span, spread_span) = expected.span.split_at(3);
        assert_near(&what("mean"), &actual.means[k][..3], mean, mean_span, FILTERED, 0.0);
        assert_near(&what("half spread"), &actual.spreads[k][..3], spread, spread_span, FILTERED, 0.0);
        let weight_sum = [expected.weight_sum];
        assert_near(&what("Σ w"), &actual.means[k][3..], &weight_sum, &own_size(&weight_sum, 0.0), FILTERED, 0.0);

        let twin = candidate(&scene.mean, None, &scene.variance, &features, &params);
        let around = brightness_around(&scene.mean);
        let per_step = |i: usize| {
            let step = |p| finite_difference_step(scene.mean[i].at(p), scene.variance[i].at(p), around.at(p)).abs();
            mean_span[i].like(|p| 1.0 + twin.derivative[i].at(p).abs() + mean_span[i].at(p) / step(p))
        };
        let scale: Planes = (0..3).map(per_step).collect();
        assert_near(&what("derivative"), &actual.derivatives[k][..3], &twin.derivative, &scale, DERIVATIVE, 0.0);
    }
}

/// One frame of a window in time.
struct InTime {
    scene: Scene,
    features: Vec<Feature>,
}

impl InTime {
    fn new(case: Case, seed: u64) -> Self {
        Self {
            scene: calm_scene(case.width, case.height, seed),
            features: features(case.width, case.height, case.features, seed + 100),
        }
    }

    fn guide(&self) -> Guide<'_> {
        Guide { mean: &self.scene.mean, variance: &self.scene.variance }
    }

    fn payload(&self) -> Planes {
        [self.scene.mean.as_slice(), &self.scene.spread].concat()
    }
}

fn filtered_in_time(gpu: &Gpu, case: Case, frames: &[InTime], schedule: Schedule) -> CandidatesInTime {
    let extent = extent_of(&frames[0].scene.mean[0]);
    run(gpu, |rec| {
        let mut uploaded = Vec::new();
        for InTime { scene, features } in frames {
            let features = if features.is_empty() { None } else { Some(pack(rec, features)?) };
            uploaded.push((
                rec.upload("signal", &packed_signal(&scene.mean, &scene.spread))?,
                upload_variance(rec, scene)?,
                features,
            ));
        }
        let frame = |index: usize| {
            let (payload, variance_of_mean, features): &(Buffer, Buffer, Option<Features>) = &uploaded[index];
            CandidateFrame { payload, guide: None, variance_of_mean, features: features.as_ref(), layers: &[] }
        };
        let frames = Frames { own: frame(0), beside: (1..uploaded.len()).map(frame).collect() };
        let (filters, window) = (filters(case), window_of(case));
        candidates(rec, extent, &frames, &filters, window, Needed::EVERYTHING, schedule, |_, _| Ok(()))
    })
}

/// One pixel of a filtered payload.
struct Average {
    /// One value for each plane.
    mean: Vec<f64>,
    /// The weighted mean distance to the centre, and a hundredth of the centre.
    span: Vec<f64>,
    weight_sum: f64,
    centre_weight: f64,
}

/// The average around p over the first frame, its payload replaced by `own`, and the frames beside it.
fn average(frames: &[InTime], own: &[Grid], p: Point, params: &FilterParams) -> Average {
    let guide = Guide { mean: &own[..3], ..frames[0].guide() };
    let beside: Vec<_> =
        frames[1..].iter().map(|frame| Beside { guide: Some(frame.guide()), features: &frame.features }).collect();
    let (weights, others) = window_weights_in_time(&own[0], p, Some(guide), &frames[0].features, &beside, params);
    let payloads: Vec<_> = frames[1..].iter().map(InTime::payload).collect();
    let terms = |plane: usize| {
        let of_own = weights.iter().map(move |(q, w)| (own[plane].at(q), w));
        let of_others = others
            .iter()
            .zip(&payloads)
            .flat_map(move |(weights, payload)| weights.iter().map(move |(q, w)| (payload[plane].at(*q), *w)));
        of_own.chain(of_others)
    };
    let weight_sum: f64 = terms(0).map(|(_, w)| w).sum();
    let mean = |plane: usize| terms(plane).map(|(u, w)| w * u).sum::<f64>() / weight_sum;
    let span = |plane: usize| {
        let centre = own[plane].at(p);
        terms(plane).map(|(u, w)| w * (u - centre).abs()).sum::<f64>() / weight_sum + 0.01 * centre.abs()
    };
    let planes = 0..own.len();
    Average {
        mean: planes.clone().map(mean).collect(),
        span: planes.map(span).collect(),
        weight_sum,
        centre_weight: weights.centre.1,
    }
}

/// A window over three frames.
fn check_in_time(gpu: &Gpu, case: Case) {
    let frames: Vec<_> = (0..3).map(|seed| InTime::new(case, 40 + seed)).collect();
    let CandidatesInTime { together: actual, alone } = filtered_in_time(gpu, case, &frames, SCHEDULE);
    let one_frame = filtered(gpu, case, &frames[0].scene, &frames[0].features, SCHEDULE);
    assert!(
        alone.is_some_and(|alone| all_bits(gpu, &alone) == all_bits(gpu, &one_frame)),
        "{case:?}: the own frame is filtered as if there were no other"
    );
    let own = frames[0].payload();
    let like = &own[0];
    let extent = extent_of(like);
    let actual = found(gpu, &actual, extent);
    for (k, filter) in filters(case).iter().enumerate() {
        let params = twin_params(case, filter);
        let what = |part: &str| format!("{case:?} in time: {} {part}", filter.name);
        let expected = map_pixels(case.width, case.height, |p| average(&frames, &own, p, &params));
        let planes = |value: &dyn Fn(&Average, usize) -> f64| -> Planes {
            (0..6).map(|plane| Grid { values: expected.iter().map(|of| value(of, plane)).collect(), ..*like }).collect()
        };
        let (mean, span) = (planes(&|of, plane| of.mean[plane]), planes(&|of, plane| of.span[plane]));
        assert_near(&what("mean"), &actual.means[k][..3], &mean[..3], &span[..3], FILTERED, 0.0);
        assert_near(&what("half spread"), &actual.spreads[k][..3], &mean[3..], &span[3..], FILTERED, 0.0);
        let weight_sum = [planes(&|of, _| of.weight_sum).remove(0)];
        assert_near(&what("Σ w"), &actual.means[k][3..], &weight_sum, &own_size(&weight_sum, 0.0), FILTERED, 0.0);

        let around = brightness_around(&own[..3]);
        let step =
            |p: Point, i: usize| finite_difference_step(own[i].at(p), frames[0].scene.variance[i].at(p), around.at(p));
        let derivative = |i: usize| {
            like.like(|p| {
                let of = &expected[like.index(p)];
                if params.k_color.is_infinite() {
                    return of.centre_weight / of.weight_sum;
                }
                let mut stepped = own.clone();
                stepped[i].values[like.index(p)] += step(p, i);
                (average(&frames, &stepped, p, &params).mean[i] - of.mean[i]) / step(p, i)
            })
        };
        let derivative: Planes = (0..3).map(derivative).collect();
        let scale: Planes =
            (0..3).map(|i| like.like(|p| 1.0 + derivative[i].at(p).abs() + span[i].at(p) / step(p, i).abs())).collect();
        assert_near(&what("derivative"), &actual.derivatives[k][..3], &derivative, &scale, DERIVATIVE, 0.0);
    }
}

fn check(gpu: &Gpu, case: Case) {
    check_scene(gpu, case, &scene(case.width, case.height, 32));
    if case.width * case.height < 3000 {
        check_scene(gpu, case, &calm_scene(case.width, case.height, 35));
    }
}

const LITERAL: Case = Case {
    width: 257,
    height: 89,
    window_radius: 2,
    patch_radii: [0, 1],
    features: &[],
    symmetric: false,
    centre: CentreWeight::One,
};
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
    check(
        gpu(),
        Case { width: 31, height: 22, window_radius: 3, patch_radii: [0, 0], centre: CentreWeight::One, ..WIDE },
    );
}

#[test]
fn of_one_pixel_one_row_and_one_column() {
    for (width, height) in [(1, 1), (1, 9), (9, 1), (2, 2)] {
        check(gpu(), Case { width, height, features: &[3], ..WIDE });
        check(gpu(), Case { width, height, features: &[], symmetric: false, centre: CentreWeight::One, ..WIDE });
    }
}

#[test]
fn in_a_window_over_frames() {
    let case = Case { width: 23, height: 17, window_radius: 3, features: &[3, 1], ..WIDE };
    check_in_time(gpu(), case);
    check_in_time(gpu(), Case { features: &[], ..case });
    check_in_time(gpu(), Case { symmetric: false, centre: CentreWeight::One, ..case });
    check_in_time(checked_gpu(), Case { width: 9, height: 12, ..case });
    for (width, height) in [(1, 1), (1, 9), (9, 1)] {
        check_in_time(gpu(), Case { width, height, ..case });
    }
}

#[test]
fn from_checked_kernels() {
    check(checked_gpu(), Case { width: 19, height: 14, window_radius: 4, features: &[3, 1, 1], ..WIDE });
    check(checked_gpu(), Case { width: 19, height: 14, window_radius: 4, features: &[], symmetric: false, ..WIDE });
}

#[test]
fn every_schedule_gives_the_same_bits() {
    for case in [
        Case { window_radius: 4, height: 37, features: &[3, 1, 1], ..WIDE },
        Case { window_radius: 4, height: 37, symmetric: false, ..WIDE },
    ] {
        let scene = scene(case.width, case.height, 33);
        let features = features(case.width, case.height, case.features, 34);
        let result = |schedule| all_bits(gpu(), &filtered(gpu(), case, &scene, &features, schedule));
        let whole = result(Schedule { scratch_bytes: 64 << 20, block_rows: 16, ..Schedule::SOFTWARE });
        for schedule in schedules() {
            assert!(result(schedule) == whole, "{case:?} with {schedule:?}");
        }
        let frames: Vec<_> = (0..2).map(|seed| InTime::new(case, 50 + seed)).collect();
        let in_time = |schedule| all_bits(gpu(), &filtered_in_time(gpu(), case, &frames, schedule).together);
        let whole = in_time(Schedule { scratch_bytes: 64 << 20, block_rows: 16, ..Schedule::SOFTWARE });
        for schedule in schedules().filter(|schedule| schedule.scratch_bytes <= 30_000) {
            assert!(in_time(schedule) == whole, "{case:?} in time with {schedule:?}");
        }
    }
}

/// The finite difference with the step that the text prescribes against the derivative itself. A step of 1 % of the
/// value sees the curvature of F and may cross one of its kinks (a weight that reaches 1, a blend that begins); the
/// step backwards sees the other side of it. So the two may differ by twice the difference of the steps in both
/// directions, and by the rounding of f32. Half a percent of the values may have kinks on both sides within 1 %.
#[test]
fn finite_differences_approach_the_analytic_derivative() {
    let (width, height) = (24, 18);
    let scene = calm_scene(width, height, 35);
    let extent = extent_of(&scene.mean[0]);
    let around = brightness_around(&scene.mean);
    for symmetric in [false, true] {
        for centre in [CentreWeight::One, CentreWeight::LargestNeighbour] {
            let case =
                Case { width, height, window_radius: 3, patch_radii: [1, 3], features: &[3, 1], symmetric, centre };
            let features = features(width, height, case.features, 36);
            let actual = found(gpu(), &filtered(gpu(), case, &scene, &features, SCHEDULE), extent);
            for (actual, filter) in actual.derivatives.into_iter().zip(filters(case)) {
                let params = twin_params(case, &filter);
                let plane = |i: usize| {
                    scene.mean[i].like(|p| {
                        let step = finite_difference_step(scene.mean[i].at(p), scene.variance[i].at(p), around.at(p));
                        let difference =
                            |step| finite_difference(&scene.mean, &scene.variance, &features, &params, p, i, step);
                        2.0 * (difference(step) - difference(-step)).abs() + 1e-3
                    })
                };
                let scale: Planes = (0..3).map(plane).collect();
                let expected: Planes = (0..3)
                    .map(|i| {
                        scene.mean[i]
                            .like(|p| analytic_derivative(&scene.mean, &scene.variance, &features, &params, p, i))
                    })
                    .collect();
                assert_near(
                    &format!("{case:?}: {} against the analytic derivative", filter.name),
                    &actual[..3],
                    &expected,
                    &scale,
                    1.0,
                    0.005,
                );
                let mean = |planes: &[Grid]| planes.iter().map(Grid::mean).sum::<f64>() / 3.0;
                assert!(mean(&scale) < 0.05, "a tolerance of {} proves nothing", mean(&scale));
                assert!(mean(&expected) > 0.02, "a derivative of {} proves nothing", mean(&expected));
            }
        }
    }
}

/// The schedule whose kernels compile fastest.
const PART: Case = Case { width: 39, height: 21, window_radius: 3, patch_radii: [1, 2], features: &[3], ..WIDE };
const FEW_REGISTERS: Schedule = Schedule { pixels: 1, offset_rows: 1, ..SCHEDULE };

/// Leaving out some results does not change the others.
#[test]
fn parts_have_the_bits_of_the_whole() {
    // Every kernel is compiled, so there are few.
    let parts = [
        ([false, true, true], true),
        ([true, true, false], true),
        ([true, false, false], false),
        ([false, false, true], false),
        ([false, true, false], true),
    ];
    let scene = scene(PART.width, PART.height, 37);
    let features = features(PART.width, PART.height, PART.features, 38);
    let extent = extent_of(&scene.mean[0]);
    let whole = found(gpu(), &filtered(gpu(), PART, &scene, &features, FEW_REGISTERS), extent);
    for (takes_part, derivatives) in parts {
        let needed = Needed { derivatives, ..Needed::EVERYTHING };
        let filters = some_filters(PART, takes_part);
        let part = filtered_as_needed(gpu(), PART, &filters, &scene, &features, needed, FEW_REGISTERS);
        assert_eq!((&part.filters, part.derivatives.is_some()), (&filters, derivatives));
        let part = found(gpu(), &part, extent);
        for (place, k) in (0..3).filter(|k| takes_part[*k]).enumerate() {
            let what = format!("candidate {k} of {takes_part:?}, derivatives {derivatives}");
            let same = |a: &Planes, b: &Planes| a.iter().zip(b).all(|(a, b)| a.values == b.values);
            assert!(same(&part.means[place], &whole.means[k]), "{what}: mean");
            assert!(same(&part.spreads[place], &whole.spreads[k]), "{what}: half spread");
            assert!(!derivatives || same(&part.derivatives[place], &whole.derivatives[k]), "{what}: derivative");
        }
    }
}

/// Filters that share no pass: other scales, other features or none, a plain mean, more patches than two.
#[test]
fn any_number_of_filters_in_any_order() {
    let case = PART;
    let own = filters(case);
    let color = |k, patch_radius| Some(ByColor { k, patch_radius });
    let further = [
        CandidateFilter { name: "wide", color: color(1.0, 2), features: own[0].features, rival: None },
        CandidateFilter { name: "color only", color: color(0.45, 1), features: None, rival: None },
        CandidateFilter { name: "mean", color: None, features: None, rival: None },
        CandidateFilter { name: "soft", color: None, features: Some(ByFeatures { k: 1.5, tau: 0.1 }), rival: None },
        CandidateFilter { name: "point", color: color(0.45, 0), features: own[0].features, rival: None },
    ];
    let scene = calm_scene(case.width, case.height, 45);
    check_filters(gpu(), case, &[&further[..2], &own, &further[2..]].concat(), &scene);
    check_filters(gpu(), Case { symmetric: false, centre: CentreWeight::One, ..case }, &further, &scene);
}

/// Weights from another image than the averaged one: the derivative is the centre's share.
#[test]
fn a_payload_is_filtered_with_the_weights_of_another_image() {
    for case in [PART, Case { width: 1, height: 9, symmetric: false, features: &[], ..PART }] {
        let (of_payload, of_guide) = (scene(case.width, case.height, 46), calm_scene(case.width, case.height, 47));
        let features = features(case.width, case.height, case.features, 48);
        let (filters, extent) = (filters(case), extent_of(&of_guide.mean[0]));
        let together = run(gpu(), |rec| {
            let payload = &rec.upload("payload", &packed_signal(&of_payload.mean, &of_payload.spread))?;
            let guide = upload(rec, &of_guide.mean)?;
            let variance_of_mean = &upload_variance(rec, &of_guide)?;
            let features = if features.is_empty() { None } else { Some(pack(rec, &features)?) };
            let frame = CandidateFrame {
                payload,
                guide: Some(&guide),
                variance_of_mean,
                features: features.as_ref(),
                layers: &[],
            };
            let (frames, needed) = (Frames::one(frame), Needed::EVERYTHING);
            let window = window_of(case);
            candidates(rec, extent, &frames, &filters, window, needed, FEW_REGISTERS, |_, _| Ok(()))
        })
        .together;
        let actual = found(gpu(), &together, extent);
        let guide = Guide { mean: &of_guide.mean, variance: &of_guide.variance };
        let payload = [of_payload.mean.as_slice(), &of_payload.spread].concat();
        for (k, filter) in filters.iter().enumerate() {
            let params = twin_params(case, filter);
            let what = |part: &str| format!("{case:?} by another image: {} {part}", filter.name);
            let expected = filtered_twin(&payload, Some(guide), &features, &params);
            let (mean, spread) = expected.planes.split_at(3);
            let (mean_span, spread_span) = expected.span.split_at(3);
            assert_near(&what("mean"), &actual.means[k][..3], mean, mean_span, FILTERED, 0.0);
            assert_near(&what("half spread"), &actual.spreads[k][..3], spread, spread_span, FILTERED, 0.0);
            let share = expected.weight_sum.like(|p| {
                let weights = window_weights(&of_guide.mean[0], p, Some(guide), &features, &params);
                weights.centre.1 / weights.sum()
            });
            let expected = vec![share; 3];
            let derivatives = &actual.derivatives[k][..3];
            assert_near(&what("derivative"), derivatives, &expected, &own_size(&expected, 0.0), FILTERED, 0.0);
        }
    }
}

#[test]
fn a_grey_image_needs_one_channel() {
    let case = PART;
    let grey = |planes: &Planes| vec![planes[0].clone(); 3];
    let Scene { mean, spread, variance } = scene(case.width, case.height, 39);
    let scene = Scene { mean: grey(&mean), spread: grey(&spread), variance: grey(&variance) };
    let features = features(case.width, case.height, case.features, 38);
    let all = |needed| {
        let found = filtered_as_needed(gpu(), case, &filters(case), &scene, &features, needed, FEW_REGISTERS);
        all_bits(gpu(), &found)
    };
    assert!(all(Needed::EVERYTHING) == all(Needed { channels: false, ..Needed::EVERYTHING }));
}

/// The requested results have the same bits as when all results are requested.
#[test]
fn some_pixels_have_the_bits_of_all() {
    let case = PART;
    let scene = scene(case.width, case.height, 43);
    let features = features(case.width, case.height, case.features, 44);
    let tiles = exact::tiles(case.width, case.height);
    let (width, pixels) = (case.width as i32, case.width * case.height);
    for exact in [None, Some(&tiles.exact)] {
        let of = |wanted: Option<Region>| {
            let needed = Needed { exact, wanted, ..Needed::EVERYTHING };
            let found = filtered_as_needed(gpu(), case, &filters(case), &scene, &features, needed, FEW_REGISTERS);
            all_bits(gpu(), &found)
        };
        let all = of(None);
        for region in exact::parts(width, case.height as i32) {
            let some = of(Some(region));
            for pixel in exact::pixels_of(region, width) {
                // w has no meaning in the half spread and the derivatives.
                let of = |bits: &[u32]| {
                    bits.chunks_exact(4 * pixels).map(|plane| plane[4 * pixel..][..3].to_vec()).collect::<Vec<_>>()
                };
                assert_eq!(of(&some), of(&all), "{region:?}, pixel {pixel}");
            }
        }
    }
}

#[test]
fn a_half_spread_that_says_nothing_is_not_filtered() {
    let case = PART;
    let of = scene(case.width, case.height, 40);
    let scene = Scene { spread: of.spread.iter().map(|grid| grid.like(|_| 0.0)).collect(), ..of };
    let features = features(case.width, case.height, case.features, 38);
    let all = |needed| {
        let found = filtered_as_needed(gpu(), case, &filters(case), &scene, &features, needed, FEW_REGISTERS);
        all_bits(gpu(), &found)
    };
    assert!(all(Needed::EVERYTHING) == all(Needed { half_spread: false, ..Needed::EVERYTHING }));
}

/// Exact tiles change no other pixel, however the work is cut. In exact tiles every candidate equals the signal.
#[test]
fn exact_tiles_keep_the_signal() {
    let case = Case { window_radius: 3, width: 71, height: 43, features: &[3], ..WIDE };
    let scene = scene(case.width, case.height, 41);
    let features = features(case.width, case.height, case.features, 42);
    let tiles = exact::tiles(case.width, case.height);
    let extent = extent_of(&scene.mean[0]);
    let whole = found(gpu(), &filtered(gpu(), case, &scene, &features, SCHEDULE), extent);
    for schedule in schedules().filter(|schedule| schedule.scratch_bytes >= 30_000) {
        let needed = Needed { exact: Some(&tiles.exact), ..Needed::EVERYTHING };
        let part = filtered_as_needed(gpu(), case, &filters(case), &scene, &features, needed, schedule);
        let part = found(gpu(), &part, extent);
        let one = scene.mean[0].like(|_| 1.0);
        let mean = [scene.mean.as_slice(), std::slice::from_ref(&one)].concat();
        let ones = vec![one; 3];
        for k in 0..3 {
            for (what, kept, part, whole) in [
                ("mean", &mean, &part.means[k], &whole.means[k]),
                ("half spread", &scene.spread, &part.spreads[k], &whole.spreads[k]),
                ("derivatives", &ones, &part.derivatives[k], &whole.derivatives[k]),
            ] {
                let expected = tiles.keep(kept, whole);
                assert!(part[..expected.len()] == expected[..], "{schedule:?}: candidate {k}, {what}");
            }
        }
    }
    let third = some_filters(case, [false, false, true]);
    let needed = Needed { exact: Some(&tiles.all), ..Needed::EVERYTHING };
    let none = found(gpu(), &filtered_as_needed(gpu(), case, &third, &scene, &features, needed, SCHEDULE), extent);
    assert!(none.means[0][..3] == scene.mean[..], "nothing is filtered where all is exact");
}
