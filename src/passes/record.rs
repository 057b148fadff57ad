//! Recording a group of frames of one scene: a list of passes. A dispatch counts the group's views in z.

use super::frame::FrameTask;
use super::recorder::{Context, PassSpan, Recorder};
use super::select::cull_hidden::TURNS;
use super::shaders::{Portion, Visibility};
use super::uniforms::GroupUniforms;
use super::{project, reconstruct, resolve, select, shade};
use crate::gpu::shader::ShaderError;
use crate::plan::Pass;
use crate::residency::{PageKind, ResidentScene, SAMPLE_PAGES};

/// Records every pass of `task`'s plan. The scratch has room and the scene is resident.
///
/// # Errors
/// A shader that does not compose, which is a defect of this program.
pub fn record(
    context: &mut Context,
    encoder: &mut wgpu::CommandEncoder,
    task: &FrameTask,
    scene: &ResidentScene,
    uniforms: &GroupUniforms,
) -> Result<Vec<PassSpan>, ShaderError> {
    let plan = &task.plan;
    let halves = if context.gpu.atomics_64 {
        &[Visibility::Wide][..]
    } else {
        &[Visibility::Depth, Visibility::Id]
    };
    context.timer.begin_frame(encoder);
    let recorder = &mut Recorder { context, encoder, scene, task, uniforms, spans: Vec::new() };

    select::clear::record(recorder)?;
    if plan.runs(Pass::CullGroups) {
        select::cull_groups::record(recorder)?;
        select::list_groups::record(recorder)?;
    }
    select::place::record(recorder)?;
    if plan.runs(Pass::SelectChunks) {
        select::select_chunks::record(recorder)?;
        select::list_entries::record(recorder)?;
    }
    select::cull::record(recorder)?;
    select::scan::record(recorder)?;
    select::compact::record(recorder)?;
    if task.hides() {
        select::launch_portions::record(recorder, false)?;
    }
    for &half in halves {
        if !task.hides() {
            project(recorder, half, Portion::All)?;
            continue;
        }
        if half == Visibility::Id {
            // What is hidden is known from the depths.
            select::launch_portions::record(recorder, true)?;
            project(recorder, half, Portion::Turn)?;
            continue;
        }
        project(recorder, half, Portion::Turn)?;
        for _ in 0..TURNS {
            select::depth_pyramid::record(recorder)?;
            select::cull_hidden::record(recorder)?;
            select::launch_portions::record(recorder, false)?;
            project(recorder, half, Portion::Turn)?;
        }
    }
    if plan.runs(Pass::BlendSplats) {
        if task.hides() {
            select::launch_portions::record(recorder, true)?;
            select::depth_pyramid::record(recorder)?;
            select::cull_hidden::record_again(recorder)?;
        }
        blend_splats(recorder)?;
    }
    if plan.runs(Pass::FuseSplats) {
        fuse_splats(recorder)?;
        resolve::resolve_fused::record(recorder)?;
    }
    if plan.runs(Pass::ResolveSplats) {
        resolve::resolve_splats::record(recorder)?;
    }
    if plan.runs(Pass::ResolveSamples) {
        resolve::resolve_samples::record(recorder)?;
    }
    if plan.runs(Pass::ResolveTriangles) {
        resolve::resolve_triangles::record(recorder)?;
    }
    if plan.runs(Pass::Shade) {
        shade::record(recorder)?;
    }
    Ok(std::mem::take(&mut recorder.spans))
}

/// Into the visibility buffer.
fn project(recorder: &mut Recorder, half: Visibility, portion: Portion) -> Result<(), ShaderError> {
    let plan = &recorder.task.plan;
    if plan.runs(project::project_samples::pass(half)) {
        project::project_samples::record(recorder, half, portion)?;
    }
    if plan.runs(project::project_splats::pass(half)) {
        project_splats(recorder, half, portion)?;
    }
    if plan.runs(project::project_triangles::pass(half)) {
        project_triangles(recorder, half, portion)?;
    }
    Ok(())
}

/// Segment by segment, as triangles.
fn project_splats(
    recorder: &mut Recorder,
    half: Visibility,
    portion: Portion,
) -> Result<(), ShaderError> {
    for segment in recorder.segments(SAMPLE_PAGES) {
        recorder.empty_list();
        project::project_splats::record(recorder, half, portion, segment)?;
        project::walk_splats::record(recorder, half, segment)?;
    }
    Ok(())
}

fn blend_splats(recorder: &mut Recorder) -> Result<(), ShaderError> {
    reconstruct::clear_sums(recorder);
    for segment in recorder.segments(SAMPLE_PAGES) {
        recorder.empty_list();
        reconstruct::blend_splats::record(recorder, segment)?;
        reconstruct::blend_walked::record(recorder, segment)?;
    }
    Ok(())
}

fn fuse_splats(recorder: &mut Recorder) -> Result<(), ShaderError> {
    reconstruct::clear_layers(recorder);
    for segment in recorder.segments(SAMPLE_PAGES) {
        recorder.empty_list();
        reconstruct::fuse_splats::record(recorder, segment)?;
        reconstruct::fuse_walked::record(recorder, segment)?;
    }
    Ok(())
}

/// Segment by segment: the list of large triangles is the segment's own, its ids mean vertices of one page.
fn project_triangles(
    recorder: &mut Recorder,
    half: Visibility,
    portion: Portion,
) -> Result<(), ShaderError> {
    let rasterise = project::rasterise_triangles::pass(half);
    for segment in recorder.segments(&[PageKind::Triangles]) {
        recorder.empty_list();
        project::project_triangles::record(recorder, half, portion, segment)?;
        if recorder.task.plan.runs(rasterise) {
            project::rasterise_triangles::record(recorder, half, segment)?;
        } else {
            project::walk_triangles::record(recorder, half, segment)?;
        }
    }
    Ok(())
}

#[cfg(test)]
#[path = "record_tests.rs"]
mod tests;
