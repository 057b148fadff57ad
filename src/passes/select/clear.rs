//! Empties what the passes of all views gather in: by commands that fill buffers, which software drivers carry out several times
//! as fast as a shader.

use crate::gpu::shader::ShaderError;
use crate::passes::recorder::Recorder;
use crate::passes::scratch::LAYERS_BYTES;
use crate::plan::Pass;
use crate::residency::layout::GpuStats;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let (task, scratch) = (recorder.task, &*recorder.context.scratch);
    let ((width, height), views) = (task.size(), u64::from(task.count()));
    let pixels = views * u64::from(width) * u64::from(height);
    let mut buffers = vec![
        (&scratch.visibility, Some(pixels * 8)),
        (&scratch.stats, Some(views * size_of::<GpuStats>() as u64)),
        (&scratch.dispatches, None),
        (&scratch.portions, None),
        (&scratch.depths, None),
    ];
    buffers.extend(scratch.sums[..task.sums()].iter().map(|sums| (sums, Some(pixels * 8))));
    if task.plan.runs(Pass::FuseSplats) {
        buffers.push((&scratch.layers, Some(pixels * LAYERS_BYTES)));
    }
    let buffers: Vec<_> =
        buffers.into_iter().map(|(found, bytes)| (found.buffer().raw().clone(), bytes)).collect();
    recorder.zero(&buffers);
    Ok(())
}
