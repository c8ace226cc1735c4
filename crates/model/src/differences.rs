//! Derivatives of a forward model by the unknowns of contacts, from central differences.
//!
//! Each unknown is moved a little either way and the difference of both responses divided by how far it really went: at an edge
//! of the surface, or of the range of forces, that is less than twice the step. The error is of second order in the step.
//! It costs two responses an unknown.

use dermis_skin::{ModelError, Surface};
use nalgebra::Vector3;

use crate::{ForwardModel, Indentation, Stimulus, Unknown, Unknowns, tangents};

/// What happens to the force of a contact that is moved along a curved surface.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MovedForce {
    /// It turns with the normal. Where shear is an unknown, it stays as it is in the frame of the link; where it is not, only the
    /// pressing part is left.
    Pressing,
    /// All of it turns with the surface, shear included.
    Turned,
}

/// How far unknowns are moved for their derivatives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Differences {
    /// \[m\] by which a place is moved.
    pub place: f64,
    /// Share of a force by which it is changed.
    pub force: f64,
    /// \[N\] by which a force is changed at least.
    pub least_force: f64,
    /// \[N\] between which a contact presses.
    pub pressing: [f64; 2],
    /// What happens to forces on the way.
    pub moved_force: MovedForce,
}

/// Share of the step below which nothing has moved.
const HELD: f64 = 1e-3;

impl Default for Differences {
    /// 50 µm, far below any pitch of taxels and far above what a table resolves; a thousandth of the force.
    fn default() -> Self {
        Self {
            place: 5e-5,
            force: 1e-3,
            least_force: 1e-6,
            pressing: [0.0, f64::INFINITY],
            moved_force: MovedForce::Pressing,
        }
    }
}

impl Differences {
    /// A contact with one unknown a little more and a little less, and how far they are apart: 0 where nothing can move.
    #[must_use]
    pub fn neighbours(
        &self,
        surface: &Surface,
        contact: &Indentation,
        unknowns: Unknowns,
        unknown: Unknown,
    ) -> (Indentation, Indentation, f64) {
        let by = match unknown {
            Unknown::Along(_) => self.place,
            _ => (contact.force.norm() * self.force).max(self.least_force),
        };
        let (more, up) = self.moved(surface, contact, unknowns, unknown, by);
        let (less, down) = self.moved(surface, contact, unknowns, unknown, -by);
        let span = up - down;
        (more, less, if span.abs() < by * HELD { 0.0 } else { span })
    }

    /// A contact with one unknown changed by `by`, and by how much it really was.
    #[must_use]
    pub fn moved(
        &self,
        surface: &Surface,
        contact: &Indentation,
        unknowns: Unknowns,
        unknown: Unknown,
        by: f64,
    ) -> (Indentation, f64) {
        let (place, normal) = surface.project(&contact.position);
        let axes = tangents(&normal);
        let with = |force| Indentation { force, ..contact.clone() };
        match unknown {
            Unknown::Along(k) => {
                let moved = self.shifted(surface, contact, unknowns, &(axes[k] * by));
                let done = (moved.position - place).dot(&axes[k]);
                (moved, done)
            }
            Unknown::Pressing => {
                let pressing = -contact.force.dot(&normal);
                // What pulls cannot press less.
                let [low, high] = self.pressing;
                let after = (pressing + by).clamp(low, high);
                (with(contact.force - normal * (after - pressing)), after - pressing)
            }
            Unknown::Shear(k) => (with(contact.force + axes[k] * by), by),
        }
    }

    /// A contact elsewhere, on the surface.
    #[must_use]
    pub fn shifted(
        &self,
        surface: &Surface,
        contact: &Indentation,
        unknowns: Unknowns,
        by: &Vector3<f64>,
    ) -> Indentation {
        let (place, normal) = surface.project(&contact.position);
        let (position, turned) = surface.project(&(place + by));
        let f = contact.force;
        let force = match self.moved_force {
            MovedForce::Pressing if unknowns == Unknowns::Full => f,
            MovedForce::Pressing => turned * f.dot(&normal),
            MovedForce::Turned if (turned - normal).norm() < 1e-12 => f,
            MovedForce::Turned => {
                let (before, after) = (tangents(&normal), tangents(&turned));
                turned * f.dot(&normal) + after[0] * f.dot(&before[0]) + after[1] * f.dot(&before[1])
            }
        };
        Indentation { position, force, ..contact.clone() }
    }

    /// [`ForwardModel::jacobian`] of any model.
    ///
    /// # Errors
    ///
    /// What the model says of stimuli near this one.
    pub fn jacobian<M: ForwardModel + ?Sized>(
        &self,
        model: &M,
        stimulus: &Stimulus,
        unknowns: Unknowns,
        out: &mut [f64],
    ) -> Result<(), ModelError> {
        let channels = model.channels();
        assert_eq!(out.len(), channels * unknowns.count() * stimulus.contacts.len());
        let mut moved = stimulus.clone();
        let mut less = vec![0.0; channels];
        let mut columns = out.chunks_exact_mut(channels.max(1));
        for (i, contact) in stimulus.contacts.iter().enumerate() {
            for unknown in unknowns.list() {
                let Some(column) = columns.next() else { break };
                let (plus, minus, step) = self.neighbours(model.surface(), contact, unknowns, *unknown);
                if step == 0.0 {
                    column.fill(0.0);
                    continue;
                }
                moved.contacts[i] = plus;
                model.response(&moved, column)?;
                moved.contacts[i] = minus;
                model.response(&moved, &mut less)?;
                column.iter_mut().zip(&less).for_each(|(c, l)| *c = (*c - l) / step);
            }
            moved.contacts[i] = contact.clone();
        }
        Ok(())
    }
}
