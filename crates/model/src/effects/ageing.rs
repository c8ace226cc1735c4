//! Loss of sensitivity with time and use: `reading · exp(-rate · t - wear · presses)`.

use dermis_skin::ParameterInfo;

use super::diagnosis::{Diagnosis, FreeNumber, Share, Signature};
use super::{Act, Circumstances, CommonEffect, CommonParameters, Refused, Settings, Stage, StatefulAct};

pub(super) const EFFECT: CommonEffect = CommonEffect {
    name: "ageing",
    what: "The sensitivity of all channels wanes, or grows, with the time that the device is on and with every press.",
    source: "first-order loss of sensitivity, exp(-rate · t - wear · n): ageing goes with time, wear with cycles of load",
    parameters: CommonParameters::Named(&[
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
    unit: "1",
    stateful: true,
    rig: false,
    stage: Stage::Transducer,
    diagnosis: Diagnosis {
        depends_on_uptime: true,
        free: &[FreeNumber::new(None, [-0.1, 0.1], 1e-4, 0.0)],
        signature: Signature::Shares(&[
            Share { parameter: "rate", slope: |sample| -sample.uptime, largest: 0.1 },
            Share { parameter: "wear", slope: |sample| -sample.presses, largest: 0.1 },
        ]),
        ..Diagnosis::FAMILY
    },
    acts,
};

fn acts(settings: &Settings<'_>) -> Result<Vec<Act>, Refused> {
    let (rate, wear) = (settings.scaled("rate"), settings.scaled("wear"));
    if (rate, wear) == (0.0, 0.0) {
        return Ok(Vec::new());
    }
    Ok(vec![Act::remembers(Stage::Transducer, Ageing { rate, wear, presses: 0.0, touched: false })])
}

#[derive(Clone)]
struct Ageing {
    rate: f64,
    wear: f64,
    /// That have begun so far, and whether one is on.
    presses: f64,
    touched: bool,
}

impl StatefulAct for Ageing {
    fn apply(&mut self, now: &Circumstances, readings: &mut [f64]) {
        self.presses += f64::from(u8::from(now.touched && !self.touched));
        self.touched = now.touched;
        let left = (-self.rate * now.time - self.wear * self.presses).exp();
        readings.iter_mut().for_each(|r| *r *= left);
    }
}
