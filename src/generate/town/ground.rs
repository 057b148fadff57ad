//! The town's plan at ground level: blocks, streets, kerbs, and their paving.
//!
//! The town is laid out straight: streets run along both axes between rectangular blocks, which kerbs raise. It is bent, tilted
//! and turned only when points are written ([`Bend`]).

use glam::{DVec2, DVec3};

use super::super::numeric::{cos, fractal, hash_unit, noise, sin, sin_cos};
use super::skin::SkinId;
use super::skin::{Rgb, Surface, class, rgb, scaled};
use super::solid::{Hit, Ray};
use crate::scene::random::SplitMix64;

/// Height of the pavement above the street.
pub const KERB_M: f64 = 0.13;
/// Width of a street between kerbs.
pub const STREET_M: f64 = 8.4;
/// Width of the pavement along a block's edge.
pub const PAVEMENT_M: f64 = 2.6;
const CORNER_RADIUS_M: f64 = 3.0;

/// The skin of hits on the ground.
pub const GROUND_SKIN: SkinId = SkinId(u32::MAX);

/// The use of a block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Use {
    /// Terraced houses around a yard.
    Terrace,
    /// Detached houses in gardens.
    Villas,
    /// A paved square with a church.
    Square,
    Park,
}

#[derive(Clone, Debug)]
pub struct Block {
    pub min: DVec2,
    pub max: DVec2,
    pub usage: Use,
}

/// The town's blocks.
#[derive(Clone, Debug)]
pub struct Plan {
    pub blocks: Vec<Block>,
    /// Intervals of the blocks along x and y, in order.
    pub columns: Vec<(f64, f64)>,
    pub rows: Vec<(f64, f64)>,
    /// Outer edge of the outermost streets.
    pub min: DVec2,
    pub max: DVec2,
}

impl Plan {
    /// A plan of about `size_m` metres square.
    pub fn new(size_m: f64, seed: u64) -> Plan {
        let mut random = SplitMix64::stream(seed, 1);
        let count = (size_m / 62.0).round().max(1.0) as usize;
        let mut cuts = |offset: f64| -> Vec<(f64, f64)> {
            let weights: Vec<f64> = (0..count).map(|_| random.range(0.8, 1.25)).collect();
            let sum: f64 = weights.iter().sum();
            let room = size_m - STREET_M * (count as f64 + 1.0);
            let mut at = offset + STREET_M;
            weights
                .iter()
                .map(|w| {
                    let low = at;
                    at += w / sum * room;
                    let interval = (low, at);
                    at += STREET_M;
                    interval
                })
                .collect()
        };
        let (columns, rows) = (cuts(0.0), cuts(0.0));
        let middle = (count / 2, count / 2);
        let mut blocks = Vec::new();
        for (j, &(y0, y1)) in rows.iter().enumerate() {
            for (i, &(x0, x1)) in columns.iter().enumerate() {
                let usage = if (i, j) == middle {
                    Use::Square
                } else {
                    match random.unit() {
                        u if u < 0.66 => Use::Terrace,
                        u if u < 0.88 => Use::Villas,
                        _ if count > 2 => Use::Park,
                        _ => Use::Terrace,
                    }
                };
                blocks.push(Block { min: DVec2::new(x0, y0), max: DVec2::new(x1, y1), usage });
            }
        }
        Plan { blocks, columns, rows, min: DVec2::ZERO, max: DVec2::splat(size_m) }
    }

    /// The block on whose raised ground `p` lies. Corners are rounded.
    pub fn block_at(&self, p: DVec2) -> Option<&Block> {
        let find = |list: &[(f64, f64)], x: f64| {
            let index = list.partition_point(|interval| interval.1 < x);
            list.get(index).filter(|interval| interval.0 <= x).map(|_| index)
        };
        let (i, j) = (find(&self.columns, p.x)?, find(&self.rows, p.y)?);
        let block = &self.blocks[j * self.columns.len() + i];
        let inset = (p - block.min).min(block.max - p);
        let corner = (DVec2::splat(CORNER_RADIUS_M) - inset).max(DVec2::ZERO);
        (corner.length_squared() <= CORNER_RADIUS_M * CORNER_RADIUS_M
            || corner.min_element() == 0.0)
            .then_some(block)
    }

    fn is_raised(&self, p: DVec3) -> bool {
        self.block_at(DVec2::new(p.x, p.y)).is_some()
    }

    /// The hit of a ray from above with the ground, including kerbs.
    pub fn hit(&self, ray: &Ray, far: f64) -> Option<Hit> {
        if ray.direction.z >= -1e-6 {
            return None;
        }
        let upper = (KERB_M - ray.origin.z) / ray.direction.z;
        let lower = -ray.origin.z / ray.direction.z;
        if upper > far {
            return None;
        }
        let hit = |t: f64, normal: DVec3| Some(Hit { t, normal, skin: GROUND_SKIN });
        let inside = |p: DVec3| {
            p.x >= self.min.x && p.y >= self.min.y && p.x <= self.max.x && p.y <= self.max.y
        };
        let above = ray.at(upper);
        if upper > 0.0 && self.is_raised(above) {
            return hit(upper, DVec3::Z);
        }
        let below = ray.at(lower);
        if !self.is_raised(below) {
            return if inside(below) && lower < far { hit(lower, DVec3::Z) } else { None };
        }
        // The ray passes below the kerb's edge. Bisect for the hit with the kerb.
        let (mut outside, mut within) = (upper.max(0.0), lower);
        for _ in 0..12 {
            let middle = 0.5 * (outside + within);
            if self.is_raised(ray.at(middle)) { within = middle } else { outside = middle }
        }
        let d = ray.direction;
        let horizontal = DVec2::new(d.x, d.y);
        let axis =
            if d.x.abs() > d.y.abs() { DVec3::X * -d.x.signum() } else { DVec3::Y * -d.y.signum() };
        if horizontal.length() < 1e-9 { hit(lower, DVec3::Z) } else { hit(within, axis) }
    }

    /// The surface of the ground at a place.
    pub fn surface(&self, p: DVec3, normal: DVec3) -> Surface {
        let q = DVec2::new(p.x, p.y);
        if normal.z < 0.5 {
            return paved(scaled(rgb(0xa9a59c), 1.0 + 0.3 * noise(p * 3.0, 2)), 0.5, class::GROUND);
        }
        match self.block_at(q) {
            None => self.street(q),
            Some(block) => raised(block, q),
        }
    }

    fn street(&self, q: DVec2) -> Surface {
        let p = DVec3::new(q.x, q.y, 0.0);
        let patch = fractal(p * 0.15, 3, 21);
        let grain = hash_unit((q.x * 25.0) as i64, (q.y * 25.0) as i64, 0, 1);
        let mut tone = 0.8 + 0.25 * patch + 0.3 * grain;
        let edge = self.distance_to_blocks(q);
        // Worn wheel tracks are lighter, the gutter is darker.
        let from_middle = (0.5 * STREET_M - edge).abs();
        tone += 0.12 * (1.0 - ((from_middle - 1.5) / 0.5).abs()).max(0.0);
        if edge < 0.3 {
            return paved(scaled(rgb(0x6f6b64), 0.8 + 0.4 * grain), 0.35, class::ROAD);
        }
        if self.is_marking(q, from_middle) {
            return paved(scaled(rgb(0xe8e6e0), 0.75 + 0.3 * grain), 0.85, class::ROAD);
        }
        let lid = (q / 17.0).floor();
        let centre = (lid + 0.5) * 17.0;
        if (q - centre).length() < 0.34 {
            return paved(rgb(0x3b3632), 0.3, class::ROAD);
        }
        paved(scaled(rgb(0x5a5a5c), tone), 0.2, class::ROAD)
    }

    /// Distance from a place in a street to the nearest kerb.
    fn distance_to_blocks(&self, q: DVec2) -> f64 {
        let mut nearest = f64::INFINITY;
        for block in &self.blocks {
            let out = (block.min - q).max(q - block.max).max(DVec2::ZERO);
            nearest = nearest.min(out.length());
        }
        nearest
    }

    /// Whether a place is on a road marking: dashes along the middle of each street, zebra crossings before the junctions.
    fn is_marking(&self, q: DVec2, from_middle: f64) -> bool {
        let inside = |list: &[(f64, f64)], x: f64| {
            list.iter().find(|interval| x >= interval.0 && x <= interval.1).copied()
        };
        let (along, interval, across) = match (inside(&self.columns, q.x), inside(&self.rows, q.y))
        {
            (Some(interval), None) => (q.x, interval, q.y),
            (None, Some(interval)) => (q.y, interval, q.x),
            _ => return false,
        };
        let to_end = (along - interval.0).min(interval.1 - along);
        if (1.2..4.2).contains(&to_end) {
            return (across / 1.0).rem_euclid(1.0) < 0.5;
        }
        to_end > 6.0 && from_middle < 0.07 && (along / 6.0).rem_euclid(1.0) < 0.5
    }
}

fn paved(color: Rgb, reflectance: f64, class: u8) -> Surface {
    Surface { color, reflectance, class, recess: 0.0 }
}

fn raised(block: &Block, q: DVec2) -> Surface {
    let p = DVec3::new(q.x, q.y, 0.0);
    let inset = (q - block.min).min(block.max - q);
    let edge = inset.x.min(inset.y);
    let grain = hash_unit((q.x * 20.0) as i64, (q.y * 20.0) as i64, 5, 1);
    if edge < 0.16 {
        return paved(scaled(rgb(0xb4b0a6), 0.85 + 0.2 * grain), 0.5, class::GROUND);
    }
    if edge < PAVEMENT_M {
        return slabs(q, 0.5, rgb(0x96928a), grain);
    }
    let middle = (block.min + block.max) * 0.5;
    match block.usage {
        Use::Square => {
            let from_middle = (q - middle).length();
            let ring = (from_middle / 5.0).fract() < 0.07;
            let tone = if ring { rgb(0xb7aa93) } else { rgb(0x8a8073) };
            slabs(q, 0.14, tone, grain)
        }
        Use::Terrace if edge < PAVEMENT_M + 10.5 => slabs(q, 0.3, rgb(0x857f76), grain),
        Use::Park | Use::Villas | Use::Terrace => {
            let d = (q - middle).abs();
            let path = block.usage == Use::Park
                && (d.x.min(d.y) < 1.3 || ((q - middle).length() - 9.0).abs() < 1.2);
            if path {
                return paved(scaled(rgb(0xb9a888), 0.8 + 0.35 * grain), 0.45, class::GROUND);
            }
            let tuft = fractal(p * 0.5, 4, 31);
            let [r, g, b] = scaled(rgb(0x65803c), 0.8 + 0.5 * tuft + 0.35 * grain);
            let dry = (fractal(p * 0.12, 3, 33) * 1.5).clamp(0.0, 0.5);
            paved([r * (1.0 + dry), g * (1.0 + 0.2 * dry), b], 0.5, class::LOW_VEGETATION)
        }
    }
}

/// Paving with joints. Each slab has its own tone.
fn slabs(q: DVec2, size: f64, color: Rgb, grain: f64) -> Surface {
    let row = (q.y / size).floor();
    let x = q.x / size + 0.5 * (row.rem_euclid(2.0));
    let (fx, fy) = (x - x.floor(), q.y / size - row);
    let stone = hash_unit(x.floor() as i64, row as i64, 1, 4);
    let joint = fx < 0.06 || fy < 0.06;
    let tone = if joint { 0.6 } else { 0.85 + 0.25 * stone + 0.1 * grain };
    paved(scaled(color, tone), 0.42, class::GROUND)
}

/// Maps the straight, level town to the world: streets wind, the ground undulates and slopes to one side, and north is not along
/// a street. The waves are so long that a house bends by only a centimetre or two.
#[derive(Clone, Copy, Debug)]
pub struct Bend {
    origin: DVec3,
    middle: DVec2,
    /// Sine and cosine of the rotation.
    turn: (f64, f64),
    phase: f64,
}

impl Bend {
    pub fn new(plan: &Plan, origin: DVec3, seed: u64) -> Bend {
        let mut random = SplitMix64::stream(seed, 2);
        Bend {
            origin,
            middle: (plan.min + plan.max) * 0.5,
            turn: sin_cos(random.range(0.15, 0.4)),
            phase: random.range(0.0, 6.0),
        }
    }

    /// Maps a point of the straight town to the world.
    pub fn apply(&self, p: DVec3) -> DVec3 {
        let q = DVec2::new(p.x, p.y) - self.middle;
        let bent = q + DVec2::new(
            5.0 * sin(q.y / 52.0 + self.phase),
            4.0 * sin(q.x / 60.0 + 0.7 * self.phase),
        );
        let (s, c) = self.turn;
        let rise = 0.018 * q.x - 0.011 * q.y + 0.9 * sin(q.x / 45.0) * cos(q.y / 55.0 + self.phase);
        self.origin + DVec3::new(c * bent.x - s * bent.y, s * bent.x + c * bent.y, p.z + rise)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rays_find_street_pavement_and_kerb() {
        let plan = Plan::new(180.0, 1);
        let block = &plan.blocks[0];
        let y = 0.5 * (block.min.y + block.max.y);
        let down = |x: f64| Ray { origin: DVec3::new(x, y, 3.0), direction: DVec3::NEG_Z };
        assert!((plan.hit(&down(block.min.x - 1.0), 9.0).unwrap().t - 3.0).abs() < 1e-9);
        assert!((plan.hit(&down(block.min.x + 1.0), 9.0).unwrap().t - 3.0 + KERB_M).abs() < 1e-9);
        assert!(plan.hit(&down(-1.0), 9.0).is_none());
        let origin = DVec3::new(block.min.x - 4.0, y, 2.0);
        let target = DVec3::new(block.min.x, y, 0.5 * KERB_M);
        let ray = Ray { origin, direction: (target - origin).normalize_or_zero() };
        let hit = plan.hit(&ray, 50.0).unwrap();
        assert_eq!(hit.normal, DVec3::NEG_X);
        assert!((ray.at(hit.t) - target).length() < 0.01);
    }

    #[test]
    fn bending_keeps_lengths_to_a_few_percent() {
        let bend = Bend::new(&Plan::new(180.0, 1), DVec3::new(412_000.0, 5_653_000.0, 110.0), 1);
        for i in 0..100 {
            let p = DVec3::new(f64::from(i) * 1.7, f64::from(i * 7 % 100) * 1.7, 5.0);
            let a = bend.apply(p);
            for axis in [DVec3::X, DVec3::Y, DVec3::Z] {
                let length = (bend.apply(p + axis) - a).length();
                assert!((length - 1.0).abs() < 0.12, "{length}");
            }
        }
    }
}
