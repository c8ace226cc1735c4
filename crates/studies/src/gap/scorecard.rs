//! Scores of the benchmark for programs.

use std::collections::BTreeMap;

use dermis_gap_benchmark::score::{Aim, CellScores, Cells, Scorecard, Scores, Share};
use serde::Serialize;
use serde_json::{Value, json};

/// Rates with their intervals and middle values of one set of cases.
fn scores(scores: &Scores) -> Value {
    let mut values = serde_json::Map::new();
    for (name, share, aim) in scores.rates().into_iter().filter(|(_, share, _)| share.of > 0) {
        let mut value = json!({ "value": share.value(), "wilson_95": share.interval(), "of": share.of });
        note(&mut value, aim, share.value());
        values.insert(name.to_owned(), value);
    }
    for (name, middle, count, aim) in scores.middles().into_iter().filter(|(_, _, count, _)| *count > 0) {
        let mut value = json!({ "value": middle, "of": count });
        note(&mut value, aim, middle);
        values.insert(name.to_owned(), value);
    }
    json!({ "cases": scores.cases, "scores": values })
}

fn note(value: &mut Value, aim: Option<Aim>, found: f64) {
    if let Some(aim) = aim {
        value["aim"] = json!(aim.text());
        value["reached"] = json!(aim.reached(found));
    }
}

fn group(groups: &BTreeMap<String, Scores>) -> Value {
    groups.iter().map(|(name, of)| (name.clone(), scores(of))).collect::<serde_json::Map<_, _>>().into()
}

/// The summary without the single cases. `head` says which tool, command and sets.
pub(super) fn json(
    head: &Value,
    scorecard: &Scorecard,
    followed: &[Scorecard],
    baselines: &[(String, Scorecard)],
) -> Value {
    let mut summary = head.clone();
    summary["headline"] = scores(&scorecard.headline);
    summary["all"] = scores(&scorecard.all);
    summary["by_gap"] = group(&scorecard.by_gap);
    summary["by_noise"] = group(&scorecard.by_noise);
    summary["cells"] = cells(&scorecard.cells);
    if !followed.is_empty() {
        summary["follow_ups"] = followed.iter().map(|after| cells(&after.cells)).collect();
    }
    summary["confusion"] = json!(scorecard.headline.confusion);
    summary["not_in_library"] = json!(scorecard.not_in_library);
    summary["baselines"] = baselines
        .iter()
        .map(|(name, of)| json!({ "name": name, "headline": scores(&of.headline) }))
        .collect();
    summary
}

/// A word as files say it.
fn text(of: &impl Serialize) -> String {
    json!(of).as_str().unwrap_or_default().to_owned()
}

/// Cells with their intervals.
fn cells(of: &Cells) -> Value {
    let share = |s: &Share| json!({ "value": s.value(), "wilson_95": s.interval(), "of": s.of });
    let cell = |s: &CellScores| {
        let mut value = json!({ "cases": s.cases, "confusion": s.confusion });
        let rates = [
            ("first_right", s.first),
            ("class_holds", s.class),
            ("firm_right", s.firm),
            ("loose_right", s.loose),
            ("unknown", s.unknown),
            ("unknown_nothing_wrong", s.unknown_only),
            ("firm_wrong", s.firm_wrong),
            ("seen", s.seen),
            ("all_of_several", s.all),
        ];
        for (name, rate) in rates.into_iter().filter(|(_, rate)| rate.of > 0) {
            value[name] = share(&rate);
        }
        value
    };
    json!({
        "cells": of.cells.iter().map(|(c, s)| (text(c), cell(s))).collect::<serde_json::Map<_, _>>(),
        "false_names_on_controls":
            of.false_names.iter().map(|(d, s)| (text(d), share(s))).collect::<serde_json::Map<_, _>>(),
        "unknown_auroc": of.unknown,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_check_is_summed_up_for_programs() {
        let mut scorecard = Scorecard::default();
        scorecard.headline.cases = 3;
        scorecard.headline.top1 = Share::default().and(1.0).and(1.0).and(0.0);
        let head = json!({ "skin": "s", "command": "c", "tool": "t", "sets": [] });
        let summary = json(&head, &scorecard, &[], &[]);
        let top1 = &summary["headline"]["scores"]["top-1, class-weighted"];
        assert_eq!((top1["of"].as_u64(), top1["reached"].as_bool()), (Some(3), Some(false)));
    }
}
