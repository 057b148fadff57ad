//! Strips of quads as ribbons.

use glam::DVec3;

use super::{Edge, LineVertex, Pieces, edge, edges_of, has_area, mean_color};
use crate::bake::sample::color::Colors;

/// Longer strips are no leaves.
const MAX_TRIANGLES: usize = 64;
/// Vertices of a textured ribbon for each quad, and places across the ribbon at which the texture is looked up.
const STATIONS: usize = 4;
const ACROSS: usize = 8;
/// A texture is looked up this far from the ends of a strip, in parts of the way to the next vertex: at its very edge a repeated
/// texture shows its other side.
const INSET: f64 = 0.2;

/// A line across a strip, by the places of its ends. At a tip, both are the same place.
type Rung = [u32; 2];

/// The ribbon of a piece, or `None` if the piece is no strip or its texture shows nothing.
pub(super) fn ribbon(pieces: &Pieces, piece: &[u32], colors: &Colors) -> Option<Vec<LineVertex>> {
    if !(2..=MAX_TRIANGLES).contains(&piece.len()) {
        return None;
    }
    let rungs = Strip::of(pieces, piece)?.rungs()?;
    let rungs = if colors.is_textured() { subdivided(&rungs) } else { rungs };
    let faces: Vec<(u32, [DVec3; 3])> =
        piece.iter().map(|&triangle| (triangle, pieces.positions(triangle))).collect();
    let looked = |at: usize| {
        let is_end = at == 0 || at + 1 == rungs.len();
        let next = if at == 0 { 1 } else { at - 1 };
        let share = if is_end && colors.is_textured() { INSET } else { 0.0 };
        between(rungs[at], rungs[next], share)
    };
    let mut stations: Vec<Station> =
        (0..rungs.len()).map(|at| Station::of(rungs[at], looked(at), &faces, colors)).collect();
    // Where the texture ends before the strip does, so does the ribbon.
    let there = |station: &Station| station.color.is_some();
    let first = stations.iter().position(there)?;
    let last = stations.iter().rposition(there)?;
    stations.truncate(last + 2);
    stations.drain(..first.saturating_sub(1));
    Some(vertices(&stations))
}

fn between(from: [DVec3; 2], to: [DVec3; 2], share: f64) -> [DVec3; 2] {
    [from[0].lerp(to[0], share), from[1].lerp(to[1], share)]
}

/// Rungs with others between them.
fn subdivided(rungs: &[[DVec3; 2]]) -> Vec<[DVec3; 2]> {
    let mut all = vec![rungs[0]];
    for pair in rungs.windows(2) {
        let share = |step: usize| step as f64 / STATIONS as f64;
        all.extend((1..=STATIONS).map(|step| between(pair[0], pair[1], share(step))));
    }
    all
}

/// A vertex of a ribbon before its neighbours are known.
struct Station {
    centre: DVec3,
    /// From the centre to one side.
    half: DVec3,
    /// `None` where the texture shows nothing.
    color: Option<[u8; 4]>,
}

impl Station {
    /// `looked` is where colours are looked up for the rung `ends`.
    fn of(
        ends: [DVec3; 2],
        looked: [DVec3; 2],
        faces: &[(u32, [DVec3; 3])],
        colors: &Colors,
    ) -> Station {
        let count = if colors.is_textured() { ACROSS } else { 1 };
        let share = |step: usize| (step as f64 + 0.5) / count as f64;
        let radius = 0.5 * looked[0].distance(looked[1]) / count as f64;
        let found = (0..count).filter_map(|step| {
            let at = looked[0].lerp(looked[1], share(step));
            let nearer = |a: &&(u32, [DVec3; 3]), b: &&(u32, [DVec3; 3])| {
                depth(a.1, at).total_cmp(&depth(b.1, at))
            };
            let &(triangle, corners) = faces.iter().max_by(nearer)?;
            Some((share(step), colors.on(triangle, corners, at, radius)?))
        });
        let found: Vec<(f64, [u8; 4])> = found.collect();
        let part = found.len() as f64 / count as f64;
        let middle = found.iter().map(|(share, _)| share).sum::<f64>() / found.len().max(1) as f64;
        Station {
            centre: ends[0].lerp(ends[1], if found.is_empty() { 0.5 } else { middle }),
            half: 0.5 * part * (ends[1] - ends[0]),
            color: mean_color(found.iter().map(|&(_, color)| color)),
        }
    }
}

/// How deep inside a triangle a place is: its smallest barycentric coordinate.
fn depth(corners: [DVec3; 3], at: DVec3) -> f64 {
    let [a, b, c] = corners;
    let normal = (b - a).cross(c - a);
    let weight = |p: DVec3, q: DVec3| (p - at).cross(q - at).dot(normal);
    weight(a, b).min(weight(b, c)).min(weight(c, a)) / normal.length_squared()
}

/// The ribbon through stations, of which at least one has a colour.
fn vertices(stations: &[Station]) -> Vec<LineVertex> {
    let last = stations.len() - 1;
    // The nearest station that has a property, where one has none itself.
    let nearest = |at: usize, has: &dyn Fn(&Station) -> bool| {
        let candidates = (0..=last).filter(|&other| has(&stations[other]));
        candidates.min_by_key(|&other| other.abs_diff(at)).unwrap_or(at)
    };
    let vertex = |at: usize| {
        let station = &stations[at];
        let chord = stations[(at + 1).min(last)].centre - stations[at.saturating_sub(1)].centre;
        let tangent = chord.normalize_or_zero();
        let square = |half: DVec3| half - tangent * half.dot(tangent);
        let side = stations[nearest(at, &|other| square(other.half) != DVec3::ZERO)].half;
        let color = stations[nearest(at, &|other| other.color.is_some())].color;
        let normal = tangent.cross(square(side)).try_normalize().unwrap_or(DVec3::Z);
        LineVertex {
            position: station.centre,
            radius: square(station.half).length() as f32,
            normal: normal.as_vec3(),
            color: color.unwrap_or([255; 4]),
        }
    };
    let mut ribbon: Vec<LineVertex> = (0..=last).map(vertex).collect();
    // Neighbouring normals lie on one side of the ribbon.
    for at in 1..ribbon.len() {
        if ribbon[at].normal.dot(ribbon[at - 1].normal) < 0.0 {
            ribbon[at].normal = -ribbon[at].normal;
        }
    }
    ribbon
}

/// Triangles of a piece as a row.
struct Strip {
    /// Places and positions of the corners.
    row: Vec<([u32; 3], [DVec3; 3])>,
    /// The edges between neighbours in the row.
    crossings: Vec<Edge>,
}

impl Strip {
    /// `None` if the triangles are no row.
    fn of(pieces: &Pieces, piece: &[u32]) -> Option<Strip> {
        let corners: Vec<[u32; 3]> =
            piece.iter().map(|&triangle| pieces.corners(triangle)).collect::<Option<_>>()?;
        if !corners.iter().copied().all(has_area) {
            return None;
        }
        // There are few triangles, so each is compared with each.
        let shared = |one: usize, other: usize| {
            let edges = edges_of(corners[other]);
            edges_of(corners[one]).into_iter().find(|edge| edges.contains(edge))
        };
        let near = |at: usize| -> Vec<usize> {
            (0..piece.len()).filter(|&other| other != at && shared(at, other).is_some()).collect()
        };
        let neighbours: Vec<Vec<usize>> = (0..piece.len()).map(near).collect();
        let mut ends = (0..piece.len()).filter(|&at| neighbours[at].len() == 1);
        let (first, _, None) = (ends.next()?, ends.next()?, ends.next()) else { return None };
        if neighbours.iter().any(|near| near.len() > 2) {
            return None;
        }
        let mut order = vec![first];
        loop {
            let at = order[order.len() - 1];
            let before = order.len().checked_sub(2).map(|before| order[before]);
            match neighbours[at].iter().find(|&&next| Some(next) != before) {
                Some(&next) => order.push(next),
                None => break,
            }
        }
        let crossings =
            order.windows(2).map(|pair| shared(pair[0], pair[1])).collect::<Option<_>>()?;
        let row = order.iter().map(|&at| (corners[at], pieces.positions(piece[at]))).collect();
        Some(Strip { row, crossings })
    }

    fn position(&self, place: u32) -> Option<DVec3> {
        self.row.iter().find_map(|(corners, positions)| {
            corners.iter().position(|&corner| corner == place).map(|at| positions[at])
        })
    }

    /// The ends of the rungs from one end of the strip to the other: the shortest where there are several ways.
    fn rungs(&self) -> Option<Vec<[DVec3; 2]>> {
        let ways = if self.row.len() == 2 {
            self.quad()
        } else {
            [false, true].into_iter().filter_map(|has_tip| self.rungs_from(has_tip)).collect()
        };
        let placed = ways.into_iter().filter_map(|rungs| {
            let ends = |rung: Rung| Some([self.position(rung[0])?, self.position(rung[1])?]);
            rungs.into_iter().map(ends).collect::<Option<Vec<_>>>()
        });
        let length = |rungs: &[[DVec3; 2]]| -> f64 {
            rungs.iter().map(|ends| ends[0].distance(ends[1])).sum()
        };
        placed.min_by(|one, other| length(one).total_cmp(&length(other)))
    }

    /// The two ways through a single quad.
    fn quad(&self) -> Vec<Vec<Rung>> {
        let (p, q) = self.crossings[0];
        let apexes = [apex(self.row[0].0, (p, q)), apex(self.row[1].0, (p, q))];
        let [Some(r), Some(s)] = apexes else { return Vec::new() };
        vec![vec![[r, p], [q, s]], vec![[r, q], [p, s]]]
    }

    /// The rungs of a strip whose first triangle is a tip, or belongs to a quad.
    fn rungs_from(&self, has_tip: bool) -> Option<Vec<Rung>> {
        let (mut rungs, mut at) = if has_tip {
            let (a, b) = self.crossings[0];
            let tip = apex(self.row[0].0, (a, b))?;
            (vec![[tip; 2], [a, b]], 1)
        } else {
            let (a, b) = *self.crossings.get(1)?;
            let mut first = self.row[0].0.into_iter().chain(self.row[1].0);
            let first: Vec<u32> =
                first.by_ref().filter(|&place| place != a && place != b).collect();
            // The diagonal ends at one of the two, which is there twice.
            let one = *first.first()?;
            (vec![[one, first.into_iter().find(|&other| other != one)?]], 0)
        };
        while let Some(&(corners, _)) = self.row.get(at) {
            let [x, y] = rungs[rungs.len() - 1];
            let third = apex(corners, edge(x, y))?;
            let Some(&(next, _)) = self.row.get(at + 1) else {
                rungs.push([third; 2]);
                break;
            };
            let diagonal = self.crossings[at];
            let fourth = apex(next, diagonal)?;
            let exit = match diagonal {
                diagonal if diagonal == edge(third, x) => [fourth, third],
                diagonal if diagonal == edge(third, y) => [third, fourth],
                _ => return None,
            };
            if self.crossings.get(at + 1).is_some_and(|&next| next != edge(exit[0], exit[1])) {
                return None;
            }
            rungs.push(exit);
            at += 2;
        }
        Some(rungs)
    }
}

/// The corner of a triangle that is not on one of its edges; `None` if the edge is none of the triangle's.
fn apex(corners: [u32; 3], edge: Edge) -> Option<u32> {
    let [a, b, c] = corners;
    edges_of(corners).into_iter().zip([c, a, b]).find(|&(own, _)| own == edge).map(|(_, apex)| apex)
}
