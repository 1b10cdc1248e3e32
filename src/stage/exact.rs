//! Tiles without noise within the reach of a filter: their pixels keep the values that they had.
//!
//! Two questions are kept apart. Which pixels keep their value depends on the frame alone. Which pixels the filter runs
//! for is a question of cost: rectangles cover all pixels that do not keep their value, and some that do.

use glam::IVec2;

use super::per_pixel;
use crate::error::Result;
use crate::gpu::{Buffer, Recorder, bindings, uniforms};

uniforms! {
    struct ExactParams {
        extent: IVec2, tile: i32, tile_columns: i32, first: IVec2, from_plane: i32, to_plane: i32, planes: i32,
    }
}

bindings! {
    struct ExactCopy<'a> { uniform params: ExactParams, read tiles, read before, write result }
    struct ExactFill<'a> { uniform params: ExactParams, read tiles, write result }
}

/// Exact tiles of a frame, and the position in the frame at which an image begins that is a part of the frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ExactTiles {
    /// Whether each tile of the whole frame is exact, row by row.
    flags: Vec<bool>,
    /// Number of tiles in a row.
    columns: usize,
    /// Width and height of a tile, in pixels.
    side: usize,
    /// Pixel of the frame at which the image begins.
    first: IVec2,
}

/// A rectangle of pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Region {
    /// First column and row.
    pub first: IVec2,
    /// Width and height, in pixels.
    pub size: IVec2,
}

impl Region {
    /// Returns the pixels of an image that are at most `reach` pixels away from `pixel`, along either axis.
    pub(crate) fn around(pixel: IVec2, reach: u32, extent: IVec2) -> Self {
        let reach = IVec2::splat(reach as i32);
        let first = (pixel - reach).max(IVec2::ZERO);
        Self { first, size: (pixel + reach + 1).min(extent) - first }
    }

    /// Returns the pixels that both regions have in common; `None` if there are none.
    pub(super) fn overlap(&self, other: &Self) -> Option<Self> {
        let first = self.first.max(other.first);
        let size = (self.first + self.size).min(other.first + other.size) - first;
        (size.min_element() > 0).then_some(Self { first, size })
    }
}

impl ExactTiles {
    /// Makes the tiles of a frame from a flag for each tile, row by row: `columns` tiles in a row, each `side` pixels
    /// wide and high.
    pub fn new(flags: Vec<bool>, columns: usize, side: usize) -> Self {
        Self { flags, columns, side, first: IVec2::ZERO }
    }

    /// Returns the tiles as seen from an image that begins at pixel `first` of the frame.
    pub fn starting_at(&self, first: IVec2) -> Self {
        Self { first, ..self.clone() }
    }

    /// Returns the share of the tiles that are exact, from 0 to 1.
    pub fn share(&self) -> f64 {
        self.flags.iter().filter(|exact| **exact).count() as f64 / self.flags.len() as f64
    }

    /// Brings the map to the device, for images of this extent.
    pub(super) fn upload(&self, rec: &mut Recorder, extent: IVec2) -> Result<UploadedTiles> {
        let words: Vec<u32> = self.flags.iter().map(|exact| u32::from(*exact)).collect();
        let tiles = rec.upload_bytes("exact tiles", bytemuck::cast_slice(&words))?;
        let params = ExactParams {
            extent,
            tile: self.side as i32,
            tile_columns: self.columns as i32,
            first: self.first,
            from_plane: 0,
            to_plane: 0,
            planes: 0,
        };
        Ok(UploadedTiles { tiles, params })
    }

    /// Returns rectangles that do not overlap and cover all pixels of an image that are in no exact tile. They are made
    /// of cells of size `cell`, except at the right and lower border. Two rectangles become one if one around both
    /// costs no more: a rectangle costs its area, including `margin` pixels around it, plus `overhead` pixels.
    pub(crate) fn regions(&self, extent: IVec2, cell: IVec2, margin: i32, overhead: i64) -> Vec<Region> {
        let cost =
            |region: &Region| i64::from(region.size.x + 2 * margin) * i64::from(region.size.y + 2 * margin) + overhead;
        let pays = |a: &Region, b: &Region| cost(&covering(a, b)) <= cost(a) + cost(b);
        let mut done: Vec<Region> = Vec::new();
        // Rectangles that end at the current row of cells.
        let mut open: Vec<Region> = Vec::new();
        for y in (0..extent.y).step_by(cell.y as usize) {
            let mut runs: Vec<Region> = Vec::new();
            for x in (0..extent.x).step_by(cell.x as usize) {
                let first = IVec2::new(x, y);
                let size = cell.min(extent - first);
                let run = Region { first, size };
                if self.is_exact(&run) {
                    continue;
                }
                match runs.last_mut().filter(|last| pays(last, &run)) {
                    Some(last) => *last = covering(last, &run),
                    None => runs.push(run),
                }
            }
            // A rectangle grows down over the runs below it if they are no wider and if the merged rectangle costs no
            // more.
            let mut grown: Vec<Region> = Vec::new();
            for above in open.drain(..) {
                let below: Vec<Region> = runs.iter().copied().filter(|run| share_columns(&above, run)).collect();
                let merged = below.iter().fold(above, |all, run| covering(&all, run));
                // The rectangle may not become wider: pixels of other rectangles would be covered twice.
                let fits = !below.is_empty() && merged.size.x == above.size.x;
                if fits && cost(&merged) <= cost(&above) + below.iter().map(cost).sum::<i64>() {
                    runs.retain(|run| !share_columns(&above, run));
                    grown.push(merged);
                } else {
                    done.push(above);
                }
            }
            open = grown;
            open.extend(runs);
        }
        done.extend(open);
        done
    }

    /// Returns whether all tiles that a part of the image lies in are exact.
    pub(crate) fn is_exact(&self, region: &Region) -> bool {
        let tiles = |first: i32, count: i32| first as usize / self.side..((first + count) as usize).div_ceil(self.side);
        let first = region.first + self.first;
        let (columns, mut rows) = (tiles(first.x, region.size.x), tiles(first.y, region.size.y));
        rows.all(|row| self.flags[row * self.columns..][columns.clone()].iter().all(|exact| *exact))
    }
}

/// Exact tiles on the device, uploaded once for all images that are written there.
#[derive(Debug)]
pub(super) struct UploadedTiles {
    tiles: Buffer,
    /// Parameters, complete except for the number of planes.
    params: ExactParams,
}

impl UploadedTiles {
    /// Copies `planes` planes of `before` to `result`, in exact tiles.
    pub(super) fn copy(&self, rec: &mut Recorder, before: &Buffer, result: &Buffer, planes: u32) -> Result<()> {
        let params = ExactParams { planes: planes as i32, ..self.params };
        self.copy_as(rec, before, result, params, false)
    }

    /// Copies the mean of a signal to a plane, in exact tiles, and sets w to 1: each pixel is the average of itself
    /// alone.
    pub(super) fn copy_mean(&self, rec: &mut Recorder, signal: &Buffer, result: &Buffer, plane: u32) -> Result<()> {
        let params = ExactParams { to_plane: plane as i32, planes: 1, ..self.params };
        self.copy_as(rec, signal, result, params, true)
    }

    /// Copies the half spread of a signal to a plane, in exact tiles.
    pub(super) fn copy_spread(&self, rec: &mut Recorder, signal: &Buffer, result: &Buffer, plane: u32) -> Result<()> {
        let params = ExactParams { from_plane: 1, to_plane: plane as i32, planes: 1, ..self.params };
        self.copy_as(rec, signal, result, params, false)
    }

    fn copy_as(
        &self,
        rec: &mut Recorder,
        before: &Buffer,
        result: &Buffer,
        params: ExactParams,
        weight_sum: bool,
    ) -> Result<()> {
        let bound = ExactCopy { params, tiles: &self.tiles, before, result };
        rec.dispatch("exact_copy", &[("WEIGHT_SUM", weight_sum.into())], &bound, per_pixel(params.extent))
    }

    /// Writes 1 (`ones`) or 0 to the channels of `planes` planes, in exact tiles.
    pub(super) fn fill(&self, rec: &mut Recorder, result: &Buffer, planes: u32, ones: bool) -> Result<()> {
        let params = ExactParams { planes: planes as i32, ..self.params };
        let bound = ExactFill { params, tiles: &self.tiles, result };
        rec.dispatch("exact_fill", &[("ONES", ones.into())], &bound, per_pixel(params.extent))
    }
}

/// Returns the smallest rectangle around two.
fn covering(a: &Region, b: &Region) -> Region {
    let first = a.first.min(b.first);
    Region { first, size: (a.first + a.size).max(b.first + b.size) - first }
}

fn share_columns(a: &Region, b: &Region) -> bool {
    a.first.x < b.first.x + b.size.x && b.first.x < a.first.x + a.size.x
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIDE: usize = 8;

    /// Makes a map in which about every third tile is exact, in blocks.
    fn map(columns: usize, rows: usize, seed: usize) -> ExactTiles {
        let flags = (0..columns * rows)
            .map(|tile| (tile % columns / 3 * 7 + tile / columns / 2 * 5 + seed).is_multiple_of(3))
            .collect();
        ExactTiles::new(flags, columns, SIDE)
    }

    #[test]
    fn regions_cover_each_pixel_that_is_not_exact_once() {
        for (width, height) in [(1, 1), (70, 51), (257, 89), (16, 8)] {
            for (seed, first_column, first_row) in [(0, 0, 0), (1, 0, 3), (2, 0, 8), (1, 5, 3), (2, 16, 0)] {
                let tiles_along = |size: i32, first: i32| ((size + first) as usize).div_ceil(SIDE);
                let tiles = map(tiles_along(width, first_column), tiles_along(height, first_row), seed)
                    .starting_at(IVec2::new(first_column, first_row));
                for cell in [IVec2::new(8, 8), IVec2::new(32, 2), IVec2::new(24, 16)] {
                    for overhead in [0, 100, 1 << 30] {
                        let extent = IVec2::new(width, height);
                        let regions = tiles.regions(extent, cell, 3, overhead);
                        for y in 0..height {
                            for x in 0..width {
                                let p = IVec2::new(x, y);
                                let covered = regions
                                    .iter()
                                    .filter(|region| {
                                        p.cmpge(region.first).all() && p.cmplt(region.first + region.size).all()
                                    })
                                    .count();
                                let is_exact = tiles.flags[(y + first_row) as usize / SIDE * tiles.columns
                                    + (x + first_column) as usize / SIDE];
                                assert!(
                                    covered <= 1 && (is_exact || covered == 1),
                                    "{width}×{height}, {cell}, {overhead}: {p} is covered {covered} times"
                                );
                            }
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn regions_leave_out_what_is_exact() {
        let half = ExactTiles::new((0..64).map(|tile| tile % 8 < 4).collect(), 8, SIDE);
        let right = Region { first: IVec2::new(32, 0), size: IVec2::new(32, 64) };
        assert_eq!(half.regions(IVec2::new(64, 64), IVec2::new(16, 8), 3, 100), [right]);
        assert_eq!(ExactTiles::new(vec![true; 64], 8, SIDE).regions(IVec2::new(64, 64), IVec2::new(16, 8), 3, 100), []);
        assert_eq!(half.share(), 0.5);
    }
}
