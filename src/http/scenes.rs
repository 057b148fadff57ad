//! Handlers for loaded scenes: list, show, move a node, remove.

use std::sync::Arc;
use std::time::Duration;

use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use axum::{Extension, Json};
use glam::{DAffine3, DMat3, DMat4, DQuat, DVec3, EulerRot};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::limits::Standing;
use super::params::unknown_name;
use super::problem::{Kind, Problem, storage};
use super::registry::{Ended, Reservation, SceneState};
use super::{App, Caller, NoQuery, Owner, Segments, body, frame, upload};
use crate::engine::{EngineError, NodePatch};
use crate::json;
use crate::scene::{LARGEST_COORDINATE, LARGEST_SCALE};

#[derive(Serialize, ToSchema)]
pub struct SceneList {
    scenes: Vec<SceneState>,
}

/// All scenes, including those that are loading or failed to load.
#[utoipa::path(
    get,
    path = "/v1/scenes",
    operation_id = "listScenes",
    tag = "scenes",
    responses((status = 200, description = "The scenes", body = SceneList)),
)]
pub async fn list(State(app): State<Arc<App>>, _: NoQuery) -> Json<SceneList> {
    let entries = app.registry.list();
    let mut scenes: Vec<SceneState> =
        app.engine.scenes().into_iter().map(|info| SceneState::Ready(Box::new(info))).collect();
    // A scene that is being removed, or has just been loaded, is in both.
    let others = entries.into_iter().filter(|(id, _)| app.engine.load_number(id).is_none());
    scenes.extend(others.filter_map(|(id, entry)| SceneState::of(id, entry)));
    Json(SceneList { scenes })
}

/// A scene: revision, bounds, counts, GPU bytes, cameras and paths.
#[utoipa::path(
    get,
    path = "/v1/scenes/{id}",
    operation_id = "getScene",
    tag = "scenes",
    params(("id" = String, Path, description = "The scene")),
    responses((status = 200, description = "The scene, loading and failed ones included", body = SceneState)),
)]
pub async fn show(
    State(app): State<Arc<App>>,
    Segments(id): Segments<String>,
    _: NoQuery,
) -> Result<Json<SceneState>, Problem> {
    // Look up the registry first: a scene is in the engine before it leaves the registry.
    let entry = app.registry.get(&id);
    match app.engine.scene(&id) {
        Ok(info) => Ok(Json(SceneState::Ready(Box::new(info)))),
        Err(error) => match entry {
            Some(entry) => SceneState::of(id, entry).map(Json).ok_or_else(|| error.into()),
            None if upload::follow::is_coming(&app, &id) => {
                Ok(Json(SceneState::Loading { id, loading_ms: 0 }))
            }
            None => Err(error.into()),
        },
    }
}

/// Removes a scene: frees its memory, and deletes its files if it was uploaded. A load in progress is
/// cancelled. A scene of the server's root is loaded again when the server restarts. A key of scope write removes only scenes that
/// it uploaded.
#[utoipa::path(
    delete,
    path = "/v1/scenes/{id}",
    operation_id = "deleteScene",
    tag = "scenes",
    params(("id" = String, Path, description = "The scene")),
    responses((status = 204, description = "The scene is removed")),
)]
pub async fn remove(
    State(app): State<Arc<App>>,
    Extension(owner): Extension<Owner>,
    Segments(id): Segments<String>,
    _: NoQuery,
) -> Result<StatusCode, Problem> {
    owner.check_scene(&app, &id)?;
    upload::follow::refuse_removal(&app, &id)?;
    let mut cancelled = None;
    if let Some(load) = app.registry.cancel(&id) {
        // The load's next step may take some seconds.
        let ended = tokio::time::timeout(LONGEST_STEP, load.clone().ended()).await;
        let ended = ended.map_err(|_| {
            let detail = format!("the load of scene `{id}` was cancelled and has not ended yet");
            Problem::new(Kind::SceneLoading, detail).retry_after(Duration::from_secs(5))
        })?;
        if ended == Ended::Gone {
            return Ok(StatusCode::NO_CONTENT);
        }
        cancelled = Some((load, ended));
    }
    let Some(claim) = app.registry.claim(&id, |id| app.engine.load_number(id)) else {
        let detail = format!("scene `{id}` is being loaded or removed");
        return Err(Problem::new(Kind::SceneLoading, detail).retry_after(Duration::from_secs(1)));
    };
    let found = claim.found();
    let is_meant = match &cancelled {
        None => true,
        Some((load, Ended::Failed)) => claim.is_failure_of(load),
        Some((_, ended)) => found == *ended,
    };
    if !is_meant {
        // The load to be removed has left the id to another one.
        return Ok(StatusCode::NO_CONTENT);
    }
    if found == Ended::Gone {
        drop(claim);
        let unknown = EngineError::UnknownScene { id: id.clone() };
        return Err(frame::missing(&app, &id, unknown.into()));
    }
    // While the load ended, the id may have got another owner.
    owner.check_scene(&app, &id)?;
    tokio::task::spawn_blocking(move || remove_claimed(&app, claim))
        .await
        .map_err(Problem::internal)?
}

/// Removes the scene of a claimed id: its files first, since a failure must leave everything as it was.
fn remove_claimed(app: &App, claim: Reservation) -> Result<StatusCode, Problem> {
    let id = claim.id();
    // Without uploads the folder of uploads may belong to another server.
    if app.settings.uploads.are_kept() {
        upload::store::remove_files(&app.settings.root, id).map_err(|error| storage(&error))?;
    }
    if let Ended::Loaded(_) = claim.found() {
        app.engine.remove(id)?;
    }
    app.uploads.forget(id);
    app.surveys.forget(id);
    claim.finish(Ended::Gone);
    Ok(StatusCode::NO_CONTENT)
}

/// Longest wait for a cancelled load to end.
const LONGEST_STEP: Duration = Duration::from_secs(30);

/// A new transform for a node, or its visibility. The transform is complete, as in a scene file: a missing
/// `translate`, `rotate` or `scale` is the identity. Without any of them, the node keeps its transform.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NodeChange {
    translate: Option<[f64; 3]>,
    /// XYZ Euler angles in degrees.
    rotate: Option<[f64; 3]>,
    /// x, y, z, w; normalised.
    quaternion: Option<[f64; 4]>,
    scale: Option<Scale>,
    /// Column-major 4×4 with last row `0 0 0 1`, instead of the others.
    matrix: Option<[f64; 16]>,
    visible: Option<bool>,
}

#[derive(Clone, Copy, Debug, PartialEq, Deserialize, ToSchema)]
#[serde(untagged)]
pub enum Scale {
    Uniform(f64),
    PerAxis([f64; 3]),
}

const CHANGE_KEYS: [&str; 6] = ["translate", "rotate", "quaternion", "scale", "matrix", "visible"];
const CHANGE_SYNONYMS: [(&str, &str); 3] =
    [("position", "translate"), ("transform", "matrix"), ("hidden", "visible")];
const MAX_CHANGE_BYTES: u64 = 64 << 10;

/// Moves, shows or hides a top-level node. The scene gets a new revision; no data is uploaded to the GPU again. The scene's
/// file does not change, so a restarted server begins with the file's values. A key of scope write changes only scenes that it
/// uploaded.
#[utoipa::path(
    patch,
    path = "/v1/scenes/{id}/nodes/{node}",
    operation_id = "changeNode",
    tag = "scenes",
    params(
        ("id" = String, Path, description = "The scene"),
        ("node" = String, Path, description = "A name that the scene lists under `nodes`"),
    ),
    request_body(content = NodeChange, content_type = "application/json"),
    responses((status = 200, description = "The scene with its new revision", body = SceneState)),
)]
pub async fn patch_node(
    State(app): State<Arc<App>>,
    Extension(Caller(client, caps)): Extension<Caller>,
    Extension(owner): Extension<Owner>,
    Segments((id, node)): Segments<(String, String)>,
    _: NoQuery,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    owner.check_scene(&app, &id)?;
    let patience = app.settings.read_timeout;
    let admission = app.engine.admission();
    let value: serde_json::Value =
        body::json(&headers, body, MAX_CHANGE_BYTES, patience, &admission).await?;
    let patch = node_change(value)?.patch()?;
    let turn = app.patches.turn(client).await?;
    // Bodies and turns take their time. Meanwhile the key may have been removed, or the id may belong to the scene of another key.
    if app.standing(client, &caps) == Standing::Gone {
        return Err(Problem::new(Kind::Unauthorized, "the key was removed or has expired"));
    }
    let load = app.engine.load_number(&id);
    owner.check_scene(&app, &id)?;
    let worker = app.clone();
    let scene = id.clone();
    let patched = tokio::task::spawn_blocking(move || {
        let unknown = || EngineError::UnknownScene { id: scene.clone() };
        let patched = worker.engine.patch_load(&scene, load.ok_or_else(unknown)?, &node, &patch);
        // The turn ends with the change, even if the client has gone.
        drop(turn);
        patched
    });
    let info = patched
        .await
        .map_err(Problem::internal)?
        .map_err(|error| frame::missing(&app, &id, error.into()))?;
    Ok(Json(SceneState::Ready(Box::new(info))).into_response())
}

pub(super) fn node_change(value: serde_json::Value) -> Result<NodeChange, Problem> {
    let keys = value.as_object().into_iter().flat_map(|object| object.keys());
    if let Some(name) = keys.into_iter().find(|name| !CHANGE_KEYS.contains(&name.as_str())) {
        return Err(unknown_name(name, &CHANGE_KEYS, &CHANGE_SYNONYMS));
    }
    serde_path_to_error::deserialize(value).map_err(|error| {
        let path = error.path().to_string();
        Problem::new(Kind::BadBody, format!("{path}: {}", json::plain(&error.inner().to_string())))
            .at(path)
    })
}

impl NodeChange {
    pub(super) fn patch(&self) -> Result<NodePatch, Problem> {
        if *self == NodeChange::default() {
            return Err(Problem::new(Kind::BadBody, "the body changes nothing")
                .accepted(CHANGE_KEYS.join(", ")));
        }
        Ok(NodePatch { world_from_node: self.transform()?, visible: self.visible })
    }

    fn transform(&self) -> Result<Option<DAffine3>, Problem> {
        let parts = self.translate.is_some()
            || self.rotate.is_some()
            || self.quaternion.is_some()
            || self.scale.is_some();
        if let Some(matrix) = self.matrix {
            if parts {
                return Err(Problem::parameter(
                    "matrix",
                    "cannot be given together with translate, rotate, quaternion or scale",
                    "either of the two",
                ));
            }
            let places = matrix.iter().skip(12).take(3);
            within(places, LARGEST_COORDINATE, "matrix")?;
            within(matrix.iter().take(12), LARGEST_SCALE, "matrix")?;
            return affine(DMat4::from_cols_array(&matrix)).map(Some);
        }
        if !parts {
            return Ok(None);
        }
        let scale = match self.scale {
            None => DVec3::ONE,
            Some(Scale::Uniform(scale)) => DVec3::splat(scale),
            Some(Scale::PerAxis(scale)) => DVec3::from(scale),
        };
        within(scale.to_array().iter(), LARGEST_SCALE, "scale")?;
        if let Some(factor) =
            scale.to_array().iter().find(|factor| factor.abs() < 1.0 / LARGEST_SCALE)
        {
            let accepted =
                format!("numbers of at least {:e}, or their negatives", 1.0 / LARGEST_SCALE);
            return Err(Problem::parameter(
                "scale",
                format!("{factor:e} is too close to 0"),
                accepted,
            ));
        }
        within(self.rotate.iter().flatten(), LARGEST_COORDINATE, "rotate")?;
        within(self.quaternion.iter().flatten(), LARGEST_COORDINATE, "quaternion")?;
        let translate = self.translate.map_or(DVec3::ZERO, DVec3::from);
        within(translate.to_array().iter(), LARGEST_COORDINATE, "translate")?;
        Ok(Some(DAffine3::from_scale_rotation_translation(scale, self.rotation()?, translate)))
    }

    fn rotation(&self) -> Result<DQuat, Problem> {
        match (self.rotate, self.quaternion) {
            (Some(_), Some(_)) => Err(Problem::parameter(
                "quaternion",
                "cannot be given together with `rotate`",
                "either of the two",
            )),
            (Some([x, y, z]), None) => {
                Ok(DQuat::from_euler(EulerRot::XYZ, x.to_radians(), y.to_radians(), z.to_radians()))
            }
            (None, Some(quaternion)) => {
                let quaternion = DQuat::from_array(quaternion);
                let length = quaternion.length();
                if !(length > 1e-9 && length.is_finite()) {
                    return Err(Problem::parameter(
                        "quaternion",
                        "has no direction",
                        "x, y, z, w, not all 0",
                    ));
                }
                Ok(quaternion / length)
            }
            (None, None) => Ok(DQuat::IDENTITY),
        }
    }
}

/// Checks the bounds that a scene file also has.
fn within<'a>(
    mut numbers: impl Iterator<Item = &'a f64>,
    most: f64,
    name: &'static str,
) -> Result<(), Problem> {
    match numbers.find(|number| !(-most..=most).contains(*number)) {
        None => Ok(()),
        Some(number) => {
            let accepted = format!("numbers from {:e} to {most:e}", -most);
            Err(Problem::parameter(name, format!("{number:e} is out of range"), accepted))
        }
    }
}

fn affine(matrix: DMat4) -> Result<DAffine3, Problem> {
    const ACCEPTED: &str = "16 finite numbers, column-major, last row 0 0 0 1, invertible";
    let fail = |reason: &str| Err(Problem::parameter("matrix", reason, ACCEPTED));
    if !matrix.is_finite() || matrix.row(3) != glam::DVec4::W {
        return fail("is not an affine transform");
    }
    if DMat3::from_mat4(matrix).determinant() == 0.0 {
        return fail("cannot be inverted");
    }
    Ok(DAffine3::from_mat4(matrix))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn patch(value: serde_json::Value) -> Result<NodePatch, Problem> {
        node_change(value)?.patch()
    }

    #[test]
    fn transforms_are_given_whole() {
        let p = patch(json!({"translate": [1, 2, 3], "rotate": [0, 90, 0], "scale": 2})).unwrap();
        let moved = p.world_from_node.unwrap().transform_point3(DVec3::X);
        assert!((moved - DVec3::new(1.0, 2.0, 1.0)).length() < 1e-12, "{moved}");
        let p = patch(json!({"visible": false})).unwrap();
        assert_eq!(p, NodePatch { world_from_node: None, visible: Some(false) });
        let q = patch(json!({"quaternion": [0, 2, 0, 2]})).unwrap().world_from_node.unwrap();
        assert!((q.transform_vector3(DVec3::X) - DVec3::NEG_Z).length() < 1e-12);
    }

    #[test]
    fn bad_changes_name_the_key() {
        let at = |value| {
            let problem = patch(value).unwrap_err();
            assert_eq!(problem.status(), 422);
            problem.parameter.unwrap_or_default()
        };
        assert_eq!(at(json!({"scale": 0})), "scale");
        assert_eq!(at(json!({"scale": [1, 0, 1]})), "scale");
        assert_eq!(at(json!({"translate": [1, 2]})), "translate");
        assert_eq!(at(json!({"translate": [1e300, 0, 0]})), "translate");
        assert_eq!(at(json!({"scale": 1e30})), "scale");
        let mut far = DMat4::IDENTITY.to_cols_array();
        far[12] = -1e13;
        assert_eq!(at(json!({"matrix": far})), "matrix");
        assert_eq!(at(json!({"quaternion": [0, 0, 0, 0]})), "quaternion");
        assert_eq!(at(json!({"rotate": [0,0,0], "quaternion": [0,0,0,1]})), "quaternion");
        assert_eq!(at(json!({"matrix": vec![0.0; 16]})), "matrix");
        assert_eq!(at(json!({"matrix": vec![1.0; 16], "scale": 1})), "matrix");
        assert_eq!(at(json!({"tranlate": [1, 2, 3]})), "tranlate");
        assert_eq!(at(json!({})), "");
    }
}
