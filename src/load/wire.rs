//! The part of the server's HTTP contract that the generator uses: the requests that it sends, and the answers that it reads.

use anyhow::{Context, bail, ensure};
use percent_encoding::{AsciiSet, NON_ALPHANUMERIC, utf8_percent_encode};
use serde::Deserialize;

use crate::math::{Camera, Lens};

/// Address of the server.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Target {
    pub host: String,
    pub port: u16,
    /// Prefix of all paths: empty, or `/prefix`.
    pub prefix: String,
}

impl Target {
    /// Reads `http://HOST[:PORT][/PREFIX]`.
    ///
    /// # Errors
    /// Fails for anything else, above all for https.
    pub fn parse(text: &str) -> anyhow::Result<Self> {
        let uri: hyper::Uri = text.parse().with_context(|| format!("{text}: not a URL"))?;
        match uri.scheme_str() {
            Some("http") => {}
            Some("https") => bail!(
                "{text}: https is not supported; give the server's own http address instead of the TLS proxy's"
            ),
            _ => bail!("{text}: expected http://HOST:PORT"),
        }
        ensure!(
            uri.query().is_none(),
            "{text}: the URL has a query; give frame parameters as options (see --help)"
        );
        let authority = uri
            .authority()
            .with_context(|| format!("{text}: the URL has no host; expected http://HOST:PORT"))?;
        ensure!(
            !authority.as_str().contains('@'),
            "{text}: the URL has credentials; give the API key with --key"
        );
        Ok(Self {
            host: authority.host().trim_matches(['[', ']']).to_owned(),
            port: authority.port_u16().unwrap_or(80),
            prefix: uri.path().trim_end_matches('/').to_owned(),
        })
    }

    /// The value of the header `Host`.
    pub fn authority(&self) -> String {
        if self.host.contains(':') {
            format!("[{}]:{}", self.host, self.port)
        } else {
            format!("{}:{}", self.host, self.port)
        }
    }
}

const ENCODED: &AsciiSet =
    &NON_ALPHANUMERIC.remove(b'-').remove(b'.').remove(b'_').remove(b'~').remove(b',');

/// Percent-encodes all bytes but unreserved characters and commas.
pub fn percent_encoded(text: &str) -> String {
    utf8_percent_encode(text, ENCODED).to_string()
}

/// The path and query of a `frame` or a `stream`. `parameters` are those that do not change between requests.
pub fn resource_path(
    prefix: &str,
    scene: &str,
    resource: &str,
    pose: &Camera,
    parameters: &[(String, String)],
) -> String {
    let vector = |v: glam::DVec3| format!("{},{},{}", v.x, v.y, v.z);
    let (lens, size) = pose.lens.parameter();
    let mut path = format!(
        "{prefix}/v1/scenes/{}/{resource}?eye={}&target={}&up={}&{lens}={size}",
        percent_encoded(scene),
        vector(pose.eye),
        vector(pose.target),
        vector(pose.up)
    );
    for (name, value) in parameters {
        path += &format!("&{}={}", percent_encoded(name), percent_encoded(value));
    }
    path
}

/// The fields of a scene that poses need.
#[derive(Clone, Debug, Deserialize)]
pub struct SceneAnswer {
    pub id: String,
    pub revision: u64,
    pub bounds: Option<[[f64; 3]; 2]>,
    pub up: [f64; 3],
    pub cameras: Vec<CameraAnswer>,
}

#[derive(Clone, Debug, Deserialize)]
pub struct CameraAnswer {
    pub eye: [f64; 3],
    pub target: [f64; 3],
    pub up: [f64; 3],
    pub fov: Option<f64>,
    pub ortho_height: Option<f64>,
}

impl CameraAnswer {
    pub fn pose(&self) -> Camera {
        Camera {
            eye: self.eye.into(),
            target: self.target.into(),
            up: self.up.into(),
            lens: Lens::given(self.fov, self.ortho_height).unwrap_or(super::poses::LENS),
        }
    }
}

/// The fields of a receipt that the tally adds up. A time that the adapter cannot measure is `None`.
#[derive(Clone, Debug, Deserialize)]
pub struct ReceiptAnswer {
    pub adapter: String,
    pub gpu_ns: Option<u64>,
    pub queue_ns: u64,
    pub encode_ns: u64,
    pub batch_size: u32,
    /// Number of frames that share `gpu_ns`.
    pub views: u32,
    #[serde(default)]
    pub coalesced: bool,
    #[serde(default)]
    pub settings: serde_json::Value,
}

/// The fields of a stream's frame that the tally adds up.
#[derive(Clone, Debug, Deserialize)]
pub struct FrameAnswer {
    pub frame: u64,
    pub seq: u64,
    pub quality: String,
    pub scale: f64,
    pub receipt: ReceiptAnswer,
}

impl FrameAnswer {
    /// Reads the header of a binary message.
    pub fn read(message: &[u8]) -> Option<Self> {
        serde_json::from_slice(header_and_image(message)?.0).ok()
    }
}

/// Splits a stream's binary message into its header, which is JSON, and its image. `None` if the message is cut off.
pub fn header_and_image(message: &[u8]) -> Option<(&[u8], &[u8])> {
    let (length, rest) = message.split_first_chunk::<4>()?;
    rest.split_at_checked(u32::from_le_bytes(*length) as usize)
}

#[cfg(test)]
impl FrameAnswer {
    pub fn of(seq: u64, quality: &str) -> FrameAnswer {
        let receipt = crate::engine::Receipt { views: 2, gpu_ns: Some(800), ..Default::default() };
        let header = serde_json::json!({
            "frame": 1, "seq": seq, "quality": quality, "scale": 0.5, "receipt": receipt,
        });
        serde_json::from_value(header).unwrap()
    }
}

/// Describes a failed request: the text of the problem document, or as much of the body as fits on a line.
pub fn complaint(status: u16, body: &[u8]) -> String {
    let problem: Option<serde_json::Value> = serde_json::from_slice(body).ok();
    let word = |key: &str| problem.as_ref()?.get(key)?.as_str().map(str::to_owned);
    let text = word("detail").or_else(|| word("title")).unwrap_or_else(|| {
        String::from_utf8_lossy(body).lines().next().unwrap_or_default().chars().take(200).collect()
    });
    let accepted = word("accepted").map_or(String::new(), |accepted| format!(" ({accepted})"));
    format!("{status}: {text}{accepted}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn targets_are_plain_http() {
        let target = Target::parse("http://127.0.0.1:8080").unwrap();
        assert_eq!((target.authority().as_str(), target.prefix.as_str()), ("127.0.0.1:8080", ""));
        let target = Target::parse("http://render.example/pointillist/").unwrap();
        assert_eq!((target.port, target.prefix.as_str()), (80, "/pointillist"));
        let target = Target::parse("http://[::1]:9000/").unwrap();
        assert_eq!((target.host.as_str(), target.authority().as_str()), ("::1", "[::1]:9000"));
        for (text, said) in [
            ("https://render.example", "https is not supported"),
            ("127.0.0.1:8080", "expected http://"),
            ("ftp://a", "expected http://"),
            ("http://a/?w=3", "options"),
            ("http://key@a/", "--key"),
            ("http://", "not a URL"),
        ] {
            let refused = format!("{:#}", Target::parse(text).unwrap_err());
            assert!(refused.contains(said), "{text}: {refused}");
        }
    }

    #[test]
    fn paths_are_complete_and_encoded() {
        let pose = Camera {
            eye: glam::DVec3::new(411_950.08, -1e-7, 3.0),
            target: glam::DVec3::ZERO,
            up: glam::DVec3::Z,
            lens: Lens::Perspective { fov_deg: 42.5 },
        };
        let parameters =
            [("w".to_owned(), "64".to_owned()), ("filter".to_owned(), "a b&c".to_owned())];
        assert_eq!(
            resource_path("/p", "my scene", "frame", &pose, &parameters),
            "/p/v1/scenes/my%20scene/frame?eye=411950.08,-0.0000001,3&target=0,0,0&up=0,0,1&fov=42.5&w=64&filter=a%20b%26c"
        );
    }

    #[test]
    fn complaints_are_told_in_the_daemons_words() {
        let problem = br#"{"title":"bad","detail":"w: not a number","accepted":"1 to 9"}"#;
        assert_eq!(complaint(400, problem), "400: w: not a number (1 to 9)");
        assert_eq!(complaint(502, b"<html>\nbad gateway"), "502: <html>");
    }

    #[test]
    fn a_message_is_length_header_image() {
        let message = b"\x02\0\0\0{}image";
        assert_eq!(header_and_image(message), Some((&b"{}"[..], &b"image"[..])));
        assert_eq!(header_and_image(&message[..6]), Some((&b"{}"[..], &b""[..])));
        assert_eq!((header_and_image(&message[..5]), header_and_image(b"\x02\0\0")), (None, None));
    }

    #[test]
    fn receipts_of_the_daemon_are_read() {
        let receipt = crate::engine::Receipt { views: 2, ..Default::default() };
        let line = serde_json::to_string(&receipt).unwrap();
        let read: ReceiptAnswer = serde_json::from_str(&line).unwrap();
        assert_eq!((read.views, read.gpu_ns, read.coalesced), (2, None, false));
    }
}
