//! Wire structures → [`Scene`]: names to indices, degrees to matrices, sRGB to linear light.
//!
//! Every function takes the [`Place`] it works at, a chain of segments on the stack that is only
//! spelt out when something is wrong there.

mod assets;
mod effects;
mod look;
mod placement;

use std::collections::HashMap;
use std::fmt;
use std::path::PathBuf;

use glam::DVec3;

use super::load::{list, nearest};
use super::wire::{Named, NodeWire, Object, PathWire, PrototypeWire, SceneFile};
use super::{CameraPath, Draws, Node, Prototype, Repeat, Scene, SceneLimits, graph};

/// Why a well-formed file was refused.
#[derive(Debug)]
pub(super) enum Reason {
    /// Path in the file and what is wrong there.
    At(String, String),
    TooLarge {
        what: &'static str,
        found: u64,
        limit: u64,
    },
}

type Valid<T> = Result<T, Reason>;

/// Lengths and coordinates beyond this are mistakes: f64 keeps a tenth of a millimetre there.
pub const LARGEST_COORDINATE: f64 = 1e12;
pub const LARGEST_SCALE: f64 = 1e9;
const DEFAULT_FOV_DEG: f64 = 40.0;
const LARGEST_INTENSITY: f64 = 1e6;

/// A place in the file.
#[derive(Clone, Copy)]
enum Place<'a> {
    Root,
    Key(&'a Place<'a>, &'a str),
    Index(&'a Place<'a>, usize),
}

impl<'a> Place<'a> {
    fn key(&'a self, key: &'a str) -> Place<'a> {
        Place::Key(self, key)
    }

    fn index(&'a self, index: usize) -> Place<'a> {
        Place::Index(self, index)
    }

    fn refuse<T>(&self, reason: impl Into<String>) -> Valid<T> {
        Err(Reason::At(self.to_string(), reason.into()))
    }
}

impl fmt::Display for Place<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Place::Root => f.write_str("$"),
            Place::Key(Place::Root, key) => f.write_str(key),
            Place::Key(parent, key) => write!(f, "{parent}.{key}"),
            Place::Index(parent, index) => write!(f, "{parent}[{index}]"),
        }
    }
}

/// Names of one kind of thing and their indices.
struct Names<'a> {
    kind: &'static str,
    indices: HashMap<&'a str, usize>,
    in_order: Vec<&'a str>,
}

impl<'a> Names<'a> {
    fn of<T>(kind: &'static str, named: &'a Named<T>) -> Names<'a> {
        let in_order: Vec<&str> = named.0.iter().map(|(name, _)| name.as_str()).collect();
        let indices = in_order.iter().enumerate().map(|(i, &name)| (name, i)).collect();
        Names { kind, indices, in_order }
    }

    fn find(&self, name: &str, place: Place<'_>) -> Valid<usize> {
        if let Some(&index) = self.indices.get(name) {
            return Ok(index);
        }
        let kind = self.kind;
        let hint = match nearest(name, self.in_order.iter().copied()) {
            Some(near) => format!("did you mean `{near}`?"),
            None if self.in_order.is_empty() => format!("the scene names no {kind}"),
            None => format!("there are {}", list(&self.in_order)),
        };
        place.refuse(format!("there is no {kind} `{name}`; {hint}"))
    }
}

/// Names that nodes may refer to.
struct Context<'a> {
    assets: Names<'a>,
    prototypes: Names<'a>,
    materials: Names<'a>,
}

/// Validates a whole file. `resolve` turns an asset's `file` into a canonical path.
pub(super) fn scene(
    wire: SceneFile,
    name: &str,
    resolve: &dyn Fn(&str) -> Result<PathBuf, String>,
    limits: &SceneLimits,
) -> Valid<Scene> {
    let root = Place::Root;
    if let Some(version) = wire.pointillist
        && version != 1
    {
        return root.key("pointillist").refuse(format!("version {version} is unknown; this is 1"));
    }
    let context = Context {
        assets: Names::of("asset", &wire.assets),
        prototypes: Names::of("prototype", &wire.prototypes),
        materials: Names::of("material", &wire.materials),
    };
    let up = look::world_up(wire.up, root.key("up"))?;
    let scene = Scene {
        splats: look::splats(wire.splats.as_deref())?,
        name: wire.name.clone().unwrap_or_else(|| name.to_owned()),
        assets: assets::assets(&wire.assets, &context.assets, resolve)?,
        materials: each(&wire.materials, "materials", look::material)?,
        prototypes: prototypes(&wire.prototypes, &context)?,
        nodes: top_nodes(&wire.nodes, &context)?,
        lights: look::lights(wire.lights.as_deref(), wire.environment.is_some())?,
        background: look::background(wire.background.as_ref())?,
        environment: wire
            .environment
            .as_deref()
            .map(|wire| effects::environment(wire, up, resolve))
            .transpose()?,
        fog: wire.fog.as_deref().map(|fog| effects::fog(fog, up)).transpose()?.flatten(),
        occlusion: wire
            .ambient_occlusion
            .as_deref()
            .map(effects::ambient_occlusion)
            .transpose()?
            .flatten(),
        cameras: each(&wire.cameras, "cameras", |name, wire, place| {
            Ok((name.to_owned(), look::camera(wire, up, place)?))
        })?,
        paths: each(&wire.paths, "paths", |name, wire, place| {
            Ok((name.to_owned(), look::path(wire, up, place)?))
        })?,
        up,
        up_because: match wire.up {
            Some(_) => "the scene file says so",
            None => "scene files have y up unless they say otherwise",
        }
        .to_owned(),
        subject: wire.subject.map(look::subject).transpose()?,
        sensor: None,
        front: None,
    };
    graph::check(&scene, limits)?;
    Ok(scene)
}

/// Validates a file that holds one camera path; `up` is the up of the scene that it leads through.
pub(super) fn path(wire: &PathWire, up: DVec3) -> Valid<CameraPath> {
    look::path(wire, up, Place::Root)
}

/// Applies `make` to every entry of a map of the root object.
fn each<T, U>(
    named: &Named<T>,
    key: &str,
    make: impl Fn(&str, &T, Place<'_>) -> Valid<U>,
) -> Valid<Vec<U>> {
    let root = Place::Root;
    let map = root.key(key);
    named.0.iter().map(|(name, wire)| make(name, wire, map.key(name))).collect()
}

fn prototypes(named: &Named<PrototypeWire>, context: &Context<'_>) -> Valid<Vec<Prototype>> {
    each(named, "prototypes", |name, wire, place| {
        let children = node_list(&wire.children, context, place.key("children"))?;
        Ok(Prototype { name: name.to_owned(), children })
    })
}

/// Top-level nodes are addressed by name when they are moved: names must not repeat.
fn top_nodes(wires: &[Object<NodeWire>], context: &Context<'_>) -> Valid<Vec<Node>> {
    let root = Place::Root;
    let place = root.key("nodes");
    let mut seen = HashMap::new();
    for (index, wire) in wires.iter().enumerate() {
        if let Some(name) = &wire.name
            && let Some(first) = seen.insert(name.as_str(), index)
        {
            let reason = format!("nodes[{first}] is already called `{name}`");
            return place.index(index).key("name").refuse(reason);
        }
    }
    node_list(wires, context, place)
}

fn node_list(
    wires: &[Object<NodeWire>],
    context: &Context<'_>,
    place: Place<'_>,
) -> Valid<Vec<Node>> {
    wires.iter().enumerate().map(|(i, wire)| node(wire, context, place.index(i))).collect()
}

/// The recursion is as deep as the JSON is nested, which its parser bounds.
fn node(wire: &NodeWire, context: &Context<'_>, place: Place<'_>) -> Valid<Node> {
    let draws = match (&wire.asset, &wire.prototype) {
        (Some(_), Some(_)) => {
            return place.refuse("has both `asset` and `prototype`; only one can be drawn");
        }
        (Some(name), None) => Draws::Asset(context.assets.find(name, place.key("asset"))?),
        (None, Some(name)) => {
            Draws::Prototype(context.prototypes.find(name, place.key("prototype"))?)
        }
        (None, None) => Draws::Nothing,
    };
    let material = match &wire.material {
        Some(name) => Some(context.materials.find(name, place.key("material"))?),
        None => None,
    };
    Ok(Node {
        name: wire.name.clone(),
        parent_from_node: placement::transform(wire, place)?,
        draws,
        children: node_list(&wire.children, context, place.key("children"))?,
        repeat: match &wire.repeat {
            Some(wire) => placement::repeat(wire, place.key("repeat"))?,
            None => Repeat::Once,
        },
        material,
        visible: wire.visible.unwrap_or(true),
    })
}

/// A direction, normalised.
fn unit(numbers: [f64; 3], place: Place<'_>) -> Valid<DVec3> {
    let v = coordinates(numbers, place)?;
    if v.length() < 1e-9 {
        return place.refuse("must not be the zero vector");
    }
    Ok(v / v.length())
}

fn coordinates(numbers: [f64; 3], place: Place<'_>) -> Valid<DVec3> {
    for (index, &number) in numbers.iter().enumerate() {
        within(number, -LARGEST_COORDINATE, LARGEST_COORDINATE, place.index(index))?;
    }
    Ok(DVec3::from_array(numbers))
}

fn within(number: f64, low: f64, high: f64, place: Place<'_>) -> Valid<f64> {
    if number >= low && number <= high {
        Ok(number)
    } else {
        place.refuse(format!("{number} lies outside {low}..={high}"))
    }
}
