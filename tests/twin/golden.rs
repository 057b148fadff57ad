//! Compares committed scenes with their images in `tests/golden`.
//!
//! `UPDATE=1 cargo test --test twin golden` writes the images anew; inspect them before committing them. Another driver may round
//! differently, so images are compared with a small tolerance instead of bit by bit.

use std::path::PathBuf;

use glam::DVec3;
use pointillist::accuracy::metrics;
use pointillist::encode::ImageFormat;
use pointillist::engine::{FrameRequest, Pose};
use pointillist::math::{Camera, Projection, exposures};
use pointillist::plan::{
    Antialias, BlurSamples, ColorBy, Edl, Lod, MaxError, Output, PointSizePx, Reconstruct, Settings,
};
use pointillist::scene::recolor::ColorMap;

use super::stage::{Case, wide_engine};
use super::verdict;

const WIDTH: u32 = 192;
const HEIGHT: u32 = 144;

fn file(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(format!("tests/golden/{name}.png"))
}

/// Writes opaque pixels as a small PNG file.
fn write(name: &str, rgba: &[[u8; 4]]) {
    let path = file(name);
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    let mut encoder = png::Encoder::new(std::fs::File::create(path).unwrap(), WIDTH, HEIGHT);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_compression(png::Compression::High);
    let rgb: Vec<u8> = rgba.iter().flat_map(|&[r, g, b, _]| [r, g, b]).collect();
    encoder.write_header().unwrap().write_image_data(&rgb).unwrap();
}

fn read(name: &str) -> Vec<[u8; 4]> {
    let path = file(name);
    let opened = std::fs::File::open(&path)
        .unwrap_or_else(|error| panic!("{}: {error}; UPDATE=1 writes it", path.display()));
    let mut reader = png::Decoder::new(std::io::BufReader::new(opened)).read_info().unwrap();
    let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut bytes).unwrap();
    assert_eq!((info.width, info.height), (WIDTH, HEIGHT), "{name}");
    assert_eq!(info.color_type, png::ColorType::Rgb, "{name}");
    let (pixels, _) = bytes.as_chunks();
    pixels.iter().map(|&[r, g, b]| [r, g, b, 255]).collect()
}

fn compare(scene: &str, cameras: &[&str]) {
    compare_with(scene, cameras, Settings::drawn_as(Reconstruct::Points), "");
}

fn compare_with(scene: &str, cameras: &[&str], settings: Settings, suffix: &str) {
    let case = Case::as_shipped(scene);
    for camera in cameras {
        let name = format!("{scene}-{camera}{suffix}");
        let mut camera: Camera = case.reference.camera(camera).unwrap();
        if let Some(projection) = settings.projection {
            camera = camera.with_projection(projection);
        }
        let colors = case.colors(&camera.view(WIDTH, HEIGHT).unwrap(), settings);
        assert!(colors.iter().all(|color| color[3] == 255), "{name} is translucent");
        hold(&name, &colors);
    }
}

/// Holds a frame against the picture of this name.
fn hold(name: &str, color: &[[u8; 4]]) {
    if std::env::var("UPDATE").is_ok_and(|update| update == "1") {
        write(name, color);
    }
    let golden = read(name);
    let psnr = metrics::psnr(&golden, color).unwrap();
    let ssim = metrics::ssim(&golden, color, WIDTH, HEIGHT).unwrap();
    let differs = |(a, b): &(&[u8; 4], &[u8; 4])| (0..3).any(|k| a[k].abs_diff(b[k]) > 2);
    let changed = golden.iter().zip(color).filter(differs).count();
    let report = format!("{name}: {psnr:.1} dB, SSIM {ssim:.5}, {changed} pixels differ");
    println!("{report}");
    if psnr < 50.0 || ssim < 0.998 || changed > golden.len() / 1000 {
        let difference = golden.iter().zip(color).map(|(a, b)| {
            let [r, g, b, _] = std::array::from_fn(|k| a[k].abs_diff(b[k]).saturating_mul(8));
            [r, g, b, 255]
        });
        verdict::save(&format!("{name}-golden"), WIDTH, HEIGHT, golden.clone());
        verdict::save(&format!("{name}-difference"), WIDTH, HEIGHT, difference.collect());
        verdict::save(&format!("{name}-frame"), WIDTH, HEIGHT, color.to_vec());
        panic!("{report}; see {}", super::stage::folder().join("failed").display());
    }
}

#[test]
fn town() {
    compare("town", &["overview", "square", "street"]);
}

#[test]
fn relief() {
    compare("relief", &["front", "detail"]);
}

#[test]
fn textured() {
    compare("textured", &["front", "grazing"]);
}

#[test]
fn materials() {
    compare("materials", &["front", "lantern"]);
}

#[test]
fn glasshouse() {
    compare("glasshouse", &["corner", "bench"]);
}

#[test]
fn glasshouse_night() {
    compare("glasshouse-night", &["corner", "inside"]);
}

#[test]
fn plaza() {
    compare("plaza", &["walk", "assembly"]);
}

#[test]
fn splats() {
    let settings = Settings { reconstruct: Reconstruct::Splats, ..Settings::default() };
    compare_with("town", &["overview", "square"], settings, "-splats");
    compare_with("part", &["front", "detail"], settings, "-splats");
}

#[test]
fn level_of_detail() {
    let spt = |px, reconstruct| {
        let max_error = MaxError::new(px).unwrap();
        Settings { lod: Lod::Spt, max_error_px: max_error, reconstruct, ..Settings::default() }
    };
    compare_with("town", &["overview"], spt(1.0, Reconstruct::Splats), "-spt");
    compare_with("plaza", &["walk"], spt(1.0, Reconstruct::Splats), "-spt");
    compare_with("relief", &["front"], spt(2.0, Reconstruct::Splats), "-spt");
    compare_with("part", &["front"], spt(1.0, Reconstruct::Points), "-spt");
}

#[test]
fn a_single_pass() {
    // Adapters without 64-bit atomics draw three passes instead.
    let case = Case::as_shipped("town");
    let view = case.view("square", WIDTH, HEIGHT);
    let frame = case.draw_wide(&view, Settings::drawn_as(Reconstruct::Fuzzy));
    assert_eq!(frame.receipt.settings.instead_because, None);
    hold("town-square-fuzzy", &frame.color);
}

#[test]
fn painted_splats() {
    let painted = Settings::drawn_as(Reconstruct::Painted);
    for (scene, camera, lod) in [("town", "square", Lod::Full), ("plaza", "walk", Lod::Spt)] {
        let case = Case::as_shipped(scene);
        let view = case.view(camera, WIDTH, HEIGHT);
        let frame = case.draw_wide(&view, Settings { lod, ..painted });
        assert_eq!(frame.receipt.settings.instead_because, None);
        hold(&format!("{scene}-{camera}-painted"), &frame.color);
    }
}

#[test]
fn pull_push_and_lines() {
    compare_with("town", &["square"], Settings::drawn_as(Reconstruct::PullPush), "-pulled");
    let points = Settings::drawn_as(Reconstruct::Points);
    let wide = Settings { line_width_px: 1.0.into(), ..points };
    compare_with("neurons", &["front"], wide, "-pixel");
    let fine = Settings { antialias: Antialias::Parts16, ..points };
    compare_with("neurons", &["detail"], fine, "-antialias");
    compare_with("plaza", &["walk"], fine, "-antialias");
}

#[test]
fn effects_and_other_settings() {
    let points = Settings::drawn_as(Reconstruct::Points);
    let splats = Settings::drawn_as(Reconstruct::Splats);
    let edl = Settings { edl: Edl::On, ..points };
    compare_with("town", &["overview"], edl, "-edl");
    let discs = Settings { point_size_px: PointSizePx::new(4.0).unwrap(), ..points };
    compare_with("town", &["square"], discs, "-discs");
    let heights = Settings { color_by: ColorBy::Height, color_map: ColorMap::Spectral, ..points };
    compare_with("relief", &["front"], heights, "-height");
    let normals = Settings { color_by: ColorBy::Normal, ..splats };
    compare_with("part", &["front"], normals, "-normal");
    let orthographic = Settings { projection: Some(Projection::Orthographic), ..splats };
    compare_with("part", &["detail"], orthographic, "-orthographic");
    let half = Some("-100,-100,-100,4,100,100".parse().unwrap());
    compare_with("plaza", &["assembly"], Settings { clip_boxes: half, ..points }, "-clipped");
}

#[test]
fn depth_of_field_and_motion_blur() {
    let blur_samples = BlurSamples::Exposures16;
    let settings = Settings { blur_samples, ..Settings::drawn_as(Reconstruct::Points) };
    let lens = Settings { aperture: 0.25.into(), focus_distance: 8.0.into(), ..settings };
    compare_with("plaza", &["walk"], lens, "-lens");
    // The camera moves to the right while the shutter is open.
    let case = Case::as_shipped("plaza");
    let camera = case.reference.camera("walk").unwrap();
    let at = |time: f64| {
        let way = DVec3::X * (time - 0.5);
        Camera { eye: camera.eye + way, target: camera.target + way, ..camera }
    };
    let exposed: Vec<Camera> = exposures(16).map(|one| at(one.time)).collect();
    let request = FrameRequest {
        scene: case.id.clone(),
        pose: Pose::Moving { camera, exposed: exposed.into() },
        width: WIDTH,
        height: HEIGHT,
        settings: Settings { shutter: 0.5.into(), ..settings },
        output: Output::Color,
        format: ImageFormat::Raw,
        quality: 85,
        deadline: None,
    };
    let frame = wide_engine().submit(request).unwrap().wait().unwrap();
    hold("plaza-walk-moving", frame.bytes.as_chunks().0);
}
