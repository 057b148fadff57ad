//! A scene's instances, and where a frame finds their chunks.

use std::sync::Arc;

use super::layout::{
    GpuChunkRun, GpuEntry, GpuInstance, GpuInstanceGroup, GpuSegment, INSTANCE_CLEAR,
    INSTANCE_GROUP, INSTANCE_TRANSLUCENT, MOST_SEGMENTS, two_floats,
};
use super::model::{AssetModel, ModelInstance, SceneModel, gpu_instance};
use super::slots::Slots;
use super::{
    FullLists, GROUP, Lists, Page, Piece, Residency, ResidencyError, TreeLists, group_entries,
};
use crate::bake::pack::{GeometryKind, PackedGeometry, PageKind};
use crate::gpu::Gpu;
use crate::gpu::buffer::Buffer;
use crate::math::Bounds;
use crate::scene::MaterialSpec;

/// Buffers of a revision of a scene that the next revision uses again.
pub(super) struct Previous {
    pub instances: Buffer,
    pub slots: Slots,
}

/// Instances with what finds their chunks.
pub(super) struct Listed {
    pub lists: Lists,
    pub instances: Buffer,
    /// For a scene of point trees.
    pub slots: Option<Slots>,
    /// All numbers of instances are less.
    pub instance_end: u32,
    /// Pages of the segments.
    pub pages: Vec<Page>,
    /// Records of instances that were written.
    pub written: u64,
}

/// The record of an instance of a scene whose materials begin at `material_start`.
fn record(model: &SceneModel, instance: &ModelInstance, material_start: u32) -> GpuInstance {
    let material = instance.material.map_or(0, |material| material_start + material as u32 + 1);
    let grid = model.geometry(instance).grid();
    let record = gpu_instance(grid, &instance.world_from_geometry, material, instance.id);
    let alpha = model.override_of(instance).map_or(1.0, MaterialSpec::alpha);
    let mut flags = record.flags;
    if model.shows_through(instance) {
        flags |= INSTANCE_TRANSLUCENT;
    }
    if alpha <= 0.0 {
        flags |= INSTANCE_CLEAR;
    }
    GpuInstance { flags, ..record }
}

/// Page of the one empty segment of a scene without anything to draw.
const NO_PAGE: Page = Page { kind: PageKind::plain(GeometryKind::Samples), index: 0 };

impl Residency {
    pub(super) fn lists(
        &self,
        gpu: &Gpu,
        model: &SceneModel,
        material_start: u32,
        previous: Option<Previous>,
    ) -> Result<Listed, ResidencyError> {
        if model.trees {
            self.list_trees(gpu, model, material_start, previous)
        } else {
            Ok(self.list_all(gpu, model, material_start))
        }
    }

    /// Lists every chunk of every instance.
    fn list_all(&self, gpu: &Gpu, model: &SceneModel, material_start: u32) -> Listed {
        let mut listed = Vec::new();
        let mut instances = Vec::with_capacity(model.instances.len());
        let first = first_geometries(model);
        for (number, instance) in model.instances.iter().enumerate() {
            instances.push(GpuInstance {
                geometry: (first[instance.asset] + instance.geometry) as u32,
                ..record(model, instance, material_start)
            });
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
        Listed {
            lists: Lists::Full(lists),
            instances: Buffer::with_data(gpu, "instances", &instances),
            slots: None,
            instance_end: instances.len() as u32,
            pages,
            written: instances.len() as u64,
        }
    }

    /// Lists instances in groups of neighbours, in the order of the model, and the chunks of each geometry page by page. What
    /// `previous` has of the instances stays as it is.
    ///
    /// # Errors
    /// More segments than shaders go through; more instances than a shader binds.
    fn list_trees(
        &self,
        gpu: &Gpu,
        model: &SceneModel,
        material_start: u32,
        previous: Option<Previous>,
    ) -> Result<Listed, ResidencyError> {
        let geometries = Geometries::of(model);
        let (pieces, pages) = self.list_pieces(gpu, model, &geometries)?;
        let instances = &model.instances;
        let most_bytes = gpu.max_binding_bytes();
        let kept = previous.and_then(|mut kept| kept.slots.keep(instances).then_some(kept));
        let mut kept = kept.unwrap_or_else(|| {
            let slots = Slots::for_instances(instances, most_bytes);
            Previous { instances: Buffer::storage(gpu, "instances", slots.bytes()), slots }
        });
        let full = ResidencyError::OverBinding {
            what: "instances",
            needed: kept.slots.bytes(),
            limit: most_bytes,
        };
        if kept.slots.bytes() > most_bytes {
            return Err(full);
        }
        let mut written = 0;
        for run in instances.runs() {
            if kept.slots.has(run) {
                continue;
            }
            let groups = run.members.chunks(INSTANCE_GROUP);
            let groups = groups.map(|members| geometries.group(model, members)).collect();
            let records: Vec<GpuInstance> = run
                .members
                .iter()
                .map(|instance| GpuInstance {
                    geometry: geometries.number(instance) as u32,
                    error_parent: instance.above.error,
                    size_parent: instance.above.size,
                    delta: instance.above.delta,
                    ..record(model, instance, material_start)
                })
                .collect();
            let Some(groups) = kept.slots.place(run, groups) else { return Err(full) };
            let mut rest = &records[..];
            // Groups that stand one behind the other are written at once.
            for groups in groups.chunk_by(|a, b| b.first == a.first + INSTANCE_GROUP as u32) {
                let count: u32 = groups.iter().map(|group| group.count).sum();
                let (records, behind) = rest.split_at(count as usize);
                let at = u64::from(groups[0].first) * size_of::<GpuInstance>() as u64;
                let bytes = bytemuck::cast_slice(records);
                gpu.queue.write_buffer(kept.instances.raw(), at, bytes);
                rest = behind;
            }
            written += records.len() as u64;
        }
        let groups = kept.slots.listed(instances);
        let lists = TreeLists {
            groups: Buffer::with_data(gpu, "instance_groups", &groups),
            pieces: Buffer::with_data(gpu, "pieces", &pieces),
            geometries: Buffer::with_data(gpu, "geometries", &geometries.halves),
            group_count: groups.len() as u32,
        };
        Ok(Listed {
            lists: Lists::Trees(lists),
            instances: kept.instances,
            instance_end: kept.slots.end(),
            slots: Some(kept.slots),
            pages,
            written,
        })
    }

    /// The chunks of each geometry by segment, and the page of each segment.
    fn list_pieces(
        &self,
        gpu: &Gpu,
        model: &SceneModel,
        geometries: &Geometries,
    ) -> Result<(Vec<GpuChunkRun>, Vec<Page>), ResidencyError> {
        let pieces_of = |asset: &Arc<AssetModel>, geometry: usize| {
            let resident = self.assets.get(&asset.uid);
            let drawn = asset.drawn_with(geometry);
            runs_of(drawn.flat_map(move |geometry| {
                resident.map_or(&[][..], |resident| &resident.geometries[geometry].pieces)
            }))
        };
        let runs: Vec<Vec<(Segment, GpuChunkRun)>> = model
            .assets
            .iter()
            .flat_map(|asset| {
                (0..asset.packed.geometries.len()).map(move |geometry| pieces_of(asset, geometry))
            })
            .collect();
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
        let mut pieces = vec![GpuChunkRun::default(); geometries.halves.len() * segments.len()];
        for (number, runs) in runs.iter().enumerate() {
            for (segment, run) in runs {
                let place = segments.binary_search(segment).unwrap_or(0);
                pieces[number * segments.len() + place] = *run;
            }
        }
        Ok((pieces, segments.into_iter().map(|(page, _)| page).collect()))
    }
}

/// Number of each asset's first geometry.
fn first_geometries(model: &SceneModel) -> Vec<usize> {
    let counts = model.assets.iter().map(|asset| asset.packed.geometries.len());
    let ends = counts.scan(0, |end, count| {
        *end += count;
        Some(*end)
    });
    std::iter::once(0).chain(ends).collect()
}

/// The geometries of a scene's assets as shaders count them: asset by asset, so that they keep their numbers while the assets before
/// them are the same.
struct Geometries {
    /// Number of each asset's first.
    first: Vec<usize>,
    /// Half the size of each with what is drawn beside it, in cells.
    halves: Vec<[f32; 4]>,
}

impl Geometries {
    fn of(model: &SceneModel) -> Geometries {
        let mut out = Geometries { first: first_geometries(model), halves: Vec::new() };
        for asset in &model.assets {
            for geometry in 0..asset.packed.geometries.len() {
                let drawn = asset.drawn_with(geometry);
                let halves = drawn.map(|drawn| half_extent(&asset.packed.geometries[drawn]));
                out.halves.push(
                    halves.fold([0.0; 4], |a, b| {
                        std::array::from_fn(|axis| f32::max(a[axis], b[axis]))
                    }),
                );
            }
        }
        out
    }

    fn number(&self, instance: &ModelInstance) -> usize {
        self.first[instance.asset] + instance.geometry
    }

    /// The record of neighbouring instances, without their places, which are not known here.
    fn group(&self, model: &SceneModel, members: &[ModelInstance]) -> GpuInstanceGroup {
        let mut bounds = Bounds::EMPTY;
        let (mut error_parent, mut size_parent, mut delta_most) = (0f32, 0f32, 0f32);
        for member in members {
            let grid = model.geometry(member).grid();
            let [x, y, z, _] = self.halves[self.number(member)].map(|v| f64::from(v) * grid.step);
            let half = glam::DVec3::new(x, y, z);
            let local = Bounds { min: grid.origin - half, max: grid.origin + half };
            bounds = bounds.union(local.transformed(&member.world_from_geometry));
            error_parent = error_parent.max(member.above.error);
            size_parent = size_parent.max(member.above.size);
            delta_most = delta_most.max(member.above.delta);
        }
        let split = bounds.centre().to_array().map(two_floats);
        // Rounded up, whatever the middle lost.
        let half = (bounds.extent() * 0.500_001).as_vec3();
        GpuInstanceGroup {
            centre_hi: [split[0].0, split[1].0, split[2].0, 0.0],
            centre_lo: [split[0].1, split[1].1, split[2].1, 0.0],
            half: half.to_array(),
            size_parent,
            first: 0,
            count: members.len() as u32,
            error_parent,
            delta_most,
        }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_comes_back_to_a_page_gets_a_segment_more() {
        let piece = |index, first_chunk, chunk_count| Piece {
            page: Page { kind: PageKind::plain(GeometryKind::Samples), index },
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
