//! What a diagnosis of the sim-to-real gap must know of an effect, declared in the effect's own file.
//!
//! A diagnosis does not ask for an effect by its name. It asks which effects have a property: how the columns of the signature are
//! made, what else than a residual gives evidence, what the effect follows, and which numbers of it can be fitted. The amounts at
//! which signatures are linearised stand there, too: small against what devices have, large against rounding.

use serde::Serialize;

/// What a diagnosis must know of an effect; [`Diagnosis::FAMILY`] is neutral in all.
#[derive(Debug, Clone, Copy)]
pub struct Diagnosis {
    /// How the columns of its signature are made.
    pub signature: Signature,
    /// Effect that it is an addition to: its columns stand beside that one's, and it is no hypothesis of its own.
    pub addition_to: Option<&'static str>,
    /// What gives evidence of it.
    pub evidence: Evidence,
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
    /// What it follows, so that anything else that does may be taken for it.
    pub follows: Option<Covariate>,
    /// Whether what another effect does to a channel may be written in its parameters.
    pub describes_channels: bool,
    /// Whether its parameters shift the readings of each channel by a constant.
    pub shifts_channels: bool,
    /// Parameter whose tolerance is a part of the model discrepancy, and what it is called there.
    pub tolerance: Option<(&'static str, &'static str)>,
    /// Parameters that are fitted on the full simulator.
    pub free: &'static [FreeNumber],
}

impl Diagnosis {
    /// Of an effect of a sensor family: its signature comes from simulations at the ends of its parameters' ranges.
    pub const FAMILY: Self = Self {
        signature: Signature::None,
        addition_to: None,
        evidence: Evidence::Residual,
        neutral: 0.0,
        limits: None,
        least: 0.0,
        nonlinear: false,
        depends_on_uptime: false,
        follows: None,
        describes_channels: false,
        shifts_channels: false,
        tolerance: None,
        free: &[],
    };

    /// Of an effect whose parameters are called after channels and act on each channel alone.
    pub(crate) const fn of_channels(amount: Amount, slope: fn(&SignatureSample) -> f64) -> Self {
        Self { signature: Signature::Channels { amount, slope }, ..Self::FAMILY }
    }

    /// Of an effect that is simulated at these amounts.
    pub(crate) const fn simulated(variations: &'static [Variation]) -> Self {
        Self { signature: Signature::Simulated(variations), ..Self::FAMILY }
    }
}

/// How the columns of an effect's signature are made.
#[derive(Debug, Clone, Copy)]
pub enum Signature {
    /// One column for each channel: the change of its reading by its parameter at the neutral value, times an amount.
    Channels {
        /// Amount that a column is for.
        amount: Amount,
        /// Change of a reading by the parameter.
        slope: fn(&SignatureSample) -> f64,
    },
    /// One column for each parameter, which acts alike on all channels.
    Shares(&'static [Share]),
    /// Zeros of channels, and one share of all readings, decay from power-on. Columns are components of such decays: the values at
    /// power-on and one time constant are fitted to them.
    DecayFromPowerOn {
        /// Parameter that is the time constant.
        time: &'static str,
        /// Parameter that is a share of all readings, and the least value of it.
        share: (&'static str, f64),
    },
    /// Each taxel moved along each axis, by central differences of the model.
    Taxels,
    /// By simulating it at these amounts, and central differences where both signs are there.
    Simulated(&'static [Variation]),
    /// It has none: something else than the size of a residual gives evidence of it.
    None,
}

/// A parameter that changes all readings by the same share.
#[derive(Debug, Clone, Copy)]
pub struct Share {
    /// Its name.
    pub parameter: &'static str,
    /// Change of a reading by the parameter, as a share of the reading.
    pub slope: fn(&SignatureSample) -> f64,
    /// Largest share over a recording that its column is for.
    pub largest: f64,
}

/// One reading of one channel, as the signature of an effect depends on it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SignatureSample {
    /// What the nominal device reads, in the unit of the skin, before anything is subtracted.
    pub reading: f64,
    /// Full scale of the channel ([`full_scale`](super::full_scale)), in the unit of the skin.
    pub full_scale: f64,
    /// \[K\] above [`NEUTRAL_TEMPERATURE`](super::NEUTRAL_TEMPERATURE).
    pub warmer: f64,
    /// \[s\] since the device was switched on.
    pub uptime: f64,
    /// Presses so far, this one included.
    pub presses: f64,
}

/// One amount that an effect is simulated at.
#[derive(Debug, Clone, Copy)]
pub struct Variation {
    /// Name of the parameter.
    pub parameter: &'static str,
    /// How far from its neutral value.
    pub amount: Amount,
    /// What a recording must have.
    pub needs: Needs,
}

impl Variation {
    /// In the unit of the parameter.
    pub(crate) const fn by(parameter: &'static str, amount: f64) -> Self {
        Self { parameter, amount: Amount::Si(amount), needs: Needs::Nothing }
    }

    /// In times between frames.
    pub(crate) const fn frames(parameter: &'static str, count: f64) -> Self {
        Self { parameter, amount: Amount::Frames(count), needs: Needs::Nothing }
    }

    /// The same, where a recording has this.
    pub(crate) const fn needing(self, needs: Needs) -> Self {
        Self { needs, ..self }
    }
}

/// How much of a parameter, beyond its neutral value.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Amount {
    /// In the unit of the parameter.
    Si(f64),
    /// In times between frames.
    Frames(f64),
    /// In deviations of the noise, the mean over channels.
    Deviations(f64),
}

/// What a recording must have for a variation to change anything.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Needs {
    /// Nothing.
    Nothing,
    /// More than one channel.
    SeveralChannels,
    /// Contacts outside of the plane z = 0.
    CurvedSurface,
}

/// What gives evidence of an effect.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Evidence {
    /// The residual shrinks where it is switched on.
    Residual,
    /// A line in the spectrum of untouched frames; names of the parameters that are its amplitude and its frequency.
    Spectrum {
        /// Amplitude, in the unit of the skin.
        amplitude: &'static str,
        /// Frequency \[Hz\].
        frequency: &'static str,
    },
    /// Readings of channels agree with the model of others.
    ChannelOrder,
}

/// What an effect may follow.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub enum Covariate {
    /// That of the device.
    Temperature,
}

/// A parameter that is fitted on the full simulator.
#[derive(Debug, Clone, Copy)]
pub struct FreeNumber {
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

impl FreeNumber {
    /// A delay or a time constant: up to a hundred frames.
    pub(crate) const LAG: Self =
        Self { parameter: None, limits: [0.0, 100.0], scale: 4.0, typical: 0.0, frames: true };

    pub(crate) const fn new(
        parameter: Option<&'static str>,
        limits: [f64; 2],
        scale: f64,
        typical: f64,
    ) -> Self {
        Self { parameter, limits, scale, typical, frames: false }
    }
}

/// Values of a lag: what comes early cannot be simulated forwards.
pub(crate) const FORWARDS: Option<[f64; 2]> = Some([0.0, f64::INFINITY]);
/// Factors of force and tip: neither vanishes.
pub(crate) const FACTOR: Option<[f64; 2]> = Some([0.05, f64::INFINITY]);
