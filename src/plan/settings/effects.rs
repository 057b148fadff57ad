//! Settings of effects that scenes ask for.

use clap::ValueEnum;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

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
