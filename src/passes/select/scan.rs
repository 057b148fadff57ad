//! Where the visible entries of each segment will lie, and how its passes are launched.

use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{Call, Recorder, rows};
use crate::plan::Pass;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let (groups, views) = (1, recorder.task.count());
    recorder.compute(Call {
        pass: Pass::Scan,
        root: "select/scan",
        visibility: None,
        constants: Vec::new(),
        segments: &[None],
        launch: rows(groups, views),
    })
}
