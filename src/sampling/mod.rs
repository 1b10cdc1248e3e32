//! Closing the loop: what a renderer implements so that samples go where the error is, and statistics of samples that
//! add up.
//!
//! A [`Sampler`] draws whole numbers of samples per pixel, as [`SampleCounts`] say, in equal numbers for both halves.
//! It returns the [`Samples`] of this pass alone; [`Samples::merge`] adds them to those of earlier passes, and
//! [`Samples::to_frame`] gives what the denoiser works on. The crate `stein-stub` has a small path tracer that stands
//! in for a renderer.
//!
//! [`adapt`] is the loop: draw, denoise, estimate the error, hand out the next samples by it as a [`SamplingMap`] says.
//! The crate `stein-exr` carries such a map to a renderer in another process, as a file.

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
