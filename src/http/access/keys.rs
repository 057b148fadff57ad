//! The file of API keys, in one of two forms.
//!
//! A file whose name ends in `.toml` has a table `[[key]]` for each key, with its limits; any other file has a line for each key,
//! `name scope sha256hex`. Both hold hashes only.

use std::path::Path;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use serde::Deserialize;
use toml::Spanned;
use toml::value::{Datetime, Offset};

use super::signed;
use super::{ApiKey, Quotas, Scope};

/// Reads the keys of a file, whose form follows from its name.
///
/// # Errors
/// Names the line and, where there is one, the key at fault, or says that the file has no keys.
pub fn read(path: &Path, text: &str) -> Result<Vec<ApiKey>, String> {
    let is_toml = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("toml"));
    if is_toml { parse_tables(text) } else { parse_lines(text) }
}

fn scope(word: &str) -> Result<Scope, &'static str> {
    match word {
        "read" => Ok(Scope::Read),
        "write" => Ok(Scope::Write),
        "admin" => Ok(Scope::Admin),
        _ => Err("the scope must be read, write or admin"),
    }
}

const BAD_HASH: &str = "the hash must be 64 hexadecimal digits (sha256sum of the key)";
const HASH_TAKEN: &str = "another key has the same hash; give each holder a key of their own";
const NAME_TAKEN: &str = "the name is already used by another key";

fn all(keys: Vec<ApiKey>) -> Result<Vec<ApiKey>, String> {
    if keys.is_empty() { Err("the file has no keys".to_owned()) } else { Ok(keys) }
}

/// Reads one `name scope sha256hex` per line; comments begin with `#`.
fn parse_lines(text: &str) -> Result<Vec<ApiKey>, String> {
    let mut keys: Vec<ApiKey> = Vec::new();
    for (index, line) in text.lines().enumerate() {
        let line = line.split('#').next().unwrap_or_default().trim();
        if line.is_empty() {
            continue;
        }
        let fail = |what: &str| format!("line {}: {what}", index + 1);
        let words: Vec<&str> = line.split_whitespace().collect();
        let [name, word, hex] = words[..] else {
            return Err(fail(
                "expected `name scope sha256hex`; the name of a file in TOML must end in `.toml`",
            ));
        };
        let scope = scope(word).map_err(fail)?;
        let hash = parse_hash(hex).ok_or_else(|| fail(BAD_HASH))?;
        if keys.iter().any(|key| key.name == name) {
            return Err(fail(NAME_TAKEN));
        }
        if keys.iter().any(|key| key.hash == hash) {
            return Err(fail(HASH_TAKEN));
        }
        let (name, quotas) = (name.to_owned(), Quotas::default());
        keys.push(ApiKey { name, scope, expires: None, quotas, url_secret: None, hash });
    }
    all(keys)
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct KeyFile {
    #[serde(default)]
    key: Vec<Spanned<KeyTable>>,
}

/// One `[[key]]`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
struct KeyTable {
    id: Spanned<String>,
    hash: Spanned<String>,
    scope: Spanned<String>,
    expires: Option<Spanned<Datetime>>,
    scenes: Option<u64>,
    upload_mib: Option<u64>,
    device_ms_per_minute: Option<Spanned<u64>>,
    streams: Option<usize>,
    requests_per_second: Option<Spanned<f64>>,
    url_secret: Option<Spanned<String>>,
}

fn parse_tables(text: &str) -> Result<Vec<ApiKey>, String> {
    // The text of the error would quote the file, and what is in the wrong place may be a key.
    let file: KeyFile = toml::from_str(text).map_err(|error| {
        let at = error.span().map_or(0, |span| span.start);
        let line = 1 + text.bytes().take(at).filter(|byte| *byte == b'\n').count();
        format!("line {line}: {}", error.message())
    })?;
    let mut keys: Vec<ApiKey> = Vec::new();
    for table in file.key {
        let table = table.into_inner();
        let name = table.id.get_ref().clone();
        let fail = |at: usize, what: &str| {
            let line = 1 + text.bytes().take(at).filter(|byte| *byte == b'\n').count();
            format!("line {line}: key `{name}`: {what}")
        };
        let id_at = table.id.span().start;
        if name.is_empty() || name.chars().any(|c| c.is_whitespace() || c.is_control()) {
            return Err(fail(id_at, "the id must be a word without spaces"));
        }
        if keys.iter().any(|key| key.name == name) {
            return Err(fail(id_at, NAME_TAKEN));
        }
        let (at, word) = (table.scope.span().start, table.scope.get_ref());
        let scope = scope(word).map_err(|what| fail(at, what))?;
        let (at, hex) = (table.hash.span().start, table.hash.get_ref());
        let hash = parse_hash(hex).ok_or_else(|| fail(at, BAD_HASH))?;
        if keys.iter().any(|key| key.hash == hash) {
            return Err(fail(at, HASH_TAKEN));
        }
        let expires = table.expires.map(|time| {
            let what =
                "`expires` must be a date, or a time with an offset, as in 2030-01-31T12:00:00Z";
            instant(time.get_ref()).ok_or_else(|| fail(time.span().start, what))
        });
        let rate = table.requests_per_second.map(|rate| {
            let what = "`requests-per-second` must be from 0.01 to 100000";
            let is_fine = (0.01..=100_000.0).contains(rate.get_ref());
            if is_fine { Ok(*rate.get_ref()) } else { Err(fail(rate.span().start, what)) }
        });
        let device = table.device_ms_per_minute.map(|ms| {
            let what = "`device-ms-per-minute` must be from 1 to 60000";
            let is_fine = (1..=60_000).contains(ms.get_ref());
            if is_fine { Ok(*ms.get_ref()) } else { Err(fail(ms.span().start, what)) }
        });
        let quotas = Quotas {
            scenes: table.scenes,
            bytes: table.upload_mib.map(|mib| mib.saturating_mul(1 << 20)),
            device_ms_per_minute: device.transpose()?,
            streams: table.streams,
            requests_per_second: rate.transpose()?,
        };
        let url_secret = table.url_secret.map(|hex| {
            let at = hex.span().start;
            if !signed::is_plain(&name) {
                let what =
                    "a key with `url-secret` needs an id of letters, digits, `-`, `.` and `_`";
                return Err(fail(at, what));
            }
            let what = "`url-secret` must be at least 64 hexadecimal digits (openssl rand -hex 32)";
            signed::Secret::from_hex(hex.get_ref()).ok_or_else(|| fail(at, what))
        });
        let (expires, url_secret) = (expires.transpose()?, url_secret.transpose()?);
        keys.push(ApiKey { scope, expires, quotas, url_secret, hash, name });
    }
    all(keys)
}

/// Returns the instant of a date (at its beginning, UTC) or of a time with an offset.
pub fn instant(time: &Datetime) -> Option<SystemTime> {
    let date = time.date?;
    // Days from 1970-01-01 in the proleptic Gregorian calendar, by years that begin in March.
    let (month, day) = (i64::from(date.month), i64::from(date.day));
    let year = i64::from(date.year) - i64::from(month <= 2);
    let (era, of_era) = (year.div_euclid(400), year.rem_euclid(400));
    let of_year = (153 * ((month + 9) % 12) + 2) / 5 + day - 1;
    let days = era * 146_097 + of_era * 365 + of_era / 4 - of_era / 100 + of_year - 719_468;
    let (clock, minutes) = match (time.time, time.offset) {
        (None, None) => (0, 0),
        (Some(clock), Some(offset)) => {
            let seconds = clock.second.map_or(0, i64::from);
            let clock = (i64::from(clock.hour) * 60 + i64::from(clock.minute)) * 60 + seconds;
            let minutes = match offset {
                Offset::Z => 0,
                Offset::Custom { minutes } => i64::from(minutes),
            };
            (clock, minutes)
        }
        _ => return None,
    };
    let seconds = days * 86_400 + clock - minutes * 60;
    Some(UNIX_EPOCH + Duration::from_secs(u64::try_from(seconds).unwrap_or(0)))
}

fn parse_hash(hex: &str) -> Option<[u8; 32]> {
    if hex.len() != 64 || !hex.bytes().all(|byte| byte.is_ascii_hexdigit()) {
        return None;
    }
    let mut hash = [0; 32];
    for (byte, digits) in hash.iter_mut().zip(hex.as_bytes().chunks_exact(2)) {
        *byte = u8::from_str_radix(std::str::from_utf8(digits).ok()?, 16).ok()?;
    }
    Some(hash)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::http::access::Access;

    fn tables(text: &str) -> Result<Vec<ApiKey>, String> {
        read(Path::new("keys.toml"), text)
    }

    const HASH: &str = "0123456789abcdef0123456789abcdef0123456789abcdef0123456789abcdef";

    const OTHER_HASH: &str = "1123456789abcdef0123456789abcdef0123456789abcdef0123456789abcdef";

    #[test]
    fn a_table_has_limits() {
        let text = format!(
            "[[key]]\nid = \"studio\"\nscope = \"write\"\nhash = \"{HASH}\"\nexpires = 2000-03-01T01:00:00+01:00\n\
             scenes = 3\nupload-mib = 2\ndevice-ms-per-minute = 500\nstreams = 4\nrequests-per-second = 2.5\n\
             [[key]]\nid = \"eye\"\nscope = \"read\"\nhash = \"{OTHER_HASH}\"\n"
        );
        let keys = tables(&text).unwrap();
        let first = &keys[0];
        assert_eq!((first.name.as_str(), first.scope), ("studio", Scope::Write));
        assert_eq!(first.expires, Some(UNIX_EPOCH + Duration::from_secs(951_868_800)));
        let quotas = Quotas {
            scenes: Some(3),
            bytes: Some(2 << 20),
            device_ms_per_minute: Some(500),
            streams: Some(4),
            requests_per_second: Some(2.5),
        };
        assert_eq!(first.quotas, quotas);
        assert_eq!((keys[1].expires, keys[1].quotas), (None, Quotas::default()));
        let lines = read(Path::new("keys"), &format!("eye read {HASH}")).unwrap();
        assert_eq!(lines[0].name, "eye");
    }

    #[test]
    fn changes_of_keys_are_told_by_their_names() {
        let read = |text: &str| Access::Keys(tables(text).unwrap());
        let key = |id: &str, scope: &str, rest: &str| {
            format!("[[key]]\nid = \"{id}\"\nscope = \"{scope}\"\nhash = \"{HASH}\"\n{rest}")
        };
        let before = read(&key("anna", "read", "").replace(HASH, OTHER_HASH));
        assert!(before.changes(&before.clone()).is_empty());
        let open = Access::Open { cors_origins: Vec::new(), only_loopback: true };
        assert_eq!(open.changes(&before), ["anna added"]);
        assert_eq!(before.changes(&read(&key("bob", "read", ""))), ["bob added", "anna removed"]);
        // Another hash, scope or limit changes a key.
        let bob = read(&key("bob", "read", ""));
        let others = [key("bob", "write", ""), key("bob", "read", "streams = 2\n")];
        let other_hash = key("bob", "read", "").replace(HASH, OTHER_HASH);
        for other in others.iter().chain([&other_hash]) {
            assert_eq!(bob.changes(&read(other)), ["bob changed"]);
        }
    }

    #[test]
    fn faults_name_line_and_key() {
        let fault = |text: &str| tables(text).unwrap_err();
        let key = |rest: &str| {
            format!("\n[[key]]\nid = \"a\"\nscope = \"read\"\nhash = \"{HASH}\"\n{rest}")
        };
        for (rest, line, word) in [
            ("requests-per-second = 0.0", "line 6", "0.01"),
            ("device-ms-per-minute = 0", "line 6", "60000"),
            ("url-secret = \"abc\"", "line 6", "64"),
            ("expires = 10:00:00", "line 6", "expires"),
            ("expires = 2030-01-01T10:00:00", "line 6", "offset"),
            ("[[key]]\nid = \"a\"\nscope = \"read\"\nhash = \"x\"", "line 7", "already used"),
            ("[[key]]\nid = \"b\"\nscope = \"red\"\nhash = \"x\"", "line 8", "`b`"),
            ("[[key]]\nid = \"b\"\nscope = \"read\"\nhash = \"x\"", "line 9", "64"),
            (
                &format!("[[key]]\nid = \"b\"\nscope = \"read\"\nhash = \"{HASH}\""),
                "line 9",
                "same hash",
            ),
            ("[[key]]\nid = \"b c\"\nscope = \"read\"\nhash = \"x\"", "line 7", "spaces"),
        ] {
            let found = fault(&key(rest));
            assert!(found.starts_with(line) && found.contains(word), "{rest}: {found}");
        }
        assert!(fault(&key("quota = 3")).contains("quota"));
        assert!(fault(&key("scenes = \"many\"")).contains("line 6"));
        assert!(fault("").contains("no keys"));
    }

    #[test]
    fn dates_begin_at_midnight() {
        let days = |text: &str| {
            let time = instant(&text.parse().unwrap()).unwrap();
            time.duration_since(UNIX_EPOCH).unwrap().as_secs_f64() / 86_400.0
        };
        assert_eq!(days("1970-01-01"), 0.0);
        assert_eq!(days("1972-02-29"), 789.0);
        assert_eq!(days("2000-01-01"), 10_957.0);
        assert_eq!(days("2100-03-01"), 47_541.0);
        assert_eq!(days("1969-12-31"), 0.0);
    }
}
