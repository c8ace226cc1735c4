//! What is promised of every effect of every sensor family: property tests that each family runs over its own table.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use dermis_skin::{
    Effect, EffectInfo, Image, ModelError, PixelFormat, SkinDescription, Surface, SurfaceSpec,
};
use nalgebra::{Point3, Vector3};

use crate::{
    COMMON, CommonEffect, CommonParameters, DeviceState, Differences, ForwardModel, Indentation, Stimulus,
    Unknowns, common_effect,
};

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

/// Noise-free readings of a device that was just switched on, frame after frame, with what its converter makes of them; then
/// those of [`ForwardModel::response`] for the last stimulus.
///
/// # Panics
///
/// Where the device refuses a stimulus.
#[must_use]
pub fn along(model: &dyn ForwardModel, stimuli: &[Stimulus], frame: f64) -> Vec<f64> {
    let mut all = steps(model, stimuli, frame);
    if let Some(last) = stimuli.last() {
        let mut readings = vec![0.0; model.channels()];
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
///
/// # Panics
///
/// Where a common effect is missing from the recordings.
#[must_use]
pub fn cases(known: &[EffectInfo], skin: &SkinDescription) -> Vec<Vec<Effect>> {
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

/// A model whose every method answers with something that no default does, to try wrappers on: two channels on a square of 20 mm.
pub struct Probe {
    surface: Surface,
    superposes: bool,
}

impl Default for Probe {
    fn default() -> Self {
        let spec = SurfaceSpec::Rectangle { size: [0.02, 0.02], spacing: 0.005 };
        Self { surface: Surface::from_spec(&spec), superposes: false }
    }
}

impl Probe {
    /// One that says that readings of contacts add up.
    #[must_use]
    pub fn that_superposes() -> Self {
        Self { superposes: true, ..Self::default() }
    }
}

/// Counts its steps from the seed on.
struct ProbeState(f64);

impl DeviceState for ProbeState {
    fn apply_to_stimulus(&mut self, time: f64, stimulus: &mut Stimulus) {
        stimulus.temperature += 1.0 + time;
    }

    fn step(&mut self, time: f64, stimulus: &Stimulus, out: &mut [f64]) -> Result<(), ModelError> {
        self.0 += 1.0;
        out.copy_from_slice(&[self.0 + time, stimulus.temperature]);
        Ok(())
    }

    fn quantize(&mut self, readings: &mut [f64]) {
        readings.iter_mut().for_each(|r| *r = r.round());
    }
}

#[deny(clippy::missing_trait_methods)]
impl ForwardModel for Probe {
    fn channels(&self) -> usize {
        2
    }

    fn surface(&self) -> &Surface {
        &self.surface
    }

    fn response(&self, stimulus: &Stimulus, out: &mut [f64]) -> Result<(), ModelError> {
        let force: f64 = stimulus.contacts.iter().map(|c| c.force.norm()).sum();
        out.copy_from_slice(&[3.0 * force, 5.0 * force]);
        Ok(())
    }

    /// Not what [`response`](ForwardModel::response) says, so that it shows who was asked.
    fn untouched(&self, out: &mut [f64]) -> Result<(), ModelError> {
        out.copy_from_slice(&[17.0, 19.0]);
        Ok(())
    }

    /// Not what [`response`](ForwardModel::response) says, so that it shows who was asked.
    fn responses(&self, stimuli: &[Stimulus], out: &mut [f64]) -> Result<(), ModelError> {
        out.fill(stimuli.len() as f64);
        Ok(())
    }

    fn jacobian(
        &self,
        _: &Stimulus,
        unknowns: Unknowns,
        _: &Differences,
        out: &mut [f64],
    ) -> Result<(), ModelError> {
        out.fill(unknowns.count() as f64);
        Ok(())
    }

    fn superposes(&self) -> bool {
        self.superposes
    }

    fn noise(&self) -> &[f64] {
        &[0.25, 0.5]
    }

    fn displacement(&self, stimulus: &Stimulus, out: &mut [f64]) -> Result<bool, ModelError> {
        out.fill(7.0 + stimulus.contacts.len() as f64);
        Ok(true)
    }

    /// One grey pixel that tells the number of contacts and the noise.
    fn capture(
        &self,
        stimulus: &Stimulus,
        noise: &mut dyn FnMut() -> f64,
    ) -> Result<Option<Image>, ModelError> {
        let level = 10.0 * stimulus.contacts.len() as f64 + noise();
        Ok(Image::new(1, 1, PixelFormat::Mono8, vec![level as u8]))
    }

    fn observe(&self, image: &Image, out: &mut [f64]) -> bool {
        out.fill(f64::from(image.data()[0]));
        true
    }

    fn remembers(&self) -> bool {
        true
    }

    fn start(&self, seed: u64) -> Box<dyn DeviceState + '_> {
        Box::new(ProbeState(seed as f64))
    }

    fn force_at(&self, at: &Point3<f64>, diameter: f64, depth: f64) -> Option<f64> {
        Some(at.x + 10.0 * diameter + 100.0 * depth)
    }

    fn depth_at(&self, at: &Point3<f64>, diameter: f64, force: f64) -> Option<f64> {
        Some(at.x + 10.0 * diameter + force)
    }
}

/// What every method of a wrapper around [`Probe`] says must be what the probe says; `noise` is the one that it should have. Where
/// `same_response` is false, the wrapper has ways of its own for responses (neutral ones in the test): then they and their
/// derivatives are compared with the wrapper's own response.
///
/// # Panics
///
/// Where a method is not forwarded.
pub fn forwards_everything(wrapper: &dyn ForwardModel, noise: &[f64], same_response: bool) {
    let probe = Probe::default();
    let contact = Indentation::sphere(Point3::new(0.001, -0.002, 0.0), Vector3::new(0.0, 0.0, -0.5), 0.004);
    let stimulus = Stimulus { contacts: vec![contact], ..Stimulus::default() };
    assert_eq!(wrapper.channels(), probe.channels());
    assert_eq!(wrapper.surface().points, probe.surface().points);
    assert_eq!(wrapper.noise(), noise);
    assert_eq!(wrapper.superposes(), probe.superposes());
    let (mut own, mut wanted) = ([f64::NAN; 2], [f64::NAN; 2]);
    wrapper.response(&stimulus, &mut own).expect("a press can be");
    probe.response(&stimulus, &mut wanted).expect("a press can be");
    assert_eq!(own, wanted, "response");
    let mut rest = [f64::NAN; 2];
    wrapper.untouched(&mut rest).expect("nothing can touch");
    assert_eq!(rest, if same_response { [17.0, 19.0] } else { [0.0; 2] }, "untouched");
    assert!(wrapper.remembers(), "remembers");

    let mut many = [f64::NAN; 4];
    wrapper.responses(&[stimulus.clone(), stimulus.clone()], &mut many).expect("a press can be");
    let [a, b] = own;
    assert_eq!(many, if same_response { [2.0; 4] } else { [a, b, a, b] }, "responses");
    let mut jacobian = [f64::NAN; 6];
    wrapper
        .jacobian(&stimulus, Unknowns::Normal, &Differences::default(), &mut jacobian)
        .expect("a press can be");
    if same_response {
        assert_eq!(jacobian, [3.0; 6], "jacobian");
    } else {
        for (found, wanted) in jacobian.iter().zip([0.0, 0.0, 0.0, 0.0, 3.0, 5.0]) {
            assert!((found - wanted).abs() < 1e-6, "jacobian: {jacobian:?}");
        }
    }

    let mut points = vec![f64::NAN; probe.surface().points.len()];
    assert!(wrapper.displacement(&stimulus, &mut points).expect("a press can be"), "displacement");
    assert!(points.iter().all(|p| *p == 8.0), "displacement: {points:?}");
    let image =
        wrapper.capture(&stimulus, &mut || 3.0).expect("a press can be").expect("the probe has a camera");
    assert_eq!(image.data(), [13], "capture");
    assert!(wrapper.observe(&image, &mut own), "observe");
    assert_eq!(own, [13.0; 2], "observe");
    let at = Point3::new(0.003, 0.0, 0.0);
    assert_eq!(wrapper.force_at(&at, 0.004, 0.001), probe.force_at(&at, 0.004, 0.001), "force_at");
    assert_eq!(wrapper.depth_at(&at, 0.004, 0.7), probe.depth_at(&at, 0.004, 0.7), "depth_at");

    let (mut state, mut real) = (wrapper.start(40), stimulus);
    state.apply_to_stimulus(0.5, &mut real);
    assert_eq!(real.temperature, 293.15 + 1.5, "apply_to_stimulus");
    for n in 1..3 {
        state.step(0.25, &real, &mut own).expect("a press can be");
        assert_eq!(own, [40.25 + f64::from(n), real.temperature], "step, and the seed of start");
    }
    state.quantize(&mut own);
    assert_eq!(own, [42.0, 295.0], "quantize");
}
