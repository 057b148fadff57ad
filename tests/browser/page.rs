//! Helpers of the tests that query the page and act on it.

use std::path::PathBuf;
use std::time::Duration;

use super::daemon::Daemon;
use super::webdriver::{self, Browser};

/// Long enough for a software driver to start and draw a first frame on a busy machine.
pub const PATIENCE: Duration = Duration::from_secs(60);

pub mod keys {
    //! Special keys by their code points in the WebDriver standard.
    pub const TAB: char = '\u{e004}';
    pub const ENTER: char = '\u{e007}';
    pub const SHIFT: char = '\u{e008}';
    pub const SPACE: char = ' ';
    pub const HOME: char = '\u{e011}';
    pub const LEFT: char = '\u{e012}';
    pub const RIGHT: char = '\u{e014}';
}

/// The path of chromedriver, or `None` with a message.
pub fn driver_or_skip() -> Option<String> {
    let driver = webdriver::find_driver();
    if driver.is_none() {
        let required = std::env::var("POINTILLIST_BROWSER").is_ok_and(|value| value == "required");
        assert!(!required, "no chromedriver, and POINTILLIST_BROWSER=required");
        eprintln!("!! SKIPPED: no chromedriver; scripts/setup-browser.sh installs one");
    }
    driver
}

/// Starts a daemon and a browser that shows its page with the first frame.
pub fn opened(driver: &str) -> (Daemon, Browser) {
    opened_at(driver, Daemon::start())
}

/// As [`opened`], with a daemon that runs already.
pub fn opened_at(driver: &str, daemon: Daemon) -> (Daemon, Browser) {
    let browser = Browser::start(driver, 1280, 800);
    browser.open(&daemon.url);
    still_picture(&browser);
    (daemon, browser)
}

impl Browser {
    /// The text that a function body returns in the page.
    pub fn text(&self, body: &str) -> String {
        self.script(body).as_str().unwrap_or_default().to_owned()
    }

    /// The number that a function body returns in the page.
    pub fn number(&self, body: &str) -> f64 {
        self.script(body).as_f64().unwrap_or_else(|| panic!("{body} is no number"))
    }

    /// Clicks the element of a selector by script.
    pub fn click(&self, selector: &str) {
        self.script(&format!("document.querySelector('{selector}').click()"));
    }

    /// Chooses an option or enters a value, with the events of a user's input.
    pub fn choose(&self, control: &str, value: &str) {
        self.script(&format!(
            "const s = document.querySelector('{control}'); s.value = '{value}'; \
             s.dispatchEvent(new Event('input')); s.dispatchEvent(new Event('change'))"
        ));
    }

    /// Reloads the page, as the reload button does.
    pub fn reload(&self) {
        self.script("window.isOld = true; location.reload()");
        self.wait_for("the page anew", PATIENCE, "return !window.isOld && globalThis.viewer");
    }

    /// Saves a screenshot as `target/browser/NAME`.
    pub fn shoot(&self, name: &str) {
        self.screenshot(
            &PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("target/browser").join(name),
        );
    }

    /// Waits for a message over the picture that contains `words`.
    pub fn message(&self, words: &str) -> String {
        let found = self.wait_for(
            &format!("a message with `{words}`"),
            PATIENCE,
            &format!(
                "const m = document.getElementById('message'); \
                 return !m.hidden && m.innerText.includes('{words}') ? m.innerText : ''"
            ),
        );
        found.as_str().unwrap_or_default().to_owned()
    }

    /// Waits until the link is in this state.
    pub fn link(&self, state: &str) {
        self.wait_for(
            &format!("the link to be `{state}`"),
            PATIENCE,
            &format!("return document.getElementById('link-state').dataset.link === '{state}'"),
        );
    }
}

/// Waits for a still frame of the latest request, and returns the size and a hash of the canvas.
pub fn still_picture(browser: &Browser) -> String {
    let found = browser.wait_for(
        "a full frame at rest",
        PATIENCE,
        "if (!globalThis.viewer?.isStill) return ''; \
         const { canvas, paper } = viewer, { width, height } = canvas; let hash = 2166136261; \
         for (const word of new Uint32Array(paper.getImageData(0, 0, width, height).data.buffer)) hash = Math.imul(hash ^ word, 16777619); \
         return `${width}x${height} ${hash >>> 0}`",
    );
    found.as_str().unwrap_or_default().to_owned()
}

/// Number of distinct colours on the canvas.
pub fn distinct_colors(browser: &Browser) -> u64 {
    let count = browser.script(
        "const { canvas, paper } = viewer; \
         const d = new Uint32Array(paper.getImageData(0, 0, canvas.width, canvas.height).data.buffer); \
         return new Set(d).size",
    );
    count.as_u64().expect("a number")
}

/// Waits for a still frame of a scene.
pub fn shows(browser: &Browser, id: &str) {
    browser.wait_for(
        &format!("scene {id}"),
        PATIENCE,
        &format!("return viewer.scene?.id === '{id}' && viewer.isStill"),
    );
}
