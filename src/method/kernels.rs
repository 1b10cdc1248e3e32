//! Kernels of a method's filters at one pixel: which neighbours made the pixel, with which weights, and why.
//!
//! A kernel is made of the data that the filter itself reads: spikes are repaired, variances scaled, features
//! prefiltered, and patch distances come from the same stage. The neighbours averaged with its weights give the value
//! of the filter, except for the rounding of float32 sums.

use std::sync::Arc;

use glam::UVec2;
use serde::Serialize;

use super::{Lane, Plan, Share};
use crate::gpu::Buffer;
use crate::image::{Extent, Image};
use crate::stage::nlm::CentreWeight;
use crate::stage::window::{CellLane, DistanceLanes};

/// The kernels at one pixel, from [`Denoiser::kernels`](crate::Denoiser::kernels).
#[derive(Clone, Debug)]
pub struct Kernels {
    /// Column of the pixel p; 0 is the left column.
    pub x: u32,
    /// Row of the pixel; 0 is the top row.
    pub y: u32,
    /// One kernel for each filter that runs, in the order of the method:
    ///
    /// * DFC: the candidates that the plan computes (`first`, `second`, `third`); `color_only`, where features are
    ///   without noise; then `second_pass`, if it runs, which averages the blend of the others.
    /// * NLM: `half_a` and `half_b`, each with the weights of the other half; or `filter`, where both halves are
    ///   filtered as one.
    /// * GEM: `scale`, the scale that was chosen at the pixel.
    ///
    /// Empty where the frame is copied.
    pub filters: Vec<FilterKernel>,
    /// The steps that run for the frame, the steps that are left out, and why.
    pub plan: Plan,
}

impl Kernels {
    /// Returns the kernel of the filter with this name.
    pub fn filter(&self, name: &str) -> Option<&FilterKernel> {
        self.filters.iter().find(|filter| filter.name == name)
    }
}

/// The weights of one filter at a pixel p over its window of (2R+1)² cells, with p in the middle.
///
/// Every image covers one window: cell (R + dx, R + dy) belongs to the neighbour q = p + (dx, dy), and its value is
/// `planes[c][(R + dy) · (2R+1) + R + dx]`. [`FilterKernel::pixel`] returns the pixel of a cell, or `None` for a cell
/// outside of the frame.
#[derive(Clone, Debug)]
pub struct FilterKernel {
    /// Name of the filter; see [`Kernels::filters`].
    pub name: &'static str,
    /// R, the radius of the window in pixels.
    pub window_radius: u32,
    /// One plane: w(p, q), the weight in the average, from 0 to 1; 0 for cells outside of the frame. Where opposite
    /// neighbours may stand in for each other ([`Symmetry`](crate::stage::nlm::Symmetry)), the two cells hold the
    /// weights with which their own pixels are averaged, including their part of the weight of the mean. The middle
    /// cell holds the weight of the pixel itself, by the rule of [`CentreWeight`].
    pub weights: Image,
    /// Σ w over the window, including the pixel itself.
    pub weight_sum: f32,
    /// Three planes: the colours u(q) that are averaged, in the units of the frame, with spikes repaired. For a half of
    /// NLM, the colours of that half; for the second pass, the colours of pass 1. 0 for cells outside of the frame.
    pub colors: Image,
    /// Value of the filter at p, Σ w·u / Σ w per channel, in the units of the frame.
    pub value: [f32; 3],
    /// Share of a candidate of DFC in pass 1 at the pixel, from 0 to 1 (Algorithm 1 lines 27 to 33). The shares sum to
    /// 1. `None` for all other filters.
    pub share: Option<f32>,
    /// Rule that made the weights.
    pub rule: WeightRule,
    /// Distances of the neighbours, the distance of the colour first. Empty where the filter uses no distances.
    pub distances: Vec<Distance>,
    pub(crate) at: PixelInFrame,
}

/// Rule that makes the weights of a window. In a JSON document, its name is `rule` and its numbers are beside it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(tag = "rule", rename_all = "snake_case")]
pub enum WeightRule {
    /// The weight is the least of the weights of all distances (eq. 8.4), or 1 without distances.
    Least,
    /// The weight is the weight of the colour's distance, or 0 where that is below `cut`.
    Cut {
        /// Least weight that counts; smaller weights become 0.
        cut: f32,
    },
    /// The weight is the mean of the weights of all pairs of pixels (p + n, q + n) in the two patches (thesis 7.1.1),
    /// or 0 where that is below `cut`. [`Distance::weights`] holds the weight of the pair (p, q) alone.
    PatchMean {
        /// Least weight that counts; smaller weights become 0.
        cut: f32,
    },
    /// The weight is exp(−|p − q|²/(2σ²)) (thesis 6.4).
    Gaussian {
        /// σ, in pixels; 0 for the pixel filter, whose window is the pixel.
        sigma: f32,
    },
    /// The filter would change the pixel by more than `sigmas` standard deviations of its noise, so pass 1 is the
    /// result ([`SecondPass::most_sigmas`](super::dfc::SecondPass::most_sigmas)): the pixel has the weight 1, all
    /// others 0. The distances are those that the filter computed.
    Refused {
        /// The largest correction, in standard deviations.
        sigmas: f32,
    },
    /// The pixel lies in an exact tile: no pixel with noise is within reach of the filter, so the pixel stays as it is.
    /// It has the weight 1, all others 0.
    Exact,
}

/// Distances of the neighbours from the pixel, by the colour or by one feature.
#[derive(Clone, Debug)]
pub struct Distance {
    /// Data that the distance compares.
    pub of: Compared,
    /// One plane: d(p, q) before the exponential, the mean over the channels; for the colour, also the mean over the
    /// patch (eq. 7.3 and 7.4; features: thesis 8.3). Below 0 where the noise explains more than the difference;
    /// infinite for cells outside of the frame; 0 in the middle.
    pub distances: Image,
    /// One plane: the weights that follow from these distances alone, exp(−max(0, d)). Opposite neighbours stand in for
    /// each other where the filter allows it. 0 for cells outside of the frame, 1 in the middle.
    pub weights: Image,
}

/// Data that a distance compares.
#[derive(Clone, Debug, PartialEq)]
pub enum Compared {
    /// Patches of the colour.
    Color {
        /// f, in pixels: patches are 2f+1 pixels wide.
        patch_radius: u32,
        /// k_c: how large a difference counts, in standard deviations.
        k: f32,
    },
    /// The values of a feature at the two pixels.
    Feature {
        /// Name of the feature.
        name: String,
        /// k_f: how large a difference counts, in standard deviations.
        k: f32,
        /// τ of this filter, in squares of the unit range: the least scale of a squared difference.
        tau: f32,
    },
}

impl Compared {
    /// Returns `colour`, or the name of the feature.
    pub fn name(&self) -> &str {
        match self {
            Self::Color { .. } => "colour",
            Self::Feature { name, .. } => name,
        }
    }
}

impl Distance {
    /// Returns the weight of a neighbour by this distance alone, exp(−max(0, d)), if no opposite neighbour stood in for
    /// it. [`Distance::weights`] is larger where the mean of both neighbours matches better
    /// ([`Symmetry`](crate::stage::nlm::Symmetry)). 0 for cells outside of the frame.
    pub fn own_weight(&self, cell: usize) -> f32 {
        (-self.distances.planes[0][cell].max(0.0)).exp()
    }
}

impl FilterKernel {
    /// Returns the number of cells in a row of the window, 2R+1.
    pub fn side(&self) -> usize {
        2 * self.window_radius as usize + 1
    }

    /// Returns the column and row of the pixel that a cell belongs to; `None` outside of the frame. Cells count from 0,
    /// row by row.
    pub fn pixel(&self, cell: usize) -> Option<(u32, u32)> {
        self.at.neighbour(cell, self.window_radius)
    }

    /// Returns the cell of the opposite neighbour, p − (q − p); `None` where it lies outside of the frame.
    pub fn opposite(&self, cell: usize) -> Option<usize> {
        let opposite = self.weights.extent.pixels().checked_sub(1 + cell)?;
        self.pixel(opposite).map(|_| opposite)
    }

    /// Returns the distance that decided about a neighbour: the one of [`FilterKernel::distances`] with the least
    /// weight, and the first of several. `None` where all weights are 1, for the pixel itself, and outside of the
    /// frame.
    ///
    /// A neighbour may still weigh less than this weight, by [`WeightRule::PatchMean`] or by a cut; where the filter
    /// was refused, all neighbours weigh nothing.
    pub fn decided_by(&self, cell: usize) -> Option<&Distance> {
        self.pixel(cell)?;
        let least = self.distances.iter().map(|distance| distance.weights.planes[0][cell]).fold(1.0, f32::min);
        self.distances.iter().find(|distance| distance.weights.planes[0][cell] == least).filter(|_| least < 1.0)
    }
}

/// Position of the pixel in its frame.
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

/// A kernel on the device.
pub(crate) struct KernelOnGpu {
    pub(crate) name: &'static str,
    pub(crate) share: Option<Share>,
    /// Image whose first plane is averaged.
    pub(crate) averaged: Arc<Buffer>,
    pub(crate) weights: WeightsOnGpu,
}

impl KernelOnGpu {
    /// Returns the number of columns and rows beside the pixel that the kernel depends on, found by a dry run.
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
            // The chosen scale depends on all scales, and their windows lie within its reach.
            WeightsOnGpu::Gaussian(lane) => lane.buffer.reach(),
            WeightsOnGpu::Exact { window_radius } => of_window(*window_radius),
        };
        of_share.max(of_weights)
    }
}

/// Images that tell whether a limit refused the filtered value: it did where their first planes differ at the pixel.
pub(crate) struct LimitOnGpu {
    pub(crate) filtered: Arc<Buffer>,
    pub(crate) result: Arc<Buffer>,
    pub(crate) sigmas: f32,
}

pub(crate) enum WeightsOnGpu {
    /// Weights in the cells of a window that a stage wrote, all but the cell in the middle.
    Cells {
        cells: Arc<Buffer>,
        window_radius: u32,
        weight: CellLane,
        distances: Vec<(Compared, DistanceLanes)>,
        rule: WeightRule,
        centre: CentreWeight,
        limit: Option<LimitOnGpu>,
    },
    /// A Gaussian whose σ is the value of an image at the pixel.
    Gaussian(Lane),
    /// The pixel stays as it is; the filter has this window.
    Exact { window_radius: u32 },
}
