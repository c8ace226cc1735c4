//! A small analytic skin for tests: three taxels, one effect of its family.

use std::sync::Arc;

use dermis_model::{ForwardModel, Indentation, Stimulus};
use dermis_skin::{Effect, EffectInfo, ModelError, ParameterInfo, Phase, SkinDescription, Surface};
use nalgebra::{Point3, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use crate::recording::{Moment, Recording};
use crate::simulate::Simulator;

const SKIN: &str = r#"
schema = "dermis-skin/1"
name = "small"
sensor = "small"
frame_id = "small_link"
unit = "Pa"
rate = 50.0
noise = 5.0
surface = { type = "rectangle", size = [0.030, 0.020], spacing = 0.002 }
taxels = [
    { name = "a", position = [-0.009, -0.004, -0.005] },
    { name = "b", position = [0.000, 0.005, -0.005] },
    { name = "c", position = [0.009, -0.004, -0.005] },
]
[medium]
spread = 1.0
"#;

/// The medium gives way less the harder it is pressed.
pub(crate) const EFFECTS: &[EffectInfo] = &[EffectInfo {
    name: "stiffening",
    what: "Strong presses read too little.",
    source: "a test",
    parameters: &[ParameterInfo {
        name: "bend",
        unit: "1/N",
        what: "share of the reading that is lost per newton",
        typical: 0.2,
        range: [0.1, 0.4],
        limits: [-0.5, 0.5],
    }],
    stateful: false,
    random: false,
}];

pub(crate) fn skin() -> SkinDescription {
    SkinDescription::from_toml(SKIN, "small.toml").unwrap()
}

/// Readings `1000 · force · (1 − bend · force) / (1 + (distance / 6 mm)²)` beside an untouched reading of each channel.
pub(crate) struct Small {
    surface: Surface,
    taxels: Vec<Point3<f64>>,
    noise: Vec<f64>,
    width: f64,
    bend: f64,
    /// \[Pa\] of the first channel where nothing touches; twice as much of the second, and so on.
    rest: f64,
}

impl Small {
    pub(crate) fn make(skin: &SkinDescription, rest: f64) -> Result<Arc<dyn ForwardModel>, String> {
        Effect::check(&skin.effects, EFFECTS, &skin.name).map_err(|e| e.to_string())?;
        let bend = skin.effects.iter().find(|e| e.name == "stiffening");
        Ok(Arc::new(Self {
            surface: skin.surface(),
            taxels: skin.taxels.iter().map(dermis_skin::Taxel::point).collect(),
            noise: skin.channel_noise(),
            width: 0.006 * skin.medium.get("spread").and_then(toml::Value::as_float).unwrap_or(1.0),
            bend: bend.map_or(0.0, |e| e.strength * EFFECTS[0].value(e, "bend")),
            rest,
        }))
    }
}

impl ForwardModel for Small {
    fn channels(&self) -> usize {
        self.taxels.len()
    }

    fn surface(&self) -> &Surface {
        &self.surface
    }

    fn response(&self, stimulus: &Stimulus, out: &mut [f64]) -> Result<(), ModelError> {
        out.iter_mut().enumerate().for_each(|(k, o)| *o = self.rest * (k + 1) as f64);
        for contact in &stimulus.contacts {
            let force = -contact.force.z;
            for (o, taxel) in out.iter_mut().zip(&self.taxels) {
                let far = ((contact.position - taxel).norm() / self.width).powi(2);
                *o += 1000.0 * force * (1.0 - self.bend * force) / (1.0 + far);
            }
        }
        Ok(())
    }

    fn noise(&self) -> &[f64] {
        &self.noise
    }
}

/// 120 presses of 0.2 to 1 N at as many places, each between untouched frames, without readings.
pub(crate) fn presses() -> Vec<Moment> {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let mut moments = Vec::new();
    for press in 0..120_u32 {
        let at = Point3::new(rng.random_range(-0.013..0.013), rng.random_range(-0.008..0.008), 0.0);
        let force: f64 = rng.random_range(0.2..1.0);
        for i in 0..60 {
            let share = match i {
                0..32 => 0.0,
                32..36 => f64::from(i - 31) / 5.0,
                56..60 => f64::from(60 - i) / 5.0,
                _ => 1.0,
            };
            let phase = match i {
                0..32 => Phase::Idle,
                32..36 => Phase::Load,
                56..60 => Phase::Unload,
                _ => Phase::Hold,
            };
            let contact = Indentation::sphere(at, Vector3::new(0.0, 0.0, -force * share), 0.004);
            let contacts = if share > 0.0 { vec![contact] } else { Vec::new() };
            moments.push(Moment {
                time: f64::from(press * 60 + i) * 0.02,
                run: 0,
                press: u64::from(press) + 1,
                location: press + 1,
                phase,
                stimulus: Some(Stimulus { contacts, ..Stimulus::default() }),
                temperature: f64::NAN,
            });
        }
    }
    moments
}

/// What a device with these effects reads along [`presses`], with noise.
pub(crate) fn recorded(simulator: &Simulator<'_>, effects: &[Effect]) -> Recording {
    let mut bare = Recording::new("small", 3);
    presses().into_iter().for_each(|moment| bare.push(moment, &[]));
    let frames: Vec<usize> = (0..bare.moments.len()).collect();
    let read = simulator.readings(&simulator.with(effects), &bare, &frames).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let mut recording = Recording::new("small", 3);
    recording.sessions.push("one".to_owned());
    for (moment, read) in bare.moments.into_iter().zip(read.chunks_exact(3)) {
        let noisy: Vec<f32> = read.iter().map(|v| v + 5.0 * rng.sample::<f32, _>(StandardNormal)).collect();
        recording.push(moment, &noisy);
    }
    recording
}

/// Gains of the three channels that differ.
pub(crate) fn gains() -> Effect {
    Effect::new("channel-gain").with("a", 1.2).with("b", 0.85).with("c", 1.1)
}
