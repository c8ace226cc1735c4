use approx::assert_relative_eq;
use dermis_fixtures::Analytic;
use dermis_model::{ForwardModel, TipShape, Unknowns};

use super::*;
use crate::testing::{dome, grid, row, thesis_row, toy};
use crate::{Responses, force_ladder, over_surface};

fn study() -> (LineStudy, Analytic) {
    let model = thesis_row();
    let (path, tolerance) = longest_row(model.surface(), &model.locations(), 1.25e-4).unwrap();
    let responses = Responses::of_model(&model, &path.points, &force_ladder(2.5, 40), 0.004).unwrap();
    let line = Line::new(responses, &path, model.surface(), &model.locations(), tolerance).unwrap();
    let options = StudyOptions {
        least: 100.0,
        values: (0..8).map(|i| 200.0 * 1.6f64.powi(i)).collect(),
        forces: vec![0.1, 0.3, 0.5, 1.0, 1.4],
        map_forces: vec![0.2, 1.0],
        step: 5e-4,
        testbed: Testbed::THESIS,
    };
    let mut seen = 0.0;
    let study = line.study(&options, |share| {
        assert!(share >= seen);
        seen = share;
    });
    assert_relative_eq!(seen, 1.0);
    (study, model)
}

#[test]
fn the_row_of_the_thesis() {
    let (study, model) = study();
    assert_eq!(study.taxels.len(), 6);
    assert_relative_eq!(study.span, 0.0325, max_relative = 1e-6);
    for taxel in &study.taxels {
        // physics.md: 0.141 N/kPa at a light touch; a deeper contact spreads and reads less.
        assert!((0.135e-3..0.175e-3).contains(&taxel.c) && taxel.nonlinearity < 0.1, "{taxel:?}");
        // α falls with the value.
        assert!(taxel.fits[0].alpha > taxel.fits[taxel.fits.len() - 1].alpha);
        // c grows with the distance.
        assert!(taxel.c_by_distance.iter().all(|[d, c]| *c > 0.0 && (d.abs() < 1e-3 || *c > taxel.c * 0.9)));
    }
    // Less between two taxels than above one, and least where most taxels are near.
    let least = |x: f64| study.minimum_force[((x + 0.01625) / 1.25e-4).round() as usize].unwrap();
    assert!(least(0.0) < least(0.00325) && least(-0.01625) > least(0.0));
    for by in &study.by_force {
        let bound = over_surface(&model, by.force, TipShape::Sphere { diameter: 0.004 }, Unknowns::Line)
            .unwrap()
            .position
            .rms;
        assert_relative_eq!(by.bound.unwrap().position_rms, bound, max_relative = 0.05);
        let (fits, corners) = (by.fits.unwrap(), by.corners.unwrap());
        assert!((0.2..5.0).contains(&(fits.position / corners.position)), "{by:?}");
        // A box is wider than a standard deviation.
        assert!(corners.position > by.bound.unwrap().position);
        assert!(fits.factor_with_testbed < fits.factor);
    }
    // More force, more resolution; more taxels and more force, smaller boxes.
    assert!(study.by_force.windows(2).all(|w| w[1].corners.unwrap().factor > w[0].corners.unwrap().factor));
    let middle = study.map.arc.len() / 2;
    assert!(study.map.position[1][middle].unwrap() < study.map.position[0][middle].unwrap());
}

#[test]
fn rows_are_found_on_any_surface() {
    let grid = grid();
    let feet = grid.locations();
    let (path, tolerance) = longest_row(grid.surface(), &feet, 0.001).unwrap();
    // Through the middle, along x.
    assert!(path.points.iter().all(|p| p.y == 0.0) && (tolerance - 0.0012).abs() < 1e-9);
    let dome = dome();
    let (path, _) = longest_row(dome.surface(), &dome.locations(), 0.0005).unwrap();
    let on = dome.locations().iter().filter(|f| path.nearest(f).1 < 0.001).count();
    assert!(on >= 5, "{on}");
    assert!(longest_row(grid.surface(), &feet[..1], 0.001).is_err());
}

/// Six taxels in a row, `each` of whose channels read the same.
fn shared(each: usize) -> (Line, Vec<Point3<f64>>, Analytic) {
    let each_of = |at: Point3<f64>| std::iter::repeat_n((at.x, at.y), each);
    let model = toy(&row(6).locations().into_iter().flat_map(each_of).collect::<Vec<_>>());
    let feet = model.locations();
    let (path, tolerance) = longest_row(model.surface(), &feet, 5e-4).unwrap();
    let responses = Responses::of_model(&model, &path.points, &force_ladder(2.0, 20), 0.004).unwrap();
    (Line::new(responses, &path, model.surface(), &feet, tolerance).unwrap(), feet, model)
}

#[test]
fn channels_that_share_a_taxel_make_no_other_row() {
    let ((one, feet, model), (many, ..)) = (shared(1), shared(12));
    assert_eq!((one.taxels().len(), many.taxels().len()), (6, 72));
    assert_eq!((one.arc(), one.span()), (many.arc(), many.span()));
    // A taxel beside the row that has more channels than all of the row decides where the row is.
    let beside = Point3::new(0.0, 0.01, 0.0);
    let weighted: Vec<_> = feet.iter().copied().chain(std::iter::repeat_n(beside, 20)).collect();
    let (path, _) = longest_row(model.surface(), &weighted, 5e-4).unwrap();
    assert!(path.points.iter().all(|p| p.y == 0.01), "{:?}", path.points[0]);
}

#[test]
fn of_many_channels_those_are_studied_that_are_next_to_some_place() {
    let options = StudyOptions {
        least: 10.0,
        values: vec![20.0, 40.0, 80.0],
        forces: vec![0.2, 0.6],
        map_forces: vec![0.5],
        step: 1e-3,
        testbed: Testbed::THESIS,
    };
    let [few, many] = [1, 12].map(|each| shared(each).0);
    let [one, study] = [&few, &many].map(|line| line.study(&options, |_| ()));
    assert_eq!((one.count, one.taxels.len()), (6, 6));
    // The first and the last of each taxel; at both ends of the row, where both next ones are of one taxel, one more.
    assert_eq!((study.count, study.taxels.len()), (72, 14));
    for arc in many.arc() {
        let next = many.pair(*arc).map(|t| t.channel);
        assert!(next.iter().all(|c| study.taxels.iter().any(|t| t.channel == *c)));
    }
    // Twelve channels of one taxel average.
    let mean = |study: &LineStudy| study.by_force[1].bound.unwrap().position;
    assert_relative_eq!(mean(&one) / mean(&study), f64::sqrt(12.0), max_relative = 1e-6);
}

#[test]
fn bands_of_the_clearest_channels_are_overlapped() {
    let (_, feet, mut model) = shared(10);
    // The first channels of the row are the noisiest.
    model.noise.iter_mut().enumerate().for_each(|(k, noise)| *noise = 100.0 - k as f64);
    let (path, tolerance) = longest_row(model.surface(), &feet, 5e-4).unwrap();
    let responses = Responses::of_model(&model, &path.points, &force_ladder(2.0, 20), 0.004).unwrap();
    let line = Line::new(responses, &path, model.surface(), &feet, tolerance).unwrap();
    let location = line.location(line.taxels()[59].foot);
    let mut channels: Vec<usize> = (0..60).collect();
    line.clearest(location, 1.0, &mut channels);
    // Above the last taxel every one before it is farther away, and noisier.
    assert_eq!(channels, (28..60).collect::<Vec<_>>());
    let mut few = vec![7, 3];
    line.clearest(location, 1.0, &mut few);
    assert_eq!(few, [7, 3]);
}

#[test]
fn bounds_under_many_forces_are_those_under_each() {
    let (line, ..) = shared(2);
    let forces = [0.1, 0.6, 1.9, 1.99, 3.0];
    for location in [0, line.arc().len() / 2, line.arc().len() - 1] {
        let all = line.bounds(location, &forces);
        assert_eq!(all, forces.map(|force| line.bound(location, force)));
        // What lies beyond the table, or a step beyond it, is not known.
        assert!(all[2].is_some() && all[3].is_none() && all[4].is_none(), "{all:?}");
    }
}
