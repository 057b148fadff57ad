//! Estimates the distance between samples from their order alone, that between triangles from their areas, and how far segments
//! of lines bend away from a straight line.
//!
//! Packed samples are sorted along a Morton curve, so that [`GROUP`] consecutive ones lie together. The two longer sides `a ≥ b`
//! of their box tell how densely they cover what they lie on, about `√(a b / n)` on a surface and, seen from the side, in a
//! volume such as a tree, and `a / (n − 1)` along a wire. The median of a chunk's groups ignores groups that a few stray samples
//! stretch, and repeated samples count once. No neighbour is searched: a million samples take about a millisecond.

use glam::{DAffine3, DVec3, IVec3};

use super::pack::{Grid, PackedChunk, PackedGeometry, PackedLines, PackedMesh, PackedSamples};

/// Consecutive samples whose box is taken.
const GROUP: usize = 32;
/// Spacing over that of a group's box: most groups end within a cell of the curve, and their boxes are larger than they are.
const BOX: f64 = 0.7;
/// Groups of a chunk that are looked at.
const GROUPS: usize = 8;
/// Chunks of a geometry that are looked at.
const CHUNKS: usize = 2048;

/// Samples, triangles or segments that lie together, and how far apart they are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Patch {
    /// Middle of most of them.
    pub centre: DVec3,
    /// Distance from the middle within which most of them lie.
    pub radius: f64,
    /// Distance between neighbouring samples at the median, the side of a square as large as the mean triangle, or the mean length of
    /// segments times the angle between neighbours in radians.
    pub spacing: f64,
    /// Number of samples, triangles or segments that the patch stands for.
    pub count: f64,
}

impl Patch {
    /// The patch where an instance places it.
    pub fn placed(&self, world_from_geometry: &DAffine3) -> Patch {
        let map = &world_from_geometry.matrix3;
        let lengths = [map.x_axis, map.y_axis, map.z_axis].map(DVec3::length);
        let longest = lengths.into_iter().fold(0.0, f64::max);
        Patch {
            centre: world_from_geometry.transform_point3(self.centre),
            radius: self.radius * longest,
            spacing: self.spacing * longest,
            count: self.count,
        }
    }
}

/// The patches of a geometry, at most `most`, in the order of its elements.
pub fn measure(geometry: &PackedGeometry, most: usize) -> Vec<Patch> {
    match geometry {
        PackedGeometry::Samples(samples) => of_samples(samples, most),
        PackedGeometry::Triangles(mesh) => of_triangles(mesh, most),
        PackedGeometry::Lines(lines) => of_lines(lines, most),
    }
}

fn of_samples(samples: &PackedSamples, most: usize) -> Vec<Patch> {
    let step = samples.chunks.len().div_ceil(CHUNKS).max(1);
    let patches: Vec<Patch> = samples
        .chunks
        .iter()
        .step_by(step)
        .filter_map(|chunk| {
            let patch = of_chunk(samples, chunk)?;
            Some(Patch { count: patch.count * step as f64, ..patch })
        })
        .collect();
    merged(&patches, most)
}

fn of_triangles(mesh: &PackedMesh, most: usize) -> Vec<Patch> {
    let side = |chunk: &PackedChunk| (mesh.area_of(chunk) / f64::from(chunk.count.max(1))).sqrt();
    of_boxes(&mesh.grid, &mesh.chunks, most, side)
}

fn of_lines(lines: &PackedLines, most: usize) -> Vec<Patch> {
    of_boxes(&lines.grid, &lines.chunks, most, |chunk| lines.bend_of(chunk))
}

/// Patches with the boxes of chunks. `spacing`: of a chunk's elements, in cells.
fn of_boxes(
    grid: &Grid,
    chunks: &[PackedChunk],
    most: usize,
    spacing: impl Fn(&PackedChunk) -> f64,
) -> Vec<Patch> {
    let step = chunks.len().div_ceil(CHUNKS).max(1);
    let of = |chunk: &PackedChunk| {
        let [low, high] =
            [chunk.origin, chunk.origin + chunk.extent].map(|cell| grid.position(cell));
        Patch {
            centre: (low + high) * 0.5,
            radius: (high - low).length() * 0.5,
            spacing: spacing(chunk) * grid.step,
            count: f64::from(chunk.count) * step as f64,
        }
    };
    merged(&chunks.iter().step_by(step).map(of).collect::<Vec<_>>(), most)
}

/// Joins consecutive patches until there are no more than `most`.
pub fn merged(patches: &[Patch], most: usize) -> Vec<Patch> {
    let run = patches.len().div_ceil(most.max(1)).max(1);
    patches.chunks(run).map(joined).collect()
}

fn of_chunk(samples: &PackedSamples, chunk: &PackedChunk) -> Option<Patch> {
    let range = chunk.first as usize..(chunk.first + chunk.count) as usize;
    let positions = samples.positions.get(range)?;
    let groups = positions.len().div_ceil(GROUP);
    let every = groups.div_ceil(GROUPS).max(1);
    let found: Vec<Patch> = positions
        .chunks(GROUP)
        .step_by(every)
        .filter_map(|group| {
            let cells = group.iter().map(|&word| chunk.cell(word));
            of_group(cells).map(|(low, high, spacing)| {
                let (low, high) = (samples.grid.position(low), samples.grid.position(high));
                Patch {
                    centre: (low + high) * 0.5,
                    radius: (high - low).length() * 0.5,
                    spacing: spacing * samples.grid.step,
                    count: f64::from(chunk.count),
                }
            })
        })
        .collect();
    let count = f64::from(chunk.count);
    (!found.is_empty()).then(|| Patch { count, ..joined(&found) })
}

/// Box and spacing of consecutive samples, in cells; `None` where all are at one place.
fn of_group(cells: impl Iterator<Item = IVec3>) -> Option<(IVec3, IVec3, f64)> {
    let (mut low, mut high) = (IVec3::MAX, IVec3::MIN);
    let (mut distinct, mut last) = (0.0f64, None);
    for cell in cells {
        (low, high) = (low.min(cell), high.max(cell));
        distinct += f64::from(last != Some(cell));
        last = Some(cell);
    }
    let mut sides = (high.as_dvec3() - low.as_dvec3()).to_array();
    sides.sort_unstable_by(f64::total_cmp);
    let [_, b, a] = sides;
    // Each sample has a square of its own, and the box ends in the middle of the outermost: (a + s) (b + s) = n s².
    let (gaps, sum) = (distinct - 1.0, a + b);
    let of_box = || (sum + (sum * sum + 4.0 * gaps * a * b).sqrt()) / (2.0 * gaps);
    (gaps > 0.0 && a > 0.0).then(|| (low, high, (BOX * of_box()).max(a / gaps)))
}

/// One patch for several that are not none.
fn joined(patches: &[Patch]) -> Patch {
    let median = |of: &dyn Fn(&Patch) -> f64| quantile(patches.iter().map(of).collect(), 0.5);
    let centre = DVec3::new(
        median(&|patch| patch.centre.x),
        median(&|patch| patch.centre.y),
        median(&|patch| patch.centre.z),
    );
    let reach = patches.iter().map(|patch| (patch.centre - centre).length() + patch.radius);
    Patch {
        centre,
        // One in eight may lie far away from the others.
        radius: quantile(reach.collect(), 0.875),
        spacing: median(&|patch| patch.spacing),
        count: patches.iter().map(|patch| patch.count).sum(),
    }
}

fn quantile(mut values: Vec<f64>, share: f64) -> f64 {
    let at = (values.len().saturating_sub(1) as f64 * share).round() as usize;
    if at >= values.len() {
        return 0.0;
    }
    *values.select_nth_unstable_by(at, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::assets::PointCloud;
    use crate::bake::pack::pack_samples;
    use crate::scene::random::SplitMix64;

    struct Numbers(SplitMix64);

    impl Numbers {
        fn next(&mut self) -> f64 {
            (self.0.next_u64() >> 11) as f64 / (1u64 << 53) as f64
        }
    }

    fn patches(positions: Vec<DVec3>) -> Vec<Patch> {
        of_samples(&pack_samples(&PointCloud { positions, ..Default::default() }).unwrap(), 64)
    }

    /// The median over samples.
    fn spacing(positions: Vec<DVec3>) -> f64 {
        quantile(patches(positions).iter().map(|patch| patch.spacing).collect(), 0.5)
    }

    const COUNT: u32 = 40_000;

    fn plane(normal: DVec3) -> Vec<DVec3> {
        let mut numbers = Numbers(SplitMix64::new(5));
        let (a, b) = normal.normalize_or(DVec3::Z).any_orthonormal_pair();
        (0..COUNT).map(|_| a * (200.0 * numbers.next()) + b * (200.0 * numbers.next())).collect()
    }

    #[test]
    fn surfaces_are_measured_as_they_are_sampled() {
        let lattice = (0..COUNT).map(|i| DVec3::new(f64::from(i % 200), f64::from(i / 200), 3.0));
        let found = [
            spacing(lattice.collect()),
            spacing(plane(DVec3::Z)),
            spacing(plane(DVec3::new(1.0, 2.0, 3.0))),
            spacing(plane(DVec3::ONE)),
        ];
        assert!(found.iter().all(|s| (0.7..1.45).contains(s)), "{found:?}");
    }

    #[test]
    fn wires_and_volumes_are_measured_as_they_look() {
        let wire = (0..COUNT).map(|i| DVec3::new(f64::from(i), 0.0, 0.0)).collect();
        assert!((0.9..1.1).contains(&spacing(wire)));
        let mut numbers = Numbers(SplitMix64::new(6));
        let mut cube = || DVec3::new(numbers.next(), numbers.next(), numbers.next()) * 34.2;
        let found = spacing((0..COUNT).map(|_| cube()).collect());
        // 32 samples of a cube of 3.2 lie less far apart on its side.
        assert!((0.4..1.0).contains(&found), "{found}");
    }

    #[test]
    fn strays_and_repetitions_change_nothing() {
        let plain = spacing(plane(DVec3::Z));
        let mut numbers = Numbers(SplitMix64::new(7));
        let strays = (0..200).map(|_| {
            DVec3::new(numbers.next() - 0.5, numbers.next() - 0.5, numbers.next() - 0.5) * 1e4
        });
        let with_strays = spacing(plane(DVec3::Z).into_iter().chain(strays).collect());
        let twice = spacing(plane(DVec3::Z).into_iter().flat_map(|p| [p, p]).collect());
        for found in [with_strays, twice] {
            assert!((0.7..1.5).contains(&(found / plain)), "{found} beside {plain}");
        }
        assert!(patches(vec![DVec3::ONE; 5000]).is_empty(), "one place has no spacing");
        assert!(patches(Vec::new()).is_empty());
    }

    #[test]
    fn patches_are_bounded_in_number_and_stand_for_all() {
        let found = patches(plane(DVec3::Z));
        assert!(found.len() <= 64);
        assert_eq!(found.iter().map(|patch| patch.count).sum::<f64>(), f64::from(COUNT));
        assert_eq!(merged(&found, 1).len(), 1);
        let scaled = found[0].placed(&DAffine3::from_scale(DVec3::splat(3.0)));
        assert_eq!(scaled.spacing, 3.0 * found[0].spacing);
        assert_eq!(scaled.count, found[0].count);
    }
}
