//! A wide bonded layer under a disc, axisymmetric.

use nalgebra::Point3;

use super::{CalculixError, Load as Acting, Model, SOURCE};
use crate::{Base, Case, Load, Medium};

const YOUNG: f64 = 70e3;
const POISSON: f64 = 0.49;
const THICKNESS: f64 = 0.010;
/// \[m\] so far out that nothing is left of the field.
const REACH: f64 = 0.100;
const DISC: f64 = 0.001;

/// Case B2: 1 N on a disc of 1 mm on a bonded layer of 10 mm; mean stress halfway down and the surface's displacement.
///
/// # Errors
///
/// [`CalculixError`] where there is no CalculiX, or it fails.
pub fn layer_cases() -> Result<Vec<Case>, CalculixError> {
    // Nodes at the locations in question: every second line of nodes is the edge of an element.
    let mut radii: Vec<f64> = (0..=8).map(|i| DISC * f64::from(i) / 8.0).collect();
    let mut refine = |end: f64, cells: u32| {
        let start = radii[radii.len() - 1];
        radii.extend((1..=2 * cells).map(|i| start + (end - start) * f64::from(i) / f64::from(2 * cells)));
    };
    for (end, cells) in [(0.004, 8), (0.010, 10), (0.020, 10), (0.040, 10), (REACH, 12)] {
        refine(end, cells);
    }
    let heights: Vec<f64> = (0..=64).map(|k| THICKNESS * f64::from(k) / 64.0).collect();
    let rows = heights.len();
    let nodes =
        radii.iter().flat_map(|&r| heights.iter().map(move |&z| Point3::new(r, z, 0.0))).collect::<Vec<_>>();
    let at = |i: usize, k: usize| i * rows + k;
    let mut elements = Vec::new();
    let mut pressures = Vec::new();
    let pressure = 1.0 / (std::f64::consts::PI * DISC * DISC);
    for i in (0..radii.len() - 1).step_by(2) {
        for k in (0..rows - 1).step_by(2) {
            if k + 3 == rows && radii[i + 2] <= DISC * 1.000_001 {
                pressures.push((elements.len(), "P3", pressure));
            }
            elements.push(vec![
                at(i, k),
                at(i + 2, k),
                at(i + 2, k + 2),
                at(i, k + 2),
                at(i + 1, k),
                at(i + 2, k + 1),
                at(i + 1, k + 2),
                at(i, k + 1),
            ]);
        }
    }
    let mut held: Vec<(usize, [bool; 3])> =
        (0..radii.len()).map(|i| (at(i, 0), [true, true, false])).collect();
    held.extend((1..rows).map(|k| (at(0, k), [true, false, false])));
    // The middle of an element has no node.
    let used: std::collections::BTreeSet<usize> = elements.iter().flatten().copied().collect();
    held.retain(|(n, _)| used.contains(n));
    let model = Model {
        nodes,
        element: "CAX8R",
        elements,
        young_modulus: YOUNG,
        poisson_ratio: POISSON,
        held,
        large: false,
        sensors: Vec::new(),
        loads: vec![Acting { pressures, ..Acting::default() }],
    };
    let answer = model.solve()?.remove(0);

    let medium = Medium::layer(YOUNG, POISSON, THICKNESS, Base::Bonded)?;
    let disc = Load::Disc { force: 1.0, radius: DISC };
    let peak = medium.pressure(&disc, THICKNESS / 2.0, 0.0)?;
    let mut cases = Vec::new();
    for r in [0.0, 0.004, 0.010, 0.020] {
        let i = radii.iter().position(|x| (x - r).abs() < 1e-9).unwrap_or(0);
        cases.push(Case::new(
            format!("B2-ccx-p-{:.0}", r * 1e3),
            format!("mean stress in a bonded layer under a disc, {:.0} mm beside its axis", r * 1e3),
            SOURCE,
            "Pa",
            [medium.pressure(&disc, THICKNESS / 2.0, r)?, answer.pressures[at(i, (rows - 1) / 2)]],
            (0.005, peak),
        ));
    }
    cases.push(Case::relative(
        "B2-ccx-w",
        "displacement of a bonded layer's surface under the middle of a disc",
        SOURCE,
        "m",
        [medium.surface_displacement(&disc, 0.0)?, -answer.displacements[at(0, rows - 1)].y],
        0.005,
    ));
    Ok(cases)
}
