//! Contacts of maximum likelihood on a forward model.
//!
//! Problem: places and forces of contacts whose readings, as the forward model has them, are those of a frame. Method: least
//! squares in units of the noise ([`Inverter`]), begun in one of several ways ([`Start`]). Each frame is taken by itself. Cost:
//! that of the inverter, a millisecond or so for one contact, tens of them for all pairs of places.

use dermis_inversion::{Found, Inverter, InverterError, Reading, Solution, SparseSettings};
use dermis_model::Indentation;
use dermis_skin::{Contact, ForceComponents};

use super::{ConditionedFrame, ContactFinder, FindError, readings};

/// What an inverter found, as a contact.
pub(crate) fn inverted(found: &Found, components: ForceComponents) -> Contact {
    let mut contact = Contact::at(found.position, found.normal);
    contact.force = found.force;
    contact.force_components = components;
    contact.position_covariance = found.position_covariance;
    contact.force_covariance = found.force_covariance;
    contact
}

/// The contacts that explain readings best, in the manner that a bundle asks for: among all pairs of places, from those of
/// the frame `before` while they last; or one after the other, the first near what was `learned`.
pub(crate) fn solve(
    inverter: &Inverter,
    readings: &[Reading],
    learned: &[Contact],
    before: &[Found],
) -> Result<Solution, InverterError> {
    if inverter.settings().in_pairs() {
        return match inverter.follow(readings, before)? {
            Some(solution) => Ok(solution),
            None => inverter.search(readings),
        };
    }
    let known =
        |c: &&Contact| c.position.iter().chain(&c.force).all(|v| v.is_finite()) && c.normal_force() > 0.0;
    let hint = learned.first().filter(known);
    inverter.solve(readings, hint.map(|c| indentation(inverter, c)).as_ref())
}

/// A contact as what a forward model takes.
fn indentation(inverter: &Inverter, contact: &Contact) -> Indentation {
    Indentation::sphere(contact.position, contact.force, inverter.settings().diameter)
}

/// Where a search for the contacts begins.
pub enum Start {
    /// One contact after the other, as long as another one explains the readings better.
    Greedy,
    /// The best of all pairs of places.
    Pairs,
    /// What another finder finds; refined together.
    Refine(Box<dyn ContactFinder>),
    /// In the manner of the inverter's settings, as in a node: what another finder finds is where the first contact is
    /// looked for, unless all pairs are asked for. Where nothing is found, the answer of the other stands.
    Bundle(Box<dyn ContactFinder>),
    /// Sparse recovery on a grid of places; refined.
    Sparse(SparseSettings),
    /// Sparse recovery by itself.
    SparseOnly(SparseSettings),
}

impl Start {
    /// The finder that it asks first.
    fn other(&mut self) -> Option<&mut dyn ContactFinder> {
        match self {
            Self::Refine(finder) | Self::Bundle(finder) => Some(finder.as_mut()),
            Self::Greedy | Self::Pairs | Self::Sparse(_) | Self::SparseOnly(_) => None,
        }
    }
}

/// Maximum likelihood on a forward model.
pub struct InversionFinder {
    inverter: Inverter,
    start: Start,
}

impl InversionFinder {
    /// A finder that begins there.
    #[must_use]
    pub fn new(inverter: Inverter, start: Start) -> Self {
        Self { inverter, start }
    }

    /// Fits contacts to readings, all together.
    fn refine(&self, readings: &[Reading], starts: &[Indentation]) -> Result<Vec<Found>, InverterError> {
        if starts.is_empty() {
            return Ok(Vec::new());
        }
        Ok(self.inverter.refine(readings, starts)?.contacts)
    }
}

impl ContactFinder for InversionFinder {
    fn find(&mut self, frame: &ConditionedFrame<'_>) -> Result<Vec<Contact>, FindError> {
        let readings: Vec<_> = readings(frame.signal, frame.flags).collect();
        let others = self.start.other().map(|finder| finder.find(frame)).transpose()?.unwrap_or_default();
        let inverter = &self.inverter;
        let components = inverter.settings().unknowns.force_components();
        let found = match &self.start {
            Start::Greedy => inverter.solve(&readings, None)?.contacts,
            Start::Pairs => inverter.search(&readings)?.contacts,
            Start::Refine(_) => {
                let starts: Vec<_> = others.iter().map(|c| indentation(inverter, c)).collect();
                self.refine(&readings, &starts)?
            }
            Start::Bundle(_) => {
                let found = solve(inverter, &readings, &others, &[])?.contacts;
                if found.is_empty() {
                    return Ok(others);
                }
                found
            }
            Start::Sparse(settings) => self.refine(&readings, &inverter.sparse(&readings, settings)?)?,
            Start::SparseOnly(settings) => {
                let found = inverter.sparse(&readings, settings)?;
                return Ok(found.iter().map(|c| placed(inverter, c, components)).collect());
            }
        };
        Ok(found.iter().map(|found| inverted(found, components)).collect())
    }

    fn pass(&mut self, frame: &ConditionedFrame<'_>) -> Result<(), FindError> {
        self.start.other().map_or(Ok(()), |finder| finder.pass(frame))
    }

    fn reset(&mut self) {
        if let Some(finder) = self.start.other() {
            finder.reset();
        }
    }
}

/// An indentation that was found without its errors.
fn placed(inverter: &Inverter, at: &Indentation, components: ForceComponents) -> Contact {
    let (position, normal) = inverter.surface().project(&at.position);
    let mut contact = Contact::at(position, normal);
    contact.force = at.force;
    contact.force_components = components;
    contact
}
