//! `pointillist panorama`: draws all that an eye can see, as one equirectangular image or as the six faces of a cube.
//!
//! The faces are ordinary frames of perspective with a field of view a little over 90°. What is around a face is drawn with it and cut
//! off again, because effects look at neighbouring pixels. An equirectangular image is taken from the faces: each of its pixels is the mean,
//! in linear light, of [`TAPS`]² directions within it.

use std::f64::consts::{PI, TAU};
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use anyhow::{Context, bail, ensure};
use clap::{Args, ValueEnum};
use glam::{DMat3, DVec2, DVec3};
use png::{BitDepth, ColorType, Encoder, SrgbRenderingIntent};
use rayon::prelude::*;

use super::frame::{DrawArgs, PoseArgs};
use super::local::{SceneArgs, progress_bar};
use super::out::say;
use crate::encode::ImageFormat;
use crate::engine::{Engine, EngineError, FrameRequest, Pose};
use crate::math::{Projection, View};
use crate::plan::{Reconstruct, Settings};
use crate::scene::color::{linear_from_srgb, srgb_from_linear};

/// Options of `pointillist panorama`.
#[derive(Args, Clone, Debug)]
pub struct PanoramaArgs {
    #[command(flatten)]
    scene: SceneArgs,
    /// PNG file to write; with --layout cube NAME.png stands for NAME-front.png, -right, -back, -left, -up and -down
    #[arg(short = 'o', long = "out", value_name = "FILE")]
    file: PathBuf,
    /// Width in pixels: an even number for the equirectangular image, which is half as high, or that of a face of the cube [default: 2048, or 1024 for a face]
    #[arg(long, value_name = "PX", value_parser = clap::value_parser!(u32).range(4..))]
    width: Option<u32>,
    /// Equirectangular image, or six faces of a cube as somebody in its middle sees them
    #[arg(long, value_enum, default_value = "equirectangular")]
    layout: Layout,
    #[command(flatten)]
    pose: PoseArgs,
    #[command(flatten)]
    draw: DrawArgs,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Layout {
    Equirectangular,
    Cube,
}

/// Width of the border that is drawn around each face and cut off again; pull-push looks at squares of powers of two.
const MARGIN_PX: u32 = 64;
/// Directions within a pixel of an equirectangular image, along each side.
const TAPS: u32 = 2;

/// A face of the cube.
struct Face {
    name: &'static str,
    /// Where its image's right, top and middle lie, in the eye's axes: right, up, backward.
    axes: [DVec3; 3],
}

/// The faces as somebody in the middle sees them. The upper one joins the front one at its lower edge, the lower one at its upper edge.
const FACES: [Face; 6] = [
    Face { name: "front", axes: [DVec3::X, DVec3::Y, DVec3::NEG_Z] },
    Face { name: "right", axes: [DVec3::Z, DVec3::Y, DVec3::X] },
    Face { name: "back", axes: [DVec3::NEG_X, DVec3::Y, DVec3::Z] },
    Face { name: "left", axes: [DVec3::NEG_Z, DVec3::Y, DVec3::NEG_X] },
    Face { name: "up", axes: [DVec3::X, DVec3::Z, DVec3::Y] },
    Face { name: "down", axes: [DVec3::X, DVec3::NEG_Z, DVec3::NEG_Y] },
];

/// Draws the faces and writes the image, or them.
///
/// # Errors
/// The scene, pose or size is refused, there is no GPU, or a file cannot be written.
pub fn run(args: PanoramaArgs) -> anyhow::Result<()> {
    super::local::init_log();
    let is_png = args.file.extension().is_some_and(|extension| extension == "png");
    ensure!(is_png, "{}: the name must end with .png", args.file.display());
    super::out::check_place(&args.file)?;
    let request = args.draw.request(args.pose.pose(args.scene.up()))?;
    ensure!(!request.settings.is_part(), "--part-of: a panorama has no parts");
    ensure!(
        !request.settings.is_blurred(),
        "--aperture, --shutter: a panorama is sharp; leave them out"
    );
    ensure!(
        request.settings.eye_shift().is_none(),
        "--eye-offset: each face would be seen from another place; leave it out"
    );
    let width = args.width.unwrap_or(match args.layout {
        Layout::Equirectangular => 2048,
        Layout::Cube => 1024,
    });
    ensure!(
        args.layout == Layout::Cube || width.is_multiple_of(2),
        "--width: {width} is odd, and an equirectangular image is half as high as wide; accepted: an even number"
    );
    // A face whose middle has more pixels to an angle than the image.
    let side = match args.layout {
        Layout::Equirectangular => (f64::from(width) * 1.25 / PI).ceil() as u32,
        Layout::Cube => width,
    };
    let (engine, _) = args.scene.load_and_warn()?;
    check_side(&engine, &request, args.layout, side)?;
    let eye = Eye::of(&engine, &request)?;
    let drawn =
        FrameRequest { width: side + 2 * MARGIN_PX, height: side + 2 * MARGIN_PX, ..request };
    // Settings for a goal are chosen once: faces that are drawn differently would have seams.
    let asked = FACES.each_ref().map(|face| eye.face(&drawn, face, side));
    let settings = super::path::settings_for_all(&engine, &asked, drawn.settings)?;
    let drawn = FrameRequest { settings, ..drawn };
    super::path::bake(&engine, &eye.face(&drawn, &FACES[0], side))?;
    let settings = alike(&engine, &eye, &drawn, side)?;
    let drawn = FrameRequest { settings, ..drawn };
    let bar = progress_bar();
    bar.set_message("drawing");
    let mut faces = Vec::with_capacity(FACES.len());
    for (number, face) in (1..).zip(&FACES) {
        let frame = engine.submit(eye.face(&drawn, face, side))?.wait()?;
        faces.push(Sheet::of(&frame.bytes, drawn.width)?);
        bar.set_position(1000 * number / FACES.len() as u64);
    }
    bar.finish_and_clear();
    match args.layout {
        Layout::Equirectangular => {
            let height = width / 2;
            write(
                &args.file,
                [width, height],
                &equirectangular(&faces, side, [width, height]),
                true,
            )?;
            say!("{}: {width} × {height} pixels", args.file.display());
        }
        Layout::Cube => {
            let stem = args.file.file_stem().context("the image has no name")?.to_string_lossy();
            for (face, sheet) in FACES.iter().zip(&faces) {
                let file = args.file.with_file_name(format!("{stem}-{}.png", face.name));
                write(&file, [side, side], &sheet.within(MARGIN_PX, side), false)?;
                say!("{}: {side} × {side} pixels", file.display());
            }
        }
    }
    Ok(())
}

/// The settings with one way to draw samples for all faces.
///
/// # Errors
/// A face is refused, or what it needs cannot be baked.
fn alike(
    engine: &Engine,
    eye: &Eye,
    drawn: &FrameRequest,
    side: u32,
) -> Result<Settings, EngineError> {
    if !drawn.settings.leaves_drawing_open() {
        return Ok(drawn.settings);
    }
    let way = |face: &Face| -> Result<Reconstruct, EngineError> {
        Ok(engine.resolve_blocking(eye.face(drawn, face, side))?.settings().reconstruct)
    };
    let ways = FACES.iter().map(way).collect::<Result<Vec<Reconstruct>, EngineError>>()?;
    Ok(drawn.settings.decided(together(&ways)))
}

/// The way to draw samples that serves all faces: that of all, or splats, which close surfaces at every distance.
fn together(ways: &[Reconstruct]) -> Reconstruct {
    match ways {
        [first, others @ ..] if others.iter().all(|other| other == first) => *first,
        _ => Reconstruct::Splats,
    }
}

/// Refuses faces that are larger than frames may be.
fn check_side(
    engine: &Engine,
    request: &FrameRequest,
    layout: Layout,
    side: u32,
) -> anyhow::Result<()> {
    let (limits, parts) = (engine.limits(), request.settings.parts());
    let most = (limits.max_side / parts).min((limits.max_pixels.isqrt() / u64::from(parts)) as u32);
    let most = most.saturating_sub(2 * MARGIN_PX);
    if side <= most {
        return Ok(());
    }
    let most = match layout {
        Layout::Equirectangular => (f64::from(most) * PI / 2.5).floor() as u32 * 2,
        Layout::Cube => most,
    };
    bail!("--width: too large within the limits of frames; accepted: up to {most}")
}

/// Where the panorama is seen from.
struct Eye {
    position: DVec3,
    /// Rows are right, up and backward in world space; up is that of the scene or of the camera, and the middle of the image is level.
    axes: DMat3,
}

impl Eye {
    fn of(engine: &Engine, request: &FrameRequest) -> anyhow::Result<Eye> {
        let camera = engine.resolve_blocking(request.clone())?.camera().clone();
        let [eye, target, up] = [camera.eye, camera.target, camera.up].map(DVec3::from);
        Eye::looking(eye, target - eye, up)
            .context("the camera has no direction; give --eye and --target")
    }

    /// Returns `None` where a direction is missing.
    fn looking(position: DVec3, ahead: DVec3, up: DVec3) -> Option<Eye> {
        let up = up.try_normalize()?;
        let ahead = ahead.try_normalize()?;
        let level = ahead.reject_from_normalized(up);
        // Straight up or down there is no direction that is level: any will do.
        let level = match level.length_squared() > 1e-12 {
            true => level.normalize_or(up.any_orthonormal_vector()),
            false => up.any_orthonormal_vector(),
        };
        let rows = [level.cross(up), up, -level];
        Some(Eye { position, axes: DMat3::from_cols_array_2d(&rows.map(Into::into)).transpose() })
    }

    /// Returns the request for a face with its margin.
    fn face(&self, drawn: &FrameRequest, face: &Face, side: u32) -> FrameRequest {
        let [right, up, ahead] = face.axes;
        let world = self.axes.transpose();
        let rows = [world * right, world * up, -(world * ahead)];
        let half = f64::from(side) / 2.0;
        let view = View {
            eye: self.position,
            view_from_world: DMat3::from_cols_array_2d(&rows.map(Into::into)).transpose(),
            projection: Projection::Perspective,
            focus: 1.0,
            focal_px: DVec2::splat(half),
            principal_px: DVec2::splat(half + f64::from(MARGIN_PX)),
            width: drawn.width,
            height: drawn.height,
        };
        FrameRequest { pose: Pose::View(view), format: ImageFormat::Raw, ..drawn.clone() }
    }
}

/// Pixels of a face with its margin: RGBA with straight alpha, row by row.
struct Sheet {
    width: u32,
    rgba: Vec<[u8; 4]>,
}

impl Sheet {
    fn of(bytes: &[u8], width: u32) -> anyhow::Result<Sheet> {
        let (rgba, _) = bytes.as_chunks::<4>();
        ensure!(rgba.len() == (width * width) as usize, "a frame of another size was drawn");
        Ok(Sheet { width, rgba: rgba.to_vec() })
    }

    /// Cuts the margin off.
    fn within(&self, margin: u32, side: u32) -> Vec<[u8; 4]> {
        let (margin, side) = (margin as usize, side as usize);
        let rows = self.rgba.chunks_exact(self.width as usize).skip(margin).take(side);
        rows.flat_map(|row| &row[margin..margin + side]).copied().collect()
    }

    /// The value at a place in pixels, between four pixels, in linear light and multiplied by alpha.
    fn at(&self, place: DVec2) -> [f64; 4] {
        let most = f64::from(self.width - 1);
        let place = (place - 0.5).clamp(DVec2::ZERO, DVec2::splat(most));
        let corner = place.floor().min(DVec2::splat(most - 1.0));
        let share = place - corner;
        let first = corner.y as usize * self.width as usize + corner.x as usize;
        let mut sum = [0.0; 4];
        for (offset, weight) in [
            (0, (1.0 - share.x) * (1.0 - share.y)),
            (1, share.x * (1.0 - share.y)),
            (self.width as usize, (1.0 - share.x) * share.y),
            (self.width as usize + 1, share.x * share.y),
        ] {
            let [r, g, b, a] = self.rgba[first + offset];
            let alpha = weight * f64::from(a) / 255.0;
            for (channel, byte) in [r, g, b].into_iter().enumerate() {
                sum[channel] += alpha * LINEAR[usize::from(byte)];
            }
            sum[3] += alpha;
        }
        sum
    }
}

/// Linear light of each byte.
static LINEAR: LazyLock<[f64; 256]> =
    LazyLock::new(|| std::array::from_fn(|byte| linear_from_srgb(byte as f64 / 255.0)));

/// The direction of a place in an equirectangular image, in the eye's axes. The middle of the image lies ahead, its left and right edges
/// behind; the upper edge is up.
fn direction(place: DVec2, [width, height]: [u32; 2]) -> DVec3 {
    let longitude = (place.x / f64::from(width) - 0.5) * TAU;
    let latitude = (0.5 - place.y / f64::from(height)) * PI;
    let (sin, cos) = longitude.sin_cos();
    DVec3::new(latitude.cos() * sin, latitude.sin(), -latitude.cos() * cos)
}

/// The face that a direction meets, and the place on it in pixels, from the corner of the face's margin.
fn on_face(direction: DVec3, side: u32) -> (usize, DVec2) {
    let ahead = |face: &Face| direction.dot(face.axes[2]);
    let mut best = 0;
    for (number, face) in FACES.iter().enumerate() {
        if ahead(face) > ahead(&FACES[best]) {
            best = number;
        }
    }
    let face = &FACES[best];
    let half = f64::from(side) / 2.0;
    let across = DVec2::new(direction.dot(face.axes[0]), -direction.dot(face.axes[1]));
    (best, across / ahead(face) * half + half + f64::from(MARGIN_PX))
}

/// Takes an equirectangular image from six faces.
fn equirectangular(faces: &[Sheet], side: u32, size: [u32; 2]) -> Vec<[u8; 4]> {
    let [width, height] = size;
    let pixel = |x: u32, y: u32| {
        let mut sum = [0.0; 4];
        for tap in 0..TAPS * TAPS {
            let within = DVec2::new(f64::from(tap % TAPS), f64::from(tap / TAPS)) + 0.5;
            let place = DVec2::new(f64::from(x), f64::from(y)) + within / f64::from(TAPS);
            let (face, place) = on_face(direction(place, size), side);
            let found = faces[face].at(place);
            sum = std::array::from_fn(|channel| sum[channel] + found[channel]);
        }
        let byte = |unit: f64| (255.0 * unit.clamp(0.0, 1.0)).round() as u8;
        if sum[3] <= 0.0 {
            return [0; 4];
        }
        let color = |channel: usize| byte(srgb_from_linear(sum[channel] / sum[3]));
        [color(0), color(1), color(2), byte(sum[3] / f64::from(TAPS * TAPS))]
    };
    let row = |y: u32| (0..width).map(move |x| pixel(x, y));
    (0..height).into_par_iter().flat_map_iter(row).collect()
}

/// Returns the note by which viewers recognise an image of a whole sphere (Google, Photo Sphere XMP Metadata).
fn sphere_note([width, height]: [u32; 2]) -> String {
    let numbers = [
        ("FullPanoWidthPixels", width),
        ("FullPanoHeightPixels", height),
        ("CroppedAreaImageWidthPixels", width),
        ("CroppedAreaImageHeightPixels", height),
        ("CroppedAreaLeftPixels", 0),
        ("CroppedAreaTopPixels", 0),
    ];
    let attributes: String =
        numbers.iter().map(|(name, value)| format!(" GPano:{name}=\"{value}\"")).collect();
    format!(
        "<x:xmpmeta xmlns:x=\"adobe:ns:meta/\"><rdf:RDF xmlns:rdf=\"http://www.w3.org/1999/02/22-rdf-syntax-ns#\"><rdf:Description rdf:about=\"\" xmlns:GPano=\"http://ns.google.com/photos/1.0/panorama/\" GPano:ProjectionType=\"equirectangular\"{attributes}/></rdf:RDF></x:xmpmeta>"
    )
}

/// Writes a PNG file, which takes its name when it is complete.
fn write(path: &Path, size: [u32; 2], rgba: &[[u8; 4]], is_sphere: bool) -> anyhow::Result<()> {
    let unwritable = || format!("{} cannot be written", path.display());
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    let file = tempfile::NamedTempFile::new_in(folder.unwrap_or(Path::new(".")))
        .with_context(unwritable)?;
    let mut encoder = Encoder::new(BufWriter::new(file.as_file()), size[0], size[1]);
    encoder.set_color(ColorType::Rgba);
    encoder.set_depth(BitDepth::Eight);
    encoder.set_source_srgb(SrgbRenderingIntent::RelativeColorimetric);
    if is_sphere {
        encoder.add_itxt_chunk("XML:com.adobe.xmp".to_owned(), sphere_note(size))?;
    }
    let mut header = encoder.write_header()?;
    header.write_image_data(rgba.as_flattened())?;
    header.finish()?;
    file.persist(path).with_context(unwritable)?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faces_are_drawn_alike() {
        use Reconstruct::{Points, PullPush, Splats};
        assert_eq!(together(&[Points; 6]), Points);
        assert_eq!(together(&[PullPush; 6]), PullPush);
        assert_eq!(together(&[Points, Points, Splats, Points, Points, Points]), Splats);
        assert_eq!(together(&[PullPush, Points, Points, Points, Points, Points]), Splats);
    }

    #[test]
    fn faces_are_right_handed_and_cover_all_directions() {
        for face in &FACES {
            let [right, up, ahead] = face.axes;
            assert_eq!(right.cross(up), -ahead, "{}", face.name);
        }
        let [width, height] = [64, 32];
        let mut met = [0; 6];
        for y in 0..height {
            for x in 0..width {
                let place = DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
                let (face, place) = on_face(direction(place, [width, height]), 100);
                met[face] += 1;
                let place = place - f64::from(MARGIN_PX);
                assert!(place.min_element() >= 0.0 && place.max_element() <= 100.0, "{place}");
            }
        }
        assert!(met.iter().all(|count| *count > 100), "{met:?}");
    }

    #[test]
    fn the_middle_lies_ahead_and_the_left_is_left() {
        let size = [400, 200];
        let at = |x: f64, y: f64| {
            let (face, place) = on_face(direction(DVec2::new(x, y), size), 100);
            (FACES[face].name, place.round() - f64::from(MARGIN_PX))
        };
        let middle = DVec2::splat(50.0);
        assert_eq!(at(200.0, 100.0), ("front", middle));
        assert_eq!(at(300.0, 100.0), ("right", middle));
        assert_eq!(at(100.0, 100.0), ("left", middle));
        assert_eq!(at(0.0, 100.0), ("back", middle));
        assert_eq!((at(200.0, 0.0), at(200.0, 200.0)), (("up", middle), ("down", middle)));
        // A step upwards in front of the eye, and one to the right, move up and to the right on its face.
        assert!(at(200.0, 80.0).1.y < 50.0 && at(220.0, 100.0).1.x > 50.0);
        // The upper face joins the front one at its lower edge.
        let (face, place) = at(200.0, 45.0);
        assert!(face == "up" && place.y > 90.0, "{face} {place}");
    }

    /// Faces that show their directions as colours: the image shows them as well, also across edges.
    #[test]
    fn an_image_is_taken_from_its_faces() {
        let side = 128;
        let width = side + 2 * MARGIN_PX;
        let byte = |unit: f64| (127.5 + 127.5 * unit).round() as u8;
        let sheets: Vec<Sheet> = FACES
            .iter()
            .map(|face| {
                let [right, up, ahead] = face.axes;
                let pixel = |at: u32| {
                    let half = f64::from(width) / 2.0;
                    let x = f64::from(at % width) + 0.5 - half;
                    let y = half - (f64::from(at / width) + 0.5);
                    let way = (x * right + y * up) / (f64::from(side) / 2.0) + ahead;
                    let way = way.normalize_or_zero();
                    [byte(way.x), byte(way.y), byte(way.z), 255]
                };
                Sheet { width, rgba: (0..width * width).map(pixel).collect() }
            })
            .collect();
        let size = [256, 128];
        let image = equirectangular(&sheets, side, size);
        let mut worst = 0;
        for (at, found) in (0u32..).zip(&image) {
            let place = DVec2::new(f64::from(at % 256) + 0.5, f64::from(at / 256) + 0.5);
            let way = direction(place, size);
            for (found, wanted) in found.iter().zip([byte(way.x), byte(way.y), byte(way.z), 255]) {
                worst = worst.max(found.abs_diff(wanted));
            }
        }
        assert!(worst <= 2, "{worst}");
    }

    #[test]
    fn the_middle_is_level_whatever_the_camera_does() {
        for ahead in [DVec3::new(3.0, -2.0, 1.0), DVec3::NEG_Z, DVec3::NEG_Y, DVec3::Y] {
            let eye = Eye::looking(DVec3::ZERO, ahead, 2.0 * DVec3::Y).unwrap();
            let up = eye.axes * DVec3::Y;
            assert!((up - DVec3::Y).length() < 1e-12, "{ahead}: {up}");
            assert!((eye.axes.determinant() - 1.0).abs() < 1e-12);
        }
        assert!(Eye::looking(DVec3::ZERO, DVec3::ZERO, DVec3::Y).is_none());
        assert!(Eye::looking(DVec3::ZERO, DVec3::X, DVec3::ZERO).is_none());
    }
}
