//! Bounds of the parts of chunks. The renderer tests whole parts before it looks at their elements: whether they are hidden, and, in
//! point trees, whether a node of the part may be drawn.

use bytemuck::{Pod, Zeroable};
use glam::{IVec3, UVec3, Vec3};

use crate::bake::pack::{
    CHUNK, NO_NORMAL, PackedChunk, PackedGeometry, octahedral, octahedral_decode,
};
use crate::bake::tree::{CODE, CODE_BITS, FILLS, NONE, cone_sine, decode_delta};

/// Elements of a part, neighbours along a curve through space; as in `shared/turns`.
pub const PART: usize = 64;
/// Parts of a chunk.
pub const PARTS: usize = CHUNK / PART;

/// `Part` of `shared/parts.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct GpuPart {
    /// The corners of the box, in 1/255 of the chunk's box: a byte an axis from x on. The last byte of `low` says how much shorter the
    /// longest kernel axis is than the chunk's, in sixteenths of an octave. Zeros for a part without elements.
    pub low: u32,
    pub high: u32,
    /// Point trees: the code of the least error of a node, and above it the code of the largest error of a parent.
    pub error: u32,
    pub size: u32,
    /// The code of the largest error of a node, and above it the code of the least error of a parent.
    pub error_all: u32,
    /// Codes of sizes in place of errors; the last bit says that each node is drawn in full wherever it is drawn at all, see [`PLAIN`].
    pub size_all: u32,
    /// The longest distance of a node from its parent, in cells.
    pub delta: f32,
    /// The cone of the normals, see [`cone_of`].
    pub cone: u32,
}

/// Bit of [`GpuPart::size_all`]: as one pixel each, no node of the part is thinned out or drawn in some views only.
const PLAIN: u32 = 1 << 31;

/// The parts of a chunk.
pub type ChunkParts = [GpuPart; PARTS];

/// The bounds of a chunk's parts.
pub fn parts_of(geometry: &PackedGeometry, chunk: &PackedChunk) -> ChunkParts {
    let mut parts = ChunkParts::default();
    for (own, first) in parts.iter_mut().zip(chunk.elements().step_by(PART)) {
        let range = first..chunk.elements().end.min(first + PART);
        let mut ends = (IVec3::MAX, IVec3::MIN);
        geometry.visit_elements(chunk, range.clone(), &mut |cells| {
            for &cell in cells {
                ends = (ends.0.min(cell), ends.1.max(cell));
            }
        });
        [own.low, own.high] = words(chunk, ends);
        own.low |= geometry.shortness(range.clone()) << 24;
        if let PackedGeometry::Samples(samples) = geometry
            && let Some(nodes) = samples.nodes.get(range.clone())
        {
            bound_nodes(own, nodes, chunk.range.base);
            let attributes = &samples.attributes[range];
            let is_plain = attributes.iter().all(|[color, _]| color >> 24 >= u32::from(FILLS));
            own.size_all |= if is_plain { PLAIN } else { 0 };
            own.cone = cone_of(nodes, attributes);
        }
    }
    parts
}

/// Bounds the measures of some nodes. A larger code stands for a smaller value; in a parent's place code 0 stands for no parent, whose error
/// counts as the largest.
fn bound_nodes(part: &mut GpuPart, nodes: &[[u32; 2]], base: f32) {
    let codes = |measure: usize| {
        let (mut any, mut all) = ([0, NONE], [NONE, 0]);
        for words in nodes {
            let (own, parent) = (words[measure] & CODE, words[measure] >> CODE_BITS & CODE);
            any = [any[0].max(own), any[1].min(parent)];
            all = [all[0].min(own), all[1].max(parent)];
        }
        [any, all].map(|[own, parent]: [u32; 2]| own | parent << CODE_BITS)
    };
    [part.error, part.error_all] = codes(0);
    [part.size, part.size_all] = codes(1);
    part.delta = nodes.iter().map(|&words| decode_delta(words, base)).fold(0.0, f32::max);
}

/// The cone that holds the normals of some nodes and of the leaves below them: the axis in two signed bytes (octahedral map), then two sines
/// in 1/255, rounded up: of the largest angle between the axis and a node's normal, and of the largest angle between a node's normal
/// and the leaves' normals below it. Zero for no cone narrower than a half space.
fn cone_of(nodes: &[[u32; 2]], attributes: &[[u32; 2]]) -> u32 {
    let normals = || attributes.iter().map(|&[_, word]| octahedral_decode(word));
    if attributes.iter().any(|&[_, word]| word == NO_NORMAL) {
        return 0;
    }
    let mean = octahedral(normals().sum::<Vec3>());
    if mean == NO_NORMAL {
        return 0;
    }
    let byte = |half: u32| u32::from((f32::from(half as u16 as i16) / 258.0).round() as i8 as u8);
    let bytes = byte(mean) | byte(mean >> 16) << 8;
    let axis = octahedral_decode(wide(bytes));
    let least = normals().map(|normal| normal.dot(axis)).fold(1.0, f32::min);
    let beneath = nodes.iter().map(|words| cone_sine(words[1])).fold(0.0, f32::max);
    if least.is_nan() || least <= 0.0 || beneath >= 1.0 {
        return 0;
    }
    let up = |sine: f32| ((sine * 255.0 + 0.01).ceil() as u32).min(255);
    let spread = (1.0 - least * least).max(0.0).sqrt();
    // The sine of 0 is written as 1/255, so that no cone is zero as a whole.
    bytes | up(spread).max(1) << 16 | up(beneath) << 24
}

/// The normal word of a cone's axis.
fn wide(cone: u32) -> u32 {
    let half = |byte: u32| u32::from((i16::from(byte as u8 as i8) * 258) as u16);
    half(cone) | half(cone >> 8) << 16
}

/// The words of a box within a chunk's.
fn words(chunk: &PackedChunk, ends: (IVec3, IVec3)) -> [u32; 2] {
    // Extents may use all 32 bits.
    let share = |cell: IVec3, up: bool| {
        let away = cell.wrapping_sub(chunk.origin).as_uvec3();
        let extent = chunk.extent.as_uvec3().max(UVec3::ONE);
        let bytes = [0, 1, 2].map(|axis| {
            let (away, extent) = (u64::from(away[axis]) * 255, u64::from(extent[axis]));
            let byte = if up { away.div_ceil(extent) } else { away / extent };
            byte.min(255) as u32
        });
        bytes[0] | bytes[1] << 8 | bytes[2] << 16
    };
    [share(ends.0, false), share(ends.1, true)]
}

#[cfg(test)]
mod tests {
    use glam::{DVec3, Vec3, Vec3Swizzles};

    use super::*;
    use crate::assets::{Kernel, Mesh, PointCloud};
    use crate::bake::pack::{pack_mesh, pack_samples, unpack_samples};
    use crate::bake::tree::build_tree;
    use crate::scene::random::SplitMix64;

    fn scattered(count: usize, seed: u64) -> Vec<DVec3> {
        let mut numbers = SplitMix64::new(seed);
        let mut place = || (numbers.next_u64() % 100_000) as f64 * 1e-4 - 5.0;
        (0..count).map(|_| DVec3::new(place(), place() * 1e3, place() * 1e-3)).collect()
    }

    fn holds(chunk: &PackedChunk, part: GpuPart, cell: IVec3) -> bool {
        let GpuPart { low, high, .. } = part;
        (0..3).all(|axis| {
            let (low, high) = (low >> (8 * axis) & 255, high >> (8 * axis) & 255);
            let extent = f64::from(chunk.extent[axis].max(1)) / 255.0;
            let away = f64::from(cell[axis]) - f64::from(chunk.origin[axis]);
            away >= f64::from(low) * extent - 1e-6 && away <= f64::from(high) * extent + 1e-6
        })
    }

    #[test]
    fn boxes_hold_what_is_in_their_parts() {
        let cloud = PointCloud { positions: scattered(5000, 1), ..PointCloud::default() };
        let samples = pack_samples(&cloud).unwrap();
        let geometry = PackedGeometry::Samples(samples.clone());
        let mut narrow = 0;
        for chunk in &samples.chunks {
            let boxes = parts_of(&geometry, chunk);
            for i in 0..chunk.count as usize {
                let cell = chunk.cell(samples.positions[chunk.first as usize + i]);
                assert!(holds(chunk, boxes[i / PART], cell));
            }
            narrow += boxes.iter().filter(|part| part.high & 255 < (part.low & 255) + 200).count();
        }
        assert!(narrow > 20, "{narrow} parts are narrower than their chunks");
    }

    #[test]
    fn boxes_hold_all_corners_of_triangles() {
        let positions = scattered(900, 2);
        let triangles = (0..300u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        let packed = pack_mesh(&Mesh { positions, triangles, ..Mesh::default() }, &[]).unwrap();
        let geometry = PackedGeometry::Triangles(packed.clone());
        for chunk in &packed.chunks {
            let boxes = parts_of(&geometry, chunk);
            for i in 0..chunk.count as usize {
                let word = packed.triangles[chunk.first as usize + i];
                for corner in [word, word >> 10, word >> 20] {
                    let vertex = packed.vertices[(chunk.vertex_first + (corner & 1023)) as usize];
                    let cell = IVec3::new(vertex[0] as i32, vertex[1] as i32, vertex[2] as i32);
                    assert!(holds(chunk, boxes[i / PART], cell));
                }
            }
        }
    }

    #[test]
    fn a_chunk_without_extent_has_boxes_without_extent() {
        let cloud = PointCloud { positions: vec![DVec3::ONE; 3], ..PointCloud::default() };
        let samples = pack_samples(&cloud).unwrap();
        let boxes = parts_of(&PackedGeometry::Samples(samples.clone()), &samples.chunks[0]);
        // No kernel is of any length.
        assert_eq!((boxes[0].low, boxes[0].high), (255 << 24, 0));
        assert_eq!(boxes[1..], ChunkParts::default()[1..]);
    }

    #[test]
    fn no_kernel_is_longer_than_its_part_says() {
        let positions = scattered(3000, 3);
        let mut numbers = SplitMix64::new(4);
        let mut axis = |of: f64| {
            let length = of * (numbers.next_u64() % 1000) as f64 * 1e-3;
            Vec3::new(length as f32, 0.0, 0.0)
        };
        // Longer from sample to sample along the first axis, as neighbours are.
        let kernels = positions.iter().map(|at| {
            let of = (0.2 * at.x).exp2();
            Kernel { u: axis(of), v: axis(of).zxy() }
        });
        let cloud = PointCloud {
            kernels: Some(kernels.collect()),
            normals: Some(vec![Vec3::Z; positions.len()]),
            positions,
            ..PointCloud::default()
        };
        let samples = pack_samples(&cloud).unwrap();
        let (lengths, mut shorter) = (unpack_samples(&samples).kernels.unwrap(), 0);
        for chunk in &samples.chunks {
            let boxes = parts_of(&PackedGeometry::Samples(samples.clone()), chunk);
            let step = samples.grid.step * f64::from(1u32 << chunk.shift);
            for i in 0..chunk.count as usize {
                let code = boxes[i / PART].low >> 24;
                let most = f64::from(chunk.kernel_base)
                    * step
                    * ((1.0 - 8.0 * f64::from(code)) / 128.0).exp2();
                let kernel = &lengths[chunk.first as usize + i];
                assert!(f64::from(kernel.u.length().max(kernel.v.length())) <= 1.0001 * most);
            }
            shorter += boxes.iter().filter(|part| (8..255).contains(&(part.low >> 24))).count();
        }
        assert!(shorter > 3, "{shorter} parts have shorter kernels than their chunks");
    }

    /// A sphere's point tree: each part bounds the codes, distances and normals of its nodes.
    #[test]
    fn bounds_of_nodes_hold_for_each_node() {
        let normals: Vec<Vec3> = scattered(4000, 5)
            .iter()
            .map(|at| at.as_vec3() * Vec3::new(1.0, 1e-3, 1e3))
            .map(|way| way.normalize_or(Vec3::X))
            .collect();
        let kernel = |normal: &Vec3| {
            let u = normal.any_orthonormal_vector() * 0.03;
            Kernel { u, v: normal.cross(u) }
        };
        let cloud = PointCloud {
            kernels: Some(normals.iter().map(kernel).collect()),
            positions: normals.iter().map(|normal| normal.as_dvec3()).collect(),
            normals: Some(normals),
            oriented: true,
            ..PointCloud::default()
        };
        let tree = build_tree(&cloud, None).unwrap();
        let geometry = PackedGeometry::Samples(tree.clone());
        let (mut cones, mut narrow) = (0, 0);
        for chunk in &tree.chunks {
            let parts = parts_of(&geometry, chunk);
            for index in chunk.elements() {
                let part = parts[(index - chunk.first as usize) / PART];
                let node = tree.nodes[index];
                for (measure, any, all) in
                    [(0, part.error, part.error_all), (1, part.size, part.size_all)]
                {
                    let (own, parent) = (node[measure] & CODE, node[measure] >> CODE_BITS & CODE);
                    assert!((all & CODE..=any & CODE).contains(&own));
                    assert!((any >> CODE_BITS..=all >> CODE_BITS & CODE).contains(&parent));
                    narrow += usize::from((any & CODE) - (all & CODE) < 128);
                }
                assert!(decode_delta(node, chunk.range.base) <= part.delta);
                if part.cone != 0 {
                    let axis = octahedral_decode(wide(part.cone));
                    let cosine = octahedral_decode(tree.attributes[index][1]).dot(axis);
                    let sine = (part.cone >> 16 & 255) as f32 / 255.0;
                    assert!(cosine > 0.0 && (1.0 - cosine * cosine).max(0.0).sqrt() <= sine + 1e-6);
                    assert!(cone_sine(node[1]) <= (part.cone >> 24) as f32 / 255.0);
                    cones += 1;
                }
            }
        }
        let count = tree.nodes.len();
        assert!(cones > count / 5 && narrow > count, "{cones} and {narrow} of {count}");
    }
}
