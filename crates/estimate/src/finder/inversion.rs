//! Contacts of maximum likelihood on a forward model.

use dermis_inversion::{Found, Inverter, SparseSettings};
use dermis_model::Indentation;
use dermis_skin::{Contact, ForceComponents};

use super::{ConditionedFrame, ContactFinder, FindError, readings};

/// What an inverter found, as a contact.
#[must_use]
pub fn inverted(found: &Found, components: ForceComponents) -> Contact {
    let mut contact = Contact::at(found.position, found.normal);
    contact.force = found.force;
    contact.force_components = components;
    contact.position_covariance = found.position_covariance;
    contact.force_covariance = found.force_covariance;
    contact
}

/// Where a search for the contacts begins.
pub enum Start {
    /// One contact after the other, as long as another one explains the readings better.
    Greedy,
    /// The best of all pairs of places.
    Pairs,
    /// What another finder finds; refined together.
    Refine(Box<dyn ContactFinder>),
    /// What another finder finds is where the first contact is looked for; where nothing is found, its answer stands.
    Hint(Box<dyn ContactFinder>),
    /// Sparse recovery on a grid of places; refined.
    Sparse(SparseSettings),
    /// Sparse recovery by itself.
    SparseOnly(SparseSettings),
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

    /// What it inverts.
    #[must_use]
    pub fn inverter(&self) -> &Inverter {
        &self.inverter
    }
}

impl ContactFinder for InversionFinder {
    fn find(&mut self, frame: &ConditionedFrame<'_>) -> Result<Vec<Contact>, FindError> {
        let Self { inverter, start } = self;
        let (diameter, components) =
            (inverter.settings().diameter, inverter.settings().unknowns.force_components());
        let indentation = |c: &Contact| Indentation::sphere(c.position, c.force, diameter);
        let readings: Vec<_> = readings(frame.signal, frame.flags).collect();
        let solution = match start {
            Start::Greedy => inverter.solve(&readings, None)?,
            Start::Pairs => inverter.search(&readings)?,
            Start::Hint(finder) => {
                let learned = finder.find(frame)?;
                let hint = learned.first().filter(|contact| contact.normal_force() > 0.0).map(indentation);
                let solution = inverter.solve(&readings, hint.as_ref())?;
                if solution.contacts.is_empty() {
                    return Ok(learned);
                }
                solution
            }
            Start::Refine(_) | Start::Sparse(_) | Start::SparseOnly(_) => {
                let starts: Vec<Indentation> = match start {
                    Start::Refine(finder) => finder.find(frame)?.iter().map(indentation).collect(),
                    Start::Sparse(settings) | Start::SparseOnly(settings) => {
                        inverter.sparse(&readings, settings)?
                    }
                    _ => Vec::new(),
                };
                if starts.is_empty() {
                    return Ok(Vec::new());
                }
                if matches!(start, Start::SparseOnly(_)) {
                    return Ok(starts.iter().map(|c| placed(inverter, c, components)).collect());
                }
                inverter.refine(&readings, &starts)?
            }
        };
        Ok(solution.contacts.iter().map(|found| inverted(found, components)).collect())
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
