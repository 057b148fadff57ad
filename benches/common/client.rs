//! A small HTTP/1.1 client over one connection that is kept open: no more work than a client must do, so that
//! what is measured is the server.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::time::Duration;

use anyhow::{Context, bail};
use serde_json::Value;

pub struct Connection {
    stream: TcpStream,
    /// Bytes received; those before `start` are used up.
    received: Vec<u8>,
    start: usize,
}

pub struct Answer {
    pub status: u16,
    head: String,
    pub body: Vec<u8>,
}

impl Answer {
    pub fn header(&self, name: &str) -> Option<&str> {
        self.head.lines().skip(1).find_map(|line| {
            let (known, value) = line.split_once(':')?;
            known.eq_ignore_ascii_case(name).then(|| value.trim())
        })
    }

    /// The receipt of a frame.
    ///
    /// # Errors
    /// An answer that has none.
    pub fn receipt(&self) -> anyhow::Result<Value> {
        let text = self.header("pointillist-receipt").with_context(|| self.head.clone())?;
        Ok(serde_json::from_str(text)?)
    }
}

impl Connection {
    /// Connects.
    ///
    /// # Errors
    /// Nobody listens.
    pub fn open(address: SocketAddr) -> anyhow::Result<Connection> {
        let stream = TcpStream::connect(address)?;
        stream.set_nodelay(true)?;
        stream.set_read_timeout(Some(Duration::from_secs(120)))?;
        Ok(Connection { stream, received: Vec::with_capacity(1 << 16), start: 0 })
    }

    /// Sends a request; `headers` are whole lines.
    ///
    /// # Errors
    /// The connection is gone.
    pub fn send(&mut self, path: &str, headers: &str) -> anyhow::Result<()> {
        let request = format!("GET {path} HTTP/1.1\r\nHost: localhost\r\n{headers}\r\n");
        Ok(self.stream.write_all(request.as_bytes())?)
    }

    /// Posts a JSON document, and receives the answer.
    ///
    /// # Errors
    /// As [`Self::send`] and [`Self::receive`].
    pub fn post(&mut self, path: &str, body: &serde_json::Value) -> anyhow::Result<Answer> {
        let body = body.to_string();
        let request = format!(
            "POST {path} HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nContent-Length: {}\r\n\r\n{body}",
            body.len()
        );
        self.stream.write_all(request.as_bytes())?;
        self.receive()
    }

    /// Receives one answer to its end.
    ///
    /// # Errors
    /// The connection ends early, or an answer without length.
    pub fn receive(&mut self) -> anyhow::Result<Answer> {
        let end = loop {
            let unread = &self.received[self.start..];
            if let Some(at) = unread.windows(4).position(|bytes| bytes == b"\r\n\r\n") {
                break self.start + at + 4;
            }
            self.fill()?;
        };
        let head = String::from_utf8_lossy(&self.received[self.start..end]).into_owned();
        self.start = end;
        let status = head.split(' ').nth(1).and_then(|text| text.parse().ok());
        let status: u16 = status.with_context(|| format!("no status in {head:?}"))?;
        let mut answer = Answer { status, head, body: Vec::new() };
        if status != 304 && status != 204 {
            let length = answer.header("content-length").and_then(|text| text.parse().ok());
            let length: usize =
                length.with_context(|| format!("no length in {:?}", answer.head))?;
            while self.received.len() < self.start + length {
                self.fill()?;
            }
            answer.body = self.received[self.start..self.start + length].to_vec();
            self.start += length;
        }
        if self.start == self.received.len() {
            self.received.clear();
            self.start = 0;
        }
        Ok(answer)
    }

    /// One request and its answer.
    ///
    /// # Errors
    /// As [`Self::send`] and [`Self::receive`].
    pub fn get(&mut self, path: &str, headers: &str) -> anyhow::Result<Answer> {
        self.send(path, headers)?;
        self.receive()
    }

    fn fill(&mut self) -> anyhow::Result<()> {
        let old = self.received.len();
        self.received.resize(old + (1 << 16), 0);
        let count = self.stream.read(&mut self.received[old..]).unwrap_or(0);
        self.received.truncate(old + count);
        if count == 0 {
            bail!("the server closed the connection or said nothing for two minutes");
        }
        Ok(())
    }
}
