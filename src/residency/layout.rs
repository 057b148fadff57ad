//! Records shared with the shaders, byte for byte. A test compares every size and offset with naga's.

use bytemuck::{Pod, Zeroable};

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
    pub mirrored: u32,
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
    pub unused: u32,
    pub segments_tested: [u32; 2],
    pub segments_listed: u32,
    pub pixels_of_segments: u32,
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
}

pub const MATERIAL_DOUBLE_SIDED: u32 = 1;
pub const MATERIAL_UNLIT: u32 = 2;
pub const MATERIAL_ALPHA_TEST: u32 = 4;

pub const OVERRIDE_BASE_COLOR: u32 = 1;
pub const OVERRIDE_SPECULAR: u32 = 2;
pub const OVERRIDE_SHININESS: u32 = 4;
pub const OVERRIDE_UNLIT: u32 = 8;
pub const OVERRIDE_DOUBLE_SIDED: u32 = 16;

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
    pub unused: u32,
}

/// `Light` of `shared/phong.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct GpuLight {
    pub kind: u32,
    pub range: f32,
    pub unused: [u32; 2],
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
    pub clips: [GpuClipBox; MOST_BOXES],
}

/// An f64 as the sum of two f32: 48 bits of mantissa.
pub fn two_floats(v: f64) -> (f32, f32) {
    let hi = v as f32;
    (hi, (v - f64::from(hi)) as f32)
}

#[cfg(test)]
mod tests {
    use super::super::parts::GpuPart;
    use super::*;
    use crate::passes::shaders::{Choices, composed};

    const SCENE: &str = include_str!("../../shaders/shared/scene.wgsl");

    /// Name of a WGSL struct, its size here, and the offsets of its members in order.
    type Mirror = (&'static str, usize, Vec<usize>);

    macro_rules! mirror {
        ($name:literal, $type:ty, $($field:ident),+) => {
            ($name, size_of::<$type>(), vec![$(std::mem::offset_of!($type, $field)),+])
        };
    }

    fn check(source: &str, mirrors: &[Mirror]) {
        let module = naga::front::wgsl::parse_str(source).unwrap();
        for (name, size, offsets) in mirrors {
            let (_, ty) =
                module.types.iter().find(|(_, ty)| ty.name.as_deref() == Some(name)).unwrap();
            let naga::TypeInner::Struct { members, span } = &ty.inner else {
                panic!("{name} is no struct")
            };
            assert_eq!(*span as usize, *size, "size of {name}");
            let theirs: Vec<usize> = members.iter().map(|member| member.offset as usize).collect();
            assert_eq!(&theirs, offsets, "offsets of {name}");
        }
    }

    #[test]
    fn records_match_the_shaders() {
        check(
            include_str!("../../shaders/shared/scene.wgsl"),
            &[
                mirror!(
                    "Instance",
                    GpuInstance,
                    axis_x,
                    material,
                    axis_y,
                    id,
                    axis_z,
                    mirrored,
                    inverse_x,
                    reach,
                    inverse_y,
                    geometry,
                    inverse_z,
                    error_parent,
                    origin_hi,
                    size_parent,
                    origin_lo,
                    delta
                ),
                mirror!("Placed", GpuPlaced, axis_x, axis_y, axis_z, position, anchor),
                mirror!(
                    "Chunk",
                    GpuChunk,
                    origin,
                    first,
                    extent,
                    count,
                    shift,
                    vertex_first,
                    material,
                    kernel_base,
                    node_base,
                    error_parent,
                    size_parent,
                    error_least,
                    size_least,
                    delta_most,
                    kind,
                    flags
                ),
                mirror!(
                    "InstanceGroup",
                    GpuInstanceGroup,
                    centre_hi,
                    centre_lo,
                    half,
                    size_parent,
                    first,
                    count,
                    error_parent,
                    delta_most
                ),
                mirror!("ChunkRun", GpuChunkRun, first, count),
                mirror!("Entry", GpuEntry, instance, chunk),
                mirror!("Segment", GpuSegment, first_group, end_group),
                mirror!("Run", GpuRun, first_slot, count),
            ],
        );
        check(
            include_str!("../../shaders/shared/frame.wgsl"),
            &[
                mirror!("ClipBox", GpuClipBox, x, y, z, high),
                mirror!(
                    "Frame",
                    GpuFrame,
                    right,
                    down,
                    forward,
                    eye_hi,
                    eye_lo,
                    focal_px,
                    principal_px,
                    size_px,
                    entry_count,
                    instance_count,
                    light_count,
                    small_triangle_px,
                    large_capacity,
                    large_units_limit,
                    view,
                    views,
                    first_pixel,
                    first_instance,
                    first_entry,
                    first_group,
                    first_slot,
                    first_run,
                    sample_segments,
                    small_splat_px,
                    weight_one,
                    splat_cutoff,
                    splat_lowpass_px,
                    splat_width,
                    splat_offset,
                    slab_near,
                    slab_per_unit,
                    slab_meet,
                    slab_meet_log2,
                    slab_per_octave,
                    lod_scale,
                    entry_capacity,
                    instance_groups,
                    segment_count,
                    edl,
                    disc_radius,
                    ramp_count,
                    ramp,
                    ramp_colors,
                    focus,
                    field,
                    field_count,
                    line_radius,
                    clips
                ),
            ],
        );
        let with_materials = concat!(
            include_str!("../../shaders/shared/material.wgsl"),
            "@group(1) @binding(4) var<storage, read> materials: array<Material>;"
        );
        check(
            with_materials,
            &[mirror!(
                "Material",
                GpuMaterial,
                base_color,
                specular,
                shininess,
                texture,
                flags,
                alpha_cutoff,
                overrides
            )],
        );
    }

    #[test]
    fn parts_match() {
        let trees = Choices { trees: true, ..Choices::default() };
        let compact = composed("select/compact", &trees).unwrap();
        check(
            &compact.source,
            &[mirror!("Part", GpuPart, low, high, error, size, error_all, size_all, delta, cone)],
        );
    }

    #[test]
    fn lights_and_textures_match() {
        let texture = concat!(
            include_str!("../../shaders/shared/texture.wgsl"),
            include_str!("../../shaders/shared/colour.wgsl"),
            "@group(1) @binding(6) var<storage, read> texels_0: array<u32>;",
            "@group(1) @binding(7) var<storage, read> texels_1: array<u32>;"
        );
        check(
            texture,
            &[mirror!(
                "Texture", GpuTexture, first, page, width, height, levels, wrap, nearest, unused
            )],
        );
        let resolve = composed("resolve/resolve_samples", &Choices::default());
        let light: Mirror = (
            "Light",
            size_of::<GpuLight>(),
            vec![
                std::mem::offset_of!(GpuLight, kind),
                std::mem::offset_of!(GpuLight, range),
                std::mem::offset_of!(GpuLight, unused),
                std::mem::offset_of!(GpuLight, unused) + 4,
                std::mem::offset_of!(GpuLight, color),
                std::mem::offset_of!(GpuLight, place_hi),
                std::mem::offset_of!(GpuLight, place_lo),
            ],
        );
        check(&resolve.unwrap().source, &[light]);
    }

    #[test]
    fn counters_match_word_by_word() {
        // Arrays here are runs of scalars there: sizes and the first member of each run.
        let module = naga::front::wgsl::parse_str(SCENE).unwrap();
        let span = |name: &str| {
            let (_, ty) =
                module.types.iter().find(|(_, ty)| ty.name.as_deref() == Some(name)).unwrap();
            let naga::TypeInner::Struct { members, span } = &ty.inner else {
                panic!("{name} is no struct")
            };
            let offset = |member: &str| {
                members.iter().find(|m| m.name.as_deref() == Some(member)).unwrap().offset as usize
            };
            match name {
                "Stats" => {
                    assert_eq!(
                        offset("triangles_tested_lo"),
                        std::mem::offset_of!(GpuStats, triangles_tested)
                    );
                    assert_eq!(
                        offset("instances_drawn"),
                        std::mem::offset_of!(GpuStats, instances_drawn)
                    );
                    assert_eq!(
                        offset("triangles_rasterised"),
                        std::mem::offset_of!(GpuStats, triangles_rasterised)
                    );
                    assert_eq!(
                        offset("pixels_of_samples"),
                        std::mem::offset_of!(GpuStats, pixels_of_samples)
                    );
                    assert_eq!(
                        offset("pixels_of_triangles"),
                        std::mem::offset_of!(GpuStats, pixels_of_triangles)
                    );
                    assert_eq!(offset("nodes_drawn"), std::mem::offset_of!(GpuStats, nodes_drawn));
                    assert_eq!(
                        offset("pixels_filled"),
                        std::mem::offset_of!(GpuStats, pixels_filled)
                    );
                    for (member, place) in [
                        ("splats_clipped", std::mem::offset_of!(GpuStats, splats_clipped)),
                        ("splats_listed", std::mem::offset_of!(GpuStats, splats_listed)),
                        ("splats_scattered", std::mem::offset_of!(GpuStats, splats_scattered)),
                        ("segments_tested_lo", std::mem::offset_of!(GpuStats, segments_tested)),
                        ("segments_listed", std::mem::offset_of!(GpuStats, segments_listed)),
                        ("pixels_of_segments", std::mem::offset_of!(GpuStats, pixels_of_segments)),
                    ] {
                        assert_eq!(offset(member), place);
                    }
                    for (member, place) in [
                        ("large_longest", std::mem::offset_of!(GpuStats, large_longest)),
                        ("large_units", std::mem::offset_of!(GpuStats, large_units)),
                        ("large_wrapped", std::mem::offset_of!(GpuStats, large_wrapped)),
                        ("sums_full", std::mem::offset_of!(GpuStats, sums_full)),
                        ("entries_wanted", std::mem::offset_of!(GpuStats, entries_wanted)),
                        ("walk_cut", std::mem::offset_of!(GpuStats, walk_cut)),
                    ] {
                        assert_eq!(offset(member), place);
                        let name = format!("STAT_{}", member.to_uppercase());
                        let text = format!("const {name}: u32 = {}u;", place / 4);
                        assert!(SCENE.contains(&text), "{text}");
                    }
                }
                "Slot" => {
                    for (member, place) in [
                        ("instance", std::mem::offset_of!(GpuSlot, instance)),
                        ("count", std::mem::offset_of!(GpuSlot, count)),
                        ("unit", std::mem::offset_of!(GpuSlot, unit)),
                        ("flags", std::mem::offset_of!(GpuSlot, flags)),
                        ("limits", std::mem::offset_of!(GpuSlot, limits)),
                        ("parts", std::mem::offset_of!(GpuSlot, parts)),
                    ] {
                        assert_eq!(offset(member), place);
                    }
                }
                _ => assert_eq!(offset("unused"), std::mem::offset_of!(GpuDispatch, unused)),
            }
            *span as usize
        };
        assert_eq!(span("Stats"), size_of::<GpuStats>());
        assert_eq!(span("Dispatch"), size_of::<GpuDispatch>());
        assert_eq!(span("Slot"), size_of::<GpuSlot>());
    }

    #[test]
    fn two_floats_hold_a_utm_coordinate() {
        for v in [5_653_123.456_789_f64, -412_000.000_1, 1e-9, 0.0] {
            let (hi, lo) = two_floats(v);
            assert!((f64::from(hi) + f64::from(lo) - v).abs() <= v.abs() * 2f64.powi(-47));
        }
    }
}
