//! Reader for Wavefront OBJ with its MTL materials and textures.
//!
//! Positions, texture coordinates and normals have indices of their own in OBJ; every combination
//! that a face uses becomes one vertex. Positions are read in f64, colours behind them (`v x y z r g
//! b`) are sRGB. Polygons are cut into triangles, which are sorted by material into runs. Line elements
//! become strands, a geometry of their own beside the mesh. A file with neither is a point cloud.
//!
//! MTL's `Kd` and `Ks` are what most viewers put on the screen unchanged, so they are taken as sRGB.

mod lines;
mod mtl;
mod weave;

#[cfg(test)]
mod tests;

use std::collections::HashMap;

use glam::{DAffine3, DVec3, Vec2, Vec3};

use self::lines::LineElements;
use super::input::{Input, Origin};
use super::tokens::{Lines, Tokens, number, shown};
use super::warnings::counted;
use super::{Asset, AssetError, Geometry, Placement, PointCloud, ReadOptions, tidy};
use crate::memory::Meter;

/// Bytes of a name in a list and in a map.
const NAME_BYTES: usize = 192;
/// Bytes of a corner as a vertex of its own, and of its entry in a map.
const CORNER_BYTES: u64 = 96;
/// In a corner: this vertex has no such attribute. In a face: it has no material.
const NONE: u32 = u32::MAX;
/// The colour of a vertex that has none in a file that has colours.
const UNCOLORED: [f32; 4] = [-1.0; 4];

/// Reads OBJ from `input`.
///
/// # Errors
/// Malformed content (naming line, element and property), indices that lead nowhere, counts over the
/// limits. Materials and textures that cannot be read are warnings.
pub fn read_from(input: Input, options: &ReadOptions) -> Result<Asset, AssetError> {
    let Input { reader, origin } = input;
    let mut statements = Statements::new(&origin.name, options);
    let mut lines = Lines::new(reader, &origin.name);
    lines.end_at_carriage_returns_if_alone()?;
    while lines.advance()? {
        // A comment may end in a path's backslash.
        if !is_comment(lines.tokens()) {
            lines.join_continuations()?;
        }
        statements.line(lines.tokens(), lines.number)?;
        statements.meter.reach(statements.bytes())?;
    }
    statements.finish(&origin, options)
}

fn is_comment(mut tokens: Tokens) -> bool {
    tokens.next().is_some_and(|word| word.starts_with(b"#"))
}

#[derive(Clone, Copy)]
struct Face {
    corners: u32,
    /// Index into [`Statements::material_names`] or [`NONE`].
    material: u32,
    line: u32,
}

/// The file's statements, as they stand.
struct Statements<'a> {
    file: &'a str,
    max_vertices: u64,
    max_triangles: u64,
    positions: Vec<DVec3>,
    /// Empty, or as long as `positions`; [`UNCOLORED`] where a vertex has none.
    colors: Vec<[f32; 4]>,
    uvs: Vec<Vec2>,
    normals: Vec<Vec3>,
    faces: Vec<Face>,
    /// Position, texture coordinate and normal of every face's corners.
    corners: Vec<[u32; 3]>,
    triangles: u64,
    meter: Meter<'a>,
    material_names: Vec<String>,
    material_numbers: HashMap<String, u32>,
    material: u32,
    libraries: Vec<String>,
    short_faces: u64,
    line_elements: LineElements,
    unknown: u64,
}

impl<'a> Statements<'a> {
    fn new(file: &'a str, options: &'a ReadOptions) -> Self {
        Self {
            file,
            max_vertices: options.max_vertices.min(u64::from(u32::MAX - 1)),
            max_triangles: options.max_triangles,
            positions: Vec::new(),
            colors: Vec::new(),
            uvs: Vec::new(),
            normals: Vec::new(),
            faces: Vec::new(),
            corners: Vec::new(),
            triangles: 0,
            meter: options.admission.meter(file),
            material_names: Vec::new(),
            material_numbers: HashMap::new(),
            material: NONE,
            libraries: Vec::new(),
            short_faces: 0,
            line_elements: LineElements::default(),
            unknown: 0,
        }
    }

    /// Bytes of what has been read.
    fn bytes(&self) -> u64 {
        let vertices = 24 * self.positions.len() + 16 * self.colors.len();
        let attributes = 8 * self.uvs.len() + 12 * self.normals.len();
        let faces = 12 * self.faces.len() + 12 * self.corners.len();
        let names = NAME_BYTES * (self.material_names.len() + self.libraries.len());
        (vertices + attributes + faces + names) as u64 + self.line_elements.bytes()
    }

    fn line(&mut self, mut tokens: Tokens, line: u64) -> Result<(), AssetError> {
        let Some(keyword) = tokens.next() else { return Ok(()) };
        let fault = |element: String| {
            let file = self.file;
            move |reason: String| {
                AssetError::malformed(file, format!("{element} (line {line})"), reason)
            }
        };
        match keyword {
            b"v" => {
                let fault = fault(format!("vertex {}", self.positions.len()));
                self.vertex(tokens).map_err(fault)?;
                let count = self.positions.len() as u64;
                AssetError::check_limit(self.file, "vertices", count, self.max_vertices)?;
            }
            b"vt" => {
                let fault = fault(format!("texture coordinate {}", self.uvs.len()));
                let u = coordinate(&mut tokens, "u").map_err(fault)?;
                // One-dimensional textures have no v.
                let v = tokens.next().and_then(number).unwrap_or(0.0);
                self.uvs.push(Vec2::new(u as f32, (1.0 - v) as f32));
                let count = self.uvs.len() as u64;
                AssetError::check_limit(self.file, "vertices", count, self.max_vertices)?;
            }
            b"vn" => {
                let fault = fault(format!("normal {}", self.normals.len()));
                let normal = vector(&mut tokens, ["nx", "ny", "nz"]).map_err(fault)?;
                self.normals.push(normal.as_vec3());
                let count = self.normals.len() as u64;
                AssetError::check_limit(self.file, "vertices", count, self.max_vertices)?;
            }
            b"f" | b"fo" => {
                let fault = fault(format!("face {}", self.faces.len() as u64 + self.short_faces));
                self.face(tokens, line).map_err(fault)?;
                AssetError::check_limit(
                    self.file,
                    "triangles",
                    self.triangles,
                    self.max_triangles,
                )?;
            }
            b"usemtl" => self.material = self.material_number(&tokens.rest()),
            b"mtllib" => self.libraries.push(tokens.rest()),
            b"l" => {
                let fault = fault(format!("line element {}", self.line_elements.len()));
                self.line_element(tokens, line).map_err(fault)?;
            }
            b"g" | b"o" | b"s" | b"p" | b"vp" | b"usemap" | b"maplib" | b"lod" | b"end" => {}
            _ if keyword.starts_with(b"#") => {}
            _ => self.unknown += 1,
        }
        Ok(())
    }

    fn material_number(&mut self, name: &str) -> u32 {
        if let Some(&number) = self.material_numbers.get(name) {
            return number;
        }
        let number = self.material_names.len() as u32;
        self.material_names.push(name.to_owned());
        self.material_numbers.insert(name.to_owned(), number);
        number
    }

    fn vertex(&mut self, mut tokens: Tokens) -> Result<(), String> {
        let position = vector(&mut tokens, ["x", "y", "z"])?;
        let mut rest = [0.0f32; 4];
        let mut count = 0;
        for token in tokens.by_ref().take(4) {
            if token.starts_with(b"#") {
                break;
            }
            let value = number(token)
                .ok_or_else(|| format!("property colour: {} is not a number", shown(token)))?;
            rest[count] = value as f32;
            count += 1;
        }
        // One value more is a weight, three a colour, four a colour with alpha.
        if count >= 3 {
            if self.colors.is_empty() {
                self.colors.resize(self.positions.len(), UNCOLORED);
            }
            let alpha = if count == 4 { rest[3] } else { f32::NAN };
            self.colors.push([rest[0], rest[1], rest[2], alpha]);
        } else if !self.colors.is_empty() {
            self.colors.push(UNCOLORED);
        }
        self.positions.push(position);
        Ok(())
    }

    fn face(&mut self, tokens: Tokens, line: u64) -> Result<(), String> {
        let from = self.corners.len();
        for token in tokens {
            if token.starts_with(b"#") {
                break;
            }
            let corner = self.corner(token)?;
            self.corners.push(corner);
        }
        let count = self.corners.len() - from;
        if count < 3 {
            self.corners.truncate(from);
            self.short_faces += 1;
            return Ok(());
        }
        self.triangles += count as u64 - 2;
        self.faces.push(Face {
            corners: count as u32,
            material: self.material,
            line: u32::try_from(line).unwrap_or(u32::MAX),
        });
        Ok(())
    }

    /// `v`, `v/t`, `v//n` or `v/t/n`; indices from 1, or from −1 backwards. What is beyond the end
    /// may still come and is judged at the end.
    fn corner(&self, token: &[u8]) -> Result<[u32; 3], String> {
        let counts = [self.positions.len(), self.uvs.len(), self.normals.len()];
        let mut corner = [NONE; 3];
        for (at, part) in token.split(|byte| *byte == b'/').enumerate() {
            if part.is_empty() && at > 0 {
                continue;
            }
            let index = std::str::from_utf8(part).ok().and_then(|text| text.parse::<i64>().ok());
            let (Some(index), Some(slot)) = (index, corner.get_mut(at)) else {
                return Err(format!("{} is no corner", shown(token)));
            };
            let resolved = match index {
                1.. => u32::try_from(index - 1).ok().filter(|index| *index != NONE),
                0 => return Err(format!("{}: indices begin at 1", shown(token))),
                _ => u32::try_from(counts[at] as i64 + index).ok(),
            };
            *slot =
                resolved.ok_or_else(|| format!("{} leads to nothing before it", shown(token)))?;
        }
        Ok(corner)
    }

    fn finish(self, origin: &Origin, options: &ReadOptions) -> Result<Asset, AssetError> {
        let mut warnings = Vec::new();
        for (count, one, many) in [
            (
                self.short_faces,
                "face with fewer than three corners is left out",
                "faces with fewer than three corners are left out",
            ),
            (
                self.unknown,
                "statement is unknown and ignored",
                "statements are unknown and ignored",
            ),
        ] {
            warnings.extend(counted(count, one, many));
        }
        let colors = self.vertex_colors(&mut warnings);
        let strands =
            self.strands(colors.as_deref(), origin, options, &mut warnings)?.map(Geometry::Lines);
        let (mut asset, strands) = match (self.faces.is_empty(), strands) {
            (true, Some(strands)) => (Asset::single("obj", &origin.name, strands), None),
            (true, None) => {
                let cloud = self.into_cloud(colors, &mut warnings);
                let cloud = tidy::finish_cloud(cloud, &origin.name, &mut warnings)?;
                (Asset::single("obj", &origin.name, Geometry::Points(cloud)), None)
            }
            (false, strands) => {
                // Every corner may become a vertex, found by a map.
                let corners = self.corners.len() as u64;
                options.admission.grow(&origin.name, corners * CORNER_BYTES)?;
                let is_unnamed = self.libraries.is_empty() && !self.uvs.is_empty();
                let (mesh, used) = self.weave(colors.unwrap_or_default(), &mut warnings)?;
                if is_unnamed
                    && let Some(image) = origin.folder.as_ref().and_then(|folder| folder.image())
                {
                    warnings.push(format!(
                    "{image} is not used: the file has texture coordinates, but names no material library (mtllib) that would name the image"
                ));
                }
                let mesh = tidy::finish_mesh(mesh, &origin.name, &mut warnings)?;
                let mut asset = Asset::single("obj", &origin.name, Geometry::Mesh(mesh));
                let library = mtl::read(
                    &self.libraries,
                    &used,
                    origin.folder.as_ref(),
                    options,
                    &mut warnings,
                );
                asset.materials = library.materials;
                asset.textures = library.textures;
                (asset, strands)
            }
        };
        if let Some(strands) = strands {
            asset.placements.push(Placement {
                name: origin.name.clone(),
                geometry: asset.geometries.len(),
                asset_from_geometry: DAffine3::IDENTITY,
            });
            asset.geometries.push(strands);
        }
        asset.warnings = warnings;
        Ok(asset)
    }

    /// The colour of each vertex, white where it has none; `None` where no vertex has one.
    fn vertex_colors(&self, warnings: &mut Vec<String>) -> Option<Vec<[u8; 4]>> {
        let mut colors = tidy::colors_from_floats(&self.colors, "that of vertex", warnings);
        let own = colors.iter_mut().zip(&self.colors);
        own.filter(|(_, own)| **own == UNCOLORED).for_each(|(color, _)| *color = [255; 4]);
        (!colors.is_empty()).then_some(colors)
    }

    fn into_cloud(self, colors: Option<Vec<[u8; 4]>>, warnings: &mut Vec<String>) -> PointCloud {
        let count = self.positions.len();
        let normals = (self.normals.len() == count).then_some(self.normals);
        PointCloud {
            positions: self.positions,
            colors,
            normals: normals.and_then(|normals| tidy::unit_normals(normals, warnings)),
            ..PointCloud::default()
        }
    }
}

fn coordinate(tokens: &mut Tokens, property: &str) -> Result<f64, String> {
    let token = tokens.next().ok_or_else(|| format!("property {property} is missing"))?;
    number(token).ok_or_else(|| format!("property {property}: {} is not a number", shown(token)))
}

fn vector(tokens: &mut Tokens, properties: [&str; 3]) -> Result<DVec3, String> {
    let [x, y, z] = properties;
    Ok(DVec3::new(coordinate(tokens, x)?, coordinate(tokens, y)?, coordinate(tokens, z)?))
}
