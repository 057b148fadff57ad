//! Listed triangles, through the adapter's rasteriser.

use crate::gpu::shader::ShaderError;
use crate::passes::recorder::Recorder;
use crate::passes::shaders::Choices;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    recorder.raster(Choices {
        visibility: recorder.visibility(),
        alpha_cut: recorder.alpha_cut(),
        ..Choices::default()
    })
}
