//! The hierarchy as a list: order, chunks, codes.

use glam::{DVec3, IVec3};
use rayon::prelude::*;

use super::super::CUTOFF;
use super::super::kernels::circle;
use super::super::pack::{
    CHUNK, Grid, NodeRange, PackedRun, PackedSamples, joined, morton, pack_run,
};
use super::hierarchy::Tree;
use super::node::Node;
use crate::assets::{Clip, Kernel, PointCloud};

/// The code of an error or size of nothing at all.
pub const NONE: u32 = 0xfff;
/// In a parent's place: there is none.
pub const NO_PARENT: u32 = 0;
/// Steps of an octave, of errors and sizes and of distances.
const STEPS: f32 = 128.0;
const DELTA_STEPS: f32 = 8.0;
/// Stands for what no error reaches.
const INFINITE: f32 = 1e30;
/// Nodes of the first chunks: what is seen from afar shall not cost a whole chunk's test.
const FIRST_CHUNKS: [usize; 2] = [64, 192];
/// Nodes at the front of a list that are strictly sorted, by the smaller of their parents' codes: so that what comes behind one
/// that is not wanted by either measure is not wanted either.
pub const SORTED: u32 = (FIRST_CHUNKS[0] + FIRST_CHUNKS[1]) as u32;
/// Chunks of fewer nodes take some of the next band.
const LEAST_CHUNK: usize = 256;

/// The largest code whose value is no less than `value`.
pub(super) fn code(value: f32, base: f32) -> u32 {
    if !(value > 0.0 && base > 0.0) {
        return NONE;
    }
    let below = ((base / value).log2() * STEPS).floor().clamp(1.0, (NONE - 1) as f32) as u32;
    // Rounding of the logarithm.
    if decode(below, base) < value { below.saturating_sub(1).max(1) } else { below }
}

/// The error or size of a code, in units of `base`.
pub fn decode(code: u32, base: f32) -> f32 {
    if code == NONE { 0.0 } else { base * (-(code as f32) / STEPS).exp2() }
}

pub(super) fn delta_code(value: f32, base: f32) -> u32 {
    if value <= 0.0 {
        return 255;
    }
    ((base / value).log2() * DELTA_STEPS).floor().clamp(0.0, 255.0) as u32
}

/// The sine of a cone's half angle, of its code; the last says nothing.
pub fn cone_sine(code: u32) -> f32 {
    if code == 7 { 2.0 } else { (code * code) as f32 / 48.0 }
}

fn cone_code(cone: f32) -> u32 {
    let sine = if cone < std::f32::consts::FRAC_PI_2 { cone.sin() } else { 2.0 };
    (0..7).find(|&code| sine <= cone_sine(code)).unwrap_or(7)
}

/// The distance of a code.
pub fn decode_delta(code: u32, base: f32) -> f32 {
    base * (-(code as f32) / DELTA_STEPS).exp2()
}

struct Codes {
    error: u32,
    size: u32,
    error_parent: u32,
    size_parent: u32,
}

/// Twice what any node has, so that no code of a node is that of no parent; in cells.
pub fn base_of(tree: &Tree, grid: Grid) -> f32 {
    let measures = tree.nodes.par_iter().map(|node| node.error.max(node.size));
    2.0 * measures.reduce(|| 0.0, f32::max) / grid.step as f32
}

/// What a measure of a tree's node is once it has been packed.
pub fn rounded(value: f32, base: f32, step: f32) -> f32 {
    decode(code(value / step, base), base) * step
}

/// All nodes as samples: leaves keep their kernels and clip lines, the others are disks.
fn cloud_of(cloud: &PointCloud, tree: &Tree) -> PointCloud {
    let leaf = |index: usize| tree.samples.get(index).map(|&sample| sample as usize);
    let nodes = || tree.nodes.par_iter().enumerate();
    let color = |(index, node): (usize, &Node)| {
        let alpha = leaf(index).and_then(|i| Some(cloud.colors.as_ref()?[i][3])).unwrap_or(255);
        let [r, g, b] = node.color.round().to_array().map(|v| v as u8);
        [r, g, b, alpha]
    };
    let kernel = |(index, node): (usize, &Node)| {
        leaf(index)
            .map(|i| cloud.kernels.as_ref().map_or(Kernel::default(), |kernels| kernels[i]))
            .unwrap_or_else(|| circle(node.normal, node.radius / CUTOFF))
    };
    let clips = cloud.clips.as_ref().map(|clips| {
        nodes().map(|(index, _)| leaf(index).map_or(Clip::NONE, |i| clips[i])).collect()
    });
    PointCloud {
        positions: tree.nodes.par_iter().map(|node| node.position).collect(),
        colors: Some(nodes().map(color).collect()),
        normals: Some(tree.nodes.par_iter().map(|node| node.normal).collect()),
        oriented: cloud.oriented,
        kernels: Some(nodes().map(kernel).collect()),
        clips,
        ..PointCloud::default()
    }
}

/// The packed tree, and which node of `tree` each of its nodes is.
///
/// Nodes before `first` are left out.
pub fn sequence(
    cloud: &PointCloud,
    tree: &Tree,
    grid: Grid,
    first: usize,
) -> (PackedSamples, Vec<u32>) {
    let all = cloud_of(cloud, tree);
    let nodes = &tree.nodes;
    let step = grid.step as f32;
    let base = base_of(tree, grid);
    let own: Vec<(u32, u32)> = nodes
        .par_iter()
        .map(|node| (code(node.error / step, base), code(node.size / step, base)))
        .collect();
    let codes: Vec<Codes> = nodes
        .par_iter()
        .zip(&own)
        .map(|(node, &(error, size))| {
            let above = own.get(node.parent as usize).copied();
            let (error_parent, size_parent) = above.unwrap_or((NO_PARENT, NO_PARENT));
            Codes { error, size, error_parent, size_parent }
        })
        .collect();
    drop(own);
    let clipped = |index: usize| {
        all.clips.as_ref().is_some_and(|clips| clips[index].lines.iter().any(Option::is_some))
    };
    let mut order: Vec<(bool, u32, u64, u32)> = (first..nodes.len())
        .into_par_iter()
        .map(|index| {
            let codes = &codes[index];
            let band = ((codes.error_parent / 64) << 8) | (codes.size_parent / 128);
            let place = morton(grid.quantise(all.positions[index]));
            (clipped(index), band, place, index as u32)
        })
        .collect();
    order.par_sort_unstable();
    let clipped_first = order.partition_point(|&(clipped, ..)| !clipped);
    let runs: Vec<PackedRun> = {
        let (plain, with_lines) = order.split_at_mut(clipped_first);
        let mut cuts = cut(plain, &codes);
        cuts.extend(cut(with_lines, &codes));
        let lists: Vec<Vec<(bool, u64, u32)>> = cuts
            .into_par_iter()
            .map(|run| run.iter().map(|&(clipped, _, place, i)| (clipped, place, i)).collect())
            .collect();
        lists.par_iter().map(|run| pack_run(&all, &grid, run)).collect()
    };
    let mut out = joined(grid, runs, clipped_first as u32);
    drop(all);
    // Where the GPU finds each node: the way to a parent is between those places.
    let mut cells = vec![IVec3::ZERO; nodes.len()];
    for chunk in &out.chunks {
        let range = chunk.first as usize..(chunk.first + chunk.count) as usize;
        for (place, &(.., node)) in out.positions[range.clone()].iter().zip(&order[range]) {
            cells[node as usize] = chunk.cell(*place);
        }
    }
    out.nodes = order
        .par_iter()
        .map(|&(.., index)| {
            let (codes, node) = (&codes[index as usize], &nodes[index as usize]);
            let delta = cells.get(node.parent as usize).map_or(255, |&parent| {
                let way: DVec3 = (cells[index as usize] - parent).as_dvec3();
                delta_code(way.length() as f32 * 1.001, base)
            });
            [
                codes.error | codes.error_parent << 12 | delta << 24,
                codes.size
                    | codes.size_parent << 12
                    | u32::from(node.level).min(31) << 24
                    | cone_code(node.cone) << 29,
            ]
        })
        .collect();
    set_ranges(&mut out, base);
    (out, order.into_iter().map(|(.., node)| node).collect())
}

/// Cuts nodes, in order, into chunks; what has the largest parents comes first, in small ones.
fn cut<'a>(
    order: &'a mut [(bool, u32, u64, u32)],
    codes: &[Codes],
) -> Vec<&'a [(bool, u32, u64, u32)]> {
    let mut head = FIRST_CHUNKS.iter().sum::<usize>().min(order.len());
    // Bands differ in order only within: the first nodes are strictly sorted.
    while head < order.len() && head < 2 * CHUNK && order[head].1 == order[head - 1].1 {
        head += 1;
    }
    order[..head].sort_unstable_by_key(|&(.., index)| {
        let codes = &codes[index as usize];
        (codes.error_parent.min(codes.size_parent), index)
    });
    let mut cuts = Vec::new();
    let mut rest: &[_] = order;
    for size in FIRST_CHUNKS {
        let (chunk, behind) = rest.split_at(size.min(rest.len()));
        if !chunk.is_empty() {
            cuts.push(chunk);
        }
        rest = behind;
    }
    while !rest.is_empty() {
        let mut end = 1;
        while end < rest.len() && end < CHUNK {
            if end >= LEAST_CHUNK && rest[end].1 != rest[end - 1].1 {
                break;
            }
            end += 1;
        }
        let (chunk, behind) = rest.split_at(end);
        cuts.push(chunk);
        rest = behind;
    }
    cuts
}

/// What the nodes of each chunk have in common.
fn set_ranges(samples: &mut PackedSamples, base: f32) {
    let parent = |code: u32| if code == NO_PARENT { INFINITE } else { decode(code, base) };
    for chunk in &mut samples.chunks {
        let nodes = &samples.nodes[chunk.first as usize..(chunk.first + chunk.count) as usize];
        let mut range =
            NodeRange { base, error_least: INFINITE, size_least: INFINITE, ..NodeRange::default() };
        for [error, size] in nodes {
            range.error_parent = range.error_parent.max(parent(error >> 12 & 0xfff));
            range.size_parent = range.size_parent.max(parent(size >> 12 & 0xfff));
            range.error_least = range.error_least.min(decode(error & 0xfff, base));
            range.size_least = range.size_least.min(decode(size & 0xfff, base));
            range.delta_most = range.delta_most.max(decode_delta(error >> 24, base));
        }
        chunk.range = range;
    }
    // Those with clip lines are another list.
    let mut behind = NodeRange::default();
    for chunk in samples.chunks.iter_mut().rev() {
        if chunk.first + chunk.count == samples.clipped_first {
            behind = NodeRange::default();
        }
        let range = &mut chunk.range;
        range.error_parent = range.error_parent.max(behind.error_parent);
        range.size_parent = range.size_parent.max(behind.size_parent);
        range.delta_most = range.delta_most.max(behind.delta_most);
        behind = *range;
    }
}
