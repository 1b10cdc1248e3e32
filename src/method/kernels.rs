//! Which neighbours made a pixel, and why: the kernels of a method's filters at one pixel.
//!
//! A kernel is made of what the filter itself reads: spikes repaired, variances scaled, features prefiltered, patch
//! distances from the same stage. Averaged with its weights, the neighbours give the value that the filter gives, but
//! for the rounding of float32 sums.

use std::sync::Arc;

use glam::UVec2;
use serde::Serialize;

use super::{Lane, Plan, Share};
use crate::gpu::Buffer;
use crate::image::{Extent, Image};
use crate::stage::nlm::CentreWeight;
use crate::stage::window::{CellLane, DistanceLanes};

/// The kernels at one pixel, as [`Denoiser::kernels`](crate::Denoiser::kernels) tells them.
#[derive(Clone, Debug)]
pub struct Kernels {
    /// Column of the pixel p; 0 is the left column.
    pub x: u32,
    /// Row of the pixel; 0 is the top row.
    pub y: u32,
    /// One for each filter that runs, in the order of the method:
    ///
    /// | method | names |
    /// | --- | --- |
    /// | DFC | the candidates, `first`, `second`, `third`, without those that are left out; `color_only`, where features are without noise; then `second_pass`, where there is one, which averages what the others were blended to |
    /// | NLM | `half_a` and `half_b`, each with the weights of the other half; `filter` where both are filtered as one |
    /// | GEM | `scale`, the scale that the pixel came to |
    ///
    /// Empty where the frame is copied.
    pub filters: Vec<FilterKernel>,
    /// What runs for the frame, what is left out, and why.
    pub plan: Plan,
}

impl Kernels {
    /// The kernel of the filter of this name.
    pub fn filter(&self, name: &str) -> Option<&FilterKernel> {
        self.filters.iter().find(|filter| filter.name == name)
    }
}

/// The weights of one filter at a pixel p over its window of (2R+1)² cells, with p in the middle.
///
/// Every image is one window: cell (R + dx, R + dy) belongs to the neighbour q = p + (dx, dy), so that
/// `planes[c][(R + dy) · (2R+1) + R + dx]` is its value. [`FilterKernel::pixel`] tells which pixel that is, or that the
/// frame ends before it.
#[derive(Clone, Debug)]
pub struct FilterKernel {
    /// See [`Kernels::filters`].
    pub name: &'static str,
    /// R, in pixels.
    pub window_radius: u32,
    /// One plane: w(p, q) as it enters the average, from 0 to 1; 0 for cells outside of the frame. Where pairs of
    /// opposite neighbours stand in for each other ([`Symmetry`](crate::stage::nlm::Symmetry)), each of the two cells
    /// has the weight that its own pixel is averaged with, the share in the weight of their mean included. In the
    /// middle the weight of the pixel itself, by the rule of [`CentreWeight`].
    pub weights: Image,
    /// Σ w over the window.
    pub weight_sum: f32,
    /// Three planes: the colours u(q) that are averaged, in the units of the frame, spikes repaired; of a half of NLM
    /// that half's, of the second pass those of pass 1. 0 for cells outside of the frame.
    pub colors: Image,
    /// Σ w·u / Σ w per channel: what the filter makes of p, in the units of the frame.
    pub value: [f32; 3],
    /// Of a candidate of DFC the share that it has in pass 1 of the pixel, from 0 to 1 (Algorithm 1 lines 27 to 33);
    /// shares sum to 1. `None` of all other filters.
    pub share: Option<f32>,
    /// How the weights came about.
    pub rule: WeightRule,
    /// What the neighbours were told apart by, the colour first. Empty where no distances are involved.
    pub distances: Vec<Distance>,
    pub(crate) at: PixelInFrame,
}

/// How the weights of a window came about. A JSON document names it as `rule`, its numbers beside.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(tag = "rule", rename_all = "snake_case")]
pub enum WeightRule {
    /// A weight is the least among those of the distances (eq. 8.4), and 1 where there are none.
    Least,
    /// A weight is that of the colour's distance, and 0 below `cut`.
    Cut {
        /// The smallest weight that counts.
        cut: f32,
    },
    /// A weight is the mean of the weights of all pairs of pixels (p + n, q + n) in the two patches (thesis 7.1.1), and
    /// 0 below `cut`: what [`Distance::weights`] shows is that of the pair (p, q) alone.
    PatchMean {
        /// The smallest weight that counts.
        cut: f32,
    },
    /// A weight is exp(−|p − q|²/(2σ²)) (thesis 6.4).
    Gaussian {
        /// σ, in pixels; 0 for the pixel filter, whose window is the pixel.
        sigma: f32,
    },
    /// The filter would change the pixel by more than `sigmas` standard deviations of its noise, so that pass 1 is the
    /// result ([`SecondPass::most_sigmas`](super::dfc::SecondPass::most_sigmas)): its weight is 1, the others are 0.
    /// The distances tell what the filter saw.
    Refused {
        /// The largest correction, in standard deviations.
        sigmas: f32,
    },
    /// The pixel lies in a tile from which no pixel with noise is within reach, and is left as it is: its weight is 1,
    /// the others are 0.
    Exact,
}

/// The distances of the neighbours in one respect.
#[derive(Clone, Debug)]
pub struct Distance {
    /// In which.
    pub of: Compared,
    /// One plane: d(p, q), the mean over channels, and of the colour over the patch, before the exponential (eq. 7.3
    /// and 7.4; features: thesis 8.3). Below 0 where the noise explains more than there is; infinite for cells outside
    /// of the frame; 0 in the middle.
    pub distances: Image,
    /// One plane: the weights that these distances alone would give, exp(−max(0, d)) with opposite neighbours standing
    /// in for each other where the filter lets them. 0 for cells outside of the frame, 1 in the middle.
    pub weights: Image,
}

/// What a distance compares.
#[derive(Clone, Debug, PartialEq)]
pub enum Compared {
    /// Patches of the colour.
    Color {
        /// f, in pixels: patches are 2f+1 pixels wide.
        patch_radius: u32,
        /// k_c: how large a difference counts, in standard deviations.
        k: f32,
    },
    /// A feature, pixel by pixel.
    Feature {
        /// Its name.
        name: String,
        /// k_f.
        k: f32,
        /// τ of this filter, in squares of the unit range: the least squared difference that counts.
        tau: f32,
    },
}

impl Compared {
    /// `colour`, or the name of the feature.
    pub fn name(&self) -> &str {
        match self {
            Self::Color { .. } => "colour",
            Self::Feature { name, .. } => name,
        }
    }
}

impl Distance {
    /// The weight that a neighbour would have by this distance if it stood for itself, exp(−max(0, d));
    /// [`Distance::weights`] has more of it where the mean with its opposite matches better
    /// ([`Symmetry`](crate::stage::nlm::Symmetry)). 0 for cells outside of the frame.
    pub fn own_weight(&self, cell: usize) -> f32 {
        (-self.distances.planes[0][cell].max(0.0)).exp()
    }
}

impl FilterKernel {
    /// Cells in a row of the window, 2R+1.
    pub fn side(&self) -> usize {
        2 * self.window_radius as usize + 1
    }

    /// The column and row of the pixel that a cell of the window belongs to; `None` outside of the frame. Cells count
    /// from 0, row by row.
    pub fn pixel(&self, cell: usize) -> Option<(u32, u32)> {
        self.at.neighbour(cell, self.window_radius)
    }

    /// The cell of the neighbour on the other side of the pixel, p − (q − p); `None` where it lies outside of the
    /// frame.
    pub fn opposite(&self, cell: usize) -> Option<usize> {
        let opposite = self.weights.extent.pixels().checked_sub(1 + cell)?;
        self.pixel(opposite).map(|_| opposite)
    }

    /// What decided about a neighbour: of [`FilterKernel::distances`] the one with the least weight, the first of
    /// several. `None` where nothing speaks against it, for the pixel itself, and outside of the frame. A neighbour
    /// whose weight [`WeightRule::PatchMean`] or a cut changed may still weigh less, and where the filter was refused
    /// all neighbours weigh nothing.
    pub fn decided_by(&self, cell: usize) -> Option<&Distance> {
        self.pixel(cell)?;
        let least = self.distances.iter().map(|distance| distance.weights.planes[0][cell]).fold(1.0, f32::min);
        self.distances.iter().find(|distance| distance.weights.planes[0][cell] == least).filter(|_| least < 1.0)
    }
}

/// Where the pixel is.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PixelInFrame {
    pub(crate) x: u32,
    pub(crate) y: u32,
    pub(crate) extent: Extent,
}

impl PixelInFrame {
    pub(crate) fn neighbour(&self, cell: usize, window_radius: u32) -> Option<(u32, u32)> {
        let side = 2 * window_radius as usize + 1;
        let along = |at: u32, offset: usize, size: u32| {
            (at + offset as u32).checked_sub(window_radius).filter(|place| *place < size)
        };
        (cell < side * side).then_some(())?;
        Some((along(self.x, cell % side, self.extent.width)?, along(self.y, cell / side, self.extent.height)?))
    }
}

/// A kernel as it lies on the device.
pub(crate) struct KernelOnGpu {
    pub(crate) name: &'static str,
    pub(crate) share: Option<Share>,
    /// Image whose first plane is averaged.
    pub(crate) averaged: Arc<Buffer>,
    pub(crate) weights: WeightsOnGpu,
}

impl KernelOnGpu {
    /// Columns and rows beside the pixel that the kernel depends on, by a dry run.
    pub(crate) fn reach(&self) -> UVec2 {
        let Self { share, averaged, weights, .. } = self;
        let of_share = match share {
            Some(Share::Lane(lane)) => lane.buffer.reach(),
            Some(Share::None | Share::Whole) | None => UVec2::ZERO,
        };
        let of_window = |radius: u32| averaged.reach() + radius;
        let of_weights = match weights {
            WeightsOnGpu::Cells { cells, window_radius, limit, .. } => {
                let of_limit = limit
                    .as_ref()
                    .map_or(UVec2::ZERO, |LimitOnGpu { filtered, result, .. }| filtered.reach().max(result.reach()));
                cells.reach().max(of_window(*window_radius)).max(of_limit)
            }
            // The scale that a pixel comes to depends on all scales, whose windows are within its reach.
            WeightsOnGpu::Gaussian(lane) => lane.buffer.reach(),
            WeightsOnGpu::Exact { window_radius } => of_window(*window_radius),
        };
        of_share.max(of_weights)
    }
}

/// Where the filter's value is the result, and where not: the first planes of images.
pub(crate) struct LimitOnGpu {
    pub(crate) filtered: Arc<Buffer>,
    pub(crate) result: Arc<Buffer>,
    pub(crate) sigmas: f32,
}

pub(crate) enum WeightsOnGpu {
    /// The window of a stage, but for the cell in its middle.
    Cells {
        cells: Arc<Buffer>,
        window_radius: u32,
        weight: CellLane,
        distances: Vec<(Compared, DistanceLanes)>,
        rule: WeightRule,
        centre: CentreWeight,
        limit: Option<LimitOnGpu>,
    },
    /// The Gaussian whose σ an image says at the pixel.
    Gaussian(Lane),
    /// The pixel is left as it is by a filter of this window.
    Exact { window_radius: u32 },
}
