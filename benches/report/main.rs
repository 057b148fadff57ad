//! The report of `make report`: what accuracy costs in three scenes, the peers at equal picture error, the tables of the four papers, the
//! promises, and the effects beside the reference renderer, from what `scripts/report.sh` has measured into `target/report/`, or into the folder of
//! `REPORT_FOLDER`.
//!
//! Writes `report.md`, `report.json` and one self-contained `index.html` beside the measurements.

#[path = "../common/mod.rs"]
mod common;
mod page;
mod papers;

use std::path::{Path, PathBuf};

use anyhow::Context;
use common::report::{Bound, judged, number, shown, verdict};
use page::{Block, Section, html, markdown};
use serde_json::{Map, Value, json};

const TITLE: &str = "Pointillist: what accuracy costs, beside peers and papers";
/// Benches whose promises are printed.
const PROMISING: [&str; 5] = ["promises", "planner", "audit", "equal", "effects"];

/// A bench's JSON.
pub struct Bench(Value);

impl Bench {
    /// A figure by its name.
    pub fn value(&self, name: &str) -> Option<f64> {
        self.0["values"][name].as_f64()
    }
}

/// Everything that was measured.
pub struct Found {
    folder: PathBuf,
    benches: Map<String, Value>,
    costs: Value,
    stability: Value,
    checkerboard: Value,
    /// Name, seconds and state of each part.
    parts: Vec<Vec<String>>,
    /// Minutes that the one command took, with building; `None` where an earlier run has measured some of the parts.
    minutes: Option<f64>,
}

impl Found {
    fn read(folder: &Path) -> anyhow::Result<Found> {
        let json = |name: &str| -> anyhow::Result<Value> {
            let file = folder.join(name);
            if !file.exists() {
                return Ok(Value::Null);
            }
            let bytes = std::fs::read(&file).with_context(|| file.display().to_string())?;
            serde_json::from_slice(&bytes).with_context(|| file.display().to_string())
        };
        let mut benches = Map::new();
        let kept = folder.join("benches");
        for entry in std::fs::read_dir(&kept).with_context(|| kept.display().to_string())? {
            let file = entry?.path();
            let name = file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            let found = json(&format!("benches/{name}.json"))?;
            benches.insert(name, found);
        }
        let minutes = std::fs::read_to_string(folder.join("minutes")).ok();
        let parts = std::fs::read_to_string(folder.join("parts.tsv")).context("parts.tsv")?;
        Ok(Found {
            folder: folder.to_owned(),
            benches,
            costs: json("cost.json")?,
            stability: json("stability/stability.json")?,
            checkerboard: json("checkerboard/accuracy.json")?,
            parts: parts
                .lines()
                .map(|line| line.split('\t').map(str::to_owned).collect())
                .collect(),
            minutes: minutes.and_then(|text| text.trim().parse().ok()),
        })
    }

    pub fn bench(&self, name: &str) -> Option<Bench> {
        self.benches.get(name).cloned().map(Bench)
    }
}

fn main() -> anyhow::Result<()> {
    let folder = std::env::var_os("REPORT_FOLDER").map_or("target/report".into(), PathBuf::from);
    let found = Found::read(&folder)?;
    let sections = [
        headline(&found)?,
        promises(&found),
        peers(&found),
        papers::dachsbacher(&found),
        papers::zwicker(&found),
        papers::marroquim(&found),
        papers::coconu(&found),
        effects(&found),
        circumstances(&found),
    ];
    let all = json!({
        "title": TITLE,
        "quick": is_quick(&found),
        "sections": sections.iter().map(Section::json).collect::<Vec<_>>(),
        "costs": found.costs,
        "stability": found.stability,
        "benches": found.benches,
    });
    for (name, text) in [
        ("report.md", markdown(TITLE, &sections)),
        ("report.json", serde_json::to_string_pretty(&all)? + "\n"),
        ("index.html", html(TITLE, &sections)),
    ] {
        let file = folder.join(name);
        std::fs::write(&file, text).with_context(|| file.display().to_string())?;
        println!("wrote {}", file.display());
    }
    // The first table of promises; others have details.
    if let Some(Block::Table(_, _, rows)) =
        sections[1].blocks.iter().find(|block| matches!(block, Block::Table(..)))
    {
        rows.iter().for_each(|row| println!("{}", row.join(" · ")));
    }
    Ok(())
}

/// Whether a bench was a smoke check.
fn is_quick(found: &Found) -> bool {
    found.benches.values().any(|bench| bench["quick"] == true)
}

fn headline(found: &Found) -> anyhow::Result<Section> {
    let mut section = Section::new("What does one more decibel cost?");
    let plot = found.folder.join("headline.svg");
    if is_quick(found) {
        section.text("A smoke check: its figures mean nothing.");
    }
    if !plot.exists() {
        section.text("The scenes have not been measured.");
        return Ok(section);
    }
    section.text(found.costs["summary"].as_str().unwrap_or_default());
    section.blocks.push(Block::Plot(std::fs::read_to_string(plot)?, "headline.svg"));
    let curves: Vec<&Value> = found.costs["curves"].as_array().into_iter().flatten().collect();
    let mut columns = vec!["at least".to_owned()];
    for curve in &curves {
        let scene = curve["scene"].as_str().unwrap_or_default();
        columns.extend([format!("{scene}: setting"), "GPU, ms".to_owned(), "×".to_owned()]);
    }
    let mut rows = Vec::new();
    for level in found.costs["levels"].as_array().into_iter().flatten() {
        let mut row =
            vec![format!("{} dB", number(level["least_db"].as_f64().unwrap_or(f64::NAN)))];
        for reached in level["scenes"].as_array().into_iter().flatten() {
            let shown = |key: &str| reached[key].as_f64().map_or("—".to_owned(), number);
            let setting = reached["label"].as_str().unwrap_or("not reached").to_owned();
            row.extend([setting, shown("gpu_ms"), shown("times")]);
        }
        rows.push(row);
    }
    let columns: Vec<&str> = columns.iter().map(String::as_str).collect();
    section.table(
        "The fastest setting with at least so many decibels; × is its time over that of the row above",
        &columns,
        rows,
    );
    for curve in &curves {
        let text = |key: &str| curve[key].as_str().unwrap_or_default();
        section.text(format!(
            "{}: pose {}, {} × {}, median of {} frames. PSNR is against {}.",
            text("scene"),
            text("poses"),
            curve["width"],
            curve["height"],
            curve["repeats"],
            text("reference"),
        ));
    }
    for curve in curves {
        let scene = curve["scene"].as_str().unwrap_or_default();
        let name = scene.trim_end_matches(".json");
        section.blocks.push(Block::Link(
            format!("{name}/index.html"),
            format!("{scene}: every setting, with its frame and its difference from the reference"),
        ));
    }
    Ok(section)
}

/// A line of the table of promises.
fn promise(beginning: &str, target: &Value) -> Vec<String> {
    let text = |key: &str| target[key].as_str().unwrap_or_default();
    vec![
        format!("{beginning}{}", text("what")),
        format!("{} {}", shown(target), text("unit")),
        format!("{} {}", text("target"), text("unit")),
        verdict(target["met"].as_bool()).to_owned(),
    ]
}

/// The figures of `accuracy --stability`: splats of hard cases, and random views of hard scenes.
fn stability(found: &Found) -> Vec<Value> {
    let list = |value: &Value| value.as_array().cloned().unwrap_or_default();
    let (classes, scenes) = (list(&found.stability["rows"]), list(&found.stability["scenes"]));
    let holding = classes.iter().filter(|class| class["holds"] == true).count() as f64;
    let (all, each) = (classes.len(), found.stability["count"].as_u64().unwrap_or_default());
    let sum = |key: &str| scenes.iter().filter_map(|scene| scene[key].as_f64()).sum::<f64>();
    let views = sum("views");
    let settings = scenes.iter().filter_map(|scene| scene["settings"].as_u64()).max().unwrap_or(0);
    let refused: u64 = scenes
        .iter()
        .flat_map(|scene| scene["refused"].as_object().into_iter().flatten())
        .filter_map(|(_, count)| count.as_u64())
        .sum();
    let of_views = |what: &str, key: &str| {
        let what = format!(
            "{what}, of {} views of {} scenes with up to {settings} settings each, {refused} refused",
            number(views),
            scenes.len()
        );
        judged(&what, (views > 0.0).then(|| sum(key)), Bound::AtMost(0.0), "views")
    };
    vec![
        judged(
            &format!(
                "classes of {each} hard splats in which all that can be judged keep their error bounds, of {all}"
            ),
            (all > 0).then_some(holding),
            Bound::AtLeast(all as f64),
            "classes",
        ),
        of_views("random views with a NaN or an infinite value in depths or normals", "not_finite"),
        of_views("random views that change more than a small step explains", "unsteady"),
    ]
}

fn promises(found: &Found) -> Section {
    let mut section = Section::new("Promises");
    let mut rows: Vec<Vec<String>> =
        stability(found).iter().map(|target| promise("stability: ", target)).collect();
    for name in PROMISING {
        let Some(bench) = found.bench(name) else {
            section.text(format!("The bench {name} has no results."));
            continue;
        };
        for target in bench.0["targets"].as_array().into_iter().flatten() {
            let beginning = if name == "promises" { String::new() } else { format!("{name}: ") };
            rows.push(promise(&beginning, target));
        }
    }
    let took =
        judged("time of the one command, with building", found.minutes, Bound::AtMost(40.0), "min");
    rows.push(promise("report: ", &took));
    let count = |word: &str| rows.iter().filter(|row| row[3] == word).count();
    section.text(format!(
        "Promises: {} met, {} not met, {} not measured.",
        count(verdict(Some(true))),
        count(verdict(Some(false))),
        count(verdict(None)),
    ));
    rows.sort_by_key(|row| row[3] != verdict(Some(false)));
    section.table(
        "What frames promise, and what was found; what is not met comes first",
        &["promise", "found", "bound", ""],
        rows,
    );
    section.text(
        "Random views of the hard scenes are few here. A million of them takes hours: `pointillist accuracy --stability --scenes scenes/hard/*.json --views 72000`.",
    );
    section.text(
        "Why some promises are not met: docs/level-of-detail.md (flicker, nodes, slowest frames), docs/planner.md (the planner's time), docs/effects.md (shadows and \
         ambient occlusion), docs/large-images.md (tiles).",
    );
    // The others have sections of their own.
    for name in ["promises", "planner", "audit"] {
        if let Some(bench) = found.bench(name) {
            section.tables_of(&bench.0, "");
        }
    }
    section
}

fn peers(found: &Found) -> Section {
    let mut section = Section::new("Peers at equal picture error");
    let Some(bench) = found.bench("equal") else {
        section.text("The bench equal has no results.");
        return section;
    };
    section.text(
        "A coloured, unlit surface of random samples from three poses. The truth is the solid itself, a mesh of two million triangles at 16 times the \
         pixels, averaged in linear light and as bytes; the average that is nearer to a frame counts. Flat colours come out equal in all programs, which \
         is checked before. Every row is on the Pareto front of its program: it has no faster way to draw that is as exact. Our time is recording and all \
         passes; VTK's is Render() until the driver has drawn; Open3D's includes reading the image back.",
    );
    let names = bench.0["values"].as_object().into_iter().flatten().map(|(name, _)| name.clone());
    let names: Vec<String> = names.collect();
    for peer in ["VTK", "Open3D"] {
        if !names.iter().any(|name| name.starts_with(&format!("{peer}, "))) {
            section.text(format!("{peer} could not draw here, and has no rows."));
        }
    }
    section.tables_of(&bench.0, "");
    section
}

/// Every effect beside the reference renderer: the sheets, and the figures of each row.
fn effects(found: &Found) -> Section {
    let mut section = Section::new("Effects beside the reference renderer");
    let Some(Bench(bench)) = found.bench("effects") else {
        section.text("The bench effects has no results.");
        return section;
    };
    section.text("Each row of a sheet is an effect: off, on, the reference renderer's frame with it, and eight times the difference of the last two.");
    for number in 1.. {
        let Some(shown) = bench["values"][format!("sheet {number}")].as_str() else { break };
        let file = format!("effects-{number}.png");
        let path = found.folder.join(&file);
        let Ok(png) = std::fs::read(&path) else {
            section.text(format!("The sheet {file} is missing."));
            continue;
        };
        let text = format!("From the top: {shown}");
        section.text(text.clone());
        section.blocks.push(Block::Picture(png, file, text));
    }
    section.tables_of(&bench, "");
    section
}

fn circumstances(found: &Found) -> Section {
    let mut section = Section::new("How it was measured");
    let mut rows = Vec::new();
    for (name, bench) in &found.benches {
        let machine = &bench["machine"];
        let text = |value: &Value| match value {
            Value::String(text) => text.clone(),
            Value::Null => "—".to_owned(),
            other => other.to_string(),
        };
        rows.push(vec![
            name.clone(),
            text(&bench["adapter"]),
            text(&machine["cpu"]),
            text(&machine["cores"]),
            text(&machine["commit"]),
            text(&machine["changed_since_commit"]),
            text(&machine["load_average_1_min"]),
        ]);
    }
    section.table(
        "Machine; a load of more than the number of cores means that other programs ran besides",
        &["bench", "adapter", "CPU", "cores", "commit", "changed since", "load when it ended"],
        rows,
    );
    section.table("Parts of the report", &["part", "seconds", "state"], found.parts.clone());
    section
}
