//! A phone's screen and touch input.

use super::daemon::Daemon;
use super::page::{driver_or_skip, still_picture};
use super::webdriver::Browser;

fn eye_distance(browser: &Browser) -> f64 {
    browser.number("const { eye, target } = viewer.pose; return Math.hypot(...eye.map((v, i) => v - target[i]))")
}

/// Asserts that nothing is wider than the screen, and that no control is cut off at its side.
pub fn nothing_overflows(browser: &Browser) {
    let wide = browser.script(
        "const all = [...document.querySelectorAll('body *')].filter(e => e.checkVisibility() && !e.closest('.unseen')); \
         return all.filter(e => e.getBoundingClientRect().right > innerWidth + 1).map(e => e.outerHTML.slice(0, 90))",
    );
    assert_eq!(wide, serde_json::json!([]), "wider than the screen");
    assert!(browser.number("return document.documentElement.scrollWidth - innerWidth") <= 0.0);
}

#[test]
fn fits_a_phone_and_follows_fingers() {
    let Some(driver) = driver_or_skip() else { return };
    let daemon = Daemon::start();
    let browser = Browser::start(&driver, 800, 900);
    browser.emulate(390, 844, 2.0);
    browser.open(&daemon.url);

    let first = still_picture(&browser);
    nothing_overflows(&browser);
    let width = browser.script("return viewer.canvas.width");
    assert_eq!(width, 780, "as wide as the screen, in its own pixels");
    browser.shoot("phone.png");

    browser.drag("touch", 0, &[(150, 300), (190, 310), (260, 330)]);
    let orbited = still_picture(&browser);
    assert_ne!(orbited, first, "one finger orbits");
    let before = eye_distance(&browser);
    browser.pinch((195, 320), 40, 120);
    assert_ne!(still_picture(&browser), orbited, "two fingers zoom");
    assert!(eye_distance(&browser) < 0.6 * before, "spreading them brings the eye nearer");

    // While flying, the same gestures look around and move forward, and the pad's buttons can be held.
    browser.click("#fly");
    let pose = browser.script("return viewer.pose");
    browser.drag("touch", 0, &[(150, 300), (190, 310), (260, 330)]);
    still_picture(&browser);
    let looked = browser.script("return viewer.pose");
    assert_eq!(looked["eye"], pose["eye"], "a finger looks about from where one is");
    assert_ne!(looked["target"], pose["target"]);
    let at = browser.script(
        "const r = document.querySelector('[data-fly=forward]').getBoundingClientRect(); return [r.x + r.width / 2, r.y + r.height / 2]",
    );
    let at = (at[0].as_f64().unwrap() as i64, at[1].as_f64().unwrap() as i64);
    browser.drag("touch", 0, &[at, at, at]);
    still_picture(&browser);
    assert_ne!(browser.script("return viewer.pose.eye"), looked["eye"], "the pad flies");
    nothing_overflows(&browser);
    browser.shoot("phone-fly.png");
    browser.click("#fly");

    // The picture has the height of the screen. The panel opens over it, and touching the picture closes it.
    let share = "return viewer.canvas.clientHeight / innerHeight";
    assert!(browser.number(share) > 0.75, "{}", browser.number(share));
    let panel = "return document.getElementById('side').checkVisibility()";
    assert_eq!(browser.script(panel), false);
    browser.click("#sheet");
    assert_eq!(browser.script(panel), true);
    still_picture(&browser);
    nothing_overflows(&browser);
    browser.shoot("phone-sheet.png");
    browser.drag("touch", 0, &[(150, 200), (150, 200)]);
    assert_eq!(browser.script(panel), false);
    browser.click("#sheet");

    // Unfold everything, with a path of two keys.
    browser.script("for (const d of document.querySelectorAll('details')) d.open = true");
    browser.click("#key-add");
    browser.click("[data-fly=right]");
    browser.click("#key-add");
    still_picture(&browser);
    nothing_overflows(&browser);
    browser.script("document.getElementById('paths').scrollIntoView()");
    browser.shoot("phone-path.png");
    browser.script("document.getElementById('side').scrollTo(0, 1e6)");
    browser.shoot("phone-below.png");
    assert_eq!(browser.console_errors(), Vec::<String>::new());
}

/// The state of the connection and the chosen scene are readable at any width.
#[test]
fn the_bar_fits_every_width() {
    let Some(driver) = driver_or_skip() else { return };
    let daemon = Daemon::start();
    let browser = Browser::start(&driver, 800, 900);
    browser.emulate(390, 844, 1.0);
    browser.open(&daemon.url);
    still_picture(&browser);
    let words = browser.text("return document.getElementById('link-state').textContent");
    assert_eq!(words, "streaming");
    for width in [320, 360, 375, 390, 412, 430, 480, 600, 700, 760, 1024] {
        browser.emulate(width, 844, 1.0);
        let state = browser.script(
            "const e = document.getElementById('link-state'), r = document.createRange(); r.selectNodeContents(e); \
             const text = r.getBoundingClientRect(), box = e.getBoundingClientRect(); \
             return { cut: e.scrollWidth - e.clientWidth, text: text.width, inside: box.left <= text.left && text.right <= box.right + 0.5, \
             lines: r.getClientRects().length }",
        );
        assert!(state["text"].as_f64().unwrap() > 40.0, "{width}: {state}");
        assert_eq!(
            (&state["cut"], &state["inside"], &state["lines"]),
            (&0.into(), &true.into(), &1.into()),
            "{width}"
        );
        let choices = browser.script(
            "return ['scene', 'camera'].map(id => document.getElementById(id).getBoundingClientRect().width)",
        );
        let of = |i: usize| choices[i].as_f64().unwrap();
        if width < 736 {
            assert!(of(0) > 130.0 && (of(0) - of(1)).abs() < 30.0, "{width}: {choices}");
        }
        nothing_overflows(&browser);
    }
    browser.emulate(320, 640, 2.0);
    still_picture(&browser);
    browser.shoot("phone-320.png");
    browser.emulate(600, 844, 1.0);
    still_picture(&browser);
    browser.shoot("phone-600.png");
}

#[test]
fn a_narrow_old_phone_still_has_everything() {
    let Some(driver) = driver_or_skip() else { return };
    let daemon = Daemon::start();
    let browser = Browser::start(&driver, 800, 900);
    browser.emulate(320, 568, 2.0);
    browser.emulate_media("prefers-reduced-motion", "reduce");
    browser.open(&daemon.url);
    still_picture(&browser);
    browser.click("#sheet");
    browser.script("for (const d of document.querySelectorAll('details')) d.open = true");
    browser.click("#key-add");
    browser.click("#fly");
    nothing_overflows(&browser);
    browser.shoot("phone-narrow.png");
    let moves = browser.script(
        "return [...document.querySelectorAll('body *')].filter(e => parseFloat(getComputedStyle(e).transitionDuration) > 0 \
         || getComputedStyle(e).animationName !== 'none').length",
    );
    assert_eq!(moves, 0, "who wants less motion has none beside the picture's");
}
