//! A small analytic skin, as the tool knows it.

use std::sync::Arc;

use dermis_fixtures::{Analytic, CreepAndDrift, SkinFile};
use dermis_model::ForwardModel;
use dermis_skin::{Effect, EffectInfo, ParameterInfo, SkinDescription};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

pub(crate) fn skin() -> SkinDescription {
    SkinFile::new("toy")
        .set("sensor", "\"toy\"")
        .set("rate", "50.0")
        .set("noise", "5.0")
        .rectangle([0.030, 0.020], 0.002)
        .taxels([
            ("a", [-0.009, -0.005, -0.005]),
            ("b", [0.000, -0.005, -0.005]),
            ("c", [0.009, -0.005, -0.005]),
            ("d", [-0.009, 0.005, -0.005]),
            ("e", [0.000, 0.005, -0.005]),
            ("f", [0.009, 0.005, -0.005]),
        ])
        .tables("[medium]\nspread = 1.0\n")
        .read()
}

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
pub(crate) fn toy(skin: &SkinDescription) -> Result<Arc<dyn ForwardModel>, String> {
    Effect::check(&skin.effects, EFFECTS, &skin.name).map_err(|e| e.to_string())?;
    let spread = skin.medium.get("spread").and_then(toml::Value::as_float).unwrap_or(1.0);
    let of = |name: &str| {
        let effect = skin.effects.iter().find(|e| e.name == name && e.strength > 0.0)?;
        Some((effect, EFFECTS.iter().find(|info| info.name == name)?))
    };
    let value =
        |(effect, info): (&Effect, &EffectInfo), name: &str| effect.strength * info.value(effect, name);
    let rise = of("stiffening").map_or(0.0, |found| value(found, "rise"));
    let mut model = Analytic::of_skin(skin, move |c, t| {
        let force = -c.force.z * (1.0 + rise * (-c.force.z));
        let (along, deep) = ((c.position - t).xy().norm_squared() * spread, t.z * t.z);
        0.5 * force * -t.z * deep / (along + deep).powf(2.5)
    });
    for (t, element) in model.elements.iter_mut().enumerate() {
        if let Some(gains) = of("gains") {
            element.gain = 1.0 + value(gains, "spread") * stream(gains.0, t).random_range(-1.0..=1.0);
        }
        if let Some(off) = of("misplacement") {
            let mut rng = stream(off.0, t);
            (0..3).for_each(|axis| element.at[axis] += value(off, "by") * rng.random_range(-1.0..=1.0));
        }
    }
    let memory = CreepAndDrift::new(
        of("creep").map(|creep| (value(creep, "share"), creep.1.value(creep.0, "time"))),
        of("weather").map(|air| (value(air, "deviation"), stream(air.0, 0))),
    );
    Ok(Arc::new(model.with_memory(move || memory.clone())))
}
