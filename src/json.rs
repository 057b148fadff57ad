//! Counts what a JSON text holds before anything is made of it (floor 0).
//!
//! Three bytes of JSON, `{},`, may become hundreds in memory. [`count`] walks a text without keeping any of it, stops at
//! the first limit, and tells how much there is, so that memory can be reserved before the text is parsed.

mod message;
mod text;
pub mod whole;

pub use message::plain;
pub(crate) use text::as_text;

use std::fmt;

use serde::de::{DeserializeSeed, Deserializer, MapAccess, SeqAccess, Visitor};

/// Limits of a text.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// Objects in arrays that are called `nodes` or `children`.
    pub nodes: u64,
    pub objects: u64,
    /// Lists, strings, numbers, `true`, `false` and `null`.
    pub values: u64,
    /// Bytes of one string.
    pub string_bytes: u64,
}

/// Counts of a text.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Census {
    pub nodes: u64,
    pub objects: u64,
    /// Lists, strings, numbers, `true`, `false` and `null`; keys are not counted.
    pub values: u64,
    /// Bytes of all strings and keys.
    pub text_bytes: u64,
}

/// A limit that a text passes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Excess {
    pub what: &'static str,
    pub found: u64,
    pub limit: u64,
}

/// Bytes of a value in memory.
const VALUE_BYTES: u64 = 24;

impl Census {
    /// Bytes that the text takes in memory where an object takes `object_bytes`.
    pub fn bytes(&self, object_bytes: usize) -> u64 {
        self.objects.saturating_mul(object_bytes as u64)
            + self.values * VALUE_BYTES
            + self.text_bytes
    }
}

/// Counts up to the first limit. A text that is no JSON is counted up to its first fault, which is its parser's to tell.
///
/// # Errors
/// The limit that the text passes.
pub fn count(text: &[u8], limits: &Limits) -> Result<Census, Excess> {
    let mut count = Count { limits, census: Census::default(), excess: None };
    let mut json = serde_json::Deserializer::from_slice(text);
    let _ = Value { count: &mut count, is_node: false, holds_nodes: false }.deserialize(&mut json);
    match count.excess {
        Some(excess) => Err(excess),
        None => Ok(count.census),
    }
}

struct Count<'a> {
    limits: &'a Limits,
    census: Census,
    excess: Option<Excess>,
}

impl Count<'_> {
    /// Refuses `found` above `limit`.
    fn check<E: serde::de::Error>(
        &mut self,
        what: &'static str,
        found: u64,
        limit: u64,
    ) -> Result<(), E> {
        if found <= limit {
            return Ok(());
        }
        self.excess = Some(Excess { what, found, limit });
        Err(E::custom(what))
    }

    fn value<E: serde::de::Error>(&mut self) -> Result<(), E> {
        self.census.values += 1;
        self.check("values in JSON", self.census.values, self.limits.values)
    }

    fn text<E: serde::de::Error>(&mut self, text: &str) -> Result<(), E> {
        let bytes = text.len() as u64;
        self.census.text_bytes += bytes;
        self.check("bytes of a string in JSON", bytes, self.limits.string_bytes)
    }
}

/// One value, of which nothing is kept.
struct Value<'c, 'l> {
    count: &'c mut Count<'l>,
    /// Whether the value is an element of a list of nodes.
    is_node: bool,
    /// Whether the elements of the value are nodes.
    holds_nodes: bool,
}

impl<'de> DeserializeSeed<'de> for Value<'_, '_> {
    type Value = ();
    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for Value<'_, '_> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("JSON")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<(), A::Error> {
        self.count.census.objects += 1;
        let (objects, limits) = (self.count.census.objects, self.count.limits);
        self.count.check("objects in JSON", objects, limits.objects)?;
        if self.is_node {
            self.count.census.nodes += 1;
            self.count.check("nodes", self.count.census.nodes, limits.nodes)?;
        }
        loop {
            let mut holds_nodes = false;
            let key = Key { count: self.count, holds_nodes: &mut holds_nodes };
            if map.next_key_seed(key)?.is_none() {
                return Ok(());
            }
            map.next_value_seed(Value { count: self.count, is_node: false, holds_nodes })?;
        }
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<(), A::Error> {
        self.count.value()?;
        let is_node = self.holds_nodes;
        while list
            .next_element_seed(Value { count: self.count, is_node, holds_nodes: false })?
            .is_some()
        {}
        Ok(())
    }

    fn visit_str<E: serde::de::Error>(self, text: &str) -> Result<(), E> {
        self.count.value()?;
        self.count.text(text)
    }

    fn visit_bool<E: serde::de::Error>(self, _: bool) -> Result<(), E> {
        self.count.value()
    }

    fn visit_u64<E: serde::de::Error>(self, _: u64) -> Result<(), E> {
        self.count.value()
    }

    fn visit_i64<E: serde::de::Error>(self, _: i64) -> Result<(), E> {
        self.count.value()
    }

    fn visit_f64<E: serde::de::Error>(self, _: f64) -> Result<(), E> {
        self.count.value()
    }

    fn visit_unit<E: serde::de::Error>(self) -> Result<(), E> {
        self.count.value()
    }
}

struct Key<'c, 'l> {
    count: &'c mut Count<'l>,
    holds_nodes: &'c mut bool,
}

impl<'de> DeserializeSeed<'de> for Key<'_, '_> {
    type Value = ();
    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_str(self)
    }
}

impl<'de> Visitor<'de> for Key<'_, '_> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a key")
    }

    fn visit_str<E: serde::de::Error>(self, key: &str) -> Result<(), E> {
        *self.holds_nodes = matches!(key, "nodes" | "children");
        self.count.text(key)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: Limits = Limits { nodes: 3, objects: 5, values: 9, string_bytes: 8 };

    fn excess(text: &str) -> (&'static str, u64) {
        let Excess { what, found, .. } = count(text.as_bytes(), &LIMITS).unwrap_err();
        (what, found)
    }

    #[test]
    fn everything_is_counted() {
        let text =
            r#"{"a": [1, -2, 0.5, true, null, "xy"], "nodes": [{}, {"children": [{}]}], "b": {}}"#;
        let census = count(text.as_bytes(), &LIMITS).unwrap();
        let expected = Census { nodes: 3, objects: 5, values: 9, text_bytes: 2 + 1 + 5 + 8 + 1 };
        assert_eq!(census, expected);
        assert_eq!(census.bytes(100), 500 + 9 * VALUE_BYTES + 17);
    }

    #[test]
    fn counting_ends_at_the_first_limit() {
        assert_eq!(excess(r#"{"nodes": [{}, {}, {}, {}, {}, {}"#), ("nodes", 4));
        assert_eq!(excess("[{}, {}, {}, {}, {}, {}, 7"), ("objects in JSON", 6));
        assert_eq!(excess("[1, [], [], [], [], [], [], [], 8, 9"), ("values in JSON", 10));
        assert_eq!(excess(r#"["123456789"]"#), ("bytes of a string in JSON", 9));
        assert_eq!(excess(r#"{"123456789": 1}"#), ("bytes of a string in JSON", 9));
    }

    #[test]
    fn faults_are_left_to_the_parser() {
        let deep = "[".repeat(100_000);
        let limits = Limits { values: 1000, ..LIMITS };
        for text in ["", "{", "[1,", "nonsense", "{\"a\"}", deep.as_str()] {
            assert!(count(text.as_bytes(), &limits).is_ok());
        }
    }
}
