//! How fine a shell must be, and what its theory leaves out.
//!
//! Problem: a shell differs from the solid that it stands for by its theory, which no mesh mends, and by its mesh. Method: the same
//! touches on ever finer triangles, by both theories, beside solids (mesh refinement study; P. J. Roache, *Verification and
//! validation in computational science and engineering*, 1998): what is left on the finest mesh is the theory's. Assumptions: the
//! solids have converged themselves; those of half the size, one through the thickness, differ by 0.7 % (root mean square) from
//! ones of 0.8 mm and two. Cost: a minute of CalculiX, and some seconds for each mesh of the shell; 72,000 nodes take two
//! gigabytes.

use std::time::{Duration, Instant};

use dermis_mechanics::VerifyError;
use dermis_mechanics::shell::PlateTheory;
use dermis_skin::SkinDescription;

use super::{Compared, TOUCHES, compare, locations, rms, solids};
use crate::model::{ShellModel, Triangles, shell_on};
use crate::parameters::Parameters;

/// Shells that are tried: theory, how often triangles are halved, and whether they are finer at edges and corners.
const SHELLS: [(PlateTheory, usize, bool); 8] = [
    (PlateTheory::KirchhoffLove, 0, false),
    (PlateTheory::KirchhoffLove, 1, false),
    (PlateTheory::KirchhoffLove, 2, false),
    (PlateTheory::ReissnerMindlin, 0, false),
    (PlateTheory::ReissnerMindlin, 1, false),
    (PlateTheory::ReissnerMindlin, 2, false),
    (PlateTheory::ReissnerMindlin, 0, true),
    (PlateTheory::ReissnerMindlin, 2, true),
];

/// One mesh beside the solids, over 40 touches of 1 N inwards.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Converged {
    /// Of a shell; `None` for solids.
    pub theory: Option<PlateTheory>,
    /// How often the cells of the surface are split into four.
    pub halvings: usize,
    /// Whether triangles at edges and corners are split further.
    pub graded: bool,
    /// Unknowns of a shell.
    pub unknowns: Option<usize>,
    /// Of the readings over the solids' by least squares.
    pub scale: f64,
    /// Root mean square of the differences, as a share of each touch's readings.
    pub rms: f64,
    /// Largest difference, as a share of its touch's strongest reading.
    pub worst: f64,
    /// By the clock, from numbers to readings.
    pub took: Duration,
}

/// Compares shells with solids whose cells are half as large as those of the skin's surface, and solids of the surface's own cells.
/// Shells are halved at most `halvings` times. `None` where the surface makes no solids.
///
/// # Errors
///
/// [`VerifyError`] where CalculiX is not installed or fails, or the skin has no shell.
pub fn convergence(skin: &SkinDescription, halvings: usize) -> Result<Option<Vec<Converged>>, VerifyError> {
    let locations = locations(skin);
    let Some(solid) = solids(skin, &locations, 1)? else { return Ok(None) };
    // The first kind of touch is the one inwards.
    let solid = &solid[0];
    let mut rows = Vec::new();
    for (theory, times, graded) in SHELLS.into_iter().filter(|(_, times, _)| *times <= halvings) {
        let begun = Instant::now();
        let mut of = skin.clone();
        let name = match theory {
            PlateTheory::KirchhoffLove => "kirchhoff-love",
            PlateTheory::ReissnerMindlin => "reissner-mindlin",
        };
        of.medium.insert("theory".into(), name.into());
        let parameters = Parameters::nominal(&of)?;
        let shell = shell_on(&of, &parameters, Triangles { halvings: times, graded })?;
        let unknowns = shell.unknowns();
        let model = ShellModel::on(&of, parameters, shell)?;
        let compared = compare(&model, &locations, TOUCHES[0].1, solid)?;
        rows.push(Converged {
            theory: Some(theory),
            halvings: times,
            graded,
            unknowns: Some(unknowns),
            took: begun.elapsed(),
            ..row(&compared)
        });
    }
    let begun = Instant::now();
    if let Some(coarse) = solids(skin, &locations, 0)? {
        let pairs: Vec<Compared> = coarse[0]
            .iter()
            .zip(solid)
            .zip(&locations)
            .flat_map(|((ours, theirs), (location, _))| Compared::of(*location, ours, theirs))
            .collect();
        rows.push(Converged { took: begun.elapsed(), ..row(&pairs) });
    }
    Ok(Some(rows))
}

/// The figures of one mesh; what it is stands in no field yet.
fn row(compared: &[Compared]) -> Converged {
    let sum = |of: fn(&Compared) -> f64| compared.iter().map(of).sum::<f64>();
    Converged {
        theory: None,
        halvings: 0,
        graded: false,
        unknowns: None,
        scale: sum(|c| c.strains[0] * c.strains[1]) / sum(|c| c.strains[1] * c.strains[1]),
        rms: rms(compared),
        worst: compared.iter().map(Compared::off).fold(0.0, f64::max),
        took: Duration::ZERO,
    }
}

#[cfg(test)]
mod tests {
    use dermis_mechanics::calculix;

    use super::super::shin;
    use super::*;

    /// Minutes of CalculiX: run by `cargo xtask test --nightly`.
    #[test]
    fn a_shell_that_shears_comes_closer_and_finer_triangles_closer_still() {
        if !calculix::available() {
            return println!("skipped: {}", calculix::CalculixError::Missing);
        }
        let rows = convergence(&shin().unwrap(), 1).unwrap().unwrap();
        let rms = |theory, halvings, graded| {
            let found = rows
                .iter()
                .find(|r| r.theory == Some(theory) && r.halvings == halvings && r.graded == graded);
            found.unwrap().rms
        };
        let thin = [0, 1].map(|n| rms(PlateTheory::KirchhoffLove, n, false));
        let shears = [0, 1].map(|n| rms(PlateTheory::ReissnerMindlin, n, false));
        assert!(thin[1] < thin[0] && shears[1] < shears[0], "{rows:#?}");
        assert!(shears[0] < thin[0] && shears[1] < thin[1], "{rows:#?}");
        // What `reissner-mindlin` takes is what ships, which `validate` holds to 3 %.
        assert!(rms(PlateTheory::ReissnerMindlin, 0, true) < 0.03, "{rows:#?}");
        let solids = rows.iter().find(|r| r.theory.is_none()).unwrap();
        assert!(solids.rms < 0.03 && (solids.scale - 1.0).abs() < 0.03, "{solids:?}");
    }
}
