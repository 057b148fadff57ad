//! A sampled solid's surface near a place: which planes bound it there, and which side is inside.
//!
//! The sample whose kept disk is nearest gives the primary face. A tangent plane is not that sample's alone: neighbours of
//! the same face are blended, each measured along the mean of its own normal and the blended one, which is exact on
//! spheres and cylinders to third order. Other faces that meet the primary one nearby join it: two faces that see each
//! other's samples behind them form a convex edge, so that inside is behind both; two in front of one another a concave
//! one, where inside is behind either. So neither samples without clip lines, whose disks reach
//! beyond their edge, nor thin walls mislead the test.

use glam::{DVec3, Vec2};

use super::{CUTOFF, Sample};
use crate::assets::{Clip, ClipLine};
use crate::bake::neighbors::PointTree;
use crate::math::Bounds;

/// Samples that are looked at about a place.
const NEARBY: usize = 32;
/// Cosine of the angle up to which normals belong to one face (35°).
const SAME_FACE: f64 = 0.819;
/// Faces that bound a solid at one place.
const MOST_FACES: usize = 5;

pub(super) struct Surface<'a> {
    samples: &'a [Sample],
    /// For each sample a place of its kept disk, well inside its lines.
    anchors: Vec<DVec3>,
    tree: PointTree,
    origin: DVec3,
    unit: f64,
    bounds: Bounds,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Plane {
    pub point: DVec3,
    pub normal: DVec3,
}

impl Plane {
    /// Signed distance, positive outside.
    pub fn distance(&self, at: DVec3) -> f64 {
        self.normal.dot(at - self.point)
    }
}

/// The relation of a solid's faces to one another.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Edge {
    Convex,
    Concave,
}

/// A face near a place.
#[derive(Clone, Copy, Debug)]
pub(super) struct Face {
    pub plane: Plane,
    /// The sample that stands for it.
    pub seed: usize,
    /// The edge to the primary face; meaningless for that face itself.
    edge: Edge,
    /// The edge to the first other face of the same kind.
    among: Edge,
}

/// The faces that bound a solid near a place; the first is the nearest.
pub(super) struct Local {
    pub faces: Vec<Face>,
    /// From the place to the nearest kept disk.
    pub distance: f64,
}

impl Local {
    /// Combines the faces' signed distances, in their order, into the solid's.
    pub fn value(&self, distance: impl Fn(usize) -> f64) -> f64 {
        let group = |edge: Edge| {
            let mut members = (1..self.faces.len()).filter(|&face| self.faces[face].edge == edge);
            let first = members.next().map(&distance)?;
            Some(members.fold(first, |sum, face| match self.faces[face].among {
                Edge::Convex => sum.max(distance(face)),
                Edge::Concave => sum.min(distance(face)),
            }))
        };
        let own = distance(0);
        let own = group(Edge::Concave).map_or(own, |other| own.min(other));
        group(Edge::Convex).map_or(own, |other| own.max(other))
    }
}

impl<'a> Surface<'a> {
    pub fn new(samples: &'a [Sample]) -> Surface<'a> {
        let bounds = Bounds::of(samples.iter().map(|sample| sample.position));
        let reach = samples.iter().fold(0.0f64, |reach, sample| reach.max(sample.radius()));
        let origin = if samples.is_empty() { DVec3::ZERO } else { bounds.centre() };
        let unit = if samples.is_empty() { 1.0 } else { bounds.extent().max_element() };
        let unit = if unit > 0.0 { unit } else { 1.0 };
        let local = samples.iter().map(|s| ((s.position - origin) / unit).as_vec3().to_array());
        Surface {
            samples,
            anchors: samples.iter().map(anchor).collect(),
            tree: PointTree::new(local),
            origin,
            unit,
            bounds: Bounds {
                min: bounds.min - DVec3::splat(reach),
                max: bounds.max + DVec3::splat(reach),
            },
        }
    }

    /// Tells whether the surface may come within `reach` of a position; if not, the position is outside.
    pub fn may_reach(&self, at: DVec3, reach: f64) -> bool {
        !self.samples.is_empty()
            && at.cmpge(self.bounds.min - DVec3::splat(reach)).all()
            && at.cmple(self.bounds.max + DVec3::splat(reach)).all()
    }

    #[cfg(test)]
    pub fn is_inside(&self, at: DVec3) -> bool {
        self.may_reach(at, 0.0)
            && self
                .local(at, 0.0)
                .is_some_and(|local| local.value(|face| local.faces[face].plane.distance(at)) < 0.0)
    }

    /// The faces within `reach` of a place, and those that meet the nearest one.
    pub fn local(&self, at: DVec3, reach: f64) -> Option<Local> {
        let nearby = self.nearby(at);
        let mut by_disk: Vec<(f64, f64, usize)> = nearby
            .iter()
            .map(|&index| {
                let sample = &self.samples[index];
                let disk = nearest_kept(sample, at).distance(at);
                (disk, sample.position.distance(at), index)
            })
            .collect();
        by_disk.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)).then(a.2.cmp(&b.2)));
        let &(distance, _, first) = by_disk.first()?;
        let face = |seed: usize, edge: Edge, among: Edge| Face {
            plane: self.blend(at, seed, &nearby),
            seed,
            edge,
            among,
        };
        let mut faces = vec![face(first, Edge::Convex, Edge::Convex)];
        for &(disk, _, other) in &by_disk {
            if faces.len() == MOST_FACES {
                break;
            }
            let joined = self.samples[first].radius() + self.samples[other].radius();
            let meets = self.anchors[first].distance(self.anchors[other]) <= joined;
            if self.same_face(first, other) || !(disk <= reach || meets) {
                continue;
            }
            let Some(edge) = self.edge(first, other) else { continue };
            let mut kin = faces.iter().skip(1).filter(|face| face.edge == edge);
            let elder = kin.next().map(|face| face.seed);
            let known = |seed: usize| self.same_face(seed, other);
            if elder.is_some_and(known) || kin.any(|face| known(face.seed)) {
                continue;
            }
            let among = elder.and_then(|elder| self.edge(elder, other)).unwrap_or(edge);
            faces.push(face(other, edge, among));
        }
        Some(Local { faces, distance })
    }

    /// The face of `seed`, followed to the part of it that is nearest to a place.
    pub fn follow(&self, at: DVec3, seed: usize) -> Plane {
        let nearby = self.nearby(at);
        let here = nearby
            .iter()
            .filter(|&&index| self.same_face(seed, index))
            .map(|&index| (nearest_kept(&self.samples[index], at).distance(at), index))
            .min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        self.blend(at, here.map_or(seed, |(_, index)| index), &nearby)
    }

    fn nearby(&self, at: DVec3) -> Vec<usize> {
        let mut found = Vec::new();
        let local = ((at - self.origin) / self.unit).as_vec3().to_array();
        self.tree.nearest(local, NEARBY, &mut found);
        found.into_iter().map(|(_, index)| index as usize).collect()
    }

    fn same_face(&self, a: usize, b: usize) -> bool {
        self.samples[a].normal.dot(self.samples[b].normal) > SAME_FACE
    }

    /// The edge that two faces form; `None` if one sees the other before it and not the other way round.
    fn edge(&self, a: usize, b: usize) -> Option<Edge> {
        let (sample_a, sample_b) = (&self.samples[a], &self.samples[b]);
        let across = self.anchors[b] - self.anchors[a];
        let (from_a, from_b) = (sample_a.normal.dot(across), -sample_b.normal.dot(across));
        let slack = 0.1 * sample_a.radius().min(sample_b.radius());
        if from_a + from_b < 0.0 && from_a.max(from_b) <= slack {
            Some(Edge::Convex)
        } else if from_a + from_b > 0.0 && from_a.min(from_b) >= -slack {
            Some(Edge::Concave)
        } else {
            None
        }
    }

    /// The tangent plane that the samples of one face give together, at the foot of a place.
    fn blend(&self, at: DVec3, seed: usize, nearby: &[usize]) -> Plane {
        let centre = &self.samples[seed];
        let foot = at - centre.normal * centre.normal.dot(at - centre.position);
        let falloff = 0.5 / (0.5 * centre.radius()).powi(2).max(1e-300);
        let members = || {
            let same = nearby.iter().filter(|&&index| self.same_face(seed, index));
            same.map(|&index| &self.samples[index]).chain(std::iter::once(centre))
        };
        let least =
            members().fold(f64::INFINITY, |least, s| least.min(s.position.distance_squared(foot)));
        let weight = |s: &Sample| (-(s.position.distance_squared(foot) - least) * falloff).exp();
        let sum: DVec3 = members().map(|s| s.normal * weight(s)).sum();
        let normal = sum.try_normalize().unwrap_or(centre.normal);
        let (mut height, mut total) = (0.0, 0.0);
        for s in members() {
            let w = weight(s);
            height += w * 0.5 * (s.normal + normal).dot(at - s.position);
            total += w;
        }
        Plane { point: at - normal * (height / total), normal }
    }
}

/// The place of a sample's kept disk that is nearest to `at`.
fn nearest_kept(sample: &Sample, at: DVec3) -> DVec3 {
    let offset = at - sample.position;
    let along = |axis: DVec3| {
        let length = axis.length_squared();
        if length > 0.0 { (offset.dot(axis) / length) as f32 } else { 0.0 }
    };
    let kernel = Vec2::new(along(sample.u), along(sample.v));
    sample.place(kept_point(&sample.clip, kernel.clamp_length_max(CUTOFF as f32)))
}

/// The nearest kept point of the disk, in kernel coordinates.
fn kept_point(clip: &Clip, at: Vec2) -> Vec2 {
    if clip.keeps(at) {
        return at;
    }
    let on = |line: &ClipLine| {
        let along = Vec2::new(-line.normal.y, line.normal.x);
        let half = (CUTOFF as f32).powi(2) - line.offset.powi(2);
        let half = half.max(0.0).sqrt();
        line.normal * line.offset + along * along.dot(at).clamp(-half, half)
    };
    let corner = match &clip.lines {
        [Some(a), Some(b)] => {
            let cross = a.normal.perp_dot(b.normal);
            let at = Vec2::new(
                a.offset * b.normal.y - b.offset * a.normal.y,
                b.offset * a.normal.x - a.offset * b.normal.x,
            );
            (cross.abs() > 1e-3).then(|| at / cross)
        }
        _ => None,
    };
    let kept = |point: &Vec2| {
        // Rounding must not lose a point that lies on its line.
        let within = |line: &ClipLine| line.normal.dot(*point) >= line.offset - 1e-4;
        let mut sides = clip.lines.iter().flatten().map(within);
        if clip.either { sides.any(|side| side) } else { sides.all(|side| side) }
    };
    let points = || clip.lines.iter().flatten().map(on).chain(corner);
    let nearest = |a: &Vec2, b: &Vec2| a.distance_squared(at).total_cmp(&b.distance_squared(at));
    points().filter(kept).min_by(nearest).or_else(|| points().min_by(nearest)).unwrap_or(at)
}

/// A place of the kept disk, away from its lines: the centre, or halfway from the line to the rim behind it.
fn anchor(sample: &Sample) -> DVec3 {
    let mut at = Vec2::ZERO;
    for line in sample.clip.lines.iter().flatten() {
        let depth = line.normal.dot(at);
        let wanted = 0.5 * (line.offset + CUTOFF as f32);
        if line.offset > -1.0 && depth < wanted {
            at += line.normal * (wanted - depth);
            if sample.clip.either {
                break;
            }
        }
    }
    sample.place(kept_point(&sample.clip, at.clamp_length_max(CUTOFF as f32)))
}
