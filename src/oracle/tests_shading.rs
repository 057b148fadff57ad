//! Colour, texture and light against values by hand.

use glam::{DAffine3, DVec2, DVec3, Vec2, Vec3};

use super::color::linear_from_srgb8;
use super::tests::{camera, item, points, quad, scene};
use super::visibility::pixel_ray;
use super::*;
use crate::assets::{Encoding, Filter, LEAST_ALPHA, MeshPart, PointCloud, Wrap};

/// A square of edge 2 around the origin, facing +z, with the material.
fn square(material: Option<u32>) -> crate::assets::Mesh {
    square_at(0.0, material)
}

/// As [`square`], around a point of the z axis.
fn square_at(z: f64, material: Option<u32>) -> crate::assets::Mesh {
    let mut square = quad(DVec3::Z * z, DVec3::X, DVec3::Y);
    square.parts = vec![MeshPart { triangles: 2, material }];
    square
}

/// Texture coordinates with the origin at the top left corner.
fn square_uvs(scale: f32) -> Vec<Vec2> {
    [(0.0, 1.0), (1.0, 1.0), (1.0, 0.0), (0.0, 0.0)].map(|(u, v)| Vec2::new(u, v) * scale).to_vec()
}

fn near(a: [f64; 4], b: [f64; 4]) {
    assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-6), "{a:?} {b:?}");
}

#[test]
fn vertex_colours_are_decoded_and_interpolated_in_perspective() {
    let mut tilted = quad(DVec3::ZERO, DVec3::X, DVec3::new(0.0, 1.0, -3.0));
    tilted.colors =
        Some([[0, 0, 0, 255], [255, 0, 0, 255], [255, 0, 0, 255], [0, 0, 0, 255]].to_vec());
    let geometry = Geometry::Mesh(tilted);
    let view = camera([0.3, 0.0, 6.0], [0.0; 3], 25.0).view(40, 40).unwrap();
    let frame = render(&scene(vec![item(&geometry)]), &view, 1);
    let mut seen = 0;
    for i in (0..1600).filter(|&i| frame.id[i] == 1) {
        // Red grows with world x from 0 at −1 to 1 at 1.
        let position = view.view_from_world.transpose()
            * (pixel_ray(&view, i % 40, i / 40) * frame.depth[i])
            + view.eye;
        near(frame.color[i], [(position.x + 1.0) / 2.0, 0.0, 0.0, 1.0]);
        seen += 1;
    }
    assert!(seen > 300, "{seen}");
}

#[test]
fn a_checker_seen_at_an_angle_shows_the_right_squares() {
    let mut tilted = quad(DVec3::ZERO, DVec3::X * 2.0, DVec3::new(0.0, 1.0, -4.0));
    tilted.uvs = Some(square_uvs(1.0));
    tilted.parts = vec![MeshPart { triangles: 2, material: Some(1) }];
    let texel = |x: u32, y: u32| {
        if (x + y).is_multiple_of(2) { [250, 10, 0, 255] } else { [0, 20, 240, 255] }
    };
    let texture = Texture {
        name: String::new(),
        width: 8,
        height: 4,
        rgba: (0..32).map(|i| texel(i % 8, i / 8)).collect(),
        wrap: [Wrap::Repeat; 2],
        filter: Filter::Nearest,
        encoding: Encoding::Srgb,
    };
    let materials =
        [Material::default(), Material { base_texture: Some(0), ..Material::default() }];
    let geometry = Geometry::Mesh(tilted);
    let textures = [texture];
    let textured = OracleItem { materials: &materials, textures: &textures, ..item(&geometry) };
    let view = camera([0.5, 0.2, 7.0], [0.0; 3], 30.0).view(50, 50).unwrap();
    let frame = render(&scene(vec![textured]), &view, 1);
    let found = frame.to_rgba8();
    let mut seen = [0, 0];
    for i in (0..2500).filter(|&i| frame.id[i] == 1) {
        let position = view.view_from_world.transpose()
            * (pixel_ray(&view, i % 50, i / 50) * frame.depth[i])
            + view.eye;
        let place = DVec2::new((position.x + 2.0) * 2.0, (1.0 - position.y) * 2.0);
        if (place - place.round()).abs().min_element() < 1e-6 {
            continue;
        }
        let expected = texel(place.x as u32, place.y as u32);
        assert_eq!(found[i], expected, "pixel {i}");
        seen[(place.x as usize + place.y as usize) % 2] += 1;
    }
    assert!(seen[0] > 200 && seen[1] > 200, "{seen:?}");
}

#[test]
fn minification_blends_to_the_average() {
    let mut far = square(Some(0));
    far.uvs = Some(square_uvs(1.0));
    let size = 64;
    let texture = |filter| Texture {
        name: String::new(),
        width: size,
        height: size,
        rgba: (0..size * size)
            .map(|i| [255 * ((i + i / size) % 2) as u8; 3])
            .map(|[r, g, b]| [r, g, b, 255])
            .collect(),
        wrap: [Wrap::Clamp; 2],
        filter,
        encoding: Encoding::Srgb,
    };
    let materials = [Material { base_texture: Some(0), ..Material::default() }];
    let geometry = Geometry::Mesh(far);
    let textures = [texture(Filter::Linear)];
    let item = OracleItem { materials: &materials, textures: &textures, ..item(&geometry) };
    // The square fills the frame: 64 texels over 16 pixels are four a pixel, level 2, where everything is average.
    let fov = 2.0 * (1.0f64 / 4.0).atan().to_degrees();
    let view = camera([0.0, 0.0, 4.0], [0.0; 3], fov).view(16, 16).unwrap();
    let frame = render(&scene(vec![item]), &view, 1);
    assert!(frame.to_rgba8().iter().all(|&pixel| pixel == [188, 188, 188, 255]));
    // At one texel a pixel it is sharp.
    let view = camera([0.0, 0.0, 4.0], [0.0; 3], fov).view(64, 64).unwrap();
    let frame = render(&scene(vec![item]), &view, 1);
    for (i, pixel) in frame.to_rgba8().into_iter().enumerate() {
        assert_eq!(pixel[0], if (i + i / 64) % 2 == 1 { 255 } else { 0 }, "pixel {i}");
    }
}

#[test]
fn what_alpha_cuts_out_shows_what_is_behind() {
    let mut sheet = square(Some(0));
    sheet.colors = Some(vec![[255, 255, 255, 200]; 4]);
    let sheet = Geometry::Mesh(sheet);
    let wall = Geometry::Mesh(square(None));
    let view = camera([0.0, 0.0, 3.0], [0.0; 3], 30.0).view(4, 4).unwrap();
    for (cutoff, alpha, id) in
        [(Some(0.5), 1.0, 1), (Some(0.5), 0.5, 2), (None, 0.0, 1), (Some(0.9), 1.0, 2)]
    {
        let materials = [Material {
            base_color: [1.0, 0.5, 0.25, alpha],
            alpha_cutoff: cutoff,
            ..Material::default()
        }];
        let behind = DAffine3::from_translation(DVec3::NEG_Z);
        let items = vec![
            OracleItem { materials: &materials, ..item(&sheet) },
            OracleItem { world_from_geometry: behind, instance: 1, ..item(&wall) },
        ];
        let frame = render(&scene(items), &view, 1);
        assert!(frame.id.iter().all(|&found| found == id), "{cutoff:?} {alpha}");
        let expected = if id == 1 { [1.0, 0.5, 0.25, 1.0] } else { [1.0; 4] };
        frame.color.iter().for_each(|&color| near(color, expected));
    }
}

#[test]
fn overrides_replace_what_they_name() {
    let materials = [Material { base_color: [0.5, 0.5, 0.5, 1.0], ..Material::default() }];
    let over = MaterialSpec {
        base_color: Some([0.25, 1.0, 0.0, 1.0]),
        unlit: Some(true),
        ..MaterialSpec::default()
    };
    let view = camera([0.0, 0.0, 3.0], [0.0; 3], 30.0).view(1, 1).unwrap();
    let black = [Light::Ambient { color: [0.0; 3] }];
    let mesh = Geometry::Mesh(square(Some(0)));
    let cloud = points(&[DVec3::ZERO]);
    let grey = linear_from_srgb8(204);
    for (geometry, expected) in [(&mesh, [0.25, 1.0, 0.0]), (&cloud, [0.25 * grey, grey, 0.0])] {
        let laid =
            OracleItem { materials: &materials, override_material: Some(&over), ..item(geometry) };
        let frame = render(&OracleScene { lights: &black, ..scene(vec![laid]) }, &view, 1);
        near(frame.color[0], [expected[0], expected[1], expected[2], 1.0]);
    }
}

/// One sample straight ahead at distance 2 with a normal at 60° to the view, under `lights`.
fn lit(lights: &[Light], normal: Vec3, specular: f32) -> [f64; 4] {
    let geometry = Geometry::Points(PointCloud {
        positions: vec![DVec3::new(1.0, 0.0, -2.0)],
        colors: Some(vec![[255, 188, 0, 255]]),
        normals: Some(vec![normal]),
        ..PointCloud::default()
    });
    let view = camera([1.0, 0.0, 0.0], [1.0, 0.0, -1.0], 30.0).view(1, 1).unwrap();
    let over = MaterialSpec {
        specular: Some([specular, 0.0, specular]),
        shininess: Some(3.0),
        ..MaterialSpec::default()
    };
    let shiny = OracleItem { override_material: Some(&over), ..item(&geometry) };
    render(&OracleScene { lights, ..scene(vec![shiny]) }, &view, 1).color[0]
}

#[test]
fn phong_by_hand() {
    let green = linear_from_srgb8(188);
    let (sin, cos) = 60f32.to_radians().sin_cos();
    let tilted = Vec3::new(sin, 0.0, cos);
    // n·l = ½; the mirrored light makes 120° with the view: no highlight.
    let head = [Light::Headlight { color: [2.0, 1.0, 1.0] }];
    near(lit(&head, tilted, 0.5), [1.0, 0.5 * green, 0.0, 1.0]);
    // Seen from behind, the normal turns towards the eye.
    near(lit(&head, -tilted, 0.5), [1.0, 0.5 * green, 0.0, 1.0]);
    // Head on: n·l = r·v = 1.
    near(lit(&head, Vec3::Z, 0.5), [3.0, green, 0.5, 1.0]);
    // A sun travelling along −x: l = x, n·l = cos 30°, r·v = sin 60°.
    let sun = |x: f64| Light::Sun { direction: DVec3::X * x, color: [1.0; 3], shadows: None };
    let c30 = 0.75f64.sqrt();
    let highlight = 0.5 * c30.powi(3);
    let expected = [c30 + highlight, c30 * green, highlight, 1.0];
    near(lit(&[sun(-1.0)], tilted, 0.5), expected);
    near(lit(&[sun(1.0)], tilted, 0.5), [0.0, 0.0, 0.0, 1.0]);
    // A lamp three away beside the sample, range 3: half is left.
    let position = DVec3::new(4.0, 0.0, -2.0);
    let lamp = Light::Point { position, color: [2.0; 3], range: 3.0, shadows: None };
    near(lit(&[lamp], tilted, 0.5), expected);
    // Ambient adds, and there is no light but it where no other light is.
    let ambient = Light::Ambient { color: [0.5, 0.25, 1.0] };
    near(lit(&[ambient], tilted, 0.5), [0.5, 0.25 * green, 0.0, 1.0]);
    near(lit(&[ambient, sun(1.0)], tilted, 0.5), [0.5, 0.25 * green, 0.0, 1.0]);
    // Without lights or without a normal, the colour as it is.
    near(lit(&[], tilted, 0.5), [1.0, green, 0.0, 1.0]);
    near(lit(&[ambient], Vec3::ZERO, 0.5), [1.0, green, 0.0, 1.0]);
}

#[test]
fn normals_follow_sheared_and_mirrored_transforms() {
    let mut smooth = square(None);
    smooth.normals = Some(vec![Vec3::Z; 4]);
    let view = camera([0.4, 0.3, 6.0], [0.0; 3], 30.0).view(21, 21).unwrap();
    let flat = Geometry::Mesh(square(None));
    let smooth = Geometry::Mesh(smooth);
    let shear = DAffine3::from_mat3(glam::DMat3::from_cols(
        DVec3::new(1.0, 0.0, 0.7),
        DVec3::new(0.2, 1.0, 0.0),
        DVec3::new(3.0, 0.0, 2.0),
    ));
    for transform in [shear, shear * DAffine3::from_scale(DVec3::new(1.0, -1.0, 1.0))] {
        let normal = |geometry| {
            let placed = OracleItem { world_from_geometry: transform, ..item(geometry) };
            render(&scene(vec![placed]), &view, 1).normal[10 * 21 + 10]
        };
        // Interpolated from the vertices, and from the triangle itself.
        assert!((normal(&smooth) - normal(&flat)).length() < 1e-12);
        assert!((normal(&flat).length() - 1.0).abs() < 1e-12 && normal(&flat).z > 0.0);
    }
}

#[test]
fn supersampling_measures_the_area() {
    // The left edge of a square cuts pixels at 0.7 of their width.
    let geometry = Geometry::Mesh(quad(DVec3::new(5.3, 0.0, -1.0), DVec3::X * 5.0, DVec3::Y * 9.0));
    let view = camera([0.0; 3], [0.0, 0.0, -1.0], 90.0).view(2, 2).unwrap();
    let view = View { focal_px: DVec2::ONE, principal_px: DVec2::ONE, ..view };
    let clear = OracleScene { background: [0.0, 0.0, 1.0, 0.0], ..scene(vec![item(&geometry)]) };
    let frame = render(&clear, &view, 10);
    for (i, &[r, g, b, a]) in frame.color.iter().enumerate() {
        let expected = if i % 2 == 0 { 0.0 } else { 0.7 };
        assert!((a - expected).abs() < 1e-12, "{a}");
        // A transparent background lends no colour.
        assert_eq!([r, g, b], if i % 2 == 0 { [0.0; 3] } else { [r; 3] });
    }
    assert_eq!(frame.id, [0, 1, 0, 1]);
}

#[test]
fn frames_do_not_depend_on_the_number_of_threads() {
    let geometry = Geometry::Mesh(quad(DVec3::ZERO, DVec3::new(1.0, 0.4, 0.0), DVec3::Y));
    let cloud: Vec<DVec3> = (0..500)
        .map(|i| DVec3::new(f64::from(i * 37 % 101), f64::from(i * 53 % 97), 0.0) / 50.0 - 1.0)
        .collect();
    let cloud = points(&cloud);
    let items = vec![item(&geometry), OracleItem { instance: 1, ..item(&cloud) }];
    let view = camera([0.4, 0.3, 5.0], [0.0; 3], 30.0).view(37, 29).unwrap();
    let threads = |n| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap();
        pool.install(|| render(&scene(items.clone()), &view, 2))
    };
    assert_eq!(threads(1), threads(5));
}

#[test]
fn translucent_sheets_lie_over_what_is_behind_them() {
    let glass = |grey: f32, alpha| Material {
        base_color: [grey, grey, grey, alpha],
        // It blends, as readers say of materials whose alpha does.
        alpha_cutoff: Some(LEAST_ALPHA),
        translucent: true,
        ..Material::default()
    };
    let wall = Material { base_color: [0.8, 0.8, 0.8, 1.0], ..Material::default() };
    let materials = [glass(1.0, 0.5), glass(0.2, 0.25), wall];
    // The file's order is neither that of depths nor its reverse; the last sheet is behind the wall.
    let sheets = [(0.0, 0), (-1.0, 2), (0.5, 1), (-2.0, 0)];
    let sheets = sheets.map(|(z, number)| Geometry::Mesh(square_at(z, Some(number))));
    let items = |count: usize| {
        let item = |geometry| OracleItem { materials: &materials, ..item(geometry) };
        sheets[..count].iter().map(item).collect()
    };
    let view = camera([0.0, 0.0, 6.0], [0.0; 3], 4.0).view(4, 4).unwrap();
    let frame = render(&scene(items(4)), &view, 1);
    let expected = 0.25 * 0.2 + 0.75 * (0.5 * 1.0 + 0.5 * 0.8);
    for (color, depth) in frame.color.iter().zip(&frame.depth) {
        near(*color, [expected, expected, expected, 1.0]);
        assert!((depth - 5.5).abs() < 1e-9, "glass has a depth: {depth}");
    }
    // Before nothing, what is covered counts: a transparent background stays so in part.
    let alone = OracleScene { background: [0.3, 0.3, 0.3, 0.0], ..scene(items(1)) };
    assert!(render(&alone, &view, 1).color.iter().all(|color| *color == [1.0, 1.0, 1.0, 0.5]));
    let fine = render(&alone, &view, 2);
    assert!(fine.color.iter().all(|color| (color[3] - 0.5).abs() < 1e-12));
}
