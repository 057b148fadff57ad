//! `town`: a simulated laser scan of an imaginary town.
//!
//! A small town is laid out from a seed (streets, kerbs, terraced and detached houses, a square with a church, parks, trees,
//! lamps, cars, people) and scanned by ray casting. The cloud therefore has the properties of real ones: shadows behind objects,
//! density that falls with distance, noisy ranges, echoes lost on glass and at grazing incidence, stray points. Coordinates are
//! UTM (easting about 412,000 m, northing about 5,653,000 m, height about 110 m, z up), in whole millimetres.
//!
//! The input is a size in metres, a number of points and a seed. The output is a point cloud with colour (with the light of a
//! sunny day), intensity (reflectance × incidence × range) and ASPRS classes. Equal parameters give equal bytes on every machine.

mod builder;
mod furniture;
mod grid;
mod ground;
mod house;
mod layout;
mod scan;
mod skin;
mod solid;

use glam::{DVec2, DVec3};

use crate::assets::{PointCloud, Progress};
use grid::Grid;
use ground::{Bend, Plan};
use skin::Skin;

/// The town's place: easting, northing, height in metres (UTM).
pub const ORIGIN_M: DVec3 = DVec3::new(412_000.0, 5_653_000.0, 110.0);

/// Parameters of a town's scan.
#[derive(Clone, Debug)]
pub struct TownParameters {
    /// Edge of the town in metres, 40 to 2000.
    pub size_m: f64,
    pub points: usize,
    pub seed: u64,
}

/// A town ready to be scanned.
pub struct Town {
    plan: Plan,
    grid: Grid,
    skins: Vec<Skin>,
    bend: Bend,
    /// Unit vector towards the sun.
    sun: DVec3,
}

impl Town {
    pub fn new(size_m: f64, seed: u64) -> Town {
        let plan = Plan::new(size_m, seed);
        let built = layout::build(&plan, seed);
        let margin = DVec2::splat(12.0);
        let grid = Grid::new(built.solids, plan.min - margin, plan.max + margin);
        let bend = Bend::new(&plan, ORIGIN_M, seed);
        let sun = DVec3::new(-0.52, -0.62, 0.74);
        Town { plan, grid, skins: built.skins, bend, sun: sun / sun.length() }
    }
}

/// Builds the town and scans it.
pub fn town(parameters: &TownParameters, progress: &Progress) -> PointCloud {
    let town = Town::new(parameters.size_m, parameters.seed);
    scan::scan(&town, parameters.points, parameters.seed, progress)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Bounds;

    fn small(seed: u64) -> PointCloud {
        town(&TownParameters { size_m: 70.0, points: 20_000, seed }, &Progress::none())
    }

    #[test]
    fn a_scan_has_what_was_asked_for() {
        let cloud = small(1);
        assert_eq!(cloud.positions.len(), 20_000);
        assert_eq!(cloud.colors.as_ref().unwrap().len(), 20_000);
        let mut spread = cloud.values_of("intensity").unwrap();
        let bounds = Bounds::of(cloud.positions.iter().copied());
        assert!((bounds.centre() - ORIGIN_M).length() < 60.0, "{bounds:?}");
        assert!(bounds.extent().z > 12.0 && bounds.extent().z < 70.0, "{bounds:?}");
        spread.sort_unstable_by(f64::total_cmp);
        assert!(spread[2_000] * 2.0 < spread[18_000], "intensity hardly varies");
        let classes = cloud.values_of("classification").unwrap();
        for (class, least) in [(1.0, 100), (2.0, 1_000), (5.0, 300), (6.0, 3_000), (11.0, 1_000)] {
            let found = classes.iter().filter(|&&c| c == class).count();
            assert!(found >= least, "class {class}: {found}");
        }
    }

    #[test]
    fn the_seed_decides_and_threads_do_not() {
        let first = small(5);
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        let again = pool.install(|| small(5));
        assert_eq!(first.positions, again.positions);
        assert_eq!(first.colors, again.colors);
        assert_ne!(first.positions, small(6).positions);
    }
}
