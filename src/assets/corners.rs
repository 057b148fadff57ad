//! Attributes of faces and of their corners: a vertex with several values becomes several vertices.

use std::collections::HashMap;
use std::hash::Hash;

use glam::Vec2;

use super::{AssetError, Mesh, ReadOptions};

/// Bytes of an additional vertex and of its entry in the map, which is up to 7/8 full.
const TWIN_BYTES: u64 = 128;
/// Bytes that each vertex of the file takes while it gets a value.
const VERTEX_BYTES: u64 = 24;

/// Gives each triangle one of `colors`, which are as many. Where vertices have colours, a warning says that those count.
pub(super) fn paint(
    mesh: &mut Mesh,
    colors: &[[u8; 4]],
    file: &str,
    options: &ReadOptions,
    warnings: &mut Vec<String>,
) -> Result<(), AssetError> {
    if mesh.colors.is_some() {
        warnings.push("colours of faces are ignored: vertices have colours".to_owned());
        return Ok(());
    }
    let of = split(mesh, |triangle, _| colors.get(triangle).copied(), file, options)?;
    mesh.colors = Some(of.into_iter().map(|color| color.flatten().unwrap_or([255; 4])).collect());
    Ok(())
}

/// Gives the corners of each triangle one of `uvs`, which are as many, in place of the texture coordinates of vertices.
pub(super) fn place_textures(
    mesh: &mut Mesh,
    uvs: &[[Vec2; 3]],
    file: &str,
    options: &ReadOptions,
) -> Result<(), AssetError> {
    mesh.uvs = None;
    let bits = |triangle: usize, corner: usize| {
        uvs.get(triangle).map(|uvs| uvs[corner].to_array().map(f32::to_bits))
    };
    let of = split(mesh, bits, file, options)?;
    let uv = |bits: [u32; 2]| Vec2::from_array(bits.map(f32::from_bits));
    mesh.uvs = Some(of.into_iter().map(|bits| bits.flatten().map_or(Vec2::ZERO, uv)).collect());
    Ok(())
}

/// Splits vertices until all corners of a vertex have one value, and returns the value of each; `None` for a vertex that no
/// triangle uses.
fn split<T: Copy + Eq + Hash>(
    mesh: &mut Mesh,
    value: impl Fn(usize, usize) -> T,
    file: &str,
    options: &ReadOptions,
) -> Result<Vec<Option<T>>, AssetError> {
    let Mesh { positions, triangles, colors, normals, uvs, .. } = mesh;
    let most = options.max_vertices.min(u64::from(u32::MAX));
    let mut meter = options.admission.meter(file);
    let own_bytes = VERTEX_BYTES * positions.len() as u64;
    meter.reach(own_bytes)?;
    // The first value of a vertex stays with it. Each other one makes a twin.
    let mut values: Vec<Option<T>> = vec![None; positions.len()];
    let mut twins: HashMap<(u32, T), u32> = HashMap::new();
    for (number, triangle) in triangles.iter_mut().enumerate() {
        for (side, corner) in triangle.iter_mut().enumerate() {
            let (at, own) = (*corner as usize, value(number, side));
            if *values[at].get_or_insert(own) == own {
                continue;
            }
            let next = positions.len() as u32;
            let twin = *twins.entry((*corner, own)).or_insert(next);
            if twin == next {
                AssetError::check_limit(file, "vertices", u64::from(next) + 1, most)?;
                meter.reach(own_bytes + TWIN_BYTES * twins.len() as u64)?;
                values.push(Some(own));
                positions.push(positions[at]);
                if let Some(colors) = colors {
                    colors.push(colors[at]);
                }
                if let Some(normals) = normals {
                    normals.push(normals[at]);
                }
                if let Some(uvs) = uvs {
                    uvs.push(uvs[at]);
                }
            }
            *corner = twin;
        }
    }
    Ok(values)
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;

    const RED: [u8; 4] = [255, 0, 0, 255];
    const BLUE: [u8; 4] = [0, 0, 255, 255];

    /// Four triangles around a vertex.
    fn fan() -> Mesh {
        Mesh {
            positions: vec![DVec3::ZERO, DVec3::X, DVec3::Y, -DVec3::X, -DVec3::Y],
            triangles: vec![[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 1]],
            uvs: Some((0..5).map(|at| Vec2::splat(at as f32)).collect()),
            ..Mesh::default()
        }
    }

    #[test]
    fn vertices_between_colors_are_split() {
        let mut warnings = Vec::new();
        let mut mesh = fan();
        paint(&mut mesh, &[RED, RED, BLUE, BLUE], "a", &ReadOptions::default(), &mut warnings)
            .unwrap();
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3], [5, 6, 4], [5, 4, 7]]);
        assert_eq!(mesh.positions[5..], [DVec3::ZERO, -DVec3::X, DVec3::X]);
        assert_eq!(mesh.uvs.unwrap()[5..], [0.0, 3.0, 1.0].map(Vec2::splat));
        let colors = mesh.colors.unwrap();
        assert_eq!(colors, [RED, RED, RED, RED, BLUE, BLUE, BLUE, BLUE]);
        let mut mesh = fan();
        paint(&mut mesh, &[RED; 4], "a", &ReadOptions::default(), &mut warnings).unwrap();
        assert!(warnings.is_empty());
        paint(&mut mesh, &[BLUE; 4], "a", &ReadOptions::default(), &mut warnings).unwrap();
        assert_eq!(warnings, ["colours of faces are ignored: vertices have colours"]);
        assert_eq!((mesh.positions.len(), mesh.colors), (5, Some(vec![RED; 5])));
    }

    #[test]
    fn vertices_between_parts_of_a_texture_are_split() {
        let mut mesh = fan();
        mesh.colors = Some(vec![RED, BLUE, RED, RED, RED]);
        let [a, b, c] = [0.25, 0.5, 0.75].map(Vec2::splat);
        let uvs = [[a, b, b], [a, b, b], [c, b, a], [c, a, b]];
        place_textures(&mut mesh, &uvs, "a", &ReadOptions::default()).unwrap();
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3], [5, 3, 4], [5, 4, 1]]);
        assert_eq!(mesh.uvs.unwrap(), [a, b, b, b, a, c]);
        assert_eq!(mesh.colors.unwrap()[5], RED);
    }

    #[test]
    fn limits_hold() {
        let few = ReadOptions { max_vertices: 6, ..ReadOptions::default() };
        let colors = [RED, RED, BLUE, BLUE];
        let error = paint(&mut fan(), &colors, "a", &few, &mut Vec::new()).unwrap_err();
        assert!(matches!(error, AssetError::TooLarge { .. }), "{error}");
    }
}
