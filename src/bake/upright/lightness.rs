//! Measures how light an asset's own colours are.

use glam::Vec2;

use super::parts::{areas, as_cloud, as_mesh};
use crate::assets::{Asset, Mesh, Texture, Wrap};
use crate::scene::color::linear_from_srgb;

/// Points and triangles of a geometry that are measured at most, about.
const SAMPLES: usize = 1 << 14;
/// Corners' weights at the places of a triangle where its texture is read.
const PLACES: [[f32; 3]; 4] =
    [[0.333, 0.333, 0.334], [0.66, 0.17, 0.17], [0.17, 0.66, 0.17], [0.17, 0.17, 0.66]];

/// Median linear luminance of the colours of an asset's surface, each weighed by its area; points weigh alike. 1 for an asset
/// without colours.
pub(super) fn lightness(asset: &Asset) -> f64 {
    let placed = || asset.placements.iter().map(|p| (p, &asset.geometries[p.geometry]));
    let mut weighed: Vec<(f64, f64)> = Vec::new();
    for (placement, mesh) in placed().filter_map(|(p, g)| Some((p, as_mesh(g)?))) {
        let step = mesh.triangles.len().div_ceil(SAMPLES).max(1);
        let materials = mesh
            .parts
            .iter()
            .flat_map(|part| std::iter::repeat_n(part.material, part.triangles as usize));
        let materials = materials.chain(std::iter::repeat(None));
        let triangles = mesh.triangles.iter().zip(areas(mesh, placement)).zip(materials);
        for ((triangle, area), material) in triangles.step_by(step) {
            for place in PLACES {
                weighed.push((luminance_of(asset, mesh, *triangle, material, place), area));
            }
        }
    }
    if weighed.is_empty() {
        for (_, cloud) in placed().filter_map(|(p, g)| Some((p, as_cloud(g)?))) {
            let Some(colors) = &cloud.colors else { continue };
            let step = colors.len().div_ceil(SAMPLES).max(1);
            weighed
                .extend(colors.iter().step_by(step).map(|&color| (luminance(linear(color)), 1.0)));
        }
    }
    median(weighed).unwrap_or(1.0)
}

/// Value below which half of the weight lies.
fn median(mut weighed: Vec<(f64, f64)>) -> Option<f64> {
    weighed.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let half = 0.5 * weighed.iter().map(|(_, weight)| weight).sum::<f64>();
    let mut sum = 0.0;
    let middle = weighed.iter().find(|(_, weight)| {
        sum += weight;
        sum >= half
    });
    middle.map(|(value, _)| *value)
}

/// Luminance of a place of a triangle: material, texture and vertex colours multiplied, as they are drawn.
fn luminance_of(
    asset: &Asset,
    mesh: &Mesh,
    triangle: [u32; 3],
    material: Option<u32>,
    place: [f32; 3],
) -> f64 {
    let mut color = [1.0; 3];
    let mut multiply = |by: [f64; 3]| {
        for (channel, factor) in color.iter_mut().zip(by) {
            *channel *= factor;
        }
    };
    if let Some(colors) = &mesh.colors
        && let Some(&own) = colors.get(triangle[0] as usize)
    {
        multiply(linear(own));
    }
    if let Some(material) = material.and_then(|index| asset.materials.get(index as usize)) {
        let [r, g, b, _] = material.base_color.map(f64::from);
        multiply([r, g, b]);
        let texture = material.base_texture.and_then(|index| asset.textures.get(index as usize));
        if let (Some(texture), Some(uvs)) = (texture, &mesh.uvs) {
            let corner = |k: usize| uvs.get(triangle[k] as usize).copied().unwrap_or_default();
            let uv = corner(0) * place[0] + corner(1) * place[1] + corner(2) * place[2];
            if let Some(texel) = texel(texture, uv) {
                multiply(linear(texel));
            }
        }
    }
    luminance(color)
}

fn texel(texture: &Texture, uv: Vec2) -> Option<[u8; 4]> {
    let at = |coordinate: f32, wrap: Wrap, size: u32| {
        let share = match wrap {
            Wrap::Clamp => coordinate.clamp(0.0, 1.0),
            Wrap::Repeat | Wrap::Mirror => coordinate - coordinate.floor(),
        };
        ((share * size as f32) as usize).min((size as usize).saturating_sub(1))
    };
    let x = at(uv.x, texture.wrap[0], texture.width);
    let y = at(uv.y, texture.wrap[1], texture.height);
    texture.rgba.get(y * texture.width as usize + x).copied()
}

fn linear([r, g, b, _]: [u8; 4]) -> [f64; 3] {
    [r, g, b].map(|channel| linear_from_srgb(f64::from(channel) / 255.0))
}

fn luminance([r, g, b]: [f64; 3]) -> f64 {
    0.2126 * r + 0.7152 * g + 0.0722 * b
}

#[cfg(test)]
mod tests {
    use glam::{DAffine3, DVec3};

    use super::*;
    use crate::assets::{Geometry, Material, MeshPart, Placement, PointCloud};

    fn asset(geometry: Geometry) -> Asset {
        let placement =
            Placement { name: String::new(), geometry: 0, asset_from_geometry: DAffine3::IDENTITY };
        Asset { geometries: vec![geometry], placements: vec![placement], ..Asset::default() }
    }

    fn points(colors: Option<Vec<[u8; 4]>>) -> Asset {
        let positions = vec![DVec3::ZERO; 100];
        asset(Geometry::Points(PointCloud { positions, colors, ..PointCloud::default() }))
    }

    #[test]
    fn lightness_of_points_is_the_median_of_their_colours() {
        let some_black = |count: usize| {
            points(Some(
                (0..100).map(|i| if i < count { [0, 0, 0, 255] } else { [255; 4] }).collect(),
            ))
        };
        assert_eq!(lightness(&some_black(60)), 0.0);
        assert!((lightness(&some_black(40)) - 1.0).abs() < 1e-9);
        assert_eq!(lightness(&points(None)), 1.0);
        assert_eq!(lightness(&Asset::default()), 1.0);
    }

    #[test]
    fn lightness_of_meshes_multiplies_material_and_texture_and_weighs_by_area() {
        // A large triangle that shows the dark half of a texture, and a small one that shows the white half.
        let at = |x: f64, y: f64| DVec3::new(x, y, 0.0);
        let mesh = Mesh {
            positions: vec![
                at(0.0, 0.0),
                at(10.0, 0.0),
                at(0.0, 10.0),
                at(20.0, 0.0),
                at(21.0, 0.0),
                at(20.0, 1.0),
            ],
            triangles: vec![[0, 1, 2], [3, 4, 5]],
            uvs: Some(
                [[0.25, 0.5]; 3].into_iter().chain([[0.75, 0.5]; 3]).map(Vec2::from).collect(),
            ),
            parts: vec![MeshPart { triangles: 2, material: Some(0) }],
            ..Mesh::default()
        };
        let mut textured = asset(Geometry::Mesh(mesh));
        let base_color = [0.5, 0.5, 0.5, 1.0];
        textured.materials =
            vec![Material { base_color, base_texture: Some(0), ..Material::default() }];
        assert!((lightness(&textured) - 0.5).abs() < 1e-6, "without the texture");
        let rgba = vec![[20, 20, 20, 255], [255; 4]];
        textured.textures = vec![Texture {
            name: String::new(),
            width: 2,
            height: 1,
            rgba,
            wrap: [Wrap::Repeat; 2],
            filter: crate::assets::Filter::default(),
            encoding: crate::assets::Encoding::Srgb,
        }];
        let dark = linear_from_srgb(20.0 / 255.0);
        assert!((lightness(&textured) - 0.5 * dark).abs() < 1e-6);
    }
}
