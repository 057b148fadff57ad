//! Effects that a scene asks for: surroundings, fog and ambient occlusion.

use std::path::PathBuf;

use glam::DVec3;

use super::super::color::to_linear;
use super::super::wire::{EnvironmentWire, FogWire, OcclusionWire};
use super::super::{AmbientOcclusion, Environment, EnvironmentSource, Fog, FogLayer};
use super::look::{color, rgb};
use super::{LARGEST_COORDINATE, LARGEST_INTENSITY, Place, Valid, within};

const LARGEST_DENSITY: f64 = 1e9;
/// Thinner fog is invisible at any coordinate; with a base far above, the shaders' exponents could not hold it.
const SMALLEST_DENSITY: f64 = 1e-12;
const SMALLEST_SCALE_HEIGHT: f64 = 1e-6;
const SMALLEST_RADIUS: f64 = 1e-9;

/// Weaker light is none in single precision.
const SMALLEST_STRENGTH: f64 = 1e-12;

/// The surroundings of a scene; `resolve` turns a file's name into its path.
pub(super) fn environment(
    wire: &EnvironmentWire,
    up: DVec3,
    resolve: &dyn Fn(&str) -> Result<PathBuf, String>,
) -> Valid<Environment> {
    let root = Place::Root;
    let place = root.key("environment");
    let path = match resolve(&wire.file) {
        Ok(path) => path,
        Err(reason) => return place.key("file").refuse(reason),
    };
    let strength = wire.strength.unwrap_or(1.0);
    let strength = within(strength, SMALLEST_STRENGTH, LARGEST_INTENSITY, place.key("strength"))?;
    let turn = within(wire.turn.unwrap_or(0.0), -1e6, 1e6, place.key("turn"))?;
    Ok(Environment {
        image: EnvironmentSource::File(path),
        strength,
        image_from_world: Environment::image_from_world(up, turn),
        shown: wire.background.unwrap_or(true),
    })
}

/// The fog of a scene; `None` where its density is 0.
pub(super) fn fog(wire: &FogWire, up: DVec3) -> Valid<Option<Fog>> {
    let root = Place::Root;
    let place = root.key("fog");
    let color = rgb(to_linear(color(&wire.color, place.key("color"))?));
    let is_faint = wire.density > 0.0 && wire.density < SMALLEST_DENSITY;
    let least = if is_faint { SMALLEST_DENSITY } else { 0.0 };
    let density = within(wire.density, least, LARGEST_DENSITY, place.key("density"))?;
    let base = wire.base_height.unwrap_or(0.0);
    let base = within(base, -LARGEST_COORDINATE, LARGEST_COORDINATE, place.key("base_height"))?;
    let layer = match wire.scale_height {
        Some(scale) => {
            let place = place.key("scale_height");
            let scale = within(scale, SMALLEST_SCALE_HEIGHT, LARGEST_COORDINATE, place)?;
            Some(FogLayer { up, base, scale })
        }
        None if wire.base_height.is_some() => {
            return place.key("base_height").refuse(
                "only fog with a `scale_height` has one: other fog is as dense at every height",
            );
        }
        None => None,
    };
    Ok((density > 0.0).then_some(Fog { color, density, layer }))
}

/// The ambient occlusion of a scene; `None` where its strength is 0.
pub(super) fn ambient_occlusion(wire: &OcclusionWire) -> Valid<Option<AmbientOcclusion>> {
    let root = Place::Root;
    let place = root.key("ambient_occlusion");
    let radius = within(wire.radius, SMALLEST_RADIUS, LARGEST_COORDINATE, place.key("radius"))?;
    let strength = within(wire.strength.unwrap_or(1.0), 0.0, 1.0, place.key("strength"))?;
    Ok((strength > 0.0).then_some(AmbientOcclusion { radius, strength }))
}
