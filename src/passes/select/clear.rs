//! Empties what the passes of all views gather in, and gives every pixel the background: by commands, which software drivers carry
//! out several times as fast as a shader.

use crate::gpu::shader::ShaderError;
use crate::passes::Levels;
use crate::passes::recorder::Recorder;
use crate::passes::scratch::{BACKGROUND_BYTES, PAINTED_BYTES, SLABS_BYTES, cursors_bytes};
use crate::plan::Pass;
use crate::residency::layout::GpuStats;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let task = recorder.task;
    let background =
        recorder.context.scratch.background(recorder.context.gpu, task.background_word());
    let scratch = &*recorder.context.scratch;
    let ((width, height), views) = (task.size(), u64::from(task.count()));
    let pixels = views * u64::from(width) * u64::from(height);
    let mut buffers = vec![
        (&scratch.visibility, Some(task.visibility_pixels() * 8)),
        (&scratch.stats, Some(views * size_of::<GpuStats>() as u64)),
        (&scratch.dispatches, None),
        (&scratch.portions, None),
        (&scratch.depths, None),
    ];
    buffers.extend(scratch.sums[..task.sums()].iter().map(|sums| (sums, Some(pixels * 8))));
    if task.plan.runs(Pass::FuzzySplats) {
        buffers.push((&scratch.layers, Some(pixels * SLABS_BYTES)));
    }
    if task.plan.runs(Pass::PaintSplats) {
        // Places where nothing is drawn have no key.
        let bytes = u64::from(task.paint_capacity) * 8;
        buffers.push((&scratch.paint_keys[0], Some(bytes)));
        let cursors = cursors_bytes((width, height), recorder.context.gpu.is_cpu);
        buffers.push((&scratch.paint_cursors, Some(cursors)));
        buffers.push((&scratch.painted, Some(pixels * PAINTED_BYTES)));
        buffers.push((&scratch.paint_sums, Some(pixels * PAINTED_BYTES)));
        buffers.push((&scratch.paint_ends, Some(pixels * 8)));
    }
    if task.plan.runs(Pass::Pull) {
        // Pixels without a sample have no patch; coarser levels are written whole.
        let bytes = views * Levels::of((width, height)).bytes();
        buffers.push((&scratch.patches[0], Some(bytes)));
    }
    let image = scratch.pixels.buffer().raw();
    let buffers = buffers.into_iter().map(|(found, bytes)| (found.buffer().raw(), bytes));
    let span = recorder.context.timer.fill(recorder.encoder, |encoder| {
        for (buffer, bytes) in buffers {
            encoder.clear_buffer(buffer, 0, bytes);
        }
        for begin in (0..pixels * 4).step_by(BACKGROUND_BYTES as usize) {
            let bytes = BACKGROUND_BYTES.min(pixels * 4 - begin);
            encoder.copy_buffer_to_buffer(&background, 0, image, begin, bytes);
        }
    });
    recorder.finish(span);
    Ok(())
}
