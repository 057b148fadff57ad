//! The committed scenes, as users see them.

use super::stage::Case;
use super::verdict::Tolerance;

fn check(scene: &str, cameras: &[&str], tolerance: Tolerance) {
    let case = Case::committed(scene);
    for camera in cameras {
        let began = std::time::Instant::now();
        case.check(&case.view(camera, 200, 150), &tolerance);
        println!("{scene} {camera}: {:.1} s", began.elapsed().as_secs_f64());
    }
}

#[test]
fn town() {
    check("town", &["overview", "square", "street", "above"], Tolerance::default());
}

#[test]
fn relief() {
    check("relief", &["front", "detail", "above"], Tolerance::default());
}

#[test]
fn textured() {
    check("textured", &["front", "detail", "grazing"], Tolerance::default());
}

#[test]
fn plaza() {
    check("plaza", &["overview", "walk", "assembly"], Tolerance::default());
}
