//! State of one run on a device that several runs may share.

use std::fmt;
use std::sync::{Arc, Mutex};

use super::device::Gpu;
use super::lock;
use super::pool::Pool;
use super::record::Recorder;
use super::timing::{StageTime, StepTime, sum_over_steps};
use crate::error::Result;

/// Memory limit, memory use and times of stages, for all recorders of one run. Cheap to clone; clones are the same run.
#[derive(Clone, Default)]
pub struct Run(Arc<Shared>);

#[derive(Default)]
struct Shared {
    /// Limit on memory, in bytes.
    limit: Option<u64>,
    memory: Mutex<Memory>,
    /// Pool of a dry run; `None` for a run on the device.
    dry: Option<Arc<Pool>>,
    /// Times of stages in steps, in the order of first use.
    times: Mutex<Vec<StepTime>>,
}

/// Memory that the buffers of a run take, in bytes.
#[derive(Default)]
struct Memory {
    in_use: u64,
    peak: u64,
    /// Size of the largest buffer, as requested, in bytes.
    largest: u64,
}

impl Run {
    /// Makes a run whose buffers, together with the idle buffers of the device, stay within `memory_limit` bytes, as
    /// far as giving up idle buffers can achieve this. `None` keeps idle buffers as long as the device has memory.
    pub fn new(memory_limit: Option<u64>) -> Self {
        Self(Arc::new(Shared { limit: memory_limit, ..Shared::default() }))
    }

    /// Makes a run without memory and commands. Its buffers have a size and a reach ([`Buffer::reach`]) and no content.
    /// Its dispatches compile and execute nothing: they only extend the reach of the buffers that they write.
    /// [`Run::peak_bytes`] is the peak that the same work has on a device without idle buffers.
    ///
    /// [`Buffer::reach`]: super::Buffer::reach
    pub fn dry(memory_limit: Option<u64>) -> Self {
        Self(Arc::new(Shared { limit: memory_limit, dry: Some(Arc::default()), ..Shared::default() }))
    }

    pub(super) fn is_dry(&self) -> bool {
        self.0.dry.is_some()
    }

    /// Returns the pool that buffers of this run come from.
    pub(super) fn pool<'a>(&'a self, gpu: &'a Gpu) -> &'a Arc<Pool> {
        self.0.dry.as_ref().unwrap_or(&gpu.inner.pool)
    }

    /// Returns the size of the largest buffer that this run requested, in bytes.
    pub(crate) fn largest_bytes(&self) -> u64 {
        lock(&self.0.memory).largest
    }

    /// Returns the largest number of bytes that buffers of this run took. Whenever a new buffer was made, the idle
    /// buffers of the device count as well.
    pub fn peak_bytes(&self) -> u64 {
        lock(&self.0.memory).peak
    }

    /// Returns whether idle buffers must be given up before a buffer of `bytes` bytes is made.
    pub(super) fn is_crowded(&self, idle: u64, bytes: u64) -> bool {
        idle > 0 && self.0.limit.is_some_and(|limit| lock(&self.0.memory).in_use + idle + bytes > limit)
    }

    /// Counts a request for `asked` bytes that a buffer of `bytes` bytes serves, while `idle` bytes of idle buffers
    /// remain beside it.
    pub(super) fn takes(&self, asked: u64, bytes: u64, idle: u64) {
        let memory = &mut lock(&self.0.memory);
        memory.largest = memory.largest.max(asked);
        memory.in_use += bytes;
        memory.peak = memory.peak.max(memory.in_use + idle);
    }

    pub(super) fn gives_back(&self, bytes: u64) {
        lock(&self.0.memory).in_use -= bytes;
    }

    /// Applies `change` to the time of a stage in a step.
    pub(super) fn time(&self, step: &str, stage: &str, change: impl FnOnce(&mut StageTime)) {
        let times = &mut lock(&self.0.times);
        let index = times.iter().position(|time| time.step == step && time.time.stage == stage).unwrap_or_else(|| {
            let time = StageTime { stage: stage.to_owned(), seconds: 0.0, dispatches: 0 };
            times.push(StepTime { step: step.to_owned(), time });
            times.len() - 1
        });
        change(&mut times[index].time);
    }
}

impl fmt::Debug for Run {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Run")
            .field("limit", &self.0.limit)
            .field("peak_bytes", &self.peak_bytes())
            .finish_non_exhaustive()
    }
}

impl Gpu {
    /// Starts recording commands of a run for this device's own queue.
    pub fn record_in(&self, run: &Run) -> Recorder {
        Recorder::new(self, run, false)
    }

    /// Returns the time of each stage in each step of a run so far, in the order of first use; `None` if the adapter
    /// has no timestamps. Waits for the device.
    ///
    /// # Errors
    /// As [`Gpu::wait`].
    pub fn step_timings(&self, run: &Run) -> Result<Option<Vec<StepTime>>> {
        if !self.collect_timings()? {
            return Ok(None);
        }
        Ok(Some(lock(&run.0.times).clone()))
    }

    /// As [`Gpu::step_timings`], summed up over the steps.
    ///
    /// # Errors
    /// As [`Gpu::wait`].
    pub fn timings(&self, run: &Run) -> Result<Option<Vec<StageTime>>> {
        Ok(self.step_timings(run)?.as_deref().map(sum_over_steps))
    }
}
