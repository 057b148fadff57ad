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
        self.ranges.grow(growth);
        self.resize(gpu, self.capacity + growth);
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

    /// Gives back the free end where that is more than half of the arena: buffers only grow otherwise.
    pub fn trim(&mut self, gpu: &Gpu) {
        let held = self.capacity - self.ranges.tail();
        let enough = held.max(INITIAL).min(self.max_capacity);
        if enough < self.capacity / 2 {
            self.ranges.shrink(enough);
            self.resize(gpu, enough);
        }
    }

    /// Moves the streams to buffers of `capacity` elements, with what both have room for.
    fn resize(&mut self, gpu: &Gpu, capacity: u32) {
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        for (stream, stride) in self.streams.iter_mut().zip(&self.strides) {
            let new = Buffer::storage(gpu, self.label, u64::from(capacity) * stride);
            let both = u64::from(self.capacity.min(capacity)) * stride;
            let bytes = both.next_multiple_of(4).min(stream.size()).min(new.size());
            encoder.copy_buffer_to_buffer(stream.raw(), 0, new.raw(), 0, bytes);
            *stream = new;
        }
        gpu.queue.submit([encoder.finish()]);
        self.capacity = capacity;
    }
}
