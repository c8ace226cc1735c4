//! Minima beside the one that a search ended in.
//!
//! Problem: of a contact on thin elastomer the pattern changes within a fraction of a millimetre, so that least squares have several minima
//! beside one another, and derivatives that hold for small displacements may end on a slope. Such a minimum leaves a hundred units of squared
//! deviations more than the true one does, which is little beside what noise leaves in 1,500 readings, and so it passes for an explanation.
//! Method: the readings that a contact changes by more than their noise are judged by themselves (Pearson's χ² of a part). Where they do not
//! fit, the search is continued with derivatives that are differences of responses, and from a lattice of places around the contact, whose
//! spacing is the way over which the pattern there changes as much as it is strong: all are compared by one response each, the best are
//! refined, and the likeliest minimum is the answer (multistart; A. H. G. Rinnooy Kan and G. T. Timmer, *Math. Program.* 39 (1987) 27). Of several
//! contacts, each is settled in what the others leave (`inverter/pursuit.rs`). Assumptions: as the search's. Cost: nothing but a sum where the
//! readings fit, which they do in all but one of some hundred frames; otherwise some 50 responses and five minimisations, twice at most.

use dermis_model::{Indentation, Unknowns, tangents};
use nalgebra::{Point3, Vector3};

use super::{Inverter, residuals};
use crate::fit::{Datum, Minimum, Problem};
use crate::local::ZERO;
use crate::settings::InverterError;

/// Deviations of its noise by which a contact changes a reading that is judged with it.
const SHOWS: f64 = 1.0;
/// Deviations of its expectation up to which what is left of these readings is what noise leaves: what a false alarm costs is a minimisation.
const PLAUSIBLE: f64 = 2.5;
/// Readings that are judged, at least: fewer belong to a contact that is too light for its place to be known so well.
const FEWEST: usize = 12;
/// Spacings of the lattice within the dictionary's, at most: farther away the dictionary itself has a place to begin at.
const RINGS: usize = 4;
/// Places that the search is begun at.
const STARTS: usize = 4;
/// Spacings of the lattice that these are apart.
const APART: f64 = 1.5;
/// Times that a minimum is left for one beside it, at most.
const PASSES: usize = 2;
/// What a pass must gain of the sum of squared deviations that another is worth its time.
const WORTH: f64 = 4.0;
/// \[m\] by which a contact is moved to see how its pattern changes.
const MOVE: f64 = 1e-4;
/// Factor from the diameter of a tip to the next that is tried: five of them up to four times the first, and a parabola finds what lies between.
const WIDER: f64 = 1.4;
/// What a tip of another diameter must explain more of the sum of squared deviations: three deviations of the noise.
const TELLING: f64 = 9.0;
/// What a step gains at the least while tips are compared, and of guesses.
pub(super) const ROUGH_GAIN: f64 = 1.0;
/// Factor by which a start may press more or less than the contact does that it stands in for.
const HARDER: f64 = 5.0;

impl Inverter {
    /// Whether what is left beneath every contact is what noise leaves there.
    pub(crate) fn fits_beneath(&self, data: &[Datum], minimum: &Minimum) -> Result<bool, InverterError> {
        Ok(self.worst(&self.problem(data), data, minimum, &[])?.is_none())
    }

    /// The likeliest of this minimum of one contact and of those beside it; itself, at once, where the readings beneath it fit.
    pub(crate) fn settle(&self, data: &[Datum], minimum: Minimum) -> Result<Minimum, InverterError> {
        let careful = Problem { by_differences: true, ..self.problem(data) };
        let mut best = minimum;
        for _ in 0..PASSES {
            let before = best.chi2;
            if self.fits_beneath(data, &best)? {
                break;
            }
            best = self.with_best_tip(data, best)?;
            if self.fits_beneath(data, &best)? {
                break;
            }
            let polished = careful.minimise(best.contacts.clone())?;
            if keep(&mut best, polished) && self.fits_beneath(data, &best)? {
                break;
            }
            for start in self.beside(&careful, data, &best)? {
                let moved = careful.minimise(vec![start])?;
                if keep(&mut best, moved) && self.fits_beneath(data, &best)? {
                    return Ok(best);
                }
            }
            if best.chi2 > before - WORTH {
                break;
            }
        }
        Ok(best)
    }

    /// This minimum of one contact, by the tip whose diameter explains the readings best: wider and narrower ones are tried for as long as they
    /// explain more, and at last one between them. Itself where there is not one contact.
    pub(crate) fn with_best_tip(&self, data: &[Datum], mut best: Minimum) -> Result<Minimum, InverterError> {
        let s = self.settings();
        let Some(widest) = s.widest.filter(|_| best.contacts.len() == 1) else { return Ok(best) };
        let rough = Problem { least_gain: ROUGH_GAIN, ..self.problem(data) };
        let by_tip = |best: &Minimum, factor: f64| {
            let Indentation { position, force, .. } = best.contacts[0];
            let diameter = best.contacts[0].diameter() * factor;
            let possible = (s.diameter * (1.0 - 1e-9)..=widest * (1.0 + 1e-9)).contains(&diameter);
            possible.then(|| rough.minimise(vec![s.pressed_by(diameter, position, force)])).transpose()
        };
        let given = best.contacts[0].diameter();
        // What tips beside the best one leave: the narrower, the wider.
        let mut beside = [None; 2];
        for (side, factor) in [(1, WIDER), (0, 1.0 / WIDER)] {
            if beside[side].is_some() {
                continue;
            }
            while let Some(tried) = by_tip(&best, factor)? {
                if tried.chi2 > best.chi2 - TELLING {
                    beside[side] = Some(tried.chi2);
                    break;
                }
                beside = [None; 2];
                beside[1 - side] = Some(best.chi2);
                best = tried;
            }
        }
        // A parabola through three points.
        if let [Some(less), Some(more)] = beside {
            let (slope, bend) = (0.5 * (more - less), more + less - 2.0 * best.chi2);
            if bend > 0.0
                && let Some(between) = by_tip(&best, WIDER.powf((-slope / bend).clamp(-0.5, 0.5)))?
                && between.chi2 < best.chi2
            {
                best = between;
            }
        }
        match best.contacts[0].diameter() == given {
            true => Ok(best),
            false => Ok(self.problem(data).minimise(best.contacts)?),
        }
    }

    /// The contact beneath which the readings fit worst, of those that are not at the places `but`; `None` where all do.
    pub(super) fn worst(
        &self,
        problem: &Problem<'_>,
        data: &[Datum],
        minimum: &Minimum,
        but: &[Point3<f64>],
    ) -> Result<Option<usize>, InverterError> {
        let left = residuals(data, &minimum.signal);
        let mut worst: Option<(f64, usize)> = None;
        for (index, contact) in minimum.contacts.iter().enumerate() {
            if but.contains(&contact.position) {
                continue;
            }
            let excess = Beneath::of(&own_signal(problem, minimum, &[index])?, &left, data).excess();
            if excess > worst.map_or(0.0, |(most, _)| most) {
                worst = Some((excess, index));
            }
        }
        Ok(worst.map(|(_, index)| index))
    }

    /// The same readings with what contacts are off added to their noise: a share of what each changes, as large as its readings say.
    pub(super) fn with_misfit(
        &self,
        problem: &Problem<'_>,
        data: &[Datum],
        minimum: &Minimum,
    ) -> Result<Vec<Datum>, InverterError> {
        let left = residuals(data, &minimum.signal);
        let mut variance = vec![0.0; data.len()];
        for index in 0..minimum.contacts.len() {
            let own = own_signal(problem, minimum, &[index])?;
            let misfit = Beneath::of(&own, &left, data).misfit();
            variance.iter_mut().zip(&own).for_each(|(variance, own)| *variance += misfit * own * own);
        }
        let more = data.iter().zip(variance);
        Ok(more
            .map(|(datum, variance)| datum.map(|v, w| (v, 1.0 / w.recip().hypot(variance.sqrt()))))
            .collect())
    }

    /// Contacts around the one of a minimum that explain readings best, each scaled to do so.
    fn beside(
        &self,
        problem: &Problem<'_>,
        data: &[Datum],
        minimum: &Minimum,
    ) -> Result<Vec<Indentation>, InverterError> {
        let Some(contact) = minimum.contacts.first() else { return Ok(Vec::new()) };
        let left = residuals(data, &vec![0.0; data.len()]);
        let step = self.pattern_step(problem, data, contact, &minimum.signal)?;
        let rings = (self.spacing / step).floor().clamp(1.0, RINGS as f64) as i32;
        let across = if self.settings.unknowns == Unknowns::Line { 0 } else { rings };
        let (_, normal) = self.surface().project(&contact.position);
        let axes = tangents(&normal);
        let mut signal = vec![0.0; data.len()];
        let mut scored: Vec<(f64, Indentation)> = Vec::new();
        for (i, j) in (-rings..=rings).flat_map(|i| (-across..=across).map(move |j| (i, j))) {
            let stride: Vector3<f64> = axes[0] * (f64::from(i) * step) + axes[1] * (f64::from(j) * step);
            let length = stride.norm();
            if length == 0.0 || length > f64::from(rings) * step * (1.0 + 1e-9) {
                continue;
            }
            let mut moved = problem.shifted(contact, &stride);
            problem.signal(std::slice::from_ref(&moved), &mut signal)?;
            let (mut dot, mut square) = (0.0, 0.0);
            for (value, left) in whitened(&signal, data).zip(&left) {
                dot += value * f64::from(*left);
                square += value * value;
            }
            if dot > 0.0 && square > 0.0 {
                moved.force *= (dot / square).clamp(1.0 / HARDER, HARDER);
                scored.push((dot * dot / square, moved));
            }
        }
        scored.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut chosen: Vec<Indentation> = Vec::new();
        for (_, start) in scored {
            if chosen.len() == STARTS {
                break;
            }
            if chosen.iter().all(|c| (c.position - start.position).norm() >= APART * step) {
                chosen.push(start);
            }
        }
        Ok(chosen)
    }

    /// \[m\] over which a contact's pattern changes as much as it is strong, in the direction in which that is least; no more than the
    /// dictionary's spacing, and no less than the finest lattice's.
    fn pattern_step(
        &self,
        problem: &Problem<'_>,
        data: &[Datum],
        contact: &Indentation,
        own: &[f64],
    ) -> Result<f64, InverterError> {
        let strength = whitened(own, data).map(|v| v * v).sum::<f64>().sqrt();
        let (_, normal) = self.surface().project(&contact.position);
        let mut least = self.spacing;
        let mut moved = vec![0.0; own.len()];
        for axis in tangents(&normal) {
            problem.signal(&[problem.shifted(contact, &(axis * MOVE))], &mut moved)?;
            let change =
                whitened(&moved, data).zip(whitened(own, data)).map(|(a, b)| (a - b).powi(2)).sum::<f64>();
            if change > 0.0 {
                least = least.min(MOVE * strength / change.sqrt());
            }
        }
        Ok(least.max(self.spacing / RINGS as f64))
    }
}

/// Signal of some of a minimum's contacts by themselves.
pub(super) fn own_signal(
    problem: &Problem<'_>,
    minimum: &Minimum,
    contacts: &[usize],
) -> Result<Vec<f64>, InverterError> {
    if minimum.contacts.len() == contacts.len() {
        return Ok(minimum.signal.clone());
    }
    let contacts: Vec<Indentation> = contacts.iter().map(|k| minimum.contacts[*k].clone()).collect();
    let mut own = vec![0.0; minimum.signal.len()];
    problem.signal(&contacts, &mut own)?;
    Ok(own)
}

/// Whether `other` takes the place of `best`: it explains more.
fn keep(best: &mut Minimum, other: Minimum) -> bool {
    let better = other.chi2 < best.chi2;
    if better {
        *best = other;
    }
    better
}

/// A signal in units of the noise of readings; what cannot be relied on is 0.
fn whitened<'a>(signal: &'a [f64], data: &'a [Datum]) -> impl Iterator<Item = f64> + 'a {
    signal.iter().zip(data).map(|(value, datum)| match datum {
        Datum::Exact(_, weight) | Datum::AtLeast(_, weight) | Datum::AtMost(_, weight) => value * weight,
        Datum::None => 0.0,
    })
}

/// Readings that a contact changes by more than their noise.
struct Beneath {
    count: usize,
    /// Squares of what is left of them and of what the contact makes of them, in units of their noise.
    left: f64,
    own: f64,
}

impl Beneath {
    fn of(own: &[f64], left: &[f32], data: &[Datum]) -> Self {
        let mut beneath = Self { count: 0, left: 0.0, own: 0.0 };
        for ((value, left), datum) in whitened(own, data).zip(left).zip(data) {
            if matches!(datum, Datum::Exact(..)) && value.abs() >= SHOWS {
                beneath.count += 1;
                beneath.left += f64::from(*left).powi(2);
                beneath.own += value * value;
            }
        }
        beneath
    }

    /// What is left of them beyond what noise leaves of as many; 0 or less where they fit, or are too few.
    fn excess(&self) -> f64 {
        if self.count < FEWEST {
            return 0.0;
        }
        let count = self.count as f64;
        self.left - (1.0 + ZERO) * (count + PLAUSIBLE * (2.0 * count).sqrt())
    }

    /// Square of the share of its own signal that a contact is off, as its readings say; 0 where they fit.
    fn misfit(&self) -> f64 {
        if self.excess() > 0.0 { (self.left - (1.0 + ZERO) * self.count as f64) / self.own } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use dermis_fixtures::Analytic;
    use dermis_skin::{Surface, SurfaceSpec};
    use nalgebra::Point3;

    use super::*;
    use crate::Search;
    use crate::settings::Settings;
    use crate::testing::{press, random, read};

    /// \[m\] between troughs of a pattern, and over which it fades.
    const PITCH: f64 = 1.2e-3;
    const WIDTH: f64 = 1.6e-3;

    /// 50 by 50 elements in the middle of a plane, whose pattern has troughs beside its crest as that of thin elastomer has: one pitch away it
    /// is nearly the same.
    fn thin(noise: f64) -> Arc<Analytic> {
        let at = |i: usize| (i as f64 - 24.5) * 4.8e-4;
        let elements = (0..2500).map(|i| Point3::new(at(i % 50), at(i / 50), 0.0));
        let spec = SurfaceSpec::Rectangle { size: [0.060, 0.060], spacing: 0.0015 };
        Arc::new(Analytic::new(Surface::from_spec(&spec), elements, noise, |c, element| {
            let off = element - c.position;
            let fades = (-off.norm_squared() / (2.0 * WIDTH * WIDTH)).exp();
            -c.force.z * (std::f64::consts::TAU * off.x / PITCH).cos() * fades
        }))
    }

    fn near(model: &Arc<Analytic>) -> Inverter {
        let mut settings = Settings::new(0.004, 2.0);
        (settings.contacts, settings.distance, settings.search) = (3, 0.004, Search::Near);
        Inverter::new(Arc::clone(model) as _, settings).unwrap()
    }

    /// A contact of the frame before lies one pitch beside the true one. Least squares from there end one pitch away, in a minimum that all
    /// readings together do not tell from the truth.
    #[test]
    fn a_minimum_beside_the_true_one_is_left() {
        let model = thin(0.16);
        let inverter = near(&model);
        for (seed, truth) in
            [press(0.0011, 0.0007, 1.0), press(-0.0023, 0.0016, 1.0), press(0.0004, -0.0031, 1.0)]
                .into_iter()
                .enumerate()
        {
            let readings = read(&model, std::slice::from_ref(&truth), &mut random(seed as u64));
            let data = inverter.data(&readings);
            let beside = press(truth.position.x + PITCH, truth.position.y, -truth.force.z);
            let trapped = inverter.problem(&data).minimise(vec![beside]).unwrap();
            let off = (trapped.contacts[0].position - truth.position).norm();
            assert!((0.6 * PITCH..1.4 * PITCH).contains(&off), "it is trapped {off} m away");
            let all = (1.0 + ZERO) * (2497.0 + crate::local::PLAUSIBLE * (2.0 * 2497.0f64).sqrt());
            assert!(trapped.chi2 < all, "all readings together do not tell: {} of {all}", trapped.chi2);
            assert!(!inverter.fits_beneath(&data, &trapped).unwrap(), "those beneath it do");
            let before = inverter.solution(&trapped, &data).contacts;
            assert!(inverter.follow_near(&readings, &before, &[]).unwrap().is_none());
            let found = inverter.search_near(&readings, &before, &[]).unwrap();
            assert_eq!(found.contacts.len(), 1, "{found:?}");
            // Four deviations of the Cramér–Rao bound: 8 µm along the wave, and 90 µm across it, where the pattern only fades.
            let off = found.contacts[0].position - truth.position;
            assert!(off.x.abs() < 4e-5 && off.y.abs() < 4e-4, "{off} m off");
            let settled = inverter.settle(&data, trapped.clone()).unwrap();
            assert!(settled.chi2 < trapped.chi2 - 30.0);
            // What fits is left as it is.
            let again = inverter.settle(&data, settled.clone()).unwrap();
            assert_eq!((again.chi2, again.contacts), (settled.chi2, settled.contacts));
        }
    }

    /// A second contact that changes some tens of 2,500 readings is lost in the sum of all, and stands out at its place.
    #[test]
    fn a_light_contact_beside_a_known_one_is_taken_in() {
        let model = thin(0.16);
        let inverter = near(&model);
        // At places of the dictionary, whose own pattern is that of the press.
        let place = |x: f64| {
            let off = |p: &Point3<f64>| (p - Point3::new(x, 0.0, 0.0)).norm();
            let all = inverter.dictionary.locations.iter().map(|l| l.position);
            all.min_by(|a, b| off(a).total_cmp(&off(b))).unwrap()
        };
        let (strong, light) = (place(-0.003), place(0.006));
        let truth = [press(strong.x, strong.y, 1.0), press(light.x, light.y, 0.4)];
        let readings = read(&model, &truth, &mut random(7));
        let data = inverter.data(&readings);
        let alone = inverter.problem(&data).minimise(truth[..1].to_vec()).unwrap();
        let all = (1.0 + ZERO) * (2497.0 + crate::local::PLAUSIBLE * (2.0 * 2497.0f64).sqrt());
        assert!(alone.chi2 < all, "all readings together do not tell: {} of {all}", alone.chi2);
        let before = inverter.solution(&alone, &data).contacts;
        assert!(inverter.follow_near(&readings, &before, &[]).unwrap().is_none());
        let found = inverter.search_near(&readings, &before, &[]).unwrap().contacts;
        assert_eq!(found.len(), 2, "{found:?}");
        for (found, truth) in found.iter().zip(&truth) {
            let off = found.position - truth.position;
            assert!(off.x.abs() < 1e-4 && off.y.abs() < 1e-3, "{found:?}");
            assert!((found.normal_force() + truth.force.z).abs() < 0.15, "{found:?}");
        }
    }

    /// The lattice is as fine as the pattern is narrow, and starts keep their distance.
    #[test]
    fn starts_lie_as_close_as_the_pattern_demands() {
        let model = thin(0.16);
        let inverter = near(&model);
        let truth = press(0.0011, 0.0007, 1.0);
        let readings = read(&model, std::slice::from_ref(&truth), &mut random(3));
        let data = inverter.data(&readings);
        let problem = inverter.problem(&data);
        let minimum = problem.minimise(vec![truth]).unwrap();
        let step = inverter.pattern_step(&problem, &data, &minimum.contacts[0], &minimum.signal).unwrap();
        // A wave of this pitch changes as much as it is strong within a sixth of it, which is finer than the finest lattice.
        assert!((step - inverter.spacing / RINGS as f64).abs() < 1e-12, "{step}");
        let starts = inverter.beside(&problem, &data, &minimum).unwrap();
        assert!((1..=STARTS).contains(&starts.len()));
        for (i, a) in starts.iter().enumerate() {
            assert!((a.position - minimum.contacts[0].position).norm() <= inverter.spacing * 1.001);
            assert!(starts[..i].iter().all(|b| (a.position - b.position).norm() >= APART * step));
        }
    }

    /// A pattern that is the wider, the wider the tip is. Where only one diameter is known, a tip of three times as much fits nowhere; where wider
    /// ones are tried, the one next to it does, alone, is followed as such, and gives way again to the narrow one.
    #[test]
    fn a_tip_of_another_size_is_told_by_its_pattern() {
        let at = |i: usize| (i as f64 - 24.5) * 1e-3;
        let elements = (0..2500).map(|i| Point3::new(at(i % 50), at(i / 50), 0.0));
        let spec = SurfaceSpec::Rectangle { size: [0.060, 0.060], spacing: 0.0015 };
        let model = Arc::new(Analytic::new(Surface::from_spec(&spec), elements, 0.005, |c, element| {
            let wide = 1.2e-3 + c.diameter() / 4.0;
            -c.force.z * (-(element - c.position).norm_squared() / (2.0 * wide * wide)).exp()
        }));
        let fixed = near(&model);
        let settings = Settings { widest: Some(0.016), ..fixed.settings().clone() };
        let free = Inverter::new(Arc::clone(&model) as _, settings).unwrap();
        let truth = |diameter: f64| press(0.0031, -0.0012, 1.0).with_diameter(diameter);
        let frame = |diameter: f64, seed: u64| read(&model, &[truth(diameter)], &mut random(seed));
        let wide = frame(0.0112, 1);
        let explains =
            |found: &crate::Solution| found.chi2 < crate::inverter::plausible(found.freedom) * (1.0 + ZERO);
        assert!(!explains(&fixed.search_near(&wide, &[], &[]).unwrap()));
        let found = free.search_near(&wide, &[], &[]).unwrap();
        let [one] = found.contacts.as_slice() else { panic!("{found:?}") };
        assert!((one.diameter / 0.0112 - 1.0).abs() < 0.03 && explains(&found), "{one:?}");
        assert!(
            (one.position - truth(0.0112).position).norm() < 1e-4 && (one.force.z + 1.0).abs() < 0.03,
            "{one:?}"
        );
        let followed = free.follow_near(&frame(0.0112, 2), &found.contacts, &[]).unwrap().unwrap();
        assert_eq!(followed.contacts[0].diameter, one.diameter);
        let narrow = free.search_near(&frame(0.004, 3), &found.contacts, &[]).unwrap();
        assert_eq!((narrow.contacts.len(), narrow.contacts[0].diameter), (1, 0.004), "{narrow:?}");
        let refused = Settings { widest: Some(0.003), ..fixed.settings().clone() };
        assert!(Inverter::new(model, refused).unwrap_err().to_string().contains("widest"));
    }
}
