//! The viewer page in a real browser: headless Chromium, driven over WebDriver, against the real daemon.
//!
//! Without `chromedriver` the tests say so and pass; with `POINTILLIST_BROWSER=required`, as `make test`
//! sets it once it has found or installed one, they fail instead. Screenshots go to `target/browser/`.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "helpers of tests: a panic is how a test fails"
)]

mod daemon;
mod webdriver;

use std::path::PathBuf;
use std::time::Duration;

use daemon::Daemon;
use webdriver::Browser;

/// Starting a software driver and a first frame on a busy machine.
const PATIENCE: Duration = Duration::from_secs(60);

fn driver_or_skip() -> Option<String> {
    let driver = webdriver::find_driver();
    if driver.is_none() {
        let required = std::env::var("POINTILLIST_BROWSER").is_ok_and(|value| value == "required");
        assert!(!required, "no chromedriver, and POINTILLIST_BROWSER=required");
        eprintln!("!! SKIPPED: no chromedriver; scripts/setup-browser.sh installs one");
    }
    driver
}

fn screenshot_path(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("target/browser").join(name)
}

/// Waits for a full frame that shows the pose asked for last, and returns the canvas as a data URL.
fn still_picture(browser: &Browser) -> String {
    browser.wait_for(
        "a full frame at rest",
        PATIENCE,
        "return canvas.dataset.state === 'still' && shownVersion === poseVersion && !inFlight",
    );
    let picture = browser.script("return canvas.toDataURL()");
    picture.as_str().expect("a data URL").to_owned()
}

/// Number of different colours among a sample of the canvas' pixels.
fn distinct_colors(browser: &Browser) -> u64 {
    let count = browser.script(
        "const d = new Uint32Array(paper.getImageData(0, 0, canvas.width, canvas.height).data.buffer); \
         return new Set(d.filter((_, i) => i % 7 === 0)).size",
    );
    count.as_u64().expect("a number")
}

fn text(browser: &Browser, script: &str) -> String {
    browser.script(script).as_str().unwrap_or_default().to_owned()
}

#[test]
fn orbit_with_the_mouse() {
    let Some(driver) = driver_or_skip() else { return };
    let daemon = Daemon::start();
    let browser = Browser::start(&driver, 1280, 800);
    browser.open(&daemon.url);

    let first = still_picture(&browser);
    assert!(distinct_colors(&browser) > 50, "the first frame shows a coloured ball");
    browser.screenshot(&screenshot_path("wide.png"));
    passes_are_explained(&browser);
    let size = text(&browser, "return canvas.width + 'x' + canvas.height");
    let expected = text(
        &browser,
        "return Math.round(canvas.clientWidth * devicePixelRatio) + 'x' + Math.round(canvas.clientHeight * devicePixelRatio)",
    );
    assert_eq!(size, expected, "a frame at rest has the canvas' own pixels");

    // The page itself notes each state, so that a state which passes quickly is not missed.
    browser.script(
        "window.states = []; new MutationObserver(() => states.push(canvas.dataset.state + ' ' + \
         document.getElementById('status').textContent)).observe(canvas, { attributes: true })",
    );
    browser.drag("mouse", 0, &[(400, 400), (430, 405), (470, 410), (540, 420), (600, 430)]);
    let orbited = still_picture(&browser);
    assert_ne!(orbited, first, "a drag orbits");
    let states = browser.script("return states.join('\\n')");
    let states = states.as_str().unwrap_or_default();
    assert!(states.contains("moving") && states.contains("JPEG, quality 75"), "{states}");
    assert!(
        text(&browser, "return document.getElementById('status').textContent").starts_with("still")
    );
    browser.screenshot(&screenshot_path("wide-orbited.png"));

    browser.drag("mouse", 2, &[(400, 400), (440, 400), (480, 440)]);
    let panned = still_picture(&browser);
    assert_ne!(panned, orbited, "a right drag pans");
    browser.wheel((400, 400), -240);
    let zoomed = still_picture(&browser);
    assert_ne!(zoomed, panned, "the wheel zooms");
    browser.key('\u{e012}'); // left arrow
    assert_ne!(still_picture(&browser), zoomed, "an arrow key orbits");
    browser.key('\u{e011}'); // Home
    assert_eq!(still_picture(&browser), first, "the same pose gives the same pixels");

    for output in ["normal", "depth", "id"] {
        choose(&browser, "output", output);
        assert_ne!(still_picture(&browser), first, "{output} is another picture");
        browser.screenshot(&screenshot_path(&format!("wide-{output}.png")));
    }
    assert_eq!(browser.console_errors(), Vec::<String>::new());

    daemon.remove_scene();
    browser.key('\u{e014}'); // right arrow
    let message = browser.wait_for(
        "an error that can be read",
        PATIENCE,
        "const m = document.getElementById('message'); return m.hidden ? '' : m.innerText",
    );
    assert!(message.as_str().unwrap_or_default().contains("ball"), "{message}");
    browser.screenshot(&screenshot_path("wide-error.png"));
}

/// Chooses an option as a user does.
fn choose(browser: &Browser, control: &str, value: &str) {
    browser.script(&format!(
        "const s = document.getElementById('{control}'); s.value = '{value}'; s.dispatchEvent(new Event('change'))"
    ));
}

/// Controls of splats that can be seen.
fn shown_controls(browser: &Browser) -> String {
    text(
        browser,
        "return ['reconstruct', 'filter', 'prefilter', 'blend', 'shading'].filter(name => \
         document.getElementById(name).checkVisibility()).join(' ')",
    )
}

#[test]
fn splats_are_chosen_and_remembered() {
    let Some(driver) = driver_or_skip() else { return };
    let daemon = Daemon::start();
    let browser = Browser::start(&driver, 1280, 800);
    browser.open(&daemon.url);
    still_picture(&browser);
    assert_eq!(shown_controls(&browser), "reconstruct", "points have no settings of splats");

    choose(&browser, "reconstruct", "splats");
    let splats = still_picture(&browser);
    assert_eq!(shown_controls(&browser), "reconstruct filter prefilter blend shading");
    browser.screenshot(&screenshot_path("wide-splats.png"));
    let filter = text(&browser, "return document.getElementById('filter').selectedOptions[0].text");
    assert_eq!(filter, "scene: perspective");
    let frame = text(&browser, "return document.getElementById('frame').innerText");
    assert!(frame.contains("perspective filter, prefilter on, weighted"), "{frame}");
    choose(&browser, "blend", "opaque");
    choose(&browser, "prefilter", "false");
    let opaque = still_picture(&browser);
    assert_ne!(opaque, splats, "opaque splats are another picture");
    let shown = shown_controls(&browser);
    assert_eq!(shown, "reconstruct filter prefilter blend", "opaque splats are lit in one way");

    let address = text(&browser, "return location.href");
    for setting in ["reconstruct=splats", "blend=opaque", "prefilter=false"] {
        assert!(address.contains(setting), "{address}");
    }
    assert!(!address.contains("filter=perspective"), "what was not chosen is not kept: {address}");
    browser.open("about:blank");
    browser.open(&address);
    assert_eq!(still_picture(&browser), opaque, "the address shows the same picture");
    choose(&browser, "reconstruct", "fuzzy");
    assert_eq!(
        shown_controls(&browser),
        "reconstruct filter prefilter",
        "blended and lit in one way"
    );
    choose(&browser, "reconstruct", "points");
    still_picture(&browser);
    assert_eq!(shown_controls(&browser), "reconstruct");
    assert_eq!(browser.console_errors(), Vec::<String>::new());
}

/// Every step has a time or a reason, and they add up to the total.
fn passes_are_explained(browser: &Browser) {
    let rows = browser.script(
        "return [...document.querySelectorAll('#passes tr[data-step]')].map(r => \
         [r.dataset.step, r.cells[1].textContent, r.querySelector('small')?.textContent ?? '', r.dataset.pass ? 'pass' : 'host'])",
    );
    let rows = rows.as_array().expect("rows");
    let cell = |row: &serde_json::Value, i: usize| row[i].as_str().unwrap_or_default().to_owned();
    let ran = |row: &&serde_json::Value| cell(row, 3) == "pass" && cell(row, 1) != "skipped";
    assert!(rows.iter().filter(ran).count() >= 2, "passes that ran: {rows:?}");
    for row in rows {
        match cell(row, 1).as_str() {
            "skipped" => assert!(cell(row, 2).len() > 3, "a skipped pass says why: {row}"),
            "–" => {} // this adapter has no timestamps
            time => assert!(time.parse::<f64>().is_ok(), "{row}"),
        }
    }
    for step in ["queue", "readback", "encode"] {
        assert!(rows.iter().any(|row| cell(row, 0) == step), "{step} is listed: {rows:?}");
    }
    let legend = text(browser, "return document.getElementById('explained').textContent");
    assert!(legend.contains('%'), "{legend}");
}

#[test]
fn fits_a_phone_and_follows_fingers() {
    let Some(driver) = driver_or_skip() else { return };
    let daemon = Daemon::start();
    let browser = Browser::start(&driver, 800, 900);
    browser.emulate(390, 844, 2.0);
    browser.open(&daemon.url);

    let first = still_picture(&browser);
    let overflow = browser.script("return document.documentElement.scrollWidth - innerWidth");
    assert!(
        overflow.as_f64().unwrap_or(1.0) <= 0.0,
        "nothing is wider than the screen: {overflow}"
    );
    assert_eq!(
        browser.script("return canvas.width"),
        780,
        "as wide as the screen, in its own pixels"
    );
    browser.screenshot(&screenshot_path("phone.png"));

    browser.drag("touch", 0, &[(150, 300), (190, 310), (260, 330)]);
    let orbited = still_picture(&browser);
    assert_ne!(orbited, first, "one finger orbits");
    let before = eye_distance(&browser);
    browser.pinch((195, 320), 40, 120);
    assert_ne!(still_picture(&browser), orbited, "two fingers zoom");
    assert!(eye_distance(&browser) < 0.6 * before, "spreading them brings the eye nearer");
    browser.script("scrollTo(0, 1e6)");
    browser.screenshot(&screenshot_path("phone-below.png"));
    assert_eq!(browser.console_errors(), Vec::<String>::new());
}

fn eye_distance(browser: &Browser) -> f64 {
    browser.script("return norm(sub(pose.eye, pose.target))").as_f64().expect("a distance")
}
