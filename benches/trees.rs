//! Ten trees of 100,000 leaves as lines and as triangles (Marroquim et al. 2008, figure 19), and how alike the pictures are.
//!
//! Frames are drawn in turns, as points and as splats, at three distances. Both forms come from one skeleton.

mod common;

use anyhow::{Context, ensure};
use common::drawing::{Drawing, Orbit, pass_medians};
use common::report::{Bound, Report, number};
use common::shots::{Shot, take, take_images};
use common::{files, median, median_ratio, pick};
use glam::DVec3;
use pointillist::accuracy::metrics::psnr;
use pointillist::encode::ImageFormat;
use pointillist::engine::EncodedFrame;
use pointillist::generate::Form;
use pointillist::plan::{Reconstruct, Settings};

const SIZE: u32 = 1024;
/// Before pictures are compared, the mean of this many by this many pixels is taken: places within a pixel are left to chance.
const BOX_PX: usize = 4;
/// Heights of a tree from the camera to the grove's middle.
const DISTANCES: [(&str, f64); 3] = [("near", 2.3), ("whole grove", 4.7), ("far", 14.0)];
/// Height of the trees.
const HEIGHT: f64 = 8.0;

fn main() -> anyhow::Result<()> {
    let leaves = pick(100_000, 1_000);
    let lines = Drawing::open(&files::grove(Form::Lines, leaves)?, SIZE, |_| ())?;
    let triangles = lines.beside(&files::grove(Form::Triangles, leaves)?)?;
    let mut report = Report::new("trees", &lines.engine.adapter());
    report.value("leaves", leaves);
    report.value("segments", lines.info.segments);
    report.value("triangles", triangles.info.triangles);
    let (mut rows, mut passes) = (Vec::new(), Vec::new());
    let mut ratios = Vec::new();
    for (name, reconstruct) in [("points", Reconstruct::Points), ("splats", Reconstruct::Splats)] {
        for (place, distance) in DISTANCES {
            let target = DVec3::new(0.05, 0.42, 0.0) * HEIGHT;
            let eye = target + DVec3::new(0.1, 0.13, 1.0) * (distance * HEIGHT);
            let orbit = Orbit { eye, target, fov_deg: 40.0 };
            let settings = Settings::drawn_as(reconstruct);
            let shots = [&lines, &triangles].map(|drawing| Shot {
                drawing,
                orbit,
                size: [SIZE, SIZE],
                settings,
            });
            let taken = take(&shots, pick((2, 9), (1, 2)))?;
            let [of_lines, of_triangles] = [taken[0].gpu_ms()?, taken[1].gpu_ms()?];
            let ratio = median_ratio(&of_triangles, &of_lines);
            let decibels = likeness(&shots)?;
            report.value(&format!("{name}, {place}: triangles over lines"), ratio);
            report.value(&format!("{name}, {place}: lines ms"), median(&of_lines));
            report.value(&format!("{name}, {place}: triangles ms"), median(&of_triangles));
            report.value(&format!("{name}, {place}: PSNR dB"), decibels);
            rows.push(vec![
                format!("{name}, {place}"),
                number(median(&of_lines)),
                number(median(&of_triangles)),
                number(ratio),
                number(decibels),
            ]);
            for (form, taken) in [("lines", &taken[0]), ("triangles", &taken[1])] {
                for (pass, time) in pass_medians(&taken.receipts) {
                    passes.push(vec![format!("{name}, {place}, {form}: {pass}"), number(time)]);
                }
            }
            if place == "whole grove" {
                ratios.push((name, ratio));
            }
        }
    }
    report.table(
        "Ten trees, the same poses",
        &["frame", "lines, GPU ms", "triangles, GPU ms", "×", "PSNR dB of 4 × 4 means"],
        &rows,
    );
    report.table("Passes", &["pass", "ms"], &passes);
    for (name, ratio) in ratios {
        report.target(
            &format!("ten trees as lines against triangles, {name}, the whole grove"),
            Some(ratio),
            Bound::AtLeast(2.5),
            "×",
        );
    }
    report.finish()
}

/// How alike the two shots' frames are, in decibels.
fn likeness(shots: &[Shot]) -> anyhow::Result<f64> {
    let mut found = f64::NAN;
    take_images(shots, ImageFormat::Raw, (0, 1), |images| {
        let [a, b] = images else { anyhow::bail!("two pictures expected") };
        found = psnr(&means(a)?, &means(b)?)?;
        Ok(())
    })?;
    Ok(found)
}

/// The means of boxes of pixels.
fn means(frame: &EncodedFrame) -> anyhow::Result<Vec<[u8; 4]>> {
    let pixels: &[[u8; 4]] = frame.bytes.as_chunks().0;
    let size = SIZE as usize;
    ensure!(pixels.len() == size * size, "a raw frame has four bytes a pixel");
    let boxes = size / BOX_PX;
    let mean = |index: usize| {
        let (x, y) = (index % boxes * BOX_PX, index / boxes * BOX_PX);
        let rows = (y..y + BOX_PX).map(|row| &pixels[row * size + x..][..BOX_PX]);
        let mut sums = [0u32; 4];
        for pixel in rows.flatten() {
            sums.iter_mut().zip(pixel).for_each(|(sum, &channel)| *sum += u32::from(channel));
        }
        let count = (BOX_PX * BOX_PX) as u32;
        sums.map(|sum| ((sum + count / 2) / count) as u8)
    };
    Some((0..boxes * boxes).map(mean).collect()).context("no pixels")
}
