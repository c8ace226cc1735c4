//! Errors per quantity and force: one implementation for training, evaluation, comparisons and reports.
//!
//! Problem: errors of estimators, and of an estimator and its bound, can be compared only where the same frames count. Rule: every
//! touched target frame counts. A contact that is not found, or whose frame has no answer, counts in number, as a force of 0,
//! and in position as the distance to [`Rule::centre`], the middle of the surface. That is the answer with the least mean square
//! error of who knows nothing but the surface (the mean of a uniform prior; compare the reference of R²). Beside each figure with
//! everything stands the figure of what was found, under its name and ` found`. Of several contacts each true one is held against the
//! one that is found for it; a contact too many counts in number only. [`AgainstBound`](crate::AgainstBound) divides by the bound.
//! Assumptions: none of the errors' distribution; intervals resample whole locations. Cost: one pass, and a sort for each quantity.

use std::borrow::Cow;
use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use dermis_skin::{Contact, ForceComponents, assign};
use nalgebra::{Matrix3, Point3, Vector3};

use crate::dataset::{SampleId, Truth, TruthContact};

mod consistency;
mod contacts;
mod examples;
mod maps;
mod statistics;
mod strongest;

pub use consistency::{Consistencies, Consistency, ConsistencyBin, Stated};
pub use contacts::{ContactsOfMaps, ContactsRead, MapContacts, MapReading, Spread};
pub use examples::MapExample;
pub(crate) use maps::MapScorer;
pub use maps::{ChannelErrors, MapErrors, MapOfNumber, MapPart, MapScores, MapSummary};
pub(crate) use statistics::median;
use statistics::summarise;
pub use strongest::{StrongestErrors, StrongestPart};

/// \[N\] edges of the bins of normal force that errors are reported by; the last bin is open.
pub const FORCE_BINS: [f64; 9] = [0.0, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0];

/// Components of a force, as labels and models name them.
pub(crate) const FORCES: [&str; 3] = ["force.x", "force.y", "force.z"];

/// What is estimated of one frame, in SI units and in the frame of the skin's link; `None` where the model gives
/// no such quantity.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Answer {
    /// \[m\].
    pub position: Option<[f64; 3]>,
    /// Whether `position` has a z that the model gives, instead of one that follows from the surface.
    pub depth: bool,
    /// \[m²\] covariance of `position`; without finite numbers where none is stated.
    pub position_covariance: Option<Matrix3<f64>>,
    /// \[N\] exerted on the skin; NaN what of it is not given.
    pub force: Option<[f64; 3]>,
    /// \[N\] pressing.
    pub normal_force: Option<f64>,
    /// Whether something touches the skin.
    pub contact: Option<bool>,
}

impl Answer {
    /// What a contact says of place and force; `depth` as above. Whether something touches is the caller's to say.
    pub(crate) fn of_contact(contact: &Contact, depth: bool) -> Self {
        let at = contact.position;
        let known = contact.force_components != ForceComponents::None;
        let full = contact.force_components == ForceComponents::Full;
        Self {
            position: (at.x.is_finite() && at.y.is_finite()).then_some([at.x, at.y, at.z]),
            depth,
            position_covariance: Some(contact.position_covariance),
            force: full.then_some(contact.force.into()),
            normal_force: known.then(|| contact.normal_force()).filter(|force| force.is_finite()),
            contact: None,
        }
    }
}

/// Distribution of one error. For a position the error is a distance, for anything else a difference.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// `m` or `N`.
    pub unit: String,
    /// Samples.
    pub samples: usize,
    /// Root mean square.
    pub rms: f64,
    /// Mean magnitude.
    pub mean: f64,
    /// Median magnitude.
    pub median: f64,
    /// 95th percentile of the magnitude.
    pub p95: f64,
    /// Largest magnitude.
    pub max: f64,
    /// Mean of estimate − truth; absent for a distance.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bias: Option<f64>,
    /// 95 % interval of `rms` over resampled groups; absent with fewer than three groups.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rms_interval: Option<[f64; 2]>,
    /// 95 % interval of `mean` over resampled groups; absent with fewer than three groups.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mean_interval: Option<[f64; 2]>,
    /// Number of groups, and what they are.
    pub groups: usize,
    /// `location`, or `press` where all samples are of one or two locations.
    pub grouped_by: String,
}

/// Errors in one bin of normal force.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Bin {
    /// \[N\] lower end.
    pub from: f64,
    /// \[N\] upper end, absent for the last bin.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub to: Option<f64>,
    /// Samples.
    pub samples: usize,
    /// Root mean square of the error, in the unit of the quantity.
    pub rms: f64,
    /// Mean of the error's magnitude; 0 in cards of dermis 0.1.0 before it was kept.
    #[serde(default)]
    pub mean: f64,
    /// Median of the error's magnitude; absent in files of before it was kept.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub median: Option<f64>,
}

/// \[N\] from which on every contact must press for their number to be judged.
pub const COUNTED_FROM: f64 = 0.2;

/// Index in [`FORCE_BINS`] of the bin of a normal force \[N\]; what pulls counts as the lightest.
pub(crate) fn bin_of(force: f64) -> usize {
    FORCE_BINS.iter().filter(|from| force >= **from).count().max(1) - 1
}

/// Which bin of these ascending edges \[N\] a true normal force \[N\] falls into; the last bin is open. `None` for what lies below the
/// first edge, and for an unknown force.
pub(crate) fn bin_in(edges: &[f64], force: f64) -> Option<usize> {
    if !force.is_finite() {
        return None;
    }
    // What a noisy force cell says of the lightest press may be below 0.
    let force = if edges.first() == Some(&0.0) { force.max(0.0) } else { force };
    edges.iter().filter(|from| force >= **from).count().checked_sub(1)
}

/// Root mean squares of values by the true normal force \[N\] of each, of pairs of force and value; empty bins and values of
/// unknown force are left out. `edges` \[N\] ascend; what lies below the first is left out, the last bin is open.
pub fn bins(edges: &[f64], values: impl Iterator<Item = (f64, f64)>) -> Vec<Bin> {
    let mut all: Vec<Vec<f64>> = vec![Vec::new(); edges.len()];
    for (force, value) in values {
        if let Some(index) = bin_in(edges, force) {
            all[index].push(value.abs());
        }
    }
    let bin = |(i, mut values): (usize, Vec<f64>)| {
        let samples = values.len();
        let squares: f64 = values.iter().map(|v| v * v).sum();
        Bin {
            from: edges[i],
            to: edges.get(i + 1).copied(),
            samples,
            rms: (squares / samples as f64).sqrt(),
            mean: values.iter().sum::<f64>() / samples as f64,
            median: Some(median(&mut values)),
        }
    };
    all.into_iter().enumerate().filter(|(_, values)| !values.is_empty()).map(bin).collect()
}

#[derive(Debug, Clone, Copy)]
struct Error {
    value: f64,
    /// \[N\] true normal force, NaN where unknown.
    force: f64,
    location: u64,
    press: u64,
    /// Whether the contact was found; otherwise `value` is what the rule says.
    found: bool,
}

/// Error of one true contact; NaN what is unknown or not given.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ContactError {
    /// Frame.
    pub id: SampleId,
    /// Index among the true contacts of the frame, and how many these are.
    pub contact: [usize; 2],
    /// \[N\] true normal force.
    pub force: f64,
    /// \[m\] distance.
    pub position: f64,
    /// \[N\] estimate − truth.
    pub normal_force: f64,
    /// \[N\] length of the difference of both forces.
    pub vector: f64,
    /// \[rad\] between both forces; NaN where the contact was not found.
    pub angle: f64,
    /// Whether the contact was found; otherwise errors of place and force are what the rule says.
    pub found: bool,
    /// What the estimator states of the position's error, where it does.
    pub stated: Option<Stated>,
}

/// What counts for a contact that was not found.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Rule {
    /// \[m\] middle of the surface; without one, what was not found has no position.
    pub centre: Option<Point3<f64>>,
    /// Whether the estimator gives positions: one of forces only misses no place.
    pub position: bool,
    /// Whether it gives normal forces.
    pub normal_force: bool,
    /// Which components of forces it gives.
    pub force: [bool; 3],
    /// Whether z counts in distances.
    pub depth: bool,
}

/// Collects errors sample by sample.
#[derive(Debug, Clone, Default)]
pub struct Scores {
    rule: Rule,
    contacts: Vec<ContactError>,
    errors: BTreeMap<&'static str, Vec<Error>>,
    touched: usize,
    missed: usize,
    untouched: usize,
    false_contacts: usize,
    /// By true number of contacts: frames, and those whose number was found right.
    counts: BTreeMap<usize, [usize; 2]>,
}

/// Names of the errors of frames with two, three … contacts.
const OF_SEVERAL: [(&str, &str); 3] = [
    ("position of 2", "force.normal of 2"),
    ("position of 3", "force.normal of 3"),
    ("position of more", "force.normal of more"),
];

impl Scores {
    /// Nothing yet.
    #[must_use]
    pub fn new(rule: Rule) -> Self {
        Self { rule, ..Self::default() }
    }

    fn add(
        &mut self,
        name: &'static str,
        (id, truth): (SampleId, &Truth),
        force: f64,
        value: f64,
        found: bool,
    ) {
        if value.is_finite() {
            let press = ((id.run as u64) << 40) ^ truth.press;
            let error = Error { value, force, location: u64::from(truth.location), press, found };
            self.errors.entry(name).or_default().push(error);
        }
    }

    /// \[m\] by how much a contact that was not found counts; NaN where there is no rule.
    fn missed_by(&self, contact: &TruthContact, depth: bool) -> f64 {
        let Some(centre) = self.rule.centre.filter(|_| self.rule.position) else { return f64::NAN };
        let away = contact.position - centre;
        if depth { away.norm() } else { away.xy().norm() }
    }

    /// Compares one answer with the truth.
    ///
    /// Force errors of an untouched skin are kept apart under `force.normal untouched`. A contact that was missed
    /// counts as a force of 0 and as far away as [`Rule::centre`]; `position.x` … are of contacts that were found.
    pub fn push(&mut self, id: SampleId, truth: &Truth, answer: &Answer) {
        if let Some(contact) = answer.contact {
            let (all, wrong) = if truth.touched() {
                (&mut self.touched, &mut self.missed)
            } else {
                (&mut self.untouched, &mut self.false_contacts)
            };
            *all += 1;
            *wrong += usize::from(contact != truth.touched());
        }
        self.score(id, truth, answer);
    }

    /// Counts a touched frame for which there is no answer: as one in which nothing was found, but for the share of missed contacts.
    pub fn unanswered(&mut self, id: SampleId, truth: &Truth) {
        if !truth.touched() {
            return;
        }
        let nothing = Answer {
            contact: Some(false),
            depth: self.rule.depth,
            normal_force: self.rule.normal_force.then_some(0.0),
            force: Some([0.0; 3]),
            ..Answer::default()
        };
        self.score(id, truth, &nothing);
        self.push_contacts(id, truth, &[]);
    }

    fn score(&mut self, id: SampleId, truth: &Truth, answer: &Answer) {
        let of = (id, truth);
        let single = truth.single();
        let true_force = single.and_then(TruthContact::normal_force).unwrap_or(f64::NAN);
        // Nothing is said of a contact that is said not to be.
        let silent = answer.contact == Some(false);
        let normal_force = answer.normal_force.map(|f| if silent { 0.0 } else { f });
        let given = answer.position.filter(|_| !silent);
        let found = !silent && (given.is_some() || !self.rule.position);
        let mut error = ContactError {
            id,
            contact: [0, 1],
            force: true_force,
            position: f64::NAN,
            normal_force: f64::NAN,
            vector: f64::NAN,
            angle: f64::NAN,
            found,
            stated: None,
        };
        if let Some(force) = normal_force
            && let Some(known) = truth.value("force.normal")
        {
            let name = if truth.touched() { "force.normal" } else { "force.normal untouched" };
            error.normal_force = force - known;
            self.add(name, of, true_force, error.normal_force, found || !truth.touched());
        }
        let Some(contact) = single else { return };
        if let Some(force) = answer.force {
            // No contact is no force, of what would be given.
            let none = self.rule.force.map(|given| if given { 0.0 } else { f64::NAN });
            let force = if silent { none } else { force };
            let along = FORCES.map(|name| truth.value(name));
            if let ([Some(x), Some(y), Some(z)], false) = (along, silent) {
                let angle = Vector3::from(force).angle(&Vector3::new(x, y, z));
                error.angle = angle;
                self.add("angle", of, true_force, angle, true);
            }
            let mut squares = Some(0.0);
            for (name, value) in FORCES.into_iter().zip(force) {
                let known = truth.value(name);
                if let Some(known) = known {
                    self.add(name, of, true_force, value - known, found);
                }
                squares = squares.zip(known).map(|(s, known): (f64, f64)| s + (value - known).powi(2));
            }
            if let Some(squares) = squares {
                error.vector = squares.sqrt();
                self.add("force", of, true_force, error.vector, found);
            }
        }
        if let Some(position) = given {
            error.position = self.score_position(of, true_force, position, answer.depth);
            let away = Point3::from(position) - contact.position;
            let away = if answer.depth { away } else { Vector3::new(away.x, away.y, 0.0) };
            error.stated = answer.position_covariance.and_then(|covariance| Stated::of(&covariance, &away));
        } else {
            error.position = self.missed_by(contact, answer.depth);
            self.add("position", of, true_force, error.position, false);
        }
        self.contacts.push(error);
    }

    /// The distance between a position that was given and the true one, NaN where that is unknown.
    fn score_position(&mut self, of: (SampleId, &Truth), force: f64, position: [f64; 3], depth: bool) -> f64 {
        let names = ["position.x", "position.y", "position.z"];
        let known = names.map(|n| of.1.value(n));
        let mut squares = 0.0;
        for ((name, known), value) in
            names.into_iter().zip(known).zip(position).take(if depth { 3 } else { 2 })
        {
            if let Some(known) = known {
                self.add(name, of, force, value - known, true);
            }
            squares += known.map_or(f64::NAN, |known| (value - known).powi(2));
        }
        self.add("position", of, force, squares.sqrt(), true);
        squares.sqrt()
    }

    /// Compares the contacts that were found with those of the truth: their number, and where there are several, each true
    /// one with the one that is found for it (the assignment whose distances add up to least). A true one for which none is found
    /// counts as a force of 0 and as far away as [`Rule::centre`].
    pub fn push_contacts(&mut self, id: SampleId, truth: &Truth, found: &[Contact]) {
        if !truth.touched() {
            return;
        }
        let clear = |c: &TruthContact| c.normal_force().is_none_or(|f| f >= COUNTED_FROM);
        if truth.contacts.iter().all(clear) {
            let [frames, right] = self.counts.entry(truth.contacts.len()).or_default();
            *frames += 1;
            *right += usize::from(found.len() == truth.contacts.len());
        }
        let Some(names) = truth.contacts.len().checked_sub(2).map(|i| OF_SEVERAL[i.min(2)]) else { return };
        let distance = |t: usize, f: usize| (found[f].position - truth.contacts[t].position).norm();
        let assigned = assign(truth.contacts.len(), found.len(), distance);
        for (n, (true_one, index)) in truth.contacts.iter().zip(assigned).enumerate() {
            let answer = index.map(|i| &found[i]);
            let force = true_one.normal_force().unwrap_or(f64::NAN);
            let position = answer
                .map_or_else(|| self.missed_by(true_one, true), |a| (a.position - true_one.position).norm());
            let missed = if self.rule.normal_force { -force } else { f64::NAN };
            let normal_force = answer.map_or(missed, |a| a.normal_force() - force);
            self.add(names.0, (id, truth), force, position, answer.is_some());
            self.add(names.1, (id, truth), force, normal_force, answer.is_some());
            let contact = [n, truth.contacts.len()];
            let found = answer.is_some();
            let (vector, angle) = (f64::NAN, f64::NAN);
            let stated =
                answer.and_then(|a| Stated::of(&a.position_covariance, &(a.position - true_one.position)));
            self.contacts.push(ContactError {
                id,
                contact,
                force,
                position,
                normal_force,
                vector,
                angle,
                found,
                stated,
            });
        }
    }

    /// Errors of every true contact.
    #[must_use]
    pub fn contacts(&self) -> &[ContactError] {
        &self.contacts
    }

    /// Share of frames whose number of contacts was found right, by true number; frames in which a contact presses with
    /// less than [`COUNTED_FROM`] are left out.
    #[must_use]
    pub fn count_right(&self) -> BTreeMap<usize, f64> {
        self.counts
            .iter()
            .map(|(number, [frames, right])| (*number, *right as f64 / *frames as f64))
            .collect()
    }

    /// Every quantity that was compared: `position` (distance), `position.x` …, `force.normal`,
    /// `force.normal untouched`, `force.x` …, `force` (length of the difference), `angle` (between the forces of contacts that were found), `position of 2` …. Where a contact was not found,
    /// also those of what was found: `position found`, `force.normal found` ….
    #[must_use]
    pub fn summaries(&self, seed: u64) -> BTreeMap<String, Summary> {
        self.named().map(|(name, errors)| (name.clone(), summarise(&name, &errors, seed))).collect()
    }

    /// Errors by true normal force, for quantities whose samples have one; empty bins are left out.
    #[must_use]
    pub fn by_force(&self, edges: &[f64]) -> BTreeMap<String, Vec<Bin>> {
        let binned = |(name, errors): (String, Cow<'_, [Error]>)| {
            let bins = bins(edges, errors.iter().map(|e| (e.force, e.value)));
            (!bins.is_empty()).then_some((name, bins))
        };
        self.named().filter_map(binned).collect()
    }

    /// All errors by name, and those of what was found, where that is not everything.
    fn named(&self) -> impl Iterator<Item = (String, Cow<'_, [Error]>)> {
        self.errors.iter().flat_map(|(name, errors)| {
            let found: Vec<Error> = errors.iter().filter(|e| e.found).copied().collect();
            let some = found.len() < errors.len() && !found.is_empty();
            let all = ((*name).to_owned(), Cow::Borrowed(errors.as_slice()));
            [Some(all), some.then(|| (format!("{name} found"), Cow::Owned(found)))].into_iter().flatten()
        })
    }

    /// Share of touched samples that were taken for untouched; `None` where the question never arose.
    #[must_use]
    pub fn missed(&self) -> Option<f64> {
        (self.touched > 0).then(|| self.missed as f64 / self.touched as f64)
    }

    /// Share of untouched samples that were taken for touched; `None` where the question never arose.
    #[must_use]
    pub fn false_contacts(&self) -> Option<f64> {
        (self.untouched > 0).then(|| self.false_contacts as f64 / self.untouched as f64)
    }
}

#[cfg(test)]
mod tests;
