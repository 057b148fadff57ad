//! Closed surfaces of random samples: our splats, `fuzzy` and `pull_push` beside VTK's Gaussians of equal footprint.
//!
//! The truth is the solid itself: a mesh of many triangles, drawn at four times the width and height and averaged in linear light. A
//! hole is a pixel without a surface although the truth has one in all of that pixel and of its neighbours. VTK lights surfaces in
//! another way than the truth, so that its colours are not compared.

mod common;

use std::path::{Path, PathBuf};

use anyhow::Context;
use common::drawing::{Drawing, Orbit};
use common::gaussians::{PEERS, TimedPeer, in_turns};
use common::peer::Peer;
use common::report::{Bound, Report, number};
use common::solid::{self, Solid, footprint, pixels_of_png};
use common::{files, folder, median, median_ratio, pick};
use pointillist::accuracy::metrics;
use pointillist::generate::{Kind, Parameters};
use pointillist::plan::{Lod, Output, Reconstruct, Settings};

const SIZE: u32 = 1024;
const SEED: u64 = 3;

/// How many samples, and how much faster than VTK three passes, a single pass and pull-push should be.
struct Closed {
    samples: u64,
    splats: f64,
    fuzzy: f64,
    pull_push: f64,
}

const CLOSED: [Closed; 2] = [
    Closed { samples: 200_000, splats: 6.0, fuzzy: 10.0, pull_push: 12.0 },
    Closed { samples: 1_000_000, splats: 9.0, fuzzy: 16.0, pull_push: 20.0 },
];

/// Ways to draw, those with a target first.
fn ways() -> [(&'static str, Settings); 6] {
    let splats = Settings::drawn_as(Reconstruct::Splats);
    [
        ("splats, three passes", splats),
        ("fuzzy", Settings::drawn_as(Reconstruct::Fuzzy)),
        ("pull_push", Settings::drawn_as(Reconstruct::PullPush)),
        ("painted", Settings::drawn_as(Reconstruct::Painted)),
        ("splats, three passes, lod=spt", Settings { lod: Lod::Spt, ..splats }),
        ("points", Settings::drawn_as(Reconstruct::Points)),
    ]
}

fn main() -> anyhow::Result<()> {
    let mut report: Option<Report> = None;
    let mut rows = Vec::new();
    for closed in CLOSED {
        let count = pick(closed.samples, closed.samples / 100);
        let parameters = Parameters { seed: SEED, points: Some(count), ..Parameters::default() };
        let file =
            files::generated(&format!("statue-seed{SEED}-{count}.ply"), Kind::Statue, &parameters)?;
        let ours = Drawing::open(&file, pick(SIZE, 256), |_| ())?;
        let report = report.get_or_insert_with(|| Report::new("closed", &ours.engine.adapter()));
        compare(report, &mut rows, &closed, &file, &ours)?;
    }
    let mut report = report.context("no surfaces")?;
    report.table(
        &format!("A closed surface of random samples at {0}²", pick(SIZE, 256)),
        &[
            "how",
            "samples",
            "ms a frame",
            "VTK at its fastest",
            "VTK as it sets itself up",
            "holes",
            "leaks",
            "PSNR",
        ],
        &rows,
    );
    report.finish()
}

fn compare(
    report: &mut Report,
    rows: &mut Vec<Vec<String>>,
    closed: &Closed,
    file: &Path,
    ours: &Drawing,
) -> anyhow::Result<()> {
    let (side, count) = (ours.size, ours.info.samples);
    let ways = ways();
    for (_, settings) in ways {
        ours.bake(settings)?;
    }
    let orbit = Orbit::around(&ours.info)?;
    let truth = Solid::open(&solid::mesh(SEED)?, side)?.truth(orbit.at(0.0))?;
    let radius = format!("--radius={}", footprint(file)?);
    let mut peers: Vec<TimedPeer> = Vec::new();
    let mut pictures: Vec<PathBuf> = Vec::new();
    for (index, (name, mode, more)) in [PEERS[1], PEERS[3]].into_iter().enumerate() {
        let picture = folder().join(format!("closed-vtk-{index}-{count}.png"));
        let png = format!("--png={}", picture.display());
        let args: Vec<&str> =
            [mode, &radius, &png].into_iter().chain(more.iter().copied()).collect();
        peers.push((name, Peer::vtk(file, &orbit, side, &args)?, Vec::new()));
        pictures.push(picture);
    }
    let (times, covered) = in_turns(ours, side, &orbit, &ways, &mut peers)?;
    report.value(&format!("covered_percent, {count} samples"), covered);
    let mut timed = Vec::new();
    for ((name, vtk, peer), picture) in peers.into_iter().zip(pictures) {
        let Some(vtk) = vtk else {
            timed.push((name, None, None));
            continue;
        };
        report.value(&format!("{name}, {count} samples"), vtk.finish()?);
        timed.push((
            name,
            Some(peer),
            Some(truth.faults(&solid::covered(&pixels_of_png(&picture)?))),
        ));
    }
    let against = |peer: &Option<Vec<f64>>, times: &[f64]| {
        peer.as_ref().map(|peer| median_ratio(peer, times))
    };
    let mut row = |how: &str, times: &[f64], faults: [u64; 2], psnr: Option<f64>| {
        let shown = |ratio: Option<f64>| ratio.map_or("—".to_owned(), number);
        let mut cells = vec![how.to_owned(), count.to_string(), number(median(times))];
        cells.extend(timed.iter().map(|(_, peer, _)| shown(against(peer, times))));
        cells.extend(faults.map(|fault| fault.to_string()));
        cells.push(shown(psnr));
        rows.push(cells);
    };
    let mut holes = Vec::new();
    for (times, (how, settings)) in times.iter().zip(ways) {
        let of = |output| ours.raw(orbit.at(0.0), [side; 2], settings, output);
        let color: Vec<[u8; 4]> = bytemuck::pod_collect_to_vec(&of(Output::Color)?.bytes);
        let depth: Vec<f32> = bytemuck::pod_collect_to_vec(&of(Output::Depth)?.bytes);
        let faults = truth.faults(&metrics::covered_by_depth(&depth));
        let psnr = metrics::psnr(&truth.color, &color)?;
        row(how, times, faults, Some(psnr));
        report.value(&format!("{how}, {count} samples, holes"), faults[0]);
        report.value(&format!("{how}, {count} samples, PSNR"), psnr);
        holes.push(faults[0] as f64);
    }
    for (name, peer, faults) in &timed {
        if let (Some(peer), Some(faults)) = (peer, faults) {
            row(name, peer, *faults, None);
        }
    }
    let bounds = [closed.splats, closed.fuzzy, closed.pull_push];
    for (index, bound) in bounds.into_iter().enumerate() {
        let how = ways[index].0;
        for (name, peer, _) in &timed {
            let what = format!("{count} samples of a closed surface, {how}, against {name}");
            report.target(&what, against(peer, &times[index]), Bound::AtLeast(bound), "×");
        }
        let what = format!("{count} samples of a closed surface, {how}, holes");
        report.target(&what, Some(holes[index]), Bound::AtMost(0.0), "pixels");
    }
    let detailed = ways.iter().position(|(_, settings)| settings.lod == Lod::Spt);
    let of_full = detailed.map(|index| median_ratio(&times[index], &times[0]));
    let what = format!("{count} samples of a closed surface, lod=spt over full detail");
    report.target(&what, of_full, Bound::AtMost(1.05), "×");
    Ok(())
}
