//! One device for the denoiser and the window.

use eframe::egui_wgpu::{WgpuConfiguration, WgpuSetup, WgpuSetupExisting};
use stein::error::{DeviceCause, RequestCause};
use stein::{Error, Gpu, Result};

/// Returns the setup with which the window draws on the denoiser's device.
///
/// # Errors
/// [`Error::Request`] if neither [`Gpu::open`] nor [`Gpu::open_with`] opened the device, so that its adapter is not
/// known and nothing can be presented.
pub fn setup(gpu: &Gpu) -> Result<WgpuSetup> {
    let (Some(instance), Some(adapter)) = (gpu.wgpu_instance(), gpu.wgpu_adapter()) else {
        return Err(Error::Request(RequestCause::Misuse {
            problem: "the device was not opened by `Gpu::open`, so that its adapter is not known".into(),
            change: "open it with `Gpu::open` or `Gpu::open_with`",
        }));
    };
    Ok(WgpuSetup::Existing(WgpuSetupExisting {
        instance: instance.clone(),
        adapter: adapter.clone(),
        device: gpu.wgpu_device().clone(),
        queue: gpu.wgpu_queue().clone(),
    }))
}

/// Returns the setup as a configuration.
///
/// # Errors
/// As [`setup`].
pub fn configuration(gpu: &Gpu) -> Result<WgpuConfiguration> {
    Ok(WgpuConfiguration { wgpu_setup: setup(gpu)?, ..Default::default() })
}

/// Makes the error of a thread that the system cannot start.
pub(crate) fn no_thread(error: std::io::Error) -> Error {
    Error::Device(DeviceCause::Other {
        problem: format!("no thread can be started: {error}"),
        remedy: "end other programs, or raise the limit on processes (ulimit -u)".into(),
    })
}
