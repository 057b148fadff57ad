//! Vertex normals of meshes, smooth up to a crease angle.
//!
//! 1. Vertices at exactly the same place are welded, so that a mesh whose triangles share nothing
//!    (STL) or that is cut along texture seams is smooth across them.
//! 2. Each corner of a triangle sums the normals of the triangles around its place, weighted with
//!    their angle there (Thürmer and Wüthrich 1998), as far as they lie within the crease angle of
//!    its own triangle. Triangles without area have no normal and contribute nothing; their own
//!    corners take everything around them.
//! 3. A vertex whose corners disagree is split: its first normal stays with it, each further one gets
//!    a copy of it at the end, with its colour and texture coordinates.
//!
//! Around places with very many triangles (the tip of a cone, hostile input), step 2 sums the
//! triangles' normals by direction first, in steps finer than 0.03, so that it stays linear.

use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use crate::assets::Mesh;

/// Places with more corners are handled by direction.
const MAX_PAIRWISE: usize = 256;
/// Cosines may be off by this much: coplanar triangles are within a crease angle of zero.
const COSINE_SLACK: f64 = 1e-9;
/// Normals that differ by less are one.
const NORMAL_STEP: f32 = 1.0 / (1 << 18) as f32;
/// Corners are numbered in 32 bits.
const MAX_TRIANGLES: usize = u32::MAX as usize / 3;

/// Gives a mesh the vertex normals that it lacks: all of them, or those of length zero.
///
/// Two triangles are smooth at a vertex when the angle between them is at most `crease_deg`
/// degrees: 0 gives flat facets, 180 no creases at all. Vertices are split where that needs it:
/// positions, colours and texture coordinates grow alike, triangles keep their order and parts.
/// Afterwards normals are unit vectors, or zero for vertices that no triangle with area uses (and
/// for all of a mesh with more than 1.4 billion triangles, whose corners 32 bits cannot number).
pub fn smooth_normals(mesh: &mut Mesh, crease_deg: f64) {
    let count = mesh.positions.len();
    mesh.normals = mesh.normals.take().filter(|normals| normals.len() == count);
    if mesh.normals.as_ref().is_some_and(|normals| !normals.contains(&Vec3::ZERO)) {
        return;
    }
    if mesh.triangles.len() > MAX_TRIANGLES {
        mesh.normals.get_or_insert_with(|| vec![Vec3::ZERO; count]);
        return;
    }
    let faces = Faces::of(mesh);
    let fans = Fans::of(mesh, &faces);
    let crease_cosine = match crease_deg {
        angle if angle >= 180.0 => -2.0,
        angle => angle.max(0.0).to_radians().cos() - COSINE_SLACK,
    };
    let corners = corner_normals(&faces, &fans, crease_cosine);
    assign(mesh, &corners);
}

/// Contributions of each triangle.
struct Faces {
    /// Unit normals, zero for triangles without area or with indices that do not exist.
    normals: Vec<Vec3>,
    /// Angles in radians at the three corners.
    angles: Vec<[f32; 3]>,
}

impl Faces {
    fn of(mesh: &Mesh) -> Self {
        let (normals, angles) = mesh
            .triangles
            .par_iter()
            .map(|triangle| face(mesh, triangle).unwrap_or((Vec3::ZERO, [0.0; 3])))
            .unzip();
        Self { normals, angles }
    }
}

/// Normal and angles of a triangle, if it has any.
fn face(mesh: &Mesh, triangle: &[u32; 3]) -> Option<(Vec3, [f32; 3])> {
    let corner = |i: usize| mesh.positions.get(triangle[i] as usize).copied();
    let (a, b, c) = (corner(0)?, corner(1)?, corner(2)?);
    let edges = [b - a, c - b, a - c];
    // Unit edges first: their product neither underflows nor overflows.
    let [ab, bc, ca] =
        [edges[0].try_normalize()?, edges[1].try_normalize()?, edges[2].try_normalize()?];
    let normal = [ab.cross(-ca), bc.cross(-ab), ca.cross(-bc)]
        .into_iter()
        .fold(DVec3::ZERO, |a, b| if b.length_squared() > a.length_squared() { b } else { a });
    // Thinner than this, the direction is rounding.
    let has_area = normal.length_squared() > 1e-24;
    if !has_area {
        return None;
    }
    let angle = |u: DVec3, v: DVec3| u.cross(v).length().atan2(u.dot(v)) as f32;
    Some((normal.normalize_or_zero().as_vec3(), [angle(ab, -ca), angle(bc, -ab), angle(ca, -bc)]))
}

/// The corners around each place: corner `3 t + i` is the `i`-th of triangle `t`.
struct Fans {
    /// Start of each position's corners in `corners`; one more at the end.
    starts: Vec<u32>,
    corners: Vec<u32>,
}

impl Fans {
    fn of(mesh: &Mesh, faces: &Faces) -> Self {
        let places = weld(&mesh.positions);
        let place_count = places.iter().max().map_or(0, |&last| last as usize + 1);
        let place_of = |corner: usize| {
            let vertex = mesh.triangles[corner / 3][corner % 3];
            places.get(vertex as usize).map(|&place| place as usize)
        };
        let corner_count = 3 * faces.normals.len();
        let mut starts = vec![0u32; place_count + 1];
        for place in (0..corner_count).filter_map(place_of) {
            starts[place + 1] += 1;
        }
        for place in 0..place_count {
            starts[place + 1] += starts[place];
        }
        let mut next = starts.clone();
        let mut corners = vec![0; starts[place_count] as usize];
        for corner in 0..corner_count {
            if let Some(place) = place_of(corner) {
                corners[next[place] as usize] = corner as u32;
                next[place] += 1;
            }
        }
        Self { starts, corners }
    }

    fn iter(&self) -> impl IndexedParallelIterator<Item = &[u32]> {
        self.starts.par_windows(2).map(|range| &self.corners[range[0] as usize..range[1] as usize])
    }
}

/// A fast hash of a few words: positions are spread by multiplication, no attacker gains by
/// collisions more than time that the vertex limit bounds.
#[derive(Default)]
pub(super) struct WordHasher(u64);

impl Hasher for WordHasher {
    fn write(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|&byte| self.write_u64(byte.into()));
    }

    fn write_u64(&mut self, word: u64) {
        let mixed = u128::from(self.0 ^ word ^ 0x243f_6a88_85a3_08d3)
            * u128::from(0x9e37_79b9_7f4a_7c15u64);
        self.0 = (mixed ^ mixed >> 64) as u64;
    }

    fn write_u32(&mut self, word: u32) {
        self.write_u64(word.into());
    }

    fn write_i32(&mut self, word: i32) {
        self.write_u64(word as u64);
    }

    fn finish(&self) -> u64 {
        self.0
    }
}

pub(super) type WordMap<K, V> = HashMap<K, V, BuildHasherDefault<WordHasher>>;

/// The place of each vertex: vertices with equal positions share one.
pub(super) fn weld(positions: &[DVec3]) -> Vec<u32> {
    let mut places: WordMap<(u64, u64, u64), u32> =
        WordMap::with_capacity_and_hasher(positions.len(), BuildHasherDefault::default());
    positions
        .iter()
        .map(|position| {
            // Adding zero makes −0 equal to 0.
            let bits = (*position + 0.0).to_array().map(f64::to_bits);
            let next = places.len() as u32;
            *places.entry((bits[0], bits[1], bits[2])).or_insert(next)
        })
        .collect()
}

/// The normal of each corner, zero where there is none.
fn corner_normals(faces: &Faces, fans: &Fans, crease_cosine: f64) -> Vec<Vec3> {
    let sums: Vec<Vec<Vec3>> = fans
        .iter()
        .with_min_len(1024)
        .map(|fan| {
            if fan.len() <= MAX_PAIRWISE || crease_cosine < -1.0 {
                fan_normals(faces, fan, crease_cosine)
            } else {
                large_fan_normals(faces, fan, crease_cosine)
            }
        })
        .collect();
    let mut normals = vec![Vec3::ZERO; 3 * faces.normals.len()];
    for (&corner, normal) in fans.corners.iter().zip(sums.into_iter().flatten()) {
        normals[corner as usize] = normal;
    }
    normals
}

/// A triangle's normal, and the same weighted with the angle at a corner.
fn contribution(faces: &Faces, corner: u32) -> (DVec3, DVec3) {
    let (face, at) = (corner as usize / 3, corner as usize % 3);
    // Stored in f32 for memory; the cosine of a crease needs its length to be 1 more exactly.
    let normal = faces.normals[face].as_dvec3().normalize_or_zero();
    (normal, normal * f64::from(faces.angles[face][at]))
}

fn unit(sum: DVec3) -> Vec3 {
    sum.try_normalize().unwrap_or(DVec3::ZERO).as_vec3()
}

fn fan_normals(faces: &Faces, fan: &[u32], crease_cosine: f64) -> Vec<Vec3> {
    let parts: Vec<(DVec3, DVec3)> =
        fan.iter().map(|&corner| contribution(faces, corner)).collect();
    let total: DVec3 = parts.iter().map(|part| part.1).sum();
    let all_smooth = crease_cosine < -1.0;
    let whole = unit(total);
    parts
        .iter()
        .map(|&(own, _)| {
            if all_smooth || own == DVec3::ZERO {
                return whole;
            }
            let near = parts.iter().filter(|(other, _)| own.dot(*other) >= crease_cosine);
            let sum = unit(near.map(|part| part.1).sum());
            if sum == Vec3::ZERO { own.as_vec3() } else { sum }
        })
        .collect()
}

/// Does the same for a fan with very many triangles, whose normals are summed by direction first.
fn large_fan_normals(faces: &Faces, fan: &[u32], crease_cosine: f64) -> Vec<Vec3> {
    let mut slots: WordMap<(i32, i32, i32), usize> = WordMap::default();
    // The first normal of each direction, and the weighted sum of all of them.
    let mut directions: Vec<(DVec3, DVec3)> = Vec::new();
    let slot_of_corner: Vec<Option<usize>> = fan
        .iter()
        .map(|&corner| {
            let (normal, weighted) = contribution(faces, corner);
            if normal == DVec3::ZERO {
                return None;
            }
            let cell = (normal * 64.0).round().as_ivec3();
            let slot = *slots.entry((cell.x, cell.y, cell.z)).or_insert_with(|| {
                directions.push((normal, DVec3::ZERO));
                directions.len() - 1
            });
            directions[slot].1 += weighted;
            Some(slot)
        })
        .collect();
    let whole = unit(directions.iter().map(|direction| direction.1).sum());
    let smooth: Vec<Vec3> = directions
        .iter()
        .map(|&(own, _)| {
            let near = directions.iter().filter(|(other, _)| own.dot(*other) >= crease_cosine);
            let sum = unit(near.map(|direction| direction.1).sum());
            if sum == Vec3::ZERO { own.as_vec3() } else { sum }
        })
        .collect();
    slot_of_corner.into_iter().map(|slot| slot.map_or(whole, |slot| smooth[slot])).collect()
}

/// Writes corner normals to the vertices, splitting those whose corners differ.
fn assign(mesh: &mut Mesh, corners: &[Vec3]) {
    let given = mesh.normals.take();
    let original = mesh.positions.len();
    let mut normals = given.clone().unwrap_or_else(|| vec![Vec3::ZERO; original]);
    let mut is_taken = vec![false; original];
    let mut copies: WordMap<(u32, i32, i32, i32), u32> = WordMap::default();
    let rounded = |normal: Vec3| (normal / NORMAL_STEP).round().as_ivec3();
    for (corner, &normal) in corners.iter().enumerate() {
        let slot = &mut mesh.triangles[corner / 3][corner % 3];
        let vertex = *slot as usize;
        let is_given = given.as_ref().and_then(|g| g.get(vertex)).is_some_and(|n| *n != Vec3::ZERO);
        if vertex >= original || is_given || normal == Vec3::ZERO {
            continue;
        }
        let cell = rounded(normal);
        if !is_taken[vertex] {
            is_taken[vertex] = true;
            normals[vertex] = normal;
        } else if rounded(normals[vertex]) != cell {
            let Ok(next) = u32::try_from(mesh.positions.len()) else { continue };
            let copy = *copies.entry((*slot, cell.x, cell.y, cell.z)).or_insert(next);
            if copy == next {
                mesh.positions.push(mesh.positions[vertex]);
                normals.push(normal);
                if let Some(colors) = &mut mesh.colors {
                    colors.extend(colors.get(vertex).copied());
                }
                if let Some(uvs) = &mut mesh.uvs {
                    uvs.extend(uvs.get(vertex).copied());
                }
            }
            *slot = copy;
        }
    }
    mesh.normals = Some(normals);
}

#[cfg(test)]
mod tests;
