//! One device for the denoiser and the window.

use eframe::egui_wgpu::{WgpuConfiguration, WgpuSetup, WgpuSetupExisting};
use stein::{Error, Gpu, Result};

/// What lets the window draw on the denoiser's device.
///
/// # Errors
/// [`Error::Device`] where the device was taken over from elsewhere, so that nothing can be presented with it.
pub fn setup(gpu: &Gpu) -> Result<WgpuSetup> {
    let (Some(instance), Some(adapter)) = (gpu.wgpu_instance(), gpu.wgpu_adapter()) else {
        return Err(Error::Device {
            problem: "the device was not opened by `Gpu::open`, so that its adapter is not known".into(),
            remedy: "open it with `Gpu::open` or `Gpu::open_with`".into(),
        });
    };
    Ok(WgpuSetup::Existing(WgpuSetupExisting {
        instance: instance.clone(),
        adapter: adapter.clone(),
        device: gpu.wgpu_device().clone(),
        queue: gpu.wgpu_queue().clone(),
    }))
}

/// The same as a configuration.
///
/// # Errors
/// As [`setup`].
pub fn configuration(gpu: &Gpu) -> Result<WgpuConfiguration> {
    Ok(WgpuConfiguration { wgpu_setup: setup(gpu)?, ..Default::default() })
}

/// That the system starts no thread.
pub(crate) fn no_thread(error: std::io::Error) -> Error {
    Error::Device {
        problem: format!("no thread can be started: {error}"),
        remedy: "end other programs, or raise the limit on processes (ulimit -u)".into(),
    }
}
