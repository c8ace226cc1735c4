use dermis_fixtures::Analytic;
use dermis_model::{TipShape, Unknowns};
use proptest::prelude::*;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal, Uniform};

use super::*;
use crate::over_surface;
use crate::testing::{dome, grid, ideal, read, row, thesis_row};

/// Root mean square of the position error \[m\] of noisy frames at random locations, and how many are not solved.
fn errors(
    model: &Analytic,
    solver: &IsolineSolver,
    locations: &[Point3<f64>],
    force: f64,
    taxels: usize,
    noise: f64,
) -> (f64, usize) {
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(11);
    let (mut squares, mut solved) = (0.0, 0);
    for location in locations {
        let values: Vec<f64> = read(model, location, force)
            .into_iter()
            .map(|v| {
                let n: f64 = StandardNormal.sample(&mut random);
                v + noise * n
            })
            .collect();
        if let Some(found) = solver.solve(&values, taxels) {
            squares += (found.position - location).norm_squared();
            solved += 1;
        }
    }
    ((squares / f64::from(solved.max(1))).sqrt(), locations.len() - solved as usize)
}

fn on_line(count: u32) -> Vec<Point3<f64>> {
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(3);
    let x = Uniform::new(-0.016, 0.016).unwrap();
    (0..count).map(|_| Point3::new(x.sample(&mut random), 0.0, 0.0)).collect()
}

fn on_grid(count: u32) -> Vec<Point3<f64>> {
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(3);
    let x = Uniform::new(-0.008, 0.008).unwrap();
    (0..count).map(|_| Point3::new(x.sample(&mut random), x.sample(&mut random), 0.0)).collect()
}

#[test]
fn without_noise_the_contact_is_found() {
    let model = row(6);
    let solver =
        IsolineSolver::line_of_model(&model, &Point3::origin(), &Vector3::x(), &SolverOptions::line())
            .unwrap();
    for taxels in [2, 3, 6] {
        let (rms, missed) = errors(&model, &solver, &on_line(50), 0.7, taxels, 0.0);
        assert!(rms < 5e-6 && missed == 0, "{taxels}: {rms}, {missed} missed");
    }
    let found = solver.solve(&read(&model, &Point3::new(0.004, 0.0, 0.0), 0.5), 3).unwrap();
    assert!(found.crossed && (found.force - 0.5).abs() < 1e-3 && found.channels[0] == 3, "{found:?}");
    // One taxel is not enough, nor is noise.
    assert!(solver.solve(&[0.0, 0.0, 50.0, 3.0, f64::NAN, 0.0], 2).is_none());
}

#[test]
fn on_a_surface_three_or_four_find_it() {
    let model = grid();
    let spec = SurfaceSpec::Rectangle { size: [0.04, 0.04], spacing: 0.005 };
    let solver = IsolineSolver::surface_of_model(&model, &spec, &SolverOptions::surface()).unwrap();
    for taxels in [3, 4] {
        let (rms, missed) = errors(&model, &solver, &on_grid(40), 0.7, taxels, 0.0);
        assert!(rms < 3e-5 && missed == 0, "{taxels}: {rms}, {missed} missed");
    }
    assert_eq!(solver.needed(), 3);
}

#[test]
fn on_a_dome_three_find_it() {
    let model = dome();
    let spec = SurfaceSpec::Dome { radius: 0.010, cylinder: 0.016, spacing: 0.001 };
    let options = SolverOptions { step: 1e-3, ..SolverOptions::surface() };
    let solver = IsolineSolver::surface_of_model(&model, &spec, &options).unwrap();
    let locations: Vec<Point3<f64>> = [(0.2, 0.9), (1.0, 0.6), (3.0, 0.3), (5.0, 0.1)]
        .map(|(turn, up): (f64, f64)| {
            let r = 0.01 * (1.0f64 - up * up).sqrt();
            Point3::new(r * turn.cos(), r * turn.sin(), 0.016 + 0.01 * up)
        })
        .to_vec();
    let (rms, missed) = errors(&model, &solver, &locations, 0.7, 3, 0.0);
    assert!(rms < 2e-4 && missed == 0, "{rms}, {missed} missed");
}

fn row_solver(model: &dyn ForwardModel, averaging: Averaging) -> IsolineSolver {
    let options = SolverOptions { averaging, ..SolverOptions::line() };
    IsolineSolver::line_of_model(model, &Point3::origin(), &Vector3::x(), &options).unwrap()
}

#[test]
fn three_taxels_beat_two_on_the_isolines_of_the_theory() {
    // Parabolas, one σ_S the same force everywhere, crossings averaged as the thesis does.
    let model = ideal(6, 2.0, 0.02);
    let options = SolverOptions {
        averaging: Averaging::Plain,
        force_max: 40.0,
        threshold: 3.0,
        ..SolverOptions::line()
    };
    let solver = IsolineSolver::line_of_model(&model, &Point3::origin(), &Vector3::x(), &options).unwrap();
    let locations: Vec<Point3<f64>> = on_line(300).iter().map(|p| p * 0.6).collect();
    let of = |taxels| errors(&model, &solver, &locations, 6.0, taxels, 0.02).0;
    let (two, three) = (of(2), of(3));
    assert!(three < 0.85 * two, "{three} {two}");
}

#[test]
fn three_taxels_beat_two_in_an_elastic_layer_where_crossings_are_weighted() {
    let model = thesis_row();
    let (plain, weighted) = (row_solver(&model, Averaging::Plain), row_solver(&model, Averaging::Weighted));
    let locations = on_line(400);
    for force in [0.5, 1.05] {
        let of = |solver: &IsolineSolver, taxels| errors(&model, solver, &locations, force, taxels, 20.0).0;
        let (two, three) = (of(&weighted, 2), of(&weighted, 3));
        assert!(three < two, "{force} N: {three} {two}");
        let bound = over_surface(&model, force, TipShape::Sphere { diameter: 0.004 }, Unknowns::Line)
            .unwrap()
            .position
            .rms;
        assert!(three > 0.9 * bound && two < 1.15 * bound, "{force} N: {three} {two}, bound {bound}");
        // Two taxels on the same side of a contact have nearly parallel isolines here: what the thesis averages spoils it.
        assert!(of(&plain, 3) > 2.0 * two);
    }
    // The isolines of the design, on devices whose gains and locations are off: the error is theirs, not that of noise.
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(4);
    let (mut two, mut three) = (0.0, 0.0);
    for _ in 0..8 {
        let mut device = thesis_row();
        for element in &mut device.elements {
            let mut draw = || -> f64 { StandardNormal.sample(&mut random) };
            element.gain = (0.1 * draw()).exp();
            element.at.x += 3e-4 * draw();
        }
        two += errors(&device, &weighted, &locations[..100], 0.5, 2, 20.0).0.powi(2);
        three += errors(&device, &weighted, &locations[..100], 0.5, 3, 20.0).0.powi(2);
    }
    assert!(three < two, "{} {}", three.sqrt(), two.sqrt());
}

#[test]
fn presses_teach_it_as_the_model_does() {
    let model = row(6);
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(1);
    let (location, force) = (Uniform::new(-0.02, 0.02).unwrap(), Uniform::new(0.01, 1.5).unwrap());
    let presses: Vec<Press> = (0..5000)
        .map(|_| {
            let position = Point3::new(location.sample(&mut random), 0.0, 0.0);
            let force = force.sample(&mut random);
            Press { position, force, readings: read(&model, &position, force) }
        })
        .collect();
    let options = SolverOptions { step: 5e-4, force_max: 1.5, ..SolverOptions::line() };
    let solver = IsolineSolver::line_of_presses(
        &presses,
        model.noise(),
        model.surface(),
        &Point3::origin(),
        &Vector3::x(),
        &options,
    )
    .unwrap();
    let (rms, missed) = errors(&model, &solver, &on_line(50), 0.7, 3, 0.0);
    assert!(rms < 1e-4 && missed == 0, "{rms}, {missed} missed");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]
    #[test]
    fn no_frame_panics(values in proptest::collection::vec(any::<f64>(), 0..9), taxels in 0usize..9) {
        let model = row(6);
        let options = SolverOptions { step: 1e-3, ..SolverOptions::line() };
        let solver = IsolineSolver::line_of_model(&model, &Point3::origin(), &Vector3::x(), &options).unwrap();
        let _ = solver.solve(&values, taxels);
    }
}
