//! Measures the time of every pass with timestamps at its end.
//!
//! A pass's time runs from the end of the previous pass (or the frame's beginning) to its own end. The time between two passes,
//! for barriers and launches, counts for the second one, so the times of all passes add up to the frame's. Pairs of timestamps
//! around each pass would not do: some software adapters write both stamps of a pass together, when the next barrier flushes
//! them.

use super::Gpu;

/// Largest number of queries in one submission, which is WebGPU's own limit.
const CAPACITY: u32 = 4096;

/// The query set of a submission in flight.
pub struct Timer {
    set: Option<wgpu::QuerySet>,
    resolved: Option<wgpu::Buffer>,
    used: u32,
    /// The stamp at which the next pass begins.
    last: Option<u32>,
    /// Whether stamps can be written between passes.
    between: bool,
    /// Target of resolves that only make the device wait for a stamp; `None` where stamps are taken in time anyway.
    settled: Option<wgpu::Buffer>,
}

/// The stamps at which a pass begins and ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Span {
    pub begin: u32,
    pub end: u32,
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
        let settled = (enabled && gpu.is_cpu && gpu.rasterises).then(|| {
            gpu.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("settled"),
                size: 8,
                usage: wgpu::BufferUsages::QUERY_RESOLVE,
                mapped_at_creation: false,
            })
        });
        let between = gpu.stamps_between_passes;
        Self { set, resolved, used: 0, last: None, between, settled }
    }

    /// Forgets the previous submission's queries.
    pub fn reset(&mut self) {
        self.used = 0;
        self.last = None;
    }

    fn stamp(&mut self) -> Option<u32> {
        if self.set.is_none() || self.used == CAPACITY {
            return None;
        }
        self.used += 1;
        Some(self.used - 1)
    }

    /// Marks the beginning of a frame.
    pub fn begin_frame(&mut self, encoder: &mut wgpu::CommandEncoder) {
        self.last = None;
        if !self.between {
            return;
        }
        if let Some((stamp, set)) = self.stamp().zip(self.set.as_ref()) {
            encoder.write_timestamp(set, stamp);
            self.last = Some(stamp);
            self.settle(encoder);
        }
    }

    /// To be called after a pass. Mesa's software rasteriser takes a stamp when its tiles are next drawn. Without something that
    /// waits for the stamp, this may be after the next pass.
    pub fn settle(&self, encoder: &mut wgpu::CommandEncoder) {
        let set = self.set.as_ref().zip(self.settled.as_ref());
        if let Some((last, (set, buffer))) = self.last.zip(set) {
            encoder.resolve_query_set(set, last..last + 1, buffer, 0);
        }
    }

    /// The stamps of the next pass, and whether the pass must write its first one itself.
    fn next(&mut self) -> Option<(Span, bool)> {
        let (begin, own) = match self.last {
            Some(last) => (last, false),
            None => (self.stamp()?, true),
        };
        let end = self.stamp()?;
        self.last = Some(end);
        Some((Span { begin, end }, own))
    }

    /// Begins a timed compute pass.
    pub fn compute<'e>(
        &mut self,
        encoder: &'e mut wgpu::CommandEncoder,
        name: &'static str,
    ) -> (wgpu::ComputePass<'e>, Option<Span>) {
        let next = self.next();
        let timestamp_writes = next.zip(self.set.as_ref()).map(|((span, own), query_set)| {
            wgpu::ComputePassTimestampWrites {
                query_set,
                beginning_of_pass_write_index: own.then_some(span.begin),
                end_of_pass_write_index: Some(span.end),
            }
        });
        (
            encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                label: Some(name),
                timestamp_writes,
            }),
            next.map(|(span, _)| span),
        )
    }

    /// Times commands that `fill` records outside of passes.
    pub fn fill(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        fill: impl FnOnce(&mut wgpu::CommandEncoder),
    ) -> Option<Span> {
        let next = self.next().zip(self.set.as_ref());
        if let Some(((span, true), set)) = next {
            stamp_alone(encoder, set, Some(span.begin), None);
        }
        fill(encoder);
        match next {
            Some(((span, _), set)) if self.between => encoder.write_timestamp(set, span.end),
            Some(((span, _), set)) => stamp_alone(encoder, set, None, Some(span.end)),
            None => {}
        }
        next.map(|((span, _), _)| span)
    }

    /// Begins a timed render pass whose single attachment is discarded.
    pub fn raster<'e>(
        &mut self,
        encoder: &'e mut wgpu::CommandEncoder,
        name: &'static str,
        attachment: &wgpu::TextureView,
    ) -> (wgpu::RenderPass<'e>, Option<Span>) {
        let next = self.next();
        let timestamp_writes = next.zip(self.set.as_ref()).map(|((span, own), query_set)| {
            wgpu::RenderPassTimestampWrites {
                query_set,
                beginning_of_pass_write_index: own.then_some(span.begin),
                end_of_pass_write_index: Some(span.end),
            }
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
        (pass, next.map(|(span, _)| span))
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

/// Writes stamps in an otherwise empty pass.
fn stamp_alone(
    encoder: &mut wgpu::CommandEncoder,
    query_set: &wgpu::QuerySet,
    begin: Option<u32>,
    end: Option<u32>,
) {
    drop(encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
        label: Some("stamp"),
        timestamp_writes: Some(wgpu::ComputePassTimestampWrites {
            query_set,
            beginning_of_pass_write_index: begin,
            end_of_pass_write_index: end,
        }),
    }));
}
