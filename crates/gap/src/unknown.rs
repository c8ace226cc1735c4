//! How much speaks for a cause that the library lacks, by a table that was calibrated on the library itself.
//!
//! Problem: a wrong name may remove most of a gap. Method: a logistic regression over what names leave ([`Model::evidence`]), fitted to simulated
//! devices whose cause was in the library or left out of it ([`trials`](crate::calibrate::trials)); what comes out is the logarithm of the odds of
//! "unknown" where both are equally frequent. Two thresholds are quantiles of devices whose cause was in the library, by
//! cross-validation: a name is firm below the first, and the cause is called unknown above the second (split conformal; Vovk, Gammerman and
//! Shafer 2005). Assumptions: a recording is like the simulated ones. Cost: none to speak of.

use std::collections::BTreeMap;
use std::sync::LazyLock;

use serde::{Deserialize, Serialize};

use crate::algebra::cholesky_solve;
use crate::calibrate::Trial;
use crate::constants::calibrate::{FIRM, FOLDS, KNOWN, RIDGE, ROUNDS, SMALL};

/// The table that reports are judged by.
pub(crate) static MODEL: LazyLock<Model> =
    LazyLock::new(|| toml::from_str(include_str!("../unknown.toml")).unwrap_or_default());

/// One thing that is measured: how it enters.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Term {
    /// Mean over all trials.
    pub mean: f64,
    /// Standard deviation over all trials.
    pub spread: f64,
    /// Weight of a standard deviation.
    pub weight: f64,
}

/// What was calibrated on.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Source {
    /// Skin.
    pub skin: String,
    /// Command that made the trials.
    pub command: String,
    /// Devices whose cause was in the library.
    pub known: usize,
    /// Devices whose cause was not.
    pub unknown: usize,
}

/// A calibrated table.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Model {
    /// `gap-unknown/1`.
    pub schema: String,
    /// Evidence below which a name may be firm.
    pub firm: f64,
    /// Evidence above which the cause is called unknown.
    pub unknown: f64,
    /// Evidence where nothing speaks for either.
    pub intercept: f64,
    /// AUROC of the trials by cross-validation.
    pub auroc: f64,
    /// What it was calibrated on.
    pub sources: Vec<Source>,
    /// Terms by name.
    pub terms: BTreeMap<String, Term>,
}

/// What enters, from what was measured.
fn features(tests: &BTreeMap<String, f64>) -> BTreeMap<String, f64> {
    let of = |name: &str| tests.get(name).copied().unwrap_or(0.0);
    // From a hundredth of the gap on what counts is by which factor more it is.
    let share = |value: f64| (value.max(0.0) / SMALL).ln_1p();
    let mut found = BTreeMap::new();
    for name in ["left", "first-order"] {
        found.insert(name.to_owned(), share(of(name)));
    }
    for (name, value) in tests.iter().filter(|(name, _)| name.starts_with("beyond-")) {
        found.insert(name.clone(), share(*value));
    }
    let place = of("beyond-field").max(of("beyond-place"));
    found.insert("channels-and-place".to_owned(), of("per-channel") * share(place));
    found.insert("excess".to_owned(), of("excess").clamp(-1.0, 1.0));
    for name in ["implausible", "size", "noise"] {
        found.insert(name.to_owned(), of(name));
    }
    found.insert("several".to_owned(), (of("names") - 1.0).clamp(0.0, 1.0));
    found.insert("unnamed".to_owned(), f64::from(u8::from(of("names") == 0.0)));
    found
}

impl Model {
    /// Logarithm of the odds of "unknown"; `None` without a calibration.
    #[must_use]
    pub fn evidence(&self, tests: &BTreeMap<String, f64>) -> Option<f64> {
        if self.terms.is_empty() || tests.is_empty() {
            return None;
        }
        let features = features(tests);
        let term = |(name, t): (&String, &Term)| {
            let value = features.get(name).copied().unwrap_or(0.0);
            t.weight * (value - t.mean) / t.spread.max(1e-9)
        };
        Some(self.intercept + self.terms.iter().map(term).sum::<f64>())
    }

    /// Fits a table to trials; both kinds count alike, however many there are of each. `None` where one kind is missing.
    #[must_use]
    pub fn fit(trials: &[Trial], sources: Vec<Source>) -> Option<Self> {
        let rows: Vec<BTreeMap<String, f64>> = trials.iter().map(|t| features(&t.tests)).collect();
        let unknown: Vec<bool> = trials.iter().map(|t| t.kind.unknown()).collect();
        let all: Vec<usize> = (0..trials.len()).collect();
        let mut made = logistic(&rows, &unknown, &all)?;
        // Devices of a fold are scored by the others. A device and what is left out of the library for it stand side by side.
        let mut scores = vec![0.0; trials.len()];
        for fold in 0..FOLDS {
            let own = |i: &usize| (i / 8) % FOLDS == fold;
            let others: Vec<usize> = all.iter().copied().filter(|i| !own(i)).collect();
            let Some(other) = logistic(&rows, &unknown, &others) else { continue };
            for i in all.iter().filter(|i| own(i)) {
                scores[*i] = other.evidence(&trials[*i].tests)?;
            }
        }
        let of = |kind: bool| -> Vec<f64> {
            let mut values: Vec<f64> =
                scores.iter().zip(&unknown).filter(|(_, u)| **u == kind).map(|(s, _)| *s).collect();
            values.sort_by(f64::total_cmp);
            values
        };
        let (known, foreign) = (of(false), of(true));
        // The quantile with one more device, as split conformal prediction has it.
        let quantile = |share: f64| {
            let at = (share * (known.len() + 1) as f64).ceil() as usize;
            known[at.clamp(1, known.len()) - 1]
        };
        (made.firm, made.unknown) = (quantile(FIRM), quantile(KNOWN));
        let won: f64 = foreign
            .iter()
            .map(|f| {
                known.iter().map(|k| if f > k { 1.0 } else { 0.5 * f64::from(u8::from(f == k)) }).sum::<f64>()
            })
            .sum();
        made.auroc = won / (known.len() * foreign.len()) as f64;
        made.schema = "gap-unknown/1".to_owned();
        made.sources = sources;
        Some(made)
    }
}

/// Logistic regression with a ridge, by Newton's method.
fn logistic(rows: &[BTreeMap<String, f64>], unknown: &[bool], of: &[usize]) -> Option<Model> {
    let count = |kind: bool| of.iter().filter(|i| unknown[**i] == kind).count();
    if count(true) == 0 || count(false) == 0 {
        return None;
    }
    let names: Vec<String> = rows.first()?.keys().cloned().collect();
    let value = |i: usize, name: &String| rows[i].get(name).copied().unwrap_or(0.0);
    let terms: Vec<Term> = names
        .iter()
        .map(|name| {
            let mean = of.iter().map(|i| value(*i, name)).sum::<f64>() / of.len() as f64;
            let square = of.iter().map(|i| (value(*i, name) - mean).powi(2)).sum::<f64>() / of.len() as f64;
            Term { mean, spread: square.sqrt().max(1e-6), weight: 0.0 }
        })
        .collect();
    let n = names.len() + 1;
    let row = |i: usize| -> Vec<f64> {
        let scaled = names.iter().zip(&terms).map(|(name, t)| (value(i, name) - t.mean) / t.spread);
        scaled.chain([1.0]).collect()
    };
    let weight = [true, false].map(|kind| 0.5 * of.len() as f64 / count(kind) as f64);
    let mut x = vec![0.0; n];
    for _ in 0..ROUNDS {
        let mut a = vec![0.0; n * n];
        let mut b = vec![0.0; n];
        for &i in of {
            let z = row(i);
            let p = 1.0 / (1.0 + (-z.iter().zip(&x).map(|(z, x)| z * x).sum::<f64>()).exp());
            let w = if unknown[i] { weight[0] } else { weight[1] };
            let off = f64::from(u8::from(unknown[i])) - p;
            for r in 0..n {
                b[r] += w * off * z[r];
                (0..n).for_each(|c| a[r * n + c] += w * p * (1.0 - p) * z[r] * z[c]);
            }
        }
        for r in 0..n {
            let ridge = if r + 1 == n { 1e-6 } else { RIDGE };
            a[r * n + r] += ridge;
            b[r] -= ridge * x[r];
        }
        cholesky_solve(&mut a, n, &mut b)?;
        x.iter_mut().zip(&b).for_each(|(x, d)| *x += d);
    }
    let terms = terms.into_iter().zip(&x).map(|(t, w)| Term { weight: *w, ..t });
    Some(Model { intercept: x[n - 1], terms: names.into_iter().zip(terms).collect(), ..Model::default() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::Kind;
    use crate::report::Verdict;

    fn trial(kind: Kind, left: f64, field: f64) -> Trial {
        let tests = [("left", left), ("beyond-field", field), ("names", 1.0), ("per-channel", 1.0)];
        Trial {
            kind,
            causes: Vec::new(),
            named: Vec::new(),
            verdict: Verdict::Named,
            tests: tests.map(|(name, value)| (name.to_owned(), value)).into(),
        }
    }

    #[test]
    fn what_unknown_causes_leave_speaks_for_them() {
        let trials: Vec<Trial> = (0..160)
            .map(|i| {
                let unknown = i % 2 == 1;
                let spread = 0.5 + (f64::from(i) * 0.618).fract();
                let left = if unknown { 0.15 } else { 0.02 } * spread;
                trial(if unknown { Kind::LeftOut } else { Kind::Right }, left, 0.8 * left)
            })
            .collect();
        let model = Model::fit(&trials, Vec::new()).unwrap();
        let evidence =
            |left: f64, field: f64| model.evidence(&trial(Kind::Right, left, field).tests).unwrap();
        assert!(model.auroc > 0.95, "{model:?}");
        assert!(model.firm <= model.unknown);
        assert!(evidence(0.2, 0.15) > model.unknown && evidence(0.01, 0.0) < model.firm);
        assert!(evidence(0.2, 0.15) > evidence(0.05, 0.02));
        // Two in a hundred of those that are known are called unknown, and hardly more.
        let called = trials.iter().filter(|t| !t.kind.unknown());
        let wrong = called.filter(|t| model.evidence(&t.tests).unwrap() > model.unknown).count();
        assert!(wrong <= 3, "{wrong}");
        let text = toml::to_string(&model).unwrap();
        assert_eq!(toml::from_str::<Model>(&text).unwrap().terms.len(), model.terms.len());
    }

    #[test]
    fn nothing_is_said_without_both_kinds() {
        assert_eq!(Model::fit(&[trial(Kind::Right, 0.1, 0.1)], Vec::new()), None);
        assert_eq!(Model::default().evidence(&trial(Kind::Right, 0.1, 0.1).tests), None);
    }

    #[test]
    fn the_shipped_table_is_one() {
        let model: Model = toml::from_str(include_str!("../unknown.toml")).unwrap();
        assert_eq!(model.schema, "gap-unknown/1");
        assert!(model.firm <= model.unknown && !model.terms.is_empty() && !model.sources.is_empty());
    }
}
