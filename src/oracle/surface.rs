//! The surface that a ray meets: colour, normal and material where a hit is.

use glam::{DVec2, DVec3};

use crate::assets::{Geometry, Material, Mesh, Physical, PointCloud, ScaledMap};
use crate::math::View;
use crate::scene::recolor::{NO_VALUE, Recolor, instance_color, share};

use super::color::linear_from_srgba8;
use super::physical::{Details, Transmission};
use super::prepare::{Prepared, PreparedItem};
use super::visibility::{Hit, SeenTriangle, pixel_ray};
use super::{lines, texture};

/// sRGB grey of samples without colour.
const SAMPLE_GREY: u8 = 204;

/// Attributes of a surface that shading needs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surface {
    /// Linear RGB.
    pub albedo: [f64; 3],
    pub alpha: f64,
    /// Relative to the eye, in world axes.
    pub position_from_eye: DVec3,
    /// The direction, up to its length, in which the eye sees it, in world axes.
    pub way: DVec3,
    /// Unit length, turned towards the eye; zero where none is known.
    pub normal_world: DVec3,
    pub specular: [f64; 3],
    pub shininess: f64,
    pub details: Details,
    pub unlit: bool,
    pub lit_as: LitAs,
    /// How far along a ray of light other surfaces still count as this one, and cast no shadow on it.
    pub thickness: f64,
    /// Share of ambient light that arrives.
    pub open: f64,
}

/// How a surface reflects light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LitAs {
    /// As its normal says.
    Solid,
    /// From both sides alike: a ribbon.
    Sheet,
    /// As the mean over the visible half of a thin cylinder, whose axis has this direction in world axes.
    Line(DVec3),
}

impl Surface {
    /// Replaces the colour by that of a value, if one is given; `instance`: number of the instance.
    pub fn recolor(&mut self, recolor: Option<&Recolor>, view: &View, instance: u32) {
        let srgb = match recolor {
            // Samples and lines have the colours of fields, and triangles their grey, from the beginning.
            None | Some(Recolor::Field { .. }) => return,
            Some(Recolor::Height { up, range, map }) => {
                let height = up.normalize_or(DVec3::Y).dot(view.eye + self.position_from_eye);
                map.at(share(height, *range))
            }
            Some(Recolor::Normal) if self.normal_world == DVec3::ZERO => {
                [f64::from(NO_VALUE) / 255.0; 3]
            }
            Some(Recolor::Normal) => (self.normal_world * 0.5 + 0.5).to_array(),
            Some(Recolor::Instance) => instance_color(instance + 1),
        };
        let [r, g, b] = srgb.map(|channel| (channel * 255.0).round() as u8);
        let [r, g, b, _] = linear_from_srgba8([r, g, b, 255]);
        self.albedo = [r, g, b];
    }

    /// Turns the normal to the side that the eye is on.
    pub fn turn_to_eye(&mut self) {
        if self.normal_world.dot(self.way) > 0.0 {
            self.normal_world = -self.normal_world;
        }
    }

    /// Lets light pass as a material has it.
    fn transmit(&mut self, material: &Material) {
        let Some(own) = material.physical.filter(|_| material.transmits()) else { return };
        if let Some(reflection) = &mut self.details.reflection {
            reflection.transmission = Some(Transmission {
                share: own.transmission.into(),
                volume: own.volume.map(f64::from),
            });
        }
    }
}

/// The surface that pixel `(x, y)` of `view` shows.
pub fn at(prepared: &Prepared<'_>, view: &View, hit: &Hit, x: usize, y: usize) -> Surface {
    let item = &prepared.items[hit.item as usize];
    let facing_eye = |mut surface: Surface| {
        surface.turn_to_eye();
        surface
    };
    match item.item.geometry {
        Geometry::Points(cloud) => {
            // A disc is seen where the pixel's ray meets it. A hit without a depth is that of a sample at its own centre.
            let on_disc = || view.at_depth(pixel_ray(view, x, y), hit.depth);
            let is_disc = prepared.scene.discs.is_some() || prepared.scene.splats.is_some();
            let seen = (is_disc && hit.depth > 0.0).then(on_disc);
            let recolor = prepared.scene.recolor.as_ref();
            facing_eye(sample(view, item, recolor, (cloud, hit.index), seen))
        }
        Geometry::Mesh(mesh) => triangle(prepared, view, item, mesh, (hit, x, y)),
        Geometry::Lines(lines) => {
            facing_eye(lines::surface(prepared, view, item, lines, (hit, x, y)))
        }
    }
}

/// Whether the alpha of the material or of the node's colour says that nothing is here.
pub fn is_cut_out(prepared: &Prepared<'_>, view: &View, hit: &Hit, x: usize, y: usize) -> bool {
    let item = &prepared.items[hit.item as usize];
    let Geometry::Mesh(mesh) = item.item.geometry else { return false };
    let over = item.item.override_material;
    if over.and_then(|over| over.base_color).is_some_and(|color| color[3] <= 0.0) {
        return true;
    }
    let Some(own) = item.material(mesh, hit.index) else { return false };
    let Some(cutoff) = own.alpha_cutoff else { return false };
    let corners_view = item.triangle_view(mesh, hit.index);
    let seen = corners_view.and_then(|corners| SeenTriangle::new(corners, view.projection));
    let (Some(seen), Some(&corners)) = (seen, mesh.triangles.get(hit.index as usize)) else {
        // No hit comes from such a triangle.
        return true;
    };
    let ray = pixel_ray(view, x, y);
    let footprint = |uvs| uv_footprint(&seen, view, ray, uvs);
    let with = (own, cut_color(item, own));
    let color = base(prepared, (item, mesh), with, (corners, seen.weights(ray)), footprint);
    color[3] < f64::from(cutoff)
}

/// The base colour whose alpha the cut-off is compared with. It is the material's own where alpha cuts holes, because the alpha of a node's colour
/// says how much is hidden of what the holes leave.
fn cut_color(item: &PreparedItem<'_>, own: &Material) -> [f32; 4] {
    if own.blends() { overridden(item, own).base_color } else { own.base_color }
}

/// Whether the material's alpha says that nothing is where a triangle's corners have these weights, whoever looks; `item` and `triangle` are
/// numbers.
pub fn is_cut_out_at(
    prepared: &Prepared<'_>,
    [item, triangle]: [u32; 2],
    weights: [f64; 3],
) -> bool {
    let item = &prepared.items[item as usize];
    let Geometry::Mesh(mesh) = item.item.geometry else { return false };
    let own = item.material(mesh, triangle);
    let corners = mesh.triangles.get(triangle as usize);
    let (Some(own), Some(&corners)) = (own, corners) else { return false };
    let Some(cutoff) = own.alpha_cutoff else { return false };
    let footprint = |uvs: [DVec2; 3]| {
        let uv = (0..3).map(|i| uvs[i] * weights[i]).sum();
        texture::Footprint { uv, along_x: DVec2::ZERO, along_y: DVec2::ZERO }
    };
    let with = (own, cut_color(item, own));
    let color = base(prepared, (item, mesh), with, (corners, weights), footprint);
    color[3] < f64::from(cutoff)
}

/// The colour of a triangle before light: that of its corners, its material and its texture. `footprint`: the place on the texture, from those of the corners.
fn base(
    prepared: &Prepared<'_>,
    (item, mesh): (&PreparedItem<'_>, &Mesh),
    (own, base_color): (&Material, [f32; 4]),
    (corners, weights): ([u32; 3], [f64; 3]),
    footprint: impl FnOnce([DVec2; 3]) -> texture::Footprint,
) -> [f64; 4] {
    let color = times(vertex_color(mesh, corners, weights), base_color.map(f64::from));
    let texture = own.base_texture.and_then(|index| item.item.textures.get(index as usize));
    let (Some(texture), Some(uvs)) = (texture, corner_values(&mesh.uvs, corners)) else {
        return color;
    };
    let footprint = footprint(uvs.map(|uv| uv.as_dvec2()));
    times(color, texture::sample(texture, prepared.pyramid(texture), &footprint))
}

/// The colour that a scalar field gives a sample; `None` if no field is shown.
fn field_color(recolor: Option<&Recolor>, cloud: &PointCloud, sample: usize) -> Option<[u8; 4]> {
    let (recolor, name) = recolor.and_then(|recolor| Some((recolor, recolor.field()?)))?;
    let [r, g, b] = recolor.field_color(cloud.value(name, sample));
    Some([r, g, b, 255])
}

/// `seen`: a place in view space other than the sample's own.
fn sample(
    view: &View,
    item: &PreparedItem<'_>,
    recolor: Option<&Recolor>,
    (cloud, index): (&PointCloud, u32),
    seen: Option<DVec3>,
) -> Surface {
    let index = index as usize;
    let field = field_color(recolor, cloud, index);
    let grey = [SAMPLE_GREY, SAMPLE_GREY, SAMPLE_GREY, 255];
    let color = cloud.colors.as_ref().and_then(|colors| colors.get(index)).unwrap_or(&grey);
    let normal = cloud.normals.as_ref().and_then(|normals| normals.get(index));
    let mut material = overridden(item, &Material::default());
    let [.., alpha] = *color;
    let color = field.map_or(*color, |[r, g, b, _]| [r, g, b, alpha]);
    if field.is_some() {
        material.base_color[..3].fill(1.0);
    }
    // A hit comes from a sample that can be drawn, so that none is missing here.
    let position = cloud.positions.get(index).and_then(|&position| item.to_view(position));
    let position_view = seen.or(position).unwrap_or(DVec3::ZERO);
    surface(
        times(linear_from_srgba8(color), material.base_color.map(f64::from)),
        (view, position_view),
        normal.map_or(DVec3::ZERO, |n| item.normal_world_from_geometry * n.as_dvec3()),
        &material,
    )
}

/// The surface of a triangle, turned to the eye.
fn triangle(
    prepared: &Prepared<'_>,
    view: &View,
    item: &PreparedItem<'_>,
    mesh: &Mesh,
    (hit, x, y): (&Hit, usize, usize),
) -> Surface {
    let own = item.material(mesh, hit.index).cloned().unwrap_or_default();
    let material = overridden(item, &own);
    let ray = pixel_ray(view, x, y);
    let world_from_view = view.view_from_world.transpose();
    let position_view = view.at_depth(ray, hit.depth);
    let corners_view = item.triangle_view(mesh, hit.index);
    let seen = corners_view.and_then(|corners| SeenTriangle::new(corners, view.projection));
    let (Some(seen), Some(&corners)) = (seen, mesh.triangles.get(hit.index as usize)) else {
        // No hit comes from such a triangle.
        return surface([0.0; 4], (view, position_view), DVec3::ZERO, &material);
    };
    let weights = seen.weights(ray);
    let footprint = |uvs| uv_footprint(&seen, view, ray, uvs);
    let base_color = material.base_color;
    let mut color = base(prepared, (item, mesh), (&own, base_color), (corners, weights), footprint);
    if let Some(Recolor::Field { .. }) = prepared.scene.recolor {
        let [r, g, b, _] = linear_from_srgba8([NO_VALUE, NO_VALUE, NO_VALUE, 255]);
        color = [r, g, b, color[3]];
    }
    let normal = match corner_values(&mesh.normals, corners) {
        Some(normals) => {
            let sum: DVec3 = (0..3).map(|i| normals[i].as_dvec3() * weights[i]).sum();
            item.normal_world_from_geometry * sum
        }
        None => {
            let [a, b, c] = seen.corners;
            world_from_view * (b - a).cross(c - a)
        }
    };
    let mut surface = surface(color, (view, position_view), normal, &material);
    surface.turn_to_eye();
    let over = item.item.override_material;
    let is_clear = over.and_then(|over| over.base_color).is_some_and(|color| color[3] < 1.0);
    surface.transmit(&material);
    if !own.blends() && !is_clear {
        // Alpha does not say how much it hides, also where an unlit or a Phong material leaves glass no transmission.
        surface.alpha = 1.0;
    }
    if let Some(uvs) = corner_values(&mesh.uvs, corners).filter(|_| own.has_maps()) {
        let uvs = uvs.map(|uv| uv.as_dvec2());
        let footprint = uv_footprint(&seen, view, ray, uvs);
        let values = |map: Option<u32>| -> Option<[f64; 4]> {
            let texture = item.item.textures.get(map? as usize)?;
            Some(texture::sample(texture, prepared.pyramid(texture), &footprint))
        };
        apply_maps(&mut surface, &own, values);
        if let Some(bump) = own.normal_map.and_then(|map| bump(map, values)) {
            let [a, b, c] = seen.corners.map(|corner| world_from_view * corner);
            let front = seen.is_counter_clockwise() != item.mirrored;
            bend(&mut surface, [b - a, c - a], [uvs[1] - uvs[0], uvs[2] - uvs[0]], (bump, front));
        }
    }
    surface
}

/// Multiplies what a material says by what its maps, other than that of the normals, show.
fn apply_maps(
    surface: &mut Surface,
    own: &Material,
    values: impl Fn(Option<u32>) -> Option<[f64; 4]>,
) {
    let details = &mut surface.details;
    if let (Some(reflection), Some([_, green, blue, _])) =
        (&mut details.reflection, values(own.physical.and_then(|own| own.map)))
    {
        reflection.roughness *= green;
        reflection.metallic *= blue;
    }
    let transmission = details.reflection.as_mut().and_then(|own| own.transmission.as_mut());
    if let (Some(transmission), Some([red, ..])) =
        (transmission, values(own.physical.and_then(|own| own.transmission_map)))
    {
        transmission.share *= red;
    }
    if let Some(light) = values(own.emissive_map) {
        for (emissive, light) in details.emissive.iter_mut().zip(light) {
            *emissive *= light;
        }
    }
    if let Some((map, [red, ..])) =
        own.occlusion_map.and_then(|map| Some((map, values(Some(map.texture))?)))
    {
        details.unoccluded = 1.0 - f64::from(map.factor) * (1.0 - red);
    }
}

/// What a normal map shows, in tangent space, up to length.
fn bump(map: ScaledMap, values: impl Fn(Option<u32>) -> Option<[f64; 4]>) -> Option<DVec3> {
    let [red, green, blue, _] = values(Some(map.texture))?.map(|value| 2.0 * value - 1.0);
    let factor = f64::from(map.factor);
    Some(DVec3::new(red * factor, green * factor, blue))
}

/// Replaces a normal by that which a normal map gives (glTF 2.0, §3.9.3). The tangent points to where u grows, the bitangent to where v becomes
/// less. `edges` and `uv_edges`: from the first corner to the others, in world axes and on the texture.
fn bend(
    surface: &mut Surface,
    edges: [DVec3; 2],
    uv_edges: [DVec2; 2],
    (bump, shows_front): (DVec3, bool),
) {
    let side = if shows_front { 1.0 } else { -1.0 };
    let front = surface.normal_world * side;
    // Gradients of the place, up to the same positive factor.
    let turn = uv_edges[0].perp_dot(uv_edges[1]);
    let sign = if turn > 0.0 { 1.0 } else { -1.0 };
    let along_u = (edges[0] * uv_edges[1].y - edges[1] * uv_edges[0].y) * sign;
    let along_v = (edges[1] * uv_edges[0].x - edges[0] * uv_edges[1].x) * sign;
    let Some(tangent) = (along_u - front * front.dot(along_u)).try_normalize() else { return };
    let across = front.cross(tangent);
    let bitangent = if across.dot(along_v) > 0.0 { -across } else { across };
    let bent = tangent * bump.x + bitangent * bump.y + front * bump.z;
    if let Some(bent) = bent.try_normalize() {
        surface.normal_world = bent * side;
    }
}

/// The material with the node's own laid over it.
pub fn overridden(item: &PreparedItem<'_>, own: &Material) -> Material {
    let mut material = own.clone();
    if let Some(over) = item.item.override_material {
        material.base_color = over.base_color.unwrap_or(material.base_color);
        material.specular = over.specular.unwrap_or(material.specular);
        material.shininess = over.shininess.unwrap_or(material.shininess);
        if over.is_phong() {
            material.physical = None;
        }
        if over.is_physical() {
            let own = material.physical.unwrap_or_default();
            material.physical = Some(Physical {
                metallic: over.metallic.unwrap_or(own.metallic),
                roughness: over.roughness.unwrap_or(own.roughness),
                transmission: over.transmission.unwrap_or(own.transmission),
                ..own
            });
        }
        material.emissive = over.emissive.unwrap_or(material.emissive);
        material.unlit = over.unlit.unwrap_or(material.unlit);
    }
    material
}

pub fn surface(
    [r, g, b, alpha]: [f64; 4],
    (view, position_view): (&View, DVec3),
    normal: DVec3,
    material: &Material,
) -> Surface {
    let world_from_view = view.view_from_world.transpose();
    Surface {
        albedo: [r, g, b],
        alpha,
        position_from_eye: world_from_view * position_view,
        way: world_from_view * view.towards(position_view),
        normal_world: normal.try_normalize().unwrap_or(DVec3::ZERO),
        specular: material.specular.map(f64::from),
        shininess: f64::from(material.shininess),
        details: Details::of(material),
        unlit: material.unlit,
        lit_as: LitAs::Solid,
        thickness: 0.0,
        open: 1.0,
    }
}

/// Decoded, then interpolated; white without colours.
fn vertex_color(mesh: &Mesh, corners: [u32; 3], weights: [f64; 3]) -> [f64; 4] {
    let Some(colors) = corner_values(&mesh.colors, corners) else { return [1.0; 4] };
    let colors = colors.map(linear_from_srgba8);
    std::array::from_fn(|channel| (0..3).map(|i| colors[i][channel] * weights[i]).sum())
}

fn corner_values<T: Copy>(values: &Option<Vec<T>>, corners: [u32; 3]) -> Option<[T; 3]> {
    let values = values.as_ref()?;
    let [a, b, c] = corners.map(|corner| values.get(corner as usize).copied());
    Some([a?, b?, c?])
}

fn times(a: [f64; 4], b: [f64; 4]) -> [f64; 4] {
    std::array::from_fn(|channel| a[channel] * b[channel])
}

/// Texture coordinates and their derivatives along the image's axes, a pixel each, exact.
///
/// With weights `wᵢ = eᵢ / Σe`, where `eᵢ = ray · planeᵢ` is linear in the pixel's position: `dwᵢ = (deᵢ − wᵢ Σde) / Σe`.
fn uv_footprint(
    seen: &SeenTriangle,
    view: &View,
    ray: DVec3,
    uvs: [DVec2; 3],
) -> texture::Footprint {
    let planes = seen.weight_planes();
    let weights = seen.weights(ray);
    let sum: f64 = planes.iter().map(|plane| ray.dot(*plane)).sum();
    let derivative = |ray_step: DVec3| -> DVec2 {
        let steps = planes.map(|plane| plane.dot(ray_step));
        let total: f64 = steps.iter().sum();
        (0..3).map(|i| uvs[i] * ((steps[i] - weights[i] * total) / sum)).sum()
    };
    texture::Footprint {
        uv: (0..3).map(|i| uvs[i] * weights[i]).sum(),
        along_x: derivative(DVec3::new(1.0 / view.focal_px.x, 0.0, 0.0)),
        along_y: derivative(DVec3::new(0.0, -1.0 / view.focal_px.y, 0.0)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Camera;

    #[test]
    fn uv_derivatives_are_those_of_the_projection() {
        let (eye, target) = (DVec3::new(1.0, 2.0, 4.0), DVec3::ZERO);
        let view = Camera::perspective(eye, target, 50.0).view(64, 48).unwrap();
        let corners = [[-3.0, 0.0, -6.0], [2.0, -0.5, 2.0], [0.0, 3.0, -1.0]];
        let seen =
            SeenTriangle::new(corners.map(|c| view.to_view(c.into())), view.projection).unwrap();
        let uvs = [(0.1, 0.9), (2.5, 0.3), (-0.4, -1.5)].map(DVec2::from);
        let uv = |pixel: DVec2| -> DVec2 {
            let weights = seen.weights(view.ray(pixel));
            (0..3).map(|i| uvs[i] * weights[i]).sum()
        };
        let step = 1e-4;
        let mut checked = 0;
        for pixel in (0..64 * 48).map(|i| DVec2::new(f64::from(i % 64), f64::from(i / 64)) + 0.5) {
            let around = [DVec2::ZERO, DVec2::X, -DVec2::X, DVec2::Y, -DVec2::Y].map(|d| pixel + d);
            if !around.iter().all(|&p| seen.covers(view.ray(p))) {
                continue;
            }
            let footprint = uv_footprint(&seen, &view, view.ray(pixel), uvs);
            for (found, axis) in [(footprint.along_x, DVec2::X), (footprint.along_y, DVec2::Y)] {
                let expected = (uv(pixel + axis * step) - uv(pixel - axis * step)) / (2.0 * step);
                assert!((found - expected).length() < 1e-6 * (1.0 + expected.length()), "{pixel}");
            }
            assert!((footprint.uv - uv(pixel)).length() < 1e-12);
            checked += 1;
        }
        assert!(checked > 100, "{checked}");
    }
}
