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
    /// The same of contacts that were found; absent where all were, or none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub found: Option<Box<Ratio>>,
}

/// Error, bound, and whether the contact was found.
type Pair = (f64, f64, bool);

impl Ratio {
    fn of(pairs: &[Pair]) -> Option<Self> {
        let count = pairs.len() as f64;
        if pairs.is_empty() {
            return None;
        }
        let rms = |of: fn(&Pair) -> f64| (pairs.iter().map(|p| of(p).powi(2)).sum::<f64>() / count).sqrt();
        let middle = |of: fn(&Pair) -> f64| median(&mut pairs.iter().map(of).collect::<Vec<f64>>());
        let found: Vec<_> = pairs.iter().filter(|p| p.2).copied().collect();
        let (error_rms, bound_rms) = (rms(|p| p.0), rms(|p| p.1));
        Some(Self {
            samples: pairs.len(),
            not_found: (pairs.len() - found.len()) as f64 / count,
            error_rms,
            error_median: middle(|p| p.0.abs()),
            bound_rms,
            bound_median: middle(|p| p.1),
            ratio_of_rms: error_rms / bound_rms,
            median_ratio: middle(|p| p.0.abs() / p.1),
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
                    pairs.entry((of, quantity)).or_default().push((error.force, (value, bound, error.found)));
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
                all.iter().filter(|(_, (_, bound, _))| *bound < WELL_DETERMINED).copied().collect();
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
mod tests {
    use dermis_fixtures::Analytic;

    use super::*;
    use crate::FORCE_BINS;
    use crate::dataset::tests::presses;

    /// Both channels of the made-up skin: one tells x by the force, the other the force.
    fn made(skin: &dermis_skin::SkinDescription) -> Analytic {
        let locations = skin.taxels.iter().map(dermis_skin::Taxel::point);
        Analytic::of_contacts(skin.surface(), locations, 0.5, |c, _, out| {
            out[0] += c.position.x * 1e4;
            out[1] += -c.force.z * 20.0;
        })
    }

    #[test]
    fn every_touched_sample_counts_in_its_bin() {
        let data = presses(10, 2);
        let model = made(data.skin());
        let found = frame_bounds(&model, &data, None, Unknowns::Normal).unwrap();
        let bounds = found.summary(&FORCE_BINS).unwrap();
        assert_eq!(bounds.samples, 40);
        assert_eq!(bounds.normal_force.iter().map(|b| b.samples).sum::<usize>(), 40);
        // 0.5 of noise over 20 a newton; y shows in no channel.
        assert!(bounds.normal_force.iter().all(|b| (b.rms - 0.025).abs() < 1e-9), "{bounds:?}");
        assert!(bounds.position.iter().all(|b| b.rms.is_infinite()));
        let some: Vec<SampleId> = data.labelled().take(30).map(|(id, ..)| id).collect();
        let fewer = frame_bounds(&model, &data, Some(&some), Unknowns::Normal).unwrap();
        assert!(fewer.summary(&FORCE_BINS).unwrap().samples < 40);
        // Where no channel tells the place, only the force is held against its bound.
        assert_eq!(found.left_out, Unbounded { touched: 40, undetermined: 40, ..Unbounded::default() });
        let errors = [error(data.labelled().find(|(_, _, t)| t.touched()).unwrap().0, [0, 1], 0.01, 0.05)];
        let against = found.against(&errors, &FORCE_BINS);
        let counts: Vec<(&str, usize)> = against.iter().map(|a| (&*a.quantity, a.all.samples)).collect();
        assert_eq!(counts, [("force.normal", 1)]);
        approx::assert_relative_eq!(against[0].all.ratio_of_rms, 2.0, max_relative = 1e-9);
    }

    #[test]
    fn well_determined_positions_stand_apart() {
        let ids = [0, 1, 2].map(|sample| SampleId { run: 0, sample });
        // Bounds of 1, 2 and 10 mm.
        let frames = ids.into_iter().zip([1e-3, 2e-3, 1e-2].map(|b| vec![bound(b)])).collect();
        let bounds = FrameBounds { frames, ..FrameBounds::default() };
        let errors: Vec<ContactError> =
            ids.iter().zip([3e-3, 4e-3, 1e-2]).map(|(id, e)| error(*id, [0, 1], e, 0.1)).collect();
        let against = bounds.against(&errors, &FORCE_BINS);
        let position = against.iter().find(|a| a.quantity == "position").unwrap();
        let well = position.well_determined.as_ref().unwrap();
        assert_eq!((position.all.samples, well.all.samples, well.below), (3, 2, 3e-3));
        approx::assert_relative_eq!(well.all.ratio_of_rms, (25.0f64 / 5.0).sqrt(), max_relative = 1e-9);
        assert_eq!(well.by_force.iter().map(|b| b.ratio.samples).sum::<usize>(), 2);
        assert!(position.to_string().contains("bound < 3 mm"), "{position}");
        // Forces have none, and nothing stands apart where all are.
        assert!(against.iter().all(|a| a.quantity == "position" || a.well_determined.is_none()));
        let sharp = bounds.against(&errors[..2], &FORCE_BINS);
        assert!(sharp.iter().all(|a| a.well_determined.is_none()));
    }

    #[test]
    fn contacts_without_a_finite_bound_are_counted() {
        let ids = [0, 1, 2, 3].map(|sample| SampleId { run: 0, sample });
        let bound_of = [1e-3, f64::INFINITY, f64::INFINITY, 2e-3];
        let frames = ids.into_iter().zip(bound_of.map(|b| vec![bound(b)])).collect();
        let bounds = FrameBounds { frames, ..FrameBounds::default() };
        let mut errors: Vec<ContactError> =
            ids.iter().zip([1e-3, 3e-3, 4e-3, 2e-3]).map(|(id, e)| error(*id, [0, 1], e, 0.1)).collect();
        // The last one presses harder, and is the only one of its bin.
        errors[3].force = 5.0;
        let against = bounds.against(&errors, &[0.5, 2.0]);
        let position = against.iter().find(|a| a.quantity == "position").unwrap();
        assert_eq!(position.all.samples, 2);
        let open = position.undetermined.as_ref().unwrap();
        assert_eq!((open.all.contacts, open.all.share), (2, 0.5));
        approx::assert_relative_eq!(open.all.error_rms, (12.5e-6_f64).sqrt(), max_relative = 1e-12);
        let bins: Vec<_> = open.by_force.iter().map(|b| (b.from, b.to, b.uncounted.contacts)).collect();
        assert_eq!(bins, [(0.5, Some(2.0), 2)]);
        approx::assert_relative_eq!(open.by_force[0].uncounted.share, 2.0 / 3.0, max_relative = 1e-12);
        let text = position.to_string();
        let line = text.lines().find(|l| l.contains("bound is infinite")).unwrap();
        insta::assert_snapshot!(line.trim(), @"left out, the bound is infinite: 2 of 4 contacts (50.0 %), error RMS 3.536; of 0.5-2 N 2 (66.7 %)");
        // Forces are bounded.
        assert!(against.iter().all(|a| a.quantity == "position" || a.undetermined.is_none()));
        let json = serde_json::to_value(&against).unwrap();
        assert_eq!(json[0]["undetermined"]["all"]["contacts"], 2);
        assert_eq!(serde_json::from_value::<Vec<AgainstBound>>(json).unwrap(), against);
    }

    fn error(id: SampleId, contact: [usize; 2], position: f64, normal_force: f64) -> ContactError {
        let (vector, angle) = (f64::NAN, f64::NAN);
        ContactError { id, contact, force: 1.0, position, normal_force, vector, angle, found: true }
    }

    #[test]
    fn all_of_a_force_stands_beside_its_bound_where_shear_is_looked_for() {
        let id = SampleId { run: 0, sample: 0 };
        let mut sheared = bound(1e-3);
        (sheared.1.normal_force, sheared.1.shear) = (0.03, Some(0.04));
        let mut found = ContactError { force: 2.0, ..error(id, [0, 1], 1e-3, 0.1) };
        (found.vector, found.angle) = (0.1, 0.01);
        let bounds = |of| FrameBounds { frames: [(id, vec![of])].into(), ..FrameBounds::default() };
        let against = bounds(sheared).against(&[found], &FORCE_BINS);
        let ratio = |name: &str| against.iter().find(|a| a.quantity == name).unwrap().all.ratio_of_rms;
        approx::assert_relative_eq!(ratio("force"), 2.0, max_relative = 1e-12);
        approx::assert_relative_eq!(ratio("angle"), 0.5, max_relative = 1e-12);
        let straight = bounds(bound(1e-3)).against(&[found], &FORCE_BINS);
        assert!(straight.iter().all(|a| a.quantity != "force" && a.quantity != "angle"));
    }

    fn bound(position: f64) -> (f64, ContactBound) {
        (1.0, ContactBound { position, along: [position; 2], normal_force: 0.1, shear: None })
    }

    #[test]
    fn errors_stand_beside_the_bounds_of_their_own_frames() {
        let id = |sample| SampleId { run: 0, sample };
        let mut bounds = FrameBounds::default();
        // Bounds of frames 0 to 3 of one contact: 1, 2, 4 and 100 mm; frame 4 has two of 8 and 6 mm; frame 5 was never answered.
        for (sample, mm) in [1.0, 2.0, 4.0, 100.0].into_iter().enumerate() {
            bounds.frames.insert(id(sample), vec![bound(mm * 1e-3)]);
        }
        bounds.frames.insert(id(4), vec![bound(8e-3), bound(6e-3)]);
        bounds.frames.insert(id(5), vec![bound(5.0)]);
        let mut errors: Vec<ContactError> =
            (0..4).map(|n| error(id(n), [0, 1], [1e-3, 1e-3, 1e-3, 10e-3][n], 0.05)).collect();
        errors.extend([error(id(4), [0, 2], 4e-3, 0.1), error(id(4), [1, 2], 3e-3, 0.1)]);
        // Of frame 9 there is no bound.
        errors.push(error(id(9), [0, 1], 1.0, 1.0));
        // What is not found counts with everything, and is listed apart.
        errors[3].found = false;
        let against = bounds.against(&errors, &[0.5, 2.0]);
        let one = &against.iter().find(|a| a.contacts == 1 && a.quantity == "position").unwrap().all;
        assert_eq!((one.samples, one.not_found), (4, 0.25));
        approx::assert_relative_eq!(one.error_rms, (103e-6_f64 / 4.0).sqrt(), max_relative = 1e-12);
        approx::assert_relative_eq!(one.bound_rms, (10_021e-6_f64 / 4.0).sqrt(), max_relative = 1e-12);
        approx::assert_relative_eq!(one.bound_median, 3e-3, max_relative = 1e-12);
        approx::assert_relative_eq!(one.ratio_of_rms, (103.0_f64 / 10_021.0).sqrt(), max_relative = 1e-12);
        // Ratios 1, 0.5, 0.25 and 0.1.
        approx::assert_relative_eq!(one.median_ratio, 0.375, max_relative = 1e-12);
        let found = one.found.as_ref().unwrap();
        approx::assert_relative_eq!(found.ratio_of_rms, (3.0_f64 / 21.0).sqrt(), max_relative = 1e-12);
        assert_eq!((found.samples, found.median_ratio, &found.found), (3, 0.5, &None));
        // Several have a bound of their own.
        let two = against.iter().find(|a| a.contacts == 2 && a.quantity == "position").unwrap();
        approx::assert_relative_eq!(two.all.ratio_of_rms, 0.5, max_relative = 1e-12);
        assert_eq!(two.by_force.iter().map(|b| (b.from, b.ratio.samples)).collect::<Vec<_>>(), [(0.5, 2)]);
        let summary = bounds.summary(&[0.5, 2.0]).unwrap();
        assert_eq!((summary.samples, summary.several[&2].samples), (5, 2));
        let json = serde_json::to_value(&against).unwrap();
        assert_eq!(serde_json::from_value::<Vec<AgainstBound>>(json).unwrap(), against);
    }

    #[test]
    fn bounds_of_before_are_read() {
        let old = r#"{ "samples": 3, "position": [{ "from": 0.2, "to": 0.4, "samples": 3, "rms": 0.001 }], "normal_force": [] }"#;
        let read: Bounds = serde_json::from_str(old).unwrap();
        assert_eq!((read.samples, read.position[0].median, read.several.len()), (3, None, 0));
    }

    #[test]
    fn without_a_diameter_there_is_no_stimulus() {
        let mut truth = presses(1, 1).labelled().find(|(_, _, t)| t.touched()).unwrap().2.clone();
        assert!(stimulus(&truth).is_some());
        truth.contacts[0].diameter = f64::NAN;
        assert!(stimulus(&truth).is_none());
    }
}
