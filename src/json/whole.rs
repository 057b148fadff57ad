//! Whole numbers as JSON Schema has them: `37.0` and `3.7e1` are the integer 37.

use std::fmt;

use serde::de::value::{F64Deserializer, I64Deserializer, U64Deserializer};
use serde::de::{Deserialize, Deserializer, Error, IntoDeserializer, Visitor};

/// A whole number, however it is written.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Whole<T>(pub T);

impl<'de, T: Deserialize<'de>> Deserialize<'de> for Whole<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Form<T>(std::marker::PhantomData<T>);
        impl<'de, T: Deserialize<'de>> Visitor<'de> for Form<T> {
            type Value = T;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a whole number")
            }
            fn visit_u64<E: Error>(self, number: u64) -> Result<T, E> {
                let number: U64Deserializer<E> = number.into_deserializer();
                T::deserialize(number)
            }
            fn visit_i64<E: Error>(self, number: i64) -> Result<T, E> {
                let number: I64Deserializer<E> = number.into_deserializer();
                T::deserialize(number)
            }
            fn visit_f64<E: Error>(self, number: f64) -> Result<T, E> {
                // Casts of what is no whole number, or out of range, do not come back as they went.
                if (number as u64) as f64 == number && number < u64::MAX as f64 {
                    return self.visit_u64(number as u64);
                }
                if (number as i64) as f64 == number && number < 0.0 {
                    return self.visit_i64(number as i64);
                }
                let number: F64Deserializer<E> = number.into_deserializer();
                T::deserialize(number)
            }
        }
        deserializer.deserialize_any(Form(std::marker::PhantomData)).map(Whole)
    }
}

/// For `deserialize_with`: a field that may be left out or `null`.
///
/// # Errors
/// The value is not a whole number, or the type cannot hold it.
pub fn optional<'de, D, T>(deserializer: D) -> Result<Option<T>, D::Error>
where
    D: Deserializer<'de>,
    T: Deserialize<'de>,
{
    Ok(Option::<Whole<T>>::deserialize(deserializer)?.map(|Whole(number)| number))
}

/// A whole number from a text, such as a value of a query.
pub fn from_text<T>(text: &str) -> Option<T>
where
    T: std::str::FromStr + for<'de> Deserialize<'de>,
{
    let written = || {
        let number: f64 = text.parse().ok()?;
        let number: F64Deserializer<serde::de::value::Error> = number.into_deserializer();
        Some(Whole::deserialize(number).ok()?.0)
    };
    text.parse().ok().or_else(written)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whole_numbers_may_be_written_with_a_fraction() {
        let read = |json: &str| serde_json::from_str::<Whole<u32>>(json).map(|whole| whole.0);
        for (json, number) in [("37", 37), ("37.0", 37), ("3.7e1", 37), ("-0.0", 0), ("1e3", 1000)]
        {
            assert_eq!(read(json).unwrap(), number, "{json}");
            assert_eq!(from_text::<u32>(json), Some(number), "{json}");
        }
        for json in ["37.5", "-1", "-1.0", "4294967296", "4294967296.0", "1e300", "\"37\"", "null"]
        {
            assert!(read(json).is_err(), "{json}");
            assert_eq!(from_text::<u32>(json), None, "{json}");
        }
        assert_eq!(from_text::<u64>("18446744073709551615"), Some(u64::MAX));
        assert_eq!(from_text::<u64>("18446744073709551616.0"), None);
        assert_eq!(from_text::<i32>("-2.0"), Some(-2));
        assert!(from_text::<u32>("nan").or(from_text("inf")).is_none());
    }

    #[test]
    fn what_is_no_whole_number_is_told() {
        let told = |json: &str| serde_json::from_str::<Whole<u32>>(json).unwrap_err().to_string();
        assert!(told("1.5").contains("floating point `1.5`, expected u32"), "{}", told("1.5"));
        assert!(told("-1").contains("integer `-1`, expected u32"), "{}", told("-1"));
        assert!(told("true").contains("expected a whole number"), "{}", told("true"));
    }
}
