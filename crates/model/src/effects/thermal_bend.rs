//! Zero of channels, square in the temperature: `reading + c · ΔT²`.

use super::diagnosis::{Amount, Covariate, Diagnosis};
use super::{Act, CommonEffect, CommonParameters, ReadingAct, Refused, Settings, Stage};

pub(super) const EFFECT: CommonEffect = CommonEffect {
    name: "thermal-bend",
    what: "The zero of channels follows the square of the temperature; neutral at 20 °C.",
    source: "apparent strain of foils, as their data sheets give it: a polynomial of the temperature",
    parameters: CommonParameters::Channels,
    unit: "",
    stateful: false,
    rig: false,
    stage: Stage::Electronics,
    diagnosis: Diagnosis {
        addition_to: Some("thermal-zero"),
        follows: Some(Covariate::Temperature),
        ..Diagnosis::of_channels(Amount::Deviations(0.1), |sample| sample.warmer.powi(2))
    },
    acts,
};

fn acts(settings: &Settings<'_>) -> Result<Vec<Act>, Refused> {
    let coefficients = settings.scaled_channels()?;
    Ok(coefficients.map(|c| Act::reading(Stage::Electronics, ThermalBend(c))).into_iter().collect())
}

struct ThermalBend(Vec<f64>);

impl ReadingAct for ThermalBend {
    fn apply(&self, warmer: f64, readings: &mut [f64]) {
        readings.iter_mut().zip(&self.0).for_each(|(r, coefficient)| *r += coefficient * warmer * warmer);
    }
}
