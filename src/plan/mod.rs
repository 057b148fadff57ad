//! Which passes a frame needs and why, as pure functions of scene, request and adapter (floor 3).
//!
//! The plan is a value: it lists every pass that this program has, in the order in which they run, each with the reason
//! where it is skipped. Recording follows it; the receipt repeats it.

pub mod auto;
mod settings;

use serde::Serialize;

pub use settings::{
    Choice, ErrorMode, Given, Kind, Lod, MaxError, Output, Paint, Reconstruct, Rule, Setting,
    SettingError, Settings, StillFrame, UsedSettings, Wait, declared,
};

use crate::scene::{Blend, Shading, Splats};

/// What a plan depends on in a scene.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SceneFacts {
    pub has_samples: bool,
    pub has_triangles: bool,
    pub lights: u32,
    /// Some light asks for shadows.
    pub casts_shadows: bool,
    /// Some material cuts holes by alpha.
    pub alpha_cut: bool,
    /// Its assets are point trees, from which a frame takes the detail that it shows.
    pub trees: bool,
    /// Chunks, instances counted.
    pub chunks: u64,
}

/// From so many chunks on it pays to ask which of them are hidden.
pub const MANY_CHUNKS: u64 = 128;

/// What a plan depends on in the adapter.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AdapterFacts {
    pub atomics_64: bool,
    /// Integers of 64 bits can be added and exchanged, not only compared.
    pub atomic_sums_64: bool,
    /// Large triangles go to the rasteriser rather than to a walk in compute.
    pub rasterises: bool,
    /// What is hidden is drawn as well: for tests and measurements.
    pub draws_hidden: bool,
}

/// Every pass, by the one name that it has everywhere.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Pass {
    Clear,
    CullGroups,
    ListGroups,
    Place,
    SelectChunks,
    ListEntries,
    Cull,
    Scan,
    Compact,
    LaunchPortions,
    DepthPyramid,
    CullHidden,
    ProjectSamples,
    /// Second half of [`Pass::ProjectSamples`] without 64-bit atomics.
    ProjectSamplesId,
    ProjectSplats,
    WalkSplats,
    ProjectSplatsId,
    WalkSplatsId,
    BlendSplats,
    BlendWalked,
    FuseSplats,
    FuseWalked,
    ProjectTriangles,
    RasteriseTriangles,
    WalkTriangles,
    ProjectTrianglesId,
    RasteriseTrianglesId,
    WalkTrianglesId,
    ResolveSamples,
    ResolveSplats,
    ResolveFused,
    ResolveTriangles,
    Shade,
    ShadowMap,
}

impl Pass {
    /// All passes in the order in which they run.
    pub const ALL: [Pass; 34] = [
        Pass::Clear,
        Pass::CullGroups,
        Pass::ListGroups,
        Pass::Place,
        Pass::SelectChunks,
        Pass::ListEntries,
        Pass::Cull,
        Pass::Scan,
        Pass::Compact,
        Pass::LaunchPortions,
        Pass::DepthPyramid,
        Pass::CullHidden,
        Pass::ShadowMap,
        Pass::ProjectSamples,
        Pass::ProjectSplats,
        Pass::WalkSplats,
        Pass::ProjectTriangles,
        Pass::RasteriseTriangles,
        Pass::WalkTriangles,
        Pass::ProjectSamplesId,
        Pass::ProjectSplatsId,
        Pass::WalkSplatsId,
        Pass::ProjectTrianglesId,
        Pass::RasteriseTrianglesId,
        Pass::WalkTrianglesId,
        Pass::BlendSplats,
        Pass::BlendWalked,
        Pass::FuseSplats,
        Pass::FuseWalked,
        Pass::ResolveSamples,
        Pass::ResolveSplats,
        Pass::ResolveFused,
        Pass::ResolveTriangles,
        Pass::Shade,
    ];

    pub fn name(self) -> &'static str {
        match self {
            Pass::Clear => "clear",
            Pass::CullGroups => "cull_groups",
            Pass::ListGroups => "list_groups",
            Pass::SelectChunks => "select_chunks",
            Pass::ListEntries => "list_entries",
            Pass::Place => "place",
            Pass::Cull => "cull",
            Pass::Scan => "scan",
            Pass::Compact => "compact",
            Pass::LaunchPortions => "launch_portions",
            Pass::DepthPyramid => "depth_pyramid",
            Pass::CullHidden => "cull_hidden",
            Pass::ProjectSamples => "project_samples",
            Pass::ProjectSamplesId => "project_samples_id",
            Pass::ProjectSplats => "project_splats",
            Pass::ProjectSplatsId => "project_splats_id",
            Pass::WalkSplats => "walk_splats",
            Pass::WalkSplatsId => "walk_splats_id",
            Pass::BlendSplats => "blend_splats",
            Pass::BlendWalked => "blend_walked",
            Pass::FuseSplats => "fuse_splats",
            Pass::FuseWalked => "fuse_walked",
            Pass::ResolveSplats => "resolve_splats",
            Pass::ResolveFused => "resolve_fused",
            Pass::ProjectTriangles => "project_triangles",
            Pass::RasteriseTriangles => "rasterise_triangles",
            Pass::ProjectTrianglesId => "project_triangles_id",
            Pass::RasteriseTrianglesId => "rasterise_triangles_id",
            Pass::WalkTriangles => "walk_triangles",
            Pass::WalkTrianglesId => "walk_triangles_id",
            Pass::ResolveSamples => "resolve_samples",
            Pass::ResolveTriangles => "resolve_triangles",
            Pass::Shade => "shade",
            Pass::ShadowMap => "shadow_map",
        }
    }
}

/// One line of a plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct PlannedPass {
    pub pass: Pass,
    /// Why it is skipped; `None` when it runs.
    pub skipped: Option<&'static str>,
}

/// The passes of one frame.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct FramePlan {
    pub passes: Vec<PlannedPass>,
}

impl FramePlan {
    pub fn runs(&self, pass: Pass) -> bool {
        self.passes.iter().any(|planned| planned.pass == pass && planned.skipped.is_none())
    }
}

/// Plans a frame; `splats`: how samples are drawn, if not as points.
pub fn plan(
    scene: &SceneFacts,
    output: Output,
    splats: Option<&Splats>,
    adapter: &AdapterFacts,
) -> FramePlan {
    let shaded = output == Output::Color && scene.lights > 0;
    let is = |blend| splats.is_some_and(|splats| splats.blend == blend);
    let (blended, fused) = (is(Blend::Weighted), is(Blend::Interleaved));
    let lit_alone =
        (blended || fused) && splats.is_some_and(|splats| splats.shading == Shading::Splat);
    let reason = |pass: Pass| -> Option<&'static str> {
        let samples = (!scene.has_samples).then_some("the scene has no samples");
        let triangles = (!scene.has_triangles).then_some("the scene has no triangles");
        let wide = adapter.atomics_64.then_some("the adapter has 64-bit atomics");
        let rasterised =
            adapter.rasterises.then_some("the adapter's rasteriser draws large triangles");
        let walked = (!adapter.rasterises)
            .then_some("the adapter's rasteriser is slower than walk_triangles");
        let points = samples.or(splats.is_none().then_some("samples are drawn as points"));
        let no_points = samples.or(splats.is_some().then_some("samples are drawn as splats"));
        let single = fused.then_some("splats are blended in a single pass");
        let opaque = points.or(single).or((!blended).then_some("splats are not blended"));
        let apart = points.or((!fused).then_some("splats are not blended in a single pass"));
        match pass {
            Pass::Clear | Pass::Place | Pass::Cull | Pass::Scan | Pass::Compact => None,
            Pass::CullGroups | Pass::ListGroups | Pass::SelectChunks | Pass::ListEntries => {
                (!scene.trees).then_some("the level of detail is full")
            }
            Pass::LaunchPortions | Pass::DepthPyramid | Pass::CullHidden => samples
                .or(single)
                .and(triangles)
                .map(|_| "nothing is drawn that can be hidden")
                .or((scene.chunks < MANY_CHUNKS).then_some("the scene is of few chunks"))
                .or(adapter.draws_hidden.then_some("what is hidden is to be drawn")),
            Pass::ProjectSamples => no_points,
            Pass::ProjectSplats | Pass::WalkSplats => points.or(single),
            Pass::ProjectSplatsId | Pass::WalkSplatsId => points.or(single).or(wide),
            Pass::BlendSplats | Pass::BlendWalked => {
                opaque.or((output == Output::Id).then_some("the output is id"))
            }
            Pass::ResolveSplats => opaque,
            Pass::FuseSplats | Pass::FuseWalked | Pass::ResolveFused => apart,
            Pass::ProjectTriangles => triangles,
            Pass::RasteriseTriangles => triangles.or(walked),
            Pass::WalkTriangles => triangles.or(rasterised),
            Pass::ProjectSamplesId => no_points.or(wide),
            Pass::ProjectTrianglesId => triangles.or(wide),
            Pass::RasteriseTrianglesId => triangles.or(wide).or(walked),
            Pass::WalkTrianglesId => triangles.or(wide).or(rasterised),
            // It also writes the background of a scene that has nothing at all.
            Pass::ResolveSamples if scene.has_samples => {
                (blended || fused).then_some("splats are blended")
            }
            Pass::ResolveSamples => samples.filter(|_| scene.has_triangles),
            Pass::ResolveTriangles => triangles,
            Pass::Shade if output != Output::Color => Some("the output is not color"),
            Pass::Shade if shaded && lit_alone && !scene.has_triangles && scene.has_samples => {
                Some("splats are lit one by one")
            }
            Pass::Shade => (!shaded).then_some("the scene has no lights"),
            Pass::ShadowMap if scene.casts_shadows => Some("this version draws no shadows"),
            Pass::ShadowMap => Some("no light casts shadows"),
        }
    };
    FramePlan {
        passes: Pass::ALL.iter().map(|&pass| PlannedPass { pass, skipped: reason(pass) }).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const OF_TREES: [Pass; 4] =
        [Pass::CullGroups, Pass::ListGroups, Pass::SelectChunks, Pass::ListEntries];
    const WIDE: AdapterFacts = AdapterFacts {
        atomics_64: true,
        atomic_sums_64: true,
        rasterises: true,
        draws_hidden: false,
    };

    #[test]
    fn a_scan_without_lights_runs_no_triangle_or_shade_pass() {
        let facts = SceneFacts { has_samples: true, ..Default::default() };
        let plan = plan(&facts, Output::Color, None, &WIDE);
        assert!(plan.runs(Pass::ProjectSamples) && plan.runs(Pass::ResolveSamples));
        for pass in
            [Pass::ProjectTriangles, Pass::RasteriseTriangles, Pass::ResolveTriangles, Pass::Shade]
        {
            assert!(!plan.runs(pass), "{pass:?}");
        }
        assert!(!plan.runs(Pass::ProjectSamplesId));
    }

    #[test]
    fn without_wide_atomics_every_projection_runs_twice() {
        let facts = SceneFacts {
            has_samples: true,
            has_triangles: true,
            lights: 1,
            chunks: MANY_CHUNKS,
            ..Default::default()
        };
        let plan = plan(&facts, Output::Color, None, &AdapterFacts::default());
        for pass in Pass::ALL {
            let other = matches!(
                pass,
                Pass::ShadowMap | Pass::RasteriseTriangles | Pass::RasteriseTrianglesId
            ) || pass.name().contains("splat")
                || matches!(pass, Pass::BlendWalked | Pass::FuseWalked | Pass::ResolveFused)
                || OF_TREES.contains(&pass);
            assert_eq!(plan.runs(pass), !other, "{pass:?}");
        }
    }

    #[test]
    fn what_is_hidden_is_looked_for_where_it_pays() {
        let asks = |facts: SceneFacts, splats: Option<&Splats>, adapter: &AdapterFacts| {
            plan(&facts, Output::Color, splats, adapter).runs(Pass::CullHidden)
        };
        let points = SceneFacts { has_samples: true, chunks: MANY_CHUNKS, ..Default::default() };
        let few = SceneFacts { chunks: MANY_CHUNKS - 1, ..points };
        assert!(asks(points, None, &WIDE) && !asks(few, None, &WIDE));
        assert!(!asks(points, None, &AdapterFacts { draws_hidden: true, ..WIDE }));
        let splats = Splats::default();
        assert!(asks(points, Some(&splats), &WIDE));
        let splats = Splats { blend: Blend::Interleaved, ..splats };
        assert!(!asks(points, Some(&splats), &WIDE));
        // Triangles among splats can be hidden.
        assert!(asks(SceneFacts { has_triangles: true, ..points }, Some(&splats), &WIDE));
    }

    #[test]
    fn large_triangles_are_drawn_in_one_way() {
        let facts = SceneFacts { has_triangles: true, ..Default::default() };
        for (rasterises, atomics_64) in [(true, true), (true, false), (false, true), (false, false)]
        {
            let adapter = AdapterFacts { atomics_64, rasterises, ..AdapterFacts::default() };
            let plan = plan(&facts, Output::Color, None, &adapter);
            assert_eq!(plan.runs(Pass::RasteriseTriangles), rasterises);
            assert_eq!(plan.runs(Pass::WalkTriangles), !rasterises);
            assert_eq!(plan.runs(Pass::RasteriseTrianglesId), rasterises && !atomics_64);
            assert_eq!(plan.runs(Pass::WalkTrianglesId), !rasterises && !atomics_64);
        }
    }

    #[test]
    fn only_color_is_shaded() {
        let facts = SceneFacts { has_samples: true, lights: 2, ..Default::default() };
        assert!(plan(&facts, Output::Color, None, &WIDE).runs(Pass::Shade));
        for output in [Output::Depth, Output::Normal, Output::Id] {
            assert!(!plan(&facts, output, None, &WIDE).runs(Pass::Shade));
        }
    }

    #[test]
    fn an_empty_scene_still_has_a_background() {
        assert!(
            plan(&SceneFacts::default(), Output::Color, None, &WIDE).runs(Pass::ResolveSamples)
        );
    }

    #[test]
    fn every_skipped_pass_says_why_and_all_are_listed_once() {
        let plan = plan(&SceneFacts::default(), Output::Color, None, &WIDE);
        assert_eq!(plan.passes.len(), Pass::ALL.len());
        for planned in &plan.passes {
            assert!(planned.skipped.is_none_or(|why| !why.is_empty()));
        }
    }

    #[test]
    fn splats_run_what_their_settings_ask_for() {
        let facts = SceneFacts { has_samples: true, lights: 1, ..Default::default() };
        let runs = |splats: &Splats, output, facts: &SceneFacts| {
            let plan = plan(facts, output, Some(splats), &WIDE);
            let all = Pass::ALL.into_iter().filter(|&pass| plan.runs(pass));
            all.map(Pass::name).filter(|name| !FIXED.contains(name)).collect::<Vec<_>>()
        };
        const FIXED: [&str; 5] = ["clear", "place", "cull", "scan", "compact"];
        let deferred = Splats::default();
        let depth = ["project_splats", "walk_splats"];
        let blend = ["blend_splats", "blend_walked", "resolve_splats"];
        assert_eq!(
            runs(&deferred, Output::Color, &facts),
            [&depth[..], &blend[..], &["shade"]].concat()
        );
        assert_eq!(runs(&deferred, Output::Depth, &facts), [&depth[..], &blend[..]].concat());
        assert_eq!(runs(&deferred, Output::Id, &facts), [&depth[..], &["resolve_splats"]].concat());
        let lit = Splats { shading: Shading::Splat, ..deferred };
        assert_eq!(runs(&lit, Output::Color, &facts), [&depth[..], &blend[..]].concat());
        let mixed = SceneFacts { has_triangles: true, ..facts };
        assert!(runs(&lit, Output::Color, &mixed).contains(&"shade"));
        let opaque = Splats { blend: Blend::Opaque, ..lit };
        assert_eq!(
            runs(&opaque, Output::Color, &facts),
            [&depth[..], &["resolve_samples", "shade"]].concat()
        );
        let fused = Splats { blend: Blend::Interleaved, ..lit };
        let single = ["fuse_splats", "fuse_walked", "resolve_fused"];
        assert_eq!(runs(&fused, Output::Color, &facts), single);
        assert_eq!(runs(&fused, Output::Color, &mixed).last(), Some(&"shade"));
        let empty = SceneFacts::default();
        assert_eq!(runs(&deferred, Output::Color, &empty), ["resolve_samples"]);
    }
}
