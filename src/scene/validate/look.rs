//! How things look and are looked at: materials, lights, colours, cameras, paths.

use glam::DVec3;

use super::super::color::{parse_hex, to_linear};
use super::super::load::DEFAULT_BACKGROUND;
use super::super::wire::{
    CameraWire, ColorWire, LightKind, LightWire, MaterialWire, Object, PATH_FPS, PATH_SECONDS,
    PathWire, SplatsWire,
};
use super::super::{CameraPath, Light, MOST_CASTING_LIGHTS, MaterialSpec, PathKey, Splats, Up};
use super::{
    DEFAULT_FOV_DEG, LARGEST_COORDINATE, LARGEST_INTENSITY, Place, Valid, coordinates, unit, within,
};
use crate::math::{Bounds, Camera, Lens};

pub(super) fn material(name: &str, wire: &MaterialWire, place: Place<'_>) -> Valid<MaterialSpec> {
    let base_color = match &wire.color {
        Some(wire) => Some(to_linear(color(wire, place.key("color"))?)),
        None => None,
    };
    let specular = match &wire.specular {
        Some(wire) => Some(rgb(to_linear(color(wire, place.key("specular"))?))),
        None => None,
    };
    let shininess = match wire.shininess {
        Some(exponent) => Some(within(exponent, 1.0, 1e6, place.key("shininess"))? as f32),
        None => None,
    };
    let share = |value: Option<f64>, key: &str| match value {
        Some(share) => Ok(Some(within(share, 0.0, 1.0, place.key(key))? as f32)),
        None => Ok(None),
    };
    let metallic = share(wire.metallic, "metallic")?;
    let roughness = share(wire.roughness, "roughness")?;
    let transmission = share(wire.transmission, "transmission")?;
    let is_physical = metallic.is_some() || roughness.is_some() || transmission.is_some();
    for (key, other) in [("specular", specular.is_some()), ("shininess", shininess.is_some())] {
        if other && is_physical {
            return place.key(key).refuse(
                "a material has `specular` and `shininess`, or `metallic`, `roughness` and `transmission`: they belong to different models",
            );
        }
    }
    let emissive = match (&wire.emissive, wire.emissive_strength) {
        (Some(wire), strength) => {
            let key = place.key("emissive_strength");
            let strength = within(strength.unwrap_or(1.0), 0.0, LARGEST_INTENSITY, key)? as f32;
            Some(rgb(to_linear(color(wire, place.key("emissive"))?)).map(|c| c * strength))
        }
        (None, Some(_)) => {
            return place
                .key("emissive_strength")
                .refuse("only a material with `emissive` has one");
        }
        (None, None) => None,
    };
    Ok(MaterialSpec {
        name: name.to_owned(),
        base_color,
        specular,
        shininess,
        metallic,
        roughness,
        transmission,
        emissive,
        unlit: wire.unlit,
        double_sided: wire.double_sided,
    })
}

/// Each pixel goes through all of them.
const MOST_LIGHTS: usize = 256;
/// Angular diameter in degrees of the sun as seen from the Earth.
const SUN_ANGLE_DEG: f64 = 0.53;

/// `surrounded`: the scene has surroundings that light it.
pub(super) fn lights(wires: Option<&[Object<LightWire>]>, surrounded: bool) -> Valid<Vec<Light>> {
    let Some(wires) = wires else {
        return Ok(if surrounded { Vec::new() } else { Light::default_pair().to_vec() });
    };
    let root = Place::Root;
    let place = root.key("lights");
    if wires.len() > MOST_LIGHTS {
        return place.refuse(format!("{} lights, {MOST_LIGHTS} are possible", wires.len()));
    }
    let lights: Vec<Light> = wires
        .iter()
        .enumerate()
        .map(|(i, wire)| light(wire, place.index(i)))
        .collect::<Valid<_>>()?;
    let casting = lights.iter().filter(|light| light.casts_shadows()).count();
    if casting > MOST_CASTING_LIGHTS {
        return place
            .refuse(format!("{casting} lights cast shadows, {MOST_CASTING_LIGHTS} are possible"));
    }
    Ok(lights)
}

fn light(wire: &LightWire, place: Place<'_>) -> Valid<Light> {
    let only = |key: &str, present: bool, kinds: &[LightKind], owner: &str| {
        if present && !kinds.contains(&wire.kind) {
            return place.key(key).refuse(format!("only {owner} has one"));
        }
        Ok(())
    };
    only("direction", wire.direction.is_some(), &[LightKind::Sun], "a sun")?;
    only("position", wire.position.is_some(), &[LightKind::Point], "a point light")?;
    only("range", wire.range.is_some(), &[LightKind::Point], "a point light")?;
    let casts = wire.shadows == Some(true);
    if casts && !matches!(wire.kind, LightKind::Sun | LightKind::Point) {
        return place.key("shadows").refuse("only suns and point lights cast shadows");
    }
    for (key, is_given, kind, owner) in [
        ("angle", wire.angle.is_some(), LightKind::Sun, "a sun"),
        ("radius", wire.radius.is_some(), LightKind::Point, "a point light"),
    ] {
        if is_given && !(casts && wire.kind == kind) {
            return place.key(key).refuse(format!(
                "only {owner} with `\"shadows\": true` has one: it softens shadows"
            ));
        }
    }
    let angle_deg = within(wire.angle.unwrap_or(SUN_ANGLE_DEG), 0.0, 20.0, place.key("angle"))?;
    let intensity =
        within(wire.intensity.unwrap_or(1.0), 0.0, LARGEST_INTENSITY, place.key("intensity"))?;
    let tint = match &wire.color {
        Some(wire) => rgb(to_linear(color(wire, place.key("color"))?)),
        None => [1.0; 3],
    };
    let color = tint.map(|channel| (f64::from(channel) * intensity) as f32);
    match wire.kind {
        LightKind::Ambient => Ok(Light::Ambient { color }),
        LightKind::Headlight => Ok(Light::Headlight { color }),
        LightKind::Sun => {
            let Some(direction) = wire.direction else {
                return place.refuse("a sun needs `direction`, where its light travels to");
            };
            let direction = unit(direction, place.key("direction"))?;
            Ok(Light::Sun { direction, color, shadows: casts.then_some(angle_deg) })
        }
        LightKind::Point => {
            let Some(position) = wire.position else {
                return place.refuse("a point light needs `position`");
            };
            let Some(range) = wire.range else {
                return place.refuse("a point light needs `range`, where half of it is left");
            };
            let range = within(range, 1e-9, LARGEST_COORDINATE, place.key("range"))?;
            let radius = wire.radius.unwrap_or(0.0);
            let radius = within(radius, 0.0, LARGEST_COORDINATE, place.key("radius"))?;
            Ok(Light::Point {
                position: coordinates(position, place.key("position"))?,
                color,
                range,
                shadows: casts.then_some(radius),
            })
        }
    }
}

/// The parameters of splats that a scene gives, with defaults for the others.
pub(super) fn splats(wire: Option<&SplatsWire>) -> Valid<Splats> {
    let mut splats = Splats::default();
    let Some(wire) = wire else { return Ok(splats) };
    let root = Place::Root;
    let place = root.key("splats");
    splats.filter = wire.filter.unwrap_or(splats.filter);
    splats.blend = wire.blend.unwrap_or(splats.blend);
    splats.shading = wire.shading.unwrap_or(splats.shading);
    splats.prefilter = wire.prefilter.unwrap_or(splats.prefilter);
    for (key, number, low, high, value) in [
        ("lowpass", wire.lowpass, 0.1, 4.0, &mut splats.lowpass_px),
        ("cutoff", wire.cutoff, 0.5, 4.0, &mut splats.cutoff),
        ("width", wire.width, 0.01, 100.0, &mut splats.width),
        ("depth_offset", wire.depth_offset, 0.0, 100.0, &mut splats.depth_offset),
    ] {
        if let Some(number) = number {
            *value = within(number, low, high, place.key(key))? as f32;
        }
    }
    Ok(splats)
}

/// A box with room inside along at least one axis.
pub(super) fn subject([min, max]: [[f64; 3]; 2]) -> Valid<Bounds> {
    let root = Place::Root;
    let place = root.key("subject");
    let bounds =
        Bounds { min: coordinates(min, place.index(0))?, max: coordinates(max, place.index(1))? };
    if bounds.min.cmpgt(bounds.max).any() || bounds.min == bounds.max {
        return place.refuse(
            "the first corner must not exceed the second along any axis, and must differ from it",
        );
    }
    Ok(bounds)
}

pub(super) fn background(wire: Option<&ColorWire>) -> Valid<[f32; 4]> {
    let root = Place::Root;
    let default = ColorWire::Hex(DEFAULT_BACKGROUND.to_owned());
    Ok(to_linear(color(wire.unwrap_or(&default), root.key("background"))?))
}

/// sRGB with alpha.
pub(super) fn color(wire: &ColorWire, place: Place<'_>) -> Valid<[f64; 4]> {
    match wire {
        ColorWire::Hex(text) => match parse_hex(text) {
            Some(channels) => Ok(channels),
            None => place.refuse(format!(
                "`{text}` is no colour; accepted are #rgb, #rrggbb, #rrggbbaa and [r, g, b] in 0..=1"
            )),
        },
        &ColorWire::Rgb([r, g, b]) => {
            for (index, channel) in [r, g, b].into_iter().enumerate() {
                within(channel, 0.0, 1.0, place.index(index))?;
            }
            Ok([r, g, b, 1.0])
        }
    }
}

pub(super) fn rgb([r, g, b, _]: [f32; 4]) -> [f32; 3] {
    [r, g, b]
}

pub(super) fn camera(wire: &CameraWire, up: DVec3, place: Place<'_>) -> Valid<Camera> {
    pose(wire.eye, wire.target, wire.up, (wire.fov, wire.ortho_height), up, place)
}

fn pose(
    eye: [f64; 3],
    target: [f64; 3],
    own_up: Option<Up>,
    (fov, ortho_height): (Option<f64>, Option<f64>),
    scene_up: DVec3,
    place: Place<'_>,
) -> Valid<Camera> {
    if fov.is_some() && ortho_height.is_some() {
        return place.key("ortho_height").refuse("a camera has either `fov` or `ortho_height`");
    }
    let camera = Camera {
        eye: coordinates(eye, place.key("eye"))?,
        target: coordinates(target, place.key("target"))?,
        up: own_up.map_or(scene_up, |up| up.0),
        lens: Lens::given(fov, ortho_height)
            .unwrap_or(Lens::Perspective { fov_deg: DEFAULT_FOV_DEG }),
    };
    match camera.view(1, 1) {
        Ok(_) => Ok(camera),
        Err(error) => place.key(error.parameter).refuse(error.reason),
    }
}

pub(super) fn path(wire: &PathWire, up: DVec3, place: Place<'_>) -> Valid<CameraPath> {
    let fps = within(wire.fps.unwrap_or(30.0), PATH_FPS[0], PATH_FPS[1], place.key("fps"))?;
    let interpolation = wire.interpolation.unwrap_or_default();
    let ease = wire.ease.unwrap_or(interpolation.default_ease());
    let list = place.key("keys");
    if wire.keys.is_empty() {
        return list.refuse("needs at least one key");
    }
    let mut keys: Vec<PathKey> = Vec::with_capacity(wire.keys.len());
    for (index, key) in wire.keys.iter().enumerate() {
        let place = list.index(index);
        within(key.t, PATH_SECONDS[0], PATH_SECONDS[1], place.key("t"))?;
        if let Some(last) = keys.last()
            && key.t <= last.t
        {
            let (t, before) = (key.t, last.t);
            return place
                .key("t")
                .refuse(format!("{t} s must be later than the key before ({before} s)"));
        }
        let camera = pose(key.eye, key.target, key.up, (key.fov, key.ortho_height), up, place)?;
        if keys
            .first()
            .is_some_and(|first| first.camera.lens.projection() != camera.lens.projection())
        {
            let (name, _) = camera.lens.parameter();
            return place.key(name).refuse(
                "all keys of a path need one projection: `ortho_height` in all of them, or in none",
            );
        }
        keys.push(PathKey { t: key.t, camera, ease: key.ease.unwrap_or(ease) });
    }
    Ok(CameraPath { fps, interpolation, keys })
}

pub(super) fn world_up(wire: Option<Up>, place: Place<'_>) -> Valid<DVec3> {
    wire.map_or(Ok(DVec3::Y), |up| unit(up.0.into(), place))
}
