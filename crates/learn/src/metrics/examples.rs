//! Force maps of single frames beside the true ones, for people: one for each true number of contacts.
//!
//! Which frame is shown is not chosen by its error: of the first press with so many contacts, the frame with the most force.

use std::collections::BTreeMap;

use dermis_skin::Surface;

use crate::dataset::Truth;

/// Most contacts of a frame of which an example is kept.
const MOST_CONTACTS: usize = 10;
/// Least third component of a normal: seen from above, such a surface does not lie over itself.
const LEAST_UP: f64 = 0.5;

/// A force map beside the true one.
#[derive(Debug, Clone, PartialEq)]
pub struct MapExample {
    /// \[N\] with which the true contacts press.
    pub forces: Vec<f64>,
    /// \[m\] x and y of the surface's points, in the frame of the skin's link.
    pub points: Vec<(f64, f64)>,
    /// \[N\] true pressing force of each point.
    pub truth: Vec<f64>,
    /// \[N\] estimated pressing force of each point.
    pub answer: Vec<f64>,
}

impl MapExample {
    /// \[N\] all forces of the ground truth.
    fn force(&self) -> f64 {
        self.truth.iter().sum()
    }
}

/// Collects examples, where the surface can be drawn from above.
#[derive(Debug, Default)]
pub(super) struct Examples {
    points: Vec<(f64, f64)>,
    /// The press of each example, while it lasts.
    by_number: BTreeMap<usize, (Option<u64>, MapExample)>,
}

impl Examples {
    pub(super) fn of(surface: &Surface) -> Self {
        let shown = surface.normals.iter().all(|normal| normal.z > LEAST_UP);
        let points = surface.points.iter().filter(|_| shown).map(|point| (point.x, point.y));
        Self { points: points.collect(), by_number: BTreeMap::new() }
    }

    /// Takes the pressing forces \[N\] of all points of a touched frame.
    pub(super) fn push(&mut self, truth: &Truth, forces: &[f64], answer: &[f64]) {
        // Of another press than the example's, no frame takes its place any more.
        for (press, _) in self.by_number.values_mut() {
            *press = press.filter(|press| *press == truth.press);
        }
        let number = truth.contacts.len();
        if self.points.is_empty() || forces.len() != self.points.len() || number > MOST_CONTACTS {
            return;
        }
        let stronger = |(press, kept): &(Option<u64>, MapExample)| {
            press.is_some() && forces.iter().sum::<f64>() > kept.force()
        };
        if !self.by_number.get(&number).is_none_or(stronger) {
            return;
        }
        let example = MapExample {
            forces: truth.contacts.iter().filter_map(crate::TruthContact::normal_force).collect(),
            points: self.points.clone(),
            truth: forces.to_vec(),
            answer: answer.to_vec(),
        };
        self.by_number.insert(number, (Some(truth.press), example));
    }

    /// By ascending number of contacts.
    pub(super) fn finish(self) -> Vec<MapExample> {
        self.by_number.into_values().map(|(_, example)| example).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::tests::{contact, skin};

    fn truth(press: u64, forces: &[f64]) -> Truth {
        let contacts = forces.iter().map(|force| contact(0.001, -0.002, *force)).collect();
        Truth { press, location: 0, idle: false, contacts }
    }

    #[test]
    fn each_number_has_the_strongest_frame_of_its_first_press() {
        let surface = skin().surface();
        let mut examples = Examples::of(&surface);
        let map = |force: f64| {
            let mut map = vec![0.0; surface.points.len()];
            map[3] = force;
            map
        };
        let mut push = |press: u64, forces: &[f64]| {
            let total: f64 = forces.iter().sum();
            examples.push(&truth(press, forces), &map(total), &map(0.9 * total));
        };
        push(1, &[1.0]);
        push(1, &[3.0]);
        push(1, &[2.0]);
        push(2, &[1.0, 1.5]);
        // Another press with one contact, with more force; and one that is called as the first was.
        push(3, &[9.0]);
        push(1, &[8.0]);
        let found = examples.finish();
        assert_eq!(found.iter().map(|e| e.forces.len()).collect::<Vec<_>>(), [1, 2]);
        assert_eq!((found[0].truth[3], found[0].answer[3]), (3.0, 0.9 * 3.0));
        assert_eq!(found[0].forces, [3.0]);
        assert_eq!((found[1].truth[3], found[1].points.len()), (2.5, surface.points.len()));
    }

    #[test]
    fn a_surface_that_turns_away_has_no_examples() {
        let mut surface = skin().surface();
        surface.normals[0] = nalgebra::Vector3::x();
        let mut examples = Examples::of(&surface);
        let map = vec![1.0; surface.points.len()];
        examples.push(&truth(1, &[1.0]), &map, &map);
        assert!(examples.finish().is_empty());
    }
}
