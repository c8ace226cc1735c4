//! Sensitivity error of channels: `reading · gain`.

use super::diagnosis::{Amount, Diagnosis};
use super::{Act, CommonEffect, CommonParameters, ReadingAct, Refused, Settings, Stage};

pub(super) const EFFECT: CommonEffect = CommonEffect {
    name: "channel-gain",
    what: "Channels read too much or too little, each by a factor of its own.",
    source: "sensitivity error of a transducer, IEC 60050-311",
    parameters: CommonParameters::Channels,
    unit: "1",
    stateful: false,
    rig: false,
    stage: Stage::Transducer,
    diagnosis: Diagnosis {
        neutral: 1.0,
        least: 1e-3,
        describes_channels: true,
        // In a tared recording it scales signals: the zero was read with the same factor.
        ..Diagnosis::of_channels(Amount::Si(0.05), |sample| sample.reading)
    },
    acts,
};

/// A gain that is as good as none.
const DEAD: f64 = 1e-6;

fn acts(settings: &Settings<'_>) -> Result<Vec<Act>, Refused> {
    let gains = settings.channels(1.0, |value| {
        let gain = 1.0 + settings.strength() * (value - 1.0);
        if gain.abs() < DEAD {
            return Err(format!("is {value} and must not be 0: mask a dead channel"));
        }
        Ok(gain)
    })?;
    Ok(gains.map(|g| Act::reading(Stage::Transducer, Gain(g))).into_iter().collect())
}

struct Gain(Vec<f64>);

impl ReadingAct for Gain {
    fn apply(&self, _: f64, readings: &mut [f64]) {
        readings.iter_mut().zip(&self.0).for_each(|(r, gain)| *r *= gain);
    }
}
