//! Solids sampled here, combined, and held against what they are in closed form.

use std::f64::consts::TAU;

use glam::{DAffine3, DMat3};

use super::*;
use crate::assets::ClipLine;
use crate::scene::random::SplitMix64;

fn combine(operation: CsgOperation, operands: &[PointCloud]) -> Result<PointCloud, CsgError> {
    super::combine(operation, operands, &Admission::default())
}

/// Distance between neighbouring samples of the solids here.
const SPACING: f64 = 0.1;

#[test]
fn a_combination_ends_when_it_is_cancelled() {
    let mut block = Builder::default();
    block.add(DVec3::ZERO, DVec3::Z);
    block.add(DVec3::X * SPACING, DVec3::Z);
    let admission = Admission::default();
    admission.cancel();
    let result = super::combine(CsgOperation::Union, &[block.0.clone(), block.0], &admission);
    assert_eq!(result.err(), Some(CsgError::Interrupted(Interrupt::Cancelled)));
}

/// Collects samples with round kernels that cover their neighbourhood.
#[derive(Default)]
struct Builder(PointCloud);

impl Builder {
    fn add(&mut self, position: DVec3, normal: DVec3) {
        let normal = normal / normal.length();
        let (u, v) = normal.any_orthonormal_pair();
        // The disk, of two standard deviations, reaches the middle of a square of samples.
        let sigma = 0.5 * SPACING * 0.75;
        self.0.positions.push(position);
        self.0.normals.get_or_insert_default().push(normal.as_vec3());
        let kernel = Kernel { u: (u * sigma).as_vec3(), v: (v * sigma).as_vec3() };
        self.0.kernels.get_or_insert_default().push(kernel);
    }

    /// A rectangle from `corner` along `a` and `b`, seen from `a × b`.
    fn rectangle(&mut self, corner: DVec3, a: DVec3, b: DVec3) {
        let (na, nb) = ((a.length() / SPACING).ceil(), (b.length() / SPACING).ceil());
        for i in 0..na as u32 {
            for j in 0..nb as u32 {
                let (s, t) = ((f64::from(i) + 0.5) / na, (f64::from(j) + 0.5) / nb);
                self.add(corner + a * s + b * t, a.cross(b));
            }
        }
    }

    fn cuboid(half: DVec3) -> PointCloud {
        let mut made = Builder::default();
        let DVec3 { x, y, z } = half;
        let axes = [DVec3::X * x, DVec3::Y * y, DVec3::Z * z];
        for axis in 0..3 {
            let (n, a, b) = (axes[axis], axes[(axis + 1) % 3], axes[(axis + 2) % 3]);
            made.rectangle(n - a - b, a * 2.0, b * 2.0);
            made.rectangle(-n - a - b, b * 2.0, a * 2.0);
        }
        made.0
    }

    /// About the z axis.
    fn cylinder(radius: f64, half: f64) -> PointCloud {
        let mut made = Builder::default();
        let around = (TAU * radius / SPACING).ceil();
        let along = (2.0 * half / SPACING).ceil();
        for i in 0..along as u32 {
            for j in 0..around as u32 {
                let (s, c) = (TAU * (f64::from(j) + 0.5 * f64::from(i % 2)) / around).sin_cos();
                let z = half * (2.0 * (f64::from(i) + 0.5) / along - 1.0);
                made.add(DVec3::new(radius * c, radius * s, z), DVec3::new(c, s, 0.0));
            }
        }
        let rings = (radius / SPACING).ceil();
        for ring in 0..rings as u32 {
            let r = radius * (f64::from(ring) + 0.5) / rings;
            let count = (TAU * r / SPACING).ceil();
            for j in 0..count as u32 {
                let (s, c) = (TAU * f64::from(j) / count).sin_cos();
                for side in [-1.0, 1.0] {
                    made.add(DVec3::new(r * c, r * s, side * half), DVec3::Z * side);
                }
            }
        }
        made.0
    }

    fn sphere(radius: f64) -> PointCloud {
        let mut made = Builder::default();
        let count = (2.0 * TAU * radius * radius / (SPACING * SPACING)) as u32;
        for i in 0..count {
            // Spherical Fibonacci points.
            let z = 1.0 - (2.0 * f64::from(i) + 1.0) / f64::from(count);
            let (s, c) = (f64::from(i) * 2.399_963_229_728_653).sin_cos();
            let n = DVec3::new((1.0 - z * z).sqrt() * c, (1.0 - z * z).sqrt() * s, z);
            made.add(n * radius, n);
        }
        made.0
    }
}

fn moved(cloud: &PointCloud, by: DVec3) -> PointCloud {
    transformed(cloud, &DAffine3::from_translation(by))
}

// Signed distances, exact near the surface, negative inside.
fn box_distance(half: DVec3, p: DVec3) -> f64 {
    let q = p.abs() - half;
    q.max(DVec3::ZERO).length() + q.max_element().min(0.0)
}

fn cylinder_distance(radius: f64, half: f64, p: DVec3) -> f64 {
    let (a, b) = (p.truncate().length() - radius, p.z.abs() - half);
    a.max(0.0).hypot(b.max(0.0)) + a.max(b).min(0.0)
}

/// Part of random places, farther than half a spacing from the surface, whose side is found right.
fn part_right(cloud: &PointCloud, reach: f64, distance: impl Fn(DVec3) -> f64) -> f64 {
    let samples = samples_of(cloud);
    let surface = Surface::new(&samples);
    let mut random = SplitMix64::new(5);
    let (mut tried, mut right) = (0u32, 0u32);
    while tried < 40_000 {
        let at = DVec3::from_array([(); 3].map(|()| random.range(-reach, reach)));
        let d = distance(at);
        // Half of the places near the surface, where it is difficult.
        if d.abs() < 0.5 * SPACING || (d.abs() > 3.0 * SPACING && tried % 2 == 0) {
            continue;
        }
        tried += 1;
        right += u32::from(surface.is_inside(at) == (d < 0.0));
    }
    f64::from(right) / f64::from(tried)
}

#[test]
fn inside_is_told_from_outside() {
    let half = DVec3::new(1.0, 0.8, 0.5);
    let (block, bore) = (Builder::cuboid(half), Builder::cylinder(0.4, 0.7));
    let block_distance = |p| box_distance(half, p);
    let bore_distance = |p| cylinder_distance(0.4, 0.7, p);
    let drilled = combine(CsgOperation::Difference, &[block.clone(), bore.clone()]).unwrap();
    let post = combine(CsgOperation::Union, &[block.clone(), bore.clone()]).unwrap();
    let corner = moved(&Builder::cuboid(DVec3::splat(0.6)), half);
    let notched = combine(CsgOperation::Difference, &[block.clone(), corner]).unwrap();
    let corner_distance = |p| box_distance(DVec3::splat(0.6), p - half);
    let plate = DVec3::new(1.0, 0.8, 0.06);
    let found = [
        ("sphere", part_right(&Builder::sphere(0.8), 1.3, |p| p.length() - 0.8)),
        ("box", part_right(&block, 1.3, block_distance)),
        ("plate", part_right(&Builder::cuboid(plate), 1.3, |p| box_distance(plate, p))),
        ("cylinder", part_right(&bore, 1.0, bore_distance)),
        (
            "box with a bore",
            part_right(&drilled, 1.3, |p| block_distance(p).max(-bore_distance(p))),
        ),
        ("box with a post", part_right(&post, 1.3, |p| block_distance(p).min(bore_distance(p)))),
        (
            "box without a corner",
            part_right(&notched, 1.3, |p| block_distance(p).max(-corner_distance(p))),
        ),
    ];
    println!("right: {found:?}");
    for (name, part) in found {
        assert!(part >= 0.999, "{name}: {part}");
    }
}

/// Tells whether any kept part of a disk comes within `near` of a position.
fn is_covered(samples: &[Sample], at: DVec3, near: f64) -> bool {
    samples.iter().any(|s| {
        let offset = at - s.position;
        let (a, b) =
            (offset.dot(s.u) / s.u.length_squared(), offset.dot(s.v) / s.v.length_squared());
        let kernel = Vec2::new(a as f32, b as f32);
        kernel.length() <= CUTOFF as f32
            && offset.dot(s.normal).abs() <= near
            && s.clip.keeps(kernel)
    })
}

#[test]
fn a_bore_is_cut_along_its_circle() {
    let half = DVec3::new(1.0, 0.8, 0.5);
    let radius = 0.5;
    let bore = Builder::cylinder(radius, 0.75);
    let drilled = combine(CsgOperation::Difference, &[Builder::cuboid(half), bore]).unwrap();
    let samples = samples_of(&drilled);
    let mut worst = 0.0f64;
    let mut lines = 0;
    for s in &samples {
        let on_face = s.normal.z.abs() > 0.9;
        for line in s.clip.lines.iter().flatten() {
            let foot = s.place(line.normal * line.offset);
            let error =
                if on_face { foot.truncate().length() - radius } else { foot.z.abs() - half.z };
            worst = worst.max(error.abs());
            lines += 1;
        }
        // The wall of the bore looks at its axis.
        if s.normal.z.abs() < 0.1 && s.position.truncate().length() < radius + 0.01 {
            assert!(s.normal.dot(s.position) < 0.0);
        }
        assert!(s.u.cross(s.v).dot(s.normal) > 0.0);
    }
    println!("{lines} lines, curve off by at most {} spacings", worst / SPACING);
    assert!(lines > 60 && worst <= 0.1 * SPACING, "{lines} lines, {worst}");
    // On either side of the rim both faces are covered up to it, and not beyond.
    for i in 0..720 {
        let (sin, cos) = (TAU * f64::from(i) / 720.0).sin_cos();
        let rim = |r: f64, z: f64| DVec3::new(r * cos, r * sin, z);
        let step = 0.15 * SPACING;
        let near = 0.2 * SPACING;
        assert!(is_covered(&samples, rim(radius + step, half.z), near), "face at {i}");
        assert!(is_covered(&samples, rim(radius, half.z - step), near), "wall at {i}");
        assert!(!is_covered(&samples, rim(radius - step, half.z), 0.01 * SPACING), "hole at {i}");
        assert!(!is_covered(&samples, rim(radius, half.z + step), 0.1 * SPACING), "above at {i}");
    }
}

#[test]
fn corners_take_two_lines() {
    let cube = Builder::cuboid(DVec3::splat(0.52));
    let other = moved(&cube, DVec3::splat(0.5));
    let count = |operation| {
        let made = combine(operation, &[cube.clone(), other.clone()]).unwrap();
        let two = |clip: &&Clip| clip.lines[1].is_some();
        let clips = made.clips.unwrap();
        let either = clips.iter().filter(two).filter(|clip| clip.either).count();
        (clips.iter().filter(two).count() - either, either)
    };
    let ((_, union), (intersection, _), (_, difference)) = (
        count(CsgOperation::Union),
        count(CsgOperation::Intersection),
        count(CsgOperation::Difference),
    );
    // Faces of the first end at a corner that the other bites out; those of an intersection end within it.
    assert!(union > 0 && intersection > 0 && difference > 0, "{union} {intersection} {difference}");
}

#[test]
fn faces_that_coincide_stay_once_or_not_at_all() {
    let raw = Builder::cuboid(DVec3::splat(0.5));
    // With itself, its own edges clip its disks.
    let cube = combine(CsgOperation::Intersection, &[raw.clone(), raw.clone()]).unwrap();
    assert_eq!(cube.positions, raw.positions);
    let beside = moved(&cube, DVec3::X);
    let joined = combine(CsgOperation::Union, &[cube.clone(), beside.clone()]).unwrap();
    let on_seam = |cloud: &PointCloud| {
        let normals = cloud.normals.clone().unwrap();
        let seam = |(p, n): (&DVec3, Vec3)| (p.x - 0.5).abs() < 1e-6 && n.x.abs() > 0.9;
        cloud.positions.iter().zip(normals).filter(|&(p, n)| seam((p, n))).count()
    };
    assert_eq!(on_seam(&joined), 0);
    assert_eq!(on_seam(&combine(CsgOperation::Difference, &[cube.clone(), beside]).unwrap()), 100);
    let same = combine(CsgOperation::Union, &[cube.clone(), cube.clone()]).unwrap();
    assert_eq!(same.positions, cube.positions);
    let same = combine(CsgOperation::Intersection, &[cube.clone(), cube.clone()]).unwrap();
    assert_eq!(same.positions, cube.positions);
    let none = combine(CsgOperation::Difference, &[cube.clone(), cube.clone()]).unwrap();
    assert!(none.positions.is_empty(), "{}", none.positions.len());
    // A tool that ends flush with the block's face.
    let tool = moved(&Builder::cylinder(0.25, 0.3), DVec3::Z * 0.2);
    let pocket = combine(CsgOperation::Difference, &[cube, tool]).unwrap();
    let samples = samples_of(&pocket);
    assert!(!is_covered(&samples, DVec3::new(0.0, 0.0, 0.5), 0.01));
    assert!(!is_covered(&samples, DVec3::new(0.22, 0.0, 0.5), 0.001));
    assert!(is_covered(&samples, DVec3::new(0.28, 0.0, 0.5), 0.001));
    assert!(is_covered(&samples, DVec3::new(0.0, 0.0, -0.1), 0.001));
}

#[test]
fn operations_agree_with_volumes_and_repeat() {
    let (a, b) = (Builder::sphere(0.7), moved(&Builder::sphere(0.7), DVec3::X * 0.6));
    let c = moved(&Builder::sphere(0.4), DVec3::new(0.3, 0.7, 0.0));
    let all = [a, b, c];
    for operation in [CsgOperation::Union, CsgOperation::Intersection, CsgOperation::Difference] {
        let made = combine(operation, &all).unwrap();
        let distances = |p: DVec3| {
            let c = p - DVec3::new(0.3, 0.7, 0.0);
            [p.length() - 0.7, (p - DVec3::X * 0.6).length() - 0.7, c.length() - 0.4]
        };
        let distance = |p: DVec3| {
            let [a, b, c] = distances(p);
            match operation {
                CsgOperation::Union => a.min(b).min(c),
                CsgOperation::Intersection => a.max(b).max(c),
                CsgOperation::Difference => a.max(-b).max(-c),
            }
        };
        // Kept parts lie on the result's surface, off by at most the height of a disk's rim above a sphere.
        let off = samples_of(&made).iter().fold(0.0f64, |worst, s| {
            let anchor = s.clip.keeps(Vec2::ZERO).then_some(s.position);
            anchor.map_or(worst, |at| worst.max(distance(at).abs()))
        });
        assert!(off <= 0.1 * SPACING, "{operation:?}: {off}");
        assert_eq!(format!("{made:?}"), format!("{:?}", combine(operation, &all).unwrap()));
    }
    let far = moved(&all[0], DVec3::X * 9.0);
    let two = combine(CsgOperation::Union, &[all[0].clone(), far.clone()]).unwrap();
    assert_eq!(two.positions.len(), 2 * far.positions.len());
    assert!(
        combine(CsgOperation::Intersection, &[all[0].clone(), far]).unwrap().positions.is_empty()
    );
}

#[test]
fn maps_take_kernels_and_clips_along() {
    let mut cloud = Builder::cuboid(DVec3::splat(0.5));
    let line = ClipLine { normal: Vec2::new(0.6, 0.8), offset: 0.3 };
    cloud.clips =
        Some(vec![Clip { lines: [Some(line), None], either: false }; cloud.positions.len()]);
    let linear = DMat3::from_rotation_y(0.4)
        * DMat3::from_diagonal(DVec3::new(2.0, -1.0, 0.5))
        * DMat3::from_rotation_x(0.7);
    let map = DAffine3::from_mat3_translation(linear, DVec3::new(1.0, 2.0, 3.0));
    let made = samples_of(&transformed(&cloud, &map));
    for (old, new) in samples_of(&cloud).iter().zip(&made) {
        assert!(new.u.dot(new.v).abs() < 1e-4 * new.u.length() * new.v.length());
        let facing = new.u.cross(new.v);
        assert!(facing.dot(new.normal) > 0.999 * facing.length());
        // Outward stays outward.
        assert!(new.normal.dot(map.transform_vector3(old.normal)) > 0.0);
        // The line's foot and a place on the rim are where the map takes them.
        let foot = map.transform_point3(old.place(line.normal * line.offset));
        let offset = foot - new.position;
        let kernel = DVec3::new(
            offset.dot(new.u) / new.u.length_squared(),
            offset.dot(new.v) / new.v.length_squared(),
            0.0,
        );
        let moved = new.clip.lines[0].unwrap();
        let along = moved.normal.as_dvec2().dot(kernel.truncate());
        assert!((along - f64::from(moved.offset)).abs() < 1e-4, "{along}");
        assert!((kernel.length() - 0.3).abs() < 1e-4);
    }
}

#[test]
fn operands_at_fault_are_named() {
    let good = Builder::sphere(0.5);
    let refused = |bad: PointCloud| combine(CsgOperation::Union, &[good.clone(), bad]).unwrap_err();
    let error = refused(PointCloud::default());
    assert_eq!((error.clone(), error.operand()), (CsgError::Empty { operand: 1 }, Some(1)));
    let bare = PointCloud { normals: None, ..good.clone() };
    assert_eq!(refused(bare), CsgError::NoNormals { operand: 1 });
    let bare = PointCloud { kernels: None, ..good.clone() };
    assert_eq!(refused(bare), CsgError::NoKernels { operand: 1 });
    assert_eq!(combine(CsgOperation::Union, &[]).unwrap_err(), CsgError::NoOperands);
}
