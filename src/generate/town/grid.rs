//! A uniform grid over the town, which rays walk column by column.
//!
//! Solids stand on the ground, so the grid has two dimensions. Each column knows its height, and rays that pass above it skip it
//! (stepping by Amanatides and Woo 1987).

use glam::{DVec2, DVec3};

use super::solid::{Hit, Ray, Solid};

/// Edge of a column in metres.
const CELL: f64 = 4.0;

/// Solids sorted into columns.
pub struct Grid {
    solids: Vec<Solid>,
    min: DVec2,
    size: [usize; 2],
    /// Start of each column's run in `items`, with one more entry than there are columns.
    starts: Vec<u32>,
    items: Vec<u32>,
    /// Height of the highest solid in each column.
    tops: Vec<f64>,
    top: f64,
}

impl Grid {
    /// Sorts solids into a grid over `min..max`.
    pub fn new(solids: Vec<Solid>, min: DVec2, max: DVec2) -> Grid {
        let extent = (max - min).max(DVec2::splat(CELL));
        let size = [(extent.x / CELL).ceil() as usize, (extent.y / CELL).ceil() as usize];
        let mut columns: Vec<Vec<u32>> = vec![Vec::new(); size[0] * size[1]];
        let mut tops = vec![f64::NEG_INFINITY; columns.len()];
        let mut top = f64::NEG_INFINITY;
        for (index, solid) in solids.iter().enumerate() {
            let span = |axis: usize| {
                let cell = |x: f64| {
                    (((x - min[axis]) / CELL).floor().max(0.0) as usize).min(size[axis] - 1)
                };
                cell(solid.bounds.min[axis])..=cell(solid.bounds.max[axis])
            };
            top = top.max(solid.bounds.max.z);
            for y in span(1) {
                for x in span(0) {
                    let column = y * size[0] + x;
                    columns[column].push(index as u32);
                    tops[column] = tops[column].max(solid.bounds.max.z);
                }
            }
        }
        let mut starts = vec![0];
        let mut items = Vec::new();
        for column in &columns {
            items.extend_from_slice(column);
            starts.push(items.len() as u32);
        }
        Grid { solids, min, size, starts, items, tops, top }
    }

    /// The nearest hit nearer than `far`.
    pub fn nearest(&self, ray: &Ray, far: f64) -> Option<Hit> {
        let mut best: Option<Hit> = None;
        self.walk(ray, far, |column, leave| {
            for &index in column {
                let limit = best.map_or(far, |hit| hit.t);
                let solid = &self.solids[index as usize];
                if let Some(hit) = solid.hit(ray, 1e-3, limit) {
                    best = Some(hit);
                }
            }
            best.is_some_and(|hit| hit.t <= leave)
        });
        best
    }

    /// Whether anything is hit within `far`.
    pub fn is_blocked(&self, ray: &Ray, far: f64) -> bool {
        let mut blocked = false;
        self.walk(ray, far, |column, _| {
            blocked = column
                .iter()
                .any(|&index| self.solids[index as usize].hit(ray, 1e-3, far).is_some());
            blocked
        });
        blocked
    }

    /// Whether `p` lies inside a solid by more than `depth`.
    pub fn is_inside(&self, p: DVec3, depth: f64) -> bool {
        let cell = (DVec2::new(p.x, p.y) - self.min) / CELL;
        let (x, y) = (cell.x.floor(), cell.y.floor());
        if x < 0.0 || y < 0.0 || x >= self.size[0] as f64 || y >= self.size[1] as f64 {
            return false;
        }
        let column = y as usize * self.size[0] + x as usize;
        let run = self.starts[column] as usize..self.starts[column + 1] as usize;
        self.items[run].iter().any(|&index| self.solids[index as usize].contains(p, depth))
    }

    /// Calls `visit` for each column along the ray that the ray does not pass above, with the distance at which the ray leaves
    /// it, until `visit` asks to stop.
    fn walk(&self, ray: &Ray, far: f64, mut visit: impl FnMut(&[u32], f64) -> bool) {
        let Some((mut t, end)) = self.clip(ray, far) else { return };
        let start = ray.at(t);
        let mut cell = [0i64; 2];
        let (mut next, mut delta, mut step) = ([f64::INFINITY; 2], [f64::INFINITY; 2], [0i64; 2]);
        for axis in 0..2 {
            let (d, size) = (ray.direction[axis], self.size[axis] as i64);
            let place = (start[axis] - self.min[axis]) / CELL;
            cell[axis] = (place.floor() as i64).clamp(0, size - 1);
            if d != 0.0 {
                step[axis] = if d > 0.0 { 1 } else { -1 };
                let edge = cell[axis] + i64::from(d > 0.0);
                next[axis] = (self.min[axis] + edge as f64 * CELL - ray.origin[axis]) / d;
                delta[axis] = CELL / d.abs();
            }
        }
        loop {
            let axis = usize::from(next[1] < next[0]);
            let leave = next[axis].min(end);
            let column = cell[1] as usize * self.size[0] + cell[0] as usize;
            let z = ray.origin.z + ray.direction.z * if ray.direction.z > 0.0 { t } else { leave };
            if z <= self.tops[column] {
                let run = self.starts[column] as usize..self.starts[column + 1] as usize;
                if visit(&self.items[run], leave) {
                    return;
                }
            } else if ray.direction.z >= 0.0 && z > self.top {
                return;
            }
            t = leave;
            if t >= end {
                return;
            }
            cell[axis] += step[axis];
            next[axis] += delta[axis];
            if cell[axis] < 0 || cell[axis] >= self.size[axis] as i64 {
                return;
            }
        }
    }

    /// The part of `0..far` in which the ray is over the grid.
    fn clip(&self, ray: &Ray, far: f64) -> Option<(f64, f64)> {
        let (mut enter, mut leave) = (0.0f64, far);
        for axis in 0..2 {
            let (o, d) = (ray.origin[axis], ray.direction[axis]);
            let low = self.min[axis];
            let high = low + self.size[axis] as f64 * CELL;
            if d == 0.0 {
                if o < low || o > high {
                    return None;
                }
                continue;
            }
            let (a, b) = ((low - o) / d, (high - o) / d);
            enter = enter.max(a.min(b));
            leave = leave.min(a.max(b));
        }
        (enter < leave).then_some((enter, leave))
    }
}

#[cfg(test)]
mod tests {
    use super::super::skin::SkinId;
    use super::super::solid::Shape;
    use super::*;
    use crate::scene::random::SplitMix64;

    #[test]
    fn the_grid_finds_what_a_plain_loop_finds() {
        let mut random = SplitMix64::new(3);
        let solids: Vec<Solid> = (0..200)
            .map(|_| {
                let base = DVec3::new(random.range(0.0, 80.0), random.range(0.0, 60.0), 0.0);
                let (radius, height) = (random.range(0.2, 5.0), random.range(1.0, 20.0));
                Solid::new(Shape::Cylinder { base, radius, height, skin: SkinId(0) })
            })
            .collect();
        let grid = Grid::new(solids.clone(), DVec2::splat(-6.0), DVec2::new(86.0, 66.0));
        let mut met = 0;
        for _ in 0..3_000 {
            let origin = DVec3::new(
                random.range(-10.0, 90.0),
                random.range(-10.0, 70.0),
                random.range(0.0, 40.0),
            );
            let direction =
                DVec3::new(random.bell(), random.bell(), random.bell() * 0.3).normalize_or_zero();
            let ray = Ray { origin, direction };
            let plain = solids
                .iter()
                .filter_map(|solid| solid.hit(&ray, 1e-3, 70.0))
                .map(|hit| hit.t)
                .min_by(f64::total_cmp);
            assert_eq!(grid.nearest(&ray, 70.0).map(|hit| hit.t), plain);
            assert_eq!(grid.is_blocked(&ray, 70.0), plain.is_some());
            met += usize::from(plain.is_some());
        }
        assert!(met > 500, "{met}");
    }
}
