//! Chunks of points along the curve, and the neighbourhoods of their points.

use std::ops::Range;

use glam::Vec3;
use rayon::prelude::*;

use super::super::extent::Extent;
use super::super::kernels::{Bounds as KernelBounds, CUTOFF, Fit, circle, fit};
use super::super::neighbors::{Near, Nearby, Neighbors, PointTree, settled};
use super::super::normals::{Frame, NORMAL_NEIGHBORS, is_radius};
use super::super::pack::CHUNK;
use crate::assets::{Kernel, PointCloud};

/// Quantile of sampled neighbour distances that a margin covers, before [`GENEROUS`].
const QUANTILE: f64 = 0.99;
const GENEROUS: f32 = 2.0;
/// With fewer sampled neighbourhoods, a piece uses those of the whole cloud.
const ENOUGH: usize = 16;
/// Maximum number of chunks in a margin, as a multiple of the piece's.
const MOST_MARGIN: usize = 4;
/// Tolerance for rounding of squared distances.
const SLACK: f32 = 1.0001;

/// The attributes to be estimated from neighbours.
#[derive(Clone, Copy)]
pub(super) struct Wanted {
    pub(super) normals: bool,
    pub(super) kernels: bool,
}

/// The estimates for a point.
#[derive(Clone, Copy, Default)]
struct Fitted {
    normal: Vec3,
    fit: Fit,
}

/// A point in the coordinates of the frame.
#[derive(Clone, Copy)]
struct Local {
    place: [f32; 3],
    /// Index in the cloud.
    index: u32,
    /// Index in its piece; [`MARGIN`] for points of other pieces.
    slot: u32,
}

const MARGIN: u32 = u32::MAX;

/// Squared reaches of sampled neighbourhoods, and the bounds that they give for all.
pub(super) struct Sampled {
    /// Index along the curve, and squared distance of the farthest neighbour.
    reaches: Vec<(usize, f32)>,
    bounds: KernelBounds,
}

/// A cloud's points along the curve.
pub(super) struct Chunks<'a> {
    cloud: &'a PointCloud,
    order: &'a [u32],
    frame: Frame,
    wanted: Wanted,
    /// Boxes of all nodes of a balanced tree: the root is 1, the children of `i` are `2 i` and `2 i + 1`.
    boxes: Vec<Extent>,
    leaves: usize,
    count: usize,
}

impl<'a> Chunks<'a> {
    pub(super) fn new(
        cloud: &'a PointCloud,
        order: &'a [u32],
        frame: Frame,
        wanted: Wanted,
    ) -> Chunks<'a> {
        let count = order.len().div_ceil(CHUNK);
        let leaves = count.next_power_of_two();
        let mut boxes = vec![Extent::EMPTY; 2 * leaves];
        boxes[leaves..].par_iter_mut().zip(order.par_chunks(CHUNK)).for_each(|(own, chunk)| {
            *own = chunk.iter().fold(Extent::EMPTY, |all, &index| {
                all.with(Extent([frame.to_local(cloud.positions[index as usize]); 2]))
            });
        });
        for node in (1..leaves).rev() {
            boxes[node] = boxes[2 * node].with(boxes[2 * node + 1]);
        }
        Chunks { cloud, order, frame, wanted, boxes, leaves, count }
    }

    pub(super) fn len(&self) -> usize {
        self.count
    }

    fn place(&self, index: u32) -> [f32; 3] {
        settled(self.frame.to_local(self.cloud.positions[index as usize]))
    }

    fn ranks(&self, chunk: usize) -> Range<usize> {
        chunk * CHUNK..self.order.len().min((chunk + 1) * CHUNK)
    }

    /// Samples the neighbourhoods of every `step`-th point of the cloud, which bound the kernels of all points.
    pub(super) fn sampled(&self, step: usize) -> Sampled {
        let ranks: Vec<usize> = (0..self.order.len())
            .into_par_iter()
            .filter(|&rank| (self.order[rank] as usize).is_multiple_of(step))
            .collect();
        let (fits, reaches): (Vec<Fit>, Vec<(usize, f32)>) = ranks
            .into_par_iter()
            .map(|rank| {
                let (fitted, reach) = self.neighborhood(self.order[rank]);
                (fitted.fit, (rank, reach))
            })
            .unzip();
        Sampled { reaches, bounds: KernelBounds::of_some(&fits, self.order.len()) }
    }

    /// Estimates normals and kernels of all points of some chunks, in the order of the curve.
    pub(super) fn estimate(&self, piece: Range<usize>, sampled: &Sampled) -> Vec<(Vec3, Kernel)> {
        let ranks = self.ranks(piece.start).start..self.ranks(piece.end - 1).end;
        let (margin, reach) = self.margin(&piece, sampled.reach(&ranks));
        let own = ranks.clone().into_par_iter().map(|rank| self.local(rank, &ranks));
        let others = margin.into_par_iter().flat_map(|chunk| self.ranks(chunk).into_par_iter());
        let mut local: Vec<Local> =
            own.chain(others.map(|rank| self.local(rank, &ranks))).collect();
        // Points at equal distances are ordered by their position in the list.
        local.par_sort_unstable_by_key(|point| point.index);
        let tree = PointTree::new(local.iter().map(|point| point.place));
        let found = tree.map_neighbors(NORMAL_NEIGHBORS, |neighbors| {
            let point = &local[tree.order()[neighbors.place] as usize];
            if point.slot == MARGIN {
                return None;
            }
            let farthest = farthest(&neighbors);
            // Any points at the same position are equally good neighbours.
            let is_complete = farthest * SLACK <= reach || farthest == 0.0;
            let found = is_complete.then(|| self.fitted(&neighbors, point.index));
            let fitted = found.filter(|(_, needed)| *needed == 0.0 || needed * SLACK <= reach);
            Some((point.slot, fitted.map(|(fitted, _)| fitted)))
        });
        drop(tree);
        let mut out = vec![Fitted::default(); ranks.len()];
        let mut strays = Vec::new();
        for (slot, fitted) in found.into_iter().flatten() {
            match fitted {
                Some(fitted) => out[slot as usize] = fitted,
                None => strays.push(slot),
            }
        }
        // A margin that was cut down holds too few points to bound the distance of neighbours.
        let completed: Vec<(u32, Fitted)> = strays
            .into_par_iter()
            .map(|slot| {
                let index = self.order[ranks.start + slot as usize];
                (slot, self.neighborhood(index).0)
            })
            .collect();
        for (slot, fitted) in completed {
            out[slot as usize] = fitted;
        }
        let indices = &self.order[ranks];
        let both = out.into_par_iter().zip(indices);
        both.map(|(fitted, &index)| self.settle(index, fitted, &sampled.bounds)).collect()
    }

    fn local(&self, rank: usize, piece: &Range<usize>) -> Local {
        let index = self.order[rank];
        let slot = if piece.contains(&rank) { (rank - piece.start) as u32 } else { MARGIN };
        Local { place: self.place(index), index, slot }
    }

    /// Finds the chunks around a piece within a squared reach. If those are too many, the reach is reduced; the reach used is
    /// returned.
    fn margin(&self, piece: &Range<usize>, mut reach: f32) -> (Vec<usize>, f32) {
        if piece.len() == self.count {
            return (Vec::new(), f32::INFINITY);
        }
        loop {
            let mut near = vec![false; self.count];
            let mut stack = Vec::new();
            for chunk in piece.clone() {
                let own = self.boxes[self.leaves + chunk];
                stack.push(1);
                while let Some(node) = stack.pop() {
                    if self.boxes[node].distance_squared(&own) > reach * SLACK {
                        continue;
                    }
                    if node < self.leaves {
                        stack.extend([2 * node, 2 * node + 1]);
                    } else if let Some(near) = near.get_mut(node - self.leaves) {
                        *near = true;
                    }
                }
            }
            let is_other = |chunk: &usize| near[*chunk] && !piece.contains(chunk);
            let margin: Vec<usize> = (0..self.count).filter(is_other).collect();
            if margin.len() <= MOST_MARGIN * piece.len() {
                return (margin, reach);
            }
            if reach <= f32::MIN_POSITIVE {
                // Too many points share one position: no neighbourhood is complete.
                return (Vec::new(), -1.0);
            }
            reach *= 0.25;
        }
    }

    /// Estimates one point from all others; also returns the squared distance of its farthest neighbour.
    fn neighborhood(&self, index: u32) -> (Fitted, f32) {
        let place = self.place(index);
        let point = Extent([place; 2]);
        let mut nearby = Nearby::default();
        let mut stack = vec![1];
        while let Some(node) = stack.pop() {
            if self.boxes[node].distance_squared(&point) > nearby.bound() * SLACK {
                continue;
            }
            if node < self.leaves {
                // The nearer child is pushed last, so it is visited first.
                let far = |child: usize| self.boxes[child].distance_squared(&point);
                let (left, right) = (2 * node, 2 * node + 1);
                stack.extend(if far(left) <= far(right) { [right, left] } else { [left, right] });
                continue;
            }
            let chunk = node - self.leaves;
            if chunk >= self.count {
                continue;
            }
            let is_place = self.boxes[node].is_place();
            for &other in self.order[self.ranks(chunk)].iter().filter(|&&other| other != index) {
                // Points at one position are sorted by index: if one is rejected, all that follow are as well.
                if !nearby.add(Near::new(self.place(other), place, other)) && is_place {
                    break;
                }
            }
        }
        let all = nearby.with_own(index, place);
        let tree = PointTree::new(all.iter().map(|&(_, place)| place));
        let found = tree.map_neighbors(NORMAL_NEIGHBORS, |neighbors| {
            let is_own = all[tree.order()[neighbors.place] as usize].0 == index;
            is_own.then(|| (self.fitted(&neighbors, index).0, farthest(&neighbors)))
        });
        found.into_iter().flatten().next().unwrap_or((Fitted::default(), f32::INFINITY))
    }

    fn given_normal(&self, index: u32) -> Vec3 {
        self.cloud.normals.as_ref().map_or(Vec3::ZERO, |normals| normals[index as usize])
    }

    /// Also returns up to which squared distance the estimates depend on other points than the neighbours; 0 where they do not.
    fn fitted(&self, neighbors: &Neighbors, index: u32) -> (Fitted, f32) {
        let normal = if self.wanted.normals { self.frame.normal(neighbors) } else { Vec3::ZERO };
        let given = self.given_normal(index);
        let own = if given == Vec3::ZERO { normal } else { given };
        let (fit, needed) = match self.wanted.kernels {
            true => fit(neighbors, own, given != Vec3::ZERO),
            false => (Fit::default(), 0.0),
        };
        (Fitted { normal, fit: fit.scaled(self.frame.size) }, needed)
    }

    /// Values from the file take precedence over estimates.
    fn settle(&self, index: u32, fitted: Fitted, bounds: &KernelBounds) -> (Vec3, Kernel) {
        let given = self.given_normal(index);
        let normal = if given == Vec3::ZERO { fitted.normal } else { given };
        let radius = self.cloud.radii.as_ref().map(|radii| radii[index as usize]);
        let kernel = match radius.filter(is_radius) {
            Some(radius) => circle(normal, radius / CUTOFF),
            None => bounds.apply(fitted.fit, normal),
        };
        (normal, kernel)
    }
}

impl Sampled {
    /// The squared reach of most neighbourhoods in a stretch of the curve, enlarged by a margin.
    fn reach(&self, ranks: &Range<usize>) -> f32 {
        let first = self.reaches.partition_point(|&(rank, _)| rank < ranks.start);
        let end = self.reaches.partition_point(|&(rank, _)| rank < ranks.end);
        let own = &self.reaches[first..end];
        let measured = if own.len() < ENOUGH { &self.reaches[..] } else { own };
        let mut reaches: Vec<f32> = measured.iter().map(|&(_, reach)| reach).collect();
        reaches.sort_unstable_by(f32::total_cmp);
        let at = ((reaches.len() as f64 - 1.0) * QUANTILE) as usize;
        reaches.get(at).map_or(0.0, |reach| reach * GENEROUS * GENEROUS)
    }
}

/// Squared distance of the farthest neighbour; infinite if there are too few neighbours.
fn farthest(neighbors: &Neighbors) -> f32 {
    match neighbors.len() == NORMAL_NEIGHBORS {
        true => neighbors.distances_squared().last().unwrap_or(f32::INFINITY),
        false => f32::INFINITY,
    }
}
