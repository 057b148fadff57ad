//! Colours of faces: a vertex between faces of several colours becomes several vertices.

use std::collections::HashMap;

use super::{AssetError, Mesh, ReadOptions};

/// Bytes of an additional vertex and of its entry in the map, which is up to 7/8 full.
const TWIN_BYTES: u64 = 96;
/// Bytes that each vertex of the file takes while colours are given to it.
const VERTEX_BYTES: u64 = 9;

/// Gives each triangle one of `colors`, which are as many. The mesh has no colours before.
pub(super) fn paint(
    mesh: &mut Mesh,
    colors: &[[u8; 4]],
    file: &str,
    options: &ReadOptions,
) -> Result<(), AssetError> {
    let Mesh { positions, triangles, normals, uvs, .. } = mesh;
    let most = options.max_vertices.min(u64::from(u32::MAX));
    let mut meter = options.admission.meter(file);
    let own_bytes = VERTEX_BYTES * positions.len() as u64;
    meter.reach(own_bytes)?;
    // The first colour of a vertex stays with it. Each other one makes a twin.
    let mut firsts: Vec<Option<[u8; 4]>> = vec![None; positions.len()];
    let mut twins: HashMap<(u32, [u8; 4]), u32> = HashMap::new();
    let mut colors_of_twins = Vec::new();
    for (triangle, &color) in triangles.iter_mut().zip(colors) {
        for corner in triangle {
            let at = *corner as usize;
            if *firsts[at].get_or_insert(color) == color {
                continue;
            }
            let next = positions.len() as u32;
            let twin = *twins.entry((*corner, color)).or_insert(next);
            if twin == next {
                AssetError::check_limit(file, "vertices", u64::from(next) + 1, most)?;
                meter.reach(own_bytes + TWIN_BYTES * twins.len() as u64)?;
                positions.push(positions[at]);
                colors_of_twins.push(color);
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
    let mut painted: Vec<[u8; 4]> =
        firsts.into_iter().map(|color| color.unwrap_or([255; 4])).collect();
    painted.append(&mut colors_of_twins);
    mesh.colors = Some(painted);
    Ok(())
}

#[cfg(test)]
mod tests {
    use glam::{DVec3, Vec2};

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
        let mut mesh = fan();
        paint(&mut mesh, &[RED, RED, BLUE, BLUE], "a", &ReadOptions::default()).unwrap();
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3], [5, 6, 4], [5, 4, 7]]);
        assert_eq!(mesh.positions[5..], [DVec3::ZERO, -DVec3::X, DVec3::X]);
        assert_eq!(mesh.uvs.unwrap()[5..], [0.0, 3.0, 1.0].map(Vec2::splat));
        let colors = mesh.colors.unwrap();
        assert_eq!(colors, [RED, RED, RED, RED, BLUE, BLUE, BLUE, BLUE]);
        let mut mesh = fan();
        paint(&mut mesh, &[RED; 4], "a", &ReadOptions::default()).unwrap();
        assert_eq!((mesh.positions.len(), mesh.colors), (5, Some(vec![RED; 5])));
    }

    #[test]
    fn limits_hold() {
        let few = ReadOptions { max_vertices: 6, ..ReadOptions::default() };
        let error = paint(&mut fan(), &[RED, RED, BLUE, BLUE], "a", &few).unwrap_err();
        assert!(matches!(error, AssetError::TooLarge { .. }), "{error}");
    }
}
