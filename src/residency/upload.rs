//! Host copies → pages and tables.

use std::sync::Arc;

use rayon::prelude::*;

use super::fields;
use super::layout::*;
use super::lists::Previous;
use super::model::{AssetModel, SceneModel};
use super::parts::{ChunkParts, parts_of};
use super::{
    PARTS_BYTES, Piece, Residency, ResidencyError, ResidentAsset, ResidentEnvironment,
    ResidentGeometry, ResidentScene, SceneMaterials, TEXEL_PAGES,
};
use crate::assets::{Encoding, Material};
use crate::bake::pack::{PackedChunk, PackedGeometry, Sides};
use crate::bake::tree::SORTED;
use crate::gpu::Gpu;
use crate::gpu::buffer::Buffer;
use crate::scene::{Casting, Light, MaterialSpec};

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
    if material.physical.is_some() {
        flags |= MATERIAL_PHYSICAL;
    }
    if !material.blends() {
        flags |= MATERIAL_SOLID;
    }
    let numbered = |texture: Option<u32>| texture.map_or(0, |own| texture_start + own + 1);
    // Where it is one of Phong's model, what a node's metallic value or roughness begins with.
    let physical = material.physical.unwrap_or_default();
    let normal_map = material.normal_map;
    let occlusion_map = material.occlusion_map;
    GpuMaterial {
        base_color: material.base_color,
        specular: material.specular,
        shininess: material.shininess.max(1.0),
        texture: numbered(material.base_texture),
        flags,
        alpha_cutoff: material.alpha_cutoff.unwrap_or(0.0),
        overrides: 0,
        dielectric: physical.dielectric,
        metallic: physical.metallic,
        emissive: material.emissive,
        roughness: physical.roughness,
        reflection_map: numbered(physical.map),
        normal_map: numbered(normal_map.map(|own| own.texture)),
        occlusion_map: numbered(occlusion_map.map(|own| own.texture)),
        emissive_map: numbered(material.emissive_map),
        normal_scale: normal_map.map_or(0.0, |own| own.factor),
        occlusion_strength: occlusion_map.map_or(0.0, |own| own.factor),
        grazing: physical.grazing,
        transmission: physical.transmission,
        volume: physical.volume,
        transmission_map: numbered(physical.transmission_map),
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
    if let Some(metallic) = spec.metallic {
        out.metallic = metallic;
        out.overrides |= OVERRIDE_METALLIC;
    }
    if let Some(roughness) = spec.roughness {
        out.roughness = roughness;
        out.overrides |= OVERRIDE_ROUGHNESS;
    }
    if let Some(transmission) = spec.transmission {
        out.transmission = transmission;
        out.overrides |= OVERRIDE_TRANSMISSION;
    }
    if let Some(emissive) = spec.emissive {
        out.emissive = emissive;
        out.overrides |= OVERRIDE_EMISSIVE;
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

fn gpu_lights(lights: &[Light]) -> Vec<GpuLight> {
    let (mut suns, mut lamps) = (0, 0);
    let mut numbered = |light: &Light| {
        let count = match light.casting() {
            Some(Casting::Sun { .. }) => Some(&mut suns),
            Some(Casting::Lamp { .. }) => Some(&mut lamps),
            None => None,
        };
        let map = count.map_or(0, |count| {
            *count += 1;
            *count
        });
        GpuLight { map, ..gpu_light(light) }
    };
    lights.iter().map(&mut numbered).collect()
}

fn gpu_light(light: &Light) -> GpuLight {
    let rgb = |c: [f32; 3]| [c[0], c[1], c[2], 0.0];
    match *light {
        Light::Ambient { color } => GpuLight { kind: 0, color: rgb(color), ..Default::default() },
        Light::Surroundings { color } => {
            GpuLight { kind: 4, color: rgb(color), ..Default::default() }
        }
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
        Light::Point { position, color, range, .. } => {
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

/// The record of a chunk in a piece that begins with the chunk `origin`.
fn gpu_chunk(
    geometry: &PackedGeometry,
    chunk: &PackedChunk,
    piece: &Piece,
    origin: &PackedChunk,
    material_start: u32,
) -> GpuChunk {
    let mut flags = match chunk.sides {
        Sides::Unknown => 0,
        Sides::Oriented => CHUNK_ORIENTED,
        Sides::Closed => CHUNK_ORIENTED | CHUNK_CLOSED,
    };
    if geometry.list_first(chunk).is_some_and(|first| chunk.first - first < SORTED) {
        flags |= CHUNK_SORTED;
    }
    if chunk.translucent {
        flags |= CHUNK_TRANSLUCENT;
    }
    GpuChunk {
        origin: chunk.origin.to_array(),
        first: piece.start + (chunk.first - origin.first),
        extent: chunk.extent.as_vec3().to_array(),
        count: chunk.count,
        shift: chunk.shift,
        vertex_first: piece.vertex_start + (chunk.vertex_first - origin.vertex_first),
        material: if chunk.material == 0 { 0 } else { material_start + chunk.material - 1 },
        kernel_base: chunk.kernel_base,
        node_base: chunk.range.base,
        error_parent: chunk.range.error_parent,
        size_parent: chunk.range.size_parent,
        error_least: chunk.range.error_least,
        size_least: chunk.range.size_least,
        delta_most: chunk.range.delta_most,
        kind: geometry.kind() as u32,
        flags,
    }
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
                linear: u32::from(texture.encoding == Encoding::Linear),
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
        let mut out = ResidentGeometry { pieces: Vec::new(), chunk_start, chunk_length };
        let mut from = 0;
        while from < chunks.len() {
            let piece = self.pages.place(gpu, geometry, from);
            let end = from + piece.chunk_count as usize;
            let of = |chunk| gpu_chunk(geometry, chunk, &piece, &chunks[from], material_start);
            let records: Vec<GpuChunk> = chunks[from..end].iter().map(of).collect();
            let first_chunk = chunk_start + from as u32;
            self.chunks.write(gpu, 0, first_chunk, &records);
            let parts: Vec<ChunkParts> =
                chunks[from..end].par_iter().map(|chunk| parts_of(geometry, chunk)).collect();
            self.chunks.write(gpu, 1, first_chunk, &parts);
            out.pieces.push(Piece { first_chunk, ..piece });
            from = end;
        }
        Ok(out)
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
                self.pages.release(piece);
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
        mut previous: Option<ResidentScene>,
    ) -> Result<ResidentScene, ResidencyError> {
        let surroundings = previous.as_mut().and_then(|scene| scene.environment.take());
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
        let lights = gpu_lights(&model.lights);
        let lights_buffer = Buffer::new(
            gpu,
            "lights",
            lights.len().max(FEW_LIGHTS as usize) as u64 * size_of::<GpuLight>() as u64,
            wgpu::BufferUsages::STORAGE
                | wgpu::BufferUsages::UNIFORM
                | wgpu::BufferUsages::COPY_DST,
        );
        gpu.queue.write_buffer(lights_buffer.raw(), 0, bytemuck::cast_slice(&lights));
        let environment = model.environment.as_ref().map(|map| {
            let kept = surroundings.filter(|kept| Arc::ptr_eq(&kept.map, map));
            kept.unwrap_or_else(|| ResidentEnvironment {
                map: map.clone(),
                buffer: Buffer::with_data(gpu, "environment", &map.texels),
            })
        });
        let fields = fields::scene_fields(&model.assets);
        let field_table = Buffer::with_data(gpu, "fields", &fields::table(&model.assets, &fields));
        Ok(ResidentScene {
            model_uid: model.uid,
            bytes: model.list_bytes(),
            last_used: self.clock,
            instances: listed.instances,
            slots: listed.slots,
            lists: listed.lists,
            lights: lights_buffer,
            environment,
            fields,
            field_table,
            pages: listed.pages,
            instance_end: listed.instance_end,
            light_count: lights.len() as u32,
            sample_count: model.counts().samples,
            alpha_cut: model.asset_materials().any(|own| own.alpha_cutoff.is_some()),
            cut_outs: model
                .asset_materials()
                .any(|own| own.alpha_cutoff.is_some() && !own.translucent),
            looks: model.looks(),
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
