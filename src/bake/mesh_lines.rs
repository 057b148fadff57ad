//! Lines made of a mesh: its leaves become ribbons and its branches tubes, the rest stays triangles (Marroquim et al. 2008, §4.3).
//!
//! A *leaf* is a piece of the mesh that is a strip of quads, whose ends may be triangles ([`leaves`]). A *branch* is a piece that is a
//! row of rings with equally many corners, open or closed by a tip at either end ([`branches`]). A piece is what hangs together by
//! edges, after vertices at the same place became one. Where branches fork within one piece, they stay triangles.

mod branches;
mod leaves;

use glam::{DVec3, Vec3};

use super::crease::{WordMap, weld};
use super::groups::Groups;
use super::sample::color::Colors;
use crate::assets::tidy::drop_vertices;
use crate::assets::{Material, Mesh, Polylines, Texture};
use crate::scene::AsLines;
use crate::scene::color::{linear_from_srgb, srgb_from_linear};

/// Largest radius of a branch and half-width of a leaf, as shares of the mesh's diagonal, unless the options give one.
const WIDEST_BRANCH: f64 = 0.01;
const WIDEST_LEAF: f64 = 0.05;
/// Rings of a smaller radius, as a share of the diagonal, need not be round: they are as coarse as files of six digits.
const THIN_SHARE: f64 = 2e-5;
/// Larger pieces are neither leaves nor branches.
const MAX_TRIANGLES: usize = 1 << 16;
/// Memory that [`lines_of_mesh`] takes for a triangle, with what it returns, in bytes.
pub(super) const TRIANGLE_BYTES: u64 = 384;

/// A mesh in parts. Parts that would be empty are absent.
#[derive(Clone, Debug, Default)]
pub struct MeshLines {
    /// Triangles that belong to no leaf and no branch.
    pub rest: Option<Mesh>,
    /// Ribbons: strands with normals and half-widths.
    pub leaves: Option<Polylines>,
    /// Tubes: strands with radii.
    pub branches: Option<Polylines>,
}

/// Turns the leaves and branches of a mesh into lines. Parts of the mesh refer to `materials`, and these to `textures`.
///
/// Lines have the mesh's unit. The colour of a vertex is the mean over the mesh around it. Where the alpha cut-off of a material
/// shapes a leaf, widths follow the texture.
pub fn lines_of_mesh(
    mesh: &Mesh,
    materials: &[Material],
    textures: &[Texture],
    options: &AsLines,
) -> MeshLines {
    let diagonal = diagonal(mesh);
    let pieces = Pieces::of(mesh, diagonal);
    let widest = |share: f64| options.max_radius.unwrap_or(share * diagonal);
    let is_thin = |strand: &[LineVertex], share: f64| {
        strand.iter().all(|vertex| f64::from(vertex.radius) <= widest(share))
    };
    let colors = Colors::of(mesh, materials, textures);
    let (mut leaves, mut branches) = (Strands::default(), Strands::default());
    let mut is_line = vec![false; mesh.triangles.len()];
    for piece in pieces.list() {
        let leaf = || leaves::ribbon(&pieces, piece, &colors);
        let branch = || branches::tube(&pieces, piece, &colors);
        let leaf = options.leaves.then(leaf).flatten();
        let branch = if leaf.is_none() && options.branches { branch() } else { None };
        match (leaf, branch) {
            (Some(leaf), _) if is_thin(&leaf, WIDEST_LEAF) => leaves.add(&leaf),
            (_, Some(branch)) if is_thin(&branch, WIDEST_BRANCH) => branches.add(&branch),
            _ => continue,
        }
        piece.iter().for_each(|&triangle| is_line[triangle as usize] = true);
    }
    MeshLines {
        rest: without(mesh, &is_line),
        leaves: leaves.finish(true),
        branches: branches.finish(false),
    }
}

fn diagonal(mesh: &Mesh) -> f64 {
    let used = mesh.triangles.iter().flatten();
    let places = used.filter_map(|&corner| mesh.positions.get(corner as usize));
    let ends = places.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), &place| {
        (low.min(place), high.max(place))
    });
    (ends.1 - ends.0).length()
}

/// A vertex of a line.
struct LineVertex {
    position: DVec3,
    /// Radius of a tube, half the width of a ribbon.
    radius: f32,
    /// Unit length; looked at where it belongs to a ribbon.
    normal: Vec3,
    color: [u8; 4],
}

/// Lines under construction.
#[derive(Default)]
struct Strands {
    lines: Polylines,
    radii: Vec<f32>,
    normals: Vec<Vec3>,
    colors: Vec<[u8; 4]>,
}

impl Strands {
    fn add(&mut self, strand: &[LineVertex]) {
        self.lines.strands.push(self.radii.len() as u32);
        for vertex in strand {
            self.lines.positions.push(vertex.position);
            self.radii.push(vertex.radius);
            self.normals.push(vertex.normal);
            self.colors.push(vertex.color);
        }
    }

    fn finish(self, are_ribbons: bool) -> Option<Polylines> {
        let mut lines = self.lines;
        if lines.strands.is_empty() {
            return None;
        }
        lines.strands.push(lines.positions.len() as u32);
        lines.radii = Some(self.radii);
        lines.normals = are_ribbons.then_some(self.normals);
        lines.colors = Some(self.colors);
        Some(lines)
    }
}

/// The mean of sRGB colours in linear light, opaque; `None` of none.
fn mean_color(colors: impl Iterator<Item = [u8; 4]>) -> Option<[u8; 4]> {
    let (mut sum, mut count) = (DVec3::ZERO, 0.0);
    for [r, g, b, _] in colors {
        sum += DVec3::from([r, g, b].map(|byte| linear_from_srgb(f64::from(byte) / 255.0)));
        count += 1.0;
    }
    let byte = |linear: f64| (srgb_from_linear(linear) * 255.0).round() as u8;
    let [r, g, b] = (sum / count).to_array().map(byte);
    (count > 0.0).then_some([r, g, b, 255])
}

/// An edge, by its two places, the smaller first.
type Edge = (u32, u32);

fn edge(a: u32, b: u32) -> Edge {
    (a.min(b), a.max(b))
}

/// Whether no two corners of a triangle are at the same place.
fn has_area([a, b, c]: [u32; 3]) -> bool {
    a != b && b != c && c != a
}

fn edges_of(corners: [u32; 3]) -> [Edge; 3] {
    let [a, b, c] = corners;
    [edge(a, b), edge(b, c), edge(c, a)]
}

/// What hangs together by edges.
struct Pieces<'a> {
    mesh: &'a Mesh,
    /// The place of each vertex.
    places: Vec<u32>,
    /// Rings of a smaller radius need not be round.
    thin: f64,
    /// Triangles, piece after piece, and where each piece begins.
    triangles: Vec<u32>,
    begins: Vec<usize>,
}

impl<'a> Pieces<'a> {
    fn of(mesh: &'a Mesh, diagonal: f64) -> Self {
        let places = weld(&mesh.positions);
        let thin = THIN_SHARE * diagonal;
        let mut pieces = Pieces { mesh, places, thin, triangles: Vec::new(), begins: Vec::new() };
        let count = mesh.triangles.len();
        let mut groups = Groups::new(count);
        let mut owners: WordMap<Edge, u32> = WordMap::default();
        for triangle in 0..count as u32 {
            for edge in pieces.corners(triangle).into_iter().flat_map(edges_of) {
                groups.join(*owners.entry(edge).or_insert(triangle), triangle);
            }
        }
        drop(owners);
        let roots = groups.roots();
        let is_placed = |&triangle: &u32| pieces.corners(triangle).is_some();
        pieces.triangles = (0..count as u32).filter(is_placed).collect();
        pieces.triangles.sort_by_key(|&triangle| roots[triangle as usize]);
        let root = |at: usize| roots[pieces.triangles[at] as usize];
        let is_first = |at: &usize| *at == 0 || root(*at) != root(at - 1);
        pieces.begins = (0..pieces.triangles.len()).filter(is_first).collect();
        pieces
    }

    fn list(&self) -> impl Iterator<Item = &[u32]> {
        let ends = self.begins.iter().skip(1).copied().chain([self.triangles.len()]);
        let pieces = self.begins.iter().zip(ends).map(|(&begin, end)| &self.triangles[begin..end]);
        pieces.filter(|piece| piece.len() <= MAX_TRIANGLES)
    }

    /// The places of a triangle's corners; `None` where a vertex does not exist or is nowhere.
    fn corners(&self, triangle: u32) -> Option<[u32; 3]> {
        let vertices = self.mesh.triangles.get(triangle as usize)?;
        let [a, b, c] = vertices.map(|vertex| {
            let position = self.mesh.positions.get(vertex as usize)?;
            position.is_finite().then_some(self.places[vertex as usize])
        });
        Some([a?, b?, c?])
    }

    /// The positions of a triangle's corners.
    fn positions(&self, triangle: u32) -> [DVec3; 3] {
        self.mesh.triangles[triangle as usize].map(|vertex| self.mesh.positions[vertex as usize])
    }
}

/// The triangles of a mesh that no line replaces, with the vertices that they use; `None` without any.
fn without(mesh: &Mesh, is_line: &[bool]) -> Option<Mesh> {
    let mut rest = mesh.clone();
    let mut lines = is_line.iter();
    rest.triangles.retain(|_| lines.next() == Some(&false));
    if rest.triangles.is_empty() {
        return None;
    }
    let mut begin = 0;
    for part in &mut rest.parts {
        let end = (begin + part.triangles as usize).min(is_line.len());
        part.triangles = is_line[begin..end].iter().filter(|is_line| !**is_line).count() as u32;
        begin = end;
    }
    rest.parts.retain(|part| part.triangles > 0);
    let mut is_used = vec![false; mesh.positions.len()];
    let mut all_exist = true;
    for &vertex in rest.triangles.iter().flatten() {
        match is_used.get_mut(vertex as usize) {
            Some(is_used) => *is_used = true,
            None => all_exist = false,
        }
    }
    if all_exist {
        drop_vertices(&mut rest, &is_used);
    }
    Some(rest)
}

#[cfg(test)]
mod tests;
