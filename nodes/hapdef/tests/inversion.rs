//! Touches on the limb that ships are found wherever they are: beams and holes make the search stop at edges.

use std::sync::Arc;

use dermis_inversion::{ForcePrior, Inverter, Reading, Settings};
use dermis_model::{Indentation, Stimulus};
use dermis_skin::SkinDescription;
use rand::{Rng, SeedableRng};
use rand_distr::{Distribution, Normal};

#[test]
fn every_touch_is_found_from_readings_alone() {
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../launch/skins/hapdef-shin.toml");
    let model = dermis_hapdef::model(&SkinDescription::load(file).unwrap()).unwrap();
    let settings = Settings { force_prior: ForcePrior::Log, ..Settings::new(0.010, 41.0) };
    let inverter = Inverter::new(Arc::clone(&model), settings).unwrap();
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(5);
    let noise = Normal::new(0.0, 3e-6).unwrap();
    let surface = model.surface();
    let (mut tried, mut unexplained, mut missed) = (0, 0, 0);
    while tried < 400 {
        let index = random.random_range(0..surface.points.len());
        let (place, normal) = (surface.points[index], surface.normals[index]);
        if place.x.abs() > 0.085 {
            continue;
        }
        let touch = Indentation::sphere(place, -normal * random.random_range(5.0..30.0), 0.010);
        let mut signal = vec![0.0; model.channels()];
        model
            .response(&Stimulus { contacts: vec![touch.clone()], ..Stimulus::default() }, &mut signal)
            .unwrap();
        let readings: Vec<Reading> =
            signal.iter().map(|v| Reading::Exact(v + noise.sample(&mut random))).collect();
        let solution = inverter.solve(&readings, None).unwrap();
        // What a search finds that knows where the touch is.
        let informed = inverter.solve(&readings, Some(&touch)).unwrap();
        tried += 1;
        missed += usize::from(informed.chi2 + 2.0 < solution.chi2);
        // Seven degrees of freedom: more than 35 is left by noise once in 90 000.
        unexplained += usize::from(solution.chi2 > 35.0);
    }
    // One start in 250 ends at an edge even so (0.4 %: below 1 % of this many with a probability of 95 %).
    assert!(unexplained <= 4, "{unexplained} of {tried}");
    assert!(missed <= 2, "{missed} of {tried}");
}
