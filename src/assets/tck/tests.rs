use proptest::prelude::*;

use super::*;
use crate::assets::first::lines;

fn read(bytes: Vec<u8>) -> Result<Asset, AssetError> {
    read_from(Input::from_bytes(bytes, "a.tck"), &ReadOptions::default())
}

const STREAMLINES: [&[[f64; 3]]; 2] = [
    &[[0.5, -1.25, 2.0], [1.0, 2.0, 3.0]],
    &[[4.0, 5.0, 6.0], [7.0, 8.0, 9.0], [10.0, 11.0, 12.5]],
];

/// The bytes of triples.
fn triples(datatype: &str, triples: &[[f64; 3]]) -> Vec<u8> {
    let numbers = triples.iter().flatten();
    match datatype {
        "Float32LE" => numbers.flat_map(|number| (*number as f32).to_le_bytes()).collect(),
        "Float32BE" => numbers.flat_map(|number| (*number as f32).to_be_bytes()).collect(),
        "Float64LE" => numbers.flat_map(|number| number.to_le_bytes()).collect(),
        _ => numbers.flat_map(|number| number.to_be_bytes()).collect(),
    }
}

/// A file with these header lines and data.
fn file(lines: &str, datatype: &str, data: &[u8]) -> Vec<u8> {
    let head = |offset: usize| {
        format!("mrtrix tracks\n{lines}datatype: {datatype}\nfile: . {offset:05}\nEND\n")
    };
    // Some room between header and data.
    let offset = head(0).len() + 3;
    let mut bytes = head(offset).into_bytes();
    bytes.extend_from_slice(b"???");
    bytes.extend_from_slice(data);
    bytes
}

fn whole(datatype: &str) -> Vec<u8> {
    let mut all: Vec<[f64; 3]> = Vec::new();
    for streamline in STREAMLINES {
        all.extend(streamline);
        all.push([f64::NAN; 3]);
    }
    all.push([f64::INFINITY; 3]);
    file("count: 2\n", datatype, &triples(datatype, &all))
}

#[test]
fn every_type_and_byte_order_is_read() {
    for datatype in ["Float32LE", "Float32BE", "Float64LE", "Float64BE"] {
        let asset = read(whole(datatype)).unwrap();
        let lines = lines(&asset);
        let expected: Vec<DVec3> =
            STREAMLINES.concat().into_iter().map(DVec3::from_array).collect();
        assert_eq!(lines.positions, expected, "{datatype}");
        assert_eq!(lines.strands, [0, 2, 5]);
        assert!(asset.warnings.is_empty() && lines.radii.is_none());
        // The direction (3, 3, 3) is grey, (0.5, 3.25, 1) mostly green.
        let colors = lines.colors.as_ref().unwrap();
        assert_eq!(colors[2], [147, 147, 147, 255]);
        assert_eq!(colors[0], [37, 241, 74, 255]);
    }
}

#[test]
fn counts_are_not_believed_and_odd_vertices_are_left_out() {
    let data = [
        [f64::NAN; 3],
        [0.0; 3],
        [1.0; 3],
        [2.0, f64::NAN, 2.0],
        [3.0; 3],
        [4.0; 3],
        [-f64::NAN; 3],
        [9.0; 3],
        [f64::INFINITY; 3],
        [5.0; 3],
    ];
    let asset = read(file("count: 615000\n", "Float32LE", &triples("Float32LE", &data))).unwrap();
    assert_eq!(lines(&asset).strands, [0, 2, 4]);
    assert_eq!(asset.warnings.len(), 3, "{:?}", asset.warnings);
    assert_eq!(asset.warnings[0], "the header counts 615000 streamlines, the file holds 2");
}

#[test]
fn damage_is_refused() {
    let whole = whole("Float32LE");
    for length in 0..whole.len() {
        let error = read(whole[..length].to_vec()).unwrap_err().to_string();
        assert!(error.starts_with("a.tck: "), "{error}");
    }
    let nothing = triples("Float32LE", &[[f64::INFINITY; 3]]);
    let with = |lines: &str| {
        let mut bytes = format!("mrtrix tracks\n{lines}END\n").into_bytes();
        bytes.extend_from_slice(&nothing);
        read(bytes).unwrap_err().to_string()
    };
    for (lines, expected) in [
        ("datatype: Float32LE\n", "the file holds no strands"),
        ("count: 1\n", "has no line \"datatype"),
        ("datatype: Int16LE\n", "accepted are Float32LE, Float32BE, Float64LE and Float64BE"),
        ("datatype: Float32LE\nfile: other.dat 0\n", "header line 3: file \"other.dat 0\""),
        ("datatype: Float32LE\nfile: . 3\n", "inside the header"),
        ("datatype: Float32LE\nfile: . 99999999999\n", "behind the end of the file"),
        ("datatype: Float32LE\nnonsense\n", "header line 3: \"nonsense\" is no \"key: value\""),
    ] {
        let error = with(lines);
        assert!(error.contains(expected), "{lines:?}: {error}");
    }
    let error = read(b"count: 0000000000\ndatatype: Float32LE\nEND\n".to_vec()).unwrap_err();
    let expected = "a.tck: header line 1: is \"count: 0000000000\"; a track file begins with \"mrtrix tracks\"";
    assert_eq!(error.to_string(), expected);
    let endless = [b"mrtrix tracks\nx: ".to_vec(), vec![b'x'; 5 << 20]].concat();
    assert!(read(endless).unwrap_err().to_string().contains("END is missing"));
}

/// Blocks end inside of streamlines.
#[test]
fn long_files_are_read_in_blocks() {
    let mut data: Vec<[f64; 3]> = (0..50_000).map(|i| [f64::from(i), 0.0, 0.0]).collect();
    data.push([f64::INFINITY; 3]);
    for datatype in ["Float32LE", "Float64BE"] {
        let asset = read(file("", datatype, &triples(datatype, &data))).unwrap();
        let lines = lines(&asset);
        assert_eq!(lines.strands, [0, 50_000]);
        assert!(lines.positions.iter().enumerate().all(|(i, p)| p.x == i as f64));
    }
}

proptest! {
    #[test]
    fn damaged_bytes_never_panic(at in 0usize..200, with in any::<u8>(), cut in 0usize..200) {
        let mut bytes = whole("Float64LE");
        let at = at % bytes.len();
        bytes[at] = with;
        bytes.truncate(bytes.len().saturating_sub(cut % 3));
        let _ = read(bytes);
    }
}
