//! Rows of rings as tubes.
//!
//! Rings are peeled off a piece from one end to the other. Where that fails, for example because the file's digits have merged corners of
//! thin rings, the corners are clustered by the lengths of edges, as in the paper.

use std::collections::{BTreeMap, BTreeSet};
use std::f64::consts::TAU;

use glam::{DVec3, Vec3};

use super::{Groups, LineVertex, Pieces, WordMap, edges_of, has_area, mean_color};
use crate::bake::sample::color::Colors;

/// The farthest corner of a ring from its centre is at most this many times as far as the nearest one.
const ROUNDNESS: f64 = 1.6;
/// A tube is at least so many times as long as its largest radius. A ball's rings are a row as well.
const SLENDERNESS: f64 = 3.0;
/// At a closed piece, so many vertices are tried as tips.
const MAX_TRIES: usize = 32;
/// The shortest edge along a branch is at least so many times as long as the longest edge of its rings, where corners are clustered.
const CLUSTER_GAP: f64 = 2.0;

/// The tube of a piece, or `None` if the piece is no row of rings. The radius of a vertex is that of the circle whose perimeter is its
/// ring's: it has the ring's mean width.
pub(super) fn tube(pieces: &Pieces, piece: &[u32], colors: &Colors) -> Option<Vec<LineVertex>> {
    let net = Net::of(pieces, piece)?;
    let rings = net.rings().or_else(|| net.clusters())?;
    let mut tube = Vec::with_capacity(rings.len());
    for ring in &rings {
        tube.push(net.vertex(ring, pieces.thin, colors)?);
    }
    // A round end reaches as far beyond its vertex as the tube is thick. A tip that is nearer needs no vertex.
    let is_within = |tip: &LineVertex, next: &LineVertex| {
        tip.radius == 0.0 && tip.position.distance(next.position) <= f64::from(next.radius)
    };
    if tube.len() > 2 && is_within(&tube[tube.len() - 1], &tube[tube.len() - 2]) {
        tube.pop();
    }
    if tube.len() > 2 && is_within(&tube[0], &tube[1]) {
        tube.remove(0);
    }
    let length: f64 = tube.windows(2).map(|pair| pair[0].position.distance(pair[1].position)).sum();
    let widest = tube.iter().map(|vertex| f64::from(vertex.radius)).fold(0.0, f64::max);
    (length >= SLENDERNESS * widest).then_some(tube)
}

/// The vertices of a piece and what they are connected with. Vertices are numbered within the piece.
struct Net {
    positions: Vec<DVec3>,
    /// A triangle at each vertex, with its corners.
    faces: Vec<(u32, [DVec3; 3])>,
    neighbours: Vec<Vec<usize>>,
    /// Neighbours along the border of the surface.
    border: Vec<Vec<usize>>,
    /// Number of triangles with an area.
    triangles: usize,
    /// No more than two triangles meet at an edge.
    is_manifold: bool,
}

impl Net {
    fn of(pieces: &Pieces, piece: &[u32]) -> Option<Net> {
        let mut net = Net {
            positions: Vec::new(),
            faces: Vec::new(),
            neighbours: Vec::new(),
            border: Vec::new(),
            triangles: 0,
            is_manifold: true,
        };
        let mut numbers: WordMap<u32, usize> = WordMap::default();
        let mut uses: WordMap<(u32, u32), usize> = WordMap::default();
        for &triangle in piece {
            let (corners, positions) = (pieces.corners(triangle)?, pieces.positions(triangle));
            for (place, position) in corners.into_iter().zip(positions) {
                numbers.entry(place).or_insert_with(|| {
                    net.positions.push(position);
                    net.faces.push((triangle, positions));
                    net.positions.len() - 1
                });
            }
            let has_area = has_area(corners);
            net.triangles += usize::from(has_area);
            for edge in edges_of(corners) {
                *uses.entry(edge).or_default() += usize::from(has_area);
            }
        }
        net.neighbours.resize(net.positions.len(), Vec::new());
        net.border.resize(net.positions.len(), Vec::new());
        for ((a, b), uses) in uses {
            if a == b {
                continue;
            }
            let (a, b) = (numbers[&a], numbers[&b]);
            net.is_manifold &= uses <= 2;
            for (one, other) in [(a, b), (b, a)] {
                net.neighbours[one].push(other);
                if uses == 1 {
                    net.border[one].push(other);
                }
            }
        }
        // The order of a hash map must not show.
        net.neighbours.iter_mut().chain(&mut net.border).for_each(|list| list.sort_unstable());
        Some(net)
    }

    /// The rings from one end to the other. A tip is a ring of one vertex.
    fn rings(&self) -> Option<Vec<Vec<usize>>> {
        if !self.is_manifold {
            return None;
        }
        let count = self.positions.len();
        if let Some(first) = (0..count).find(|&vertex| !self.border[vertex].is_empty()) {
            return self.rings_from(self.loop_at(first)?);
        }
        // At a closed tube, a tip is one of the outermost vertices or a neighbour of one.
        let from = self.positions[0];
        let one = self.farthest(from);
        let other = self.farthest(self.positions[one]);
        let ends = [one, other]
            .into_iter()
            .flat_map(|end| std::iter::once(end).chain(self.neighbours[end].iter().copied()));
        ends.take(MAX_TRIES).find_map(|tip| self.rings_from(vec![tip]))
    }

    /// The rings from one end to the other, as clusters of corners with short edges between them. Long edges connect each cluster with the
    /// next one, and with no other.
    fn clusters(&self) -> Option<Vec<Vec<usize>>> {
        let edges = || {
            let of = |(one, others): (usize, &Vec<usize>)| {
                let others: Vec<usize> =
                    others.iter().copied().filter(|&other| other > one).collect();
                others.into_iter().map(move |other| {
                    (one, other, self.positions[one].distance(self.positions[other]))
                })
            };
            self.neighbours.iter().enumerate().flat_map(of)
        };
        let mut lengths: Vec<f64> = edges().map(|(_, _, length)| length).collect();
        lengths.sort_by(f64::total_cmp);
        let gaps = lengths.windows(2).map(|pair| (pair[1] / pair[0], pair[0]));
        let (gap, short) = gaps.max_by(|one, other| one.0.total_cmp(&other.0))?;
        if gap < CLUSTER_GAP {
            return None;
        }
        let mut groups = Groups::new(self.positions.len());
        let is_short = |length: f64| length <= short;
        edges()
            .filter(|&(_, _, length)| is_short(length))
            .for_each(|(one, other, _)| groups.join(one as u32, other as u32));
        let roots = groups.roots();
        let mut members: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
        for (vertex, &root) in roots.iter().enumerate() {
            members.entry(root).or_default().push(vertex);
        }
        let mut near: BTreeMap<u32, BTreeSet<u32>> = BTreeMap::new();
        for (one, other, _) in edges().filter(|&(_, _, length)| !is_short(length)) {
            let (one, other) = (roots[one], roots[other]);
            near.entry(one).or_default().insert(other);
            near.entry(other).or_default().insert(one);
        }
        if near.iter().any(|(own, near)| near.contains(own) || near.len() > 2) {
            return None;
        }
        let (mut at, _) = near.iter().find(|(_, near)| near.len() == 1)?;
        let mut rings: Vec<Vec<usize>> = Vec::with_capacity(members.len());
        while let Some(ring) = members.remove(at) {
            rings.push(ring);
            at = near[at].iter().find(|next| members.contains_key(next)).unwrap_or(at);
        }
        members.is_empty().then_some(rings)
    }

    fn farthest(&self, from: DVec3) -> usize {
        let distance = |vertex: usize| self.positions[vertex].distance_squared(from);
        let vertices = 0..self.positions.len();
        vertices.max_by(|&a, &b| distance(a).total_cmp(&distance(b))).unwrap_or(0)
    }

    /// The vertices of the border through a vertex, in the order of their numbers, if it is a simple loop.
    fn loop_at(&self, first: usize) -> Option<Vec<usize>> {
        let mut ring = vec![first];
        loop {
            let at = ring[ring.len() - 1];
            let [a, b] = self.border[at][..] else { return None };
            let before = if ring.len() > 1 { ring[ring.len() - 2] } else { b };
            let next = if a == before { b } else { a };
            if next == first {
                ring.sort_unstable();
                return (ring.len() > 2).then_some(ring);
            }
            ring.push(next);
            if ring.len() > self.positions.len() {
                return None;
            }
        }
    }

    /// Takes ring after ring off the piece, beginning with a ring or a tip. Nothing else may be left in the end.
    fn rings_from(&self, first: Vec<usize>) -> Option<Vec<Vec<usize>>> {
        let mut is_taken = vec![false; self.positions.len()];
        let (mut taken, mut triangles) = (0, 0);
        let mut rings = vec![first];
        loop {
            let ring = &rings[rings.len() - 1];
            ring.iter().for_each(|&vertex| is_taken[vertex] = true);
            taken += ring.len();
            let around = ring.iter().flat_map(|&vertex| &self.neighbours[vertex]).copied();
            let mut next: Vec<usize> = around.filter(|&vertex| !is_taken[vertex]).collect();
            next.sort_unstable();
            next.dedup();
            if next.is_empty() {
                break;
            }
            if next.len() > 1 && !self.is_loop(&next) {
                return None;
            }
            // Each side of either ring has one triangle between them.
            let sides = |ring: &[usize]| if ring.len() == 1 { 0 } else { ring.len() };
            triangles += sides(ring) + sides(&next);
            rings.push(next);
        }
        let is_whole = taken == self.positions.len() && triangles == self.triangles;
        (is_whole && rings.len() > 1).then_some(rings)
    }

    /// Neighbours of a vertex within a sorted list.
    fn within<'n>(&'n self, ring: &'n [usize], vertex: usize) -> impl Iterator<Item = usize> + 'n {
        let near = self.neighbours[vertex].iter().copied();
        near.filter(|other| ring.binary_search(other).is_ok())
    }

    /// Whether the vertices of a sorted list are one loop.
    fn is_loop(&self, ring: &[usize]) -> bool {
        let (mut before, mut at) = (usize::MAX, ring[0]);
        for step in 1..=ring.len() {
            if self.within(ring, at).count() != 2 {
                return false;
            }
            let next = self.within(ring, at).find(|&next| next != before);
            (before, at) = (at, next.unwrap_or(at));
            if at == ring[0] {
                return step == ring.len();
            }
        }
        false
    }

    /// `None` if the ring is not round, unless it is `thin`.
    fn vertex(&self, ring: &[usize], thin: f64, colors: &Colors) -> Option<LineVertex> {
        let positions = ring.iter().map(|&vertex| self.positions[vertex]);
        let position = positions.clone().sum::<DVec3>() / ring.len() as f64;
        let distances = positions.map(|corner| corner.distance(position));
        let far = distances.clone().fold(0.0, f64::max);
        let is_round =
            ring.len() != 2 && far <= ROUNDNESS * distances.fold(f64::INFINITY, f64::min);
        if far > thin && !is_round {
            return None;
        }
        let sides = ring.iter().flat_map(|&one| {
            let others =
                self.neighbours[one].iter().filter(|other| ring.binary_search(other).is_ok());
            others.map(move |&other| self.positions[one].distance(self.positions[other]))
        });
        // Each side was met from both ends.
        let perimeter = 0.5 * sides.sum::<f64>();
        let radius = perimeter / TAU;
        // Textures are averaged over half a side.
        let reach = 0.5 * perimeter / ring.len() as f64;
        let found = ring.iter().filter_map(|&vertex| {
            let (triangle, corners) = self.faces[vertex];
            colors.on(triangle, corners, self.positions[vertex], reach)
        });
        Some(LineVertex {
            position,
            radius: radius as f32,
            normal: Vec3::ZERO,
            color: mean_color(found).unwrap_or([255; 4]),
        })
    }
}
