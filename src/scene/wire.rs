//! Scene files as written: the serde structures, one field for every key that a file may hold.
//!
//! These say what is *well-formed*; [`super::validate`] says what is *meant*. Every structure
//! denies unknown keys, and serde's derive refuses a key that is given twice; maps from a name to
//! something are [`Named`], which keeps the file's order and refuses repeated names. The JSON
//! Schema is derived from the same structures ([`json_schema`]).

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fmt;
use std::marker::PhantomData;

use schemars::{JsonSchema, Schema, SchemaGenerator};
use serde::de::{self, Deserialize, Deserializer, MapAccess, SeqAccess, Visitor};

use super::path::{Ease, Interpolation};
use super::splats::{Blend, Filter, Shading};
use super::up::Up;
use crate::json::whole::{self, Whole};

/// Frames a second that a path may have.
pub(super) const PATH_FPS: [f64; 2] = [0.001, 1000.0];
/// Seconds at which a key of a path may stand.
pub(super) const PATH_SECONDS: [f64; 2] = [-1e6, 1e6];

/// The JSON Schema of scene files, draft 2020-12.
pub fn json_schema() -> serde_json::Value {
    schemars::schema_for!(SceneFile).to_value()
}

/// The JSON Schema of files that hold one camera path, draft 2020-12.
pub fn path_json_schema() -> serde_json::Value {
    schemars::schema_for!(PathWire).to_value()
}

/// A scene: files and what is made of them, where they stand, how they are lit and seen. Angles are in degrees, lengths in
/// the scene's own unit, colours sRGB. Only `assets` and `nodes` are required.
#[derive(Debug, serde::Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(title = "Pointillist scene")]
pub(super) struct SceneFile {
    /// Where this schema lies, for editors; not read.
    #[serde(rename = "$schema", default)]
    pub _schema: Option<String>,
    /// Version of the format: 1.
    #[serde(default, deserialize_with = "whole::optional")]
    pub pointillist: Option<u32>,
    /// Shown to users; the file's name when absent.
    #[serde(default)]
    pub name: Option<String>,
    /// Files, and solids made of other assets, by name.
    #[schemars(with = "BTreeMap<String, AssetWire>")]
    pub assets: Named<AssetWire>,
    /// Subtrees by name. They may use one another, but not themselves.
    #[serde(default)]
    #[schemars(with = "BTreeMap<String, PrototypeWire>")]
    pub prototypes: Named<PrototypeWire>,
    pub nodes: Vec<Object<NodeWire>>,
    /// Appearances by name, for nodes to lay over their assets' own.
    #[serde(default)]
    #[schemars(with = "BTreeMap<String, MaterialWire>")]
    pub materials: Named<MaterialWire>,
    /// When absent: a headlight (0.63) and ambient light (0.07), or nothing where the scene has an `environment`. An empty list means unlit, but for
    /// the light of an `environment`.
    #[serde(default)]
    pub lights: Option<Vec<Object<LightWire>>>,
    /// Colour of pixels that nothing covers, `#202428` when absent.
    #[serde(default)]
    pub background: Option<ColorWire>,
    /// An image of the scene's surroundings, which lights surfaces, is reflected by them, and is the background.
    #[serde(default)]
    pub environment: Option<Object<EnvironmentWire>>,
    /// Fog that surfaces are seen through, and an opaque background with them.
    #[serde(default)]
    pub fog: Option<Object<FogWire>>,
    /// Darkens ambient light where other surfaces are near.
    #[serde(default)]
    pub ambient_occlusion: Option<Object<OcclusionWire>>,
    /// Poses by name.
    #[serde(default)]
    #[schemars(with = "BTreeMap<String, CameraWire>")]
    pub cameras: Named<CameraWire>,
    /// Min and max corner of the box that a frame without a pose shows. When absent, such a frame shows the whole scene.
    #[serde(default)]
    pub subject: Option<[[f64; 3]; 2]>,
    /// Camera paths by name.
    #[serde(default)]
    #[schemars(with = "BTreeMap<String, PathWire>")]
    pub paths: Named<PathWire>,
    /// World up: an axis by name, `"y"` when absent, or a vector.
    #[serde(default)]
    pub up: Option<Up>,
    /// How samples are drawn as splats.
    #[serde(default)]
    pub splats: Option<Object<SplatsWire>>,
}

/// A file, or a solid made of other assets: one of `file`, `union`, `intersection` and `difference`.
#[derive(Debug, Default, serde::Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub(super) struct AssetWire {
    /// Relative to the scene file, inside the scene root.
    pub file: Option<String>,
    /// Turns the file's meshes into samples that cover their surface; `{}` chooses how densely.
    pub sample: Option<Object<SampleWire>>,
    /// Whether sharp features of the file's points are looked for, false when absent.
    pub features: Option<bool>,
    /// Turns the leaves and branches of the file's meshes into lines; `{}` does so with both.
    pub as_lines: Option<Object<AsLinesWire>>,
    /// Radius of the file's lines, in its unit, in place of its own; without one, lines have a radius that follows from their size and number.
    pub line_radius: Option<f64>,
    /// The union of these sampled solids.
    pub union: Option<Vec<Object<OperandWire>>>,
    /// The intersection of these sampled solids.
    pub intersection: Option<Vec<Object<OperandWire>>>,
    /// The first of these sampled solids without the others.
    pub difference: Option<Vec<Object<OperandWire>>>,
}

#[derive(Debug, Default, serde::Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub(super) struct SampleWire {
    /// Distance between neighbouring samples, in the file's unit.
    pub spacing: Option<f64>,
    /// Degrees between faces above which their edge is sharp, 35 when absent.
    pub crease: Option<f64>,
}

#[derive(Debug, Default, serde::Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub(super) struct AsLinesWire {
    /// Whether leaves, which are strips of quads, become ribbons; true when absent.
    pub leaves: Option<bool>,
    /// Whether branches, which are rows of rings, become tubes; true when absent.
    pub branches: Option<bool>,
    /// Largest radius of a tube and half-width of a ribbon, in the file's unit; wider parts stay triangles. When absent, a hundredth and a twentieth of the mesh's diagonal.
    pub max_radius: Option<f64>,
}

/// An asset as part of a solid, and where it stands in it.
#[derive(Debug, serde::Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct OperandWire {
    /// Name of another asset: sampled, points with normals, or made of others itself.
    pub asset: String,
    #[serde(default)]
    pub translate: Option<[f64; 3]>,
    /// Degrees about x, then y, then z, all about the solid's axes.
    #[serde(default)]
    pub rotate: Option<[f64; 3]>,
    /// `[x, y, z, w]`, normalised on reading.
    #[serde(default)]
    pub quaternion: Option<[f64; 4]>,
    #[serde(default)]
    pub scale: Option<ScaleWire>,
    /// Column by column, the last row 0 0 0 1; instead of the others.
    #[serde(default)]
    pub matrix: Option<[f64; 16]>,
}

#[derive(Debug, Default, serde::Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub(super) struct SplatsWire {
    /// How a kernel is taken to the image, `perspective` when absent.
    pub filter: Option<Filter>,
    /// How overlapping splats are combined, `weighted` when absent.
    pub blend: Option<Blend>,
    /// When splats are lit, `deferred` when absent.
    pub shading: Option<Shading>,
    /// Whether kernels are convolved with a low-pass filter of the image, true when absent.
    pub prefilter: Option<bool>,
    /// Standard deviation of that filter in pixels, 0.1 to 4; 0.5 when absent.
    pub lowpass: Option<f64>,
    /// Where kernels end, in their standard deviations, 0.5 to 4; 2 when absent.
    pub cutoff: Option<f64>,
    /// Multiplies every kernel's axes, 0.01 to 100; 1 when absent.
    pub width: Option<f64>,
    /// How far behind the nearest surface splats still count, in radii of the nearest splat, 0 to 100; 1 when absent.
    pub depth_offset: Option<f64>,
}

#[derive(Debug, serde::Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct PrototypeWire {
    pub children: Vec<Object<NodeWire>>,
}

/// A transform (translate · rotate · scale, or one matrix), what it draws, its children.
#[derive(Debug, Default, serde::Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub(super) struct NodeWire {
    pub name: Option<String>,
    /// Name of the asset drawn here.
    pub asset: Option<String>,
    /// Name of the prototype drawn here.
    pub prototype: Option<String>,
    pub translate: Option<[f64; 3]>,
    /// Degrees about x, then y, then z, all about the parent's axes.
    pub rotate: Option<[f64; 3]>,
    /// `[x, y, z, w]`, normalised on reading.
    pub quaternion: Option<[f64; 4]>,
    pub scale: Option<ScaleWire>,
    /// Column by column, the last row 0 0 0 1; instead of the others.
    pub matrix: Option<[f64; 16]>,
    /// Name of a material for this node and all below.
    pub material: Option<String>,
    /// True when absent; false hides everything below, too.
    pub visible: Option<bool>,
    pub repeat: Option<Object<RepeatWire>>,
    pub children: Vec<Object<NodeWire>>,
}

/// Copies: `grid` with `step`, or `scatter` with `half_extent`.
#[derive(Debug, Default, serde::Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub(super) struct RepeatWire {
    /// Number of copies along x, y and z of the parent.
    #[schemars(with = "Option<[u32; 3]>")]
    pub grid: Option<[Whole<u32>; 3]>,
    /// Distance between the grid's neighbours.
    pub step: Option<[f64; 3]>,
    /// Number of copies strewn at random.
    #[serde(deserialize_with = "whole::optional")]
    pub scatter: Option<u32>,
    /// Half the edges of the box in which they are strewn, centred on the node.
    pub half_extent: Option<[f64; 3]>,
    /// Smallest and largest uniform scale of a strewn copy, `[1, 1]` when absent.
    pub scale: Option<[f64; 2]>,
    /// Whether each strewn copy is turned about the scene's up, false when absent.
    pub turn: Option<bool>,
    /// 0 when absent.
    #[serde(deserialize_with = "whole::optional")]
    pub seed: Option<u64>,
}

#[derive(Debug, Default, serde::Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub(super) struct MaterialWire {
    pub color: Option<ColorWire>,
    /// Specular colour of Phong's model.
    pub specular: Option<ColorWire>,
    /// Phong exponent, at least 1.
    pub shininess: Option<f64>,
    /// From 0, for dielectrics, to 1, for metals; in the metallic-roughness model of glTF, which knows neither `specular` nor `shininess`.
    pub metallic: Option<f64>,
    /// From 0, for mirrors, to 1; in the metallic-roughness model of glTF. Without it the asset's own, or 1.
    pub roughness: Option<f64>,
    /// From 0 to 1, the share of the light that is not reflected which passes surfaces of meshes, tinted by their colour, in place of being
    /// scattered below them; in the metallic-roughness model of glTF. Without it the asset's own, or 0.
    pub transmission: Option<f64>,
    /// Colour of light that the surface gives off.
    pub emissive: Option<ColorWire>,
    /// Factor of `emissive`, 1 when absent.
    pub emissive_strength: Option<f64>,
    pub unlit: Option<bool>,
    pub double_sided: Option<bool>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub(super) enum LightKind {
    Ambient,
    Headlight,
    Sun,
    Point,
}

#[derive(Debug, serde::Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct LightWire {
    pub kind: LightKind,
    /// White when absent.
    #[serde(default)]
    pub color: Option<ColorWire>,
    /// Multiplies the colour in linear light, 1 when absent.
    #[serde(default)]
    pub intensity: Option<f64>,
    /// Where a sun's light travels to.
    #[serde(default)]
    pub direction: Option<[f64; 3]>,
    /// Where a point light stands.
    #[serde(default)]
    pub position: Option<[f64; 3]>,
    /// Distance at which half of a point light is left.
    #[serde(default)]
    pub range: Option<f64>,
    /// Whether a sun or a point light casts shadows, false when absent.
    #[serde(default)]
    pub shadows: Option<bool>,
    /// Angular diameter in degrees of a sun that casts shadows, 0 to 20; 0.53, that of the sun seen from the Earth, when absent. The larger it is, the softer
    /// are the shadows' edges; with 0 they are hard.
    #[serde(default)]
    pub angle: Option<f64>,
    /// Radius in scene units of a point light that casts shadows, 0 when absent. The larger it is, the softer are the shadows' edges.
    #[serde(default)]
    pub radius: Option<f64>,
}

#[derive(Debug, serde::Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct EnvironmentWire {
    /// An equirectangular image, twice as wide as high: Radiance HDR, OpenEXR, or any format that textures have. Relative to the scene file, inside the
    /// scene root.
    pub file: String,
    /// Factor of its light, above 0 and up to 1e6; 1 when absent. White surroundings of strength 1 light a white surface to white.
    #[serde(default)]
    pub strength: Option<f64>,
    /// Degrees by which the surroundings are turned about the scene's up, counter-clockwise as seen from above, 0 when absent. The centre of the image lies
    /// at -z then where up is y, and at +y where up is z.
    #[serde(default)]
    pub turn: Option<f64>,
    /// Whether pixels that nothing covers show it in place of the `background`, true when absent.
    #[serde(default)]
    pub background: Option<bool>,
}

#[derive(Debug, serde::Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct FogWire {
    /// Colour of what is far within the fog. It is shown as it is; lights do not change it.
    pub color: ColorWire,
    /// Extinction for each scene unit, 0 or 1e-12 to 1e9: at a distance of 1 / density, 37 % of a surface's light are left; at 3 / density, 5 %.
    pub density: f64,
    /// Height over which the density falls by a factor of e, in scene units along the scene's up. When absent, the fog is as dense everywhere.
    #[serde(default)]
    pub scale_height: Option<f64>,
    /// Height at which fog with a `scale_height` has its density, 0 when absent.
    #[serde(default)]
    pub base_height: Option<f64>,
}

#[derive(Debug, serde::Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct OcclusionWire {
    /// Distance in scene units within which surfaces hide ambient light from each other.
    pub radius: f64,
    /// Share of the hidden ambient light that is taken away, 0 to 1; 1 when absent.
    #[serde(default)]
    pub strength: Option<f64>,
}

#[derive(Debug, serde::Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct CameraWire {
    pub eye: [f64; 3],
    pub target: [f64; 3],
    /// The scene's up when absent.
    #[serde(default)]
    pub up: Option<Up>,
    /// Vertical field of view, 40 when absent.
    #[serde(default)]
    pub fov: Option<f64>,
    /// Height of the view in scene units, in place of `fov`: the projection is orthographic.
    #[serde(default)]
    pub ortho_height: Option<f64>,
}

/// A camera's way: its poses at certain times. In between, orientations turn the shorter way, distances to the target and fields of
/// view change evenly.
#[derive(Debug, serde::Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(title = "Pointillist camera path")]
pub(super) struct PathWire {
    /// Where this schema lies, for editors; not read.
    #[serde(rename = "$schema", default)]
    pub _schema: Option<String>,
    /// Frames a second, 30 when absent.
    #[serde(default)]
    #[schemars(range(min = PATH_FPS[0], max = PATH_FPS[1]))]
    pub fps: Option<f64>,
    /// How positions go from key to key, `catmull_rom` when absent.
    #[serde(default)]
    pub interpolation: Option<Interpolation>,
    /// How time passes between keys that do not say themselves; when absent `smooth` for `catmull_rom`, `linear` for `linear`.
    #[serde(default)]
    pub ease: Option<Ease>,
    #[schemars(length(min = 1))]
    pub keys: Vec<Object<KeyWire>>,
}

#[derive(Debug, serde::Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct KeyWire {
    /// Seconds, later than the key before.
    #[schemars(range(min = PATH_SECONDS[0], max = PATH_SECONDS[1]))]
    pub t: f64,
    pub eye: [f64; 3],
    pub target: [f64; 3],
    /// The scene's up when absent.
    #[serde(default)]
    pub up: Option<Up>,
    /// Vertical field of view, 40 when absent.
    #[serde(default)]
    pub fov: Option<f64>,
    /// Height of the view in scene units, in place of `fov`: the projection is orthographic.
    #[serde(default)]
    pub ortho_height: Option<f64>,
    /// How time passes from here to the next key; the path's `ease` when absent.
    #[serde(default)]
    pub ease: Option<Ease>,
}

/// `#rgb`, `#rrggbb`, `#rrggbbaa` or three channels in 0..=1, sRGB.
#[derive(Clone, Debug, PartialEq, JsonSchema)]
#[schemars(untagged)]
pub(super) enum ColorWire {
    Hex(String),
    Rgb([f64; 3]),
}

/// One factor, or one for each axis.
#[derive(Clone, Copy, Debug, PartialEq, JsonSchema)]
#[schemars(untagged)]
pub(super) enum ScaleWire {
    Uniform(f64),
    Axes([f64; 3]),
}

/// Three numbers from a sequence, no more and no fewer.
pub(super) fn three<'de, A: SeqAccess<'de>>(
    mut seq: A,
    expected: &dyn de::Expected,
) -> Result<[f64; 3], A::Error> {
    let mut values = [0.0; 3];
    for (index, value) in values.iter_mut().enumerate() {
        *value = seq.next_element()?.ok_or_else(|| de::Error::invalid_length(index, expected))?;
    }
    match seq.next_element::<de::IgnoredAny>()? {
        None => Ok(values),
        Some(_) => Err(de::Error::invalid_length(4, expected)),
    }
}

/// `Deserialize` for a value that is a string or a number on one hand, three numbers on the other.
macro_rules! either_form {
    ($name:ident, $expecting:literal, { $($scalar:tt)* }) => {
        impl<'de> Deserialize<'de> for $name {
            fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                struct Form;
                impl<'de> Visitor<'de> for Form {
                    type Value = $name;
                    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                        f.write_str($expecting)
                    }
                    $($scalar)*
                }
                deserializer.deserialize_any(Form)
            }
        }
    };
}

either_form! {
    ColorWire, "a colour, `#rrggbb` or [r, g, b] in 0..=1", {
        fn visit_str<E: de::Error>(self, text: &str) -> Result<ColorWire, E> {
            Ok(ColorWire::Hex(text.to_owned()))
        }
        fn visit_seq<A: SeqAccess<'de>>(self, seq: A) -> Result<ColorWire, A::Error> {
            three(seq, &self).map(ColorWire::Rgb)
        }
    }
}

either_form! {
    ScaleWire, "a number or three of them", {
        fn visit_f64<E: de::Error>(self, factor: f64) -> Result<ScaleWire, E> {
            Ok(ScaleWire::Uniform(factor))
        }
        fn visit_u64<E: de::Error>(self, factor: u64) -> Result<ScaleWire, E> {
            Ok(ScaleWire::Uniform(factor as f64))
        }
        fn visit_i64<E: de::Error>(self, factor: i64) -> Result<ScaleWire, E> {
            Ok(ScaleWire::Uniform(factor as f64))
        }
        fn visit_seq<A: SeqAccess<'de>>(self, seq: A) -> Result<ScaleWire, A::Error> {
            three(seq, &self).map(ScaleWire::Axes)
        }
    }
}

/// A structure written as an object. serde's derive would take an array of the fields' values, too.
#[derive(Debug)]
pub(super) struct Object<T>(pub T);

// A derived schema would have one name for all structures.
impl<T: JsonSchema> JsonSchema for Object<T> {
    fn inline_schema() -> bool {
        T::inline_schema()
    }
    fn schema_name() -> Cow<'static, str> {
        T::schema_name()
    }
    fn schema_id() -> Cow<'static, str> {
        T::schema_id()
    }
    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        T::json_schema(generator)
    }
}

impl<T> std::ops::Deref for Object<T> {
    type Target = T;
    fn deref(&self) -> &T {
        &self.0
    }
}

impl<'de, T: Deserialize<'de>> Deserialize<'de> for Object<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Fields<T>(PhantomData<T>);
        impl<'de, T: Deserialize<'de>> Visitor<'de> for Fields<T> {
            type Value = Object<T>;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("an object")
            }
            fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Object<T>, A::Error> {
                T::deserialize(de::value::MapAccessDeserializer::new(map)).map(Object)
            }
        }
        deserializer.deserialize_map(Fields(PhantomData))
    }
}

/// A map from names, in the file's order, in which every name occurs once.
#[derive(Debug)]
pub(super) struct Named<T>(pub Vec<(String, T)>);

impl<T> Default for Named<T> {
    fn default() -> Self {
        Named(Vec::new())
    }
}

impl<'de, T: Deserialize<'de>> Deserialize<'de> for Named<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Entries<T>(PhantomData<T>);
        impl<'de, T: Deserialize<'de>> Visitor<'de> for Entries<T> {
            type Value = Named<T>;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("an object")
            }
            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Named<T>, A::Error> {
                let mut entries = Vec::new();
                let mut seen = std::collections::HashSet::new();
                while let Some(name) = map.next_key::<String>()? {
                    if !seen.insert(name.clone()) {
                        return Err(de::Error::custom(format_args!("duplicate key `{name}`")));
                    }
                    entries.push((name, map.next_value::<Object<T>>()?.0));
                }
                Ok(Named(entries))
            }
        }
        deserializer.deserialize_map(Entries(PhantomData))
    }
}
