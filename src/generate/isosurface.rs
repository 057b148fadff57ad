//! Meshing the zero set of a signed distance function (naive surface nets, Gibson 1998).
//!
//! Space is divided into cubic cells. Each cell whose corners differ in sign gets a vertex, moved onto the surface. Each grid
//! edge whose ends differ in sign gets an outward-facing quad of the four cells around it. Each mesh edge is therefore used once
//! in each direction, which makes the mesh watertight by construction. Cells are processed in blocks of 8³. Only blocks that the
//! surface may touch are evaluated, in parallel and in a fixed order.

use glam::DVec3;
use rayon::prelude::*;

use crate::math::Bounds;

/// Cells along a block's edge.
const BLOCK: usize = 8;
const CORNERS: usize = BLOCK + 1;

/// Vertices and outward-facing triangles.
#[derive(Clone, Debug, Default)]
pub struct Isosurface {
    pub positions: Vec<DVec3>,
    pub triangles: Vec<[u32; 3]>,
}

struct Lattice {
    min: DVec3,
    cell: f64,
    /// Number of blocks along each axis.
    blocks: [usize; 3],
}

impl Lattice {
    fn corner(&self, index: [i64; 3]) -> DVec3 {
        self.min + DVec3::from_array(index.map(|i| i as f64)) * self.cell
    }

    fn block_index(&self, block: [i64; 3]) -> Option<usize> {
        let inside = |(&b, &count): (&i64, &usize)| b >= 0 && b < count as i64;
        if !block.iter().zip(&self.blocks).all(inside) {
            return None;
        }
        let [x, y, z] = block.map(|b| b as usize);
        Some((z * self.blocks[1] + y) * self.blocks[0] + x)
    }

    fn block_of(&self, index: usize) -> [i64; 3] {
        let [nx, ny, _] = self.blocks;
        [(index % nx) as i64, (index / nx % ny) as i64, (index / nx / ny) as i64]
    }
}

/// A block that the surface may touch, with the values at its corners and a vertex for each cell that the surface crosses.
struct Active {
    origin: [i64; 3],
    values: Vec<f64>,
    /// Cells with a vertex, in order, and the vertex.
    crossed: Vec<(usize, DVec3)>,
}

impl Active {
    fn value(&self, x: usize, y: usize, z: usize) -> f64 {
        self.values[(z * CORNERS + y) * CORNERS + x]
    }
}

/// Meshes `{p : distance(p) = 0}` within `bounds` with cells of edge `cell`. `distance` is negative inside. It may overestimate
/// the true distance by up to a half.
pub fn isosurface(
    distance: &(dyn Fn(DVec3) -> f64 + Sync),
    bounds: Bounds,
    cell: f64,
) -> Isosurface {
    let padded = bounds.extent() + 4.0 * cell;
    let blocks = padded.to_array().map(|e| (e / (cell * BLOCK as f64)).ceil().max(1.0) as usize);
    let lattice = Lattice { min: bounds.min - 2.0 * cell, cell, blocks };
    let count = blocks.iter().product::<usize>();
    let reach = 1.5 * 0.5 * 3f64.sqrt() * cell * CORNERS as f64;
    let active: Vec<Active> = (0..count)
        .into_par_iter()
        .filter_map(|index| {
            let origin = lattice.block_of(index).map(|b| b * BLOCK as i64);
            let middle = lattice.corner(origin) + 0.5 * cell * BLOCK as f64;
            (distance(middle).abs() <= reach).then(|| evaluate(distance, &lattice, origin))
        })
        .collect();
    connect(&lattice, &active)
}

fn evaluate(distance: &dyn Fn(DVec3) -> f64, lattice: &Lattice, origin: [i64; 3]) -> Active {
    let mut values = Vec::with_capacity(CORNERS * CORNERS * CORNERS);
    for z in 0..CORNERS as i64 {
        for y in 0..CORNERS as i64 {
            for x in 0..CORNERS as i64 {
                let corner = [origin[0] + x, origin[1] + y, origin[2] + z];
                values.push(distance(lattice.corner(corner)));
            }
        }
    }
    let mut active = Active { origin, values, crossed: Vec::new() };
    for index in 0..BLOCK * BLOCK * BLOCK {
        if let Some(vertex) = vertex(distance, lattice, &active, index) {
            active.crossed.push((index, vertex));
        }
    }
    active
}

/// The vertex of a cell: the mean of its edges' crossings, pulled onto the surface within the cell.
fn vertex(
    distance: &dyn Fn(DVec3) -> f64,
    lattice: &Lattice,
    active: &Active,
    index: usize,
) -> Option<DVec3> {
    let [x, y, z] = [index % BLOCK, index / BLOCK % BLOCK, index / BLOCK / BLOCK];
    let value =
        |corner: usize| active.value(x + (corner & 1), y + (corner >> 1 & 1), z + (corner >> 2));
    let (mut sum, mut crossings) = (DVec3::ZERO, 0.0);
    for corner in 0..8 {
        for axis in 0..3 {
            let other = corner | 1 << axis;
            if other == corner {
                continue;
            }
            let (a, b) = (value(corner), value(other));
            if (a < 0.0) == (b < 0.0) {
                continue;
            }
            let mut p = [0, 1, 2].map(|bit| (corner >> bit & 1) as f64);
            p[axis] = a / (a - b);
            sum += DVec3::from_array(p);
            crossings += 1.0;
        }
    }
    if crossings == 0.0 {
        return None;
    }
    let [ox, oy, oz] = active.origin;
    let base = lattice.corner([ox + x as i64, oy + y as i64, oz + z as i64]);
    let mut p = base + sum / crossings * lattice.cell;
    for _ in 0..2 {
        let step = gradient(distance, p, 0.25 * lattice.cell) * distance(p);
        let margin = 0.05 * lattice.cell;
        p = (p - step).clamp(base + margin, base + lattice.cell - margin);
    }
    Some(p)
}

/// The unit vector in which `distance` grows fastest, or zero if it does not grow.
pub fn gradient(distance: &dyn Fn(DVec3) -> f64, p: DVec3, step: f64) -> DVec3 {
    let along = |axis: DVec3| distance(p + axis * step) - distance(p - axis * step);
    let g = DVec3::new(along(DVec3::X), along(DVec3::Y), along(DVec3::Z));
    let length = g.length();
    if length > 1e-300 { g / length } else { DVec3::ZERO }
}

/// Numbers the vertices and connects them by quads.
fn connect(lattice: &Lattice, active: &[Active]) -> Isosurface {
    const NONE: u32 = u32::MAX;
    let mut mesh = Isosurface::default();
    let mut slot_of_block = vec![NONE; lattice.blocks.iter().product()];
    let mut vertices: Vec<Vec<u32>> = Vec::with_capacity(active.len());
    for (slot, block) in active.iter().enumerate() {
        let mut numbers = vec![NONE; BLOCK * BLOCK * BLOCK];
        for &(cell, p) in &block.crossed {
            numbers[cell] = mesh.positions.len() as u32;
            mesh.positions.push(p);
        }
        vertices.push(numbers);
        if let Some(index) = lattice.block_index(block.origin.map(|o| o / BLOCK as i64)) {
            slot_of_block[index] = slot as u32;
        }
    }
    let number = |cell: [i64; 3]| -> Option<u32> {
        let block = lattice.block_index(cell.map(|c| c.div_euclid(BLOCK as i64)))?;
        let numbers = vertices.get(slot_of_block[block] as usize)?;
        let [x, y, z] = cell.map(|c| c.rem_euclid(BLOCK as i64) as usize);
        let found = numbers[(z * BLOCK + y) * BLOCK + x];
        (found != NONE).then_some(found)
    };
    for block in active {
        for index in 0..BLOCK * BLOCK * BLOCK {
            let at = [index % BLOCK, index / BLOCK % BLOCK, index / BLOCK / BLOCK];
            let here = block.value(at[0], at[1], at[2]) < 0.0;
            for axis in 0..3 {
                let mut end = at;
                end[axis] += 1;
                if here == (block.value(end[0], end[1], end[2]) < 0.0) {
                    continue;
                }
                let cell = [0, 1, 2].map(|i| block.origin[i] + at[i] as i64);
                let (b, c) = ((axis + 1) % 3, (axis + 2) % 3);
                let around = [(1, 1), (0, 1), (0, 0), (1, 0)].map(|(db, dc)| {
                    let mut other = cell;
                    other[b] -= db;
                    other[c] -= dc;
                    number(other)
                });
                if let [Some(p), Some(q), Some(r), Some(s)] = around {
                    let quad = if here { [p, q, r, s] } else { [s, r, q, p] };
                    push_quad(&mut mesh, quad);
                }
            }
        }
    }
    mesh
}

/// Adds a quad as two triangles, split along the shorter diagonal.
fn push_quad(mesh: &mut Isosurface, [p, q, r, s]: [u32; 4]) {
    let at = |index: u32| mesh.positions[index as usize];
    let split = if (at(p) - at(r)).length_squared() <= (at(q) - at(s)).length_squared() {
        [[p, q, r], [p, r, s]]
    } else {
        [[p, q, s], [q, r, s]]
    };
    mesh.triangles.extend(split);
}

#[cfg(test)]
pub(super) mod tests {
    use std::collections::HashMap;

    use super::*;

    /// Panics unless every edge is used equally often in both directions.
    pub fn assert_watertight(triangles: &[[u32; 3]]) {
        let mut balance: HashMap<(u32, u32), i64> = HashMap::new();
        for &[a, b, c] in triangles {
            assert!(a != b && b != c && c != a, "degenerate triangle");
            for (from, to) in [(a, b), (b, c), (c, a)] {
                *balance.entry((from.min(to), from.max(to))).or_default() +=
                    if from < to { 1 } else { -1 };
            }
        }
        assert!(balance.values().all(|&n| n == 0), "an edge without its opposite");
    }

    /// The volume enclosed by outward-facing triangles.
    pub fn volume(positions: &[DVec3], triangles: &[[u32; 3]]) -> f64 {
        triangles
            .iter()
            .map(|t| {
                let [a, b, c] = t.map(|i| positions[i as usize]);
                a.dot(b.cross(c)) / 6.0
            })
            .sum()
    }

    #[test]
    fn a_torus_is_watertight_outward_and_of_the_right_volume() {
        let torus = |p: DVec3| {
            let ring = (p.x * p.x + p.z * p.z).sqrt() - 1.0;
            (ring * ring + p.y * p.y).sqrt() - 0.4
        };
        let bounds = Bounds { min: DVec3::new(-1.4, -0.4, -1.4), max: DVec3::new(1.4, 0.4, 1.4) };
        let mesh = isosurface(&torus, bounds, 0.05);
        assert_watertight(&mesh.triangles);
        let exact = 2.0 * std::f64::consts::PI.powi(2) * 0.16;
        let found = volume(&mesh.positions, &mesh.triangles);
        assert!((found / exact - 1.0).abs() < 0.01, "{found} {exact}");
        // Euler's characteristic of a torus is 0: V − E + F with E = 3F/2.
        assert_eq!(2 * mesh.positions.len(), mesh.triangles.len());
        assert!(mesh.positions.iter().all(|&p| torus(p).abs() < 0.005));
    }
}
