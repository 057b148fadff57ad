//! LZF decompression.
//!
//! A control byte below 32 is followed by that many plus one literal bytes. Otherwise its upper
//! three bits hold a match length (7 adds the following byte) and its lower five, with one more
//! byte, the distance back: `length + 2` bytes are copied from `distance + 1` bytes before, where
//! source and target may overlap.

/// Three bytes of input give at most this much output; 264 bytes is the longest match.
const MAX_MATCH_BYTES: u64 = 264;

/// Expands `input` to exactly `length` bytes.
///
/// # Errors
/// Input that ends early, that reaches back before the start, or that gives more or fewer bytes.
/// Lengths that the input cannot reach are refused before anything is allocated.
pub(super) fn decompress(input: &[u8], length: u64) -> Result<Vec<u8>, String> {
    if length > (input.len() as u64 / 2 + 1).saturating_mul(MAX_MATCH_BYTES) {
        return Err(format!("{} bytes cannot expand to {length}", input.len()));
    }
    let length = length as usize;
    let mut output = Vec::with_capacity(length);
    let mut rest = input;
    let ends = || "ends within a run".to_owned();
    while let Some((&control, after)) = rest.split_first() {
        rest = after;
        if control < 32 {
            let (literals, after) =
                rest.split_at_checked(usize::from(control) + 1).ok_or_else(ends)?;
            output.extend_from_slice(literals);
            rest = after;
        } else {
            let mut take = || {
                let (&byte, after) = rest.split_first().ok_or_else(ends)?;
                rest = after;
                Ok::<usize, String>(byte.into())
            };
            let mut count = usize::from(control >> 5);
            if count == 7 {
                count += take()?;
            }
            let distance = (usize::from(control & 31) << 8 | take()?) + 1;
            let Some(start) = output.len().checked_sub(distance) else {
                return Err(format!("reaches {distance} bytes back at byte {}", output.len()));
            };
            copy_within(&mut output, start, count + 2);
        }
        if output.len() > length {
            return Err(format!("expands to more than {length} bytes"));
        }
    }
    if output.len() < length {
        return Err(format!("expands to {} of {length} bytes", output.len()));
    }
    Ok(output)
}

/// Appends `count` bytes from `start` on, which may run into the appended ones.
fn copy_within(output: &mut Vec<u8>, start: usize, count: usize) {
    let mut left = count;
    while left > 0 {
        let step = left.min(output.len() - start);
        output.extend_from_within(start..start + step);
        left -= step;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn literals_and_overlapping_matches() {
        // "abc", then 10 bytes from 3 back; 300 bytes from 1 back with the long form in two runs.
        assert_eq!(
            decompress(&[2, b'a', b'b', b'c', 0xe0, 1, 2], 13).unwrap(),
            b"abcabcabcabca"
        );
        assert_eq!(decompress(&[0, b'x', 0xe0, 255, 0, 0xe0, 25, 0], 299).unwrap(), [b'x'; 299]);
    }

    #[test]
    fn damage_is_described() {
        assert!(decompress(&[5, b'a'], 6).unwrap_err().contains("ends within"));
        assert!(decompress(&[0, b'a', 0x20, 9], 4).unwrap_err().contains("10 bytes back"));
        assert!(decompress(&[0, b'a'], 2).unwrap_err().contains("1 of 2"));
        assert!(decompress(&[1, b'a', b'b'], 1).unwrap_err().contains("more than 1"));
        assert!(decompress(&[0, b'a'], u32::MAX.into()).unwrap_err().contains("cannot expand"));
    }

    proptest! {
        #[test]
        fn anything_is_answered(input in proptest::collection::vec(any::<u8>(), 0..64), n in 0u64..5000) {
            if let Ok(output) = decompress(&input, n) {
                prop_assert_eq!(output.len() as u64, n);
            }
        }
    }
}
