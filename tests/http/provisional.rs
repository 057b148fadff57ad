//! Frames of a cloud whose normals and kernels are being estimated have no entity tag and are not cacheable until they are final.

use std::sync::Arc;

use axum::body::Body;
use axum::http::{HeaderMap, Request, Response};
use pointillist::engine::{Engine, EngineConfig, EstimateState, Latch};
use pointillist::http::{App, Phase, router};
use tower::ServiceExt;

use super::lifecycle::settings;

#[test]
fn provisional_frames_have_no_tag_and_final_ones_have() {
    let folder = tempfile::tempdir().unwrap();
    let latch = Arc::new(Latch::default());
    let mut config = EngineConfig::new(folder.path());
    config.estimate_at_once = 100;
    config.bake_latch = Some(latch.clone());
    let engine = Engine::start(config).unwrap();
    let mut ply = String::from("ply\nformat ascii 1.0\nelement vertex 400\n");
    ply += "property float x\nproperty float y\nproperty float z\n";
    ply += "property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n";
    for i in 0..400 {
        ply += &format!("{} {} 0 200 {} 90\n", i % 20, i / 20, i % 256);
    }
    std::fs::write(folder.path().join("cloud.ply"), ply).unwrap();
    engine.load("cloud", &folder.path().join("cloud.ply")).unwrap();
    let app = App::new(engine.clone(), settings(folder.path()), Err("no jobs here".to_owned()));
    app.set_phase(Phase::Serving);
    let router = router(app);
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let ask = |method: &str, query: &str, known: Option<&str>| -> Response<Body> {
        let mut request = Request::builder()
            .method(method)
            .uri(format!("/v1/scenes/cloud/frame?w=160&h=120&{query}"))
            .header("host", "localhost");
        if let Some(tag) = known {
            request = request.header("if-none-match", tag);
        }
        let request = request.body(Body::empty()).unwrap();
        runtime.block_on(router.clone().oneshot(request)).unwrap()
    };
    let text = |headers: &HeaderMap, name: &str| {
        headers.get(name).map(|value| value.to_str().unwrap().to_owned())
    };
    for method in ["GET", "HEAD"] {
        let answer = ask(method, "format=png", Some("*"));
        assert_eq!(answer.status(), 200, "{method}");
        assert_eq!(text(answer.headers(), "etag"), None, "{method}");
        assert_eq!(text(answer.headers(), "cache-control").unwrap(), "no-store", "{method}");
    }
    let warning = text(ask("GET", "", None).headers(), "pointillist-warning").unwrap();
    assert!(warning.contains("provisional") && warning.contains("wait=complete"), "{warning}");
    let receipt = text(ask("GET", "", None).headers(), "pointillist-receipt").unwrap();
    assert!(receipt.contains("normals and kernels are being estimated"), "{receipt}");
    // A request that waits ends at its deadline.
    for query in ["wait=complete&deadline_ms=30", "reconstruct=splats&deadline_ms=30"] {
        let status = ask("GET", query, None).status().as_u16();
        assert!([503, 504].contains(&status), "{query}: {status}");
    }
    assert_eq!(ask("GET", "wait=forever", None).status(), 422);
    latch.open();
    let last = ask("GET", "format=png&wait=complete", None);
    assert_eq!(engine.scene("cloud").unwrap().estimates.state, EstimateState::Complete);
    let tag = text(last.headers(), "etag").unwrap();
    let same = ask("GET", "format=png", None);
    assert_eq!(text(same.headers(), "pointillist-warning"), None);
    assert_eq!(text(same.headers(), "etag").unwrap(), tag, "waiting makes no other picture");
    assert!(!text(same.headers(), "pointillist-receipt").unwrap().contains("estimated ("));
    assert_eq!(ask("GET", "format=png", Some(&tag)).status(), 304);
}
