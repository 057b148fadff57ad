//! What of settings decides the cost of a frame.

use serde_json::Value;

use super::{Settings, words};

impl Settings {
    /// Bytes that are equal for frames that cost about the same: the canonical form with numbers rounded to powers of two, and without
    /// lists of numbers.
    pub fn kind_of_cost(&self) -> Vec<u8> {
        let rounded = |(name, value): (&String, &Value)| match value {
            Value::Number(number) => {
                let octave = number.as_f64().map_or(0, |value| value.abs().log2().round() as i64);
                format!("{name}={octave};")
            }
            Value::Array(_) => format!("{name};"),
            other => format!("{name}={other};"),
        };
        words(&self.applied()).iter().flat_map(|word| rounded(word).into_bytes()).collect()
    }
}
