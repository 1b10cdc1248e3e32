//! The graphics processor: opening a device, building kernels from WGSL, recording dispatches, reading results back.
//!
//! Nothing here knows of denoising. For each shader file, a consumer writes one function of this form:
//!
//! ```text
//! uniforms! { struct BoxParams { extent: UVec2, radius: u32 } }
//! bindings! { struct BoxBlur<'a> { uniform params: BoxParams, read source, write blurred } }
//!
//! let kernel = gpu.kernel::<BoxBlur>("box_blur", &[])?;
//! let blurred = rec.take("blurred", source.bytes())?;
//! rec.dispatch(&kernel, &BoxBlur { params, source: &source, blurred: &blurred }, [width, height, 1])?;
//! ```
//!
//! Every name, kind and type in these structs is compared with the shader when the kernel is built ([`bindings`]).
//!
//! # House rules for shaders
//! * One entry point, called `main`; its `@workgroup_size` is read from the shader and written nowhere else.
//! * All bindings lie in `@group(0)`; binding numbers appear in the WGSL only.
//! * Release kernels run unchecked: no index clamping, no forced loop bounds, no guard around integer division, no
//!   zeroed workgroup memory. A shader must not rely on any of these; tests run with [`GpuOptions::checked_shaders`] as
//!   well.
//! * Buffers come with whatever was in them before ([`Recorder::take`]): each kernel writes every element of its
//!   outputs.

mod bindings;
mod cache;
mod catalogue;
mod device;
mod encode;
mod kernel;
mod pool;
mod read;
mod record;
mod run;
mod shader;
mod timing;

pub use bindings::{Bindings, Member, Slot, SlotKind, Uniform, Value, ValueType};
pub use cache::SavedPipelines;
pub use device::{AdapterSummary, DeviceChoice, DeviceKind, Gpu, GpuOptions};
pub use kernel::Kernel;
pub use pool::{Buffer, MemoryUse};
pub use record::{Pace, Recorder};
pub use run::Run;
pub use shader::{Definition, Definitions, compose, compose_source, shared_modules, stages};
pub use timing::{StageTime, StepTime};

pub use crate::{bindings, uniforms};

use std::sync::{Mutex, MutexGuard, PoisonError};

/// Locks `mutex`, even if another thread panicked while it held the lock: the data behind these locks is valid between
/// any two statements.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Formats a number of bytes for people, such as `1.5 GiB`.
pub(crate) fn human_bytes(bytes: u64) -> String {
    let units = ["B", "KiB", "MiB", "GiB", "TiB", "PiB", "EiB"];
    let mut value = bytes as f64;
    let mut unit = 0;
    while value >= 1024.0 && unit + 1 < units.len() {
        value /= 1024.0;
        unit += 1;
    }
    if value.fract() < 0.05 { format!("{value:.0} {}", units[unit]) } else { format!("{value:.1} {}", units[unit]) }
}
