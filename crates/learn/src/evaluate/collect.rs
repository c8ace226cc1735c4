//! Collecting estimates beside the truth, frame by frame.

use std::collections::BTreeSet;

use dermis_skin::{Contact, Estimate, Estimator, ForceComponents, Surface};
use nalgebra::{Point3, Vector3};

use super::Evaluation;
use crate::LearnError;
use crate::dataset::{Dataset, Sample, SampleId, Truth};
use crate::metrics::{Answer, Consistencies, MapReading, MapScorer, Rule, Scores};
use crate::target::Maps;

/// Compares estimates with the truth one by one, for callers that get their estimates elsewhere, e.g. from a bus.
#[derive(Default)]
pub struct Evaluator {
    /// Without contacts where there was no answer.
    answers: Vec<(SampleId, Truth, Option<Vec<Contact>>)>,
    maps: Option<MapScorer>,
    maps_of: Option<BTreeSet<SampleId>>,
    edges: Option<Vec<f64>>,
    centre: Option<Point3<f64>>,
    tares: usize,
}

impl Evaluator {
    /// Nothing yet. What is missed counts as far away as the middle of all true contacts; better [`of`](Self::of) a data set, or
    /// [`on`](Self::on) a surface.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Nothing yet of the skin of this data set.
    #[must_use]
    pub fn of(data: &Dataset) -> Self {
        Self::new().on(&data.skin().surface())
    }

    /// What is missed counts as far away as the middle of this surface.
    #[must_use]
    pub fn on(mut self, surface: &Surface) -> Self {
        self.centre = centre(surface);
        self
    }

    /// Reports errors by force in these bins in place of [`FORCE_BINS`]; `edges` \[N\] ascend, the last bin is open.
    ///
    /// [`FORCE_BINS`]: crate::FORCE_BINS
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

    /// Reads contacts off the maps of forces that are compared in this way, in place of [`MapReading::of_surface`].
    #[must_use]
    pub fn with_map_reading(mut self, reading: MapReading) -> Self {
        self.maps = self.maps.map(|maps| maps.reading(reading));
        self
    }

    /// Takes the maps of these frames only.
    #[must_use]
    pub fn maps_of(mut self, only: &[SampleId]) -> Self {
        self.maps_of = Some(only.iter().copied().collect());
        self
    }

    /// Takes the maps of one estimate, besides what [`push`](Self::push) takes of it; none count as unanswered.
    ///
    /// # Errors
    ///
    /// [`LearnError::Training`] where the forward model fails on the true map.
    pub fn push_maps(&mut self, truth: &Truth, estimate: &Estimate) -> Result<(), LearnError> {
        self.maps.as_mut().map_or(Ok(()), |maps| maps.push_estimate(truth, estimate))
    }

    /// Takes one estimate. Where one contact is true, of several found the one with the largest normal force counts, then
    /// that of the largest confidence; where several are true, each is compared with the one that is found for it.
    pub fn push(&mut self, id: SampleId, truth: &Truth, estimate: &Estimate) {
        self.answers.push((id, truth.clone(), Some(estimate.contacts.clone())));
    }

    /// Counts a frame for which there is no answer: where something touched, as one in which nothing was found.
    pub fn unanswered(&mut self, id: SampleId, truth: &Truth) {
        self.answers.push((id, truth.clone(), None));
    }

    /// Counts a zero that was taken anew.
    pub fn tared(&mut self) {
        self.tares += 1;
    }

    /// Feeds every frame of a data set to an estimator as [`evaluate`](super::evaluate) does, and takes those of `only`, or all
    /// labelled ones.
    ///
    /// # Errors
    ///
    /// [`LearnError::Estimate`] names the bag that holds the frame that the estimator refused; and where the forward model fails on a
    /// true map.
    pub fn run(
        &mut self,
        estimator: &mut dyn Estimator,
        data: &Dataset,
        only: Option<&[SampleId]>,
    ) -> Result<(), LearnError> {
        if self.centre.is_none() {
            self.centre = centre(&data.skin().surface());
        }
        let only: Option<BTreeSet<SampleId>> = only.map(|ids| ids.iter().copied().collect());
        for (run, r) in data.runs().iter().enumerate() {
            estimator.reset();
            for (sample, s) in data.stream_images(run, None)?.enumerate() {
                let s = s?;
                if s.tare {
                    estimator.tare();
                    self.tared();
                }
                let estimate = estimator
                    .estimate(&s.frame)
                    .map_err(|source| LearnError::Estimate { bag: r.path.clone(), source })?;
                let Some(truth) = &s.truth else { continue };
                let id = SampleId { run, sample };
                if only.as_ref().is_some_and(|ids| !ids.contains(&id)) {
                    continue;
                }
                self.take(id, &s, truth, &estimate)?;
            }
        }
        Ok(())
    }

    /// Takes the estimate of a sample and its maps; before the first zero there is no answer.
    pub(super) fn take(
        &mut self,
        id: SampleId,
        sample: &Sample,
        truth: &Truth,
        estimate: &Estimate,
    ) -> Result<(), LearnError> {
        let none = Estimate::default();
        let answer = if !sample.tared.iter().all(|v| v.is_nan()) {
            self.push(id, truth, estimate);
            estimate
        } else if truth.touched() {
            self.unanswered(id, truth);
            &none
        } else {
            return Ok(());
        };
        if self.maps_of.as_ref().is_none_or(|ids| ids.contains(&id)) {
            self.push_maps(truth, answer)?;
        }
        Ok(())
    }

    /// What was taken of these frames, without maps.
    #[must_use]
    pub fn restricted(&self, only: &[SampleId]) -> Self {
        let only: BTreeSet<SampleId> = only.iter().copied().collect();
        Self {
            answers: self.answers.iter().filter(|(id, ..)| only.contains(id)).cloned().collect(),
            edges: self.edges.clone(),
            centre: self.centre,
            tares: self.tares,
            ..Self::default()
        }
    }

    /// The same with the maps that `other` took; it has none then.
    #[must_use]
    pub fn with_maps_of(mut self, other: &mut Self) -> Self {
        self.maps = other.maps.take();
        self
    }

    /// What is given shows in the contacts; only then does "no contact" mean "no force". Who never found anything is scored on all.
    fn rule(&self) -> Rule {
        let found = || self.answers.iter().filter_map(|(.., found)| found.as_ref()).flatten();
        let gives =
            |components: &[ForceComponents]| found().any(|c| components.contains(&c.force_components));
        let full = gives(&[ForceComponents::Full]);
        let nothing = found().next().is_none();
        let normal = found().any(|c| c.normal_force().is_finite());
        let normal_force = nothing || (full && normal) || gives(&[ForceComponents::Normal]);
        let component = |i: usize| {
            nothing || found().any(|c| c.force_components == ForceComponents::Full && c.force[i].is_finite())
        };
        let force = [0, 1, 2].map(component);
        let position = nothing || found().any(|c| c.position.x.is_finite() && c.position.y.is_finite());
        // On a curved skin the height says where a contact is, too.
        let locations =
            || self.answers.iter().flat_map(|(_, truth, _)| truth.contacts.iter().map(|c| c.position));
        let (low, high) =
            locations().fold((f64::INFINITY, -f64::INFINITY), |(l, h), p| (l.min(p.z), h.max(p.z)));
        let known = || locations().filter(|p| p.coords.iter().all(|v| v.is_finite()));
        let count = known().count();
        let middle =
            (count > 0).then(|| Point3::from(known().map(|p| p.coords).sum::<Vector3<f64>>() / count as f64));
        let centre = self.centre.or(middle);
        Rule { centre, position, normal_force, force, depth: high - low > 1e-6 }
    }

    /// Sums up.
    #[must_use]
    pub fn finish(self, data: impl Into<String>) -> Evaluation {
        let rule = self.rule();
        let strength = |c: &Contact| {
            let force = c.normal_force();
            (if force.is_nan() { 0.0 } else { force }, c.confidence)
        };
        let mut scores = Scores::new(rule);
        let (mut frames, mut unanswered) = (0, 0);
        for (id, truth, found) in &self.answers {
            let Some(found) = found else {
                unanswered += usize::from(truth.touched());
                scores.unanswered(*id, truth);
                continue;
            };
            frames += 1;
            scores.push_contacts(*id, truth, found);
            let contact = found.iter().max_by(|a, b| {
                let ((fa, ca), (fb, cb)) = (strength(a), strength(b));
                fa.total_cmp(&fb).then(ca.total_cmp(&cb))
            });
            let answer = match contact {
                Some(contact) => Answer::of_contact(contact, rule.depth),
                None => Answer {
                    normal_force: rule.normal_force.then_some(0.0),
                    force: Some([0.0; 3]),
                    depth: rule.depth,
                    ..Answer::default()
                },
            };
            scores.push(*id, truth, &Answer { contact: Some(contact.is_some()), ..answer });
        }
        let mut evaluation = Evaluation::of(&scores, data, frames, unanswered, self.tares);
        if let Some(edges) = &self.edges {
            evaluation.by_force = scores.by_force(edges);
            evaluation.consistency = Consistencies::of(scores.contacts(), edges);
        }
        match self.maps {
            Some(maps) => evaluation.with_maps(maps),
            None => evaluation,
        }
    }
}

/// The mean place of a surface; `None` where it has no area.
pub(crate) fn centre(surface: &Surface) -> Option<Point3<f64>> {
    let area: f64 = surface.areas.iter().sum();
    let weighted = surface.points.iter().zip(&surface.areas).map(|(p, a)| p.coords * *a);
    (area > 0.0).then(|| Point3::from(weighted.sum::<Vector3<f64>>() / area))
}
