//! The ring of buffers through which results come back to the host.

use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};

use super::Gpu;

const PENDING: u8 = 0;
const MAPPED: u8 = 1;
const FAILED: u8 = 2;

/// Idle buffers. A readback reuses the smallest one that fits.
#[derive(Default)]
pub struct Ring {
    idle: Vec<wgpu::Buffer>,
}

/// Largest number of idle buffers.
const KEEP: usize = 32;

/// A buffer that a submission writes and the host reads.
pub struct Landing {
    buffer: wgpu::Buffer,
    state: Arc<AtomicU8>,
}

impl Ring {
    /// Takes a buffer of at least `bytes`.
    pub fn take(&mut self, gpu: &Gpu, bytes: u64) -> Landing {
        let fit = self
            .idle
            .iter()
            .enumerate()
            .filter(|(_, buffer)| buffer.size() >= bytes && buffer.size() <= 4 * bytes.max(1 << 16))
            .min_by_key(|(_, buffer)| buffer.size())
            .map(|(index, _)| index);
        let buffer = match fit {
            Some(index) => self.idle.swap_remove(index),
            None => gpu.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("readback"),
                size: bytes.next_multiple_of(256),
                usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            }),
        };
        Landing { buffer, state: Arc::new(AtomicU8::new(PENDING)) }
    }

    /// Unmaps the buffer and keeps it for reuse.
    pub fn give_back(&mut self, landing: Landing) {
        landing.buffer.unmap();
        if self.idle.len() >= KEEP {
            // The smallest buffer is the cheapest to create again.
            if let Some(index) = (0..self.idle.len()).min_by_key(|&index| self.idle[index].size()) {
                self.idle.swap_remove(index);
            }
        }
        self.idle.push(landing.buffer);
    }

    /// Frees every idle buffer.
    pub fn clear(&mut self) {
        self.idle.clear();
    }
}

impl Landing {
    pub fn buffer(&self) -> &wgpu::Buffer {
        &self.buffer
    }

    /// Requests the mapping. Call it after the submission that writes the buffer.
    pub fn map(&self) {
        let state = self.state.clone();
        self.buffer.map_async(wgpu::MapMode::Read, .., move |result| {
            state.store(if result.is_ok() { MAPPED } else { FAILED }, Ordering::Release);
        });
    }

    pub fn is_pending(&self) -> bool {
        self.state.load(Ordering::Acquire) == PENDING
    }

    /// Passes the first `bytes` of the buffer to `with`; `None` if the mapping failed because the device was lost.
    pub fn read<R>(&self, bytes: u64, with: impl FnOnce(&[u8]) -> R) -> Option<R> {
        if self.state.load(Ordering::Acquire) != MAPPED {
            return None;
        }
        let view = self.buffer.get_mapped_range(..bytes).ok()?;
        Some(with(&view))
    }
}
