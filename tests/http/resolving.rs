//! Requests are resolved once, and resolving bakes nothing.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use axum::body::{Body, to_bytes};
use axum::http::{Request, StatusCode};
use pointillist::engine::{Engine, EngineConfig, Latch};
use pointillist::http::{App, Phase, router};
use tempfile::TempDir;
use tower::ServiceExt;

use super::daemon::eventually;
use super::lifecycle::settings;

/// An engine with a scene `cloud`, and the HTTP service over it.
fn service(adjust: impl FnOnce(&mut EngineConfig)) -> (TempDir, Engine, axum::Router) {
    let folder = tempfile::tempdir().unwrap();
    let mut config = EngineConfig::new(folder.path());
    adjust(&mut config);
    let engine = Engine::start(config).unwrap();
    for (name, side) in [("cloud.xyz", 20), ("other.xyz", 40)] {
        let points = (0..side * side).map(|i| format!("{} {} 0\n", i % side, i / side));
        std::fs::write(folder.path().join(name), points.collect::<String>()).unwrap();
    }
    engine.load("cloud", &folder.path().join("cloud.xyz")).unwrap();
    let app = App::new(engine.clone(), settings(folder.path()), Err("no jobs here".to_owned()));
    app.set_phase(Phase::Serving);
    (folder, engine, router(app))
}

fn request(method: &str, path: &str) -> axum::http::request::Builder {
    Request::builder().method(method).uri(path).header("host", "localhost")
}

#[tokio::test]
async fn a_request_is_resolved_once() {
    let resolved = Arc::<AtomicUsize>::default();
    let counted = resolved.clone();
    let (_folder, _engine, router) = service(|config| {
        config.resolve_hook = Some(Arc::new(move || {
            counted.fetch_add(1, Ordering::Relaxed);
        }));
    });
    const FRAME: &str = "/v1/scenes/cloud/frame?w=32&h=24&format=png";
    let send = async |request: Request<Body>| {
        let answer = router.clone().oneshot(request).await.unwrap();
        let (head, body) = answer.into_parts();
        let body = to_bytes(body, usize::MAX).await.unwrap();
        (head, body, resolved.swap(0, Ordering::Relaxed))
    };
    let (head, _, count) = send(request("GET", FRAME).body(Body::empty()).unwrap()).await;
    assert_eq!((head.status, count), (StatusCode::OK, 1));
    let tag = head.headers["etag"].clone();
    let known = request("GET", FRAME).header("if-none-match", tag).body(Body::empty()).unwrap();
    let (head, _, count) = send(known).await;
    assert_eq!((head.status, count), (StatusCode::NOT_MODIFIED, 1));
    let (_, _, count) = send(request("HEAD", FRAME).body(Body::empty()).unwrap()).await;
    assert_eq!(count, 1);
    let poses = request("POST", "/v1/scenes/cloud/frames")
        .header("content-type", "application/json")
        .body(Body::from(r#"{"w": 32, "h": 24, "poses": [{}, {"fov": 30}, {"fov": 40}]}"#));
    let (head, _, count) = send(poses.unwrap()).await;
    assert_eq!((head.status, count), (StatusCode::OK, 3));
}

/// A frame that waits for a bake fails when its scene is removed. A frame of the next scene waits for that scene's bake.
#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn frames_that_wait_for_a_bake_end_with_their_scene() {
    let latch = Arc::new(Latch::default());
    let (folder, engine, router) = service(|config| config.bake_latch = Some(latch.clone()));
    const FRAME: &str = "/v1/scenes/cloud/frame?w=32&h=24&lod=spt&color_by=levels";
    let ask = || {
        let request = request("GET", FRAME).body(Body::empty()).unwrap();
        tokio::spawn(router.clone().oneshot(request))
    };
    let wait = async |waiters: usize| {
        while engine.bake_waiters() != waiters {
            tokio::task::yield_now().await;
        }
    };
    let first = ask();
    wait(1).await;
    let delete = request("DELETE", "/v1/scenes/cloud").body(Body::empty()).unwrap();
    assert!(router.clone().oneshot(delete).await.unwrap().status().is_success());
    assert_eq!(first.await.unwrap().unwrap().status(), StatusCode::NOT_FOUND);
    let (other, file) = (engine.clone(), folder.path().join("other.xyz"));
    tokio::task::spawn_blocking(move || other.load("cloud", &file).unwrap()).await.unwrap();
    let second = ask();
    wait(1).await;
    latch.open();
    assert_eq!(second.await.unwrap().unwrap().status(), StatusCode::OK);
    eventually("the end of the bakes", || engine.bakes_running() == 0);
}
