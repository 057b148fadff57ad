//! Tests `pointillist path` as run by a shell: complete and interrupted runs, and the frames on disk.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test that unwraps says where it failed")]
#![cfg(unix)]

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output as Ended, Stdio};
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use pointillist::encode::ImageFormat;
use pointillist::engine::{
    Client, Engine, EngineConfig, EngineError, FrameRequest, NodePatch, Pose,
};
use pointillist::film::{self, Event, Film, FilmError, Report, shots::Shots};
use pointillist::plan::{Output, Settings};
use pointillist::scene::random::SplitMix64;
use serde_json::{Value, json};
use sha2::{Digest, Sha256};

/// A folder with a scene that has a path of 121 frames.
struct Studio {
    folder: tempfile::TempDir,
}

const FRAMES: usize = 121;
const SMALL: [&str; 2] = ["--size", "64x48"];

fn path() -> Value {
    json!({ "fps": 30, "keys": [
        { "t": 0, "eye": [25, 20, 90], "target": [25, 25, 0] },
        { "t": 1, "eye": [90, 25, 40], "target": [25, 25, 0], "ease": "in_out" },
        { "t": 2.5, "eye": [60, 80, 30], "target": [25, 25, 0], "fov": 55 },
        { "t": 4, "eye": [25, 20, 90], "target": [25, 25, 0] },
    ] })
}

impl Studio {
    fn new() -> Studio {
        let studio = Studio { folder: tempfile::tempdir().unwrap() };
        let mut cloud = String::from("ply\nformat ascii 1.0\nelement vertex 2500\n");
        for axis in ["x", "y", "z"] {
            writeln!(cloud, "property float {axis}").unwrap();
        }
        cloud += "end_header\n";
        for i in 0..2500 {
            writeln!(cloud, "{} {} {}", i % 50, i / 50, i % 7).unwrap();
        }
        fs::write(studio.at("cloud.ply"), cloud).unwrap();
        let key = &path()["keys"][0];
        let scene = json!({
            "assets": { "cloud": { "file": "cloud.ply" } },
            "nodes": [{ "asset": "cloud" }],
            "cameras": { "first": { "eye": key["eye"], "target": key["target"] } },
            "paths": { "fly": path(), "other": path() },
        });
        fs::write(studio.at("scene.json"), scene.to_string()).unwrap();
        studio
    }

    fn at(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn command(&self, args: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_pointillist"));
        command.args(args).current_dir(self.folder.path());
        command.env("POINTILLIST_CACHE", self.at("cache"));
        command
    }

    /// A command that draws the path `fly` into `folder` as small frames.
    fn fly(&self, folder: &str, more: &[&str]) -> Command {
        let args = ["path", "scene.json", "--path", "fly", "-o", folder];
        self.command(&[&args[..], &SMALL, more].concat())
    }

    /// Runs [`Studio::fly`] to its end, and returns its messages.
    fn flown(&self, folder: &str, more: &[&str]) -> String {
        let output = self.fly(folder, more).output().unwrap();
        let told = text(&output);
        assert!(output.status.success(), "{told}");
        told
    }

    fn succeeds(&self, args: &[&str]) {
        let output = self.command(&[args, &SMALL].concat()).output().unwrap();
        assert!(output.status.success(), "{args:?}: {}", text(&output));
    }

    fn complaint(&self, args: &[&str]) -> String {
        let output =
            self.command(&[&["path", "scene.json"], args, &SMALL].concat()).output().unwrap();
        assert_eq!(output.status.code(), Some(1), "{args:?}: {}", text(&output));
        text(&output)
    }

    /// An engine with the scene under the id that the program uses, so that frames are equal.
    fn engine(&self, adjust: impl FnOnce(&mut EngineConfig)) -> Engine {
        let mut config = EngineConfig::new(self.folder.path());
        adjust(&mut config);
        let engine = Engine::start(config).unwrap();
        engine.load("scene", &self.at("scene.json")).unwrap();
        engine
    }

    /// Draws the path through the library, in a process that draws other things as well.
    fn filmed(
        &self,
        engine: &Engine,
        folder: &str,
        stop: bool,
        tell: impl FnMut(Event<'_>) + Send,
    ) -> Result<Report, FilmError> {
        let mark = engine.scene_mark("scene").unwrap();
        let path = engine.camera_path("scene", "fly").unwrap();
        let film = Film {
            engine,
            request: FrameRequest {
                scene: "scene".to_owned(),
                pose: Pose::FIT,
                width: 64,
                height: 48,
                settings: Settings::default(),
                output: Output::Color,
                format: ImageFormat::Png,
                quality: 85,
                deadline: None,
            },
            shots: Shots::new(&path, None, None, None).unwrap(),
            mark,
            folder: &self.at(folder),
            origin: Client::Unnamed.into(),
            most_pixels: film::MOST_PIXELS,
            elsewhere: None,
        };
        film::run(&film, &AtomicBool::new(stop), tell)
    }

    /// The content of every file in a folder, except for the lock.
    fn contents(&self, folder: &str) -> BTreeMap<String, Vec<u8>> {
        names(&self.at(folder))
            .into_iter()
            .map(|(name, path)| (name, fs::read(path).unwrap()))
            .collect()
    }

    /// The inode of each frame's file. A frame that is drawn again has another inode.
    fn inodes(&self, folder: &str) -> BTreeMap<String, u64> {
        let files =
            names(&self.at(folder)).into_iter().filter(|(name, _)| name.starts_with("frame-"));
        files.map(|(name, path)| (name, fs::metadata(path).unwrap().ino())).collect()
    }

    fn records(&self, folder: &str) -> Vec<Value> {
        records(&fs::read_to_string(self.at(folder).join("frames.jsonl")).unwrap())
    }

    /// Checks that every record has its file with the right length and checksum, and that there are no other files. Returns the
    /// number of records.
    fn check(&self, folder: &str) -> usize {
        let mut files = self.contents(folder);
        let manifest = files.remove("frames.jsonl").unwrap();
        let records = records(std::str::from_utf8(&manifest).unwrap());
        let numbers: Vec<u64> =
            records.iter().map(|record| record["frame"].as_u64().unwrap()).collect();
        assert!(numbers.is_sorted_by(|a, b| a < b));
        for record in &records {
            let file = files.remove(record["file"].as_str().unwrap()).unwrap();
            assert_eq!(record["bytes"], file.len());
            let sum: String =
                Sha256::digest(&file).iter().map(|byte| format!("{byte:02x}")).collect();
            assert_eq!(record["sha256"], sum);
            assert_eq!(record["tag"].as_str().unwrap().len(), 32);
        }
        assert!(files.is_empty(), "{:?}", files.keys());
        records.len()
    }
}

fn names(folder: &Path) -> Vec<(String, PathBuf)> {
    let Ok(items) = fs::read_dir(folder) else { return Vec::new() };
    let found = items.map(|item| {
        let item = item.unwrap();
        (item.file_name().into_string().unwrap(), item.path())
    });
    found.filter(|(name, _)| name != ".frames.lock").collect()
}

fn records(manifest: &str) -> Vec<Value> {
    manifest.lines().skip(1).filter_map(|line| serde_json::from_str(line).ok()).collect()
}

fn text(output: &Ended) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Waits until a folder has this many frames, or the process has ended.
fn wait_for(child: &mut Child, folder: &Path, frames: usize) {
    let began = Instant::now();
    while names(folder).iter().filter(|(name, _)| name.starts_with("frame-")).count() < frames {
        assert!(began.elapsed() < Duration::from_secs(120), "no frames");
        if child.try_wait().unwrap().is_some() {
            return;
        }
        std::thread::sleep(Duration::from_millis(1));
    }
}

#[test]
fn a_path_becomes_numbered_frames() {
    let studio = Studio::new();
    let told = studio.flown("a/frames", &[]);
    assert!(told.contains("121 frames drawn") && told.contains("0 kept"), "{told}");
    assert!(told.contains("121 of 121 frames"), "{told}");
    assert_eq!(studio.check("a/frames"), FRAMES);
    let manifest = fs::read_to_string(studio.at("a/frames/frames.jsonl")).unwrap();
    let header: Value = serde_json::from_str(manifest.lines().next().unwrap()).unwrap();
    let expected = json!({ "manifest": 1, "scene": "scene", "fps": 30.0, "frames": 121, "width": 64, "height": 48,
        "output": "color", "format": "png" });
    assert_eq!(header, expected);
    let last = &studio.records("a/frames")[120];
    assert_eq!((&last["frame"], &last["t"]), (&120.into(), &4.0.into()));

    // The path's first and last key equal a camera of the scene: these frames equal one of `render` bit by bit.
    let render = ["render", "scene.json", "--camera", "first", "-o", "first.png"];
    studio.succeeds(&render);
    let files = studio.contents("a/frames");
    let first = fs::read(studio.at("first.png")).unwrap();
    assert!(files["frame-00000.png"] == first && files["frame-00120.png"] == first);
    assert_ne!(files["frame-00060.png"], first);

    // A second run has nothing to do. The same path from a file gives the same frames.
    let inodes = studio.inodes("a/frames");
    let told = studio.flown("a/frames", &[]);
    assert!(told.contains("0 frames drawn, 121 kept"), "{told}");
    assert_eq!((studio.inodes("a/frames"), studio.contents("a/frames")), (inodes, files.clone()));
    fs::write(studio.at("cam.json"), path().to_string()).unwrap();
    let args = ["path", "scene.json", "--path", "cam.json", "-o", "b"];
    studio.succeeds(&args);
    assert_eq!(studio.contents("b"), files);
}

/// Runs that are killed at many moments, also while starting and while checking files: the final result is that of a single run.
#[test]
fn killed_runs_leave_no_trace() {
    let studio = Studio::new();
    studio.flown("whole", &[]);
    let whole = studio.contents("whole");
    let mut random = SplitMix64::new(7);
    let mut pick = |most: u64| (random.next_u64() % most) as usize;
    let folder = studio.at("broken");
    let mut kept: BTreeMap<String, u64> = BTreeMap::new();
    for round in 0..10 {
        let before = studio.inodes("broken").len();
        let mut child = studio.fly("broken", &[]).stderr(Stdio::null()).spawn().unwrap();
        if round % 3 == 2 {
            std::thread::sleep(Duration::from_millis(pick(900) as u64));
        } else {
            wait_for(&mut child, &folder, before + 1 + pick(14));
        }
        child.kill().unwrap();
        child.wait().unwrap();
        // Frames in the manifest exist, and keep their files through all later runs.
        let inodes = studio.inodes("broken");
        for (file, inode) in &kept {
            assert_eq!(inodes[file], *inode, "{file} was drawn again in round {round}");
        }
        let files = studio.contents("broken");
        let manifest =
            files.get("frames.jsonl").map(|text| String::from_utf8_lossy(text).into_owned());
        for record in records(&manifest.unwrap_or_default()) {
            let file = record["file"].as_str().unwrap();
            assert_eq!(files[file], whole[file], "{file} in round {round}");
            kept.insert(file.to_owned(), inodes[file]);
        }
    }
    assert!(kept.len() > 10, "{} frames in ten runs", kept.len());
    let told = studio.flown("broken", &[]);
    assert!(
        told.contains(&format!("{} frames drawn", FRAMES - kept.len())),
        "{told}: {}",
        kept.len()
    );
    assert_eq!(studio.check("broken"), FRAMES);
    assert_eq!(studio.contents("broken"), whole);
}

#[test]
fn damaged_frames_are_drawn_again_and_no_others() {
    let studio = Studio::new();
    studio.flown("f", &["--to", "19"]);
    let (files, before) = (studio.contents("f"), studio.inodes("f"));
    let file = |number: usize| studio.at(&format!("f/frame-{number:05}.png"));
    let mut flipped = files["frame-00003.png"].clone();
    *flipped.last_mut().unwrap() ^= 1;
    fs::write(file(3), flipped).unwrap();
    fs::write(file(7), &files["frame-00007.png"][..50]).unwrap();
    fs::remove_file(file(11)).unwrap();
    fs::write(studio.at("f/.frame-00012.png.part"), "half").unwrap();
    // A line cut off by a crash, and a damaged line.
    let manifest = String::from_utf8(files["frames.jsonl"].clone()).unwrap();
    let manifest = manifest.replace("{\"frame\":15,", "{\"frime\":15,");
    fs::write(studio.at("f/frames.jsonl"), &manifest[..manifest.len() - 20]).unwrap();
    let told = studio.flown("f", &["--to", "19"]);
    assert!(told.contains("5 frames drawn") && told.contains("15 kept"), "{told}");
    assert_eq!(studio.contents("f"), files);
    let after = studio.inodes("f");
    let anew = [3, 7, 11, 15, 19].map(|number| format!("frame-{number:05}.png"));
    for (name, inode) in before.iter().filter(|(name, _)| !anew.contains(name)) {
        assert_eq!(after[name], *inode, "{name}");
    }
}

#[test]
fn other_settings_draw_all_anew() {
    let studio = Studio::new();
    let few = ["--to", "9", "--format", "jpg"];
    let with = |more: &[&'static str]| [&few[..], more].concat();
    studio.flown("f", &few);
    let mut drawn = vec![studio.contents("f")];
    for more in [
        &["--quality", "40"][..],
        &["--fps", "15"],
        &["--reconstruct", "fuzzy"],
        &["--lod", "spt", "--color-by", "levels"],
        &["--output", "normal"],
    ] {
        let told = studio.flown("f", &with(more));
        assert!(told.contains("10 frames drawn"), "{more:?}: {told}");
        assert_eq!(studio.check("f"), 10);
        assert!(!drawn.contains(&studio.contents("f")), "{more:?}");
        drawn.push(studio.contents("f"));
        assert!(studio.flown("f", &with(more)).contains("0 frames drawn, 10 kept"));
    }
    // Another scene under the same name.
    let cloud = fs::read_to_string(studio.at("cloud.ply")).unwrap();
    fs::write(studio.at("cloud.ply"), cloud.replacen("0 0 0", "0 0 1", 1)).unwrap();
    let told = studio.flown("f", &with(&["--output", "normal"]));
    assert!(told.contains("10 frames drawn"), "{told}");
    // In another format the earlier files are kept and named.
    let told = studio.flown("f", &["--to", "9", "--output", "depth", "--format", "exr"]);
    assert!(told.contains("warning: 10 files") && told.contains("frame-00000.jpg"), "{told}");
    assert_eq!(studio.records("f").len(), 10);
}

/// A film that another renderer began is drawn again completely.
#[cfg(debug_assertions)]
#[test]
fn other_shaders_draw_all_anew() {
    let studio = Studio::new();
    let ends = |mut command: Command| {
        let ended = command.output().unwrap();
        assert!(ended.status.success(), "{}", text(&ended));
        text(&ended)
    };
    studio.flown("f", &["--to", "4"]);
    let before = studio.records("f");
    let shader = include_str!("../shaders/resolve/resolve_samples.wgsl");
    let shaders = studio.at("shaders");
    fs::create_dir_all(shaders.join("resolve")).unwrap();
    fs::write(
        shaders.join("resolve/resolve_samples.wgsl"),
        format!("{shader}// Another shader.\n"),
    )
    .unwrap();
    for expected in ["7 frames drawn", "0 frames drawn, 7 kept"] {
        let mut command = studio.fly("f", &["--to", "6"]);
        command.env("POINTILLIST_SHADERS", &shaders);
        let told = ends(command);
        assert!(told.contains(expected), "{told}");
    }
    for (old, new) in before.iter().zip(studio.records("f")) {
        assert_ne!(old["tag"], new["tag"]);
        assert_eq!(old["sha256"], new["sha256"], "the change is a comment");
    }
}

#[test]
fn parts_make_a_whole() {
    let studio = Studio::new();
    studio.flown("whole", &[]);
    studio.flown("parts", &["--from", "100"]);
    assert_eq!(studio.check("parts"), 21);
    studio.flown("parts", &["--from", "30", "--to", "59"]);
    assert_eq!(studio.check("parts"), 51);
    let told = studio.flown("parts", &[]);
    assert!(told.contains("70 frames drawn") && told.contains("51 kept"), "{told}");
    assert_eq!(studio.contents("parts"), studio.contents("whole"));
}

#[test]
fn an_interrupt_ends_a_run_that_goes_on_later() {
    let studio = Studio::new();
    let slow = ["--fps", "1000"];
    let mut child = studio.fly("f", &slow).stderr(Stdio::piped()).spawn().unwrap();
    wait_for(&mut child, &studio.at("f"), 5);
    // Another process cannot draw into the folder meanwhile.
    let second = studio.fly("f", &slow).output().unwrap();
    let told = text(&second);
    assert!(!second.status.success() && told.contains("another process"), "{told}");
    let id = child.id().to_string();
    assert!(Command::new("kill").args(["-INT", &id]).status().unwrap().success());
    let output = child.wait_with_output().unwrap();
    let told = text(&output);
    assert_eq!(output.status.code(), Some(1), "{told}");
    assert!(told.contains("SIGINT") && told.contains("frames are missing"), "{told}");
    let drawn = studio.check("f");
    assert!((5..4001).contains(&drawn), "{drawn}");
    let last = drawn.to_string();
    let told = studio.flown("f", &["--fps", "1000", "--to", &last]);
    assert!(told.contains("1 frame drawn") && told.contains(&format!("{drawn} kept")), "{told}");
}

#[test]
fn what_is_wrong_is_named() {
    let studio = Studio::new();
    fs::write(
        studio.at("bad.json"),
        r#"{"keys": [{"t": 0, "eye": [0, 0, 1], "targt": [0, 0, 0]}]}"#,
    )
    .unwrap();
    fs::write(studio.at("file"), "").unwrap();
    fs::create_dir(studio.at("notes")).unwrap();
    fs::write(studio.at("notes/frames.jsonl"), "remember the milk\n").unwrap();
    for (args, expected) in [
        (
            &["--path", "flie", "-o", "f"][..],
            "--path flie: there is no such file, and the scene's paths are fly, other",
        ),
        (&["--path", "none.json", "-o", "f"], "--path none.json: No such file"),
        (&["--path", "bad.json", "-o", "f"], "--path bad.json: keys[0]"),
        (
            &["--path", "fly", "-o", "f", "--from", "121"],
            "--from: 121 is beyond the path's last frame, 120",
        ),
        (&["--path", "fly", "-o", "f", "--fps", "0"], "--fps: 0 is out of range"),
        (&["--path", "fly", "-o", "f", "--keep-frames"], "need a video"),
        (&["--path", "fly", "-o", "f", "--format", "pfm"], "format: pfm cannot hold color"),
        (
            &["--path", "fly", "-o", "f", "--lod", "full", "--max-error-px", "2"],
            "--max-error-px: this setting applies to `lod=spt` only; accepted: no value, or a value together with `--lod spt`",
        ),
        (&["--path", "fly", "-o", "file"], "file: "),
        (&["--path", "fly", "-o", "notes"], "frames.jsonl: this is not a manifest of frames"),
    ] {
        let told = studio.complaint(args);
        assert!(told.contains(expected), "{args:?}: {told}");
    }
    assert!(!studio.at("f").exists());
    assert_eq!(fs::read_to_string(studio.at("notes/frames.jsonl")).unwrap(), "remember the milk\n");
    let args = ["path", "cloud.ply", "--path", "fly", "-o", "f"];
    let told = text(&studio.command(&args).output().unwrap());
    assert!(told.contains("the scene has no paths"), "{told}");
}

/// Frames of a moving camera are blurred while the shutter is open; a shutter that never opens changes nothing.
#[test]
fn an_open_shutter_blurs_the_frames_of_a_path() {
    let studio = Studio::new();
    let drawn = |folder: &str, more: &[&str]| {
        studio.flown(folder, &[&["--from", "12", "--to", "13"], more].concat());
        [12, 13].map(|number| {
            fs::read(studio.at(folder).join(format!("frame-000{number}.png"))).unwrap()
        })
    };
    let sharp = drawn("sharp", &[]);
    assert_eq!(drawn("closed", &["--shutter", "0"]), sharp);
    let open = drawn("open", &["--shutter", "1", "--blur-samples", "4"]);
    let half = drawn("half", &["--shutter", "0.5", "--blur-samples", "4"]);
    for (a, b) in [(&open, &sharp), (&half, &sharp), (&open, &half)] {
        assert!(a[0] != b[0] && a[1] != b[1]);
    }
    // A run that goes on draws the same.
    fs::remove_file(studio.at("open/frame-00013.png")).unwrap();
    assert_eq!(drawn("open", &["--shutter", "1", "--blur-samples", "4"]), open);
}

/// Receipts of films have no plan, so the command says what they would.
#[test]
fn a_goal_that_no_film_is_promised_is_told() {
    let studio = Studio::new();
    let told = studio.flown("f", &["--to", "2", "--min-psnr-db", "30"]);
    let expected = "warning: the goal of 30 dB is not promised: the scene was not measured";
    assert!(told.contains(expected), "{told}");
    let told = studio.flown("g", &["--to", "2"]);
    assert!(!told.contains("promised"), "{told}");
}

/// A video can be resumed like its frames, which are removed when it is finished.
#[cfg(feature = "video")]
#[test]
fn a_path_becomes_a_video() {
    use pointillist::film::video::mp4::Summary;
    let studio = Studio::new();
    // Kill the run while it draws frames. The next run continues.
    let mut child = studio.fly("fly.mp4", &["--fps", "60"]).stderr(Stdio::null()).spawn().unwrap();
    wait_for(&mut child, &studio.at("fly.mp4.frames"), 20);
    child.kill().unwrap();
    child.wait().unwrap();
    let kept = studio.records("fly.mp4.frames").len();
    let told = studio.flown("fly.mp4", &["--fps", "60", "--keep-frames"]);
    assert!(told.contains("241 frames, 4.02 s") && told.contains("kept"), "{told}");
    assert!(kept > 0 && studio.check("fly.mp4.frames") == 241, "{kept}");
    let video = |name: &str| Summary::read(&studio.at(name)).unwrap().unwrap();
    let found = video("fly.mp4");
    assert_eq!((found.frames, found.width, found.height), (241, 64, 48));
    assert!((found.duration_s() - 241.0 / 60.0).abs() < 1e-3);
    // Run it again from the existing frames. They are then removed, and no other file is.
    fs::write(studio.at("fly.mp4.frames/notes.txt"), "remember the milk").unwrap();
    let told = studio.flown("fly.mp4", &["--fps", "60", "--bitrate-kbps", "100"]);
    assert!(told.contains("0 frames drawn, 241 kept"), "{told}");
    assert_eq!(names(&studio.at("fly.mp4.frames")).len(), 1);
    assert_eq!(video("fly.mp4").frames, 241);
    studio.flown("part.MP4", &["--from", "10", "--to", "29"]);
    assert_eq!(video("part.MP4").frames, 20);
    assert!(!studio.at("part.MP4.frames").exists());
    for (args, expected) in [
        (&["--size", "65x48"][..], "--size: 65 is odd"),
        (&["--to", "0"], "--to: a video needs at least two frames"),
        (&["--bitrate-kbps", "1"], "--bitrate-kbps: 1 is out of range"),
        (&["--output", "depth"], "--output: a video needs"),
    ] {
        let line = [&["path", "scene.json", "--path", "fly", "-o", "no.mp4"], args].concat();
        let output = studio.command(&line).output().unwrap();
        let told = text(&output);
        assert!(!output.status.success() && told.contains(expected), "{args:?}: {told}");
    }
    assert!(!studio.at("no.mp4.frames").exists());
}

/// Without a coder, the command says what to do before it draws anything. `ffmpeg` serves as a coder.
#[cfg(not(feature = "video"))]
#[test]
fn a_video_needs_a_coder() {
    let studio = Studio::new();
    let output = studio.fly("fly.mp4", &[]).env("PATH", studio.at("nowhere")).output().unwrap();
    let told = text(&output);
    assert!(!output.status.success(), "{told}");
    assert!(told.contains("--features video") && told.contains("ffmpeg"), "{told}");
    assert!(!studio.at("fly.mp4.frames").exists());
}

/// Neither a queue filled by others nor a lost device loses or changes a frame.
#[test]
fn what_the_engine_puts_off_is_drawn_later() {
    let studio = Studio::new();
    studio.flown("whole", &[]);
    let whole = studio.contents("whole");

    let narrow = studio.engine(|config| (config.queue_capacity, config.max_batch) = (1, 1));
    let report = studio.filmed(&narrow, "narrow", false, |_| ()).unwrap();
    assert_eq!((report.drawn, report.kept, report.missing), (121, 0, 0));
    assert_eq!(studio.contents("narrow"), whole);

    let engine = studio.engine(|_| ());
    let mut drawn = 0;
    let report = studio.filmed(&engine, "lost", false, |event| {
        drawn += u64::from(matches!(event, Event::Drawn { .. }));
        if drawn == 5 {
            engine.lose_device();
        }
    });
    assert_eq!((report.unwrap().drawn, drawn), (121, 121));
    assert_eq!(engine.stats().device_losses, 1);
    assert_eq!(studio.contents("lost"), whole);
    // Several frames went through the device at once.
    let stats = engine.stats();
    assert!(stats.batches * 2 < stats.frames, "{} frames, {} batches", stats.frames, stats.batches);
}

/// Which frames are drawn from point trees depends on the pose: here the first is drawn in full and the last from a tree.
#[test]
fn a_film_bakes_what_a_later_frame_needs() {
    let studio = Studio::new();
    let made = ["generate", "statue", "--points", "200000", "-o", "statue.ply"];
    let output = studio.command(&made).output().unwrap();
    assert!(output.status.success(), "{}", text(&output));
    let key =
        |t: u32, distance: f64| json!({ "t": t, "eye": [0, 1, distance], "target": [0, 1, 0] });
    let path = json!({ "fps": 4, "keys": [key(0, 1.0), key(1, 10.0)] });
    fs::write(studio.at("out.json"), path.to_string()).unwrap();
    let settings = ["--lod", "spt", "--max-error-px", "0.5", "--reconstruct", "splats"];
    let args = ["path", "statue.ply", "--path", "out.json", "-o", "out"];
    studio.succeeds(&[&args[..], &settings].concat());
    let lods = |name: &str| {
        let args = ["render", "statue.ply", "--receipt", "r.json", "-o", "f.png"];
        let eye = ["--eye", name, "--target", "0,1,0"];
        studio.succeeds(&[&args[..], &eye, &settings].concat());
        let receipt: Value =
            serde_json::from_slice(&fs::read(studio.at("r.json")).unwrap()).unwrap();
        receipt["settings"]["lod"].as_str().unwrap().to_owned()
    };
    assert_eq!([lods("0,1,1"), lods("0,1,10")], ["full", "spt"], "the poses were well chosen");
}

#[test]
fn a_scene_that_changes_ends_the_run() {
    let studio = Studio::new();
    let engine = studio.engine(|_| ());
    let stopped = studio.filmed(&engine, "f", true, |_| ()).unwrap();
    assert_eq!((stopped.drawn, stopped.missing), (0, 121));
    let hidden = NodePatch { visible: Some(false), ..NodePatch::default() };
    let mut is_first = true;
    let ended = studio.filmed(&engine, "f", false, |event| {
        if matches!(event, Event::Drawn { .. }) && std::mem::take(&mut is_first) {
            engine.patch("scene", "0", &hidden).unwrap();
        }
    });
    assert!(matches!(ended, Err(FilmError::SceneChanged { .. })), "{ended:?}");
    assert!((1..121).contains(&studio.check("f")));
    // None of these frames shows the scene as it is now.
    let report = studio.filmed(&engine, "f", false, |_| ()).unwrap();
    assert_eq!((report.drawn, report.kept), (121, 0));
}

/// A new scene under the same id begins at the same revision, but counts as another scene.
#[test]
fn a_scene_that_is_exchanged_ends_the_run() {
    let studio = Studio::new();
    let mut other: Value =
        serde_json::from_slice(&fs::read(studio.at("scene.json")).unwrap()).unwrap();
    other["nodes"][0]["translate"] = json!([0, 0, 20]);
    fs::write(studio.at("other.json"), other.to_string()).unwrap();
    let engine = studio.engine(|_| ());
    let exchange = |file: &str| {
        engine.remove("scene").unwrap();
        assert_eq!(engine.load("scene", &studio.at(file)).unwrap().revision, 1);
    };
    let mut is_first = true;
    let ended = studio.filmed(&engine, "f", false, |event| {
        if matches!(event, Event::Drawn { .. }) && std::mem::take(&mut is_first) {
            exchange("other.json");
        }
    });
    // Frames are sent on another thread, which may look between the two steps of the exchange.
    let is_told = match &ended {
        Err(FilmError::Frame { error, .. }) => matches!(error, EngineError::UnknownScene { .. }),
        ended => matches!(ended, Err(FilmError::SceneChanged { .. })),
    };
    assert!(is_told, "{ended:?}");
    let drawn = studio.check("f");
    assert!((1..FRAMES).contains(&drawn), "{drawn}");
    // Frames show the scene of which they were drawn: none are kept for the other scene, and all are kept for the first.
    let report = studio.filmed(&engine, "other", false, |_| ()).unwrap();
    assert_eq!(report.drawn, FRAMES as u64);
    exchange("scene.json");
    let report = studio.filmed(&engine, "f", false, |_| ()).unwrap();
    assert_eq!(report.kept, drawn as u64);
    let whole = studio.contents("f");
    exchange("other.json");
    let report = studio.filmed(&engine, "f", false, |_| ()).unwrap();
    assert_eq!((report.drawn, report.kept), (FRAMES as u64, 0));
    assert_eq!(studio.contents("f"), studio.contents("other"));
    assert_ne!(studio.contents("f"), whole);
    // A change of the scene after the survey of a complete folder is no error.
    let ended = studio.filmed(&engine, "f", false, |event| {
        if matches!(event, Event::Surveyed { .. }) {
            exchange("scene.json");
        }
    });
    assert_eq!(ended.unwrap().kept, FRAMES as u64, "all was there, and is of the scene as it was");
}

/// A run that is told to stop before it draws anything changes nothing, even in a complete folder.
#[test]
fn a_run_that_stops_at_once_keeps_what_is_there() {
    let studio = Studio::new();
    let engine = studio.engine(|_| ());
    studio.filmed(&engine, "f", false, |_| ()).unwrap();
    let whole = studio.contents("f");
    let stopped = studio.filmed(&engine, "f", true, |_| panic!("nothing was looked through"));
    let stopped = stopped.unwrap();
    assert_eq!((stopped.kept, stopped.drawn, stopped.missing), (0, 0, FRAMES as u64));
    assert_eq!(studio.contents("f"), whole);
    assert_eq!(studio.filmed(&engine, "f", false, |_| ()).unwrap().kept, FRAMES as u64);
}

#[test]
fn a_file_is_no_folder() {
    let studio = Studio::new();
    fs::write(studio.at("notes.txt"), "mine").unwrap();
    let told = studio.complaint(&["--path", "fly", "-o", "notes.txt"]);
    assert!(told.contains("existing file") && told.contains(".mp4"), "{told}");
    assert_eq!(fs::read_to_string(studio.at("notes.txt")).unwrap(), "mine");
    let told = studio.complaint(&["--path", "fly", "-o", "film.gif"]);
    assert!(told.contains("cannot write .gif videos"), "{told}");
    if cfg!(feature = "video") {
        fs::write(studio.at("fly.mp4.frames"), "mine").unwrap();
        let told = studio.complaint(&["--path", "fly", "-o", "fly.mp4"]);
        assert!(told.contains("fly.mp4.frames, but a file"), "{told}");
    }
}
