//! Causes of failures of the device.

use super::Remedy;
use crate::gpu::{AdapterSummary, DeviceChoice};
use crate::host_memory::Shortage;
use crate::text::human_bytes;

/// The reason why the device cannot do the work.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum DeviceCause {
    /// The computer has no graphics adapter with a driver.
    #[error("no graphics adapter was found (Vulkan, Metal or DX12)")]
    NoAdapter,
    /// None of the adapters is the requested one.
    #[error("there is no adapter {}", described(choice))]
    NoSuchAdapter {
        /// The requested adapter.
        choice: DeviceChoice,
        /// All adapters of the computer.
        adapters: Vec<AdapterSummary>,
    },
    /// The driver refuses to open a device on the adapter.
    #[error("adapter '{adapter}' cannot be opened: {reason}")]
    NotOpened {
        /// Name of the adapter.
        adapter: String,
        /// Message of the driver.
        reason: String,
    },
    /// The caller's device was opened without compute shaders.
    #[error("the device on '{adapter}' offers no compute")]
    NoCompute {
        /// Name of the adapter.
        adapter: String,
    },
    /// A stage exceeds one of the device's limits on kernels.
    #[error("stage '{stage}' needs {needed} {what}, but '{adapter}' has {limit}")]
    StageTooLarge {
        /// The stage, named as its file in `shaders/`.
        stage: String,
        /// Name of the limited resource, in the plural.
        what: &'static str,
        /// Number that the stage needs.
        needed: u64,
        /// Number that the device offers.
        limit: u64,
        /// Name of the adapter.
        adapter: String,
    },
    /// The device was lost.
    #[error("the device was lost: {reason}")]
    Lost {
        /// Message of the driver.
        reason: String,
    },
    /// The driver reported an error about valid commands.
    #[error("the driver of '{adapter}' reported: {report}")]
    DriverReport {
        /// Name of the adapter.
        adapter: String,
        /// Message of the driver.
        report: String,
    },
    /// A buffer is larger than a kernel can bind.
    #[error(
        "the buffer '{label}' would need {} ({bytes} bytes), but '{adapter}' lets a kernel see at \
         most {} ({limit} bytes)",
        human_bytes(*bytes),
        human_bytes(*limit)
    )]
    BufferTooLarge {
        /// Label of the buffer.
        label: String,
        /// Size of the buffer in bytes.
        bytes: u64,
        /// Size of the largest binding in bytes.
        limit: u64,
        /// Name of the adapter.
        adapter: String,
    },
    /// The adapter's memory is full.
    #[error("'{adapter}' has no memory left for {what}; {} are in use by this program", human_bytes(*bytes_in_use))]
    OutOfMemory {
        /// What the memory is for.
        what: String,
        /// Bytes in pooled buffers that are handed out.
        bytes_in_use: u64,
        /// Name of the adapter.
        adapter: String,
    },
    /// The computer's memory is full.
    #[error("{what} {shortage}")]
    OutOfHostMemory {
        /// What the memory is for.
        what: String,
        /// Needed and free bytes.
        shortage: Shortage,
    },
    /// Not even one row with its halo fits into the memory that the caller allows.
    #[error(
        "a strip of one row of this image, with the {halo} rows above and below that it depends on, does not fit into \
         the memory allowed on the device: it needs {} MiB of {} MiB",
        needed.div_ceil(1 << 20),
        allowed >> 20
    )]
    StripTooLarge {
        /// Rows above, and as many below, that one row depends on.
        halo: usize,
        /// Bytes that the strip needs.
        needed: u64,
        /// Bytes that the caller allows.
        allowed: u64,
    },
    /// Not even one row with its halo fits the adapter's limits.
    #[error(
        "a strip of one row of this image, with the {halo} rows above and below that it depends on, does not fit the \
         limits of '{adapter}': it needs a buffer of {} MiB and {rows} workgroups in a row, the adapter binds {} MiB \
         and runs {most_groups}",
        bytes.div_ceil(1 << 20),
        most_bytes.div_ceil(1 << 20)
    )]
    StripExceedsAdapter {
        /// Rows above, and as many below, that one row depends on.
        halo: usize,
        /// Size of the largest buffer in bytes.
        bytes: u64,
        /// Rows of the strip, each of which takes a row of workgroups.
        rows: u64,
        /// Size of the largest binding in bytes.
        most_bytes: u64,
        /// Largest number of workgroups along an axis.
        most_groups: u32,
        /// Name of the adapter.
        adapter: String,
    },
    /// A dispatch has more workgroups along an axis than the adapter runs.
    #[error("stage '{stage}' needs {groups} workgroups in {axis}, the adapter runs at most {limit}")]
    TooManyWorkgroups {
        /// The stage, named as its file in `shaders/`.
        stage: String,
        /// Number of workgroups along the axis.
        groups: u32,
        /// The axis: `x`, `y` or `z`.
        axis: char,
        /// Largest number of workgroups along an axis.
        limit: u32,
    },
    /// A failure of a program or a crate around the library, in its own words.
    #[error("{problem}")]
    Other {
        /// Cause of the failure.
        problem: String,
        /// Action that helps the user.
        remedy: String,
    },
}

impl DeviceCause {
    /// Returns actions that help the user, the best one first.
    pub fn remedies(&self) -> Vec<Remedy> {
        match self {
            Self::NoAdapter => vec![Remedy::InstallDriver],
            Self::NoSuchAdapter { adapters, .. } => vec![Remedy::ChooseAdapter { adapters: adapters.clone() }],
            Self::NotOpened { .. } => vec![Remedy::AnotherAdapter, Remedy::UpdateDriver, Remedy::RaiseSystemLimit],
            Self::NoCompute { .. } => {
                vec![Remedy::ChangeCall("open the device with at least `wgpu::Limits::default()`")]
            }
            Self::StageTooLarge { .. } => vec![Remedy::AnotherAdapter],
            Self::Lost { .. } => vec![
                Remedy::RunAgain,
                Remedy::UpdateDriver,
                Remedy::AnotherAdapter,
                Remedy::SmallerWindow,
                Remedy::CropImage,
            ],
            Self::DriverReport { .. } => vec![
                Remedy::UpdateDriver,
                Remedy::AnotherAdapter,
                Remedy::ReportDefect { with: "the output of `stein devices`" },
            ],
            Self::BufferTooLarge { .. } => {
                vec![Remedy::LowerMemoryLimit, Remedy::SmallerWindow, Remedy::CropImage, Remedy::AnotherAdapter]
            }
            Self::OutOfMemory { .. } => vec![
                Remedy::LowerMemoryLimit,
                Remedy::SmallerWindow,
                Remedy::CropImage,
                Remedy::CloseGraphicsPrograms,
                Remedy::AnotherAdapter,
            ],
            Self::OutOfHostMemory { .. } => Remedy::MORE_HOST_MEMORY.to_vec(),
            Self::StripTooLarge { .. } => vec![
                Remedy::RaiseMemoryLimit,
                Remedy::SmallerWindow,
                Remedy::FewerFramesBeside,
                Remedy::LeaveFeaturesOut,
            ],
            Self::StripExceedsAdapter { .. } => {
                vec![Remedy::CropImage, Remedy::SmallerWindow, Remedy::LeaveFeaturesOut, Remedy::AnotherAdapter]
            }
            Self::TooManyWorkgroups { .. } => vec![Remedy::CropImage, Remedy::CutImage],
            Self::Other { remedy, .. } => vec![Remedy::Other(remedy.clone())],
        }
    }
}

fn described(choice: &DeviceChoice) -> String {
    match choice {
        DeviceChoice::Auto => String::new(),
        DeviceChoice::Index(index) => format!("with the index {index}"),
        DeviceChoice::Name(name) => format!("whose name contains '{name}'"),
    }
}
