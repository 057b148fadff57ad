//! Shadow maps: depths of the scene as its lights see it, which the passes that compute light compare places with.
//!
//! A map is an ordinary frame of depths, with a plan of its own. Maps depend on no pixel of the frames that use them: neighbouring poses share them, and
//! [`ShadowMaps`] keeps those that were drawn last.

pub mod shadow_map;
mod soundness;

use std::cell::RefCell;
use std::sync::Arc;

use glam::DVec3;

use self::soundness::Soundness;
use super::frame::FrameTask;
use crate::gpu::Gpu;
use crate::gpu::bind::BindCache;
use crate::gpu::buffer::Buffer;
use crate::math::View;
use crate::plan::shadow::LAMP_MAPS;
use crate::plan::{ErrorMode, FramePlan, Output, Reconstruction};
use crate::residency::layout::{GpuShadowMap, GpuStats};
use crate::scene::clipping::ClipRegion;
use crate::scene::{Casting, Light, MOST_CASTING_LIGHTS};

/// Weight of a splat of a map where its kernel is 1: sums of depths have room for 32 times as many splats as those of colours.
pub const MAP_WEIGHT: f32 = 1024.0;
const STATS_BYTES: u64 = size_of::<GpuStats>() as u64;
/// Bytes of the maps that are kept.
const KEPT_BYTES: u64 = 256 << 20;

/// The maps of a frame.
#[derive(Clone)]
pub struct Shadows {
    /// A task for each map.
    pub tasks: Vec<FrameTask>,
    pub set: Arc<MapSet>,
    /// Where the maps come from; none where the set has them.
    pub sources: Vec<Source>,
}

/// Where a map of a new set comes from.
#[derive(Clone)]
pub enum Source {
    Drawn,
    /// Another set has it, from this byte on.
    Copied(Arc<MapSet>, u64),
}

impl Source {
    pub fn is_drawn(&self) -> bool {
        matches!(self, Source::Drawn)
    }
}

impl Shadows {
    /// Whether as many maps are drawn as for a frame at a new pose: all maps of suns, which follow the view, and none of lamps.
    pub fn are_those_of_a_new_pose(&self) -> bool {
        let follows_view = |map: &FrameTask| map.views.iter().any(View::is_orthographic);
        let is_drawn = |number: usize| self.sources.get(number).is_some_and(Source::is_drawn);
        self.tasks.iter().enumerate().all(|(number, map)| follows_view(map) == is_drawn(number))
    }

    /// The tasks of maps that are still to be drawn.
    pub fn drawn(&self) -> impl Iterator<Item = &FrameTask> {
        let with_source = self.tasks.iter().zip(&self.sources);
        with_source.filter(|(_, source)| source.is_drawn()).map(|(task, _)| task)
    }

    /// Bytes of the counters of those maps.
    pub fn stats_bytes(&self) -> u64 {
        self.drawn().count() as u64 * STATS_BYTES
    }
}

/// All that the depths of maps depend on besides their views and the adapter.
#[derive(Clone, Debug, PartialEq)]
pub struct MapKey {
    pub scene: String,
    /// Identifies the scene's revision among all of the process.
    pub revision: u64,
    pub plan: FramePlan,
    pub reconstruction: Reconstruction,
    pub accepted_px: f32,
    pub clip: Option<ClipRegion>,
}

impl MapKey {
    /// The task that draws the map of a view. Its depths follow from the key and the view alone. From `frame`, the task of a frame of the key's
    /// scene, it takes the scene itself and the sizes of the adapter's lists.
    pub fn task(&self, view: View, frame: &FrameTask) -> FrameTask {
        FrameTask {
            model: frame.model.clone(),
            extent: frame.extent,
            views: vec![view],
            output: Output::Depth,
            plan: self.plan.clone(),
            reconstruction: self.reconstruction,
            accepted_px: self.accepted_px,
            clip: self.clip,
            weight_one: MAP_WEIGHT,
            opaque_only: true,
            // A light sees errors from another angle than the frame's eye.
            error_mode: ErrorMode::Unified,
            levels: false,
            recolor: None,
            edl: None,
            round: None,
            parts: 1,
            least_line_px: 0.0,
            background: [0.0; 4],
            environment: false,
            fog: None,
            occlusion: None,
            tone: None,
            image_rows: None,
            shadows: None,
            small_splat_px: frame.small_splat_px,
            small_triangle_px: frame.small_triangle_px,
            large_capacity: frame.large_capacity,
            walk_stride: frame.walk_stride,
            large_units_limit: frame.large_units_limit,
            window_pixels: frame.window_pixels,
            entry_capacity: frame.entry_capacity,
            paint_capacity: frame.paint_capacity,
            paint_launches: frame.paint_launches,
        }
    }
}

/// The maps of all lights, one behind the other, and what drawing them counted.
pub struct MapSet {
    pub maps: Buffer,
    pub stats: Buffer,
    pub soundness: Arc<Soundness>,
}

struct Kept {
    key: MapKey,
    views: Vec<View>,
    set: Arc<MapSet>,
}

/// The maps that frames used last, the latest last.
#[derive(Default)]
pub struct ShadowMaps {
    kept: Vec<Kept>,
}

impl ShadowMaps {
    /// The maps of some views, and where those come from that are still to be made. With `anew`, all maps of suns are: a frame at a new pose
    /// has to draw them. Empties `binds` where maps are dropped, because bind groups keep buffers alive.
    pub fn get(
        &mut self,
        gpu: &Gpu,
        binds: &RefCell<BindCache>,
        key: MapKey,
        views: &[View],
        anew: bool,
    ) -> (Arc<MapSet>, Vec<Source>) {
        let is_anew = |view: &View| anew && view.is_orthographic();
        let is_whole = |kept: &Kept| kept.key == key && kept.views == views;
        self.drop_if(binds, |kept| kept.set.soundness.is_spoiled());
        let whole = self.kept.iter().position(is_whole);
        if let Some(place) = whole.filter(|_| !views.iter().any(is_anew)) {
            let found = self.kept.remove(place);
            let set = found.set.clone();
            self.kept.push(found);
            return (set, Vec::new());
        }
        let source = |view: &View| match is_anew(view) {
            true => Source::Drawn,
            false => self.source(&key, view),
        };
        let sources: Vec<Source> = views.iter().map(source).collect();
        self.drop_if(binds, is_whole);
        let origins = sources.iter().filter_map(|source| match source {
            Source::Drawn => None,
            Source::Copied(from, _) => Some(from.soundness.clone()),
        });
        let set = Arc::new(MapSet {
            maps: Buffer::storage(gpu, "shadow_maps", bytes(views)),
            stats: Buffer::storage(gpu, "shadow_stats", views.len() as u64 * STATS_BYTES),
            soundness: Arc::new(Soundness::of_copy(origins.collect())),
        });
        self.kept.push(Kept { key, views: views.to_vec(), set: set.clone() });
        let mut excess: u64 = self.kept.iter().map(|kept| kept.set.maps.size()).sum();
        // The oldest go first, and the new set stays.
        self.drop_if(binds, |kept| {
            let drops = excess > KEPT_BYTES && !Arc::ptr_eq(&kept.set, &set);
            excess -= if drops { kept.set.maps.size() } else { 0 };
            drops
        });
        (set, sources)
    }

    fn drop_if(&mut self, binds: &RefCell<BindCache>, mut drops: impl FnMut(&Kept) -> bool) {
        let before = self.kept.len();
        self.kept.retain(|kept| !drops(kept));
        if self.kept.len() < before {
            binds.borrow_mut().clear();
        }
    }

    fn source(&self, key: &MapKey, view: &View) -> Source {
        let place = |kept: &Kept| {
            let number = kept.views.iter().position(|other| other == view)?;
            (kept.key == *key)
                .then(|| Source::Copied(kept.set.clone(), bytes(&kept.views[..number])))
        };
        self.kept.iter().rev().find_map(place).unwrap_or(Source::Drawn)
    }

    /// Drops the maps of a scene.
    pub fn remove(&mut self, scene: &str) {
        self.kept.retain(|kept| kept.key.scene != scene);
    }

    pub fn clear(&mut self) {
        self.kept.clear();
    }
}

fn bytes(views: &[View]) -> u64 {
    views.iter().map(pixels).sum::<u64>() * 4
}

fn pixels(view: &View) -> u64 {
    u64::from(view.width) * u64::from(view.height)
}

/// The records of a view's maps: one for each map of a sun, from the first on, and one for each lamp, from the last back.
pub fn map_records(
    task: &FrameTask,
    view: &View,
    focus: f64,
) -> [GpuShadowMap; MOST_CASTING_LIGHTS] {
    let mut records = [GpuShadowMap::default(); MOST_CASTING_LIGHTS];
    let Some(shadows) = &task.shadows else { return records };
    let maps: Vec<&View> = shadows.tasks.iter().filter_map(|map| map.views.first()).collect();
    let first = |map: usize| maps[..map].iter().map(|map| pixels(map) as u32).sum();
    let axes = view.view_from_world.transpose();
    let origin = view.eye - axes.z_axis * focus;
    let (mut next, mut lamps) = (0, MOST_CASTING_LIGHTS);
    let per_sun = task.maps_per_sun() as usize;
    for casting in task.model.lights.iter().filter_map(Light::casting) {
        let Casting::Sun { angle_deg, .. } = casting else { continue };
        let spread = (0.5 * angle_deg).to_radians().tan() as f32;
        for (place, map) in maps.iter().enumerate().skip(next).take(per_sun) {
            records[place] =
                GpuShadowMap { spread, first: first(place), ..sun_record(map, origin) };
        }
        next += per_sun;
    }
    for casting in task.model.lights.iter().filter_map(Light::casting) {
        let Casting::Lamp { radius, .. } = casting else { continue };
        lamps -= 1;
        if let Some(map) = maps.get(next) {
            records[lamps] = GpuShadowMap {
                pixel: (1.0 / map.focal_px.x) as f32,
                spread: radius as f32,
                side: map.width,
                first: first(next),
                ..GpuShadowMap::default()
            };
        }
        next += LAMP_MAPS;
    }
    records
}

/// The record of a sun's map for places relative to `origin`.
fn sun_record(map: &View, origin: DVec3) -> GpuShadowMap {
    let axes = map.view_from_world.transpose();
    let offset = origin - map.eye;
    let row = |axis: DVec3, scale: f64, add: f64| {
        (axis * scale).extend(axis.dot(offset) * scale + add).as_vec4().to_array()
    };
    GpuShadowMap {
        x: row(axes.x_axis, map.focal_px.x, map.principal_px.x),
        y: row(-axes.y_axis, map.focal_px.y, map.principal_px.y),
        depth: row(-axes.z_axis, 1.0, 0.0),
        pixel: (1.0 / map.focal_px.x) as f32,
        side: map.width,
        ..GpuShadowMap::default()
    }
}
