//! What is known of values before any reading is seen.
//!
//! The prior of a value is Cauchy's law about the middle of what devices have, with half of its mass within that: weakly informative
//! (Gelman, Jakulin, Pittau and Su 2008), so that a device that is far off is found, and one that cannot be costs. What devices have is
//! the range of a parameter in its effect's table, or the tolerance of a number of the description. A value that these presses do
//! not show well is judged by the nearest end of its interval.

use dermis_model::common_effect;

use super::data::Data;
use crate::constants::signatures::TOLERANCE;
use crate::design;
use crate::report::Value;

/// Says of each value of an effect how plausible it is: the probability of one as far off or farther.
pub(super) fn score(data: &Data<'_>, effect: &str, values: &mut [Value]) {
    for value in values {
        let away = prior(data, effect, value).zip(value.interval).map(|((middle, half), [low, high])| {
            let nearest = middle.clamp(low.min(high), high.max(low));
            (nearest - middle).abs() / half
        });
        value.plausibility = away.map(|away| 1.0 - std::f64::consts::FRAC_2_PI * away.atan());
    }
}

/// Twice the negative logarithm of the prior of the least plausible value, beside that of the middle.
pub(super) fn cost(values: &[Value]) -> f64 {
    let away = |p: f64| (std::f64::consts::FRAC_PI_2 * (1.0 - p)).tan();
    let costs = values.iter().filter_map(|v| v.plausibility).map(|p| 2.0 * away(p).powi(2).ln_1p());
    costs.fold(0.0, f64::max)
}

/// Middle and half width of what devices have.
fn prior(data: &Data<'_>, effect: &str, value: &Value) -> Option<(f64, f64)> {
    if let Some(nominal) = design::value(data.simulator.skin, &value.name) {
        return Some((nominal, TOLERANCE * nominal.abs()));
    }
    let family = data.simulator.effects.iter().find(|i| i.name == effect).map(|i| i.parameters);
    let known = family.or_else(|| common_effect(effect).map(dermis_model::CommonEffect::named))?;
    let [low, high] = known.iter().find(|p| p.name == value.name)?.range;
    (low.is_finite() && high > low).then_some((0.5 * (low + high), 0.5 * (high - low)))
}

#[cfg(test)]
mod tests {
    use super::super::testing::{Case, with_simulator};
    use super::*;

    #[test]
    fn a_value_is_as_plausible_as_its_prior_makes_it() {
        with_simulator(|simulator| {
            let case = Case::of(simulator, &[]);
            let data = case.data(simulator);
            let of = |effect: &str, name: &str, value: f64, half: f64| {
                let interval = Some([value - half, value + half]);
                let value =
                    Value { name: name.to_owned(), value, unit: String::new(), interval, plausibility: None };
                let mut values = [value];
                score(&data, effect, &mut values);
                (values[0].plausibility, cost(&values))
            };
            // The bend of devices is 0.1 to 0.4 per newton.
            let (p, cost) = of("stiffening", "bend", 0.4, 0.0);
            assert!(
                (p.unwrap() - 0.5).abs() < 1e-9 && (cost - 2.0 * 2.0f64.ln()).abs() < 1e-9,
                "{p:?} {cost}"
            );
            let (p, cost) = of("stiffening", "bend", 4.0, 0.01);
            assert!(p.unwrap() < 0.05 && cost > 10.0);
            // What is not seen well is not held against it.
            assert_eq!(of("stiffening", "bend", 4.0, 4.0), (Some(1.0), 0.0));
            // A number of the description has its tolerance, and a channel's gain no prior.
            assert!(of("medium.spread", "medium.spread", 1.04, 0.0).0.unwrap() > 0.5);
            assert!(of("medium.spread", "medium.spread", 3.0, 0.0).0.unwrap() < 0.05);
            assert_eq!(of("channel-gain", "a", 9.0, 0.0), (None, 0.0));
        });
    }
}
