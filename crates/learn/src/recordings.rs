//! Single contacts that were recorded.

use dermis_model::{ForwardModel, Indentation, Stimulus};
use dermis_skin::ChannelFlags;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::LearnError;
use crate::bounds::stimulus;
use crate::dataset::{Dataset, SampleId};

/// Draws of one superposition before its contacts are allowed to stand nearer to each other than requested.
const TRIES: usize = 200;

/// One contact, and what the channels read of it.
#[derive(Debug, Clone, PartialEq)]
pub struct Recorded {
    /// What pressed.
    pub contact: Indentation,
    /// Readings minus their untouched ones, one a channel, in the unit of the skin.
    pub signal: Vec<f32>,
    /// Identity of the place.
    pub location: u32,
}

impl Recorded {
    /// Single contacts of these samples that press with `least` \[N\] or more and of which every channel is known; `most` at most,
    /// evenly over them.
    ///
    /// # Errors
    ///
    /// [`LearnError`] where a bag cannot be read once more.
    pub fn of(data: &Dataset, only: &[SampleId], least: f64, most: usize) -> Result<Vec<Self>, LearnError> {
        let whole = |flags: &ChannelFlags| !flags.is_invalid() && !flags.contains(ChannelFlags::SATURATED);
        let pressed = |id: &SampleId| {
            let info = data.sample(*id)?;
            let truth = info.truth.as_ref()?;
            truth.single()?.normal_force().filter(|f| *f >= least)?;
            let [contact]: [Indentation; 1] = stimulus(truth)?.contacts.try_into().ok()?;
            info.flags.iter().all(whole).then_some((contact, truth.location))
        };
        let (ids, contacts): (Vec<SampleId>, Vec<(Indentation, u32)>) =
            only.iter().filter_map(|id| Some((*id, pressed(id)?))).unzip();
        let all: Vec<Self> = data
            .gather(&ids)?
            .into_iter()
            .zip(contacts)
            .filter(|((_, sample), _)| sample.tared.iter().all(|v| v.is_finite()))
            .map(|((_, sample), (contact, location))| Self { contact, signal: sample.tared, location })
            .collect();
        let step = dermis_regress::stride(all.len(), most);
        Ok(all.into_iter().step_by(step).collect())
    }
}

/// Sums of what single contacts read, as if they had pressed at once: `contacts` of them, at least `distance` \[m\] apart. Where a
/// surface gives way in proportion to what presses, this is what it reads of all of them; where it stiffens, nearly so. None of more
/// than one contact where they do not ([`ForwardModel::superposes`]).
#[must_use]
pub fn superpose(
    model: &dyn ForwardModel,
    recorded: &[Recorded],
    contacts: usize,
    count: usize,
    distance: f64,
    seed: u64,
) -> Vec<(Stimulus, Vec<f32>)> {
    if recorded.is_empty() || (contacts > 1 && !model.superposes()) {
        return Vec::new();
    }
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(contacts as u64);
    let one = |rng: &mut ChaCha8Rng| {
        let mut chosen: Vec<&Recorded> = Vec::with_capacity(contacts);
        let mut tries = 0;
        while chosen.len() < contacts {
            let next = &recorded[rng.random_range(0..recorded.len())];
            tries += 1;
            let near = |c: &&Recorded| (c.contact.position - next.contact.position).norm() < distance;
            if chosen.iter().any(near) && tries < TRIES {
                continue;
            }
            chosen.push(next);
        }
        let mut signal = vec![0.0; recorded[0].signal.len()];
        for press in &chosen {
            signal.iter_mut().zip(&press.signal).for_each(|(s, v)| *s += v);
        }
        let contacts = chosen.iter().map(|c| c.contact.clone()).collect();
        (Stimulus { contacts, ..Stimulus::default() }, signal)
    };
    (0..count).map(|_| one(&mut rng)).collect()
}

#[cfg(test)]
mod tests {
    use nalgebra::{Point3, Vector3};

    use super::*;

    #[test]
    fn signals_of_locations_that_stand_apart_add_up() {
        let press = |i: usize| Recorded {
            contact: Indentation::sphere(
                Point3::new(i as f64 * 0.01, 0.0, 0.0),
                Vector3::new(0.0, 0.0, -1.0),
                0.004,
            ),
            signal: vec![i as f32, 1.0],
            location: i as u32,
        };
        let recorded: Vec<Recorded> = (0..20).map(press).collect();
        let model = dermis_model::suite::Probe::that_superposes();
        for (stimulus, signal) in superpose(&model, &recorded, 3, 50, 0.025, 1) {
            let locations: Vec<f64> = stimulus.contacts.iter().map(|c| c.position.x).collect();
            let sum: f64 = locations.iter().map(|x| x / 0.01).sum();
            assert!((f64::from(signal[0]) - sum).abs() < 1e-4 && signal[1] == 3.0);
            for (i, a) in locations.iter().enumerate() {
                assert!(locations[..i].iter().all(|b| (a - b).abs() >= 0.025 - 1e-12), "{locations:?}");
            }
        }
        assert!(superpose(&model, &[], 2, 5, 0.01, 1).is_empty());
        // The probe says that contacts change each other's readings.
        let probe = dermis_model::suite::Probe::default();
        assert!(superpose(&probe, &recorded, 2, 5, 0.01, 1).is_empty());
        assert_eq!(superpose(&probe, &recorded, 1, 5, 0.01, 1).len(), 5);
    }
}
