//! The graphs of prototypes and of solids: no cycles, bounded depth, and how many instances it unfolds to.
//!
//! Prototypes that use one another form a directed graph. It is sorted topologically (Kahn 1962),
//! users after what they use; what cannot be sorted holds a cycle. In that order depth and number
//! of instances follow from one pass without unfolding anything, so that a file of a few hundred
//! bytes that describes 2⁶⁴ instances is refused in microseconds.

use super::validate::Reason;
use super::{Draws, Node, Repeat, Scene, SceneLimits};

/// Refuses cycles, depth and number of instances over the limits.
pub(super) fn check(scene: &Scene, limits: &SceneLimits) -> Result<(), Reason> {
    check_solids(scene, limits)?;
    let order = topological_order(scene).map_err(|cycle| {
        let names: Vec<&str> = cycle.iter().map(|&i| scene.prototypes[i].name.as_str()).collect();
        let place = format!("prototypes.{}", names.first().copied().unwrap_or_default());
        Reason::At(place, format!("contains itself: {}", names.join(" → ")))
    })?;
    let mut depths = vec![0u64; scene.prototypes.len()];
    for &index in &order {
        depths[index] = depth(&scene.prototypes[index].children, &depths);
    }
    let deepest = depths.iter().copied().max().unwrap_or(0).max(depth(&scene.nodes, &depths));
    if deepest > u64::from(limits.max_depth) {
        let limit = u64::from(limits.max_depth);
        return Err(Reason::TooLarge { what: "depth of nodes", found: deepest, limit });
    }
    let counts = count_prototypes(scene, &order, false);
    let found = count_nodes(&scene.nodes, &counts, false);
    if found > limits.max_instances {
        let limit = limits.max_instances;
        return Err(Reason::TooLarge { what: "instances", found, limit });
    }
    Ok(())
}

/// Refuses solids that are made of themselves, nested too deeply, or that expand to too many operands.
fn check_solids(scene: &Scene, limits: &SceneLimits) -> Result<(), Reason> {
    let found = scene.assets.iter().map(|asset| asset.operands().len() as u64).sum();
    if found > limits.max_nodes {
        return Err(Reason::TooLarge { what: "operands", found, limit: limits.max_nodes });
    }
    let uses: Vec<Vec<usize>> = scene
        .assets
        .iter()
        .map(|asset| asset.operands().iter().map(|operand| operand.asset).collect())
        .collect();
    let order = sort(uses.clone()).map_err(|cycle| {
        let names: Vec<&str> = cycle.iter().map(|&i| scene.assets[i].name.as_str()).collect();
        let place = format!("assets.{}", names.first().copied().unwrap_or_default());
        Reason::At(place, format!("is made of itself: {}", names.join(" → ")))
    })?;
    let mut depths = vec![0u64; uses.len()];
    for &index in &order {
        depths[index] = 1 + uses[index].iter().map(|&used| depths[used]).max().unwrap_or(0);
    }
    let found = depths.into_iter().max().unwrap_or(0);
    if found > u64::from(limits.max_depth) {
        let limit = u64::from(limits.max_depth);
        return Err(Reason::TooLarge { what: "depth of solids", found, limit });
    }
    // Every use of a solid counts as all that the solid is made of.
    let mut expanded = vec![1u64; uses.len()];
    for index in order.into_iter().filter(|&index| !uses[index].is_empty()) {
        expanded[index] =
            uses[index].iter().fold(0, |sum: u64, &used| sum.saturating_add(expanded[used]));
        if expanded[index] > limits.max_operands {
            let (asset, limit) = (&scene.assets[index], limits.max_operands);
            let found = expanded[index];
            let reason = format!(
                "expands to {found} operands, as every use of a solid counts all that the solid is made of; at most {limit}"
            );
            return Err(Reason::At(format!("assets.{}", asset.name), reason));
        }
    }
    Ok(())
}

/// Indices of prototypes, each after all that it uses; or the indices along a cycle, the first one
/// repeated at the end.
pub(super) fn topological_order(scene: &Scene) -> Result<Vec<usize>, Vec<usize>> {
    let uses = |children: &[Node]| {
        let mut used = Vec::new();
        collect_uses(children, &mut used);
        used
    };
    sort(scene.prototypes.iter().map(|prototype| uses(&prototype.children)).collect())
}

/// Sorts what uses one another, given what each one uses, as [`topological_order`] does.
fn sort(mut uses: Vec<Vec<usize>>) -> Result<Vec<usize>, Vec<usize>> {
    let count = uses.len();
    let mut users: Vec<Vec<usize>> = vec![Vec::new(); count];
    for (index, used) in uses.iter_mut().enumerate() {
        used.sort_unstable();
        used.dedup();
        for &other in used.iter() {
            users[other].push(index);
        }
    }
    let mut missing: Vec<usize> = uses.iter().map(Vec::len).collect();
    let mut order: Vec<usize> = (0..count).filter(|&i| missing[i] == 0).collect();
    let mut next = 0;
    while let Some(&index) = order.get(next) {
        next += 1;
        for &user in &users[index] {
            missing[user] -= 1;
            if missing[user] == 0 {
                order.push(user);
            }
        }
    }
    let Some(start) = (0..count).find(|&i| missing[i] > 0) else { return Ok(order) };
    // Each one that is left uses another one that is left: walking on must come back somewhere.
    let mut walk = vec![start];
    let mut position = vec![None; count];
    let mut here = start;
    loop {
        position[here] = Some(walk.len() - 1);
        let Some(&onward) = uses[here].iter().find(|&&i| missing[i] > 0) else { return Err(walk) };
        walk.push(onward);
        if let Some(first) = position[onward] {
            return Err(walk.split_off(first));
        }
        here = onward;
    }
}

fn collect_uses(nodes: &[Node], used: &mut Vec<usize>) {
    for node in nodes {
        if let Draws::Prototype(index) = node.draws {
            used.push(index);
        }
        collect_uses(&node.children, used);
    }
}

/// Levels of nodes below and including `nodes`.
fn depth(nodes: &[Node], prototype_depths: &[u64]) -> u64 {
    let below = |node: &Node| {
        let drawn = match node.draws {
            Draws::Prototype(index) => prototype_depths[index],
            Draws::Asset(_) | Draws::Nothing => 0,
        };
        1 + drawn.max(depth(&node.children, prototype_depths))
    };
    nodes.iter().map(below).max().unwrap_or(0)
}

/// Instances in one copy of each prototype; of visible nodes only, or of all.
pub(super) fn count_prototypes(scene: &Scene, order: &[usize], visible_only: bool) -> Vec<u64> {
    let mut counts = vec![0; scene.prototypes.len()];
    for &index in order {
        counts[index] = count_nodes(&scene.prototypes[index].children, &counts, visible_only);
    }
    counts
}

/// Instances in all copies of `nodes`, saturating.
pub(super) fn count_nodes(nodes: &[Node], prototype_counts: &[u64], visible_only: bool) -> u64 {
    nodes
        .iter()
        .filter(|node| node.visible || !visible_only)
        .map(|node| {
            let drawn = match node.draws {
                Draws::Nothing => 0,
                Draws::Asset(_) => 1,
                Draws::Prototype(index) => prototype_counts[index],
            };
            let below = count_nodes(&node.children, prototype_counts, visible_only);
            node.repeat.count().saturating_mul(drawn.saturating_add(below))
        })
        .fold(0, u64::saturating_add)
}

impl Repeat {
    /// Number of copies, saturating.
    pub fn count(&self) -> u64 {
        match *self {
            Repeat::Once => 1,
            Repeat::Grid { counts: [x, y, z], .. } => {
                u64::from(x).saturating_mul(u64::from(y)).saturating_mul(u64::from(z))
            }
            Repeat::Scatter { count, .. } => u64::from(count),
        }
    }
}
