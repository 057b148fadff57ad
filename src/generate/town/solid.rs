//! The solids of the town, and their intersections with rays.
//!
//! There are three shapes: convex polyhedra (walls, roofs, cars), upright cylinders (posts, trunks) and ellipsoids, which are
//! either hard or filled with leaves. Leaves are a lattice of small cells. A hash of its place decides whether a cell has a leaf,
//! so leaves are the same from every side, and rays pass between them.

use glam::{DVec2, DVec3};

use super::super::numeric::hash_unit;
use super::skin::SkinId;
use crate::math::Bounds;

/// A half-line with unit direction.
#[derive(Clone, Copy, Debug)]
pub struct Ray {
    pub origin: DVec3,
    pub direction: DVec3,
}

impl Ray {
    pub fn at(&self, t: f64) -> DVec3 {
        self.origin + self.direction * t
    }
}

/// The hit of a ray with a surface.
#[derive(Clone, Copy, Debug)]
pub struct Hit {
    /// Distance from the ray's origin in metres.
    pub t: f64,
    pub normal: DVec3,
    pub skin: SkinId,
}

/// The half-space `normal · p ≤ offset`, and the skin of its boundary.
#[derive(Clone, Copy, Debug)]
pub struct Face {
    pub normal: DVec3,
    pub offset: f64,
    pub skin: SkinId,
}

#[derive(Clone, Debug)]
pub enum Shape {
    Convex(Vec<Face>),
    /// An upright cylinder from `base` to `base + height`, closed at the top.
    Cylinder {
        base: DVec3,
        radius: f64,
        height: f64,
        skin: SkinId,
    },
    Ellipsoid {
        centre: DVec3,
        radii: DVec3,
        skin: SkinId,
    },
    /// An ellipsoid of leaves. `density` is the share of its cells that have one.
    Leaves {
        centre: DVec3,
        radii: DVec3,
        density: f64,
        skin: SkinId,
        seed: u64,
    },
}

/// A shape and its bounding box.
#[derive(Clone, Debug)]
pub struct Solid {
    pub shape: Shape,
    pub bounds: Bounds,
}

/// Edge of a leaf cell in metres.
const LEAF_CELL: f64 = 0.17;

impl Solid {
    pub fn new(shape: Shape) -> Solid {
        let bounds = match &shape {
            Shape::Convex(faces) => convex_bounds(faces),
            Shape::Cylinder { base, radius, height, .. } => Bounds {
                min: *base - DVec3::new(*radius, *radius, 0.0),
                max: *base + DVec3::new(*radius, *radius, *height),
            },
            Shape::Ellipsoid { centre, radii, .. } | Shape::Leaves { centre, radii, .. } => {
                Bounds { min: *centre - *radii, max: *centre + *radii }
            }
        };
        Solid { shape, bounds }
    }

    /// The nearest hit in `near..far`, entering from outside.
    pub fn hit(&self, ray: &Ray, near: f64, far: f64) -> Option<Hit> {
        match &self.shape {
            Shape::Convex(faces) => hit_convex(faces, ray, near, far),
            Shape::Cylinder { base, radius, height, skin } => {
                hit_cylinder(ray, near, far, *base, *radius, *height, *skin)
            }
            Shape::Ellipsoid { centre, radii, skin } => {
                let (enter, _) = ellipsoid_span(ray, *centre, *radii)?;
                (enter > near && enter < far).then(|| {
                    let normal = (ray.at(enter) - *centre) / (*radii * *radii);
                    Hit { t: enter, normal: normal / normal.length(), skin: *skin }
                })
            }
            Shape::Leaves { centre, radii, density, skin, seed } => {
                let (enter, leave) = ellipsoid_span(ray, *centre, *radii)?;
                let span = (enter.max(near), leave.min(far));
                hit_leaves(ray, span, *centre, *radii, *density, *skin, *seed)
            }
        }
    }
}

impl Solid {
    /// Whether `p` is inside by more than `depth`. Nothing is inside leaves.
    pub fn contains(&self, p: DVec3, depth: f64) -> bool {
        match &self.shape {
            Shape::Convex(faces) => faces.iter().all(|f| f.normal.dot(p) < f.offset - depth),
            Shape::Cylinder { base, radius, height, .. } => {
                let d = p - *base;
                let inner = radius - depth;
                inner > 0.0
                    && d.x * d.x + d.y * d.y < inner * inner
                    && d.z > depth
                    && d.z < height - depth
            }
            Shape::Ellipsoid { centre, radii, .. } => {
                let inner = *radii - depth;
                inner.min_element() > 0.0 && ((p - *centre) / inner).length_squared() < 1.0
            }
            Shape::Leaves { .. } => false,
        }
    }
}

/// The bounding box of a convex solid. Its corners are where three faces meet inside all others.
fn convex_bounds(faces: &[Face]) -> Bounds {
    let mut bounds = Bounds::EMPTY;
    for (i, a) in faces.iter().enumerate() {
        for (j, b) in faces.iter().enumerate().skip(i + 1) {
            for c in faces.iter().skip(j + 1) {
                let bc = b.normal.cross(c.normal);
                let volume = a.normal.dot(bc);
                if volume.abs() < 1e-9 {
                    continue;
                }
                let ca = c.normal.cross(a.normal);
                let ab = a.normal.cross(b.normal);
                let corner = (bc * a.offset + ca * b.offset + ab * c.offset) / volume;
                if faces.iter().all(|f| f.normal.dot(corner) <= f.offset + 1e-6) {
                    bounds.add(corner);
                }
            }
        }
    }
    bounds
}

fn hit_convex(faces: &[Face], ray: &Ray, near: f64, far: f64) -> Option<Hit> {
    let (mut enter, mut leave) = (near, far);
    let mut entered: Option<&Face> = None;
    for face in faces {
        let slope = face.normal.dot(ray.direction);
        let distance = face.offset - face.normal.dot(ray.origin);
        if slope < 0.0 {
            let t = distance / slope;
            if t > enter {
                enter = t;
                entered = Some(face);
            }
        } else if slope > 0.0 {
            leave = leave.min(distance / slope);
        } else if distance < 0.0 {
            return None;
        }
        if enter >= leave {
            return None;
        }
    }
    entered.map(|face| Hit { t: enter, normal: face.normal, skin: face.skin })
}

fn hit_cylinder(
    ray: &Ray,
    near: f64,
    far: f64,
    base: DVec3,
    radius: f64,
    height: f64,
    skin: SkinId,
) -> Option<Hit> {
    let o = DVec2::new(ray.origin.x - base.x, ray.origin.y - base.y);
    let d = DVec2::new(ray.direction.x, ray.direction.y);
    let top = base.z + height;
    if ray.direction.z < 0.0 && ray.origin.z > top {
        let t = (top - ray.origin.z) / ray.direction.z;
        if t > near && t < far && (o + d * t).length_squared() <= radius * radius {
            return Some(Hit { t, normal: DVec3::Z, skin });
        }
    }
    let a = d.length_squared();
    let b = o.dot(d);
    let inside = b * b - a * (o.length_squared() - radius * radius);
    if a < 1e-12 || inside <= 0.0 {
        return None;
    }
    let t = (-b - inside.sqrt()) / a;
    let z = ray.origin.z + ray.direction.z * t;
    if !(t > near && t < far && z >= base.z && z <= top) {
        return None;
    }
    let n = (o + d * t) / radius;
    Some(Hit { t, normal: DVec3::new(n.x, n.y, 0.0), skin })
}

/// The distances at which a ray enters and leaves an ellipsoid.
fn ellipsoid_span(ray: &Ray, centre: DVec3, radii: DVec3) -> Option<(f64, f64)> {
    let o = (ray.origin - centre) / radii;
    let d = ray.direction / radii;
    let (a, b, c) = (d.length_squared(), o.dot(d), o.length_squared() - 1.0);
    let inside = b * b - a * c;
    if inside <= 0.0 {
        return None;
    }
    let root = inside.sqrt();
    Some(((-b - root) / a, (-b + root) / a))
}

fn hit_leaves(
    ray: &Ray,
    (enter, leave): (f64, f64),
    centre: DVec3,
    radii: DVec3,
    density: f64,
    skin: SkinId,
    seed: u64,
) -> Option<Hit> {
    let mut t = enter + 0.5 * LEAF_CELL;
    while t < leave {
        let p = ray.at(t);
        let [x, y, z] = (p / LEAF_CELL).floor().to_array().map(|c| c as i64);
        let chance = hash_unit(x, y, z, seed);
        if chance < density {
            let r2 = ((p - centre) / radii).length_squared();
            // Leaves grow in the light: few in the middle, and in clumps of half a metre.
            let clump = hash_unit(x >> 1, y >> 1, z >> 1, seed ^ 0x51);
            if chance < density * (0.25 + 0.75 * r2) && clump > 0.25 {
                let lean = |k: i64| hash_unit(x, y, z + k * 1_000_003, seed) - 0.5;
                let outward = (p - centre) / radii;
                let n = outward + 1.4 * DVec3::new(lean(1), lean(2), lean(3)) + DVec3::Z * 0.3;
                let jitter = LEAF_CELL * (hash_unit(z, x, y, seed) - 0.5);
                let length = n.length();
                let normal = if length > 1e-6 { n / length } else { DVec3::Z };
                return Some(Hit { t: t + jitter, normal, skin });
            }
        }
        t += 0.8 * LEAF_CELL;
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    const SKIN: SkinId = SkinId(0);

    fn unit_box() -> Solid {
        let faces = [DVec3::X, DVec3::Y, DVec3::Z]
            .into_iter()
            .flat_map(|n| [n, -n])
            .map(|normal| Face { normal, offset: 1.0, skin: SKIN })
            .collect();
        Solid::new(Shape::Convex(faces))
    }

    #[test]
    fn rays_meet_shapes_where_they_should() {
        let ray = Ray { origin: DVec3::new(-5.0, 0.2, 0.1), direction: DVec3::X };
        let solid = unit_box();
        assert!((solid.bounds.max - DVec3::ONE).length() < 1e-9);
        let hit = solid.hit(&ray, 0.0, 100.0).unwrap();
        assert_eq!((hit.t, hit.normal), (4.0, DVec3::NEG_X));
        assert!(solid.hit(&ray, 0.0, 3.9).is_none());
        assert!(solid.hit(&Ray { direction: DVec3::NEG_X, ..ray }, 0.0, 100.0).is_none());
        let ball =
            Shape::Ellipsoid { centre: DVec3::ZERO, radii: DVec3::new(2.0, 1.0, 1.0), skin: SKIN };
        let axis = Ray { origin: DVec3::new(-5.0, 0.0, 0.0), direction: DVec3::X };
        let hit = Solid::new(ball).hit(&axis, 0.0, 100.0).unwrap();
        assert!((hit.t - 3.0).abs() < 1e-12 && (hit.normal - DVec3::NEG_X).length() < 1e-12);
        let post = Shape::Cylinder { base: DVec3::ZERO, radius: 0.5, height: 2.0, skin: SKIN };
        let post = Solid::new(post);
        let hit =
            post.hit(&Ray { origin: DVec3::new(-5.0, 0.0, 1.0), direction: DVec3::X }, 0.0, 9.0);
        assert!((hit.unwrap().t - 4.5).abs() < 1e-12);
        let down = Ray { origin: DVec3::new(0.2, 0.0, 5.0), direction: DVec3::NEG_Z };
        assert_eq!(post.hit(&down, 0.0, 9.0).unwrap().normal, DVec3::Z);
    }

    #[test]
    fn leaves_let_some_rays_through_and_look_the_same_from_both_sides() {
        let crown = Solid::new(Shape::Leaves {
            centre: DVec3::ZERO,
            radii: DVec3::splat(1.5),
            density: 0.3,
            skin: SKIN,
            seed: 5,
        });
        let mut met = 0;
        for i in 0..400 {
            let (y, z) = (f64::from(i % 20) * 0.1 - 1.0, f64::from(i / 20) * 0.1 - 1.0);
            let ray = Ray { origin: DVec3::new(-9.0, y, z), direction: DVec3::X };
            if let Some(hit) = crown.hit(&ray, 0.0, 50.0) {
                met += 1;
                assert!(crown.bounds.min.x - 0.2 < ray.at(hit.t).x);
                assert!((hit.normal.length() - 1.0).abs() < 1e-9);
            }
        }
        assert!((150..400).contains(&met), "{met}");
    }
}
