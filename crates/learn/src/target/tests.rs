use dermis_fixtures::Analytic;

use super::*;
use crate::dataset::tests::{contact, skin};

fn truth(contacts: Vec<TruthContact>) -> Truth {
    Truth { press: 0, location: 0, idle: contacts.is_empty(), contacts }
}

fn fine() -> SkinDescription {
    let mut skin = skin();
    if let dermis_skin::SurfaceSpec::Rectangle { spacing, .. } = &mut skin.surface {
        *spacing = 0.0005;
    }
    skin
}

/// Gives way in proportion to the force, at the nearest point only.
fn soft(skin: &SkinDescription) -> Analytic {
    Analytic::of_skin(skin, |_, _| 0.0).on_spring(25e3, 1.0).displaced_by(|surface, stimulus, out| {
        out.fill(0.0);
        for contact in &stimulus.contacts {
            for (i, share) in
                shares(surface, &contact.position, Patch { radius: 0.0, pressure: Pressure::Hertz })
            {
                out[i] -= 1e-3 * share * contact.force.z;
            }
        }
    })
}

#[test]
fn a_force_is_spread_over_its_patch_and_none_is_lost() {
    let skin = fine();
    let mut maps = Maps::new(&skin, None, &[MapTarget::Normal]).unwrap();
    let mut map = Vec::new();
    let mut oblique = contact(0.003, -0.002, 2.0);
    oblique.force.x = 0.5;
    let both = truth(vec![oblique, contact(-0.004, 0.001, 1.0)]);
    maps.append(MapTarget::Normal, &both, &mut map).unwrap();
    approx::assert_relative_eq!(map.iter().sum::<f64>(), 3.0, max_relative = 1e-9);
    // The centre of pressure is where the tips are, and nothing acts elsewhere.
    let surface = skin.surface();
    let (mut moment, mut outside) = (0.0, 0.0);
    for (point, force) in surface.points.iter().zip(&map) {
        moment += point.x * force;
        let near =
            [(0.003, -0.002), (-0.004, 0.001)].iter().any(|(x, y)| (point.x - x).hypot(point.y - y) < 0.001);
        outside += if near { 0.0 } else { force.abs() };
    }
    approx::assert_relative_eq!(moment, 2.0 * 0.003 - 0.004, epsilon = 2e-5);
    assert_eq!(outside, 0.0);
    assert!(map.iter().filter(|f| **f > 0.0).count() > 15);

    let mut forces = Vec::new();
    maps.append(MapTarget::Force, &both, &mut forces).unwrap();
    let sum = |axis: usize| forces.iter().skip(axis).step_by(3).sum::<f64>();
    approx::assert_relative_eq!(sum(0), 0.5, max_relative = 1e-9);
    approx::assert_relative_eq!(sum(2), -3.0, max_relative = 1e-9);
}

#[test]
fn profiles_are_those_of_the_thesis() {
    let skin = fine();
    let surface = skin.surface();
    // A ball of 4 mm on a point: σ is 2 mm, and points are 0.5 mm apart.
    let middle = surface.points.iter().min_by(|a, b| a.coords.norm().total_cmp(&b.coords.norm())).unwrap();
    let at = TruthContact { diameter: 0.004, ..contact(middle.x, middle.y, 2.0) };
    let map = |profile| {
        let mut maps = Maps::new(&skin, None, &[MapTarget::Normal]).unwrap().spread_by(profile);
        let mut map = Vec::new();
        maps.append(MapTarget::Normal, &truth(vec![at.clone()]), &mut map).unwrap();
        approx::assert_relative_eq!(map.iter().sum::<f64>(), 2.0, max_relative = 1e-9);
        map
    };
    let value = |map: &[f64], x: f64| {
        let found = surface.points.iter().position(|p| (p.x - middle.x - x).hypot(p.y - middle.y) < 1e-6);
        map[found.unwrap()]
    };
    let ratio = |profile, x: f64| {
        let map = map(profile);
        value(&map, x) / value(&map, 0.0)
    };
    approx::assert_relative_eq!(ratio(ForceProfile::Uniform, 1e-3), 1.0, max_relative = 1e-9);
    approx::assert_relative_eq!(ratio(ForceProfile::Hertz, 1e-3), 0.75_f64.sqrt(), max_relative = 1e-9);
    approx::assert_relative_eq!(
        ratio(ForceProfile::Gaussian, 1e-3),
        (-1.0_f64 / 3.2).exp(),
        max_relative = 1e-9
    );
    approx::assert_relative_eq!(
        ratio(ForceProfile::Laplacian1, 1e-3),
        (-1.0_f64 / 1.74).exp(),
        max_relative = 1e-9
    );
    approx::assert_relative_eq!(ratio(ForceProfile::Laplacian2, 3e-3), (-3.0_f64).exp(), max_relative = 1e-9);
    // Cut at σ, or at twice that.
    for profile in [ForceProfile::Uniform, ForceProfile::Hertz] {
        assert_eq!(value(&map(profile), 2.5e-3), 0.0);
    }
    for profile in [ForceProfile::Gaussian, ForceProfile::Laplacian1, ForceProfile::Laplacian2] {
        assert!(value(&map(profile), 3.5e-3) > 0.0);
        assert_eq!(value(&map(profile), 4.5e-3), 0.0);
    }
}

#[test]
fn a_flat_tip_presses_evenly_on_its_face() {
    let skin = fine();
    let model: Arc<dyn ForwardModel> = Arc::new(soft(&skin));
    for model in [None, Some(model)] {
        let mut maps = Maps::new(&skin, model, &[MapTarget::Normal]).unwrap();
        let mut map = Vec::new();
        let flat = TruthContact { flat: true, ..contact(0.0, 0.0, 3.0) };
        maps.append(MapTarget::Normal, &truth(vec![flat]), &mut map).unwrap();
        approx::assert_relative_eq!(map.iter().sum::<f64>(), 3.0, max_relative = 1e-9);
        let pressed: Vec<f64> = map.iter().copied().filter(|f| *f > 0.0).collect();
        // Points of a grid of 0.5 mm within 2 mm of one of them, the four on the rim included.
        assert_eq!(pressed.len(), 49);
        assert!(pressed.iter().all(|f| (f / pressed[0] - 1.0).abs() < 1e-9), "{pressed:?}");
    }
}

#[test]
fn a_patch_grows_with_the_depth_and_the_nearest_point_stands_in_for_a_small_one() {
    let skin = fine();
    let model: Arc<dyn ForwardModel> = Arc::new(soft(&skin));
    let mut maps = Maps::new(&skin, Some(model), &MapTarget::ALL).unwrap();
    let mut touched = |newtons: f64| {
        let mut map = Vec::new();
        maps.append(MapTarget::Normal, &truth(vec![contact(0.001, 0.001, newtons)]), &mut map).unwrap();
        approx::assert_relative_eq!(map.iter().sum::<f64>(), newtons, max_relative = 1e-9);
        map.iter().filter(|f| **f > 0.0).count()
    };
    let counts = [touched(0.01), touched(5.0), touched(20.0)];
    assert_eq!(counts[0], 1);
    assert!(counts[1] > 1 && counts[2] > counts[1], "{counts:?}");
}

#[test]
fn the_signal_is_what_the_model_reads_minus_its_zero() {
    let skin = skin();
    // Rests at 7 and reads 2 per newton and channel.
    let model = Analytic::of_skin(&skin, |contact, _| 2.0 * contact.force.norm()).resting_at(|_| 7.0);
    let mut maps = Maps::new(&skin, Some(Arc::new(model)), &[MapTarget::Signal]).unwrap();
    let mut signal = Vec::new();
    maps.append(MapTarget::Signal, &truth(vec![contact(0.0, 0.0, 3.0)]), &mut signal).unwrap();
    maps.append(MapTarget::Signal, &truth(Vec::new()), &mut signal).unwrap();
    // Where the force cell's noise pulls, nothing presses.
    maps.append(MapTarget::Signal, &truth(vec![contact(0.0, 0.0, -0.02)]), &mut signal).unwrap();
    let channels = skin.channels().len();
    assert!(signal[..channels].iter().all(|v| (v - 6.0).abs() < 1e-12), "{signal:?}");
    assert!(signal.len() == 3 * channels && signal[channels..].iter().all(|v| *v == 0.0));
}

#[test]
fn displacements_are_those_of_the_model_and_unknown_forces_make_no_map() {
    let skin = skin();
    let model: Arc<dyn ForwardModel> = Arc::new(soft(&skin));
    let mut maps = Maps::new(&skin, Some(model), &[MapTarget::Displacement]).unwrap();
    let mut map = Vec::new();
    maps.append(MapTarget::Displacement, &truth(vec![contact(0.0, 0.0, 3.0)]), &mut map).unwrap();
    approx::assert_relative_eq!(map.iter().sum::<f64>(), 3e-3, max_relative = 1e-12);
    map.clear();
    maps.append(MapTarget::Displacement, &truth(Vec::new()), &mut map).unwrap();
    assert!(map.len() == skin.surface().points.len() && map.iter().all(|v| *v == 0.0));
    map.clear();
    let mut unknown = contact(0.0, 0.0, 1.0);
    unknown.components = dermis_skin::ForceComponents::None;
    maps.append(MapTarget::Normal, &truth(vec![unknown]), &mut map).unwrap();
    assert!(map.iter().all(|v| v.is_nan()));
    let mut maps = Maps::new(&skin, Some(Arc::new(soft(&skin))), &[MapTarget::Signal]).unwrap();
    assert!(maps.knows(MapTarget::Signal));
    assert_eq!(maps.len(MapTarget::Signal), skin.channels().len());
    let error = Maps::new(&skin, None, &[MapTarget::Displacement]).err().unwrap().to_string();
    insta::assert_snapshot!(error, @"training: target `map.displacement` needs the forward model of skin `pad`: train with `dermis train`, which knows the models of its sensors, or leave the target out");
}
