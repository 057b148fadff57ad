//! Reader for the polygon file format (Greg Turk, "The PLY Polygon File Format", 1994): ascii and both
//! binaries, elements and properties in any order, unknown ones stepped over.
//!
//! `vertex` rows go straight into columns ([`vertices`]), `face` and `tristrips` lists straight into
//! triangles. A file without faces is a point cloud; `range_grid`, the raster of a raw range scan,
//! adds nothing to its points. Header lines that are not part of the format, which scanner software writes, are
//! ignored with a warning, unless they look like damage. Colours are taken as sRGB whatever their type, texture coordinates
//! with their origin at the bottom left; those of faces' corners count before those of vertices. Colours of faces count where vertices
//! have none. Gaussian splats in PLY's
//! clothing are refused.

mod body;
mod colors;
mod header;
mod vertices;

#[cfg(test)]
mod tests;

use std::io::BufRead;

use glam::{DVec3, Vec2};

use self::body::{Body, Row, Wanted};
use self::colors::FaceColors;
use self::header::{Element, Header, Kind};
pub(super) use self::vertices::Facts;
use self::vertices::Vertices;
use super::input::{Input, Origin};
use super::polygon::Triangulator;
use super::texture::{self, TextureBudget};
use super::tokens::Lines;
use super::warnings::counted;
use super::{
    Asset, AssetError, Geometry, Material, Mesh, MeshPart, PointCloud, ReadOptions, corners, tidy,
};
use crate::memory::Meter;

/// Points that are given at a time.
const BLOCK: usize = 1 << 16;
const INDEX_LISTS: [&str; 2] = ["vertex_indices", "vertex_index"];
/// Texture coordinates of a face's corners: u and v of each.
const CORNER_UVS: [&str; 1] = ["texcoord"];
const NO_UVS: [Vec2; 3] = [Vec2::ZERO; 3];

/// Reads PLY from `input`.
///
/// # Errors
/// Malformed or truncated content (naming element, index and property), counts over the limits,
/// Gaussian splats.
pub fn read_from(input: Input, options: &ReadOptions) -> Result<Asset, AssetError> {
    let Input { reader, origin } = input;
    let file = origin.name.as_str();
    let mut lines = Lines::new(reader, file);
    let header = checked_header(&mut lines, &origin, options)?;
    let vertex = vertex_element(&header, file)?;
    let mut meter = origin.admission.meter(file);
    let bytes_each = columns(&header, 0, file)?.bytes_each();
    meter.reach_exactly(origin.reserve(vertex.count) as u64 * bytes_each)?;
    let vertices = columns(&header, origin.reserve(vertex.count), file)?;
    let mut parts = Parts {
        file,
        vertices,
        vertex_count: vertex.count,
        have_vertices: false,
        have_faces: false,
        triangles: Vec::new(),
        triangulator: Triangulator::default(),
        rings: Vec::new(),
        ring_lengths: Vec::new(),
        ring_faces: Vec::new(),
        ring_uvs: Vec::new(),
        corner_uvs: Vec::new(),
        face_colors: FaceColors::nothing(),
        max_triangles: options.max_triangles,
        meter,
        short_faces: 0,
        warnings: header.warnings.clone(),
    };
    let mut body = Body::new(lines, header.encoding, &origin);
    for element in &header.elements {
        parts.element(element, &mut body, &origin)?;
    }
    parts.cut_rings()?;
    parts.finish(&header, &origin, options)
}

fn checked_header<R: BufRead>(
    lines: &mut Lines<'_, R>,
    origin: &Origin,
    options: &ReadOptions,
) -> Result<Header, AssetError> {
    let file = origin.name.as_str();
    let header = header::read(lines, file)?;
    refuse_splats(&header, file)?;
    let vertex = vertex_element(&header, file)?;
    let max_vertices = options.max_vertices.min(u64::from(u32::MAX));
    AssetError::check_limit(file, "vertices", vertex.count, max_vertices)?;
    for element in &header.elements {
        let place = format!("element {}", element.name);
        origin.check_count(&place, element.count, element.min_bytes(header.encoding))?;
    }
    Ok(header)
}

fn vertex_element<'h>(header: &'h Header, file: &str) -> Result<&'h Element, AssetError> {
    let missing = || AssetError::malformed(file, "header", "declares no vertex element");
    header.element("vertex").ok_or_else(missing)
}

/// Whether the file has faces, and so is a mesh.
fn is_mesh(header: &Header) -> bool {
    let has_faces = |element: &Element| {
        let name = element.name.to_ascii_lowercase();
        element.count > 0 && (name == "face" || name == "tristrips")
    };
    header.elements.iter().any(has_faces)
}

fn columns(header: &Header, reserve: usize, file: &str) -> Result<Vertices, AssetError> {
    let vertex = vertex_element(header, file)?;
    Vertices::new(vertex, reserve, !is_mesh(header)).map_err(|missing| {
        let reason = format!("the vertex element has no scalar property {missing}");
        AssetError::malformed(file, "header", reason)
    })
}

/// The vertices that the header announces; `None` where the file has faces, and so is a mesh.
pub(super) fn announced(input: Input, options: &ReadOptions) -> Result<Option<u64>, AssetError> {
    let Input { reader, origin } = input;
    let header = checked_header(&mut Lines::new(reader, &origin.name), &origin, options)?;
    let vertex = vertex_element(&header, &origin.name)?;
    Ok((!is_mesh(&header)).then_some(vertex.count))
}

/// Calls `visit` with the points of a file without faces, [`BLOCK`] at a time. What colours, normals and intensities are depends on
/// the whole file: give what a first call has found to a second one.
///
/// # Errors
/// As [`read_from`]; those of `visit`.
pub(super) fn each(
    input: Input,
    options: &ReadOptions,
    known: Option<&Facts>,
    visit: &mut dyn FnMut(PointCloud) -> Result<(), AssetError>,
) -> Result<Facts, AssetError> {
    let Input { reader, origin } = input;
    let file = origin.name.as_str();
    let mut lines = Lines::new(reader, file);
    let header = checked_header(&mut lines, &origin, options)?;
    let vertex = vertex_element(&header, file)?;
    let mut facts = Facts::default();
    let mut give = |block: Vertices| {
        facts.add(&block);
        visit(known.unwrap_or(&facts).cloud(block))
    };
    let mut body = Body::new(lines, header.encoding, &origin);
    for element in &header.elements {
        if !std::ptr::eq(element, vertex) {
            body.each(element, &Wanted::nothing(element), |_, _| Ok(()))?;
            continue;
        }
        let mut block = columns(&header, BLOCK, file)?;
        let wanted = block.wanted();
        body.each(element, &wanted, |_, row| {
            block.push(row);
            if block.len() < BLOCK {
                return Ok(());
            }
            give(std::mem::replace(&mut block, columns(&header, BLOCK, file)?))
        })?;
        give(block)?;
    }
    Ok(facts)
}

fn mesh_asset(
    mut mesh: Mesh,
    header: &Header,
    origin: &Origin,
    options: &ReadOptions,
    warnings: &mut Vec<String>,
) -> Result<Asset, AssetError> {
    let mut materials = Vec::new();
    let mut textures = Vec::new();
    if let (Some(reference), true) = (&header.texture_file, mesh.uvs.is_some()) {
        let mut budget = TextureBudget::new(options);
        match texture::load(reference, origin.folder.as_ref(), &mut budget) {
            Ok(image) => {
                textures.push(image);
                materials.push(Material {
                    name: reference.clone(),
                    base_texture: Some(0),
                    ..Material::default()
                });
                let count = mesh.triangles.len() as u32;
                mesh.parts = vec![MeshPart { triangles: count, material: Some(0) }];
            }
            Err(reason) => warnings.push(reason),
        }
    }
    let mesh = tidy::finish_mesh(mesh, &origin.name, warnings)?;
    let mut asset = Asset::single("ply", &origin.name, Geometry::Mesh(mesh));
    asset.materials = materials;
    asset.textures = textures;
    Ok(asset)
}

fn refuse_splats(header: &Header, file: &str) -> Result<(), AssetError> {
    let has = |name: &str| header.elements.iter().any(|e| e.scalar(&[name]).is_some());
    if has("f_dc_0") || has("packed_position") || (has("scale_0") && has("rot_0")) {
        return Err(AssetError::unsupported(
            file,
            "is a PLY file of 3D Gaussian splats; splats are not offered yet, only points and meshes",
        ));
    }
    Ok(())
}

fn index_list(element: &Element, file: &str) -> Result<Wanted, AssetError> {
    let place = format!("element {}", element.name);
    let list = element.list(&INDEX_LISTS).ok_or_else(|| {
        AssetError::malformed(file, &place, "has no list property vertex_indices")
    })?;
    if let Kind::List { item, .. } = element.properties[list].kind
        && item.is_float()
    {
        return Err(AssetError::malformed(file, &place, "vertex indices must be integers"));
    }
    Ok(Wanted { list: Some(list), ..Wanted::nothing(element) })
}

/// The geometry under construction.
struct Parts<'a> {
    file: &'a str,
    vertices: Vertices,
    vertex_count: u64,
    have_vertices: bool,
    have_faces: bool,
    triangles: Vec<[u32; 3]>,
    triangulator: Triangulator,
    /// Polygons that came before the vertices they need for being cut.
    rings: Vec<u32>,
    ring_lengths: Vec<u32>,
    /// The number of each ring's face among those with a colour.
    ring_faces: Vec<u32>,
    /// Texture coordinates beside `rings`, up to the last one that has them.
    ring_uvs: Vec<Vec2>,
    /// Texture coordinates beside `triangles`, up to the last one that has them.
    corner_uvs: Vec<[Vec2; 3]>,
    face_colors: FaceColors,
    max_triangles: u64,
    meter: Meter<'a>,
    short_faces: u64,
    warnings: Vec<String>,
}

impl Parts<'_> {
    fn element<R: BufRead>(
        &mut self,
        element: &Element,
        body: &mut Body<'_, R>,
        origin: &Origin,
    ) -> Result<(), AssetError> {
        match element.name.to_ascii_lowercase().as_str() {
            "vertex" if !self.have_vertices => {
                let wanted = self.vertices.wanted();
                body.each(element, &wanted, |_, row| {
                    self.vertices.push(row);
                    let bytes = self.vertices.len() as u64 * self.vertices.bytes_each();
                    Ok(self.meter.reach(bytes)?)
                })?;
                self.have_vertices = true;
            }
            "face" if element.count > 0 => {
                let mut wanted = self.begin_faces(element)?;
                wanted.numbers = element.list(&CORNER_UVS);
                if !self.face_colors.ask(element, &mut wanted) {
                    self.warnings.push("colours of a second list of faces are ignored".to_owned());
                }
                let reserved = origin.reserve(element.count);
                self.meter.reach_exactly(self.bytes() + 12 * reserved as u64)?;
                self.triangles.reserve(reserved);
                body.each(element, &wanted, |index, row| self.face(element, index, row))?;
            }
            "tristrips" if element.count > 0 => {
                let wanted = self.begin_faces(element)?;
                if colors::properties(element)[0].is_some() {
                    self.warnings.push("colours of triangle strips are ignored".to_owned());
                }
                body.each(element, &wanted, |index, row| self.strip(element, index, &row.list))?;
            }
            name => {
                body.each(element, &Wanted::nothing(element), |_, _| Ok(()))?;
                if element.count > 0 && name != "range_grid" {
                    self.warnings.push(format!("{} {name} elements are ignored", element.count));
                }
            }
        }
        Ok(())
    }

    fn begin_faces(&mut self, element: &Element) -> Result<Wanted, AssetError> {
        AssetError::check_limit(self.file, "faces", element.count, self.max_triangles)?;
        self.have_faces = true;
        index_list(element, self.file)
    }

    fn finish(
        mut self,
        header: &Header,
        origin: &Origin,
        options: &ReadOptions,
    ) -> Result<Asset, AssetError> {
        let mut warnings = std::mem::take(&mut self.warnings);
        for (count, one, many) in [
            (
                self.short_faces,
                "face with fewer than three corners is left out",
                "faces with fewer than three corners are left out",
            ),
            (
                self.triangulator.forced,
                "polygon crosses itself and is drawn as a fan",
                "polygons cross themselves and are drawn as fans",
            ),
        ] {
            warnings.extend(counted(count, one, many));
        }
        let vertices = self.vertices.finish(&mut warnings);
        let mut asset = if self.have_faces {
            let mut mesh = Mesh {
                positions: vertices.positions,
                triangles: self.triangles,
                colors: vertices.colors,
                normals: vertices.normals,
                uvs: vertices.uvs,
                parts: Vec::new(),
            };
            let triangles = mesh.triangles.len();
            if let Some(colors) = self.face_colors.of_triangles(triangles, &mut warnings) {
                corners::paint(&mut mesh, &colors, self.file, options, &mut warnings)?;
            }
            if !self.corner_uvs.is_empty() {
                corners::place_textures(&mut mesh, &self.corner_uvs, self.file, options)?;
            }
            mesh_asset(mesh, header, origin, options, &mut warnings)?
        } else {
            let cloud = tidy::finish_cloud(vertices.into_cloud(), self.file, &mut warnings)?;
            Asset::single("ply", self.file, Geometry::Points(cloud))
        };
        asset.warnings = warnings;
        Ok(asset)
    }

    fn vertex(&self, element: &Element, index: u64, vertex: i64) -> Result<u32, AssetError> {
        match u64::try_from(vertex) {
            Ok(found) if found < self.vertex_count => Ok(found as u32),
            _ => Err(AssetError::malformed(
                self.file,
                format!("{} {index}, property vertex_indices", element.name),
                format!("vertex {vertex} does not exist, the file has {}", self.vertex_count),
            )),
        }
    }

    fn face(&mut self, element: &Element, index: u64, row: &Row) -> Result<(), AssetError> {
        let list = row.list.as_slice();
        let face = self.face_colors.push(&row.values);
        let (numbers, _) = row.numbers.as_chunks::<2>();
        // The lists of faces without a texture are empty.
        let has_uvs = !list.is_empty() && numbers.len() == list.len();
        let uv =
            |corner: usize| numbers.get(corner).map_or(Vec2::ZERO, |&[u, v]| Vec2::new(u, 1.0 - v));
        if let [a, b, c] = *list {
            let triangle = [
                self.vertex(element, index, a)?,
                self.vertex(element, index, b)?,
                self.vertex(element, index, c)?,
            ];
            if has_uvs {
                self.corner_uvs.resize(self.triangles.len(), NO_UVS);
                self.corner_uvs.push([uv(0), uv(1), uv(2)]);
            }
            self.face_colors.give(face, self.triangles.len());
            self.triangles.push(triangle);
            return self.check_triangles();
        }
        let from = self.rings.len();
        for &vertex in list {
            let vertex = self.vertex(element, index, vertex)?;
            self.rings.push(vertex);
        }
        if has_uvs {
            self.ring_uvs.resize(from, Vec2::ZERO);
            self.ring_uvs.extend((0..list.len()).map(uv));
        }
        if list.len() < 3 {
            self.short_faces += 1;
            self.rings.truncate(from);
            self.ring_uvs.truncate(from);
        } else {
            self.ring_lengths.push(list.len() as u32);
            self.ring_faces.push(face);
            if self.have_vertices {
                self.cut_rings()?;
            }
        }
        self.check_triangles()
    }

    /// Bytes of what has been read.
    fn bytes(&self) -> u64 {
        self.vertices.len() as u64 * self.vertices.bytes_each()
            + 12 * self.triangles.len() as u64
            + 4 * (self.rings.len() + self.ring_lengths.len() + self.ring_faces.len()) as u64
            + self.face_colors.bytes()
            + 24 * self.corner_uvs.len() as u64
            + 8 * self.ring_uvs.len() as u64
    }

    fn check_triangles(&mut self) -> Result<(), AssetError> {
        self.meter.reach(self.bytes())?;
        let count = self.triangles.len() as u64;
        AssetError::check_limit(self.file, "triangles", count, self.max_triangles)
    }

    fn strip(&mut self, element: &Element, index: u64, list: &[i64]) -> Result<(), AssetError> {
        let mut window: Vec<u32> = Vec::with_capacity(3);
        let mut flip = false;
        for &vertex in list {
            if vertex == -1 {
                window.clear();
                flip = false;
                continue;
            }
            window.push(self.vertex(element, index, vertex)?);
            if let [a, b, c] = window[..] {
                // A repeated corner is how strips turn; it covers nothing.
                if a != b && b != c && c != a {
                    self.triangles.push(if flip { [b, a, c] } else { [a, b, c] });
                }
                flip = !flip;
                window.remove(0);
            }
        }
        self.check_triangles()
    }

    fn cut_rings(&mut self) -> Result<(), AssetError> {
        let positions = &self.vertices.positions;
        let mut from = 0;
        for (&length, &face) in self.ring_lengths.iter().zip(&self.ring_faces) {
            let ring = &self.rings[from..from + length as usize];
            let place = |vertex: u32| positions.get(vertex as usize).copied().unwrap_or(DVec3::NAN);
            let uvs = self.ring_uvs.get(from..from + length as usize);
            let (triangles, corner_uvs) = (&mut self.triangles, &mut self.corner_uvs);
            let face_colors = &mut self.face_colors;
            self.triangulator.cut(ring, place, |corners| {
                if let Some(uvs) = uvs {
                    corner_uvs.resize(triangles.len(), NO_UVS);
                    corner_uvs.push(corners.map(|corner| uvs[corner as usize]));
                }
                face_colors.give(face, triangles.len());
                triangles.push(corners.map(|corner| ring[corner as usize]));
            });
            from += length as usize;
        }
        self.rings.clear();
        self.ring_uvs.clear();
        self.ring_lengths.clear();
        self.ring_faces.clear();
        self.check_triangles()
    }
}
