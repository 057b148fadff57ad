//! Base 64 (RFC 4648), as formats put binary data into text.

/// Decodes text up to `most` bytes. Groups are padded or not, and a padded one may be followed by others, as where several
/// texts are joined. The alphabets for files and for addresses are both accepted, and blanks are passed over. `None` for any
/// other character.
pub(super) fn decode(text: &[u8], most: usize) -> Option<Vec<u8>> {
    let mut bytes = Vec::with_capacity((text.len() / 4 * 3 + 3).min(most.saturating_add(3)));
    let (mut bits, mut held) = (0u32, 0);
    for byte in text {
        let value = match byte {
            b'A'..=b'Z' => byte - b'A',
            b'a'..=b'z' => byte - b'a' + 26,
            b'0'..=b'9' => byte - b'0' + 52,
            b'+' | b'-' => 62,
            b'/' | b'_' => 63,
            b'=' => {
                held = 0;
                continue;
            }
            b'\r' | b'\n' | b' ' | b'\t' => continue,
            _ => return None,
        };
        bits = bits << 6 | u32::from(value);
        held += 6;
        if held >= 8 {
            held -= 8;
            bytes.push((bits >> held) as u8);
            if bytes.len() == most {
                break;
            }
        }
    }
    Some(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_are_decoded() {
        let all = |text: &str| decode(text.as_bytes(), usize::MAX);
        assert_eq!(all("SGFsbG8="), Some(b"Hallo".to_vec()));
        assert_eq!(all("SGFsbG8"), Some(b"Hallo".to_vec()));
        assert_eq!(all("SGFs\n bG8h"), Some(b"Hallo!".to_vec()));
        assert_eq!(all("_-8="), all("/+8="));
        assert_eq!(all("SA==SGFsbG8="), Some(b"HHallo".to_vec()), "joined");
        assert_eq!(all("*"), None);
        assert_eq!(all(""), Some(Vec::new()));
        assert_eq!(decode(b"SGFsbG8*", 4), Some(b"Hall".to_vec()));
    }
}
