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
    change: OnceLock<Result<Bicubic, MechanicsError>>,
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
            })
            .as_ref()
            .map_err(Clone::clone)?;
        let mut sums = vec![0.0; change.width()];
        change.add(contact.position.x, contact.position.y, 1.0, &mut sums);
        let force = contact.force;
        for (o, a) in out.iter_mut().zip(sums.chunks_exact(3)) {
            *o += a[0] * force.x + a[1] * force.y + a[2] * force.z;
        }
        Ok(())
    }
}
