//! Triangles of meshes. Vertices that chunks share are stored in each.

use std::borrow::Cow;
use std::io;
use std::ops::Range;

use glam::{DVec3, I64Vec3, IVec3, Vec2};
use rayon::prelude::*;

use super::kind::{
    Arrays, LOOKED_AT, PackedKind, PageKind, STRAY_SHARE, Stream, StreamOf, TAIL_SHARE, holds,
};
use super::{
    ALWAYS, CHUNK, GeometryKind, Grid, NO_NORMAL, NodeRange, PackError, PackedChunk, Sides,
    cell_of, finite, morton, octahedral, octahedral_decode, rgba_word,
};
use crate::assets::{Material, Mesh, MeshPart};
use crate::math::Bounds;

/// Words of a mesh vertex: grid position, colour, normal, texture coordinates.
pub const VERTEX_WORDS: usize = 7;

/// A mesh as the GPU holds it.
#[derive(Clone, Debug)]
pub struct PackedMesh {
    pub grid: Grid,
    pub chunks: Vec<PackedChunk>,
    pub vertices: Vec<[u32; VERTEX_WORDS]>,
    /// Three 10-bit indices into the chunk's vertices.
    pub triangles: Vec<u32>,
}

/// Packs a mesh whose parts refer to `materials`; vertices shared between chunks are stored in each.
///
/// # Errors
/// See [`PackError`].
pub fn pack_mesh(mesh: &Mesh, materials: &[Material]) -> Result<PackedMesh, PackError> {
    let grid = Grid::of(&Bounds::of(mesh.positions.iter().copied()))?;
    pack_triangles(mesh, materials, grid, None)
}

/// Packs a mesh for a point tree. `sides` are the errors up to which triangles are drawn, in mesh units. Triangles are sorted by
/// `sides` in bands of half an octave, so that a frame finds the triangles that it needs. `grid` is the grid of the samples that
/// stand in for the triangles, and holds the whole mesh.
///
/// # Errors
/// See [`PackError`].
pub fn pack_hybrid(
    mesh: &Mesh,
    materials: &[Material],
    grid: Grid,
    sides: &[f32],
) -> Result<PackedMesh, PackError> {
    pack_triangles(mesh, materials, grid, Some(sides))
}

fn pack_triangles(
    mesh: &Mesh,
    looks: &[Material],
    grid: Grid,
    sides: Option<&[f32]>,
) -> Result<PackedMesh, PackError> {
    finite(&mesh.positions)?;
    let cells: Vec<IVec3> = mesh.positions.par_iter().map(|&p| grid.quantise(p)).collect();
    let mut materials = vec![0u32; mesh.triangles.len()];
    let mut at = 0;
    for part in &mesh.parts {
        let end = (at + part.triangles as usize).min(materials.len());
        materials[at..end].fill(part.material.map_or(0, |m| m + 1));
        at = end;
    }
    let is_translucent = |material: u32| {
        let own = material.checked_sub(1).and_then(|material| looks.get(material as usize));
        own.is_some_and(|material| material.translucent)
    };
    let known = sides.unwrap_or_default().iter().zip(&materials);
    let opaque = known.filter(|(_, material)| !is_translucent(**material));
    let longest = opaque.map(|(&side, _)| side).fold(0.0, f32::max);
    // Translucent triangles come first, which have pages of their own, and then the longest ones.
    let band = |index: usize| {
        let side = sides.map_or(0.0, |sides| sides[index]);
        match side {
            _ if is_translucent(materials[index]) => 0,
            side if side > 0.0 => ((2.0 * (longest / side).log2()) as u32).saturating_add(1),
            _ => u32::MAX,
        }
    };
    let mut order: Vec<(u32, u32, u64, u32)> = mesh
        .triangles
        .par_iter()
        .enumerate()
        .map(|(index, corners)| {
            let sum: I64Vec3 = corners.iter().map(|&v| cells[v as usize].as_i64vec3()).sum();
            (band(index), materials[index], morton((sum / 3).as_ivec3()), index as u32)
        })
        .collect();
    order.par_sort_unstable();
    let mut packer = MeshPacker {
        mesh,
        cells: &cells,
        stamp: vec![(u32::MAX, 0); mesh.positions.len()],
        out: PackedMesh {
            grid,
            chunks: Vec::new(),
            vertices: Vec::with_capacity(mesh.positions.len()),
            triangles: Vec::with_capacity(order.len()),
        },
    };
    let mut last = 0;
    for &(band, material, _, index) in &order {
        let split = band != last && packer.out.chunks.last().is_some_and(|c| c.count >= 256);
        packer.add(material, mesh.triangles[index as usize], split);
        last = band;
    }
    packer.finish_boxes();
    for chunk in &mut packer.out.chunks {
        chunk.translucent = is_translucent(chunk.material);
    }
    if let Some(sides) = sides {
        let mut behind = 0.0f32;
        for chunk in packer.out.chunks.iter_mut().rev() {
            let own = order[chunk.elements()].iter().map(|&(.., index)| sides[index as usize]);
            behind = own.fold(behind, f32::max);
            // The bound covers this chunk and those behind it, as for nodes.
            chunk.range.error_parent = (behind / grid.step as f32).min(ALWAYS);
            chunk.range.size_parent = chunk.range.error_parent;
        }
    }
    Ok(packer.out)
}

struct MeshPacker<'a> {
    mesh: &'a Mesh,
    cells: &'a [IVec3],
    /// For every vertex of the mesh: the last chunk that took it, and its index there.
    stamp: Vec<(u32, u32)>,
    out: PackedMesh,
}

impl MeshPacker<'_> {
    fn add(&mut self, material: u32, corners: [u32; 3], split: bool) {
        let current = self.out.chunks.len() as u32;
        let fits = self.out.chunks.last().is_some_and(|chunk| {
            let fresh =
                corners.iter().filter(|&&v| self.stamp[v as usize].0 != current - 1).count();
            !split
                && chunk.material == material
                && (chunk.count as usize) < CHUNK
                && chunk.vertex_count as usize + fresh <= CHUNK
        });
        if !fits {
            self.out.chunks.push(PackedChunk {
                origin: IVec3::ZERO,
                extent: IVec3::ZERO,
                first: self.out.triangles.len() as u32,
                count: 0,
                shift: 0,
                vertex_first: self.out.vertices.len() as u32,
                vertex_count: 0,
                material,
                kernel_base: 0.0,
                sides: Sides::Unknown,
                translucent: false,
                range: NodeRange::default(),
            });
        }
        let number = self.out.chunks.len() as u32 - 1;
        let mut word = 0;
        for (place, &v) in corners.iter().enumerate() {
            let (owner, local) = self.stamp[v as usize];
            let local = if owner == number {
                local
            } else {
                let vertex = self.vertex(v as usize);
                self.out.vertices.push(vertex);
                let chunk = &mut self.out.chunks[number as usize];
                let local = chunk.vertex_count;
                chunk.vertex_count += 1;
                self.stamp[v as usize] = (number, local);
                local
            };
            word |= local << (10 * place);
        }
        self.out.triangles.push(word);
        self.out.chunks[number as usize].count += 1;
    }

    fn vertex(&self, v: usize) -> [u32; VERTEX_WORDS] {
        let cell = self.cells[v];
        let color = self.mesh.colors.as_ref().map_or(u32::MAX, |colors| rgba_word(colors[v]));
        let normal = self.mesh.normals.as_ref().map_or(NO_NORMAL, |normals| octahedral(normals[v]));
        let uv = self.mesh.uvs.as_ref().map_or([0.0; 2], |uvs| {
            let uv = uvs[v];
            if uv.is_finite() { uv.to_array() } else { [0.0; 2] }
        });
        [
            cell.x as u32,
            cell.y as u32,
            cell.z as u32,
            color,
            normal,
            uv[0].to_bits(),
            uv[1].to_bits(),
        ]
    }

    fn finish_boxes(&mut self) {
        for chunk in &mut self.out.chunks {
            let run = &self.out.vertices[chunk.vertices()];
            let low = run.iter().map(cell_of).fold(IVec3::MAX, IVec3::min);
            let high = run.iter().map(cell_of).fold(IVec3::MIN, IVec3::max);
            chunk.origin = low;
            chunk.extent = high - low;
        }
    }
}

/// Unpacks a mesh's triangles, in their order. A vertex shared by several chunks is repeated for each of them.
pub fn unpack_mesh(packed: &PackedMesh) -> Mesh {
    let words = &packed.vertices;
    let mut mesh = Mesh {
        positions: words.iter().map(|w| packed.grid.position(cell_of(w))).collect(),
        triangles: Vec::with_capacity(packed.triangles.len()),
        colors: Some(words.iter().map(|w| w[3].to_le_bytes()).collect()),
        normals: Some(words.iter().map(|w| octahedral_decode(w[4])).collect()),
        uvs: Some(
            words.iter().map(|w| Vec2::new(f32::from_bits(w[5]), f32::from_bits(w[6]))).collect(),
        ),
        parts: Vec::with_capacity(packed.chunks.len()),
    };
    for chunk in &packed.chunks {
        let triangles = &packed.triangles[chunk.elements()];
        mesh.triangles.extend(
            triangles
                .iter()
                .map(|word| [0, 10, 20].map(|shift| chunk.vertex_first + (word >> shift & 0x3ff))),
        );
        let material = chunk.material.checked_sub(1);
        mesh.parts.push(MeshPart { triangles: chunk.count, material });
    }
    mesh
}

/// Bytes that packing a mesh needs.
pub(super) fn packing_bytes(mesh: &Mesh) -> u64 {
    48 * mesh.positions.len() as u64 + 72 * mesh.triangles.len() as u64
}

fn area(corners: &[DVec3]) -> f64 {
    let &[a, b, c] = corners else { return 0.0 };
    0.5 * (b - a).cross(c - a).length()
}

impl PackedMesh {
    /// The corners of a chunk's triangles, in grid cells.
    fn triangles_of<'a>(
        &'a self,
        chunk: &PackedChunk,
    ) -> impl Iterator<Item = [DVec3; 3]> + use<'a> {
        let vertices = &self.vertices[chunk.vertices()];
        self.triangles[chunk.elements()]
            .iter()
            .map(move |&word| corners(vertices, word).map(|cell| cell.as_dvec3()))
    }

    /// Area of a chunk's triangles, in squares of grid cells.
    pub(in crate::bake) fn area_of(&self, chunk: &PackedChunk) -> f64 {
        self.triangles_of(chunk).map(|corners| area(&corners)).sum()
    }

    fn area(&self) -> f64 {
        // Chunk by chunk in their order, so that the sum is the same on every machine.
        let areas: Vec<f64> = self.chunks.par_iter().map(|chunk| self.area_of(chunk)).collect();
        areas.iter().sum()
    }
}

/// The grid positions of a triangle's corners.
fn corners(vertices: &[[u32; VERTEX_WORDS]], word: u32) -> [IVec3; 3] {
    [word, word >> 10, word >> 20].map(|corner| cell_of(&vertices[corner as usize & (CHUNK - 1)]))
}

impl PackedKind for PackedMesh {
    fn grid(&self) -> &Grid {
        &self.grid
    }

    fn chunks(&self) -> &[PackedChunk] {
        &self.chunks
    }

    fn len(&self) -> usize {
        self.triangles.len()
    }

    fn arrays(&self) -> Vec<&[u32]> {
        let PackedMesh { grid: _, chunks: _, vertices, triangles } = self;
        vec![vertices.as_flattened(), triangles]
    }

    fn widths() -> &'static [usize] {
        &[VERTEX_WORDS, 1]
    }

    fn read(grid: Grid, chunks: Vec<PackedChunk>, arrays: &mut Arrays<'_>) -> io::Result<Self> {
        Ok(PackedMesh { grid, chunks, vertices: arrays.rows()?, triangles: arrays.words()? })
    }

    fn check(&self) -> Result<(), &'static str> {
        let mut vertices = 0u64;
        for chunk in &self.chunks {
            holds(chunk.vertex_count as usize <= CHUNK, "a chunk has too many vertices")?;
            holds(
                u64::from(chunk.vertex_first) == vertices,
                "a chunk's vertices are not the next",
            )?;
            vertices += u64::from(chunk.vertex_count);
            // The last index needs no mask: no bits lie above it.
            let is_inside = |word: &u32| {
                [word & 0x3ff, word >> 10 & 0x3ff, word >> 20]
                    .iter()
                    .all(|&v| v < chunk.vertex_count)
            };
            let triangles = &self.triangles[chunk.elements()];
            holds(triangles.iter().all(is_inside), "a triangle's vertex is not in its chunk")?;
        }
        holds(vertices == self.vertices.len() as u64, "chunks do not have all vertices")?;
        holds(u32::try_from(vertices).is_ok(), "there are too many vertices")
    }

    fn page(&self, chunk: &PackedChunk) -> PageKind {
        PageKind { translucent: chunk.translucent, ..PageKind::plain(GeometryKind::Triangles) }
    }

    fn streams(_page: PageKind) -> Vec<Stream> {
        vec![
            Stream { name: "triangles", words: 1, of: StreamOf::Elements },
            Stream { name: "vertices", words: VERTEX_WORDS, of: StreamOf::Vertices },
        ]
    }

    fn stream(&self, _page: PageKind, name: &str, range: Range<usize>) -> Cow<'_, [u32]> {
        match name {
            "triangles" => self.triangles[range].into(),
            _ => self.vertices[range].as_flattened().into(),
        }
    }

    fn visit_elements(
        &self,
        chunk: &PackedChunk,
        range: Range<usize>,
        visit: &mut dyn FnMut(&[IVec3]),
    ) {
        let vertices = &self.vertices[chunk.vertices()];
        self.triangles[range].iter().for_each(|&word| visit(&corners(vertices, word)));
    }

    fn visit_cells(&self, chunk: &PackedChunk, visit: &mut dyn FnMut(IVec3)) {
        self.vertices[chunk.vertices()].iter().map(cell_of).for_each(visit);
    }

    /// Leaves out the triangles at the ends of each axis that have next to no area.
    fn core(&self) -> Option<Bounds> {
        let whole = self.area();
        if !(whole > 0.0 && whole.is_finite()) {
            return None;
        }
        let every = (self.triangles.len() as u64).div_ceil(LOOKED_AT);
        let large = whole / LOOKED_AT as f64;
        let triangles = self.chunks.iter().flat_map(|chunk| self.triangles_of(chunk));
        let chosen = (0u64..).zip(triangles).filter_map(|(index, corners)| {
            let area = area(&corners);
            let weight = if area >= large { area } else { area * every as f64 };
            (area >= large || index % every == 0).then_some((corners, weight))
        });
        let chosen: Vec<([DVec3; 3], f64)> = chosen.collect();
        let mut inside = vec![true; chosen.len()];
        let mut order: Vec<usize> = (0..chosen.len()).collect();
        for axis in 0..3 {
            let middle =
                |index: usize| chosen[index].0.iter().map(|corner| corner[axis]).sum::<f64>();
            order.sort_unstable_by(|&a, &b| middle(a).total_cmp(&middle(b)).then(a.cmp(&b)));
            let mut cut = |ends: &mut dyn Iterator<Item = &usize>| {
                let mut lost = 0.0;
                for &index in ends {
                    lost += chosen[index].1;
                    if lost > TAIL_SHARE * whole {
                        break;
                    }
                    inside[index] = false;
                }
            };
            cut(&mut order.iter());
            cut(&mut order.iter().rev());
        }
        let kept = chosen.iter().zip(&inside).filter(|&(_, &inside)| inside);
        let core = Bounds::of(kept.flat_map(|((corners, _), _)| *corners));
        (!core.is_empty()).then_some(core)
    }

    fn weight(&self, corners: &[DVec3]) -> f64 {
        area(corners)
    }

    fn stray_weight(&self) -> f64 {
        STRAY_SHARE * self.area()
    }
}
