//! The octree, from the finest level up.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::super::pack::spread;
use super::Measures;
use super::node::Node;
use crate::assets::{Kernel, PointCloud};
use crate::math::Bounds;

/// Levels of the octree: bits of a Morton code's coordinate.
const LEVELS: u32 = 21;
/// Members of a level that a thread takes at least.
const PIECE: usize = 1 << 14;
/// Children of a node at most.
const CHILDREN: usize = 8;

/// Nodes, the leaves first, in the order of their codes; and which sample each leaf is.
pub struct Tree {
    pub nodes: Vec<Node>,
    pub samples: Vec<u32>,
}

/// A node that has no parent yet, and the code of its cell.
type Open = (u64, u32);

fn codes(cloud: &PointCloud, bounds: &Bounds) -> Vec<Open> {
    let extent = bounds.extent().max_element();
    let scale = if extent > 0.0 { f64::from((1u32 << LEVELS) - 1) / extent } else { 0.0 };
    let code = |position: &DVec3| {
        let cell = ((*position - bounds.min) * scale).to_array().map(|v| v as u64);
        spread(cell[0]) | spread(cell[1]) << 1 | spread(cell[2]) << 2
    };
    let mut codes: Vec<Open> = cloud
        .positions
        .par_iter()
        .enumerate()
        .map(|(index, position)| (code(position), index as u32))
        .collect();
    codes.par_sort_unstable();
    codes
}

pub fn build(cloud: &PointCloud, stands: Option<&[Measures]>, bounds: &Bounds) -> Tree {
    let mut open = codes(cloud, bounds);
    let samples: Vec<u32> = open.iter().map(|&(_, sample)| sample).collect();
    let mut nodes: Vec<Node> = samples
        .par_iter()
        .map(|&sample| {
            let i = sample as usize;
            Node::leaf(
                cloud.positions[i],
                cloud.normals.as_ref().map_or(Vec3::ZERO, |normals| normals[i]),
                cloud.colors.as_ref().map_or(super::super::colors::NEUTRAL, |colors| colors[i]),
                &cloud.kernels.as_ref().map_or(Kernel::default(), |kernels| kernels[i]),
                cloud
                    .clips
                    .as_ref()
                    .is_some_and(|clips| clips[i].lines.iter().any(Option::is_some)),
                stands.map_or(Measures::default(), |stands| stands[i]),
            )
        })
        .collect();
    open.par_iter_mut().enumerate().for_each(|(leaf, open)| open.1 = leaf as u32);
    // Samples in one cell of the finest level may be more than eight.
    while some_share_a_cell(&open) {
        open = merge(&mut nodes, open, 0);
    }
    for level in 1..=LEVELS {
        if open.len() < 2 {
            break;
        }
        open = merge(&mut nodes, open, 3 * level);
    }
    Tree { nodes, samples }
}

fn some_share_a_cell(open: &[Open]) -> bool {
    open.par_windows(2).any(|pair| pair[0].0 == pair[1].0)
}

struct Merged {
    nodes: Vec<Node>,
    open: Vec<Open>,
    /// Children of this piece's nodes, and the number of each's parent among them.
    parents: Vec<(u32, u32)>,
}

/// Merges what shares a cell, up to eight at a time; what is alone stays.
fn merge(nodes: &mut Vec<Node>, open: Vec<Open>, shift: u32) -> Vec<Open> {
    let same = |a: &Open, b: &Open| a.0 >> shift == b.0 >> shift;
    let mut pieces = Vec::new();
    let mut begin = 0;
    while begin < open.len() {
        let mut end = (begin + PIECE).min(open.len());
        while end < open.len() && same(&open[end - 1], &open[end]) {
            end += 1;
        }
        pieces.push(&open[begin..end]);
        begin = end;
    }
    let known: &[Node] = nodes;
    let merged: Vec<Merged> = pieces
        .into_par_iter()
        .map(|piece| {
            let mut out = Merged {
                nodes: Vec::new(),
                open: Vec::with_capacity(piece.len()),
                parents: Vec::new(),
            };
            for run in piece.chunk_by(same) {
                for run in run.chunks(CHILDREN) {
                    let &[(code, only)] = run else {
                        out.add(known, run);
                        continue;
                    };
                    out.open.push((code, only));
                }
            }
            out
        })
        .collect();
    let mut still_open = Vec::with_capacity(merged.iter().map(|piece| piece.open.len()).sum());
    for piece in merged {
        let first = nodes.len() as u32;
        for (child, parent) in piece.parents {
            nodes[child as usize].parent = first + parent;
        }
        nodes.extend(piece.nodes);
        still_open.extend(piece.open.into_iter().map(|(code, node)| {
            // See [`Merged::add`].
            (code & !FRESH, if code & FRESH == 0 { node } else { first + node })
        }));
    }
    still_open
}

/// Codes have 63 bits; the uppermost marks nodes of a piece until they have their final numbers.
const FRESH: u64 = 1 << 63;

impl Merged {
    fn add(&mut self, known: &[Node], run: &[Open]) {
        let mut children = [&known[run[0].1 as usize]; CHILDREN];
        for (child, &(_, node)) in children.iter_mut().zip(run) {
            *child = &known[node as usize];
        }
        let number = self.nodes.len() as u32;
        self.nodes.push(Node::above(&children[..run.len()]));
        self.parents.extend(run.iter().map(|&(_, child)| (child, number)));
        self.open.push((run[0].0 | FRESH, number));
    }
}
