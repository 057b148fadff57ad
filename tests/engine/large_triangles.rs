//! More large triangles than their list initially has room for.

use std::fmt::Write as _;

use pointillist::engine::{FrameRequest, Pose};
use pointillist::math::Camera;
use pointillist::plan::Output;

use super::studio::{Studio, depths, fit, same};
use glam::DVec3;

const SIDE: u32 = 2400;
/// Width of a strip in pixels, larger than the limit of triangles that a thread walks by itself.
const STRIP: u32 = 34;
const DISTANCE: f64 = 5.0;

/// Strips one pixel high, side by side, that cover the first columns of a frame. Each consists of two triangles.
fn strips() -> (String, u32) {
    let columns = SIDE / STRIP;
    let quads = columns * SIDE;
    let mut text = format!(
        "ply\nformat ascii 1.0\nelement vertex {}\nproperty double x\nproperty double y\nproperty double z\n\
         element face {}\nproperty list uchar int vertex_indices\nend_header\n",
        4 * quads,
        2 * quads
    );
    // With a vertical field of view of 90° a pixel is 2 · distance / side wide.
    let at = |pixel: u32| (f64::from(pixel) / f64::from(SIDE) * 2.0 - 1.0) * DISTANCE;
    for row in 0..SIDE {
        for column in 0..columns {
            let (left, right) = (at(column * STRIP), at((column + 1) * STRIP));
            let (top, bottom) = (-at(row), -at(row + 1));
            for (x, y) in [(left, top), (left, bottom), (right, bottom), (right, top)] {
                writeln!(text, "{x} {y} 0").unwrap();
            }
        }
    }
    for quad in 0..quads {
        let [a, b, c, d] = [0, 1, 2, 3].map(|corner| 4 * quad + corner);
        writeln!(text, "3 {a} {b} {c}\n3 {a} {c} {d}").unwrap();
    }
    (text, columns * STRIP)
}

#[test]
fn a_frame_with_too_many_is_drawn_again() {
    let (text, covered_columns) = strips();
    for force_32_bit in [false, true] {
        let studio = Studio::with(|config| config.force_32_bit = force_32_bit);
        studio.write("strips.ply", &text);
        studio.load("strips", "strips.ply");
        let camera = Camera::perspective(DVec3::Z * DISTANCE, DVec3::ZERO, 90.0);
        let request =
            FrameRequest { pose: Pose::Camera(camera), ..fit("strips", SIDE, Output::Depth) };
        let frame = studio.frame(&request);
        let rasterised = frame.receipt.triangles.rasterised.unwrap();
        assert!(rasterised > 1 << 18, "{rasterised} large triangles");
        for (pixel, depth) in depths(&frame.bytes).into_iter().enumerate() {
            let column = pixel as u32 % SIDE;
            if column < covered_columns {
                assert!((depth - DISTANCE as f32).abs() < 1e-4, "pixel {pixel}: {depth}");
            } else if column > covered_columns {
                assert_eq!(depth, f32::INFINITY, "pixel {pixel}");
            }
        }
        same(&studio.bytes(&request), &frame.bytes, "with room at once");
    }
}
