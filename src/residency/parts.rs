//! Boxes of the parts of chunks: what is hidden by what is nearer is asked for each of them.

use glam::{IVec3, UVec3};

use crate::bake::pack::{CHUNK, PackedChunk, PackedGeometry};

/// Elements of a part, neighbours along a curve through space; as in `shared/turns`.
pub const PART: usize = 64;
/// Parts of a chunk.
pub const PARTS: usize = CHUNK / PART;

/// The corners of each part's box, in parts of 255 of the chunk's, a byte an axis from x on, and in the first word's last byte how much shorter
/// its longest kernel axis is than the chunk's, in sixteenths of an octave; of none, zeros.
pub type PartBoxes = [[u32; 2]; PARTS];

/// The boxes of a chunk's parts, around the corners of their elements.
pub fn part_boxes(geometry: &PackedGeometry, chunk: &PackedChunk) -> PartBoxes {
    let mut boxes = PartBoxes::default();
    for (own, first) in boxes.iter_mut().zip(chunk.elements().step_by(PART)) {
        let range = first..chunk.elements().end.min(first + PART);
        let mut ends = (IVec3::MAX, IVec3::MIN);
        geometry.visit_elements(chunk, range.clone(), &mut |cells| {
            for &cell in cells {
                ends = (ends.0.min(cell), ends.1.max(cell));
            }
        });
        *own = words(chunk, ends);
        own[0] |= geometry.shortness(range) << 24;
    }
    boxes
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
    use crate::scene::random::SplitMix64;

    fn scattered(count: usize, seed: u64) -> Vec<DVec3> {
        let mut numbers = SplitMix64::new(seed);
        let mut place = || (numbers.next_u64() % 100_000) as f64 * 1e-4 - 5.0;
        (0..count).map(|_| DVec3::new(place(), place() * 1e3, place() * 1e-3)).collect()
    }

    fn holds(chunk: &PackedChunk, [low, high]: [u32; 2], cell: IVec3) -> bool {
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
            let boxes = part_boxes(&geometry, chunk);
            for i in 0..chunk.count as usize {
                let cell = chunk.cell(samples.positions[chunk.first as usize + i]);
                assert!(holds(chunk, boxes[i / PART], cell));
            }
            narrow += boxes.iter().filter(|[low, high]| high & 255 < (low & 255) + 200).count();
        }
        assert!(narrow > 20, "{narrow} parts are narrower than their chunks");
    }

    #[test]
    fn boxes_hold_all_corners_of_triangles() {
        let positions = scattered(900, 2);
        let triangles = (0..300u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        let packed = pack_mesh(&Mesh { positions, triangles, ..Mesh::default() }).unwrap();
        let geometry = PackedGeometry::Triangles(packed.clone());
        for chunk in &packed.chunks {
            let boxes = part_boxes(&geometry, chunk);
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
        let boxes = part_boxes(&PackedGeometry::Samples(samples.clone()), &samples.chunks[0]);
        // No kernel is of any length.
        assert_eq!(boxes[0], [255 << 24, 0]);
        assert_eq!(boxes[1..], PartBoxes::default()[1..]);
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
            let boxes = part_boxes(&PackedGeometry::Samples(samples.clone()), chunk);
            let step = samples.grid.step * f64::from(1u32 << chunk.shift);
            for i in 0..chunk.count as usize {
                let code = boxes[i / PART][0] >> 24;
                let most = f64::from(chunk.kernel_base)
                    * step
                    * ((1.0 - 8.0 * f64::from(code)) / 128.0).exp2();
                let kernel = &lengths[chunk.first as usize + i];
                assert!(f64::from(kernel.u.length().max(kernel.v.length())) <= 1.0001 * most);
            }
            shorter += boxes.iter().filter(|words| (8..255).contains(&(words[0] >> 24))).count();
        }
        assert!(shorter > 3, "{shorter} parts have shorter kernels than their chunks");
    }
}
