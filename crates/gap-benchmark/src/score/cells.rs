//! The scorecard by cells: rates of causes that differ in kind are never averaged.
//!
//! A case belongs to one cell, by what is withheld and by what the tool's library holds: an effect that the library lacks is foreign to it,
//! whatever the literature lists. Shares have Wilson's 95 % intervals (Wilson 1927). How well a tool tells what is foreign from what it
//! knows is the area under the ROC curve of its own evidence for "unknown" (probability that a foreign case gets more of it than a known
//! one; Hanley and McNeil 1982, with their standard error).

use std::collections::BTreeMap;
use std::fmt::Write;

use serde::Serialize;

use super::{Answer, Mapping, Named, Share};
use crate::Cell;
use crate::set::{Disturbance, GroundTruth, Kind};

/// Scores of one cell.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct CellScores {
    /// Cases.
    pub cases: usize,
    /// First name right, a class counted as one over its size.
    pub first: Share,
    /// The first class holds the right name.
    pub class: Share,
    /// Firm names that stand alone in their class: right.
    pub firm: Share,
    /// Other names, loose ones and members of a class: the right one is among them.
    pub loose: Share,
    /// Called unknown, alone or beside a name.
    pub unknown: Share,
    /// Called unknown, and nothing wrong is named for sure.
    pub unknown_only: Share,
    /// A firm name that is wrong.
    pub firm_wrong: Share,
    /// A gap is seen.
    pub seen: Share,
    /// Several causes: all of them named.
    pub all: Share,
    /// What was answered first, by what is withheld.
    pub confusion: BTreeMap<String, BTreeMap<String, usize>>,
}

/// Area under the ROC curve with its 95 % interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Auroc {
    /// The area.
    pub value: f64,
    /// Of Hanley and McNeil.
    pub interval: [f64; 2],
    /// Foreign cases, and known ones.
    pub of: [usize; 2],
}

impl Auroc {
    /// Of the evidence for "unknown" of foreign and of known cases; `None` where one kind is missing.
    #[must_use]
    pub fn of(foreign: &[f64], known: &[f64]) -> Option<Self> {
        if foreign.is_empty() || known.is_empty() {
            return None;
        }
        let (n, m) = (foreign.len() as f64, known.len() as f64);
        let won = |a: &f64, b: &f64| {
            if a > b {
                1.0
            } else if a < b {
                0.0
            } else {
                0.5
            }
        };
        let sum: f64 = foreign.iter().map(|a| known.iter().map(|b| won(a, b)).sum::<f64>()).sum();
        let area = sum / (n * m);
        let (q1, q2) = (area / (2.0 - area), 2.0 * area * area / (1.0 + area));
        let variance =
            (area * (1.0 - area) + (n - 1.0) * (q1 - area * area) + (m - 1.0) * (q2 - area * area)) / (n * m);
        let half = 1.959_964 * variance.max(0.0).sqrt();
        let interval = [(area - half).max(0.0), (area + half).min(1.0)];
        Some(Self { value: area, interval, of: [foreign.len(), known.len()] })
    }
}

/// Scores by cell, of gaps of at least three floors.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Cells {
    /// By cell.
    pub cells: BTreeMap<Cell, CellScores>,
    /// Controls where a firm effect is named, by what disturbs them.
    pub false_names: BTreeMap<Disturbance, Share>,
    /// How well the evidence for "unknown" tells what is foreign.
    pub unknown: Option<Auroc>,
    #[serde(skip)]
    evidence: [Vec<f64>; 2],
}

/// The cell of a case for a tool that has the names of `mapping` only.
#[must_use]
pub fn cell(truth: &GroundTruth, mapping: &Mapping) -> Cell {
    match &truth.causes[..] {
        [] => Cell::Controls,
        [_] if truth.kind == Kind::Confounded => Cell::Hard,
        [one] => {
            let held = !mapping.of(&one.cause.id).is_empty();
            match crate::cell_of(&one.cause.id).unwrap_or(Cell::Foreign) {
                cell @ (Cell::DoesNotRepeat | Cell::DesignNumber) => cell,
                // What the literature does not list and the tool has all the same was not written after the tool.
                Cell::Foreign if held => Cell::OtherLaw,
                cell if held => cell,
                _ => Cell::Foreign,
            }
        }
        [_, _] => Cell::TwoCauses,
        _ => Cell::Hard,
    }
}

impl Cells {
    /// Adds a case. Gaps below three floors are left out.
    pub fn add(&mut self, truth: &GroundTruth, answer: &Answer, mapping: &Mapping) {
        if truth.gap > 0.0 && truth.gap < 3.0 {
            return;
        }
        let cell = cell(truth, mapping);
        let yes = |so: bool| f64::from(u8::from(so));
        let right = |name: &String| truth.causes.iter().any(|t| mapping.right(&t.cause.id, name));
        let hit = |named: &Named| named.class.iter().any(right);
        let sure = |named: &&Named| named.firm && named.class.len() == 1;
        let scores = self.cells.entry(cell).or_default();
        scores.cases += 1;
        let first = answer.named.first();
        let wrong = answer.named.iter().any(|n| n.firm && !hit(n));
        if cell != Cell::Controls {
            let share =
                |n: &Named| n.class.iter().filter(|name| right(name)).count() as f64 / n.class.len() as f64;
            scores.first = scores.first.and(first.filter(|n| !n.class.is_empty()).map_or(0.0, share));
            scores.class = scores.class.and(yes(first.is_some_and(hit)));
        }
        for named in &answer.named {
            let of = if sure(&named) { &mut scores.firm } else { &mut scores.loose };
            *of = of.and(yes(hit(named)));
        }
        let unknown = answer.gap && answer.unknown;
        scores.unknown = scores.unknown.and(yes(unknown));
        scores.unknown_only = scores.unknown_only.and(yes(unknown && !wrong));
        scores.firm_wrong = scores.firm_wrong.and(yes(wrong));
        scores.seen = scores.seen.and(yes(answer.gap));
        if truth.causes.len() > 1 {
            let named = |id: &str| answer.named.iter().flat_map(|n| &n.class).any(|n| mapping.right(id, n));
            scores.all = scores.all.and(yes(truth.causes.iter().all(|t| named(&t.cause.id))));
        }
        let withheld: Vec<&str> = truth.causes.iter().map(|t| t.cause.id.as_str()).collect();
        let said = first.map_or_else(|| format!("({})", answer.verdict), |n| n.class.join(" or "));
        *scores.confusion.entry(withheld.join(" + ")).or_default().entry(said).or_default() += 1;
        if cell == Cell::Controls {
            let of = self.false_names.entry(truth.disturbance).or_default();
            *of = of.and(yes(wrong));
        }
        let evidence = if answer.gap { answer.evidence.or(answer.unexplained).unwrap_or(0.0) } else { 0.0 };
        match cell {
            Cell::Foreign => self.evidence[0].push(evidence),
            Cell::SameLaw | Cell::OtherLaw | Cell::DesignNumber => self.evidence[1].push(evidence),
            _ => {}
        }
        self.unknown = Auroc::of(&self.evidence[0], &self.evidence[1]);
    }

    /// As Markdown: a row a cell, the area under the curve, and false names on controls.
    #[must_use]
    pub fn table(&self) -> String {
        let shown = |share: Share| {
            if share.of == 0 {
                return "-".to_owned();
            }
            let [low, high] = share.interval();
            format!("{:.2} ({low:.2} to {high:.2}) of {}", share.value(), share.of)
        };
        let mut text = String::from(
            "\nBy cell, gaps of at least three floors; 95 % intervals of Wilson:\n\n\
             | cell | cases | right first | class holds it | firm single names right | loose names right | called unknown | unknown, nothing \
             wrong for sure | firm and wrong | all of several |\n|---|---|---|---|---|---|---|---|---|---|\n",
        );
        for (cell, s) in &self.cells {
            let _ = writeln!(
                text,
                "| {} | {} | {} | {} | {} | {} | {} | {} | {} | {} |",
                cell.name(),
                s.cases,
                shown(s.first),
                shown(s.class),
                shown(s.firm),
                shown(s.loose),
                shown(s.unknown),
                shown(s.unknown_only),
                shown(s.firm_wrong),
                shown(s.all)
            );
        }
        if let Some(Auroc { value, interval: [low, high], of: [foreign, known] }) = self.unknown {
            let _ = writeln!(
                text,
                "\nEvidence for \"unknown\" tells {foreign} foreign from {known} known cases with an AUROC of {value:.3} ({low:.2} to {high:.2})."
            );
        }
        let of = |d: &Disturbance| serde_json::to_value(d).ok().and_then(|v| v.as_str().map(str::to_owned));
        let named: Vec<String> = self
            .false_names
            .iter()
            .map(|(disturbance, share)| format!("{}: {}", of(disturbance).unwrap_or_default(), shown(*share)))
            .collect();
        if !named.is_empty() {
            let _ = writeln!(text, "\nFirm names on controls, by what disturbs them: {}.", named.join("; "));
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_area_is_the_chance_that_a_foreign_case_gets_more() {
        let area = |a: &[f64], b: &[f64]| Auroc::of(a, b).unwrap();
        assert_eq!(area(&[0.9, 0.8], &[0.1, 0.2, 0.3]).value, 1.0);
        assert_eq!(area(&[0.5, 0.5], &[0.5]).value, 0.5);
        // Two of six pairs are lost.
        let found = area(&[0.9, 0.15], &[0.1, 0.2, 0.3]);
        assert!((found.value - 4.0 / 6.0).abs() < 1e-12 && found.of == [2, 3]);
        assert!(found.interval[0] < found.value && found.interval[1] > found.value);
        // Hanley and McNeil 1982, table II: an area of 0.893 of 51 and 58 has a standard error of 0.032.
        let auroc: f64 = 0.893;
        let (q1, q2) = (auroc / (2.0 - auroc), 2.0 * auroc * auroc / (1.0 + auroc));
        let variance = (auroc * (1.0 - auroc) + 50.0 * (q1 - auroc * auroc) + 57.0 * (q2 - auroc * auroc))
            / (51.0 * 58.0);
        assert!((variance.sqrt() - 0.032).abs() < 1e-3, "{}", variance.sqrt());
        assert_eq!(Auroc::of(&[], &[1.0]), None);
    }
}
