//! Stein: a GPU denoiser for Monte Carlo renderings that knows its own error.
pub mod buffers;
pub mod error;
pub mod frame;
pub mod gpu;
pub mod image;
pub mod metric;
pub mod stage;
