//! Shadows of suns and lamps against closed forms.

use glam::{DVec2, DVec3, Vec2};

use super::prepare::Prepared;
use super::tests::{item, points, quad, scene};
use super::tests_splats::{cloud, sharp, view};
use super::visibility::pixel_ray;
use super::*;
use crate::assets::{
    Clip, ClipLine, Encoding, Filter, Mesh, MeshPart, PointCloud, Polylines, Wrap,
};
use crate::scene::{Blend, Filter as SplatFilter};

/// A place on the Earth in metres, as surveys have them.
const UTM: DVec3 = DVec3::new(4e5, 5.6e6, 312.0);

fn sun(direction: DVec3, angle_deg: f64) -> [Light; 1] {
    let direction = direction.normalize_or_zero();
    [Light::Sun { direction, color: [1.0; 3], shadows: Some(angle_deg) }]
}

/// The level square of 2 × 2 around `centre`.
fn square(centre: DVec3) -> Mesh {
    quad(centre, DVec3::X, DVec3::NEG_Z)
}

/// A large level square through `base`.
fn ground(base: DVec3) -> Geometry {
    Geometry::Mesh(quad(base + DVec3::NEG_Z * 5.0, DVec3::X * 30.0, DVec3::NEG_Z * 30.0))
}

/// Shares of the scene's first light at places, seen by an eye at `eye`.
fn shares(scene: &OracleScene<'_>, eye: DVec3, places: &[DVec3]) -> Vec<f64> {
    let view = View { eye, ..view() };
    let scene = OracleScene { shadows: true, ..scene.clone() };
    let prepared = Prepared::new(&scene, &view);
    let share = |&place: &DVec3| {
        let position = view.to_view(place);
        let material = Material::default();
        let surface = surface::surface([1.0; 4], (&view, position), DVec3::Y, &material);
        prepared.lit_share(&surface, &scene.lights[0])
    };
    places.iter().map(share).collect()
}

/// The shares along the x axis of the ground, at depth z = −5.
fn shares_along_x(scene: &OracleScene<'_>, xs: &[f64]) -> Vec<f64> {
    let places: Vec<DVec3> = xs.iter().map(|&x| DVec3::new(x, 0.0, -5.0)).collect();
    shares(scene, DVec3::Y * 4.0, &places)
}

#[test]
fn a_square_casts_a_square_of_the_same_size_wherever_the_scene_lies() {
    for base in [DVec3::ZERO, UTM] {
        let (plane, caster) =
            (ground(base), Geometry::Mesh(square(base + DVec3::new(0.3, 2.0, -5.0))));
        // Moved by half the height along x and a quarter of it along z.
        let lights = sun(DVec3::new(1.0, -2.0, 0.5), 0.0);
        let lit = OracleScene { lights: &lights, ..scene(vec![item(&plane), item(&caster)]) };
        let middle = base + DVec3::new(1.3, 0.0, -4.5);
        let offsets = [-5.0, -1.5, -1.00001, -0.99999, -0.4, 0.0, 0.7, 0.99999, 1.00001, 3.0];
        let places = offsets.iter().flat_map(|&x| offsets.map(|z| middle + DVec3::new(x, 0.0, z)));
        let places: Vec<DVec3> = places.collect();
        let found = shares(&lit, base + DVec3::new(0.0, 4.0, 0.5), &places);
        for (place, share) in places.iter().zip(found) {
            let away = (*place - middle).abs();
            let is_inside = away.x < 1.0 && away.z < 1.0;
            assert_eq!(share, if is_inside { 0.0 } else { 1.0 }, "{away} at {base}");
        }
    }
}

#[test]
fn the_penumbra_of_an_edge_has_the_profile_of_the_suns_disc() {
    let plane = ground(DVec3::ZERO);
    let height = 2.0;
    let lights = sun(DVec3::NEG_Y, 10.0);
    let radius = height * 5f64.to_radians().tan();
    // The edge is the z axis, or the line x = −z − 5.
    for turned in [false, true] {
        let diagonal = 0.5f64.sqrt();
        let out = if turned { DVec3::new(diagonal, 0.0, diagonal) } else { DVec3::X };
        let along = out.cross(DVec3::Y);
        let origin = DVec3::new(0.0, height, -5.0);
        let caster = Geometry::Mesh(quad(origin - out * 20.0, out * 20.0, along * 20.0));
        let lit = OracleScene { lights: &lights, ..scene(vec![item(&plane), item(&caster)]) };
        let steps: Vec<f64> = (-120..=120).map(|i| f64::from(i) / 100.0).collect();
        let place = |step: &f64| DVec3::NEG_Z * 5.0 + out * (step * radius);
        let places: Vec<DVec3> = steps.iter().map(place).collect();
        let found = shares(&lit, DVec3::Y * 4.0, &places);
        let mut sum = 0.0;
        for (step, share) in steps.iter().zip(&found) {
            let a = step.clamp(-1.0, 1.0);
            let expected = 0.5 + (a * (1.0 - a * a).sqrt() + a.asin()) / std::f64::consts::PI;
            assert!((share - expected).abs() < 0.02, "{step}: {share} instead of {expected}");
            if step.abs() >= 1.0 {
                assert_eq!(*share, expected);
            }
            sum += (share - expected).abs();
        }
        assert!(sum / (steps.len() as f64) < 0.005, "{sum}");
        assert!(found.windows(2).all(|pair| pair[0] <= pair[1]));
    }
}

fn lamp(position: DVec3, radius: f64) -> [Light; 1] {
    [Light::Point { position, color: [1.0; 3], range: 10.0, shadows: Some(radius) }]
}

/// A lamp at a height of 3 over a square at a height of 2 triples the square. What is above the lamp casts nothing onto the ground.
#[test]
fn a_lamp_magnifies_shadows_by_similar_triangles() {
    for base in [DVec3::ZERO, UTM] {
        let at = |y: f64| base + DVec3::new(0.3, y, -5.0);
        let (plane, caster, above) = (
            ground(base),
            Geometry::Mesh(square(at(2.0))),
            Geometry::Mesh(quad(at(3.5), DVec3::X * 9.0, DVec3::NEG_Z * 9.0)),
        );
        let lights = lamp(at(3.0), 0.0);
        let items = vec![item(&plane), item(&caster), item(&above)];
        let lit = OracleScene { lights: &lights, ..scene(items) };
        let offsets = [-9.0, -3.0001, -2.9999, -1.0, 0.2, 2.9999, 3.0001, 4.0];
        let places = offsets.iter().flat_map(|&x| offsets.map(|z| at(0.0) + DVec3::new(x, 0.0, z)));
        let places: Vec<DVec3> = places.collect();
        let found = shares(&lit, base + DVec3::new(0.0, 2.5, 0.5), &places);
        for (place, share) in places.iter().zip(found) {
            let away = (*place - at(0.0)).abs();
            let is_inside = away.x < 3.0 && away.z < 3.0;
            assert_eq!(share, if is_inside { 0.0 } else { 1.0 }, "{away} at {base}");
        }
    }
}

/// Below an edge half way up to a lamp, the penumbra is as wide as the lamp.
#[test]
fn the_penumbra_of_a_lamp_has_the_profile_of_its_disc() {
    let plane = ground(DVec3::ZERO);
    let (height, radius) = (400.0, 0.5);
    let lights = lamp(DVec3::new(0.0, height, -5.0), radius);
    let edge = DVec3::new(0.0, 0.5 * height, -5.0);
    let half = quad(edge - DVec3::X * 20.0, DVec3::X * 20.0, DVec3::NEG_Z * 20.0);
    let caster = Geometry::Mesh(half);
    let lit = OracleScene { lights: &lights, ..scene(vec![item(&plane), item(&caster)]) };
    let steps: Vec<f64> = (-12..=12).map(|i| f64::from(i) / 10.0).collect();
    let found = shares_along_x(&lit, &steps.iter().map(|a| a * radius).collect::<Vec<_>>());
    for (step, share) in steps.iter().zip(found) {
        let a = step.clamp(-1.0, 1.0);
        let expected = 0.5 + (a * (1.0 - a * a).sqrt() + a.asin()) / std::f64::consts::PI;
        assert!((share - expected).abs() < 0.02, "{step}: {share} instead of {expected}");
    }
}

#[test]
fn translucent_squares_cast_no_shadow_and_cut_ones_cast_what_is_left() {
    let plane = ground(DVec3::ZERO);
    let lights = sun(DVec3::NEG_Y, 0.0);
    let mut caster = square(DVec3::new(0.0, 2.0, -5.0));
    caster.parts = vec![MeshPart { triangles: 2, material: Some(0) }];
    caster.uvs = Some([(0.0, 1.0), (1.0, 1.0), (1.0, 0.0), (0.0, 0.0)].map(Vec2::from).to_vec());
    let caster = Geometry::Mesh(caster);
    let texel = |alpha| [255, 255, 255, alpha];
    let textures = [Texture {
        name: String::new(),
        width: 2,
        height: 2,
        rgba: [255, 0, 0, 255].map(texel).to_vec(),
        wrap: [Wrap::Clamp; 2],
        filter: Filter::Nearest,
        encoding: Encoding::Srgb,
    }];
    let quarters = [(-0.5, -5.5), (0.5, -5.5), (-0.5, -4.5), (0.5, -4.5)];
    let quarters = quarters.map(|(x, z)| DVec3::new(x, 0.0, z));
    let found = |material: Material, override_material: Option<&MaterialSpec>| {
        let materials = [material];
        let textures = &textures;
        let cut =
            OracleItem { materials: &materials, textures, override_material, ..item(&caster) };
        let lit = OracleScene { lights: &lights, ..scene(vec![item(&plane), cut]) };
        shares(&lit, DVec3::Y * 4.0, &quarters)
    };
    let opaque = Material::default();
    assert_eq!(found(opaque.clone(), None), [0.0; 4]);
    assert_eq!(found(Material { translucent: true, ..opaque.clone() }, None), [1.0; 4]);
    let glass = MaterialSpec { base_color: Some([1.0, 1.0, 1.0, 0.5]), ..MaterialSpec::default() };
    assert_eq!(found(opaque.clone(), Some(&glass)), [1.0; 4]);
    let cut = Material { base_texture: Some(0), alpha_cutoff: Some(0.5), ..opaque };
    assert_eq!(found(cut.clone(), None), [0.0, 1.0, 1.0, 0.0]);
    // Alpha of the texture without a cut-off is not looked at.
    assert_eq!(found(Material { alpha_cutoff: None, ..cut }, None), [0.0; 4]);
}

/// Splats of a ball with 3000 samples.
fn ball(centre: DVec3) -> Geometry {
    let sample = |i: u32| {
        let y = 1.0 - (2.0 * f64::from(i) + 1.0) / 3000.0;
        let (sine, cosine) = (f64::from(i) * 2.4).sin_cos();
        let across = (1.0 - y * y).sqrt();
        let normal = DVec3::new(across * cosine, y, across * sine);
        let (u, v) = normal.normalize_or_zero().any_orthonormal_pair();
        [centre + normal, u * 0.04, v * 0.04]
    };
    Geometry::Points(cloud(&(0..3000).map(sample).collect::<Vec<_>>()))
}

#[test]
fn a_ball_of_splats_shades_the_ground_and_not_its_lit_side() {
    for base in [DVec3::ZERO, UTM] {
        let centre = base + DVec3::new(0.0, 1.5, -5.0);
        let (plane, ball) = (ground(base), ball(centre));
        let direction = DVec3::new(0.5, -1.0, -0.3).normalize_or_zero();
        let items = vec![item(&plane), OracleItem { instance: 1, ..item(&ball) }];
        let view = View {
            eye: base + DVec3::new(0.0, 1.5, 5.0),
            focal_px: DVec2::splat(200.0),
            principal_px: DVec2::new(64.0, 48.0),
            width: 128,
            height: 96,
            ..view()
        };
        let world = |frame: &OracleFrame, i: usize| {
            view.eye + pixel_ray(&view, i % 128, i / 128) * frame.depth[i]
        };
        for (angle, blend) in [(0.0, Blend::Weighted), (2.0, Blend::Opaque)] {
            let lights = sun(direction, angle);
            let splats = Some(Splats { blend, ..sharp(SplatFilter::Exact) });
            let open = OracleScene { lights: &lights, splats, ..scene(items.clone()) };
            let shaded = OracleScene { shadows: true, ..open.clone() };
            let (open, shaded) = (render(&open, &view, 1), render(&shaded, &view, 1));
            let (mut smooth, mut dark, mut bright) = (0, 0, 0);
            for i in 0..open.id.len() {
                let share = shaded.color[i][0] / open.color[i][0];
                let to = world(&open, i) - centre;
                let beside = (to - direction * to.dot(direction)).length();
                // At the silhouette, disks are seen from behind, and their normals turned towards the eye.
                let facing = |normal: DVec3| -normal.dot(direction);
                let facing = facing(open.normal[i]).min(facing(to.normalize_or_zero()));
                match open.id[i] {
                    2 if facing > 0.25 => {
                        assert!((share - 1.0).abs() < 1e-9, "{i}: {share}");
                        smooth += 1;
                    }
                    1 if beside < 0.9 => {
                        assert_eq!(shaded.color[i][0], 0.0, "{i}: {beside}");
                        dark += 1;
                    }
                    1 if beside > 1.2 => {
                        assert_eq!(share, 1.0, "{i}: {beside}");
                        bright += 1;
                    }
                    _ => {}
                }
            }
            assert!(smooth > 200 && dark > 20 && bright > 200, "{smooth} {dark} {bright}");
        }
    }
}

#[test]
fn samples_cast_shadows_as_they_are_drawn() {
    let plane = ground(DVec3::ZERO);
    let lights = sun(DVec3::NEG_Y, 0.0);
    let centre = DVec3::new(0.0, 2.0, -5.0);
    let mut disk = cloud(&[[centre, DVec3::Z * 0.1, DVec3::X * 0.3]]);
    let xs = [-0.601, -0.599, -0.299, 0.299, 0.599, 0.601];
    let with = |geometry: &Geometry, given: OracleScene<'_>| {
        let items = vec![item(&plane), item(geometry)];
        shares_along_x(&OracleScene { items, lights: &lights, ..given }, &xs)
    };
    let splats = Some(sharp(SplatFilter::Exact));
    let drawn = OracleScene { splats, ..scene(vec![]) };
    let whole = Geometry::Points(disk.clone());
    assert_eq!(with(&whole, drawn.clone()), [1.0, 0.0, 0.0, 0.0, 0.0, 1.0]);
    // Half as wide.
    let thin = OracleScene { splats: splats.map(|s| Splats { width: 0.5, ..s }), ..drawn.clone() };
    assert_eq!(with(&whole, thin), [1.0, 1.0, 0.0, 0.0, 1.0, 1.0]);
    // Pull-push has the same disks; points of one pixel have no size.
    let weights = crate::scene::PullPushWeights::default();
    let pull_push = splats.map(|splats| PullPush { splats, weights });
    let pulled = OracleScene { pull_push, ..scene(vec![]) };
    assert_eq!(with(&whole, pulled), [1.0, 0.0, 0.0, 0.0, 0.0, 1.0]);
    assert_eq!(with(&whole, scene(vec![])), [1.0; 6]);
    let bare = points(&[centre]);
    assert_eq!(with(&bare, drawn.clone()), [1.0; 6]);
    // Discs have their diameter in scene units, and none in pixels.
    for (diameter, expected) in [(1.2, [1.0, 0.0, 0.0, 0.0, 0.0, 1.0]), (0.0, [1.0; 6])] {
        let discs = Some(Discs { diameter_px: 40.0, diameter });
        assert_eq!(with(&bare, OracleScene { discs, ..scene(vec![]) }), expected);
    }
    // A clip line keeps x ≥ 0.
    let line = ClipLine { normal: Vec2::Y, offset: 0.0 };
    disk.clips = Some(vec![Clip { lines: [Some(line), None], either: false }]);
    let half = Geometry::Points(disk.clone());
    assert_eq!(with(&half, drawn.clone()), [1.0, 1.0, 1.0, 0.0, 0.0, 1.0]);
    // Without a normal, the kernel is a circle that faces the sun, however it lay.
    let upright = cloud(&[[centre, DVec3::Y * 0.1, DVec3::Z * 0.3]]);
    let facing = Geometry::Points(PointCloud { normals: None, ..upright });
    assert_eq!(with(&facing, drawn), [1.0, 0.0, 0.0, 0.0, 0.0, 1.0]);
}

#[test]
fn lines_cast_shadows_of_their_true_width() {
    let plane = ground(DVec3::ZERO);
    let lights = sun(DVec3::NEG_Y, 0.0);
    let tube = Polylines {
        positions: vec![DVec3::new(0.0, 2.0, -8.0), DVec3::new(0.0, 2.0, -2.0)],
        strands: vec![0, 2],
        radii: Some(vec![0.25; 2]),
        ..Polylines::default()
    };
    let cone = Polylines { radii: Some(vec![0.5, 0.0]), ..tube.clone() };
    let ribbon = Polylines { normals: Some(vec![glam::Vec3::Y; 2]), ..tube.clone() };
    let edge_on = Polylines { normals: Some(vec![glam::Vec3::X; 2]), ..tube.clone() };
    let thin = Polylines { radii: None, ..tube.clone() };
    let wide = [1.0, 0.0, 0.0, 0.0, 1.0];
    for (lines, expected) in
        [(tube, wide), (cone, wide), (ribbon, wide), (edge_on, [1.0; 5]), (thin, [1.0; 5])]
    {
        let lines = Geometry::Lines(lines);
        let items = vec![item(&plane), item(&lines)];
        let lit = OracleScene { lights: &lights, least_line_px: 9.0, ..scene(items) };
        // Half a cone's radius at half its length, where its surface leans a little.
        let found = shares_along_x(&lit, &[-0.253, -0.249, 0.01, 0.249, 0.253]);
        assert_eq!(found, expected, "{lines:?}");
    }
}

#[test]
fn a_thin_line_does_not_shade_itself() {
    let place = |i: u32| {
        let (sine, cosine) = (f64::from(i) * 0.2).sin_cos();
        DVec3::new(cosine, sine, -4.0 - 0.01 * f64::from(i))
    };
    let lines = Polylines {
        positions: (0..28).map(place).collect(),
        strands: vec![0, 28],
        radii: Some(vec![0.004; 28]),
        ..Polylines::default()
    };
    let lines = Geometry::Lines(lines);
    for direction in [DVec3::new(0.3, 0.2, 1.0), DVec3::new(0.3, 0.2, -1.0)] {
        let lights = sun(direction, 0.53);
        for least_line_px in [0.0, 1.0, 2.5] {
            let open = OracleScene { lights: &lights, least_line_px, ..scene(vec![item(&lines)]) };
            let shaded = OracleScene { shadows: true, ..open.clone() };
            let (open, shaded) = (render(&open, &view(), 3), render(&shaded, &view(), 3));
            assert!(open.color.iter().any(|color| color[0] > 0.0));
            assert_eq!(open, shaded);
        }
    }
}

#[test]
fn clipped_casters_cast_no_shadow() {
    let plane = ground(DVec3::ZERO);
    let lights = sun(DVec3::NEG_Y, 0.0);
    let caster = Geometry::Mesh(square(DVec3::new(0.0, 2.0, -5.0)));
    let disk = [DVec3::new(0.0, 2.0, -5.0), DVec3::Z * 0.4, DVec3::X * 0.4];
    let splat = Geometry::Points(cloud(&[disk]));
    let splats = Some(sharp(SplatFilter::Exact));
    for caster in [caster, splat] {
        for (boxes, expected) in [
            ("*,*,*,*,*,*", [0.0, 0.0]),
            ("outside:*,1,*,*,3,*", [1.0, 1.0]),
            ("*,*,*,0,*,*", [0.0, 1.0]),
        ] {
            let boxes = boxes.parse().unwrap();
            let region = ClipRegion { boxes, box_from_world: DAffine3::IDENTITY };
            let items = vec![item(&plane), item(&caster)];
            let clip = Some(region);
            let lit = OracleScene { lights: &lights, splats, clip, ..scene(items) };
            assert_eq!(shares_along_x(&lit, &[-0.5, 0.5]), expected, "{region:?}");
        }
    }
}

#[test]
fn shadows_take_diffuse_and_specular_light_of_their_sun_alone() {
    let mut plane = quad(DVec3::NEG_Z * 5.0, DVec3::X * 9.0, DVec3::Y * 9.0);
    plane.parts = vec![MeshPart { triangles: 2, material: Some(0) }];
    let plane = Geometry::Mesh(plane);
    let materials = [Material { specular: [0.5; 3], shininess: 2.0, ..Material::default() }];
    let plane = OracleItem { materials: &materials, ..item(&plane) };
    // Out of the eye's sight, between the sun and the middle of the image.
    let caster = Geometry::Mesh(quad(DVec3::new(5.0, 0.0, 0.0), DVec3::X, DVec3::Y));
    let [casting] = sun(DVec3::new(-1.0, 0.0, -1.0), 0.0);
    let open = Light::Sun { direction: DVec3::NEG_Z, color: [0.25; 3], shadows: None };
    let rest = [Light::Ambient { color: [0.125; 3] }, Light::Headlight { color: [0.25; 3] }, open];
    let all = [&rest[..], &[casting]].concat();
    let view = View { principal_px: DVec2::new(32.5, 24.5), ..view() };
    let items = vec![plane, item(&caster)];
    let middle = |lights: &[Light], shadows: bool| {
        let lit = OracleScene { lights, shadows, ..scene(items.clone()) };
        render(&lit, &view, 1).color[24 * 64 + 32][0]
    };
    let without = middle(&rest, true);
    let cosine = 0.5f64.sqrt();
    assert!((middle(&all, false) - without - (cosine + 0.5 * cosine * cosine)).abs() < 1e-9);
    assert_eq!(middle(&all, true), without);
    assert_eq!(without, middle(&rest, false));
}
