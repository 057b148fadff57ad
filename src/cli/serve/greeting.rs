//! Messages on standard output after the server has started.

use std::io::Write;
use std::net::SocketAddr;

use crate::engine::Engine;
use crate::load::wire::percent_encoded;

/// The server's addresses.
pub fn greeting(address: SocketAddr, is_tls: bool) -> String {
    let scheme = scheme(is_tls);
    format!("listening on {scheme}://{address}\nviewer: {scheme}://{}/\n", reachable(address))
}

fn scheme(is_tls: bool) -> &'static str {
    if is_tls { "https" } else { "http" }
}

/// A command that gets a first frame; empty if there is no scene.
pub fn example(engine: &Engine, address: SocketAddr, is_tls: bool, has_keys: bool) -> String {
    // The first camera of the first scene, which the viewer also opens with.
    let Some(scene) = engine.scenes().into_iter().next() else { return String::new() };
    let camera = scene.cameras.first();
    let camera = camera.map(|camera| format!("camera={}&", percent_encoded(&camera.name)));
    let key = if has_keys { "-H 'Authorization: Bearer KEY' " } else { "" };
    let url = format!("{}://{}/v1/scenes/{}", scheme(is_tls), reachable(address), scene.id);
    format!("curl {key}-o frame.png '{url}/frame?{}w=1024&h=768'\n", camera.unwrap_or_default())
}

/// The address under which a client on this machine reaches the server.
fn reachable(mut address: SocketAddr) -> SocketAddr {
    if address.ip().is_unspecified() {
        address.set_ip(std::net::Ipv4Addr::LOCALHOST.into());
    }
    address
}

/// Prints a text. The server goes on if its output was closed.
pub fn tell(text: &str) {
    let mut out = std::io::stdout().lock();
    let _ = out.write_all(text.as_bytes()).and_then(|()| out.flush());
}
