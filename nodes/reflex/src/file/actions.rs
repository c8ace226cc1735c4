//! Actions of a rule file.

use serde::Deserialize;

use super::numbers::{positive_time, ratio, topic};
use super::{Wrong, wrong};
use crate::rules::{Action, ActionKind};

#[derive(Deserialize)]
#[serde(rename_all = "snake_case")]
enum Kind {
    Bool,
    Empty,
    Twist,
    SpeedScale,
    Trigger,
    Cancel,
}

/// An action with the keys of every kind.
#[derive(Deserialize)]
pub(super) struct RawAction {
    kind: Kind,
    topic: Option<String>,
    service: Option<String>,
    action: Option<String>,
    value: Option<bool>,
    scale: Option<f64>,
    stamped: Option<String>,
    repeat: Option<f64>,
    heartbeat: Option<f64>,
}

/// \[s\] after which a message is sent again: one can be lost.
const USUAL_REPEAT: f64 = 0.05;
/// \[s\] after which a call that was not answered, or not with success, is made again.
const USUAL_CALL_REPEAT: f64 = 0.5;

pub(super) fn action((name, raw): (String, RawAction)) -> Result<Action, Wrong> {
    let field = |key: &str| format!("actions.{name}.{key}");
    let (target_key, allowed): (&str, &[&str]) = match raw.kind {
        Kind::Bool => ("topic", &["value", "heartbeat"]),
        Kind::Empty => ("topic", &[]),
        Kind::Twist => ("topic", &["stamped"]),
        Kind::SpeedScale => ("topic", &["scale", "heartbeat"]),
        Kind::Trigger => ("service", &[]),
        Kind::Cancel => ("action", &[]),
    };
    for (key, given) in [
        ("topic", raw.topic.is_some()),
        ("service", raw.service.is_some()),
        ("action", raw.action.is_some()),
        ("value", raw.value.is_some()),
        ("scale", raw.scale.is_some()),
        ("stamped", raw.stamped.is_some()),
        ("heartbeat", raw.heartbeat.is_some()),
    ] {
        if given && key != target_key && !allowed.contains(&key) {
            return wrong(field(key), "is of no use for this kind of action; remove it");
        }
    }
    let given = match target_key {
        "topic" => raw.topic,
        "service" => raw.service,
        _ => raw.action,
    };
    let Some(target) = given else {
        return wrong(field(target_key), "is missing; say where it goes");
    };
    topic(&target, &field(target_key))?;
    let kind = match raw.kind {
        Kind::Bool => ActionKind::Bool { topic: target, value: raw.value.unwrap_or(true) },
        Kind::Empty => ActionKind::Empty { topic: target },
        Kind::Twist => ActionKind::Twist { topic: target, stamped: raw.stamped },
        Kind::SpeedScale => {
            let Some(scale) = raw.scale else {
                return wrong(field("scale"), "is missing; give the share of the speed, 0 to 1");
            };
            ActionKind::SpeedScale { topic: target, scale: ratio(Some(scale), 0.0, &field("scale"))? }
        }
        Kind::Trigger => ActionKind::Trigger { service: target },
        Kind::Cancel => ActionKind::Cancel { action: target },
    };
    let usual = if kind.is_call() { USUAL_CALL_REPEAT } else { USUAL_REPEAT };
    let repeat = positive_time(raw.repeat.unwrap_or(usual), &field("repeat"))?;
    let heartbeat = raw.heartbeat.map(|period| positive_time(period, &field("heartbeat"))).transpose()?;
    Ok(Action { name, kind, repeat, heartbeat })
}

/// Refuses two actions that would contradict each other: only speed scales may share a topic, because the smallest counts.
pub(super) fn check_targets(actions: &[Action]) -> Result<(), Wrong> {
    for (i, action) in actions.iter().enumerate() {
        let same = |other: &&Action| {
            other.kind.is_call() == action.kind.is_call() && other.kind.target() == action.kind.target()
        };
        let Some(other) = actions[..i].iter().find(same) else { continue };
        let scales = action.kind.scales_with(&other.kind);
        if scales && (action.repeat, action.heartbeat) != (other.repeat, other.heartbeat) {
            let reason = format!(
                "shares its topic with `{}`; give both the same `repeat` and `heartbeat`",
                other.name
            );
            return wrong(format!("actions.{}", action.name), reason);
        }
        if !scales {
            let reason = format!("goes where `{}` goes; let the rules share one action", other.name);
            return wrong(format!("actions.{}", action.name), reason);
        }
    }
    Ok(())
}
