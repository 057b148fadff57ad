//! Sharp edges and borders of a mesh, and which of them lie near a place.

use glam::{DVec2, DVec3, IVec3};

use super::super::crease::{WordMap, weld};
use super::super::kernels::tangents;
use super::{FACING, Face};
use crate::assets::Mesh;

/// Edges farther above or below a tangent plane than this part of the disk's radius belong to another sheet.
const SHEET: f64 = 0.3;
/// Planes that meet at a flatter angle (its sine) give no good line: the edge itself does.
const FLAT: f64 = 0.3;

/// One face's side of a sharp edge or border.
#[derive(Clone, Copy, Debug)]
struct Side {
    ends: [DVec3; 2],
    /// Welded vertices.
    places: [u32; 2],
    normal: DVec3,
    /// Along the face, away from the edge.
    inward: DVec3,
    /// Normal of the face beyond, if there is just one.
    beyond: Option<DVec3>,
}

/// An edge as a sample sees it in its tangent plane, whose axes are those of its kernel.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sharp {
    pub ends: [DVec2; 2],
    pub places: [u32; 2],
    /// Keeps what lies where `normal · x ≥ offset`.
    pub normal: DVec2,
    pub offset: f64,
    pub distance: f64,
}

/// The sides in cells of twice a disk's radius.
pub(super) struct Edges {
    sides: Vec<Side>,
    cells: WordMap<(i32, i32, i32), Vec<u32>>,
    origin: DVec3,
    size: f64,
}

impl Edges {
    /// # Errors
    /// The number of disks along all edges, where it is far over the limit.
    pub(super) fn of(
        mesh: &Mesh,
        faces: &[Face],
        crease_cosine: f64,
        radius: f64,
        limit: u64,
    ) -> Result<Self, f64> {
        let sides = sides_of(mesh, faces, crease_cosine);
        let length: f64 = sides.iter().map(|side| side.ends[0].distance(side.ends[1])).sum();
        if length / radius > 8.0 * limit as f64 {
            return Err(length / radius);
        }
        let origin = faces.first().map_or(DVec3::ZERO, |face| face.corners[0]);
        let mut edges = Self { sides, cells: WordMap::default(), origin, size: 2.0 * radius };
        for index in 0..edges.sides.len() {
            let [a, b] = edges.sides[index].ends;
            let steps = (a.distance(b) / (0.5 * radius)).ceil().max(1.0) as u32;
            let mut last = None;
            for step in 0..=steps {
                let cell = edges.cell(a.lerp(b, f64::from(step) / f64::from(steps)));
                if last != Some(cell) {
                    let list = edges.cells.entry((cell.x, cell.y, cell.z)).or_default();
                    list.push(index as u32);
                    last = Some(cell);
                }
            }
        }
        Ok(edges)
    }

    fn cell(&self, point: DVec3) -> IVec3 {
        ((point - self.origin) / self.size).floor().as_ivec3()
    }

    /// The sides that a disk crosses, nearest first, in the plane of `tangents(normal)`.
    pub(super) fn near(&self, point: DVec3, normal: DVec3, radius: f64, found: &mut Vec<Sharp>) {
        found.clear();
        if self.sides.is_empty() {
            return;
        }
        let axes = tangents(normal.as_vec3()).map(|axis| axis.as_dvec3());
        let cell = self.cell(point);
        let mut seen: Vec<u32> = Vec::new();
        for index in 0..27 {
            let step = IVec3::new(index % 3 - 1, index / 3 % 3 - 1, index / 9 - 1);
            let at = cell.saturating_add(step);
            seen.extend(self.cells.get(&(at.x, at.y, at.z)).into_iter().flatten());
        }
        seen.sort_unstable();
        seen.dedup();
        let sides = seen.iter().filter_map(|&index| self.sides.get(index as usize));
        found.extend(sides.filter_map(|side| side.seen_from(point, normal, axes, radius)));
        found.sort_by(|a, b| a.distance.total_cmp(&b.distance));
    }
}

impl Side {
    fn seen_from(
        &self,
        point: DVec3,
        normal: DVec3,
        axes: [DVec3; 2],
        radius: f64,
    ) -> Option<Sharp> {
        if self.normal.dot(normal) < FACING {
            return None;
        }
        let flat = |d: DVec3| DVec2::new(d.dot(axes[0]), d.dot(axes[1]));
        let [a, b] = self.ends.map(|end| flat(end - point));
        let along = b - a;
        let part = (-a.dot(along) / along.length_squared().max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
        let distance = (a + along * part).length();
        let nearest = self.ends[0].lerp(self.ends[1], part);
        if distance >= radius || (nearest - point).dot(normal).abs() > SHEET * radius {
            return None;
        }
        let inward = flat(self.inward);
        let toward = |line: DVec2| if line.dot(inward) < 0.0 { -line } else { line };
        // The edge itself, projected.
        let straight = toward(along.perp().try_normalize()?);
        let mut line = (straight, straight.dot(a));
        // The tangent plane meets the plane beyond (Zwicker 2004, Fig. 4); on flat faces it is the same.
        if let Some(beyond) = self.beyond {
            let across = flat(beyond);
            let sine = across.length();
            if sine > FLAT {
                let meets = toward(across / sine);
                let side = if meets.dot(across) < 0.0 { -1.0 } else { 1.0 };
                let offset = side * (self.ends[0] - point).dot(beyond) / sine;
                let off = (meets.dot(a + along * part) - offset).abs();
                if off < 0.1 * radius && meets.dot(straight) > 0.9 {
                    line = (meets, offset);
                }
            }
        }
        Some(Sharp { ends: [a, b], places: self.places, normal: line.0, offset: line.1, distance })
    }
}

/// All sides of all edges that are sharp, open, or shared by more than two faces.
fn sides_of(mesh: &Mesh, faces: &[Face], crease_cosine: f64) -> Vec<Side> {
    let places = weld(&mesh.positions);
    // Edges by their places: the face, which of its corners is first, and whether the direction is the key's.
    let mut users: Vec<([u32; 2], u32, u8, bool)> = Vec::with_capacity(3 * faces.len());
    for (index, face) in (0u32..).zip(faces) {
        let corners = mesh.triangles[face.triangle as usize];
        for first in 0..3u8 {
            let [a, b] = [first, (first + 1) % 3]
                .map(|i| places.get(corners[usize::from(i)] as usize).copied().unwrap_or(u32::MAX));
            users.push(([a.min(b), a.max(b)], index, first, a < b));
        }
    }
    users.sort_unstable();
    let mut sides = Vec::new();
    for users in users.chunk_by(|a, b| a.0 == b.0) {
        let beyond = match users {
            [_] => [None; 2],
            [one, two] => {
                let [a, b] = [one, two].map(|user| faces[user.1 as usize].normal);
                // Faces that go round the same way meet an edge in opposite directions.
                let turn = if one.3 == two.3 { -1.0 } else { 1.0 };
                // A fold flat upon itself is sharp whatever its faces' order.
                if a.dot(b) * turn >= crease_cosine - 1e-9 {
                    continue;
                }
                [Some(b * turn), Some(a * turn)]
            }
            _ => [None; 2],
        };
        for (place, &(places, face, first, _)) in users.iter().enumerate() {
            let face = &faces[face as usize];
            let first = usize::from(first);
            let [a, b, c] = [0, 1, 2].map(|i| face.corners[(first + i) % 3]);
            let inward = face.normal.cross(b - a).normalize_or_zero();
            let inward = if inward.dot(c - a) < 0.0 { -inward } else { inward };
            let ordered = if users[place].3 { [a, b] } else { [b, a] };
            sides.push(Side {
                ends: ordered,
                places,
                normal: face.normal,
                inward,
                beyond: beyond.get(place).copied().flatten(),
            });
        }
    }
    sides
}
