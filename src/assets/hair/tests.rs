use proptest::prelude::*;

use super::*;
use crate::assets::first::lines;

fn read(bytes: Vec<u8>) -> Result<Asset, AssetError> {
    read_from(Input::from_bytes(bytes, "a.hair"), &ReadOptions::default())
}

fn header(strands: u32, points: u32, arrays: u32, segments: u32) -> Vec<u8> {
    let mut bytes = b"HAIR".to_vec();
    for word in [strands, points, arrays, segments] {
        bytes.extend(word.to_le_bytes());
    }
    for number in [0.5f32, 0.0, 1.0, 0.5, 0.0] {
        bytes.extend(number.to_le_bytes());
    }
    bytes.resize(128, b' ');
    bytes
}

fn floats(bytes: &mut Vec<u8>, numbers: &[f32]) {
    bytes.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
}

/// Strands of three and two points, with all arrays.
fn whole() -> Vec<u8> {
    let mut bytes = header(2, 5, 31, 0);
    bytes.extend([2u16, 1].iter().flat_map(|segments| segments.to_le_bytes()));
    floats(&mut bytes, &(0..15).map(|i| i as f32).collect::<Vec<_>>());
    floats(&mut bytes, &[1.0, 0.5, 0.25, 2.0, 0.0]);
    floats(&mut bytes, &[0.0; 5]);
    floats(&mut bytes, &[0.0, 0.5, 1.0].repeat(5));
    bytes
}

#[test]
fn arrays_are_read() {
    let asset = read(whole()).unwrap();
    let lines = lines(&asset);
    assert_eq!(lines.strands, [0, 3, 5]);
    assert_eq!(lines.positions[4], DVec3::new(12.0, 13.0, 14.0));
    assert_eq!(lines.radii.as_ref().unwrap()[..], [0.5, 0.25, 0.125, 1.0, 0.0]);
    assert_eq!(lines.colors.as_ref().unwrap()[..], [[0, 128, 255, 255]; 5]);
    assert_eq!(asset.warnings, ["transparency is left out: strands are opaque"]);
}

#[test]
fn what_has_no_array_is_in_the_header() {
    let mut bytes = header(2, 4, 2, 1);
    floats(&mut bytes, &(0..12).map(|i| i as f32).collect::<Vec<_>>());
    let asset = read(bytes.clone()).unwrap();
    let lines = lines(&asset);
    assert_eq!(lines.strands, [0, 2, 4]);
    assert_eq!(lines.radii.as_ref().unwrap()[..], [0.25; 4]);
    assert_eq!(lines.colors.as_ref().unwrap()[..], [[255, 128, 0, 255]; 4]);
    assert!(asset.warnings.is_empty());
    bytes.push(0);
    assert_eq!(read(bytes).unwrap().warnings, ["what follows the arrays is ignored"]);
}

#[test]
fn damage_is_refused() {
    let whole = whole();
    for length in 0..whole.len() {
        let error = read(whole[..length].to_vec()).unwrap_err().to_string();
        assert!(error.starts_with("a.hair: "), "{length}: {error}");
    }
    let with = |bytes: Vec<u8>| read(bytes).unwrap_err().to_string();
    let mut few = header(2, 4, 2, 2);
    floats(&mut few, &[0.0; 12]);
    assert!(with(few).contains("strand 1: it has 2 segments, but there are 4 points only"));
    let mut many = header(1, 4, 2, 2);
    floats(&mut many, &[0.0; 12]);
    assert!(with(many).contains("the 1 strands have 3 points, the header announces 4"));
    assert!(with(header(1, 1 << 30, 2, 2)).contains("declares 1073741824"));
    assert!(with(header(9, 4, 2, 2)).contains("9 strands need more than 4 points"));
    assert!(with(header(1, 2, 1, 1)).contains("has no points"));
    assert!(with(b"HAIL".to_vec()).contains("does not begin with HAIR"));
}

proptest! {
    #[test]
    fn damaged_bytes_never_panic(at in 0usize..300, with in any::<u8>(), cut in 0usize..3) {
        let mut bytes = whole();
        let at = at % bytes.len();
        bytes[at] = with;
        bytes.truncate(bytes.len() - cut);
        let _ = read(bytes);
    }
}
