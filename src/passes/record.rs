//! Recording a group of frames of one scene: the steps of its plan, one after the other. A dispatch counts the group's views
//! in z.

use super::frame::FrameTask;
use super::recorder::{Context, PassSpan, Recorder};
use super::uniforms::GroupUniforms;
use super::windows::LAYERS;
use super::{project, reconstruct, resolve, select, shadow};
use crate::gpu::shader::ShaderError;
use crate::plan::{Pass, Step, pass_table};
use crate::residency::ResidentScene;

macro_rules! functions {
    ($($pass:ident $kind:ident $folder:ident/$file:ident $half:literal
        [$($stage:ident)+] $per:ident [$($reason:ident)*];)+) => {
        /// Records the pass that the recorder is at.
        fn record_pass(recorder: &mut Recorder) -> Result<(), ShaderError> {
            match recorder.pass {
                $(Pass::$pass => $folder::$file::record(recorder),)+
            }
        }
    };
}
pass_table!(functions);

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
    context.timer.begin_frame(encoder);
    let recorder = &mut Recorder::new(context, encoder, task, scene, uniforms);
    let steps = task.plan.steps();
    for steps in steps.chunk_by(|a, b| a.stage.is_windowed() == b.stage.is_windowed()) {
        for window in 0..recorder.repeats(steps[0].stage) {
            recorder.window = window;
            if steps[0].stage.is_windowed() {
                recorder.empty_window();
            }
            steps.iter().try_for_each(|step| record_step(recorder, step))?;
        }
    }
    Ok(std::mem::take(&mut recorder.spans))
}

fn record_step(recorder: &mut Recorder, step: &Step) -> Result<(), ShaderError> {
    recorder.stage = step.stage;
    for (segment, level) in recorder.rounds_of(step) {
        (recorder.segment, recorder.level) = (segment, level);
        recorder.layers = if step.takes_turns() { level..level + 1 } else { 0..LAYERS as usize };
        if segment.is_some() {
            // The list of what is large is the segment's own: its ids mean elements of one page.
            recorder.empty_list();
        }
        for &pass in &step.passes {
            recorder.pass = pass;
            record_pass(recorder)?;
        }
    }
    if step.passes.iter().any(|pass| matches!(pass, Pass::Pull | Pass::Push)) {
        recorder.copy_levels();
    }
    Ok(())
}

#[cfg(test)]
#[path = "record_tests.rs"]
mod tests;
