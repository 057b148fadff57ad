//! Which passes a frame needs and why, as pure functions of scene, request and adapter (floor 3).
//!
//! The plan is a value: it has every line of the [table of passes](table), each with the reason where the pass is skipped, and every line of
//! the table of specialisations beside it.
//! Recording goes through its [steps](FramePlan::steps).

pub mod auto;
pub mod detail;
pub mod planner;
mod reconstruction;
mod settings;
pub mod shadow;
mod table;

use serde::Serialize;

pub use reconstruction::Reconstruction;
pub use settings::{
    Antialias, Background, BlurSamples, Choice, ColorBound, ColorBy, Edl, EdlRadius, EdlStrength,
    Effect, ErrorMode, Extent, Given, ImagePart, LineWidth, Lod, MOST_WHOLE_PX, MaxError, Output,
    PointSize, PointSizePx, Reconstruct, Rule, Setting, SettingError, SettingKind, Settings,
    ShadowPx, Shadows, StillFrame, Trade, TradeOff, UsedSettings, UsedSplats, Wait, declared,
    trade_offs,
};

pub(crate) use table::pass_table;
use table::specialisation_table;
pub use table::{Kind, MANY_CHUNKS, Per, Stage};

use crate::bake::pack::{Counts, GeometryKind};
use crate::residency::Looks;
use crate::scene::{EyeDome, Shading};

/// Facts about a scene that decide the plans of its frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SceneFacts {
    /// Instances counted.
    pub counts: Counts,
    /// Some file gives normals.
    pub has_normals: bool,
    pub lights: u32,
    /// Suns that cast shadows.
    pub casting_lights: u32,
    /// It has surroundings that light it.
    pub environment: bool,
    /// They are its background.
    pub shows_environment: bool,
    /// It has fog.
    pub fog: bool,
    /// That fog becomes thinner with height.
    pub layered_fog: bool,
    /// It has ambient occlusion.
    pub occlusion: bool,
    /// Its lines would cover little of an image that shows the whole scene.
    pub sparse_lines: bool,
    /// Its assets are point trees, from which a frame takes the detail that it shows.
    pub trees: bool,
    /// For each kind of geometry, whether some of its elements are translucent.
    pub translucent: [bool; GeometryKind::ALL.len()],
    pub looks: Looks,
}

impl SceneFacts {
    pub fn has(&self, kind: GeometryKind) -> bool {
        self.counts.of(kind) > 0
    }

    /// Whether some elements of a kind are translucent.
    pub fn is_translucent(&self, kind: GeometryKind) -> bool {
        self.translucent[kind as usize]
    }

    /// Whether anything is translucent.
    pub fn has_translucent(&self) -> bool {
        self.translucent.contains(&true)
    }
}

/// Number of turns in which distant chunks are tested for occlusion; the shaders have the same number.
pub const TURNS: u32 = 7;

/// Facts about the adapter that decide a plan.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AdapterFacts {
    pub atomics_64: bool,
    /// 64-bit atomics return values as well, and add.
    pub atomic_sums_64: bool,
    /// Large triangles go to the rasteriser rather than to a walk in compute.
    pub rasterises: bool,
    /// Occlusion culling is off, for tests and measurements.
    pub draws_hidden: bool,
}

macro_rules! declare {
    ($($pass:ident $kind:ident $folder:ident/$file:ident $half:literal
        [$($stage:ident)+] $per:ident [$($reason:ident)*];)+) => {
        /// A pass, by the one name that it has everywhere. Passes are ordered as they run.
        #[derive(
            Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, utoipa::ToSchema,
        )]
        #[serde(rename_all = "snake_case")]
        pub enum Pass {
            $($pass),+
        }

        impl Pass {
            /// All passes in the order in which they run.
            pub const ALL: &[Pass] = &[$(Pass::$pass),+];
        }

        const TABLE: &[Line] = &[$(Line {
            name: concat!(stringify!($file), $half),
            shader: concat!(stringify!($folder), "/", stringify!($file)),
            kind: Kind::$kind,
            stages: &[$(Stage::$stage),+],
            per: table::per!($per),
            reasons: &[$(table::$reason),*],
        }),+];
    };
}
pass_table!(declare);

macro_rules! declare_specialisations {
    ($($name:ident $constant:literal [$($reason:ident)*];)+) => {
        /// An effect without a pass of its own. Passes have its code where a frame calls for it.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, utoipa::ToSchema)]
        #[serde(rename_all = "snake_case")]
        pub enum Specialisation {
            $($name),+
        }

        impl Specialisation {
            pub const ALL: &[Specialisation] = &[$(Specialisation::$name),+];
        }

        const SPECIALISATIONS: &[SpecialisationLine] = &[$(SpecialisationLine {
            constant: $constant,
            reasons: &[$(table::$reason),*],
        }),+];
    };
}
specialisation_table!(declare_specialisations);

/// A specialisation's line of its table.
struct SpecialisationLine {
    constant: &'static str,
    reasons: &'static [table::Reason],
}

impl Specialisation {
    fn line(self) -> &'static SpecialisationLine {
        &SPECIALISATIONS[self as usize]
    }

    /// The override of shaders that switches the effect on, or the name that stands for its fragments.
    pub fn constant(self) -> &'static str {
        self.line().constant
    }

    /// The name on the wire.
    pub fn name(self) -> String {
        self.constant().to_lowercase()
    }

    fn skipped(self, facts: &Facts) -> Option<&'static str> {
        table::first(self.line().reasons, facts)
    }
}

/// A pass's line of the table.
struct Line {
    name: &'static str,
    shader: &'static str,
    kind: Kind,
    stages: &'static [Stage],
    per: Per,
    reasons: &'static [table::Reason],
}

impl Pass {
    fn line(self) -> &'static Line {
        &TABLE[self as usize]
    }

    pub fn name(self) -> &'static str {
        self.line().name
    }

    /// The pass's WGSL file below `shaders/`, where it has one.
    pub fn shader(self) -> &'static str {
        self.line().shader
    }

    pub fn kind(self) -> Kind {
        self.line().kind
    }

    pub fn stages(self) -> &'static [Stage] {
        self.line().stages
    }

    fn skipped(self, facts: &Facts) -> Option<&'static str> {
        table::first(self.line().reasons, facts)
    }
}

/// Facts about a frame that decide its plan.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FrameFacts {
    pub output: Output,
    /// How samples are drawn.
    pub reconstruction: Reconstruction,
    /// Eye-dome lighting, where it is on.
    pub edl: Option<EyeDome>,
    /// Shadows are wanted where a light casts them.
    pub shadows: Shadows,
    /// Surroundings are wanted where the scene has some.
    pub environment: Effect,
    /// The request names a background.
    pub has_background: bool,
    /// Fog is wanted where the scene has some.
    pub fog: Effect,
    /// Ambient occlusion is wanted where the scene has some.
    pub occlusion: Effect,
    /// Exposure or a tone map changes the light.
    pub is_toned: bool,
    /// Pixels are means of their parts.
    pub is_averaged: bool,
    /// The frame is the mean of several exposures.
    pub is_exposed: bool,
}

/// One line of a plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct PlannedPass {
    pub pass: Pass,
    /// Why it is skipped; `None` when it runs.
    pub skipped: Option<&'static str>,
}

/// One line of a plan about an effect without a pass.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct PlannedSpecialisation {
    pub specialisation: Specialisation,
    /// Why it is left out; `None` when passes have it.
    pub skipped: Option<&'static str>,
}

/// The passes of one frame.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct FramePlan {
    pub passes: Vec<PlannedPass>,
    pub specialisations: Vec<PlannedSpecialisation>,
    /// Light is computed for each pixel, from its normal.
    pub lights_pixels: bool,
}

/// Consecutive passes of one stage, recorded once, for each segment of a kind, for each digit of a sort, or for each layer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Step {
    pub stage: Stage,
    pub per: Per,
    pub passes: Vec<Pass>,
}

impl Step {
    /// Whether its passes take turns layer by layer. Tubes and ribbons have pipelines of their own, which take turns as well.
    pub fn takes_turns(&self) -> bool {
        let has_lines = self.passes.contains(&Pass::ResolveLinesLayers);
        self.per == Per::Layer && (has_lines || self.passes.len() > 1)
    }
}

impl FramePlan {
    pub fn runs(&self, pass: Pass) -> bool {
        self.passes.iter().any(|planned| planned.pass == pass && planned.skipped.is_none())
    }

    /// Whether passes have the code of an effect.
    pub fn draws(&self, effect: Specialisation) -> bool {
        let mut planned = self.specialisations.iter();
        planned.any(|planned| planned.specialisation == effect && planned.skipped.is_none())
    }

    /// Adds `identify` to the plan, which tells which element each pixel shows.
    #[must_use]
    pub fn with_identities(mut self) -> FramePlan {
        for planned in &mut self.passes {
            if planned.pass == Pass::Identify {
                planned.skipped = None;
            }
        }
        self
    }

    /// Returns the steps to record, in order.
    pub fn steps(&self) -> Vec<Step> {
        let turns = if self.runs(Pass::CullHidden) { TURNS } else { 0 };
        let mut steps = Vec::new();
        for stage in Stage::ALL {
            let passes = self.stage(stage);
            let turns = if stage == Stage::Project { turns } else { 0 };
            for turn in 0..=turns {
                let is_last = stage == Stage::Project && turn == turns;
                // Nothing comes after the last turn that could be hidden.
                let is_asked = |pass| matches!(pass, Pass::DepthPyramid | Pass::CullHidden);
                let passes = passes.iter().filter(|&&pass| !(is_last && is_asked(pass)));
                let passes: Vec<Pass> = passes.copied().collect();
                let together = |a: &Pass, b: &Pass| {
                    let per = a.line().per;
                    per == b.line().per && matches!(per, Per::Segment(_) | Per::Digit | Per::Layer)
                };
                steps.extend(passes.chunk_by(together).map(|passes| Step {
                    stage,
                    per: passes[0].line().per,
                    passes: passes.to_vec(),
                }));
            }
        }
        steps
    }

    /// The passes that run in a stage; none where no pass runs that belongs to it.
    fn stage(&self, stage: Stage) -> Vec<Pass> {
        let running = self.passes.iter().filter(|planned| planned.skipped.is_none());
        let passes: Vec<Pass> = running
            .map(|planned| planned.pass)
            .filter(|pass| pass.stages().contains(&stage))
            .collect();
        let belongs = |pass: &Pass| pass.stages().first() == Some(&stage);
        if passes.iter().any(belongs) { passes } else { Vec::new() }
    }
}

/// All facts that a reason to skip a pass may ask for.
struct Facts<'a> {
    scene: &'a SceneFacts,
    frame: &'a FrameFacts,
    adapter: &'a AdapterFacts,
}

impl Facts<'_> {
    /// Whether elements of a kind are drawn even where they are occluded.
    fn is_drawn_wherever(&self, kind: GeometryKind) -> bool {
        match kind {
            GeometryKind::Samples => self.frame.reconstruction.without_depths().is_some(),
            GeometryKind::Triangles | GeometryKind::Lines => false,
        }
    }

    /// Whether translucent surfaces are compared with the depths of blended splats, which surfaces that are kept have.
    fn composites_over_splats(&self) -> bool {
        let frame = self.frame;
        let blends =
            self.scene.has(GeometryKind::Samples) && frame.reconstruction.weighted().is_some();
        blends && self.scene.has_translucent() && frame.output == Output::Color
    }

    /// Whether splats leave no depths in the image.
    fn leaves_no_depths(&self) -> bool {
        self.scene.has(GeometryKind::Samples)
            && self.frame.reconstruction.without_depths().is_some()
    }

    /// Whether the colours of splats are those under all lights before pixels are.
    fn lights_splats(&self) -> bool {
        self.scene.has(GeometryKind::Samples)
            && self.scene.lights > 0
            && self.frame.reconstruction.blends()
            && self.frame.reconstruction.shades(Shading::Splat)
    }

    /// Whether light is computed for each pixel. Splats that are lit one by one need none after they are blended, unless some are
    /// translucent.
    fn lights_pixels(&self) -> bool {
        let reconstruction = &self.frame.reconstruction;
        let only_splats = GeometryKind::ALL
            .iter()
            .all(|&kind| self.scene.has(kind) == (kind == GeometryKind::Samples));
        let is_done = reconstruction.shades(Shading::Splat)
            && reconstruction.blends()
            && only_splats
            && !self.scene.has_translucent();
        self.frame.output == Output::Color && self.scene.lights > 0 && !is_done
    }
}

/// Width and height in pixels of a frame that is drawn at a scale of the size that is shown: at least 1, and no larger than shown.
pub fn scaled_size(shown: [u32; 2], scale: f64) -> [u32; 2] {
    shown.map(|side| ((f64::from(side) * scale).round() as u32).clamp(1, side.max(1)))
}

/// Plans a frame.
pub fn plan(scene: &SceneFacts, frame: &FrameFacts, adapter: &AdapterFacts) -> FramePlan {
    let facts = Facts { scene, frame, adapter };
    let planned = |&pass: &Pass| PlannedPass { pass, skipped: pass.skipped(&facts) };
    let left_out = |&specialisation: &Specialisation| PlannedSpecialisation {
        specialisation,
        skipped: specialisation.skipped(&facts),
    };
    FramePlan {
        passes: Pass::ALL.iter().map(planned).collect(),
        specialisations: Specialisation::ALL.iter().map(left_out).collect(),
        lights_pixels: facts.lights_pixels(),
    }
}

#[cfg(test)]
mod tests;
