//! A small analytic skin for tests: three taxels, one effect of its family.

use std::sync::Arc;

use dermis_fixtures::{Analytic, SkinFile};
use dermis_model::{ForwardModel, Indentation, Stimulus};
use dermis_skin::{Effect, EffectInfo, ParameterInfo, Phase, SkinDescription};
use nalgebra::{Point3, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use crate::recording::{FrameLabel, Recording};
use crate::simulate::Simulator;

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
    SkinFile::new("small")
        .set("sensor", "\"small\"")
        .set("rate", "50.0")
        .set("noise", "5.0")
        .rectangle([0.030, 0.020], 0.002)
        .taxels([
            ("a", [-0.009, -0.004, -0.005]),
            ("b", [0.000, 0.005, -0.005]),
            ("c", [0.009, -0.004, -0.005]),
        ])
        .tables("[medium]\nspread = 1.0\n")
        .read()
}

/// Readings `1000 · force · (1 − bend · force) / (1 + (distance / 6 mm)²)` beside an untouched reading of each channel: `rest`
/// \[Pa\] of the first, twice as much of the second, and so on.
pub(crate) fn small(skin: &SkinDescription, rest: f64) -> Result<Arc<dyn ForwardModel>, String> {
    Effect::check(&skin.effects, EFFECTS, &skin.name).map_err(|e| e.to_string())?;
    let bend = skin.effects.iter().find(|e| e.name == "stiffening");
    let bend = bend.map_or(0.0, |e| e.strength * EFFECTS[0].value(e, "bend"));
    let width = 0.006 * skin.medium.get("spread").and_then(toml::Value::as_float).unwrap_or(1.0);
    let model = Analytic::of_skin(skin, move |contact, taxel| {
        let force = -contact.force.z;
        let far = ((contact.position - taxel).norm() / width).powi(2);
        1000.0 * force * (1.0 - bend * force) / (1.0 + far)
    });
    Ok(Arc::new(model.resting_at(|k| rest * (k + 1) as f64)))
}

/// 120 presses of 0.2 to 1 N at as many locations, each between untouched frames, without readings.
pub(crate) fn presses() -> Vec<FrameLabel> {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let mut labels = Vec::new();
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
            labels.push(FrameLabel {
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
    labels
}

/// What a device with these effects reads along [`presses`], with noise.
pub(crate) fn recorded(simulator: &Simulator<'_>, effects: &[Effect]) -> Recording {
    let mut bare = Recording::new("small", 3);
    presses().into_iter().for_each(|label| bare.push(label, &[]));
    let frames: Vec<usize> = (0..bare.labels.len()).collect();
    let read = simulator.readings(&simulator.with(effects), &bare, &frames).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let mut recording = Recording::new("small", 3);
    recording.sessions.push("one".to_owned());
    for (label, read) in bare.labels.into_iter().zip(read.chunks_exact(3)) {
        let noisy: Vec<f32> = read.iter().map(|v| v + 5.0 * rng.sample::<f32, _>(StandardNormal)).collect();
        recording.push(label, &noisy);
    }
    recording
}

/// Gains of the three channels that differ.
pub(crate) fn gains() -> Effect {
    Effect::new("channel-gain").with("a", 1.2).with("b", 0.85).with("c", 1.1)
}
