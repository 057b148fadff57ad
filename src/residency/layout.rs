//! Records shared with the shaders, byte for byte. A test compares every size and offset with naga's.

use bytemuck::{Pod, Zeroable};

use crate::scene::MOST_CASTING_LIGHTS;
use crate::scene::clipping::MOST_BOXES;

/// `Instance` of `shared/scene.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct GpuInstance {
    pub axis_x: [f32; 3],
    pub material: u32,
    pub axis_y: [f32; 3],
    pub id: u32,
    pub axis_z: [f32; 3],
    pub flags: u32,
    pub inverse_x: [f32; 3],
    pub reach: f32,
    pub inverse_y: [f32; 3],
    pub geometry: u32,
    pub inverse_z: [f32; 3],
    pub error_parent: f32,
    pub origin_hi: [f32; 3],
    pub size_parent: f32,
    pub origin_lo: [f32; 3],
    pub delta: f32,
}

/// `Placed` of `shared/scene.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct GpuPlaced {
    pub axis_x: [f32; 4],
    pub axis_y: [f32; 4],
    pub axis_z: [f32; 4],
    pub position: [f32; 4],
    pub anchor: [i32; 4],
}

/// `Chunk` of `shared/scene.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct GpuChunk {
    pub origin: [i32; 3],
    pub first: u32,
    pub extent: [f32; 3],
    pub count: u32,
    pub shift: u32,
    pub vertex_first: u32,
    pub material: u32,
    pub kernel_base: f32,
    pub node_base: f32,
    pub error_parent: f32,
    pub size_parent: f32,
    pub error_least: f32,
    pub size_least: f32,
    pub delta_most: f32,
    /// [`crate::bake::pack::GeometryKind`].
    pub kind: u32,
    pub flags: u32,
}

pub const CHUNK_ORIENTED: u32 = 1;
pub const CHUNK_CLOSED: u32 = 2;
pub const CHUNK_SORTED: u32 = 4;
pub const CHUNK_TRANSLUCENT: u32 = 8;

/// `InstanceGroup` of `shared/scene.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct GpuInstanceGroup {
    pub centre_hi: [f32; 4],
    pub centre_lo: [f32; 4],
    pub half: [f32; 3],
    pub size_parent: f32,
    pub first: u32,
    pub count: u32,
    pub error_parent: f32,
    pub delta_most: f32,
}

/// Instances of a group; as in `shared/scene.wgsl`.
pub const INSTANCE_GROUP: usize = 32;
/// Launches behind those of the segments; as in `shared/chosen.wgsl`.
pub const LOD_LAUNCHES: usize = 4;
/// Segments of a scene of point trees at most; as in `select/list_entries.wgsl`.
pub const MOST_SEGMENTS: usize = 32;

/// `ChunkRun` of `shared/scene.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct GpuChunkRun {
    pub first: u32,
    pub count: u32,
}

/// `Entry` of `shared/scene.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct GpuEntry {
    pub instance: u32,
    pub chunk: u32,
}

/// `Slot` of `shared/scene.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct GpuSlot {
    pub row_x: [f32; 4],
    pub row_y: [f32; 4],
    pub row_z: [f32; 4],
    pub instance: u32,
    pub chunk: u32,
    pub first: u32,
    pub count: u32,
    pub unit: f32,
    pub flags: u32,
    pub limits: u32,
    pub parts: u32,
}

/// `Segment` of `shared/scene.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct GpuSegment {
    pub first_group: u32,
    pub end_group: u32,
}

/// `Run` of `shared/scene.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct GpuRun {
    pub first_slot: u32,
    pub count: u32,
}

/// `Dispatch` of `shared/scene.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct GpuDispatch {
    pub groups: [u32; 3],
    pub unused: u32,
}

/// `Stats` of `shared/scene.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct GpuStats {
    pub samples_tested: [u32; 2],
    pub triangles_tested: [u32; 2],
    pub instances_drawn: u32,
    pub triangles_rasterised: u32,
    pub pixels_of_samples: u32,
    pub pixels_of_triangles: u32,
    pub large_longest: u32,
    pub large_units: u32,
    pub large_wrapped: u32,
    pub splats_clipped: u32,
    pub splats_listed: u32,
    pub splats_scattered: u32,
    pub sums_full: u32,
    pub entries_wanted: u32,
    pub nodes_drawn: u32,
    pub walk_cut: u32,
    /// Bounds of all that may be drawn, see `shared/scene.wgsl`.
    pub drawn_bounds: [u32; 4],
    pub pixels_filled: u32,
    pub deepest: u32,
    pub pixels_of_all_layers: u32,
    pub segments_tested: [u32; 2],
    pub segments_listed: u32,
    pub pixels_of_segments: u32,
    pub splats_wanted: u32,
    pub paint_cut: u32,
    /// Bits of a float that is not negative.
    pub passing_most: u32,
}

/// `Material` of `shared/material.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct GpuMaterial {
    pub base_color: [f32; 4],
    pub specular: [f32; 3],
    pub shininess: f32,
    pub texture: u32,
    pub flags: u32,
    pub alpha_cutoff: f32,
    pub overrides: u32,
    pub dielectric: [f32; 3],
    pub metallic: f32,
    pub emissive: [f32; 3],
    pub roughness: f32,
    pub reflection_map: u32,
    pub normal_map: u32,
    pub occlusion_map: u32,
    pub emissive_map: u32,
    pub normal_scale: f32,
    pub occlusion_strength: f32,
    pub grazing: f32,
    pub transmission: f32,
    pub volume: [f32; 3],
    pub transmission_map: u32,
}

/// Flags of [`GpuInstance`]; as in `shared/scene.wgsl`.
pub const INSTANCE_MIRRORED: u32 = 1;
pub const INSTANCE_TRANSLUCENT: u32 = 2;
pub const INSTANCE_CLEAR: u32 = 4;

pub const MATERIAL_DOUBLE_SIDED: u32 = 1;
pub const MATERIAL_UNLIT: u32 = 2;
pub const MATERIAL_ALPHA_TEST: u32 = 4;
pub const MATERIAL_PHYSICAL: u32 = 8;
pub const MATERIAL_SOLID: u32 = 16;

pub const OVERRIDE_BASE_COLOR: u32 = 1;
pub const OVERRIDE_SPECULAR: u32 = 2;
pub const OVERRIDE_SHININESS: u32 = 4;
pub const OVERRIDE_UNLIT: u32 = 8;
pub const OVERRIDE_DOUBLE_SIDED: u32 = 16;
pub const OVERRIDE_METALLIC: u32 = 32;
pub const OVERRIDE_ROUGHNESS: u32 = 64;
pub const OVERRIDE_EMISSIVE: u32 = 128;
pub const OVERRIDE_TRANSMISSION: u32 = 256;

/// `Texture` of `shared/texture.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct GpuTexture {
    pub first: u32,
    pub page: u32,
    pub width: u32,
    pub height: u32,
    pub levels: u32,
    pub wrap: u32,
    pub nearest: u32,
    pub linear: u32,
}

/// `Light` of `shared/phong.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct GpuLight {
    pub kind: u32,
    pub range: f32,
    pub map: u32,
    pub unused: u32,
    pub color: [f32; 4],
    pub place_hi: [f32; 4],
    pub place_lo: [f32; 4],
}

/// Views that the same dispatches draw at most; as in `shared/frame.wgsl`, and what four bits of a list's entry hold.
pub const MOST_VIEWS: u32 = 16;
/// Rows of an image at most: what fourteen bits of a list's entry hold.
pub const MOST_ROWS: u32 = 1 << 14;

/// Lights that are bound as uniforms; as in `shared/phong.wgsl`. The list of lights has room for as many at least.
pub const FEW_LIGHTS: u32 = 4;

/// A box that a view is clipped with; see `ClipBox` in `shaders/shared/frame.wgsl`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct GpuClipBox {
    pub x: [f32; 4],
    pub y: [f32; 4],
    pub z: [f32; 4],
    pub high: [f32; 4],
}

/// A sun's shadow map, or those of a lamp; see `ShadowMap` in `shaders/shared/frame.wgsl`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct GpuShadowMap {
    pub x: [f32; 4],
    pub y: [f32; 4],
    pub depth: [f32; 4],
    pub pixel: f32,
    pub spread: f32,
    pub side: u32,
    pub first: u32,
}

/// `Frame` of `shared/frame.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct GpuFrame {
    pub right: [f32; 4],
    pub down: [f32; 4],
    pub forward: [f32; 4],
    pub eye_hi: [f32; 4],
    pub eye_lo: [f32; 4],
    pub focal_px: [f32; 2],
    pub principal_px: [f32; 2],
    pub size_px: [u32; 2],
    pub entry_count: u32,
    pub instance_count: u32,
    pub light_count: u32,
    pub small_triangle_px: i32,
    pub large_capacity: u32,
    pub large_units_limit: u32,
    pub view: u32,
    pub views: u32,
    pub first_pixel: u32,
    pub first_instance: u32,
    pub first_entry: u32,
    pub first_group: u32,
    pub first_slot: u32,
    pub first_run: u32,
    pub sample_segments: u32,
    pub small_splat_px: i32,
    pub weight_one: f32,
    pub splat_cutoff: f32,
    pub splat_lowpass_px: f32,
    pub splat_width: f32,
    pub splat_offset: f32,
    pub slab_near: f32,
    pub slab_per_unit: f32,
    pub slab_meet: f32,
    pub slab_meet_log2: f32,
    pub slab_per_octave: f32,
    /// Accepted error of point trees at a depth of 1, in scene units; 0 in full detail.
    pub lod_scale: f32,
    pub entry_capacity: u32,
    pub instance_groups: u32,
    pub segment_count: u32,
    pub edl: [f32; 2],
    pub disc_radius: f32,
    pub ramp_count: u32,
    pub ramp: [f32; 4],
    pub ramp_colors: [[u32; 4]; 3],
    pub focus: f32,
    pub field: u32,
    pub field_count: u32,
    pub line_radius: f32,
    pub paint_capacity: u32,
    pub exposure: f32,
    pub occlusion: [f32; 2],
    pub image_height: f32,
    pub dither: f32,
    pub unused: [f32; 2],
    pub fog: [f32; 4],
    pub fog_up: [f32; 4],
    pub clips: [GpuClipBox; MOST_BOXES],
    pub map_records: [GpuShadowMap; MOST_CASTING_LIGHTS],
}

/// An f64 as the sum of two f32: 48 bits of mantissa.
pub fn two_floats(v: f64) -> (f32, f32) {
    let hi = v as f32;
    (hi, (v - f64::from(hi)) as f32)
}

#[cfg(test)]
mod tests;
