//! The search for contacts.

use std::sync::Arc;

use dermis_model::{ForwardModel, Indentation, Unknowns, Untouched, tangents};
use dermis_skin::{ChannelFlags, ModelError, Surface};
use nalgebra::{DMatrix, Matrix3, Point3, Vector3};
use serde::{Deserialize, Serialize};

use crate::dictionary::{Dictionary, SHAPE};
use crate::fit::{Datum, Minimum, Problem};
use crate::pairs::Pairs;

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
    /// whose level does not show it ([`Settings::shows`]). Drift that a zero lags behind looks like a light contact: untouched
    /// recordings of the device say how much of it there is.
    #[serde(default = "presence", skip_serializing_if = "is_presence")]
    pub presence: f64,
    /// \[m\] that contacts are apart at least.
    #[serde(default = "apart")]
    pub distance: f64,
    /// How likely forces are before the reading.
    #[serde(default, skip_serializing_if = "ForcePrior::is_default")]
    pub force_prior: ForcePrior,
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
    /// The first two among all pairs of places ([`Inverter::search`]), and from frame to frame ([`Inverter::follow`]): where
    /// elements are few and each responds to half of the surface.
    Pairs,
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
    /// Every ratio is as likely as any other, up to the largest force. For skins with places where nothing gives way: without it,
    /// a light touch looks like a strong one there.
    Log,
}

impl ForcePrior {
    fn is_default(&self) -> bool {
        *self == Self::default()
    }

    /// −2 times the logarithm of the prior's density, but for a constant.
    fn penalty(self, contacts: &[Indentation]) -> f64 {
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
            force_max,
            gains: Vec::new(),
            model_error: 0.0,
            evidence: evidence(),
            presence: presence(),
            distance: apart(),
            force_prior: ForcePrior::default(),
            search: Search::default(),
            region: None,
        }
    }

    /// Whether contacts are searched among all pairs of places.
    #[must_use]
    pub fn in_pairs(&self) -> bool {
        self.contacts > 1 && self.search == Search::Pairs
    }

    /// Whether this [evidence](Inverter::evidence) is that of a contact; `before`: whether that of the frame before was. One that is
    /// there lasts down to a share of [`presence`](Self::presence).
    #[must_use]
    pub fn shows(&self, (gain, left): (f64, f64), before: bool) -> bool {
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

/// What one channel reads, minus its untouched reading, in the unit of the skin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Reading {
    /// This.
    Exact(f64),
    /// This or more: it is at the upper end of its range.
    AtLeast(f64),
    /// This or less: it is at the lower end of its range.
    AtMost(f64),
    /// Nothing that could be relied on.
    Missing,
}

impl Reading {
    /// A `signal` (untouched reading subtracted) of a channel with these flags.
    #[must_use]
    pub fn of(signal: f32, flags: ChannelFlags) -> Self {
        let saturated = flags.contains(ChannelFlags::SATURATED);
        match f64::from(signal) {
            v if v.is_nan() || flags.is_invalid() => Self::Missing,
            v if saturated && v > 0.0 => Self::AtLeast(v),
            v if saturated => Self::AtMost(v),
            v => Self::Exact(v),
        }
    }
}

/// One contact that was found.
#[derive(Debug, Clone, PartialEq)]
pub struct Found {
    /// \[m\] on the surface.
    pub position: Point3<f64>,
    /// Out of the surface there.
    pub normal: Vector3<f64>,
    /// \[N\] exerted on the skin.
    pub force: Vector3<f64>,
    /// \[m²\] in the frame of the skin's link.
    pub position_covariance: Matrix3<f64>,
    /// \[N²\] in the frame of the skin's link.
    pub force_covariance: Matrix3<f64>,
}

impl Found {
    /// \[N\] with which it presses.
    #[must_use]
    pub fn normal_force(&self) -> f64 {
        -self.force.dot(&self.normal)
    }

    /// \[m\] root of the variance of its place, both directions together.
    #[must_use]
    pub fn deviation(&self) -> f64 {
        self.position_covariance.trace().max(0.0).sqrt()
    }
}

/// What readings say.
#[derive(Debug, Clone, PartialEq)]
pub struct Solution {
    /// Strongest first; empty where nothing stands out of the noise.
    pub contacts: Vec<Found>,
    /// Sum of squared deviations from the readings, in units of their noise.
    pub chi2: f64,
    /// Readings that count, less the numbers that were looked for.
    pub freedom: usize,
}

/// A weak contact whose place is known no better than this many spacings of the dictionary is answered by the mean over
/// all places that it may have.
const BROAD: f64 = 0.8;
/// Deviations of its expectation up to which a sum of squared deviations is what noise leaves.
const PLAUSIBLE: f64 = 2.0;
/// Share of the evidence that a contact begins with down to which it lasts.
const LASTS: f64 = 0.5;
/// What a contact leaves unexplained per reading, at most: drift and ambient pressure leave more.
const UNEXPLAINED: f64 = 2.0;
/// Starts of a further contact that are tried.
const STARTS: usize = 2;
/// Pairs of places, and single ones, that a search begins at.
const PAIRS: usize = 5;
/// \[m\] by which a contact is split in two, to both sides.
const SPLIT: f64 = 3e-3;
/// Places of a dictionary at most, roughly.
const PLACES: f64 = 1500.0;

/// Ways to begin with one contact more.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Start {
    /// Where the caller says.
    Hint,
    /// Where the dictionary explains most of what is left.
    Dictionary,
    /// At both sides of the contact that was found last.
    Split,
}

/// Finds contacts that explain readings.
///
/// Greedy in their number: the best single contact, then one more where that explains significantly more, all refined
/// together (orthogonal matching pursuit with a least-squares step of all unknowns; S. G. Mallat and Z. Zhang, *IEEE
/// Trans. Signal Process.* 41 (1993) 3397). The noise is Gaussian, so that the least squares are the maximum of the
/// likelihood, and the error of the answer approaches the Cramér–Rao bound as the signal grows. A contact so weak that its
/// place is all but open is answered by its mean over the surface and over all forces, both equally likely beforehand:
/// that is a prior, and lets the error stay below the bound for estimators without bias.
#[derive(Debug)]
pub struct Inverter {
    model: ModelBox,
    settings: Settings,
    gains: Vec<f64>,
    untouched: Untouched,
    spacing: f64,
    /// \[m\] y of the middle line, where only x is looked for.
    line: Option<f64>,
    dictionary: Dictionary,
    pairs: Pairs,
}

struct ModelBox(Arc<dyn ForwardModel>);

impl std::fmt::Debug for ModelBox {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("ForwardModel").field("channels", &self.0.channels()).finish_non_exhaustive()
    }
}

impl Inverter {
    /// An inverter for one skin; costs some thousand responses of the model.
    ///
    /// # Errors
    ///
    /// [`InverterError::Setting`] names what cannot be; [`InverterError::Model`] where the model has no answer.
    pub fn new(model: Arc<dyn ForwardModel>, settings: Settings) -> Result<Self, InverterError> {
        let channels = model.channels();
        settings.check(channels)?;
        let s = &settings;
        let gains = if s.gains.is_empty() { vec![1.0; channels] } else { s.gains.clone() };
        let untouched = Untouched::of(model.as_ref())?;
        let area: f64 = model.surface().areas.iter().sum();
        // Fine enough to begin at; a row of taxels has a length more than an area.
        let longest = model.surface().points.iter().map(|p| p.coords.amax()).fold(0.0, f64::max);
        let spacing = (area / PLACES).sqrt().max(longest / PLACES).max(5e-4);
        let points = &model.surface().points;
        let middle = points.iter().map(|p| p.y).sum::<f64>() / points.len().max(1) as f64;
        let line = (s.unknowns == Unknowns::Line).then_some(middle);
        let dictionary =
            Dictionary::new(model.as_ref(), (line, s.region), spacing, s.diameter, s.force_max, &gains)?;
        let pairs = Pairs::new(&dictionary, spacing);
        Ok(Self { model: ModelBox(model), settings, gains, untouched, spacing, line, dictionary, pairs })
    }

    /// Its settings.
    #[must_use]
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// The model that it inverts.
    #[must_use]
    pub fn model(&self) -> &Arc<dyn ForwardModel> {
        &self.model.0
    }

    /// What the channels of the device read for these contacts, less what they read untouched, written to `out` (one a
    /// channel, in the unit of the skin).
    ///
    /// # Errors
    ///
    /// [`InverterError::Model`] where a contact lies off the surface or is not a number.
    pub fn signal(&self, contacts: &[Indentation], out: &mut [f64]) -> Result<(), InverterError> {
        Ok(self.problem(&[]).signal(contacts, out)?)
    }

    /// The contacts that explain `readings` best. `hint` is a contact to begin at besides what is found here: what a
    /// learned model says, or the frame before.
    ///
    /// # Errors
    ///
    /// [`InverterError::Channels`] for readings of another skin.
    pub fn solve(&self, readings: &[Reading], hint: Option<&Indentation>) -> Result<Solution, InverterError> {
        self.check(readings)?;
        let channels = self.gains.len();
        let data = self.data(readings);
        let problem = self.problem(&data);
        let counted = data.iter().filter(|d| **d != Datum::None).count();
        let nothing: Vec<f64> = vec![0.0; channels];
        let mut best = Minimum {
            contacts: Vec::new(),
            chi2: data
                .iter()
                .map(|d| match d {
                    Datum::Exact(v, w) | Datum::AtLeast(v, w) | Datum::AtMost(v, w) => (v * w).powi(2),
                    Datum::None => 0.0,
                })
                .sum(),
            covariance: None,
            signal: nothing,
        };
        let per_contact = self.settings.unknowns.count();
        while best.contacts.len() < self.settings.contacts {
            let after = (best.contacts.len() + 1) * per_contact;
            // What noise alone leaves cannot be explained any better.
            let left = best.chi2 - counted.saturating_sub(after) as f64;
            if after > counted || left < self.settings.evidence && !best.contacts.is_empty() {
                break;
            }
            let freedom = counted.saturating_sub(after) as f64;
            let mut found: Option<Minimum> = None;
            for kind in [Start::Hint, Start::Dictionary, Start::Split] {
                // What is left is noise: no other start finds anything better.
                let enough = |f: &Minimum| f.chi2 < freedom + PLAUSIBLE * (2.0 * freedom).sqrt();
                if found.as_ref().is_some_and(enough) {
                    break;
                }
                for start in self.starts(kind, &data, &best, hint) {
                    let minimum = problem.minimise(start)?;
                    if found.as_ref().is_none_or(|f| self.score(&minimum) < self.score(f)) {
                        found = Some(minimum);
                    }
                }
            }
            let Some(found) = found else { break };
            let first = best.contacts.is_empty();
            // The caller knows that there is a contact; each further one must lower the deviations enough.
            if !first && (best.chi2 - found.chi2 < self.settings.evidence || !self.apart(&found)) {
                break;
            }
            best = found;
        }
        Ok(self.solution(&best, &data))
    }

    /// How surely readings show a contact at all: by how much the best single one of the dictionary lowers the sum of
    /// squared deviations, and what it leaves per reading. A matched filter, that finds contacts which no channel shows by
    /// itself; drift, which has another pattern, leaves more than noise does. (0, 0) for readings of another skin.
    #[must_use]
    pub fn evidence(&self, readings: &[Reading]) -> (f64, f64) {
        if readings.len() != self.gains.len() {
            return (0.0, 0.0);
        }
        let data = self.data(readings);
        let left = residuals(&data, &vec![0.0; data.len()]);
        let whole: f64 = left.iter().map(|r| f64::from(*r).powi(2)).sum();
        let counted = data.iter().filter(|d| **d != Datum::None).count();
        let freedom = counted.saturating_sub(self.settings.unknowns.count());
        // Nothing can be gained that is not there.
        if whole < self.settings.evidence || freedom == 0 {
            return (0.0, whole / counted.max(1) as f64);
        }
        let best = f64::from(self.dictionary.project(&left).fold(0.0f32, f32::max)).powi(2);
        (best, (whole - best) / freedom as f64)
    }

    /// The contacts near `starts` that explain `readings` best, refined together. The weakest is dropped for as long as what
    /// remains explains the readings about as well ([`Settings::evidence`]), and where two have run into one another.
    ///
    /// # Errors
    ///
    /// [`InverterError::Channels`] for readings of another skin.
    pub fn refine(&self, readings: &[Reading], starts: &[Indentation]) -> Result<Solution, InverterError> {
        self.check(readings)?;
        let data = self.data(readings);
        let problem = self.problem(&data);
        let counted = data.iter().filter(|d| **d != Datum::None).count();
        let per_contact = self.settings.unknowns.count();
        // More than the readings can tell are not looked for.
        let most = self.settings.contacts.min(counted / per_contact);
        let mut strongest = starts.to_vec();
        strongest.sort_by(|a, b| b.force.norm().total_cmp(&a.force.norm()));
        strongest.truncate(most);
        let mut best = problem.minimise(strongest)?;
        while best.contacts.len() > 1 {
            let weakest = (0..best.contacts.len())
                .min_by(|a, b| best.contacts[*a].force.norm().total_cmp(&best.contacts[*b].force.norm()));
            let mut fewer = best.contacts.clone();
            weakest.map(|i| fewer.remove(i));
            let fewer = problem.minimise(fewer)?;
            // Each contact less leaves about as many units more to noise as it had unknowns.
            if fewer.chi2 - best.chi2 >= self.settings.evidence && self.apart(&best) {
                break;
            }
            best = fewer;
        }
        Ok(self.solution(&best, &data))
    }

    /// As [`solve`](Self::solve), but looks for two contacts among all pairs of places, not for the second beside the first:
    /// where elements are few and each responds to half of the surface, the best single contact may be none of the two. Takes some
    /// milliseconds.
    ///
    /// # Errors
    ///
    /// [`InverterError::Channels`] for readings of another skin.
    pub fn search(&self, readings: &[Reading]) -> Result<Solution, InverterError> {
        self.check(readings)?;
        let data = self.data(readings);
        let problem = self.problem(&data);
        let counted = data.iter().filter(|d| **d != Datum::None).count();
        let s = &self.settings;
        let most = s.contacts.min(counted / s.unknowns.count());
        let untouched = vec![0.0; data.len()];
        let mut best: Option<Minimum> = None;
        for start in self.matches(&data, &untouched, PAIRS) {
            let minimum = problem.minimise(vec![start])?;
            if best.as_ref().is_none_or(|b| self.score(&minimum) < self.score(b)) {
                best = Some(minimum);
            }
        }
        let Some(mut best) = best else { return self.solve(readings, None) };
        for contacts in 2..=most {
            let left = best.chi2 - counted.saturating_sub(contacts * s.unknowns.count()) as f64;
            if left < s.evidence {
                break;
            }
            let mut starts: Vec<Vec<Indentation>> = Vec::new();
            // Pairs are added up of places that were pressed alone: only a medium that does so can be searched by them.
            if contacts == 2 && self.model.0.superposes() {
                let bounds = (s.distance, s.force_max * 1.2, s.diameter);
                let pairs = self.pairs.best(&self.dictionary, &data, bounds, PAIRS);
                starts.extend(pairs.into_iter().map(Vec::from));
            }
            for kind in [Start::Dictionary, Start::Split] {
                starts.extend(self.starts(kind, &data, &best, None));
            }
            let mut found: Option<Minimum> = None;
            for start in starts {
                let minimum = problem.minimise(start)?;
                let better = |f: &Minimum| self.score(&minimum) < self.score(f);
                if found.as_ref().is_none_or(better) && self.apart(&minimum) {
                    found = Some(minimum);
                }
            }
            match found {
                Some(found) if best.chi2 - found.chi2 >= s.evidence => best = found,
                _ => break,
            }
        }
        Ok(self.solution(&best, &data))
    }

    /// The contacts of the frame `before`, moved to where they explain these readings best: what [`search`](Self::search) finds,
    /// in a fraction of its time, for as long as the same contacts last. `None` where that is not so: they leave more than noise
    /// leaves, fewer would do, or their places are all but open. Then search anew.
    ///
    /// # Errors
    ///
    /// [`InverterError::Channels`] for readings of another skin.
    pub fn follow(&self, readings: &[Reading], before: &[Found]) -> Result<Option<Solution>, InverterError> {
        self.check(readings)?;
        let s = &self.settings;
        let data = self.data(readings);
        let counted = data.iter().filter(|d| **d != Datum::None).count();
        let Some(freedom) = counted.checked_sub(s.unknowns.count() * before.len()) else { return Ok(None) };
        if before.is_empty() || before.len() > s.contacts || before.iter().any(|f| self.is_broad(f)) {
            return Ok(None);
        }
        let problem = self.problem(&data);
        let start = before.iter().map(|f| Indentation::sphere(f.position, f.force, s.diameter)).collect();
        let moved = problem.minimise(start)?;
        let freedom = freedom as f64;
        if moved.chi2 > freedom + PLAUSIBLE * (2.0 * freedom).sqrt() || !self.apart(&moved) {
            return Ok(None);
        }
        // Any of them may have ended, not the weakest alone.
        for i in 0..if moved.contacts.len() > 1 { moved.contacts.len() } else { 0 } {
            let mut fewer = moved.contacts.clone();
            fewer.remove(i);
            if problem.minimise(fewer)?.chi2 - moved.chi2 < s.evidence {
                return Ok(None);
            }
        }
        let solution = self.solution(&moved, &data);
        Ok((!solution.contacts.iter().any(|f| self.is_broad(f))).then_some(solution))
    }

    /// Whether a contact's place is all but open.
    fn is_broad(&self, found: &Found) -> bool {
        let deviation = found.deviation();
        deviation.is_nan() || deviation >= BROAD * self.spacing
    }

    /// Share of the surface where a press of `force` \[N\] lowers the sum of squared deviations by less than `evidence`, in
    /// units of the noise: where it cannot be detected.
    #[must_use]
    pub fn unfelt(&self, force: f64, evidence: f64) -> f64 {
        let unit = self.dictionary.forces[SHAPE];
        let (mut all, mut undetectable) = (0.0, 0.0);
        for (index, place) in self.dictionary.places.iter().enumerate() {
            let response = self.dictionary.response(index, SHAPE).iter().zip(self.noise());
            let square: f64 = response.map(|(v, n)| (f64::from(*v) / n * force / unit).powi(2)).sum();
            all += place.area;
            if square < evidence {
                undetectable += place.area;
            }
        }
        if all > 0.0 { undetectable / all } else { 0.0 }
    }

    /// How unlikely a minimum is, to be compared between minima of as many contacts.
    fn score(&self, minimum: &Minimum) -> f64 {
        minimum.chi2 + self.settings.force_prior.penalty(&minimum.contacts)
    }

    fn check(&self, readings: &[Reading]) -> Result<(), InverterError> {
        let channels = self.gains.len();
        if readings.len() == channels {
            return Ok(());
        }
        Err(InverterError::Channels { found: readings.len(), expected: channels })
    }

    fn problem<'a>(&'a self, data: &'a [Datum]) -> Problem<'a> {
        Problem {
            model: self.model.0.as_ref(),
            unknowns: self.settings.unknowns,
            data,
            gains: &self.gains,
            untouched: &self.untouched,
            force_max: self.settings.force_max * 1.5,
        }
    }

    fn solution(&self, best: &Minimum, data: &[Datum]) -> Solution {
        let counted = data.iter().filter(|d| **d != Datum::None).count();
        let mut contacts = self.describe(best, data);
        if let [single] = contacts.as_mut_slice()
            && self.is_broad(single)
        {
            *single = self.mean(data, single);
        }
        contacts.sort_by(|a, b| b.normal_force().total_cmp(&a.normal_force()));
        let freedom = counted.saturating_sub(self.settings.unknowns.count() * contacts.len());
        Solution { contacts, chi2: best.chi2, freedom }
    }

    /// Readings in units of their noise; what is missing is 0.
    pub(crate) fn whitened(&self, readings: &[Reading]) -> Result<Vec<f64>, InverterError> {
        self.check(readings)?;
        let value = |(reading, noise): (&Reading, &f64)| match *reading {
            Reading::Exact(v) | Reading::AtLeast(v) | Reading::AtMost(v) if v.is_finite() => v / noise,
            _ => 0.0,
        };
        Ok(readings.iter().zip(self.noise()).map(value).collect())
    }

    pub(crate) fn noise(&self) -> &[f64] {
        self.model.0.noise()
    }

    pub(crate) fn dictionary(&self) -> &Dictionary {
        &self.dictionary
    }

    /// Surface that contacts lie on.
    #[must_use]
    pub fn surface(&self) -> &Surface {
        self.model.0.surface()
    }

    fn data(&self, readings: &[Reading]) -> Vec<Datum> {
        let weight = |noise: f64, value: f64| 1.0 / noise.hypot(self.settings.model_error * value);
        readings
            .iter()
            .zip(self.model.0.noise())
            .map(|(reading, noise)| match *reading {
                Reading::Exact(v) if v.is_finite() => Datum::Exact(v, weight(*noise, v)),
                Reading::AtLeast(v) if v.is_finite() => Datum::AtLeast(v, weight(*noise, v)),
                Reading::AtMost(v) if v.is_finite() => Datum::AtMost(v, weight(*noise, v)),
                _ => Datum::None,
            })
            .collect()
    }

    /// Where to begin with one contact more than `best` has.
    fn starts(
        &self,
        kind: Start,
        data: &[Datum],
        best: &Minimum,
        hint: Option<&Indentation>,
    ) -> Vec<Vec<Indentation>> {
        let with = |contact: Indentation| {
            let mut all = best.contacts.clone();
            all.push(contact);
            all
        };
        match kind {
            Start::Hint => {
                let first = hint.filter(|_| best.contacts.is_empty());
                let on_line = |contact: &Indentation| {
                    let mut contact = contact.clone();
                    contact.position.y = self.line.unwrap_or(contact.position.y);
                    contact
                };
                first.map(|h| with(on_line(h))).into_iter().collect()
            }
            Start::Dictionary => self.matches(data, &best.signal, STARTS).into_iter().map(with).collect(),
            // Two contacts that stand close look like one between them.
            Start::Split => {
                let Some((last, others)) = best.contacts.split_last() else { return Vec::new() };
                let surface = self.model.0.surface();
                let (place, normal) = surface.project(&last.position);
                let directions = if self.settings.unknowns == Unknowns::Line { 1 } else { 2 };
                let half = |by: Vector3<f64>| {
                    let (position, normal) = surface.project(&(place + by));
                    Indentation { position, force: -normal * (last.force.norm() / 2.0), ..last.clone() }
                };
                tangents(&normal)[..directions]
                    .iter()
                    .map(|along| {
                        others.iter().cloned().chain([half(along * SPLIT), half(along * -SPLIT)]).collect()
                    })
                    .collect()
            }
        }
    }

    /// Contacts of the dictionary that explain whitened residuals best, no two of them near to each other.
    fn matches(&self, data: &[Datum], signal: &[f64], most: usize) -> Vec<Indentation> {
        let left = residuals(data, signal);
        let mut scores: Vec<(f32, usize)> = self.dictionary.project(&left).zip(0..).collect();
        scores.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut chosen: Vec<Indentation> = Vec::new();
        for (_, index) in scores {
            let place = &self.dictionary.places[index];
            if chosen.len() == most {
                break;
            }
            if chosen.iter().any(|c| (c.position - place.position).norm() < 3.0 * self.spacing) {
                continue;
            }
            // The level whose force changes least.
            let force = (0..self.dictionary.forces.len())
                .map(|level| {
                    let (mut dot, mut square) = (0.0, 0.0);
                    let response = self.dictionary.response(index, level).iter().zip(self.model.0.noise());
                    for ((value, noise), residual) in response.zip(&left) {
                        let v = f64::from(*value) / noise;
                        dot += v * f64::from(*residual);
                        square += v * v;
                    }
                    if square > 0.0 { dot / square } else { 0.0 }
                })
                .zip(&self.dictionary.forces)
                .min_by(|a, b| (a.0.max(1e-9).ln().abs()).total_cmp(&b.0.max(1e-9).ln().abs()))
                .map_or(0.0, |(share, force)| share * force);
            chosen.push(Indentation::sphere(
                place.position,
                -place.normal * force.clamp(1e-3, self.settings.force_max),
                self.settings.diameter,
            ));
        }
        chosen
    }

    fn apart(&self, minimum: &Minimum) -> bool {
        minimum.contacts.iter().enumerate().all(|(i, a)| {
            minimum.contacts[..i].iter().all(|b| (a.position - b.position).norm() >= self.settings.distance)
        })
    }

    fn describe(&self, minimum: &Minimum, data: &[Datum]) -> Vec<Found> {
        let per_contact = self.settings.unknowns.count();
        let counted = data.iter().filter(|d| **d != Datum::None).count();
        let freedom = counted.saturating_sub(per_contact * minimum.contacts.len());
        // Where model and readings differ by more than noise, the error is more than noise makes.
        let inflation = if freedom > 0 { (minimum.chi2 / freedom as f64).max(1.0) } else { 1.0 };
        minimum
            .contacts
            .iter()
            .enumerate()
            .map(|(i, contact)| {
                let (position, normal) = self.model.0.surface().project(&contact.position);
                let block = minimum.covariance.as_ref().map(|c| {
                    c.view((i * per_contact, i * per_contact), (per_contact, per_contact)).into_owned()
                });
                let (place, force) = covariances(self.settings.unknowns, &normal, block.as_ref());
                Found {
                    position,
                    normal,
                    force: contact.force,
                    position_covariance: place * inflation,
                    force_covariance: force * inflation,
                }
            })
            .collect()
    }

    /// Mean and covariance of one contact over all places and forces, each as likely as any other before the reading.
    fn mean(&self, data: &[Datum], sharp: &Found) -> Found {
        let levels = &self.dictionary.forces;
        let mut terms: Vec<(f64, f64, f64, usize)> = Vec::with_capacity(self.dictionary.places.len());
        let mut least = f64::INFINITY;
        for place in 0..self.dictionary.places.len() {
            // The level whose force comes out nearest to itself.
            let mut chosen: Option<(f64, f64, f64, f64)> = None;
            for (level, force) in levels.iter().enumerate() {
                let (mut dot, mut square, mut whole) = (0.0, 0.0, 0.0);
                let response = self.dictionary.response(place, level);
                for (value, datum) in response.iter().zip(data) {
                    let Datum::Exact(reading, weight) = *datum else { continue };
                    let v = f64::from(*value) * weight / force;
                    dot += v * reading * weight;
                    square += v * v;
                    whole += (reading * weight).powi(2);
                }
                if square <= 0.0 {
                    continue;
                }
                let found = dot / square;
                let off = (found.max(1e-6) / force).ln().abs();
                if chosen.is_none_or(|(o, ..)| off < o) {
                    chosen = Some((off, found, square, whole - dot * dot / square));
                }
            }
            if let Some((_, found, square, chi2)) = chosen {
                least = least.min(chi2);
                terms.push((found, square, chi2, place));
            }
        }
        let (mut total, mut force, mut force_square) = (0.0, 0.0, 0.0);
        let (mut place, mut second) = (Vector3::zeros(), Matrix3::zeros());
        for (found, square, chi2, index) in terms {
            let spot = &self.dictionary.places[index];
            // The force is Gaussian about `found`, cut off at 0 (and, far away, at the largest).
            let deviation = 1.0 / square.sqrt();
            let (mass, mean, variance) = truncated(found, deviation);
            let mass = match self.settings.force_prior {
                ForcePrior::Uniform => mass,
                ForcePrior::Log if found > self.settings.force_max + 2.0 * deviation => continue,
                ForcePrior::Log => mass / mean.max(1e-9),
            };
            let weight = spot.area * mass * deviation * (-(chi2 - least) / 2.0).exp();
            total += weight;
            force += weight * mean;
            force_square += weight * (variance + mean * mean);
            place += spot.position.coords * weight;
            second += spot.position.coords * spot.position.coords.transpose() * weight;
        }
        if !(total > 0.0 && total.is_finite()) {
            return sharp.clone();
        }
        let mean = place / total;
        let (position, normal) = self.model.0.surface().project(&Point3::from(mean));
        let pressing = (force / total).min(self.settings.force_max * 1.5);
        let variance = (force_square / total - pressing * pressing).max(0.0);
        // Presses of the dictionary are straight: a shear that is looked for is as open as the sharp answer says.
        let across = Matrix3::identity() - normal * normal.transpose();
        let shear = match self.settings.unknowns {
            Unknowns::Full => across * sharp.force_covariance * across,
            _ => Matrix3::zeros(),
        };
        Found {
            position,
            normal,
            force: -normal * pressing,
            position_covariance: second / total - mean * mean.transpose(),
            force_covariance: normal * normal.transpose() * variance + shear,
        }
    }
}

/// What a model signal leaves of data, in units of their noise.
fn residuals(data: &[Datum], signal: &[f64]) -> Vec<f32> {
    let left = |(datum, signal): (&Datum, &f64)| match *datum {
        Datum::Exact(v, w) => (v - signal) * w,
        Datum::AtLeast(v, w) => (v - signal).max(0.0) * w,
        Datum::AtMost(v, w) => (v - signal).min(0.0) * w,
        Datum::None => 0.0,
    };
    data.iter().zip(signal).map(|pair| left(pair) as f32).collect()
}

/// Covariances of place and force in the frame of the link from those of the unknowns; unknown where `block` is.
fn covariances(
    unknowns: Unknowns,
    normal: &Vector3<f64>,
    block: Option<&DMatrix<f64>>,
) -> (Matrix3<f64>, Matrix3<f64>) {
    let Some(block) = block else {
        return (
            Matrix3::from_diagonal_element(f64::INFINITY),
            Matrix3::from_diagonal_element(f64::INFINITY),
        );
    };
    let [first, second] = tangents(normal);
    let (along, forces): (Vec<Vector3<f64>>, Vec<Vector3<f64>>) = match unknowns {
        Unknowns::Line => (vec![first], vec![-normal]),
        Unknowns::Normal => (vec![first, second], vec![-normal]),
        Unknowns::Full => (vec![first, second], vec![-normal, first, second]),
    };
    let spread = |axes: &[Vector3<f64>], from: usize| {
        let mut all = Matrix3::zeros();
        for (i, a) in axes.iter().enumerate() {
            for (j, b) in axes.iter().enumerate() {
                all += a * b.transpose() * block[(from + i, from + j)];
            }
        }
        all
    };
    (spread(&along, 0), spread(&forces, along.len()))
}

/// Mass, mean and variance of a Gaussian that is cut off below 0.
fn truncated(mean: f64, deviation: f64) -> (f64, f64, f64) {
    let z = mean / deviation;
    let mass = 0.5 * libm::erfc(-z / std::f64::consts::SQRT_2);
    if mass < 1e-12 {
        // Far below 0 the rest is exponential.
        let scale = deviation / z.abs();
        return (mass, scale, scale * scale);
    }
    let ratio = (-z * z / 2.0).exp() / (std::f64::consts::TAU.sqrt() * mass);
    let variance = deviation * deviation * (1.0 - ratio * (z + ratio));
    (mass, mean + deviation * ratio, variance.max(0.0))
}

#[cfg(test)]
mod tests {
    use dermis_theory::cramer_rao;
    use proptest::prelude::*;
    use rand::Rng;

    use dermis_model::Stimulus;

    use super::*;
    use crate::testing::{Shifted, Toy, press, random};

    fn inverter(noise: f64, change: impl FnOnce(&mut Settings)) -> (Inverter, Arc<Toy>) {
        let model = Arc::new(Toy::grid(noise));
        let mut settings = Settings::new(0.004, 2.0);
        change(&mut settings);
        let shared: Arc<dyn ForwardModel> = Arc::clone(&model) as _;
        (Inverter::new(shared, settings).unwrap(), model)
    }

    #[test]
    fn one_contact_is_found_to_its_bound() {
        let (inverter, model) = inverter(20.0, |_| ());
        let mut random = random(1);
        for force in [0.2, 1.0] {
            let (mut error, mut bound, mut expected) = (0.0, 0.0, 0.0);
            let tries = 300;
            for _ in 0..tries {
                let truth =
                    press(random.random_range(-0.012..0.012), random.random_range(-0.012..0.012), force);
                let stimulus = Stimulus { contacts: vec![truth.clone()], ..Stimulus::default() };
                let solution = inverter.solve(&model.read(&stimulus.contacts, &mut random), None).unwrap();
                let [found] = solution.contacts.as_slice() else { panic!("{solution:?}") };
                error += (found.position - truth.position).norm_squared();
                expected += found.deviation().powi(2);
                bound += cramer_rao(model.as_ref(), &stimulus, Unknowns::Normal).unwrap()[0].position.powi(2);
            }
            let (error, bound, expected) = (error.sqrt(), bound.sqrt(), expected.sqrt());
            assert!((0.9..1.1).contains(&(error / bound)), "{force} N: {error} is not {bound}");
            assert!(
                (0.85..1.2).contains(&(expected / bound)),
                "{force} N: {expected} is said, {bound} is true"
            );
        }
    }

    #[test]
    fn a_weak_contact_is_answered_by_its_mean() {
        // The strongest taxel stands 4 noise deviations out at best.
        let (inverter, model) = inverter(20.0, |_| ());
        let mut random = random(2);
        let (mut error, mut said, mut bound) = (0.0, 0.0, 0.0);
        for _ in 0..400 {
            let truth = press(random.random_range(-0.017..0.017), random.random_range(-0.017..0.017), 0.012);
            let stimulus = Stimulus { contacts: vec![truth.clone()], ..Stimulus::default() };
            let solution = inverter.solve(&model.read(&stimulus.contacts, &mut random), None).unwrap();
            error += (solution.contacts[0].position - truth.position).norm_squared();
            said += solution.contacts[0].deviation().powi(2);
            let unbiased = cramer_rao(model.as_ref(), &stimulus, Unknowns::Normal).unwrap();
            bound += unbiased[0].position.powi(2);
        }
        let (error, said, bound) = (error.sqrt(), said.sqrt(), bound.sqrt());
        assert!(error < bound, "knowing the surface helps: {error}, unbiased {bound}");
        assert!((0.7..1.4).contains(&(said / error)), "{said} is said, {error} is true");
    }

    #[test]
    fn pairs_are_found_among_all_pairs() {
        let (inverter, model) = inverter(1e-3, |s| s.contacts = 3);
        let mut random = random(8);
        for _ in 0..20 {
            let mut at = || random.random_range(-0.014..0.014);
            let (a, b) = (press(at(), at(), 1.0), press(at(), at(), 0.7));
            if (a.position - b.position).norm() < 0.008 {
                continue;
            }
            let truth = [a, b];
            let readings = model.read(&truth, &mut random);
            let found = inverter.search(&readings).unwrap().contacts;
            assert_eq!(found.len(), 2, "{truth:?} {found:?}");
            for t in &truth {
                let nearest = found.iter().map(|f| (f.position - t.position).norm()).fold(1.0, f64::min);
                assert!(nearest < 5e-4, "{truth:?} {found:?}");
            }
        }
        let single = inverter.search(&model.read(&[press(0.003, 0.004, 0.8)], &mut random)).unwrap();
        assert_eq!(single.contacts.len(), 1);
        assert!(inverter.search(&[Reading::Exact(0.0)]).is_err());
    }

    #[test]
    fn a_model_that_reads_something_untouched_finds_the_same_contacts() {
        let settings = Settings { contacts: 2, ..Settings::new(0.004, 2.0) };
        let plain = Inverter::new(Arc::new(Toy::grid(20.0)), settings.clone()).unwrap();
        let shifted = Inverter::new(Arc::new(Shifted(Toy::grid(20.0), 3e4)), settings).unwrap();
        // What a skin publishes: readings minus untouched ones.
        let truth = [press(0.007, 0.005, 1.0), press(-0.008, -0.006, 0.7)];
        let readings = Toy::grid(20.0).read(&truth, &mut random(14));
        let light = Toy::grid(20.0).read(&[press(0.003, 0.001, 0.012)], &mut random(15));
        let same = |of: &dyn Fn(&Inverter) -> Solution| {
            let (a, b) = (of(&plain), of(&shifted));
            assert_eq!(a.contacts.len(), b.contacts.len());
            assert!(!a.contacts.is_empty());
            for (a, b) in a.contacts.iter().zip(&b.contacts) {
                // Both end where a step gains less than 1e-4 of a unit of chi².
                assert!((a.position - b.position).norm() < 0.02 * a.deviation(), "{a:?} {b:?}");
                assert!((a.force - b.force).norm() < 1e-3 * a.force.norm(), "{a:?} {b:?}");
            }
        };
        same(&|inverter| inverter.solve(&readings, None).unwrap());
        same(&|inverter| inverter.search(&readings).unwrap());
        same(&|inverter| inverter.refine(&readings, &truth).unwrap());
        same(&|inverter| inverter.solve(&light, None).unwrap());
        let (a, b) = (plain.evidence(&light), shifted.evidence(&light));
        assert!((a.0 - b.0).abs() < 1e-3 * a.0 && (a.1 - b.1).abs() < 1e-3 * a.1, "{a:?} {b:?}");
        let mut signal = vec![f64::NAN; 25];
        shifted.signal(&[], &mut signal).unwrap();
        assert_eq!(signal, [0.0; 25]);
    }

    #[test]
    fn contacts_that_last_are_followed() {
        let (inverter, model) = inverter(1e-3, |s| s.contacts = 2);
        let mut random = random(11);
        let at = |share: f64| [press(0.007, 0.005, 1.0 + share), press(-0.008 + 0.002 * share, -0.006, 0.7)];
        let mut before = inverter.search(&model.read(&at(0.0), &mut random)).unwrap().contacts;
        let mut followed = 0;
        for k in 1..=50 {
            let truth = at(f64::from(k) / 50.0);
            let readings = model.read(&truth, &mut random);
            let answer = inverter.follow(&readings, &before).unwrap();
            followed += usize::from(answer.is_some());
            before = answer.unwrap_or_else(|| inverter.search(&readings).unwrap()).contacts;
            for t in &truth {
                let nearest = before.iter().map(|f| (f.position - t.position).norm()).fold(1.0, f64::min);
                assert!(nearest < 5e-4, "{k}: {before:?}");
            }
        }
        assert!(followed >= 40, "{followed} of 50 frames");
        // One of them ends, a third begins, all end: what was there before is no answer.
        let one = model.read(&at(1.0)[..1], &mut random);
        assert_eq!(inverter.follow(&one, &before).unwrap(), None);
        let mut third = at(1.0).to_vec();
        third.push(press(0.012, -0.012, 0.8));
        assert_eq!(inverter.follow(&model.read(&third, &mut random), &before).unwrap(), None);
        assert_eq!(inverter.follow(&model.read(&[], &mut random), &before).unwrap(), None);
        assert_eq!(inverter.follow(&one, &[]).unwrap(), None);
        assert!(inverter.follow(&one[1..], &before).is_err());
    }

    #[test]
    fn light_presses_are_undetectable_and_strong_ones_are_not() {
        let (inverter, _) = inverter(20.0, |_| ());
        assert!(inverter.unfelt(1e-4, 30.0) > 0.99 && inverter.unfelt(2.0, 30.0) < 0.01);
        let some = inverter.unfelt(0.03, 30.0);
        assert!((0.01..0.99).contains(&some), "{some}");
    }

    #[test]
    fn several_contacts_are_told_apart() {
        let (inverter, model) = inverter(20.0, |s| s.contacts = 3);
        let mut random = random(3);
        let (mut right, tries) = (0, 150);
        for k in 0..tries {
            let count = 1 + k % 3;
            let mut truth: Vec<Indentation> = Vec::new();
            while truth.len() < count {
                let p = press(
                    random.random_range(-0.015..0.015),
                    random.random_range(-0.015..0.015),
                    random.random_range(0.3..1.5),
                );
                if truth.iter().all(|t| (t.position - p.position).norm() > 0.011) {
                    truth.push(p);
                }
            }
            let solution = inverter.solve(&model.read(&truth, &mut random), None).unwrap();
            let near =
                |t: &Indentation| solution.contacts.iter().any(|f| (f.position - t.position).norm() < 0.001);
            right += usize::from(solution.contacts.len() == count && truth.iter().all(near));
        }
        assert!(right * 100 >= tries * 95, "{right} of {tries}");
    }

    #[test]
    fn noise_makes_no_second_contact() {
        let (inverter, model) = inverter(20.0, |s| s.contacts = 3);
        let mut random = random(4);
        for _ in 0..200 {
            let truth = [press(random.random_range(-0.017..0.017), random.random_range(-0.017..0.017), 1.0)];
            assert_eq!(inverter.solve(&model.read(&truth, &mut random), None).unwrap().contacts.len(), 1);
        }
    }

    #[test]
    fn shear_is_found_where_it_is_looked_for() {
        let (inverter, model) = inverter(20.0, |s| s.unknowns = Unknowns::Full);
        let mut truth = press(0.003, -0.002, 1.0);
        truth.force = Vector3::new(0.3, -0.2, -1.0);
        let found = inverter.solve(&model.read(std::slice::from_ref(&truth), &mut random(5)), None).unwrap();
        let found = &found.contacts[0];
        let sigma = found.force_covariance.diagonal().map(f64::sqrt);
        for k in 0..3 {
            assert!((found.force[k] - truth.force[k]).abs() < 5.0 * sigma[k] && sigma[k] < 0.05, "{found:?}");
        }
        assert!((found.position - truth.position).norm() < 5.0 * found.deviation());
    }

    #[test]
    fn channels_at_the_end_of_their_range_and_missing_ones_are_no_lies() {
        let (inverter, model) = inverter(20.0, |_| ());
        let truth = press(0.0005, 0.001, 1.2);
        let mut readings = model.read(std::slice::from_ref(&truth), &mut random(6));
        // The one below the press is cut off at 3 kPa, two neighbours are gone.
        readings[12] = Reading::AtLeast(3000.0);
        readings[11] = Reading::Missing;
        readings[18] = Reading::Exact(f64::NAN);
        let solution = inverter.solve(&readings, None).unwrap();
        assert!(
            (solution.contacts[0].position - truth.position).norm() < 5.0 * solution.contacts[0].deviation()
        );
        assert_eq!(solution.freedom, 20);
        let missing = vec![Reading::Missing; 25];
        assert!(inverter.solve(&missing, None).unwrap().contacts.is_empty());
        insta::assert_snapshot!(inverter.solve(&missing[1..], None).unwrap_err(), @"24 readings where the model has 25 channels");
    }

    #[test]
    fn what_cannot_be_is_refused() {
        let refused = |change: fn(&mut Settings)| {
            let mut settings = Settings::new(0.004, 2.0);
            change(&mut settings);
            Inverter::new(Arc::new(Toy::grid(20.0)), settings).unwrap_err().to_string()
        };
        insta::assert_snapshot!(refused(|s| s.contacts = 0), @"`contacts` is 0 and must be 1 to 10");
        insta::assert_snapshot!(refused(|s| s.force_max = f64::NAN), @"`force_max` is NaN and must be a positive number");
        insta::assert_snapshot!(refused(|s| s.gains = vec![1.0; 3]), @"`gains` is 3 long and must be one number for each of 25 channels");
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn every_reading_has_an_answer_on_the_surface(
            values in proptest::collection::vec(-1e5..1e5f64, 25), kinds in proptest::collection::vec(0..4u8, 25),
        ) {
            let (inverter, model) = inverter(20.0, |s| s.contacts = 2);
            let readings: Vec<Reading> = values.iter().zip(&kinds).map(|(v, k)| match k {
                0 => Reading::AtLeast(*v),
                1 => Reading::AtMost(*v),
                2 => Reading::Missing,
                _ => Reading::Exact(*v),
            }).collect();
            for found in inverter.solve(&readings, None).unwrap().contacts {
                prop_assert!(model.surface().distance(&found.position) < 1e-9);
                prop_assert!(found.normal_force() > 0.0 && found.normal_force() <= 3.0 + 1e-9);
            }
        }
    }
}
