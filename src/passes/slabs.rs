//! How depths are cut into slabs where splats are blended and depth-tested in a single pass: see `shared/slabs.wgsl`.

use crate::math::View;
use crate::residency::model::Extent;
use crate::scene::Splats;

/// How thick slabs are where `depth_offset` is 1: in pixels, or as a share of how far kernels reach. A pixel shows one slab to two of
/// them; measured on town, part and balls of large splats, these come nearest to three passes.
const SLAB_PX: f64 = 2.0;
const SLAB_REACH: f64 = 0.5;
/// The last slab's number; as in the shader.
pub const SLABS: f64 = 8188.0;
/// Where kernels have no width, what lies nearer than the farthest by this factor is in the first slab.
const SLAB_RANGE: f64 = 4096.0;
/// Least fraction of the wanted number of slabs. With fewer, slabs are too thick, and the frame takes three passes.
const LEAST_FIT: f64 = 0.75;

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Slabs {
    pub near: f64,
    /// Slabs for each unit of depth, from `near` to `meet`.
    pub per_unit: f64,
    pub meet: f64,
    /// Slabs for each doubling of depth, from there on.
    pub per_octave: f64,
    /// Number of slabs as a fraction of the number wanted; below 1 only if the scene spans more than there are numbers for.
    fit: f64,
}

impl Slabs {
    /// A slab is as thick as [`SLAB_REACH`] of what a kernel reaches, or as [`SLAB_PX`] pixels are wide where that is more, times
    /// `depth_offset`; thicker where there would be too many for what the scene spans.
    ///
    /// `accepted_px`: by how much nodes of point trees may be wrong, whose disks are wider by as much; 0 at full detail.
    pub fn new(splats: &Splats, extent: &Extent, view: &View, accepted_px: f32) -> Slabs {
        let backward = view.view_from_world.transpose().z_axis;
        let depths = extent.bounds.corners().map(|corner| (view.eye - corner).dot(backward));
        let far = depths.into_iter().fold(0.0, f64::max);
        let least = depths.into_iter().fold(f64::INFINITY, f64::min);
        if !(far > 0.0 && far.is_finite()) {
            // Nothing is before the eye.
            return Slabs { fit: 1.0, ..Slabs::default() };
        }
        let offset = f64::from(splats.depth_offset);
        let reach = SLAB_REACH * offset * extent.kernel * f64::from(splats.width * splats.cutoff);
        let share = SLAB_PX.max(f64::from(accepted_px)) * offset / view.focal_px.max_element();
        if view.is_orthographic() {
            // Pixels have one width at all depths, and so have slabs.
            let thick = reach.max(share);
            let near = least.max(0.0);
            let wanted = (far - near) / thick;
            let fit = if thick > 0.0 { (SLABS / wanted.max(1.0)).min(1.0) } else { 0.0 };
            let per_unit = if thick > 0.0 { fit / thick } else { 0.0 };
            return Slabs { near, per_unit, meet: far, per_octave: 0.0, fit };
        }
        let near = if reach > 0.0 { least.max(0.0) } else { least.max(far / SLAB_RANGE) };
        // From where on pixels are wider than kernels reach.
        let meet = (reach / share).clamp(near, far);
        if !(share > 0.0 && meet > 0.0) {
            return Slabs { fit: 0.0, ..Slabs::default() };
        }
        let per_unit = if meet > near { reach.recip() } else { 0.0 };
        let per_octave = std::f64::consts::LN_2 / share.ln_1p();
        let wanted = (meet - near) * per_unit + (far / meet).log2() * per_octave;
        let fit = (SLABS / wanted.max(1.0)).min(1.0);
        Slabs { near, per_unit: per_unit * fit, meet, per_octave: per_octave * fit, fit }
    }

    /// Whether there are enough of them to tell surfaces apart as three passes do.
    pub fn fit(&self) -> bool {
        self.fit >= LEAST_FIT
    }

    /// The slab of a depth, as the shader has it.
    #[cfg(test)]
    fn of(&self, z: f64) -> f64 {
        let first = (z.min(self.meet) - self.near) * self.per_unit;
        let rest = (z.log2() - self.meet.log2()).max(0.0) * self.per_octave;
        (first + rest).clamp(0.0, SLABS).floor()
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::math::{Bounds, Camera};

    fn view(eye: DVec3, side: u32) -> View {
        let camera = Camera::perspective(eye, eye - DVec3::Z, 45.0);
        camera.view(side, side).unwrap()
    }

    fn extent(size: f64, kernel: f64) -> Extent {
        Extent { bounds: Bounds::of([DVec3::splat(-size), DVec3::splat(size)]), kernel }
    }

    /// Between depths that far apart there is a slab's end, and no more than a few.
    #[test]
    fn slabs_are_as_thick_as_kernels_or_pixels() {
        for (eye, size, kernel) in [(3.0, 1.0, 0.01), (0.3, 1.0, 0.01), (900.0, 300.0, 0.01)] {
            let view = view(DVec3::Z * eye, 1000);
            let slabs = Slabs::new(&Splats::default(), &extent(size, kernel), &view, 0.0);
            assert!(slabs.fit());
            for depth in [0.2, 0.9, 2.5, 3.5, 700.0, 1100.0] {
                if depth < eye - size || depth > eye + size {
                    continue;
                }
                let thick = f64::max(kernel, 2.0 * depth / view.focal_px.x);
                let between = slabs.of(depth + 3.0 * thick) - slabs.of(depth);
                assert!((2.0..=4.0).contains(&between), "{eye} {depth}: {between}");
            }
        }
    }

    /// Other objects of a scene change slabs little, until the scene is too deep for them, which is then known.
    #[test]
    fn a_far_object_hardly_changes_slabs() {
        let view = view(DVec3::Z * 3.0, 1600);
        let thickness = |size: f64| {
            let slabs = Slabs::new(&Splats::default(), &extent(size, 0.008), &view, 0.0);
            slabs.fit().then(|| (slabs.of(3.9) - slabs.of(3.0)) as i64)
        };
        let alone = thickness(1.0).unwrap();
        for size in [300.0, 30_000.0] {
            let there = thickness(size).unwrap();
            assert!(there <= alone + 1 && there as f64 >= LEAST_FIT * alone as f64 - 1.0, "{size}");
        }
        assert_eq!(thickness(1e12), None);
    }

    #[test]
    fn degenerate_scenes_have_slabs_of_numbers() {
        let odd = [
            (extent(0.0, 0.0), 3.0),
            (extent(1.0, 0.0), 0.0),
            (extent(1.0, 1e-30), 0.0),
            (extent(1e-20, 1e-25), 1.0),
            (extent(1e20, 1e15), 0.0),
            (Extent { bounds: Bounds::EMPTY, kernel: 0.0 }, 1.0),
        ];
        for (extent, eye) in odd {
            for depth_offset in [0.0, 1.0, 100.0] {
                let splats = Splats { depth_offset, ..Splats::default() };
                let slabs = Slabs::new(&splats, &extent, &view(DVec3::Z * eye, 64), 1.0);
                for value in [slabs.near, slabs.per_unit, slabs.meet, slabs.per_octave] {
                    assert!(value >= 0.0 && value.is_finite(), "{extent:?} {eye}: {slabs:?}");
                }
                assert!(
                    depth_offset > 0.0
                        || !slabs.fit()
                        || slabs == Slabs { fit: 1.0, ..Slabs::default() }
                );
            }
        }
    }
}
