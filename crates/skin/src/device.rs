//! Effects that every skin can have, whatever it senses with: electronics, placement, and the rig that it was measured on.
//!
//! A skin description switches them on like those of its family; their parameters are named after channels (`b0 = 1.02`) or
//! taxels (`"b0.x" = 1e-4`). The family's model never sees them: [`device`] takes them out and puts them around it.

use std::collections::VecDeque;
use std::sync::Arc;

use nalgebra::{Point3, Rotation3, Vector3};

use crate::{Effect, ForwardModel, ModelError, SkinDescription, Stimulus, Surface, Trajectory};

/// An effect that every skin can have.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CommonEffect {
    /// As files call it.
    pub name: &'static str,
    /// One sentence for people.
    pub what: &'static str,
    /// What its parameters are called: channels, taxels with an axis, or these.
    pub parameters: CommonParameters,
    /// Unit of its parameters; empty: that of the skin.
    pub unit: &'static str,
    /// Whether readings depend on what happened before.
    pub stateful: bool,
    /// Whether it belongs to the rig rather than to the skin.
    pub rig: bool,
}

/// What the parameters of a common effect are called.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CommonParameters {
    /// Names of channels.
    Channels,
    /// Names of taxels with `.x`, `.y` or `.z`.
    Taxels,
    /// These names.
    Named(&'static [&'static str]),
}

const fn common(
    name: &'static str,
    what: &'static str,
    parameters: CommonParameters,
    unit: &'static str,
    stateful: bool,
    rig: bool,
) -> CommonEffect {
    CommonEffect { name, what, parameters, unit, stateful, rig }
}

/// Every effect that is common to all skins. Names are part of the file format.
pub const COMMON: &[CommonEffect] = &[
    common(
        "channel-offset",
        "Channels read something where nothing touches.",
        CommonParameters::Channels,
        "",
        false,
        false,
    ),
    common(
        "channel-gain",
        "Channels read too much or too little, each by a factor of its own.",
        CommonParameters::Channels,
        "1",
        false,
        false,
    ),
    common(
        "taxel-position",
        "Taxels do not lie where they were designed to.",
        CommonParameters::Taxels,
        "m",
        false,
        false,
    ),
    common(
        "thermal-zero",
        "The zero of channels follows the temperature; neutral at 20 °C.",
        CommonParameters::Channels,
        "",
        false,
        false,
    ),
    common(
        "thermal-span",
        "The gain of channels follows the temperature; neutral at 20 °C.",
        CommonParameters::Channels,
        "1/K",
        false,
        false,
    ),
    common(
        "delay",
        "Readings come late against the ground truth.",
        CommonParameters::Named(&["time"]),
        "s",
        true,
        false,
    ),
    common(
        "low-pass",
        "Readings follow with a time constant.",
        CommonParameters::Named(&["time"]),
        "s",
        true,
        false,
    ),
    common(
        "truth-shift",
        "Contacts are elsewhere than the ground truth says: the skin is mounted askew on the rig.",
        CommonParameters::Named(&["x", "y", "z", "turn"]),
        "m",
        false,
        true,
    ),
    common(
        "force-scale",
        "The force cell reads too much or too little: the true force is that factor of what it says.",
        CommonParameters::Named(&["factor"]),
        "1",
        false,
        true,
    ),
    common(
        "force-zero",
        "The zero of the force cell is off: the true force is that much larger.",
        CommonParameters::Named(&["force"]),
        "N",
        false,
        true,
    ),
    common(
        "tip-scale",
        "The tip is larger, or smaller, than the ground truth says.",
        CommonParameters::Named(&["factor"]),
        "1",
        false,
        true,
    ),
    common(
        "channel-order",
        "Channels are read in another order: each parameter names the place, from 0, from which the channel's readings come.",
        CommonParameters::Channels,
        "1",
        false,
        false,
    ),
];

/// The common effect of that name.
#[must_use]
pub fn common_effect(name: &str) -> Option<&'static CommonEffect> {
    COMMON.iter().find(|c| c.name == name)
}

/// \[K\] at which thermal effects are neutral.
const NEUTRAL: f64 = 293.15;

/// The forward model of a skin whose description may switch common effects on; `make` builds the family's.
///
/// # Errors
///
/// [`ModelError::Description`] names the effect and parameter that cannot be; what `make` says.
pub fn device<E: From<ModelError>>(
    skin: &SkinDescription,
    make: impl FnOnce(&SkinDescription) -> Result<Arc<dyn ForwardModel>, E>,
) -> Result<Arc<dyn ForwardModel>, E> {
    if !skin.effects.iter().any(|e| common_effect(&e.name).is_some()) {
        return make(skin);
    }
    let mut inner = skin.clone();
    inner.effects.retain(|e| common_effect(&e.name).is_none());
    let mut around = Around::neutral(skin);
    for (i, effect) in skin.effects.iter().enumerate() {
        let Some(info) = common_effect(&effect.name) else { continue };
        for (name, value) in &effect.parameters {
            let wrong = |reason: String| {
                E::from(ModelError::Description {
                    skin: skin.name.clone(),
                    field: format!("effects[{i}].{name}"),
                    reason,
                })
            };
            around.set(info, effect, name, *value, &mut inner).map_err(wrong)?;
        }
    }
    let model = make(&inner)?;
    if around.is_neutral() {
        return Ok(model);
    }
    Ok(Arc::new(Device { model, around: Arc::new(around) }))
}

/// What is around a family's model.
#[derive(Debug, Clone, PartialEq)]
struct Around {
    channels: Vec<String>,
    taxels: Vec<String>,
    gain: Vec<f64>,
    offset: Vec<f64>,
    thermal_zero: Vec<f64>,
    thermal_span: Vec<f64>,
    order: Vec<usize>,
    delay: f64,
    low_pass: f64,
    shift: Vector3<f64>,
    turn: f64,
    force_scale: f64,
    force_zero: f64,
    tip: f64,
}

impl Around {
    fn neutral(skin: &SkinDescription) -> Self {
        let channels: Vec<String> = skin.channels().iter().map(|c| c.name.clone()).collect();
        let n = channels.len();
        Self {
            taxels: skin.taxels.iter().map(|t| t.name.clone()).collect(),
            gain: vec![1.0; n],
            offset: vec![0.0; n],
            thermal_zero: vec![0.0; n],
            thermal_span: vec![0.0; n],
            order: (0..n).collect(),
            channels,
            delay: 0.0,
            low_pass: 0.0,
            shift: Vector3::zeros(),
            turn: 0.0,
            force_scale: 1.0,
            force_zero: 0.0,
            tip: 1.0,
        }
    }

    fn is_neutral(&self) -> bool {
        let mut zero = self.clone();
        zero.order.sort_unstable();
        self.gain.iter().all(|g| *g == 1.0)
            && [&self.offset, &self.thermal_zero, &self.thermal_span]
                .iter()
                .all(|v| v.iter().all(|x| *x == 0.0))
            && self.order == zero.order
            && (self.delay, self.low_pass, self.turn, self.force_zero) == (0.0, 0.0, 0.0, 0.0)
            && self.shift == Vector3::zeros()
            && (self.force_scale, self.tip) == (1.0, 1.0)
    }

    /// Takes one parameter over; what is wrong with it otherwise.
    fn set(
        &mut self,
        info: &CommonEffect,
        effect: &Effect,
        name: &str,
        value: f64,
        inner: &mut SkinDescription,
    ) -> Result<(), String> {
        let strength = effect.strength;
        let scaled = strength * value;
        match info.parameters {
            CommonParameters::Channels => {
                let Some(k) = self.channels.iter().position(|c| c == name) else {
                    return Err(format!("is no channel of this skin; it has {}", self.channels.join(", ")));
                };
                match info.name {
                    "channel-offset" => self.offset[k] = scaled,
                    "channel-gain" => {
                        let gain = 1.0 + strength * (value - 1.0);
                        if gain.abs() < 1e-6 {
                            return Err(format!("is {value} and must not be 0: mask a dead channel"));
                        }
                        self.gain[k] = gain;
                    }
                    "thermal-zero" => self.thermal_zero[k] = scaled,
                    "thermal-span" => self.thermal_span[k] = scaled,
                    _ => {
                        let from = value.round();
                        if from != value || from < 0.0 || from as usize >= self.channels.len() {
                            return Err(format!(
                                "is {value} and must be a place from 0 to {}",
                                self.channels.len() - 1
                            ));
                        }
                        if strength > 0.0 {
                            self.order[k] = from as usize;
                        }
                    }
                }
            }
            CommonParameters::Taxels => {
                let place = name.rsplit_once('.').and_then(|(taxel, axis)| {
                    let axis = ["x", "y", "z"].iter().position(|a| *a == axis)?;
                    Some((self.taxels.iter().position(|t| t == taxel)?, axis))
                });
                let Some((taxel, axis)) = place else {
                    return Err("names a taxel and an axis, e.g. \"t0.x\"".to_owned());
                };
                inner.taxels[taxel].position[axis] += scaled;
            }
            CommonParameters::Named(names) => {
                if !names.contains(&name) {
                    return Err(format!("is no parameter of {}; it has {}", info.name, names.join(", ")));
                }
                let not_negative = |v: f64| {
                    if v >= 0.0 { Ok(v) } else { Err(format!("is {v} s and must be 0 or positive")) }
                };
                let factor = 1.0 + strength * (value - 1.0);
                match (info.name, name) {
                    ("delay", _) => self.delay = not_negative(scaled)?,
                    ("low-pass", _) => self.low_pass = not_negative(scaled)?,
                    ("truth-shift", "x") => self.shift.x = scaled,
                    ("truth-shift", "y") => self.shift.y = scaled,
                    ("truth-shift", "z") => self.shift.z = scaled,
                    ("truth-shift", _) => self.turn = scaled,
                    ("force-zero", _) => self.force_zero = scaled,
                    (_, _) if factor <= 0.0 => return Err(format!("is {value} and must be positive")),
                    ("force-scale", _) => self.force_scale = factor,
                    _ => self.tip = factor,
                }
            }
        }
        Ok(())
    }

    /// What really touches where the rig says this.
    fn real(&self, stimulus: &Stimulus, surface: &Surface) -> Stimulus {
        let mut real = stimulus.clone();
        let turn = (self.turn != 0.0).then(|| Rotation3::from_axis_angle(&Vector3::z_axis(), self.turn));
        let still = self.shift == Vector3::zeros() && turn.is_none();
        for contact in &mut real.contacts {
            let (_, before) = surface.project(&contact.position);
            if !still {
                let turned = turn.map_or(contact.position, |t| t * contact.position);
                let (on, after) = surface.project(&(turned + self.shift));
                contact.position = on;
                if (before - after).norm() > 1e-9 {
                    let bend =
                        Rotation3::rotation_between(&before, &after).unwrap_or_else(Rotation3::identity);
                    contact.force = bend * contact.force;
                }
            }
            contact.diameter *= self.tip;
            contact.force *= self.force_scale;
            if self.force_zero != 0.0 {
                let size = contact.force.norm();
                // A tip that the cell does not feel touches nowhere that anybody knows.
                let longer = (size + self.force_zero).max(0.0);
                contact.force *= longer / size.max(1e-12);
            }
        }
        real
    }

    fn apply(&self, temperature: f64, readings: &mut [f64]) {
        let warm = temperature - NEUTRAL;
        for (k, r) in readings.iter_mut().enumerate() {
            *r = *r * self.gain[k] * (1.0 + self.thermal_span[k] * warm)
                + self.offset[k]
                + self.thermal_zero[k] * warm;
        }
        self.permute(readings);
    }

    fn undo(&self, temperature: f64, readings: &mut [f64]) {
        let read = readings.to_vec();
        for (k, from) in self.order.iter().enumerate() {
            readings[*from] = read[k];
        }
        let warm = temperature - NEUTRAL;
        for (k, r) in readings.iter_mut().enumerate() {
            let factor = self.gain[k] * (1.0 + self.thermal_span[k] * warm);
            let factor = if factor.abs() < 1e-9 { 1.0 } else { factor };
            *r = (*r - self.offset[k] - self.thermal_zero[k] * warm) / factor;
        }
    }

    fn permute(&self, readings: &mut [f64]) {
        if self.order.iter().enumerate().any(|(k, from)| k != *from) {
            let read = readings.to_vec();
            for (r, from) in readings.iter_mut().zip(&self.order) {
                *r = read[*from];
            }
        }
    }
}

/// A family's model and what is around it.
struct Device {
    model: Arc<dyn ForwardModel>,
    around: Arc<Around>,
}

impl ForwardModel for Device {
    fn channels(&self) -> usize {
        self.model.channels()
    }

    fn surface(&self) -> &Surface {
        self.model.surface()
    }

    fn response(&self, stimulus: &Stimulus, out: &mut [f64]) -> Result<(), ModelError> {
        self.model.response(&self.around.real(stimulus, self.model.surface()), out)?;
        self.around.apply(stimulus.temperature, out);
        Ok(())
    }

    fn noise(&self) -> &[f64] {
        self.model.noise()
    }

    fn trajectory(&self) -> Box<dyn Trajectory> {
        Box::new(Along {
            inner: self.model.trajectory(),
            around: Arc::clone(&self.around),
            surface: self.model.surface().clone(),
            frames: VecDeque::new(),
            smooth: None,
        })
    }

    fn force_at(&self, at: &Point3<f64>, diameter: f64, depth: f64) -> Option<f64> {
        self.model.force_at(at, diameter * self.around.tip, depth)
    }

    fn depth_at(&self, at: &Point3<f64>, diameter: f64, force: f64) -> Option<f64> {
        self.model.depth_at(at, diameter * self.around.tip, force)
    }
}

/// The way of a device through time.
struct Along {
    inner: Box<dyn Trajectory>,
    around: Arc<Around>,
    surface: Surface,
    /// Time and readings, as far back as the delay needs.
    frames: VecDeque<(f64, Vec<f64>)>,
    /// Time and state of the low-pass.
    smooth: Option<(f64, Vec<f64>)>,
}

impl Trajectory for Along {
    fn touch(&mut self, time: f64, stimulus: &mut Stimulus) {
        self.inner.touch(time, stimulus);
    }

    fn transduce(&mut self, time: f64, stimulus: &Stimulus, readings: &mut [f64]) {
        // The medium remembers what it felt, not what the electronics made of it.
        self.around.undo(stimulus.temperature, readings);
        self.inner.transduce(time, &self.around.real(stimulus, &self.surface), readings);
        self.around.apply(stimulus.temperature, readings);
        if self.around.low_pass > 0.0 {
            let (then, state) = self.smooth.get_or_insert_with(|| (time, readings.to_vec()));
            let keep = (-(time - *then).max(0.0) / self.around.low_pass).exp();
            for (s, r) in state.iter_mut().zip(readings.iter_mut()) {
                *s = *r + (*s - *r) * keep;
                *r = *s;
            }
            *then = time;
        }
        if self.around.delay > 0.0 {
            let at = time - self.around.delay;
            while self.frames.len() > 1 && self.frames[1].0 <= at {
                self.frames.pop_front();
            }
            self.frames.push_back((time, readings.to_vec()));
            let after = self.frames.partition_point(|(t, _)| *t < at);
            match (after.checked_sub(1), self.frames.get(after)) {
                (Some(before), Some((t1, next))) => {
                    let (t0, ago) = &self.frames[before];
                    let part = (at - t0) / (t1 - t0);
                    for ((r, a), n) in readings.iter_mut().zip(ago).zip(next) {
                        *r = a + (n - a) * part;
                    }
                }
                (None, Some((_, next))) => readings.copy_from_slice(next),
                (_, None) => {}
            }
        }
    }

    fn convert(&mut self, readings: &mut [f64]) {
        self.inner.convert(readings);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Indentation;

    const SKIN: &str = r#"
schema = "dermis-skin/1"
name = "pad"
sensor = "taxels"
frame_id = "pad_link"
unit = "Pa"
rate = 100.0
noise = 1.0
surface = { type = "rectangle", size = [0.02, 0.02], spacing = 0.005 }
taxels = [{ name = "a", position = [-0.005, 0.0, -0.005] }, { name = "b", position = [0.005, 0.0, -0.005] }]
"#;

    /// Reads force over distance.
    struct Plain {
        surface: Surface,
        taxels: Vec<Point3<f64>>,
    }

    impl ForwardModel for Plain {
        fn channels(&self) -> usize {
            self.taxels.len()
        }
        fn surface(&self) -> &Surface {
            &self.surface
        }
        fn response(&self, stimulus: &Stimulus, out: &mut [f64]) -> Result<(), ModelError> {
            for (o, t) in out.iter_mut().zip(&self.taxels) {
                *o = stimulus.contacts.iter().map(|c| c.force.norm() / (c.position - t).norm()).sum();
            }
            Ok(())
        }
        fn noise(&self) -> &[f64] {
            &[1.0, 1.0]
        }
    }

    fn made(effects: Vec<Effect>) -> Result<Arc<dyn ForwardModel>, ModelError> {
        let mut skin = SkinDescription::from_toml(SKIN, "pad.toml").unwrap();
        skin.effects = effects;
        device(&skin, |inner| {
            assert!(inner.effects.iter().all(|e| e.name == "inner"));
            Ok(Arc::new(Plain {
                surface: inner.surface(),
                taxels: inner.taxels.iter().map(crate::Taxel::point).collect(),
            }))
        })
    }

    fn press(x: f64, force: f64) -> Stimulus {
        let contact = Indentation {
            position: Point3::new(x, 0.0, 0.0),
            force: Vector3::new(0.0, 0.0, -force),
            diameter: 0.004,
        };
        Stimulus { contacts: vec![contact], ..Stimulus::default() }
    }

    fn read(effects: Vec<Effect>, stimulus: &Stimulus) -> [f64; 2] {
        let mut out = [0.0; 2];
        made(effects).unwrap().response(stimulus, &mut out).unwrap();
        out
    }

    #[test]
    fn nothing_is_around_a_skin_without_common_effects() {
        assert_eq!(read(vec![Effect::new("inner")], &press(0.001, 1.0)), read(vec![], &press(0.001, 1.0)));
    }

    #[test]
    fn electronics_come_after_the_medium() {
        let plain = read(vec![], &press(0.0, 1.0));
        let effects = vec![
            Effect::new("channel-gain").with("a", 1.2).strength(0.5),
            Effect::new("channel-offset").with("b", 3.0),
            Effect::new("channel-order").with("a", 1.0).with("b", 0.0),
        ];
        let changed = read(effects, &press(0.0, 1.0));
        approx::assert_relative_eq!(changed[0], plain[1] + 3.0, max_relative = 1e-12);
        approx::assert_relative_eq!(changed[1], plain[0] * 1.1, max_relative = 1e-12);
    }

    #[test]
    fn what_the_rig_says_is_not_what_touches() {
        let shifted = read(vec![Effect::new("truth-shift").with("x", 0.002)], &press(0.001, 1.0));
        assert_eq!(shifted, read(vec![], &press(0.003, 1.0)));
        let stronger = vec![
            Effect::new("force-scale").with("factor", 1.5),
            Effect::new("force-zero").with("force", 0.1),
        ];
        let (found, wanted) = (read(stronger, &press(0.001, 1.0)), read(vec![], &press(0.001, 1.6)));
        approx::assert_relative_eq!(found[0], wanted[0], max_relative = 1e-12);
    }

    #[test]
    fn taxels_move() {
        let moved = read(vec![Effect::new("taxel-position").with("a.x", 0.005)], &press(0.0, 1.0));
        approx::assert_relative_eq!(moved[0], 1.0 / 0.005, max_relative = 1e-12);
    }

    #[test]
    fn a_delay_is_one_of_all_readings() {
        let model = made(vec![Effect::new("delay").with("time", 0.015)]).unwrap();
        let mut way = model.trajectory();
        let mut last = [0.0; 2];
        for frame in 0..10 {
            let stimulus = press(0.0, f64::from(frame));
            model.response(&stimulus, &mut last).unwrap();
            way.transduce(f64::from(frame) * 0.01, &stimulus, &mut last);
        }
        let before = read(vec![], &press(0.0, 7.5));
        approx::assert_relative_eq!(last[0], before[0], max_relative = 1e-9);
    }

    #[test]
    fn refusals_name_the_parameter() {
        let refused = |effect| made(vec![effect]).err().unwrap().to_string();
        insta::assert_snapshot!(refused(Effect::new("channel-gain").with("c", 1.0)), @"skin `pad`: field `effects[0].c`: is no channel of this skin; it has a, b");
        insta::assert_snapshot!(refused(Effect::new("channel-gain").with("a", 0.0)), @"skin `pad`: field `effects[0].a`: is 0 and must not be 0: mask a dead channel");
        insta::assert_snapshot!(refused(Effect::new("delay").with("time", -1.0)), @"skin `pad`: field `effects[0].time`: is -1 s and must be 0 or positive");
        insta::assert_snapshot!(refused(Effect::new("truth-shift").with("w", 1.0)), @"skin `pad`: field `effects[0].w`: is no parameter of truth-shift; it has x, y, z, turn");
        insta::assert_snapshot!(refused(Effect::new("taxel-position").with("a", 1.0)), @r#"skin `pad`: field `effects[0].a`: names a taxel and an axis, e.g. "t0.x""#);
        insta::assert_snapshot!(refused(Effect::new("channel-order").with("a", 7.0)), @"skin `pad`: field `effects[0].a`: is 7 and must be a place from 0 to 1");
    }
}
