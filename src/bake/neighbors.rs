//! The k nearest neighbours of every point of a cloud, exactly.
//!
//! Points are ordered by a balanced k-d tree: each node halves its points at the median of its
//! longest extent, down to leaves of 16 to 32 points, so that a node's range follows from its number
//! alone and nothing is stored but a tight box for each node. Queries run leaf by leaf. The points
//! of a leaf first look at each other; the farthest k-th distance bounds which other leaves matter,
//! and one walk from the root gathers those for all points of the leaf; each point then scans the
//! gathered leaves whose box is nearer than its own k-th neighbour so far. Distances are computed
//! for a whole leaf at a time, on separate arrays of x, y and z, which compilers vectorise.
//!
//! Points at equal distance are ordered by index, so that neighbours do not depend on the other points in the tree: lattices, and
//! scans with coordinates in centimetres, have many equal distances.
//!
//! If many points share a position, only the first [`COPIES`] are in the tree: no query finds more of them. All others have the
//! same neighbours, the first ones, which are known without a search. Points without depth at a scanner's own position, or
//! coordinates that a file has rounded to one position, therefore cost no more than others.
//!
//! Measured with 1 M points on a sphere, one in eight of them in a cluster of a 300th of its size,
//! k = 12, optimised for a generic x86-64, on a 2-core virtual machine, tree included: 0.69 s on one
//! core and 0.35 s on two, where kiddo 6.3 takes 2.19 s and 0.81 s (`speed_against_kiddo` in the
//! tests prints both). With normals and radii, 0.83 s on one core and 0.43 s on two.

mod aabb;
mod places;

use std::cmp::Ordering;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use aabb::Aabb;
use rayon::prelude::*;

pub(super) use places::{AROUND, Near, Nearby, Places};

/// Leaves hold at most this many points, and more than half as many unless there is only one.
const LEAF_POINTS: usize = 32;
/// Most neighbours that can be asked for: a leaf has at least 15 others for each of its points.
pub(super) const MAX_NEIGHBORS: usize = 15;
/// Points at one place that the tree keeps: one, and all the neighbours that it can have.
const COPIES: usize = MAX_NEIGHBORS + 1;
/// Coordinates below the first are multiples of the second, a part in 2²⁴ of it, so that the square of the least distance
/// between two places is a normal number.
const FINE: f32 = 1.0 / (1u64 << 38) as f32;
const GRAIN: f32 = 1.0 / (1u64 << 62) as f32;
/// Subtrees with fewer points are built, and ranges with fewer leaves searched, on one thread.
const SERIAL_POINTS: usize = 8192;
const SERIAL_LEAVES: usize = 64;

/// A point while the tree is built.
#[derive(Clone, Copy, Debug)]
struct Item {
    position: [f32; 3],
    index: u32,
}

impl Item {
    fn new(position: [f32; 3], index: u32) -> Self {
        Self { position: settled(position), index }
    }
}

/// A point's place as the tree has it.
pub(super) fn settled(position: [f32; 3]) -> [f32; 3] {
    // Adding zero makes one zero of two.
    position.map(|v| if v.abs() < FINE { (v / GRAIN).round() * GRAIN + 0.0 } else { v })
}

/// More points at one place than the tree keeps.
struct SamePlace {
    /// Indices of the first [`COPIES`], ascending.
    kept: [u32; COPIES],
    /// The others, in the tree's order.
    others: std::ops::Range<usize>,
}

/// Points in tree order, and behind them those that are not in the tree.
pub(super) struct PointTree {
    x: Vec<f32>,
    y: Vec<f32>,
    z: Vec<f32>,
    /// For each place in tree order the point's own index.
    order: Vec<u32>,
    same_places: Vec<SamePlace>,
    /// Points and boxes that searches for all points' neighbours have looked at.
    visited: AtomicU64,
    /// Boxes of all nodes: the root is 1, the children of `i` are `2 i` and `2 i + 1`.
    boxes: Vec<Aabb>,
    /// Halvings between root and leaves.
    levels: u32,
}

/// The neighbours of one point, nearest first.
pub(super) struct Neighbors<'a> {
    tree: &'a PointTree,
    /// Place of the point itself in tree order.
    pub place: usize,
    /// A place in the tree with the point's coordinates.
    own: usize,
    keys: &'a [u64],
}

impl Neighbors<'_> {
    pub(super) fn len(&self) -> usize {
        self.keys.len()
    }

    /// The squared distances, ascending.
    pub(super) fn distances_squared(&self) -> impl Iterator<Item = f32> {
        self.keys.iter().map(|&key| distance_of(key))
    }

    /// The neighbours' coordinates relative to the point.
    pub(super) fn offsets(&self) -> impl Iterator<Item = [f32; 3]> {
        let [x, y, z] = self.position();
        self.keys.iter().map(move |&key| {
            let [nx, ny, nz] = self.tree.position(place_of(key));
            [nx - x, ny - y, nz - z]
        })
    }

    pub(super) fn position(&self) -> [f32; 3] {
        self.tree.position(self.own)
    }

    /// Finds the nearest [`AROUND`] places other than the point's own, nearest first, however many points are at each. Gives their
    /// coordinates relative to the point to `offsets`. Returns the squared distance of the last one, infinite if there are fewer.
    pub(super) fn around(&self, offsets: &mut Vec<[f32; 3]>) -> f32 {
        let [x, y, z] = self.position();
        let found = self.tree.places(self.position());
        offsets.clear();
        offsets.extend(found.iter().map(|Near { at, .. }| [at[0] - x, at[1] - y, at[2] - z]));
        found.bound()
    }

    /// The neighbours' own indices.
    pub(super) fn indices(&self) -> impl Iterator<Item = u32> {
        self.keys.iter().map(|&key| self.tree.order[place_of(key)])
    }
}

/// A neighbour as one number that sorts by distance: a non-negative float's bits are ordered.
fn key_of(distance_squared: f32, place: usize) -> u64 {
    u64::from(distance_squared.to_bits()) << 32 | place as u64
}

fn distance_of(key: u64) -> f32 {
    f32::from_bits((key >> 32) as u32)
}

fn place_of(key: u64) -> usize {
    (key & 0xffff_ffff) as usize
}

/// Buffers that a leaf's queries reuse.
struct Scratch {
    best: [[u64; MAX_NEIGHBORS]; LEAF_POINTS],
    distances: [f32; LEAF_POINTS],
    /// Leaves that matter: distance from the middle of this leaf, and which.
    candidates: Vec<(f32, usize)>,
    stack: Vec<usize>,
    visited: u64,
}

/// The first points at each place, and the places that hold the others, with their indices.
fn thinned(mut items: Vec<Item>) -> (Vec<Item>, Vec<SamePlace>, Vec<u32>) {
    let key = |item: &Item| (item.position.map(f32::to_bits), item.index);
    items.par_sort_unstable_by_key(key);
    let (mut kept, mut same_places, mut others) = (Vec::new(), Vec::new(), Vec::new());
    for same in items.chunk_by(|a, b| a.position == b.position) {
        let first = &same[..same.len().min(COPIES)];
        kept.extend_from_slice(first);
        if let Some(more) = same.get(COPIES..).filter(|more| !more.is_empty()) {
            let begin = others.len();
            others.extend(more.iter().map(|item| item.index));
            let kept = std::array::from_fn(|at| first[at].index);
            same_places.push(SamePlace { kept, others: begin..others.len() });
        }
    }
    (kept, same_places, others)
}

impl PointTree {
    /// Orders up to 2³² − 1 points with finite coordinates whose squared distances are finite, too.
    pub(super) fn new(positions: impl IntoIterator<Item = [f32; 3]>) -> Self {
        let mut items: Vec<Item> = positions
            .into_iter()
            .zip(0..u32::MAX)
            .map(|(position, index)| Item::new(position, index))
            .collect();
        let (mut shape, mut boxes) = Self::ordered(&mut items);
        let (mut same_places, mut others) = (Vec::new(), Vec::new());
        // If many points share one position, some leaf holds nothing else.
        let is_one_place = |leaf: usize| {
            let holds = shape.range(shape.levels, leaf).len();
            holds > COPIES && boxes[(1 << shape.levels) + leaf].is_place()
        };
        if (0..1 << shape.levels).any(is_one_place) {
            (items, same_places, others) = thinned(items);
            (shape, boxes) = Self::ordered(&mut items);
        }
        let axis = |axis: usize| items.iter().map(|item| item.position[axis]).collect();
        for SamePlace { others, .. } in &mut same_places {
            *others = items.len() + others.start..items.len() + others.end;
        }
        Self {
            x: axis(0),
            y: axis(1),
            z: axis(2),
            order: items.iter().map(|item| item.index).chain(others).collect(),
            same_places,
            visited: AtomicU64::new(0),
            boxes,
            levels: shape.levels,
        }
    }

    /// Puts points into tree order, and gives the boxes of all nodes.
    fn ordered(items: &mut [Item]) -> (Shape, Vec<Aabb>) {
        let count = items.len();
        let levels = count.div_ceil(LEAF_POINTS).next_power_of_two().trailing_zeros();
        let mut boxes = vec![Aabb::EMPTY; 2 << levels];
        let shape = Shape { count, levels };
        shape.split(items, 0, 0);
        let leaves = 1 << levels;
        boxes[leaves..].par_iter_mut().enumerate().for_each(|(leaf, bounds)| {
            *bounds = Aabb::of(&items[shape.range(levels, leaf)]);
        });
        for node in (1..leaves).rev() {
            boxes[node] = boxes[2 * node].union(&boxes[2 * node + 1]);
        }
        (shape, boxes)
    }

    /// For each place in tree order the point's own index.
    pub(super) fn order(&self) -> &[u32] {
        &self.order
    }

    fn position(&self, place: usize) -> [f32; 3] {
        [self.x[place], self.y[place], self.z[place]]
    }

    fn shape(&self) -> Shape {
        Shape { count: self.x.len(), levels: self.levels }
    }

    /// Calls `visit` with the `k` nearest others of every point (fewer if there are fewer), and
    /// returns the results **in tree order**.
    pub(super) fn map_neighbors<T: Clone + Default + Send>(
        &self,
        k: usize,
        visit: impl Fn(Neighbors) -> T + Sync,
    ) -> Vec<T> {
        let mut results = vec![T::default(); self.order.len()];
        let k = k.min(MAX_NEIGHBORS);
        if k > 0 {
            let (own, others) = results.split_at_mut(self.x.len());
            self.map_leaves(0..1 << self.levels, k, own, &visit);
            self.map_same_places(k, others, &visit);
        }
        results
    }

    /// Handles the points that are not in the tree, which `results` covers: the first ones at their place are their neighbours.
    fn map_same_places<T: Send>(
        &self,
        k: usize,
        results: &mut [T],
        visit: &(impl Fn(Neighbors) -> T + Sync),
    ) {
        if self.same_places.is_empty() {
            return;
        }
        let in_tree = self.x.len();
        let mut place_of = vec![0u32; self.order.len()];
        for (place, &index) in (0..).zip(&self.order) {
            place_of[index as usize] = place;
        }
        for SamePlace { kept, others } in &self.same_places {
            let first = kept.map(|index| place_of[index as usize] as usize);
            let keys = first.map(|own| key_of(0.0, own));
            let results = &mut results[others.start - in_tree..others.end - in_tree];
            results.par_iter_mut().zip(others.clone()).for_each(|(result, place)| {
                let keys = &keys[..k];
                *result = visit(Neighbors { tree: self, place, own: first[0], keys });
            });
        }
    }

    /// Points and boxes that [`PointTree::map_neighbors`] has looked at.
    #[cfg(test)]
    pub(super) fn visited(&self) -> u64 {
        self.visited.load(Relaxed)
    }

    /// Handles a range of leaves, whose places `results` covers.
    fn map_leaves<T: Send>(
        &self,
        leaves: std::ops::Range<usize>,
        k: usize,
        results: &mut [T],
        visit: &(impl Fn(Neighbors) -> T + Sync),
    ) {
        let shape = self.shape();
        let start = shape.range(self.levels, leaves.start).start;
        if leaves.len() > SERIAL_LEAVES {
            let middle = leaves.start + leaves.len() / 2;
            let cut = shape.range(self.levels, middle).start - start;
            let (left, right) = results.split_at_mut(cut);
            rayon::join(
                || self.map_leaves(leaves.start..middle, k, left, visit),
                || self.map_leaves(middle..leaves.end, k, right, visit),
            );
            return;
        }
        let mut scratch = Scratch {
            best: [[u64::MAX; MAX_NEIGHBORS]; LEAF_POINTS],
            distances: [0.0; LEAF_POINTS],
            candidates: Vec::new(),
            stack: Vec::new(),
            visited: 0,
        };
        for leaf in leaves {
            self.search_leaf(leaf, k, &mut scratch);
            for (place, best) in shape.range(self.levels, leaf).zip(&scratch.best) {
                let found = best[..k].iter().take_while(|&&key| key != u64::MAX).count();
                let keys = &best[..found];
                let own = Neighbors { tree: self, place, own: place, keys };
                results[place - start] = visit(own);
            }
        }
        self.visited.fetch_add(scratch.visited, Relaxed);
    }

    /// Finds the `k` nearest neighbours of every point of a leaf.
    fn search_leaf(&self, leaf: usize, k: usize, scratch: &mut Scratch) {
        let range = self.shape().range(self.levels, leaf);
        let Scratch { best, distances, candidates, stack, visited } = scratch;
        let mut reach = 0.0f32;
        for (place, best) in range.clone().zip(best.iter_mut()) {
            *best = [u64::MAX; MAX_NEIGHBORS];
            let best = &mut best[..k];
            self.scan(range.clone(), self.position(place), Some(place), distances, best);
            *visited += range.len() as u64;
            reach = reach.max(bound(best));
        }
        self.gather(leaf, reach, candidates, stack);
        for (place, best) in range.zip(best.iter_mut()) {
            let best = &mut best[..k];
            let position = self.position(place);
            let point = Aabb::point(position);
            *visited += candidates.len() as u64;
            for &(_, other) in candidates.iter() {
                if self.boxes[(1 << self.levels) + other].distance_squared(&point) <= bound(best) {
                    let range = self.shape().range(self.levels, other);
                    *visited += range.len() as u64;
                    self.scan(range, position, None, distances, best);
                }
            }
        }
    }

    /// Collects the other leaves within a squared distance of a leaf's box, likely ones first.
    fn gather(
        &self,
        leaf: usize,
        reach: f32,
        candidates: &mut Vec<(f32, usize)>,
        stack: &mut Vec<usize>,
    ) {
        let leaves = 1 << self.levels;
        let bounds = self.boxes[leaves + leaf];
        let centre = Aabb::point(bounds.centre());
        candidates.clear();
        stack.clear();
        stack.push(1);
        while let Some(node) = stack.pop() {
            // A leaf at exactly the bound may have a smaller index.
            if self.boxes[node].distance_squared(&bounds) > reach {
                continue;
            }
            if node < leaves {
                stack.extend([2 * node, 2 * node + 1]);
            } else if node != leaves + leaf {
                candidates.push((self.boxes[node].distance_squared(&centre), node - leaves));
            }
        }
        candidates.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    }

    /// Gives `found` the `k` points nearest to any position, nearest first: squared distance and the point's own index.
    pub(super) fn nearest(&self, position: [f32; 3], k: usize, found: &mut Vec<(f32, u32)>) {
        found.clear();
        let k = k.min(self.x.len());
        if k == 0 {
            return;
        }
        let mut best = vec![u64::MAX; k];
        let mut distances = [0.0; LEAF_POINTS];
        self.near_first(position, |range| {
            if let Some(range) = range {
                self.scan(range, position, None, &mut distances, &mut best);
            }
            bound(&best)
        });
        let known = best.iter().take_while(|&&key| key != u64::MAX);
        found.extend(known.map(|&key| (distance_of(key), self.order[place_of(key)])));
    }

    /// The nearest [`AROUND`] places other than this one.
    fn places(&self, position: [f32; 3]) -> Places {
        let mut places = Places::default();
        self.near_first(position, |range| {
            for near in range.into_iter().flatten().map(|place| self.near(place, position)) {
                places.add(near);
            }
            places.bound()
        });
        places
    }

    /// Adds the points near a position to others. `index_of` gives the index of a point of the tree among all, if it counts.
    pub(super) fn add_nearby(
        &self,
        position: [f32; 3],
        nearby: &mut Nearby,
        index_of: impl Fn(u32) -> Option<u32>,
    ) {
        self.near_first(position, |range| {
            for near in range.into_iter().flatten().map(|place| self.near(place, position)) {
                if let Some(index) =
                    index_of(near.index).filter(|_| near.distance <= nearby.bound())
                {
                    nearby.add(Near { index, ..near });
                }
            }
            nearby.bound()
        });
    }

    fn near(&self, place: usize, from: [f32; 3]) -> Near {
        Near::new(self.position(place), from, self.order[place])
    }

    /// Calls `visit` with the leaves that may have points within a squared distance of a position, nearer ones before farther ones. It
    /// returns that distance, and is asked for it, without a leaf, at the start.
    fn near_first(
        &self,
        position: [f32; 3],
        mut visit: impl FnMut(Option<std::ops::Range<usize>>) -> f32,
    ) {
        let leaves = 1 << self.levels;
        let point = Aabb::point(position);
        let mut bound = visit(None);
        let mut stack = vec![1];
        while let Some(node) = stack.pop() {
            if self.boxes[node].distance_squared(&point) > bound {
                continue;
            }
            if node < leaves {
                let far = |child: usize| self.boxes[child].distance_squared(&point);
                let (left, right) = (2 * node, 2 * node + 1);
                // The nearer child is taken first: it comes last onto the stack.
                stack.extend(if far(left) <= far(right) { [right, left] } else { [left, right] });
            } else {
                bound = visit(Some(self.shape().range(self.levels, node - leaves)));
            }
        }
    }

    /// Enters the points of a range that are nearer than the last of `best`.
    #[inline]
    fn scan(
        &self,
        range: std::ops::Range<usize>,
        [x, y, z]: [f32; 3],
        except: Option<usize>,
        distances: &mut [f32; LEAF_POINTS],
        best: &mut [u64],
    ) {
        let start = range.start;
        let axes = self.x[range.clone()].iter().zip(&self.y[range.clone()]).zip(&self.z[range]);
        let count = axes.len();
        for (distance, ((px, py), pz)) in distances.iter_mut().zip(axes) {
            let (dx, dy, dz) = (px - x, py - y, pz - z);
            *distance = dx * dx + dy * dy + dz * dz;
        }
        if let Some(own) = except.and_then(|place| distances.get_mut(place - start)) {
            *own = f32::NAN;
        }
        let mut worst = bound(best);
        for (at, &distance) in distances[..count].iter().enumerate() {
            if distance <= worst {
                self.insert(best, key_of(distance, start + at));
                worst = bound(best);
            }
        }
    }

    /// Enters a key into an ascending list, dropping the last; or not, if that is nearer.
    #[inline]
    fn insert(&self, best: &mut [u64], key: u64) {
        let mut at = best.len();
        while at > 0 && self.is_nearer(key, best[at - 1]) {
            at -= 1;
        }
        if at < best.len() {
            best.copy_within(at..best.len() - 1, at + 1);
            best[at] = key;
        }
    }

    /// By the distance, then by the points' own indices.
    #[inline]
    fn is_nearer(&self, key: u64, other: u64) -> bool {
        match (key >> 32).cmp(&(other >> 32)) {
            Ordering::Less => true,
            Ordering::Greater => false,
            Ordering::Equal => self.order[place_of(key)] < self.order[place_of(other)],
        }
    }
}

/// The squared distance that a point must undercut, infinite while there is room.
#[inline]
fn bound(best: &[u64]) -> f32 {
    match best.last() {
        Some(&key) if key != u64::MAX => distance_of(key),
        _ => f32::INFINITY,
    }
}

/// The shape of the tree: how a number of points is halved.
#[derive(Clone, Copy)]
struct Shape {
    count: usize,
    levels: u32,
}

impl Shape {
    /// The places of the `index`-th node of a level.
    #[inline]
    fn range(self, level: u32, index: usize) -> std::ops::Range<usize> {
        // The count is below 2³² and so is the number of nodes.
        let at = |index: usize| ((index as u64 * self.count as u64) >> level) as usize;
        at(index)..at(index + 1)
    }

    /// Orders the points of a node and everything below it.
    fn split(self, items: &mut [Item], level: u32, index: usize) {
        if level == self.levels {
            return;
        }
        let axis = Aabb::of(items).longest_axis();
        let middle = self.range(level + 1, 2 * index).len();
        items.select_nth_unstable_by(middle, |a, b| a.position[axis].total_cmp(&b.position[axis]));
        let is_large = items.len() > SERIAL_POINTS;
        let (left, right) = items.split_at_mut(middle);
        if is_large {
            rayon::join(
                || self.split(left, level + 1, 2 * index),
                || self.split(right, level + 1, 2 * index + 1),
            );
        } else {
            self.split(left, level + 1, 2 * index);
            self.split(right, level + 1, 2 * index + 1);
        }
    }
}

#[cfg(test)]
mod tests;
