use super::*;
use glam::vec3;

const LENS: Lens = Lens { focal_px: vec2(900.0, 800.0), principal_px: vec2(512.0, 300.0) };

fn image(disk: &Disk, cutoff: f32) -> ImageDisk {
    match disk.seen(cutoff, &LENS) {
        Side::Regular(image) => image,
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_disk_that_faces_the_eye_is_a_circle_in_tangents() {
    let disk = Disk { centre: vec3(0.0, 0.0, 4.0), tangents: [Vec3::X * 0.5, Vec3::Y * 0.5] };
    let conic = image(&disk, 2.0).conic();
    assert_eq!(
        (conic.centre_px, conic.radii_px),
        (LENS.principal_px, [vec2(225.0, 0.0), vec2(0.0, 200.0)])
    );
    assert_eq!((conic.min_px, conic.max_px), (vec2(287.0, 100.0), vec2(737.0, 500.0)));
    assert_eq!(conic.variance_px2, [12656.25, 0.0, 10000.0]);
    assert_eq!(conic.root_det_px2, 11250.0);
}

#[test]
fn shape_and_determinant_agree_with_the_dual_conic() {
    let disk = Disk {
        centre: vec3(0.7, -0.4, 3.0),
        tangents: [vec3(0.3, 0.2, 0.6), vec3(-0.1, 0.5, -0.2)],
    };
    let cutoff = 1.5f64;
    let conic = image(&disk, 1.5).conic();
    // C* formed and solved in f64, where nothing of this disk cancels badly.
    let (p, [u, v]) = (disk.centre.as_dvec3(), disk.tangents.map(|t| t.as_dvec3()));
    let c = |i: usize, j: usize| cutoff * cutoff * (u[i] * u[j] + v[i] * v[j]) - p[i] * p[j];
    let (cx, cy) = (c(0, 2) / c(2, 2), c(1, 2) / c(2, 2));
    let (fx, fy, square) = (900.0, 800.0, cutoff * cutoff);
    let near = |a: f32, b: f64| assert!((f64::from(a) - b).abs() <= 1e-5 * b.abs(), "{a} {b}");
    near(conic.centre_px.x, cx * fx + 512.0);
    near(conic.centre_px.y, cy * fy + 300.0);
    near(conic.variance_px2[0], (cx * cx - c(0, 0) / c(2, 2)) * fx * fx / square);
    near(conic.variance_px2[1], (cx * cy - c(0, 1) / c(2, 2)) * fx * fy / square);
    near(conic.variance_px2[2], (cy * cy - c(1, 1) / c(2, 2)) * fy * fy / square);
    let d = p.dot(u.cross(v));
    near(conic.root_det_px2, fx * fy * d.abs() / c(2, 2).abs().powf(1.5));
    let [xx, xy, yy] = conic.variance_px2.map(f64::from);
    near(conic.root_det_px2, (xx * yy - xy * xy).sqrt());
}

#[test]
fn kernel_coordinates_come_back() {
    let disk = Disk {
        centre: vec3(0.7, -0.4, 3.0),
        tangents: [vec3(0.3, 0.2, 0.6), vec3(-0.1, 0.5, -0.2)],
    };
    let image = image(&disk, 2.0);
    for (s, t) in [(0.0, 0.0), (1.0, 0.5), (-1.2, 1.5), (0.3, -2.0)] {
        let hit = disk.centre + disk.tangents[0] * s + disk.tangents[1] * t;
        let pixel = vec2(hit.x / hit.z, hit.y / hit.z) * LENS.focal_px + LENS.principal_px;
        let found = image.kernel_at(pixel).unwrap();
        assert!((found - vec2(s, t)).length() < 2e-6 * 4.0, "{found} {s} {t}");
    }
}

#[test]
fn sides_of_the_camera_plane() {
    let side = |z: f32, reach: f32| {
        let disk = Disk { centre: vec3(0.1, 0.2, z), tangents: [vec3(0.0, 0.0, reach), Vec3::X] };
        disk.seen(2.0, &LENS)
    };
    assert!(matches!(side(1.0, 0.49), Side::Regular(_)));
    assert_eq!(side(-1.0, 0.49), Side::Behind);
    for (z, reach) in [(1.0, 0.5), (-1.0, 0.5), (1.0, 1e30), (0.0, 0.0), (0.0, 1.0), (1e-30, 0.0)] {
        assert_eq!(side(z, reach), Side::Crosses, "{z} {reach}");
    }
    let nothing = Disk { centre: Vec3::ZERO, tangents: [Vec3::ZERO; 2] };
    assert_eq!(nothing.seen(2.0, &LENS), Side::Crosses);
}

#[test]
fn a_disk_seen_exactly_edge_on_covers_nothing_but_has_a_box() {
    let disk = Disk { centre: vec3(0.0, 0.0, 2.0), tangents: [Vec3::X * 0.25, Vec3::Z * 0.25] };
    let image = image(&disk, 2.0);
    let conic = image.conic();
    assert_eq!((conic.root_det_px2, conic.min_px.y, conic.max_px.y), (0.0, 300.0, 300.0));
    assert!(conic.max_px.x > 512.0 + 225.0 && conic.min_px.x < 512.0 - 225.0);
    assert_eq!(image.kernel_at(vec2(520.0, 300.0)), None);
    assert_eq!(image.kernel_at(image.projected_px), None);
}
