//! Pages of the GPU's memory from which ranges are handed out; a page grows up to what a shader can bind.

use crate::gpu::Gpu;
use crate::gpu::buffer::{Buffer, Ranges};

/// Parallel streams of elements in one range allocator.
pub struct Arena {
    label: &'static str,
    streams: Vec<Buffer>,
    /// Bytes of an element in each stream.
    strides: Vec<u64>,
    ranges: Ranges,
    capacity: u32,
    max_capacity: u32,
}

/// Elements of a fresh arena.
const INITIAL: u32 = 4096;

impl Arena {
    pub fn new(gpu: &Gpu, label: &'static str, strides: &[u64]) -> Self {
        let widest = strides.iter().copied().max().unwrap_or(4);
        let max_capacity = (gpu.max_binding_bytes() / widest).min(1 << 31) as u32;
        let capacity = INITIAL.min(max_capacity);
        let streams = strides
            .iter()
            .map(|stride| Buffer::storage(gpu, label, u64::from(capacity) * stride))
            .collect();
        Self {
            label,
            streams,
            strides: strides.to_vec(),
            ranges: Ranges::new(capacity),
            capacity,
            max_capacity,
        }
    }

    /// How many of `wanted` elements, in one run, this arena could take after growing as far as it may.
    pub fn room(&self, wanted: u32) -> u32 {
        let largest = self.ranges.largest();
        if largest >= wanted {
            return wanted;
        }
        // Growth adds to what is free at the end.
        (self.max_capacity - self.capacity + self.ranges.tail()).max(largest).min(wanted)
    }

    /// A run of `length` elements, growing if need be; `None` where even a full-grown arena has no such run.
    pub fn allocate(&mut self, gpu: &Gpu, length: u32) -> Option<u32> {
        if let Some(start) = self.ranges.allocate(length) {
            return Some(start);
        }
        let missing = length - self.ranges.tail().min(length);
        if self.max_capacity - self.capacity < missing {
            return None;
        }
        let growth = missing.max(self.capacity / 2).min(self.max_capacity - self.capacity);
        let grown = self.capacity + growth;
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        let streams: Vec<Buffer> = self
            .streams
            .iter()
            .zip(&self.strides)
            .map(|(old, stride)| {
                let new = Buffer::storage(gpu, self.label, u64::from(grown) * stride);
                let bytes = (u64::from(self.capacity) * stride).next_multiple_of(4).min(old.size());
                encoder.copy_buffer_to_buffer(old.raw(), 0, new.raw(), 0, bytes);
                new
            })
            .collect();
        gpu.queue.submit([encoder.finish()]);
        self.streams = streams;
        self.ranges.release(self.capacity, growth);
        self.ranges.grow(growth);
        self.capacity = grown;
        self.ranges.allocate(length)
    }

    pub fn release(&mut self, start: u32, length: u32) {
        self.ranges.release(start, length);
    }

    /// Writes elements of one stream.
    pub fn write<T: bytemuck::NoUninit>(&self, gpu: &Gpu, stream: usize, start: u32, data: &[T]) {
        let bytes: &[u8] = bytemuck::cast_slice(data);
        if !bytes.is_empty() {
            gpu.queue.write_buffer(
                self.streams[stream].raw(),
                u64::from(start) * self.strides[stream],
                bytes,
            );
        }
    }

    pub fn buffer(&self, stream: usize) -> &Buffer {
        &self.streams[stream]
    }

    /// Begins anew, and small, where nothing is held: buffers only grow otherwise.
    pub fn trim(&mut self, gpu: &Gpu) {
        if self.ranges.is_empty() && self.capacity > INITIAL {
            *self = Arena::new(gpu, self.label, &self.strides);
        }
    }
}
