//! The triangles that each sample replaces where triangles are too small to be drawn: the smallest of them, and which ways they face.
//!
//! A triangle's own samples lie at the centres of the cells that it contains. The rest of the triangle, its parts in cells about
//! its outline, lies under disks of other triangles' samples. Where the triangle is not drawn, these have to be. For each such part,
//! the sample of the part's own cell replaces the triangle, which also closes pictures of points, one in each cell. Where that
//! sample does not cover the part, another one does: the one of the smallest triangle, which needs the least change.

use std::cell::Cell;
use std::f32::consts::PI;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering::Relaxed};

use glam::Vec3;
use rayon::prelude::*;

use super::cover::Index;
use super::facet::{self, Facet, Grid, Sample};
use super::outer_parts;
use crate::assets::Mesh;

/// Angle up to which triangles face as their sample does, 0.2 radians: where the sample is seen from behind, they are narrower than a fifth of
/// their length.
const SAME_WAY: f32 = 0.2;

/// What a sample replaces: its own triangle, and others of which parts lie under its disk.
#[derive(Clone, Copy, Debug)]
pub struct Replaced {
    /// The shortest of their sides.
    pub side: f64,
    /// The largest angle between their normals and the sample's, in radians; 0 if all are below [`SAME_WAY`].
    pub cone: f32,
}

/// Returns what each sample replaces of a mesh whose triangles have these `sides`.
pub(super) fn by_samples(
    mesh: &Mesh,
    grid: &Grid,
    samples: &[Sample],
    sides: &[f64],
) -> Vec<Replaced> {
    let index = Index::of(samples);
    let own = |number: u32| sides[samples[number as usize].triangle as usize];
    let angle = |sample: &Sample, normal: Vec3| sample.normal.dot(normal).clamp(-1.0, 1.0).acos();
    // Bits of numbers that are not negative have the order of the values.
    let found: Vec<(AtomicU64, AtomicU32)> = samples
        .par_iter()
        .enumerate()
        .map(|(number, sample)| {
            let cone = normal_of(mesh, sample.triangle).map_or(PI, |normal| angle(sample, normal));
            (AtomicU64::new(own(number as u32).to_bits()), AtomicU32::new(cone.to_bits()))
        })
        .collect();
    let visit = |facet: &Facet, cell: [i64; 2], _: &mut Vec<()>| {
        let side = sides[facet.triangle as usize];
        let part = facet.part(cell);
        if part.points().is_empty() {
            return;
        }
        let best: Cell<Option<(f64, u32)>> = Cell::new(None);
        let mut accept = |number: u32| {
            let found = (own(number), number);
            best.set(best.get().filter(|best| *best <= found).or(Some(found)));
            found.0 <= side
        };
        let patch = facet.patch(cell);
        index.any_here(samples, facet, cell, &patch, &mut accept);
        if best.get().is_none() {
            index.any(samples, facet, part.points(), &mut accept);
        }
        if let Some((_, number)) = best.get() {
            let (shortest, cone) = &found[number as usize];
            shortest.fetch_min(side.to_bits(), Relaxed);
            let apart = angle(&samples[number as usize], facet.normal.as_vec3());
            cone.fetch_max(apart.to_bits(), Relaxed);
        }
    };
    outer_parts(mesh, grid, 0..mesh.triangles.len(), visit);
    let read = |(side, cone): (AtomicU64, AtomicU32)| {
        let cone = f32::from_bits(cone.into_inner());
        Replaced {
            side: f64::from_bits(side.into_inner()),
            cone: if cone > SAME_WAY { cone } else { 0.0 },
        }
    };
    found.into_iter().map(read).collect()
}

fn normal_of(mesh: &Mesh, triangle: u32) -> Option<Vec3> {
    let [a, b, c] = facet::corners(mesh, *mesh.triangles.get(triangle as usize)?)?;
    (b - a).cross(c - a).try_normalize().map(|normal| normal.as_vec3())
}
