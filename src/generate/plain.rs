//! Plain meshes: `cube`, `sphere`, `tree`, and the furniture of the plaza.

use std::f64::consts::{PI, TAU};

use glam::DVec3;

use super::GeneratedMesh;
use super::numeric::sin_cos;
use crate::assets::{Material, Mesh};
use crate::scene::random::SplitMix64;

/// Collects coloured faces, each with its own vertices.
#[derive(Default)]
pub struct Faces {
    mesh: Mesh,
    normals: Vec<glam::Vec3>,
    colors: Vec<[u8; 4]>,
}

/// An opaque sRGB colour from `0xrrggbb`.
pub fn srgb(hex: u32) -> [u8; 4] {
    [(hex >> 16) as u8, (hex >> 8) as u8, hex as u8, 255]
}

impl Faces {
    /// Adds a flat convex polygon, counter-clockwise seen from outside.
    pub fn polygon(&mut self, corners: &[DVec3], color: [u8; 4]) {
        let [a, b, c, ..] = corners else { return };
        let normal = (*b - *a).cross(*c - *a);
        let normal = if normal.length() > 0.0 { normal / normal.length() } else { DVec3::ZERO };
        self.smooth_polygon(corners, &vec![normal; corners.len()], color);
    }

    /// Adds a polygon with a normal at each corner.
    pub fn smooth_polygon(&mut self, corners: &[DVec3], normals: &[DVec3], color: [u8; 4]) {
        let first = self.mesh.positions.len() as u32;
        self.mesh.positions.extend_from_slice(corners);
        self.normals.extend(normals.iter().map(|n| n.as_vec3()));
        self.colors.extend(corners.iter().map(|_| color));
        for i in 1..corners.len().saturating_sub(1) as u32 {
            self.mesh.triangles.push([first, first + i, first + i + 1]);
        }
    }

    /// Adds an axis-aligned box.
    pub fn cuboid(&mut self, min: DVec3, max: DVec3, color: [u8; 4]) {
        let corner = |bits: usize| {
            let pick = |axis: usize| if bits >> axis & 1 == 1 { max[axis] } else { min[axis] };
            DVec3::new(pick(0), pick(1), pick(2))
        };
        // Bits x, y, z number the corners. Each face is counter-clockwise seen from outside.
        for face in
            [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]]
        {
            self.polygon(&face.map(corner), color);
        }
    }

    /// Adds a tapering tube between two points, closed at both ends.
    pub fn tube(&mut self, from: DVec3, to: DVec3, radii: [f64; 2], sides: u32, color: [u8; 4]) {
        let [low, high] = self.mantle(from, to, radii, sides, color);
        self.polygon(&high, color);
        self.polygon(&low.into_iter().rev().collect::<Vec<_>>(), color);
    }

    /// Adds a tapering tube without its ends, and returns the two rings of corners.
    fn mantle(
        &mut self,
        from: DVec3,
        to: DVec3,
        radii: [f64; 2],
        sides: u32,
        color: [u8; 4],
    ) -> [Vec<DVec3>; 2] {
        let axis = to - from;
        let helper = if axis.x.abs() < 0.6 * axis.length() { DVec3::X } else { DVec3::Y };
        let u = axis.cross(helper);
        let u = u / u.length();
        let v = axis.cross(u) / axis.length();
        let out = |i: u32| {
            let (s, c) = sin_cos(TAU * f64::from(i % sides) / f64::from(sides));
            u * c + v * s
        };
        let [low, high]: [Vec<DVec3>; 2] = [(from, radii[0]), (to, radii[1])]
            .map(|(end, radius)| (0..sides).map(|i| end + out(i) * radius).collect());
        for i in 0..sides {
            let j = (i + 1) % sides;
            let (a, b) = (i as usize, j as usize);
            let (na, nb) = (out(i), out(j));
            self.smooth_polygon(&[low[a], low[b], high[b], high[a]], &[na, nb, nb, na], color);
        }
        [low, high]
    }

    /// Returns the finished mesh.
    pub fn finish(mut self, material: Option<Material>) -> GeneratedMesh {
        self.mesh.normals = Some(self.normals);
        self.mesh.colors = Some(self.colors);
        GeneratedMesh { mesh: self.mesh, material, ..GeneratedMesh::default() }
    }
}

/// A cube of edge `size`, centred on the origin.
pub fn cube(size: f64) -> GeneratedMesh {
    let mut faces = Faces::default();
    faces.cuboid(DVec3::splat(-0.5 * size), DVec3::splat(0.5 * size), srgb(0xc8ccd2));
    faces.finish(None)
}

/// A sphere of diameter `size` about the origin, in rings of quads, with shared vertices.
pub fn sphere(size: f64, triangles: u64) -> GeneratedMesh {
    // The number of triangles is 2 · rings · sectors minus those at the poles, with twice as many sectors as rings.
    let rings = ((triangles as f64 / 4.0).sqrt().round() as u32).max(3);
    let sectors = 2 * rings;
    let mut mesh = Mesh::default();
    let mut normals = vec![DVec3::Y];
    for ring in 1..rings {
        let (s, c) = sin_cos(PI * f64::from(ring) / f64::from(rings));
        for sector in 0..sectors {
            let (x, z) = sin_cos(TAU * f64::from(sector) / f64::from(sectors));
            normals.push(DVec3::new(s * x, c, s * z));
        }
    }
    normals.push(DVec3::NEG_Y);
    let last = normals.len() as u32 - 1;
    let at = |ring: u32, sector: u32| 1 + (ring - 1) * sectors + sector % sectors;
    for sector in 0..sectors {
        mesh.triangles.push([0, at(1, sector), at(1, sector + 1)]);
        for ring in 1..rings - 1 {
            let (a, b) = (at(ring, sector), at(ring, sector + 1));
            let (c, d) = (at(ring + 1, sector), at(ring + 1, sector + 1));
            mesh.triangles.extend([[a, c, d], [a, d, b]]);
        }
        mesh.triangles.push([last, at(rings - 1, sector + 1), at(rings - 1, sector)]);
    }
    mesh.positions = normals.iter().map(|&n| n * (0.5 * size)).collect();
    mesh.normals = Some(normals.iter().map(|n| n.as_vec3()).collect());
    GeneratedMesh { mesh, ..GeneratedMesh::default() }
}

/// A tree of `height`, standing on the origin, y up: a trunk that forks a few times, and leaves as single quads around the twigs.
/// The fewer triangles there are, the larger the leaves.
pub fn tree(height: f64, triangles: u64, seed: u64) -> GeneratedMesh {
    let mut random = SplitMix64::stream(seed, 31);
    let mut wood = Wood { levels: if triangles < 4_000 { 2 } else { 3 }, ..Wood::default() };
    let rise = DVec3::Y * 0.34 * height;
    wood.grow(DVec3::ZERO, rise, 0.03 * height, 0, &mut random);
    let Wood { mut faces, twigs, .. } = wood;
    let leaves = triangles.saturating_sub(faces.mesh.triangles.len() as u64) / 2;
    let palette = [0x55803a, 0x648f3e, 0x78a046, 0x466f33, 0x8aa84e].map(srgb);
    let crown = DVec3::Y * 0.62 * height;
    let leaf_size = height * (0.6 / (leaves as f64).sqrt().max(1.0)).clamp(0.006, 0.06);
    for i in 0..leaves {
        let twig: DVec3 = twigs[(i % twigs.len() as u64) as usize];
        let scatter = height * if wood.levels == 2 { 0.085 } else { 0.06 };
        let middle = twig + random.bells() * scatter;
        let across = random.bells();
        let across = across / across.length().max(1e-9);
        let normal = across.cross(random.bells());
        let normal = normal / normal.length().max(1e-9);
        let size = leaf_size * random.range(0.75, 1.3);
        let (along, across) = (normal.cross(across) * size * 1.5, across * size);
        let corners = [middle - along, middle + across, middle + along, middle - across];
        // Lit as part of the crown, not as a single leaf.
        let out = middle - crown;
        let soft = out / out.length().max(1e-9);
        let color = palette[random.index(palette.len())];
        faces.smooth_polygon(&corners, &[soft; 4], color);
    }
    faces.finish(None)
}

/// Trunk and branches, and the places of leaves.
#[derive(Default)]
struct Wood {
    faces: Faces,
    twigs: Vec<DVec3>,
    /// Number of times that branches fork.
    levels: u32,
}

impl Wood {
    fn grow(&mut self, from: DVec3, rise: DVec3, radius: f64, level: u32, random: &mut SplitMix64) {
        let to = from + rise;
        let sides = if level < self.levels - 1 { 6 } else { 4 };
        self.faces.mantle(from, to, [radius, 0.62 * radius], sides, srgb(0x6b533d));
        if level + 1 >= self.levels {
            self.twigs.extend([to, from + rise * 0.6]);
        }
        if level == self.levels {
            return;
        }
        let forks = if level == 0 { 5 } else { 3 };
        let start = random.range(0.0, TAU);
        for fork in 0..forks {
            let (s, c) = sin_cos(start + TAU * f64::from(fork) / f64::from(forks));
            let spread = random.range(0.55, 0.9);
            let length = rise.length() * random.range(0.5, 0.68);
            let way = rise / rise.length() + DVec3::new(c, 0.1, s) * spread;
            let way = way / way.length() * length;
            let at = from + rise * random.range(0.75, 1.0);
            self.grow(at, way, 0.6 * radius, level + 1, random);
        }
    }
}

/// A park bench of length 1.8 whose seat faces +z.
pub fn bench() -> GeneratedMesh {
    let mut faces = Faces::default();
    let (wood, iron) = (srgb(0x8a6340), srgb(0x3c4044));
    for i in 0..3 {
        let z = -0.2 + 0.15 * f64::from(i);
        faces.cuboid(DVec3::new(-0.9, 0.42, z), DVec3::new(0.9, 0.46, z + 0.12), wood);
    }
    for i in 0..2 {
        let y = 0.55 + 0.17 * f64::from(i);
        faces.cuboid(DVec3::new(-0.9, y, -0.29), DVec3::new(0.9, y + 0.13, -0.25), wood);
    }
    for x in [-0.75, 0.69] {
        faces.cuboid(DVec3::new(x, 0.0, -0.28), DVec3::new(x + 0.06, 0.42, -0.22), iron);
        faces.cuboid(DVec3::new(x, 0.0, 0.16), DVec3::new(x + 0.06, 0.42, 0.22), iron);
        faces.cuboid(DVec3::new(x, 0.36, -0.25), DVec3::new(x + 0.06, 0.42, 0.22), iron);
        faces.cuboid(DVec3::new(x, 0.42, -0.31), DVec3::new(x + 0.06, 0.88, -0.27), iron);
    }
    faces.finish(None)
}

/// A lantern on a post, of height 3.4.
pub fn lamp() -> GeneratedMesh {
    let mut faces = Faces::default();
    let (iron, light) = (srgb(0x2f3b39), srgb(0xfff1c4));
    let up = |y: f64| DVec3::Y * y;
    faces.tube(up(0.0), up(0.5), [0.14, 0.09], 8, iron);
    faces.tube(up(0.5), up(2.8), [0.055, 0.045], 8, iron);
    faces.tube(up(2.8), up(2.86), [0.12, 0.15], 8, iron);
    faces.tube(up(2.86), up(3.2), [0.12, 0.17], 8, light);
    faces.tube(up(3.2), up(3.4), [0.2, 0.03], 8, iron);
    faces.finish(None)
}

/// The ground of one assembly: a paved tile of edge `size` with a raised border and a round plinth.
pub fn tile(size: f64) -> GeneratedMesh {
    let mut faces = Faces::default();
    let half = 0.5 * size;
    let (light, dark, border) = (srgb(0xb9b2a4), srgb(0xa39b8c), srgb(0x8f8778));
    let count = 6;
    let edge = size / f64::from(count);
    for z in 0..count {
        for x in 0..count {
            let (x0, z0) = (f64::from(x) * edge - half, f64::from(z) * edge - half);
            let color = if (x + z) % 2 == 0 { light } else { dark };
            let corner = |dx: f64, dz: f64| DVec3::new(x0 + dx * edge, 0.0, z0 + dz * edge);
            let corners = [corner(0.0, 0.0), corner(0.0, 1.0), corner(1.0, 1.0), corner(1.0, 0.0)];
            faces.polygon(&corners, color);
        }
    }
    faces.tube(DVec3::Y * -0.02, DVec3::Y * 0.18, [0.95, 0.9], 16, border);
    faces.tube(DVec3::Y * 0.18, DVec3::Y * 0.3, [0.7, 0.66], 16, light);
    faces.finish(None)
}

#[cfg(test)]
mod tests {
    use super::super::isosurface::tests::{assert_watertight, volume};
    use super::*;

    #[test]
    fn spheres_are_round_and_closed() {
        let mesh = sphere(2.0, 2_000).mesh;
        assert_watertight(&mesh.triangles);
        assert!((1_800..2_200).contains(&mesh.triangles.len()), "{}", mesh.triangles.len());
        let found = volume(&mesh.positions, &mesh.triangles);
        assert!((found / (4.0 / 3.0 * PI) - 1.0).abs() < 0.01, "{found}");
    }

    #[test]
    fn boxes_and_tubes_face_outwards() {
        let mesh = cube(2.0).mesh;
        assert_eq!(mesh.triangles.len(), 12);
        assert!((volume(&mesh.positions, &mesh.triangles) - 8.0).abs() < 1e-12);
        let mut faces = Faces::default();
        faces.tube(DVec3::ZERO, DVec3::Y * 2.0, [1.0, 1.0], 64, srgb(0));
        let found = volume(&faces.mesh.positions, &faces.mesh.triangles);
        assert!((found / TAU - 1.0).abs() < 0.01, "{found}");
        let normals = cube(1.0).mesh.normals.unwrap();
        assert!(
            cube(1.0).mesh.positions.iter().zip(normals).all(|(p, n)| p.dot(n.as_dvec3()) > 0.0)
        );
    }

    #[test]
    fn trees_have_the_size_asked_for() {
        let mesh = tree(6.0, 3_000, 4).mesh;
        let high = mesh.positions.iter().fold(0.0f64, |m, p| m.max(p.y));
        assert!((4.5..8.5).contains(&high), "{high}");
        assert!((2_900..3_001).contains(&mesh.triangles.len()), "{}", mesh.triangles.len());
        assert_eq!(mesh.colors.unwrap().len(), mesh.positions.len());
    }
}
