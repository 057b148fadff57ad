//! Uniform words of a batch, written to the GPU in one go before the submission.

use std::ops::Range;

use super::frame::{FrameTask, frame_record};
use super::levels::Levels;
use super::scratch::Scratch;
use super::shadow::Shadows;
use super::windows;
use crate::gpu::Gpu;
use crate::plan::Pass;
use crate::residency::ResidentScene;
use crate::residency::layout::{GpuFrame, MOST_VIEWS};

/// Records begin at multiples of this.
const ALIGN: usize = 256;
/// Size of the window that a shader binds as the views' records, however many there are.
pub const VIEWS_WINDOW: u64 = MOST_VIEWS as u64 * size_of::<GpuFrame>() as u64;
/// Size of the window that a shader binds as its segment, or as its level.
pub const SEGMENT_WINDOW: u64 = 16;
/// Digits of the keys that painted splats are sorted by; as in `shared/digits`.
pub const DIGITS: u32 = 3;

#[derive(Default)]
pub struct Uniforms {
    bytes: Vec<u8>,
}

/// Where the records of one group lie: those of its views, then one a segment, one a level, one a digit, and one a layer of each
/// window.
#[derive(Clone, Debug)]
pub struct GroupUniforms {
    pub views: u32,
    pub segments: Vec<u32>,
    pub levels: Vec<u32>,
    pub digits: Vec<u32>,
    pub windows: Vec<(Range<u32>, Vec<u32>)>,
    /// Those of each shadow map that is drawn before.
    pub shadows: Vec<GroupUniforms>,
}

impl Uniforms {
    fn push<T: bytemuck::NoUninit>(&mut self, records: &[T]) -> u32 {
        let offset = self.bytes.len();
        self.bytes.extend_from_slice(bytemuck::cast_slice(records));
        self.bytes.resize(self.bytes.len().next_multiple_of(ALIGN), 0);
        offset as u32
    }

    /// Adds a group.
    pub fn group(&mut self, task: &FrameTask, scene: &ResidentScene) -> GroupUniforms {
        let records: Vec<GpuFrame> =
            (0..task.count()).map(|number| frame_record(task, scene, number)).collect();
        let views = self.push(&records);
        let segments =
            (0..scene.pages.len() as u32).map(|index| self.push(&[index, 0, 0, 0])).collect();
        // A frame of one pixel has no coarser level, and no gap either.
        let levels = match task.plan.runs(Pass::Pull) {
            true => Levels::of(task.size()).records().map(|record| self.push(&record)).collect(),
            false => Vec::new(),
        };
        let digits = match task.plan.runs(Pass::PaintSplats) {
            true => (0..DIGITS).map(|number| self.push(&[number, 0, 0, 0])).collect(),
            false => Vec::new(),
        };
        let windows = match task.composites() {
            true => windows::windows(task.pixels(), task.window_pixels),
            false => Vec::new(),
        };
        let mut place = |window: Range<u32>| {
            let layers = windows::records(&window).map(|record| self.push(&[record])).collect();
            (window, layers)
        };
        let windows = windows.into_iter().map(&mut place).collect();
        let maps = task.shadows.iter().flat_map(Shadows::drawn);
        let shadows = maps.map(|map| self.group(map, scene)).collect();
        GroupUniforms { views, segments, levels, digits, windows, shadows }
    }

    pub fn write(&self, gpu: &Gpu, scratch: &mut Scratch) {
        // The last group's window may reach beyond its views.
        scratch.uniforms.reserve(gpu, self.bytes.len() as u64 + VIEWS_WINDOW);
        gpu.queue.write_buffer(scratch.uniforms.buffer().raw(), 0, &self.bytes);
    }
}
