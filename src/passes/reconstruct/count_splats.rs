//! How many samples of each slot may be painted.

use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{Call, Recorder};
use crate::passes::samples::{is_tree, node_constants};
use crate::passes::shaders::Choices;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let segment = recorder.segment;
    let mut constants = node_constants(recorder, segment);
    constants.push(recorder.lanes());
    let choices = Choices { nodes: is_tree(recorder, segment), ..Choices::default() };
    let (segments, launch) = (&[segment], recorder.launch());
    recorder.compute(Call { choices, constants, segments, launch })
}
