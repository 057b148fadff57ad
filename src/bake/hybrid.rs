//! Meshes for point trees (Dachsbacher et al. 2003, §3.8): samples where triangles are smaller than the accepted error, and the
//! triangles everywhere else.
//!
//! A triangle is drawn while its longest side `s` exceeds the accepted error, `s > T(z)`. Where it is not drawn, samples replace
//! it: its own, and samples of its neighbours whose disks lie over the rest of it. Each sample has for an error the shortest `s` of
//! the triangles that it replaces, so it is drawn where any of them is not. Around the border both are drawn, because the test
//! uses the triangle's near end and the sample's own position: there is no seam. Large triangles have one sample, whose disk
//! covers them, or several if they are needles ([`needles`]). Only small ones are rasterised ([`rasterise`](super::rasterise)), with
//! about one sample for each triangle of usual size.
//!
//! Translucent triangles are drawn at any error, because samples hide what is behind them. So are those whose reflection or light varies by a
//! map ([`Material::varies`]): a sample has a colour and a normal, and the rest of its material with all others. Where a mesh has several
//! materials, its samples have none, and triangles are kept that would look otherwise ([`Material::differs`]).

mod needles;

use std::f32::consts::PI;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::groups::Groups;
use super::kernels::{CUTOFF, circle};
use super::pack::ALWAYS;
use super::rasterise::replaced::Replaced;
use super::rasterise::{RasteriseOptions, rasterise_replacing};
use super::sample::SampleError;
use super::sample::color::Colors;
use super::tree::Measures;
use crate::assets::tidy::weld_key;
use crate::assets::{Material, Mesh, MeshPart, PointCloud, Texture};

/// A mesh, prepared for a point tree.
pub struct HybridMesh {
    pub samples: PointCloud,
    /// The measures of each sample.
    pub stands: Vec<Measures>,
    /// The error up to which each triangle is drawn, in mesh units.
    pub sides: Vec<f32>,
    /// The material of all samples: that of all triangles, if they have one.
    pub material: Option<u32>,
}

/// Usual triangles are rasterised with this many samples along their longest side.
const PER_SIDE: f64 = 1.5;
/// Size in cells from which on a triangle is not rasterised.
const LARGE: f64 = 4.0;
/// Triangles for each sample that needles may have beyond one each. Machine parts consist of
/// needles: without a limit they have up to eight times the samples (ADIS16480.STL, 3,718 and 29,957).
const TRIANGLES_PER_MORE: usize = 4;
/// Upper bound of the factor by which coding enlarges an error.
const ROUNDED: f32 = 1.02;

/// Tells whether a mesh is the surface of solids, none of them inside out: every edge has as many triangles on one side as on the
/// other, and every connected part encloses a positive volume. Vertices at one position count as one.
pub fn is_watertight(mesh: &Mesh) -> bool {
    let mut places: Vec<[u64; 3]> = mesh.positions.iter().map(|p| weld_key(*p)).collect();
    let of_vertex = places.clone();
    places.par_sort_unstable();
    places.dedup();
    let number = |v: u32| places.binary_search(of_vertex.get(v as usize)?).ok();
    let mut whole = Groups::new(places.len());
    let mut edges = Vec::with_capacity(3 * mesh.triangles.len());
    let mut triangles = Vec::with_capacity(mesh.triangles.len());
    for &[a, b, c] in &mesh.triangles {
        let (Some(na), Some(nb), Some(nc)) = (number(a), number(b), number(c)) else {
            return false;
        };
        if na == nb || nb == nc || nc == na {
            continue;
        }
        for (from, to) in [(na, nb), (nb, nc), (nc, na)] {
            edges.push(if from < to { (from, to, 1) } else { (to, from, -1) });
            whole.join(from as u32, to as u32);
        }
        triangles.push((na, [a, b, c]));
    }
    edges.par_sort_unstable();
    let balanced = edges
        .chunk_by(|a, b| (a.0, a.1) == (b.0, b.1))
        .all(|edge| edge.iter().map(|(.., side)| side).sum::<i32>() == 0);
    let mut volumes = vec![None; places.len()];
    for (place, corners) in triangles {
        let [a, b, c] = corners.map(|v| mesh.positions[v as usize]);
        // A closed surface's volume does not depend on the origin; a near origin is more exact.
        let (origin, volume) = volumes[whole.root(place as u32) as usize].get_or_insert((a, 0.0));
        *volume += (a - *origin).dot((b - *origin).cross(c - *origin));
    }
    let mut volumes = volumes.into_iter().flatten().peekable();
    balanced && volumes.peek().is_some() && volumes.all(|(_, volume)| volume > 0.0)
}

/// The corners of a triangle, if it can be drawn.
fn corners(mesh: &Mesh, triangle: [u32; 3]) -> Option<[DVec3; 3]> {
    let corner = |v: u32| mesh.positions.get(v as usize).copied().filter(|p| p.is_finite());
    let corners = [corner(triangle[0])?, corner(triangle[1])?, corner(triangle[2])?];
    let [a, b, c] = corners;
    ((b - a).cross(c - a) != DVec3::ZERO).then_some(corners)
}

fn longest_side([a, b, c]: [DVec3; 3]) -> f64 {
    (b - a).length().max((c - b).length()).max((a - c).length())
}

/// Samples a mesh. Its parts refer to `materials`, and the materials to `textures`. Triangles that samples
/// cannot replace have none, and are drawn at any error.
///
/// # Errors
/// Fails if there would be more samples than `max_samples`.
pub fn hybrid_mesh(
    mesh: &Mesh,
    materials: &[Material],
    textures: &[Texture],
    max_samples: u64,
) -> Result<HybridMesh, SampleError> {
    let material = only_material(mesh);
    let lasts =
        |own: &Material| own.translucent || own.varies() || (material.is_none() && own.differs());
    let mut lasting = vec![false; mesh.triangles.len()];
    let mut rest = &mut lasting[..];
    for part in &mesh.parts {
        let (own, behind) = rest.split_at_mut((part.triangles as usize).min(rest.len()));
        let material = part.material.and_then(|number| materials.get(number as usize));
        own.fill(material.is_some_and(lasts));
        rest = behind;
    }
    let side = |(&triangle, &lasting): (&[u32; 3], &bool)| {
        let corners = corners(mesh, triangle).filter(|_| !lasting);
        corners.map_or(0.0, longest_side)
    };
    let sides: Vec<f64> = mesh.triangles.iter().zip(&lasting).map(side).collect();
    let mut known: Vec<f64> = sides.iter().copied().filter(|side| *side > 0.0).collect();
    let always = |lasting: &bool| if *lasting { ALWAYS } else { 0.0 };
    if known.is_empty() {
        let sides = lasting.iter().map(always).collect();
        let samples = PointCloud::default();
        return Ok(HybridMesh { samples, stands: Vec::new(), sides, material });
    }
    let middle = known.len() / 2;
    let (_, &mut usual, _) = known.select_nth_unstable_by(middle, f64::total_cmp);
    let spacing = usual / PER_SIDE;
    let is_large = |side: f64| side > LARGE * spacing;
    let (small, numbers) =
        wanted_part(mesh, |triangle| !is_large(sides[triangle]) && !lasting[triangle]);
    let options = RasteriseOptions { spacing: Some(spacing), max_samples };
    let small_sides: Vec<f64> = numbers.iter().map(|&number| sides[number as usize]).collect();
    let (rasterised, replaced) =
        rasterise_replacing(&small, materials, textures, &options, &small_sides)?;
    let mut samples = rasterised.cloud;
    samples.radii = None;
    let stand = |side: f64, area: f32| {
        let error = side.max(spacing) as f32;
        Measures { error, size: error, area, cone: 0.0 }
    };
    let areas = areas(&small, &rasterised.triangles);
    let of_sample = |(replaced, area): (&Replaced, f32)| Measures {
        cone: replaced.cone,
        ..stand(replaced.side, area)
    };
    let mut stands: Vec<Measures> = replaced.iter().zip(areas).map(of_sample).collect();
    let colors = Colors::of(mesh, materials, textures);
    let large =
        mesh.triangles.iter().zip(&sides).enumerate().filter_map(|(number, (&triangle, &side))| {
            Some((number, triangle, corners(mesh, triangle).filter(|_| is_large(side))?))
        });
    let (count, more) = large.clone().fold((0, 0.0), |(count, more), (.., corners)| {
        (count + 1, more + needles::wanted(corners, spacing) - 1.0)
    });
    let room = max_samples.saturating_sub((samples.positions.len() + count) as u64);
    let most = room.min((mesh.triangles.len() / TRIANGLES_PER_MORE) as u64);
    let share = (most as f64 / more).min(1.0);
    // Samples that needles are entitled to and have not got, less than one.
    let mut due = 0.0;
    for (number, triangle, corners) in large {
        let [a, b, c] = corners;
        let normal = (b - a).cross(c - a).normalize_or_zero().as_vec3();
        let shown = outward(mesh, triangle, normal);
        let cone = if shown == normal { 0.0 } else { PI };
        due += (needles::wanted(corners, spacing) - 1.0) * share;
        let count = 1 + due as usize;
        due = due.fract();
        let area = (area_of(corners) / count as f64) as f32;
        for needles::Disk { centre, radius } in needles::disks(corners, count) {
            let Some(color) = colors.on(number as u32, corners, centre, radius) else { continue };
            samples.positions.push(centre);
            samples.colors.get_or_insert_default().push(color);
            samples.normals.get_or_insert_default().push(shown);
            samples.kernels.get_or_insert_default().push(circle(normal, radius as f32 / CUTOFF));
            stands.push(Measures { cone, ..stand(sides[number], area) });
        }
    }
    let limit = max_samples;
    let count = samples.positions.len() as u64;
    if count > limit {
        return Err(SampleError::TooMany { count, limit });
    }
    let drawn = |(&side, lasting): (&f64, &bool)| {
        if *lasting { ALWAYS } else { stand(side, 0.0).error * ROUNDED }
    };
    let sides = sides.iter().zip(&lasting).map(drawn).collect();
    let samples = PointCloud { oriented: true, ..samples };
    Ok(HybridMesh { samples, stands, sides, material })
}

/// The material that all triangles have.
fn only_material(mesh: &Mesh) -> Option<u32> {
    let mut parts = mesh.parts.iter().filter(|part| part.triangles > 0);
    let first = parts.next()?.material?;
    let covered: usize = mesh.parts.iter().map(|part| part.triangles as usize).sum();
    let alike = parts.all(|part| part.material == Some(first));
    (alike && covered >= mesh.triangles.len()).then_some(first)
}

fn area_of([a, b, c]: [DVec3; 3]) -> f64 {
    0.5 * (b - a).cross(c - a).length()
}

/// The share of its triangle's area that each sample has; the area of triangles without samples is distributed over all samples.
fn areas(mesh: &Mesh, triangles: &[u32]) -> Vec<f32> {
    let area = |triangle| corners(mesh, triangle).map_or(0.0, area_of);
    let areas: Vec<f64> = mesh.triangles.iter().map(|&triangle| area(triangle)).collect();
    let mut counts = vec![0u32; areas.len()];
    triangles.iter().for_each(|&triangle| counts[triangle as usize] += 1);
    let sampled = areas.iter().zip(&counts).filter(|(_, count)| **count > 0);
    let sampled: f64 = sampled.map(|(area, _)| area).sum();
    let more = if sampled > 0.0 { areas.iter().sum::<f64>() / sampled } else { 1.0 };
    let share = |&triangle: &u32| {
        let triangle = triangle as usize;
        (more * areas[triangle] / f64::from(counts[triangle])) as f32
    };
    triangles.iter().map(share).collect()
}

/// The face's normal, on the side of its vertices' normals.
fn outward(mesh: &Mesh, triangle: [u32; 3], normal: Vec3) -> Vec3 {
    let Some(normals) = &mesh.normals else { return normal };
    let sum: Vec3 = triangle.iter().filter_map(|&v| normals.get(v as usize)).sum();
    if sum.dot(normal) < 0.0 { -normal } else { normal }
}

/// The wanted triangles, with all vertices, and the index of each in the whole mesh.
fn wanted_part(mesh: &Mesh, wanted: impl Fn(usize) -> bool) -> (Mesh, Vec<u32>) {
    let mut numbers = Vec::with_capacity(mesh.triangles.len());
    let mut parts = Vec::with_capacity(mesh.parts.len());
    let mut first = 0usize;
    for part in &mesh.parts {
        let end = (first + part.triangles as usize).min(mesh.triangles.len());
        let before = numbers.len();
        numbers.extend((first..end).filter(|&i| wanted(i)).map(|i| i as u32));
        parts.push(MeshPart { triangles: (numbers.len() - before) as u32, ..*part });
        first = end;
    }
    numbers.extend((first..mesh.triangles.len()).filter(|&i| wanted(i)).map(|i| i as u32));
    let triangles = numbers.iter().map(|&i| mesh.triangles[i as usize]).collect();
    let part = Mesh {
        positions: mesh.positions.clone(),
        triangles,
        colors: mesh.colors.clone(),
        normals: mesh.normals.clone(),
        uvs: mesh.uvs.clone(),
        parts,
    };
    (part, numbers)
}

#[cfg(test)]
mod tests;
