//! The window without a screen, for pictures in the documentation and for tests.

use std::path::Path;
use std::time::{Duration, Instant};

use eframe::egui::{Context, Event, Pos2, RawInput, Rect, Theme, Ui, Vec2, ViewportId};
use eframe::egui_wgpu::{RenderState, RendererOptions, ScreenDescriptor};
use eframe::wgpu;
use stein::error::{DeviceCause, FileCause, RequestCause};
use stein::{Error, Extent, Gpu, Result};
use stein_exr::atomic_file;

use crate::app::{Start, Viewer};
use crate::device;
use crate::settings::Settings;

/// Longest time that a run may take before the picture is given up.
const PATIENCE: Duration = Duration::from_secs(600);
/// Number of frames that the layout may need to come to rest.
const SETTLING_FRAMES: usize = 4;
/// Time between two looks at the worker.
const PAUSE: Duration = Duration::from_millis(15);

/// A picture with eight bits per channel and rows from top to bottom.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Picture {
    /// Width and height in pixels.
    pub extent: Extent,
    /// R, G, B and an opaque A of each pixel.
    pub rgba: Vec<u8>,
}

impl Picture {
    /// Returns R, G and B of a pixel.
    pub fn pixel(&self, x: u32, y: u32) -> [u8; 3] {
        let first = 4 * (y as usize * self.extent.width as usize + x as usize);
        [self.rgba[first], self.rgba[first + 1], self.rgba[first + 2]]
    }

    /// Writes the picture as PNG. The file appears under its name only when it is complete.
    ///
    /// # Errors
    /// [`Error::File`] if the file cannot be written.
    pub fn write_png(&self, path: &Path) -> Result<()> {
        let failed = |reason: String| Error::File { path: path.to_owned(), cause: FileCause::Unwritable { reason } };
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, self.extent.width, self.extent.height);
        encoder.set_color(png::ColorType::Rgba);
        encoder.set_depth(png::BitDepth::Eight);
        let written = encoder
            .write_header()
            .and_then(|mut writer| writer.write_image_data(&self.rgba).and_then(|()| writer.finish()));
        written.map_err(|error| failed(error.to_string()))?;
        atomic_file::write(path, &bytes).map_err(|error| failed(error.to_string()))
    }
}

/// A window that draws into a texture.
pub struct Offscreen {
    context: Context,
    state: RenderState,
    extent: Extent,
    scale: f32,
    events: Vec<Event>,
    start: Instant,
}

impl Offscreen {
    /// Creates a window of `width` × `height` points, each of `scale` pixels.
    ///
    /// # Errors
    /// As [`device::setup`]; [`Error::Device`] if the device cannot draw.
    pub fn new(gpu: &Gpu, width: f32, height: f32, scale: f32) -> Result<Self> {
        let configuration = device::configuration(gpu)?;
        let Some(instance) = gpu.wgpu_instance() else { unreachable!("the configuration has one") };
        let state =
            pollster::block_on(RenderState::create(&configuration, instance, None, RendererOptions::PREDICTABLE));
        let state = state.map_err(|error| {
            Error::Device(DeviceCause::Other {
                problem: format!("nothing can be drawn on '{}': {error}", gpu.summary().name),
                remedy: "choose another adapter with --device".into(),
            })
        })?;
        let context = Context::default();
        context.set_theme(Theme::Dark);
        // With animations, a picture would depend on the time at which it is taken.
        context.all_styles_mut(|style| style.animation_time = 0.0);
        let extent = Extent { width: (width * scale).round() as u32, height: (height * scale).round() as u32 };
        Ok(Self { context, state, extent, scale, events: Vec::new(), start: Instant::now() })
    }

    /// Returns the context of the window.
    pub fn context(&self) -> &Context {
        &self.context
    }

    /// Returns the format of the render target.
    pub fn format(&self) -> wgpu::TextureFormat {
        self.state.target_format
    }

    /// Adds an event that happens before the next frame.
    pub fn send(&mut self, event: Event) {
        self.events.push(event);
    }

    /// Draws a frame.
    ///
    /// # Errors
    /// [`Error::Device`] if the device is lost.
    pub fn frame(&mut self, show: impl FnMut(&mut Ui)) -> Result<Picture> {
        let size = Vec2::new(self.extent.width as f32, self.extent.height as f32) / self.scale;
        let mut input = RawInput {
            screen_rect: Some(Rect::from_min_size(Pos2::ZERO, size)),
            time: Some(self.start.elapsed().as_secs_f64()),
            max_texture_side: Some(self.state.device.limits().max_texture_dimension_2d as usize),
            events: std::mem::take(&mut self.events),
            ..Default::default()
        };
        input.viewports.entry(ViewportId::ROOT).or_default().native_pixels_per_point = Some(self.scale);
        let mut output = self.context.run_ui(input, show);
        let screen =
            ScreenDescriptor { size_in_pixels: [self.extent.width, self.extent.height], pixels_per_point: self.scale };
        let shapes = self.context.tessellate(output.shapes, output.pixels_per_point);
        let (device, queue) = (&self.state.device, &self.state.queue);
        let mut renderer = self.state.renderer.write();
        for (id, deltas) in output.textures_delta.set.drain() {
            deltas.iter().for_each(|delta| renderer.update_texture(device, queue, id, delta));
        }
        let target = device.create_texture(&wgpu::TextureDescriptor {
            label: Some("picture"),
            size: wgpu::Extent3d { width: self.extent.width, height: self.extent.height, depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: self.state.target_format,
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC,
            view_formats: &[],
        });
        let view = target.create_view(&Default::default());
        let mut encoder = device.create_command_encoder(&Default::default());
        let mut commands = renderer.update_buffers(device, queue, &mut encoder, &shapes, &screen);
        let pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("picture"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: &view,
                resolve_target: None,
                ops: wgpu::Operations { load: wgpu::LoadOp::Clear(wgpu::Color::BLACK), store: wgpu::StoreOp::Store },
                depth_slice: None,
            })],
            ..Default::default()
        });
        renderer.render(&mut pass.forget_lifetime(), &shapes, &screen);
        for id in output.textures_delta.free.drain() {
            renderer.free_texture(&id);
        }
        drop(renderer);
        commands.push(encoder.finish());
        queue.submit(commands);
        self.read(&target)
    }

    fn read(&self, target: &wgpu::Texture) -> Result<Picture> {
        let (device, queue) = (&self.state.device, &self.state.queue);
        let row = (self.extent.width * 4).next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT);
        let buffer = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("picture"),
            size: u64::from(row) * u64::from(self.extent.height),
            usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
            mapped_at_creation: false,
        });
        let mut encoder = device.create_command_encoder(&Default::default());
        let layout = wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(row), rows_per_image: None };
        encoder.copy_texture_to_buffer(
            target.as_image_copy(),
            wgpu::TexelCopyBufferInfo { buffer: &buffer, layout },
            target.size(),
        );
        queue.submit([encoder.finish()]);
        let lost = |problem: String| {
            Error::Device(DeviceCause::Other {
                problem,
                remedy: "run again; if it happens again, choose another adapter with --device".into(),
            })
        };
        let (sender, mapped) = std::sync::mpsc::channel();
        buffer.map_async(wgpu::MapMode::Read, .., move |result| {
            // The receiver lives until this result has arrived.
            let _ = sender.send(result);
        });
        device
            .poll(wgpu::PollType::wait_indefinitely())
            .map_err(|error| lost(format!("the picture cannot be read back: {error}")))?;
        let outcome = mapped.recv().map_err(|_| lost("the picture cannot be read back".into()))?;
        outcome.map_err(|error| lost(format!("the picture cannot be read back: {error}")))?;
        let bytes =
            buffer.get_mapped_range(..).map_err(|error| lost(format!("the picture cannot be read back: {error}")))?;
        let rows = bytes.chunks_exact(row as usize).flat_map(|bytes| &bytes[..self.extent.width as usize * 4]);
        let mut rgba: Vec<u8> = rows.copied().collect();
        rgba.chunks_exact_mut(4).for_each(|pixel| pixel[3] = 255);
        Ok(Picture { extent: self.extent, rgba })
    }
}

/// Contents and size of a picture of the window.
#[derive(Clone, Debug)]
pub struct Shot {
    /// State with which the window starts.
    pub start: Start,
    /// Width and height in points.
    pub size: [f32; 2],
    /// Pixels per point.
    pub scale: f32,
    /// Dark or light.
    pub theme: Theme,
}

/// Opens the files of the shot, waits for the run, and draws the window. Calls `arrange` once everything is ready, to
/// set what is shown.
///
/// # Errors
/// The failure that the window would report; [`Error::Request`] if the run takes too long, or if a layer, a pixel or a
/// neighbour does not exist. The window would show a default instead.
pub fn take(gpu: &Gpu, shot: &Shot, arrange: impl FnOnce(&mut Viewer)) -> Result<Picture> {
    let mut window = Offscreen::new(gpu, shot.size[0], shot.size[1], shot.scale)?;
    window.context().set_theme(shot.theme);
    let mut viewer = Viewer::new(window.context(), gpu, window.format(), Settings::default(), shot.start.clone())?;
    let start = Instant::now();
    loop {
        viewer.poll(window.context());
        if let Some((_, trouble)) = viewer.trouble.take() {
            return Err(trouble);
        }
        if viewer.is_idle() {
            break;
        }
        if start.elapsed() > PATIENCE {
            let problem = format!("the run took longer than {} s", PATIENCE.as_secs());
            return Err(Error::Request(RequestCause::Other { problem, remedy: "give a smaller frame".into() }));
        }
        std::thread::sleep(PAUSE);
    }
    arrange(&mut viewer);
    let mut picture = window.frame(|ui| viewer.show(ui))?;
    for _ in 1..SETTLING_FRAMES {
        picture = window.frame(|ui| viewer.show(ui))?;
    }
    Ok(picture)
}
