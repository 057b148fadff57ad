//! Settings as a request gives them: read, merged with defaults, and checked.

use serde::de::DeserializeOwned;
use serde_json::Value;

use super::declaration::Accepted;
use super::{Given, Rule, SettingError, SettingKind, Settings, declaration, declared, words};
use crate::spelling::suggestion;

/// Reads the value of a setting, with errors that say what the setting takes.
pub(super) fn read<T: DeserializeOwned>(
    name: &'static str,
    value: Value,
) -> Result<Option<T>, SettingError> {
    serde_json::from_value(value.clone()).map_err(|error| {
        let kind = declaration(name).map(|setting| &setting.kind);
        let shown: String = match (value, kind) {
            // These say themselves what is wrong.
            (Value::String(_), Some(SettingKind::Text { .. })) => {
                return unusable(name, error.to_string());
            }
            (Value::String(text), Some(SettingKind::Number { .. }))
                if text.parse::<f64>().is_ok() =>
            {
                return unusable(name, format!("\"{text}\" is a text, not a number"));
            }
            (Value::Number(number), Some(SettingKind::Choice { .. })) => {
                return unusable(name, format!("{number} is a number, not a text"));
            }
            (Value::String(text), _) => text,
            (other, _) => other.to_string(),
        };
        let shown: String = shown.chars().take(64).collect();
        let near = match kind {
            Some(SettingKind::Choice { choices, .. }) => {
                suggestion(&shown, choices.iter().map(|choice| choice.value.as_str()))
            }
            _ => String::new(),
        };
        unusable(name, format!("`{shown}` is not a value of this setting{near}"))
    })
}

fn unusable(name: &'static str, reason: String) -> SettingError {
    let accepted = declaration(name).map(|setting| setting.kind.accepted()).unwrap_or_default();
    SettingError { setting: name, reason, accepted: Accepted::Values(accepted) }
}

impl Given {
    /// Bytes that differ for different settings, for hashes.
    pub fn bytes(&self) -> Vec<u8> {
        let pair = |(name, value): (&String, &Value)| format!("{name}={value};").into_bytes();
        words(self).iter().flat_map(pair).collect()
    }

    /// Takes a value that was written as text, as in a query.
    ///
    /// # Errors
    /// As [`Given::set`]; a setting that was given before.
    pub fn set_text(&mut self, name: &str, text: &str) -> Result<(), SettingError> {
        if let Some(setting) = declaration(name).filter(|setting| self.has(setting.name)) {
            let accepted = Accepted::Values("once".to_owned());
            let reason = "given twice".to_owned();
            return Err(SettingError { setting: setting.name, reason, accepted });
        }
        let value = match declaration(name).map(|setting| &setting.kind) {
            Some(SettingKind::Flag) => text.parse().map(Value::Bool).ok(),
            Some(SettingKind::Number { .. }) => serde_json::from_str(text).ok(),
            _ => None,
        };
        self.set(name, value.filter(|value| !value.is_null()).unwrap_or_else(|| text.into()))
    }

    /// Names and values of what is given, as a query has them.
    pub fn pairs(&self) -> Vec<(String, String)> {
        let text = |value: Value| match value {
            Value::String(word) => word,
            // 2 and not 2.0.
            Value::Number(number) => number.as_f64().unwrap_or_default().to_string(),
            other => other.to_string(),
        };
        words(self).into_iter().map(|(name, value)| (name, text(value))).collect()
    }

    fn has(&self, name: &str) -> bool {
        words(self).contains_key(name)
    }

    /// Fills what is missing from `defaults`, except settings that do not apply to the values given here: beside `reconstruct=points`, no
    /// setting of splats is inherited.
    #[must_use]
    pub fn or(&self, defaults: &Given) -> Given {
        let mut merged = self.over(defaults);
        let (own, used) = (words(self), words(&Settings::from(merged)));
        for setting in declared().iter().filter(|setting| !own.contains_key(setting.name)) {
            let value = used.get(setting.name);
            let unfit = |rule: &Rule| own.contains_key(rule.of) && !rule.allows(value, &used);
            if setting.needs.iter().any(unfit) {
                // Nothing is wrong with `null`.
                let _ = merged.set(setting.name, Value::Null);
            }
        }
        merged.without_idle_exposures(self)
    }

    /// Refuses values out of range, whatever stands beside them.
    ///
    /// # Errors
    /// The first such setting.
    pub fn check(&self) -> Result<(), SettingError> {
        let given = words(self);
        for setting in declared() {
            let (Some(value), SettingKind::Number { least, most, .. }) =
                (given.get(setting.name), &setting.kind)
            else {
                continue;
            };
            // Numbers that are not finite are `null` in JSON.
            let number = value.as_f64();
            if number.is_none_or(|number| !(*least..=*most).contains(&number)) {
                let shown = number.map_or_else(|| value.to_string(), |number| number.to_string());
                let reason = format!("{shown} is outside {least} to {most}");
                return Err(unusable(setting.name, reason));
            }
        }
        Ok(())
    }

    /// The settings that a frame is drawn with.
    ///
    /// # Errors
    /// A value out of range, or a setting that does not go with another.
    pub fn resolve(&self) -> Result<Settings, SettingError> {
        self.check()?;
        if let (Some(least), Some(most)) = (self.color_least, self.color_most)
            && most.get() <= least.get()
        {
            let reason = format!("{} is not above color_least, {}", most.get(), least.get());
            let accepted = Accepted::Values(format!("a value above {}", least.get()));
            return Err(SettingError { setting: "color_most", reason, accepted });
        }
        self.check_exposures()?;
        let settings = Settings::from(*self);
        let (given, used, open) = (words(self), words(&settings), settings.open());
        for setting in declared() {
            let Some(value) = given.get(setting.name) else { continue };
            if setting.kind.is_default(value) {
                continue;
            }
            let mut needs = setting.needs.iter().filter(|rule| !open.contains(&rule.of));
            if let Some(rule) = needs.find(|rule| !rule.allows(Some(value), &used)) {
                let default = match &setting.kind {
                    SettingKind::Choice { default, .. } => default.clone(),
                    _ => None,
                };
                return Err(SettingError {
                    setting: setting.name,
                    reason: rule.why.to_owned(),
                    accepted: Accepted::With(setting.needs.clone(), default),
                });
            }
        }
        Ok(settings)
    }
}
