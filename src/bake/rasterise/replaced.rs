//! The triangles that each sample replaces where triangles are too small to be drawn.
//!
//! A triangle's own samples lie at the centres of the cells that it contains. The rest of the triangle, its parts in cells about
//! its outline, lies under disks of other triangles' samples. Where the triangle is not drawn, these have to be. For each such part,
//! the sample of the part's own cell replaces the triangle, which also closes pictures of points, one in each cell. Where that
//! sample does not cover the part, another one does: the one of the smallest triangle, which needs the least change.

use std::cell::Cell;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use super::cover::Index;
use super::facet::{Facet, Grid, Sample};
use super::outer_parts;
use crate::assets::Mesh;

/// For each sample the smallest of the `sides` of the triangles that it replaces, of which its own is one.
pub(super) fn shortest(mesh: &Mesh, grid: &Grid, samples: &[Sample], sides: &[f64]) -> Vec<f64> {
    let index = Index::of(samples);
    let own = |number: u32| sides[samples[number as usize].triangle as usize];
    // Bits of numbers that are not negative have the order of the values.
    let shortest: Vec<AtomicU64> =
        (0u32..).take(samples.len()).map(|number| AtomicU64::new(own(number).to_bits())).collect();
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
            shortest[number as usize].fetch_min(side.to_bits(), Relaxed);
        }
    };
    outer_parts(mesh, grid, 0..mesh.triangles.len(), visit);
    shortest.into_iter().map(|side| f64::from_bits(side.into_inner())).collect()
}
