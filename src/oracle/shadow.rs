//! Shadows of suns and lamps: the share of a sun's disc, or of a lamp's ball, that is seen from a lit place.
//!
//! [`Occluders`] holds everything opaque that casts a shadow, whether the eye sees it or not, in a hierarchy of balls. [`Occluders::share`] sends rays from
//! the lit place to points of the disc and counts those that reach it. A lamp's ball is seen as the disc through its middle that faces the lit place.
//!
//! - *Triangles* cast shadows from both sides, and where their material cuts holes by alpha, only where it is opaque. The texture's finest level says
//!   where. Translucent triangles cast none.
//! - *Lines* cast the shadows of tubes, cones and ribbons of their true radius, even where the image shows them wider. Lines without radius
//!   cast none.
//! - *Samples* cast shadows as the image shows them. A splat is its disk out to the kernel's cutoff, less what clip lines take away; a splat
//!   without a normal is a circle that faces each ray. So is a disc of a diameter in scene units. Points of one pixel, and diameters in pixels,
//!   have no size in the scene and cast none.
//! - *Clip boxes* take away what they hide: a hit in a hidden place does not count. Where a ray enters a tube in a hidden place, it passes through it,
//!   as rays of the eye do.
//!
//! A surface must not shade itself by rounding. Hits therefore count only beyond a distance from the lit place, the greatest of three:
//!
//! - 10⁻⁶ of the place's distance from the eye and 10⁻⁹ of the scene's extent: far below a pixel, and far above the rounding of places, which are
//!   computed relative to the eye;
//! - the thickness of the lit surface ([`Surface::thickness`]). Splats within the depth offset of the nearest one are blended as one surface,
//!   and the lit place is the mean of their depths, so that some of them lie before it. Places of thin lines lie somewhere on a
//!   cylinder that is lit as a whole, and have twice its width;
//! - the thickness of the surface that is hit: a splat's depth offset times its radius (in each blend mode), or a disc's radius. A disk
//!   that touches a curved surface rises above it by far less than its radius. A ray meets such a disk within the offset, unless the ray nearly grazes
//!   the surface.
//!
//! The rays' directions are a fixed Vogel spiral (Vogel 1979) over the disc, whose points each stand for the same area of the plane that touches the
//! sphere of directions. A hard sun has one ray.

use glam::DVec3;

use crate::assets::{Clip, Geometry, PointCloud};
use crate::math::{Tube, View};
use crate::scene::{Casting, Light};

use super::lines::{self, TrueSegment};
use super::prepare::{Prepared, PreparedItem};
use super::splats::{camera_from_view, clip, normal, tangents};
use super::surface::{Surface, is_cut_out_at};
use super::visibility::Hit;

/// Rays to a light that has a size. Across the penumbra of a straight edge the share is wrong by 0.015 at most.
const RAYS: u32 = 256;

/// Angle between neighbouring points of a Vogel spiral, in radians.
const GOLDEN_ANGLE: f64 = 2.399_963_229_728_653;

/// Everything that casts shadows, relative to the eye in world axes.
pub struct Occluders {
    root: Option<Ball>,
    eye: DVec3,
    /// Distance to the farthest point of the scene from the middle of its bounds.
    extent: f64,
}

/// A ball around one occluder or two balls.
struct Ball {
    centre: DVec3,
    radius: f64,
    inside: Inside,
}

enum Inside {
    One(Occluder),
    Two(Box<[Ball; 2]>),
}

enum Occluder {
    Triangle {
        corners: [DVec3; 3],
        /// The mesh's item and the triangle's number; `None` for one half of a ribbon's segment.
        source: Option<[u32; 2]>,
    },
    Tube(Tube),
    /// Points `centre + s·u + t·v` with `s² + t² ≤ reach²`, as far as the clip lines keep them.
    Disk {
        centre: DVec3,
        axes: [DVec3; 2],
        reach: f64,
        clip: Clip,
        thickness: f64,
    },
    /// A circle that faces each ray.
    Facing {
        centre: DVec3,
        radius: f64,
        thickness: f64,
    },
}

/// Directions around `axis`, from `apex`: a ray where the sine is zero.
#[derive(Clone, Copy)]
struct Cone {
    apex: DVec3,
    /// Unit length.
    axis: DVec3,
    sine: f64,
    cosine: f64,
}

impl Occluders {
    /// `None` where the scene has neither ambient occlusion nor shadows.
    pub fn of(prepared: &Prepared<'_>, view: &View) -> Option<Occluders> {
        let scene = prepared.scene;
        let casts = scene.shadows && scene.lights.iter().any(Light::casts_shadows);
        if !casts && scene.occlusion.is_none() {
            return None;
        }
        let world_from_view = view.view_from_world.transpose();
        let mut occluders = vec![];
        for (number, item) in (0u32..).zip(&prepared.items) {
            match item.item.geometry {
                Geometry::Mesh(mesh) => {
                    let opaque = (0..mesh.triangles.len() as u32).filter(|&index| {
                        !prepared.is_translucent(&Hit { depth: 0.0, item: number, index })
                    });
                    occluders.extend(opaque.filter_map(|index| {
                        let corners = item.triangle_view(mesh, index)?;
                        let corners = corners.map(|corner| world_from_view * corner);
                        Some(Occluder::Triangle { corners, source: Some([number, index]) })
                    }));
                }
                Geometry::Lines(lines) => {
                    let segments = lines.segments().filter(|&index| {
                        !prepared.is_translucent(&Hit { depth: 0.0, item: number, index })
                    });
                    let segments =
                        segments.filter_map(|vertex| lines::casting(item, lines, vertex));
                    occluders.extend(segments.flat_map(|segment| segment_occluders(view, segment)));
                }
                Geometry::Points(cloud) => {
                    let samples = (0..cloud.positions.len()).filter(|&i| {
                        let hit = Hit { depth: 0.0, item: number, index: i as u32 };
                        !prepared.is_translucent(&hit)
                    });
                    occluders
                        .extend(samples.filter_map(|i| sample(prepared, view, (item, cloud, i))));
                }
            }
        }
        let balls: Vec<Ball> = occluders.into_iter().filter_map(Ball::around).collect();
        let root = Ball::of_all(balls);
        let extent = root.as_ref().map_or(0.0, |root| root.radius);
        Some(Occluders { root, eye: view.eye, extent })
    }

    /// The share, 0 to 1, of a light that the place of a surface sees.
    pub fn share(&self, prepared: &Prepared<'_>, surface: &Surface, casting: Casting) -> f64 {
        let apex = surface.position_from_eye;
        // The way to the light, the tangent of half the angle that it is seen under, and the distance of its disc.
        let (to_light, tangent, distance) = match casting {
            Casting::Sun { direction, angle_deg } => {
                (-direction, (0.5 * angle_deg.to_radians()).tan(), f64::INFINITY)
            }
            Casting::Lamp { position, radius } => {
                let way = position - self.eye - apex;
                (way, radius / way.length(), way.length())
            }
        };
        let (Some(root), Some(axis)) = (&self.root, to_light.try_normalize()) else {
            return 1.0;
        };
        let nearest = (1e-6 * apex.length() + 1e-9 * self.extent).max(surface.thickness);
        let half = tangent.atan();
        let all = Cone { apex, axis, sine: half.sin(), cosine: half.cos() };
        if !root.any(&all, &mut |_| true) {
            return 1.0;
        }
        let rays = if half > 0.0 { RAYS } else { 1 };
        let (right, up) = axis.any_orthonormal_pair();
        let is_free = |ray: &u32| {
            let out = tangent * ((f64::from(*ray) + 0.5) / f64::from(rays)).sqrt();
            let (sine, cosine) = (f64::from(*ray) * GOLDEN_ANGLE).sin_cos();
            let way = (axis + (right * cosine + up * sine) * out) / 1f64.hypot(out);
            let ray = Cone { apex, axis: way, sine: 0.0, cosine: 1.0 };
            let farthest = distance * 1f64.hypot(out);
            !root.any(&ray, &mut |occluder| {
                self.hides(prepared, occluder, (apex, way), [nearest, farthest])
            })
        };
        (0..rays).filter(is_free).count() as f64 / f64::from(rays)
    }

    /// The share, 0 to 1, of the hemisphere above the place of a surface in which no occluder lies within `radius`, weighted by the cosine of the angle from
    /// the normal (Zhukov, Iones & Kronin 1998, without a falloff). A surface without a normal is taken to face the eye.
    pub fn openness(&self, prepared: &Prepared<'_>, surface: &Surface, radius: f64) -> f64 {
        let facing = || (-surface.way).try_normalize();
        let normal = surface.normal_world.try_normalize().or_else(facing);
        let (Some(root), Some(normal)) = (&self.root, normal) else { return 1.0 };
        let apex = surface.position_from_eye;
        let nearest = (1e-6 * apex.length() + 1e-9 * self.extent).max(surface.thickness);
        let (right, up) = normal.any_orthonormal_pair();
        let is_free = |ray: &u32| {
            // Points of a disc, each of the same area, projected to the hemisphere above it (Malley 1988).
            let out_2 = (f64::from(*ray) + 0.5) / f64::from(RAYS);
            let (sine, cosine) = (f64::from(*ray) * GOLDEN_ANGLE).sin_cos();
            let way = (right * cosine + up * sine) * out_2.sqrt() + normal * (1.0 - out_2).sqrt();
            let ray = Cone { apex, axis: way, sine: 0.0, cosine: 1.0 };
            let hides = &mut |occluder: &Occluder| {
                self.hides(prepared, occluder, (apex, way), [nearest, radius])
            };
            !root.any_within(&ray, radius, hides)
        };
        (0..RAYS).filter(is_free).count() as f64 / f64::from(RAYS)
    }

    /// Whether a ray meets an occluder farther away than `nearest`, and no farther than `farthest`.
    fn hides(
        &self,
        prepared: &Prepared<'_>,
        occluder: &Occluder,
        (origin, way): (DVec3, DVec3),
        [nearest, farthest]: [f64; 2],
    ) -> bool {
        let (at, thickness) = match *occluder {
            Occluder::Triangle { corners, source } => {
                let Some((at, weights)) = meet_triangle(corners, origin, way) else { return false };
                if source.is_some_and(|source| is_cut_out_at(prepared, source, weights)) {
                    return false;
                }
                (at, 0.0)
            }
            Occluder::Tube(ref tube) => {
                let Some(entry) = tube.enter(origin, way) else { return false };
                (entry.at, 0.0)
            }
            Occluder::Disk { centre, axes: [u, v], reach, ref clip, thickness } => {
                let normal = u.cross(v);
                let at = normal.dot(centre - origin) / normal.dot(way);
                let away = origin + way * at - centre;
                let place = glam::DVec2::new(away.cross(v).dot(normal), u.cross(away).dot(normal))
                    / normal.length_squared();
                // Not a number, a place is in no disk.
                if !(place.length() <= reach && clip.keeps(place.as_vec2())) {
                    return false;
                }
                (at, thickness)
            }
            Occluder::Facing { centre, radius, thickness } => {
                let at = way.dot(centre - origin);
                if origin.distance(centre - way * at) > radius {
                    return false;
                }
                (at, thickness)
            }
        };
        let is_shown = || {
            let place = self.eye + (origin + way * at);
            prepared.scene.clip.is_none_or(|clip| clip.shows(place))
        };
        at > nearest.max(thickness) && at <= farthest && is_shown()
    }
}

/// A line's segment; `view`: the one in whose space it is.
fn segment_occluders(view: &View, segment: TrueSegment) -> Vec<Occluder> {
    let world = |place: DVec3| view.view_from_world.transpose() * place;
    match segment {
        TrueSegment::Tube(Tube { ends, radii }) => {
            vec![Occluder::Tube(Tube { ends: ends.map(world), radii })]
        }
        TrueSegment::Ribbon(triangles) => triangles
            .map(|corners| Occluder::Triangle { corners: corners.map(world), source: None })
            .into(),
    }
}

/// A sample as the image shows it; `None` for one without size.
fn sample(
    prepared: &Prepared<'_>,
    view: &View,
    (item, cloud, index): (&PreparedItem<'_>, &PointCloud, usize),
) -> Option<Occluder> {
    let scene = prepared.scene;
    let world_from_view = view.view_from_world.transpose();
    let centre = world_from_view * item.to_view(*cloud.positions.get(index)?)?;
    let splats = scene.pull_push.map(|pull_push| pull_push.splats).or(scene.splats);
    let Some(splats) = splats else {
        let radius = 0.5 * f64::from(scene.discs?.diameter);
        return (radius > 0.0).then_some(Occluder::Facing { centre, radius, thickness: radius });
    };
    let reach = f64::from(splats.cutoff) * f64::from(splats.width);
    // Kernels that face what sees them have the same length whichever way that is.
    let axes = tangents(item, cloud, index, DVec3::Z);
    let radius = reach * axes[0].length().max(axes[1].length());
    let thickness = f64::from(splats.depth_offset) * radius;
    if !(radius > 0.0 && radius.is_finite() && thickness.is_finite()) {
        return None;
    }
    Some(match normal(cloud, index) {
        None => Occluder::Facing { centre, radius, thickness },
        Some(_) => {
            let axes = axes.map(|axis| world_from_view * camera_from_view(axis));
            Occluder::Disk { centre, axes, reach, clip: clip(cloud, index), thickness }
        }
    })
}

/// Where a ray meets a triangle, along the ray and as weights of the corners (Möller & Trumbore 1997). The borders belong to it, and a little more, so
/// that no ray passes between neighbours.
fn meet_triangle([a, b, c]: [DVec3; 3], origin: DVec3, way: DVec3) -> Option<(f64, [f64; 3])> {
    const BORDER: f64 = -1e-12;
    let (along, beside) = (b - a, c - a);
    let across = way.cross(beside);
    let determinant = along.dot(across);
    let from = origin - a;
    let second = from.dot(across) / determinant;
    let turned = from.cross(along);
    let third = way.dot(turned) / determinant;
    let at = beside.dot(turned) / determinant;
    let weights = [1.0 - second - third, second, third];
    // Rays within the plane make infinities or no numbers.
    (weights.iter().all(|&weight| weight >= BORDER) && at.is_finite()).then_some((at, weights))
}

impl Cone {
    /// Whether the cone may meet a ball; never false where it does.
    fn meets(&self, ball: &Ball) -> bool {
        let to = ball.centre - self.apex;
        let along = to.dot(self.axis);
        let beside = (to - self.axis * along).length();
        along >= -ball.radius && beside * self.cosine - along * self.sine <= ball.radius
    }
}

impl Ball {
    /// The ball around an occluder, with some air for rounding; `None` where it is not finite.
    fn around(occluder: Occluder) -> Option<Ball> {
        let (centre, radius) = match &occluder {
            Occluder::Triangle { corners, .. } => {
                let low = corners.iter().copied().reduce(DVec3::min)?;
                let high = corners.iter().copied().reduce(DVec3::max)?;
                let centre = low.midpoint(high);
                let radius = corners.iter().map(|corner| corner.distance(centre));
                (centre, radius.fold(0.0, f64::max))
            }
            Occluder::Tube(Tube { ends: [a, b], radii }) => {
                (a.midpoint(*b), 0.5 * a.distance(*b) + radii[0].max(radii[1]))
            }
            Occluder::Disk { centre, axes: [u, v], reach, .. } => {
                (*centre, reach * u.length().hypot(v.length()))
            }
            Occluder::Facing { centre, radius, .. } => (*centre, *radius),
        };
        let radius = radius * (1.0 + 1e-9) + 1e-12 * centre.length();
        let is_finite = centre.is_finite() && radius.is_finite();
        is_finite.then_some(Ball { centre, radius, inside: Inside::One(occluder) })
    }

    /// Halves balls along the longest axis of their centres, down to single ones.
    fn of_all(mut balls: Vec<Ball>) -> Option<Ball> {
        if balls.len() < 2 {
            return balls.pop();
        }
        let low = balls.iter().map(|ball| ball.centre).reduce(DVec3::min)?;
        let high = balls.iter().map(|ball| ball.centre).reduce(DVec3::max)?;
        let axis = (high - low).max_position();
        let middle = balls.len() / 2;
        balls.select_nth_unstable_by(middle, |a, b| a.centre[axis].total_cmp(&b.centre[axis]));
        let second = balls.split_off(middle);
        let both = [Ball::of_all(balls)?, Ball::of_all(second)?];
        let corner = |sign: f64| both.each_ref().map(|ball| ball.centre + ball.radius * sign);
        let [low, high] = [corner(-1.0), corner(1.0)];
        let centre = low[0].min(low[1]).midpoint(high[0].max(high[1]));
        let radius = both.iter().map(|ball| ball.centre.distance(centre) + ball.radius);
        let radius = radius.fold(0.0, f64::max) * (1.0 + 1e-9);
        Some(Ball { centre, radius, inside: Inside::Two(Box::new(both)) })
    }

    /// Whether any occluder whose ball the cone meets passes the test.
    fn any(&self, cone: &Cone, test: &mut impl FnMut(&Occluder) -> bool) -> bool {
        self.any_within(cone, f64::INFINITY, test)
    }

    /// As [`Ball::any`], for balls no farther from the cone's apex than `reach`.
    fn any_within(
        &self,
        cone: &Cone,
        reach: f64,
        test: &mut impl FnMut(&Occluder) -> bool,
    ) -> bool {
        cone.meets(self)
            && self.centre.distance(cone.apex) - self.radius <= reach
            && match &self.inside {
                Inside::One(occluder) => test(occluder),
                Inside::Two(both) => both.iter().any(|ball| ball.any_within(cone, reach, test)),
            }
    }
}
