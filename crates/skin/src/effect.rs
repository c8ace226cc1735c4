//! What a nominal forward model leaves out: named, parametrised effects that a skin description switches on.

use std::collections::BTreeMap;
use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::{ModelError, SkinDescription, SkinError};

/// A number that an effect depends on.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ParameterInfo {
    /// As files call it.
    pub name: &'static str,
    /// SI symbol; `1` where it has none.
    pub unit: &'static str,
    /// One line for people.
    pub what: &'static str,
    /// Value where a file names none.
    pub typical: f64,
    /// Values that have been seen on real devices, or that make sense.
    pub range: [f64; 2],
    /// Values outside of these cannot be, and are refused.
    pub limits: [f64; 2],
}

impl ParameterInfo {
    /// A parameter whose fields come in their order.
    #[must_use]
    pub const fn new(
        name: &'static str,
        unit: &'static str,
        what: &'static str,
        typical: f64,
        range: [f64; 2],
        limits: [f64; 2],
    ) -> Self {
        Self { name, unit, what, typical, range, limits }
    }
}

/// An effect that a sensor family knows.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct EffectInfo {
    /// As files call it: lower case, words joined by `-`.
    pub name: &'static str,
    /// One sentence for people.
    pub what: &'static str,
    /// Where the model comes from.
    pub source: &'static str,
    /// Its parameters; those that a file does not name are typical.
    pub parameters: &'static [ParameterInfo],
    /// Whether readings depend on what happened before, or on how long ago the device was switched on, so that it shows
    /// as a device is stepped only.
    pub stateful: bool,
    /// Whether the seed matters: parts of it are drawn at random.
    pub random: bool,
}

impl EffectInfo {
    /// What `effect` says of the parameter called `name`, the typical value where it says nothing.
    #[must_use]
    pub fn value(&self, effect: &Effect, name: &str) -> f64 {
        let typical = self.parameters.iter().find(|p| p.name == name).map_or(f64::NAN, |p| p.typical);
        effect.parameters.get(name).copied().unwrap_or(typical)
    }
}

/// An effect of a skin, as its description switches it on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Effect {
    /// Name that the sensor family knows.
    pub name: String,
    /// 0 is no effect, 1 the one that the parameters say; the deviation from the nominal readings grows with it.
    #[serde(default = "full")]
    pub strength: f64,
    /// Which device is drawn, for effects that differ from device to device; 0 where neither the file nor the program that
    /// runs the model says it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seed: Option<u64>,
    /// Parameters that are not typical, in SI units; the sensor family refuses names that it does not know.
    #[serde(flatten)]
    pub parameters: BTreeMap<String, f64>,
}

fn full() -> f64 {
    1.0
}

impl Effect {
    /// The typical effect of this name.
    #[must_use]
    pub fn new(name: impl Into<String>) -> Self {
        Self { name: name.into(), strength: full(), seed: None, parameters: BTreeMap::new() }
    }

    /// With another strength.
    #[must_use]
    pub fn strength(mut self, strength: f64) -> Self {
        self.strength = strength;
        self
    }

    /// With this device.
    #[must_use]
    pub fn seed(mut self, seed: u64) -> Self {
        self.seed = Some(seed);
        self
    }

    /// With another parameter.
    #[must_use]
    pub fn with(mut self, name: impl Into<String>, value: f64) -> Self {
        self.parameters.insert(name.into(), value);
        self
    }

    /// Reads a file of effects: TOML with `[[effects]]` and nothing else.
    ///
    /// # Errors
    ///
    /// [`SkinError`] says which file and field is wrong and what would be right. Whether a sensor family knows the effects
    /// is for its model to say.
    pub fn load(path: impl AsRef<Path>) -> Result<Vec<Self>, SkinError> {
        #[derive(Deserialize)]
        #[serde(deny_unknown_fields)]
        struct File {
            effects: Vec<Effect>,
        }
        let path = path.as_ref();
        let text = dermis_io::read_text(path, dermis_io::TEXT)
            .map_err(|source| SkinError::ReadEffects { path: path.to_owned(), source })?;
        let file = path.display().to_string();
        let wrong = |(field, reason)| SkinError::Effects { file: file.clone(), field, reason };
        let read: File = dermis_io::toml::parse(&text).map_err(|fault| wrong(fault.into_field()))?;
        match impossible(&read.effects) {
            Some(fault) => Err(wrong(fault)),
            None => Ok(read.effects),
        }
    }

    /// Puts `effects` on top of what is in `into`: one of the same name is replaced where it stands, others follow.
    pub fn merge(into: &mut Vec<Self>, effects: impl IntoIterator<Item = Self>) {
        for effect in effects {
            match into.iter_mut().find(|e| e.name == effect.name) {
                Some(same) => *same = effect,
                None => into.push(effect),
            }
        }
    }

    /// Refuses what a sensor family that knows `known` does not know, and values that cannot be. `skin` is what errors call
    /// the skin.
    ///
    /// # Errors
    ///
    /// [`ModelError::Description`] with the field `effects[i].…` and what is known.
    pub fn check(effects: &[Self], known: &[EffectInfo], skin: &str) -> Result<(), ModelError> {
        let wrong = |field: String, reason: String| {
            Err(ModelError::Description { skin: skin.to_owned(), field, reason })
        };
        if let Some((field, reason)) = impossible(effects) {
            return wrong(field, reason);
        }
        for (i, effect) in effects.iter().enumerate() {
            let Some(info) = known.iter().find(|k| k.name == effect.name) else {
                let names: Vec<&str> = known.iter().map(|k| k.name).collect();
                let reason =
                    format!("\"{}\" is no effect of this sensor; it has {}", effect.name, names.join(", "));
                return wrong(format!("effects[{i}].name"), reason);
            };
            for (name, &value) in &effect.parameters {
                let Some(parameter) = info.parameters.iter().find(|p| p.name == name) else {
                    let names: Vec<&str> = info.parameters.iter().map(|p| p.name).collect();
                    let reason = format!("is no parameter of {}; it has {}", info.name, names.join(", "));
                    return wrong(format!("effects[{i}].{name}"), reason);
                };
                let [low, high] = parameter.limits;
                if !(low..=high).contains(&value) {
                    let unit = if parameter.unit == "1" { "" } else { parameter.unit };
                    let reason =
                        format!("is {value} {unit} and must be {low} to {high} {unit}").replace("  ", " ");
                    return wrong(format!("effects[{i}].{name}"), reason.trim_end().to_owned());
                }
            }
        }
        Ok(())
    }

    /// Has `act` change what a model is computed from by each effect of a skin that is on, in the order of the table `known`, so that
    /// the order in the file makes no difference. What `act` refuses is a parameter's name and why.
    ///
    /// # Errors
    ///
    /// As [`check`](Self::check), and [`ModelError::Description`] with the field `effects[i].…` of what `act` refuses.
    pub fn apply(
        skin: &SkinDescription,
        known: &'static [EffectInfo],
        mut act: impl FnMut(&EffectInfo, &Self) -> Result<(), (&'static str, String)>,
    ) -> Result<(), ModelError> {
        Self::check(&skin.effects, known, &skin.name)?;
        for info in known {
            let on = |e: &Self| e.name == info.name && e.strength > 0.0;
            let Some(i) = skin.effects.iter().position(on) else { continue };
            act(info, &skin.effects[i])
                .map_err(|(name, reason)| skin.refusal(&format!("effects[{i}].{name}"), reason))?;
        }
        Ok(())
    }
}

/// Effects of a device.
const EFFECTS: usize = 1000;
/// Strength of an effect: many times of what is typical.
const STRENGTH: f64 = 1e6;

/// What no sensor family could make sense of: field and reason.
pub(crate) fn impossible(effects: &[Effect]) -> Option<(String, String)> {
    if effects.len() > EFFECTS {
        let reason = format!("are {}; {EFFECTS} at most make sense", effects.len());
        return Some(("effects".to_owned(), reason));
    }
    for (i, effect) in effects.iter().enumerate() {
        if effect.strength > STRENGTH {
            return Some((
                format!("effects[{i}].strength"),
                format!("is {:e} and must be {STRENGTH} at most", effect.strength),
            ));
        }
        if !(effect.strength.is_finite() && effect.strength >= 0.0) {
            return Some((
                format!("effects[{i}].strength"),
                format!("is {} and must be 0 (off) or positive", effect.strength),
            ));
        }
        if let Some((name, value)) = effect.parameters.iter().find(|(_, v)| !v.is_finite()) {
            return Some((format!("effects[{i}].{name}"), format!("is {value} and must be a finite number")));
        }
        if effects[..i].iter().any(|other| other.name == effect.name) {
            return Some((format!("effects[{i}].name"), format!("\"{}\" is already there", effect.name)));
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    const KNOWN: &[EffectInfo] = &[EffectInfo {
        name: "gain",
        what: "Reads too much.",
        source: "a guess",
        parameters: &[ParameterInfo {
            name: "by",
            unit: "Pa",
            what: "how much",
            typical: 0.1,
            range: [0.05, 0.2],
            limits: [0.0, 1.0],
        }],
        stateful: false,
        random: false,
    }];

    fn load(text: &str) -> Result<Vec<Effect>, String> {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("device.toml");
        std::fs::write(&file, text).unwrap();
        Effect::load(&file).map_err(|e| e.to_string().replace(&*dir.path().display().to_string(), ""))
    }

    #[test]
    fn a_file_says_what_it_does_not_leave_typical() {
        let effects =
            load("[[effects]]\nname = \"gain\"\nstrength = 0.5\nby = 1\n[[effects]]\nname = \"tilt\"")
                .unwrap();
        assert_eq!(effects, [Effect::new("gain").strength(0.5).with("by", 1.0), Effect::new("tilt")]);
        assert_eq!(KNOWN[0].value(&effects[0], "by"), 1.0);
        assert_eq!(KNOWN[0].value(&effects[1], "by"), 0.1);
    }

    #[test]
    fn merging_replaces_by_name() {
        let mut effects = vec![Effect::new("gain"), Effect::new("tilt")];
        Effect::merge(&mut effects, [Effect::new("skew"), Effect::new("gain").strength(0.5)]);
        assert_eq!(effects, [Effect::new("gain").strength(0.5), Effect::new("tilt"), Effect::new("skew")]);
    }

    #[test]
    fn refusals_name_file_and_field() {
        insta::assert_snapshot!(load("effects = 3").unwrap_err(), @"effects file /device.toml: field `effects`: invalid type: integer `3`, expected a sequence");
        insta::assert_snapshot!(load("[[effects]]\nname = \"gain\"\nby = \"much\"").unwrap_err(), @r#"effects file /device.toml: field `effects[0]`: invalid type: string "much", expected f64"#);
        insta::assert_snapshot!(load("[[effect]]\nname = \"gain\"").unwrap_err(), @"effects file /device.toml: field `effect`: unknown field `effect`, expected `effects`");
        insta::assert_snapshot!(load("[[effects]]\nname = \"gain\"\nstrength = nan").unwrap_err(), @"effects file /device.toml: field `effects[0].strength`: is NaN and must be 0 (off) or positive");
        insta::assert_snapshot!(load("[[effects]]\nname =").unwrap_err(), @"effects file /device.toml: field `line 2, column 7`: string values must be quoted, expected literal string");
        let refused = |effect| Effect::check(&[effect], KNOWN, "pad").unwrap_err().to_string();
        insta::assert_snapshot!(refused(Effect::new("gian")), @r#"skin `pad`: field `effects[0].name`: "gian" is no effect of this sensor; it has gain"#);
        insta::assert_snapshot!(refused(Effect::new("gain").with("bye", 0.1)), @"skin `pad`: field `effects[0].bye`: is no parameter of gain; it has by");
        insta::assert_snapshot!(refused(Effect::new("gain").with("by", 2.0)), @"skin `pad`: field `effects[0].by`: is 2 Pa and must be 0 to 1 Pa");
    }
}
