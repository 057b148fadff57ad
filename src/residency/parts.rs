//! Boxes of the parts of chunks: what is hidden by what is nearer is asked for each of them.

use glam::{IVec3, UVec3};

use crate::bake::pack::{CHUNK, PackedChunk, PackedGeometry};

/// Elements of a part, neighbours along a curve through space; as in `shared/turns`.
pub const PART: usize = 64;
/// Parts of a chunk.
pub const PARTS: usize = CHUNK / PART;

/// Of each part the corners of its box, in parts of 255 of the chunk's, a byte an axis from x on; of none, zeros.
pub type PartBoxes = [[u32; 2]; PARTS];

/// The boxes of a chunk's parts: of its samples' positions, or of its triangles.
pub fn part_boxes(geometry: &PackedGeometry, chunk: &PackedChunk) -> PartBoxes {
    let range = chunk.first as usize..(chunk.first + chunk.count) as usize;
    let mut boxes = PartBoxes::default();
    match geometry {
        PackedGeometry::Samples(samples) => {
            for (own, part) in boxes.iter_mut().zip(samples.positions[range].chunks(PART)) {
                *own = words(chunk, part.iter().map(|&word| chunk.cell(word)));
            }
        }
        PackedGeometry::Mesh(mesh) => {
            let first = chunk.vertex_first as usize;
            let vertices = &mesh.vertices[first..first + chunk.vertex_count as usize];
            let cell = |corner: u32| {
                let [x, y, z, ..] = vertices[corner as usize & (CHUNK - 1)];
                IVec3::new(x as i32, y as i32, z as i32)
            };
            let corners = |&word: &u32| [word, word >> 10, word >> 20].map(cell);
            for (own, part) in boxes.iter_mut().zip(mesh.triangles[range].chunks(PART)) {
                *own = words(chunk, part.iter().flat_map(corners));
            }
        }
    }
    boxes
}

fn words(chunk: &PackedChunk, cells: impl Iterator<Item = IVec3>) -> [u32; 2] {
    let ends =
        cells.fold((IVec3::MAX, IVec3::MIN), |(low, high), cell| (low.min(cell), high.max(cell)));
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
    use glam::DVec3;

    use super::*;
    use crate::assets::{Mesh, PointCloud};
    use crate::bake::pack::{pack_mesh, pack_samples};
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
        let geometry = PackedGeometry::Mesh(packed.clone());
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
        assert_eq!(boxes, PartBoxes::default());
    }
}
