//! Time that each stage takes, measured by the device.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, channel};
use std::sync::{Arc, Mutex};

use serde::Serialize;

use super::device::Gpu;
use super::lock;
use super::run::Run;
use crate::error::Result;

/// Number of dispatches whose times are read back together.
const DISPATCHES_PER_BATCH: u32 = 64;

const BATCH_BYTES: u64 = DISPATCHES_PER_BATCH as u64 * 2 * wgpu::QUERY_SIZE as u64;

/// The time of all dispatches of one stage.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StageTime {
    /// The stage, named as its file in `shaders/`.
    pub stage: String,
    /// Sum over its dispatches, in seconds on the device.
    pub seconds: f64,
    /// Number of its dispatches.
    pub dispatches: usize,
}

/// The time of all dispatches of one stage in one step.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StepTime {
    /// Name of the step, as given to [`Recorder::begin_step`](super::Recorder::begin_step); empty if none was given.
    pub step: String,
    /// Stage and its time in this step.
    #[serde(flatten)]
    pub time: StageTime,
}

/// Returns the time of each stage in all steps together, in the order of first use.
pub(crate) fn sum_over_steps(steps: &[StepTime]) -> Vec<StageTime> {
    let mut stages: Vec<StageTime> = Vec::new();
    for StepTime { time, .. } in steps {
        match stages.iter_mut().find(|stage| stage.stage == time.stage) {
            Some(stage) => {
                stage.seconds += time.seconds;
                stage.dispatches += time.dispatches;
            }
            None => stages.push(time.clone()),
        }
    }
    stages
}

pub(super) struct Timing {
    available: bool,
    on: AtomicBool,
    nanoseconds_per_tick: f64,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    pending: Vec<(Batch, Receiver<bool>)>,
    free: Vec<Arc<Queries>>,
}

struct Queries {
    set: wgpu::QuerySet,
    resolved: wgpu::Buffer,
    readback: wgpu::Buffer,
}

/// The timestamps of a few dispatches: two each, before and after.
pub(super) struct Batch {
    run: Run,
    queries: Arc<Queries>,
    /// Step and stage of each dispatch.
    dispatches: Vec<(Arc<str>, String)>,
}

impl Batch {
    pub(super) fn is_full(&self) -> bool {
        self.dispatches.len() == DISPATCHES_PER_BATCH as usize
    }

    /// Adds a dispatch, and returns where it writes its timestamps.
    pub(super) fn next(&mut self, step: &Arc<str>, stage: &str) -> wgpu::ComputePassTimestampWrites<'_> {
        let first = self.dispatches.len() as u32 * 2;
        self.dispatches.push((Arc::clone(step), stage.to_owned()));
        wgpu::ComputePassTimestampWrites {
            query_set: &self.queries.set,
            beginning_of_pass_write_index: Some(first),
            end_of_pass_write_index: Some(first + 1),
        }
    }
}

impl Timing {
    pub(super) fn new(available: bool, nanoseconds_per_tick: f32) -> Self {
        Self {
            available,
            on: AtomicBool::new(false),
            nanoseconds_per_tick: nanoseconds_per_tick.into(),
            state: Mutex::default(),
        }
    }

    pub(super) fn is_on(&self) -> bool {
        self.on.load(Ordering::Relaxed)
    }

    pub(super) fn batch(&self, device: &wgpu::Device, run: &Run) -> Batch {
        let queries = lock(&self.state).free.pop().unwrap_or_else(|| {
            let count = DISPATCHES_PER_BATCH * 2;
            let set = device.create_query_set(&wgpu::QuerySetDescriptor {
                label: Some("times"),
                ty: wgpu::QueryType::Timestamp,
                count,
            });
            let buffer = |usage| {
                device.create_buffer(&wgpu::BufferDescriptor {
                    label: Some("times"),
                    size: BATCH_BYTES,
                    usage,
                    mapped_at_creation: false,
                })
            };
            let resolved = buffer(wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC);
            let readback = buffer(wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST);
            Arc::new(Queries { set, resolved, readback })
        });
        Batch { run: run.clone(), queries, dispatches: Vec::new() }
    }

    /// Encodes the readback of the timestamps of `batch`; it runs once somebody submits `encoder`.
    pub(super) fn resolve(&self, batch: Batch, encoder: &mut wgpu::CommandEncoder) {
        let Queries { set, resolved, readback } = &*batch.queries;
        let count = batch.dispatches.len() as u32 * 2;
        encoder.resolve_query_set(set, 0..count, resolved, 0);
        encoder.copy_buffer_to_buffer(resolved, 0, readback, 0, BATCH_BYTES);
        let (sender, receiver) = channel();
        encoder.map_buffer_on_submit(readback, wgpu::MapMode::Read, .., move |mapped| {
            // The receiver is gone if the device is gone.
            let _ = sender.send(mapped.is_ok());
        });
        for (step, stage) in &batch.dispatches {
            batch.run.time(step, stage, |_| {});
        }
        lock(&self.state).pending.push((batch, receiver));
    }

    /// Adds up the timestamps that have arrived.
    fn collect(&self) {
        let State { pending, free } = &mut *lock(&self.state);
        pending.retain(|(batch, receiver)| {
            let Ok(mapped) = receiver.try_recv() else { return true };
            let view = if mapped { batch.queries.readback.get_mapped_range(..).ok() } else { None };
            if let Some(view) = view {
                let ticks: Vec<u64> = view.chunks_exact(8).map(bytemuck::pod_read_unaligned).collect();
                drop(view);
                batch.queries.readback.unmap();
                for ((step, stage), pair) in batch.dispatches.iter().zip(ticks.chunks_exact(2)) {
                    batch.run.time(step, stage, |time| {
                        time.seconds += pair[1].saturating_sub(pair[0]) as f64 * self.nanoseconds_per_tick * 1e-9;
                        time.dispatches += 1;
                    });
                }
                free.push(Arc::clone(&batch.queries));
            }
            false
        });
    }
}

impl Gpu {
    /// Turns the timing of stages on or off for dispatches that are encoded from now on. Returns whether it is on: an
    /// adapter without timestamps stays off.
    pub fn set_timing(&self, on: bool) -> bool {
        let timing = &self.inner.timing;
        timing.on.store(on && timing.available, Ordering::Relaxed);
        timing.is_on()
    }

    /// Adds up the timestamps that have arrived, for all runs. Returns whether the adapter has timestamps. Waits for
    /// the device.
    pub(super) fn collect_timings(&self) -> Result<bool> {
        if self.inner.timing.available {
            self.wait()?;
            self.inner.timing.collect();
        }
        Ok(self.inner.timing.available)
    }
}
