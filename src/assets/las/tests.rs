use std::io::Cursor;

use glam::DVec3;
use las::point::{Classification, Format};
use las::{Builder, Color, Point, Transform, Vector, Writer};
use proptest::prelude::*;

use super::*;

fn read_bytes(bytes: &[u8]) -> Result<Asset, AssetError> {
    read_seekable(Cursor::new(bytes), "t.las", &ReadOptions::default())
}

fn points_of(asset: &Asset) -> &PointCloud {
    match &asset.geometries[0] {
        Geometry::Points(cloud) => cloud,
        _ => panic!("a LAS file holds points"),
    }
}

fn position(i: usize) -> DVec3 {
    let i = i as f64;
    DVec3::new(636_000.0 + 0.25 * i, 848_000.0 - 0.5 * i, (i * 0.1).sin().abs() * 8.0).round()
        + DVec3::new(0.25, 0.5, 0.75)
}

/// `count` points, written by the `las` crate; the second one is withheld.
pub(crate) fn file(
    version: (u8, u8),
    format: u8,
    is_compressed: bool,
    count: usize,
    color: u16,
) -> Vec<u8> {
    let mut format = Format::new(format).unwrap();
    format.is_compressed = is_compressed;
    format.extra_bytes = 2;
    let transform = |offset| Transform { scale: 0.01, offset };
    let mut builder = Builder::from(version);
    builder.point_format = format;
    builder.transforms =
        Vector { x: transform(636_000.0), y: transform(848_000.0), z: transform(0.0) };
    let mut writer = Writer::new(Cursor::new(Vec::new()), builder.into_header().unwrap()).unwrap();
    for i in 0..count {
        let p = position(i);
        let level = (i % 5) as u16;
        writer
            .write_point(Point {
                x: p.x,
                y: p.y,
                z: p.z,
                intensity: i as u16,
                classification: Classification::new((i % 3) as u8).unwrap(),
                return_number: (i % 4 + 1) as u8,
                number_of_returns: 5,
                scan_angle: (i % 7) as f32,
                user_data: (i % 2) as u8,
                point_source_id: (i % 3 + 1000) as u16,
                is_withheld: i == 1,
                gps_time: format.has_gps_time.then_some(i as f64),
                color: format
                    .has_color
                    .then(|| Color::new(level * color, color, level / 4 * color)),
                nir: format.has_nir.then_some(9),
                waveform: format.has_waveform.then(Default::default),
                extra_bytes: vec![1, 2],
                ..Point::default()
            })
            .unwrap();
    }
    writer.close().unwrap();
    writer.into_inner().unwrap().into_inner()
}

#[test]
fn every_format_comes_back_plain_and_compressed() {
    for format in 0..=10u8 {
        for is_compressed in [false, true] {
            let bytes = file((1, 4), format, is_compressed, 500, 1);
            let asset = read_bytes(&bytes).unwrap_or_else(|e| panic!("format {format}: {e}"));
            let cloud = points_of(&asset);
            assert_eq!(cloud.positions.len(), 499, "format {format}");
            for (k, found) in cloud.positions.iter().enumerate() {
                let i = if k == 0 { 0 } else { k + 1 };
                assert!((*found - position(i)).length() < 1e-6, "format {format}, point {i}");
                let value = |name: &str| cloud.value(name, k);
                assert_eq!(value("intensity"), Some(i as f64));
                assert_eq!(value("classification"), Some((i % 3) as f64));
                assert_eq!(value("return_number"), Some((i % 4 + 1) as f64));
                assert_eq!(value("number_of_returns"), Some(5.0));
                assert!((value("scan_angle").unwrap() - (i % 7) as f64).abs() < 0.007);
                assert_eq!(value("user_data"), Some((i % 2) as f64));
                assert_eq!(value("point_source_id"), Some((i % 3 + 1000) as f64));
                let has_time = !matches!(format, 0 | 2);
                assert_eq!(value("gps_time").is_some(), has_time);
                assert!(value("gps_time").is_none_or(|time| (time - i as f64).abs() < 0.01));
            }
            let colors = cloud.colors.as_ref();
            assert_eq!(colors.is_some(), matches!(format, 2 | 3 | 5 | 7 | 8 | 10));
            assert!(colors.is_none_or(|colors| colors[1] == [2, 1, 0, 255]));
            assert_eq!(asset.warnings, ["1 point skipped: flagged as withheld"]);
            assert_eq!(asset.format, if is_compressed { "laz" } else { "las" });
        }
    }
}

#[test]
fn declared_extra_bytes_are_fields() {
    // A declaration of a word with a scale of 0.5, behind an undocumented byte.
    let mut declarations = vec![0; 2 * 192];
    declarations[3] = 1;
    (declarations[194], declarations[195]) = (3, 8);
    declarations[196..205].copy_from_slice(b"Amplitude");
    declarations[304..312].copy_from_slice(&0.5f64.to_le_bytes());
    for (is_compressed, is_extended) in [(false, false), (true, false), (false, true), (true, true)]
    {
        let mut builder = Builder::from((1, 4));
        builder.point_format = Format::new(6).unwrap();
        builder.point_format.is_compressed = is_compressed;
        builder.point_format.extra_bytes = 3;
        if !is_extended {
            builder.vlrs.push(las::Vlr {
                user_id: "LASF_Spec".to_owned(),
                record_id: 4,
                data: declarations.clone(),
                ..las::Vlr::default()
            });
        }
        let header = builder.into_header().unwrap();
        let mut writer = Writer::new(Cursor::new(Vec::new()), header).unwrap();
        for i in 0..300u16 {
            let [low, high] = (1000 + i).to_le_bytes();
            let extra_bytes = vec![77, low, high];
            let x = f64::from(i);
            let gps_time = Some(x);
            writer.write_point(Point { x, gps_time, extra_bytes, ..Point::default() }).unwrap();
        }
        writer.close().unwrap();
        let mut bytes = writer.into_inner().unwrap().into_inner();
        if is_extended {
            // Another record stands before that of the declarations.
            let start = bytes.len() as u64;
            bytes[235..243].copy_from_slice(&start.to_le_bytes());
            bytes[243..247].copy_from_slice(&2u32.to_le_bytes());
            for (id, data) in [(9u16, &declarations[..5]), (4, &declarations[..])] {
                let mut head = [0; 60];
                head[2..11].copy_from_slice(b"LASF_Spec");
                head[18..20].copy_from_slice(&id.to_le_bytes());
                head[20..28].copy_from_slice(&(data.len() as u64).to_le_bytes());
                bytes.extend(head);
                bytes.extend(data);
            }
        }
        let asset = read_bytes(&bytes).unwrap();
        let values = points_of(&asset).values_of("Amplitude").unwrap();
        let expected: Vec<f64> = (0..300).map(|i| f64::from(1000 + i) * 0.5).collect();
        assert!(values.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 0.01), "{values:?}");
    }
}

#[test]
fn many_chunks_keep_their_order() {
    let bytes = file((1, 2), 3, true, 120_000, 256);
    let asset = read_bytes(&bytes).unwrap();
    let cloud = points_of(&asset);
    assert_eq!(cloud.positions.len(), 119_999);
    let wrong = (2..120_000).find(|&i| (cloud.positions[i - 1] - position(i)).length() > 1e-6);
    assert_eq!(wrong, None);
    // 8-bit values in the high bytes.
    assert_eq!(cloud.colors.as_ref().unwrap()[3], [4, 1, 1, 255]);
}

#[test]
fn a_missing_chunk_table_is_done_without() {
    let mut bytes = file((1, 2), 1, true, 60_000, 0);
    let at = u32::from_le_bytes(bytes[96..100].try_into().unwrap()) as usize;
    bytes[at..at + 8].copy_from_slice(&(-1i64).to_le_bytes());
    let asset = read_bytes(&bytes).unwrap();
    assert_eq!(points_of(&asset).positions.len(), 59_999);
}

#[test]
fn lies_are_refused_by_name() {
    let good = file((1, 2), 3, false, 50, 0);
    let error = |at: usize, with: &[u8]| {
        let mut bytes = good.clone();
        bytes[at..at + with.len()].copy_from_slice(with);
        read_bytes(&bytes).unwrap_err().to_string()
    };
    assert!(error(0, b"LASS").contains("signature"));
    assert!(error(24, &[2]).contains("LAS version 2.2"));
    assert!(error(94, &[0, 0]).contains("header, header size"));
    assert!(error(96, &[0xff; 4]).contains("header, offset to point data"));
    assert!(error(104, &[11]).contains("point format 11"));
    assert!(error(104, &[0x83]).contains("LASzip record: is missing"));
    assert!(error(105, &[10, 0]).contains("header, point data record length"));
    assert!(error(107, &[51, 0, 0, 0]).contains("number of point records: is 51; the file has"));
    assert!(error(107, &[0; 4]).contains("holds no points"));
    assert!(error(131, &[0; 8]).contains("header, scale factor"));
    assert!(error(155, &f64::NAN.to_le_bytes()).contains("header, offset"));
    assert!(read_bytes(b"LASF").unwrap_err().to_string().contains("header size"));
    // Far too many variable length records are only remarked upon, if the points are there.
    let mut bytes = good.clone();
    bytes[100..104].copy_from_slice(&[0xff; 4]);
    assert!(read_bytes(&bytes).unwrap().warnings[0].contains("declares 4294967295"));
}

#[test]
fn lying_chunks_are_refused() {
    for format in [3, 7] {
        let good = file((1, 4), format, true, 3000, 300);
        let start = u32::from_le_bytes(good[96..100].try_into().unwrap()) as usize;
        let table = i64::from_le_bytes(good[start..start + 8].try_into().unwrap()) as usize;
        let error = |at: usize, with: &[u8]| {
            let mut bytes = good.clone();
            bytes[at..at + with.len()].copy_from_slice(with);
            read_bytes(&bytes).unwrap_err().to_string()
        };
        assert!(error(table + 4, &[0xff; 4]).contains("chunk table: lists 4294967295 chunks"));
        assert!(error(start, &(1i64 << 40).to_le_bytes()).contains("behind the end"));
        assert!(error(table + 4, &[0; 4]).contains("holds 0 points"));
        if format == 7 {
            let record = good[105] as usize;
            let layers = error(start + 8 + record + 4, &[0xff; 4]);
            assert!(layers.contains("chunk 0: layers of"), "{layers}");
        }
    }
}

#[test]
fn limits_hold() {
    let bytes = file((1, 2), 0, true, 100, 0);
    let read = |options| read_seekable(Cursor::new(&bytes), "t.laz", &options);
    let few = ReadOptions { max_vertices: 99, ..ReadOptions::default() };
    assert!(matches!(read(few), Err(AssetError::TooLarge { found: 100, limit: 99, .. })));
    let small = ReadOptions { max_decompressed_bytes: 2199, ..ReadOptions::default() };
    assert!(matches!(read(small), Err(AssetError::TooLarge { found: 2200, .. })));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn damage_is_answered(
        format in 0u8..=10,
        is_compressed: bool,
        flips in proptest::collection::vec((0usize..4000, any::<u8>()), 0..4),
        cut in 0usize..4000,
    ) {
        let mut bytes = file((1, 4), format, is_compressed, 60, 700);
        for (at, byte) in flips {
            let at = at % bytes.len();
            bytes[at] = byte;
        }
        if cut % 3 == 0 {
            bytes.truncate(cut);
        }
        let few = ReadOptions { max_vertices: 1 << 20, ..ReadOptions::default() };
        let _ = read_seekable(Cursor::new(&bytes), "t.las", &few);
    }
}
