//! Self-heating after switching on: zero and sensitivity are off by `exp(-t / time)` of what they are off by at first.

use dermis_skin::ParameterInfo;

use super::diagnosis::{Diagnosis, FreeNumber, Signature};
use super::{Act, Circumstances, CommonEffect, CommonParameters, Refused, Settings, Stage, StatefulAct};

pub(super) const EFFECT: CommonEffect = CommonEffect {
    name: "warm-up",
    what: "The zero of channels, and the sensitivity of all, are off when the device is switched on, and go home as it warms itself.",
    source: "first-order heating of a body by its own power, exp(-t / time), through its coefficients of zero and span",
    parameters: CommonParameters::ChannelsAnd(&[
        ParameterInfo::new("time", "s", "after which 37 % of it is left", 300.0, [30.0, 1800.0], [1.0, 1e5]),
        ParameterInfo::new(
            "span",
            "1",
            "by which the sensitivity is too large at first",
            0.0,
            [-0.3, 0.3],
            [-0.95, 10.0],
        ),
    ]),
    unit: "",
    stateful: true,
    rig: false,
    stage: Stage::Transducer,
    diagnosis: Diagnosis {
        depends_on_uptime: true,
        signature: Signature::DecayFromPowerOn { time: "time", share: ("span", -0.9) },
        free: &[
            FreeNumber::new(Some("time"), [1.0, 1e5], 300.0, 300.0),
            FreeNumber::new(Some("span"), [-0.9, 9.0], 0.1, 0.0),
        ],
        ..Diagnosis::FAMILY
    },
    acts,
};

fn acts(settings: &Settings<'_>) -> Result<Vec<Act>, Refused> {
    let (time, span) = (settings.value("time"), settings.scaled("span"));
    let mut acts = Vec::new();
    if span != 0.0 {
        acts.push(Act::remembers(Stage::Transducer, ColdSpan { span, time }));
    }
    if let Some(zero) = settings.scaled_channels()? {
        acts.push(Act::remembers(Stage::Electronics, ColdZero { zero, time }));
    }
    Ok(acts)
}

/// Share of the sensitivity that is too much when the device is switched on.
#[derive(Clone)]
struct ColdSpan {
    span: f64,
    time: f64,
}

impl StatefulAct for ColdSpan {
    fn apply(&mut self, now: &Circumstances, readings: &mut [f64]) {
        let factor = 1.0 + self.span * (-now.time / self.time).exp();
        readings.iter_mut().for_each(|r| *r *= factor);
    }
}

/// Zero of every channel when the device is switched on.
#[derive(Clone)]
struct ColdZero {
    zero: Vec<f64>,
    time: f64,
}

impl StatefulAct for ColdZero {
    fn apply(&mut self, now: &Circumstances, readings: &mut [f64]) {
        let cold = (-now.time / self.time).exp();
        readings.iter_mut().zip(&self.zero).for_each(|(r, zero)| *r += zero * cold);
    }
}
