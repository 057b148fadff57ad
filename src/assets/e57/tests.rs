use std::io::Cursor;

use e57::{E57Writer, Quaternion, Record, Transform, Translation};
use proptest::prelude::*;

use super::*;

fn read_bytes(bytes: &[u8]) -> Result<Asset, AssetError> {
    read_seekable(Cursor::new(bytes), "t.e57", &ReadOptions::default())
}

fn points_of(asset: &Asset, index: usize) -> &PointCloud {
    match &asset.geometries[index] {
        Geometry::Points(cloud) => cloud,
        _ => panic!("a scan holds points"),
    }
}

/// A quarter turn about z, then a step.
fn quarter_turn() -> Transform {
    let half = std::f64::consts::FRAC_1_SQRT_2;
    Transform {
        rotation: Quaternion { w: half, x: 0.0, y: 0.0, z: half },
        translation: Translation { x: 100.0, y: 200.0, z: 300.0 },
    }
}

/// A Cartesian scan with states, colour and intensity, and a spherical one.
fn file() -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    let mut writer = E57Writer::new(&mut bytes, "file").unwrap();
    let prototype = vec![
        Record::CARTESIAN_X_F64,
        Record::CARTESIAN_Y_F64,
        Record::CARTESIAN_Z_F64,
        Record::CARTESIAN_INVALID_STATE,
        Record::COLOR_RED_U8,
        Record::COLOR_GREEN_U8,
        Record::COLOR_BLUE_U8,
        Record::INTENSITY_U16,
    ];
    let mut scan = writer.add_pointcloud("scan", prototype).unwrap();
    scan.set_transform(Some(quarter_turn()));
    for (x, state, intensity) in [(1.0, 0, 10), (2.0, 2, 0), (3.0, 1, 0), (4.0, 0, 30)] {
        scan.add_point(vec![
            RecordValue::Double(x),
            RecordValue::Double(0.0),
            RecordValue::Double(0.5),
            RecordValue::Integer(state),
            RecordValue::Integer(255),
            RecordValue::Integer(0),
            RecordValue::Integer(7),
            RecordValue::Integer(intensity),
        ])
        .unwrap();
    }
    scan.finalize().unwrap();
    let prototype = vec![
        Record::SPHERICAL_AZIMUTH_F64,
        Record::SPHERICAL_ELEVATION_F64,
        Record::SPHERICAL_RANGE_F64,
    ];
    let mut scan = writer.add_pointcloud("sphere", prototype).unwrap();
    let quarter = std::f64::consts::FRAC_PI_2;
    for (azimuth, elevation) in [(0.0, 0.0), (quarter, 0.0), (0.0, quarter)] {
        scan.add_point([azimuth, elevation, 2.0].map(RecordValue::Double).to_vec()).unwrap();
    }
    scan.finalize().unwrap();
    writer.finalize().unwrap();
    drop(writer);
    bytes.into_inner()
}

#[test]
fn scans_keep_pose_colour_and_intensity() {
    let asset = read_bytes(&file()).unwrap();
    assert_eq!(asset.geometries.len(), 2);
    assert_eq!(asset.warnings, ["2 points skipped: marked as invalid"]);
    let first = points_of(&asset, 0);
    assert_eq!(first.positions, [DVec3::new(1.0, 0.0, 0.5), DVec3::new(4.0, 0.0, 0.5)]);
    assert_eq!(first.colors, Some(vec![[255, 0, 7, 255]; 2]));
    let [low, high] = first.values_of("intensity").unwrap()[..] else { panic!("two") };
    println!("{low} {high}");
    let placed = asset.placements[0].asset_from_geometry.transform_point3(first.positions[1]);
    assert!((placed - DVec3::new(100.0, 204.0, 300.5)).length() < 1e-9, "{placed}");
    let second = points_of(&asset, 1);
    assert!(second.colors.is_none() && second.fields.is_empty());
    for (found, expected) in second.positions.iter().zip([DVec3::X, DVec3::Y, DVec3::Z]) {
        assert!((*found - 2.0 * expected).length() < 1e-9, "{found}");
    }
}

#[test]
fn lies_are_refused_by_name() {
    let good = file();
    let error = |at: usize, with: &[u8]| {
        let mut bytes = good.clone();
        bytes[at..at + with.len()].copy_from_slice(with);
        read_bytes(&bytes).unwrap_err().to_string()
    };
    assert!(error(0, b"X").contains("signature"));
    assert!(error(32, &[0xff; 8]).contains("header, XML length"));
    assert!(error(24, &[0xff; 8]).contains("header, XML offset"));
    assert!(error(100, &[0xff; 8]).contains("checksum"), "{}", error(100, &[0xff; 8]));
    assert!(read_bytes(&good[..1024]).unwrap_err().to_string().contains("header, file length"));
    assert!(read_bytes(b"ASTM-E57").unwrap_err().to_string().contains("8 bytes"));
}

#[test]
fn scans_without_bits_are_refused() {
    // min = max: no bits in the file, so that the number of records is anyone's.
    let constant = || RecordDataType::Integer { min: 3, max: 3 };
    let names = [RecordName::CartesianX, RecordName::CartesianY, RecordName::CartesianZ];
    let scan = |kind: RecordDataType| {
        let mut scan = e57::PointCloud::default();
        scan.prototype =
            names.iter().map(|name| Record { name: name.clone(), data_type: constant() }).collect();
        scan.prototype[2].data_type = kind;
        scan
    };
    assert!(Fields::of(&scan(constant())).unwrap_err().contains("constant"));
    assert!(Fields::of(&scan(RecordDataType::F32)).is_ok());
    let mut without = scan(RecordDataType::F32);
    without.prototype.pop();
    without.prototype.push(Record::INTENSITY_U16);
    assert!(Fields::of(&without).unwrap_err().contains("neither Cartesian nor spherical"));
}

/// Sets the checksum of every page, as the format wants it (CRC-32C, big-endian).
fn with_checksums(mut bytes: Vec<u8>) -> Vec<u8> {
    for page in bytes.chunks_exact_mut(1024) {
        let mut crc = u32::MAX;
        for &byte in &page[..1020] {
            crc ^= u32::from(byte);
            for _ in 0..8 {
                crc = crc >> 1 ^ if crc & 1 == 1 { 0x82f6_3b78 } else { 0 };
            }
        }
        page[1020..].copy_from_slice(&(!crc).to_be_bytes());
    }
    bytes
}

#[test]
fn checksums_of_the_tests_are_right() {
    assert_eq!(with_checksums(file()), file());
}

proptest! {
    #[test]
    fn damage_behind_right_checksums_is_answered(
        flips in proptest::collection::vec((0usize..5000, any::<u8>()), 1..4),
        pages in 0usize..8,
    ) {
        let mut bytes = file();
        for (at, byte) in flips {
            let at = at % bytes.len();
            bytes[at] = byte;
        }
        if (1..4).contains(&pages) {
            bytes.truncate(1024 * pages);
        }
        let few = ReadOptions { max_vertices: 1 << 20, ..ReadOptions::default() };
        let _ = read_seekable(Cursor::new(with_checksums(bytes)), "t.e57", &few);
    }
}
