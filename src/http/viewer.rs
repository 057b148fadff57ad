//! Serves the viewer: one page and its files, all embedded in the binary.
//!
//! Clients revalidate every file by its hash, so that a newer server never runs with an older page's scripts. The page may load
//! only these files and this server's answers ([`POLICY`]). A debug build with `POINTILLIST_VIEWER=src/viewer` reads the files
//! from that folder instead.

use std::borrow::Cow;
use std::fmt::Write;
use std::sync::LazyLock;

use axum::http::{HeaderMap, HeaderName, HeaderValue, header};
use axum::response::Response;
use serde_json::json;
use sha2::{Digest, Sha256};

use super::names::COMPANIONS;
use super::problem::{Kind, Problem};
use super::upload::MAX_FILES;
use super::{Segments, conditional};
use crate::assets;
use crate::spelling::nearest;

const HTML: &str = "text/html; charset=utf-8";
const CSS: &str = "text/css; charset=utf-8";
const JS: &str = "text/javascript; charset=utf-8";

/// Content security policy of the page.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self' blob: data:; media-src 'self' blob:; \
                      base-uri 'none'; form-action 'none'; frame-ancestors 'self'";

struct File {
    name: &'static str,
    text: &'static str,
}

macro_rules! files {
    ($($name:literal),* $(,)?) => {
        [$(File { name: $name, text: include_str!(concat!("../viewer/", $name)) }),*]
    };
}

/// The script that tells the page which files an upload takes, made of what the server declares.
static FORMATS: LazyLock<File> = LazyLock::new(|| {
    let models: Vec<&str> =
        assets::FORMATS.iter().copied().filter(|format| !COMPANIONS.contains(format)).collect();
    let text = format!(
        "// Formats that the server reads, files that belong to others, and the largest number of files in an upload.\n\
         export const MODELS = {};\nexport const COMPANIONS = {};\nexport const MOST_FILES = {MAX_FILES};\n",
        json!(models),
        json!(COMPANIONS),
    );
    File { name: "formats.js", text: text.leak() }
});

fn files() -> impl Iterator<Item = &'static File> {
    FILES.iter().chain([&*FORMATS])
}

/// The page comes first.
static FILES: [File; 31] = files![
    "index.html",
    "style.css",
    "curve.css",
    "accuracy.js",
    "address.js",
    "api.js",
    "app.js",
    "chart.js",
    "controls.js",
    "curve.js",
    "files.js",
    "film.js",
    "jobs.js",
    "link.js",
    "measure.js",
    "message.js",
    "overlay.js",
    "path.js",
    "pick.js",
    "player.js",
    "pose.js",
    "receipt.js",
    "recorder.js",
    "reel.js",
    "requests.js",
    "scenes.js",
    "settings.js",
    "store.js",
    "upload.js",
    "wipe.js",
    "zip.js",
];

/// The viewer page.
#[utoipa::path(
    get,
    path = "/",
    operation_id = "getViewer",
    tag = "service",
    responses(
        (status = 200, description = "The viewer", body = String, content_type = "text/html"),
        (status = 304, description = "The client has this version already"),
    ),
)]
pub async fn page(headers: HeaderMap) -> Result<Response, Problem> {
    answer(&FILES[0], &headers)
}

/// A file of the viewer page.
#[utoipa::path(
    get,
    path = "/viewer/{file}",
    operation_id = "getViewerFile",
    tag = "service",
    params(("file" = String, Path, description = "A script or style sheet that the page names")),
    responses(
        (status = 200, description = "The file", content(
            (String = "text/html"), (String = "text/css"), (String = "text/javascript"),
        )),
        (status = 304, description = "The client has this version already"),
    ),
)]
pub async fn file(
    Segments(name): Segments<String>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    match files().find(|file| file.name == name) {
        Some(file) => answer(file, &headers),
        None => {
            let shown: String = name.chars().take(64).collect();
            let problem = Problem::new(
                Kind::UnknownRoute,
                format!("the viewer has no file `{}`", shown.escape_debug()),
            );
            Err(match nearest(&shown, files().map(|file| file.name)) {
                Some(meant) => problem.accepted(format!("/viewer/{meant}")),
                None => problem.accepted("the files that the page at / names"),
            })
        }
    }
}

impl File {
    fn media_type(&self) -> &'static str {
        match self.name.rsplit_once('.') {
            Some((_, "css")) => CSS,
            Some((_, "js")) => JS,
            _ => HTML,
        }
    }

    fn text(&self) -> Cow<'static, str> {
        #[cfg(debug_assertions)]
        if let Some(folder) = std::env::var_os("POINTILLIST_VIEWER")
            && let Ok(text) = std::fs::read_to_string(std::path::Path::new(&folder).join(self.name))
        {
            return Cow::Owned(text);
        }
        Cow::Borrowed(self.text)
    }
}

fn answer(file: &File, headers: &HeaderMap) -> Result<Response, Problem> {
    let text = file.text();
    let facts: [(HeaderName, HeaderValue); 4] = [
        (header::CONTENT_TYPE, HeaderValue::from_static(file.media_type())),
        (header::CONTENT_SECURITY_POLICY, HeaderValue::from_static(POLICY)),
        (header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff")),
        (header::REFERRER_POLICY, HeaderValue::from_static("no-referrer")),
    ];
    conditional::revalidated(headers, &entity_tag(&text), (facts, text))
}

/// Returns a strong entity tag (quoted) of a text.
pub(super) fn entity_tag(text: &str) -> String {
    let digest: [u8; 32] = Sha256::digest(text.as_bytes()).into();
    let mut tag = String::from("\"");
    for byte in &digest[..12] {
        // Writing to a string cannot fail.
        let _ = write!(tag, "{byte:02x}");
    }
    tag.push('"');
    tag
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    /// Returns the files that a text names, as `./name.js` in scripts or `/viewer/name.css` in the page.
    fn named(text: &str) -> BTreeSet<&str> {
        text.split(['"', '\''])
            .filter_map(|word| word.strip_prefix("./").or_else(|| word.strip_prefix("/viewer/")))
            .collect()
    }

    #[test]
    fn every_file_that_is_named_is_served_and_the_other_way_round() {
        let known: BTreeSet<&str> = files().map(|file| file.name).collect();
        let mut all: BTreeSet<&str> = FILES.iter().flat_map(|file| named(file.text)).collect();
        assert!(all.insert("index.html"));
        assert_eq!(known, all);
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/src/viewer");
        let there = std::fs::read_dir(folder).unwrap().count();
        assert_eq!(there, FILES.len(), "files in {folder}");
        assert_eq!(FILES[0].name, "index.html");
    }

    #[test]
    fn the_page_takes_every_format_that_is_read() {
        let list = |name: &str| -> Vec<String> {
            let (_, rest) = FORMATS.text.split_once(&format!("const {name} = ")).unwrap();
            serde_json::from_str(rest.split_once(';').unwrap().0).unwrap()
        };
        let (models, companions) = (list("MODELS"), list("COMPANIONS"));
        for format in assets::FORMATS {
            let lists = [&models, &companions];
            let found = lists.iter().filter(|list| list.iter().any(|name| name == format)).count();
            assert_eq!(found, 1, "{format}");
        }
        // No other script repeats a list.
        for file in &FILES {
            assert!(!file.text.contains("'laz'"), "{}", file.name);
        }
        let page = FILES[0].text;
        assert!(page.contains("id=\"formats\"") && !page.contains("LAZ"));
    }

    #[test]
    fn the_page_has_nothing_that_its_policy_forbids() {
        for file in &FILES {
            assert!(!file.text.contains("style=\""), "{}", file.name);
            assert!(!file.text.contains("://cdn"), "{}", file.name);
            assert!(file.text.lines().count() < 600, "{} has grown too long", file.name);
        }
        let page = FILES[0].text;
        assert!(!page.contains("onclick=") && !page.contains("<style"), "inline code or style");
        for script in page.split("<script").skip(1) {
            assert!(script.contains("src=\"/viewer/"), "an inline script");
        }
    }
}
