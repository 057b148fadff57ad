//! The commands that work without a server, run as by a shell.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test that unwraps says where it failed")]

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;

/// A folder with a cloud, and a home folder for default caches.
struct Shell {
    folder: tempfile::TempDir,
}

impl Shell {
    fn new() -> Shell {
        let shell = Shell { folder: tempfile::tempdir().unwrap() };
        let mut text = String::from("ply\nformat ascii 1.0\nelement vertex 2500\n");
        for axis in ["x", "y", "z"] {
            writeln!(text, "property float {axis}").unwrap();
        }
        text += "end_header\n";
        for i in 0..2500 {
            writeln!(text, "{} {} {}", i % 50, i / 50, i % 7).unwrap();
        }
        std::fs::write(shell.path("cloud.ply"), text).unwrap();
        shell
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn command(&self, args: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_pointillist"));
        command.args(args).current_dir(self.folder.path());
        for name in [
            "POINTILLIST_CACHE",
            "POINTILLIST_NO_CACHE",
            "POINTILLIST_CACHE_MAX_MIB",
            "POINTILLIST_BAKE_MEMORY_MIB",
        ] {
            command.env_remove(name);
        }
        command.env("XDG_CACHE_HOME", self.path("caches"));
        command
    }

    fn run(&self, args: &[&str]) -> Output {
        self.command(args).output().unwrap()
    }

    /// Runs a command that must succeed, and parses its output as JSON.
    fn json(&self, args: &[&str]) -> Value {
        json(&self.run(args))
    }

    /// The default folder of point trees. Drivers have their own caches beside it.
    fn default_cache(&self) -> PathBuf {
        self.path("caches").join("pointillist")
    }

    fn complaint(&self, args: &[&str]) -> String {
        let output = self.run(args);
        assert_eq!(output.status.code(), Some(1), "{args:?}");
        String::from_utf8(output.stderr).unwrap()
    }
}

fn json(output: &Output) -> Value {
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{errors}");
    serde_json::from_slice(&output.stdout).unwrap()
}

fn entries(folder: &Path) -> usize {
    std::fs::read_dir(folder).map_or(0, Iterator::count)
}

#[test]
fn bake_fills_the_cache() {
    let shell = Shell::new();
    let first = shell.json(&["bake", "cloud.ply", "--json"]);
    let asset = &first["assets"][0];
    assert_eq!(asset["source"], "stored");
    assert_eq!((&asset["samples"], &asset["tree"]["leaves"]), (&2500.into(), &2500.into()));
    let folder = shell.default_cache();
    assert_eq!(first["cache"], folder.to_str().unwrap());
    assert_eq!(entries(&folder), 1);
    let second = shell.run(&["bake", "cloud.ply"]);
    let (told, lines) = (second.stdout, String::from_utf8(second.stderr).unwrap());
    let told = String::from_utf8(told).unwrap();
    assert!(told.contains("M leaves/s") && told.contains("caches/pointillist"), "{told}");
    assert!(lines.contains("2500 samples") && lines.contains("cache"), "{lines}");

    let named = shell.json(&["bake", "cloud.ply", "--json", "--cache", "here/there"]);
    assert_eq!(
        (&named["assets"][0]["source"], &named["cache"]),
        (&"stored".into(), &"here/there".into())
    );
    assert_eq!(entries(&shell.path("here/there")), 1);
    let mut by_environment = shell.command(&["bake", "cloud.ply", "--json"]);
    by_environment.env("POINTILLIST_CACHE", "here/there");
    assert_eq!(json(&by_environment.output().unwrap())["assets"][0]["source"], "cached");
}

/// A committed scene of one ball of samples.
const BALL: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/hard/turned-away.json");

#[test]
fn accuracy_measures_a_scene_and_a_second_run_has_nothing_to_do() {
    let shell = Shell::new();
    let options = "-o report --quick --camera outside --size 96x54 --repeats 2 --json";
    let line: Vec<&str> = ["accuracy", BALL].into_iter().chain(options.split(' ')).collect();
    let run = |line: &[&str]| {
        let mut command = shell.command(line);
        // Drivers keep compiled shaders in the user's cache, and point trees of so small a scene are quickly built.
        command.env_remove("XDG_CACHE_HOME").env("POINTILLIST_NO_CACHE", "true");
        command.output().unwrap()
    };
    let first = run(&line);
    let results = json(&first);
    let rows = results["scopes"][0]["entries"].as_array().unwrap();
    let ways = ["points full", "splats full", "fuzzy full", "painted full", "pull_push full"];
    for way in ways {
        let row = rows.iter().find(|row| row["row"] == way).unwrap();
        let same = row["same_as"].as_str().unwrap_or(way);
        assert!(row["gpu_ms"]["median"].as_f64().unwrap() > 0.0, "{way}");
        assert!(row["psnr_db"].as_f64().unwrap() > 10.0, "{way}");
        assert!(rows.iter().any(|row| row["row"] == same && row["same_as"].is_null()), "{way}");
    }
    // What `auto` chooses is another row.
    let auto = rows.iter().find(|row| row["row"] == "auto full").unwrap();
    assert!(auto["same_as"].is_string() && !auto["notes"].as_array().unwrap().is_empty(), "{auto}");
    let points = rows.iter().find(|row| row["row"] == "points full").unwrap();
    let splats = rows.iter().find(|row| row["row"] == "splats full").unwrap();
    assert!(splats["psnr_db"].as_f64() > points["psnr_db"].as_f64(), "{splats} {points}");
    assert!(!results["scopes"][0]["fronts"]["psnr"].as_array().unwrap().is_empty());
    for file in ["accuracy.json", "accuracy.md", "accuracy.svg", "index.html", "measurements.jsonl"]
    {
        assert!(shell.path("report").join(file).metadata().unwrap().len() > 500, "{file}");
    }
    let pose = results["scopes"][0]["folder"].as_str().unwrap();
    let frames = shell.path("report/frames").join(pose);
    assert!(frames.join("reference.png").exists() && frames.join("splats-full-flip.png").exists());

    let journal = std::fs::read(shell.path("report/measurements.jsonl")).unwrap();
    let again = run(&line);
    assert_eq!(json(&again), results);
    let told = String::from_utf8(again.stderr).unwrap();
    assert!(told.contains("nothing to draw"), "{told}");
    assert_eq!(std::fs::read(shell.path("report/measurements.jsonl")).unwrap(), journal);

    // A run that was cut off within its last line measures what is missing, and draws no image again.
    let cut = &journal[..journal.len() - 20];
    std::fs::write(shell.path("report/measurements.jsonl"), cut).unwrap();
    let resumed = run(&line);
    assert!(resumed.status.success());
    let told = String::from_utf8(resumed.stderr).unwrap();
    assert!(told.contains("timing") && !told.contains("nothing to draw"), "{told}");
    let text = std::fs::read_to_string(shell.path("report/measurements.jsonl")).unwrap();
    assert_eq!(text.lines().count(), journal.iter().filter(|&&byte| byte == b'\n').count());

    let other = run(&[&line[..], &["--seed", "9"]].concat());
    assert_eq!(other.status.code(), Some(1));
    let told = String::from_utf8(other.stderr).unwrap();
    assert!(told.contains("seed 1 (now 9)") && told.contains("another folder"), "{told}");
}

#[test]
fn accuracy_along_a_path_tells_what_flickers_and_goes_on() {
    let shell = Shell::new();
    let path = r#"{ "fps": 20, "keys": [
        { "t": 0, "eye": [0, 0, 5], "target": [0, 0, 0] }, { "t": 1, "eye": [2, 1, 4], "target": [0, 0, 0] } ] }"#;
    std::fs::write(shell.path("fly.json"), path).unwrap();
    let file = shell.path("fly.json");
    let options =
        "-o report --quick --camera outside --size 48x36 --repeats 1 --from 3 --to 6 --json";
    let mut line: Vec<&str> = ["accuracy", BALL].into_iter().chain(options.split(' ')).collect();
    line.extend(["--path", file.to_str().unwrap()]);
    let run = |line: &[&str]| {
        let mut command = shell.command(line);
        command.env_remove("XDG_CACHE_HOME").env("POINTILLIST_NO_CACHE", "true");
        command.output().unwrap()
    };
    let results = json(&run(&line));
    let found = &results["identity"]["path"];
    assert_eq!(
        (&found["name"], &found["fps"], &found["from"], &found["to"]),
        (&"fly.json".into(), &20.0.into(), &3.into(), &6.into())
    );
    let along = &results["along"];
    assert_eq!(along["refused"].as_array().map(Vec::len), Some(0), "{along}");
    let entries = along["entries"].as_array().unwrap();
    let of = |row: &str| entries.iter().find(|entry| entry["row"] == row).unwrap();
    for row in ["points full", "splats full", "fuzzy full", "painted full", "pull_push full"] {
        let entry = of(row);
        assert!(entry["flicker"].as_f64().unwrap() > 0.0, "{entry}");
        assert_eq!(
            (&entry["flicker_times"], &entry["frames"]),
            (&1.0.into(), &4.into()),
            "{entry}"
        );
        assert!((10.0..60.0).contains(&entry["psnr_db"].as_f64().unwrap()), "{entry}");
    }
    // Points of one sample a pixel flicker more than splats, and antialiasing steadies both.
    let flicker = |row: &str| of(row)["flicker"].as_f64().unwrap();
    assert!(flicker("points full") > flicker("splats full"), "{along}");
    assert!(flicker("splats full antialias=16x") < flicker("splats full"), "{along}");
    assert!(of("points full")["pop_px"].as_u64().unwrap() > 0, "{along}");
    let text = std::fs::read_to_string(shell.path("report/accuracy.md")).unwrap();
    assert!(text.contains("## Along fly.json") && text.contains("| splats full | 4 |"), "{text}");

    // A run that was cut off within a frame of the path goes on with the same figures.
    let file = shell.path("report/measurements.jsonl");
    let journal = std::fs::read_to_string(&file).unwrap();
    let cut: Vec<&str> = journal.lines().filter(|line| !line.contains(r#""frame":6"#)).collect();
    let whole = cut.iter().filter(|line| line.contains(r#""frame":5"#)).count();
    let kept = cut.len() - whole / 2;
    std::fs::write(&file, cut[..kept].join("\n") + "\n").unwrap();
    let resumed = run(&line);
    let told = String::from_utf8_lossy(&resumed.stderr).into_owned();
    assert!(told.contains("fly.json, frame") && !told.contains("timing"), "{told}");
    assert_eq!(json(&resumed), results);
    assert_eq!(std::fs::read_to_string(&file).unwrap(), journal);
    let again = run(&line);
    assert!(String::from_utf8_lossy(&again.stderr).contains("nothing to draw"), "{again:?}");

    // Other frames are another report.
    let at = line.iter().position(|word| *word == "6").unwrap();
    line[at] = "5";
    let told = String::from_utf8(run(&line).stderr).unwrap();
    assert!(told.contains("frames 3 to 6") && told.contains("(now fly.json"), "{told}");
}

#[test]
fn accuracy_says_what_it_cannot_measure() {
    let shell = Shell::new();
    std::fs::write(shell.path("empty.json"), r#"{"assets": {}, "nodes": []}"#).unwrap();
    std::fs::write(shell.path("broken.ply"), "ply\nnonsense").unwrap();
    let path = r#"{ "fps": 2, "keys": [{ "t": 0, "eye": [0, 0, 5], "target": [0, 0, 0] }, { "t": 1, "eye": [2, 0, 5], "target": [0, 0, 0] }] }"#;
    std::fs::write(shell.path("p.json"), path).unwrap();
    for (line, expected) in [
        (&["accuracy", BALL, "-o", "r", "--camera", "nowhere"][..], "its cameras are"),
        (&["accuracy", "none.json", "-o", "r"], "none.json"),
        (&["accuracy", BALL, "-o", "r", "--path", "nowhere"], "--path nowhere"),
        (&["accuracy", BALL, "-o", "r", "--path", "p.json", "--from", "9"], "--from: 9 is beyond"),
        (
            &["accuracy", BALL, "-o", "r", "--path", "p.json", "--to", "0"],
            "2 to 2000 can be compared",
        ),
        (&["accuracy", "broken.ply", "-o", "r"], "broken.ply"),
        (&["accuracy", "empty.json", "-o", "r"], "empty"),
        (&["accuracy", "cloud.ply", "-o", "cloud.ply/r", "--quick"], "cloud.ply/r"),
        (&["accuracy", "cloud.ply", "-o", "r", "--quick", "--size", "3000x3000"], "smaller --size"),
    ] {
        let told = shell.complaint(line);
        assert!(told.contains(expected) && !told.contains("panicked"), "{line:?}: {told}");
        assert!(!shell.path("r").exists(), "{line:?} leaves a folder");
    }
}

/// A scene may take minutes to load; here it cannot be loaded at all.
#[test]
fn outputs_without_a_place_are_refused_before_the_scene_is_loaded() {
    let shell = Shell::new();
    std::fs::write(shell.path("broken.ply"), "ply\nnonsense").unwrap();
    for (line, expected) in [
        (&["accuracy", "broken.ply", "-o", "."][..], "files of other things"),
        (&["accuracy", "broken.ply", "-o", "cloud.ply/r"], "cloud.ply/r"),
        (&["render", "broken.ply", "-o", "none/a.png"], "there is no folder none"),
        (&["render", "broken.ply", "-o", "a.png", "--receipt", "none/a.json"], "none/a.json"),
        (&["stereo", "broken.ply", "-o", "none/a.png"], "there is no folder none"),
        (&["tiles", "broken.ply", "-o", "none/a.png"], "there is no folder none"),
        (&["panorama", "broken.ply", "-o", "none/a.png"], "there is no folder none"),
        (
            &["render", "broken.ply", "-o", "a.png", "--lod", "full", "--max-error-px", "2"],
            "with `--lod spt`",
        ),
        (&["panorama", "broken.ply", "-o", "a.png", "--width", "255"], "--width: 255 is odd"),
        (
            &["panorama", "broken.ply", "-o", "a.png", "--layout", "cube", "--width", "255"],
            "broken.ply",
        ),
        (&["render", "broken.ply", "-o", "a.png"], "broken.ply"),
    ] {
        let told = shell.complaint(line);
        assert!(told.contains(expected), "{line:?}: {told}");
        assert_eq!(told.contains("broken.ply"), expected == "broken.ply", "{line:?}: {told}");
    }
    // Nothing is drawn for a report that cannot be written.
    let line = ["accuracy", "--stability", "--count", "3", "-o", "cloud.ply/r"];
    let output = shell.run(&line);
    assert_eq!((output.status.code(), output.stdout.len()), (Some(1), 0));
}

/// Few people read the receipt, which gives the same reason.
#[test]
fn a_goal_that_is_not_promised_is_told_on_standard_error() {
    let shell = Shell::new();
    let expected = "warning: the goal of 20 ms is not promised: the scene was not measured";
    let size = ["--size", "64x64"];
    for (line, is_told) in [
        (&["render", "cloud.ply", "--budget-ms", "20", "-o", "a.png"][..], true),
        (&["stereo", "cloud.ply", "--budget-ms", "20", "-o", "b.png"], true),
        (&["render", "cloud.ply", "-o", "c.png"], false),
    ] {
        let output = shell.run(&[line, &size].concat());
        let told = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.success(), "{line:?}: {told}");
        assert_eq!(told.contains(expected), is_told, "{line:?}: {told}");
        assert_eq!(told.contains("promised"), is_told, "{line:?}: {told}");
    }
}

#[test]
fn no_cache_writes_nothing() {
    let shell = Shell::new();
    let told = shell.json(&["bake", "cloud.ply", "--json", "--no-cache"]);
    assert_eq!((&told["assets"][0]["source"], &told["cache"]), (&"built".into(), &Value::Null));
    let told =
        shell.json(&["inspect", "cloud.ply", "--json", "--tree", "--no-cache", "--cache", "c"]);
    assert_eq!(told["trees"][0]["source"], "built");
    // Levels are those of a tree's nodes, so that one is needed.
    let frame = ["--lod", "spt", "--color-by", "levels", "--size", "64x64", "-o", "a.raw"];
    let frame = [&["render", "cloud.ply"][..], &frame].concat();
    assert!(shell.run(&[&frame[..], &["--no-cache"]].concat()).status.success());
    assert!(!shell.default_cache().exists() && !shell.path("c").exists());
    // With the cache, draw the same frame twice.
    for name in ["b.raw", "c.raw"] {
        assert!(shell.run(&[&frame[..9], &[name]].concat()).status.success());
        assert_eq!(
            std::fs::read(shell.path(name)).unwrap(),
            std::fs::read(shell.path("a.raw")).unwrap()
        );
    }
    assert_eq!(entries(&shell.default_cache()), 1);
}

#[test]
fn inspect_tells_of_trees_when_asked() {
    let shell = Shell::new();
    let plain = shell.json(&["inspect", "cloud.ply", "--json"]);
    assert!(plain.get("trees").is_none() && !shell.default_cache().exists());
    assert_eq!(plain["uncovered"], serde_json::json!([null]), "that cloud is no surface");
    let plane: String = (0..900).map(|i| format!("{} {} 0\n", i % 30, i / 30)).collect();
    std::fs::write(shell.path("plane.xyz"), plane).unwrap();
    let told = shell.json(&["inspect", "plane.xyz", "--json"]);
    assert_eq!(told["uncovered"], serde_json::json!([0.0]));
    let text = String::from_utf8(shell.run(&["inspect", "plane.xyz"]).stdout).unwrap();
    assert!(text.contains("< 0.01 %"), "{text}");
    let told = shell.json(&["inspect", "cloud.ply", "--json", "--tree"]);
    let tree = &told["trees"][0]["tree"];
    let sum =
        |list: &Value| list.as_array().unwrap().iter().map(|n| n.as_u64().unwrap()).sum::<u64>();
    let nodes = tree["leaves"].as_u64().unwrap() + tree["inner"].as_u64().unwrap();
    assert_eq!((sum(&tree["levels"]), sum(&tree["errors"])), (nodes, nodes));
    assert_eq!(tree["bytes"].as_u64(), Some(28 * nodes));
    let text = String::from_utf8(shell.run(&["inspect", "cloud.ply", "--tree"]).stdout).unwrap();
    for expected in ["leaves", "inner nodes", "chunks", "a leaf", "level above", "at most"] {
        assert!(text.contains(expected), "{expected}: {text}");
    }
}

#[test]
fn what_cannot_be_cached_is_an_error_of_bake() {
    let shell = Shell::new();
    std::fs::write(shell.path("file"), "").unwrap();
    for (args, expected) in [
        (&["nothing.ply"][..], "cannot open nothing.ply"),
        (&["cloud.ply", "--cache", "file"], "--cache file"),
        (&["cloud.ply", "--cache-max-mib", "0"], "--cache-max-mib 0"),
    ] {
        let text = shell.complaint(&[&["bake"], args].concat());
        assert!(text.contains(expected), "{args:?}: {text}");
    }
    let mut homeless = shell.command(&["bake", "cloud.ply"]);
    let output = homeless.env_remove("XDG_CACHE_HOME").env_remove("HOME").output().unwrap();
    let text = String::from_utf8(output.stderr).unwrap();
    assert!(!output.status.success() && text.contains("give --cache FOLDER"), "{text}");
}

/// Writes a binary PLY file of `count` points of a hilly square, unordered.
fn write_scan(path: &Path, count: u32) {
    let mut bytes = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {count}\nproperty float x\nproperty float y\n\
         property float z\nend_header\n"
    )
    .into_bytes();
    let mut state = 1u64;
    let mut next = || {
        state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f32 / (1 << 24) as f32
    };
    for _ in 0..count {
        let (x, y) = (next(), next());
        for value in [x, y, 0.1 * x * y * (1.0 - x)] {
            bytes.extend(value.to_le_bytes());
        }
    }
    std::fs::write(path, bytes).unwrap();
}

/// The largest resident memory of a command that was observed until it ended, in MiB.
#[cfg(target_os = "linux")]
fn peak_mib(mut command: Command) -> u64 {
    let mut child = command.stdout(std::process::Stdio::null()).spawn().unwrap();
    let status = format!("/proc/{}/status", child.id());
    let mut peak = 0;
    while child.try_wait().unwrap().is_none() {
        let text = std::fs::read_to_string(&status).unwrap_or_default();
        let line = text.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        let kib = line.and_then(|line| line.trim().strip_suffix("kB")?.trim().parse().ok());
        peak = peak.max(kib.unwrap_or(0));
        std::thread::sleep(std::time::Duration::from_millis(2));
    }
    assert!(child.wait().unwrap().success());
    peak / 1024
}

/// A bake that exceeds its memory limit, and is done out of core, gives the same cache entry.
#[cfg(target_os = "linux")]
#[test]
fn bake_keeps_to_its_memory() {
    let shell = Shell::new();
    write_scan(&shell.path("scan.ply"), 400_000);
    let whole =
        peak_mib(shell.command(&["bake", "scan.ply", "--cache", "whole", "--memory", "8G"]));
    let little =
        peak_mib(shell.command(&["bake", "scan.ply", "--cache", "little", "--memory", "64M"]));
    assert!(little <= 64 && whole > 96, "{little} MiB of 64, {whole} in memory");
    let entry = |folder: &str| {
        let mut files: Vec<PathBuf> = std::fs::read_dir(shell.path(folder))
            .unwrap()
            .map(|file| file.unwrap().path())
            .collect();
        assert_eq!(files.len(), 1, "{files:?}");
        let file = files.remove(0);
        (file.file_name().unwrap().to_owned(), std::fs::read(file).unwrap())
    };
    assert!(entry("little") == entry("whole"), "entries differ");
    let again = shell.json(&["bake", "scan.ply", "--cache", "little", "--memory", "64M", "--json"]);
    let first = shell.json(&["bake", "scan.ply", "--cache", "whole", "--json"]);
    assert_eq!(again["assets"][0]["source"], "cached");
    assert_eq!(again["assets"][0]["tree"], first["assets"][0]["tree"]);
}

/// Measures a bake of eight million points in little memory.
#[cfg(target_os = "linux")]
#[test]
#[ignore = "a measurement"]
fn bake_keeps_to_its_memory_for_millions() {
    let shell = Shell::new();
    write_scan(&shell.path("scan.ply"), 8_000_000);
    for (memory, limit) in [("64M", 64), ("128M", 128), ("512M", 512)] {
        let began = std::time::Instant::now();
        let peak =
            peak_mib(shell.command(&["bake", "scan.ply", "--cache", memory, "--memory", memory]));
        println!("{memory}: {peak} MiB, {:.1} s", began.elapsed().as_secs_f64());
        assert!(peak <= limit, "{peak} MiB of {limit}");
    }
}

/// A killed bake leaves neither an entry nor temporary files.
#[cfg(target_os = "linux")]
#[test]
fn a_killed_bake_leaves_nothing() {
    let shell = Shell::new();
    write_scan(&shell.path("scan.ply"), 400_000);
    let args = ["bake", "scan.ply", "--cache", "c", "--memory", "64M"];
    let mut child = shell.command(&args).spawn().unwrap();
    let open = format!("/proc/{}/fd", child.id());
    let has_spilled = || {
        let links = std::fs::read_dir(&open).into_iter().flatten().flatten();
        let links = links.filter_map(|link| std::fs::read_link(link.path()).ok());
        links.into_iter().any(|file| file.to_string_lossy().ends_with("(deleted)"))
    };
    while !has_spilled() {
        assert!(child.try_wait().unwrap().is_none(), "it ended before it could be killed");
        std::thread::sleep(std::time::Duration::from_millis(2));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    assert_eq!(std::fs::read_dir(shell.path("c")).unwrap().count(), 0);
    let baked = shell.json(&[&args[..], &["--json"]].concat());
    assert_eq!(baked["assets"][0]["source"], "stored");
}

/// The report tests the shaders themselves, not a copy of their formulas: an error in a shader breaks its bounds.
#[cfg(debug_assertions)]
#[test]
fn an_error_in_a_shader_breaks_the_bounds_of_the_stability_report() {
    let shell = Shell::new();
    let right = "let inverse_k = 1.0 / (1.0 - f2 * dot(slopes, slopes));";
    let shader = include_str!("../shaders/shared/splat.wgsl");
    assert!(shader.contains(right));
    let wrong = shader.replace(right, "let inverse_k = 1.0;");
    std::fs::create_dir_all(shell.path("shaders/shared")).unwrap();
    std::fs::write(shell.path("shaders/shared/splat.wgsl"), wrong).unwrap();
    let mut command = shell.command(&["accuracy", "--stability", "--count", "20"]);
    let output = command.env("POINTILLIST_SHADERS", shell.path("shaders")).output().unwrap();
    let told = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{told}");
    assert!(told.contains("outlines exceed their error bounds: ordinary"), "{told}");
}

/// A reader that closes the pipe early is not an error.
#[test]
fn a_reader_that_goes_is_no_failure() {
    let shell = Shell::new();
    for args in [
        &["inspect", "cloud.ply", "--json"][..],
        &["inspect", "cloud.ply"],
        &["bake", "cloud.ply", "--json", "--no-cache"],
        &["bake", "cloud.ply", "--no-cache"],
        &["generate", "town", "--points", "1000", "-o", "town.ply"],
        &["accuracy", "--stability", "--count", "3", "--json"],
        &["openapi"],
    ] {
        let (reader, writer) = std::io::pipe().unwrap();
        // Close the pipe before anything is written.
        drop(reader);
        let mut command = shell.command(args);
        command.stdout(writer).stderr(std::process::Stdio::piped());
        let output = command.spawn().unwrap().wait_with_output().unwrap();
        let told = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(0), "{args:?}: {told}");
        assert!(!told.contains("panicked") && !told.contains("roken pipe"), "{args:?}: {told}");
    }
    // Standard error may be closed as well, and real failures still fail.
    for (args, code) in [
        (&["bake", "cloud.ply", "--no-cache"][..], 0),
        (&["render", "cloud.ply", "--size", "8x8", "-o", "cloud.png"], 0),
        (&["render", "none.ply", "--size", "8x8", "-o", "none.png"], 1),
    ] {
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        let mut command = shell.command(args);
        command.stdout(writer.try_clone().unwrap()).stderr(writer);
        assert_eq!(command.status().unwrap().code(), Some(code), "{args:?}");
    }
    assert!(shell.path("cloud.png").exists());
    assert!(shell.path("town.ply").exists());
}

/// Images go to standard output and messages to standard error; `jpg` means JPEG; exit codes are as in `--help`.
#[test]
fn render_writes_to_standard_output() {
    let shell = Shell::new();
    let small = ["render", "cloud.ply", "--size", "32x24", "-o", "-", "--no-cache"];
    let output = shell.run(&small);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && said.contains("standard output: 2500 samples"), "{said}");
    assert!(output.stdout.starts_with(b"\x89PNG"));
    assert!(!shell.path("-").exists());
    let [jpg, jpeg] = ["jpg", "jpeg"].map(|name| {
        let output = shell.run(&[&small[..], &["--format", name]].concat());
        assert!(output.stdout.starts_with(&[0xff, 0xd8]), "{name}");
        output.stdout
    });
    assert_eq!(jpg, jpeg);

    let told = shell.complaint(&["render", "cloud.ply", "-o", "a.tiff"]);
    assert!(told.contains("`tiff`") && told.contains("--format"), "{told}");
    let narrow = [&small[..], &["--max-side", "31"]].concat();
    assert!(shell.complaint(&narrow).contains("31"));
    std::fs::create_dir(shell.path("folder.d")).unwrap();
    let told = shell.complaint(&["render", "folder.d", "-o", "a.png"]);
    assert!(told.contains("is a folder; name one file in it"), "{told}");
    #[cfg(unix)]
    {
        // Opening a pipe without a writer would block for ever.
        assert!(Command::new("mkfifo").arg(shell.path("pipe.ply")).status().unwrap().success());
        let told = shell.complaint(&["render", "pipe.ply", "-o", "a.png"]);
        assert!(told.contains("no regular file"), "{told}");
    }
    let few = [&small[..], &["--max-pixels", "767"]].concat();
    assert!(shell.complaint(&few).contains("767"));
    assert_eq!(shell.run(&["render", "cloud.ply", "--colour"]).status.code(), Some(2));
    let help = String::from_utf8(shell.run(&["--help"]).stdout).unwrap();
    assert!(help.contains("Exit status:"), "{help}");
    // For commands that draw no frame, `--output` is still the file to write.
    let generated = shell.run(&["generate", "sphere", "--output", "ball.ply"]);
    let said = String::from_utf8_lossy(&generated.stderr);
    assert!(generated.status.success() && shell.path("ball.ply").exists(), "{said}");
}

/// A box around the eye, with a colour at each corner.
fn room() -> String {
    let mut text = String::from("ply\nformat ascii 1.0\nelement vertex 8\n");
    for axis in ["x", "y", "z"] {
        writeln!(text, "property float {axis}").unwrap();
    }
    for color in ["red", "green", "blue"] {
        writeln!(text, "property uchar {color}").unwrap();
    }
    text += "element face 12\nproperty list uchar int vertex_indices\nend_header\n";
    for corner in 0..8u32 {
        let [x, y, z] = [0, 1, 2].map(|axis| corner >> axis & 1);
        let side = |bit: u32| 40 + 200 * bit;
        let place = [x, y, z].map(|bit| f64::from(bit) * 4.0 - 2.0);
        let [px, py, pz] = place;
        writeln!(text, "{px} {py} {pz} {} {} {}", side(x), side(y), side(z)).unwrap();
    }
    for [a, b, c, d] in
        [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
    {
        writeln!(text, "3 {a} {b} {c}\n3 {a} {c} {d}").unwrap();
    }
    text
}

/// Faces of a cube that are frames, whose borders fit together, and an image of the whole sphere that shows the same.
#[test]
fn panoramas_show_what_frames_show() {
    let shell = Shell::new();
    std::fs::write(shell.path("room.ply"), room()).unwrap();
    let pose = ["room.ply", "--up", "y", "--eye", "0.3,0.2,-0.4", "--target", "1.3,0.2,-3"];
    let cube = ["--layout", "cube", "--width", "96", "-o", "a.png"];
    assert!(shell.run(&[&["panorama"][..], &pose, &cube].concat()).status.success());
    let face = |name: &str| {
        let face = image::open(shell.path(&format!("a-{name}.png"))).unwrap().into_rgba8();
        assert_eq!(face.dimensions(), (96, 96));
        face
    };
    let near = |a: &image::Rgba<u8>, b: &image::Rgba<u8>, most: u8, what: &str| {
        let worst = a.0.iter().zip(b.0).map(|(a, b)| a.abs_diff(b)).max().unwrap();
        assert!(worst <= most, "{what}: {a:?} {b:?}");
    };
    let front = face("front");
    let frame = ["--fov", "90", "--size", "96x96", "-o", "b.png"];
    assert!(shell.run(&[&["render"][..], &pose, &frame].concat()).status.success());
    let rendered = image::open(shell.path("b.png")).unwrap().into_rgba8();
    let same = front.pixels().zip(rendered.pixels()).filter(|(a, b)| a == b).count();
    assert!(same * 100 > 99 * 96 * 96, "{same} of 9216 pixels are those of a frame");
    // Neighbours at borders show the same directions, apart from a pixel's step.
    let [right, back, left, up, down] = ["right", "back", "left", "up", "down"].map(face);
    for at in 2..94 {
        let beside = [(&front, &right), (&right, &back), (&back, &left), (&left, &front)];
        for (number, (one, next)) in beside.into_iter().enumerate() {
            near(one.get_pixel(95, at), next.get_pixel(0, at), 12, &format!("{number} {at}"));
        }
        near(front.get_pixel(at, 0), up.get_pixel(at, 95), 12, &format!("up {at}"));
        near(front.get_pixel(at, 95), down.get_pixel(at, 0), 12, &format!("down {at}"));
    }
    let sphere = ["--width", "256", "-o", "c.png"];
    assert!(shell.run(&[&["panorama"][..], &pose, &sphere].concat()).status.success());
    let bytes = std::fs::read(shell.path("c.png")).unwrap();
    let note = b"GPano:ProjectionType=\"equirectangular\"";
    assert!(bytes.windows(note.len()).any(|window| window == note));
    let whole = image::load_from_memory(&bytes).unwrap().into_rgba8();
    assert_eq!(whole.dimensions(), (256, 128));
    for (column, face) in [(128, &front), (192, &right), (0, &back), (64, &left)] {
        near(whole.get_pixel(column, 64), face.get_pixel(48, 48), 12, &format!("column {column}"));
    }
    for row in 0..128 {
        near(whole.get_pixel(0, row), whole.get_pixel(255, row), 12, &format!("row {row}"));
    }
    let told = shell.complaint(&[&["panorama"][..], &pose, &["-o", "d.jpg"]].concat());
    assert!(told.contains("must end with .png"), "{told}");
    let beside = ["--eye-offset", "0.1", "-o", "d.png"];
    let told = shell.complaint(&[&["panorama"][..], &pose, &beside].concat());
    assert!(told.contains("--eye-offset"), "{told}");
    let large = ["--width", "99998", "-o", "d.png"];
    let told = shell.complaint(&[&["panorama"][..], &pose, &large].concat());
    let (_, most) = told.trim_end().rsplit_once("accepted: up to ").unwrap();
    assert!(most.parse::<u32>().unwrap().is_multiple_of(2), "{told}");
}

#[test]
fn two_eyes_see_one_scene() {
    let shell = Shell::new();
    std::fs::write(shell.path("room.ply"), room()).unwrap();
    let pose = ["room.ply", "--up", "y", "--eye", "0.3,0.2,1.4", "--target", "0.3,0.2,-2"];
    let size = ["--size", "64x48"];
    let of = |command: &[&str], file: &str| {
        let output = shell.run(&[command, &pose, &size, &["-o", file]].concat());
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        image::open(shell.path(file)).unwrap().into_rgba8()
    };
    let both = of(&["stereo", "--eye-distance", "0.2"], "a.png");
    assert_eq!(both.dimensions(), (128, 48));
    let left = of(&["render", "--eye-offset", "-0.1"], "b.png");
    let right = of(&["render", "--eye-offset", "0.1"], "c.png");
    assert!(left != right);
    for (x, y, pixel) in both.enumerate_pixels() {
        let eye = if x < 64 { &left } else { &right };
        assert_eq!(pixel, eye.get_pixel(x % 64, y), "{x} {y}");
    }
    let above = of(&["stereo", "--layout", "over-under", "--eye-distance", "0.2"], "d.png");
    assert_eq!(above.dimensions(), (64, 96));
    assert_eq!(above.get_pixel(9, 57), right.get_pixel(9, 9));
    let near = of(&["stereo", "--eye-distance", "0.2", "--stereo-distance", "0.7"], "g.png");
    let eye = ["render", "--eye-offset", "0.1", "--stereo-distance", "0.7"];
    let eye = of(&eye, "h.png");
    assert!(eye != right && near.get_pixel(64 + 9, 9) == eye.get_pixel(9, 9));
    let red = of(&["stereo", "--layout", "anaglyph"], "e.png");
    assert_eq!(red.dimensions(), (64, 48));
    let told =
        shell.complaint(&[&["stereo", "--eye-offset", "1"], &pose[..], &["-o", "f.png"]].concat());
    assert!(told.contains("--eye-distance"), "{told}");
}

/// A large image in one file, and as a pyramid of tiles whose pixels are those of the file.
#[test]
fn tiles_make_up_an_image() {
    let shell = Shell::new();
    let tiles =
        ["tiles", "cloud.ply", "--size", "300x200", "--eye", "25,25,60", "--target", "25,25,0"];
    // Frames of 80,000 pixels have parts of 90 × 91.
    let tiles = [&tiles[..], &["--max-pixels", "80000", "--max-side", "320"]].concat();
    let told =
        String::from_utf8(shell.run(&[&tiles[..], &["-o", "a.png"]].concat()).stderr).unwrap();
    assert!(told.contains("300 × 200 pixels in 12 parts"), "{told}");
    let whole = image::open(shell.path("a.png")).unwrap().into_rgba8();
    assert_eq!(whole.dimensions(), (300, 200));
    let render = [&["render"][..], &tiles[1..8], &["-o", "b.png"]].concat();
    assert!(shell.run(&render).status.success());
    let frame = image::open(shell.path("b.png")).unwrap().into_rgba8();
    let same = whole.pixels().zip(frame.pixels()).filter(|(a, b)| a == b).count();
    assert!(same * 200 > 199 * 300 * 200, "{same} of 60000 pixels are those of a frame");
    assert!(shell.run(&[&tiles[..], &["--tile", "64", "-o", "c.dzi"]].concat()).status.success());
    let description = std::fs::read_to_string(shell.path("c.dzi")).unwrap();
    assert!(description.contains("TileSize=\"64\" Overlap=\"1\" Format=\"png\""), "{description}");
    assert!(description.contains("Width=\"300\" Height=\"200\""), "{description}");
    // From one pixel to 512: ten levels.
    for (level, columns, rows) in [(9, 5, 4), (8, 3, 2), (0, 1, 1)] {
        let folder = shell.path(&format!("c_files/{level}"));
        assert_eq!(std::fs::read_dir(&folder).unwrap().count(), columns * rows, "{level}");
    }
    assert!(!shell.path("c_files/10").exists());
    // A smaller image takes the place of the old one as a whole; what is not ours stays.
    let smaller = ["tiles", "cloud.ply", "--size", "20x20", "-o", "c.dzi"];
    let kept = shell.path("c_files/9/1_2.png");
    let tile = image::open(&kept).unwrap().into_rgba8();
    assert!(shell.run(&smaller).status.success());
    assert!(!kept.exists() && shell.path("c_files/5/0_0.png").exists());
    std::fs::write(shell.path("c_files/notes"), "mine").unwrap();
    assert!(shell.complaint(&smaller).contains("notes"));
    assert!(shell.path("c_files/5/0_0.png").exists());
    assert_eq!(tile.dimensions(), (66, 66));
    let part = image::imageops::crop_imm(&whole, 63, 127, 66, 66).to_image();
    let same = tile.pixels().zip(part.pixels()).filter(|(a, b)| a == b).count();
    assert!(same * 200 > 199 * 66 * 66, "{same} of {} pixels", 66 * 66);
    for (options, complaint) in [
        (&["-o", "a.tiff"][..], "neither with .png nor with .dzi"),
        (&["-o", "c.dzi", "--max-pixels", "90000"], "--tile"),
        (&["-o", "c.dzi", "--max-pixels", "9000"], "--max-pixels"),
        (&["-o", "a.png", "--part-of", "9,9,0,0"], "--part-of"),
        (&["-o", "a.png", "--size", "300000x4"], "262144"),
    ] {
        let told = shell.complaint(&[&["tiles", "cloud.ply"][..], options].concat());
        assert!(told.contains(complaint), "{told}");
    }
}
