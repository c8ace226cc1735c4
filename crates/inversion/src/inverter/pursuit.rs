//! Several contacts where each place has a pattern of its own.
//!
//! Problem: nobody knows where contacts are, nor how many. One contact alone is found from a few starts, but several at once have minima beyond
//! number. Method: contacts are taken in one after the other, the one that stands out most first (CLEAN; J. A. Högbom, *Astron. Astrophys.
//! Suppl.* 15 (1974) 417). Each is looked for by itself, in what the others leave of the readings that a contact about that place can change, and then
//! all are refined together. A contact beneath which the readings do not fit is looked for anew in the same way once the others are known
//! (RELAX; J. Li and P. Stoica, *IEEE Trans. Signal Process.* 44 (1996) 281). Two that lie close together give way to one that explains as
//! much, and contacts that the readings do without are dropped. What contacts are off, as a share of what they change, counts as noise when further ones
//! are judged: where the model does not fit, as beneath a tip of another size, a strong contact would else be mended by several that are not there.
//! A single contact is first looked for on readings whose strong ones count for less, for
//! there its minimum is wide (graduated non-convexity, A. Blake and A. Zisserman, *Visual Reconstruction*, 1987). Assumptions: a contact changes what
//! presses at places within [`REACH`] of it change, and nothing else. Cost: some ten minimisations of one contact,
//! and one of all, for each contact that is taken in; some thirty of one for each that is looked for anew.

use dermis_model::Indentation;
use nalgebra::{Point3, center};

use super::nearby::own_signal;
use super::{Inverter, counted};
use crate::fit::{Datum, Minimum, Problem};
use crate::settings::InverterError;

/// Spacings of the dictionary between a contact and the place whose pattern is most like its own, at most. On the thumb, where shear, beams beneath
/// and large forces change patterns, they were below 2 for nine presses of ten, and 3.5 for the worst of 60.
const REACH: f64 = 4.5;
/// Share of a pattern's length from which on a reading belongs to it.
const BELONGS: f32 = 0.03;
/// Rounds of taking in and looking anew, at most.
const ROUNDS: usize = 3;
/// What must be gained of the sum of squared deviations that more is tried.
const WORTH: f64 = 4.0;
/// The same as a share of what noise does not explain of that sum: where the model does not fit, everything that is tried gains a little.
const WORTH_SHARE: f64 = 0.02;
/// Share of a reading that a first fit leaves to it.
const COARSE: f64 = 0.2;
/// Peaks that a single contact is begun at, at most.
const ALONE: usize = 4;
/// Locations that a single contact is begun at besides, at most, and how many spacings of the dictionary they are apart.
const ELSEWHERE: usize = 16;
const BESIDE: f64 = 1.2;

impl Inverter {
    /// The contacts that explain `data` best, wherever they are; one at least.
    pub(crate) fn pursue(
        &self,
        problem: &Problem<'_>,
        data: &[Datum],
        most: usize,
    ) -> Result<Minimum, InverterError> {
        let single = self.settle(data, self.alone(data)?)?;
        if self.explains(&single, data) {
            return self.complete(problem, data, single, most);
        }
        if most > 1 {
            let several = self.complete(problem, data, Minimum::untouched(data), most)?;
            if self.cost(&several) <= self.cost(&single) {
                return Ok(several);
            }
        }
        let single = self.settle(data, self.elsewhere(data, single)?)?;
        self.complete(problem, data, single, most)
    }

    /// Takes in what contacts leave out, looks anew for those that do not fit, and drops those that the readings do without.
    pub(crate) fn complete(
        &self,
        problem: &Problem<'_>,
        data: &[Datum],
        minimum: Minimum,
        most: usize,
    ) -> Result<Minimum, InverterError> {
        let mut best = minimum;
        for _ in 0..ROUNDS {
            let (before, known) = (best.chi2, best.contacts.len());
            let more = self.take_in(problem, data, best.clone(), most)?;
            let grown = more.contacts.len() > known;
            let mut anew = self.look_anew(problem, data, more)?;
            if grown {
                anew = self.merge(problem, data, anew)?;
            }
            anew = self.without_idle(problem, anew)?;
            if best.contacts.is_empty() || self.cost(&anew) < self.cost(&best) {
                best = anew;
            }
            if best.chi2 > before - worth(before, data) {
                break;
            }
        }
        Ok(best)
    }

    /// Takes in contacts until none stands out of what the others leave.
    fn take_in(
        &self,
        problem: &Problem<'_>,
        data: &[Datum],
        mut best: Minimum,
        most: usize,
    ) -> Result<Minimum, InverterError> {
        while best.contacts.len() < most {
            // The first is taken in whatever it gains: the caller knows that there is a contact.
            let first = best.contacts.is_empty();
            let least = if first { 0.0 } else { self.settings().evidence };
            let doubted = self.with_misfit(problem, data, &best)?;
            let Some(peak) = self.peaks_left(&doubted, &best, 1, least).pop() else { break };
            let around = self.around(data, &best.signal, &peak.position);
            let one = self.settle(&around, self.alone(&around)?)?;
            if one.contacts.is_empty() {
                break;
            }
            let joint = problem.minimise(replaced(&best, &[], one))?;
            let known = self.problem(&doubted);
            let gained = known.chi2(&best.signal) - known.chi2(&joint.signal);
            if !first && gained <= self.settings().evidence {
                break;
            }
            best = joint;
        }
        Ok(best)
    }

    /// Looks anew for each contact beneath which the readings do not fit, the worst first, in what the others leave.
    fn look_anew(
        &self,
        problem: &Problem<'_>,
        data: &[Datum],
        mut best: Minimum,
    ) -> Result<Minimum, InverterError> {
        if best.contacts.len() < 2 {
            return self.settle(data, best);
        }
        let mut tried: Vec<Point3<f64>> = Vec::new();
        for _ in 0..2 * best.contacts.len() {
            let Some(index) = self.worst(problem, data, &best, &tried)? else { break };
            let contact = best.contacts[index].clone();
            let around = self.around(data, &signal_without(problem, &best, &[index])?, &contact.position);
            let here = self.problem(&around).minimise(vec![contact.clone()])?;
            let mut found = self.settle(&around, here)?;
            if !self.fits_beneath(&around, &found)? {
                let elsewhere = self.seek(&around)?;
                if elsewhere.chi2 < found.chi2 {
                    found = elsewhere;
                }
            }
            let joint = problem.minimise(replaced(&best, &[index], found))?;
            if self.apart(&joint) && joint.chi2 < best.chi2 - worth(best.chi2, data) {
                best = joint;
                tried.clear();
            } else {
                tried.push(contact.position);
            }
        }
        Ok(best)
    }

    /// One contact in place of two that lie within each other's reach, wherever it explains the readings as well.
    fn merge(
        &self,
        problem: &Problem<'_>,
        data: &[Datum],
        mut best: Minimum,
    ) -> Result<Minimum, InverterError> {
        let mut tried: Vec<[Point3<f64>; 2]> = Vec::new();
        while let Some([i, j]) = self.close_pair(&best, &tried) {
            let [a, b] = [i, j].map(|k| best.contacts[k].position);
            tried.push([a, b]);
            let around = self.around(data, &signal_without(problem, &best, &[i, j])?, &center(&a, &b));
            let joint = problem.minimise(replaced(&best, &[i, j], self.seek(&around)?))?;
            if self.cost(&joint) < self.cost(&best) {
                best = joint;
            }
        }
        Ok(best)
    }

    /// Two contacts within each other's reach that are not among the `tried` ones.
    fn close_pair(&self, minimum: &Minimum, tried: &[[Point3<f64>; 2]]) -> Option<[usize; 2]> {
        let place = |k: usize| minimum.contacts[k].position;
        let pairs = (0..minimum.contacts.len()).flat_map(|j| (0..j).map(move |i| [i, j]));
        let close = |[i, j]: &[usize; 2]| (place(*i) - place(*j)).norm() < REACH * self.spacing;
        pairs.filter(close).find(|[i, j]| !tried.contains(&[place(*i), place(*j)]))
    }

    /// Readings that a contact about a place can change, less what others do; nothing in place of the rest.
    fn around(&self, data: &[Datum], others: &[f64], place: &Point3<f64>) -> Vec<Datum> {
        let dictionary = self.dictionary();
        let mut seen = vec![false; data.len()];
        for (index, location) in dictionary.locations.iter().enumerate() {
            if (location.position - place).norm() < REACH * self.spacing {
                let belongs = dictionary.direction(index).iter().map(|share| share.abs() >= BELONGS);
                seen.iter_mut().zip(belongs).for_each(|(seen, belongs)| *seen |= belongs);
            }
        }
        let left = data.iter().zip(others).zip(seen);
        left.map(|((datum, other), seen)| if seen { datum.less(*other) } else { Datum::None }).collect()
    }

    /// The single contact that explains `data` best, looked for everywhere.
    fn seek(&self, data: &[Datum]) -> Result<Minimum, InverterError> {
        self.settle(data, self.elsewhere(data, self.alone(data)?)?)
    }

    /// The single contact that explains `data` best, begun at peaks of the dictionary.
    fn alone(&self, data: &[Datum]) -> Result<Minimum, InverterError> {
        let coarse = coarsened(data);
        let (problem, smooth) = (self.problem(data), self.problem(&coarse));
        let mut best = Minimum::untouched(data);
        for peak in self.peaks_left(data, &best, ALONE, 0.0) {
            let roughly = smooth.minimise(vec![peak.clone()])?;
            for start in [roughly.contacts, vec![peak]] {
                let minimum = problem.minimise(start)?;
                if best.contacts.is_empty() || minimum.chi2 < best.chi2 {
                    best = minimum;
                }
                if self.explains(&best, data) {
                    return Ok(best);
                }
            }
        }
        Ok(best)
    }

    /// A single contact that explains readings which `best` does not, begun at locations beside the peaks as well: where shear or a beam beneath
    /// moves the pattern, the true place lies on a slope of the dictionary's scores.
    fn elsewhere(&self, data: &[Datum], mut best: Minimum) -> Result<Minimum, InverterError> {
        if self.explains(&best, data) {
            return Ok(best);
        }
        let coarse = coarsened(data);
        let (problem, smooth) = (self.problem(data), self.problem(&coarse));
        for start in self.matches(data, &Minimum::untouched(data).signal, ELSEWHERE, BESIDE) {
            let roughly = smooth.minimise(vec![start])?;
            if !self.explains(&roughly, &coarse) {
                continue;
            }
            let minimum = problem.minimise(roughly.contacts)?;
            if self.cost(&minimum) < self.cost(&best) {
                best = minimum;
            }
            if self.explains(&best, data) {
                break;
            }
        }
        Ok(best)
    }
}

/// What must be gained of a sum of squared deviations that more is tried.
fn worth(chi2: f64, data: &[Datum]) -> f64 {
    WORTH.max(WORTH_SHARE * (chi2 - counted(data) as f64))
}

/// Signal of a minimum's contacts but these.
fn signal_without(
    problem: &Problem<'_>,
    minimum: &Minimum,
    but: &[usize],
) -> Result<Vec<f64>, InverterError> {
    let own = own_signal(problem, minimum, but)?;
    Ok(minimum.signal.iter().zip(&own).map(|(all, own)| all - own).collect())
}

/// A minimum's contacts, these replaced by those of another.
fn replaced(minimum: &Minimum, gone: &[usize], by: Minimum) -> Vec<Indentation> {
    let stays = minimum.contacts.iter().enumerate().filter(|(k, _)| !gone.contains(k));
    stays.map(|(_, contact)| contact.clone()).chain(by.contacts).collect()
}

/// The same readings, of which the strong ones count for less: what fits the weak ones about a contact leads to it from farther away than what
/// fits those beneath it, whose patterns change within a millimetre.
fn coarsened(data: &[Datum]) -> Vec<Datum> {
    let less = |value: f64, weight: f64| (value, 1.0 / weight.recip().hypot(COARSE * value));
    data.iter().map(|datum| datum.map(less)).collect()
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use dermis_fixtures::Analytic;
    use dermis_model::Unknowns;
    use dermis_skin::{Surface, SurfaceSpec};
    use nalgebra::Vector3;

    use super::*;
    use crate::settings::{Search, Settings};
    use crate::testing::{press, random, read};

    /// \[m\] over which a pattern fades.
    const WIDTH: f64 = 1.6e-3;

    /// 50 by 50 elements 1.2 mm apart, each of which a contact changes within some millimetres of `width` \[m\]; shear leans the pattern to one side.
    fn device(noise: f64, width: f64) -> Arc<Analytic> {
        let at = |i: usize| (i as f64 - 24.5) * 1.2e-3;
        let elements = (0..2500).map(|i| Point3::new(at(i % 50), at(i / 50), 0.0));
        let spec = SurfaceSpec::Rectangle { size: [0.060, 0.060], spacing: 0.0015 };
        Arc::new(Analytic::new(Surface::from_spec(&spec), elements, noise, move |c, element| {
            let off = (element - c.position) / width;
            // Wider than what a move along the surface changes, which shear would be taken for.
            let leans = (c.force.x * off.x + c.force.y * off.y) * (-off.norm_squared() / 8.0).exp();
            leans - c.force.z * (-off.norm_squared() / 2.0).exp()
        }))
    }

    fn skin(noise: f64, contacts: usize) -> (Inverter, Arc<Analytic>) {
        let model = device(noise, WIDTH);
        let settings = Settings {
            contacts,
            distance: 0.004,
            unknowns: Unknowns::Full,
            shear: Some(0.3),
            search: Search::Near,
            ..Settings::new(0.004, 2.0)
        };
        (Inverter::new(Arc::clone(&model) as _, settings).unwrap(), model)
    }

    fn leaning(x: f64, y: f64, newtons: f64, lean: [f64; 2]) -> Indentation {
        let mut contact = press(x, y, newtons);
        contact.force += Vector3::new(lean[0], lean[1], 0.0) * newtons;
        contact
    }

    fn minimum(inverter: &Inverter, data: &[Datum], contacts: Vec<Indentation>) -> Minimum {
        let mut signal = vec![0.0; data.len()];
        inverter.problem(data).signal(&contacts, &mut signal).unwrap();
        let left = crate::inverter::residuals(data, &signal);
        let chi2 = left.iter().map(|r| f64::from(*r).powi(2)).sum();
        Minimum { contacts, chi2, covariance: None, signal }
    }

    fn farthest(found: &[Indentation], truth: &[Indentation]) -> f64 {
        let nearest = |t: &Indentation| {
            found.iter().map(|f| (f.position - t.position).norm()).fold(f64::INFINITY, f64::min)
        };
        truth.iter().map(nearest).fold(0.0, f64::max)
    }

    /// Five at once, the strongest ten times as strong as the weakest, some of them within each other's reach.
    #[test]
    fn contacts_are_taken_in_one_after_the_other() {
        let (inverter, model) = skin(0.005, 6);
        let truth = [
            leaning(0.0011, 0.0007, 1.5, [0.3, -0.2]),
            leaning(0.0071, 0.0017, 0.3, [-0.4, 0.1]),
            leaning(-0.0123, 0.0086, 0.8, [0.0, 0.4]),
            leaning(0.0174, -0.0201, 0.15, [0.2, 0.2]),
            leaning(-0.0024, -0.0061, 0.5, [-0.1, -0.3]),
        ];
        for seed in 0..4 {
            let readings = read(&model, &truth, &mut random(seed));
            let data = inverter.data(&readings);
            let found = inverter.pursue(&inverter.problem(&data), &data, 6).unwrap();
            assert_eq!(found.contacts.len(), 5, "{:?}", found.contacts);
            // The weakest is known to less than 0.1 mm.
            assert!(farthest(&found.contacts, &truth) < 2e-4, "{:?}", found.contacts);
            let informed = inverter.problem(&data).minimise(truth.to_vec()).unwrap();
            assert!(found.chi2 < informed.chi2 + 0.1, "{} and {}", found.chi2, informed.chi2);
        }
    }

    /// A tip that is wider than the one that is looked for.
    #[test]
    fn what_does_not_fit_is_not_mended_by_contacts_that_are_not_there() {
        let (inverter, _) = skin(0.02, 6);
        for seed in 0..4 {
            let truth = [leaning(0.0011, 0.0007, 1.2, [0.2, -0.1])];
            let readings = read(&device(0.02, 1.1 * WIDTH), &truth, &mut random(seed));
            let data = inverter.data(&readings);
            let found = inverter.pursue(&inverter.problem(&data), &data, 6).unwrap();
            assert!(!inverter.fits_beneath(&data, &found).unwrap());
            assert_eq!(found.contacts.len(), 1, "{:?}", found.contacts);
            assert!(farthest(&found.contacts, &truth) < 3e-4, "{:?}", found.contacts);
        }
    }

    /// Of three contacts one was taken for a light one far away from it, whose pattern is in nobody's way.
    #[test]
    fn what_does_not_fit_is_looked_for_anew() {
        let (inverter, model) = skin(0.02, 3);
        let truth = [press(0.012, 0.004, 1.0), press(-0.011, 0.0063, 0.7), press(0.0031, -0.0148, 0.4)];
        let readings = read(&model, &truth, &mut random(11));
        let data = inverter.data(&readings);
        let wrong = vec![truth[0].clone(), press(-0.0063, 0.0063, 0.5), truth[2].clone()];
        let wrong = minimum(&inverter, &data, wrong);
        assert!(!inverter.fits_beneath(&data, &wrong).unwrap());
        let problem = inverter.problem(&data);
        let found = inverter.look_anew(&problem, &data, wrong).unwrap();
        assert!(inverter.fits_beneath(&data, &found).unwrap());
        assert!(farthest(&found.contacts, &truth) < 1e-4, "{:?}", found.contacts);
        // What fits is left as it is.
        let again = inverter.look_anew(&problem, &data, found.clone()).unwrap();
        assert_eq!((again.chi2, again.contacts), (found.chi2, found.contacts));
    }

    #[test]
    fn two_that_stand_for_one_give_way_to_it_and_two_of_two_stay() {
        let (inverter, model) = skin(0.02, 3);
        let one = [press(0.0012, 0.0034, 1.0)];
        let readings = read(&model, &one, &mut random(12));
        let data = inverter.data(&readings);
        let halves = vec![press(-0.0012, 0.0034, 0.5), press(0.0036, 0.0034, 0.5)];
        let merged =
            inverter.merge(&inverter.problem(&data), &data, minimum(&inverter, &data, halves)).unwrap();
        assert_eq!(merged.contacts.len(), 1, "{:?}", merged.contacts);
        assert!(farthest(&merged.contacts, &one) < 1e-4);
        let two = [press(-0.0022, 0.0034, 0.6), press(0.0028, 0.0034, 0.5)];
        let readings = read(&model, &two, &mut random(13));
        let data = inverter.data(&readings);
        let kept =
            inverter.merge(&inverter.problem(&data), &data, minimum(&inverter, &data, two.to_vec())).unwrap();
        assert_eq!(kept.contacts, two);
    }

    #[test]
    fn readings_about_a_place_are_what_the_others_leave() {
        let (inverter, model) = skin(0.02, 3);
        let data = inverter.data(&read(&model, &[press(0.0, 0.0, 1.0)], &mut random(14)));
        let others = vec![0.25; data.len()];
        let around = inverter.around(&data, &others, &Point3::origin());
        let element = |x: usize, y: usize| y * 50 + x;
        let (near, far) = (element(25, 26), element(2, 47));
        assert_eq!(around[near], data[near].less(0.25));
        assert_eq!(
            (around[far], Datum::AtLeast(1.0, 2.0).less(0.25)),
            (Datum::None, Datum::AtLeast(0.75, 2.0))
        );
        let counted = counted(&around);
        assert!((100..900).contains(&counted), "{counted} readings");
    }

    /// A place that is on no peak is found from the locations beside the peaks, and what explains the readings is left as it is.
    #[test]
    fn a_contact_is_looked_for_beside_the_peaks() {
        let (inverter, model) = skin(0.02, 1);
        let truth = press(0.0052, -0.0031, 0.9);
        let readings = read(&model, std::slice::from_ref(&truth), &mut random(6));
        let data = inverter.data(&readings);
        let from = |best| inverter.elsewhere(&data, best).unwrap();
        let found = from(Minimum::untouched(&data));
        assert_eq!(found.contacts.len(), 1);
        assert!((found.contacts[0].position - truth.position).norm() < 2e-4, "{found:?}");
        assert!(inverter.explains(&found, &data));
        let (location, chi2) = (found.contacts[0].position, found.chi2);
        let again = from(found);
        assert_eq!((again.contacts[0].position, again.chi2), (location, chi2));
    }
}
