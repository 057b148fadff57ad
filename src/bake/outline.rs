//! Outlines: the few points of a geometry that decide which cameras show it whole.
//!
//! A camera holds a geometry in its frame when it holds the geometry's convex hull. The hull is approximated from within by the
//! points that lie farthest along up to 512 directions, spread evenly over a sphere that is stretched to the geometry's box.
//! The search goes through the chunks' boxes first, so that it visits few points.
//!
//! Stray points would make such a hull useless: one return from a bird, and a scan is a dot. Points are strays when they are
//! few ([`STRAY_SHARE`] of the samples, or of the triangles' area) and lie far from all others ([`gap`]). Outlines leave them out
//! and count them.

use std::f64::consts::PI;

use glam::{DVec3, IVec3};
use rayon::prelude::*;

use super::pack::{CHUNK, PackedChunk, PackedGeometry, PackedMesh, PackedSamples, longer_axis};
use crate::math::Bounds;

/// Directions in which the farthest point is looked for, at most and at least.
const DIRECTIONS: (usize, usize) = (512, 64);
/// Directions of an asset's geometries together.
const DIRECTIONS_IN_ALL: usize = 1 << 16;
/// Share of a geometry that may be strays.
const STRAY_SHARE: f64 = 1e-3;
/// Share that each end of each axis may lose before the box around the rest is taken.
const TAIL_SHARE: f64 = 2.5e-4;
/// Samples or triangles that the box around the rest is computed from, at most, large triangles not counted.
const LOOKED_AT: u64 = 1 << 16;
/// Fewer samples than this have no strays.
const LEAST_SAMPLES: u64 = 32;
/// Clouds of fewer samples are framed with their discs, which may be larger than the distances between them.
const FEW_SAMPLES: u64 = 256;
/// Standard deviations at which a disc ends.
const DISC_DEVIATIONS: f64 = 2.0;

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
                cells_of(geometry, &chunks[index], &mut |cell| {
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
        let radius = disc_radius(geometry);
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
        let core = match geometry {
            PackedGeometry::Samples(cloud) => core_of_samples(cloud),
            PackedGeometry::Mesh(mesh) => core_of_triangles(mesh),
        };
        let Some(core) = core else { return Rest::everything() };
        let size = core.extent().length();
        if size == 0.0 {
            return Rest::everything();
        }
        let mut rest = Rest { keep: core.grown(size * gap(geometry)), ..Rest::everything() };
        if rest.holds(all.min) && rest.holds(all.max) {
            return Rest::everything();
        }
        // The guess from a sample is verified on all points.
        let centre = core.centre();
        let (mut lost, mut most) = (0.0, f64::INFINITY);
        let straddling = geometry.chunks().iter().filter(|chunk| {
            let bounds = chunk_box(chunk);
            !(rest.holds(bounds.min) && rest.holds(bounds.max))
        });
        let mut far = (0u64, 0.0f64);
        for chunk in straddling {
            match geometry {
                PackedGeometry::Samples(cloud) => {
                    most = allowed_samples(cloud.positions.len() as u64) as f64;
                    for place in samples_of(cloud, chunk).map(|cell| cell.as_dvec3()) {
                        if !rest.holds(place) {
                            far = (far.0 + 1, far.1.max(place.distance(centre)));
                            lost += 1.0;
                        }
                    }
                }
                PackedGeometry::Mesh(mesh) => {
                    if most == f64::INFINITY {
                        most = STRAY_SHARE * area_of(mesh);
                    }
                    for corners in triangles_of(mesh, chunk) {
                        let away = corners.iter().filter(|&&corner| !rest.holds(corner));
                        let farthest =
                            away.map(|corner| corner.distance(centre)).fold(0.0, f64::max);
                        if farthest > 0.0 {
                            far = (far.0 + 1, far.1.max(farthest));
                            lost += area(&corners);
                        }
                    }
                }
            }
            if lost > most {
                return Rest::everything();
            }
        }
        (rest.strays, rest.farthest_stray) = far;
        rest
    }
}

/// Minimum distance of a stray from the box around the rest, in diagonals of that box; larger if there are few samples.
fn gap(geometry: &PackedGeometry) -> f64 {
    match geometry {
        PackedGeometry::Samples(cloud) if cloud.positions.len() < 10_000 => 1.5,
        _ => 0.5,
    }
}

fn allowed_samples(count: u64) -> u64 {
    let least = if count < 1000 { 1 } else { 4 };
    least.max((STRAY_SHARE * count as f64) as u64)
}

/// The box around a cloud's samples without the tails of each axis; none where a sample's absence proves nothing.
fn core_of_samples(cloud: &PackedSamples) -> Option<Bounds> {
    let count = cloud.positions.len() as u64;
    if count < LEAST_SAMPLES {
        return None;
    }
    let every = count.div_ceil(LOOKED_AT) as usize;
    let chosen = cloud.chunks.iter().flat_map(|chunk| {
        let first = chunk.first as usize;
        let range = first..first + chunk.count as usize;
        range.filter(|index| index % every == 0).map(|index| chunk.cell(cloud.positions[index]))
    });
    let cells: Vec<IVec3> = chosen.collect();
    let tail = (TAIL_SHARE * cells.len() as f64).ceil() as usize;
    let tail = tail.max(if count < 1000 { 1 } else { 4 });
    let mut core = Bounds::EMPTY;
    for axis in 0..3 {
        let mut values: Vec<i32> = cells.iter().map(|cell| cell[axis]).collect();
        let last = values.len() - 1;
        let (_, &mut low, _) = values.select_nth_unstable(tail);
        let (_, &mut high, _) = values.select_nth_unstable(last - tail);
        core.min[axis] = f64::from(low);
        core.max[axis] = f64::from(high);
    }
    Some(core)
}

/// The box around a mesh's triangles without those at the ends of each axis that have next to no area.
fn core_of_triangles(mesh: &PackedMesh) -> Option<Bounds> {
    let whole = area_of(mesh);
    if !(whole > 0.0 && whole.is_finite()) {
        return None;
    }
    let every = (mesh.triangles.len() as u64).div_ceil(LOOKED_AT);
    let large = whole / LOOKED_AT as f64;
    let triangles = mesh.chunks.iter().flat_map(|chunk| triangles_of(mesh, chunk));
    let chosen = (0u64..).zip(triangles).filter_map(|(index, corners)| {
        let area = area(&corners);
        let weight = if area >= large { area } else { area * every as f64 };
        (area >= large || index % every == 0).then_some((corners, weight))
    });
    let chosen: Vec<([DVec3; 3], f64)> = chosen.collect();
    let mut inside = vec![true; chosen.len()];
    let mut order: Vec<usize> = (0..chosen.len()).collect();
    for axis in 0..3 {
        let middle = |index: usize| chosen[index].0.iter().map(|corner| corner[axis]).sum::<f64>();
        order.sort_unstable_by(|&a, &b| middle(a).total_cmp(&middle(b)).then(a.cmp(&b)));
        let mut cut = |ends: &mut dyn Iterator<Item = &usize>| {
            let mut lost = 0.0;
            for &index in ends {
                lost += chosen[index].1;
                if lost > TAIL_SHARE * whole {
                    break;
                }
                inside[index] = false;
            }
        };
        cut(&mut order.iter());
        cut(&mut order.iter().rev());
    }
    let kept = chosen.iter().zip(&inside).filter(|&(_, &inside)| inside);
    let core = Bounds::of(kept.flat_map(|((corners, _), _)| *corners));
    (!core.is_empty()).then_some(core)
}

fn area_of(mesh: &PackedMesh) -> f64 {
    // Chunk by chunk in their order, so that the sum is the same on every machine.
    let areas: Vec<f64> = mesh
        .chunks
        .par_iter()
        .map(|chunk| triangles_of(mesh, chunk).map(|corners| area(&corners)).sum())
        .collect();
    areas.iter().sum()
}

fn area([a, b, c]: &[DVec3; 3]) -> f64 {
    0.5 * (*b - *a).cross(*c - *a).length()
}

fn samples_of(cloud: &PackedSamples, chunk: &PackedChunk) -> impl Iterator<Item = IVec3> {
    let first = chunk.first as usize;
    let positions = &cloud.positions[first..first + chunk.count as usize];
    positions.iter().map(|&words| chunk.cell(words))
}

fn vertices_of<'a>(
    mesh: &'a PackedMesh,
    chunk: &PackedChunk,
) -> impl Iterator<Item = IVec3> + use<'a> {
    let first = chunk.vertex_first as usize;
    let vertices = &mesh.vertices[first..first + chunk.vertex_count as usize];
    vertices.iter().map(|&[x, y, z, ..]| IVec3::new(x as i32, y as i32, z as i32))
}

fn triangles_of<'a>(
    mesh: &'a PackedMesh,
    chunk: &PackedChunk,
) -> impl Iterator<Item = [DVec3; 3]> + use<'a> {
    let corners: Vec<DVec3> = vertices_of(mesh, chunk).map(|cell| cell.as_dvec3()).collect();
    let first = chunk.first as usize;
    let words = &mesh.triangles[first..first + chunk.count as usize];
    words.iter().map(move |&word| {
        [word, word >> 10, word >> 20].map(|corner| corners[corner as usize & (CHUNK - 1)])
    })
}

fn cells_of(geometry: &PackedGeometry, chunk: &PackedChunk, visit: &mut dyn FnMut(IVec3)) {
    match geometry {
        PackedGeometry::Samples(cloud) => samples_of(cloud, chunk).for_each(visit),
        PackedGeometry::Mesh(mesh) => vertices_of(mesh, chunk).for_each(visit),
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

/// Radius of a median disc in a cloud of few samples, 0 otherwise.
fn disc_radius(geometry: &PackedGeometry) -> f64 {
    let PackedGeometry::Samples(cloud) = geometry else { return 0.0 };
    if cloud.positions.len() as u64 >= FEW_SAMPLES {
        return 0.0;
    }
    let of_chunk = |chunk: &PackedChunk| {
        let first = chunk.first as usize;
        let longest = f64::from(chunk.kernel_base) * f64::from(1u32 << chunk.shift);
        let words = cloud.kernels.get(first..first + chunk.count as usize).unwrap_or_default();
        let radius = move |&word: &u32| {
            longer_axis(word).map_or(0.0, |code| longest * (-f64::from(code) / 128.0).exp2())
        };
        words.iter().map(radius).collect::<Vec<f64>>()
    };
    let mut radii: Vec<f64> = cloud.chunks.iter().flat_map(of_chunk).collect();
    let middle = radii.len() / 2;
    if middle >= radii.len() {
        return 0.0;
    }
    let (_, median, _) = radii.select_nth_unstable_by(middle, f64::total_cmp);
    *median * cloud.grid.step * DISC_DEVIATIONS
}

#[cfg(test)]
mod tests;
