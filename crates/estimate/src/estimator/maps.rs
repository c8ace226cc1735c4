//! Maps over the surface.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use dermis_inference::{MAP_DISPLACEMENT, MAP_NORMAL};
use dermis_model::{Indentation, Stimulus, Unknowns};
use dermis_skin::{Contact, DisplacementMap, Estimate, ForceMap, ForceValues};

use super::SkinEstimator;
use crate::finder::{REACH, given_displacements, given_forces, spread_forces};
use crate::models::{MAP_FORCE, Pipeline, gives};

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
        let spread = || spread_forces(&self.surface, contacts, self.knows_vectors());
        given_forces(|output| self.map(output)).or_else(|| placed.then(spread))
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
        if let Some(map) = given_displacements(|output| self.map(output)) {
            return Some(map);
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
