//! The contract, generated from the handlers and wire types.
//!
//! Handlers document their successes; which problems each operation answers stands in one table
//! here, so that every status, with the `type`s behind it, is in the document. `openapi.yaml` at
//! the root of the repository is this document; a test holds the two equal.

use std::collections::BTreeMap;

use utoipa::openapi::path::Operation;
use utoipa::openapi::security::{Http, HttpAuthScheme, SecurityRequirement, SecurityScheme};
use utoipa::openapi::{ContentBuilder, Ref, RefOr, ResponseBuilder};
use utoipa::{Modify, OpenApi};

use super::access;
use super::problem::{Kind, PROBLEM_JSON, ProblemDocument};
use super::{frame, frames, jobs, mjpeg, paths, scenes, service, stream, upload, viewer};
use crate::engine::Receipt;

#[derive(OpenApi)]
#[openapi(
    info(
        title = "Pointillist",
        description = "A headless render server: a camera pose goes in, a frame and its receipt come out.\n\n\
            Every failure is `application/problem+json` with a stable `type`. Nothing is silently clamped: \
            what cannot be used is refused, with what would be accepted.\n\n\
            Every answer has `X-Request-Id`: the request's own, if that is 1 to 128 letters, digits and `-_.:/+=@~`, or a new one. \
            Receipts and problems repeat it as `request_id`, and with `POINTILLIST_LOG=pointillist=debug` the log tells a frame's \
            whole way by it.",
        license(name = "MIT OR Apache-2.0", identifier = "MIT OR Apache-2.0"),
    ),
    paths(
        frame::frame,
        frames::frames,
        stream::stream,
        mjpeg::mjpeg,
        scenes::list,
        upload::create,
        scenes::show,
        scenes::remove,
        scenes::patch_node,
        paths::show,
        jobs::list,
        jobs::create::create,
        jobs::show,
        jobs::remove,
        jobs::cancel,
        jobs::resume,
        jobs::events::events,
        jobs::frames::manifest,
        jobs::frames::frame,
        jobs::frames::multipart,
        jobs::video::video,
        service::limits,
        service::scene_schema,
        service::healthz,
        service::readyz,
        service::metrics,
        service::openapi,
        viewer::page,
        viewer::file,
    ),
    components(schemas(Receipt, ProblemDocument, stream::FrameHeader, stream::PoseFields)),
    tags(
        (name = "frames", description = "Images of scenes"),
        (name = "scenes", description = "What can be drawn"),
        (name = "jobs", description = "Camera paths, drawn without anybody waiting"),
        (name = "service", description = "The server itself"),
    ),
    modifiers(&Problems, &Keys),
)]
struct Contract;

/// The contract as a document.
pub fn document() -> utoipa::openapi::OpenApi {
    Contract::openapi()
}

/// The contract as `openapi.yaml` has it.
///
/// # Errors
/// None that the types allow; the serialiser's, if any.
pub fn openapi_yaml() -> anyhow::Result<String> {
    let yaml = document().to_yaml()?;
    Ok(format!(
        "# Generated from the code by `pointillist openapi`; a test holds it equal.\n{yaml}"
    ))
}

/// The contract as JSON.
///
/// # Errors
/// None that the types allow; the serialiser's, if any.
pub fn openapi_json() -> anyhow::Result<serde_json::Value> {
    Ok(serde_json::to_value(document())?)
}

/// What each operation may answer beside its successes; access and internal errors are added to all.
fn problems(path: &str, method: &str) -> &'static [Kind] {
    use Kind::*;
    match (path, method) {
        ("/v1/scenes/{id}/frame", _) => &[
            UnknownScene,
            SceneLoading,
            NotAcceptable,
            BadParameter,
            UnknownParameter,
            Unavailable,
            OverLimit,
            AssetRefused,
            SceneRefused,
            UnsupportedAsset,
            SceneTooLarge,
            Busy,
            DeadlineExceeded,
            FrameTimeout,
            DeviceLost,
            ShuttingDown,
            OutOfGpuMemory,
            OutOfMemory,
        ],
        ("/v1/scenes/{id}/frames", _) => &[
            UnknownScene,
            SceneLoading,
            RequestTimeout,
            BodyTooLarge,
            UnsupportedMediaType,
            BadParameter,
            UnknownParameter,
            Unavailable,
            BadBody,
            AssetRefused,
            SceneRefused,
            UnsupportedAsset,
            SceneTooLarge,
            OutOfGpuMemory,
            OutOfMemory,
            ShuttingDown,
        ],
        ("/v1/scenes/{id}/stream", _) => &[
            UnknownScene,
            SceneLoading,
            UpgradeRequired,
            BadParameter,
            UnknownParameter,
            Unavailable,
        ],
        ("/v1/scenes/{id}/mjpeg", _) => &[
            UnknownScene,
            SceneLoading,
            BadParameter,
            UnknownParameter,
            Unavailable,
            OverLimit,
            AssetRefused,
            SceneRefused,
            UnsupportedAsset,
            SceneTooLarge,
            Busy,
            FrameTimeout,
            DeviceLost,
            ShuttingDown,
            OutOfGpuMemory,
            OutOfMemory,
        ],
        ("/v1/scenes/{id}/paths/{name}", _) => &[UnknownScene, UnknownPath, SceneLoading],
        ("/viewer/{file}", _) => &[UnknownRoute],
        ("/v1/scenes", "post") => &[
            UploadsOff,
            RequestTimeout,
            SceneExists,
            BodyTooLarge,
            SceneTooLarge,
            UnsupportedMediaType,
            UnsupportedAsset,
            BadParameter,
            UnknownParameter,
            BadBody,
            OverLimit,
            AssetRefused,
            SceneRefused,
            LoadCancelled,
            TooManyScenes,
            DeviceLost,
            ShuttingDown,
            OutOfGpuMemory,
            OutOfMemory,
            OutOfDisk,
            UploadQuota,
        ],
        ("/v1/scenes/{id}", "delete") => &[UnknownScene, SceneLoading],
        ("/v1/scenes/{id}", _) => &[UnknownScene],
        ("/v1/scenes/{id}/nodes/{node}", _) => &[
            UnknownScene,
            UnknownNode,
            SceneLoading,
            RequestTimeout,
            BodyTooLarge,
            UnsupportedMediaType,
            BadParameter,
            UnknownParameter,
            BadBody,
            OverLimit,
            DeviceLost,
            ShuttingDown,
            OutOfGpuMemory,
            OutOfMemory,
        ],
        ("/v1/jobs", "post") => &[
            JobsOff,
            UnknownScene,
            SceneLoading,
            RequestTimeout,
            BodyTooLarge,
            UnsupportedMediaType,
            BadParameter,
            UnknownParameter,
            Unavailable,
            BadBody,
            OverLimit,
            KeyReused,
            TooManyJobs,
            ShuttingDown,
            OutOfGpuMemory,
            OutOfJobDisk,
            OutOfDisk,
        ],
        ("/v1/jobs", _) => &[JobsOff],
        ("/v1/jobs/{id}", "get") => &[JobsOff, UnknownJob],
        ("/v1/jobs/{id}", _) => &[JobsOff, UnknownJob, OutOfDisk],
        ("/v1/jobs/{id}/cancel", _) => &[JobsOff, UnknownJob, JobState, OutOfDisk],
        ("/v1/jobs/{id}/resume", _) => {
            &[JobsOff, UnknownJob, JobState, TooManyJobs, OutOfJobDisk, OutOfDisk]
        }
        ("/v1/jobs/{id}/events", _) => &[JobsOff, UnknownJob, Busy],
        ("/v1/jobs/{id}/frames", _) => &[JobsOff, UnknownJob, OutOfDisk],
        ("/v1/jobs/{id}/frames/{n}", _) => &[
            JobsOff,
            UnknownJob,
            UnknownFrame,
            FrameNotDrawn,
            JobFileDamaged,
            RangeNotSatisfiable,
            OutOfDisk,
        ],
        ("/v1/jobs/{id}/multipart", _) => {
            &[JobsOff, UnknownJob, UnknownFrame, BadParameter, UnknownParameter, Busy]
        }
        ("/v1/jobs/{id}/video.mp4", _) => {
            &[JobsOff, UnknownJob, NoVideo, JobFileDamaged, RangeNotSatisfiable, OutOfDisk]
        }
        ("/healthz" | "/readyz", _) => &[NotReady],
        _ => &[],
    }
}

struct Problems;

impl Modify for Problems {
    fn modify(&self, openapi: &mut utoipa::openapi::OpenApi) {
        each_operation(openapi, |path, method, operation| {
            let mut kinds = problems(path, method).to_vec();
            kinds.extend([Kind::WrongHost, Kind::Internal]);
            let verb = axum::http::Method::from_bytes(method.to_uppercase().as_bytes());
            match access::needed(&verb.unwrap_or_default(), path) {
                None => {}
                Some(access::Scope::Read) => kinds.extend([Kind::Unauthorized, Kind::Forbidden]),
                Some(_) => kinds.extend([Kind::Unauthorized, Kind::Forbidden]),
            }
            let mut by_status: BTreeMap<u16, Vec<Kind>> = BTreeMap::new();
            for kind in kinds {
                by_status.entry(kind.facts().0).or_default().push(kind);
            }
            for (status, kinds) in by_status {
                operation.responses.responses.insert(status.to_string(), answer(&kinds));
            }
        });
    }
}

fn answer(kinds: &[Kind]) -> RefOr<utoipa::openapi::Response> {
    let lines: Vec<String> = kinds
        .iter()
        .map(|kind| {
            let (_, urn, title) = kind.facts();
            format!("{title} (`{urn}`)")
        })
        .collect();
    let schema = RefOr::Ref(Ref::from_schema_name("Problem"));
    let content = ContentBuilder::new().schema(Some(schema)).build();
    RefOr::T(
        ResponseBuilder::new().description(lines.join("; ")).content(PROBLEM_JSON, content).build(),
    )
}

/// API keys, for every operation that may need one.
struct Keys;

impl Modify for Keys {
    fn modify(&self, openapi: &mut utoipa::openapi::OpenApi) {
        let mut http = Http::new(HttpAuthScheme::Bearer);
        http.description = Some(
            "An API key, where the server asks for one: not on loopback by default, where only requests \
             to `localhost` and loopback addresses are answered"
                .to_owned(),
        );
        let components = openapi.components.get_or_insert_with(Default::default);
        components.add_security_scheme("key", SecurityScheme::Http(http));
        each_operation(openapi, |path, method, operation| {
            let verb = axum::http::Method::from_bytes(method.to_uppercase().as_bytes());
            if let Some(scope) = access::needed(&verb.unwrap_or_default(), path) {
                let scope = format!("{scope:?}").to_lowercase();
                operation.security = Some(vec![
                    SecurityRequirement::default(),
                    SecurityRequirement::new("key", [scope]),
                ]);
            }
        });
    }
}

fn each_operation(
    openapi: &mut utoipa::openapi::OpenApi,
    mut change: impl FnMut(&str, &str, &mut Operation),
) {
    for (path, item) in &mut openapi.paths.paths {
        for (method, operation) in [
            ("get", &mut item.get),
            ("post", &mut item.post),
            ("patch", &mut item.patch),
            ("delete", &mut item.delete),
        ] {
            if let Some(operation) = operation {
                change(path, method, operation);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_file_is_what_the_code_says() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/openapi.yaml");
        let yaml = openapi_yaml().unwrap();
        if std::env::var_os("UPDATE").is_some() {
            std::fs::write(path, &yaml).unwrap();
        }
        let file = std::fs::read_to_string(path).unwrap();
        assert!(
            file == yaml,
            "openapi.yaml differs from the code; run the test with UPDATE=1 and look at the change"
        );
    }

    #[test]
    fn every_route_is_in_the_document() {
        let paths = document().paths.paths;
        for route in crate::http::ROUTES.iter().filter(|route| route.starts_with('/')) {
            assert!(paths.contains_key(*route), "{route}");
        }
        assert_eq!(paths.len(), crate::http::ROUTES.len() - 1);
    }

    #[test]
    fn every_kind_of_problem_is_in_the_document() {
        let text = openapi_yaml().unwrap();
        for kind in Kind::ALL {
            // What no operation is behind cannot be documented with one.
            let (_, urn, _) = kind.facts();
            // What only a job's `error` can be stands there, without what all have in common.
            let short = urn.rsplit(':').next().unwrap();
            if kind != Kind::MethodNotAllowed {
                assert!(text.contains(urn) || text.contains(&format!("`{short}`")), "{kind:?}");
            }
        }
    }
}
