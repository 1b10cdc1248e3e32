//! The weights in the window of one pixel, each with the distances behind it: what the filters compute, shown for one
//! pixel.
//!
//! A window of radius R is laid out as an image of (2R+1)² cells: the cell of the neighbour p + (dx, dy) lies in column
//! R + dx of row R + dy. The cell in the middle is not written: the weight of a pixel itself follows from its
//! neighbours.

use std::sync::Arc;

use glam::IVec2;

use super::candidate::{CandidateFrame, CandidateWindow as Window};
use super::candidate_filter::{CandidateFilter, CandidateParams, Pass, passes};
use super::feature::Slot;
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

/// The weights that a candidate gives the neighbours of a pixel in its own frame, and their distances.
#[derive(Clone, Debug)]
pub struct WindowOfCandidate {
    /// Cells of the window, which filters of one pass over the window share: two planes, and two more for each group of
    /// features.
    pub cells: Arc<Buffer>,
    /// Index of the filter in the pass. 0: small patches, 1: large patches, 2: features alone.
    of_pass: u32,
}

impl WindowOfCandidate {
    /// Returns the position of the weights, as they enter the average; 0 where a neighbour does not exist.
    pub fn weight(&self) -> CellLane {
        CellLane { plane: 0, component: self.of_pass }
    }

    /// Returns the position of the distances between patches of the colour; `None` for features alone.
    pub fn color(&self) -> Option<DistanceLanes> {
        (self.of_pass < 2).then(|| DistanceLanes::new(1, self.of_pass, 2 + self.of_pass))
    }

    /// Returns the position of the distances between the values of a feature.
    pub fn feature(&self, slot: Slot) -> DistanceLanes {
        let single = u32::from(slot.single);
        DistanceLanes::new(2 + 2 * slot.group + u32::from(self.of_pass == 2), single, 2 + single)
    }
}

/// Returns the weights of all `filters` at a pixel, and their distances, one window for each filter. `grey`: all
/// channels of the colour are equal.
///
/// # Errors
/// As [`Recorder::take`] and [`Recorder::dispatch`].
#[expect(clippy::too_many_arguments, reason = "they are the operator's definition; a struct would only rename them")]
pub fn candidate_window(
    rec: &mut Recorder,
    extent: IVec2,
    pixel: IVec2,
    frame: &CandidateFrame,
    filters: &[CandidateFilter],
    window: Window,
    grey: bool,
    schedule: Schedule,
) -> Result<Vec<WindowOfCandidate>> {
    let mut windows: Vec<(usize, WindowOfCandidate)> = Vec::new();
    for pass in passes(filters) {
        let cells = Arc::new(cells_of_pass(rec, extent, pixel, frame, &pass, window, grey, schedule)?);
        let places = [pass.small, pass.large, pass.alone];
        let of_place = |(of_pass, place): (u32, Option<usize>)| {
            Some((place?, WindowOfCandidate { cells: cells.clone(), of_pass }))
        };
        windows.extend((0..).zip(places).filter_map(of_place));
    }
    windows.sort_by_key(|(place, _)| *place);
    Ok(windows.into_iter().map(|(_, window)| window).collect())
}

#[expect(clippy::too_many_arguments, reason = "they are the operator's definition; a struct would only rename them")]
fn cells_of_pass(
    rec: &mut Recorder,
    extent: IVec2,
    pixel: IVec2,
    frame: &CandidateFrame,
    pass: &Pass,
    Window { radius, weighting }: Window,
    grey: bool,
    schedule: Schedule,
) -> Result<Buffer> {
    let features = frame.features.filter(|_| pass.by_features());
    let groups = features.map_or(0, |features| features.packing.groups);
    let cells = cells(rec, radius, 2 + 2 * groups)?;
    let window = WindowParams { pixel, radius: radius as i32 };
    let guide = frame.guide(pass, grey);
    let [symmetric, hard] = weighting.symmetric.definitions();
    let of_all = [("FEATURE_GROUPS", Definition::Int(groups as i32)), symmetric, hard];
    let definitions = [&of_all[..], &pass.definitions()].concat();
    let (candidate, by_color) = (pass.params(features), pass.by_color());
    for_each_chunk_around(rec, extent, pixel, &guide, by_color, radius, weighting, schedule, |rec, chunk| {
        let columns = by_color.then(|| chunk.columns.within_columns_and_rows(guide.patch_radius, 0));
        let features = features.map(|features| features.buffer.within(window.radius as u32));
        let bound = CandidateWindow { params: chunk.params, candidate, window, columns, features, cells: &cells };
        let invocations = [chunk.params.offsets.x as u32, chunk.params.offsets.y as u32, 1];
        rec.dispatch("candidate_window", &definitions, &bound, invocations)
    })?;
    Ok(cells)
}
