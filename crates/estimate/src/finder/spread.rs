//! Maps that belong to contacts: what a model gives by itself, and forces of contacts spread over the surface.

use dermis_inference::{MAP_DISPLACEMENT, MAP_NORMAL, Outputs};
use dermis_skin::{Contact, DisplacementMap, ForceMap, ForceValues, Surface};
use nalgebra::Vector3;

use crate::models::MAP_FORCE;

/// \[m\] about a contact of unknown diameter that its force is spread over.
pub(crate) const REACH: f64 = 0.005;

/// Maps over the surface that a model gave by itself for one frame.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct GivenMaps {
    /// Of forces.
    pub force: Option<ForceMap>,
    /// Of displacements.
    pub displacement: Option<DisplacementMap>,
}

impl GivenMaps {
    /// Those among the outputs of a model.
    pub(crate) fn of(outputs: &Outputs) -> Self {
        let map = |name: &str| outputs.values(name);
        Self { force: given_forces(map), displacement: given_displacements(map) }
    }
}

/// The force map that a model gives; `map` answers with the values of an output.
pub(crate) fn given_forces<'a>(map: impl Fn(&str) -> Option<&'a [f64]>) -> Option<ForceMap> {
    let forces = if let Some(map) = map(MAP_FORCE) {
        ForceValues::Vector(map.chunks_exact(3).map(|f| [f[0] as f32, f[1] as f32, f[2] as f32]).collect())
    } else {
        ForceValues::Normal(map(MAP_NORMAL)?.iter().map(|f| *f as f32).collect())
    };
    Some(ForceMap { indices: None, forces })
}

/// The displacement map that a model gives; `map` as above.
pub(crate) fn given_displacements<'a>(map: impl Fn(&str) -> Option<&'a [f64]>) -> Option<DisplacementMap> {
    let displacements = map(MAP_DISPLACEMENT)?.iter().map(|d| *d as f32).collect();
    Some(DisplacementMap { indices: None, displacements })
}

/// The forces of contacts over the surface: `whole`, or what presses alone.
pub(crate) fn spread_forces(surface: &Surface, contacts: &[Contact], whole: bool) -> ForceMap {
    let forces = match whole {
        true => ForceValues::Vector(spread_vectors(surface, contacts)),
        false => ForceValues::Normal(spread(surface, contacts)),
    };
    ForceMap { indices: None, forces }
}

/// \[N\] on every point of a surface: the pressing force of each contact on the points within its radius, shared by area.
/// The points add up to the contacts.
fn spread(surface: &Surface, contacts: &[Contact]) -> Vec<f32> {
    let mut forces = vec![0.0; surface.points.len()];
    for contact in contacts {
        let force = contact.normal_force();
        under(surface, contact).into_iter().for_each(|(i, share)| forces[i] += force * share);
    }
    forces.iter().map(|f| *f as f32).collect()
}

/// The same with all of the force of each contact.
fn spread_vectors(surface: &Surface, contacts: &[Contact]) -> Vec<[f32; 3]> {
    let mut forces = vec![Vector3::zeros(); surface.points.len()];
    for contact in contacts {
        under(surface, contact).into_iter().for_each(|(i, share)| forces[i] += contact.force * share);
    }
    forces.iter().map(|f: &Vector3<f64>| [f.x as f32, f.y as f32, f.z as f32]).collect()
}

/// Points within a contact's radius, and what share of its force each of them gets; the nearest one between the points of a coarse surface.
fn under(surface: &Surface, contact: &Contact) -> Vec<(usize, f64)> {
    let radius = if contact.diameter.is_finite() { f64::from(contact.diameter) / 2.0 } else { REACH };
    let points = surface.points.len();
    let distance = |i: usize| (surface.points[i] - contact.position).norm();
    let mut under: Vec<usize> = (0..points).filter(|i| distance(*i) <= radius).collect();
    if under.is_empty() {
        under.extend((0..points).min_by(|a, b| distance(*a).total_cmp(&distance(*b))));
    }
    let area: f64 = under.iter().map(|i| surface.areas[*i]).sum();
    let even = 1.0 / under.len() as f64;
    under.into_iter().map(|i| (i, if area > 0.0 { surface.areas[i] / area } else { even })).collect()
}
