//! `GET /v1/scenes/{id}/stream`: a WebSocket on which poses come in and frames go out.
//!
//! ```text
//! reader ─▶ session ──▶ schedule (which pose, how well; pure)
//!             │   └───▶ pacing (how many, how large; pure)
//!             ├─ ask, replace ─▶ a latest slot of the engine ─▶ frames
//!             └─▶ send_queue ─▶ writer
//! ```
//!
//! The newest pose wins: a stream has at most one frame being drawn and one waiting. A newer pose replaces the waiting one and
//! keeps its turn. Acknowledgements open the window ([`pacing`]); without them no more frames are sent.

mod allowance;
mod moving;
mod pacing;
mod places;
mod pose_schedule;
mod preparation;
mod send_queue;
mod session;
pub(super) mod wire;

use std::sync::Arc;

use axum::extract::ws::WebSocketUpgrade;
use axum::extract::ws::rejection::WebSocketUpgradeRejection;
use axum::extract::{Extension, State};
use axum::http::Uri;
use axum::response::Response;
use tracing::Instrument;

pub use allowance::MOST_PER_SECOND as MOST_MESSAGES_PER_SECOND;
pub use places::{Place, StreamLimits, Streams};
pub use wire::{Close, FrameHeader, MAX_MESSAGE_BYTES, PoseFields, WITHOUT};

use super::frame::missing;
use super::params::{FrameParams, Names};
use super::problem::{Kind, Problem};
use super::{App, Caller, Segments, naming};
use crate::engine::RequestId;
use crate::plan::Given;
use session::Session;

/// The subprotocol that is chosen when a client offers it.
const PROTOCOL: &str = "pointillist";

/// Parameters that the address may hold.
const QUERY_NAMES: Names = Names { own: &[], without: WITHOUT };

/// Poses in, frames out, over a WebSocket.
///
/// **The client sends** JSON text. A pose is `{"seq": 7, …}` with any parameter of a frame but `deadline_ms`, named and written as in
/// `POST …/frames` (schema `StreamPose`); missing parameters keep the previous pose's values, or with `"reset": true` take their defaults. `{"ack": n}` acknowledges frame `n` and all
/// earlier frames; send it once the frame is decoded. The second frame is sent after the first is acknowledged; later, two to eight frames may be in flight. A client that never acknowledges is told so
/// once, by a problem whose `parameter` is `ack`. `{"ping": x}` is answered with
/// `{"event": "pong", "ping": x}`. The server draws the pose that arrived last, whatever its `seq`. Parameters in the address are the first pose, with `seq` 0, so that a client that reconnects
/// gets a frame at once.
///
/// **The server sends** frames as one binary message each: a little-endian u32, the length of the header; the header, JSON (schema
/// `StreamFrame`); the image. Frames are sent in the order of their poses. The server skips a pose when a newer one arrives before it is drawn.
/// While the pose moves (`"moving": true`, or left out and the last pose less than 200 ms ago) frames are smaller and colours are JPEG where a
/// format that a browser shows was asked for; below half of each side, those of `lod=spt` are coarser, too (an accepted error of up to four times what was
/// asked for, and no more than 4 unless more was asked for). So 30 come in a second by what engine and link were measured to do, if a quarter of each
/// side and that error make it possible: the header says `"quality": "moving"`, how small and how coarse. If the scene was measured for the planner, the planner chooses the most exact
/// settings and size that come in time, and the receipt's `planned` says how. When it rests, or `"moving": false` says so, one frame comes as it was asked for,
/// `"quality": "still"`; without `format` colours are JPEG. A receipt's `request_id` is the handshake's `X-Request-Id` with the number that
/// the frame has when nothing fails before it, as in `4bf92f35/12`.
///
/// Text messages of the server are `{"event": "scene", "scene": …, "revision": r}`, first and whenever the scene changed, after which the
/// pose is drawn again unasked; `{"event": "deleted", …}`; `{"event": "pong", …}`; and `{"event": "problem", …}`, a `Problem` with the `seq` of the
/// pose, if it is about one. After a problem the stream goes on, with the previous settings.
///
/// **It closes** with 1001 (the server stops), 1002 (a frame violates the WebSocket protocol), 1003 (a binary message), 1007 (a text is not UTF-8), 1008
/// (more than `max_stream_messages_per_second`, for longer than a burst of four times as many), 1009 (a message over `max_stream_message_bytes`), 1011 (the server can
/// no longer draw), 4403 (the key was removed or has expired), 4404 (the scene was deleted), 4408 (nothing received for `stream_idle_ms`) or 4429 (too many streams).
///
/// Pages cannot set headers on a WebSocket: their key may come as a subprotocol, `new WebSocket(url, ["pointillist",
/// "pointillist.key.KEY"])`. Without keys, pages of other origins than the server's and those of `--cors-origin` are refused.
#[utoipa::path(
    get,
    path = "/v1/scenes/{id}/stream",
    operation_id = "openStream",
    tag = "frames",
    params(("id" = String, Path, description = "A scene that `GET /v1/scenes` lists"), FrameParams, Given),
    responses((status = 101, description = "The connection becomes a WebSocket")),
)]
pub async fn stream(
    State(app): State<Arc<App>>,
    Extension(Caller(client, caps)): Extension<Caller>,
    Extension(request_id): Extension<RequestId>,
    Segments(id): Segments<String>,
    uri: Uri,
    upgrade: Result<WebSocketUpgrade, WebSocketUpgradeRejection>,
) -> Result<Response, Problem> {
    let first = uri.query().filter(|query| !query.is_empty());
    let first =
        first.map(|query| FrameParams::from_query_as(Some(query), &QUERY_NAMES)).transpose()?;
    app.engine.scene(&id).map_err(|error| missing(&app, &id, error.into()))?;
    let upgrade = upgrade.map_err(|rejection| {
        Problem::new(Kind::UpgradeRequired, rejection.body_text())
            .at("Upgrade")
            .accepted("a WebSocket handshake over HTTP/1.1, version 13")
    })?;
    // A message slightly over the limit is read to its end, because a reset would otherwise lose the close that answers it.
    let most = 4 * MAX_MESSAGE_BYTES;
    let upgrade = upgrade.protocols([PROTOCOL]).max_message_size(most).max_frame_size(most);
    // Take the place before answering the handshake, so that places go to clients in the order of the answers.
    let place = Place::take(&app, client);
    Ok(upgrade.on_upgrade(move |socket| async move {
        let Some(place) = place else {
            return send_queue::refuse(socket, Close::TooMany).await;
        };
        let span = tracing::debug_span!("stream", connection = %request_id, scene = id);
        let session = Session::start(app, id, request_id.clone(), Caller(client, caps), socket)
            .run(first, place);
        naming::within(request_id, session.instrument(span)).await;
    }))
}
