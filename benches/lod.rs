//! Level of detail by sequential point trees: how time grows with copies, instances, samples, distance and accuracy, what building
//! the trees costs, and what of them is processed in vain.
//!
//! Beside them stand L. Coconu, H.-C. Hege, "Hardware-Accelerated Point-Based Rendering of Complex Scenes", Eurographics Workshop on
//! Rendering 2002, Table 4 (grids of copies), and C. Dachsbacher, C. Vogelgsang, M. Stamminger, "Sequential Point Trees", SIGGRAPH
//! 2003 (10 to 40 % of the points processed are not drawn; Fig. 1, a model at growing distance).

mod common;

use std::path::PathBuf;
use std::time::Instant;

use anyhow::Context;
use common::drawing::{Drawing, Orbit};
use common::files::{self, Wall};
use common::report::{Bound, Report, number};
use common::shots::{Shot, Taken, take, take_images};
use common::{median, median_ratio, memory_mib, pick};
use glam::DVec3;
use pointillist::accuracy::metrics::psnr;
use pointillist::assets::{PointCloud, Progress};
use pointillist::bake::estimate_kernels;
use pointillist::bake::tree::{TreeStatistics, build_tree};
use pointillist::encode::ImageFormat;
use pointillist::engine::EncodedFrame;
use pointillist::generate::{Generated, Kind, Parameters, generate};
use pointillist::plan::{Lod, MaxError, Reconstruct, Settings};

/// The size of Coconu's and Hege's frames.
const SMALL: [u32; 2] = [500, 400];
const HOWS: [(&str, Reconstruct); 2] =
    [("points", Reconstruct::Points), ("splats", Reconstruct::Splats)];

fn main() -> anyhow::Result<()> {
    let probe = files::wall(&Wall { side: 64.0, spacing: 8.0, radius: 8.0 })?;
    let mut report = Report::new("lod", &Drawing::open(&probe, 64, |_| ())?.engine.adapter());
    let parts = std::env::var("BENCH_LOD")
        .unwrap_or_else(|_| "copies million bake cpu errors distance".into());
    for part in parts.split_whitespace() {
        match part {
            "copies" => copies(&mut report)?,
            "million" => million(&mut report)?,
            "bake" => bake(&mut report)?,
            "cpu" => cpu(&mut report)?,
            "errors" => errors(&mut report)?,
            "distance" => distance(&mut report)?,
            other => anyhow::bail!(
                "BENCH_LOD knows copies, million, bake, cpu, errors and distance, not {other}"
            ),
        }
    }
    report.finish()
}

/// Frames that do not count, and frames that do.
fn repeats() -> (u32, u32) {
    pick((2, 7), (1, 2))
}

fn spt(reconstruct: Reconstruct, max_error: MaxError) -> Settings {
    Settings { lod: Lod::Spt, max_error_px: max_error, reconstruct, ..Settings::default() }
}

fn statue(points: u64) -> anyhow::Result<PathBuf> {
    let parameters = Parameters { seed: 1, points: Some(points), ..Parameters::default() };
    files::generated(&format!("statue-{points}.ply"), Kind::Statue, &parameters)
}

/// Scenes in one engine, which builds the tree of an asset that they share once.
fn open_all(files: &[PathBuf]) -> anyhow::Result<Vec<Drawing>> {
    let (first, others) = files.split_first().context("no scenes")?;
    let first = Drawing::open(first, SMALL[0], |_| ())?;
    let others =
        others.iter().map(|file| first.beside(file)).collect::<anyhow::Result<Vec<_>>>()?;
    Ok(std::iter::once(first).chain(others).collect())
}

/// From where fields of copies are seen; turned about its target no eye comes among them.
fn poses(drawing: &Drawing) -> anyhow::Result<[(&'static str, Orbit); 3]> {
    let fitted = Orbit::fitted(drawing, SMALL, spt(Reconstruct::Points, MaxError::default()))?;
    let [low, high] = drawing.info.bounds.context("an empty scene")?.map(DVec3::from);
    let (extent, centre) = (high - low, 0.5 * (low + high));
    let corner = low + DVec3::new(-0.5, 1.6, -0.5);
    let above = centre + DVec3::new(0.0, 1.4, 0.1) * extent.max_element();
    Ok([
        ("fitted", fitted),
        ("corner", Orbit { eye: corner, target: centre, fov_deg: 60.0 }),
        ("above", Orbit { eye: above, target: centre, fov_deg: 40.0 }),
    ])
}

/// Fields of copies of one mesh, as in Table 4 of Coconu and Hege.
fn copies(report: &mut Report) -> anyhow::Result<()> {
    let sides: [u32; 4] = pick([1, 10, 50, 200], [1, 3, 6, 12]);
    let (base, most) = (1, sides.len() - 1);
    let files = sides.map(files::copies).into_iter().collect::<anyhow::Result<Vec<_>>>()?;
    let drawings = open_all(&files)?;
    for drawing in &drawings {
        drawing.bake(spt(Reconstruct::Points, MaxError::default()))?;
    }
    let seen = drawings.iter().map(poses).collect::<anyhow::Result<Vec<_>>>()?;
    for (how, reconstruct) in HOWS {
        let settings = spt(reconstruct, MaxError::default());
        let (mut rows, mut ratios, mut slowest) = (Vec::new(), Vec::new(), f64::INFINITY);
        for (pose, (pose_name, _)) in seen[0].iter().enumerate() {
            let shots: Vec<Shot> = drawings
                .iter()
                .zip(&seen)
                .map(|(drawing, seen)| Shot { drawing, orbit: seen[pose].1, size: SMALL, settings })
                .collect();
            let taken = take(&shots, repeats())?;
            for (side, taken) in sides.iter().zip(&taken) {
                let name = format!("{side} × {side}, {how}, {pose_name}");
                let (time, share) = (median(&taken.gpu_ms()?), taken.rejected_percent());
                report.value(&format!("{name}, GPU ms"), time);
                report.value(&format!("{name}, tested but not drawn, %"), share);
                rows.push(vec![
                    format!("{side} × {side}, {pose_name}"),
                    number(time),
                    number(taken.tested()),
                    number(taken.accepted()),
                    number(share),
                    number(taken.triangles()),
                    number(taken.instances_drawn()),
                    number(taken.frames_per_second()),
                ]);
            }
            ratios.push((pose_name, median_ratio(&taken[most].gpu_ms()?, &taken[base].gpu_ms()?)));
            slowest = slowest.min(taken[most].frames_per_second());
        }
        report.table(
            &format!("Copies of a mesh, {how}, 500 × 400"),
            &[
                "copies, pose",
                "GPU ms",
                "tested",
                "accepted",
                "% not drawn",
                "triangles",
                "instances",
                "frames/s",
            ],
            &rows,
        );
        let [from, to] = [sides[base], sides[most]];
        for (pose, ratio) in ratios {
            report.target(
                &format!(
                    "{to} × {to} copies as {how}, {pose}, against {from} × {from} (paper: 5.6)"
                ),
                Some(ratio),
                Bound::AtMost(3.0),
                "×",
            );
        }
        report.target(
            &format!("{to} × {to} copies as {how}, slowest pose"),
            Some(slowest),
            Bound::AtLeast(5.0),
            "frames/s",
        );
    }
    Ok(())
}

/// A million instances of ten models.
fn million(report: &mut Report) -> anyhow::Result<()> {
    let side = pick(1000, 100);
    let file = files::crowd(side)?;
    // From here on the peak is this scene's, where the system can forget an earlier one.
    let _ = std::fs::write("/proc/self/clear_refs", "5");
    let began = Instant::now();
    let drawing = Drawing::open(&file, SMALL[0], |_| ())?;
    let load_s = began.elapsed().as_secs_f64();
    let began = Instant::now();
    drawing.bake(spt(Reconstruct::Points, MaxError::default()))?;
    let bake_s = began.elapsed().as_secs_f64();
    let seen = poses(&drawing)?;
    let count = drawing.info.instances;
    let (mut rows, mut gpu_bytes) = (Vec::new(), 0.0);
    for (how, reconstruct) in HOWS {
        for size in [SMALL, [1024, 768]] {
            let [width, height] = size;
            let settings = spt(reconstruct, MaxError::default());
            let shots = seen.map(|(_, orbit)| Shot { drawing: &drawing, orbit, size, settings });
            let taken = take(&shots, repeats())?;
            let mut slowest: f64 = 0.0;
            for ((pose, _), taken) in seen.iter().zip(&taken) {
                let time = median(&taken.gpu_ms()?);
                slowest = slowest.max(time);
                gpu_bytes = taken.gpu_bytes();
                let name = format!("{how}, {width} × {height}, {pose}");
                report.value(&format!("{count} instances, {name}, GPU ms"), time);
                rows.push(vec![
                    name,
                    number(time),
                    number(taken.record_ms()),
                    number(taken.tested()),
                    number(taken.accepted()),
                    number(taken.rejected_percent()),
                    number(taken.instances_drawn()),
                ]);
            }
            if reconstruct == Reconstruct::Points {
                report.target(
                    &format!("{count} instances of ten models as points, {width} × {height}, slowest pose"),
                    Some(slowest),
                    Bound::Below(150.0),
                    "ms",
                );
            }
        }
    }
    report.table(
        &format!("{count} instances of ten models"),
        &["how", "GPU ms", "record ms", "tested", "accepted", "% not drawn", "instances"],
        &rows,
    );
    let peak = memory_mib("self", "VmHWM");
    report.value("million, load s", load_s);
    report.value("million, trees s", bake_s);
    report.value("million, peak host MiB", peak);
    report.value("million, GPU MiB", gpu_bytes / 1_048_576.0);
    println!(
        "read in {} s, trees built in {} s, at most {} MiB of host memory (a software adapter's is in it), \
         {} MiB on the GPU",
        number(load_s),
        number(bake_s),
        peak.map_or("—".to_owned(), number),
        number(gpu_bytes / 1_048_576.0)
    );
    Ok(())
}

/// A statue's samples as trees are built of them.
fn samples(points: u64) -> anyhow::Result<PointCloud> {
    let parameters = Parameters { seed: 1, points: Some(points), ..Parameters::default() };
    match generate(Kind::Statue, &parameters, &Progress::new(|_| ()))? {
        Generated::Points(mut cloud) => {
            cloud.oriented = true;
            estimate_kernels(&mut cloud);
            Ok(cloud)
        }
        _ => anyhow::bail!("a statue is points"),
    }
}

/// How fast trees are built, and how large they are.
fn bake(report: &mut Report) -> anyhow::Result<()> {
    let cloud = samples(pick(1_000_000, 50_000))?;
    let count = cloud.positions.len() as f64;
    let mut rows = Vec::new();
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
        let (mut best_s, mut statistics) = (f64::INFINITY, None);
        for _ in 0..3 {
            let began = Instant::now();
            let tree = pool.install(|| build_tree(&cloud, None))?;
            best_s = best_s.min(began.elapsed().as_secs_f64());
            statistics = Some(TreeStatistics::of(&tree));
        }
        let statistics = statistics.context("a tree was built")?;
        let nodes = (statistics.leaves + statistics.inner) as f64;
        let (rate, bytes) = (count / best_s / 1e6, statistics.bytes as f64 / nodes);
        rows.push(vec![
            threads.to_string(),
            number(count),
            number(best_s),
            number(rate),
            number(rate / threads as f64),
            number(nodes / count),
            number(bytes),
        ]);
        report.value(&format!("trees on {threads} threads, M samples/s"), rate);
        report.target(
            &format!("trees of {} samples, threads: {threads}", number(count)),
            Some(rate / threads as f64),
            Bound::AtLeast(1.0),
            "M samples/s a core",
        );
        if threads == 1 {
            report.target("bytes a node", Some(bytes), Bound::AtMost(28.0), "B");
        }
    }
    report.table(
        "Building trees, best of 3",
        &["threads", "samples", "s", "M samples/s", "a core", "nodes a sample", "bytes a node"],
        &rows,
    );
    Ok(())
}

/// The render thread's time a frame, which neither instances nor samples ought to change.
fn cpu(report: &mut Report) -> anyhow::Result<()> {
    let sides: [u32; 3] = pick([1, 10, 200], [1, 3, 12]);
    let clouds: [u64; 3] = pick([100_000, 1_000_000, 5_000_000], [5_000, 20_000, 50_000]);
    let files = sides.map(files::copies).into_iter().chain(clouds.map(statue));
    let drawings = open_all(&files.collect::<anyhow::Result<Vec<_>>>()?)?;
    let settings = spt(Reconstruct::Points, MaxError::default());
    let shots = drawings
        .iter()
        .map(|drawing| {
            let orbit = Orbit::fitted(drawing, SMALL, settings)?;
            Ok(Shot { drawing, orbit, size: SMALL, settings })
        })
        .collect::<anyhow::Result<Vec<_>>>()?;
    let taken = take(&shots, pick((3, 21), (1, 2)))?;
    let instances = sides.map(|side| format!("instances: {}", side * side));
    let samples = clouds.map(|points| format!("samples: {points}"));
    let mut rows = Vec::new();
    for (names, taken) in [(instances, &taken[..3]), (samples, &taken[3..])] {
        for (name, shot) in names.into_iter().zip(taken) {
            let (time, ratio) = (shot.record_ms(), shot.record_ms() / taken[0].record_ms());
            report.value(&format!("{name}, record ms"), time);
            report.value(&format!("{name}, record against the smallest"), ratio);
            rows.push(vec![name, number(time), number(ratio)]);
        }
    }
    report.table(
        "CPU time of the render thread a frame, points, 500 × 400",
        &["scene", "ms", "times the smallest"],
        &rows,
    );
    Ok(())
}

fn pixels(frame: &EncodedFrame) -> &[[u8; 4]] {
    frame.bytes.as_chunks().0
}

/// The cost of accuracy, and the error, beside full detail.
fn errors(report: &mut Report) -> anyhow::Result<()> {
    const ERRORS_PX: [f32; 6] = [0.25, 0.5, 1.0, 2.0, 4.0, 8.0];
    let side = pick(1024, 256);
    let drawing = Drawing::open(&statue(pick(1_000_000, 50_000))?, side, |_| ())?;
    let orbit = Orbit::around(&drawing.info)?;
    for (how, reconstruct) in HOWS {
        let full = Settings { reconstruct, ..Settings::default() };
        let trees = ERRORS_PX.iter().filter_map(|&px| Some(spt(reconstruct, MaxError::new(px)?)));
        let shots: Vec<Shot> = std::iter::once(full)
            .chain(trees)
            .map(|settings| Shot { drawing: &drawing, orbit, size: [side, side], settings })
            .collect();
        let mut decibels: Vec<Vec<f64>> = vec![Vec::new(); shots.len()];
        let taken = take_images(&shots, ImageFormat::Raw, repeats(), |frames| {
            for (decibels, frame) in decibels.iter_mut().zip(frames) {
                decibels.push(psnr(pixels(&frames[0]), pixels(frame))?);
            }
            Ok(())
        })?;
        let mut rows = Vec::new();
        let full_ms = taken[0].gpu_ms()?;
        for ((shot, taken), decibels) in shots.iter().zip(&taken).zip(&decibels) {
            let (times, decibels) = (taken.gpu_ms()?, median(decibels));
            let name = match shot.settings.lod {
                Lod::Full => "full detail".to_owned(),
                Lod::Spt => format!("{} px", shot.settings.max_error_px.px()),
            };
            report.value(&format!("{name}, {how}, GPU ms"), median(&times));
            report.value(&format!("{name}, {how}, PSNR dB"), decibels);
            rows.push(vec![
                name,
                number(median(&times)),
                number(median_ratio(&full_ms, &times)),
                number(taken.tested()),
                number(taken.accepted()),
                if decibels.is_infinite() { "equal".to_owned() } else { number(decibels) },
            ]);
        }
        report.table(
            &format!("{} samples as {how}, {side}², by the accepted error", drawing.info.samples),
            &["accepted error", "GPU ms", "times faster", "tested", "accepted", "PSNR dB"],
            &rows,
        );
    }
    Ok(())
}

/// A model that moves away, as in Fig. 1 of Dachsbacher et al.
fn distance(report: &mut Report) -> anyhow::Result<()> {
    let side = pick(1024, 256);
    let drawing = Drawing::open(&statue(pick(1_000_000, 50_000))?, side, |_| ())?;
    let near = Orbit::around(&drawing.info)?;
    let factors: Vec<f64> = (0..7).map(|octave| f64::from(1 << octave)).collect();
    for (how, reconstruct) in HOWS {
        let settings = spt(reconstruct, MaxError::default());
        let shots: Vec<Shot> = factors
            .iter()
            .map(|factor| {
                let orbit = Orbit { eye: near.target + (near.eye - near.target) * *factor, ..near };
                Shot { drawing: &drawing, orbit, size: [side, side], settings }
            })
            .collect();
        let taken: Vec<Taken> = take(&shots, repeats())?;
        let mut rows = Vec::new();
        for (factor, taken) in factors.iter().zip(&taken) {
            let (time, share) = (median(&taken.gpu_ms()?), taken.rejected_percent());
            report.value(&format!("distance × {factor}, {how}, GPU ms"), time);
            report.value(&format!("distance × {factor}, {how}, tested but not drawn, %"), share);
            report.value(&format!("distance × {factor}, {how}, tested"), taken.tested());
            report.value(&format!("distance × {factor}, {how}, accepted"), taken.accepted());
            let record = 100.0 * taken.record_ms() / time;
            report.value(&format!("distance × {factor}, {how}, CPU over GPU time, %"), record);
            rows.push(vec![
                format!("× {factor}"),
                number(taken.tested()),
                number(taken.accepted()),
                number(share),
                number(time),
            ]);
        }
        report.table(
            &format!("{} samples as {how}, {side}², by distance", drawing.info.samples),
            &["distance", "tested", "accepted", "% not drawn", "GPU ms"],
            &rows,
        );
    }
    Ok(())
}
