//! Rules for names in uploads, and what follows from the names.
//!
//! Names are refused, not repaired: a repaired one would no longer be the one that a scene mentions.

use axum::http::{HeaderMap, header};

use super::problem::{Kind, Problem};

/// Longest id of a scene.
const MAX_ID_BYTES: usize = 64;
/// [`valid_id`] as a regular expression.
pub const ID_PATTERN: &str = "^[a-z0-9_-]{1,64}$";
/// Longest name of an uploaded file.
pub const MAX_FILE_NAME_BYTES: usize = 128;
/// [`valid_file_name`] as a regular expression, without the limit on length.
pub const FILE_NAME_PATTERN: &str = r#"^[^./\\:*?"<>|\x00-\x1f\x7f-\x9f]([^/\\:*?"<>|\x00-\x1f\x7f-\x9f]*[^./\\:*?"<>| \x00-\x1f\x7f-\x9f])?$"#;

/// Checks an id that a client chose.
pub fn valid_id(id: String) -> Result<String, Problem> {
    let good = |c: u8| c.is_ascii_lowercase() || c.is_ascii_digit() || c == b'-' || c == b'_';
    if (1..=MAX_ID_BYTES).contains(&id.len()) && id.bytes().all(good) {
        return Ok(id);
    }
    Err(Problem::parameter("id", "is not a valid id", "1 to 64 of a-z, 0-9, - and _"))
}

/// Checks the name of a file in an upload's folder. A bad name is refused, not repaired: a repaired name
/// would no longer be the one that the scene mentions.
pub fn valid_file_name(name: &str) -> Result<String, Problem> {
    let fail = |reason: &str| {
        let shown: String = name.chars().take(64).collect();
        Err(Problem::parameter(
            "name",
            format!("`{}` {reason}", shown.escape_debug()),
            "a plain file name of at most 128 bytes without folders, not beginning with a dot",
        ))
    };
    if name.is_empty() || name.len() > MAX_FILE_NAME_BYTES {
        return fail("has no usable length");
    }
    if name.starts_with('.') {
        return fail("begins with a dot");
    }
    if name.ends_with(['.', ' ']) {
        return fail("ends with a dot or a space");
    }
    if name.chars().any(|c| c.is_control() || "/\\:*?\"<>|".contains(c)) {
        return fail("contains a character that is not allowed in file names");
    }
    Ok(name.to_owned())
}

/// Latin letters with marks and ligatures, and how an id spells them.
const LATIN: [(&str, &str); 23] = [
    ("àáâãäåāăą", "a"),
    ("æ", "ae"),
    ("çćĉċč", "c"),
    ("ďđð", "d"),
    ("èéêëēĕėęě", "e"),
    ("ĝğġģ", "g"),
    ("ĥħ", "h"),
    ("ìíîïĩīĭįı", "i"),
    ("ĵ", "j"),
    ("ķ", "k"),
    ("ĺļľŀł", "l"),
    ("ñńņňŋ", "n"),
    ("òóôõöøōŏő", "o"),
    ("œ", "oe"),
    ("ŕŗř", "r"),
    ("śŝşšș", "s"),
    ("ß", "ss"),
    ("ţťŧț", "t"),
    ("þ", "th"),
    ("ùúûüũūŭůűų", "u"),
    ("ŵ", "w"),
    ("ýÿŷ", "y"),
    ("źżž", "z"),
];
/// Combining marks, which some systems write behind their letters.
const MARKS: std::ops::RangeInclusive<char> = '\u{300}'..='\u{36f}';

/// Makes an id from a file's name: lower-case letters without marks, digits and underscores, with hyphens for everything between
/// them; `scene` where nothing is left.
pub fn slug(name: &str) -> String {
    let stem = name.rsplit_once('.').map_or(name, |(stem, _)| stem);
    let mut slug = String::new();
    for c in stem.chars().flat_map(char::to_lowercase).filter(|c| !MARKS.contains(c)) {
        if c.is_ascii_alphanumeric() || c == '_' {
            slug.push(c);
        } else if let Some((_, plain)) = LATIN.iter().find(|(marked, _)| marked.contains(c)) {
            slug += plain;
        } else if !slug.ends_with('-') && !slug.is_empty() {
            slug.push('-');
        }
    }
    slug.truncate(56);
    let slug = slug.trim_end_matches('-');
    if slug.is_empty() { "scene".to_owned() } else { slug.to_owned() }
}

/// Returns whether a file of this name is a scene.
pub fn is_json_name(name: &str) -> bool {
    name.to_ascii_lowercase().ends_with(".json")
}

/// Returns the file name in `Content-Disposition`, if any.
pub fn disposition_name(headers: &HeaderMap) -> Result<Option<String>, Problem> {
    let Some(value) = headers.get(header::CONTENT_DISPOSITION) else { return Ok(None) };
    let value = String::from_utf8_lossy(value.as_bytes());
    let Some((_, rest)) = value.split_once("filename=") else { return Ok(None) };
    let name = match rest.strip_prefix('"') {
        Some(quoted) => quoted.split('"').next().unwrap_or_default(),
        None => rest.split(';').next().unwrap_or_default().trim(),
    };
    valid_file_name(name).map(Some)
}

/// Extensions of files that belong to other files and are no scene by themselves.
pub const COMPANIONS: [&str; 11] =
    ["mtl", "png", "jpg", "jpeg", "webp", "bmp", "tga", "bin", "gif", "hdr", "txt"];

/// Chooses the file to load: the one named, else the scene, else the only file that is not a
/// companion of another.
pub fn main_file(names: &[String], named: Option<&str>) -> Result<String, Problem> {
    const ACCEPTED: &str =
        "?name= of the file to load, or one scene, or one asset with its companions";
    if let Some(named) = named {
        return match names.iter().find(|name| *name == named) {
            Some(name) => Ok(name.clone()),
            None => Err(Problem::parameter(
                "name",
                format!("there is no file `{named}` in the form"),
                names.join(", "),
            )),
        };
    }
    let is_companion = |name: &str| {
        name.rsplit_once('.').is_some_and(|(_, extension)| {
            COMPANIONS.contains(&extension.to_ascii_lowercase().as_str())
        })
    };
    let scenes: Vec<&String> = names.iter().filter(|name| is_json_name(name)).collect();
    let assets: Vec<&String> = names.iter().filter(|name| !is_companion(name)).collect();
    match (&scenes[..], &assets[..], names) {
        ([only], _, _) | ([], [only], _) => Ok((*only).clone()),
        ([], [], [only]) => Ok(only.clone()),
        ([], [], []) => {
            Err(Problem::new(Kind::BadBody, "the form contains no file").accepted(ACCEPTED))
        }
        (candidates, _, _) if candidates.len() > 1 => Err(several(candidates)),
        (_, assets, _) if !assets.is_empty() => Err(several(assets)),
        _ => Err(several(&names.iter().collect::<Vec<_>>())),
    }
}

/// Builds the problem for a form in which several files could be the one to load.
fn several(files: &[&String]) -> Problem {
    const MOST_SHOWN: usize = 4;
    let shown: Vec<String> =
        files.iter().take(MOST_SHOWN).map(|name| format!("`{name}`")).collect();
    let more = match files.len().saturating_sub(MOST_SHOWN) {
        0 => String::new(),
        more => format!(" and {more} more"),
    };
    let reason =
        format!("each of {}{more} could be loaded, and one upload is one scene", shown.join(", "));
    let first = files.first().map_or("FILE", |name| name.as_str());
    let accepted = format!(
        "one of them at a time, `?name={first}` to load it and keep the others beside it, or a scene (JSON) that names them all"
    );
    Problem::parameter("name", reason, accepted)
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::http::HeaderValue;

    #[test]
    fn ids() {
        for good in ["a", "plaza-2_b", &"x".repeat(64)] {
            assert!(valid_id(good.to_owned()).is_ok(), "{good}");
        }
        for bad in ["", "A", "a/b", "..", "a b", &"x".repeat(65)] {
            assert!(valid_id(bad.to_owned()).is_err(), "{bad}");
        }
    }

    #[test]
    fn file_names_lead_nowhere() {
        for good in ["a.ply", "Stanford bunny (1).ply", "größe.obj"] {
            assert_eq!(valid_file_name(good).unwrap(), good);
        }
        for bad in [
            "", ".", "..", ".hidden", "../a.ply", "a/b.ply", "a\\b.ply", "C:a.ply", "a\0.ply",
            "a.", "a\n",
        ] {
            assert_eq!(valid_file_name(bad).unwrap_err().status(), 422, "{bad:?}");
        }
        assert!(valid_file_name(&"x".repeat(129)).is_err());
    }

    #[test]
    fn slugs_are_valid_ids() {
        assert_eq!(slug("Stanford Bunny (1).ply"), "stanford-bunny-1");
        assert_eq!(slug("Größe.obj"), "grosse");
        assert_eq!(slug("Öffentlicher Löwe 獅子.ply"), "offentlicher-lowe");
        assert_eq!(slug("Cafe\u{301} no\u{308}el.ply"), "cafe-noel", "as macOS writes it");
        assert_eq!(slug("日本.ply"), "scene");
        for name in ["a.b.ply", "---", "İstanbul.ply", &"long name ".repeat(20), &"ß".repeat(60)]
        {
            assert!(valid_id(slug(name)).is_ok(), "{name}");
        }
    }

    #[test]
    fn names_in_content_disposition() {
        let name = |value: &str| {
            let mut headers = HeaderMap::new();
            headers.insert(header::CONTENT_DISPOSITION, HeaderValue::from_str(value).unwrap());
            disposition_name(&headers).map_err(|problem| problem.status())
        };
        assert_eq!(name("attachment; filename=\"a b.ply\"; x=1"), Ok(Some("a b.ply".into())));
        assert_eq!(name("attachment; filename=a.ply"), Ok(Some("a.ply".into())));
        assert_eq!(name("attachment"), Ok(None));
        assert_eq!(name("attachment; filename=\"../a.ply\""), Err(422));
    }

    #[test]
    fn the_file_to_load() {
        let pick = |names: &[&str], named| {
            let names: Vec<String> = names.iter().map(|name| (*name).to_owned()).collect();
            main_file(&names, named).map_err(|problem| problem.status())
        };
        assert_eq!(pick(&["a.obj", "a.mtl", "wood.PNG"], None), Ok("a.obj".into()));
        assert_eq!(pick(&["a.ply", "s.json", "b.ply"], None), Ok("s.json".into()));
        assert_eq!(pick(&["points.txt"], None), Ok("points.txt".into()));
        assert_eq!(pick(&["a.ply", "b.ply"], Some("b.ply")), Ok("b.ply".into()));
        assert_eq!(pick(&["a.ply", "b.ply"], None), Err(422));
        assert_eq!(pick(&["a.ply"], Some("c.ply")), Err(422));
        assert_eq!(pick(&[], None), Err(422));
    }

    #[test]
    fn who_drops_several_files_is_told_which() {
        let told = |names: &[&str]| {
            let names: Vec<String> = names.iter().map(|name| (*name).to_owned()).collect();
            let problem = main_file(&names, None).unwrap_err();
            (problem.detail, problem.accepted.unwrap_or_default())
        };
        let (detail, accepted) = told(&["bunny.ply", "lion.obj", "lion.mtl"]);
        assert!(detail.contains("each of `bunny.ply`, `lion.obj` could be loaded"), "{detail}");
        assert!(accepted.contains("?name=bunny.ply"), "{accepted}");
        assert!(told(&["a.json", "b.json", "c.ply"]).0.contains("`a.json`, `b.json` could"));
        assert!(told(&["a.png", "b.png"]).0.contains("`a.png`, `b.png`"));
        let many: Vec<String> = (0..9).map(|number| format!("{number}.ply")).collect();
        let many: Vec<&str> = many.iter().map(String::as_str).collect();
        assert!(told(&many).0.contains("`3.ply` and 5 more could"), "{}", told(&many).0);
    }
}
