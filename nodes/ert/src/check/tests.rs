//! Faults that effects of the simulator make, and touches that make none.

use dermis_model::{ForwardModel, Stimulus};
use dermis_skin::Effect;
use nalgebra::Vector3;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use super::*;
use crate::model::tests::small;

const PANEL: &str = include_str!("../../../../launch/skins/ert-panel.toml");

/// A device of the panel that ships.
struct Device {
    skin: SkinDescription,
    model: FabricModel,
    check: ElectrodeCheck,
    rng: ChaCha8Rng,
}

impl Device {
    fn new(effects: Vec<Effect>) -> Self {
        let mut skin = small(PANEL);
        skin.effects = effects;
        let model = FabricModel::new(&skin).unwrap();
        let check = ElectrodeCheck::new(&skin).unwrap();
        Self { skin, model, check, rng: ChaCha8Rng::seed_from_u64(5) }
    }

    /// Electrodes whose wire, or whose contact with the top layer, is not as designed.
    fn harmed(&self) -> Vec<String> {
        let drive = &self.model.parameters().drive;
        let harmed = |e: &usize| drive.whole[*e] != 1.0 || drive.short[*e] != 0.0;
        (0..self.skin.taxels.len())
            .filter(harmed)
            .map(|e| format!("electrode {}", self.skin.taxels[e].name))
            .collect()
    }

    /// Tips at random locations, every other one on an electrode, that press as hard as the panel is built for.
    fn touches(&mut self, tips: usize) -> Stimulus {
        let rated = self.skin.rated_press();
        let press = |rng: &mut ChaCha8Rng| {
            let mut at = [rng.random_range(-0.25..0.25), rng.random_range(-0.26..0.26)];
            if rng.random_bool(0.5) {
                let [x, y, _] = self.skin.taxels[rng.random_range(0..self.skin.taxels.len())].position;
                at = [x, y];
            }
            let (position, normal) = self.model.parameters().panel.roll(at);
            let force = rng.random_range(rated.force[0]..rated.force[1]);
            let tip = Tip::standing(TipShape::FlatPunch { diameter: rated.diameter }, &Vector3::z());
            Indentation { position, force: -normal * force, tip }
        };
        let contacts = (0..tips).map(|_| press(&mut self.rng)).collect();
        Stimulus { contacts, ..Stimulus::default() }
    }

    /// Readings with noise, in counts of the converter.
    fn read(&mut self, stimulus: &Stimulus) -> Vec<f32> {
        let mut out = vec![0.0; self.model.channels()];
        self.model.response(stimulus, &mut out).unwrap();
        for v in &mut out {
            *v += self.skin.noise * self.rng.sample::<f64, _>(StandardNormal);
        }
        self.model.start(0).quantize(&mut out);
        out.into_iter().map(|v| v as f32).collect()
    }

    fn look(&mut self, values: Vec<f32>) -> Vec<ElementFault> {
        let mut faults = Vec::new();
        self.check.check(&Frame::new(0, 0, values), &mut faults);
        faults
    }

    /// Faults at the last of some frames, each with so many tips elsewhere.
    fn last(&mut self, frames: u32, tips: usize) -> Vec<ElementFault> {
        let mut faults = Vec::new();
        for _ in 0..frames {
            let stimulus = self.touches(tips);
            let values = self.read(&stimulus);
            faults = self.look(values);
        }
        faults
    }

    /// The fault whose sentence begins so is that of every harmed electrode, and there is none else.
    fn names(&mut self, frames: u32, tips: usize, begins: &str) {
        let faults = self.last(frames, tips);
        let elements: Vec<String> = faults.iter().map(|fault| fault.element.clone()).collect();
        assert_eq!(elements, self.harmed(), "{faults:?} with {tips} tips");
        for fault in &faults {
            assert!(fault.sentence.starts_with(begins), "{fault}");
            assert_eq!(fault.channels.len(), 55, "{fault}");
            let name = fault.element.trim_start_matches("electrode ");
            let own = |c: &usize| self.skin.channels()[*c].name.split('-').any(|part| part == name);
            assert!(fault.channels.iter().all(own), "{fault:?}");
        }
    }
}

fn short(resistance: f64) -> Effect {
    Effect::new("shorted-electrode").with("resistance", resistance)
}

#[test]
fn touches_are_no_faults() {
    let other = ["electrode-impedance", "mux-resistance", "ground-resistance", "settling", "mux-leakage"];
    for effects in [Vec::new(), other.map(|name| Effect::new(name).seed(3)).to_vec()] {
        let mut device = Device::new(effects);
        for frame in 0..200 {
            let stimulus = device.touches(frame % 7);
            // Each for longer than a fault takes to be believed, but for noise.
            let values = device.read(&stimulus);
            for _ in 0..=LASTING {
                let faults = device.look(values.clone());
                assert_eq!(faults, [], "frame {frame}");
            }
        }
    }
}

#[test]
fn an_open_electrode_is_named_at_once() {
    for (seed, tips) in [(1, 0), (2, 1), (3, 6)] {
        Device::new(vec![Effect::new("open-electrode").seed(seed)]).names(1, tips, "is open");
        Device::new(vec![Effect::new("open-electrode").with("count", 3.0).seed(seed)])
            .names(1, tips, "is open");
    }
}

#[test]
fn a_shorted_electrode_is_named_with_its_resistance() {
    for (resistance, tips) in [(1e3, 0), (1e4, 0), (1e4, 1), (1e4, 6), (2.5e4, 1)] {
        let mut device = Device::new(vec![short(resistance).seed(7)]);
        assert_eq!(device.last(LASTING - 1, tips), []);
        device.names(1, tips, "is shorted");
        let sentence = device.last(1, tips).remove(0).sentence;
        let found: f64 = sentence.split_whitespace().nth(8).unwrap().parse().unwrap();
        // Touches take current, too: six of the hardest a fifth of it.
        assert!((0.75..1.1).contains(&(found * 1e3 / resistance)), "{resistance} ohm: {sentence}");
    }
    // As silent as an open one.
    Device::new(vec![short(1.0).seed(2)]).names(1, 1, "is shorted");
    Device::new(vec![short(1e4).with("count", 2.0).seed(4)]).names(LASTING, 1, "is shorted");
}

#[test]
fn what_leans_on_a_panel_is_no_short() {
    let mut device = Device::new(vec![short(3e5)]);
    assert_eq!(device.last(LASTING + 5, 0), []);
}

#[test]
fn a_multiplexer_that_fails_on_one_side_is_distinguished_from_a_wire() {
    let mut device = Device::new(Vec::new());
    let stimulus = device.touches(1);
    let whole = device.read(&stimulus);
    let with = |silent: &dyn Fn(usize, usize) -> bool, value: f32| -> Vec<f32> {
        whole.iter().enumerate().map(|(i, v)| if silent(i / 28, i % 28) { value } else { *v }).collect()
    };
    let not_fed = device.look(with(&|fed, _| fed == 4, 0.0));
    insta::assert_snapshot!(not_fed[0], @"electrode e04 is not fed but read: check the multiplexer of the source");
    let not_read = device.look(with(&|_, read| read == 4, 0.0));
    insta::assert_snapshot!(not_read[0], @"electrode e04 is fed but not read: check the multiplexer of the converter");
    let floats = device.look(with(&|_, read| read == 4, 3.3));
    insta::assert_snapshot!(floats[0], @"electrode e04 reads more than the 3 V of the source: its input floats or touches a supply; check its wire, and `medium.drive.source_voltage`");
    assert_eq!([not_fed.len(), not_read.len(), floats.len()], [1; 3]);
    assert_eq!([&not_fed[0], &not_read[0], &floats[0]].map(|fault| fault.channels.len()), [28; 3]);
}

#[test]
fn injections_in_another_order_are_named() {
    let mut device = Device::new(Vec::new());
    // A touch beside an electrode, so that the sheet is not at one potential.
    let [x, y, _] = device.skin.taxels[9].position;
    let (position, normal) = device.model.parameters().panel.roll([x, y]);
    let tip = Tip::standing(TipShape::FlatPunch { diameter: 0.02 }, &normal);
    let press = Indentation { position, force: -normal * 40.0, tip };
    let stimulus = Stimulus { contacts: vec![press], ..Stimulus::default() };
    let mut faults = Vec::new();
    for _ in 0..LASTING {
        let mut values = device.read(&stimulus);
        // The frame begins one injection late.
        values.rotate_left(28);
        assert_eq!(faults, []);
        faults = device.look(values);
    }
    assert!(faults.iter().any(|fault| fault.sentence.contains("order of the skin file")), "{faults:?}");
    device.check.reset();
    let values = device.read(&stimulus);
    assert_eq!(device.look(values), []);
}

#[test]
fn frames_that_lack_numbers_are_inspected() {
    let mut device = Device::new(vec![Effect::new("open-electrode").seed(1)]);
    let stimulus = device.touches(0);
    let mut values = device.read(&stimulus);
    values[3] = f32::NAN;
    values[29] = f32::NAN;
    let elements: Vec<String> = device.look(values).into_iter().map(|fault| fault.element).collect();
    assert_eq!(elements, device.harmed());
    assert_eq!(device.look(vec![f32::NAN; 784]), []);
    assert_eq!(device.look(vec![0.0; 12]), []);
}
