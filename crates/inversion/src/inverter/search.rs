//! Searches that begin at contacts that are supposed, at those of the frame before, or at all pairs of locations.

use dermis_model::Indentation;

use super::misfit::{GROWN, left};
use super::starts::{APART, Start};
use super::{Inverter, counted, plausible};
use crate::contact::{ContactEstimate, Reading, Solution};
use crate::fit::Minimum;
use crate::settings::InverterError;

/// Pairs of locations, and single ones, that a search begins at.
const PAIRS: usize = 5;
/// Further pairs that it begins at where noise explains none of the minima so far.
const MORE_PAIRS: usize = 20;

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
        let problem = self.problem(&data);
        let most = self.most(&data);
        let mut strongest = starts.to_vec();
        strongest.sort_by(|a, b| b.force.norm().total_cmp(&a.force.norm()));
        strongest.truncate(most);
        let mut best = problem.minimise(strongest)?;
        let error = self.misfit(&best, &data);
        while best.contacts.len() > 1 {
            let weakest = (0..best.contacts.len())
                .min_by(|a, b| best.contacts[*a].force.norm().total_cmp(&best.contacts[*b].force.norm()));
            let mut fewer = best.contacts.clone();
            weakest.map(|i| fewer.remove(i));
            let fewer = problem.minimise(fewer)?;
            // Each contact less leaves about as many units more to noise as it had unknowns.
            let explained = left(&fewer, &data, error) - left(&best, &data, error);
            if explained >= self.settings.evidence && self.apart(&best) {
                break;
            }
            best = fewer;
        }
        Ok(self.solution(&best, &data))
    }

    /// As [`solve`](Self::solve), but looks for two contacts among all pairs of locations, not for the second beside the first:
    /// where elements are few and each responds to half of the surface, the best single contact may be none of the two. Takes some
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
        let mut best: Option<Minimum> = None;
        for start in self.matches(&data, &untouched, PAIRS, APART) {
            let minimum = problem.minimise(vec![start])?;
            if best.as_ref().is_none_or(|b| self.score(&minimum) < self.score(b)) {
                best = Some(minimum);
            }
        }
        let Some(mut best) = best else { return self.solve(readings, None) };
        let mut fewer: Vec<Minimum> = Vec::new();
        for contacts in 2..=most {
            let freedom = counted.saturating_sub(contacts * s.unknowns.count());
            if best.chi2 - (freedom as f64) < s.evidence {
                break;
            }
            let mut starts: Vec<Vec<Indentation>> = Vec::new();
            // Pairs are added up of locations that were pressed alone: only a medium that does so can be searched by them.
            if contacts == 2 && self.model.0.superposes() {
                let bounds = (s.distance, s.force_max * 1.2, s.diameter);
                let pairs = self.pairs.best(&self.dictionary, &data, bounds, PAIRS + MORE_PAIRS);
                let tip = |c: Indentation| s.indentation(c.position, c.force);
                starts.extend(pairs.into_iter().map(|pair| pair.map(tip).to_vec()));
            }
            let farther = starts.split_off(PAIRS.min(starts.len()));
            for kind in [Start::Dictionary, Start::Split] {
                starts.extend(self.starts(kind, &data, &best));
            }
            let first = starts.len();
            let mut found: Option<Minimum> = None;
            for (n, start) in starts.into_iter().chain(farther).enumerate() {
                if n >= first && found.as_ref().is_some_and(|f| f.chi2 < plausible(freedom)) {
                    break;
                }
                let minimum = problem.minimise(start)?;
                let better = |f: &Minimum| self.score(&minimum) < self.score(f);
                if found.as_ref().is_none_or(better) && self.apart(&minimum) {
                    found = Some(minimum);
                }
            }
            match found {
                Some(found) if best.chi2 - found.chi2 >= s.evidence => {
                    fewer.push(std::mem::replace(&mut best, found));
                }
                _ => break,
            }
        }
        Ok(self.solution(&self.worth(best, fewer, &data), &data))
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

    /// The contacts of the frame `before`, moved to where they explain these readings best: what [`search`](Self::search) finds,
    /// in a fraction of its time, for as long as the same contacts last. `None` where that is not so: they leave more than noise
    /// leaves, and than a device that differs by `misfit` from its model, as the search left it ([`Solution::misfit`]); fewer would do; or their
    /// locations are all but open. Then search anew.
    ///
    /// # Errors
    ///
    /// [`InverterError::Channels`] for readings of another skin.
    pub fn follow(
        &self,
        readings: &[Reading],
        before: &[ContactEstimate],
        misfit: f64,
    ) -> Result<Option<Solution>, InverterError> {
        self.check(readings)?;
        let s = &self.settings;
        let data = self.data(readings);
        let counted = counted(&data);
        let Some(freedom) = counted.checked_sub(s.unknowns.count() * before.len()) else { return Ok(None) };
        if before.is_empty() || before.len() > s.contacts || before.iter().any(|f| self.is_broad(f)) {
            return Ok(None);
        }
        let problem = self.problem(&data);
        let moved = problem.minimise(s.indentations(before))?;
        if left(&moved, &data, GROWN * misfit) > plausible(freedom) || !self.apart(&moved) {
            return Ok(None);
        }
        let error = self.misfit(&moved, &data);
        // Any of them may have ended, not the weakest alone.
        for i in 0..if moved.contacts.len() > 1 { moved.contacts.len() } else { 0 } {
            let mut fewer = moved.contacts.clone();
            fewer.remove(i);
            if left(&problem.minimise(fewer)?, &data, error) - left(&moved, &data, error) < s.evidence {
                return Ok(None);
            }
        }
        let solution = self.solution(&moved, &data);
        Ok((!solution.contacts.iter().any(|f| self.is_broad(f))).then_some(solution))
    }
}
