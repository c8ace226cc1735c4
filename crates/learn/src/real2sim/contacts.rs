//! Found contacts beside true ones, and the settings of the suppression that follow from it.

use dermis_inversion::{PeakSettings, suppress};
use dermis_model::Indentation;
use dermis_skin::Contact;

/// Shares of the strongest force that are tried.
const SHARES: [f64; 12] = [0.0, 0.02, 0.04, 0.06, 0.08, 0.1, 0.13, 0.16, 0.2, 0.25, 0.3, 0.4];

/// Index of the found contact that belongs to each true one: the nearest pairs first, none used twice, and none farther than
/// `reach` \[m\].
#[must_use]
pub fn matched(truth: &[Indentation], found: &[Contact], reach: f64) -> Vec<Option<usize>> {
    let mut pairs: Vec<(f64, usize, usize)> = Vec::new();
    for (t, contact) in truth.iter().enumerate() {
        for (f, other) in found.iter().enumerate() {
            let distance = (other.position - contact.position).norm();
            if distance <= reach {
                pairs.push((distance, t, f));
            }
        }
    }
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut all = vec![None; truth.len()];
    for (_, t, f) in pairs {
        if all[t].is_none() && !all.contains(&Some(f)) {
            all[t] = Some(f);
        }
    }
    all
}

/// The suppression that gives the right number of contacts most often, over frames of a true number and the forces \[N\] of all
/// peaks; frames of every number count alike. Only the share and the least force are chosen.
#[must_use]
pub fn tune(frames: &[(usize, Vec<f64>)], least_true: f64, settings: &PeakSettings) -> PeakSettings {
    let most = frames.iter().map(|(n, _)| *n).max().unwrap_or(0);
    let mut best = (f64::NEG_INFINITY, settings.clone());
    for share in SHARES {
        for floor in [0.0, 0.1, 0.2, 0.4, 0.6, 0.8] {
            let tried = PeakSettings { share, least_force: floor * least_true, ..settings.clone() };
            let mut right = vec![(0usize, 0usize); most + 1];
            for (number, forces) in frames {
                let (all, hits) = &mut right[*number];
                *all += 1;
                *hits += usize::from(suppress(forces, &tried).len() == *number);
            }
            let known = right.iter().filter(|(all, _)| *all > 0);
            let score: f64 = known.map(|(all, hits)| *hits as f64 / *all as f64).sum();
            if score > best.0 {
                best = (score, tried);
            }
        }
    }
    best.1
}

#[cfg(test)]
mod tests {
    use nalgebra::{Point3, Vector3};

    use super::*;

    #[test]
    fn pairs_are_the_nearest_and_none_is_used_twice() {
        let press =
            |x: f64| Indentation::sphere(Point3::new(x, 0.0, 0.0), Vector3::new(0.0, 0.0, -1.0), 0.004);
        let found = |x: f64| Contact::at(Point3::new(x, 0.0, 0.0), Vector3::z());
        let truth = [press(0.0), press(0.020)];
        assert_eq!(matched(&truth, &[found(0.019), found(0.003)], 0.015), [Some(1), Some(0)]);
        assert_eq!(matched(&truth, &[found(0.009)], 0.015), [Some(0), None]);
        assert_eq!(matched(&truth, &[found(0.040)], 0.015), [None, None]);
    }

    #[test]
    fn the_share_that_parts_contacts_from_ripples_is_found() {
        let frames: Vec<(usize, Vec<f64>)> = vec![
            (1, vec![10.0, 0.8]),
            (1, vec![5.0, 0.45]),
            (2, vec![10.0, 3.0, 0.9]),
            (2, vec![8.0, 6.0, 0.6]),
        ];
        let tuned = tune(&frames, 0.5, &PeakSettings::default());
        for (number, forces) in &frames {
            assert_eq!(suppress(forces, &tuned).len(), *number, "{tuned:?}");
        }
    }
}
