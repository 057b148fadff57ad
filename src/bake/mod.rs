//! Assets → what the GPU holds (floor 2).

pub mod pack;

pub fn fill_colors(_: &mut crate::assets::PointCloud) {}
pub fn estimate_point_attributes(_: &mut crate::assets::PointCloud) {}
pub fn smooth_normals(_: &mut crate::assets::Mesh, _: f64) {}
