//! Tiles of a signal that have noise.

use rayon::prelude::*;

use super::Signal;

/// Side of a tile, in pixels; filters reach over a few tiles.
pub(crate) const TILE: usize = 8;

/// Tiles of an image and whether any of their pixels is known to have noise: a half spread or a variance other than 0.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct NoiseTiles {
    /// Number of tiles in a row.
    columns: usize,
    noisy: Vec<bool>,
}

impl NoiseTiles {
    /// Finds the tiles of a signal with noise; looks at every value once.
    pub(crate) fn of(signal: &Signal) -> Self {
        let width = signal.mean.extent.width as usize;
        let columns = width.div_ceil(TILE);
        let planes: Vec<&[f32]> = [&signal.half_spread, &signal.variance_of_mean]
            .into_iter()
            .flatten()
            .flat_map(|image| &image.planes)
            .map(Vec::as_slice)
            .collect();
        let rows_of_a_tile = |rows: std::ops::Range<usize>| {
            let mut any = vec![0u32; columns];
            for row in planes.iter().flat_map(|plane| plane[rows.clone()].chunks_exact(width)) {
                for (any, values) in any.iter_mut().zip(row.chunks(TILE)) {
                    // All bits but the sign: 0 for 0 and −0 alone.
                    *any |= values.iter().fold(0, |bits, value| bits | value.to_bits() << 1);
                }
            }
            any
        };
        let pixels = signal.mean.extent.pixels();
        let tiles_of_rows = (0..pixels)
            .into_par_iter()
            .step_by(width * TILE)
            .map(|first| rows_of_a_tile(first..(first + width * TILE).min(pixels)));
        let noisy = tiles_of_rows.flat_map_iter(|any| any.into_iter().map(|bits| bits != 0)).collect();
        Self { columns, noisy }
    }

    /// Finds the tiles of several signals of one extent; a tile has noise where one of the signals has noise.
    pub(crate) fn of_all<'a>(signals: impl Iterator<Item = &'a Signal>) -> Option<Self> {
        signals
            .map(Self::of)
            .reduce(|all, one| Self { noisy: all.noisy.iter().zip(&one.noisy).map(|(a, b)| a | b).collect(), ..all })
    }

    /// Returns whether any tile has noise.
    pub(crate) fn any(&self) -> bool {
        self.noisy.contains(&true)
    }

    /// Returns for each tile whether no pixel within `reach` pixels of it has noise. Compares whole tiles, so a tile
    /// just beyond the reach may count as within it.
    pub(crate) fn exact(&self, reach: usize) -> Vec<bool> {
        let near = reach.div_ceil(TILE);
        let rows = self.noisy.len() / self.columns;
        let widened = |flags: &[bool], count: usize, stride: usize, at: usize, place: usize| {
            (place.saturating_sub(near)..=(place + near).min(count - 1)).any(|other| flags[at + other * stride])
        };
        let across: Vec<bool> = (0..self.noisy.len())
            .map(|tile| widened(&self.noisy, self.columns, 1, tile - tile % self.columns, tile % self.columns))
            .collect();
        (0..self.noisy.len())
            .map(|tile| !widened(&across, rows, self.columns, tile % self.columns, tile / self.columns))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::{Extent, Image};

    /// Noise in the last pixel alone, as −2 in one plane of the spread.
    fn one_noisy_pixel(width: u32, height: u32) -> Signal {
        let extent = Extent { width, height };
        let mut half_spread = Image::filled(extent, 3, -0.0);
        if let Some(last) = half_spread.planes[2].last_mut() {
            *last = -2.0;
        }
        Signal {
            mean: Image::filled(extent, 3, 1.0),
            half_spread: Some(half_spread),
            variance_of_mean: Some(Image::filled(extent, 3, 0.0)),
        }
    }

    #[test]
    fn noise_is_found_where_it_is() {
        for (width, height) in [(1, 1), (8, 8), (9, 17), (40, 33)] {
            let tiles = NoiseTiles::of(&one_noisy_pixel(width, height));
            let (columns, rows) = ((width as usize).div_ceil(TILE), (height as usize).div_ceil(TILE));
            assert_eq!((tiles.columns, tiles.noisy.len()), (columns, columns * rows));
            assert!(tiles.any());
            assert_eq!(tiles.noisy.iter().position(|noisy| *noisy), Some(columns * rows - 1));
            for reach in [0usize, 1, 8, 9, 16] {
                let near = reach.div_ceil(TILE);
                for (tile, exact) in tiles.exact(reach).into_iter().enumerate() {
                    let is_near = columns - 1 - tile % columns <= near && rows - 1 - tile / columns <= near;
                    assert_eq!(exact, !is_near, "{width}×{height}, tile {tile}, reach {reach}");
                }
            }
        }
    }

    #[test]
    fn without_noise_every_tile_is_exact() {
        let extent = Extent { width: 20, height: 10 };
        let signal = Signal {
            mean: Image::filled(extent, 1, 3.0),
            half_spread: None,
            variance_of_mean: Some(Image::filled(extent, 1, 0.0)),
        };
        let tiles = NoiseTiles::of(&signal);
        assert!(!tiles.any() && tiles.exact(100).iter().all(|exact| *exact));
        assert_eq!(NoiseTiles::of_all([&signal, &signal].into_iter()), Some(tiles));
    }
}
