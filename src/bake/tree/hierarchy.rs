//! The octree: leaves sorted along a Morton curve and merged cell by cell.

use std::ops::Range;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::super::pack::{Layout, fields_of, spread, values_of};
use super::Measures;
use super::coverage;
use super::node::{Matter, NO_NODE, Node};
use super::stack::{CHILDREN, Stack, shared_level};
use crate::assets::{Kernel, PointCloud};
use crate::math::Bounds;

/// Levels of the octree: bits per coordinate in a Morton code.
const LEVELS: u32 = 21;
/// Maximum number of leaves per parallel task, unless more leaves share a cell of the finest level.
const PIECE: usize = 1 << 12;

/// The nodes of a tree: leaves first, in Morton order, then inner nodes, each after all nodes below it. `samples` maps each leaf
/// to its sample.
pub struct Tree {
    pub nodes: Vec<Node>,
    pub samples: Vec<u32>,
    /// The last leaf below each inner node.
    ends: Vec<u32>,
}

impl Tree {
    /// All nodes except the leaves before `first`, in post-order: each node follows its descendants and precedes nodes farther
    /// along the curve.
    pub fn along_the_curve(&self, first: usize) -> Vec<u32> {
        let mut order = Vec::with_capacity(self.nodes.len() - first);
        let mut ends = self.ends.iter().zip(self.samples.len() as u32..).peekable();
        for leaf in 0..self.samples.len() as u32 {
            if leaf as usize >= first {
                order.push(leaf);
            }
            while let Some((_, node)) = ends.next_if(|(end, _)| **end == leaf) {
                order.push(node);
            }
        }
        order
    }
}

/// The Morton codes of positions in a box with the index of each position, sorted.
fn codes(positions: &[DVec3], bounds: &Bounds) -> Vec<(u64, u32)> {
    let cells = Cells::of(bounds);
    let mut codes: Vec<(u64, u32)> = positions
        .par_iter()
        .enumerate()
        .map(|(index, &position)| (cells.code(position), index as u32))
        .collect();
    codes.par_sort_unstable();
    codes
}

/// The grid of the octree's finest cells.
pub struct Cells {
    origin: DVec3,
    scale: f64,
}

impl Cells {
    /// Divides a box into cells.
    pub fn of(bounds: &Bounds) -> Cells {
        let extent = bounds.extent().max_element();
        let scale = if extent > 0.0 { f64::from((1u32 << LEVELS) - 1) / extent } else { 0.0 };
        Cells { origin: bounds.min, scale }
    }

    /// The Morton code of the cell that holds a position.
    pub fn code(&self, position: DVec3) -> u64 {
        let cell = ((position - self.origin) * self.scale).to_array().map(|v| u64::from(v as u32));
        spread(cell[0]) | spread(cell[1]) << 1 | spread(cell[2]) << 2
    }
}

pub fn build(
    cloud: &PointCloud,
    stands: Option<&[Measures]>,
    bounds: &Bounds,
    matter: Matter,
) -> Tree {
    let codes = codes(&cloud.positions, bounds);
    let samples: Vec<u32> = codes.iter().map(|&(_, sample)| sample).collect();
    let mut nodes: Vec<Node> = Vec::with_capacity(2 * samples.len());
    let layout = Layout::of(&fields_of(cloud));
    let leaf = |&sample: &u32| {
        let i = sample as usize;
        let leaf = Node::leaf(
            cloud.positions[i],
            cloud.normals.as_ref().map_or(Vec3::ZERO, |normals| normals[i]),
            cloud.colors.as_ref().map_or(crate::assets::NEUTRAL, |colors| colors[i]),
            &cloud.kernels.as_ref().map_or(Kernel::default(), |kernels| kernels[i]),
            cloud.is_clipped(i),
            stands.map_or(Measures::default(), |stands| stands[i]),
            matter,
        );
        Node { values: values_of(cloud, i), ..leaf }
    };
    nodes.par_extend(samples.par_iter().map(leaf));
    let pieces = pieces(&codes);
    let mut rest = &mut nodes[..];
    let mut leaves = Vec::with_capacity(pieces.len());
    for piece in &pieces {
        let (own, behind) = std::mem::take(&mut rest).split_at_mut(piece.len());
        leaves.push(own);
        rest = behind;
    }
    let branches: Vec<Branch> = leaves
        .into_par_iter()
        .zip(&pieces)
        .map(|(leaves, piece)| Branch::above(leaves, &codes[piece.clone()], &layout))
        .collect();
    let ends = join(&codes, &pieces, branches, &mut nodes, &layout);
    coverage::look_around(&mut nodes);
    Tree { nodes, samples, ends }
}

/// Splits the leaves into ranges that each fill an octree cell.
fn pieces(codes: &[(u64, u32)]) -> Vec<Range<usize>> {
    let mut pieces = Vec::new();
    let mut open = vec![(0..codes.len(), LEVELS)];
    while let Some((range, level)) = open.pop() {
        if range.len() <= PIECE || level == 0 {
            pieces.extend((!range.is_empty()).then_some(range));
            continue;
        }
        // Push the eight child cells so that the first is on top.
        let mut end = range.end;
        while end > range.start {
            let cell = codes[end - 1].0 >> (3 * (level - 1));
            let within = &codes[range.start..end];
            let begin =
                range.start + within.partition_point(|&(code, _)| code >> (3 * (level - 1)) < cell);
            open.push((begin..end, level - 1));
            end = begin;
        }
    }
    pieces
}

/// The inner nodes above the leaves of a piece, numbered from the piece's first leaf on.
struct Branch {
    nodes: Vec<Node>,
    ends: Vec<u32>,
    root: u32,
}

impl Branch {
    fn above(leaves: &mut [Node], codes: &[(u64, u32)], layout: &Layout) -> Branch {
        let count = leaves.len() as u32;
        let mut nodes: Vec<Node> = Vec::with_capacity(leaves.len());
        let (mut ends, mut end) = (Vec::with_capacity(leaves.len()), 0);
        let mut merge = |members: &[u32], end: u32| {
            let number = count + nodes.len() as u32;
            let node = |member: u32| {
                leaves.get(member as usize).unwrap_or_else(|| &nodes[(member - count) as usize])
            };
            let node = above(members, node, layout);
            for &member in members {
                match leaves.get_mut(member as usize) {
                    Some(leaf) => leaf.parent = number,
                    None => nodes[(member - count) as usize].parent = number,
                }
            }
            nodes.push(node);
            ends.push(end);
            number
        };
        let mut stack = Stack::new();
        let mut last = None;
        for (leaf, &(code, _)) in codes.iter().enumerate() {
            let level = last.map_or(0, |last| shared_level(last, code));
            stack.advance(level, &mut |members: &[u32]| merge(members, end));
            stack.put(leaf as u32);
            (last, end) = (Some(code), leaf as u32);
        }
        let root = stack.finish(&mut |members: &[u32]| merge(members, end)).unwrap_or(0);
        Branch { nodes, ends, root }
    }
}

/// Builds the parent of `members`.
fn above<'a>(members: &[u32], node: impl Fn(u32) -> &'a Node, layout: &Layout) -> Node {
    let mut children = [node(members[0]); CHILDREN];
    for (child, &member) in children.iter_mut().zip(members) {
        *child = node(member);
    }
    Node::above(&children[..members.len().min(CHILDREN)], layout)
}

/// Appends the branches' nodes to the leaves, then the nodes that join the branches. Returns the last leaf below each appended
/// node.
fn join(
    codes: &[(u64, u32)],
    pieces: &[Range<usize>],
    branches: Vec<Branch>,
    nodes: &mut Vec<Node>,
    layout: &Layout,
) -> Vec<u32> {
    let mut ends = Vec::with_capacity(branches.iter().map(|branch| branch.ends.len()).sum());
    let merge = |members: &[u32], end: u32, nodes: &mut Vec<Node>, ends: &mut Vec<u32>| {
        let number = nodes.len() as u32;
        nodes.push(above(members, |member| &nodes[member as usize], layout));
        ends.push(end);
        members.iter().for_each(|&member| nodes[member as usize].parent = number);
        number
    };
    let (mut stack, mut last) = (Stack::new(), 0);
    for (piece, branch) in pieces.iter().zip(branches) {
        let begin = piece.start as u32;
        let level = shared_level(codes[last as usize].0, codes[piece.start].0);
        stack.advance(level, &mut |members: &[u32]| merge(members, last, nodes, &mut ends));
        let (local, global) = (piece.len() as u32, nodes.len() as u32);
        let place = |node: u32| if node < local { begin + node } else { global + node - local };
        for leaf in &mut nodes[piece.clone()] {
            leaf.parent = if leaf.parent == NO_NODE { NO_NODE } else { place(leaf.parent) };
        }
        nodes.extend(branch.nodes.into_iter().map(|node| Node {
            parent: if node.parent == NO_NODE { NO_NODE } else { place(node.parent) },
            ..node
        }));
        ends.extend(branch.ends.iter().map(|end| begin + end));
        stack.put(place(branch.root));
        last = piece.end as u32 - 1;
    }
    stack.finish(&mut |members: &[u32]| merge(members, last, nodes, &mut ends));
    ends
}
