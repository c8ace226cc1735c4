//! The Cramér–Rao bound of the contacts of a data set, beside the errors of an estimator on the very same contacts.
//!
//! Problem: by how much does an estimator err more than it must? Method: the bound of every frame by the forward model, with the
//! channels that were within their range; then, frame by frame, error over bound. [`Bounds`] sums up the bounds alone,
//! [`AgainstBound`] errors and bounds of the same contacts: ratio of the root mean squares, and median of the ratios of single
//! frames. The first is ruled by the few frames that the bound is large on, the second by most frames. An estimator that reaches the
//! bound with Gaussian errors has a ratio of 1 in the root mean squares; in the median of the ratios it has 0.67 of one number
//! (a force, a place on a line), and 0.83 of a place on a surface whose two directions are alike. Frames of one, two, three … contacts
//! are kept apart, for each has a bound of its own. Assumptions: those of the bound (no bias, no prior knowledge: it may exceed the
//! skin). Cost: a Jacobian of the model for each of at most [`MOST`] frames.

use std::collections::{BTreeMap, BTreeSet};

use dermis_model::{ForwardModel, Indentation, Stimulus, Unknowns, WithNoise};
use dermis_skin::ForceComponents;
use dermis_theory::{ContactBound, TheoryError, cramer_rao};
use serde::{Deserialize, Serialize};

use crate::dataset::{Dataset, SampleId, Truth};
use crate::metrics::{Bin, ContactError, bin_in, bins, median};

mod shown;
mod undetermined;

pub use undetermined::{Uncounted, UncountedBin, Undetermined};

/// Frames that are bounded at most; of more, every n-th is taken.
pub const MOST: usize = 6000;

/// Touched frames that have no bound, and why.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct Unbounded {
    /// All touched frames.
    pub touched: usize,
    /// Only every n-th frame is bounded.
    pub thinned: usize,
    /// Place, force or tip of a contact is not known.
    pub unknown: usize,
    /// The model cannot answer: what pulls at the skin, e.g. by the noise of a force sensor.
    pub refused: usize,
    /// The channels do not determine the contact: the bound is infinite.
    pub undetermined: usize,
}

/// Bounds of the frames of a data set, one for each true contact.
#[derive(Debug, Clone, Default)]
pub struct FrameBounds {
    frames: BTreeMap<SampleId, Vec<(f64, ContactBound)>>,
    /// What has none.
    pub left_out: Unbounded,
}

/// What an estimator without bias that sees one frame at a time reaches at best on the contacts of a data set: root mean
/// squares and medians by true normal force, of the same bins as the errors. Of frames of one contact, if not said otherwise.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Bounds {
    /// Touched frames of one contact that were bounded.
    pub samples: usize,
    /// \[m\] of the position.
    pub position: Vec<Bin>,
    /// \[N\] of the normal force.
    pub normal_force: Vec<Bin>,
    /// Of frames of several contacts, by their number; empty in files of before they were kept apart.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub several: BTreeMap<usize, OfSeveral>,
    /// Frames without a bound.
    #[serde(default)]
    pub left_out: Unbounded,
}

/// Bounds of frames of several contacts.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OfSeveral {
    /// Contacts that were bounded.
    pub samples: usize,
    /// \[m\] of the position.
    pub position: Vec<Bin>,
    /// \[N\] of the normal force.
    pub normal_force: Vec<Bin>,
}

/// Errors and bounds of the very same contacts.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AgainstBound {
    /// True contacts of the frames.
    pub contacts: usize,
    /// `position`, `force.normal` or, of one contact whose shear is looked for, `force` (length of the difference) and `angle` (between both
    /// forces of contacts that were found; its bound is that of the shear over the pressing force).
    pub quantity: String,
    /// `m`, `N` or `rad`.
    pub unit: String,
    /// Over all forces.
    pub all: Ratio,
    /// By true normal force.
    pub by_force: Vec<RatioBin>,
    /// Of positions, those alone whose bound is below [`WELL_DETERMINED`]; absent where all are, or none. A root mean square over all
    /// locations is that of the few where the channels hardly tell the place.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub well_determined: Option<WellDetermined>,
    /// Contacts that have an error and an infinite bound, and stand in no figure here; absent where there are none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub undetermined: Option<Undetermined>,
}

/// Contacts whose position the channels determine well.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct WellDetermined {
    /// \[m\] that their bound is below.
    pub below: f64,
    /// Over all forces.
    pub all: Ratio,
    /// By true normal force.
    pub by_force: Vec<RatioBin>,
}

/// \[m\] of the bound below which a position counts as well determined: less than a fingertip's contact is wide.
const WELL_DETERMINED: f64 = 3e-3;

/// Errors and bounds of the same contacts in one bin of force.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RatioBin {
    /// \[N\] lower end.
    pub from: f64,
    /// \[N\] upper end, absent for the last bin.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub to: Option<f64>,
    /// The same as one number each.
    #[serde(flatten)]
    pub ratio: Ratio,
}

/// Errors over bounds of the same contacts, in the unit of the quantity.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Ratio {
    /// Contacts.
    pub samples: usize,
    /// Share of these that were not found.
    pub not_found: f64,
    /// Root mean square and median of the error.
    pub error_rms: f64,
    /// Median of the error.
    pub error_median: f64,
    /// Root mean square of the bound.
    pub bound_rms: f64,
    /// Median of the bound.
    pub bound_median: f64,
    /// `error_rms` over `bound_rms`.
    pub ratio_of_rms: f64,
    /// Median of error over bound of single contacts.
    pub median_ratio: f64,
    /// \[m\] root mean square of the error of a position as the estimator states it, of contacts that were found; absent where it does not of
    /// all of these. Where readings fit at several locations nearly as well, it is more than the bound, which knows one: no estimator can be
    /// sure of the right one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stated_rms: Option<f64>,
    /// The same of contacts that were found; absent where all were, or none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub found: Option<Box<Ratio>>,
}

/// One contact beside its bound.
#[derive(Debug, Clone, Copy)]
struct Pair {
    error: f64,
    bound: f64,
    found: bool,
    /// What the estimator states of the error, where it does.
    stated: Option<f64>,
}

impl Ratio {
    fn of(pairs: &[Pair]) -> Option<Self> {
        let count = pairs.len() as f64;
        if pairs.is_empty() {
            return None;
        }
        let rms = |of: fn(&Pair) -> f64| (pairs.iter().map(|p| of(p).powi(2)).sum::<f64>() / count).sqrt();
        let middle = |of: fn(&Pair) -> f64| median(&mut pairs.iter().map(of).collect::<Vec<f64>>());
        let found: Vec<_> = pairs.iter().filter(|p| p.found).copied().collect();
        let (error_rms, bound_rms) = (rms(|p| p.error), rms(|p| p.bound));
        let stated = found.iter().map(|p| p.stated.map(|s| s * s)).sum::<Option<f64>>();
        Some(Self {
            samples: pairs.len(),
            not_found: (pairs.len() - found.len()) as f64 / count,
            error_rms,
            error_median: middle(|p| p.error.abs()),
            bound_rms,
            bound_median: middle(|p| p.bound),
            ratio_of_rms: error_rms / bound_rms,
            median_ratio: middle(|p| p.error.abs() / p.bound),
            stated_rms: stated
                .filter(|_| !found.is_empty())
                .map(|squares| (squares / found.len() as f64).sqrt()),
            found: if found.len() < pairs.len() { Self::of(&found).map(Box::new) } else { None },
        })
    }
}

/// Bounds the touched samples of a data set, or those of `only`, by the forward model of its skin. A channel that was at an end of its
/// range, or had no valid reading, tells nothing of its sample.
///
/// # Errors
///
/// [`TheoryError::Noise`] where the skin names a channel without noise.
pub fn frame_bounds(
    model: &dyn ForwardModel,
    data: &Dataset,
    only: Option<&[SampleId]>,
    unknowns: Unknowns,
) -> Result<FrameBounds, TheoryError> {
    let only: Option<BTreeSet<SampleId>> = only.map(|ids| ids.iter().copied().collect());
    let sampled: Vec<_> = data
        .labelled()
        .filter(|(id, _, truth)| truth.touched() && only.as_ref().is_none_or(|ids| ids.contains(id)))
        .collect();
    let mut found = FrameBounds::default();
    found.left_out.touched = sampled.len();
    let step = dermis_regress::stride(sampled.len(), MOST);
    found.left_out.thinned = sampled.len() - sampled.len().div_ceil(step);
    let mut masked = WithNoise::new(model, model.noise().to_vec());
    for (id, sample, truth) in sampled.into_iter().step_by(step) {
        let Some(stimulus) = stimulus(truth) else {
            found.left_out.unknown += 1;
            continue;
        };
        masked.noise_mut().copy_from_slice(model.noise());
        for (noise, _) in masked.noise_mut().iter_mut().zip(&*sample.flags).filter(|(_, f)| !f.is_ok()) {
            *noise = MASKED_NOISE;
        }
        match cramer_rao(&masked, &stimulus, unknowns) {
            Ok(all) => {
                let finite = all.iter().all(|b| b.position.is_finite() && b.normal_force.is_finite());
                found.left_out.undetermined += usize::from(!finite);
                let force = |c: &Indentation| -c.force.dot(&model.surface().project(&c.position).1);
                let of = stimulus.contacts.iter().zip(all).map(|(c, bound)| (force(c), bound));
                found.frames.insert(id, of.collect());
            }
            // A force sensor's noise pulls at the skin now and then, which the model does not know.
            Err(TheoryError::Model(_)) => found.left_out.refused += 1,
            Err(error) => return Err(error),
        }
    }
    Ok(found)
}

impl FrameBounds {
    /// The bounds alone; `None` where no frame has one: position, force and diameter of every contact are needed. Infinite ones
    /// count, and make the root mean square infinite.
    #[must_use]
    pub fn summary(&self, edges: &[f64]) -> Option<Bounds> {
        let of = |number: usize| {
            let all: Vec<&(f64, ContactBound)> =
                self.frames.values().filter(|all| all.len() == number).flatten().collect();
            let bins = |value: fn(&ContactBound) -> f64| {
                bins(edges, all.iter().map(|(force, bound)| (*force, value(bound))))
            };
            OfSeveral {
                samples: all.len(),
                position: bins(|b| b.position),
                normal_force: bins(|b| b.normal_force),
            }
        };
        let numbers: BTreeSet<usize> = self.frames.values().map(Vec::len).filter(|n| *n > 1).collect();
        let OfSeveral { samples, position, normal_force } = of(1);
        (!self.frames.is_empty()).then(|| Bounds {
            samples,
            position,
            normal_force,
            several: numbers.into_iter().map(|n| (n, of(n))).collect(),
            left_out: self.left_out,
        })
    }

    /// Errors of an estimator beside the bounds of the very same contacts. Those whose bound is infinite are counted for themselves; a
    /// quantity of which every bound is infinite stands in [`Unbounded::undetermined`] alone.
    #[must_use]
    pub fn against(&self, errors: &[ContactError], edges: &[f64]) -> Vec<AgainstBound> {
        type Of = fn(&ContactError, &ContactBound) -> (f64, f64);
        let quantities: [(&str, &str, Of); 4] = [
            ("position", "m", |e, b| (e.position, b.position)),
            ("force.normal", "N", |e, b| (e.normal_force, b.normal_force)),
            ("force", "N", |e, b| (e.vector, b.shear.map_or(f64::NAN, |shear| shear.hypot(b.normal_force)))),
            // To first order, where the shear is small beside what presses.
            ("angle", "rad", |e, b| (e.angle, b.shear.map_or(f64::NAN, |shear| shear / e.force))),
        ];
        let mut pairs: BTreeMap<(usize, usize), Vec<(f64, Pair)>> = BTreeMap::new();
        let mut open: BTreeMap<(usize, usize), Vec<(f64, f64)>> = BTreeMap::new();
        for error in errors {
            let [contact, of] = error.contact;
            let Some(all) = self.frames.get(&error.id).filter(|all| all.len() == of) else { continue };
            for (quantity, (.., value)) in quantities.iter().enumerate() {
                let (value, bound) = value(error, &all[contact].1);
                if value.is_finite() && bound.is_finite() && bound > 0.0 {
                    let stated = error.stated.filter(|_| quantity == 0).map(|s| s.deviation);
                    let pair = Pair { error: value, bound, found: error.found, stated };
                    pairs.entry((of, quantity)).or_default().push((error.force, pair));
                } else if value.is_finite() && bound.is_infinite() {
                    open.entry((of, quantity)).or_default().push((error.force, value));
                }
            }
        }
        let sum_up = |((contacts, quantity), all): ((usize, usize), Vec<(f64, Pair)>)| {
            let (name, unit, _) = quantities[quantity];
            let ratios = |of: &[(f64, Pair)]| {
                let bin = |n: usize| {
                    let inside = of.iter().filter(|(force, _)| bin_in(edges, *force) == Some(n));
                    let ratio = Ratio::of(&inside.map(|p| p.1).collect::<Vec<_>>())?;
                    Some(RatioBin { from: edges[n], to: edges.get(n + 1).copied(), ratio })
                };
                let whole = Ratio::of(&of.iter().map(|p| p.1).collect::<Vec<_>>())?;
                Some((whole, (0..edges.len()).filter_map(bin).collect()))
            };
            let well: Vec<(f64, Pair)> =
                all.iter().filter(|(_, pair)| pair.bound < WELL_DETERMINED).copied().collect();
            let some = name == "position" && well.len() < all.len();
            let well_determined = some.then(|| ratios(&well)).flatten();
            let (whole, by_force) = ratios(&all)?;
            let forces: Vec<f64> = all.iter().map(|(force, _)| *force).collect();
            let undetermined =
                open.get(&(contacts, quantity)).and_then(|open| Undetermined::of(open, &forces, edges));
            Some(AgainstBound {
                contacts,
                quantity: name.to_owned(),
                unit: unit.to_owned(),
                all: whole,
                by_force,
                well_determined: well_determined.map(|(all, by_force)| WellDetermined {
                    below: WELL_DETERMINED,
                    all,
                    by_force,
                }),
                undetermined,
            })
        };
        pairs.into_iter().filter_map(sum_up).collect()
    }
}

/// Noise of a channel that tells nothing, in any unit.
const MASKED_NOISE: f64 = 1e30;

/// What pressed, where the truth is whole.
#[must_use]
pub fn stimulus(truth: &Truth) -> Option<Stimulus> {
    let contacts = truth
        .contacts
        .iter()
        .map(|c| {
            let pressing = -c.normal * c.normal_force()?;
            let full = c.components == ForceComponents::Full && c.force.iter().all(|v| v.is_finite());
            let force = if full { c.force } else { pressing };
            let known = c.position.iter().chain(&force).all(|v| v.is_finite()) && c.diameter > 0.0;
            known.then(|| Indentation { position: c.position, force, tip: c.tip() })
        })
        .collect::<Option<Vec<_>>>()?;
    Some(Stimulus { contacts, ..Stimulus::default() })
}

#[cfg(test)]
mod tests;
