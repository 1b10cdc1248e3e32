//! Adaptive sampling: the interface to a renderer that puts samples where the error is, and sample statistics that can
//! be added up.
//!
//! A [`Sampler`] draws whole numbers of samples per pixel from [`SampleCounts`], equal numbers for both halves. It
//! returns the [`Samples`] of this pass alone. [`Samples::merge`] adds them to those of earlier passes, and
//! [`Samples::to_frame`] makes the input of the denoiser. The crate `stein-stub` has a small path tracer that stands in
//! for a renderer.
//!
//! [`adapt`] is the loop: draw, denoise, estimate the error, hand out the next samples by a [`SamplingMap`]. The crate
//! `stein-exr` carries such a map as a file to a renderer in another process.

mod adapt;
mod density;
mod map;
mod sampler;
mod samples;

pub use adapt::{Event, Iterations, Outcome, Resumed, SampleSchedule, adapt, estimated_relative_mse, uniform};
pub use density::sampling_density;
pub use map::SamplingMap;
pub use sampler::{Progress, SampleCounts, Sampler};
pub use samples::{PixelAccumulator, Samples};
