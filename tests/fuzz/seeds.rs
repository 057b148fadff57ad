use std::io::Cursor;
use e57::{E57Writer, Quaternion, Record, RecordValue, Transform as T, Translation};
use las::point::{Classification, Format};
use las::{Builder, Color, Point, Transform, Vector, Writer};

fn put(target: &str, name: &str, bytes: &[u8]) {
    let d = format!("/tmp/seeds/{target}");
    std::fs::create_dir_all(&d).unwrap();
    println!("{target} {name} {}", bytes.len());
    if bytes.len() <= 4096 { std::fs::write(format!("{d}/{name}"), bytes).unwrap(); }
}
fn las(version: (u8, u8), f: u8, z: bool, count: usize) -> Vec<u8> {
    let mut format = Format::new(f).unwrap();
    format.is_compressed = z;
    let tr = |offset| Transform { scale: 0.01, offset };
    let mut b = Builder::from(version);
    b.point_format = format;
    b.transforms = Vector { x: tr(636_000.0), y: tr(848_000.0), z: tr(0.0) };
    let mut w = Writer::new(Cursor::new(Vec::new()), b.into_header().unwrap()).unwrap();
    for i in 0..count {
        w.write_point(Point { x: 636_000.0 + 0.25 * i as f64, y: 848_000.0 - 0.5 * i as f64, z: i as f64, intensity: i as u16, classification: Classification::new((i % 3) as u8).unwrap(), return_number: (i % 4 + 1) as u8, number_of_returns: 5, gps_time: format.has_gps_time.then_some(i as f64), color: format.has_color.then(|| Color::new(i as u16 * 256, 255, 9)), nir: format.has_nir.then_some(9), waveform: format.has_waveform.then(Default::default), is_withheld: i == 1, ..Point::default() }).unwrap();
    }
    w.close().unwrap();
    w.into_inner().unwrap().into_inner()
}
fn main() {
    for (v, f) in [((1, 2), 0), ((1, 2), 1), ((1, 2), 2), ((1, 2), 3), ((1, 4), 6), ((1, 4), 7), ((1, 4), 8)] {
        let plain = las(v, f, false, 5);
        put("las", &format!("f{f}"), &plain);
        put("las-blocks", &format!("f{f}"), &plain);
        let laz = las(v, f, true, 9);
        put("laz", &format!("f{f}"), &laz);
        put("las-blocks", &format!("z{f}"), &laz);
    }
    let half = std::f64::consts::FRAC_1_SQRT_2;
    for both in [false, true] {
        let mut bytes = Cursor::new(Vec::new());
        let mut writer = E57Writer::new(&mut bytes, "file").unwrap();
        if both {
            let mut scan = writer.add_pointcloud("scan", vec![Record::CARTESIAN_X_F64, Record::CARTESIAN_Y_F64, Record::CARTESIAN_Z_F64, Record::CARTESIAN_INVALID_STATE, Record::COLOR_RED_U8, Record::COLOR_GREEN_U8, Record::COLOR_BLUE_U8, Record::INTENSITY_U16]).unwrap();
            scan.set_transform(Some(T { rotation: Quaternion { w: half, x: 0.0, y: 0.0, z: half }, translation: Translation { x: 100.0, y: 200.0, z: 300.0 } }));
            for (x, s, i) in [(1.0, 0, 10), (2.0, 2, 0), (4.0, 0, 30)] {
                scan.add_point(vec![RecordValue::Double(x), RecordValue::Double(0.0), RecordValue::Double(0.5), RecordValue::Integer(s), RecordValue::Integer(255), RecordValue::Integer(0), RecordValue::Integer(7), RecordValue::Integer(i)]).unwrap();
            }
            scan.finalize().unwrap();
        } else {
            let mut scan = writer.add_pointcloud("sphere", vec![Record::SPHERICAL_AZIMUTH_F64, Record::SPHERICAL_ELEVATION_F64, Record::SPHERICAL_RANGE_F64]).unwrap();
            for (a, e) in [(0.0, 0.0), (1.5, 0.0), (0.0, 1.5)] { scan.add_point([a, e, 2.0].map(RecordValue::Double).to_vec()).unwrap(); }
            scan.finalize().unwrap();
        }
        writer.finalize().unwrap();
        drop(writer);
        put("e57", if both { "both" } else { "sphere" }, &bytes.into_inner());
    }
    let rgb = image::RgbImage::from_fn(8, 4, |x, y| image::Rgb([(x * 30) as u8, (y * 60) as u8, 9]));
    for (format, name) in [(image::ImageFormat::Jpeg, "jpeg"), (image::ImageFormat::WebP, "webp"), (image::ImageFormat::Tga, "tga")] {
        let mut b = Cursor::new(Vec::new());
        image::DynamicImage::from(rgb.clone()).write_to(&mut b, format).unwrap();
        put("texture", name, b.get_ref());
        put("environment", name, b.get_ref());
    }
    let floats = image::Rgb32FImage::from_fn(8, 4, |x, y| image::Rgb([x as f32, y as f32, 0.5]));
    for (format, name) in [(image::ImageFormat::OpenExr, "exr"), (image::ImageFormat::Hdr, "hdr")] {
        let mut b = Cursor::new(Vec::new());
        image::DynamicImage::from(floats.clone()).write_to(&mut b, format).unwrap();
        put("texture", name, b.get_ref());
        put("environment", name, b.get_ref());
    }
    // Bake cache.
    use pointillist::assets::{Mesh, PointCloud, Polylines};
    use pointillist::bake::{cache::BakeCache, pack::*, tree::build_tree};
    use glam::{DVec3, Vec3};
    let cloud = PointCloud { positions: (0..5).map(|i| DVec3::new(i as f64, (i * i) as f64 * 0.1, 0.3)).collect(), colors: Some((0..5).map(|i| [i, 20, 200, 255]).collect()), normals: Some(vec![Vec3::Z; 5]), oriented: true, ..PointCloud::default() };
    let mesh = Mesh { positions: vec![DVec3::ZERO, DVec3::X, DVec3::Y], triangles: vec![[0, 1, 2]], ..Mesh::default() };
    let folder = tempfile::tempdir().unwrap();
    let cache = BakeCache::new(folder.path(), u64::MAX);
    let key = [0xa5; 32];
    let mut n = 0;
    let mut keep = |g: Vec<PackedGeometry>| {
        cache.store(&key, &g).unwrap();
        let f = std::fs::read_dir(folder.path()).unwrap().next().unwrap().unwrap().path();
        let b = std::fs::read(f).unwrap();
        n += 1;
        put("bake-cache", &format!("g{n}"), &b[..b.len() - 32]);
    };
    keep(vec![]);
    keep(vec![PackedGeometry::Samples(pack_samples(&cloud).unwrap())]);
    keep(vec![PackedGeometry::Samples(build_tree(&cloud, None).unwrap())]);
    keep(vec![PackedGeometry::Triangles(pack_mesh(&mesh, &[]).unwrap())]);
    let _ = Polylines::default();
}
