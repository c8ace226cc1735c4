//! Zero of channels, linear in the temperature: `reading + c · ΔT`.

use super::diagnosis::{Amount, Covariate, Diagnosis};
use super::{Act, CommonEffect, CommonParameters, ReadingAct, Refused, Settings, Stage};

pub(super) const EFFECT: CommonEffect = CommonEffect {
    name: "thermal-zero",
    what: "The zero of channels follows the temperature; neutral at 20 °C.",
    source: "temperature coefficient of offset, as data sheets of transducers give it",
    parameters: CommonParameters::Channels,
    unit: "",
    stateful: false,
    rig: false,
    stage: Stage::Electronics,
    diagnosis: Diagnosis {
        follows: Some(Covariate::Temperature),
        ..Diagnosis::of_channels(Amount::Deviations(1.0), |sample| sample.warmer)
    },
    acts,
};

fn acts(settings: &Settings<'_>) -> Result<Vec<Act>, Refused> {
    let coefficients = settings.scaled_channels()?;
    Ok(coefficients.map(|c| Act::reading(Stage::Electronics, ThermalZero(c))).into_iter().collect())
}

struct ThermalZero(Vec<f64>);

impl ReadingAct for ThermalZero {
    fn apply(&self, warmer: f64, readings: &mut [f64]) {
        readings.iter_mut().zip(&self.0).for_each(|(r, per_kelvin)| *r += per_kelvin * warmer);
    }
}
