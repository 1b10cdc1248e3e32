//! Tiles without noise as far as a filter reaches: what would be filtered there stays what it was.
//!
//! Two things are kept apart. Which pixels take the value that they had is a matter of the frame alone. Which pixels
//! the filter is run for is a matter of cost: rectangles that cover all others, and some of them.

use glam::IVec2;

use super::per_pixel;
use crate::error::Result;
use crate::gpu::{Buffer, Recorder, bindings, uniforms};

uniforms! { struct ExactParams { extent: IVec2, tile: i32, tile_columns: i32, first: IVec2, planes: i32 } }

bindings! {
    struct ExactCopy<'a> { uniform params: ExactParams, read tiles, read before, write result }
    struct ExactFill<'a> { uniform params: ExactParams, read tiles, write result }
}

/// Which tiles of a frame are exact, and where in the frame an image begins that is a part of it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ExactTiles {
    /// Row by row, of the whole frame.
    flags: Vec<bool>,
    /// In a row.
    columns: usize,
    /// Of a tile, in pixels.
    side: usize,
    /// Pixel of the frame.
    first: IVec2,
}

/// A rectangle of pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Region {
    /// Its first column and row.
    pub first: IVec2,
    /// Its width and height.
    pub size: IVec2,
}

impl Region {
    /// The pixels of an image that are this far from one at the most, along either axis.
    pub(crate) fn around(pixel: IVec2, reach: u32, extent: IVec2) -> Self {
        let reach = IVec2::splat(reach as i32);
        let first = (pixel - reach).max(IVec2::ZERO);
        Self { first, size: (pixel + reach + 1).min(extent) - first }
    }

    /// What two have in common, if there is anything.
    pub(super) fn overlap(&self, other: &Self) -> Option<Self> {
        let first = self.first.max(other.first);
        let size = (self.first + self.size).min(other.first + other.size) - first;
        (size.min_element() > 0).then_some(Self { first, size })
    }
}

impl ExactTiles {
    /// From a flag for each tile of a frame, row by row, so many in a row, of so many pixels each way.
    pub fn new(flags: Vec<bool>, columns: usize, side: usize) -> Self {
        Self { flags, columns, side, first: IVec2::ZERO }
    }

    /// The same seen from an image that begins at this pixel of the frame.
    pub fn starting_at(&self, first: IVec2) -> Self {
        Self { first, ..self.clone() }
    }

    /// The share of the tiles that are exact.
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
            planes: 0,
        };
        Ok(UploadedTiles { tiles, params })
    }

    /// Rectangles that do not overlap and cover all pixels of an image that are in no exact tile. They are made of
    /// cells of this size, but at the right and lower border; two that cost no less than one around both are made one:
    /// a rectangle costs its area, with `margin` pixels around it, and `overhead` pixels.
    pub(crate) fn regions(&self, extent: IVec2, cell: IVec2, margin: i32, overhead: i64) -> Vec<Region> {
        let cost =
            |region: &Region| i64::from(region.size.x + 2 * margin) * i64::from(region.size.y + 2 * margin) + overhead;
        let pays = |a: &Region, b: &Region| cost(&covering(a, b)) <= cost(a) + cost(b);
        let mut done: Vec<Region> = Vec::new();
        // Those that end at the row of cells that is looked at.
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
            // A rectangle grows down where it is as wide as what lies below, or where one as wide as the wider of the
            // two pays.
            let mut grown: Vec<Region> = Vec::new();
            for above in open.drain(..) {
                let below: Vec<Region> = runs.iter().copied().filter(|run| share_columns(&above, run)).collect();
                let merged = below.iter().fold(above, |all, run| covering(&all, run));
                // No wider than it was: nothing else above it may be covered twice.
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

    /// Whether all tiles that a part of the image lies in are exact.
    pub(crate) fn is_exact(&self, region: &Region) -> bool {
        let tiles = |first: i32, count: i32| first as usize / self.side..((first + count) as usize).div_ceil(self.side);
        let first = region.first + self.first;
        let (columns, mut rows) = (tiles(first.x, region.size.x), tiles(first.y, region.size.y));
        rows.all(|row| self.flags[row * self.columns..][columns.clone()].iter().all(|exact| *exact))
    }
}

/// Exact tiles on the device, once for all that is written to them.
#[derive(Debug)]
pub(super) struct UploadedTiles {
    tiles: Buffer,
    /// But for the number of planes.
    params: ExactParams,
}

impl UploadedTiles {
    /// Puts `before`, so many planes, in the place of `result` in exact tiles.
    pub(super) fn copy(&self, rec: &mut Recorder, before: &Buffer, result: &Buffer, planes: u32) -> Result<()> {
        self.copy_as(rec, before, result, planes, false)
    }

    /// The same with a signal whose w becomes 1: the pixel is an average of itself alone.
    pub(super) fn copy_signal(&self, rec: &mut Recorder, before: &Buffer, result: &Buffer) -> Result<()> {
        self.copy_as(rec, before, result, 2, true)
    }

    fn copy_as(
        &self,
        rec: &mut Recorder,
        before: &Buffer,
        result: &Buffer,
        planes: u32,
        weight_sum: bool,
    ) -> Result<()> {
        let kernel = rec.gpu().kernel::<ExactCopy>("exact_copy", &[("WEIGHT_SUM", weight_sum.into())])?;
        rec.dispatch(
            &kernel,
            &ExactCopy { params: self.of_planes(planes), tiles: &self.tiles, before, result },
            per_pixel(self.params.extent),
        )
    }

    /// Puts 1 into the channels of so many planes in exact tiles, or 0.
    pub(super) fn fill(&self, rec: &mut Recorder, result: &Buffer, planes: u32, ones: bool) -> Result<()> {
        let kernel = rec.gpu().kernel::<ExactFill>("exact_fill", &[("ONES", ones.into())])?;
        rec.dispatch(
            &kernel,
            &ExactFill { params: self.of_planes(planes), tiles: &self.tiles, result },
            per_pixel(self.params.extent),
        )
    }

    fn of_planes(&self, planes: u32) -> ExactParams {
        ExactParams { planes: planes as i32, ..self.params }
    }
}

/// The smallest rectangle around two.
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

    /// A map in which every third tile or so is exact, in blocks.
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
