//! Settings of effects that scenes ask for.

use clap::ValueEnum;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::{Exposure, Settings};
use crate::scene::{Tone, ToneMap};

/// Whether an effect is drawn that the scene asks for.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema, ValueEnum,
)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
#[schema(as = SceneEffect)]
pub enum Effect {
    /// As the scene file describes it
    #[default]
    On,
    /// Left out
    Off,
}

impl Settings {
    /// How light becomes colours; `None` where colours are the light.
    pub fn tone(&self) -> Option<Tone> {
        let (map, exposure) = (self.tone_map, self.exposure);
        let is_plain = map == ToneMap::None && exposure == Exposure::default();
        (!is_plain).then(|| Tone { map, stops: exposure.get().into() })
    }
}
