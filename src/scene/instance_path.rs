//! The nodes above an instance, found without unfolding the scene.
//!
//! Instances are numbered as [`Scene::instances`] lists them, with each asset's placements expanded. Every node knows how many
//! instances it stands for, so the search goes down one branch of the tree.

use super::{Draws, Node, Scene, graph};

/// A node on the way from the scene to an instance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathStep<'a> {
    pub node: &'a Node,
    /// Index of the node among its siblings.
    pub index: usize,
    /// Number of the node's copy, where it repeats.
    pub copy: u64,
}

/// The way to an instance.
#[derive(Clone, Debug, PartialEq)]
pub struct InstancePath<'a> {
    /// From a top-level node to the node that draws the asset.
    pub steps: Vec<PathStep<'a>>,
    pub asset: usize,
    /// Index of the placement among those of the asset.
    pub placement: usize,
}

/// Finds the nodes above instances.
pub struct InstancePaths<'a> {
    scene: &'a Scene,
    /// Number of placements of each asset.
    placements: Vec<u64>,
    /// Instances in one copy of each prototype.
    prototypes: Vec<u64>,
    /// Instances up to and including each top-level node.
    ends: Vec<u64>,
}

impl<'a> InstancePaths<'a> {
    pub fn new(scene: &'a Scene, placements: Vec<u64>) -> InstancePaths<'a> {
        let prototypes = vec![0; scene.prototypes.len()];
        let mut paths = InstancePaths { scene, placements, prototypes, ends: Vec::new() };
        // A scene whose prototypes contain themselves draws nothing.
        let Ok(order) = graph::topological_order(scene) else { return paths };
        for index in order {
            paths.prototypes[index] = paths.count(&scene.prototypes[index].children);
        }
        let mut end = 0u64;
        for node in &scene.nodes {
            end = end.saturating_add(paths.count(std::slice::from_ref(node)));
            paths.ends.push(end);
        }
        paths
    }

    /// The way to an instance; `None` where the scene has fewer.
    pub fn find(&self, instance: u64) -> Option<InstancePath<'a>> {
        let top = self.ends.partition_point(|&end| end <= instance);
        let before = top.checked_sub(1).map_or(0, |last| self.ends[last]);
        let (mut nodes, mut first) = (self.scene.nodes.get(top..top + 1)?, top);
        let mut rest = instance - before;
        let mut steps = Vec::new();
        loop {
            let (index, node, each) = self.child(nodes, &mut rest)?;
            steps.push(PathStep { node, index: first + index, copy: rest / each });
            rest %= each;
            first = 0;
            let drawn = self.drawn(node);
            nodes = match node.draws {
                Draws::Asset(asset) if rest < drawn => {
                    return Some(InstancePath { steps, asset, placement: rest as usize });
                }
                Draws::Prototype(index) if rest < drawn => &self.scene.prototypes[index].children,
                _ => {
                    rest -= drawn;
                    &node.children
                }
            };
        }
    }

    /// The node that holds instance `rest` of its siblings', with the instances in a copy of it; `rest` then counts from the node.
    fn child(&self, nodes: &'a [Node], rest: &mut u64) -> Option<(usize, &'a Node, u64)> {
        for (index, node) in nodes.iter().enumerate().filter(|(_, node)| node.visible) {
            let each = self.drawn(node).saturating_add(self.count(&node.children));
            let all = node.repeat.count().saturating_mul(each);
            if *rest < all {
                return Some((index, node, each));
            }
            *rest -= all;
        }
        None
    }

    /// Instances that a copy of a node draws itself.
    fn drawn(&self, node: &Node) -> u64 {
        match node.draws {
            Draws::Nothing => 0,
            Draws::Asset(asset) => self.placements.get(asset).copied().unwrap_or(0),
            Draws::Prototype(index) => self.prototypes[index],
        }
    }

    fn count(&self, nodes: &[Node]) -> u64 {
        let visible = nodes.iter().filter(|node| node.visible);
        let counts = visible.map(|node| {
            let each = self.drawn(node).saturating_add(self.count(&node.children));
            node.repeat.count().saturating_mul(each)
        });
        counts.fold(0, u64::saturating_add)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Prototype, Repeat};

    fn draws(asset: usize) -> Node {
        Node { draws: Draws::Asset(asset), ..Node::default() }
    }

    #[test]
    fn paths_follow_the_order_of_the_instances() {
        let row = |count| Repeat::Grid { counts: [count, 1, 1], step: glam::DVec3::ONE };
        let scene = Scene {
            prototypes: vec![Prototype {
                name: "pair".into(),
                children: vec![draws(0), Node { repeat: row(2), ..draws(1) }],
            }],
            nodes: vec![
                Node { visible: false, ..draws(0) },
                Node {
                    draws: Draws::Prototype(0),
                    repeat: row(3),
                    children: vec![draws(1)],
                    ..Node::default()
                },
                draws(1),
            ],
            ..Scene::default()
        };
        // The second asset is placed twice.
        let paths = InstancePaths::new(&scene, vec![1, 2]);
        let instances = scene.instances();
        let expected: Vec<(usize, usize, usize)> = instances
            .iter()
            .flat_map(|one| (0..=one.asset).map(|placement| (one.node, one.asset, placement)))
            .collect();
        let found: Vec<(usize, usize, usize)> = (0..)
            .map_while(|number| paths.find(number))
            .map(|path| (path.steps[0].index, path.asset, path.placement))
            .collect();
        assert_eq!(found, expected);
        let path = paths.find(7 + 3).unwrap();
        let steps: Vec<(usize, u64)> = path.steps.iter().map(|s| (s.index, s.copy)).collect();
        assert_eq!((steps, path.placement), (vec![(1, 1), (1, 1)], 0), "{path:?}");
        assert_eq!(paths.find(expected.len() as u64), None);
    }
}
