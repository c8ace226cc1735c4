//! Effects that every skin can have, whatever it senses with: electronics, placement, and the rig that it was measured on.
//!
//! A skin description switches them on like those of its family; their parameters are named after channels (`b0 = 1.02`) or
//! taxels (`"b0.x" = 1e-4`). The family's model never sees them: [`device`] takes them out and puts them around it.

use std::collections::VecDeque;
use std::f64::consts::TAU;
use std::sync::Arc;

use nalgebra::{Point3, Rotation3, Vector3};
use serde::Serialize;

use crate::{ForwardModel, Stimulus, Trajectory};
use dermis_skin::{Channel, Effect, ModelError, ParameterInfo, SkinDescription, Surface};

/// An effect that every skin can have. Without parameters it is the identity.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct CommonEffect {
    /// As files call it.
    pub name: &'static str,
    /// One sentence for people.
    pub what: &'static str,
    /// Where the model comes from.
    pub source: &'static str,
    /// What its parameters are called: channels, taxels with an axis, or these.
    pub parameters: CommonParameters,
    /// Unit of parameters that are called after channels or taxels; empty: that of the skin.
    pub unit: &'static str,
    /// Whether readings depend on what happened before.
    pub stateful: bool,
    /// Whether it belongs to the rig rather than to the skin.
    pub rig: bool,
}

impl CommonEffect {
    /// Parameters that have a name of their own, whatever the skin.
    #[must_use]
    pub fn named(&self) -> &'static [ParameterInfo] {
        match self.parameters {
            CommonParameters::Named(named) | CommonParameters::ChannelsAnd(named) => named,
            CommonParameters::Channels | CommonParameters::Taxels => &[],
        }
    }

    /// Unit of a parameter; empty: that of the skin.
    #[must_use]
    pub fn unit_of(&self, parameter: &str) -> &'static str {
        self.named().iter().find(|p| p.name == parameter).map_or(self.unit, |p| p.unit)
    }
}

/// Curvature of a channel at most. Few skins use their channels to the full: what bends much there may be all but straight in use.
pub const CURVED: f64 = 100.0;

/// The larger end of a channel's range; 1000 deviations of its noise where it has none.
#[must_use]
pub fn full_scale(channel: &Channel, noise: f64) -> f64 {
    let ends = channel.range.map(|[low, high]| low.abs().max(high.abs()));
    let ends = ends.filter(|e| e.is_finite() && *e > 0.0);
    ends.unwrap_or(1e3 * channel.noise.unwrap_or(noise)).max(f64::MIN_POSITIVE)
}

/// What the parameters of a common effect are called.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum CommonParameters {
    /// Names of channels.
    Channels,
    /// Names of taxels with `.x`, `.y` or `.z`.
    Taxels,
    /// These; their typical value is what they are where a file does not name them.
    Named(&'static [ParameterInfo]),
    /// Names of channels, and these.
    ChannelsAnd(&'static [ParameterInfo]),
}

const fn common(
    name: &'static str,
    what: &'static str,
    source: &'static str,
    parameters: CommonParameters,
    unit: &'static str,
    [stateful, rig]: [bool; 2],
) -> CommonEffect {
    CommonEffect { name, what, source, parameters, unit, stateful, rig }
}

/// Every effect that is common to all skins. Names are part of the file format.
pub const COMMON: &[CommonEffect] = &[
    common(
        "channel-offset",
        "Channels read something where nothing touches.",
        "zero error of a transducer, IEC 60050-311",
        CommonParameters::Channels,
        "",
        [false, false],
    ),
    common(
        "channel-gain",
        "Channels read too much or too little, each by a factor of its own.",
        "sensitivity error of a transducer, IEC 60050-311",
        CommonParameters::Channels,
        "1",
        [false, false],
    ),
    common(
        "channel-curvature",
        "Channels are not straight: they read more or less by the square of the reading, by this share of it at full scale; beyond the vertex they stay.",
        "non-linearity of a bridge of one active arm, and of transducers: Hoffmann, An Introduction to Stress Analysis and Transducer Design; full scale is the larger end of a channel's range, 1000 deviations of its noise where it has none",
        CommonParameters::Channels,
        "1",
        [false, false],
    ),
    common(
        "crosstalk",
        "Channels read a share of what their neighbours on the bus read as well: of the one before, of the one after.",
        "charge that a multiplexer keeps from the channel before, and coupling of neighbouring lines: Horowitz and Hill, The Art of Electronics, 3rd ed., 3.4 and 13.11",
        CommonParameters::Named(&[
            ParameterInfo::new(
                "before",
                "1",
                "of what the channel before it on the bus reads",
                0.0,
                [-0.1, 0.3],
                [-0.49, 0.49],
            ),
            ParameterInfo::new(
                "after",
                "1",
                "of what the channel after it on the bus reads",
                0.0,
                [-0.1, 0.3],
                [-0.49, 0.49],
            ),
        ]),
        "1",
        [false, false],
    ),
    common(
        "taxel-position",
        "Taxels do not lie where they were designed to.",
        "placement tolerance",
        CommonParameters::Taxels,
        "m",
        [false, false],
    ),
    common(
        "thermal-zero",
        "The zero of channels follows the temperature; neutral at 20 °C.",
        "temperature coefficient of offset, as data sheets of transducers give it",
        CommonParameters::Channels,
        "",
        [false, false],
    ),
    common(
        "thermal-bend",
        "The zero of channels follows the square of the temperature; neutral at 20 °C.",
        "apparent strain of foils, as their data sheets give it: a polynomial of the temperature",
        CommonParameters::Channels,
        "",
        [false, false],
    ),
    common(
        "thermal-span",
        "The gain of channels follows the temperature; neutral at 20 °C.",
        "temperature coefficient of span, as data sheets of transducers give it",
        CommonParameters::Channels,
        "1/K",
        [false, false],
    ),
    common(
        "warm-up",
        "The zero of channels, and the sensitivity of all, are off when the device is switched on, and go home as it warms itself.",
        "first-order heating of a body by its own power, exp(-t / time), through its coefficients of zero and span",
        CommonParameters::ChannelsAnd(&[
            ParameterInfo::new(
                "time",
                "s",
                "after which 37 % of it is left",
                300.0,
                [30.0, 1800.0],
                [1.0, 1e5],
            ),
            ParameterInfo::new(
                "span",
                "1",
                "by which the sensitivity is too large at first",
                0.0,
                [-0.3, 0.3],
                [-0.95, 10.0],
            ),
        ]),
        "",
        [true, false],
    ),
    common(
        "ageing",
        "The sensitivity of all channels wanes, or grows, with the time that the device is on and with every press.",
        "first-order loss of sensitivity, exp(-rate · t - wear · n): ageing goes with time, wear with cycles of load",
        CommonParameters::Named(&[
            ParameterInfo::new(
                "rate",
                "1/s",
                "share of the sensitivity that is lost in a second",
                0.0,
                [-1e-3, 1e-3],
                [-1.0, 1.0],
            ),
            ParameterInfo::new(
                "wear",
                "1",
                "share of the sensitivity that is lost by a press",
                0.0,
                [-2e-3, 2e-3],
                [-1.0, 1.0],
            ),
        ]),
        "1",
        [true, false],
    ),
    common(
        "interference",
        "The mains, or a motor, couples into all channels as a hum of one frequency; what is above half of the frame rate shows below it.",
        "Ott, Electromagnetic Compatibility Engineering, ch. 2; mains at 50 or 60 Hz",
        CommonParameters::Named(&[
            ParameterInfo::new(
                "amplitude",
                "",
                "half of the hum from peak to peak",
                0.0,
                [0.0, 100.0],
                [0.0, 1e9],
            ),
            ParameterInfo::new("frequency", "Hz", "of the hum", 50.0, [1.0, 400.0], [0.0, 1e6]),
            ParameterInfo::new(
                "phase",
                "rad",
                "of the hum when the device is switched on",
                0.0,
                [0.0, 6.3],
                [-1e3, 1e3],
            ),
        ]),
        "",
        [true, false],
    ),
    common(
        "delay",
        "Readings come late against the ground truth.",
        "dead time of a chain of measurement",
        CommonParameters::Named(&[ParameterInfo::new(
            "time",
            "s",
            "by which they are late",
            0.0,
            [0.0, 0.1],
            [0.0, f64::INFINITY],
        )]),
        "s",
        [true, false],
    ),
    common(
        "low-pass",
        "Readings follow with a time constant.",
        "first-order filter",
        CommonParameters::Named(&[ParameterInfo::new(
            "time",
            "s",
            "time constant",
            0.0,
            [0.0, 0.1],
            [0.0, f64::INFINITY],
        )]),
        "s",
        [true, false],
    ),
    common(
        "truth-shift",
        "Contacts are elsewhere than the ground truth says: the skin is mounted askew on the rig.",
        "rigid displacement between two frames",
        CommonParameters::Named(&[
            ParameterInfo::new(
                "x",
                "m",
                "along x of the link frame",
                0.0,
                [-2e-3, 2e-3],
                [f64::NEG_INFINITY, f64::INFINITY],
            ),
            ParameterInfo::new(
                "y",
                "m",
                "along y of the link frame",
                0.0,
                [-2e-3, 2e-3],
                [f64::NEG_INFINITY, f64::INFINITY],
            ),
            ParameterInfo::new(
                "z",
                "m",
                "along z of the link frame",
                0.0,
                [-2e-3, 2e-3],
                [f64::NEG_INFINITY, f64::INFINITY],
            ),
            ParameterInfo::new(
                "turn",
                "rad",
                "about z of the link frame",
                0.0,
                [-0.1, 0.1],
                [f64::NEG_INFINITY, f64::INFINITY],
            ),
        ]),
        "m",
        [false, true],
    ),
    common(
        "force-scale",
        "The force cell reads too much or too little: the true force is that factor of what it says.",
        "sensitivity error of a force cell",
        CommonParameters::Named(&[ParameterInfo::new(
            "factor",
            "1",
            "true over said force",
            1.0,
            [0.9, 1.1],
            [0.0, f64::INFINITY],
        )]),
        "1",
        [false, true],
    ),
    common(
        "force-zero",
        "The zero of the force cell is off: the true force is that much larger.",
        "zero error of a force cell",
        CommonParameters::Named(&[ParameterInfo::new(
            "force",
            "N",
            "true minus said force",
            0.0,
            [-0.05, 0.05],
            [f64::NEG_INFINITY, f64::INFINITY],
        )]),
        "N",
        [false, true],
    ),
    common(
        "tip-scale",
        "The tip is larger, or smaller, than the ground truth says.",
        "tolerance of a tip",
        CommonParameters::Named(&[ParameterInfo::new(
            "factor",
            "1",
            "true over said diameter",
            1.0,
            [0.8, 1.25],
            [0.0, f64::INFINITY],
        )]),
        "1",
        [false, true],
    ),
    common(
        "channel-order",
        "Channels are read in another order: each parameter names the place, from 0, from which the channel's readings come.",
        "swapped plugs",
        CommonParameters::Channels,
        "1",
        [false, false],
    ),
];

/// The common effect of that name.
#[must_use]
pub fn common_effect(name: &str) -> Option<&'static CommonEffect> {
    COMMON.iter().find(|c| c.name == name)
}

/// Value of a parameter where a file does not name it.
fn typical(effect: &str, parameter: &str) -> f64 {
    let named = common_effect(effect).map_or(&[][..], CommonEffect::named);
    named.iter().find(|p| p.name == parameter).map_or(f64::NAN, |p| p.typical)
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
    /// Share of the square of a reading over its full scale, and that scale.
    curvature: Vec<f64>,
    full: Vec<f64>,
    thermal_zero: Vec<f64>,
    thermal_bend: Vec<f64>,
    thermal_span: Vec<f64>,
    order: Vec<usize>,
    /// Of the channel before, and of the one after.
    crosstalk: [f64; 2],
    /// Zero of each channel when it is switched on.
    cold: Vec<f64>,
    warming: f64,
    /// Share by which the sensitivity is too large when it is switched on.
    cold_span: f64,
    /// A second, and a press.
    ageing: [f64; 2],
    /// Amplitude, frequency, phase.
    hum: [f64; 3],
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
            curvature: vec![0.0; n],
            full: skin.channels().iter().map(|c| full_scale(c, skin.noise)).collect(),
            thermal_zero: vec![0.0; n],
            thermal_bend: vec![0.0; n],
            thermal_span: vec![0.0; n],
            order: (0..n).collect(),
            crosstalk: [0.0; 2],
            cold: vec![0.0; n],
            warming: typical("warm-up", "time"),
            cold_span: 0.0,
            ageing: [0.0; 2],
            hum: [0.0, typical("interference", "frequency"), 0.0],
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
            && [
                &self.offset,
                &self.curvature,
                &self.thermal_zero,
                &self.thermal_bend,
                &self.thermal_span,
                &self.cold,
            ]
            .iter()
            .all(|v| v.iter().all(|x| *x == 0.0))
            && self.order == zero.order
            && self.crosstalk == [0.0; 2]
            && self.ageing == [0.0; 2]
            && (self.cold_span, self.hum[0]) == (0.0, 0.0)
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
        if let Some(of) = info.named().iter().find(|p| p.name == name) {
            let [low, high] = of.limits;
            // Times and factors say by themselves what they must be.
            let bounded = low.is_finite() && high.is_finite();
            if bounded && !(low..=high).contains(&value) {
                let unit = if of.unit == "1" { "" } else { of.unit };
                return Err(format!("is {value} {unit} and must be {low} to {high}").replace("  ", " "));
            }
        }
        match info.parameters {
            CommonParameters::ChannelsAnd(named) if named.iter().any(|p| p.name == name) => match name {
                "time" => self.warming = value,
                _ => self.cold_span = scaled,
            },
            CommonParameters::Channels | CommonParameters::ChannelsAnd(_) => {
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
                    "channel-curvature" if scaled.abs() > CURVED => {
                        return Err(format!(
                            "is {scaled} at this strength and must be -{CURVED} to {CURVED}"
                        ));
                    }
                    "channel-curvature" => self.curvature[k] = scaled,
                    "thermal-zero" => self.thermal_zero[k] = scaled,
                    "thermal-bend" => self.thermal_bend[k] = scaled,
                    "thermal-span" => self.thermal_span[k] = scaled,
                    "warm-up" => self.cold[k] = scaled,
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
                if !names.iter().any(|p| p.name == name) {
                    let names: Vec<&str> = names.iter().map(|p| p.name).collect();
                    return Err(format!("is no parameter of {}; it has {}", info.name, names.join(", ")));
                }
                let not_negative = |v: f64| {
                    if v >= 0.0 { Ok(v) } else { Err(format!("is {v} s and must be 0 or positive")) }
                };
                let factor = 1.0 + strength * (value - 1.0);
                match (info.name, name) {
                    ("crosstalk", _) if scaled.abs() >= 0.5 => {
                        return Err(format!("is {scaled} at this strength and must stay below 0.5"));
                    }
                    ("crosstalk", side) => self.crosstalk[usize::from(side == "after")] = scaled,
                    ("ageing", of) => self.ageing[usize::from(of == "wear")] = scaled,
                    ("interference", "amplitude") => self.hum[0] = scaled,
                    ("interference", "frequency") => self.hum[1] = value,
                    ("interference", _) => self.hum[2] = value,
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

    /// Where the rig really is when it says that it is at `at`, and the normals of the surface at both.
    fn real_position(&self, at: &Point3<f64>, surface: &Surface) -> (Point3<f64>, [Vector3<f64>; 2]) {
        let (_, before) = surface.project(at);
        if self.shift == Vector3::zeros() && self.turn == 0.0 {
            return (*at, [before, before]);
        }
        let turned = Rotation3::from_axis_angle(&Vector3::z_axis(), self.turn) * at;
        let (on, after) = surface.project(&(turned + self.shift));
        (on, [before, after])
    }

    /// Position and diameter of a tip, really, where the rig says these.
    fn real_tip(&self, at: &Point3<f64>, diameter: f64, surface: &Surface) -> (Point3<f64>, f64) {
        (self.real_position(at, surface).0, diameter * self.tip)
    }

    /// What really touches where the rig says this.
    fn real(&self, stimulus: &Stimulus, surface: &Surface) -> Stimulus {
        let mut real = stimulus.clone();
        for contact in &mut real.contacts {
            let (on, [before, after]) = self.real_position(&contact.position, surface);
            contact.position = on;
            if (before - after).norm() > 1e-9 {
                let bend = Rotation3::rotation_between(&before, &after).unwrap_or_else(Rotation3::identity);
                contact.force = bend * contact.force;
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

    /// What the electronics make of what the transducers feel; `cold` is the share of the zero at switching on that is still there.
    fn apply(&self, temperature: f64, cold: f64, readings: &mut [f64]) {
        let warm = temperature - NEUTRAL;
        for (k, r) in readings.iter_mut().enumerate() {
            let straight = *r * self.gain[k] * (1.0 + self.thermal_span[k] * warm);
            // A transducer does not turn back: beyond the vertex it stays where it is.
            let vertex = -0.5 * self.full[k] / self.curvature[k];
            let straight = if self.curvature[k] > 0.0 { straight.max(vertex) } else { straight };
            let straight = if self.curvature[k] < 0.0 { straight.min(vertex) } else { straight };
            *r = straight
                + self.curvature[k] * straight * straight / self.full[k]
                + self.offset[k]
                + (self.thermal_zero[k] + self.thermal_bend[k] * warm) * warm;
            if self.cold[k] != 0.0 {
                *r += self.cold[k] * cold;
            }
        }
        if self.crosstalk != [0.0; 2] {
            let [of_before, of_after] = self.crosstalk;
            let mut before = 0.0;
            for k in 0..readings.len() {
                let own = readings[k];
                let after = readings.get(k + 1).copied().unwrap_or(0.0);
                readings[k] = own + of_before * before + of_after * after;
                before = own;
            }
        }
        self.permute(readings);
    }

    /// Takes back what [`apply`](Self::apply) does, where no zero is left of switching on.
    fn undo(&self, temperature: f64, readings: &mut [f64]) {
        let read = readings.to_vec();
        for (k, from) in self.order.iter().enumerate() {
            readings[*from] = read[k];
        }
        if self.crosstalk != [0.0; 2] {
            // Elimination in a tridiagonal matrix whose diagonal outweighs the rest.
            let [of_before, of_after] = self.crosstalk;
            let mut above = vec![0.0; readings.len()];
            let (mut last, mut slope) = (0.0, 0.0);
            for (r, a) in readings.iter_mut().zip(&mut above) {
                let pivot = 1.0 - of_before * slope;
                *r = (*r - of_before * last) / pivot;
                slope = of_after / pivot;
                (last, *a) = (*r, slope);
            }
            for k in (0..readings.len().saturating_sub(1)).rev() {
                readings[k] -= above[k] * readings[k + 1];
            }
        }
        let warm = temperature - NEUTRAL;
        for (k, r) in readings.iter_mut().enumerate() {
            let factor = self.gain[k] * (1.0 + self.thermal_span[k] * warm);
            let factor = if factor.abs() < 1e-9 { 1.0 } else { factor };
            let bent = *r - self.offset[k] - (self.thermal_zero[k] + self.thermal_bend[k] * warm) * warm;
            // The root that goes to the reading itself where there is no curvature; beyond the vertex there is none.
            let under = (1.0 + 4.0 * self.curvature[k] * bent / self.full[k]).max(0.0);
            *r = 2.0 * bent / (1.0 + under.sqrt()) / factor;
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
        self.around.apply(stimulus.temperature, 0.0, out);
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
            presses: 0.0,
            touched: false,
        })
    }

    fn displacement(&self, stimulus: &Stimulus, out: &mut [f64]) -> Result<bool, ModelError> {
        self.model.displacement(&self.around.real(stimulus, self.model.surface()), out)
    }

    /// As the rig states the force: [`response`](Self::response) takes its scale and zero into account.
    fn force_at(&self, at: &Point3<f64>, diameter: f64, depth: f64) -> Option<f64> {
        let (at, diameter) = self.around.real_tip(at, diameter, self.model.surface());
        let real = self.model.force_at(&at, diameter, depth)?;
        let stated = (real - self.around.force_zero) / self.around.force_scale;
        (stated >= 0.0).then_some(stated)
    }

    fn depth_at(&self, at: &Point3<f64>, diameter: f64, force: f64) -> Option<f64> {
        let (at, diameter) = self.around.real_tip(at, diameter, self.model.surface());
        let real = (force * self.around.force_scale + self.around.force_zero).max(0.0);
        self.model.depth_at(&at, diameter, real)
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
    /// Presses that have begun so far, and whether one is on.
    presses: f64,
    touched: bool,
}

impl Trajectory for Along {
    fn touch(&mut self, time: f64, stimulus: &mut Stimulus) {
        self.inner.touch(time, stimulus);
    }

    fn transduce(&mut self, time: f64, stimulus: &Stimulus, readings: &mut [f64]) {
        // The medium remembers what it felt, not what the electronics made of it.
        self.around.undo(stimulus.temperature, readings);
        self.inner.transduce(time, &self.around.real(stimulus, &self.surface), readings);
        let touched = !stimulus.contacts.is_empty();
        self.presses += f64::from(u8::from(touched && !self.touched));
        self.touched = touched;
        let cold = (-time / self.around.warming).exp();
        if self.around.ageing != [0.0; 2] || self.around.cold_span != 0.0 {
            let [rate, wear] = self.around.ageing;
            let left = (-rate * time - wear * self.presses).exp() * (1.0 + self.around.cold_span * cold);
            readings.iter_mut().for_each(|r| *r *= left);
        }
        self.around.apply(stimulus.temperature, cold, readings);
        let [amplitude, frequency, phase] = self.around.hum;
        if amplitude != 0.0 {
            let hum = amplitude * (TAU * frequency * time + phase).sin();
            readings.iter_mut().for_each(|r| *r += hum);
        }
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
                let felt = |c: &Indentation| c.force.norm() / (c.position - t).norm() * (c.diameter / 0.004);
                *o = stimulus.contacts.iter().map(felt).sum();
            }
            Ok(())
        }
        fn noise(&self) -> &[f64] {
            &[1.0, 1.0]
        }
        fn displacement(&self, stimulus: &Stimulus, out: &mut [f64]) -> Result<bool, ModelError> {
            for (o, point) in out.iter_mut().zip(&self.surface.points) {
                let sunk = |c: &Indentation| c.force.norm() / (1.0 + (c.position - point).norm());
                *o = stimulus.contacts.iter().map(sunk).sum();
            }
            Ok(true)
        }
        fn force_at(&self, at: &Point3<f64>, diameter: f64, depth: f64) -> Option<f64> {
            Some(depth * diameter * (1.0 + at.x))
        }
        fn depth_at(&self, at: &Point3<f64>, diameter: f64, force: f64) -> Option<f64> {
            Some(force / (diameter * (1.0 + at.x)))
        }
    }

    fn made(effects: Vec<Effect>) -> Result<Arc<dyn ForwardModel>, ModelError> {
        let mut skin = SkinDescription::from_toml(SKIN, "pad.toml").unwrap();
        skin.effects = effects;
        device(&skin, |inner| {
            assert!(inner.effects.iter().all(|e| e.name == "inner"));
            Ok(Arc::new(Plain {
                surface: inner.surface(),
                taxels: inner.taxels.iter().map(dermis_skin::Taxel::point).collect(),
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

    fn displaced(effects: Vec<Effect>, stimulus: &Stimulus) -> Vec<f64> {
        let model = made(effects).unwrap();
        let mut out = vec![0.0; model.surface().points.len()];
        assert!(model.displacement(stimulus, &mut out).unwrap());
        out
    }

    #[test]
    fn a_device_with_common_effects_has_a_displacement_map() {
        let plain = displaced(vec![], &press(0.003, 1.5));
        assert_eq!(displaced(vec![Effect::new("channel-offset").with("b", 3.0)], &press(0.003, 1.5)), plain);
        let rig =
            vec![Effect::new("truth-shift").with("x", 0.002), Effect::new("force-scale").with("factor", 1.5)];
        assert_eq!(displaced(rig, &press(0.001, 1.0)), plain);
    }

    #[test]
    fn forces_and_depths_are_those_that_the_rig_states() {
        let (at, tip) = (Point3::new(0.001, 0.0, 0.0), 0.004);
        let plain = made(vec![]).unwrap();
        let rig = made(vec![
            Effect::new("truth-shift").with("x", 0.002),
            Effect::new("tip-scale").with("factor", 1.25),
            Effect::new("force-scale").with("factor", 1.5),
            Effect::new("force-zero").with("force", 0.1),
        ])
        .unwrap();
        let depth = 100.0;
        let stated = rig.force_at(&at, tip, depth).unwrap();
        let real = plain.force_at(&Point3::new(0.003, 0.0, 0.0), tip * 1.25, depth).unwrap();
        approx::assert_relative_eq!(stated * 1.5 + 0.1, real, max_relative = 1e-12);
        approx::assert_relative_eq!(rig.depth_at(&at, tip, stated).unwrap(), depth, max_relative = 1e-12);
        // The cell says nothing yet, though the tip touches.
        assert_eq!(rig.force_at(&at, tip, 1.0), None);
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

    /// What every common effect is switched on by in a test.
    fn switched_on(info: &CommonEffect) -> Effect {
        let effect = Effect::new(info.name);
        match (info.name, info.parameters) {
            ("channel-gain", _) => effect.with("a", 1.3),
            ("channel-order", _) => effect.with("a", 1.0).with("b", 0.0),
            (_, CommonParameters::Channels | CommonParameters::ChannelsAnd(_)) => {
                effect.with("a", 0.02).with("b", -0.03)
            }
            (_, CommonParameters::Taxels) => effect.with("a.x", 1e-3).with("b.y", 2e-3),
            (_, CommonParameters::Named(named)) => named.iter().fold(effect, |effect, p| {
                let far = p.range[1];
                effect.with(p.name, if p.name == "frequency" { 13.0 } else { far })
            }),
        }
    }

    /// Readings of a warm skin that is pressed by more and more.
    fn along(effects: Vec<Effect>) -> Vec<f64> {
        let model = made(effects).unwrap();
        let mut way = model.trajectory();
        let mut all = Vec::new();
        for frame in 1..40 {
            let mut read = [0.0; 2];
            let t = 0.01 * f64::from(frame);
            let stimulus =
                Stimulus { temperature: 300.0, ..press(0.002, if frame > 10 { 3.0 * t } else { 0.0 }) };
            model.response(&stimulus, &mut read).unwrap();
            way.transduce(t, &stimulus, &mut read);
            all.extend(read);
        }
        all
    }

    #[test]
    fn every_effect_grows_from_nothing() {
        let plain = along(vec![]);
        let bits = |v: &[f64]| v.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
        for info in COMMON {
            assert!(!info.what.is_empty() && !info.source.is_empty(), "{}", info.name);
            // Nothing is said, or nothing of it is switched on.
            assert_eq!(bits(&along(vec![Effect::new(info.name)])), bits(&plain), "{}", info.name);
            let on = switched_on(info);
            assert_eq!(bits(&along(vec![on.clone().strength(0.0)])), bits(&plain), "{}", info.name);
            let mut last = 0.0;
            for strength in [0.25, 0.5, 1.0] {
                let read = along(vec![on.clone().strength(strength)]);
                let off: f64 = read.iter().zip(&plain).map(|(a, b)| (a - b).powi(2)).sum();
                let grows = off > last || info.name == "channel-order" && off > 0.0;
                assert!(grows, "{} at {strength}: {off} after {last}", info.name);
                last = off;
            }
        }
    }

    #[test]
    fn every_effect_remembers_what_it_should() {
        for info in COMMON {
            let model = made(vec![switched_on(info)]).unwrap();
            let mut still = [0.0; 2];
            let after = along(vec![switched_on(info)]);
            // The same stimulus as the last of that way.
            let stimulus = Stimulus { temperature: 300.0, ..press(0.002, 3.0 * 0.01 * 39.0) };
            model.response(&stimulus, &mut still).unwrap();
            let apart =
                after[after.len() - 2..].iter().zip(still).any(|(a, b)| (a - b).abs() > 1e-9 * b.abs());
            assert_eq!(apart, info.stateful, "{}", info.name);
        }
    }

    #[test]
    fn every_named_parameter_has_a_sense_and_survives_a_file() {
        for info in COMMON {
            for p in info.named() {
                let nested =
                    p.limits[0] <= p.range[0] && p.range[0] <= p.range[1] && p.range[1] <= p.limits[1];
                let inside = (p.limits[0]..=p.limits[1]).contains(&p.typical);
                assert!(nested && inside && !p.what.is_empty(), "{}.{}", info.name, p.name);
                assert_eq!(info.unit_of(p.name), p.unit);
            }
            let mut skin = SkinDescription::from_toml(SKIN, "pad.toml").unwrap();
            skin.effects = vec![switched_on(info)];
            let text = toml::to_string(&skin).unwrap();
            assert_eq!(SkinDescription::from_toml(&text, "written").unwrap().effects, skin.effects);
        }
    }

    #[test]
    fn neighbours_on_the_bus_read_each_other() {
        let plain = read(vec![], &press(0.001, 1.0));
        let coupled = read(vec![Effect::new("crosstalk").with("before", 0.2)], &press(0.001, 1.0));
        assert_eq!(coupled[0], plain[0]);
        approx::assert_relative_eq!(coupled[1], plain[1] + 0.2 * plain[0], max_relative = 1e-12);
        // What the medium remembers is what it felt.
        let taxel = |i| format!("{{ name = \"t{i}\", position = [0.00{i}, 0.0, -0.005] }}");
        let taxels: Vec<String> = (0..7).map(taxel).collect();
        let line = SKIN.lines().find(|l| l.starts_with("taxels")).unwrap();
        let text = SKIN.replace(line, &format!("taxels = [{}]", taxels.join(", ")));
        let skin = SkinDescription::from_toml(&text, "pad.toml").unwrap();
        let mut around = Around::neutral(&skin);
        around.crosstalk = [0.3, -0.2];
        around.gain = vec![1.5; 7];
        around.curvature = vec![0.1; 7];
        around.thermal_bend = vec![1e-3; 7];
        let felt = [1.0, -2.0, 3.0, 0.5, 0.0, 4.0, -1.0];
        let mut through = felt;
        around.apply(303.15, 0.0, &mut through);
        around.undo(303.15, &mut through);
        for (a, b) in through.iter().zip(felt) {
            approx::assert_relative_eq!(*a, b, epsilon = 1e-12);
        }
    }

    #[test]
    fn what_is_not_straight_does_not_turn_back() {
        let skin = SkinDescription::from_toml(SKIN, "pad.toml").unwrap();
        for curvature in [-3.0, -0.4, 0.4, 3.0] {
            let mut around = Around::neutral(&skin);
            around.curvature = vec![curvature; 2];
            let full = around.full[0];
            let read = |share: f64| {
                let mut readings = [share * full; 2];
                around.apply(NEUTRAL, 0.0, &mut readings);
                readings[0] / full
            };
            approx::assert_relative_eq!(read(0.1), 0.1 + 0.01 * curvature, max_relative = 1e-12);
            let all: Vec<f64> = (-20..=20).map(|i| read(0.1 * f64::from(i))).collect();
            assert!(all.windows(2).all(|w| w[1] >= w[0]), "{curvature}: {all:?}");
        }
    }

    #[test]
    fn time_since_power_on_matters_to_what_warms_and_what_wears() {
        let at = |effect: Effect, time: f64, force: f64| {
            let model = made(vec![effect]).unwrap();
            let (stimulus, mut out) = (press(0.001, force), [0.0; 2]);
            model.response(&stimulus, &mut out).unwrap();
            model.trajectory().transduce(time, &stimulus, &mut out);
            out
        };
        let cold = || Effect::new("warm-up").with("a", 5.0).with("time", 100.0);
        approx::assert_relative_eq!(at(cold(), 100.0, 0.0)[0], 5.0 / 1.0f64.exp(), max_relative = 1e-12);
        assert_eq!(at(cold(), 100.0, 0.0)[1], 0.0);
        let plain = read(vec![], &press(0.001, 2.0));
        let worn = at(Effect::new("ageing").with("rate", 1e-3), 500.0, 2.0);
        approx::assert_relative_eq!(worn[0], plain[0] * (-0.5f64).exp(), max_relative = 1e-12);
        let pressed = at(Effect::new("ageing").with("wear", 0.1), 500.0, 2.0);
        approx::assert_relative_eq!(pressed[0], plain[0] * (-0.1f64).exp(), max_relative = 1e-12);
        let warm = at(Effect::new("warm-up").with("span", 0.2).with("time", 100.0), 100.0, 2.0);
        approx::assert_relative_eq!(warm[0], plain[0] * (1.0 + 0.2 / 1.0f64.exp()), max_relative = 1e-12);
        let hum = Effect::new("interference").with("amplitude", 3.0).with("frequency", 10.0);
        approx::assert_relative_eq!(at(hum, 0.025, 2.0)[1], plain[1] + 3.0, max_relative = 1e-12);
    }

    #[test]
    fn refusals_name_the_parameter() {
        let refused = |effect| made(vec![effect]).err().unwrap().to_string();
        insta::assert_snapshot!(refused(Effect::new("channel-gain").with("c", 1.0)), @"skin `pad`: field `effects[0].c`: is no channel of this skin; it has a, b");
        insta::assert_snapshot!(refused(Effect::new("channel-gain").with("a", 0.0)), @"skin `pad`: field `effects[0].a`: is 0 and must not be 0: mask a dead channel");
        insta::assert_snapshot!(refused(Effect::new("delay").with("time", -1.0)), @"skin `pad`: field `effects[0].time`: is -1 s and must be 0 or positive");
        insta::assert_snapshot!(refused(Effect::new("truth-shift").with("w", 1.0)), @"skin `pad`: field `effects[0].w`: is no parameter of truth-shift; it has x, y, z, turn");
        insta::assert_snapshot!(refused(Effect::new("taxel-position").with("a", 1.0)), @r#"skin `pad`: field `effects[0].a`: names a taxel and an axis, e.g. "t0.x""#);
        insta::assert_snapshot!(refused(Effect::new("crosstalk").with("before", 0.7)), @"skin `pad`: field `effects[0].before`: is 0.7 and must be -0.49 to 0.49");
        insta::assert_snapshot!(refused(Effect::new("crosstalk").with("after", 0.3).strength(2.0)), @"skin `pad`: field `effects[0].after`: is 0.6 at this strength and must stay below 0.5");
        insta::assert_snapshot!(refused(Effect::new("warm-up").with("time", 0.0)), @"skin `pad`: field `effects[0].time`: is 0 s and must be 1 to 100000");
        insta::assert_snapshot!(refused(Effect::new("channel-order").with("a", 7.0)), @"skin `pad`: field `effects[0].a`: is 7 and must be a place from 0 to 1");
    }
}
