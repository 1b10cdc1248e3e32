//! Reading buffers back.

use std::sync::mpsc::channel;
use std::time::Duration;

use super::device::Gpu;
use super::pool::Buffer;
use crate::error::{Error, Result};

/// The most that is read at once, in bytes: bounds the staging memory.
const CHUNK_BYTES: u64 = 64 << 20;

/// How long another thread may take to run a callback that it has taken from the device. It does nothing but send one word.
const CALLBACK_PATIENCE: Duration = Duration::from_secs(10);

impl Gpu {
    /// The content of a buffer after everything that was submitted. Blocks until that is done.
    ///
    /// # Errors
    /// [`Error::Request`] where commands that use the buffer are recorded and not submitted; [`Error::Device`] where the device failed.
    pub fn read(&self, buffer: &Buffer) -> Result<Vec<f32>> {
        let mut values = vec![0.0; (buffer.bytes() / 4) as usize];
        self.read_into(buffer, 0, &mut values)?;
        Ok(values)
    }

    /// Part of a buffer: fills `values` from `offset_bytes` on, a multiple of four.
    ///
    /// # Errors
    /// [`Error::Request`] where the buffer ends before or its commands are not submitted; [`Error::Device`] where the device failed.
    pub fn read_into(&self, buffer: &Buffer, offset_bytes: u64, values: &mut [f32]) -> Result<()> {
        let refuse = |problem: String, remedy: &str| Err(Error::Request { problem, remedy: remedy.into() });
        let (label, end) = (buffer.label(), offset_bytes + size_of_val(values) as u64);
        if !offset_bytes.is_multiple_of(4) || end > buffer.bytes() {
            let problem = format!("bytes {offset_bytes} to {end} of the buffer '{label}' cannot be read: it has {} bytes", buffer.bytes());
            return refuse(problem, "read whole values within the buffer");
        }
        if self.inner.pool.is_open(buffer.last_use()) {
            return refuse(format!("commands that use the buffer '{label}' are recorded but not submitted"), "call `Recorder::submit` or `flush` first");
        }
        let mut offset = offset_bytes;
        for chunk in values.chunks_mut((CHUNK_BYTES / 4) as usize) {
            self.read_chunk(buffer, offset, bytemuck::cast_slice_mut(chunk))?;
            offset += CHUNK_BYTES;
        }
        Ok(())
    }

    fn read_chunk(&self, buffer: &Buffer, offset: u64, out: &mut [u8]) -> Result<()> {
        self.check()?;
        let bytes = out.len() as u64;
        let device = &self.inner.device;
        let usage = wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST;
        let (sender, receiver) = channel();
        let copied = self.guarded(|| {
            let staging = device.create_buffer(&wgpu::BufferDescriptor { label: Some("readback"), size: bytes, usage, mapped_at_creation: false });
            let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some("readback") });
            encoder.copy_buffer_to_buffer(buffer.wgpu(), offset, &staging, 0, bytes);
            self.inner.queue.submit([encoder.finish()]);
            staging.map_async(wgpu::MapMode::Read, .., move |mapped| {
                // Nobody listens where the read failed already.
                let _ = sender.send(mapped);
            });
            staging
        });
        let staging = copied.map_err(|error| self.out_of_memory(&format!("reading '{}' back", buffer.label()), &error))?;
        self.wait()?;
        let unreadable = || self.defect(&format!("the buffer '{}' cannot be read; the device is probably lost", buffer.label()));
        // A thread that waits for the same device may have taken the callback along with its own, and not have come to it yet.
        receiver.recv_timeout(CALLBACK_PATIENCE).ok().and_then(std::result::Result::ok).ok_or_else(unreadable)?;
        let view = staging.get_mapped_range(..).map_err(|_| unreadable())?;
        out.copy_from_slice(&view);
        Ok(())
    }
}
