//! The stages: one function per shader, named like its file. They know the GPU layer and nothing about methods.
//!
//! Everything lives in *planes*: one vec4 per pixel, channels in x, y, z. A *signal* is two planes in one buffer, the
//! mean and behind it the half spread ([`Signal::half_spread`](crate::frame::Signal::half_spread)).

pub mod candidate;
pub mod candidate_filter;
pub mod error;
pub mod exact;
pub mod feature;
pub mod frames;
pub mod gaussian;
pub mod half;
pub mod keep_clean;
pub mod nlm;
pub mod noise;
pub mod payload;
pub mod sample;
pub mod scale;
pub mod select;
pub mod spike;
pub mod variance;
pub mod window;

use glam::IVec2;

/// Bytes of one pixel in one plane.
pub const PLANE_PIXEL_BYTES: u64 = 16;

/// Returns the bytes of `planes` planes of an image.
pub(crate) fn plane_bytes(extent: IVec2, planes: u32) -> u64 {
    extent.x as u64 * extent.y as u64 * u64::from(planes) * PLANE_PIXEL_BYTES
}

/// Returns one invocation per pixel.
pub(crate) fn per_pixel(extent: IVec2) -> [u32; 3] {
    [extent.x as u32, extent.y as u32, 1]
}

/// Returns one invocation per `pixels` adjacent pixels in a row.
pub(crate) fn per_run(extent: IVec2, pixels: u32) -> [u32; 3] {
    [(extent.x as u32).div_ceil(pixels), extent.y as u32, 1]
}
