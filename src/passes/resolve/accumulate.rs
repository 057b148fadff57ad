//! Depth of field and motion blur: the mean of many exposures.

use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{Launch, Recorder};

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let task = recorder.task;
    let Some(round) = task.round else { return Ok(()) };
    let (width, height) = task.image_size();
    let total = round.exposures.map_or(0, |count| count * task.parts * task.parts);
    recorder.compute_once(
        vec![
            ("PARTS", task.parts),
            ("EXPOSURES", task.count()),
            ("FIRST", u32::from(round.first == 0)),
            ("TOTAL", total),
        ],
        Launch::Direct([width.div_ceil(64), height, 1]),
    )
}
