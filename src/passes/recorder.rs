//! Steps with which every pass records itself: find its pipeline and bind groups, take its stamps, launch.

use std::cell::RefCell;
use std::ops::Range;
use std::rc::Rc;

use super::bindings::Names;
use super::frame::FrameTask;
use super::levels::Levels;
use super::pipelines::{Constants, Pipelines};
use super::scratch::Scratch;
use super::shaders::{Choices, Portion, Visibility};
use super::spread;
use super::uniforms::{DIGITS, GroupUniforms};
use super::windows::{FRAGMENT_BYTES, LAYERS, covered_bytes};
use crate::bake::pack::{GeometryKind, PageKind};
use crate::gpu::Gpu;
use crate::gpu::bind::BindCache;
use crate::gpu::pipeline::{BindingSlot, GROUPS};
use crate::gpu::shader::ShaderError;
use crate::gpu::timing::{Span, Timer};
use crate::plan::{Pass, Per, Specialisation, Stage, Step};
use crate::residency::layout::{GpuDispatch, LOD_LAUNCHES};
use crate::residency::{Residency, ResidentScene};
use crate::scene::clipping::Side;

/// Workgroups in x before a dispatch takes a second row; as in the shaders.
pub const DISPATCH_ROW: u32 = 32768;

/// When a pass ran within its submission.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PassSpan {
    pub pass: Pass,
    pub span: Option<Span>,
}

/// Where copies of the levels of pull-push go, one behind the other.
pub struct LevelCopies<'a> {
    pub buffer: &'a wgpu::Buffer,
    /// Place of the next copy, in bytes.
    pub next: u64,
}

impl LevelCopies<'_> {
    /// Number of copies: of four buffers, after pull and after push.
    pub const COUNT: u64 = 8;
}

/// The GPU objects that recording needs, which all groups share.
pub struct Context<'a> {
    pub gpu: &'a Gpu,
    pub pipelines: &'a Pipelines,
    pub binds: &'a RefCell<BindCache>,
    pub scratch: &'a mut Scratch,
    pub residency: &'a Residency,
    pub timer: &'a mut Timer,
    /// For tests: copies all levels after pull and after push.
    pub copies: Option<LevelCopies<'a>>,
}

/// A group being recorded.
pub struct Recorder<'a, 'c> {
    pub context: &'a mut Context<'c>,
    pub encoder: &'a mut wgpu::CommandEncoder,
    pub scene: &'a ResidentScene,
    pub task: &'a FrameTask,
    uniforms: &'a GroupUniforms,
    /// The pass being recorded, and in which stage.
    pub pass: Pass,
    pub stage: Stage,
    /// The segment that the pass is recorded for, if it is for one.
    pub segment: Segment,
    /// The level of the pyramid, or the digit, that the pass is recorded for, if it is for one; else 0.
    pub level: usize,
    /// The window of the image that translucent surfaces are drawn in, and the layers of them that the pass goes through.
    pub window: usize,
    pub layers: Range<usize>,
    pub spans: Vec<PassSpan>,
}

/// The segment that a launch draws, if it draws one.
pub type Segment = Option<usize>;

/// Number of workgroups of a dispatch, or the buffer that holds it.
#[derive(Clone, Copy)]
pub enum Launch {
    Direct([u32; 3]),
    /// As `scan` has written it for the segment.
    Indirect,
    /// As `launch_portions` has written it for the segment.
    Asked,
    Turn,
    /// As it has written it for the hierarchical depth buffer.
    Pyramid,
    /// As `list_groups` or `list_entries` has written it, behind the segments'.
    Listed(Listed),
}

/// Launches of passes over the lists of point trees; the numbers are those of `shared/chosen.wgsl`.
#[derive(Clone, Copy)]
pub enum Listed {
    Place = 0,
    Select = 1,
    Cull = 2,
    Compact = 3,
}

/// How a compute pass is launched.
pub struct Call<'s> {
    /// The fragments that its shader is made of; threads vote where they can.
    pub choices: Choices,
    pub constants: Constants,
    /// Segments that the pass is launched for, one after the other.
    pub segments: &'s [Segment],
    pub launch: Launch,
}

type Binds = Vec<(Rc<wgpu::BindGroup>, Vec<u32>)>;

impl<'a, 'c> Recorder<'a, 'c> {
    /// A recorder at the beginning of a frame.
    pub fn new(
        context: &'a mut Context<'c>,
        encoder: &'a mut wgpu::CommandEncoder,
        task: &'a FrameTask,
        scene: &'a ResidentScene,
        uniforms: &'a GroupUniforms,
    ) -> Self {
        Self {
            context,
            encoder,
            scene,
            task,
            uniforms,
            pass: Pass::Clear,
            stage: Stage::Select,
            segment: None,
            level: 0,
            window: 0,
            layers: 0..0,
            spans: Vec::new(),
        }
    }

    /// Returns the segments and levels that a step's passes are recorded for, one after the other; no segment stands for the whole frame.
    pub fn rounds_of(&self, step: &Step) -> Vec<(Segment, usize)> {
        let coarser = || (0..self.levels().count().saturating_sub(1)).map(|level| (None, level));
        match step.per {
            Per::Layer if step.takes_turns() => {
                (0..LAYERS as usize).map(|layer| (None, layer)).collect()
            }
            Per::Frame | Per::Layer => vec![(None, 0)],
            Per::Segment(kind) => {
                self.segments(&[kind]).into_iter().map(|segment| (segment, 0)).collect()
            }
            Per::Coarser => coarser().collect(),
            // The image itself is completed where it is resolved.
            Per::Finer => coarser().skip(1).rev().collect(),
            Per::Digit => (0..DIGITS as usize).map(|digit| (None, digit)).collect(),
        }
    }

    /// The levels of the image.
    pub fn levels(&self) -> Levels {
        Levels::of(self.task.size())
    }

    /// How the pass writes the visibility buffer.
    pub fn visibility(&self) -> Visibility {
        let gpu = self.context.gpu;
        let is_wide = match self.stage {
            Stage::Layers => gpu.atomic_sums_64,
            _ => gpu.atomics_64,
        };
        match (is_wide, self.stage) {
            (true, Stage::Layers) => Visibility::LayersWide,
            (false, Stage::Layers) => Visibility::LayersDepth,
            (_, Stage::LayerIds) => Visibility::LayersId,
            (true, _) => Visibility::Wide,
            (false, Stage::Ids) => Visibility::Id,
            (false, _) => Visibility::Depth,
        }
    }

    /// Which of a segment's slots the pass draws. Splats that are blended in a single pass and translucent surfaces are drawn wherever
    /// they are.
    pub fn portion(&self) -> Portion {
        let everywhere =
            matches!(self.stage, Stage::Fuzzy | Stage::Paint) || self.stage.is_windowed();
        if self.task.hides() && !everywhere { Portion::Turn } else { Portion::All }
    }

    /// The scene's segments of some kinds of geometry that the stage draws. Where translucent surfaces are laid over the image, no other
    /// stage draws them.
    pub fn segments(&self, kinds: &[GeometryKind]) -> Vec<Segment> {
        let (composites, windowed) = (self.task.draws_opaque_first(), self.stage.is_windowed());
        let has_both = |page: PageKind| match page.kind {
            // Instances that are translucent beside opaque ones stand on pages of both.
            GeometryKind::Triangles => windowed && self.overrides_alpha(page.kind),
            GeometryKind::Samples | GeometryKind::Lines => self.is_mixed(page),
        };
        let is_drawn =
            |page: PageKind| !composites || page.translucent == windowed || has_both(page);
        (0..self.scene.pages.len())
            .filter(|&index| {
                let page = self.scene.pages[index].kind;
                kinds.contains(&page.kind) && is_drawn(page)
            })
            .map(Some)
            .collect()
    }

    /// Whether some instance of a kind of geometry has a translucent colour of its own.
    pub fn overrides_alpha(&self, kind: GeometryKind) -> bool {
        self.scene.looks.translucent_overrides[kind as usize]
    }

    /// Whether a page of samples or lines may have both translucent and opaque ones. The nodes of point trees have no alpha.
    pub fn is_mixed(&self, page: PageKind) -> bool {
        page.translucent || (self.overrides_alpha(page.kind) && !page.nodes)
    }

    /// Whether the pass asks triangles for their alpha at each pixel, which costs a CPU adapter several times the rest.
    pub fn alpha_cut(&self) -> bool {
        let is_opaque = self.task.draws_opaque_first() && !self.stage.is_windowed();
        if is_opaque { self.scene.cut_outs } else { self.scene.alpha_cut }
    }

    /// How often a stage is repeated.
    pub fn repeats(&self, stage: Stage) -> usize {
        if stage.is_windowed() { self.uniforms.windows.len() } else { 1 }
    }

    /// The records of the frames that are shadow maps.
    pub fn shadow_uniforms(&self) -> &'a [GroupUniforms] {
        &self.uniforms.shadows
    }

    /// Number of pixels of the window.
    pub fn window_pixels(&self) -> u32 {
        self.uniforms.windows.get(self.window).map_or(0, |(window, _)| window.end - window.start)
    }

    /// Empties what the translucent fragments of a window are kept in.
    pub fn empty_window(&mut self) {
        let pixels = u64::from(self.window_pixels());
        let scratch = &self.context.scratch;
        let covered = covered_bytes(self.task.plan.draws(Specialisation::Transmits));
        let buffers = [(&scratch.fragments, FRAGMENT_BYTES), (&scratch.covered, covered)];
        for (buffer, bytes) in buffers {
            self.encoder.clear_buffer(buffer.buffer().raw(), 0, Some(pixels * bytes));
        }
    }

    /// The override of `shared/lanes`.
    pub fn lanes(&self) -> (&'static str, u32) {
        let [lanes, ..] = spread::overrides(self.context.gpu.is_cpu);
        lanes
    }

    /// Whether what is hidden by what is nearer is looked for, as an override.
    pub fn hides(&self) -> (&'static str, u32) {
        ("HIDES", u32::from(self.task.hides()))
    }

    /// Overrides that decide whether a node of a point tree is drawn.
    pub fn tree_constants(&self) -> [(&'static str, u32); 2] {
        [("MEASURE", self.task.measure()), ("SPLIT", u32::from(self.task.splits_errors()))]
    }

    /// How the pass is launched over a segment's slots.
    pub fn launch(&self) -> Launch {
        match self.portion() {
            Portion::All => Launch::Indirect,
            Portion::Turn => Launch::Turn,
        }
    }

    /// Entries of a view, padding included.
    pub fn entries(&self) -> u32 {
        self.scene.entries(self.task.entry_capacity).0
    }

    /// Copies all levels of pull-push, if a test has asked for them.
    pub fn copy_levels(&mut self) {
        let bytes = u64::from(self.task.count()) * self.levels().bytes();
        let Some(copies) = &mut self.context.copies else { return };
        for patches in &self.context.scratch.patches {
            let (from, to) = (patches.buffer().raw(), copies.buffer);
            self.encoder.copy_buffer_to_buffer(from, 0, to, copies.next, bytes);
            copies.next += bytes;
        }
    }

    /// Empties the list of large triangles or splats.
    pub fn empty_list(&mut self) {
        self.encoder.clear_buffer(self.context.scratch.large.buffer().raw(), 0, Some(4));
    }

    /// Values of overrides that every pass has.
    fn constants(&self, own: Constants) -> Constants {
        let mut constants = vec![("VIEWS", u32::from(self.task.count() > 1))];
        if self.task.is_orthographic() {
            constants.push(("ORTHOGRAPHIC", 1));
        }
        if let Some(clip) = &self.task.clip {
            let boxes = clip.boxes.boxes();
            let shows_inside = boxes.iter().any(|clip| clip.side == Side::Inside);
            constants.push(("CLIP_BOXES", boxes.len() as u32));
            constants.push(("CLIP_INSIDE", u32::from(shows_inside)));
        }
        constants.extend(own);
        constants
    }

    /// Records a compute pass that is launched once for the whole frame, with the default fragments.
    pub fn compute_once(
        &mut self,
        constants: Constants,
        launch: Launch,
    ) -> Result<(), ShaderError> {
        self.compute(Call { choices: Choices::default(), constants, segments: &[None], launch })
    }

    /// Records a compute pass.
    pub fn compute(&mut self, call: Call) -> Result<(), ShaderError> {
        let Call { choices, constants, segments, launch } = call;
        let constants = self.constants(constants);
        let gpu = self.context.gpu;
        let choices = Choices { subgroups: gpu.subgroups, ..choices };
        let pipeline = self.context.pipelines.compute(gpu, self.pass, choices, constants)?;
        // Layer by layer, and in each through all segments.
        let layers = if choices.layers { self.layers.clone() } else { 0..1 };
        let launches: Vec<(usize, Segment)> = layers
            .flat_map(|layer| segments.iter().map(move |&segment| (layer, segment)))
            .collect();
        let binds: Vec<Binds> = launches
            .iter()
            .map(|&(layer, segment)| {
                self.bind(&pipeline.layouts, &pipeline.bindings, (segment, layer))
            })
            .collect::<Result<_, _>>()?;
        let (mut recorded, span) = self.context.timer.compute(self.encoder, self.pass.name());
        for ((_, segment), binds) in launches.iter().zip(&binds) {
            recorded.set_pipeline(&pipeline.pipeline);
            for (index, (group, offsets)) in binds.iter().enumerate() {
                recorded.set_bind_group(index as u32, group.as_ref(), offsets);
            }
            match launch {
                Launch::Direct([x, y, z]) if x > 0 && y > 0 => {
                    recorded.dispatch_workgroups(x, y, z);
                }
                Launch::Direct(_) => {}
                _ => {
                    let dispatches = self.context.scratch.dispatches.buffer();
                    let (own, count) = (segment.unwrap_or(0), self.scene.pages.len());
                    let number = match launch {
                        Launch::Listed(listed) => {
                            dispatches.size() as usize / size_of::<GpuDispatch>() - LOD_LAUNCHES
                                + listed as usize
                        }
                        Launch::Asked => count + own,
                        Launch::Turn => 2 * count + own,
                        Launch::Pyramid => 3 * count,
                        Launch::Indirect | Launch::Direct(_) => own,
                    };
                    let offset = (number * size_of::<GpuDispatch>()) as u64;
                    recorded.dispatch_workgroups_indirect(dispatches.raw(), offset);
                }
            }
        }
        drop(recorded);
        self.finish(span);
        Ok(())
    }

    /// Records a compute pass over the whole scene, launched in one dimension that takes a second row where one is not
    /// enough, for each of `views`.
    pub fn rows(
        &mut self,
        groups: u32,
        views: u32,
        constants: Constants,
    ) -> Result<(), ShaderError> {
        let size = [groups.min(DISPATCH_ROW), groups.div_ceil(DISPATCH_ROW), views];
        self.compute(Call {
            choices: Choices::default(),
            constants,
            segments: &[None],
            launch: Launch::Direct(size),
        })
    }

    /// Records a pass over the entries, or over the instances, of all views; where the scene is one of point trees, over those
    /// that the frame has listed.
    pub fn over_lists(
        &mut self,
        groups: u32,
        listed: Listed,
        constants: Constants,
    ) -> Result<(), ShaderError> {
        if !self.scene.has_trees() {
            return self.rows(groups, self.task.count(), constants);
        }
        self.compute(Call {
            choices: Choices { trees: true, ..Choices::default() },
            constants,
            segments: &[None],
            launch: Launch::Listed(listed),
        })
    }

    /// Records an indirect draw of the list of large triangles. The attachment has a view's size and is thrown away.
    pub fn raster(&mut self, choices: Choices) -> Result<(), ShaderError> {
        let constants = self.constants(Vec::new());
        let context = &mut *self.context;
        let pipeline = context.pipelines.raster(context.gpu, self.pass, choices, constants)?;
        let binds = self.bind(&pipeline.layouts, &pipeline.bindings, (self.segment, 0))?;
        let (width, height) = self.task.size();
        let context = &mut *self.context;
        let attachment = context.scratch.attachment(context.gpu, width, height);
        let name = self.pass.name();
        let (mut recorded, span) = context.timer.raster(self.encoder, name, &attachment);
        recorded.set_pipeline(&pipeline.pipeline);
        for (index, (group, offsets)) in binds.iter().enumerate() {
            recorded.set_bind_group(index as u32, group.as_ref(), offsets);
        }
        recorded.draw_indirect(context.scratch.large.buffer().raw(), 0);
        drop(recorded);
        self.finish(span);
        Ok(())
    }

    /// Notes when the pass ran.
    pub fn finish(&mut self, span: Option<Span>) {
        self.context.timer.settle(self.encoder);
        self.spans.push(PassSpan { pass: self.pass, span });
    }

    /// Finds the buffer of every binding by its name in the shader.
    fn bind(
        &self,
        layouts: &[wgpu::BindGroupLayout; GROUPS],
        bindings: &[Vec<BindingSlot>; GROUPS],
        (segment, layer): (Segment, usize),
    ) -> Result<Binds, ShaderError> {
        let names = Names {
            scratch: self.context.scratch,
            residency: self.context.residency,
            scene: self.scene,
            uniforms: self.uniforms,
            shadow_maps: self.task.shadows.as_ref().map(|shadows| &shadows.set.maps),
            segment,
            level: self.level,
            window: (self.window, layer),
        };
        let mut out = Vec::with_capacity(GROUPS);
        for (layout, slots) in layouts.iter().zip(bindings) {
            let mut list = Vec::with_capacity(slots.len());
            let mut offsets = Vec::new();
            for slot in slots {
                let (binding, offset) =
                    names.find(&slot.name).ok_or_else(|| ShaderError::Invalid {
                        name: slot.name.clone(),
                        message: "no buffer goes by this name in this pass".to_owned(),
                    })?;
                list.push((slot.number, binding));
                if slot.dynamic {
                    offsets.push(offset);
                }
            }
            let group = self.context.binds.borrow_mut().get(self.context.gpu, layout, &list);
            out.push((group, offsets));
        }
        Ok(out)
    }
}
