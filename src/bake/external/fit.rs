//! Second phase: estimates normals and kernels from neighbours, one piece of the points at a time.
//!
//! Besides a piece's own points, memory holds the points within a margin of its box. The margin is the reach of most
//! neighbourhoods, estimated from a sample. A neighbourhood that fits into the margin is complete. The other neighbourhoods, of
//! strays and of places much sparser than the rest, wait and are completed from each piece that may hold a nearer point.
//! Neighbours are therefore those of the whole cloud, and there is no seam.

use std::io;

use bytemuck::{Pod, Zeroable};
use glam::Vec3;
use rayon::prelude::*;

use super::super::kernels::{Bounds, Fit, circle, fit};
use super::super::neighbors::{AROUND, Nearby, Neighbors, PointTree, settled};
use super::super::normals::{NORMAL_NEIGHBORS, stride};
use super::pieces::Place;
use super::points::{Point, Points};
use super::spill::SpillFile;
use super::{Phase, Work};
use crate::assets::Kernel;

/// The normal and kernel of a point, estimated from its neighbours.
#[derive(Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub(super) struct Fitted {
    normal: [f32; 3],
    u: [f32; 3],
    v: [f32; 3],
    /// Same value as [`Fit::most`].
    most: f32,
    /// Same value as [`Fit::is_grouped`], as 0 or 1.
    is_grouped: u32,
}

/// The estimates of all points, in the order of the points' file, and the bounds of kernels.
pub(super) struct Fits {
    file: Option<SpillFile<Fitted>>,
    bounds: Option<Bounds>,
}

/// Number of sampled neighbourhoods that determine the margin.
const SAMPLED: usize = 512;
/// Share of the sampled neighbourhoods that fit into the margin, and the factor by which the margin is enlarged.
const QUANTILE: f64 = 0.95;
const GENEROUS: f32 = 1.5;
/// Tolerance for rounding.
const SLACK: f32 = 1.0001;

impl Fits {
    pub(super) fn of(points: &Points, work: &Work) -> io::Result<Fits> {
        let lacks_kernels = points.lacks_kernels;
        if !points.lacks_normals && !lacks_kernels {
            return Ok(Fits { file: None, bounds: None });
        }
        let mut file = work.spill.file()?;
        let mut waiting = Vec::new();
        let most = (work.memory.to_merge() / 2 / size_of::<Waiting>()).max(100);
        for (number, piece) in points.pieces.iter().enumerate() {
            let Found { fitted, strays } = near(points, number, work)?;
            file.extend(&fitted)?;
            drop(fitted);
            for Stray { slot, farthest } in strays {
                let at = piece.range.start + u64::from(slot);
                waiting.push(Waiting::new(points, at, farthest)?);
                if waiting.len() >= most {
                    complete(points, std::mem::take(&mut waiting), &mut file)?;
                }
            }
            work.tell(Phase::Neighbors, piece.range.end as f64 / points.file.count() as f64);
        }
        complete(points, waiting, &mut file)?;
        let bounds = if lacks_kernels { Some(bounds(points, &file)?) } else { None };
        Ok(Fits { file: Some(file), bounds })
    }

    /// Calls `take` with each point in the file's order, its normal and its kernel.
    pub(super) fn each(
        &self,
        points: &Points,
        bytes: usize,
        mut take: impl FnMut(&Point, Vec3, Kernel) -> io::Result<()>,
    ) -> io::Result<()> {
        let all = 0..points.file.count();
        let mut walk = points.file.walk(all.clone(), bytes);
        let mut fits = self.file.as_ref().map(|file| file.walk(all, bytes));
        while let Some(point) = walk.next()? {
            let fitted = match &mut fits {
                Some(fits) => fits.next()?,
                None => None,
            };
            let (normal, kernel) = self.settle(&point, fitted.unwrap_or_default());
            take(&point, normal, kernel)?;
        }
        Ok(())
    }

    /// The normal and kernel of one point.
    pub(super) fn one(&self, points: &Points, at: u64) -> io::Result<(Point, Vec3, Kernel)> {
        let mut point = [Point::zeroed()];
        points.file.read(at, &mut point)?;
        let mut fitted = [Fitted::default()];
        if let Some(file) = &self.file {
            file.read(at, &mut fitted)?;
        }
        let (normal, kernel) = self.settle(&point[0], fitted[0]);
        Ok((point[0], normal, kernel))
    }

    /// Values from the file take precedence over estimates.
    fn settle(&self, point: &Point, fitted: Fitted) -> (Vec3, Kernel) {
        let given = point.normal();
        let normal = if given == Vec3::ZERO { Vec3::from(fitted.normal) } else { given };
        let kernel = match (point.deviation(), &self.bounds) {
            (Some(deviation), _) => circle(normal, deviation),
            (None, Some(bounds)) => bounds.apply(fitted.fit(), normal),
            (None, None) => fitted.kernel(),
        };
        (normal, kernel)
    }
}

impl Fitted {
    fn fit(&self) -> Fit {
        Fit { kernel: self.kernel(), most: self.most, is_grouped: self.is_grouped != 0 }
    }

    fn kernel(&self) -> Kernel {
        Kernel { u: self.u.into(), v: self.v.into() }
    }

    /// Builds the estimate from the neighbours of a point with this normal, if it is not zero. Also returns up to which squared distance
    /// the estimate depends on other points than the neighbours; 0 where it does not.
    fn of(points: &Points, neighbors: &Neighbors, given: Vec3) -> (Fitted, f32) {
        let normal = if points.lacks_normals { points.frame.normal(neighbors) } else { Vec3::ZERO };
        let own = if given == Vec3::ZERO { normal } else { given };
        let (fit, needed) = match points.lacks_kernels {
            true => fit(neighbors, own, given != Vec3::ZERO),
            false => (Fit::default(), 0.0),
        };
        let Fit { kernel, most, is_grouped } = fit.scaled(points.frame.size);
        let fitted = Fitted {
            normal: normal.into(),
            u: kernel.u.into(),
            v: kernel.v.into(),
            most,
            is_grouped: is_grouped.into(),
        };
        (fitted, needed)
    }
}

/// Bounds of all kernels, from a sample of them.
fn bounds(points: &Points, file: &SpillFile<Fitted>) -> io::Result<Bounds> {
    let step = stride(points.file.count() as usize) as u32;
    let mut some = Vec::new();
    let mut at = 0;
    points.file.each_block(|block| {
        for point in block {
            if point.index.is_multiple_of(step) {
                let mut fitted = [Fitted::default()];
                file.read(at, &mut fitted)?;
                some.push(fitted[0].fit());
            }
            at += 1;
        }
        Ok(())
    })?;
    Ok(Bounds::of_some(&some, points.file.count() as usize))
}

/// A point in the coordinates of the frame.
#[derive(Clone, Copy)]
struct Local {
    place: [f32; 3],
    /// Index in the file as it was read.
    index: u32,
    /// Index in the piece, for the piece's own points.
    slot: Option<u32>,
}

/// The estimates of a piece's points, and the points whose neighbourhoods are incomplete.
struct Found {
    fitted: Vec<Fitted>,
    strays: Vec<Stray>,
}

/// A point whose surroundings may lie outside the points in memory, with a bound on the squared distance of what matters.
struct Stray {
    slot: u32,
    farthest: f32,
}

fn near(points: &Points, number: usize, work: &Work) -> io::Result<Found> {
    let piece = &points.pieces[number];
    let places = points.places.load(piece.range.clone())?;
    let count = places.len();
    let mut local: Vec<Local> = places
        .into_iter()
        .zip(0..)
        .map(|(Place { at, index }, slot)| Local { place: at, index, slot: Some(slot) })
        .collect();
    let mut given = Vec::new();
    if points.oriented {
        let mut walk = points.file.walk(piece.range.clone(), 1 << 18);
        while let Some(point) = walk.next()? {
            given.push(point.normal());
        }
    }
    local.par_sort_unstable_by_key(|point| point.index);
    let alone = points.pieces.len() == 1;
    let mut reach = f32::INFINITY;
    if !alone {
        reach = usual_reach(&local);
        let (margin, left) = margin(points, number, reach, work)?;
        reach = left;
        local.extend(margin);
        // Points at equal distances are ordered by their position in the list.
        local.par_sort_unstable_by_key(|point| point.index);
    }
    let tree = PointTree::new(local.iter().map(|point| point.place));
    let found = tree.map_neighbors(NORMAL_NEIGHBORS, |neighbors| {
        let slot = local[tree.order()[neighbors.place] as usize].slot?;
        let farthest = match neighbors.len() == NORMAL_NEIGHBORS {
            true => neighbors.distances_squared().last().unwrap_or(f32::INFINITY),
            false => f32::INFINITY,
        };
        // Any neighbours at the same position are equally good.
        if alone || farthest * SLACK <= reach || farthest == 0.0 {
            let given = given.get(slot as usize).copied().unwrap_or(Vec3::ZERO);
            let (fitted, needed) = Fitted::of(points, &neighbors, given);
            if alone || needed == 0.0 || needed * SLACK <= reach {
                return Some((fitted, None));
            }
        }
        Some((Fitted::default(), Some(neighbors.around(&mut Vec::new()))))
    });
    let mut out = Found { fitted: vec![Fitted::default(); count], strays: Vec::new() };
    for (&id, found) in tree.order().iter().zip(found) {
        let (Some(slot), Some((fitted, farthest))) = (local[id as usize].slot, found) else {
            continue;
        };
        out.fitted[slot as usize] = fitted;
        out.strays.extend(farthest.map(|farthest| Stray { slot, farthest }));
    }
    Ok(out)
}

/// The squared reach of most neighbourhoods within a piece, enlarged by [`GENEROUS`].
fn usual_reach(local: &[Local]) -> f32 {
    let tree = PointTree::new(local.iter().map(|point| point.place));
    let places = local.iter().step_by(local.len().div_ceil(SAMPLED).max(1));
    let mut reaches: Vec<f32> = places
        .map(|point| {
            let mut found = Vec::new();
            // The search also finds the point itself.
            tree.nearest(point.place, AROUND + 1, &mut found);
            found.last().map_or(0.0, |&(distance, _)| distance)
        })
        .collect();
    reaches.sort_unstable_by(f32::total_cmp);
    let at = ((reaches.len() as f64 - 1.0) * QUANTILE) as usize;
    reaches.get(at).map_or(0.0, |reach| reach * GENEROUS * GENEROUS)
}

/// Loads other pieces' points within a squared reach of a piece's box. If those are too many, the reach is reduced; the reach
/// used is returned.
fn margin(
    points: &Points,
    number: usize,
    mut reach: f32,
    work: &Work,
) -> io::Result<(Vec<Local>, f32)> {
    let piece = &points.pieces[number];
    let most = work.memory.of_pieces();
    let mut margin: Vec<Local> = Vec::new();
    for (other, behind) in points.pieces.iter().enumerate() {
        if other == number || piece.gap_squared(behind) > reach {
            continue;
        }
        let mut walk = points.places.walk(behind.range.clone(), 1 << 18);
        while let Some(Place { at, index }) = walk.next()? {
            if piece.distance_squared(at) > reach {
                continue;
            }
            margin.push(Local { place: at, index, slot: None });
            while margin.len() > most {
                // Too many points share one position: no neighbourhood is complete.
                reach = if reach > f32::MIN_POSITIVE { reach * 0.25 } else { -1.0 };
                margin.retain(|point| piece.distance_squared(point.place) <= reach);
            }
        }
    }
    Ok((margin, reach))
}

/// A stray whose neighbours are being searched.
struct Waiting {
    /// Index in the points' file.
    at: u64,
    place: [f32; 3],
    index: u32,
    /// Bound on the squared distance of all points that the estimates depend on.
    farthest: f32,
    found: Nearby,
}

impl Waiting {
    fn new(points: &Points, at: u64, farthest: f32) -> io::Result<Waiting> {
        let mut place = [Place::zeroed()];
        points.places.read(at, &mut place)?;
        let [Place { at: place, index }] = place;
        Ok(Waiting { at, place, index, farthest, found: Nearby::default() })
    }
}

/// Finds the neighbours of the waiting points in all pieces, and writes their estimates.
fn complete(
    points: &Points,
    mut waiting: Vec<Waiting>,
    file: &mut SpillFile<Fitted>,
) -> io::Result<()> {
    for piece in &points.pieces {
        let wanted =
            |point: &Waiting| piece.distance_squared(point.place) <= point.farthest * SLACK;
        if !waiting.iter().any(wanted) {
            continue;
        }
        let mut local = points.places.load(piece.range.clone())?;
        local.par_sort_unstable_by_key(|place| place.index);
        let tree = PointTree::new(local.iter().map(|place| place.at));
        waiting.par_iter_mut().filter(|point| wanted(point)).for_each(|point| {
            let of_others =
                |id: u32| Some(local[id as usize].index).filter(|id| *id != point.index);
            tree.add_nearby(settled(point.place), &mut point.found, of_others);
            point.farthest = point.farthest.min(point.found.bound());
        });
    }
    for point in waiting {
        let all = point.found.with_own(point.index, point.place);
        let tree = PointTree::new(all.iter().map(|&(_, place)| place));
        let mut own = [Point::zeroed()];
        points.file.read(point.at, &mut own)?;
        let found = tree.map_neighbors(NORMAL_NEIGHBORS, |neighbors| {
            let is_own = all[tree.order()[neighbors.place] as usize].0 == point.index;
            is_own.then(|| Fitted::of(points, &neighbors, own[0].normal()).0)
        });
        let fitted = found.into_iter().flatten().next().unwrap_or_default();
        file.put(point.at, &fitted)?;
    }
    Ok(())
}
