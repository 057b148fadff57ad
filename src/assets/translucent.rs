//! Corrects what is translucent. In formats without materials, the alpha of vertices decides. Materials whose alpha is 1 everywhere and
//! which transmit no light are opaque.

use super::{
    Asset, AssetError, Geometry, LEAST_ALPHA, Material, Mesh, MeshPart, PointCloud, Polylines,
    ReadOptions, texture,
};

/// Makes translucent materials opaque where nothing that they are made of lets light through. Many exporters call all materials
/// translucent, and opaque surfaces take less time and have levels of detail.
pub(super) fn drop_without_alpha(asset: &mut Asset) {
    let Asset { geometries, materials, textures, .. } = asset;
    if !materials.iter().any(|material| material.translucent) {
        return;
    }
    let mut by_vertices = vec![false; materials.len()];
    for geometry in geometries {
        let Geometry::Mesh(Mesh { colors: Some(colors), parts, .. }) = geometry else { continue };
        if colors.iter().any(|color| color[3] < 255) {
            for number in parts.iter().filter_map(|part| part.material) {
                if let Some(own) = by_vertices.get_mut(number as usize) {
                    *own = true;
                }
            }
        }
    }
    let materials = materials.iter_mut().zip(by_vertices);
    for (material, by_vertices) in materials.filter(|(material, _)| material.translucent) {
        let texture = material.base_texture.and_then(|number| textures.get(number as usize));
        let has_alpha =
            by_vertices || material.base_color[3] < 1.0 || texture.is_some_and(texture::has_alpha);
        if !has_alpha {
            (material.translucent, material.alpha_cutoff) = (material.transmits(), None);
        }
    }
}

/// Gives such triangles a translucent material. Where every vertex has alpha 0, exporters mean that there is none.
///
/// # Errors
/// The parts of a mesh do not fit into memory.
pub(super) fn from_vertex_colors(
    asset: &mut Asset,
    name: &str,
    options: &ReadOptions,
) -> Result<(), AssetError> {
    if !asset.materials.is_empty() {
        return Ok(());
    }
    for geometry in &mut asset.geometries {
        let Geometry::Mesh(mesh) = geometry else { continue };
        options.admission.grow(name, mesh.triangles.len() as u64)?;
        let flags = flags(mesh);
        if !flags.contains(&true) {
            continue;
        }
        let runs = || flags.chunk_by(|a, b| a == b);
        let bytes = runs().count() * size_of::<MeshPart>();
        options.admission.grow(name, bytes as u64)?;
        let part =
            |run: &[bool]| MeshPart { triangles: run.len() as u32, material: run[0].then_some(0) };
        mesh.parts = runs().map(part).collect();
        if asset.materials.is_empty() {
            asset.materials.push(Material {
                name: "translucent".to_owned(),
                translucent: true,
                alpha_cutoff: Some(LEAST_ALPHA),
                ..Material::default()
            });
        }
    }
    Ok(())
}

/// Makes points and lines opaque where every vertex has alpha 0: exporters mean that there is none.
pub(super) fn fill_unwritten(asset: &mut Asset) {
    for geometry in &mut asset.geometries {
        let (Geometry::Points(PointCloud { colors: Some(colors), .. })
        | Geometry::Lines(Polylines { colors: Some(colors), .. })) = geometry
        else {
            continue;
        };
        if colors.iter().all(|color| color[3] == 0) {
            colors.iter_mut().for_each(|color| color[3] = 255);
        }
    }
}

/// For each triangle whether something shows through.
fn flags(mesh: &Mesh) -> Vec<bool> {
    let Some(colors) = &mesh.colors else { return Vec::new() };
    if colors.iter().all(|color| color[3] == 0) || colors.iter().all(|color| color[3] == 255) {
        return Vec::new();
    }
    let shows = |&corner: &u32| colors.get(corner as usize).is_some_and(|color| color[3] < 255);
    mesh.triangles.iter().map(|corners| corners.iter().any(shows)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::memory::{Admission, HostMemory};

    /// Two triangles between four vertices of these alphas, as a PLY file.
    fn ply(alphas: [u8; 4]) -> String {
        let mut text = String::from(
            "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
             property uchar red\nproperty uchar green\nproperty uchar blue\nproperty uchar alpha\n\
             element face 2\nproperty list uchar int vertex_indices\nend_header\n",
        );
        for (corner, alpha) in [[0, 0], [1, 0], [1, 1], [0, 1]].iter().zip(alphas) {
            text += &format!("{} {} 0 9 8 7 {alpha}\n", corner[0], corner[1]);
        }
        text + "3 0 1 2\n3 0 2 3\n"
    }

    fn parts(alphas: [u8; 4]) -> Vec<(u32, bool)> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.ply");
        std::fs::write(&path, ply(alphas)).unwrap();
        let asset = crate::assets::read(&path, &ReadOptions::default()).unwrap();
        let [Geometry::Mesh(mesh)] = &asset.geometries[..] else { panic!("one mesh") };
        let is_translucent = |part: &MeshPart| {
            part.material.is_some_and(|number| asset.materials[number as usize].translucent)
        };
        mesh.parts.iter().map(|part| (part.triangles, is_translucent(part))).collect()
    }

    #[test]
    fn alpha_of_vertices_makes_their_triangles_translucent() {
        assert_eq!(parts([255, 128, 255, 255]), [(1, true), (1, false)]);
        assert_eq!(parts([255, 255, 255, 0]), [(1, false), (1, true)]);
        assert_eq!(parts([128; 4]), [(2, true)]);
        let opaque = [[255; 4], [0; 4]].map(|alphas| parts(alphas).iter().any(|part| part.1));
        assert_eq!(opaque, [false; 2]);
    }

    #[test]
    fn materials_without_alpha_are_opaque() {
        let glass = |alpha| Material {
            base_color: [1.0, 1.0, 1.0, alpha],
            translucent: true,
            ..Material::default()
        };
        let mesh = |number, alpha| {
            Geometry::Mesh(Mesh {
                colors: Some(vec![[9, 9, 9, alpha]; 3]),
                triangles: vec![[0, 1, 2]],
                parts: vec![MeshPart { triangles: 1, material: Some(number) }],
                ..Mesh::default()
            })
        };
        let mut asset = Asset {
            geometries: vec![mesh(0, 255), mesh(1, 255), mesh(2, 254)],
            materials: vec![glass(1.0), glass(0.5), glass(1.0)],
            ..Asset::default()
        };
        drop_without_alpha(&mut asset);
        let found: Vec<bool> =
            asset.materials.iter().map(|material| material.translucent).collect();
        assert_eq!(found, [false, true, true]);
    }

    #[test]
    fn points_without_any_alpha_are_opaque() {
        let alphas = |given: [u8; 2]| {
            let colors = Some(given.map(|alpha| [1, 2, 3, alpha]).to_vec());
            let cloud = PointCloud { colors, ..PointCloud::default() };
            let mut asset = Asset { geometries: vec![Geometry::Points(cloud)], ..Asset::default() };
            fill_unwritten(&mut asset);
            let [Geometry::Points(cloud)] = &asset.geometries[..] else { panic!("a cloud") };
            let alphas = cloud.colors.iter().flatten().map(|color| color[3]);
            alphas.collect::<Vec<u8>>()
        };
        assert_eq!(alphas([0, 0]), [255, 255]);
        assert_eq!(alphas([0, 7]), [0, 7]);
    }

    #[test]
    fn parts_are_reserved_before_they_are_kept() {
        let triangle = Mesh {
            colors: Some(vec![[1, 2, 3, 4], [1, 2, 3, 255], [0; 4]]),
            triangles: vec![[0, 1, 2]],
            ..Mesh::default()
        };
        let mut asset = Asset { geometries: vec![Geometry::Mesh(triangle)], ..Asset::default() };
        let admission = Admission::new(&HostMemory::new(4));
        let options = ReadOptions { admission, ..ReadOptions::default() };
        let refused = from_vertex_colors(&mut asset, "a.ply", &options);
        assert!(matches!(refused, Err(AssetError::Interrupted(_))));
    }
}
