//! Encodes the list of recorded commands into wgpu's command encoder.

use std::sync::Arc;

use super::device::Gpu;
use super::kernel::Kernel;
use super::run::Run;
use super::timing::Batch;
use crate::error::Result;

/// One recorded command. It keeps its buffers alive, so a [`Buffer`](super::Buffer) may be dropped after recording.
#[derive(Debug)]
pub(super) enum Op {
    Copy { from: wgpu::Buffer, to: wgpu::Buffer, to_offset: u64, bytes: u64 },
    Dispatch(Dispatch),
}

#[derive(Debug)]
pub(super) struct Dispatch {
    pub(super) kernel: Arc<Kernel>,
    /// Name of the step that the dispatch belongs to.
    pub(super) step: Arc<str>,
    pub(super) bound: Vec<Bound>,
    pub(super) groups: [u32; 3],
}

/// Buffer that is bound in one dispatch; offsets and sizes are in bytes.
#[derive(Debug)]
pub(super) enum Bound {
    Uniform { binding: u32, offset: u64, bytes: u64 },
    Storage { binding: u32, buffer: wgpu::Buffer, bytes: u64 },
}

/// Encodes `ops`. Dispatches share compute passes unless timing is on; then each has a pass of its own.
pub(super) fn encode(
    gpu: &Gpu,
    of_run: &Run,
    ops: &[Op],
    uniforms: &[u8],
    encoder: &mut wgpu::CommandEncoder,
) -> Result<()> {
    let uniforms = match uniforms {
        [] => None,
        bytes => Some(gpu.filled(
            "uniforms",
            wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::STORAGE,
            bytes,
            bytes.len() as u64,
        )?),
    };
    let timing = &gpu.inner.timing;
    let mut batch: Option<Batch> = None;
    let mut pass: Option<wgpu::ComputePass<'static>> = None;
    for op in ops {
        match op {
            Op::Copy { from, to, to_offset, bytes } => {
                pass = None;
                encoder.copy_buffer_to_buffer(from, 0, to, *to_offset, *bytes);
            }
            Op::Dispatch(dispatch) => {
                let group = bind_group(gpu, dispatch, uniforms.as_ref());
                if timing.is_on() {
                    pass = None;
                    if let Some(full) = batch.take_if(|batch| batch.is_full()) {
                        timing.resolve(full, encoder);
                    }
                    let batch = batch.get_or_insert_with(|| timing.batch(&gpu.inner.device, of_run));
                    let timestamps = batch.next(&dispatch.step, dispatch.kernel.stage());
                    let description = wgpu::ComputePassDescriptor {
                        label: Some(dispatch.kernel.stage()),
                        timestamp_writes: Some(timestamps),
                    };
                    run(&mut encoder.begin_compute_pass(&description), dispatch, &group);
                } else {
                    let begin = || {
                        encoder
                            .begin_compute_pass(&wgpu::ComputePassDescriptor {
                                label: Some("stein"),
                                timestamp_writes: None,
                            })
                            .forget_lifetime()
                    };
                    run(pass.get_or_insert_with(begin), dispatch, &group);
                }
            }
        }
    }
    drop(pass);
    if let Some(batch) = batch {
        timing.resolve(batch, encoder);
    }
    Ok(())
}

fn run(pass: &mut wgpu::ComputePass<'_>, dispatch: &Dispatch, group: &wgpu::BindGroup) {
    let [x, y, z] = dispatch.groups;
    pass.set_pipeline(&dispatch.kernel.pipeline);
    pass.set_bind_group(0, group, &[]);
    pass.dispatch_workgroups(x, y, z);
}

fn bind_group(gpu: &Gpu, dispatch: &Dispatch, uniforms: Option<&wgpu::Buffer>) -> wgpu::BindGroup {
    let entry = |bound| {
        let (binding, buffer, offset, bytes) = match bound {
            &Bound::Uniform { binding, offset, bytes } => (binding, uniforms?, offset, bytes),
            Bound::Storage { binding, buffer, bytes } => (*binding, buffer, 0, *bytes),
        };
        let resource =
            wgpu::BindingResource::Buffer(wgpu::BufferBinding { buffer, offset, size: std::num::NonZero::new(bytes) });
        Some(wgpu::BindGroupEntry { binding, resource })
    };
    let entries: Vec<_> = dispatch.bound.iter().filter_map(entry).collect();
    let description = wgpu::BindGroupDescriptor {
        label: Some(dispatch.kernel.stage()),
        layout: &dispatch.kernel.layout,
        entries: &entries,
    };
    gpu.inner.device.create_bind_group(&description)
}
