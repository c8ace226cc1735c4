//! The model discrepancy: what the simulator itself may have wrong.
//!
//! Kennedy and O'Hagan (2001) add a discrepancy to a model that is calibrated; Kaipio and Somersalo (2007) marginalise over
//! approximation errors. Here its columns are numbers of data sheets within their tolerance, the tip, and the laws of contact and of
//! spread that every model simplifies; selection gives them a prior.

use dermis_skin::SkinDescription;

use super::{Changes, Signatures, central};
use crate::algebra::{components, mean};
use crate::constants::signatures::{DISCREPANCIES, DISCREPANCY, LAW, TOLERANCE};
use crate::samples::Samples;
use crate::statistics::Column;
use crate::zero_level::ZeroLevel;

/// A change of a field over the distance, in units of its width.
type Shape = fn(f64) -> f64;

/// Changes of the spread of a contact over distance.
const SHAPES: [(&str, Shape); 3] = [
    ("height of the spread", |q| (-q * q).exp()),
    ("width of the spread", |q| q * q * (-q * q / 4.0).exp()),
    ("tail of the spread", |q| q * q / (1.0 + q * q)),
];

/// Where samples and channels are.
struct Field<'a> {
    samples: &'a Samples,
    skin: &'a SkinDescription,
    noise: &'a [f64],
    nominal: &'a [f32],
    zero: &'a ZeroLevel,
    owners: Vec<usize>,
}

impl Field<'_> {
    /// What touches make the nominal model read: laws of contact and spread say nothing of what it reads untouched.
    fn signal(&self, sample: usize, channel: usize) -> f64 {
        self.zero.signal(channel, f64::from(self.nominal[sample * self.noise.len() + channel]))
    }

    /// \[m\] from the contact to a channel's taxel; NaN where nothing touches.
    fn distance(&self, sample: usize, channel: usize) -> f64 {
        let p = self.samples.list[sample].position;
        let t = self.skin.taxels[self.owners[channel]].position;
        let square: f64 = p.iter().zip(t).map(|(a, b)| (a - b).powi(2)).sum();
        square.sqrt()
    }

    /// \[m\] mean distance from which channels see contacts, weighted by the energy of signals.
    fn width(&self) -> f64 {
        let (mut scale, mut weight) = (0.0, 0.0);
        for i in 0..self.samples.list.len() {
            for k in 0..self.noise.len() {
                let (d, s) = (self.distance(i, k), self.signal(i, k).powi(2));
                if d.is_finite() {
                    scale += s * d;
                    weight += s;
                }
            }
        }
        scale / f64::max(weight, 1e-300)
    }

    fn whitened(&self, value: impl Fn(usize, usize) -> f64) -> Vec<f32> {
        let channels = self.noise.len();
        (0..self.samples.list.len() * channels)
            .map(|i| {
                let (sample, k) = (i / channels, i % channels);
                (value(sample, k) / self.noise[k]) as f32
            })
            .collect()
    }

    /// Another exponent of the force.
    fn exponent(&self) -> Vec<f32> {
        let list = &self.samples.list;
        let forces: Vec<f64> = list.iter().filter(|s| s.force > 0.0).map(|s| s.force.ln()).collect();
        let level = mean(&forces);
        self.whitened(|i, k| {
            let force = list[i].force;
            if force > 0.0 { LAW * self.signal(i, k) * (force.ln() - level) } else { 0.0 }
        })
    }
}

impl Signatures {
    /// Adds the columns of the model discrepancy.
    pub(super) fn add_discrepancy(
        &mut self,
        changes: Changes,
        skin: &SkinDescription,
        samples: &Samples,
        noise: &[f64],
    ) {
        let mut vectors = Vec::new();
        // A skin's own table of the medium is what its data sheet states; deeper numbers are hypotheses only.
        let stated =
            |path: &String| path.strip_prefix("medium.").is_some_and(|key| !key.contains(['.', '[']));
        for (path, sides) in changes.numbers.into_iter().filter(|(path, _)| stated(path)) {
            if let Some(mut change) = central(&sides) {
                change.iter_mut().for_each(|v| *v *= TOLERANCE as f32);
                vectors.push(change);
                self.discrepancy_names.push(path);
            }
        }
        for (name, sides) in changes.tolerances {
            if let Some(change) = central(&sides) {
                vectors.push(change);
                self.discrepancy_names.push(name);
            }
        }
        let (nominal, zero) = (&self.nominal, &self.zero);
        let field = Field { samples, skin, noise, nominal, zero, owners: skin.channel_taxels() };
        vectors.push(field.exponent());
        self.discrepancy_names.push("exponent of the force".to_owned());
        let width = field.width();
        if width > 0.0 {
            for (name, shape) in SHAPES {
                vectors.push(field.whitened(|i, k| {
                    let q = field.distance(i, k) / width;
                    if q.is_finite() { LAW * field.signal(i, k) * shape(q) } else { 0.0 }
                }));
                self.discrepancy_names.push(name.to_owned());
            }
            // Depth of all taxels together, as a share of the distance that they see contacts from.
            if let Some(slope) = central(&changes.taxels[2]) {
                vectors.push(slope.iter().map(|v| v * (LAW * width) as f32).collect());
                self.discrepancy_names.push("depth of all taxels".to_owned());
            }
        }
        // Many tolerances at once: components of their sum, not of their mean.
        let (mut found, _) = components(&vectors, DISCREPANCY, DISCREPANCIES);
        let back = (vectors.len() as f32).sqrt();
        for values in &mut found {
            values.iter_mut().for_each(|v| *v *= back);
            self.discrepancy.push(self.columns.len());
            self.columns.push(Column { channel: None, values: std::mem::take(values) });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::statistics::tests::samples;

    #[test]
    fn laws_of_contact_scale_signals_and_not_untouched_readings() {
        let skin = crate::testing::skin();
        let mut samples = samples(&[0, 0, 1, 1]);
        for (i, sample) in samples.list.iter_mut().enumerate() {
            (sample.force, sample.contacts) = (0.2 + 0.2 * i as f64, 1);
            sample.position = [0.003 * i as f64, 0.001, 0.0];
        }
        let signals: Vec<f32> = (0..12).map(|i| 64.0 * i as f32).collect();
        let raised: Vec<f32> = signals.iter().enumerate().map(|(i, s)| s + 1000.0 * (i % 3) as f32).collect();
        let untouched = dermis_model::Untouched::from(vec![0.0, 1000.0, 2000.0]);
        let zero = ZeroLevel::new(&untouched, &untouched, false);
        let nothing = ZeroLevel::default();
        let field = |nominal, zero| Field {
            samples: &samples,
            skin: &skin,
            noise: &[5.0; 3],
            nominal,
            zero,
            owners: skin.channel_taxels(),
        };
        let (plain, raised) = (field(&signals, &nothing), field(&raised, &zero));
        assert_eq!(plain.exponent(), raised.exponent());
        assert_eq!(plain.width(), raised.width());
        assert!(plain.exponent().iter().any(|v| v.abs() > 1.0));
    }
}
