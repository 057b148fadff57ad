//! The parts of an asset that are measured: clouds, meshes and their triangles in the asset's coordinates.

use glam::DVec3;

use crate::assets::{Geometry, Mesh, Placement, PointCloud};

pub(super) fn as_mesh(geometry: &Geometry) -> Option<&Mesh> {
    match geometry {
        Geometry::Mesh(mesh) => Some(mesh),
        Geometry::Points(_) | Geometry::Lines(_) => None,
    }
}

pub(super) fn as_cloud(geometry: &Geometry) -> Option<&PointCloud> {
    match geometry {
        Geometry::Points(cloud) => Some(cloud),
        Geometry::Mesh(_) | Geometry::Lines(_) => None,
    }
}

/// The corners of a triangle; not a number for a vertex that the mesh does not have.
pub(super) fn corners(mesh: &Mesh, placement: &Placement, triangle: [u32; 3]) -> [DVec3; 3] {
    triangle.map(|vertex| {
        let at = mesh.positions.get(vertex as usize).copied().unwrap_or(DVec3::NAN);
        placement.asset_from_geometry.transform_point3(at)
    })
}

/// The area of each triangle; 0 where it is not finite.
pub(super) fn areas<'a>(
    mesh: &'a Mesh,
    placement: &'a Placement,
) -> impl Iterator<Item = f64> + 'a {
    mesh.triangles.iter().map(|triangle| {
        let [a, b, c] = corners(mesh, placement, *triangle);
        let area = 0.5 * (b - a).cross(c - a).length();
        if area.is_finite() { area } else { 0.0 }
    })
}
