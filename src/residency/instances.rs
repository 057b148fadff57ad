//! A scene's instances, in runs that its revisions share.

use std::sync::Arc;

use super::model::{AssetModel, ModelInstance};
use crate::bake::pack::Counts;
use crate::math::Bounds;

/// Instances one behind the other, with what they add up to. Never changed: who changes one of them makes a new run.
#[derive(Debug)]
pub struct InstanceRun {
    pub members: Vec<ModelInstance>,
    pub totals: Counts,
    /// World-space box around them.
    pub bounds: Bounds,
    /// The axes of their kernels in world units, summed over samples, and how many samples there are.
    pub kernels: (f64, f64),
}

impl Default for InstanceRun {
    fn default() -> Self {
        InstanceRun {
            members: Vec::new(),
            totals: Counts::default(),
            bounds: Bounds::EMPTY,
            kernels: (0.0, 0.0),
        }
    }
}

impl InstanceRun {
    /// These instances, with numbers that begin at `first`.
    pub fn numbered_from(&self, first: u32) -> InstanceRun {
        let members = self.members.iter().zip(first..);
        InstanceRun {
            members: members.map(|(member, id)| ModelInstance { id, ..*member }).collect(),
            ..*self
        }
    }
}

/// The instances of a scene.
#[derive(Clone, Debug, Default)]
pub struct Instances {
    runs: Vec<Arc<InstanceRun>>,
    count: usize,
}

impl Instances {
    pub fn new(runs: Vec<Arc<InstanceRun>>) -> Instances {
        let count = runs.iter().map(|run| run.members.len()).sum();
        Instances { runs, count }
    }

    pub fn runs(&self) -> &[Arc<InstanceRun>] {
        &self.runs
    }

    pub fn iter(&self) -> impl Iterator<Item = &ModelInstance> {
        self.runs.iter().flat_map(|run| &run.members)
    }

    pub fn len(&self) -> usize {
        self.count
    }

    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// The world-space box around every instance.
    pub fn bounds(&self) -> Bounds {
        self.runs.iter().fold(Bounds::EMPTY, |all, run| all.union(run.bounds))
    }

    pub fn totals(&self) -> Counts {
        self.runs.iter().map(|run| run.totals).sum()
    }

    /// Mean length of kernels' axes in world units; 0 where there are no samples.
    pub fn mean_kernel(&self) -> f64 {
        let add = |(sum, count): (f64, f64), run: &Arc<InstanceRun>| {
            (sum + run.kernels.0, count + run.kernels.1)
        };
        let (sum, count) = self.runs.iter().fold((0.0, 0.0), add);
        if count > 0.0 && f64::is_finite(sum) { sum / count } else { 0.0 }
    }
}

/// Adds up instances of these assets.
pub struct RunMeter<'a> {
    assets: &'a [Arc<AssetModel>],
    kernels: Vec<Vec<(f64, f64)>>,
    totals: Vec<Vec<Counts>>,
}

impl<'a> RunMeter<'a> {
    pub fn new(assets: &'a [Arc<AssetModel>]) -> RunMeter<'a> {
        let kernels = assets.iter().map(|asset| asset.kernels()).collect();
        let of_asset = |asset: &Arc<AssetModel>| {
            (0..asset.packed.geometries.len()).map(|geometry| counts(asset, geometry)).collect()
        };
        RunMeter { assets, kernels, totals: assets.iter().map(of_asset).collect() }
    }

    pub fn run(&self, members: Vec<ModelInstance>) -> InstanceRun {
        let mut totals = Counts::default();
        let mut bounds = Bounds::EMPTY;
        let mut kernels = (0.0, 0.0);
        for member in &members {
            totals += self.totals[member.asset][member.geometry];
            let local = &self.assets[member.asset].bounds[member.geometry];
            bounds = bounds.union(local.transformed(&member.world_from_geometry));
            let (kernel, samples) = self.kernels[member.asset][member.geometry];
            let map = member.world_from_geometry.matrix3;
            let scale = map.x_axis.length().max(map.y_axis.length()).max(map.z_axis.length());
            kernels.0 += samples * kernel * scale;
            kernels.1 += samples;
        }
        InstanceRun { members, totals, bounds, kernels }
    }
}

/// Counts of one instance of a geometry, with what is drawn wherever it is.
fn counts(asset: &AssetModel, geometry: usize) -> Counts {
    let drawn = asset.drawn_with(geometry).map(|drawn| asset.packed.geometries[drawn].counts());
    Counts { instances: 1, ..drawn.sum() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bake::tree::Above;
    use glam::{DAffine3, DVec3};

    fn member(id: u32) -> ModelInstance {
        ModelInstance {
            asset: 0,
            geometry: 0,
            world_from_geometry: DAffine3::from_translation(DVec3::splat(f64::from(id))),
            material: None,
            id,
            above: Above::NOTHING,
        }
    }

    #[test]
    fn runs_are_one_list() {
        let run = |ids: std::ops::Range<u32>| {
            let members: Vec<_> = ids.map(member).collect();
            let totals = Counts { instances: members.len() as u64, ..Counts::default() };
            Arc::new(InstanceRun { members, totals, ..InstanceRun::default() })
        };
        let instances = Instances::new(vec![run(1..4), run(4..4), run(4..9)]);
        assert_eq!(instances.len(), 8);
        assert!(instances.iter().map(|member| member.id).eq(1..9));
        assert_eq!(instances.totals().instances, 8);
        let renumbered = instances.runs()[2].numbered_from(2);
        assert!(renumbered.members.iter().map(|member| member.id).eq(2..7));
        assert_eq!(renumbered.members[0].world_from_geometry.translation, DVec3::splat(4.0));
        assert_eq!(renumbered.totals, instances.runs()[2].totals);
    }
}
