//! Settings that are numbers.

use serde::{Deserialize, Deserializer, Serialize};

use super::SettingKind;

/// What holds without a value of a number that the scene may give.
const SCENES: &str = "the scene’s";

/// Declares types of bounded numbers: name, unit, range and default, and for lengths how many times the largest one references may draw.
macro_rules! numbers {
    ($($(#[doc = $doc:literal])+ $name:ident: $least:literal to $most:literal $unit:literal, $default:literal $(, drawn $times:literal times)?;)+) => {$(
        $(#[doc = $doc])+
        #[derive(Clone, Copy, Debug)]
        pub struct $name(f32);

        impl $name {
            /// Least and largest value.
            pub const RANGE: [f32; 2] = [$least, $most];
            /// Least and largest value that frames are drawn with.
            const DRAWN: [f32; 2] = [$least, $most $(* $times)?];

            /// `None` for values that frames are not drawn with.
            pub fn new(value: f32) -> Option<$name> {
                let [least, most] = $name::DRAWN;
                // One form for both zeros.
                (least..=most).contains(&value).then_some($name(value + 0.0))
            }

            pub fn get(self) -> f32 {
                self.0
            }

            pub(super) fn kind() -> SettingKind {
                let [least, most] = $name::RANGE.map(exact);
                SettingKind::Number {
                    least,
                    most,
                    default: Some(exact($default)),
                    absent: SCENES,
                    unit: $unit,
                }
            }
        }

        impl From<f64> for $name {
            /// The default for values that cannot be drawn. [`super::Given::check`] refuses those outside the range of requests before.
            fn from(value: f64) -> Self {
                $name::new(value as f32).unwrap_or_default()
            }
        }

        impl Serialize for $name {
            fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                serializer.serialize_f64(exact(self.0))
            }
        }

        impl Default for $name {
            fn default() -> Self {
                $name($default)
            }
        }

        impl PartialEq for $name {
            fn eq(&self, other: &Self) -> bool {
                self.0.to_bits() == other.0.to_bits()
            }
        }

        impl Eq for $name {}

        impl std::hash::Hash for $name {
            fn hash<H: std::hash::Hasher>(&self, state: &mut H) {
                self.0.to_bits().hash(state);
            }
        }
    )+};
}

numbers! {
    /// Accepted error, in pixels.
    MaxError: 0.05 to 64.0 "pixels", 1.0;
    /// Least diameter of points, in pixels.
    PointSizePx: 1.0 to 256.0 "pixels", 1.0;
    /// Diameter of points in scene units.
    PointSize: 0.0 to 1e9 "scene units", 0.0;
    /// Least width of lines, in pixels.
    LineWidthPx: 0.0 to 64.0 "pixels", 0.0, drawn 4.0 times;
    /// Strength of eye-dome lighting: doubling it squares what is left of a pixel's light.
    EdlStrength: 0.0 to 10.0 "", 0.6;
    /// Distance of the neighbours that eye-dome lighting compares a pixel with, in pixels.
    EdlRadius: 1.0 to 16.0 "pixels", 1.4, drawn 4.0 times;
    /// Exposure, in stops.
    Exposure: -16.0 to 16.0 "stops", 0.0;
    /// Diameter of a lens, in scene units.
    LensDiameter: 0.0 to 1e9 "scene units", 0.0;
    /// Distance along the viewing axis, in scene units.
    ViewDistance: 1e-9 to 1e9 "scene units", 1.0;
    /// Shift to the right, in scene units.
    Shift: -1e9 to 1e9 "scene units", 0.0;
    /// Share of the time between two frames.
    OpenShare: 0.0 to 1.0 "", 0.0;
    /// GPU time of a frame, in milliseconds.
    BudgetMs: 0.01 to 60000.0 "ms", 33.0;
    /// Peak signal-to-noise ratio, in decibels.
    Decibels: 1.0 to 100.0 "dB", 35.0;
}

/// Declares types of numbers that may be missing.
macro_rules! optional {
    ($($(#[doc = $doc:literal])+ $name:ident of $number:ident, $absent:expr;)+) => {$(
        $(#[doc = $doc])+
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize)]
        #[serde(transparent)]
        pub struct $name(Option<$number>);

        impl $name {
            pub(super) fn kind() -> SettingKind {
                match $number::kind() {
                    SettingKind::Number { least, most, unit, .. } => {
                        SettingKind::Number { least, most, default: None, absent: $absent, unit }
                    }
                    other => other,
                }
            }
        }

        impl From<f64> for $name {
            fn from(value: f64) -> Self {
                $name(Some(value.into()))
            }
        }
    )+};
}

optional! {
    /// Least width of lines. Where there is none, the scene decides.
    LineWidth of LineWidthPx, SCENES;
    /// Longest GPU time of a frame, where there is one.
    Budget of BudgetMs, "none";
    /// Least peak signal-to-noise ratio of a frame, where there is one.
    MinPsnr of Decibels, "none";
    /// Distance at which things are sharp. Where there is none, the camera decides.
    FocusDistance of ViewDistance, "the target’s";
}

/// Declares types of numbers that stand for nothing where they are 0.
macro_rules! switched {
    ($($(#[doc = $doc:literal])+ $name:ident of $number:ident;)+) => {$(
        $(#[doc = $doc])+
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize)]
        #[serde(transparent)]
        pub struct $name(Option<$number>);

        impl $name {
            pub(super) fn kind() -> SettingKind {
                $number::kind()
            }

            /// The number; `None` for 0.
            pub fn get(self) -> Option<f64> {
                self.0.map(|number| exact(number.get()))
            }
        }

        impl From<f64> for $name {
            fn from(value: f64) -> Self {
                $name((value != 0.0).then(|| value.into()))
            }
        }
    )+};
}

switched! {
    /// Diameter of the lens. Without one, the camera is a pinhole.
    Aperture of LensDiameter;
    /// Shift of the eye to the right, of one image of a stereo pair.
    EyeOffset of Shift;
    /// Share of the time between two frames for which the shutter is open. Without one, a frame shows an instant.
    Shutter of OpenShare;
}

/// Declares numbers that grow with the pixels of a frame.
macro_rules! lengths {
    ($($name:ident),+) => {$(
        impl $name {
            /// The number times `scale`, or the nearest that can be drawn.
            #[must_use]
            pub fn times(self, scale: f32) -> $name {
                let [least, most] = $name::DRAWN;
                $name((self.0 * scale).clamp(least, most))
            }
        }
    )+};
}

lengths!(LineWidthPx, EdlRadius);

impl LineWidth {
    /// The width, where there is one; else a pixel for sparse lines, and their own width for others.
    #[must_use]
    pub fn decided(self, are_sparse: bool) -> LineWidth {
        LineWidth(Some(self.0.unwrap_or(LineWidthPx(if are_sparse { 1.0 } else { 0.0 }))))
    }

    pub fn px(self) -> f32 {
        self.0.unwrap_or_default().get()
    }

    /// The width times `scale`, where there is one.
    #[must_use]
    pub fn times(self, scale: f32) -> LineWidth {
        LineWidth(self.0.map(|width| width.times(scale)))
    }
}

impl Budget {
    pub fn ms(self) -> Option<f64> {
        self.0.map(|budget| exact(budget.get()))
    }
}

impl FocusDistance {
    /// A distance, or the nearest one in the range.
    pub fn nearest(distance: f64) -> FocusDistance {
        let [least, most] = ViewDistance::RANGE.map(exact);
        distance.clamp(least, most).into()
    }

    /// The distance, where there is one.
    pub fn get(self) -> Option<f64> {
        self.0.map(|distance| exact(distance.get()))
    }
}

impl MinPsnr {
    pub fn db(self) -> Option<f64> {
        self.0.map(|least| exact(least.get()))
    }
}

impl MaxError {
    pub fn px(self) -> f32 {
        self.get()
    }
}

/// The number with the same shortest decimal form: 0.05 and not 0.05000000074505806.
fn exact(number: f32) -> f64 {
    number.to_string().parse().unwrap_or(f64::from(number))
}

/// A bound of the values that a colour map shows, in scene units or in those of the field.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(transparent)]
pub struct ColorBound(#[serde(deserialize_with = "with_one_zero")] f64);

/// Reads a number with one form for both zeros.
fn with_one_zero<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    Ok(f64::deserialize(deserializer)? + 0.0)
}

impl ColorBound {
    pub fn get(self) -> f64 {
        self.0
    }

    pub(super) fn kind() -> SettingKind {
        SettingKind::Number {
            least: -1e9,
            most: 1e9,
            default: None,
            absent: SCENES,
            unit: "units of the value",
        }
    }
}

impl From<f64> for ColorBound {
    fn from(value: f64) -> Self {
        ColorBound(value + 0.0)
    }
}

impl std::str::FromStr for ColorBound {
    type Err = std::num::ParseFloatError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        text.parse().map(f64::into)
    }
}

impl PartialEq for ColorBound {
    fn eq(&self, other: &Self) -> bool {
        self.0.to_bits() == other.0.to_bits()
    }
}

impl Eq for ColorBound {}

impl std::hash::Hash for ColorBound {
    fn hash<H: std::hash::Hasher>(&self, state: &mut H) {
        self.0.to_bits().hash(state);
    }
}
