//! Scenes in GPU memory (floor 3): pages, budget, eviction, revisions.
//!
//! ```text
//! SceneModel (host) ──upload once──▶ pages: samples │ vertices + triangles │ texels     shared by all scenes
//!                                    tables: chunks │ materials │ textures
//!                                    per scene: instances │ entries │ segments │ lights
//! ```
//! An *entry* is a chunk of an instance; entries are grouped into *segments*, one for each page and kind, padded so that a
//! segment begins at a group boundary of the cull pass. A frame writes none of this: it only reads. When the budget is
//! exceeded the scenes that were used the longest ago are freed ([`Residency::ensure`]), with the assets that no other
//! scene draws; the next frame that needs them brings them back from the host copy.

pub mod arena;
mod evict;
pub mod fields;
mod fits;
pub mod instances;
pub mod layout;
mod lists;
pub mod model;
pub mod once;
mod pages;
mod parts;
mod slots;
pub mod spacing;
mod upload;

use std::collections::{HashMap, HashSet};
use std::ops::Range;
use std::sync::Arc;

use self::arena::Arena;
use self::evict::Holding;
pub use self::fits::{Part, check_fits};
use self::layout::{GpuChunk, GpuEntry, GpuMaterial, GpuSegment, GpuTexture};
use self::model::{AssetModel, SceneModel};
use self::pages::Pages;
use self::parts::ChunkParts;
pub use self::parts::PART;
use self::slots::Slots;
use crate::bake::environment::EnvironmentMap;
use crate::bake::pack::{GeometryKind, PageKind};
use crate::gpu::Gpu;
use crate::gpu::buffer::Buffer;
use crate::scene::fields::SceneField;

/// Entries that one thread of the cull pass tests.
pub const GROUP: usize = 32;

/// A page: its kind and its number among those.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Page {
    pub kind: PageKind,
    pub index: usize,
}

/// A scene that cannot be made resident.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ResidencyError {
    #[error("{what} needs {needed} bytes on the GPU, the budget is {budget}")]
    OverBudget { what: String, needed: u64, budget: u64 },
    /// More than a single binding can hold.
    #[error("{what}: {needed} bytes in one binding, this adapter allows {limit}")]
    OverBinding { what: &'static str, needed: u64, limit: u64 },
}

/// Bytes of the bounds of a chunk's parts, more than those of its record.
const PARTS_BYTES: u64 = size_of::<ChunkParts>() as u64;
const _: () = assert!(PARTS_BYTES >= size_of::<GpuChunk>() as u64);

/// A run of chunks in one page.
struct Piece {
    page: Page,
    /// In the chunk table.
    first_chunk: u32,
    chunk_count: u32,
    /// Elements in the page: samples, or triangles.
    start: u32,
    length: u32,
    /// Vertices in the page.
    vertex_start: u32,
    vertex_length: u32,
}

struct ResidentGeometry {
    pieces: Vec<Piece>,
    chunk_start: u32,
    chunk_length: u32,
}

struct ResidentAsset {
    geometries: Vec<ResidentGeometry>,
    material_start: u32,
    material_length: u32,
    texture_start: u32,
    texture_length: u32,
    /// Texel page, start and length of every texture.
    texels: Vec<(usize, u32, u32)>,
    bytes: u64,
}

/// Which kinds of appearance a scene has: pipelines leave out what it has not.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Looks {
    pub textures: bool,
    /// Some instance overrides its asset's materials.
    pub overrides: bool,
    /// For each kind of geometry, whether some instance has a translucent colour of its own.
    pub translucent_overrides: [bool; GeometryKind::ALL.len()],
    pub specular: bool,
    /// Some material reflects as the metallic-roughness model has it.
    pub physical: bool,
    /// Some material gives off light.
    pub emissive: bool,
    /// Some material lets light pass in place of scattering it.
    pub transmits: bool,
    /// Some material has maps beside that of its colour.
    pub maps: bool,
    pub unlit: bool,
    pub point_lights: bool,
}

impl Looks {
    /// Whether lighting a pixel or a splat takes its material.
    pub fn has_looked_up(&self) -> bool {
        self.overrides || self.specular || self.physical || self.emissive || self.unlit
    }
}

/// Where a frame finds the chunks of a scene's instances.
pub enum Lists {
    Full(FullLists),
    Trees(TreeLists),
}

/// Every chunk of every instance.
pub struct FullLists {
    pub entries: Buffer,
    pub segments: Buffer,
    pub sizes: Buffer,
    /// Entries, padding included; a multiple of [`GROUP`].
    pub entry_count: u32,
    /// Entries that are no padding.
    pub chunk_count: u32,
}

/// Lists from which frames of point trees select their entries.
pub struct TreeLists {
    pub groups: Buffer,
    /// Runs of chunks by geometry and segment.
    pub pieces: Buffer,
    /// Half the size of each geometry, in cells.
    pub geometries: Buffer,
    pub group_count: u32,
}

/// Blurred images of surroundings.
pub struct ResidentEnvironment {
    map: Arc<EnvironmentMap>,
    pub buffer: Buffer,
}

/// Buffers that the passes bind for one scene.
pub struct ResidentScene {
    /// [`SceneModel::uid`].
    model_uid: u64,
    /// [`SceneModel::list_bytes`].
    bytes: u64,
    /// Clock of the last call of [`Residency::ensure`] for it.
    last_used: u64,
    pub instances: Buffer,
    slots: Option<Slots>,
    pub lists: Lists,
    pub lights: Buffer,
    /// Blurred images of its surroundings, where it has some.
    pub environment: Option<ResidentEnvironment>,
    /// Scalar fields of its points and lines, and the table of shaders that shows them.
    pub fields: Vec<SceneField>,
    pub field_table: Buffer,
    /// The page of each segment, in order.
    pub pages: Vec<Page>,
    /// All numbers of instances are less.
    pub instance_end: u32,
    pub light_count: u32,
    /// Samples of all instances.
    pub sample_count: u64,
    /// Some material cuts holes by alpha.
    pub alpha_cut: bool,
    /// Some opaque material has holes that alpha cuts.
    pub cut_outs: bool,
    pub looks: Looks,
    asset_uids: Vec<u64>,
    materials: SceneMaterials,
}

/// Materials that a scene's nodes name, in the table.
struct SceneMaterials {
    start: u32,
    overrides: Vec<GpuMaterial>,
}

impl ResidentScene {
    /// Segments of samples, which come before those of other kinds.
    pub fn sample_segments(&self) -> u32 {
        self.pages.iter().filter(|page| page.kind.kind == GeometryKind::Samples).count() as u32
    }

    /// Whether some samples carry clip lines.
    pub fn has_clip_lines(&self) -> bool {
        self.pages.iter().any(|page| page.kind.clipped)
    }

    /// Entries of a view, padding included, and those that may be none; `capacity`: what there is room for where a frame lists
    /// its own.
    pub fn entries(&self, capacity: u32) -> (u32, u32) {
        match &self.lists {
            Lists::Full(full) => (full.entry_count, full.chunk_count),
            Lists::Trees(_) => (capacity, capacity),
        }
    }

    /// Groups of instances; none where a frame does not list its own entries.
    pub fn instance_groups(&self) -> u32 {
        match &self.lists {
            Lists::Full(_) => 0,
            Lists::Trees(trees) => trees.group_count,
        }
    }

    pub fn has_trees(&self) -> bool {
        matches!(self.lists, Lists::Trees(_))
    }
}

/// GPU memory and what lies in it.
pub struct Residency {
    pages: Pages,
    texels: Vec<Arena>,
    chunks: Arena,
    materials: Arena,
    textures: Arena,
    assets: HashMap<u64, ResidentAsset>,
    scenes: HashMap<String, ResidentScene>,
    budget: u64,
    used: u64,
    clock: u64,
    evictions: u64,
    uploads: u64,
    instances_written: u64,
}

/// Pages of texels that a shader binds.
pub const TEXEL_PAGES: usize = 2;

impl Residency {
    /// Empty; at most `budget` bytes of scenes stay at a time.
    pub fn new(gpu: &Gpu, budget: u64) -> Self {
        let mut materials = Arena::new(gpu, "materials", &[size_of::<GpuMaterial>() as u64]);
        // Number 0: what has no material of its own.
        materials.allocate(gpu, 1);
        materials.write(gpu, 0, 0, &[upload::gpu_material(&Default::default(), 0)]);
        Self {
            pages: Pages::new(gpu),
            texels: (0..TEXEL_PAGES).map(|_| Arena::new(gpu, "texels", &[4])).collect(),
            chunks: Arena::new(gpu, "chunks", &[size_of::<GpuChunk>() as u64, PARTS_BYTES]),
            materials,
            textures: Arena::new(gpu, "textures", &[size_of::<GpuTexture>() as u64]),
            assets: HashMap::new(),
            scenes: HashMap::new(),
            budget,
            used: 0,
            clock: 0,
            evictions: 0,
            uploads: 0,
            instances_written: 0,
        }
    }

    pub fn budget(&self) -> u64 {
        self.budget
    }

    /// Bytes of resident assets and of the lists of resident scenes.
    pub fn used(&self) -> u64 {
        self.used
    }

    pub fn evictions(&self) -> u64 {
        self.evictions
    }

    pub fn uploads(&self) -> u64 {
        self.uploads
    }

    /// Records of instances that were written, of all scenes and revisions.
    pub fn instances_written(&self) -> u64 {
        self.instances_written
    }

    /// Identifiers of the resident scenes, in no order.
    pub fn ids(&self) -> impl Iterator<Item = &str> {
        self.scenes.keys().map(String::as_str)
    }

    /// The buffer of a page that shaders call `name`, if pages of this kind have it.
    pub fn page_buffer(&self, page: Page, name: &str) -> Option<&Buffer> {
        self.pages.buffer(page, name)
    }

    pub fn chunk_table(&self) -> &Buffer {
        self.chunks.buffer(0)
    }

    /// Bounds of the parts of chunks.
    pub fn part_table(&self) -> &Buffer {
        self.chunks.buffer(1)
    }

    pub fn material_table(&self) -> &Buffer {
        self.materials.buffer(0)
    }

    pub fn texture_table(&self) -> &Buffer {
        self.textures.buffer(0)
    }

    pub fn texel_page(&self, index: usize) -> &Buffer {
        self.texels[index].buffer(0)
    }

    /// The place of each geometry in the chunk table, asset by asset; empty where an asset is not resident.
    pub fn chunk_ranges(&self, model: &SceneModel) -> Vec<Range<u32>> {
        let of = |asset: &Arc<AssetModel>| {
            let resident = self.assets.get(&asset.uid);
            (0..asset.packed.geometries.len()).map(move |geometry| {
                let found = resident.and_then(|resident| resident.geometries.get(geometry));
                found.map_or(0..0, |g| g.chunk_start..g.chunk_start + g.chunk_length)
            })
        };
        model.assets.iter().flat_map(of).collect()
    }

    pub fn scene(&self, id: &str) -> Option<&ResidentScene> {
        self.scenes.get(id)
    }

    /// Whether exactly this model, at this revision, is resident.
    pub fn is_current(&self, model: &SceneModel) -> bool {
        self.scenes.get(&model.id).is_some_and(|scene| scene.model_uid == model.uid)
    }

    /// Makes `model` resident, evicting others if need be. Uploads nothing when it is there already. True when buffers of
    /// other scenes or of an earlier revision may have been given up for it.
    ///
    /// # Errors
    /// [`ResidencyError`]; nothing of `model` stays then, and the other scenes that are resident can be drawn.
    pub fn ensure(&mut self, gpu: &Gpu, model: &Arc<SceneModel>) -> Result<bool, ResidencyError> {
        self.clock += 1;
        let missing = !self.is_current(model);
        if missing {
            self.check(gpu, model)?;
            let previous = self.take_scene(&model.id);
            // Assets that only the earlier scene of that name drew would take room from others.
            self.drop_unused_assets(&uids(model));
            if let Err(error) = self.bring(gpu, model, previous) {
                self.drop_unused_assets(&HashSet::new());
                return Err(error);
            }
        }
        if let Some(scene) = self.scenes.get_mut(&model.id) {
            scene.last_used = self.clock;
        }
        Ok(missing)
    }

    /// Uploads what is missing and lists the instances, with what can stay of the revision before.
    fn bring(
        &mut self,
        gpu: &Gpu,
        model: &Arc<SceneModel>,
        mut previous: Option<ResidentScene>,
    ) -> Result<(), ResidencyError> {
        let scene = match self.bring_assets(gpu, model) {
            Ok(()) => loop {
                match self.build_scene(gpu, model, previous.take()) {
                    Ok(scene) => break scene,
                    Err(error) if !self.evict_one(model) => return Err(error),
                    Err(_) => {}
                }
            },
            Err(error) => {
                if let Some(scene) = previous {
                    self.release_materials(&scene.materials);
                }
                return Err(error);
            }
        };
        self.used += scene.bytes;
        self.scenes.insert(model.id.clone(), scene);
        Ok(())
    }

    /// Uploads the assets that are missing, and makes room for the lists.
    fn bring_assets(&mut self, gpu: &Gpu, model: &Arc<SceneModel>) -> Result<(), ResidencyError> {
        let mut afresh = false;
        let mut next = 0;
        while let Some(asset) = model.assets.get(next) {
            if self.assets.contains_key(&asset.uid) {
                next += 1;
                continue;
            }
            self.make_room(model, asset.gpu_bytes())?;
            if let Err(error) = self.upload_asset(gpu, asset) {
                // A table or a page of texels is full: others may hold it, or free room lies in pieces.
                if !self.evict_one(model) {
                    if afresh {
                        return Err(error);
                    }
                    afresh = true;
                    next = 0;
                    for asset in &model.assets {
                        self.evictions += u64::from(self.assets.contains_key(&asset.uid));
                        self.free_asset(asset.uid);
                    }
                }
            }
        }
        self.make_room(model, model.list_bytes())
    }

    /// Whether `model` could ever be resident here.
    ///
    /// # Errors
    /// The part that is too large, and by how much.
    pub fn check(&self, gpu: &Gpu, model: &SceneModel) -> Result<(), ResidencyError> {
        check_fits(gpu.max_binding_bytes(), self.budget, model, Part::Whole)
    }

    /// Frees a scene and the assets that no other resident scene draws.
    pub fn remove(&mut self, gpu: &Gpu, id: &str) {
        self.forget_scene(id);
        self.drop_unused_assets(&HashSet::new());
        self.pages.trim(gpu);
        self.texels.iter_mut().for_each(|arena| arena.trim(gpu));
    }

    /// Frees the assets that no resident scene draws, except `kept`.
    fn drop_unused_assets(&mut self, kept: &HashSet<u64>) {
        let drawn: HashSet<u64> =
            self.scenes.values().flat_map(|scene| scene.asset_uids.iter().copied()).collect();
        let dropped: Vec<u64> = self
            .assets
            .keys()
            .copied()
            .filter(|uid| !drawn.contains(uid) && !kept.contains(uid))
            .collect();
        for uid in dropped {
            self.free_asset(uid);
        }
    }

    fn forget_scene(&mut self, id: &str) {
        if let Some(scene) = self.take_scene(id) {
            self.release_materials(&scene.materials);
        }
    }

    /// A scene that is no longer resident; its materials are still in the table.
    fn take_scene(&mut self, id: &str) -> Option<ResidentScene> {
        let scene = self.scenes.remove(id)?;
        self.used -= scene.bytes;
        Some(scene)
    }

    /// Evicts the scenes used the longest ago, never the assets of `model`, until `bytes` more fit the budget.
    fn make_room(&mut self, model: &SceneModel, bytes: u64) -> Result<(), ResidencyError> {
        let over = (self.used + bytes).saturating_sub(self.budget);
        if over == 0 {
            return Ok(());
        }
        self.evict_scenes(model, over);
        if self.used + bytes > self.budget {
            return Err(ResidencyError::OverBudget {
                what: format!("scene `{}` with what must stay beside it", model.id),
                needed: self.used + bytes,
                budget: self.budget,
            });
        }
        Ok(())
    }

    /// Evicts the scene used the longest ago; false when there is none.
    fn evict_one(&mut self, model: &SceneModel) -> bool {
        self.evict_scenes(model, 1) > 0
    }

    /// Evicts as many scenes as hold `bytes`, not `model`, and nothing that it draws; their number.
    fn evict_scenes(&mut self, model: &SceneModel, bytes: u64) -> usize {
        let kept = uids(model);
        let holdings: Vec<Holding> = self
            .scenes
            .iter()
            .filter(|(id, _)| **id != model.id)
            .map(|(id, scene)| Holding {
                id,
                last_used: scene.last_used,
                list_bytes: scene.bytes,
                asset_uids: &scene.asset_uids,
            })
            .collect();
        let asset_bytes = |uid| self.assets.get(&uid).map_or(0, |asset| asset.bytes);
        let gone: Vec<String> = evict::victims(&holdings, asset_bytes, &kept, bytes)
            .into_iter()
            .map(str::to_owned)
            .collect();
        for id in &gone {
            self.forget_scene(id);
        }
        self.drop_unused_assets(&kept);
        self.evictions += gone.len() as u64;
        gone.len()
    }
}

/// Identifiers of the assets that a model draws.
fn uids(model: &SceneModel) -> HashSet<u64> {
    model.assets.iter().map(|asset| asset.uid).collect()
}

/// Entries grouped by page and padded to [`GROUP`]: the lists that the cull pass walks.
fn group_entries(mut listed: Vec<(Page, GpuEntry)>) -> (Vec<GpuEntry>, Vec<GpuSegment>, Vec<Page>) {
    const PADDING: GpuEntry = GpuEntry { instance: u32::MAX, chunk: 0 };
    listed.sort_by_key(|(page, _)| *page);
    let mut entries: Vec<GpuEntry> = Vec::with_capacity(listed.len() + GROUP);
    let (mut segments, mut pages) = (Vec::new(), Vec::new());
    for run in listed.chunk_by(|a, b| a.0 == b.0) {
        let first_group = (entries.len() / GROUP) as u32;
        entries.extend(run.iter().map(|(_, entry)| *entry));
        entries.resize(entries.len().next_multiple_of(GROUP), PADDING);
        segments.push(GpuSegment { first_group, end_group: (entries.len() / GROUP) as u32 });
        pages.push(run[0].0);
    }
    (entries, segments, pages)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn segments_begin_at_group_boundaries() {
        let page = |kind, index| Page { kind: PageKind::plain(kind), index };
        let entry = |chunk| GpuEntry { instance: 0, chunk };
        let mut listed = Vec::new();
        for chunk in 0..40 {
            listed.push((page(GeometryKind::Triangles, 0), entry(chunk)));
            listed.push((page(GeometryKind::Samples, 1), entry(100 + chunk)));
        }
        listed.push((page(GeometryKind::Samples, 0), entry(7)));
        let (entries, segments, pages) = group_entries(listed);
        assert_eq!(
            pages,
            [
                page(GeometryKind::Samples, 0),
                page(GeometryKind::Samples, 1),
                page(GeometryKind::Triangles, 0)
            ]
        );
        assert_eq!(
            segments.iter().map(|s| (s.first_group, s.end_group)).collect::<Vec<_>>(),
            [(0, 1), (1, 3), (3, 5)]
        );
        assert_eq!(entries.len(), 5 * GROUP);
        assert_eq!(entries.iter().filter(|e| e.instance != u32::MAX).count(), 81);
        assert_eq!(entries[GROUP].chunk, 100);
    }
}
