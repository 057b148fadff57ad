//! Plans of scenes, outputs, methods and adapters of every kind.

use super::*;
use crate::scene::{Blend, Discs, EyeDome, Painted, Painting, PullPush, PullPushWeights, Splats};

const SAMPLES: Counts = Counts { samples: 1, chunks: 1, instances: 1, triangles: 0, segments: 0 };
const TRIANGLES: Counts = Counts { samples: 0, chunks: 1, instances: 1, triangles: 1, segments: 0 };
const BOTH: Counts = Counts { samples: 1, ..TRIANGLES };

/// Kinds of geometry with translucent elements.
const SAMPLES_ALONE: [bool; 3] = [true, false, false];
const TRIANGLES_ALONE: [bool; 3] = [false, true, false];

const POINTS: Reconstruction = Reconstruction::Points;
const WIDE: AdapterFacts =
    AdapterFacts { atomics_64: true, atomic_sums_64: true, rasterises: true, draws_hidden: false };

fn plan(
    scene: &SceneFacts,
    output: Output,
    reconstruction: &Reconstruction,
    adapter: &AdapterFacts,
) -> FramePlan {
    let frame = FrameFacts { output, reconstruction: *reconstruction, ..FrameFacts::default() };
    super::plan(scene, &frame, adapter)
}

/// Plans of scenes, outputs, ways to draw samples and adapters of every kind.
fn every_plan() -> Vec<FramePlan> {
    let sides = [false, true];
    let mut adapters = Vec::new();
    for (atomics_64, rasterises, draws_hidden) in iproduct(sides, sides, sides) {
        let atomic_sums_64 = atomics_64 && !draws_hidden;
        adapters.push(AdapterFacts { atomics_64, atomic_sums_64, rasterises, draws_hidden });
    }
    let mut scenes = Vec::new();
    for (samples, triangles, trees) in iproduct([0, 1], [0, 1], sides) {
        let translucent = [samples > 0 && !trees, triangles > 0 && trees, false];
        for (lights, chunks) in [(0, 1), (2, 1), (0, MANY_CHUNKS), (2, MANY_CHUNKS)] {
            scenes.push(SceneFacts {
                counts: Counts { samples, triangles, segments: 0, chunks, instances: 1 },
                lights,
                trees,
                translucent,
                ..SceneFacts::default()
            });
        }
    }
    let lit = Splats { shading: Shading::Splat, ..Splats::default() };
    let mut methods = vec![
        Reconstruction::Points,
        Reconstruction::Discs(Discs { diameter_px: 3.0, diameter: 0.0 }),
        Reconstruction::Fuzzy(lit),
        Reconstruction::Painted(Painted { splats: lit, each: Painting::default() }),
        Reconstruction::PullPush(PullPush {
            splats: Splats::default(),
            weights: PullPushWeights::default(),
        }),
    ];
    for blend in [Blend::Opaque, Blend::Weighted] {
        for shading in [Shading::Splat, Shading::Deferred] {
            let splats = Splats { blend, shading, ..Splats::default() };
            methods.push(Reconstruction::Splats(splats));
        }
    }
    let outputs = [Output::Color, Output::Depth, Output::Normal, Output::Id];
    let effect = EyeDome { strength: 1.0, radius_px: 1.4 };
    let mut plans = Vec::new();
    for (scene, adapter, reconstruction) in iproduct(scenes, adapters, methods) {
        for (output, edl, picked) in iproduct(outputs, [None, Some(effect)], sides) {
            let frame = FrameFacts { output, reconstruction, edl, ..FrameFacts::default() };
            let plan = super::plan(&scene, &frame, &adapter);
            plans.push(if picked { plan.with_identities() } else { plan });
        }
    }
    plans
}

fn iproduct<A: Clone, B: Clone, C: Clone>(
    a: impl IntoIterator<Item = A>,
    b: impl IntoIterator<Item = B> + Clone,
    c: impl IntoIterator<Item = C> + Clone,
) -> Vec<(A, B, C)> {
    let mut out = Vec::new();
    for a in a {
        for b in b.clone() {
            out.extend(c.clone().into_iter().map(|c| (a.clone(), b.clone(), c)));
        }
    }
    out
}

fn running(plan: &FramePlan) -> Vec<Pass> {
    Pass::ALL.iter().copied().filter(|&pass| plan.runs(pass)).collect()
}

#[test]
fn a_scan_without_lights_runs_no_triangle_pass_and_is_not_lit() {
    let facts = SceneFacts { counts: SAMPLES, ..Default::default() };
    let plan = plan(&facts, Output::Color, &POINTS, &WIDE);
    assert!(plan.runs(Pass::ProjectSamples) && plan.runs(Pass::ResolveSamples));
    for pass in [Pass::ProjectTriangles, Pass::RasteriseTriangles, Pass::ResolveTriangles] {
        assert!(!plan.runs(pass), "{pass:?}");
    }
    assert!(!plan.lights_pixels);
    assert!(!plan.runs(Pass::ProjectSamplesId));
}

#[test]
fn without_wide_atomics_every_projection_runs_twice() {
    let facts = SceneFacts {
        counts: Counts { chunks: MANY_CHUNKS, ..BOTH },
        lights: 1,
        ..Default::default()
    };
    let plan = plan(&facts, Output::Color, &POINTS, &AdapterFacts::default());
    let names: Vec<&str> = running(&plan).into_iter().map(Pass::name).collect();
    let first = ["project_samples", "project_triangles", "walk_triangles"];
    let second = ["project_samples_id", "project_triangles_id", "walk_triangles_id"];
    assert_eq!(
        names,
        [
            &["clear", "place", "cull", "scan", "compact", "launch_portions"][..],
            &first,
            &["depth_pyramid", "cull_hidden"],
            &second,
            &["resolve_samples", "resolve_triangles"],
        ]
        .concat()
    );
}

#[test]
fn what_is_hidden_is_looked_for_where_it_pays() {
    let asks = |facts: SceneFacts, method: &Reconstruction, adapter: &AdapterFacts| {
        plan(&facts, Output::Color, method, adapter).runs(Pass::CullHidden)
    };
    let of = |counts: Counts, chunks| SceneFacts {
        counts: Counts { chunks, ..counts },
        ..Default::default()
    };
    let points = of(SAMPLES, MANY_CHUNKS);
    let few = of(SAMPLES, MANY_CHUNKS - 1);
    assert!(asks(points, &POINTS, &WIDE) && !asks(few, &POINTS, &WIDE));
    assert!(!asks(points, &POINTS, &AdapterFacts { draws_hidden: true, ..WIDE }));
    let splats = Splats::default();
    assert!(asks(points, &Reconstruction::Splats(splats), &WIDE));
    let fuzzy = Reconstruction::Fuzzy(splats);
    assert!(!asks(points, &fuzzy, &WIDE));
    // Triangles among splats can be hidden.
    assert!(asks(of(BOTH, MANY_CHUNKS), &fuzzy, &WIDE));
}

#[test]
fn large_triangles_are_drawn_in_one_way() {
    let facts = SceneFacts { counts: TRIANGLES, ..Default::default() };
    for (rasterises, atomics_64) in [(true, true), (true, false), (false, true), (false, false)] {
        let adapter = AdapterFacts { atomics_64, rasterises, ..AdapterFacts::default() };
        let plan = plan(&facts, Output::Color, &POINTS, &adapter);
        assert_eq!(plan.runs(Pass::RasteriseTriangles), rasterises);
        assert_eq!(plan.runs(Pass::WalkTriangles), !rasterises);
        assert_eq!(plan.runs(Pass::RasteriseTrianglesId), rasterises && !atomics_64);
        assert_eq!(plan.runs(Pass::WalkTrianglesId), !rasterises && !atomics_64);
    }
}

#[test]
fn translucent_triangles_take_passes_where_there_are_some() {
    let opaque = SceneFacts { counts: TRIANGLES, ..Default::default() };
    let glass = SceneFacts { translucent: TRIANGLES_ALONE, ..opaque };
    let halves = AdapterFacts { atomic_sums_64: false, ..WIDE };
    let runs = |facts: &SceneFacts, output, adapter: &AdapterFacts| {
        let plan = plan(facts, output, &POINTS, adapter);
        let names = running(&plan).into_iter().map(Pass::name);
        names.filter(|name| name.contains("layers")).collect::<Vec<_>>()
    };
    let whole = ["project_triangles_layers", "rasterise_triangles_layers"];
    let ids = ["project_triangles_layers_id", "rasterise_triangles_layers_id"];
    let ends = ["resolve_triangles_layers", "composite_layers"];
    assert_eq!(runs(&glass, Output::Color, &WIDE), [whole, ends].concat());
    assert_eq!(runs(&glass, Output::Color, &halves), [whole, ids, ends].concat());
    assert!(runs(&opaque, Output::Color, &WIDE).is_empty());
    for output in [Output::Depth, Output::Normal, Output::Id] {
        assert!(runs(&glass, output, &WIDE).is_empty());
    }
}

#[test]
fn translucent_samples_take_passes_by_how_they_are_drawn() {
    let opaque = SceneFacts { counts: SAMPLES, ..Default::default() };
    let mist = SceneFacts { translucent: SAMPLES_ALONE, ..opaque };
    let halves = AdapterFacts { atomic_sums_64: false, ..WIDE };
    let runs = |facts: &SceneFacts, method: &Reconstruction, adapter: &AdapterFacts| {
        let plan = plan(facts, Output::Color, method, adapter);
        let names = running(&plan).into_iter().map(Pass::name);
        names.filter(|name| name.contains("layers")).collect::<Vec<_>>()
    };
    let ends = ["resolve_samples_layers", "composite_layers"];
    let one = ["project_samples_layers"];
    assert_eq!(runs(&mist, &POINTS, &WIDE), [&one[..], &ends].concat());
    let ids = ["project_samples_layers_id"];
    assert_eq!(runs(&mist, &POINTS, &halves), [&one[..], &ids, &ends].concat());
    let disks = ["project_splats_layers", "walk_splats_layers"];
    let discs = Reconstruction::Discs(Discs { diameter_px: 3.0, diameter: 0.0 });
    for method in [discs, Reconstruction::Splats(Splats::default())] {
        assert_eq!(runs(&mist, &method, &WIDE), [&disks[..], &ends].concat());
        assert!(runs(&opaque, &method, &WIDE).is_empty());
    }
    // They are lit, also where the splats among them are lit one by one.
    let lit = Splats { shading: Shading::Splat, ..Splats::default() };
    let lit = Reconstruction::Splats(lit);
    let is_lit = |facts: &SceneFacts| plan(facts, Output::Color, &lit, &WIDE).lights_pixels;
    assert!(is_lit(&SceneFacts { lights: 1, ..mist }));
    assert!(!is_lit(&SceneFacts { lights: 1, ..opaque }));
}

#[test]
fn translucent_lines_take_turns_with_each_other() {
    let counts = Counts { segments: 1, triangles: 0, ..TRIANGLES };
    let opaque = SceneFacts { counts, ..Default::default() };
    let smoke = SceneFacts { translucent: [false, false, true], ..opaque };
    let plan_of = |facts: &SceneFacts| plan(facts, Output::Color, &POINTS, &WIDE);
    let layers = |facts: &SceneFacts| {
        let names = running(&plan_of(facts)).into_iter().map(Pass::name);
        names.filter(|name| name.contains("layers")).collect::<Vec<_>>()
    };
    let passes = ["project_lines_layers", "walk_lines_layers"];
    assert_eq!(layers(&smoke), [passes, ["resolve_lines_layers", "composite_layers"]].concat());
    assert!(layers(&opaque).is_empty());
    let steps = plan_of(&smoke).steps();
    assert!(steps.iter().any(|step| step.per == Per::Layer && step.takes_turns()));
}

#[test]
fn layers_of_several_kinds_are_resolved_in_turns() {
    let facts = SceneFacts { counts: BOTH, ..Default::default() };
    let turns = |translucent| {
        let plan = plan(&SceneFacts { translucent, ..facts }, Output::Color, &POINTS, &WIDE);
        let step = plan.steps().into_iter().find(|step| step.per == Per::Layer).unwrap();
        (step.passes.len(), step.takes_turns())
    };
    assert_eq!(turns([true, true, false]), (2, true));
    assert_eq!([turns(SAMPLES_ALONE), turns(TRIANGLES_ALONE)], [(1, false); 2]);
}

#[test]
fn only_color_is_lit() {
    let facts = SceneFacts { counts: SAMPLES, lights: 2, ..Default::default() };
    assert!(plan(&facts, Output::Color, &POINTS, &WIDE).lights_pixels);
    for output in [Output::Depth, Output::Normal, Output::Id] {
        assert!(!plan(&facts, output, &POINTS, &WIDE).lights_pixels);
    }
}

#[test]
fn effects_that_look_at_neighbours_write_the_output_last() {
    let facts = SceneFacts { counts: SAMPLES, ..Default::default() };
    for output in [Output::Color, Output::Depth, Output::Normal, Output::Id] {
        let edl = Some(EyeDome { strength: 1.0, radius_px: 1.0 });
        let frame = FrameFacts { output, edl, ..FrameFacts::default() };
        let plan = super::plan(&facts, &frame, &WIDE);
        assert_eq!(plan.runs(Pass::WriteOutput), output == Output::Color);
        let frame = FrameFacts { edl: None, ..frame };
        assert!(!super::plan(&facts, &frame, &WIDE).runs(Pass::WriteOutput));
    }
}

#[test]
fn exposures_are_averaged_with_their_parts() {
    let facts = SceneFacts { counts: SAMPLES, ..Default::default() };
    for (is_averaged, is_exposed, output, expected) in [
        (false, false, Output::Color, [false, false]),
        (true, false, Output::Color, [true, false]),
        (false, true, Output::Color, [false, true]),
        (true, true, Output::Color, [false, true]),
        (false, true, Output::Depth, [false, false]),
    ] {
        let frame = FrameFacts { output, is_averaged, is_exposed, ..FrameFacts::default() };
        let plan = super::plan(&facts, &frame, &WIDE);
        assert_eq!([Pass::Average, Pass::Accumulate].map(|pass| plan.runs(pass)), expected);
    }
}

#[test]
fn steps_first_record_passes_in_the_order_of_the_table() {
    for plan in every_plan() {
        let mut recorded: Vec<Pass> = Vec::new();
        for pass in plan.steps().into_iter().flat_map(|step| step.passes) {
            if !recorded.contains(&pass) {
                recorded.push(pass);
            }
        }
        assert_eq!(recorded, running(&plan));
    }
}

#[test]
fn passes_that_share_a_list_go_through_segments_together() {
    for step in every_plan().iter().flat_map(FramePlan::steps) {
        let names: Vec<&str> = step.passes.iter().map(|pass| pass.name()).collect();
        let listed = names.iter().any(|name| name.contains("walk") || name.contains("raster"));
        // No list says which samples are recorded.
        let is_plain = ["record_samples", "count_splats", "list_splats"].contains(&names[0]);
        let by_segment = matches!(step.per, Per::Segment(_)) && !is_plain;
        assert_eq!(listed, by_segment, "{names:?}");
        let together = match step.per {
            Per::Digit => 3,
            Per::Layer => names.len(),
            _ => 1,
        };
        assert_eq!(names.len(), if listed { 2 } else { together }, "{names:?}");
    }
}

#[test]
fn a_turn_ends_by_asking_what_is_hidden_unless_it_is_the_last() {
    let scene = SceneFacts { counts: Counts { chunks: MANY_CHUNKS, ..BOTH }, ..Default::default() };
    let plan = plan(&scene, Output::Color, &Reconstruction::Splats(Splats::default()), &WIDE);
    let of = |stage| {
        let steps = plan.steps().into_iter().filter(move |step| step.stage == stage);
        steps.flat_map(|step| step.passes).map(Pass::name).collect::<Vec<_>>()
    };
    let draw = ["launch_portions", "project_splats", "walk_splats"].into_iter();
    let draw: Vec<&str> = draw.chain(["project_triangles", "rasterise_triangles"]).collect();
    let ask = ["depth_pyramid", "cull_hidden"];
    let mut turns = [&draw[..], &ask].concat().repeat(TURNS as usize);
    turns.extend(&draw);
    assert_eq!(of(Stage::Project), turns);
    // Splats that are blended are asked once more.
    let blend = ["blend_splats", "blend_walked"];
    assert_eq!(of(Stage::Blend), [&["launch_portions"], &ask[..], &blend].concat());
}

#[test]
fn names_are_those_of_shaders_and_of_the_wire() {
    for &pass in Pass::ALL {
        assert_eq!(serde_json::to_value(pass).unwrap(), pass.name());
        let file = pass.shader().rsplit('/').next().unwrap();
        let half = pass.name().strip_prefix(file).unwrap();
        assert!(["", "_id", "_tiles", "_layers", "_layers_id"].contains(&half));
    }
}

#[test]
fn the_architecture_lists_passes_as_they_run() {
    let text = include_str!("../../ARCHITECTURE.md");
    let (_, frame) = text.split_once("\n## The frame\n").unwrap();
    let rows = frame.lines().skip_while(|line| !line.starts_with("| `"));
    let rows = rows.take_while(|line| line.starts_with('|'));
    let names = rows.flat_map(|row| row.split('|').nth(1).unwrap().split(','));
    let names: Vec<&str> = names.map(|name| name.trim().trim_matches('`')).collect();
    // One row stands for the second halves of all passes that have one.
    let mut expected: Vec<&str> = Pass::ALL.iter().map(|pass| pass.name()).collect();
    let is_half = |name: &&str| name.ends_with("_id");
    let first = expected.iter().position(is_half).unwrap();
    expected.retain(|name| !is_half(name));
    expected.insert(first, "…_id");
    assert_eq!(names, expected);
}

#[test]
fn splats_run_what_their_settings_ask_for() {
    let facts = SceneFacts { counts: SAMPLES, lights: 1, ..Default::default() };
    let runs = |method: &Reconstruction, output, facts: &SceneFacts| {
        let plan = plan(facts, output, method, &WIDE);
        let all = running(&plan).into_iter().map(Pass::name);
        all.filter(|name| !FIXED.contains(name)).collect::<Vec<_>>()
    };
    const FIXED: [&str; 5] = ["clear", "place", "cull", "scan", "compact"];
    let splats = Splats::default();
    let deferred = Reconstruction::Splats(splats);
    let depth = ["project_splats", "walk_splats"];
    let blend = ["blend_splats", "blend_walked", "resolve_splats"];
    let is_lit = |method: &Reconstruction, facts: &SceneFacts| {
        plan(facts, Output::Color, method, &WIDE).lights_pixels
    };
    assert_eq!(runs(&deferred, Output::Color, &facts), [&depth[..], &blend[..]].concat());
    assert!(is_lit(&deferred, &facts));
    assert_eq!(runs(&deferred, Output::Depth, &facts), [&depth[..], &blend[..]].concat());
    assert_eq!(runs(&deferred, Output::Id, &facts), [&depth[..], &["resolve_splats"]].concat());
    let splats = Splats { shading: Shading::Splat, ..splats };
    let lit = Reconstruction::Splats(splats);
    assert_eq!(runs(&lit, Output::Color, &facts), [&depth[..], &blend[..]].concat());
    assert!(!is_lit(&lit, &facts));
    let mixed = SceneFacts { counts: BOTH, ..facts };
    assert!(is_lit(&lit, &mixed));
    let opaque = Reconstruction::Splats(Splats { blend: Blend::Opaque, ..splats });
    assert_eq!(runs(&opaque, Output::Color, &facts), [&depth[..], &["resolve_samples"]].concat());
    assert!(is_lit(&opaque, &facts));
    let fuzzy = Reconstruction::Fuzzy(splats);
    let single = ["fuzzy_splats", "fuzzy_walked", "resolve_fuzzy"];
    assert_eq!(runs(&fuzzy, Output::Color, &facts), single);
    assert!(!is_lit(&fuzzy, &facts) && is_lit(&fuzzy, &mixed));
    let painted = Reconstruction::Painted(Painted { splats, each: Painting::default() });
    let sort =
        ["count_splats", "number_splats", "list_splats", "count_keys", "sum_counts", "move_keys"];
    let tiles = ["count_tiles", "sum_counts_tiles", "move_tiles"];
    let paint = [&sort[..], &tiles, &["paint_splats", "composite_splats"]].concat();
    assert_eq!(runs(&painted, Output::Color, &facts), paint);
    let empty = SceneFacts::default();
    assert!(runs(&deferred, Output::Color, &empty).is_empty());
}

#[test]
fn shadow_maps_are_drawn_for_lit_colours_under_casting_suns_alone() {
    let sunny =
        SceneFacts { counts: TRIANGLES, lights: 2, casting_lights: 1, ..Default::default() };
    let why = |scene: &SceneFacts, output, shadows| {
        let frame = FrameFacts { output, shadows, ..FrameFacts::default() };
        let plan = super::plan(scene, &frame, &WIDE);
        plan.passes.iter().find(|planned| planned.pass == Pass::ShadowMap).unwrap().skipped
    };
    assert_eq!(why(&sunny, Output::Color, Shadows::On), None);
    assert_eq!(why(&sunny, Output::Depth, Shadows::On), Some("the output is not color"));
    assert_eq!(why(&sunny, Output::Color, Shadows::Off), Some("shadows are off"));
    let plain = SceneFacts { casting_lights: 0, ..sunny };
    assert_eq!(why(&plain, Output::Color, Shadows::On), Some("no light casts shadows"));
}

#[test]
fn fog_of_layers_has_a_background_of_its_own() {
    let even = SceneFacts { counts: TRIANGLES, fog: true, ..Default::default() };
    let layered = SceneFacts { layered_fog: true, ..even };
    let plan_of = |scene: &SceneFacts, output, fog| {
        super::plan(scene, &FrameFacts { output, fog, ..FrameFacts::default() }, &WIDE)
    };
    let why = |scene: &SceneFacts, output, fog| {
        let plan = plan_of(scene, output, fog);
        plan.passes.iter().find(|planned| planned.pass == Pass::FogBackground).unwrap().skipped
    };
    assert_eq!(why(&layered, Output::Color, Effect::On), None);
    assert_eq!(why(&even, Output::Color, Effect::On), Some("the fog is as dense at every height"));
    assert_eq!(why(&layered, Output::Color, Effect::Off), Some("fog is off"));
    assert_eq!(why(&layered, Output::Normal, Effect::On), Some("the output is not color"));
    let has_fog =
        |scene: &SceneFacts, output, fog| plan_of(scene, output, fog).draws(Specialisation::Fog);
    assert!(has_fog(&even, Output::Color, Effect::On));
    assert!(!has_fog(&even, Output::Color, Effect::Off));
    assert!(!has_fog(&even, Output::Depth, Effect::On));
    let clear = SceneFacts { fog: false, ..even };
    assert!(!has_fog(&clear, Output::Color, Effect::On));
}

/// Plans name every effect without a pass, and the scene's or the request's reason where it is left out.
#[test]
fn effects_without_a_pass_are_left_out_for_a_reason() {
    use Specialisation::{Environment, Fog, Maps, Materials, Textures, Tone, Transmits};
    let looks = Looks {
        textures: true,
        overrides: false,
        translucent_overrides: [false; 3],
        specular: true,
        physical: true,
        emissive: true,
        transmits: true,
        maps: true,
        unlit: false,
        point_lights: true,
    };
    let rich = SceneFacts {
        counts: TRIANGLES,
        lights: 1,
        environment: true,
        fog: true,
        translucent: TRIANGLES_ALONE,
        looks,
        ..Default::default()
    };
    let edl = Some(EyeDome { strength: 1.0, radius_px: 1.0 });
    let frame = FrameFacts { edl, is_toned: true, ..FrameFacts::default() };
    let why = |scene: &SceneFacts, frame: &FrameFacts| -> Vec<Option<&'static str>> {
        let plan = super::plan(scene, frame, &WIDE);
        let planned = plan.specialisations.iter().map(|planned| planned.specialisation);
        assert!(planned.eq(Specialisation::ALL.iter().copied()));
        plan.specialisations.iter().map(|planned| planned.skipped).collect()
    };
    let count = Specialisation::ALL.len();
    assert_eq!(why(&rich, &frame), vec![None; count]);
    let bare = FrameFacts { edl: None, is_toned: false, ..frame };
    let plain = SceneFacts { lights: 1, translucent: TRIANGLES_ALONE, ..Default::default() };
    assert_eq!(
        why(&plain, &bare),
        [
            "no material has a texture",
            "no material has a map of normals, occlusion, reflection, emitted light or transmission",
            "no material shines, is metallic or rough, gives off light or is unlit, and no node has a material of its own",
            "no material has a highlight of Phong's model",
            "no material has a metallic value or a roughness",
            "no material gives off light",
            "no material transmits light",
            "no light stands at a point",
            "the scene has no environment",
            "the scene has no fog",
            "exposure is 0, and there is no tone map",
            "eye-dome lighting is off",
        ]
        .map(Some)
    );
    let of = |scene: &SceneFacts, frame: &FrameFacts, effect: Specialisation| {
        let at = Specialisation::ALL.iter().position(|&one| one == effect).unwrap();
        why(scene, frame)[at]
    };
    let unlit = SceneFacts { looks: Looks { unlit: true, ..Looks::default() }, ..rich };
    assert_eq!(of(&unlit, &frame, Materials), None);
    let dark = SceneFacts { lights: 0, ..rich };
    for effect in [Materials, Tone] {
        assert_eq!(of(&dark, &frame, effect), Some("the scene has no lights"));
    }
    let solid = SceneFacts { translucent: [false; 3], ..rich };
    assert_eq!(of(&solid, &frame, Transmits), Some("nothing in the scene is translucent"));
    let off = FrameFacts { environment: Effect::Off, fog: Effect::Off, ..frame };
    assert_eq!(of(&rich, &off, Environment), Some("the environment is off"));
    assert_eq!(of(&rich, &off, Fog), Some("fog is off"));
    for (output, has_maps) in [(Output::Depth, false), (Output::Id, false), (Output::Normal, true)]
    {
        let frame = FrameFacts { output, ..frame };
        for effect in [Textures, Maps] {
            let expected = (!has_maps).then_some("the output is depth or id");
            assert_eq!(of(&rich, &frame, effect), expected);
        }
        assert_eq!(of(&rich, &frame, Fog), Some("the output is not color"));
    }
    for &effect in Specialisation::ALL {
        assert_eq!(serde_json::to_value(effect).unwrap(), effect.name());
    }
}

#[test]
fn ambient_occlusion_needs_depths_and_ambient_light_of_its_own() {
    let scene = SceneFacts { counts: SAMPLES, lights: 1, occlusion: true, ..Default::default() };
    let of = |scene: &SceneFacts, frame: FrameFacts| {
        let plan = super::plan(scene, &frame, &WIDE);
        let pass = plan.passes.iter().find(|planned| planned.pass == Pass::AmbientOcclusion);
        let skipped = pass.unwrap().skipped;
        assert_eq!(plan.runs(Pass::WriteOutput), skipped.is_none());
        skipped
    };
    let with = |reconstruction| FrameFacts { reconstruction, ..FrameFacts::default() };
    let splats = Splats::default();
    assert_eq!(of(&scene, with(Reconstruction::Splats(splats))), None);
    assert_eq!(of(&scene, with(POINTS)), None);
    let off = FrameFacts { occlusion: Effect::Off, ..with(POINTS) };
    assert_eq!(of(&scene, off), Some("ambient occlusion is off"));
    let depth = FrameFacts { output: Output::Depth, ..with(POINTS) };
    assert_eq!(of(&scene, depth), Some("the output is not color"));
    let fuzzy = with(Reconstruction::Fuzzy(splats));
    assert!(of(&scene, fuzzy).is_some_and(|why| why.contains("no depths")));
    let singly = with(Reconstruction::Splats(Splats { shading: Shading::Splat, ..splats }));
    assert!(of(&scene, singly).is_some_and(|why| why.contains("one by one")));
    let opaque = Splats { shading: Shading::Splat, blend: Blend::Opaque, ..splats };
    assert_eq!(of(&scene, with(Reconstruction::Splats(opaque))), None);
    let unlit = SceneFacts { lights: 0, ..scene };
    assert_eq!(of(&unlit, singly), None);
    let meshes = SceneFacts { counts: TRIANGLES, ..scene };
    assert_eq!([of(&meshes, fuzzy), of(&meshes, singly)], [None; 2]);
    let plain = SceneFacts { occlusion: false, ..scene };
    assert_eq!(of(&plain, with(POINTS)), Some("the scene has no ambient occlusion"));
}
