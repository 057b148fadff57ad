//! Camera paths: recorded, played, saved and loaded; and equality with the daemon's curve.

use glam::DVec3;
use pointillist::scene::parse_path;
use proptest::prelude::*;
use proptest::strategy::ValueTree;
use proptest::test_runner::{Config, RngAlgorithm, TestRng, TestRunner};
use serde_json::{Value, json};

use super::page::{PATIENCE, driver_or_skip, opened, still_picture};
use super::webdriver::Browser;

const KEYS: &str = "return document.querySelectorAll('#keys tbody tr').length";

fn record_two_keys(browser: &Browser) {
    browser.click("#key-add");
    browser.drag("mouse", 0, &[(400, 400), (470, 410), (600, 430)]);
    still_picture(browser);
    browser.click("#key-add");
    assert_eq!(browser.script(KEYS), 2);
}

#[test]
fn a_path_is_recorded_and_played() {
    let Some(driver) = driver_or_skip() else { return };
    let (_daemon, browser) = opened(&driver);
    let first = still_picture(&browser);
    record_two_keys(&browser);
    let last = still_picture(&browser);
    assert_eq!(
        browser.text("return document.getElementById('path-summary').textContent"),
        "2 keys, 2 s"
    );
    browser.choose("#duration", "0.8");
    assert_eq!(browser.text("return document.querySelectorAll('#keys input')[1].value"), "0.8");
    browser.script("document.getElementById('paths').scrollIntoView()");
    browser.shoot("wide-path.png");
    let frames = browser.number("return Number(viewer.canvas.dataset.frames)");
    browser.script(
        "window.xs = new Set(); window.played = setInterval(() => xs.add(viewer.pose.eye[0]), 5); document.getElementById('play').click()",
    );
    assert_eq!(browser.text("return document.getElementById('play').textContent"), "Pause");
    browser.wait_for("the end", PATIENCE, "return !viewer.recorder.player.isPlaying");
    assert_eq!(still_picture(&browser), last, "it ends where the last key is");
    let passed = browser.number("clearInterval(played); return xs.size");
    assert!(passed > 3.0, "it passes between the keys: {passed}");
    assert!(browser.number("return Number(viewer.canvas.dataset.frames)") > frames + 1.0);
    browser.click("#stop");
    assert_eq!(still_picture(&browser), first, "and begins at the first");

    // A loop goes on until it is stopped. Moving the picture by hand stops it.
    browser.click("#loop");
    browser.click("#play");
    browser.wait_for(
        "a second round",
        PATIENCE,
        "globalThis.far ||= viewer.recorder.player.at > 0.5; return far && viewer.recorder.player.at < 0.3",
    );
    browser.drag("mouse", 0, &[(400, 400), (420, 410)]);
    assert!(!browser.script("return viewer.recorder.player.isPlaying").as_bool().unwrap());
    still_picture(&browser);

    // Keys can be reordered, retimed and removed.
    let eyes = || browser.script("return viewer.recorder.path.keys.map(k => k.eye)");
    let before = eyes();
    browser.click("#keys [data-action=down]");
    assert_eq!(eyes(), json!([before[1], before[0]]));
    assert_eq!(browser.script("return viewer.recorder.path.keys.map(k => k.t)"), json!([0, 0.8]));
    browser.choose("#keys input", "5");
    assert_eq!(eyes(), before, "the key with the later time is the later one");
    browser.choose("#keys input", "5");
    let fault = browser.text("return document.getElementById('key-fault').textContent");
    assert!(fault.contains("another key is at 5 s"), "{fault}");
    browser.click("#keys [data-action=delete]");
    assert_eq!(browser.script(KEYS), 1);
    assert_eq!(browser.console_errors(), Vec::<String>::new());
}

/// Records the blob that a download would save.
const CATCH_DOWNLOADS: &str = "window.saved = null; const make = URL.createObjectURL; URL.createObjectURL = blob => { saved = blob; return make(blob); }";

#[test]
fn paths_are_saved_and_loaded_and_taken_from_the_scene() {
    let Some(driver) = driver_or_skip() else { return };
    let (daemon, browser) = opened(&driver);
    browser.script(CATCH_DOWNLOADS);
    record_two_keys(&browser);
    browser.choose("#ease", "in_out");
    browser.choose("#keys select", "linear");
    browser.click("#path-save");
    let text = browser.text("return saved.text()");
    let path = parse_path(&text, "saved", DVec3::Y).expect("what is saved is a path file");
    let pose = browser.script("return viewer.pose");
    let eye: [f64; 3] = path.keys[1].camera.eye.into();
    assert_eq!(json!(eye), pose["eye"]);
    let kept = browser.script("return viewer.recorder.path");
    browser.click("#path-clear");
    assert_eq!(browser.script(KEYS), 0);
    browser.choose_files("#path-file", &[&daemon.file("way.json", &text)]);
    browser.wait_for(
        "the keys",
        PATIENCE,
        "return document.querySelectorAll('#keys tbody tr').length === 2",
    );
    let loaded = browser.script("return viewer.recorder.path");
    assert_eq!((&loaded["keys"], &loaded["ease"]), (&kept["keys"], &kept["ease"]));

    // A key that is recorded while a path of the scene arrives stays.
    browser.script(
        "const real = fetch; globalThis.fetch = async (url, options) => { const found = await real(url, options); \
         if (String(url).includes('/paths/')) { globalThis.fetch = real; await new Promise(go => { window.letGo = go; }); } return found; }",
    );
    browser.choose("#named", "round");
    browser.wait_for("the path", PATIENCE, "return Boolean(window.letGo)");
    browser.script(
        "viewer.recorder.add(); letGo(); fetch('/v1/limits').then(found => found.json()).then(() => { window.isLater = true; })",
    );
    browser.wait_for("a later answer", PATIENCE, "return window.isLater");
    let recorded = browser.script("return viewer.recorder.name");
    assert_eq!((recorded, browser.script(KEYS)), (json!(null), json!(3)));
    browser.click("#path-clear");
    browser.choose("#named", "round");
    browser.wait_for(
        "the scene's keys",
        PATIENCE,
        "return document.querySelectorAll('#keys tbody tr').length === 3",
    );
    still_picture(&browser);
    assert_eq!(browser.script("return viewer.pose.eye"), json!([0, 1, 5]));
    film_plays_in_an_image(&browser);
    let shown = browser.script("return document.getElementById('film').checkVisibility()");
    assert_eq!(shown, false, "a daemon without jobs offers none");
    assert_eq!(browser.console_errors(), Vec::<String>::new());
}

/// An `<img>` of the page shows the film of the scene's path.
fn film_plays_in_an_image(browser: &Browser) {
    let film = browser.text("return document.getElementById('mjpeg').getAttribute('href')");
    assert!(film.contains("path=round") && film.contains("loop=true"), "{film}");
    browser.script(&format!(
        "window.film = new Image(); film.src = '{}'; document.body.append(film); \
         window.seen = new Set(); const c = document.createElement('canvas'); c.width = 96; c.height = 54; \
         window.watching = setInterval(() => {{ if (!film.naturalWidth) return; \
           c.getContext('2d').drawImage(film, 0, 0, 96, 54); seen.add(c.toDataURL()); }}, 30)",
        film.replace("w=960&h=540", "w=192&h=108")
    ));
    browser.wait_for("an image that changes", PATIENCE, "return seen.size >= 4");
    assert_eq!(browser.script("return film.naturalWidth"), 192);
    browser.script("clearInterval(watching); film.remove(); film.src = ''");
    // A view without a path is a film of one picture, which is shown although no other follows.
    browser.script(
        "window.view = new Image(); view.src = '/v1/scenes/ball/mjpeg?camera=front&w=64&h=48'",
    );
    browser.wait_for("the view", PATIENCE, "return view.naturalWidth === 64");
    browser.script("view.src = ''");
}

fn path_document() -> impl Strategy<Value = Value> {
    let coordinate = || (-300i32..300).prop_map(|v| f64::from(v) / 10.0);
    let place = move || prop::array::uniform3(coordinate());
    let ease = prop::sample::select(&["smooth", "linear", "in", "out", "in_out", "hold"][..]);
    let key = (0.05..3.0f64, place(), place(), 20.0..90.0f64, ease, 0u8..5, 0u8..4);
    (prop::collection::vec(key, 1..7), prop::bool::ANY).prop_map(|(keys, is_linear)| {
        let mut t = -1.0;
        let mut last = [0.0, 0.0, 9.0];
        let keys: Vec<Value> = keys
            .into_iter()
            .map(|(after, eye, offset, fov, ease, pause, plain)| {
                t += after;
                // Some keys repeat the previous position. The target never coincides with the eye.
                last = if pause == 0 { last } else { eye };
                let target =
                    [0, 1, 2].map(|i| last[i] + offset[i] + if i == 0 { 31.0 } else { 0.0 });
                let mut key = json!({ "t": t, "eye": last, "target": target, "ease": ease });
                if plain > 0 {
                    key["fov"] = fov.into();
                    key["up"] = json!([0.1, 0.2, 1.0]);
                }
                key
            })
            .collect();
        let interpolation = if is_linear { "linear" } else { "catmull_rom" };
        json!({ "interpolation": interpolation, "keys": keys })
    })
}

#[test]
fn the_curve_is_the_daemons() {
    let Some(driver) = driver_or_skip() else { return };
    let (_daemon, browser) = opened(&driver);
    let seed = TestRng::from_seed(RngAlgorithm::ChaCha, &[7; 32]);
    let mut runner = TestRunner::new_with_rng(Config::default(), seed);
    let paths: Vec<Value> =
        (0..60).map(|_| path_document().new_tree(&mut runner).expect("a path").current()).collect();
    // Sample before, between and after the keys, but not at them, where rounding decides which side of a cut is shown.
    let shares: Vec<f64> = (-1..=40).map(|i| (f64::from(i) + 0.5) / 40.0).collect();
    let found = browser.script(&format!(
        "return {}.map(path => {{ const at = viewer.sampler({{ ...path, keys: path.keys.map(k => ({{ up: [0, 1, 0], ...k }})) }}); \
         const first = path.keys[0].t, last = path.keys[path.keys.length - 1].t; \
         return {}.map(share => {{ const p = at(first + (last - first) * share); return [p.eye, p.target, p.up, p.fov]; }}); }})",
        json!(paths),
        json!(shares)
    ));
    let vector =
        |value: &Value| DVec3::from_array([0, 1, 2].map(|i| value[i].as_f64().expect("a number")));
    for (index, document) in paths.iter().enumerate() {
        let path = parse_path(&document.to_string(), "p", DVec3::Y).expect("a path");
        let sampler = path.sampler().expect("it can be followed");
        let (first, last) = (path.keys[0].t, path.keys[path.keys.len() - 1].t);
        for (step, share) in shares.iter().enumerate() {
            let expected = sampler.at(first + (last - first) * share);
            let pose = &found[index][step];
            for (name, found, expected) in [
                ("eye", vector(&pose[0]), expected.eye),
                ("target", vector(&pose[1]), expected.target),
                ("up", vector(&pose[2]), expected.up),
            ] {
                let error = found.distance(expected) / expected.length().max(1.0);
                assert!(
                    error < 1e-6,
                    "path {index} at {share}: {name} {found} {expected}\n{document}"
                );
            }
            let fov = pose[3].as_f64().expect("a number");
            assert!(
                (fov - expected.lens.fov_deg().unwrap()).abs() < 1e-9,
                "path {index} at {share}: {fov}"
            );
        }
    }
}
