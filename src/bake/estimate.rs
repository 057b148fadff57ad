//! Estimates normals and kernels of large clouds and packs them piece by piece.
//!
//! The result equals word for word that of [`super::prepare::prepare_geometry`] and [`super::pack::pack_samples`] for the same
//! cloud, but takes less memory, reports progress and can be cancelled. The cloud is first sorted along the curve. For one piece
//! of the curve at a time, a tree is built of the piece's points and of the chunks around it, and the piece's chunks are packed
//! at once.
//!
//! A neighbourhood is complete if its reach is no longer than the margin around the piece. The few others are searched again
//! among all chunks ([`Chunks::neighborhood`]). Ties are broken by the points' indices, so pieces leave no seam.

mod chunks;

use std::sync::atomic::{AtomicBool, Ordering};

use glam::{DVec3, Vec3};

use self::chunks::{Chunks, Wanted};
use super::attributes::estimate_kernels;
use super::normals::{Frame, is_radius, stride};
use super::pack::{CHUNK, Grid, KERNEL_DETAIL, PackError, PackedSamples, Packing, pack_samples};
use crate::assets::PointCloud;
use crate::math::Bounds;

/// Number of chunks in a piece.
const PIECE: usize = 512;

/// Why a cloud was not packed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum EstimateError {
    #[error(transparent)]
    Pack(#[from] PackError),
    #[error("stopped before its end")]
    Stopped,
}

/// Tells whether some sample of a cloud needs a normal or a kernel estimated from its neighbours.
pub fn lacks_estimates(cloud: &PointCloud) -> bool {
    lacks_normals(cloud) || !has_radii(cloud)
}

/// Tells whether some sample of a cloud needs a normal estimated from its neighbours.
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

/// Packs a cloud without kernels and clip lines and estimates the normals and kernels that it lacks. `tell` receives the
/// progress, from 0 to 1.
///
/// # Errors
/// Fails with a [`PackError`], or when `stop` has become true.
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
    let Some(frame) = Frame::of_some(&some) else { return Ok(packing.finish(&[])) };
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
        return Ok(packing.finish(&order));
    }
    // Long kernels enlarge the cells of the grid, which changes the curve.
    drop(packing);
    estimate_kernels(&mut cloud);
    Ok(pack_samples(&cloud)?)
}

#[cfg(test)]
mod tests;
