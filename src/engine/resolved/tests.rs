mod rules;

use glam::{DAffine3, DVec3};

use super::*;
use crate::bake::pack::Counts;
use crate::plan::{self, AdapterFacts, Given, Output, SceneFacts, Setting, SettingKind};
use crate::scene::{Blend, Shading, Splats};

fn drawing(settings: &Settings) -> Drawing {
    drawing_of(Counts { samples: 1, segments: 1, chunks: 1, ..Counts::default() }, settings)
}

fn drawing_of(counts: Counts, settings: &Settings) -> Drawing {
    let scene = SceneFacts {
        counts,
        lights: 1,
        casting_lights: 1,
        environment: true,
        fog: true,
        occlusion: true,
        trees: true,
        ..Default::default()
    };
    let adapter = AdapterFacts::default();
    let box_from_world = DAffine3::IDENTITY;
    let clip = settings.clip_boxes.map(|boxes| ClipRegion { boxes, box_from_world });
    let recolor = |settings: &Settings| settings.recolor(DVec3::Y, || [0.0, 1.0], &[]);
    let reconstruction = Reconstruction::new(settings, &Splats::default());
    Drawing::new(settings, reconstruction, (&scene, &adapter), Output::Color, recolor, clip)
}

/// Some values of a setting.
fn values(setting: &Setting) -> Vec<String> {
    match &setting.kind {
        SettingKind::Choice { choices, .. } => {
            choices.iter().map(|choice| choice.value.clone()).collect()
        }
        SettingKind::Flag => vec!["true".to_owned(), "false".to_owned()],
        SettingKind::Text { examples, .. } => examples.iter().map(ToString::to_string).collect(),
        SettingKind::Number { least, most, .. } => vec![least.to_string(), most.to_string()],
    }
}

/// A task takes its settings from the first job of a group, whose members have equal drawings.
#[test]
fn drawings_of_different_settings_differ() {
    for setting in plan::declared() {
        let values = values(setting);
        let mut needed = Given::default();
        for rule in &setting.needs {
            let is_number = [Settings::LENS, Settings::EYE].contains(&rule.of);
            let any = if is_number { "1" } else { "0,0,0,1,1,1" };
            needed.set_text(rule.of, rule.is.first().copied().unwrap_or(any)).unwrap();
        }
        if setting.useful_with.iter().any(|rule| rule.of == "blur") {
            needed.set_text(Settings::LENS, "1").unwrap();
        }
        let drawings = values.iter().map(|value| {
            let mut given = needed;
            given.set_text(setting.name, value).unwrap();
            drawing(&given.resolve().unwrap())
        });
        let drawings: Vec<Drawing> = drawings.collect();
        for (index, one) in drawings.iter().enumerate() {
            assert!(!drawings[..index].contains(one), "{}={}", setting.name, values[index]);
        }
    }
}

#[test]
fn settings_without_effect_leave_drawings_equal() {
    let points = Settings::drawn_as(plan::Reconstruct::Points);
    let fine = Settings { max_error_px: 0.5.into(), ..points };
    assert_eq!(drawing(&fine), drawing(&points), "full detail accepts no error");
    let trees = |settings: Settings| drawing(&Settings { lod: plan::Lod::Spt, ..settings });
    assert_ne!(trees(fine), trees(points));
}

/// One picture has one tag.
#[test]
fn ambient_occlusion_is_a_setting_of_frames_that_can_have_it() {
    let samples = Counts { samples: 1, chunks: 1, ..Counts::default() };
    let meshes = Counts { triangles: 1, chunks: 1, ..Counts::default() };
    let splats = |blend, shading| Settings {
        blend: Some(blend),
        shading: Some(shading),
        ..Settings::drawn_as(plan::Reconstruct::Splats)
    };
    for (settings, has) in [
        (Settings::drawn_as(plan::Reconstruct::Points), true),
        (Settings::drawn_as(plan::Reconstruct::PullPush), true),
        (Settings::drawn_as(plan::Reconstruct::Fuzzy), false),
        (Settings::drawn_as(plan::Reconstruct::Painted), false),
        (splats(Blend::Weighted, Shading::Deferred), true),
        (splats(Blend::Weighted, Shading::Splat), false),
        (splats(Blend::Opaque, Shading::Splat), true),
    ] {
        for (counts, has) in [(samples, has), (meshes, true)] {
            let with = drawing_of(counts, &settings);
            let without = drawing_of(counts, &Settings { ao: plan::Effect::Off, ..settings });
            assert_eq!(with.plan.runs(Pass::AmbientOcclusion), has, "{settings:?}");
            assert_eq!((with != without, without.applied.ao.is_some()), (has, has), "{settings:?}");
        }
    }
}

/// Films draw all frames as the first one was decided.
#[test]
fn how_samples_are_drawn_stays_decided_where_there_are_none() {
    let counts = Counts { triangles: 1, chunks: 1, ..Counts::default() };
    let drawing = drawing_of(counts, &Settings::drawn_as(plan::Reconstruct::Points));
    assert!(!drawing.settings.leaves_drawing_open());
    assert!(drawing.applied.reconstruct.is_none(), "it has no effect");
}
