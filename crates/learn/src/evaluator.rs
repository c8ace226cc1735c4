//! What a graph makes of a data set before it is a bundle.
//!
//! The graph answers through [`NetworkFinder`], as in a node and in comparisons: the same features, and contacts on the surface of
//! the skin. What a node adds needs a bundle and several frames: presence by level and identities. So the figures of a bundle's
//! card are those of its answers to labelled frames, and `dermis evaluate` adds what the node makes of them.

use std::borrow::Cow;
use std::collections::BTreeSet;
use std::path::Path;

use dermis_estimate::finder::NetworkFinder;
use dermis_estimate::{ContactFinder, FindError, UnpackedModel};
use dermis_inference::{Baseline, FeatureConfig, Features, Model, Outputs};
use dermis_skin::{Contact, SkinDescription};

use crate::LearnError;
use crate::dataset::{Dataset, SampleId};
use crate::evaluate::{Evaluation, centre};
use crate::metrics::{Answer, FORCES, MapScorer, Rule, Scores};
use crate::plot::Point;
use crate::target::Maps;

/// Runs the finished graph.
pub(crate) struct GraphEvaluator {
    finder: NetworkFinder,
}

impl GraphEvaluator {
    /// `model` lies at `path` or will; it takes `features` of readings with or without their zero, and its output means `outputs`.
    pub(crate) fn new(
        path: &Path,
        (model, outputs): (Model, Outputs),
        (features, baseline): (&FeatureConfig, Baseline),
        skin: &SkinDescription,
    ) -> Result<Self, LearnError> {
        let features = Features::new(features.clone())?;
        let model = UnpackedModel { path: path.to_owned(), model, outputs, features, baseline };
        let finder = NetworkFinder::unpacked(model, skin).map_err(|e| LearnError::Setup(Box::new(e)))?;
        Ok(Self { finder })
    }

    /// Compares its answers with the truth, on `only` or on all labelled frames; its maps with those of `maps`.
    pub(crate) fn evaluate(
        &mut self,
        data: &Dataset,
        only: Option<&[SampleId]>,
        maps: Maps,
        name: String,
    ) -> Result<(Evaluation, Vec<Point>), LearnError> {
        let only: Option<BTreeSet<SampleId>> = only.map(|ids| ids.iter().copied().collect());
        let wanted = |id: &SampleId| only.as_ref().is_none_or(|only| only.contains(id));
        let values = &self.finder.outputs().config().values;
        let gives = |name: &str| values.iter().any(|v| v.name == name);
        let mut scores = Scores::new(Rule {
            centre: centre(&data.skin().surface()),
            position: gives("position.x") && gives("position.y"),
            normal_force: gives("force.normal"),
            force: FORCES.map(gives),
            depth: gives("position.z"),
        });
        let mut maps = MapScorer::new(maps);
        let (mut points, mut frames, mut unanswered, mut tares) = (Vec::new(), 0, 0, 0);
        for run in 0..data.runs().len() {
            self.finder.reset();
            for (sample, read) in data.stream_for(run, self.finder.image())?.enumerate() {
                let read = read?;
                if read.tare {
                    // As an estimator does: history seen with another zero would hold a step.
                    self.finder.reset();
                    tares += 1;
                }
                let frame = read.conditioned();
                let id = SampleId { run, sample };
                let truth = read.truth.as_ref().filter(|_| wanted(&id));
                let Some(truth) = truth else {
                    self.finder.pass(&frame)?;
                    continue;
                };
                let contact = match self.finder.contact(&frame) {
                    Err(FindError::History(_)) => {
                        if truth.touched() {
                            unanswered += 1;
                            scores.unanswered(id, truth);
                            maps.push(truth, |_| None)?;
                        }
                        continue;
                    }
                    found => found?,
                };
                let outputs = self.finder.outputs();
                let answer = answer(&contact, outputs);
                scores.push(id, truth, &answer);
                maps.push(truth, |map| outputs.values(map.name()).map(Cow::Borrowed))?;
                points.push(Point::new(truth, &answer));
                frames += 1;
            }
        }
        Ok((Evaluation::of(&scores, name, frames, unanswered, tares).with_maps(maps), points))
    }
}

/// What is scored: the contact; and, as the model gives it, what a contact without a place on the surface cannot hold.
fn answer(contact: &Contact, outputs: &Outputs) -> Answer {
    let depth = outputs.get("position.z");
    let plain = || outputs.get("position.x").zip(outputs.get("position.y"));
    let reported = Answer::of_contact(contact, depth.is_some());
    Answer {
        position: reported.position.or_else(|| plain().map(|(x, y)| [x, y, depth.unwrap_or(0.0)])),
        force: reported.force.or_else(|| known_forces(outputs)),
        normal_force: reported.normal_force.or_else(|| outputs.normal_force()),
        contact: outputs.contact().map(|p| p > 0.5),
        ..reported
    }
}

/// \[N\] the components that the model gives, NaN for the others; `None` where it gives none.
fn known_forces(outputs: &Outputs) -> Option<[f64; 3]> {
    let force = FORCES.map(|name| outputs.get(name));
    force.iter().any(Option::is_some).then(|| force.map(|f| f.unwrap_or(f64::NAN)))
}
