//! A triangle on the grid of the axis along which it appears largest.

use std::ops::Range;

use glam::{DVec2, DVec3, Vec3};

use super::AGREES;
use crate::assets::Mesh;

/// Where the grid begins below the mesh's bounds, in cells: so little that what is made of whole cells needs no more than
/// these, and so unlike a fraction that no model's own raster falls on the centres of cells.
const BEFORE: DVec3 = DVec3::new(3.819_660e-3, 2.928_932e-3, 3.542_487e-3);
/// Relative tolerance between two equally good axes: the later one is taken, so that rounding decides nothing.
const TIE: f64 = 1e-6;
/// Height over length of the flattest triangle whose normal is more than rounding.
const FLATTEST: f64 = 1e-12;
/// Maximum error of a division, in cells; the edges' sides then decide.
const SLACK: f64 = 1e-3;

/// A sample, in cells of the grid.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sample {
    pub at: DVec3,
    pub normal: Vec3,
    pub triangle: u32,
    /// Along which its triangle is seen.
    pub axis: u8,
}

/// Three grids of cubic cells with one origin, each for one axis: what is seen along the axis.
#[derive(Clone, Copy, Debug)]
pub(super) struct Grid {
    origin: DVec3,
    /// Side of a cell in mesh units.
    pub spacing: f64,
}

impl Grid {
    /// The grid of a mesh with this lower corner.
    pub(super) fn new(low: DVec3, spacing: f64) -> Self {
        Self { origin: low - BEFORE * spacing, spacing }
    }

    fn cells_from_mesh(&self, place: DVec3) -> DVec3 {
        (place - self.origin) / self.spacing
    }

    /// About how many cells the outline of a triangle crosses, at most.
    pub(super) fn parts(&self, [a, b, c]: [DVec3; 3]) -> f64 {
        2.0 * (a.max(b).max(c) - a.min(b).min(c)).element_sum() / self.spacing + 4.0
    }

    pub(super) fn mesh_from_cells(&self, place: DVec3) -> DVec3 {
        self.origin + place * self.spacing
    }
}

/// The corners of a triangle, if they exist and are finite.
pub(super) fn corners(mesh: &Mesh, triangle: [u32; 3]) -> Option<[DVec3; 3]> {
    let corner = |index: u32| mesh.positions.get(index as usize).filter(|p| p.is_finite()).copied();
    let [a, b, c] = triangle;
    Some([corner(a)?, corner(b)?, corner(c)?])
}

/// Coordinates across an axis, then along it; right-handed like the original ones.
pub(super) fn along(axis: u8, place: DVec3) -> DVec3 {
    match axis {
        0 => DVec3::new(place.y, place.z, place.x),
        1 => DVec3::new(place.z, place.x, place.y),
        _ => place,
    }
}

/// The inverse of [`along`].
fn back(axis: u8, local: DVec3) -> DVec3 {
    match axis {
        0 => DVec3::new(local.z, local.x, local.y),
        1 => DVec3::new(local.y, local.z, local.x),
        _ => local,
    }
}

/// A side of a triangle as its axis sees it, from the lesser end to the greater: both triangles that share it find the
/// same numbers.
#[derive(Clone, Copy, Debug)]
struct Edge {
    start: DVec2,
    run: DVec2,
    /// The triangle is on the left.
    is_left: bool,
}

impl Edge {
    fn new(a: DVec2, b: DVec2, is_left: bool) -> Self {
        let in_order = (a.x, a.y) <= (b.x, b.y);
        let (start, end) = if in_order { (a, b) } else { (b, a) };
        Self { start, run: end - start, is_left: is_left == in_order }
    }

    /// Positive to the left: twice the area that the edge spans with a place.
    fn left_of(&self, at: DVec2) -> f64 {
        self.run.x * (at.y - self.start.y) - self.run.y * (at.x - self.start.x)
    }

    /// A place on the edge is the left triangle's. As edges run to greater x, or straight to greater y, that is as if all
    /// places lay a little higher, and very much less to the left: at a corner, too, just one triangle has it.
    fn is_inside(&self, at: DVec2) -> bool {
        (self.left_of(at) >= 0.0) == self.is_left
    }

    fn weight(&self, at: DVec2) -> f64 {
        let left = self.left_of(at);
        if self.is_left { left.max(0.0) } else { (-left).max(0.0) }
    }
}

/// A triangle, in cells of the grid.
#[derive(Clone, Copy, Debug)]
pub(super) struct Facet {
    pub triangle: u32,
    pub axis: u8,
    /// Unit length, in the mesh's axes.
    pub normal: DVec3,
    /// Corners in the axis's coordinates ([`along`]).
    corners: [DVec3; 3],
    /// Each opposite to its corner.
    edges: [Edge; 3],
    /// Normals of the corners, if the face agrees with them.
    smooth: Option<[Vec3; 3]>,
    /// Depth over distance across.
    slope: DVec2,
    low: DVec2,
    high: DVec2,
}

impl Facet {
    /// A triangle of a mesh, if it has a place and an area.
    pub(super) fn of(mesh: &Mesh, grid: &Grid, triangle: usize) -> Option<Self> {
        let indices = *mesh.triangles.get(triangle)?;
        let places = corners(mesh, indices)?.map(|corner| grid.cells_from_mesh(corner));
        let [a, b, c] = places;
        let (ab, ac) = (b - a, c - a);
        let cross = ab.cross(ac);
        let longest = ab.length_squared().max(ac.length_squared()).max(b.distance_squared(c));
        let length = cross.length();
        // Also false for what is not a number.
        if !(length > FLATTEST * longest && length.is_finite()) {
            return None;
        }
        let normal = cross / length;
        let axis = main_axis(normal);
        let seen = places.map(|place| along(axis, place));
        let flat = seen.map(DVec3::truncate);
        let across = along(axis, normal);
        let slope = -across.truncate() / across.z;
        let is_left = across.z > 0.0;
        let edge = |from: usize, to: usize| Edge::new(flat[from], flat[to], is_left);
        let smooth = mesh.normals.as_ref().and_then(|normals| {
            let of = |index: u32| {
                let own = normals.get(index as usize)?.as_dvec3().try_normalize()?;
                (own.dot(normal) >= AGREES).then(|| own.as_vec3())
            };
            Some([of(indices[0])?, of(indices[1])?, of(indices[2])?])
        });
        Some(Self {
            triangle: u32::try_from(triangle).ok()?,
            axis,
            normal,
            corners: seen,
            edges: [edge(1, 2), edge(2, 0), edge(0, 1)],
            smooth,
            slope,
            low: flat[0].min(flat[1]).min(flat[2]),
            high: flat[0].max(flat[1]).max(flat[2]),
        })
    }

    /// Area as the axis sees it, in cells.
    pub(super) fn cells(&self) -> f64 {
        let [a, b, c] = self.corners.map(DVec3::truncate);
        0.5 * (b - a).perp_dot(c - a).abs()
    }

    /// The rows of cells that it touches.
    pub(super) fn rows(&self) -> Range<i64> {
        self.low.y.floor() as i64..(self.high.y.floor() as i64).saturating_add(1)
    }

    /// Columns of a row's cells whose centres it contains.
    pub(super) fn span(&self, row: i64) -> Range<i64> {
        let y = row as f64 + 0.5;
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        self.crossings(y, |x| (low, high) = (low.min(x), high.max(x)));
        if low > high {
            return 0..0;
        }
        let mut first = (low - 0.5 - SLACK).ceil() as i64;
        let mut end = ((high - 0.5 + SLACK).floor() as i64).saturating_add(1);
        // Along a row, rounded or not, a place passes each edge once.
        let is_outside = |column: i64| {
            let at = DVec2::new(column as f64 + 0.5, y);
            !self.edges.iter().all(|edge| edge.is_inside(at))
        };
        while first < end && is_outside(first) {
            first += 1;
        }
        while first < end && is_outside(end - 1) {
            end -= 1;
        }
        first..end
    }

    /// Columns of a row's cells that it touches.
    pub(super) fn touched(&self, row: i64) -> Range<i64> {
        let (from, to) = (row as f64, row as f64 + 1.0);
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        let mut take = |x: f64| (low, high) = (low.min(x), high.max(x));
        self.corners.iter().filter(|p| (from..=to).contains(&p.y)).for_each(|p| take(p.x));
        self.crossings(from, &mut take);
        self.crossings(to, &mut take);
        if low > high { 0..0 } else { low.floor() as i64..(high.floor() as i64).saturating_add(1) }
    }

    /// Finds the crossings of the outline with a line of constant y.
    fn crossings(&self, y: f64, mut take: impl FnMut(f64)) {
        for index in 0..3 {
            let (a, b) = (self.corners[index], self.corners[(index + 1) % 3]);
            if (a.y <= y) != (b.y <= y) {
                take(a.x + (b.x - a.x) * ((y - a.y) / (b.y - a.y)));
            }
        }
    }

    /// The sample at a cell's centre.
    pub(super) fn centre(&self, column: i64, row: i64) -> Sample {
        let at = DVec2::new(column as f64 + 0.5, row as f64 + 0.5);
        let weights = self.weights(at);
        let [a, b, c] = self.corners;
        // If rounding matters, the position is on the triangle rather than at the centre.
        let on = a * weights[0] + b * weights[1] + c * weights[2];
        self.with_normal(back(self.axis, on), weights)
    }

    /// The sample at a place of the triangle.
    pub(super) fn sample(&self, at: DVec3) -> Sample {
        self.with_normal(at, self.weights(along(self.axis, at).truncate()))
    }

    fn with_normal(&self, at: DVec3, weights: [f64; 3]) -> Sample {
        let own = self.normal.as_vec3();
        let normal = self.smooth.map_or(own, |[a, b, c]| {
            let [s, t, u] = weights.map(|weight| weight as f32);
            (a * s + b * t + c * u).try_normalize().unwrap_or(own)
        });
        Sample { at, normal, triangle: self.triangle, axis: self.axis }
    }

    /// Barycentric weights of a position, as the axis sees it.
    fn weights(&self, at: DVec2) -> [f64; 3] {
        let [a, b, c] = self.edges.map(|edge| edge.weight(at));
        let scale = (a + b + c).recip();
        if scale.is_finite() { [a * scale, b * scale, c * scale] } else { [1.0 / 3.0; 3] }
    }

    /// The corners of a rectangle, as the axis sees it, that holds what of the triangle lies in a cell; in its plane.
    pub(super) fn patch(&self, [column, row]: [i64; 2]) -> [DVec3; 4] {
        let cell = DVec2::new(column as f64, row as f64);
        let (low, high) = (self.low.max(cell), self.high.min(cell + 1.0));
        let [corner, ..] = self.corners;
        [low, DVec2::new(high.x, low.y), high, DVec2::new(low.x, high.y)].map(|at| {
            let depth = corner.z + self.slope.dot(at - corner.truncate());
            back(self.axis, at.extend(depth))
        })
    }

    /// The part of the triangle that lies in a cell.
    pub(super) fn part(&self, [column, row]: [i64; 2]) -> Part {
        let low = DVec2::new(column as f64, row as f64);
        let high = low + 1.0;
        let mut part = Part { axis: self.axis, points: [DVec3::ZERO; Part::MOST], count: 3 };
        part.points[..3].copy_from_slice(&self.corners);
        if self.low.x < low.x {
            part.cut(|p| p.x - low.x);
        }
        if self.high.x > high.x {
            part.cut(|p| high.x - p.x);
        }
        if self.low.y < low.y {
            part.cut(|p| p.y - low.y);
        }
        if self.high.y > high.y {
            part.cut(|p| high.y - p.y);
        }
        part.points[..part.count].iter_mut().for_each(|point| *point = back(self.axis, *point));
        part
    }
}

fn main_axis(normal: DVec3) -> u8 {
    let DVec3 { x, y, z } = normal.abs();
    let with = 1.0 + TIE;
    if z * with >= x.max(y) {
        2
    } else if y * with >= x {
        1
    } else {
        0
    }
}

/// A convex polygon.
pub(super) struct Part {
    axis: u8,
    points: [DVec3; Part::MOST],
    count: usize,
}

impl Part {
    /// A triangle's corners, and one more for each side of the cell; yet another where rounding bends it.
    const MOST: usize = 8;

    pub(super) fn points(&self) -> &[DVec3] {
        &self.points[..self.count]
    }

    /// Keeps what lies where `value`, which is linear, is not negative.
    fn cut(&mut self, value: impl Fn(DVec3) -> f64) {
        let (old, count) = (self.points, self.count);
        self.count = 0;
        let mut put = |point: DVec3| {
            if self.count < Self::MOST {
                self.points[self.count] = point;
                self.count += 1;
            }
        };
        for index in 0..count {
            let (a, b) = (old[index], old[(index + 1) % count]);
            let (at_a, at_b) = (value(a), value(b));
            if at_a >= 0.0 {
                put(a);
            }
            if (at_a >= 0.0) != (at_b >= 0.0) {
                put(a + (b - a) * (at_a / (at_a - at_b)));
            }
        }
    }

    /// The place nearest to the centre of a cell, which lies outside, and how far it is, as the axis sees them.
    pub(super) fn nearest(&self, [column, row]: [i64; 2]) -> (f32, DVec3) {
        let centre = DVec2::new(column as f64 + 0.5, row as f64 + 0.5);
        let mut found = (f64::INFINITY, DVec3::ZERO);
        let points = self.points();
        for (index, &start) in points.iter().enumerate() {
            let run = points[(index + 1) % points.len()] - start;
            let (flat, flat_run) =
                (along(self.axis, start).truncate(), along(self.axis, run).truncate());
            let part = (centre - flat).dot(flat_run) / flat_run.length_squared();
            let part = if part.is_finite() { part.clamp(0.0, 1.0) } else { 0.0 };
            let distance = (flat + flat_run * part).distance_squared(centre);
            if distance < found.0 {
                found = (distance, start + run * part);
            }
        }
        (found.0.sqrt() as f32, found.1)
    }
}
