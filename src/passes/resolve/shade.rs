//! Lights, once a pixel.

use super::tiles;
use crate::gpu::shader::ShaderError;
use crate::passes::pipelines::Constants;
use crate::passes::recorder::{Call, Recorder};
use crate::passes::shaders::Choices;
use crate::residency::Looks;
use crate::residency::layout::FEW_LIGHTS;

/// Overrides of `shared/phong` and of what asks pixels or splats for their materials.
pub fn light_constants(looks: Looks, lights: u32) -> Constants {
    vec![
        ("SPECULAR", u32::from(looks.specular)),
        ("POINT_LIGHTS", u32::from(looks.point_lights)),
        ("MATERIALS", u32::from(looks.overrides || looks.specular || looks.unlit)),
        ("FEW_LIGHTS", if lights > FEW_LIGHTS { 0 } else { lights }),
    ]
}

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let looks = recorder.scene.looks;
    let mut constants = light_constants(looks, recorder.scene.light_count);
    constants.push(("OVERRIDES", u32::from(looks.overrides)));
    recorder.compute(Call {
        choices: Choices::default(),
        constants,
        segments: &[None],
        launch: tiles(recorder),
    })
}
