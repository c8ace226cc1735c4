//! How thick the wall is where.

use rand::Rng;

use super::panel::Shape;
use crate::cause::{Cause, Causes};

/// \[m\] from the middle of a thin place within which most of it is.
pub(super) const THIN: f64 = 0.015;

/// Where the wall is thin, along x and the arc \[m\].
pub(super) fn thin_at(shape: &Shape, cause: &Cause) -> [f64; 2] {
    let mut rng = cause.rng();
    [0.35 * shape.size[0], 0.35 * shape.size[1]].map(|half| rng.random_range(-half..half))
}

/// How the thickness of the wall varies over it, as a share of its nominal one.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Relief {
    /// Wave numbers \[1/m\] along x and the arc, phase and amplitude.
    waves: Vec<[f64; 4]>,
    /// Place \[m\] and loss of a broken beam.
    broken: Option<([f64; 2], f64)>,
}

impl Relief {
    pub fn of(causes: &Causes, shape: &Shape) -> Self {
        let waves: Vec<[f64; 4]> = causes.get("uneven-wall").map_or_else(Vec::new, |(cause, deviation)| {
            let mut rng = cause.rng();
            let wave = |_| {
                let turn = rng.random_range(0.0..std::f64::consts::TAU);
                let number = std::f64::consts::TAU / rng.random_range(0.04..0.12);
                [
                    number * f64::cos(turn),
                    number * f64::sin(turn),
                    rng.random_range(0.0..6.3),
                    deviation * 0.6,
                ]
            };
            (0..6).map(wave).collect()
        });
        let broken = causes.get("broken-beam").map(|(cause, loss)| (thin_at(shape, cause), loss));
        Self { waves, broken }
    }

    pub fn at(&self, at: [f64; 2]) -> f64 {
        let wave = |w: &[f64; 4]| w[3] * (w[0] * at[0] + w[1] * at[1] + w[2]).cos();
        let mut here = 1.0 + self.waves.iter().map(wave).sum::<f64>();
        if let Some((place, loss)) = &self.broken {
            let off = (at[0] - place[0]).hypot(at[1] - place[1]) / THIN;
            here *= 1.0 - loss * (-off * off).exp();
        }
        here.clamp(0.15, 3.0)
    }
}
