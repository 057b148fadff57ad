//! Unpacks geometry, up to the rounding of its records: baking starts from the result once the source file is gone.

use glam::{IVec3, Vec2, Vec3};

use super::kernel::{self, NO_LINE};
use super::{NO_NORMAL, PackedMesh, PackedSamples, Sides, octahedral_decode};
use crate::assets::{Clip, ClipLine, Kernel, Mesh, MeshPart, PointCloud};

/// Unpacks samples, in their order.
pub fn unpack_samples(packed: &PackedSamples) -> PointCloud {
    let count = packed.positions.len();
    let mut cloud = PointCloud {
        positions: Vec::with_capacity(count),
        colors: Some(packed.attributes.iter().map(|[color, _]| color.to_le_bytes()).collect()),
        normals: Some(packed.attributes.iter().map(|[_, n]| octahedral_decode(*n)).collect()),
        oriented: packed.chunks.iter().any(|chunk| chunk.sides != Sides::Unknown),
        ..PointCloud::default()
    };
    let mut kernels = Vec::with_capacity(count);
    for chunk in &packed.chunks {
        let step = packed.grid.step as f32 * (chunk.shift as f32).exp2();
        let base = chunk.kernel_base * step;
        let range = chunk.first as usize..(chunk.first + chunk.count) as usize;
        for index in range {
            cloud.positions.push(packed.grid.position(chunk.cell(packed.positions[index])));
            kernels.push(unpack_kernel(packed.kernels[index], packed.attributes[index][1], base));
        }
    }
    cloud.kernels = Some(kernels);
    if !packed.clips.is_empty() {
        let plain = packed.clipped_first as usize;
        let clips = packed.clips.iter().map(|&words| clip(words));
        cloud.clips = Some(vec![Clip::NONE; plain].into_iter().chain(clips).collect());
    }
    cloud
}

/// The kernel of a sample with this normal; `base` is the longest axis of its chunk.
pub(in crate::bake) fn unpack_kernel(word: u32, normal: u32, base: f32) -> Kernel {
    let axes = if normal == NO_NORMAL { Vec3::Z } else { octahedral_decode(normal) };
    kernel::decode(word, axes, base)
}

fn line(word: u32) -> Option<ClipLine> {
    (word != NO_LINE).then(|| {
        let angle = (word >> 16) as f32 / 65536.0 * std::f32::consts::TAU;
        let offset = f32::from(word as u16 as i16) / 32767.0 * kernel::OFFSET_RANGE;
        ClipLine { normal: Vec2::from_angle(angle), offset }
    })
}

fn clip([a, b]: [u32; 2]) -> Clip {
    Clip { lines: [line(a), line(b)], either: a > b }
}

/// Unpacks a mesh's triangles, in their order. A vertex shared by several chunks is repeated for each of them.
pub fn unpack_mesh(packed: &PackedMesh) -> Mesh {
    let words = &packed.vertices;
    let cell = |w: &[u32; super::VERTEX_WORDS]| IVec3::new(w[0] as i32, w[1] as i32, w[2] as i32);
    let mut mesh = Mesh {
        positions: words.iter().map(|w| packed.grid.position(cell(w))).collect(),
        triangles: Vec::with_capacity(packed.triangles.len()),
        colors: Some(words.iter().map(|w| w[3].to_le_bytes()).collect()),
        normals: Some(words.iter().map(|w| octahedral_decode(w[4])).collect()),
        uvs: Some(
            words.iter().map(|w| Vec2::new(f32::from_bits(w[5]), f32::from_bits(w[6]))).collect(),
        ),
        parts: Vec::with_capacity(packed.chunks.len()),
    };
    for chunk in &packed.chunks {
        let triangles = &packed.triangles[chunk.first as usize..][..chunk.count as usize];
        mesh.triangles.extend(
            triangles
                .iter()
                .map(|word| [0, 10, 20].map(|shift| chunk.vertex_first + (word >> shift & 0x3ff))),
        );
        let material = chunk.material.checked_sub(1);
        mesh.parts.push(MeshPart { triangles: chunk.count, material });
    }
    mesh
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::super::pack_samples;
    use super::*;
    use crate::bake::kernels::circle;
    use crate::scene::random::SplitMix64;

    #[test]
    fn packing_again_gives_the_same_words() {
        let mut numbers = SplitMix64::new(3);
        let mut next = || (numbers.next_u64() >> 40) as f32 / (1 << 24) as f32 - 0.5;
        let mut cloud = PointCloud::default();
        let (mut normals, mut kernels, mut colors, mut clips) =
            (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for index in 0..3000 {
            cloud.positions.push(DVec3::new(next().into(), next().into(), next().into()) * 7.0);
            let normal = Vec3::new(next(), next(), next()).normalize_or(Vec3::X);
            let normal = if index % 17 == 0 { Vec3::ZERO } else { normal };
            normals.push(normal);
            let Kernel { u, v } = circle(normal, 0.02 + 0.01 * next());
            kernels.push(Kernel { u: u * (1.5 + next()), v });
            colors.push([(index % 256) as u8, 3, 90, 255]);
            let lines = [index % 5 == 0, index % 10 == 0].map(|there| {
                there.then(|| ClipLine { normal: Vec2::from_angle(7.0 * next()), offset: next() })
            });
            clips.push(Clip { lines, either: index % 20 == 0 });
        }
        cloud.normals = Some(normals);
        cloud.kernels = Some(kernels);
        cloud.colors = Some(colors);
        cloud.clips = Some(clips);
        let packed = pack_samples(&cloud).unwrap();
        let back = unpack_samples(&packed);
        let again = pack_samples(&back).unwrap();
        // Boxes may differ by a rounding, and with them orders and steps: the test compares positions and attributes instead.
        assert_eq!(again.positions.len(), packed.positions.len());
        assert_eq!(again.clipped_first, packed.clipped_first);
        let once_more = unpack_samples(&again);
        let step = 2.0 * packed.grid.step * f64::from(1u32 << packed.chunks[0].shift.min(30));
        for (a, b) in back.positions.iter().zip(&once_more.positions) {
            assert!((*a - *b).length() <= step.max(1e-6), "{a} {b}");
        }
        let (a, b) = (back.kernels.unwrap(), once_more.kernels.unwrap());
        for (a, b) in a.iter().zip(&b) {
            assert!((a.u.length() - b.u.length()).abs() <= 0.006 * a.u.length());
            assert!(a.u.angle_between(b.u).sin().abs() < 0.01);
        }
        let (a, b) = (back.clips.unwrap(), once_more.clips.unwrap());
        assert!(a.iter().zip(&b).all(|(a, b)| {
            a.either == b.either
                && a.lines.iter().zip(&b.lines).all(|(a, b)| a.is_some() == b.is_some())
        }));
        assert!(a.iter().any(|clip| clip.either));
    }
}
