//! Values of settings, and what they mean for a frame.

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::numbers::{ColorBound, MaxError, PointSizePx};
use super::{Given, SettingKind, Settings};
use crate::assets::fields::{CLASSIFICATION, INTENSITY, RETURN_NUMBER};
use crate::plan::Reconstruction;
use crate::plan::SceneFacts;
use crate::scene::fields::SceneField;
use crate::scene::name::Name;
use crate::scene::recolor::Recolor;
use crate::scene::{Blend, Discs, EyeDome, Shading, color};
use crate::words::words;

/// How long a frame waits for normals and kernels that its samples lack, where it is left open how they are drawn.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, utoipa::ToSchema,
)]
#[serde(rename_all = "snake_case")]
pub enum Wait {
    /// Nothing: it shows points, and its receipt says that this is provisional.
    #[default]
    Ready,
    /// All that this frame needs.
    Complete,
    /// All that any frame of the scene may need, so that frames of a film are drawn alike.
    #[serde(skip)]
    Whole,
}

/// A still frame, which frames of a moving pose stand in for: all of them are drawn alike.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct StillFrame {
    pub height: u32,
    pub max_error: MaxError,
    /// Parts along each side of a pixel.
    pub parts: u32,
}

impl Given {
    /// Accepted error in pixels.
    pub fn accepted_px(&self) -> Option<f64> {
        self.max_error_px
    }
}

impl Given {
    /// Whether it matters how samples are drawn, for settings that list what affects a frame.
    pub fn draws_samples(&self) -> bool {
        self.reconstruct.is_some()
    }
}

impl Settings {
    /// The defaults, with samples drawn in a given way.
    pub fn drawn_as(reconstruct: Reconstruct) -> Settings {
        Settings { reconstruct, ..Settings::default() }
    }

    /// Whether it is left open how samples are drawn.
    pub fn leaves_drawing_open(&self) -> bool {
        self.reconstruct == Reconstruct::Auto
    }

    /// Whether samples are drawn as points, round or of one pixel.
    pub fn draws_points(&self) -> bool {
        self.reconstruct == Reconstruct::Points
    }

    /// The settings with samples drawn in a given way.
    #[must_use]
    pub fn decided(&self, reconstruct: Reconstruct) -> Settings {
        Settings { reconstruct, ..*self }
    }

    /// Whether the request says how splats are drawn.
    pub fn has_splat_choices(&self) -> bool {
        let Settings { filter, prefilter, blend, shading, .. } = self;
        filter.is_some() || prefilter.is_some() || blend.is_some() || shading.is_some()
    }

    /// The settings with samples drawn as others draw them.
    #[must_use]
    pub fn drawn_like(&self, other: &Settings) -> Settings {
        self.decided(other.reconstruct)
    }

    /// Whether point trees are drawn in place of all samples and triangles.
    pub fn draws_trees(&self) -> bool {
        self.lod == Lod::Spt
    }

    /// The settings with `edl` on or off.
    #[must_use]
    pub fn with_edl_decided(&self, scene: &SceneFacts, output: Output) -> Settings {
        let is_shapeless =
            scene.counts.samples > 0 && scene.counts.triangles == 0 && !scene.has_normals;
        let is_used = match self.edl {
            Edl::Auto => {
                let has_depths =
                    !matches!(self.reconstruct, Reconstruct::Fuzzy | Reconstruct::Painted);
                is_shapeless && scene.lights == 0 && has_depths
            }
            Edl::On => true,
            Edl::Off => false,
        };
        let edl = if is_used && output == Output::Color { Edl::On } else { Edl::Off };
        Settings { edl, ..*self }
    }

    /// The settings without eye-dome lighting, which some ways to draw samples leave out.
    #[must_use]
    pub fn comparable(&self) -> Settings {
        Settings { edl: Edl::Off, ..*self }
    }

    /// The settings of a frame that waits for everything that it needs.
    #[must_use]
    pub fn complete(&self) -> Settings {
        Settings { wait: Wait::Complete, ..*self }
    }

    /// The settings with the least width of lines decided: lines that would be lost as scattered pixels are a pixel wide.
    #[must_use]
    pub fn with_line_width_decided(&self, scene: &SceneFacts) -> Settings {
        Settings { line_width_px: self.line_width_px.decided(scene.sparse_lines), ..*self }
    }

    /// The settings with antialiasing decided: colours alone are averaged.
    #[must_use]
    pub fn with_antialias_decided(&self, output: Output) -> Settings {
        let antialias = if output == Output::Color { self.antialias } else { Antialias::Off };
        Settings { antialias, ..*self }
    }

    /// Parts along each side of a pixel.
    pub fn parts(&self) -> u32 {
        match self.antialias {
            Antialias::Off => 1,
            Antialias::Parts4 => 2,
            Antialias::Parts16 => 4,
        }
    }

    /// Least width of lines, in pixels.
    pub fn least_line_px(&self) -> f32 {
        self.line_width_px.px()
    }

    /// The settings with points that are no smaller than `px` pixels, where samples are drawn as points.
    #[must_use]
    pub fn with_point_size(&self, px: Option<f64>) -> Settings {
        let size = px.and_then(|px| PointSizePx::new(px as f32));
        match size.filter(|size| size.get() > self.point_size_px.get()) {
            Some(point_size_px) if self.draws_points() => Settings { point_size_px, ..*self },
            _ => *self,
        }
    }

    /// The settings with the level of detail that an accepted error asks for where no other is given. A goal leaves it open.
    pub(super) fn with_lod_of_error(self, given: &Given) -> Settings {
        let is_alone = given.lod.is_none() && given.max_error_px.is_some();
        if is_alone && self.goal().is_none() { Settings { lod: Lod::Spt, ..self } } else { self }
    }

    /// The settings with the level of detail that they would have without their goal.
    pub(super) fn with_lod_without_goal(&self) -> Settings {
        let open = self.open();
        let is_alone = open.contains(&"lod") && !open.contains(&"max_error_px");
        if is_alone { Settings { lod: Lod::Spt, ..*self } } else { *self }
    }

    /// Accepted error of `lod=spt` in pixels.
    pub fn accepted_px(&self) -> f32 {
        self.max_error_px.px()
    }

    /// Accepted error of `lod=spt`.
    pub fn accepted_error(&self) -> MaxError {
        self.max_error_px
    }

    /// The settings with another accepted error.
    #[must_use]
    pub fn accepting(&self, error: MaxError) -> Settings {
        Settings { max_error_px: error, ..*self }
    }

    /// Accepted error in pixels of a frame that is asked for with `lod=spt`.
    pub fn accepted_px_of_trees(&self) -> Option<f32> {
        self.draws_trees().then(|| self.accepted_px())
    }

    /// A still frame of these settings.
    pub fn still_frame(&self, height: u32) -> StillFrame {
        StillFrame { height, max_error: self.max_error_px, parts: self.parts() }
    }

    /// Makes these the settings of a frame that stands in for a still one: it may have another error, and has neither
    /// antialiasing nor blur. `auto` decides for the still one.
    pub fn stand_in_for(&mut self, still: StillFrame, error: MaxError) {
        *self = self.without_blur();
        self.decide_for = Some(still);
        self.antialias = Antialias::Off;
        self.max_error_px = error;
    }

    /// Parts along each side of a pixel for which `auto` decides how samples are drawn.
    pub fn decisive_parts(&self) -> u32 {
        self.decide_for.map_or(self.parts(), |still| still.parts)
    }

    /// The accepted error for which `auto` decides how samples are drawn.
    pub fn decisive_error(&self) -> MaxError {
        self.decide_for.map_or(self.max_error_px, |still| still.max_error)
    }

    /// Whether points are larger than a pixel.
    pub fn has_point_size(&self) -> bool {
        self.point_size_px != PointSizePx::default() || self.point_size.get() > 0.0
    }

    /// Discs that samples are drawn as; `None` for splats and for points of one pixel. Points that cover several parts of a pixel, and
    /// nodes of point trees that may be larger than a pixel, are discs as well.
    pub fn discs(&self) -> Option<Discs> {
        let (diameter_px, diameter) = (self.point_size_px.get(), self.point_size.get());
        let has_large_nodes = self.draws_trees() && self.accepted_px() > 1.0;
        let is_larger = self.has_point_size() || has_large_nodes || self.parts() > 1;
        (self.draws_points() && is_larger).then_some(Discs { diameter_px, diameter })
    }

    /// Whether colours come from the resolved surface, not from samples and materials.
    pub fn recolors(&self) -> bool {
        matches!(self.color_by, ColorBy::Height | ColorBy::Normal | ColorBy::Instance)
    }

    /// Whether nodes of point trees show their height above the leaves.
    pub fn shows_levels(&self) -> bool {
        self.color_by == ColorBy::Levels
    }

    /// The scalar field that colours samples, if `color_by` names one.
    pub fn colored_field(&self) -> Option<Name> {
        let name = match self.color_by {
            ColorBy::Intensity => INTENSITY,
            ColorBy::Classification => CLASSIFICATION,
            ColorBy::ReturnNumber => RETURN_NUMBER,
            ColorBy::Field => return self.field,
            _ => return None,
        };
        name.parse().ok()
    }

    /// The value that colours surfaces, if it is not their own colours; `up` and `heights` are the scene's up direction and its least and largest
    /// height along it.
    pub fn recolor(
        &self,
        up: DVec3,
        heights: impl FnOnce() -> [f64; 2],
        fields: &[SceneField],
    ) -> Option<Recolor> {
        let map = self.color_map;
        let within = |[least, most]: [f64; 2]| {
            let own = [self.color_least, self.color_most];
            // A bound that is not given makes way for one beyond it, so that the range keeps its direction.
            let extent = if most > least { most - least } else { 1.0 };
            match own.map(|bound| bound.map(ColorBound::get)) {
                [Some(own), None] if own >= most => [own, own + extent],
                [None, Some(own)] if own <= least => [own - extent, own],
                [own_least, own_most] => [own_least.unwrap_or(least), own_most.unwrap_or(most)],
            }
        };
        match self.color_by {
            ColorBy::Colors | ColorBy::Levels => None,
            ColorBy::Normal => Some(Recolor::Normal),
            ColorBy::Instance => Some(Recolor::Instance),
            ColorBy::Height => Some(Recolor::Height { up, range: within(heights()), map }),
            ColorBy::Intensity
            | ColorBy::Classification
            | ColorBy::ReturnNumber
            | ColorBy::Field => {
                let name = self.colored_field()?;
                let field = fields.iter().find(|field| field.name == name.as_str())?;
                let (range, has_classes) = (within(field.shown), field.classes.is_some());
                Some(Recolor::Field { name, range, map, has_classes })
            }
        }
    }

    /// Eye-dome lighting, if it is on.
    pub fn eye_dome(&self) -> Option<EyeDome> {
        (self.edl == Edl::On).then(|| EyeDome {
            strength: self.edl_strength.get(),
            radius_px: self.edl_radius_px.get(),
        })
    }

    /// The settings, with the scene's values where they have none.
    #[must_use]
    pub fn settled(&self, reconstruction: &Reconstruction) -> Settings {
        let splats = reconstruction.splats().filter(|_| reconstruction.pull_push().is_none());
        splats.map_or(*self, |splats| Settings {
            filter: Some(splats.filter),
            prefilter: Some(splats.prefilter),
            blend: Some(splats.blend),
            shading: Some(splats.shading),
            ..*self
        })
    }

    /// Returns the settings with samples drawn as splats, for a frame that pull-push cannot draw.
    pub fn as_splats(&self) -> Settings {
        Settings { reconstruct: Reconstruct::Splats, ..*self }
    }

    /// Returns the settings with splats drawn in three passes, for a frame that a single pass cannot draw.
    pub fn in_three_passes(&self) -> Settings {
        Settings {
            reconstruct: Reconstruct::Splats,
            blend: Some(Blend::Weighted),
            shading: Some(Shading::Splat),
            ..*self
        }
    }
}

const BACKGROUND_PATTERN: &str = "^(transparent|#?([0-9a-fA-F]{3}|[0-9a-fA-F]{6}|[0-9a-fA-F]{8}))$";

/// A colour of the background: sRGB and straight alpha, a byte each.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Background([u8; 4]);

impl Background {
    pub(super) const TRANSPARENT: Background = Background([0; 4]);

    pub(super) fn kind() -> SettingKind {
        SettingKind::Text {
            default: "the scene’s",
            accepted: "transparent, #rgb, #rrggbb or #rrggbbaa",
            pattern: BACKGROUND_PATTERN.to_owned(),
            examples: &["transparent", "#000000", "#ffffff"],
        }
    }

    /// Linear RGB and straight alpha.
    pub fn linear(self) -> [f32; 4] {
        color::to_linear(self.0.map(|byte| f64::from(byte) / 255.0))
    }
}

impl std::fmt::Display for Background {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.0 {
            [0, 0, 0, 0] => write!(f, "transparent"),
            [r, g, b, 255] => write!(f, "#{r:02x}{g:02x}{b:02x}"),
            [r, g, b, a] => write!(f, "#{r:02x}{g:02x}{b:02x}{a:02x}"),
        }
    }
}

impl std::str::FromStr for Background {
    type Err = String;

    /// `#` may be left out: it would end a URL.
    fn from_str(text: &str) -> Result<Background, String> {
        if text.is_empty() {
            return Err(
                "no colour is given; in an address, `#` is written `%23` or left out".to_owned()
            );
        }
        if text == "transparent" {
            return Ok(Background([0; 4]));
        }
        let digits = text.strip_prefix('#').unwrap_or(text);
        let channels = color::parse_hex(&format!("#{digits}"));
        let shown = || text.chars().take(64).collect::<String>();
        let channels = channels.ok_or_else(|| format!("`{}` is not a colour", shown()))?;
        Ok(Background(channels.map(|channel| (channel * 255.0).round() as u8)))
    }
}

crate::json::as_text!(Background, BACKGROUND_PATTERN);

words! {
    /// When eye-dome lighting is used.
    pub enum Edl {
        /// For samples that have no normals and are not lit, except with `reconstruct=fuzzy` and `painted`
        #[default]
        Auto,
        /// Always; `reconstruct=fuzzy` and `painted` are drawn in three passes instead
        On,
        /// Never
        Off,
    }

    /// Level of detail.
    pub enum Lod {
        /// Every sample and triangle.
        #[default]
        Full,
        /// As fine as the accepted error asks for, from sequential point trees (Dachsbacher et al. 2003).
        Spt,
    }

    /// How the error of a point tree's node is measured (Dachsbacher et al. 2003, §3.4).
    pub enum ErrorMode {
        /// Errors are the same from every angle, so that the accepted error holds everywhere
        #[default]
        Unified,
        /// Errors depend on the viewing angle, which draws fewer nodes. The outline of a surface seen at an angle may be off by twice the
        /// accepted error.
        Split,
    }

    /// Parts of a pixel that are averaged.
    pub enum Antialias {
        /// A pixel shows what its centre shows
        #[default]
        #[serde(rename = "off")]
        #[value(name = "off")]
        Off,
        /// Mean of 2 × 2 parts
        #[serde(rename = "4x")]
        #[value(name = "4x")]
        Parts4,
        /// Mean of 4 × 4 parts
        #[serde(rename = "16x")]
        #[value(name = "16x")]
        Parts16,
    }

    /// Meaning of the colours of surfaces.
    pub enum ColorBy {
        /// Colours of the file
        #[default]
        Colors,
        /// Height of each node above the leaves of its tree (Dachsbacher et al. 2003, Fig. 1)
        Levels,
        /// Distance along the scene's up direction
        Height,
        /// World-space normal: x, y and z as red, green and blue
        Normal,
        /// A hue for each instance
        Instance,
        /// Strength of the returned signal, of samples whose file has it
        Intensity,
        /// Class of each sample, in the customary colours of ASPRS classes
        Classification,
        /// Number of the return among those of its pulse
        ReturnNumber,
        /// Any scalar field of the file; `field` names it
        Field,
    }

    /// How a surface is made of projected samples.
    pub enum Reconstruct {
        /// Points where samples are denser than pixels, splats where they are not.
        #[default]
        Auto = 3,
        /// One pixel a sample, or round points of `point_size`.
        Points = 0,
        /// Elliptical Gaussians in the samples' tangent planes (Zwicker et al. 2004).
        Splats = 1,
        /// Splats that are blended and depth-tested in a single pass (Dachsbacher et al. 2003, §5): faster, coarser in weights and depths.
        Fuzzy = 2,
        /// Splats that are sorted by distance and blended in that order (Coconu & Hege 2002): smooth outlines, and what is behind thin
        /// things shows through.
        Painted = 5,
        /// One pixel a sample, and gaps filled from coarser levels of the image (Marroquim et al. 2008): costs what the pixels cost, however
        /// large the splats would be.
        PullPush = 4,
    }

    /// Which image of the frame is wanted.
    pub enum Output {
        /// Shaded sRGB, straight alpha.
        #[default]
        Color,
        /// Distance along the viewing axis in scene units; infinite where nothing is.
        Depth,
        /// World-space unit normals, `n · ½ + ½` in the colour channels.
        Normal,
        /// Which instance covers the pixel, see [`crate::encode::FrameImage::Id`].
        Id,
    }
}
