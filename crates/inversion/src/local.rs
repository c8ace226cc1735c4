//! The search for contacts where each place has a pattern of its own.
//!
//! Problem: a skin with very many elements tells every place from every other, and a contact is found as soon as somebody knows roughly where
//! it is. To look for other locations that explain the same readings, as a skin of few elements needs, is then most of the time of a frame.
//! Method: least squares from where contacts are supposed to be; what leaves no more than noise does is the answer. Where nothing does, contacts
//! are looked for everywhere (`inverter/pursuit.rs`). Those that the readings do without are dropped: Wald's statistic (A. Wald, *Trans. Am. Math.
//! Soc.* 54 (1943) 426) says which may be, and the ratio of likelihoods whether, for the statistic falls where a force is hardly known, however
//! much it explains (W. W. Hauck and A. Donner, *J. Am. Stat. Assoc.* 72 (1977) 851). That a minimum leaves no more than noise in all readings
//! together says little of the few that one contact changes: what stands out of the rest is taken in all the same, and the readings beneath a contact
//! are judged by themselves (`inverter/nearby.rs`). Assumptions: as the [search's](crate::Inverter), and a minimum that explains the readings
//! there is the only one. Cost: one minimisation and a product with the dictionary where somebody knows; some hundred minimisations of one
//! contact where nobody does.

use dermis_model::{Indentation, Unknown};

use crate::contact::{ContactEstimate, Reading, Solution};
use crate::fit::{Datum, Minimum, Problem};
use crate::inverter::Inverter;
use crate::settings::InverterError;

/// Share of the highest peak's gain from which on a search may begin at others: lower ones are what the highest leaves of itself.
const TOGETHER: f64 = 0.3;
/// Deviations of its expectation up to which a sum of squared deviations is what noise leaves: noise alone begins one search of a thousand
/// anew, which takes longer than the others.
pub(crate) const PLAUSIBLE: f64 = 3.0;
/// What the zero adds to the variance of a reading, as a share: it is the mean of some twenty untouched ones (half a second at 40 frames a
/// second). Of 1500 readings that is more than the noise of their sum.
pub(crate) const ZERO: f64 = 0.05;

/// What least squares begun at given contacts came to.
enum LocalFit {
    /// Contacts that explain the readings.
    Explains(Minimum),
    /// The best of those that do not explain them; `None` where no contacts were given.
    Fails(Option<Minimum>),
}

impl Inverter {
    /// The contacts that explain `readings` best, near those of the frame `before` or those that somebody else supposes where these explain
    /// the readings, and wherever they are otherwise.
    ///
    /// # Errors
    ///
    /// [`InverterError::Channels`] for readings of another skin.
    pub fn search_near(
        &self,
        readings: &[Reading],
        before: &[ContactEstimate],
        starts: &[Indentation],
    ) -> Result<Solution, InverterError> {
        self.check(readings)?;
        let data = self.data(readings);
        let problem = self.problem(&data);
        let most = self.most(&data);
        let best = match self.fit_locally(&problem, &data, before, starts)? {
            LocalFit::Explains(minimum) => self.complete(&problem, &data, minimum, most)?,
            LocalFit::Fails(best) => {
                // Contacts that lie wrong would be in the way of those that are there.
                let found = self.pursue(&problem, &data, most)?;
                match best {
                    Some(best) if self.cost(&best) <= self.cost(&found) && self.apart(&best) => {
                        self.complete(&problem, &data, best, most)?
                    }
                    _ => found,
                }
            }
        };
        Ok(self.solution(&self.with_best_tip(&data, best)?, &data))
    }

    /// What [`search_near`](Self::search_near) finds near the contacts that it is given, if that explains the readings; `None` where it has to
    /// look elsewhere, which takes many times as long.
    ///
    /// # Errors
    ///
    /// [`InverterError::Channels`] for readings of another skin.
    pub fn follow_near(
        &self,
        readings: &[Reading],
        before: &[ContactEstimate],
        starts: &[Indentation],
    ) -> Result<Option<Solution>, InverterError> {
        self.check(readings)?;
        let data = self.data(readings);
        let problem = self.problem(&data);
        let LocalFit::Explains(minimum) = self.fit_locally(&problem, &data, before, starts)? else {
            return Ok(None);
        };
        let room = self.most(&data).saturating_sub(minimum.contacts.len()).min(1);
        let further = self.peaks_left(&data, &minimum, room, self.settings().evidence);
        if !further.is_empty() || !self.fits_beneath(&data, &minimum)? {
            return Ok(None);
        }
        Ok(Some(self.solution(&self.with_best_tip(&data, minimum)?, &data)))
    }

    /// Least squares begun at the contacts of the frame `before`, then at `starts`, until one explains the readings.
    fn fit_locally(
        &self,
        problem: &Problem<'_>,
        data: &[Datum],
        before: &[ContactEstimate],
        starts: &[Indentation],
    ) -> Result<LocalFit, InverterError> {
        let last = self.settings().indentations(before);
        let most = self.most(data);
        let mut best: Option<Minimum> = None;
        for start in [last.as_slice(), starts].into_iter().filter(|s| (1..=most).contains(&s.len())) {
            let minimum = self.without_idle(problem, problem.minimise(start.to_vec())?)?;
            if self.explains(&minimum, data) && self.apart(&minimum) {
                return Ok(LocalFit::Explains(minimum));
            }
            if best.as_ref().is_none_or(|best| self.cost(&minimum) < self.cost(best)) {
                best = Some(minimum);
            }
        }
        Ok(LocalFit::Fails(best))
    }

    /// Drops contacts that the readings do without, and one of two that have run into each other.
    pub(crate) fn without_idle(
        &self,
        problem: &Problem<'_>,
        mut minimum: Minimum,
    ) -> Result<Minimum, InverterError> {
        while minimum.contacts.len() > 1 {
            let gains: Vec<f64> = (0..minimum.contacts.len()).map(|i| self.gain(&minimum, i)).collect();
            let Some(weakest) = (0..gains.len()).min_by(|a, b| gains[*a].total_cmp(&gains[*b])) else {
                break;
            };
            let apart = self.apart(&minimum);
            if gains[weakest] >= self.settings().evidence && apart {
                break;
            }
            let mut fewer = minimum.contacts.clone();
            fewer.remove(weakest);
            let fewer = problem.minimise(fewer)?;
            if apart && self.cost(&fewer) > self.cost(&minimum) {
                break;
            }
            minimum = fewer;
        }
        Ok(minimum)
    }

    /// By how much the sum of squared deviations would rise without a contact, to second order: Wald's statistic of its force. 0 where the
    /// readings do not fix it.
    fn gain(&self, minimum: &Minimum, contact: usize) -> f64 {
        let list = self.settings().unknowns.list();
        let Some(covariance) = &minimum.covariance else { return 0.0 };
        let forces: Vec<usize> = list
            .iter()
            .enumerate()
            .filter(|(_, unknown)| !matches!(unknown, Unknown::Along(_)))
            .map(|(k, _)| contact * list.len() + k)
            .collect();
        let Indentation { position, force, .. } = &minimum.contacts[contact];
        let (_, normal) = self.surface().project(position);
        let axes = dermis_model::tangents(&normal);
        let value = |unknown: &Unknown| match unknown {
            Unknown::Shear(k) => force.dot(&axes[*k]),
            _ => -force.dot(&normal),
        };
        let values = nalgebra::DVector::from_iterator(
            forces.len(),
            list.iter().filter(|unknown| !matches!(unknown, Unknown::Along(_))).map(value),
        );
        let block = covariance.select_rows(&forces).select_columns(&forces);
        block.cholesky().map_or(0.0, |factor| values.dot(&factor.solve(&values)))
    }

    pub(crate) fn explains(&self, minimum: &Minimum, data: &[Datum]) -> bool {
        let unknowns = minimum.contacts.len() * self.settings().unknowns.count();
        let freedom = crate::inverter::counted(data).saturating_sub(unknowns) as f64;
        minimum.chi2 < (1.0 + ZERO) * (freedom + PLAUSIBLE * (2.0 * freedom).sqrt())
    }

    /// What a minimum leaves, and what its contacts must gain.
    pub(crate) fn cost(&self, minimum: &Minimum) -> f64 {
        minimum.chi2 + self.settings().evidence * minimum.contacts.len() as f64
    }

    /// Presses at the locations of the dictionary that explain what `best` leaves, each better than its neighbours do, by `least` or more, and not
    /// much worse than the best of them.
    pub(crate) fn peaks_left(
        &self,
        data: &[Datum],
        best: &Minimum,
        room: usize,
        least: f64,
    ) -> Vec<Indentation> {
        let left = crate::inverter::residuals(data, &best.signal);
        let dictionary = self.dictionary();
        let scores: Vec<f32> = dictionary.explained(&left).collect();
        let mut peaks: Vec<usize> = (0..scores.len())
            .filter(|i| dictionary.neighbours(*i).iter().all(|other| scores[*other] <= scores[*i]))
            .filter(|i| {
                let at = dictionary.locations[*i].position;
                let near = |c: &Indentation| (c.position - at).norm() < self.settings().distance;
                !best.contacts.iter().any(near)
            })
            .collect();
        peaks.sort_by(|a, b| scores[*b].total_cmp(&scores[*a]));
        let highest = peaks.first().map_or(0.0, |first| f64::from(scores[*first]).powi(2));
        let stands_out = |gain: f64| gain > least && gain >= TOGETHER * highest;
        let mut chosen: Vec<Indentation> = Vec::new();
        for index in peaks {
            let at = dictionary.locations[index].position;
            if chosen.len() == room || !stands_out(f64::from(scores[index]).powi(2)) {
                break;
            }
            if chosen.iter().all(|c| (c.position - at).norm() >= self.settings().distance) {
                chosen.push(self.pressed(index, &left));
            }
        }
        chosen
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::testing::{grid, press, random, read};
    use crate::{Search, Settings};

    fn inverter() -> (Inverter, Arc<dermis_fixtures::Analytic>) {
        let model = Arc::new(grid(20.0));
        let mut settings = Settings::new(0.004, 2.0);
        (settings.contacts, settings.distance, settings.search) = (3, 0.004, Search::Near);
        (Inverter::new(Arc::clone(&model) as _, settings).unwrap(), model)
    }

    fn matches(solution: &Solution, truth: &[Indentation]) {
        assert_eq!(solution.contacts.len(), truth.len(), "{solution:?}");
        for truth in truth {
            let near = |c: &&ContactEstimate| (c.position - truth.position).norm() < 2e-4;
            let found = solution.contacts.iter().find(near).unwrap_or_else(|| panic!("{solution:?}"));
            assert!((found.force - truth.force).norm() < 0.02, "{found:?}");
        }
    }

    #[test]
    fn contacts_are_found_wherever_they_were_supposed() {
        let (inverter, model) = inverter();
        let truth = [press(0.008, 0.006, 1.0), press(-0.009, -0.004, 0.6)];
        for truth in [&truth[..1], &truth[..]] {
            let readings = read(&model, truth, &mut random(1));
            let nowhere = inverter.search_near(&readings, &[], &[]).unwrap();
            matches(&nowhere, truth);
            let near = inverter.search_near(&readings, &[], &[press(0.007, 0.005, 0.5)]).unwrap();
            matches(&near, truth);
            let unknown = inverter.follow_near(&readings, &[], &[]).unwrap();
            assert_eq!(unknown, None);
            let followed = inverter.follow_near(&readings, &nowhere.contacts, &[]).unwrap();
            matches(&followed.unwrap(), truth);
            let wrong = inverter.search_near(&readings, &[], &[press(-0.001, 0.002, 0.5)]).unwrap();
            matches(&wrong, truth);
            matches(&inverter.search_near(&readings, &nowhere.contacts, &[]).unwrap(), truth);
        }
    }

    /// What a light press leaves open of its shear is what was expected of it, and no more.
    #[test]
    fn shear_that_readings_hardly_tell_stays_what_is_expected() {
        let (inverter, model) = inverter();
        let mut settings =
            Settings { unknowns: dermis_model::Unknowns::Full, contacts: 1, ..inverter.settings().clone() };
        let readings = read(&model, &[press(0.002, 0.001, 0.03)], &mut random(4));
        let shear = |settings: &Settings| {
            let inverter = Inverter::new(Arc::clone(&model) as _, settings.clone()).unwrap();
            let found = inverter.search_near(&readings, &[], &[]).unwrap().contacts.remove(0);
            let off = found.force_covariance[(0, 0)].max(found.force_covariance[(1, 1)]).sqrt();
            (found.force.xy().norm() / -found.force.z, off / -found.force.z)
        };
        let (any, open) = shear(&settings);
        settings.shear = Some(0.1);
        let (expected, known) = shear(&settings);
        assert!(open > 0.35, "without it, readings leave {open} open");
        assert!(expected <= any.min(0.3) && known < 0.15, "{expected} of {any}, {known} of {open}");
        settings.shear = Some(0.0);
        assert!(Inverter::new(model, settings).unwrap_err().to_string().contains("shear"));
    }

    /// Of a strong press with shear, the nearest place of the dictionary leaves far more than noise.
    #[test]
    fn a_strong_contact_counts_whatever_a_place_leaves_of_it() {
        let (near, model) = inverter();
        let mut truth = press(0.0064, 0.0041, 1.8);
        truth.force.x = 0.8;
        let readings = read(&model, &[truth], &mut random(5));
        let settings = Settings { search: Search::Greedy, ..near.settings().clone() };
        let greedy = Inverter::new(model, settings).unwrap();
        let [by_place, by_share] = [&greedy, &near].map(|inverter| inverter.evidence(&readings));
        assert!(by_place.1 > 2.0 && !greedy.settings().exceeds_threshold(by_place, false), "{by_place:?}");
        assert!(near.settings().exceeds_threshold(by_share, false), "{by_share:?}");
    }

    /// One of two has gone: the one that stays is all that is left.
    #[test]
    fn a_contact_that_has_ended_is_dropped() {
        let (inverter, model) = inverter();
        let both = [press(0.008, 0.006, 1.0), press(-0.009, -0.004, 0.6)];
        let before = inverter.search_near(&read(&model, &both, &mut random(2)), &[], &[]).unwrap();
        assert_eq!(before.contacts.len(), 2);
        let readings = read(&model, &both[..1], &mut random(3));
        matches(&inverter.search_near(&readings, &before.contacts, &[]).unwrap(), &both[..1]);
        assert!(inverter.search_near(&[Reading::Exact(0.0); 3], &[], &[]).is_err());
    }
}
