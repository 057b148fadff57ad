//! Files onto the page, by the button and by drop.

use super::page::{PATIENCE, distinct_colors, driver_or_skip, opened, still_picture};
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

fn shows(browser: &Browser, id: &str) {
    browser.wait_for(
        &format!("scene {id}"),
        PATIENCE,
        &format!("return viewer.scene?.id === '{id}' && viewer.isStill"),
    );
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

    // Several files are one scene.
    let obj = "mtllib red.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl red\nf 1 2 3\n";
    drop_files(&browser, &[("shape.obj", obj), ("red.mtl", "newmtl red\nKd 1 0 0\n")]);
    shows(&browser, "shape");
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
    assert_eq!(browser.text("return viewer.scene.id"), "ball");
}
