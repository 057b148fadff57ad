//! Looks for NaN and infinities in values of any type, in what `Debug` prints.

use std::fmt::Debug;

/// Panics where a number in `value` is NaN or infinite. Strings in `value` may hold these words.
pub fn assert_finite(value: &impl Debug) {
    assert_without(&[b"NaN", b"inf"], value);
}

/// Panics where a number in `value` is NaN.
pub fn assert_numbers(value: &impl Debug) {
    assert_without(&[b"NaN"], value);
}

fn assert_without(words: &[&[u8]], value: &impl Debug) {
    let text = format!("{value:?}");
    if let Some(at) = find(words, &text) {
        let around = &text.as_bytes()[at.saturating_sub(200)..text.len().min(at + 3)];
        panic!("a number is not finite: …{}", String::from_utf8_lossy(around));
    }
}

/// The place of the first of these words outside strings.
fn find(words: &[&[u8]], text: &str) -> Option<usize> {
    let bytes = text.as_bytes();
    let (mut at, mut is_quoted) = (0, false);
    while at < bytes.len() {
        match bytes[at] {
            b'\\' if is_quoted => at += 1,
            b'"' => is_quoted = !is_quoted,
            byte if !is_quoted && byte.is_ascii_alphanumeric() => {
                let rest = &bytes[at..];
                let end = rest.iter().position(|&b| !b.is_ascii_alphanumeric() && b != b'_');
                let word = &rest[..end.unwrap_or(rest.len())];
                if words.contains(&word) {
                    return Some(at);
                }
                at += word.len();
                continue;
            }
            _ => {}
        }
        at += 1;
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    fn not_finite(text: &str) -> Option<usize> {
        find(&[b"NaN", b"inf"], text)
    }

    #[test]
    fn numbers_are_told_from_words() {
        for text in [format!("{:?}", [1.0, f64::NAN]), format!("{:?}", Some(-f32::INFINITY))] {
            assert!(not_finite(&text).is_some(), "{text}");
        }
        for value in ["NaN", "a\"inf", "\\", "\\\" inf"] {
            let text = format!("{:?}", (value, 'x', 1e300));
            assert_eq!(not_finite(&text), None, "{text}");
        }
        assert_eq!(not_finite("Info { inform: NaNs, max_inf: infinite }"), None);
    }
}
