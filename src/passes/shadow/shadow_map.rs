//! The scene as its suns see it: a whole frame of depths for each map, whose passes count as this one.

use super::{STATS_BYTES, Source};
use crate::gpu::shader::ShaderError;
use crate::passes::record::record as record_frame;
use crate::passes::recorder::{PassSpan, Recorder};
use crate::plan::Pass;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let task = recorder.task;
    let Some(shadows) = &task.shadows else { return Ok(()) };
    let set = &shadows.set;
    let mut uniforms = recorder.shadow_uniforms().iter();
    let (mut first, mut counted) = (0, 0);
    for (map, source) in shadows.tasks.iter().zip(&shadows.sources) {
        let bytes = map.pixels() * 4;
        let maps = set.maps.raw();
        match source {
            Source::Copied(from, place) => {
                let encoder = &mut *recorder.encoder;
                encoder.copy_buffer_to_buffer(from.maps.raw(), *place, maps, first, bytes);
            }
            Source::Drawn => {
                // There is a record for each map that is drawn.
                let Some(uniforms) = uniforms.next() else { break };
                let (scene, encoder) = (recorder.scene, &mut *recorder.encoder);
                let spans = record_frame(recorder.context, encoder, map, scene, uniforms)?;
                let renamed = |span: PassSpan| PassSpan { pass: Pass::ShadowMap, ..span };
                recorder.spans.extend(spans.into_iter().map(renamed));
                let scratch = &*recorder.context.scratch;
                let (depths, stats) = (scratch.pixels.buffer(), scratch.stats.buffer());
                let encoder = &mut *recorder.encoder;
                encoder.copy_buffer_to_buffer(depths.raw(), 0, maps, first, bytes);
                let counts = set.stats.raw();
                encoder.copy_buffer_to_buffer(stats.raw(), 0, counts, counted, STATS_BYTES);
                counted += STATS_BYTES;
            }
        }
        first += bytes;
    }
    Ok(())
}
