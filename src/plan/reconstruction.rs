//! How a frame makes a surface of projected samples: the method that a request, `auto` and the scene together decide.

use super::{Reconstruct, Settings};
use crate::scene::{Blend, Discs, PAINT_WIDTH_PERCENT, Painted, PullPush, Shading, Splats};

/// A method of reconstruction with its parameters.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Reconstruction {
    /// One pixel a sample.
    #[default]
    Points,
    /// Points of a size: discs that face the image plane.
    Discs(Discs),
    /// Elliptical Gaussians (Zwicker et al. 2004): blended in three passes, or opaque.
    Splats(Splats),
    /// Splats that are blended and depth-tested in a single pass (Dachsbacher et al. 2003, §5). `blend` and `shading` are those of the
    /// three passes that the single pass approximates.
    Fuzzy(Splats),
    /// Splats that are painted over each other in the order of their distances (Coconu & Hege 2002). `blend` and `shading` are as for
    /// [`Reconstruction::Fuzzy`].
    Painted(Painted),
    /// One pixel a sample, and coarser levels of the image that fill the gaps (Marroquim et al. 2008).
    PullPush(PullPush),
}

impl Reconstruction {
    /// Returns the method for settings whose `reconstruct` is decided. `scene` gives what the settings leave open.
    pub fn new(settings: &Settings, scene: &Splats) -> Reconstruction {
        let splats = Splats {
            filter: settings.filter.unwrap_or(scene.filter),
            prefilter: settings.prefilter.unwrap_or(scene.prefilter),
            ..*scene
        };
        let lit = |splats| Splats { blend: Blend::Weighted, shading: Shading::Splat, ..splats };
        match settings.reconstruct {
            // `auto` has been decided before.
            Reconstruct::Points | Reconstruct::Auto => {
                settings.discs().map_or(Reconstruction::Points, Reconstruction::Discs)
            }
            Reconstruct::Splats => Reconstruction::Splats(Splats {
                blend: settings.blend.unwrap_or(scene.blend),
                // Surfaces that are coloured after blending are lit after blending.
                shading: match settings.recolors() {
                    true => Shading::Deferred,
                    false => settings.shading.unwrap_or(scene.shading),
                },
                ..splats
            }),
            // Blended colours cannot be lit any more.
            Reconstruct::Fuzzy => Reconstruction::Fuzzy(lit(splats)),
            Reconstruct::Painted => Reconstruction::Painted(Painted {
                splats: Splats {
                    prefilter: true,
                    cutoff: splats.cutoff * PAINT_WIDTH_PERCENT as f32 / 100.0,
                    ..lit(splats)
                },
                each: settings.painted_as,
            }),
            Reconstruct::PullPush => Reconstruction::PullPush(PullPush {
                splats: Splats {
                    blend: Blend::Weighted,
                    shading: Shading::Deferred,
                    prefilter: false,
                    ..*scene
                },
                weights: settings.pull_push_weights,
            }),
        }
    }

    /// The parameters of splats, or of the disks that pull-push reconstructs a surface of; `None` where samples are drawn as points.
    pub fn splats(&self) -> Option<&Splats> {
        match self {
            Reconstruction::Points | Reconstruction::Discs(_) => None,
            Reconstruction::Splats(splats) | Reconstruction::Fuzzy(splats) => Some(splats),
            Reconstruction::Painted(painted) => Some(&painted.splats),
            Reconstruction::PullPush(pull_push) => Some(&pull_push.splats),
        }
    }

    /// The method for an image whose pixels are smaller by a factor.
    #[must_use]
    pub fn in_parts(self, factor: f32) -> Reconstruction {
        let finer = |splats: Splats| Splats { lowpass_px: splats.lowpass_px * factor, ..splats };
        match self {
            Reconstruction::Points => Reconstruction::Points,
            Reconstruction::Discs(discs) => {
                let diameter_px = discs.diameter_px * factor;
                Reconstruction::Discs(Discs { diameter_px, ..discs })
            }
            Reconstruction::Splats(splats) => Reconstruction::Splats(finer(splats)),
            Reconstruction::Fuzzy(splats) => Reconstruction::Fuzzy(finer(splats)),
            Reconstruction::Painted(painted) => {
                let splats = finer(painted.splats);
                Reconstruction::Painted(Painted { splats, ..painted })
            }
            Reconstruction::PullPush(pull_push) => {
                let splats = finer(pull_push.splats);
                Reconstruction::PullPush(PullPush { splats, ..pull_push })
            }
        }
    }

    /// The discs that samples are drawn as.
    pub fn discs(&self) -> Option<&Discs> {
        match self {
            Reconstruction::Discs(discs) => Some(discs),
            _ => None,
        }
    }

    /// Whether each sample covers one pixel.
    pub fn is_points(&self) -> bool {
        *self == Reconstruction::Points
    }

    /// The parameters of pull-push reconstruction.
    pub fn pull_push(&self) -> Option<&PullPush> {
        match self {
            Reconstruction::PullPush(pull_push) => Some(pull_push),
            _ => None,
        }
    }

    /// How far behind the nearest surface samples belong to it, in radii of the nearest one; 0 where they are not combined.
    pub fn depth_offset(&self) -> f32 {
        let painted = self.painted().map(|painted| &painted.splats);
        let pulled = self.pull_push().map(|pull_push| &pull_push.splats);
        let splats = self.weighted().or(painted).or(pulled);
        splats.map_or(0.0, |splats| splats.depth_offset)
    }

    /// Whether samples stand for disks: as splats, or for pull-push.
    pub fn is_splats(&self) -> bool {
        self.splats().is_some()
    }

    /// The parameters of splats that are blended and depth-tested in a single pass.
    pub fn fuzzy(&self) -> Option<&Splats> {
        match self {
            Reconstruction::Fuzzy(splats) => Some(splats),
            _ => None,
        }
    }

    /// The parameters of splats that are painted over each other.
    pub fn painted(&self) -> Option<&Painted> {
        match self {
            Reconstruction::Painted(painted) => Some(painted),
            _ => None,
        }
    }

    /// The parameters of splats that are drawn after all triangles, wherever they are, and leave no depths.
    pub fn without_depths(&self) -> Option<&Splats> {
        self.fuzzy().or(self.painted().map(|painted| &painted.splats))
    }

    /// The parameters of splats that are blended in three passes.
    pub fn weighted(&self) -> Option<&Splats> {
        match self {
            Reconstruction::Splats(splats) if splats.blend == Blend::Weighted => Some(splats),
            _ => None,
        }
    }

    /// Whether overlapping splats are blended, in three passes or in one.
    pub fn blends(&self) -> bool {
        self.weighted().is_some() || self.without_depths().is_some()
    }

    /// Whether splats are lit with the given kind of shading.
    pub fn shades(&self, shading: Shading) -> bool {
        self.splats().is_some_and(|splats| splats.shading == shading)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Filter;

    const SCENE: Splats = Splats {
        filter: Filter::Exact,
        blend: Blend::Opaque,
        shading: Shading::Deferred,
        prefilter: true,
        lowpass_px: 0.5,
        cutoff: 2.0,
        width: 3.0,
        depth_offset: 1.0,
    };

    fn method(reconstruct: Reconstruct) -> Reconstruction {
        Reconstruction::new(&Settings::drawn_as(reconstruct), &SCENE)
    }

    #[test]
    fn settings_decide_and_the_scene_fills_what_they_leave_open() {
        assert_eq!(method(Reconstruct::Points), Reconstruction::Points);
        assert_eq!(method(Reconstruct::Splats), Reconstruction::Splats(SCENE));
        let asked = Settings {
            blend: Some(Blend::Weighted),
            prefilter: Some(false),
            ..Settings::drawn_as(Reconstruct::Splats)
        };
        let splats = Splats { blend: Blend::Weighted, prefilter: false, ..SCENE };
        assert_eq!(Reconstruction::new(&asked, &SCENE), Reconstruction::Splats(splats));
    }

    #[test]
    fn painted_splats_have_the_parameters_of_a_single_pass() {
        let painted = method(Reconstruct::Painted);
        let wider = Splats { cutoff: 2.3, ..*method(Reconstruct::Fuzzy).splats().unwrap() };
        assert_eq!(painted.splats(), Some(&wider));
        assert!(painted.painted().is_some() && painted.fuzzy().is_none() && painted.blends());
        assert!(painted.depth_offset() == 1.0 && method(Reconstruct::Fuzzy).depth_offset() == 0.0);
        assert_eq!(painted.without_depths(), painted.splats());
    }

    #[test]
    fn a_single_pass_stands_for_three_that_blend_lit_splats() {
        let fuzzy = method(Reconstruct::Fuzzy);
        let three = Settings::drawn_as(Reconstruct::Fuzzy).in_three_passes();
        let three = Reconstruction::new(&three, &SCENE);
        assert_eq!(fuzzy.splats(), three.splats());
        assert!(fuzzy.fuzzy().is_some() && fuzzy.weighted().is_none() && fuzzy.blends());
        assert!(three.fuzzy().is_none() && three.weighted().is_some() && three.blends());
        let opaque = method(Reconstruct::Splats);
        assert!(opaque.is_splats() && !opaque.blends() && !Reconstruction::Points.is_splats());
    }
}
