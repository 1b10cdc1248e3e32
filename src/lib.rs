//! Stein: a GPU denoiser for Monte Carlo renderings that knows its own error.
//!
//! # The house
//! Each arrow is a function, and only that function makes its output type. Nothing flows back.
//!
//! ```text
//! RawSignals -> Frame       (frame: finite, one extent, meaning normalised, repairs counted)
//!            -> Plan        (method: the steps that this frame needs, and why not the others)
//!            -> GpuFrame    (method: uploaded, colour at the order of 1)
//!            -> GpuEstimate (method: each method is one straight function of stages)
//!                 dfc: variances -> prefiltered features -> spikes -> candidates -> SURE -> selection -> blend -> second pass
//!                 nlm: variances -> spikes -> halves -> each filtered with the weights of the other -> their difference
//!                 gem: variances -> spikes -> scales -> stopping maps -> the finest scale that stops
//!            -> Estimate    (denoiser: colour, halves, estimated error, intermediates)
//! ```
//!
//! | room | holds | knows |
//! | --- | --- | --- |
//! | [`text`] | text files; names, paths, lists and numbers in messages; templates of commands | nothing |
//! | [`host_memory`] | free memory of the computer; vectors whose allocation may fail | nothing |
//! | [`image`] | planes of pixels on the host | nothing |
//! | [`frame`] | frames: the only input of the denoiser | [`image`] |
//! | [`gpu`] | device, kernels, recording, pool, timing, compiled pipelines on disk | nothing of denoising |
//! | [`stage`] | one function per shader, called like its file | `gpu` |
//! | [`parameters`] | parameters that describe themselves | nothing |
//! | [`method`] | the methods: parameters and a straight function | `stage`, never the GPU interface |
//! | [`sampling`] | where the next samples go, the trait that a renderer implements, the adaptive loop | the denoiser |
//!
//! Crates around it, which know this one: `stein-exr` (OpenEXR files), `stein-metric` (error measures), `stein-stub` (a
//! small path tracer). On these stand `stein-bench` (measures and compares) and `stein-selftest` (extreme frames and
//! their checks), and on all of them `stein-cli` (the command line) and `stein-viewer`. `stein-reference` has every
//! stage again in plain float64 loops and knows nothing; `stein-twin` brings frames and parameters into its form.
//!
//! One word names a stage everywhere: shader file, Rust function, reference function, timing label.
//!
//! # What is left out
//! A [`Plan`](method::Plan) is made before anything runs, from the parameters, from the requested results and from a
//! look at the frame. The methods ask it at every step. [`Denoiser::with_everything`] also runs the steps that the plan
//! leaves out, to compare: the result is the same to the bit, or within bounds that stand where the plan is made.
//!
//! # Half buffers
//! Halves travel as the mean and one *half spread*, `(A − B)·√(n_A·n_B)/n`. Its expectation is zero, its square is the
//! two-buffer estimate of the variance of the mean, and with fixed weights it is filtered like the mean. So the factor
//! of two between the variance of a half and that of the mean is settled once, where the spread is made.
//!
//! # Where to start
//! [`Denoiser::denoise`] for frames in host memory; [`Denoiser::record`] for a renderer that keeps its buffers on the
//! GPU (`examples/embed` is one); [`Denoiser::kernels`] tells which neighbours made a pixel.

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

pub use denoiser::{Denoiser, Estimate, Layer, Options, Requirements};
pub use error::{Error, Result};
pub use frame::Frame;
pub use gpu::Gpu;
pub use image::{Extent, Image};
pub use method::kernels::{self, FilterKernel, Kernels};
pub use method::{DfcParams, GemParams, Method, NlmParams, Preset};
/// The version that this library's public face speaks.
pub use {glam, wgpu};
