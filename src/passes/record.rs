//! Recording a group of frames of one scene: a list of calls, one a pass. A dispatch counts the group's views in z.

use std::cell::RefCell;
use std::rc::Rc;

use super::frame::{FrameTask, frame_record, output_number};
use super::pipelines::{Constants, Pipelines};
use super::scratch::Scratch;
use super::shaders::Visibility;
use crate::gpu::Gpu;
use crate::gpu::bind::{BindCache, Binding};
use crate::gpu::buffer::Buffer;
use crate::gpu::pipeline::{BindingSlot, ComputePipeline, GROUPS};
use crate::gpu::shader::ShaderError;
use crate::gpu::timing::{Span, Timer};
use crate::plan::{Output, Pass};
use crate::residency::layout::{FEW_LIGHTS, GpuDispatch, GpuFrame, GpuLight, MOST_VIEWS};
use crate::residency::{PageKind, Residency, ResidentScene};

/// What a shader binds as the views' records, however many there are.
const VIEWS_WINDOW: u64 = MOST_VIEWS as u64 * size_of::<GpuFrame>() as u64;
/// Uniform records begin at multiples of this.
const ALIGN: u64 = 256;
/// Workgroups in x before an indirect or direct dispatch takes a second row; as in the shaders.
const DISPATCH_ROW: u32 = 32768;

/// Triangles that walk_triangles takes side by side, and the height of a band of the image; as in the shader.
const WALK: (u32, u32) = (64, 128);
/// Pixels that a workgroup resolves or shades; as in the shaders.
const TILE: (u32, u32) = (64, 16);

/// When a pass ran within its submission.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PassSpan {
    pub pass: Pass,
    pub span: Option<Span>,
}

/// What recording a group leaves behind.
#[derive(Clone, Debug, Default)]
pub struct Recorded {
    pub spans: Vec<PassSpan>,
}

/// Uniform words of a batch, written to the GPU in one go before the submission.
#[derive(Default)]
pub struct Uniforms {
    bytes: Vec<u8>,
}

impl Uniforms {
    fn push<T: bytemuck::NoUninit>(&mut self, records: &[T]) -> u32 {
        let offset = self.bytes.len();
        self.bytes.extend_from_slice(bytemuck::cast_slice(records));
        self.bytes.resize(self.bytes.len().next_multiple_of(ALIGN as usize), 0);
        offset as u32
    }

    /// Where a group's records lie: those of its views, then one a segment.
    pub fn group(&mut self, task: &FrameTask, scene: &ResidentScene) -> FrameUniforms {
        let views: Vec<GpuFrame> =
            (0..task.count()).map(|number| frame_record(task, scene, number)).collect();
        let frame = self.push(views.as_slice());
        let segments = (0..scene.pages.len() as u32)
            .map(|index| self.push(&[index, u32::from(index == 0), 0u32, 0u32]))
            .collect();
        FrameUniforms { frame, segments }
    }

    pub fn write(&self, gpu: &Gpu, scratch: &mut Scratch) {
        // The last group's window may reach beyond its views.
        scratch.uniforms.reserve(gpu, self.bytes.len() as u64 + VIEWS_WINDOW);
        gpu.queue.write_buffer(scratch.uniforms.buffer().raw(), 0, &self.bytes);
    }
}

/// Offsets into the batch's uniforms.
#[derive(Clone, Debug)]
pub struct FrameUniforms {
    frame: u32,
    segments: Vec<u32>,
}

/// What recording needs besides the frame.
pub struct Context<'a> {
    pub gpu: &'a Gpu,
    pub pipelines: &'a mut Pipelines,
    pub binds: &'a RefCell<BindCache>,
    pub scratch: &'a mut Scratch,
    pub residency: &'a Residency,
    pub timer: &'a mut Timer,
}

/// A group being recorded.
struct Recorder<'a, 'c> {
    context: &'a mut Context<'c>,
    scene: &'a ResidentScene,
    task: &'a FrameTask,
    uniforms: &'a FrameUniforms,
    out: Recorded,
}

/// The segment that a pass draws, if it draws one.
type Segment = Option<usize>;

/// Records every pass of `task`'s plan. The scratch has room and the scene is resident.
///
/// # Errors
/// A shader that does not compose, which is a defect of this program.
pub fn record(
    context: &mut Context,
    encoder: &mut wgpu::CommandEncoder,
    task: &FrameTask,
    scene: &ResidentScene,
    uniforms: &FrameUniforms,
) -> Result<Recorded, ShaderError> {
    let atomics_64 = context.gpu.atomics_64;
    let mut recorder = Recorder { context, scene, task, uniforms, out: Recorded::default() };
    let (width, height) = task.size();
    let views = task.count();
    let pixels = views * width * height;
    let plan = &task.plan;
    let cut = scene.alpha_cut;

    recorder.context.timer.begin_frame(encoder);
    let entries = scene.entry_count;
    recorder.run(encoder, Pass::Clear, "select/clear", pixels.div_ceil(2).div_ceil(16 * 64), 1)?;
    recorder.run(encoder, Pass::Place, "select/place", scene.instance_count.div_ceil(64), views)?;
    recorder.run(encoder, Pass::Cull, "select/cull", entries.div_ceil(32 * 32), views)?;
    recorder.run(encoder, Pass::Scan, "select/scan", 1, views)?;
    recorder.run(encoder, Pass::Compact, "select/compact", entries.div_ceil(64), views)?;
    let (first, second) = if atomics_64 {
        (Visibility::Wide, None)
    } else {
        (Visibility::Depth, Some(Visibility::Id))
    };
    recorder.project(encoder, first, cut)?;
    if let Some(second) = second {
        recorder.project(encoder, second, cut)?;
    }
    let tiles = [width.div_ceil(TILE.0), height.div_ceil(TILE.1), views];
    if plan.runs(Pass::ResolveSamples) {
        recorder.resolve(
            encoder,
            Pass::ResolveSamples,
            "resolve/resolve_samples",
            PageKind::Samples,
            tiles,
        )?;
    }
    if plan.runs(Pass::ResolveTriangles) {
        recorder.resolve(
            encoder,
            Pass::ResolveTriangles,
            "resolve/resolve_triangles",
            PageKind::Triangles,
            tiles,
        )?;
    }
    if plan.runs(Pass::Shade) {
        recorder.shade(encoder, tiles)?;
    }
    debug_assert!(task.output != Output::Color || scene.light_count == 0 || plan.runs(Pass::Shade));
    Ok(recorder.out)
}

impl Recorder<'_, '_> {
    /// A pass of one direct dispatch.
    fn run(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        pass: Pass,
        root: &str,
        groups: u32,
        views: u32,
    ) -> Result<(), ShaderError> {
        let constants = self.constants();
        let pipeline =
            self.context.pipelines.plain(self.context.gpu, root, pass.name(), constants)?;
        let binds = self.bind(&pipeline, None)?;
        let (mut recorded, span) = self.context.timer.compute(encoder, pass.name());
        set(&mut recorded, &pipeline, &binds);
        if groups > 0 {
            recorded.dispatch_workgroups(
                groups.min(DISPATCH_ROW),
                groups.div_ceil(DISPATCH_ROW),
                views,
            );
        }
        drop(recorded);
        self.context.timer.settle(encoder);
        self.out.spans.push(PassSpan { pass, span });
        Ok(())
    }

    /// Values of overrides that every pass has.
    fn constants(&self) -> Constants {
        vec![("VIEWS", u32::from(self.task.count() > 1))]
    }

    fn segments(&self, kind: PageKind) -> Vec<usize> {
        (0..self.scene.pages.len()).filter(|&index| self.scene.pages[index].kind == kind).collect()
    }

    /// All samples, then all triangles, into the visibility buffer.
    fn project(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        visibility: Visibility,
        alpha_cut: bool,
    ) -> Result<(), ShaderError> {
        let second = visibility == Visibility::Id;
        let samples = if second { Pass::ProjectSamplesId } else { Pass::ProjectSamples };
        if self.task.plan.runs(samples) {
            let pipeline = self.context.pipelines.visible(
                self.context.gpu,
                "project/project_samples",
                "project_samples",
                visibility,
                false,
                self.constants(),
            )?;
            self.dispatch_segments(encoder, samples, &pipeline, PageKind::Samples)?;
        }
        let triangles = if second { Pass::ProjectTrianglesId } else { Pass::ProjectTriangles };
        if self.task.plan.runs(triangles) {
            let (raster, walk) = if second {
                (Pass::RasteriseTrianglesId, Pass::WalkTrianglesId)
            } else {
                (Pass::RasteriseTriangles, Pass::WalkTriangles)
            };
            for segment in self.segments(PageKind::Triangles) {
                // The list of large triangles is the segment's own: its ids mean vertices of one page.
                encoder.clear_buffer(self.context.scratch.large.buffer().raw(), 0, Some(4));
                self.project_triangles(encoder, triangles, visibility, alpha_cut, segment)?;
                if self.task.plan.runs(raster) {
                    self.rasterise(encoder, raster, visibility, alpha_cut, segment)?;
                } else {
                    self.walk(encoder, walk, visibility, alpha_cut, segment)?;
                }
            }
        }
        Ok(())
    }

    fn dispatch_segments(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        pass: Pass,
        pipeline: &Rc<ComputePipeline>,
        kind: PageKind,
    ) -> Result<(), ShaderError> {
        let segments = self.segments(kind);
        let binds: Vec<Binds> = segments
            .iter()
            .map(|&segment| self.bind(pipeline, Some(segment)))
            .collect::<Result<_, _>>()?;
        let (mut recorded, span) = self.context.timer.compute(encoder, pass.name());
        for (segment, binds) in segments.iter().zip(&binds) {
            set(&mut recorded, pipeline, binds);
            recorded.dispatch_workgroups_indirect(
                self.context.scratch.dispatches.buffer().raw(),
                (*segment * size_of::<GpuDispatch>()) as u64,
            );
        }
        drop(recorded);
        self.context.timer.settle(encoder);
        self.out.spans.push(PassSpan { pass, span });
        Ok(())
    }

    fn project_triangles(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        pass: Pass,
        visibility: Visibility,
        alpha_cut: bool,
        segment: usize,
    ) -> Result<(), ShaderError> {
        let pipeline = self.context.pipelines.visible(
            self.context.gpu,
            "project/project_triangles",
            "project_triangles",
            visibility,
            alpha_cut,
            self.constants(),
        )?;
        let binds = self.bind(&pipeline, Some(segment))?;
        let (mut recorded, span) = self.context.timer.compute(encoder, pass.name());
        set(&mut recorded, &pipeline, &binds);
        recorded.dispatch_workgroups_indirect(
            self.context.scratch.dispatches.buffer().raw(),
            (segment * size_of::<GpuDispatch>()) as u64,
        );
        drop(recorded);
        self.context.timer.settle(encoder);
        self.out.spans.push(PassSpan { pass, span });
        Ok(())
    }

    fn walk(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        pass: Pass,
        visibility: Visibility,
        alpha_cut: bool,
        segment: usize,
    ) -> Result<(), ShaderError> {
        let pipeline = self.context.pipelines.visible(
            self.context.gpu,
            "project/walk_triangles",
            "walk_triangles",
            visibility,
            alpha_cut,
            self.constants(),
        )?;
        let binds = self.bind(&pipeline, Some(segment))?;
        let (mut recorded, span) = self.context.timer.compute(encoder, pass.name());
        set(&mut recorded, &pipeline, &binds);
        recorded.dispatch_workgroups(WALK.0, self.task.size().1.div_ceil(WALK.1), 1);
        drop(recorded);
        self.context.timer.settle(encoder);
        self.out.spans.push(PassSpan { pass, span });
        Ok(())
    }

    fn rasterise(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        pass: Pass,
        visibility: Visibility,
        alpha_cut: bool,
        segment: usize,
    ) -> Result<(), ShaderError> {
        let constants = self.constants();
        let pipeline =
            self.context.pipelines.raster(self.context.gpu, visibility, alpha_cut, constants)?;
        let binds = self.bind_layouts(&pipeline.layouts, &pipeline.bindings, Some(segment))?;
        let (width, height) = self.task.size();
        let attachment = self.context.scratch.attachment(self.context.gpu, width, height);
        let (mut recorded, span) = self.context.timer.raster(encoder, pass.name(), &attachment);
        recorded.set_pipeline(&pipeline.pipeline);
        for (index, (group, offsets)) in binds.iter().enumerate() {
            recorded.set_bind_group(index as u32, group.as_ref(), offsets);
        }
        recorded.draw_indirect(self.context.scratch.large.buffer().raw(), 0);
        drop(recorded);
        self.context.timer.settle(encoder);
        self.out.spans.push(PassSpan { pass, span });
        Ok(())
    }

    fn resolve(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        pass: Pass,
        root: &str,
        kind: PageKind,
        tiles: [u32; 3],
    ) -> Result<(), ShaderError> {
        let looks = self.scene.looks;
        let mut constants = self.constants();
        constants.extend([
            ("OUTPUT", output_number(self.task.output)),
            ("SHADED", u32::from(self.task.plan.runs(Pass::Shade))),
            ("OVERRIDES", u32::from(looks.overrides)),
            ("TEXTURES", u32::from(looks.textures)),
        ]);
        let pipeline =
            self.context.pipelines.plain(self.context.gpu, root, pass.name(), constants)?;
        let segments = self.segments(kind);
        let binds: Vec<Binds> = segments
            .iter()
            .map(|&segment| self.bind(&pipeline, Some(segment)))
            .collect::<Result<_, _>>()?;
        let (mut recorded, span) = self.context.timer.compute(encoder, pass.name());
        for binds in &binds {
            set(&mut recorded, &pipeline, binds);
            recorded.dispatch_workgroups(tiles[0], tiles[1], tiles[2]);
        }
        drop(recorded);
        self.context.timer.settle(encoder);
        self.out.spans.push(PassSpan { pass, span });
        Ok(())
    }

    fn shade(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        tiles: [u32; 3],
    ) -> Result<(), ShaderError> {
        let (looks, lights) = (self.scene.looks, self.scene.light_count);
        let mut constants = self.constants();
        constants.extend([
            ("OVERRIDES", u32::from(looks.overrides)),
            ("SPECULAR", u32::from(looks.specular)),
            ("POINT_LIGHTS", u32::from(looks.point_lights)),
            ("MATERIALS", u32::from(looks.overrides || looks.specular || looks.unlit)),
            ("FEW_LIGHTS", if lights > FEW_LIGHTS { 0 } else { lights }),
        ]);
        let name = Pass::Shade.name();
        let pipeline =
            self.context.pipelines.plain(self.context.gpu, "shade/shade", name, constants)?;
        let binds = self.bind(&pipeline, None)?;
        let (mut recorded, span) = self.context.timer.compute(encoder, name);
        set(&mut recorded, &pipeline, &binds);
        recorded.dispatch_workgroups(tiles[0], tiles[1], tiles[2]);
        drop(recorded);
        self.context.timer.settle(encoder);
        self.out.spans.push(PassSpan { pass: Pass::Shade, span });
        Ok(())
    }

    fn bind(&mut self, pipeline: &ComputePipeline, segment: Segment) -> Result<Binds, ShaderError> {
        self.bind_layouts(&pipeline.layouts, &pipeline.bindings, segment)
    }

    /// Finds the buffer of every binding by its name in the shader.
    fn bind_layouts(
        &mut self,
        layouts: &[wgpu::BindGroupLayout; GROUPS],
        bindings: &[Vec<BindingSlot>; GROUPS],
        segment: Segment,
    ) -> Result<Binds, ShaderError> {
        let mut out = Vec::with_capacity(GROUPS);
        for (layout, slots) in layouts.iter().zip(bindings) {
            let mut list = Vec::with_capacity(slots.len());
            let mut offsets = Vec::new();
            for slot in slots {
                let (binding, offset) =
                    resolve_name(self.context, self.scene, self.uniforms, &slot.name, segment)
                        .ok_or_else(|| ShaderError::Invalid {
                            name: slot.name.clone(),
                            message: "no buffer goes by this name in this pass".to_owned(),
                        })?;
                list.push((slot.number, binding));
                if slot.dynamic {
                    offsets.push(offset);
                }
            }
            out.push((
                self.context.binds.borrow_mut().get(self.context.gpu, layout, &list),
                offsets,
            ));
        }
        Ok(out)
    }
}

type Binds = Vec<(Rc<wgpu::BindGroup>, Vec<u32>)>;

fn set(pass: &mut wgpu::ComputePass, pipeline: &ComputePipeline, binds: &Binds) {
    pass.set_pipeline(&pipeline.pipeline);
    for (index, (group, offsets)) in binds.iter().enumerate() {
        pass.set_bind_group(index as u32, group.as_ref(), offsets);
    }
}

/// The buffer that a shader means by `name`, and its dynamic offset.
fn resolve_name<'b>(
    context: &'b Context,
    scene: &'b ResidentScene,
    uniforms: &FrameUniforms,
    name: &str,
    segment: Segment,
) -> Option<(Binding<'b>, u32)> {
    let scratch = &*context.scratch;
    let residency = context.residency;
    let page = segment.map(|segment| scene.pages[segment]);
    let samples = || {
        page.filter(|page| page.kind == PageKind::Samples)
            .map(|page| residency.sample_page(page.index))
    };
    let mesh = || {
        page.filter(|page| page.kind == PageKind::Triangles)
            .map(|page| residency.mesh_page(page.index))
    };
    let buffer: &Buffer = match name {
        "frames" => {
            let window = Binding::Window(scratch.uniforms.buffer(), VIEWS_WINDOW);
            return Some((window, uniforms.frame));
        }
        "segment" => {
            let offset = *uniforms.segments.get(segment?)?;
            return Some((Binding::Window(scratch.uniforms.buffer(), 16), offset));
        }
        "visibility" => scratch.visibility.buffer(),
        "pixels" => scratch.pixels.buffer(),
        "normals" => scratch.normals.buffer(),
        "stats" => scratch.stats.buffer(),
        "placed" => scratch.placed.buffer(),
        "seen" => scratch.seen.buffer(),
        "ranks" => scratch.ranks.buffer(),
        "group_counts" => scratch.group_counts.buffer(),
        "slots" => scratch.slots.buffer(),
        "runs" => scratch.runs.buffer(),
        "dispatches" => scratch.dispatches.buffer(),
        "large" => scratch.large.buffer(),
        "instances" => &scene.instances,
        "entries" => &scene.entries,
        "segments" => &scene.segments,
        "sizes" => &scene.sizes,
        "lights" => &scene.lights,
        "few_lights" => {
            let window = u64::from(FEW_LIGHTS) * size_of::<GpuLight>() as u64;
            return Some((Binding::Window(&scene.lights, window), 0));
        }
        "chunks" => residency.chunk_table(),
        "materials" => residency.material_table(),
        "textures" => residency.texture_table(),
        "texels_0" => residency.texel_page(0),
        "texels_1" => residency.texel_page(1),
        "positions" => samples()?.0,
        "attributes" => samples()?.1,
        "vertices" => mesh()?.0,
        "triangles" => mesh()?.1,
        _ => return None,
    };
    Some((Binding::Whole(buffer), 0))
}

#[cfg(test)]
#[path = "record_tests.rs"]
mod tests;
