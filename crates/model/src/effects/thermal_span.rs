//! Sensitivity of channels, linear in the temperature: `reading · (1 + c · ΔT)`.

use super::diagnosis::{Amount, Covariate, Diagnosis};
use super::{Act, CommonEffect, CommonParameters, ReadingAct, Refused, Settings, Stage};

pub(super) const EFFECT: CommonEffect = CommonEffect {
    name: "thermal-span",
    what: "The gain of channels follows the temperature; neutral at 20 °C.",
    source: "temperature coefficient of span, as data sheets of transducers give it",
    parameters: CommonParameters::Channels,
    unit: "1/K",
    stateful: false,
    rig: false,
    stage: Stage::Transducer,
    diagnosis: Diagnosis {
        follows: Some(Covariate::Temperature),
        ..Diagnosis::of_channels(Amount::Si(0.01), |sample| sample.warmer * sample.reading)
    },
    acts,
};

fn acts(settings: &Settings<'_>) -> Result<Vec<Act>, Refused> {
    let coefficients = settings.scaled_channels()?;
    Ok(coefficients.map(|c| Act::reading(Stage::Transducer, ThermalSpan(c))).into_iter().collect())
}

struct ThermalSpan(Vec<f64>);

impl ReadingAct for ThermalSpan {
    fn apply(&self, warmer: f64, readings: &mut [f64]) {
        readings.iter_mut().zip(&self.0).for_each(|(r, per_kelvin)| *r *= 1.0 + per_kelvin * warmer);
    }
}
