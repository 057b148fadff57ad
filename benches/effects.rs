//! Looks at every effect: our frame without it, our frame with it, and the reference renderer's frame with it.
//!
//! Each effect has a small scene (`effects/scenes.rs`). Contact sheets in `target/bench/effects/` have a row for each effect: off, on, the reference,
//! and the difference of the last two, [`AMPLIFIED`] times as large. A frame with an effect should have [`LEAST_DB`] against the reference, and [`GAINED_DB`]
//! more than the frame without it. The bench fails where a frame has less, but for known reasons, which have a least PSNR of their own.
//!
//! `EFFECTS_RECORD=1` copies the sheets to `docs/img/`.

mod common;
#[path = "effects/scenes.rs"]
mod scenes;
// The shapes and glTF files of the twin tests.
#[allow(dead_code, clippy::unwrap_used, reason = "the bench uses a part, and tests unwrap")]
#[path = "../tests/twin/files.rs"]
mod shapes;
#[path = "effects/sheet.rs"]
mod sheet;

use std::path::{Path, PathBuf};

use anyhow::{Context, ensure};
use common::report::{Bound, Report, number, verdict};
use common::{folder, is_quick, pick};
use glam::{DAffine3, DVec2};
use pointillist::accuracy::metrics;
use pointillist::accuracy::reference::Reference;
use pointillist::assets::ReadOptions;
use pointillist::encode::ImageFormat;
use pointillist::engine::{Engine, EngineConfig, FrameRequest, Pose};
use pointillist::math::{View, exposures};
use pointillist::oracle::color::srgb8_from_linear;
use pointillist::oracle::{self, OracleFrame, OracleScene};
use pointillist::plan::{Edl, Output, Settings, Shadows};
use pointillist::scene::clipping::ClipRegion;
use pointillist::scene::{EyeDome, SceneLimits};
use scenes::{Case, Scene, Side};

const SIZE: [u32; 2] = [128, 96];
const LEAST_DB: f64 = 40.0;
/// How much nearer to the reference an effect brings a frame.
const GAINED_DB: f64 = 6.0;
/// PSNR that equal images count as.
const MOST_DB: f64 = 99.0;
const AMPLIFIED: u8 = 8;
const ROWS_A_SHEET: usize = 8;
/// Most bytes of all recorded sheets.
const MOST_BYTES: usize = 600_000;

fn main() -> anyhow::Result<()> {
    let sheets = folder().join("effects");
    let root = sheets.join("scenes");
    std::fs::create_dir_all(&root)?;
    let root = root.canonicalize()?;
    let bench = Bench {
        engine: Engine::start(EngineConfig::new(&root))?,
        root,
        size: pick(SIZE, [32, 24]),
    };
    let mut report = Report::new("effects", &bench.engine.adapter());
    let mut looks = Vec::new();
    for (number, case) in scenes::all()?.into_iter().enumerate() {
        let name = case.name;
        println!("drawing {name}");
        looks.push(bench.look(number, case).context(name)?);
    }
    tell(&mut report, &looks, bench.size);
    write_sheets(&mut report, &looks, &sheets, bench.size)?;
    report.finish()?;
    // Small frames of a smoke check may miss an effect.
    let faults: Vec<&str> = looks.iter().filter(|look| look.is_wrong()).map(Look::name).collect();
    ensure!(
        is_quick() || faults.is_empty(),
        "without a known reason, these effects have less than {LEAST_DB} dB, or do not bring the frame {GAINED_DB} dB nearer to the reference: {}",
        faults.join(", ")
    );
    Ok(())
}

struct Bench {
    root: PathBuf,
    engine: Engine,
    size: [u32; 2],
}

/// An effect with its frames and figures.
struct Look {
    case: Case,
    /// Off, on, the reference, and the difference of the last two.
    frames: sheet::Frames,
    /// Passes, and effects within passes, that the frame with the effect has and the one without lacks.
    added: Vec<String>,
    changed_percent: f64,
    psnr_db: f64,
    /// That of the frame without the effect.
    off_db: f64,
    largest: u8,
}

/// A frame of the engine, with the names of the passes and of the effects within passes that it ran.
struct Drawn {
    color: Vec<[u8; 4]>,
    ran: Vec<String>,
}

impl Look {
    fn name(&self) -> &str {
        self.case.name
    }

    fn is_met(&self) -> bool {
        self.psnr_db >= LEAST_DB
    }

    fn is_wrong(&self) -> bool {
        let least_db = self.case.allowed.map_or(LEAST_DB, |(least_db, _)| least_db);
        self.psnr_db < least_db || self.psnr_db < self.off_db + GAINED_DB
    }
}

impl Bench {
    fn look(&self, number: usize, case: Case) -> anyhow::Result<Look> {
        let (_, off) = self.draw(&format!("{number}-off"), &case, &case.off)?;
        let (scene, on) = self.draw(&format!("{number}-on"), &case, &case.on)?;
        let (read, limits) = (ReadOptions::default(), SceneLimits::default());
        let reference = Reference::load(&scene, &self.root, &read, &limits)?;
        let exact = self.exact(&case, &reference)?;
        let changed = off.color.iter().zip(&on.color).filter(|(a, b)| a != b).count();
        let difference = exact.iter().zip(&on.color).map(|(a, b)| {
            let [r, g, b, _] =
                std::array::from_fn(|c| a[c].abs_diff(b[c]).saturating_mul(AMPLIFIED));
            [r, g, b, 255]
        });
        let difference = difference.collect();
        Ok(Look {
            added: on.ran.into_iter().filter(|name| !off.ran.contains(name)).collect(),
            changed_percent: 100.0 * changed as f64 / on.color.len() as f64,
            psnr_db: metrics::psnr(&exact, &on.color)?.min(MOST_DB),
            off_db: metrics::psnr(&exact, &off.color)?.min(MOST_DB),
            largest: metrics::max_error(&exact, &on.color)?,
            frames: [off.color, on.color, exact, difference],
            case,
        })
    }

    /// Writes the scene of a side into a folder of its own, loads it and draws it. Returns the scene file as well.
    fn draw(&self, id: &str, case: &Case, side: &Side) -> anyhow::Result<(PathBuf, Drawn)> {
        let Side { scene, settings } = side;
        let file = write(&self.root.join(id), scene)?;
        self.engine.load(id, &file)?;
        let camera = case.camera_at(0.5);
        let pose = if settings.open_share().is_some() {
            let exposed = exposures(settings.exposures()).map(|one| case.camera_at(one.time));
            Pose::Moving { camera, exposed: exposed.collect() }
        } else {
            Pose::Camera(camera)
        };
        let [width, height] = self.size;
        let request = FrameRequest {
            scene: id.to_owned(),
            pose,
            width,
            height,
            settings: *settings,
            output: Output::Color,
            format: ImageFormat::Raw,
            quality: 85,
            deadline: None,
        };
        let frame = self.engine.submit(request)?.wait()?;
        let receipt = &frame.receipt;
        let passes = receipt.passes.iter().filter(|pass| pass.ran);
        let effects = receipt.specialisations.iter().filter(|effect| effect.ran);
        let ran = passes.map(|pass| pass.name.to_owned());
        let ran = ran.chain(effects.map(|effect| effect.name.name())).collect();
        Ok((file, Drawn { color: frame.bytes.as_chunks::<4>().0.to_vec(), ran }))
    }

    /// The reference renderer's frame with the effect.
    fn exact(&self, case: &Case, reference: &Reference) -> anyhow::Result<Vec<[u8; 4]>> {
        let settings = &case.on.settings;
        let (strength, radius_px) = (settings.edl_strength.get(), settings.edl_radius_px.get());
        let region = |boxes| ClipRegion { boxes, box_from_world: DAffine3::IDENTITY };
        let scene = OracleScene {
            shadows: settings.shadows == Shadows::On,
            clip: settings.clip_boxes.map(region),
            edl: (settings.edl == Edl::On).then_some(EyeDome { strength, radius_px }),
            tone: settings.tone(),
            ..reference.scene()
        };
        let draw = |view: &View| oracle::render(&scene, view, settings.parts());
        let views = self.views(case, settings)?;
        Ok(mean(&views.iter().map(draw).collect::<Vec<_>>()))
    }

    /// The views whose mean is the frame with the effect.
    fn views(&self, case: &Case, settings: &Settings) -> anyhow::Result<Vec<View>> {
        let [width, height] = self.size;
        let at = |time: f64| case.camera_at(time).view(width, height);
        let middle = at(0.5)?;
        if let Some(shift) = settings.eye_shift() {
            return Ok(vec![middle.from_lens(DVec2::new(shift, 0.0), middle.focus)]);
        }
        if !settings.is_blurred() {
            return Ok(vec![middle]);
        }
        let radius = 0.5 * settings.lens_diameter().unwrap_or(0.0);
        let exposed = exposures(settings.exposures()).map(|one| -> anyhow::Result<View> {
            let view = at(one.time)?;
            Ok(view.from_lens(radius * one.on_lens, view.focus).moved(one.in_pixel))
        });
        exposed.collect()
    }
}

/// Writes a scene and its files into a folder, and returns the scene file.
fn write(folder: &Path, scene: &Scene) -> anyhow::Result<PathBuf> {
    std::fs::create_dir_all(folder)?;
    for (name, bytes) in &scene.files {
        std::fs::write(folder.join(name), bytes)?;
    }
    let file = folder.join("scene.json");
    std::fs::write(&file, scene.description.to_string())?;
    Ok(file)
}

/// The mean of frames before an opaque background, in linear light.
fn mean(frames: &[OracleFrame]) -> Vec<[u8; 4]> {
    let pixels = frames.first().map_or(0, |frame| frame.color.len());
    let channel = |pixel: usize, channel: usize| {
        let light = frames.iter().map(|frame| frame.color[pixel][channel].clamp(0.0, 1.0));
        srgb8_from_linear(light.sum::<f64>() / frames.len() as f64)
    };
    (0..pixels).map(|i| [channel(i, 0), channel(i, 1), channel(i, 2), 255]).collect()
}

/// Prints figures and targets, and the reasons for what is below the target.
fn tell(report: &mut Report, looks: &[Look], [width, height]: [u32; 2]) {
    let row = |look: &Look| {
        let added = if look.added.is_empty() { "none".to_owned() } else { look.added.join(", ") };
        vec![
            look.name().to_owned(),
            look.case.switch.to_owned(),
            number(look.changed_percent),
            number(look.psnr_db),
            number(look.off_db),
            look.largest.to_string(),
            added,
            verdict(Some(look.is_met())).to_owned(),
        ]
    };
    report.table(
        &format!("Effects at {width} × {height} pixels, on against off and against the reference"),
        &[
            "effect",
            "switched on by",
            "changed pixels, %",
            "PSNR, dB",
            "without it, dB",
            "largest difference of a byte",
            "passes, and effects within passes, that it adds",
            "40 dB",
        ],
        &looks.iter().map(row).collect::<Vec<_>>(),
    );
    let low = looks.iter().filter(|look| !look.is_met());
    let reason =
        |look: &Look| look.case.allowed.map_or("not known", |(_, reason)| reason).to_owned();
    let rows: Vec<Vec<String>> =
        low.map(|look| vec![look.name().to_owned(), number(look.psnr_db), reason(look)]).collect();
    if !rows.is_empty() {
        report.table("Below 40 dB, and why", &["effect", "PSNR, dB", "reason"], &rows);
    }
    for look in looks {
        let what = format!("{}: PSNR against the reference", look.name());
        report.target(&what, Some(look.psnr_db), Bound::AtLeast(LEAST_DB), "dB");
        let what = format!("{}: PSNR over that of the frame without it", look.name());
        let gained_db = look.psnr_db - look.off_db;
        report.target(&what, Some(gained_db), Bound::AtLeast(GAINED_DB), "dB");
    }
}

/// Writes `effects-1.png` and so on, and says in the report which effects each sheet has.
fn write_sheets(
    report: &mut Report,
    looks: &[Look],
    folder: &Path,
    size: [u32; 2],
) -> anyhow::Result<()> {
    let mut sheets = Vec::new();
    for (number, looks) in (1..).zip(looks.chunks(ROWS_A_SHEET)) {
        let rows: Vec<&sheet::Frames> = looks.iter().map(|look| &look.frames).collect();
        let file = format!("effects-{number}.png");
        let bytes = sheet::png(&rows, size)?;
        std::fs::write(folder.join(&file), &bytes).with_context(|| file.clone())?;
        let names: Vec<&str> = looks.iter().map(Look::name).collect();
        report.value(&format!("sheet {number}"), names.join(", "));
        println!("wrote {}, from the top: {}", folder.join(&file).display(), names.join(", "));
        sheets.push((file, bytes));
    }
    let total: usize = sheets.iter().map(|(_, bytes)| bytes.len()).sum();
    report.value("sheets, bytes", total);
    if std::env::var("EFFECTS_RECORD").is_ok_and(|value| value == "1") {
        ensure!(!is_quick(), "a smoke check is not recorded: its frames are tiny");
        ensure!(total <= MOST_BYTES, "the sheets have {total} bytes, of {MOST_BYTES} at most");
        for (file, bytes) in &sheets {
            std::fs::write(Path::new("docs/img").join(file), bytes)
                .with_context(|| format!("docs/img/{file}"))?;
        }
        println!("recorded {} sheets in docs/img", sheets.len());
    }
    Ok(())
}
