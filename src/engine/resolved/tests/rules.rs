//! Two lists say when a setting affects a frame: the rules of settings (`useful_with`), which tags are made by, and the reasons to skip passes. These tests
//! compare both lists over random scenes and settings.

use serde_json::Value;

use super::*;
use crate::plan::{FramePlan, Reconstruct};
use crate::residency::Looks;
use crate::scene::random::SplitMix64;

const ROUNDS: usize = 2000;
/// Settings of each round that are changed.
const CHANGES: usize = 4;
const OUTPUTS: [Output; 4] = [Output::Color, Output::Depth, Output::Normal, Output::Id];
/// A setting with the values that turn an effect on and off, and what shows in the plan of a frame with the effect.
type Switch = (&'static str, [&'static str; 2], fn(&FramePlan) -> bool);
const EFFECTS: [Switch; 8] = [
    ("shadows", ["on", "off"], |plan| plan.runs(Pass::ShadowMap)),
    ("ao", ["on", "off"], |plan| plan.runs(Pass::AmbientOcclusion)),
    ("environment", ["on", "off"], |plan| plan.draws(Specialisation::Environment)),
    ("fog", ["on", "off"], |plan| plan.draws(Specialisation::Fog)),
    ("exposure", ["1", "0"], |plan| plan.draws(Specialisation::Tone)),
    ("edl", ["on", "off"], |plan| plan.draws(Specialisation::Edl)),
    ("antialias", ["4x", "off"], |plan| plan.runs(Pass::Average) || plan.runs(Pass::Accumulate)),
    ("aperture", ["1", "0"], |plan| plan.runs(Pass::Accumulate)),
];

/// Everything that decides a frame beside its settings.
#[derive(Debug)]
struct Ground {
    scene: SceneFacts,
    splats: Splats,
    output: Output,
    /// What `auto` chooses.
    auto: Reconstruct,
    /// The camera moves while a shutter is open.
    moves: bool,
    adapter: AdapterFacts,
}

impl Ground {
    fn random(random: &mut SplitMix64) -> Ground {
        let mut some = || random.chance(0.6);
        let [samples, triangles, segments] = [some(), some(), some()].map(u64::from);
        let lights = u32::from(some());
        let (environment, fog) = (some(), some());
        let scene = SceneFacts {
            counts: Counts { samples, triangles, segments, chunks: 500, ..Counts::default() },
            has_normals: some(),
            lights,
            casting_lights: u32::from(some()) * lights,
            environment,
            shows_environment: environment && some(),
            fog,
            layered_fog: fog && some(),
            occlusion: some(),
            sparse_lines: some(),
            trees: false,
            translucent: [samples > 0 && some(), triangles > 0 && some(), segments > 0 && some()],
            looks: Looks::default(),
        };
        let adapter = AdapterFacts {
            atomics_64: some(),
            atomic_sums_64: some(),
            rasterises: some(),
            draws_hidden: some(),
        };
        let splats = Splats {
            blend: if some() { Blend::Weighted } else { Blend::Opaque },
            shading: if some() { Shading::Deferred } else { Shading::Splat },
            prefilter: some(),
            ..Splats::default()
        };
        let moves = some();
        let autos = [Reconstruct::Points, Reconstruct::Splats, Reconstruct::PullPush];
        let auto = autos[random.index(autos.len())];
        Ground { scene, splats, output: OUTPUTS[random.index(4)], auto, moves, adapter }
    }

    /// The frame as the engine decides it.
    fn frame(&self, given: &Given) -> Drawing {
        let asked = given.resolve().unwrap();
        let scene = SceneFacts { trees: asked.draws_trees(), ..self.scene };
        let decided = if asked.leaves_drawing_open() { self.auto } else { asked.reconstruct };
        let settings = asked
            .decided(decided)
            .with_blur_decided(self.output, self.moves)
            .with_antialias_decided(self.output)
            .with_edl_decided(&scene, self.output)
            .with_line_width_decided(&scene);
        let reconstruction = Reconstruction::new(&settings, &self.splats);
        let facts = (&scene, &self.adapter);
        Drawing::new(&settings, reconstruction, facts, self.output, |_| None, None)
    }
}

/// The settings without those that do not go with the others.
fn allowed(mut given: Given) -> Given {
    while let Err(error) = given.resolve() {
        given.set(error.setting, Value::Null).unwrap();
    }
    given
}

/// Gives a setting one of its values, or none. Goals have no passes: the engine replaces them by settings.
fn change(given: &mut Given, setting: &Setting, random: &mut SplitMix64) {
    let values = values(setting);
    given.set(setting.name, Value::Null).unwrap();
    if !["budget_ms", "min_psnr_db"].contains(&setting.name) && random.chance(0.7) {
        given.set_text(setting.name, &values[random.index(values.len())]).unwrap();
    }
}

fn random_given(random: &mut SplitMix64) -> Given {
    let mut given = Given::default();
    for setting in plan::declared() {
        if random.chance(0.4) {
            change(&mut given, setting, random);
        }
    }
    allowed(given)
}

/// Frames of equal settings have one tag, so they must have the same passes.
#[test]
fn settings_that_change_the_passes_change_the_tag() {
    let mut random = SplitMix64::new(2);
    let mut changed = 0;
    for _ in 0..ROUNDS {
        let (ground, given) = (Ground::random(&mut random), random_given(&mut random));
        let before = ground.frame(&given);
        for _ in 0..CHANGES {
            let setting = &plan::declared()[random.index(plan::declared().len())];
            let mut other = given;
            change(&mut other, setting, &mut random);
            let after = ground.frame(&allowed(other));
            if before.plan != after.plan {
                changed += 1;
                let [one, two] = [&before, &after].map(|drawing| drawing.applied.bytes());
                assert_ne!(one, two, "{}: {ground:?} {given:?} {other:?}", setting.name);
            }
        }
    }
    assert!(changed > ROUNDS / 10, "{changed} changes of passes say little");
}

/// An effect is in the tag where its pass runs, and nowhere else: otherwise one picture would have two tags.
#[test]
fn effects_are_in_the_tag_where_their_pass_runs() {
    let mut random = SplitMix64::new(3);
    let mut seen = [[0; 2]; EFFECTS.len()];
    for round in 0..ROUNDS {
        let (ground, given) = (Ground::random(&mut random), random_given(&mut random));
        let number = round % EFFECTS.len();
        let (name, values, is_drawn) = EFFECTS[number];
        let [on, off] = values.map(|value| {
            let mut given = given;
            given.set(name, Value::Null).unwrap();
            given.set_text(name, value).unwrap();
            ground.frame(&allowed(given))
        });
        let is_tagged = on.applied.bytes() != off.applied.bytes();
        assert_eq!(is_tagged, is_drawn(&on.plan), "{name}: {ground:?} {given:?}");
        seen[number][usize::from(is_tagged)] += 1;
    }
    // Each effect was drawn, and left out.
    assert!(seen.as_flattened().iter().all(|count| *count > 5), "{seen:?}");
}
