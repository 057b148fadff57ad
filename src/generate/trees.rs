//! Trees of many leaves: one skeleton of stems and leaves, put out as triangles or as lines.
//!
//! The skeleton has a trunk, limbs, branches and twigs, each a chain of vertices with radii, and leaves along the twigs. As
//! *triangles*, stems are closed tubes and each leaf is two quads. As *lines*, the trunk stays a mesh, the other stems are
//! polylines with radii, and each leaf is a ribbon through the middles of its quads' edges: both forms of a leaf have equal corners.

use std::f64::consts::{PI, TAU};

use glam::{DVec3, Vec3};

use super::GeneratedMesh;
use super::lines::unit;
use super::numeric::sin_cos;
use super::plain::srgb;
use crate::assets::{Mesh, Polylines, Progress};
use crate::scene::random::SplitMix64;

/// Streams of random numbers begin here, so that no other generator has them.
const STEM_STREAM: u64 = 1 << 43;
const LEAF_STREAM: u64 = 1 << 44;
/// Leaves of a twig, twigs of a branch.
const LEAVES_PER_TWIG: usize = 20;
const TWIGS_PER_BRANCH: usize = 20;
/// Between neighbours along a stem, in radians: leaves and branches cover each other least.
const GOLDEN_ANGLE: f64 = 2.399_963_229_728_653;
/// Leaves, bent in the middle: half their widths at foot, middle and tip, in parts of their lengths.
const LEAF_WIDTHS: [f64; 3] = [0.08, 0.28, 0.03];
const LEAF_COLORS: [u32; 5] = [0x55803a, 0x648f3e, 0x78a046, 0x466f33, 0x8aa84e];
const BARK: u32 = 0x6b533d;
/// A tree has this many leaves for each triangle apart from the trunk's: four for a leaf, and those of stems.
const LEAVES_PER_TRIANGLE: f64 = 0.173;
const TRUNK_TRIANGLES: u64 = 216;

/// How a tree is put out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, clap::ValueEnum)]
pub enum Form {
    /// Stems as closed tubes of triangles, each leaf as two quads
    Triangles,
    /// The trunk as triangles, other stems as lines with radii, leaves as ribbons
    Lines,
}

/// The parts of a tree.
#[derive(Clone, Copy, Debug)]
pub struct TreeParameters {
    pub height: f64,
    pub leaves: usize,
    pub seed: u64,
}

impl TreeParameters {
    /// The number of leaves of a tree with about this many triangles.
    pub fn leaves_of(triangles: u64) -> u64 {
        ((triangles.saturating_sub(TRUNK_TRIANGLES) as f64 * LEAVES_PER_TRIANGLE).round() as u64)
            .max(1)
    }
}

/// A tree in parts: lines, and the mesh of its trunk.
#[derive(Clone, Debug, Default)]
pub struct Plant {
    pub trunk: GeneratedMesh,
    /// Tubes.
    pub branches: Polylines,
    /// Ribbons.
    pub leaves: Polylines,
}

/// A chain of vertices with radii.
struct Stem {
    /// 0 is the trunk, 3 is a twig.
    order: usize,
    path: Vec<DVec3>,
    radii: Vec<f64>,
}

/// The shape of all stems of an order.
struct Order {
    steps: usize,
    /// Corners of a ring.
    sides: usize,
    /// How much a step turns away from the one before it, and upwards.
    wobble: f64,
    rise: f64,
}

const ORDERS: [Order; 4] = [
    Order { steps: 8, sides: 12, wobble: 0.05, rise: 0.1 },
    Order { steps: 6, sides: 8, wobble: 0.12, rise: 0.1 },
    Order { steps: 5, sides: 6, wobble: 0.18, rise: 0.06 },
    Order { steps: 3, sides: 4, wobble: 0.2, rise: 0.0 },
];

/// Foot, middle and tip, their normals, and the unit direction of the width.
struct Leaf {
    path: [DVec3; 3],
    normals: [DVec3; 3],
    side: DVec3,
    length: f64,
    color: [u8; 4],
}

/// Two unit vectors that are perpendicular to a direction and to each other.
fn frame_of(way: DVec3) -> [DVec3; 2] {
    let helper = if way.x.abs() < 0.6 { DVec3::X } else { DVec3::Y };
    let u = unit(way.cross(helper));
    [u, way.cross(u)]
}

impl Stem {
    fn grow(
        order: usize,
        from: DVec3,
        way: DVec3,
        length: f64,
        radii: [f64; 2],
        random: &mut SplitMix64,
    ) -> Stem {
        let Order { steps, wobble, rise, .. } = ORDERS[order];
        let mut stem = Stem { order, path: vec![from], radii: vec![radii[0]] };
        let (mut at, mut way) = (from, unit(way));
        for step in 1..=steps {
            way = unit(way + random.bells() * wobble + DVec3::Y * rise);
            at += way * (length / steps as f64);
            let share = step as f64 / steps as f64;
            stem.path.push(at);
            stem.radii.push(radii[0] + share * (radii[1] - radii[0]));
        }
        stem
    }

    /// Place, direction and radius at a share of the way.
    fn at(&self, share: f64) -> (DVec3, DVec3, f64) {
        let last = self.path.len() - 1;
        let along = share.clamp(0.0, 1.0) * last as f64;
        let step = (along as usize).min(last - 1);
        let part = along - step as f64;
        let way = self.path[step + 1] - self.path[step];
        let radius = self.radii[step] + part * (self.radii[step + 1] - self.radii[step]);
        (self.path[step] + way * part, unit(way), radius)
    }

    /// The child `number` of `count`, `spread` away from this stem's direction, whose length is given for its share of the way.
    fn child(
        &self,
        (number, count): (usize, usize),
        first: f64,
        spread: f64,
        thick: f64,
        length: impl Fn(f64) -> f64,
        random: &mut SplitMix64,
    ) -> Stem {
        let part = (number as f64 + random.range(0.2, 0.8)) / count as f64;
        let share = first + (1.0 - first) * part;
        let (from, way, radius) = self.at(share);
        let [u, v] = frame_of(way);
        let (s, c) = sin_cos(GOLDEN_ANGLE * number as f64 + random.range(-0.4, 0.4));
        let (across, along) = sin_cos(spread * random.range(0.8, 1.2));
        let way = way * along + (u * c + v * s) * across;
        let length = length(share) * random.range(0.8, 1.15);
        let radius = radius * thick;
        Stem::grow(self.order + 1, from, way, length, [radius, 0.35 * radius], random)
    }
}

/// Which of `children` the parent `number` of `parents` has.
fn share_of(children: usize, number: usize, parents: usize) -> std::ops::Range<usize> {
    number * children / parents..(number + 1) * children / parents
}

/// Stems, parents before children, and leaves.
fn skeleton(parameters: &TreeParameters) -> (Vec<Stem>, Vec<Leaf>) {
    let &TreeParameters { height, leaves, seed } = parameters;
    let twigs = leaves.div_ceil(LEAVES_PER_TWIG).max(1);
    let branches = twigs.div_ceil(TWIGS_PER_BRANCH);
    let limbs = (branches as f64).sqrt().ceil() as usize;
    let mut stream = STEM_STREAM;
    let mut random = || {
        stream += 1;
        SplitMix64::stream(seed, stream)
    };
    let girth = [0.026 * height, 0.007 * height];
    let trunk = Stem::grow(0, DVec3::ZERO, DVec3::Y, 0.8 * height, girth, &mut random());
    let (mut stems, mut out) = (Vec::new(), Vec::with_capacity(leaves));
    for limb in 0..limbs {
        // Low limbs are the longest.
        let reach = |share: f64| height * (0.5 - 0.34 * share);
        let new = trunk.child((limb, limbs), 0.28, 1.05, 0.5, reach, &mut random());
        let own = share_of(branches, limb, limbs);
        for branch in own.clone() {
            let reach = |share: f64| height * (0.21 - 0.1 * share);
            let place = (branch - own.start, own.len());
            let new = new.child(place, 0.25, 0.85, 0.5, reach, &mut random());
            let own = share_of(twigs, branch, branches);
            for twig in own.clone() {
                let place = (twig - own.start, own.len());
                let new = new.child(place, 0.1, 0.9, 0.45, |_| 0.07 * height, &mut random());
                add_leaves(parameters, &new, share_of(leaves, twig, twigs), &mut out);
                stems.push(new);
            }
            stems.push(new);
        }
        stems.push(new);
    }
    stems.push(trunk);
    stems.reverse();
    (stems, out)
}

fn add_leaves(
    parameters: &TreeParameters,
    twig: &Stem,
    own: std::ops::Range<usize>,
    out: &mut Vec<Leaf>,
) {
    let &TreeParameters { height, leaves, seed } = parameters;
    // The fewer leaves there are, the larger they are.
    let size = height * (0.0125 * (1e5 / leaves as f64).sqrt()).clamp(0.003, 0.05);
    let crown = DVec3::Y * (0.55 * height);
    for number in own.clone() {
        let mut random = SplitMix64::stream(seed, LEAF_STREAM + number as u64);
        let place = (number - own.start) as f64;
        let (foot, way, _) = twig.at(0.1 + 0.9 * (place + 0.5) / own.len() as f64);
        let [u, v] = frame_of(way);
        let (s, c) = sin_cos(GOLDEN_ANGLE * place + random.range(-0.5, 0.5));
        let way = unit(way * 0.6 + u * c + v * s + DVec3::NEG_Y * 0.15);
        // Leaves face the sky outside of the crown.
        let sky = unit(foot - crown) * 0.8 + DVec3::Y * 0.6 + random.bells() * 0.35;
        let side = unit(sky.cross(way));
        let first = way.cross(side);
        let bent = unit(way - first * 0.4);
        let last = bent.cross(side);
        let length = size * random.range(0.75, 1.3);
        let middle = foot + way * (0.5 * length);
        out.push(Leaf {
            path: [foot, middle, middle + bent * (0.5 * length)],
            normals: [first, unit(first + last), last],
            side,
            length,
            color: srgb(LEAF_COLORS[random.index(LEAF_COLORS.len())]),
        });
    }
}

/// A mesh under construction.
#[derive(Default)]
struct Faces {
    positions: Vec<DVec3>,
    normals: Vec<Vec3>,
    colors: Vec<[u8; 4]>,
    triangles: Vec<[u32; 3]>,
}

impl Faces {
    fn vertex(&mut self, position: DVec3, normal: DVec3, color: [u8; 4]) -> u32 {
        self.positions.push(position);
        self.normals.push(normal.as_vec3());
        self.colors.push(color);
        self.positions.len() as u32 - 1
    }

    /// A closed tube of rings about a stem. Polygons about a circle have its mean width.
    fn stem(&mut self, stem: &Stem) {
        let sides = ORDERS[stem.order].sides;
        let wide = PI / (sides as f64 * sin_cos(PI / sides as f64).0);
        let color = srgb(BARK);
        let last = stem.path.len() - 1;
        let mut u = DVec3::ZERO;
        let mut rings: Vec<u32> = Vec::with_capacity(last + 1);
        let mut ends = [DVec3::ZERO; 2];
        for (at, (&centre, &radius)) in stem.path.iter().zip(&stem.radii).enumerate() {
            let way = unit(stem.path[(at + 1).min(last)] - stem.path[at.saturating_sub(1)]);
            // The frame turns as little as the stem does.
            u = if at == 0 { frame_of(way)[0] } else { unit(u - way * way.dot(u)) };
            let v = way.cross(u);
            rings.push(self.positions.len() as u32);
            for side in 0..sides {
                let (s, c) = sin_cos(TAU * side as f64 / sides as f64);
                let out = u * c + v * s;
                self.vertex(centre + out * (radius * wide), out, color);
            }
            ends[usize::from(at != 0)] = way;
        }
        let foot = self.vertex(stem.path[0], -ends[0], color);
        let tip = stem.path[last] + ends[1] * (0.7 * stem.radii[last]);
        let tip = self.vertex(tip, ends[1], color);
        let top = rings[last];
        for side in 0..sides as u32 {
            let next = (side + 1) % sides as u32;
            for ring in rings.windows(2) {
                let (a, b) = (ring[0] + side, ring[0] + next);
                let (c, d) = (ring[1] + side, ring[1] + next);
                self.triangles.extend([[a, b, d], [a, d, c]]);
            }
            self.triangles.push([foot, rings[0] + next, rings[0] + side]);
            self.triangles.push([tip, top + side, top + next]);
        }
    }

    /// Two quads with an edge in common.
    fn leaf(&mut self, leaf: &Leaf) {
        let first = self.positions.len() as u32;
        for ((&middle, &normal), width) in leaf.path.iter().zip(&leaf.normals).zip(LEAF_WIDTHS) {
            let out = leaf.side * (width * leaf.length);
            self.vertex(middle - out, normal, leaf.color);
            self.vertex(middle + out, normal, leaf.color);
        }
        for a in [first, first + 2] {
            self.triangles.extend([[a, a + 1, a + 3], [a, a + 3, a + 2]]);
        }
    }

    fn finish(self) -> GeneratedMesh {
        let mesh = Mesh {
            positions: self.positions,
            triangles: self.triangles,
            colors: Some(self.colors),
            normals: Some(self.normals),
            ..Mesh::default()
        };
        GeneratedMesh { mesh, ..GeneratedMesh::default() }
    }
}

/// A tree as one mesh, standing on the origin, y up.
pub fn triangles(parameters: &TreeParameters, progress: &Progress) -> GeneratedMesh {
    progress.report(0.0);
    let (stems, leaves) = skeleton(parameters);
    let mut faces = Faces::default();
    stems.iter().for_each(|stem| faces.stem(stem));
    leaves.iter().for_each(|leaf| faces.leaf(leaf));
    progress.report(1.0);
    faces.finish()
}

/// The tree of [`triangles`] as lines, apart from its trunk.
pub fn lines(parameters: &TreeParameters, progress: &Progress) -> Plant {
    progress.report(0.0);
    let (stems, leaves) = skeleton(parameters);
    let mut plant = Plant::default();
    let (mut radii, mut colors) = (Vec::new(), Vec::new());
    plant.branches.strands.push(0);
    let mut trunk = Faces::default();
    for stem in &stems {
        if stem.order == 0 {
            trunk.stem(stem);
            continue;
        }
        plant.branches.positions.extend(&stem.path);
        radii.extend(stem.radii.iter().map(|&radius| radius as f32));
        colors.extend(stem.path.iter().map(|_| srgb(BARK)));
        plant.branches.strands.push(radii.len() as u32);
    }
    plant.trunk = trunk.finish();
    plant.branches.radii = Some(radii);
    plant.branches.colors = Some(colors);
    let (mut radii, mut normals, mut colors) = (Vec::new(), Vec::new(), Vec::new());
    plant.leaves.strands.push(0);
    for leaf in &leaves {
        plant.leaves.positions.extend(leaf.path);
        radii.extend(LEAF_WIDTHS.map(|width| (width * leaf.length) as f32));
        normals.extend(leaf.normals.map(|normal| normal.as_vec3()));
        colors.extend([leaf.color; 3]);
        plant.leaves.strands.push(radii.len() as u32);
    }
    plant.leaves.radii = Some(radii);
    plant.leaves.normals = Some(normals);
    plant.leaves.colors = Some(colors);
    progress.report(1.0);
    plant
}

#[cfg(test)]
mod tests;
