//! Lines: tubes beside VTK's tube filter, and loading of streamlines beside nibabel.

mod common;

use std::fs::File;
use std::io::{BufReader, BufWriter, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use anyhow::{Context, ensure};
use common::drawing::{Drawing, Orbit, STEP_DEG, gpu_ms, pass_medians};
use common::peer::{PYTHON, Peer, is_installed};
use common::report::{Bound, Report, number};
use common::{files, median, median_ratio, memory_mib, ms, pick};
use pointillist::assets::{Geometry, ReadOptions, read};
use pointillist::engine::Receipt;
use pointillist::generate::{Kind, Parameters};
use pointillist::plan::Settings;
use serde_json::{Value, json};

const SIZE: u32 = 2048;
/// Distances of the camera in units of the whole view's, from near to far.
const DISTANCES: [f64; 5] = [0.25, 0.5, 1.0, 2.0, 4.0];
/// Streamlines that have 3.2 million segments, and the radius of their tubes, in a block of 150 units.
const STREAMLINES: u64 = 34_500;
const RADIUS: f64 = 0.075;
/// Bytes of scenes on the GPU while loading: a million streamlines are more than what an engine takes by itself.
const LOADED_BYTES: u64 = 16 << 30;
/// The argument with which this program loads a file in a process of its own.
const LOAD: &str = "--load";

/// VTK's ways: as few sides as it makes by itself, and tubes that look round.
const PEERS: [(&str, &[&str]); 2] = [
    ("VTK, 3 sides", &["--sides=3"]),
    ("VTK, 8 sides, 8 multisamples", &["--sides=8", "--multisamples=8"]),
];

fn main() -> anyhow::Result<()> {
    let mut arguments = std::env::args().skip_while(|argument| argument != LOAD).skip(1);
    if let (Some(how), Some(file)) = (arguments.next(), arguments.next()) {
        println!("{}", loaded(&how, Path::new(&file))?);
        return Ok(());
    }
    let probe = Drawing::open(Path::new("scenes/relief.json"), 16, |_| ())?;
    let mut report = Report::new("lines", &probe.engine.adapter());
    drop(probe);
    let parts = std::env::var("BENCH_LINES").unwrap_or_else(|_| "tubes loading".into());
    for part in parts.split_whitespace() {
        match part {
            "tubes" => tubes(&mut report)?,
            "loading" => loading(&mut report)?,
            other => anyhow::bail!("BENCH_LINES knows tubes and loading, not {other}"),
        }
    }
    report.finish()
}

/// A number of streamlines that the environment may set, for machines on which all of them take too long.
fn number_from(variable: &str, usual: u64) -> anyhow::Result<u64> {
    match std::env::var(variable) {
        Ok(text) => text.parse().with_context(|| format!("{variable}={text}: not a whole number")),
        Err(_) => Ok(usual),
    }
}

fn tracts(count: u64, extension: &str) -> anyhow::Result<PathBuf> {
    let parameters = Parameters { seed: 1, count: Some(count), ..Parameters::default() };
    files::generated(&format!("tracts-{count}.{extension}"), Kind::Tracts, &parameters)
}

/// Tubes from close to far, frames in turns with VTK's.
fn tubes(report: &mut Report) -> anyhow::Result<()> {
    let side = pick(SIZE, 256);
    let count = number_from("BENCH_TUBES", pick(STREAMLINES, STREAMLINES / 100))?;
    let file = tracts(count, "vtk")?;
    let name = file.file_name().context("a file has a name")?.to_string_lossy();
    let scene = files::scene(
        &format!("tracts-{count}.json"),
        &json!({
            "assets": { "tracts": { "file": name, "line_radius": RADIUS } },
            "nodes": [{ "asset": "tracts" }],
        }),
    )?;
    let ours = Drawing::open(&scene, side, |_| ())?;
    let orbit = Orbit::around(&ours.info)?;
    let segments = ours.info.segments;
    let mut rows: Vec<Vec<String>> = Vec::new();
    let mut ratios: Vec<Vec<Option<f64>>> = Vec::new();
    // VTK's meshes are large: one after the other, each in turns with our frames.
    for (index, (peer, more)) in PEERS.into_iter().enumerate() {
        let radius = format!("--radius={RADIUS}");
        let args: Vec<&str> = ["--mode=tubes", "--warmup=0", &radius]
            .into_iter()
            .chain(more.iter().copied())
            .collect();
        let mut vtk = Peer::vtk(&file, &orbit, side, &args)?;
        let mut of_peer = Vec::new();
        for (place, distance) in DISTANCES.into_iter().enumerate() {
            let (receipts, peer_ms) = take_turns(&ours, &orbit, distance, vtk.as_mut())?;
            let times = receipts.iter().map(gpu_ms).collect::<Result<Vec<f64>, _>>()?;
            let ratio = vtk.is_some().then(|| median_ratio(&peer_ms, &times));
            of_peer.push(ratio);
            if index == 0 {
                let drawn: Vec<f64> = receipts.iter().map(|of| ms(of.total_ns)).collect();
                let time = median(&times);
                rows.push(vec![
                    number(distance),
                    number(RADIUS * focal_px(&orbit, side) / reach(&orbit, distance)),
                    number(time),
                    number(1e3 / time),
                    number(median(&drawn)),
                ]);
                report.value(&format!("distance {distance}, fps"), 1e3 / time);
                let passes: Vec<String> = pass_medians(&receipts)
                    .into_iter()
                    .filter(|(_, time)| *time >= 0.05 * median(&times))
                    .map(|(name, time)| format!("{name} {}", number(time)))
                    .collect();
                println!("distance {distance}: {} ms; {}", number(time), passes.join(", "));
            }
            let shown = |value: Option<f64>| value.map_or("—".to_owned(), number);
            let peer_fps = vtk.is_some().then(|| 1e3 / median(&peer_ms));
            rows[place].extend([shown(peer_fps), shown(ratio)]);
        }
        if let Some(vtk) = vtk {
            let (load_ms, first_ms) = (vtk.load_ms, vtk.first_ms);
            report.value(&format!("{peer}, reading and making tubes, ms"), load_ms);
            report.value(&format!("{peer}, first frame, ms"), first_ms);
            report.value(peer, vtk.finish()?);
        }
        ratios.push(of_peer);
    }
    report.value("segments", segments);
    report.table(
        &format!(
            "{segments} segments as tubes at {side}²; distances in units of the whole view's; the radius is that at the middle"
        ),
        &[
            "distance",
            "radius, px",
            "GPU ms",
            "frames/s",
            "to a JPEG, ms",
            "VTK, 3 sides, frames/s",
            "times",
            "VTK, 8 sides, frames/s",
            "times",
        ],
        &rows,
    );
    for ((peer, _), ratios) in PEERS.iter().zip(&ratios) {
        for (distance, ratio) in DISTANCES.iter().zip(ratios) {
            let what = format!("{segments} segments as tubes, distance {distance}, against {peer}");
            report.target(&what, *ratio, Bound::AtLeast(10.0), "×");
        }
    }
    Ok(())
}

fn reach(orbit: &Orbit, distance: f64) -> f64 {
    distance * (orbit.eye - orbit.target).length()
}

fn focal_px(orbit: &Orbit, side: u32) -> f64 {
    0.5 * f64::from(side) / (0.5 * orbit.fov_deg).to_radians().tan()
}

/// Frames of ours and milliseconds of VTK's from a distance, in turns.
fn take_turns(
    ours: &Drawing,
    orbit: &Orbit,
    distance: f64,
    mut vtk: Option<&mut Peer>,
) -> anyhow::Result<(Vec<Receipt>, Vec<f64>)> {
    let (warm, frames) = pick((1, 3), (1, 2));
    let (mut receipts, mut peer_ms) = (Vec::new(), Vec::new());
    let eye = orbit.target + distance * (orbit.eye - orbit.target);
    let near = Orbit { eye, ..*orbit };
    for frame in 0..warm + frames {
        let degrees = f64::from(frame) * STEP_DEG;
        let receipt = ours.draw(near.at(degrees), [ours.size; 2], Settings::default())?;
        if frame < warm {
            continue;
        }
        receipts.push(receipt);
        if let Some(vtk) = &mut vtk {
            peer_ms.push(vtk.frame_from_ms(degrees, distance)?);
        }
    }
    Ok((receipts, peer_ms))
}

/// Streamlines of TCK and TRK from the file to what is drawn, beside nibabel's arrays.
fn loading(report: &mut Report) -> anyhow::Result<()> {
    let count = number_from("BENCH_STREAMLINES", pick(1_000_000, 10_000))?;
    let tck = tracts(count, "tck")?;
    let trk = files::once(&format!("tracts-{count}.trk"), |file| trk_of(&tck, count, file))?;
    let has_nibabel = is_installed("nibabel", "nibabel");
    let mut rows = Vec::new();
    for (format, file) in [("TCK", &tck), ("TRK", &trk)] {
        let (mut arrays, mut scene, mut nibabel) = (Vec::new(), Vec::new(), Vec::new());
        for _ in 0..pick(3, 1) {
            let this = std::env::current_exe()?;
            arrays.push(told(Command::new(&this).args([LOAD, "arrays"]).arg(file))?);
            scene.push(told(Command::new(&this).args([LOAD, "scene"]).arg(file))?);
            if has_nibabel {
                let script = "benches/peers/nibabel_load.py";
                nibabel.push(told(Command::new(PYTHON).arg(script).arg(file))?);
            }
        }
        let of = |runs: &[Value], key: &str| -> Vec<f64> {
            runs.iter().filter_map(|run| run[key].as_f64()).collect()
        };
        let packed = median(&of(&scene, "gpu_mib"));
        let size = std::fs::metadata(file)?.len() as f64 / 1_048_576.0;
        for (how, runs) in
            [("read into arrays", &arrays), ("read and packed", &scene), ("nibabel", &nibabel)]
        {
            if runs.is_empty() {
                continue;
            }
            let peak = median(&of(runs, "peak_mib"));
            rows.push(vec![
                format!("{format}, {how}"),
                number(median(&of(runs, "seconds"))),
                number(peak),
                number(peak / packed),
                number(size),
                number(packed),
            ]);
            report.value(&format!("{format}, {how}"), runs.clone());
        }
        for (how, runs) in [("read into arrays", &arrays), ("read and packed", &scene)] {
            let ratio =
                has_nibabel.then(|| median_ratio(&of(&nibabel, "seconds"), &of(runs, "seconds")));
            let what = format!("{count} streamlines of {format}, {how}, against nibabel's arrays");
            report.target(&what, ratio, Bound::AtLeast(10.0), "×");
        }
        let peak = median(&of(&scene, "peak_mib")) / packed;
        let what = format!("{count} streamlines of {format}, peak memory over the packed size");
        report.target(&what, Some(peak), Bound::AtMost(2.0), "×");
    }
    report.table(
        &format!(
            "Loading {count} streamlines; peaks are those of the process, less what it held before"
        ),
        &["how", "seconds", "peak MiB", "of the packed size", "file MiB", "packed MiB"],
        &rows,
    );
    Ok(())
}

/// The JSON that a process prints in its last line.
fn told(command: &mut Command) -> anyhow::Result<Value> {
    let output = command.output().with_context(|| format!("{command:?}"))?;
    ensure!(output.status.success(), "{command:?}: {}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8_lossy(&output.stdout);
    let line = text.lines().last().with_context(|| format!("{command:?} printed nothing"))?;
    serde_json::from_str(line).with_context(|| format!("{command:?} printed {line}"))
}

/// Loads a file, in a process that does nothing else: as arrays, or as a scene that is ready to be drawn.
fn loaded(how: &str, file: &Path) -> anyhow::Result<Value> {
    let packed = how == "scene";
    // The engine and its device are there before.
    let small = packed.then(|| tracts(10, "tck")).transpose()?;
    let engine = small.map(|small| {
        Drawing::open(&small, 16, |config| config.gpu_budget_bytes = Some(LOADED_BYTES))
    });
    let engine = engine.transpose()?;
    // From here on the peak counts anew.
    std::fs::write("/proc/self/clear_refs", "5").context("/proc/self/clear_refs")?;
    let before = memory_mib("self", "VmRSS").context("no VmRSS")?;
    let began = Instant::now();
    let (segments, gpu_bytes) = match engine {
        Some(engine) => {
            let info = engine.beside(file)?.info;
            (info.segments, Some(info.gpu_bytes))
        }
        None => {
            let asset = read(file, &ReadOptions::default())?;
            let strands = asset.geometries.iter().map(|geometry| match geometry {
                Geometry::Lines(lines) => lines.positions.len() + 1 - lines.strands.len(),
                _ => 0,
            });
            (strands.sum::<usize>() as u64, None)
        }
    };
    let seconds = began.elapsed().as_secs_f64();
    let peak = memory_mib("self", "VmHWM").context("no VmHWM")?;
    Ok(json!({
        "seconds": seconds,
        "peak_mib": peak - before,
        "segments": segments,
        "gpu_mib": gpu_bytes.map(|bytes| bytes as f64 / 1_048_576.0),
    }))
}

/// Writes the streamlines of a TCK file as the generator leaves it as a TRK file of version 2.
fn trk_of(tck: &Path, count: u64, trk: &Path) -> anyhow::Result<()> {
    let mut input = BufReader::new(File::open(tck)?);
    input.seek(SeekFrom::Start(offset_of(tck)?))?;
    let mut out = BufWriter::new(File::create(trk)?);
    out.write_all(&trk_header(i32::try_from(count)?))?;
    let mut points: Vec<u8> = Vec::new();
    let mut triple = [0u8; 12];
    loop {
        input.read_exact(&mut triple)?;
        let first = f32::from_le_bytes([triple[0], triple[1], triple[2], triple[3]]);
        if first.is_infinite() {
            return Ok(out.flush()?);
        }
        if first.is_nan() {
            out.write_all(&i32::try_from(points.len() / triple.len())?.to_le_bytes())?;
            out.write_all(&points)?;
            points.clear();
        } else {
            points.extend(triple);
        }
    }
}

/// Where the coordinates of a TCK file begin.
fn offset_of(tck: &Path) -> anyhow::Result<u64> {
    let mut head = Vec::new();
    File::open(tck)?.take(1024).read_to_end(&mut head)?;
    let head = String::from_utf8_lossy(&head);
    let line = head.lines().find_map(|line| line.strip_prefix("file: . "));
    Ok(line.context("a TCK file without `file`")?.trim().parse()?)
}

/// A header without scalars and properties, of voxels of one millimetre whose axes are the scanner's.
fn trk_header(count: i32) -> [u8; 1000] {
    let mut header = [0u8; 1000];
    let mut put = |offset: usize, bytes: &[u8]| {
        header[offset..offset + bytes.len()].copy_from_slice(bytes);
    };
    put(0, b"TRACK\0");
    for axis in 0..3 {
        put(6 + 2 * axis, &256i16.to_le_bytes());
        put(12 + 4 * axis, &1f32.to_le_bytes());
    }
    for diagonal in 0..4 {
        put(440 + 20 * diagonal, &1f32.to_le_bytes());
    }
    put(948, b"RAS\0");
    put(988, &count.to_le_bytes());
    put(992, &2i32.to_le_bytes());
    put(996, &1000i32.to_le_bytes());
    header
}
