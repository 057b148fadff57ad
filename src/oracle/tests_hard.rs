//! Whatever the coordinates, a frame holds sound numbers and shows nothing that lies behind the eye.

use glam::{DAffine3, DMat3, DVec3, Vec2, Vec3};
use proptest::prelude::*;

use super::tests::{camera, item, mesh, points, scene};
use super::*;
use crate::assets::{Encoding, Filter, MeshPart, PointCloud, Texture, Wrap};

/// Ordinary numbers beside those that break renderers.
fn coordinate() -> impl Strategy<Value = f64> {
    prop_oneof![
        4 => -3.0..3.0f64,
        2 => prop::sample::select(vec![
            0.0, -0.0, 1.0, 1e-12, -1e-12, 1e-300, 1e8, -1e8, 1e150, f64::MAX, f64::NAN, f64::INFINITY,
        ]),
    ]
}

fn vector() -> impl Strategy<Value = [f64; 3]> {
    [coordinate(), coordinate(), coordinate()]
}

fn transform() -> impl Strategy<Value = DAffine3> {
    let entry = || prop::sample::select(vec![1.0, 0.0, -1.0, 1e-8, 1e8, 0.5]);
    let column = move || [entry(), entry(), entry()];
    prop_oneof![
        Just(DAffine3::IDENTITY),
        [column(), column(), column()]
            .prop_map(|c| DAffine3::from_mat3(DMat3::from_cols_array_2d(&c))),
    ]
}

fn assert_sound(frame: &OracleFrame) {
    for i in 0..frame.id.len() {
        let covered = frame.id[i] != 0;
        assert!(frame.color[i].iter().all(|c| c.is_finite()), "{:?}", frame.color[i]);
        assert!(
            frame.depth[i] > 0.0 && frame.depth[i].is_finite() == covered,
            "{}",
            frame.depth[i]
        );
        let length = frame.normal[i].length();
        assert!(length == 0.0 || covered && (length - 1.0).abs() < 1e-9, "{length}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn frames_hold_sound_numbers(
        corners in prop::collection::vec(vector(), 3..9),
        place in transform(),
        fov in prop::sample::select(vec![0.01, 40.0, 179.0]),
        lit in any::<bool>(),
    ) {
        let count = corners.len() as u32;
        let triangles: Vec<[u32; 3]> = (2..count + 1).map(|i| [0, i - 1, i]).collect();
        let mut solid = mesh(&corners, &triangles);
        let direction = |p: &[f64; 3]| {
            Vec3::from(p.map(|x| x as f32)).try_normalize().unwrap_or(Vec3::ZERO)
        };
        solid.uvs = Some(corners.iter().map(|p| Vec2::new(p[0] as f32, p[2] as f32)).collect());
        solid.normals = lit.then(|| corners.iter().map(direction).collect());
        solid.parts = vec![MeshPart { triangles: count - 1, material: Some(0) }];
        let texture = Texture {
            name: String::new(),
            width: 3,
            height: 2,
            rgba: vec![[9, 99, 200, 255]; 6],
            wrap: [Wrap::Mirror, Wrap::Repeat],
            filter: Filter::Linear,
            encoding: Encoding::Srgb,
        };
        let material = Material {
            base_texture: Some(0),
            alpha_cutoff: Some(0.5),
            specular: [1.0; 3],
            shininess: 1000.0,
            ..Material::default()
        };
        let (materials, textures) = ([material], [texture]);
        let cloud = PointCloud {
            positions: corners.iter().map(|&p| p.into()).collect(),
            normals: solid.normals.clone(),
            ..PointCloud::default()
        };
        let (solid, cloud) = (Geometry::Mesh(solid), Geometry::Points(cloud));
        let place_item = |geometry| OracleItem {
            world_from_geometry: place,
            materials: &materials,
            textures: &textures,
            ..item(geometry)
        };
        let lights = [
            Light::Headlight { color: [1.0; 3] },
            Light::Point { position: DVec3::ZERO, color: [1.0; 3], range: 1.0, shadows: None },
        ];
        let items = vec![place_item(&solid), place_item(&cloud)];
        let lights = if lit { &lights[..] } else { &[] };
        let drawn = OracleScene { lights, ..scene(items) };
        // The eye is often on a vertex or in a triangle's plane.
        let view = camera([0.0, 0.0, 1.0], [0.0; 3], fov).view(9, 7).unwrap();
        assert_sound(&render(&drawn, &view, 1));
        assert_sound(&render(&drawn, &view, 2));
    }
}

#[test]
fn empty_scenes_and_frames_are_rendered() {
    let nothing = Geometry::Points(PointCloud::default());
    let view = camera([0.0, 0.0, 1.0], [0.0; 3], 40.0).view(5, 4).unwrap();
    for items in [vec![], vec![item(&nothing)]] {
        let frame = render(&scene(items), &view, 2);
        assert!(frame.color.iter().all(|&c| c == [0.0, 0.0, 0.0, 1.0]));
        assert_eq!(
            (frame.color.len(), frame.id, frame.normal),
            (20, vec![0; 20], vec![DVec3::ZERO; 20])
        );
    }
    let one = points(&[DVec3::ZERO]);
    for (width, height) in [(0, 0), (0, 3), (1, 1)] {
        let view = View { width, height, ..view };
        assert_eq!(render(&scene(vec![item(&one)]), &view, 1).id.len() as u32, width * height);
    }
}

#[test]
fn indices_that_lead_nowhere_draw_nothing() {
    let mut broken = mesh(&[[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 1.0, 0.0]], &[[0, 1, 7]]);
    broken.parts = vec![MeshPart { triangles: 1, material: Some(9) }];
    let view = camera([0.0, 0.0, 3.0], [0.0; 3], 40.0).view(5, 5).unwrap();
    let geometry = Geometry::Mesh(broken.clone());
    assert!(render(&scene(vec![item(&geometry)]), &view, 1).id.iter().all(|&id| id == 0));
    // A material that is not there is the default one.
    broken.triangles = vec![[0, 1, 2]];
    let geometry = Geometry::Mesh(broken);
    let frame = render(&scene(vec![item(&geometry)]), &view, 1);
    assert_eq!(frame.to_rgba8()[12], [255; 4]);
}
