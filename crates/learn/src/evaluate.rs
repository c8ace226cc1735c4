//! What an estimator makes of a data set.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use dermis_skin::{Contact, Estimate, Estimator, ForceComponents};
use serde::{Deserialize, Serialize};

use crate::LearnError;
use crate::dataset::{Dataset, SampleId};
use crate::metrics::{Answer, Bin, COUNTED_FROM, FORCE_BINS, Scores, Summary};

/// Errors of an estimator on labelled frames.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Evaluation {
    /// What was evaluated on.
    pub data: String,
    /// Frames that were compared.
    pub frames: usize,
    /// Touched frames for which the estimator had no answer, e.g. because its zero was not known yet.
    pub unanswered: usize,
    /// How often the zero was taken anew because the ground truth said that nothing touches.
    #[serde(default)]
    pub tares: usize,
    /// Share of touched frames that were taken for untouched.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub missed: Option<f64>,
    /// Share of untouched frames that were taken for touched.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub false_contacts: Option<f64>,
    /// Share of frames whose number of contacts was right, by true number; where every contact presses clearly.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub count_right: BTreeMap<usize, f64>,
    /// Errors by quantity.
    pub quantities: BTreeMap<String, Summary>,
    /// Errors by quantity and true normal force.
    pub by_force: BTreeMap<String, Vec<Bin>>,
}

impl Evaluation {
    /// Sums up scores; errors by force in the bins [`FORCE_BINS`].
    #[must_use]
    pub fn of(
        scores: &Scores,
        data: impl Into<String>,
        frames: usize,
        unanswered: usize,
        tares: usize,
    ) -> Self {
        Self {
            data: data.into(),
            frames,
            unanswered,
            tares,
            missed: scores.missed(),
            false_contacts: scores.false_contacts(),
            count_right: scores.count_right(),
            quantities: scores.summaries(1),
            by_force: scores.by_force(&FORCE_BINS),
        }
    }

    /// Every figure that a [`Requirement`] can name, in SI units: `position_rms`, `position_mean`,
    /// `position_median`, `position_p95`, `position_max`, the same of `position_x` …, `force_normal` …, and
    /// `missed`, `false_contacts`, `unanswered`, `count_right_of_1` … as shares.
    #[must_use]
    pub fn figures(&self) -> BTreeMap<String, f64> {
        let mut all = BTreeMap::new();
        for (name, s) in &self.quantities {
            let name = name.replace(['.', ' '], "_");
            for (suffix, value) in
                [("rms", s.rms), ("mean", s.mean), ("median", s.median), ("p95", s.p95), ("max", s.max)]
            {
                all.insert(format!("{name}_{suffix}"), value);
            }
        }
        let shares = [("missed", self.missed), ("false_contacts", self.false_contacts)];
        all.extend(shares.into_iter().filter_map(|(name, v)| Some((name.to_owned(), v?))));
        for (number, share) in &self.count_right {
            all.insert(format!("count_right_of_{number}"), *share);
        }
        let asked = self.frames + self.unanswered;
        if asked > 0 {
            all.insert("unanswered".into(), self.unanswered as f64 / asked as f64);
        }
        all
    }

    /// As one line of JSON.
    #[must_use]
    pub fn to_json(&self) -> serde_json::Value {
        serde_json::to_value(self).unwrap_or_default()
    }
}

/// Millimetres and newtons: for people.
fn shown(unit: &str, value: f64) -> String {
    if unit == "m" { format!("{:.3}", value * 1e3) } else { format!("{value:.3}") }
}

impl fmt::Display for Evaluation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {} frames", self.data, self.frames)?;
        if self.unanswered > 0 {
            write!(f, ", {} touched ones without an answer", self.unanswered)?;
        }
        if self.tares > 0 {
            write!(f, ", zero taken {} times", self.tares)?;
        }
        writeln!(f)?;
        writeln!(
            f,
            "  {:<24}{:>4}{:>9}{:>20}{:>9}{:>9}{:>9}{:>9}",
            "", "", "RMS", "95 % interval", "mean", "median", "p95", "frames"
        )?;
        for (name, s) in &self.quantities {
            let unit = if s.unit == "m" { "mm" } else { s.unit.as_str() };
            let interval = s.rms_interval.map_or_else(String::new, |[low, high]| {
                format!("{} .. {}", shown(&s.unit, low), shown(&s.unit, high))
            });
            writeln!(
                f,
                "  {name:<24}{unit:>4}{:>9}{interval:>20}{:>9}{:>9}{:>9}{:>9}",
                shown(&s.unit, s.rms),
                shown(&s.unit, s.mean),
                shown(&s.unit, s.median),
                shown(&s.unit, s.p95),
                s.samples
            )?;
        }
        if let Some(s) = self.quantities.values().find(|s| s.rms_interval.is_some()) {
            let what = if s.grouped_by == "press" { "presses" } else { "locations" };
            writeln!(f, "  intervals: whole {what} resampled ({})", s.groups)?;
        }
        for (name, bins) in &self.by_force {
            if bins.len() < 2 || (name != "position" && name != "force.normal") {
                continue;
            }
            let (unit, shown_unit) = if name == "position" { ("m", "mm") } else { ("N", "N") };
            write!(f, "  {name} RMS [{shown_unit}] by force [N]:")?;
            for bin in bins {
                match bin.to {
                    Some(to) => write!(f, "  {}-{to}: {}", bin.from, shown(unit, bin.rms))?,
                    None => write!(f, "  {}+: {}", bin.from, shown(unit, bin.rms))?,
                }
            }
            writeln!(f)?;
        }
        if let Some(missed) = self.missed {
            write!(f, "  missed contacts {:.2} %", missed * 100.0)?;
            if let Some(wrong) = self.false_contacts {
                write!(f, ", false contacts {:.2} %", wrong * 100.0)?;
            }
            writeln!(f)?;
        }
        if self.count_right.keys().any(|number| *number > 1) {
            write!(f, "  right number of contacts (each of {COUNTED_FROM} N or more):")?;
            for (number, share) in &self.count_right {
                write!(f, "  {number}: {:.1} %", share * 100.0)?;
            }
            writeln!(f)?;
        }
        Ok(())
    }
}

/// Compares estimates with the truth one by one, for callers that get their estimates elsewhere, e.g. from a bus.
#[derive(Debug, Default)]
pub struct Evaluator {
    answers: Vec<(usize, crate::Truth, Vec<Contact>)>,
    edges: Option<Vec<f64>>,
    unanswered: usize,
    tares: usize,
}

impl Evaluator {
    /// Nothing yet.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Reports errors by force in these bins in place of [`FORCE_BINS`]; `edges` \[N\] ascend, the last bin is open.
    #[must_use]
    pub fn by_force(mut self, edges: &[f64]) -> Self {
        self.edges = Some(edges.to_vec());
        self
    }

    /// Takes one estimate. Where one contact is true, of several found the one with the largest normal force counts, then
    /// that of the largest confidence; where several are true, each is compared with the one that is found for it. `run`
    /// tells presses of different runs apart.
    pub fn push(&mut self, run: usize, truth: &crate::Truth, estimate: &Estimate) {
        self.answers.push((run, truth.clone(), estimate.contacts.clone()));
    }

    /// Counts a frame for which there is no answer.
    pub fn unanswered(&mut self) {
        self.unanswered += 1;
    }

    /// Counts a zero that was taken anew.
    pub fn tared(&mut self) {
        self.tares += 1;
    }

    /// Sums up.
    #[must_use]
    pub fn finish(self, data: impl Into<String>) -> Evaluation {
        // What the model gives shows in its contacts; only then does "no contact" mean "no force".
        let gives = |components: &[ForceComponents]| {
            self.answers
                .iter()
                .any(|(_, _, found)| found.iter().any(|c| components.contains(&c.force_components)))
        };
        let full = gives(&[ForceComponents::Full]);
        let normal = full || gives(&[ForceComponents::Normal]);
        // On a curved skin the height says where a contact is, too.
        let places =
            || self.answers.iter().flat_map(|(_, truth, _)| truth.contacts.iter().map(|c| c.position.z));
        let (low, high) = places().fold((f64::INFINITY, -f64::INFINITY), |(l, h), z| (l.min(z), h.max(z)));
        let curved = high - low > 1e-6;
        let strength = |c: &Contact| {
            let force = c.normal_force();
            (if force.is_nan() { 0.0 } else { force }, c.confidence)
        };
        let mut scores = Scores::new();
        for (run, truth, found) in &self.answers {
            scores.push_contacts(*run, truth, found);
            let contact = found.iter().max_by(|a, b| {
                let ((fa, ca), (fb, cb)) = (strength(a), strength(b));
                fa.total_cmp(&fb).then(ca.total_cmp(&cb))
            });
            let mut answer = Answer { contact: Some(contact.is_some()), depth: curved, ..Answer::default() };
            if let Some(c) = contact {
                let p = c.position;
                answer.position = (p.x.is_finite() && p.y.is_finite()).then_some([p.x, p.y, p.z]);
                if c.force_components != ForceComponents::None {
                    answer.normal_force = Some(c.normal_force()).filter(|f| f.is_finite());
                }
                answer.force = (c.force_components == ForceComponents::Full)
                    .then_some([c.force.x, c.force.y, c.force.z]);
            } else {
                answer.normal_force = normal.then_some(0.0);
                answer.force = full.then_some([0.0; 3]);
            }
            scores.push(*run, truth, &answer);
        }
        let mut evaluation = Evaluation::of(&scores, data, self.answers.len(), self.unanswered, self.tares);
        if let Some(edges) = &self.edges {
            evaluation.by_force = scores.by_force(edges);
        }
        evaluation
    }
}

/// Feeds every frame of a data set to an estimator, in order and as the device gave them, and compares what comes
/// out with the truth; on `only` (e.g. the held-out part of a split), or on all labelled frames. The estimator is
/// reset before each run, and told to take its zero anew where the data set says so ([`Sample::tare`]). Touched
/// frames before the first zero count as unanswered.
///
/// [`Sample::tare`]: crate::Sample::tare
///
/// # Errors
///
/// [`LearnError::Estimate`] names the bag and frame that the estimator refused.
pub fn evaluate(
    estimator: &mut dyn Estimator,
    data: &Dataset,
    only: Option<&[SampleId]>,
    name: impl Into<String>,
) -> Result<Evaluation, LearnError> {
    evaluate_by(estimator, data, only, &FORCE_BINS, name)
}

/// As [`evaluate`], with errors by force in other bins: `edges` \[N\] ascend, the last bin is open.
///
/// # Errors
///
/// As [`evaluate`].
pub fn evaluate_by(
    estimator: &mut dyn Estimator,
    data: &Dataset,
    only: Option<&[SampleId]>,
    edges: &[f64],
    name: impl Into<String>,
) -> Result<Evaluation, LearnError> {
    let only: Option<BTreeSet<SampleId>> = only.map(|ids| ids.iter().copied().collect());
    let mut evaluator = Evaluator::new().by_force(edges);
    for (run, r) in data.runs().iter().enumerate() {
        estimator.reset();
        for (sample, s) in data.stream_images(run, None)?.enumerate() {
            let s = s?;
            if s.tare {
                estimator.tare();
                evaluator.tared();
            }
            let estimate = estimator
                .estimate(&s.frame)
                .map_err(|source| LearnError::Estimate { bag: r.path.clone(), source })?;
            let Some(truth) = &s.truth else { continue };
            if only.as_ref().is_some_and(|ids| !ids.contains(&SampleId { run, sample })) {
                continue;
            }
            if !s.tared.iter().all(|v| v.is_nan()) {
                evaluator.push(run, truth, &estimate);
            } else if truth.touched() {
                evaluator.unanswered();
            }
        }
    }
    Ok(evaluator.finish(name))
}

/// As [`evaluate`], on several parts of a data set at once, each by itself, for estimators that take their time: touched frames of
/// presses that no part asks for are left out. `watch` is told how far it is, from 0 to 1, and says whether it goes on; `None`
/// where it does not.
///
/// # Errors
///
/// As [`evaluate`].
pub fn evaluate_parts(
    estimator: &mut dyn Estimator,
    data: &Dataset,
    parts: &[(&str, &[SampleId])],
    watch: &dyn Fn(f64) -> bool,
) -> Result<Option<Vec<Evaluation>>, LearnError> {
    let asked: Vec<BTreeSet<SampleId>> = parts.iter().map(|(_, ids)| ids.iter().copied().collect()).collect();
    let press = |id: &SampleId| Some((id.run, data.sample(*id)?.truth.as_ref()?.press));
    let presses: BTreeSet<(usize, u64)> = asked.iter().flatten().filter_map(press).collect();
    let mut evaluators: Vec<Evaluator> =
        parts.iter().map(|_| Evaluator::new().by_force(&FORCE_BINS)).collect();
    let total = data.runs().iter().map(|r| r.samples.len()).sum::<usize>().max(1) as f64;
    let mut done = 0u32;
    for (run, r) in data.runs().iter().enumerate() {
        estimator.reset();
        for (sample, s) in data.stream_images(run, None)?.enumerate() {
            let s = s?;
            if !watch(f64::from(done) / total) {
                return Ok(None);
            }
            done += 1;
            if s.tare {
                estimator.tare();
                evaluators.iter_mut().for_each(Evaluator::tared);
            }
            let elsewhere = |t: &crate::Truth| t.touched() && !presses.contains(&(run, t.press));
            if s.truth.as_ref().is_some_and(elsewhere) {
                continue;
            }
            let estimate = estimator
                .estimate(&s.frame)
                .map_err(|source| LearnError::Estimate { bag: r.path.clone(), source })?;
            let Some(truth) = &s.truth else { continue };
            for (ids, evaluator) in asked.iter().zip(&mut evaluators) {
                if !ids.contains(&SampleId { run, sample }) {
                    continue;
                }
                if !s.tared.iter().all(|v| v.is_nan()) {
                    evaluator.push(run, truth, &estimate);
                } else if truth.touched() {
                    evaluator.unanswered();
                }
            }
        }
    }
    Ok(Some(evaluators.into_iter().zip(parts).map(|(e, (name, _))| e.finish(*name)).collect()))
}

/// A figure that an evaluation has to reach, e.g. `position_rms<=0.0005` (SI units).
#[derive(Debug, Clone, PartialEq)]
pub struct Requirement {
    figure: String,
    at_least: bool,
    bound: f64,
}

/// What an evaluation says to a requirement.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Verdict {
    /// The requirement.
    pub requirement: String,
    /// The measured figure; absent where the evaluation has none of this name, which counts as failed.
    pub value: Option<f64>,
    /// Whether it is met.
    pub met: bool,
}

/// What an evaluation says to all requirements.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Verdicts(Vec<Verdict>);

impl Verdicts {
    /// Holds every requirement against an evaluation.
    #[must_use]
    pub fn of(requirements: &[Requirement], evaluation: &Evaluation) -> Self {
        Self(requirements.iter().map(|r| r.check(evaluation)).collect())
    }

    /// Whether all are met.
    ///
    /// # Errors
    ///
    /// [`LearnError::Missed`] counts those that are not.
    pub fn require(&self) -> Result<(), LearnError> {
        match self.0.iter().filter(|v| !v.met).count() {
            0 => Ok(()),
            missed => Err(LearnError::Missed { missed, of: self.0.len() }),
        }
    }
}

impl fmt::Display for Verdicts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|verdict| writeln!(f, "{verdict}"))
    }
}

impl std::str::FromStr for Requirement {
    type Err = LearnError;

    fn from_str(text: &str) -> Result<Self, LearnError> {
        let wrong = |reason: String| LearnError::Requirement { text: text.to_owned(), reason };
        let (figure, at_least, bound) = if let Some((figure, bound)) = text.split_once("<=") {
            (figure, false, bound)
        } else if let Some((figure, bound)) = text.split_once(">=") {
            (figure, true, bound)
        } else {
            return Err(wrong("needs `<=` or `>=`, as in `position_rms<=0.0005`".into()));
        };
        let bound = bound.trim();
        let bound: f64 =
            bound.parse().map_err(|_| wrong(format!("`{bound}` is not a number in SI units")))?;
        if !bound.is_finite() || figure.trim().is_empty() {
            return Err(wrong("needs the name of a figure and a finite number".into()));
        }
        Ok(Self { figure: figure.trim().to_owned(), at_least, bound })
    }
}

impl fmt::Display for Requirement {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}{}{}", self.figure, if self.at_least { ">=" } else { "<=" }, self.bound)
    }
}

impl Requirement {
    /// Holds it against an evaluation.
    #[must_use]
    pub fn check(&self, evaluation: &Evaluation) -> Verdict {
        let value = evaluation.figures().get(&self.figure).copied();
        let met = value.is_some_and(|v| if self.at_least { v >= self.bound } else { v <= self.bound });
        Verdict { requirement: self.to_string(), value, met }
    }
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mark = if self.met { "met" } else { "MISSED" };
        match self.value {
            Some(value) => write!(f, "{mark}: {} (measured {value:.6})", self.requirement),
            None => write!(f, "{mark}: {} (no such figure here)", self.requirement),
        }
    }
}

#[cfg(test)]
mod tests {
    use dermis_skin::{EstimateError, Frame};
    use nalgebra::{Point3, Vector3};

    use super::*;
    use crate::dataset::tests::presses;

    /// Reads position and force off the two channels of the made-up skin, whose zero is 1000; 0.5 mm off in x.
    struct Known;

    impl Estimator for Known {
        fn estimate(&mut self, frame: &Frame) -> Result<Estimate, EstimateError> {
            let [x, force] = [frame.values[0] - 1000.0, frame.values[1] - 1000.0].map(f64::from);
            let mut estimate = Estimate::default();
            if force > 1.0 {
                let mut contact = Contact::at(Point3::new(x * 1e-4 + 0.0005, 0.0, 0.0), Vector3::z());
                contact.force = Vector3::new(0.0, 0.0, -force / 20.0 * 1.1);
                contact.force_components = ForceComponents::Normal;
                estimate.contacts.push(contact);
            }
            Ok(estimate)
        }

        fn reset(&mut self) {}
    }

    #[test]
    fn people_read_a_table() {
        let data = presses(10, 2);
        let result = evaluate(&mut Known, &data, None, "made-up presses").unwrap();
        insta::assert_snapshot!(result, @r"
        made-up presses: 180 frames, zero taken 20 times
                                            RMS       95 % interval     mean   median      p95   frames
          force.normal               N    0.332      0.243 .. 0.409    0.300    0.300    0.500       40
          force.normal untouched     N    0.000      0.000 .. 0.000    0.000    0.000    0.000      140
          position                  mm    0.500      0.500 .. 0.500    0.500    0.500    0.500       40
          position.x                mm    0.500      0.500 .. 0.500    0.500    0.500    0.500       40
          position.y                mm    0.000      0.000 .. 0.000    0.000    0.000    0.000       40
          intervals: whole locations resampled (10)
          force.normal RMS [N] by force [N]:  1-2: 0.100  2-5: 0.311  5-10: 0.500
          position RMS [mm] by force [N]:  1-2: 0.500  2-5: 0.500  5-10: 0.500
          missed contacts 0.00 %, false contacts 0.00 %
        ");
        let figures = result.figures();
        approx::assert_relative_eq!(figures["position_rms"], 0.0005, max_relative = 1e-3);
        let again: Evaluation = serde_json::from_value(result.to_json()).unwrap();
        assert_eq!(again.frames, result.frames);
        let verdict = |text: &str| text.parse::<Requirement>().unwrap().check(&result);
        assert!(verdict("position_rms <= 0.00051").met && verdict("missed<=0").met);
        insta::assert_snapshot!(verdict("position_rms<=0.0004"), @"MISSED: position_rms<=0.0004 (measured 0.000500)");
        insta::assert_snapshot!(verdict("force_x_rms<=1"), @"MISSED: force_x_rms<=1 (no such figure here)");
    }

    #[test]
    fn only_the_asked_samples_count() {
        let data = presses(10, 2);
        let held_out = crate::SplitConfig::default().apply(&data).unwrap().test;
        let result = evaluate(&mut Known, &data, Some(&held_out), "held out").unwrap();
        let read = data.gather(&held_out).unwrap();
        let has_zero = read.iter().filter(|(_, sample)| sample.tared[0].is_finite()).count();
        assert_eq!((result.frames, result.unanswered), (has_zero, 0));
        assert!(result.frames < data.labelled().count());
    }

    #[test]
    fn parts_are_evaluated_by_themselves_and_without_what_nobody_asks_for() {
        let data = presses(10, 2);
        let held_out = crate::SplitConfig::default().apply(&data).unwrap().test;
        let (one, two) = held_out.split_at(held_out.len() / 2);
        let parts = [("one", one), ("two", two)];
        let both = evaluate_parts(&mut Known, &data, &parts, &|_| true).unwrap().unwrap();
        for ((name, ids), found) in parts.iter().zip(&both) {
            assert_eq!(found, &evaluate(&mut Known, &data, Some(ids), *name).unwrap());
        }
        // It counts what it is asked.
        struct Counted(usize);
        impl Estimator for Counted {
            fn estimate(&mut self, frame: &Frame) -> Result<Estimate, EstimateError> {
                self.0 += 1;
                Known.estimate(frame)
            }
            fn reset(&mut self) {}
        }
        let mut counted = Counted(0);
        evaluate_parts(&mut counted, &data, &parts, &|_| true).unwrap();
        let all: usize = data.runs().iter().map(|r| r.samples.len()).sum();
        assert!(counted.0 < all && counted.0 >= held_out.len(), "{} of {all}", counted.0);
        assert_eq!(evaluate_parts(&mut Known, &data, &parts, &|share| share < 0.5).unwrap(), None);
    }

    #[test]
    fn requirements_are_read_strictly() {
        let told = |text: &str| text.parse::<Requirement>().unwrap_err().to_string();
        insta::assert_snapshot!(told("position_rms<0.1"), @"requirement `position_rms<0.1`: needs `<=` or `>=`, as in `position_rms<=0.0005`");
        insta::assert_snapshot!(told("position_rms<=0.5mm"), @"requirement `position_rms<=0.5mm`: `0.5mm` is not a number in SI units");
    }
}
