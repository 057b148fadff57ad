//! The buffer of a scene's instances where assets are point trees: revisions of the scene share it.
//!
//! ```text
//! runs of the model    │ run a: 70          │ run b: 33 │ …        from one revision to the next most stay
//! groups of a run      │ 32   32   6        │ 32   1    │          as the passes cull them
//! slots of the buffer  0 1 2 3 4 5 …                              room for 32 instances each, in any order
//! ```
//!
//! A slot holds one group, so that there are no gaps that a group does not fit into. What is listed is in the order of the runs,
//! wherever the slots are: a frame does not depend on which edits led to its scene.

use std::collections::HashMap;
use std::sync::Arc;

use super::instances::{InstanceRun, Instances};
use super::layout::{GpuInstance, GpuInstanceGroup, INSTANCE_GROUP};

/// The owner of each slot.
pub struct Slots {
    capacity: u32,
    free: Vec<u32>,
    /// By the address of the run, which is held, so that no other has it.
    placed: HashMap<usize, (Arc<InstanceRun>, Vec<GpuInstanceGroup>)>,
}

pub const SLOT_BYTES: u64 = (INSTANCE_GROUP * size_of::<GpuInstance>()) as u64;

fn groups_of_run(run: &InstanceRun) -> usize {
    run.members.len().div_ceil(INSTANCE_GROUP)
}

/// Groups of all runs.
pub fn groups_of(instances: &Instances) -> usize {
    instances.runs().iter().map(|run| groups_of_run(run)).sum()
}

/// Slots for so many groups, with room for edits.
fn roomy(groups: usize) -> u64 {
    groups as u64 + groups as u64 / 8
}

/// Bytes of the slots for so many groups, and of the groups' records.
pub fn bytes(groups: usize) -> u64 {
    roomy(groups) * SLOT_BYTES + (groups * size_of::<GpuInstanceGroup>()) as u64
}

fn key(run: &Arc<InstanceRun>) -> usize {
    Arc::as_ptr(run) as usize
}

impl Slots {
    /// Free slots for `instances` and some more, as many as a buffer of `most_bytes` holds.
    pub fn for_instances(instances: &Instances, most_bytes: u64) -> Slots {
        let needed = groups_of(instances);
        let most = (most_bytes / SLOT_BYTES).max(needed as u64);
        let capacity = roomy(needed).min(most) as u32;
        // From the last one on, so that the first are taken first.
        Slots { capacity, free: (0..capacity).rev().collect(), placed: HashMap::new() }
    }

    pub fn bytes(&self) -> u64 {
        u64::from(self.capacity) * SLOT_BYTES
    }

    /// Instances that there is room for: all numbers are less.
    pub fn end(&self) -> u32 {
        self.capacity * INSTANCE_GROUP as u32
    }

    /// Frees what `instances` does not have; whether there is room for the rest of it.
    pub fn keep(&mut self, instances: &Instances) -> bool {
        let mut gone = std::mem::take(&mut self.placed);
        let mut missing = 0;
        for run in instances.runs() {
            match gone.remove_entry(&key(run)) {
                Some((key, placed)) => _ = self.placed.insert(key, placed),
                // A run that stands twice in the list is one.
                None if self.placed.contains_key(&key(run)) => {}
                None => missing += groups_of_run(run),
            }
        }
        let groups = gone.into_values().flat_map(|(_, groups)| groups);
        self.free.extend(groups.map(|group| group.first / INSTANCE_GROUP as u32));
        // Neighbours, written together.
        self.free.sort_unstable_by(|a, b| b.cmp(a));
        missing <= self.free.len()
    }

    pub fn has(&self, run: &Arc<InstanceRun>) -> bool {
        self.placed.contains_key(&key(run))
    }

    /// Places a run whose groups are these, in order; their first instances are set. `None` where there is no room for it.
    pub fn place(
        &mut self,
        run: &Arc<InstanceRun>,
        mut groups: Vec<GpuInstanceGroup>,
    ) -> Option<&[GpuInstanceGroup]> {
        if groups.len() > self.free.len() {
            return None;
        }
        for group in &mut groups {
            group.first = self.free.pop()? * INSTANCE_GROUP as u32;
        }
        let (_, groups) = self.placed.entry(key(run)).or_insert((run.clone(), groups));
        Some(groups)
    }

    /// The groups of all runs, in their order.
    pub fn listed(&self, instances: &Instances) -> Vec<GpuInstanceGroup> {
        let placed = instances.runs().iter().filter_map(|run| self.placed.get(&key(run)));
        placed.flat_map(|(_, groups)| groups.iter().copied()).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::super::model::ModelInstance;
    use super::*;
    use crate::bake::tree::Above;
    use glam::DAffine3;
    use proptest::prelude::*;

    fn run(members: usize) -> Arc<InstanceRun> {
        let member = ModelInstance {
            asset: 0,
            geometry: 0,
            world_from_geometry: DAffine3::IDENTITY,
            material: None,
            id: 1,
            above: Above::NOTHING,
        };
        Arc::new(InstanceRun { members: vec![member; members], ..InstanceRun::default() })
    }

    fn groups(run: &InstanceRun) -> Vec<GpuInstanceGroup> {
        let members = run.members.chunks(INSTANCE_GROUP);
        members
            .map(|members| GpuInstanceGroup {
                count: members.len() as u32,
                ..GpuInstanceGroup::default()
            })
            .collect()
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 100, ..ProptestConfig::default() })]
        #[test]
        fn groups_never_share_a_slot_and_stay_where_they_are(
            first in prop::collection::vec(0usize..100, 1..20),
            edits in prop::collection::vec((any::<prop::sample::Index>(), 0usize..100), 0..40),
        ) {
            let mut runs: Vec<_> = first.into_iter().map(run).collect();
            let mut slots = Slots::for_instances(&Instances::new(runs.clone()), 1 << 20);
            let mut fresh = 0;
            for (place, members) in std::iter::once(None).chain(edits.into_iter().map(Some)).map(|edit| edit.unzip()) {
                if let (Some(place), Some(members)) = (place, members) {
                    let place = place.index(runs.len());
                    runs[place] = run(members);
                }
                let instances = Instances::new(runs.clone());
                let before: HashMap<usize, Vec<u32>> = slots
                    .placed
                    .iter()
                    .map(|(&key, (_, groups))| (key, groups.iter().map(|g| g.first).collect()))
                    .collect();
                if !slots.keep(&instances) {
                    slots = Slots::for_instances(&instances, 1 << 20);
                    fresh += 1;
                }
                for run in &runs {
                    if !slots.has(run) {
                        prop_assert!(slots.place(run, groups(run)).is_some());
                    } else if let Some(before) = before.get(&key(run)) {
                        let now = slots.placed[&key(run)].1.iter().map(|group| group.first);
                        prop_assert!(now.eq(before.iter().copied()));
                    }
                }
                let listed = slots.listed(&instances);
                prop_assert!(listed.iter().map(|group| group.count as usize).sum::<usize>() == instances.len());
                let mut firsts: Vec<u32> = listed.iter().map(|group| group.first).collect();
                firsts.sort_unstable();
                prop_assert!(firsts.windows(2).all(|pair| pair[1] - pair[0] >= 32));
                prop_assert!(firsts.last().is_none_or(|last| last + 32 <= slots.end()));
                prop_assert_eq!(firsts.len() + slots.free.len(), slots.capacity as usize);
            }
            prop_assert!(fresh < 40);
        }
    }
}
