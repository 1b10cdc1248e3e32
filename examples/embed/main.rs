//! A renderer that denoises the buffers of its own wgpu device in place.
//!
//! It renders, denoises and shows in one command encoder, without reading anything back in between. This example then
//! copies the picture to a file; a renderer with a window would present it. Run it with `cargo run --release --example
//! embed -- picture.ppm`.

use std::error::Error;
use std::sync::Arc;

use stein::frame::FeatureKind;
use stein::glam::IVec2;
use stein::method::{GpuFeature, GpuFrame, GpuSignal};
use stein::stage::sample::GpuSamples;
use stein::{Denoiser, DfcParams, Gpu, wgpu};

const WIDTH: u32 = 192;
const HEIGHT: u32 = 128;
/// Samples per pixel of each half.
const SAMPLES: u32 = 8;

fn main() -> Result<(), Box<dyn Error>> {
    let pictures = render_and_denoise()?;
    println!("grain on the floor: {:.4} before, {:.4} after", grain(&pictures[0]), grain(&pictures[1]));
    if let Some(path) = std::env::args().nth(1) {
        std::fs::write(path, ppm(&pictures))?;
    }
    Ok(())
}

/// Returns the rendered picture and the denoised one.
fn render_and_denoise() -> Result<[Vec<u8>; 2], Box<dyn Error>> {
    let renderer = Renderer::open()?;
    let gpu = Gpu::from_wgpu(renderer.device.clone(), renderer.queue.clone(), &renderer.info)?;
    let denoiser = Denoiser::new(&gpu, DfcParams::default())?;
    let [noisy, denoised] = [renderer.picture(), renderer.picture()];

    let mut encoder = renderer.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    // Render.
    let rendered = renderer.render(&mut encoder, 1);
    renderer.show(&mut encoder, &rendered.color, &noisy);
    // Denoise: the kernels go into the same encoder.
    let mut rec = gpu.record_whole();
    let estimate = denoiser.record(&mut rec, rendered.frame(&gpu)?, Vec::new())?;
    rec.encode_into(&mut encoder)?;
    // Show.
    renderer.show(&mut encoder, estimate.signal.wgpu(), &denoised);
    renderer.queue.submit([encoder.finish()]);

    Ok([renderer.read(&noisy)?, renderer.read(&denoised)?])
}

/// A renderer's own device, kernels and buffers.
struct Renderer {
    device: wgpu::Device,
    queue: wgpu::Queue,
    info: wgpu::AdapterInfo,
    render: wgpu::ComputePipeline,
    show: wgpu::ComputePipeline,
}

/// The buffers that a frame is rendered to.
struct Rendered {
    color: wgpu::Buffer,
    albedo: wgpu::Buffer,
    variance: wgpu::Buffer,
}

impl Rendered {
    /// Returns the buffers as the denoiser takes them. Radiance is of the order of 1, and albedo in the unit range.
    fn frame(&self, gpu: &Gpu) -> stein::Result<GpuFrame> {
        let import = |label, buffer: &wgpu::Buffer| gpu.import(label, buffer.clone()).map(Arc::new);
        let variance_of_mean = Some(import("variance", &self.variance)?);
        let color = GpuSignal { signal: import("colour", &self.color)?, variance_of_mean, has_halves: true };
        let albedo = GpuSignal { signal: import("albedo", &self.albedo)?, variance_of_mean: None, has_halves: true };
        Ok(GpuFrame {
            extent: IVec2::new(WIDTH as i32, HEIGHT as i32),
            color,
            features: vec![GpuFeature {
                name: "albedo".into(),
                kind: FeatureKind::Albedo,
                signal: albedo,
                channels: 3,
            }],
            samples: GpuSamples::Uniform(2.0 * SAMPLES as f32),
            mean_variance: None,
            payload: Vec::new(),
        })
    }
}

impl Renderer {
    fn open() -> Result<Self, Box<dyn Error>> {
        let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle());
        let adapter = pollster::block_on(instance.request_adapter(&wgpu::RequestAdapterOptions::default()))?;
        let (device, queue) = pollster::block_on(adapter.request_device(&wgpu::DeviceDescriptor::default()))?;
        let pipeline = |source: &str| {
            let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
                label: None,
                source: wgpu::ShaderSource::Wgsl(source.into()),
            });
            device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: None,
                layout: None,
                module: &module,
                entry_point: None,
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                cache: None,
            })
        };
        let (render, show) = (pipeline(include_str!("render.wgsl")), pipeline(include_str!("show.wgsl")));
        Ok(Self { info: adapter.get_info(), device, queue, render, show })
    }

    fn buffer(&self, bytes: u32, usage: wgpu::BufferUsages) -> wgpu::Buffer {
        self.device.create_buffer(&wgpu::BufferDescriptor {
            label: None,
            size: bytes.into(),
            usage,
            mapped_at_creation: false,
        })
    }

    /// Records the rendering of one frame.
    fn render(&self, encoder: &mut wgpu::CommandEncoder, frame: u32) -> Rendered {
        let planes = |count: u32| self.buffer(16 * count * WIDTH * HEIGHT, wgpu::BufferUsages::STORAGE);
        let rendered = Rendered { color: planes(2), albedo: planes(2), variance: planes(1) };
        let params = self.buffer(16, wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST);
        let values: Vec<u8> = [WIDTH, HEIGHT, SAMPLES, frame].into_iter().flat_map(u32::to_le_bytes).collect();
        self.queue.write_buffer(&params, 0, &values);
        let bound = [&params, &rendered.color, &rendered.albedo, &rendered.variance];
        self.dispatch(encoder, &self.render, &bound.map(wgpu::Buffer::as_entire_binding));
        rendered
    }

    /// Records the conversion of a linear colour to a picture.
    fn show(&self, encoder: &mut wgpu::CommandEncoder, color: &wgpu::Buffer, picture: &wgpu::Texture) {
        let view = picture.create_view(&wgpu::TextureViewDescriptor::default());
        self.dispatch(encoder, &self.show, &[color.as_entire_binding(), wgpu::BindingResource::TextureView(&view)]);
    }

    fn dispatch(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        pipeline: &wgpu::ComputePipeline,
        resources: &[wgpu::BindingResource],
    ) {
        let entries: Vec<_> = (0..)
            .zip(resources)
            .map(|(binding, resource)| wgpu::BindGroupEntry { binding, resource: resource.clone() })
            .collect();
        let layout = pipeline.get_bind_group_layout(0);
        let group = self.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: None,
            layout: &layout,
            entries: &entries,
        });
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
        pass.set_pipeline(pipeline);
        pass.set_bind_group(0, &group, &[]);
        pass.dispatch_workgroups(WIDTH.div_ceil(8), HEIGHT.div_ceil(8), 1);
    }

    fn picture(&self) -> wgpu::Texture {
        self.device.create_texture(&wgpu::TextureDescriptor {
            label: None,
            size: wgpu::Extent3d { width: WIDTH, height: HEIGHT, depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: wgpu::TextureFormat::Rgba8Unorm,
            usage: wgpu::TextureUsages::STORAGE_BINDING | wgpu::TextureUsages::COPY_SRC,
            view_formats: &[],
        })
    }

    /// Returns the picture as RGBA, 8 bits each, row by row.
    fn read(&self, picture: &wgpu::Texture) -> Result<Vec<u8>, Box<dyn Error>> {
        let staging = self.buffer(4 * WIDTH * HEIGHT, wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ);
        let mut encoder = self.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let layout = wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(4 * WIDTH), rows_per_image: None };
        encoder.copy_texture_to_buffer(
            picture.as_image_copy(),
            wgpu::TexelCopyBufferInfo { buffer: &staging, layout },
            picture.size(),
        );
        self.queue.submit([encoder.finish()]);
        let (sender, receiver) = std::sync::mpsc::channel();
        staging.map_async(wgpu::MapMode::Read, .., move |result| drop(sender.send(result)));
        self.device.poll(wgpu::PollType::wait_indefinitely())?;
        receiver.recv()??;
        Ok(staging.get_mapped_range(..)?.to_vec())
    }
}

/// Returns the mean difference of neighbouring pixels within the squares of the floor at the bottom, relative to white.
fn grain(picture: &[u8]) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for y in 120..124 {
        for x in (2..WIDTH - 1).filter(|x| (2..22).contains(&(x % 24))) {
            let green = |x: u32| f64::from(picture[(4 * (y * WIDTH + x) + 1) as usize]) / 255.0;
            sum += (green(x) - green(x - 1)).abs();
            count += 1.0;
        }
    }
    sum / count
}

/// Returns both pictures side by side, as a PPM file.
fn ppm(pictures: &[Vec<u8>; 2]) -> Vec<u8> {
    let mut file = format!("P6 {} {HEIGHT} 255\n", 2 * WIDTH).into_bytes();
    for row in 0..HEIGHT as usize {
        for picture in pictures {
            let pixels = picture[4 * row * WIDTH as usize..].chunks_exact(4).take(WIDTH as usize);
            file.extend(pixels.flat_map(|pixel| pixel[..3].to_vec()));
        }
    }
    file
}

#[cfg(test)]
mod tests {
    use super::{grain, render_and_denoise};

    #[test]
    fn the_picture_that_is_shown_is_denoised() {
        let pictures = render_and_denoise().unwrap_or_else(|error| panic!("{error}"));
        let [before, after] = [grain(&pictures[0]), grain(&pictures[1])];
        assert!(before > 0.05 && after < 0.2 * before, "the grain of {before} became {after}");
        let mean = |picture: &[u8]| picture.iter().map(|value| f64::from(*value)).sum::<f64>() / picture.len() as f64;
        let [before, after] = [mean(&pictures[0]), mean(&pictures[1])];
        assert!((after / before - 1.0).abs() < 0.05, "the brightness of {before} became {after}");
    }
}
