//! Completes the attributes of a point cloud: normals, radii and kernels, from one search for each point's neighbours.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::kernels::{Bounds, CUTOFF, Fit, circle, fit, is_kernel};
use super::neighbors::{Neighbors, PointTree};
use super::normals::{Frame, NORMAL_NEIGHBORS, is_radius, lone_size, median_of};
use crate::assets::PointCloud;

const RADIUS_NEIGHBORS: usize = 6;
/// Radii below this fraction of the median are raised to it (points at the same place).
const RADIUS_FLOOR: f32 = 0.05;
/// The radius where nothing tells a size: a single point, or all at one place.
const LONE_RADIUS: f32 = 0.5;

/// Gives a cloud the normals and radii that it lacks; what it has is kept, apart from normals of
/// length zero, radii that are not positive, and vectors of a wrong length.
///
/// Afterwards both are present. Normals are unit vectors, or zero where the neighbours lie on a
/// line, on one place, or are fewer than two. Radii are positive, in the units of the positions.
/// Positions that are not finite get a zero normal and the smallest radius.
pub fn estimate_point_attributes(cloud: &mut PointCloud) {
    complete_attributes(cloud, false);
}

/// [`estimate_point_attributes`], and with `wants_kernels` the kernels that [`fit`] finds, in the units of the positions;
/// zero where it finds none.
pub(super) fn complete_attributes(cloud: &mut PointCloud, wants_kernels: bool) -> Vec<Fit> {
    let count = cloud.positions.len();
    cloud.normals = cloud.normals.take().filter(|normals| normals.len() == count);
    cloud.radii = cloud.radii.take().filter(|radii| radii.len() == count);
    let lacks_normals = cloud.normals.as_ref().is_none_or(|n| n.contains(&Vec3::ZERO));
    let lacks_radii = cloud.radii.as_ref().is_none_or(|radii| !radii.iter().all(is_radius));
    if !lacks_normals && !lacks_radii && !wants_kernels {
        return Vec::new();
    }
    let wants = Wants {
        neighbors: if wants_kernels || lacks_normals { NORMAL_NEIGHBORS } else { RADIUS_NEIGHBORS },
        normals: lacks_normals,
        kernels: wants_kernels,
        given: cloud.normals.as_deref().unwrap_or(&[]),
    };
    let Estimates { normals, mut radii, kernels } = estimate(&cloud.positions, &wants);
    if lacks_normals {
        let keep = |(old, new): (&Vec3, &Vec3)| if *old == Vec3::ZERO { *new } else { *old };
        cloud.normals = Some(match cloud.normals.take() {
            Some(old) => old.iter().zip(&normals).map(keep).collect(),
            None => normals,
        });
    }
    if lacks_radii {
        raise_radii(&mut radii);
        let keep = |(old, new): (&f32, &f32)| if is_radius(old) { *old } else { *new };
        cloud.radii = Some(match cloud.radii.take() {
            Some(old) => old.iter().zip(&radii).map(keep).collect(),
            None => radii,
        });
    }
    kernels
}

/// The results that a search has to compute.
struct Wants<'a> {
    neighbors: usize,
    normals: bool,
    kernels: bool,
    /// Normals that are known already, where they are not zero; may be empty.
    given: &'a [Vec3],
}

/// The results of a search for each point, zero if unknown; results that were not requested are empty.
#[derive(Default)]
struct Estimates {
    normals: Vec<Vec3>,
    radii: Vec<f32>,
    kernels: Vec<Fit>,
}

fn estimate(positions: &[DVec3], wants: &Wants) -> Estimates {
    let count = positions.len();
    let mut estimates = Estimates {
        normals: vec![Vec3::ZERO; if wants.normals { count } else { 0 }],
        radii: vec![0.0; count],
        kernels: vec![Fit::default(); if wants.kernels { count } else { 0 }],
    };
    // The tree counts in 32 bits.
    let finite: Vec<u32> = (0..u32::MAX)
        .zip(positions)
        .filter_map(|(index, position)| position.is_finite().then_some(index))
        .collect();
    let Some(frame) = Frame::of(positions, &finite) else { return estimates };
    let local: Vec<[f32; 3]> =
        finite.par_iter().map(|&index| frame.to_local(positions[index as usize])).collect();
    let tree = PointTree::new(local);
    let index_of = |place: usize| finite[tree.order()[place] as usize] as usize;
    let radius = |neighbors: &Neighbors| (f64::from(radius(neighbors)) * frame.size) as f32;
    let normal = |neighbors: &Neighbors| {
        if wants.normals { frame.normal(neighbors) } else { Vec3::ZERO }
    };
    if wants.kernels {
        let found = tree.map_neighbors(wants.neighbors, |neighbors| {
            let normal = normal(&neighbors);
            let given = wants.given.get(index_of(neighbors.place)).copied();
            let given = given.filter(|given| *given != Vec3::ZERO);
            let (fit, _) = fit(&neighbors, given.unwrap_or(normal), given.is_some());
            (normal, radius(&neighbors), fit.scaled(frame.size))
        });
        for (place, (normal, radius, kernel)) in found.into_iter().enumerate() {
            let index = index_of(place);
            estimates.set(index, normal, radius);
            estimates.kernels[index] = kernel;
        }
    } else {
        let visit = |neighbors: Neighbors| (normal(&neighbors), radius(&neighbors));
        for (place, (normal, radius)) in
            tree.map_neighbors(wants.neighbors, visit).into_iter().enumerate()
        {
            estimates.set(index_of(place), normal, radius);
        }
    }
    estimates
}

impl Estimates {
    fn set(&mut self, index: usize, normal: Vec3, radius: f32) {
        if let Some(slot) = self.normals.get_mut(index) {
            *slot = normal;
        }
        self.radii[index] = radius;
    }
}

/// Half the mean distance to the nearest few; zero without any.
fn radius(neighbors: &Neighbors) -> f32 {
    let used = neighbors.len().min(RADIUS_NEIGHBORS);
    let sum: f32 = neighbors.distances_squared().take(used).map(f32::sqrt).sum();
    0.5 * sum / used.max(1) as f32
}

/// Raises radii that are zero or all but zero beside the others.
fn raise_radii(radii: &mut [f32]) {
    let floor = match median_of(radii) {
        Some(median) => (median * RADIUS_FLOOR).max(f32::MIN_POSITIVE),
        None => lone_size(LONE_RADIUS, radii.len()),
    };
    radii.iter_mut().for_each(|radius| *radius = radius.max(floor).min(f32::MAX));
}

/// Gives a cloud the kernels that it lacks, and the normals and radii as
/// [`estimate_point_attributes`] does, from one search for neighbours.
///
/// Call it instead of that function, not after it: a radius that is there on entry is taken for the file's own and makes
/// the kernel circular, so that the disk at [`CUTOFF`] is the file's. All others get the ellipse that the module
/// describes. Kernels that the cloud has are kept, apart from those that are zero or not finite, or whose number is wrong.
///
/// Afterwards every kernel is finite, with `u ⟂ v`, and `u × v` looks along the normal; both are ⟂ to it. Points whose
/// normal is zero have circular kernels in an arbitrary plane. Standard deviations estimated here lie within a 20th of the
/// cloud's median and, on flat surfaces, ten times the median, in volumes and along wires the median; strays, and points at one
/// place with all their neighbours, take the median itself.
pub fn estimate_kernels(cloud: &mut PointCloud) {
    let count = cloud.positions.len();
    let given = cloud.kernels.take().filter(|kernels| kernels.len() == count);
    if given.as_ref().is_some_and(|kernels| kernels.iter().all(is_kernel)) {
        cloud.kernels = given;
        complete_attributes(cloud, false);
        return;
    }
    let of_file = cloud.radii.clone().filter(|radii| radii.len() == count);
    let needs_fit = of_file.as_ref().is_none_or(|radii| !radii.iter().all(is_radius));
    let mut fits = complete_attributes(cloud, needs_fit);
    fits.resize(count, Fit::default());
    let normals = cloud.normals.as_deref().unwrap_or(&[]);
    let bounds = Bounds::of(&fits);
    let settled = fits.into_par_iter().enumerate().map(|(index, fit)| {
        let of_file = of_file.as_ref().and_then(|radii| radii.get(index)).filter(|r| is_radius(r));
        let normal = normals.get(index).copied().unwrap_or(Vec3::ZERO);
        match (given.as_ref().and_then(|given| given.get(index)), of_file) {
            (Some(own), _) if is_kernel(own) => *own,
            (_, Some(&radius)) => circle(normal, radius / CUTOFF),
            _ => bounds.apply(fit, normal),
        }
    });
    cloud.kernels = Some(settled.collect());
}
