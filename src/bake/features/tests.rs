use glam::Vec3;

use super::*;
use crate::assets::Mesh;
use crate::bake::{SampleOptions, sample_mesh};
use crate::scene::random::SplitMix64;

fn cube() -> Mesh {
    let corner =
        |i: u32| DVec3::new(f64::from(i & 1), f64::from(i >> 1 & 1), f64::from(i >> 2 & 1));
    let quads =
        [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    let triangles = quads.into_iter().flat_map(|[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    Mesh { positions: (0..8).map(corner).collect(), triangles, ..Mesh::default() }
}

fn points(mesh: &Mesh, spacing: f64) -> Vec<DVec3> {
    let options = SampleOptions { spacing: Some(spacing), ..SampleOptions::default() };
    sample_mesh(mesh, &[], &[], &options).unwrap().positions
}

fn detected(positions: Vec<DVec3>, normals: Option<Vec<Vec3>>) -> PointCloud {
    let mut cloud = PointCloud { positions, normals, ..PointCloud::default() };
    detect_features(&mut cloud, &FeatureOptions::default());
    cloud
}

fn count(cloud: &PointCloud) -> usize {
    cloud.clips.iter().flatten().filter(|clip| **clip != Clip::NONE).count()
}

/// Counts the samples of a cube whose disks cross an edge, those of them with a line, the worst distance of a line from the
/// nearest edge, and the lines of all other samples.
fn against_cube(cloud: &PointCloud) -> (usize, usize, f64, f64) {
    let (kernels, normals) = (cloud.kernels.as_ref().unwrap(), cloud.normals.as_ref().unwrap());
    let (mut crossing, mut lined, mut worst) = (0, 0, 0.0f64);
    let mut snapped = 0;
    for (index, position) in cloud.positions.iter().enumerate() {
        let mut walls: Vec<f64> =
            position.to_array().iter().flat_map(|x| [x.abs(), (1.0 - x).abs()]).collect();
        walls.sort_by(f64::total_cmp);
        let reach = kernels[index].u.length().max(kernels[index].v.length()) * CUTOFF;
        if walls[1] < f64::from(reach) * 0.98 {
            crossing += 1;
            snapped += usize::from(normals[index].abs().max_element() > 0.9999);
            let clip = cloud.clips.as_ref().map_or(Clip::NONE, |clips| clips[index]);
            lined += usize::from(clip != Clip::NONE);
            for line in clip.lines.iter().flatten() {
                let foot = line.normal * line.offset;
                let at =
                    *position + (kernels[index].u * foot.x + kernels[index].v * foot.y).as_dvec3();
                let mut off: Vec<f64> =
                    at.to_array().iter().map(|x| x.abs().min((1.0 - x).abs())).collect();
                off.sort_by(f64::total_cmp);
                worst = worst.max(off[0].hypot(off[1]));
            }
        }
    }
    (crossing, lined, worst, snapped as f64 / crossing as f64)
}

#[test]
fn a_cube_has_its_edges() {
    let spacing = 1.0 / 32.0;
    let positions = points(&cube(), spacing);
    let cloud = detected(positions.clone(), None);
    let (crossing, lined, worst, snapped) = against_cube(&cloud);
    println!(
        "cube: {} samples, {lined} of {crossing} have a line, off by at most {:.4} spacings, {:.3} snapped",
        positions.len(),
        worst / spacing,
        snapped
    );
    assert!(lined as f64 >= 0.9 * crossing as f64);
    assert!(worst <= 0.05 * spacing && snapped > 0.9);
    // A hundredth of the spacing of noise.
    let mut random = SplitMix64::new(1);
    let mut near = || 0.02 * spacing * (random.unit() - 0.5);
    let noisy = positions.iter().map(|p| *p + DVec3::new(near(), near(), near())).collect();
    let (crossing, lined, worst, _) = against_cube(&detected(noisy, None));
    println!("noisy cube: {lined} of {crossing}, off by at most {:.4} spacings", worst / spacing);
    assert!(lined as f64 >= 0.85 * crossing as f64 && worst <= 0.2 * spacing);
}

#[test]
fn smooth_surfaces_have_no_features() {
    let mut random = SplitMix64::new(2);
    // Places at random, as far apart as a scan's: a jittered lattice.
    let golden = std::f64::consts::PI * (3.0 - 5f64.sqrt());
    let ball: Vec<DVec3> = (0..20_000)
        .map(|i| {
            let z = 1.0 - 2.0 * (f64::from(i) + random.unit()) / 20_000.0;
            let (sin, cos) = (golden * f64::from(i) + 0.01 * random.unit()).sin_cos();
            DVec3::new((1.0 - z * z).sqrt() * cos, (1.0 - z * z).sqrt() * sin, z)
        })
        .collect();
    assert_eq!(count(&detected(ball.clone(), None)), 0);
    let mut near = || (0.02 * (random.unit() - 0.5)) as f32;
    let normals =
        ball.iter().map(|p| (p.as_vec3() + Vec3::new(near(), near(), near())).normalize_or_zero());
    assert_eq!(count(&detected(ball.clone(), Some(normals.collect()))), 0);
    let relief = (0..20_000).map(|_| {
        let (x, y) = (random.unit() * 10.0, random.unit() * 10.0);
        DVec3::new(x, y, 0.3 * (1.3 * x).sin() * (1.1 * y).cos())
    });
    assert_eq!(count(&detected(relief.collect(), None)), 0);
    for few in [vec![], vec![DVec3::ONE; 40], ball[..2].to_vec(), vec![DVec3::NAN; 9]] {
        assert_eq!(count(&detected(few, None)), 0);
    }
}

#[test]
fn a_wall_on_a_floor_ends_and_the_floor_does_not() {
    let mut positions = Vec::new();
    for (x, y) in (0..40).flat_map(|x| (0..40).map(move |y| (f64::from(x), f64::from(y)))) {
        positions.push(DVec3::new(x - 19.6, y, 0.0));
        if x >= 0.0 {
            positions.push(DVec3::new(0.0, y, x + 0.5));
        }
    }
    let cloud = detected(positions, None);
    let clips = cloud.clips.unwrap();
    for (position, clip) in cloud.positions.iter().zip(&clips) {
        if (4.0..36.0).contains(&position.y) && position.z == 0.0 {
            assert_eq!(*clip, Clip::NONE, "{position}");
        }
    }
}
