//! A made-up skin for tests.

use dermis_fixtures::Analytic;
use dermis_model::Indentation;
use dermis_skin::{Surface, SurfaceSpec};
use nalgebra::{Point3, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::Reading;

const DEPTH: f64 = 0.005;

/// Five by five taxels, 6.5 mm apart and 5 mm below a plane, that respond to a normal force as a half-space does, a little less than
/// linear in it, and to shear as the derivative of that.
pub(crate) fn grid(noise: f64) -> Analytic {
    let at = |i: usize| (i as f64 - 2.0) * 0.0065;
    let locations = (0..25).map(|i| Point3::new(at(i % 5), at(i / 5), 0.0));
    let spec = SurfaceSpec::Rectangle { size: [0.034, 0.034], spacing: 0.001 };
    Analytic::new(Surface::from_spec(&spec), locations, noise, |c, taxel| {
        let pressing = -c.force.z;
        let (dx, dy) = (taxel.x - c.position.x, taxel.y - c.position.y);
        let r = (dx * dx + dy * dy + DEPTH * DEPTH).sqrt();
        1.58e-1 / r.powi(3) * (pressing * DEPTH * (1.0 - 0.05 * pressing) + c.force.x * dx + c.force.y * dy)
    })
}

/// The same skin in a medium that stiffens by a half for each newton on all of it: signals do not add up.
pub(crate) fn stiffening_grid(noise: f64) -> Analytic {
    grid(noise).nonlinear(|stimulus, out| {
        let load: f64 = stimulus.contacts.iter().map(|c| c.force.norm()).sum();
        out.iter_mut().for_each(|v| *v /= 1.0 + 0.5 * load);
    })
}

/// What the channels read, with noise.
pub(crate) fn read(model: &Analytic, contacts: &[Indentation], random: &mut ChaCha8Rng) -> Vec<Reading> {
    let noisy = |(v, sigma): (f64, &f64)| {
        let noise: f64 = StandardNormal.sample(random);
        Reading::Exact(v + sigma * noise)
    };
    model.read(contacts).into_iter().zip(&model.noise).map(noisy).collect()
}

pub(crate) fn press(x: f64, y: f64, newtons: f64) -> Indentation {
    Indentation::sphere(Point3::new(x, y, 0.0), Vector3::new(0.0, 0.0, -newtons), 0.004)
}

pub(crate) fn random(seed: u64) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(seed)
}
