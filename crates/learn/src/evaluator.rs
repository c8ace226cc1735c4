//! What a graph makes of a data set, without the estimator of a sensor family around it.

use std::borrow::Cow;
use std::collections::BTreeSet;

use dermis_inference::{Baseline, FeatureConfig, Model, Outputs};

use crate::LearnError;
use crate::dataset::{Dataset, SampleId};
use crate::evaluate::{Evaluation, centre};
use crate::metrics::{Answer, MapScorer, Rule, Scores};
use crate::plot::Point;
use crate::target::Maps;

const FORCES: [&str; 3] = ["force.x", "force.y", "force.z"];

/// Runs the finished graph.
pub(crate) struct GraphEvaluator<'a> {
    /// The graph.
    pub(crate) model: Model,
    /// What its output means.
    pub(crate) outputs: Outputs,
    /// How frames become its input.
    pub(crate) features: &'a FeatureConfig,
    /// Which readings it takes.
    pub(crate) baseline: Baseline,
}

impl GraphEvaluator<'_> {
    /// Compares its answers with the truth, on `only` or on all labelled frames; its maps with those of `maps`.
    pub(crate) fn evaluate(
        &mut self,
        data: &Dataset,
        only: Option<&BTreeSet<SampleId>>,
        maps: Maps,
        name: String,
    ) -> Result<(Evaluation, Vec<Point>), LearnError> {
        let wanted = |id: &SampleId| only.is_none_or(|only| only.contains(id));
        let values = &self.outputs.config().values;
        let gives = |name: &str| values.iter().any(|v| v.name == name);
        let mut scores = Scores::new(Rule {
            centre: centre(&data.skin().surface()),
            position: gives("position.x") && gives("position.y"),
            normal_force: gives("force.normal"),
            force: FORCES.map(gives),
            depth: gives("position.z"),
        });
        let mut maps = MapScorer::new(maps);
        let (mut points, mut raw, mut frames) = (Vec::new(), Vec::new(), 0);
        let mut answered = BTreeSet::new();
        data.each_input(self.features, self.baseline, |id, row| {
            let Some(truth) = data.sample(id).and_then(|s| s.truth.as_ref()).filter(|_| wanted(&id)) else {
                return Ok(());
            };
            self.model.run(row, &mut raw)?;
            self.outputs.decode(&raw)?;
            let answer = self.answer();
            scores.push(id, truth, &answer);
            maps.push(truth, |map| self.outputs.values(map.name()).map(Cow::Borrowed))?;
            points.push(Point::new(truth, &answer));
            answered.insert(id);
            frames += 1;
            Ok(())
        })?;
        let mut unanswered = 0;
        for (id, _, truth) in
            data.labelled().filter(|(id, _, t)| wanted(id) && t.touched() && !answered.contains(id))
        {
            unanswered += 1;
            scores.unanswered(id, truth);
            maps.push(truth, |_| None)?;
        }
        let tares = data.runs().iter().flat_map(|r| &r.samples).filter(|s| s.tare).count();
        Ok((Evaluation::of(&scores, name, frames, unanswered, tares).with_maps(maps), points))
    }

    fn answer(&self) -> Answer {
        let get = |name: &str| self.outputs.get(name);
        let position = get("position.x").zip(get("position.y"));
        let depth = get("position.z");
        let force = FORCES.map(get);
        Answer {
            position: position.map(|(x, y)| [x, y, depth.unwrap_or(0.0)]),
            depth: depth.is_some(),
            force: force.iter().any(Option::is_some).then(|| force.map(|f| f.unwrap_or(f64::NAN))),
            normal_force: self.outputs.normal_force(),
            contact: self.outputs.contact().map(|p| p > 0.5),
        }
    }
}
