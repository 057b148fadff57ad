//! The stream's connection: a daemon that restarts, a scene that is edited or deleted, and a page without WebSocket.

use super::daemon::Daemon;
use super::page::{PATIENCE, driver_or_skip, keys, opened, still_picture};
use super::webdriver::Browser;

#[test]
fn goes_on_where_it_was_after_a_restart() {
    let Some(driver) = driver_or_skip() else { return };
    let (mut daemon, browser) = opened(&driver);
    browser.drag("mouse", 0, &[(400, 400), (470, 410), (600, 430)]);
    let before = still_picture(&browser);
    let pose = browser.script("return viewer.pose");

    daemon.kill();
    browser.link("waiting");
    let message = browser.message("Not connected");
    assert!(message.contains("Trying again"), "{message}");
    browser.shoot("wide-waiting.png");
    daemon.start_again();
    browser.link("stream");
    assert_eq!(still_picture(&browser), before);
    assert_eq!(browser.script("return viewer.pose"), pose, "the view stayed where it was");
    let quiet = browser.script("return document.getElementById('message').hidden");
    assert!(quiet.as_bool().unwrap(), "the message is gone with its cause");
    // A change made while the daemon is down is shown when it is back.
    daemon.kill();
    browser.link("waiting");
    browser.script("viewer.canvas.focus()");
    browser.key(keys::RIGHT);
    daemon.start_again();
    assert_ne!(still_picture(&browser), before);
}

#[test]
fn edits_are_told_and_deleted_scenes_may_come_back() {
    let Some(driver) = driver_or_skip() else { return };
    let (daemon, browser) = opened(&driver);
    let before = still_picture(&browser);
    daemon.move_ball(0.7);
    let message = browser.message("The scene was changed");
    assert!(message.contains("revision 2"), "{message}");
    browser.wait_for(
        "a frame of the new revision",
        PATIENCE,
        "return viewer.isStill && viewer.canvas.dataset.revision === '2'",
    );
    assert_ne!(still_picture(&browser), before);
    let facts = browser.wait_for(
        "the scene's new revision",
        PATIENCE,
        "const t = document.getElementById('about').innerText; return /revision\\s+2/.test(t) ? t : ''",
    );
    assert!(facts.as_str().unwrap().contains("samples"), "{facts}");

    let moved = browser.script("return viewer.pose");
    daemon.remove_scene();
    browser.message("deleted");
    browser.link("gone");
    let ply = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n0 0 0\n";
    let again = ureq::post(format!("{}/v1/scenes?id=ball&name=dot.ply", daemon.url)).send(ply);
    assert!(again.is_ok(), "{again:?}");
    browser.link("stream");
    still_picture(&browser);
    assert_eq!(browser.script("return viewer.pose"), moved, "the view stayed where it was");
}

/// A page whose WebSockets are refused, as by some proxies.
#[test]
fn frames_come_by_requests_where_there_is_no_stream() {
    let Some(driver) = driver_or_skip() else { return };
    let daemon = Daemon::start();
    let browser = Browser::start(&driver, 1280, 800);
    browser.open(&daemon.url);
    let streamed = still_picture(&browser);
    browser.before_pages(
        "const Real = WebSocket; \
         globalThis.WebSocket = class { static OPEN = 1; constructor() { this.readyState = 3; setTimeout(() => this.onclose({ code: 1006, reason: '' })); } close() {} }; \
         globalThis.RealSocket = Real;",
    );
    browser.open("about:blank");
    browser.open(&daemon.url);
    browser.link("requests");
    let first = still_picture(&browser);
    assert_eq!(first, streamed, "the same pixels either way");
    browser.script(
        "window.states = []; new MutationObserver(() => states.push(document.getElementById('status').textContent))\
         .observe(document.getElementById('status'), { childList: true })",
    );
    browser.drag("mouse", 0, &[(400, 400), (430, 405), (470, 410), (540, 420), (600, 430)]);
    assert_ne!(still_picture(&browser), first);
    let states = browser.text("return states.join('\\n')");
    assert!(states.contains("moving") && states.contains("still, refined"), "{states}");
    // A pose that comes while the frame of the one before is decoded is drawn as well.
    browser.script(
        "window.decode = createImageBitmap; \
         globalThis.createImageBitmap = async image => { const made = await decode(image); await new Promise(go => { window.letGo = go; }); return made; }; \
         viewer.link.show(false)",
    );
    browser.wait_for("a frame that is decoded", PATIENCE, "return Boolean(window.letGo)");
    browser.script("viewer.canvas.dataset.state = 'waiting'; viewer.link.show(false)");
    browser.wait_for("the next pose", PATIENCE, "return !viewer.link.isDue");
    browser.script("globalThis.createImageBitmap = decode; letGo()");
    still_picture(&browser);
    // Once WebSockets work, the stream continues where the requests were.
    let requested = still_picture(&browser);
    browser.script("globalThis.WebSocket = RealSocket; viewer.link.connect()");
    browser.link("stream");
    assert_eq!(still_picture(&browser), requested);
    assert_eq!(browser.console_errors(), Vec::<String>::new());
}
