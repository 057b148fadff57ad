//! Errors of the engine.

use std::sync::Arc;
use std::time::Duration;

use crate::assets::AssetError;
use crate::bake::assemble::AssembleError;
use crate::memory::Interrupt;
use crate::scene::SceneError;

/// Errors in words that a user can act on. Knows nothing of HTTP.
#[derive(Debug, Clone, thiserror::Error)]
pub enum EngineError {
    #[error("there is no scene `{id}`")]
    UnknownScene { id: String },
    #[error("there is no node `{node}` in scene `{scene}`")]
    UnknownNode { scene: String, node: String },
    /// A parameter that cannot be used; `accepted` says what would be accepted.
    #[error("{parameter}: {reason}; accepted: {accepted}")]
    BadParameter { parameter: &'static str, reason: String, accepted: String },
    #[error("a scene `{id}` is already loaded")]
    SceneExists { id: String },
    #[error("the queue is full")]
    Busy { retry_after: Duration },
    /// A newer request replaced this request of a [`super::LatestSlot`].
    #[error("a newer request took this one's place")]
    Overtaken,
    /// The deadline has passed, or will pass given what is queued before the frame and what such frames have cost.
    #[error("the deadline passes before the frame can be had")]
    DeadlineExceeded { retry_after: Duration },
    #[error("the GPU was lost; scenes are being rebuilt")]
    DeviceLost { retry_after: Duration },
    #[error("shutting down")]
    ShuttingDown,
    #[error("{what} needs {needed} bytes on the GPU, the budget is {budget}")]
    OutOfGpuMemory { what: String, needed: u64, budget: u64 },
    #[error("{what} take {needed} bytes, of which this adapter binds {limit} at once")]
    OverBinding { what: &'static str, needed: u64, limit: u64 },
    /// A limit of [`super::Limits`] was exceeded, by `parameter` of a request where one alone is too large.
    #[error("{found} is more than the limit of {limit} {what}")]
    OverLimit { what: &'static str, found: u64, limit: u64, parameter: Option<&'static str> },
    /// A load was cancelled, or there is not enough host memory for it.
    #[error(transparent)]
    Interrupted(#[from] Interrupt),
    #[error("{0}")]
    Asset(Arc<AssetError>),
    #[error("{0}")]
    Scene(Arc<SceneError>),
    /// No adapter can draw; the text says what to install.
    #[error("{0}")]
    NoGpu(String),
    #[error("internal error: {0}")]
    Internal(String),
}

pub fn asset_error(error: AssetError) -> EngineError {
    match error {
        AssetError::Interrupted(interrupt) => interrupt.into(),
        error => EngineError::Asset(Arc::new(error)),
    }
}

pub fn scene_error(error: SceneError) -> EngineError {
    match error {
        SceneError::Interrupted(interrupt) => interrupt.into(),
        error => EngineError::Scene(Arc::new(error)),
    }
}

impl From<AssembleError> for EngineError {
    fn from(error: AssembleError) -> Self {
        match error {
            AssembleError::Asset(error) => asset_error(error),
            AssembleError::Interrupted(interrupt) => interrupt.into(),
            AssembleError::Scene(error) => scene_error(error),
        }
    }
}
