//! Buffers that every frame uses and none keeps.

use std::collections::HashMap;

use super::frame::FrameTask;
use super::levels::Levels;
use super::spread::{lanes, painters, sort_workers};
use super::windows::{FRAGMENT_BYTES, covered_bytes, most_pixels};
use crate::gpu::Gpu;
use crate::gpu::buffer;
use crate::plan::{FramePlan, Pass, Specialisation};
use crate::residency::layout::{
    GpuDispatch, GpuEntry, GpuPlaced, GpuRun, GpuSegment, GpuSlot, GpuStats, INSTANCE_GROUP,
    LOD_LAUNCHES,
};
use crate::residency::{GROUP, ResidentScene};

/// Scratch of the device: the groups of a batch run one behind the other and share it.
pub struct Scratch {
    pub visibility: buffer::Scratch,
    pub pixels: buffer::Scratch,
    /// Colours and normals of surfaces that wait for `write_output`.
    pub colors: buffer::Scratch,
    pub normals: buffer::Scratch,
    /// What maps of their materials say of surfaces that wait for `write_output`: two words each.
    pub mapped: buffer::Scratch,
    /// How open the surroundings of each pixel are, for ambient light.
    pub openness: buffer::Scratch,
    /// Sums of the exposures of a frame: four words for each pixel of its image; see `resolve/accumulate`.
    pub exposed: buffer::Scratch,
    /// Sums of blended splats: two words of 32 bits for each pixel in each buffer.
    pub sums: [buffer::Scratch; 4],
    /// Words of splats that are blended in a single pass; see `shared/slabs`.
    pub layers: buffer::Scratch,
    /// Splats that are painted over each other: their list, their records, their keys before and after a digit is
    /// sorted, and what sorting counts; see `shared/painted` and `shared/digits`.
    pub paint_list: buffer::Scratch,
    pub paint_records: buffer::Scratch,
    pub paint_keys: [buffer::Scratch; 2],
    pub paint_counts: buffer::Scratch,
    /// How far threads have painted, and the picture that they make.
    pub paint_cursors: buffer::Scratch,
    pub painted: buffer::Scratch,
    /// These two hold, for each pixel, the sums and the end of the surface that is being painted.
    pub paint_sums: buffer::Scratch,
    pub paint_ends: buffer::Scratch,
    /// The nearest translucent fragments of the pixels of a window, and what they cover; see `shared/window`.
    pub fragments: buffer::Scratch,
    pub covered: buffer::Scratch,
    /// Levels of pull-push: two words for each pixel of each level in each buffer; see `shared/patches`.
    pub patches: [buffer::Scratch; 4],
    pub stats: buffer::Scratch,
    pub placed: buffer::Scratch,
    pub seen: buffer::Scratch,
    pub ranks: buffer::Scratch,
    pub group_counts: buffer::Scratch,
    pub slots: buffer::Scratch,
    pub runs: buffer::Scratch,
    pub dispatches: buffer::Scratch,
    pub large: buffer::Scratch,
    /// This buffer and the next four serve occlusion culling; see `shared/portions` and `shared/pyramid`.
    pub depths: buffer::Scratch,
    pub portions: buffer::Scratch,
    pub turns: buffer::Scratch,
    pub turn_slots: buffer::Scratch,
    pub pyramid: buffer::Scratch,
    /// This buffer and the next six serve scenes of point trees: the groups of instances in play, what each instance has chosen, and
    /// the entries listed from that.
    pub group_flags: buffer::Scratch,
    pub listed: buffer::Scratch,
    pub chosen: buffer::Scratch,
    pub chosen_first: buffer::Scratch,
    pub entries: buffer::Scratch,
    pub segments: buffer::Scratch,
    pub sizes: buffer::Scratch,
    pub uniforms: buffer::Scratch,
    /// Buffers full of one word each, from which frames copy their background.
    backgrounds: HashMap<u32, wgpu::Buffer>,
    attachment: Option<(u32, u32, wgpu::TextureView)>,
    /// Ids that the list of large triangles holds.
    large_capacity: u32,
    /// Entries that a frame of point trees may list.
    entry_capacity: u32,
    /// Entries of the list of large triangles that are walked side by side.
    walk_stride: u32,
    /// Splats that a frame may paint.
    paint_capacity: u32,
    /// Launches in which it paints them.
    paint_launches: u32,
}

/// Size of a buffer that backgrounds are copied from, and how many are kept.
pub const BACKGROUND_BYTES: u64 = 1 << 18;
const MOST_BACKGROUNDS: usize = 32;

/// Bytes that each pixel takes where splats are blended in a single pass: two words.
pub const SLABS_BYTES: u64 = 16;

/// Bytes that each pixel of a frame of several exposures takes for their sums.
pub const EXPOSED_BYTES: u64 = 16;

/// Side of a block of the hierarchical depth buffer, and the words of its record; as in `shared/pyramid`.
pub const BLOCK_PX: u32 = 16;
pub const BLOCK_WORDS: u32 = 17;

/// Launches of a segment: all of its slots, those that are asked, those whose turn it is to be drawn.
const PORTION_LAUNCHES: usize = 3;
/// Size of a view's record of depths; as in `shared/portions`.
pub const DEPTHS_BYTES: u64 = 1560 * 4;
const PORTION_BYTES: u64 = 16;
/// Large triangles that there is room for at first; a frame with more is drawn again with room enough.
const LARGE_INITIAL: u32 = 1 << 18;
/// Likewise for the entries that a frame of point trees lists.
const ENTRIES_INITIAL: u32 = 1 << 15;
/// Entries of a list that are walked side by side, each by a workgroup a band: at first, and at most.
const STRIDE_INITIAL: u32 = 64;
const MOST_STRIDE: u32 = 1 << 15;
/// Likewise for the splats that a frame paints.
const PAINTED_INITIAL: u32 = 1 << 17;
/// Most of them, whatever a binding holds: places have 22 bits, and records take 500 MB then.
pub const MOST_PAINTED: u32 = 1 << 22;
/// Size of a painted splat's record where some splats of the scene have clip lines, and where none have; as in `shared/painted`.
pub const CLIPPED_RECORD_BYTES: u64 = 112;
pub const RECORD_BYTES: u64 = 80;
/// Size of the head of the list of painted splats, and rows of what sorting counts: values of a digit, which are the tiles of the image as well.
const PAINT_LIST_BYTES: u64 = 16 + 4 * (DIGIT_VALUES as u64 + 1);
pub const DIGIT_VALUES: u32 = 256;
/// Bytes of what splats cover of a pixel: colour and alpha.
pub const PAINTED_BYTES: u64 = 16;
/// Threads of a workgroup that paints a band, at most, and what each of them keeps between launches.
const PAINTERS: u64 = 64;
const CURSOR_BYTES: u64 = 8;
/// Launches that paint, at most.
const MOST_PAINT_LAUNCHES: u32 = 64;
/// Slots have numbers of 22 bits.
pub const MOST_ENTRIES: u32 = 1 << 22;

impl Scratch {
    pub fn new(gpu: &Gpu) -> Self {
        let storage = wgpu::BufferUsages::STORAGE
            | wgpu::BufferUsages::COPY_SRC
            | wgpu::BufferUsages::COPY_DST;
        let make = |label| buffer::Scratch::new(gpu, label, storage);
        let indirect =
            |label| buffer::Scratch::new(gpu, label, storage | wgpu::BufferUsages::INDIRECT);
        Self {
            visibility: make("visibility"),
            pixels: make("pixels"),
            colors: make("colors"),
            normals: make("normals"),
            mapped: make("mapped"),
            openness: make("openness"),
            exposed: make("exposed"),
            sums: ["sums_0", "sums_1", "sums_2", "sums_3"].map(make),
            layers: make("layers"),
            paint_list: make("paint_list"),
            paint_records: make("paint_records"),
            paint_keys: ["paint_keys_0", "paint_keys_1"].map(make),
            paint_counts: make("paint_counts"),
            paint_cursors: make("paint_cursors"),
            painted: make("painted"),
            paint_sums: make("paint_sums"),
            paint_ends: make("paint_ends"),
            fragments: make("fragments"),
            covered: make("covered"),
            patches: ["patches_0", "patches_1", "patches_2", "patches_3"].map(make),
            stats: make("stats"),
            placed: make("placed"),
            seen: make("seen"),
            ranks: make("ranks"),
            group_counts: make("group_counts"),
            slots: make("slots"),
            runs: make("runs"),
            dispatches: indirect("dispatches"),
            large: indirect("large"),
            depths: make("depths"),
            portions: make("portions"),
            turns: make("turns"),
            turn_slots: make("turn_slots"),
            pyramid: make("pyramid"),
            group_flags: make("group_flags"),
            listed: make("listed"),
            chosen: make("chosen"),
            chosen_first: make("chosen_first"),
            entries: make("entries"),
            segments: make("segments"),
            sizes: make("sizes"),
            uniforms: buffer::Scratch::new(
                gpu,
                "uniforms",
                wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
            ),
            backgrounds: HashMap::new(),
            attachment: None,
            large_capacity: LARGE_INITIAL.min(most_large(gpu)),
            entry_capacity: ENTRIES_INITIAL.min(most_entries(gpu)),
            walk_stride: STRIDE_INITIAL,
            paint_capacity: PAINTED_INITIAL.min(most_painted(gpu)),
            paint_launches: 1,
        }
    }

    /// Bytes of the largest buffer that one view needs.
    pub fn largest(scene: &ResidentScene, (width, height): (u32, u32), plan: &FramePlan) -> u64 {
        let bytes = if plan.runs(Pass::ResolveFuzzy) { SLABS_BYTES } else { 8 };
        let patches = match plan.runs(Pass::Pull) {
            true => Levels::of((width, height)).bytes(),
            false => 0,
        };
        let fragments = match plan.runs(Pass::CompositeLayers) {
            true => {
                let pixels = u64::from(width) * u64::from(height);
                pixels.min(most_pixels(u64::MAX).into()) * FRAGMENT_BYTES
            }
            false => 0,
        };
        let bytes = [
            patches,
            fragments,
            u64::from(width) * u64::from(height) * bytes,
            u64::from(scene.instance_end) * size_of::<GpuPlaced>() as u64,
            u64::from(scene.entries(ENTRIES_INITIAL).1) * size_of::<GpuSlot>() as u64,
        ];
        bytes.into_iter().max().unwrap_or(0)
    }

    /// Makes room for what a group of frames of `scene` needs.
    pub fn reserve(&mut self, gpu: &Gpu, scene: &ResidentScene, task: &FrameTask) {
        let ((width, height), views) = (task.size(), u64::from(task.count()));
        let pixels = task.pixels();
        self.visibility.reserve(gpu, task.visibility_pixels() * 8);
        self.pixels.reserve(gpu, pixels * 4);
        if task.plan.runs(Pass::WriteOutput) {
            self.colors.reserve(gpu, pixels * 8);
            self.normals.reserve(gpu, pixels * 4);
            if task.plan.draws(Specialisation::Maps) {
                self.mapped.reserve(gpu, pixels * 8);
            }
        }
        if task.plan.runs(Pass::AmbientOcclusion) {
            self.openness.reserve(gpu, pixels * 4);
        }
        if task.plan.runs(Pass::Accumulate) {
            let (width, height) = task.image_size();
            self.exposed.reserve(gpu, u64::from(width) * u64::from(height) * EXPOSED_BYTES);
        }
        for sums in &mut self.sums[..task.sums()] {
            sums.reserve(gpu, pixels * 8);
        }
        if task.plan.runs(Pass::ResolveFuzzy) {
            self.layers.reserve(gpu, pixels * SLABS_BYTES);
        }
        if task.plan.runs(Pass::PaintSplats) {
            let splats = u64::from(self.paint_capacity);
            let slots = u64::from(scene.entries(self.entry_capacity).1);
            let counts = slots * u64::from(lanes(gpu.is_cpu)) * 4;
            let list = (PAINT_LIST_BYTES + counts).min(gpu.max_binding_bytes());
            self.paint_list.reserve(gpu, list);
            self.paint_records.reserve(gpu, splats * record_bytes(scene.has_clip_lines()));
            for keys in &mut self.paint_keys {
                keys.reserve(gpu, splats * 8);
            }
            let workers = u64::from(sort_workers(gpu.is_cpu));
            self.paint_counts.reserve(gpu, (workers + 1) * u64::from(DIGIT_VALUES) * 4);
            self.painted.reserve(gpu, pixels * PAINTED_BYTES);
            self.paint_sums.reserve(gpu, pixels * PAINTED_BYTES);
            self.paint_ends.reserve(gpu, pixels * 8);
            self.paint_cursors.reserve(gpu, cursors_bytes((width, height), gpu.is_cpu));
        }
        if task.composites() {
            let pixels = pixels.min(task.window_pixels.into());
            self.fragments.reserve(gpu, pixels * FRAGMENT_BYTES);
            let transmits = task.plan.draws(Specialisation::Transmits);
            self.covered.reserve(gpu, pixels * covered_bytes(transmits));
        }
        if task.plan.runs(Pass::Pull) {
            for patches in &mut self.patches {
                patches.reserve(gpu, views * Levels::of((width, height)).bytes());
            }
        }
        self.stats.reserve(gpu, views * size_of::<GpuStats>() as u64);
        let instances = views * u64::from(scene.instance_end);
        self.placed.reserve(gpu, instances * size_of::<GpuPlaced>() as u64);
        self.seen.reserve(gpu, instances * 4);
        let (entries, slots) = scene.entries(self.entry_capacity);
        self.ranks.reserve(gpu, views * u64::from(entries) * 4);
        self.group_counts.reserve(gpu, views * (u64::from(entries) / GROUP as u64 + 1) * 4);
        self.slots.reserve(gpu, views * u64::from(slots) * size_of::<GpuSlot>() as u64);
        self.runs.reserve(gpu, views * (scene.pages.len() * size_of::<GpuRun>()) as u64);
        self.depths.reserve(gpu, views * DEPTHS_BYTES);
        self.portions.reserve(gpu, views * scene.pages.len() as u64 * PORTION_BYTES);
        self.turns.reserve(gpu, views * u64::from(slots) * 4);
        self.turn_slots.reserve(gpu, views * u64::from(slots) * 8);
        let blocks = u64::from(width.div_ceil(BLOCK_PX)) * u64::from(height.div_ceil(BLOCK_PX));
        self.pyramid.reserve(gpu, views * blocks * u64::from(BLOCK_WORDS) * 4);
        // Shaders find what is behind the segments' from the end.
        let launches = (scene.pages.len() * PORTION_LAUNCHES + 1 + LOD_LAUNCHES) as u64;
        self.dispatches.reserve(gpu, launches * size_of::<GpuDispatch>() as u64);
        if scene.has_trees() {
            let (groups, segments) = (u64::from(scene.instance_groups()), scene.pages.len() as u64);
            self.group_flags.reserve(gpu, groups * 4);
            self.listed.reserve(gpu, (groups + 1) * 4);
            self.chosen.reserve(gpu, segments * groups * (INSTANCE_GROUP as u64 + 1) * 4);
            self.chosen_first.reserve(gpu, segments * groups * 4);
            self.entries.reserve(gpu, u64::from(entries) * size_of::<GpuEntry>() as u64);
            self.segments.reserve(gpu, segments * size_of::<GpuSegment>() as u64);
            self.sizes.reserve(gpu, 16);
        }
        if self.large.reserve(gpu, 16 + u64::from(self.large_capacity) * 8) {
            // An indirect draw of one instance. Frames change the number of vertices alone.
            let head = [0u32, 1, 0, 0];
            gpu.queue.write_buffer(self.large.buffer().raw(), 0, bytemuck::cast_slice(&head));
        }
    }

    pub fn large_capacity(&self) -> u32 {
        self.large_capacity
    }

    /// Makes room for `count` large triangles from the next frame on, as far as a binding goes.
    pub fn grow_large(&mut self, gpu: &Gpu, count: u32) {
        self.large_capacity = count.max(self.large_capacity).min(most_large(gpu));
    }

    pub fn entry_capacity(&self) -> u32 {
        self.entry_capacity
    }

    /// Makes room for `count` entries from the next frame on, as far as slots can be told apart and a binding goes.
    pub fn grow_entries(&mut self, gpu: &Gpu, count: u32) {
        let wanted = count.checked_next_power_of_two().unwrap_or(u32::MAX);
        self.entry_capacity = wanted.max(self.entry_capacity).min(most_entries(gpu));
    }

    pub fn walk_stride(&self) -> u32 {
        self.walk_stride
    }

    /// Cuts walks over lists into more parts than `stride`, from the next frame on; false where there can be no more.
    pub fn grow_walk(&mut self, stride: u32) -> bool {
        self.walk_stride = self.walk_stride.max((stride * 8).min(MOST_STRIDE));
        self.walk_stride > stride
    }

    pub fn paint_capacity(&self) -> u32 {
        self.paint_capacity
    }

    /// Makes room for `count` painted splats from the next frame on, as far as a binding goes.
    pub fn grow_painted(&mut self, gpu: &Gpu, count: u32) {
        let wanted = count.checked_next_power_of_two().unwrap_or(u32::MAX);
        self.paint_capacity = wanted.max(self.paint_capacity).min(most_painted(gpu));
    }

    pub fn paint_launches(&self) -> u32 {
        self.paint_launches
    }

    /// Paints in more launches than `launches` from the next frame on; false where there can be no more.
    pub fn grow_paint_launches(&mut self, launches: u32) -> bool {
        self.paint_launches = self.paint_launches.max((launches * 8).min(MOST_PAINT_LAUNCHES));
        self.paint_launches > launches
    }

    /// A buffer of [`BACKGROUND_BYTES`] that is full of `word`.
    pub fn background(&mut self, gpu: &Gpu, word: u32) -> wgpu::Buffer {
        if self.backgrounds.len() >= MOST_BACKGROUNDS && !self.backgrounds.contains_key(&word) {
            // Frames that use them hold them until they are drawn.
            self.backgrounds.clear();
        }
        let buffer = self.backgrounds.entry(word).or_insert_with(|| {
            let buffer = gpu.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("background"),
                size: BACKGROUND_BYTES,
                usage: wgpu::BufferUsages::COPY_SRC,
                mapped_at_creation: true,
            });
            if let Ok(mut view) = buffer.get_mapped_range_mut(..) {
                let words = vec![word; BACKGROUND_BYTES as usize / 4];
                view.copy_from_slice(bytemuck::cast_slice(&words));
            }
            buffer.unmap();
            buffer
        });
        buffer.clone()
    }

    /// An attachment of the frame's size that render passes need and nobody reads.
    pub fn attachment(&mut self, gpu: &Gpu, width: u32, height: u32) -> wgpu::TextureView {
        if let Some((w, h, view)) = &self.attachment
            && (*w, *h) == (width, height)
        {
            return view.clone();
        }
        let texture = gpu.device.create_texture(&wgpu::TextureDescriptor {
            label: Some("attachment"),
            size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: wgpu::TextureFormat::R8Unorm,
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT,
            view_formats: &[],
        });
        let view = texture.create_view(&Default::default());
        self.attachment = Some((width, height, view.clone()));
        view
    }
}

/// Size of the cursors of all threads that paint. Those of a GPU need none.
pub fn cursors_bytes(size: (u32, u32), is_cpu: bool) -> u64 {
    if !is_cpu {
        return CURSOR_BYTES;
    }
    u64::from(DIGIT_VALUES * painters(size, is_cpu)) * PAINTERS * CURSOR_BYTES
}

fn record_bytes(has_clip_lines: bool) -> u64 {
    if has_clip_lines { CLIPPED_RECORD_BYTES } else { RECORD_BYTES }
}

/// Painted splats whose records a shader can bind.
fn most_painted(gpu: &Gpu) -> u32 {
    (gpu.max_binding_bytes() / CLIPPED_RECORD_BYTES).min(u64::from(MOST_PAINTED)) as u32
}

/// Entries whose slots a shader can bind, in whole groups.
fn most_entries(gpu: &Gpu) -> u32 {
    let slots = gpu.max_binding_bytes() / size_of::<GpuSlot>() as u64;
    slots.min(u64::from(MOST_ENTRIES)) as u32 / GROUP as u32 * GROUP as u32
}

/// Large triangles whose list a shader can bind: a head of 16 bytes, then 8 each.
fn most_large(gpu: &Gpu) -> u32 {
    (gpu.max_binding_bytes().saturating_sub(16) / 8).min(u64::from(u32::MAX / 3)) as u32
}
