//! Uniforms and constants of fog, see `shaders/shared/fog.wgsl`.

use super::pipelines::Constants;
use super::recorder::Recorder;
use crate::math::View;
use crate::plan::Specialisation;
use crate::scene::Fog;

/// Linear RGB and the density for each scene unit.
pub fn light(fog: &Fog) -> [f32; 4] {
    let [r, g, b] = fog.color;
    [r, g, b, (fog.density as f32).max(f32::MIN_POSITIVE)]
}

/// Map from a place in camera space to its height above the fog's base in scale heights: a product with the first three numbers, plus the last. Zeros
/// where the fog is as dense everywhere.
pub fn heights(fog: &Fog, view: &View) -> [f32; 4] {
    let Some(layer) = fog.layer else { return [0.0; 4] };
    let slope = view.view_from_world * layer.up / layer.scale;
    let eye = (layer.up.dot(view.eye) - layer.base) / layer.scale;
    // Camera space looks along +z, with y down.
    [slope.x as f32, -slope.y as f32, -slope.z as f32, eye as f32]
}

/// Override of `shared/fog`; none where there is no fog.
pub fn constants(recorder: &Recorder) -> Constants {
    let number = |fog: Fog| if fog.layer.is_some() { 2 } else { 1 };
    let name = Specialisation::Fog.constant();
    recorder.task.fog.map(|fog| (name, number(fog))).into_iter().collect()
}
