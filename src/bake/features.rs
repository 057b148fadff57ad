//! Sharp features of point clouds, and kernels for those without.

use crate::assets::{Kernel, PointCloud};

/// What counts as a sharp feature.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FeatureOptions {}

/// Gives samples at sharp features their clip lines.
pub fn detect_features(_cloud: &mut PointCloud, _options: &FeatureOptions) {}

/// Gives samples without kernels round ones.
pub fn estimate_kernels(cloud: &mut PointCloud) {
    if cloud.kernels.is_none()
        && let (Some(normals), Some(radii)) = (&cloud.normals, &cloud.radii)
    {
        let round = |(normal, radius): (&glam::Vec3, &f32)| match normal.try_normalize() {
            Some(normal) => {
                let (u, v) = normal.any_orthonormal_pair();
                Kernel { u: u * *radius, v: v * *radius }
            }
            None => Kernel::default(),
        };
        cloud.kernels = Some(normals.iter().zip(radii).map(round).collect());
    }
}
