use dermis_fixtures::Analytic;
use dermis_model::Stimulus;
use dermis_theory::cramer_rao;
use nalgebra::{Point3, Vector3};
use proptest::prelude::*;
use rand::Rng;
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::testing::{grid, press, random, read};

fn inverter(noise: f64, change: impl FnOnce(&mut Settings)) -> (Inverter, Arc<Analytic>) {
    let model = Arc::new(grid(noise));
    let mut settings = Settings::new(0.004, 2.0);
    change(&mut settings);
    let shared: Arc<dyn ForwardModel> = Arc::clone(&model) as _;
    (Inverter::new(shared, settings).unwrap(), model)
}

#[test]
fn one_contact_is_found_to_its_bound() {
    let (inverter, model) = inverter(20.0, |_| ());
    let mut random = random(1);
    for force in [0.2, 1.0] {
        let (mut error, mut bound, mut expected) = (0.0, 0.0, 0.0);
        let tries = 300;
        for _ in 0..tries {
            let truth = press(random.random_range(-0.012..0.012), random.random_range(-0.012..0.012), force);
            let stimulus = Stimulus { contacts: vec![truth.clone()], ..Stimulus::default() };
            let solution = inverter.solve(&read(&model, &stimulus.contacts, &mut random), None).unwrap();
            let [found] = solution.contacts.as_slice() else { panic!("{solution:?}") };
            error += (found.position - truth.position).norm_squared();
            expected += found.deviation().powi(2);
            bound += cramer_rao(model.as_ref(), &stimulus, Unknowns::Normal).unwrap()[0].position.powi(2);
        }
        let (error, bound, expected) = (error.sqrt(), bound.sqrt(), expected.sqrt());
        assert!((0.9..1.1).contains(&(error / bound)), "{force} N: {error} is not {bound}");
        assert!((0.85..1.2).contains(&(expected / bound)), "{force} N: {expected} is said, {bound} is true");
    }
}

#[test]
fn a_weak_contact_is_answered_by_its_mean() {
    // The strongest taxel stands 4 noise deviations out at best.
    let (inverter, model) = inverter(20.0, |_| ());
    let mut random = random(2);
    let (mut error, mut said, mut bound) = (0.0, 0.0, 0.0);
    for _ in 0..400 {
        let truth = press(random.random_range(-0.017..0.017), random.random_range(-0.017..0.017), 0.012);
        let stimulus = Stimulus { contacts: vec![truth.clone()], ..Stimulus::default() };
        let solution = inverter.solve(&read(&model, &stimulus.contacts, &mut random), None).unwrap();
        error += (solution.contacts[0].position - truth.position).norm_squared();
        said += solution.contacts[0].deviation().powi(2);
        let unbiased = cramer_rao(model.as_ref(), &stimulus, Unknowns::Normal).unwrap();
        bound += unbiased[0].position.powi(2);
    }
    let (error, said, bound) = (error.sqrt(), said.sqrt(), bound.sqrt());
    assert!(error < bound, "knowing the surface helps: {error}, unbiased {bound}");
    assert!((0.7..1.4).contains(&(said / error)), "{said} is said, {error} is true");
}

/// A device that differs from its model, here by ten times the noise, is answered as unsurely as what is left says.
#[test]
fn what_is_left_beyond_noise_counts_as_noise() {
    let (inverter, _) = inverter(20.0, |_| ());
    let device = grid(200.0);
    let mut random = random(6);
    // Where many locations explain the readings, and where one does.
    for (force, least, most) in [(0.12, 0.7, 1.6), (2.0, 0.8, 1.25)] {
        let (mut error, mut said) = (0.0, 0.0);
        for _ in 0..400 {
            let truth = press(random.random_range(-0.012..0.012), random.random_range(-0.012..0.012), force);
            let solution =
                inverter.solve(&read(&device, std::slice::from_ref(&truth), &mut random), None).unwrap();
            let [found] = solution.contacts.as_slice() else { panic!("{solution:?}") };
            error += (found.position - truth.position).norm_squared();
            let widest = found.position_covariance.symmetric_eigenvalues().max();
            let least = found.position_covariance.symmetric_eigenvalues().min();
            assert!(least > -1e-9 * widest, "a covariance: {}", found.position_covariance);
            said += found.deviation().powi(2);
        }
        let ratio = (said / error).sqrt();
        assert!((least..most).contains(&ratio), "{force} N: {ratio} of the error is said");
    }
}

/// What readings leave open is no more open than the surface, and a force no more than the largest; what they fix stays as it is.
#[test]
fn no_place_is_more_open_than_the_surface() {
    let (inverter, model) = inverter(20.0, |_| ());
    let surface = nalgebra::Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, 0.0));
    let pressing = nalgebra::Matrix3::from_diagonal(&Vector3::z());
    let bounded = |place: f64, force: f64| {
        let mut contact = ContactEstimate {
            position: Point3::origin(),
            normal: Vector3::z(),
            force: -Vector3::z(),
            diameter: 0.004,
            position_covariance: surface * place,
            force_covariance: pressing * force,
        };
        inverter.bound(&mut contact);
        contact
    };
    let (x, count) = model.surface().points.iter().fold((0.0, 0.0), |(x, n), p| (x + p.x * p.x, n + 1.0));
    for open in [bounded(1e8, 1e8), bounded(f64::INFINITY, f64::NAN)] {
        approx::assert_relative_eq!(open.position_covariance, surface * (x / count), max_relative = 0.1);
        approx::assert_relative_eq!(open.force_covariance, pressing * 4.0, max_relative = 1e-6);
    }
    let sharp = bounded(1e-8, 1e-4);
    approx::assert_relative_eq!(
        sharp.position_covariance,
        surface * 1e-8,
        max_relative = 1e-3,
        epsilon = 1e-20
    );
    approx::assert_relative_eq!(
        sharp.force_covariance,
        pressing * 1e-4,
        max_relative = 1e-3,
        epsilon = 1e-15
    );
}

#[test]
fn pairs_are_found_among_all_pairs() {
    let (inverter, model) = inverter(1e-3, |s| s.contacts = 3);
    let mut random = random(8);
    for _ in 0..20 {
        let mut at = || random.random_range(-0.014..0.014);
        let (a, b) = (press(at(), at(), 1.0), press(at(), at(), 0.7));
        if (a.position - b.position).norm() < 0.008 {
            continue;
        }
        let truth = [a, b];
        let readings = read(&model, &truth, &mut random);
        let found = inverter.search(&readings).unwrap().contacts;
        assert_eq!(found.len(), 2, "{truth:?} {found:?}");
        for t in &truth {
            let nearest = found.iter().map(|f| (f.position - t.position).norm()).fold(1.0, f64::min);
            assert!(nearest < 5e-4, "{truth:?} {found:?}");
        }
    }
    let single = inverter.search(&read(&model, &[press(0.003, 0.004, 0.8)], &mut random)).unwrap();
    assert_eq!(single.contacts.len(), 1);
    assert!(inverter.search(&[Reading::Exact(0.0)]).is_err());
}

#[test]
fn a_model_that_reads_something_untouched_finds_the_same_contacts() {
    let settings = Settings { contacts: 2, ..Settings::new(0.004, 2.0) };
    let plain = Inverter::new(Arc::new(grid(20.0)), settings.clone()).unwrap();
    let shifted = Inverter::new(Arc::new(grid(20.0).resting_at(|_| 3e4)), settings).unwrap();
    // What a skin publishes: readings minus untouched ones.
    let truth = [press(0.007, 0.005, 1.0), press(-0.008, -0.006, 0.7)];
    let readings = read(&grid(20.0), &truth, &mut random(14));
    let light = read(&grid(20.0), &[press(0.003, 0.001, 0.012)], &mut random(15));
    let same = |of: &dyn Fn(&Inverter) -> Solution| {
        let (a, b) = (of(&plain), of(&shifted));
        assert_eq!(a.contacts.len(), b.contacts.len());
        assert!(!a.contacts.is_empty());
        for (a, b) in a.contacts.iter().zip(&b.contacts) {
            // Both end where a step gains less than 1e-4 of a unit of chi².
            assert!((a.position - b.position).norm() < 0.02 * a.deviation(), "{a:?} {b:?}");
            assert!((a.force - b.force).norm() < 1e-3 * a.force.norm(), "{a:?} {b:?}");
        }
    };
    same(&|inverter| inverter.solve(&readings, None).unwrap());
    same(&|inverter| inverter.search(&readings).unwrap());
    same(&|inverter| inverter.refine(&readings, &truth).unwrap());
    same(&|inverter| inverter.solve(&light, None).unwrap());
    let (a, b) = (plain.evidence(&light), shifted.evidence(&light));
    assert!((a.0 - b.0).abs() <= 1e-3 * a.0 && (a.1 - b.1).abs() <= 1e-3 * a.1, "{a:?} {b:?}");
    let mut signal = vec![f64::NAN; 25];
    shifted.signal(&[], &mut signal).unwrap();
    assert_eq!(signal, [0.0; 25]);
}

/// A row of elements along y = 0, which touches at y and −y read alike, and one element beside it that reads `gain` of the others.
fn row(gain: f64) -> (Inverter, Arc<Analytic>) {
    let mut model = grid(20.0);
    for (i, element) in model.elements.iter_mut().enumerate() {
        element.gain = match i {
            10..15 => 1.0,
            17 => gain,
            _ => 0.0,
        };
    }
    let model = Arc::new(model);
    let shared: Arc<dyn ForwardModel> = Arc::clone(&model) as _;
    (Inverter::new(shared, Settings::new(0.004, 2.0)).unwrap(), model)
}

#[test]
fn of_two_locations_that_explain_readings_the_mean_is_answered() {
    // The element beside the row reads 197 · gain or 3458 · gain Pa: 3.3 deviations apart. Where both are as likely before the reading, the
    // odds of the true place are exp(N(3.3² / 2, 3.3²)), and the mean is within 4 mm of it where they are above 3, by 90 %; wherever the
    // search begins.
    let (inverter, model) = row(0.02);
    let mut random = random(21);
    let (truth, other) = (press(0.003, -0.008, 1.0), press(0.003, 0.008, 1.0));
    let (mut right, mut likelier, mut error, mut of_likelier) = (0, 0, 0.0, 0.0);
    for _ in 0..200 {
        let found = inverter.solve(&read(&model, std::slice::from_ref(&truth), &mut random), Some(&other));
        let found = found.unwrap();
        let away = |c: &ContactEstimate| (c.position - truth.position).norm();
        right += usize::from(away(&found.contacts[0]) < 0.004);
        likelier += usize::from(away(&found.minima[0][0]) < 0.004);
        error += away(&found.contacts[0]).powi(2);
        of_likelier += away(&found.minima[0][0]).powi(2);
    }
    assert!((165..=195).contains(&right), "{right} of 200");
    // Φ(3.3 / 2) = 95 %.
    assert!((180..=199).contains(&likelier), "{likelier} of 200");
    // 256 mm² times E(p (1 - p)) = 0.043 against 256 mm² times 5 %.
    assert!(error < 0.92 * of_likelier, "{error} {of_likelier}");
}

#[test]
fn minima_are_followed_as_a_search_finds_them() {
    let (inverter, model) = row(0.01);
    let mut random = random(23);
    let at = |k: usize| press(0.003 + 5e-5 * k as f64, -0.008, 1.0 + 0.01 * k as f64);
    let first = inverter.solve(&read(&model, &[at(0)], &mut random), None).unwrap();
    assert_eq!(first.misfit, 0.0, "noise explains what is left");
    let (mut minima, mut several, mut lost) = (first.minima, 0, 0);
    for k in 1..=40 {
        let readings = read(&model, &[at(k)], &mut random);
        let searched = inverter.solve(&readings, None).unwrap();
        let Some(followed) = inverter.follow(&readings, &minima, first.misfit).unwrap() else {
            (minima, lost) = (searched.minima, lost + 1);
            continue;
        };
        let (a, b) = (&searched.contacts[0], &followed.contacts[0]);
        assert!((a.position - b.position).norm() < 0.05 * a.deviation().max(1e-4), "{k}: {a:?} {b:?}");
        assert!((a.deviation() - b.deviation()).abs() < 0.05 * a.deviation(), "{k}: {a:?} {b:?}");
        several += usize::from(followed.minima.len() > 1);
        minima = followed.minima;
    }
    assert!(several >= 20, "{several} of 40");
    // Noise is above two deviations of its expectation in one frame of 40.
    assert!(lost <= 3, "{lost} of 40");
    // No single contact explains two, and where nothing is known there is nothing to follow.
    let two = read(&model, &[press(-0.010, -0.008, 1.0), press(0.010, -0.008, 1.0)], &mut random);
    assert_eq!(inverter.follow(&two, &minima, 0.0).unwrap(), None);
    assert_eq!(inverter.follow(&two, &[], 0.0).unwrap(), None);
    assert!(inverter.follow(&two[1..], &minima, 0.0).is_err());
}

/// Readings of a device whose channels have gains of their own.
fn differing(
    contacts: &[Indentation],
    model: &Analytic,
    gains: &[f64],
    random: &mut ChaCha8Rng,
) -> Vec<Reading> {
    let scaled = |(reading, gain): (Reading, &f64)| match reading {
        Reading::Exact(v) => Reading::Exact(v * gain),
        other => other,
    };
    read(model, contacts, random).into_iter().zip(gains).map(scaled).collect()
}

/// Another contact always explains some of what a device differs by. It is none as long as it explains no more than that.
#[test]
fn what_a_device_differs_by_is_no_contact() {
    let mut random = random(26);
    for pairs in [false, true] {
        let (inverter, model) = inverter(1.0, |s| s.contacts = 2);
        let mut counts = [[0; 3]; 2];
        for _ in 0..30 {
            let gains: Vec<f64> = (0..model.channels()).map(|_| random.random_range(0.9..1.1)).collect();
            let contacts = [press(-0.008, -0.006, random.random_range(0.5..1.5)), press(0.008, 0.007, 1.0)];
            for (count, pressing) in counts.iter_mut().zip([&contacts[..1], &contacts]) {
                let readings = differing(pressing, &model, &gains, &mut random);
                let found = if pairs { inverter.search(&readings) } else { inverter.solve(&readings, None) };
                count[found.unwrap().contacts.len()] += 1;
            }
        }
        assert!(counts[0][1] >= 27 && counts[1][2] >= 27, "{counts:?}");
    }
}

/// No search explains more of a device that differs from its model: a following that leaves no more is as good.
#[test]
fn a_contact_on_a_device_that_differs_is_followed() {
    let (inverter, model) = inverter(1.0, |_| ());
    let mut random = random(25);
    let gains: Vec<f64> = (0..model.channels()).map(|_| random.random_range(0.9..1.1)).collect();
    let mut differing = |at: Indentation| differing(&[at], &model, &gains, &mut random);
    let at = |k: usize| press(0.003 + 5e-5 * k as f64, -0.008, 1.0 + 0.01 * k as f64);
    let first = inverter.solve(&differing(at(0)), None).unwrap();
    assert!(first.misfit > 0.0);
    let mut minima = first.minima;
    for k in 1..=40 {
        let readings = differing(at(k));
        assert_eq!(inverter.follow(&readings, &minima, 0.0).unwrap(), None, "noise explains it");
        let followed = inverter.follow(&readings, &minima, first.misfit).unwrap().expect("is followed");
        let searched = inverter.solve(&readings, None).unwrap();
        let (a, b) = (&searched.contacts[0], &followed.contacts[0]);
        assert!((a.position - b.position).norm() < 0.05 * a.deviation(), "{k}: {a:?} {b:?}");
        minima = followed.minima;
    }
    // Another contact is no part of what differs.
    let two = read(&model, &[press(-0.010, -0.008, 1.0), press(0.010, -0.008, 1.0)], &mut random);
    assert_eq!(inverter.follow(&two, &minima, first.misfit).unwrap(), None);
}

/// The contacts of the next frame, and whether those before were followed to them.
fn go_on(
    inverter: &Inverter,
    readings: &[Reading],
    minima: &mut Vec<Vec<ContactEstimate>>,
    misfit: f64,
) -> bool {
    let answer = inverter.follow(readings, minima, misfit).unwrap();
    let followed = answer.is_some();
    *minima = answer.unwrap_or_else(|| inverter.search(readings).unwrap()).minima;
    followed
}

/// \[m\] from the true contact that is farthest from what was found.
fn farthest(truth: &[Indentation], found: &[ContactEstimate]) -> f64 {
    let nearest =
        |t: &Indentation| found.iter().map(|f| (f.position - t.position).norm()).fold(1.0, f64::min);
    truth.iter().map(nearest).fold(0.0, f64::max)
}

/// The same of two, one of which ends.
#[test]
fn two_contacts_on_a_device_that_differs_are_followed() {
    let (inverter, model) = inverter(1.0, |s| s.contacts = 2);
    let mut random = random(27);
    let gains: Vec<f64> = (0..model.channels()).map(|_| random.random_range(0.9..1.1)).collect();
    let at =
        |share: f64| [press(0.007, 0.005, 1.0 + 0.4 * share), press(-0.008 + 0.002 * share, -0.006, 0.7)];
    let first = inverter.search(&differing(&at(0.0), &model, &gains, &mut random)).unwrap();
    assert_eq!((first.contacts.len(), first.misfit > 0.0), (2, true));
    let (mut before, mut followed) = (first.minima, 0);
    for k in 1..=40 {
        let truth = at(f64::from(k) / 40.0);
        let readings = differing(&truth, &model, &gains, &mut random);
        assert_eq!(inverter.follow(&readings, &before, 0.0).unwrap(), None, "noise explains it");
        followed += usize::from(go_on(&inverter, &readings, &mut before, first.misfit));
        assert!(farthest(&truth, &before[0]) < 2e-3, "{k}: {before:?}");
    }
    assert!(followed >= 36, "{followed} of 40 frames");
    let one = differing(&at(1.0)[..1], &model, &gains, &mut random);
    assert_eq!(inverter.follow(&one, &before, first.misfit).unwrap(), None);
}

#[test]
fn minima_are_looked_for_anew_where_a_contact_has_moved() {
    let (inverter, model) = inverter(1.0, |_| ());
    let mut random = random(24);
    let mut found = |x: f64, force: f64| {
        let readings = read(&model, &[press(x, -0.004, force)], &mut random);
        inverter.solve(&readings, None).unwrap().minima
    };
    let (begun, same, other, harder) = (found(0.0, 0.5), found(0.0, 0.6), found(0.006, 0.5), found(0.0, 1.2));
    let has_moved =
        |from: &[Vec<ContactEstimate>], to: &[Vec<ContactEstimate>]| inverter.has_moved(&from[0], to);
    assert!(!has_moved(&begun, &same));
    assert!(has_moved(&begun, &other) && has_moved(&begun, &[]));
    assert!(has_moved(&begun, &harder) && has_moved(&harder, &begun));
    // As long as it is among the minima, the others do not count.
    assert!(!has_moved(&begun, &[other, same].concat()));
}

#[test]
fn an_answer_says_that_another_location_explains_the_readings_too() {
    // 0.8 deviations apart: the likelier place is the true one with Φ(0.4) = 66 %.
    let (inverter, model) = row(0.005);
    let mut random = random(22);
    let truth = press(0.003, -0.008, 1.0);
    let (mut error, mut said, tries) = (0.0, 0.0, 300);
    for _ in 0..tries {
        let readings = read(&model, std::slice::from_ref(&truth), &mut random);
        let found = inverter.solve(&readings, Some(&truth)).unwrap();
        error += (found.contacts[0].position - truth.position).norm_squared();
        said += found.contacts[0].deviation().powi(2);
    }
    let (error, said) = ((error / f64::from(tries)).sqrt(), (said / f64::from(tries)).sqrt());
    assert!((0.007..0.012).contains(&error), "{error}");
    assert!((0.7..1.4).contains(&(said / error)), "{said} is said, {error} is true");
}

/// Elements that tell on which side of y = 0 a touch is on the left only: of two contacts, the one on the right may be on the other side.
#[test]
fn two_contacts_say_that_others_explain_the_readings_too() {
    let mut model = grid(20.0);
    for (i, element) in model.elements.iter_mut().enumerate() {
        element.gain = if i % 5 == 0 || i / 5 == 2 { 1.0 } else { 0.0 };
    }
    let model = Arc::new(model);
    let settings = Settings { contacts: 2, ..Settings::new(0.004, 2.0) };
    let inverter = Inverter::new(Arc::clone(&model) as _, settings).unwrap();
    let mut random = random(28);
    let truth = [press(-0.013, -0.006, 1.2), press(0.009, -0.007, 1.0)];
    let (mut error, mut said, mut several, mut tries) = ([0.0; 2], [0.0; 2], 0, 0);
    for _ in 0..200 {
        let readings = read(&model, &truth, &mut random);
        let searched = inverter.search(&readings).unwrap();
        let followed = inverter.follow(&readings, &searched.minima, 0.0).unwrap();
        several += usize::from(searched.minima.len() > 1);
        for found in [Some(searched), followed].into_iter().flatten() {
            assert_eq!(found.contacts.len(), 2, "{found:?}");
            for (i, truth) in truth.iter().enumerate() {
                let off = |c: &&ContactEstimate| (c.position - truth.position).norm();
                let nearest = found.contacts.iter().min_by(|a, b| off(a).total_cmp(&off(b))).unwrap();
                error[i] += off(&nearest).powi(2);
                said[i] += nearest.deviation().powi(2);
            }
            tries += 1;
        }
    }
    assert!(several > 150 && tries > 350, "{several} of 200 have other minima, {tries} answers");
    let rms = |square: f64| (square / f64::from(tries)).sqrt();
    for (error, said) in error.into_iter().zip(said) {
        assert!((0.8..1.25).contains(&(rms(said) / rms(error))), "{} said, {} true", rms(said), rms(error));
    }
    // The one on the left is known, the other is on one side or on the other.
    assert!(rms(error[0]) < 5e-4 && (2e-3..8e-3).contains(&rms(error[1])), "{error:?}");
}

#[test]
fn contacts_that_last_are_followed() {
    let (inverter, model) = inverter(1e-3, |s| s.contacts = 2);
    let mut random = random(11);
    let at = |share: f64| [press(0.007, 0.005, 1.0 + share), press(-0.008 + 0.002 * share, -0.006, 0.7)];
    let mut before = inverter.search(&read(&model, &at(0.0), &mut random)).unwrap().minima;
    let mut followed = 0;
    for k in 1..=50 {
        let truth = at(f64::from(k) / 50.0);
        let readings = read(&model, &truth, &mut random);
        followed += usize::from(go_on(&inverter, &readings, &mut before, 0.0));
        assert!(farthest(&truth, &before[0]) < 5e-4, "{k}: {before:?}");
    }
    assert!(followed >= 40, "{followed} of 50 frames");
    // One of them ends, a third begins, all end: what was there before is no answer.
    let one = read(&model, &at(1.0)[..1], &mut random);
    assert_eq!(inverter.follow(&one, &before, 0.0).unwrap(), None);
    let mut third = at(1.0).to_vec();
    third.push(press(0.012, -0.012, 0.8));
    assert_eq!(inverter.follow(&read(&model, &third, &mut random), &before, 0.0).unwrap(), None);
    assert_eq!(inverter.follow(&read(&model, &[], &mut random), &before, 0.0).unwrap(), None);
    assert_eq!(inverter.follow(&one, &[], 0.0).unwrap(), None);
    assert!(inverter.follow(&one[1..], &before, 0.0).is_err());
}

#[test]
fn light_presses_are_undetectable_and_strong_ones_are_not() {
    let (inverter, _) = inverter(20.0, |_| ());
    assert!(
        inverter.undetectable_fraction(1e-4, 30.0) > 0.99 && inverter.undetectable_fraction(2.0, 30.0) < 0.01
    );
    let some = inverter.undetectable_fraction(0.03, 30.0);
    assert!((0.01..0.99).contains(&some), "{some}");
}

/// A grid whose locations at x > 0 stand for nine times the area of those at x < 0, in all as much as before. Taxels at x > 0 have this
/// gain.
fn lopsided(gain: f64) -> Analytic {
    let mut model = grid(20.0);
    for (point, area) in model.surface.points.iter().zip(&mut model.surface.areas) {
        *area *= if point.x > 1e-9 {
            1.8
        } else if point.x < -1e-9 {
            0.2
        } else {
            1.0
        };
    }
    model.elements.iter_mut().filter(|e| e.at.x > 0.001).for_each(|e| e.gain = gain);
    model
}

#[test]
fn locations_count_with_their_area() {
    let inverter = |model: Analytic| Inverter::new(Arc::new(model), Settings::new(0.004, 2.0)).unwrap();
    // Where the taxels of one half are deaf, 0.1 N cannot be detected in much of that half, and everywhere in the other one.
    let mut deaf = lopsided(0.0);
    let uneven = inverter(lopsided(0.0)).undetectable_fraction(0.1, 30.0);
    deaf.surface = grid(20.0).surface;
    let even = inverter(deaf).undetectable_fraction(0.1, 30.0);
    assert!((0.2..0.3).contains(&even), "{even}");
    approx::assert_relative_eq!(uneven / even, 1.8, max_relative = 0.01);
    // Readings that say nothing leave the mean of all locations: ∫|x| = 8.7 mm or so, of which (1.8 − 0.2) / 2 is left.
    let data = vec![Datum::Exact(0.0, 1.0 / 20.0); 25];
    let sharp = ContactEstimate {
        position: Point3::origin(),
        normal: Vector3::z(),
        force: -Vector3::z(),
        diameter: 0.004,
        position_covariance: nalgebra::Matrix3::identity(),
        force_covariance: nalgebra::Matrix3::identity(),
    };
    let mean = |model: Analytic| inverter(model).mean(&data, &sharp, 1.0).position;
    let (even, uneven) = (mean(grid(20.0)), mean(lopsided(1.0)));
    assert!(even.x.abs() < 1e-4, "{even}");
    assert!((6.5e-3..7.5e-3).contains(&uneven.x) && uneven.y.abs() < 1e-4, "{uneven}");
}

#[test]
fn several_contacts_are_distinguished() {
    let (inverter, model) = inverter(20.0, |s| s.contacts = 3);
    let mut random = random(3);
    let (mut right, tries) = (0, 150);
    for k in 0..tries {
        let count = 1 + k % 3;
        let mut truth: Vec<Indentation> = Vec::new();
        while truth.len() < count {
            let p = press(
                random.random_range(-0.015..0.015),
                random.random_range(-0.015..0.015),
                random.random_range(0.3..1.5),
            );
            if truth.iter().all(|t| (t.position - p.position).norm() > 0.011) {
                truth.push(p);
            }
        }
        let solution = inverter.solve(&read(&model, &truth, &mut random), None).unwrap();
        let near =
            |t: &Indentation| solution.contacts.iter().any(|f| (f.position - t.position).norm() < 0.001);
        right += usize::from(solution.contacts.len() == count && truth.iter().all(near));
    }
    assert!(right * 100 >= tries * 95, "{right} of {tries}");
}

#[test]
fn noise_makes_no_second_contact() {
    let (inverter, model) = inverter(20.0, |s| s.contacts = 3);
    let mut random = random(4);
    for _ in 0..200 {
        let truth = [press(random.random_range(-0.017..0.017), random.random_range(-0.017..0.017), 1.0)];
        assert_eq!(inverter.solve(&read(&model, &truth, &mut random), None).unwrap().contacts.len(), 1);
    }
}

#[test]
fn shear_is_found_where_it_is_looked_for() {
    let (inverter, model) = inverter(20.0, |s| s.unknowns = Unknowns::Full);
    let mut truth = press(0.003, -0.002, 1.0);
    truth.force = Vector3::new(0.3, -0.2, -1.0);
    let found = inverter.solve(&read(&model, std::slice::from_ref(&truth), &mut random(5)), None).unwrap();
    let found = &found.contacts[0];
    let sigma = found.force_covariance.diagonal().map(f64::sqrt);
    for k in 0..3 {
        assert!((found.force[k] - truth.force[k]).abs() < 5.0 * sigma[k] && sigma[k] < 0.05, "{found:?}");
    }
    assert!((found.position - truth.position).norm() < 5.0 * found.deviation());
}

#[test]
fn channels_at_the_end_of_their_range_and_missing_ones_are_no_lies() {
    let (inverter, model) = inverter(20.0, |_| ());
    let truth = press(0.0005, 0.001, 1.2);
    let mut readings = read(&model, std::slice::from_ref(&truth), &mut random(6));
    // The one below the press is cut off at 3 kPa, two neighbours are gone.
    readings[12] = Reading::AtLeast(3000.0);
    readings[11] = Reading::Missing;
    readings[18] = Reading::Exact(f64::NAN);
    let solution = inverter.solve(&readings, None).unwrap();
    assert!((solution.contacts[0].position - truth.position).norm() < 5.0 * solution.contacts[0].deviation());
    assert_eq!(solution.freedom, 20);
    let missing = vec![Reading::Missing; 25];
    assert!(inverter.solve(&missing, None).unwrap().contacts.is_empty());
    insta::assert_snapshot!(inverter.solve(&missing[1..], None).unwrap_err(), @"24 readings where the model has 25 channels");
}

#[test]
fn what_cannot_be_is_refused() {
    let refused = |change: fn(&mut Settings)| {
        let mut settings = Settings::new(0.004, 2.0);
        change(&mut settings);
        Inverter::new(Arc::new(grid(20.0)), settings).unwrap_err().to_string()
    };
    insta::assert_snapshot!(refused(|s| s.contacts = 0), @"`contacts` is 0 and must be 1 to 10");
    insta::assert_snapshot!(refused(|s| s.force_max = f64::NAN), @"`force_max` is NaN and must be a positive number");
    insta::assert_snapshot!(refused(|s| s.gains = vec![1.0; 3]), @"`gains` is 3 long and must be one number for each of 25 channels");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn every_reading_has_an_answer_on_the_surface(
        values in proptest::collection::vec(-1e5..1e5f64, 25), kinds in proptest::collection::vec(0..4u8, 25),
    ) {
        let (inverter, model) = inverter(20.0, |s| s.contacts = 2);
        let readings: Vec<Reading> = values.iter().zip(&kinds).map(|(v, k)| match k {
            0 => Reading::AtLeast(*v),
            1 => Reading::AtMost(*v),
            2 => Reading::Missing,
            _ => Reading::Exact(*v),
        }).collect();
        for found in inverter.solve(&readings, None).unwrap().contacts {
            prop_assert!(model.surface().distance(&found.position) < 1e-9);
            prop_assert!(found.normal_force() > 0.0 && found.normal_force() <= 3.0 + 1e-9);
        }
    }
}
