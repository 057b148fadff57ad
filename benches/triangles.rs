//! Triangles: from which size on they are better not left to a single thread, and meshes beside VTK.
//!
//! The crossing belongs into `small_triangle_px` (`src/passes/mod.rs`). Two engines draw the same grids of equal
//! triangles in turns, one told to walk all that the walk can take, one to rasterise everything.

mod common;

use std::path::Path;

use common::drawing::{Drawing, Orbit, STEP_DEG, pass_ns};
use common::peer::Peer;
use common::report::{Report, number};
use common::{crossing_px, files, median, median_ratio, ms, pick};
use glam::DVec3;
use pointillist::engine::Receipt;
use pointillist::generate::{Kind, Parameters};
use pointillist::math::Camera;
use pointillist::passes::small_triangle_px;

const SIZE: u32 = 1024;
const SIDES_PX: [u32; 8] = [1, 2, 4, 8, 16, 32, 64, 128];
/// The walk's integers hold no longer boxes.
const WALK_LIMIT_PX: u32 = 60;

fn main() -> anyhow::Result<()> {
    let probe = Drawing::open(&files::triangle_grid(64, SIZE)?, SIZE, |_| ())?;
    let mut report = Report::new("triangles", &probe.engine.adapter());
    drop(probe);
    crossing(&mut report)?;
    let triangles = pick(400_000, 40_000);
    let parameters = Parameters { seed: 1, triangles: Some(triangles), ..Parameters::default() };
    let relief = files::generated(&format!("relief-{triangles}.ply"), Kind::Relief, &parameters)?;
    let mut rows = beside_vtk("relief", &relief, &mut report)?;
    match files::dragon() {
        Some(file) => rows.extend(beside_vtk("Stanford dragon", &file, &mut report)?),
        None => println!("!! SKIPPED: the Stanford dragon; `make data` brings it"),
    }
    report.table(
        "Meshes, the same poses",
        &[
            "mesh",
            "triangles",
            "GPU ms",
            "M triangles/s",
            "VTK ms",
            "×",
            "JPEG ms",
            "VTK JPEG ms",
            "×",
        ],
        &rows,
    );
    report.finish()
}

/// Time of the passes that put triangles into the visibility buffer.
fn coverage_ms(receipt: &Receipt) -> anyhow::Result<f64> {
    let mut sum = 0;
    for name in [
        "project_triangles",
        "rasterise_triangles",
        "walk_triangles",
        "project_triangles_id",
        "rasterise_triangles_id",
        "walk_triangles_id",
    ] {
        sum += pass_ns(receipt, name)?;
    }
    Ok(ms(sum))
}

/// One unit of the plane z = 0 a pixel, and no corner on a pixel's edge or centre.
fn facing(frame: u32) -> Camera {
    let shift = 0.01 * f64::from(frame);
    let distance = f64::from(SIZE);
    let center = DVec3::new(0.5 * distance + 0.371 + shift, 0.5 * distance + 0.613, 0.0);
    Camera::perspective(center + DVec3::Z * distance, center, 2.0 * 0.5f64.atan().to_degrees())
}

/// How triangles can be drawn: name, longest side that a thread walks alone, and who draws the others.
const WAYS: [(&str, u32, bool); 3] =
    [("thread", WALK_LIMIT_PX, false), ("walk_triangles", 0, false), ("rasteriser", 0, true)];

fn crossing(report: &mut Report) -> anyhow::Result<()> {
    let mut rows = Vec::new();
    // Side and the second and third way's time over the thread's, where all can draw.
    let mut ratios: [Vec<(f64, f64)>; 2] = Default::default();
    for side in SIDES_PX {
        let file = files::triangle_grid(side, SIZE)?;
        let drawings = WAYS
            .iter()
            .map(|&(_, px, rasterise)| {
                Drawing::open(&file, SIZE, |config| {
                    config.small_triangle_px = Some(px);
                    config.rasterise = Some(rasterise);
                    // A million triangles of a pixel, each drawn as if it were large, are over what a daemon allows.
                    config.large_units_limit = Some(u32::MAX);
                })
            })
            .collect::<anyhow::Result<Vec<_>>>()?;
        let mut times: [Vec<f64>; 3] = Default::default();
        let (warm, frames) = pick((3, 15), (1, 2));
        let mut alone = false;
        for frame in 0..warm + frames {
            for (way, drawing) in drawings.iter().enumerate() {
                let receipt = drawing.receipt(facing(frame))?;
                if way == 0 {
                    alone = receipt.triangles.rasterised == Some(0);
                }
                if frame >= warm {
                    times[way].push(coverage_ms(&receipt)?);
                }
            }
        }
        let count = drawings[0].info.triangles;
        let mut row = vec![side.to_string(), count.to_string()];
        for (way, (name, _, _)) in WAYS.iter().enumerate() {
            if way == 0 && !alone {
                row.extend(["—".to_owned(), "—".to_owned()]);
                continue;
            }
            let time = median(&times[way]);
            report.value(&format!("{name}_{side}_px_ms"), time);
            row.extend([number(time), number(time * 1e6 / count as f64)]);
        }
        for way in [1, 2] {
            let ratio = median_ratio(&times[way], &times[0]);
            row.push(if alone { number(ratio) } else { "—".to_owned() });
            if alone {
                ratios[way - 1].push((f64::from(side), ratio));
            }
        }
        rows.push(row);
    }
    report.table(
        "Equal triangles that cover the frame, drawn in three ways",
        &[
            "side px",
            "triangles",
            "thread ms",
            "ns each",
            "walk_triangles ms",
            "ns each",
            "rasteriser ms",
            "ns each",
            "walk/thread",
            "rasteriser/thread",
        ],
        &rows,
    );
    for (way, ratios) in ratios.iter().enumerate() {
        let crossing = crossing_px(ratios);
        println!("{}", explain(WAYS[way + 1].0, crossing, ratios));
        report.value(&format!("crossing_{}_px", WAYS[way + 1].0), crossing);
    }
    report.value("small_triangle_px", small_triangle_px(true));
    report.value("small_triangle_px_gpu", small_triangle_px(false));
    Ok(())
}

fn explain(other: &str, crossing: Option<f64>, ratios: &[(f64, f64)]) -> String {
    let now = format!(
        "small_triangle_px is {} for CPUs, {} for GPUs",
        small_triangle_px(true),
        small_triangle_px(false)
    );
    match (crossing, ratios.first()) {
        (Some(side), _) => {
            format!("a thread beats {other} up to {} px on this machine; {now}", number(side))
        }
        (None, Some((_, ratio))) if *ratio < 1.0 => {
            format!("{other} is faster at every size on this machine; {now}")
        }
        (None, _) => format!(
            "a thread beats {other} at every size that it can take ({WALK_LIMIT_PX} px) on this machine; {now}"
        ),
    }
}

/// A mesh at the same poses, drawn by both: without and with a JPEG at the end.
fn beside_vtk(name: &str, file: &Path, report: &mut Report) -> anyhow::Result<Vec<Vec<String>>> {
    let ours = Drawing::open(file, SIZE, |_| ())?;
    let orbit = Orbit::around(&ours.info)?;
    for warm in 0..3 {
        ours.receipt(orbit.at(f64::from(warm) - 10.0))?;
    }
    let mut drawn = Peer::vtk(file, &orbit, SIZE, &["--mode=surface"])?;
    let mut encoded = Peer::vtk(file, &orbit, SIZE, &["--mode=surface", "--jpeg=85"])?;
    let (mut gpu, mut jpeg, mut peer, mut peer_jpeg) = (vec![], vec![], vec![], vec![]);
    for frame in 0..pick(11, 2) {
        let degrees = f64::from(frame) * STEP_DEG + 5.0;
        let receipt = ours.receipt(orbit.at(degrees))?;
        gpu.extend(receipt.gpu_ns.map(ms));
        jpeg.push(ms(receipt.total_ns));
        for (vtk, times) in [(&mut drawn, &mut peer), (&mut encoded, &mut peer_jpeg)] {
            if let Some(vtk) = vtk {
                times.push(vtk.frame_ms(degrees)?);
            }
        }
    }
    let (ratio, jpeg_ratio) = (median_ratio(&peer, &gpu), median_ratio(&peer_jpeg, &jpeg));
    let (gpu, jpeg) = (median(&gpu), median(&jpeg));
    let (peer, peer_jpeg) = (median(&peer), median(&peer_jpeg));
    for (what, time) in [("gpu", gpu), ("vtk", peer), ("jpeg", jpeg), ("vtk jpeg", peer_jpeg)] {
        report.value(&format!("{name}, {what} ms"), time);
    }
    Ok(vec![vec![
        name.to_owned(),
        ours.info.triangles.to_string(),
        number(gpu),
        number(ours.info.triangles as f64 / gpu / 1e3),
        number(peer),
        number(ratio),
        number(jpeg),
        number(peer_jpeg),
        number(jpeg_ratio),
    ]])
}
