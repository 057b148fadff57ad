//! Splats together, and with triangles, against sums by hand.

use glam::{DAffine3, DMat3, DVec2, DVec3};

use super::tests::{item, quad};
use super::tests_splats::{FILTERS, between, centre_of, cloud, draw, seen, sharp, touch, view};
use super::visibility::pixel_ray;
use super::*;
use crate::assets::PointCloud;
use crate::math::Projection;
use crate::scene::random::SplitMix64;
use crate::scene::{Blend, Filter, Shading};

const RED: [u8; 4] = [255, 0, 0, 255];
const GREEN: [u8; 4] = [0, 255, 0, 255];
/// The pixel right and below of the image's centre, half a pixel each way from it.
const CENTRE: usize = 24 * 64 + 32;

/// A circle that faces the eye from `-z`, with a standard deviation of `pixels`, `x` pixels right of the image's centre.
fn circle(x: f64, depth: f64, pixels: f64) -> [DVec3; 3] {
    let unit = depth / 100.0;
    [DVec3::new(x * unit, 0.0, -depth), DVec3::X * pixels * unit, DVec3::Y * pixels * unit]
}

fn colored(samples: &[[DVec3; 3]], colors: &[[u8; 4]]) -> PointCloud {
    PointCloud { colors: Some(colors.to_vec()), ..cloud(samples) }
}

fn draw_cloud(splats: Splats, cloud: PointCloud) -> OracleFrame {
    draw(splats, vec![item(&Geometry::Points(cloud))])
}

fn assert_near(found: &[f64], expected: &[f64]) {
    let near = found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6);
    assert!(near && found.len() == expected.len(), "{found:?} {expected:?}");
}

#[test]
fn colours_and_depths_are_weighted_means() {
    // Two circles 6 pixels apart, the green one a little behind, at a pixel ½ and 5½ from their centres.
    let both = colored(&[circle(0.0, 1.0, 4.0), circle(6.0, 1.01, 4.0)], &[RED, GREEN]);
    let weight =
        |x: f64, y: f64, deviation: f64| (-0.5 * (x * x + y * y) / deviation.powi(2)).exp();
    for filter in FILTERS {
        let frame = draw_cloud(sharp(filter), both.clone());
        let (red, green) = (weight(0.5, 0.5, 4.0), weight(5.5, 0.5, 4.0));
        let share = green / (red + green);
        assert_near(&frame.color[CENTRE], &[1.0 - share, share, 0.0, 1.0]);
        assert_near(&[frame.depth[CENTRE]], &[1.0 + 0.01 * share]);
        // With a low-pass filter, which lowers both alike.
        let frame = draw_cloud(Splats { prefilter: true, ..sharp(filter) }, both.clone());
        let wide = 16.25f64.sqrt();
        let (red, green) = (weight(0.5, 0.5, wide), weight(5.5, 0.5, wide));
        let share = green / (red + green);
        assert_near(&frame.color[CENTRE], &[1.0 - share, share, 0.0, 1.0]);
    }
    // Amplitudes: one of 4 pixels, one of ¼ pixel in the same place under a filter of ½.
    let thin = colored(&[circle(0.0, 1.0, 4.0), circle(0.0, 1.0, 0.25)], &[RED, GREEN]);
    for filter in FILTERS {
        let frame = draw_cloud(Splats { prefilter: true, ..sharp(filter) }, thin.clone());
        let red = 16.0 / 16.25 * weight(0.5, 0.5, 16.25f64.sqrt());
        let green = 0.0625 / 0.3125 * weight(0.5, 0.5, 0.3125f64.sqrt());
        let share = green / (red + green);
        assert_near(&frame.color[CENTRE], &[1.0 - share, share, 0.0, 1.0]);
    }
}

#[test]
fn surfaces_end_where_the_winners_offset_does() {
    // The nearest reaches ε = depth_offset · F · |t| = 0.08 behind itself, and F·σ·z/f = 0.01 more with the filter.
    for (behind, prefilter, depth_offset, blended) in [
        (0.0799, false, 1.0, true),
        (0.0801, false, 1.0, false),
        (0.0899, true, 1.0, true),
        (0.0901, true, 1.0, false),
        (0.1599, false, 2.0, true),
        (0.0001, false, 0.0, false),
        (0.0, false, 0.0, true),
    ] {
        let both = [circle(0.0, 1.0, 4.0), circle(0.0, 1.0 + behind, 4.0)];
        let splats = Splats { prefilter, depth_offset, ..sharp(Filter::Exact) };
        let color = draw_cloud(splats, colored(&both, &[RED, GREEN])).color[CENTRE];
        assert_eq!(color[1] > 0.1, blended, "{behind} {prefilter}: {color:?}");
        let reversed = colored(&[both[1], both[0]], &[GREEN, RED]);
        assert_near(&draw_cloud(splats, reversed).color[CENTRE], &color);
        // Opaque, the nearer is all there is; of two at one depth, the first.
        let opaque = Splats { blend: Blend::Opaque, ..splats };
        let frame = draw_cloud(opaque, colored(&both, &[RED, GREEN]));
        assert_near(&frame.color[CENTRE], &[1.0, 0.0, 0.0, 1.0]);
        assert_near(&[frame.depth[CENTRE]], &[1.0]);
    }
    // It is the reach that counts: a small splat 0.03 behind, with ε = 0.02, wins over ε = 0.08, and both are seen.
    let nested = [circle(0.0, 1.0, 4.0), circle(0.0, 1.03, 0.01 / 1.03 * 100.0)];
    let far = circle(0.0, 1.06, 4.0);
    let three = colored(&[nested[0], nested[1], far], &[RED, GREEN, [0, 0, 255, 255]]);
    let items = [Geometry::Points(three)];
    let color = draw(sharp(Filter::Exact), vec![item(&items[0])]).color[CENTRE];
    assert!(color[0] > 0.3 && color[1] > 0.3 && color[2] == 0.0, "{color:?}");
    // Floors that reach behind the eye know no filter: ε = 0.02, while they are 0.043 apart at the last row.
    let floor = |y: f64| [DVec3::new(0.0, y, -5.0), DVec3::X * 10.0, DVec3::Z * 10.0];
    let floors = colored(&[floor(-1.0), floor(-1.01)], &[RED, GREEN]);
    let splats = Splats { lowpass_px: 1000.0, depth_offset: 0.001, ..Splats::default() };
    assert_near(&draw_cloud(splats, floors).color[47 * 64 + 32], &[1.0, 0.0, 0.0, 1.0]);
}

#[test]
fn a_plane_of_splats_has_the_planes_depth() {
    let (right, up) = (DVec3::new(1.0, 0.1, 0.5), DVec3::new(0.0, 1.0, -0.8));
    let u = right.normalize_or_zero() * 0.05;
    let v = right.cross(up).cross(right).normalize_or_zero() * 0.05;
    let place = |i: i32| {
        let (x, y) = (f64::from(i % 81 - 40), f64::from(i / 81 - 40));
        [DVec3::NEG_Z * 2.0 + u * x + v * y, u, v]
    };
    let plane: Vec<_> = (0..81 * 81).map(place).collect();
    let normal = right.cross(up);
    for blend in [Blend::Weighted, Blend::Opaque] {
        for prefilter in [false, true] {
            let splats = Splats { prefilter, blend, ..sharp(Filter::Exact) };
            let frame = draw_cloud(splats, cloud(&plane));
            for (i, &depth) in frame.depth.iter().enumerate() {
                let ray = pixel_ray(&view(), i % 64, i / 64);
                let expected = normal.dot(DVec3::NEG_Z * 2.0) / normal.dot(ray);
                // Kernels are stored in single precision.
                assert!((depth - expected).abs() < 1e-6, "{i}: {depth} {expected}");
                let cosine = frame.normal[i].dot(normal.normalize_or_zero()).abs();
                assert!((cosine - 1.0).abs() < 1e-6);
            }
        }
    }
}

#[test]
fn light_falls_on_the_mean_or_on_each() {
    // Two splats in one place with normals 60° to either side of the view, and a sun along the first normal.
    let normal = |side: f64| DVec3::new(side * 0.75f64.sqrt(), 0.0, 0.5);
    let tilted = |side: f64| {
        let n = normal(side);
        [DVec3::NEG_Z, n.cross(DVec3::Y) * -0.05, DVec3::Y * 0.05]
    };
    let sun = Light::Sun { direction: -normal(1.0), color: [1.6; 3], shadows: None };
    let both = colored(&[tilted(1.0), tilted(-1.0)], &[[255; 4]; 2]);
    // The kernels lie as the normals say, so that only the weights are left to know: equal on the axis between them.
    let view = View { principal_px: DVec2::new(32.5, 24.5), ..view() };
    let geometry = Geometry::Points(both);
    let color = |splats| {
        let lit = OracleScene {
            splats: Some(splats),
            lights: &[sun],
            ..super::tests::scene(vec![item(&geometry)])
        };
        let frame = render(&lit, &view, 1);
        (frame.color[CENTRE][0], frame.normal[CENTRE])
    };
    let deferred = color(sharp(Filter::Exact));
    let each = color(Splats { shading: Shading::Splat, ..sharp(Filter::Exact) });
    let opaque =
        color(Splats { shading: Shading::Splat, blend: Blend::Opaque, ..sharp(Filter::Exact) });
    // The mean normal looks along z: n·l = ½. On its own the first is fully lit, 1.6 cut to 1, the second not at all.
    assert_near(&[deferred.0, each.0, opaque.0], &[0.8, 0.5, 1.6]);
    assert!((deferred.1 - DVec3::Z).length() < 1e-6 && (each.1 - DVec3::Z).length() < 1e-6);
    assert!((opaque.1 - normal(1.0)).length() < 1e-6);
}

#[test]
fn triangles_hide_what_reaches_behind_them() {
    let disk = Geometry::Points(cloud(&[circle(0.0, 1.0, 4.0)]));
    // ε = 0.08: a wall within it shows, however far behind the disk itself it is.
    for (wall_depth, weighted, opaque) in
        [(0.9, 1, 1), (1.05, 1, 2), (1.0799, 1, 2), (1.0801, 2, 2)]
    {
        let wall = quad(DVec3::NEG_Z * wall_depth, DVec3::X * 9.0, DVec3::Y * 9.0);
        let wall = Geometry::Mesh(wall);
        let items = vec![item(&wall), OracleItem { instance: 1, ..item(&disk) }];
        for (blend, id) in [(Blend::Weighted, weighted), (Blend::Opaque, opaque)] {
            let frame = draw(Splats { blend, ..sharp(Filter::Perspective) }, items.clone());
            assert_eq!(frame.id[CENTRE], id, "{wall_depth} {blend:?}");
            let depth = if id == 1 { wall_depth } else { 1.0 };
            assert_near(&[frame.depth[CENTRE], frame.depth[0]], &[depth, wall_depth]);
            assert_eq!(frame.id[0], 1);
        }
    }
    // At the same depth the lower instance wins.
    let wall = Geometry::Mesh(quad(DVec3::NEG_Z, DVec3::X * 9.0, DVec3::Y * 9.0));
    let opaque = Splats { blend: Blend::Opaque, ..sharp(Filter::Affine) };
    for (wall_number, id) in [(0, 1), (7, 4)] {
        let items = vec![
            OracleItem { instance: wall_number, ..item(&wall) },
            OracleItem { instance: 3, ..item(&disk) },
        ];
        let frame = draw(opaque, items);
        // Both depths are 1 but for rounding, which at this depth there is none of.
        assert_eq!((frame.depth[CENTRE], frame.id[CENTRE]), (1.0, id));
    }
}

#[test]
fn crossing_splats_meet_in_a_line() {
    // Planes z = −1 ± x, as disks around (0, 0, −1).
    let disk = |side: f64| [DVec3::NEG_Z, DVec3::new(0.1, 0.0, side * 0.1), DVec3::Y * 0.1];
    let opaque = Splats { blend: Blend::Opaque, ..sharp(Filter::Exact) };
    let frame = draw_cloud(opaque, colored(&[disk(1.0), disk(-1.0)], &[RED, GREEN]));
    let mut covered = 0;
    for i in (0..64 * 48).filter(|&i| frame.id[i] == 1) {
        let x = pixel_ray(&view(), i % 64, i / 64).x;
        // −z = 1 − x of the first is the nearer to the right.
        assert_eq!(frame.color[i][0], if x > 0.0 { 1.0 } else { 0.0 }, "{i}");
        assert_near(&[frame.depth[i]], &[1.0 / (1.0 + x.abs())]);
        covered += 1;
    }
    assert!(covered > 500, "{covered}");
}

#[test]
fn the_depth_of_a_filtered_pixel_stays_near_the_splat() {
    // Seen at 0.6°, the plane goes through all depths within few rows; the splat stays within R + F·σ·z/f of its own.
    let disk = [DVec3::NEG_Z, DVec3::X * 0.02, DVec3::new(0.0, 0.0002, 0.02)];
    let splats = Splats { prefilter: true, lowpass_px: 2.0, ..sharp(Filter::Perspective) };
    let splat = seen(splats, &cloud(&[disk])).unwrap();
    let depths: Vec<f64> =
        (0..64 * 48).filter_map(|i| Some(touch(&splat, centre_of(i))?.depth)).collect();
    let (low, high) = depths.iter().fold((9.0f64, 0.0f64), |(a, b), &d| (a.min(d), b.max(d)));
    assert_near(&[low, high], &[1.0 - 0.08, 1.0 + 0.08]);
}

/// Splats of all kinds and overlaps.
fn heap(seed: u64, count: usize, size: f64) -> PointCloud {
    let mut rng = SplitMix64::new(seed);
    let mut samples = Vec::with_capacity(count);
    let mut colors = Vec::with_capacity(count);
    for _ in 0..count {
        let mut draw = |low, high| between(&mut rng, low, high);
        let centre = DVec3::new(draw(-1.0, 1.0), draw(-0.8, 0.8), draw(-4.0, -2.0));
        let turn = DMat3::from_rotation_y(draw(0.0, 9.0)) * DMat3::from_rotation_x(draw(0.0, 9.0));
        let (u, v) = (turn.x_axis * draw(0.2, 1.0), turn.y_axis * draw(0.2, 1.0));
        samples.push([centre, u * size, v * size]);
        colors.push([(); 4].map(|()| draw(0.0, 255.0) as u8));
    }
    colored(&samples, &colors)
}

#[test]
fn neither_the_order_of_samples_nor_the_number_of_threads_matters() {
    let samples = heap(1, 800, 0.06);
    let reversed = PointCloud {
        positions: samples.positions.iter().rev().copied().collect(),
        colors: samples.colors.clone().map(|all| all.into_iter().rev().collect()),
        normals: samples.normals.clone().map(|all| all.into_iter().rev().collect()),
        kernels: samples.kernels.clone().map(|all| all.into_iter().rev().collect()),
        ..PointCloud::default()
    };
    let (samples, reversed) = (Geometry::Points(samples), Geometry::Points(reversed));
    let triangles = Geometry::Mesh(quad(DVec3::NEG_Z * 3.0, DVec3::X, DVec3::Y));
    for filter in FILTERS {
        let splats = Splats { prefilter: true, ..sharp(filter) };
        let frame = |geometry| {
            draw(splats, vec![item(geometry), OracleItem { instance: 1, ..item(&triangles) }])
        };
        let threads = |n| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap();
            pool.install(|| frame(&samples))
        };
        let forward = threads(1);
        assert_eq!(forward, threads(5));
        let backward = frame(&reversed);
        assert_eq!(forward.id, backward.id);
        assert!(forward.id.contains(&1) && forward.id.contains(&2));
        for i in (0..64 * 48).filter(|&i| forward.id[i] == 1) {
            assert_near(&[backward.depth[i]], &[forward.depth[i]]);
            assert_near(&backward.color[i], &forward.color[i]);
        }
    }
}

#[test]
fn supersampling_keeps_the_filter_as_wide_in_pixels() {
    let samples = cloud(&[circle(0.3, 1.0, 1.0)]);
    let geometry = Geometry::Points(samples.clone());
    for filter in FILTERS {
        for (prefilter, variance) in [(false, 1.0), (true, 1.25)] {
            let splats = Splats { prefilter, ..sharp(filter) };
            // Blended over the filter's reach, seen over its own.
            let scene = super::tests::scene(vec![item(&geometry)]);
            let finer = view().finer(8);
            let prepared = Prepared::new(&scene, &finer);
            let settings = splats::Settings::new(&splats, 8);
            let splat =
                splats::SeenSplat::new(&finer, &settings, &prepared.items[0], &samples, 0).unwrap();
            let pixels = (0..48 * 8).flat_map(|y| (0..64 * 8).map(move |x| (x, y)));
            let centre = |(x, y): (usize, usize)| DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
            let touched =
                pixels.filter(|&at| splat.at(centre(at), pixel_ray(&finer, at.0, at.1)).is_some());
            let share = touched.count() as f64 / 64.0 / (std::f64::consts::PI * 4.0 * variance);
            assert!((share - 1.0).abs() < 0.01, "{filter:?} {share}");
            let splats = Some(splats);
            let clear = OracleScene {
                splats,
                background: [0.0; 4],
                ..super::tests::scene(vec![item(&geometry)])
            };
            let fine = render(&clear, &view(), 8);
            let area: f64 = fine.color.iter().map(|color| color[3]).sum();
            let expected = std::f64::consts::PI * 4.0;
            assert!((area / expected - 1.0).abs() < 0.01, "{filter:?} {area} {expected}");
            let coarse = render(&clear, &view(), 1);
            assert_eq!((fine.depth, fine.id), (coarse.depth, coarse.id));
        }
    }
}

#[test]
fn many_splats_fill_a_frame_within_seconds() {
    let view = View {
        projection: Projection::Perspective,
        focus: 0.0,
        focal_px: DVec2::splat(400.0),
        principal_px: DVec2::new(128.0, 96.0),
        width: 256,
        height: 192,
        ..view()
    };
    let geometry = Geometry::Points(heap(2, 200_000, 0.01));
    let back = DAffine3::from_translation(DVec3::NEG_Z);
    let items = vec![OracleItem { world_from_geometry: back, ..item(&geometry) }];
    let splats = Some(Splats { prefilter: true, ..sharp(Filter::Exact) });
    let frame = render(&OracleScene { splats, ..super::tests::scene(items) }, &view, 1);
    assert!(frame.id.iter().filter(|&&id| id == 1).count() > 40_000);
}
