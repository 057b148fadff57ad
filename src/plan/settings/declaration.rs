//! Declaration of a setting: its values, and the rules that bind it to others.

use clap::ValueEnum;
use serde::Serialize;
use serde_json::{Map, Value};

use super::trades::Trade;

/// A declared setting.
#[derive(Clone, Debug, Serialize, utoipa::ToSchema)]
#[schema(as = SettingInfo)]
pub struct Setting {
    /// Name in queries, bodies and stored jobs; on the command line `_` is `-`.
    pub name: &'static str,
    /// Short text for a control.
    pub label: &'static str,
    /// Description, in sentences.
    pub help: String,
    #[serde(flatten)]
    pub kind: SettingKind,
    /// Where one of these does not hold, a value is refused, unless it is the default of a choice.
    pub needs: Vec<Rule>,
    /// Where one of these does not hold, the setting has no effect worth a control, or the rule's value cannot be drawn. `output`, `samples`,
    /// `segments`, `lights`, `casting_lights`, `scene_environment`, `scene_fog`, `scene_occlusion` and `fields` are facts of the frame and its scene; `fields` are the names of its scalar fields.
    /// `blur` is `some` with an aperture or an open shutter. `occludable` is `none` where samples are drawn without depths, or are lit one by one.
    pub useful_with: Vec<Rule>,
    /// Whether the setting trades accuracy for time, so that comparisons vary it.
    #[serde(serialize_with = "is_there")]
    #[schema(value_type = bool)]
    pub trades: Option<Trade>,
}

fn is_there<S: serde::Serializer>(trade: &Option<Trade>, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_bool(trade.is_some())
}

/// Values that a setting takes.
#[derive(Clone, Debug, Serialize, utoipa::ToSchema)]
#[serde(tag = "kind", rename_all = "snake_case")]
#[schema(as = SettingKind)]
pub enum SettingKind {
    Choice {
        choices: Vec<Choice>,
        /// `null`: as the scene has it.
        default: Option<String>,
    },
    /// `true` or `false`; where it is not given, as the scene has it.
    Flag,
    /// Text of a form of its own.
    Text {
        /// The default, in words.
        default: &'static str,
        /// The form, in words.
        accepted: &'static str,
        /// A regular expression that matches every accepted value, and possibly others.
        pattern: String,
        examples: &'static [&'static str],
    },
    Number {
        least: f64,
        most: f64,
        /// `null`: see `absent`.
        default: Option<f64>,
        /// What holds without a value where there is no default: `the scene’s` value, that of the camera (`the target’s`), or `none`.
        absent: &'static str,
        unit: &'static str,
    },
}

/// A value of a [`SettingKind::Choice`].
#[derive(Clone, Debug, Serialize, utoipa::ToSchema)]
#[schema(as = SettingChoice)]
pub struct Choice {
    pub value: String,
    pub help: String,
}

/// A setting or fact that must have one of these values; any value where there are none.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, utoipa::ToSchema)]
#[schema(as = SettingRule)]
pub struct Rule {
    pub of: &'static str,
    pub is: &'static [&'static str],
    /// The rule is for this value of the setting alone.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub value: Option<&'static str>,
    /// Reason for a refusal.
    #[serde(skip)]
    pub(super) why: &'static str,
}

/// A setting that cannot be used.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{setting}: {reason}")]
pub struct SettingError {
    pub setting: &'static str,
    pub reason: String,
    pub(super) accepted: Accepted,
}

#[derive(Clone, Debug, PartialEq)]
pub(super) enum Accepted {
    Values(String),
    /// Rules of other settings that the setting needs, and the default, which needs none.
    With(Vec<Rule>, Option<String>),
}

impl SettingError {
    /// Says in words which values would be accepted. `pair` writes a setting with its value in the caller's notation.
    pub fn accepted(&self, pair: impl Fn(&str, &str) -> String) -> String {
        match &self.accepted {
            Accepted::Values(values) => values.clone(),
            Accepted::With(needs, default) => {
                let needs = in_words(needs, pair);
                match default {
                    Some(value) => format!("`{value}`, or another value with {needs}"),
                    None => format!("no value, or a value together with {needs}"),
                }
            }
        }
    }
}

impl Setting {
    /// Settings that must stand beside this one for a value other than its default, in words; `None` where none must.
    pub fn needs_in_words(&self, pair: impl Fn(&str, &str) -> String) -> Option<String> {
        (!self.needs.is_empty()).then(|| in_words(&self.needs, pair))
    }
}

fn in_words(needs: &[Rule], pair: impl Fn(&str, &str) -> String) -> String {
    let rules = needs.iter().map(|rule| {
        let (first, others) = rule.is.split_first().unwrap_or((&"…", &[]));
        let first = format!("`{}`", pair(rule.of, first));
        let others = others.iter().map(|value| format!("`{value}`"));
        let all = alternatives(&std::iter::once(first).chain(others).collect::<Vec<_>>());
        rule.value.map_or(all.clone(), |value| format!("{all} for `{value}`"))
    });
    rules.collect::<Vec<_>>().join(" and ")
}

/// `a`, `a or b`, `a, b or c`.
fn alternatives(words: &[String]) -> String {
    match words {
        [] => String::new(),
        [one] => one.clone(),
        [others @ .., last] => format!("{} or {last}", others.join(", ")),
    }
}

impl Rule {
    pub(super) const fn new(
        of: &'static str,
        is: &'static [&'static str],
        why: &'static str,
    ) -> Rule {
        Rule { of, is, value: None, why }
    }

    pub(super) const fn for_value(self, value: &'static str) -> Rule {
        Rule { value: Some(value), ..self }
    }

    /// Whether a setting may have a value (`None`: any), beside these values of the others.
    pub(super) fn allows(&self, value: Option<&Value>, words: &Map<String, Value>) -> bool {
        let concerns = |only| value.and_then(Value::as_str) == Some(only);
        !self.value.is_none_or(concerns) || self.holds(words)
    }

    pub(super) fn holds(&self, words: &Map<String, Value>) -> bool {
        let value = words.get(self.of).filter(|value| !value.is_null());
        let is_listed = |value: &Value| value.as_str().is_some_and(|word| self.is.contains(&word));
        value.is_some_and(|value| self.is.is_empty() || is_listed(value))
    }
}

impl SettingKind {
    pub(super) fn choice<T: ValueEnum>(default: Option<T>) -> SettingKind {
        let values = T::value_variants().iter().filter_map(ValueEnum::to_possible_value);
        let choices = values.map(|value| Choice {
            value: value.get_name().to_owned(),
            help: value.get_help().map(ToString::to_string).unwrap_or_default(),
        });
        let default = default.and_then(|default| default.to_possible_value());
        SettingKind::Choice {
            choices: choices.collect(),
            default: default.map(|value| value.get_name().to_owned()),
        }
    }

    pub(super) fn scenes<T: ValueEnum>() -> SettingKind {
        SettingKind::choice::<T>(None)
    }

    pub(super) fn own<T: ValueEnum + Default>() -> SettingKind {
        SettingKind::choice(Some(T::default()))
    }

    /// The values, in words.
    pub fn accepted(&self) -> String {
        match self {
            SettingKind::Choice { choices, .. } => {
                let values: Vec<&str> =
                    choices.iter().map(|choice| choice.value.as_str()).collect();
                values.join(if values.len() == 2 { " or " } else { ", " })
            }
            SettingKind::Flag => "true or false".to_owned(),
            SettingKind::Text { accepted, .. } => (*accepted).to_owned(),
            SettingKind::Number { least, most, unit, .. } => {
                format!("{least} to {most} {unit}").trim_end().to_owned()
            }
        }
    }

    pub(super) fn is_default(&self, value: &Value) -> bool {
        matches!(self, SettingKind::Choice { default: Some(default), .. } if value == default)
    }
}
