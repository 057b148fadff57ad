//! Visibility against closed forms.

use glam::{DAffine3, DVec2, DVec3};

use super::visibility::{SeenTriangle, pixel_ray};
use super::*;
use crate::assets::{Mesh, MeshPart, PointCloud};
use crate::math::Camera;

pub fn camera(eye: [f64; 3], target: [f64; 3], fov_deg: f64) -> Camera {
    Camera::perspective(eye.into(), target.into(), fov_deg)
}

pub fn mesh(positions: &[[f64; 3]], triangles: &[[u32; 3]]) -> Mesh {
    let positions = positions.iter().map(|&p| p.into()).collect();
    Mesh { positions, triangles: triangles.to_vec(), ..Mesh::default() }
}

/// A rectangle of two triangles around `centre`, counter-clockwise seen from where `right × up` points.
pub fn quad(centre: DVec3, right: DVec3, up: DVec3) -> Mesh {
    let corner = |x: f64, y: f64| (centre + right * x + up * y).into();
    let corners = [corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)];
    mesh(&corners, &[[0, 1, 2], [0, 2, 3]])
}

pub fn points(positions: &[DVec3]) -> Geometry {
    Geometry::Points(PointCloud { positions: positions.to_vec(), ..PointCloud::default() })
}

pub fn item(geometry: &Geometry) -> OracleItem<'_> {
    OracleItem {
        geometry,
        world_from_geometry: DAffine3::IDENTITY,
        materials: &[],
        textures: &[],
        override_material: None,
        instance: 0,
    }
}

pub fn scene<'a>(items: Vec<OracleItem<'a>>) -> OracleScene<'a> {
    OracleScene {
        items,
        lights: &[],
        shadows: false,
        background: [0.0, 0.0, 0.0, 1.0],
        splats: None,
        painted: None,
        pull_push: None,
        discs: None,
        least_line_px: 0.0,
        recolor: None,
        clip: None,
        edl: None,
        surroundings: None,
        fog: None,
        occlusion: None,
        tone: None,
    }
}

/// Vertices and triangles of a unit ball, `rows` × 2·`rows` facets.
fn ball(rows: u32) -> Mesh {
    let columns = 2 * rows;
    let vertex = |i: u32| {
        let (row, column) = (f64::from(i / columns), f64::from(i % columns));
        let (polar, turn) = (
            row / f64::from(rows) * std::f64::consts::PI,
            column / f64::from(columns) * std::f64::consts::TAU,
        );
        [polar.sin() * turn.cos(), polar.cos(), -polar.sin() * turn.sin()]
    };
    let positions: Vec<[f64; 3]> = (0..(rows + 1) * columns).map(vertex).collect();
    let mut triangles = vec![];
    for row in 0..rows {
        for column in 0..columns {
            let next = (column + 1) % columns;
            let (a, b) = (row * columns + column, row * columns + next);
            let (c, d) = (a + columns, b + columns);
            triangles.extend([[a, c, b], [b, c, d]]);
        }
    }
    mesh(&positions, &triangles)
}

#[test]
fn a_sample_covers_the_pixel_it_projects_into() {
    let view = camera([1.0, 2.0, 5.0], [0.0; 3], 50.0).view(40, 30).unwrap();
    let world = |x: f64, y: f64, depth: f64| {
        view.eye + view.view_from_world.transpose() * (view.ray(DVec2::new(x, y)) * depth)
    };
    let inside = [world(3.01, 4.99, 2.0), world(39.9, 29.9, 7.0)];
    let outside = [world(-0.01, 4.0, 2.0), world(40.01, 4.0, 2.0), world(8.0, 30.01, 2.0)];
    let behind = [world(8.0, 8.0, -2.0), view.eye, DVec3::splat(f64::NAN)];
    let geometry = points(&[&inside[..], &outside, &behind].concat());
    let frame = render(&scene(vec![item(&geometry)]), &view, 1);
    for (i, &depth) in frame.depth.iter().enumerate() {
        match (i % 40, i / 40) {
            (3, 4) => assert!((depth - 2.0).abs() < 1e-12),
            (39, 29) => assert!((depth - 7.0).abs() < 1e-12),
            _ => assert_eq!(depth, f64::INFINITY),
        }
        assert_eq!(frame.id[i] == 1, depth.is_finite());
    }
    assert_eq!(frame.to_rgba8()[4 * 40 + 3], [204, 204, 204, 255]);
    assert_eq!(frame.to_rgba8()[0], [0, 0, 0, 255]);
    // Samples fill their pixels whatever the supersampling.
    assert_eq!(render(&scene(vec![item(&geometry)]), &view, 3).to_rgba8(), frame.to_rgba8());
}

#[test]
fn the_nearest_wins_and_ties_go_to_the_lower_number() {
    let view = camera([0.0; 3], [0.0, 0.0, -1.0], 60.0).view(1, 1).unwrap();
    let colored = |depths: &[f64]| {
        let positions = depths.iter().map(|&depth| DVec3::new(0.0, 0.0, -depth)).collect();
        let colors = (0..depths.len()).map(|i| [i as u8, 0, 0, 255]).collect();
        Geometry::Points(PointCloud { positions, colors: Some(colors), ..PointCloud::default() })
    };
    let (far, tied) = (colored(&[9.0, 3.0, 4.0, 3.0]), colored(&[5.0, 3.0]));
    for (first, second, id, red) in [(7, 2, 3, 1), (2, 7, 3, 1), (5, 5, 6, 1)] {
        let items = vec![
            OracleItem { instance: first, ..item(&far) },
            OracleItem { instance: second, ..item(&tied) },
        ];
        let frame = render(&scene(items), &view, 1);
        assert_eq!((frame.depth[0], frame.id[0]), (3.0, id));
        assert_eq!(frame.to_rgba8()[0][0], red);
    }
}

#[test]
fn a_planes_depth_is_exact_at_every_pixel() {
    let view = camera([1.0, 2.0, 5.0], [0.2, 0.1, 0.0], 40.0).view(64, 48).unwrap();
    let (right, up) = (DVec3::new(40.0, 3.0, 9.0), DVec3::new(-3.0, 40.0, -20.0));
    let geometry = Geometry::Mesh(quad(DVec3::new(0.0, 0.0, -1.0), right, up));
    let frame = render(&scene(vec![item(&geometry)]), &view, 1);
    let normal = right.cross(up).normalize_or_zero();
    let normal_view = view.view_from_world * normal;
    let offset = normal_view.dot(view.to_view(DVec3::new(0.0, 0.0, -1.0)));
    for (i, &depth) in frame.depth.iter().enumerate() {
        let expected = offset / normal_view.dot(pixel_ray(&view, i % 64, i / 64));
        assert!((depth / expected - 1.0).abs() < 1e-12, "pixel {i}: {depth} {expected}");
        assert!((frame.normal[i] - normal).length() < 1e-12);
    }
}

#[test]
fn a_balls_silhouette_is_right_within_a_pixel() {
    let view = camera([2.0, 1.0, 4.0], [0.1, 0.0, 0.0], 35.0).view(96, 80).unwrap();
    let geometry = Geometry::Mesh(ball(96));
    let frame = render(&scene(vec![item(&geometry)]), &view, 1);
    let centre = view.to_view(DVec3::ZERO);
    // Half the chord in which the ray through an image position meets the ball, squared; negative beside it.
    let inside = |x: f64, y: f64| {
        let ray = view.ray(DVec2::new(x, y)).normalize_or_zero();
        1.0 - (centre.length_squared() - ray.dot(centre).powi(2))
    };
    let mut checked = [0, 0];
    for (i, &depth) in frame.depth.iter().enumerate() {
        let (x, y) = ((i % 96) as f64 + 0.5, (i / 96) as f64 + 0.5);
        let around: Vec<f64> =
            [(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, -1), (1, -1), (-1, 1)]
                .map(|(dx, dy)| inside(x + f64::from(dx), y + f64::from(dy)))
                .to_vec();
        if around.iter().all(|&chord| chord > 0.0) {
            let ray = view.ray(DVec2::new(x, y));
            let t = ray.normalize_or_zero().dot(centre) - around[0].sqrt();
            assert!((depth - t / ray.length()).abs() < 5e-3, "pixel {i}: {depth}");
            checked[0] += 1;
        } else if around.iter().all(|&chord| chord < 0.0) {
            assert_eq!(depth, f64::INFINITY, "pixel {i}");
            checked[1] += 1;
        }
    }
    assert!(checked[0] > 1000 && checked[1] > 1000, "{checked:?}");
}

#[test]
fn a_ball_is_covered_twice_and_its_front_once() {
    // Every ray that meets the closed surface enters and leaves exactly once, also through edges and vertices: the
    // eye on the axis makes many rays hit them.
    for (eye, target) in [([0.0, 0.0, 4.0], [0.0; 3]), ([0.3, 3.9, 0.7], [0.01, 0.0, 0.0])] {
        let view = camera(eye, target, 40.0).view(65, 65).unwrap();
        let solid = ball(16);
        let seen: Vec<SeenTriangle> = solid
            .triangles
            .iter()
            .filter_map(|t| {
                SeenTriangle::new(
                    t.map(|i| view.to_view(solid.positions[i as usize])),
                    view.projection,
                )
            })
            .collect();
        let mut covered = 0;
        for i in 0..65 * 65 {
            let ray = pixel_ray(&view, i % 65, i / 65);
            let count = seen.iter().filter(|triangle| triangle.covers(ray)).count();
            assert!(count == 0 || count == 2, "pixel {i} is covered {count} times");
            covered += count / 2;
        }
        assert!(covered > 700, "{covered}");
    }
}

#[test]
fn a_fan_covers_every_pixel_once() {
    // The hub and several rim points project onto pixel centres exactly.
    let view = camera([0.0; 3], [0.0, 0.0, -1.0], 90.0).view(31, 31).unwrap();
    let rim: Vec<DVec3> = [(0, 0), (9, 0), (31, 0), (31, 17), (31, 31), (12, 31), (0, 31), (0, 8)]
        .map(|(x, y)| {
            let depth = 1.0 + f64::from(x * y % 7);
            view.ray(DVec2::new(f64::from(x) * 1.2 - 2.5, f64::from(y) * 1.2 - 2.5)) * depth
        })
        .to_vec();
    let hubs = [(15, 15), (3, 20), (30, 0)].map(|(x, y)| pixel_ray(&view, x, y) * 3.0);
    for hub in hubs {
        let fan: Vec<SeenTriangle> = (0..rim.len())
            .filter_map(|i| {
                SeenTriangle::new([hub, rim[i], rim[(i + 1) % rim.len()]], view.projection)
            })
            .collect();
        assert_eq!(fan.len(), rim.len());
        for i in 0..31 * 31 {
            let ray = pixel_ray(&view, i % 31, i / 31);
            let count = fan.iter().filter(|triangle| triangle.covers(ray)).count();
            assert_eq!(count, 1, "pixel {} {}", i % 31, i / 31);
        }
    }
}

#[test]
fn a_triangle_through_the_camera_plane_needs_no_clipping() {
    // A floor one below the eye that reaches behind it.
    let view = camera([0.0; 3], [0.0, 0.0, -1.0], 80.0).view(48, 48).unwrap();
    let floor = mesh(&[[-1e3, -1.0, 1e3], [1e3, -1.0, 1e3], [0.0, -1.0, -1e3]], &[[0, 1, 2]]);
    let geometry = Geometry::Mesh(floor);
    let frame = render(&scene(vec![item(&geometry)]), &view, 1);
    let mut seen = 0;
    for (i, &depth) in frame.depth.iter().enumerate() {
        let ray = pixel_ray(&view, i % 48, i / 48);
        let expected = -1.0 / ray.y;
        let half_width = 0.5 * (1e3 - expected);
        if ray.y < 0.0 && (ray.x * expected).abs() < half_width - 1e-6 {
            assert!((depth / expected - 1.0).abs() < 1e-9, "pixel {i}: {depth} {expected}");
            assert!((frame.normal[i] - DVec3::Y).length() < 1e-9);
            seen += 1;
        } else if ray.y > 0.0 {
            assert_eq!(depth, f64::INFINITY, "pixel {i} looks up");
        }
    }
    assert_eq!(seen, 48 * 24);
    // Behind the eye altogether, and edge-on.
    for corners in [
        [[-1.0, -1.0, 2.0], [1.0, -1.0, 2.0], [0.0, 1.0, 2.0]],
        [[0.0, 0.0, -1.0], [0.0, 0.0, -2.0], [5.0, 0.0, -2.0]],
    ] {
        let geometry = Geometry::Mesh(mesh(&corners, &[[0, 1, 2]]));
        let frame = render(&scene(vec![item(&geometry)]), &view, 1);
        assert!(frame.id.iter().all(|&id| id == 0));
    }
}

#[test]
fn single_sided_triangles_are_culled_from_behind_and_mirrors_flip_them() {
    let view = camera([0.0, 0.0, 3.0], [0.0; 3], 40.0).view(9, 9).unwrap();
    let mut front = quad(DVec3::ZERO, DVec3::X, DVec3::Y);
    front.parts = vec![MeshPart { triangles: 2, material: Some(0) }];
    let mut back = front.clone();
    back.triangles.iter_mut().for_each(|triangle| triangle.swap(1, 2));
    let single = [Material { double_sided: false, ..Material::default() }];
    let mirror = DAffine3::from_scale(DVec3::new(-1.0, 1.0, 1.0));
    for (mesh, transform, visible) in [
        (&front, DAffine3::IDENTITY, true),
        (&back, DAffine3::IDENTITY, false),
        (&front, mirror, true),
        (&back, mirror, false),
        (&front, DAffine3::from_rotation_y(std::f64::consts::PI), false),
    ] {
        let geometry = Geometry::Mesh(mesh.clone());
        let mut placed =
            OracleItem { world_from_geometry: transform, materials: &single, ..item(&geometry) };
        assert_eq!(render(&scene(vec![placed]), &view, 1).id[40] == 1, visible);
        let over = MaterialSpec { double_sided: Some(true), ..MaterialSpec::default() };
        placed.override_material = Some(&over);
        assert_eq!(render(&scene(vec![placed]), &view, 1).id[40], 1);
    }
}

#[test]
fn instanced_equals_flattened_even_far_from_the_origin() {
    let far = DVec3::new(4.5e6, 1.2e7, -3.25e5);
    let transform = DAffine3::from_translation(far)
        * DAffine3::from_rotation_z(0.3)
        * DAffine3::from_scale(DVec3::new(1.0, -2.0, 0.5));
    let local = ball(12);
    let mut flat = local.clone();
    flat.positions.iter_mut().for_each(|p| *p = transform.transform_point3(*p));
    let near_view = camera([2.0, 1.0, 5.0], [0.0; 3], 40.0).view(33, 33).unwrap();
    let view = View { eye: near_view.eye + far, ..near_view };
    let (local, flat) = (Geometry::Mesh(local), Geometry::Mesh(flat));
    let placed = OracleItem { world_from_geometry: transform, ..item(&local) };
    let instanced = render(&scene(vec![placed]), &view, 1);
    let flattened = render(&scene(vec![item(&flat)]), &view, 1);
    // At the origin, the same picture: nothing is lost to the distance.
    let at_origin = DAffine3 { translation: DVec3::ZERO, ..transform };
    let origin = OracleItem { world_from_geometry: at_origin, ..item(&local) };
    let origin = render(&scene(vec![origin]), &near_view, 1);
    assert_eq!(instanced, origin);
    assert!(instanced.id.iter().filter(|&&id| id == 1).count() > 100);
    let differing = (0..33 * 33)
        .filter(|&i| (instanced.depth[i] / flattened.depth[i] - 1.0).abs() > 1e-7)
        .count();
    assert_eq!(differing, 0);
}
