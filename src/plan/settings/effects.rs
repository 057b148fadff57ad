//! Settings of effects that scenes ask for.

use super::{Exposure, Settings};
use crate::scene::{Tone, ToneMap};
use crate::words::words;

words! {
    /// Whether an effect is drawn that the scene asks for.
    #[schema(as = SceneEffect)]
    pub enum Effect {
        /// As the scene file describes it
        #[default]
        On,
        /// Left out
        Off,
    }
}

impl Settings {
    /// How light becomes colours; `None` where colours are the light.
    pub fn tone(&self) -> Option<Tone> {
        let (map, exposure) = (self.tone_map, self.exposure);
        let is_plain = map == ToneMap::None && exposure == Exposure::default();
        (!is_plain).then(|| Tone { map, stops: exposure.get().into() })
    }
}
