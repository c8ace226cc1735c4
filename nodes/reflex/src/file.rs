//! The rule file: TOML in, [`Rules`] out, or one sentence that names file, line and field.
//!
//! ```toml
//! schema = "dermis-reflex/1"
//! name = "arm"
//! start = "stopped"              # or "clear"
//! at_end = "act"                 # or "silent"
//!
//! [inputs.body]                  # every topic that is listened to
//! kind = "body"                  # BodyContacts; or "skin": the ContactArray of one skin
//! topic = "body_contacts"
//! timeout = 0.05                 # [s]
//! max_age = 0.1                  # [s] optional
//!
//! [regions.hands]
//! links = ["left_hand", "right_hand"]   # and, or, `skins`
//!
//! [limits.hand]                  # of a body region of a person, as ISO/TS 15066 writes them
//! quasi_static = { force = …, pressure = … }    # [N], [N/cm²]
//! transient = { force = …, pressure = … }
//! time_to_quasi_static = …       # [s]
//!
//! [actions.stop]
//! kind = "bool"                  # empty, twist, speed_scale, trigger, cancel
//! topic = "stop"
//! repeat = 0.05                  # [s]
//! heartbeat = 0.1                # [s]
//!
//! [[rules]]
//! name = "hand"
//! region = "hands"               # everything where absent
//! inputs = ["body"]              # all where absent
//! force = { above = …, release = … }    # [N]; pressure in N/cm², speed in m/s
//! limits = "hand"
//! actions = ["stop"]
//! ```

use std::collections::BTreeMap;
use std::path::Path;

use dermis_io::toml::Fault;

use crate::rules::{
    Action, ContactLimits, Input, InputKind, LimitPair, Loss, PASCALS_PER_N_PER_CM2, Region, Rule, Rules,
    Threshold,
};
use numbers::{at_least_zero, name_of, positive, positive_time, ratio, time, topic, within};
use raw::{RawInput, RawInputKind, RawLimits, RawPair, RawRegion, RawRule, RawRules, RawThreshold};

mod actions;
mod locate;
mod numbers;
mod raw;

/// What the file's `schema` has to be.
const SCHEMA: &str = "dermis-reflex/1";
/// Rules, inputs or actions in one file.
const MOST: usize = 256;

/// Why a rule file cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RuleFileError {
    /// The file cannot be read.
    #[error("rule file {file}: cannot be read: {source}; check the path and its permissions")]
    Read {
        /// File that was requested.
        file: String,
        /// What the system says.
        source: std::io::Error,
    },
    /// The text is no TOML.
    #[error("rule file {file}: line {line}: {reason}")]
    Syntax {
        /// What errors call the file.
        file: String,
        /// Line, from 1.
        line: usize,
        /// What is wrong.
        reason: String,
    },
    /// A field is missing, has the wrong type or cannot be.
    #[error("rule file {file}: line {line}: field `{field}`: {reason}")]
    Field {
        /// What errors call the file.
        file: String,
        /// Line, from 1.
        line: usize,
        /// Path of the field.
        field: String,
        /// What is wrong, and what to do.
        reason: String,
    },
}

/// A field and why it cannot be.
type Wrong = (String, String);

fn wrong<T>(field: impl Into<String>, reason: impl Into<String>) -> Result<T, Wrong> {
    Err((field.into(), reason.into()))
}

/// Share of a threshold below which it is released, where the file says nothing.
const USUAL_RELEASE: f64 = 0.9;
/// \[s\] without a condition before a rule can be released, where the file says nothing.
const USUAL_QUIET: f64 = 0.2;

impl Rules {
    /// Reads a rule file.
    ///
    /// # Errors
    ///
    /// [`RuleFileError`] names the file, the line and the field.
    pub fn load(path: impl AsRef<Path>) -> Result<Self, RuleFileError> {
        let path = path.as_ref();
        let file = path.display().to_string();
        match dermis_io::read_text(path, dermis_io::TEXT) {
            Ok(text) => Self::from_toml(&text, &file),
            Err(source) => Err(RuleFileError::Read { file, source }),
        }
    }

    /// Reads the text of a rule file, which errors call `file`.
    ///
    /// # Errors
    ///
    /// As [`load`](Self::load).
    pub fn from_toml(text: &str, file: &str) -> Result<Self, RuleFileError> {
        let raw = parse(text, file)?;
        check(raw).map_err(|(field, reason)| {
            let line = locate::line_of(text, &field);
            RuleFileError::Field { file: file.to_owned(), line, field, reason }
        })
    }
}

/// Keys and values as they stand in the file.
fn parse(text: &str, file: &str) -> Result<RawRules, RuleFileError> {
    dermis_io::toml::parse(text).map_err(|fault| match fault {
        Fault::Syntax { line, reason, .. } => RuleFileError::Syntax { file: file.to_owned(), line, reason },
        fault => {
            let (field, reason) = fault.into_field();
            RuleFileError::Field { file: file.to_owned(), line: locate::line_of(text, &field), field, reason }
        }
    })
}

fn check(raw: RawRules) -> Result<Rules, Wrong> {
    if raw.schema != SCHEMA {
        return wrong("schema", format!("is \"{}\" where this program reads \"{SCHEMA}\"", raw.schema));
    }
    if raw.placeholders {
        return wrong(
            "placeholders",
            "the values of this file are placeholders: replace each by that of your own risk assessment, then remove this line",
        );
    }
    name_of(&raw.name, "name")?;
    for (what, number) in
        [("inputs", raw.inputs.len()), ("actions", raw.actions.len()), ("rules", raw.rules.len())]
    {
        if number == 0 || number > MOST {
            return wrong(what, format!("has {number} entries; give 1 to {MOST}"));
        }
    }
    let inputs = raw.inputs.into_iter().map(input).collect::<Result<Vec<_>, _>>()?;
    distinct(&inputs, |i| &inputs[i].topic, |i| format!("inputs.{}.topic", inputs[i].name))?;
    for (name, region) in &raw.regions {
        if region.links.is_empty() && region.skins.is_empty() {
            let reason = "has neither `links` nor `skins`; a rule without `region` is for the whole robot";
            return wrong(format!("regions.{name}"), reason);
        }
    }
    let limits = raw
        .limits
        .into_iter()
        .map(|(name, raw)| Ok((name.clone(), limits(name, &raw)?)))
        .collect::<Result<BTreeMap<_, _>, Wrong>>()?;
    let actions = raw.actions.into_iter().map(actions::action).collect::<Result<Vec<_>, _>>()?;
    actions::check_targets(&actions)?;
    let known = Known { inputs, regions: raw.regions, limits, actions };
    let mut rules: Vec<Rule> = Vec::with_capacity(raw.rules.len());
    for (i, raw) in raw.rules.into_iter().enumerate() {
        let rule = known.rule(raw).map_err(|(key, reason)| (format!("rules[{i}].{key}"), reason))?;
        if let Some(other) = rules.iter().position(|r| r.name == rule.name) {
            let reason = format!("\"{}\" is the name of rules[{other}] already", rule.name);
            return wrong(format!("rules[{i}].name"), reason);
        }
        rules.push(rule);
    }
    let Known { inputs, actions, .. } = known;
    for (i, input) in inputs.iter().enumerate() {
        if !rules.iter().any(|rule| rule.inputs.contains(&i)) {
            return wrong(format!("inputs.{}", input.name), "no rule listens to it; remove it");
        }
    }
    for (i, action) in actions.iter().enumerate() {
        if !rules.iter().any(|rule| rule.actions.contains(&i)) {
            return wrong(format!("actions.{}", action.name), "no rule does it; remove it");
        }
    }
    Ok(Rules { name: raw.name, start: raw.start, at_end: raw.at_end, inputs, actions, rules })
}

fn input((name, raw): (String, RawInput)) -> Result<Input, Wrong> {
    let field = |key: &str| format!("inputs.{name}.{key}");
    topic(&raw.topic, &field("topic"))?;
    let kind = match raw.kind {
        RawInputKind::Skin => InputKind::Skin { skin: raw.skin, link: raw.link },
        RawInputKind::Body => {
            for (key, given) in [("skin", raw.skin.is_some()), ("link", raw.link.is_some())] {
                if given {
                    return wrong(field(key), "is of use for inputs of kind \"skin\" only; remove it");
                }
            }
            InputKind::Body
        }
    };
    let timeout = positive_time(raw.timeout, &field("timeout"))?;
    let max_age = raw.max_age.map(|age| positive_time(age, &field("max_age"))).transpose()?;
    Ok(Input { name, kind, topic: raw.topic, timeout, max_age })
}

fn limits(name: String, raw: &RawLimits) -> Result<ContactLimits, Wrong> {
    let field = |key: &str| format!("limits.{name}.{key}");
    let pair = |raw: &RawPair, key: &str| -> Result<LimitPair, Wrong> {
        let of = |value: Option<f64>, what: &str| {
            value.map(|value| positive(value, &field(&format!("{key}.{what}")))).transpose()
        };
        Ok(LimitPair {
            force: of(raw.force, "force")?,
            pressure: of(raw.pressure, "pressure")?.map(|p| p * PASCALS_PER_N_PER_CM2),
        })
    };
    let (quasi_static, mut transient) =
        (pair(&raw.quasi_static, "quasi_static")?, pair(&raw.transient, "transient")?);
    if quasi_static.force.is_none() && quasi_static.pressure.is_none() {
        return wrong(field("quasi_static"), "gives neither `force` nor `pressure`; give one at least");
    }
    for (what, short, long) in [
        ("force", transient.force, quasi_static.force),
        ("pressure", transient.pressure, quasi_static.pressure),
    ] {
        match (short, long) {
            (Some(short), Some(long)) if short < long => {
                let reason = "is below that of a quasi-static contact; a short contact is allowed no less than a long one";
                return wrong(field(&format!("transient.{what}")), reason);
            }
            (Some(_), None) => {
                let reason = "is missing, while `transient` gives it; a contact that begins could last";
                return wrong(field(&format!("quasi_static.{what}")), reason);
            }
            _ => {}
        }
    }
    // A body region without transient limits is one where no transient contact is allowed.
    transient.force = transient.force.or(quasi_static.force);
    transient.pressure = transient.pressure.or(quasi_static.pressure);
    let time_to_quasi_static = positive_time(raw.time_to_quasi_static, &field("time_to_quasi_static"))?;
    let release_ratio = ratio(raw.release_ratio, USUAL_RELEASE, &field("release_ratio"))?;
    Ok(ContactLimits { name, quasi_static, transient, time_to_quasi_static, release_ratio })
}

/// What rules refer to.
struct Known {
    inputs: Vec<Input>,
    regions: BTreeMap<String, RawRegion>,
    limits: BTreeMap<String, ContactLimits>,
    actions: Vec<Action>,
}

impl Known {
    fn rule(&self, raw: RawRule) -> Result<Rule, Wrong> {
        name_of(&raw.name, "name")?;
        let region = match &raw.region {
            None => Region::default(),
            Some(name) => {
                let found = self.regions.get(name);
                let RawRegion { links, skins } =
                    found.ok_or_else(|| unknown("region", name, self.regions.keys()))?;
                Region { links: links.clone(), skins: skins.clone() }
            }
        };
        let inputs = self.listened(raw.inputs.as_deref(), &region)?;
        let limits = match &raw.limits {
            None => None,
            Some(name) => {
                let found = self.limits.get(name).cloned();
                Some(found.ok_or_else(|| unknown("limits", name, self.limits.keys()))?)
            }
        };
        if raw.actions.is_empty() {
            return wrong("actions", "is empty; name what the rule does");
        }
        let actions = names(&raw.actions, "actions", |name| self.actions.iter().position(|a| a.name == name))
            .map_err(|(field, name)| {
                let (_, reason) = unknown("actions", &name, self.actions.iter().map(|a| &a.name));
                (field, reason)
            })?;
        let threshold =
            |raw: Option<RawThreshold>, key: &str, unit: f64| -> Result<Option<Threshold>, Wrong> {
                raw.map(|raw| threshold(&raw, key, unit)).transpose()
            };
        Ok(Rule {
            region,
            region_name: raw.region,
            inputs,
            force: threshold(raw.force, "force", 1.0)?,
            pressure: threshold(raw.pressure, "pressure", PASCALS_PER_N_PER_CM2)?,
            speed: threshold(raw.speed, "speed", 1.0)?,
            slip: raw.slip,
            limits,
            counts_as_touched: raw.counts_as_touched.unwrap_or_else(|| Loss::USUAL.to_vec()),
            ignore: raw.ignore,
            least_confidence: ratio(raw.least_confidence, 0.0, "least_confidence")?,
            sigmas: within(raw.sigmas, 0.0, (0.0, 100.0), "sigmas")?,
            peak_over_mean: within(raw.peak_over_mean, 1.5, (1.0, 100.0), "peak_over_mean")?,
            hold: time(raw.hold.unwrap_or(0.0), "hold")?,
            quiet: time(raw.quiet.unwrap_or(USUAL_QUIET), "quiet")?,
            latch: raw.latch.unwrap_or(true),
            actions,
            name: raw.name,
        })
        .and_then(useful)
    }

    /// Inputs that a rule listens to: those that it names, of which each can tell of its region; or all that can.
    fn listened(&self, named: Option<&[String]>, region: &Region) -> Result<Vec<usize>, Wrong> {
        let all = || self.inputs.iter().map(|input| &input.name);
        let chosen = match named {
            None => (0..self.inputs.len()).filter(|i| tells_of(&self.inputs[*i], region)).collect(),
            Some(named) => {
                let found = names(named, "inputs", |name| self.inputs.iter().position(|i| i.name == name))
                    .map_err(|(field, name)| (field, unknown("inputs", &name, all()).1))?;
                if let Some(at) = found.iter().position(|i| !tells_of(&self.inputs[*i], region)) {
                    let reason =
                        "says nothing of the rule's region: give the input a `link` or a `skin` of it";
                    return wrong(format!("inputs[{at}]"), format!("\"{}\" {reason}", named[at]));
                }
                found
            }
        };
        // A part of the region that no input reports would never be sensed.
        let reports = |input: &usize, skin: Option<&str>, link: Option<&str>| match &self.inputs[*input].kind
        {
            InputKind::Body => true,
            InputKind::Skin { skin: s, link: l } => {
                (skin.is_some() && s.as_deref() == skin) || (link.is_some() && l.as_deref() == link)
            }
        };
        let silent_link = region.links.iter().find(|l| !chosen.iter().any(|i| reports(i, None, Some(l))));
        let silent_skin = region.skins.iter().find(|s| !chosen.iter().any(|i| reports(i, Some(s), None)));
        if let Some(part) = silent_link.or(silent_skin) {
            let reason = format!(
                "no input that the rule listens to can tell of `{part}`: add one, or give one its `link` or `skin`"
            );
            return wrong("region", reason);
        }
        if chosen.is_empty() {
            return wrong("inputs", "is empty; name what the rule listens to");
        }
        Ok(chosen)
    }
}

/// Whether an input can say something of a region.
fn tells_of(input: &Input, region: &Region) -> bool {
    match &input.kind {
        InputKind::Body => true,
        InputKind::Skin { skin, link } => {
            region.is_everything()
                || skin.as_deref().is_some_and(|skin| region.has_skin(skin))
                || link.as_deref().is_some_and(|link| region.has_link(link))
        }
    }
}

fn useful(rule: Rule) -> Result<Rule, Wrong> {
    let feels = rule.force.is_some()
        || rule.pressure.is_some()
        || rule.speed.is_some()
        || rule.slip.is_some()
        || rule.limits.is_some();
    if !feels && rule.counts_as_touched.is_empty() {
        let reason =
            "can never act: give `force`, `pressure`, `speed`, `slip`, `limits` or `counts_as_touched`";
        return wrong("name", reason);
    }
    Ok(rule)
}

fn threshold(raw: &RawThreshold, key: &str, unit: f64) -> Result<Threshold, Wrong> {
    let above = at_least_zero(raw.above, &format!("{key}.above"))?;
    let release = raw.release.unwrap_or(USUAL_RELEASE * above);
    let release = at_least_zero(release, &format!("{key}.release"))?;
    if release > above {
        let reason = format!("is {release} and may not be larger than `above`, {above}");
        return wrong(format!("{key}.release"), reason);
    }
    Ok(Threshold { above: above * unit, release: release * unit })
}

/// Indices of names; a field and the name that is not known.
fn names(given: &[String], key: &str, find: impl Fn(&str) -> Option<usize>) -> Result<Vec<usize>, Wrong> {
    let mut found = Vec::with_capacity(given.len());
    for (i, name) in given.iter().enumerate() {
        let index = find(name).ok_or_else(|| (format!("{key}[{i}]"), name.clone()))?;
        if !found.contains(&index) {
            found.push(index);
        }
    }
    Ok(found)
}

fn unknown<'a>(field: &str, name: &str, known: impl Iterator<Item = &'a String>) -> Wrong {
    let known: Vec<&str> = known.map(String::as_str).collect();
    let known = if known.is_empty() { "none".to_owned() } else { known.join(", ") };
    (field.to_owned(), format!("\"{name}\" is not in this file; there are: {known}"))
}

/// Refuses two entries of one topic.
fn distinct<'a, T>(
    all: &[T],
    target: impl Fn(usize) -> &'a str,
    field: impl Fn(usize) -> String,
) -> Result<(), Wrong> {
    for i in 0..all.len() {
        if let Some(other) = (0..i).find(|j| target(*j) == target(i)) {
            return wrong(field(i), format!("is that of `{}` already; each has its own", field(other)));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests;
