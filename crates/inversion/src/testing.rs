//! A made-up skin for tests.

use dermis_model::{ForwardModel, Indentation, Stimulus};
use dermis_skin::{ModelError, Surface, SurfaceSpec};
use nalgebra::{Point3, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::Reading;

/// Point taxels below a plane that respond to a normal force as a half-space does, a little less than linear in it, and shear as
/// the derivative of that.
pub(crate) struct Toy {
    surface: Surface,
    taxels: Vec<(f64, f64)>,
    gains: Vec<f64>,
    noise: Vec<f64>,
}

const DEPTH: f64 = 0.005;

impl Toy {
    /// Five by five taxels, 6.5 mm apart.
    pub fn grid(noise: f64) -> Self {
        let at = |i: usize| (i as f64 - 2.0) * 0.0065;
        let spec = SurfaceSpec::Rectangle { size: [0.034, 0.034], spacing: 0.001 };
        Self {
            surface: Surface::from_spec(&spec),
            taxels: (0..25).map(|i| (at(i % 5), at(i / 5))).collect(),
            gains: vec![1.0; 25],
            noise: vec![noise; 25],
        }
    }

    /// Another device of this design: place and gain of every taxel.
    pub fn change(&mut self, mut change: impl FnMut(&mut (f64, f64), &mut f64)) {
        self.taxels.iter_mut().zip(&mut self.gains).for_each(|(at, gain)| change(at, gain));
    }

    /// What the channels read, with noise.
    pub fn read(&self, contacts: &[Indentation], random: &mut ChaCha8Rng) -> Vec<Reading> {
        let mut out = vec![0.0; self.channels()];
        let stimulus = Stimulus { contacts: contacts.to_vec(), ..Stimulus::default() };
        self.response(&stimulus, &mut out).unwrap();
        out.iter()
            .zip(&self.noise)
            .map(|(v, sigma)| {
                let noise: f64 = StandardNormal.sample(random);
                Reading::Exact(v + sigma * noise)
            })
            .collect()
    }
}

impl ForwardModel for Toy {
    fn channels(&self) -> usize {
        self.taxels.len()
    }

    fn surface(&self) -> &Surface {
        &self.surface
    }

    fn response(&self, stimulus: &Stimulus, out: &mut [f64]) -> Result<(), ModelError> {
        out.fill(0.0);
        for c in &stimulus.contacts {
            let pressing = -c.force.z;
            for ((value, (x, y)), gain) in out.iter_mut().zip(&self.taxels).zip(&self.gains) {
                let (dx, dy) = (x - c.position.x, y - c.position.y);
                let r = (dx * dx + dy * dy + DEPTH * DEPTH).sqrt();
                let kernel = 1.58e-1 / r.powi(3);
                *value += gain
                    * kernel
                    * (pressing * DEPTH * (1.0 - 0.05 * pressing) + c.force.x * dx + c.force.y * dy);
            }
        }
        Ok(())
    }

    fn noise(&self) -> &[f64] {
        &self.noise
    }
}

/// The same skin behind electronics that read so much more, touched or not.
pub(crate) struct Shifted(pub Toy, pub f64);

impl ForwardModel for Shifted {
    fn channels(&self) -> usize {
        self.0.channels()
    }

    fn surface(&self) -> &Surface {
        self.0.surface()
    }

    fn response(&self, stimulus: &Stimulus, out: &mut [f64]) -> Result<(), ModelError> {
        self.0.response(stimulus, out)?;
        out.iter_mut().for_each(|v| *v += self.1);
        Ok(())
    }

    fn noise(&self) -> &[f64] {
        self.0.noise()
    }
}

/// The same skin in a medium that stiffens by a half for each newton on all of it: signals do not add up.
pub(crate) struct Stiffening(pub Toy);

impl ForwardModel for Stiffening {
    fn channels(&self) -> usize {
        self.0.channels()
    }

    fn surface(&self) -> &Surface {
        self.0.surface()
    }

    fn response(&self, stimulus: &Stimulus, out: &mut [f64]) -> Result<(), ModelError> {
        self.0.response(stimulus, out)?;
        let load: f64 = stimulus.contacts.iter().map(|c| c.force.norm()).sum();
        out.iter_mut().for_each(|v| *v /= 1.0 + 0.5 * load);
        Ok(())
    }

    fn noise(&self) -> &[f64] {
        self.0.noise()
    }

    fn superposes(&self) -> bool {
        false
    }
}

pub(crate) fn press(x: f64, y: f64, newtons: f64) -> Indentation {
    Indentation::sphere(Point3::new(x, y, 0.0), Vector3::new(0.0, 0.0, -newtons), 0.004)
}

pub(crate) fn random(seed: u64) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(seed)
}
