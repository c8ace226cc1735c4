//! Minima as contacts with their errors.
//!
//! A contact that the readings locate has the covariance (JᵀJ)⁻¹ of least squares, scaled by what the minimum leaves beyond noise. One
//! whose place is all but open is answered by its posterior mean over the dictionary: locations are equally likely by their area, the
//! force at each is Gaussian and cut off at 0, and within the pitch of the dictionary all stays open. That costs one product with the dictionary.
//! What the best minimum leaves beyond noise counts as noise there, too ([`Inverter::excess`]).

use dermis_model::{Unknowns, tangents};
use nalgebra::{DMatrix, Matrix3, Point3, Vector3};

use super::{Inverter, counted, residuals};
use crate::contact::ContactEstimate;
use crate::dictionary::Location;
use crate::fit::{Datum, Minimum};
use crate::settings::{ForcePrior, Search};

/// Units of a sum of squared deviations that a place explains less than the best, from which on its weight is below 10⁻⁶.
const WEIGHTLESS: f32 = 30.0;

impl Inverter {
    pub(super) fn describe(&self, minimum: &Minimum, data: &[Datum]) -> Vec<ContactEstimate> {
        let per_contact = self.settings.unknowns.count();
        let counted = counted(data);
        let freedom = counted.saturating_sub(per_contact * minimum.contacts.len());
        // Where model and readings differ by more than noise, the error is more than noise makes.
        let inflation = if freedom > 0 { (minimum.chi2 / freedom as f64).max(1.0) } else { 1.0 };
        minimum
            .contacts
            .iter()
            .enumerate()
            .map(|(i, contact)| {
                let (position, normal) = self.model.0.surface().project(&contact.position);
                let block = minimum.covariance.as_ref().map(|c| {
                    c.view((i * per_contact, i * per_contact), (per_contact, per_contact)).into_owned()
                });
                let (location, force) = covariances(self.settings.unknowns, &normal, block.as_ref());
                ContactEstimate {
                    position,
                    normal,
                    force: contact.force,
                    diameter: contact.diameter(),
                    position_covariance: location * inflation,
                    force_covariance: force * inflation,
                }
            })
            .collect()
    }

    /// Mean and covariance of one contact over all locations and forces, each as likely as any other before the reading; `excess` by which
    /// the noise counts.
    pub(super) fn mean(&self, data: &[Datum], sharp: &ContactEstimate, excess: f64) -> ContactEstimate {
        let levels = &self.dictionary.forces;
        let mut terms: Vec<(f64, f64, f64, usize)> = Vec::with_capacity(self.dictionary.locations.len());
        let mut least = f64::INFINITY;
        for location in self.likely(data) {
            // The level whose force comes out nearest to itself.
            let mut chosen: Option<(f64, f64, f64, f64)> = None;
            for (level, force) in levels.iter().enumerate() {
                let (mut dot, mut square, mut whole) = (0.0, 0.0, 0.0);
                let response = self.dictionary.response(location, level);
                for (value, datum) in response.iter().zip(data) {
                    let Datum::Exact(reading, weight) = *datum else { continue };
                    let v = f64::from(*value) * weight / force;
                    dot += v * reading * weight;
                    square += v * v;
                    whole += (reading * weight).powi(2);
                }
                if square <= 0.0 {
                    continue;
                }
                let found = dot / square;
                let off = (found.max(1e-6) / force).ln().abs();
                if chosen.is_none_or(|(o, ..)| off < o) {
                    chosen = Some((off, found, square, whole - dot * dot / square));
                }
            }
            if let Some((_, found, square, chi2)) = chosen {
                least = least.min(chi2);
                terms.push((found, square, chi2, location));
            }
        }
        let (mut total, mut force, mut force_square) = (0.0, 0.0, 0.0);
        let (mut location, mut second) = (Vector3::zeros(), Matrix3::zeros());
        for (found, square, chi2, index) in terms {
            let spot = &self.dictionary.locations[index];
            // The force is Gaussian about `found`, cut off at 0 (and, far away, at the largest).
            let deviation = (excess / square).sqrt();
            let (mass, mean, variance) = truncated(found, deviation);
            let mass = match self.settings.force_prior {
                ForcePrior::Uniform => mass,
                ForcePrior::Log if found > self.settings.force_max + 2.0 * deviation => continue,
                ForcePrior::Log => mass / mean.max(1e-9),
            };
            let weight = spot.area * mass * deviation * (-(chi2 - least) / (2.0 * excess)).exp();
            total += weight;
            force += weight * mean;
            force_square += weight * (variance + mean * mean);
            location += spot.position.coords * weight;
            second += (spot.position.coords * spot.position.coords.transpose() + self.cell(spot)) * weight;
        }
        if !(total > 0.0 && total.is_finite()) {
            return sharp.clone();
        }
        let mean = location / total;
        let (position, normal) = self.model.0.surface().project(&Point3::from(mean));
        let pressing = (force / total).min(self.settings.force_max * 1.5);
        let variance = (force_square / total - pressing * pressing).max(0.0);
        // Presses of the dictionary are straight: a shear that is looked for is as open as the sharp answer says.
        let across = Matrix3::identity() - normal * normal.transpose();
        let shear = match self.settings.unknowns {
            Unknowns::Full => across * sharp.force_covariance * across,
            _ => Matrix3::zeros(),
        };
        ContactEstimate {
            position,
            normal,
            force: -normal * pressing,
            diameter: sharp.diameter,
            position_covariance: second / total - mean * mean.transpose(),
            force_covariance: normal * normal.transpose() * variance + shear,
        }
    }
}

impl Inverter {
    /// Takes into the covariances what is known before the reading: that the place is on the surface, and that a force is no more than the
    /// largest. Without it, readings that hardly fix a contact leave it kilometres open.
    pub(super) fn bound(&self, contact: &mut ContactEstimate) {
        let strongest = self.settings.force_max.powi(2);
        let axis = contact.normal * contact.normal.transpose();
        let surface = Matrix3::identity() - axis;
        let forces = if self.settings.unknowns == Unknowns::Full { Matrix3::identity() } else { axis };
        contact.position_covariance = bounded(&contact.position_covariance, self.anywhere, &surface);
        contact.force_covariance = bounded(&contact.force_covariance, strongest, &forces);
    }

    /// \[m²\] covariance of a place that is somewhere in the cell of a location of the dictionary.
    fn cell(&self, location: &Location) -> Matrix3<f64> {
        let [first, second] = tangents(&location.normal);
        let along = |axis: Vector3<f64>| axis * axis.transpose() * (self.spacing * self.spacing / 12.0);
        along(first) + if self.line.is_some() { Matrix3::zeros() } else { along(second) }
    }

    /// Locations of the dictionary that a mean over all has to evaluate. On a skin of very many elements, those that explain so much less than the best
    /// that they weigh nothing follow from one product.
    fn likely(&self, data: &[Datum]) -> Vec<usize> {
        let all = 0..self.dictionary.locations.len();
        let whole = data.iter().all(|datum| matches!(datum, Datum::Exact(..)));
        if !whole || self.settings.search != Search::Near {
            return all.collect();
        }
        let left = residuals(data, &vec![0.0; data.len()]);
        let scores: Vec<f32> = self.dictionary.project(&left).map(|score| score * score).collect();
        let best = scores.iter().copied().fold(0.0, f32::max);
        all.filter(|location| scores[*location] > best - WEIGHTLESS).collect()
    }
}

/// Covariances of place and force in the frame of the link from those of the unknowns; unknown where `block` is.
fn covariances(
    unknowns: Unknowns,
    normal: &Vector3<f64>,
    block: Option<&DMatrix<f64>>,
) -> (Matrix3<f64>, Matrix3<f64>) {
    let Some(block) = block else {
        return (
            Matrix3::from_diagonal_element(f64::INFINITY),
            Matrix3::from_diagonal_element(f64::INFINITY),
        );
    };
    let [first, second] = tangents(normal);
    let (along, forces): (Vec<Vector3<f64>>, Vec<Vector3<f64>>) = match unknowns {
        Unknowns::Line => (vec![first], vec![-normal]),
        Unknowns::Normal => (vec![first, second], vec![-normal]),
        Unknowns::Full => (vec![first, second], vec![-normal, first, second]),
    };
    let spread = |axes: &[Vector3<f64>], from: usize| {
        let mut all = Matrix3::zeros();
        for (i, a) in axes.iter().enumerate() {
            for (j, b) in axes.iter().enumerate() {
                all += a * b.transpose() * block[(from + i, from + j)];
            }
        }
        all
    };
    (spread(&along, 0), spread(&forces, along.len()))
}

/// A covariance with prior knowledge of this variance along each of its directions, (C⁻¹ + P⁻¹)⁻¹; `directions` projects on those that vary, for a
/// covariance that is unknown.
fn bounded(covariance: &Matrix3<f64>, variance: f64, directions: &Matrix3<f64>) -> Matrix3<f64> {
    if !covariance.iter().all(|v| v.is_finite()) {
        return directions * variance;
    }
    let mut eigen = covariance.symmetric_eigen();
    eigen.eigenvalues.apply(|v| *v = v.max(0.0) * variance / (v.max(0.0) + variance));
    eigen.recompose()
}

/// Mass, mean and variance of a Gaussian that is cut off below 0.
fn truncated(mean: f64, deviation: f64) -> (f64, f64, f64) {
    let z = mean / deviation;
    let mass = 0.5 * libm::erfc(-z / std::f64::consts::SQRT_2);
    if mass < 1e-12 {
        // Far below 0 the rest is exponential.
        let scale = deviation / z.abs();
        return (mass, scale, scale * scale);
    }
    let ratio = (-z * z / 2.0).exp() / (std::f64::consts::TAU.sqrt() * mass);
    let variance = deviation * deviation * (1.0 - ratio * (z + ratio));
    (mass, mean + deviation * ratio, variance.max(0.0))
}
