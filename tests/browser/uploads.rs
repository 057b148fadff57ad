//! Uploads on the page, by button and by drop.

use super::page::{PATIENCE, distinct_colors, driver_or_skip, opened, shows, still_picture};
use super::webdriver::Browser;

const PLY: &str = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
    property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n\
    0 0 0 255 0 0\n1 0 0 0 255 0\n0 1 0 0 0 255\n1 1 0 255 255 0\n";

/// Drops files with these names and texts onto the page.
fn drop_files(browser: &Browser, files: &[(&str, &str)]) {
    let files = serde_json::to_string(files).unwrap();
    browser.script(&format!(
        "const data = new DataTransfer(); \
         for (const [name, text] of {files}) data.items.add(new File([text], name)); \
         const send = kind => document.body.dispatchEvent(new DragEvent(kind, {{ bubbles: true, cancelable: true, dataTransfer: data }})); \
         send('dragenter'); window.dropShown = !document.getElementById('drop').hidden; send('dragover'); send('drop')"
    ));
}

#[test]
fn files_are_sent_shown_and_refused_in_words() {
    let Some(driver) = driver_or_skip() else { return };
    let (daemon, browser) = opened(&driver);
    browser.script(
        "window.said = []; new MutationObserver(() => said.push(document.getElementById('upload-text').textContent))\
         .observe(document.getElementById('upload-text'), { childList: true })",
    );
    browser.choose_files("#files", &[&daemon.file("four-corners.ply", PLY)]);
    shows(&browser, "four-corners");
    let said = browser.text("return said.join('\\n')");
    assert!(said.contains("four-corners.ply: sending") && said.contains("sent"), "{said}");
    assert!(distinct_colors(&browser) > 4, "four points on a background");
    let list = browser.text("return document.getElementById('scene-list').textContent");
    assert!(list.contains("four-corners") && list.contains("4 samples"), "{list}");
    let hidden = browser.script("return document.getElementById('upload').hidden");
    assert!(hidden.as_bool().unwrap(), "the progress is put away");

    drop_files(&browser, &[("broken.ply", "ply\nformat ascii 1.0\nelement vertex 9\n")]);
    assert!(browser.script("return dropShown").as_bool().unwrap(), "where to drop is shown");
    let message = browser.message("(422)");
    assert!(message.contains("broken.ply"), "{message}");
    browser.shoot("wide-refused.png");
    assert_eq!(browser.text("return viewer.scene.id"), "four-corners", "the last scene stays");

    // Several files make one scene.
    let obj = "mtllib red.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl red\nf 1 2 3\n";
    drop_files(&browser, &[("shape.obj", obj), ("red.mtl", "newmtl red\nKd 1 0 0\n")]);
    shows(&browser, "shape");
    browser.wait_for(
        "the refusal to go when the next upload is there",
        PATIENCE,
        "return document.getElementById('message').hidden",
    );
    browser.choose("#scene", "ball");
    shows(&browser, "ball");
    let severe: Vec<String> =
        browser.console_errors().into_iter().filter(|error| !error.contains("422")).collect();
    assert_eq!(severe, Vec::<String>::new());
    still_picture(&browser);
}

#[test]
fn a_dropped_camera_path_is_one() {
    let Some(driver) = driver_or_skip() else { return };
    let (_daemon, browser) = opened(&driver);
    let path = r#"{ "fps": 12, "keys": [ { "t": 0, "eye": [0, 1, 5], "target": [0, 0, 0] }, { "t": 3, "eye": [5, 1, 0], "target": [0, 0, 0] } ] }"#;
    drop_files(&browser, &[("way.json", path)]);
    browser.wait_for(
        "its keys",
        PATIENCE,
        "return document.querySelectorAll('#keys tbody tr').length === 2",
    );
    assert_eq!(browser.text("return document.getElementById('duration').value"), "3");
    drop_files(&browser, &[("way.json", &path.replace("[5, 1, 0]", "[5, 1]"))]);
    let message = browser.message("no camera path");
    assert!(message.contains("keys[1].eye"), "{message}");
    assert!(message.starts_with("way.json is"), "names stay as they are: {message}");
    assert_eq!(browser.text("return viewer.scene.id"), "ball");
}

#[test]
fn models_that_have_nothing_to_do_with_each_other_are_scenes_of_their_own() {
    let Some(driver) = driver_or_skip() else { return };
    let (_daemon, browser) = opened(&driver);
    let obj = "mtllib red.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl red\nf 1 2 3\n";
    let files = [
        ("left.ply", PLY),
        ("shape.obj", obj),
        ("red.mtl", "newmtl red\nKd 1 0 0\n"),
        ("right.ply", PLY),
    ];
    drop_files(&browser, &files);
    // Files that are dropped while others are sent wait for their turn.
    drop_files(&browser, &[("later.ply", PLY)]);
    shows(&browser, "later");
    let list =
        browser.script("return [...document.getElementById('scene').options].map(o => o.value)");
    assert_eq!(list, serde_json::json!(["ball", "left", "shape", "right", "later"]));
    assert_eq!(browser.script("return document.getElementById('message').hidden"), true);
    browser.choose("#scene", "shape");
    shows(&browser, "shape");
    let warnings = browser.script("return viewer.scene.warnings");
    assert_eq!(warnings, serde_json::json!([]), "its material came with it");
}

#[test]
fn folders_are_looked_through() {
    let Some(driver) = driver_or_skip() else { return };
    let (daemon, browser) = opened(&driver);
    let folder = daemon.file(
        "model/shape.obj",
        "mtllib stuff/red.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl red\nf 1 2 3\n",
    );
    daemon.file("model/stuff/red.mtl", "newmtl red\nKd 1 0 0\n");
    for other in [".hidden", "README.md", "package.json"] {
        daemon.file(&format!("model/{other}"), "{}");
    }
    let folder = folder.trim_end_matches("/shape.obj");
    browser.drop_from_disk((400, 400), &[folder]);
    shows(&browser, "shape");
    assert_eq!(browser.script("return document.getElementById('message').hidden"), true);
    let warnings = browser.script("return viewer.scene.warnings");
    assert_eq!(warnings, serde_json::json!([]), "its material came with it");

    let empty = daemon.file("empty/photo.png", "of use to a model alone");
    browser.drop_from_disk((400, 400), &[empty.trim_end_matches("/photo.png")]);
    browser.message("Nothing in the folder empty can be shown");
    for number in 0..33 {
        daemon.file(&format!("many/{number}.ply"), PLY);
    }
    let many = daemon.file("many/33.ply", PLY);
    browser.drop_from_disk((400, 400), &[many.trim_end_matches("/33.ply")]);
    browser.message("34 scenes; 32 at a time");
    // Browsers without folder support pass folders as files that cannot be read.
    browser.script(
        "const data = new DataTransfer(), folder = new File([], 'Textured'); \
         folder.slice = () => ({ arrayBuffer: () => Promise.reject(new DOMException('gone', 'NotFoundError')) }); \
         const event = new DragEvent('drop', { bubbles: true, cancelable: true, dataTransfer: data }); \
         Object.defineProperty(event, 'dataTransfer', { value: { types: ['Files'], files: [folder], items: [] } }); \
         document.body.dispatchEvent(event)",
    );
    let message = browser.message("Textured cannot be read. Is it a folder");
    assert!(!message.contains("daemon"), "{message}");
    assert_eq!(browser.console_errors(), Vec::<String>::new());
}

#[test]
fn what_could_not_be_sent_is_kept_until_it_is() {
    let Some(driver) = driver_or_skip() else { return };
    let (mut daemon, browser) = opened(&driver);
    daemon.kill();
    browser.link("waiting");
    drop_files(&browser, &[("late.ply", PLY)]);
    browser.message("late.ply could not be sent");
    // Repeated messages about the connection hide no other message.
    browser.script("viewer.link.again()");
    let message = browser.message("Not connected");
    assert!(message.contains("late.ply could not be sent"), "{message}");
    browser.shoot("wide-two-messages.png");
    daemon.start_again();
    browser.link("stream");
    still_picture(&browser);
    let message = browser.message("late.ply could not be sent");
    assert!(!message.contains("Not connected"), "{message}");
    browser.script("[...document.querySelectorAll('#message button')].find(b => b.textContent === 'Send again').click()");
    shows(&browser, "late");
    assert_eq!(browser.script("return document.getElementById('message').hidden"), true);
}

#[test]
fn a_server_that_names_a_pause_is_not_asked_before() {
    let Some(driver) = driver_or_skip() else { return };
    let (_daemon, browser) = opened(&driver);
    // The upload is still loading when it is answered. The first question about the scene is refused for three seconds.
    browser.script(
        "const open = XMLHttpRequest.prototype.open; \
         XMLHttpRequest.prototype.open = function (method, url) { \
             open.call(this, method, url); \
             Object.defineProperty(this, 'status', { get: () => 202 }); \
             Object.defineProperty(this, 'responseText', { get: () => JSON.stringify({ id: 'slow', state: 'loading' }) }); \
         }; \
         const real = window.fetch; \
         window.asked = []; \
         window.fetch = async (url, options) => { \
             if (!String(url).endsWith('/v1/scenes/slow')) return real(url, options); \
             asked.push(performance.now()); \
             return asked.length > 1 ? real(url, options) \
                 : new Response('{}', { status: 429, headers: { 'Retry-After': '3' } }); \
         }",
    );
    drop_files(&browser, &[("slow.ply", PLY)]);
    shows(&browser, "slow");
    let pause = browser.script("return asked[1] - asked[0]").as_f64().unwrap();
    assert!(pause >= 2900.0, "the page asked again after {pause} ms");
    assert_eq!(browser.console_errors(), Vec::<String>::new());
}
