//! A pair of timestamps around every pass.

use super::Gpu;

/// Queries that one submission may hold; WebGPU's own limit.
const CAPACITY: u32 = 4096;

/// The query set of one submission in flight.
pub struct Timer {
    set: Option<wgpu::QuerySet>,
    resolved: Option<wgpu::Buffer>,
    used: u32,
}

/// Where a pass's two timestamps will be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Span {
    pub begin: u32,
}

impl Timer {
    pub fn new(gpu: &Gpu) -> Self {
        let enabled = gpu.timestamp_period_ns.is_some();
        let set = enabled.then(|| {
            gpu.device.create_query_set(&wgpu::QuerySetDescriptor {
                label: Some("timer"),
                ty: wgpu::QueryType::Timestamp,
                count: CAPACITY,
            })
        });
        let resolved = enabled.then(|| {
            gpu.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("timestamps"),
                size: u64::from(CAPACITY) * 8,
                usage: wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC,
                mapped_at_creation: false,
            })
        });
        Self { set, resolved, used: 0 }
    }

    /// Forgets the previous submission's queries.
    pub fn reset(&mut self) {
        self.used = 0;
    }

    /// Room for `passes` more passes?
    pub fn has_room(&self, passes: u32) -> bool {
        self.set.is_none() || self.used + 2 * passes <= CAPACITY
    }

    fn span(&mut self) -> Option<Span> {
        if self.set.is_none() || self.used + 2 > CAPACITY {
            return None;
        }
        self.used += 2;
        Some(Span { begin: self.used - 2 })
    }

    /// Begins a timed compute pass.
    pub fn compute<'e>(
        &mut self,
        encoder: &'e mut wgpu::CommandEncoder,
        name: &'static str,
    ) -> (wgpu::ComputePass<'e>, Option<Span>) {
        let span = self.span();
        let timestamp_writes =
            span.zip(self.set.as_ref()).map(|(span, query_set)| wgpu::ComputePassTimestampWrites {
                query_set,
                beginning_of_pass_write_index: Some(span.begin),
                end_of_pass_write_index: Some(span.begin + 1),
            });
        (
            encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                label: Some(name),
                timestamp_writes,
            }),
            span,
        )
    }

    /// Begins a timed render pass whose single attachment is thrown away.
    pub fn raster<'e>(
        &mut self,
        encoder: &'e mut wgpu::CommandEncoder,
        name: &'static str,
        attachment: &wgpu::TextureView,
    ) -> (wgpu::RenderPass<'e>, Option<Span>) {
        let span = self.span();
        let timestamp_writes =
            span.zip(self.set.as_ref()).map(|(span, query_set)| wgpu::RenderPassTimestampWrites {
                query_set,
                beginning_of_pass_write_index: Some(span.begin),
                end_of_pass_write_index: Some(span.begin + 1),
            });
        let pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some(name),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: attachment,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations {
                    load: wgpu::LoadOp::Clear(wgpu::Color::BLACK),
                    store: wgpu::StoreOp::Discard,
                },
            })],
            depth_stencil_attachment: None,
            timestamp_writes,
            occlusion_query_set: None,
            multiview_mask: None,
        });
        (pass, span)
    }

    /// Resolves every query used so far and returns the buffer and its length in bytes.
    pub fn resolve(&self, encoder: &mut wgpu::CommandEncoder) -> Option<(&wgpu::Buffer, u64)> {
        let (set, buffer) = self.set.as_ref().zip(self.resolved.as_ref())?;
        if self.used == 0 {
            return None;
        }
        encoder.resolve_query_set(set, 0..self.used, buffer, 0);
        Some((buffer, u64::from(self.used) * 8))
    }
}
