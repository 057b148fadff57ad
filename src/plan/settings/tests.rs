mod names;

use super::*;
use crate::bake::pack::Counts;
use crate::plan::SceneFacts;
use serde_json::json;

fn given(query: &str) -> Given {
    let mut given = Given::default();
    for pair in query.split('&').filter(|pair| !pair.is_empty()) {
        let (name, value) = pair.split_once('=').unwrap();
        given.set_text(name, value).unwrap();
    }
    given
}

/// A value of a setting that is not its default, with what it needs beside it.
fn other_value(setting: &Setting) -> Given {
    let value = match &setting.kind {
        SettingKind::Choice { choices, default } => {
            let other = choices.iter().find(|choice| Some(&choice.value) != default.as_ref());
            other.unwrap().value.clone()
        }
        SettingKind::Flag => "false".to_owned(),
        SettingKind::Text { examples, .. } => examples[0].to_owned(),
        SettingKind::Number { least, most, default, .. } => {
            if Some(*least) == *default { most } else { least }.to_string()
        }
    };
    let mut given = Given::default();
    for rule in &setting.needs {
        let is_number =
            matches!(declaration(rule.of).map(|of| &of.kind), Some(SettingKind::Number { .. }));
        let any = if is_number { "1" } else { "0,0,0,1,1,1" };
        given.set_text(rule.of, rule.is.first().copied().unwrap_or(any)).unwrap();
    }
    if setting.useful_with.contains(&BLURRED) {
        given.set_text("aperture", "1").unwrap();
    }
    given.set_text(setting.name, &value).unwrap();
    given
}

/// Tags, cost estimates and receipts are made of the canonical form: a setting that is not in it would be lost in all of them.
#[test]
fn every_setting_has_a_say_in_the_canonical_form() {
    let counts = Counts { samples: 1, segments: 1, ..Counts::default() };
    let scene = SceneFacts {
        counts,
        lights: 1,
        casting_lights: 1,
        environment: true,
        fog: true,
        occlusion: true,
        ..SceneFacts::default()
    };
    for setting in declared() {
        let other = other_value(setting);
        let mut without = other;
        without.set(setting.name, Value::Null).unwrap();
        let [with, without] = [other, without].map(|given| given.resolve().unwrap());
        assert_ne!(with, without, "{}", setting.name);
        let bytes = |settings: &Settings| settings.affecting(&scene, Output::Color).bytes();
        assert_ne!(bytes(&with), bytes(&without), "{}", setting.name);
        assert_eq!(Settings::from(with.applied()), with, "{}", setting.name);
        // In each notation the same.
        let json = serde_json::to_value(other).unwrap();
        assert_eq!(serde_json::from_value::<Given>(json).unwrap(), other);
        let query: Vec<String> =
            other.pairs().iter().map(|(name, value)| format!("{name}={value}")).collect();
        assert_eq!(given(&query.join("&")), other);
    }
}

#[test]
fn declarations_are_complete() {
    let names: Vec<&str> = declared().iter().map(|setting| setting.name).collect();
    assert_eq!(names, Given::NAMES);
    let used = words(&Settings::default());
    assert!(names.iter().all(|name| used.contains_key(*name)) && used.len() == names.len());
    for setting in declared() {
        assert!(setting.help.ends_with('.') && !setting.help.contains("  "), "{}", setting.help);
        for rule in setting.needs.iter().chain(&setting.useful_with) {
            let kind = declaration(rule.of).map(|setting| &setting.kind);
            let Some(SettingKind::Choice { choices, .. }) = kind else {
                // Any text or number will do.
                let is_text =
                    matches!(kind, Some(SettingKind::Text { .. } | SettingKind::Number { .. }));
                let is_fact = [
                    "output",
                    "samples",
                    "segments",
                    "lights",
                    "casting_lights",
                    "scene_environment",
                    "scene_fog",
                    "scene_occlusion",
                    "occludable",
                    "blur",
                    "fields",
                ]
                .contains(&rule.of);
                assert!(is_text || is_fact, "{}", rule.of);
                assert!(!is_text || rule.is.is_empty(), "{}", rule.of);
                continue;
            };
            let is_value = |value: &&str| choices.iter().any(|choice| choice.value == *value);
            assert!(rule.is.iter().all(is_value), "{}", setting.name);
        }
        if let SettingKind::Choice { choices, .. } = &setting.kind {
            assert!(choices.iter().all(|choice| !choice.help.is_empty()), "{}", setting.name);
        }
    }
}

#[test]
fn colours_by_a_field_are_offered_where_the_scene_has_it() {
    let Some(Setting { kind: SettingKind::Choice { choices, .. }, useful_with, .. }) =
        declaration("color_by")
    else {
        panic!("it has choices");
    };
    for Choice { value, .. } in choices {
        let chosen = Settings::from(given(&format!("color_by={value}&field=height")));
        let is_of_value = |rule: &&Rule| rule.of == "fields" && rule.value == Some(value.as_str());
        let rules: Vec<&Rule> = useful_with.iter().filter(is_of_value).collect();
        let shown = chosen.colored_field();
        assert_eq!(rules.len(), usize::from(shown.is_some()), "{value}");
        // The field is another setting's to name.
        let named = shown.as_ref().map(Name::as_str).filter(|name| *name != "height");
        assert_eq!(rules.first().and_then(|rule| rule.is.first().copied()), named, "{value}");
    }
}

#[test]
fn what_does_not_go_together_is_refused() {
    let refused = |query: &str| {
        let error = given(query).resolve().unwrap_err();
        (error.setting, error.accepted(|name, value| format!("{name}={value}")))
    };
    assert_eq!(
        refused("error_mode=split"),
        (
            "error_mode",
            "`unified`, or another value with `lod=spt` and `reconstruct=splats`, `fuzzy`, `painted` or `auto`"
                .to_owned()
        )
    );
    assert_eq!(
        refused("lod=full&max_error_px=2").1,
        "no value, or a value together with `lod=spt`"
    );
    assert_eq!(refused("lod=spt&max_error_px=65").1, "0.05 to 64 pixels");
    // A setting that changes nothing is no fault.
    for harmless in ["error_mode=unified", "color_by=colors", "lod=full&reconstruct=auto"] {
        assert_eq!(given(harmless).resolve().unwrap(), Settings::default());
    }
    // An error alone is that of point trees.
    assert_eq!(given("max_error_px=2").resolve(), given("lod=spt&max_error_px=2").resolve());
    let upside_down = given("color_by=height&color_least=5&color_most=5").resolve().unwrap_err();
    assert_eq!(upside_down.to_string(), "color_most: 5 is not above color_least, 5");
    assert_eq!(upside_down.accepted(|_, _| String::new()), "a value above 5");
    let mut huge = given("lod=spt");
    huge.set("max_error_px", json!(1e300)).unwrap();
    assert_eq!(huge.resolve().unwrap_err().setting, "max_error_px");
    assert!(Given::default().set("max_errors", json!(1)).is_err());
}

#[test]
fn a_number_of_exposures_needs_blur() {
    for query in ["blur_samples=64", "blur_samples=64&aperture=0", "blur_samples=4&shutter=0"] {
        let refused = given(query).resolve().unwrap_err();
        let accepted = refused.accepted(|_, _| String::new());
        assert_eq!(refused.setting, "blur_samples", "{query}");
        assert!(accepted.contains("an aperture or a shutter above 0"), "{accepted}");
    }
    for query in ["blur_samples=32", "blur_samples=64&aperture=0.1", "blur_samples=4&shutter=0.5"] {
        assert!(given(query).resolve().is_ok(), "{query}");
    }
    let defaults = given("aperture=0.1&blur_samples=64");
    assert_eq!(given("").or(&defaults), defaults);
    assert_eq!(given("aperture=0").or(&defaults), given("aperture=0"));
    // A fault of the defaults alone is told of.
    assert!(given("").or(&given("blur_samples=64")).resolve().is_err());
}

#[test]
fn settings_without_meaning_are_not_inherited() {
    let defaults = given(
        "lod=spt&max_error_px=4&color_by=levels&reconstruct=splats&blend=opaque&filter=exact",
    );
    assert_eq!(given("").or(&defaults), defaults);
    assert_eq!(
        given("lod=full").or(&defaults),
        given("lod=full&reconstruct=splats&blend=opaque&filter=exact")
    );
    let points = given("reconstruct=points").or(&defaults);
    assert_eq!(points, given("lod=spt&max_error_px=4&color_by=levels&reconstruct=points"));
    let fuzzy = given("reconstruct=fuzzy").or(&defaults);
    assert_eq!((fuzzy.blend, fuzzy.filter), (None, Some(Filter::Exact)));
    // A fault of the defaults alone is told of.
    assert!(given("").or(&given("color_by=levels")).resolve().is_err());
}

#[test]
fn backgrounds_are_read_as_they_are_written() {
    for (text, written) in [
        ("transparent", "transparent"),
        ("#00000000", "transparent"),
        ("fff", "#ffffff"),
        ("000000", "#000000"),
        ("#20242880", "#20242880"),
    ] {
        let background = given(&format!("background={text}")).background.unwrap();
        assert_eq!(background.to_string(), written);
        assert_eq!(given(&format!("background={written}")).background, Some(background));
    }
    let refused = Given::default().set_text("background", "blue").unwrap_err();
    assert_eq!(refused.accepted(|_, _| String::new()), "transparent, #rgb, #rrggbb or #rrggbbaa");
}

/// Limits are checked before numbers are rounded to 32 bits, and numbers are told as they were given.
#[test]
fn numbers_are_checked_as_they_are_written() {
    for (query, setting) in [
        ("color_by=height&color_most=1000000001", "color_most"),
        ("point_size=1000000001", "point_size"),
        ("lod=spt&max_error_px=64.000001", "max_error_px"),
    ] {
        assert_eq!(given(query).resolve().unwrap_err().setting, setting);
    }
    let settings = given("color_by=height&color_least=5653000.125&edl=on&edl_strength=0.7");
    let applied = settings.resolve().unwrap().applied();
    assert_eq!(
        (applied.color_least, applied.edl_strength),
        (Some(ColorBound::from(5_653_000.125)), Some(0.7))
    );
}

#[test]
fn boxes_of_a_node_need_boxes() {
    let clipped = given("clip_boxes=0,0,0,1,1,1;outside:*,*,*,*,*,0.5&clip_node=tower");
    let settings = clipped.resolve().unwrap();
    assert_eq!(settings.clip_boxes.unwrap().boxes().len(), 2);
    assert_eq!(settings.clip_node.unwrap().as_str(), "tower");
    let refused = given("clip_node=tower").resolve().unwrap_err();
    assert_eq!(refused.to_string(), "clip_node: there are no clip boxes");
    let accepted = refused.accepted(|name, value| format!("{name}={value}"));
    assert_eq!(accepted, "no value, or a value together with `clip_boxes=…`");
    let refused = Given::default().set_text("clip_boxes", "0,0,0,1,1").unwrap_err();
    assert_eq!(refused.to_string(), "clip_boxes: box 1 has 5 numbers instead of 6");
}

#[test]
fn eye_dome_light_is_for_samples_without_normals_and_light() {
    let counts = Counts { samples: 1, ..Counts::default() };
    let scan = SceneFacts { counts, ..SceneFacts::default() };
    let used = |query: &str, scene| {
        let settings = given(query).resolve().unwrap();
        assert_eq!(settings.with_edl_decided(&scene, Output::Depth).eye_dome(), None);
        settings.with_edl_decided(&scene, Output::Color).eye_dome().is_some()
    };
    assert!(used("", scan) && used("edl=on", scan) && !used("edl=off", scan));
    for other in [
        SceneFacts { has_normals: true, ..scan },
        SceneFacts { lights: 1, ..scan },
        SceneFacts { counts: Counts { triangles: 1, ..counts }, ..scan },
        SceneFacts::default(),
    ] {
        assert!(!used("", other) && used("edl=on", other) && !used("edl=off", other));
    }
    assert!(!used("reconstruct=fuzzy", scan) && used("reconstruct=fuzzy&edl=on", scan));
}

/// The page of the docs that the declarations make.
fn page() -> String {
    let mut page = String::from(
        "# Settings of a frame\n\n\
         How a frame is drawn. Settings are parameters of a frame (`?lod=spt`), fields of a JSON body, of a message of a stream and of a job \
         (`\"lod\": \"spt\"`), and options of `render`, `pick`, `path` and `load` (`--lod spt`; `_` becomes `-`). The viewer has a control for each. \
         `GET /v1/settings` serves the same list as JSON. The receipt of a frame names the settings that affected it.\n\n\
         A setting that needs another is refused without it, unless its value is the default of a choice.\n\n\
         | setting | values | default | needs | meaning |\n|---|---|---|---|---|\n",
    );
    for setting in declared() {
        let (values, default) = match &setting.kind {
            SettingKind::Choice { choices, default } => {
                let values: Vec<String> =
                    choices.iter().map(|choice| format!("`{}`", choice.value)).collect();
                (values.join(", "), default.as_ref().map(|value| format!("`{value}`")))
            }
            SettingKind::Flag => ("`true`, `false`".to_owned(), None),
            SettingKind::Text { accepted, default, .. } => {
                ((*accepted).to_owned(), Some((*default).to_owned()))
            }
            SettingKind::Number { default, absent, .. } => {
                let default = default.map_or((*absent).to_owned(), |default| default.to_string());
                (setting.kind.accepted(), Some(default))
            }
        };
        let default = default.unwrap_or_else(|| "the scene’s".to_owned());
        let needs = setting.needs_in_words(|name, value| format!("{name}={value}"));
        let needs = needs.unwrap_or_default();
        let Setting { name, help, .. } = setting;
        page += &format!("| `{name}` | {values} | {default} | {needs} | {help} |\n");
    }
    page += "\n## Values\n\n| setting | value | meaning |\n|---|---|---|\n";
    for setting in declared() {
        let SettingKind::Choice { choices, .. } = &setting.kind else { continue };
        for Choice { value, help } in choices {
            page += &format!("| `{}` | `{value}` | {help} |\n", setting.name);
        }
    }
    page + "\nSee also [Choose a level of detail](level-of-detail.md) and [Draw samples as splats](splats.md).\n"
}

/// `UPDATE=1` writes the page anew.
#[test]
fn the_docs_list_what_is_declared() {
    let file = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/settings.md");
    if std::env::var_os("UPDATE").is_some() {
        std::fs::write(&file, page()).unwrap();
    }
    assert_eq!(std::fs::read_to_string(file).unwrap(), page(), "UPDATE=1 writes it anew");
}

#[test]
fn a_bound_beyond_the_scene_keeps_the_direction_of_the_map() {
    let range = |bounds: &[(&str, &str)], heights: [f64; 2]| {
        let mut given = Given::default();
        given.set_text("color_by", "height").unwrap();
        for (name, value) in bounds {
            given.set_text(name, value).unwrap();
        }
        let settings = given.resolve().unwrap();
        match settings.recolor(glam::DVec3::Y, || heights, &[]) {
            Some(crate::scene::recolor::Recolor::Height { range, .. }) => range,
            other => panic!("{other:?}"),
        }
    };
    assert_eq!(range(&[], [2.0, 10.0]), [2.0, 10.0]);
    assert_eq!(range(&[("color_least", "4")], [2.0, 10.0]), [4.0, 10.0]);
    assert_eq!(range(&[("color_least", "20")], [2.0, 10.0]), [20.0, 28.0]);
    assert_eq!(range(&[("color_most", "-1")], [2.0, 10.0]), [-9.0, -1.0]);
    assert_eq!(range(&[("color_most", "2")], [2.0, 2.0]), [1.0, 2.0]);
    assert_eq!(range(&[("color_least", "1"), ("color_most", "9")], [2.0, 3.0]), [1.0, 9.0]);
}

/// Settings that compare as different give equal frames different tags, and the planner promises nothing for them.
#[test]
fn both_zeros_are_the_same_value() {
    let mut compared = 0;
    for setting in declared() {
        let SettingKind::Number { least, .. } = setting.kind else { continue };
        if least > 0.0 {
            continue;
        }
        let with = |zero: f64| {
            let mut given = Given::default();
            given.set(setting.name, zero.into()).unwrap();
            Settings::from(given)
        };
        assert_eq!(with(-0.0), with(0.0), "{}", setting.name);
        compared += 1;
    }
    assert!(compared > 5, "{compared} numbers may be 0");
    // Options of the command line are read from text.
    assert_eq!("-0".parse::<ColorBound>(), Ok(ColorBound::from(0.0)));
}
