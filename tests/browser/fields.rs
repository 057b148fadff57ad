//! Invalid input is reported at its field until it is corrected.

use serde_json::json;

use super::page::{PATIENCE, driver_or_skip, opened, still_picture};
use super::webdriver::Browser;

/// The message of a field about its input.
fn fault(browser: &Browser, id: &str) -> String {
    let text = format!(
        "return document.getElementById('{id}-fault')?.checkVisibility() ? document.getElementById('{id}-fault').textContent : ''"
    );
    browser.text(&text)
}

#[test]
fn fields_say_what_they_take() {
    let Some(driver) = driver_or_skip() else { return };
    let (_daemon, browser) = opened(&driver);
    browser.script("document.getElementById('paths').open = true");
    for bad in ["900", "0", ""] {
        browser.choose("#fov", bad);
        assert_eq!(fault(&browser, "fov"), "1 to 170 degrees; the view keeps 40", "{bad}");
        assert_eq!(browser.script("return viewer.pose.fov"), 40);
    }
    browser.shoot("wide-fault.png");
    browser.choose("#fov", "50");
    assert_eq!(fault(&browser, "fov"), "");
    assert_eq!(
        browser.text("return document.getElementById('fov').getAttribute('aria-invalid')"),
        "false"
    );

    browser.choose("#fps", "0");
    assert_eq!(fault(&browser, "fps"), "1 to 120; the path keeps 30");
    browser.choose("#fps", "25");
    assert_eq!(fault(&browser, "fps"), "");
    assert_eq!(browser.script("return viewer.recorder.path.fps"), 25);

    browser.click("#key-add");
    browser.drag("mouse", 0, &[(400, 400), (470, 410), (600, 430)]);
    still_picture(&browser);
    browser.click("#key-add");
    let second = "#keys tbody tr:nth-child(2) input";
    let times = || browser.script("return viewer.recorder.path.keys.map(key => key.t)");
    for (bad, why) in [
        ("1e9", "a path lasts 8,000 s at most"),
        ("0", "another key is at 0 s already"),
        ("", "a key needs a time in seconds"),
    ] {
        browser.choose(second, bad);
        assert_eq!(fault(&browser, "key"), format!("Key 2 stays at 2 s: {why}."));
        assert_eq!(times(), json!([0, 2]), "{bad}");
    }
    browser.script("document.getElementById('key-fault').scrollIntoView({ block: 'center' })");
    browser.shoot("wide-fault-key.png");
    browser.choose("#ease", "in_out");
    assert_eq!(fault(&browser, "key"), "", "a later edit that is fine ends what was said");
    browser.choose(second, "3");
    assert_eq!(times(), json!([0, 3]));
    browser.choose("#duration", "1e9");
    assert_eq!(fault(&browser, "duration"), "0.1 to 8,000 s; the path keeps 3 s");
    browser.choose("#duration", "1");
    assert_eq!((fault(&browser, "duration"), times()), (String::new(), json!([0, 1])));
    // A path that is too short for its keys.
    browser.choose(second, "0.001");
    browser.click("#key-add");
    assert_eq!(times(), json!([0, 0.001, 2.001]));
    browser.choose("#duration", "0.5");
    let why = "keys 1 and 2 would be at one time; the path keeps 2.001 s";
    assert_eq!((fault(&browser, "duration").as_str(), times()), (why, json!([0, 0.001, 2.001])));
    assert_eq!(browser.console_errors(), Vec::<String>::new());
}

#[test]
fn addresses_say_what_they_take() {
    let Some(driver) = driver_or_skip() else { return };
    let (daemon, browser) = opened(&driver);
    let first = still_picture(&browser);
    let open = |hash: &str| {
        browser.open("about:blank");
        browser.open(&format!("{}/#{hash}", daemon.url));
    };
    open("scene=ball&lod=foo&fov=999&eye=1,2,x&colour=red&camera=street");
    let message = browser.message("Not all of the address");
    for told in [
        "lod=foo: accepted are full, spt",
        "fov=999: 1 to 170",
        "eye=1,2,x: three numbers",
        "colour: the viewer knows no such setting",
        "camera=street: the scene’s cameras are front",
    ] {
        assert!(message.contains(told), "{told}: {message}");
    }
    assert_eq!(still_picture(&browser), first, "the rest is as it comes");
    browser.shoot("wide-address.png");
    // A change of the hash works without a new page, and valid values give no message.
    browser.script("location.hash = 'scene=ball&camera=front&fov=50'");
    browser.wait_for("its view", PATIENCE, "return viewer.pose?.fov === 50 && viewer.isStill");
    assert_eq!(browser.script("return document.getElementById('message').hidden"), true);
    browser.script("location.hash = 'scene=ball&eye=0,1,6'");
    let message = browser.message("target is missing");
    assert!(message.contains("eye and target"), "{message}");
    open("camera=front");
    assert_eq!(still_picture(&browser), first);
    assert_eq!(browser.text("return document.getElementById('camera').value"), "front");
    assert_eq!(browser.script("return document.getElementById('message').hidden"), true);
    assert_eq!(browser.console_errors(), Vec::<String>::new());
}
