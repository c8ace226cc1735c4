//! What the free sides of a flat elastomer change.
//!
//! Near its edge, an elastomer that ends there gives way to the side: [`free_sides`] says how that is felt. A contact acts at
//! its centre here, and is as wide as on a layer without end.

use std::sync::OnceLock;

use dermis_mechanics::MechanicsError;
use dermis_mechanics::fem::{Bicubic, Probe, free_sides};
use dermis_skin::Indentation;

/// What the free sides of a block change in each channel.
#[derive(Debug)]
pub(super) struct Rim {
    size: [f64; 2],
    thickness: f64,
    poisson_ratio: f64,
    slip: f64,
    probes: Vec<Probe>,
    /// Solved when first asked for: some seconds of work that a model without contacts can do without.
    /// One for the force along each axis: most contacts do without two of them.
    change: OnceLock<Result<[Bicubic; 3], MechanicsError>>,
}

impl Rim {
    /// Sides of a block of `size` and `thickness` \[m\], whose probes lie in it.
    pub(super) fn new(
        size: [f64; 2],
        thickness: f64,
        poisson_ratio: f64,
        slip: f64,
        probes: Vec<Probe>,
    ) -> Self {
        Self { size, thickness, poisson_ratio, slip, probes, change: OnceLock::new() }
    }

    /// Adds what the sides change in the stress \[Pa\] under `contact` to `out`.
    ///
    /// # Errors
    ///
    /// [`MechanicsError`] where the block cannot be solved.
    pub(super) fn add(&self, contact: &Indentation, out: &mut [f64]) -> Result<(), MechanicsError> {
        let change = self
            .change
            .get_or_init(|| {
                free_sides(self.size, self.thickness, self.poisson_ratio, self.slip, &self.probes)
                    .map(|change| [0, 1, 2].map(|axis| change.every(3, axis)))
            })
            .as_ref()
            .map_err(Clone::clone)?;
        for (change, force) in change.iter().zip(contact.force.iter()) {
            if *force != 0.0 {
                change.add(contact.position.x, contact.position.y, *force, out);
            }
        }
        Ok(())
    }
}
