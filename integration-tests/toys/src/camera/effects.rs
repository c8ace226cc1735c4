//! What a camera pad of the test may have that its design has not.

use dermis_skin::{Effect, EffectInfo, ModelError, ParameterInfo, SkinDescription};

use super::model::Medium;

/// All of them.
pub const EFFECTS: &[EffectInfo] = &[
    EffectInfo {
        name: "dim-lamp",
        what: "The red lamp is darker than it was designed to be.",
        source: "tolerance of a lamp",
        parameters: &[ParameterInfo::new(
            "loss",
            "1",
            "share of its brightness that is missing",
            0.2,
            [0.05, 0.5],
            [0.0, 0.9],
        )],
        stateful: false,
        random: false,
    },
    EffectInfo {
        name: "soft-pad",
        what: "The pad is softer than it was designed to be: every press sinks in further.",
        source: "tolerance of a silicone",
        parameters: &[ParameterInfo::new(
            "gain",
            "1",
            "share of the depth that is added",
            0.3,
            [0.1, 0.6],
            [0.0, 2.0],
        )],
        stateful: false,
        random: false,
    },
];

/// The medium of a device with the effects that its description switches on.
pub fn apply(skin: &SkinDescription, mut medium: Medium) -> Result<Medium, ModelError> {
    Effect::check(&skin.effects, EFFECTS, &skin.name)?;
    let known = |effect: &Effect| EFFECTS.iter().find(|info| info.name == effect.name);
    for (effect, info) in skin.effects.iter().filter_map(|effect| Some((effect, known(effect)?))) {
        match info.name {
            "dim-lamp" => medium.red *= 1.0 - effect.strength * info.value(effect, "loss"),
            _ => medium.softness *= 1.0 + effect.strength * info.value(effect, "gain"),
        }
    }
    Ok(medium)
}
