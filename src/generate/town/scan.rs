//! Scans the town: places of instruments, directions of rays, and echoes.
//!
//! Three surveys are merged, as is usual: a vehicle that drives every street (mobile), tripods at junctions, in yards and on
//! squares (terrestrial), and a drone's strips above the roofs (aerial). Within a survey each station sends an equal number of
//! rays, in directions that fill its field evenly (the R₂ sequence, Roberts 2018). Density falls with distance, and places that
//! no station sees stay empty. Stations are independent and seeded by their number, so the result does not depend on the number
//! of threads.

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use super::Town;
use super::ground::{GROUND_SKIN, Plan, Use};
use super::skin::{Surface, class, scaled};
use super::solid::{Hit, Ray};
use crate::assets::fields::{CLASSIFICATION, INTENSITY};
use crate::assets::{Fields, PointCloud, Progress};
use crate::generate::numeric::sin_cos;
use crate::scene::random::SplitMix64;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Survey {
    Mobile,
    Terrestrial,
    Aerial,
}

impl Survey {
    /// Longest distance in metres.
    fn range(self) -> f64 {
        match self {
            Survey::Mobile => 95.0,
            Survey::Terrestrial => 120.0,
            Survey::Aerial => 160.0,
        }
    }

    /// Standard deviation of a measured distance in metres.
    fn noise(self) -> f64 {
        match self {
            Survey::Mobile => 0.008,
            Survey::Terrestrial => 0.003,
            Survey::Aerial => 0.02,
        }
    }

    /// The survey's share of all rays.
    fn share(self) -> f64 {
        match self {
            Survey::Mobile => 0.38,
            Survey::Terrestrial => 0.18,
            Survey::Aerial => 0.44,
        }
    }
}

#[derive(Clone, Copy, Debug)]
struct Station {
    origin: DVec3,
    survey: Survey,
}

/// An echo in the straight town.
struct Echo {
    position: DVec3,
    color: [u8; 4],
    intensity: u16,
    class: u8,
}

/// Scans `town` until there are `points` echoes.
pub fn scan(town: &Town, points: usize, seed: u64, progress: &Progress) -> PointCloud {
    let mut stations = stations(&town.plan, points);
    // Rays from inside a wall would see through it.
    stations.retain(|station| !town.grid.is_inside(station.origin, -0.3));
    let counts = |survey| stations.iter().filter(|s| s.survey == survey).count().max(1) as f64;
    let shares: Vec<f64> = stations.iter().map(|s| s.survey.share() / counts(s.survey)).collect();
    let share_sum: f64 = shares.iter().sum();

    // A few rays per station show how many come back.
    const PROBES: usize = 48;
    let yields: f64 = stations
        .par_iter()
        .zip(&shares)
        .enumerate()
        .map(|(index, (station, share))| {
            let back = echoes(town, station, index, PROBES, seed ^ 0x9b0b).len();
            back as f64 / PROBES as f64 * share / share_sum
        })
        .collect::<Vec<f64>>()
        .iter()
        .sum();
    let mut rays = points as f64 / yields.max(0.01) * 1.03 + 64.0;
    loop {
        let cloud = scan_with(town, &stations, &shares, rays / share_sum, seed, progress);
        if cloud.positions.len() >= points {
            return thinned(cloud, points);
        }
        rays *= 1.1 * points as f64 / (cloud.positions.len().max(1)) as f64;
    }
}

fn scan_with(
    town: &Town,
    stations: &[Station],
    shares: &[f64],
    rays: f64,
    seed: u64,
    progress: &Progress,
) -> PointCloud {
    let mut cloud = PointCloud { colors: Some(Vec::new()), ..PointCloud::default() };
    let (mut intensities, mut classes) = (Vec::new(), Vec::new());
    // Stations of a block run in parallel; blocks are reported and appended in order.
    for (block, chunk) in stations.chunks(64).enumerate() {
        let first = block * 64;
        let found: Vec<Vec<Echo>> = chunk
            .par_iter()
            .enumerate()
            .map(|(i, station)| {
                let count = (rays * shares[first + i]).round() as usize;
                echoes(town, station, first + i, count, seed)
            })
            .collect();
        for echo in found.into_iter().flatten() {
            cloud.positions.push(millimetres(town.bend.apply(echo.position)));
            cloud.colors.get_or_insert_default().push(echo.color);
            intensities.push(echo.intensity);
            classes.push(u16::from(echo.class));
        }
        progress.report((first + chunk.len()) as f32 / stations.len() as f32);
    }
    cloud.fields = Fields::of_numbers(vec![(INTENSITY, intensities), (CLASSIFICATION, classes)]);
    cloud
}

/// Rounds coordinates to whole millimetres, as LAS files store them.
fn millimetres(p: DVec3) -> DVec3 {
    DVec3::from_array(p.to_array().map(|c| (c * 1000.0).round() / 1000.0))
}

/// Thins a cloud to exactly `count` points, evenly chosen, in order.
fn thinned(cloud: PointCloud, count: usize) -> PointCloud {
    let total = cloud.positions.len();
    fn keep<T: Copy>(list: &[T], count: usize, total: usize) -> Vec<T> {
        (0..count).map(|i| list[(i as u128 * total as u128 / count as u128) as usize]).collect()
    }
    PointCloud {
        positions: keep(&cloud.positions, count, total),
        colors: cloud.colors.map(|list| keep(&list, count, total)),
        fields: cloud
            .fields
            .picked((0..count).map(|i| (i as u128 * total as u128 / count as u128) as usize)),
        ..PointCloud::default()
    }
}

/// The places of instruments. With few points there are few stations, so that each has enough rays.
fn stations(plan: &Plan, points: usize) -> Vec<Station> {
    let mut found = Vec::new();
    let spacing = |length: f64, shortest: f64, share: f64| {
        let most = (points as f64 * share / 200.0).max(8.0);
        (length / most).max(shortest)
    };
    let middles = |list: &[(f64, f64)], low: f64, high: f64| -> Vec<f64> {
        let mut edges = vec![low];
        edges.extend(list.iter().flat_map(|interval| [interval.0, interval.1]));
        edges.push(high);
        edges.chunks(2).map(|street| 0.5 * (street[0] + street[1])).collect()
    };
    let xs = middles(&plan.columns, plan.min.x, plan.max.x);
    let ys = middles(&plan.rows, plan.min.y, plan.max.y);
    let extent = plan.max - plan.min;
    let driven = extent.x * ys.len() as f64 + extent.y * xs.len() as f64;
    let step = spacing(driven, 1.2, Survey::Mobile.share());
    let mut drive = |from: DVec2, to: DVec2| {
        let count = ((to - from).length() / step).ceil().max(1.0);
        for i in 0..count as u32 {
            let at = from + (to - from) * ((f64::from(i) + 0.5) / count);
            found.push(Station { origin: at.extend(2.45), survey: Survey::Mobile });
        }
    };
    for &y in &ys {
        drive(DVec2::new(plan.min.x, y + 0.4), DVec2::new(plan.max.x, y + 0.4));
    }
    for &x in &xs {
        drive(DVec2::new(x + 0.4, plan.min.y), DVec2::new(x + 0.4, plan.max.y));
    }
    let tripod = |at: DVec2| Station { origin: at.extend(1.9), survey: Survey::Terrestrial };
    for &y in &ys {
        found.extend(xs.iter().map(|&x| tripod(DVec2::new(x - 2.2, y - 1.7))));
    }
    for block in &plan.blocks {
        let middle = (block.min + block.max) * 0.5;
        let reach = (block.max - block.min) * if block.usage == Use::Terrace { 0.08 } else { 0.27 };
        for (sx, sy) in [(-1.0, -1.0), (1.0, -0.9), (-0.9, 1.0), (1.0, 1.0)] {
            found.push(tripod(middle + reach * DVec2::new(sx, sy)));
        }
    }
    let strips = (extent.y / 24.0).ceil().max(2.0);
    let step = spacing(strips * extent.x, 3.0, Survey::Aerial.share());
    for strip in 0..strips as u32 {
        let y = plan.min.y + extent.y * (f64::from(strip) + 0.5) / strips;
        let count = (extent.x / step).ceil().max(1.0);
        for i in 0..count as u32 {
            let x = plan.min.x + extent.x * (f64::from(i) + 0.5) / count;
            found.push(Station { origin: DVec3::new(x, y, 62.0), survey: Survey::Aerial });
        }
    }
    found
}

fn echoes(town: &Town, station: &Station, index: usize, rays: usize, seed: u64) -> Vec<Echo> {
    let mut random = SplitMix64::stream(seed, 1_000_000 + index as u64);
    let shift = (random.unit(), random.unit());
    (0..rays)
        .filter_map(|i| {
            // R₂: powers of the plastic number's inverse.
            let n = i as f64;
            let u = (shift.0 + n * 0.754_877_666_246_692_8).fract();
            let v = (shift.1 + n * 0.569_840_290_998_053_3).fract();
            let ray = Ray { origin: station.origin, direction: direction(station.survey, u, v) };
            echo(town, station.survey, &ray, &mut random)
        })
        .collect()
}

/// The direction of a ray in a survey's field, for `u` and `v` in 0..1.
fn direction(survey: Survey, u: f64, v: f64) -> DVec3 {
    let d = match survey {
        Survey::Mobile | Survey::Terrestrial => {
            let (s, c) = sin_cos(u * std::f64::consts::TAU);
            // Slopes are dense around the horizon, where distant objects are.
            let w = 1.75 * v - 0.75;
            DVec3::new(c, s, 1.9 * w * w.abs() - 0.02)
        }
        Survey::Aerial => DVec3::new(1.1 * (2.0 * u - 1.0), 1.1 * (2.0 * v - 1.0), -1.0),
    };
    d / d.length()
}

fn echo(town: &Town, survey: Survey, ray: &Ray, random: &mut SplitMix64) -> Option<Echo> {
    let hit = town.nearest(ray, survey.range())?;
    let mut position = ray.at(hit.t);
    let surface = town.surface(&hit, position);
    let incidence = -hit.normal.dot(ray.direction);
    let facing = incidence.abs().max(0.02);
    let strength = surface.reflectance * facing * (1.0 - 0.5 * hit.t / survey.range());
    // Weak echoes are lost.
    if random.unit() > strength * 14.0 {
        return None;
    }
    let mut class = surface.class;
    let mut distance = hit.t + surface.recess / facing.max(0.2) + survey.noise() * random.bell();
    if random.chance(0.000_05) {
        // Echoes over a second surface arrive late, and echoes from dust early.
        distance *= random.range(0.6, 1.06);
        class = class::LOW_NOISE;
    }
    position = if surface.recess > 0.0 || class == class::LOW_NOISE {
        ray.at(distance)
    } else {
        position + ray.direction * (distance - hit.t)
    };
    let intensity = (65_535.0 * (strength * (1.0 + 0.06 * random.bell())).clamp(0.0, 1.0)) as u16;
    let color = town.photograph(&hit, &surface, ray.at(hit.t), random);
    Some(Echo { position, color, intensity, class })
}

impl Town {
    /// The first hit along a ray.
    fn nearest(&self, ray: &Ray, far: f64) -> Option<Hit> {
        let ground = self.plan.hit(ray, far);
        let limit = ground.map_or(far, |hit| hit.t);
        self.grid.nearest(ray, limit).or(ground)
    }

    fn surface(&self, hit: &Hit, p: DVec3) -> Surface {
        if hit.skin == GROUND_SKIN {
            return self.plan.surface(p, hit.normal);
        }
        match self.skins.get(hit.skin.0 as usize) {
            Some(skin) => skin.surface(p),
            None => self.plan.surface(p, hit.normal),
        }
    }

    /// The colour of a photograph at this place, with sun, sky and shadow, as sRGB.
    fn photograph(
        &self,
        hit: &Hit,
        surface: &Surface,
        p: DVec3,
        random: &mut SplitMix64,
    ) -> [u8; 4] {
        let towards_sun = hit.normal.dot(self.sun);
        let lit = towards_sun > 0.0 && {
            let origin = p + hit.normal * 0.03 + self.sun * 0.02;
            !self.grid.is_blocked(&Ray { origin, direction: self.sun }, 90.0)
        };
        let sun = if lit { 1.28 * towards_sun } else { 0.0 };
        let sky = 0.4 + 0.16 * hit.normal.z + 0.1 * (p.z / 6.0).clamp(0.0, 1.0);
        let [r, g, b] = scaled(surface.color, 1.0 + 0.05 * random.bell());
        let light = [1.0 * sun + 0.92 * sky, 0.95 * sun + 0.97 * sky, 0.84 * sun + 1.1 * sky];
        let encode = |c: f64| {
            // Gamma 2 with a soft shoulder towards white.
            let c = c.max(0.0);
            let c = c * (1.0 + c * 0.12) / (1.0 + 0.42 * c);
            (255.0 * (1.12 * c).min(1.0).sqrt() + 0.5) as u8
        };
        [encode(r * light[0]), encode(g * light[1]), encode(b * light[2]), 255]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Scanned points lie on surfaces: no ray passes through walls, not even from inside.
    #[test]
    fn nothing_is_seen_through_walls() {
        let town = Town::new(130.0, 3);
        let mut stations = stations(&town.plan, 40_000);
        let all = stations.len();
        stations.retain(|station| !town.grid.is_inside(station.origin, -0.3));
        assert!(stations.len() * 10 > all * 8, "most stations stand free");
        let mut checked = 0;
        for (index, station) in stations.iter().enumerate() {
            for echo in echoes(&town, station, index, 60, 1) {
                if echo.class != class::LOW_NOISE {
                    checked += 1;
                    assert!(!town.grid.is_inside(echo.position, 1.2), "{}", echo.position);
                }
            }
        }
        assert!(checked > 5_000, "{checked}");
    }
}
