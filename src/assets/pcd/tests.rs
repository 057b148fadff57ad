use proptest::prelude::*;

use super::*;

fn read_bytes(bytes: &[u8]) -> Result<Asset, AssetError> {
    read_from(bytes, "t.pcd", &ReadOptions::default())
}

fn cloud_of(bytes: &[u8]) -> PointCloud {
    match read_bytes(bytes).unwrap().geometries.remove(0) {
        Geometry::Points(cloud) => cloud,
        _ => panic!("a PCD file holds points"),
    }
}

const HEADER: &str = "# .PCD v0.7\nVERSION 0.7\nFIELDS label z _ y x rgb normal_x normal_y normal_z\n\
    SIZE 2 8 1 4 4 4 4 4 4\nTYPE U F U F F F F F F\nCOUNT 1 1 3 1 1 1 1 1 1\n\
    WIDTH 2\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 2\nDATA ";

/// The two points' values, field by field.
fn fields() -> [[Vec<u8>; 2]; 9] {
    let f = |a: f32, b: f32| [a.to_le_bytes().to_vec(), b.to_le_bytes().to_vec()];
    let color = |value: u32| value.to_le_bytes().to_vec();
    [
        [7u16.to_le_bytes().to_vec(), 300u16.to_le_bytes().to_vec()],
        [3.5f64.to_le_bytes().to_vec(), (-1e9f64).to_le_bytes().to_vec()],
        [vec![9; 3], vec![8; 3]],
        f(2.0, 5.0),
        f(1.0, 4.0),
        [color(0x00ff_8001), color(0x7f00_0102)],
        f(0.0, 0.0),
        f(2.0, 0.0),
        f(0.0, 0.0),
    ]
}

fn check(cloud: &PointCloud) {
    assert_eq!(cloud.positions, [DVec3::new(1.0, 2.0, 3.5), DVec3::new(4.0, 5.0, -1e9)]);
    assert_eq!(cloud.colors, Some(vec![[255, 128, 1, 255], [0, 1, 2, 255]]));
    assert_eq!(cloud.normals, Some(vec![glam::Vec3::Y, glam::Vec3::ZERO]));
    assert_eq!(cloud.values_of("classification"), Some(vec![7.0, 300.0]));
    assert!(cloud.field("intensity").is_none());
}

fn binary() -> Vec<u8> {
    let mut bytes = format!("{HEADER}binary\n").into_bytes();
    for point in 0..2 {
        fields().iter().for_each(|field| bytes.extend(&field[point]));
    }
    bytes
}

fn compressed() -> Vec<u8> {
    let body: Vec<u8> = fields().iter().flat_map(|field| field.concat()).collect();
    // Literal runs only.
    let packed: Vec<u8> = body
        .chunks(32)
        .flat_map(|run| [vec![run.len() as u8 - 1], run.to_vec()].concat())
        .collect();
    let mut bytes = format!("{HEADER}binary_compressed\n").into_bytes();
    bytes.extend((packed.len() as u32).to_le_bytes());
    bytes.extend((body.len() as u32).to_le_bytes());
    bytes.extend(packed);
    bytes
}

#[test]
fn the_three_bodies_agree() {
    let (first, second) = (f32::from_bits(0x00ff_8001), f32::from_bits(0x7f00_0102));
    let ascii = format!(
        "{HEADER}ascii\n7 3.5 9 9 9 2 1 {first:e} 0 2 0\n300 -1e9 8 8 8 5 4 {second:e} 0 0 0\n"
    );
    check(&cloud_of(ascii.as_bytes()));
    check(&cloud_of(&binary()));
    check(&cloud_of(&compressed()));
}

#[test]
fn organised_clouds_skip_pixels_without_depth() {
    let text = "VERSION .7\nFIELDS X Y Z rgba intensity\nSIZE 4 4 4 4 1\nTYPE F F F U U\n\
                WIDTH 2\nHEIGHT 2\nDATA ascii\n1 2 3 4278190335 4\nnan nan nan 0 0\n\
                4 5 6 2147483648 5\nNaN 1 1 0 9\n";
    let asset = read_bytes(text.as_bytes()).unwrap();
    assert_eq!(asset.warnings, ["2 points skipped: no finite position"]);
    let Geometry::Points(cloud) = &asset.geometries[0] else { panic!("points") };
    assert_eq!(cloud.positions.len(), 2);
    assert_eq!(cloud.colors, Some(vec![[0, 0, 255, 255], [0, 0, 0, 128]]));
    assert_eq!(cloud.values_of("intensity"), Some(vec![4.0, 5.0]));
}

#[test]
fn every_scalar_field_is_kept() {
    let text = "FIELDS x y z intensity ring time\nSIZE 4 4 4 4 2 8\nTYPE F F F F U F\nPOINTS 2\n\
                DATA ascii\n1 2 3 7 15 100\n4 5 6 8 16 200\n";
    let cloud = cloud_of(text.as_bytes());
    assert_eq!(cloud.values_of("intensity"), Some(vec![7.0, 8.0]));
    assert_eq!(cloud.values_of("ring"), Some(vec![15.0, 16.0]));
    assert_eq!(cloud.values_of("time"), Some(vec![100.0, 200.0]));
}

#[test]
fn separate_channels_and_missing_counts() {
    let text = "FIELDS x y z r g b\nSIZE 4 4 4 1 1 1\nTYPE F F F U U U\nPOINTS 1\nDATA ascii\n\
                1 2 3 255 0 9";
    assert_eq!(cloud_of(text.as_bytes()).colors, Some(vec![[255, 0, 9, 255]]));
}

#[test]
fn errors_name_field_and_point() {
    let error = |bytes: &[u8]| read_bytes(bytes).unwrap_err().to_string();
    assert!(error(b"1 2 3\n4 5 6\n").contains("header, line 1: \"1\" is no PCD keyword"));
    assert!(error(b"FIELDS x y\nPOINTS 1\nDATA ascii\n").contains("no field z"));
    assert!(error(b"FIELDS x y z\nDATA ascii\n").contains("header, POINTS"));
    assert!(error(b"FIELDS x y z\nSIZE 3 4 4\nPOINTS 1\nDATA ascii\n").contains("header, SIZE"));
    assert!(error(b"FIELDS x y z\nTYPE F F\nPOINTS 1\nDATA ascii\n").contains("header, TYPE"));
    assert!(error(b"FIELDS x y z\nWIDTH 2\nPOINTS 3\nDATA ascii\n").contains("header, POINTS"));
    assert!(error(b"FIELDS x y z\nPOINTS 1\nDATA zip\n").contains("PCD data \"zip\""));
    let body = error(b"FIELDS x y z\nPOINTS 2\nDATA ascii\n1 2 3\n4 five 6\n");
    assert!(body.contains("point 1, property y (line 5)"), "{body}");
    let short = error(&binary()[..binary().len() - 1]);
    assert!(short.contains("point 1: the file ends"), "{short}");
    let short = error(&compressed()[..compressed().len() - 1]);
    assert!(short.contains("compressed data"), "{short}");
    let lies = b"FIELDS x y z\nWIDTH 1000000000\nHEIGHT 1\nDATA binary\nabc";
    assert!(error(lies).contains("point 0: the file ends"));
    let lies = b"FIELDS x y z\nWIDTH 300000000\nDATA binary_compressed\n\x01\0\0\0\0\xa4\x93\xd6a";
    assert!(error(lies).contains("cannot expand"), "{}", error(lies));
}

proptest! {
    #[test]
    fn damage_is_answered(which: bool, at in 0usize..500, byte: u8, cut in 0usize..500) {
        let mut bytes = if which { binary() } else { compressed() };
        let at = at % bytes.len();
        bytes[at] = byte;
        bytes.truncate(cut.max(4));
        let _ = read_bytes(&bytes);
    }

    #[test]
    fn noise_is_answered(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
        let mut file = HEADER.as_bytes().to_vec();
        file.extend(b"binary_compressed\n");
        file.extend(&bytes);
        let _ = read_bytes(&file);
        let _ = read_bytes(&bytes);
    }
}

/// A depth image of a wall with a hole in it, as a Kinect writes it.
fn depth_image(viewpoint: &str) -> Vec<u8> {
    let mut text = format!(
        "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 40\nHEIGHT 30\n\
         VIEWPOINT {viewpoint}\nPOINTS 1200\nDATA ascii\n"
    );
    for pixel in 0..1200 {
        let (u, v) = (f64::from(pixel % 40) - 19.5, f64::from(pixel / 40) - 14.5);
        let depth = if pixel % 11 == 5 { f64::NAN } else { 2.0 + 0.01 * u };
        text += &format!("{} {} {depth}\n", u / 32.0 * depth, v / 32.0 * depth);
    }
    text.into_bytes()
}

#[test]
fn depth_images_have_the_view_of_their_sensor() {
    let asset = read_bytes(&depth_image("0 0 0 1 0 0 0")).unwrap();
    let Some(Sensor::View(seen)) = asset.sensor else { panic!("{:?}", asset.sensor) };
    assert_eq!(seen.camera.eye, DVec3::ZERO);
    assert_eq!(seen.camera.up, DVec3::NEG_Y);
    assert!(seen.camera.target.distance(DVec3::Z * 2.0) < 0.1, "{:?}", seen.camera);
    let fov_deg = 2.0 * (15.0f64 / 32.0).atan().to_degrees();
    assert!((seen.camera.lens.fov_deg().unwrap() - fov_deg).abs() < 0.1, "{:?}", seen.camera.lens);
    assert!(asset.warnings.len() == 1, "{:?}", asset.warnings);
    let named = read_bytes(&depth_image("0 0 zero 1 0 0 0")).unwrap();
    assert!(named.warnings[0].starts_with("VIEWPOINT is ignored"), "{:?}", named.warnings);
    assert!(read_bytes(&binary()).unwrap().sensor.is_none());
}

#[test]
fn colours_that_were_never_written_are_none() {
    let text = "FIELDS x y z rgb\nSIZE 4 4 4 4\nTYPE F F F U\nWIDTH 2\nPOINTS 2\nDATA ascii\n0 0 0 0\n1 0 0 0\n";
    assert!(cloud_of(text.as_bytes()).colors.is_none());
    assert!(cloud_of(text.replace("1 0 0 0", "1 0 0 1").as_bytes()).colors.is_some());
}
