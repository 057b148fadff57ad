//! Jobs in, encoded frames with receipts out (floor 5). One thread owns the device.

pub mod receipt;
mod request;

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use serde::Serialize;

pub use receipt::Receipt;
pub use request::{FrameRequest, Pose};

use crate::assets::{AssetError, ReadOptions};
use crate::math::Camera;
use crate::scene::{SceneError, SceneLimits};

/// How the engine is set up.
#[derive(Clone)]
pub struct EngineConfig {
    /// Scenes and the files they name are read below this folder only.
    pub root: PathBuf,
    /// Bytes of scene data that may stay on the GPU; `None`: three quarters of what the adapter can bind, at most 4 GiB.
    pub gpu_budget_bytes: Option<u64>,
    /// Jobs that may wait; more are refused with [`EngineError::Busy`].
    pub queue_capacity: usize,
    /// Frames recorded into one submission.
    pub max_batch: usize,
    pub encoder_threads: usize,
    /// Width · height of one frame.
    pub max_pixels: u64,
    /// Longest side of a frame.
    pub max_side: u32,
    /// Never use 64-bit atomics, even where the adapter has them.
    pub force_32_bit: bool,
    pub read: ReadOptions,
    pub scene: SceneLimits,
}

/// What can go wrong, in words that a user can act on. Knows nothing of HTTP.
#[derive(Debug, Clone, thiserror::Error)]
pub enum EngineError {
    #[error("there is no scene `{id}`")]
    UnknownScene { id: String },
    #[error("there is no node `{node}` in scene `{scene}`")]
    UnknownNode { scene: String, node: String },
    /// A parameter that cannot be used; `accepted` says what would be.
    #[error("{parameter}: {reason}; accepted: {accepted}")]
    BadParameter { parameter: &'static str, reason: String, accepted: String },
    #[error("a scene `{id}` is already loaded")]
    SceneExists { id: String },
    #[error("the queue is full")]
    Busy { retry_after: Duration },
    #[error("the deadline passed before the frame was begun")]
    DeadlineExceeded,
    #[error("the GPU was lost; scenes are being rebuilt")]
    DeviceLost { retry_after: Duration },
    #[error("shutting down")]
    ShuttingDown,
    #[error("{what} needs {needed} bytes on the GPU, the budget is {budget}")]
    OutOfGpuMemory { what: String, needed: u64, budget: u64 },
    /// A limit of [`Limits`] was exceeded.
    #[error("{what} ({found}) is over the limit of {limit}")]
    OverLimit { what: &'static str, found: u64, limit: u64 },
    #[error("{0}")]
    Asset(#[source] Arc<AssetError>),
    #[error("{0}")]
    Scene(#[source] Arc<SceneError>),
    #[error("internal error: {0}")]
    Internal(String),
}

/// What `GET /v1/limits` lists.
#[derive(Clone, Debug, Serialize, utoipa::ToSchema)]
pub struct Limits {
    pub max_pixels: u64,
    pub max_side: u32,
    pub queue_capacity: usize,
    pub max_batch: usize,
    pub gpu_budget_bytes: u64,
    pub max_vertices: u64,
    pub max_triangles: u64,
    pub max_texels: u64,
    pub max_decompressed_bytes: u64,
    pub max_nodes: u64,
    pub max_depth: u32,
    pub max_instances: u64,
    pub max_json_bytes: u64,
}

/// A loaded scene as callers see it.
#[derive(Clone, Debug, Serialize, utoipa::ToSchema)]
pub struct SceneInfo {
    pub id: String,
    pub name: String,
    /// Grows with every change.
    pub revision: u64,
    /// World-space box: min and max corner, `null` when empty.
    pub bounds: Option<[[f64; 3]; 2]>,
    pub samples: u64,
    pub triangles: u64,
    pub instances: u64,
    pub assets: Vec<AssetInfo>,
    /// Bytes that the scene needs on the GPU, and whether it is there now.
    pub gpu_bytes: u64,
    pub resident: bool,
    pub cameras: Vec<NamedCamera>,
    pub paths: Vec<String>,
    /// Names of top-level nodes, as `PATCH` takes them.
    pub nodes: Vec<String>,
    pub lights: usize,
    pub warnings: Vec<String>,
}

#[derive(Clone, Debug, Serialize, utoipa::ToSchema)]
pub struct AssetInfo {
    pub name: String,
    pub format: &'static str,
    pub samples: u64,
    pub triangles: u64,
    pub has_colors: bool,
    pub has_normals: bool,
    /// Normals were not in the file and come from the neighbourhood.
    pub normals_estimated: bool,
}

#[derive(Clone, Debug, Serialize, utoipa::ToSchema)]
pub struct NamedCamera {
    pub name: String,
    pub eye: [f64; 3],
    pub target: [f64; 3],
    pub up: [f64; 3],
    pub fov: f64,
}

impl NamedCamera {
    pub fn new(name: &str, camera: &Camera) -> Self {
        Self {
            name: name.to_owned(),
            eye: camera.eye.into(),
            target: camera.target.into(),
            up: camera.up.into(),
            fov: camera.fov_deg,
        }
    }
}

/// Changes to one top-level node; `None` leaves a property as it is.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct NodePatch {
    pub world_from_node: Option<glam::DAffine3>,
    pub visible: Option<bool>,
}

/// A finished frame.
#[derive(Clone, Debug)]
pub struct EncodedFrame {
    pub bytes: Bytes,
    pub content_type: &'static str,
    pub receipt: Receipt,
}

/// Whether frames can be had now, and if not, why.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Readiness {
    Ready,
    Starting,
    Stalled { for_ms: u64 },
    DeviceLost,
    Draining,
}

/// Counters for `/metrics`, cumulative since the start.
#[derive(Clone, Debug, Default)]
pub struct EngineStats {
    pub frames: u64,
    pub batches: u64,
    pub coalesced: u64,
    pub cancelled: u64,
    pub expired: u64,
    pub refused: u64,
    pub failed: u64,
    pub queued: u64,
    pub device_losses: u64,
    pub evictions: u64,
    pub uploads: u64,
    pub gpu_bytes_resident: u64,
    pub gpu_ns: u64,
    pub encode_ns: u64,
}

/// A handle on the running engine; clones share it. The last one dropped stops the render thread
/// after the jobs it has accepted.
#[derive(Clone)]
pub struct Engine {}

/// A frame that has been promised. Await it; dropping it cancels the job unless somebody else waits
/// for the same frame or it has been submitted already.
pub struct FrameTicket {
    receiver: tokio::sync::oneshot::Receiver<Result<Arc<EncodedFrame>, EngineError>>,
}

impl std::future::Future for FrameTicket {
    type Output = Result<Arc<EncodedFrame>, EngineError>;

    fn poll(
        mut self: std::pin::Pin<&mut Self>,
        context: &mut std::task::Context<'_>,
    ) -> std::task::Poll<Self::Output> {
        std::pin::Pin::new(&mut self.receiver)
            .poll(context)
            .map(|result| result.unwrap_or(Err(EngineError::ShuttingDown)))
    }
}

impl Engine {
    /// Finds an adapter and starts the render thread and the encoders.
    ///
    /// # Errors
    /// No adapter, or one that lacks what the passes need; the message says what to install.
    pub fn start(config: EngineConfig) -> Result<Engine, EngineError> {
        let _ = config;
        Err(EngineError::Internal("not built yet".into()))
    }

    /// Loads a scene file or a single asset file (absolute path below the root) under `id`. Blocks: reads, bakes, checks the
    /// budget; call from a blocking thread. Fails without side effects.
    pub fn load(&self, id: &str, path: &std::path::Path) -> Result<SceneInfo, EngineError> {
        let _ = (id, path);
        unreachable!()
    }

    /// Forgets a scene and frees its GPU memory.
    pub fn remove(&self, id: &str) -> Result<(), EngineError> {
        let _ = id;
        unreachable!()
    }

    /// Moves, shows or hides a top-level node: a new revision, nothing uploaded but transforms.
    pub fn patch(&self, id: &str, node: &str, patch: &NodePatch) -> Result<SceneInfo, EngineError> {
        let _ = (id, node, patch);
        unreachable!()
    }

    pub fn scenes(&self) -> Vec<SceneInfo> {
        unreachable!()
    }

    pub fn scene(&self, id: &str) -> Result<SceneInfo, EngineError> {
        let _ = id;
        unreachable!()
    }

    /// The strong entity tag (quoted) of the frame that `request` would give. Validates the request; costs no GPU work.
    pub fn etag(&self, request: &FrameRequest) -> Result<String, EngineError> {
        let _ = request;
        unreachable!()
    }

    /// Queues a frame.
    ///
    /// # Errors
    /// Whatever is wrong with the request, or [`EngineError::Busy`]; nothing is queued then.
    pub fn submit(&self, request: FrameRequest) -> Result<FrameTicket, EngineError> {
        let _ = request;
        unreachable!()
    }

    pub fn readiness(&self) -> Readiness {
        unreachable!()
    }

    pub fn stats(&self) -> EngineStats {
        unreachable!()
    }

    pub fn limits(&self) -> Limits {
        unreachable!()
    }

    /// Name of the adapter, as receipts give it.
    pub fn adapter(&self) -> String {
        unreachable!()
    }

    /// Refuses new jobs, finishes the accepted ones. Blocks.
    pub fn drain(&self) {}
}
