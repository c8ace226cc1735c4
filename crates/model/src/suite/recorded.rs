//! Readings of devices with effects are those that were recorded when each effect was last reviewed.

use std::collections::BTreeMap;
use std::path::Path;

use dermis_skin::{Effect, EffectInfo, SkinDescription};

use super::{Effects, steps};
use crate::{COMMON, CommonEffect, CommonParameters, ForwardModel, Stimulus, common_effect};

/// Frames of a recording whose readings are kept.
const KEPT: [usize; 6] = [6, 20, 34, 37, 45, 59];

impl Effects<'_> {
    /// Readings of devices with effects, alone and together, are those that the file at `path` holds, to
    /// rounding: those of a few frames, of which the last is number 59, and the response to the last of the `stimuli`. Where
    /// `DERMIS_RECORD` is set, they are written there instead.
    ///
    /// # Panics
    ///
    /// Where they differ, the file cannot be read or written, or there are fewer stimuli.
    pub fn are_as_recorded(&self, stimuli: &[Stimulus], path: &Path) {
        let nominal = (self.skin)(Vec::new());
        let mut found = BTreeMap::new();
        for effects in cases(self.known, &nominal) {
            let name = effects.iter().map(|e| e.name.as_str()).collect::<Vec<_>>().join(" + ");
            let all = along(self.device(effects).as_ref(), stimuli, self.frame);
            let frames: Vec<&[f64]> = all.chunks(nominal.channels().len()).collect();
            // The last chunk is the response.
            let kept = KEPT.into_iter().chain([stimuli.len()]).flat_map(|i| frames[i]);
            found.insert(name, kept.copied().collect());
        }
        as_recorded(path, &found);
    }
}

/// Noise-free readings of a device that was just switched on, frame after frame, with what its converter makes of them; then
/// those of [`ForwardModel::response`] for the last stimulus.
fn along(model: &dyn ForwardModel, stimuli: &[Stimulus], frame: f64) -> Vec<f64> {
    let mut all = steps(model, stimuli, frame);
    if let Some(last) = stimuli.last() {
        let mut readings = vec![0.0; model.channels()];
        model.response(last, &mut readings).expect("the stimuli of a test can be");
        all.extend_from_slice(&readings);
    }
    all
}

/// A common effect that shows in the readings of `skin`: its first two channels, or taxels, are off.
fn switched_on(info: &CommonEffect, skin: &SkinDescription) -> Effect {
    let channels = skin.channels();
    let (first, second) = (channels[0].name.as_str(), channels[1].name.as_str());
    let mut effect = Effect::new(info.name);
    // Of the skin's unit, as a multiple of its noise.
    let [a, b] = match info.name {
        "channel-order" => [1.0, 0.0],
        "channel-gain" => [1.3, 0.8],
        "channel-curvature" | "thermal-span" => [0.02, -0.03],
        "thermal-bend" => [0.1 * skin.noise, -0.2 * skin.noise],
        _ => [5.0 * skin.noise, -8.0 * skin.noise],
    };
    match info.parameters {
        CommonParameters::Channels => effect = effect.with(first, a).with(second, b),
        CommonParameters::ChannelsAnd(_) => {
            effect = effect.with(first, a).with(second, b).with("span", 0.1).with("time", 1.3);
        }
        CommonParameters::Taxels => {
            let [x, y] = [format!("{}.x", skin.taxels[0].name), format!("{}.y", skin.taxels[1].name)];
            effect = effect.with(x, 4e-4).with(y, -3e-4);
        }
        CommonParameters::Named(named) => {
            for p in named {
                let value = match p.name {
                    "amplitude" => 5.0 * skin.noise,
                    "frequency" => 13.0,
                    "rate" => 0.1,
                    "wear" => 0.05,
                    _ => 0.9 * p.range[1],
                };
                effect = effect.with(p.name, value);
            }
        }
    }
    effect
}

/// The common effects in an order that says which are recorded together: another order of the table changes no recording.
const IN_PAIRS: [&str; 18] = [
    "channel-offset",
    "channel-gain",
    "channel-curvature",
    "crosstalk",
    "taxel-position",
    "thermal-zero",
    "thermal-bend",
    "thermal-span",
    "warm-up",
    "ageing",
    "interference",
    "delay",
    "low-pass",
    "truth-shift",
    "force-scale",
    "force-zero",
    "tip-scale",
    "channel-order",
];

/// Lists of effects whose readings a family records: each effect alone, in pairs across the seam between the family and what is
/// common to all, and all at once.
fn cases(known: &[EffectInfo], skin: &SkinDescription) -> Vec<Vec<Effect>> {
    let own: Vec<Effect> = known.iter().map(|info| Effect::new(info.name).seed(5)).collect();
    assert_eq!(COMMON.len(), IN_PAIRS.len(), "a common effect is in no recording");
    let common: Vec<Effect> = IN_PAIRS
        .iter()
        .map(|name| switched_on(common_effect(name).expect("a common effect has this name"), skin))
        .collect();
    let mut cases: Vec<Vec<Effect>> = own.iter().chain(&common).map(|e| vec![e.clone()]).collect();
    let remembering: Vec<&Effect> =
        known.iter().zip(&own).filter(|(info, _)| info.stateful).map(|(_, e)| e).collect();
    for (i, effect) in common.iter().enumerate() {
        cases.push(vec![remembering[i % remembering.len()].clone(), effect.clone()]);
        cases.push(vec![effect.clone(), common[(i + 3) % common.len()].clone()]);
    }
    for name in ["channel-curvature", "crosstalk", "truth-shift"] {
        let with = common.iter().filter(|e| e.name == name);
        cases.extend(with.flat_map(|c| remembering.iter().map(|e| vec![c.clone(), (*e).clone()])));
    }
    cases.push(common.clone());
    cases.push(common.into_iter().chain(remembering.into_iter().cloned()).collect());
    cases
}

/// Compares readings with those that the file at `path` holds, to rounding; where `DERMIS_RECORD` is set, writes them there.
fn as_recorded(path: &Path, found: &BTreeMap<String, Vec<f64>>) {
    if std::env::var_os("DERMIS_RECORD").is_some() {
        let text = toml::to_string(found).expect("numbers can be written");
        std::fs::write(path, text).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        return;
    }
    let text = std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let wanted: BTreeMap<String, Vec<f64>> = toml::from_str(&text).expect("the recorded file is TOML");
    assert!(found.keys().eq(wanted.keys()), "other cases than recorded: {:?}", found.keys());
    for (name, wanted) in &wanted {
        let found = &found[name];
        assert_eq!(found.len(), wanted.len(), "{name}");
        let largest = wanted.iter().fold(0.0f64, |m, v| m.max(v.abs()));
        for (i, (a, b)) in found.iter().zip(wanted).enumerate() {
            assert!((a - b).abs() <= 1e-9 * largest, "{name}: number {i} is {a} and was {b}");
        }
    }
}
