//! Messages on the socket, and the codes with which it is closed.
//!
//! ```text
//! client ─▶ server   text     {"seq": 7, "eye": [0, 1, 9], "target": [0, 0, 0], "moving": true}
//!                             {"ack": 12}      {"ping": 1}
//! server ─▶ client   binary   u32 little-endian: bytes of the header │ header, JSON │ image
//!                    text     {"event": "scene", …}  {"event": "deleted", …}  {"event": "pong", …}
//!                             {"event": "problem", "type": …, "parameter": …, "accepted": …}
//! ```

use axum::extract::ws::{CloseFrame, Message};
use bytes::{BufMut, Bytes, BytesMut};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use tokio_tungstenite::tungstenite::Error as SocketError;
use tokio_tungstenite::tungstenite::error::ProtocolError;
use utoipa::ToSchema;

use crate::encode::ImageFormat;
use crate::engine::Receipt;
use crate::http::params::{FrameParams, Names};
use crate::http::problem::{Kind, Problem};
use crate::json::whole::Whole;
use crate::scene::check_keys;

/// Largest message of a client in bytes.
pub const MAX_MESSAGE_BYTES: usize = 64 << 10;

/// Why the server closes a stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Close {
    /// The server drains.
    GoingAway,
    /// The client sent data that is no WebSocket frame.
    BrokenProtocol,
    /// The client sent a binary message.
    NotText,
    /// A text message is not UTF-8.
    NotUtf8,
    /// The client sent more messages than any client needs.
    Flood,
    /// A message was over [`MAX_MESSAGE_BYTES`].
    TooLarge,
    /// The server can no longer draw.
    Failed,
    /// The client's key was removed, or has expired.
    NotAllowed,
    /// The scene was deleted.
    Deleted,
    /// Nothing came from the client for too long.
    Idle,
    /// The number of streams has reached its limit.
    TooMany,
}

impl Close {
    #[cfg(test)]
    pub const ALL: [Close; 11] = [
        Close::GoingAway,
        Close::BrokenProtocol,
        Close::NotText,
        Close::NotUtf8,
        Close::Flood,
        Close::TooLarge,
        Close::Failed,
        Close::NotAllowed,
        Close::Deleted,
        Close::Idle,
        Close::TooMany,
    ];

    /// Returns the code (RFC 6455 §7.4; 4000 and above are this protocol's own) and the reason.
    pub fn facts(self) -> (u16, &'static str) {
        match self {
            Close::GoingAway => (1001, "the server is shutting down"),
            Close::BrokenProtocol => (1002, "a frame violates the WebSocket protocol"),
            Close::NotText => (1003, "binary messages are not accepted; send JSON text"),
            Close::NotUtf8 => (1007, "the message is not UTF-8"),
            Close::Flood => (
                1008,
                "too many messages per second; see max_stream_messages_per_second of GET /v1/limits",
            ),
            Close::TooLarge => {
                (1009, "the message is too large; see max_stream_message_bytes of GET /v1/limits")
            }
            Close::Failed => (1011, "the server can no longer draw"),
            Close::NotAllowed => (4403, "the API key was removed or has expired"),
            Close::Deleted => (4404, "the scene was deleted"),
            Close::Idle => {
                (4408, "the client sent nothing for too long; see stream_idle_ms of GET /v1/limits")
            }
            Close::TooMany => {
                (4429, "too many streams are open; see max_streams of GET /v1/limits")
            }
        }
    }

    /// Returns the close for a message that could not be read; `None` when the connection is lost and no close would arrive.
    pub fn of_fault(error: axum::Error) -> Option<Close> {
        let error = error.into_inner().downcast::<SocketError>().ok()?;
        match *error {
            SocketError::Utf8(_) => Some(Close::NotUtf8),
            SocketError::Capacity(_) => Some(Close::TooLarge),
            SocketError::Protocol(ProtocolError::ResetWithoutClosingHandshake) => None,
            SocketError::Protocol(_) => Some(Close::BrokenProtocol),
            _ => None,
        }
    }

    pub fn message(self) -> Message {
        let (code, reason) = self.facts();
        Message::Close(Some(CloseFrame { code, reason: reason.into() }))
    }
}

/// A parsed message of the client; it may have several parts at once.
#[derive(Debug, Default)]
pub struct Incoming {
    /// Number of an acknowledged frame; earlier frames are acknowledged with it.
    pub ack: Option<u64>,
    pub ping: Option<Value>,
    pub pose: Option<PoseMessage>,
}

/// Frame parameters that a stream does not have.
pub const WITHOUT: &[(&str, &str)] =
    &[("deadline_ms", "a stream always draws the newest pose and drops older ones")];

/// Fields that a message may hold.
const MESSAGE_NAMES: Names =
    Names { own: &["seq", "moving", "reset", "ack", "ping"], without: WITHOUT };

/// A new pose.
#[derive(Debug)]
pub struct PoseMessage {
    pub seq: u64,
    pub moving: Option<bool>,
    /// Whether parameters left out take their defaults instead of the previous pose's values.
    pub reset: bool,
    pub params: FrameParams,
}

/// The fields of a pose that a frame's query does not have.
#[derive(serde::Deserialize, ToSchema)]
#[schema(as = StreamPose)]
#[expect(dead_code, reason = "read as JSON; here it stands for the contract")]
pub struct PoseFields {
    /// Number that the client gives the pose; frames that show the pose repeat it. The server draws the pose that arrived last, whatever
    /// its number.
    seq: u64,
    /// `true` announces further poses and asks for a quick frame. `false` says that the pose rests and asks for a frame in full quality.
    /// Without `moving`, a quick frame comes first, and a frame in full quality once no pose has followed for a moment.
    moving: Option<bool>,
    /// `true`: parameters that this message leaves out take their defaults, instead of the previous pose's values.
    reset: Option<bool>,
    #[serde(flatten)]
    parameters: FrameParams,
}

impl Incoming {
    /// # Errors
    /// Names the parameter that cannot be used.
    pub fn read(text: &str) -> Result<Incoming, Problem> {
        const MESSAGE: &str = "a pose with `seq`, or `ack`, or `ping`";
        let unreadable = |why: String| {
            Problem::new(Kind::BadBody, why).accepted(format!("a JSON object: {MESSAGE}"))
        };
        check_keys(text.as_bytes())
            .map_err(|found| unreadable(found.to_string()).at(found.path))?;
        let value: Value =
            serde_json::from_str(text).map_err(|error| unreadable(error.to_string()))?;
        let Value::Object(mut fields) = value else {
            return Err(unreadable("the message is not a JSON object".to_owned()));
        };
        for name in fields.keys() {
            MESSAGE_NAMES.check(name)?;
        }
        let ack = fields.remove("ack").map(|ack| whole("ack", &ack)).transpose()?;
        let ping = fields.remove("ping");
        let seq = fields.remove("seq").map(|seq| whole("seq", &seq)).transpose()?;
        let mut flag = |name: &str| match fields.remove(name) {
            None => Ok(None),
            Some(Value::Bool(value)) => Ok(Some(value)),
            Some(_) => Err(Problem::parameter(name, "is neither true nor false", "true or false")),
        };
        let (moving, reset) = (flag("moving")?, flag("reset")?);
        let has_pose = moving.is_some() || reset.is_some() || !fields.is_empty();
        let params = FrameParams::from_json(Value::Object(fields), "")?;
        let pose = match seq {
            Some(seq) => {
                let reset = reset.unwrap_or_default();
                Some(PoseMessage { seq, moving, reset, params })
            }
            None if has_pose => {
                return Err(Problem::parameter("seq", "missing", "a whole number for the pose"));
            }
            None if ack.is_none() && ping.is_none() => {
                return Err(unreadable("the message is empty".to_owned()));
            }
            None => None,
        };
        Ok(Incoming { ack, ping, pose })
    }
}

fn whole(name: &str, value: &Value) -> Result<u64, Problem> {
    Whole::deserialize(value).map(|Whole(number)| number).map_err(|_| {
        Problem::parameter(name, "is not a whole number of 0 or more", "a whole number, 0 or more")
    })
}

/// Quality of a streamed frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Quality {
    /// Smaller or more strongly compressed than requested, because the pose may still change.
    Moving,
    /// Size and quality as requested.
    Still,
}

/// JSON header in front of a frame's image.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = StreamFrame)]
pub struct FrameHeader<'a> {
    /// Number of the frame in this stream, from 1; `ack` repeats it.
    pub frame: u64,
    /// `seq` of the pose that the frame shows.
    pub seq: u64,
    /// Revision of the scene that the frame shows.
    pub revision: u64,
    pub quality: Quality,
    /// Width and height as a share of the requested ones; 1 when still.
    pub scale: f64,
    pub format: ImageFormat,
    /// Quality of a JPEG, 1 to 100; `null` for other formats.
    pub jpeg_quality: Option<u8>,
    /// Error bound of a frame of `lod=spt`, in its own pixels: as requested when still, and up to four times that while moving.
    #[serde(rename = "max_error_px")]
    pub accepted_px: Option<f32>,
    pub width: u32,
    pub height: u32,
    pub content_type: &'a str,
    /// Size of the image in bytes.
    pub bytes: usize,
    /// Number of poses of this stream so far that were skipped because a newer pose had arrived.
    pub overtaken: u64,
    pub receipt: &'a Receipt,
}

impl FrameHeader<'_> {
    /// Returns the binary message.
    pub fn message(&self, image: &[u8]) -> Message {
        // This cannot fail: there are only strings and numbers.
        let header = serde_json::to_vec(self).unwrap_or_default();
        Message::Binary(pack(&header, image))
    }
}

fn pack(header: &[u8], image: &[u8]) -> Bytes {
    let mut message = BytesMut::with_capacity(4 + header.len() + image.len());
    message.put_u32_le(u32::try_from(header.len()).unwrap_or(u32::MAX));
    message.put_slice(header);
    message.put_slice(image);
    message.freeze()
}

/// A text message from the server.
#[derive(Debug, Serialize)]
#[serde(tag = "event", rename_all = "lowercase")]
pub enum Event<'a> {
    /// The scene that is shown; sent first and after every change.
    Scene {
        scene: &'a str,
        revision: u64,
    },
    /// The scene was deleted; the stream is closed.
    Deleted {
        scene: &'a str,
    },
    Pong {
        ping: Value,
    },
    /// A message was not understood, or a pose could not be drawn.
    Problem {
        #[serde(skip_serializing_if = "Option::is_none")]
        seq: Option<u64>,
        #[serde(flatten)]
        problem: Problem,
    },
}

impl Event<'_> {
    pub fn message(&self) -> Message {
        // This cannot fail: there are only strings and numbers.
        Message::text(serde_json::to_string(self).unwrap_or_default())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fault(text: &str) -> (u16, Option<String>) {
        let problem = Incoming::read(text).unwrap_err();
        (problem.status(), problem.parameter)
    }

    #[test]
    fn messages_of_a_client() {
        let pose = Incoming::read(r#"{"seq": 7, "eye": [0, 1, 2], "moving": true}"#).unwrap();
        let pose = pose.pose.unwrap();
        assert_eq!(
            (pose.seq, pose.moving, pose.params.eye),
            (7, Some(true), Some([0.0, 1.0, 2.0]))
        );
        let both = Incoming::read(r#"{"ack": 3, "ping": "x"}"#).unwrap();
        assert_eq!((both.ack, both.ping, both.pose.is_none()), (Some(3), Some("x".into()), true));
        assert!(Incoming::read(r#"{"seq": 0}"#).unwrap().pose.is_some(), "the same again");
        assert_eq!(Incoming::read(r#"{"ack": 3.0}"#).unwrap().ack, Some(3));
    }

    #[test]
    fn what_cannot_be_used_is_named() {
        let named = |status, name: &str| (status, Some(name.to_owned()));
        assert_eq!(fault(r#"{"eye": [0, 0, 1]}"#), named(422, "seq"));
        assert_eq!(fault(r#"{"seq": -1}"#), named(422, "seq"));
        assert_eq!(fault(r#"{"ack": "1"}"#), named(422, "ack"));
        assert_eq!(fault(r#"{"seq": 1, "moving": 1}"#), named(422, "moving"));
        assert_eq!(fault(r#"{"seq": 1, "reset": 1}"#), named(422, "reset"));
        assert_eq!(fault(r#"{"reset": true}"#), named(422, "seq"));
        assert_eq!(fault(r#"{"seq": 1, "eyes": [0, 0, 1]}"#), named(422, "eyes"));
        assert_eq!(fault(r#"{"seq": 1, "eye": [0, 1]}"#), named(422, "eye"));
        assert_eq!(fault(r#"{"seq": 1, "deadline_ms": 5}"#), named(422, "deadline_ms"));
        let unknown = Incoming::read(r#"{"hello": 1}"#).unwrap_err();
        assert!(!unknown.detail.contains("did you mean"), "{}", unknown.detail);
        let accepted = unknown.accepted.unwrap_or_default();
        assert!(accepted.starts_with("seq, moving, reset, ack, ping, camera"), "{accepted}");
        assert!(!accepted.contains("deadline_ms"), "{accepted}");
        let near = Incoming::read(r#"{"acks": 1}"#).unwrap_err();
        assert!(near.detail.contains("did you mean `ack`"), "{}", near.detail);
        for text in ["", "[]", "{}", "1", "{\"seq\": 1"] {
            assert_eq!(fault(text), (422, None), "{text}");
        }
    }

    #[test]
    fn a_key_that_comes_twice_is_named() {
        let problem = Incoming::read(r#"{"seq": 1, "eye": [0, 0, 1], "seq": 2}"#).err().unwrap();
        assert!(problem.detail.contains("duplicate key `seq`"), "{}", problem.detail);
    }

    #[test]
    fn a_frame_is_length_header_image() {
        let message = pack(br#"{"a":1}"#, b"image");
        assert_eq!(&message[..4], [7, 0, 0, 0]);
        assert_eq!(&message[4..], br#"{"a":1}image"#);
    }

    #[test]
    fn problems_keep_their_members() {
        let problem = Problem::parameter("eye", "bad", "three numbers");
        let Message::Text(text) = Event::Problem { seq: Some(4), problem }.message() else {
            panic!()
        };
        let value: Value = serde_json::from_str(&text).unwrap();
        assert_eq!((&value["event"], &value["seq"]), (&"problem".into(), &4.into()));
        assert_eq!((&value["parameter"], &value["status"]), (&"eye".into(), &422.into()));
    }

    #[test]
    fn what_cannot_be_read_has_its_close_and_a_lost_connection_none() {
        let close = |error: SocketError| Close::of_fault(axum::Error::new(error));
        assert_eq!(close(SocketError::Utf8(String::new())), Some(Close::NotUtf8));
        let reserved = ProtocolError::NonZeroReservedBits;
        assert_eq!(close(SocketError::Protocol(reserved)), Some(Close::BrokenProtocol));
        assert_eq!(close(ProtocolError::ResetWithoutClosingHandshake.into()), None);
        assert_eq!(close(std::io::Error::from(std::io::ErrorKind::ConnectionReset).into()), None);
        assert_eq!(Close::of_fault(axum::Error::new(std::fmt::Error)), None);
    }

    #[test]
    fn close_codes_differ_and_fit() {
        let mut codes: Vec<u16> = Close::ALL.iter().map(|close| close.facts().0).collect();
        codes.dedup();
        assert_eq!(codes.len(), Close::ALL.len());
        // A control frame holds 125 bytes; the code takes two of them.
        assert!(Close::ALL.iter().all(|close| close.facts().1.len() <= 123));
    }
}
