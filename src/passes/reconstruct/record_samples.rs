//! Level 0 of the pull-push pyramid, of the samples that pixels show.

use super::pulled_constants;
use crate::gpu::shader::ShaderError;
use crate::passes::frame::output_number;
use crate::passes::recorder::{Call, Launch, Recorder};
use crate::passes::samples::{is_clipped, is_tree, node_constants, paint_constants};
use crate::passes::shaders::Choices;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let segment = recorder.segment;
    let mut constants = pulled_constants(recorder);
    constants.extend([
        ("OUTPUT", output_number(recorder.task.output)),
        ("EXPANDED", 1),
        ("OVERRIDES", u32::from(recorder.scene.looks.overrides)),
        // Arguments of `paint_of`.
        ("DEFERRED", constants.iter().any(|&(name, value)| name == "NORMALS" && value != 0).into()),
        recorder.lanes(),
    ]);
    constants.extend(node_constants(recorder, segment));
    constants.extend(paint_constants(recorder, segment));
    recorder.compute(Call {
        choices: Choices {
            clipped: is_clipped(recorder, segment),
            nodes: is_tree(recorder, segment),
            fields: recorder.task.shows_field(),
            ..Choices::default()
        },
        constants,
        segments: &[segment],
        // Samples that were found hidden have not won a pixel.
        launch: Launch::Indirect,
    })
}
