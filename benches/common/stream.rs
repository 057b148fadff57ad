//! A client of one stream that reads frames and nothing else.

use std::net::{SocketAddr, TcpStream};
use std::time::Duration;

use anyhow::{Context, bail};
use pointillist::load::wire::header_and_image;
use serde_json::{Value, json};
use tungstenite::client::IntoClientRequest;
use tungstenite::{Message, WebSocket};

pub struct Stream {
    socket: WebSocket<TcpStream>,
    seq: u64,
}

impl Stream {
    /// Opens a stream.
    ///
    /// # Errors
    /// The daemon refuses.
    pub fn open(address: SocketAddr, path: &str) -> anyhow::Result<Stream> {
        Stream::open_as(address, path, None)
    }

    /// Opens a stream with an API key.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn open_as(address: SocketAddr, path: &str, key: Option<&str>) -> anyhow::Result<Stream> {
        let socket = TcpStream::connect(address)?;
        socket.set_nodelay(true)?;
        socket.set_read_timeout(Some(Duration::from_secs(120)))?;
        let url = format!("ws://{address}{path}");
        let mut request = url.into_client_request()?;
        if let Some(key) = key {
            request.headers_mut().insert("authorization", format!("Bearer {key}").parse()?);
        }
        let (socket, _) = tungstenite::client::client(request, socket)
            .map_err(|error| anyhow::anyhow!("{path}: {error}"))?;
        Ok(Stream { socket, seq: 0 })
    }

    /// A number for the next pose.
    pub fn next_seq(&mut self) -> u64 {
        self.seq += 1;
        self.seq
    }

    /// Sends a message.
    ///
    /// # Errors
    /// The stream is gone.
    pub fn send(&mut self, message: &Value) -> anyhow::Result<()> {
        Ok(self.socket.send(Message::text(message.to_string()))?)
    }

    /// Tells that a frame, whose header this is, was taken.
    ///
    /// # Errors
    /// The stream is gone.
    pub fn acknowledge(&mut self, frame: &Value) -> anyhow::Result<()> {
        self.send(&json!({ "ack": frame["frame"] }))
    }

    /// The header of the first frame that shows the pose `seq`; frames before it are acknowledged.
    ///
    /// # Errors
    /// A problem that the daemon tells of; the stream is gone.
    pub fn frame_of(&mut self, seq: u64) -> anyhow::Result<Value> {
        Ok(self.frame_where(|shown| shown == seq)?.0)
    }

    /// Does the work of [`Self::frame_of`], and returns the image as well.
    ///
    /// # Errors
    /// As [`Self::frame_of`].
    pub fn image_of(&mut self, seq: u64) -> anyhow::Result<(Value, Vec<u8>)> {
        self.frame_where(|shown| shown == seq)
    }

    /// The header of the first frame that shows the pose `seq` or a later one.
    ///
    /// # Errors
    /// As [`Self::frame_of`].
    pub fn frame_from(&mut self, seq: u64) -> anyhow::Result<Value> {
        Ok(self.frame_where(|shown| shown >= seq)?.0)
    }

    fn frame_where(&mut self, is_it: impl Fn(u64) -> bool) -> anyhow::Result<(Value, Vec<u8>)> {
        loop {
            match self.socket.read()? {
                Message::Binary(bytes) => {
                    let (header, image) =
                        header_and_image(&bytes).context("a frame that is cut off")?;
                    let header: Value = serde_json::from_slice(header)?;
                    if header["seq"].as_u64().is_some_and(&is_it) {
                        return Ok((header, image.to_vec()));
                    }
                    self.acknowledge(&header)?;
                }
                Message::Text(text) => {
                    let event: Value = serde_json::from_str(&text)?;
                    if event["event"] == "problem" {
                        bail!("{event}");
                    }
                }
                Message::Close(reason) => bail!("closed: {reason:?}"),
                _ => {}
            }
        }
    }
}
