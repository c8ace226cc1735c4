//! Contacts as the sparse non-negative combination of responses that explains readings.

use dermis_model::Indentation;

use crate::contact::Reading;
use crate::dictionary::SHAPE;
use crate::inverter::Inverter;
use crate::settings::InverterError;

/// Rounds of coordinate descent at most.
const ROUNDS: usize = 400;
/// Change of an amplitude, as a share of the largest, at which the descent has ended.
const SETTLED: f64 = 1e-4;

/// Settings of a sparse recovery.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SparseSettings {
    /// Penalty as a share of the one that leaves nothing: small keeps many contacts.
    pub penalty: f64,
    /// \[m\] within which locations are one contact.
    pub radius: f64,
    /// Share of the strongest contact's force below which another is none.
    pub share: f64,
}

impl Default for SparseSettings {
    fn default() -> Self {
        Self { penalty: 0.01, radius: 0.010, share: 0.1 }
    }
}

impl Inverter {
    /// Contacts by a least-squares fit with an ℓ₁ penalty over the forces at locations all over the surface, none of which
    /// pulls (R. Tibshirani, *J. R. Stat. Soc. B* 58 (1996) 267; coordinate descent as in J. Friedman et al., *J. Stat. Softw.* 33
    /// (2010) 1). Locations that stand together are one contact at their mean, weighted by force. The medium is taken to
    /// be linear; [`refine`](Self::refine) goes on from here without that. For a model that does not
    /// [superpose](dermis_model::ForwardModel::superposes) a sum of single responses is no answer: there the fit is only the start,
    /// and what is returned was refined on the model.
    ///
    /// # Errors
    ///
    /// [`InverterError::Channels`] for readings of another skin.
    pub fn sparse(
        &self,
        readings: &[Reading],
        settings: &SparseSettings,
    ) -> Result<Vec<Indentation>, InverterError> {
        let signal = self.whitened(readings)?;
        let dictionary = self.dictionary();
        let locations = dictionary.locations.len();
        let unit = dictionary.forces[SHAPE];
        let noise = self.noise();
        let lengths: Vec<f64> = (0..locations)
            .map(|location| {
                let response = dictionary.response(location, SHAPE).iter().zip(noise);
                response.map(|(v, n)| (f64::from(*v) / n).powi(2)).sum::<f64>().sqrt()
            })
            .collect();
        // Where no channel responds much, an enormous force would explain whatever is left.
        let most: Vec<f64> = lengths.iter().map(|l| l * self.settings().force_max / unit).collect();
        let amplitudes = lasso(&signal, dictionary.directions(), &most, settings.penalty);
        let force = |location: usize| {
            if lengths[location] > 0.0 { amplitudes[location] / lengths[location] * unit } else { 0.0 }
        };
        let mut active: Vec<(f64, usize)> =
            (0..locations).map(|p| (force(p), p)).filter(|(f, _)| *f > 0.0).collect();
        active.sort_by(|a, b| b.0.total_cmp(&a.0));
        // The strongest place gathers what is near, then the strongest of the rest.
        let mut contacts: Vec<Indentation> = Vec::new();
        while let Some((_, middle)) = active.first().copied() {
            let centre = dictionary.locations[middle].position;
            let near = |p: &usize| (dictionary.locations[*p].position - centre).norm() <= settings.radius;
            let (mut total, mut location) = (0.0, nalgebra::Vector3::zeros());
            for (force, p) in active.iter().filter(|(_, p)| near(p)) {
                total += force;
                location += dictionary.locations[*p].position.coords * *force;
            }
            active.retain(|(_, p)| !near(p));
            let (position, normal) = self.surface().project(&(location / total).into());
            contacts.push(self.settings().indentation(position, -normal * total));
        }
        contacts.sort_by(|a, b| b.force.norm().total_cmp(&a.force.norm()));
        let strongest = contacts.first().map_or(0.0, |c| c.force.norm());
        contacts.retain(|c| c.force.norm() >= settings.share * strongest);
        contacts.truncate(self.settings().contacts);
        if contacts.len() > 1 && !self.model().superposes() {
            let refined = self.refine(readings, &contacts)?.contacts;
            return Ok(self.settings().indentations(&refined));
        }
        Ok(contacts)
    }
}

/// Amplitudes of unit directions (locations × channels, end to end) from 0 up to the `most` of each place.
fn lasso(signal: &[f64], directions: &[f32], most: &[f64], share: f64) -> Vec<f64> {
    let (channels, locations) = (signal.len(), most.len());
    let direction = |location: usize| &directions[location * channels..(location + 1) * channels];
    let dot = |a: &[f32], b: &[f64]| a.iter().zip(b).map(|(a, b)| f64::from(*a) * b).sum::<f64>();
    let largest = (0..locations).map(|p| dot(direction(p), signal)).fold(0.0, f64::max);
    let penalty = share * largest;
    let mut amplitudes = vec![0.0; locations];
    let mut left = signal.to_vec();
    let update = |location: usize, amplitudes: &mut [f64], left: &mut [f64]| {
        let d = direction(location);
        let before: f64 = amplitudes[location];
        let after = (before + dot(d, left) - penalty).clamp(0.0, most[location]);
        if after != before {
            left.iter_mut().zip(d).for_each(|(l, d)| *l -= (after - before) * f64::from(*d));
            amplitudes[location] = after;
        }
        (after - before).abs()
    };
    // All locations once, then those that matter until they stand still, and so on until no other wants to join.
    for _ in 0..ROUNDS {
        let mut change: f64 = 0.0;
        for location in 0..locations {
            change = change.max(update(location, &mut amplitudes, &mut left));
        }
        if change <= SETTLED * largest {
            break;
        }
        let active: Vec<usize> = (0..locations).filter(|p| amplitudes[*p] > 0.0).collect();
        for _ in 0..ROUNDS {
            let mut change: f64 = 0.0;
            for location in &active {
                change = change.max(update(*location, &mut amplitudes, &mut left));
            }
            if change <= SETTLED * largest {
                break;
            }
        }
    }
    amplitudes
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use dermis_fixtures::Analytic;

    use crate::testing::{grid, press, random, read, stiffening_grid};
    use crate::{Inverter, Settings};

    fn inverter(noise: f64) -> (Inverter, Arc<Analytic>) {
        let model = Arc::new(grid(noise));
        let mut settings = Settings::new(0.004, 2.0);
        settings.contacts = 4;
        (Inverter::new(Arc::clone(&model) as _, settings).unwrap(), model)
    }

    #[test]
    fn contacts_that_stand_apart_are_recovered() {
        let (inverter, model) = inverter(1e-3);
        let truth = [press(0.008, 0.006, 1.0), press(-0.009, -0.004, 0.6)];
        let readings = read(&model, &truth, &mut random(1));
        let settings = SparseSettings { radius: 0.006, ..SparseSettings::default() };
        let found = inverter.sparse(&readings, &settings).unwrap();
        assert_eq!(found.len(), 2, "{found:?}");
        for (found, truth) in found.iter().zip(&truth) {
            assert!((found.position - truth.position).norm() < 1.5e-3, "{found:?}");
            assert!((found.force.norm() - truth.force.norm()).abs() < 0.15, "{found:?}");
        }
        // The refinement takes away what grid and penalty leave.
        let refined = inverter.refine(&readings, &found).unwrap().contacts;
        for (found, truth) in refined.iter().zip(&truth) {
            assert!((found.position - truth.position).norm() < 1e-4, "{found:?}");
        }
    }

    #[test]
    fn where_signals_do_not_add_up_the_answer_is_refined_on_the_model() {
        let model = Arc::new(stiffening_grid(1e-3));
        let mut settings = Settings::new(0.004, 2.0);
        settings.contacts = 4;
        let inverter = Inverter::new(Arc::clone(&model) as _, settings).unwrap();
        let truth = [press(0.008, 0.006, 1.0), press(-0.009, -0.004, 0.6)];
        let readings: Vec<Reading> = model.read(&truth).into_iter().map(Reading::Exact).collect();
        let settings = SparseSettings { radius: 0.006, ..SparseSettings::default() };
        let found = inverter.sparse(&readings, &settings).unwrap();
        assert_eq!(found.len(), 2, "{found:?}");
        // A sum of single presses of 0.4 N would say two thirds of these forces: 1.2 / 1.8.
        for (found, truth) in found.iter().zip(&truth) {
            assert!((found.force.norm() - truth.force.norm()).abs() < 0.01, "{found:?}");
            assert!((found.position - truth.position).norm() < 1e-4, "{found:?}");
        }
    }

    #[test]
    fn nothing_is_recovered_from_nothing() {
        let (inverter, _) = inverter(1e-3);
        let settings = SparseSettings::default();
        assert!(inverter.sparse(&[Reading::Exact(0.0); 25], &settings).unwrap().is_empty());
        assert!(inverter.sparse(&[Reading::Missing; 25], &settings).unwrap().is_empty());
        assert!(inverter.sparse(&[Reading::Exact(0.0); 3], &settings).is_err());
    }
}
