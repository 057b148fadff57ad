//! `GET /v1/scenes/{id}/paths/{name}`: one of a scene's camera paths, in the format of a path file.

use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use serde::Serialize;
use utoipa::ToSchema;

use super::frame::missing;
use super::problem::{Kind, Problem};
use super::{App, NoQuery, Segments};
use crate::engine::EngineError;
use crate::scene::{CameraPath, Ease, Interpolation};

/// A camera path with all that its scene or its defaults fill in. It can be saved and given to `pointillist path`, or put into a
/// scene's `paths`.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = CameraPath)]
pub struct PathDocument {
    /// Frames a second.
    fps: f64,
    /// How positions go from key to key.
    interpolation: Interpolation,
    keys: Vec<PathKeyDocument>,
}

/// The camera at one time of a path.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = CameraPathKey)]
pub struct PathKeyDocument {
    /// Seconds, later than the key before.
    t: f64,
    eye: [f64; 3],
    target: [f64; 3],
    up: [f64; 3],
    /// Vertical field of view in degrees, of a perspective.
    #[serde(skip_serializing_if = "Option::is_none")]
    fov: Option<f64>,
    /// Height of the view in scene units, of an orthographic projection.
    #[serde(skip_serializing_if = "Option::is_none")]
    ortho_height: Option<f64>,
    /// How time passes from here to the next key.
    ease: Ease,
}

impl From<&CameraPath> for PathDocument {
    fn from(path: &CameraPath) -> Self {
        let key = |key: &crate::scene::PathKey| PathKeyDocument {
            t: key.t,
            eye: key.camera.eye.into(),
            target: key.camera.target.into(),
            up: key.camera.up.into(),
            fov: key.camera.lens.fov_deg(),
            ortho_height: key.camera.lens.ortho_height(),
            ease: key.ease,
        };
        Self {
            fps: path.fps,
            interpolation: path.interpolation,
            keys: path.keys.iter().map(key).collect(),
        }
    }
}

/// A camera path that the scene names.
#[utoipa::path(
    get,
    path = "/v1/scenes/{id}/paths/{name}",
    operation_id = "getPath",
    tag = "scenes",
    params(
        ("id" = String, Path, description = "The scene"),
        ("name" = String, Path, description = "A name that the scene lists under `paths`"),
    ),
    responses((status = 200, description = "The path, in the format of path files", body = PathDocument)),
)]
pub async fn show(
    State(app): State<Arc<App>>,
    Segments((id, name)): Segments<(String, String)>,
    _: NoQuery,
) -> Result<Json<PathDocument>, Problem> {
    match app.engine.camera_path(&id, &name) {
        Ok(path) => Ok(Json(PathDocument::from(&path))),
        // Here the name is part of the URL, not a parameter.
        Err(EngineError::BadParameter { reason, accepted, .. }) => {
            Err(Problem::new(Kind::UnknownPath, reason).at("name").accepted(accepted))
        }
        Err(error) => Err(missing(&app, &id, error.into())),
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::scene::parse_path;

    #[test]
    fn what_is_answered_is_a_path_file() {
        let text = r#"{ "fps": 24, "interpolation": "linear", "keys": [
            { "t": 0.1, "eye": [0.1, 1e9, 5], "target": [0, 0, 0], "ease": "hold" },
            { "t": 4, "eye": [5, 0.30000000000000004, 0], "target": [0, 0, 0], "up": [0, 0, 1], "fov": 33.3 } ] }"#;
        let path = parse_path(text, "p", DVec3::Y).unwrap();
        let answered = serde_json::to_string(&PathDocument::from(&path)).unwrap();
        // The answer has every field, so parsing with another up gives the same path.
        assert_eq!(parse_path(&answered, "p", DVec3::X).unwrap(), path);
    }
}
