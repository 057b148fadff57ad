//! Packed samples as points again.

use glam::{Vec2, Vec3};

use super::super::fields::PackedField;
use super::super::kernel::{self, NO_LINE};
use super::super::{NO_NORMAL, Sides, octahedral_decode};
use super::PackedSamples;
use crate::assets::{Clip, ClipLine, Fields, Kernel, PointCloud};

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
        for index in chunk.elements() {
            cloud.positions.push(packed.grid.position(chunk.cell(packed.positions[index])));
            kernels.push(unpack_kernel(packed.kernels[index], packed.attributes[index][1], base));
        }
    }
    cloud.kernels = Some(kernels);
    let fields = packed.fields.iter().map(PackedField::field).collect();
    cloud.fields = Fields::from_words(fields, packed.values.clone());
    if !packed.clips.is_empty() {
        let plain = packed.clipped_first() as usize;
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
