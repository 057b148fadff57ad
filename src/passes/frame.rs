//! The description of one frame, and its uniform record.

use std::sync::Arc;

use glam::{DMat3, DVec3, Vec3};

use super::fog;
use super::shadow::{Shadows, map_records};
use super::slabs::Slabs;
use crate::math::View;
use crate::plan::detail::point_error_px;
use crate::plan::shadow::LAMP_MAPS;
use crate::plan::{ErrorMode, FramePlan, Output, Pass, Reconstruction};
use crate::residency::layout::{GpuClipBox, GpuFrame, two_floats};
use crate::residency::model::{Extent, SceneModel};
use crate::residency::{GROUP, ResidentScene};
use crate::scene::clipping::{ClipRegion, MOST_BOXES, Side};
use crate::scene::fields::SceneField;
use crate::scene::recolor::{MOST_COLORS, Recolor, share};
use crate::scene::{AmbientOcclusion, Casting, EyeDome, Fog, Light, Shading, Tone};

/// Frames of one scene that are drawn together: the model (resident already), where it is seen from, what is wanted.
#[derive(Clone)]
pub struct FrameTask {
    pub model: Arc<SceneModel>,
    /// All of one size; at most [`MOST_VIEWS`](crate::residency::layout::MOST_VIEWS), and at least one.
    pub views: Vec<View>,
    pub output: Output,
    pub plan: FramePlan,
    /// How samples are drawn.
    pub reconstruction: Reconstruction,
    /// Place and width of the scene's samples, at full detail.
    pub extent: Extent,
    /// Boxes of splats with a longer side than this are walked by several threads.
    pub small_splat_px: u32,
    /// Integer weight of a splat where its kernel is 1.
    pub weight_one: f32,
    /// Boxes of triangles with a longer side than this go to the rasteriser.
    pub small_triangle_px: u32,
    /// Large triangles that the list holds.
    pub large_capacity: u32,
    /// Entries of that list that are walked side by side.
    pub walk_stride: u32,
    /// Units of 4096 pixels that the boxes of large triangles may cover in all.
    pub large_units_limit: u32,
    /// Largest accepted error in pixels, for scenes of point trees.
    pub accepted_px: f32,
    /// How that error is measured for splats.
    pub error_mode: ErrorMode,
    /// Nodes of point trees show their height above the leaves.
    pub levels: bool,
    /// Value that colours surfaces in place of their own colours.
    pub recolor: Option<Recolor>,
    /// Region that the scene is clipped with.
    pub clip: Option<ClipRegion>,
    /// Eye-dome lighting, where it is on.
    pub edl: Option<EyeDome>,
    /// Which exposures of a frame the views are, where a frame is the mean of several.
    pub round: Option<Round>,
    /// Parts along each side of a pixel that are averaged. Views, and all lengths in pixels, are those of the parts.
    pub parts: u32,
    /// Least width of lines, in pixels.
    pub least_line_px: f32,
    /// Linear RGB and straight alpha of pixels that show nothing.
    pub background: [f32; 4],
    /// The scene's surroundings light it.
    pub environment: bool,
    /// Fog that surfaces and the background are seen through.
    pub fog: Option<Fog>,
    /// Ambient occlusion.
    pub occlusion: Option<AmbientOcclusion>,
    /// How light becomes colours.
    pub tone: Option<Tone>,
    /// Height in pixels of the image that the views are parts of, where they are.
    pub image_rows: Option<u32>,
    /// Maximum number of pixels whose translucent fragments are kept at once.
    pub window_pixels: u32,
    /// Maximum number of entries that a frame of point trees may list.
    pub entry_capacity: u32,
    /// Maximum number of splats that may be painted.
    pub paint_capacity: u32,
    /// Launches in which they are painted.
    pub paint_launches: u32,
    /// Shadow maps, where lights cast shadows.
    pub shadows: Option<Shadows>,
    /// Translucent surfaces are left out: they hide no sun.
    pub opaque_only: bool,
}

/// The place of a task among those that draw the exposures of one frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Round {
    /// Number of the first of its exposures.
    pub first: u32,
    /// Number of exposures of the frame; given in the last round.
    pub exposures: Option<u32>,
}

/// Beyond it a few triangles would take all the rounds of loops that lavapipe lets a thread have: 65535.
pub const MOST_SMALL_TRIANGLE_PX: u32 = 60;
/// The bytes of a linear colour in an image, red lowest.
pub fn srgb8(color: [f32; 4]) -> u32 {
    let encode = |c: f32| {
        let c = c.clamp(0.0, 1.0);
        let s = if c <= 0.003_130_8 { 12.92 * c } else { 1.055 * c.powf(1.0 / 2.4) - 0.055 };
        (s * 255.0).round() as u8
    };
    u32::from_le_bytes([
        encode(color[0]),
        encode(color[1]),
        encode(color[2]),
        (color[3].clamp(0.0, 1.0) * 255.0).round() as u8,
    ])
}

/// Returns the number of an output in shaders.
pub fn output_number(output: Output) -> u32 {
    match output {
        Output::Color => 0,
        Output::Depth => 1,
        Output::Normal => 2,
        Output::Id => 3,
    }
}

impl FrameTask {
    pub fn size(&self) -> (u32, u32) {
        self.views.first().map_or((0, 0), |view| (view.width, view.height))
    }

    /// Size of the images that leave the GPU.
    pub fn image_size(&self) -> (u32, u32) {
        let (width, height) = self.size();
        (width / self.parts, height / self.parts)
    }

    /// Returns whether splats' normals and depths are blended too: pixels are lit or coloured by them afterwards, or an effect or fog needs depths.
    pub fn is_deferred(&self) -> bool {
        let colors_by_surface =
            matches!(self.recolor, Some(Recolor::Normal | Recolor::Height { .. }));
        let is_lit = self.reconstruction.shades(Shading::Deferred) && self.plan.lights_pixels;
        let is_color = self.output == Output::Color;
        let is_seen_through_fog = self.fog.is_some() && self.reconstruction.weighted().is_some();
        is_lit
            || is_seen_through_fog
            || (is_color && colors_by_surface)
            || self.plan.runs(Pass::WriteOutput)
    }

    /// Whether translucent surfaces are laid over the image, in the order of their depths.
    pub fn composites(&self) -> bool {
        self.plan.runs(Pass::CompositeLayers)
    }

    /// Number of shadow maps of each sun that casts shadows; 0 where none does.
    pub fn maps_per_sun(&self) -> u32 {
        let casting = || self.model.lights.iter().filter_map(Light::casting);
        let suns = casting().filter(|of| matches!(of, Casting::Sun { .. })).count();
        let lamps = casting().count() - suns;
        let maps = |shadows: &Shadows| shadows.tasks.len().saturating_sub(lamps * LAMP_MAPS);
        self.shadows.as_ref().map_or(0, |shadows| (maps(shadows) / suns.max(1)) as u32)
    }

    /// Whether a point light casts shadows.
    pub fn has_lamp_maps(&self) -> bool {
        let is_lamp = |light: &Light| matches!(light.casting(), Some(Casting::Lamp { .. }));
        self.shadows.is_some() && self.model.lights.iter().any(is_lamp)
    }

    /// Whether surfaces that are drawn before translucent ones are opaque.
    pub fn draws_opaque_first(&self) -> bool {
        self.opaque_only || self.composites()
    }

    /// Number of pixels of all views, or of their parts.
    pub fn pixels(&self) -> u64 {
        let (width, height) = self.size();
        u64::from(self.count()) * u64::from(width) * u64::from(height)
    }

    /// Number of pixels that the visibility buffer holds: those of all views and, for pull-push, those of the rims around them; see
    /// `shared/landing`.
    pub fn visibility_pixels(&self) -> u64 {
        let (width, height) = self.size();
        let rims = u64::from(self.count()) * 2 * (u64::from(width) + u64::from(height) + 2);
        self.pixels() + self.reconstruction.pull_push().map_or(0, |_| rims)
    }

    /// Whether rays are parallel. All views of a task have one projection.
    pub fn is_orthographic(&self) -> bool {
        self.views.iter().any(View::is_orthographic)
    }

    /// Number of sums in use for each pixel; 0 without blended splats.
    pub fn sums(&self) -> usize {
        match (self.plan.runs(Pass::BlendSplats), self.is_deferred()) {
            (false, _) => 0,
            (true, false) => 2,
            (true, true) => 4,
        }
    }

    /// Whether occlusion culling is on: near chunks are drawn first, and then only chunks that they do not hide.
    pub fn hides(&self) -> bool {
        self.plan.runs(Pass::CullHidden)
    }

    /// Measure of a node that decides its detail: 1, its size, where samples are drawn as points; else 0, its error.
    pub fn measure(&self) -> u32 {
        u32::from(!self.reconstruction.is_splats())
    }

    /// Largest error in pixels of nodes that are drawn.
    pub fn node_error_px(&self) -> f32 {
        if self.reconstruction.is_splats() {
            return self.accepted_px;
        }
        point_error_px(self.accepted_px, self.reconstruction.discs().is_some())
    }

    /// Whether the error of a node depends on the angle at which it is seen. Points cover one pixel at any angle, so it never does for them.
    pub fn splits_errors(&self) -> bool {
        let as_splats =
            self.reconstruction.is_splats() && self.reconstruction.pull_push().is_none();
        as_splats && self.error_mode == ErrorMode::Split
    }

    /// Whether samples and lines have the colours of a scalar field.
    pub fn shows_field(&self) -> bool {
        self.output == Output::Color && matches!(self.recolor, Some(Recolor::Field { .. }))
    }

    /// Word of pixels that show nothing.
    pub fn background_word(&self) -> u32 {
        match self.output {
            Output::Color => srgb8(self.background),
            Output::Depth => f32::INFINITY.to_bits(),
            Output::Normal | Output::Id => 0,
        }
    }

    /// Returns the number of views.
    pub fn count(&self) -> u32 {
        self.views.len() as u32
    }
}

/// The uniform record of view `number`.
pub fn frame_record(task: &FrameTask, scene: &ResidentScene, number: u32) -> GpuFrame {
    let view = &task.views[number as usize];
    let axes = view.view_from_world.transpose();
    let row = |v: glam::DVec3| [v.x as f32, v.y as f32, v.z as f32, 0.0];
    // Places are subtracted from the eye; where rays are parallel, from the point on the optical axis that is looked at.
    let focus = if view.is_orthographic() { view.focus } else { 0.0 };
    let eye = (view.eye - axes.z_axis * focus).to_array().map(two_floats);
    let (entries, slots) = scene.entries(task.entry_capacity);
    let (splats, fuzzy) = (task.reconstruction.splats(), task.reconstruction.fuzzy());
    let discs = task.reconstruction.discs();
    let slabs = fuzzy.map_or(Slabs::default(), |splats| {
        let accepted_px = if task.model.trees { task.accepted_px } else { 0.0 };
        Slabs::new(splats, &task.extent, view, accepted_px)
    });
    let (ramp_count, ramp_colors) = ramp_colors(task);
    GpuFrame {
        right: row(axes.x_axis),
        down: row(-axes.y_axis),
        forward: row(-axes.z_axis),
        eye_hi: [eye[0].0, eye[1].0, eye[2].0, 0.0],
        eye_lo: [eye[0].1, eye[1].1, eye[2].1, 0.0],
        focal_px: view.focal_px.as_vec2().to_array(),
        principal_px: view.principal_px.as_vec2().to_array(),
        size_px: [view.width, view.height],
        entry_count: entries,
        instance_count: scene.instance_end,
        light_count: scene.light_count,
        small_triangle_px: task.small_triangle_px.min(MOST_SMALL_TRIANGLE_PX) as i32,
        large_capacity: task.large_capacity,
        large_units_limit: task.large_units_limit,
        view: number,
        views: task.count(),
        first_pixel: number * view.width * view.height,
        first_instance: number * scene.instance_end,
        first_entry: number * entries,
        first_group: number * (entries / GROUP as u32 + 1),
        first_slot: number * slots,
        first_run: number * scene.pages.len() as u32,
        sample_segments: scene.sample_segments(),
        small_splat_px: task.small_splat_px as i32,
        weight_one: task.weight_one,
        splat_cutoff: match discs {
            Some(_) => 1.0,
            None => splats.map_or(0.0, |splats| splats.cutoff),
        },
        splat_lowpass_px: match (splats, discs) {
            (Some(splats), _) if splats.prefilter => splats.lowpass_px,
            (_, Some(discs)) => 0.5 * discs.diameter_px,
            _ => 0.0,
        },
        splat_width: splats.map_or(0.0, |splats| splats.width),
        splat_offset: task.reconstruction.depth_offset(),
        slab_near: slabs.near as f32,
        slab_per_unit: slabs.per_unit as f32,
        slab_meet: slabs.meet as f32,
        slab_meet_log2: slabs.meet.log2() as f32,
        slab_per_octave: slabs.per_octave as f32,
        lod_scale: match task.model.trees {
            true => task.node_error_px() / view.focal_px.max_element() as f32,
            false => 0.0,
        },
        entry_capacity: task.entry_capacity,
        instance_groups: scene.instance_groups(),
        segment_count: scene.pages.len() as u32,
        edl: task.edl.map_or([0.0; 2], |edl| [edl.strength, edl.radius_px]),
        disc_radius: discs.map_or(0.0, |discs| 0.5 * discs.diameter),
        ramp_count,
        ramp: ramp(task, scene, view),
        ramp_colors,
        focus: focus as f32,
        field: field_of(task, scene).map_or(0, |(number, _)| number as u32),
        field_count: scene.fields.len() as u32,
        // A little less, so that lines of one pixel are strips, which take less time than tubes.
        line_radius: 0.499_99 * task.least_line_px
            / (view.focal_px.x * view.focal_px.y).sqrt() as f32,
        paint_capacity: task.paint_capacity,
        exposure: task.tone.map_or(1.0, |tone| tone.stops.exp2() as f32),
        occlusion: task.occlusion.map_or([0.0; 2], |own| [own.radius as f32, own.strength as f32]),
        image_height: task.image_rows.unwrap_or(view.height) as f32,
        dither: dither(task, number),
        unused: [0.0; 2],
        fog: task.fog.map_or([0.0; 4], |fog| fog::light(&fog)),
        fog_up: task.fog.map_or([0.0; 4], |fog| fog::heights(&fog, view)),
        clips: task.clip.map_or_else(Default::default, |clip| clip_records(&clip, view)),
        map_records: map_records(task, view, focus),
    }
}

/// The offset of an exposure's keys, by which thin lines, small nodes and light weights are drawn with a probability. Exposures of one frame draw different ones:
/// multiples of the golden ratio spread the offsets evenly. 0 for a frame of one exposure.
fn dither(task: &FrameTask, number: u32) -> f32 {
    let exposure = task.round.map_or(0, |round| round.first + number);
    // Nearest below, since 1 would be no key.
    (f64::from(exposure) * 0.618_033_988_749_895).fract().min(0.999_999) as f32
}

/// The boxes of a region in a view's camera space.
fn clip_records(clip: &ClipRegion, view: &View) -> [GpuClipBox; MOST_BOXES] {
    // Camera space looks along +z, with y down.
    let camera = DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
    let rows =
        (clip.box_from_world.matrix3 * view.view_from_world.transpose() * camera).transpose();
    let eye = clip.box_from_world.transform_point3(view.eye);
    let mut records = [GpuClipBox::default(); MOST_BOXES];
    for (record, clip) in records.iter_mut().zip(clip.boxes.boxes()) {
        // Open bounds are finite in shaders.
        let [low, high] = [clip.low, clip.high].map(|corner| {
            (corner - eye).as_vec3().clamp(Vec3::splat(-f32::MAX), Vec3::splat(f32::MAX))
        });
        let row = |axis: DVec3, low: f32| axis.as_vec3().extend(low).to_array();
        let side = f32::from(u8::from(clip.side == Side::Outside));
        *record = GpuClipBox {
            x: row(rows.x_axis, low.x),
            y: row(rows.y_axis, low.y),
            z: row(rows.z_axis, low.z),
            high: high.extend(side).to_array(),
        };
    }
    records
}

/// The number of colours of the frame's map, and each as sRGB8.
fn ramp_colors(task: &FrameTask) -> (u32, [[u32; 4]; MOST_COLORS / 4]) {
    let mut words = [[0; 4]; MOST_COLORS / 4];
    let (Some(Recolor::Height { map, .. }) | Some(Recolor::Field { map, .. })) = task.recolor
    else {
        return (0, words);
    };
    for (word, [r, g, b]) in words.as_flattened_mut().iter_mut().zip(map.colors()) {
        *word = u32::from_le_bytes([*r, *g, *b, 255]);
    }
    (map.colors().len() as u32, words)
}

/// The number and the record of the scalar field that colours samples.
fn field_of<'a>(task: &FrameTask, scene: &'a ResidentScene) -> Option<(usize, &'a SceneField)> {
    let Some(Recolor::Field { name, .. }) = &task.recolor else { return None };
    scene.fields.iter().enumerate().find(|(_, field)| field.name == name.as_str())
}

/// The share of the range that a position in camera space has: a product with the first three numbers, plus the last. For fields, the
/// product is of the first number with a value's share of the field's range in the scene.
fn ramp(task: &FrameTask, scene: &ResidentScene, view: &View) -> [f32; 4] {
    let finite = |value: f64| (value as f32).clamp(-f32::MAX, f32::MAX);
    match task.recolor {
        Some(Recolor::Height { up, range, .. }) => {
            let up = up.normalize_or(glam::DVec3::Y);
            let [least, most] = range;
            let per_unit = if most == least { 0.0 } else { 1.0 / (most - least) };
            let slope = view.view_from_world * up * per_unit;
            let offset = share(up.dot(view.eye), range);
            // Camera space looks along +z, with y down.
            [slope.x as f32, -slope.y as f32, -slope.z as f32, offset as f32]
        }
        Some(Recolor::Field { range, .. }) => {
            let Some((_, field)) = field_of(task, scene) else { return [0.0; 4] };
            let offset = share(field.least, range);
            [finite(share(field.most, range) - offset), 0.0, 0.0, finite(offset)]
        }
        _ => [0.0; 4],
    }
}
