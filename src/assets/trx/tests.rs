use std::io::{Cursor, Write};

use half::f16;
use proptest::prelude::*;
use zip::ZipWriter;
use zip::write::SimpleFileOptions;

use super::*;
use crate::assets::first::lines;
use crate::memory::{Admission, HostMemory, Interrupt};

fn read_with(bytes: Vec<u8>, options: &ReadOptions) -> Result<Asset, AssetError> {
    read_seekable(Cursor::new(bytes), "a.trx", options)
}

fn read(bytes: Vec<u8>) -> Result<Asset, AssetError> {
    read_with(bytes, &ReadOptions::default())
}

const STREAMLINES: [&[[f64; 3]]; 2] = [
    &[[0.5, -1.25, 2.0], [4.5, -1.25, 2.0]],
    &[[4.0, 5.0, 6.0], [4.0, 8.0, 6.0], [4.0, 8.0, 11.5]],
];

/// A file under construction.
#[derive(Clone)]
struct TrxFile {
    entries: Vec<(String, Vec<u8>)>,
    is_deflated: bool,
}

impl Default for TrxFile {
    /// Two streamlines of two and three vertices.
    fn default() -> TrxFile {
        TrxFile { entries: vec![], is_deflated: false }
            .with("header.json", header(2, 5))
            .with("positions.3.float32", numbers("float32", &places()))
            .with("offsets.uint64", numbers("uint64", &[0.0, 2.0, 5.0]))
    }
}

impl TrxFile {
    /// Adds an entry or changes it.
    fn with(mut self, name: &str, bytes: Vec<u8>) -> TrxFile {
        self.entries.retain(|(known, _)| known != name);
        self.entries.push((name.to_owned(), bytes));
        self
    }

    fn without(mut self, name: &str) -> TrxFile {
        self.entries.retain(|(known, _)| known != name);
        self
    }

    fn deflated(mut self) -> TrxFile {
        self.is_deflated = true;
        self
    }

    fn bytes(&self) -> Vec<u8> {
        let method = if self.is_deflated {
            zip::CompressionMethod::Deflated
        } else {
            zip::CompressionMethod::Stored
        };
        let options = SimpleFileOptions::default().compression_method(method);
        let mut writer = ZipWriter::new(Cursor::new(Vec::new()));
        for (name, bytes) in &self.entries {
            writer.start_file(name.as_str(), options).unwrap();
            writer.write_all(bytes).unwrap();
        }
        writer.finish().unwrap().into_inner()
    }

    fn error(&self) -> String {
        let error = read(self.bytes()).unwrap_err().to_string();
        assert!(error.starts_with("a.trx: "), "{error}");
        error
    }
}

fn header(streamlines: u64, vertices: u64) -> Vec<u8> {
    format!(
        r#"{{"DIMENSIONS": [4000000, 5, 6], "VOXEL_TO_RASMM": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]],
            "NB_STREAMLINES": {streamlines}, "NB_VERTICES": {vertices}}}"#
    )
    .into_bytes()
}

fn places() -> Vec<f64> {
    STREAMLINES.concat().concat()
}

fn vertices() -> Vec<DVec3> {
    STREAMLINES.concat().into_iter().map(DVec3::from_array).collect()
}

fn numbers(kind: &str, numbers: &[f64]) -> Vec<u8> {
    let bytes = |number: f64| match kind {
        "bit" | "uint8" => vec![number as u8],
        "int8" => (number as i8).to_le_bytes().to_vec(),
        "int16" => (number as i16).to_le_bytes().to_vec(),
        "uint16" => (number as u16).to_le_bytes().to_vec(),
        "int32" => (number as i32).to_le_bytes().to_vec(),
        "uint32" => (number as u32).to_le_bytes().to_vec(),
        "int64" => (number as i64).to_le_bytes().to_vec(),
        "uint64" => (number as u64).to_le_bytes().to_vec(),
        "float16" => f16::from_f64(number).to_le_bytes().to_vec(),
        "float32" => (number as f32).to_le_bytes().to_vec(),
        "float64" => number.to_le_bytes().to_vec(),
        _ => panic!("{kind}"),
    };
    numbers.iter().flat_map(|number| bytes(*number)).collect()
}

/// The values of a field at all vertices.
fn values(asset: &Asset, name: &str) -> Vec<f64> {
    let fields = &lines(asset).fields;
    let field = fields.list().iter().find(|field| field.name == name);
    let field = field.unwrap_or_else(|| panic!("no field {name}: {:?}", fields.list()));
    (0..fields.points()).map(|vertex| field.value(fields.at(vertex)).unwrap()).collect()
}

#[test]
fn positions_and_offsets_of_every_type_are_read() {
    for positions in ["float16", "float32", "float64"] {
        for (offsets, has_end) in
            [("uint32", false), ("uint32", true), ("uint64", false), ("uint64", true)]
        {
            let first = if has_end { &[0.0, 2.0, 5.0][..] } else { &[0.0, 2.0] };
            let file = TrxFile { entries: vec![], is_deflated: false }
                .with(&format!("positions.3.{positions}"), numbers(positions, &places()))
                .with(&format!("offsets.{offsets}"), numbers(offsets, first))
                .with("header.json", header(2, 5));
            for file in [file.clone(), file.deflated()] {
                let asset = read(file.bytes()).unwrap();
                assert!(asset.warnings.is_empty(), "{:?}", asset.warnings);
                assert_eq!(asset.format, "trx");
                let lines = lines(&asset);
                assert_eq!(lines.strands, [0, 2, 5]);
                assert_eq!(lines.positions, vertices());
                let colors = lines.colors.as_ref().unwrap();
                assert_eq!((colors[0], colors[2]), ([255, 0, 0, 255], [0, 255, 0, 255]));
                assert_eq!(colors[4], [0, 0, 255, 255]);
                assert!(lines.fields.is_empty() && lines.radii.is_none());
            }
        }
    }
}

#[test]
fn data_and_groups_are_fields() {
    let file = TrxFile::default()
        .with("dpv/fa.float16", numbers("float16", &[0.5, 0.75, 0.5, 1.0, 0.25]))
        .with("dps/algo.1.uint8", numbers("uint8", &[3.0, 7.0]))
        .with("dps/algo.json", b"{}".to_vec())
        .with("dps/end.2.int16", numbers("int16", &[-1.0, 2.0, 30.0, 40.0]))
        .with("groups/AF_L.uint32", numbers("uint32", &[1.0]))
        .with("groups/none.uint32", vec![])
        .with("dpg/AF_L/mean_fa.float16", numbers("float16", &[0.5]));
    for file in [file.clone(), file.deflated()] {
        let asset = read(file.bytes()).unwrap();
        assert!(asset.warnings.is_empty(), "{:?}", asset.warnings);
        let fa = values(&asset, "fa");
        assert!(fa.iter().zip([0.5, 0.75, 0.5, 1.0, 0.25]).all(|(a, b)| (a - b).abs() < 1e-4));
        assert_eq!(values(&asset, "algo"), [3.0, 3.0, 7.0, 7.0, 7.0]);
        assert_eq!(values(&asset, "end_0"), [-1.0, -1.0, 30.0, 30.0, 30.0]);
        assert_eq!(values(&asset, "end_1"), [2.0, 2.0, 40.0, 40.0, 40.0]);
        assert_eq!(values(&asset, "AF_L"), [0.0, 0.0, 1.0, 1.0, 1.0]);
        // Nothing is in the group, which tells nothing.
        assert_eq!(lines(&asset).fields.list().len(), 5);
    }
}

/// Written by trx-python 0.6, deflated, as `data_and_groups_are_fields` has it.
#[test]
fn files_of_trx_python_are_read() {
    let asset = read(include_bytes!("trx_python.trx").to_vec()).unwrap();
    assert!(asset.warnings.is_empty(), "{:?}", asset.warnings);
    assert_eq!(lines(&asset).strands, [0, 2, 5]);
    assert_eq!(lines(&asset).positions, vertices());
    assert_eq!(values(&asset, "id"), [3.0, 3.0, 7.0, 7.0, 7.0]);
    assert_eq!(values(&asset, "end_1"), [2.0, 2.0, 40.0, 40.0, 40.0]);
    assert_eq!(values(&asset, "AF_L"), [0.0, 0.0, 1.0, 1.0, 1.0]);
    let fa = values(&asset, "fa");
    assert!(fa.iter().zip([0.5, 0.75, 0.5, 1.0, 0.25]).all(|(a, b)| (a - b).abs() < 1e-4));
}

/// Writers that cannot seek put sizes behind the data, and large files have them in 64 bits.
#[test]
fn streamed_and_large_archives_are_read() {
    let options = SimpleFileOptions::default()
        .compression_method(zip::CompressionMethod::Deflated)
        .large_file(true);
    let mut writer = ZipWriter::new_stream(Vec::new());
    for (name, bytes) in TrxFile::default().entries {
        writer.start_file(name, options).unwrap();
        writer.write_all(&bytes).unwrap();
    }
    let bytes = writer.finish().unwrap().into_inner();
    assert_eq!(lines(&read(bytes).unwrap()).strands, [0, 2, 5]);
}

#[test]
fn data_of_every_type_are_read() {
    let kinds = [
        "bit", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "float16",
        "float32", "float64",
    ];
    for kind in kinds {
        let file = TrxFile::default()
            .with(&format!("dps/a.b.{kind}"), numbers(kind, &[1.0, 0.0]))
            .deflated();
        assert_eq!(values(&read(file.bytes()).unwrap(), "a.b"), [1.0, 1.0, 0.0, 0.0, 0.0]);
    }
}

#[test]
fn fields_that_do_not_fit_are_named() {
    let mut file = TrxFile::default();
    for group in 0..70 {
        file = file.with(&format!("groups/g{group:02}.uint32"), numbers("uint32", &[1.0]));
    }
    // Before the groups, wherever it lies.
    file = file.with("dpv/fa.float32", numbers("float32", &[0.5, 0.75, 0.5, 1.0, 0.25]));
    let asset = read(file.bytes()).unwrap();
    let warnings = asset.warnings.join("\n");
    assert!(warnings.contains("7 entries are left out: up to 64 columns"), "{warnings}");
    assert!(warnings.contains("the first is \"groups/g63.uint32\""), "{warnings}");
    assert!(warnings.contains("a point keeps 64 bits of fields"), "{warnings}");
    assert_eq!(lines(&asset).fields.list().len(), 1 + 48);
}

#[test]
fn data_called_colours_are_colours() {
    let bytes = [255.0, 0.0, 128.0].repeat(5);
    let color = |name: &str, kind: &str, numbers: Vec<u8>| {
        let asset = read(TrxFile::default().with(&format!("{name}.{kind}"), numbers).bytes());
        let asset = asset.unwrap();
        assert!(lines(&asset).fields.is_empty() && asset.warnings.is_empty());
        lines(&asset).colors.clone().unwrap()
    };
    for name in ["dpv/color.3", "dpv/RGB.3"] {
        let found = color(name, "uint8", numbers("uint8", &bytes));
        assert_eq!(found, [[255, 0, 128, 255]; 5]);
    }
    let found = color("dpv/colors.3", "float32", numbers("float32", &[1.0, 0.0, 0.5].repeat(5)));
    assert_eq!(found, [[255, 0, 128, 255]; 5]);
    let found = color("dpv/colors.3", "float16", numbers("float16", &bytes));
    assert_eq!(found, [[255, 0, 128, 255]; 5]);
    let found = color("dps/colors.3", "uint8", numbers("uint8", &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]));
    assert_eq!((found[1], found[2]), ([1, 2, 3, 255], [4, 5, 6, 255]));
}

#[test]
fn streamlines_without_a_line_are_left_out() {
    let mut places = places();
    places[9] = f64::NAN;
    let file = TrxFile::default()
        .with("header.json", header(5, 5))
        .with("offsets.uint64", numbers("uint64", &[0.0, 0.0, 2.0, 2.0, 5.0]))
        .with("positions.3.float32", numbers("float32", &places))
        .with("dps/id.uint8", numbers("uint8", &[1.0, 2.0, 3.0, 4.0, 5.0]));
    let asset = read(file.bytes()).unwrap();
    assert_eq!(lines(&asset).strands, [0, 2]);
    assert_eq!(values(&asset, "id"), [2.0, 2.0]);
    assert!(asset.warnings[0].contains("non-finite"), "{:?}", asset.warnings);
    let nothing = TrxFile::default()
        .with("header.json", header(0, 0))
        .with("offsets.uint64", vec![])
        .with("positions.3.float32", vec![]);
    assert!(nothing.error().contains("holds no strands"));
}

#[test]
fn large_arrays_are_read_in_blocks() {
    let count = 50_000u32;
    let places: Vec<f64> = (0..count).flat_map(|i| [f64::from(i), 0.5, 0.5]).collect();
    let ids: Vec<f64> = (0..count).map(|i| f64::from(i % 1000)).collect();
    let file = TrxFile::default()
        .with("header.json", header(1, count.into()))
        .with("offsets.uint64", numbers("uint64", &[0.0]))
        .with("positions.3.float32", numbers("float32", &places))
        .with("dpv/id.uint16", numbers("uint16", &ids));
    for file in [file.clone(), file.deflated()] {
        let asset = read(file.bytes()).unwrap();
        let xs = lines(&asset).positions.iter().map(|place| place.x);
        assert!(xs.eq((0..count).map(f64::from)));
        assert_eq!(values(&asset, "id"), ids);
    }
}

#[test]
fn wrong_arrays_are_refused() {
    let file = TrxFile::default;
    let refused = [
        (file().without("header.json"), "has no entry header.json"),
        (file().without("positions.3.float32"), "has no entry positions.3.float16, positions"),
        (file().without("offsets.uint64"), "has no entry offsets.uint32 or offsets.uint64"),
        (file().with("header.json", b"[1]".to_vec()), "header.json: "),
        (file().with("header.json", b"{}".to_vec()), "missing field `NB_STREAMLINES`"),
        (file().with("header.json", vec![b' '; 2 << 20]), "up to 1048576 are read"),
        (
            file().with("header.json", header(2, 6)),
            "positions.3.float32: has 60 bytes, but the 6 vertices of header.json take 12 bytes each, 72",
        ),
        (
            file().with("header.json", header(4, 5)),
            "offsets.uint64: has 24 bytes, but the 4 streamlines of header.json take 8 bytes each, 32",
        ),
        (
            file().with("header.json", header(u64::MAX, 5)),
            "offsets.uint64: has 24 bytes, but the 18446744073709551615 streamlines",
        ),
        (
            file().with("header.json", header(2, u64::MAX)),
            "vertices (18446744073709551615) is over the limit of 2147483648",
        ),
        (
            file().with("positions.3.int16", vec![]),
            "positions.3.int16: has other rows; accepted are rows of 3 × float16 or float32",
        ),
        (file().with("positions.2.float32", vec![]), "accepted are rows of 3 ×"),
        (file().with("positions.3.float16", vec![]), "another entry holds the same"),
        (file().with("offsets.uint32", vec![]), "another entry holds the same"),
        (file().with("offsets.int64", vec![]), "accepted are rows of 1 × uint32 or uint64"),
        (
            file().with("offsets.uint64", numbers("uint64", &[1.0, 2.0, 5.0])),
            "offsets.uint64, streamline 0: begins at vertex 1; the first one begins at vertex 0",
        ),
        (
            file().with("offsets.uint64", numbers("uint64", &[0.0, 7.0])),
            "offsets.uint64, streamline 1: begins at vertex 7; header.json counts 5 vertices",
        ),
        (
            file()
                .with("header.json", header(3, 5))
                .with("offsets.uint64", numbers("uint64", &[0.0, 3.0, 2.0, 5.0])),
            "offsets.uint64, streamline 2: begins at vertex 2; the one before begins at 3",
        ),
        (
            file().with("offsets.uint64", numbers("uint64", &[0.0, 2.0, 4.0])),
            "streamline 2: begins at vertex 4; the last offset is the number of vertices, 5",
        ),
        (
            file().with("dpv/fa.float32", vec![0; 19]),
            "dpv/fa.float32: has 19 bytes, but the 5 vertices of header.json take 4 bytes each, 20",
        ),
        (
            file().with("dps/id.2.uint8", vec![0; 3]),
            "dps/id.2.uint8: has 3 bytes, but the 2 stream",
        ),
        (
            file().with("groups/g.uint32", numbers("uint32", &[0.0, 2.0])),
            "groups/g.uint32, index 1: is streamline 2, but header.json counts 2",
        ),
        (
            file().with("groups/g.uint32", vec![0; 5]),
            "groups/g.uint32: has 5 bytes; accepted is a multiple of 4",
        ),
        (file().with("groups/g.float32", vec![]), "groups/g.float32: has other rows"),
    ];
    for (file, expected) in refused {
        for file in [file.clone(), file.deflated()] {
            let error = file.error();
            assert!(error.contains(expected), "{error}");
        }
    }
    let odd = file().with("dpv/x.complex64", vec![]).with("dpv/y.0.uint8", vec![]);
    let warnings = read(odd.with("README", vec![]).bytes()).unwrap().warnings;
    assert_eq!(warnings.len(), 3, "{warnings:?}");
    assert!(warnings[0].contains("entry \"dpv/x.complex64\" is ignored"), "{warnings:?}");
}

/// Places of `signature` in `bytes`.
fn places_of(bytes: &[u8], signature: &[u8; 4]) -> Vec<usize> {
    (0..bytes.len()).filter(|at| bytes[*at..].starts_with(signature)).collect()
}

#[test]
fn archives_that_lie_are_refused() {
    // The numbers of an entry in the directory lie at these places behind its signature.
    let (flags, method, packed, unpacked) = (8, 10, 20, 24);
    let error = |file: &TrxFile, entry: usize, at: usize, with: &[u8]| {
        let mut bytes = file.bytes();
        let place = places_of(&bytes, b"PK\x01\x02")[entry] + at;
        bytes[place..place + with.len()].copy_from_slice(with);
        read(bytes).unwrap_err().to_string()
    };
    let file = TrxFile::default();
    let encrypted = error(&file, 1, flags, &[1]);
    assert!(encrypted.contains("positions.3.float32: is encrypted"), "{encrypted}");
    let packed_so = error(&file, 2, method, &[12]);
    assert!(packed_so.contains("offsets.uint64: has compression "), "{packed_so}");
    assert!(packed_so.contains("accepted are stored and deflated"), "{packed_so}");
    let larger = error(&file, 1, unpacked, &1000u32.to_le_bytes());
    assert!(larger.contains("declares 1000 bytes, but its data hold at most 60"), "{larger}");
    let both = [4000u32.to_le_bytes(), 4000u32.to_le_bytes()].concat();
    let beyond = error(&file, 1, packed, &both);
    assert!(beyond.contains("declares 4000 bytes, more than the file has"), "{beyond}");
    let bomb = error(&file.clone().deflated(), 1, unpacked, &u32::MAX.to_le_bytes()[..3]);
    assert!(bomb.contains("declares 16777215 bytes, but its data hold"), "{bomb}");
    // Sixty bytes are declared, and other numbers come.
    let mut bytes = file.bytes();
    let place = places_of(&bytes, b"PK\x03\x04")[1] + 60;
    bytes[place] ^= 0xff;
    let checksum = read(bytes).unwrap_err().to_string();
    assert!(checksum.contains("positions.3.float32: is damaged or truncated"), "{checksum}");

    let twice = file.with("dpv/a.uint8", vec![1; 5]).with("dpv/b.uint8", vec![1; 5]).bytes();
    let text = twice.iter().map(|byte| char::from(*byte)).collect::<String>();
    let twice = text.replace("dpv/b", "dpv/a").chars().map(|character| character as u8).collect();
    let twice = read(twice).unwrap_err().to_string();
    assert!(twice.contains("two entries have the same name"), "{twice}");
}

/// The `zip` crate would make room for 300,000 entries in the first case, and for as many as a field of 64 bits says in the second.
#[test]
fn large_directories_are_refused_before_there_is_room_for_them() {
    let mut bytes = b"PK\x03\x04header.json".to_vec();
    bytes.extend(b"PK\x01\x02");
    bytes.resize(17 << 20, 0);
    let mut small = bytes.clone();
    small.extend(b"PK\x05\x06");
    small.extend([0, 0, 0, 0, 0xfe, 0xff, 0xfe, 0xff, 0, 0, 0, 0]);
    small.extend(15u32.to_le_bytes());
    small.extend([0, 0]);
    let error = read(small).unwrap_err().to_string();
    assert!(error.contains("ZIP directory: has 17825777 bytes; up to 16777216"), "{error}");

    let record = bytes.len() as u64;
    bytes.extend(b"PK\x06\x06");
    bytes.extend(44u64.to_le_bytes());
    bytes.extend([0; 12]);
    bytes.extend([300_000u64, 300_000, 1 << 40, 15].map(u64::to_le_bytes).concat());
    bytes.extend(b"PK\x06\x07\0\0\0\0");
    bytes.extend(record.to_le_bytes());
    bytes.extend(1u32.to_le_bytes());
    bytes.extend(b"PK\x05\x06\0\0\0\0");
    bytes.extend([0xff; 12]);
    bytes.extend([0, 0]);
    let error = read(bytes).unwrap_err().to_string();
    assert!(error.contains("up to 16777216 are read"), "{error}");
}

#[test]
fn limits_and_cancelling_end_a_load() {
    let count = 100_000u32;
    let file = TrxFile::default()
        .with("header.json", header(1, count.into()))
        .with("offsets.uint64", numbers("uint64", &[0.0]))
        .with("positions.3.float32", vec![0; 12 * count as usize]);
    for file in [file.clone(), file.deflated()] {
        let within = |memory: u64| {
            let admission = Admission::new(&HostMemory::new(memory));
            let options = ReadOptions { admission: admission.clone(), ..ReadOptions::default() };
            (read_with(file.bytes(), &options), admission.held())
        };
        let (refused, held) = within(1 << 20);
        let is_refused = matches!(refused, Err(AssetError::Interrupted(Interrupt::OutOfMemory(_))));
        assert!(is_refused && held <= 1 << 20, "{refused:?}");
        let (asset, held) = within(64 << 20);
        assert!(asset.is_ok() && held >= 28 * u64::from(count), "{held}");

        let admission = Admission::default();
        admission.cancel();
        let cancelled = ReadOptions { admission, ..ReadOptions::default() };
        let cancelled = read_with(file.bytes(), &cancelled);
        assert!(matches!(cancelled, Err(AssetError::Interrupted(Interrupt::Cancelled))));

        let few = ReadOptions { max_vertices: 99_999, ..ReadOptions::default() };
        let error = read_with(file.bytes(), &few).unwrap_err().to_string();
        assert!(error.contains("vertices (100000) is over the limit of 99999"), "{error}");
        let small = ReadOptions { max_decompressed_bytes: 1 << 20, ..ReadOptions::default() };
        let read = read_with(file.bytes(), &small);
        let is_large = matches!(read, Err(AssetError::TooLarge { what: "decompressed bytes", .. }));
        assert_eq!(is_large, file.is_deflated, "{read:?}");
    }
}

#[test]
fn files_are_recognised_by_content_or_name() {
    let folder = tempfile::tempdir().unwrap();
    let read = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        crate::assets::read(&path, &ReadOptions::default())
    };
    let bytes = TrxFile::default().bytes();
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    encoder.write_all(&bytes).unwrap();
    let packed = encoder.finish().unwrap();
    // The entry that the content is known by lies behind the first 8 KiB.
    let padding = TrxFile { entries: vec![], is_deflated: false }
        .with("dpg/a/padding.uint8", vec![0; 10_000]);
    let late = TrxFile {
        entries: [padding.entries, TrxFile::default().entries].concat(),
        ..TrxFile::default()
    };
    for (name, bytes) in [
        ("a.trx", &bytes),
        ("b", &bytes),
        ("c.zip", &bytes),
        ("d.trx.gz", &packed),
        ("e.TRX", &late.bytes()),
    ] {
        assert_eq!(lines(&read(name, bytes).unwrap()).strands, [0, 2, 5], "{name}");
    }
    let other = TrxFile { entries: vec![], is_deflated: false }.with("model.usdc", vec![0; 9]);
    let error = read("f.usdz", &other.bytes()).unwrap_err().to_string();
    assert!(error.contains("a ZIP archive (3MF, USDZ, KMZ) is not offered"), "{error}");
    let error = read("g.trx", b"no archive").unwrap_err().to_string();
    assert!(error.contains("g.trx: ZIP directory: is damaged or truncated"), "{error}");
}

/// A file with everything in it.
fn example() -> TrxFile {
    TrxFile::default()
        .with("dpv/color.3.uint8", vec![9; 15])
        .with("dps/id.uint16", numbers("uint16", &[1.0, 2.0]))
        .with("groups/g.uint32", numbers("uint32", &[1.0]))
}

/// The end of a directory stands behind what begins as the locator of a large archive, in a file of eight bytes.
#[test]
fn files_shorter_than_a_locator_are_refused() {
    let error = read(b"PK\x06\x07PK\x05\x06".to_vec()).unwrap_err().to_string();
    assert!(error.starts_with("a.trx: "), "{error}");
}

#[test]
fn truncated_files_are_refused() {
    for file in [example(), example().deflated()] {
        let whole = file.bytes();
        assert!(read(whole.clone()).is_ok());
        for length in 0..whole.len() {
            let error = read(whole[..length].to_vec()).unwrap_err().to_string();
            assert!(error.starts_with("a.trx: "), "{length}: {error}");
        }
    }
}

proptest! {
    #[test]
    fn damaged_bytes_never_panic(
        is_deflated: bool,
        damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        end in any::<prop::sample::Index>(),
        is_cut: bool,
    ) {
        let mut bytes = TrxFile { is_deflated, ..example() }.bytes();
        for (at, with) in damage {
            let at = at.index(bytes.len());
            bytes[at] = with;
        }
        if is_cut {
            bytes.truncate(end.index(bytes.len()));
        }
        let _ = read(bytes);
    }

    #[test]
    fn damaged_numbers_never_panic(
        header_json in "[{}:,\"0-9A-Z_ ]{0,40}",
        offsets in prop::collection::vec(0u64..8, 0..5),
        streamlines in 0u64..6,
        vertices in 0u64..7,
        is_json: bool,
    ) {
        let offsets: Vec<f64> = offsets.into_iter().map(|offset| offset as f64).collect();
        let json = if is_json { header(streamlines, vertices) } else { header_json.into_bytes() };
        let file = example().with("header.json", json).with("offsets.uint64", numbers("uint64", &offsets));
        let _ = read(file.bytes());
    }
}
