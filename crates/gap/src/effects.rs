//! What the stages of a diagnosis ask of an effect.
//!
//! No stage asks for an effect by its name. The file of a common effect declares its properties
//! ([`Diagnosis`](dermis_model::diagnosis::Diagnosis)): how the signature is made, what else than a residual gives evidence of it, what
//! it follows, and which numbers of it can be fitted. Every other effect is one of a sensor family, and has the neutral properties of
//! [`Diagnosis::FAMILY`]. Whether an effect belongs to the rig or remembers is said by [`CommonEffect`] and
//! [`EffectInfo`](dermis_skin::EffectInfo).

use dermis_model::diagnosis::{Amount, Diagnosis};
use dermis_model::{COMMON, CommonEffect, common_effect};
use dermis_skin::Effect;

use crate::algebra::mean;
use crate::nonlinear_refinement::Free;

/// Properties of the effect `name`.
pub(crate) fn of(name: &str) -> &'static Diagnosis {
    common_effect(name).map_or(&Diagnosis::FAMILY, |info| &info.diagnosis)
}

/// The common effects that have a property.
pub(crate) fn with(property: impl Fn(&Diagnosis) -> bool) -> impl Iterator<Item = &'static CommonEffect> {
    COMMON.iter().filter(move |info| property(&info.diagnosis))
}

/// The value for a coefficient of a column that stands for `amount`, within what a device can have.
pub(crate) fn value(of: &Diagnosis, coefficient: f64, amount: f64) -> f64 {
    let value = coefficient * amount + of.neutral;
    let value = match of.limits {
        Some([low, high]) => value.max(low).min(high),
        None => value,
    };
    if value.abs() < of.least { of.least } else { value }
}

/// How much of a parameter that is, in its unit: `period` is the time between frames, `noise` the deviation of each channel's.
pub(crate) fn amount(of: Amount, period: f64, noise: &[f64]) -> f64 {
    match of {
        Amount::Si(amount) => amount,
        Amount::Frames(count) => count * period,
        Amount::Deviations(count) => count * mean(noise),
    }
}

/// Numbers of `effect` that can be fitted; `period` is the time between frames.
pub(crate) fn free_numbers(effect: &Effect, period: f64) -> Vec<Free> {
    let free = of(&effect.name).free;
    let number = |parameter: &String| {
        let found = free.iter().find(|f| f.parameter.is_none_or(|p| p == parameter))?;
        let unit = if found.frames { period } else { 1.0 };
        Some(Free {
            effect: effect.name.clone(),
            parameter: parameter.clone(),
            limits: found.limits.map(|l| l * unit),
            scale: found.scale * unit,
            typical: found.typical,
            neutral: found.typical,
        })
    };
    effect.parameters.keys().filter_map(number).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn written_values_are_ones_that_a_device_can_have() {
        let value = |name: &str, coefficient, amount| value(of(name), coefficient, amount);
        assert_eq!(value("channel-gain", -1.0, 1.0), 1e-3);
        assert_eq!(value("channel-gain", 2.0, 0.05), 1.1);
        assert_eq!(value("delay", -3.0, 0.02), 0.0);
        assert_eq!(value("crosstalk", 100.0, 0.05), 0.49);
        assert_eq!(value("tip-scale", -100.0, 0.1), 0.05);
        assert_eq!(value("an effect of a family", 2.0, 3.0), 6.0);
    }

    #[test]
    fn lags_are_fitted_in_frames() {
        let effect = Effect::new("delay").with("time", 0.1);
        let free = free_numbers(&effect, 0.02);
        assert_eq!((free[0].limits, free[0].scale), ([0.0, 2.0], 0.08));
        let turn = Effect::new("truth-shift").with("turn", 0.1).with("x", 1e-3);
        let free = free_numbers(&turn, 0.02);
        assert_eq!(free.iter().map(|f| f.limits[1]).collect::<Vec<_>>(), [0.5, 0.02]);
        assert!(free_numbers(&Effect::new("channel-gain").with("a", 1.1), 0.02).is_empty());
    }
}
