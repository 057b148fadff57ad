//! The surfaces of visible pixels, and the output that they make.

pub mod accumulate;
pub mod ambient_occlusion;
pub mod average;
pub mod composite_layers;
pub mod composite_splats;
pub mod identify;
pub mod resolve_fuzzy;
pub mod resolve_lines;
pub mod resolve_pulled;
pub mod resolve_samples;
pub mod resolve_splats;
pub mod resolve_triangles;
pub mod write_output;

use super::fog;
use super::frame::output_number;
use super::pipelines::Constants;
use super::recorder::{Launch, Recorder};
use super::shaders::Choices;
use crate::plan::{Pass, Specialisation};
use crate::residency::layout::FEW_LIGHTS;
use crate::scene::recolor::Recolor;
use crate::scene::{Tone, ToneMap};

/// Pixels that a workgroup resolves; as in the shaders.
pub const TILE: (u32, u32) = (64, 16);

/// A launch of a workgroup for every tile of every view.
pub fn tiles(recorder: &Recorder) -> Launch {
    let (width, height) = recorder.task.size();
    Launch::Direct([width.div_ceil(TILE.0), height.div_ceil(TILE.1), recorder.task.count()])
}

/// Override of an effect, by whether the plan has it.
fn switch(recorder: &Recorder, effect: Specialisation) -> (&'static str, u32) {
    (effect.constant(), u32::from(recorder.task.plan.draws(effect)))
}

/// Overrides of `shared/phong` and of what asks pixels or splats for their materials.
pub fn light_constants(recorder: &Recorder) -> Constants {
    use Specialisation::{Emissive, Materials, Physical, PointLights, Specular};
    let lights = recorder.scene.light_count;
    let mut constants = [Specular, PointLights, Physical, Emissive, Materials]
        .map(|effect| switch(recorder, effect))
        .to_vec();
    constants.push(("FEW_LIGHTS", if lights > FEW_LIGHTS { 0 } else { lights }));
    constants.extend(tone_constants(recorder));
    if recorder.task.shadows.is_some() {
        constants.push(("SUN_MAPS", recorder.task.maps_per_sun()));
        constants.push(("LAMP_MAPS", u32::from(recorder.task.has_lamp_maps())));
    }
    constants
}

/// Override of `shared/tone`.
pub fn tone_constants(recorder: &Recorder) -> Constants {
    let number = |tone: Tone| match tone.map {
        ToneMap::None => 1,
        ToneMap::Neutral => 2,
        ToneMap::Aces => 3,
    };
    vec![(Specialisation::Tone.constant(), recorder.task.tone.map_or(0, number))]
}

/// Whether pixels are lit by the scene's surroundings.
fn surrounded(recorder: &Recorder) -> bool {
    recorder.task.environment && recorder.task.plan.lights_pixels
}

/// Fragments of a resolve pass: surfaces are kept if a later pass writes the output.
fn choices(recorder: &Recorder) -> Choices {
    let layers = recorder.stage.is_windowed();
    let kept = !layers && recorder.task.plan.runs(Pass::WriteOutput);
    let shadows = recorder.task.shadows.is_some();
    let maps = kept && recorder.task.plan.draws(Specialisation::Maps);
    Choices { kept, layers, shadows, environment: surrounded(recorder), maps, ..Choices::default() }
}

/// Override of the value that colours surfaces, where one does.
fn recolor_constants(recorder: &Recorder) -> Constants {
    let number = |recolor| match recolor {
        Recolor::Height { .. } => 1,
        Recolor::Normal => 2,
        Recolor::Instance => 3,
        Recolor::Field { .. } => 4,
    };
    recorder.task.recolor.map(|recolor| ("COLOR_BY", number(recolor))).into_iter().collect()
}

/// Overrides of the fragments that light surfaces and write the output.
fn output_constants(recorder: &Recorder) -> Constants {
    let (scene, is_lit) = (recorder.scene, recorder.task.plan.lights_pixels);
    let mut constants = vec![
        ("OUTPUT", output_number(recorder.task.output)),
        ("SHADED", u32::from(is_lit)),
        ("OVERRIDES", u32::from(scene.looks.overrides)),
    ];
    if is_lit {
        constants.extend(light_constants(recorder));
    }
    constants.extend(fog::constants(recorder));
    constants
}

/// Override of `shared/transmits`, of passes over translucent surfaces.
fn layer_constants(recorder: &Recorder) -> Constants {
    let transmits = switch(recorder, Specialisation::Transmits);
    let has_override = recorder.stage.is_windowed() && transmits.1 > 0;
    has_override.then_some(transmits).into_iter().collect()
}

fn constants(recorder: &Recorder) -> Constants {
    let mut constants = if choices(recorder).kept {
        vec![
            ("OUTPUT", output_number(recorder.task.output)),
            ("SHADED", u32::from(recorder.task.plan.lights_pixels)),
            ("OVERRIDES", u32::from(recorder.scene.looks.overrides)),
        ]
    } else {
        output_constants(recorder)
    };
    constants.extend(recolor_constants(recorder));
    constants.extend(layer_constants(recorder));
    constants.push(switch(recorder, Specialisation::Textures));
    constants.push(switch(recorder, Specialisation::Maps));
    constants
}
