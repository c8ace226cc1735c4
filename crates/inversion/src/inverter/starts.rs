//! Where a search begins with one contact more.
//!
//! A start needs not be right: all contacts are refined together on the forward model from there.

use dermis_model::{Indentation, Unknowns, tangents};
use nalgebra::Vector3;

use super::{Inverter, residuals};
use crate::fit::{Datum, Minimum};

/// Starts of a further contact that are tried.
const STARTS: usize = 2;

/// Spacings of the dictionary that these are apart.
pub(super) const APART: f64 = 3.0;

/// Ways to begin with one contact more.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Start {
    /// Where the dictionary explains most of what is left.
    Dictionary,
    /// At both sides of the contact that was found last.
    Split,
}

impl Inverter {
    /// Where to begin with one contact more than `best` has.
    pub(super) fn starts(&self, kind: Start, data: &[Datum], best: &Minimum) -> Vec<Vec<Indentation>> {
        let with = |contact: Indentation| {
            let mut all = best.contacts.clone();
            all.push(contact);
            all
        };
        match kind {
            Start::Dictionary => {
                self.matches(data, &best.signal, STARTS, APART).into_iter().map(with).collect()
            }
            // Two contacts that stand close look like one between them.
            Start::Split => {
                let Some((last, others)) = best.contacts.split_last() else { return Vec::new() };
                let surface = self.model.0.surface();
                let (location, normal) = surface.project(&last.position);
                let directions = if self.settings.unknowns == Unknowns::Line { 1 } else { 2 };
                let half = |by: Vector3<f64>| {
                    let (position, normal) = surface.project(&(location + by));
                    Indentation { position, force: -normal * (last.force.norm() / 2.0), ..last.clone() }
                };
                tangents(&normal)[..directions]
                    .iter()
                    .map(|along| {
                        others
                            .iter()
                            .cloned()
                            .chain([half(along * self.stride()), half(along * -self.stride())])
                            .collect()
                    })
                    .collect()
            }
        }
    }

    /// Contacts of the dictionary that explain whitened residuals best, no two of them within so many spacings of each other.
    pub(crate) fn matches(
        &self,
        data: &[Datum],
        signal: &[f64],
        most: usize,
        spacings: f64,
    ) -> Vec<Indentation> {
        let left = residuals(data, signal);
        let mut scores: Vec<(f32, usize)> = self.dictionary.explained(&left).zip(0..).collect();
        scores.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut chosen: Vec<Indentation> = Vec::new();
        for (_, index) in scores {
            let location = &self.dictionary.locations[index];
            if chosen.len() == most {
                break;
            }
            if chosen.iter().any(|c| (c.position - location.position).norm() < spacings * self.spacing) {
                continue;
            }
            chosen.push(self.pressed(index, &left));
        }
        chosen
    }

    /// A press at a place of the dictionary, with the force that explains whitened residuals best.
    pub(crate) fn pressed(&self, index: usize, left: &[f32]) -> Indentation {
        let location = &self.dictionary.locations[index];
        // The level whose force changes least.
        let force = (0..self.dictionary.forces.len())
            .map(|level| {
                let (mut dot, mut square) = (0.0, 0.0);
                let response = self.dictionary.response(index, level).iter().zip(self.model.0.noise());
                for ((value, noise), residual) in response.zip(left) {
                    let v = f64::from(*value) / noise;
                    dot += v * f64::from(*residual);
                    square += v * v;
                }
                if square > 0.0 { dot / square } else { 0.0 }
            })
            .zip(&self.dictionary.forces)
            .min_by(|a, b| (a.0.max(1e-9).ln().abs()).total_cmp(&b.0.max(1e-9).ln().abs()))
            .map_or(0.0, |(share, force)| share * force);
        let pressing = force.clamp(1e-3, self.settings.force_max);
        let lean = self.dictionary.lean(index, left);
        let axes = tangents(&location.normal);
        let shear = axes[0] * (lean[0] * pressing) + axes[1] * (lean[1] * pressing);
        self.settings.indentation(location.position, shear - location.normal * pressing)
    }
}
