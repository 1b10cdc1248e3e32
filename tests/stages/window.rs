//! `nlm_window` and `candidate_window`: the weights of one pixel's neighbours, and the distances behind them.

use glam::IVec2;
use stein::gpu::Gpu;
use stein::stage::candidate::CandidateFrame;
use stein::stage::nlm::{CentreWeight, Guide, Schedule, Symmetry, Weighting};
use stein::stage::window::{CellLane, NLM_DISTANCE, NLM_WEIGHT, candidate_window, nlm_window};

use crate::candidate::{Case, some_filters, twin_params, window_of};
use crate::common::{
    Scene, assert_near, calm_scene, checked_gpu, extent_of, gpu, packed_signal, run, scene, schedules, upload,
};
use crate::feature::{features, pack};
use crate::nlm::twin_of;
use crate::reference::nlm;
use crate::reference::nlm_method::{self, Filter};
use crate::reference::window::{self, Neighbour};
use crate::reference::{Grid, Point};

/// A distance is a mean of terms; those below 0 are at least −2/k². f32 sums them to some millionths of their size.
const DISTANCE: f64 = 2e-5;
/// The relative error of exp(−d) is the absolute error of d.
const WEIGHT: f64 = 1e-4;
/// Larger distances mean total dissimilarity, and are limited to this.
const FAR: f64 = 1e5;

const SCHEDULE: Schedule = Schedule::SOFTWARE;

/// Corners, edges and inner pixels.
fn places(width: usize, height: usize) -> Vec<Point> {
    let (right, bottom) = (width as isize - 1, height as isize - 1);
    let all = [
        (0, 0),
        (right, bottom),
        (right, 0),
        (right / 2, 0),
        (0, bottom / 2),
        (right / 2, bottom / 2),
        (right / 3, bottom / 4),
        (2 * right / 3, bottom - bottom / 5),
    ];
    all.map(|(x, y)| Point { x, y }).to_vec()
}

fn pixel(p: Point) -> IVec2 {
    IVec2::new(p.x as i32, p.y as i32)
}

/// The cells of a window; neighbours that exist fill theirs.
struct Cells {
    values: Vec<f32>,
    radius: isize,
    p: Point,
}

impl Cells {
    fn at(&self, lane: CellLane, q: Point) -> f64 {
        let side = 2 * self.radius + 1;
        let cell = (q.y - self.p.y + self.radius) * side + q.x - self.p.x + self.radius;
        f64::from(
            self.values[(lane.plane as usize * (side * side) as usize + cell as usize) * 4 + lane.component as usize],
        )
    }

    /// A value of each neighbour, as an image of one row.
    fn lane(&self, lane: CellLane, neighbours: &[Neighbour]) -> Grid {
        row(neighbours.iter().map(|neighbour| self.at(lane, neighbour.at)).collect())
    }

    /// Cells outside of the image weigh nothing.
    fn check_outside(&self, what: &str, weights: &[CellLane], extent: IVec2) {
        let around = -self.radius..=self.radius;
        for (dx, dy) in around.clone().flat_map(|dy| around.clone().map(move |dx| (dx, dy))) {
            let q = Point { x: self.p.x + dx, y: self.p.y + dy };
            let is_inside = q.x >= 0 && q.y >= 0 && q.x < extent.x as isize && q.y < extent.y as isize;
            assert!(is_inside || weights.iter().all(|lane| self.at(*lane, q) == 0.0), "{what}: {q:?} does not exist");
        }
    }
}

fn row(values: Vec<f64>) -> Grid {
    Grid { width: values.len(), height: 1, values }
}

fn check_weights(what: &str, actual: &Grid, expected: Vec<f64>, distances: &[f64], allowed: f64) {
    let expected = row(expected);
    let scale = row(expected
        .values
        .iter()
        .zip(distances)
        .map(|(weight, distance)| weight * (1.0 + distance.abs().min(30.0)) + 1e-9)
        .collect());
    assert_near(what, std::slice::from_ref(actual), &[expected], &[scale], WEIGHT, allowed);
}

fn check_distances(what: &str, actual: &Grid, expected: Vec<f64>) {
    let limited = |values: &[f64]| row(values.iter().map(|value| value.min(FAR)).collect());
    let expected = limited(&expected);
    let scale = row(expected.values.iter().map(|distance| 10.0 + distance.abs()).collect());
    assert_near(what, &[limited(&actual.values)], &[expected], &[scale], DISTANCE, 0.0);
}

const BEST: Case = Case {
    width: 257,
    height: 89,
    window_radius: 4,
    patch_radii: [1, 3],
    features: &[3, 1, 3, 1],
    symmetric: true,
    centre: CentreWeight::One,
};

fn check(gpu: &Gpu, case: Case, takes_part: [bool; 3], scene: &Scene, grey: bool) {
    let extent = extent_of(&scene.mean[0]);
    let features = features(case.width, case.height, case.features, 61);
    let filters = some_filters(case, takes_part);
    for p in places(case.width, case.height) {
        let (windows, slots) = run(gpu, |rec| {
            let payload = &rec.upload("signal", &packed_signal(&scene.mean, &scene.spread))?;
            let variance_of_mean = &upload(rec, &scene.variance)?;
            let packed = if features.is_empty() { None } else { Some(pack(rec, &features)?) };
            let slots = packed.as_ref().map_or_else(Vec::new, |packed| packed.packing.slots.clone());
            let frame =
                CandidateFrame { payload, guide: None, variance_of_mean, features: packed.as_ref(), layers: &[] };
            let (pixel, window) = (pixel(p), window_of(case));
            let windows = candidate_window(rec, extent, pixel, &frame, &filters, window, grey, SCHEDULE)?;
            Ok((windows, slots))
        });
        let guide = nlm::Guide { mean: &scene.mean, variance: &scene.variance };
        for (filter, of) in filters.iter().zip(&windows) {
            let params = twin_params(case, filter);
            let cells = Cells {
                values: gpu.read(&of.cells).unwrap_or_else(|error| panic!("{error}")),
                radius: case.window_radius as isize,
                p,
            };
            let what = |part: &str| format!("{case:?}, {takes_part:?} at {p:?}: {} {part}", filter.name);
            let expected = window::candidate_window(guide, &features, &params, p);
            assert_eq!(of.color().is_some(), filter.color.is_some());
            let lanes: Vec<_> = of.color().into_iter().chain(slots.iter().map(|slot| of.feature(*slot))).collect();
            let farthest: Vec<f64> = expected
                .iter()
                .map(|neighbour| neighbour.distances.iter().map(|d| d.distance).fold(0.0, f64::max))
                .collect();
            let weight = of.weight();
            check_weights(
                &what("weight"),
                &cells.lane(weight, &expected),
                expected.iter().map(|neighbour| neighbour.weight).collect(),
                &farthest,
                0.0,
            );
            for (index, lanes) in lanes.iter().enumerate() {
                let of = |value: fn(&window::Distance) -> f64| {
                    expected.iter().map(|neighbour| value(&neighbour.distances[index])).collect::<Vec<_>>()
                };
                let distances = of(|distance| distance.distance);
                check_weights(
                    &what("weight alone"),
                    &cells.lane(lanes.weight, &expected),
                    of(|distance| distance.weight),
                    &distances,
                    0.0,
                );
                check_distances(&what("distance"), &cells.lane(lanes.distance, &expected), distances);
            }
            let weights: Vec<_> = lanes.iter().map(|lanes| lanes.weight).chain([weight]).collect();
            cells.check_outside(&what("weight"), &weights, extent);
        }
    }
}

#[test]
fn of_the_candidates() {
    for case in [BEST, Case { features: &[], ..BEST }, Case { symmetric: false, features: &[2, 1], ..BEST }] {
        check(gpu(), case, [true; 3], &scene(case.width, case.height, 62), false);
    }
    let tall = Case { width: 7, height: 300, window_radius: 10, features: &[1], ..BEST };
    check(gpu(), tall, [true; 3], &calm_scene(7, 300, 63), false);
    for (width, height) in [(1, 1), (1, 9), (9, 1)] {
        check(gpu(), Case { width, height, ..tall }, [true; 3], &calm_scene(width, height, 64), false);
    }
    check(checked_gpu(), Case { width: 19, height: 14, ..BEST }, [true; 3], &scene(19, 14, 65), false);
}

#[test]
fn of_candidates_of_which_some_take_no_part() {
    let (width, height) = (40, 33);
    for takes_part in [[true, false, false], [false, true, false], [false, false, true], [false, true, true]] {
        let case = Case { width, height, features: &[3], ..BEST };
        check(gpu(), case, takes_part, &calm_scene(width, height, 66), false);
    }
    // One channel stands for all.
    let scene = calm_scene(width, height, 67);
    let grey = |planes: &[Grid]| vec![planes[0].clone(); 3];
    let scene = Scene { mean: grey(&scene.mean), spread: grey(&scene.spread), variance: grey(&scene.variance) };
    check(gpu(), Case { width, height, features: &[3], ..BEST }, [true; 3], &scene, true);
}

#[derive(Clone, Copy, Debug)]
struct Chapter7 {
    width: usize,
    height: usize,
    window_radius: u32,
    patch_radius: u32,
    symmetric: Symmetry,
    patchwise: bool,
    cut: f32,
}

const THESIS: Chapter7 = Chapter7 {
    width: 24,
    height: 20,
    window_radius: 10,
    patch_radius: 3,
    symmetric: Symmetry::Hard,
    patchwise: true,
    cut: 0.05,
};

/// Share of values in which rounding may change a decision: whether a pair is replaced, whether a weight is cut.
const FLIPPED: f64 = 0.01;

fn cells_of(gpu: &Gpu, case: Chapter7, scene: &Scene, p: Point, schedule: Schedule) -> Cells {
    let cells = run(gpu, |rec| {
        let (signal, variance) = (upload(rec, &scene.mean)?, upload(rec, &scene.variance)?);
        let guide = Guide {
            alpha: 0.5,
            patchwise: case.patchwise,
            cut: case.cut,
            ..Guide::new(&signal, &variance, 3, 0.45, case.patch_radius)
        };
        let weighting = Weighting { symmetric: case.symmetric, centre: CentreWeight::One };
        nlm_window(rec, extent_of(&scene.mean[0]), pixel(p), &guide, case.window_radius, weighting, schedule)
    });
    Cells { values: gpu.read(&cells).unwrap_or_else(|error| panic!("{error}")), radius: case.window_radius as isize, p }
}

fn check_chapter7(gpu: &Gpu, case: Chapter7) {
    let scene = calm_scene(case.width, case.height, 68);
    let filter = Filter {
        window_radius: case.window_radius as usize,
        patch_radius: case.patch_radius as usize,
        k: 0.45f32.into(),
        alpha: 0.5,
        symmetric: match case.symmetric {
            Symmetry::Off => nlm_method::Symmetry::Off,
            Symmetry::Blended => nlm_method::Symmetry::Blended,
            Symmetry::Hard => nlm_method::Symmetry::Hard,
        },
        patchwise: case.patchwise,
        cut: case.cut.into(),
        centre: twin_of(CentreWeight::One),
    };
    for p in places(case.width, case.height) {
        let what = |part: &str| format!("{case:?} at {p:?}: {part}");
        let cells = cells_of(gpu, case, &scene, p, SCHEDULE);
        let expected = window::nlm_window(nlm::Guide { mean: &scene.mean, variance: &scene.variance }, &filter, p);
        let of = |value: fn(&Neighbour) -> f64| expected.iter().map(value).collect::<Vec<_>>();
        let distances = of(|neighbour| neighbour.distances[0].distance);
        check_weights(
            &what("weight"),
            &cells.lane(NLM_WEIGHT, &expected),
            of(|neighbour| neighbour.weight),
            &distances,
            FLIPPED,
        );
        let alone = of(|neighbour| neighbour.distances[0].weight);
        check_weights(&what("weight alone"), &cells.lane(NLM_DISTANCE.weight, &expected), alone, &distances, FLIPPED);
        check_distances(&what("distance"), &cells.lane(NLM_DISTANCE.distance, &expected), distances);
        cells.check_outside(&what("weight"), &[NLM_WEIGHT, NLM_DISTANCE.weight], extent_of(&scene.mean[0]));
    }
}

#[test]
fn of_nlm() {
    check_chapter7(gpu(), THESIS);
    check_chapter7(gpu(), Chapter7 { symmetric: Symmetry::Blended, patchwise: false, cut: 0.0, ..THESIS });
    check_chapter7(gpu(), Chapter7 { symmetric: Symmetry::Off, patch_radius: 0, ..THESIS });
    let small = Chapter7 { window_radius: 2, patch_radius: 1, ..THESIS };
    check_chapter7(gpu(), Chapter7 { width: 257, height: 89, ..small });
    check_chapter7(gpu(), Chapter7 { width: 7, height: 300, ..small });
    for (width, height) in [(1, 1), (1, 9), (9, 1)] {
        check_chapter7(gpu(), Chapter7 { width, height, ..THESIS });
    }
    check_chapter7(checked_gpu(), Chapter7 { width: 19, height: 14, ..small });
}

/// The middle of the window belongs to no neighbour.
#[test]
fn every_schedule_gives_the_same_bits() {
    let scene = calm_scene(THESIS.width, THESIS.height, 69);
    let p = Point { x: 2, y: 11 };
    let of = |schedule| {
        let mut values = cells_of(gpu(), THESIS, &scene, p, schedule).values;
        let middle = values.len() / 8 * 4;
        values.drain(middle..middle + 4);
        values.into_iter().map(f32::to_bits).collect::<Vec<_>>()
    };
    let expected = of(SCHEDULE);
    assert!(schedules().all(|schedule| of(schedule) == expected));
}
