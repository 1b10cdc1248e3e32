//! Stein: a GPU denoiser for Monte Carlo renderings that knows its own error.

pub mod buffers;
mod denoiser;
pub mod error;
pub mod frame;
pub mod gpu;
pub mod image;
pub mod method;
pub mod metric;
pub mod sampling;
pub mod stage;

pub use denoiser::{Denoiser, Estimate, Layer, Options};
pub use error::{Error, Result};
pub use frame::Frame;
pub use gpu::Gpu;
pub use image::{Extent, Image};
pub use method::{Params, Preset};
