//! A scene's instances, and where a frame finds their chunks.

use std::collections::BTreeMap;

use super::layout::{
    GpuChunkRun, GpuEntry, GpuInstance, GpuInstanceGroup, GpuSegment, INSTANCE_GROUP, two_floats,
};
use super::model::{ModelInstance, SceneModel, gpu_instance};
use super::{FullLists, GROUP, Lists, Page, PageKind, Residency, TreeLists, group_entries};
use crate::bake::pack::PackedGeometry;
use crate::gpu::Gpu;
use crate::gpu::buffer::Buffer;
use crate::math::Bounds;

/// Lists, instances whose materials count from 1 within the scene, and the pages of the segments.
type Listed = (Lists, Vec<GpuInstance>, Vec<Page>);

/// Records of instances. The materials' final numbers are not known here.
fn record(model: &SceneModel, instance: &ModelInstance) -> GpuInstance {
    let material = instance.material.map_or(0, |material| material as u32 + 1);
    let grid = model.geometry(instance).grid();
    gpu_instance(grid, &instance.world_from_geometry, material, instance.id)
}

/// Nothing to draw: one empty segment, for which the resolve pass still writes the background.
const NO_PAGE: Page = Page { kind: PageKind::Samples, index: 0 };

impl Residency {
    /// Lists every chunk of every instance.
    pub(super) fn list_all(&self, gpu: &Gpu, model: &SceneModel) -> Listed {
        let mut listed = Vec::new();
        let mut instances = Vec::with_capacity(model.instances.len());
        for (number, instance) in model.instances.iter().enumerate() {
            instances.push(record(model, instance));
            let Some(asset) = self.assets.get(&model.assets[instance.asset].uid) else { continue };
            for piece in &asset.geometries[instance.geometry].pieces {
                for chunk in piece.first_chunk..piece.first_chunk + piece.chunk_count {
                    listed.push((piece.page, GpuEntry { instance: number as u32, chunk }));
                }
            }
        }
        let chunk_count = listed.len() as u32;
        let (entries, mut segments, mut pages) = group_entries(listed);
        if pages.is_empty() {
            segments.push(GpuSegment { first_group: 0, end_group: 0 });
            pages.push(NO_PAGE);
        }
        let sizes = [(entries.len() / GROUP) as u32, segments.len() as u32, 0, 0];
        let lists = FullLists {
            entries: Buffer::with_data(gpu, "entries", &entries),
            segments: Buffer::with_data(gpu, "segments", &segments),
            sizes: Buffer::with_data(gpu, "sizes", &sizes),
            entry_count: entries.len() as u32,
            chunk_count,
        };
        (Lists::Full(lists), instances, pages)
    }

    /// Lists instances in groups of neighbours, in the order of the model, and the chunks of each geometry page by page.
    pub(super) fn list_trees(&self, gpu: &Gpu, model: &SceneModel) -> Listed {
        let mut numbers: BTreeMap<(usize, usize), u32> = BTreeMap::new();
        for instance in &model.instances {
            let next = numbers.len() as u32;
            numbers.entry((instance.asset, instance.geometry)).or_insert(next);
        }
        let mut pages: Vec<Page> = Vec::new();
        let pieces_of = |&(asset, geometry): &(usize, usize)| {
            let resident = self.assets.get(&model.assets[asset].uid);
            let drawn = model.assets[asset].drawn_with(geometry);
            drawn.flat_map(move |geometry| {
                resident.map_or(&[][..], |resident| &resident.geometries[geometry].pieces)
            })
        };
        for key in numbers.keys() {
            pages.extend(pieces_of(key).map(|piece| piece.page));
        }
        pages.sort_unstable();
        pages.dedup();
        if pages.is_empty() {
            pages.push(NO_PAGE);
        }
        let mut pieces = vec![GpuChunkRun::default(); numbers.len() * pages.len()];
        let mut geometries = vec![[0f32; 4]; numbers.len()];
        for (key, &number) in &numbers {
            for piece in pieces_of(key) {
                let segment = pages.binary_search(&piece.page).unwrap_or(0);
                // A geometry may have come into a page in several pieces, whose chunks lie one behind the other only where
                // nothing else was between them: `place_samples` never leaves and comes back.
                let run = &mut pieces[number as usize * pages.len() + segment];
                let end = piece.first_chunk + piece.chunk_count;
                let first = if run.count == 0 { piece.first_chunk } else { run.first };
                *run = GpuChunkRun { first, count: end - first };
            }
            let asset = &model.assets[key.0];
            let halves = asset
                .drawn_with(key.1)
                .map(|geometry| half_extent(&asset.packed.geometries[geometry]));
            geometries[number as usize] = halves
                .fold([0.0; 4], |a, b| std::array::from_fn(|axis| f32::max(a[axis], b[axis])));
        }
        let halves: BTreeMap<(usize, usize), [f32; 4]> =
            numbers.iter().map(|(&key, &number)| (key, geometries[number as usize])).collect();
        let instances: Vec<GpuInstance> = model
            .instances
            .iter()
            .map(|instance| GpuInstance {
                geometry: numbers[&(instance.asset, instance.geometry)],
                error_parent: instance.above.error,
                size_parent: instance.above.size,
                delta: instance.above.delta,
                ..record(model, instance)
            })
            .collect();
        let groups: Vec<GpuInstanceGroup> = model
            .instances
            .chunks(INSTANCE_GROUP)
            .enumerate()
            .map(|(number, members)| group(model, &halves, number * INSTANCE_GROUP, members))
            .collect();
        let lists = TreeLists {
            groups: Buffer::with_data(gpu, "instance_groups", &groups),
            pieces: Buffer::with_data(gpu, "pieces", &pieces),
            geometries: Buffer::with_data(gpu, "geometries", &geometries),
            group_count: groups.len() as u32,
        };
        (Lists::Trees(lists), instances, pages)
    }
}

/// Half the size of the box about the grid's origin, in cells, that holds a geometry with the disks of its leaves.
fn half_extent(geometry: &PackedGeometry) -> [f32; 4] {
    let mut half = glam::Vec3::ZERO;
    for chunk in geometry.chunks() {
        half = half.max(chunk.origin.as_vec3().abs());
        half = half.max((chunk.origin.as_vec3() + chunk.extent.as_vec3()).abs());
    }
    // The grid's reach has room for the leaves' disks; those of inner nodes are less than the accepted error beyond.
    let disks = (geometry.grid().reach as f32 - half.max_element()).max(0.0);
    [half.x + disks, half.y + disks, half.z + disks, 0.0]
}

fn group(
    model: &SceneModel,
    halves: &BTreeMap<(usize, usize), [f32; 4]>,
    first: usize,
    members: &[ModelInstance],
) -> GpuInstanceGroup {
    let mut bounds = Bounds::EMPTY;
    let (mut error_parent, mut size_parent, mut delta_most) = (0f32, 0f32, 0f32);
    for member in members {
        let geometry = model.geometry(member);
        let grid = geometry.grid();
        let [x, y, z, _] =
            halves[&(member.asset, member.geometry)].map(|v| f64::from(v) * grid.step);
        let half = glam::DVec3::new(x, y, z);
        let local = Bounds { min: grid.origin - half, max: grid.origin + half };
        bounds = bounds.union(local.transformed(&member.world_from_geometry));
        error_parent = error_parent.max(member.above.error);
        size_parent = size_parent.max(member.above.size);
        delta_most = delta_most.max(member.above.delta);
    }
    let centre = bounds.centre();
    let split = centre.to_array().map(two_floats);
    // Rounded up, whatever the middle lost.
    let half = (bounds.extent() * 0.500_001).as_vec3();
    GpuInstanceGroup {
        centre_hi: [split[0].0, split[1].0, split[2].0, 0.0],
        centre_lo: [split[0].1, split[1].1, split[2].1, 0.0],
        half: half.to_array(),
        size_parent,
        first: first as u32,
        count: members.len() as u32,
        error_parent,
        delta_most,
    }
}
