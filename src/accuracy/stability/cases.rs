//! The classes of splats in the report.

use std::f64::consts::TAU;

use glam::{DVec2, DVec3, Vec2, Vec3, dvec2};

use crate::scene::random::SplitMix64;

/// One class of splats.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Class {
    Ordinary,
    /// Angle in radians between the disk's plane and the line of sight.
    EdgeOn(f64),
    /// `F·|(t_u.z, t_v.z)|` over the depth; at 1 the disk touches the camera plane.
    Large(f64),
    /// Axes of this length, at a distance of 1 to 20 units.
    Tiny(f64),
    /// The eye 10⁻³ to 10⁻⁹ units from the sample, or on it.
    NearEye,
    Far,
    /// Ratio of the two axes.
    Ratio(f64),
    /// Axes of length 10¹².
    Huge,
    /// Angle in degrees between the viewing direction and the sample.
    OffAxis(f64),
    /// Vertical field of view in degrees.
    FieldOfView(f64),
    ZeroAxis,
    ZeroAxes,
    /// The camera plane intersects the disk, barely misses it, or lies in front of it.
    Crossing,
}

/// All rows of the report, in order.
pub fn classes() -> Vec<Class> {
    let mut all = vec![Class::Ordinary];
    all.extend((1..=12).map(|decade| Class::EdgeOn(10f64.powi(-decade))));
    all.extend([0.3, 0.9, 0.999].map(Class::Large));
    all.extend([1e-4, 1e-8, 1e-12].map(Class::Tiny));
    all.extend([Class::Huge, Class::NearEye, Class::Far]);
    all.extend([1e2, 1e4, 1e6].map(Class::Ratio));
    all.extend([60.0, 89.0].map(Class::OffAxis));
    all.extend([0.01, 179.0].map(Class::FieldOfView));
    all.extend([Class::ZeroAxis, Class::ZeroAxes, Class::Crossing]);
    all
}

/// A disk in camera space (x right, y down, z forward, the eye at 0). Its tangents are as long as its kernel's standard deviations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Disk {
    pub centre: Vec3,
    pub tangents: [Vec3; 2],
}

/// The parameters of a camera on which the image of a disk depends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lens {
    /// Pixels per unit of tangent, positive.
    pub focal_px: Vec2,
    /// The point of the image that the viewing direction meets.
    pub principal_px: Vec2,
}

impl Lens {
    /// The lens of disks that were already multiplied by their camera's intrinsics.
    pub const UNIT: Lens = Lens { focal_px: Vec2::ONE, principal_px: Vec2::ZERO };
}

impl Disk {
    /// Multiplies a disk by the intrinsics of its camera, which gives the form that shaders take: `(x·z px, y·z px, z)`.
    pub fn through(&self, lens: &Lens) -> Disk {
        let (focal, principal) = (lens.focal_px.as_dvec2(), lens.principal_px.as_dvec2());
        let through = |v: Vec3| {
            let v = v.as_dvec3();
            (focal * v.truncate() + principal * v.z).extend(v.z).as_vec3()
        };
        Disk { centre: through(self.centre), tangents: self.tangents.map(through) }
    }
}

/// A splat of the report.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Case {
    pub disk: Disk,
    pub cutoff: f32,
    pub lens: Lens,
}

/// Half the side of the image, in pixels.
const HALF_PX: f64 = 512.0;
/// Default number of pixels per unit of tangent.
const FOCAL_PX: f64 = 900.0;

fn unit(random: &mut SplitMix64) -> DVec3 {
    let (z, turn) = (random.range(-1.0, 1.0), random.range(0.0, TAU));
    let (sin, cos) = turn.sin_cos();
    DVec3::new((1.0 - z * z).sqrt() * cos, (1.0 - z * z).sqrt() * sin, z)
}

/// `10^exponent` with a uniform exponent between `low` and `high`.
fn decades(random: &mut SplitMix64, low: f64, high: f64) -> f64 {
    10f64.powf(random.range(low, high))
}

/// Two orthogonal unit vectors in the plane with this normal, turned by a random angle.
fn frame(normal: DVec3, random: &mut SplitMix64) -> [DVec3; 2] {
    let (x, y) = normal.any_orthonormal_pair();
    let (sin, cos) = random.range(0.0, TAU).sin_cos();
    [x * cos + y * sin, y * cos - x * sin]
}

impl Class {
    pub fn name(self) -> String {
        match self {
            Class::Ordinary => "ordinary".into(),
            Class::EdgeOn(angle) => format!("edge-on within {angle:.0e} rad"),
            Class::Large(part) => format!("reaches {part} of its depth"),
            Class::Tiny(size) => format!("axes {size:.0e} at 1–20"),
            Class::NearEye => "eye nearly on the sample".into(),
            Class::Far => "1e6 away".into(),
            Class::Ratio(ratio) => format!("axes 1 : {ratio:.0e}"),
            Class::Huge => "axes 1e12".into(),
            Class::OffAxis(degrees) => format!("{degrees}° off axis"),
            Class::FieldOfView(degrees) => format!("field of view {degrees}°"),
            Class::ZeroAxis => "one axis zero".into(),
            Class::ZeroAxes => "both axes zero".into(),
            Class::Crossing => "about the camera plane".into(),
        }
    }

    /// Draws a random splat of the class.
    pub fn draw(self, random: &mut SplitMix64) -> Case {
        let focal = match self {
            Class::FieldOfView(degrees) => HALF_PX / (degrees.to_radians() / 2.0).tan(),
            _ => FOCAL_PX,
        };
        let cutoff = random.range(1.0, 3.0);
        let depth = match self {
            Class::NearEye => decades(random, -9.0, -3.0),
            Class::Far => 1e6 * random.range(0.5, 2.0),
            Class::Huge if random.chance(0.5) => 1e13 * random.range(0.5, 2.0),
            _ => random.range(1.0, 20.0),
        };
        let tan = match self {
            Class::OffAxis(degrees) => {
                DVec2::from_angle(random.range(0.0, TAU)) * degrees.to_radians().tan()
            }
            _ => dvec2(random.range(-1.0, 1.0), random.range(-1.0, 1.0)) * (HALF_PX / focal),
        };
        let mut centre = tan.extend(1.0) * depth;
        let distance = centre.length();
        let [mut u, mut v] = self.tangents(centre, distance, cutoff, random);
        match self {
            Class::NearEye if random.chance(0.01) => centre = DVec3::ZERO,
            // A disk of a scene's usual size has to be nearly parallel to the image, or it would reach the camera plane.
            Class::NearEye if random.chance(0.5) => {
                let part = random.range(0.0, 0.6) / cutoff;
                (u, v) = (u * (0.01 / distance), v * (0.01 / distance));
                (u.z, v.z) = (part * depth, -part * depth);
            }
            Class::Huge if random.chance(0.5) => (u.z, v.z) = (0.0, 0.0),
            Class::Crossing if random.chance(0.5) => centre.z = -centre.z,
            _ => {}
        }
        Case {
            disk: Disk { centre: centre.as_vec3(), tangents: [u.as_vec3(), v.as_vec3()] },
            cutoff: cutoff as f32,
            lens: Lens {
                focal_px: Vec2::splat(focal as f32),
                principal_px: Vec2::splat(HALF_PX as f32),
            },
        }
    }

    fn tangents(
        self,
        centre: DVec3,
        distance: f64,
        cutoff: f64,
        random: &mut SplitMix64,
    ) -> [DVec3; 2] {
        let ray = centre / distance;
        let normal = match self {
            Class::EdgeOn(angle) => {
                let [across, _] = frame(ray, random);
                across * angle.cos() + ray * angle.sin()
            }
            // A disk parallel to the image has a single depth.
            Class::Large(_) | Class::Crossing => {
                let (sin, cos) = random.range(0.0, TAU).sin_cos();
                DVec3::new(cos, sin, random.range(-1.0, 1.0))
            }
            _ => unit(random),
        };
        let normal = normal.try_normalize().unwrap_or(DVec3::Z);
        let [u, v] = frame(normal, random);
        let size = match self {
            Class::Tiny(size) => size,
            Class::Huge => 1e12,
            _ => distance * random.range(0.005, 0.05),
        };
        let other = match self {
            Class::Ratio(ratio) => size / ratio,
            Class::Tiny(_) | Class::Huge | Class::EdgeOn(_) => size,
            _ => size * random.range(0.3, 1.0),
        };
        let (u, v) = (u * size, v * other);
        let deep = cutoff * dvec2(u.z, v.z).length() / centre.z;
        match self {
            Class::Large(part) => [u * (part / deep), v * (part / deep)],
            Class::Crossing => {
                let near = decades(random, -9.0, 0.0);
                let part = if random.chance(0.5) { 1.0 + near } else { 1.0 - near };
                [u * (part / deep), v * (part / deep)]
            }
            Class::ZeroAxis => [u, DVec3::ZERO],
            Class::ZeroAxes => [DVec3::ZERO; 2],
            _ => [u, v],
        }
    }
}
