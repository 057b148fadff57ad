//! Pixels that show a sample, or the layers of translucent samples before them.

use super::{choices, constants, tiles};
use crate::bake::pack::GeometryKind;
use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{Call, Recorder};
use crate::passes::samples::{is_tree, paint_constants};
use crate::passes::shaders::Choices;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let segments = recorder.segments(&[GeometryKind::Samples]);
    let first = segments.first().copied().flatten();
    let mut constants = constants(recorder);
    constants.extend(paint_constants(recorder, first));
    recorder.compute(Call {
        choices: Choices {
            nodes: is_tree(recorder, first),
            fields: recorder.task.shows_field(),
            ..choices(recorder)
        },
        constants,
        segments: &segments,
        launch: tiles(recorder),
    })
}
