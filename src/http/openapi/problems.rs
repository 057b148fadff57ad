//! The problems that each operation may answer.

use super::super::problem::Kind::{self, *};

/// Settings of a frame.
const SETTINGS: &[Kind] = &[BadParameter, UnknownParameter, Unavailable];
/// A body in JSON.
const BODY: &[Kind] = &[RequestTimeout, BodyTooLarge, UnsupportedMediaType, BadBody];
/// A scene that is not in memory, and is loaded for the request.
const LOADED: &[Kind] = &[
    AssetRefused,
    SceneRefused,
    UnsupportedAsset,
    SceneTooLarge,
    LoadLost,
    OutOfGpuMemory,
    OutOfMemory,
    ShuttingDown,
];
/// A frame in the queue of the device.
const QUEUED: &[Kind] = &[OverLimit, Busy, DeadlineExceeded, FrameTimeout, DeviceLost];
/// A change of a scene in GPU memory.
const CHANGED: &[Kind] = &[OverLimit, DeviceLost, ShuttingDown, OutOfGpuMemory, OutOfMemory];
/// A job that exists.
const JOB: &[Kind] = &[JobsOff, UnknownJob];
/// A stored file of a job.
const JOB_FILE: &[Kind] = &[JobFileDamaged, RangeNotSatisfiable, OutOfDisk];

/// Lists the problems that an operation may answer, in any order and perhaps twice. Access and internal errors are added to all operations.
pub fn of_operation(path: &str, method: &str) -> Vec<Kind> {
    let groups: &[&[Kind]] = match (path, method) {
        ("/v1/scenes/{id}/frame", _) => {
            &[&[UnknownScene, SceneLoading, NotReady, NotAcceptable], SETTINGS, LOADED, QUEUED]
        }
        ("/v1/scenes/{id}/frames", _) => {
            &[&[UnknownScene, SceneLoading, NotReady], BODY, SETTINGS, LOADED]
        }
        ("/v1/scenes/{id}/compare", _) => {
            &[&[UnknownScene, SceneLoading, NotReady, SceneChanged], BODY, SETTINGS, LOADED, QUEUED]
        }
        ("/v1/scenes/{id}/accuracy", "post") => &[
            &[UnknownScene, SceneLoading, NotReady, Measuring, BadParameter, UnknownParameter],
            &[OverLimit, SceneRefused, SceneTooLarge, OutOfMemory, ShuttingDown],
            BODY,
        ],
        ("/v1/scenes/{id}/accuracy" | "/v1/scenes/{id}/accuracy/cancel", _) => {
            &[&[UnknownScene, SceneLoading, NotReady, NotMeasured], LOADED]
        }
        ("/v1/scenes/{id}/pick", "get") => {
            &[&[UnknownScene, SceneLoading, NotReady], SETTINGS, LOADED, QUEUED]
        }
        ("/v1/scenes/{id}/pick", _) => {
            &[&[UnknownScene, SceneLoading, NotReady], BODY, SETTINGS, LOADED, QUEUED]
        }
        ("/v1/scenes/{id}/stream", _) => {
            &[&[UnknownScene, SceneLoading, NotReady, UpgradeRequired], SETTINGS]
        }
        ("/v1/scenes/{id}/mjpeg", _) => &[
            &[UnknownScene, SceneLoading, NotReady, OverLimit, Busy, FrameTimeout, DeviceLost],
            SETTINGS,
            LOADED,
        ],
        ("/v1/scenes/{id}/paths/{name}", _) => {
            &[&[UnknownScene, UnknownPath, SceneLoading, NotReady]]
        }
        ("/viewer/{file}", _) => &[&[UnknownRoute]],
        ("/v1/scenes", "post") => &[
            &[UploadsOff, SceneExists, SceneTooLarge, UnsupportedAsset, BadParameter],
            &[UnknownParameter, AssetRefused, SceneRefused, LoadCancelled, TooManyScenes],
            &[OutOfDisk, UploadQuota],
            BODY,
            CHANGED,
        ],
        ("/v1/scenes/{id}/retry", _) => &[
            &[UnknownScene, SceneExists, SceneLoading, OverLimit, LoadCancelled, OutOfDisk],
            LOADED,
        ],
        ("/v1/scenes/{id}", "delete") => {
            &[&[UnknownScene, SceneLoading, NotReady, UploadsOff, OutOfDisk]]
        }
        ("/v1/scenes/{id}", _) => &[&[UnknownScene]],
        ("/v1/scenes/{id}/nodes/{node}", _) => &[
            &[UnknownScene, UnknownNode, SceneLoading, NotReady, BadParameter, UnknownParameter],
            BODY,
            CHANGED,
        ],
        ("/v1/jobs", "post") => &[
            &[JobsOff, UnknownScene, SceneLoading, NotReady, OverLimit, KeyReused, TooManyJobs],
            &[ShuttingDown, OutOfGpuMemory, OutOfJobDisk, OutOfDisk],
            BODY,
            SETTINGS,
        ],
        ("/v1/jobs", _) => &[&[JobsOff]],
        ("/v1/jobs/{id}", "get") => &[JOB],
        ("/v1/jobs/{id}" | "/v1/jobs/{id}/frames", _) => &[JOB, &[OutOfDisk]],
        ("/v1/jobs/{id}/cancel", _) => &[JOB, &[JobState, OutOfDisk]],
        ("/v1/jobs/{id}/resume", _) => &[JOB, &[JobState, TooManyJobs, OutOfJobDisk, OutOfDisk]],
        ("/v1/jobs/{id}/events", _) => &[JOB, &[Busy]],
        ("/v1/jobs/{id}/frames/{n}", _) => &[JOB, JOB_FILE, &[UnknownFrame, FrameNotDrawn]],
        ("/v1/jobs/{id}/multipart", _) => {
            &[JOB, &[UnknownFrame, BadParameter, UnknownParameter, Busy]]
        }
        ("/v1/jobs/{id}/video.mp4", _) => &[JOB, JOB_FILE, &[NoVideo]],
        ("/healthz" | "/readyz", _) => &[&[NotReady]],
        _ => &[],
    };
    groups.concat()
}
