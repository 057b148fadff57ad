//! Settings of a frame, each declared once.
//!
//! `settings!` takes the declarations and makes of them
//! - [`Given`]: the settings as a request gives them, in a query, a JSON body, a message of a stream, options of a command or a stored
//!   job; what is `None` has its default, or is the scene's to say,
//! - [`Settings`]: those that a frame is drawn with,
//! - [`declared`]: their names, ranges, labels and rules, from which the viewer builds its controls and the docs their table.
//!
//! [`Given::resolve`] is the one place where settings are checked, and [`Settings::affecting`] the one canonical form: entity tags,
//! coalescing and receipts all use it, so a new setting cannot be missing in one of them.

use std::sync::LazyLock;

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

mod blur;
mod cost;
mod declaration;
mod effects;
mod finer;
mod given;
mod goal;
mod numbers;
mod part;
mod shadows;
mod stereo;
mod text;
mod trades;
mod used;
mod values;

pub use crate::scene::name::Name;
pub use blur::BlurSamples;
use declaration::Accepted;
pub use declaration::{Choice, Rule, Setting, SettingError, SettingKind};
pub use effects::Effect;
use given::read;
pub use goal::Pinned;
pub use numbers::{
    Aperture, Budget, ColorBound, EdlRadius, EdlStrength, Exposure, EyeOffset, FocusDistance,
    LineWidth, MaxError, MinPsnr, PointSize, PointSizePx, Shutter,
};
pub use part::{ImagePart, MOST_WHOLE_PX};
pub use shadows::{ShadowPx, Shadows};
pub use trades::{Extent, Trade, TradeOff, trade_offs};
pub use used::{UsedSettings, UsedSplats};
pub use values::{
    Antialias, Background, ColorBy, Edl, ErrorMode, Lod, Output, Reconstruct, StillFrame, Wait,
};

use crate::assets::fields::{CLASSIFICATION, INTENSITY, RETURN_NUMBER};
use crate::math::Projection;
use crate::plan::SceneFacts;
use crate::scene::clipping::ClipBoxes;
use crate::scene::recolor::ColorMap;
use crate::scene::{Blend, Filter, Painting, PullPushWeights, Shading, ToneMap};

/// Samples are drawn as splats, or may be.
const SPLATS: Rule = Rule::new(
    "reconstruct",
    &["splats", "fuzzy", "painted", "auto"],
    "this setting applies to splats only",
);
const FILTERED: Rule = Rule::new(
    "reconstruct",
    &["splats", "fuzzy", "auto"],
    "painted splats are always low-pass filtered",
);
const PULL_PUSH: Rule = Rule::new(
    "reconstruct",
    &["pull_push"],
    "this setting applies to `reconstruct=pull_push` only",
);
const PAINTED: Rule =
    Rule::new("reconstruct", &["painted"], "this setting applies to `reconstruct=painted` only");
/// Samples are drawn as points, or may be.
const POINTS: Rule =
    Rule::new("reconstruct", &["points", "auto"], "splats have sizes of their own");
/// Samples are drawn with `reconstruct=splats`, or may be, so that `blend` and `shading` apply.
const PASSES: Rule = Rule::new(
    "reconstruct",
    &["splats", "auto"],
    "points are not blended, and `fuzzy` and `painted` have a fixed blend and shading",
);
const TREES: Rule = Rule::new("lod", &["spt"], "this setting applies to `lod=spt` only");
const MAPPED: Rule = Rule::new(
    "color_by",
    &["height", "intensity", "return_number", "field"],
    "no colour map is used",
);
const FIELD: Rule = Rule::new("color_by", &["field"], "no field is named");
const CLIPPED: Rule = Rule::new("clip_boxes", &[], "there are no clip boxes");
/// Samples in the scene, or those of meshes whose detail is chosen.
const SAMPLES: Rule = Rule::new("samples", &["some"], "");
const SEGMENTS: Rule = Rule::new("segments", &["some"], "");
const SHADOWS: Rule = Rule::new("shadows", &["on"], "shadows are off");
const CASTING: Rule = Rule::new("casting_lights", &["some"], "");
const LIT: Rule = Rule::new("lights", &["some"], "");
const OCCLUDED: Rule = Rule::new("scene_occlusion", &["some"], "");
/// Ambient occlusion finds depths, and ambient light that is not mixed with the rest.
const OCCLUDABLE: Rule = Rule::new("occludable", &["some"], "");
/// Samples leave depths, or may do so.
const DEPTHS: Rule = Rule::new("reconstruct", &["points", "splats", "pull_push", "auto"], "");
const WEIGHTED: Rule = Rule::new("blend", &["weighted"], "");
const LIT_SINGLY: Rule = Rule::new("shading", &["splat"], "");
const SURROUNDED: Rule = Rule::new("scene_environment", &["some"], "");
const FOGGY: Rule = Rule::new("scene_fog", &["some"], "");
/// An aperture or an open shutter.
const BLURRED: Rule = Rule::new("blur", &["some"], "");
const APERTURE: Rule =
    Rule::new("aperture", &[], "the aperture is 0, so that everything is sharp at every distance");
const SHIFTED: Rule = Rule::new("eye_offset", &[], "the eye is not shifted");
const EDL: Rule = Rule::new("edl", &["on", "auto"], "eye-dome lighting is off");
const SURELY_SPLATS: Rule = Rule::new("reconstruct", &["splats", "fuzzy", "painted"], "");
const THREE_PASSES: Rule = Rule::new("reconstruct", &["splats"], "");
const COLORS: Rule = Rule::new("output", &["color"], "");
const INTENSITIES: Rule = Rule::new("fields", &[INTENSITY], "").for_value("intensity");
const CLASSES: Rule = Rule::new("fields", &[CLASSIFICATION], "").for_value("classification");
const RETURNS: Rule = Rule::new("fields", &[RETURN_NUMBER], "").for_value("return_number");
const ANY_FIELD: Rule = Rule::new("fields", &[], "").for_value("field");

macro_rules! settings {
    ($(
        $(#[doc = $doc:literal])+
        $name:ident: $given:ident => $used:ty $(, once $old:literal)? {
            label: $label:literal, kind: $kind:expr, needs: [$($need:expr),*], useful_with: [$($useful:expr),*]
            $(, trades: $trades:expr)?
        }
    )+) => {
        /// Settings as a request gives them.
        #[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, clap::Args, utoipa::ToSchema, utoipa::IntoParams)]
        #[into_params(parameter_in = Query)]
        #[schema(as = Settings)]
        pub struct Given {
            $(
                $(#[doc = $doc])+
                // Numbers may be negative.
                #[arg(long, allow_hyphen_values = true)]
                #[serde(skip_serializing_if = "Option::is_none" $(, alias = $old)?)]
                pub $name: Option<$given>,
            )+
        }

        /// Settings that a frame is drawn with; `None` is as the scene has it.
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize)]
        pub struct Settings {
            $( $(#[doc = $doc])+ pub $name: $used, )+
            /// Frame that [`Reconstruct::Auto`] decides for, where that is another than the frame itself.
            #[serde(skip)]
            pub decide_for: Option<StillFrame>,
            /// How `auto` draws before normals and kernels are there.
            #[serde(skip)]
            pub wait: Wait,
            /// The frame draws its shadow maps itself, so that its time does not depend on earlier frames.
            #[serde(skip)]
            pub draws_maps: bool,
            /// Settings that the request gives, where a goal has the others chosen.
            #[serde(skip)]
            pub pinned: Pinned,
        }

        static DECLARED: LazyLock<Vec<Setting>> = LazyLock::new(|| vec![$(
            Setting {
                name: stringify!($name),
                label: $label,
                help: concat!($($doc),+).trim().to_owned(),
                kind: $kind,
                needs: vec![$($need),*],
                useful_with: vec![$($useful),*],
                trades: None$(.or(Some($trades)))?,
            },
        )+]);

        impl Given {
            /// Names of all settings, in the order of their declaration.
            pub const NAMES: &[&str] = &[$(stringify!($name)),+];

            /// Takes a value that was written as JSON; `null` takes what was given before away.
            ///
            /// # Errors
            /// A name that no setting has, or a value of another type.
            pub fn set(&mut self, name: &str, value: Value) -> Result<(), SettingError> {
                match name {
                    $( stringify!($name) => self.$name = read(stringify!($name), value)?, )+
                    _ => {
                        let accepted = Accepted::Values(Given::NAMES.join(", "));
                        let reason = format!("there is no setting `{name}`");
                        return Err(SettingError { setting: "", reason, accepted });
                    }
                }
                Ok(())
            }

            fn over(&self, defaults: &Given) -> Given {
                Given { $( $name: self.$name.or(defaults.$name), )+ }
            }
        }

        impl From<Given> for Settings {
            /// The settings without any check: a stored job was checked when it was made.
            fn from(given: Given) -> Settings {
                let settings = Settings {
                    $( $name: given.$name.map(<$used>::from).unwrap_or_default(), )+
                    ..Settings::default()
                };
                settings.with_pinned([$(given.$name.is_some()),+]).with_lod_of_error(&given)
            }
        }
    };
}

settings! {
    /// Projection of the camera; the camera's own by default. A converted camera keeps the height of its view at the
    /// target. The default view fills the frame.
    projection: Projection => Option<Projection> {
        label: "Projection", kind: SettingKind::scenes::<Projection>(), needs: [], useful_with: []
    }
    /// Size of an image, and the place of the frame's first pixel in it: `WIDTH,HEIGHT,X,Y`. The frame is that part of the image. The pose, the
    /// level of detail and the shadow maps are those of the whole image, so that parts fit together.
    part_of: ImagePart => Option<ImagePart> {
        label: "Part of image", kind: ImagePart::kind(), needs: [], useful_with: []
    }
    /// Boxes that the scene is clipped with, separated by `;`. `x,y,z,x,y,z` is a box's least and largest corner, and `*` leaves a bound open.
    /// Plain boxes keep their inside, and `outside:` boxes remove their inside. Without plain boxes, everything else stays.
    clip_boxes: ClipBoxes => Option<ClipBoxes> {
        label: "Clip boxes", kind: text::boxes(), needs: [], useful_with: []
    }
    /// Top-level node in whose coordinates the boxes are, and with which they move; the scene by default.
    clip_node: Name => Option<Name> {
        label: "Boxes of node", kind: text::name("the scene", "the name of a top-level node", &["0", "1"]), needs: [CLIPPED], useful_with: []
    }
    /// Longest GPU time of the frame, in milliseconds. The planner chooses the most exact level of detail, way to draw samples and antialiasing that were
    /// measured to keep it. What the request gives stays. The receipt says what was chosen, and why.
    budget_ms: f64 => Budget {
        label: "Time budget", kind: Budget::kind(), needs: [], useful_with: [COLORS]
    }
    /// Least peak signal-to-noise ratio of the frame against the reference, in decibels. The planner chooses the fastest level of detail,
    /// way to draw samples and antialiasing that were measured to keep it. What the request gives stays.
    min_psnr_db: f64 => MinPsnr {
        label: "Least PSNR", kind: MinPsnr::kind(), needs: [], useful_with: [COLORS]
    }
    /// Level of detail.
    lod: Lod => Lod {
        label: "Detail", kind: SettingKind::own::<Lod>(), needs: [], useful_with: [], trades: Trade::main()
    }
    /// Largest accepted error of the level of detail, in pixels. Without `lod` and without a goal, it asks for `lod=spt`: full detail or point
    /// trees, whichever takes less time.
    max_error_px: f64 => MaxError {
        label: "Error", kind: MaxError::kind(), needs: [TREES], useful_with: [], trades: Trade::main_at(&[0.25, 0.5, 1.0, 2.0, 4.0, 8.0])
    }
    /// How `lod=spt` measures the error of a splat.
    error_mode: ErrorMode => ErrorMode {
        label: "Error seen", kind: SettingKind::own::<ErrorMode>(),
        needs: [TREES, Rule::new("reconstruct", SPLATS.is, "points are selected by their size alone")],
        useful_with: [SURELY_SPLATS], trades: Trade::variant()
    }
    /// Meaning of the colours of surfaces.
    color_by: ColorBy => ColorBy, once "paint" {
        label: "Colours", kind: SettingKind::own::<ColorBy>(), needs: [TREES.for_value("levels")],
        useful_with: [COLORS, INTENSITIES, CLASSES, RETURNS, ANY_FIELD]
    }
    /// Scalar field that `color_by=field` shows.
    field: Name => Option<Name> {
        label: "Field", kind: text::name("none", "the name of a scalar field of the scene", &["intensity"]), needs: [FIELD],
        useful_with: [COLORS]
    }
    /// Colours of the values that `color_by` shows.
    color_map: ColorMap => ColorMap {
        label: "Colour map", kind: SettingKind::own::<ColorMap>(), needs: [MAPPED], useful_with: [COLORS]
    }
    /// Value that has the first colour of the map; the scene's least height, or a field's 1st percentile, by default.
    color_least: ColorBound => Option<ColorBound> {
        label: "First colour at", kind: ColorBound::kind(), needs: [MAPPED], useful_with: [COLORS]
    }
    /// Value that has the last colour of the map; the scene's largest height, or a field's 99th percentile, by default.
    color_most: ColorBound => Option<ColorBound> {
        label: "Last colour at", kind: ColorBound::kind(), needs: [MAPPED], useful_with: [COLORS]
    }
    /// Least width of lines, in pixels. With 0, lines keep their true width: a pixel shows a thinner line with a probability that
    /// equals the line's width. By default 1 in
    /// scenes whose lines would cover little of the image, and 0 in others.
    line_width_px: f64 => LineWidth {
        label: "Line width", kind: LineWidth::kind(), needs: [], useful_with: [SEGMENTS]
    }
    /// How samples are drawn. The receipt says what `auto` chose and why.
    reconstruct: Reconstruct => Reconstruct {
        label: "Samples as", kind: SettingKind::own::<Reconstruct>(), needs: [], useful_with: [SAMPLES], trades: Trade::main()
    }
    /// Least diameter of round points, in pixels. Above 1, `reconstruct=auto` draws points.
    point_size_px: f64 => PointSizePx {
        label: "Point size", kind: PointSizePx::kind(), needs: [POINTS], useful_with: [SAMPLES]
    }
    /// Diameter of round points in scene units, which shrinks with distance; 0 for none. Above 0, `reconstruct=auto` draws points.
    point_size: f64 => PointSize {
        label: "Point size in the scene", kind: PointSize::kind(), needs: [POINTS], useful_with: [SAMPLES]
    }
    /// Projection of splats to the image; the scene's value by default.
    filter: Filter => Option<Filter> {
        label: "Filter", kind: SettingKind::scenes::<Filter>(), needs: [SPLATS], useful_with: [SAMPLES, SURELY_SPLATS], trades: Trade::variant()
    }
    /// Whether splats are convolved with a low-pass filter of the image; the scene's value by default.
    prefilter: bool => Option<bool> {
        label: "Prefilter", kind: SettingKind::Flag, needs: [FILTERED], useful_with: [SAMPLES, SURELY_SPLATS], trades: Trade::variant()
    }
    /// How overlapping splats are combined; the scene's value by default.
    blend: Blend => Option<Blend> {
        label: "Blend", kind: SettingKind::scenes::<Blend>(), needs: [PASSES], useful_with: [SAMPLES, THREE_PASSES], trades: Trade::variant()
    }
    /// Whether lighting is computed for each pixel or for each splat; the scene's value by default.
    shading: Shading => Option<Shading> {
        label: "Light", kind: SettingKind::scenes::<Shading>(), needs: [PASSES],
        useful_with: [SAMPLES, THREE_PASSES, COLORS, WEIGHTED, LIT], trades: Trade::variant()
    }
    /// Whether suns and point lights cast the shadows that the scene asks for.
    shadows: Shadows => Shadows {
        label: "Shadows", kind: SettingKind::own::<Shadows>(), needs: [], useful_with: [COLORS, CASTING], trades: Trade::variant()
    }
    /// Side in pixels of the square that a light's shadow maps take. If the maps of all lights would have more pixels than a frame may have, the next
    /// smaller value is used. A larger value gives sharper edges.
    shadow_px: ShadowPx => ShadowPx {
        label: "Shadow map", kind: SettingKind::own::<ShadowPx>(), needs: [SHADOWS], useful_with: [COLORS, CASTING], trades: Trade::variant()
    }
    /// Whether the scene's ambient occlusion is drawn.
    ao: Effect => Effect {
        label: "Ambient occlusion", kind: SettingKind::own::<Effect>(), needs: [], useful_with: [COLORS, OCCLUDED, OCCLUDABLE], trades: Trade::variant()
    }
    /// Whether the scene's environment is drawn. Where it is off, ambient light as bright as its mean takes its place.
    environment: Effect => Effect {
        label: "Environment", kind: SettingKind::own::<Effect>(), needs: [], useful_with: [COLORS, SURROUNDED], trades: Trade::variant()
    }
    /// Whether the scene's fog is drawn.
    fog: Effect => Effect {
        label: "Fog", kind: SettingKind::own::<Effect>(), needs: [], useful_with: [COLORS, FOGGY], trades: Trade::variant()
    }
    /// Brightness of lit surfaces: each stop doubles the light that they reflect and give off.
    exposure: f64 => Exposure {
        label: "Exposure", kind: Exposure::kind(), needs: [], useful_with: [COLORS, LIT]
    }
    /// How light that lit surfaces reflect and give off becomes colours that can be shown.
    tone_map: ToneMap => ToneMap {
        label: "Tone map", kind: SettingKind::own::<ToneMap>(), needs: [], useful_with: [COLORS, LIT]
    }
    /// Weights of the samples around a gap that pull-push fills.
    pull_push_weights: PullPushWeights => PullPushWeights {
        label: "Gap weights", kind: SettingKind::own::<PullPushWeights>(), needs: [PULL_PUSH], useful_with: [SAMPLES], trades: Trade::variant()
    }
    /// What `reconstruct=painted` blends.
    painted_as: Painting => Painting {
        label: "Painted as", kind: SettingKind::own::<Painting>(), needs: [PAINTED], useful_with: [SAMPLES], trades: Trade::variant()
    }
    /// Eye-dome lighting: darkens pixels whose neighbours are nearer (Boucheny 2009). `auto` uses it for samples that have no normals and
    /// are not lit.
    edl: Edl => Edl {
        label: "Eye-dome light", kind: SettingKind::own::<Edl>(), needs: [], useful_with: [COLORS]
    }
    /// Strength of eye-dome lighting.
    edl_strength: f64 => EdlStrength {
        label: "Strength", kind: EdlStrength::kind(), needs: [EDL], useful_with: [COLORS]
    }
    /// Distance of the neighbours that eye-dome lighting compares a pixel with, in pixels.
    edl_radius_px: f64 => EdlRadius {
        label: "Radius", kind: EdlRadius::kind(), needs: [EDL], useful_with: [COLORS]
    }
    /// Antialiasing: pixels are means of their parts, in linear light.
    antialias: Antialias => Antialias {
        label: "Antialiasing", kind: SettingKind::own::<Antialias>(), needs: [], useful_with: [COLORS], trades: Trade::large_variant()
    }
    /// Diameter of the camera's lens in scene units, for depth of field; 0 is a pinhole, which shows everything sharp. A camera with parallel rays
    /// has no lens.
    aperture: f64 => Aperture {
        label: "Aperture", kind: Aperture::kind(), needs: [], useful_with: [COLORS]
    }
    /// Distance along the viewing axis at which things are sharp, in scene units; by default that of the camera's target.
    focus_distance: f64 => FocusDistance {
        label: "Focus distance", kind: FocusDistance::kind(), needs: [APERTURE], useful_with: [COLORS]
    }
    /// Share of the time between two frames of a camera path for which the shutter is open, for motion blur: 0.5 is a shutter of 180 degrees. The time of
    /// the frame is its middle. A frame that belongs to no path shows an instant.
    shutter: f64 => Shutter {
        label: "Shutter", kind: Shutter::kind(), needs: [], useful_with: [COLORS]
    }
    /// Number of exposures that are averaged into a frame with an aperture or an open shutter. Each exposure has its own point on the lens, its own time
    /// and its own points within the pixels. Without an aperture or an open shutter, only the default is accepted.
    blur_samples: BlurSamples => BlurSamples {
        label: "Exposures", kind: SettingKind::own::<BlurSamples>(), needs: [], useful_with: [COLORS, BLURRED]
    }
    /// Shift of the eye to the right in scene units, for one image of a stereo pair: minus or plus half the distance between the eyes. What lies at
    /// `stereo_distance` keeps its place in the image. A camera with parallel rays has no such images.
    eye_offset: f64 => EyeOffset {
        label: "Eye offset", kind: EyeOffset::kind(), needs: [], useful_with: []
    }
    /// Distance along the viewing axis of what both images of a stereo pair show in the same place, in scene units; by default that of the camera's
    /// target.
    stereo_distance: f64 => FocusDistance {
        label: "Stereo distance", kind: FocusDistance::kind(), needs: [SHIFTED], useful_with: []
    }
    /// Colour of pixels that show nothing; the scene's value by default. JPEG and video cannot store transparency and show black.
    background: Background => Option<Background> {
        label: "Background", kind: Background::kind(), needs: [], useful_with: [COLORS]
    }
}

/// All settings, in the order of their declaration.
pub fn declared() -> &'static [Setting] {
    &DECLARED
}

fn declaration(name: &str) -> Option<&'static Setting> {
    DECLARED.iter().find(|setting| setting.name == name)
}

fn words(settings: &impl Serialize) -> Map<String, Value> {
    match serde_json::to_value(settings) {
        Ok(Value::Object(words)) => words,
        // Words, numbers and truth values always have a form in JSON.
        _ => Map::new(),
    }
}

/// Those settings among `known` whose needs are met and that `is_asked` lets pass. Those in `open` are yet to be chosen.
fn kept(known: &Map<String, Value>, open: &[&str], is_asked: impl Fn(&Setting) -> bool) -> Given {
    let mut given = Given::default();
    for setting in declared().iter().filter(|setting| !open.contains(&setting.name)) {
        let is_met = |value, rule: &Rule| open.contains(&rule.of) || rule.allows(value, known);
        if let Some(value) = known.get(setting.name)
            && setting.needs.iter().all(|rule| is_met(Some(value), rule))
            && is_asked(setting)
        {
            // Comes of the same type.
            let _ = given.set(setting.name, value.clone());
        }
    }
    given
}

impl Settings {
    /// Every setting whose needs among the other settings are met: the form in which jobs are stored. [`Settings::affecting`] also asks the
    /// output and the scene.
    #[must_use]
    pub fn applied(&self) -> Given {
        kept(&words(self), &self.open(), |_| true)
    }

    /// The canonical form: those applied settings that affect the pixels of an output of a scene. Receipts list them, and tags hash them.
    /// `self` leaves nothing to `auto` or to the scene.
    #[must_use]
    pub fn affecting(&self, scene: &SceneFacts, output: Output) -> Given {
        let some = |count: u64| if count > 0 { "some" } else { "none" };
        let mut known = words(self);
        known.insert("samples".to_owned(), some(scene.counts.samples).into());
        known.insert("segments".to_owned(), some(scene.counts.segments).into());
        known.insert("lights".to_owned(), some(scene.lights.into()).into());
        known.insert("casting_lights".to_owned(), some(scene.casting_lights.into()).into());
        known.insert("scene_occlusion".to_owned(), some(scene.occlusion.into()).into());
        known.insert("scene_environment".to_owned(), some(scene.environment.into()).into());
        known.insert("scene_fog".to_owned(), some(scene.fog.into()).into());
        known.insert("blur".to_owned(), some(self.is_blurred().into()).into());
        known.insert("output".to_owned(), serde_json::json!(output));
        let are_lit_singly =
            [THREE_PASSES, WEIGHTED, LIT_SINGLY, LIT].iter().all(|rule| rule.holds(&known));
        let is_occludable = !SAMPLES.holds(&known) || DEPTHS.holds(&known) && !are_lit_singly;
        known.insert("occludable".to_owned(), some(is_occludable.into()).into());
        let is_open = |rule: &Rule| known.get(rule.of).is_none_or(Value::is_null);
        kept(&known, &self.open(), |setting| {
            // Rules of single values say what can be drawn at all.
            let mut rules = setting.useful_with.iter().filter(|rule| rule.value.is_none());
            rules.all(|rule| is_open(rule) || rule.holds(&known))
        })
    }
}

#[cfg(test)]
mod tests;
