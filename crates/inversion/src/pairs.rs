//! Where to begin with two contacts: the best of all pairs of locations.

use dermis_model::Indentation;
use nalgebra::{Point3, Vector3};

use crate::dictionary::{Dictionary, SHAPE};
use crate::fit::Datum;

/// Locations whose pairs are gone through, roughly.
const LOCATIONS: usize = 420;

/// Some locations of a dictionary, all over the surface.
#[derive(Debug)]
pub(crate) struct Pairs {
    locations: Vec<usize>,
    /// \[m\] that they are apart.
    spacing: f64,
}

impl Pairs {
    pub fn new(dictionary: &Dictionary, spacing: f64) -> Self {
        let share = (dictionary.locations.len() as f64 / LOCATIONS as f64).sqrt().max(1.0);
        let spacing = spacing * share;
        let mut locations: Vec<usize> = Vec::new();
        for (i, location) in dictionary.locations.iter().enumerate() {
            let near = |other: &usize| {
                (dictionary.locations[*other].position - location.position).norm() < spacing * 0.999
            };
            if share <= 1.0 || !locations.iter().any(near) {
                locations.push(i);
            }
        }
        Self { locations, spacing }
    }

    /// The pairs, `apart` \[m\] or more from one another, whose best forces (between 0 and `force_max` \[N\]) explain most of
    /// the data; at most `count`, no two of them alike. The readings of
    /// both are taken to add up: [`ForwardModel::superposes`](dermis_model::ForwardModel::superposes).
    pub fn best(
        &self,
        dictionary: &Dictionary,
        data: &[Datum],
        (apart, force_max, diameter): (f64, f64, f64),
        count: usize,
    ) -> Vec<[Indentation; 2]> {
        let (values, weights): (Vec<f64>, Vec<f64>) = data
            .iter()
            .map(|datum| match *datum {
                Datum::Exact(v, w) | Datum::AtLeast(v, w) | Datum::AtMost(v, w) => (v * w, w),
                Datum::None => (0.0, 0.0),
            })
            .unzip();
        let channels = data.len();
        let unit = dictionary.forces[SHAPE];
        // Of every place: what one newton does to each channel, in units of its error.
        let mut rows = Vec::with_capacity(self.locations.len() * channels);
        for location in &self.locations {
            let response = dictionary.response(*location, SHAPE);
            rows.extend(response.iter().zip(&weights).map(|(v, w)| f64::from(*v) * w / unit));
        }
        let row = |i: usize| &rows[i * channels..(i + 1) * channels];
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let own: Vec<(f64, f64)> =
            (0..self.locations.len()).map(|i| (dot(row(i), &values), dot(row(i), row(i)))).collect();
        let position = |i: usize| dictionary.locations[self.locations[i]].position;
        let apart = apart * apart;
        // The best partner of each.
        let mut found: Vec<(f64, usize, usize, [f64; 2])> = Vec::new();
        for i in 0..self.locations.len() {
            let (bi, gi) = own[i];
            let mut best: Option<(f64, usize, usize, [f64; 2])> = None;
            for (j, (bj, gj)) in own.iter().copied().enumerate().take(i) {
                let g = dot(row(i), row(j));
                let determinant = gi * gj - g * g;
                if determinant <= 1e-9 * gi * gj {
                    continue;
                }
                let (fi, fj) = ((gj * bi - g * bj) / determinant, (gi * bj - g * bi) / determinant);
                if fi <= 0.0 || fj <= 0.0 || fi > force_max || fj > force_max {
                    continue;
                }
                let gain = bi * fi + bj * fj;
                if best.is_none_or(|(most, ..)| gain > most)
                    && (position(i) - position(j)).norm_squared() >= apart
                {
                    best = Some((gain, i, j, [fi, fj]));
                }
            }
            found.extend(best);
        }
        found.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut chosen: Vec<(usize, usize)> = Vec::new();
        let mut all = Vec::new();
        for (_, i, j, [fi, fj]) in found {
            if all.len() == count {
                break;
            }
            let near = |a: usize, b: usize| (position(a) - position(b)).norm() < 2.5 * self.spacing;
            let alike = |(a, b): &(usize, usize)| near(*a, i) && near(*b, j) || near(*a, j) && near(*b, i);
            if chosen.iter().any(alike) {
                continue;
            }
            chosen.push((i, j));
            let contact = |k: usize, force: f64| {
                let location = &dictionary.locations[self.locations[k]];
                press(location.position, location.normal, force, diameter)
            };
            all.push([contact(i, fi), contact(j, fj)]);
        }
        all
    }
}

fn press(position: Point3<f64>, normal: Vector3<f64>, force: f64, diameter: f64) -> Indentation {
    Indentation::sphere(position, -normal * force, diameter)
}

#[cfg(test)]
mod tests {
    use dermis_model::ForwardModel;

    use super::*;
    use crate::settings::Settings;
    use crate::testing::{grid, press};

    const DIAMETER: f64 = 0.004;
    const FORCE_MAX: f64 = 3.0;
    const APART: f64 = 0.008;

    /// The best pairs for what presses of these forces \[N\] at two locations read together, as if a force could pull.
    fn best(forces: [f64; 2]) -> Vec<[Indentation; 2]> {
        let toy = grid(1.0);
        let gains = vec![1.0; toy.channels()];
        let dictionary =
            Dictionary::new(&toy, (None, None), 0.002, &Settings::new(DIAMETER, FORCE_MAX), &gains).unwrap();
        let mut sum = vec![0.0; toy.channels()];
        for (x, force) in [-0.008, 0.008].into_iter().zip(forces) {
            let out = toy.read(&[press(x, 0.0, force.abs())]);
            sum.iter_mut().zip(&out).for_each(|(s, o)| *s += force.signum() * o);
        }
        let data: Vec<Datum> = sum.into_iter().map(|v| Datum::Exact(v, 1.0)).collect();
        let found = Pairs::new(&dictionary, 0.002).best(&dictionary, &data, (APART, FORCE_MAX, DIAMETER), 4);
        for [a, b] in &found {
            for contact in [a, b] {
                let pressing = -contact.force.z;
                assert!(pressing > 0.0 && pressing <= FORCE_MAX, "{pressing} N for {forces:?}");
            }
            assert!((a.position - b.position).norm() >= APART, "{} and {}", a.position, b.position);
        }
        found
    }

    #[test]
    fn the_best_pair_is_the_one_that_presses() {
        let found = best([1.0, 2.0]);
        let [a, b] = &found[0];
        let (left, right) = if a.position.x < b.position.x { (a, b) } else { (b, a) };
        for (contact, (x, force)) in [(left, (-0.008, 1.0)), (right, (0.008, 2.0))] {
            assert!((contact.position - Point3::new(x, 0.0, 0.0)).norm() < 0.003, "{}", contact.position);
            assert!((-contact.force.z - force).abs() < 0.3 * force, "{} N", -contact.force.z);
        }
    }

    #[test]
    fn nothing_pulls_and_nothing_is_pressed_too_hard() {
        // `best` itself looks at every force.
        best([1.0, -0.6]);
        best([-0.6, 1.0]);
        best([2.9, 4.5]);
    }
}
