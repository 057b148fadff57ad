//! Where the program names settings.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use crate::plan::settings::declared;

/// Most files that may name a setting: its declaration, its values, and two where something depends on it.
const MOST_FILES: usize = 4;
const ROOT: &str = env!("CARGO_MANIFEST_DIR");

/// Parts of the program, by path, without tests.
fn sources() -> BTreeMap<String, String> {
    let mut found = BTreeMap::new();
    let mut folders = ["src", "shaders"].map(|folder| Path::new(ROOT).join(folder)).to_vec();
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_name().unwrap().to_str().unwrap();
            let (stem, extension) = name.split_once('.').unwrap_or((name, ""));
            if stem == "tests" || stem.starts_with("tests_") || stem.ends_with("_tests") {
                continue;
            }
            if path.is_dir() {
                folders.push(path);
            } else if ["rs", "wgsl", "js", "html"].contains(&extension) {
                let text = fs::read_to_string(&path).unwrap();
                let path = path.strip_prefix(ROOT).unwrap().to_str().unwrap();
                found.insert(path.to_owned(), without_tests(&text).to_owned());
            }
        }
    }
    found
}

/// A file's text up to its module of tests, which comes last.
fn without_tests(text: &str) -> &str {
    let ends = ["mod tests {", "pub mod tests {"].map(|module| format!("\n#[cfg(test)]\n{module}"));
    ends.iter().fold(text, |text, end| text.split_once(end.as_str()).map_or(text, |(text, _)| text))
}

/// The rest of the text behind each place where a word stands by itself, with the text before it.
fn places<'a>(text: &'a str, word: &'a str) -> impl Iterator<Item = (&'a str, &'a str)> {
    let belongs = |c: char| c.is_alphanumeric() || c == '_';
    text.match_indices(word).filter_map(move |(at, _)| {
        let (before, after) = (&text[..at], &text[at + word.len()..]);
        (!before.ends_with(belongs) && !after.starts_with(belongs)).then_some((before, after))
    })
}

/// Whether the text before a word ends within the braces of `Settings { … }` or `Given { … }`.
fn is_in_settings(before: &str) -> bool {
    let mut depth = 0;
    for (at, c) in before.char_indices().rev() {
        match c {
            '}' => depth += 1,
            '{' if depth > 0 => depth -= 1,
            '{' => {
                let owner = before[..at].trim_end();
                // `impl Settings {` opens methods.
                let line = owner.rsplit('\n').next().unwrap_or(owner);
                return places(owner, "Settings")
                    .chain(places(owner, "Given"))
                    .any(|(_, after)| after.is_empty())
                    && !line.contains("impl ")
                    && !line.contains("struct ")
                    && !line.contains("-> ");
            }
            ';' if depth == 0 => return false,
            _ => {}
        }
    }
    false
}

/// Whether a text names a setting.
///
/// A name of several words, such as `point_size`, means the setting wherever it stands, in comments too. A name of one word, such as
/// `field` or `blend`, is also a word of English and a name of other things. There, the expressions count that read or write the setting:
/// `settings.blend`, `Settings { blend, … }`, and `$('blend')` or `found.blend` in the viewer. In
/// the declaration the word alone counts, and `self.blend` in methods of the settings.
fn names(path: &str, text: &str, name: &str) -> bool {
    let is_declaration = path == "src/plan/settings.rs";
    let is_method = path.starts_with("src/plan/settings/");
    places(text, name).any(|(before, after)| {
        let is_read = ["settings.", "asked.", "given.", "found."]
            .iter()
            .any(|owner| before.ends_with(owner) && !after.starts_with('('));
        let is_control = before.ends_with("$('") && after.starts_with("')");
        name.contains('_')
            || is_declaration
            || (is_method && before.ends_with("self."))
            || is_read
            || is_control
            || is_in_settings(before)
    })
}

#[test]
fn settings_are_named_in_few_files() {
    let sources = sources();
    assert!(sources.len() > 300 && sources.contains_key("src/plan/settings.rs"));
    let mut too_often = Vec::new();
    for setting in declared() {
        let naming: Vec<&str> = sources
            .iter()
            .filter(|(path, text)| names(path, text, setting.name))
            .map(|(path, _)| path.as_str())
            .collect();
        assert!(naming.contains(&"src/plan/settings.rs"), "{} is not found", setting.name);
        if naming.len() > MOST_FILES {
            too_often.push((setting.name, naming));
        }
    }
    assert!(too_often.is_empty(), "{too_often:#?}");
}

#[test]
fn names_are_found_where_they_mean_settings() {
    for text in ["/// `lod_px` ends.", "x.lod_px", "let lod_px = 1;"] {
        assert!(names("src/a.rs", text, "lod_px"), "{text}");
    }
    for text in ["my_lod_px", "lod_pxs", "lod.px"] {
        assert!(!names("src/a.rs", text, "lod_px"), "{text}");
    }
    for text in [
        "if request.settings.lod == Lod::Spt {",
        "Settings { lod: Lod::Full, ..asked }",
        "let Settings { wait, lod, .. } = settings;",
        "Given {\n    edl: edl(&x { y }),\n    lod,\n}",
        "$('lod').value",
    ] {
        assert!(names("src/a.rs", text, "lod"), "{text}");
    }
    for text in [
        "the lod of a frame",
        "grounds.lod",
        "impl Settings {\n    fn a(lod: Lod) {}\n}",
        "fn a() -> Settings {\n    lod\n}",
        "Settings { wait } ; lod",
    ] {
        assert!(!names("src/a.rs", text, "lod"), "{text}");
    }
    assert!(names("src/plan/settings/values.rs", "self.lod", "lod"));
    assert!(!names("src/plan/settings/values.rs", "/// A frame of lod=spt.", "lod"));
    assert!(!names("src/a.rs", "pub struct Settings {\n    lod: u8,\n}", "lod"));
    assert_eq!(without_tests("a\n#[cfg(test)]\nmod tests {\n    lod\n}\n"), "a");
    assert_eq!(without_tests("a\n#[cfg(test)]\npub mod tests {}"), "a");
}
