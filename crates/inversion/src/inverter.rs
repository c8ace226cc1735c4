//! The search for contacts.

use std::sync::Arc;

use dermis_skin::{ForwardModel, Indentation, ModelError, Stimulus};
use nalgebra::{DMatrix, Matrix3, Point3, Vector3};
use serde::{Deserialize, Serialize};

use crate::dictionary::Dictionary;
use crate::fit::{Datum, Minimum, Problem, tangents};

/// What is looked for in a contact.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Unknowns {
    /// Its place along the first direction of the surface (x on a flat one) and how hard it presses: taxels in a row.
    Line,
    /// Its place on the surface and how hard it presses; it is taken to press along the normal.
    #[default]
    Normal,
    /// Its place and all three components of its force.
    Full,
}

impl Unknowns {
    fn count(self) -> usize {
        match self {
            Self::Line => 2,
            Self::Normal => 3,
            Self::Full => 5,
        }
    }
}

/// What an [`Inverter`] is told besides the model.
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
    /// \[m\] that contacts are apart at least.
    #[serde(default = "apart")]
    pub distance: f64,
}

fn one() -> usize {
    1
}

fn evidence() -> f64 {
    30.0
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
            distance: apart(),
        }
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
/// Starts of a further contact that are tried.
const STARTS: usize = 2;
/// \[m\] by which a contact is split in two, to both sides.
const SPLIT: f64 = 3e-3;
/// Places of a dictionary at most, roughly.
const PLACES: f64 = 1500.0;

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
    rest: Vec<f64>,
    spacing: f64,
    dictionary: Dictionary,
}

struct ModelBox(Arc<dyn ForwardModel>);

impl std::fmt::Debug for ModelBox {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("ForwardModel").field("channels", &self.0.channels()).finish_non_exhaustive()
    }
}

impl Inverter {
    /// An inverter for one skin; asks the model some thousand times.
    ///
    /// # Errors
    ///
    /// [`InverterError::Setting`] names what cannot be; [`InverterError::Model`] where the model has no answer.
    pub fn new(model: Arc<dyn ForwardModel>, settings: Settings) -> Result<Self, InverterError> {
        let wrong = |field, value: String, expected: &str| {
            Err(InverterError::Setting { field, value, expected: expected.into() })
        };
        let s = &settings;
        if !(1..=10).contains(&s.contacts) {
            return wrong("contacts", s.contacts.to_string(), "1 to 10");
        }
        for (field, value) in [("diameter", s.diameter), ("force_max", s.force_max), ("evidence", s.evidence)] {
            if !(value.is_finite() && value > 0.0) {
                return wrong(field, value.to_string(), "a positive number");
            }
        }
        for (field, value) in [("model_error", s.model_error), ("distance", s.distance)] {
            if !(value.is_finite() && value >= 0.0) {
                return wrong(field, value.to_string(), "0 or positive");
            }
        }
        let channels = model.channels();
        let gains = if s.gains.is_empty() { vec![1.0; channels] } else { s.gains.clone() };
        if gains.len() != channels {
            let expected = format!("one number for each of {channels} channels");
            return Err(InverterError::Setting { field: "gains", value: format!("{} long", gains.len()), expected });
        }
        if let Some(gain) = gains.iter().find(|g| !g.is_finite()) {
            return wrong("gains", gain.to_string(), "finite");
        }
        let mut rest = vec![0.0; channels];
        model.response(&Stimulus::default(), &mut rest)?;
        let area: f64 = model.surface().areas.iter().sum();
        // Fine enough to begin at; a row of taxels has a length more than an area.
        let longest = model.surface().points.iter().map(|p| p.coords.amax()).fold(0.0, f64::max);
        let spacing = (area / PLACES).sqrt().max(longest / PLACES).max(5e-4);
        let dictionary = Dictionary::new(model.as_ref(), spacing, s.diameter, s.force_max)?;
        Ok(Self { model: ModelBox(model), settings, gains, rest, spacing, dictionary })
    }

    /// What it was told.
    #[must_use]
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// The contacts that explain `readings` best. `hint` is a contact to begin at besides what is found here: what a
    /// learned model says, or the frame before.
    ///
    /// # Errors
    ///
    /// [`InverterError::Channels`] for readings of another skin.
    pub fn solve(&self, readings: &[Reading], hint: Option<&Indentation>) -> Result<Solution, InverterError> {
        let channels = self.gains.len();
        if readings.len() != channels {
            return Err(InverterError::Channels { found: readings.len(), expected: channels });
        }
        let data = self.data(readings);
        let problem = Problem {
            model: self.model.0.as_ref(),
            unknowns: self.settings.unknowns,
            data: &data,
            gains: &self.gains,
            rest: &self.rest,
            force_max: self.settings.force_max * 1.5,
        };
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
            let starts = self.starts(&data, &best, hint.filter(|_| best.contacts.is_empty()));
            let mut found: Option<Minimum> = None;
            for start in starts {
                let minimum = problem.minimise(start, 0)?;
                if found.as_ref().is_none_or(|f| minimum.chi2 < f.chi2) {
                    found = Some(minimum);
                }
            }
            let Some(found) = found else { break };
            let first = best.contacts.is_empty();
            // The first contact is there because the caller asks; a further one has to prove itself.
            if !first && (best.chi2 - found.chi2 < self.settings.evidence || !self.apart(&found)) {
                break;
            }
            best = found;
        }
        let mut contacts = self.describe(&best, &data);
        if let [single] = contacts.as_mut_slice()
            && !(single.deviation() < BROAD * self.spacing)
        {
            *single = self.mean(&data, single);
        }
        contacts.sort_by(|a, b| b.normal_force().total_cmp(&a.normal_force()));
        let freedom = counted.saturating_sub(per_contact * contacts.len());
        Ok(Solution { contacts, chi2: best.chi2, freedom })
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
    fn starts(&self, data: &[Datum], best: &Minimum, hint: Option<&Indentation>) -> Vec<Vec<Indentation>> {
        let left: Vec<(f32, f32)> = data
            .iter()
            .zip(&best.signal)
            .map(|(datum, signal)| match *datum {
                Datum::Exact(v, w) => (((v - signal) * w) as f32, w as f32),
                Datum::AtLeast(v, w) => (((v - signal).max(0.0) * w) as f32, w as f32),
                Datum::AtMost(v, w) => (((v - signal).min(0.0) * w) as f32, w as f32),
                Datum::None => (0.0, 0.0),
            })
            .collect();
        let with = |contact: Indentation| {
            let mut all = best.contacts.clone();
            all.push(contact);
            all
        };
        let mut starts: Vec<Vec<Indentation>> = hint.map(|h| with(h.clone())).into_iter().collect();
        starts.extend(self.matches(&left, STARTS).into_iter().map(with));
        // Two contacts that stand close look like one between them.
        if let Some((last, others)) = best.contacts.split_last() {
            let (place, normal) = self.model.0.surface().project(&last.position);
            let directions = if self.settings.unknowns == Unknowns::Line { 1 } else { 2 };
            for along in &tangents(&normal)[..directions] {
                let half = |by: f64| {
                    let (position, normal) = self.model.0.surface().project(&(place + along * by));
                    Indentation { position, force: -normal * (last.force.norm() / 2.0), ..last.clone() }
                };
                starts.push(others.iter().cloned().chain([half(SPLIT), half(-SPLIT)]).collect());
            }
        }
        starts
    }

    /// Contacts of the dictionary that explain whitened residuals best, no two of them near to each other.
    fn matches(&self, left: &[(f32, f32)], most: usize) -> Vec<Indentation> {
        let gains: Vec<f32> = self.gains.iter().map(|g| *g as f32).collect();
        let levels = self.dictionary.forces.len();
        let mut scores: Vec<(f32, usize, f64)> = Vec::with_capacity(self.dictionary.places.len());
        for place in 0..self.dictionary.places.len() {
            let mut top = (0.0f32, 0.0f64);
            for level in 0..levels {
                let (mut dot, mut square) = (0.0f32, 0.0f32);
                for ((value, gain), (residual, weight)) in
                    self.dictionary.response(place, level).iter().zip(&gains).zip(left)
                {
                    let v = value * gain * weight;
                    dot += v * residual;
                    square += v * v;
                }
                if dot > 0.0 && square > 0.0 {
                    let score = dot * dot / square;
                    if score > top.0 {
                        top = (score, f64::from(dot / square) * self.dictionary.forces[level]);
                    }
                }
            }
            scores.push((top.0, place, top.1));
        }
        scores.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut chosen: Vec<Indentation> = Vec::new();
        for (_, place, force) in scores {
            let place = &self.dictionary.places[place];
            if chosen.len() == most {
                break;
            }
            if chosen.iter().any(|c| (c.position - place.position).norm() < 3.0 * self.spacing) {
                continue;
            }
            chosen.push(Indentation {
                position: place.position,
                force: -place.normal * force.clamp(1e-3, self.settings.force_max),
                diameter: self.settings.diameter,
            });
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
                for ((value, gain), datum) in response.iter().zip(&self.gains).zip(data) {
                    let Datum::Exact(reading, weight) = *datum else { continue };
                    let v = f64::from(*value) * gain * weight / force;
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
        let pressing = force / total;
        let variance = (force_square / total - pressing * pressing).max(0.0);
        Found {
            position,
            normal,
            force: -normal * pressing,
            position_covariance: second / total - mean * mean.transpose(),
            force_covariance: normal * normal.transpose() * variance,
        }
    }
}

/// Covariances of place and force in the frame of the link from those of the unknowns; unknown where `block` is.
fn covariances(
    unknowns: Unknowns,
    normal: &Vector3<f64>,
    block: Option<&DMatrix<f64>>,
) -> (Matrix3<f64>, Matrix3<f64>) {
    let Some(block) = block else {
        return (Matrix3::from_diagonal_element(f64::INFINITY), Matrix3::from_diagonal_element(f64::INFINITY));
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
