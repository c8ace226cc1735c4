//! Interference of one frequency on all channels: `reading + a · sin(2π f t + φ)`.

use std::f64::consts::TAU;

use dermis_skin::ParameterInfo;

use super::diagnosis::{Diagnosis, Evidence};
use super::{Act, Circumstances, CommonEffect, CommonParameters, Refused, Settings, Stage, StatefulAct};

pub(super) const EFFECT: CommonEffect = CommonEffect {
    name: "interference",
    what: "The mains, or a motor, couples interference of one frequency into all channels; above half of the frame rate it is aliased.",
    source: "Ott, Electromagnetic Compatibility Engineering, ch. 2; mains at 50 or 60 Hz",
    parameters: CommonParameters::Named(&[
        ParameterInfo::new(
            "amplitude",
            "",
            "half of the interference from peak to peak",
            0.0,
            [0.0, 100.0],
            [0.0, 1e9],
        ),
        ParameterInfo::new("frequency", "Hz", "of the interference", 50.0, [1.0, 400.0], [0.0, 1e6]),
        ParameterInfo::new(
            "phase",
            "rad",
            "of the interference when the device is switched on",
            0.0,
            [0.0, 6.3],
            [-1e3, 1e3],
        ),
    ]),
    unit: "",
    stateful: true,
    rig: false,
    stage: Stage::Electronics,
    diagnosis: Diagnosis {
        evidence: Evidence::Spectrum { amplitude: "amplitude", frequency: "frequency" },
        ..Diagnosis::FAMILY
    },
    acts,
};

fn acts(settings: &Settings<'_>) -> Result<Vec<Act>, Refused> {
    let amplitude = settings.scaled("amplitude");
    if amplitude == 0.0 {
        return Ok(Vec::new());
    }
    let (frequency, phase) = (settings.value("frequency"), settings.value("phase"));
    Ok(vec![Act::remembers(Stage::Electronics, Interference { amplitude, frequency, phase })])
}

#[derive(Clone)]
struct Interference {
    amplitude: f64,
    frequency: f64,
    phase: f64,
}

impl StatefulAct for Interference {
    fn apply(&mut self, now: &Circumstances, readings: &mut [f64]) {
        let added = self.amplitude * (TAU * self.frequency * now.time + self.phase).sin();
        readings.iter_mut().for_each(|r| *r += added);
    }
}
