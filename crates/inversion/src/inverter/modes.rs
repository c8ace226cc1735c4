//! Minima: which contacts, as many in each, explain the readings, and how likely each minimum is.
//!
//! Problem: few elements that each respond to half of a surface can read nearly the same for touches far apart. Least squares then has
//! several minima, and a search that stops at the first plausible one is wrong by centimetres. Method: the locations of the dictionary
//! that may hold a minimum are all refined; each minimum has the evidence of its Laplace approximation, √det C · exp(−χ²/2) times the
//! prior of its forces (D. J. C. MacKay, *Neural Comput.* 4 (1992) 415, eq. 4.1). The answer is their mean, which has the least expected
//! square of the error (S. M. Kay, *Fundamentals of Statistical Signal Processing* I, 10.3). A place may hold a minimum where it explains
//! the readings better than its neighbours do, and where what it leaves is no more than noise and the pitch of the dictionary leave. Where
//! the best minimum leaves more than noise, χ² is in units of what it leaves ([`Inverter::excess`]). Of several contacts, each is the mean of
//! those that are next to it in the minima, none of them next to two (linear assignment). Minima of several are those that a search of all
//! pairs of locations ended in.
//! Assumptions: as the search's; minima are Gaussian and apart. Cost: one product with the dictionary, and a minimisation for each candidate.

use dermis_model::{Indentation, Unknown, Unknowns};
use dermis_skin::assign;
use nalgebra::{Matrix3, Point3, Vector3};

use super::misfit::{GROWN, left};
use super::{Inverter, PLAUSIBLE, counted, plausible, residuals};
use crate::contact::{ContactEstimate, Reading, Solution};
use crate::fit::{Datum, Minimum, Problem, sum_of_squares};
use crate::settings::InverterError;

/// Peaks of the dictionary that are refined at most.
const PEAKS: usize = 6;
/// Further locations that are refined, each the best that is far from all minima so far.
const FARTHER: usize = 4;
/// \[spacings\] that is far.
const APART: f64 = 2.0;
/// Locations that are tried besides where none of the minima explains the readings.
const RESTARTS: usize = 12;
/// Locations that are ranked.
const RANKED: usize = 200;
/// Share of the evidence from which on a minimum stands for all.
const CERTAIN: f64 = 0.99;
/// Share of the evidence down to which a minimum is followed from frame to frame.
const UNLIKELY: f64 = 1e-3;
/// Factor by which a force has changed when minima are looked for anew: the noise hides others beside half of it, or no longer beside twice.
const CHANGED: f64 = 2.0;

/// A minimum, among others of as many contacts.
pub(super) struct Mode {
    pub minimum: Minimum,
    /// Share of the evidence of all minima.
    pub share: f64,
}

impl Inverter {
    /// Minima of one contact that explain `data`, the likeliest first; `hint` is a further place to begin at.
    pub(super) fn modes(
        &self,
        problem: &Problem<'_>,
        data: &[Datum],
        hint: Option<&Indentation>,
    ) -> Result<Vec<Mode>, InverterError> {
        let left = residuals(data, &vec![0.0; data.len()]);
        let scores: Vec<f32> = self.dictionary.project(&left).collect();
        let limits = self.limits(data);
        let mut minima: Vec<Minimum> = Vec::new();
        if let Some(hint) = hint {
            let mut start = hint.clone();
            start.position.y = self.line.unwrap_or(start.position.y);
            self.add(&mut minima, problem.minimise(vec![start])?);
        }
        let mut tried = self.peaks(&scores, &limits);
        for index in &tried {
            // From beside a minimum that explains the readings the search ends in it once more.
            let location = self.dictionary.locations[*index].position;
            let explains = |m: &Minimum| m.chi2 < limits.noise && self.is_at(m, location);
            if !minima.iter().any(explains) {
                self.add(&mut minima, problem.minimise(vec![self.pressed(*index, &left)])?);
            }
        }
        let ranked = self.ranked(&scores, &limits, data);
        for _ in 0..FARTHER {
            let Some(index) = self.farther(&ranked, &limits, &tried, &minima) else { break };
            tried.push(index);
            self.add(&mut minima, problem.minimise(vec![self.pressed(index, &left)])?);
        }
        // A minimum that noise does not explain lies at an edge that the true place is beyond of: begin all about.
        for (_, index) in ranked.iter().filter(|(_, index)| !tried.contains(index)).take(RESTARTS) {
            if minima.iter().any(|m| m.chi2 < limits.noise) {
                break;
            }
            self.add(&mut minima, problem.minimise(vec![self.pressed(*index, &left)])?);
        }
        Ok(self.weighted(minima, data))
    }

    /// Minima with their shares of the evidence, the likeliest first.
    pub(super) fn weighted(&self, minima: Vec<Minimum>, data: &[Datum]) -> Vec<Mode> {
        let best = minima.iter().min_by(|a, b| a.chi2.total_cmp(&b.chi2));
        let excess = best.map_or(1.0, |best| self.excess(best, data));
        let evidence: Vec<f64> = minima.iter().map(|m| self.log_evidence(m, excess)).collect();
        let most = evidence.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let mut modes: Vec<Mode> = minima
            .into_iter()
            .zip(evidence)
            .map(|(minimum, e)| Mode { minimum, share: if e.is_finite() { (e - most).exp() } else { 0.0 } })
            .collect();
        let total: f64 = modes.iter().map(|m| m.share).sum();
        if total > 0.0 {
            modes.iter_mut().for_each(|m| m.share /= total);
        }
        modes.sort_by(|a, b| {
            b.share.total_cmp(&a.share).then(self.score(&a.minimum).total_cmp(&self.score(&b.minimum)))
        });
        modes
    }

    /// The contacts that explain these readings, near the `minima` that a search of an earlier frame has found
    /// ([`Solution::minima`]): what [`solve`](Self::solve) and [`search`](Self::search) find, in a fraction of their time, for as long as the
    /// same contacts last and no other minimum comes up. `None` where none of the minima explains the readings or, of several contacts or
    /// where several are looked for, where fewer would do or locations are all but open. Then search anew; and where
    /// [`has_moved`](Self::has_moved) says so.
    ///
    /// `misfit` is what that search left ([`Solution::misfit`]): no search explains more of a device that differs from its model, so that
    /// minima that leave about as much explain the readings, too.
    ///
    /// # Errors
    ///
    /// [`InverterError::Channels`] for readings of another skin.
    pub fn follow(
        &self,
        readings: &[Reading],
        minima: &[Vec<ContactEstimate>],
        misfit: f64,
    ) -> Result<Option<Solution>, InverterError> {
        self.check(readings)?;
        let s = &self.settings;
        let data = self.data(readings);
        let Some(likeliest) = minima.first().filter(|m| !m.is_empty() && m.len() <= s.contacts) else {
            return Ok(None);
        };
        let Some(freedom) = counted(&data).checked_sub(s.unknowns.count() * likeliest.len()) else {
            return Ok(None);
        };
        // Where only one contact is looked for, no other number would explain the readings better.
        let is_open =
            |contacts: &[ContactEstimate]| s.contacts > 1 && contacts.iter().any(|c| self.is_broad(c));
        if is_open(likeliest) {
            return Ok(None);
        }
        let problem = self.problem(&data);
        let mut found = Vec::new();
        for contacts in minima.iter().filter(|m| m.len() == likeliest.len()) {
            self.add(&mut found, problem.minimise(s.indentations(contacts))?);
        }
        let modes = self.weighted(found, &data);
        let explains = |m: &&Mode| left(&m.minimum, &data, GROWN * misfit) <= plausible(freedom);
        let Some(best) = modes.first().filter(explains).map(|mode| &mode.minimum) else { return Ok(None) };
        let error = self.misfit(best, &data);
        // Any of them may have ended, not the weakest alone.
        for i in 0..if best.contacts.len() > 1 { best.contacts.len() } else { 0 } {
            let mut fewer = best.contacts.clone();
            fewer.remove(i);
            if left(&problem.minimise(fewer)?, &data, error) - left(best, &data, error) < s.evidence {
                return Ok(None);
            }
        }
        let solution = self.among(best, &modes, &data);
        Ok((!solution.minima.first().is_some_and(|contacts| is_open(contacts))).then_some(solution))
    }

    /// Whether none of the minima `now` is where a search found the likeliest: contacts are that far from there, or press so much harder or less,
    /// that other minima may have come up. What noise makes of them does not count.
    #[must_use]
    pub fn has_moved(&self, searched: &[ContactEstimate], now: &[Vec<ContactEstimate>]) -> bool {
        let stays = |was: &ContactEstimate, is: &ContactEstimate| {
            let (ratio, noise) =
                (is.force.norm() / was.force.norm().max(1e-9), was.force_covariance.trace().max(0.0).sqrt());
            (is.position - was.position).norm() <= self.spacing.max(PLAUSIBLE * was.deviation())
                && ((1.0 / CHANGED..=CHANGED).contains(&ratio)
                    || (is.force - was.force).norm() <= PLAUSIBLE * noise)
        };
        let is_there = |contacts: &Vec<ContactEstimate>| {
            contacts.len() == searched.len()
                && searched.iter().all(|was| contacts.iter().any(|is| stays(was, is)))
        };
        !now.iter().any(is_there)
    }

    /// What `best` says, one of `modes` where these are of as many contacts.
    pub(super) fn among(&self, best: &Minimum, modes: &[Mode], data: &[Datum]) -> Solution {
        let mut solution = self.solution(best, data);
        let number = solution.contacts.len();
        let alike = modes.iter().filter(|mode| mode.minimum.contacts.len() == number && number > 0);
        let minima: Vec<(Vec<ContactEstimate>, f64)> =
            alike.map(|mode| (self.describe(&mode.minimum, data), mode.share)).collect();
        let mut of_each: Vec<Vec<(ContactEstimate, f64)>> = vec![Vec::new(); number];
        for (contacts, share) in &minima {
            let away = |i: usize, k: usize| (solution.contacts[i].position - contacts[k].position).norm();
            for (of_one, k) in of_each.iter_mut().zip(assign(number, number, away)) {
                of_one.extend(k.map(|k| (contacts[k].clone(), *share)));
            }
        }
        for (contact, minima) in solution.contacts.iter_mut().zip(of_each) {
            // A single contact whose place is all but open has been answered over all locations.
            if number > 1 || !self.is_broad(contact) {
                self.weigh(contact, &minima);
            }
        }
        let likely = minima.into_iter().enumerate().filter(|(i, (_, share))| *i == 0 || *share > UNLIKELY);
        solution.minima = likely.map(|(_, (contacts, _))| contacts).collect();
        solution
    }

    /// Answers for all minima that may be true: with their mean, where there is a place on the surface, or with the likeliest; with the
    /// spread of all of them about it in either case.
    ///
    /// The mean has the least expected square of the error, and is what a filter takes a contact with its covariance for. Of locations on
    /// two sides of a limb it lies inside: nobody can touch that.
    fn weigh(&self, answer: &mut ContactEstimate, minima: &[(ContactEstimate, f64)]) {
        // Where the readings fix none of them, none has a share.
        if minima.first().is_none_or(|(_, share)| *share >= CERTAIN || *share <= 0.0) {
            return;
        }
        let contacts = || minima.iter().filter(|(_, share)| *share > 0.0);
        let mean = contacts().map(|(c, share)| c.position.coords * *share).sum::<Vector3<f64>>();
        let (position, normal) = self.model.0.surface().project(&Point3::from(mean));
        if (position.coords - mean).norm() < self.spacing {
            let pressing: f64 = contacts().map(|(c, share)| -c.force.dot(&c.normal) * share).sum();
            let shear = contacts().map(|(c, share)| c.force * *share).sum::<Vector3<f64>>();
            let shear = match self.settings.unknowns {
                Unknowns::Full => shear - normal * normal.dot(&shear),
                _ => Vector3::zeros(),
            };
            (answer.position, answer.normal, answer.force) = (position, normal, shear - normal * pressing);
        }
        let (mut location, mut force) = (Matrix3::zeros(), Matrix3::zeros());
        for (contact, share) in contacts() {
            let (by, more) = (contact.position - answer.position, contact.force - answer.force);
            // As in the evidence: a minimum answers for its own surroundings only.
            let own = (APART * self.spacing / contact.deviation()).min(1.0).powi(2);
            location += (contact.position_covariance * own + by * by.transpose()) * *share;
            force += (contact.force_covariance * own + more * more.transpose()) * *share;
        }
        (answer.position_covariance, answer.force_covariance) = (location, force);
    }

    /// Takes a minimum in, unless contacts have run into one another; two starts that end in one place are one minimum.
    pub(super) fn add(&self, minima: &mut Vec<Minimum>, found: Minimum) {
        if found.contacts.is_empty() || !self.apart(&found) {
            return;
        }
        let covers = |m: &Minimum, other: &Minimum| other.contacts.iter().all(|c| self.is_at(m, c.position));
        let same = |m: &&mut Minimum| covers(m, &found) && covers(&found, m);
        match minima.iter_mut().find(same) {
            Some(other) if self.score(&found) < self.score(other) => *other = found,
            Some(_) => {}
            None => minima.push(found),
        }
    }

    /// Whether a minimum lies at a place, as far as the dictionary tells locations apart.
    fn is_at(&self, minimum: &Minimum, location: Point3<f64>) -> bool {
        minimum.contacts.iter().any(|c| (c.position - location).norm() < self.spacing)
    }

    fn limits(&self, data: &[Datum]) -> Limits {
        let noise = plausible(counted(data).saturating_sub(self.settings.unknowns.count()));
        Limits { whole: sum_of_squares(data), noise }
    }

    /// Locations of the dictionary by the sum of squared deviations that a press there leaves, the best first; as many as are tried at
    /// most.
    fn ranked(&self, scores: &[f32], limits: &Limits, data: &[Datum]) -> Vec<(f64, usize)> {
        // A direction is of all channels: where some do not say what they read, it is no measure of what the others leave.
        let whole = data.iter().all(|datum| matches!(datum, Datum::Exact(..)));
        let left = |(index, score): (usize, &f32)| {
            let left = if whole { limits.left(*score) } else { self.unexplained(index, data) };
            (left, index)
        };
        let mut locations: Vec<(f64, usize)> = scores.iter().enumerate().map(left).collect();
        let few = RANKED.min(locations.len());
        if few > 0 && few < locations.len() {
            locations.select_nth_unstable_by(few - 1, |a, b| a.0.total_cmp(&b.0));
            locations.truncate(few);
        }
        locations.sort_by(|a, b| a.0.total_cmp(&b.0));
        locations
    }

    /// The best of `ranked` that may hold a minimum and is far from every place where a search began or ended.
    fn farther(
        &self,
        ranked: &[(f64, usize)],
        limits: &Limits,
        tried: &[usize],
        minima: &[Minimum],
    ) -> Option<usize> {
        let location = |index: usize| self.dictionary.locations[index].position;
        let is_far = |index: usize| {
            let begun = tried.iter().map(|other| location(*other));
            let ended = minima.iter().flat_map(|m| m.contacts.iter().map(|c| c.position));
            begun.chain(ended).all(|other| (other - location(index)).norm() > APART * self.spacing)
        };
        let mut possible = ranked.iter().filter(|(left, index)| self.is_possible(*left, *index, limits));
        possible.find(|(_, index)| is_far(*index)).map(|(_, index)| *index)
    }

    /// Whether a touch near a place of the dictionary can be what made readings of which a press at that very place leaves `left`.
    fn is_possible(&self, left: f64, index: usize, limits: &Limits) -> bool {
        left < limits.noise + self.dictionary.mismatch(index) * limits.whole
    }

    /// Least sum of squared deviations of the channels that say what they read, for a press at a place of the dictionary, whatever its
    /// force.
    fn unexplained(&self, index: usize, data: &[Datum]) -> f64 {
        let levels = (0..self.dictionary.forces.len()).map(|level| {
            let (mut dot, mut square, mut whole) = (0.0, 0.0, 0.0);
            for (value, datum) in self.dictionary.response(index, level).iter().zip(data) {
                let Datum::Exact(reading, weight) = *datum else { continue };
                let v = f64::from(*value) * weight;
                dot += v * reading * weight;
                square += v * v;
                whole += (reading * weight).powi(2);
            }
            if square > 0.0 { whole - dot.max(0.0).powi(2) / square } else { whole }
        });
        levels.fold(f64::INFINITY, f64::min)
    }

    /// Logarithm of a minimum's evidence but for a constant; −∞ where the readings do not fix it.
    ///
    /// A minimum answers for its own surroundings only, however flat it is: before the reading, its place is Gaussian with what counts
    /// as far, its forces with the largest one. Squares of deviations count as noise whose variance is `excess` times as large.
    fn log_evidence(&self, minimum: &Minimum, excess: f64) -> f64 {
        let information = minimum.covariance.as_ref().and_then(|c| (c * excess).try_inverse());
        let Some(mut information) = information else { return f64::NEG_INFINITY };
        let (far, strong) = (APART * self.spacing, self.settings.force_max);
        let of_each = self.settings.unknowns.list();
        for (k, unknown) in of_each.iter().cycle().take(information.nrows()).enumerate() {
            let scale = if matches!(unknown, Unknown::Along(_)) { far } else { strong };
            information[(k, k)] += scale.powi(-2);
        }
        let penalty = self.settings.force_prior.penalty(&minimum.contacts);
        -0.5 * (information.determinant().ln() + minimum.chi2 / excess + penalty)
    }

    /// Locations of the dictionary that may hold a minimum, the best first.
    fn peaks(&self, scores: &[f32], limits: &Limits) -> Vec<usize> {
        let mut highest: Vec<usize> = (0..scores.len())
            .filter(|i| {
                scores[*i] > 0.0 && self.dictionary.neighbours(*i).iter().all(|n| scores[*n] <= scores[*i])
            })
            .collect();
        highest.sort_by(|a, b| scores[*b].total_cmp(&scores[*a]));
        // The best is tried whatever it leaves.
        let possible = |(rank, index): &(usize, usize)| {
            *rank == 0 || self.is_possible(limits.left(scores[*index]), *index, limits)
        };
        highest.into_iter().enumerate().filter(possible).map(|(_, index)| index).take(PEAKS).collect()
    }
}

/// What the readings of one frame allow.
struct Limits {
    /// Sum of the squares of the readings.
    whole: f64,
    /// Up to where a sum of squared deviations is what noise leaves.
    noise: f64,
}

impl Limits {
    /// Sum of squared deviations that a press leaves whose direction the readings have `score` of.
    fn left(&self, score: f32) -> f64 {
        self.whole - f64::from(score).powi(2)
    }
}
