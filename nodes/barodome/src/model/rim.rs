//! What the free sides of a flat elastomer change.
//!
//! Near its edge, an elastomer that ends there gives way to the side: [`free_sides`] says how that changes the readings. A contact is as wide
//! as on a layer without end. The change varies little over it, so that seven points stand for it: its centre, and six on the
//! ring that has the moments of its pressure ([`dermis_mechanics::SphereContact::ring`]). Acting at its centre alone, 1 N on a tip
//! of 4 mm would read some percent less, 3 mm from a side.

use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use dermis_mechanics::MechanicsError;
use dermis_mechanics::fem::{Bicubic, Probe, free_sides};
use dermis_model::Indentation;
use dermis_skin::cache::{Key, kept};

/// One for the force along each axis: most contacts do without two of them.
type Change = Arc<[Bicubic; 3]>;

/// Blocks that were solved in this process: a simulator and a node of one skin, or an estimator that is made again, solve
/// theirs once.
static SOLVED: Mutex<Vec<(Block, Change)>> = Mutex::new(Vec::new());
/// Blocks that are kept.
const KEPT: usize = 8;

/// What a solution depends on.
#[derive(Debug, Clone, PartialEq)]
struct Block {
    size: [f64; 2],
    thickness: f64,
    poisson_ratio: f64,
    slip: f64,
    probes: Vec<Probe>,
}

impl Block {
    fn solve(&self) -> Result<Change, MechanicsError> {
        // Others wait: what they want is most likely this. A solution is added whole.
        let mut solved = SOLVED.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, change)) = solved.iter().find(|(block, _)| block == self) {
            return Ok(Arc::clone(change));
        }
        let what = "what the free sides of the elastomer change (finite elements)";
        let change = kept(what, Key::new("free-sides").debug(self), || -> Result<_, MechanicsError> {
            let all = free_sides(self.size, self.thickness, self.poisson_ratio, self.slip, &self.probes)?;
            Ok(Arc::new([0, 1, 2].map(|axis| all.every(3, axis))))
        })?;
        if solved.len() >= KEPT {
            solved.remove(0);
        }
        solved.push((self.clone(), Arc::clone(&change)));
        Ok(change)
    }
}

/// What the free sides of a block change in each channel.
#[derive(Debug)]
pub(super) struct Rim {
    block: Block,
    /// Solved when first requested: some seconds of work that a model without contacts can do without.
    change: OnceLock<Result<Change, MechanicsError>>,
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
        Self { block: Block { size, thickness, poisson_ratio, slip, probes }, change: OnceLock::new() }
    }

    /// Adds what the sides change in the stress \[Pa\] under `contact` to `out`; `ring` is its radius \[m\] and its share of the
    /// force.
    ///
    /// # Errors
    ///
    /// [`MechanicsError`] where the block cannot be solved.
    pub(super) fn add(
        &self,
        contact: &Indentation,
        ring: (f64, f64),
        out: &mut [f64],
    ) -> Result<(), MechanicsError> {
        let change = self.change.get_or_init(|| self.block.solve()).as_ref().map_err(Clone::clone)?;
        for (change, force) in change.iter().zip(contact.force.iter()) {
            if *force != 0.0 {
                change.add_all(&spread(contact, ring, *force), out);
            }
        }
        Ok(())
    }
}

/// Points around a hexagon of radius 1.
const HEXAGON: [[f64; 2]; 6] = {
    let high = 0.866_025_403_784_438_6;
    [[1.0, 0.0], [0.5, high], [-0.5, high], [-1.0, 0.0], [-0.5, -high], [0.5, -high]]
};

/// Where a contact acts, and with how much of `force`.
fn spread(contact: &Indentation, (radius, share): (f64, f64), force: f64) -> [[f64; 3]; 7] {
    let (x, y) = (contact.position.x, contact.position.y);
    let mut points = [[x, y, (1.0 - share) * force]; 7];
    for (point, [u, v]) in points[1..].iter_mut().zip(HEXAGON) {
        *point = [x + radius * u, y + radius * v, share * force / 6.0];
    }
    points
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Point3, Vector3};

    #[test]
    fn seven_points_have_the_moments_of_the_contact() {
        let contact = Indentation::sphere(Point3::new(0.003, -0.002, 0.0), -Vector3::z(), 0.004);
        let (radius, share) = (0.0013, 0.72);
        let points = spread(&contact, (radius, share), -2.0);
        let sum = |of: &dyn Fn(f64, f64) -> f64| -> f64 {
            points.iter().map(|[x, y, weight]| weight * of(x - 0.003, y + 0.002)).sum()
        };
        assert!((sum(&|_, _| 1.0) + 2.0).abs() < 1e-12);
        assert!(sum(&|x, _| x).abs() < 1e-15 && sum(&|_, y| y).abs() < 1e-15);
        let second = -2.0 * share * radius * radius / 2.0;
        assert!((sum(&|x, _| x * x) / second - 1.0).abs() < 1e-9);
        assert!((sum(&|_, y| y * y) / second - 1.0).abs() < 1e-9);
        assert!(sum(&|x, y| x * y).abs() < 1e-15);
    }
}
