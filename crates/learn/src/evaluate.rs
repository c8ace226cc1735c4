//! What an estimator makes of a data set.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use dermis_skin::Estimator;
use serde::{Deserialize, Serialize};

use crate::LearnError;
use crate::bounds::{AgainstBound, FrameBounds};
use crate::dataset::{Dataset, Run, SampleId};
use crate::metrics::{
    Bin, COUNTED_FROM, Consistencies, ContactError, FORCE_BINS, MapErrors, MapScorer, Scores, Summary,
};

mod collect;
mod of_maps;
mod requirement;

pub use collect::Evaluator;
pub(crate) use collect::centre;
pub use requirement::{Requirement, Verdict, Verdicts};

/// Errors of an estimator on labelled frames.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Evaluation {
    /// What was evaluated on.
    pub data: String,
    /// Frames that were compared.
    pub frames: usize,
    /// Touched frames for which the estimator had no answer, e.g. because its zero was not known yet. They are not among `frames`,
    /// but in the errors: as frames in which nothing was found.
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
    /// Share of all true contacts for which nothing was found; they count in the errors as far away as the middle of the surface, and
    /// as a force of 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub not_found: Option<f64>,
    /// Errors by quantity; `… found` are those of contacts that were found, where not all were.
    pub quantities: BTreeMap<String, Summary>,
    /// Errors by quantity and true normal force.
    pub by_force: BTreeMap<String, Vec<Bin>>,
    /// Errors of maps over the surface, by name: `map.normal`, `map.force`, `map.displacement`.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub maps: BTreeMap<String, MapErrors>,
    /// Errors and bounds of the very same contacts, by number of contacts and quantity; empty where no bound is known.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub against_bound: Vec<AgainstBound>,
    /// Errors of positions beside the covariance that the estimator states of each; absent where it states none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub consistency: Option<Consistencies>,
    /// Errors of every true contact, for what is computed of single frames.
    #[serde(skip)]
    pub contacts: Vec<ContactError>,
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
            not_found: share_not_found(scores.contacts()),
            quantities: scores.summaries(1),
            by_force: scores.by_force(&FORCE_BINS),
            maps: BTreeMap::new(),
            against_bound: Vec::new(),
            consistency: Consistencies::of(scores.contacts(), &FORCE_BINS),
            contacts: scores.contacts().to_vec(),
        }
    }

    /// The same beside the bounds of its frames, by force in bins of these edges \[N\].
    #[must_use]
    pub fn against(mut self, bounds: &FrameBounds, edges: &[f64]) -> Self {
        self.against_bound = bounds.against(&self.contacts, edges);
        self
    }

    /// The same with errors of maps.
    pub(crate) fn with_maps(mut self, maps: MapScorer) -> Self {
        self.maps = maps.finish();
        self
    }

    /// Every figure that a [`Requirement`] can name, in SI units: `position_rms`, `position_mean`,
    /// `position_median`, `position_p95`, `position_max`, the same of `position_x` …, `force_normal` …, of what was found
    /// (`position_found_rms`, `force_normal_found_rms` …), and `not_found`, `missed`, `false_contacts`, `unanswered`, `count_right_of_1` … as shares. Of maps `map_normal_rms`, `map_normal_relative`,
    /// `map_normal_total_force` on touched frames, `map_normal_untouched_rms` … on the others, `map_normal_unanswered` of both; `map_normal_fvu_of_3` by number of
    /// contacts; and of contacts that are read off maps of forces from 5 N on, `map_normal_5n_position_mean`,
    /// `map_normal_5n_of_3_position_mean` …: `number_right`, means of `number`, `position`, `position_found`, `position_nearest`,
    /// `force` and `diameter`, and `force_rms`.
    #[must_use]
    pub fn figures(&self) -> BTreeMap<String, f64> {
        let mut all = BTreeMap::new();
        // Where everything was found, both are the same.
        let found = |name: &&str| !self.quantities.contains_key(&format!("{name} found"));
        let also = ["position", "force.normal"].into_iter().filter(found);
        let also = also.filter_map(|name| Some((format!("{name} found"), self.quantities.get(name)?)));
        for (name, s) in self.quantities.iter().map(|(name, s)| (name.clone(), s)).chain(also) {
            let name = name.replace(['.', ' '], "_");
            for (suffix, value) in
                [("rms", s.rms), ("mean", s.mean), ("median", s.median), ("p95", s.p95), ("max", s.max)]
            {
                all.insert(format!("{name}_{suffix}"), value);
            }
        }
        let shares =
            [("missed", self.missed), ("false_contacts", self.false_contacts), ("not_found", self.not_found)];
        all.extend(shares.into_iter().filter_map(|(name, v)| Some((name.to_owned(), v?))));
        for (number, share) in &self.count_right {
            all.insert(format!("count_right_of_{number}"), *share);
        }
        of_maps::figures(&self.maps, &mut all);
        let total = self.frames + self.unanswered;
        if total > 0 {
            all.insert("unanswered".into(), self.unanswered as f64 / total as f64);
        }
        all
    }

    /// As one line of JSON.
    #[must_use]
    pub fn to_json(&self) -> serde_json::Value {
        serde_json::to_value(self).unwrap_or_default()
    }
}

fn share_not_found(contacts: &[ContactError]) -> Option<f64> {
    let lost = contacts.iter().filter(|c| !c.found).count();
    (!contacts.is_empty()).then(|| lost as f64 / contacts.len() as f64)
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
        if self.quantities.is_empty() && self.maps.is_empty() {
            writeln!(
                f,
                "  nothing could be compared: no quantity that the model gives is known in these frames; `dermis train --check` says \
                 what a bag knows"
            )?;
        }
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
            let shown_names = ["position", "position found", "force.normal", "force.normal found"];
            if bins.len() < 2 || !shown_names.contains(&name.as_str()) {
                continue;
            }
            let (unit, shown_unit) = if name.starts_with("position") { ("m", "mm") } else { ("N", "N") };
            write!(f, "  {name} RMS [{shown_unit}] by force [N]:")?;
            for bin in bins {
                match bin.to {
                    Some(to) => write!(f, "  {}-{to}: {}", bin.from, shown(unit, bin.rms))?,
                    None => write!(f, "  {}+: {}", bin.from, shown(unit, bin.rms))?,
                }
            }
            writeln!(f)?;
        }
        of_maps::write(f, &self.maps)?;
        if let Some(lost) = self.not_found.filter(|lost| *lost > 0.0) {
            writeln!(
                f,
                "  contacts that were not found, {:.2} %, count as far away as the middle of the surface and as a force of 0; rows \
                 `found` leave them out",
                lost * 100.0
            )?;
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
        self.consistency.iter().try_for_each(|c| write!(f, "{c}"))
    }
}

/// Feeds every frame of a data set to an estimator, in order and as the device gave them, and compares what comes
/// out with the truth; on `only` (e.g. the held-out part of a split), or on all labelled frames. The estimator is
/// reset before each run, and takes its zero anew where the data set says so ([`Sample::tare`]). Touched
/// frames before the first zero count as unanswered: as frames in which nothing was found.
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
    evaluate_by(Evaluator::of(data).by_force(&FORCE_BINS), estimator, data, only, name)
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
    evaluator.run(estimator, data, only)?;
    Ok(evaluator.finish(name))
}

/// As [`evaluate_by`], on several parts of a data set at once, each by an evaluator of its own, for estimators that take their time:
/// touched frames of presses that no part asks for are left out. `watch` receives the progress, from 0 to 1, and says whether it goes
/// on; `None` where it does not.
///
/// # Errors
///
/// As [`evaluate_by`].
pub fn evaluate_parts(
    estimator: &mut dyn Estimator,
    data: &Dataset,
    parts: Vec<(Evaluator, &str, &[SampleId])>,
    watch: &dyn Fn(f64) -> bool,
) -> Result<Option<Vec<Evaluation>>, LearnError> {
    let targets: Vec<BTreeSet<SampleId>> =
        parts.iter().map(|(.., ids)| ids.iter().copied().collect()).collect();
    let press = |id: &SampleId| Some((id.run, data.sample(*id)?.truth.as_ref()?.press));
    let presses: BTreeSet<(usize, u64)> = targets.iter().flatten().filter_map(press).collect();
    let (mut evaluators, names): (Vec<Evaluator>, Vec<&str>) =
        parts.into_iter().map(|(evaluator, name, _)| (evaluator, name)).unzip();
    let total = data.runs().iter().map(Run::frames).sum::<usize>().max(1) as f64;
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
            for (ids, evaluator) in targets.iter().zip(&mut evaluators) {
                let id = SampleId { run, sample };
                if ids.contains(&id) {
                    evaluator.take(id, &s, truth, &estimate)?;
                }
            }
        }
    }
    Ok(Some(evaluators.into_iter().zip(names).map(|(e, name)| e.finish(name)).collect()))
}

#[cfg(test)]
mod tests;
