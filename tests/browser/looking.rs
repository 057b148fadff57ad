//! Orbit, pan, zoom, outputs and settings; what is told of a frame.

use super::page::{distinct_colors, driver_or_skip, keys, opened, still_picture};
use super::webdriver::Browser;

#[test]
fn orbit_with_the_mouse() {
    let Some(driver) = driver_or_skip() else { return };
    let (daemon, browser) = opened(&driver);

    let first = still_picture(&browser);
    assert!(distinct_colors(&browser) > 50, "the first frame shows a coloured ball");
    browser.link("stream");
    browser.shoot("wide.png");
    passes_are_explained(&browser);
    let size = browser.text("return viewer.canvas.width + 'x' + viewer.canvas.height");
    let expected = browser.text(
        "const c = viewer.canvas; \
         return Math.round(c.clientWidth * devicePixelRatio) + 'x' + Math.round(c.clientHeight * devicePixelRatio)",
    );
    assert_eq!(size, expected, "a frame at rest has the canvas' own pixels");

    // The page itself notes each state, so that a state which passes quickly is not missed.
    browser.script(
        "window.states = []; new MutationObserver(() => states.push(viewer.canvas.dataset.state + ' ' + \
         document.getElementById('status').textContent)).observe(viewer.canvas, { attributes: true })",
    );
    browser.drag("mouse", 0, &[(400, 400), (430, 405), (470, 410), (540, 420), (600, 430)]);
    let orbited = still_picture(&browser);
    assert_ne!(orbited, first, "a drag orbits");
    let states = browser.text("return states.join('\\n')");
    assert!(states.contains("moving") && states.contains("JPEG, quality"), "{states}");
    assert!(states.contains("declared lower quality than"), "{states}");
    let status = browser.text("return document.getElementById('status').textContent");
    assert!(status.starts_with("still, refined") && status.contains("Revision 1"), "{status}");
    browser.shoot("wide-orbited.png");
    let columns = browser.number("return Number(document.getElementById('chart').dataset.columns)");
    assert!(columns >= 3.0, "the chart has a column a frame: {columns}");
    let spoken = browser.text("return document.getElementById('chart').getAttribute('aria-label')");
    assert!(spoken.contains("longest step"), "{spoken}");

    browser.drag("mouse", 2, &[(400, 400), (440, 400), (480, 440)]);
    let panned = still_picture(&browser);
    assert_ne!(panned, orbited, "a right drag pans");
    browser.wheel((400, 400), -240);
    let zoomed = still_picture(&browser);
    assert_ne!(zoomed, panned, "the wheel zooms");
    browser.key(keys::LEFT);
    assert_ne!(still_picture(&browser), zoomed, "an arrow key orbits");
    browser.key(keys::HOME);
    assert_eq!(still_picture(&browser), first, "the same pose gives the same pixels");

    for output in ["normal", "depth", "id"] {
        browser.choose("#output", output);
        assert_ne!(still_picture(&browser), first, "{output} is another picture");
        browser.shoot(&format!("wide-{output}.png"));
    }
    assert_eq!(browser.console_errors(), Vec::<String>::new());

    daemon.remove_scene();
    let message = browser.message("deleted");
    assert!(message.contains("Ball"), "{message}");
    assert_eq!(browser.text("return viewer.canvas.dataset.state"), "gone");
    browser.shoot("wide-deleted.png");
}

/// Controls of splats that can be seen.
fn shown_controls(browser: &Browser) -> String {
    browser.text(
        "return ['reconstruct', 'filter', 'prefilter', 'blend', 'shading'].filter(name => \
         document.getElementById(name).checkVisibility()).join(' ')",
    )
}

#[test]
fn splats_are_chosen_and_remembered() {
    let Some(driver) = driver_or_skip() else { return };
    let (_daemon, browser) = opened(&driver);
    assert_eq!(shown_controls(&browser), "reconstruct", "the choice is left open");
    let auto = still_picture(&browser);

    browser.choose("#reconstruct", "splats");
    let splats = still_picture(&browser);
    assert_eq!(shown_controls(&browser), "reconstruct filter prefilter blend shading");
    browser.shoot("wide-splats.png");
    let filter = browser.text("return document.getElementById('filter').selectedOptions[0].text");
    assert_eq!(filter, "scene: perspective");
    let frame = browser.text("return document.getElementById('frame').innerText");
    assert!(frame.contains("perspective filter, prefilter on, weighted"), "{frame}");
    browser.choose("#blend", "opaque");
    browser.choose("#prefilter", "false");
    let opaque = still_picture(&browser);
    assert_ne!(opaque, splats, "opaque splats are another picture");
    let shown = shown_controls(&browser);
    assert_eq!(shown, "reconstruct filter prefilter blend", "opaque splats are lit in one way");

    let address = browser.text("return location.href");
    for setting in ["reconstruct=splats", "blend=opaque", "prefilter=false"] {
        assert!(address.contains(setting), "{address}");
    }
    assert!(!address.contains("filter=perspective"), "what was not chosen is not kept: {address}");
    browser.open("about:blank");
    browser.open(&address);
    assert_eq!(still_picture(&browser), opaque, "the address shows the same picture");
    // What was chosen can be left to the scene again, on the same stream.
    browser.choose("#blend", "");
    browser.choose("#prefilter", "");
    assert_eq!(still_picture(&browser), splats);
    browser.choose("#reconstruct", "fuzzy");
    assert_eq!(
        shown_controls(&browser),
        "reconstruct filter prefilter",
        "blended and lit in one way"
    );
    browser.choose("#reconstruct", "points");
    let points = still_picture(&browser);
    assert_ne!(points, splats);
    assert_eq!(shown_controls(&browser), "reconstruct", "points have no settings of splats");
    browser.choose("#reconstruct", "auto");
    assert_eq!(still_picture(&browser), auto);
    assert_eq!(browser.console_errors(), Vec::<String>::new());
}

#[test]
fn detail_by_error_and_links_that_curl_takes() {
    let Some(driver) = driver_or_skip() else { return };
    let (daemon, browser) = opened(&driver);
    let full = still_picture(&browser);
    browser.choose("#lod", "spt");
    browser.choose("#max_error_px", "8");
    let coarse = still_picture(&browser);
    assert_ne!(coarse, full);
    browser.choose("#paint", "levels");
    assert_ne!(still_picture(&browser), coarse, "levels have colours of their own");
    browser.shoot("wide-levels.png");
    browser.choose("#quality", "50");
    still_picture(&browser);
    let status = browser.text("return document.getElementById('status').textContent");
    assert!(status.contains("JPEG, quality 50"), "{status}");

    let address = browser.text("return document.getElementById('link').href");
    for part in
        ["/v1/scenes/ball/frame?", "lod=spt", "max_error_px=8", "paint=levels", "quality=50"]
    {
        assert!(address.contains(part), "{address}");
    }
    let answer = ureq::get(&address).call().expect("the link to the frame is one");
    let kind = answer.headers().get("content-type").and_then(|kind| kind.to_str().ok());
    assert_eq!(kind, Some("image/jpeg"));
    assert!(address.starts_with(&daemon.url), "{address}");
    browser.click("#copy");
    browser.wait_for(
        "a word about the copied link",
        super::page::PATIENCE,
        "return document.getElementById('copied').textContent",
    );
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
    let legend = browser.text("return document.getElementById('explained').textContent");
    assert!(legend.contains('%'), "{legend}");
}
