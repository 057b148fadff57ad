//! Faces to an indexed mesh: one vertex for every combination of indices, one run per material.

use std::collections::HashMap;

use glam::{DVec3, Vec2, Vec3};

use super::super::polygon::Triangulator;
use super::super::warnings::counted;
use super::super::{AssetError, Mesh, MeshPart, tidy};
use super::{NONE, Statements};

impl Statements<'_> {
    /// The mesh, and the names of the materials that its parts refer to, in order. Without `colors`, vertices have none.
    pub(super) fn weave(
        &self,
        colors: Vec<[u8; 4]>,
        warnings: &mut Vec<String>,
    ) -> Result<(Mesh, Vec<String>), AssetError> {
        // Every corner may become a vertex, and vertices have 32-bit numbers.
        let corners = self.corners.len() as u64;
        AssetError::check_limit(self.file, "face corners", corners, u64::from(NONE))?;
        self.check_corners()?;
        let mut loom = Loom::new(self, colors);
        let mut triangulator = Triangulator::default();
        let mut ring: Vec<u32> = Vec::new();
        let mut used = Vec::new();
        let mut parts = Vec::new();
        let mut triangles: Vec<[u32; 3]> = Vec::with_capacity(self.triangles as usize);
        let starts = self.corner_starts();
        for run in self.by_material() {
            let before = triangles.len();
            for &face in &run.faces {
                let from = starts[face as usize] as usize;
                let count = self.faces[face as usize].corners as usize;
                ring.clear();
                ring.extend(self.corners[from..from + count].iter().map(|c| loom.vertex(*c)));
                let positions = &loom.mesh.positions;
                triangulator.cut(
                    &ring,
                    |vertex| positions[vertex as usize],
                    |cut| triangles.push(cut.map(|at| ring[at as usize])),
                );
            }
            let material = (run.material != NONE).then(|| {
                used.push(self.material_names[run.material as usize].clone());
                used.len() as u32 - 1
            });
            parts.push(MeshPart { triangles: (triangles.len() - before) as u32, material });
        }
        warnings.extend(counted(
            triangulator.forced,
            "polygon crosses itself and is drawn as a fan",
            "polygons cross themselves and are drawn as fans",
        ));
        let mut mesh = loom.mesh;
        mesh.triangles = triangles;
        if !used.is_empty() {
            mesh.parts = parts;
        }
        mesh.normals = mesh.normals.and_then(|normals| tidy::unit_normals(normals, warnings));
        Ok((mesh, used))
    }

    /// Indices that no statement of the whole file answers to.
    fn check_corners(&self) -> Result<(), AssetError> {
        let counts = [
            ("vertex", self.positions.len()),
            ("texture coordinate", self.uvs.len()),
            ("normal", self.normals.len()),
        ];
        let mut at = 0;
        for (number, face) in self.faces.iter().enumerate() {
            for corner in &self.corners[at..at + face.corners as usize] {
                for ((what, count), index) in counts.iter().zip(corner) {
                    if *index != NONE && *index as usize >= *count {
                        return Err(AssetError::malformed(
                            self.file,
                            format!("face {number} (line {})", face.line),
                            format!("{what} {} does not exist, the file has {count}", index + 1),
                        ));
                    }
                }
            }
            at += face.corners as usize;
        }
        Ok(())
    }

    fn corner_starts(&self) -> Vec<u64> {
        let mut start = 0;
        self.faces
            .iter()
            .map(|face| {
                let this = start;
                start += u64::from(face.corners);
                this
            })
            .collect()
    }

    /// Faces by material, in order of first use.
    fn by_material(&self) -> Vec<Run> {
        let mut runs: Vec<Run> = Vec::new();
        let mut run_of: HashMap<u32, usize> = HashMap::new();
        for (number, face) in self.faces.iter().enumerate() {
            let run = *run_of.entry(face.material).or_insert_with(|| {
                runs.push(Run { material: face.material, faces: Vec::new() });
                runs.len() - 1
            });
            runs[run].faces.push(number as u32);
        }
        runs
    }
}

struct Run {
    material: u32,
    faces: Vec<u32>,
}

/// Makes vertices out of combinations of indices.
struct Loom<'a> {
    statements: &'a Statements<'a>,
    colors: Vec<[u8; 4]>,
    vertices: HashMap<[u32; 3], u32>,
    mesh: Mesh,
}

impl<'a> Loom<'a> {
    fn new(statements: &'a Statements<'a>, colors: Vec<[u8; 4]>) -> Self {
        let any = |slot: usize| statements.corners.iter().any(|corner| corner[slot] != NONE);
        let mesh = Mesh {
            uvs: any(1).then(Vec::new),
            normals: any(2).then(Vec::new),
            colors: (!colors.is_empty()).then(Vec::new),
            ..Mesh::default()
        };
        Self { statements, colors, vertices: HashMap::new(), mesh }
    }

    /// The vertex for checked indices.
    fn vertex(&mut self, corner: [u32; 3]) -> u32 {
        let next = self.mesh.positions.len() as u32;
        let vertex = *self.vertices.entry(corner).or_insert(next);
        if vertex != next {
            return vertex;
        }
        let [position, uv, normal] = corner.map(|index| index as usize);
        let from = self.statements;
        self.mesh.positions.push(from.positions.get(position).copied().unwrap_or(DVec3::NAN));
        if let Some(uvs) = &mut self.mesh.uvs {
            uvs.push(from.uvs.get(uv).copied().unwrap_or(Vec2::ZERO));
        }
        if let Some(normals) = &mut self.mesh.normals {
            normals.push(from.normals.get(normal).copied().unwrap_or(Vec3::ZERO));
        }
        if let Some(colors) = &mut self.mesh.colors {
            colors.push(self.colors.get(position).copied().unwrap_or([255; 4]));
        }
        vertex
    }
}
