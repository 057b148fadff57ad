//! Last steps of every reader: colours to bytes, normals to unit length, vertices
//! that are nowhere (not-a-number, infinite) and triangles that cover nothing taken out, and said so.

use glam::{DVec3, Vec2, Vec3};

use super::warnings::{Odd, counted};
use super::{AssetError, Mesh, PointCloud};

/// Largest channel of a file whose colours count to 1. Conversions between colour spaces round, and interpolation overshoots; a
/// file that counts to 255 and has no channel above this is all but black.
pub(crate) const MOST_OF_UNIT: f32 = 2.0;

/// Colours as bytes from floats. A file with any channel above [`MOST_OF_UNIT`] counts from 0 to 255, others from 0
/// to 1; not-a-number becomes white. The warning calls the first such colour `first` and its number.
pub(crate) fn colors_from_floats(
    values: &[[f32; 4]],
    first: &str,
    warnings: &mut Vec<String>,
) -> Vec<[u8; 4]> {
    let bytes = values.iter().any(counts_to_255);
    let mut bad = Odd::default();
    let colors = values
        .iter()
        .enumerate()
        .map(|(index, color)| {
            let [r, g, b, _] = *color;
            if !(r.is_finite() && g.is_finite() && b.is_finite()) {
                bad.add(index as u64);
            }
            color_from_floats(*color, bytes)
        })
        .collect();
    warnings.extend(bad.warning(
        "colour is not a number and is drawn white",
        "colours are not numbers and are drawn white",
        first,
    ));
    colors
}

/// Whether a colour can only be one of those that count from 0 to 255.
pub(crate) fn counts_to_255(color: &[f32; 4]) -> bool {
    color.iter().any(|channel| channel.is_finite() && *channel > MOST_OF_UNIT)
}

/// A colour of a file whose colours count from 0 to 255 (`bytes`) or to 1.
pub(crate) fn color_from_floats([r, g, b, a]: [f32; 4], bytes: bool) -> [u8; 4] {
    if !(r.is_finite() && g.is_finite() && b.is_finite()) {
        return [255; 4];
    }
    let scale = if bytes { 1.0 } else { 255.0 };
    let byte = |channel: f32| (channel * scale).round() as u8;
    // Alpha that the file does not give is 1 whatever the scale.
    let alpha = if a.is_nan() { 255 } else { byte(a) };
    [byte(r), byte(g), byte(b), alpha]
}

/// A normal at unit length; zero stays zero, not-a-number becomes zero.
pub(crate) fn unit_normal(normal: Vec3) -> Vec3 {
    if !normal.is_finite() {
        return Vec3::ZERO;
    }
    let wide = normal.as_dvec3();
    (wide / wide.length().max(f64::MIN_POSITIVE)).as_vec3()
}

/// Scales normals to unit length in place; zero stays zero, not-a-number becomes zero. `None` when
/// none of them says anything.
pub(crate) fn unit_normals(
    mut normals: Vec<Vec3>,
    warnings: &mut Vec<String>,
) -> Option<Vec<Vec3>> {
    let mut bad = Odd::default();
    let mut any = false;
    for (index, normal) in normals.iter_mut().enumerate() {
        if !normal.is_finite() {
            bad.add(index as u64);
        }
        *normal = unit_normal(*normal);
        any |= *normal != Vec3::ZERO;
    }
    warnings.extend(bad.warning(
        "normal is not a number and counts as unknown",
        "normals are not numbers and count as unknown",
        "that of vertex",
    ));
    any.then_some(normals)
}

fn keep<T>(values: &mut Option<Vec<T>>, kept: &[bool]) {
    if let Some(values) = values {
        retain(values, kept);
    }
}

pub(super) fn retain<T>(values: &mut Vec<T>, kept: &[bool]) {
    let mut flags = kept.iter();
    values.retain(|_| flags.next().copied().unwrap_or(false));
}

/// Takes points without a place out of a cloud.
///
/// # Errors
/// No point is left.
pub(crate) fn finish_cloud(
    mut cloud: PointCloud,
    file: &str,
    warnings: &mut Vec<String>,
) -> Result<PointCloud, AssetError> {
    if cloud.positions.is_empty() {
        return Err(AssetError::malformed(file, "vertex", "the file holds no vertices"));
    }
    let kept: Vec<bool> = cloud.positions.iter().map(|p| p.is_finite()).collect();
    let mut lost = Odd::default();
    (0..).zip(&kept).filter(|(_, kept)| !**kept).for_each(|(vertex, _)| lost.add(vertex));
    let warning = lost.warning(
        "point with non-finite coordinates is left out",
        "points with non-finite coordinates are left out",
        "vertex",
    );
    if warning.is_none() {
        return Ok(cloud);
    }
    if !kept.contains(&true) {
        return Err(AssetError::malformed(file, "vertex", "no vertex has finite coordinates"));
    }
    retain(&mut cloud.positions, &kept);
    keep(&mut cloud.colors, &kept);
    keep(&mut cloud.normals, &kept);
    cloud.fields.retain(&kept);
    keep(&mut cloud.radii, &kept);
    keep(&mut cloud.kernels, &kept);
    keep(&mut cloud.clips, &kept);
    warnings.extend(warning);
    Ok(cloud)
}

/// Takes out triangles that use a vertex without a place or one vertex twice, then the vertices
/// without a place. Texture coordinates that are not finite become 0. Every index must be in range; `parts` shrink with their
/// triangles.
///
/// # Errors
/// No triangle is left.
pub(crate) fn finish_mesh(
    mut mesh: Mesh,
    file: &str,
    warnings: &mut Vec<String>,
) -> Result<Mesh, AssetError> {
    // Before vertices are taken out, which would change the number that the warning names.
    if let Some(uvs) = &mut mesh.uvs {
        finite_uvs(uvs, warnings);
    }
    let placed: Vec<bool> = mesh.positions.iter().map(|p| p.is_finite()).collect();
    let all_placed = placed.iter().all(|placed| *placed);
    let is_placed =
        |t: &[u32; 3]| t.iter().all(|&i| placed.get(i as usize).copied().unwrap_or(false));
    let (mut adrift, mut flat) = (0u64, 0u64);
    let mut usable = |t: &[u32; 3]| {
        if !all_placed && !is_placed(t) {
            adrift += 1;
            return false;
        }
        let [a, b, c] = *t;
        let twice = a == b || b == c || c == a;
        flat += u64::from(twice);
        !twice
    };
    let mut kept_parts = Vec::with_capacity(mesh.parts.len());
    let mut write = 0;
    let mut read = 0;
    let count = mesh.triangles.len();
    let mut lengths = mesh.parts.iter().map(|part| part.triangles as usize);
    while read < count {
        let end = lengths.next().map_or(count, |length| count.min(read + length));
        let begin = write;
        for at in read..end {
            let triangle = mesh.triangles[at];
            if usable(&triangle) {
                mesh.triangles[write] = triangle;
                write += 1;
            }
        }
        kept_parts.push((write - begin) as u32);
        read = end;
    }
    mesh.triangles.truncate(write);
    for (part, length) in mesh.parts.iter_mut().zip(kept_parts) {
        part.triangles = length;
    }
    mesh.parts.retain(|part| part.triangles > 0);
    if mesh.triangles.is_empty() {
        let reason = "every triangle is degenerate or has non-finite corners";
        let reason = if count == 0 { "no face has three corners" } else { reason };
        return Err(AssetError::malformed(file, "face", reason));
    }
    for (count, one, many) in [
        (
            adrift,
            "triangle with non-finite corners is left out",
            "triangles with non-finite corners are left out",
        ),
        (
            flat,
            "triangle that uses one vertex twice is left out",
            "triangles that use one vertex twice are left out",
        ),
    ] {
        warnings.extend(counted(count, one, many));
    }
    if !mesh.triangles.iter().any(|triangle| has_area(&mesh.positions, triangle)) {
        warnings.push("no triangle has an area: nothing of the mesh can be seen".to_owned());
    }
    if !all_placed {
        drop_vertices(&mut mesh, &placed);
    }
    Ok(mesh)
}

/// Replaces texture coordinates that are not finite by 0.
fn finite_uvs(uvs: &mut [Vec2], warnings: &mut Vec<String>) {
    let mut bad = Odd::default();
    for (index, uv) in uvs.iter_mut().enumerate().filter(|(_, uv)| !uv.is_finite()) {
        bad.add(index as u64);
        *uv = Vec2::ZERO;
    }
    warnings.extend(bad.warning(
        "texture coordinate is not finite and is taken as 0",
        "texture coordinates are not finite and are taken as 0",
        "that of vertex",
    ));
}

fn has_area(positions: &[DVec3], triangle: &[u32; 3]) -> bool {
    let [a, b, c] = triangle.map(|i| positions.get(i as usize).copied().unwrap_or(DVec3::NAN));
    (b - a).cross(c - a) != DVec3::ZERO
}

/// Keeps some of a mesh's vertices. Its triangles use no others.
pub(crate) fn drop_vertices(mesh: &mut Mesh, kept: &[bool]) {
    let mut next = 0u32;
    let renumbered: Vec<u32> = kept
        .iter()
        .map(|kept| {
            let number = next;
            next += u32::from(*kept);
            number
        })
        .collect();
    retain(&mut mesh.positions, kept);
    keep(&mut mesh.colors, kept);
    keep(&mut mesh.normals, kept);
    keep(&mut mesh.uvs, kept);
    for index in mesh.triangles.iter_mut().flatten() {
        *index = renumbered[*index as usize];
    }
}

/// Linear channel in 0..=1 from an sRGB one (IEC 61966-2-1).
pub(crate) fn linear_from_srgb(value: f32) -> f32 {
    let value = value.clamp(0.0, 1.0);
    if value <= 0.040_45 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
}

/// sRGB byte from a linear channel.
pub(crate) fn srgb_byte_from_linear(value: f32) -> u8 {
    let value = value.clamp(0.0, 1.0);
    let encoded =
        if value <= 0.003_130_8 { value * 12.92 } else { 1.055 * value.powf(1.0 / 2.4) - 0.055 };
    (encoded * 255.0).round() as u8
}

/// Position bits with one zero, for welding by exact place.
pub(crate) fn weld_key(position: DVec3) -> [u64; 3] {
    position.to_array().map(|c| (c + 0.0).to_bits())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::assets::MeshPart;

    #[test]
    fn float_colours_find_their_scale() {
        let mut warnings = Vec::new();
        let mut colors_from_floats =
            |values: &[[f32; 4]]| super::colors_from_floats(values, "that of face", &mut warnings);
        let unit = colors_from_floats(&[[0.5, 0.0, 1.0, f32::NAN]]);
        assert_eq!(unit, [[128, 0, 255, 255]]);
        let byte = colors_from_floats(&[[200.0, 1.0, 300.0, 7.0]]);
        assert_eq!(byte, [[200, 1, 255, 7]]);
        let rounded = colors_from_floats(&[[1.000_000_1, 0.5, 1.25, 1.0]]);
        assert_eq!(rounded, [[255, 128, 255, 255]], "slightly above 1 is not 1 of 255");
        let odd = colors_from_floats(&[[f32::NAN, 0.0, 0.0, 1.0]]);
        assert_eq!(odd, [[255; 4]]);
        let said = "1 colour is not a number and is drawn white; the first is that of face 0";
        assert_eq!(warnings, [said]);
    }

    #[test]
    fn normals_are_scaled() {
        let mut warnings = Vec::new();
        let given = vec![Vec3::new(0.0, 3.0, 4.0), Vec3::ZERO, Vec3::NAN, Vec3::splat(1e-30)];
        let unit = unit_normals(given, &mut warnings).unwrap();
        assert_eq!(unit[0], Vec3::new(0.0, 0.6, 0.8));
        assert_eq!((unit[1], unit[2]), (Vec3::ZERO, Vec3::ZERO));
        assert!((unit[3].length() - 1.0).abs() < 1e-6);
        assert_eq!(warnings.len(), 1);
        assert!(unit_normals(vec![Vec3::ZERO; 3], &mut warnings).is_none());
    }

    #[test]
    fn lost_vertices_take_their_triangles_along() {
        let mesh = Mesh {
            positions: vec![DVec3::ZERO, DVec3::NAN, DVec3::X, DVec3::Y, DVec3::Z],
            triangles: vec![[0, 1, 2], [0, 2, 3], [2, 3, 4], [2, 2, 3]],
            parts: vec![
                MeshPart { triangles: 1, material: Some(0) },
                MeshPart { triangles: 2, material: Some(1) },
                MeshPart { triangles: 1, material: None },
            ],
            ..Mesh::default()
        };
        let mut warnings = Vec::new();
        let mesh = finish_mesh(mesh, "f", &mut warnings).unwrap();
        assert_eq!(mesh.positions, [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z]);
        assert_eq!(mesh.triangles, [[0, 1, 2], [1, 2, 3]]);
        assert_eq!(mesh.parts, [MeshPart { triangles: 2, material: Some(1) }]);
        assert_eq!(warnings.len(), 2);
    }

    #[test]
    fn texture_coordinates_are_finite() {
        let mesh = Mesh {
            positions: vec![DVec3::ZERO, DVec3::X, DVec3::Y],
            triangles: vec![[0, 1, 2]],
            uvs: Some(vec![Vec2::ONE, Vec2::new(f32::INFINITY, 0.5), Vec2::NAN]),
            ..Mesh::default()
        };
        let mut warnings = Vec::new();
        let mesh = finish_mesh(mesh, "f", &mut warnings).unwrap();
        assert_eq!(mesh.uvs.unwrap(), [Vec2::ONE, Vec2::ZERO, Vec2::ZERO]);
        assert_eq!(
            warnings,
            [
                "2 texture coordinates are not finite and are taken as 0; the first is that of vertex 1"
            ]
        );
    }

    #[test]
    fn a_mesh_of_which_nothing_can_be_seen_says_so() {
        let said = |positions: Vec<DVec3>| {
            let triangles = vec![[0, 1, 2], [1, 2, 3]];
            let mut warnings = Vec::new();
            let mesh = Mesh { positions, triangles, ..Mesh::default() };
            finish_mesh(mesh, "f", &mut warnings).unwrap();
            warnings
        };
        let nothing = ["no triangle has an area: nothing of the mesh can be seen"];
        assert_eq!(said(vec![DVec3::ONE; 4]), nothing, "all at one point");
        let line = (0..4).map(|i| DVec3::X * f64::from(i)).collect();
        assert_eq!(said(line), nothing, "all on one line");
        let one_of_two = vec![DVec3::ZERO, DVec3::X, DVec3::X * 2.0, DVec3::Y];
        assert!(said(one_of_two).is_empty());
    }

    #[test]
    fn lost_points_take_their_attributes_along() {
        let cloud = PointCloud {
            positions: vec![DVec3::NAN, DVec3::X],
            colors: Some(vec![[1; 4], [2; 4]]),
            ..PointCloud::default()
        };
        let mut warnings = Vec::new();
        let cloud = finish_cloud(cloud, "f", &mut warnings).unwrap();
        assert_eq!((cloud.positions, cloud.colors), (vec![DVec3::X], Some(vec![[2; 4]])));
        let lost = PointCloud { positions: vec![DVec3::INFINITY], ..PointCloud::default() };
        assert!(finish_cloud(lost, "f", &mut warnings).is_err());
        assert!(finish_cloud(PointCloud::default(), "f", &mut warnings).is_err());
    }

    #[test]
    fn srgb_round_trips() {
        for byte in 0..=255u8 {
            let linear = linear_from_srgb(f32::from(byte) / 255.0);
            assert_eq!(srgb_byte_from_linear(linear), byte);
        }
    }
}
