//! How the passes are launched that draw what is near first, and then what it does not hide.

use crate::gpu::shader::ShaderError;
use crate::passes::recorder::Recorder;
use crate::plan::Pass;

/// `whole`: all that is not hidden is drawn in one turn.
pub fn record(recorder: &mut Recorder, whole: bool) -> Result<(), ShaderError> {
    let constants = vec![("WHOLE", u32::from(whole))];
    recorder.rows(Pass::LaunchPortions, "select/launch_portions", 1, 1, constants)
}
