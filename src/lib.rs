//! Stein: a GPU denoiser for Monte Carlo renderings that knows its own error.
//!
//! # The house
//! Each arrow is a function, and only that function makes its output type. Nothing flows back.
//!
//! ```text
//! EXR files -> BufferSet  (buffers: what the files said)
//!           -> Frame      (frame: finite, one extent, meaning normalised, repairs counted)
//!           -> Plan       (method: what of the method this frame needs, and why not the rest)
//!           -> GpuFrame   (method: uploaded, colour at the order of 1)
//!           -> GpuEstimate (method: one straight function of the stages each)
//!                dfc: prefiltered features -> spikes -> variances of the pixel mean -> candidates -> SURE -> selection -> blend -> second pass
//!                nlm: spikes -> variances of the pixel mean -> halves -> each filtered with the weights of the other -> their difference
//!                gem: spikes -> variances of the pixel mean -> scales -> stopping maps -> the finest that stops
//!           -> Estimate   (denoiser: colour, halves, estimated error, intermediates) -> EXR file
//! ```
//!
//! | room | holds | knows |
//! | --- | --- | --- |
//! | [`aside`] | files on their way to their names | nothing |
//! | [`text`] | text files; names, paths and lists in messages | nothing |
//! | [`buffers`] | OpenEXR files as buffer sets, which layer is what, writing | [`image`], `aside` |
//! | [`frame`] | a buffer set whose meaning is settled | `buffers` |
//! | [`gpu`] | device, kernels, recording, pool, timing, compiled pipelines on disk | nothing of denoising |
//! | `host_memory` | how much memory of the computer is left, vectors that may fail | nothing |
//! | [`stage`] | one function per shader, called like its file | `gpu` |
//! | [`parameters`] | parameters that describe themselves | nothing |
//! | [`method`] | the methods: parameters and a straight function | `stage`, never the GPU interface |
//! | [`sampling`] | where the next samples go, what a renderer implements, the adaptive loop, a small renderer | the denoiser's public face, `buffers` |
//!
//! One word names a stage everywhere: shader file, Rust function, reference function, timing label.
//!
//! # What is left out
//! Before anything runs, a [`Plan`](method::Plan) is made of the parameters, of what is wanted and of a look at the frame; the methods ask it at every step, so that it is what happens.
//! [`Denoiser::with_everything`] runs the rest as well, to compare: the result is the same to the bit, or within bounds that are stated where the plan is made.
//!
//! # Half buffers
//! Halves travel as the mean and one *half spread*, `(A − B)·√(n_A·n_B)/n`: zero in expectation, its square the two-buffer estimate of the variance of the mean, and with
//! fixed weights it is filtered like the mean. So the factor of two between the variance of a half and of the mean is settled once, where the spread is made.
//!
//! # Where to start
//! [`Denoiser`] for frames from files; [`Denoiser::record`] for a renderer that keeps its buffers on the GPU; [`Denoiser::kernels`] for those who wonder about a pixel.

pub mod aside;
mod denoiser;
pub mod error;
pub mod frame;
pub mod gpu;
pub mod host_memory;
pub mod image;
pub mod method;
pub mod parameters;
pub mod sampling;
pub mod stage;
pub mod text;

pub use denoiser::{Denoiser, Estimate, Layer, Options};
pub use error::{Error, Result};
pub use frame::Frame;
pub use gpu::Gpu;
pub use image::{Extent, Image};
pub use method::kernels::{self, FilterKernel, Kernels};
pub use method::{DfcParams, GemParams, Method, NlmParams, Preset};
