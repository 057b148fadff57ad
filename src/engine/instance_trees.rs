//! Trees over a scene's instances. From afar, groups of instances are a few nodes; an edit rebuilds only the trees over what it
//! moved.
//!
//! ```text
//! instances ──▶ roots of their trees, along a Morton curve of a cube about the origin
//!           ──▶ blocks: cells of that cube's octree, split while they hold more than BLOCK   (a bucket PR octree, Samet 1990)
//!           ──▶ a tree over each block, and one over the blocks
//! ```
//!
//! The instances of a block depend only on their positions and not on the scene's history, so an edited scene has the same trees
//! as one loaded in that state. A block whose cell has no added, removed or moved instance keeps its tree and its GPU data.

mod cells;

use std::collections::HashMap;
use std::ops::Range;
use std::sync::{Arc, OnceLock};

use glam::{DAffine3, DMat3, DVec3, Vec3};
use rayon::prelude::*;

use self::cells::{Member, cells, exponent, key, keys_of};
use super::EngineError;
use super::uid::next_uid;
use crate::assets::PointCloud;
use crate::bake::pack::{ALWAYS, PackedAsset, PackedGeometry, PackedSamples};
use crate::bake::tree::{Above, Measures, Root, build_over_instances};
use crate::bake::{CUTOFF, circle};
use crate::math::Bounds;
use crate::memory::Reservation;
use crate::residency::instances::{InstanceRun, Instances, RunMeter};
use crate::residency::model::{AssetModel, ModelInstance, SceneModel};
use crate::residency::once::MadeOnce;
use crate::scene::color::{linear_from_srgb, srgb_from_linear};

/// Key of an instance that no tree can stand for ([`root_of`]) or that has no position; it is drawn by itself.
const LOOSE: u128 = u128::MAX;

/// A cell of the octree and the tree over its instances.
struct Block {
    /// The cell's least key, and its depth.
    cell: (u128, u32),
    /// `None` over a single instance, which is `lone`.
    over: Option<Over>,
    root: Root,
}

struct Over {
    tree: Arc<AssetModel>,
    /// For each instance of the run, its place among the block's members.
    order: Vec<u32>,
    run: Arc<InstanceRun>,
}

/// The trees over the instances of one revision of a scene.
pub struct InstanceTrees {
    /// Instances of the scene as loaded.
    instances: Instances,
    /// The cube reaches from −2ᵉ to 2ᵉ along each axis.
    exponent: i32,
    members: Vec<Member>,
    blocks: Vec<Arc<Block>>,
}

/// A scene of trees together with the trees over its instances.
pub struct InstanceTreeScene {
    /// The scene's own assets, then the trees over blocks, then the tree over all.
    pub assets: Vec<Arc<AssetModel>>,
    pub instances: Instances,
    /// Nodes of the added trees, number of blocks, and number of blocks that were rebuilt.
    pub nodes: u64,
    pub blocks: usize,
    pub made: usize,
}

/// Computes the roots of instances: the scene, and the root of each geometry of its assets as trees.
struct Roots<'a> {
    model: &'a SceneModel,
    meter: RunMeter<'a>,
    of_geometry: Vec<Vec<Option<Root>>>,
}

impl InstanceTrees {
    /// Builds the trees over the instances of `model`; `assets` are its assets as trees, `before` an earlier revision's trees.
    ///
    /// # Errors
    /// Positions that no tree can be built over.
    pub fn over(
        model: &SceneModel,
        assets: &[Arc<AssetModel>],
        before: Option<&InstanceTrees>,
    ) -> Result<(InstanceTrees, InstanceTreeScene), EngineError> {
        let roots = Roots::of(model, assets);
        let exponent = exponent(&model.instances.bounds());
        let runs = model.instances.runs();
        let before = before.filter(|before| {
            before.exponent == exponent && before.instances.runs().len() == runs.len()
        });
        let changes = match before {
            Some(before) => Changes::since(before, &roots, exponent),
            None => Changes::all(&roots, exponent),
        };
        let members = changes.merged(before.map_or(&[][..], |before| &before.members));
        let placed = members.partition_point(|member| member.key != LOOSE);
        let known: HashMap<(u128, u32), &Arc<Block>> = before
            .iter()
            .flat_map(|before| &before.blocks)
            .map(|block| (block.cell, block))
            .collect();
        let cells = cells(&members[..placed]);
        let blocks = cells
            .par_iter()
            .map(|(cell, range)| {
                let members = &members[range.clone()];
                let keys = keys_of(*cell);
                match known.get(cell) {
                    Some(block) if !changes.touches(&keys) => {
                        let numbered = changes.renumbers(&keys);
                        let kept = || Arc::clone(block);
                        let block =
                            if numbered { block.numbered(&roots, members).into() } else { kept() };
                        Ok((block, false))
                    }
                    _ => Ok((Arc::new(roots.block(*cell, members)?), true)),
                }
            })
            .collect::<Result<Vec<(Arc<Block>, bool)>, EngineError>>()?;
        let made = blocks.iter().filter(|(_, made)| *made).count();
        let blocks: Vec<Arc<Block>> = blocks.into_iter().map(|(block, _)| block).collect();
        let lone: Vec<Option<Member>> = cells
            .iter()
            .map(|(_, range)| (range.len() == 1).then(|| members[range.start]))
            .collect();
        let loose = &members[placed..];
        let made_scene = made_scene(&roots, assets, &blocks, &lone, loose, made)?;
        Ok((
            InstanceTrees { instances: model.instances.clone(), exponent, members, blocks },
            made_scene,
        ))
    }
}

/// Builds a tree over the blocks, and collects everything that is drawn in one list.
fn made_scene(
    roots: &Roots<'_>,
    assets: &[Arc<AssetModel>],
    blocks: &[Arc<Block>],
    lone: &[Option<Member>],
    loose: &[Member],
    made: usize,
) -> Result<InstanceTreeScene, EngineError> {
    let mut assets = assets.to_vec();
    let mut runs: Vec<Arc<InstanceRun>> = Vec::with_capacity(blocks.len() + 1);
    let (top, above) = tree_over(blocks.iter().map(|block| block.root.clone()))?;
    let mut nodes = 0;
    let mut last: Vec<ModelInstance> = Vec::new();
    for (block, above) in above {
        let index = block as usize;
        match (&blocks[index].over, lone[index]) {
            (Some(over), _) => {
                last.push(ModelInstance { above, ..over_all(assets.len()) });
                nodes += over.tree.counts().samples;
                assets.push(over.tree.clone());
            }
            (None, Some(member)) => last.push(ModelInstance { above, ..*roots.instance(member) }),
            (None, None) => {}
        }
    }
    runs.extend(blocks.iter().filter_map(|block| Some(block.over.as_ref()?.run.clone())));
    last.extend(loose.iter().map(|&member| *roots.instance(member)));
    if !top.nodes.is_empty() {
        last.push(over_all(assets.len()));
        nodes += top.nodes.len() as u64;
        let bounds = Bounds::of(blocks.iter().map(|block| block.root.position));
        assets.push(Arc::new(tree_asset(top, bounds)));
    }
    runs.push(Arc::new(RunMeter::new(&assets).run(last)));
    Ok(InstanceTreeScene {
        assets,
        instances: Instances::new(runs),
        nodes,
        blocks: blocks.len(),
        made,
    })
}

/// Returns an instance of a tree over others, which is in world space.
fn over_all(asset: usize) -> ModelInstance {
    ModelInstance {
        asset,
        geometry: 0,
        world_from_geometry: DAffine3::IDENTITY,
        material: None,
        id: 0,
        above: Above::NOTHING,
    }
}

fn tree_asset(packed: PackedSamples, bounds: Bounds) -> AssetModel {
    AssetModel {
        memory: Reservation::default(),
        uid: next_uid(),
        name: "instances".to_owned(),
        format: "instances",
        packed: PackedAsset {
            geometries: vec![PackedGeometry::Samples(packed)],
            materials: Vec::new(),
            textures: Vec::new(),
        },
        bounds: vec![bounds],
        has_colors: true,
        shows_intensity: false,
        has_normals: true,
        normals_estimated: false,
        beside: Vec::new(),
        tree: MadeOnce::default(),
        deferred: None,
        outlined: OnceLock::new(),
    }
}

/// Builds the tree over `members`, and returns which of its nodes stand above each.
fn tree_over(
    members: impl ExactSizeIterator<Item = Root>,
) -> Result<(PackedSamples, Vec<(u32, Above)>), EngineError> {
    let count = members.len();
    let mut cloud = PointCloud { oriented: true, ..PointCloud::default() };
    let (mut normals, mut colors) = (Vec::with_capacity(count), Vec::with_capacity(count));
    let (mut kernels, mut stands) = (Vec::with_capacity(count), Vec::with_capacity(count));
    for root in members {
        cloud.positions.push(root.position);
        normals.push(root.normal);
        colors.push(root.color);
        kernels.push(circle(root.normal, root.radius / CUTOFF));
        stands.push(root.measures);
    }
    cloud.normals = Some(normals);
    cloud.colors = Some(colors);
    cloud.kernels = Some(kernels);
    build_over_instances(&cloud, &stands).map_err(|error| {
        EngineError::Internal(format!("a tree over the instances cannot be built: {error}"))
    })
}

impl Block {
    /// Returns the block with its instances' current numbers.
    fn numbered(&self, roots: &Roots<'_>, members: &[Member]) -> Block {
        let over = self.over.as_ref().map(|over| {
            let places = over.order.iter().zip(&over.run.members);
            let instances = places.map(|(&place, old)| ModelInstance {
                above: old.above,
                ..*roots.instance(members[place as usize])
            });
            let members = instances.collect();
            Over {
                tree: over.tree.clone(),
                order: over.order.clone(),
                run: Arc::new(InstanceRun { members, ..*over.run }),
            }
        });
        Block { over, root: self.root.clone(), ..*self }
    }
}

impl<'a> Roots<'a> {
    fn of(model: &'a SceneModel, assets: &'a [Arc<AssetModel>]) -> Roots<'a> {
        let of_asset = |asset: &Arc<AssetModel>| {
            (0..asset.packed.geometries.len()).map(|geometry| root_of(asset, geometry)).collect()
        };
        let of_geometry = assets.iter().map(of_asset).collect();
        Roots { model, meter: RunMeter::new(assets), of_geometry }
    }

    fn instance(&self, member: Member) -> &'a ModelInstance {
        &self.model.instances.runs()[member.run as usize].members[member.index as usize]
    }

    /// Returns the root of an instance's tree in world space; `None` for an instance that no tree can stand for or that has no position.
    fn root(&self, instance: &ModelInstance) -> Option<Root> {
        let root = self.of_geometry[instance.asset][instance.geometry].as_ref()?;
        let map = &instance.world_from_geometry;
        let position = map.transform_point3(root.position);
        let scale = stretch(&map.matrix3) as f32;
        if !(position.is_finite() && scale.is_finite()) {
            return None;
        }
        let Measures { error, size, area, cone } = root.measures;
        let (normal, area_scale) = area_under(&map.matrix3, root.normal);
        Some(Root {
            position,
            normal,
            color: self.painted(instance, root.color),
            radius: root.radius * scale,
            measures: Measures {
                error: error * scale,
                size: size * scale,
                area: area * area_scale as f32,
                cone,
            },
        })
    }

    /// Returns the color of an instance's root under its material.
    fn painted(&self, instance: &ModelInstance, color: [u8; 4]) -> [u8; 4] {
        let material = instance.material.and_then(|index| self.model.materials.get(index));
        let Some(base) = material.and_then(|material| material.base_color) else { return color };
        let channel = |i: usize| {
            let linear = linear_from_srgb(f64::from(color[i]) / 255.0) * f64::from(base[i]);
            (srgb_from_linear(linear.clamp(0.0, 1.0)) * 255.0).round() as u8
        };
        [channel(0), channel(1), channel(2), color[3]]
    }

    /// Returns the members of a run of the scene.
    fn members(&self, run: usize, exponent: i32) -> Vec<Member> {
        let instances = &self.model.instances.runs()[run].members;
        let member = |(index, instance): (usize, &ModelInstance)| {
            let key = self.root(instance).map_or(LOOSE, |root| key(root.position, exponent));
            Member { key, run: run as u32, index: index as u32 }
        };
        instances.par_iter().enumerate().map(member).collect()
    }

    /// Builds the tree over a block.
    fn block(&self, cell: (u128, u32), members: &[Member]) -> Result<Block, EngineError> {
        let internal = || EngineError::Internal("an instance without a tree in a block".to_owned());
        let all: Option<Vec<Root>> =
            members.iter().map(|&member| self.root(self.instance(member))).collect();
        let all = all.ok_or_else(internal)?;
        if let [root] = &all[..] {
            return Ok(Block { cell, over: None, root: root.clone() });
        }
        let bounds = Bounds::of(all.iter().map(|root| root.position));
        let (packed, above) = tree_over(all.into_iter())?;
        let root = Root::of(&packed).ok_or_else(internal)?;
        let (mut order, mut drawn) = (Vec::new(), Vec::new());
        for (place, above) in above {
            order.push(place);
            drawn.push(ModelInstance { above, ..*self.instance(members[place as usize]) });
        }
        let tree = Arc::new(tree_asset(packed, bounds));
        let run = Arc::new(self.meter.run(drawn));
        Ok(Block { cell, over: Some(Over { tree, order, run }), root })
    }
}

/// Returns the root of a geometry's tree; `None` for a geometry without samples, or with triangles that are drawn at any error beside them. A
/// tree over instances has samples alone, so it would leave out these triangles.
fn root_of(asset: &AssetModel, geometry: usize) -> Option<Root> {
    let all = &asset.packed.geometries;
    let beside = asset.beside.get(geometry).copied().flatten();
    if beside.is_some_and(|beside| has_lasting(&all[beside])) {
        return None;
    }
    all[geometry].samples().and_then(Root::of)
}

/// Returns whether some triangles of a mesh beside samples are drawn at any error.
fn has_lasting(geometry: &PackedGeometry) -> bool {
    let PackedGeometry::Triangles(mesh) = geometry else { return false };
    // Sides are packed in cells of the grid.
    let always = (ALWAYS / mesh.grid.step as f32).min(ALWAYS);
    mesh.chunks.iter().any(|chunk| chunk.range.error_parent >= always)
}

/// Returns an upper bound of the largest singular value of a map, the longest that it makes a unit vector.
fn stretch(map: &DMat3) -> f64 {
    let square = map.transpose() * *map;
    // Gershgorin's circles; exact for rotations with uniform scale.
    let row = |v: DVec3| v.abs().element_sum();
    row(square.x_axis).max(row(square.y_axis)).max(row(square.z_axis)).sqrt()
}

/// Returns the matrix that maps directed areas under `map`.
fn cofactors(map: &DMat3) -> DMat3 {
    let (x, y, z) = (map.x_axis, map.y_axis, map.z_axis);
    DMat3::from_cols(y.cross(z), z.cross(x), x.cross(y))
}

/// Flattening by more than this factor turns a ball into a plate.
const FLAT: f64 = 2.0;

/// Returns the unit normal of areas under a map, and the factor of their size. Areas without a normal look alike from everywhere.
/// They stay so, with the mean over the axes, unless the map flattens them into plates, which have a normal.
fn area_under(map: &DMat3, normal: Vec3) -> (Vec3, f64) {
    let cofactors = cofactors(map);
    let sign = map.determinant().signum();
    let unit = |area: DVec3| area.try_normalize().map_or(Vec3::ZERO, |n| n.as_vec3());
    if normal != Vec3::ZERO {
        let area = cofactors * normal.as_dvec3() * sign;
        return (unit(area), area.length());
    }
    let mut areas = [cofactors.x_axis, cofactors.y_axis, cofactors.z_axis];
    areas.sort_by(|a, b| b.length().total_cmp(&a.length()));
    let [most, second, least] = areas.map(DVec3::length);
    if most > FLAT * second {
        return (unit(areas[0]), most);
    }
    (Vec3::ZERO, (most + second + least) / 3.0)
}

/// Differences between two revisions of a scene.
struct Changes {
    /// Removed members in order, as are the added ones.
    removed: Vec<Member>,
    added: Vec<Member>,
    /// Keys of removed and added members.
    touched: Vec<u128>,
    /// Keys of instances whose numbers changed and whose places did not.
    renumbered: Vec<u128>,
}

impl Changes {
    fn all(roots: &Roots<'_>, exponent: i32) -> Changes {
        let runs = 0..roots.model.instances.runs().len();
        let added = runs.flat_map(|run| roots.members(run, exponent)).collect();
        Changes::new(Vec::new(), added, Vec::new())
    }

    fn since(before: &InstanceTrees, roots: &Roots<'_>, exponent: i32) -> Changes {
        let (mut removed, mut added, mut renumbered) = (Vec::new(), Vec::new(), Vec::new());
        let runs = before.instances.runs().iter().zip(roots.model.instances.runs());
        for (number, (old, new)) in runs.enumerate() {
            if Arc::ptr_eq(old, new) {
                continue;
            }
            let key_of = |instance: &ModelInstance| {
                roots.root(instance).map_or(LOOSE, |root| key(root.position, exponent))
            };
            let now = roots.members(number, exponent);
            if old.members.len() != new.members.len() {
                let members = old.members.iter().enumerate();
                removed.extend(members.map(|(index, instance)| Member {
                    key: key_of(instance),
                    run: number as u32,
                    index: index as u32,
                }));
                added.extend(now);
                continue;
            }
            for (member, (old, new)) in now.into_iter().zip(old.members.iter().zip(&new.members)) {
                if *old == *new {
                    continue;
                }
                if (ModelInstance { id: old.id, ..*new }) == *old {
                    renumbered.push(member.key);
                } else {
                    removed.push(Member { key: key_of(old), ..member });
                    added.push(member);
                }
            }
        }
        Changes::new(removed, added, renumbered)
    }

    fn new(mut removed: Vec<Member>, mut added: Vec<Member>, mut renumbered: Vec<u128>) -> Changes {
        removed.par_sort_unstable();
        added.par_sort_unstable();
        renumbered.par_sort_unstable();
        let mut touched: Vec<u128> =
            removed.iter().chain(&added).map(|member| member.key).collect();
        touched.par_sort_unstable();
        Changes { removed, added, touched, renumbered }
    }

    /// Returns the members after the changes.
    fn merged(&self, before: &[Member]) -> Vec<Member> {
        let mut merged = Vec::with_capacity(before.len() + self.added.len());
        let mut removed = self.removed.iter().peekable();
        let mut added = self.added.iter().peekable();
        for member in before {
            while let Some(next) = added.next_if(|next| *next < member) {
                merged.push(*next);
            }
            if removed.next_if_eq(&member).is_none() {
                merged.push(*member);
            }
        }
        merged.extend(added);
        merged
    }

    fn touches(&self, keys: &Range<u128>) -> bool {
        holds(&self.touched, keys)
    }

    fn renumbers(&self, keys: &Range<u128>) -> bool {
        holds(&self.renumbered, keys)
    }
}

/// Returns whether one of `sorted` is in the range.
fn holds(sorted: &[u128], range: &Range<u128>) -> bool {
    let next = sorted.partition_point(|key| *key < range.start);
    sorted.get(next).is_some_and(|key| *key < range.end)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig { cases: 60, ..ProptestConfig::default() })]

        #[test]
        fn merging_is_removing_and_adding(
            before in prop::collection::btree_set((0u128..200, 0u32..4), 0..80),
            after in prop::collection::btree_set((0u128..200, 0u32..4), 0..80),
        ) {
            let list = |set: &std::collections::BTreeSet<(u128, u32)>| -> Vec<Member> {
                set.iter().map(|&(key, index)| Member { key, run: 0, index }).collect()
            };
            let removed = list(&before.difference(&after).copied().collect());
            let added = list(&after.difference(&before).copied().collect());
            let changes = Changes::new(removed.clone(), added.clone(), Vec::new());
            prop_assert_eq!(changes.merged(&list(&before)), list(&after));
            for range in [0u128..50, 50..51, 51..200] {
                let inside = |members: &[Member]| members.iter().any(|m| range.contains(&m.key));
                prop_assert_eq!(changes.touches(&range), inside(&removed) || inside(&added));
            }
        }
    }
}
