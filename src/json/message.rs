//! Messages about values of a wrong type, in the words of JSON.

/// Rewrites a message of serde about a value of a wrong type, range or length, which names types of Rust. Other messages stay.
pub fn plain(message: &str) -> String {
    rewritten(message).unwrap_or_else(|| message.to_owned())
}

fn rewritten(message: &str) -> Option<String> {
    let (message, position) = match message.rsplit_once(" at line ") {
        Some((message, position)) => (message, format!(" at line {position}")),
        None => (message, String::new()),
    };
    let (kind, rest) =
        message.split_once(' ').filter(|(word, _)| *word == "invalid")?.1.split_once(' ')?;
    // The value found may be any text; the expected type comes last.
    let (found, expected) = rest.rsplit_once(", expected ")?;
    let expected = expected_words(expected);
    match kind {
        "type:" | "value:" => {
            Some(format!("found {}{position}; expected {expected}", found_words(found)))
        }
        "length" => Some(format!("found {found} elements{position}; expected {expected}")),
        _ => None,
    }
}

/// A value that was found.
fn found_words(found: &str) -> String {
    let value =
        |kind: &str| found.strip_prefix(kind).map(|value| value.trim_matches('`').to_owned());
    let number = value("floating point ").or_else(|| value("integer "));
    match (number, found) {
        (Some(number), _) => format!("the number {number}"),
        (_, "map") => "an object".to_owned(),
        (_, "sequence") => "an array".to_owned(),
        (_, "unit value" | "null" | "Option value") => "null".to_owned(),
        _ => match (value("boolean "), found.strip_prefix("string ")) {
            (Some(boolean), _) => boolean,
            (None, Some(text)) => format!("the text {text}"),
            (None, None) => found.to_owned(),
        },
    }
}

/// A type that was expected.
fn expected_words(expected: &str) -> String {
    let whole = |least: String, most: String| format!("a whole number from {least} to {most}");
    match expected {
        "f32" | "f64" | "a number" => "a number".to_owned(),
        "u8" => whole(u8::MIN.to_string(), u8::MAX.to_string()),
        "u16" => whole(u16::MIN.to_string(), u16::MAX.to_string()),
        "u32" => whole(u32::MIN.to_string(), u32::MAX.to_string()),
        "i8" => whole(i8::MIN.to_string(), i8::MAX.to_string()),
        "i16" => whole(i16::MIN.to_string(), i16::MAX.to_string()),
        "i32" => whole(i32::MIN.to_string(), i32::MAX.to_string()),
        "u64" | "usize" => "a whole number from 0".to_owned(),
        "i64" | "isize" => "a whole number".to_owned(),
        "a boolean" => "`true` or `false`".to_owned(),
        "a string" | "string" => "a text".to_owned(),
        "a map" => "an object".to_owned(),
        "a sequence" => "an array".to_owned(),
        _ if expected.starts_with("struct ") => "an object".to_owned(),
        _ => match expected.rsplit_once(" of length ").or(expected.rsplit_once(" of size ")) {
            Some((_, size)) => format!("an array of {size} elements"),
            None => expected.to_owned(),
        },
    }
}

#[cfg(test)]
mod tests {
    use serde::Deserialize;

    use super::plain;

    #[derive(Deserialize)]
    #[allow(dead_code, reason = "only errors are looked at")]
    struct Everything {
        number: Option<f64>,
        whole: Option<u32>,
        is_so: Option<bool>,
        name: Option<String>,
        place: Option<[f64; 3]>,
        list: Option<Vec<f64>>,
        pair: Option<(u8, i32)>,
        inner: Option<Box<Everything>>,
    }

    #[test]
    fn types_are_told_in_the_words_of_json() {
        for (text, words) in [
            (r#"{"number": "fast"}"#, r#"found the text "fast"; expected a number"#),
            (
                r#"{"whole": -1}"#,
                "found the number -1; expected a whole number from 0 to 4294967295",
            ),
            (
                r#"{"whole": 1.5}"#,
                "found the number 1.5; expected a whole number from 0 to 4294967295",
            ),
            (r#"{"is_so": 1}"#, "found the number 1; expected `true` or `false`"),
            (r#"{"name": true}"#, "found true; expected a text"),
            (r#"{"name": {}}"#, "found an object; expected a text"),
            (r#"{"place": [1, 2]}"#, "found 2 elements; expected an array of 3 elements"),
            (
                r#"{"place": "a, expected b"}"#,
                r#"found the text "a, expected b"; expected an array of 3 elements"#,
            ),
            (r#"{"list": 7}"#, "found the number 7; expected an array"),
            (r#"{"pair": [1]}"#, "found 1 elements; expected an array of 2 elements"),
            (
                r#"{"pair": [1, [2]]}"#,
                "found an array; expected a whole number from -2147483648 to 2147483647",
            ),
            (r#"{"inner": 7}"#, "found the number 7; expected an object"),
        ] {
            let value: serde_json::Value = serde_json::from_str(text).unwrap();
            let error = serde_json::from_value::<Everything>(value).err().unwrap();
            assert_eq!(plain(&error.to_string()), words, "{error}");
        }
        let error = serde_json::from_str::<Everything>("{\"number\": []}").err().unwrap();
        assert_eq!(
            plain(&error.to_string()),
            "found an array at line 1 column 11; expected a number"
        );
        assert_eq!(plain("trailing characters at line 2"), "trailing characters at line 2");
        assert_eq!(plain("invalid"), "invalid");
    }
}
