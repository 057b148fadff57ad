//! Estimate of the share of a surface that splats leave uncovered.
//!
//! A sample's Voronoi cell in its tangent plane holds all places that are nearer to it than to any other sample. Disks of [`CUTOFF`] standard
//! deviations should cover it: the sample's own, or those of its neighbours. Some samples are looked at, evenly spread over a cloud, and of each cell
//! some places. Cells at the border of a cloud have no end, and neighbourhoods that are no surface have no cells; both are left out.

use glam::{DVec3, I64Vec3, Vec2, Vec3};

use super::kernels::{CUTOFF, Cell, ROUGH, is_kernel, proportions, tangents};
use super::neighbors::AROUND;
use super::pack::{NO_NORMAL, PackedChunk, PackedSamples, octahedral_decode, unpack_kernel};
use crate::assets::Kernel;

/// Samples that are looked at, and the most chunks that they are taken from.
const SAMPLES: usize = 1024;
const CHUNKS: usize = 64;
/// Neighbours that bound a cell: as many as kernels of open cells depend on.
const NEAR: usize = AROUND;
/// Corners of a square, and one for each neighbour.
const CORNERS: usize = 5 + NEAR;
/// Margin around a chunk within which neighbours are looked for, in diagonals of its box.
const MARGIN: f64 = 0.25;
/// Each side of a triangle of a cell is divided so often; places lie in the middle of the parts.
const PARTS: usize = 3;

/// A sample with its kernel.
#[derive(Clone, Copy)]
struct Disk {
    centre: DVec3,
    kernel: Kernel,
    /// Zero where it has none.
    normal: Vec3,
}

impl Disk {
    /// Whether the disk holds a place, in its own plane.
    fn covers(&self, place: DVec3) -> bool {
        let way = (place - self.centre).as_vec3();
        let along = |axis: Vec3| way.dot(axis) / axis.length_squared();
        Vec2::new(along(self.kernel.u), along(self.kernel.v)).length_squared() <= CUTOFF * CUTOFF
    }
}

/// Estimates the share, 0 to 1, of the sampled surface that is in no splat. `None` for a cloud without kernels, and where no
/// neighbourhood looks like a surface.
pub fn uncovered_share(samples: &PackedSamples) -> Option<f64> {
    let step = samples.chunks.len().div_ceil(CHUNKS).max(1);
    let looked_at = samples.chunks.iter().step_by(step);
    let each = (SAMPLES / looked_at.len().max(1)).max(1);
    let (mut uncovered, mut total) = (0.0, 0.0);
    for chunk in looked_at {
        let near = disks_about(samples, chunk);
        let every = (chunk.count as usize).div_ceil(each).max(1);
        for disk in disks_of(samples, chunk).step_by(every) {
            if let Some((open, area)) = uncovered_of(&disk, &near) {
                uncovered += open;
                total += area;
            }
        }
    }
    (total > 0.0).then(|| uncovered / total)
}

fn disks_of<'a>(
    samples: &'a PackedSamples,
    chunk: &'a PackedChunk,
) -> impl Iterator<Item = Disk> + 'a {
    let base = chunk.kernel_base * samples.grid.step as f32 * (chunk.shift as f32).exp2();
    chunk.elements().filter_map(move |index| {
        let normal = samples.attributes[index][1];
        let kernel = unpack_kernel(samples.kernels[index], normal, base);
        let normal = if normal == NO_NORMAL { Vec3::ZERO } else { octahedral_decode(normal) };
        let centre = samples.grid.position(chunk.cell(samples.positions[index]));
        is_kernel(&kernel).then_some(Disk { centre, kernel, normal })
    })
}

/// The disks in and near a chunk.
fn disks_about(samples: &PackedSamples, chunk: &PackedChunk) -> Vec<Disk> {
    let ends = |chunk: &PackedChunk| {
        let low = chunk.origin.as_i64vec3();
        // Extents may use all 32 bits.
        (low, low + chunk.extent.as_uvec3().as_i64vec3())
    };
    let (low, high) = ends(chunk);
    let margin = I64Vec3::splat((MARGIN * (high - low).as_dvec3().length()) as i64);
    let (low, high) = (low - margin, high + margin);
    let meets = |other: &&PackedChunk| {
        let (other_low, other_high) = ends(other);
        other_low.cmple(high).all() && other_high.cmpge(low).all()
    };
    samples.chunks.iter().filter(meets).flat_map(|chunk| disks_of(samples, chunk)).collect()
}

/// The uncovered and the whole area of a disk's cell; `None` where there is no cell.
fn uncovered_of(disk: &Disk, all: &[Disk]) -> Option<(f64, f64)> {
    if disk.normal == Vec3::ZERO {
        return None;
    }
    let mut near: Vec<(f64, &Disk)> =
        all.iter().map(|other| (other.centre.distance_squared(disk.centre), other)).collect();
    // The disk itself is among them.
    if near.len() > NEAR + 1 {
        near.select_nth_unstable_by(NEAR, |a, b| a.0.total_cmp(&b.0));
        near.truncate(NEAR + 1);
    }
    near.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let farthest = near.last()?.0.sqrt() as f32;
    let offsets: Vec<Vec3> =
        near.iter().map(|(_, other)| (other.centre - disk.centre).as_vec3()).collect();
    let [a, b] = tangents(disk.normal);
    let flat: Vec<Vec2> = offsets.iter().map(|q| Vec2::new(q.dot(a), q.dot(b))).collect();
    if proportions(&offsets, &flat, disk.normal)[0] > ROUGH {
        return None;
    }
    let cell = Cell::<CORNERS>::of(&flat, 2.0 * farthest, 1e-8 * farthest * farthest);
    let extent = cell.extent();
    if extent.is_nan() || extent >= farthest {
        return None;
    }
    let (mut open, mut whole) = (0.0, 0.0);
    let corners = cell.corners();
    for (from, to) in corners.iter().zip(corners.iter().cycle().skip(1)) {
        let area = 0.5 * f64::from(from.perp_dot(*to).abs());
        whole += area;
        let places = places(*from, *to).map(|at| disk.centre + (a * at.x + b * at.y).as_dvec3());
        let (mut count, mut missed) = (0.0, 0.0);
        for place in places {
            count += 1.0;
            missed += f64::from(u8::from(!near.iter().any(|(_, disk)| disk.covers(place))));
        }
        open += area * missed / count;
    }
    Some((open, whole))
}

/// Places spread over the triangle of the origin and two corners.
fn places(from: Vec2, to: Vec2) -> impl Iterator<Item = Vec2> {
    let share = |index: usize| (index as f32 + 1.0 / 3.0) / PARTS as f32;
    (0..PARTS).flat_map(move |i| (0..PARTS - i).map(move |j| from * share(i) + to * share(j)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::assets::{Geometry, PointCloud};
    use crate::bake::pack::pack_samples;
    use crate::bake::prepare::{AssetTraits, prepare_geometry};
    use crate::memory::Admission;
    use crate::scene::random::SplitMix64;

    /// A cloud with the kernels that the program gives it, and their size multiplied.
    fn share(positions: Vec<DVec3>, width: f32) -> Option<f64> {
        let mut geometry = Geometry::Points(PointCloud { positions, ..PointCloud::default() });
        prepare_geometry(&mut geometry, &mut AssetTraits::default(), &Admission::default())
            .unwrap();
        let Geometry::Points(mut cloud) = geometry else { panic!("no cloud") };
        for kernel in cloud.kernels.iter_mut().flatten() {
            *kernel = Kernel { u: kernel.u * width, v: kernel.v * width };
        }
        uncovered_share(&pack_samples(&cloud).unwrap())
    }

    fn ball(count: usize) -> Vec<DVec3> {
        let mut numbers = SplitMix64::new(11);
        (0..count)
            .map(|_| {
                let height = numbers.range(-1.0, 1.0);
                let (sin, cos) = numbers.range(0.0, std::f64::consts::TAU).sin_cos();
                let width = (1.0 - height * height).sqrt();
                DVec3::new(width * cos, width * sin, height)
            })
            .collect()
    }

    #[test]
    fn random_samples_of_a_surface_leave_next_to_nothing_uncovered() {
        let own = share(ball(20_000), 1.0).unwrap();
        assert!(own < 1e-3, "{own}");
        let half = share(ball(20_000), 0.5).unwrap();
        assert!((0.1..0.9).contains(&half), "{half}");
    }

    #[test]
    fn a_lattice_of_disks_leaves_what_is_between_circles() {
        let lattice = || (0..4096).map(|i| DVec3::new(f64::from(i % 64), f64::from(i / 64), 0.0));
        assert_eq!(share(lattice().collect(), 1.0), Some(0.0));
        // Circles that reach the corners of cells, at two thirds of their size: r² = 2/9, less than half a cell.
        let narrow = share(lattice().collect(), 2.0 / 3.0 / 1.05).unwrap();
        let uncovered = 1.0 - std::f64::consts::PI * 2.0 / 9.0;
        assert!((narrow - uncovered).abs() < 0.05, "{narrow} for {uncovered}");
    }

    #[test]
    fn what_is_no_surface_has_no_share() {
        assert_eq!(share(ball(3), 1.0), None);
        assert_eq!(uncovered_share(&pack_samples(&PointCloud::default()).unwrap()), None);
    }
}
