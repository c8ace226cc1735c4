use approx::assert_relative_eq;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal, Uniform};

use super::*;
use crate::testing::{read, row, shifted};

#[test]
fn a_reading_is_found_again_by_its_force() {
    let model = row(6);
    let points = [Point3::new(0.001, 0.0, 0.0), Point3::new(0.003, 0.0, 0.0)];
    let responses = Responses::of_model(&model, &points, &force_ladder(2.0, 30), 0.004).unwrap();
    for location in 0..2 {
        for channel in 0..6 {
            for force in [0.03, 0.4, 1.7] {
                let value = responses.reading(location, channel, force);
                assert_relative_eq!(
                    responses.force_for(location, channel, value).unwrap(),
                    force,
                    max_relative = 1e-9
                );
                // The toy is linear in the force: c is what it takes for one unit.
                let c = responses.slope(location, channel, value * 0.9).unwrap();
                assert_relative_eq!(c, force / value, max_relative = 1e-6);
            }
            assert_eq!(responses.force_for(location, channel, 1e9), None);
        }
    }
    assert!(responses.reading(0, 0, 2.1).is_nan());
    assert_relative_eq!(
        responses.minimum_force(0, 10.0, 2).unwrap(),
        responses.force_for(0, 3, 10.0).unwrap().max(responses.force_for(0, 2, 10.0).unwrap())
    );
}

#[test]
fn isolines_are_those_of_signals() {
    // An untouched reading above a value would be an isoline of no force at all.
    let points = [Point3::new(0.001, 0.0, 0.0), Point3::new(0.003, 0.0, 0.0)];
    let forces = force_ladder(2.0, 30);
    let plain = Responses::of_model(&row(6), &points, &forces, 0.004).unwrap();
    let resting = Responses::of_model(&shifted(row(6)), &points, &forces, 0.004).unwrap();
    assert_eq!(resting.reading(0, 2, 0.0), 0.0);
    for location in 0..2 {
        for channel in 0..6 {
            let [a, b] = [&plain, &resting].map(|r| r.force_for(location, channel, 20.0).unwrap());
            assert_relative_eq!(a, b, max_relative = 1e-9);
        }
    }
}

#[test]
fn presses_give_what_the_model_does() {
    // Presses at random locations of a row, each with noise.
    let model = row(6);
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(1);
    let (location, force) = (Uniform::new(-0.018, 0.018).unwrap(), Uniform::new(0.01, 1.5).unwrap());
    let presses: Vec<Press> = (0..6000)
        .map(|_| {
            let position = Point3::new(location.sample(&mut random), 0.0, 0.0);
            let force = force.sample(&mut random);
            let readings = read(&model, &position, force).into_iter().map(|v| {
                let noise: f64 = StandardNormal.sample(&mut random);
                v + model.noise()[0] * noise
            });
            Press { position, force, readings: readings.collect() }
        })
        .collect();
    let points: Vec<Point3<f64>> = (-16..=16).map(|i| Point3::new(f64::from(i) * 1e-3, 0.0, 0.0)).collect();
    let forces = force_ladder(1.4, 14);
    let exact = Responses::of_model(&model, &points, &forces, 0.004).unwrap();
    let found =
        Responses::of_presses(&presses, model.noise(), model.surface(), &points, &forces, 0.0015).unwrap();
    let mut errors = Vec::new();
    for location in 0..points.len() {
        for channel in 0..6 {
            for force in [0.3, 0.7, 1.3] {
                errors
                    .push(found.reading(location, channel, force) - exact.reading(location, channel, force));
            }
        }
    }
    let rms = (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt();
    // Some forty presses lie in a window: better than a single one by far.
    assert!(rms < 0.5 * model.noise()[0], "{rms}");
    assert!(Responses::of_presses(&presses, &[2.0; 5], model.surface(), &points, &forces, 0.001).is_err());
}

#[test]
fn noise_is_distinguished_from_drift() {
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(5);
    let mut stretch = |sigma: f64| -> Vec<Vec<f64>> {
        (0..2000)
            .map(|i| {
                let noise: f64 = StandardNormal.sample(&mut random);
                vec![sigma * noise + 0.05 * f64::from(i), if i == 7 { f64::NAN } else { 1.0 }]
            })
            .collect()
    };
    let stretches = [stretch(20.0), stretch(20.0)];
    let found = noise_of_repeats(stretches.iter().map(Vec::as_slice), 2).unwrap();
    assert_relative_eq!(found[0], 20.0, max_relative = 0.05);
    assert_eq!(found[1], 0.0);
    assert_eq!(noise_of_repeats([&stretches[0][..1]], 2), None);
}

#[test]
fn forces_ascend_from_nothing() {
    let error = Responses::of_model(&row(2), &[], &[0.1, 0.2], 0.004).unwrap_err();
    insta::assert_snapshot!(error, @"forces of a table must ascend from 0");
}

#[test]
fn a_signal_that_falls_has_the_isolines_of_one_that_rises() {
    let points = [Point3::new(0.001, 0.0, 0.0), Point3::new(0.003, 0.0, 0.0)];
    let forces = force_ladder(2.0, 30);
    let mut model = row(6);
    let plain = Responses::of_model(&model, &points, &forces, 0.004).unwrap();
    model.elements.iter_mut().step_by(2).for_each(|element| element.gain = -1.0);
    let falling = Responses::of_model(&model, &points, &forces, 0.004).unwrap();
    for channel in 0..6 {
        assert_eq!(falling.orientation(channel), if channel % 2 == 0 { -1.0 } else { 1.0 });
        assert_eq!(falling.peak(channel), plain.peak(channel));
        for location in 0..2 {
            assert_eq!(falling.curve(location, channel), plain.curve(location, channel));
            assert_eq!(falling.force_for(location, channel, 20.0), plain.force_for(location, channel, 20.0));
            assert!(falling.force_for(location, channel, 20.0).is_some());
        }
    }
    assert_eq!(falling.minimum_force(0, 10.0, 3), plain.minimum_force(0, 10.0, 3));
    assert_eq!(falling.active(0, 1.0, 10.0), plain.active(0, 1.0, 10.0));
    // As another table has it.
    let as_plain = falling.clone().oriented_as(&plain);
    assert_eq!((as_plain.orientation(0), as_plain.reading(0, 0, 1.0)), (1.0, -plain.reading(0, 0, 1.0)));
    assert_eq!(as_plain.force_for(0, 0, 20.0), None);
}

#[test]
fn of_a_signal_that_rises_and_falls_the_first_branch_counts() {
    // F (1 − F/2) has its most, a half, at 1 N, and is 0 again at 2 N.
    let spec = dermis_skin::SurfaceSpec::Rectangle { size: [0.04, 0.04], spacing: 0.005 };
    let surface = Surface::from_spec(&spec);
    let humped = |sign: f64| {
        dermis_fixtures::Analytic::new(surface.clone(), [Point3::origin()], 1e-3, move |c, _| {
            sign * -c.force.z * (1.0 + c.force.z / 2.0)
        })
    };
    for sign in [1.0, -1.0] {
        let responses =
            Responses::of_model(&humped(sign), &[Point3::origin()], &force_ladder(1.99, 400), 0.004).unwrap();
        assert_eq!(responses.orientation(0), sign);
        // 3/8 is read at a half and at one and a half newtons.
        assert_relative_eq!(responses.force_for(0, 0, 0.375).unwrap(), 0.5, max_relative = 1e-3);
        assert_eq!(responses.force_for(0, 0, 0.51), None);
    }
}

#[test]
fn a_reading_below_zero_that_rises_is_not_turned() {
    // The normalised setting reads −30 or less far from a taxel, and one unit more for each newton everywhere.
    let model = crate::testing::ideal(6, 2.0, 0.02);
    let points = [Point3::new(-0.02, 0.0, 0.0), Point3::new(0.02, 0.0, 0.0)];
    let responses = Responses::of_model(&model, &points, &force_ladder(10.0, 20), 0.004).unwrap();
    assert!(responses.reading(0, 5, 0.0) < -30.0, "{}", responses.reading(0, 5, 0.0));
    assert!((0..6).all(|channel| responses.orientation(channel) == 1.0));
}
