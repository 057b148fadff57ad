//! Bind groups, created once for each combination of pipeline, group and buffers.

use std::collections::HashMap;
use std::rc::Rc;

use super::Gpu;
use super::buffer::Buffer;

/// The buffer for a binding number.
#[derive(Clone, Copy)]
pub enum Binding<'a> {
    Whole(&'a Buffer),
    /// A window of this many bytes, whose start is a dynamic offset.
    Window(&'a Buffer, u64),
}

type Key = (*const wgpu::BindGroupLayout, Vec<(u64, u64)>);

/// A cache of bind groups. A layout is identified by its address, because pipelines are boxed and live as long as the device.
#[derive(Default)]
pub struct BindCache {
    groups: HashMap<Key, Rc<wgpu::BindGroup>>,
}

/// Number of groups above which the cache is emptied. Groups still in use are then created again.
const CAPACITY: usize = 4096;

impl BindCache {
    /// The bind group of `bindings`, by number, for `layout`.
    pub fn get(
        &mut self,
        gpu: &Gpu,
        layout: &wgpu::BindGroupLayout,
        bindings: &[(u32, Binding)],
    ) -> Rc<wgpu::BindGroup> {
        let ids = bindings
            .iter()
            .map(|(_, binding)| match binding {
                Binding::Whole(buffer) => (buffer.id(), 0),
                Binding::Window(buffer, bytes) => (buffer.id(), *bytes),
            })
            .collect();
        let key = (std::ptr::from_ref(layout), ids);
        if let Some(group) = self.groups.get(&key) {
            return group.clone();
        }
        if self.groups.len() >= CAPACITY {
            self.groups.clear();
        }
        let entries: Vec<wgpu::BindGroupEntry> = bindings
            .iter()
            .map(|(number, binding)| wgpu::BindGroupEntry {
                binding: *number,
                resource: match binding {
                    Binding::Whole(buffer) => buffer.raw().as_entire_binding(),
                    Binding::Window(buffer, bytes) => {
                        wgpu::BindingResource::Buffer(wgpu::BufferBinding {
                            buffer: buffer.raw(),
                            offset: 0,
                            size: wgpu::BufferSize::new(*bytes),
                        })
                    }
                },
            })
            .collect();
        let group = Rc::new(gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: None,
            layout,
            entries: &entries,
        }));
        self.groups.insert(key, group.clone());
        group
    }

    /// Drops all groups, which keep freed buffers alive.
    pub fn clear(&mut self) {
        self.groups.clear();
    }
}
