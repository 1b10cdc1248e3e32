//! Adapters and the open device.

use std::any::Any;
use std::collections::HashMap;
use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::cache::PipelineCache;
use super::kernel::{Kernel, KernelKey};
use super::pool::{MemoryUse, Pool};
use super::timing::Timing;
use super::{human_bytes, lock};
use crate::error::{DeviceCause, Error, Result};
use crate::host_memory::FreeMemory;

/// Backends that are good for compute. OpenGL would list the same hardware a second time, with fewer features.
const BACKENDS: wgpu::Backends = wgpu::Backends::VULKAN.union(wgpu::Backends::METAL).union(wgpu::Backends::DX12);

/// Time to wait, after a failure, for the report that the device is lost.
const NEWS_PATIENCE: Duration = Duration::from_secs(2);

/// Number of storage buffers per kernel to request from an adapter; fewer if the adapter has fewer.
const STORAGE_BUFFERS_WANTED: u32 = 16;

/// Kernels count the elements of a buffer in i32, and no element is smaller than four bytes: in a larger buffer an
/// index could wrap around.
const LARGEST_INDEXED_BYTES: u64 = 4 * i32::MAX as u64;

/// Address space that a driver needs to be loaded and opened, in bytes; a software driver includes a compiler. With
/// less, drivers end the process or are not found.
const DRIVER_BYTES: u64 = 320 << 20;

/// Choice of the adapter to open.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum DeviceChoice {
    /// The first of the best kind: discrete, integrated, virtual, software.
    #[default]
    Auto,
    /// The index in [`Gpu::adapters`].
    Index(usize),
    /// The first adapter whose name contains this text, ignoring case.
    Name(String),
}

impl FromStr for DeviceChoice {
    type Err = std::convert::Infallible;

    fn from_str(text: &str) -> std::result::Result<Self, Self::Err> {
        Ok(match text.trim() {
            text if text.is_empty() || text.eq_ignore_ascii_case("auto") => Self::Auto,
            text => text.parse().map_or_else(|_| Self::Name(text.to_owned()), Self::Index),
        })
    }
}

/// Kind of an adapter, best first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum DeviceKind {
    /// A graphics card with memory of its own.
    Discrete,
    /// Graphics in the processor.
    Integrated,
    /// Graphics of a virtual machine.
    Virtual,
    /// Unknown to the driver.
    Other,
    /// A program that emulates a graphics card on the processor's cores.
    Software,
}

impl fmt::Display for DeviceKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Discrete => "discrete",
            Self::Integrated => "integrated",
            Self::Virtual => "virtual",
            Self::Other => "other",
            Self::Software => "software",
        })
    }
}

/// An adapter, described for people and for reports.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct AdapterSummary {
    /// Position in [`Gpu::adapters`]; 0 for a device that a renderer brought along.
    pub index: usize,
    /// Name that the driver reports.
    pub name: String,
    /// Vulkan, Metal or DX12.
    pub backend: String,
    /// Kind of the adapter.
    pub kind: DeviceKind,
    /// Driver and its version.
    pub driver: String,
    /// The largest buffer, in bytes.
    pub max_buffer_bytes: u64,
    /// The largest part of a buffer that a kernel can see, in bytes.
    pub max_binding_bytes: u64,
    /// Number of storage buffers that one kernel can see.
    pub max_storage_buffers: u32,
    /// Whether kernels can be timed on the device.
    pub timestamps: bool,
}

impl AdapterSummary {
    fn new(index: usize, info: &wgpu::AdapterInfo, limits: &wgpu::Limits, features: wgpu::Features) -> Self {
        let driver = format!("{} {}", info.driver, info.driver_info);
        Self {
            index,
            name: info.name.clone(),
            backend: match info.backend {
                wgpu::Backend::Dx12 => "DX12".to_owned(),
                backend => format!("{backend:?}"),
            },
            kind: match info.device_type {
                wgpu::DeviceType::DiscreteGpu => DeviceKind::Discrete,
                wgpu::DeviceType::IntegratedGpu => DeviceKind::Integrated,
                wgpu::DeviceType::VirtualGpu => DeviceKind::Virtual,
                wgpu::DeviceType::Other => DeviceKind::Other,
                wgpu::DeviceType::Cpu => DeviceKind::Software,
            },
            driver: driver.trim().to_owned(),
            max_buffer_bytes: limits.max_buffer_size,
            max_binding_bytes: limits
                .max_storage_buffer_binding_size
                .min(limits.max_buffer_size)
                .min(LARGEST_INDEXED_BYTES)
                & !3,
            max_storage_buffers: limits.max_storage_buffers_per_shader_stage,
            timestamps: features.contains(wgpu::Features::TIMESTAMP_QUERY),
        }
    }
}

/// Parts of an [`AdapterSummary`] by which documents tell on which adapter a run was.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct AdapterIdentity {
    /// Name that the driver reports.
    pub name: String,
    /// The interface: Vulkan, Metal or DX12.
    pub backend: String,
    /// Name of a [`DeviceKind`].
    pub kind: String,
    /// Driver and its version.
    pub driver: String,
    /// Whether stages can be timed.
    pub timestamps: bool,
}

impl From<&AdapterSummary> for AdapterIdentity {
    fn from(summary: &AdapterSummary) -> Self {
        let AdapterSummary { name, backend, kind, driver, timestamps, .. } = summary;
        Self {
            name: name.clone(),
            backend: backend.clone(),
            kind: kind.to_string(),
            driver: driver.clone(),
            timestamps: *timestamps,
        }
    }
}

impl fmt::Display for AdapterIdentity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} ({}, {}, {})", self.name, self.backend, self.kind, self.driver)
    }
}

impl fmt::Display for AdapterSummary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { index, name, backend, kind, driver, .. } = self;
        write!(
            f,
            "{index}: {name} ({backend}, {kind}, {driver}; buffers up to {})",
            human_bytes(self.max_binding_bytes)
        )
    }
}

/// Options for opening a device. The default suits a program that embeds the library; checks and poison serve the test
/// suite.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct GpuOptions {
    /// Folder that keeps compiled pipelines from one process to the next, if the adapter hands them out; created if it
    /// does not exist. Drivers trust the files there: nobody else should be able to write to the folder. `None`, the
    /// default, keeps none: a library writes no files that its user did not request.
    pub pipeline_folder: Option<PathBuf>,
    /// Whether to build kernels with bounds checks, loop bounds and zeroed workgroup memory. Kernels without them are
    /// up to a third faster.
    pub checked_shaders: bool,
    /// Whether to fill every buffer that [`Recorder::take`](super::Recorder::take) hands out with [`Gpu::POISON`], so
    /// that a value that a kernel forgets to write becomes visible.
    pub poison: bool,
}

/// An open device. Cheap to clone, shared between threads.
#[derive(Clone)]
pub struct Gpu {
    pub(super) inner: Arc<Inner>,
}

impl fmt::Debug for Gpu {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Gpu").field(&self.inner.summary.name).finish()
    }
}

pub(super) struct Inner {
    origin: Option<Origin>,
    pub(super) device: wgpu::Device,
    pub(super) queue: wgpu::Queue,
    pub(super) limits: wgpu::Limits,
    pub(super) summary: AdapterSummary,
    pub(super) options: GpuOptions,
    pub(super) pool: Arc<Pool>,
    pub(super) pipeline_cache: Option<PipelineCache>,
    pub(super) kernels: Mutex<HashMap<KernelKey, Arc<Kernel>>>,
    pub(super) timing: Timing,
    pub(super) poison_source: Mutex<Option<wgpu::Buffer>>,
    health: Arc<Health>,
}

/// Instance and adapter of a device that was opened here.
struct Origin {
    instance: wgpu::Instance,
    adapter: wgpu::Adapter,
}

/// Errors that came up outside of any call that could have returned them.
#[derive(Default)]
struct Health {
    lost: Mutex<Option<String>>,
    fault: Mutex<Option<String>>,
}

impl Drop for Inner {
    fn drop(&mut self) {
        if lock(&self.health.lost).is_none()
            && let Some(cache) = &self.pipeline_cache
        {
            // Nobody can handle an error any more, and the next process only compiles again.
            let _ = cache.save();
        }
    }
}

impl Gpu {
    /// The bits that fill every buffer under [`GpuOptions::poison`]: a quiet NaN that no arithmetic produces.
    pub const POISON: u32 = 0x7fc0_dead;

    /// All adapters of this machine, in the driver's order.
    pub fn adapters() -> Vec<AdapterSummary> {
        let summaries = enumerate().1.into_iter().enumerate();
        summaries
            .map(|(index, adapter)| {
                AdapterSummary::new(index, &adapter.get_info(), &adapter.limits(), adapter.features())
            })
            .collect()
    }

    /// Opens an adapter.
    ///
    /// # Errors
    /// [`Error::Device`] where the computer has no adapter, where no adapter matches `choice`, or where the driver
    /// refuses to open the adapter.
    pub fn open(choice: &DeviceChoice) -> Result<Self> {
        Self::open_with(choice, GpuOptions::default())
    }

    /// Opens an adapter with other options than the default ones.
    ///
    /// # Errors
    /// As [`Gpu::open`].
    pub fn open_with(choice: &DeviceChoice, options: GpuOptions) -> Result<Self> {
        if let Some(free) = FreeMemory::of_address_space() {
            free.check(DRIVER_BYTES).map_err(|shortage| shortage.error("the driver of a graphics adapter"))?;
        }
        let (instance, adapters) = enumerate();
        let summaries: Vec<_> = adapters
            .iter()
            .enumerate()
            .map(|(index, adapter)| {
                AdapterSummary::new(index, &adapter.get_info(), &adapter.limits(), adapter.features())
            })
            .collect();
        let summary = choose(&summaries, choice)?;
        let adapter = &adapters[summary.index];

        let offered = adapter.limits();
        let limits = wgpu::Limits {
            max_buffer_size: offered.max_buffer_size,
            max_storage_buffer_binding_size: offered.max_storage_buffer_binding_size,
            max_storage_buffers_per_shader_stage: offered
                .max_storage_buffers_per_shader_stage
                .min(STORAGE_BUFFERS_WANTED),
            max_compute_workgroup_storage_size: offered.max_compute_workgroup_storage_size,
            max_compute_invocations_per_workgroup: offered.max_compute_invocations_per_workgroup,
            max_compute_workgroup_size_x: offered.max_compute_workgroup_size_x,
            max_compute_workgroup_size_y: offered.max_compute_workgroup_size_y,
            max_compute_workgroup_size_z: offered.max_compute_workgroup_size_z,
            // For programs that show images on the same device.
            max_texture_dimension_2d: offered.max_texture_dimension_2d,
            ..wgpu::Limits::default().or_worse_values_from(&offered)
        };
        let description = wgpu::DeviceDescriptor {
            label: Some("stein"),
            required_features: adapter.features() & (wgpu::Features::TIMESTAMP_QUERY | wgpu::Features::PIPELINE_CACHE),
            required_limits: limits,
            // A software device keeps its buffers in main memory: they are made one by one, without large blocks to cut
            // them from.
            memory_hints: if summary.kind == DeviceKind::Software {
                wgpu::MemoryHints::MemoryUsage
            } else {
                wgpu::MemoryHints::Performance
            },
            ..Default::default()
        };
        let (device, queue) = pollster::block_on(adapter.request_device(&description)).map_err(|error| {
            Error::Device(DeviceCause::NotOpened { adapter: summary.name.clone(), reason: error.to_string() })
        })?;

        let health = Arc::new(Health::default());
        let (lost, fault) = (Arc::clone(&health), Arc::clone(&health));
        device.set_device_lost_callback(move |reason, message| {
            let message = if message.is_empty() { format!("{reason:?}").to_lowercase() } else { message };
            lock(&lost.lost).get_or_insert(message);
        });
        // Every call below catches its own errors; this handler keeps any other error from ending the process.
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
            lock(&fault.fault).get_or_insert(error.to_string());
        }));
        let folder =
            options.pipeline_folder.as_deref().filter(|_| device.features().contains(wgpu::Features::PIPELINE_CACHE));
        let pipeline_cache = folder.and_then(|folder| PipelineCache::open(&device, &adapter.get_info(), folder));
        let origin = Some(Origin { instance, adapter: adapter.clone() });
        Self::assemble(origin, device, queue, summary, options, pipeline_cache, health)
    }

    /// Takes over a device that a renderer already has. The renderer keeps its callbacks for errors and device loss.
    ///
    /// # Errors
    /// [`Error::Device`] where the device was opened without compute.
    pub fn from_wgpu(device: wgpu::Device, queue: wgpu::Queue, info: &wgpu::AdapterInfo) -> Result<Self> {
        let summary = AdapterSummary::new(0, info, &device.limits(), device.features());
        Self::assemble(None, device, queue, summary, GpuOptions::default(), None, Arc::default())
    }

    fn assemble(
        origin: Option<Origin>,
        device: wgpu::Device,
        queue: wgpu::Queue,
        summary: AdapterSummary,
        options: GpuOptions,
        pipeline_cache: Option<PipelineCache>,
        health: Arc<Health>,
    ) -> Result<Self> {
        let limits = device.limits();
        if limits.max_compute_invocations_per_workgroup == 0 || limits.max_storage_buffers_per_shader_stage == 0 {
            return Err(Error::Device(DeviceCause::NoCompute { adapter: summary.name.clone() }));
        }
        let timing = Timing::new(summary.timestamps, queue.get_timestamp_period());
        let inner = Inner {
            origin,
            device,
            queue,
            limits,
            summary,
            options,
            pool: Arc::default(),
            pipeline_cache,
            kernels: Mutex::default(),
            timing,
            poison_source: Mutex::default(),
            health,
        };
        Ok(Self { inner: Arc::new(inner) })
    }

    /// Returns the summary of the adapter.
    pub fn summary(&self) -> &AdapterSummary {
        &self.inner.summary
    }

    /// Returns whether kernels run on the processor's cores.
    pub fn is_software(&self) -> bool {
        self.inner.summary.kind == DeviceKind::Software
    }

    /// Returns the size of the largest buffer that a kernel can see whole, in bytes.
    pub fn max_binding_bytes(&self) -> u64 {
        self.inner.summary.max_binding_bytes
    }

    /// Returns the largest number of workgroups that one dispatch can run along each of its three axes.
    pub fn max_workgroups(&self) -> u32 {
        self.inner.limits.max_compute_workgroups_per_dimension
    }

    /// Returns the wgpu device, for embedders.
    pub fn wgpu_device(&self) -> &wgpu::Device {
        &self.inner.device
    }

    /// Returns the wgpu queue, for embedders.
    pub fn wgpu_queue(&self) -> &wgpu::Queue {
        &self.inner.queue
    }

    /// Returns the instance that the device was opened from, for embedders that present to a window; `None` for a
    /// device that was taken over by [`Gpu::from_wgpu`].
    pub fn wgpu_instance(&self) -> Option<&wgpu::Instance> {
        self.inner.origin.as_ref().map(|origin| &origin.instance)
    }

    /// Returns the adapter that the device was opened on; `None` for a device that was taken over by
    /// [`Gpu::from_wgpu`].
    pub fn wgpu_adapter(&self) -> Option<&wgpu::Adapter> {
        self.inner.origin.as_ref().map(|origin| &origin.adapter)
    }

    /// Returns the memory held by pooled buffers.
    pub fn memory(&self) -> MemoryUse {
        self.inner.pool.usage()
    }

    /// Gives idle buffers back to the driver.
    pub fn trim(&self) {
        self.inner.pool.trim();
    }

    /// Blocks until all submitted commands are done.
    ///
    /// # Errors
    /// [`Error::Device`] where the device was lost or reported an error meanwhile.
    pub fn wait(&self) -> Result<()> {
        self.poll(wgpu::PollType::wait_indefinitely())
    }

    /// Lets the driver's callbacks run.
    pub(super) fn poll(&self, poll: wgpu::PollType) -> Result<()> {
        self.check()?;
        if let Some(error) = self.poll_for_news(poll) {
            lock(&self.inner.health.fault).get_or_insert(error.to_string());
        }
        self.check()
    }

    /// Lets the driver's callbacks run; one of them reports that the device is lost.
    fn poll_for_news(&self, poll: wgpu::PollType) -> Option<wgpu::PollError> {
        // wgpu panics if the driver reports a lost device during a poll, and a poll is also where a hang or a reset of
        // the hardware becomes known.
        let device = &self.inner.device;
        match std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| device.poll(poll))) {
            Ok(polled) => polled.err(),
            Err(panic) => {
                lock(&self.inner.health.lost).get_or_insert(panic_message(panic.as_ref()));
                None
            }
        }
    }

    /// Runs `work`, and returns its result or an error that wgpu or the driver reported meanwhile.
    pub(super) fn guarded<T>(&self, work: impl FnOnce() -> T) -> std::result::Result<T, wgpu::Error> {
        let filters = [wgpu::ErrorFilter::Validation, wgpu::ErrorFilter::Internal, wgpu::ErrorFilter::OutOfMemory];
        let scopes = filters.map(|filter| self.inner.device.push_error_scope(filter));
        let result = work();
        let mut first = None;
        for scope in scopes.into_iter().rev() {
            first = first.or(pollster::block_on(scope.pop()));
        }
        first.map_or(Ok(result), Err)
    }

    /// Fails where the device was lost, or where an error came up that no call could return.
    pub(super) fn check(&self) -> Result<()> {
        if let Some(lost) = self.lost() {
            return Err(lost);
        }
        match lock(&self.inner.health.fault).take() {
            Some(fault) => Err(self.defect(&fault)),
            None => Ok(()),
        }
    }

    fn lost(&self) -> Option<Error> {
        lock(&self.inner.health.lost).as_ref().map(|reason| Error::Device(DeviceCause::Lost { reason: reason.clone() }))
    }

    /// Makes an error from a report about valid commands: the driver failed on commands that wgpu had accepted, or wgpu
    /// refused commands that the driver accepts. Returns the loss of the device instead if the device was lost.
    pub(super) fn defect(&self, report: &str) -> Error {
        // Once a device is lost, every call fails for that reason. A call may fail before the loss is reported, because
        // the report comes only after the remaining work.
        self.poll_for_news(wgpu::PollType::Wait { submission_index: None, timeout: Some(NEWS_PATIENCE) });
        if let Some(lost) = self.lost() {
            return lost;
        }
        Error::Device(DeviceCause::DriverReport {
            adapter: self.inner.summary.name.clone(),
            report: report.trim_end().into(),
        })
    }
}

fn panic_message(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<String>().map(String::as_str).or(panic.downcast_ref::<&str>().copied());
    text.unwrap_or("the driver failed while it was waited for").to_owned()
}

fn enumerate() -> (wgpu::Instance, Vec<wgpu::Adapter>) {
    let description =
        wgpu::InstanceDescriptor { backends: BACKENDS, ..wgpu::InstanceDescriptor::new_without_display_handle() };
    let instance = wgpu::Instance::new(description);
    let adapters = pollster::block_on(instance.enumerate_adapters(BACKENDS));
    (instance, adapters)
}

fn choose(summaries: &[AdapterSummary], choice: &DeviceChoice) -> Result<AdapterSummary> {
    let chosen = match choice {
        DeviceChoice::Auto => summaries.iter().min_by_key(|summary| summary.kind),
        DeviceChoice::Index(index) => summaries.get(*index),
        DeviceChoice::Name(name) => {
            let name = name.to_lowercase();
            summaries.iter().find(|summary| summary.name.to_lowercase().contains(&name))
        }
    };
    if let Some(summary) = chosen {
        return Ok(summary.clone());
    }
    if summaries.is_empty() {
        return Err(Error::Device(DeviceCause::NoAdapter));
    }
    Err(Error::Device(DeviceCause::NoSuchAdapter { choice: choice.clone(), adapters: summaries.to_vec() }))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn summary(index: usize, name: &str, kind: DeviceKind) -> AdapterSummary {
        AdapterSummary {
            index,
            name: name.into(),
            backend: "Vulkan".into(),
            kind,
            driver: "driver 1".into(),
            max_buffer_bytes: 1 << 30,
            max_binding_bytes: 1 << 27,
            max_storage_buffers: 16,
            timestamps: true,
        }
    }

    #[test]
    fn the_best_kind_of_adapter_is_taken() {
        let found = [
            summary(0, "llvmpipe", DeviceKind::Software),
            summary(1, "Arc", DeviceKind::Discrete),
            summary(2, "RTX", DeviceKind::Discrete),
        ];
        assert_eq!(choose(&found, &DeviceChoice::Auto).expect("one").index, 1);
        assert_eq!(choose(&found, &DeviceChoice::Index(2)).expect("one").name, "RTX");
        assert_eq!(choose(&found, &DeviceChoice::Name("LLVM".into())).expect("one").index, 0);
    }

    #[test]
    fn a_missing_adapter_is_told_with_those_that_exist() {
        let error = choose(&[summary(0, "llvmpipe", DeviceKind::Software)], &DeviceChoice::Name("rtx".into()))
            .expect_err("none");
        let text = error.to_string();
        assert!(text.contains("whose name contains 'rtx'") && text.contains("0: llvmpipe (Vulkan, software"), "{text}");
        let text = choose(&[], &DeviceChoice::Auto).expect_err("none").to_string();
        assert!(text.contains("mesa-vulkan-drivers") && text.contains("scripts/setup.sh"), "{text}");
    }

    #[test]
    fn a_choice_is_an_index_or_part_of_a_name() {
        assert_eq!("auto".parse(), Ok(DeviceChoice::Auto));
        assert_eq!("1".parse(), Ok(DeviceChoice::Index(1)));
        assert_eq!("RTX 4090".parse(), Ok(DeviceChoice::Name("RTX 4090".into())));
    }
}
