//! `textured` and `checkerboard`: meshes whose appearance is in a texture.
//!
//! The first is an amphora, turned on a lathe and painted with friezes. Its texture wraps around once (u) and runs from the lip
//! to the foot (v), so that texel density varies by a factor of three between belly and neck. The second is a ground plane with a
//! checker so fine that it needs filtering in the distance.

use std::f64::consts::TAU;

use glam::{DVec2, DVec3, Vec2};

use super::GeneratedMesh;
use super::numeric::{fractal, noise, sin_cos};
use super::plain::srgb;
use crate::assets::{Encoding, Filter, Material, Mesh, PointCloud, Texture, Wrap};
use crate::scene::random::SplitMix64;

/// Texels along each side of the textures.
const TEXELS: u32 = 512;

/// The amphora's outline from the lip down to the foot: radius and height, in units of its height.
const OUTLINE: [(f64, f64); 17] = [
    (0.118, 0.985),
    (0.132, 1.0),
    (0.142, 0.99),
    (0.138, 0.965),
    (0.105, 0.945),
    (0.085, 0.9),
    (0.08, 0.85),
    (0.09, 0.8),
    (0.15, 0.745),
    (0.235, 0.68),
    (0.275, 0.59),
    (0.272, 0.48),
    (0.225, 0.34),
    (0.15, 0.19),
    (0.088, 0.085),
    (0.09, 0.045),
    (0.125, 0.0),
];

/// A point of the smooth outline, `t` in 0..=1 from lip to foot (Catmull–Rom through the table).
fn outline(t: f64) -> DVec2 {
    let last = OUTLINE.len() - 1;
    let place = t.clamp(0.0, 1.0) * last as f64;
    let i = (place.floor() as usize).min(last - 1);
    let f = place - i as f64;
    let at = |k: usize| {
        let (radius, height) = OUTLINE[k.min(last)];
        DVec2::new(radius, height)
    };
    let (a, b, c, d) = (at(i.saturating_sub(1)), at(i), at(i + 1), at(i + 2));
    let cubic = (b - c) * 3.0 + d - a;
    let square = a * 2.0 - b * 5.0 + c * 4.0 - d;
    (b * 2.0 + (c - a) * f + square * (f * f) + cubic * (f * f * f)) * 0.5
}

/// An amphora of `height` with about `triangles` triangles, standing on the origin, y up.
pub fn amphora(height: f64, triangles: u64, seed: u64) -> GeneratedMesh {
    let rings = ((triangles as f64 / 2.6).sqrt().round() as u32).max(16);
    let sectors = (rings * 5 / 4).max(16);
    let mut mesh = Mesh::default();
    let (mut normals, mut uvs) = (Vec::new(), Vec::new());
    for ring in 0..=rings {
        let t = f64::from(ring) / f64::from(rings);
        let (p, next, before) = (outline(t), outline(t + 1e-4), outline(t - 1e-4));
        let slope = next - before;
        // Along the outline from top to bottom, the outside is on the left.
        let out = DVec2::new(-slope.y, slope.x) / slope.length();
        for sector in 0..=sectors {
            let share = f64::from(sector) / f64::from(sectors);
            let (s, c) = sin_cos(TAU * share);
            mesh.positions.push(DVec3::new(p.x * s, p.y, p.x * c) * height);
            normals.push(DVec3::new(out.x * s, out.y, out.x * c).as_vec3());
            uvs.push(Vec2::new(share as f32, t as f32));
        }
    }
    mesh.triangles.extend(lattice(rings, sectors));
    mesh.normals = Some(normals);
    mesh.uvs = Some(uvs);
    for side in [1.0, -1.0] {
        handle(&mut mesh, height, side);
    }
    let material = Material {
        name: "amphora".to_owned(),
        specular: [0.12; 3],
        shininess: 40.0,
        double_sided: true,
        ..Material::default()
    };
    GeneratedMesh {
        mesh,
        material: Some(material),
        texture: Some(painted(seed)),
        ..GeneratedMesh::default()
    }
}

/// The triangles of a sheet of vertices, of `rows` × `columns` quads: row by row, one vertex more than quads along both.
pub(super) fn lattice(rows: u32, columns: u32) -> impl Iterator<Item = [u32; 3]> {
    let row = columns + 1;
    (0..rows).flat_map(move |i| {
        (0..columns).flat_map(move |j| {
            let a = i * row + j;
            let [b, c, d] = [a + 1, a + row, a + row + 1];
            [[a, c, d], [a, d, b]]
        })
    })
}

/// A handle from the neck to the shoulder, in plain glaze.
fn handle(mesh: &mut Mesh, height: f64, side: f64) {
    const ALONG: u32 = 18;
    const AROUND: u32 = 10;
    let path = |t: f64| {
        let (a, b) = (DVec2::new(0.085, 0.925), DVec2::new(0.3, 1.0));
        let (c, d) = (DVec2::new(0.31, 0.83), DVec2::new(0.2, 0.7));
        let s = 1.0 - t;
        a * (s * s * s) + b * (3.0 * s * s * t) + c * (3.0 * s * t * t) + d * (t * t * t)
    };
    let first = mesh.positions.len() as u32;
    for i in 0..=ALONG {
        let t = f64::from(i) / f64::from(ALONG);
        let middle = path(t);
        let run = path(t + 1e-4) - path(t - 1e-4);
        let out = DVec2::new(-run.y, run.x) / run.length();
        for j in 0..=AROUND {
            let share = f64::from(j) / f64::from(AROUND);
            let (s, c) = sin_cos(TAU * share);
            let normal = DVec3::new(out.x * c * side, out.y * c, s * side);
            let centre = DVec3::new(middle.x * side, middle.y, 0.0);
            let girth = DVec3::new(0.017, 0.017, 0.026);
            mesh.positions.push((centre + normal * girth) * height);
            mesh.normals.get_or_insert_default().push(normal.as_vec3());
            // A strip of the texture with black glaze.
            let uv = Vec2::new(share as f32 * 0.2, 0.985 + 0.01 * t as f32);
            mesh.uvs.get_or_insert_default().push(uv);
        }
    }
    // The other way round than the amphora.
    mesh.triangles.extend(lattice(ALONG, AROUND).map(|[a, b, c]| [a, c, b].map(|v| first + v)));
}

/// The amphora's texture: friezes in black on clay, 512².
fn painted(seed: u64) -> Texture {
    let mut random = SplitMix64::stream(seed, 41);
    let waves = 20.0 + random.index(3) as f64 * 2.0;
    let rgba = (0..TEXELS * TEXELS)
        .map(|index| {
            let u = (f64::from(index % TEXELS) + 0.5) / f64::from(TEXELS);
            let v = (f64::from(index / TEXELS) + 0.5) / f64::from(TEXELS);
            let black = is_glazed(u, v, waves);
            let (s, c) = sin_cos(TAU * u);
            let place = DVec3::new(s * 6.0, v * 30.0, c * 6.0);
            // Few tones, so that the image file stays small.
            let tone = 1.0 + 0.1 * (8.0 * fractal(place, 3, seed)).round() / 8.0;
            let base: [f64; 3] = if black { [34.0, 28.0, 27.0] } else { [203.0, 116.0, 62.0] };
            let [r, g, b] = base.map(|c| (c * tone).clamp(0.0, 255.0).round() as u8);
            [r, g, b, 255]
        })
        .collect();
    Texture {
        name: "amphora".to_owned(),
        width: TEXELS,
        height: TEXELS,
        rgba,
        wrap: [Wrap::Repeat, Wrap::Clamp],
        filter: Filter::Linear,
        encoding: Encoding::Srgb,
    }
}

/// Whether the pattern is black at `u` around and `v` down.
fn is_glazed(u: f64, v: f64, waves: f64) -> bool {
    let between = |low: f64, high: f64| (v >= low && v < high).then(|| (v - low) / (high - low));
    let line = |at: f64| (v - at).abs() < 0.004;
    if [0.28, 0.345, 0.47, 0.485, 0.7, 0.715, 0.755].iter().any(|&at| line(at)) {
        return true;
    }
    if let Some(y) = between(0.29, 0.335) {
        return meander(u * waves, y);
    }
    if let Some(y) = between(0.36, 0.455) {
        // Tongues.
        let x = (u * 36.0).fract() - 0.5;
        return x * x * 9.0 + (y - 0.15).max(0.0) * (y - 0.15).max(0.0) * 1.3 < 0.9
            && x.abs() < 0.36;
    }
    if let Some(y) = between(0.5, 0.685) {
        // A running spiral wave with suns between.
        let x = (u * 9.0).fract() - 0.5;
        let (dx, dy) = (x, (y - 0.5) * 1.15);
        let r = (dx * dx + dy * dy).sqrt();
        let angle = super::numeric::atan2(dy, dx);
        let rays = (angle / TAU * 16.0).rem_euclid(1.0);
        return r < 0.13
            || (r > 0.17 && r < 0.205)
            || (r > 0.235 && r < 0.4 && (rays - 0.5).abs() < 0.28 * (0.42 - r) / 0.18)
            || (dx.abs() > 0.455 && (y * 9.0).fract() < 0.55);
    }
    if let Some(y) = between(0.72, 0.75) {
        return ((u * 72.0).fract() < 0.5) != (y < 0.5);
    }
    if let Some(y) = between(0.77, 0.93) {
        // Rays that rise from the foot.
        let x = (u * 24.0).fract() - 0.5;
        return x.abs() < 0.36 * y;
    }
    !(0.27..0.93).contains(&v)
}

/// A Greek key with one period per unit of `x`; `y` in 0..1 runs downwards.
fn meander(x: f64, y: f64) -> bool {
    const KEY: [&[u8; 8]; 7] =
        [b"########", b"#......#", b"#.####.#", b"#.#..#.#", b"#.##.#.#", b"#....#.#", b"######.#"];
    let row = ((y * 7.0) as usize).min(6);
    let column = (((x - x.floor()) * 8.0) as usize).min(7);
    KEY[row][column] == b'#'
}

/// A level square of edge `size` about the origin whose texture has 64 × 64 fields.
pub fn checker_mesh(size: f64) -> GeneratedMesh {
    let half = 0.5 * size;
    let corners = [(-1.0, -1.0), (-1.0, 1.0), (1.0, 1.0), (1.0, -1.0)];
    let mesh = Mesh {
        positions: corners.map(|(x, z)| DVec3::new(x * half, 0.0, z * half)).to_vec(),
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        normals: Some(vec![glam::Vec3::Y; 4]),
        uvs: Some(
            corners.map(|(x, z)| Vec2::new(0.5 + 0.5 * x as f32, 0.5 + 0.5 * z as f32)).to_vec(),
        ),
        ..Mesh::default()
    };
    let rgba = (0..TEXELS * TEXELS)
        .map(|index| {
            let (x, y) = (index % TEXELS / 8, index / TEXELS / 8);
            checker_color(x, y)
        })
        .collect();
    let texture = Texture {
        name: "checkerboard".to_owned(),
        width: TEXELS,
        height: TEXELS,
        rgba,
        wrap: [Wrap::Repeat; 2],
        filter: Filter::Linear,
        encoding: Encoding::Srgb,
    };
    let material = Material { name: "checkerboard".to_owned(), ..Material::default() };
    GeneratedMesh {
        mesh,
        material: Some(material),
        texture: Some(texture),
        ..GeneratedMesh::default()
    }
}

fn checker_color(x: u32, y: u32) -> [u8; 4] {
    let major = if (x / 8 + y / 8).is_multiple_of(2) { 0 } else { 0x0a0806 };
    srgb(if (x + y).is_multiple_of(2) { 0xdcd8d0 - major } else { 0x5c6670 - major })
}

/// The square of [`checker_mesh`] as points on a grid, with normals and colours.
pub fn checker_points(size: f64, points: usize) -> PointCloud {
    let side = ((points as f64).sqrt().ceil() as usize).max(1);
    let mut cloud = PointCloud {
        normals: Some(vec![glam::Vec3::Y; points]),
        colors: Some(Vec::with_capacity(points)),
        ..PointCloud::default()
    };
    for index in 0..points {
        let (x, y) = ((index % side) as f64 + 0.5, (index / side) as f64 + 0.5);
        let (u, v) = (x / side as f64, y / side as f64);
        let dust = 1.0 + 0.02 * noise(DVec3::new(u * 90.0, v * 90.0, 0.0), 3);
        cloud.positions.push(DVec3::new((u - 0.5) * size, 0.0, (v - 0.5) * size));
        let [r, g, b, _] = checker_color((u * 64.0) as u32, (v * 64.0) as u32);
        let [r, g, b] = [r, g, b].map(|c| (f64::from(c) * dust).round().clamp(0.0, 255.0) as u8);
        cloud.colors.get_or_insert_default().push([r, g, b, 255]);
    }
    cloud
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_amphora_is_textured_and_faces_outwards() {
        let generated = amphora(0.6, 6_000, 1);
        let mesh = &generated.mesh;
        let count = mesh.triangles.len();
        assert!((5_000..8_000).contains(&count), "{count}");
        let uvs = mesh.uvs.as_ref().unwrap();
        assert!(uvs.iter().all(|uv| (0.0..=1.0).contains(&uv.x) && (0.0..=1.0).contains(&uv.y)));
        let normals = mesh.normals.as_ref().unwrap();
        let mut agree = 0;
        for t in &mesh.triangles {
            let [a, b, c] = t.map(|i| mesh.positions[i as usize]);
            let normal = normals[t[0] as usize].as_dvec3();
            agree += usize::from((b - a).cross(c - a).dot(normal) > 0.0);
        }
        assert!(agree * 100 > count * 97, "{agree} of {count}");
        let texture = generated.texture.unwrap();
        let black = texture.rgba.iter().filter(|texel| texel[0] < 60).count();
        assert!((60_000..200_000).contains(&black), "{black}");
    }

    #[test]
    fn checkers_alternate() {
        let texture = checker_mesh(10.0).texture.unwrap();
        assert_eq!(texture.rgba.len(), 512 * 512);
        assert_ne!(texture.rgba[0], texture.rgba[8]);
        assert_eq!(texture.rgba[0], texture.rgba[8 * 512 + 8]);
        let cloud = checker_points(10.0, 5_000);
        assert_eq!((cloud.positions.len(), cloud.colors.unwrap().len()), (5_000, 5_000));
    }
}
