//! Outlines: the few points of a geometry that decide which cameras show it whole.
//!
//! A camera holds a geometry in its frame when it holds the geometry's convex hull. The hull is approximated from within by the
//! points that lie farthest along up to 512 directions, spread evenly over a sphere that is stretched to the geometry's box.
//! The search goes through the chunks' boxes first, so that it visits few points.
//!
//! Stray points would make such a hull useless: one return from a bird, and a scan is a dot. Points are strays when they are
//! few (of the samples, or of the triangles' area) and lie far from all others. Outlines leave them out and count them. The file
//! of each kind of geometry says how few and how far.

use std::f64::consts::PI;

use glam::{DVec3, IVec3};
use rayon::prelude::*;

use super::pack::{PackedChunk, PackedGeometry};
use crate::math::Bounds;

/// Directions in which the farthest point is looked for, at most and at least.
const DIRECTIONS: (usize, usize) = (512, 64);
/// Directions of an asset's geometries together.
const DIRECTIONS_IN_ALL: usize = 1 << 16;

/// The points of a geometry that decide which cameras show it whole, in the geometry's own space.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Outline {
    pub points: Vec<DVec3>,
    /// Samples or triangles that are left out, because they are few and far from the rest.
    pub strays: u64,
    /// Largest distance of a stray from the middle of the rest; 0 without strays.
    pub farthest_stray: f64,
}

/// Directions that are spread evenly over the unit sphere (a Fibonacci lattice), the six axes first.
pub fn directions(count: usize) -> impl Iterator<Item = DVec3> {
    let axes = [DVec3::X, DVec3::Y, DVec3::Z].into_iter().flat_map(|axis| [axis, -axis]);
    let rest = count.saturating_sub(6);
    let turn = PI * (3.0 - 5f64.sqrt());
    let lattice = (0..rest).map(move |i| {
        let z = 1.0 - (2.0 * i as f64 + 1.0) / rest as f64;
        let (sin, cos) = (turn * i as f64).sin_cos();
        let radius = (1.0 - z * z).sqrt();
        DVec3::new(radius * cos, radius * sin, z)
    });
    axes.chain(lattice)
}

/// One over each edge of a box, so that directions can be spread over its shape; 1 where there is no edge.
pub fn inverse_extent(bounds: &Bounds) -> DVec3 {
    let inverse = |edge: f64| if edge > 0.0 { 1.0 / edge } else { 1.0 };
    let extent = bounds.extent();
    DVec3::new(inverse(extent.x), inverse(extent.y), inverse(extent.z))
}

/// The extent of a box along a direction.
pub fn reach_of(bounds: &Bounds, direction: DVec3) -> f64 {
    if bounds.is_empty() {
        return f64::NEG_INFINITY;
    }
    bounds.centre().dot(direction) + (0.5 * bounds.extent()).dot(direction.abs())
}

/// Finds what reaches farthest along a direction. `reaches` says how far each group may reach at most, `best_of` finds the
/// farthest point of a group. Most groups are not searched.
pub fn farthest<P: Copy>(
    reaches: impl Iterator<Item = f64>,
    best_of: impl Fn(usize) -> Option<(f64, P)>,
) -> Option<(f64, P)> {
    let reaches: Vec<f64> = reaches.collect();
    let promising = (0..reaches.len()).max_by(|&a, &b| reaches[a].total_cmp(&reaches[b]))?;
    let mut best = best_of(promising);
    for (group, &reach) in reaches.iter().enumerate().filter(|&(group, _)| group != promising) {
        if best.is_none_or(|(most, _)| reach > most)
            && let Some(found) = best_of(group)
            && best.is_none_or(|(reach, _)| found.0 > reach)
        {
            best = Some(found);
        }
    }
    best
}

impl Outline {
    /// Computes the outlines of an asset's geometries.
    pub fn of_all(geometries: &[PackedGeometry]) -> Vec<Outline> {
        let (most, least) = DIRECTIONS;
        let count = (DIRECTIONS_IN_ALL / geometries.len().max(1)).clamp(least, most);
        geometries.iter().map(|geometry| Outline::of(geometry, count)).collect()
    }

    /// Computes the outline of a packed geometry from its farthest points in `count` directions.
    fn of(geometry: &PackedGeometry, count: usize) -> Outline {
        let chunks = geometry.chunks();
        let all = chunks.iter().fold(Bounds::EMPTY, |all, chunk| all.union(chunk_box(chunk)));
        if all.is_empty() {
            return Outline::default();
        }
        let grid = geometry.grid();
        let rest = Rest::of(geometry, &all);
        let boxes: Vec<Bounds> =
            chunks.iter().map(|chunk| intersection(&chunk_box(chunk), &rest.keep)).collect();
        let scale = inverse_extent(&intersection(&all, &rest.keep));
        let directions: Vec<DVec3> = directions(count).map(|d| d * scale).collect();
        let farthest_along = |direction: &DVec3| {
            let best_of = |index: usize| {
                let mut best: Option<(f64, IVec3)> = None;
                geometry.visit_cells(&chunks[index], &mut |cell| {
                    let place = cell.as_dvec3();
                    let reach = place.dot(*direction);
                    if best.is_none_or(|(most, _)| reach > most) && rest.holds(place) {
                        best = Some((reach, cell));
                    }
                });
                best
            };
            farthest(boxes.iter().map(|bounds| reach_of(bounds, *direction)), best_of)
        };
        let mut cells: Vec<[i32; 3]> = directions
            .par_iter()
            .filter_map(|direction| farthest_along(direction).map(|(_, cell)| cell.to_array()))
            .collect();
        cells.sort_unstable();
        cells.dedup();
        let corners = cells.into_iter().map(|cell| grid.position(IVec3::from(cell)));
        let radius = geometry.corner_radius();
        let points: Vec<DVec3> = if radius > 0.0 {
            let around = |corner| self::directions(26).map(move |d| corner + d * radius);
            corners.flat_map(around).collect()
        } else {
            corners.collect()
        };
        Outline { points, strays: rest.strays, farthest_stray: rest.farthest_stray * grid.step }
    }

    /// The box around the outline.
    pub fn bounds(&self) -> Bounds {
        Bounds::of(self.points.iter().copied())
    }
}

/// The box that everything but strays lies in, in grid cells.
struct Rest {
    keep: Bounds,
    strays: u64,
    farthest_stray: f64,
}

impl Rest {
    fn everything() -> Rest {
        let keep = Bounds { min: DVec3::NEG_INFINITY, max: DVec3::INFINITY };
        Rest { keep, strays: 0, farthest_stray: 0.0 }
    }

    fn holds(&self, place: DVec3) -> bool {
        place.cmpge(self.keep.min).all() && place.cmple(self.keep.max).all()
    }

    fn of(geometry: &PackedGeometry, all: &Bounds) -> Rest {
        let Some(core) = geometry.core() else { return Rest::everything() };
        let size = core.extent().length();
        if size == 0.0 {
            return Rest::everything();
        }
        let gap = geometry.stray_gap();
        let mut rest = Rest { keep: core.grown(size * gap), ..Rest::everything() };
        if rest.holds(all.min) && rest.holds(all.max) {
            return Rest::everything();
        }
        // The guess from a sample is verified on all points.
        let centre = core.centre();
        let (mut lost, most) = (0.0, geometry.stray_weight());
        let straddling = geometry.chunks().iter().filter(|chunk| {
            let bounds = chunk_box(chunk);
            !(rest.holds(bounds.min) && rest.holds(bounds.max))
        });
        let mut far = (0u64, 0.0f64);
        let mut corners: Vec<DVec3> = Vec::new();
        for chunk in straddling {
            geometry.visit_elements(chunk, chunk.elements(), &mut |cells| {
                corners.clear();
                corners.extend(cells.iter().map(|cell| cell.as_dvec3()));
                let away = corners.iter().filter(|&&corner| !rest.holds(corner));
                let farthest = away.map(|corner| corner.distance(centre)).fold(0.0, f64::max);
                if farthest > 0.0 {
                    far = (far.0 + 1, far.1.max(farthest));
                    lost += geometry.weight(&corners);
                }
            });
            if lost > most {
                return Rest::everything();
            }
        }
        (rest.strays, rest.farthest_stray) = far;
        rest
    }
}

/// The box of a chunk in grid cells. Extents may use all 32 bits.
fn chunk_box(chunk: &PackedChunk) -> Bounds {
    let min = chunk.origin.as_dvec3();
    Bounds { min, max: min + chunk.extent.as_uvec3().as_dvec3() }
}

fn intersection(a: &Bounds, b: &Bounds) -> Bounds {
    Bounds { min: a.min.max(b.min), max: a.max.min(b.max) }
}

#[cfg(test)]
mod tests;
