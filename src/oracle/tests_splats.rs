//! Single splats against closed forms: outlines, depths, weights, clip lines, and the places where formulas break down.

use glam::{DAffine3, DMat3, DVec2, DVec3, Vec2, Vec3};

use super::footprint::Disk;
use super::prepare::Prepared;
use super::splats::{SeenSplat, Settings, Touch, camera_from_view};
use super::tests::{item, scene};
use super::visibility::pixel_ray;
use super::*;
use crate::assets::{Clip, ClipLine, Kernel, PointCloud};
use crate::math::Projection;
use crate::scene::random::SplitMix64;
use crate::scene::{Filter, Splats};

pub const FILTERS: [Filter; 3] = [Filter::Affine, Filter::Perspective, Filter::Exact];

/// A hundred pixels a unit at distance 1, looking along −z from the origin.
pub fn view() -> View {
    View {
        eye: DVec3::ZERO,
        view_from_world: DMat3::IDENTITY,
        projection: Projection::Perspective,
        focus: 0.0,
        focal_px: DVec2::splat(100.0),
        principal_px: DVec2::new(32.0, 24.0),
        width: 64,
        height: 48,
    }
}

pub fn sharp(filter: Filter) -> Splats {
    Splats { filter, prefilter: false, ..Splats::default() }
}

/// Samples with centre and axes, their normals across the axes.
pub fn cloud(samples: &[[DVec3; 3]]) -> PointCloud {
    let kernel = |[_, u, v]: &[DVec3; 3]| Kernel { u: u.as_vec3(), v: v.as_vec3() };
    let normal = |[_, u, v]: &[DVec3; 3]| u.cross(*v).normalize_or_zero().as_vec3();
    PointCloud {
        positions: samples.iter().map(|sample| sample[0]).collect(),
        normals: Some(samples.iter().map(normal).collect()),
        kernels: Some(samples.iter().map(kernel).collect()),
        ..PointCloud::default()
    }
}

pub fn draw(splats: Splats, items: Vec<OracleItem<'_>>) -> OracleFrame {
    render(&OracleScene { splats: Some(splats), ..scene(items) }, &view(), 1)
}

/// The frame of one item at the identity.
fn draw_cloud(splats: Splats, cloud: PointCloud) -> OracleFrame {
    draw(splats, vec![item(&Geometry::Points(cloud))])
}

pub fn seen(splats: Splats, cloud: &PointCloud) -> Option<SeenSplat> {
    let geometry = Geometry::Points(cloud.clone());
    let scene = scene(vec![item(&geometry)]);
    let prepared = Prepared::new(&scene, &view());
    SeenSplat::new(&view(), &Settings::new(&splats, 1), &prepared.items[0], cloud, 0)
}

pub fn touch(splat: &SeenSplat, pixel: DVec2) -> Option<Touch> {
    splat.at(pixel, view().ray(pixel))
}

pub fn centre_of(i: usize) -> DVec2 {
    DVec2::new((i % 64) as f64 + 0.5, (i / 64) as f64 + 0.5)
}

pub fn between(rng: &mut SplitMix64, low: f64, high: f64) -> f64 {
    low + (high - low) * rng.unit()
}

/// A disk at depth 1 to 4 near the image, up to `size` of its distance, with axes as the kernel's f32 has them.
fn random_disk(rng: &mut SplitMix64, size: f64) -> [DVec3; 3] {
    let depth = between(rng, 1.0, 4.0);
    let pixel = DVec2::new(between(rng, -10.0, 74.0), between(rng, -10.0, 58.0));
    let mut direction = || DVec3::from_array([(); 3].map(|()| between(rng, -1.0, 1.0)));
    let (a, b) = (direction(), direction());
    let u = a.normalize_or_zero();
    let v = u.cross(b).normalize_or_zero();
    let mut length = || between(rng, 0.1, 1.0) * size * depth;
    let axes = [u * length(), v * length()].map(|axis| axis.as_vec3().as_dvec3());
    [view().ray(pixel) * depth, axes[0], axes[1]]
}

fn projected(point: DVec3) -> DVec2 {
    view().project(point).unwrap()
}

#[test]
fn a_circle_seen_head_on_covers_a_circle() {
    // 50 pixels a unit at depth 2: a standard deviation of 2.5 pixels.
    let centre = DVec3::new(0.033, -0.021, -2.0);
    let circle = [centre, DVec3::X * 0.05, DVec3::Y * 0.05];
    let at = DVec2::new(32.0 + 50.0 * 0.033, 24.0 + 50.0 * 0.021);
    for filter in FILTERS {
        for (splats, deviation) in [
            (sharp(filter), 2.5),
            // The filter's margin is blended where another splat is seen.
            (Splats { prefilter: true, ..sharp(filter) }, 2.5),
            (Splats { width: 2.0, cutoff: 1.5, ..sharp(filter) }, 5.0),
        ] {
            let radius = deviation * f64::from(splats.cutoff);
            let frame = draw_cloud(splats, cloud(&[circle]));
            for (i, &id) in frame.id.iter().enumerate() {
                let distance = centre_of(i).distance(at);
                assert!((distance - radius).abs() > 1e-6, "the test would hang on rounding");
                assert_eq!(id == 1, distance < radius, "{filter:?} {splats:?} {i}");
                if id == 1 {
                    assert!((frame.depth[i] - 2.0).abs() < 1e-6);
                    assert!((frame.normal[i] - DVec3::Z).length() < 1e-12);
                }
            }
        }
    }
}

#[test]
fn perspective_and_exact_have_the_projected_outline() {
    let mut rng = SplitMix64::new(1);
    let mut by_inverse = 0;
    for round in 0..400 {
        let cutoff = between(&mut rng, 1.0, 3.0);
        let [centre, u, v] = random_disk(&mut rng, 0.4 / cutoff);
        let seen = [centre, u, v].map(camera_from_view);
        let disk = Disk::new(seen[0], [seen[1], seen[2]], &view());
        let inverse = disk.perspective_by_inverse(cutoff);
        by_inverse += u32::from(inverse.is_some());
        let ways = [inverse, Some(disk.perspective_by_dual(cutoff))];
        for gaussian in ways.into_iter().flatten() {
            for step in 0..12 {
                let (sin, cos) = f64::from(step).sin_cos();
                let rim = projected(centre + (u * cos + v * sin) * cutoff);
                let found = gaussian.squared_distance(rim - gaussian.centre_px, 0.0).sqrt();
                assert!((found - cutoff).abs() < 1e-5 * cutoff, "{round} {step}: {found} {cutoff}");
            }
        }
        let frame = |filter| {
            let splats = Splats { cutoff: cutoff as f32, ..sharp(filter) };
            draw_cloud(splats, cloud(&[[centre, u, v]]))
        };
        let (perspective, exact) = (frame(Filter::Perspective), frame(Filter::Exact));
        assert_eq!(perspective.id, exact.id, "{round}");
        let pairs = perspective.depth.iter().zip(&exact.depth);
        assert!(pairs.filter(|(a, _)| a.is_finite()).all(|(a, b)| (a - b).abs() < 1e-6));
    }
    assert!(by_inverse > 350, "{by_inverse}");
}

#[test]
fn an_exact_splat_has_its_own_points_weight_and_depth() {
    let mut rng = SplitMix64::new(2);
    for _ in 0..300 {
        let disk @ [centre, u, v] = random_disk(&mut rng, 0.15);
        let Some(splat) = seen(sharp(Filter::Exact), &cloud(&[disk])) else { continue };
        for _ in 0..8 {
            let at = DVec2::new(between(&mut rng, -2.5, 2.5), between(&mut rng, -2.5, 2.5));
            let point = centre + u * at.x + v * at.y;
            let found = touch(&splat, projected(point));
            let holds_centre = projected(point).floor() == projected(centre).floor();
            assert_eq!(found.is_some(), at.length() <= 2.0 || holds_centre);
            assert!(found.is_none_or(|found| found.is_seen));
            if let Some(found) = found.filter(|_| at.length() <= 2.0) {
                assert!((found.depth + point.z).abs() < 1e-7, "{} {}", found.depth, point.z);
                assert!((found.weight - (-0.5 * at.length_squared()).exp()).abs() < 1e-7);
            }
        }
    }
}

#[test]
fn filters_agree_on_what_is_small_and_the_amplitude_is_the_share_of_the_area() {
    let mut rng = SplitMix64::new(3);
    for _ in 0..100 {
        let [centre, u, v] = random_disk(&mut rng, 0.1).map(camera_from_view);
        let gaussians = |scale: f64| {
            let disk = Disk::new(centre, [u * scale, v * scale], &view());
            (disk.affine(), disk.perspective(2.0))
        };
        // The relative difference is of second order in the size.
        let difference = |scale: f64| {
            let (affine, perspective) = gaussians(scale);
            let extents = affine.half_extent_px(2.0, 0.0) - perspective.half_extent_px(2.0, 0.0);
            (extents.length() + affine.centre_px.distance(perspective.centre_px)) / scale
        };
        assert!(difference(1e-3) < 2e-3 * difference(1.0) + 1e-7);
        // Under a wide low-pass filter only the areas count: det V = f⁴ D² / |C*₃₃|³.
        let (affine, perspective) = gaussians(1.0);
        let plane = centre.dot(u.cross(v));
        let corner = centre.z.powi(2) - 4.0 * (u.z * u.z + v.z * v.z);
        for (gaussian, power) in [(perspective, corner.powf(1.5)), (affine, centre.z.powi(3))] {
            let area = 1e4 * plane.abs() / power;
            let found = gaussian.amplitude(1e6) * 1e12;
            assert!((found / area - 1.0).abs() < 1e-6, "{found} {area}");
        }
    }
}

#[test]
fn object_space_ewa_widens_the_kernel_at_its_centre() {
    // u has 4 pixels, v 1; with σ = ½ the kernel's own variances grow by 1/64 and 1/4.
    let disk = [DVec3::NEG_Z, DVec3::X * 0.04, DVec3::Y * 0.01];
    let splats = Splats { prefilter: true, ..sharp(Filter::Exact) };
    let splat = seen(splats, &cloud(&[disk])).unwrap();
    let amplitude = (1.0 / (1.0 + 1.0 / 64.0) / 1.25f64).sqrt();
    for (x, y) in [(0.0, 0.0), (3.0, 0.0), (0.0, 1.5), (-5.0, 0.75)] {
        let squared = (x / 4.0f64).powi(2) / (1.0 + 1.0 / 64.0) + f64::powi(y, 2) / 1.25;
        let found = touch(&splat, DVec2::new(32.0 + x, 24.0 + y)).unwrap();
        assert!((found.weight - amplitude * (-0.5 * squared).exp()).abs() < 1e-7);
    }
    // Thinner than the filter: v has a third of a pixel, as the perspective filter sees it.
    let thin = cloud(&[[DVec3::new(0.1, 0.0, -1.0), DVec3::X * 0.04, DVec3::Y * 0.003]]);
    let [exact, perspective] = [Filter::Exact, Filter::Perspective]
        .map(|filter| draw_cloud(Splats { filter, ..splats }, thin.clone()));
    assert_eq!(exact, perspective);
    assert!(exact.id.contains(&1));
}

#[test]
fn clip_lines_keep_their_side() {
    let line = |x: f32, y: f32, offset| Some(ClipLine { normal: Vec2::new(x, y), offset });
    // Axes of 5 pixels, drawn at twice the width: lines stay where they are on the surface.
    let disk = [DVec3::new(0.0013, 0.0017, -1.0), DVec3::X * 0.05, DVec3::Y * 0.05];
    let (right, up) = (|d: DVec2| d.x >= 2.5, |d: DVec2| d.y <= 5.0);
    type Side<'a> = &'a dyn Fn(DVec2) -> bool;
    let clips: [(Clip, Side<'_>); 4] = [
        (Clip { lines: [line(1.0, 0.0, 0.5), None], either: false }, &right),
        (Clip { lines: [None, line(0.0, -1.0, -1.0)], either: true }, &|d| d.y >= -5.0),
        (Clip { lines: [line(1.0, 0.0, 0.5), line(0.0, 1.0, -1.0)], either: false }, &|d| {
            right(d) && up(d)
        }),
        (Clip { lines: [line(1.0, 0.0, 0.5), line(0.0, 1.0, -1.0)], either: true }, &|d| {
            right(d) || up(d)
        }),
    ];
    for filter in FILTERS {
        let splats = Splats { width: 2.0, ..sharp(filter) };
        for (clip, keeps) in &clips {
            let clipped = PointCloud { clips: Some(vec![*clip]), ..cloud(&[disk]) };
            let frame = draw_cloud(splats, clipped);
            for (i, &id) in frame.id.iter().enumerate() {
                let from_centre = centre_of(i) - projected(disk[0]);
                assert_eq!(id == 1, from_centre.length() <= 20.0 && keeps(from_centre), "{clip:?}");
            }
        }
    }
    // In perspective a line stays a line of the disk's plane, whatever draws the disk.
    let tilted = [DVec3::new(0.01, 0.02, -1.0), DVec3::X * 0.06, DVec3::new(0.0, 0.03, -0.1)];
    let clip = Clip { lines: [line(0.6, 0.8, -0.3), None], either: false };
    for filter in FILTERS {
        for offset in [-0.01, 0.01] {
            let at = DVec2::new(0.6, 0.8) * (-0.3 + offset) + DVec2::new(0.8, -0.6) * 0.9;
            let point = tilted[0] + tilted[1] * at.x + tilted[2] * at.y;
            let clipped = PointCloud { clips: Some(vec![clip]), ..cloud(&[tilted]) };
            let splat = seen(Splats { prefilter: true, ..sharp(filter) }, &clipped).unwrap();
            assert_eq!(touch(&splat, projected(point)).is_some(), offset > 0.0, "{filter:?}");
        }
    }
}

#[test]
fn what_reaches_behind_the_eye_is_met_by_rays() {
    // A floor 1 below the eye, from 15 behind it to 25 before it.
    let floor = [DVec3::new(0.0, -1.0, -5.0), DVec3::X * 10.0, DVec3::Z * 10.0];
    for filter in FILTERS {
        let splats = Splats { prefilter: true, ..sharp(filter) };
        let frame = draw_cloud(splats, cloud(&[floor]));
        for (i, &depth) in frame.depth.iter().enumerate() {
            let ray = pixel_ray(&view(), i % 64, i / 64);
            let point = ray / -ray.y;
            let covered = ray.y < 0.0 && (point - floor[0]).length() <= 20.0;
            assert_eq!(frame.id[i] == 1, covered, "{i}");
            assert!(!covered || (depth + point.z).abs() < 1e-9);
        }
        assert_eq!(frame.id[47 * 64 + 32], 1);
    }
    // Wholly behind, and facing the eye from where it stands.
    for disk in [[DVec3::Z, DVec3::X, DVec3::Y], [DVec3::ZERO, DVec3::X, DVec3::Y]] {
        assert!(draw_cloud(Splats::default(), cloud(&[disk])).id.iter().all(|&id| id == 0));
    }
}

#[test]
fn edge_on_disks_are_seen_at_their_centre_and_blended_as_wide_as_the_filter() {
    // In the plane y = 0 through the eye, between the rows 23 and 24.
    let edge_on = [DVec3::new(0.0, 0.0, -1.0), DVec3::X * 0.02, DVec3::Z * 0.1];
    for filter in FILTERS {
        for prefilter in [false, true] {
            let frame = draw_cloud(Splats { prefilter, ..sharp(filter) }, cloud(&[edge_on]));
            let seen: Vec<usize> = (0..frame.id.len()).filter(|&i| frame.id[i] == 1).collect();
            assert_eq!(seen, [24 * 64 + 32], "{filter:?}");
            assert_eq!(frame.depth[seen[0]], 1.0);
        }
        let splat = seen(Splats { prefilter: true, ..sharp(filter) }, &cloud(&[edge_on])).unwrap();
        for row in 0..48 {
            let there = touch(&splat, DVec2::new(31.5, f64::from(row) + 0.5));
            assert_eq!(there.is_some(), [23, 24].contains(&row), "{filter:?} {row}");
            assert!(there.is_none_or(|there| there.depth == 1.0 && !there.is_seen));
        }
        let weight = touch(&splat, DVec2::new(32.0, 24.0)).unwrap().weight;
        assert!((0.5..=1.0).contains(&(weight * 8.0)), "{filter:?} {weight}");
        // Turned around the viewing axis, the plane misses the eye by rounding alone, which must not choose a depth.
        let geometry = Geometry::Points(cloud(&[edge_on]));
        let turned = DAffine3::from_rotation_z(0.3);
        let turned = OracleItem { world_from_geometry: turned, ..item(&geometry) };
        let frame = draw(Splats { prefilter: true, ..sharp(filter) }, vec![turned]);
        let depths = frame.depth.iter().filter(|depth| depth.is_finite());
        assert!(
            depths.clone().count() == 1 && depths.clone().all(|depth| (depth - 1.0).abs() < 1e-12)
        );
    }
}

#[test]
fn boxes_hold_every_covered_pixel() {
    let mut rng = SplitMix64::new(4);
    let mut covered = [0; 2];
    for round in 0..600 {
        // Up to two thirds of them reach the camera plane.
        let disk = random_disk(&mut rng, [0.2, 0.6, 1.5][round % 3]);
        let splats = Splats { prefilter: round % 2 == 0, ..sharp(FILTERS[round / 2 % 3]) };
        let Some(splat) = seen(splats, &cloud(&[disk])) else { continue };
        let [x0, x1, y0, y1] = splat.pixel_box;
        for i in 0..64 * 48 {
            let inside = (x0..x1).contains(&(i % 64)) && (y0..y1).contains(&(i / 64));
            let touched = touch(&splat, centre_of(i)).is_some();
            assert!(inside || !touched, "{round}: {i} is not in {:?}", splat.pixel_box);
            covered[usize::from(touched)] += u32::from(inside);
        }
    }
    assert!(covered[1] > covered[0] / 2, "loose: {covered:?}");
}

#[test]
fn odd_transforms_draw_sound_numbers() {
    let mut rng = SplitMix64::new(5);
    let disks: Vec<[DVec3; 3]> = (0..40).map(|_| random_disk(&mut rng, 0.3)).collect();
    let plain = cloud(&disks);
    let linear = |x: [f64; 3], y: [f64; 3], z: [f64; 3]| {
        DAffine3::from_mat3(DMat3::from_cols(x.into(), y.into(), z.into()))
    };
    let mirrored = linear([-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]);
    let sheared = linear([1.0, 0.5, 0.0], [0.3, 1.0, 0.0], [0.2, 0.0, 1.0]);
    for placed in [mirrored, sheared] {
        // It equals the moved kernels, which need not be orthogonal.
        let moved = disks
            .iter()
            .map(|&[p, u, v]| [placed.transform_point3(p), placed.matrix3 * u, placed.matrix3 * v]);
        let moved = Geometry::Points(cloud(&moved.collect::<Vec<_>>()));
        let geometry = Geometry::Points(plain.clone());
        for filter in FILTERS {
            let by_transform = draw(
                sharp(filter),
                vec![OracleItem { world_from_geometry: placed, ..item(&geometry) }],
            );
            let by_hand = draw(sharp(filter), vec![item(&moved)]);
            assert_eq!(by_transform.id, by_hand.id);
            let pairs = by_transform.depth.iter().zip(&by_hand.depth);
            assert!(pairs.filter(|(a, _)| a.is_finite()).all(|(a, b)| (a - b).abs() < 1e-5));
        }
    }
    let mut bad = plain;
    if let (Some(kernels), Some(normals)) = (&mut bad.kernels, &mut bad.normals) {
        kernels[0].u.x = f32::NAN;
        kernels[1].v.y = f32::INFINITY;
        kernels[2] = Kernel::default();
        kernels[3].u = Vec3::splat(f32::MAX);
        normals[4] = Vec3::ZERO;
        normals[5] = Vec3::NAN;
    }
    let line = ClipLine { normal: Vec2::NAN, offset: f32::INFINITY };
    bad.clips = Some(vec![Clip { lines: [Some(line), None], either: false }; 20]);
    bad.positions[6] = DVec3::NAN;
    let geometry = Geometry::Points(bad);
    for scale in [0.0, 1.0, 1e-300, 1e300, f64::NAN] {
        for axis in [DVec3::ONE, DVec3::new(1.0, 1.0, 0.0), DVec3::Z] {
            let placed = DAffine3::from_scale(axis * scale + (DVec3::ONE - axis));
            for world_from_geometry in [placed, DAffine3::from_translation(DVec3::NEG_Z) * placed] {
                for prefilter in [false, true] {
                    for filter in FILTERS {
                        let odd = OracleItem { world_from_geometry, ..item(&geometry) };
                        let frame = draw(Splats { prefilter, ..sharp(filter) }, vec![odd]);
                        assert!(frame.color.iter().flatten().all(|c| c.is_finite()));
                        assert!(frame.normal.iter().all(|n| n.is_finite()));
                        let sound = |(&id, &depth): (&u32, &f64)| {
                            if id == 0 {
                                depth == f64::INFINITY
                            } else {
                                depth > 0.0 && depth.is_finite()
                            }
                        };
                        assert!(frame.id.iter().zip(&frame.depth).all(sound));
                    }
                }
            }
        }
    }
}

#[test]
fn samples_without_normal_or_kernel_are_circles() {
    // Without normal: a circle around the longer axis, stretched by the longest column, that faces the eye.
    let disk = [DVec3::NEG_Z, DVec3::X * 0.02, DVec3::Z * 0.01];
    let line = Some(ClipLine { normal: Vec2::X, offset: 0.0 });
    let facing = Geometry::Points(PointCloud {
        normals: None,
        // No line has a side on it.
        clips: Some(vec![Clip { lines: [line, None], either: false }]),
        ..cloud(&[disk])
    });
    let radii = Geometry::Points(PointCloud {
        radii: Some(vec![0.02]),
        kernels: None,
        normals: Some(vec![Vec3::Z]),
        ..cloud(&[disk])
    });
    let stretch = DAffine3::from_scale(DVec3::new(1.0, 2.0, 1.0));
    for (geometry, placed, radius) in [
        (&facing, DAffine3::IDENTITY, 4.0),
        (&facing, stretch, 8.0),
        (&radii, DAffine3::IDENTITY, 4.0),
    ] {
        for filter in FILTERS {
            let placed = OracleItem { world_from_geometry: placed, ..item(geometry) };
            let frame = draw(sharp(filter), vec![placed]);
            for (i, &id) in frame.id.iter().enumerate() {
                assert_eq!(id == 1, centre_of(i).distance(DVec2::new(32.0, 24.0)) < radius, "{i}");
            }
        }
    }
    // With neither, only a low-pass filter has width: F·σ = 1 pixel around the centre. Seen is the pixel that holds that.
    let bare = PointCloud { kernels: None, ..cloud(&[disk]) };
    let frame = draw_cloud(sharp(Filter::Exact), bare.clone());
    assert_eq!(frame.id.iter().filter(|&&id| id == 1).count(), 1);
    for filter in FILTERS {
        let filtered = Splats { prefilter: true, ..sharp(filter) };
        let frame = draw_cloud(filtered, bare.clone());
        assert_eq!(frame.id.iter().filter(|&&id| id == 1).count(), 1, "{filter:?}");
        let splat = seen(filtered, &bare).unwrap();
        let touched = (0..64 * 48).filter(|&i| touch(&splat, centre_of(i)).is_some()).count();
        assert_eq!(touched, 4, "{filter:?}");
    }
}
