//! The weights in one pixel's window, each with the distances that it comes from: the view of the filters from one
//! pixel.
//!
//! A window of radius R is laid out as an image of (2R+1)² cells: the cell of the neighbour p + (dx, dy) lies in column
//! R + dx of row R + dy. The cell in the middle is not written: the weight of a pixel itself follows from its
//! neighbours.

use glam::IVec2;

use super::candidate::{CandidateFilter, CandidateParams};
use super::candidate_set::CandidateSet;
use super::feature::{Features, Slot};
use super::nlm::{Guide, NlmParams, Schedule, Weighting, for_each_chunk_around};
use super::plane_bytes;
use crate::error::Result;
use crate::gpu::{Buffer, Definition, Recorder, bindings, uniforms};

uniforms! { struct WindowParams { pixel: IVec2, radius: i32 } }

bindings! {
    struct NlmWindow<'a> {
        uniform params: NlmParams, uniform window: WindowParams, around columns, optional_around weight_columns,
        write cells,
    }
    struct CandidateWindow<'a> {
        uniform params: NlmParams, uniform candidate: CandidateParams, uniform window: WindowParams,
        optional_around columns, optional_around features, write cells,
    }
}

/// Position of a value in the planes of a window, which have one vec4 per cell: a plane, and a component of its vec4.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CellLane {
    /// Plane, counted from 0.
    pub plane: u32,
    /// Component, 0 to 3 for x to w.
    pub component: u32,
}

/// A distance, and the weight that it would give alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DistanceLanes {
    /// Position of the distance, which is arbitrary where a neighbour does not exist.
    pub distance: CellLane,
    /// Position of the weight, which is 0 where a neighbour does not exist.
    pub weight: CellLane,
}

impl DistanceLanes {
    fn new(plane: u32, distance: u32, weight: u32) -> Self {
        let lane = |component| CellLane { plane, component };
        Self { distance: lane(distance), weight: lane(weight) }
    }
}

fn cells(rec: &mut Recorder, window_radius: u32, planes: u32) -> Result<Buffer> {
    let side = 2 * window_radius as i32 + 1;
    rec.take("window", plane_bytes(IVec2::new(side, side), planes))
}

/// Returns the weights that [`nlm_filter`](super::nlm::nlm_filter) gives the neighbours of a pixel in its own frame,
/// and their distances: one plane of cells, laid out as [`NLM_WEIGHT`] and [`NLM_DISTANCE`] say.
///
/// # Errors
/// As [`Recorder::take`] and [`Recorder::dispatch`].
pub fn nlm_window(
    rec: &mut Recorder,
    extent: IVec2,
    pixel: IVec2,
    guide: &Guide,
    window_radius: u32,
    weighting: Weighting,
    schedule: Schedule,
) -> Result<Buffer> {
    let cells = cells(rec, window_radius, 1)?;
    let window = WindowParams { pixel, radius: window_radius as i32 };
    let [symmetric, hard] = weighting.symmetric.definitions();
    let definitions = [
        ("PATCH_RADIUS", Definition::Int(guide.patch_radius as i32)),
        ("PATCHWISE", guide.patchwise.into()),
        symmetric,
        hard,
    ];
    for_each_chunk_around(rec, extent, pixel, guide, true, window_radius, weighting, schedule, |rec, chunk| {
        let weight_columns = guide.patchwise.then(|| chunk.columns.within_columns_and_rows(guide.patch_radius, 0));
        let columns = chunk.distances.within_columns_and_rows(guide.patch_radius, 0);
        let bound = NlmWindow { params: chunk.params, window, columns, weight_columns, cells: &cells };
        rec.dispatch(
            "nlm_window",
            &definitions,
            &bound,
            [chunk.params.offsets.x as u32, chunk.params.offsets.y as u32, 1],
        )
    })?;
    Ok(cells)
}

/// Position of the weights that [`nlm_window`] writes, as they enter the average; 0 where a neighbour does not exist.
pub const NLM_WEIGHT: CellLane = CellLane { plane: 0, component: 0 };

/// Position of the distances between patches that [`nlm_window`] writes.
pub const NLM_DISTANCE: DistanceLanes =
    DistanceLanes { distance: CellLane { plane: 0, component: 1 }, weight: CellLane { plane: 0, component: 2 } };

/// The weights that [`candidates`](super::candidate::candidates) gives the neighbours of a pixel in its own frame.
#[derive(Debug)]
pub struct WindowOfCandidates {
    /// Cells of the window: two planes, and two more for each group of features.
    pub cells: Buffer,
}

impl WindowOfCandidates {
    /// Returns the position of the weights of FIRST, SECOND or THIRD, counted from 0, as they enter the average; 0
    /// where a neighbour does not exist.
    pub fn weight(candidate: u32) -> CellLane {
        CellLane { plane: 0, component: candidate }
    }

    /// Returns the position of the distances that FIRST or SECOND, counted from 0, find between patches of the colour.
    pub fn color(candidate: u32) -> DistanceLanes {
        DistanceLanes::new(1, candidate, 2 + candidate)
    }

    /// Returns the position of the distances that a candidate finds between the values of a feature.
    pub fn feature(candidate: u32, slot: Slot) -> DistanceLanes {
        let single = u32::from(slot.single);
        DistanceLanes::new(2 + 2 * slot.group + u32::from(candidate == 2), single, 2 + single)
    }
}

/// Returns the weights of the candidates that take part at a pixel, and their distances. `grey`: all channels of the
/// colour are equal.
///
/// # Errors
/// As [`Recorder::take`] and [`Recorder::dispatch`].
#[expect(clippy::too_many_arguments, reason = "they are the operator's definition; a struct would only rename them")]
pub fn candidate_window(
    rec: &mut Recorder,
    extent: IVec2,
    pixel: IVec2,
    signal: &Buffer,
    variance_of_mean: &Buffer,
    features: Option<&Features>,
    filter: &CandidateFilter,
    candidates: CandidateSet,
    grey: bool,
    schedule: Schedule,
) -> Result<WindowOfCandidates> {
    let groups = features.map_or(0, |features| features.packing.groups);
    let cells = cells(rec, filter.window_radius, 2 + 2 * groups)?;
    let window = WindowParams { pixel, radius: filter.window_radius as i32 };
    let guide = filter.guide(signal, variance_of_mean, candidates, grey);
    let by_color = candidates.by_color();
    let [symmetric, hard] = filter.weighting.symmetric.definitions();
    let [takes_part_first, takes_part_second, takes_part_third] = candidates.definitions();
    let definitions = [
        ("PATCH_RADIUS", Definition::Int(guide.patch_radius as i32)),
        ("SMALL_PATCH_RADIUS", Definition::Int(filter.first_patch_radius as i32)),
        ("COLOR", by_color.into()),
        takes_part_first,
        takes_part_second,
        takes_part_third,
        ("FEATURE_GROUPS", Definition::Int(groups as i32)),
        symmetric,
        hard,
    ];
    let candidate = filter.params(features);
    for_each_chunk_around(
        rec,
        extent,
        pixel,
        &guide,
        by_color,
        filter.window_radius,
        filter.weighting,
        schedule,
        |rec, chunk| {
            let columns = by_color.then(|| chunk.columns.within_columns_and_rows(guide.patch_radius, 0));
            let features = features.map(|features| features.buffer.within(filter.window_radius));
            let bound = CandidateWindow { params: chunk.params, candidate, window, columns, features, cells: &cells };
            rec.dispatch(
                "candidate_window",
                &definitions,
                &bound,
                [chunk.params.offsets.x as u32, chunk.params.offsets.y as u32, 1],
            )
        },
    )?;
    Ok(WindowOfCandidates { cells })
}
