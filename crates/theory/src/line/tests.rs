use approx::assert_relative_eq;
use dermis_fixtures::Analytic;
use dermis_model::{ForwardModel, Unknowns};
use nalgebra::Vector3;

use super::*;
use crate::normalised::TwoTaxels;
use crate::testing::{IDEAL_DISTANCE, dome, ideal, row, toy};
use crate::{cramer_rao, force_ladder};

fn toy_row(step: f64, noise: f64) -> (Line, Analytic) {
    let mut model = row(6);
    model.noise.fill(noise);
    let path = Path::across(model.surface(), &Point3::origin(), &Vector3::x(), step).unwrap();
    let responses = Responses::of_model(&model, &path.points, &force_ladder(3.0, 30), 0.004).unwrap();
    (Line::new(responses, &path, model.surface(), &model.locations(), 0.001).unwrap(), model)
}

/// Place at x.
fn at(line: &Line, x: f64) -> usize {
    line.location(x + 0.02)
}

#[test]
fn taxels_lie_in_order() {
    let (line, _) = toy_row(0.0005, 2.0);
    assert_relative_eq!(line.span(), 0.0325, max_relative = 1e-6);
    assert_eq!(line.pair(0.02).map(|t| t.channel), [2, 3]);
    assert_eq!(line.pair(0.0).map(|t| t.channel), [0, 1]);
    assert_eq!(line.pair(0.04).map(|t| t.channel), [4, 5]);
}

#[test]
fn corners_tend_to_the_closed_form_and_to_the_slopes_of_the_toy() {
    let (x, force) = (0.001, 0.8);
    // F = S (h + d²/h): σ_P = σ (c₁ + c₂) / |m₁ − m₂| with m = 2 S d / h.
    let h = 0.005;
    let (d1, d2) = (x + 0.00325, x - 0.00325);
    let c = |d: f64| h + d * d / h;
    let m = |d: f64| 2.0 * (force / c(d)) * d / h;
    let exact = |sigma: f64| sigma * (c(d1) + c(d2)) / (m(d1) - m(d2)).abs();
    for sigma in [1.0, 0.25] {
        let (line, _) = toy_row(0.00005, sigma);
        let location = at(&line, x);
        let corners = line.corners(location, force, [2, 3]).unwrap();
        let first = line.first_order(location, force, [2, 3]).unwrap();
        assert_relative_eq!(first.position, exact(sigma), max_relative = 2e-3);
        assert_relative_eq!(corners.position, first.position, max_relative = 5e-3);
        assert_relative_eq!(corners.force, first.force, max_relative = 2e-2);
    }
}

/// The thesis' setting, with `count` taxels.
fn ideal_line(count: usize, alpha: f64, sigma: f64) -> (Line, Analytic) {
    let model = ideal(count, alpha, sigma);
    let path = Path::across(model.surface(), &Point3::origin(), &Vector3::x(), 0.00005).unwrap();
    let responses = Responses::of_model(&model, &path.points, &force_ladder(20.0, 60), 0.004).unwrap();
    (Line::new(responses, &path, model.surface(), &model.locations(), 0.001).unwrap(), model)
}

#[test]
fn a_line_of_two_is_the_normalised_setting() {
    for alpha in [1.5, 2.0, 3.0] {
        let (line, model) = ideal_line(2, alpha, 0.02);
        let two = TwoTaxels::normalised(alpha).unwrap();
        for x in [-0.002, 0.0, 0.001, 0.004] {
            let location = at(&line, x);
            let contact = (line.responses().points()[location].x - model.elements[0].at.x) / IDEAL_DISTANCE;
            let (found, expected) =
                (line.corners(location, 2.0, [0, 1]).unwrap(), two.corners(contact, 0.02));
            assert_relative_eq!(found.position / IDEAL_DISTANCE, expected.position, max_relative = 5e-3);
            assert_relative_eq!(found.force, expected.force, max_relative = 1e-2);
        }
    }
}

#[test]
fn taxels_further_away_locate_better_where_the_noise_is_the_same_force() {
    // Fig. 5.4: each band of a pair twice as far apart is crossed twice as steeply.
    let (line, _) = ideal_line(4, 2.0, 0.02);
    let location = at(&line, 0.0005);
    let of = |channels: &[usize]| line.corners_of_all(location, 6.0, channels).unwrap().position;
    let (two, three, four) = (of(&[1, 2]), of(&[1, 2, 3]), of(&[0, 1, 2, 3]));
    assert_relative_eq!(two, 0.02 * 0.005, max_relative = 5e-3);
    assert_relative_eq!(three / two, 0.5, max_relative = 5e-3);
    assert_relative_eq!(four / two, 1.0 / 3.0, max_relative = 5e-3);
    // F_S is lower between taxels than above one.
    let least = |x: f64| line.responses().minimum_force(at(&line, x), 0.1, 2).unwrap();
    assert_relative_eq!(least(0.0), 0.35, max_relative = 1e-3);
    assert_relative_eq!(least(0.0025), 1.1, max_relative = 1e-3);
}

#[test]
fn fits_of_parabolas_give_the_same() {
    let (line, _) = toy_row(0.0001, 1.0);
    let values: Vec<f64> = (1..=20).map(|i| f64::from(i) * 10.0).collect();
    let pair = line.pair(0.021);
    let fits = pair.map(|t| line.fits(&t, &values));
    let (location, force) = (line.location(0.021), 0.6);
    let found = line.by_fits(location, force, &pair, [&fits[0], &fits[1]]).unwrap();
    let first = line.first_order(location, force, pair.map(|t| t.channel)).unwrap();
    // Two different c, of which (5.18) takes one.
    assert!((found.position / first.position - 1.0).abs() < 0.35, "{found:?} {first:?}");
}

#[test]
fn more_taxels_locate_no_worse() {
    let (line, model) = toy_row(0.0001, 2.0);
    for x in [-0.006, 0.0, 0.0013] {
        let location = at(&line, x);
        let pair = line.pair(line.arc()[location]).map(|t| t.channel);
        let two = line.corners(location, 0.8, pair).unwrap().position;
        let of = |channels: &[usize]| line.corners_of_all(location, 0.8, channels).unwrap().position;
        assert_relative_eq!(of(&pair), two, max_relative = 1e-6);
        let (four, six) = (of(&[1, 2, 3, 4]), of(&[0, 1, 2, 3, 4, 5]));
        // Taxels that lie further away have steeper isolines, but here one σ_S of them is more force.
        assert!(four <= two && six <= four, "{two} {four} {six}");
        // And the box that holds all bands is wider than what their average would have, which is the bound.
        let contact = dermis_model::Indentation::sphere(
            line.responses().points()[location],
            Vector3::new(0.0, 0.0, -0.8),
            0.004,
        );
        let stimulus = dermis_model::Stimulus { contacts: vec![contact], ..Default::default() };
        let bound = cramer_rao(&model, &stimulus, Unknowns::Line).unwrap()[0].position;
        assert!(bound < six * 1.05, "{bound} {six}");
    }
}

#[test]
fn equal_taxels_average() {
    // √n: four at each place of two.
    let model = |n: usize| {
        let feet: Vec<_> = (0..n).flat_map(|_| [(-0.00325, 0.0), (0.00325, 0.0)]).collect();
        toy(&feet)
    };
    let bound = |n| {
        let contact = dermis_model::Indentation::sphere(
            Point3::new(0.001, 0.0, 0.0),
            Vector3::new(0.0, 0.0, -0.5),
            0.004,
        );
        let stimulus = dermis_model::Stimulus { contacts: vec![contact], ..Default::default() };
        cramer_rao(&model(n), &stimulus, Unknowns::Line).unwrap()[0].position
    };
    assert_relative_eq!(bound(1) / bound(4), 2.0, max_relative = 1e-6);
}

#[test]
fn less_force_is_needed_between_taxels() {
    let (line, _) = toy_row(0.0005, 2.0);
    let least = |x: f64| line.responses().minimum_force(at(&line, x), 50.0, 2).unwrap();
    assert!(least(0.0) < least(0.00325), "{} {}", least(0.0), least(0.00325));
    // Ever more taxels need ever more force.
    let more = |n| line.responses().minimum_force(at(&line, 0.0), 10.0, n).unwrap();
    assert!(more(2) < more(3) && more(3) <= more(4));
}

#[test]
fn two_contacts_are_distinguished_where_each_has_taxels_of_its_own() {
    let (line, _) = toy_row(0.0005, 2.0);
    let (a, b) = (at(&line, -0.0130), at(&line, 0.0130));
    assert!(line.distinguishable((a, 0.3), (b, 0.3), 25.0, 2));
    assert!(!line.distinguishable((a, 0.3), (at(&line, -0.0065), 0.3), 25.0, 2));
    // Close together never; "with higher forces the distinguishable distance is larger": they reach more taxels.
    let resolved = |force: f64| line.distinguishable_by_distance(force, 25.0, &[0.004, 0.011, 0.012]);
    let (light, hard) = (resolved(0.3), resolved(0.6));
    assert_eq!((light[0], hard[0]), (0.0, 0.0));
    assert!(light[1] > hard[1] && light[2] > hard[2], "{light:?} {hard:?}");
}

#[test]
fn distances_on_a_dome_are_those_along_it() {
    let model = dome();
    let tip = Point3::new(0.0, 0.0, 0.026);
    let path = Path::across(model.surface(), &tip, &Vector3::x(), 0.0004).unwrap();
    let responses = Responses::of_model(&model, &path.points, &force_ladder(2.0, 20), 0.004).unwrap();
    let line = Line::new(responses, &path, model.surface(), &model.locations(), 0.001).unwrap();
    // Tip, upper and lower taxels on both sides.
    assert_eq!(line.taxels().len(), 5);
    let tip = line.taxels()[2];
    assert_eq!(tip.channel, 0);
    let fit = line.isoline(&tip, 40.0).fit().unwrap();
    // A parabola in the distance along the surface.
    assert_relative_eq!(fit.alpha, 2.0, max_relative = 0.01);
    assert_relative_eq!(fit.g, 40.0 * 0.005, max_relative = 0.01);
    let location = line.location(tip.foot + 0.003);
    let pair = line.pair(line.arc()[location]).map(|t| t.channel);
    let (exact, first) =
        (line.corners(location, 1.0, pair).unwrap(), line.first_order(location, 1.0, pair).unwrap());
    assert_relative_eq!(exact.position, first.position, max_relative = 0.05);
}

#[test]
fn a_ring_has_no_ends() {
    let model = dome();
    let path = Path::across(model.surface(), &Point3::new(0.01, 0.0, 0.016), &Vector3::y(), 0.0002).unwrap();
    let responses = Responses::of_model(&model, &path.points, &force_ladder(3.0, 20), 0.004).unwrap();
    let line = Line::new(responses, &path, model.surface(), &model.locations(), 0.001).unwrap();
    // Six taxels, the same everywhere between two of them, also where the path begins and ends.
    assert_eq!(line.taxels().len(), 6);
    assert_relative_eq!(line.span(), std::f64::consts::TAU * 0.01, max_relative = 1e-2);
    let sixth = line.span() / 6.0;
    let of = |i: usize| {
        let location = line.location((line.taxels()[0].foot + sixth * (0.3 + i as f64)) % line.span());
        let pair = line.pair(line.arc()[location]).map(|t| t.channel);
        let active = line.responses().active(location, 1.0, 20.0);
        let all = line.corners_of_all(location, 1.0, &active).unwrap();
        (line.corners(location, 1.0, pair).unwrap(), line.first_order(location, 1.0, pair).unwrap(), all)
    };
    let (first, ..) = of(0);
    for i in 0..6 {
        let (corners, linear, all) = of(i);
        assert_relative_eq!(corners.position, first.position, max_relative = 0.05);
        assert_relative_eq!(corners.position, linear.position, max_relative = 0.05);
        assert!(all.position <= corners.position * 1.001);
    }
    let fits = line.taxels().iter().map(|t| line.isoline(t, 40.0).fit().unwrap().alpha);
    assert!(fits.into_iter().all(|alpha| (alpha - 2.0).abs() < 0.02));
}

#[test]
fn one_taxel_is_no_line() {
    let model = row(1);
    let path = Path::across(model.surface(), &Point3::origin(), &Vector3::x(), 0.001).unwrap();
    let responses = Responses::of_model(&model, &path.points, &force_ladder(1.0, 5), 0.004).unwrap();
    let error = Line::new(responses, &path, model.surface(), &[Point3::origin()], 0.001).unwrap_err();
    insta::assert_snapshot!(error, @"1 taxels lie on the line where at least two must: their isolines have to cross");
}
