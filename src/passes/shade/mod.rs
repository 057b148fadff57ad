//! Lights, once a pixel.

use super::recorder::{Call, Recorder};
use super::resolve::tiles;
use crate::gpu::shader::ShaderError;
use crate::plan::Pass;
use crate::residency::layout::FEW_LIGHTS;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let (looks, lights) = (recorder.scene.looks, recorder.scene.light_count);
    let constants = vec![
        ("OVERRIDES", u32::from(looks.overrides)),
        ("SPECULAR", u32::from(looks.specular)),
        ("POINT_LIGHTS", u32::from(looks.point_lights)),
        ("MATERIALS", u32::from(looks.overrides || looks.specular || looks.unlit)),
        ("FEW_LIGHTS", if lights > FEW_LIGHTS { 0 } else { lights }),
    ];
    recorder.compute(Call {
        pass: Pass::Shade,
        root: "shade/shade",
        visibility: None,
        constants,
        segments: &[None],
        launch: tiles(recorder),
    })
}
