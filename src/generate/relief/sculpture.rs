//! The sculpture as a signed distance function: a serpent coiled around a fluted column with a pine cone on top, on a moulded
//! base. It is two metres high and stands on the origin, y up, facing +z.
//!
//! Solids are joined by smooth minima (polynomial, Quílez) and carved by displacement: flutes, beads, a frieze, cone scales, and
//! the serpent's skin, a lattice of keeled diamonds along its body.

use glam::{DVec2, DVec3};

use crate::generate::numeric::{atan2, cos, fractal, lerp, sin_cos, smoothstep};
use crate::math::Bounds;

/// Height in metres before scaling.
pub const HEIGHT: f64 = 2.0;

/// A sculpture. The seed varies turns, girth and stone.
#[derive(Clone, Debug)]
pub struct Sculpture {
    seed: u64,
    turns: f64,
    girth: f64,
    flutes: f64,
}

/// The material of a place on the surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Matter {
    Stone,
    Bronze,
    Gilt,
}

/// The distance to a part, and the height of its relief (−1..1).
#[derive(Clone, Copy, Debug)]
struct Part {
    distance: f64,
    relief: f64,
}

const COIL_LOW: f64 = 0.44;
const COIL_HIGH: f64 = 1.22;
const HEAD_SCALE: f64 = 1.25;

impl Sculpture {
    pub fn new(seed: u64) -> Sculpture {
        let mut random = crate::scene::random::SplitMix64::stream(seed, 7);
        Sculpture {
            seed,
            turns: random.range(2.7, 3.1),
            girth: random.range(0.058, 0.066),
            flutes: 16.0 + 2.0 * random.index(3) as f64,
        }
    }

    /// The bounding box.
    pub fn bounds(&self) -> Bounds {
        Bounds { min: DVec3::new(-0.42, -0.01, -0.42), max: DVec3::new(0.42, 2.06, 0.66) }
    }

    /// Signed distance in metres, negative inside.
    pub fn distance(&self, p: DVec3) -> f64 {
        let stone = smooth_min(self.base(p), self.column(p), 0.012);
        let stone = smooth_min(stone, self.cone(p).distance, 0.012);
        smooth_min(stone, self.serpent(p).distance, 0.008)
    }

    /// The material of the surface at `p`, and the height of its relief there.
    pub fn matter(&self, p: DVec3) -> (Matter, f64) {
        let (cone, serpent) = (self.cone(p), self.serpent(p));
        let stone = self.base(p).min(self.column(p));
        if serpent.distance < stone && serpent.distance < cone.distance {
            (Matter::Bronze, serpent.relief)
        } else if cone.distance < stone {
            (Matter::Gilt, cone.relief)
        } else {
            (Matter::Stone, 0.0)
        }
    }

    fn base(&self, p: DVec3) -> f64 {
        if p.y > 0.6 {
            return p.y - 0.41;
        }
        let low = rounded_box(p - DVec3::Y * 0.07, DVec3::new(0.36, 0.07, 0.36), 0.012);
        let panel = rounded_box(
            DVec3::new(p.x.abs().max(p.z.abs()) - 0.366, p.y - 0.07, p.x.abs().min(p.z.abs())),
            DVec3::new(0.018, 0.036, 0.28),
            0.006,
        );
        let low = smooth_max(low, -panel, 0.006).min(self.frieze(p));
        let step = rounded_box(p - DVec3::Y * 0.17, DVec3::new(0.31, 0.03, 0.31), 0.01);
        let rho = (p.x * p.x + p.z * p.z).sqrt();
        let torus_low = (DVec2::new(rho - 0.225, p.y - 0.245)).length() - 0.05;
        let core = (rho - 0.225).max((p.y - 0.25).abs() - 0.045);
        let scotia = {
            // A hollow between two rings.
            let hollow = 0.055 - DVec2::new(rho - 0.25, p.y - 0.325).length();
            smooth_max((rho - 0.225).max((p.y - 0.325).abs() - 0.045), hollow, 0.006)
        };
        let ring = DVec2::new(rho - 0.19, p.y - 0.375).length() - 0.024;
        let round = smooth_min(torus_low.min(core), scotia, 0.006).min(ring);
        smooth_min(low.min(step), round, 0.008)
    }

    /// A row of half-round studs in the plinth's panels.
    fn frieze(&self, p: DVec3) -> f64 {
        let (along, out) = if p.x.abs() > p.z.abs() { (p.z, p.x.abs()) } else { (p.x, p.z.abs()) };
        let pitch = 0.07;
        let i = (along / pitch).round().clamp(-3.0, 3.0);
        let q = DVec3::new(along - i * pitch, p.y - 0.07, out - 0.345);
        let petal = |x: f64, y: f64| DVec3::new((q.x - x) / 0.9, q.y - y, q.z).length() - 0.013;
        let flower = petal(0.015, 0.0).min(petal(-0.015, 0.0));
        let flower = flower.min(petal(0.0, 0.015)).min(petal(0.0, -0.015));
        smooth_min(flower, q.length() - 0.011, 0.004) * 0.9
    }

    fn column(&self, p: DVec3) -> f64 {
        if p.y < 0.2 || p.y > 1.75 {
            return (0.33 - p.y).max(p.y - 1.58);
        }
        let rho = (p.x * p.x + p.z * p.z).sqrt();
        let angle = atan2(p.x, p.z);
        let t = ((p.y - 0.38) / 1.0).clamp(0.0, 1.0);
        let radius = lerp(0.172, 0.145, t * t * 0.6 + t * 0.4);
        let ends = smoothstep(0.39, 0.45, p.y) * (1.0 - smoothstep(1.33, 1.38, p.y));
        let wave = 0.5 + 0.5 * cos(self.flutes * angle);
        let flute = 0.017 * ends * (1.0 - wave * wave);
        let shaft = ((rho - radius + flute) * 0.85).max((p.y - 0.87).abs() - 0.53);
        let neck = DVec2::new(rho - 0.15, p.y - 1.385).length() - 0.016;
        let flare = {
            let t = ((p.y - 1.39) / 0.09).clamp(0.0, 1.0);
            ((rho - lerp(0.15, 0.215, t * t)) * 0.8).max((p.y - 1.435).abs() - 0.045)
        };
        // Beads under the slab.
        let count = 24.0;
        let sector = std::f64::consts::TAU / count;
        let (s, c) = sin_cos(angle - (angle / sector).round() * sector);
        let bead = DVec3::new((rho * s) / 0.8, p.y - 1.447, rho * c - 0.2).length() - 0.021;
        let slab = rounded_box(p - DVec3::Y * 1.505, DVec3::new(0.25, 0.027, 0.25), 0.01);
        let foot = DVec2::new(rho - 0.1, p.y - 1.545).length() - 0.028;
        let foot = foot.min((rho - 0.1).max((p.y - 1.545).abs() - 0.028));
        let capital = smooth_min(flare, bead * 0.8, 0.004).min(slab).min(foot);
        smooth_min(shaft.min(neck), capital, 0.006)
    }

    /// The pine cone on top.
    fn cone(&self, p: DVec3) -> Part {
        if p.y < 1.4 {
            return Part { distance: 1.53 - p.y, relief: 0.0 };
        }
        let q = p - DVec3::Y * 1.775;
        let radii =
            if q.y > 0.0 { DVec3::new(0.165, 0.245, 0.165) } else { DVec3::new(0.165, 0.2, 0.165) };
        let k = (q / radii).length();
        let egg = (k - 1.0) * 0.165;
        if egg > 0.12 {
            return Part { distance: egg - 0.03, relief: 0.0 };
        }
        let angle = atan2(q.x, q.z);
        // Rows by slope, so that scales stay square towards the tip.
        let (row_at, around) = (((q.y / 0.245).clamp(-0.95, 0.95) + 1.0) * 6.5, 13.0);
        let (mut relief, row) = (0.0f64, row_at.floor());
        for neighbour in [row - 1.0, row, row + 1.0] {
            let shift = 0.5 * neighbour.rem_euclid(2.0);
            let u = angle / std::f64::consts::TAU * around + shift;
            let (du, dv) = (u - u.round(), row_at - neighbour - 0.5);
            // A scale rises towards its tip, which points up.
            let shape = 1.0 - (du.abs() * 1.9 + (dv * 0.75).abs());
            relief = relief.max(shape * (0.75 + 0.5 * dv));
        }
        let fade = 1.0 - smoothstep(0.15, 0.225, q.y.abs());
        let relief = relief.clamp(0.0, 1.0).sqrt() * fade;
        let tip = (q - DVec3::Y * 0.24).length() - 0.03;
        let carved = (egg - 0.028 * relief) * 0.75;
        Part { distance: smooth_min(carved, tip, 0.02), relief: relief * 2.0 - 1.0 }
    }

    fn body_radius(&self, t: f64) -> f64 {
        // Negative at the very tip, so that the tail ends in a point.
        let swell = smoothstep(-0.05, 0.36, t) * (1.0 - 0.32 * smoothstep(0.72, 1.0, t));
        self.girth * swell - 0.006 * (1.0 - smoothstep(0.0, 0.06, t))
    }

    /// The body coils up the column, then leaves it for the neck and the head.
    fn serpent(&self, p: DVec3) -> Part {
        let rho = (p.x * p.x + p.z * p.z).sqrt();
        if rho > 0.78 || !(0.2..=1.7).contains(&p.y) {
            let away = (rho - 0.66).max((p.y - 0.95).abs() - 0.7).max(0.05);
            return Part { distance: away, relief: 0.0 };
        }
        let tau = std::f64::consts::TAU;
        let pitch = (COIL_HIGH - COIL_LOW) / self.turns;
        // The coil ends in front, at angle 0.
        let angle = atan2(p.x, p.z);
        let phase = angle / tau + self.turns;
        let lowest = (-phase).ceil();
        let highest = (self.turns - phase).floor();
        let nearest = ((p.y - COIL_LOW) / pitch - phase).round().clamp(lowest, highest);
        let along = (nearest + phase).clamp(0.0, self.turns);
        let t = along / self.turns;
        let r = self.body_radius(t);
        let ring = 0.168 + 0.72 * r;
        let climb = p.y - (COIL_LOW + along * pitch);
        // The cross-section is foreshortened by the slope of the climb.
        let slant = (tau * ring) / ((tau * ring) * (tau * ring) + pitch * pitch).sqrt();
        let section = DVec2::new(rho - ring, climb * slant);
        let around = atan2(section.y, section.x);
        let length = along * tau * 0.21;
        let fade = smoothstep(0.02, 0.15, t);
        let relief = skin(length / 0.052, around / tau * 12.0);
        let coil = section.length() - r - 0.0075 * fade * relief;
        let head = self.head(p, pitch);
        let distance = smooth_min(coil * 0.8, head.distance, 0.02);
        let relief = if head.distance < coil * 0.8 { head.relief } else { relief * 2.0 - 1.0 };
        Part { distance, relief }
    }

    /// The neck and the head, in front of the column.
    fn head(&self, p: DVec3, pitch: f64) -> Part {
        let r = self.body_radius(1.0);
        let start = DVec3::new(0.0, COIL_HIGH, 0.168 + 0.72 * r);
        let middle = DVec3::new(0.13, COIL_HIGH + 0.55 * pitch, start.z + 0.03);
        let end = DVec3::new(0.05, COIL_HIGH + 0.42 * pitch, start.z + 0.17);
        let mut neck = f64::INFINITY;
        let mut place = 0.0;
        let mut last = start;
        const PIECES: u32 = 10;
        for i in 1..=PIECES {
            let t = f64::from(i) / f64::from(PIECES);
            let a = start + (middle - start) * t;
            let b = middle + (end - middle) * t;
            let here = a + (b - a) * t;
            let (axis, offset) = (here - last, p - last);
            let along = (offset.dot(axis) / axis.length_squared()).clamp(0.0, 1.0);
            let d = (offset - axis * along).length() - r * (1.0 - 0.12 * t);
            if d < neck {
                neck = d;
                place = t;
            }
            last = here;
        }
        let stripes = 0.5 + 0.5 * cos(place * 60.0);
        // The head looks outwards and a little down.
        let q = p - end - DVec3::new(-0.01, -0.008, 0.05);
        let q = DVec3::new(q.x, q.y + 0.25 * q.z, q.z) / HEAD_SCALE;
        let skull = ((q / DVec3::new(0.062, 0.042, 0.085)).length() - 1.0) * 0.042;
        let snout = (((q - DVec3::new(0.0, -0.004, 0.062)) / DVec3::new(0.038, 0.024, 0.055))
            .length()
            - 1.0)
            * 0.024;
        let mut head = smooth_min(skull, snout, 0.02);
        let mouth = DVec2::new(q.y + 0.014, (q.z - 0.1).min(0.0) * 0.15).length() - 0.0035;
        head = smooth_max(head, -mouth.max(0.02 - q.z), 0.004);
        let side = DVec3::new(q.x.abs(), q.y, q.z);
        let brow = (side - DVec3::new(0.036, 0.027, 0.032)).length() - 0.016;
        let eye = (side - DVec3::new(0.047, 0.017, 0.04)).length() - 0.0115;
        let nostril = (side - DVec3::new(0.015, 0.008, 0.113)).length() - 0.006;
        head = smooth_min(head, brow, 0.012).min(eye);
        head = smooth_max(head, -nostril, 0.003);
        let head = head * HEAD_SCALE;
        let joined = smooth_min(neck - 0.002 * stripes, head, 0.025);
        Part { distance: joined * 0.8, relief: if head < neck { 0.3 } else { stripes - 0.5 } }
    }

    /// The sRGB colour of the surface at `p` with outward normal `n`.
    pub fn color(&self, p: DVec3, n: DVec3) -> [u8; 4] {
        let mut open = 1.0;
        for (reach, weight) in [(0.012, 0.45), (0.04, 0.4), (0.12, 0.3)] {
            let seen = (self.distance(p + n * reach) / reach).clamp(0.0, 1.0);
            open *= 1.0 - weight * (1.0 - seen);
        }
        let grain = fractal(p * 14.0, 4, self.seed);
        let stain = fractal(DVec3::new(p.x * 6.0, p.y * 1.5, p.z * 6.0), 3, self.seed ^ 5);
        let (matter, relief) = self.matter(p);
        let tint = match matter {
            Matter::Stone => {
                let tone = 0.93 + 0.12 * grain + 0.1 * stain;
                [0.86 * tone, 0.81 * tone, 0.72 * tone]
            }
            Matter::Bronze => {
                let worn = smoothstep(0.0, 1.3, relief + 0.8 * stain + 0.5 * grain);
                let at = |green: f64, bronze: f64| lerp(green, bronze, worn);
                [at(0.27, 0.62), at(0.52, 0.46), at(0.45, 0.25)]
            }
            Matter::Gilt => {
                let worn = 0.85 + 0.1 * relief + 0.2 * grain;
                [0.88 * worn, 0.69 * worn, 0.33 * worn]
            }
        };
        let shade = 0.35 + 0.65 * open;
        let byte = |c: f64| (255.0 * (c * shade).clamp(0.0, 1.0)).round() as u8;
        [byte(tint[0]), byte(tint[1]), byte(tint[2]), 255]
    }
}

/// The height of a skin of keeled diamonds in alternating rows, 0..1. `u` counts rows, and `v` scales around the body.
fn skin(u: f64, v: f64) -> f64 {
    let mut best = 0.0f64;
    let row = u.floor();
    for neighbour in [row - 1.0, row, row + 1.0] {
        let x = v + 0.5 * neighbour.rem_euclid(2.0);
        let (dx, dy) = (x - x.round(), u - neighbour - 0.5);
        best = best.max(1.0 - dx.abs() * 2.0 - (0.62 * dy).abs());
    }
    best.clamp(0.0, 1.0).sqrt()
}

fn rounded_box(p: DVec3, half: DVec3, radius: f64) -> f64 {
    let q = p.abs() - half + radius;
    q.max(DVec3::ZERO).length() + q.max_element().min(0.0) - radius
}

/// The minimum, with the crease filled over a width of about `k`.
fn smooth_min(a: f64, b: f64, k: f64) -> f64 {
    let h = (k - (a - b).abs()).max(0.0) / k;
    a.min(b) - 0.25 * k * h * h
}

fn smooth_max(a: f64, b: f64, k: f64) -> f64 {
    -smooth_min(-a, -b, k)
}
