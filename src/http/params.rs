//! Frame parameters, from a query string or from JSON, turned into a [`FrameRequest`].
//!
//! Both notations share one struct and one list of names. A name that is unknown, given twice, or known but not available in this
//! version is refused, and the problem says what would be accepted. Values are checked, never clamped. The engine enforces the
//! limits on sizes.

mod check;
mod names;

use std::time::{Duration, Instant};

use glam::{DMat4, DVec3};
use serde::Deserialize;
use serde::de::{DeserializeOwned, IntoDeserializer, value::StrDeserializer};
use utoipa::{IntoParams, ToSchema};

pub use check::{MAX_DEADLINE_MS, MAX_NAME_CHARS, QUALITY_RANGE};
pub use names::{Names, check_name, names, unknown_name};

use super::problem::{Kind, Problem};
use crate::encode::ImageFormat;
use crate::engine::{FrameRequest, Pose};
use crate::json::{self, whole};
use crate::math::{Camera, Lens, Projection, View};
use crate::plan::{Given, Output, SettingError, Settings, Wait};
use crate::scene::{Up, UpForm};
use crate::spelling::suggestion;

/// Default width and height of a frame.
pub const DEFAULT_SIDE: u32 = 1024;
/// Default quality of lossy formats.
pub const DEFAULT_QUALITY: u8 = 85;
/// Default vertical field of view in degrees.
pub const DEFAULT_FOV_DEG: f64 = 40.0;

/// Subject and settings of a frame. The pose is `camera`, or `eye` and `target` (with `up`, and `fov` or `ortho_height`), or
/// `view` and `proj`; without any, the whole scene is shown, to which `up`, and `fov` or `ortho_height`, apply as well.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, ToSchema, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct FrameParams {
    /// Name of a camera in the scene. In a frame that is higher than wide, the camera's field of view applies to the width, up to a
    /// vertical field of view of 100 degrees. The frame then shows as much from side to side as a square one.
    pub camera: Option<String>,
    /// Position of the eye in world space: `x,y,z`.
    #[param(style = Form, explode = false)]
    pub eye: Option<[f64; 3]>,
    /// Point that the eye looks at, in world space: `x,y,z`.
    #[param(style = Form, explode = false)]
    pub target: Option<[f64; 3]>,
    /// Up direction: `x`, `y`, `z`, `-x`, `-y`, `-z` or `x,y,z`. The default is the scene's own (`up` of
    /// `GET /v1/scenes/{id}`). Without `eye` and `target`, the frame shows the whole scene with this direction up.
    #[param(style = Form, explode = false, value_type = Option<UpForm>)]
    #[schema(value_type = Option<UpForm>)]
    pub up: Option<Up>,
    /// Vertical field of view in degrees; default 40. Without `eye` and `target`, the frame shows the whole scene with this field of view.
    pub fov: Option<f64>,
    /// Height of the view in scene units, in place of `fov`: the projection is orthographic, and what lies behind the eye is not drawn.
    /// glTF's `ymag` is half of it.
    pub ortho_height: Option<f64>,
    /// World → view, 16 numbers, column-major; rotation and translation only. Needs `proj`.
    #[param(style = Form, explode = false)]
    pub view: Option<[f64; 16]>,
    /// View → clip, 16 numbers, column-major; a perspective with last row `0 0 -1 0` or an orthographic projection with last row `0 0 0 1`. Near and far
    /// are not used. Needs `view`.
    #[param(style = Form, explode = false)]
    pub proj: Option<[f64; 16]>,
    /// Width in pixels; default 1024.
    #[serde(default, deserialize_with = "whole::optional")]
    pub w: Option<u32>,
    /// Height in pixels; default 1024.
    #[serde(default, deserialize_with = "whole::optional")]
    pub h: Option<u32>,
    /// Image format. Without it, the `Accept` header decides; if that allows several formats, PNG is preferred.
    #[param(value_type = Option<ImageFormat>)]
    #[schema(value_type = Option<ImageFormat>)]
    pub format: Option<String>,
    /// Quality of lossy formats, 1 to 100; default 85.
    #[serde(default, deserialize_with = "whole::optional")]
    pub quality: Option<u8>,
    /// Kind of image: colour, depth, normals or ids.
    #[param(value_type = Option<Output>)]
    #[schema(value_type = Option<Output>)]
    pub output: Option<String>,
    /// How the frame is drawn: the other parameters.
    #[serde(skip)]
    pub settings: Given,
    /// Behaviour of `reconstruct=auto` before the normals and kernels of a large cloud are estimated: `ready` draws points at once and
    /// marks the answer as provisional, `complete` waits. All other frames wait for the data that they need.
    #[param(value_type = Option<Wait>)]
    #[schema(value_type = Option<Wait>)]
    pub wait: Option<String>,
    /// Milliseconds until the frame is useless to the client. The server drops work that has not begun by then. It estimates the wait
    /// from the queue and the cost of earlier frames, and refuses at once a frame that would be late, with a `Retry-After`.
    pub deadline_ms: Option<f64>,
}

/// Splits a query string into decoded names and values.
pub fn pairs(query: Option<&str>) -> Result<Vec<(String, String)>, Problem> {
    let Some(query) = query.filter(|q| !q.is_empty()) else { return Ok(Vec::new()) };
    let uri =
        axum::http::Uri::builder().path_and_query(format!("/?{query}")).build().map_err(|_| {
            Problem::new(Kind::BadParameter, "the query string is not valid percent-encoded UTF-8")
        })?;
    axum::extract::Query::<Vec<(String, String)>>::try_from_uri(&uri)
        .map(|axum::extract::Query(pairs)| pairs)
        .map_err(|_| {
            Problem::new(Kind::BadParameter, "the query string is not valid percent-encoded UTF-8")
        })
}

impl FrameParams {
    /// Reads a query string.
    pub fn from_query(query: Option<&str>) -> Result<Self, Problem> {
        Self::from_query_as(query, &Names::FRAME)
    }

    /// Reads a query string whose names `names` accepts. `names` must have no names of its `own`.
    pub fn from_query_as(query: Option<&str>, names: &Names) -> Result<Self, Problem> {
        let mut params = FrameParams::default();
        for (name, value) in pairs(query)? {
            names.check(&name)?;
            params.set(&name, &value)?;
        }
        Ok(params)
    }

    /// Sets one parameter of a query. [`check_name`] must have accepted the name.
    pub fn set(&mut self, name: &str, value: &str) -> Result<(), Problem> {
        const SIDE: &str = "a whole number of pixels, at least 1";
        const DEGREES: &str = "a number of degrees";
        match name {
            "camera" => once(&mut self.camera, name, value.to_owned()),
            "eye" => once(&mut self.eye, name, numbers(name, value)?),
            "target" => once(&mut self.target, name, numbers(name, value)?),
            "up" => once(&mut self.up, name, number(name, value, Up::ACCEPTED)?),
            "fov" => once(&mut self.fov, name, number(name, value, DEGREES)?),
            "ortho_height" => {
                once(&mut self.ortho_height, name, number(name, value, "a number of scene units")?)
            }
            "view" => once(&mut self.view, name, numbers(name, value)?),
            "proj" => once(&mut self.proj, name, numbers(name, value)?),
            "w" => once(&mut self.w, name, integer(name, value, SIDE)?),
            "h" => once(&mut self.h, name, integer(name, value, SIDE)?),
            "format" => once(&mut self.format, name, value.to_owned()),
            "quality" => once(&mut self.quality, name, integer(name, value, "1 to 100")?),
            "output" => once(&mut self.output, name, value.to_owned()),
            "wait" => once(&mut self.wait, name, value.to_owned()),
            "deadline_ms" => {
                once(&mut self.deadline_ms, name, number(name, value, "milliseconds above 0")?)
            }
            _ => Ok(self.settings.set_text(name, value)?),
        }
    }

    /// Reads a JSON object. `place` is its place in the body (`poses[3]`, or empty).
    pub fn from_json(value: serde_json::Value, place: &str) -> Result<Self, Problem> {
        let locate = |name: &str| match place {
            "" => name.to_owned(),
            place => format!("{place}.{name}"),
        };
        let mut value = value;
        let mut settings = Given::default();
        if let Some(object) = value.as_object_mut() {
            for name in object.keys() {
                check_name(name).map_err(|problem| problem.at(locate(name)))?;
            }
            for name in Given::NAMES {
                let Some(value) = object.remove(*name) else { continue };
                settings.set(name, value).map_err(|error| Problem::from(error).at(locate(name)))?;
            }
        }
        let params: FrameParams = serde_path_to_error::deserialize(value).map_err(|error| {
            let path = error.path().to_string();
            let at = if path == "." { place.to_owned() } else { locate(&path) };
            Problem::new(
                Kind::BadBody,
                format!("{at}: {}", json::plain(&error.inner().to_string())),
            )
            .at(at)
        })?;
        Ok(FrameParams { settings, ..params })
    }

    /// Fills missing parameters from `defaults`. A pose that is given in another way replaces the pose of the defaults as a
    /// whole; `up`, `fov`, `ortho_height` and `proj` are inherited only by a pose of their own kind. [`Given::or`] says how
    /// settings are inherited.
    pub fn or(self, defaults: &FrameParams) -> FrameParams {
        let posed = self.pose_parameter().is_some();
        let empty = FrameParams::default();
        let is_sized = self.fov.is_some() || self.ortho_height.is_some();
        let by_eye = self.eye.is_some() || self.target.is_some() || self.up.is_some() || is_sized;
        let by_matrix = self.view.is_some() || self.proj.is_some();
        let of = |yes: bool| if yes || !posed { defaults } else { &empty };
        let (camera, eye, matrix) = (of(false), of(by_eye), of(by_matrix));
        FrameParams {
            camera: self.camera.or_else(|| camera.camera.clone()),
            eye: self.eye.or(eye.eye),
            target: self.target.or(eye.target),
            up: self.up.or(eye.up),
            // One replaces the other.
            fov: if is_sized { self.fov } else { eye.fov },
            ortho_height: if is_sized { self.ortho_height } else { eye.ortho_height },
            view: self.view.or(matrix.view),
            proj: self.proj.or(matrix.proj),
            w: self.w.or(defaults.w),
            h: self.h.or(defaults.h),
            format: self.format.or_else(|| defaults.format.clone()),
            quality: self.quality.or(defaults.quality),
            output: self.output.or_else(|| defaults.output.clone()),
            settings: self.settings.or(&defaults.settings),
            wait: self.wait.or_else(|| defaults.wait.clone()),
            deadline_ms: self.deadline_ms.or(defaults.deadline_ms),
        }
    }

    /// The name of a parameter that sets the pose, if there is one.
    pub fn pose_parameter(&self) -> Option<&'static str> {
        [
            ("camera", self.camera.is_some()),
            ("eye", self.eye.is_some()),
            ("target", self.target.is_some()),
            ("up", self.up.is_some()),
            ("fov", self.fov.is_some()),
            ("ortho_height", self.ortho_height.is_some()),
            ("view", self.view.is_some()),
            ("proj", self.proj.is_some()),
        ]
        .into_iter()
        .find_map(|(name, is_given)| is_given.then_some(name))
    }

    /// The requested output.
    pub fn output(&self) -> Result<Output, Problem> {
        choice("output", self.output.as_deref())
    }

    /// The requested format, if one is named.
    pub fn format(&self) -> Result<Option<ImageFormat>, Problem> {
        self.format.as_deref().map(|name| choice("format", Some(name))).transpose()
    }

    /// Builds the frame request. Its deadline counts from `now`.
    pub fn request(
        &self,
        scene: &str,
        format: ImageFormat,
        now: Instant,
    ) -> Result<FrameRequest, Problem> {
        self.check()?;
        let (width, height) = (self.w.unwrap_or(DEFAULT_SIDE), self.h.unwrap_or(DEFAULT_SIDE));
        let quality = self.quality.unwrap_or(DEFAULT_QUALITY);
        Ok(FrameRequest {
            scene: scene.to_owned(),
            pose: self.pose(width, height)?,
            width,
            height,
            settings: self.settings()?,
            output: self.output()?,
            format,
            quality,
            deadline: self
                .deadline_ms
                .and_then(|ms| now.checked_add(Duration::from_secs_f64(ms / 1000.0))),
        })
    }

    fn settings(&self) -> Result<Settings, Problem> {
        let wait = choice("wait", self.wait.as_deref())?;
        Ok(Settings { wait, ..self.settings.resolve()? })
    }

    fn pose(&self, width: u32, height: u32) -> Result<Pose, Problem> {
        const WAYS: &str = "`camera`, or `eye` and `target`, or `view` and `proj`, or none of them; `up`, and `fov` or `ortho_height`, with `eye` or alone";
        let by_eye = [
            ("eye", self.eye.is_some()),
            ("target", self.target.is_some()),
            ("up", self.up.is_some()),
            ("fov", self.fov.is_some()),
            ("ortho_height", self.ortho_height.is_some()),
        ];
        let by_eye = by_eye.iter().find(|(_, given)| *given).map(|(name, _)| *name);
        let by_matrix = match (self.view, self.proj) {
            (Some(_), _) => Some("view"),
            (None, Some(_)) => Some("proj"),
            (None, None) => None,
        };
        let camera = self.camera.as_ref().map(|_| "camera");
        let ways: Vec<&str> = [camera, by_eye, by_matrix].into_iter().flatten().collect();
        if let [first, second, ..] = ways[..] {
            return Err(Problem::parameter(
                second,
                format!("cannot be given together with `{first}`"),
                WAYS,
            ));
        }
        if self.ortho_height.is_some() {
            let perspective = self.settings.projection == Some(Projection::Perspective);
            if let Some(other) = if self.fov.is_some() {
                Some("fov")
            } else {
                perspective.then_some("projection=perspective")
            } {
                return Err(Problem::parameter(
                    "ortho_height",
                    format!("cannot be given together with `{other}`"),
                    "one of them",
                ));
            }
        }
        if let Some(name) = &self.camera {
            return Ok(Pose::Named(name.clone()));
        }
        let missing = |name| Problem::parameter(name, "missing", WAYS);
        let up = self.up.map(|Up(up)| up);
        let lens = Lens::given(self.fov, self.ortho_height);
        if self.eye.is_some() || self.target.is_some() {
            let eye = DVec3::from(self.eye.ok_or_else(|| missing("eye"))?);
            let target = DVec3::from(self.target.ok_or_else(|| missing("target"))?);
            let lens = lens.unwrap_or(Lens::Perspective { fov_deg: DEFAULT_FOV_DEG });
            return Ok(match up {
                Some(up) => Pose::Camera(Camera { eye, target, up, lens }),
                None => Pose::Upright { eye, target, lens },
            });
        }
        if by_matrix.is_some() {
            let view = self.view.ok_or_else(|| missing("view"))?;
            let proj = self.proj.ok_or_else(|| missing("proj"))?;
            let (view, proj) = (DMat4::from_cols_array(&view), DMat4::from_cols_array(&proj));
            return Ok(Pose::View(View::from_matrices(view, proj, width, height)?));
        }
        Ok(Pose::Fit { up, lens })
    }
}

impl From<SettingError> for Problem {
    fn from(error: SettingError) -> Problem {
        let accepted = error.accepted(|name, value| format!("{name}={value}"));
        Problem::parameter(error.setting, error.reason, accepted)
    }
}

pub fn once<T>(slot: &mut Option<T>, name: &str, value: T) -> Result<(), Problem> {
    match slot.replace(value) {
        None => Ok(()),
        Some(_) => Err(Problem::parameter(name, "given twice", "once")),
    }
}

pub fn number<T: std::str::FromStr>(name: &str, value: &str, accepted: &str) -> Result<T, Problem> {
    value.parse().map_err(|_| unusable(name, value, accepted))
}

/// Reads a whole number, which may be written as `37.0`.
pub fn integer<T>(name: &str, value: &str, accepted: &str) -> Result<T, Problem>
where
    T: std::str::FromStr + DeserializeOwned,
{
    whole::from_text(value).ok_or_else(|| unusable(name, value, accepted))
}

fn unusable(name: &str, value: &str, accepted: &str) -> Problem {
    Problem::parameter(name, format!("`{}` cannot be used", shown(value)), accepted)
}

fn numbers<const N: usize>(name: &str, value: &str) -> Result<[f64; N], Problem> {
    let fail = |reason: String| {
        Problem::parameter(name, reason, format!("{N} finite numbers separated by commas"))
    };
    let mut found = [0.0; N];
    let mut count = 0;
    for text in value.split(',') {
        let number: f64 =
            text.trim().parse().map_err(|_| fail(format!("`{}` is not a number", shown(text))))?;
        if !number.is_finite() {
            return Err(fail(format!("`{}` is not finite", shown(text))));
        }
        if let Some(slot) = found.get_mut(count) {
            *slot = number;
        }
        count += 1;
    }
    if count != N {
        return Err(fail(format!("{count} numbers given")));
    }
    Ok(found)
}

/// Reads a word of a closed list. The list of accepted words comes from the type's own deserialiser, so a new setting needs no
/// second list here.
fn choice<T: DeserializeOwned + Default>(name: &str, word: Option<&str>) -> Result<T, Problem> {
    let Some(word) = word else { return Ok(T::default()) };
    let deserializer: StrDeserializer<'_, serde::de::value::Error> = word.into_deserializer();
    T::deserialize(deserializer).map_err(|error| {
        let text = error.to_string();
        let list = text.rsplit_once("expected ").map_or("", |(_, list)| list);
        let word = shown(word);
        let near = suggestion(&word, list.split('`').skip(1).step_by(2));
        let accepted = list.trim_start_matches("one of ").replace('`', "");
        Problem::parameter(name, format!("`{word}` is not available{near}"), accepted)
    })
}

fn shown(text: &str) -> String {
    text.chars().take(64).collect()
}

#[cfg(test)]
mod tests;
