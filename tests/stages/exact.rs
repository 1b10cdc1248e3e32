//! `exact_copy` and `exact_fill`, through the filters that leave tiles out.

use glam::IVec2;
use stein::stage::exact::{ExactTiles, Region};
use stein::stage::nlm::{CentreWeight, Guide, Payload, Schedule, Symmetry, Weighting, nlm_filter};

use crate::common::{checked_gpu, extent_of, gpu, packed_signal, read, run, scene, schedules, upload};
use crate::reference::{Grid, Planes};

/// Pixels.
const SIDE: usize = 8;

/// Some exact tiles of an image, alone and in blocks; the test also reads them by hand.
pub(crate) struct Tiles {
    pub(crate) exact: ExactTiles,
    pub(crate) all: ExactTiles,
    flags: Vec<bool>,
    columns: usize,
}

pub(crate) fn tiles(width: usize, height: usize) -> Tiles {
    let (columns, rows) = (width.div_ceil(SIDE), height.div_ceil(SIDE));
    let flags: Vec<bool> =
        (0..columns * rows).map(|tile| (tile % columns / 2 * 5 + tile / columns * 3) % 7 < 3).collect();
    Tiles {
        exact: ExactTiles::new(flags.clone(), columns, SIDE),
        all: ExactTiles::new(vec![true; columns * rows], columns, SIDE),
        flags,
        columns,
    }
}

impl Tiles {
    /// `before` in exact tiles, `after` elsewhere.
    pub(crate) fn keep(&self, before: &[Grid], after: &[Grid]) -> Planes {
        let is_exact = |x: isize, y: isize| self.flags[y as usize / SIDE * self.columns + x as usize / SIDE];
        before
            .iter()
            .zip(after)
            .map(|(before, after)| after.like(|p| if is_exact(p.x, p.y) { before.at(p) } else { after.at(p) }))
            .collect()
    }
}

#[test]
fn exact_tiles_keep_the_payload_and_nothing_else_changes() {
    for (gpu, width, height) in [(gpu(), 257, 89), (gpu(), 7, 300), (gpu(), 1, 1), (checked_gpu(), 40, 33)] {
        let scene = scene(width, height, 81);
        let extent = extent_of(&scene.mean[0]);
        let tiles = tiles(width, height);
        let filtered = |exact: Option<&ExactTiles>, schedule: Schedule| {
            let filtered = run(gpu, |rec| {
                let signal = rec.upload("signal", &packed_signal(&scene.mean, &scene.spread))?;
                let variance = upload(rec, &scene.variance)?;
                let weighting = Weighting { symmetric: Symmetry::Blended, centre: CentreWeight::LargestNeighbour };
                let guide = Guide { exact, ..Guide::new(&signal, &variance, 3, 0.45, 1) };
                nlm_filter(rec, extent, &guide, &Payload::new(&signal, 2), 2, weighting, true, schedule)
            });
            let residual = filtered.residual_variance.unwrap_or_else(|| panic!("it was asked for"));
            [
                read(gpu, &filtered.planes, extent).concat(),
                read(gpu, &filtered.weights, extent).concat(),
                read(gpu, &residual, extent).concat(),
            ]
        };
        let [planes, weights, residual] = filtered(None, Schedule::SOFTWARE);
        let zero = scene.mean[0].like(|_| 0.0);
        let one = scene.mean[0].like(|_| 1.0);
        let payload =
            [&scene.mean[..], std::slice::from_ref(&zero), &scene.spread, std::slice::from_ref(&zero)].concat();
        for schedule in schedules().filter(|schedule| schedule.scratch_bytes >= 1 << 18) {
            let part = filtered(Some(&tiles.exact), schedule);
            let what = format!("{width}×{height}, {schedule:?}");
            assert!(part[0] == tiles.keep(&payload, &planes), "{what}: planes");
            assert!(part[1][..1] == tiles.keep(std::slice::from_ref(&one), &weights)[..], "{what}: Σ w");
            assert!(part[2][..3] == tiles.keep(&vec![zero.clone(); 3], &residual)[..], "{what}: residual variance");
        }
        let [planes, weights, _] = filtered(Some(&tiles.all), Schedule::SOFTWARE);
        assert!(planes == payload && weights[0] == one, "{width}×{height}: all is exact");
    }
}

/// Rectangles at the borders, across tiles, and of one pixel.
pub(crate) fn parts(width: i32, height: i32) -> [Region; 4] {
    let region = |x: i32, y: i32, right: i32, bottom: i32| Region {
        first: IVec2::new(x, y),
        size: IVec2::new(right - x, bottom - y),
    };
    let (middle, last) = (IVec2::new(width / 2, height / 2), IVec2::new(width - 1, height - 1));
    [
        region(0, 0, width, height),
        region(0, middle.y, middle.x + 1, height),
        region(middle.x, middle.y / 2, width, middle.y + 1),
        region(last.x, last.y, width, height),
    ]
}

/// Indices of the pixels of a rectangle, row by row.
pub(crate) fn pixels_of(region: Region, width: i32) -> Vec<usize> {
    let Region { first, size } = region;
    (first.y..first.y + size.y)
        .flat_map(|y| (first.x..first.x + size.x).map(move |x| (y * width + x) as usize))
        .collect()
}

/// The requested results have the same bits as when all results are requested.
#[test]
fn some_pixels_have_the_bits_of_all() {
    for (gpu, width, height) in [(gpu(), 257, 89), (gpu(), 7, 300), (gpu(), 1, 1), (checked_gpu(), 40, 33)] {
        let scene = scene(width, height, 83);
        let extent = extent_of(&scene.mean[0]);
        let tiles = tiles(width, height);
        let filtered = |exact: Option<&ExactTiles>, wanted: Option<Region>, schedule: Schedule| {
            let filtered = run(gpu, |rec| {
                let signal = rec.upload("signal", &packed_signal(&scene.mean, &scene.spread))?;
                let variance = upload(rec, &scene.variance)?;
                let weighting = Weighting { symmetric: Symmetry::Blended, centre: CentreWeight::LargestNeighbour };
                let guide = Guide { exact, wanted, ..Guide::new(&signal, &variance, 3, 0.45, 1) };
                nlm_filter(rec, extent, &guide, &Payload::new(&signal, 2), 2, weighting, true, schedule)
            });
            let residual = filtered.residual_variance.unwrap_or_else(|| panic!("it was asked for"));
            [
                read(gpu, &filtered.planes, extent).concat(),
                read(gpu, &filtered.weights, extent).concat(),
                read(gpu, &residual, extent).concat(),
            ]
            .concat()
        };
        for exact in [None, Some(&tiles.exact)] {
            let all = filtered(exact, None, Schedule::SOFTWARE);
            for region in parts(extent.x, extent.y) {
                for schedule in [
                    Schedule::SOFTWARE,
                    Schedule { pixels: 1, offset_rows: 1, scratch_bytes: 1 << 18, ..Schedule::SOFTWARE },
                ] {
                    let some = filtered(exact, Some(region), schedule);
                    let pixels = pixels_of(region, extent.x);
                    for (lane, (some, all)) in some.iter().zip(&all).enumerate() {
                        let of =
                            |grid: &Grid| pixels.iter().map(|pixel| grid.values[*pixel].to_bits()).collect::<Vec<_>>();
                        assert!(of(some) == of(all), "{width}×{height}, {region:?}, {schedule:?}: lane {lane}");
                    }
                }
            }
        }
    }
}

/// A part of a frame reads its own tiles, even if it cuts through them.
#[test]
fn a_part_keeps_what_its_frame_keeps() {
    let (width, height) = (40, 61);
    let scene = scene(width, height, 82);
    let tiles = tiles(width, height);
    let filtered = |mean: &[Grid], spread: &[Grid], exact: &ExactTiles| {
        run(gpu(), |rec| {
            let signal = rec.upload("signal", &packed_signal(mean, spread))?;
            // Enough noise that all neighbours count.
            let variance = upload(rec, &vec![mean[0].like(|_| 1e9); 3])?;
            let weighting = Weighting { symmetric: Symmetry::Off, centre: CentreWeight::One };
            let guide = Guide { exact: Some(exact), ..Guide::new(&signal, &variance, 3, 0.45, 0) };
            nlm_filter(
                rec,
                extent_of(&mean[0]),
                &guide,
                &Payload::new(&signal, 2),
                1,
                weighting,
                false,
                Schedule::SOFTWARE,
            )
        })
    };
    let whole =
        read(gpu(), &filtered(&scene.mean, &scene.spread, &tiles.exact).planes, extent_of(&scene.mean[0])).concat();
    for (left, first) in [(0usize, 0usize), (0, 5), (0, 8), (0, 23), (8, 0), (11, 5)] {
        let part_of = |planes: &[Grid]| -> Planes {
            let rows = |grid: &Grid| {
                grid.values.chunks_exact(width).skip(first).flat_map(|row| row[left..].to_vec()).collect()
            };
            planes.iter().map(|grid| Grid { width: width - left, height: height - first, values: rows(grid) }).collect()
        };
        let part = filtered(
            &part_of(&scene.mean),
            &part_of(&scene.spread),
            &tiles.exact.starting_at(IVec2::new(left as i32, first as i32)),
        );
        let part = read(gpu(), &part.planes, extent_of(&part_of(&scene.mean)[0])).concat();
        for (part, whole) in part.iter().zip(part_of(&whole)) {
            // The first row has lost its neighbours above, the first column those on its left.
            let kept = |grid: &Grid| -> Vec<f64> {
                let rows = grid.values.chunks_exact(grid.width).skip(usize::from(first > 0));
                rows.flat_map(|row| row[usize::from(left > 0)..].to_vec()).collect()
            };
            assert!(kept(part) == kept(&whole), "from column {left}, row {first}");
        }
    }
}
