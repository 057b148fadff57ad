//! Pipelines whose bind group layouts are reflected from the shader, so that nothing has to be kept in sync by hand. A [`Shader`] is parsed
//! and reflected once. Its pipelines differ by the values of overrides.
//!
//! Uniform buffers of groups 0 and 2 are bound with a dynamic offset: one buffer holds the uniforms of a whole batch.

use std::borrow::Cow;

use naga::{AddressSpace, StorageAccess};

use super::Gpu;
use super::shader::{self, Composed, ShaderError};

/// Number of bind groups, by rate of change: 0 per frame, 1 per scene, 2 per pass.
pub const GROUPS: usize = 3;

/// A compute pipeline and its reflected layouts.
pub struct ComputePipeline {
    pub name: &'static str,
    pub pipeline: wgpu::ComputePipeline,
    pub layouts: [wgpu::BindGroupLayout; GROUPS],
    /// The bindings of each group, by ascending number.
    pub bindings: [Vec<BindingSlot>; GROUPS],
}

/// A binding as the shader declares it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BindingSlot {
    pub number: u32,
    /// The variable's name, which identifies its buffer.
    pub name: String,
    /// Whether it is bound with a dynamic offset.
    pub dynamic: bool,
    pub access: wgpu::BufferBindingType,
}

/// A render pipeline whose colour target is irrelevant: its fragments write to storage.
pub struct RasterPipeline {
    pub name: &'static str,
    pub pipeline: wgpu::RenderPipeline,
    pub layouts: [wgpu::BindGroupLayout; GROUPS],
    pub bindings: [Vec<BindingSlot>; GROUPS],
}

/// A shader and its reflected layouts.
pub struct Shader {
    name: &'static str,
    module: wgpu::ShaderModule,
    layouts: [wgpu::BindGroupLayout; GROUPS],
    bindings: [Vec<BindingSlot>; GROUPS],
    layout: wgpu::PipelineLayout,
}

impl Shader {
    /// Parses a composition. `stages`: those that bind its buffers.
    ///
    /// # Errors
    /// The WGSL does not parse, or a group number is over 2.
    pub fn new(
        gpu: &Gpu,
        name: &'static str,
        composed: &Composed,
        stages: wgpu::ShaderStages,
    ) -> Result<Self, ShaderError> {
        let parsed = shader::parse(name, composed)?;
        let (entries, bindings) = reflect(name, &parsed, stages)?;
        let layouts: [wgpu::BindGroupLayout; GROUPS] = std::array::from_fn(|group| {
            gpu.device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
                label: Some(name),
                entries: &entries[group],
            })
        });
        let layout = gpu.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some(name),
            bind_group_layouts: &[Some(&layouts[0]), Some(&layouts[1]), Some(&layouts[2])],
            immediate_size: 0,
        });
        let source = wgpu::ShaderSource::Naga(Cow::Owned(parsed));
        let descriptor = wgpu::ShaderModuleDescriptor { label: Some(name), source };
        let mut checks = wgpu::ShaderRuntimeChecks::checked();
        checks.force_loop_bounding = false;
        #[allow(
            unsafe_code,
            reason = "a counter in every loop costs a tenth of a frame on CPU adapters"
        )]
        // SAFETY: the check left out guards against loops without end. Each of ours counts something up to a bound that it does
        // not move: elements of a chunk, groups of a scan, entries of the list of large triangles (each no more than once), pixels
        // of a triangle's clamped box, lights, levels of a texture. Those that go down a tile's column end by votes, but take at
        // least one row off with every turn of every loop but the outermost, which ends with the rows.
        let module = unsafe { gpu.device.create_shader_module_trusted(descriptor, checks) };
        Ok(Self { name, module, layouts, bindings, layout })
    }
}

type Groups<T> = [Vec<T>; GROUPS];

/// Entries of the layouts and bindings of a module's groups, by ascending number.
fn reflect(
    name: &str,
    parsed: &naga::Module,
    stages: wgpu::ShaderStages,
) -> Result<(Groups<wgpu::BindGroupLayoutEntry>, Groups<BindingSlot>), ShaderError> {
    let mut entries: Groups<wgpu::BindGroupLayoutEntry> = Default::default();
    let mut bindings: Groups<BindingSlot> = Default::default();
    for (_, variable) in parsed.global_variables.iter() {
        let Some(binding) = &variable.binding else { continue };
        let group = binding.group as usize;
        let ty = match variable.space {
            AddressSpace::Uniform => wgpu::BufferBindingType::Uniform,
            AddressSpace::Storage { access } => wgpu::BufferBindingType::Storage {
                read_only: !access.contains(StorageAccess::STORE),
            },
            _ => continue,
        };
        let Some(list) = entries.get_mut(group) else {
            return Err(ShaderError::Invalid {
                name: name.to_owned(),
                message: format!("bind group {group} is over {}", GROUPS - 1),
            });
        };
        let dynamic = ty == wgpu::BufferBindingType::Uniform && group != 1;
        // Vertex stages may not write to storage, and ours do not.
        let written = ty == wgpu::BufferBindingType::Storage { read_only: false };
        list.push(wgpu::BindGroupLayoutEntry {
            binding: binding.binding,
            visibility: if written { stages - wgpu::ShaderStages::VERTEX } else { stages },
            ty: wgpu::BindingType::Buffer {
                ty,
                has_dynamic_offset: dynamic,
                min_binding_size: None,
            },
            count: None,
        });
        bindings[group].push(BindingSlot {
            number: binding.binding,
            name: variable.name.clone().unwrap_or_default(),
            dynamic,
            access: ty,
        });
    }
    for list in &mut entries {
        list.sort_by_key(|entry| entry.binding);
    }
    for list in &mut bindings {
        list.sort_by_key(|slot| slot.number);
    }
    Ok((entries, bindings))
}

impl ComputePipeline {
    /// Builds the pipeline of the entry point that has the shader's name, with the given values of overrides.
    pub fn new(gpu: &Gpu, shader: &Shader, constants: &[(&str, f64)]) -> Self {
        let pipeline = gpu.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(shader.name),
            layout: Some(&shader.layout),
            module: &shader.module,
            entry_point: Some(shader.name),
            compilation_options: wgpu::PipelineCompilationOptions {
                constants,
                zero_initialize_workgroup_memory: false,
            },
            cache: gpu.pipeline_cache.as_ref(),
        });
        let Shader { name, layouts, bindings, .. } = shader;
        Self { name, pipeline, layouts: layouts.clone(), bindings: bindings.clone() }
    }
}

impl RasterPipeline {
    /// Builds a pipeline of the entry points `vertex` and `fragment` over triangles, without culling, with the given values of
    /// overrides.
    pub fn new(gpu: &Gpu, shader: &Shader, constants: &[(&str, f64)]) -> Self {
        let compilation_options =
            wgpu::PipelineCompilationOptions { constants, ..Default::default() };
        let pipeline = gpu.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some(shader.name),
            layout: Some(&shader.layout),
            vertex: wgpu::VertexState {
                module: &shader.module,
                entry_point: Some("vertex"),
                compilation_options: compilation_options.clone(),
                buffers: &[],
            },
            primitive: wgpu::PrimitiveState::default(),
            depth_stencil: None,
            multisample: wgpu::MultisampleState::default(),
            fragment: Some(wgpu::FragmentState {
                module: &shader.module,
                entry_point: Some("fragment"),
                compilation_options,
                targets: &[Some(wgpu::ColorTargetState {
                    format: wgpu::TextureFormat::R8Unorm,
                    blend: None,
                    write_mask: wgpu::ColorWrites::empty(),
                })],
            }),
            multiview_mask: None,
            cache: gpu.pipeline_cache.as_ref(),
        });
        let Shader { name, layouts, bindings, .. } = shader;
        Self { name, pipeline, layouts: layouts.clone(), bindings: bindings.clone() }
    }
}
