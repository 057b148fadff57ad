//! `relief` and `statue`: a sculpted solid with fine relief, as a mesh and as a dense point cloud.
//!
//! The input is a height, a number of triangles or points, and a seed. The output is a watertight mesh with outward triangles,
//! normals and colours, or points spread evenly over the same surface, with normals and colours. The shape is
//! [`sculpture::Sculpture`], a signed distance function. The mesh comes from [`super::isosurface`]. Points are distributed over a
//! mesh by area (a low-discrepancy sequence within triangles) and moved onto the surface.

mod sculpture;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::GeneratedMesh;
use super::isosurface::{Isosurface, gradient, isosurface};
use crate::assets::{Mesh, PointCloud, Progress};
use sculpture::{HEIGHT, Sculpture};

/// Step of the finite differences for normals, in metres at a height of two.
const NORMAL_STEP: f64 = 0.001;

/// Parameters of a relief.
#[derive(Clone, Debug)]
pub struct ReliefParameters {
    pub height: f64,
    /// Number of triangles of a mesh (within a few per cent), or number of points of a cloud (exactly).
    pub count: usize,
    pub seed: u64,
}

/// The sculpture as a mesh.
pub fn relief(parameters: &ReliefParameters, progress: &Progress) -> GeneratedMesh {
    let sculpture = Sculpture::new(parameters.seed);
    let surface = mesh(&sculpture, parameters.count, progress);
    let step = NORMAL_STEP;
    let looks: Vec<(Vec3, [u8; 4])> = surface
        .positions
        .par_iter()
        .map(|&p| {
            let normal = gradient(&|q| sculpture.distance(q), p, step);
            (normal.as_vec3(), sculpture.color(p, normal))
        })
        .collect();
    progress.report(1.0);
    let scale = parameters.height / HEIGHT;
    let mesh = Mesh {
        positions: surface.positions.iter().map(|&p| p * scale).collect(),
        triangles: surface.triangles,
        normals: Some(looks.iter().map(|look| look.0).collect()),
        colors: Some(looks.iter().map(|look| look.1).collect()),
        ..Mesh::default()
    };
    GeneratedMesh { mesh, ..GeneratedMesh::default() }
}

/// A mesh of about `triangles` triangles: the number grows with the square of the resolution.
fn mesh(sculpture: &Sculpture, triangles: usize, progress: &Progress) -> Isosurface {
    let distance = |p: DVec3| sculpture.distance(p);
    let coarse = HEIGHT / 90.0;
    let found = isosurface(&distance, sculpture.bounds(), coarse).triangles.len().max(1);
    progress.report(0.1);
    let cell = coarse * (found as f64 / triangles as f64).sqrt();
    let surface = isosurface(&distance, sculpture.bounds(), cell);
    progress.report(0.6);
    surface
}

/// The sculpture as points that are spread evenly by area.
pub fn statue(parameters: &ReliefParameters, progress: &Progress) -> PointCloud {
    let sculpture = Sculpture::new(parameters.seed);
    let carrier = mesh(&sculpture, (parameters.count / 6).clamp(40_000, 400_000), progress);
    let mut total = 0.0;
    let areas: Vec<f64> = carrier
        .triangles
        .iter()
        .map(|t| {
            let [a, b, c] = t.map(|i| carrier.positions[i as usize]);
            total += 0.5 * (b - a).cross(c - a).length();
            total
        })
        .collect();
    let scale = parameters.height / HEIGHT;
    let count = parameters.count;
    let mut cloud = PointCloud {
        normals: Some(Vec::with_capacity(count)),
        colors: Some(Vec::with_capacity(count)),
        positions: Vec::with_capacity(count),
        ..PointCloud::default()
    };
    const PORTION: usize = 1 << 16;
    for first in (0..count).step_by(PORTION) {
        let portion: Vec<(DVec3, DVec3, [u8; 4])> = (first..(first + PORTION).min(count))
            .into_par_iter()
            .map(|index| {
                let p = spread(&carrier, &areas, index, count);
                on_surface(&sculpture, p)
            })
            .collect();
        for (p, normal, color) in portion {
            cloud.positions.push(p * scale);
            cloud.normals.get_or_insert_default().push(normal.as_vec3());
            cloud.colors.get_or_insert_default().push(color);
        }
        progress.report(0.6 + 0.4 * (first as f32 / count as f32));
    }
    cloud
}

/// Point `index` of `count` on a mesh. Equal steps of area choose the triangle, and the R₂ sequence (Roberts 2018) the position
/// in it.
fn spread(mesh: &Isosurface, areas: &[f64], index: usize, count: usize) -> DVec3 {
    let total = areas.last().copied().unwrap_or(0.0);
    let at = (index as f64 + 0.5) / count as f64 * total;
    let triangle = areas.partition_point(|&sum| sum < at).min(mesh.triangles.len() - 1);
    let [a, b, c] = mesh.triangles[triangle].map(|i| mesh.positions[i as usize]);
    let n = index as f64;
    let (mut u, mut v) =
        ((n * 0.754_877_666_246_692_8).fract(), (n * 0.569_840_290_998_053_3).fract());
    if u + v > 1.0 {
        (u, v) = (1.0 - u, 1.0 - v);
    }
    a + (b - a) * u + (c - a) * v
}

fn on_surface(sculpture: &Sculpture, mut p: DVec3) -> (DVec3, DVec3, [u8; 4]) {
    let distance = |q: DVec3| sculpture.distance(q);
    for _ in 0..4 {
        let off = distance(p);
        if off.abs() < 2e-4 {
            break;
        }
        p -= gradient(&distance, p, NORMAL_STEP) * off;
    }
    let normal = gradient(&distance, p, NORMAL_STEP);
    (p, normal, sculpture.color(p, normal))
}

#[cfg(test)]
mod tests {
    use super::super::isosurface::tests::{assert_watertight, volume};
    use super::*;

    fn small() -> GeneratedMesh {
        let parameters = ReliefParameters { height: 2.0, count: 30_000, seed: 1 };
        relief(&parameters, &Progress::none())
    }

    #[test]
    fn the_relief_is_watertight_outward_and_as_fine_as_asked() {
        let generated = small();
        let mesh = &generated.mesh;
        assert_watertight(&mesh.triangles);
        let count = mesh.triangles.len();
        assert!((27_000..33_000).contains(&count), "{count}");
        let volume = volume(&mesh.positions, &mesh.triangles);
        assert!((0.1..0.4).contains(&volume), "{volume}");
        let normals = mesh.normals.as_ref().unwrap();
        let mut agree = 0;
        for t in &mesh.triangles {
            let [a, b, c] = t.map(|i| mesh.positions[i as usize]);
            let flat = (b - a).cross(c - a);
            agree += i32::from(flat.dot(normals[t[0] as usize].as_dvec3()) > 0.0);
        }
        // Scales are only two or three cells wide here, so some facets cut across them.
        assert!(f64::from(agree) > 0.94 * count as f64, "{agree} of {count}");
        assert!(normals.iter().all(|n| (n.length() - 1.0).abs() < 1e-4));
    }

    #[test]
    fn statue_points_lie_on_the_surface_and_are_even() {
        let parameters = ReliefParameters { height: 4.0, count: 20_000, seed: 1 };
        let cloud = statue(&parameters, &Progress::none());
        assert_eq!(cloud.positions.len(), 20_000);
        let sculpture = Sculpture::new(1);
        let off =
            cloud.positions.iter().filter(|&&p| sculpture.distance(p * 0.5).abs() > 0.002).count();
        assert!(off < 200, "{off} points off the surface");
        // The plinth's top and bottom have known areas, and density must be equal on both.
        let on = |low: f64, high: f64| {
            cloud.positions.iter().filter(|p| p.y > low && p.y < high).count() as f64
        };
        let density = on(-0.001, 0.001) / (4.0 * 0.696 * 0.696);
        let whole = 20_000.0 / (4.0 * 4.0);
        assert!(density / whole > 0.5 && density / whole < 2.0, "{density} {whole}");
    }

    #[test]
    fn seeds_vary_and_repeat() {
        let again = small();
        assert_eq!(small().mesh.positions, again.mesh.positions);
        let parameters = ReliefParameters { height: 2.0, count: 30_000, seed: 2 };
        let other = relief(&parameters, &Progress::none());
        assert_ne!(other.mesh.positions, again.mesh.positions);
    }
}
