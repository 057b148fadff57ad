//! Lines: which pixels' rays meet them, and what they show there.
//!
//! A tube is the union of balls along its segments ([`Tube`]), a ribbon two triangles a segment. Both have their true width here however
//! thin they are: with many sub-pixels a pixel, that is what thin lines look like.

use glam::DVec3;
use rayon::prelude::*;

use crate::assets::{Geometry, Material, Polylines};
use crate::math::{Tube, View};
use crate::scene::recolor::Recolor;

use super::color::linear_from_srgba8;
use super::prepare::{Prepared, PreparedItem};
use super::surface::{LitAs, Surface, overridden, surface as surface_of};
use super::visibility::{Hit, SeenTriangle, band_rows, pixel_ray, pixels_between};

/// Width in pixels from which on a tube has the normals of its surface; a thinner one is lit by its direction.
const ROUND_PX: f64 = 2.0;

/// A segment in view space, or what lies of it before the camera plane.
struct Seen {
    shape: Shape,
    /// Shares of the segment at both ends.
    range: [f64; 2],
}

#[allow(
    clippy::large_enum_variant,
    reason = "the reference is written for clarity, and few lines are seen at a time"
)]
enum Shape {
    Tube(Tube),
    Ribbon([Option<SeenTriangle>; 2]),
}

/// Where a pixel's ray meets a segment.
struct Met {
    depth: f64,
    share: f64,
    /// In view space; zero for ribbons.
    normal: DVec3,
}

impl Seen {
    fn new(
        item: &PreparedItem<'_>,
        lines: &Polylines,
        (view, width_px): (&View, f64),
        vertex: u32,
    ) -> Option<Seen> {
        let Tube { ends: [a, b], radii: own } = axis(item, lines, vertex)?;
        let focal = (view.focal_px.x * view.focal_px.y).sqrt();
        let least = |p: DVec3| 0.5 * width_px * view.divisor((-p.z).max(0.0)) / focal;
        let is_widened = own[0] < least(a) || own[1] < least(b);
        let range = if is_widened { before_eye(view, [a, b]) } else { [0.0, 1.0] };
        let [a, b] = range.map(|share| if share == 1.0 { b } else { a.lerp(b, share) });
        let own = range.map(|share| own[0] + (own[1] - own[0]) * share);
        let radii = [own[0].max(least(a)), own[1].max(least(b))];
        let tube = Tube { ends: [a, b], radii };
        let shape = match ribbon(item, lines, vertex, (&tube, range)) {
            None => Shape::Tube(tube),
            Some(corners) => {
                Shape::Ribbon(corners.map(|corners| SeenTriangle::new(corners, view.projection)))
            }
        };
        Some(Seen { shape, range })
    }

    /// Pixels that hold every covered one.
    fn pixel_box(&self, view: &View) -> Option<[usize; 4]> {
        match &self.shape {
            Shape::Tube(Tube { ends, radii }) => {
                let corners = ends.iter().zip(radii).flat_map(|(&end, &radius)| {
                    (0..8).map(move |i| {
                        let sign = |bit: u32| if i >> bit & 1 == 0 { -radius } else { radius };
                        end + DVec3::new(sign(0), sign(1), sign(2))
                    })
                });
                let corners: Vec<DVec3> = corners.collect();
                if corners.iter().all(|corner| corner.z >= 0.0) {
                    return None;
                }
                let images: Option<Vec<_>> = corners.iter().map(|&c| view.project(c)).collect();
                let Some(images) = images else {
                    return Some([0, view.width as usize, 0, view.height as usize]);
                };
                let low = images.iter().copied().reduce(glam::DVec2::min)?;
                let high = images.iter().copied().reduce(glam::DVec2::max)?;
                Some(pixels_between(view, low, high))
            }
            Shape::Ribbon(triangles) => {
                let boxes = triangles.iter().flatten().filter_map(|t| t.pixel_box(view));
                boxes
                    .reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1]), a[2].min(b[2]), a[3].max(b[3])])
            }
        }
    }

    fn meet(&self, view: &View, ray: DVec3) -> Option<Met> {
        match &self.shape {
            Shape::Tube(tube) => {
                let (origin, way) = (view.at_depth(ray, 0.0), view.towards(ray));
                let entry = tube.enter(origin, way)?;
                let depth = -(origin + way * entry.at).z;
                Some(Met { depth, share: entry.share, normal: entry.normal })
            }
            Shape::Ribbon(triangles) => {
                let covers = |t: &&SeenTriangle| t.covers(ray);
                let which =
                    triangles.iter().position(|t| t.as_ref().is_some_and(|t| covers(&t)))?;
                let triangle = triangles[which].as_ref()?;
                let [_, second, third] = triangle.weights(ray);
                let share = if which == 0 { third } else { second + third };
                Some(Met { depth: triangle.depth(ray), share, normal: DVec3::ZERO })
            }
        }
    }
}

/// A segment of its true radius in view space.
pub enum TrueSegment {
    Tube(Tube),
    Ribbon([[DVec3; 3]; 2]),
}

/// The segment as it stands in the way of light; `None` where its ends cannot be drawn.
pub fn casting(item: &PreparedItem<'_>, lines: &Polylines, vertex: u32) -> Option<TrueSegment> {
    let tube = axis(item, lines, vertex)?;
    let corners = ribbon(item, lines, vertex, (&tube, [0.0, 1.0]));
    Some(corners.map_or(TrueSegment::Tube(tube), TrueSegment::Ribbon))
}

/// A segment's ends in view space, and its true radii there.
fn axis(item: &PreparedItem<'_>, lines: &Polylines, vertex: u32) -> Option<Tube> {
    let ends = [vertex as usize, vertex as usize + 1];
    let [a, b] = ends.map(|v| lines.positions.get(v).and_then(|&p| item.to_view(p)));
    let stretch = item.greatest_stretch();
    let own = |v: usize| lines.radii.as_ref().map_or(0.0, |radii| f64::from(radii[v])) * stretch;
    Some(Tube { ends: [a?, b?], radii: ends.map(own) })
}

/// The two triangles of a ribbon between shares of a segment, whose ends and radii there are those of `tube`; `None` for lines that are tubes.
fn ribbon(
    item: &PreparedItem<'_>,
    lines: &Polylines,
    vertex: u32,
    (tube, range): (&Tube, [f64; 2]),
) -> Option<[[DVec3; 3]; 2]> {
    let normals = lines.normals.as_ref()?;
    let strand = lines.strand_of(vertex);
    let sides = [vertex as usize, vertex as usize + 1].map(|end| {
        let side = lines.side(normals, end, strand.clone());
        item.to_view_direction(side).normalize_or_zero()
    });
    let side = |place: usize| sides[0].lerp(sides[1], range[place]) * tube.radii[place];
    let ([a, b], sa, sb) = (tube.ends, side(0), side(1));
    Some([[a - sa, a + sa, b + sb], [a - sa, b + sb, b - sb]])
}

/// Shares of a segment between which it lies before the camera plane, but for a tiny part; all of it where it does not pass the plane. A radius
/// that grows with depth is linear along that part alone.
fn before_eye(view: &View, ends: [DVec3; 2]) -> [f64; 2] {
    let [a, b] = ends.map(|end| -end.z);
    let nearest = 1e-7 * a.max(b);
    if view.is_orthographic() || (a < nearest) == (b < nearest) {
        return [0.0, 1.0];
    }
    let share = (nearest - a) / (b - a);
    if a < nearest { [share, 1.0] } else { [0.0, share] }
}

/// Adds the hits of a geometry of lines, as `keep` keeps them.
pub fn add<Kept: Send>(
    prepared: &Prepared<'_>,
    view: &View,
    frame: &mut [Kept],
    (number, item, lines): (u32, &PreparedItem<'_>, &Polylines),
    keep: impl Fn(&mut Kept, Hit) + Sync,
) {
    let width_px = prepared.scene.least_line_px;
    let seen = |vertex: u32| {
        let seen = Seen::new(item, lines, (view, width_px), vertex)?;
        let pixels = seen.pixel_box(view)?;
        Some((vertex, seen, pixels))
    };
    let vertices: Vec<u32> =
        lines.segments().filter(|&vertex| !item.is_clear_line(lines, vertex)).collect();
    let segments: Vec<_> = vertices.into_par_iter().filter_map(seen).collect();
    let width = view.width as usize;
    let rows = band_rows(view.height as usize);
    frame.par_chunks_mut((width * rows).max(1)).enumerate().for_each(|(band, pixels)| {
        let (y_begin, y_end) = (band * rows, band * rows + pixels.len() / width);
        for (vertex, seen, [x0, x1, y0, y1]) in &segments {
            for y in (*y0).max(y_begin)..(*y1).min(y_end) {
                for x in *x0..*x1 {
                    let ray = pixel_ray(view, x, y);
                    let Some(met) = seen.meet(view, ray) else { continue };
                    let hit = Hit { depth: met.depth, item: number, index: *vertex };
                    if hit.depth > 0.0 && prepared.shows(view, view.at_depth(ray, hit.depth)) {
                        keep(&mut pixels[(y - y_begin) * width + x], hit);
                    }
                }
            }
        }
    });
}

/// How far the places of segments of a strand may seem apart where they meet, in radii.
const JOINT: f64 = 1.1;

/// Whether a hit lies within the segment that a nearer hit shows, of the same strand or of one that begins or ends on it: a strand hides once
/// between where a ray enters and leaves it.
pub fn is_joint(prepared: &Prepared<'_>, view: &View, before: &Hit, hit: &Hit, ray: DVec3) -> bool {
    let item = &prepared.items[hit.item as usize];
    let Geometry::Lines(lines) = item.item.geometry else { return false };
    if before.item != hit.item {
        return false;
    }
    let width = (view, prepared.scene.least_line_px);
    let segment = |vertex: u32| {
        let Seen { shape: Shape::Tube(tube), range } = Seen::new(item, lines, width, vertex)?
        else {
            return None;
        };
        let strand = lines.strand_of(vertex);
        let begins = strand.start == vertex as usize && range[0] == 0.0;
        let ends = strand.end == vertex as usize + 2 && range[1] == 1.0;
        Some((tube, strand, [begins, ends]))
    };
    let Some((nearer, strand, ends)) = segment(before.index) else { return false };
    if !is_in_tube(&nearer, view.at_depth(ray, hit.depth)) {
        return false;
    }
    let Some((own, own_strand, own_ends)) = segment(hit.index) else { return false };
    strand == own_strand
        || ends_in_tube((&own, own_ends), &nearer)
        || ends_in_tube((&nearer, ends), &own)
}

fn is_in_tube(tube: &Tube, place: DVec3) -> bool {
    let [a, b] = tube.ends;
    let (axis, from_a) = (b - a, place - a);
    let foot = (from_a.dot(axis) / axis.length_squared().max(1e-100)).clamp(0.0, 1.0);
    let radius = tube.radii[0] + (tube.radii[1] - tube.radii[0]) * foot;
    (from_a - axis * foot).length() <= JOINT * radius
}

/// Whether a strand begins or ends with a segment, as the flags say of its ends, and does so within another segment.
fn ends_in_tube((one, is_end): (&Tube, [bool; 2]), other: &Tube) -> bool {
    one.ends.iter().zip(is_end).any(|(&end, is_end)| is_end && is_in_tube(other, end))
}

/// The point of a segment that a pixel shows.
pub fn surface(
    prepared: &Prepared<'_>,
    view: &View,
    item: &PreparedItem<'_>,
    lines: &Polylines,
    (hit, x, y): (&Hit, usize, usize),
) -> Surface {
    let world_from_view = view.view_from_world.transpose();
    let ray = pixel_ray(view, x, y);
    let material = overridden(item, &Material::default());
    let position = view.at_depth(ray, hit.depth);
    let seen = Seen::new(item, lines, (view, prepared.scene.least_line_px), hit.index);
    let met = seen.as_ref().and_then(|seen| seen.meet(view, ray));
    let (Some(seen), Some(met)) = (seen, met) else {
        // No hit comes from such a segment.
        return surface_of([0.0; 4], (view, position), DVec3::ZERO, &material);
    };
    let ends = [hit.index as usize, hit.index as usize + 1];
    let mix = |[a, b]: [f64; 2], share: f64| a + (b - a) * share;
    let share = mix(seen.range, met.share);
    let recolor = prepared.scene.recolor.as_ref();
    let shown = recolor.and_then(|recolor| Some((recolor, recolor.field()?)));
    let mut color = [1.0; 4];
    if let Some(colors) = &lines.colors {
        let [a, b] = ends.map(|v| linear_from_srgba8(colors[v]));
        color = std::array::from_fn(|channel| mix([a[channel], b[channel]], share));
    }
    for (channel, factor) in color.iter_mut().zip(material.base_color) {
        *channel *= f64::from(factor);
    }
    if let Some((recolor, name)) = shown {
        let field = lines.fields.list().iter().find(|field| field.name == name);
        let is_class = matches!(recolor, Recolor::Field { has_classes: true, .. });
        let at = ends.map(|vertex| lines.fields.at(vertex));
        let value = field.and_then(|field| field.between(at, share, is_class));
        let [r, g, b] = recolor.field_color(value);
        let [r, g, b, _] = linear_from_srgba8([r, g, b, 255]);
        color = [r, g, b, color[3]];
    }
    match seen.shape {
        Shape::Tube(tube) => {
            let axis = tube.ends[1] - tube.ends[0];
            let at = tube.ends[0] + axis * met.share;
            let focal = (view.focal_px.x * view.focal_px.y).sqrt();
            let width_px = 2.0 * mix(tube.radii, met.share) * focal / view.divisor(-at.z);
            if width_px >= ROUND_PX {
                let normal = world_from_view * met.normal;
                return surface_of(color, (view, position), normal, &material);
            }
            let way = view.towards(position);
            let tangent = axis.normalize_or_zero();
            let across = tangent * way.dot(tangent) - way;
            let surface = surface_of(color, (view, position), world_from_view * across, &material);
            let thickness = 4.0 * mix(tube.radii, met.share);
            Surface { lit_as: LitAs::Line(world_from_view * tangent), thickness, ..surface }
        }
        Shape::Ribbon(_) => {
            let normal = lines.normals.as_ref().map_or(DVec3::ZERO, |normals| {
                let [a, b] = ends.map(|v| normals[v].as_dvec3());
                item.normal_world_from_geometry * a.lerp(b, share)
            });
            let surface = surface_of(color, (view, position), normal, &material);
            Surface { lit_as: LitAs::Sheet, ..surface }
        }
    }
}
