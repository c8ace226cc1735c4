//! What a foam of the test may have that its design has not.

use dermis_skin::{Effect, EffectInfo, ModelError, ParameterInfo, SkinDescription};

use super::model::Medium;

/// All of them.
pub const EFFECTS: &[EffectInfo] = &[
    EffectInfo {
        name: "stiff-foam",
        what: "The foam is stiffer than it was designed to be: every press changes less.",
        source: "tolerance of a foam",
        parameters: &[ParameterInfo::new(
            "loss",
            "1",
            "share of the sensitivity that is missing",
            0.2,
            [0.05, 0.4],
            [0.0, 0.9],
        )],
        stateful: false,
        random: false,
    },
    EffectInfo {
        name: "slow-foam",
        what: "The foam creeps more than it was designed to: more of every reading follows slowly.",
        source: "creep of open-cell foams",
        parameters: &[ParameterInfo::new(
            "share",
            "1",
            "that follows slowly besides what the design knows",
            0.3,
            [0.1, 0.5],
            [0.0, 0.6],
        )],
        stateful: true,
        random: false,
    },
];

/// The medium of a device with the effects that its description switches on.
pub fn apply(skin: &SkinDescription, mut medium: Medium) -> Result<Medium, ModelError> {
    Effect::check(&skin.effects, EFFECTS, &skin.name)?;
    for (effect, info) in skin
        .effects
        .iter()
        .filter_map(|effect| Some((effect, EFFECTS.iter().find(|i| i.name == effect.name)?)))
    {
        match info.name {
            "stiff-foam" => medium.sensitivity *= 1.0 - effect.strength * info.value(effect, "loss"),
            _ => medium.fade += effect.strength * info.value(effect, "share"),
        }
    }
    Ok(medium)
}
