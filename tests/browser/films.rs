//! Films as jobs: made as frames or as a video, viewed, downloaded, and found again after a reload.

use serde_json::json;

use super::daemon::Daemon;
use super::page::{PATIENCE, driver_or_skip, opened_at, still_picture};
use super::phone::nothing_overflows;
use super::webdriver::{Browser, decode_base64};

const TEXT: &str = "return document.getElementById('film-text').textContent";

fn shown(id: &str) -> String {
    format!("return document.getElementById('{id}').checkVisibility()")
}

/// Starts a film of the scene's path, 11 frames, as video or frames.
fn render_named(browser: &Browser, want: &str) {
    browser.choose("#named", "round");
    let keys = "return document.querySelectorAll('#keys tbody tr').length === 3";
    browser.wait_for("the scene's keys", PATIENCE, keys);
    browser.choose("#film-want", want);
    browser.choose("#film-size", "640x360");
    browser.click("#film-start");
    browser.wait_for(
        "the film",
        PATIENCE,
        &format!("return (() => {{ {TEXT} }})() === 'Done: 11 frames.'"),
    );
}

fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0, |crc: u32, byte| {
        (0..8).fold(crc ^ u32::from(*byte), |crc, _| {
            if crc & 1 == 1 { 0xedb8_8320 ^ (crc >> 1) } else { crc >> 1 }
        })
    })
}

fn number(bytes: &[u8], at: usize, size: usize) -> usize {
    bytes[at..at + size].iter().rev().fold(0, |sum, byte| sum << 8 | usize::from(*byte))
}

/// Names and contents of an archive, read as unpackers do: from its end, through the directory.
fn unpacked(zip: &[u8]) -> Vec<(String, Vec<u8>)> {
    let end = zip.len() - 22;
    assert_eq!(number(zip, end, 4), 0x0605_4b50, "it ends as an archive does");
    let mut at = number(zip, end + 16, 4);
    let entries = (0..number(zip, end + 10, 2))
        .map(|_| {
            assert_eq!(number(zip, at, 4), 0x0201_4b50);
            let (crc, size, length) =
                (number(zip, at + 16, 4), number(zip, at + 24, 4), number(zip, at + 28, 2));
            let name = String::from_utf8(zip[at + 46..at + 46 + length].to_vec()).unwrap();
            let local = number(zip, at + 42, 4);
            assert_eq!(number(zip, local, 4), 0x0403_4b50, "{name}");
            let from = local + 30 + number(zip, local + 26, 2) + number(zip, local + 28, 2);
            let content = zip[from..from + size].to_vec();
            assert_eq!(crc32(&content) as usize, crc, "{name}");
            at += 46 + length;
            (name, content)
        })
        .collect();
    assert_eq!(at, end, "the directory is as long as it says");
    entries
}

#[test]
fn frames_are_looked_at_played_and_downloaded() {
    let Some(driver) = driver_or_skip() else { return };
    let (daemon, browser) = opened_at(&driver, Daemon::with_jobs());
    browser.script("document.getElementById('paths').open = true");
    render_named(&browser, "frames");
    assert_eq!(browser.script(&shown("film-result")), false, "there is no video");
    browser.click("#film-frames");
    let image = "const i = document.getElementById('reel-image'); return i.checkVisibility() && i.naturalWidth ? [i.naturalWidth, i.src.split('/').pop()] : ''";
    assert_eq!(browser.wait_for("frame 0", PATIENCE, image), json!([640, "0"]));
    browser.script(
        "const r = document.getElementById('reel-frame'); r.value = 4; r.dispatchEvent(new Event('input'))",
    );
    browser.wait_for(
        "frame 4",
        PATIENCE,
        "return document.getElementById('reel-image').src.endsWith('/frames/4')",
    );
    browser.shoot("wide-reel.png");
    browser.click("#reel-play");
    browser.wait_for(
        "the end",
        PATIENCE,
        "return document.getElementById('reel-image').src.endsWith('/frames/10') && document.getElementById('reel-play').textContent === 'Play'",
    );
    let one = browser.text("return document.getElementById('reel-one').href");
    let mut answer = ureq::get(&one).call().expect("the link to a frame is one");
    let last = answer.body_mut().read_to_vec().unwrap();

    browser.script(
        "window.saved = null; const make = URL.createObjectURL; URL.createObjectURL = blob => { saved = blob; return make(blob); }",
    );
    browser.click("#reel-all");
    let zip = browser.wait_for(
        "the archive",
        PATIENCE,
        "return saved && new Promise(done => { const r = new FileReader(); r.onload = () => done(r.result.split(',')[1]); r.readAsDataURL(saved); })",
    );
    let entries = unpacked(&decode_base64(zip.as_str().unwrap()));
    let names: Vec<String> = entries.iter().map(|(name, _)| name.clone()).collect();
    let expected: Vec<String> = (0..11).map(|number| format!("{number:06}.png")).collect();
    assert_eq!(names, expected);
    assert_eq!(entries[10].1, last, "what is in it are the daemon's frames");
    // A film that is closed ends its archive, even if another one is begun at once.
    browser.script(
        "window.archives = 0; HTMLAnchorElement.prototype.click = function() { if (this.download.endsWith('.zip')) archives++; }; \
         const { reel } = viewer.jobs, { job } = reel; window.packs = [reel.pack()]; reel.close(); reel.job = job; \
         packs.push(reel.pack()); document.getElementById('reel').hidden = false",
    );
    let archives = "return Promise.all(packs).then(() => archives)";
    assert_eq!(browser.script(archives), 1, "archives saved");
    let list = browser.text("return document.getElementById('reel-list').href");
    assert!(list.starts_with(&daemon.url) && list.ends_with("/frames"), "{list}");
    browser.script("for (const d of document.querySelectorAll('details')) d.open = true");
    for width in [390, 320] {
        browser.emulate(width, 640, 2.0);
        nothing_overflows(&browser);
    }
    browser.script("document.getElementById('job-list').scrollIntoView(); scrollBy(0, -420)");
    browser.shoot("phone-films.png");
    assert_eq!(browser.console_errors(), Vec::<String>::new());
}

#[test]
fn a_film_with_gaps_shows_the_frames_that_are_there() {
    let Some(driver) = driver_or_skip() else { return };
    let (_daemon, browser) = opened_at(&driver, Daemon::with_jobs());
    browser.script("document.getElementById('paths').open = true");
    render_named(&browser, "frames");
    // The answers of a server whose job was cancelled before its workers had drawn frames 2 to 8.
    browser.script(
        "const real = window.fetch; \
         window.fetch = async (url, options) => { \
             const answer = await real(url, options), path = new URL(url, location).pathname; \
             if (/jobs\\/\\d+$/.test(path)) { \
                 const job = await answer.json(); \
                 job.frames.done = 4; \
                 return new Response(JSON.stringify(job)); \
             } \
             if (!path.endsWith('/frames')) return answer; \
             const [head, ...lines] = (await answer.text()).trim().split('\\n'); \
             const there = lines.filter(line => [0, 1, 9, 10].includes(JSON.parse(line).frame)); \
             return new Response([head, ...there.reverse(), ''].join('\\n')); \
         }",
    );
    browser.click("#film-frames");
    let shows = |number| {
        format!("return document.getElementById('reel-image').src.endsWith('/frames/{number}')")
    };
    browser.wait_for("the first frame", PATIENCE, &shows(0));
    browser.click("#reel-play");
    browser.wait_for("the last frame", PATIENCE, &shows(10));
    let slider =
        browser.script("const r = document.getElementById('reel-frame'); return [r.max, r.value]");
    assert_eq!(slider, json!(["3", "3"]));
    assert_eq!(browser.console_errors(), Vec::<String>::new());
}

#[test]
fn a_video_is_there_after_a_reload() {
    let Some(driver) = driver_or_skip() else { return };
    if !cfg!(feature = "video") {
        return;
    }
    let (_daemon, browser) = opened_at(&driver, Daemon::with_jobs());
    render_named(&browser, "video");
    browser.reload();
    still_picture(&browser);
    browser.wait_for(
        "the film of before",
        PATIENCE,
        &format!("return (() => {{ {TEXT} }})() === 'Done: 11 frames.'"),
    );
    browser.wait_for(
        "the scene's path of before",
        PATIENCE,
        "return document.getElementById('named').value === 'round'",
    );
    browser.script("for (const d of document.querySelectorAll('#paths, #jobs')) d.open = true");
    assert_eq!(browser.script(&shown("film-result")), true);
    let fetched = |selector: &str| {
        browser.script(&format!(
            "return fetch(document.querySelector('{selector}').href).then(a => a.status + ' ' + a.headers.get('content-type'))"
        ))
    };
    assert_eq!(fetched("#film-result"), "200 video/mp4");
    assert_eq!(fetched("#job-list a"), "200 video/mp4");
    // The video element loads the film, whether or not this browser has a decoder.
    let video = "const v = document.getElementById('film-video'); return v.checkVisibility() && (v.videoWidth > 0 || v.error?.code > 2 || !v.canPlayType('video/mp4; codecs=\"avc1.42E01E\"')) ? new URL(v.src).pathname : ''";
    let path = browser.wait_for("the film in its place", PATIENCE, video);
    assert!(path.as_str().unwrap().ends_with("/video.mp4"), "{path}");
    // The list of all films plays it as well.
    browser.script("document.querySelector('[data-act^=\"play \"]').click()");
    let path =
        browser.wait_for("a film of the list", PATIENCE, &video.replace("film-video", "job-video"));
    assert!(path.as_str().unwrap().ends_with("/video.mp4"), "{path}");
    browser.script("document.getElementById('jobs').scrollIntoView()");
    browser.shoot("wide-films.png");
    assert_eq!(
        browser.script("return document.getElementById('message').hidden"),
        true,
        "nothing is lost, and nothing said"
    );
    assert_eq!(browser.console_errors(), Vec::<String>::new());
}

#[test]
fn path_and_film_outlast_a_reload() {
    let Some(driver) = driver_or_skip() else { return };
    let (_daemon, browser) = opened_at(&driver, Daemon::with_jobs());
    browser.click("#key-add");
    browser.drag("mouse", 0, &[(400, 400), (470, 410), (600, 430)]);
    still_picture(&browser);
    browser.click("#key-add");
    // More frames than can be drawn while the page reloads.
    browser.choose("#duration", "400");
    let path = browser.script("return viewer.recorder.path");
    browser.choose("#film-want", "frames");
    browser.click("#film-start");
    browser.wait_for(
        "its progress",
        PATIENCE,
        &format!("return (() => {{ {TEXT} }})().includes('of 12,001 frames')"),
    );

    browser.reload();
    browser.wait_for(
        "its progress again",
        PATIENCE,
        &format!("return (() => {{ {TEXT} }})().includes('of 12,001 frames')"),
    );
    assert_eq!(browser.script("return viewer.recorder.path"), path, "the path is there too");
    still_picture(&browser);
    for id in ["film-progress", "film-cancel"] {
        assert_eq!(browser.script(&shown(id)), true, "{id}");
    }
    browser.shoot("wide-film-again.png");
    browser.script("document.getElementById('jobs').open = true");
    browser.wait_for(
        "it in the list",
        PATIENCE,
        "return document.querySelectorAll('#job-list progress').length === 1",
    );
    browser.click("#film-cancel");
    browser.wait_for(
        "its end",
        PATIENCE,
        &format!("return (() => {{ {TEXT} }})().startsWith('Cancelled')"),
    );
    let act = |name: &str| format!("#job-list [data-act^={name}]");
    let wait = |name: &str| {
        browser.wait_for(name, PATIENCE, &format!("return document.querySelector('{}')", act(name)))
    };
    wait("resume");
    browser.click(&act("resume"));
    browser.wait_for("it goes on", PATIENCE, &shown("film-cancel"));
    // Deletion needs a confirmation.
    browser.click(&act("ask"));
    wait("keep");
    browser.click(&act("keep"));
    wait("ask");
    browser.click(&act("ask"));
    browser.click(&act("delete"));
    browser.wait_for("an empty list", PATIENCE, &shown("no-jobs"));
    browser.wait_for(
        "a word of it",
        PATIENCE,
        &format!("return (() => {{ {TEXT} }})() === 'The film was deleted.'"),
    );

    // A cleared path stays cleared.
    browser.click("#path-clear");
    browser.reload();
    still_picture(&browser);
    assert_eq!(browser.script("return viewer.recorder.path.keys.length"), 0);
    assert_eq!(browser.text(TEXT), "");
    assert_eq!(browser.console_errors(), Vec::<String>::new());
}
