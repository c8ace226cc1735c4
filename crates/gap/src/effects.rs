//! What the stages of a diagnosis must know of an effect, declared once per effect.
//!
//! No stage asks for an effect by its name. It asks this table which effects have a property: how the signature is made, what else
//! than a residual gives evidence of it, what it follows, and which numbers of it can be fitted. An effect that is not in the
//! table is one of a sensor family: its signature comes from simulations at the ends of its parameters' ranges, and it has the
//! neutral properties of [`FAMILY`]. Whether an effect belongs to the rig or remembers is said by
//! [`CommonEffect`](dermis_model::CommonEffect) and [`EffectInfo`](dermis_skin::EffectInfo).

use dermis_model::CURVED;
use dermis_skin::Effect;

use crate::constants::signatures::{SHIFT, TURN};
use crate::nonlinear_refinement::Free;
use crate::signatures::common::{self, Context, Parts};

/// How the columns of an effect's signature are made.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Signature {
    /// By a formula over the readings of the nominal model.
    Formula(fn(&Context<'_>) -> Parts),
    /// By simulating it at these amounts, and central differences where both signs are there.
    Simulated(&'static [Variation]),
    /// It has none: something else than the size of a residual gives evidence of it, or another effect's signature holds it.
    None,
}

/// One amount that an effect is simulated at.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Variation {
    pub parameter: &'static str,
    pub amount: Amount,
    pub needs: Needs,
}

/// How much of a parameter, beyond its neutral value.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Amount {
    /// In the unit of the parameter.
    Si(f64),
    /// In times between frames.
    Frames(f64),
}

/// What a recording must have for a variation to change anything.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Needs {
    Nothing,
    SeveralChannels,
    /// Contacts outside of the plane z = 0.
    CurvedSurface,
}

/// What gives evidence of an effect.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Evidence {
    /// The residual shrinks where it is switched on.
    Residual,
    /// A line in the spectrum of untouched frames; names of the parameters that are its amplitude and its frequency.
    Spectrum { amplitude: &'static str, frequency: &'static str },
    /// Readings of channels agree with the model of others.
    ChannelOrder,
}

/// What an effect follows, so that anything else that does may be taken for it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Covariate {
    Temperature,
}

/// How coefficients of columns become values of parameters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Coefficients {
    /// In proportion.
    Proportional,
    /// Columns are components of exponential decays from power-on: the values at power-on and one time constant are fitted to them.
    DecayFromPowerOn {
        /// Parameter that is the time constant.
        time: &'static str,
        /// Parameter that is a share of all readings, and the least value of it.
        share: (&'static str, f64),
    },
}

/// A parameter that is fitted on the full simulator.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FreeNumber {
    /// Its name; any where absent.
    pub parameter: Option<&'static str>,
    /// Values that can be.
    pub limits: [f64; 2],
    /// What is a large change of it.
    pub scale: f64,
    /// Value where nothing says another.
    pub typical: f64,
    /// Whether limits and scale are in times between frames.
    pub frames: bool,
}

/// What stages know of an effect.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Properties {
    pub name: &'static str,
    pub signature: Signature,
    pub evidence: Evidence,
    /// Whether each channel has parameters of its own.
    pub per_channel: bool,
    /// Value of its parameters at which it changes nothing.
    pub neutral: f64,
    /// Values that a linear fit may write; unlimited where absent.
    pub limits: Option<[f64; 2]>,
    /// Least size of a value: a smaller one would switch a channel off.
    pub least: f64,
    /// Whether its readings are not in proportion to its values: where it is large, its columns leave what looks like other effects.
    pub nonlinear: bool,
    /// Whether it follows the time since power-on or the number of presses: repeats do not show it.
    pub depends_on_uptime: bool,
    pub follows: Option<Covariate>,
    /// Whether what another effect does to a channel may be written in its parameters.
    pub describes_channels: bool,
    /// Whether its parameters shift the readings of each channel by a constant.
    pub shifts_channels: bool,
    /// Parameter whose tolerance is a part of the model discrepancy, and what it is called there.
    pub tolerance: Option<(&'static str, &'static str)>,
    pub coefficients: Coefficients,
    pub free: &'static [FreeNumber],
}

/// Properties of an effect that the table does not list.
pub(crate) const FAMILY: Properties = Properties {
    name: "",
    signature: Signature::None,
    evidence: Evidence::Residual,
    per_channel: false,
    neutral: 0.0,
    limits: None,
    least: 0.0,
    nonlinear: false,
    depends_on_uptime: false,
    follows: None,
    describes_channels: false,
    shifts_channels: false,
    tolerance: None,
    coefficients: Coefficients::Proportional,
    free: &[],
};

const fn channels(name: &'static str, formula: fn(&Context<'_>) -> Parts) -> Properties {
    Properties { name, signature: Signature::Formula(formula), per_channel: true, ..FAMILY }
}

const fn simulated(
    name: &'static str,
    variations: &'static [Variation],
    free: &'static [FreeNumber],
) -> Properties {
    Properties { name, signature: Signature::Simulated(variations), free, ..FAMILY }
}

const fn by(parameter: &'static str, amount: f64) -> Variation {
    Variation { parameter, amount: Amount::Si(amount), needs: Needs::Nothing }
}

const fn frames(parameter: &'static str, count: f64) -> Variation {
    Variation { parameter, amount: Amount::Frames(count), needs: Needs::Nothing }
}

const fn needing(needs: Needs, variation: Variation) -> Variation {
    Variation { needs, ..variation }
}

const fn free(parameter: Option<&'static str>, limits: [f64; 2], scale: f64, typical: f64) -> FreeNumber {
    FreeNumber { parameter, limits, scale, typical, frames: false }
}

/// A delay or a time constant: up to a hundred frames.
const LAG: &[FreeNumber] =
    &[FreeNumber { parameter: None, limits: [0.0, 100.0], scale: 4.0, typical: 0.0, frames: true }];
/// Values of a lag: what comes early cannot be simulated forwards.
const FORWARDS: Option<[f64; 2]> = Some([0.0, f64::INFINITY]);
/// Crosstalk beyond a half would be another channel's reading.
const HALF: f64 = 0.49;
/// Factors of force and tip: neither vanishes.
const FACTOR: Option<[f64; 2]> = Some([0.05, f64::INFINITY]);

/// The effects that every skin can have, in the order in which they are compared.
pub(crate) const TABLE: &[Properties] = &[
    Properties {
        describes_channels: true,
        shifts_channels: true,
        ..channels("channel-offset", common::offsets)
    },
    Properties {
        neutral: 1.0,
        least: 1e-3,
        describes_channels: true,
        ..channels("channel-gain", common::gains)
    },
    Properties { limits: Some([-CURVED, CURVED]), ..channels("channel-curvature", common::curvatures) },
    Properties { follows: Some(Covariate::Temperature), ..channels("thermal-zero", common::thermal_zeros) },
    // Its columns are among those of the zero's drift with temperature.
    Properties { name: "thermal-bend", follows: Some(Covariate::Temperature), per_channel: true, ..FAMILY },
    Properties { follows: Some(Covariate::Temperature), ..channels("thermal-span", common::thermal_spans) },
    Properties {
        per_channel: false,
        depends_on_uptime: true,
        free: &[free(None, [-0.1, 0.1], 1e-4, 0.0)],
        ..channels("ageing", common::ageing)
    },
    Properties {
        depends_on_uptime: true,
        coefficients: Coefficients::DecayFromPowerOn { time: "time", share: ("span", -0.9) },
        free: &[free(Some("time"), [1.0, 1e5], 300.0, 300.0), free(Some("span"), [-0.9, 9.0], 0.1, 0.0)],
        ..channels("warm-up", common::decays)
    },
    Properties {
        nonlinear: true,
        describes_channels: true,
        ..channels("taxel-position", common::taxel_positions)
    },
    Properties {
        limits: Some([-HALF, HALF]),
        ..simulated(
            "crosstalk",
            &[
                needing(Needs::SeveralChannels, by("before", 0.05)),
                needing(Needs::SeveralChannels, by("after", 0.05)),
            ],
            &[free(None, [-HALF, HALF], 0.1, 0.0)],
        )
    },
    Properties { limits: FORWARDS, ..simulated("delay", &[frames("time", 1.0), frames("time", 5.0)], LAG) },
    Properties {
        neutral: 1.0,
        limits: FACTOR,
        ..simulated(
            "force-scale",
            &[by("factor", 0.05), by("factor", -0.05)],
            &[free(None, [0.1, 10.0], 0.2, 1.0)],
        )
    },
    simulated(
        "force-zero",
        &[by("force", 0.005), by("force", -0.005)],
        &[free(None, [-2.0, 2.0], 0.05, 0.0)],
    ),
    Properties {
        limits: FORWARDS,
        ..simulated("low-pass", &[frames("time", 1.0), frames("time", 10.0)], LAG)
    },
    Properties {
        neutral: 1.0,
        limits: FACTOR,
        tolerance: Some(("factor", "diameter of the tip")),
        ..simulated(
            "tip-scale",
            &[by("factor", 0.1), by("factor", -0.1)],
            &[free(None, [0.1, 10.0], 0.2, 1.0)],
        )
    },
    simulated(
        "truth-shift",
        &[
            by("x", SHIFT),
            by("x", -SHIFT),
            by("y", SHIFT),
            by("y", -SHIFT),
            needing(Needs::CurvedSurface, by("z", SHIFT)),
            needing(Needs::CurvedSurface, by("z", -SHIFT)),
            by("turn", TURN),
            by("turn", -TURN),
        ],
        &[free(Some("turn"), [-0.5, 0.5], 0.05, 0.0), free(None, [-0.02, 0.02], 1e-3, 0.0)],
    ),
    Properties {
        name: "interference",
        evidence: Evidence::Spectrum { amplitude: "amplitude", frequency: "frequency" },
        ..FAMILY
    },
    Properties { name: "channel-order", evidence: Evidence::ChannelOrder, per_channel: true, ..FAMILY },
];

/// Properties of the effect `name`.
pub(crate) fn of(name: &str) -> &'static Properties {
    TABLE.iter().find(|p| p.name == name).unwrap_or(&FAMILY)
}

/// The effects that have a property, in the order of the table.
pub(crate) fn with(property: impl Fn(&Properties) -> bool) -> impl Iterator<Item = &'static Properties> {
    TABLE.iter().filter(move |p| property(p))
}

impl Properties {
    /// The value for a coefficient of a column that stands for `amount`, within what a device can have.
    pub(crate) fn value(&self, coefficient: f64, amount: f64) -> f64 {
        let value = coefficient * amount + self.neutral;
        let value = match self.limits {
            Some([low, high]) => value.max(low).min(high),
            None => value,
        };
        if value.abs() < self.least { self.least } else { value }
    }

    /// Numbers of `effect` that can be fitted; `period` is the time between frames.
    pub(crate) fn free_numbers(&self, effect: &Effect, period: f64) -> Vec<Free> {
        let of = |parameter: &String| {
            let found = self.free.iter().find(|f| f.parameter.is_none_or(|p| p == parameter))?;
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
        effect.parameters.keys().filter_map(of).collect()
    }
}

#[cfg(test)]
mod tests {
    use dermis_model::COMMON;

    use super::*;

    #[test]
    fn every_common_effect_stands_in_the_table_once() {
        let mut listed: Vec<&str> = TABLE.iter().map(|p| p.name).collect();
        let mut known: Vec<&str> = COMMON.iter().map(|c| c.name).collect();
        listed.sort_unstable();
        known.sort_unstable();
        assert_eq!(listed, known);
    }

    #[test]
    fn parameters_of_the_table_are_those_of_the_effects() {
        for properties in TABLE {
            let info = dermis_model::common_effect(properties.name).unwrap();
            let has = |name: &str| info.named().iter().any(|p| p.name == name);
            if let Signature::Simulated(variations) = properties.signature {
                assert!(variations.iter().all(|v| has(v.parameter)), "{}", properties.name);
            }
            if let Evidence::Spectrum { amplitude, frequency } = properties.evidence {
                assert!(has(amplitude) && has(frequency));
            }
            for free in properties.free.iter().filter_map(|f| f.parameter) {
                assert!(has(free), "{}.{free}", properties.name);
            }
        }
    }

    #[test]
    fn written_values_are_ones_that_a_device_can_have() {
        assert_eq!(of("channel-gain").value(-1.0, 1.0), 1e-3);
        assert_eq!(of("channel-gain").value(2.0, 0.05), 1.1);
        assert_eq!(of("delay").value(-3.0, 0.02), 0.0);
        assert_eq!(of("crosstalk").value(100.0, 0.05), HALF);
        assert_eq!(of("tip-scale").value(-100.0, 0.1), 0.05);
        assert_eq!(of("an effect of a family").value(2.0, 3.0), 6.0);
    }

    #[test]
    fn lags_are_fitted_in_frames() {
        let effect = Effect::new("delay").with("time", 0.1);
        let free = of("delay").free_numbers(&effect, 0.02);
        assert_eq!((free[0].limits, free[0].scale), ([0.0, 2.0], 0.08));
        let turn = Effect::new("truth-shift").with("turn", 0.1).with("x", 1e-3);
        let free = of("truth-shift").free_numbers(&turn, 0.02);
        assert_eq!(free.iter().map(|f| f.limits[1]).collect::<Vec<_>>(), [0.5, 0.02]);
        assert!(
            of("channel-gain").free_numbers(&Effect::new("channel-gain").with("a", 1.1), 0.02).is_empty()
        );
    }
}
