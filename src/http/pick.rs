//! `GET` and `POST /v1/scenes/{id}/pick`: which elements the pixels of a frame show.

use std::sync::Arc;
use std::time::Instant;

use axum::Json;
use axum::body::Body;
use axum::extract::{Extension, State};
use axum::http::{HeaderMap, HeaderValue, Uri, header};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::frame::{missing, receipt_headers, resolve, wait};
use super::params::{FrameParams, Names, integer, once, pairs};
use super::problem::Problem;
use super::{App, Caller, NoQuery, Segments, body};
use crate::encode::ImageFormat;
use crate::engine::pick::{Pick, request_of};
use crate::engine::receipt::CameraReceipt;
use crate::engine::{Origin, RequestId};
use crate::json::whole::{self, Whole};
use crate::plan::Given;

/// Largest body of a request.
const MAX_BODY_BYTES: u64 = 1 << 20;
const PIXEL: &str = "a whole number of pixels, from 0 at the top left";

/// Parameters of a pick.
pub const NAMES: Names = Names {
    own: &["x", "y"],
    without: &[
        ("output", "a pick answers with JSON"),
        ("format", "a pick answers with JSON"),
        ("quality", "a pick answers with JSON"),
    ],
};

/// A pixel of the frame.
#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
pub struct PixelParams {
    /// Column of the pixel, from 0 at the left.
    x: u32,
    /// Row of the pixel, from 0 at the top.
    y: u32,
}

/// Pixels of a frame, and the frame.
#[derive(Deserialize, ToSchema)]
pub struct PickRequest {
    /// Column of the pixel, from 0 at the left.
    #[serde(default, deserialize_with = "whole::optional")]
    x: Option<u32>,
    /// Row of the pixel, from 0 at the top.
    #[serde(default, deserialize_with = "whole::optional")]
    y: Option<u32>,
    /// Several pixels instead of `x` and `y`: column and row of each.
    #[schema(value_type = Option<Vec<[u32; 2]>>)]
    pixels: Option<Vec<[Whole<u32>; 2]>>,
    #[serde(flatten)]
    #[schema(value_type = FrameParams)]
    frame: serde_json::Map<String, serde_json::Value>,
}

/// Surfaces that pixels show.
#[derive(Serialize, ToSchema)]
pub struct Picks {
    scene: String,
    revision: u64,
    camera: CameraReceipt,
    /// One pick per pixel, in the order of the request.
    picks: Vec<Pick>,
}

/// The surface that a pixel shows.
///
/// Takes the parameters of a frame, and answers with what the pixel `x`, `y` of that frame shows: the world position in full precision,
/// the distance, the normal, the instance and the nodes above it. `Pointillist-Receipt` is the receipt of the frame drawn for the pick.
#[utoipa::path(
    get,
    path = "/v1/scenes/{id}/pick",
    operation_id = "pick",
    tag = "frames",
    params(("id" = String, Path, description = "A scene that `GET /v1/scenes` lists"), PixelParams, FrameParams, Given),
    responses((status = 200, description = "What the pixel shows", body = Picks)),
)]
pub async fn pick(
    State(app): State<Arc<App>>,
    Extension(caller): Extension<Caller>,
    Extension(request_id): Extension<RequestId>,
    Segments(id): Segments<String>,
    uri: Uri,
) -> Result<Response, Problem> {
    let (mut x, mut y, mut params) = (None, None, FrameParams::default());
    for (name, value) in pairs(uri.query())? {
        match name.as_str() {
            "x" => once(&mut x, &name, integer(&name, &value, PIXEL)?)?,
            "y" => once(&mut y, &name, integer(&name, &value, PIXEL)?)?,
            _ => {
                NAMES.check(&name)?;
                params.set(&name, &value)?;
            }
        }
    }
    let PixelParams { x, y } = PixelParams::of(x, y)?;
    answer(&app, caller, request_id, &id, &params, vec![[x, y]]).await
}

/// Surfaces that several pixels show.
///
/// Draws one frame for all pixels. The body has the fields of a frame, and either `x` and `y` or `pixels`.
#[utoipa::path(
    post,
    path = "/v1/scenes/{id}/pick",
    operation_id = "pickMany",
    tag = "frames",
    params(("id" = String, Path, description = "A scene that `GET /v1/scenes` lists")),
    request_body(content = PickRequest, content_type = "application/json"),
    responses((status = 200, description = "What the pixels show", body = Picks)),
)]
pub async fn pick_many(
    State(app): State<Arc<App>>,
    Extension(caller): Extension<Caller>,
    Extension(request_id): Extension<RequestId>,
    Segments(id): Segments<String>,
    _: NoQuery,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    let (admission, patience) = (app.engine.admission(), app.settings.read_timeout);
    let request: PickRequest =
        body::json(&headers, body, MAX_BODY_BYTES, patience, &admission).await?;
    for name in request.frame.keys() {
        NAMES.check(name)?;
    }
    let params = FrameParams::from_json(serde_json::Value::Object(request.frame), "")?;
    let pixels = match (request.pixels, request.x, request.y) {
        (Some(pixels), None, None) => {
            pixels.into_iter().map(|pair| pair.map(|Whole(number)| number)).collect()
        }
        (None, x, y) => {
            let PixelParams { x, y } = PixelParams::of(x, y)?;
            vec![[x, y]]
        }
        (Some(_), x, _) => {
            let name = if x.is_some() { "x" } else { "y" };
            let reason = "cannot be given together with `pixels`";
            return Err(Problem::parameter(name, reason, "`x` and `y`, or `pixels`"));
        }
    };
    answer(&app, caller, request_id, &id, &params, pixels).await
}

impl PixelParams {
    fn of(x: Option<u32>, y: Option<u32>) -> Result<PixelParams, Problem> {
        let missing = |name| Problem::parameter(name, "missing", PIXEL);
        Ok(PixelParams { x: x.ok_or_else(|| missing("x"))?, y: y.ok_or_else(|| missing("y"))? })
    }
}

async fn answer(
    app: &Arc<App>,
    Caller(client, caps): Caller,
    request_id: RequestId,
    id: &str,
    params: &FrameParams,
    pixels: Vec<[u32; 2]>,
) -> Result<Response, Problem> {
    let request = params.request(id, ImageFormat::Raw, Instant::now())?;
    let deadline = request.deadline;
    let resolved = resolve(app, request_of(request)).await;
    let resolved = resolved.map_err(|problem| missing(app, id, problem))?;
    app.check_caps(&caps, &resolved)?;
    let origin = Origin { client, request_id };
    let (ticket, picker) = app.engine.pick(origin, &resolved, pixels)?;
    let frame = wait(app, ticket, deadline).await?;
    app.metrics.frame(&frame);
    let receipt = &frame.receipt;
    let (scene, revision, camera) =
        (receipt.scene.clone(), receipt.revision, receipt.camera.clone());
    let drawn = frame.clone();
    let read = tokio::task::spawn_blocking(move || picker.read(&drawn)).await;
    let picks = read.map_err(Problem::internal)??;
    let mut response = Json(Picks { scene, revision, camera, picks }).into_response();
    let headers = response.headers_mut();
    let receipt = receipt_headers(&frame).into_iter();
    headers.extend(receipt.filter(|(name, _)| *name != header::CONTENT_TYPE));
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
    Ok(response)
}
