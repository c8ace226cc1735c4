//! Maps over the surface.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use dermis_inference::{MAP_DISPLACEMENT, MAP_NORMAL};
use dermis_model::{Indentation, Stimulus, Unknowns};
use dermis_skin::{Contact, DisplacementMap, Estimate, ForceMap, ForceValues, Surface};
use nalgebra::Vector3;

use super::SkinEstimator;
use crate::models::{MAP_FORCE, Pipeline, gives};

/// \[m\] about a contact of unknown diameter that its force is spread over.
pub(super) const REACH: f64 = 0.005;

impl SkinEstimator {
    /// Whether a displacement map comes without delay. The first one of a forward model may take seconds: it is made ready on
    /// another thread from the first call on.
    pub fn displacements_ready(&mut self) -> bool {
        if gives(&self.pipelines, &[MAP_DISPLACEMENT]) {
            return true;
        }
        let Some(pipeline) = self.pipelines.iter_mut().find(|p| p.displaces) else { return false };
        if let Some(answered) = &pipeline.answered {
            return answered.load(Ordering::Acquire);
        }
        let answered = Arc::new(AtomicBool::new(false));
        pipeline.answered = Some(Arc::clone(&answered));
        let Some(model) = pipeline.inverter.as_ref().map(|i| Arc::clone(i.model())) else { return false };
        let ask = move || {
            let surface = model.surface();
            let mut out = vec![0.0; surface.points.len()];
            if let Some((position, normal)) = surface.points.first().zip(surface.normals.first()) {
                let press = Indentation::sphere(*position, -normal, REACH);
                // What it says of this press is of no interest.
                let _ =
                    model.displacement(&Stimulus { contacts: vec![press], ..Stimulus::default() }, &mut out);
            }
            answered.store(true, Ordering::Release);
        };
        if let Err(error) = std::thread::Builder::new().name("dermis-displacement".into()).spawn(ask) {
            tracing::warn!("skin `{}`: no displacement map: no thread: {error}", self.skin.name);
        }
        false
    }

    pub(super) fn map(&self, output: &str) -> Option<&[f64]> {
        self.pipelines.iter().filter(|p| p.fresh).find_map(|p| p.outputs.values(output))
    }

    /// What a learned model gives or, where none does, the forces of contacts that a forward model refined or that are peaks.
    pub(super) fn force_map(&self, contacts: &[Contact], refined: bool) -> Option<ForceMap> {
        let placed = refined || self.pipelines.iter().any(|p| p.fresh && p.peaks.is_some());
        let forces = if let Some(map) = self.map(MAP_FORCE) {
            ForceValues::Vector(
                map.chunks_exact(3).map(|f| [f[0] as f32, f[1] as f32, f[2] as f32]).collect(),
            )
        } else if let Some(map) = self.map(MAP_NORMAL) {
            ForceValues::Normal(map.iter().map(|f| *f as f32).collect())
        } else if placed {
            match self.knows_vectors() {
                true => ForceValues::Vector(spread_vectors(&self.surface, contacts)),
                false => ForceValues::Normal(spread(&self.surface, contacts)),
            }
        } else {
            return None;
        };
        Some(ForceMap { indices: None, forces })
    }

    /// Whether the force map has all of the forces and not what presses alone: a learned map says which; where there is none, contacts are
    /// spread, and the forward model that refines them knows.
    fn knows_vectors(&self) -> bool {
        let refines =
            |p: &Pipeline| p.inverter.as_ref().is_some_and(|i| i.settings().unknowns == Unknowns::Full);
        gives(&self.pipelines, &[MAP_FORCE])
            || !gives(&self.pipelines, &[MAP_NORMAL]) && self.pipelines.iter().any(refines)
    }

    /// What a learned model gives or, where none does, what the forward model that refined contacts makes of them.
    pub(super) fn displacement_map(
        &self,
        contacts: &[Contact],
        refined: Option<usize>,
    ) -> Option<DisplacementMap> {
        if let Some(map) = self.map(MAP_DISPLACEMENT) {
            let displacements = map.iter().map(|d| *d as f32).collect();
            return Some(DisplacementMap { indices: None, displacements });
        }
        let inverter = self.pipelines.get(refined?)?.inverter.as_ref()?;
        let settings = inverter.settings();
        let contacts = contacts.iter().map(|c| settings.indentation(c.position, c.force)).collect();
        let mut points = vec![0.0; self.surface.points.len()];
        let known = inverter.model().displacement(&Stimulus { contacts, ..Stimulus::default() }, &mut points);
        if !known.unwrap_or_else(|error| {
            tracing::debug!("skin `{}`: no displacement map: {error}", self.skin.name);
            false
        }) {
            return None;
        }
        Some(DisplacementMap { indices: None, displacements: points.iter().map(|d| *d as f32).collect() })
    }

    /// The maps of a skin that nothing touches.
    pub(super) fn untouched(&self) -> Estimate {
        let points = self.surface.points.len();
        let can = self.maps();
        let forces = if self.knows_vectors() {
            ForceValues::Vector(vec![[0.0; 3]; points])
        } else {
            ForceValues::Normal(vec![0.0; points])
        };
        let displacements = vec![0.0; points];
        Estimate {
            contacts: Vec::new(),
            force_map: (can.force && self.maps.force).then_some(ForceMap { indices: None, forces }),
            displacement_map: (can.displacement && self.maps.displacement)
                .then_some(DisplacementMap { indices: None, displacements }),
        }
    }
}

/// \[N\] on every point of a surface: the pressing force of each contact on the points within its radius, shared by area.
/// The points add up to the contacts.
pub(super) fn spread(surface: &Surface, contacts: &[Contact]) -> Vec<f32> {
    let mut forces = vec![0.0; surface.points.len()];
    for contact in contacts {
        let force = contact.normal_force();
        under(surface, contact).into_iter().for_each(|(i, share)| forces[i] += force * share);
    }
    forces.iter().map(|f| *f as f32).collect()
}

/// The same with all of the force of each contact.
pub(super) fn spread_vectors(surface: &Surface, contacts: &[Contact]) -> Vec<[f32; 3]> {
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
