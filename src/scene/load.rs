//! Bytes → [`Scene`]: size limits, JSON, the files that a scene names.
//!
//! JSON is read straight into the structures of [`super::wire`] by serde_json; serde_path_to_error
//! keeps track of the place, so that both syntax and type errors name their path. Files are
//! canonicalised before they are compared with the root: neither `..` nor a symbolic link leads out.

use std::fs::File;
use std::io::Read;
use std::path::{Component, Path, PathBuf};

use glam::DVec3;
use serde::de::DeserializeOwned;

use super::validate::{self, Reason};
use super::wire::{NodeWire, Object, PathWire, SceneFile};
use super::{AssetRef, CameraPath, Light, Node, Scene, SceneError, SceneLimits};
use crate::json;
use crate::memory::Admission;

/// Background of scenes that name none: `#202428`.
pub(super) const DEFAULT_BACKGROUND: &str = "#202428";

/// Reads and validates the scene file at `path`, which must lie below `root`.
///
/// # Errors
/// See [`SceneError`]; `Invalid` names the place in the file.
pub fn load(path: &Path, root: &Path, limits: &SceneLimits) -> Result<Scene, SceneError> {
    load_within(path, None, root, limits, &Admission::default())
}

/// Reads a scene file as [`load`] does, with memory that is reserved first. Files that the scene names lie in the folder
/// `base`, or beside the scene where there is none.
///
/// # Errors
/// See [`load`]; [`SceneError::Interrupted`].
pub fn load_within(
    path: &Path,
    base: Option<&Path>,
    root: &Path,
    limits: &SceneLimits,
    admission: &Admission,
) -> Result<Scene, SceneError> {
    // Only the name: where the root lies is nobody's business but the operator's.
    let file = path
        .file_name()
        .map_or_else(|| path.display().to_string(), |name| name.to_string_lossy().into_owned());
    let io = |source| SceneError::Io { file: file.clone(), source };
    let canonical = path.canonicalize().map_err(io)?;
    if !canonical.starts_with(root.canonicalize().map_err(io)?) {
        return Err(SceneError::Invalid {
            file,
            path: "$".to_owned(),
            reason: "the scene file lies outside the scene root".to_owned(),
        });
    }
    let length = std::fs::metadata(&canonical).map_err(io)?.len();
    let before = admission.held();
    admission.grow(&file, length.min(limits.max_json_bytes))?;
    let text = read(&canonical, &file, limits)?;
    let base = base.or(canonical.parent()).unwrap_or(Path::new("/"));
    let mut scene = parse_within(&text, &file, base, root, limits, admission)?;
    admission.shrink_to(before + scene.host_bytes());
    if scene.name == file {
        scene.name = path.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or(file);
    }
    Ok(scene)
}

/// Reads a file that holds one camera path, wherever it lies. `up` is the up of the scene that it leads through.
///
/// # Errors
/// See [`SceneError`]; `Invalid` names the place in the file.
pub fn load_path(path: &Path, up: DVec3, limits: &SceneLimits) -> Result<CameraPath, SceneError> {
    let file = path.display().to_string();
    let text = read(path, &file, limits)?;
    parse_path(&text, &file, up)
}

/// Validates the text of a file that holds one camera path. `name` is what errors call it.
///
/// # Errors
/// [`SceneError::Invalid`], which names the place in the file.
pub fn parse_path(text: &str, name: &str, up: DVec3) -> Result<CameraPath, SceneError> {
    let wire: PathWire =
        deserialize(text).map_err(|(path, reason)| invalid(name, &path, reason))?;
    validate::path(&wire, up).map_err(|reason| refused(name, reason))
}

/// Text of a file that is small enough; `file` is what errors call it.
fn read(path: &Path, file: &str, limits: &SceneLimits) -> Result<String, SceneError> {
    let io = |source| SceneError::Io { file: file.to_owned(), source };
    let mut bytes = Vec::new();
    let handle = File::open(path).map_err(io)?;
    handle.take(limits.max_json_bytes.saturating_add(1)).read_to_end(&mut bytes).map_err(io)?;
    check_length(bytes.len(), file, limits)?;
    String::from_utf8(bytes).map_err(|error| {
        let at = error.utf8_error().valid_up_to();
        invalid(file, "$", format!("not UTF-8 text: byte {at}"))
    })
}

fn check_length(bytes: usize, file: &str, limits: &SceneLimits) -> Result<(), SceneError> {
    let (found, limit) = (bytes as u64, limits.max_json_bytes);
    if found <= limit {
        return Ok(());
    }
    Err(SceneError::TooLarge { file: file.to_owned(), what: "bytes of JSON", found, limit })
}

/// Validates the text of a scene file. `name` is what errors call it (and the scene, if it names
/// itself nothing else); files are looked up relative to `base_dir` and must lie below `root`.
///
/// # Errors
/// See [`SceneError`]; `Invalid` names the place in the file.
pub fn parse(
    text: &str,
    name: &str,
    base_dir: &Path,
    root: &Path,
    limits: &SceneLimits,
) -> Result<Scene, SceneError> {
    parse_within(text, name, base_dir, root, limits, &Admission::default())
}

fn parse_within(
    text: &str,
    name: &str,
    base_dir: &Path,
    root: &Path,
    limits: &SceneLimits,
    admission: &Admission,
) -> Result<Scene, SceneError> {
    check_length(text.len(), name, limits)?;
    let most = json::Limits {
        nodes: limits.max_nodes,
        objects: limits.max_json_objects,
        values: u64::MAX,
        string_bytes: MAX_STRING_BYTES,
    };
    let census = json::count(text.as_bytes(), &most).map_err(|excess| {
        let json::Excess { what, found, limit } = excess;
        SceneError::TooLarge { file: name.to_owned(), what, found, limit }
    })?;
    // As written, and as validated.
    admission.grow(name, census.bytes(OBJECT_BYTES + size_of::<Node>()))?;
    let wire: SceneFile =
        deserialize(text).map_err(|(path, reason)| invalid(name, &path, reason))?;
    let root = root
        .canonicalize()
        .map_err(|source| SceneError::Io { file: "the scene root".to_owned(), source })?;
    let resolve = |file: &str| resolve_file(file, base_dir, &root);
    validate::scene(wire, name, &resolve, limits).map_err(|reason| refused(name, reason))
}

/// Longer strings are no names, colours or paths of files.
const MAX_STRING_BYTES: u64 = 64 << 10;
/// Bytes of an object of a scene file in memory: nodes are the largest; names are kept in maps beside them.
const OBJECT_BYTES: usize = size_of::<NodeWire>() + 256;

impl Scene {
    /// Bytes of nodes and assets.
    fn host_bytes(&self) -> u64 {
        fn nodes(list: &[Node]) -> usize {
            list.iter().map(|node| 1 + nodes(&node.children)).sum()
        }
        let prototypes: usize = self.prototypes.iter().map(|p| nodes(&p.children)).sum();
        let operands: usize = self.assets.iter().map(|asset| 1 + asset.operands().len()).sum();
        ((nodes(&self.nodes) + prototypes) * size_of::<Node>() + operands * 256) as u64
    }

    /// The scene of a bare asset file (absolute, already checked): one node, one default pair of
    /// lights, `+y` up.
    pub fn from_asset(name: &str, file: PathBuf) -> Scene {
        Scene {
            name: name.to_owned(),
            assets: vec![AssetRef::file(name, file)],
            nodes: vec![Node {
                name: Some(name.to_owned()),
                draws: super::Draws::Asset(0),
                ..Node::default()
            }],
            lights: Light::default_pair().to_vec(),
            background: super::color::parse_hex(DEFAULT_BACKGROUND)
                .map_or([0.0, 0.0, 0.0, 1.0], super::color::to_linear),
            up: DVec3::Y,
            ..Scene::default()
        }
    }
}

fn refused(file: &str, reason: Reason) -> SceneError {
    match reason {
        Reason::At(path, reason) => invalid(file, &path, reason),
        Reason::TooLarge { what, found, limit } => {
            SceneError::TooLarge { file: file.to_owned(), what, found, limit }
        }
    }
}

fn invalid(file: &str, path: &str, reason: String) -> SceneError {
    SceneError::Invalid { file: file.to_owned(), path: path.to_owned(), reason }
}

/// JSON → wire structures, or the path and the reason why not.
fn deserialize<T: DeserializeOwned>(text: &str) -> Result<T, (String, String)> {
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let mut json = serde_json::Deserializer::from_str(text);
    let wire: Object<T> = serde_path_to_error::deserialize(&mut json).map_err(|error| {
        let path = match error.path().to_string() {
            path if path == "." => "$".to_owned(),
            path => path,
        };
        (path, explain(&error.into_inner().to_string()))
    })?;
    json.end().map_err(|error| ("$".to_owned(), error.to_string()))?;
    Ok(wire.0)
}

/// serde's message in the words of JSON, with the nearest known key or value suggested where one was unknown, and with
/// a way out where JSON was nested too deeply.
fn explain(message: &str) -> String {
    if message.starts_with("recursion limit exceeded") {
        return "JSON is nested more than 128 arrays and objects deep; name subtrees as prototypes \
                instead"
            .to_owned();
    }
    for what in ["unknown field `", "unknown variant `"] {
        let Some(rest) = message.strip_prefix(what) else { continue };
        // The offending key may hold anything, backquotes too; what was expected comes last.
        let Some((found, expected)) = rest.rsplit_once("`, expected ") else { continue };
        let known: Vec<&str> = expected.split('`').skip(1).step_by(2).collect();
        let kind = if what.contains("field") { "unknown key" } else { "unknown value" };
        let suggestion = match nearest(found, known.iter().copied()) {
            Some(near) => format!("did you mean `{near}`?"),
            None => format!("known are {}", list(&known)),
        };
        let position = expected.rsplit_once(" at line ").map_or("", |(_, position)| position);
        return match position {
            "" => format!("{kind} `{found}`; {suggestion}"),
            position => format!("{kind} `{found}` at line {position}; {suggestion}"),
        };
    }
    json::plain(message)
}

/// The name among `known` that `found` was probably meant to be.
pub(super) fn nearest<'a>(found: &str, known: impl Iterator<Item = &'a str>) -> Option<&'a str> {
    // Damerau–Levenshtein is quadratic; longer strings are no typing errors.
    if found.len() > 64 {
        return None;
    }
    let lower = found.to_lowercase();
    known
        .filter(|name| name.len() <= 64)
        .map(|name| (strsim::damerau_levenshtein(&lower, &name.to_lowercase()), name))
        .min_by_key(|&(distance, _)| distance)
        .filter(|&(distance, name)| distance <= 1 + found.chars().count().min(name.len()) / 3)
        .map(|(_, name)| name)
}

/// "`a`, `b`, `c`", the first dozen of them.
pub(super) fn list(names: &[&str]) -> String {
    const MOST: usize = 12;
    let mut text =
        names.iter().take(MOST).map(|name| format!("`{name}`")).collect::<Vec<_>>().join(", ");
    if names.len() > MOST {
        text.push_str(&format!(" and {} more", names.len() - MOST));
    }
    text
}

/// Where a scene's `file` lies, canonical; `root` is canonical already. The reason never tells
/// whether something exists outside the root, nor where the root is.
fn resolve_file(file: &str, base_dir: &Path, root: &Path) -> Result<PathBuf, String> {
    let outside = || format!("`{file}` leads out of the scene root");
    if file.is_empty() {
        return Err("must name a file".to_owned());
    }
    if file.contains("://") {
        return Err(format!("`{file}` is an address; only files below the scene root are read"));
    }
    if file.contains('\0') {
        return Err("a file's name cannot hold a NUL character".to_owned());
    }
    let relative = Path::new(file);
    if !relative
        .components()
        .all(|c| matches!(c, Component::Normal(_) | Component::CurDir | Component::ParentDir))
    {
        return Err(format!("`{file}` is absolute; it must be relative to the scene file"));
    }
    let base =
        base_dir.canonicalize().map_err(|_| "the scene's folder is not readable".to_owned())?;
    let mut lexical = base.clone();
    for component in relative.components() {
        match component {
            Component::ParentDir => {
                lexical.pop();
                if !lexical.starts_with(root) {
                    return Err(outside());
                }
            }
            other => lexical.push(other),
        }
    }
    if !lexical.starts_with(root) {
        return Err(outside());
    }
    let canonical = match base.join(relative).canonicalize() {
        Ok(canonical) => canonical,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            return Err(format!("there is no file `{file}` beside the scene file"));
        }
        Err(_) => return Err(format!("`{file}` cannot be read")),
    };
    if !canonical.starts_with(root) {
        return Err(outside());
    }
    if !canonical.is_file() {
        return Err(format!("`{file}` is not a file"));
    }
    Ok(canonical)
}
