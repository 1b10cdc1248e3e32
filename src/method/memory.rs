//! How an image is cut into strips of rows that fit: what a strip costs, and how far its result reaches into its neighbours.

use super::{Facts, Method};
use crate::error::{Error, Result};
use crate::gpu::Gpu;
use crate::image::Extent;
use crate::stage::PLANE_PIXEL_BYTES;
use crate::stage::nlm::Schedule;

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

/// What a method takes, and how far its result reaches.
#[derive(Clone, Copy, Debug)]
pub(super) struct Footprint {
    /// How many rows above and below a pixel its result depends on: the reach of each stage, added up along the longest chain.
    pub(super) halo: usize,
    /// Planes of one pixel that live at the worst moment.
    pub(super) live_planes: u64,
    /// Planes of the largest buffer.
    pub(super) largest_planes: u64,
    /// What is taken besides, whatever the number of rows.
    pub(super) scratch_bytes: u64,
}

/// Planes that a frame is uploaded to: mean, half spread and sample variance of the colour and of each of `features`, and the samples of each pixel.
pub(super) fn uploaded_planes(features: usize) -> u64 {
    3 * (1 + features as u64) + 1
}

/// Cuts a frame into strips of which each, with the same rows of the frames beside it, fits the adapter's binding limit and `max_memory` bytes.
///
/// # Errors
/// [`Error::Device`] where not even one row with its halo fits.
pub(crate) fn strips(gpu: &Gpu, extent: Extent, method: &Method, facts: &Facts, kept: bool, schedule: Schedule, max_memory: Option<u64>) -> Result<Vec<Strip>> {
    let (width, height) = (u64::from(extent.width), extent.height as usize);
    let Footprint { halo, live_planes, largest_planes, scratch_bytes } = method.footprint(facts, kept, schedule);
    let row_bytes = width * PLANE_PIXEL_BYTES;
    let by_binding = gpu.max_binding_bytes() / (largest_planes * row_bytes);
    let by_memory = max_memory.map_or(u64::MAX, |limit| limit.saturating_sub(scratch_bytes) / (live_planes * row_bytes));
    let most_rows = usize::try_from(by_binding.min(by_memory)).unwrap_or(usize::MAX);
    if most_rows >= height {
        return Ok(vec![Strip { first: 0, end: height, first_with_halo: 0, end_with_halo: height }]);
    }
    let rows = most_rows.saturating_sub(2 * halo);
    if rows == 0 {
        let least = (2 * halo as u64 + 1) * live_planes * row_bytes + scratch_bytes;
        return Err(Error::Device {
            problem: format!(
                "a strip of one row of this image, with the {halo} rows above and below that it depends on, does not fit into the memory allowed: it needs {} MiB",
                least.div_ceil(1 << 20)
            ),
            remedy: "raise the memory limit (`Denoiser::with_max_memory`), choose a smaller window or fewer frames beside, leave features out, or choose another adapter, \
                     which binds larger buffers".into(),
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
