//! Searches that begin at contacts that are supposed, or at all pairs of locations.
//!
//! Problem: where elements are few and each responds to half of a surface, the best single contact may be none of two, and several pairs may
//! read alike. Method: least squares from the best pairs of locations, as signals of single presses add up, then from what the best of their
//! minima becomes with one contact elsewhere (orthogonal matching pursuit with replacement: P. Jain, A. Tewari and I. S. Dhillon, *Adv. Neural
//! Inf. Process. Syst.* 24 (2011)). All minima count ([`Inverter::weighted`]). `cargo xtask measure doubles` says how often the right ones are
//! found and whether errors are as stated. Assumptions: as the search's. Cost: about ten milliseconds on the limb.

use dermis_model::Indentation;

use super::misfit::left;
use super::modes::Mode;
use super::starts::{APART, Start};
use super::{Inverter, counted, plausible};
use crate::contact::{Reading, Solution};
use crate::fit::{Datum, Minimum, Problem};
use crate::settings::InverterError;

/// Pairs of locations, and single ones, that a search begins at.
const PAIRS: usize = 5;
/// Further pairs that it begins at where noise explains none of the minima so far.
const MORE_PAIRS: usize = 20;
/// Other locations that each contact of the best minimum is tried at.
const REPLACEMENTS: usize = 8;
/// Times that this is repeated at most, from a better minimum each.
const ROUNDS: usize = 4;

impl Inverter {
    /// The contacts near `starts` that explain `readings` best, refined together. The weakest is dropped for as long as what
    /// remains explains the readings about as well ([`Settings::evidence`](crate::Settings::evidence)), and where two have run into one another.
    ///
    /// # Errors
    ///
    /// [`InverterError::Channels`] for readings of another skin.
    pub fn refine(&self, readings: &[Reading], starts: &[Indentation]) -> Result<Solution, InverterError> {
        self.check(readings)?;
        let data = self.data(readings);
        let best = self.refined(&self.problem(&data), &data, starts.to_vec())?;
        Ok(self.solution(&best, &data))
    }

    /// The same as a minimum of `problem`.
    pub(super) fn refined(
        &self,
        problem: &Problem<'_>,
        data: &[Datum],
        mut starts: Vec<Indentation>,
    ) -> Result<Minimum, InverterError> {
        starts.sort_by(|a, b| b.force.norm().total_cmp(&a.force.norm()));
        starts.truncate(self.most(data));
        let mut best = problem.minimise(starts)?;
        let error = self.misfit(&best, data);
        while best.contacts.len() > 1 {
            let weakest = (0..best.contacts.len())
                .min_by(|a, b| best.contacts[*a].force.norm().total_cmp(&best.contacts[*b].force.norm()));
            let mut fewer = best.contacts.clone();
            weakest.map(|i| fewer.remove(i));
            let fewer = problem.minimise(fewer)?;
            // Each contact less leaves about as many units more to noise as it had unknowns.
            let explained = left(&fewer, data, error) - left(&best, data, error);
            if explained >= self.settings.evidence && self.apart(&best) {
                break;
            }
            best = fewer;
        }
        Ok(best)
    }

    /// As [`solve`](Self::solve), but looks for two contacts among all pairs of locations, not for the second beside the first:
    /// where elements are few and each responds to half of the surface, the best single contact may be none of the two. Takes about ten
    /// milliseconds.
    ///
    /// # Errors
    ///
    /// [`InverterError::Channels`] for readings of another skin.
    pub fn search(&self, readings: &[Reading]) -> Result<Solution, InverterError> {
        self.check(readings)?;
        let data = self.data(readings);
        let problem = self.problem(&data);
        let counted = counted(&data);
        let s = &self.settings;
        let most = self.most(&data);
        let untouched = vec![0.0; data.len()];
        let mut single: Vec<Minimum> = Vec::new();
        for start in self.matches(&data, &untouched, PAIRS, APART) {
            self.add(&mut single, problem.minimise(vec![start])?);
        }
        let mut modes = self.weighted(single, &data);
        let Some(mut best) = modes.first().map(|mode| mode.minimum.clone()) else {
            return self.solve(readings, None);
        };
        let mut fewer: Vec<Minimum> = Vec::new();
        for contacts in 2..=most {
            let freedom = counted.saturating_sub(contacts * s.unknowns.count());
            if best.chi2 - (freedom as f64) < s.evidence {
                break;
            }
            let several = self.more(&problem, &best)?;
            match several.first().map(|mode| mode.minimum.clone()) {
                Some(found) if best.chi2 - found.chi2 >= s.evidence => {
                    fewer.push(std::mem::replace(&mut best, found));
                    modes.extend(several);
                }
                _ => break,
            }
        }
        Ok(self.among(&self.worth(best, fewer, &data), &modes, &data))
    }

    /// Minima of one contact more than `best` has, the likeliest first.
    fn more(&self, problem: &Problem<'_>, best: &Minimum) -> Result<Vec<Mode>, InverterError> {
        let s = &self.settings;
        let contacts = best.contacts.len() + 1;
        let explained = plausible(counted(problem.data).saturating_sub(contacts * s.unknowns.count()));
        let mut starts: Vec<Vec<Indentation>> = Vec::new();
        // Pairs are added up of locations that were pressed alone: only a medium that does so can be searched by them.
        if contacts == 2 && self.model.0.superposes() {
            let bounds = (s.distance, s.force_max * 1.2, s.diameter);
            let pairs = self.pairs.best(&self.dictionary, problem.data, bounds, PAIRS + MORE_PAIRS);
            let tip = |c: Indentation| s.indentation(c.position, c.force);
            starts.extend(pairs.into_iter().map(|pair| pair.map(tip).to_vec()));
        }
        let farther = starts.split_off(PAIRS.min(starts.len()));
        for kind in [Start::Dictionary, Start::Split] {
            starts.extend(self.starts(kind, problem.data, best));
        }
        let first = starts.len();
        let mut minima: Vec<Minimum> = Vec::new();
        for (n, start) in starts.into_iter().chain(farther).enumerate() {
            if n >= first && least(&minima) < explained {
                break;
            }
            self.add(&mut minima, problem.minimise(start)?);
        }
        for _ in 0..ROUNDS {
            let before = least(&minima);
            self.replace(problem, &mut minima)?;
            let now = least(&minima);
            if now < explained || before - now < s.evidence {
                break;
            }
        }
        Ok(self.weighted(minima, problem.data))
    }

    /// Adds the minima that are reached from the best with one of its contacts elsewhere. Pairs of single presses do not lead to all of them: a
    /// step may end at an edge of the surface.
    fn replace(&self, problem: &Problem<'_>, minima: &mut Vec<Minimum>) -> Result<(), InverterError> {
        let best = minima.iter().min_by(|a, b| self.score(a).total_cmp(&self.score(b)));
        let Some(contacts) = best.map(|best| best.contacts.clone()) else { return Ok(()) };
        let mut signal = vec![0.0; problem.data.len()];
        for i in 0..contacts.len() {
            let mut others = contacts.clone();
            others.remove(i);
            problem.signal(&others, &mut signal)?;
            for other in self.matches(problem.data, &signal, REPLACEMENTS, APART) {
                let start = others.iter().cloned().chain([other]).collect();
                self.add(minima, problem.minimise(start)?);
            }
        }
        Ok(())
    }

    /// As [`search`](Self::search), begun at contacts that somebody else supposes: where these, refined together, leave no more than
    /// noise does, that is the answer, in a fraction of the time of a search. Otherwise what a search finds is the answer where it
    /// explains the readings better, each further contact by more than [`Settings::evidence`](crate::Settings::evidence).
    ///
    /// # Errors
    ///
    /// [`InverterError::Channels`] for readings of another skin.
    pub fn search_from(
        &self,
        readings: &[Reading],
        starts: &[Indentation],
    ) -> Result<Solution, InverterError> {
        if starts.is_empty() {
            return self.search(readings);
        }
        let refined = self.refine(readings, starts)?;
        if refined.chi2 < plausible(refined.freedom) {
            return Ok(refined);
        }
        let found = self.search(readings)?;
        let cost = |s: &Solution| s.chi2 + self.settings.evidence * s.contacts.len() as f64;
        Ok(if cost(&refined) < cost(&found) { refined } else { found })
    }
}

/// Least sum of squared deviations that one of the minima leaves.
fn least(minima: &[Minimum]) -> f64 {
    minima.iter().map(|m| m.chi2).fold(f64::INFINITY, f64::min)
}
