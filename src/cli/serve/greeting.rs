//! What the daemon says on standard output when it has come up.

use std::io::Write;
use std::net::SocketAddr;

use crate::engine::Engine;
use crate::load::wire::percent_encoded;

/// Where the server is.
pub fn greeting(address: SocketAddr) -> String {
    format!("listening on http://{address}\nviewer: http://{}/\n", reachable(address))
}

/// How to see a first frame; nothing where there is no scene.
pub fn example(engine: &Engine, address: SocketAddr, has_keys: bool) -> String {
    // The scene that was loaded first, from its first camera: what the viewer opens with.
    let Some(scene) = engine.scenes().into_iter().next() else { return String::new() };
    let camera = scene.cameras.first();
    let camera = camera.map(|camera| format!("camera={}&", percent_encoded(&camera.name)));
    let key = if has_keys { "-H 'Authorization: Bearer KEY' " } else { "" };
    let url = format!("http://{}/v1/scenes/{}", reachable(address), scene.id);
    format!("curl {key}-o frame.png '{url}/frame?{}w=1024&h=768'\n", camera.unwrap_or_default())
}

/// The address as one on this machine would ask for it.
fn reachable(mut address: SocketAddr) -> SocketAddr {
    if address.ip().is_unspecified() {
        address.set_ip(std::net::Ipv4Addr::LOCALHOST.into());
    }
    address
}

/// Whoever started the daemon may have closed its output; it runs on.
pub fn tell(text: &str) {
    let mut out = std::io::stdout().lock();
    let _ = out.write_all(text.as_bytes()).and_then(|()| out.flush());
}
