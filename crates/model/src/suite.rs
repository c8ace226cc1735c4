//! What is promised of every effect of every sensor family: property tests that each family runs over its own table.

mod probe;
mod recorded;

use std::sync::Arc;

use dermis_skin::{Effect, EffectInfo, ModelError, SkinDescription};

use crate::{Case, ForwardModel, Stimulus};

pub use probe::{Probe, forwards_everything};

/// Prints all validation cases, and fails where one does.
///
/// # Panics
///
/// Names the cases that failed.
pub fn all_pass(cases: &[Case]) {
    for case in cases {
        println!("{} {}: {:e} for {:e} ({:e})", case.id, case.what, case.got, case.reference, case.tolerance);
    }
    let failed: Vec<&Case> = cases.iter().filter(|c| !c.pass).collect();
    assert!(failed.is_empty(), "{failed:#?}");
}

/// Makes the device that a skin describes.
pub type Makes<'a> = dyn Fn(&SkinDescription) -> Result<Arc<dyn ForwardModel>, ModelError> + 'a;

/// The effects of a family, and how devices with them are made.
pub struct Effects<'a> {
    /// The family's table.
    pub known: &'static [EffectInfo],
    /// A skin with these effects.
    pub skin: &'a dyn Fn(Vec<Effect>) -> SkinDescription,
    /// The device that a skin describes.
    pub device: &'a Makes<'a>,
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
    fn read(&self, device: &dyn ForwardModel, stimuli: &[Stimulus]) -> Vec<f64> {
        steps(device, stimuli, self.frame)
    }

    fn device(&self, effects: Vec<Effect>) -> Arc<dyn ForwardModel> {
        (self.device)(&(self.skin)(effects)).expect("the devices of a test can be")
    }

    /// Noise-free readings, frame after frame, of a device that was just switched on.
    ///
    /// # Panics
    ///
    /// Where there is no such device, or it refuses a stimulus.
    #[must_use]
    pub fn readings(&self, effects: Vec<Effect>, stimuli: &[Stimulus]) -> Vec<f64> {
        self.read(self.device(effects).as_ref(), stimuli)
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
    /// just switched on; and a new state is a device that was never touched.
    ///
    /// # Panics
    ///
    /// Where that is not so.
    pub fn remember_what_they_should(&self, stimuli: &[Stimulus], middle: usize, seed: u64) {
        for info in self.known {
            let device = self.device(vec![Effect::new(info.name).seed(seed)]);
            let after = self.read(device.as_ref(), &stimuli[..=middle]);
            let fresh = self.read(device.as_ref(), &stimuli[middle..=middle]);
            let last = &after[after.len() - device.channels()..];
            assert_eq!(!same(last, &fresh), info.stateful, "{}", info.name);
            let again = self.read(device.as_ref(), stimuli);
            assert!(same(&again, &self.read(device.as_ref(), stimuli)), "{} is not reset", info.name);
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

/// Noise-free readings of a device that was just switched on, frame after frame, with what its converter makes of them.
fn steps(model: &dyn ForwardModel, stimuli: &[Stimulus], frame: f64) -> Vec<f64> {
    let mut state = model.start(0);
    let mut readings = vec![0.0; model.channels()];
    let mut all = Vec::new();
    for (i, stimulus) in stimuli.iter().enumerate() {
        let (t, mut stimulus) = (i as f64 * frame, stimulus.clone());
        state.apply_to_stimulus(t, &mut stimulus);
        state.step(t, &stimulus, &mut readings).expect("the stimuli of a test can be");
        state.quantize(&mut readings);
        all.extend_from_slice(&readings);
    }
    all
}
