//! Use without a pointer: flight by keys, and everything reachable by keyboard.

use super::page::{PATIENCE, driver_or_skip, keys, opened, still_picture};
use super::webdriver::Browser;

fn eye(browser: &Browser) -> Vec<f64> {
    let eye = browser.script("return viewer.pose.eye");
    eye.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
}

#[test]
fn fly_by_keys() {
    let Some(driver) = driver_or_skip() else { return };
    let (_daemon, browser) = opened(&driver);
    let first = still_picture(&browser);
    browser.script("viewer.canvas.focus()");
    browser.key('f');
    assert!(browser.script("return viewer.controls.isFlying").as_bool().unwrap());
    let start = eye(&browser);
    browser.hold('w', true);
    browser.wait_for(
        "the eye to come nearer",
        PATIENCE,
        &format!("return viewer.pose.eye[2] < {}", start[2] - 0.5),
    );
    browser.hold('w', false);
    let flown = still_picture(&browser);
    assert_ne!(flown, first);
    browser.shoot("wide-fly.png");
    let (now, target) = (eye(&browser), browser.script("return viewer.pose.target"));
    browser.key(keys::RIGHT);
    still_picture(&browser);
    assert_eq!(eye(&browser), now, "arrows look about");
    assert_ne!(browser.script("return viewer.pose.target"), target);
    let slow = browser.number("return Number(document.getElementById('speed').value)");
    browser.key('+');
    assert!(browser.number("return Number(document.getElementById('speed').value)") > slow);
    // A held key is released when the picture loses the keyboard focus.
    browser.hold('d', true);
    browser.script("viewer.canvas.blur()");
    still_picture(&browser);
    browser.hold('d', false);
    browser.script("viewer.canvas.focus()");
    browser.key('f');
    assert!(!browser.script("return viewer.controls.isFlying").as_bool().unwrap());
    assert_eq!(browser.console_errors(), Vec::<String>::new());
}

/// Name and outline of the focused element.
fn focused(browser: &Browser) -> (String, String) {
    let found = browser.script(
        "const e = document.activeElement, label = e.closest('label'); \
         const name = e.getAttribute('aria-label') || (label && label.innerText) || e.innerText || e.title; \
         const style = getComputedStyle(e); \
         return [(e.id || e.tagName) + ': ' + name, style.outlineStyle + ' ' + style.outlineWidth]",
    );
    (found[0].as_str().unwrap().to_owned(), found[1].as_str().unwrap().to_owned())
}

#[test]
fn everything_is_reached_by_the_keyboard() {
    let Some(driver) = driver_or_skip() else { return };
    let (_daemon, browser) = opened(&driver);
    browser.script(
        "for (const d of document.querySelectorAll('details')) d.open = true; scrollTo(0, 0)",
    );
    let reachable = browser.number(
        "return [...document.querySelectorAll('button, input, select, a[href], summary, canvas[tabindex]')]\
         .filter(e => e.checkVisibility({ visibilityProperty: true }) && !e.disabled).length",
    );
    let mut seen: Vec<String> = Vec::new();
    for _ in 0..reachable as usize + 5 {
        browser.key(keys::TAB);
        let (name, outline) = focused(&browser);
        if name.starts_with("BODY") || name.starts_with("HTML") {
            break;
        }
        assert!(!name.ends_with(": "), "{name} has no name");
        assert_eq!(outline, "solid 2px", "{name} shows that it has the focus");
        seen.push(name);
    }
    assert_eq!(seen.len(), reachable as usize, "{seen:#?}");

    // Record a path of two keys and play it without a pointer.
    browser.script("viewer.canvas.focus()");
    browser.key('k');
    browser.key(keys::RIGHT);
    browser.key(keys::RIGHT);
    browser.key('k');
    let count = "return document.querySelectorAll('#keys tbody tr').length";
    assert_eq!(browser.script(count), 2);
    browser.script("document.getElementById('play').focus()");
    browser.key(keys::SPACE);
    assert_eq!(browser.text("return document.getElementById('play').textContent"), "Pause");
    browser.key(keys::ENTER);
    assert_eq!(browser.text("return document.getElementById('play').textContent"), "Play");
    still_picture(&browser);
    browser.script("document.querySelector('#keys [data-action=delete]').focus()");
    browser.key(keys::ENTER);
    assert_eq!(browser.script(count), 1);
    let (name, _) = focused(&browser);
    assert!(name.contains("Delete key 1"), "the focus stays in the table: {name}");
    browser.hold(keys::SHIFT, true);
    browser.key(keys::TAB);
    browser.hold(keys::SHIFT, false);
    assert_eq!(browser.console_errors(), Vec::<String>::new());
}
