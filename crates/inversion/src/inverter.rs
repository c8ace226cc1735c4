//! The search for contacts.
//!
//! Problem: which contacts, one or several, made these readings? Method: maximum likelihood on a forward model. The search is greedy
//! in the number of contacts (orthogonal matching pursuit, S. G. Mallat and Z. Zhang, *IEEE Trans. Signal Process.* 41 (1993) 3397);
//! each number is refined by least squares over all unknowns ([`Problem`]). A further contact must lower the sum of squared
//! deviations by more than [`Settings::evidence`]. Assumptions: Gaussian noise that is independent from channel to channel, straight
//! presses of one tip as starts, and a device that is like its model but for gains and a relative error. Cost: one product with a
//! dictionary of some 1,500 locations for each further contact, and some tens of responses and Jacobians for each start.

mod describe;
mod misfit;
mod modes;
mod nearby;
mod pursuit;
mod search;
mod starts;
#[cfg(test)]
mod tests;

use std::sync::Arc;

use dermis_model::{ForwardModel, Indentation, Unknowns, Untouched};
use dermis_skin::Surface;

use crate::contact::{ContactEstimate, Reading, Solution};
use crate::dictionary::{Dictionary, SHAPE};
use crate::fit::{Datum, LEAST_GAIN, Minimum, Problem, STRIDE};
use crate::pairs::Pairs;
use crate::settings::{InverterError, Search, Settings};
use modes::Mode;
use nearby::ROUGH_GAIN;
use starts::Start;

/// A weak contact whose place is known no better than this many spacings of the dictionary is answered by the mean over
/// all locations that it may have.
const BROAD: f64 = 0.8;
/// Spacings of the dictionary below which a place is known in a direction.
const NARROW: f64 = 0.3;
/// Deviations of its expectation up to which a sum of squared deviations is what noise leaves.
const PLAUSIBLE: f64 = 2.0;
/// Share of readings' squares that one place explains from which on they show a contact, where each place has a pattern of its own: of five
/// contacts alike each explains nearly a fifth, and of what changes all of the readings at once a place explains some hundredths.
const CLEAR: f64 = 0.1;
/// What a step gains at the least in a search near what is known: it leaves a tenth of the noise's own deviation.
const NEAR_GAIN: f64 = 1e-2;
/// Spacings of the dictionary that a contact moves in one step, where that is more than [`STRIDE`].
const STEP: f64 = 0.75;
/// Locations of a dictionary at most, roughly.
const LOCATIONS: f64 = 1500.0;

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
    /// \[m²\] variance of a place that is anywhere on the surface, along each direction of it.
    anywhere: f64,
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
        let spacing = (area / LOCATIONS).sqrt().max(longest / LOCATIONS).max(5e-4);
        let points = &model.surface().points;
        let middle = points.iter().map(|p| p.y).sum::<f64>() / points.len().max(1) as f64;
        let line = (s.unknowns == Unknowns::Line).then_some(middle);
        let dictionary = Dictionary::new(model.as_ref(), (line, s.region), spacing, s, &gains)?;
        let pairs = Pairs::new(&dictionary, spacing);
        let anywhere = dictionary.variance().max(spacing * spacing);
        Ok(Self {
            model: ModelBox(model),
            settings,
            gains,
            untouched,
            spacing,
            line,
            dictionary,
            pairs,
            anywhere,
        })
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
        let data = self.data(readings);
        let problem = self.problem(&data);
        let counted = counted(&data);
        let mut best = Minimum::untouched(&data);
        let mut fewer: Vec<Minimum> = Vec::new();
        let per_contact = self.settings.unknowns.count();
        let mut modes: Vec<Mode> = Vec::new();
        while best.contacts.len() < self.settings.contacts {
            let after = (best.contacts.len() + 1) * per_contact;
            // What noise alone leaves cannot be explained any better.
            let left = best.chi2 - counted.saturating_sub(after) as f64;
            if after > counted || left < self.settings.evidence && !best.contacts.is_empty() {
                break;
            }
            let freedom = counted.saturating_sub(after);
            let mut found: Option<Minimum> = None;
            if best.contacts.is_empty() {
                modes = self.modes(&problem, &data, hint)?;
                found = modes.first().map(|mode| mode.minimum.clone());
            } else {
                for kind in [Start::Dictionary, Start::Split] {
                    // What is left is noise: no other start finds anything better.
                    let enough = |f: &Minimum| f.chi2 < plausible(freedom);
                    if found.as_ref().is_some_and(enough) {
                        break;
                    }
                    for start in self.starts(kind, &data, &best) {
                        let minimum = problem.minimise(start)?;
                        if found.as_ref().is_none_or(|f| self.score(&minimum) < self.score(f)) {
                            found = Some(minimum);
                        }
                    }
                }
            }
            let Some(found) = found else { break };
            let first = best.contacts.is_empty();
            // The caller knows that there is a contact; each further one must lower the deviations enough.
            if !first && (best.chi2 - found.chi2 < self.settings.evidence || !self.apart(&found)) {
                break;
            }
            fewer.push(std::mem::replace(&mut best, found));
        }
        Ok(self.among(&self.worth(best, fewer, &data), &modes, &data))
    }

    /// How surely readings show a contact at all: by how much the best single one of the dictionary lowers the sum of
    /// squared deviations, and what it leaves per reading. A matched filter, that finds contacts which no channel shows by
    /// itself; drift, which has another pattern, leaves more than noise does. So does a strong contact with shear or between locations of the
    /// dictionary: where each place has a pattern of its own ([`Search::Near`]), nothing counts as left as soon as a place explains
    /// a tenth of the whole. (0, 0) for readings of another skin.
    #[must_use]
    pub fn evidence(&self, readings: &[Reading]) -> (f64, f64) {
        if readings.len() != self.gains.len() {
            return (0.0, 0.0);
        }
        let data = self.data(readings);
        let left = residuals(&data, &vec![0.0; data.len()]);
        let whole: f64 = left.iter().map(|r| f64::from(*r).powi(2)).sum();
        let counted = counted(&data);
        let freedom = counted.saturating_sub(self.settings.unknowns.count());
        // Nothing can be gained that is not there.
        if whole < self.settings.evidence || freedom == 0 {
            return (0.0, whole / counted.max(1) as f64);
        }
        let best = f64::from(self.dictionary.clearest(&left)).powi(2);
        if self.settings.search == Search::Near && best > CLEAR * whole {
            return (best, 0.0);
        }
        (best, (whole - best) / freedom as f64)
    }

    /// What can be had while a search takes its time: contacts near `starts`, or one near the place of the dictionary that explains `readings` best
    /// where there are none, moved to where they explain them better. Where responses are dear ([`Search::Near`]), they come to about a
    /// deviation of the noise from there.
    ///
    /// # Errors
    ///
    /// [`InverterError::Channels`] for readings of another skin.
    pub fn guess(&self, readings: &[Reading], starts: &[Indentation]) -> Result<Solution, InverterError> {
        self.check(readings)?;
        let data = self.data(readings);
        let mut starts = starts.to_vec();
        if starts.is_empty() {
            starts = self.matches(&data, &Minimum::untouched(&data).signal, 1, 1.0);
        }
        if starts.is_empty() {
            return Ok(self.solution(&Minimum::untouched(&data), &data));
        }
        let mut problem = self.problem(&data);
        if self.settings.search == Search::Near {
            problem.least_gain = ROUGH_GAIN;
        }
        Ok(self.solution(&self.refined(&problem, &data, starts)?, &data))
    }

    /// Whether a contact's place is all but open: in every direction of the surface. Where it is open in one only, least squares know
    /// more than the dictionary, whose pitch is coarse for the others.
    fn is_broad(&self, found: &ContactEstimate) -> bool {
        let deviation = found.deviation();
        let narrowest = || {
            let mut along = found.position_covariance.symmetric_eigenvalues();
            along.as_mut_slice().sort_by(f64::total_cmp);
            // Nothing varies along the normal; along a line nothing does across it.
            let least = if self.line.is_some() { along[2] } else { along[1] };
            least.max(0.0).sqrt()
        };
        // What the readings do not fix at all has no eigenvalues.
        !deviation.is_finite() || deviation >= BROAD * self.spacing && narrowest() >= NARROW * self.spacing
    }

    /// Share of the surface where a press of `force` \[N\] lowers the sum of squared deviations by less than `evidence`, in
    /// units of the noise: where it cannot be detected.
    #[must_use]
    pub fn undetectable_fraction(&self, force: f64, evidence: f64) -> f64 {
        let unit = self.dictionary.forces[SHAPE];
        let (mut all, mut undetectable) = (0.0, 0.0);
        for (index, location) in self.dictionary.locations.iter().enumerate() {
            let response = self.dictionary.response(index, SHAPE).iter().zip(self.noise());
            let square: f64 = response.map(|(v, n)| (f64::from(*v) / n * force / unit).powi(2)).sum();
            all += location.area;
            if square < evidence {
                undetectable += location.area;
            }
        }
        if all > 0.0 { undetectable / all } else { 0.0 }
    }

    /// How unlikely a minimum is, to be compared between minima of as many contacts.
    fn score(&self, minimum: &Minimum) -> f64 {
        minimum.chi2 + self.settings.force_prior.penalty(&minimum.contacts)
    }

    pub(crate) fn check(&self, readings: &[Reading]) -> Result<(), InverterError> {
        let channels = self.gains.len();
        if readings.len() == channels {
            return Ok(());
        }
        Err(InverterError::Channels { found: readings.len(), expected: channels })
    }

    pub(crate) fn problem<'a>(&'a self, data: &'a [Datum]) -> Problem<'a> {
        Problem {
            model: self.model.0.as_ref(),
            unknowns: self.settings.unknowns,
            data,
            gains: &self.gains,
            untouched: &self.untouched,
            force_max: self.settings.force_max * 1.5,
            stride: self.stride(),
            shear: self.settings.shear,
            keeps: self.settings.search == Search::Near,
            least_gain: if self.settings.search == Search::Near { NEAR_GAIN } else { LEAST_GAIN },
            by_differences: false,
        }
    }

    /// \[m\] farthest that a contact moves in one step, and is split by. On a panel half a metre wide, searches that took steps of
    /// [`STRIDE`] ended before they came to the minimum; steps of half to twice the spacing end in the same ones.
    fn stride(&self) -> f64 {
        STRIDE.max(STEP * self.spacing)
    }

    pub(crate) fn solution(&self, best: &Minimum, data: &[Datum]) -> Solution {
        let counted = counted(data);
        let mut contacts = self.describe(best, data);
        if let [single] = contacts.as_mut_slice()
            && self.is_broad(single)
        {
            *single = self.mean(data, single, self.excess(best, data));
        }
        contacts.iter_mut().for_each(|contact| self.bound(contact));
        contacts.sort_by(|a, b| b.normal_force().total_cmp(&a.normal_force()));
        let freedom = counted.saturating_sub(self.settings.unknowns.count() * contacts.len());
        let misfit = self.misfit(best, data);
        Solution { contacts, minima: Vec::new(), chi2: best.chi2, freedom, misfit }
    }

    /// By how much larger the squares of all errors are than noise makes them, as what the `best` minimum of as many contacts leaves says; 1
    /// where noise explains it.
    ///
    /// A device that differs from its model leaves many times what noise does. Taken for noise, that rules out all but one location (the
    /// variance factor of weighted least squares: Å. Björck, *Numerical Methods for Least Squares Problems*, 1996, §1.1).
    fn excess(&self, best: &Minimum, data: &[Datum]) -> f64 {
        let freedom = counted(data).saturating_sub(self.settings.unknowns.count() * best.contacts.len());
        if freedom > 0 && best.chi2 > plausible(freedom) { best.chi2 / freedom as f64 } else { 1.0 }
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

    pub(crate) fn data(&self, readings: &[Reading]) -> Vec<Datum> {
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

    /// Contacts that are looked for: no more than the readings can tell.
    pub(crate) fn most(&self, data: &[Datum]) -> usize {
        self.settings.contacts.min(counted(data) / self.settings.unknowns.count())
    }

    pub(crate) fn apart(&self, minimum: &Minimum) -> bool {
        minimum.contacts.iter().enumerate().all(|(i, a)| {
            minimum.contacts[..i].iter().all(|b| (a.position - b.position).norm() >= self.settings.distance)
        })
    }
}

/// Readings that count.
pub(crate) fn counted(data: &[Datum]) -> usize {
    data.iter().filter(|d| **d != Datum::None).count()
}

/// Up to where a sum of squared deviations with so many degrees of freedom is what noise leaves.
pub(crate) fn plausible(freedom: usize) -> f64 {
    within(freedom, PLAUSIBLE)
}

/// So many deviations beyond what noise leaves of a sum of squared deviations with so many degrees of freedom.
fn within(freedom: usize, deviations: f64) -> f64 {
    freedom as f64 + deviations * (2.0 * freedom as f64).sqrt()
}

/// What a model signal leaves of data, in units of their noise.
pub(crate) fn residuals(data: &[Datum], signal: &[f64]) -> Vec<f32> {
    let left = |(datum, signal): (&Datum, &f64)| match *datum {
        Datum::Exact(v, w) => (v - signal) * w,
        Datum::AtLeast(v, w) => (v - signal).max(0.0) * w,
        Datum::AtMost(v, w) => (v - signal).min(0.0) * w,
        Datum::None => 0.0,
    };
    data.iter().zip(signal).map(|pair| left(pair) as f32).collect()
}
