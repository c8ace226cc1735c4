//! Where a gauge could be glued.

use std::collections::BTreeSet;

use dermis_mechanics::shell::Shell;
use dermis_skin::{ModelError, SkinDescription, Surface, SurfaceSpec, Taxel};
use nalgebra::{Point3, Vector3};

use crate::model::{COVERED, rectangle, shell};
use crate::parameters::{Parameters, StrainGauge};

/// \[m\] of material that a gauge needs around it: hands are not more exact.
const CLEARANCE: f64 = 1.5e-3;

/// Locations for a gauge under the points of the surface, and under the middles of the edges between them, wherever it lies on the
/// shell with [`CLEARANCE`] around: along the limb, and where it fits across, too. `a` and `c` in the names of gauges stand for
/// along and across.
///
/// # Errors
///
/// [`ModelError::Description`] where the shell cannot be.
pub fn candidates(skin: &SkinDescription) -> Result<Vec<Taxel>, ModelError> {
    let parameters = Parameters::nominal(skin)?;
    let shell = shell(skin, &parameters)?;
    let surface = &parameters.surface;
    let Some(size) = parameters.gauges.first().map(|g| g.size) else { return Ok(Vec::new()) };
    let mut found = Vec::new();
    let size = size.map(|side| side + 2.0 * CLEARANCE);
    for (i, point) in locations(surface).into_iter().enumerate() {
        let (point, normal) = surface.project(&point);
        let position = point - normal * parameters.thickness;
        for (name, axis) in directions(skin, &normal) {
            let gauge = StrainGauge { position, normal, axis, size, gain: 1.0, transverse: 0.0 };
            if lies_on(&shell, &gauge, parameters.thickness) {
                found.push(Taxel {
                    name: format!("n{i}{name}"),
                    position: position.into(),
                    normal: normal.into(),
                    axis: Some(axis.into()),
                });
            }
        }
    }
    Ok(found)
}

/// Points, then middles of edges.
fn locations(surface: &Surface) -> Vec<Point3<f64>> {
    let mut edges = BTreeSet::new();
    for t in &surface.triangles {
        for [i, j] in [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]] {
            edges.insert([i.min(j), i.max(j)]);
        }
    }
    let middles = edges
        .into_iter()
        .map(|[i, j]| nalgebra::center(&surface.points[i as usize], &surface.points[j as usize]));
    surface.points.iter().copied().chain(middles).collect()
}

fn lies_on(shell: &Shell, gauge: &StrainGauge, thickness: f64) -> bool {
    shell.gauge(&rectangle(gauge, thickness, false)).is_ok_and(|reading| reading.covered >= COVERED)
}

/// Directions along the surface to try, of a panel along and around the limb.
fn directions(skin: &SkinDescription, normal: &Vector3<f64>) -> Vec<(char, Vector3<f64>)> {
    let along = Vector3::x() - normal * normal.x;
    // Where the surface looks along the limb, any direction is as good as another.
    let along = if matches!(skin.surface, SurfaceSpec::Panel { .. }) || along.norm() > 0.1 {
        along
    } else {
        Vector3::y() - normal * normal.y
    };
    let along = along.normalize();
    vec![('a', along), ('c', normal.cross(&along))]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_candidate_is_a_gauge_that_the_model_takes() {
        let text = include_str!("../../../launch/skins/hapdef-shin.toml")
            .replace("spacing = 0.00245", "spacing = 0.005");
        let skin = SkinDescription::from_toml(&text, "hapdef-shin.toml").unwrap();
        let found = candidates(&skin).unwrap();
        let points = skin.surface().points.len();
        println!("{} of {points}", found.len());
        assert!((points / 4..2 * points).contains(&found.len()), "{} of {points} points", found.len());
        // Beams run both ways.
        let along = found.iter().filter(|t| t.name.ends_with('a')).count();
        assert!((found.len() / 5..4 * found.len() / 5).contains(&along), "{along} of {}", found.len());
        let with = skin.with_taxels(found.into_iter().step_by(7).collect()).unwrap();
        assert!(crate::model(&with).is_ok());
    }
}
