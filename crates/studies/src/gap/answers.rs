//! What a report says, in the words of the scorecard.

use std::collections::BTreeMap;

use dermis_gap_benchmark::score::{Answer, Named, SAME};
use serde_json::Value;

/// What a report says, as scores need it.
pub(super) fn answer(report: &Value) -> Answer {
    let text = |v: &Value| v.as_str().unwrap_or_default().to_owned();
    let pair = |v: &Value| -> Option<[f64; 2]> { Some([v.get(0)?.as_f64()?, v.get(1)?.as_f64()?]) };
    let verdict = text(&report["verdict"]);
    // `closure` in reports of `gap-report/1`.
    let reduction = report.get("residual_reduction").unwrap_or(&report["closure"]);
    let mut answer = Answer {
        gap: matches!(verdict.as_str(), "named" | "named-and-unknown" | "unknown-systematic" | "unmeasured"),
        unknown: matches!(verdict.as_str(), "unknown-systematic" | "unmeasured" | "named-and-unknown"),
        residual_reduction: reduction["predicted"]
            .as_f64()
            .zip(reduction["achieved"].as_f64())
            .map(<[f64; 2]>::from),
        interval: pair(&reduction["interval"]),
        verdict: verdict.clone(),
        ..Answer::default()
    };
    answer.unexplained = if answer.gap { report["unknown"]["share"].as_f64() } else { None };
    // Odds become a probability, so that it compares with the shares of reports that say none.
    let odds = report["unknown"]["evidence"].as_f64().filter(|_| answer.gap);
    answer.evidence = odds.map(|odds| 1.0 / (1.0 + (-odds).exp()));
    let list = |v: &Value| v.as_array().cloned().unwrap_or_default();
    answer.axes = list(&report["where"]).iter().map(|axis| text(&axis["axis"])).collect();
    let fvu = |bin: &Value| bin["fvu"].as_f64().unwrap_or(0.0);
    let channels = list(&report["channels"]);
    let worst = channels.iter().max_by(|a, b| fvu(a).total_cmp(&fvu(b)));
    answer.channel = worst.map(|bin| text(&bin["label"]));
    let peak = &report["maps"][0]["peak"];
    answer.peak = peak[0].as_f64().zip(peak[1].as_f64()).zip(peak[2].as_f64()).map(|((x, y), z)| [x, y, z]);
    for effect in report["effects"].as_array().into_iter().flatten() {
        let mut named = Named { firm: effect["tier"] == "strict", ..Named::default() };
        for member in effect["class"].as_array().into_iter().flatten() {
            let name = member.as_str().map_or_else(|| text(&member["name"]), str::to_owned);
            // Another name of the member before it is no other answer.
            match named.class.last_mut().filter(|_| member["alias"] == true) {
                Some(last) => last.push_str(&format!("{SAME}{name}")),
                None => named.class.push(name),
            }
        }
        let label = text(&effect["label"]);
        if named.class.is_empty() {
            named.class.push(label.clone());
        }
        let first = named.class[0].split(SAME).next().unwrap_or_default().to_owned();
        let mut parameters = BTreeMap::new();
        for theta in effect["theta"].as_array().into_iter().flatten() {
            if let Some(value) = theta["value"].as_f64() {
                let name = text(&theta["name"]);
                let interval = pair(&theta["interval"]).or_else(|| pair(&theta["ci"]));
                parameters.insert(format!("{first}.{name}"), (value, interval));
            }
        }
        named.parameters = parameters;
        answer.ranking.extend(named.class.iter().cloned());
        answer.named.push(named);
    }
    answer
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_report_becomes_an_answer() {
        let report = serde_json::json!({
            "verdict": "named",
            "effects": [
                { "label": "thickness", "tier": "strict", "class": [{ "name": "thickness" }, { "name": "base-bonding" }],
                  "theta": [{ "name": "change", "value": -0.001, "interval": [-0.002, 0.0] }] },
                { "label": "friction", "tier": "loose", "class": [{ "name": "friction" }] },
            ],
            "closure": { "predicted": 0.9, "achieved": 0.8, "interval": [0.7, 0.95] },
        });
        let answer = answer(&report);
        assert!(answer.gap && !answer.unknown);
        assert_eq!(answer.ranking, ["thickness", "base-bonding", "friction"]);
        assert!(answer.named[0].firm && !answer.named[1].firm);
        assert_eq!(answer.named[0].parameters["thickness.change"], (-0.001, Some([-0.002, 0.0])));
        assert_eq!((answer.residual_reduction, answer.interval), (Some([0.9, 0.8]), Some([0.7, 0.95])));
        let named = |class: Value| {
            let effects = serde_json::json!([{ "label": "modulus", "tier": "strict", "class": class }]);
            super::answer(&serde_json::json!({ "verdict": "named", "effects": effects })).named[0]
                .class
                .clone()
        };
        let alias = serde_json::json!({ "name": "medium.young_modulus", "alias": true });
        let class = serde_json::json!([{ "name": "modulus" }, alias, { "name": "thickness" }]);
        assert_eq!(named(class), ["modulus = medium.young_modulus", "thickness"]);
        assert!(!super::answer(&serde_json::json!({ "verdict": "no-gap-beyond-noise" })).gap);
        let evidence = |verdict: &str| {
            let unknown = serde_json::json!({ "share": 0.1, "evidence": 3.0f64.ln() });
            super::answer(&serde_json::json!({ "verdict": verdict, "unknown": unknown })).evidence
        };
        assert!((evidence("named").unwrap() - 0.75).abs() < 1e-12);
        assert_eq!(evidence("model-discrepancy"), None);
    }
}
