//! Effects that the renderer and the oracle draw alike.

use std::path::PathBuf;

use glam::{DMat3, DVec3};

use crate::words::words;

/// Samples as discs that face the image plane, each at its own depth. Of the two diameters the larger one in the image counts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Discs {
    pub diameter_px: f32,
    /// In scene units; the discs shrink with distance.
    pub diameter: f32,
}

/// Eye-dome lighting (Boucheny 2009, §4): depths of neighbouring pixels darken what lies behind them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EyeDome {
    pub strength: f32,
    /// Distance of the neighbours, in pixels.
    pub radius_px: f32,
}

/// Fog: light of a surface is absorbed exponentially with the length of its way through the fog (Beer–Lambert), and the fog's own light takes its place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fog {
    /// Linear RGB of what is infinitely far within it.
    pub color: [f32; 3],
    /// Extinction for each scene unit, above 0; at [`FogLayer::base`], where there is a layer.
    pub density: f64,
    /// How it becomes thinner with height; `None` for fog that is as dense everywhere.
    pub layer: Option<FogLayer>,
}

/// Fog that becomes thinner with height: the density falls by a factor of e with every `scale`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FogLayer {
    /// The scene's up direction, of unit length.
    pub up: DVec3,
    /// Height along `up` at which the fog has its density.
    pub base: f64,
    /// Scale height, in scene units.
    pub scale: f64,
}

/// Ambient occlusion: ambient light does not reach the part of a surface's surroundings that other surfaces fill within a radius.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AmbientOcclusion {
    /// Distance in scene units within which surfaces hide ambient light.
    pub radius: f64,
    /// Share of the hidden light that is taken away, above 0 and up to 1.
    pub strength: f64,
}

/// An image of a scene's surroundings, infinitely far away: its light falls on surfaces from all directions.
#[derive(Clone, Debug, PartialEq)]
pub struct Environment {
    pub image: EnvironmentSource,
    /// Factor of its light, above 0.
    pub strength: f64,
    /// Turns directions of the world to those of the image: `+y` is its upper edge, `-z` its centre, and `+x` lies right of the centre.
    pub image_from_world: DMat3,
    /// Pixels that nothing covers show it.
    pub shown: bool,
}

/// Where an image of surroundings comes from.
#[derive(Clone, Debug, PartialEq)]
pub enum EnvironmentSource {
    /// An equirectangular image; absolute, inside the scene root.
    File(PathBuf),
    /// A photographer's studio ([`crate::generate::studio`]).
    Studio,
}

impl Environment {
    /// The surroundings of a bare file with metals, which would have nothing to reflect without them.
    pub fn studio(up: DVec3) -> Environment {
        Environment {
            image: EnvironmentSource::Studio,
            strength: 1.0,
            image_from_world: Environment::image_from_world(up, 0.0),
            shown: false,
        }
    }

    /// [`Environment::image_from_world`] of an image whose upper edge is up, and that is turned by an angle in degrees about that direction.
    pub fn image_from_world(up: DVec3, turn_deg: f64) -> DMat3 {
        // The shortest way from the image's up to the scene's, about x where they are opposite.
        let axis = DVec3::Y.cross(up).try_normalize().unwrap_or(DVec3::X);
        let upright = DMat3::from_axis_angle(axis, DVec3::Y.dot(up).clamp(-1.0, 1.0).acos());
        let turn = DMat3::from_rotation_y(turn_deg.rem_euclid(360.0).to_radians());
        (upright * turn).transpose()
    }
}

words! {
    /// How light of any strength becomes a colour that can be shown.
    pub enum ToneMap {
        /// As it is; what is brighter than white is white
        #[default]
        None,
        /// Colours stay what they are, and highlights are compressed and become white (Khronos PBR Neutral)
        Neutral,
        /// As film: more contrast, and colours that fade where they are bright (ACES, as fitted by Hill)
        Aces,
    }
}

/// Exposure and tone mapping of the light that surfaces reflect and give off.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tone {
    pub map: ToneMap,
    /// Each doubles the light before it is mapped.
    pub stops: f64,
}
