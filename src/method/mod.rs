//! The methods: a straight function each, that reads like its chapter. They know the stages, never the GPU interface beneath them.

pub mod dfc;
mod frame;
mod memory;
mod params;

pub use frame::{GpuFeature, GpuFrame, GpuSignal};
pub(crate) use memory::{Strip, strips};
pub use params::{Params, Preset, SecondPass};
