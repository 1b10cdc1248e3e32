//! Recording commands: dispatches, uploads and the buffers between them.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use super::bindings::{Around, Bindings, SlotKind, Value};
use super::device::Gpu;
use super::encode::{Bound, Dispatch, Op, encode};
use super::kernel::Kernel;
use super::pool::Buffer;
use super::reach::propagate;
use super::run::Run;
use super::shader::Definitions;
use super::{human_bytes, lock};
use crate::error::{DeviceCause, Error, RequestCause, Result};

/// Number of dispatches in one submission. Drivers kill a submission that runs for seconds, and a program can only wait
/// for a submission as a whole. Submitting costs tens of microseconds.
const DISPATCHES_PER_SUBMISSION: usize = 32;

/// Bytes of staging memory that uploads may hold before they are submitted and waited for.
const STAGED_BYTES: u64 = 64 << 20;

/// Largest number of values in one piece of an upload that the host makes piece by piece.
const PIECE_VALUES: usize = (8 << 20) / 4;

/// Size of the buffer that poison is copied from, in bytes.
const POISON_BYTES: u64 = 1 << 20;

/// Pace of a recorder that shares the device with somebody who waits for it, such as a window. The result does not
/// depend on it, to the bit.
#[derive(Clone, Debug)]
pub struct Pace {
    /// Number of dispatches that are submitted together, at least 1. The recorder waits for them before it goes on, so
    /// that commands that others submit meanwhile come next.
    pub dispatches: usize,
    /// Flag that cancels: once it is true, the recorder ends with [`Error::Cancelled`] after the dispatches that are
    /// submitted already.
    pub cancelled: Arc<AtomicBool>,
}

/// A list of commands that execute in the order in which they were recorded.
///
/// A recorder from [`Gpu::record`] submits itself every few dozen dispatches, and the rest in [`Recorder::submit`]. A
/// recorder from [`Gpu::record_whole`] touches no queue, and [`Recorder::encode_into`] puts all commands into the
/// caller's encoder. If a recorder is dropped without either call, the commands not yet submitted are lost.
#[derive(Debug)]
pub struct Recorder {
    gpu: Gpu,
    run: Run,
    id: u64,
    ops: Vec<Op>,
    /// The uniform structs of all dispatches in `ops`, at the offsets that their bindings name.
    uniforms: Vec<u8>,
    dispatches: usize,
    staged_bytes: u64,
    whole: bool,
    has_submitted: bool,
    pace: Option<Pace>,
    /// Name of the step that the next dispatches belong to; times are summed under this name.
    step: Arc<str>,
}

impl Gpu {
    /// Starts recording commands for this device's own queue, in a run of their own.
    pub fn record(&self) -> Recorder {
        self.record_in(&Run::default())
    }

    /// Starts recording commands that stay together until [`Recorder::encode_into`] or [`Recorder::submit`].
    pub fn record_whole(&self) -> Recorder {
        self.record_whole_in(&Run::default())
    }

    /// As [`Gpu::record_whole`], as part of `run`.
    pub fn record_whole_in(&self, run: &Run) -> Recorder {
        Recorder::new(self, run, true)
    }
}

impl Recorder {
    pub(super) fn new(gpu: &Gpu, run: &Run, whole: bool) -> Self {
        Self {
            gpu: gpu.clone(),
            run: run.clone(),
            id: run.pool(gpu).open_recorder(),
            ops: Vec::new(),
            uniforms: Vec::new(),
            dispatches: 0,
            staged_bytes: 0,
            whole,
            has_submitted: false,
            pace: None,
            step: Arc::from(""),
        }
    }

    /// Shares the device at this pace from here on.
    pub fn set_pace(&mut self, pace: Pace) {
        self.pace = Some(pace);
    }

    /// Returns the device that the commands are recorded for.
    pub fn gpu(&self) -> &Gpu {
        &self.gpu
    }

    /// Returns whether the commands belong to a [dry run](Run::dry) and will not execute. The caller may then leave out
    /// a dispatch if another one writes the same buffers and reads at least as far around each pixel.
    pub fn is_dry(&self) -> bool {
        self.run.is_dry()
    }

    /// Names the step that the dispatches from here on belong to, so that [`Gpu::step_timings`] can tell the uses of
    /// one stage apart.
    pub fn begin_step(&mut self, name: &str) {
        self.step = Arc::from(name);
    }

    /// Names the step that the dispatches of `record` belong to, and returns to the step before.
    pub(crate) fn in_step<T>(&mut self, name: &str, record: impl FnOnce(&mut Self) -> T) -> T {
        let before = std::mem::replace(&mut self.step, Arc::from(name));
        let result = record(self);
        self.step = before;
        result
    }

    /// Takes a storage buffer of at least `bytes` bytes from the pool. Its content is arbitrary: zeros, another stage's
    /// image, or poison.
    ///
    /// Drop it after recording its last use, not after that use has executed: the next `take` may hand out the same
    /// memory.
    ///
    /// # Errors
    /// [`Error::Device`] where a kernel cannot see that many bytes, or the device has no memory left.
    pub fn take(&mut self, label: &str, bytes: u64) -> Result<Buffer> {
        let buffer = self.take_plain(label, bytes)?;
        if self.gpu.inner.options.poison && !self.is_dry() {
            self.poison(&buffer)?;
        }
        Ok(buffer)
    }

    fn take_plain(&mut self, label: &str, bytes: u64) -> Result<Buffer> {
        let (gpu, run, id) = (self.gpu.clone(), self.run.clone(), self.id);
        gpu.take_for(id, &run, label, bytes, || {
            // Idle buffers are given back to the driver only after the commands that use them.
            self.flush()?;
            if self.is_dry() { Ok(()) } else { self.gpu.wait() }
        })
        .inspect(|buffer| buffer.mark_used(self.id))
    }

    /// Takes a storage buffer that holds `data`.
    ///
    /// # Errors
    /// As [`Recorder::take`].
    pub fn upload(&mut self, label: &str, data: &[f32]) -> Result<Buffer> {
        self.upload_bytes(label, bytemuck::cast_slice(data))
    }

    /// Takes a storage buffer that holds `data`, padded to a multiple of four bytes.
    ///
    /// # Errors
    /// As [`Recorder::take`].
    pub fn upload_bytes(&mut self, label: &str, data: &[u8]) -> Result<Buffer> {
        let buffer = self.take_plain(label, data.len() as u64)?;
        if self.is_dry() {
            return Ok(buffer);
        }
        self.stage(data, &buffer, 0, buffer.bytes())?;
        Ok(buffer)
    }

    /// Takes a storage buffer of `values` values and fills it piece by piece, so that the host never holds a second
    /// copy of all values. Calls `fill` with the position of each piece, counted in values, and with the piece, which
    /// holds zeros. Each piece but the last is a multiple of four values long. A dry run fills nothing.
    ///
    /// # Errors
    /// As [`Recorder::take`].
    pub fn upload_with(
        &mut self,
        label: &str,
        values: usize,
        mut fill: impl FnMut(usize, &mut [f32]),
    ) -> Result<Buffer> {
        let buffer = self.take_plain(label, 4 * values as u64)?;
        if self.is_dry() {
            return Ok(buffer);
        }
        let mut piece = vec![0.0; PIECE_VALUES.min(values)];
        for first in (0..values).step_by(PIECE_VALUES) {
            let piece = &mut piece[..PIECE_VALUES.min(values - first)];
            piece.fill(0.0);
            fill(first, piece);
            self.stage(bytemuck::cast_slice(piece), &buffer, 4 * first as u64, size_of_val(piece) as u64)?;
        }
        Ok(buffer)
    }

    /// Copies `data`, padded to `bytes` bytes, to a buffer, from the byte `to_offset` on.
    fn stage(&mut self, data: &[u8], buffer: &Buffer, to_offset: u64, bytes: u64) -> Result<()> {
        let staging = self.gpu.filled(buffer.label(), wgpu::BufferUsages::COPY_SRC, data, bytes)?;
        buffer.mark_used(self.id);
        self.ops.push(Op::Copy { from: staging, to: buffer.wgpu().clone(), to_offset, bytes });
        self.staged_bytes += bytes;
        if self.staged_bytes > STAGED_BYTES && !self.whole {
            self.flush()?;
            self.gpu.wait()?;
        }
        Ok(())
    }

    /// Records a stage in `shaders/` with these definitions over `invocations` in x, y and z. Each number is rounded up
    /// to whole workgroups, so the shader must ignore invocations beyond its extent.
    ///
    /// # Errors
    /// As [`Gpu::kernel`] and [`Recorder::dispatch_kernel`].
    pub fn dispatch<B: Bindings>(
        &mut self,
        stage: &str,
        definitions: Definitions,
        bindings: &B,
        invocations: [u32; 3],
    ) -> Result<()> {
        let kernel = if self.is_dry() { None } else { Some(self.gpu.kernel::<B>(stage, definitions)?) };
        self.record(kernel.as_ref(), bindings, invocations)
    }

    /// As [`Recorder::dispatch`], for a kernel that is already built.
    ///
    /// # Errors
    /// [`Error::Shader`] where the kernel was built for other bindings or a written buffer is bound twice;
    /// [`Error::Device`] where the grid exceeds the adapter's limit or, when this dispatch completes a batch, the
    /// device fails.
    pub fn dispatch_kernel<B: Bindings>(
        &mut self,
        kernel: &Arc<Kernel>,
        bindings: &B,
        invocations: [u32; 3],
    ) -> Result<()> {
        self.record(Some(kernel), bindings, invocations)
    }

    /// Records a kernel; a dry run needs none.
    fn record<B: Bindings>(&mut self, kernel: Option<&Arc<Kernel>>, bindings: &B, invocations: [u32; 3]) -> Result<()> {
        let Some(kernel) = kernel.filter(|_| !self.is_dry()) else {
            propagate(B::SLOTS, &bindings.values());
            return Ok(());
        };
        let failure = |problem: String| Error::Shader { stage: kernel.stage().into(), problem };
        if kernel.slots != B::SLOTS {
            return Err(failure("it is dispatched with bindings of another stage".into()));
        }
        let groups: [u32; 3] = std::array::from_fn(|axis| invocations[axis].div_ceil(kernel.workgroup_size()[axis]));
        self.check_groups(kernel, groups)?;
        if groups.contains(&0) {
            return Ok(());
        }

        let values = bindings.values();
        let mut bound = Vec::with_capacity(values.len());
        for ((slot, place), value) in kernel.slots.iter().zip(&kernel.places).zip(&values) {
            match (place, value) {
                (None, Value::Absent) => {}
                (Some(place), Value::Uniform(members)) => {
                    let offset = self.append_uniform(place.uniform_bytes, &place.offsets, members);
                    bound.push(Bound::Uniform {
                        binding: place.binding,
                        offset,
                        bytes: u64::from(place.uniform_bytes),
                    });
                }
                (Some(place), Value::Buffer(Around { buffer, .. })) => {
                    buffer.mark_used(self.id);
                    bound.push(Bound::Storage {
                        binding: place.binding,
                        buffer: buffer.wgpu().clone(),
                        bytes: buffer.bytes(),
                    });
                }
                (Some(_), Value::Absent) => {
                    return Err(failure(format!("the shader reads '{}', but nothing is bound to it", slot.name)));
                }
                (None, _) => {
                    return Err(failure(format!(
                        "'{}' is bound, but these definitions remove it from the shader",
                        slot.name
                    )));
                }
            }
        }
        if let Some((name, other)) = aliased(kernel, &values) {
            return Err(failure(format!("the same buffer is bound to '{name}', which is written, and to '{other}'")));
        }
        self.ops.push(Op::Dispatch(Dispatch {
            kernel: Arc::clone(kernel),
            step: Arc::clone(&self.step),
            bound,
            groups,
        }));
        self.dispatches += 1;
        let most = self.pace.as_ref().map_or(DISPATCHES_PER_SUBMISSION, |pace| pace.dispatches);
        if self.dispatches >= most { self.flush() } else { Ok(()) }
    }

    /// Hands the commands recorded so far to the device, which starts on them. Does nothing in a recorder from
    /// [`Gpu::record_whole`].
    ///
    /// # Errors
    /// [`Error::Device`] where the device failed; [`Error::Cancelled`] where the [`Pace`] was cancelled.
    pub fn flush(&mut self) -> Result<()> {
        if self.whole { Ok(()) } else { self.hand_over() }
    }

    /// Hands all commands to the device. Does not wait for them, except under a [`Pace`]; [`Gpu::wait`] and
    /// [`Gpu::read`] wait.
    ///
    /// # Errors
    /// [`Error::Device`] where the device failed; [`Error::Cancelled`] where the [`Pace`] was cancelled.
    pub fn submit(mut self) -> Result<()> {
        self.hand_over()
    }

    /// Puts all commands into a caller's encoder; the device's queue is not touched. Encoders must be submitted in the
    /// order in which they were filled, because buffers dropped before one of them may be used again in the next.
    ///
    /// # Errors
    /// [`Error::Request`] where commands are submitted already because the recorder is not from [`Gpu::record_whole`];
    /// [`Error::Device`] where the device failed.
    pub fn encode_into(mut self, encoder: &mut wgpu::CommandEncoder) -> Result<()> {
        if self.has_submitted {
            return Err(Error::Request(RequestCause::Misuse {
                problem: "part of these commands was submitted already, so they cannot go into an encoder as a whole"
                    .into(),
                change: "record them with `Gpu::record_whole`",
            }));
        }
        self.gpu.check()?;
        let (ops, uniforms) = (std::mem::take(&mut self.ops), std::mem::take(&mut self.uniforms));
        let encoded = self.gpu.guarded(|| encode(&self.gpu, &self.run, &ops, &uniforms, encoder));
        encoded.map_err(|error| self.gpu.out_of_memory("the commands", &error))?
    }

    fn hand_over(&mut self) -> Result<()> {
        if self.is_dry() {
            return Ok(());
        }
        if self.ops.is_empty() {
            return self.gpu.check();
        }
        self.gpu.check()?;
        let (ops, uniforms) = (std::mem::take(&mut self.ops), std::mem::take(&mut self.uniforms));
        (self.dispatches, self.staged_bytes, self.has_submitted) = (0, 0, true);
        let inner = &self.gpu.inner;
        let submitted = self.gpu.guarded(|| {
            let mut encoder =
                inner.device.create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some("stein") });
            encode(&self.gpu, &self.run, &ops, &uniforms, &mut encoder)?;
            inner.queue.submit([encoder.finish()]);
            Ok(())
        });
        drop(ops);
        inner.pool.close_recorder(self.id);
        self.id = inner.pool.open_recorder();
        submitted.map_err(|error| self.gpu.out_of_memory("the commands", &error))??;
        let Some(pace) = &self.pace else {
            // Polls without waiting: frees the resources of finished commands, and lets a lost device become known.
            return self.gpu.poll(wgpu::PollType::Poll);
        };
        self.gpu.wait()?;
        if pace.cancelled.load(Ordering::Relaxed) { Err(Error::Cancelled) } else { Ok(()) }
    }

    fn check_groups(&self, kernel: &Kernel, groups: [u32; 3]) -> Result<()> {
        let limit = self.gpu.max_workgroups();
        match groups.iter().position(|count| *count > limit) {
            None => Ok(()),
            Some(axis) => Err(Error::Device(DeviceCause::TooManyWorkgroups {
                stage: kernel.stage().into(),
                groups: groups[axis],
                axis: ['x', 'y', 'z'][axis],
                limit,
            })),
        }
    }

    /// Writes the members at the offsets that the shader declares, and returns the offset of the struct, in bytes.
    fn append_uniform(&mut self, bytes: u32, offsets: &[u32], members: &[&[u8]]) -> u64 {
        let limits = &self.gpu.inner.limits;
        let alignment =
            limits.min_uniform_buffer_offset_alignment.max(limits.min_storage_buffer_offset_alignment) as usize;
        let start = self.uniforms.len().next_multiple_of(alignment);
        self.uniforms.resize(start + bytes as usize, 0);
        for (offset, member) in offsets.iter().zip(members) {
            let at = start + *offset as usize;
            self.uniforms[at..at + member.len()].copy_from_slice(member);
        }
        start as u64
    }

    fn poison(&mut self, buffer: &Buffer) -> Result<()> {
        let mut source = lock(&self.gpu.inner.poison_source);
        let poison = match source.as_ref() {
            Some(poison) => poison.clone(),
            None => {
                let bits = vec![Gpu::POISON; POISON_BYTES as usize / 4];
                let poison = self.gpu.filled(
                    "poison",
                    wgpu::BufferUsages::COPY_SRC,
                    bytemuck::cast_slice(&bits),
                    POISON_BYTES,
                )?;
                source.insert(poison).clone()
            }
        };
        drop(source);
        for offset in (0..buffer.bytes()).step_by(POISON_BYTES as usize) {
            let bytes = POISON_BYTES.min(buffer.bytes() - offset);
            self.ops.push(Op::Copy { from: poison.clone(), to: buffer.wgpu().clone(), to_offset: offset, bytes });
        }
        Ok(())
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        self.run.pool(&self.gpu).close_recorder(self.id);
    }
}

impl Gpu {
    /// Makes a buffer of `bytes` bytes that begins with `data`. The data is written through a mapping, so no queue is
    /// involved.
    pub(super) fn filled(
        &self,
        label: &str,
        usage: wgpu::BufferUsages,
        data: &[u8],
        bytes: u64,
    ) -> Result<wgpu::Buffer> {
        let size = bytes.next_multiple_of(wgpu::COPY_BUFFER_ALIGNMENT);
        let description = wgpu::BufferDescriptor { label: Some(label), size, usage, mapped_at_creation: true };
        let filled = self.guarded(|| {
            let buffer = self.inner.device.create_buffer(&description);
            let mut view = buffer.get_mapped_range_mut(..)?;
            view.slice(..data.len()).copy_from_slice(data);
            drop(view);
            buffer.unmap();
            Ok::<_, wgpu::MapRangeError>(buffer)
        });
        match filled {
            Ok(Ok(buffer)) => Ok(buffer),
            Err(error) => Err(self.out_of_memory(&format!("staging {} for '{label}'", human_bytes(bytes)), &error)),
            Ok(Err(error)) => {
                // A lost device makes buffers that cannot be mapped, and gives the reason only when polled.
                self.poll(wgpu::PollType::Poll)?;
                Err(self.defect(&format!("{} of staging for '{label}' cannot be written: {error}", human_bytes(bytes))))
            }
        }
    }
}

/// Finds a written slot whose buffer is bound a second time, and returns the names of both slots. The device gives no
/// order between two such accesses.
fn aliased(kernel: &Kernel, values: &[Value<'_>]) -> Option<(&'static str, &'static str)> {
    let buffer = |index: usize| match values[index] {
        Value::Buffer(Around { buffer, .. }) => Some(buffer.wgpu()),
        _ => None,
    };
    for (written, slot) in kernel.slots.iter().enumerate().filter(|(_, slot)| slot.kind == SlotKind::Write) {
        let other = (0..values.len())
            .find(|other| *other != written && buffer(*other).is_some() && buffer(*other) == buffer(written));
        if let Some(other) = other {
            return Some((slot.name, kernel.slots[other].name));
        }
    }
    None
}
