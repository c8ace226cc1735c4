//! Effects that every skin can have, whatever it senses with: electronics, placement, and the rig that it was measured on.
//!
//! A skin description switches them on like those of its family; their parameters are named after channels (`b0 = 1.02`) or
//! taxels (`"b0.x" = 1e-4`). The family's model never sees them: [`device`](crate::device()) takes them out and puts them around
//! it. Each is a file of its own: what it is, where in the device it acts, how, and what a diagnosis must know of it. A new one is a
//! file and a line in [`COMMON`].

mod ageing;
mod channel_curvature;
mod channel_gain;
mod channel_offset;
mod channel_order;
mod crosstalk;
mod delay;
pub mod diagnosis;
mod force_scale;
mod force_zero;
mod interference;
mod low_pass;
mod settings;
mod taxel_position;
mod thermal_bend;
mod thermal_span;
mod thermal_zero;
mod tip_scale;
mod truth_shift;
mod warm_up;

use std::sync::Arc;

use dermis_skin::{Channel, ParameterInfo, SkinDescription, Surface};
use serde::Serialize;

use crate::Indentation;
use diagnosis::Diagnosis;
pub(crate) use settings::Settings;

/// Every effect that is common to all skins, in the order in which those of one stage act. Names are part of the file format.
pub const COMMON: &[CommonEffect] = &[
    taxel_position::EFFECT,
    channel_gain::EFFECT,
    thermal_span::EFFECT,
    ageing::EFFECT,
    warm_up::EFFECT,
    channel_curvature::EFFECT,
    channel_offset::EFFECT,
    thermal_zero::EFFECT,
    thermal_bend::EFFECT,
    crosstalk::EFFECT,
    channel_order::EFFECT,
    interference::EFFECT,
    low_pass::EFFECT,
    delay::EFFECT,
    truth_shift::EFFECT,
    tip_scale::EFFECT,
    force_scale::EFFECT,
    force_zero::EFFECT,
];

/// The common effect of that name.
#[must_use]
pub fn common_effect(name: &str) -> Option<&'static CommonEffect> {
    COMMON.iter().find(|c| c.name == name)
}

/// Where in a device an effect acts, in the order of the signal; the rig, which knows what touches only so well, stands outside.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Stage {
    /// What touches: friction, a tip that stands askew.
    Stimulus,
    /// What lies between surface and sensing elements, and where these lie.
    Medium,
    /// From the medium's stress or strain to a signal: sensitivity, linearity.
    Transducer,
    /// From a signal to the converter: zero, coupling, filters, the order of lines.
    Electronics,
    /// Range and resolution.
    Converter,
    /// The rig that says what touches.
    Rig,
}

/// An effect that every skin can have. Without parameters it is the identity.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct CommonEffect {
    /// As files call it.
    pub name: &'static str,
    /// One sentence for people.
    pub what: &'static str,
    /// Where the model comes from.
    pub source: &'static str,
    /// What its parameters are called: channels, taxels with an axis, or these.
    pub parameters: CommonParameters,
    /// Unit of parameters that are called after channels or taxels; empty: that of the skin.
    pub unit: &'static str,
    /// Whether readings depend on what happened before.
    pub stateful: bool,
    /// Whether it belongs to the rig rather than to the skin.
    pub rig: bool,
    /// Where it acts; one that acts twice (warm-up: on sensitivity and on zero) names the first stage.
    pub stage: Stage,
    /// What a diagnosis of the sim-to-real gap must know of it.
    #[serde(skip)]
    pub diagnosis: Diagnosis,
    /// What it does, with these settings: nothing where they are neutral.
    #[serde(skip)]
    pub(crate) acts: fn(&Settings<'_>) -> Result<Vec<Act>, Refused>,
}

impl CommonEffect {
    /// Parameters that have a name of their own, whatever the skin.
    #[must_use]
    pub fn named(&self) -> &'static [ParameterInfo] {
        match self.parameters {
            CommonParameters::Named(named) | CommonParameters::ChannelsAnd(named) => named,
            CommonParameters::Channels | CommonParameters::Taxels => &[],
        }
    }

    /// Whether each channel has parameters of its own.
    #[must_use]
    pub fn per_channel(&self) -> bool {
        !matches!(self.parameters, CommonParameters::Named(_))
    }

    /// Unit of a parameter; empty: that of the skin.
    #[must_use]
    pub fn unit_of(&self, parameter: &str) -> &'static str {
        self.named().iter().find(|p| p.name == parameter).map_or(self.unit, |p| p.unit)
    }
}

/// What the parameters of a common effect are called.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum CommonParameters {
    /// Names of channels.
    Channels,
    /// Names of taxels with `.x`, `.y` or `.z`.
    Taxels,
    /// These; their typical value is what they are where a file does not name them.
    Named(&'static [ParameterInfo]),
    /// Names of channels, and these.
    ChannelsAnd(&'static [ParameterInfo]),
}

/// \[K\] at which thermal effects are neutral.
pub const NEUTRAL_TEMPERATURE: f64 = 293.15;

/// The larger end of a channel's range; 1000 deviations of its noise where it has none.
#[must_use]
pub fn full_scale(channel: &Channel, noise: f64) -> f64 {
    let ends = channel.range.map(|[low, high]| low.abs().max(high.abs()));
    let ends = ends.filter(|e| e.is_finite() && *e > 0.0);
    ends.unwrap_or(1e3 * channel.noise.unwrap_or(noise)).max(f64::MIN_POSITIVE)
}

/// A parameter that cannot be: its name, and why.
pub(crate) type Refused = (String, String);

/// What an effect does to a device.
pub(crate) enum Act {
    /// Changes the description that the family's model is made of.
    Design(Box<dyn FnOnce(&mut SkinDescription)>),
    /// Changes readings, and remembers nothing.
    Reading(Stage, Box<dyn ReadingAct>),
    /// Changes readings, and remembers: this switches it on.
    Remembers(Stage, Box<dyn Starts>),
    /// Says what really touches where the rig says something else.
    Rig(Arc<dyn RigAct>),
}

impl Act {
    fn reading(stage: Stage, act: impl ReadingAct + 'static) -> Self {
        Self::Reading(stage, Box::new(act))
    }

    fn remembers(stage: Stage, start: impl Starts + 'static) -> Self {
        Self::Remembers(stage, Box::new(start))
    }
}

/// What acts depend on beside the readings.
pub(crate) struct Circumstances {
    /// \[s\] since the device was switched on.
    pub time: f64,
    /// Whether anything touches.
    pub touched: bool,
}

/// Changes noise-free readings, whatever happened before.
pub(crate) trait ReadingAct: Send + Sync {
    /// The time is not known here, as a response has none.
    fn apply(&self, warmer: f64, readings: &mut [f64]);
}

/// Switches on what remembers.
pub(crate) trait Starts: Send + Sync {
    fn start(&self) -> Box<dyn StatefulAct>;
}

/// What is cloned from how it is at the beginning.
impl<T: StatefulAct + Clone + Sync + 'static> Starts for T {
    fn start(&self) -> Box<dyn StatefulAct> {
        Box::new(self.clone())
    }
}

/// Changes noise-free readings along the way of a device through time.
pub(crate) trait StatefulAct: Send {
    fn apply(&mut self, now: &Circumstances, readings: &mut [f64]);
}

/// The rig says what touches; this says what really does.
pub(crate) trait RigAct: Send + Sync {
    /// The contact as it really is, where the rig says that it is this.
    fn real(&self, contact: &mut Indentation, surface: &Surface);

    /// \[N\] that really press where the rig says `stated`.
    fn real_force(&self, stated: f64) -> f64 {
        stated
    }

    /// \[N\] that the rig says where `real` press.
    fn stated_force(&self, real: f64) -> f64 {
        real
    }
}

#[cfg(test)]
mod tests;
