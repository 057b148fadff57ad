//! The viewer page in a real browser: headless Chromium, driven over WebDriver, against the real daemon.
//!
//! Without `chromedriver` the tests print a message and pass. With `POINTILLIST_BROWSER=required` they fail instead; `make test`
//! sets it once it has found or installed a driver. Screenshots go to `target/browser/`.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "helpers of tests: a panic is how a test fails"
)]

mod accuracy;
mod connection;
mod daemon;
mod docs;
mod fields;
mod films;
mod keyboard;
mod looking;
mod page;
mod paths;
mod phone;
mod scenes;
mod uploads;
mod webdriver;
