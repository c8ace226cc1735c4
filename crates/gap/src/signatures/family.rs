//! Signatures of a family's effects: principal components of what their realisations change.

use dermis_skin::EffectInfo;

use super::{Candidate, Realisation, Signatures, drift};
use crate::algebra::{components, dot};
use crate::constants::signatures::{EACH, FEW, HELD, MOVED, PREDICTED, SAME, TOGETHER, WHOLE};
use crate::samples::Samples;
use crate::simulate::Simulator;
use crate::statistics::{Column, Gram, Statistics};

/// How a family's effect acts, as its realisations show it.
struct Shape {
    columns: Vec<Column>,
    per_channel: bool,
    drifts_randomly: bool,
    nonlinear: bool,
}

impl Shape {
    fn of(random: bool, realised: &[Realisation], samples: &Samples, channels: usize) -> Self {
        let vectors: Vec<&[f32]> = realised.iter().map(|(.., v)| v.as_slice()).collect();
        let per_channel = random && !predicted(realised);
        let pattern = random.then(|| drift::pattern(realised, samples, channels)).flatten();
        let mut nonlinear = random && pattern.is_none();
        let mut columns: Vec<Column> = Vec::new();
        if let Some(pattern) = &pattern {
            columns = drift::columns(samples, pattern, channels);
        } else if per_channel {
            // One for each channel says that it is in proportion.
            nonlinear = false;
            for k in 0..channels {
                let own: Vec<Vec<f32>> = vectors
                    .iter()
                    .map(|v| (0..samples.list.len()).map(|i| v[i * channels + k]).collect())
                    .collect();
                let (found, _) = components(&own, HELD, EACH);
                nonlinear |= found.len() > 1;
                columns.extend(found.into_iter().map(|values| Column { channel: Some(k), values }));
            }
        } else {
            let (found, _) = components(&vectors, HELD, TOGETHER);
            columns.extend(found.into_iter().map(|values| Column { channel: None, values }));
        }
        let drifts_randomly = pattern.is_some();
        Self { columns, per_channel: per_channel || drifts_randomly, drifts_randomly, nonlinear }
    }
}

impl Signatures {
    /// Adds a family's effect by the components of its realisations.
    pub(super) fn add_family(
        &mut self,
        info: &EffectInfo,
        realised: &[Realisation],
        samples: &Samples,
        channels: usize,
    ) {
        let readings = (samples.list.len() * channels).max(1) as f64;
        let moved = realised.iter().map(|(.., v)| (dot(v, v) / readings).sqrt()).fold(0.0, f64::max);
        if moved < MOVED {
            self.silent
                .push((info.name.to_owned(), "it does not move any reading in this recording".to_owned()));
            return;
        }
        let mut shape = Shape::of(info.random, realised, samples, channels);
        let first = self.columns.len();
        let norms: Vec<f64> = shape.columns.iter().map(|c| dot(&c.values, &c.values)).collect();
        let starts = if shape.per_channel {
            Vec::new()
        } else {
            let coordinates = |v: &[f32]| -> Vec<f64> {
                shape.columns.iter().zip(&norms).map(|(c, norm)| dot(&c.values, v) / norm).collect()
            };
            realised.iter().map(|(effect, _, v)| (effect.clone(), coordinates(v))).collect()
        };
        self.candidates.push(Candidate {
            name: info.name.to_owned(),
            what: info.what.to_owned(),
            family: true,
            rig: false,
            number: false,
            columns: (first..first + shape.columns.len()).collect(),
            per_channel: shape.per_channel,
            drifts_randomly: shape.drifts_randomly,
            nonlinear: shape.nonlinear,
            depends_on_uptime: false,
            written_as: None,
            aliases: Vec::new(),
            starts,
            linear: Vec::new(),
        });
        self.columns.append(&mut shape.columns);
    }

    /// A family's effect that a common one says as well, and the other way round, is that one under the family's name.
    pub(super) fn merge_equal(&mut self, simulator: &Simulator<'_>, samples: &Samples, channels: usize) {
        let nothing = vec![0.0f32; samples.list.len() * channels];
        let gram = Gram::of(&Statistics::new(&self.columns, &nothing, samples, channels));
        let mut merged: Vec<usize> = Vec::new();
        for f in 0..self.candidates.len() {
            if !(self.candidates[f].family && self.candidates[f].per_channel) {
                continue;
            }
            for c in 0..self.candidates.len() {
                let (family, common) = (&self.candidates[f], &self.candidates[c]);
                if common.family || !common.per_channel {
                    continue;
                }
                let there = gram.explained(&family.columns, &common.columns);
                let back = gram.explained(&common.columns, &family.columns);
                if there > SAME && back > SAME {
                    let common = common.clone();
                    let family = &mut self.candidates[f];
                    (family.columns, family.linear) = (common.columns, common.linear);
                    family.written_as = Some(common.name);
                    merged.push(c);
                    break;
                }
            }
        }
        let mut index = 0;
        self.candidates.retain(|_| {
            index += 1;
            !merged.contains(&(index - 1))
        });
        self.join_aliases(simulator, &gram);
    }
}

/// Whether components of all devices but one predict that one (leave-one-out).
fn predicted(realised: &[Realisation]) -> bool {
    let mut devices: Vec<Vec<f32>> =
        realised.iter().filter(|r| r.1.is_some()).map(|(.., v)| v.clone()).collect();
    // What all devices have in common says nothing of how they differ.
    let count = devices.len().max(1) as f32;
    let mut mean = vec![0.0f32; devices.first().map_or(0, Vec::len)];
    for device in &devices {
        mean.iter_mut().zip(device).for_each(|(m, v)| *m += v / count);
    }
    for device in &mut devices {
        device.iter_mut().zip(&mean).for_each(|(v, m)| *v -= m);
    }
    let mut shares = Vec::new();
    for left in 0..devices.len() {
        let others: Vec<&[f32]> =
            devices.iter().enumerate().filter(|(i, _)| *i != left).map(|(_, v)| v.as_slice()).collect();
        let (found, _) = components(&others, WHOLE, FEW);
        let target = &devices[left];
        let energy = dot(target, target);
        let held: f64 = found.iter().map(|c| dot(c, target).powi(2) / dot(c, c).max(1e-300)).sum::<f64>();
        shares.push(if energy > 0.0 { held / energy } else { 1.0 });
    }
    shares.sort_by(f64::total_cmp);
    shares.get(shares.len() / 2).is_some_and(|s| *s > PREDICTED)
}

#[cfg(test)]
mod tests {
    use dermis_skin::Effect;
    use rand::{Rng, SeedableRng};

    use super::*;

    #[test]
    fn devices_predict_each_other_only_where_few_numbers_make_them() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(2);
        let mut drawn = || rng.random_range(-1.0f32..1.0);
        let one: Vec<Realisation> = (0..8)
            .map(|d| {
                let size = drawn();
                (Effect::new("e"), Some(d), (0..50).map(|i| size * i as f32).collect())
            })
            .collect();
        assert!(predicted(&one));
        let each: Vec<Realisation> =
            (0..8).map(|d| (Effect::new("e"), Some(d), (0..50).map(|_| drawn()).collect())).collect();
        assert!(!predicted(&each));
    }
}
