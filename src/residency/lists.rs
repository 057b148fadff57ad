//! A scene's instances, and where a frame finds their chunks.

use std::collections::BTreeMap;

use super::layout::{
    GpuChunkRun, GpuEntry, GpuInstance, GpuInstanceGroup, GpuSegment, INSTANCE_GROUP,
    MOST_SEGMENTS, two_floats,
};
use super::model::{ModelInstance, SceneModel, gpu_instance};
use super::{
    FullLists, GROUP, Lists, Page, PageKind, Piece, Residency, ResidencyError, TreeLists,
    group_entries,
};
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
    pub(super) fn lists(&self, gpu: &Gpu, model: &SceneModel) -> Result<Listed, ResidencyError> {
        if model.trees { self.list_trees(gpu, model) } else { Ok(self.list_all(gpu, model)) }
    }

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
    ///
    /// # Errors
    /// More segments than shaders go through.
    pub(super) fn list_trees(
        &self,
        gpu: &Gpu,
        model: &SceneModel,
    ) -> Result<Listed, ResidencyError> {
        let mut numbers: BTreeMap<(usize, usize), u32> = BTreeMap::new();
        for instance in &model.instances {
            let next = numbers.len() as u32;
            numbers.entry((instance.asset, instance.geometry)).or_insert(next);
        }
        let pieces_of = |&(asset, geometry): &(usize, usize)| {
            let resident = self.assets.get(&model.assets[asset].uid);
            let drawn = model.assets[asset].drawn_with(geometry);
            drawn.flat_map(move |geometry| {
                resident.map_or(&[][..], |resident| &resident.geometries[geometry].pieces)
            })
        };
        let runs: Vec<Vec<(Segment, GpuChunkRun)>> =
            numbers.keys().map(|key| runs_of(pieces_of(key))).collect();
        let mut segments: Vec<Segment> =
            runs.iter().flatten().map(|&(segment, _)| segment).collect();
        segments.sort_unstable();
        segments.dedup();
        if segments.is_empty() {
            segments.push((NO_PAGE, 0));
        }
        if segments.len() > MOST_SEGMENTS {
            return Err(ResidencyError::OverBinding {
                what: "pages of point trees",
                needed: segments.len() as u64 * gpu.max_binding_bytes(),
                limit: MOST_SEGMENTS as u64 * gpu.max_binding_bytes(),
            });
        }
        let mut pieces = vec![GpuChunkRun::default(); numbers.len() * segments.len()];
        let mut geometries = vec![[0f32; 4]; numbers.len()];
        for ((key, &number), runs) in numbers.iter().zip(&runs) {
            for (segment, run) in runs {
                let place = segments.binary_search(segment).unwrap_or(0);
                pieces[number as usize * segments.len() + place] = *run;
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
        Ok((Lists::Trees(lists), instances, segments.into_iter().map(|(page, _)| page).collect()))
    }
}

/// A page, and how often a geometry has come back to it: chunks of a segment lie one behind the other.
type Segment = (Page, usize);

/// Pieces as runs of chunks, each in a segment of its own.
fn runs_of<'a>(pieces: impl Iterator<Item = &'a Piece>) -> Vec<(Segment, GpuChunkRun)> {
    let mut runs: Vec<(Segment, GpuChunkRun)> = Vec::new();
    for piece in pieces {
        let (page, first, count) = (piece.page, piece.first_chunk, piece.chunk_count);
        match runs.last_mut() {
            Some(((last, _), run)) if *last == page && run.first + run.count == first => {
                run.count += count;
            }
            _ => {
                let before = runs.iter().filter(|((other, _), _)| *other == page).count();
                runs.push(((page, before), GpuChunkRun { first, count }));
            }
        }
    }
    runs
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_comes_back_to_a_page_gets_a_segment_more() {
        let piece = |index, first_chunk, chunk_count| Piece {
            page: Page { kind: PageKind::Nodes, index },
            first_chunk,
            chunk_count,
            start: 0,
            length: 0,
            vertex_start: 0,
            vertex_length: 0,
        };
        let pieces = [piece(0, 0, 5), piece(0, 5, 2), piece(1, 7, 9), piece(0, 16, 1)];
        let found: Vec<(usize, usize, u32, u32)> = runs_of(pieces.iter())
            .into_iter()
            .map(|((page, again), run)| (page.index, again, run.first, run.count))
            .collect();
        assert_eq!(found, [(0, 0, 0, 7), (1, 0, 7, 9), (0, 1, 16, 1)]);
    }
}
