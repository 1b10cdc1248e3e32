//! Reading buffers back.

use std::sync::mpsc::channel;
use std::time::Duration;

use super::device::Gpu;
use super::pool::Buffer;
use crate::error::{Error, RequestCause, Result};

/// Largest number of values that are read at once; it bounds the staging memory.
const CHUNK_VALUES: usize = (16 << 20) / 4;

/// Time that another thread may take to run a callback that it has taken from the device. The callback only sends one
/// message.
const CALLBACK_PATIENCE: Duration = Duration::from_secs(10);

impl Gpu {
    /// Returns the content of a buffer after all submitted commands. Blocks until they are done.
    ///
    /// # Errors
    /// [`Error::Request`] where commands that use the buffer are recorded and not submitted; [`Error::Device`] where
    /// the device failed.
    pub fn read(&self, buffer: &Buffer) -> Result<Vec<f32>> {
        let mut values = vec![0.0; (buffer.bytes() / 4) as usize];
        self.read_into(buffer, 0, &mut values)?;
        Ok(values)
    }

    /// Fills `values` with the part of a buffer that begins at `offset_bytes`, a multiple of four.
    ///
    /// # Errors
    /// [`Error::Request`] where the part reaches beyond the end of the buffer, where `offset_bytes` is no multiple of
    /// four, where commands that use the buffer are not submitted, or where the buffer belongs to a dry run;
    /// [`Error::Device`] where the device failed.
    pub fn read_into(&self, buffer: &Buffer, offset_bytes: u64, values: &mut [f32]) -> Result<()> {
        self.read_with(buffer, offset_bytes, values.len(), |first, piece| {
            values[first..first + piece.len()].copy_from_slice(piece);
        })
    }

    /// Reads `values` values of a buffer piece by piece, from `offset_bytes` on, which is a multiple of four. Calls
    /// `take` with the position of each piece and with the piece; positions count values and are multiples of four.
    ///
    /// # Errors
    /// As [`Gpu::read_into`].
    pub fn read_with(
        &self,
        buffer: &Buffer,
        offset_bytes: u64,
        values: usize,
        mut take: impl FnMut(usize, &[f32]),
    ) -> Result<()> {
        let refuse = |problem, change| Err(Error::Request(RequestCause::Misuse { problem, change }));
        let (label, end) = (buffer.label(), offset_bytes + 4 * values as u64);
        if !offset_bytes.is_multiple_of(4) || end > buffer.bytes() {
            let problem = format!(
                "bytes {offset_bytes} to {end} of the buffer '{label}' cannot be read: it has {} bytes",
                buffer.bytes()
            );
            return refuse(problem, "read whole values within the buffer");
        }
        if buffer.is_dry() {
            return refuse(
                format!("the buffer '{label}' belongs to a dry run, which computes nothing"),
                "run the work",
            );
        }
        if self.inner.pool.is_open(buffer.last_use()) {
            return refuse(
                format!("commands that use the buffer '{label}' are recorded but not submitted"),
                "call `Recorder::submit` or `flush` first",
            );
        }
        for first in (0..values).step_by(CHUNK_VALUES) {
            let bytes = 4 * CHUNK_VALUES.min(values - first) as u64;
            self.read_chunk(buffer, offset_bytes + 4 * first as u64, bytes, |chunk| take(first, chunk))?;
        }
        Ok(())
    }

    fn read_chunk(&self, buffer: &Buffer, offset: u64, bytes: u64, take: impl FnOnce(&[f32])) -> Result<()> {
        self.check()?;
        let device = &self.inner.device;
        let usage = wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST;
        let (sender, receiver) = channel();
        let copied = self.guarded(|| {
            let staging = device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("readback"),
                size: bytes,
                usage,
                mapped_at_creation: false,
            });
            let mut encoder =
                device.create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some("readback") });
            encoder.copy_buffer_to_buffer(buffer.wgpu(), offset, &staging, 0, bytes);
            self.inner.queue.submit([encoder.finish()]);
            staging.map_async(wgpu::MapMode::Read, .., move |mapped| {
                // The receiver is gone if the read failed already.
                let _ = sender.send(mapped);
            });
            staging
        });
        let staging =
            copied.map_err(|error| self.out_of_memory(&format!("reading '{}' back", buffer.label()), &error))?;
        self.wait()?;
        let unreadable =
            || self.defect(&format!("the buffer '{}' cannot be read; the device is probably lost", buffer.label()));
        // Another thread that waits for the same device may have taken this callback together with its own callbacks,
        // and may not have run it yet.
        receiver.recv_timeout(CALLBACK_PATIENCE).ok().and_then(std::result::Result::ok).ok_or_else(unreadable)?;
        let view = staging.get_mapped_range(..).map_err(|_| unreadable())?;
        take(bytemuck::cast_slice(&view));
        Ok(())
    }
}
