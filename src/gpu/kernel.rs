//! Kernels: shaders that were compared with their host structs, and the pipelines made from them.

use std::sync::Arc;

use naga::{AddressSpace, Module, StorageAccess};

use super::bindings::{Bindings, Slot, SlotKind};
use super::cache::PipelineCache;
use super::device::Gpu;
use super::lock;
use super::shader::{Definition, Definitions, compose, compose_source};
use super::uniform_layout::{lay_out, undecorated};
use crate::error::{DeviceCause, Error, Result};

/// Identity of a kernel: kernels with equal keys are the same.
#[derive(Debug, PartialEq, Eq, Hash)]
pub(super) struct KernelKey {
    stage: String,
    /// The source of a shader that is not in `shaders/`.
    source: Option<String>,
    /// Definitions of the kernel, sorted by name.
    definitions: Vec<(String, Definition)>,
}

/// A compiled stage that fits its [`Bindings`].
#[derive(Debug)]
pub struct Kernel {
    stage: String,
    workgroup_size: [u32; 3],
    pub(super) slots: &'static [Slot],
    /// Binding of each slot; `None` for an optional slot that the shader does not declare.
    pub(super) places: Vec<Option<Place>>,
    pub(super) layout: wgpu::BindGroupLayout,
    pub(super) pipeline: wgpu::ComputePipeline,
}

/// Binding of a slot in the shader.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Place {
    pub(super) binding: u32,
    /// Size of a uniform struct, and in `offsets` the offset of each member in the order of the host's table, both in
    /// bytes. 0 and empty for buffers.
    pub(super) uniform_bytes: u32,
    pub(super) offsets: Vec<u32>,
}

impl Kernel {
    /// The stage, named as its file; times are summed under this name.
    pub fn stage(&self) -> &str {
        &self.stage
    }

    /// Invocations per workgroup in x, y and z, as the shader declares them.
    pub fn workgroup_size(&self) -> [u32; 3] {
        self.workgroup_size
    }
}

impl Gpu {
    /// Returns the kernel of a stage in `shaders/`. It is built once for each set of definitions, and kept.
    ///
    /// # Errors
    /// [`Error::Shader`] where the shader does not compile or does not fit `B`; [`Error::Device`] where it needs more
    /// than the adapter has.
    pub fn kernel<B: Bindings>(&self, stage: &str, definitions: Definitions) -> Result<Arc<Kernel>> {
        self.find_or_build(stage, None, definitions, B::SLOTS)
    }

    /// Returns the kernel of a shader that is not in `shaders/`, for tests and embedders. The shader runs without
    /// bounds checks, except under [`GpuOptions::checked_shaders`](super::GpuOptions::checked_shaders): it must keep to
    /// the house rules in [`gpu`](super).
    ///
    /// # Errors
    /// As [`Gpu::kernel`].
    pub fn kernel_from_source<B: Bindings>(
        &self,
        name: &str,
        source: &str,
        definitions: Definitions,
    ) -> Result<Arc<Kernel>> {
        self.find_or_build(name, Some(source), definitions, B::SLOTS)
    }

    fn find_or_build(
        &self,
        stage: &str,
        source: Option<&str>,
        definitions: Definitions,
        slots: &'static [Slot],
    ) -> Result<Arc<Kernel>> {
        self.check()?;
        let mut sorted: Vec<_> = definitions.iter().map(|(name, value)| ((*name).to_owned(), *value)).collect();
        sorted.sort_by(|a, b| a.0.cmp(&b.0));
        let key = KernelKey { stage: stage.into(), source: source.map(str::to_owned), definitions: sorted };
        // The lock is held while the kernel is built: a second thread that needs the same kernel waits instead of
        // building it again.
        let mut kernels = lock(&self.inner.kernels);
        if let Some(kernel) = kernels.get(&key) {
            let same = kernel.slots == slots;
            return if same {
                Ok(Arc::clone(kernel))
            } else {
                Err(failure(stage, "two different host structs are bound to it".into()))
            };
        }
        let module = match source {
            Some(source) => compose_source(stage, source, definitions)?,
            None => compose(stage, definitions)?,
        };
        let kernel = Arc::new(self.build(stage, module, slots)?);
        kernels.insert(key, Arc::clone(&kernel));
        Ok(kernel)
    }

    /// Returns the number of kernels that are kept.
    pub fn kernel_count(&self) -> usize {
        lock(&self.inner.kernels).len()
    }

    fn build(&self, stage: &str, mut module: Module, slots: &'static [Slot]) -> Result<Kernel> {
        let places = place(&module, slots).map_err(|problem| failure(stage, problem))?;
        let workgroup_size = workgroup_size(&module).map_err(|problem| failure(stage, problem))?;
        self.check_limits(stage, &module, slots, &places, workgroup_size)?;

        let uniforms = self.uniform_binding();
        if uniforms != wgpu::BufferBindingType::Uniform {
            for (_, global) in
                module.global_variables.iter_mut().filter(|(_, global)| global.space == AddressSpace::Uniform)
            {
                global.space = AddressSpace::Storage { access: StorageAccess::LOAD };
            }
        }
        let entries: Vec<_> = slots
            .iter()
            .zip(&places)
            .filter_map(|(slot, place)| Some(layout_entry(slot, place.as_ref()?, uniforms)))
            .collect();
        let checks = if self.inner.options.checked_shaders {
            wgpu::ShaderRuntimeChecks::checked()
        } else {
            wgpu::ShaderRuntimeChecks::unchecked()
        };
        let device = &self.inner.device;
        let build = || {
            let layout = device
                .create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some(stage), entries: &entries });
            let pipeline_layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
                label: Some(stage),
                bind_group_layouts: &[Some(&layout)],
                immediate_size: 0,
            });
            let source = wgpu::ShaderSource::Naga(std::borrow::Cow::Owned(module));
            let description = wgpu::ShaderModuleDescriptor { label: Some(stage), source };
            #[expect(
                unsafe_code,
                reason = "unchecked shaders save up to a third of the time; the test suite runs ours with checks, too"
            )]
            // SAFETY: without checks, a shader must index only within its buffers and loop a bounded number of times.
            // The shaders of this crate do so, and `kernel_from_source` demands it of all other shaders.
            let shader = unsafe { device.create_shader_module_trusted(description, checks) };
            let pipeline = device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some(stage),
                layout: Some(&pipeline_layout),
                module: &shader,
                entry_point: Some("main"),
                compilation_options: wgpu::PipelineCompilationOptions {
                    zero_initialize_workgroup_memory: self.inner.options.checked_shaders,
                    ..Default::default()
                },
                cache: self.inner.pipeline_cache.as_ref().map(PipelineCache::wgpu),
            });
            (layout, pipeline)
        };
        let (layout, pipeline) = self.guarded(build).map_err(|error| failure(stage, error.to_string()))?;
        self.check()?;
        Ok(Kernel { stage: stage.into(), workgroup_size, slots, places, layout, pipeline })
    }

    /// Returns the type of buffer that uniform structs are bound as: storage buffers on a software adapter that has
    /// enough of them. Mesa's software driver reads values that loops and branches depend on from uniform buffers and
    /// compiles them into the shader, again for each value that a dispatch brings. On llvmpipe this costs 4.4 ms for
    /// each dispatch of `candidate_accumulate`, and half a second for each new size of an image. The driver does not do
    /// this with storage buffers.
    pub(super) fn uniform_binding(&self) -> wgpu::BufferBindingType {
        let has_to_spare = self.inner.limits.max_storage_buffers_per_shader_stage
            > wgpu::Limits::default().max_storage_buffers_per_shader_stage;
        if self.is_software() && has_to_spare {
            wgpu::BufferBindingType::Storage { read_only: true }
        } else {
            wgpu::BufferBindingType::Uniform
        }
    }

    fn check_limits(
        &self,
        stage: &str,
        module: &Module,
        slots: &[Slot],
        places: &[Option<Place>],
        size: [u32; 3],
    ) -> Result<()> {
        let limits = &self.inner.limits;
        let as_storage = self.uniform_binding() != wgpu::BufferBindingType::Uniform;
        let is_storage = |(slot, place): &(&Slot, &Option<Place>)| {
            place.is_some() && (as_storage || !matches!(slot.kind, SlotKind::Uniform { .. }))
        };
        let storage_buffers = slots.iter().zip(places).filter(is_storage).count();
        let invocations = size.iter().map(|n| u64::from(*n)).product::<u64>();
        let shared = module.global_variables.iter().filter(|(_, global)| global.space == AddressSpace::WorkGroup);
        let shared_bytes =
            shared.map(|(_, global)| u64::from(module.types[global.ty].inner.size(module.to_ctx()))).sum::<u64>();
        let widest = [
            limits.max_compute_workgroup_size_x,
            limits.max_compute_workgroup_size_y,
            limits.max_compute_workgroup_size_z,
        ];
        let needs = [
            (storage_buffers as u64, limits.max_storage_buffers_per_shader_stage, "storage buffers"),
            (invocations, limits.max_compute_invocations_per_workgroup, "invocations per workgroup"),
            (u64::from(size[0]), widest[0], "invocations per workgroup in x"),
            (u64::from(size[1]), widest[1], "invocations per workgroup in y"),
            (u64::from(size[2]), widest[2], "invocations per workgroup in z"),
            (shared_bytes, limits.max_compute_workgroup_storage_size, "bytes of workgroup memory"),
        ];
        for (need, limit, what) in needs {
            if need > u64::from(limit) {
                return Err(Error::Device(DeviceCause::StageTooLarge {
                    stage: stage.into(),
                    what,
                    needed: need,
                    limit: limit.into(),
                    adapter: self.inner.summary.name.clone(),
                }));
            }
        }
        Ok(())
    }
}

fn failure(stage: &str, problem: String) -> Error {
    Error::Shader { stage: stage.into(), problem }
}

fn layout_entry(slot: &Slot, place: &Place, uniforms: wgpu::BufferBindingType) -> wgpu::BindGroupLayoutEntry {
    let ty = match slot.kind {
        SlotKind::Uniform { .. } => uniforms,
        SlotKind::Read | SlotKind::Optional => wgpu::BufferBindingType::Storage { read_only: true },
        SlotKind::Write => wgpu::BufferBindingType::Storage { read_only: false },
    };
    wgpu::BindGroupLayoutEntry {
        binding: place.binding,
        visibility: wgpu::ShaderStages::COMPUTE,
        ty: wgpu::BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None },
        count: None,
    }
}

fn workgroup_size(module: &Module) -> std::result::Result<[u32; 3], String> {
    let [entry] = module.entry_points.as_slice() else {
        return Err(format!("it has {} entry points instead of one", module.entry_points.len()));
    };
    if entry.stage != naga::ShaderStage::Compute || entry.name != "main" {
        return Err(format!(
            "its entry point is '{}' ({:?}) instead of the compute shader 'main'",
            entry.name, entry.stage
        ));
    }
    if entry.workgroup_size_overrides.is_some() {
        return Err(
            "its workgroup size depends on an override; use a definition instead, as in @workgroup_size(#{WIDTH})"
                .into(),
        );
    }
    Ok(entry.workgroup_size)
}

/// Finds the binding of every slot in the shader. Fails if the shader has a binding without a slot, or lacks a slot
/// that is not optional.
fn place(module: &Module, slots: &[Slot]) -> std::result::Result<Vec<Option<Place>>, String> {
    let mut places = vec![None; slots.len()];
    for (_, global) in module.global_variables.iter() {
        let Some(resource) = &global.binding else { continue };
        let name = undecorated(global.name.as_deref());
        if resource.group != 0 {
            return Err(format!("'{name}' is in @group({}); all bindings belong to @group(0)", resource.group));
        }
        let declared =
            declaration(global.space).ok_or_else(|| format!("'{name}' is neither a uniform nor a storage buffer"))?;
        let Some(index) = slots.iter().position(|slot| slot.name == name) else {
            return Err(format!(
                "the shader declares '{declared} {name}', which the host does not bind (it binds {})",
                names(slots)
            ));
        };
        let kind = slots[index].kind;
        if kind.declaration() != declared {
            return Err(format!(
                "the shader declares '{declared} {name}', but the host binds it as '{}'",
                kind.declaration()
            ));
        }
        let (uniform_bytes, offsets) = match kind {
            SlotKind::Uniform { host, members } => lay_out(module, global, host, members)?,
            SlotKind::Read | SlotKind::Optional | SlotKind::Write => (0, Vec::new()),
        };
        places[index] = Some(Place { binding: resource.binding, uniform_bytes, offsets });
    }
    for (slot, place) in slots.iter().zip(&places) {
        if place.is_none() && slot.kind != SlotKind::Optional {
            return Err(format!(
                "the host binds '{}', but the shader has no '{} {}'",
                slot.name,
                slot.kind.declaration(),
                slot.name
            ));
        }
    }
    Ok(places)
}

fn names(slots: &[Slot]) -> String {
    slots.iter().map(|slot| format!("'{}'", slot.name)).collect::<Vec<_>>().join(", ")
}

fn declaration(space: AddressSpace) -> Option<&'static str> {
    match space {
        AddressSpace::Uniform => Some("var<uniform>"),
        AddressSpace::Storage { access } if access.contains(StorageAccess::STORE) => Some("var<storage, read_write>"),
        AddressSpace::Storage { .. } => Some("var<storage, read>"),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::super::shader::Pieces;
    use super::*;
    use crate::{bindings, uniforms};

    /// Pieces in an order in which the first piece imports the second.
    const SHARED: &[(&str, &str)] = &[
        (
            "planes",
            "#define_import_path stein::planes
            #import stein::guard::at_least_zero
            struct Planes { margin: i32, extent: vec2<u32> }
            fn index(planes: Planes, x: i32) -> u32 { return u32(at_least_zero(x + planes.margin)); }",
        ),
        (
            "guard",
            "#define_import_path stein::guard
            fn at_least_zero(x: i32) -> i32 { return max(x, #{FLOOR}); }",
        ),
    ];

    const STAGE: &str = "
        #import stein::planes::{Planes, index}
        struct Params { gain: f32, @align(16) planes: Planes }
        @group(0) @binding(3) var<storage, read_write> result: array<f32>;
        @group(0) @binding(0) var<uniform> params: Params;
        @compute @workgroup_size(64)
        fn main(@builtin(global_invocation_id) id: vec3<u32>) {
            result[index(params.planes, i32(id.x))] = params.gain;
        }";

    uniforms! {
        struct Planes { extent: glam::UVec2, margin: i32 }
        struct Params { planes: Planes, gain: f32 }
    }

    bindings! {
        struct Fill<'a> { uniform params: Params, write result }
    }

    fn composed(shared: &'static [(&str, &str)], definitions: Definitions) -> std::result::Result<Module, String> {
        Pieces::read(shared)?.compose("fill", STAGE, definitions)
    }

    #[test]
    fn structs_of_imported_pieces_are_laid_out_by_the_shader() {
        let module = composed(SHARED, &[("FLOOR", 0.into())]).expect("it composes");
        let places = place(&module, Fill::SLOTS).expect("it fits");
        let params = Place { binding: 0, uniform_bytes: 32, offsets: vec![16 + 8, 16, 0] };
        assert_eq!(places, [Some(params), Some(Place { binding: 3, uniform_bytes: 0, offsets: vec![] })]);
        assert_eq!(workgroup_size(&module), Ok([64, 1, 1]));
    }

    #[test]
    fn a_mistake_in_an_imported_piece_is_told_with_its_file() {
        const BROKEN: &[(&str, &str)] = &[
            SHARED[0],
            ("guard", "#define_import_path stein::guard\nfn at_least_zero(x: i32) -> i32 { return max(x, 0.5); }"),
        ];
        let text = composed(BROKEN, &[]).expect_err("a float is no integer");
        assert!(text.contains("shaders/shared/guard.wgsl"), "{text}");
        let text = composed(SHARED.split_at(1).0, &[]).expect_err("a piece is missing");
        assert!(text.contains("shaders/shared/planes.wgsl") && text.contains("stein::guard"), "{text}");
    }
}
