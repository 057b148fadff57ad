//! How the passes are launched that draw what is near first, and then what it does not hide.

use crate::gpu::shader::ShaderError;
use crate::passes::recorder::Recorder;
use crate::passes::spread;
use crate::plan::Stage;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    // Once the depths are known, all that is not hidden is drawn in one turn.
    let whole = recorder.stage != Stage::Project;
    let [_, asked, _] = spread::overrides(recorder.context.gpu.is_cpu);
    recorder.rows(1, 1, vec![("WHOLE", u32::from(whole)), asked])
}
