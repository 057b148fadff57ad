//! Measures what tells up from down, and how light it is, on samples of an asset's surface.

use glam::{DVec2, DVec3, Vec3};
use serde::{Deserialize, Serialize};

use super::lightness::lightness;
use super::parts::{areas, as_cloud, as_mesh, corners};
use crate::assets::{Asset, Geometry, Mesh, Placement};

/// Samples that are measured at most.
const SAMPLES: usize = 1 << 14;
/// Fewer samples than this have no shape.
const FEWEST: usize = 200;
/// Share of samples beyond each end that may be outliers.
const OUTLIERS: f64 = 0.001;
/// Samples within this share of the height touch the ground.
const CONTACT: f64 = 0.03;
/// Samples within this share of the height belong to a flat base, and face down within about 14°.
const BASE: f64 = 0.015;
const FACES_DOWN: f64 = 0.97;
/// Cells along the longest axis of the grid that symmetry is measured in.
const GRID: f64 = 24.0;

/// Measurements of an asset along its axes. Lengths are relative to the longest extent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Shape {
    pub extent: [f64; 3],
    /// Overlap of the asset with its mirror image along each axis, 0 to 1.
    pub symmetry: [f64; 3],
    /// The low and the high end of each axis.
    pub ends: [[End; 2]; 3],
    /// The asset consists of points.
    pub is_cloud: bool,
    /// Median linear luminance of the file's colours, 0 to 1; 1 without colours.
    pub lightness: f64,
}

/// Measurements of one end of an asset. Areas are relative to the outline of the asset as it is seen along the axis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct End {
    /// Area of the convex hull of what touches the ground.
    pub footprint: f64,
    /// Distance from the centre of mass to the footprint's rim, relative to the outline's size; negative outside.
    pub balance: f64,
    /// Tangent of the angle that the asset can be tilted by before it falls over; negative if it falls over by itself.
    pub tilt: f64,
    /// Share of the surface that touches the ground.
    pub contact: f64,
    /// Share of the surface in a flat base, and the area of its convex hull.
    pub flat: f64,
    pub flat_footprint: f64,
    /// Height of the centre of mass above this end, relative to the height of the asset.
    pub centroid_height: f64,
    /// Mean part of the normals that points away from this end: above 0 where the surface is open here.
    pub opening: f64,
}

/// A point of the surface; the normal is zero where it is not known.
#[derive(Clone, Copy)]
struct Sample {
    position: DVec3,
    normal: DVec3,
}

impl Shape {
    /// Measures an asset. `None` if it has too little to measure, or no extent.
    pub fn of(asset: &Asset) -> Option<Shape> {
        let is_cloud = asset.geometries.iter().all(|g| matches!(g, Geometry::Points(_)));
        let mut samples = surface(asset);
        let (low, high) = core_box(&samples)?;
        let longest = (high - low).max_element();
        if !(longest > 0.0 && longest.is_finite()) {
            return None;
        }
        let margin = DVec3::splat(0.02 * longest);
        if is_cloud {
            samples.retain(|sample| {
                sample.position.cmpge(low - margin).all()
                    && sample.position.cmple(high + margin).all()
            });
        }
        for sample in &mut samples {
            sample.position = (sample.position - low) / longest;
        }
        let extent = (high - low) / longest;
        let mut shape = Shape {
            extent: extent.to_array(),
            is_cloud,
            lightness: lightness(asset),
            ..Shape::default()
        };
        let count = samples.len() as f64;
        let centroid = samples.iter().map(|s| s.position).sum::<DVec3>() / count;
        for axis in 0..3 {
            shape.symmetry[axis] = symmetry(&samples, extent, axis);
            let outline = Hull::of(samples.iter().map(|s| across(s.position, axis)));
            for end in 0..2 {
                shape.ends[axis][end] = measure(&samples, extent, centroid, axis, end, &outline);
            }
        }
        Some(shape)
    }
}

fn measure(
    samples: &[Sample],
    extent: DVec3,
    centroid: DVec3,
    axis: usize,
    end: usize,
    outline: &Hull,
) -> End {
    let (tall, sign) = (extent[axis], if end == 0 { 1.0 } else { -1.0 });
    let height = |at: DVec3| if end == 0 { at[axis] } else { tall - at[axis] };
    let whole = outline.area.max(1e-30);
    let is_base = |sample: &&Sample| {
        let is_low = height(sample.position) < BASE * tall.max(0.3);
        is_low && (sample.normal == DVec3::ZERO || -sign * sample.normal[axis] > FACES_DOWN)
    };
    let touching = samples.iter().filter(|s| height(s.position) < CONTACT * tall);
    let feet = Hull::of(touching.clone().map(|s| across(s.position, axis)));
    let base = Hull::of(samples.iter().filter(is_base).map(|s| across(s.position, axis)));
    let share = |count: usize| count as f64 / samples.len() as f64;
    let inside = feet.distance_inside(across(centroid, axis));
    let mean = samples.iter().map(|s| s.normal[axis]).sum::<f64>() / samples.len() as f64;
    End {
        footprint: feet.area / whole,
        balance: inside / whole.sqrt(),
        tilt: inside / height(centroid).max(1e-12),
        contact: share(touching.count()),
        flat: share(samples.iter().filter(is_base).count()),
        flat_footprint: base.area / whole,
        centroid_height: height(centroid) / tall.max(1e-12),
        opening: sign * mean,
    }
}

/// The coordinates beside an axis.
fn across(at: DVec3, axis: usize) -> DVec2 {
    match axis {
        0 => DVec2::new(at.y, at.z),
        1 => DVec2::new(at.z, at.x),
        _ => DVec2::new(at.x, at.y),
    }
}

/// Box without the outermost samples of each axis; `None` for fewer than [`FEWEST`].
fn core_box(samples: &[Sample]) -> Option<(DVec3, DVec3)> {
    if samples.len() < FEWEST {
        return None;
    }
    let (mut low, mut high) = (DVec3::ZERO, DVec3::ZERO);
    let cut = (samples.len() as f64 * OUTLIERS) as usize;
    for axis in 0..3 {
        let mut along: Vec<f64> = samples.iter().map(|s| s.position[axis]).collect();
        let last = along.len() - 1 - cut;
        low[axis] = *along.select_nth_unstable_by(cut, f64::total_cmp).1;
        high[axis] = *along.select_nth_unstable_by(last, f64::total_cmp).1;
    }
    Some((low, high))
}

/// Share of the grid's occupied cells that the asset and its mirror image have in common, at the best of a few offsets.
fn symmetry(samples: &[Sample], extent: DVec3, axis: usize) -> f64 {
    let size = (extent * GRID).ceil().max(DVec3::ONE);
    let cells = size.as_u64vec3();
    let cell = |at: DVec3| {
        let [x, y, z] = at.floor().clamp(DVec3::ZERO, size - DVec3::ONE).to_array();
        ((z as u64 * cells.y + y as u64) * cells.x + x as u64) as usize
    };
    let mut own = vec![false; (cells.x * cells.y * cells.z) as usize];
    samples.iter().for_each(|s| own[cell(s.position * GRID)] = true);
    let tall = extent[axis] * GRID;
    let overlap = |shift: f64| {
        let mut mirrored = vec![false; own.len()];
        for sample in samples {
            let mut at = sample.position * GRID;
            at[axis] = tall - at[axis] + shift;
            if (0.0..=tall).contains(&at[axis]) {
                mirrored[cell(at)] = true;
            }
        }
        let pairs = || own.iter().zip(&mirrored);
        let common = pairs().filter(|(a, b)| **a && **b).count();
        let all = pairs().filter(|(a, b)| **a || **b).count();
        common as f64 / all.max(1) as f64
    };
    [-1.0, -0.5, 0.0, 0.5, 1.0].into_iter().map(overlap).fold(0.0, f64::max)
}

/// A convex polygon, anticlockwise.
struct Hull {
    corners: Vec<DVec2>,
    area: f64,
}

impl Hull {
    /// Andrew's monotone chain.
    fn of(points: impl Iterator<Item = DVec2>) -> Hull {
        let mut points: Vec<DVec2> = points.collect();
        points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
        points.dedup();
        let mut corners: Vec<DVec2> = Vec::new();
        let mut add = |point: DVec2, fixed: usize| {
            while let [.., a, b] = corners[..]
                && corners.len() > fixed
                && (b - a).perp_dot(point - b) <= 0.0
            {
                corners.pop();
            }
            corners.push(point);
            corners.len()
        };
        let lower = points.iter().fold(0, |_, &point| add(point, 1));
        points.iter().rev().skip(1).for_each(|&point| {
            add(point, lower);
        });
        if corners.len() > 1 {
            corners.pop();
        }
        let mut area = 0.0;
        for (i, a) in corners.iter().enumerate() {
            area += 0.5 * a.perp_dot(corners[(i + 1) % corners.len()]);
        }
        Hull { corners, area: area.max(0.0) }
    }

    /// Distance from the rim to a point inside; −1 where there is no inside, negative distance to the nearest side's line for a
    /// point outside.
    fn distance_inside(&self, point: DVec2) -> f64 {
        if self.area <= 0.0 {
            return -1.0;
        }
        let sides = self.corners.iter().enumerate().filter_map(|(i, a)| {
            let along = (self.corners[(i + 1) % self.corners.len()] - *a).try_normalize()?;
            Some(along.perp_dot(point - *a))
        });
        sides.fold(f64::INFINITY, f64::min)
    }
}

/// Samples spread evenly over an asset's surface, or some of its points.
fn surface(asset: &Asset) -> Vec<Sample> {
    let placed = || asset.placements.iter().map(|p| (p, &asset.geometries[p.geometry]));
    let area: f64 =
        placed().map(|(p, g)| as_mesh(g).map_or(0.0, |mesh| areas(mesh, p).sum())).sum();
    let points: usize = placed().map(|(_, g)| as_cloud(g).map_or(0, |c| c.positions.len())).sum();
    let mut samples = Vec::new();
    if area > 0.0 && area.is_finite() {
        let mut walk = Walk { step: area / SAMPLES as f64, next: 0.5, passed: 0.0, taken: 0 };
        for (placement, mesh) in placed().filter_map(|(p, g)| Some((p, as_mesh(g)?))) {
            walk.mesh(mesh, placement, &mut samples);
        }
    } else {
        let step = points.div_ceil(SAMPLES).max(1);
        for (placement, cloud) in placed().filter_map(|(p, g)| Some((p, as_cloud(g)?))) {
            let linear = placement.asset_from_geometry.matrix3;
            let normal = |i: usize| cloud.normals.as_ref().map_or(Vec3::ZERO, |normals| normals[i]);
            samples.extend((0..cloud.positions.len()).step_by(step).map(|i| Sample {
                position: placement.asset_from_geometry.transform_point3(cloud.positions[i]),
                normal: (linear * normal(i).as_dvec3()).normalize_or_zero(),
            }));
        }
    }
    samples.retain(|sample| sample.position.is_finite());
    samples
}

/// Takes a sample each time that a certain area has been passed.
struct Walk {
    step: f64,
    /// Steps after which the next sample is taken.
    next: f64,
    passed: f64,
    taken: u32,
}

impl Walk {
    fn mesh(&mut self, mesh: &Mesh, placement: &Placement, samples: &mut Vec<Sample>) {
        for (area, triangle) in areas(mesh, placement).zip(&mesh.triangles) {
            self.passed += area;
            if self.passed < self.next * self.step {
                continue;
            }
            let [a, b, c] = corners(mesh, placement, *triangle);
            let normal = (b - a).cross(c - a).normalize_or_zero();
            while self.passed >= self.next * self.step {
                self.next += 1.0;
                self.taken += 1;
                // Martin Roberts' R2 sequence.
                let [mut u, mut v] = [0.754_877_666_246_692_7, 0.569_840_290_998_053_2]
                    .map(|step: f64| (0.5 + f64::from(self.taken) * step).fract());
                if u + v > 1.0 {
                    (u, v) = (1.0 - u, 1.0 - v);
                }
                samples.push(Sample { position: a + (b - a) * u + (c - a) * v, normal });
            }
        }
    }
}
