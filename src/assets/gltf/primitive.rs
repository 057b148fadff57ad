//! Primitives to geometries.

mod lines;

use std::collections::HashMap;
use std::rc::Rc;

use ::gltf::json::accessor::Type;
use ::gltf::json::mesh::{Mode, Primitive, Semantic};
use ::gltf::json::validation::Checked;
use ::gltf::json::{Index, Root, accessor, mesh};
use glam::{DVec3, Vec2, Vec3};

use super::super::tidy::{self, srgb_byte_from_linear};
use super::super::{AssetError, Geometry, Material, Mesh, MeshPart, PointCloud, ReadOptions};
use super::buffers::Buffers;
use super::material::{Materials, TexturePlacement};

/// Geometries of the meshes that nodes asked for so far.
pub(super) struct Primitives<'a> {
    root: &'a Root,
    buffers: &'a Buffers<'a>,
    file: &'a str,
    vertices_left: u64,
    triangles_left: u64,
    /// Attributes that the next primitive shares with the one read last.
    shared: Option<([Option<usize>; 4], TexturePlacement, Rc<Attributes>)>,
    /// By mesh, the geometries that its primitives became.
    known: HashMap<usize, Vec<usize>>,
    /// By geometry, for those through which light passes.
    scales: HashMap<usize, Scales>,
    pub geometries: Vec<Geometry>,
    pub warnings: Vec<String>,
}

/// The scales at which a geometry is drawn.
struct Scales {
    /// Its material where it is not scaled.
    material: u32,
    /// Each scale and the geometry that has its material.
    known: Vec<(f64, usize)>,
}

/// Scales of one geometry that have materials of their own; others take the material of the nearest.
const MOST_SCALES: usize = 16;

/// A vertex's attributes, in parallel.
#[derive(Clone)]
pub(super) struct Attributes {
    positions: Vec<DVec3>,
    normals: Option<Vec<Vec3>>,
    uvs: Option<Vec<Vec2>>,
    colors: Option<Vec<[u8; 4]>>,
}

impl<'a> Primitives<'a> {
    pub fn new(
        root: &'a Root,
        buffers: &'a Buffers<'a>,
        file: &'a str,
        options: &ReadOptions,
    ) -> Self {
        Self {
            root,
            buffers,
            file,
            vertices_left: options.max_vertices.min(u64::from(u32::MAX)),
            triangles_left: options.max_triangles,
            shared: None,
            known: HashMap::new(),
            scales: HashMap::new(),
            geometries: Vec::new(),
            warnings: Vec::new(),
        }
    }

    /// The geometries of a mesh, read when first asked for.
    pub fn get(
        &mut self,
        index: Index<mesh::Mesh>,
        materials: &mut Materials,
    ) -> Result<Vec<usize>, AssetError> {
        if let Some(known) = self.known.get(&index.value()) {
            return Ok(known.clone());
        }
        let mesh_place = format!("meshes[{}]", index.value());
        let Some(mesh) = self.root.get(index) else {
            return Err(AssetError::malformed(self.file, mesh_place, "does not exist"));
        };
        let mut geometries = Vec::new();
        for (number, primitive) in mesh.primitives.iter().enumerate() {
            let place = format!("{mesh_place}.primitives[{number}]");
            let next = mesh.primitives.get(number + 1);
            let share = next.is_some_and(|next| next.attributes == primitive.attributes);
            if let Some(geometry) = self.primitive(primitive, share, &place, materials)? {
                geometries.push(self.geometries.len());
                self.geometries.push(geometry);
            }
        }
        self.known.insert(index.value(), geometries.clone());
        Ok(geometries)
    }

    /// The geometry for a node that is scaled. Its material may depend on the scale; then each scale has a geometry.
    pub fn scaled(
        &mut self,
        geometry: usize,
        scale: f64,
        place: &str,
        materials: &mut Materials,
    ) -> Result<usize, AssetError> {
        let Some(Geometry::Mesh(mesh)) = self.geometries.get(geometry) else { return Ok(geometry) };
        let (vertices, triangles) = (mesh.positions.len(), mesh.triangles.len());
        let material = mesh.parts.first().and_then(|part| part.material);
        let Some(Scales { material, known }) = self.scales.get(&geometry) else {
            let Some(material) = material.filter(|&own| materials.absorbs(own)) else {
                return Ok(geometry);
            };
            // The first scale takes the geometry itself.
            self.scales.insert(geometry, Scales { material, known: vec![(scale, geometry)] });
            self.paint(geometry, materials.scaled(material, scale));
            return Ok(geometry);
        };
        // Zero has no logarithm: equal scales are told apart from others first.
        let ratio = |own: f64| if own == scale { 0.0 } else { (own.ln() - scale.ln()).abs() };
        let nearest = known.iter().min_by(|a, b| ratio(a.0).total_cmp(&ratio(b.0)));
        let nearest = nearest.copied().unwrap_or((scale, geometry));
        if nearest.0 == scale || known.len() >= MOST_SCALES {
            return Ok(nearest.1);
        }
        let material = materials.scaled(*material, scale);
        self.keep(vertices, triangles, place)?;
        let Some(copy) = self.geometries.get(geometry).cloned() else { return Ok(geometry) };
        let made = self.geometries.len();
        self.geometries.push(copy);
        self.paint(made, material);
        if let Some(scales) = self.scales.get_mut(&geometry) {
            scales.known.push((scale, made));
        }
        Ok(made)
    }

    /// Gives a mesh another material.
    fn paint(&mut self, geometry: usize, material: u32) {
        if let Some(Geometry::Mesh(mesh)) = self.geometries.get_mut(geometry) {
            for part in &mut mesh.parts {
                part.material = Some(material);
            }
        }
    }

    fn primitive(
        &mut self,
        primitive: &Primitive,
        share: bool,
        place: &str,
        materials: &mut Materials,
    ) -> Result<Option<Geometry>, AssetError> {
        let fail = |reason: String| AssetError::malformed(self.file, place, reason);
        let mode = match primitive.mode {
            Checked::Valid(mode) => mode,
            Checked::Invalid => return Err(fail("mode is unknown".to_owned())),
        };
        let Some(position) = attribute(primitive, Semantic::Positions) else {
            self.warnings.push(format!("{place}: has no POSITION and is left out"));
            return Ok(None);
        };
        self.refuse_compressed(primitive, position, place)?;
        let material = match primitive.material {
            Some(index) => Some(
                materials
                    .get(index)
                    .ok_or_else(|| fail(format!("materials[{}] does not exist", index.value())))?,
            ),
            None => None,
        };
        if primitive.targets.as_ref().is_some_and(|targets| !targets.is_empty()) {
            self.warnings.push(format!("{place}: morph targets are ignored"));
        }
        let count = self.buffers.count(position)?;
        AssetError::check_limit(self.file, "vertices", count, self.vertices_left)?;
        let placement = material.map_or_else(TexturePlacement::default, |(_, p)| p);
        let attributes = self.attributes_shared(primitive, position, placement, share, place)?;
        let count = attributes.positions.len();
        // Finding out which vertices are used looks at each of them.
        self.buffers.spend(place, count as u64 / 8)?;
        let indices = match primitive.indices {
            Some(index) => self.buffers.indices(index)?,
            None => (0..count as u32).collect(),
        };
        if let Some(at) = indices.iter().position(|index| *index as usize >= count) {
            return Err(AssetError::malformed(
                self.file,
                format!("{place}.indices, item {at}"),
                format!("vertex {} does not exist, there are {count}", indices[at]),
            ));
        }
        if indices.is_empty() {
            self.warnings.push(format!("{place}: is empty and left out"));
            return Ok(None);
        }
        let own = material.and_then(|(number, _)| materials.materials.get(number as usize));
        if mode == Mode::Points {
            return self.points(attributes, primitive.indices.is_some(), indices, own, place);
        }
        if matches!(mode, Mode::Lines | Mode::LineLoop | Mode::LineStrip) {
            return self.lines(primitive, mode, &attributes, &indices, own, place);
        }
        let triangles = self.triangles(mode, &indices, place)?;
        let number = material.map(|(number, _)| match &attributes.uvs {
            Some(_) => number,
            None => materials.without_textures(number),
        });
        self.mesh(attributes, triangles, number, place)
    }

    /// Data that only a decompressor could read.
    fn refuse_compressed(
        &self,
        primitive: &Primitive,
        position: Index<accessor::Accessor>,
        place: &str,
    ) -> Result<(), AssetError> {
        let accessor = self.buffers.accessor(position)?;
        let draco = primitive
            .extensions
            .as_ref()
            .is_some_and(|ext| ext.others.contains_key("KHR_draco_mesh_compression"));
        if draco && accessor.buffer_view.is_none() && accessor.sparse.is_none() {
            return Err(AssetError::unsupported(
                self.file,
                format!("{place} is compressed with KHR_draco_mesh_compression, not offered"),
            ));
        }
        Ok(())
    }

    /// [`Self::attributes`], read once for neighbours that share them.
    fn attributes_shared(
        &mut self,
        primitive: &Primitive,
        position: Index<accessor::Accessor>,
        placement: TexturePlacement,
        share: bool,
        place: &str,
    ) -> Result<Rc<Attributes>, AssetError> {
        let key = [
            Semantic::Positions,
            Semantic::Normals,
            Semantic::TexCoords(placement.set),
            Semantic::Colors(0),
        ]
        .map(|semantic| attribute(primitive, semantic).map(|index| index.value()));
        let attributes = match self.shared.take() {
            Some((known, placed, attributes)) if known == key && placed == placement => attributes,
            _ => Rc::new(self.attributes(primitive, position, placement, place)?),
        };
        if share {
            self.shared = Some((key, placement, attributes.clone()));
        }
        Ok(attributes)
    }

    /// Counts vertices and triangles that stay in memory.
    fn keep(&mut self, vertices: usize, triangles: usize, place: &str) -> Result<(), AssetError> {
        let (vertices, triangles) = (vertices as u64, triangles as u64);
        AssetError::check_limit(self.file, "vertices", vertices, self.vertices_left)?;
        self.vertices_left -= vertices;
        self.buffers.keep(place, vertices.saturating_add(triangles))
    }

    fn attributes(
        &mut self,
        primitive: &Primitive,
        position: Index<accessor::Accessor>,
        placement: TexturePlacement,
        place: &str,
    ) -> Result<Attributes, AssetError> {
        let (flat, _) = self.buffers.floats(position, &[Type::Vec3])?;
        let positions: Vec<DVec3> =
            flat.as_chunks::<3>().0.iter().map(|p| Vec3::from_array(*p).as_dvec3()).collect();
        let mut read = |semantic: Semantic, types: &[Type]| -> Result<_, AssetError> {
            let Some(index) = attribute(primitive, semantic.clone()) else { return Ok(None) };
            if self.buffers.count(index)? != positions.len() as u64 {
                let reason = "has another number of items than POSITION and is ignored";
                self.warnings.push(format!("{place}: {semantic:?} {reason}"));
                return Ok(None);
            }
            self.buffers.floats(index, types).map(Some)
        };
        let normals = read(Semantic::Normals, &[Type::Vec3])?;
        let uvs = read(Semantic::TexCoords(placement.set), &[Type::Vec2])?;
        let colors = read(Semantic::Colors(0), &[Type::Vec3, Type::Vec4])?;
        let normals = normals.and_then(|(flat, _)| {
            let normals = flat.as_chunks::<3>().0.iter().map(|n| Vec3::from_array(*n)).collect();
            tidy::unit_normals(normals, &mut self.warnings)
        });
        let (sin, cos) = placement.rotation.sin_cos();
        let uvs = uvs.map(|(flat, _)| {
            // Turned counter-clockwise as seen with v downwards, after scaling, before moving.
            let place = |uv: &[f32; 2]| {
                let [u, v] = [uv[0] * placement.scale[0], uv[1] * placement.scale[1]];
                let turned = Vec2::new(cos * u + sin * v, cos * v - sin * u);
                turned + Vec2::from_array(placement.offset)
            };
            flat.as_chunks::<2>().0.iter().map(place).collect()
        });
        let colors = colors.map(|(flat, components)| {
            let color = |c: &[f32]| {
                let alpha = c.get(3).map_or(255, |a| (a.clamp(0.0, 1.0) * 255.0).round() as u8);
                let [r, g, b] = [c[0], c[1], c[2]].map(srgb_byte_from_linear);
                [r, g, b, alpha]
            };
            flat.chunks_exact(components).map(color).collect()
        });
        Ok(Attributes { positions, normals, uvs, colors })
    }

    fn points(
        &mut self,
        attributes: Rc<Attributes>,
        indexed: bool,
        indices: Vec<u32>,
        material: Option<&Material>,
        place: &str,
    ) -> Result<Option<Geometry>, AssetError> {
        self.keep(indices.len(), 0, place)?;
        let attributes =
            if indexed { attributes.picked(&indices) } else { Rc::unwrap_or_clone(attributes) };
        let count = attributes.positions.len();
        let default = Material::default();
        let own = match (attributes.colors, material) {
            (None, Some(_)) => Some(vec![[255; 4]; count]),
            (own, _) => own,
        };
        let material = material.unwrap_or(&default);
        let colors = own.map(|own| own.into_iter().map(|color| painted(color, material)).collect());
        let cloud = PointCloud {
            positions: attributes.positions,
            colors,
            normals: attributes.normals,
            ..PointCloud::default()
        };
        let file = format!("{}: {place}", self.file);
        tidy::finish_cloud(cloud, &file, &mut self.warnings).map(|c| Some(Geometry::Points(c)))
    }

    fn triangles(
        &mut self,
        mode: Mode,
        indices: &[u32],
        place: &str,
    ) -> Result<Vec<[u32; 3]>, AssetError> {
        let count = match mode {
            Mode::Triangles => indices.len() / 3,
            _ => indices.len().saturating_sub(2),
        };
        AssetError::check_limit(self.file, "triangles", count as u64, self.triangles_left)?;
        self.triangles_left -= count as u64;
        Ok(match mode {
            Mode::TriangleStrip => indices
                .windows(3)
                .enumerate()
                .map(|(at, w)| if at % 2 == 0 { [w[0], w[1], w[2]] } else { [w[1], w[0], w[2]] })
                .collect(),
            Mode::TriangleFan => {
                indices[1..].windows(2).map(|w| [indices[0], w[0], w[1]]).collect()
            }
            _ => {
                let (triangles, rest) = indices.as_chunks::<3>();
                if !rest.is_empty() {
                    self.warnings.push(format!("{place}: the last triangle lacks corners"));
                }
                triangles.to_vec()
            }
        })
    }

    fn mesh(
        &mut self,
        attributes: Rc<Attributes>,
        triangles: Vec<[u32; 3]>,
        material: Option<u32>,
        place: &str,
    ) -> Result<Option<Geometry>, AssetError> {
        let (attributes, triangles) = compacted(attributes, triangles);
        self.keep(attributes.positions.len(), triangles.len(), place)?;
        let part = MeshPart { triangles: triangles.len() as u32, material };
        let mesh = Mesh {
            positions: attributes.positions,
            triangles,
            colors: attributes.colors,
            normals: attributes.normals,
            uvs: attributes.uvs,
            parts: if material.is_some() { vec![part] } else { Vec::new() },
        };
        match tidy::finish_mesh(mesh, self.file, &mut self.warnings) {
            Ok(mesh) => Ok(Some(Geometry::Mesh(mesh))),
            Err(AssetError::Malformed { reason, .. }) => {
                self.warnings.push(format!("{place} is left out: {reason}"));
                Ok(None)
            }
            Err(error) => Err(error),
        }
    }
}

impl Attributes {
    /// The vertices at `indices`, in that order.
    fn picked(&self, indices: &[u32]) -> Attributes {
        fn pick<T: Copy>(values: &[T], indices: &[u32]) -> Vec<T> {
            indices.iter().filter_map(|index| values.get(*index as usize).copied()).collect()
        }
        Attributes {
            positions: pick(&self.positions, indices),
            normals: self.normals.as_ref().map(|values| pick(values, indices)),
            uvs: self.uvs.as_ref().map(|values| pick(values, indices)),
            colors: self.colors.as_ref().map(|values| pick(values, indices)),
        }
    }
}

/// The colour of a vertex of points or lines of a material. Alpha counts where the material blends or has a cut-off.
fn painted(color: [u8; 4], material: &Material) -> [u8; 4] {
    let [red, green, blue, factor] = material.base_color;
    let [r, g, b, own] = tinted(color, [red, green, blue]);
    let alpha = f32::from(own) / 255.0 * factor;
    let byte = match material.alpha_cutoff {
        _ if material.blends() => (alpha * 255.0).round() as u8,
        Some(cutoff) if alpha < cutoff => 0,
        _ => 255,
    };
    [r, g, b, byte]
}

/// The colour of a vertex, times a linear factor.
fn tinted([r, g, b, alpha]: [u8; 4], tint: [f32; 3]) -> [u8; 4] {
    let [r, g, b] = [(r, tint[0]), (g, tint[1]), (b, tint[2])].map(|(byte, factor)| {
        srgb_byte_from_linear(tidy::linear_from_srgb(f32::from(byte) / 255.0) * factor)
    });
    [r, g, b, alpha]
}

/// Without the vertices that no triangle uses: primitives like to share one large accessor.
fn compacted(
    attributes: Rc<Attributes>,
    mut triangles: Vec<[u32; 3]>,
) -> (Attributes, Vec<[u32; 3]>) {
    let mut number = vec![u32::MAX; attributes.positions.len()];
    for index in triangles.iter().flatten() {
        number[*index as usize] = 0;
    }
    if number.iter().all(|number| *number == 0) {
        return (Rc::unwrap_or_clone(attributes), triangles);
    }
    let mut used = Vec::new();
    for (at, number) in number.iter_mut().enumerate().filter(|(_, number)| **number == 0) {
        *number = used.len() as u32;
        used.push(at as u32);
    }
    for index in triangles.iter_mut().flatten() {
        *index = number[*index as usize];
    }
    (attributes.picked(&used), triangles)
}

fn attribute(primitive: &Primitive, semantic: Semantic) -> Option<Index<accessor::Accessor>> {
    primitive.attributes.get(&Checked::Valid(semantic)).copied()
}
