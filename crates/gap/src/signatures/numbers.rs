//! Signatures of the numbers of a description, and the joining of hypotheses that are one thing under several names.
//!
//! A number is simulated a tolerance above and below what the description says. Half of the difference is its slope; half of the sum is
//! its curvature, which is a second direction where a large change is not in proportion (Taylor's series to the second order).

use std::collections::BTreeMap;

use dermis_skin::SkinDescription;

use super::common::differences;
use super::{Candidate, Change, Signatures};
use crate::algebra::dot;
use crate::constants::signatures::{ALIAS, MOVED, REACH};
use crate::design;
use crate::samples::Samples;
use crate::simulate::Simulator;
use crate::statistics::Gram;

/// Changes by a large part of a number, from those by its tolerance.
fn extrapolated(sides: &[Change]) -> Vec<(String, Change)> {
    let named = |by: f64, values: Vec<f32>| (design::VALUE.to_owned(), (by, values));
    match sides {
        [(a, x), (b, y)] if *a == -*b => {
            let (along, across) = ((REACH / a) as f32, (REACH / a).powi(2) as f32);
            let at = |sign: f32| -> Vec<f32> {
                let each = x.iter().zip(y);
                each.map(|(x, y)| 0.5 * (sign * along * (x - y) + across * (x + y))).collect()
            };
            vec![named(REACH, at(1.0)), named(-REACH, at(-1.0))]
        }
        // The other side cannot be.
        [(a, x), ..] => vec![named(REACH, x.iter().map(|v| v * (REACH / a) as f32).collect())],
        [] => Vec::new(),
    }
}

impl Signatures {
    /// Adds a hypothesis for each number of the description that moves readings.
    pub(super) fn add_numbers(
        &mut self,
        skin: &SkinDescription,
        samples: &Samples,
        changes: &BTreeMap<String, Vec<Change>>,
    ) {
        let least = MOVED * ((samples.list.len() * skin.channels().len()) as f64).sqrt();
        for (path, sides) in changes {
            let Some(nominal) = design::value(skin, path) else { continue };
            let moves = sides.iter().any(|(_, change)| dot(change, change).sqrt() >= least);
            let parts = if moves { differences(extrapolated(sides)) } else { Vec::new() };
            if parts.is_empty() {
                continue;
            }
            let mut candidate = Candidate {
                name: path.clone(),
                what: "The device was built with another number than its description says.".to_owned(),
                family: false,
                rig: false,
                number: true,
                columns: Vec::new(),
                per_channel: false,
                drifts_randomly: false,
                nonlinear: false,
                depends_on_uptime: false,
                written_as: None,
                aliases: Vec::new(),
                starts: Vec::new(),
                linear: Vec::new(),
            };
            for part in parts {
                candidate.columns.push(self.columns.len());
                candidate.linear.push((path.clone(), part.parameter, part.amount * nominal));
                self.columns.push(part.column);
            }
            self.candidates.push(candidate);
        }
    }

    /// Joins hypotheses that are one thing under several names: memoryless, and each explaining the other at every press. The one that
    /// the family knows gives the name, then a common effect, then a number of the description.
    pub(super) fn join_aliases(&mut self, simulator: &Simulator<'_>, gram: &Gram) {
        let rank = |c: &Candidate| match c {
            c if c.family => 0,
            c if !c.number => 1,
            _ => 2,
        };
        let mut order: Vec<usize> = (0..self.candidates.len())
            .filter(|i| {
                let of = &self.candidates[*i];
                !(of.per_channel
                    || of.drifts_randomly
                    || of.depends_on_uptime
                    || simulator.is_stateful(&of.name))
            })
            .collect();
        order.sort_by_key(|i| rank(&self.candidates[*i]));
        let mut joined: Vec<usize> = Vec::new();
        for (n, &head) in order.iter().enumerate() {
            if joined.contains(&head) {
                continue;
            }
            for &other in &order[n + 1..] {
                let (a, b) = (&self.candidates[head], &self.candidates[other]);
                // How a number bends is beyond what an effect of small range shows of it.
                let own = |c: &Candidate| c.columns[..if c.number { 1 } else { c.columns.len() }].to_vec();
                let held = |of: &Candidate, by: &Candidate| gram.explained(&own(of), &by.columns) > ALIAS;
                let same = || held(a, b) && held(b, a);
                if !joined.contains(&other) && same() {
                    joined.push(other);
                    let name = self.candidates[other].name.clone();
                    self.candidates[head].aliases.push(name);
                }
            }
        }
        let mut index = 0;
        self.candidates.retain(|_| {
            index += 1;
            !joined.contains(&(index - 1))
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tolerances_are_extrapolated_to_the_second_order() {
        // 2 x + 8 x².
        let at = |x: f32| vec![2.0 * x + 8.0 * x * x];
        let found = extrapolated(&[(0.05, at(0.05)), (-0.05, at(-0.05))]);
        for (sign, (_, (by, values))) in [1.0f32, -1.0].into_iter().zip(&found) {
            assert_eq!(*by as f32, sign * REACH as f32);
            assert!((values[0] - at(sign * REACH as f32)[0]).abs() < 1e-5, "{values:?}");
        }
        let one = extrapolated(&[(-0.05, vec![0.1])]);
        assert_eq!(one[0].1.0, REACH);
        assert!((one[0].1.1[0] + 0.5).abs() < 1e-6);
    }
}
