//! How an image is cut into strips of rows that fit: what a strip costs, and how far its result reaches into its neighbours.

use super::dfc::{DENSITY_SMOOTHING, ERROR_SMOOTHING, PREFILTER, SCALE_RADIUS, SELECTION_SMOOTHING};
use super::params::Params;
use crate::error::{Error, Result};
use crate::frame::Frame;
use crate::gpu::Gpu;
use crate::stage::PLANE_PIXEL_BYTES;
use crate::stage::candidate::STATE_PLANES;
use crate::stage::feature::Packing;
use crate::stage::nlm::Schedule;
use crate::stage::variance::{INPUT_SMOOTHING, RESIDUAL_SMOOTHING};

/// Rows of an image that are worked on at one time: those wanted, and the halo that they depend on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Strip {
    /// First row wanted.
    pub(crate) first: usize,
    /// One past the last row wanted.
    pub(crate) end: usize,
    /// First row uploaded.
    pub(crate) first_with_halo: usize,
    /// One past the last row uploaded.
    pub(crate) end_with_halo: usize,
}

impl Strip {
    pub(crate) fn rows_with_halo(&self) -> usize {
        self.end_with_halo - self.first_with_halo
    }

    /// The pixels uploaded, in an image of this width.
    pub(crate) fn pixels(&self, width: usize) -> std::ops::Range<usize> {
        self.first_with_halo * width..self.end_with_halo * width
    }
}

/// How many rows above and below a pixel its result depends on: the reach of each stage, added up along the longest chain.
fn halo(params: &Params) -> usize {
    let scaled_variance = SCALE_RADIUS.max(INPUT_SMOOTHING.radius);
    // One more for the gradient, which is less than the smoothing of the residual variance.
    let features = PREFILTER.window_radius + PREFILTER.patch_radius + scaled_variance + RESIDUAL_SMOOTHING.radius.max(1);
    let candidates = params.window_radius + features.max(params.second_patch_radius + scaled_variance);
    let errors = ERROR_SMOOTHING.window_radius + ERROR_SMOOTHING.patch_radius + candidates;
    let pass1 = SELECTION_SMOOTHING.window_radius + SELECTION_SMOOTHING.patch_radius + errors;
    let pass2 = params.second_pass.map_or(0, |pass| pass.window_radius(params.window_radius) + pass.patch_radius + RESIDUAL_SMOOTHING.radius);
    let density = DENSITY_SMOOTHING.window_radius + DENSITY_SMOOTHING.patch_radius;
    (pass1 + pass2.max(density)) as usize
}

/// Planes of one pixel that live at the worst moment, and planes of the largest buffer. Counted from `dfc`: what is dropped is used again.
fn planes(frame: &Frame, kept: bool) -> (u64, u64) {
    let channels: Vec<u32> = frame.features().iter().map(|feature| feature.signal.mean.channels() as u32).collect();
    let packed = 3 * u64::from(Packing::new(&channels).groups);
    // Mean, half spread, sample variance of the colour and of each feature, the colour's scaled variance, the samples of each pixel.
    let input = 3 * (1 + channels.len() as u64) + 2;
    // Scaled variance, two box sums, two filtered planes, weights, residual variance.
    let prefilter = 7;
    // Candidates 6, derivatives 3, SURE, errors and weights 2, selected, smoothed and weights 2, blend 3, variance, second pass and weights 3.
    let later = 22;
    // Prefiltered features and residual variances, the sampling density and its weights.
    let kept = if kept { 3 * channels.len() as u64 + 3 } else { 0 };
    (input + packed + later.max(prefilter) + kept, packed.max(3))
}

/// The most that the candidates' running sums take for the rows that one scratch buffer covers.
fn running_sum_bytes(params: &Params, schedule: Schedule) -> u64 {
    let offsets_in_a_row = u64::from(2 * params.window_radius + 1);
    schedule.scratch_bytes * u64::from(STATE_PLANES) / offsets_in_a_row
}

/// Cuts a frame into strips of which each fits the adapter's binding limit and `max_memory` bytes.
///
/// # Errors
/// [`Error::Device`] where not even one row with its halo fits.
pub(crate) fn strips(gpu: &Gpu, frame: &Frame, params: &Params, kept: bool, schedule: Schedule, max_memory: Option<u64>) -> Result<Vec<Strip>> {
    let (width, height) = (u64::from(frame.extent().width), frame.extent().height as usize);
    let (live_planes, largest_planes) = planes(frame, kept);
    let row_bytes = width * PLANE_PIXEL_BYTES;
    let by_binding = gpu.max_binding_bytes() / (largest_planes * row_bytes);
    // Two scratch buffers for the column sums, and the running sums of the rows they cover: a scratch buffer holds at least one plane per pair of offsets, so with small
    // windows the running sums are the larger.
    let scratch = 2 * schedule.scratch_bytes + running_sum_bytes(params, schedule);
    let by_memory = max_memory.map_or(u64::MAX, |limit| limit.saturating_sub(scratch) / (live_planes * row_bytes));
    let most_rows = usize::try_from(by_binding.min(by_memory)).unwrap_or(usize::MAX);
    if most_rows >= height {
        return Ok(vec![Strip { first: 0, end: height, first_with_halo: 0, end_with_halo: height }]);
    }
    let halo = halo(params);
    let rows = most_rows.saturating_sub(2 * halo);
    if rows == 0 {
        let least = (2 * halo as u64 + 1) * live_planes * row_bytes + scratch;
        return Err(Error::Device {
            problem: format!(
                "a strip of one row of this image, with the {halo} rows above and below that it depends on, does not fit into the memory allowed: it needs {} MiB",
                least.div_ceil(1 << 20)
            ),
            remedy: "allow more with --max-memory, choose a smaller --radius, leave features out, or a device that binds larger buffers".into(),
        });
    }
    // Of equal height, so that the last one is not a sliver that costs as much halo as the others.
    let count = height.div_ceil(rows);
    let rows = height.div_ceil(count);
    Ok((0..height)
        .step_by(rows)
        .map(|first| {
            let end = (first + rows).min(height);
            Strip { first, end, first_with_halo: first.saturating_sub(halo), end_with_halo: (end + halo).min(height) }
        })
        .collect())
}
