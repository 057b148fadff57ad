use super::*;

fn camera() -> Camera {
    Camera::perspective(DVec3::new(1.0, 2.0, 5.0), DVec3::new(0.5, 1.0, 0.0), 40.0)
}

#[test]
fn target_projects_to_the_centre() {
    let view = camera().view(640, 480).unwrap();
    let p = view.project(view.to_view(camera().target)).unwrap();
    assert!((p - DVec2::new(320.0, 240.0)).length() < 1e-9);
}

#[test]
fn ray_inverts_project() {
    let view = camera().view(640, 480).unwrap();
    let pixel = DVec2::new(17.25, 400.5);
    let back = view.project(view.ray(pixel) * 7.0).unwrap();
    assert!((back - pixel).length() < 1e-9);
}

#[test]
fn matrices_agree_with_the_pose() {
    let (w, h) = (640, 480);
    let view = camera().view(w, h).unwrap();
    let m = DMat4::from(view.view_affine());
    let f = 1.0 / (20.0f64.to_radians()).tan();
    let aspect = f64::from(w) / f64::from(h);
    let proj = DMat4::from_cols(
        DVec4::new(f / aspect, 0.0, 0.0, 0.0),
        DVec4::new(0.0, f, 0.0, 0.0),
        DVec4::new(0.2, -0.1, -1.0, -1.0),
        DVec4::new(0.0, 0.0, -0.1, 0.0),
    );
    let other = View::from_matrices(m, proj, w, h).unwrap();
    let p = DVec3::new(0.3, 0.9, -0.5);
    let clip = proj * m * p.extend(1.0);
    let ndc = clip.truncate() / clip.w;
    let expected = DVec2::new((ndc.x + 1.0) * 320.0, (1.0 - ndc.y) * 240.0);
    let found = other.project(other.to_view(p)).unwrap();
    assert!((found - expected).length() < 1e-9, "{found} {expected}");
}

fn orthographic(height: f64) -> Camera {
    Camera { lens: Lens::Orthographic { height }, ..camera() }
}

#[test]
fn parallel_rays_give_the_same_size_at_every_depth() {
    let view = orthographic(2.0).view(640, 480).unwrap();
    assert_eq!(
        (view.focal_px, view.focus),
        (DVec2::splat(240.0), camera().eye.distance(camera().target))
    );
    for depth in [1e-9, 1.0, 1e9] {
        let pixel = view.project(DVec3::new(1.0, 0.5, -depth)).unwrap();
        assert_eq!(pixel, DVec2::new(560.0, 120.0));
        let back = view.project(view.at_depth(view.ray(pixel), depth)).unwrap();
        assert!((back - pixel).length() < 1e-9);
    }
    assert_eq!(view.project(DVec3::new(0.0, 0.0, 1.0)), None, "behind the eye");
}

#[test]
fn projections_show_as_much_at_the_target() {
    let flat = camera().with_projection(Projection::Orthographic);
    let beside = |camera: &Camera| {
        let view = camera.view(640, 480).unwrap();
        let target = view.to_view(camera.target);
        view.project(target + DVec3::new(0.3, 0.2, 0.0)).unwrap()
    };
    assert!((beside(&flat) - beside(&camera())).length() < 1e-9);
    let back = flat.with_projection(Projection::Perspective).lens.fov_deg().unwrap();
    assert!((back - 40.0).abs() < 1e-9);
    assert_eq!(flat.with_projection(Projection::Orthographic), flat);
    assert_eq!(orthographic(3.0).for_frame(300, 900).lens.ortho_height(), Some(9.0));
}

#[test]
fn orthographic_matrices_agree_with_the_pose() {
    let (w, h) = (640, 480);
    let view = orthographic(3.0).view(w, h).unwrap();
    let m = DMat4::from(view.view_affine());
    let proj = DMat4::from_cols(
        DVec4::new(0.5, 0.0, 0.0, 0.0),
        DVec4::new(0.0, 2.0 / 3.0, 0.0, 0.0),
        DVec4::new(0.0, 0.0, -0.1, 0.0),
        DVec4::new(0.25, -0.5, -1.0, 1.0),
    );
    let other = View::from_matrices(m, proj, w, h).unwrap();
    assert_eq!(other.projection, Projection::Orthographic);
    let p = DVec3::new(0.3, 0.9, -0.5);
    let ndc = (proj * m * p.extend(1.0)).truncate();
    let expected = DVec2::new((ndc.x + 1.0) * 320.0, (1.0 - ndc.y) * 240.0);
    assert!((other.project(other.to_view(p)).unwrap() - expected).length() < 1e-9);
    assert!((other.focal_px - view.focal_px).length() < 1e-9);
    let sheared = DMat4 { z_axis: DVec4::new(0.1, 0.0, -0.1, 0.0), ..proj };
    assert_eq!(View::from_matrices(m, sheared, w, h).unwrap_err().parameter, "proj");
}

#[test]
fn narrow_frames_show_as_much_of_the_width() {
    let corner = |width, height| {
        let view = camera().for_frame(width, height).view(width, height).unwrap();
        let square = camera().view(width, width).unwrap();
        (view.focal_px, square.focal_px)
    };
    let (found, expected) = corner(390, 844);
    assert!((found - expected).length() < 1e-9, "{found} {expected}");
    assert_eq!(camera().for_frame(640, 480), camera());
    assert_eq!(camera().for_frame(480, 480), camera());
    assert_eq!(camera().for_frame(1, 257).lens.fov_deg(), Some(100.0));
    let wide = Camera { lens: Lens::Perspective { fov_deg: 179.0 }, ..camera() };
    assert_eq!(wide.for_frame(1, 257), wide);
}

#[test]
fn bad_poses_name_their_parameter() {
    let mut c = camera();
    for fov_deg in [180.0, 179.999_999_999, 1e-7, 5e-324, 0.0, f64::NAN] {
        c.lens = Lens::Perspective { fov_deg };
        assert_eq!(c.view(8, 8).unwrap_err().parameter, "fov");
    }
    for fov_deg in FOV_RANGE_DEG {
        c.lens = Lens::Perspective { fov_deg };
        c.view(8, 8).unwrap();
    }
    for height in [0.0, -1.0, 1e16, f64::NAN] {
        c.lens = Lens::Orthographic { height };
        assert_eq!(c.view(8, 8).unwrap_err().parameter, "ortho_height");
    }
    let mut c = camera();
    c.target = c.eye;
    assert_eq!(c.view(8, 8).unwrap_err().parameter, "target");
    let mut c = camera();
    c.up = DVec3::ZERO;
    assert_eq!(c.view(8, 8).unwrap_err().parameter, "up");
    let mut c = camera();
    c.eye.x = f64::NAN;
    assert_eq!(c.view(8, 8).unwrap_err().parameter, "eye");
}

#[test]
fn looking_along_up_is_drawn() {
    let c = Camera::perspective(DVec3::Y, DVec3::ZERO, 60.0);
    let view = c.view(8, 8).unwrap();
    assert!(view.view_from_world.is_finite());
}
