//! Reader for SWC, the format of traced neurons (Cannon et al., "An on-line archive of reconstructed hippocampal neurons",
//! J. Neurosci. Methods 84, 1998): a node on each line, `id type x y z radius parent`, in any order.
//!
//! Nodes become strands, cut at branch points. A strand begins with the vertex of its first node's parent, so that no gap
//! appears, and that vertex has the type of the strand. Where a branch leaves the cell body, the strand begins with the
//! branch's own radius: a cone from the body's radius to that of the branch is not in the data.
//!
//! A cell body (type 1) of a single node is a ball, and of three nodes, as NeuroMorpho.org writes them, the ball that they stand
//! for: a ball is a strand of two vertices at one place. Any other cell body is drawn as its nodes say. The scalar field
//! `type` has the types. There are no colours.

use std::collections::HashMap;

use glam::DVec3;

use super::fields::{Column, Numbers};
use super::input::{Input, Origin};
use super::strands::{Attributes, Paint, Strands, Vertex};
use super::tokens::{Lines, Tokens, number, shown};
use super::warnings::counted;
use super::{Asset, AssetError, ReadOptions};

/// Bytes of a node, its entry in the map of numbers, and its place among the children of its parent.
const NODE_BYTES: u64 = 128;
/// Whole numbers up to this are exact.
const LARGEST_ID: f64 = 9e15;
/// No node.
const NONE: u32 = u32::MAX;
/// Type of a cell body.
const SOMA: f32 = 1.0;
/// How exactly three nodes must describe a ball, relative to its radius.
const BALL_TOLERANCE: f64 = 0.1;
const COLUMNS: [&str; 7] = ["id", "type", "x", "y", "z", "radius", "parent"];

/// Reads SWC from `input`.
///
/// # Errors
/// Malformed content (naming line, node and column), numbers that two nodes have, nodes that are their own ancestors, counts
/// over the limits.
pub fn read_from(input: Input, options: &ReadOptions) -> Result<Asset, AssetError> {
    let Input { reader, origin } = input;
    let mut warnings = Vec::new();
    let mut lines = Lines::new(reader, &origin.name);
    lines.end_at_carriage_returns_if_alone()?;
    let nodes = nodes(lines, &origin, options, &mut warnings)?;
    let tree = Tree::new(nodes, &origin.name, &mut warnings)?;
    let attributes = Attributes {
        radii: true,
        paint: Paint::Nothing,
        columns: vec![Column::of("type", Numbers::Singles(Vec::new()))],
    };
    let mut strands = Strands::new(&origin, options, attributes);
    tree.strands(&mut strands, &mut warnings)?;
    strands.into_asset("swc", warnings)
}

/// A line of the file.
struct Node {
    id: i64,
    kind: f32,
    position: DVec3,
    radius: f32,
    /// The parent's number; `None` for a root.
    parent: Option<i64>,
    line: u64,
}

fn nodes<R: std::io::BufRead>(
    mut lines: Lines<'_, R>,
    origin: &Origin,
    options: &ReadOptions,
    warnings: &mut Vec<String>,
) -> Result<Vec<Node>, AssetError> {
    let file = origin.name.as_str();
    let mut nodes = Vec::new();
    let mut meter = origin.admission.meter(file);
    let mut orphans = 0;
    let most = options.max_vertices.min(u64::from(NONE) - 1);
    while lines.advance_to_content(b'#')? {
        let line = lines.number;
        let (node, has_parent) = node(lines.tokens()).map_err(|(column, reason)| {
            let place = format!("node {} (line {line}), column {column}", nodes.len());
            AssetError::malformed(file, place, reason)
        })?;
        orphans += u64::from(!has_parent);
        AssetError::check_limit(file, "vertices", nodes.len() as u64 + 1, most)?;
        meter.reach(NODE_BYTES * (nodes.len() as u64 + 1))?;
        nodes.push(Node { line, ..node });
    }
    warnings.extend(counted(
        orphans,
        "node has NaN for its parent and counts as a root",
        "nodes have NaN for their parents and count as roots",
    ));
    Ok(nodes)
}

/// A node, and whether its parent is a number; otherwise the column at fault and the reason.
fn node(mut tokens: Tokens) -> Result<(Node, bool), (&'static str, String)> {
    let mut values = [0.0; 7];
    for (value, column) in values.iter_mut().zip(COLUMNS) {
        let token = tokens.next().ok_or_else(|| {
            (column, "is missing; a node is \"id type x y z radius parent\"".to_owned())
        })?;
        *value =
            number(token).ok_or_else(|| (column, format!("{} is not a number", shown(token))))?;
    }
    let [id, kind, x, y, z, radius, parent] = values;
    let whole =
        |value: f64| (value.fract() == 0.0 && value.abs() <= LARGEST_ID).then_some(value as i64);
    let fail = |column, value: f64| (column, format!("{value} is not a whole number"));
    let node = Node {
        id: whole(id).ok_or_else(|| fail("id", id))?,
        kind: whole(kind).ok_or_else(|| fail("type", kind))? as f32,
        position: DVec3::new(x, y, z),
        radius: radius as f32,
        parent: match parent {
            parent if parent.is_nan() => None,
            parent => Some(whole(parent).ok_or_else(|| fail("parent", parent))?),
        },
        line: 0,
    };
    // Every negative number stands for no parent; −1 is the usual one.
    let parent = node.parent.filter(|parent| *parent >= 0);
    Ok((Node { parent, ..node }, !values[6].is_nan()))
}

/// The nodes, and who descends from whom.
struct Tree {
    nodes: Vec<Node>,
    /// For each node, its parent or [`NONE`].
    parents: Vec<u32>,
    /// For each node, where its children begin, and behind them the number of all children.
    begins: Vec<u32>,
    children: Vec<u32>,
}

impl Tree {
    fn new(nodes: Vec<Node>, file: &str, warnings: &mut Vec<String>) -> Result<Tree, AssetError> {
        let mut numbers: HashMap<i64, u32> = HashMap::with_capacity(nodes.len());
        for (index, node) in nodes.iter().enumerate() {
            if let Some(first) = numbers.insert(node.id, index as u32) {
                let first = nodes[first as usize].line;
                let place = format!("node {index} (line {}), column id", node.line);
                let reason = format!("line {first} has a node with the number {}, too", node.id);
                return Err(AssetError::malformed(file, place, reason));
            }
        }
        let mut lost = 0;
        let mut first_lost = None;
        let parents: Vec<u32> = nodes
            .iter()
            .map(|node| {
                let Some(parent) = node.parent else { return NONE };
                numbers.get(&parent).copied().unwrap_or_else(|| {
                    lost += 1;
                    first_lost.get_or_insert((node.line, parent));
                    NONE
                })
            })
            .collect();
        let text = counted(
            lost,
            "node names a parent that does not exist and begins a tree of its own",
            "nodes name parents that do not exist and begin trees of their own",
        );
        if let (Some(text), Some((line, parent))) = (text, first_lost) {
            warnings.push(format!("{text}; the first is on line {line}, with the parent {parent}"));
        }
        let mut begins = vec![0u32; nodes.len() + 1];
        for &parent in parents.iter().filter(|parent| **parent != NONE) {
            begins[parent as usize + 1] += 1;
        }
        for index in 1..begins.len() {
            begins[index] += begins[index - 1];
        }
        let mut next = begins.clone();
        let mut children = vec![0; begins.last().map_or(0, |count| *count as usize)];
        for (index, &parent) in parents.iter().enumerate().filter(|(_, parent)| **parent != NONE) {
            let slot = &mut next[parent as usize];
            children[*slot as usize] = index as u32;
            *slot += 1;
        }
        let tree = Tree { nodes, parents, begins, children };
        tree.refuse_cycles(file)?;
        Ok(tree)
    }

    fn children(&self, node: u32) -> &[u32] {
        let at = node as usize;
        &self.children[self.begins[at] as usize..self.begins[at + 1] as usize]
    }

    fn node(&self, node: u32) -> &Node {
        &self.nodes[node as usize]
    }

    fn is_soma(&self, node: u32) -> bool {
        self.node(node).kind == SOMA
    }

    fn roots(&self) -> impl Iterator<Item = u32> {
        (0..self.nodes.len() as u32).filter(|node| self.parents[*node as usize] == NONE)
    }

    /// Samples that no root leads to form a ring.
    fn refuse_cycles(&self, file: &str) -> Result<(), AssetError> {
        let mut is_reached = vec![false; self.nodes.len()];
        let mut open: Vec<u32> = self.roots().collect();
        while let Some(node) = open.pop() {
            is_reached[node as usize] = true;
            open.extend_from_slice(self.children(node));
        }
        let Some(node) = is_reached.iter().position(|reached| !reached) else { return Ok(()) };
        let Node { id, line, .. } = self.nodes[node];
        let place = format!("node {node} (line {line}), column parent");
        let reason = format!("the ancestors of node {id} lead in a circle and to no root");
        Err(AssetError::malformed(file, place, reason))
    }

    /// The two outer nodes of a cell body that three nodes describe: they touch the ball about the first one on opposite sides.
    fn ball_of_three(&self, root: u32) -> Option<[u32; 2]> {
        let of_soma = |nodes: &[u32]| -> Vec<u32> {
            nodes.iter().copied().filter(|child| self.is_soma(*child)).collect()
        };
        let [a, b] = of_soma(self.children(root))[..] else { return None };
        if !self.is_soma(root) || self.parents[root as usize] != NONE {
            return None;
        }
        let is_end = |outer: u32| of_soma(self.children(outer)).is_empty();
        let Node { position, radius, .. } = *self.node(root);
        let within = BALL_TOLERANCE * f64::from(radius);
        let [to_a, to_b] = [a, b].map(|outer| self.node(outer).position - position);
        let touches = |way: DVec3| (way.length() - f64::from(radius)).abs() <= within;
        let has_radius = |outer: u32| f64::from(self.node(outer).radius - radius).abs() <= within;
        let is_ball = radius > 0.0
            && [a, b].into_iter().all(|outer| is_end(outer) && has_radius(outer))
            && touches(to_a)
            && touches(to_b)
            && (to_a + to_b).length() <= 2.0 * within;
        is_ball.then_some([a, b])
    }

    fn strands(&self, strands: &mut Strands, warnings: &mut Vec<String>) -> Result<(), AssetError> {
        let mut is_outer = vec![false; self.nodes.len()];
        let mut wrong_roots = 0;
        for root in self.roots() {
            let outer = self.ball_of_three(root);
            for node in outer.into_iter().flatten() {
                is_outer[node as usize] = true;
                wrong_roots += self.children(node).len() as u64;
            }
            let inner = self.children(root).iter().any(|child| self.is_soma(*child));
            let is_alone = self.children(root).is_empty();
            if outer.is_some() || is_alone || (self.is_soma(root) && !inner) {
                let node = self.node(root);
                add(strands, node.position, node.radius, node.kind)?;
                add(strands, node.position, node.radius, node.kind)?;
                strands.cut()?;
            }
        }
        for node in 0..self.nodes.len() as u32 {
            let is_inside = self.parents[node as usize] != NONE
                && self.children(node).len() == 1
                && !self.leaves_soma(self.children(node)[0]);
            if is_inside {
                continue;
            }
            for &child in self.children(node) {
                if !is_outer[child as usize] {
                    self.strand(node, child, strands)?;
                }
            }
        }
        warnings.extend(counted(
            wrong_roots,
            "branch begins at an outer node of a cell body of three nodes, not at its centre",
            "branches begin at outer nodes of a cell body of three nodes, not at its centre",
        ));
        Ok(())
    }

    /// Whether the segment before a node leaves the cell body.
    fn leaves_soma(&self, node: u32) -> bool {
        let parent = self.parents[node as usize];
        parent != NONE && self.is_soma(parent) && !self.is_soma(node)
    }

    /// The strand that begins at a node and goes to its child, up to a branch point or an end.
    fn strand(&self, from: u32, child: u32, strands: &mut Strands) -> Result<(), AssetError> {
        let (begin, first) = (self.node(from), self.node(child));
        let radius = if self.leaves_soma(child) { first.radius } else { begin.radius };
        add(strands, begin.position, radius, first.kind)?;
        let mut at = child;
        loop {
            let node = self.node(at);
            add(strands, node.position, node.radius, node.kind)?;
            match *self.children(at) {
                [next] if !self.leaves_soma(next) => at = next,
                _ => return strands.cut(),
            }
        }
    }
}

fn add(strands: &mut Strands, position: DVec3, radius: f32, kind: f32) -> Result<(), AssetError> {
    strands.vertex(Vertex { position, radius, color: [0.0; 4], values: &[kind] })
}

#[cfg(test)]
mod tests;
