//! `pointillist accuracy`: reports what accuracy costs in time, and whether bounds on errors hold.

use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Instant, SystemTime};

use anyhow::{Context, Result, bail};
use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};

use super::cache::CacheArgs;
use super::frame::size;
use super::local::{ID, LimitArgs, SceneArgs, SceneFile, progress_bar};
use super::out::{self, say};
use super::path::{LINE_EVERY, bake, shots, stop_when_told};
use crate::accuracy::cost::{Costs, Curve};
use crate::accuracy::journal::{Identity, Journal};
use crate::accuracy::planning::{self, Planning};
use crate::accuracy::reference::Reference;
use crate::accuracy::results::Results;
use crate::accuracy::stability::{Stability, stability};
use crate::accuracy::steady::{self, Steadiness, Sweep};
use crate::accuracy::survey::{AlongPath, Event, MOST_FRAMES, Purpose, Survey, SurveyError};
use crate::accuracy::{date, report, sweep};
use crate::assets::ReadOptions;
use crate::engine::{Client, Engine, Pose, SceneInfo};
use crate::film::shots::Shots;
use crate::plan::Extent;
use crate::scene::SceneLimits;

/// Options of `pointillist accuracy`.
#[derive(Args, Clone, Debug)]
pub struct AccuracyArgs {
    /// Scene file (.json), or one file of points, lines or triangles, whose settings are compared
    #[arg(
        value_name = "SCENE_OR_ASSET",
        required_unless_present_any = ["stability", "combine"],
        conflicts_with_all = ["stability", "combine"]
    )]
    scene: Option<PathBuf>,
    /// Compare the splat shaders on this adapter with exact results for hard cases; fails if an error bound is exceeded
    #[arg(long)]
    stability: bool,
    /// Measure the scene for the planner, which chooses settings for --budget-ms and --min-psnr-db; the measurements are kept beside the point
    /// trees once all are made
    #[arg(long, conflicts_with_all = ["stability", "out", "camera", "path", "repeats", "quick", "oracle", "seed", "json"])]
    planner: bool,
    /// Say what one more decibel costs in several scenes: one plot and one table of the reports in these folders
    #[arg(
        long,
        value_name = "REPORT",
        num_args = 1..,
        requires = "out",
        conflicts_with_all = ["stability", "planner", "camera", "path", "size", "repeats", "quick", "oracle", "seed", "root"]
    )]
    combine: Vec<PathBuf>,
    /// Folder for the report, created if missing: index.html, accuracy.json, .md and .svg, and frames; with --stability
    /// stability.json and stability.md; with --combine cost.json, .md and .svg
    #[arg(short, long, alias = "output", value_name = "FOLDER")]
    out: Option<PathBuf>,
    /// Name of a camera in the scene; may be repeated [default: the first five, or five views around the scene if it has none]
    #[arg(long, value_name = "NAME", conflicts_with = "stability")]
    camera: Vec<String>,
    /// Name of a path in the scene, or a path file (.json): consecutive frames are compared as well, and the report tells how much they flicker
    #[arg(long, value_name = "NAME_OR_FILE", conflicts_with = "stability")]
    path: Option<String>,
    /// Frames per second of the path [default: the path's own]
    #[arg(long, value_name = "N", requires = "path")]
    fps: Option<f64>,
    /// Number of the path's first frame to compare [default: 0]
    #[arg(long, value_name = "FRAME", requires = "path")]
    from: Option<u64>,
    /// Number of the path's last frame to compare [default: 48 frames are compared; with --quick 12]
    #[arg(long, value_name = "FRAME", requires = "path")]
    to: Option<u64>,
    /// Width and height of the frames in pixels [default: 640x360; with --quick 240x135]
    #[arg(long, value_name = "WxH", value_parser = size, conflicts_with = "stability")]
    size: Option<(u32, u32)>,
    /// Number of timed frames of each setting and pose [default: 5; with --quick 3]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1000), conflicts_with = "stability")]
    repeats: Option<u32>,
    /// Few settings, one pose, a small frame and few timed frames, for a first look: prices are rough
    #[arg(long, conflicts_with = "stability")]
    quick: bool,
    /// Measure errors against the f64 reference renderer on the CPU; for small scenes, since a frame may take minutes
    #[arg(long, conflicts_with = "stability")]
    oracle: bool,
    /// Seed of the order in which frames are timed, or of the random splats of --stability
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Number of splats in each class of --stability
    #[arg(long, value_name = "N", default_value_t = 3000, value_parser = clap::value_parser!(u32).range(1..), requires = "stability")]
    count: u32,
    /// Scenes of which --stability also draws random views with every setting, each beside a view a thousandth of a pixel aside: depths must be numbers,
    /// and colours steady
    #[arg(long, value_name = "SCENE", num_args = 1.., requires = "stability", conflicts_with = "root")]
    scenes: Vec<PathBuf>,
    /// Number of such views of each scene
    #[arg(long, value_name = "N", default_value_t = 2000, value_parser = clap::value_parser!(u64).range(1..), requires = "scenes")]
    views: u64,
    /// Print JSON on standard output
    #[arg(long)]
    json: bool,
    /// Folder that the scene's files must lie in [default: the scene's own]
    #[arg(long, value_name = "FOLDER")]
    root: Option<PathBuf>,
    #[command(flatten)]
    cache: CacheArgs,
    #[command(flatten)]
    limits: LimitArgs,
}

/// Makes the report, prints its summary, and writes it to files.
///
/// # Errors
/// The scene or an option is refused, there is no GPU, a file cannot be written, a signal stops the run, or a bound does not hold.
pub fn run(args: &AccuracyArgs) -> Result<()> {
    match &args.scene {
        Some(scene) if args.planner => plan(args, scene),
        Some(scene) => survey(args, scene),
        None if args.combine.is_empty() => check_stability(args),
        None => combine(args),
    }
}

/// Compares the reports of several scenes.
fn combine(args: &AccuracyArgs) -> Result<()> {
    let Some(folder) = &args.out else {
        bail!("no folder for the comparison was given: add -o FOLDER");
    };
    let read = |report: &PathBuf| {
        let file = if report.is_dir() { report.join("accuracy.json") } else { report.clone() };
        let text = std::fs::read_to_string(&file)
            .with_context(|| format!("reading the report {}", file.display()))?;
        Curve::read(&text).with_context(|| file.display().to_string())
    };
    let costs = Costs::new(args.combine.iter().map(read).collect::<Result<_>>()?);
    let plot = report::write_costs(folder, &costs)?;
    if args.json {
        out::print(&(serde_json::to_string_pretty(&costs)? + "\n"))?;
    } else {
        out::print(&format!("{}\n", costs.summary))?;
    }
    say!("{}: the plot, with the tables beside it", plot.display());
    Ok(())
}

/// Loads the scene whose settings are compared.
fn load(args: &AccuracyArgs, scene: &Path) -> Result<(Engine, SceneInfo)> {
    super::local::init_log();
    let scene_args = SceneArgs {
        file: SceneFile {
            scene: scene.to_owned(),
            root: args.root.clone(),
            cache: args.cache.clone(),
        },
        limits: args.limits.clone(),
    };
    scene_args.check_up()?;
    let (engine, info) = scene_args.load_and_warn()?;
    if info.bounds.is_none() {
        bail!("{}: the scene is empty, so there is nothing to compare", scene.display());
    }
    Ok((engine, info))
}

/// Measures a scene for the planner.
fn plan(args: &AccuracyArgs, scene: &Path) -> Result<()> {
    if args.cache.open()?.is_none() {
        bail!("measurements for the planner are kept beside the point trees: leave out --no-cache");
    }
    let (engine, info) = load(args, scene)?;
    let stop = stop_when_told()?;
    let least_size = args.size.map_or(planning::LEAST_SIZE, |(width, height)| [width, height]);
    let client = Client::Unnamed;
    let journals = None;
    let planning =
        Planning { engine: &engine, client, scene: ID, least_size, stop: &stop, journals };
    for request in planning.requests() {
        bake(&engine, &request)?;
    }
    let mut telling = Telling::new();
    let measured = planning.measure(&info, |event| telling.hear(&event));
    telling.bar.finish_and_clear();
    let measured = match measured {
        Err(SurveyError::Stopped) => bail!("stopped by a signal; nothing was kept"),
        measured => measured?,
    };
    let poses = measured.poses.len();
    let settings = engine.learn(ID, measured)?;
    out::print(&format!(
        "measured {settings} settings at {poses} poses; --budget-ms and --min-psnr-db choose from them\n"
    ))
}

/// Measures what accuracy costs for a scene.
fn survey(args: &AccuracyArgs, scene: &Path) -> Result<()> {
    let Some(folder) = &args.out else {
        bail!("no folder for the report was given: add -o FOLDER");
    };
    let is_new = !folder.exists();
    // A large scene takes minutes to load.
    Journal::prepare(folder)?;
    let done = survey_into(args, scene, folder);
    if done.is_err() && is_new {
        // It stays if anything was measured.
        let _ = std::fs::remove_dir(folder);
    }
    done
}

fn survey_into(args: &AccuracyArgs, scene: &Path, folder: &Path) -> Result<()> {
    let (engine, info) = load(args, scene)?;
    let oracle = match args.oracle {
        true => Some(oracle(args, scene)?),
        false => None,
    };
    let extent = if args.quick { Extent::Few } else { Extent::All };
    let shots = args.path.as_deref().map(|name| along(args, &engine, &info, name)).transpose()?;
    let (width, height) = args.size.unwrap_or(if args.quick { (240, 135) } else { (640, 360) });
    // Signals end the program until there are measurements to report.
    let never = AtomicBool::new(false);
    let mut survey = Survey {
        engine: &engine,
        client: Client::Unnamed,
        scene: ID,
        poses: Vec::new(),
        rows: sweep::sized_rows(extent, info.has_samples()),
        size: [width, height],
        repeats: args.repeats.unwrap_or(if args.quick { 3 } else { 5 }),
        seed: args.seed,
        oracle: oracle.as_ref(),
        folder: Some(folder),
        purpose: Purpose::Report,
        stop: &never,
    };
    if info.cameras.is_empty() && args.camera.is_empty() {
        bake(&engine, &survey.request_at(Pose::FIT))?;
    }
    survey.find_poses(&info, &args.camera, args.quick).map_err(|error| match error {
        SurveyError::UnknownCamera(error) => anyhow::anyhow!("--camera: {error}"),
        error => error.into(),
    })?;
    let all = survey.poses.len();
    let blank = survey.leave_out_blank()?;
    if blank.len() == all {
        bail!(
            "nothing of {} is seen in {width}x{height} pixels from {}",
            scene.display(),
            blank.join(", ")
        );
    }
    for name in blank {
        say!("warning: nothing of the scene is seen from {name}; it is left out");
    }
    let name = scene.file_name().unwrap_or(scene.as_os_str()).to_string_lossy();
    let path = args.path.as_deref().zip(shots.as_ref());
    let path = path.map(|(name, shots)| {
        let name = Path::new(name).file_name().and_then(|name| name.to_str()).unwrap_or(name);
        AlongPath { name, shots, rows: sweep::main_rows(extent, info.has_samples()) }
    });
    let record = path.as_ref().map(AlongPath::record);
    let identity = Identity { path: record, ..survey.identity(&name)? };
    let mut journal = Journal::open(folder, &identity, &date(SystemTime::now()))?;
    for request in survey.requests() {
        bake(&engine, &request)?;
    }
    let stop = stop_when_told()?;
    let survey = Survey { stop: &stop, ..survey };
    let mut telling = Telling::new();
    let is_complete = survey.run(&mut journal, |event| telling.hear(&event));
    telling.bar.finish_and_clear();
    let mut is_complete = is_complete?;
    let mut steps = telling.steps;
    if let Some(path) = path.as_ref().filter(|_| is_complete) {
        let mut telling = Telling::new();
        let ended = survey.run_along(path, &mut journal, |event| telling.hear(&event));
        telling.bar.finish_and_clear();
        is_complete = ended?;
        steps += telling.steps;
    }
    if is_complete && steps == 0 {
        say!("nothing to draw: all measurements are there already");
    }
    let results = Results::new(identity, journal.date.clone(), &survey.rows, &journal.records);
    let page = report::write(folder, &results)?;
    if !is_complete {
        bail!(
            "stopped by a signal; {} shows what is there, and the same command continues",
            page.display()
        );
    }
    if args.json {
        out::print(&(serde_json::to_string_pretty(&results)? + "\n"))?;
    } else {
        let along =
            results.along.as_ref().map_or(String::new(), |along| format!("{}\n", along.summary));
        out::print(&format!("{}\n{along}", results.summary))?;
    }
    say!("{}: the report, with the plot, all figures and the frames", page.display());
    Ok(())
}

/// Frames of a path that are compared, unless the arguments say which.
const FRAMES: u64 = 48;
const QUICK_FRAMES: u64 = 12;

/// The frames of a path that are compared.
fn along(args: &AccuracyArgs, engine: &Engine, info: &SceneInfo, name: &str) -> Result<Shots> {
    let found = shots(engine, info, name, args.fps, args.from, args.to)?;
    let count = if args.quick { QUICK_FRAMES } else { FRAMES };
    let found = if args.to.is_none() { found.first(count) } else { found };
    let count = found.wanted().count() as u64;
    if !(2..=MOST_FRAMES).contains(&count) {
        let (first, last) = found.wanted().into_inner();
        bail!(
            "--path {name}: frames {first} to {last} are {count}; 2 to {MOST_FRAMES} can be compared, chosen with --fps, --from and --to"
        );
    }
    Ok(found)
}

/// The scene as the oracle draws it.
fn oracle(args: &AccuracyArgs, scene: &Path) -> Result<Reference> {
    let path = scene.canonicalize().with_context(|| format!("cannot open {}", scene.display()))?;
    let folder = path.parent().unwrap_or(Path::new("/"));
    let root = args.root.as_deref().unwrap_or(folder);
    Reference::load(&path, root, &ReadOptions::default(), &SceneLimits::default())
        .with_context(|| format!("the oracle cannot load {}", scene.display()))
}

/// Shows the progress of a survey: a bar on a terminal, a line every few seconds elsewhere.
struct Telling {
    bar: ProgressBar,
    has_lines: bool,
    /// Steps that were not there already.
    steps: u64,
    began: Instant,
    told: Instant,
}

impl Telling {
    fn new() -> Telling {
        let bar = progress_bar();
        if let Ok(style) = ProgressStyle::with_template("{msg} {wide_bar} {pos}/{len} · {eta} left")
        {
            bar.set_style(style);
        }
        bar.set_message("comparing");
        let now = Instant::now();
        let has_lines = !std::io::stderr().is_terminal();
        Telling { bar, has_lines, steps: 0, began: now, told: now }
    }

    fn hear(&mut self, event: &Event<'_>) {
        let Event { done, total, what } = *event;
        if self.steps == 0 {
            self.began = Instant::now();
            self.bar.set_length(total);
            self.bar.set_position(done);
            // Steps that were there already took no time.
            self.bar.reset_eta();
        }
        self.steps += 1;
        self.bar.set_length(total);
        self.bar.set_position(done);
        self.bar.set_message(what.to_owned());
        if self.has_lines && (self.told.elapsed() >= LINE_EVERY || done == total) {
            self.told = Instant::now();
            let rate = self.steps as f64 / self.began.elapsed().as_secs_f64().max(1e-9);
            let left_s = (total - done) as f64 / rate;
            say!("{done} of {total}: {what}, about {left_s:.0} s left");
        }
    }
}

/// Compares the shaders of splats with f64 on hard cases.
fn check_stability(args: &AccuracyArgs) -> Result<()> {
    if let Some(folder) = &args.out {
        std::fs::create_dir_all(folder)
            .with_context(|| format!("making the folder {}", folder.display()))?;
    }
    let report = stability(args.seed, args.count)?;
    let report = Stability { scenes: steadiness(args)?, ..report };
    let json = serde_json::to_string_pretty(&report)? + "\n";
    if args.json {
        out::print(&json)?;
    } else {
        out::print(&report.to_string())?;
    }
    if let Some(folder) = &args.out {
        for (name, text) in [("stability.json", json), ("stability.md", report.markdown())] {
            let path = folder.join(name);
            std::fs::write(&path, text).with_context(|| format!("writing {}", path.display()))?;
        }
    }
    let broken: Vec<&str> =
        report.rows.iter().filter(|row| !row.holds).map(|row| row.class.as_str()).collect();
    if !broken.is_empty() {
        bail!("outlines exceed their error bounds: {}", broken.join("; "));
    }
    let unsteady = report.scenes.iter().filter(|found| !found.holds);
    let unsteady: Vec<&str> = unsteady.map(|found| found.scene.as_str()).collect();
    if !unsteady.is_empty() {
        bail!("frames of these scenes are not steady: {}", unsteady.join("; "));
    }
    let blank = report.scenes.iter().filter(|found| found.views == 0);
    let blank: Vec<&str> = blank.map(|found| found.scene.as_str()).collect();
    if !blank.is_empty() {
        bail!(
            "nothing was compared of these scenes: {}; the report has the reasons",
            blank.join("; ")
        );
    }
    Ok(())
}

/// Draws random views of the scenes that are to be steady.
fn steadiness(args: &AccuracyArgs) -> Result<Vec<Steadiness>> {
    if args.scenes.is_empty() {
        return Ok(Vec::new());
    }
    // One list for all scenes, with or without samples.
    let rows = sweep::rows(Extent::All, true);
    let stop = stop_when_told()?;
    let (mut found, mut first) = (Vec::with_capacity(args.scenes.len()), 0);
    for scene in &args.scenes {
        let (engine, info) = load(args, scene)?;
        let mut telling = Telling::new();
        let what = scene.file_stem().unwrap_or_default().to_string_lossy();
        let (views, seed) = (args.views, args.seed);
        let sweep = Sweep { engine: &engine, rows: &rows, first, views, seed, stop: &stop };
        let told = |done| telling.hear(&Event { done, total: views, what: &what });
        found.push(sweep.of(&info, told).with_context(|| format!("drawing {}", scene.display()))?);
        telling.bar.finish_and_clear();
        first += usize::try_from(views.div_ceil(u64::from(steady::AT_ONCE)))?;
        if stop.load(Ordering::Relaxed) {
            bail!("stopped by a signal");
        }
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        args: AccuracyArgs,
    }

    fn parse(line: &[&str]) -> Result<AccuracyArgs, clap::Error> {
        Line::try_parse_from([&["accuracy"], line].concat()).map(|line| line.args)
    }

    #[test]
    fn stability_writes_both_files() {
        let folder = tempfile::tempdir().unwrap();
        let output = folder.path().join("new");
        let line = [
            "--stability",
            "--seed",
            "5",
            "--count",
            "3",
            "--json",
            "-o",
            output.to_str().unwrap(),
        ];
        run(&parse(&line).unwrap()).unwrap();
        let json = std::fs::read_to_string(output.join("stability.json")).unwrap();
        let report: serde_json::Value = serde_json::from_str(&json).unwrap();
        assert_eq!((&report["holds"], &report["seed"]), (&true.into(), &5.into()));
        let page = std::fs::read_to_string(output.join("stability.md")).unwrap();
        assert!(page.contains("3 splats a row, seed 5"), "{page}");
    }

    #[test]
    fn either_a_scene_or_stability_is_asked_for() {
        let args =
            parse(&["s.json", "-o", "r", "--camera", "a", "--camera", "b", "--size", "64x36"]);
        let args = args.unwrap();
        assert_eq!(
            (args.camera, args.size),
            (vec!["a".to_owned(), "b".to_owned()], Some((64, 36)))
        );
        assert!(parse(&[]).unwrap_err().to_string().contains("SCENE_OR_ASSET"));
        assert!(parse(&["s.json", "--stability"]).is_err());
        assert!(parse(&["s.json", "--repeats", "0"]).is_err());
        let error = run(&parse(&["s.json"]).unwrap()).unwrap_err();
        assert!(error.to_string().contains("-o FOLDER"), "{error}");
    }

    #[test]
    fn options_without_an_effect_are_refused() {
        assert!(parse(&["s.json", "--planner", "--size", "64x36"]).is_ok());
        for line in [
            &["s.json", "--planner", "--seed", "2"][..],
            &["s.json", "--planner", "--json"],
            &["--combine", "a", "-o", "r", "--seed", "2"],
            &["--combine", "a", "-o", "r", "--root", "f"],
        ] {
            let told = parse(line).unwrap_err().to_string();
            assert!(told.contains("cannot be used with"), "{line:?}: {told}");
        }
    }

    #[test]
    fn combining_takes_reports_and_a_folder_and_nothing_else() {
        let args = parse(&["--combine", "a", "b/accuracy.json", "-o", "r"]).unwrap();
        assert_eq!(args.combine, [PathBuf::from("a"), PathBuf::from("b/accuracy.json")]);
        assert!(parse(&["--combine", "a"]).is_err());
        assert!(parse(&["s.json", "--combine", "a", "-o", "r"]).is_err());
        assert!(parse(&["--combine", "a", "-o", "r", "--quick"]).is_err());
        let folder = tempfile::tempdir().unwrap();
        let (report, output) = (folder.path().join("report"), folder.path().join("new"));
        let line = ["--combine", report.to_str().unwrap(), "-o", output.to_str().unwrap()];
        let told = format!("{:#}", run(&parse(&line).unwrap()).unwrap_err());
        assert!(told.contains("reading the report"), "{told}");
        std::fs::create_dir(&report).unwrap();
        std::fs::write(report.join("accuracy.json"), "{}").unwrap();
        let told = format!("{:#}", run(&parse(&line).unwrap()).unwrap_err());
        assert!(told.contains("accuracy.json: not the accuracy.json of a report"), "{told}");
        assert!(!output.exists());
        let results = crate::accuracy::results::tests::results();
        let json = serde_json::to_string(&results).unwrap();
        std::fs::write(report.join("accuracy.json"), json).unwrap();
        run(&parse(&line).unwrap()).unwrap();
        for file in ["cost.json", "cost.md", "cost.svg"] {
            assert!(output.join(file).metadata().unwrap().len() > 500, "{file}");
        }
    }
}
