//! Lines: `neurons`, trees of tapering branches about cell bodies, and `tracts`, bundles of streamlines.
//!
//! Each neuron and each streamline has random numbers of its own, so that they are the same whatever their number is, apart
//! from the block that they share.

use std::f64::consts::TAU;

use glam::DVec3;
use rayon::prelude::*;

use super::numeric::sin_cos;
use super::plain::srgb;
use crate::assets::{Fields, Polylines, Progress, direction_colors};
use crate::scene::random::SplitMix64;

/// Streams of random numbers begin here, so that no other generator has them.
const NEURON_STREAM: u64 = 1 << 40;
const TRACT_STREAM: u64 = 1 << 41;
const BUNDLE_STREAM: u64 = 1 << 42;
/// Types of SWC.
const SOMA: u16 = 1;
const AXON: u16 = 2;
const BASAL: u16 = 3;
const APICAL: u16 = 4;

/// The vertices of some strands, in parallel.
#[derive(Default)]
struct Part {
    positions: Vec<DVec3>,
    radii: Vec<f32>,
    kinds: Vec<u16>,
    colors: Vec<[u8; 4]>,
    /// Number of vertices of each strand.
    lengths: Vec<u32>,
}

impl Part {
    fn vertex(&mut self, position: DVec3, radius: f64, kind: u16) {
        self.positions.push(position);
        self.radii.push(radius as f32);
        self.kinds.push(kind);
        self.colors.push(match kind {
            SOMA => srgb(0xd8c9a0),
            AXON => srgb(0x4f86c6),
            BASAL => srgb(0xc8553d),
            _ => srgb(0xb0609f),
        });
    }

    /// Ends a strand of all vertices since `begin`.
    fn end(&mut self, begin: usize) {
        self.lengths.push((self.positions.len() - begin) as u32);
    }
}

fn joined(parts: Vec<Part>, has_kinds: bool) -> Polylines {
    let vertices = parts.iter().map(|part| part.positions.len()).sum();
    let mut lines = Polylines { strands: vec![0], ..Polylines::default() };
    lines.positions.reserve_exact(vertices);
    let (mut radii, mut kinds, mut colors) = (Vec::new(), Vec::new(), Vec::new());
    let mut end = 0;
    for mut part in parts {
        lines.positions.append(&mut part.positions);
        radii.append(&mut part.radii);
        kinds.append(&mut part.kinds);
        colors.append(&mut part.colors);
        for length in part.lengths {
            end += length;
            lines.strands.push(end);
        }
    }
    lines.colors = (!colors.is_empty()).then_some(colors);
    if has_kinds {
        lines.radii = Some(radii);
        lines.fields = Fields::of_numbers(vec![("type", kinds)]);
    }
    lines
}

/// A unit vector, evenly distributed.
fn direction(random: &mut SplitMix64) -> DVec3 {
    let height = random.range(-1.0, 1.0);
    let (sine, cosine) = sin_cos(random.range(0.0, TAU));
    let across = (1.0 - height * height).sqrt();
    DVec3::new(across * cosine, height, across * sine)
}

pub(super) fn unit(vector: DVec3) -> DVec3 {
    vector / vector.length().max(1e-9)
}

/// Neurons with their bodies in a block of this edge, y towards the surface of the cortex.
pub fn neurons(count: usize, edge: f64, seed: u64, progress: &Progress) -> Polylines {
    // Branches reach as far as in a block of a millimetre, or as the block is wide.
    let scale = (edge / 1000.0).min(1.0);
    progress.report(0.0);
    let parts: Vec<Part> = (0..count)
        .into_par_iter()
        .map(|neuron| {
            let mut random = SplitMix64::stream(seed, NEURON_STREAM + neuron as u64);
            let place = [0; 3].map(|_| random.range(-0.5, 0.5) * edge);
            one_neuron(DVec3::from_array(place), scale, &mut random)
        })
        .collect();
    progress.report(1.0);
    joined(parts, true)
}

fn one_neuron(centre: DVec3, scale: f64, random: &mut SplitMix64) -> Part {
    let mut part = Part::default();
    let body = random.range(6.0, 10.0) * scale;
    // A strand of two vertices at one place is a ball.
    part.vertex(centre, body, SOMA);
    part.vertex(centre, body, SOMA);
    part.end(0);
    let basal = 4 + random.index(4);
    for _ in 0..basal {
        let way = unit(direction(random) - DVec3::Y * 0.5);
        let branch = Branch {
            kind: BASAL,
            radius: random.range(0.9, 1.6) * scale,
            left: 4,
            step: 9.0 * scale,
        };
        branch.grow(centre, way, &mut part, random);
    }
    let apical = Branch {
        kind: APICAL,
        radius: random.range(1.8, 2.6) * scale,
        left: 5,
        step: 16.0 * scale,
    };
    apical.grow(centre, DVec3::Y, &mut part, random);
    let axon =
        Branch { kind: AXON, radius: random.range(0.5, 0.8) * scale, left: 5, step: 18.0 * scale };
    axon.grow(centre, unit(DVec3::NEG_Y + direction(random) * 0.3), &mut part, random);
    part
}

/// A branch up to the point where it forks or ends.
#[derive(Clone, Copy)]
struct Branch {
    kind: u16,
    radius: f64,
    /// How often it forks at most.
    left: u32,
    step: f64,
}

impl Branch {
    fn grow(self, from: DVec3, way: DVec3, part: &mut Part, random: &mut SplitMix64) {
        let begin = part.positions.len();
        let steps = 5 + random.index(9);
        let (mut at, mut way, mut radius) = (from, way, self.radius);
        part.vertex(at, radius, self.kind);
        for _ in 0..steps {
            way = unit(way + direction(random) * 0.35);
            at += way * self.step * random.range(0.8, 1.2);
            radius *= 0.97;
            part.vertex(at, radius, self.kind);
        }
        part.end(begin);
        if self.left == 0 || random.chance(0.12) {
            return;
        }
        // Rall's law for two equal branches: the sum of the radii to the power of 3/2 is kept.
        let child = Branch { radius: radius * 0.63, left: self.left - 1, ..self };
        let across = unit(way.cross(direction(random)));
        for side in [across, -across] {
            let turned = unit(way + side * random.range(0.35, 0.8));
            child.grow(at, turned, part, random);
        }
    }
}

/// A bundle: a curve of four control points, its width along the way, and how far its ends fan out.
struct Bundle {
    control: [DVec3; 4],
    width: f64,
    fan: f64,
}

/// Streamlines in bundles within an ellipsoid of this height, z up, half of the bundles mirrored to the other side. They have the colours of
/// their directions.
pub fn tracts(count: usize, height: f64, seed: u64, progress: &Progress) -> Polylines {
    let bundles = ((count as f64).sqrt() / 3.0).round().clamp(4.0, 60.0) as u64;
    let bundles: Vec<Bundle> = (0..bundles).map(|number| bundle(number, height, seed)).collect();
    progress.report(0.0);
    let parts: Vec<Part> = (0..count)
        .into_par_iter()
        .map(|streamline| {
            let mut random = SplitMix64::stream(seed, TRACT_STREAM + streamline as u64);
            let bundle = &bundles[streamline % bundles.len()];
            let mut part = Part::default();
            streamline_of(bundle, height, &mut part, &mut random);
            direction_colors(&part.positions, &mut part.colors);
            part
        })
        .collect();
    progress.report(1.0);
    joined(parts, false)
}

fn bundle(number: u64, height: f64, seed: u64) -> Bundle {
    // Two bundles that follow each other are mirror images.
    let mut random = SplitMix64::stream(seed, BUNDLE_STREAM + number / 2);
    let side = if number.is_multiple_of(2) { 1.0 } else { -1.0 };
    let shape = DVec3::new(0.45, 0.58, 0.42) * height;
    let control = [0.85, 0.5, 0.5, 0.85].map(|reach| {
        let point = direction(&mut random) * shape * reach;
        DVec3::new(point.x.abs() * side, point.y, point.z)
    });
    let width = random.range(0.012, 0.035) * height;
    Bundle { control, width, fan: random.range(1.0, 3.5) }
}

fn streamline_of(bundle: &Bundle, height: f64, part: &mut Part, random: &mut SplitMix64) {
    let [a, b, c, d] = bundle.control;
    let offset = DVec3::new(random.bell(), random.bell(), random.bell()) * bundle.width;
    let (first, last) = (random.range(0.0, 0.12), random.range(0.88, 1.0));
    let length = a.distance(b) + b.distance(c) + c.distance(d);
    let points = ((length / (0.012 * height)).round() as usize).clamp(16, 120);
    let drift = DVec3::new(random.bell(), random.bell(), random.bell()) * 0.25 * bundle.width;
    for point in 0..=points {
        let t = first + (last - first) * point as f64 / points as f64;
        let s = 1.0 - t;
        let middle =
            a * (s * s * s) + b * (3.0 * s * s * t) + c * (3.0 * s * t * t) + d * (t * t * t);
        let from_middle = 2.0 * (t - 0.5);
        let spread = 1.0 + bundle.fan * from_middle * from_middle;
        let wave = drift * sin_cos(9.0 * t).0;
        part.positions.push(middle + offset * spread + wave);
    }
    part.end(0);
}
