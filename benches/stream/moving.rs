//! Moving frames that the planner chooses, beside those that are paced by time alone: how often they come, and how exact they are as they are shown.
//!
//! One daemon has measured the scenes, another has not. A camera circles around each scene with the wall clock; the next pose is sent when a frame is there. Frames are not compressed,
//! enlarged to the size that was asked for as a browser does it, and compared with full detail at 16 samples a pixel.

use std::ffi::OsStr;
use std::path::Path;
use std::time::{Duration, Instant};

use anyhow::{Context, bail, ensure};
use glam::DVec3;
use pointillist::accuracy::enlarge::bilinear;
use pointillist::accuracy::metrics;
use pointillist::accuracy::truth::{opaque, quads};
use serde_json::{Value, json};

use super::common::daemon::Daemon;
use super::common::drawing::Orbit;
use super::common::report::{Report, number};
use super::common::stream::Stream;
use super::common::{self, median, pick, quantile};
use super::{SIZE, eye_and_target};

const SCENES: [&str; 3] = ["town", "relief", "glasshouse"];
/// Requests of the streams, beside size and format.
const ASKED: [&str; 2] = ["", "&lod=spt"];
const DEGREES_PER_SECOND: f64 = 6.0;
/// Frames of a stream that are compared.
const COMPARED: usize = 12;
/// Time of a frame at which moving frames aim, in milliseconds.
const TARGET_MS: f64 = 33.0;

/// A frame of a moving pose: where it was seen from, its header and its pixels.
struct Seen {
    degrees: f64,
    header: Value,
    image: Vec<u8>,
}

pub fn compare(report: &mut Report) -> anyhow::Result<()> {
    let mut table = Vec::new();
    for scene in SCENES.into_iter().take(pick(SCENES.len(), 1)) {
        let file = format!("{scene}.json");
        let folder = common::folder().join("moving-cache");
        let kept = [
            ("POINTILLIST_NO_CACHE", OsStr::new("false")),
            ("POINTILLIST_CACHE", folder.as_os_str()),
        ];
        let args = ["--no-uploads"];
        let start = |kept: &[_]| Daemon::start_with(Path::new("scenes"), &[&file], &args, kept);
        let daemons = [start(&kept)?, start(&[])?];
        measure(&daemons[0], scene)?;
        let orbit = around(&daemons[0], scene)?;
        for asked in ASKED {
            // Trees are built before anything is timed.
            for daemon in &daemons {
                turn(daemon, scene, asked, &orbit, pick(4.0, 0.2))?;
            }
            // Which daemon goes first alternates.
            let mut found: [Vec<Vec<String>>; 2] = Default::default();
            for round in 0..pick(2, 1) {
                for at in [round % 2, 1 - round % 2] {
                    let (waits, seen) = turn(&daemons[at], scene, asked, &orbit, pick(12.0, 0.2))?;
                    found[at].push(row(&daemons[0], scene, &orbit, &waits, &seen)?);
                }
            }
            for (rows, name) in found.into_iter().zip(["planned", "paced"]) {
                let asked = if asked.is_empty() { "defaults" } else { &asked[1..] };
                table.extend(rows.into_iter().map(|row| {
                    [vec![scene.to_owned(), asked.to_owned(), name.to_owned()], row].concat()
                }));
            }
        }
    }
    report.table(
        "Moving frames at 640×480, planned from measurements and paced by time alone",
        &[
            "scene",
            "asked",
            "chosen by",
            "frames",
            "ms, median",
            "ms, 95 %",
            "in 33 ms, %",
            "PSNR as shown, mean",
            "worst",
            "most often",
        ],
        &table,
    );
    Ok(())
}

/// Has a scene measured for the planner, unless it was in an earlier run.
fn measure(daemon: &Daemon, scene: &str) -> anyhow::Result<()> {
    let mut connection = daemon.connect()?;
    let place = format!("/v1/scenes/{scene}/accuracy");
    let known: Value = serde_json::from_slice(&connection.get(&place, "")?.body)?;
    if !known["planner"].is_null() {
        return Ok(());
    }
    let [width, height] = pick([320, 180], [64, 36]);
    let wanted = json!({ "planner": true, "w": width, "h": height });
    let begun = connection.post(&place, &wanted)?;
    ensure!(begun.status == 202, "the measurement was answered with {}", begun.status);
    loop {
        std::thread::sleep(Duration::from_secs(1));
        let found: Value = serde_json::from_slice(&connection.get(&place, "")?.body)?;
        match found["state"].as_str() {
            Some("running") => {}
            _ if !found["planner"].is_null() => return Ok(()),
            _ => bail!("{found}"),
        }
    }
}

/// A circle through the eye of the default view.
fn around(daemon: &Daemon, scene: &str) -> anyhow::Result<Orbit> {
    let path = format!("/v1/scenes/{scene}/frame?w={}&h={}&format=raw", SIZE[0], SIZE[1]);
    let camera = &daemon.connect()?.get(&path, "")?.receipt()?["camera"];
    let place = |name: &str| -> anyhow::Result<DVec3> {
        let found: [f64; 3] = serde_json::from_value(camera[name].clone())?;
        Ok(found.into())
    };
    let fov_deg = camera["fov_deg"].as_f64().context("a view without perspective")?;
    Ok(Orbit { eye: place("eye")?, target: place("target")?, fov_deg })
}

/// Draws moving frames for some seconds. Returns how long each pose waited for its frame, in ms, and the frames.
fn turn(
    daemon: &Daemon,
    scene: &str,
    asked: &str,
    orbit: &Orbit,
    seconds: f64,
) -> anyhow::Result<(Vec<f64>, Vec<Seen>)> {
    let size = format!("w={}&h={}", SIZE[0], SIZE[1]);
    let path = format!("/v1/scenes/{scene}/stream?{size}&format=raw{asked}");
    let mut stream = Stream::open(daemon.address, &path)?;
    let (mut waits, mut seen) = (Vec::new(), Vec::new());
    let began = Instant::now();
    while began.elapsed().as_secs_f64() < seconds {
        let sent = Instant::now();
        let degrees = DEGREES_PER_SECOND * began.elapsed().as_secs_f64();
        let [eye, target] = eye_and_target(orbit, degrees);
        let seq = stream.next_seq();
        let pose = json!({ "seq": seq, "eye": eye, "target": target, "fov": orbit.fov_deg, "moving": true });
        stream.send(&pose)?;
        let (header, image) = stream.image_of(seq)?;
        stream.acknowledge(&header)?;
        // The first third lets the pace settle.
        if 3.0 * began.elapsed().as_secs_f64() >= seconds {
            waits.push(1e3 * sent.elapsed().as_secs_f64());
            seen.push(Seen { degrees, header, image });
        }
    }
    Ok((waits, seen))
}

fn row(
    daemon: &Daemon,
    scene: &str,
    orbit: &Orbit,
    waits: &[f64],
    seen: &[Seen],
) -> anyhow::Result<Vec<String>> {
    let mut connection = daemon.connect()?;
    let mut decibels = Vec::new();
    for Seen { degrees, header, image } in seen.iter().step_by(seen.len().div_ceil(COMPARED)) {
        let [eye, target] =
            eye_and_target(orbit, *degrees).map(|v| v.map(|n| n.to_string()).join(","));
        let path = format!(
            "/v1/scenes/{scene}/frame?eye={eye}&target={target}&fov={}&w={}&h={}&format=raw&antialias=16x",
            orbit.fov_deg, SIZE[0], SIZE[1]
        );
        let answer = connection.get(&path, "")?;
        ensure!(answer.status == 200, "a reference was answered with {}", answer.status);
        let side = |name: &str| header[name].as_u64().map(|side| side as u32).context("no size");
        let pixels = |bytes: &[u8]| quads(bytes).into_iter().map(opaque).collect::<Vec<[u8; 4]>>();
        let shown = bilinear(pixels(image), [side("width")?, side("height")?], SIZE);
        let error = metrics::mse(&pixels(&answer.body), &shown)?;
        decibels.push(metrics::psnr_db(error).unwrap_or(99.0));
    }
    let in_time = waits.iter().filter(|ms| **ms <= TARGET_MS).count();
    let mean = decibels.iter().sum::<f64>() / decibels.len() as f64;
    Ok(vec![
        waits.len().to_string(),
        number(median(waits)),
        number(quantile(waits, 0.95)),
        number(100.0 * in_time as f64 / waits.len() as f64),
        number(mean),
        number(decibels.iter().copied().fold(f64::INFINITY, f64::min)),
        most_often(seen),
    ])
}

/// The setting, or the scale and the accepted error, that most frames have.
fn most_often(seen: &[Seen]) -> String {
    let name = |one: &Seen| {
        let planned = &one.header["receipt"]["planned"]["chosen"]["setting"];
        let scale = one.header["scale"].as_f64().unwrap_or(1.0);
        match (planned.as_str(), one.header["max_error_px"].as_f64()) {
            (Some(setting), _) => setting.to_owned(),
            (None, Some(px)) => format!("spt {px:.1} px size={scale:.2}"),
            (None, None) => format!("full size={scale:.2}"),
        }
    };
    let names: Vec<String> = seen.iter().map(name).collect();
    let count = |name: &String| names.iter().filter(|other| *other == name).count();
    names.iter().max_by_key(|name| count(name)).cloned().unwrap_or_default()
}
