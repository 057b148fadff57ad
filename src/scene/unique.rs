//! Finds JSON objects that have a key twice. Most JSON readers, serde_json's maps among them, silently keep the last value.

use std::collections::HashSet;
use std::fmt::{self, Write as _};

use serde::de::{DeserializeSeed, Deserializer, Error, MapAccess, SeqAccess, Visitor};

/// A key that an object has more than once.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("duplicate key `{key}`; an object may have each key once")]
pub struct DuplicateKey {
    pub key: String,
    /// Place of the second one, as in `keys[3].eye`.
    pub path: String,
}

/// Reads a document without keeping it. A document that is no JSON is left to whoever parses it.
///
/// # Errors
/// The first key, in the order of the document, that its object has had before.
pub fn check_keys(json: &[u8]) -> Result<(), DuplicateKey> {
    let mut walk = Walk { path: String::new(), found: None };
    let mut deserializer = serde_json::Deserializer::from_slice(json);
    let _ = (&mut walk).deserialize(&mut deserializer);
    walk.found.map_or(Ok(()), Err)
}

/// Where the walk is, and what it has found.
struct Walk {
    path: String,
    found: Option<DuplicateKey>,
}

impl<'de> DeserializeSeed<'de> for &mut Walk {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for &mut Walk {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("JSON")
    }

    fn visit_bool<E: Error>(self, _: bool) -> Result<(), E> {
        Ok(())
    }

    fn visit_i64<E: Error>(self, _: i64) -> Result<(), E> {
        Ok(())
    }

    fn visit_u64<E: Error>(self, _: u64) -> Result<(), E> {
        Ok(())
    }

    fn visit_f64<E: Error>(self, _: f64) -> Result<(), E> {
        Ok(())
    }

    fn visit_str<E: Error>(self, _: &str) -> Result<(), E> {
        Ok(())
    }

    fn visit_unit<E: Error>(self) -> Result<(), E> {
        Ok(())
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<(), A::Error> {
        let length = self.path.len();
        for index in 0.. {
            // Writing to a string does not fail.
            let _ = write!(self.path, "[{index}]");
            let more = seq.next_element_seed(&mut *self)?.is_some();
            self.path.truncate(length);
            if !more {
                break;
            }
        }
        Ok(())
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<(), A::Error> {
        let length = self.path.len();
        let mut seen: HashSet<String> = HashSet::new();
        while let Some(key) = map.next_key::<String>()? {
            if length > 0 {
                self.path.push('.');
            }
            self.path.push_str(&key);
            if seen.contains(&key) {
                self.found = Some(DuplicateKey { key, path: std::mem::take(&mut self.path) });
                return Err(A::Error::custom("a key comes twice"));
            }
            seen.insert(key);
            map.next_value_seed(&mut *self)?;
            self.path.truncate(length);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_that_come_twice_are_found_where_they_are() {
        for (json, expected) in [
            (r#"{"a": 1, "b": {"a": [1, {"a": null}]}, "c": {"a": true}}"#, None),
            (r#"{"a": 1, "b": 2, "a": 1}"#, Some(("a", "a"))),
            (r#"{"keys": [{"t": 0}, {"t": -1.5, "eye": [], "t": "x"}]}"#, Some(("t", "keys[1].t"))),
            (r#"[[], [{"a": {"b": 1, "\u0062": 2}}]]"#, Some(("b", "[1][0].a.b"))),
            // The parser says what is wrong.
            (r#"{"a": 1, "b": }"#, None),
            ("", None),
        ] {
            let found = check_keys(json.as_bytes()).err();
            let found = found.as_ref().map(|found| (found.key.as_str(), found.path.as_str()));
            assert_eq!(found, expected, "{json}");
        }
        let deep = "[".repeat(100_000);
        assert_eq!(check_keys(deep.as_bytes()), Ok(()));
    }
}
