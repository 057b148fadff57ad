//! Meshes to samples on covering disks.

use crate::assets::{Material, Mesh, PointCloud, Texture};

/// How densely a mesh is sampled.
#[derive(Clone, Debug, PartialEq)]
pub struct SampleOptions {
    /// Distance between neighbouring samples in mesh units; `None` chooses.
    pub spacing: Option<f64>,
    pub max_samples: u64,
    /// Angle between faces above which their edge is sharp.
    pub crease_deg: f64,
}

impl Default for SampleOptions {
    fn default() -> Self {
        Self { spacing: None, max_samples: 50_000_000, crease_deg: 35.0 }
    }
}

/// Why a mesh was not sampled.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct SampleError(pub String);

/// Samples a mesh.
///
/// # Errors
/// A mesh without surface.
pub fn sample_mesh(
    mesh: &Mesh,
    _materials: &[Material],
    _textures: &[Texture],
    options: &SampleOptions,
) -> Result<PointCloud, SampleError> {
    let mut cloud = PointCloud::default();
    let (mut normals, mut kernels) = (Vec::new(), Vec::new());
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|v| mesh.positions[v as usize]);
        let Some(normal) = (b - a).cross(c - a).try_normalize() else { continue };
        let spacing = options.spacing.unwrap_or((b - a).length());
        let (u, v) = normal.any_orthonormal_pair();
        cloud.positions.push((a + b + c) / 3.0);
        normals.push(normal.as_vec3());
        let axis = |axis: glam::DVec3| (axis * (0.5 * spacing)).as_vec3();
        kernels.push(crate::assets::Kernel { u: axis(u), v: axis(v) });
    }
    if cloud.positions.is_empty() {
        return Err(SampleError("the mesh has no surface to sample".to_owned()));
    }
    cloud.normals = Some(normals);
    cloud.kernels = Some(kernels);
    Ok(cloud)
}
