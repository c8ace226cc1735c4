//! Several contacts on the panel that ships, found by inversion of its forward model: as well as from the true contacts on, where the
//! readings tell them apart.

use std::sync::Arc;

use dermis_ert::model::FabricModel;
use dermis_inversion::{Inverter, Reading, Settings};
use dermis_model::{ForwardModel, Indentation, Stimulus, Untouched};
use dermis_skin::{SkinDescription, TipKind};
use nalgebra::{Point3, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

const PANEL: &str = include_str!("../../../launch/skins/ert-panel.toml");
const SCENES: usize = 6;
const CONTACTS: usize = 3;

fn settings() -> Settings {
    let mut settings = Settings::new(0.02, 48.0);
    (settings.contacts, settings.tip, settings.distance) = (6, TipKind::FlatPunch, 0.02);
    settings
}

/// Contacts of 20 to 40 N, 120 mm apart.
fn scene(rng: &mut ChaCha8Rng) -> Vec<Indentation> {
    let mut locations: Vec<Point3<f64>> = Vec::new();
    while locations.len() < CONTACTS {
        let location = Point3::new(rng.random_range(-0.22..0.22), rng.random_range(-0.22..0.22), 0.0);
        if locations.iter().all(|other| (location - other).norm() > 0.12) {
            locations.push(location);
        }
    }
    let mut press = |location: Point3<f64>| {
        settings().indentation(location, Vector3::new(0.0, 0.0, -rng.random_range(20.0..40.0)))
    };
    locations.into_iter().map(&mut press).collect()
}

#[test]
fn a_search_for_three_contacts_ends_where_one_from_the_true_ones_does() {
    dermis_skin::register(dermis_ert::FAMILY);
    let skin = SkinDescription::from_toml(PANEL, "ert-panel.toml").unwrap();
    let model = Arc::new(FabricModel::new(&skin).unwrap());
    let inverter = Inverter::new(model.clone(), settings()).unwrap();
    let untouched = Untouched::of(model.as_ref()).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(18);
    let mut signal = vec![0.0; model.channels()];
    let mut as_good = 0;
    for _ in 0..SCENES {
        let truth = scene(&mut rng);
        let stimulus = Stimulus { contacts: truth.clone(), ..Stimulus::default() };
        model.response(&stimulus, &mut signal).unwrap();
        untouched.subtract(&mut signal);
        let noisy = |v: &f64| {
            Reading::Exact(
                v + skin.noise * <StandardNormal as Distribution<f64>>::sample(&StandardNormal, &mut rng),
            )
        };
        let readings: Vec<Reading> = signal.iter().map(noisy).collect();
        let near_truth = inverter.refine(&readings, &truth).unwrap();
        let searched = inverter.search(&readings).unwrap();
        // A little more than the least sum is the same minimum.
        as_good += usize::from(searched.chi2 < near_truth.chi2 + 1.0);
        // Begun at what a network might suppose, a search is not longer than a refinement.
        let supposed: Vec<Indentation> = truth
            .iter()
            .map(|c| Indentation { position: c.position + Vector3::new(0.015, -0.015, 0.0), ..c.clone() })
            .collect();
        let begun = inverter.search_from(&readings, &supposed).unwrap();
        assert_eq!(begun.contacts.len(), CONTACTS);
        assert!(begun.chi2 < near_truth.chi2 + 1.0, "{} after {}", begun.chi2, near_truth.chi2);
    }
    assert!(as_good + 1 >= SCENES, "{as_good} of {SCENES} searches");
}
