//! The Cramér–Rao bound of the contacts of a data set, to stand beside the errors of an estimator.

use std::collections::BTreeSet;
use std::fmt;

use dermis_model::{ForwardModel, Indentation, Stimulus, Unknowns, WithNoise};
use dermis_skin::{ChannelFlags, ForceComponents};
use dermis_theory::{ContactBound, TheoryError, cramer_rao};
use serde::{Deserialize, Serialize};

use crate::dataset::{Dataset, SampleId, Truth};
use crate::metrics::{Bin, bins};

/// Samples that are bounded at most; of more, every n-th is taken.
const MOST: usize = 2000;

/// What an estimator without bias that sees one frame at a time reaches at best on the contacts of a data set: root mean
/// squares by true normal force, of the same bins as the errors.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Bounds {
    /// Touched samples that were bounded.
    pub samples: usize,
    /// \[m\] of the position.
    pub position: Vec<Bin>,
    /// \[N\] of the normal force.
    pub normal_force: Vec<Bin>,
}

impl fmt::Display for Bounds {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (name, unit, factor, bins) in
            [("position", "mm", 1e3, &self.position), ("force.normal", "N", 1.0, &self.normal_force)]
        {
            write!(f, "  {name} Cramér–Rao bound [{unit}] by force [N]:")?;
            for bin in bins {
                let value = bin.rms * factor;
                match bin.to {
                    Some(to) => write!(f, "  {}-{to}: {value:.3}", bin.from)?,
                    None => write!(f, "  {}+: {value:.3}", bin.from)?,
                }
            }
            writeln!(f)?;
        }
        Ok(())
    }
}

/// Bounds the touched samples of a data set, or those of `only`, by the forward model of its skin. `None` where no sample
/// has what a stimulus needs: position, force and diameter of every contact. `edges` \[N\] of the bins ascend, the last bin
/// is open. A channel that was at an end of its range, or had no valid reading, tells nothing of its sample.
///
/// # Errors
///
/// [`TheoryError::Noise`] where the skin names a channel without noise.
pub fn bounds(
    model: &dyn ForwardModel,
    data: &Dataset,
    only: Option<&[SampleId]>,
    unknowns: Unknowns,
    edges: &[f64],
) -> Result<Option<Bounds>, TheoryError> {
    let only: Option<BTreeSet<SampleId>> = only.map(|ids| ids.iter().copied().collect());
    let stimuli: Vec<(Stimulus, &[ChannelFlags])> = data
        .labelled()
        .filter(|(id, _, truth)| truth.touched() && only.as_ref().is_none_or(|ids| ids.contains(id)))
        .filter_map(|(_, sample, truth)| Some((stimulus(truth)?, &*sample.flags)))
        .collect();
    let mut masked = WithNoise::new(model, model.noise().to_vec());
    let mut found: Vec<(f64, ContactBound)> = Vec::new();
    for (stimulus, flags) in stimuli.iter().step_by(stimuli.len().div_ceil(MOST).max(1)) {
        masked.noise_mut().copy_from_slice(model.noise());
        for (noise, _) in masked.noise_mut().iter_mut().zip(*flags).filter(|(_, f)| !f.is_ok()) {
            *noise = MASKED_NOISE;
        }
        match cramer_rao(&masked, stimulus, unknowns) {
            Ok(all) => {
                let surface = model.surface();
                found.extend(stimulus.contacts.iter().zip(all).map(|(contact, bound)| {
                    let (_, normal) = surface.project(&contact.position);
                    (-contact.force.dot(&normal), bound)
                }));
            }
            // A force sensor's noise pulls at the skin now and then, which the model does not know.
            Err(TheoryError::Model(_)) => {}
            Err(error) => return Err(error),
        }
    }
    let bins = |value: fn(&ContactBound) -> f64| {
        bins(edges, found.iter().map(|(force, bound)| (*force, value(bound))))
    };
    Ok((!found.is_empty()).then(|| Bounds {
        samples: found.len(),
        position: bins(|b| b.position),
        normal_force: bins(|b| b.normal_force),
    }))
}

/// Noise of a channel that tells nothing, in any unit.
const MASKED_NOISE: f64 = 1e30;

/// What pressed, where the truth is whole.
pub(crate) fn stimulus(truth: &Truth) -> Option<Stimulus> {
    let contacts = truth
        .contacts
        .iter()
        .map(|c| {
            let pressing = -c.normal * c.normal_force()?;
            let full = c.components == ForceComponents::Full && c.force.iter().all(|v| v.is_finite());
            let force = if full { c.force } else { pressing };
            let known = c.position.iter().chain(&force).all(|v| v.is_finite()) && c.diameter > 0.0;
            known.then_some(Indentation::sphere(c.position, force, c.diameter))
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
        let places = skin.taxels.iter().map(dermis_skin::Taxel::point);
        Analytic::of_contacts(skin.surface(), places, 0.5, |c, _, out| {
            out[0] += c.position.x * 1e4;
            out[1] += -c.force.z * 20.0;
        })
    }

    #[test]
    fn every_touched_sample_counts_in_its_bin() {
        let data = presses(10, 2);
        let model = made(data.skin());
        let bounds = bounds(&model, &data, None, Unknowns::Normal, &FORCE_BINS).unwrap().unwrap();
        assert_eq!(bounds.samples, 40);
        assert_eq!(bounds.normal_force.iter().map(|b| b.samples).sum::<usize>(), 40);
        // 0.5 of noise over 20 a newton; y is told by no channel.
        assert!(bounds.normal_force.iter().all(|b| (b.rms - 0.025).abs() < 1e-9), "{bounds:?}");
        assert!(bounds.position.iter().all(|b| b.rms.is_infinite()));
        let some: Vec<SampleId> = data.labelled().take(30).map(|(id, ..)| id).collect();
        let fewer =
            super::bounds(&model, &data, Some(&some), Unknowns::Normal, &FORCE_BINS).unwrap().unwrap();
        assert!(fewer.samples < 40);
    }

    #[test]
    fn without_a_diameter_there_is_no_stimulus() {
        let mut truth = presses(1, 1).labelled().find(|(_, _, t)| t.touched()).unwrap().2.clone();
        assert!(stimulus(&truth).is_some());
        truth.contacts[0].diameter = f64::NAN;
        assert!(stimulus(&truth).is_none());
    }
}
