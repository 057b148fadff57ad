//! Triangles: from which size on the rasteriser beats the compute walk, and meshes beside VTK.
//!
//! The crossing belongs into `SMALL_TRIANGLE_PX` (`src/passes/mod.rs`). Two engines draw the same grids of equal
//! triangles in turns, one told to walk all that the walk can take, one to rasterise everything.

mod common;

use std::path::Path;

use common::drawing::{Drawing, Orbit, STEP_DEG, pass_ns};
use common::peer::Vtk;
use common::report::{Report, number};
use common::{files, median, median_ratio, ms, pick};
use glam::DVec3;
use pointillist::engine::Receipt;
use pointillist::generate::{Kind, Parameters};
use pointillist::math::Camera;
use pointillist::passes::SMALL_TRIANGLE_PX;

const SIZE: u32 = 1024;
const SIDES_PX: [u32; 8] = [1, 2, 4, 8, 16, 32, 64, 128];
/// The walk's integers hold no longer boxes.
const WALK_LIMIT_PX: u32 = 64;

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
        "project_triangles_id",
        "rasterise_triangles_id",
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
    Camera {
        eye: center + DVec3::Z * distance,
        target: center,
        up: DVec3::Y,
        fov_deg: 2.0 * 0.5f64.atan().to_degrees(),
    }
}

fn crossing(report: &mut Report) -> anyhow::Result<()> {
    let mut rows = Vec::new();
    // Side and rasteriser's time over the walk's, where both can draw.
    let mut ratios: Vec<(f64, f64)> = Vec::new();
    for side in SIDES_PX {
        let file = files::triangle_grid(side, SIZE)?;
        let open = |px| Drawing::open(&file, SIZE, |config| config.small_triangle_px = Some(px));
        let (walk, raster) = (open(WALK_LIMIT_PX)?, open(0)?);
        let (mut walk_ms, mut raster_ms) = (Vec::new(), Vec::new());
        let mut whole: [Vec<f64>; 2] = Default::default();
        let (warm, frames) = pick((3, 15), (1, 2));
        let mut walked = false;
        for frame in 0..warm + frames {
            let receipts = (walk.receipt(facing(frame))?, raster.receipt(facing(frame))?);
            walked = receipts.0.triangles.rasterised == Some(0);
            if frame >= warm {
                walk_ms.push(coverage_ms(&receipts.0)?);
                raster_ms.push(coverage_ms(&receipts.1)?);
                whole[0].extend(receipts.0.gpu_ns.map(ms));
                whole[1].extend(receipts.1.gpu_ns.map(ms));
            }
        }
        let ratio = median_ratio(&raster_ms, &walk_ms);
        let (walk_ms, raster_ms) = (median(&walk_ms), median(&raster_ms));
        let count = walk.info.triangles;
        let each_ns = |time: f64| number(time * 1e6 / count as f64);
        report.value(&format!("raster_{side}_px_ms"), raster_ms);
        let mut row = vec![side.to_string(), count.to_string()];
        if walked {
            report.value(&format!("walk_{side}_px_ms"), walk_ms);
            ratios.push((f64::from(side), ratio));
            row.extend([number(walk_ms), each_ns(walk_ms)]);
        } else {
            row.extend(["—".to_owned(), "—".to_owned()]);
        }
        row.extend([number(raster_ms), each_ns(raster_ms)]);
        row.push(if walked { number(ratio) } else { "—".to_owned() });
        row.push(if walked { number(median(&whole[0])) } else { "—".to_owned() });
        row.push(number(median(&whole[1])));
        rows.push(row);
    }
    report.table(
        "Equal triangles that cover the frame: compute walk and rasteriser",
        &[
            "side px",
            "triangles",
            "walk ms",
            "ns each",
            "rasteriser ms",
            "ns each",
            "rasteriser/walk",
            "frame, walk ms",
            "frame, rasteriser ms",
        ],
        &rows,
    );
    let crossing = crossing_px(&ratios);
    println!("{}", explain(crossing, &ratios));
    report.value("crossing_px", crossing);
    report.value("small_triangle_px", SMALL_TRIANGLE_PX);
    Ok(())
}

/// Where the ratio falls through one for good, interpolated on logarithmic axes; `None` when it does not.
fn crossing_px(ratios: &[(f64, f64)]) -> Option<f64> {
    let last_fast = ratios.iter().rposition(|(_, ratio)| *ratio >= 1.0)?;
    let (low, high) = (ratios.get(last_fast)?, ratios.get(last_fast + 1)?);
    let share = low.1.ln() / (low.1.ln() - high.1.ln());
    Some((low.0.ln() + share * (high.0.ln() - low.0.ln())).exp())
}

fn explain(crossing: Option<f64>, ratios: &[(f64, f64)]) -> String {
    let now = format!("SMALL_TRIANGLE_PX is {SMALL_TRIANGLE_PX}");
    match (crossing, ratios.first()) {
        (Some(side), _) => {
            format!("the walk is faster up to {} px on this machine; {now}", number(side))
        }
        (None, Some((_, ratio))) if *ratio < 1.0 => {
            format!("the rasteriser is faster at every size on this machine; {now}")
        }
        (None, _) => format!(
            "the walk is faster at every size that it can take ({WALK_LIMIT_PX} px) on this machine; {now}"
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
    let mut drawn = Vtk::start(file, &orbit, SIZE, &["--mode=surface"])?;
    let mut encoded = Vtk::start(file, &orbit, SIZE, &["--mode=surface", "--jpeg=85"])?;
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
