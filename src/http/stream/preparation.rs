//! The bake that planned frames of moving poses need, while others are drawn. Pure.
//!
//! ```text
//!          begin             failed, same scene
//!   Idle ────────▶ Baking ──────────────────────▶ Failed
//!    ▲               │                              │
//!    └───────────────┴──────────────────────────────┘
//!      succeeded, or failed         the scene changed
//!      for an earlier scene
//! ```
//!
//! A change of the scene leaves the bake alone: a scene that is often patched would never get trees, and most of the assets that are
//! baked are usually in the changed scene, too.

/// State of the bake `B`. `M` marks a scene at one revision.
pub enum Preparation<B, M> {
    Idle,
    Baking { bake: B, mark: M },
    Failed { mark: M },
}

impl<B, M: Copy + PartialEq> Preparation<B, M> {
    /// Takes note of the scene's present mark and of the end of the bake. `outcome` returns whether the bake succeeded, once it has
    /// ended.
    pub fn update(&mut self, present: M, outcome: impl FnOnce(&mut B) -> Option<bool>) {
        *self = match self {
            Preparation::Baking { bake, mark } => match outcome(bake) {
                None => return,
                Some(false) if *mark == present => Preparation::Failed { mark: present },
                Some(_) => Preparation::Idle,
            },
            Preparation::Failed { mark } if *mark != present => Preparation::Idle,
            _ => return,
        };
    }

    /// Returns whether no bake is under way or has failed.
    pub fn is_idle(&self) -> bool {
        matches!(self, Preparation::Idle)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    type Bake = Option<bool>;

    fn baking(mark: u64) -> Preparation<Bake, u64> {
        Preparation::Baking { bake: None, mark }
    }

    fn update(preparation: &mut Preparation<Bake, u64>, present: u64) {
        preparation.update(present, |bake| *bake);
    }

    fn end(preparation: &mut Preparation<Bake, u64>, is_good: bool) {
        if let Preparation::Baking { bake, .. } = preparation {
            *bake = Some(is_good);
        }
    }

    #[test]
    fn a_bake_outlasts_changes_of_the_scene() {
        let mut preparation = baking(1);
        for mark in 1..9 {
            update(&mut preparation, mark);
            assert!(matches!(preparation, Preparation::Baking { mark: 1, .. }));
        }
        end(&mut preparation, true);
        update(&mut preparation, 9);
        assert!(preparation.is_idle(), "the changed scene may need another bake");
    }

    #[test]
    fn a_failed_bake_is_tried_again_when_the_scene_has_changed() {
        let mut preparation = baking(1);
        end(&mut preparation, false);
        for _ in 0..2 {
            update(&mut preparation, 1);
            assert!(matches!(preparation, Preparation::Failed { mark: 1 }));
        }
        update(&mut preparation, 2);
        assert!(preparation.is_idle());
        // The scene changed while the bake ran.
        let mut preparation = baking(1);
        end(&mut preparation, false);
        update(&mut preparation, 2);
        assert!(preparation.is_idle());
    }
}
