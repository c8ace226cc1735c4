//! What is promised of every effect of every sensor family: property tests that each family runs over its own table.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use crate::{COMMON, CommonEffect, CommonParameters, ForwardModel, Stimulus, Trajectory};
use dermis_skin::{Effect, EffectInfo, ModelError, SkinDescription};

/// A device as its effects made it.
pub struct Device {
    /// What it reads.
    pub model: Arc<dyn ForwardModel>,
    /// Switches it on.
    pub begin: Box<dyn Fn() -> Box<dyn Trajectory>>,
}

/// The effects of a family, and how devices with them are made.
pub struct Effects<'a> {
    /// The family's table.
    pub known: &'static [EffectInfo],
    /// A skin with these effects.
    pub skin: &'a dyn Fn(Vec<Effect>) -> SkinDescription,
    /// The device that a skin describes.
    pub device: &'a dyn Fn(&SkinDescription) -> Result<Device, ModelError>,
    /// \[s\] between frames.
    pub frame: f64,
}

fn rms(a: &[f64], b: &[f64]) -> f64 {
    (a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>() / a.len() as f64).sqrt()
}

fn same(a: &[f64], b: &[f64]) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| a.to_bits() == b.to_bits())
}

impl Effects<'_> {
    fn read(&self, device: &Device, stimuli: &[Stimulus]) -> Vec<f64> {
        let mut walk = (device.begin)();
        let mut readings = vec![0.0; device.model.channels()];
        let mut all = Vec::new();
        for (i, stimulus) in stimuli.iter().enumerate() {
            let (t, mut stimulus) = (i as f64 * self.frame, stimulus.clone());
            walk.touch(t, &mut stimulus);
            device.model.response(&stimulus, &mut readings).expect("the stimuli of a test can be");
            walk.transduce(t, &stimulus, &mut readings);
            walk.convert(&mut readings);
            all.extend_from_slice(&readings);
        }
        all
    }

    fn device(&self, effects: Vec<Effect>) -> Device {
        (self.device)(&(self.skin)(effects)).expect("the devices of a test can be")
    }

    /// Noise-free readings, frame after frame, of a device that was just switched on.
    ///
    /// # Panics
    ///
    /// Where there is no such device, or it refuses a stimulus.
    #[must_use]
    pub fn readings(&self, effects: Vec<Effect>, stimuli: &[Stimulus]) -> Vec<f64> {
        self.read(&self.device(effects), stimuli)
    }

    /// Every effect is the identity at 0, bit for bit, and its deviation from the nominal readings grows with its strength.
    ///
    /// # Panics
    ///
    /// Where that is not so.
    pub fn grow_from_nothing(&self, stimuli: &[Stimulus], seed: u64) {
        let nominal = self.readings(Vec::new(), stimuli);
        for info in self.known {
            let mut last = 0.0;
            // Doubled each time: what rounds deviates by chance, too.
            for strength in [0.0, 0.25, 0.5, 1.0] {
                let effect = Effect::new(info.name).strength(strength).seed(seed);
                let found = self.readings(vec![effect], stimuli);
                if strength == 0.0 {
                    assert!(same(&found, &nominal), "{} at strength 0 changes readings", info.name);
                    continue;
                }
                let off = rms(&found, &nominal);
                assert!(off > last, "{} at {strength}: {off} off after {last}", info.name);
                last = off;
            }
        }
    }

    /// One seed is one device, and effects that are drawn at random differ from seed to seed: not every time, where few devices
    /// are possible.
    ///
    /// # Panics
    ///
    /// Where that is not so.
    pub fn are_drawn_by_their_seeds(&self, stimuli: &[Stimulus], seed: u64) {
        for info in self.known {
            let of = |seed| self.readings(vec![Effect::new(info.name).seed(seed)], stimuli);
            let one = of(seed);
            assert!(same(&one, &of(seed)), "{}: one seed, two devices", info.name);
            let tries = if info.random { 30 } else { 1 };
            let differs = (1..=tries).any(|by| !same(&one, &of(seed.wrapping_add(by))));
            assert_eq!(differs, info.random, "{}", info.name);
        }
    }

    /// What is stateful reads the stimulus number `middle` as its history makes it, what is not reads it as a device that was
    /// just switched on; and a new trajectory is a device that was never touched.
    ///
    /// # Panics
    ///
    /// Where that is not so.
    pub fn remember_what_they_should(&self, stimuli: &[Stimulus], middle: usize, seed: u64) {
        for info in self.known {
            let device = self.device(vec![Effect::new(info.name).seed(seed)]);
            let after = self.read(&device, &stimuli[..=middle]);
            let fresh = self.read(&device, &stimuli[middle..=middle]);
            let last = &after[after.len() - device.model.channels()..];
            assert_eq!(!same(last, &fresh), info.stateful, "{}", info.name);
            let again = self.read(&device, stimuli);
            assert!(same(&again, &self.read(&device, stimuli)), "{} is not reset", info.name);
        }
    }

    /// Names, words, ranges and limits make sense; values outside of the limits, and parameters that are none, are refused by
    /// name; and an effect survives the way through a file.
    ///
    /// # Panics
    ///
    /// Where that is not so.
    pub fn are_named_and_parametrised(&self, stimuli: &[Stimulus]) {
        let word = |s: &str, join| s.chars().all(|c| c.is_ascii_lowercase() || c == join) && !s.is_empty();
        let refused = |effect: Effect| match (self.device)(&(self.skin)(vec![effect])) {
            Ok(_) => String::from("taken"),
            Err(error) => error.to_string(),
        };
        for (i, info) in self.known.iter().enumerate() {
            let name = info.name;
            assert!(word(name, '-') && self.known[..i].iter().all(|e| e.name != name), "{name}");
            assert!(!info.what.is_empty() && !info.source.is_empty() && !info.parameters.is_empty());
            let mut effect = Effect::new(name).seed(7);
            for p in info.parameters {
                assert!(word(p.name, '_') && !p.what.is_empty() && !p.unit.is_empty(), "{name}.{}", p.name);
                let ([low, high], [least, most]) = (p.range, p.limits);
                let nested = least <= low && low <= p.typical && p.typical <= high && high <= most;
                assert!(nested, "{name}.{}", p.name);
                effect = effect.with(p.name, p.typical);
                for bad in [least - 1e-3 * (1.0 + least.abs()), most + 1e-3 * (1.0 + most.abs()), f64::NAN] {
                    let text = refused(Effect::new(name).with(p.name, bad));
                    assert!(text.contains(&format!("`effects[0].{}`: is {bad}", p.name)), "{text}");
                }
            }
            let named = (self.skin)(vec![effect]);
            let text = toml::to_string(&named).expect("a skin can be written");
            let back = SkinDescription::from_toml(&text, "written").unwrap_or_else(|e| panic!("{e}\n{text}"));
            assert_eq!(back.effects, named.effects);
            // Typical values are those that a file may leave out.
            let typical = self.readings(vec![Effect::new(name).seed(7)], stimuli);
            assert!(same(&self.readings(back.effects, stimuli), &typical), "{name}");
            let text = refused(Effect::new(name).with("colour", 1.0));
            let known = format!("`effects[0].colour`: is no parameter of {name}; it has");
            assert!(text.contains(&known), "{text}");
        }
    }
}

/// Noise-free readings of a device that was just switched on, frame after frame, with what its converter makes of them; then
/// those of [`ForwardModel::response`] for the last stimulus.
///
/// # Panics
///
/// Where the device refuses a stimulus.
#[must_use]
pub fn along(model: &dyn ForwardModel, stimuli: &[Stimulus], frame: f64) -> Vec<f64> {
    let mut walk = model.trajectory();
    let mut readings = vec![0.0; model.channels()];
    let mut all = Vec::new();
    for (i, stimulus) in stimuli.iter().enumerate() {
        let (t, mut stimulus) = (i as f64 * frame, stimulus.clone());
        walk.touch(t, &mut stimulus);
        model.response(&stimulus, &mut readings).expect("the stimuli of a test can be");
        walk.transduce(t, &stimulus, &mut readings);
        walk.convert(&mut readings);
        all.extend_from_slice(&readings);
    }
    if let Some(last) = stimuli.last() {
        model.response(last, &mut readings).expect("the stimuli of a test can be");
        all.extend_from_slice(&readings);
    }
    all
}

/// A common effect that shows in the readings of `skin`: its first two channels, or taxels, are off.
///
/// # Panics
///
/// Where the skin has fewer than two channels or taxels.
#[must_use]
pub fn switched_on(info: &CommonEffect, skin: &SkinDescription) -> Effect {
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

/// Lists of effects whose readings a family records: each effect alone, in pairs across the seam between the family and what is
/// common to all, and all at once.
#[must_use]
pub fn cases(known: &[EffectInfo], skin: &SkinDescription) -> Vec<Vec<Effect>> {
    let own: Vec<Effect> = known.iter().map(|info| Effect::new(info.name).seed(5)).collect();
    let common: Vec<Effect> = COMMON.iter().map(|info| switched_on(info, skin)).collect();
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
///
/// # Panics
///
/// Where they differ, or the file cannot be read or written.
pub fn as_recorded(path: &Path, found: &BTreeMap<String, Vec<f64>>) {
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
