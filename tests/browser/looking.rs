//! Orbit, pan, zoom, outputs and settings, and the receipt of a frame.

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

    // The page records every state, so that brief states are not missed.
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

/// Names of the visible controls of splats.
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
    // A chosen setting can be returned to the scene's default on the same stream.
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
    assert_eq!(still_picture(&browser), full, "a tree of so few triangles would be slower");
    browser.choose("#color_by", "levels");
    let coarse = still_picture(&browser);
    assert_ne!(coarse, full, "levels have colours of their own");
    browser.choose("#max_error_px", "2");
    assert_ne!(still_picture(&browser), coarse, "smaller nodes");
    browser.choose("#max_error_px", "8");
    browser.shoot("wide-levels.png");
    browser.choose("#quality", "50");
    still_picture(&browser);
    let status = browser.text("return document.getElementById('status').textContent");
    assert!(status.contains("JPEG, quality 50"), "{status}");

    let address = browser.text("return document.getElementById('link').href");
    for part in
        ["/v1/scenes/ball/frame?", "lod=spt", "max_error_px=8", "color_by=levels", "quality=50"]
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

/// Every step has a time or a reason, and the times add up to the total.
fn passes_are_explained(browser: &Browser) {
    let rows = browser.script(
        "return [...document.querySelectorAll('#passes tr[data-step]')].map(r => \
         [r.dataset.step, r.cells[1].textContent, r.dataset.pass ? 'pass' : 'host'])",
    );
    let rows = rows.as_array().expect("rows");
    let cell = |row: &serde_json::Value, i: usize| row[i].as_str().unwrap_or_default().to_owned();
    let ran = |row: &&serde_json::Value| cell(row, 2) == "pass";
    assert!(rows.iter().filter(ran).count() >= 2, "passes that ran: {rows:?}");
    for row in rows {
        match cell(row, 1).as_str() {
            "–" => {} // this adapter has no timestamps
            time => assert!(time.parse::<f64>().is_ok(), "{row}"),
        }
    }
    for step in ["queue", "readback", "encode"] {
        assert!(rows.iter().any(|row| cell(row, 0) == step), "{step} is listed: {rows:?}");
    }
    // Skipped passes and effects are one line, which unfolds to the reasons.
    let skipped = browser.text(
        "const r = document.querySelectorAll('#passes tr.skipped'); if (r.length !== 1) return ''; \
         const open = r[0].querySelector('details').open, items = [...r[0].querySelectorAll('li')]; \
         return `${open} ${r[0].querySelector('summary').textContent} ${items.every(i => i.textContent.length > i.dataset.skipped.length + 5)} ${items.length}`",
    );
    let count = skipped.rsplit(' ').next().unwrap_or_default();
    assert_eq!(skipped, format!("false skipped passes and effects: {count} true {count}"));
    let legend = browser.text("return document.getElementById('explained').textContent");
    assert!(legend.contains('%'), "{legend}");
}

/// Position of a world point on the canvas, in CSS pixels from its top left, computed with the page's pose.
const PROJECT: &str = "const project = p => { const { eye, target, up, fov } = viewer.pose, sub = (a, b) => a.map((v, i) => v - b[i]); \
     const dot = (a, b) => a.reduce((s, v, i) => s + v * b[i], 0), unit = a => a.map(v => v / Math.hypot(...a)); \
     const cross = (a, b) => [a[1]*b[2]-a[2]*b[1], a[2]*b[0]-a[0]*b[2], a[0]*b[1]-a[1]*b[0]]; \
     const f = unit(sub(target, eye)), r = unit(cross(f, up)), u = cross(r, f), v = sub(p, eye), c = viewer.canvas; \
     const s = c.clientHeight / 2 / Math.tan(fov * Math.PI / 360) / dot(v, f); \
     return [c.clientWidth / 2 + dot(v, r) * s, c.clientHeight / 2 - dot(v, u) * s]; };";

fn numbers(value: &serde_json::Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
}

#[test]
fn the_wheel_zooms_towards_the_pointer_and_a_double_click_sets_the_pivot() {
    let Some(driver) = driver_or_skip() else { return };
    let (_daemon, browser) = opened(&driver);
    let at = |p: &str| numbers(&browser.script(&format!("{PROJECT} return project({p})")));
    // The point under a place of the picture, in the plane through the target, stays there.
    let bar = browser.number("return viewer.canvas.getBoundingClientRect().top");
    browser.script("viewer.canvas.focus(); window.under = [0.5, 0.3, 0]");
    let before = at("window.under");
    let target_depth = browser
        .number("return Math.hypot(...viewer.pose.eye.map((v, i) => v - viewer.pose.target[i]))");
    browser.wheel((before[0] as i64, (before[1] + bar) as i64), -400);
    still_picture(&browser);
    let after = at("window.under");
    let now = browser
        .number("return Math.hypot(...viewer.pose.eye.map((v, i) => v - viewer.pose.target[i]))");
    assert!(now < 0.8 * target_depth, "{now} of {target_depth}");
    let moved = (after[0] - before[0]).hypot(after[1] - before[1]);
    assert!(moved < 4.0, "it went from {before:?} to {after:?}");

    browser.key(keys::HOME);
    still_picture(&browser);
    // A place on the ball beside its middle: the hit lies on the unit sphere.
    let place = at("[0.45, 0.2, Math.sqrt(1 - 0.45 ** 2 - 0.2 ** 2)]");
    browser.script(&format!(
        "const r = viewer.canvas.getBoundingClientRect(); viewer.canvas.dispatchEvent(new MouseEvent('dblclick', \
         {{ clientX: r.left + {}, clientY: r.top + {}, bubbles: true }}))",
        place[0], place[1]
    ));
    browser.wait_for(
        "the pivot on the ball",
        super::page::PATIENCE,
        "const [x, y, z] = viewer.pose.target; return Math.abs(Math.hypot(x, y, z) - 1) < 0.01 && Math.hypot(x - 0.45, y - 0.2) < 0.04",
    );
    still_picture(&browser);
    let middle = at("[0.45, 0.2, Math.sqrt(1 - 0.45 ** 2 - 0.2 ** 2)]");
    let size =
        numbers(&browser.script("return [viewer.canvas.clientWidth, viewer.canvas.clientHeight]"));
    assert!(
        (middle[0] - size[0] / 2.0).hypot(middle[1] - size[1] / 2.0) < 12.0,
        "{middle:?} of {size:?}"
    );
    // Beside the scene there is no point to look at.
    let pose = browser.script("return viewer.pose.target");
    browser.script("const r = viewer.canvas.getBoundingClientRect(); viewer.canvas.dispatchEvent(new MouseEvent('dblclick', { clientX: r.left + 3, clientY: r.top + 60, bubbles: true }))");
    browser.wait_for(
        "the message",
        super::page::PATIENCE,
        "return document.querySelector('[data-of=pivot]')?.innerText.includes('Nothing here to turn around')",
    );
    assert_eq!(browser.script("return viewer.pose.target"), pose);
    assert_eq!(browser.console_errors(), Vec::<String>::new());
}

#[test]
fn a_view_of_nothing_says_so_and_fits() {
    let Some(driver) = driver_or_skip() else { return };
    let (daemon, browser) = opened(&driver);
    let lost =
        "const l = document.getElementById('lost'); return l.checkVisibility() ? l.innerText : ''";
    // Inside the scene's box, but between ball and floor: only the frame tells that nothing is in view.
    browser.open(&format!("{}/#scene=ball&eye=0,-1.1,1.9&target=0,-1.05,5&fov=30", daemon.url));
    let said = browser.wait_for("a word about nothing", super::page::PATIENCE, lost);
    assert!(said.as_str().unwrap().contains("Fit the view"), "{said}");
    browser.shoot("wide-nothing.png");
    browser.click("#lost-fit");
    still_picture(&browser);
    assert_eq!(browser.text(lost), "");
    assert!(distinct_colors(&browser) > 50);
    let camera = browser.text("return document.getElementById('camera').selectedOptions[0].text");
    assert_eq!(camera, "whole scene");
    assert_eq!(browser.console_errors(), Vec::<String>::new());
}

#[test]
fn coordinates_have_the_digits_that_can_be_seen() {
    let Some(driver) = driver_or_skip() else { return };
    let (_daemon, browser) = opened(&driver);
    let shown = |pose: &str| {
        browser.script(&format!("location.hash = '#scene=ball&{pose}'"));
        browser.wait_for(
            "the pose in the panel",
            super::page::PATIENCE,
            &format!("return viewer.isStill && '{pose}'.startsWith('eye=' + viewer.pose.eye.join(',') + '&')"),
        );
        browser.text("return [...document.querySelectorAll('#frame dd')].slice(-2).map(e => e.textContent).join(' | ')")
    };
    let survey = shown("eye=412000.125,5653000.25,130&target=412010,5653000,110");
    assert_eq!(survey, "412000.125, 5653000.25, 130 | 412010, 5653000, 110");
    let small = shown("eye=0.000125,0,0.0005&target=0,0,0");
    assert_eq!(small, "0.000125, 0, 0.0005 | 0, 0, 0");
}

#[test]
fn a_frame_that_takes_long_is_said_to_be_on_its_way() {
    let Some(driver) = driver_or_skip() else { return };
    let (_daemon, browser) = opened(&driver);
    let is_busy = "return document.getElementById('view').classList.contains('busy')";
    assert_eq!(browser.script(is_busy), false, "nothing is waited for");
    // Hold frames back within the page.
    browser.script(
        "viewer.canvas.focus(); window.came = viewer.link.came; viewer.link.came = () => {}",
    );
    browser.key(keys::LEFT);
    browser.wait_for("a word about waiting", super::page::PATIENCE, is_busy);
    browser.script("viewer.link.came = window.came; viewer.link.show(false)");
    still_picture(&browser);
    assert_eq!(browser.script(is_busy), false);
}

#[test]
fn clicks_read_coordinates_and_measure() {
    let Some(driver) = driver_or_skip() else { return };
    let (_daemon, browser) = opened(&driver);
    still_picture(&browser);
    let bar = browser.number("return viewer.canvas.getBoundingClientRect().top");
    let at = |p: &str| numbers(&browser.script(&format!("{PROJECT} return project({p})")));
    let click = |place: &[f64]| {
        browser.drag("mouse", 0, &[(place[0] as i64, (place[1] + bar) as i64)]);
    };
    let read = |what: &str, pattern: &str| {
        let text = "document.getElementById('measured').textContent";
        browser.wait_for(what, super::page::PATIENCE, &format!("return /{pattern}/.test({text})"));
        browser.text(&format!("return {text}"))
    };
    // Places on the ball: the hits lie on the unit sphere.
    let surface =
        |x: f64, y: f64| at(&format!("[{x}, {y}, Math.sqrt(1 - ({x}) ** 2 - ({y}) ** 2)]"));
    let place = |text: &str| -> Vec<f64> {
        text.split(", ").map(|number| number.trim().parse().unwrap()).collect()
    };
    click(&surface(0.4, 0.2));
    let text = read("the coordinates", "away");
    let found = place(text.lines().next().unwrap());
    let radius = found.iter().map(|v| v * v).sum::<f64>().sqrt();
    assert!((radius - 1.0).abs() < 0.01, "{text}");
    assert!((found[0] - 0.4).hypot(found[1] - 0.2) < 0.04, "{text}");

    browser.script("viewer.canvas.focus()");
    browser.key('m');
    click(&surface(-0.4, 0.0));
    read("the first point", "second point");
    click(&surface(0.4, 0.0));
    let text = read("the distance", "^[0-9.]+ units\\nfrom");
    let distance: f64 = text.split(' ').next().unwrap().parse().unwrap();
    assert!((distance - 0.8).abs() < 0.08, "{text}");
    let line = "const line = document.getElementById('line'); return ";
    assert_eq!(browser.text(&format!("{line} line.getAttribute('visibility')")), "visible");
    let ends = browser.text(&format!("{line} line.getAttribute('points')"));
    let ends: Vec<f64> = ends.split([' ', ',']).map(|v| v.parse().unwrap()).collect();
    let expected = surface(0.4, 0.0);
    assert!((ends[2] - expected[0]).hypot(ends[3] - expected[1]) < 12.0, "{ends:?} {expected:?}");
    browser.shoot("wide-measured.png");
    // The line of the measurement follows the view.
    browser.key(keys::LEFT);
    still_picture(&browser);
    let turned = browser.text(&format!("{line} line.getAttribute('points')"));
    assert_ne!(turned.split([' ', ',']).map(|v| v.parse().unwrap()).collect::<Vec<f64>>(), ends);
    let scale = browser.text("return document.getElementById('scale-text').textContent");
    let (length, unit) = scale.split_once(' ').unwrap();
    let pixels =
        browser.number("return document.getElementById('scale-bar').getBoundingClientRect().width");
    let per_px = browser.number(
        "const p = viewer.pose; return 2 * Math.hypot(...p.eye.map((v, i) => v - p.target[i])) * \
         Math.tan(p.fov * Math.PI / 360) / viewer.canvas.clientHeight",
    );
    assert_eq!(unit, "units");
    let long: f64 = length.parse().unwrap();
    assert!((long / per_px - pixels).abs() < 5.0, "{scale} takes {pixels} px of {per_px}");
    assert!(matches!(length.trim_start_matches(['0', '.']).chars().next(), Some('1' | '2' | '5')));
    browser.key('m');
    assert_eq!(browser.text(&format!("{line} line.getAttribute('visibility')")), "hidden");
    assert_eq!(browser.console_errors(), Vec::<String>::new());
}
