//! Accuracy and its price: the curve of a measurement, the settings of its points, and the wipe between two frames.

use std::time::{Duration, Instant};

use serde_json::json;

use super::daemon::Daemon;
use super::page::{PATIENCE, driver_or_skip, keys, opened, still_picture};
use super::phone::nothing_overflows;
use super::webdriver::Browser;

const IS_DONE: &str = "return viewer.accuracy.known?.state === 'done' && document.querySelectorAll('#curve .dot').length";
const IS_OPEN: &str = "return document.getElementById('wipe').checkVisibility() && document.getElementById('wipe-a').naturalWidth";

/// Measures the scene by its daemon, quickly and small.
fn measured(daemon: &Daemon) {
    let body = json!({ "w": 48, "h": 36, "repeats": 1 });
    let begin =
        || ureq::post(format!("{}/v1/scenes/ball/accuracy", daemon.url)).send_json(&body).is_ok();
    // A cancelled measurement ends with the frame at hand.
    let until = Instant::now() + PATIENCE;
    while !begin() {
        assert!(Instant::now() < until, "no measurement begins");
        std::thread::sleep(Duration::from_millis(100));
    }
}

/// Opens the panel and waits for the curve.
fn curve(browser: &Browser) {
    browser.script("document.getElementById('accuracy').open = true; document.getElementById('accuracy').scrollIntoView()");
    browser.wait_for("the curve", 4 * PATIENCE, IS_DONE);
}

#[test]
fn a_point_of_the_curve_draws_the_view() {
    let Some(driver) = driver_or_skip() else { return };
    let (daemon, browser) = opened(&driver);
    let text =
        |id: &str| browser.text(&format!("return document.getElementById('{id}').textContent"));
    browser.script("document.getElementById('accuracy').open = true");
    browser.wait_for(
        "the state",
        PATIENCE,
        "return document.getElementById('accuracy-said').textContent.startsWith('Not measured')",
    );
    // The button measures the scene, and the progress is shown until it is cancelled.
    browser.choose("#accuracy-extent", "whole");
    browser.click("#accuracy-start");
    browser.wait_for(
        "the progress",
        PATIENCE,
        "return document.getElementById('accuracy-said').textContent.startsWith('Step ')",
    );
    assert_eq!(
        browser.script("return document.getElementById('accuracy-progress').checkVisibility()"),
        true
    );
    // A question that gets no answer is asked again.
    browser.script(
        "const real = fetch; window.asked = 0; globalThis.fetch = (url, options) => \
         !String(url).endsWith('/accuracy') || asked++ > 0 ? real(url, options) : Promise.reject(new TypeError('no network'))",
    );
    browser.wait_for("another question", PATIENCE, "return asked > 1");
    browser.click("#accuracy-cancel");
    browser.wait_for(
        "the end",
        PATIENCE,
        "return document.getElementById('accuracy-said').textContent.includes('cancelled')",
    );

    measured(&daemon);
    browser.script("document.getElementById('accuracy').open = false");
    browser.script("return new Promise(done => setTimeout(done, 50))");
    curve(&browser);
    let before = still_picture(&browser);
    browser.shoot("wide-accuracy.png");
    assert!(
        text("accuracy-summary").contains("Measured at 48 × 36"),
        "{}",
        text("accuracy-summary")
    );
    assert!(text("accuracy-here").starts_with("Line: this view"), "{}", text("accuracy-here"));

    // A click on a point draws the view with its settings, and the address has them.
    let dot = |row: &str| format!("document.querySelector('#curve [data-row=\"{row}\"]')");
    browser.script(&format!(
        "{}.dispatchEvent(new MouseEvent('click', {{ bubbles: true }}))",
        dot("points full antialias=4x")
    ));
    let drawn = |expected: &str| {
        browser.wait_for(expected, PATIENCE, &format!("return viewer.isStill && viewer.accuracy.receipt?.settings.antialias === '{expected}'"));
    };
    drawn("4x");
    let value = |id: &str| browser.text(&format!("return document.getElementById('{id}').value"));
    assert_eq!((value("reconstruct"), value("antialias")), ("points".to_owned(), "4x".to_owned()));
    assert_ne!(still_picture(&browser), before);
    assert!(browser.text("return location.hash").contains("antialias=4x"));
    assert!(
        text("accuracy-here").contains("drawn as points full antialias=4x"),
        "{}",
        text("accuracy-here")
    );
    assert!(text("accuracy-row-said").contains("dB") || text("accuracy-row-said").contains("PSNR"));

    // So does a key on a point, and the point keeps the focus.
    browser.script(&format!("{}.focus()", dot("splats full")));
    browser.key(keys::ENTER);
    drawn("off");
    assert_eq!((value("reconstruct"), value("antialias")), ("splats".to_owned(), "off".to_owned()));
    assert_eq!(browser.text("return document.activeElement.dataset.row"), "splats full");

    // An edit of the scene makes the results stale.
    daemon.move_ball(0.2);
    browser.wait_for(
        "the note",
        PATIENCE,
        "return document.getElementById('accuracy-said').textContent.includes('has changed since')",
    );
    assert_eq!(browser.console_errors(), Vec::<String>::new());
}

#[test]
fn a_wipe_shows_two_frames_of_the_view() {
    let Some(driver) = driver_or_skip() else { return };
    let daemon = Daemon::start();
    let browser = Browser::start(&driver, 800, 900);
    browser.emulate(390, 844, 1.0);
    browser.open(&daemon.url);
    still_picture(&browser);
    browser.choose("#reconstruct", "points");
    still_picture(&browser);
    // Without a measurement, the view is compared with the reference or with the defaults.
    browser.click("#sheet");
    browser.script("document.getElementById('accuracy').open = true; document.getElementById('accuracy').scrollIntoView()");
    nothing_overflows(&browser);
    browser.shoot("phone-accuracy.png");
    browser.click("#wipe-start");
    browser.wait_for("the wipe", 2 * PATIENCE, IS_OPEN);
    nothing_overflows(&browser);
    browser.shoot("phone-wipe.png");
    let shape = browser.script(
        "const i = document.getElementById('wipe-a'), c = viewer.canvas; return Math.abs(i.naturalWidth / i.naturalHeight / (c.width / c.height) - 1) < 0.02",
    );
    assert_eq!(shape, true, "the frames have the picture's shape");
    let figures = browser.text("return document.getElementById('wipe-figures').textContent");
    assert!(figures.starts_with("PSNR ") && figures.contains("hole"), "{figures}");
    assert!(
        browser
            .text("return document.getElementById('wipe-right').textContent")
            .starts_with("the reference")
    );

    // A finger and the keyboard move the edge.
    let edge = "return parseFloat(document.getElementById('wipe-edge').style.left)";
    assert_eq!(browser.number(edge), 50.0);
    browser.key(keys::RIGHT);
    assert!((browser.number(edge) - 52.0).abs() < 0.01);
    browser.drag("touch", 0, &[(100, 300), (150, 300), (195, 300)]);
    assert!((browser.number(edge) - 50.0).abs() < 1.0, "{}", browser.number(edge));
    let clip = browser.text("return document.getElementById('wipe-a').style.clipPath");
    assert!(clip.starts_with("inset(0"), "{clip}");
    browser.click("#wipe-map");
    assert_eq!(
        browser.script("return document.getElementById('wipe-difference').checkVisibility()"),
        true
    );
    browser.shoot("phone-wipe-map.png");
    // Escape closes it, and so does a view that moves.
    browser.script("document.getElementById('wipe-share').disabled = false; document.getElementById('wipe-close').focus()");
    browser.key('\u{e00c}');
    assert_eq!(browser.script("return viewer.accuracy.wipe.isOpen"), false);
    browser.choose("#wipe-with", "\\0defaults");
    browser.click("#wipe-start");
    browser.wait_for("the wipe", PATIENCE, IS_OPEN);
    browser.script("document.getElementById('fit').click()");
    assert_eq!(browser.script("return viewer.accuracy.wipe.isOpen"), false);
    assert_eq!(browser.console_errors(), Vec::<String>::new());
}
