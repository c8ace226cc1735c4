//! Which of several regressors to keep.
//!
//! Problem: on some recordings a Gaussian process or support vectors carry better to another run than a network, on others worse, and
//! which it is shows only where nothing was learned. Method: cross-validation within the training part (M. Stone, *Cross-validatory choice
//! and assessment of statistical predictions*, JRSS B 36, 1974), between runs where there are several, else between locations, else
//! between stretches of time. Positions, forces and contact are judged apart, and each is answered by whoever errs least on it; one graph
//! holds them all. The error is the weighted mean square in the units of the outputs' scales, which is what networks are fitted by; for
//! contact that of the probability. The mean of all others is a candidate like them, judged by their answers to the same rows. Settings
//! of kernels are chosen on the same folds, which favours them a little; what was held out of training judges the result. Assumptions:
//! inputs of some tens of numbers. Cost: a training of the network for each fold, and some hundred fits of at most [`TUNED`] rows for each
//! kind of kernel; a Gaussian process of n rows in a graph of m (`model.most`) takes nm² multiplications for each fold, and at most 200 MB
//! for 2,000, whatever n is.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::atomic::{AtomicBool, Ordering};

use dermis_regress::{Fitted, KernelExpansion, Method, Rows, Settings, Tuning, stride};
use serde::Serialize;

use super::candidates::Candidate;
use super::config::TrainConfig;
use super::network::{Batch, Mlp, fit};
use crate::LearnError;
use crate::dataset::{Dataset, SampleId};

/// Rows that settings of kernels are chosen with at most.
const TUNED: usize = 1000;
/// Rows that a Gaussian process learns from at most, where its graph may hold fewer: a sum over those is fitted to all of these.
const PROCESS: usize = 10_000;
/// Rows of a fold that candidates are judged on at most.
const JUDGED: usize = 2000;
/// Share of the largest weight below which a row teaches no kernel: kernels know no weights.
const LIGHT: f32 = 0.1;
/// Smallest λ of a Gaussian process whose weights a graph of 32-bit numbers still adds up to a thousandth.
const LEAST_NOISE: f64 = 1e-4;
/// What the answer of a kernel to whether something touches, 0 to 1, is multiplied by to be the logit of a probability.
const SLOPE: f64 = 8.0;

/// What is answered by one regressor.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Group {
    /// `position`, `force` or `contact`.
    pub(super) name: &'static str,
    /// Its outputs among all.
    pub(super) columns: std::ops::Range<usize>,
}

/// Which outputs belong together, in the order of the outputs.
pub(super) fn groups(columns: &[&'static str]) -> Vec<Group> {
    let name = |column: &str| match column.split('.').next() {
        Some("position") => "position",
        Some("force") => "force",
        _ => "contact",
    };
    let mut all: Vec<Group> = Vec::new();
    for (i, column) in columns.iter().enumerate() {
        match all.last_mut() {
            Some(last) if last.name == name(column) => last.columns.end = i + 1,
            _ => all.push(Group { name: name(column), columns: i..i + 1 }),
        }
    }
    all
}

/// How a candidate did on what it did not learn from.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Judged {
    /// Who.
    pub candidate: Candidate,
    /// Weighted mean square error by group, in the units of the outputs' scales.
    pub errors: BTreeMap<&'static str, f64>,
    /// Settings by group, of kernels.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub settings: BTreeMap<&'static str, Settings>,
}

/// What was chosen, and by what.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Choice {
    /// What folds part: `runs`, `locations` or `stretches of time`.
    pub between: &'static str,
    /// Folds.
    pub folds: usize,
    /// Everyone who was judged.
    pub judged: Vec<Judged>,
    /// Who answers each group.
    pub kept: BTreeMap<&'static str, Candidate>,
}

impl fmt::Display for Choice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "regressors judged between {} of the training part, {} folds:",
            self.between, self.folds
        )?;
        for judged in &self.judged {
            write!(f, "  {:<18}", judged.candidate.in_words())?;
            for (group, error) in &judged.errors {
                let kept = if self.kept.get(group) == Some(&judged.candidate) { " (kept)" } else { "" };
                write!(f, "  {group} {:.4}{kept}", error.sqrt())?;
            }
            writeln!(f)?;
        }
        writeln!(f, "  root mean squares in units of the outputs' scales")
    }
}

/// Answers of a candidate to the rows that everyone is judged on, by group.
type Answers = BTreeMap<&'static str, Vec<Vec<f64>>>;

/// Regressors whose mean answers a group: one of them, or all where `mean` was kept.
pub(super) struct Kept {
    kernels: Vec<KernelExpansion>,
    network: bool,
}

/// Rows of the training part, and the fold of each.
pub(super) struct Table<'a> {
    batch: &'a Batch,
    groups: Vec<Group>,
    folds: Vec<usize>,
    count: usize,
    between: &'static str,
}

impl<'a> Table<'a> {
    /// `ids` are those of the rows.
    pub(super) fn new(
        data: &Dataset,
        batch: &'a Batch,
        ids: &[SampleId],
        columns: &[&'static str],
        config: &TrainConfig,
    ) -> Result<Self, LearnError> {
        let location = |id: &SampleId| {
            data.sample(*id).and_then(|s| s.truth.as_ref()).filter(|t| t.touched()).map(|t| t.location)
        };
        let runs: std::collections::BTreeSet<usize> = ids.iter().map(|id| id.run).collect();
        let locations: std::collections::BTreeSet<u32> = ids.iter().filter_map(location).collect();
        let most = config.model.folds;
        let (between, groups): (_, Vec<usize>) = if runs.len() > 1 {
            ("runs", ids.iter().map(|id| id.run).collect())
        } else if locations.len() >= most {
            // Untouched rows go with the place before them.
            let mut last = 0;
            let mut place = |id: &SampleId| {
                last = location(id).map_or(last, |l| l as usize);
                last
            };
            ("locations", ids.iter().map(&mut place).collect())
        } else {
            ("stretches of time", (0..ids.len()).map(|i| i * most / ids.len().max(1)).collect())
        };
        let count = if between == "runs" { runs.len().min(most) } else { most };
        let folds = dermis_regress::folds(&groups, count, config.training.seed);
        let groups = self::groups(columns);
        if (0..count).any(|fold| !folds.contains(&fold)) {
            return Err(LearnError::Training {
                reason: format!(
                    "regressors cannot be judged between {between}: there are fewer than {count}; lower `model.folds`, or name \
                     one of `model.candidates`"
                ),
            });
        }
        Ok(Self { batch, groups, folds, count, between })
    }

    fn row(&self, i: usize) -> &[f32] {
        &self.batch.inputs[i * self.batch.width..(i + 1) * self.batch.width]
    }

    fn target(&self, i: usize, columns: &std::ops::Range<usize>) -> &[f32] {
        let from = i * self.batch.outputs;
        &self.batch.targets[from + columns.start..from + columns.end]
    }

    fn weight(&self, i: usize, columns: &std::ops::Range<usize>) -> f32 {
        let from = i * self.batch.outputs;
        self.batch
            .weights
            .get(from + columns.start..from + columns.end)
            .map_or(1.0, |w| w.iter().sum::<f32>() / w.len() as f32)
    }

    /// Rows on which every output of a group is known.
    fn known(&self, group: &Group) -> Vec<usize> {
        (0..self.batch.len())
            .filter(|i| self.target(*i, &group.columns).iter().all(|t| t.is_finite()))
            .collect()
    }

    /// Rows that a kernel learns from, at most so many of those where `may` holds, evenly.
    fn taught(&self, group: &Group, most: usize, may: impl Fn(usize) -> bool) -> Vec<usize> {
        let rows: Vec<usize> = self.known(group).into_iter().filter(|i| may(*i)).collect();
        let largest = rows.iter().map(|i| self.weight(*i, &group.columns)).fold(0.0, f32::max);
        let heavy: Vec<usize> =
            rows.into_iter().filter(|i| self.weight(*i, &group.columns) >= LIGHT * largest).collect();
        thinned(&heavy, most)
    }

    /// Inputs and targets of rows.
    fn tables(&self, rows: &[usize], group: &Group) -> (Vec<f64>, Vec<f64>) {
        let inputs = rows.iter().flat_map(|i| self.row(*i)).map(|v| f64::from(*v)).collect();
        let targets =
            rows.iter().flat_map(|i| self.target(*i, &group.columns)).map(|v| f64::from(*v)).collect();
        (inputs, targets)
    }

    fn fit(&self, settings: &Settings, rows: &[usize], group: &Group) -> Result<Fitted, LearnError> {
        let (inputs, targets) = self.tables(rows, group);
        let fit = || {
            settings.fit(
                Rows::new(&inputs, self.batch.width, "inputs")?,
                Rows::new(&targets, group.columns.len(), "targets")?,
            )
        };
        fit().map_err(|e| LearnError::Training { reason: format!("a kernel cannot be fitted: {e}") })
    }

    /// Rows that everyone is judged on, each with its fold.
    fn judged_rows(&self, group: &Group) -> Vec<(usize, usize)> {
        let known = self.known(group);
        let of = |fold: usize| {
            let rows: Vec<usize> = known.iter().copied().filter(|i| self.folds[*i] == fold).collect();
            thinned(&rows, JUDGED).into_iter().map(move |i| (fold, i))
        };
        (0..self.count).flat_map(of).collect()
    }

    /// Weighted mean square error of answers to the judged rows, one number an output of the group.
    fn error(&self, group: &Group, answers: &[Vec<f64>]) -> f64 {
        let (mut sum, mut total) = (0.0, 0.0);
        for ((_, i), answer) in self.judged_rows(group).into_iter().zip(answers) {
            let weight = f64::from(self.weight(i, &group.columns));
            for (answer, target) in answer.iter().zip(self.target(i, &group.columns)) {
                let value = if group.name == "contact" { logistic(*answer) } else { *answer };
                sum += weight * (value - f64::from(*target)).powi(2);
                total += weight;
            }
        }
        if total > 0.0 { sum / total } else { f64::NAN }
    }

    /// A candidate by its answers.
    fn judged(
        &self,
        candidate: Candidate,
        answers: &Answers,
        settings: BTreeMap<&'static str, Settings>,
    ) -> Judged {
        let error = |group: &Group| {
            (group.name, answers.get(group.name).map_or(f64::NAN, |own| self.error(group, own)))
        };
        Judged { candidate, errors: self.groups.iter().map(error).collect(), settings }
    }

    fn network(&self, config: &TrainConfig, stop: &AtomicBool) -> Result<Option<Answers>, LearnError> {
        let mut members = Vec::with_capacity(self.count);
        for fold in 0..self.count {
            let mut part =
                Batch { inputs: Vec::new(), targets: Vec::new(), weights: Vec::new(), ..*self.batch };
            let (width, outputs) = (self.batch.width, self.batch.outputs);
            for i in (0..self.batch.len()).filter(|i| self.folds[*i] != fold) {
                part.inputs.extend_from_slice(&self.batch.inputs[i * width..(i + 1) * width]);
                part.targets.extend_from_slice(&self.batch.targets[i * outputs..(i + 1) * outputs]);
                part.weights
                    .extend(self.batch.weights.get(i * outputs..(i + 1) * outputs).into_iter().flatten());
            }
            let mut fitted = Vec::new();
            for member in 0..config.network.members {
                if stop.load(Ordering::Relaxed) {
                    return Ok(None);
                }
                fitted.push(fit(&part, &config.network, &config.training, member)?);
            }
            members.push(fitted);
        }
        let answer = |group: &Group| {
            let of = |(fold, i): (usize, usize)| {
                let mut mean = vec![0.0; group.columns.len()];
                for member in &members[fold] {
                    let answer = member.predict(self.row(i));
                    let own = &answer[group.columns.clone()];
                    mean.iter_mut()
                        .zip(own)
                        .for_each(|(m, a)| *m += f64::from(*a) / members[fold].len() as f64);
                }
                mean
            };
            (group.name, self.judged_rows(group).into_iter().map(of).collect())
        };
        Ok(Some(self.groups.iter().map(answer).collect()))
    }

    /// Answers by group, and settings.
    fn kernels(
        &self,
        candidate: Candidate,
        method: Method,
        most: usize,
    ) -> Result<(Answers, BTreeMap<&'static str, Settings>), LearnError> {
        let (mut answers, mut all) = (Answers::new(), BTreeMap::new());
        // Settings that suit more rows than a graph may hold are not the best for those that it holds.
        let enough = TUNED.min(most);
        for group in &self.groups {
            let rows = self.taught(group, enough, |_| true);
            let (inputs, targets) = self.tables(&rows, group);
            let folds: Vec<usize> = rows.iter().map(|i| self.folds[*i]).collect();
            let tuning = Tuning { folds: self.count, most: enough, seed: 0 };
            let tune = || {
                let inputs = Rows::new(&inputs, self.batch.width, "inputs")?;
                let targets = Rows::new(&targets, group.columns.len(), "targets")?;
                let may = |s: &Settings| !matches!(s, Settings::Gaussian(g) if g.noise < LEAST_NOISE);
                Method::tuned_among(method.grid().into_iter().filter(may), inputs, targets, &folds, &tuning)
            };
            let tuned = tune().map_err(|e| LearnError::Training {
                reason: format!("settings of {} cannot be chosen: {e}", candidate.in_words()),
            });
            let settings = tuned?.0.with_supports(most);
            let fitted = (0..self.count)
                .map(|fold| {
                    let rows = self.taught(group, learned(&settings, most), |i| self.folds[i] != fold);
                    self.fit(&settings, &rows, group)
                })
                .collect::<Result<Vec<Fitted>, LearnError>>()?;
            let answer = |(fold, i): (usize, usize)| {
                let row: Vec<f64> = self.row(i).iter().map(|v| f64::from(*v)).collect();
                let answer = fitted[fold].predict(&row);
                let mut answer = answer.map_err(|e| LearnError::Training { reason: e.to_string() })?;
                if group.name == "contact" {
                    answer.iter_mut().for_each(|a| *a = SLOPE * (*a - 0.5));
                }
                Ok(answer)
            };
            let own = self.judged_rows(group).into_iter().map(answer).collect::<Result<_, LearnError>>()?;
            answers.insert(group.name, own);
            all.insert(group.name, settings);
        }
        Ok((answers, all))
    }

    /// Judges everyone; `None` where it was stopped.
    pub(super) fn choose(
        &self,
        config: &TrainConfig,
        stop: &AtomicBool,
    ) -> Result<Option<Choice>, LearnError> {
        let (mut judged, mut all) = (Vec::new(), Vec::new());
        for candidate in config.model.candidates.iter().filter(|c| **c != Candidate::Mean) {
            if stop.load(Ordering::Relaxed) {
                return Ok(None);
            }
            let (answers, settings) = match candidate.kernel() {
                Some(method) => self.kernels(*candidate, method, config.model.most)?,
                None => match self.network(config, stop)? {
                    Some(answers) => (answers, BTreeMap::new()),
                    None => return Ok(None),
                },
            };
            judged.push(self.judged(*candidate, &answers, settings));
            all.push(answers);
        }
        if config.model.candidates.contains(&Candidate::Mean) {
            judged.push(self.judged(Candidate::Mean, &mean(&all), BTreeMap::new()));
        }
        let mut kept = BTreeMap::new();
        for group in &self.groups {
            let error = |j: &&Judged| j.errors.get(group.name).copied().unwrap_or(f64::NAN);
            // NaN is above every number.
            if let Some(best) = judged.iter().min_by(|a, b| error(a).total_cmp(&error(b))) {
                kept.insert(group.name, best.candidate);
            }
        }
        Ok(Some(Choice { between: self.between, folds: self.count, judged, kept }))
    }

    /// Who answers a group, fitted on all of the training part: kernels as they answer in the units of the outputs, and whether the
    /// network answers, too.
    pub(super) fn kept(&self, group: &Group, choice: &Choice, most: usize) -> Result<Kept, LearnError> {
        let kept = choice.kept.get(group.name).copied();
        let of = |judged: &&Judged| match kept {
            Some(Candidate::Mean) => judged.candidate != Candidate::Mean,
            kept => kept == Some(judged.candidate),
        };
        let mut all = Kept { kernels: Vec::new(), network: false };
        for judged in choice.judged.iter().filter(of) {
            let Some(settings) = judged.settings.get(group.name) else {
                all.network = true;
                continue;
            };
            let fitted = self.fit(settings, &self.taught(group, learned(settings, most), |_| true), group)?;
            let Some(mut expansion) = fitted.expansion().cloned() else { continue };
            if group.name == "contact" {
                expansion.weights.iter_mut().for_each(|w| *w *= SLOPE);
                expansion.bias.iter_mut().for_each(|b| *b = SLOPE * (*b - 0.5));
            }
            all.kernels.push(expansion);
        }
        Ok(all)
    }

    /// What belongs together.
    pub(super) fn groups(&self) -> &[Group] {
        &self.groups
    }
}

/// The mean of several candidates' answers to the same rows.
fn mean(all: &[Answers]) -> Answers {
    let mut sum = Answers::new();
    let share = 1.0 / all.len().max(1) as f64;
    for (group, rows) in all.iter().flatten() {
        let own = sum.entry(group).or_insert_with(|| rows.iter().map(|row| vec![0.0; row.len()]).collect());
        for (sum, value) in own.iter_mut().flatten().zip(rows.iter().flatten()) {
            *sum += share * value;
        }
    }
    sum
}

fn logistic(value: f64) -> f64 {
    1.0 / (1.0 + (-value).exp())
}

/// Rows that a kernel learns from at most, where its graph holds `most`.
fn learned(settings: &Settings, most: usize) -> usize {
    match settings {
        Settings::Gaussian(_) => most.max(PROCESS),
        _ => most,
    }
}

fn thinned(rows: &[usize], most: usize) -> Vec<usize> {
    rows.iter().copied().step_by(stride(rows.len(), most)).collect()
}

/// The networks of which a group keeps none are not fitted.
pub(super) fn needs_network(choice: &Choice) -> bool {
    let fitted = choice.judged.iter().any(|j| j.candidate == Candidate::Network);
    fitted && choice.kept.values().any(|kept| matches!(kept, Candidate::Network | Candidate::Mean))
}

/// Networks and kernels behind one preparation, as a graph of batch 1: `input` → `output`.
pub(super) fn to_onnx(
    networks: &[Mlp],
    kept: &[(Group, Kept)],
    preparation: &super::prepare::Preparation,
    outputs: usize,
) -> Result<Vec<u8>, dermis_inference::onnx::OnnxError> {
    let mut g = dermis_inference::onnx::GraphBuilder::new("dermis");
    let input = g.input("input", &[1, preparation.width()]);
    let prepared = preparation.to_graph(&mut g, &input);
    let network = Mlp::mean_to_graph(networks, &mut g, &prepared);
    let mut parts = Vec::new();
    for (group, kept) in kept {
        let end = |v: usize| i64::try_from(v).unwrap_or(i64::MAX);
        let mut own = Vec::new();
        for (k, kernel) in kept.kernels.iter().enumerate() {
            let name = format!("{}_{k}", group.name);
            own.push(super::kernels::to_graph(kernel, &mut g, &prepared, &name));
        }
        if let Some(mean) = network.as_ref().filter(|_| kept.network) {
            own.push(g.slice(mean, 1, end(group.columns.start), end(group.columns.end)));
        }
        let count = own.len() as f32;
        let Some(sum) = own.into_iter().reduce(|a, b| g.add(&a, &b)) else { continue };
        parts.push(if count > 1.0 {
            let share = g.constant(&format!("{}_share", group.name), &[1, 1], &[1.0 / count]);
            g.mul(&sum, &share)
        } else {
            sum
        });
    }
    let all = match parts.as_slice() {
        [one] => one.clone(),
        _ => g.concat(&parts.iter().collect::<Vec<_>>(), 1),
    };
    g.output("output", &all, &[1, outputs]);
    g.finish()
}

#[cfg(test)]
mod tests;
