//! What an estimator makes of a data set.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use dermis_skin::{Contact, Estimate, Estimator, ForceComponents};
use serde::{Deserialize, Serialize};

use crate::LearnError;
use crate::dataset::{Dataset, SampleId};
use crate::metrics::{Answer, Bin, COUNTED_FROM, FORCE_BINS, MapErrors, MapPart, MapScorer, Scores, Summary};
use crate::target::Maps;

mod requirement;

pub use requirement::{Requirement, Verdict, Verdicts};

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
    /// Errors of maps over the surface, by name: `map.normal`, `map.force`, `map.displacement`.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub maps: BTreeMap<String, MapErrors>,
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
            maps: BTreeMap::new(),
        }
    }

    /// The same with errors of maps.
    pub(crate) fn with_maps(mut self, maps: MapScorer) -> Self {
        self.maps = maps.finish();
        self
    }

    /// Every figure that a [`Requirement`] can name, in SI units: `position_rms`, `position_mean`,
    /// `position_median`, `position_p95`, `position_max`, the same of `position_x` …, `force_normal` …, and
    /// `missed`, `false_contacts`, `unanswered`, `count_right_of_1` … as shares. Of maps `map_normal_rms`, `map_normal_relative`,
    /// `map_normal_total_force` on touched frames, `map_normal_untouched_rms` … on the others, `map_normal_unanswered` of both.
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
        for (name, errors) in &self.maps {
            let name = name.replace('.', "_");
            for (part, what) in [(&errors.touched, ""), (&errors.untouched, "untouched_")] {
                let values =
                    [("rms", part.rms), ("relative", part.relative), ("total_force", part.total_force)];
                let known = values.into_iter().filter_map(|(figure, v)| Some((figure, v?)));
                all.extend(known.map(|(figure, v)| (format!("{name}_{what}{figure}"), v)));
            }
            let unanswered = errors.touched.unanswered + errors.untouched.unanswered;
            let asked = errors.touched.frames + errors.untouched.frames + unanswered;
            all.insert(format!("{name}_unanswered"), unanswered as f64 / asked.max(1) as f64);
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

/// Errors of maps, for people: micrometres and millinewtons a point, newtons in all.
fn write_maps(f: &mut fmt::Formatter<'_>, maps: &BTreeMap<String, MapErrors>) -> fmt::Result {
    if maps.is_empty() {
        return Ok(());
    }
    writeln!(
        f,
        "  {:<28}{:>4}{:>12}{:>14}{:>16}{:>9}{:>12}",
        "maps, over all points", "", "RMS", "of the truth", "total force [N]", "frames", "unanswered"
    )?;
    let or_dash = |value: Option<String>| value.unwrap_or_else(|| "-".into());
    for (name, errors) in maps {
        let (unit, factor) = if errors.unit == "m" { ("µm", 1e6) } else { ("mN", 1e3) };
        for (what, part) in [("touched", &errors.touched), ("untouched", &errors.untouched)] {
            let MapPart { frames, unanswered, rms, relative, total_force } = part;
            if frames + unanswered == 0 {
                continue;
            }
            writeln!(
                f,
                "  {:<28}{unit:>4}{:>12}{:>14}{:>16}{frames:>9}{unanswered:>12}",
                format!("{name} {what}"),
                or_dash(rms.map(|v| format!("{:.3}", v * factor))),
                or_dash(relative.map(|v| format!("{:.1} %", v * 100.0))),
                or_dash(total_force.map(|v| format!("{v:.3}"))),
            )?;
        }
    }
    Ok(())
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
        write_maps(f, &self.maps)?;
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
#[derive(Default)]
pub struct Evaluator {
    answers: Vec<(usize, crate::Truth, Vec<Contact>)>,
    maps: Option<MapScorer>,
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

    /// Compares maps over the surface with these, too.
    #[must_use]
    pub fn with_maps(mut self, maps: Maps) -> Self {
        self.maps = Some(MapScorer::new(maps));
        self
    }

    /// Takes the maps of one estimate, besides what [`push`](Self::push) takes of it; none count as unanswered.
    ///
    /// # Errors
    ///
    /// [`LearnError::Training`] where the forward model fails on the true map.
    pub fn push_maps(&mut self, truth: &crate::Truth, estimate: &Estimate) -> Result<(), LearnError> {
        self.maps.as_mut().map_or(Ok(()), |maps| maps.push_estimate(truth, estimate))
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
        match self.maps {
            Some(maps) => evaluation.with_maps(maps),
            None => evaluation,
        }
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
    evaluate_by(Evaluator::new().by_force(&FORCE_BINS), estimator, data, only, name)
}

/// As [`evaluate`], with errors by force in other bins ([`Evaluator::by_force`]) or with errors of maps
/// ([`Evaluator::with_maps`]).
///
/// # Errors
///
/// As [`evaluate`], and where the forward model fails on a true map.
pub fn evaluate_by(
    mut evaluator: Evaluator,
    estimator: &mut dyn Estimator,
    data: &Dataset,
    only: Option<&[SampleId]>,
    name: impl Into<String>,
) -> Result<Evaluation, LearnError> {
    let only: Option<BTreeSet<SampleId>> = only.map(|ids| ids.iter().copied().collect());
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
                evaluator.push_maps(truth, &estimate)?;
            } else if truth.touched() {
                evaluator.unanswered();
                evaluator.push_maps(truth, &Estimate::default())?;
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

#[cfg(test)]
mod tests;
