//! Time at equal picture error: a coloured surface of random samples, drawn by VTK and Open3D in all their ways to draw points, and by us with
//! every setting that the planner chooses from.
//!
//! The truth is the solid itself, a mesh of many triangles, at four times the width and height. Programs average in linear light or as bytes, so
//! that both averages are made, and the one that is nearer to a frame counts. Nothing is lit, the background is black, and all three programs are
//! checked to draw a given colour alike. Errors are pooled over all poses. Our time is recording and all passes of a frame; VTK's is `Render()`
//! until the driver has drawn; Open3D's includes reading the image back, because it has no call without that.
//!
//! `BENCH_EQUAL="200000"` takes other numbers of samples.
//!
//! A hole is a black pixel although the truth shows the surface in all of that pixel and of its neighbours; a leak is the opposite.

mod common;

use std::path::{Path, PathBuf};

use anyhow::{Context, ensure};
use common::drawing::{Drawing, Orbit, gpu_ms};
use common::peer::Peer;
use common::report::{Bound, Report, number};
use common::solid::{self, Solid, Truth, covered, footprint, pixels_of_png};
use common::{files, folder, median, median_ratio, ms, pick};
use pointillist::accuracy::metrics;
use pointillist::accuracy::sweep::{pareto, rows};
use pointillist::accuracy::truth::{opaque, quads};
use pointillist::encode::ImageFormat;
use pointillist::generate::{Kind, Parameters};
use pointillist::plan::{Extent, PointSizePx, Settings};
use serde_json::{Value, json};

const SIZE: u32 = 768;
const SEED: u64 = 3;
const SAMPLES: [u64; 2] = [200_000, 1_000_000];
/// Turns of the camera about the solid.
const POSES_DEG: [f64; 3] = [0.0, 100.0, 220.0];
/// Frames of each way and pose, after one that may compile shaders.
const REPEATS: usize = 2;
/// A colour that all programs have to draw alike.
const FLAT: [u8; 3] = [200, 120, 60];

/// A way to draw, by one of the programs, with what was found of it.
struct Way {
    name: String,
    drawn_by: Program,
    /// Milliseconds by pose and repeat.
    times: Vec<f64>,
    /// Mean squared error of each pose.
    errors: Vec<f64>,
    faults: [u64; 2],
}

enum Program {
    Ours(Box<Settings>),
    Peer(&'static str, Peer),
}

impl Way {
    fn new(name: String, drawn_by: Program) -> Way {
        Way { name, drawn_by, times: Vec::new(), errors: Vec::new(), faults: [0; 2] }
    }

    fn program(&self) -> &'static str {
        match self.drawn_by {
            Program::Ours(_) => "Pointillist",
            Program::Peer(name, _) => name,
        }
    }

    fn mse(&self) -> f64 {
        self.errors.iter().sum::<f64>() / self.errors.len() as f64
    }

    /// Decibels, infinite for frames that equal the truth.
    fn decibels(&self) -> f64 {
        metrics::psnr_db(self.mse()).unwrap_or(f64::INFINITY)
    }

    /// Takes the error and the faults of a pose from its frame.
    fn see(&mut self, truth: &Truth, pixels: &[[u8; 4]]) -> anyhow::Result<()> {
        let linear = metrics::mse(&truth.color, pixels)?;
        self.errors.push(linear.min(metrics::mse(&truth.bytes, pixels)?));
        let found = truth.faults(&covered(pixels));
        self.faults.iter_mut().zip(found).for_each(|(sum, found)| *sum += found);
        Ok(())
    }
}

/// How VTK and Open3D draw points: single pixels and squares of some sizes, discs and Gaussians of some radii (in units of the kernels'
/// footprint), and those with the best hopes multisampled.
fn peers(file: &Path, orbit: &Orbit, side: u32) -> anyhow::Result<Vec<Way>> {
    let radius = footprint(file)?;
    let mut ways = Vec::new();
    let mut add = |name: String, program, args: &[String]| -> anyhow::Result<bool> {
        let args: Vec<&str> = args.iter().map(String::as_str).collect();
        let peer = match program {
            "VTK" => Peer::vtk(file, orbit, side, &args)?,
            _ => Peer::open3d(file, orbit, side, &args)?,
        };
        let is_there = peer.is_some();
        ways.extend(peer.map(|peer| Way::new(name, Program::Peer(program, peer))));
        Ok(is_there)
    };
    let samples = |count: u32| match count {
        0 => String::new(),
        _ => format!(", {count} multisamples"),
    };
    for (size, count) in pick(&[(1, 0), (2, 0), (3, 0), (4, 0), (2, 4), (3, 4)][..], &[(2, 0)]) {
        let args = [
            "--mode=points".into(),
            format!("--point-size={size}"),
            format!("--multisamples={count}"),
        ];
        if !add(format!("points of {size} px{}", samples(*count)), "VTK", &args)? {
            return Ok(ways);
        }
    }
    let discs =
        [(0.6, 0), (0.75, 0), (0.9, 0), (0.75, 4)].map(|(times, count)| ("splats", times, count));
    let gaussians =
        [(0.6, 0), (1.0, 0), (1.6, 0), (1.0, 4)].map(|(times, count)| ("gaussians", times, count));
    let all = [discs, gaussians].concat();
    for (mode, times, count) in &all[..pick(all.len(), 1)] {
        let kind = if *mode == "splats" { "discs" } else { "Gaussians" };
        let args = [
            format!("--mode={mode}"),
            format!("--radius={}", times * radius),
            format!("--multisamples={count}"),
        ];
        add(format!("{kind} of {times} footprints{}", samples(*count)), "VTK", &args)?;
    }
    for size in pick(&[2, 3, 4][..], &[2]) {
        let args = [format!("--point-size={size}")];
        if !add(format!("points of {size} px, 4 multisamples"), "Open3D", &args)? {
            break;
        }
    }
    Ok(ways)
}

/// A scene file of one asset that nothing lights, before black.
fn unlit(asset: &Path) -> anyhow::Result<PathBuf> {
    let name = asset.file_name().context("a file has a name")?.to_string_lossy();
    let description = json!({
        "assets": { "surface": { "file": name } },
        "nodes": [{ "asset": "surface" }],
        "lights": [],
        "background": "#000000",
    });
    files::scene(&format!("unlit-{name}.json"), &description)
}

/// Draws a wall of one colour with all programs and refuses to compare those that draw another colour.
fn check_colors(side: u32) -> anyhow::Result<()> {
    let file = files::once("flat.ply", |file| {
        const ACROSS: usize = 101;
        let mut out =
            format!("ply\nformat binary_little_endian 1.0\nelement vertex {}\n", ACROSS * ACROSS);
        for name in ["x", "y", "z", "nx", "ny", "nz"] {
            out += &format!("property float {name}\n");
        }
        out += "property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n";
        let mut out = out.into_bytes();
        for index in 0..ACROSS * ACROSS {
            let [x, y] = [index % ACROSS, index / ACROSS].map(|place| 0.02 * place as f32 - 1.0);
            let numbers = [x, y, 0.0, 0.0, 0.0, 1.0];
            out.extend(numbers.into_iter().flat_map(f32::to_le_bytes));
            out.extend(FLAT);
        }
        Ok(std::fs::write(file, out)?)
    })?;
    let ours = Drawing::open(&unlit(&file)?, side, |_| ())?;
    let orbit = Orbit::around(&ours.info)?;
    let point_size_px = PointSizePx::new(24.0).unwrap_or_default();
    let settings = Settings { point_size_px, ..Settings::default() };
    let frame = ours.image(orbit.at(0.0), [side; 2], settings, ImageFormat::Raw)?;
    let drawn: Vec<[u8; 4]> = quads(&frame.bytes).into_iter().map(opaque).collect();
    let middle = (side * side / 2 + side / 2) as usize;
    let mut found = vec![("Pointillist", drawn[middle])];
    let size = ["--point-size=24"];
    let peers = [
        ("VTK", Peer::vtk(&file, &orbit, side, &size)?),
        ("Open3D", Peer::open3d(&file, &orbit, side, &size)?),
    ];
    for (name, peer) in peers {
        let Some(mut peer) = peer else { continue };
        let picture = folder().join(format!("flat-{name}.png"));
        peer.frame_saved_ms(0.0, &picture)?;
        found.push((name, pixels_of_png(&picture)?[middle]));
    }
    for (name, [r, g, b, _]) in found {
        let is_alike = [r, g, b].iter().zip(FLAT).all(|(found, given)| found.abs_diff(given) <= 1);
        ensure!(
            is_alike,
            "{name} draws {FLAT:?} as {:?}: its pictures cannot be compared",
            [r, g, b]
        );
    }
    Ok(())
}

/// Draws all ways in turns, from all poses.
fn draw(ours: &Drawing, ways: &mut [Way], orbit: &Orbit, truths: &[Truth]) -> anyhow::Result<()> {
    let side = ours.size;
    for repeat in 0..=pick(REPEATS, 1) {
        println!("{} samples: round {repeat} of {} ways", ours.info.samples, ways.len());
        for (degrees, truth) in POSES_DEG.into_iter().zip(truths) {
            for way in ways.iter_mut() {
                let (time, pixels) = match &mut way.drawn_by {
                    Program::Ours(settings) => {
                        let camera = orbit.at(degrees);
                        let frame = ours.image(camera, [side; 2], **settings, ImageFormat::Raw)?;
                        let time = gpu_ms(&frame.receipt)? + ms(frame.receipt.record_ns);
                        let pixels = (repeat == 0)
                            .then(|| quads(&frame.bytes).into_iter().map(opaque).collect());
                        (time, pixels)
                    }
                    Program::Peer(name, peer) if repeat == 0 => {
                        let picture = folder().join(format!("equal-{name}.png"));
                        (peer.frame_saved_ms(degrees, &picture)?, Some(pixels_of_png(&picture)?))
                    }
                    Program::Peer(_, peer) => (peer.frame_ms(degrees)?, None),
                };
                if let Some(pixels) = pixels {
                    let pixels: Vec<[u8; 4]> = pixels;
                    way.see(truth, &pixels)?;
                } else {
                    way.times.push(time);
                }
            }
        }
    }
    Ok(())
}

fn main() -> anyhow::Result<()> {
    let side = pick(SIZE, 256);
    check_colors(side)?;
    let mut report: Option<Report> = None;
    let (mut equal, mut best, mut all) = (Vec::new(), Vec::new(), Vec::new());
    let given =
        std::env::var("BENCH_EQUAL").unwrap_or_else(|_| SAMPLES.map(|n| n.to_string()).join(" "));
    let sizes: Vec<u64> = given
        .split_whitespace()
        .map(str::parse)
        .collect::<Result<_, _>>()
        .context("BENCH_EQUAL")?;
    for samples in sizes {
        let count = pick(samples, samples / 100);
        let parameters = Parameters { seed: SEED, points: Some(count), ..Parameters::default() };
        let file =
            files::generated(&format!("statue-seed{SEED}-{count}.ply"), Kind::Statue, &parameters)?;
        let solid = Solid::open(&unlit(&solid::mesh(SEED)?)?, side)?;
        let ours = Drawing::open(&unlit(&file)?, side, |_| ())?;
        let orbit = Orbit::around(&ours.info)?;
        let truths: Vec<Truth> = POSES_DEG
            .iter()
            .map(|&degrees| solid.truth(orbit.at(degrees)))
            .collect::<anyhow::Result<_>>()?;
        drop(solid);
        let mut ways: Vec<Way> = Vec::new();
        let mut drawn = Vec::new();
        let extent = pick(Extent::Planned, Extent::Few);
        for row in rows(extent, true) {
            let settings = Settings::from(row.given).complete();
            ours.bake(settings)?;
            // Settings that the program draws as earlier ones are left out.
            let applied = ours.draw(orbit.at(0.0), [side; 2], settings)?.settings.applied;
            if drawn.contains(&applied) {
                continue;
            }
            drawn.push(applied);
            ways.push(Way::new(row.label, Program::Ours(Box::new(settings))));
        }
        ways.extend(peers(&file, &orbit, side)?);
        draw(&ours, &mut ways, &orbit, &truths)?;
        let report = report.get_or_insert_with(|| Report::new("equal", &ours.engine.adapter()));
        tell(report, count, &ways, [&mut equal, &mut best, &mut all]);
        for way in ways {
            if let Program::Peer(name, peer) = way.drawn_by {
                report.value(&format!("{name}, {}, {count} samples", way.name), peer.finish()?);
            }
        }
    }
    let mut report = report.context("no surfaces")?;
    report.value("poses", POSES_DEG.len());
    report.table(
        &format!("Time at equal picture error, {side}²: the Pareto front of each peer, and our fastest setting with at least its PSNR"),
        &["peer, how", "samples", "PSNR, dB", "holes", "ms", "ours", "PSNR, dB", "holes", "ms", "peer's time over ours"],
        &equal,
    );
    report.table(
        "The best picture of each program",
        &["program, how", "samples", "PSNR, dB", "holes", "leaks", "ms"],
        &best,
    );
    report.table(
        "Every way to draw",
        &["program, how", "samples", "PSNR, dB", "holes", "leaks", "ms"],
        &all,
    );
    report.finish()
}

/// Rows of the tables: times at equal error, the best of each program, and all ways.
fn tell(
    report: &mut Report,
    count: u64,
    ways: &[Way],
    [equal, best, all]: [&mut Vec<Vec<String>>; 3],
) {
    let described = |way: &Way| {
        vec![
            format!("{}, {}", way.program(), way.name),
            count.to_string(),
            format!("{:.2}", way.decibels()),
            way.faults[0].to_string(),
            way.faults[1].to_string(),
            number(median(&way.times)),
        ]
    };
    let mut values = Vec::new();
    for program in ["VTK", "Open3D", "Pointillist"] {
        let own: Vec<&Way> = ways.iter().filter(|way| way.program() == program).collect();
        let points: Vec<(f64, f64)> =
            own.iter().map(|way| (median(&way.times), way.mse())).collect();
        let front: Vec<&Way> = pareto(&points).into_iter().map(|index| own[index]).collect();
        best.extend(front.last().map(|way| described(way)));
        if program == "Pointillist" {
            continue;
        }
        // The smallest ratio of all ways of the peer. A way that none of our settings equals counts as 0.
        let mut least: Option<f64> = None;
        for peer in front {
            let enough = ways.iter().filter(|way| {
                matches!(way.drawn_by, Program::Ours(_)) && way.decibels() >= peer.decibels()
            });
            let fastest = enough.min_by(|a, b| median(&a.times).total_cmp(&median(&b.times)));
            let mut row = described(peer);
            row.remove(4);
            let ratio = fastest.map(|ours| median_ratio(&peer.times, &ours.times));
            row.extend(match fastest {
                None => {
                    vec!["no setting reaches this".to_owned(), "—".into(), "—".into(), "—".into()]
                }
                Some(ours) => vec![
                    ours.name.clone(),
                    format!("{:.2}", ours.decibels()),
                    ours.faults[0].to_string(),
                    number(median(&ours.times)),
                ],
            });
            row.push(ratio.map_or("—".to_owned(), number));
            least = Some(least.unwrap_or(f64::INFINITY).min(ratio.unwrap_or(0.0)));
            values.push(json!({
                "program": program,
                "how": peer.name,
                "psnr_db": peer.decibels(),
                "ms": median(&peer.times),
                "ours": fastest.map(|ours| ours.name.clone()),
                "ours_psnr_db": fastest.map(Way::decibels),
                "ours_ms": fastest.map(|ours| median(&ours.times)),
                "peer_over_ours": ratio,
            }));
            equal.push(row);
        }
        report.target(
            &format!("time of {program} at equal picture error over ours, worst way to draw {count} samples"),
            least,
            Bound::AtLeast(1.0),
            "times",
        );
    }
    all.extend(ways.iter().map(described));
    report.value(&format!("{count} samples"), Value::Array(values));
}
