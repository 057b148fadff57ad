//! The scene that a page opens with, names and deletion of scenes, cameras, and free views.

use serde_json::json;

use super::daemon::Daemon;
use super::page::{PATIENCE, distinct_colors, driver_or_skip, opened, shows, still_picture};
use super::webdriver::Browser;

const CAMERA: &str = "return document.getElementById('camera').selectedOptions[0].text";
const SILENT: &str = "return document.getElementById('message').hidden";

/// Uploads a scene of one point without the viewer.
fn send_dot(daemon: &Daemon, id: &str) {
    let ply = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n0 0 0\n";
    let answer = ureq::post(format!("{}/v1/scenes?id={id}&name=dot.ply", daemon.url)).send(ply);
    assert!(answer.is_ok(), "{answer:?}");
}

#[test]
fn a_view_that_left_its_camera_is_free() {
    let Some(driver) = driver_or_skip() else { return };
    let (_daemon, browser) = opened(&driver);
    let first = still_picture(&browser);
    assert_eq!(browser.text(CAMERA), "front");
    browser.drag("mouse", 0, &[(400, 400), (470, 410), (600, 430)]);
    assert_ne!(still_picture(&browser), first);
    assert_eq!(browser.text(CAMERA), "free view");
    browser.shoot("wide-free.png");
    browser.reload();
    still_picture(&browser);
    assert_eq!(browser.text(CAMERA), "free view");
    // Return to the camera that the view left, by the list and by the button.
    browser.choose("#camera", "front");
    assert_eq!((still_picture(&browser), browser.text(CAMERA)), (first.clone(), "front".into()));
    browser.wheel((400, 400), -240);
    still_picture(&browser);
    assert_eq!(browser.text(CAMERA), "free view");
    browser.click("#back");
    assert_eq!((still_picture(&browser), browser.text(CAMERA)), (first, "front".into()));
    browser.choose("#camera", "");
    still_picture(&browser);
    assert_eq!(browser.text(CAMERA), "whole scene");
    browser.wheel((400, 400), -240);
    still_picture(&browser);
    assert_eq!(browser.text(CAMERA), "free view");
    assert_eq!(browser.console_errors(), Vec::<String>::new());
}

#[test]
fn scenes_far_off_stay_in_sight() {
    let Some(driver) = driver_or_skip() else { return };
    let (_daemon, browser) = opened(&driver);
    browser.script(
        "for (let i = 0; i < 200; i++) viewer.canvas.dispatchEvent(new WheelEvent('wheel', { deltaY: 200, cancelable: true }))",
    );
    still_picture(&browser);
    assert!(distinct_colors(&browser) > 2, "something is there");
    browser.shoot("wide-far.png");
    let far = browser.number("return Math.hypot(...viewer.pose.eye)");
    assert!(far > 100.0, "and is far off: {far}");
    let lost = || browser.script("return document.getElementById('lost').checkVisibility()");
    assert_eq!(lost(), true, "what leads back is pointed at");
    browser.click("#back");
    still_picture(&browser);
    assert_eq!(lost(), false);
    // A box beside the view, behind it, and half in it.
    for (pose, is_lost) in [
        ("40, 0, 5], [40, 0, 0", true),
        ("0, 0, -5], [0, 0, -9", true),
        ("2, 0, 5], [2, 0, 0", false),
        ("0, 0, 0], [0, 0, -1", false),
    ] {
        browser.script(&format!("const [eye, target] = [[{pose}]]; viewer.controls.view.move({{ ...viewer.pose, eye, target }}, false)"));
        assert_eq!(lost(), is_lost, "{pose}");
    }
}

#[test]
fn the_first_picture_is_asked_for_at_rest() {
    let Some(driver) = driver_or_skip() else { return };
    let daemon = Daemon::start();
    let browser = Browser::start(&driver, 1280, 800);
    browser.before_pages(
        "window.sent = []; const send = WebSocket.prototype.send; \
         WebSocket.prototype.send = function (text) { sent.push(JSON.parse(text)); return send.call(this, text); }",
    );
    browser.open(&daemon.url);
    still_picture(&browser);
    let poses = browser.script("return sent.filter(m => m.seq).map(m => m.moving)");
    assert!(poses.as_array().is_some_and(|poses| !poses.is_empty()), "{poses}");
    assert!(poses.as_array().unwrap().iter().all(|moving| moving == false), "{poses}");
    assert_eq!(
        browser.text("return viewer.canvas.dataset.frames"),
        "1",
        "no lesser frame came first"
    );
}

#[test]
fn the_page_opens_with_what_was_seen_last() {
    let Some(driver) = driver_or_skip() else { return };
    let (daemon, browser) = opened(&driver);
    send_dot(&daemon, "aaa");
    // A browser without stored data opens the first scene.
    let other = Browser::start(&driver, 1280, 800);
    other.open(&daemon.url);
    shows(&other, "ball");
    drop(other);
    browser.script("document.getElementById('scenes').open = true");
    browser.wait_for(
        "it in the list",
        PATIENCE,
        "return document.querySelector('[data-scene=aaa]')",
    );
    browser.click("[data-scene=aaa]");
    shows(&browser, "aaa");
    browser.open("about:blank");
    browser.open(&daemon.url);
    shows(&browser, "aaa");
    assert_eq!(browser.script(SILENT), true);
}

#[test]
fn scenes_of_one_name_are_told_apart_and_deleted() {
    let Some(driver) = driver_or_skip() else { return };
    let (daemon, browser) = opened(&driver);
    for id in ["one", "two"] {
        send_dot(&daemon, id);
    }
    browser.reload();
    shows(&browser, "ball");
    let names =
        browser.script("return [...document.getElementById('scene').options].map(o => o.text)");
    assert_eq!(names, json!(["Ball", "dot (one)", "dot (two)"]));
    browser.script("document.getElementById('scenes').open = true");
    browser.click("[data-scene=two]");
    shows(&browser, "two");
    browser.click("[data-remove=two]");
    let asked = browser.text("return document.querySelector('.question').textContent");
    assert!(asked.contains("dot (two)") && asked.contains("gone for good"), "{asked}");
    browser.script("document.querySelector('.question').scrollIntoView({ block: 'center' })");
    browser.shoot("wide-delete.png");
    browser.click("[data-keep=two]");
    assert_eq!(browser.script("return document.querySelector('.question')"), json!(null));
    browser.click("[data-remove=two]");
    browser.click("[data-delete=two]");
    shows(&browser, "ball");
    let names =
        browser.script("return [...document.getElementById('scene').options].map(o => o.text)");
    assert_eq!(names, json!(["Ball", "dot"]));
    assert_eq!(browser.script(SILENT), true, "who deleted it need not be told");
    assert!(!daemon.has_upload("two") && daemon.has_upload("one"), "its files are gone");
    // A deletion by another page is reported with the scene's name.
    browser.click("[data-scene=one]");
    shows(&browser, "one");
    let answer = ureq::delete(format!("{}/v1/scenes/one", daemon.url)).call();
    assert!(answer.is_ok(), "{answer:?}");
    let message = browser.message("The scene dot (one) was deleted");
    assert!(!message.contains("There is no scene"), "{message}");
    browser.choose("#scene", "ball");
    shows(&browser, "ball");
    assert_eq!(browser.script(SILENT), true, "it is over with another scene");
}
