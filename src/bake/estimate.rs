//! Normals and kernels of large clouds, packed as they are found.
//!
//! What comes out is word for word what [`super::prepare::prepare_geometry`] and [`super::pack::pack_samples`] make of the same
//! cloud, with less memory, with progress, and with a place to stop at. The cloud is ordered along the curve first. A piece of
//! the curve at a time gets a tree of its own points and of the chunks around it, and the piece's chunks are packed at once.
//!
//! A neighbourhood is complete where its reach is no longer than that of the margin around the piece. The few others are
//! searched for once more among all chunks ([`Chunks::neighborhood`]). Ties are broken by the points' own numbers, so that pieces leave no
//! seam.

mod chunks;

use std::sync::atomic::{AtomicBool, Ordering};

use glam::{DVec3, Vec3};

use self::chunks::{Chunks, Wanted};
use super::kernels::estimate_kernels;
use super::normals::{Frame, is_radius, stride};
use super::pack::{CHUNK, Grid, KERNEL_DETAIL, PackError, PackedSamples, Packing, pack_samples};
use crate::assets::PointCloud;
use crate::math::Bounds;

/// Chunks of a piece.
const PIECE: usize = 512;

/// Why a cloud was not packed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum EstimateError {
    #[error(transparent)]
    Pack(#[from] PackError),
    #[error("stopped before its end")]
    Stopped,
}

/// Whether some sample of a cloud has to be given a normal or a kernel from its neighbours.
pub fn lacks_estimates(cloud: &PointCloud) -> bool {
    lacks_normals(cloud) || !has_radii(cloud)
}

/// Whether some sample of a cloud has to be given a normal from its neighbours.
pub fn lacks_normals(cloud: &PointCloud) -> bool {
    let count = cloud.positions.len();
    let normals = cloud.normals.as_ref().filter(|normals| normals.len() == count);
    normals.is_none_or(|normals| normals.contains(&Vec3::ZERO))
}

fn has_radii(cloud: &PointCloud) -> bool {
    let count = cloud.positions.len();
    let radii = cloud.radii.as_ref().filter(|radii| radii.len() == count);
    radii.is_some_and(|radii| radii.iter().all(is_radius))
}

/// Packs a cloud that has neither kernels nor clip lines, with the normals and kernels that it lacks. `tell` gets the part that is
/// done, of 1.
///
/// # Errors
/// See [`PackError`]; `stop` has become true.
pub fn pack_estimated(
    cloud: PointCloud,
    stop: Option<&AtomicBool>,
    tell: &dyn Fn(f64),
) -> Result<PackedSamples, EstimateError> {
    pack_in_pieces(cloud, PIECE, stop, tell)
}

fn pack_in_pieces(
    mut cloud: PointCloud,
    piece: usize,
    stop: Option<&AtomicBool>,
    tell: &dyn Fn(f64),
) -> Result<PackedSamples, EstimateError> {
    let count = cloud.positions.len();
    cloud.normals = cloud.normals.take().filter(|normals| normals.len() == count);
    cloud.radii = cloud.radii.take().filter(|radii| radii.len() == count);
    let check = || match stop {
        Some(stop) if stop.load(Ordering::Relaxed) => Err(EstimateError::Stopped),
        _ => Ok(()),
    };
    let bounds = Bounds::of_all(&cloud.positions);
    let mut packing = Packing::new(&cloud, Grid::of(&bounds)?)?;
    check()?;
    let step = stride(count);
    let some: Vec<DVec3> = cloud.positions.iter().step_by(step).copied().collect();
    let Some(frame) = Frame::of_some(&some) else { return Ok(packing.finish()) };
    let wanted = Wanted { normals: lacks_normals(&cloud), kernels: !has_radii(&cloud) };
    let order = packing.take_order();
    let chunks = Chunks::new(&cloud, &order, frame, wanted);
    let sampled = chunks.sampled(step);
    let number = chunks.len().div_ceil(piece);
    for at in 0..number {
        check()?;
        let range = at * piece..chunks.len().min((at + 1) * piece);
        let first = range.start * CHUNK;
        let found = chunks.estimate(range.clone(), &sampled);
        packing.fill(&order, range, |rank| found[rank - first]);
        tell((at + 1) as f64 / number as f64);
    }
    let detail = f64::from(packing.longest()) * KERNEL_DETAIL;
    if Grid::with_detail(&bounds, detail)? == packing.grid() {
        return Ok(packing.finish());
    }
    // Kernels so long that cells are larger for them: the curve runs otherwise.
    drop(packing);
    estimate_kernels(&mut cloud);
    Ok(pack_samples(&cloud)?)
}

#[cfg(test)]
mod tests;
