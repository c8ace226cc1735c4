//! Which frames are compared, and answers held against the truth.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Instant;

use anyhow::Result;
use dermis_estimate::ContactFinder;
use dermis_learn::real2sim::Compliance;
use dermis_learn::{ContactError, Dataset, Evaluation, Evaluator, FrameBounds, SampleId, TruthContact, bins};
use dermis_skin::Estimate;
use serde::Serialize;

use super::{Kind, Request};
use crate::{LeftOut, Progress};

/// Errors of a method on frames of one kind. A contact for which none was found counts in the errors as far away as the middle of the
/// surface, and as a force of 0.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Errors {
    /// Frames that it answered.
    pub frames: usize,
    /// Share of frames with the right number of contacts; absent for a method that always says one.
    pub count_right: Option<f64>,
    /// \[m\] mean distance.
    pub position_mean: f64,
    /// \[m\] root mean square.
    pub position_rms: f64,
    /// \[m\] median.
    pub position_median: f64,
    /// \[N\] mean error of the pressing force.
    pub force_mean: f64,
    /// \[N\] root mean square.
    pub force_rms: f64,
    /// Share of true contacts for which none was found.
    pub lost: f64,
}

impl Errors {
    fn of(contacts: &[&ContactError], right: Option<(usize, usize)>, frames: usize) -> Self {
        // Mean, root mean square and median, of one bin for all forces.
        let of_all = |of: fn(&ContactError) -> f64| -> [f64; 3] {
            let values = contacts.iter().map(|c| of(c)).filter(|v| v.is_finite());
            let bin = bins(&[0.0], values.map(|value| (0.0, value))).pop();
            bin.map_or([f64::NAN; 3], |bin| [bin.mean, bin.rms, bin.median.unwrap_or(f64::NAN)])
        };
        let [position_mean, position_rms, position_median] = of_all(|c| c.position);
        let [force_mean, force_rms, _] = of_all(|c| c.normal_force);
        let lost = contacts.iter().filter(|c| !c.found).count();
        Self {
            frames,
            count_right: right.map(|(right, of)| right as f64 / of.max(1) as f64),
            position_mean,
            position_rms,
            position_median,
            force_mean,
            force_rms,
            lost: lost as f64 / contacts.len().max(1) as f64,
        }
    }
}

/// What a method made of one kind of frames.
#[derive(Debug, Clone, Serialize)]
pub struct Row {
    /// Its name.
    pub method: String,
    /// [`Kind::name`].
    pub kind: &'static str,
    /// Errors on every frame, where `errors` leaves out those of locations that hardly give way.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub with_everything: Option<Errors>,
    /// Errors on what was requested.
    #[serde(flatten)]
    pub errors: Errors,
    /// The same of contacts that were found, where not all were.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub found: Option<Errors>,
    /// \[s\] a frame.
    pub seconds: f64,
    /// Errors by force, and beside their bounds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub evaluation: Option<Evaluation>,
}

/// Touched frames that are compared, by kind; those of locations that give way among them; and what is left out of the latter.
pub(in crate::real2sim) struct Targets {
    pub(in crate::real2sim) all: BTreeMap<Kind, Vec<SampleId>>,
    pub(in crate::real2sim) kept: Option<BTreeSet<SampleId>>,
    pub(in crate::real2sim) left_out: Vec<LeftOut>,
}

impl Targets {
    /// Touched frames of one and two contacts, evenly thinned.
    pub(in crate::real2sim) fn of(
        data: &Dataset,
        options: &Request,
        compliance: &Compliance,
    ) -> Result<Self> {
        let mut all: BTreeMap<Kind, Vec<SampleId>> = BTreeMap::new();
        let mut rigid = BTreeSet::new();
        let (mut touched, mut other, mut light, mut thinned) = (0, 0, 0, 0);
        let heavy = |c: &TruthContact| c.normal_force().is_some_and(|f| f >= options.least);
        for run in 0..data.runs().len() {
            for (sample, read) in data.stream(run)?.enumerate() {
                let read = read?;
                let Some(truth) = read.truth.as_ref().filter(|t| t.touched()) else { continue };
                touched += 1;
                let Some(kind) = Kind::of(truth).filter(|_| read.tared.iter().any(|v| v.is_finite())) else {
                    other += 1;
                    continue;
                };
                if !truth.contacts.iter().all(heavy) {
                    light += 1;
                    continue;
                }
                let id = SampleId { run, sample };
                if !truth.contacts.iter().all(|c| compliance.gives_way(&c.position)) {
                    rigid.insert(id);
                }
                all.entry(kind).or_default().push(id);
            }
        }
        for ids in all.values_mut() {
            let step = dermis_regress::stride(ids.len(), options.most);
            let before = ids.len();
            *ids = ids.iter().copied().step_by(step).collect();
            thinned += before - ids.len();
        }
        let compared = all.values().flatten();
        let stiff = compared.clone().filter(|id| !options.rigid && rigid.contains(id)).count();
        let left_out = LeftOut::list(
            touched,
            &[
                (other, "more than two contacts, or no zero yet".to_owned()),
                (light, format!("a contact of less than {} N, or of unknown force", options.least)),
                (thinned, "only every n-th frame is compared (`--most`)".to_owned()),
                (
                    stiff,
                    "the surface gives way by less than a tenth of its median (`--rigid` keeps them)".into(),
                ),
            ],
        );
        let kept = (stiff > 0).then(|| compared.filter(|id| !rigid.contains(id)).copied().collect());
        Ok(Self { all, kept, left_out })
    }

    /// Whether a frame that is compared counts.
    pub(in crate::real2sim) fn keeps(&self, id: &SampleId) -> bool {
        self.kept.as_ref().is_none_or(|kept| kept.contains(id))
    }

    /// The frames that count.
    pub(in crate::real2sim) fn compared(&self) -> impl Iterator<Item = &SampleId> {
        self.all.values().flatten().filter(|id| self.keeps(id))
    }
}

/// Where answers are held against the truth.
pub(in crate::real2sim) struct MethodEvaluator<'a> {
    pub(in crate::real2sim) data: &'a Dataset,
    pub(in crate::real2sim) bounds: &'a FrameBounds,
    pub(in crate::real2sim) bins: &'a [f64],
    pub(in crate::real2sim) kept: Option<&'a BTreeSet<SampleId>>,
}

impl MethodEvaluator<'_> {
    pub(in crate::real2sim) fn row(
        &self,
        name: &str,
        method: &mut dyn ContactFinder,
        (kind, ids): (Kind, &[SampleId]),
        progress: &dyn Progress,
    ) -> Result<Row> {
        let mut evaluator = Evaluator::of(self.data).by_force(self.bins);
        let mut right = BTreeMap::new();
        let read = self.data.gather(ids)?;
        let started = Instant::now();
        for (n, (id, sample)) in read.iter().enumerate() {
            let Some(truth) = sample.truth.as_ref() else { continue };
            // These frames do not follow each other.
            method.reset();
            let contacts = method.find(&sample.conditioned())?;
            progress.at((n + 1) as f64 / ids.len() as f64);
            right.insert(*id, contacts.len() == truth.contacts.len());
            evaluator.push(*id, truth, &Estimate { contacts, ..Estimate::default() });
        }
        let seconds = started.elapsed().as_secs_f64() / ids.len().max(1) as f64;
        let counts = !method.single();
        let errors = |evaluation: &Evaluation, found: bool| {
            let contacts: Vec<&ContactError> =
                evaluation.contacts.iter().filter(|c| c.found || !found).collect();
            let frames: BTreeSet<SampleId> = contacts.iter().map(|c| c.id).collect();
            let number = frames.iter().filter(|id| right.get(id) == Some(&true)).count();
            Errors::of(&contacts, counts.then_some((number, frames.len())), frames.len())
        };
        let targets: Option<Vec<SampleId>> =
            self.kept.map(|kept| ids.iter().filter(|id| kept.contains(id)).copied().collect());
        let part = targets.map(|ids| evaluator.restricted(&ids).finish(name));
        let whole = evaluator.finish(name);
        let (with_everything, evaluation) = match part {
            Some(part) => (Some(errors(&whole, false)), part),
            None => (None, whole),
        };
        let found = evaluation.not_found.is_some_and(|lost| lost > 0.0).then(|| errors(&evaluation, true));
        Ok(Row {
            method: name.to_owned(),
            kind: kind.name(),
            with_everything,
            errors: errors(&evaluation, false),
            found,
            seconds,
            evaluation: Some(evaluation.against(self.bounds, self.bins)),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn contacts_that_are_lost_count() {
        let contact = |sample, position, normal_force, found| ContactError {
            id: SampleId { run: 0, sample },
            contact: [0, 1],
            force: 2.0,
            position,
            normal_force,
            vector: f64::NAN,
            angle: f64::NAN,
            found,
            stated: None,
        };
        let all =
            [contact(0, 0.003, -1.0, true), contact(1, 0.004, 0.0, true), contact(2, 0.05, -2.0, false)];
        let of = |found: bool| {
            let some: Vec<&ContactError> = all.iter().filter(|c| c.found || !found).collect();
            Errors::of(&some, Some((2, some.len())), some.len())
        };
        let (everything, found) = (of(false), of(true));
        assert!((everything.position_mean - 0.019).abs() < 1e-12);
        assert!((everything.force_mean - 1.0).abs() < 1e-12);
        assert!((everything.lost - 1.0 / 3.0).abs() < 1e-12);
        assert!((found.position_rms - 12.5e-6_f64.sqrt()).abs() < 1e-12);
        assert_eq!((everything.position_median, found.lost, found.count_right), (0.004, 0.0, Some(1.0)));
    }
}
