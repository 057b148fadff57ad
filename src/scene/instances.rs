//! Unfolding nodes, prototypes and repeats into instances.
//!
//! The walk is depth first in the file's order: a node's own drawing before its children, copy by
//! copy (x fastest, z slowest). Subtrees that draw nothing are cut off beforehand, so that the work
//! is proportional to the number of instances times the depth, whatever a file repeats.

use std::ops::Range;

use glam::{DAffine3, DMat3, DVec3};

use super::random::SplitMix64;
use super::{Draws, Instance, Node, Repeat, Scene, graph};

/// A node that draws something, and its children that do.
struct Kept<'a> {
    node: &'a Node,
    children: Vec<Kept<'a>>,
}

impl Scene {
    /// Every visible instance, in a fixed order. `Instance::material` is the innermost override.
    ///
    /// Meant for scenes that validation let pass; prototypes that contain themselves draw nothing.
    pub fn instances(&self) -> Vec<Instance> {
        self.unfolding().instances(0..self.nodes.len())
    }

    /// Unfolds top-level nodes, some at a time.
    pub fn unfolding(&self) -> Unfolding<'_> {
        let Ok(order) = graph::topological_order(self) else {
            return Unfolding { scene: self, counts: None, prototypes: Vec::new() };
        };
        let counts = graph::count_prototypes(self, &order, true);
        let prototypes = self.prototypes.iter().map(|p| keep(&p.children, &counts)).collect();
        Unfolding { scene: self, counts: Some(counts), prototypes }
    }

    /// Top-level nodes in runs: a run ends where it has `most` instances or more, hidden ones counted, so that no edit of
    /// a node moves the ends. Each run is not empty; together they are all nodes, in order.
    pub fn node_runs(&self, most: u64) -> Vec<Range<usize>> {
        let Ok(order) = graph::topological_order(self) else {
            return std::iter::once(0..self.nodes.len()).filter(|run| !run.is_empty()).collect();
        };
        let counts = graph::count_prototypes(self, &order, false);
        let mut runs = Vec::new();
        let (mut first, mut found) = (0, 0u64);
        for (index, node) in self.nodes.iter().enumerate() {
            found = found.saturating_add(graph::count_nodes(
                std::slice::from_ref(node),
                &counts,
                false,
            ));
            if found >= most || index + 1 == self.nodes.len() {
                runs.push(first..index + 1);
                (first, found) = (index + 1, 0);
            }
        }
        runs
    }

    /// The number of [`Scene::instances`], saturating, without unfolding them.
    pub fn instance_count(&self) -> u64 {
        match graph::topological_order(self) {
            Ok(order) => {
                let counts = graph::count_prototypes(self, &order, true);
                graph::count_nodes(&self.nodes, &counts, true)
            }
            Err(_) => 0,
        }
    }
}

fn keep<'a>(nodes: &'a [Node], prototype_counts: &[u64]) -> Vec<Kept<'a>> {
    nodes
        .iter()
        .filter(|node| node.visible)
        .map(|node| Kept { node, children: keep(&node.children, prototype_counts) })
        .filter(|kept| match kept.node.draws {
            Draws::Nothing => !kept.children.is_empty(),
            Draws::Asset(_) => true,
            Draws::Prototype(index) => prototype_counts[index] > 0 || !kept.children.is_empty(),
        })
        .collect()
}

/// Unfolds top-level nodes of a scene; see [`Scene::unfolding`].
pub struct Unfolding<'a> {
    scene: &'a Scene,
    /// Instances of each prototype; `None` where some contains itself.
    counts: Option<Vec<u64>>,
    prototypes: Vec<Vec<Kept<'a>>>,
}

impl Unfolding<'_> {
    /// The instances of these top-level nodes, as in [`Scene::instances`].
    pub fn instances(&self, nodes: Range<usize>) -> Vec<Instance> {
        let Some(counts) = &self.counts else { return Vec::new() };
        let chosen = self.scene.nodes.get(nodes.clone()).unwrap_or_default();
        let total = graph::count_nodes(chosen, counts, true);
        let mut walk = Walk {
            up: self.scene.up,
            prototypes: &self.prototypes,
            found: Vec::with_capacity(usize::try_from(total).unwrap_or(0).min(1 << 20)),
            top: 0,
        };
        for (index, node) in nodes.zip(chosen) {
            walk.top = index;
            for kept in keep(std::slice::from_ref(node), counts) {
                walk.visit(&kept, DAffine3::IDENTITY, None);
            }
        }
        walk.found
    }
}

struct Walk<'a> {
    up: DVec3,
    prototypes: &'a [Vec<Kept<'a>>],
    found: Vec<Instance>,
    /// Index of the top-level node that is being unfolded.
    top: usize,
}

impl Walk<'_> {
    fn visit(&mut self, kept: &Kept<'_>, world_from_parent: DAffine3, inherited: Option<usize>) {
        let node = kept.node;
        let material = node.material.or(inherited);
        let prototypes = self.prototypes;
        for placed in Copies::new(node, self.up) {
            let world_from_node = world_from_parent * placed;
            match node.draws {
                Draws::Nothing => {}
                Draws::Asset(asset) => self.found.push(Instance {
                    asset,
                    world_from_asset: world_from_node,
                    material,
                    node: self.top,
                }),
                Draws::Prototype(index) => {
                    for child in &prototypes[index] {
                        self.visit(child, world_from_node, material);
                    }
                }
            }
            for child in &kept.children {
                self.visit(child, world_from_node, material);
            }
        }
    }
}

/// The transforms `parent ← node` of each copy of a node.
struct Copies {
    parent_from_node: DAffine3,
    repeat: Repeat,
    random: SplitMix64,
    up: DVec3,
    next: u64,
    end: u64,
}

impl Copies {
    fn new(node: &Node, up: DVec3) -> Copies {
        let seed = match node.repeat {
            Repeat::Scatter { seed, .. } => seed,
            Repeat::Once | Repeat::Grid { .. } => 0,
        };
        Copies {
            parent_from_node: node.parent_from_node,
            repeat: node.repeat.clone(),
            random: SplitMix64::new(seed),
            up,
            next: 0,
            end: node.repeat.count(),
        }
    }
}

impl Iterator for Copies {
    type Item = DAffine3;

    fn next(&mut self) -> Option<DAffine3> {
        let index = self.next;
        if index >= self.end {
            return None;
        }
        self.next += 1;
        let mut placed = self.parent_from_node;
        match self.repeat {
            Repeat::Once => {}
            Repeat::Grid { counts, step } => {
                let [nx, ny, nz] = counts.map(u64::from);
                let cell = [index % nx, index / nx % ny, index / nx / ny];
                for (axis, (i, n)) in cell.into_iter().zip([nx, ny, nz]).enumerate() {
                    // Half steps from the middle: exact for any count, symmetric about the node.
                    let half_steps = (2 * i) as f64 - (n - 1) as f64;
                    placed.translation[axis] += 0.5 * half_steps * step[axis];
                }
            }
            Repeat::Scatter { half_extent, scale, turn, .. } => {
                // All five numbers are drawn every time: changing one option moves nothing else.
                let random = &mut self.random;
                let offset = DVec3::from_array([(); 3].map(|()| random.range(-1.0, 1.0)));
                let factor = random.range(scale[0], scale[1]);
                let angle = random.range(0.0, std::f64::consts::TAU);
                let spin = match self.up.try_normalize() {
                    Some(up) if turn => DMat3::from_axis_angle(up, angle),
                    _ => DMat3::IDENTITY,
                };
                placed.matrix3 = spin * placed.matrix3 * factor;
                placed.translation += offset * half_extent;
            }
        }
        Some(placed)
    }
}
