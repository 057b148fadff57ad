//! Samples of a mesh's surface on three orthogonal grids, fast and in parallel (Coconu & Hege 2002, §4).
//!
//! 1. *Rasterise.* Each triangle is seen along the axis in which it appears largest, on that axis' one fixed square grid;
//!    each centre of a cell that it contains becomes a sample in its plane ([`facet`]). Where triangles share an edge,
//!    exactly one of them has a centre that lies on it.
//! 2. *Fill.* Whatever part of a triangle lies in a cell whose centre is elsewhere has to lie **wholly** in some disk: of
//!    the triangle that has the centre, or of any other about it, on whichever grid ([`cover`]). A part that lies in none
//!    gets a sample of its own, at its place nearest to the cell's centre, which reaches all of it. Borders, sharp edges,
//!    corners, needles, specks, and the lines where triangles change to another axis, are covered that way.
//! 3. *Colour.* As [`sample_mesh`](super::sample_mesh) does it; what an alpha cut-off removes goes last.
//!
//! We deviate from the paper, which rasterises along all three axes and merges what it finds: one axis is enough
//! where slopes are at most √2, and gives little more than half of the samples. Its samples have splats as large as the worst
//! slope needs; ours are ellipses, which appear as circles of one size along the triangle's axis: [`REACH`] cells, where half a
//! cell's diagonal, 0.71, is what a flat surface needs and the rest is for surfaces that curve between samples.
//!
//! Cubes, balls, needles, strips, fans, sheets and specks: 0 of 20 000 random places are open, about two disks lie over
//! one. A plane across an axis has a sample for each square of the spacing, one that slopes fewer, by the cosine of the
//! slope; a ball has 0.84, and 0.91 where its curvature or its facets are as coarse as a tenth of its radius (`tests`).
//! One core of a shared machine makes 2.7 to 3.5 million samples a second of large triangles, 0.7 to 1.1 million where
//! each triangle has two (built with `opt-level = 3`).
//!
//! Triangles are rasterised in parallel; parts found open are filled one after the other, in an order that
//! depends on them alone. Equal input gives equal samples, on however many threads.

mod cover;
mod facet;
pub(super) mod replaced;

use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};

use glam::DVec3;
use rayon::prelude::*;

use self::cover::Index;
use self::facet::Sample;
use self::facet::{Facet, Grid};
use self::replaced::Replaced;
use super::sample::SampleError;
use super::sample::color::Colors;
use crate::assets::{Material, Mesh, PointCloud, Texture};

/// Options for rasterising a mesh into samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RasteriseOptions {
    /// Side of a cell in mesh units. `None` gives about as many samples as there are vertices, or twice as many as there
    /// are triangles, whichever is more, but 20 000 at least and half of `max_samples` at most: the side is the root of
    /// what the triangles' areas, each as it appears along its axis, together leave to one of so many. If filling then
    /// takes more than `max_samples`, the side grows by a factor of √2 until it does not.
    pub spacing: Option<f64>,
    /// More are refused, those that an alpha cut-off would remove included.
    pub max_samples: u64,
}

impl Default for RasteriseOptions {
    fn default() -> Self {
        Self { spacing: None, max_samples: 1 << 24 }
    }
}

/// A mesh's samples.
#[derive(Clone, Debug, Default)]
pub struct RasterisedMesh {
    /// In the order of the triangles: positions, sRGB colours, oriented unit normals, elliptical kernels, and radii of
    /// disks of the same area as the kernels' at [`CUTOFF`](super::CUTOFF), all in mesh units.
    pub cloud: PointCloud,
    /// The triangle that each sample lies on.
    pub triangles: Vec<u32>,
    /// Side of a cell in mesh units; zero if none was given and there is nothing to sample.
    pub spacing: f64,
}

/// Radius of a sample's disk at [`CUTOFF`](super::CUTOFF) as it appears along its axis, in cells. From 0.71 on no place
/// is open, since what is open is filled. Up to 0.75 that takes many samples where surfaces curve; beyond 0.8 larger
/// disks save hardly any.
const REACH: f64 = 0.8;
/// Kernels are stretched along the slope by this at most, √3: what the largest of a unit normal's components allows.
const STRETCH: f64 = 1.732_050_807_568_877;
/// Cosine between a vertex's normal and a face's, 60°, below which the face's holds.
const AGREES: f64 = 0.5;
const LEAST_AUTOMATIC: f64 = 2e4;
/// Steps of √2 by which an automatic spacing may grow.
const ATTEMPTS: u32 = 24;
/// Triangles, centres and rows that a task takes.
const TRIANGLES: usize = 1024;
const CENTRES: f64 = 16_384.0;
const ROWS: i64 = 2048;
/// Parts looked at before those found open are filled.
const BLOCK: f64 = 1e6;

/// Samples the surface of a mesh, whose parts refer to `materials`, and these to `textures`.
///
/// Seen straight from above, every place of every triangle lies in the disk of some sample at most half a cell above or
/// below; only where a face turns away from its own vertex normals by more than 20° may that be more. Normals are
/// interpolated from the vertices where the mesh has them and all three are within 60° of the face's, which is taken
/// otherwise. What a material's alpha cut-off removes is left out; triangles without area, and those whose vertices do
/// not exist or are not finite, are, too.
///
/// Working memory is about 60 bytes a sample, and 24 for each open part of a block: at most about 10⁶, or as many as one
/// triangle has, which is a small multiple of `max_samples`.
///
/// # Errors
/// More samples than `max_samples`, or a spacing that is no positive number.
pub fn rasterise_mesh(
    mesh: &Mesh,
    materials: &[Material],
    textures: &[Texture],
    options: &RasteriseOptions,
) -> Result<RasterisedMesh, SampleError> {
    rasterise(mesh, materials, textures, options, None).map(|(rasterised, _)| rasterised)
}

/// Samples a mesh as [`rasterise_mesh`] does. `sides` are lengths of the triangles; also returns what each sample replaces.
///
/// # Errors
/// See [`rasterise_mesh`].
pub(super) fn rasterise_replacing(
    mesh: &Mesh,
    materials: &[Material],
    textures: &[Texture],
    options: &RasteriseOptions,
    sides: &[f64],
) -> Result<(RasterisedMesh, Vec<Replaced>), SampleError> {
    rasterise(mesh, materials, textures, options, Some(sides))
}

fn rasterise(
    mesh: &Mesh,
    materials: &[Material],
    textures: &[Texture],
    options: &RasteriseOptions,
    sides: Option<&[f64]>,
) -> Result<(RasterisedMesh, Vec<Replaced>), SampleError> {
    let extent = Extent::of(mesh);
    let limit = options.max_samples.min(u64::from(u32::MAX) - 1);
    let most = (0.5 * limit as f64).max(1.0);
    let wanted = (2.0 * mesh.triangles.len() as f64).max(mesh.positions.len() as f64);
    let wanted = wanted.max(LEAST_AUTOMATIC).min(most);
    let mut spacing = options.spacing.unwrap_or_else(|| (extent.area / wanted).sqrt());
    if extent.area == 0.0 && options.spacing.is_none() {
        return Ok(<(RasterisedMesh, Vec<Replaced>)>::default());
    }
    if !(spacing > 0.0 && spacing.is_finite()) {
        return Err(SampleError::Spacing { spacing });
    }
    let mut attempts = if options.spacing.is_none() { ATTEMPTS } else { 0 };
    let samples = loop {
        match samples_of(mesh, &extent, spacing, limit) {
            Err(SampleError::TooMany { .. }) if attempts > 0 => {
                attempts -= 1;
                spacing *= std::f64::consts::SQRT_2;
            }
            found => break found?,
        }
    };
    let grid = Grid::new(extent.low, spacing);
    let (samples, colors) = colored(samples, &grid, mesh, &Colors::of(mesh, materials, textures));
    let replaced = sides.map(|sides| replaced::by_samples(mesh, &grid, &samples, sides));
    Ok((finish(&samples, colors, &grid), replaced.unwrap_or_default()))
}

/// Figures of all triangles together.
#[derive(Clone, Copy, Debug)]
struct Extent {
    /// Sum of the areas as they appear along each triangle's axis.
    area: f64,
    low: DVec3,
    /// The longest side of a triangle along any axis.
    longest: f64,
}

impl Extent {
    fn of(mesh: &Mesh) -> Self {
        let none = Self { area: 0.0, low: DVec3::INFINITY, longest: 0.0 };
        let join = |one: Self, other: &Self| Self {
            area: one.area + other.area,
            low: one.low.min(other.low),
            longest: one.longest.max(other.longest),
        };
        let of_one = |triangle: &[u32; 3]| {
            let [a, b, c] = facet::corners(mesh, *triangle)?;
            let area = 0.5 * (b - a).cross(c - a).abs().max_element();
            let low = a.min(b).min(c);
            let longest = (a.max(b).max(c) - low).max_element();
            (area > 0.0 && area.is_finite()).then_some(Self { area, low, longest })
        };
        // Sums of fixed runs, added in order: the same for any number of threads.
        let runs: Vec<Self> = mesh
            .triangles
            .par_chunks(TRIANGLES)
            .map(|run| run.iter().filter_map(of_one).fold(none, |sum, one| join(sum, &one)))
            .collect();
        runs.iter().fold(none, join)
    }
}

/// All samples of a mesh, in the order of its triangles.
fn samples_of(
    mesh: &Mesh,
    extent: &Extent,
    spacing: f64,
    limit: u64,
) -> Result<Vec<Sample>, SampleError> {
    // No disk is longer than this, so that one long triangle tells how many samples there are at least.
    let of_longest = extent.longest / (2.0 * REACH * STRETCH * spacing);
    let count = (extent.area / spacing / spacing).max(of_longest);
    if count.is_nan() || count > limit as f64 {
        return Err(SampleError::TooMany { count: count.min(u64::MAX as f64) as u64, limit });
    }
    let grid = Grid::new(extent.low, spacing);
    let mut samples = centres(mesh, &grid, limit)?;
    let rasterised = samples.len();
    fill(mesh, &grid, limit, &mut samples)?;
    if samples.len() > rasterised {
        samples.par_sort_by_key(|sample| sample.triangle);
    }
    Ok(samples)
}

/// The samples at cells' centres.
fn centres(mesh: &Mesh, grid: &Grid, limit: u64) -> Result<Vec<Sample>, SampleError> {
    let count = AtomicU64::new(0);
    let of_rows = |facet: &Facet, rows: Range<i64>, found: &mut Vec<Sample>| {
        for row in rows {
            let span = facet.span(row);
            let length = span.end.saturating_sub(span.start).max(0) as u64;
            if length > 0 && count.fetch_add(length, Ordering::Relaxed) + length <= limit {
                found.extend(span.map(|column| facet.centre(column, row)));
            }
        }
    };
    let of_run = |(run, triangles): (usize, &[[u32; 3]])| {
        let mut found = Vec::new();
        for triangle in (run * TRIANGLES..).take(triangles.len()) {
            let Some(facet) = Facet::of(mesh, grid, triangle) else { continue };
            let rows = facet.rows();
            let area = facet.cells();
            if area < 2.0 * CENTRES {
                of_rows(&facet, rows, &mut found);
                continue;
            }
            let per_task = ((rows.end - rows.start) as f64 * CENTRES / area) as i64;
            found.extend(in_bands(rows, per_task.max(1), |rows| {
                let mut found = Vec::new();
                of_rows(&facet, rows, &mut found);
                found
            }));
        }
        found
    };
    let runs: Vec<Vec<Sample>> =
        mesh.triangles.par_chunks(TRIANGLES).enumerate().map(of_run).collect();
    if count.into_inner() > limit {
        return Err(SampleError::TooMany { count: limit + 1, limit });
    }
    Ok(runs.concat())
}

/// Runs `of_rows` on bands of rows and returns the results in their order.
fn in_bands<T: Clone + Send>(
    rows: Range<i64>,
    per_band: i64,
    of_rows: impl Fn(Range<i64>) -> Vec<T> + Sync,
) -> Vec<T> {
    let bands: Vec<Range<i64>> = (0..=(rows.end - rows.start - 1).max(0) / per_band)
        .map(|band| rows.start + band * per_band)
        .map(|start| start..(start + per_band).min(rows.end))
        .collect();
    let found: Vec<Vec<T>> = bands.into_par_iter().map(&of_rows).collect();
    found.concat()
}

/// A triangle's part in a cell.
#[derive(Clone, Copy, Debug)]
struct Open {
    triangle: u32,
    /// From the cell's centre to the part, in cells.
    distance: f32,
    cell: [i64; 2],
}

/// Adds samples where those there are leave parts of triangles open.
///
/// Parts are looked at in blocks: all of a block's against the samples there are before it, in parallel, then those found
/// open once more, one after the other, against the samples added on the way. Those near their cells' centres come first:
/// what is added there covers more of the others, and keeps its distance.
fn fill(
    mesh: &Mesh,
    grid: &Grid,
    limit: u64,
    samples: &mut Vec<Sample>,
) -> Result<(), SampleError> {
    let mut index = Index::of(samples);
    for block in blocks(mesh, grid) {
        let mut open = open_parts(mesh, grid, block, samples, &index);
        open.par_sort_by(|a, b| a.distance.total_cmp(&b.distance));
        index.reserve(samples, open.len());
        let mut last: Option<Facet> = None;
        for Open { triangle, cell, .. } in open {
            if last.as_ref().is_none_or(|facet| facet.triangle != triangle) {
                last = Facet::of(mesh, grid, triangle as usize);
            }
            let Some(facet) = &last else { continue };
            let part = facet.part(cell);
            if index.covers(samples, facet, part.points()) {
                continue;
            }
            let count = samples.len() as u64 + 1;
            if count > limit {
                return Err(SampleError::TooMany { count, limit });
            }
            samples.push(facet.sample(part.nearest(cell).1));
            index.insert(samples);
        }
    }
    Ok(())
}

/// Runs of triangles with about [`BLOCK`] parts or fewer, but for triangles that alone have more.
fn blocks(mesh: &Mesh, grid: &Grid) -> Vec<Range<usize>> {
    let parts = |triangle: usize| {
        facet::corners(mesh, mesh.triangles[triangle]).map_or(0.0, |corners| grid.parts(corners))
    };
    let count = mesh.triangles.len();
    let run = |run: usize| run * TRIANGLES..((run + 1) * TRIANGLES).min(count);
    let sums: Vec<f64> = (0..count.div_ceil(TRIANGLES))
        .into_par_iter()
        .map(|index| run(index).map(parts).sum())
        .collect();
    let mut found: Vec<Range<usize>> = Vec::new();
    let mut held = f64::INFINITY;
    let mut put = |range: Range<usize>, sum: f64| {
        held += sum;
        match found.last_mut() {
            Some(last) if held <= BLOCK => last.end = range.end,
            _ => {
                found.push(range);
                held = sum;
            }
        }
    };
    for (index, sum) in sums.into_iter().enumerate() {
        if sum <= BLOCK {
            put(run(index), sum);
        } else {
            run(index).for_each(|triangle| put(triangle..triangle + 1, parts(triangle)));
        }
    }
    found
}

/// The parts of a run of triangles that no sample covers, in order.
fn open_parts(
    mesh: &Mesh,
    grid: &Grid,
    block: Range<usize>,
    samples: &[Sample],
    index: &Index,
) -> Vec<Open> {
    outer_parts(mesh, grid, block, |facet, cell, found| {
        if index.covers_here(samples, facet, cell, &facet.patch(cell)) {
            return;
        }
        let part = facet.part(cell);
        if !part.points().is_empty() && !index.covers(samples, facet, part.points()) {
            let (distance, _) = part.nearest(cell);
            found.push(Open { triangle: facet.triangle, distance, cell });
        }
    })
}

/// Calls `visit` with the cells that each of a run of triangles touches without containing their centres; returns what the
/// calls find, in the order of the triangles.
fn outer_parts<T: Clone + Send>(
    mesh: &Mesh,
    grid: &Grid,
    block: Range<usize>,
    visit: impl Fn(&Facet, [i64; 2], &mut Vec<T>) + Sync,
) -> Vec<T> {
    let of_rows = |facet: &Facet, rows: Range<i64>, found: &mut Vec<T>| {
        for row in rows {
            let (inside, touched) = (facet.span(row), facet.touched(row));
            let is_inside = |column: &i64| inside.contains(column);
            // The cells inside may be many; they are skipped at once.
            let left = touched.start..touched.end.min(inside.start.max(touched.start));
            let right = if inside.is_empty() { left.end } else { inside.end }..touched.end;
            for column in left.chain(right).filter(|column| !is_inside(column)) {
                visit(facet, [column, row], found);
            }
        }
    };
    let of_run = |run: usize| {
        let mut found = Vec::new();
        for triangle in run..(run + TRIANGLES).min(block.end) {
            let Some(facet) = Facet::of(mesh, grid, triangle) else { continue };
            let rows = facet.rows();
            if rows.end - rows.start < 2 * ROWS {
                of_rows(&facet, rows, &mut found);
                continue;
            }
            found.extend(in_bands(rows, ROWS, |rows| {
                let mut found = Vec::new();
                of_rows(&facet, rows, &mut found);
                found
            }));
        }
        found
    };
    let runs: Vec<usize> = block.clone().step_by(TRIANGLES).collect();
    let found: Vec<Vec<T>> = runs.into_par_iter().map(of_run).collect();
    found.concat()
}

/// The samples that no alpha cut-off removes, and their colours.
fn colored(
    mut samples: Vec<Sample>,
    grid: &Grid,
    mesh: &Mesh,
    colors: &Colors,
) -> (Vec<Sample>, Vec<[u8; 4]>) {
    let color = |sample: &Sample| {
        let corners = facet::corners(mesh, mesh.triangles[sample.triangle as usize])?;
        let radius = sample.radius() * grid.spacing;
        colors.on(sample.triangle, corners, grid.mesh_from_cells(sample.at), radius)
    };
    let is_flat = colors.is_flat();
    // If a whole part has one colour, the colour is found once and kept.
    let known = |known: &mut Option<(usize, Option<[u8; 4]>)>, sample: &Sample| {
        let part = colors.part(sample.triangle);
        match *known {
            Some((of, color)) if is_flat && of == part => color,
            _ => known.insert((part, color(sample))).1,
        }
    };
    let colored: Vec<Option<[u8; 4]>> = samples.par_iter().map_init(|| None, known).collect();
    let colors: Vec<[u8; 4]> = colored.iter().copied().flatten().collect();
    if colors.len() < samples.len() {
        let mut kept = colored.iter();
        samples.retain(|_| kept.next().is_some_and(Option::is_some));
    }
    (samples, colors)
}

/// The cloud of these samples, in mesh units.
fn finish(samples: &[Sample], colors: Vec<[u8; 4]>, grid: &Grid) -> RasterisedMesh {
    let radius = |sample: &Sample| (sample.radius() * grid.spacing) as f32;
    let cloud = PointCloud {
        positions: samples.par_iter().map(|sample| grid.mesh_from_cells(sample.at)).collect(),
        colors: Some(colors),
        normals: Some(samples.par_iter().map(|sample| sample.normal).collect()),
        oriented: true,
        radii: Some(samples.par_iter().map(radius).collect()),
        kernels: Some(samples.par_iter().map(|sample| sample.kernel(grid.spacing)).collect()),
        ..PointCloud::default()
    };
    let triangles = samples.par_iter().map(|sample| sample.triangle).collect();
    RasterisedMesh { cloud, triangles, spacing: grid.spacing }
}

#[cfg(test)]
mod tests;
