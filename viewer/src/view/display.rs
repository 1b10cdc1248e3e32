//! Values to colours on the GPU: layers as textures, and a draw for each view of them.

use std::cell::Cell;
use std::collections::HashMap;
use std::sync::Arc;

use eframe::egui::{PaintCallback, PaintCallbackInfo, Rect};
use eframe::egui_wgpu::{Callback, CallbackResources, CallbackTrait, ScreenDescriptor};
use eframe::wgpu;
use stein::glam;
use stein::gpu::UniformLayout;

use super::colormap::{self, Colormap};
use super::{Channel, Tone};
use crate::layer::{Kind, Range, Scale, Shown};

const SHADER: &str = include_str!("display.wgsl");
/// Constant ε that keeps the relative differences of dark pixels finite.
pub const RELATIVE_EPSILON: f32 = 0.01;
/// Number of bytes from the uniforms of one draw to those of the next: no device needs a larger distance.
const SLOT_BYTES: u64 = 256;
/// Number of frames for which a texture is kept after it was last drawn.
const FRAMES_KEPT: u64 = 120;
/// Largest number of taps along each axis, for images that are reduced.
const MOST_TAPS: f32 = 8.0;

/// Operation on the two layers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Operation {
    /// A alone.
    #[default]
    Single = 0,
    /// A − B.
    Difference = 1,
    /// (A − B)/(|B| + ε).
    Relative = 2,
}

/// One view of one layer, or of two that are compared.
#[derive(Clone, Debug)]
pub struct Draw {
    /// Layer A.
    pub a: Shown,
    /// Layer B, of the same extent; `None` shows A alone.
    pub b: Option<Shown>,
    /// Meaning of the values of A.
    pub kind: Kind,
    /// Operation on the two layers.
    pub operation: Operation,
    /// Position in the image of the target's pixel (0, 0), in pixels of the image.
    pub first: [f32; 2],
    /// Pixels of the image per pixel of the target.
    pub step: f32,
    /// Channels that are shown.
    pub channel: Channel,
    /// Curve from scene-linear colour to the screen.
    pub tone: Tone,
    /// Exposure, in stops.
    pub exposure: f32,
    /// Offset that is added to colours after the exposure.
    pub offset: f32,
    /// γ of [`Tone::Gamma`].
    pub gamma: f32,
    /// Ends of the false-colour scale.
    pub range: Range,
    /// Steps of the false-colour scale.
    pub scale: Scale,
    /// Colours of the false-colour scale.
    pub colormap: Colormap,
    /// Background colour around the image, sRGB.
    pub background: [f32; 3],
}

stein::gpu::uniforms! {
    /// Members of the shader's uniform struct `Draw`.
    struct DrawUniforms {
        first: glam::Vec2,
        step: glam::Vec2,
        size: glam::UVec2,
        planes_a: u32,
        planes_b: u32,
        channel: u32,
        colormap: u32,
        taps: u32,
        epsilon: f32,
        factor: f32,
        offset: f32,
        inverse_gamma: f32,
        low: f32,
        high: f32,
        background: glam::Vec4,
    }
}

/// Settings that a pipeline is built for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Variant {
    kind: u32,
    operation: Operation,
    tone: Tone,
    is_log: bool,
    reduces: bool,
}

impl Variant {
    /// Returns the values of the shader's overrides.
    fn constants(self, encodes: bool) -> [(&'static str, f64); 6] {
        [
            ("KIND", self.kind.into()),
            ("OPERATION", f64::from(self.operation as u32)),
            ("TONE", f64::from(self.tone as u32)),
            ("IS_LOG", u32::from(self.is_log).into()),
            ("REDUCES", u32::from(self.reduces).into()),
            ("ENCODES", u32::from(encodes).into()),
        ]
    }
}

impl Draw {
    fn diverges(&self) -> bool {
        self.scale == Scale::Diverging || self.operation != Operation::Single
    }

    /// Returns the settings of the pipeline. Those without effect are set to fixed values, so that draws can share a
    /// pipeline.
    fn variant(&self) -> Variant {
        let kind = match self.kind {
            _ if self.operation != Operation::Single => 2,
            Kind::Color => 0,
            Kind::Direction => 1,
            Kind::Scalar(_) => 2,
            Kind::Shares => 3,
        };
        Variant {
            kind,
            operation: self.operation,
            tone: if kind == 0 { self.tone } else { Tone::Srgb },
            is_log: kind == 2 && self.scale == Scale::Log && !self.diverges(),
            reduces: self.step > 1.0,
        }
    }

    fn uniforms(&self) -> DrawUniforms {
        let extent = self.a.image.extent;
        let [red, green, blue] = self.background;
        let row = |map: Colormap| Colormap::ALL.iter().position(|other| *other == map).unwrap_or(0) as u32;
        DrawUniforms {
            first: self.first.into(),
            step: glam::Vec2::splat(self.step),
            size: glam::uvec2(extent.width, extent.height),
            planes_a: self.a.image.channels() as u32,
            planes_b: self.b.as_ref().map_or(1, |b| b.image.channels() as u32),
            channel: self.channel as u32,
            colormap: row(if self.diverges() { Colormap::Diverging } else { self.colormap }),
            taps: self.step.ceil().clamp(1.0, MOST_TAPS) as u32,
            epsilon: RELATIVE_EPSILON,
            factor: self.exposure.exp2(),
            offset: self.offset,
            inverse_gamma: 1.0 / self.gamma,
            low: self.range.low,
            high: self.range.high,
            background: glam::vec4(red, green, blue, 1.0),
        }
    }
}

/// Numbers the draws of a frame; each of them has its own slot for uniforms.
#[derive(Debug)]
pub struct Slots {
    layout: Arc<UniformLayout<DrawUniforms>>,
    frame: u64,
    /// Number of draws of this frame. Panels that paint only read the view, so that this number changes behind a shared
    /// reference.
    used: Cell<u32>,
    format: wgpu::TextureFormat,
}

impl Slots {
    /// Compares [`DrawUniforms`] with the shader. [`Slots::begin`] comes before the first draw.
    ///
    /// # Errors
    /// [`stein::Error::Shader`] if names or types of the members differ.
    pub fn new() -> stein::Result<Self> {
        let layout = Arc::new(UniformLayout::from_source("display", SHADER, "draw")?);
        Ok(Self { layout, frame: 0, used: Cell::new(0), format: wgpu::TextureFormat::Rgba8Unorm })
    }

    /// Begins a frame, which is drawn to a target of this format.
    pub fn begin(&mut self, format: wgpu::TextureFormat) {
        self.frame += 1;
        self.used.set(0);
        self.format = format;
    }

    /// Returns a shape that shows `draw` in a rectangle of the window.
    pub fn paint(&self, rect: Rect, draw: Draw) -> PaintCallback {
        let slot = self.used.get();
        self.used.set(slot + 1);
        let layout = self.layout.clone();
        Callback::new_paint_callback(rect, Paint { draw, layout, slot, frame: self.frame, format: self.format })
    }
}

struct Paint {
    draw: Draw,
    layout: Arc<UniformLayout<DrawUniforms>>,
    slot: u32,
    frame: u64,
    format: wgpu::TextureFormat,
}

impl Paint {
    fn key(&self) -> [u64; 2] {
        [self.draw.a.id, self.draw.b.as_ref().map_or(self.draw.a.id, |b| b.id)]
    }
}

impl CallbackTrait for Paint {
    fn prepare(
        &self,
        device: &wgpu::Device,
        queue: &wgpu::Queue,
        _screen: &ScreenDescriptor,
        _encoder: &mut wgpu::CommandEncoder,
        resources: &mut CallbackResources,
    ) -> Vec<wgpu::CommandBuffer> {
        let resources = resources
            .entry::<Resources>()
            .or_insert_with(|| Resources::new(device, queue, self.format, self.layout.clone()));
        resources.forget_before(self.frame.saturating_sub(FRAMES_KEPT));
        let shown = [Some(&self.draw.a), self.draw.b.as_ref()];
        for shown in shown.into_iter().flatten() {
            resources.upload(device, queue, shown, self.frame);
        }
        resources.bind(device, self.key());
        resources.build(device, self.draw.variant());
        resources.write(device, queue, self.slot, &self.draw.uniforms());
        Vec::new()
    }

    fn paint(&self, _info: PaintCallbackInfo, pass: &mut wgpu::RenderPass<'static>, resources: &CallbackResources) {
        let Some(resources) = resources.get::<Resources>() else { return };
        let Some(group) = resources.groups.get(&self.key()) else { return };
        let Some(pipeline) = resources.pipelines.get(&self.draw.variant()) else { return };
        pass.set_pipeline(pipeline);
        pass.set_bind_group(0, &resources.draw_group, &[self.slot * SLOT_BYTES as u32]);
        pass.set_bind_group(1, group, &[]);
        pass.draw(0..3, 0..1);
    }
}

struct Texture {
    view: wgpu::TextureView,
    last_drawn: u64,
}

/// Resources that the draws of a window share.
struct Resources {
    format: wgpu::TextureFormat,
    layout: Arc<UniformLayout<DrawUniforms>>,
    module: wgpu::ShaderModule,
    draw_layout: wgpu::BindGroupLayout,
    layers_layout: wgpu::BindGroupLayout,
    pipeline_layout: wgpu::PipelineLayout,
    pipelines: HashMap<Variant, wgpu::RenderPipeline>,
    uniforms: wgpu::Buffer,
    colors: wgpu::TextureView,
    draw_group: wgpu::BindGroup,
    textures: HashMap<u64, Texture>,
    groups: HashMap<[u64; 2], wgpu::BindGroup>,
}

impl Resources {
    fn new(
        device: &wgpu::Device,
        queue: &wgpu::Queue,
        format: wgpu::TextureFormat,
        layout: Arc<UniformLayout<DrawUniforms>>,
    ) -> Self {
        let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some("display"),
            source: wgpu::ShaderSource::Wgsl(SHADER.into()),
        });
        let texture = |binding| wgpu::BindGroupLayoutEntry {
            binding,
            visibility: wgpu::ShaderStages::FRAGMENT,
            ty: wgpu::BindingType::Texture {
                sample_type: wgpu::TextureSampleType::Float { filterable: false },
                view_dimension: wgpu::TextureViewDimension::D2,
                multisampled: false,
            },
            count: None,
        };
        let uniforms = wgpu::BindGroupLayoutEntry {
            binding: 0,
            visibility: wgpu::ShaderStages::FRAGMENT,
            ty: wgpu::BindingType::Buffer {
                ty: wgpu::BufferBindingType::Uniform,
                has_dynamic_offset: true,
                min_binding_size: wgpu::BufferSize::new(layout.bytes()),
            },
            count: None,
        };
        let group_layout = |label, entries: &[wgpu::BindGroupLayoutEntry]| {
            device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some(label), entries })
        };
        let draw_layout = group_layout("draw", &[uniforms, texture(1)]);
        let layers_layout = group_layout("layers", &[texture(0), texture(1)]);
        let pipeline_layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some("display"),
            bind_group_layouts: &[Some(&draw_layout), Some(&layers_layout)],
            immediate_size: 0,
        });
        let colors = upload(device, queue, colormap::STEPS as u32, Colormap::ALL.len() as u32, &colormap::table());
        let uniforms = uniform_buffer(device, 64);
        let draw_group = bind_draw(device, &draw_layout, &uniforms, layout.bytes(), &colors);
        Self {
            format,
            layout,
            module,
            draw_layout,
            layers_layout,
            pipeline_layout,
            pipelines: HashMap::new(),
            uniforms,
            colors,
            draw_group,
            textures: HashMap::new(),
            groups: HashMap::new(),
        }
    }

    fn build(&mut self, device: &wgpu::Device, variant: Variant) {
        self.pipelines.entry(variant).or_insert_with(|| {
            device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
                label: Some("display"),
                layout: Some(&self.pipeline_layout),
                vertex: wgpu::VertexState {
                    module: &self.module,
                    entry_point: Some("cover"),
                    compilation_options: Default::default(),
                    buffers: &[],
                },
                fragment: Some(wgpu::FragmentState {
                    module: &self.module,
                    entry_point: Some("paint"),
                    compilation_options: wgpu::PipelineCompilationOptions {
                        constants: &variant.constants(self.format.is_srgb()),
                        ..Default::default()
                    },
                    targets: &[Some(self.format.into())],
                }),
                primitive: Default::default(),
                depth_stencil: None,
                multisample: Default::default(),
                multiview_mask: None,
                cache: None,
            })
        });
    }

    /// Uploads the values of a layer as a texture, unless it is there already.
    fn upload(&mut self, device: &wgpu::Device, queue: &wgpu::Queue, shown: &Shown, frame: u64) {
        let texture = self.textures.entry(shown.id).or_insert_with(|| {
            let image = &shown.image;
            let pixel = |pixel: usize| {
                let value = |plane: usize| image.planes.get(plane).map_or(0.0, |plane| plane[pixel]);
                if image.channels() == 1 { [value(0); 4] } else { [value(0), value(1), value(2), 0.0] }
            };
            let pixels: Vec<[f32; 4]> = (0..image.extent.pixels()).map(pixel).collect();
            Texture { view: upload(device, queue, image.extent.width, image.extent.height, &pixels), last_drawn: frame }
        });
        texture.last_drawn = frame;
    }

    fn bind(&mut self, device: &wgpu::Device, key: [u64; 2]) {
        let (Some(a), Some(b)) = (self.textures.get(&key[0]), self.textures.get(&key[1])) else { return };
        self.groups.entry(key).or_insert_with(|| {
            device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some("layers"),
                layout: &self.layers_layout,
                entries: &[
                    wgpu::BindGroupEntry { binding: 0, resource: wgpu::BindingResource::TextureView(&a.view) },
                    wgpu::BindGroupEntry { binding: 1, resource: wgpu::BindingResource::TextureView(&b.view) },
                ],
            })
        });
    }

    /// Writes the uniforms of a draw to its slot. The buffer grows if it has too few slots.
    fn write(&mut self, device: &wgpu::Device, queue: &wgpu::Queue, slot: u32, uniforms: &DrawUniforms) {
        let offset = u64::from(slot) * SLOT_BYTES;
        if offset + SLOT_BYTES > self.uniforms.size() {
            let grown = uniform_buffer(device, 2 * (slot + 1));
            let mut encoder = device.create_command_encoder(&Default::default());
            encoder.copy_buffer_to_buffer(&self.uniforms, 0, &grown, 0, self.uniforms.size());
            queue.submit([encoder.finish()]);
            self.uniforms = grown;
            self.draw_group = bind_draw(device, &self.draw_layout, &self.uniforms, self.layout.bytes(), &self.colors);
        }
        queue.write_buffer(&self.uniforms, offset, &self.layout.encode(uniforms));
    }

    fn forget_before(&mut self, frame: u64) {
        let textures = self.textures.len();
        self.textures.retain(|_, texture| texture.last_drawn >= frame);
        if self.textures.len() < textures {
            self.groups.retain(|ids, _| ids.iter().all(|id| self.textures.contains_key(id)));
        }
    }
}

fn uniform_buffer(device: &wgpu::Device, slots: u32) -> wgpu::Buffer {
    device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("draws"),
        size: u64::from(slots) * SLOT_BYTES,
        usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::COPY_SRC,
        mapped_at_creation: false,
    })
}

fn bind_draw(
    device: &wgpu::Device,
    layout: &wgpu::BindGroupLayout,
    uniforms: &wgpu::Buffer,
    uniform_bytes: u64,
    colors: &wgpu::TextureView,
) -> wgpu::BindGroup {
    let uniforms = wgpu::BufferBinding { buffer: uniforms, offset: 0, size: wgpu::BufferSize::new(uniform_bytes) };
    device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: Some("draw"),
        layout,
        entries: &[
            wgpu::BindGroupEntry { binding: 0, resource: wgpu::BindingResource::Buffer(uniforms) },
            wgpu::BindGroupEntry { binding: 1, resource: wgpu::BindingResource::TextureView(colors) },
        ],
    })
}

fn upload(
    device: &wgpu::Device,
    queue: &wgpu::Queue,
    width: u32,
    height: u32,
    pixels: &[[f32; 4]],
) -> wgpu::TextureView {
    let size = wgpu::Extent3d { width, height, depth_or_array_layers: 1 };
    let texture = device.create_texture(&wgpu::TextureDescriptor {
        label: Some("layer"),
        size,
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: wgpu::TextureFormat::Rgba32Float,
        usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
        view_formats: &[],
    });
    let layout =
        wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(width * 16), rows_per_image: Some(height) };
    queue.write_texture(texture.as_image_copy(), bytemuck::cast_slice(pixels), layout, size);
    texture.create_view(&Default::default())
}

#[cfg(test)]
mod tests {
    use super::*;

    stein::gpu::uniforms! {
        struct Misnamed { low: f32, hihg: f32 }
    }

    #[test]
    fn the_uniform_struct_is_the_shader_s() {
        let layout = Slots::new().expect("names and types are equal").layout;
        assert_eq!(layout.bytes(), 96);
        assert!(layout.bytes() <= SLOT_BYTES);
        // A name that the shader does not have is found.
        let source = "struct Draw { low: f32, high: f32 } @group(0) @binding(0) var<uniform> draw: Draw;";
        let error = UniformLayout::<Misnamed>::from_source("display", source, "draw").expect_err("hihg is not high");
        assert!(error.to_string().contains("'draw.high: f32' is not in the host struct Misnamed"), "{error}");
        assert!(UniformLayout::<Misnamed>::from_source("display", SHADER, "draw").is_err());
    }
}
