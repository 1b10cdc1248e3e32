//! Stein: a GPU denoiser for Monte Carlo renderings that knows its own error.
//!
//! # The house
//! Each arrow is a step of the work. Nothing flows back.
//!
//! ```text
//! RawSignals -> Frame       (frame: finite, one extent, meaning normalised, repairs counted)
//!            -> Plan        (method: a typed plan per method; each step runs or is left out, with the reason)
//!            -> FrameInput  (method: uploaded, colour at the order of 1; a renderer hands over a GpuFrame instead)
//!            -> GpuEstimate (method: each method is one straight function of stages)
//!                 dfc: variances -> prefiltered features -> spikes -> candidates -> SURE -> selection -> blend
//!                      -> second pass
//!                 nlm: variances -> spikes -> halves -> each filtered with the weights of the other -> difference
//!                 gem: variances -> spikes -> scales -> stopping maps -> the finest scale that stops
//!            -> Estimate    (denoiser: colour, halves, estimated error, intermediates)
//! ```
//!
//! | room | holds | knows |
//! | --- | --- | --- |
//! | [`text`] | text files; names, paths, lists and numbers in messages; templates of commands | nothing |
//! | [`error`] | failures: place, cause with its data, remedies | the types that causes name |
//! | [`host_memory`] | free memory of the computer; vectors whose allocation may fail | nothing but errors |
//! | [`image`] | planes of pixels on the host | [`host_memory`] |
//! | [`frame`] | frames: the only input of the denoiser | [`image`] |
//! | [`gpu`] | device, kernels, recording, dry runs, pool, timing, compiled pipelines on disk | nothing of denoising |
//! | [`stage`] | one function per shader, named like its file; candidate filters as data | `gpu` |
//! | [`parameters`] | parameters that describe themselves | nothing of filters |
//! | [`method`] | the methods: parameters, plan and a straight function each | `stage`, never the GPU interface |
//! | [`sampling`] | where the next samples go, the trait that a renderer implements, the adaptive loop | the denoiser |
//!
//! Other crates build on this one: `stein-exr` (OpenEXR files), `stein-metric` (error measures), `stein-stub` (a small
//! path tracer); on these, `stein-bench` (measures and compares) and `stein-selftest` (extreme frames and their
//! checks); on all of them, `stein-cli` (the command line) and `stein-viewer`. `stein-reference` holds every stage
//! again in plain float64 loops and knows nothing of this crate; `stein-twin` converts frames and parameters for it.
//!
//! A stage has one name everywhere: shader file, Rust function, reference function, timing label.
//!
//! # Candidates
//! The candidates of DFC are a list of filters ([`stage::candidate_filter::CandidateFilter`]): how each compares the
//! colour, how it compares the features, and its rival. [`DfcParams::filters`] returns the list: FIRST, SECOND and
//! THIRD of the thesis, then [`DfcParams::further`]. Filters that have enough in common share one pass over the window.
//!
//! # What is left out
//! A [`Plan`](method::Plan) is made before anything runs, from the parameters, the requested results and an analysis of
//! the frame. Each method has its own type of plan with one field per step, and asks it at every step.
//! [`Denoiser::with_everything`] also runs the steps that the plan leaves out, for comparison: the result is the same
//! to the bit, or within the bounds that the plan of the method states.
//!
//! # Dry runs
//! A method is described once, by its function. In a [dry run](gpu::Run::dry) buffers have only a size and a reach, and
//! dispatches only add up reaches. So the method's own function yields its peak memory and its halo, and the cut into
//! strips follows from them. [`Denoiser::requirements`] returns memory, halo and strips for a frame, and
//! [`Denoiser::reach`] the halo for any frame.
//!
//! # Half buffers
//! Halves travel as the mean and one *half spread*, `(A − B)·√(n_A·n_B)/n`. Its expectation is zero, its square is the
//! two-buffer estimate of the variance of the mean, and with fixed weights it is filtered like the mean. So the factor
//! of two between the variance of a half and that of the mean is settled once, where the spread is made.
//!
//! # Layers along
//! A frame may have a payload ([`Frame::payload`]): light groups, AOVs and alpha. Every filter averages these layers
//! with the weights that the colour has, and every later step does to them what it does to the colour, so that the sum
//! of denoised layers is the denoised sum. [`stage::payload`] holds a stage for each such step. Layers that do not fit
//! into memory together are filtered in rounds, each of which filters the colour anew.
//!
//! # Where to start
//! [`Denoiser::denoise`] takes frames in host memory. [`Denoiser::record`] is for a renderer that keeps its buffers on
//! the GPU; `examples/embed` is one. [`Denoiser::kernels`] returns which neighbours made a pixel.

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

pub use denoiser::{DenoisedLayer, Denoiser, Estimate, Layer, Options, Requirements};
pub use error::{Error, Result};
pub use frame::Frame;
pub use gpu::Gpu;
pub use image::{Extent, Image};
pub use method::kernels::{self, FilterKernel, Kernels};
pub use method::{DfcParams, GemParams, Method, NlmParams, PayloadLeft, Preset};
/// The crates whose types this library's public interface uses.
pub use {glam, wgpu};
