//! What the free sides of a flat elastomer change.
//!
//! Near its edge, an elastomer that ends there gives way to the side: [`free_sides`] says how that is felt. A contact acts at
//! its centre here, and is as wide as on a layer without end.

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
    /// Solved when first asked for: some seconds of work that a model without contacts can do without.
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

    /// Adds what the sides change in the stress \[Pa\] under `contact` to `out`.
    ///
    /// # Errors
    ///
    /// [`MechanicsError`] where the block cannot be solved.
    pub(super) fn add(&self, contact: &Indentation, out: &mut [f64]) -> Result<(), MechanicsError> {
        let change = self.change.get_or_init(|| self.block.solve()).as_ref().map_err(Clone::clone)?;
        for (change, force) in change.iter().zip(contact.force.iter()) {
            if *force != 0.0 {
                change.add(contact.position.x, contact.position.y, *force, out);
            }
        }
        Ok(())
    }
}
