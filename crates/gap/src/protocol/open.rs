//! What a report leaves open, as hypotheses that presses can tell apart.
//!
//! The members of its classes come first, at the values that were fitted to them. Beside each name stand the effects that explain most when
//! they come alone: a recording that asks too little names the wrong one for sure, and only a press that it did not have shows it.

use std::collections::BTreeSet;

use dermis_skin::{Effect, EffectInfo};

use super::design::Hypothesis;
use crate::constants::protocol::{FIRM, SUSPECTED, SUSPECTS, UNKNOWN};
use crate::report::{Report, Verdict};
use crate::select::Tier;

/// What a report leaves open.
#[derive(Debug, Clone, PartialEq)]
pub struct Open {
    /// What may be the cause, the named one first.
    pub hypotheses: Vec<Hypothesis>,
    /// Effects that are there whichever of them is right.
    pub beside: Vec<Effect>,
    /// Share of the time for what none of them explains.
    pub unknown: f64,
}

/// What a report leaves open; `known` are the effects of the skin's family.
#[must_use]
pub fn open(report: &Report, known: &[EffectInfo]) -> Open {
    let mut hypotheses = report.hypotheses.clone();
    // At fitted values where there are some, else as the family says it is typically.
    let values = |name: &str| -> Vec<Effect> {
        let fitted: Vec<Effect> = report.corrected.iter().filter(|e| e.name == name).cloned().collect();
        if !fitted.is_empty() {
            return fitted;
        }
        known.iter().filter(|info| info.name == name).map(|info| Effect::new(info.name)).collect()
    };
    let mut add = |name: &str, p_confuse: f64| {
        if !hypotheses.iter().any(|h| h.name == name) {
            hypotheses.push(Hypothesis { name: name.to_owned(), effects: values(name), p_confuse });
        }
    };
    for member in report.effects.iter().flat_map(|e| &e.class) {
        add(&member.name, member.p_confuse.clamp(FIRM, 0.5));
    }
    let sure = report.verdict == Verdict::Named && report.effects.iter().all(|e| e.tier == Tier::Strict);
    let named: BTreeSet<&str> = report.effects.iter().map(|e| e.label.as_str()).collect();
    let suspects = report.suspects.iter().filter(|s| !named.contains(s.name.as_str()));
    for suspect in suspects.take(SUSPECTS) {
        add(&suspect.name, if sure { FIRM } else { SUSPECTED });
    }
    let switched: BTreeSet<&str> =
        hypotheses.iter().flat_map(|h| &h.effects).map(|e| e.name.as_str()).collect();
    let beside = report.corrected.iter().filter(|e| !switched.contains(e.name.as_str())).cloned().collect();
    let [least, most] = UNKNOWN;
    // "Unknown" is a hypothesis as well, as probable as its evidence says.
    let probable = report.unknown.evidence.map_or(0.0, |odds| 1.0 / (1.0 + (-odds).exp()));
    let unknown = match report.verdict {
        _ if hypotheses.len() < 2 => 1.0,
        Verdict::Named => probable.clamp(least, most),
        _ => report.unknown.share.max(probable).clamp(least, most),
    };
    Open { hypotheses, beside, unknown }
}
