//! A small analytic skin, as the tool knows it.

use std::sync::Arc;

use dermis_model::{DeviceState, ForwardModel, Memory, Stepped, Stimulus};
use dermis_skin::{Effect, EffectInfo, ModelError, ParameterInfo, SkinDescription, Surface};
use nalgebra::Point3;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

pub(crate) const SKIN: &str = r#"
schema = "dermis-skin/1"
name = "toy"
sensor = "toy"
frame_id = "toy_link"
unit = "Pa"
rate = 50.0
noise = 5.0
surface = { type = "rectangle", size = [0.030, 0.020], spacing = 0.002 }
taxels = [
    { name = "a", position = [-0.009, -0.005, -0.005] },
    { name = "b", position = [0.000, -0.005, -0.005] },
    { name = "c", position = [0.009, -0.005, -0.005] },
    { name = "d", position = [-0.009, 0.005, -0.005] },
    { name = "e", position = [0.000, 0.005, -0.005] },
    { name = "f", position = [0.009, 0.005, -0.005] },
]
[medium]
spread = 1.0
"#;

pub(crate) const fn parameter(
    name: &'static str,
    typical: f64,
    range: [f64; 2],
    limits: [f64; 2],
) -> ParameterInfo {
    ParameterInfo { name, unit: "1", what: "a number", typical, range, limits }
}

pub(crate) const EFFECTS: &[EffectInfo] = &[
    EffectInfo {
        name: "gains",
        what: "Each taxel reads by a factor of its own.",
        source: "a test",
        parameters: &[parameter("spread", 0.1, [0.0, 0.2], [0.0, 0.9])],
        stateful: false,
        random: true,
    },
    EffectInfo {
        name: "misplacement",
        what: "Taxels lie elsewhere.",
        source: "a test",
        parameters: &[parameter("by", 4e-4, [0.0, 8e-4], [0.0, 4e-3])],
        stateful: false,
        random: true,
    },
    EffectInfo {
        name: "stiffening",
        what: "Strong presses read too much.",
        source: "a test",
        parameters: &[parameter("rise", 0.2, [-0.2, 0.3], [-0.9, 3.0])],
        stateful: false,
        random: false,
    },
    EffectInfo {
        name: "creep",
        what: "What is held fades.",
        source: "a test",
        parameters: &[
            parameter("share", 0.1, [0.0, 0.2], [0.0, 0.9]),
            parameter("time", 0.5, [0.1, 2.0], [1e-2, 1e3]),
        ],
        stateful: true,
        random: false,
    },
    EffectInfo {
        name: "weather",
        what: "All read what the air does.",
        source: "a test",
        parameters: &[parameter("deviation", 100.0, [10.0, 300.0], [0.0, 1e5])],
        stateful: true,
        random: true,
    },
];

pub(crate) fn stream(effect: &Effect, taxel: usize) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(effect.seed.unwrap_or(0));
    rng.set_stream(1 + taxel as u64);
    rng
}

/// Point loads on a half space, as the tool knows them.
pub(crate) struct Toy {
    surface: Surface,
    taxels: Vec<Point3<f64>>,
    gains: Vec<f64>,
    spread: f64,
    rise: f64,
    noise: Vec<f64>,
    way: Way,
}

#[derive(Clone, Default)]
pub(crate) struct Way {
    creep: Option<(f64, f64)>,
    weather: Option<(f64, ChaCha8Rng, f64)>,
    state: Vec<f64>,
    last: Option<f64>,
}

impl Toy {
    pub(crate) fn make(skin: &SkinDescription) -> Result<Arc<dyn ForwardModel>, String> {
        Effect::check(&skin.effects, EFFECTS, &skin.name).map_err(|e| e.to_string())?;
        let mut toy = Self {
            surface: skin.surface(),
            taxels: skin.taxels.iter().map(dermis_skin::Taxel::point).collect(),
            gains: vec![1.0; skin.taxels.len()],
            spread: skin.medium.get("spread").and_then(toml::Value::as_float).unwrap_or(1.0),
            rise: 0.0,
            noise: skin.channel_noise(),
            way: Way::default(),
        };
        for effect in skin.effects.iter().filter(|e| e.strength > 0.0) {
            let info = EFFECTS.iter().find(|i| i.name == effect.name).ok_or("unknown effect")?;
            let value = |name: &str| effect.strength * info.value(effect, name);
            match info.name {
                "gains" => {
                    for (t, gain) in toy.gains.iter_mut().enumerate() {
                        *gain = 1.0 + value("spread") * stream(effect, t).random_range(-1.0..=1.0);
                    }
                }
                "misplacement" => {
                    for (t, place) in toy.taxels.iter_mut().enumerate() {
                        let mut rng = stream(effect, t);
                        for axis in 0..3 {
                            place[axis] += value("by") * rng.random_range(-1.0..=1.0);
                        }
                    }
                }
                "stiffening" => toy.rise = value("rise"),
                "creep" => toy.way.creep = Some((value("share"), info.value(effect, "time"))),
                _ => toy.way.weather = Some((value("deviation"), stream(effect, 0), f64::NAN)),
            }
        }
        toy.way.state = vec![0.0; toy.taxels.len()];
        Ok(Arc::new(toy))
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
            let force = -c.force.z * (1.0 + self.rise * (-c.force.z));
            for ((o, t), gain) in out.iter_mut().zip(&self.taxels).zip(&self.gains) {
                let (along, deep) = ((c.position - t).xy().norm_squared() * self.spread, t.z * t.z);
                *o += gain * 0.5 * force * -t.z * deep / (along + deep).powf(2.5);
            }
        }
        Ok(())
    }
    fn noise(&self) -> &[f64] {
        &self.noise
    }
    fn start(&self, _: u64) -> Box<dyn DeviceState + '_> {
        Box::new(Stepped::new(self, self.way.clone()))
    }
}

impl Memory for Way {
    fn apply_transducer(&mut self, time: f64, _: &Stimulus, readings: &mut [f64]) {
        let dt = time - self.last.unwrap_or(time);
        self.last = Some(time);
        if let Some((share, tau)) = self.creep {
            for (r, s) in readings.iter_mut().zip(&mut self.state) {
                *s += (*r - *s) * -(-dt / tau).exp_m1();
                *r -= share * *s;
            }
        }
        if let Some((deviation, rng, value)) = &mut self.weather {
            let draw: f64 = rng.sample(StandardNormal);
            *value = if value.is_nan() { draw } else { *value + draw * (2.0 * dt / 600.0).sqrt() };
            readings.iter_mut().for_each(|r| *r += *deviation * *value);
        }
    }
}
