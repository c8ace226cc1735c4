//! What a run of the benchmark comes to, for files that are kept: Markdown and a picture.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;

use anyhow::Result;
use dermis_figures::{Bar, RGBColor, bars, column, matrix};
use dermis_gap_benchmark::score::{Aim, Scorecard, Share};
use serde_json::Value;

/// Colour of what is compared with.
const GREY: RGBColor = RGBColor(153, 153, 153);

/// A share with its interval.
fn shown(share: Share) -> String {
    if share.of == 0 {
        return "-".to_owned();
    }
    let [low, high] = share.interval();
    format!("{:.2} ({low:.2} to {high:.2})", share.value())
}

/// The summary for people.
#[must_use]
pub fn markdown(head: &Value, scorecard: &Scorecard, baselines: &[(String, Scorecard)]) -> String {
    let text = |v: &Value| v.as_str().unwrap_or_default().to_owned();
    let mut out = format!(
        "# Check of the diagnosis: {}\n\n`{}` with {}.\n\n",
        text(&head["skin"]),
        text(&head["command"]),
        text(&head["tool"])
    );
    // Results of before the first version say `packs`.
    let sets = head["sets"].as_array().or_else(|| head["packs"].as_array());
    for set in sets.into_iter().flatten() {
        let kind = set["kind"].as_str().unwrap_or("all kinds");
        let _ = writeln!(
            out,
            "- benchmark set of {} cases, {kind}: sha256 `{}`, reports `{}`",
            set["cases"],
            text(&set["sha256"]),
            text(&set["reports_sha256"])
        );
    }
    let _ = write!(out, "\n{}", scorecard.table());
    if !baselines.is_empty() {
        out.push_str(
            "\n| way | top-1 | top-3 | precision | false alarms | both of two |\n|---|---|---|---|---|---|\n",
        );
        let own = [("dermis".to_owned(), scorecard.clone())];
        for (name, scorecard) in own.iter().chain(baselines) {
            let s = &scorecard.headline;
            let _ = writeln!(
                out,
                "| {name} | {} | {} | {} | {} | {} |",
                shown(s.top1),
                shown(s.top3),
                shown(s.precision),
                shown(s.false_alarms),
                shown(s.both_found)
            );
        }
    }
    if !scorecard.not_in_library.is_empty() {
        let _ = writeln!(
            out,
            "\nNames that would be right and that the tool does not have: {}.",
            scorecard.not_in_library.join(", ")
        );
    }
    out
}

/// A bar of the picture: a share with its interval, and what is aimed at.
fn bar(name: &str, share: Share, aim: Option<Aim>) -> Bar {
    let text = format!("{:.2} of {}", share.value(), share.of);
    let aims = match aim {
        Some(Aim::AtLeast(v) | Aim::AtMost(v)) => vec![v],
        Some(Aim::Between(a, b)) => vec![a, b],
        None => Vec::new(),
    };
    Bar { aims, ..Bar::new(name, share.value(), text).interval(share.interval()) }
}

/// The picture: every rate with its interval and aim, top-1 of the baselines, and what was answered for each cause.
///
/// # Errors
///
/// Where it cannot be drawn.
pub fn svg(skin: &str, scorecard: &Scorecard, baselines: &[(String, Scorecard)]) -> Result<String> {
    let heading = format!(
        "{skin}: gap of at least three times the floor, {} cases; 95 % intervals, aims in orange",
        scorecard.headline.cases
    );
    let rates = scorecard.headline.rates().into_iter().filter(|(_, share, _)| share.of > 0);
    let rates: Vec<Bar> = rates.map(|(name, share, aim)| bar(name, share, aim)).collect();
    let mut pictures = vec![bars(&heading, &rates, Some(1.0))?];
    let grey = |bar: Bar| Bar { colour: GREY, ..bar };
    let others = baselines.iter().filter(|(_, scorecard)| scorecard.headline.top1.of > 0);
    let others: Vec<Bar> =
        others.map(|(name, scorecard)| grey(bar(name, scorecard.headline.top1, None))).collect();
    if !others.is_empty() {
        pictures.push(bars("top-1 of simpler ways", &others, Some(1.0))?);
    }
    pictures.push(confusion(scorecard)?);
    Ok(column(&pictures))
}

/// Rows: what was withheld. Columns: the label of the first class.
fn confusion(scorecard: &Scorecard) -> Result<String> {
    let label = |said: &str| said.split(" or ").next().unwrap_or_default().to_owned();
    let mut table: BTreeMap<&str, BTreeMap<String, usize>> = BTreeMap::new();
    for (cause, answers) in &scorecard.headline.confusion {
        for (said, count) in answers {
            *table.entry(cause).or_default().entry(label(said)).or_default() += count;
        }
    }
    let columns: BTreeSet<String> = table.values().flat_map(BTreeMap::keys).cloned().collect();
    let columns: Vec<String> = columns.into_iter().collect();
    let counts = |answers: &BTreeMap<String, usize>| {
        columns.iter().map(|column| answers.get(column).copied().unwrap_or(0)).collect()
    };
    let rows: Vec<(String, Vec<usize>)> =
        table.iter().map(|(cause, answers)| ((*cause).to_owned(), counts(answers))).collect();
    Ok(matrix("withheld (rows) and first answer (columns), number of cases", &columns, &rows)?)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn a_check_is_summed_up_for_people_and_eyes() {
        let mut scorecard = Scorecard::default();
        scorecard.headline.cases = 3;
        scorecard.headline.top1 = Share::default().and(1.0).and(1.0).and(0.0);
        scorecard.headline.confusion.insert("cavity".to_owned(), [("a or b".to_owned(), 2)].into());
        let head = json!({ "skin": "s", "command": "c", "tool": "t", "sets": [{ "cases": 3, "sha256": "x", "reports_sha256": "y" }] });
        let text = markdown(&head, &scorecard, &[("nearest".to_owned(), scorecard.clone())]);
        assert!(text.contains("| top-1, class-weighted | 0.667 | 0.21 to 0.94 | 3 | ≥ 0.9 | no |"), "{text}");
        assert!(text.contains("| cavity | 2× a or b |"), "{text}");
        let picture = svg("s", &scorecard, &[]).unwrap();
        assert!(picture.contains(">\ncavity\n</text>") && picture.contains("0.67 of 3"), "{picture}");
        assert!(picture.contains(">\na\n</text>") && !picture.contains("simpler ways"), "{picture}");
        let compared = svg("s", &scorecard, &[("nearest".to_owned(), scorecard.clone())]).unwrap();
        assert!(compared.contains(">\nnearest\n</text>") && compared.contains("#999999"), "{compared}");
    }
}
