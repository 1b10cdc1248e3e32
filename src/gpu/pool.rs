//! Pool of storage buffers, which are used again.
//!
//! A denoiser takes and drops dozens of image-sized buffers per frame. Dropping a [`Buffer`] puts it back into the pool
//! of its device; taking one prefers an idle one. Commands execute in the order in which they were recorded, so a
//! buffer that is dropped after its last recorded use may be handed out again *while recording*: what the new owner
//! records runs later. This aliasing keeps the memory peak low. It is valid within one recorder, and between recorders
//! once the earlier one is submitted; a buffer whose last use lies in a recorder that is still open is handed out to
//! that recorder only. Recorders that use the same buffer must be submitted in the order in which they used it.
//!
//! Sizes: a request is rounded up to 256 bytes. The smallest idle buffer that is large enough serves it if at most a
//! quarter of it would stay unused; otherwise a buffer of exactly the rounded size is made.
//!
//! A dry run keeps a pool of its own by the same rules, of buffers that have a size and no memory.

use std::collections::HashSet;
use std::fmt;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

use glam::UVec2;
use serde::Serialize;

use super::device::Gpu;
use super::reach::SharedReach;
use super::run::Run;
use super::{human_bytes, lock};
use crate::error::{DeviceCause, Error, RequestCause, Result};

/// Sizes of pooled buffers are multiples of this many bytes.
const GRANULE: u64 = 256;

/// Size of the smallest buffer that can be bound, in bytes.
const SMALLEST: u64 = 4;

pub(super) const USAGE: wgpu::BufferUsages =
    wgpu::BufferUsages::STORAGE.union(wgpu::BufferUsages::COPY_SRC).union(wgpu::BufferUsages::COPY_DST);

/// A storage buffer on the device. Dropping it returns it to the pool.
pub struct Buffer {
    memory: Memory,
    bytes: u64,
    label: String,
    /// Number of the recorder that used the buffer last.
    last_use: AtomicU64,
    home: Option<Home>,
    /// Distance around a pixel on which the content depends; 0 except in a dry run.
    reach: SharedReach,
}

/// Memory behind a buffer.
#[derive(Clone)]
enum Memory {
    Device(wgpu::Buffer),
    /// The size of a buffer of a dry run, in bytes.
    Dry(u64),
}

impl Memory {
    fn size(&self) -> u64 {
        match self {
            Self::Device(buffer) => buffer.size(),
            Self::Dry(bytes) => *bytes,
        }
    }
}

/// Pool that a buffer returns to, and run that its memory counts for.
struct Home {
    pool: Arc<Pool>,
    run: Run,
}

impl Buffer {
    /// Returns the number of bytes that a kernel sees. For a pooled buffer this is the requested size, at least 4,
    /// rounded up to a multiple of four; for a caller's buffer ([`Gpu::import`]) it is the size of that buffer, rounded
    /// down to a multiple of four.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Returns the label under which the buffer was taken.
    pub fn label(&self) -> &str {
        &self.label
    }

    /// Returns the wgpu buffer, for embedders; it may be larger than [`Buffer::bytes`].
    ///
    /// # Panics
    /// If the buffer belongs to a [dry run](Run::dry), which has no buffers on the device.
    pub fn wgpu(&self) -> &wgpu::Buffer {
        match &self.memory {
            Memory::Device(buffer) => buffer,
            Memory::Dry(_) => panic!("the buffer '{}' belongs to a dry run, which has none on the device", self.label),
        }
    }

    /// Returns the number of columns and rows beside a pixel that its value in this buffer depends on, if the buffer
    /// belongs to a [dry run](Run::dry); otherwise 0.
    pub fn reach(&self) -> UVec2 {
        let reach = self.reach.get();
        reach.front.max(reach.back)
    }

    pub(super) fn is_dry(&self) -> bool {
        matches!(self.memory, Memory::Dry(_))
    }

    pub(super) fn shared_reach(&self) -> &SharedReach {
        &self.reach
    }

    pub(super) fn mark_used(&self, recorder: u64) {
        self.last_use.store(recorder, Ordering::Relaxed);
    }

    pub(super) fn last_use(&self) -> u64 {
        self.last_use.load(Ordering::Relaxed)
    }
}

impl fmt::Debug for Buffer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Buffer '{}' of {} bytes", self.label, self.bytes)
    }
}

impl Drop for Buffer {
    fn drop(&mut self) {
        if let Some(Home { pool, run }) = &self.home {
            let bytes = self.memory.size();
            run.gives_back(bytes);
            let mut state = lock(&pool.0);
            state.usage.bytes_in_use -= bytes;
            state.usage.bytes_idle += bytes;
            state.idle.push(Idle { memory: self.memory.clone(), last_use: self.last_use() });
        }
    }
}

/// Memory of a device that is held in pooled buffers, in bytes. Staging for uploads and readbacks is not counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct MemoryUse {
    /// Bytes in buffers that are handed out.
    pub bytes_in_use: u64,
    /// Bytes in idle buffers, which wait to be used again.
    pub bytes_idle: u64,
}

#[derive(Default)]
pub(super) struct Pool(Mutex<State>);

#[derive(Default)]
struct State {
    idle: Vec<Idle>,
    usage: MemoryUse,
    /// Numbers of the recorders whose commands are not submitted yet.
    open: HashSet<u64>,
    last_recorder: u64,
}

struct Idle {
    memory: Memory,
    last_use: u64,
}

impl Pool {
    pub(super) fn usage(&self) -> MemoryUse {
        lock(&self.0).usage
    }

    pub(super) fn trim(&self) {
        let mut state = lock(&self.0);
        state.usage.bytes_idle = 0;
        let idle = std::mem::take(&mut state.idle);
        drop(state);
        drop(idle);
    }

    /// Returns a number for a new batch of commands, and counts it as open.
    pub(super) fn open_recorder(&self) -> u64 {
        let mut state = lock(&self.0);
        state.last_recorder += 1;
        let id = state.last_recorder;
        state.open.insert(id);
        id
    }

    /// Records that the commands of `recorder` are submitted or discarded.
    pub(super) fn close_recorder(&self, recorder: u64) {
        lock(&self.0).open.remove(&recorder);
    }

    pub(super) fn is_open(&self, recorder: u64) -> bool {
        lock(&self.0).open.contains(&recorder)
    }

    fn take_idle(&self, bytes: u64, recorder: u64) -> Option<Memory> {
        let mut state = lock(&self.0);
        let fits = |idle: &Idle| {
            let size = idle.memory.size();
            size >= bytes
                && size - bytes <= size / 4
                && (idle.last_use == recorder || !state.open.contains(&idle.last_use))
        };
        let best =
            state.idle.iter().enumerate().filter(|(_, idle)| fits(idle)).min_by_key(|(_, idle)| idle.memory.size())?.0;
        let memory = state.idle.swap_remove(best).memory;
        state.usage.bytes_idle -= memory.size();
        state.usage.bytes_in_use += memory.size();
        Some(memory)
    }

    fn count_new(&self, bytes: u64) {
        lock(&self.0).usage.bytes_in_use += bytes;
    }
}

impl Gpu {
    /// Makes a caller's buffer bindable. It is not pooled: dropping the result only drops this reference.
    ///
    /// # Errors
    /// [`Error::Request`] where the buffer lacks `STORAGE` usage; [`Error::Device`] where it is larger than a kernel
    /// can see.
    pub fn import(&self, label: &str, buffer: wgpu::Buffer) -> Result<Buffer> {
        if !buffer.usage().contains(wgpu::BufferUsages::STORAGE) {
            return Err(Error::Request(RequestCause::Misuse {
                problem: format!("the buffer '{label}' was created without STORAGE usage, so no kernel can see it"),
                change: "create it with `wgpu::BufferUsages::STORAGE`",
            }));
        }
        self.check_size(label, buffer.size())?;
        Ok(Buffer {
            bytes: buffer.size() & !3,
            memory: Memory::Device(buffer),
            label: label.into(),
            last_use: AtomicU64::new(0),
            home: None,
            reach: SharedReach::default(),
        })
    }

    /// Takes a pooled buffer for commands of `recorder` in a run. Calls `relieve` at most once, before idle buffers are
    /// given back to the driver: if the run would exceed its limit, or if the first attempt to make a buffer fails.
    pub(super) fn take_for(
        &self,
        recorder: u64,
        run: &Run,
        label: &str,
        bytes: u64,
        relieve: impl FnOnce() -> Result<()>,
    ) -> Result<Buffer> {
        if !run.is_dry() {
            self.check()?;
            self.check_size(label, bytes)?;
        }
        let pool = run.pool(self);
        let bytes = bytes.max(SMALLEST).next_multiple_of(4);
        // A dry run may request more than the largest buffer of the adapter.
        let rounded = bytes.next_multiple_of(GRANULE).min(self.inner.summary.max_buffer_bytes & !3).max(bytes);
        // Bytes of the idle buffers that remain beside a new buffer.
        let mut idle = 0;
        let memory = match pool.take_idle(bytes, recorder) {
            Some(memory) => memory,
            None => {
                let mut relieve = Some(relieve);
                let mut make_room = || match relieve.take() {
                    None => Ok(()),
                    Some(relieve) => {
                        relieve()?;
                        pool.trim();
                        Ok(())
                    }
                };
                idle = pool.usage().bytes_idle;
                if run.is_crowded(idle, rounded) {
                    make_room()?;
                    idle = 0;
                }
                let create = || if run.is_dry() { Ok(Memory::Dry(rounded)) } else { self.create(label, rounded) };
                let made = match create() {
                    Err(_) => {
                        make_room()?;
                        idle = 0;
                        create()
                    }
                    made => made,
                };
                let memory = made.map_err(|error| {
                    self.out_of_memory(
                        &format!("the buffer '{label}' of {} ({bytes} bytes)", human_bytes(bytes)),
                        &error,
                    )
                })?;
                pool.count_new(rounded);
                memory
            }
        };
        run.takes(bytes, memory.size(), idle);
        let home = Some(Home { pool: Arc::clone(pool), run: run.clone() });
        let (label, last_use) = (label.into(), AtomicU64::new(recorder));
        Ok(Buffer { memory, bytes, label, last_use, home, reach: SharedReach::default() })
    }

    fn create(&self, label: &str, size: u64) -> std::result::Result<Memory, wgpu::Error> {
        let description = wgpu::BufferDescriptor { label: Some(label), size, usage: USAGE, mapped_at_creation: false };
        self.guarded(|| Memory::Device(self.inner.device.create_buffer(&description)))
    }

    pub(super) fn check_size(&self, label: &str, bytes: u64) -> Result<()> {
        let limit = self.max_binding_bytes();
        if bytes <= limit {
            return Ok(());
        }
        Err(Error::Device(DeviceCause::BufferTooLarge {
            label: label.into(),
            bytes,
            limit,
            adapter: self.inner.summary.name.clone(),
        }))
    }

    /// Makes the error for people from a failed allocation for `what`: a lack of memory, or else a defect.
    pub(super) fn out_of_memory(&self, what: &str, error: &wgpu::Error) -> Error {
        let wgpu::Error::OutOfMemory { .. } = error else { return self.defect(&error.to_string()) };
        Error::Device(DeviceCause::OutOfMemory {
            what: what.into(),
            bytes_in_use: self.memory().bytes_in_use,
            adapter: self.inner.summary.name.clone(),
        })
    }
}
