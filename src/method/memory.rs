//! How an image is cut into strips of rows that fit: what a strip costs, and how far its result reaches into its
//! neighbours.

use super::{Facts, Method};
use crate::error::{DeviceCause, Error, Result};
use crate::gpu::Gpu;
use crate::host_memory::{FreeMemory, Shortage};
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

/// Memory that a method takes, and how far its result reaches.
#[derive(Clone, Copy, Debug)]
pub(super) struct Footprint {
    /// Rows above and below a pixel that its result depends on: the reach of each stage, added up along the longest
    /// chain.
    pub(super) halo: usize,
    /// Planes that are alive at the same time, at most.
    pub(super) live_planes: u64,
    /// Planes of the largest buffer.
    pub(super) largest_planes: u64,
    /// Bytes of scratch buffers, whose size does not depend on the number of rows.
    pub(super) scratch_bytes: u64,
}

/// Planes that a frame without its features is uploaded to: mean, half spread and sample variance of the colour, and
/// the samples of each pixel.
pub(super) const UPLOADED_PLANES: u64 = 4;

/// What bounds the memory that buffers take on the device, besides the device.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DeviceMemory {
    /// The limit that a user set, in bytes.
    pub(crate) asked: Option<u64>,
    /// The memory of the computer, and what the host takes of it, in bytes: where the device is a program on the
    /// processor, its buffers are in the same memory.
    pub(crate) shared: Option<(FreeMemory, u64)>,
}

impl DeviceMemory {
    /// Bytes that a program takes that plays a graphics card, besides buffers: it compiles the kernels.
    const DRIVER_BYTES: u64 = 96 << 20;

    fn left_by_host(self) -> Option<u64> {
        self.shared.map(|(free, host)| free.bytes().saturating_sub(host + Self::DRIVER_BYTES))
    }

    /// Bytes that buffers may take.
    pub(crate) fn bytes(self) -> Option<u64> {
        self.asked.into_iter().chain(self.left_by_host()).min()
    }

    /// Why buffers of `least` bytes do not fit, which the adapter would bind.
    fn refuse(self, least: u64, halo: usize) -> Error {
        if let Some((free, host)) = self.shared
            && self.left_by_host().is_some_and(|left| left < least)
        {
            let what = format!(
                "a strip of one row of this image, with the {halo} rows above and below that it depends on, and the result"
            );
            return Shortage::new(host + Self::DRIVER_BYTES + least, free).error(&what);
        }
        Error::Device(DeviceCause::StripTooLarge { halo, needed: least, allowed: self.asked.unwrap_or(u64::MAX) })
    }
}

/// Planes per pixel that a method keeps as intermediates.
pub(crate) fn kept_planes(method: &Method, facts: &Facts, schedule: Schedule) -> u64 {
    let live = |kept: bool| method.footprint(facts, kept, schedule).live_planes;
    live(true) - live(false)
}

/// Cuts a frame into strips of which each, with the same rows of the frames beside it, fits the adapter's limits on
/// bindings and dispatches and the memory.
///
/// # Errors
/// [`Error::Device`] where not even one row with its halo fits.
pub(crate) fn strips(
    gpu: &Gpu,
    extent: Extent,
    method: &Method,
    facts: &Facts,
    kept: bool,
    schedule: Schedule,
    memory: DeviceMemory,
) -> Result<Vec<Strip>> {
    let (width, height) = (u64::from(extent.width), extent.height as usize);
    let Footprint { halo, live_planes, largest_planes, scratch_bytes } = method.footprint(facts, kept, schedule);
    let row_bytes = width * PLANE_PIXEL_BYTES;
    let by_binding = gpu.max_binding_bytes() / (largest_planes * row_bytes);
    let by_memory =
        memory.bytes().map_or(u64::MAX, |limit| limit.saturating_sub(scratch_bytes) / (live_planes * row_bytes));
    // A workgroup is at least one row high.
    let by_dispatch = u64::from(gpu.max_workgroups());
    let most_rows = usize::try_from(by_binding.min(by_memory).min(by_dispatch)).unwrap_or(usize::MAX);
    if most_rows >= height {
        return Ok(vec![Strip { first: 0, end: height, first_with_halo: 0, end_with_halo: height }]);
    }
    let rows = most_rows.saturating_sub(2 * halo);
    if rows == 0 {
        // The halo ends with the image.
        let rows = (2 * halo + 1).min(height) as u64;
        if by_memory < rows {
            return Err(memory.refuse(rows * live_planes * row_bytes + scratch_bytes, halo));
        }
        return Err(Error::Device(DeviceCause::StripExceedsAdapter {
            halo,
            bytes: rows * largest_planes * row_bytes,
            rows,
            most_bytes: gpu.max_binding_bytes(),
            most_groups: gpu.max_workgroups(),
            adapter: gpu.summary().name.clone(),
        }));
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
