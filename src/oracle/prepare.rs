//! Values computed once a frame: transforms relative to the eye, texture pyramids, and what casts shadows.

use std::collections::HashMap;

use glam::{DMat3, DVec3};

use crate::assets::{Filter, Geometry, Material, Mesh, PointCloud, Polylines, Texture};
use crate::math::View;
use crate::scene::{Light, MaterialSpec};

use super::shadow::Occluders;
use super::surface::{LitAs, Surface};
use super::texture::{self, Pyramid};
use super::visibility::Hit;
use super::{OracleItem, OracleScene};

/// Nothing beyond this distance from the eye is drawn: products of three coordinates stay finite.
const FARTHEST: f64 = 1e100;

/// A scene as one view sees it.
pub struct Prepared<'a> {
    pub scene: &'a OracleScene<'a>,
    pub items: Vec<PreparedItem<'a>>,
    /// By the texture's address, as items share an asset's textures.
    pyramids: HashMap<usize, Pyramid>,
    /// `None` where nothing casts shadows.
    occluders: Option<Occluders>,
}

/// An item with its transform taken apart.
pub struct PreparedItem<'a> {
    pub item: OracleItem<'a>,
    linear: DMat3,
    /// The geometry's origin less the eye, in world axes: subtracted before anything is added to it, so that scenes
    /// far from the world's origin lose nothing.
    origin_from_eye: DVec3,
    view_from_world: DMat3,
    /// The transform turns left into right.
    pub mirrored: bool,
    /// Turns normals, up to a factor, whose sign does not matter as they are turned towards the eye afterwards.
    /// Defined for singular transforms too.
    pub normal_world_from_geometry: DMat3,
    /// For a mesh, the number of its first triangle after each part.
    part_ends: Vec<usize>,
}

impl<'a> Prepared<'a> {
    pub fn new(scene: &'a OracleScene<'a>, view: &View) -> Self {
        let mut pyramids = HashMap::new();
        for texture in scene.items.iter().flat_map(|item| item.textures) {
            if texture.filter == Filter::Linear && texture::is_sound(texture) {
                pyramids.entry(address(texture)).or_insert_with(|| Pyramid::of(texture));
            }
        }
        let items = scene.items.iter().map(|item| PreparedItem::new(item, view)).collect();
        let mut prepared = Self { scene, items, pyramids, occluders: None };
        prepared.occluders = Occluders::of(&prepared, view);
        prepared
    }

    /// The share of a light, 0 to 1, that reaches the place of a surface: less than 1 only for lights that cast shadows.
    pub fn lit_share(&self, surface: &Surface, light: &Light) -> f64 {
        match (&self.occluders, light.casting()) {
            (Some(occluders), Some(casting)) if self.scene.shadows => {
                occluders.share(self, surface, casting)
            }
            _ => 1.0,
        }
    }

    /// The share of ambient light, 0 to 1, that arrives at a surface. Lines that are lit as a whole have all of it.
    pub fn ambient_share(&self, surface: &Surface) -> f64 {
        match (&self.occluders, &self.scene.occlusion) {
            (Some(occluders), Some(occlusion))
                if self.scene.painted.is_none() && surface.lit_as == LitAs::Solid =>
            {
                let open = occluders.openness(self, surface, occlusion.radius);
                1.0 - occlusion.strength * (1.0 - open)
            }
            _ => 1.0,
        }
    }

    pub fn pyramid(&self, texture: &Texture) -> Option<&Pyramid> {
        self.pyramids.get(&address(texture))
    }

    /// Whether clip boxes show a place in view space.
    pub fn shows(&self, view: &View, place: DVec3) -> bool {
        let world = || view.eye + view.view_from_world.transpose() * place;
        self.scene.clip.is_none_or(|clip| clip.shows(world()))
    }

    /// Whether a hit is that of a translucent triangle, sample or segment.
    pub fn is_translucent(&self, hit: &Hit) -> bool {
        let item = &self.items[hit.item as usize];
        match item.item.geometry {
            Geometry::Mesh(mesh) => {
                let over = item.item.override_material;
                over.is_some_and(MaterialSpec::is_translucent)
                    || item.material(mesh, hit.index).is_some_and(|material| material.translucent)
            }
            Geometry::Points(cloud) => {
                item.alpha() < 1.0 || alpha(&cloud.colors, hit.index as usize) < 255
            }
            Geometry::Lines(lines) => {
                item.alpha() < 1.0 || ends_of(lines, hit.index).into_iter().any(|a| a < 255)
            }
        }
    }

    /// Whether anything is translucent.
    pub fn has_translucent(&self) -> bool {
        self.items.iter().any(|item| match item.item.geometry {
            Geometry::Points(PointCloud { colors, .. })
            | Geometry::Lines(Polylines { colors, .. }) => {
                item.alpha() < 1.0 || colors.iter().flatten().any(|color| color[3] < 255)
            }
            Geometry::Mesh(_) => {
                let over = item.item.override_material;
                over.is_some_and(MaterialSpec::is_translucent)
                    || item.item.materials.iter().any(|own| own.translucent)
            }
        })
    }

    /// Whether some surface lets light pass in place of scattering it.
    pub fn transmits(&self) -> bool {
        self.items.iter().any(|item| {
            let over = item.item.override_material;
            over.is_some_and(MaterialSpec::transmits)
                || item.item.materials.iter().any(Material::transmits)
        })
    }

    pub fn instance(&self, hit: &Hit) -> u32 {
        self.items[hit.item as usize].item.instance
    }
}

/// The alpha of a vertex, of 255.
fn alpha(colors: &Option<Vec<[u8; 4]>>, index: usize) -> u8 {
    colors.as_ref().and_then(|colors| colors.get(index)).map_or(255, |color| color[3])
}

/// The alpha of both ends of a segment, of 255.
fn ends_of(lines: &Polylines, vertex: u32) -> [u8; 2] {
    [0, 1].map(|end| alpha(&lines.colors, vertex as usize + end))
}

fn address(texture: &Texture) -> usize {
    std::ptr::from_ref(texture).addr()
}

impl<'a> PreparedItem<'a> {
    /// The alpha of its node's colour.
    fn alpha(&self) -> f32 {
        self.item.override_material.map_or(1.0, MaterialSpec::alpha)
    }

    /// Whether a sample has no alpha at all, and is not there whatever the output.
    pub fn is_clear_sample(&self, cloud: &PointCloud, index: usize) -> bool {
        self.alpha() <= 0.0 || alpha(&cloud.colors, index) == 0
    }

    /// Whether a segment has no alpha at all, and is not there whatever the output.
    pub fn is_clear_line(&self, lines: &Polylines, vertex: u32) -> bool {
        self.alpha() <= 0.0 || ends_of(lines, vertex) == [0, 0]
    }

    fn new(item: &OracleItem<'a>, view: &View) -> Self {
        let linear = item.world_from_geometry.matrix3;
        // The cofactors are the inverse transpose times the determinant.
        let (x, y, z) = (linear.x_axis, linear.y_axis, linear.z_axis);
        let cofactors = DMat3::from_cols(y.cross(z), z.cross(x), x.cross(y));
        let part_ends = match item.geometry {
            Geometry::Points(_) | Geometry::Lines(_) => vec![],
            Geometry::Mesh(mesh) => {
                let ends = mesh.parts.iter().scan(0usize, |end, part| {
                    *end += part.triangles as usize;
                    Some(*end)
                });
                ends.collect()
            }
        };
        Self {
            item: *item,
            linear,
            origin_from_eye: item.world_from_geometry.translation - view.eye,
            view_from_world: view.view_from_world,
            mirrored: linear.determinant() < 0.0,
            normal_world_from_geometry: cofactors,
            part_ends,
        }
    }

    /// A point of the geometry in view space; `None` where a coordinate is not a number or beyond [`FARTHEST`].
    pub fn to_view(&self, geometry: DVec3) -> Option<DVec3> {
        let view = self.view_from_world * (self.linear * geometry + self.origin_from_eye);
        (view.abs().max_element() <= FARTHEST && !view.is_nan()).then_some(view)
    }

    /// A direction of the geometry in view space.
    pub fn to_view_direction(&self, geometry: DVec3) -> DVec3 {
        self.view_from_world * (self.linear * geometry)
    }

    /// Length of the longest column of the linear part.
    pub fn greatest_stretch(&self) -> f64 {
        let columns = [self.linear.x_axis, self.linear.y_axis, self.linear.z_axis];
        columns.iter().map(|column| column.length()).fold(0.0, f64::max)
    }

    /// A mesh's triangle in view space; `None` where an index leads nowhere or a corner cannot be drawn.
    pub fn triangle_view(&self, mesh: &Mesh, triangle: u32) -> Option<[DVec3; 3]> {
        let [a, b, c] = *mesh.triangles.get(triangle as usize)?;
        let vertex = |i: u32| self.to_view(*mesh.positions.get(i as usize)?);
        Some([vertex(a)?, vertex(b)?, vertex(c)?])
    }

    /// The asset's own material of a triangle, before any override.
    pub fn material(&self, mesh: &Mesh, triangle: u32) -> Option<&'a Material> {
        let part = self.part_ends.partition_point(|&end| end <= triangle as usize);
        self.item.materials.get(mesh.parts.get(part)?.material? as usize)
    }

    /// Whether a triangle is drawn when seen from behind.
    pub fn double_sided(&self, mesh: &Mesh, triangle: u32) -> bool {
        let own = || self.material(mesh, triangle).is_none_or(|material| material.double_sided);
        self.item.override_material.and_then(|material| material.double_sided).unwrap_or_else(own)
    }
}
