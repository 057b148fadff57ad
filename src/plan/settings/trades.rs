//! Settings that trade accuracy for time, and the combinations of their values that a comparison draws.
//!
//! Declarations say which settings these are: a new method, or a new setting with `trades:`, appears in every comparison by itself.

use serde_json::Value;

use super::{Given, Setting, SettingKind, Settings, declared};

/// How a setting trades accuracy for time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trade {
    is_main: bool,
    /// A short comparison has it, too.
    is_large: bool,
    /// Values of a number that are compared.
    numbers: &'static [f64],
}

impl Trade {
    /// Each value is combined with each value of the other main settings.
    pub(super) const fn main() -> Trade {
        Trade { is_main: true, is_large: true, numbers: &[] }
    }

    /// [`Trade::main`] for a number, with the values to compare.
    pub(super) const fn main_at(numbers: &'static [f64]) -> Trade {
        Trade { is_main: true, is_large: true, numbers }
    }

    /// One value at a time differs from the default, beside the main settings with default numbers.
    pub(super) const fn variant() -> Trade {
        Trade { is_main: false, is_large: false, numbers: &[] }
    }

    /// Whether it is a [`Trade::large_variant`].
    pub(super) fn is_large_variant(&self) -> bool {
        self.is_large && !self.is_main
    }

    /// [`Trade::variant`] that matters enough for a short comparison.
    pub(super) const fn large_variant() -> Trade {
        Trade { is_main: false, is_large: true, numbers: &[] }
    }
}

/// How many combinations are wanted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Extent {
    All,
    /// The main settings with default numbers, and the variants that matter most.
    Few,
    /// The main settings with all numbers, and the variants that matter most, with nothing left to `auto`: what a planner chooses from.
    Planned,
}

/// A combination of settings to compare with others.
#[derive(Clone, Debug, PartialEq)]
pub struct TradeOff {
    pub given: Given,
    /// The last main setting's value, the other main values, then `name=value` of a variant. Unique.
    pub label: String,
    /// The last main setting's value: how samples are drawn.
    pub family: String,
}

/// Every combination that the rules of the declarations allow, main ones first, in the order of the declarations.
pub fn trade_offs(extent: Extent) -> Vec<TradeOff> {
    let (main, variants): (Vec<&Setting>, Vec<&Setting>) =
        declared().iter().filter(|s| s.trades.is_some()).partition(|s| is_main(s));
    let mut combinations = vec![Given::default()];
    for setting in &main {
        let values = values(setting, extent);
        combinations = combinations
            .into_iter()
            .flat_map(|given| {
                let with = allowed(given, setting, &values);
                if with.is_empty() { vec![given] } else { with }
            })
            .collect();
    }
    let mut found: Vec<TradeOff> =
        combinations.iter().map(|given| trade_off(*given, &main)).collect();
    let is_base = |given: &&Given| {
        let is_open = Settings::from(**given).leaves_drawing_open();
        !is_open && main.iter().all(|setting| has_default_number(given, setting))
    };
    for given in combinations.iter().filter(is_base) {
        let wanted = |setting: &&&Setting| {
            extent == Extent::All || setting.trades.is_some_and(|trade| trade.is_large)
        };
        for setting in variants.iter().filter(wanted) {
            let mut values = values(setting, extent);
            values.retain(|value| !setting.kind.is_default(value));
            let with = allowed(*given, setting, &values);
            found.extend(with.into_iter().map(|given| trade_off(given, &main)));
        }
    }
    if extent == Extent::Planned {
        found.retain(|found| !Settings::from(found.given).leaves_drawing_open());
    }
    found
}

fn is_main(setting: &Setting) -> bool {
    setting.trades.is_some_and(|trade| trade.is_main)
}

fn values(setting: &Setting, extent: Extent) -> Vec<Value> {
    match &setting.kind {
        SettingKind::Choice { choices, .. } => {
            choices.iter().map(|choice| choice.value.as_str().into()).collect()
        }
        SettingKind::Flag => vec![true.into(), false.into()],
        SettingKind::Number { default, .. } if extent == Extent::Few => {
            default.iter().map(|&number| number.into()).collect()
        }
        SettingKind::Number { .. } => {
            let numbers = setting.trades.iter().flat_map(|trade| trade.numbers);
            numbers.map(|&number| number.into()).collect()
        }
        SettingKind::Text { .. } => Vec::new(),
    }
}

/// The combination with each of the values that its rules allow.
fn allowed(given: Given, setting: &Setting, values: &[Value]) -> Vec<Given> {
    let with = |value: &Value| {
        let mut given = given;
        given.set(setting.name, value.clone()).ok()?;
        given.resolve().ok().map(|_| given)
    };
    values.iter().filter_map(with).collect()
}

fn has_default_number(given: &Given, setting: &Setting) -> bool {
    let SettingKind::Number { default, .. } = setting.kind else { return true };
    let own = super::words(given).get(setting.name).and_then(Value::as_f64);
    own.is_none() || own == default
}

fn trade_off(given: Given, main: &[&Setting]) -> TradeOff {
    let words = super::words(&given);
    let text = |setting: &Setting, value: &Value| match (&setting.kind, value) {
        (SettingKind::Number { unit, .. }, number) => {
            let unit = if *unit == "pixels" { "px" } else { unit };
            format!("{} {unit}", number.as_f64().unwrap_or_default()).trim_end().to_owned()
        }
        (_, Value::String(word)) => word.clone(),
        (_, other) => other.to_string(),
    };
    let mut mains: Vec<String> =
        main.iter().filter_map(|setting| Some(text(setting, words.get(setting.name)?))).collect();
    let family = mains.pop().unwrap_or_default();
    mains.insert(0, family.clone());
    let others = declared().iter().filter(|setting| setting.trades.is_some() && !is_main(setting));
    mains.extend(others.filter_map(|setting| {
        let value = words.get(setting.name)?;
        Some(format!("{}={}", setting.name, text(setting, value)))
    }));
    TradeOff { given, label: mains.join(" "), family }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;
    use crate::plan::{Lod, Reconstruct};

    #[test]
    fn all_combinations_are_allowed_and_have_names_of_their_own() {
        let all = trade_offs(Extent::All);
        let labels: BTreeSet<&str> = all.iter().map(|found| found.label.as_str()).collect();
        assert_eq!(labels.len(), all.len());
        for found in &all {
            assert!(found.given.resolve().is_ok(), "{}", found.label);
        }
        for expected in [
            "points full",
            "splats spt 0.25 px",
            "painted spt 8 px",
            "splats full filter=exact",
            "pull_push spt 1 px pull_push_weights=box",
            "painted full painted_as=splats",
            "fuzzy full antialias=16x",
            "splats spt 1 px error_mode=split",
        ] {
            assert!(labels.contains(expected), "{expected} in {labels:?}");
        }
        // Variants that the rules exclude.
        assert!(!labels.contains("points full filter=exact"));
        assert!(!labels.iter().any(|label| label.starts_with("auto full ")));
    }

    #[test]
    fn every_way_to_draw_samples_appears_with_every_level_of_detail() {
        use clap::ValueEnum;
        let few = trade_offs(Extent::Few);
        let ways = Reconstruct::value_variants().len() * Lod::value_variants().len();
        let (large, plain): (Vec<&TradeOff>, Vec<&TradeOff>) =
            few.iter().partition(|found| found.label.contains('='));
        assert_eq!(plain.len(), ways);
        assert!(large.iter().any(|found| found.label == "fuzzy full antialias=16x"));
        assert!(large.iter().all(|found| found.label.contains("antialias=")));
        let all = trade_offs(Extent::All);
        assert!(few.iter().all(|found| all.contains(found)));
        let planned = trade_offs(Extent::Planned);
        assert!(planned.iter().all(|found| all.contains(found) && found.family != "auto"));
        assert!(planned.iter().any(|found| found.label == "fuzzy spt 4 px"));
        // docs/planner.md names what is chosen.
        let names: BTreeSet<&str> = planned.iter().flat_map(|found| found.given.names()).collect();
        assert_eq!(names, BTreeSet::from(["antialias", "lod", "max_error_px", "reconstruct"]));
    }
}
