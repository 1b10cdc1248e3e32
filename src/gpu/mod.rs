//! The graphics processor: opening a device, building kernels from WGSL, recording dispatches, reading results back.
//!
//! Nothing here knows of denoising. For each shader file, a consumer writes one function of this form:
//!
//! ```text
//! uniforms! { struct BoxParams { extent: UVec2, radius: u32 } }
//! bindings! { struct BoxBlur<'a> { uniform params: BoxParams, around source, write blurred } }
//!
//! let blurred = rec.take("blurred", source.bytes())?;
//! let bound = BoxBlur { params, source: source.within(params.radius), blurred: &blurred };
//! rec.dispatch("box_blur", &[], &bound, [width, height, 1])?;
//! ```
//!
//! `around source` takes `source.within(radius)` in place of `&source`, so that a dry run knows how far the stage looks
//! around each pixel ([`Around`]). Every name, kind and type in these structs is compared with the shader when the
//! kernel is built ([`bindings`]).
//!
//! # House rules for shaders
//! * One entry point, called `main`; its `@workgroup_size` is read from the shader and written nowhere else.
//! * All bindings lie in `@group(0)`; binding numbers appear in the WGSL only.
//! * Release kernels run unchecked: no index clamping, no forced loop bounds, no guard around integer division, no
//!   zeroed workgroup memory. A shader must not rely on any of these; tests run with [`GpuOptions::checked_shaders`] as
//!   well.
//! * A buffer from [`Recorder::take`] has arbitrary content: each kernel writes every element of its outputs.

mod bindings;
mod cache;
mod catalogue;
mod device;
mod encode;
mod kernel;
mod pool;
mod reach;
mod read;
mod record;
mod run;
mod shader;
mod timing;
mod uniform_layout;

pub use bindings::{Around, Bindings, Member, Slot, SlotKind, Uniform, Value, ValueType};
pub use cache::SavedPipelines;
pub use device::{AdapterIdentity, AdapterSummary, DeviceChoice, DeviceKind, Gpu, GpuOptions};
pub use kernel::Kernel;
pub use pool::{Buffer, MemoryUse};
pub use record::{Pace, Recorder};
pub use run::Run;
pub use shader::{Definition, Definitions, compose, compose_source, shared_modules, stages};
pub(crate) use timing::sum_over_steps;
pub use timing::{StageTime, StepTime};
pub use uniform_layout::UniformLayout;

pub use crate::{bindings, uniforms};

use std::sync::{Mutex, MutexGuard, PoisonError};

use crate::text::human_bytes;

/// Locks `mutex`, even if another thread panicked while it held the lock: the data behind these locks is valid between
/// any two statements.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
