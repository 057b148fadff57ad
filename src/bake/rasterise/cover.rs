//! Which samples' disks cover a part of a triangle.

use std::sync::atomic::{AtomicU32, Ordering};

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::super::kernels::{CUTOFF, circle};
use super::facet::{Facet, Sample, along};
use super::{REACH, STRETCH};
use crate::assets::Kernel;
use crate::scene::random::mix;

/// Maximum height difference, in cells, between a disk and a position that it covers.
const RISE: f64 = 0.5;
/// Cosine between normals, below which a disk is seen too much from its edge, or from behind, to cover a face.
const FACING: f64 = 0.25;
/// Depth of what is looked at together, in cells: a sample is less than half of that deeper or higher than what its disk
/// covers.
const SLAB: f64 = 5.0;
/// A cell and those about it, the nearest first.
const ABOUT: [[i64; 2]; 9] =
    [[0, 0], [-1, 0], [1, 0], [0, -1], [0, 1], [-1, -1], [1, -1], [-1, 1], [1, 1]];
const NONE: u32 = u32::MAX;

impl Sample {
    /// Length of the disk along the slope over its width.
    pub(super) fn stretch(&self) -> f64 {
        let steep = f64::from(self.normal[usize::from(self.axis)].abs());
        steep.max(1.0 / STRETCH).recip()
    }

    /// Radius of a round disk of the same area, in cells.
    pub(super) fn radius(&self) -> f64 {
        REACH * self.stretch().sqrt()
    }

    /// The kernel whose disk at [`CUTOFF`] appears as a circle of [`REACH`] cells along the axis, in mesh units.
    pub(super) fn kernel(&self, spacing: f64) -> Kernel {
        let deviation = (REACH * spacing / f64::from(CUTOFF)) as f32;
        let axis = Vec3::AXES[usize::from(self.axis)];
        match axis.cross(self.normal).try_normalize() {
            Some(level) => Kernel {
                u: level * deviation,
                v: self.normal.cross(level) * (deviation * self.stretch() as f32),
            },
            None => circle(self.normal, deviation),
        }
    }

    /// Tells whether the disk, seen along the normal of a face, lies over all of a convex part of it, and near.
    ///
    /// A place `d` from the sample is seen at `o = d + s · n_f` in the sample's plane, `s = −d · n / (n · n_f)`. The
    /// disk's width is [`REACH`] across the slope and `stretch` times that along it, so that with the component `o_a` of
    /// `o` along the axis, `o² − o_a² (1 − stretch⁻²) / (1 − n_a²)` is at most `REACH²`. As far as the stretch is `1 /
    /// |n_a|`, that is `o` without its component along the axis: a circle.
    fn covers(&self, face_normal: DVec3, part: &[DVec3]) -> bool {
        let normal = self.normal.as_dvec3();
        let facing = normal.dot(face_normal);
        if facing < FACING {
            return false;
        }
        let axis = usize::from(self.axis);
        let steep = normal[axis] * normal[axis];
        let share = ((1.0 - (STRETCH * STRETCH).recip()) / (1.0 - steep)).min(1.0);
        part.iter().all(|place| {
            let offset = place - self.at;
            let rise = -offset.dot(normal) / facing;
            let on = offset + face_normal * rise;
            rise.abs() <= RISE && on.length_squared() - on[axis] * on[axis] * share <= REACH * REACH
        })
    }
}

/// Samples by the cell of their axis' grid that they are in, and roughly by depth: a list for each cell (or, rarely, for
/// several).
///
/// Lists may be put together in parallel, in any order, since all that is asked is whether any of a list's samples covers
/// something.
pub(super) struct Index {
    heads: Vec<AtomicU32>,
    /// For each sample the next one of its list.
    next: Vec<AtomicU32>,
}

impl Index {
    pub(super) fn of(samples: &[Sample]) -> Self {
        let mut index = Self { heads: Vec::new(), next: Vec::new() };
        index.build(samples, samples.len());
        index
    }

    fn build(&mut self, samples: &[Sample], expected: usize) {
        let none = || AtomicU32::new(NONE);
        self.heads.clear();
        self.heads.resize_with(expected.max(1024).next_power_of_two(), none);
        self.next.clear();
        self.next.resize_with(samples.len(), none);
        samples.par_iter().zip(&self.next).zip(0u32..u32::MAX).for_each(|((sample, next), own)| {
            let list = self.list_of(sample);
            next.store(self.heads[list].swap(own, Ordering::Relaxed), Ordering::Relaxed);
        });
    }

    /// Makes lists enough for more samples than there are.
    pub(super) fn reserve(&mut self, samples: &[Sample], more: usize) {
        let expected = samples.len() + more;
        if expected > 2 * self.heads.len() {
            self.build(samples, expected);
        }
    }

    /// Takes in the last of the samples.
    pub(super) fn insert(&mut self, samples: &[Sample]) {
        if let Some(sample) = samples.last() {
            let list = self.list_of(sample);
            let own = self.next.len() as u32;
            self.next.push(AtomicU32::new(self.heads[list].swap(own, Ordering::Relaxed)));
        }
    }

    fn list_of(&self, sample: &Sample) -> usize {
        let local = along(sample.axis, sample.at);
        let cell = [local.x.floor() as i64, local.y.floor() as i64];
        self.list(sample.axis, cell, (local.z / SLAB).floor() as i64)
    }

    /// Cells of a square of four by four have neighbouring lists: triangles that follow each other are near each other,
    /// too.
    fn list(&self, axis: u8, [x, y]: [i64; 2], slab: i64) -> usize {
        let bits = mix((x >> 2) as u64 ^ ((y >> 2) as u64).rotate_left(24))
            ^ (slab as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15)
            ^ u64::from(axis) << 20;
        let in_square = ((y & 3) << 2 | (x & 3)) as usize;
        (((bits ^ bits >> 32) as usize) << 4 | in_square) & (self.heads.len() - 1)
    }

    /// Tells whether some sample's disk lies over all of a convex part of a facet.
    pub(super) fn covers(&self, samples: &[Sample], facet: &Facet, part: &[DVec3]) -> bool {
        self.any(samples, facet, part, &mut |_| true)
    }

    /// Calls `accept` with the samples whose disks lie over all of a convex part of a facet, until it accepts one.
    pub(super) fn any(
        &self,
        samples: &[Sample],
        facet: &Facet,
        part: &[DVec3],
        accept: &mut impl FnMut(u32) -> bool,
    ) -> bool {
        let middle = part.iter().sum::<DVec3>() / part.len().max(1) as f64;
        (0..3).any(|step| {
            let axis = (facet.axis + step) % 3;
            let local = along(axis, middle);
            let [x, y] = [local.x.floor() as i64, local.y.floor() as i64];
            let depth = local.z / SLAB;
            let slab = depth.floor();
            let other = if depth - slab < 0.5 { slab - 1.0 } else { slab + 1.0 };
            ABOUT.into_iter().any(|[dx, dy]| {
                [slab, other].into_iter().any(|slab| {
                    let list =
                        self.list(axis, [x.wrapping_add(dx), y.wrapping_add(dy)], slab as i64);
                    self.any_from(list, samples, facet, part, accept)
                })
            })
        })
    }

    /// Tells whether a disk of a sample in a cell of the facet's own grid, at the depth of a convex part of the facet, lies over
    /// all of that part. [`covers`](Self::covers) makes this test first, and it is mostly sufficient.
    pub(super) fn covers_here(
        &self,
        samples: &[Sample],
        facet: &Facet,
        cell: [i64; 2],
        part: &[DVec3; 4],
    ) -> bool {
        self.any_here(samples, facet, cell, part, &mut |_| true)
    }

    /// Calls `accept` with the samples that [`covers_here`](Self::covers_here) looks for, until it accepts one.
    pub(super) fn any_here(
        &self,
        samples: &[Sample],
        facet: &Facet,
        cell: [i64; 2],
        part: &[DVec3; 4],
        accept: &mut impl FnMut(u32) -> bool,
    ) -> bool {
        let axis = usize::from(facet.axis);
        let depth = 0.25 * (part[0][axis] + part[1][axis] + part[2][axis] + part[3][axis]);
        let list = self.list(facet.axis, cell, (depth / SLAB).floor() as i64);
        self.any_from(list, samples, facet, part, accept)
    }

    fn any_from(
        &self,
        list: usize,
        samples: &[Sample],
        facet: &Facet,
        part: &[DVec3],
        accept: &mut impl FnMut(u32) -> bool,
    ) -> bool {
        let mut next = self.heads[list].load(Ordering::Relaxed);
        while let Some(sample) = samples.get(next as usize) {
            if sample.covers(facet.normal, part) && accept(next) {
                return true;
            }
            next = self.next[next as usize].load(Ordering::Relaxed);
        }
        false
    }
}
