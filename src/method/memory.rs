//! Cuts an image into strips of rows whose work fits the memory. Dry runs find the memory of a strip and the rows
//! around it that its result depends on.

use crate::error::{DeviceCause, Error, Result};
use crate::gpu::Gpu;
use crate::host_memory::{FreeMemory, Shortage};
use crate::image::Extent;

/// Rows of an image that are processed at one time: the rows of the result, and the halo that they depend on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Strip {
    /// First row of the result.
    pub(crate) first: usize,
    /// One past the last row of the result.
    pub(crate) end: usize,
    /// First row that is uploaded.
    pub(crate) first_with_halo: usize,
    /// One past the last row that is uploaded.
    pub(crate) end_with_halo: usize,
}

impl Strip {
    /// Makes a strip of the whole image.
    pub(crate) fn whole(extent: Extent) -> Self {
        let height = extent.height as usize;
        Self { first: 0, end: height, first_with_halo: 0, end_with_halo: height }
    }

    pub(crate) fn rows_with_halo(&self) -> usize {
        self.end_with_halo - self.first_with_halo
    }

    /// Returns the uploaded pixels, in an image of this width.
    pub(crate) fn pixels(&self, width: usize) -> std::ops::Range<usize> {
        self.first_with_halo * width..self.end_with_halo * width
    }
}

/// Memory of the work on some strips, and the reach of its results, found by a dry run.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Footprint {
    /// Rows above and below a pixel that its results depend on.
    pub(crate) halo: u32,
    /// Largest number of bytes that buffers take on the device.
    pub(crate) peak_bytes: u64,
    /// Size of the largest buffer, in bytes.
    pub(crate) largest_bytes: u64,
    /// Planes of one number per pixel that are kept as intermediates.
    pub(crate) kept_planes: u64,
}

/// Limits on the memory of the device's buffers, besides the limits of the device itself.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DeviceMemory {
    /// The limit that a user set, in bytes.
    pub(crate) asked: Option<u64>,
    /// Free memory of the computer, and the part of it that the host takes, in bytes. `None` unless the device is a
    /// program on the processor, which keeps its buffers in this memory.
    pub(crate) shared: Option<(FreeMemory, u64)>,
}

impl DeviceMemory {
    /// Bytes that a software device takes besides its buffers: it compiles the kernels.
    const DRIVER_BYTES: u64 = 96 << 20;

    fn left_by_host(self) -> Option<u64> {
        self.shared.map(|(free, host)| free.bytes().saturating_sub(host + Self::DRIVER_BYTES))
    }

    /// Returns the largest number of bytes that buffers may take; `None` without a limit.
    pub(crate) fn bytes(self) -> Option<u64> {
        self.asked.into_iter().chain(self.left_by_host()).min()
    }

    /// Makes the error for buffers of `least` bytes that the adapter could bind but the memory cannot hold.
    fn refuse(self, least: u64, halo: usize) -> Error {
        if let Some((free, host)) = self.shared
            && self.left_by_host().is_some_and(|left| left < least)
        {
            let what = format!(
                "a strip of one row of this image, with the {halo} rows above and below that it depends on, and the \
                 result"
            );
            return Shortage::new(host + Self::DRIVER_BYTES + least, free).error(&what);
        }
        Error::Device(DeviceCause::StripTooLarge { halo, needed: least, allowed: self.asked.unwrap_or(u64::MAX) })
    }
}

/// Cuts a frame into strips. Each strip, with the same rows of the frames beside, fits the memory and the adapter's
/// limits on bindings and dispatches. `whole` is the footprint of the frame as one strip; its halo holds for every
/// strip. `dry_run` finds the footprint of several strips under the limit of `memory`. Returns the strips with their
/// footprint.
///
/// # Errors
/// [`Error::Device`] where not even one row with its halo fits; errors of `dry_run`.
pub(crate) fn strips(
    gpu: &Gpu,
    extent: Extent,
    memory: DeviceMemory,
    whole: Footprint,
    dry_run: impl Fn(&[Strip]) -> Result<Footprint>,
) -> Result<(Vec<Strip>, Footprint)> {
    let (height, halo) = (extent.height as usize, whole.halo as usize);
    // All strips have the same height: a last sliver would cost as much halo as the others.
    let cut = |count: usize| {
        let rows = height.div_ceil(count);
        let strip = |first: usize| {
            let end = (first + rows).min(height);
            Strip { first, end, first_with_halo: first.saturating_sub(halo), end_with_halo: (end + halo).min(height) }
        };
        (0..height).step_by(rows).map(strip).collect::<Vec<_>>()
    };
    let tallest = |strips: &[Strip]| strips.iter().copied().max_by_key(Strip::rows_with_halo);
    let fits_memory = |footprint: &Footprint| memory.bytes().is_none_or(|limit| footprint.peak_bytes <= limit);
    let fits = |strips: &[Strip], footprint: &Footprint| {
        // A workgroup is at least one row high.
        let rows = tallest(strips).map_or(0, |strip| strip.rows_with_halo()) as u64;
        fits_memory(footprint)
            && footprint.largest_bytes <= gpu.max_binding_bytes()
            && rows <= u64::from(gpu.max_workgroups())
    };
    let in_one_piece = cut(1);
    if fits(&in_one_piece, &whole) {
        return Ok((in_one_piece, whole));
    }
    let within_limit = dry_run(&in_one_piece)?;
    if fits(&in_one_piece, &within_limit) {
        return Ok((in_one_piece, within_limit));
    }
    // Finds the fewest strips of which the tallest fits by itself. With two strips, each has a halo on one side only,
    // so the tallest of two may be lower than the tallest of three.
    let of_tallest = |count: usize| match tallest(&cut(count)) {
        None => Ok((true, whole)),
        Some(tallest) => dry_run(&[tallest]).map(|footprint| (fits(&[tallest], &footprint), footprint)),
    };
    let two_fit = of_tallest(2)?.0;
    let (rows_fit, least) = of_tallest(height)?;
    if two_fit || rows_fit {
        let (mut too_few, mut count) = if two_fit { (1, 2) } else { (2, height.max(2)) };
        while count - too_few > 1 {
            let middle = too_few.midpoint(count);
            if of_tallest(middle)?.0 {
                count = middle;
            } else {
                too_few = middle;
            }
        }
        // Then checks all strips one after the other: each of them finds the idle buffers of the strips before it.
        for count in count..=height.max(count) {
            let strips = cut(count);
            let footprint = dry_run(&strips)?;
            if fits(&strips, &footprint) {
                return Ok((strips, footprint));
            }
        }
    }
    if !fits_memory(&least) {
        return Err(memory.refuse(least.peak_bytes, halo));
    }
    // The halo ends with the image.
    let rows = (2 * halo + 1).min(height);
    Err(Error::Device(DeviceCause::StripExceedsAdapter {
        halo,
        bytes: least.largest_bytes,
        rows: rows as u64,
        most_bytes: gpu.max_binding_bytes(),
        most_groups: gpu.max_workgroups(),
        adapter: gpu.summary().name.clone(),
    }))
}
