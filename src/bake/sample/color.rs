//! Colours of samples: vertex colour × base colour × texture, averaged over the sample's disk in linear light.

use glam::{DVec2, DVec3, Vec4};

use super::{Face, barycentric};
use crate::assets::tidy::srgb_byte_from_linear;
use crate::assets::{Filter, Material, Mesh, Texture, Wrap};
use crate::scene::color::linear_from_srgb;

/// Taps across a disk.
const TAPS: [f64; 4] = [-0.75, -0.25, 0.25, 0.75];
/// The part of a disk over which the texture is averaged: where its Gaussian is above a seventh.
const FOOTPRINT: f64 = 0.5;

/// A texture's sizes, linear with straight alpha weights multiplied in, the largest first.
struct Pyramid {
    levels: Vec<(usize, usize, Vec<Vec4>)>,
    wrap: [Wrap; 2],
    filter: Filter,
}

/// Finds the colours of a mesh's samples.
pub(in crate::bake) struct Colors<'a> {
    mesh: &'a Mesh,
    materials: &'a [Material],
    /// Indexed as by the materials; empty for textures that none uses or that are broken.
    pyramids: Vec<Option<Pyramid>>,
    linear: [f32; 256],
    /// Ends of the parts, in triangles.
    ends: Vec<u64>,
}

impl<'a> Colors<'a> {
    pub(in crate::bake) fn of(
        mesh: &'a Mesh,
        materials: &'a [Material],
        textures: &[Texture],
    ) -> Self {
        let linear = std::array::from_fn(|byte| linear_from_srgb(byte as f64 / 255.0) as f32);
        let used = |index: usize| {
            let uses = |material: u32| materials.get(material as usize)?.base_texture;
            mesh.uvs.is_some()
                && mesh.parts.iter().any(|part| {
                    part.material.and_then(uses).is_some_and(|texture| texture as usize == index)
                })
        };
        let pyramid = |(index, texture): (usize, &Texture)| {
            used(index).then(|| Pyramid::of(texture, &linear)).flatten()
        };
        let pyramids = textures.iter().enumerate().map(pyramid).collect();
        let ends = mesh
            .parts
            .iter()
            .scan(0, |end, part| {
                *end += u64::from(part.triangles);
                Some(*end)
            })
            .collect();
        Self { mesh, materials, pyramids, linear, ends }
    }

    /// The part that a triangle belongs to; the number of parts for those that belong to none.
    pub(in crate::bake) fn part(&self, triangle: u32) -> usize {
        self.ends.partition_point(|&end| end <= u64::from(triangle))
    }

    /// Tells whether each part has a single colour.
    pub(in crate::bake) fn is_flat(&self) -> bool {
        self.mesh.colors.is_none() && self.pyramids.iter().all(Option::is_none)
    }

    /// Tells whether a part has a texture.
    pub(in crate::bake) fn is_textured(&self) -> bool {
        self.pyramids.iter().any(Option::is_some)
    }

    /// The colour about a place of a triangle that exists and has these corners, or `None` where the material's cut-off
    /// leaves nothing.
    pub(in crate::bake) fn on(
        &self,
        triangle: u32,
        corners: [DVec3; 3],
        at: DVec3,
        radius: f64,
    ) -> Option<[u8; 4]> {
        let [a, b, c] = corners;
        let cross = (b - a).cross(c - a);
        let normal = cross.normalize_or_zero();
        let face = Face { triangle, corners, normal, area: 0.5 * cross.length() };
        self.at(&face, barycentric(&face, at), at, radius)
    }

    /// The colour about a place of a face, or `None` where the material's cut-off leaves nothing.
    pub(super) fn at(
        &self,
        face: &Face,
        weights: [f64; 3],
        at: DVec3,
        radius: f64,
    ) -> Option<[u8; 4]> {
        let corners = self.mesh.triangles[face.triangle as usize];
        let mut color = Vec4::ONE;
        if let Some(colors) = &self.mesh.colors {
            color = Vec4::ZERO;
            for (weight, corner) in weights.into_iter().zip(corners) {
                let [r, g, b, a] = colors.get(corner as usize).copied().unwrap_or([255; 4]);
                let [r, g, b] = [r, g, b].map(|byte| self.linear[usize::from(byte)]);
                color += Vec4::new(r, g, b, f32::from(a) / 255.0) * weight as f32;
            }
        }
        let part = self.part(face.triangle);
        let material = self.mesh.parts.get(part).and_then(|part| part.material);
        if let Some(material) = material.and_then(|index| self.materials.get(index as usize)) {
            color *= Vec4::from(material.base_color);
            let pyramid = material.base_texture.and_then(|index| self.pyramids.get(index as usize));
            if let (Some(Some(pyramid)), Some(uvs)) = (pyramid, &self.mesh.uvs) {
                let uv = corners
                    .map(|corner| uvs.get(corner as usize).copied().unwrap_or_default().as_dvec2());
                color *= pyramid.average(face, uv, at, radius);
            }
            // Samples and lines are opaque: what is mostly clear in a texture has none.
            let cutoff = match (material.translucent, material.base_texture) {
                (false, _) => material.alpha_cutoff,
                (true, texture) => texture.map(|_| 0.5 * material.base_color[3]),
            };
            if cutoff.is_some_and(|cutoff| color.w < cutoff) {
                return None;
            }
        }
        let [r, g, b, _] = color.to_array();
        let [r, g, b] = [r, g, b].map(srgb_byte_from_linear);
        Some([r, g, b, 255])
    }
}

impl Pyramid {
    fn of(texture: &Texture, linear: &[f32; 256]) -> Option<Self> {
        let (width, height) = (texture.width as usize, texture.height as usize);
        if width == 0 || height == 0 || texture.rgba.len() < width.checked_mul(height)? {
            return None;
        }
        // Colour weighted with alpha: what is transparent does not tint.
        let first = texture.rgba[..width * height].iter().map(|&[r, g, b, a]| {
            let [r, g, b] = [r, g, b].map(|byte| linear[usize::from(byte)]);
            let a = f32::from(a) / 255.0;
            Vec4::new(r * a, g * a, b * a, a)
        });
        let mut levels = vec![(width, height, first.collect::<Vec<Vec4>>())];
        while let Some((w, h, texels)) = levels.last().filter(|(w, h, _)| w * h > 1) {
            let (nw, nh) = ((w / 2).max(1), (h / 2).max(1));
            // Each texel averages its share of the larger size: two to three texels a side.
            let span =
                |i: usize, new: usize, old: usize| i * old / new..((i + 1) * old).div_ceil(new);
            let mut next = Vec::with_capacity(nw * nh);
            for y in 0..nh {
                for x in 0..nw {
                    let (rows, columns) = (span(y, nh, *h), span(x, nw, *w));
                    let count = (rows.len() * columns.len()) as f32;
                    let sum: Vec4 = rows
                        .map(|r| {
                            texels[r * w + columns.start..r * w + columns.end].iter().sum::<Vec4>()
                        })
                        .sum();
                    next.push(sum / count);
                }
            }
            levels.push((nw, nh, next));
        }
        Some(Self { levels, wrap: texture.wrap, filter: texture.filter })
    }

    /// The average over the disk about a place of a face: taps over the disk, each from the size whose texels are as wide
    /// as the taps are apart.
    fn average(&self, face: &Face, uv: [DVec2; 3], at: DVec3, radius: f64) -> Vec4 {
        let [a, b, c] = face.corners;
        let u = (b - a).normalize_or_zero();
        let v = face.normal.cross(u);
        let uv_at = |point: DVec3| {
            // Weights without bounds: the disk may leave its triangle.
            let double = 2.0 * face.area;
            let weight =
                |p: DVec3, q: DVec3| (p - point).cross(q - point).dot(face.normal) / double;
            let (x, y) = (weight(b, c), weight(c, a));
            uv[0] * x + uv[1] * y + uv[2] * (1.0 - x - y)
        };
        let reach = radius * FOOTPRINT;
        let centre = uv_at(at);
        let (du, dv) = (uv_at(at + u * reach) - centre, uv_at(at + v * reach) - centre);
        let size = DVec2::new(self.levels[0].0 as f64, self.levels[0].1 as f64);
        // Texels between taps, along the wider direction.
        let step = 0.5 * (du * size).length().max((dv * size).length());
        let level = step.max(1.0).log2();
        let mut sum = Vec4::ZERO;
        let mut count = 0.0;
        for (x, y) in TAPS.into_iter().flat_map(|y| TAPS.map(|x| (x, y))) {
            if x * x + y * y <= 1.0 {
                sum += self.trilinear(centre + du * x + dv * y, level);
                count += 1.0;
            }
        }
        let sum = sum / count;
        if sum.w > 0.0 { (sum.truncate() / sum.w).extend(sum.w) } else { Vec4::ZERO }
    }

    fn trilinear(&self, uv: DVec2, level: f64) -> Vec4 {
        let last = self.levels.len() - 1;
        let lower = (level.floor() as usize).min(last);
        if self.filter == Filter::Nearest && level <= 0.0 {
            return self.texel(0, (uv * self.size(0)).floor());
        }
        let part = (level - lower as f64).clamp(0.0, 1.0) as f32;
        let one = self.bilinear(lower, uv);
        if part == 0.0 { one } else { one.lerp(self.bilinear((lower + 1).min(last), uv), part) }
    }

    fn size(&self, level: usize) -> DVec2 {
        DVec2::new(self.levels[level].0 as f64, self.levels[level].1 as f64)
    }

    fn bilinear(&self, level: usize, uv: DVec2) -> Vec4 {
        let at = uv * self.size(level) - 0.5;
        let low = at.floor();
        let part = (at - low).as_vec2();
        let row = |y: f64| {
            let left = self.texel(level, low + DVec2::new(0.0, y));
            left.lerp(self.texel(level, low + DVec2::new(1.0, y)), part.x)
        };
        row(0.0).lerp(row(1.0), part.y)
    }

    fn texel(&self, level: usize, at: DVec2) -> Vec4 {
        let (width, height, texels) = &self.levels[level];
        let x = wrapped(at.x as i64, *width as i64, self.wrap[0]);
        let y = wrapped(at.y as i64, *height as i64, self.wrap[1]);
        texels.get((y * *width as i64 + x) as usize).copied().unwrap_or(Vec4::ZERO)
    }
}

fn wrapped(index: i64, size: i64, wrap: Wrap) -> i64 {
    match wrap {
        Wrap::Repeat => index.rem_euclid(size),
        Wrap::Clamp => index.clamp(0, size - 1),
        Wrap::Mirror => {
            let place = index.rem_euclid(2 * size);
            place.min(2 * size - 1 - place)
        }
    }
}
