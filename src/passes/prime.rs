//! Builds pipelines ahead of the frames that will need them.
//!
//! Drivers of GPUs compile a shader when its pipeline is built. Lavapipe compiles when the pipeline is first dispatched, on
//! its queue; there, [`Prime`] also dispatches each pipeline over no workgroups, with empty buffers bound.

use super::pipelines::{Pipelines, Variant};
use super::uniforms::VIEWS_WINDOW;
use crate::gpu::Gpu;
use crate::gpu::pipeline::{BindingSlot, ComputePipeline};
use crate::gpu::shader::ShaderError;

/// No fixed part of a binding is longer, in bytes: the longest are the records of views.
const EMPTY_BYTES: u64 = VIEWS_WINDOW;

/// Buffers of pipelines that are launched over nothing, one for each way of access.
pub struct Prime<'a> {
    gpu: &'a Gpu,
    uniform: wgpu::Buffer,
    read: wgpu::Buffer,
    write: wgpu::Buffer,
}

impl<'a> Prime<'a> {
    pub fn new(gpu: &'a Gpu) -> Self {
        let buffer = |usage| {
            gpu.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("prime"),
                size: EMPTY_BYTES,
                usage,
                mapped_at_creation: false,
            })
        };
        let (uniform, storage) = (wgpu::BufferUsages::UNIFORM, wgpu::BufferUsages::STORAGE);
        Self { gpu, uniform: buffer(uniform), read: buffer(storage), write: buffer(storage) }
    }

    /// Builds a pipeline and has the driver compile it; whether a submission is under way that does.
    ///
    /// # Errors
    /// The shader or the driver refuses the pipeline. Frames are not affected.
    pub fn build(&self, pipelines: &Pipelines, variant: &Variant) -> Result<bool, ShaderError> {
        let device = &self.gpu.device;
        let scope = device.push_error_scope(wgpu::ErrorFilter::Validation);
        let check = || refused(variant, scope);
        let built = pipelines.build(self.gpu, variant, check)?;
        let Some(pipeline) = built.filter(|_| self.gpu.is_cpu) else { return Ok(false) };
        let scope = device.push_error_scope(wgpu::ErrorFilter::Validation);
        self.dispatch_nothing(&pipeline);
        refused(variant, scope)?;
        Ok(true)
    }

    fn dispatch_nothing(&self, pipeline: &ComputePipeline) {
        let device = &self.gpu.device;
        let mut encoder =
            device.create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some("prime") });
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("prime"),
            timestamp_writes: None,
        });
        pass.set_pipeline(&pipeline.pipeline);
        for (number, (layout, slots)) in pipeline.layouts.iter().zip(&pipeline.bindings).enumerate()
        {
            let entries: Vec<wgpu::BindGroupEntry> =
                slots.iter().map(|slot| self.bound(slot)).collect();
            let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some("prime"),
                layout,
                entries: &entries,
            });
            let offsets = vec![0; slots.iter().filter(|slot| slot.dynamic).count()];
            pass.set_bind_group(number as u32, &group, &offsets);
        }
        pass.dispatch_workgroups(0, 0, 0);
        drop(pass);
        self.gpu.queue.submit([encoder.finish()]);
    }

    fn bound(&self, slot: &BindingSlot) -> wgpu::BindGroupEntry<'_> {
        let buffer = match slot.access {
            wgpu::BufferBindingType::Uniform => &self.uniform,
            wgpu::BufferBindingType::Storage { read_only: true } => &self.read,
            wgpu::BufferBindingType::Storage { read_only: false } => &self.write,
        };
        wgpu::BindGroupEntry { binding: slot.number, resource: buffer.as_entire_binding() }
    }
}

/// Error of the driver within the scope.
fn refused(variant: &Variant, scope: wgpu::ErrorScopeGuard) -> Result<(), ShaderError> {
    match pollster::block_on(scope.pop()) {
        None => Ok(()),
        Some(error) => Err(ShaderError::Invalid {
            name: variant.name().to_owned(),
            message: error.to_string(),
        }),
    }
}
