//! Tests the page in docs/web-page.md, served from another origin, as a reader who copies it does.

use std::io::{BufRead, BufReader, Write};
use std::net::TcpListener;
use std::time::Duration;

use super::daemon::Daemon;
use super::page::driver_or_skip;
use super::webdriver::Browser;

/// The last HTML block of the page, which is a complete document.
fn document() -> String {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/docs/web-page.md");
    let text = std::fs::read_to_string(path).unwrap();
    let html = text.rsplit_once("```html\n").unwrap().1;
    html.split_once("```").unwrap().0.to_owned()
}

/// Serves `page` to everybody while the test runs.
fn serve(listener: TcpListener, page: String) {
    std::thread::spawn(move || {
        for mut stream in listener.incoming().map_while(Result::ok) {
            let mut lines = BufReader::new(stream.try_clone().unwrap()).lines();
            while lines.next().is_some_and(|line| line.is_ok_and(|line| !line.is_empty())) {}
            let _ = write!(
                stream,
                "HTTP/1.1 200 OK\r\ncontent-type: text/html\r\ncontent-length: {}\r\nconnection: close\r\n\r\n{page}",
                page.len()
            );
        }
    });
}

#[test]
fn the_page_of_the_documentation_shows_frames_of_another_origin() {
    let Some(driver) = driver_or_skip() else { return };
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let origin = format!("http://{}", listener.local_addr().unwrap());
    let daemon = Daemon::for_pages_of(&origin);
    let page = document().replace("http://127.0.0.1:8080", &daemon.url).replace("'town'", "'ball'");
    assert!(page.contains(&daemon.url) && page.contains("'ball'"), "{page}");
    serve(listener, page);
    let browser = Browser::start(&driver, 800, 600);
    browser.open(&origin);
    let frame = "return Number(document.querySelector('canvas').dataset.frame) > 2";
    browser.wait_for("frames of the stream", Duration::from_secs(60), frame);
    let said = browser.script("return document.querySelector('p').textContent");
    assert!(said.as_str().unwrap().contains("pixels show samples"), "{said}");
    let drawn = "const c = document.querySelector('canvas'), d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data; \
        return new Set(Array.from({ length: d.length / 4 }, (_, i) => d[4 * i] >> 4)).size";
    assert!(browser.script(drawn).as_u64().unwrap() > 1, "the picture has one colour");
}
