//! Gaps between samples, filled from coarser levels of the image (Marroquim et al. 2008, §3), with the changes that `shaders/shared/patches`
//! lists.
//!
//! 1. *Level 0.* Each pixel keeps the nearest of the samples that project into it, if it is nearer than the triangle there. The sample becomes a
//!    [`Patch`]: the ellipse that its disk is in the image, its plane, colour and normal. Samples beside the image lie in a rim around it.
//! 2. *Pull.* A pixel of the next level combines the patches of its four pixels that cover its centre and belong to the nearest surface there.
//! 3. *Push.* From the coarsest level down, each pixel combines its patch with those of the four nearest pixels of the coarser level that cover
//!    its centre. Level 0 gives the image. A pixel that stays open beside patches takes the disk of a sample near by that covers it.

use glam::{DMat2, DVec2, DVec3};
use rayon::prelude::*;

use crate::math::View;
use crate::scene::{PullPush, PullPushWeights};

use super::blend::Blended;
use super::patches::{Level, Patch, Pyramid, Steps};
use super::prepare::Prepared;
use super::shade::shade;
use super::surface::{self, Surface};
use super::visibility::{Hit, pixel_ray};

/// Ellipses are widened by this part of a pixel of their level, and by so many pixels at level 0.
const WIDEN: f64 = 0.3;
const WIDEN_PX: f64 = 0.75;
/// Part of the variance of centres that combined ellipses have.
const CENTRES: f64 = 2.3;
/// Least width of a patch's disks, in pixels of the level that it is combined into.
const LEAST_DISK: f64 = 0.4;
/// Squared distances up to which places between patches, and between four patches, count as covered.
const BETWEEN: f64 = 4.0;
const BETWEEN_FOUR: f64 = 16.0;
/// Cosine below which two patches lie on opposite sides.
const OPPOSITE: f64 = -0.3;
/// Exponent of weights at an outline.
const FALL: f64 = 2.5;
/// Weight of a pixel's own sample at level 0.
const OWN: f64 = 0.25;
/// How far from a corner of level 1 an open pixel finds samples, in pixels, and by how many pixels their disks are widened.
const ABOUT: isize = 8;
const ABOUT_WIDEN_PX: f64 = 0.1;
/// Radii of a disk that its plane is followed for.
const FOLLOWED: f64 = 1.5;

/// A patch at a place: squared distance in half axes, 1/z, and 1/z behind the surface by the depth offset.
#[derive(Clone, Copy)]
struct Seen {
    patch: Patch,
    distance: f64,
    inverse: f64,
    behind: f64,
}

/// The pixels of `view` that show samples before the `hits` of triangles.
pub fn pulled(
    prepared: &Prepared<'_>,
    view: &View,
    settings: &PullPush,
    hits: &[Option<Hit>],
) -> Vec<Option<Blended>> {
    let steps = Steps { prepared, view, settings };
    let Pyramid { pulled, pushed } = steps.pyramid(hits, None);
    // There are at least two levels.
    steps.finish(&pulled[0], &pushed[0], hits)
}

impl Steps<'_> {
    /// Makes all levels. Each step starts from the levels that are `given`, or else from those made before.
    pub fn pyramid(&self, hits: &[Option<Hit>], given: Option<&Pyramid>) -> Pyramid {
        let mut pulled = vec![self.samples(hits)];
        while let Some(last) = pulled.last()
            && (pulled.len() == 1 || last.width * last.height > 1)
        {
            let finer = given.map_or(last, |given| &given.pulled[pulled.len() - 1]);
            let next = self.pull(finer, pulled.len());
            pulled.push(next);
        }
        // The coarsest level is complete.
        let mut pushed: Vec<Level> = pulled.last().cloned().into_iter().collect();
        for number in (1..pulled.len() - 1).rev() {
            let (own, coarser) = match given {
                Some(given) => (&given.pulled[number], &given.pushed[number]),
                None => (&pulled[number], &pushed[pushed.len() - 1]),
            };
            let next = self.push(own, coarser, number);
            pushed.push(next);
        }
        pushed.reverse();
        Pyramid { pulled, pushed }
    }

    /// How far behind a patch others still count as the same surface: a share of its distance, or a length where rays are parallel.
    fn offset(&self, patch: &Patch) -> f64 {
        f64::from(self.settings.splats.depth_offset) * patch.radius_px / self.focal_px()
    }

    /// A patch as it is seen from a place in the image.
    fn see(&self, patch: Patch, place_px: DVec2, widen_px: f64) -> Seen {
        let widened = patch.spread + DMat2::from_diagonal(DVec2::splat(widen_px * widen_px));
        let away = place_px - patch.at_px;
        let distance = away.dot(widened.inverse() * away);
        let inverse = 1.0 / self.depth(&patch, place_px);
        let offset = self.offset(&patch);
        let behind = match self.view.is_orthographic() {
            true => inverse / (1.0 + offset * inverse),
            false => inverse / (1.0 + offset),
        };
        Seen { patch, distance, inverse, behind }
    }

    /// Distance along the viewing axis of a patch's plane.
    fn depth(&self, patch: &Patch, place_px: DVec2) -> f64 {
        let along = patch.slope.dot(place_px - patch.at_px);
        let far = FOLLOWED * patch.radius_px / self.focal_px();
        if self.view.is_orthographic() {
            return (patch.value + along.clamp(-far, far)).max(f64::MIN_POSITIVE);
        }
        let nearest = if far < 0.999 { 1.0 / (1.0 - far) } else { 1e6 };
        1.0 / (patch.value * (1.0 + along).clamp(1.0 / (1.0 + far), nearest))
    }

    fn weight(&self, seen: &Seen) -> f64 {
        match self.settings.weights {
            PullPushWeights::Gaussian => (-FALL * seen.distance.min(1.0)).exp(),
            PullPushWeights::Box => 1.0,
        }
    }

    /// One patch of several, about a place.
    fn combine(&self, parts: &[(Patch, f64)]) -> Option<Patch> {
        let sum: f64 = parts.iter().map(|(_, weight)| weight).sum();
        let (most, _) = parts.iter().rev().max_by(|a, b| a.1.total_cmp(&b.1))?;
        let mean = |value: &dyn Fn(&Patch) -> f64| {
            parts.iter().map(|(patch, weight)| value(patch) * weight).sum::<f64>() / sum
        };
        let at_px = DVec2::new(mean(&|patch| patch.at_px.x), mean(&|patch| patch.at_px.y));
        let spread = parts.iter().fold(DMat2::ZERO, |spread, (patch, weight)| {
            let away = patch.at_px - at_px;
            let outer = DMat2::from_cols(away * away.x, away * away.y);
            spread + (patch.spread + outer * CENTRES) * (weight / sum)
        });
        let normal =
            parts.iter().map(|(patch, weight)| patch.normal_world * *weight).sum::<DVec3>();
        let value = |patch: &Patch| match self.view.is_orthographic() {
            true => self.depth(patch, at_px),
            false => 1.0 / self.depth(patch, at_px),
        };
        Some(Patch {
            value: mean(&value),
            at_px,
            spread,
            radius_px: mean(&|patch| patch.radius_px),
            slope: DVec2::new(mean(&|patch| patch.slope.x), mean(&|patch| patch.slope.y)),
            color: std::array::from_fn(|channel| mean(&|patch| patch.color[channel])),
            normal_world: normal.try_normalize().unwrap_or(DVec3::ZERO),
            ..*most
        })
    }

    fn pull(&self, finer: &Level, number: usize) -> Level {
        let size = (1u64 << number) as f64;
        let patch = |x: isize, y: isize| {
            let place = (DVec2::new(x as f64, y as f64) + 0.5) * size;
            let (x, y) = (2 * x, 2 * y);
            let children = [(x, y), (x + 1, y), (x, y + 1), (x + 1, y + 1)];
            let children = children.map(|(x, y)| {
                let patch = finer.at(x, y).filter(|patch| patch.radius_px >= LEAST_DISK * size)?;
                Some(self.see(patch, place, WIDEN * size))
            });
            let is_covered = children.iter().flatten().any(|seen| seen.distance <= 1.0);
            // Where nothing covers the centre, disks beside the image count: the rim is narrower than they may be far away.
            let covers = |seen: &Seen| match is_covered {
                true => seen.distance <= 1.0,
                false => self.is_beside(&seen.patch),
            };
            let (front, side) = front(&children, covers);
            let parts: Vec<(Patch, f64)> = children
                .iter()
                .flatten()
                .filter(|seen| covers(seen) && belongs(seen, front, side))
                .map(|seen| (seen.patch, self.weight(seen)))
                .collect();
            self.combine(&parts).map(|patch| Patch { facing: side, ..patch })
        };
        Level::of((finer.width.div_ceil(2), finer.height.div_ceil(2)), patch)
    }

    /// Whether a patch's centre lies beside the image.
    fn is_beside(&self, patch: &Patch) -> bool {
        let size = DVec2::new(f64::from(self.view.width), f64::from(self.view.height));
        !(patch.at_px.cmpge(DVec2::ZERO).all() && patch.at_px.cmple(size).all())
    }

    fn push(&self, own: &Level, coarser: &Level, number: usize) -> Level {
        let size = (1u64 << number) as f64;
        let patch = |x: isize, y: isize| {
            let place = (DVec2::new(x as f64, y as f64) + 0.5) * size;
            let mine = own.at(x, y);
            let found = self.around(coarser, (x, y), place, WIDEN * size, mine.is_none(), false);
            let seen = mine.map(|patch| self.see(patch, place, WIDEN * size));
            let seen = seen.filter(|seen| is_seen(seen.inverse, seen.patch.facing, &found));
            let (parts, side) = self.parts(&found, seen.as_ref(), 1.0);
            self.combine(&parts).map(|patch| Patch { facing: side, ..patch })
        };
        Level::of((own.width, own.height), patch)
    }

    /// The surface at a place, as the four nearest pixels of the coarser level know it.
    fn around(
        &self,
        coarser: &Level,
        (x, y): (isize, isize),
        place: DVec2,
        widen_px: f64,
        may_close: bool,
        is_last: bool,
    ) -> Around {
        let (left, above) = (corner(x) - 1, corner(y) - 1);
        let share = |is_far: bool| if is_far { 0.75 } else { 0.25 };
        let (right, down) = (share(x % 2 == 0), share(y % 2 == 0));
        let four = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(dx, dy)| {
            let patch = coarser.at(left + dx, above + dy)?;
            Some(self.see(patch, place, widen_px))
        });
        let bilinear = [
            (1.0 - right) * (1.0 - down),
            right * (1.0 - down),
            (1.0 - right) * down,
            right * down,
        ];
        let mut covers = four.map(|seen| seen.is_some_and(|seen| seen.distance <= 1.0));
        if may_close && covers == [false; 4] {
            covers = between(&four, place, widen_px, is_last);
        }
        let covering: [Option<Seen>; 4] = std::array::from_fn(|i| four[i].filter(|_| covers[i]));
        let (front, side) = front(&covering, |_| true);
        let is_near = four.iter().any(Option::is_some);
        Around { covering, bilinear, front, side, is_near }
    }

    /// The patches at a place that belong to its nearest surface, with their weights, and the side that they show.
    fn parts(
        &self,
        around: &Around,
        own: Option<&Seen>,
        own_weight: f64,
    ) -> (Vec<(Patch, f64)>, i8) {
        let (mut front, mut side) = (around.front, around.side);
        let mut parts = Vec::new();
        if let Some(own) = own {
            if own.behind > front {
                (front, side) = (own.behind, own.patch.facing);
            }
            parts.push((own.patch, own_weight));
        }
        for (seen, bilinear) in around.covering.iter().zip(around.bilinear) {
            if let Some(seen) = seen.filter(|seen| belongs(seen, front, side)) {
                parts.push((seen.patch, self.weight(&seen) * bilinear));
            }
        }
        (parts, side)
    }

    /// The image: level 0, completed and lit.
    fn finish(&self, image: &Level, coarser: &Level, hits: &[Option<Hit>]) -> Vec<Option<Blended>> {
        let pixel = |pixel: usize| {
            let (x, y) = (pixel % image.width, pixel / image.width);
            let place = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
            let at = (x as isize, y as isize);
            let sample = image.at(at.0, at.1);
            let own = sample.map(|patch| self.see(patch, place, WIDEN_PX));
            let is_elsewhere = own.is_some_and(|own| own.distance > 1.0);
            let own = own.filter(|_| !is_elsewhere);
            let mut found = self.around(coarser, at, place, WIDEN_PX, own.is_none(), true);
            if own.is_none() && found.front == 0.0 && found.is_near {
                found = self.about(image, at, place).unwrap_or(found);
            }
            // The sample's own depth, not that of its plane.
            let own = own.map(|own| Seen { inverse: 1.0 / own.patch.source.depth, ..own });
            let own_seen = own.filter(|own| is_seen(own.inverse, own.patch.facing, &found));
            let triangle = hits[pixel].filter(|_| sample.is_none());
            let hides = triangle.is_some_and(|hit| 1.0 / hit.depth >= found.front);
            if own_seen.is_none() && (found.front == 0.0 || hides) {
                return None;
            }
            let (parts, _) = self.parts(&found, own_seen.as_ref(), OWN);
            let patch = self.combine(&parts)?;
            let sum: f64 = parts.iter().map(|(_, weight)| weight).sum();
            let inverse = parts.iter().enumerate().map(|(i, (patch, weight))| match own_seen {
                Some(own) if i == 0 => own.inverse * weight,
                _ => weight / self.depth(patch, place),
            });
            let depth = sum / inverse.sum::<f64>();
            let ray = pixel_ray(self.view, x, y);
            if own_seen.is_none() && !self.prepared.shows(self.view, self.view.at_depth(ray, depth))
            {
                return None;
            }
            let source = own_seen.map_or(patch.source, |own| own.patch.source);
            Some(self.lit(&Patch { source, ..patch }, self.view.at_depth(ray, depth), depth))
        };
        (0..hits.len()).into_par_iter().map(pixel).collect()
    }

    /// The disk of a sample near by that covers a pixel: of the nearest surface, the one whose middle the pixel is closest to.
    fn about(&self, image: &Level, (x, y): (isize, isize), place: DVec2) -> Option<Around> {
        let (right, down) = (2 * corner(x), 2 * corner(y));
        let pixels = (-ABOUT..ABOUT).flat_map(|y| (-ABOUT..ABOUT).map(move |x| (x, y)));
        let disks = pixels.filter_map(|(x, y)| image.at(right + x, down + y));
        let covering = disks
            .map(|disk| self.see(disk, place, ABOUT_WIDEN_PX))
            .filter(|disk| disk.distance <= 1.0);
        let cover = covering.reduce(|best, disk| {
            let is_same = disk.inverse >= best.behind && disk.distance < best.distance;
            if disk.behind > best.inverse || is_same { disk } else { best }
        })?;
        Some(Around {
            covering: [Some(cover), None, None, None],
            bilinear: [1.0; 4],
            front: cover.behind,
            side: cover.patch.facing,
            is_near: true,
        })
    }

    fn lit(&self, patch: &Patch, position_view: DVec3, depth: f64) -> Blended {
        let world_from_view = self.view.view_from_world.transpose();
        let mut surface = Surface {
            albedo: patch.color,
            position_from_eye: world_from_view * position_view,
            way: world_from_view * self.view.towards(position_view),
            normal_world: patch.normal_world,
            thickness: self.offset(patch) * self.view.divisor(depth),
            ..surface::at(self.prepared, self.view, &patch.source, 0, 0)
        };
        surface.turn_to_eye();
        let instance = self.prepared.instance(&patch.source);
        surface.recolor(self.prepared.scene.recolor.as_ref(), self.view, instance);
        surface.open = self.prepared.ambient_share(&surface);
        let color = shade(&surface, self.prepared, self.view.eye);
        Blended { color, normal_world: surface.normal_world, depth, instance }
    }
}

/// The patches of a coarser level that cover a place.
struct Around {
    covering: [Option<Seen>; 4],
    bilinear: [f64; 4],
    /// 1/z behind the nearest one, 0 if there is none, and the side that it shows.
    front: f64,
    side: i8,
    /// Whether there are patches, even if none covers the place.
    is_near: bool,
}

/// The corner of the coarser level that a pixel touches, along one axis.
fn corner(x: isize) -> isize {
    (x + 1).div_euclid(2)
}

fn front(four: &[Option<Seen>; 4], covers: impl Fn(&Seen) -> bool) -> (f64, i8) {
    let covering = four.iter().flatten().filter(|seen| covers(seen));
    covering.fold((0.0, 0), |(front, side), seen| match seen.behind > front {
        true => (seen.behind, seen.patch.facing),
        false => (front, side),
    })
}

fn belongs(seen: &Seen, front: f64, side: i8) -> bool {
    seen.inverse >= front && seen.patch.facing * side >= 0
}

fn is_seen(inverse: f64, facing: i8, around: &Around) -> bool {
    inverse >= around.front && facing * around.side >= 0
}

/// Which of four patches have a place between them that none of them covers.
fn between(four: &[Option<Seen>; 4], place: DVec2, widen_px: f64, is_last: bool) -> [bool; 4] {
    let distances = four.map(|seen| seen.map_or(f64::INFINITY, |seen| seen.distance));
    let Some(by) = four.iter().flatten().min_by(|a, b| a.distance.total_cmp(&b.distance)) else {
        return [false; 4];
    };
    // The nearest one's ellipse measures directions.
    let widened = by.patch.spread + DMat2::from_diagonal(DVec2::splat(widen_px * widen_px));
    let x = widened.x_axis.x.sqrt();
    let lean = widened.x_axis.y / x;
    let y = (widened.y_axis.y - lean * lean).max(1e-12).sqrt();
    let direction = |seen: &Seen| {
        let away = seen.patch.at_px - place;
        let across = away.x / x;
        DVec2::new(across, (away.y - lean * across) / y).normalize_or_zero()
    };
    let directions = four.map(|seen| seen.map(|seen| direction(&seen)));
    let near = distances.map(|distance| distance <= BETWEEN);
    let is_opposite = (0..4).any(|i| {
        (0..i).any(|j| match (directions[i], directions[j]) {
            (Some(a), Some(b)) => near[i] && near[j] && a.dot(b) < OPPOSITE,
            _ => false,
        })
    });
    let all_four = is_last && distances.iter().all(|distance| *distance <= BETWEEN_FOUR);
    match (all_four, is_opposite) {
        (true, _) => [true; 4],
        (false, true) => near,
        (false, false) => [false; 4],
    }
}
