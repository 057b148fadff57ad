//! Splats: beside VTK's discs of equal footprint, beside our own points, beside Table 1 of the paper, and from which size on they
//! are better not left to a single thread.
//!
//! The paper is M. Zwicker, J. Räsänen, M. Botsch, C. Dachsbacher, M. Pauly, "Perspective Accurate Splatting", Graphics
//! Interface 2004. The crossing belongs into `small_splat_px` (`src/passes/mod.rs`).

mod common;

use std::path::PathBuf;

use common::drawing::{Drawing, Orbit, STEP_DEG, gpu_ms, pass_medians, pass_ns};
use common::files::Wall;
use common::gaussians::{PEERS, covered_percent, degrees, in_turns};
use common::peer::Peer;
use common::report::{Bound, Report, number};
use common::{files, median, median_ratio, ms, pick};
use glam::DVec3;
use pointillist::engine::Receipt;
use pointillist::generate::{Kind, Parameters};
use pointillist::passes::small_splat_px;
use pointillist::plan::{Reconstruct, Settings};
use pointillist::scene::{Blend, Filter};

const SIZE: u32 = 1024;
/// Radii of splats beside VTK's discs.
const RADII_PX: [f64; 2] = [1.5, 3.0];
const FILTERS: [(&str, Filter); 3] =
    [("affine", Filter::Affine), ("perspective", Filter::Perspective), ("exact", Filter::Exact)];
/// One pass and three, as the paper counts them.
const BLENDS: [(&str, Blend); 2] = [("1 pass", Blend::Opaque), ("3 passes", Blend::Weighted)];

fn main() -> anyhow::Result<()> {
    let probe = Drawing::open(&wall(64, 8.0, 8.0)?, SIZE, |_| ())?;
    let mut report = Report::new("splats", &probe.engine.adapter());
    drop(probe);
    let parts =
        std::env::var("BENCH_SPLATS").unwrap_or_else(|_| "vtk points paper crossing".into());
    for part in parts.split_whitespace() {
        match part {
            "vtk" => beside_vtk(&mut report)?,
            "points" => beside_points(&mut report)?,
            "paper" => beside_the_paper(&mut report)?,
            "crossing" => crossing(&mut report)?,
            other => {
                anyhow::bail!("BENCH_SPLATS knows vtk, points, paper and crossing, not {other}")
            }
        }
    }
    report.finish()
}

/// Settings of splats; the rest are the defaults of scenes.
fn splats(filter: Option<Filter>, blend: Blend, prefilter: bool) -> Settings {
    Settings {
        reconstruct: Reconstruct::Splats,
        filter,
        prefilter: Some(prefilter),
        blend: Some(blend),
        ..Settings::default()
    }
}

/// Blended and depth-tested in a single pass.
fn fuzzy(prefilter: bool) -> Settings {
    let prefilter = Some(prefilter);
    Settings { reconstruct: Reconstruct::Fuzzy, prefilter, ..Settings::default() }
}

/// A waved wall of disks before [`facing`]: one unit of its plane a pixel.
fn wall(side_px: u32, spacing_px: f64, radius_px: f64) -> anyhow::Result<PathBuf> {
    files::wall(&Wall { side: f64::from(side_px), spacing: spacing_px, radius: radius_px })
}

/// From where a unit of the wall is a pixel of a frame of `side_px`².
fn facing(side_px: u32) -> Orbit {
    let distance = f64::from(side_px);
    Orbit {
        eye: DVec3::new(0.371, 0.613, distance),
        target: DVec3::new(0.371, 0.613, 0.0),
        fov_deg: 2.0 * 0.5f64.atan().to_degrees(),
    }
}

/// VTK's discs and Gaussians and ours: of the same radius, of the same samples.
fn beside_vtk(report: &mut Report) -> anyhow::Result<()> {
    let side = pick(SIZE, 256);
    let orbit = facing(side);
    let ways = [
        ("three passes", splats(None, Blend::Weighted, false)),
        ("three passes, prefiltered", splats(None, Blend::Weighted, true)),
        ("one pass", splats(None, Blend::Opaque, false)),
        ("fuzzy", fuzzy(false)),
    ];
    let mut rows = Vec::new();
    for radius in RADII_PX {
        let file = wall(side, 1.0, radius)?;
        let ours = Drawing::open(&file, side, |_| ())?;
        let mut peers = Vec::new();
        for (name, mode, more) in PEERS {
            let radius = format!("--radius={radius}");
            let args: Vec<&str> = [mode, &radius].into_iter().chain(more.iter().copied()).collect();
            peers.push((name, Peer::vtk(&file, &orbit, side, &args)?, Vec::new()));
        }
        let (times, covered) = in_turns(&ours, side, &orbit, &ways, &mut peers)?;
        let mut peer_times = Vec::new();
        for (name, vtk, peer) in peers {
            let Some(vtk) = vtk else { continue };
            report.value(&format!("{name}, radius {radius} px"), vtk.finish()?);
            rows.push(vec![
                format!("{name}, radius {radius} px"),
                ours.info.samples.to_string(),
                number(median(&peer)),
                "—".to_owned(),
            ]);
            peer_times.push((name, peer));
        }
        report.value(&format!("covered_percent, radius {radius} px"), covered);
        for (times, (name, _)) in times.iter().zip(&ways) {
            report.value(&format!("{name}, radius {radius} px, ms"), median(times));
            rows.push(vec![
                format!("Pointillist, {name}, radius {radius} px"),
                ours.info.samples.to_string(),
                number(median(times)),
                number(covered),
            ]);
        }
        // Blended beside blended, opaque beside opaque.
        for (index, (name, _, _)) in PEERS.iter().enumerate() {
            let beside: &[(&str, usize)] = if index % 2 == 0 {
                &[("one pass", 2)]
            } else {
                &[("three passes", 0), ("fuzzy", 3)]
            };
            for &(what, ours) in beside {
                report.target(
                    &format!("splats of {radius} px radius at 1024², {what}, against {name}"),
                    peer_times.get(index).map(|(_, peer)| median_ratio(peer, &times[ours])),
                    Bound::AtLeast(20.0),
                    "×",
                );
            }
        }
    }
    report.table(
        "Splats and discs of the same samples, at the same poses",
        &["how", "samples", "ms a frame", "% covered"],
        &rows,
    );
    Ok(())
}

/// Draws samples as points, and as splats that close the surface.
fn beside_points(report: &mut Report) -> anyhow::Result<()> {
    const RADIUS_PX: f64 = 1.5;
    let side = pick(SIZE, 256);
    let ours = Drawing::open(&wall(side, 1.0, RADIUS_PX)?, side, |_| ())?;
    let orbit = facing(side);
    let mut ways = vec![("points".to_owned(), Settings::drawn_as(Reconstruct::Points))];
    for (blend_name, blend) in BLENDS {
        for (filter_name, filter) in FILTERS {
            let settings = splats(Some(filter), blend, true);
            ways.push((format!("splats, {filter_name}, {blend_name}"), settings));
        }
    }
    // The low-pass filter makes 1.5 px 1.8 px.
    let plain = ways.len();
    ways.push(("splats, unfiltered, 3 passes".to_owned(), splats(None, Blend::Weighted, false)));
    let single = ways.len();
    ways.push(("fuzzy, unfiltered".to_owned(), fuzzy(false)));
    ways.push(("fuzzy".to_owned(), fuzzy(true)));
    let defaults = Settings { reconstruct: Reconstruct::Splats, ..Settings::default() };
    ways.push(("splats, as they come".to_owned(), defaults));
    let mut times: Vec<Vec<f64>> = vec![Vec::new(); ways.len()];
    let mut covered = vec![0.0; ways.len()];
    let mut as_they_come = Vec::new();
    let (warm, frames) = pick((2, 9), (1, 2));
    for frame in 0..warm + frames {
        for (way, (_, settings)) in ways.iter().enumerate() {
            let receipt = ours.draw(orbit.at(degrees(frame)), [side, side], *settings)?;
            covered[way] = covered_percent(&receipt);
            if frame >= warm {
                times[way].push(gpu_ms(&receipt)?);
                if way + 1 == ways.len() {
                    as_they_come.push(receipt);
                }
            }
        }
    }
    let mut rows = Vec::new();
    for (way, (name, _)) in ways.iter().enumerate() {
        let (time, ratio) = (median(&times[way]), median_ratio(&times[way], &times[0]));
        report.value(&format!("{name}, {RADIUS_PX} px, ms"), time);
        rows.push(vec![name.clone(), number(time), number(ratio), number(covered[way])]);
    }
    let samples = ours.info.samples;
    report.table(
        &format!("{samples} samples of {RADIUS_PX} px radius"),
        &["how", "GPU ms", "times points", "% covered"],
        &rows,
    );
    let passes = pass_medians(&as_they_come);
    let rows: Vec<Vec<String>> =
        passes.iter().map(|(name, time)| vec![(*name).to_owned(), number(*time)]).collect();
    report.table("Passes of splats as they come", &["pass", "median ms"], &rows);
    for (what, times_of) in [
        ("", plain),
        (", widened by the low-pass filter", ways.len() - 1),
        (", in a single pass", single),
        (", in a single pass, widened by the low-pass filter", single + 1),
    ] {
        report.target(
            &format!("splats of 1.5 px radius{what}, that cover 1024², against the same samples as points"),
            times.get(times_of).map(|of| median_ratio(of, &times[0])),
            Bound::AtMost(6.0),
            "×",
        );
    }
    Ok(())
}

/// Million splats a second, as in the paper's Table 1.
fn beside_the_paper(report: &mut Report) -> anyhow::Result<()> {
    const SIZES: [[u32; 2]; 2] = [[512, 512], [1280, 1024]];
    let counts: &[u64] = pick(&[100_000, 200_000, 400_000, 650_000], &[20_000, 50_000]);
    // By filter, size and blend, a cloud's rate each.
    let mut rates: Vec<[[Vec<f64>; 2]; 2]> = vec![Default::default(); FILTERS.len()];
    for &count in counts {
        let parameters = Parameters { seed: 1, points: Some(count), ..Parameters::default() };
        let file = files::generated(&format!("statue-{count}.ply"), Kind::Statue, &parameters)?;
        let ours = Drawing::open(&file, SIZE, |_| ())?;
        let orbit = Orbit::around(&ours.info)?;
        for (filter, (_, by)) in FILTERS.iter().enumerate() {
            for (size, pixels) in SIZES.iter().enumerate() {
                for (blend, (_, passes)) in BLENDS.iter().enumerate() {
                    let settings = splats(Some(*by), *passes, true);
                    let (warm, frames) = pick((2, 5), (1, 2));
                    let mut times = Vec::new();
                    for frame in 0..warm + frames {
                        let camera = orbit.at(f64::from(frame) * STEP_DEG);
                        let receipt = ours.draw(camera, *pixels, settings)?;
                        if frame >= warm {
                            times.push(gpu_ms(&receipt)?);
                        }
                    }
                    rates[filter][size][blend].push(count as f64 / median(&times) / 1e3);
                }
            }
        }
    }
    let mut rows = Vec::new();
    for (filter, (name, _)) in FILTERS.iter().enumerate() {
        let mut row = vec![format!("Pointillist, {name}")];
        for (size, [width, height]) in SIZES.iter().enumerate() {
            for (blend, (passes, _)) in BLENDS.iter().enumerate() {
                let of = &rates[filter][size][blend];
                let mean = of.iter().sum::<f64>() / of.len() as f64;
                report.value(&format!("{name}, {width} × {height}, {passes}, M splats/s"), mean);
                row.push(number(mean));
            }
        }
        rows.push(row);
    }
    for (name, figures) in
        [("paper, Cg", [2.9, 1.4, 2.8, 1.2]), ("paper, assembler", [11.2, 3.1, 10.4, 2.8])]
    {
        rows.push(std::iter::once(name.to_owned()).chain(figures.map(number)).collect());
    }
    report.table(
        "Million splats a second, mean over statues of 100 to 650 thousand samples; paper: Zwicker et al. 2004, Table 1, on \
         a GeForce FX 5950 and a Pentium IV of 3 GHz, other objects of as many points",
        &["", "512 × 512, 1 pass", "3 passes", "1280 × 1024, 1 pass", "3 passes"],
        &rows,
    );
    Ok(())
}

/// Splats of one size that cover the frame, listed from several sizes on.
fn crossing(report: &mut Report) -> anyhow::Result<()> {
    const THRESHOLDS_PX: [u32; 5] = [8, 16, 32, 64, 128];
    const RADII_PX: [u32; 6] = [3, 6, 12, 24, 48, 96];
    let side = pick(SIZE, 256);
    let orbit = facing(side);
    let mut rows = Vec::new();
    // Side of a splat's box; time of those who list it over the time of those who do not.
    let mut ratios = Vec::new();
    for radius in RADII_PX {
        // Half a radius apart: a dozen over each pixel, whatever the size.
        let file = wall(side, 0.5 * f64::from(radius), f64::from(radius))?;
        let drawings = THRESHOLDS_PX
            .iter()
            .map(|&px| {
                Drawing::open(&file, side, |config| {
                    config.small_splat_px = Some(px);
                    config.large_units_limit = Some(u32::MAX);
                })
            })
            .collect::<anyhow::Result<Vec<_>>>()?;
        let mut times: Vec<Vec<f64>> = vec![Vec::new(); drawings.len()];
        let mut listed = vec![0.0; drawings.len()];
        let (warm, frames) = pick((2, 7), (1, 2));
        for frame in 0..warm + frames {
            for (way, drawing) in drawings.iter().enumerate() {
                let settings = splats(None, Blend::Weighted, true);
                let receipt = drawing.draw(orbit.at(degrees(frame)), [side, side], settings)?;
                let large = receipt.splats.rasterised.unwrap_or(0) as f64;
                let small = receipt.splats.scattered.unwrap_or(0) as f64;
                listed[way] = large / (large + small).max(1.0);
                if frame >= warm {
                    times[way].push(coverage_ms(&receipt)?);
                }
            }
        }
        let mut row = vec![(2 * radius).to_string(), drawings[0].info.samples.to_string()];
        for ((threshold, times), listed) in THRESHOLDS_PX.iter().zip(&times).zip(&listed) {
            let time = median(times);
            report.value(&format!("radius {radius} px, small_splat_px {threshold}, ms"), time);
            let way = if *listed > 0.5 { "walked" } else { "thread" };
            row.push(format!("{} {way}", number(time)));
        }
        rows.push(row);
        // The least threshold lists all of them but the smallest, the greatest all but the largest none.
        let (first, last) = (listed[0], listed[THRESHOLDS_PX.len() - 1]);
        if first > 0.99 && last < 0.01 {
            let ratio = median_ratio(&times[0], &times[THRESHOLDS_PX.len() - 1]);
            ratios.push((f64::from(2 * radius), ratio));
        }
    }
    report.table(
        "Equal splats that cover the frame: ms of visibility and sums by the longest side that a thread walks",
        &["side px", "splats", "8 px", "16 px", "32 px", "64 px", "128 px"],
        &rows,
    );
    let crossing = common::crossing_px(&ratios);
    match crossing {
        Some(side) => println!("a thread beats eight up to {} px on this machine", number(side)),
        None => {
            println!("no crossing among {ratios:?} (side in px, eight threads' time over one's)")
        }
    }
    println!(
        "small_splat_px is {} for CPUs, {} for GPUs",
        small_splat_px(true),
        small_splat_px(false)
    );
    report.value("crossing_walk_splats_px", crossing);
    report.value("small_splat_px", small_splat_px(true));
    report.value("small_splat_px_gpu", small_splat_px(false));
    Ok(())
}

/// Time of the passes that walk splats' boxes.
fn coverage_ms(receipt: &Receipt) -> anyhow::Result<f64> {
    let mut sum = 0;
    for name in [
        "project_splats",
        "walk_splats",
        "project_splats_id",
        "walk_splats_id",
        "blend_splats",
        "blend_walked",
    ] {
        sum += pass_ns(receipt, name)?;
    }
    Ok(ms(sum))
}
