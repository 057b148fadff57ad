//! Buffers with an id, buffers that grow, and an allocator of ranges within a buffer.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};

use super::Gpu;

/// Smallest size of a buffer. A binding must hold at least one element of its type, and none of our records is larger.
pub const LEAST: u64 = 256;

static NEXT_ID: AtomicU64 = AtomicU64::new(1);

/// A GPU buffer with an id that is unique in this process.
pub struct Buffer {
    raw: wgpu::Buffer,
    id: u64,
}

impl Buffer {
    /// Creates a buffer. `bytes` is rounded up to a multiple of 16, and to at least [`LEAST`].
    pub fn new(gpu: &Gpu, label: &str, bytes: u64, usage: wgpu::BufferUsages) -> Self {
        let raw = gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            size: bytes.max(LEAST).next_multiple_of(16),
            usage,
            mapped_at_creation: false,
        });
        Self { raw, id: NEXT_ID.fetch_add(1, Ordering::Relaxed) }
    }

    /// Creates a storage buffer that copies can write to.
    pub fn storage(gpu: &Gpu, label: &str, bytes: u64) -> Self {
        Self::new(
            gpu,
            label,
            bytes,
            wgpu::BufferUsages::STORAGE
                | wgpu::BufferUsages::COPY_DST
                | wgpu::BufferUsages::COPY_SRC,
        )
    }

    /// Creates a storage buffer with contents.
    pub fn with_data<T: bytemuck::NoUninit>(gpu: &Gpu, label: &str, data: &[T]) -> Self {
        let bytes: &[u8] = bytemuck::cast_slice(data);
        let buffer = Self::storage(gpu, label, bytes.len() as u64);
        if !bytes.is_empty() {
            gpu.queue.write_buffer(&buffer.raw, 0, bytes);
        }
        buffer
    }

    pub fn raw(&self) -> &wgpu::Buffer {
        &self.raw
    }

    pub fn id(&self) -> u64 {
        self.id
    }

    /// Size in bytes.
    pub fn size(&self) -> u64 {
        self.raw.size()
    }
}

/// A scratch buffer. If a frame needs more, it is replaced by a larger one and its contents are lost.
pub struct Scratch {
    buffer: Buffer,
    label: &'static str,
    usage: wgpu::BufferUsages,
}

impl Scratch {
    pub fn new(gpu: &Gpu, label: &'static str, usage: wgpu::BufferUsages) -> Self {
        Self { buffer: Buffer::new(gpu, label, 16, usage), label, usage }
    }

    /// Makes sure that the buffer has at least `bytes`. Returns whether it was replaced.
    pub fn reserve(&mut self, gpu: &Gpu, bytes: u64) -> bool {
        let grows = bytes > self.buffer.size();
        if grows {
            // A quarter more than requested avoids reallocation for the next few sizes, within the binding limit.
            let roomy = (bytes + bytes / 4).min(gpu.max_binding_bytes()).max(bytes);
            self.buffer = Buffer::new(gpu, self.label, roomy, self.usage);
        }
        grows
    }

    pub fn buffer(&self) -> &Buffer {
        &self.buffer
    }
}

/// A first-fit allocator of element ranges. Freed neighbours are merged.
#[derive(Clone, Debug)]
pub struct Ranges {
    /// Free ranges: start → length.
    free: BTreeMap<u32, u32>,
    capacity: u32,
}

impl Ranges {
    pub fn new(capacity: u32) -> Self {
        let mut free = BTreeMap::new();
        if capacity > 0 {
            free.insert(0, capacity);
        }
        Self { free, capacity }
    }

    /// Allocates `length` elements and returns the start, or `None` if there is no room.
    pub fn allocate(&mut self, length: u32) -> Option<u32> {
        if length == 0 {
            return Some(0);
        }
        let (&start, &size) = self.free.iter().find(|(_, size)| **size >= length)?;
        self.free.remove(&start);
        if size > length {
            self.free.insert(start + length, size - length);
        }
        Some(start)
    }

    /// Frees a range that [`Ranges::allocate`] returned.
    pub fn release(&mut self, start: u32, length: u32) {
        if length == 0 {
            return;
        }
        let (mut start, mut length) = (start, length);
        if let Some((&before, &size)) = self.free.range(..start).next_back()
            && before + size == start
        {
            self.free.remove(&before);
            start = before;
            length += size;
        }
        if let Some(size) = self.free.remove(&(start + length)) {
            length += size;
        }
        self.free.insert(start, length);
    }

    /// Adds `growth` free elements at the end.
    pub fn grow(&mut self, growth: u32) {
        let end = self.capacity;
        self.capacity += growth;
        self.release(end, growth);
    }

    /// Removes free elements from the end until `capacity` are left, or until the last one is in use.
    pub fn shrink(&mut self, capacity: u32) {
        let surplus = self.capacity.saturating_sub(capacity).min(self.tail());
        if let Some((start, size)) = self.free.pop_last() {
            if size > surplus {
                self.free.insert(start, size - surplus);
            }
            self.capacity -= surplus;
        }
    }

    /// The length of the free range at the end, which growth extends.
    pub fn tail(&self) -> u32 {
        self.free
            .last_key_value()
            .filter(|(start, size)| **start + **size == self.capacity)
            .map_or(0, |(_, size)| *size)
    }

    /// The length of the longest free range.
    pub fn largest(&self) -> u32 {
        self.free.values().copied().max().unwrap_or(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn ranges_never_overlap_and_all_come_back(steps in prop::collection::vec((1u32..40, 0u8..6), 1..200)) {
            let mut ranges = Ranges::new(256);
            let mut held: Vec<(u32, u32)> = Vec::new();
            for (length, step) in steps {
                let end = held.iter().map(|(start, size)| start + size).max().unwrap_or(0);
                match step {
                    0 => ranges.grow(length),
                    1 => {
                        let before = ranges.capacity;
                        ranges.shrink(4 * length);
                        prop_assert_eq!(ranges.capacity, before.min(end.max(4 * length)));
                    }
                    2 | 3 if !held.is_empty() => {
                        let (start, size) = held.swap_remove(length as usize % held.len());
                        ranges.release(start, size);
                    }
                    _ => {
                        let Some(start) = ranges.allocate(length) else { continue };
                        prop_assert!(start + length <= ranges.capacity);
                        for &(other, size) in &held {
                            prop_assert!(start + length <= other || other + size <= start);
                        }
                        held.push((start, length));
                    }
                }
                prop_assert!(ranges.tail() <= ranges.largest());
            }
            for (start, size) in held {
                ranges.release(start, size);
            }
            prop_assert_eq!((ranges.largest(), ranges.tail()), (ranges.capacity, ranges.capacity));
        }
    }
}
