//! Coulomb's friction at tips that slide.

use std::sync::Arc;

use dermis_model::{Indentation, Stimulus};
use dermis_skin::Surface;

/// \[m/s\] above which a contact that moves is another contact.
const SLIDE_MAX: f64 = 1.0;
/// \[m\] from frame to frame below which a contact stands still: rounding.
const STILL: f64 = 1e-9;

/// Coulomb's friction at tips that slide. What a plan asks for beside it stays.
#[derive(Debug, Clone)]
pub struct Friction {
    coefficient: f64,
    surface: Arc<Surface>,
    /// Time of the last frame, and what touched then.
    before: Option<(f64, Vec<Indentation>)>,
}

impl Friction {
    /// Tangential force per normal force, on this surface.
    #[must_use]
    pub fn new(coefficient: f64, surface: Arc<Surface>) -> Self {
        Self { coefficient, surface, before: None }
    }

    /// Drags at what has moved since the last call, `time` in seconds.
    pub fn drag(&mut self, time: f64, stimulus: &mut Stimulus) {
        let contacts = stimulus.contacts.clone();
        if let Some((then, before)) = &self.before
            && before.len() == contacts.len()
        {
            let far = SLIDE_MAX * (time - then);
            for (contact, before) in stimulus.contacts.iter_mut().zip(before) {
                let (_, normal) = self.surface.project(&contact.position);
                let way = contact.position - before.position;
                let along = way - normal * way.dot(&normal);
                let moved = along.norm();
                if moved > STILL && moved <= far {
                    let pressing = (-contact.force.dot(&normal)).max(0.0);
                    contact.force += along * (self.coefficient * pressing / moved);
                }
            }
        }
        self.before = Some((time, contacts));
    }
}
