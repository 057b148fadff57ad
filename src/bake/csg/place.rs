//! An operand moved to where it is combined.

use glam::{DAffine3, DMat3, DVec3, Vec2, Vec3};

use crate::assets::{Clip, Kernel, PointCloud};

/// The cloud under an invertible affine map: positions, normals, kernels, clip lines and radii.
///
/// Under a map that stretches unevenly a kernel's axes are turned to those of its image, so that they stay orthogonal,
/// and its clip lines with them.
pub fn transformed(cloud: &PointCloud, map: &DAffine3) -> PointCloud {
    let linear = map.matrix3;
    // Normals go with the cofactors, which need no division; a mirror image's look outward as well.
    let cofactors = DMat3::from_cols(
        linear.y_axis.cross(linear.z_axis),
        linear.z_axis.cross(linear.x_axis),
        linear.x_axis.cross(linear.y_axis),
    ) * linear.determinant().signum();
    let normal = |n: &Vec3| {
        (cofactors * n.as_dvec3()).try_normalize().map_or(Vec3::ZERO, |normal| normal.as_vec3())
    };
    let mirrored = linear.determinant() < 0.0;
    let mut result = cloud.clone();
    result.positions.iter_mut().for_each(|p| *p = map.transform_point3(*p));
    result.normals.iter_mut().flatten().for_each(|n| *n = normal(n));
    let scale = linear.determinant().abs().cbrt() as f32;
    result.radii.iter_mut().flatten().for_each(|radius| *radius *= scale);
    for (index, kernel) in result.kernels.iter_mut().flatten().enumerate() {
        let (u, v) = (linear * kernel.u.as_dvec3(), linear * kernel.v.as_dvec3());
        let turn = principal_turn(u, v);
        let (c, s) = (f64::from(turn.x), f64::from(turn.y));
        let flip = if mirrored { -1.0 } else { 1.0 };
        *kernel = Kernel { u: (u * c + v * s).as_vec3(), v: ((v * c - u * s) * flip).as_vec3() };
        if let Some(clip) = result.clips.as_mut().and_then(|clips| clips.get_mut(index)) {
            turn_lines(clip, turn, flip as f32);
        }
    }
    result
}

/// Cosine and sine of the turn that takes an ellipse's conjugate axes to its principal ones.
fn principal_turn(u: DVec3, v: DVec3) -> Vec2 {
    let across = u.dot(v);
    let (uu, vv) = (u.length_squared(), v.length_squared());
    if across.abs() <= 1e-7 * (uu * vv).sqrt() {
        return Vec2::X;
    }
    let (s, c) = (0.5 * (2.0 * across).atan2(uu - vv)).sin_cos();
    Vec2::new(c as f32, s as f32)
}

fn turn_lines(clip: &mut Clip, turn: Vec2, flip: f32) {
    for line in clip.lines.iter_mut().flatten() {
        let across = Vec2::new(-turn.y, turn.x) * flip;
        line.normal = Vec2::new(line.normal.dot(turn), line.normal.dot(across));
    }
}
