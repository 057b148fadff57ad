//! Host copies → pages and tables.

use std::sync::Arc;

use rayon::prelude::*;

use super::arena::Arena;
use super::layout::*;
use super::lists::Previous;
use super::model::{AssetModel, SceneModel};
use super::parts::{PartBoxes, part_boxes};
use super::{
    Looks, PARTS_BYTES, Page, PageKind, Piece, Residency, ResidencyError, ResidentAsset,
    ResidentGeometry, ResidentScene, SAMPLE_PAGES, SceneMaterials, TEXEL_PAGES,
};
use crate::assets::Material;
use crate::bake::pack::{
    PackedChunk, PackedGeometry, PackedMesh, PackedSamples, TRIANGLES, VERTEX_WORDS,
};
use crate::bake::tree::SORTED;
use crate::gpu::Gpu;
use crate::gpu::buffer::Buffer;
use crate::scene::{Light, MaterialSpec};

pub(super) fn sample_page(gpu: &Gpu, kind: PageKind) -> Arena {
    // Positions, attributes, kernels with the words of nodes, clip lines.
    let kernels = if kind.is_tree() { 12 } else { 4 };
    let strides = [8, 8, kernels, 8];
    let streams = if kind.is_clipped() { 4 } else { 3 };
    Arena::new(gpu, "samples", &strides[..streams])
}

pub(super) fn mesh_page(gpu: &Gpu) -> (Arena, Arena) {
    (Arena::new(gpu, "vertices", &[4 * VERTEX_WORDS as u64]), Arena::new(gpu, "triangles", &[4]))
}

/// A material of an asset whose textures begin at `texture_start`.
pub(super) fn gpu_material(material: &Material, texture_start: u32) -> GpuMaterial {
    let mut flags = 0;
    if material.double_sided {
        flags |= MATERIAL_DOUBLE_SIDED;
    }
    if material.unlit {
        flags |= MATERIAL_UNLIT;
    }
    if material.alpha_cutoff.is_some() {
        flags |= MATERIAL_ALPHA_TEST;
    }
    GpuMaterial {
        base_color: material.base_color,
        specular: material.specular,
        shininess: material.shininess.max(1.0),
        texture: material.base_texture.map_or(0, |texture| texture_start + texture + 1),
        flags,
        alpha_cutoff: material.alpha_cutoff.unwrap_or(0.0),
        overrides: 0,
    }
}

fn gpu_override(spec: &MaterialSpec) -> GpuMaterial {
    let mut out = GpuMaterial { shininess: 1.0, ..Default::default() };
    if let Some(color) = spec.base_color {
        out.base_color = color;
        out.overrides |= OVERRIDE_BASE_COLOR;
    }
    if let Some(specular) = spec.specular {
        out.specular = specular;
        out.overrides |= OVERRIDE_SPECULAR;
    }
    if let Some(shininess) = spec.shininess {
        out.shininess = shininess.max(1.0);
        out.overrides |= OVERRIDE_SHININESS;
    }
    if let Some(unlit) = spec.unlit {
        out.flags |= if unlit { MATERIAL_UNLIT } else { 0 };
        out.overrides |= OVERRIDE_UNLIT;
    }
    if let Some(double_sided) = spec.double_sided {
        out.flags |= if double_sided { MATERIAL_DOUBLE_SIDED } else { 0 };
        out.overrides |= OVERRIDE_DOUBLE_SIDED;
    }
    out
}

fn gpu_light(light: &Light) -> GpuLight {
    let rgb = |c: [f32; 3]| [c[0], c[1], c[2], 0.0];
    match *light {
        Light::Ambient { color } => GpuLight { kind: 0, color: rgb(color), ..Default::default() },
        Light::Headlight { color } => GpuLight { kind: 1, color: rgb(color), ..Default::default() },
        Light::Sun { direction, color, .. } => {
            let d = direction.as_vec3();
            GpuLight {
                kind: 2,
                color: rgb(color),
                place_hi: [d.x, d.y, d.z, 0.0],
                ..Default::default()
            }
        }
        Light::Point { position, color, range } => {
            let split = position.to_array().map(two_floats);
            GpuLight {
                kind: 3,
                range: range as f32,
                color: rgb(color),
                place_hi: [split[0].0, split[1].0, split[2].0, 0.0],
                place_lo: [split[0].1, split[1].1, split[2].1, 0.0],
                ..Default::default()
            }
        }
    }
}

fn gpu_chunk(
    chunk: &PackedChunk,
    start: u32,
    vertex_start: u32,
    material_start: u32,
    origin: &PackedChunk,
    list_first: u32,
) -> GpuChunk {
    GpuChunk {
        origin: chunk.origin.to_array(),
        first: start + (chunk.first - origin.first),
        extent: chunk.extent.as_vec3().to_array(),
        count: chunk.count,
        shift: chunk.shift,
        vertex_first: if chunk.shift == TRIANGLES {
            vertex_start + (chunk.vertex_first - origin.vertex_first)
        } else {
            chunk.sides as u32
        },
        material: if chunk.material == 0 { 0 } else { material_start + chunk.material - 1 },
        kernel_base: chunk.kernel_base,
        node_base: chunk.range.base,
        error_parent: chunk.range.error_parent,
        size_parent: chunk.range.size_parent,
        error_least: chunk.range.error_least,
        size_least: chunk.range.size_least,
        delta_most: chunk.range.delta_most,
        sorted: u32::from(chunk.shift != TRIANGLES && chunk.first - list_first < SORTED),
        range_unused: 0,
    }
}

fn looks(model: &SceneModel) -> Looks {
    let black = [0.0; 3];
    let materials = model.assets.iter().flat_map(|asset| &asset.packed.materials);
    let textures = materials.clone().any(|material| material.base_texture.is_some());
    let unlit = materials.clone().any(|material| material.unlit);
    let shines = materials.clone().any(|material| material.specular != black);
    let polished = model.materials.iter().any(|spec| spec.specular.is_some_and(|s| s != black));
    Looks {
        textures,
        overrides: model.instances.iter().any(|instance| instance.material.is_some()),
        specular: shines || polished,
        unlit,
        point_lights: model.lights.iter().any(|light| matches!(light, Light::Point { .. })),
    }
}

/// The longest run of chunks from `from` on whose elements and vertices fit the given room; at least one chunk.
fn fitting_run(chunks: &[PackedChunk], from: usize, elements: u32, vertices: u32) -> usize {
    let (mut used, mut used_vertices) = (0u32, 0u32);
    let mut end = from;
    while let Some(chunk) = chunks.get(end) {
        used = used.saturating_add(chunk.count);
        used_vertices = used_vertices.saturating_add(chunk.vertex_count);
        if used > elements || used_vertices > vertices {
            break;
        }
        end += 1;
    }
    end
}

impl Residency {
    /// Uploads an asset that is not resident.
    pub(super) fn upload_asset(
        &mut self,
        gpu: &Gpu,
        asset: &Arc<AssetModel>,
    ) -> Result<(), ResidencyError> {
        let mut resident = ResidentAsset {
            geometries: Vec::new(),
            material_start: 0,
            material_length: 0,
            texture_start: 0,
            texture_length: 0,
            texels: Vec::new(),
            bytes: asset.gpu_bytes(),
        };
        if let Err(error) = self.fill_asset(gpu, asset, &mut resident) {
            self.release(&resident);
            return Err(error);
        }
        self.used += resident.bytes;
        self.uploads += 1;
        self.assets.insert(asset.uid, resident);
        Ok(())
    }

    /// Everything that is allocated is noted in `resident` at once, also where a later step fails.
    fn fill_asset(
        &mut self,
        gpu: &Gpu,
        asset: &AssetModel,
        resident: &mut ResidentAsset,
    ) -> Result<(), ResidencyError> {
        let packed = &asset.packed;
        let full = |what, count: usize, bytes: usize| ResidencyError::OverBinding {
            what,
            needed: count as u64 * bytes as u64,
            limit: gpu.max_binding_bytes(),
        };
        let count = packed.textures.len();
        resident.texture_start = self
            .textures
            .allocate(gpu, count as u32)
            .ok_or_else(|| full("textures", count, size_of::<GpuTexture>()))?;
        resident.texture_length = count as u32;
        for (index, texture) in packed.textures.iter().enumerate() {
            let length = texture.texels.len() as u32;
            let (page, first) = (0..TEXEL_PAGES)
                .find_map(|page| Some((page, self.texels[page].allocate(gpu, length)?)))
                .ok_or_else(|| ResidencyError::OverBudget {
                    what: format!("the textures of asset `{}`", asset.name),
                    needed: packed.textures.iter().map(|t| t.texels.len() as u64 * 4).sum(),
                    budget: TEXEL_PAGES as u64 * gpu.max_binding_bytes(),
                })?;
            self.texels[page].write(gpu, 0, first, &texture.texels);
            resident.texels.push((page, first, length));
            let record = GpuTexture {
                first,
                page: page as u32,
                width: texture.width,
                height: texture.height,
                levels: texture.levels,
                wrap: texture.wrap,
                nearest: u32::from(texture.nearest),
                unused: 0,
            };
            self.textures.write(gpu, 0, resident.texture_start + index as u32, &[record]);
        }
        let count = packed.materials.len();
        resident.material_start = self
            .materials
            .allocate(gpu, count as u32)
            .ok_or_else(|| full("materials", count, size_of::<GpuMaterial>()))?;
        resident.material_length = count as u32;
        let records: Vec<GpuMaterial> = packed
            .materials
            .iter()
            .map(|material| gpu_material(material, resident.texture_start))
            .collect();
        self.materials.write(gpu, 0, resident.material_start, &records);
        for geometry in &packed.geometries {
            let uploaded = self.upload_geometry(gpu, geometry, resident.material_start)?;
            resident.geometries.push(uploaded);
        }
        Ok(())
    }

    fn upload_geometry(
        &mut self,
        gpu: &Gpu,
        geometry: &PackedGeometry,
        material_start: u32,
    ) -> Result<ResidentGeometry, ResidencyError> {
        let chunks = geometry.chunks();
        let chunk_length = chunks.len() as u32;
        let bytes = u64::from(chunk_length) * PARTS_BYTES;
        let chunk_start =
            self.chunks.allocate(gpu, chunk_length).ok_or(ResidencyError::OverBinding {
                what: "chunks of all resident assets",
                needed: bytes,
                limit: gpu.max_binding_bytes(),
            })?;
        // Samples with clip lines are a list of their own.
        let clipped_first = match geometry {
            PackedGeometry::Samples(samples) => samples.clipped_first,
            PackedGeometry::Mesh(_) => u32::MAX,
        };
        let mut out = ResidentGeometry { pieces: Vec::new(), chunk_start, chunk_length };
        let mut from = 0;
        while from < chunks.len() {
            let piece = match geometry {
                PackedGeometry::Samples(samples) => self.place_samples(gpu, samples, from),
                PackedGeometry::Mesh(mesh) => self.place_triangles(gpu, mesh, from),
            };
            let end = from + piece.chunk_count as usize;
            let records: Vec<GpuChunk> = chunks[from..end]
                .iter()
                .map(|chunk| {
                    let [start, vertices] = [piece.start, piece.vertex_start];
                    let list = if chunk.first >= clipped_first { clipped_first } else { 0 };
                    gpu_chunk(chunk, start, vertices, material_start, &chunks[from], list)
                })
                .collect();
            let first_chunk = chunk_start + from as u32;
            self.chunks.write(gpu, 0, first_chunk, &records);
            let parts: Vec<PartBoxes> =
                chunks[from..end].par_iter().map(|chunk| part_boxes(geometry, chunk)).collect();
            self.chunks.write(gpu, 1, first_chunk, &parts);
            out.pieces.push(Piece { first_chunk, ..piece });
            from = end;
        }
        Ok(out)
    }

    /// Puts samples of chunks from `from` on into a page of their kind, as many as fit there.
    fn place_samples(&mut self, gpu: &Gpu, samples: &PackedSamples, from: usize) -> Piece {
        let first = samples.chunks[from].first;
        let clipped = first >= samples.clipped_first;
        let number = usize::from(clipped) + if samples.nodes.is_empty() { 0 } else { 2 };
        let (kind, pages) = (SAMPLE_PAGES[number], &mut self.samples[number]);
        // Those with clip lines lie behind the others.
        let plain_chunks = samples.chunks.partition_point(|c| c.first < samples.clipped_first);
        let chunks = if clipped { &samples.chunks[..] } else { &samples.chunks[..plain_chunks] };
        let all = if clipped { samples.positions.len() as u32 } else { samples.clipped_first };
        let mut index = 0;
        loop {
            let fresh = index == pages.len();
            if fresh {
                pages.push(sample_page(gpu, kind));
            }
            let page = &mut pages[index];
            let end = fitting_run(chunks, from, page.room(all - first), u32::MAX);
            // A few chunks here and there would make many segments, each with its own dispatch.
            let worth = end == chunks.len() || end >= from + 64 || fresh;
            if worth {
                let last = &chunks[end - 1];
                let length = last.first + last.count - first;
                if let Some(start) = page.allocate(gpu, length) {
                    let range = first as usize..(first + length) as usize;
                    page.write(gpu, 0, start, &samples.positions[range.clone()]);
                    page.write(gpu, 1, start, &samples.attributes[range.clone()]);
                    if kind.is_tree() {
                        let words: Vec<[u32; 3]> = samples.kernels[range.clone()]
                            .iter()
                            .zip(&samples.nodes[range])
                            .map(|(&kernel, &[error, size])| [kernel, error, size])
                            .collect();
                        page.write(gpu, 2, start, &words);
                    } else {
                        page.write(gpu, 2, start, &samples.kernels[range]);
                    }
                    if clipped {
                        let at = (first - samples.clipped_first) as usize;
                        page.write(gpu, 3, start, &samples.clips[at..at + length as usize]);
                    }
                    return Piece {
                        page: Page { kind, index },
                        first_chunk: 0,
                        chunk_count: (end - from) as u32,
                        start,
                        length,
                        vertex_start: 0,
                        vertex_length: 0,
                    };
                }
            }
            index += 1;
        }
    }

    /// Puts triangles and vertices of chunks from `from` on into a page, as many as fit there.
    fn place_triangles(&mut self, gpu: &Gpu, mesh: &PackedMesh, from: usize) -> Piece {
        let origin = mesh.chunks[from];
        let wanted = mesh.triangles.len() as u32 - origin.first;
        let wanted_vertices = mesh.vertices.len() as u32 - origin.vertex_first;
        let mut index = 0;
        loop {
            let fresh = index == self.meshes.len();
            if fresh {
                self.meshes.push(mesh_page(gpu));
            }
            let (vertices, triangles) = &mut self.meshes[index];
            let end = fitting_run(
                &mesh.chunks,
                from,
                triangles.room(wanted),
                vertices.room(wanted_vertices),
            );
            let worth = end == mesh.chunks.len() || end >= from + 64 || fresh;
            if worth {
                let last = &mesh.chunks[end - 1];
                let length = last.first + last.count - origin.first;
                let vertex_length = last.vertex_first + last.vertex_count - origin.vertex_first;
                if let Some(start) = triangles.allocate(gpu, length) {
                    if let Some(vertex_start) = vertices.allocate(gpu, vertex_length) {
                        let at = origin.first as usize;
                        triangles.write(gpu, 0, start, &mesh.triangles[at..at + length as usize]);
                        let at = origin.vertex_first as usize;
                        vertices.write(
                            gpu,
                            0,
                            vertex_start,
                            &mesh.vertices[at..at + vertex_length as usize],
                        );
                        return Piece {
                            page: Page { kind: PageKind::Triangles, index },
                            first_chunk: 0,
                            chunk_count: (end - from) as u32,
                            start,
                            length,
                            vertex_start,
                            vertex_length,
                        };
                    }
                    triangles.release(start, length);
                }
            }
            index += 1;
        }
    }

    pub(super) fn free_asset(&mut self, uid: u64) {
        let Some(asset) = self.assets.remove(&uid) else { return };
        self.used -= asset.bytes;
        self.release(&asset);
    }

    fn release(&mut self, asset: &ResidentAsset) {
        for geometry in &asset.geometries {
            self.chunks.release(geometry.chunk_start, geometry.chunk_length);
            for piece in &geometry.pieces {
                match SAMPLE_PAGES.iter().position(|&kind| kind == piece.page.kind) {
                    Some(kind) => {
                        self.samples[kind][piece.page.index].release(piece.start, piece.length)
                    }
                    None => {
                        let (vertices, triangles) = &mut self.meshes[piece.page.index];
                        triangles.release(piece.start, piece.length);
                        vertices.release(piece.vertex_start, piece.vertex_length);
                    }
                }
            }
        }
        for &(page, start, length) in &asset.texels {
            self.texels[page].release(start, length);
        }
        self.textures.release(asset.texture_start, asset.texture_length);
        self.materials.release(asset.material_start, asset.material_length);
    }

    /// The scene's own buffers; its assets are resident already. Of the revision before, `previous`, what has not changed stays.
    pub(super) fn build_scene(
        &mut self,
        gpu: &Gpu,
        model: &SceneModel,
        previous: Option<ResidentScene>,
    ) -> Result<ResidentScene, ResidencyError> {
        let overrides: Vec<GpuMaterial> = model.materials.iter().map(gpu_override).collect();
        let (materials, previous) = match previous {
            Some(scene) if scene.materials.overrides == overrides => {
                let ResidentScene { materials, instances, slots, .. } = scene;
                (materials, slots.map(|slots| Previous { instances, slots }))
            }
            other => {
                if let Some(scene) = other {
                    self.release_materials(&scene.materials);
                }
                (self.upload_materials(gpu, overrides)?, None)
            }
        };
        let listed = match self.lists(gpu, model, materials.start, previous) {
            Ok(listed) => listed,
            Err(error) => {
                self.release_materials(&materials);
                return Err(error);
            }
        };
        self.instances_written += listed.written;
        let lights: Vec<GpuLight> = model.lights.iter().map(gpu_light).collect();
        let lights_buffer = Buffer::new(
            gpu,
            "lights",
            lights.len().max(FEW_LIGHTS as usize) as u64 * size_of::<GpuLight>() as u64,
            wgpu::BufferUsages::STORAGE
                | wgpu::BufferUsages::UNIFORM
                | wgpu::BufferUsages::COPY_DST,
        );
        gpu.queue.write_buffer(lights_buffer.raw(), 0, bytemuck::cast_slice(&lights));
        Ok(ResidentScene {
            model_uid: model.uid,
            bytes: model.list_bytes(),
            last_used: self.clock,
            instances: listed.instances,
            slots: listed.slots,
            lists: listed.lists,
            lights: lights_buffer,
            pages: listed.pages,
            instance_end: listed.instance_end,
            light_count: lights.len() as u32,
            sample_count: model.counts().samples,
            alpha_cut: model.assets.iter().any(|asset| {
                asset.packed.materials.iter().any(|material| material.alpha_cutoff.is_some())
            }),
            looks: looks(model),
            asset_uids: model.assets.iter().map(|asset| asset.uid).collect(),
            materials,
        })
    }

    /// Materials of a scene's own, in the table.
    fn upload_materials(
        &mut self,
        gpu: &Gpu,
        overrides: Vec<GpuMaterial>,
    ) -> Result<SceneMaterials, ResidencyError> {
        let length = overrides.len() as u32;
        let start = self.materials.allocate(gpu, length).ok_or(ResidencyError::OverBinding {
            what: "materials of all resident scenes",
            needed: u64::from(length) * size_of::<GpuMaterial>() as u64,
            limit: gpu.max_binding_bytes(),
        })?;
        self.materials.write(gpu, 0, start, &overrides);
        Ok(SceneMaterials { start, overrides })
    }

    pub(super) fn release_materials(&mut self, materials: &SceneMaterials) {
        self.materials.release(materials.start, materials.overrides.len() as u32);
    }
}
