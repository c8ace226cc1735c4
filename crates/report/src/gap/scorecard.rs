//! What a run of the benchmark comes to, for files that are kept: Markdown and a picture.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;

use dermis_figures::escape as escaped;
use dermis_gap_benchmark::score::{Aim, Scorecard, Share};
use serde_json::Value;

/// \[px\] of the picture.
const WIDTH: f64 = 980.0;
/// \[px\] of a line of it.
const LINE: f64 = 20.0;
/// \[px\] from the left to the bars, and of a whole bar.
const BARS: [f64; 2] = [390.0, 420.0];

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
pub fn markdown(head: &Value, card: &Scorecard, baselines: &[(String, Scorecard)]) -> String {
    let text = |v: &Value| v.as_str().unwrap_or_default().to_owned();
    let mut out = format!(
        "# Check of the diagnosis: {}\n\n`{}` with {}.\n\n",
        text(&head["skin"]),
        text(&head["command"]),
        text(&head["tool"])
    );
    for pack in head["packs"].as_array().into_iter().flatten() {
        let kind = pack["kind"].as_str().unwrap_or("all kinds");
        let _ = writeln!(
            out,
            "- pack of {} cases, {kind}: sha256 `{}`, reports `{}`",
            pack["cases"],
            text(&pack["sha256"]),
            text(&pack["reports_sha256"])
        );
    }
    let _ = write!(out, "\n{}", card.table());
    if !baselines.is_empty() {
        out.push_str(
            "\n| way | top-1 | top-3 | precision | false alarms | both of two |\n|---|---|---|---|---|---|\n",
        );
        let own = [("dermis".to_owned(), card.clone())];
        for (name, card) in own.iter().chain(baselines) {
            let s = &card.headline;
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
    if !card.not_in_library.is_empty() {
        let _ = writeln!(
            out,
            "\nNames that would be right and that the tool does not have: {}.",
            card.not_in_library.join(", ")
        );
    }
    out
}

/// A line of the picture: name, share with its interval, and what is aimed at.
fn bar(out: &mut String, y: f64, (name, share, aim): (&str, Share, Option<Aim>), colour: &str) {
    let [left, whole] = BARS;
    let [low, high] = share.interval().map(|v| left + whole * v);
    let middle = y - 0.2 * LINE;
    let _ = write!(
        out,
        "<text x=\"{:.1}\" y=\"{y:.1}\" text-anchor=\"end\">{}</text>\
         <rect x=\"{left:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"10\" fill=\"{colour}\"/>\
         <path d=\"M{low:.1} {middle:.1}H{high:.1}M{low:.1} {:.1}v8M{high:.1} {:.1}v8\" stroke=\"#222\" fill=\"none\"/>\
         <text x=\"{:.1}\" y=\"{y:.1}\">{:.2} of {}</text>",
        left - 8.0,
        escaped(name),
        middle - 5.0,
        whole * share.value(),
        middle - 4.0,
        middle - 4.0,
        left + whole + 8.0,
        share.value(),
        share.of
    );
    let limits = match aim {
        Some(Aim::AtLeast(v) | Aim::AtMost(v)) => vec![v],
        Some(Aim::Between(a, b)) => vec![a, b],
        None => Vec::new(),
    };
    for limit in limits {
        let x = left + whole * limit;
        let _ =
            write!(out, "<path d=\"M{x:.1} {:.1}v14\" stroke=\"#d55e00\" stroke-width=\"2\"/>", middle - 7.0);
    }
}

/// The picture: every rate with its interval and aim, top-1 of the baselines, and what was answered for each cause.
#[must_use]
pub fn svg(skin: &str, card: &Scorecard, baselines: &[(String, Scorecard)]) -> String {
    let mut body = String::new();
    let mut y = 1.5 * LINE;
    let title = |body: &mut String, y: f64, text: &str| {
        let _ = write!(body, "<text x=\"16\" y=\"{y:.1}\" font-weight=\"bold\">{}</text>", escaped(text));
    };
    title(
        &mut body,
        y,
        &format!(
            "{skin}: gap of at least three times the floor, {} cases; 95 % intervals, aims in orange",
            card.headline.cases
        ),
    );
    for (name, share, aim) in card.headline.rates().into_iter().filter(|(_, share, _)| share.of > 0) {
        y += LINE;
        bar(&mut body, y, (name, share, aim), "#0072b2");
    }
    if !baselines.is_empty() {
        y += 1.6 * LINE;
        title(&mut body, y, "top-1 of simpler ways");
        for (name, card) in baselines.iter().filter(|(_, card)| card.headline.top1.of > 0) {
            y += LINE;
            bar(&mut body, y, (name, card.headline.top1, None), "#999");
        }
    }
    // Rows: what was withheld. Columns: the label of the first class.
    let label = |said: &str| said.split(" or ").next().unwrap_or_default().to_owned();
    let mut table: BTreeMap<&str, BTreeMap<String, usize>> = BTreeMap::new();
    for (cause, answers) in &card.headline.confusion {
        for (said, count) in answers {
            *table.entry(cause).or_default().entry(label(said)).or_default() += count;
        }
    }
    let columns: BTreeSet<&String> = table.values().flat_map(BTreeMap::keys).collect();
    let (left, cell) = (190.0, ((WIDTH - 210.0) / columns.len().max(1) as f64).min(LINE));
    y += 1.6 * LINE;
    title(&mut body, y, "withheld (rows) and first answer (columns), number of cases");
    y += 130.0;
    for (i, column) in columns.iter().enumerate() {
        let x = left + (i as f64 + 0.7) * cell;
        let _ = write!(
            body,
            "<text transform=\"translate({x:.1} {:.1}) rotate(-60)\" font-size=\"11\">{}</text>",
            y - 4.0,
            escaped(column)
        );
    }
    for (cause, answers) in &table {
        let all: usize = answers.values().sum();
        let _ = write!(
            body,
            "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
            left - 6.0,
            y + 0.75 * LINE,
            escaped(cause)
        );
        for (i, column) in columns.iter().enumerate() {
            let count = answers.get(*column).copied().unwrap_or(0);
            let shade = 255 - (200 * count / all.max(1)) as u8;
            let x = left + i as f64 * cell;
            let _ = write!(
                body,
                "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{cell:.1}\" height=\"{LINE}\" fill=\"rgb({shade},{shade},255)\" stroke=\"#eee\"/>"
            );
            if count > 0 {
                let _ = write!(
                    body,
                    "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\" font-size=\"11\">{count}</text>",
                    x + 0.5 * cell,
                    y + 0.72 * LINE
                );
            }
        }
        y += LINE;
    }
    let height = y + LINE;
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{WIDTH}\" height=\"{height:.0}\" viewBox=\"0 0 {WIDTH} {height:.0}\" \
         font-family=\"sans-serif\" font-size=\"13\"><rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>{body}</svg>\n"
    )
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn a_check_is_summed_up_for_people_and_eyes() {
        let mut card = Scorecard::default();
        card.headline.cases = 3;
        card.headline.top1 = Share::default().and(1.0).and(1.0).and(0.0);
        card.headline.confusion.insert("cavity".to_owned(), [("a or b".to_owned(), 2)].into());
        let head = json!({ "skin": "s", "command": "c", "tool": "t", "packs": [{ "cases": 3, "sha256": "x", "reports_sha256": "y" }] });
        let text = markdown(&head, &card, &[("nearest".to_owned(), card.clone())]);
        assert!(text.contains("| top-1, class-weighted | 0.667 | 0.21 to 0.94 | 3 | ≥ 0.9 | no |"), "{text}");
        assert!(text.contains("| cavity | 2× a or b |"), "{text}");
        let picture = svg("s", &card, &[]);
        assert!(picture.contains(">cavity</text>") && picture.contains("0.67 of 3"), "{picture}");
    }
}
