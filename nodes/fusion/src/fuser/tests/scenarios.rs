//! Simulated touches, all seeded: how good the estimator is.

use std::collections::HashMap;

use dermis_skin::assign;

use super::*;
use crate::testing::{Moment, Scenario, SimSkin, Touch};

/// \[s\] after which a touch has to be there: births, the slowest skin's period, its delay.
const SETTLE: f64 = 0.1;

fn scenario(touches: Vec<Touch>, duration: f64) -> Scenario {
    Scenario {
        seed: 7,
        duration,
        touches,
        skins: vec![SimSkin::good(0), SimSkin::good(1)],
        settings: Settings::default(),
        moves: false,
        rate: 100.0,
    }
}

/// Index of a touch, and the error of its contact's position with that contact.
type Error = (usize, Option<(Vector3<f64>, BodyTouch)>);

/// Error of the position of each touch, in the order of the truth; `None` where nothing is within 20 mm.
fn errors(moment: &Moment<'_>) -> Vec<Error> {
    let found = &moment.state.contacts;
    let distance = |t: usize, f: usize| (on_chest(&found[f]) - moment.truth[t].1.position).norm();
    let assigned = assign(moment.truth.len(), found.len(), distance);
    let each = moment.truth.iter().zip(assigned).enumerate().map(|(t, ((index, touch), f))| {
        let near = f.filter(|f| distance(t, *f) < 0.02);
        (*index, near.map(|f| (on_chest(&found[f]) - touch.position, found[f].clone())))
    });
    each.collect()
}

#[test]
fn two_contacts_30_mm_apart_stay_two() {
    let touches = vec![Touch::resting(0.0, 60.0, 0.0, 0.0, 3.0), Touch::resting(0.0, 60.0, 0.03, 0.0, 5.0)];
    let mut scenario = scenario(touches, 30.0);
    // Coarse skins, and each with a bias of its own.
    scenario.skins.iter_mut().for_each(|s| s.position = 3e-3);
    let mut ids: Option<Vec<u32>> = None;
    scenario.run(|moment| {
        if moment.t < SETTLE {
            return;
        }
        let found = &moment.state.contacts;
        assert_eq!(found.len(), 2, "at {} s: {found:?}", moment.t);
        assert!(found.iter().all(|c| c.skins.len() == 2), "at {} s: {found:?}", moment.t);
        let now: Vec<u32> =
            errors(moment).iter().map(|(_, e)| e.as_ref().unwrap().1.contact.track_id).collect();
        assert_eq!(*ids.get_or_insert(now.clone()), now, "at {} s", moment.t);
    });
    assert!(ids.is_some());
}

#[test]
fn one_touch_of_two_skins_is_one_contact() {
    for seed in 0..20 {
        let mut scenario = scenario(vec![Touch::resting(0.0, 9.0, 0.01, 0.02, 4.0)], 2.0);
        scenario.seed = seed;
        scenario.run(|moment| {
            if moment.t < SETTLE {
                return;
            }
            let [touch] = moment.state.contacts.as_slice() else {
                panic!("seed {seed} at {} s: {:?}", moment.t, moment.state.contacts)
            };
            assert_eq!(touch.skins.len(), 2);
            // Gains of 3 %, noise of 0.1 N.
            assert!((moment.state.net.force.z + 4.0).abs() < 0.8, "{:?}", moment.state.net);
        });
    }
}

/// Ten touches that slide, rest and end, skins that miss, invent and rename contacts.
#[test]
fn identities_switch_once_in_1000_contact_seconds_at_most() {
    let mut touches = Vec::new();
    for k in 0..10 {
        let (x, y) = (f64::from(k % 5) * 0.06 - 0.12, f64::from(k / 5) * 0.06 - 0.03);
        touches.push(Touch::resting(0.1 * f64::from(k), 101.0, x, y, 2.0 + f64::from(k)));
    }
    let mut scenario = scenario(touches, 100.0);
    for skin in &mut scenario.skins {
        (skin.miss, skin.clutter, skin.rename) = (0.02, 0.02, 0.002);
        skin.position = 1.5e-3;
    }
    scenario.rate = 50.0;
    let (mut of_touch, mut switches, mut lost, mut samples): (HashMap<usize, u32>, u32, u32, u32) =
        Default::default();
    let mut more = 0;
    scenario.run(|moment| {
        if moment.t < 1.1 + SETTLE {
            return;
        }
        for (touch, error) in errors(moment) {
            samples += 1;
            match error {
                Some((_, found)) => {
                    let id = found.contact.track_id;
                    switches += u32::from(of_touch.insert(touch, id).is_some_and(|before| before != id));
                }
                None => lost += 1,
            }
        }
        more += moment.state.contacts.len().saturating_sub(moment.truth.len());
    });
    let seconds = f64::from(samples) / scenario.rate;
    println!("{switches} switches in {seconds} contact-seconds");
    assert!(seconds > 980.0);
    assert!(f64::from(switches) <= seconds / 1000.0, "{switches} switches in {seconds} s");
    assert_eq!(lost, 0, "of {samples}");
    assert!(more as f64 <= 0.001 * f64::from(samples), "{more} contacts too many in {samples}");
}

/// Standard deviations within which three normal variables all are in 95 % of cases (Bonferroni): the quantile of 1 − 0.05 / 6.
const JOINTLY: f64 = 2.394;

/// Bounds of the mean of a χ² variable with `n` degrees of freedom, divided by n, at `z` standard deviations of a normal one (Wilson and
/// Hilferty 1931).
fn band(n: f64, z: f64) -> (f64, f64) {
    let bound = |z: f64| (1.0 - 2.0 / (9.0 * n) + z * (2.0 / (9.0 * n)).sqrt()).powi(3);
    (bound(-z), bound(z))
}

/// Normalised squared errors of position, force and velocity of six touches a seed that move as the model says, by skins whose errors stay as they
/// are said to: sums over all components, and how many.
fn normalised_errors(seeds: std::ops::Range<u64>) -> ([f64; 3], f64) {
    let (mut sums, mut n) = ([0.0; 3], 0.0);
    for seed in seeds {
        let touches = (0..6)
            .map(|k| Touch::resting(0.0, 9.0, f64::from(k % 3) * 0.2, f64::from(k / 3) * 0.2, 8.0))
            .collect();
        let mut scenario = scenario(touches, 0.8);
        (scenario.seed, scenario.moves) = (seed, true);
        scenario.settings.gain_deviation = 0.02;
        // The gain's error is that of the first force: forces must not change too much.
        scenario.settings.force_change = 2.0;
        scenario.rate = 20.0;
        scenario.skins[1].position = 2e-3;
        let last = (scenario.duration * scenario.rate) as usize - 1;
        scenario.run(|moment| {
            if (moment.t * 20.0).round() as usize != last {
                return;
            }
            for (touch, error) in errors(moment) {
                let (error, found) = error.unwrap();
                let truth = &moment.truth.iter().find(|(i, _)| *i == touch).unwrap().1;
                // All in the frame of the contact's link; chest and body have the same axes, the plate is turned.
                let turn = match found.link {
                    1 => nalgebra::UnitQuaternion::identity(),
                    _ => nalgebra::UnitQuaternion::from_euler_angles(0.0, 0.0, -0.5),
                };
                let nees = |e: Vector3<f64>, p: Matrix3<f64>| {
                    (turn * e).dot(&(p.try_inverse().unwrap() * (turn * e)))
                };
                let back = turn.inverse();
                sums[0] += nees(error, found.contact.position_covariance);
                sums[1] += nees(back * found.contact.force - truth.force, found.contact.force_covariance);
                sums[2] += nees(back * found.velocity - truth.velocity, found.velocity_covariance);
                n += 3.0;
            }
        });
    }
    (sums, n)
}

/// Touches and biases of all seeds are independent of each other, so that every component counts. The band is that of all three sums
/// together: where each has a band of 95 % of its own, one of three is outside in one of seven runs. Of 14,400 touches (seeds 10,000 to 12,400) the means
/// were 1.007, 1.009 and 0.996, with a standard deviation of 0.007.
#[test]
fn covariances_are_honest() {
    let (sums, n) = normalised_errors(100..300);
    assert_eq!(n, 3600.0);
    let (low, high) = band(n, JOINTLY);
    for (what, sum) in ["position", "force", "velocity"].into_iter().zip(sums) {
        let mean = sum / n;
        assert!((low..high).contains(&mean), "{what}: {mean} is not within {low}..{high}");
    }
}

#[test]
fn a_contact_of_five_minutes_stays() {
    let mut scenario = scenario(vec![Touch::resting(0.0, 400.0, 0.01, 0.02, 4.0)], 300.0);
    scenario.skins.iter_mut().for_each(|s| (s.rate, s.miss) = (20.0, 0.02));
    scenario.rate = 10.0;
    let mut id = None;
    scenario.run(|moment| {
        if moment.t < 0.3 {
            return;
        }
        let [touch] = moment.state.contacts.as_slice() else {
            panic!("at {} s: {:?}", moment.t, moment.state.contacts)
        };
        assert_eq!(*id.get_or_insert(touch.contact.track_id), touch.contact.track_id);
        assert!((touch.contact.force.z + 4.0).abs() < 1.0, "at {} s: {:?}", moment.t, touch.contact.force);
    });
    assert!(id.is_some());
}

/// Root mean square error of the position beside that of the mean of the last readings of both skins, of the last reading of the better skin, and of
/// the same filter on the better skin alone: the last rival has everything but the other skin.
#[test]
fn it_is_better_than_an_average_and_than_the_best_skin() {
    let (mut fused, mut average, mut best, mut n) = (0.0, 0.0, 0.0, 0.0);
    let (mut filtered, mut m) = (0.0, 0.0);
    for seed in 0..60 {
        let mut scenario = scenario(vec![Touch::resting(0.0, 9.0, 0.01, 0.02, 4.0)], 0.6);
        (scenario.seed, scenario.moves) = (500 + seed, true);
        (scenario.skins[0].position, scenario.skins[1].position) = (2e-3, 4e-3);
        scenario.rate = 20.0;
        scenario.run(|moment| {
            if moment.t < 0.2 {
                return;
            }
            let ([(_, truth)], [a], [b]) =
                (moment.truth.as_slice(), moment.last[0].as_slice(), moment.last[1].as_slice())
            else {
                panic!("one touch")
            };
            let error = errors(moment)[0].1.as_ref().unwrap().0;
            fused += error.norm_squared();
            average += ((a + b) * 0.5 - truth.position).norm_squared();
            best += (a - truth.position).norm_squared();
            n += 1.0;
        });
        // Touch and readings are drawn before those of further skins, so that they are the same again.
        scenario.skins.truncate(1);
        scenario.run(|moment| {
            if moment.t < 0.2 {
                return;
            }
            filtered += errors(moment)[0].1.as_ref().unwrap().0.norm_squared();
            m += 1.0;
        });
    }
    assert_eq!(n, m, "both are asked equally often");
    let [fused, average, best, filtered] = [fused, average, best, filtered].map(|sum: f64| (sum / n).sqrt());
    println!(
        "root mean square: fused {fused} m, average {average} m, best skin {best} m, filtered {filtered} m"
    );
    assert!(fused < 0.9 * average.min(best), "fused {fused} m, average {average} m, best skin {best} m");
    assert!(
        fused < filtered && filtered < best,
        "fused {fused} m, best skin {best} m, filtered {filtered} m"
    );
}
