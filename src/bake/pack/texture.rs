//! Textures with all their mip levels.

use glam::DVec2;
use rayon::prelude::*;

use super::rgba_word;
use crate::assets::tidy::{linear_from_srgb, srgb_byte_from_linear};
use crate::assets::{Encoding, Filter, Texture, Wrap};

/// A texture with all its mip levels, largest first, as words of four bytes.
#[derive(Clone, Debug)]
pub struct PackedTexture {
    pub width: u32,
    pub height: u32,
    pub levels: u32,
    /// Two bits per axis: 0 repeat, 1 mirror, 2 clamp.
    pub wrap: u32,
    pub nearest: bool,
    pub encoding: Encoding,
    pub texels: Vec<u32>,
}

impl PackedTexture {
    /// The texel of the largest level at these coordinates; `None` where there are no texels.
    pub fn nearest_texel(&self, uv: DVec2) -> Option<u32> {
        let along = |place: f64, size: u32, wrap: u32| {
            let (size, index) = (i64::from(size), (place * f64::from(size)).floor() as i64);
            match wrap & 3 {
                0 => index.rem_euclid(size.max(1)),
                1 => {
                    let phase = index.rem_euclid(2 * size.max(1));
                    phase.min(2 * size - 1 - phase)
                }
                _ => index.clamp(0, (size - 1).max(0)),
            }
        };
        let x = along(uv.x, self.width, self.wrap);
        let y = along(uv.y, self.height, self.wrap >> 2);
        self.texels.get((y * i64::from(self.width) + x) as usize).copied()
    }
}

/// Builds every mip level of a texture: each texel is the average, in linear light, of the 2×2 texels of the larger level.
pub fn pack_texture(texture: &Texture) -> PackedTexture {
    let (mut width, mut height) = (texture.width as usize, texture.height as usize);
    let mut level: Vec<[u8; 4]> = texture.rgba.clone();
    let linear = texture.encoding == Encoding::Linear;
    let decode: Vec<f32> = (0..256)
        .map(|v| v as f32 / 255.0)
        .map(|v| if linear { v } else { linear_from_srgb(v) })
        .collect();
    let mut texels: Vec<u32> = level.iter().map(|&texel| rgba_word(texel)).collect();
    let mut levels = 1;
    while width > 1 || height > 1 {
        let (w, h) = ((width / 2).max(1), (height / 2).max(1));
        let next: Vec<[u8; 4]> = (0..w * h)
            .into_par_iter()
            .map(|i| {
                let (x, y) = (i % w, i / w);
                let mut sum = [0.0f32; 4];
                for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                    let texel =
                        level[(2 * y + dy).min(height - 1) * width + (2 * x + dx).min(width - 1)];
                    for c in 0..3 {
                        sum[c] += decode[texel[c] as usize];
                    }
                    sum[3] += f32::from(texel[3]);
                }
                let byte = |v: f32| match texture.encoding {
                    Encoding::Srgb => srgb_byte_from_linear(v * 0.25),
                    Encoding::Linear => (v * 0.25 * 255.0).round() as u8,
                };
                [byte(sum[0]), byte(sum[1]), byte(sum[2]), (sum[3] * 0.25).round() as u8]
            })
            .collect();
        texels.extend(next.iter().map(|&texel| rgba_word(texel)));
        (level, width, height) = (next, w, h);
        levels += 1;
    }
    let wrap = |mode| match mode {
        Wrap::Repeat => 0,
        Wrap::Mirror => 1,
        Wrap::Clamp => 2,
    };
    PackedTexture {
        width: texture.width,
        height: texture.height,
        levels,
        wrap: wrap(texture.wrap[0]) | wrap(texture.wrap[1]) << 2,
        nearest: texture.filter == Filter::Nearest,
        encoding: texture.encoding,
        texels,
    }
}

/// The largest mip level of a packed texture.
pub fn unpack_texture(packed: &PackedTexture) -> Texture {
    let wrap = |bits: u32| match bits & 3 {
        0 => Wrap::Repeat,
        1 => Wrap::Mirror,
        _ => Wrap::Clamp,
    };
    let count = packed.width as usize * packed.height as usize;
    Texture {
        name: String::new(),
        width: packed.width,
        height: packed.height,
        rgba: packed.texels.iter().take(count).map(|texel| texel.to_le_bytes()).collect(),
        wrap: [wrap(packed.wrap), wrap(packed.wrap >> 2)],
        filter: if packed.nearest { Filter::Nearest } else { Filter::default() },
        encoding: packed.encoding,
    }
}
