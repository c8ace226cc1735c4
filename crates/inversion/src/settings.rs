//! Settings of an [`Inverter`](crate::Inverter), and why contacts cannot be looked for.

use dermis_model::{Indentation, Tip, TipShape, Unknowns};
use dermis_skin::{ModelError, TipKind};
use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};

use crate::contact::ContactEstimate;

/// Share of the evidence that a contact begins with down to which it lasts.
const LASTS: f64 = 0.5;
/// What a contact leaves unexplained per reading, at most: drift and ambient pressure leave more.
const UNEXPLAINED: f64 = 2.0;

/// Settings of an [`Inverter`], besides the model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Contacts at most.
    #[serde(default = "one")]
    pub contacts: usize,
    /// What is looked for in each.
    #[serde(default)]
    pub unknowns: Unknowns,
    /// \[m\] of the tip that is taken to press.
    pub diameter: f64,
    /// \[m\] of the widest tip that is tried where the readings beneath a contact do not fit; that of `diameter` alone where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub widest: Option<f64>,
    /// End of that tip.
    #[serde(default, skip_serializing_if = "is_sphere")]
    pub tip: TipKind,
    /// \[N\] that a contact presses with at most.
    pub force_max: f64,
    /// Reading of the device per reading of the model, one a channel; empty: 1.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub gains: Vec<f64>,
    /// Share of a signal by which model and device differ (standard deviation) once the gains are in.
    #[serde(default)]
    pub model_error: f64,
    /// By how much one more contact must lower the sum of squared deviations, in units of the noise, to be believed.
    #[serde(default = "evidence")]
    pub evidence: f64,
    /// By how much one contact must lower the sum of squared deviations, in units of the noise, for a skin to count as touched
    /// whose level does not show it ([`Settings::exceeds_threshold`]). Drift that a zero lags behind looks like a light contact: untouched
    /// recordings of the device say how much of it there is.
    #[serde(default = "presence", skip_serializing_if = "is_presence")]
    pub presence: f64,
    /// \[m\] that contacts are apart at least.
    #[serde(default = "apart")]
    pub distance: f64,
    /// How likely forces are before the reading.
    #[serde(default, skip_serializing_if = "ForcePrior::is_default")]
    pub force_prior: ForcePrior,
    /// Standard deviation of shear along each direction of the surface over the pressing force, before the reading; any is as likely where
    /// absent. Where contacts slip, readings say no more of how large a shear is, and without it an estimate grows without end.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shear: Option<f64>,
    /// How several contacts are looked for.
    #[serde(default, skip_serializing_if = "Search::is_default")]
    pub search: Search,
    /// \[m\] two corners of the box that contacts are looked for in; all of the surface where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub region: Option<[[f64; 3]; 2]>,
}

/// How several contacts are looked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Search {
    /// One after the other ([`Inverter::solve`]): where elements are many and each responds to what is near.
    #[default]
    Greedy,
    /// The first two among all pairs of locations ([`Inverter::search`]), and from frame to frame ([`Inverter::follow`]): where
    /// elements are few and each responds to half of the surface. Where contacts change what others do, no pairs are added up, and
    /// following is what is left of it.
    Pairs,
    /// Near those of the frame before, or what a learned model says, as long as that explains the readings, and wherever it stands out
    /// otherwise ([`Inverter::search_near`](crate::Inverter::search_near)): where elements are so many that each place has a pattern of its own.
    Near,
}

impl Search {
    fn is_default(&self) -> bool {
        *self == Self::default()
    }
}

/// How likely forces are before the reading: what decides where a reading leaves it open.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ForcePrior {
    /// Every force is as likely as any other.
    #[default]
    Uniform,
    /// Every ratio is as likely as any other, up to the largest force. For skins with locations where nothing gives way: without it,
    /// a light touch looks like a strong one there.
    Log,
}

impl ForcePrior {
    fn is_default(&self) -> bool {
        *self == Self::default()
    }

    /// −2 times the logarithm of the prior's density, but for a constant.
    pub(crate) fn penalty(self, contacts: &[Indentation]) -> f64 {
        match self {
            Self::Uniform => 0.0,
            Self::Log => contacts.iter().map(|c| 2.0 * c.force.norm().max(1e-9).ln()).sum(),
        }
    }
}

fn one() -> usize {
    1
}

fn evidence() -> f64 {
    30.0
}

fn presence() -> f64 {
    30.0
}

fn is_presence(value: &f64) -> bool {
    value.to_bits() == presence().to_bits()
}

fn is_sphere(tip: &TipKind) -> bool {
    *tip == TipKind::Sphere
}

fn apart() -> f64 {
    2e-3
}

impl Settings {
    /// One normal contact of a tip of `diameter` \[m\] that presses with up to `force_max` \[N\] on a skin that is as its
    /// model says.
    #[must_use]
    pub fn new(diameter: f64, force_max: f64) -> Self {
        Self {
            contacts: one(),
            unknowns: Unknowns::default(),
            diameter,
            widest: None,
            tip: TipKind::Sphere,
            force_max,
            gains: Vec::new(),
            model_error: 0.0,
            evidence: evidence(),
            presence: presence(),
            distance: apart(),
            force_prior: ForcePrior::default(),
            shear: None,
            search: Search::default(),
            region: None,
        }
    }

    /// The contact that is looked for, at a place \[m\] with a force \[N\].
    #[must_use]
    pub fn indentation(&self, position: Point3<f64>, force: Vector3<f64>) -> Indentation {
        self.pressed_by(self.diameter, position, force)
    }

    /// The same of a tip of `diameter` \[m\].
    #[must_use]
    pub fn pressed_by(&self, diameter: f64, position: Point3<f64>, force: Vector3<f64>) -> Indentation {
        match (self.tip, force.try_normalize(0.0)) {
            (TipKind::FlatPunch, Some(pressing)) => {
                let shape = TipShape::of_kind(self.tip, diameter);
                Indentation { position, force, tip: Tip::standing(shape, &-pressing) }
            }
            _ => Indentation::sphere(position, force, diameter),
        }
    }

    /// The same of contacts that were found.
    #[must_use]
    pub fn indentations(&self, found: &[ContactEstimate]) -> Vec<Indentation> {
        found.iter().map(|c| self.pressed_by(c.diameter, c.position, c.force)).collect()
    }

    /// Whether contacts are searched among all pairs of locations.
    #[must_use]
    pub fn in_pairs(&self) -> bool {
        self.contacts > 1 && self.search == Search::Pairs
    }

    /// Whether one contact is looked for, wherever a minimum may be.
    #[must_use]
    pub fn is_single(&self) -> bool {
        self.contacts == 1 && self.search != Search::Near
    }

    /// Whether what is found depends on what was found in the frame before.
    #[must_use]
    pub fn follows(&self) -> bool {
        self.in_pairs() || self.search == Search::Near
    }

    /// Whether this [evidence](Inverter::evidence) is that of a contact; `before`: whether that of the frame before was. One that is
    /// there lasts down to a share of [`presence`](Self::presence).
    #[must_use]
    pub fn exceeds_threshold(&self, (gain, left): (f64, f64), before: bool) -> bool {
        gain > self.presence * if before { LASTS } else { 1.0 } && left < UNEXPLAINED
    }

    /// Says what is impossible for a skin of `channels`.
    ///
    /// # Errors
    ///
    /// [`InverterError::Setting`] names the field.
    pub fn check(&self, channels: usize) -> Result<(), InverterError> {
        let wrong = |field, value: String, expected: &str| {
            Err(InverterError::Setting { field, value, expected: expected.into() })
        };
        if !(1..=10).contains(&self.contacts) {
            return wrong("contacts", self.contacts.to_string(), "1 to 10");
        }
        let positive = [
            ("diameter", self.diameter),
            ("force_max", self.force_max),
            ("evidence", self.evidence),
            ("presence", self.presence),
        ];
        for (field, value) in positive {
            if !(value.is_finite() && value > 0.0) {
                return wrong(field, value.to_string(), "a positive number");
            }
        }
        if let Some(shear) = self.shear.filter(|shear| !(shear.is_finite() && *shear > 0.0)) {
            return wrong("shear", shear.to_string(), "a positive number");
        }
        if let Some(widest) = self.widest.filter(|widest| !(widest.is_finite() && *widest >= self.diameter)) {
            return wrong("widest", widest.to_string(), "`diameter` or more");
        }
        for (field, value) in [("model_error", self.model_error), ("distance", self.distance)] {
            if !(value.is_finite() && value >= 0.0) {
                return wrong(field, value.to_string(), "0 or positive");
            }
        }
        if !(self.gains.is_empty() || self.gains.len() == channels) {
            let expected = format!("one number for each of {channels} channels");
            return wrong("gains", format!("{} long", self.gains.len()), &expected);
        }
        if let Some([low, high]) = self.region
            && !low.iter().zip(&high).all(|(low, high)| low < high)
        {
            return wrong("region", format!("{low:?} to {high:?}"), "two corners of a box, the lower first");
        }
        if let Some(gain) = self.gains.iter().find(|g| !g.is_finite()) {
            return wrong("gains", gain.to_string(), "finite");
        }
        Ok(())
    }
}

/// Why contacts cannot be looked for.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum InverterError {
    /// A setting cannot be.
    #[error("`{field}` is {value} and must be {expected}")]
    Setting {
        /// Which.
        field: &'static str,
        /// What it is.
        value: String,
        /// What would be right.
        expected: String,
    },
    /// Readings of another skin.
    #[error("{found} readings where the model has {expected} channels")]
    Channels {
        /// Readings.
        found: usize,
        /// Channels of the model.
        expected: usize,
    },
    /// A correction of another skin.
    #[error("a correction of {found} channels for a model of {expected}; fit it anew")]
    Correction {
        /// Channels of the correction.
        found: usize,
        /// Channels of the model.
        expected: usize,
    },
    /// A correction that cannot be.
    #[error("the correction's `{field}`: {reason}; fit it anew")]
    CorrectionValue {
        /// Which of its fields.
        field: &'static str,
        /// What is wrong with it.
        reason: String,
    },
    /// The model has no answer.
    #[error("the forward model has no answer: {0}")]
    Model(#[from] ModelError),
}
