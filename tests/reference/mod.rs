//! The naive float64 twin of every stage, of Algorithm 1 and of GEM, written from chapters 6 to 8 of the thesis.
//!
//! The shaders are compared with this twin, so it shares no code and no trick with them: one loop per sum, patch
//! distances by brute force, no separable filter, no value kept from one pixel to the next. The speed of a test is not
//! worth a doubt about its reference.
//!
//! ```text
//! exposure    the unit that all of it is done in
//! variance    what is known of the noise: scaled sample variances, two-buffer variances      8.2, 8.3
//! noise       variances that no renderer gave, from two halves
//! spike       what stands out on very few samples, and where it goes; the same pixels of a payload
//! gaussian    averages, their variance, averages of a pixel's neighbours                      6.2, 6.4
//! nlm         the one NL-means operator: payload, optional guide, optional features          7.1.1, 8.2, 8.3
//! window      what the operator sees from one pixel: weights and the distances behind them  7.1.1, 8.2, 8.3
//! prefilter   features: denoised, their residual variance and gradient                       8.3
//! candidates  one candidate filter and its derivative                                        8.4
//! sure        its error                                                                      8.4
//! select      the least error, as binary maps, smoothed maps, guarded maps                   8.4
//! dfc         all of it in order                                                             8.5
//! keep_clean  what has no noise stays as it is
//! gem         scales, stopping maps and what they choose                                      6
//! random      noise that is the same on every machine
//! compare     how far something is from it
//! ```
//!
//! Neighbours outside the image do not exist: windows, patches, boxes and Gaussians shrink at the border and are
//! normalised by their remaining pixels.

#![allow(
    missing_docs,
    reason = "fields and parameters bear the names of the text; each stage says which section it is"
)]

pub mod candidates;
pub mod compare;
pub mod dfc;
pub mod exposure;
pub mod gaussian;
pub mod gem;
pub mod keep_clean;
pub mod nlm;
pub mod nlm_method;
pub mod noise;
pub mod prefilter;
pub mod random;
pub mod select;
pub mod spike;
pub mod sure;
pub mod variance;
pub mod window;

use std::num::NonZero;
use std::ops::{Add, Range, Sub};
use std::thread;

/// A pixel, or the offset between two; it may lie outside the image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Point {
    pub x: isize,
    pub y: isize,
}

impl Add for Point {
    type Output = Point;

    fn add(self, offset: Point) -> Point {
        Point { x: self.x + offset.x, y: self.y + offset.y }
    }
}

impl Sub for Point {
    type Output = Point;

    fn sub(self, offset: Point) -> Point {
        Point { x: self.x - offset.x, y: self.y - offset.y }
    }
}

/// One plane, rows from the top.
#[derive(Clone, Debug, PartialEq)]
pub struct Grid {
    pub width: usize,
    pub height: usize,
    pub values: Vec<f64>,
}

/// Planes of one extent that belong together, such as the channels of a colour.
pub type Planes = Vec<Grid>;

impl Grid {
    pub fn filled(width: usize, height: usize, value: f64) -> Grid {
        Grid { width, height, values: vec![value; width * height] }
    }

    /// The value of every pixel from its position.
    pub fn from_fn(width: usize, height: usize, pixel: impl Fn(Point) -> f64 + Sync) -> Grid {
        Grid { width, height, values: map_pixels(width, height, pixel) }
    }

    /// A plane of the same extent, from the position of every pixel.
    pub fn like(&self, pixel: impl Fn(Point) -> f64 + Sync) -> Grid {
        Grid::from_fn(self.width, self.height, pixel)
    }

    pub fn contains(&self, p: Point) -> bool {
        p.x >= 0 && p.y >= 0 && (p.x as usize) < self.width && (p.y as usize) < self.height
    }

    pub fn index(&self, p: Point) -> usize {
        debug_assert!(self.contains(p));
        p.y as usize * self.width + p.x as usize
    }

    pub fn at(&self, p: Point) -> f64 {
        self.values[self.index(p)]
    }

    pub fn mean(&self) -> f64 {
        self.values.iter().sum::<f64>() / self.values.len() as f64
    }
}

/// The mean over the planes at one pixel.
pub fn channel_mean(planes: &[Grid], p: Point) -> f64 {
    planes.iter().map(|plane| plane.at(p)).sum::<f64>() / planes.len() as f64
}

/// The median; of an even number the lower one of the two in the middle.
pub fn lower_median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[(values.len() - 1) / 2]
}

/// All offsets of a square of side `2·radius + 1`, row by row.
pub fn square(radius: usize) -> impl Iterator<Item = Point> {
    let reach = -(radius as isize)..=radius as isize;
    reach.clone().flat_map(move |y| reach.clone().map(move |x| Point { x, y }))
}

/// Calls `pixel` for every pixel, rows from the top. The only place that knows of threads: bands of rows, one per core.
pub fn map_pixels<T: Send>(width: usize, height: usize, pixel: impl Fn(Point) -> T + Sync) -> Vec<T> {
    let pixel = &pixel;
    let band = move |rows: Range<usize>| -> Vec<T> {
        rows.flat_map(|y| (0..width).map(move |x| pixel(Point { x: x as isize, y: y as isize }))).collect()
    };
    let cores = thread::available_parallelism().map_or(1, NonZero::get);
    let rows = height.div_ceil(cores).max(1);
    thread::scope(|scope| {
        let bands: Vec<_> =
            (0..height).step_by(rows).map(|top| scope.spawn(move || band(top..height.min(top + rows)))).collect();
        bands.into_iter().flat_map(|band| band.join().expect("a reference pixel panicked")).collect()
    })
}
