use super::*;
use crate::passes::shaders::{Choices, composed};
use crate::residency::parts::GpuPart;

const SCENE: &str = include_str!("../../../shaders/shared/scene.wgsl");

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
        let (_, ty) = module.types.iter().find(|(_, ty)| ty.name.as_deref() == Some(name)).unwrap();
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
        include_str!("../../../shaders/shared/scene.wgsl"),
        &[
            mirror!(
                "Instance",
                GpuInstance,
                axis_x,
                material,
                axis_y,
                id,
                axis_z,
                flags,
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
        include_str!("../../../shaders/shared/frame.wgsl"),
        &[
            mirror!("ClipBox", GpuClipBox, x, y, z, high),
            mirror!("ShadowMap", GpuShadowMap, x, y, depth, pixel, spread, side, first),
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
                paint_capacity,
                exposure,
                occlusion,
                image_height,
                dither,
                fog,
                fog_up,
                clips,
                map_records
            ),
        ],
    );
    let with_materials = concat!(
        include_str!("../../../shaders/shared/material.wgsl"),
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
            overrides,
            dielectric,
            metallic,
            emissive,
            roughness,
            reflection_map,
            normal_map,
            occlusion_map,
            emissive_map,
            normal_scale,
            occlusion_strength,
            grazing,
            transmission,
            volume,
            transmission_map
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
        include_str!("../../../shaders/shared/texture.wgsl"),
        include_str!("../../../shaders/shared/colour.wgsl"),
        "@group(1) @binding(6) var<storage, read> texels_0: array<u32>;",
        "@group(1) @binding(7) var<storage, read> texels_1: array<u32>;"
    );
    check(
        texture,
        &[mirror!(
            "Texture", GpuTexture, first, page, width, height, levels, wrap, nearest, linear
        )],
    );
    let resolve = composed("resolve/resolve_samples", &Choices::default());
    let light: Mirror = (
        "Light",
        size_of::<GpuLight>(),
        vec![
            std::mem::offset_of!(GpuLight, kind),
            std::mem::offset_of!(GpuLight, range),
            std::mem::offset_of!(GpuLight, map),
            std::mem::offset_of!(GpuLight, unused),
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
        let (_, ty) = module.types.iter().find(|(_, ty)| ty.name.as_deref() == Some(name)).unwrap();
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
                assert_eq!(offset("pixels_filled"), std::mem::offset_of!(GpuStats, pixels_filled));
                for (member, place) in [
                    ("splats_clipped", std::mem::offset_of!(GpuStats, splats_clipped)),
                    ("splats_listed", std::mem::offset_of!(GpuStats, splats_listed)),
                    ("splats_scattered", std::mem::offset_of!(GpuStats, splats_scattered)),
                    ("segments_tested_lo", std::mem::offset_of!(GpuStats, segments_tested)),
                    ("segments_listed", std::mem::offset_of!(GpuStats, segments_listed)),
                    ("pixels_of_segments", std::mem::offset_of!(GpuStats, pixels_of_segments)),
                    ("splats_wanted", std::mem::offset_of!(GpuStats, splats_wanted)),
                    ("paint_cut", std::mem::offset_of!(GpuStats, paint_cut)),
                    ("pixels_of_all_layers", std::mem::offset_of!(GpuStats, pixels_of_all_layers)),
                    ("passing_most", std::mem::offset_of!(GpuStats, passing_most)),
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
