//! Scores of a whole benchmark set, and their table.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;

use serde::Serialize;

use super::{Aim, Answer, Cells, Mapping, Scores};
use crate::set::GroundTruth;

/// Scores of a whole benchmark set: all cases, those with a gap of at least three times the floor, and those of each gap and noise.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Scorecard {
    /// All cases.
    pub all: Scores,
    /// Gap at least three times the floor; controls and causes outside of the library included.
    pub headline: Scores,
    /// By gap, controls having none, in multiples of the floor.
    pub by_gap: BTreeMap<String, Scores>,
    /// By noise in multiples of the skin's, of those of the headline.
    pub by_noise: BTreeMap<String, Scores>,
    /// Apart by what is withheld.
    pub cells: Cells,
    /// Names that the mapping accepts and the tool does not have.
    pub not_in_library: Vec<String>,
}

impl Scorecard {
    /// Scores of answers, one a ground truth, of a tool that has the effects of `library`.
    #[must_use]
    pub fn new<'a>(
        cases: impl IntoIterator<Item = (&'a GroundTruth, &'a Answer)>,
        mapping: &Mapping,
        library: &BTreeSet<String>,
    ) -> Self {
        let names: BTreeSet<&String> = mapping.causes.values().flat_map(|a| &a.names).collect();
        let not_in_library = names.into_iter().filter(|n| !library.contains(*n)).cloned().collect();
        let mut scorecard = Self { not_in_library, ..Self::default() };
        let mapping = mapping.within(library);
        for (truth, answer) in cases {
            scorecard.all.add(truth, answer, &mapping, library);
            scorecard.cells.add(truth, answer, &mapping);
            let gap = scorecard.by_gap.entry(format!("{}", truth.gap)).or_default();
            gap.add(truth, answer, &mapping, library);
            if truth.gap == 0.0 || truth.gap >= 3.0 {
                scorecard.headline.add(truth, answer, &mapping, library);
                let noise = scorecard.by_noise.entry(format!("{}", truth.noise)).or_default();
                noise.add(truth, answer, &mapping, library);
            }
        }
        scorecard
    }

    /// As Markdown: the headline with what is aimed at, the main rates by gap and noise, and what was answered for each cause.
    #[must_use]
    pub fn table(&self) -> String {
        let mut text = String::from(
            "Gap of at least three times the floor, controls, and causes outside of the library:\n\n\
             | score | value | 95 % | of | aim | reached |\n|---|---|---|---|---|---|\n",
        );
        let s = &self.headline;
        let reached = |aim: Option<Aim>, value: f64| {
            aim.map_or((String::new(), ""), |a| (a.text(), if a.reached(value) { "yes" } else { "no" }))
        };
        for (name, share, aim) in s.rates().into_iter().filter(|(_, share, _)| share.of > 0) {
            let [low, high] = share.interval();
            let (aim, reached) = reached(aim, share.value());
            let value = share.value();
            let _ = writeln!(
                text,
                "| {name} | {value:.3} | {low:.2} to {high:.2} | {} | {aim} | {reached} |",
                share.of
            );
        }
        for (name, value, count, aim) in s.middles().into_iter().filter(|(_, _, count, _)| *count > 0) {
            let (aim, reached) = reached(aim, value);
            let _ = writeln!(text, "| {name} | {value:.3} | | {count} | {aim} | {reached} |");
        }
        text.push_str(
            "\n| cases | number | top-1 | top-3 | precision | false alarms | unknown found | both found | located |\n\
             |---|---|---|---|---|---|---|---|---|\n",
        );
        let gaps = self.by_gap.iter().map(|(gap, s)| (format!("gap {gap} × floor"), s));
        let noises = self.by_noise.iter().map(|(noise, s)| (format!("noise × {noise}"), s));
        for (name, s) in gaps.chain(noises) {
            let _ = write!(text, "| {name} | {}", s.cases);
            let of = [s.top1, s.top3, s.precision, s.false_alarms, s.unknown_found, s.both_found, s.located];
            for share in of {
                let _ = match share.of {
                    0 => write!(text, " | -"),
                    of => write!(text, " | {:.2} of {of}", share.value()),
                };
            }
            text.push_str(" |\n");
        }
        text.push_str(&self.cells.table());
        if !s.confusion.is_empty() {
            text.push_str("\n| withheld | answered first |\n|---|---|\n");
            for (cause, answers) in &s.confusion {
                let mut said: Vec<(&String, &usize)> = answers.iter().collect();
                said.sort_by(|a, b| b.1.cmp(a.1));
                let said: Vec<String> = said.iter().map(|(name, n)| format!("{n}× {name}")).collect();
                let _ = writeln!(text, "| {cause} | {} |", said.join(", "));
            }
        }
        text
    }
}
