//! Where and how hard the skin is pressed.

use anyhow::{Context, Result, bail};
use dermis_skin::{SkinDescription, Surface};
use dermis_theory::placement::{Feasibility, Location, Verdict, feasible};

use super::Request;
use crate::Families;

/// Noise deviations that the strongest channel reads, in the median over the locations, under the force that is taken where none
/// is given.
const CLEAR: f64 = 300.0;

/// Locations to press: points of the surface away from its supports, as many as are requested.
pub(super) fn pressed(surface: &Surface, rule: &Feasibility, options: &Request) -> Vec<Location> {
    let verdicts = feasible(surface, &surface.points, rule);
    let free: Vec<usize> = (0..surface.points.len()).filter(|i| verdicts[*i] == Verdict::Feasible).collect();
    // At random, so that no pattern of the triangulation shows.
    let mut order = dermis_regress::shuffled(free.len(), options.seed);
    order.truncate(options.locations);
    order.sort_unstable();
    order
        .into_iter()
        .map(|n| Location { point: surface.points[free[n]], normal: surface.normals[free[n]] })
        .collect()
}

/// The forces that were requested; otherwise one that the skin as it is feels clearly.
pub(super) fn forces(
    skin: &SkinDescription,
    options: &Request,
    locations: &[Location],
    families: &Families,
) -> Result<Vec<f64>> {
    if !options.force.is_empty() {
        let mut forces = options.force.clone();
        forces.sort_by(f64::total_cmp);
        forces.dedup();
        return Ok(forces);
    }
    let model = families.model_of_file(&options.skin, skin)?;
    let untouched = dermis_model::Untouched::of(model.as_ref())?;
    let mut out = vec![0.0; model.channels()];
    let mut clear = Vec::new();
    for location in locations.iter().step_by(dermis_regress::stride(locations.len(), 200)) {
        let contact = dermis_model::Indentation::sphere(location.point, -location.normal, options.diameter);
        model
            .response(&dermis_model::Stimulus { contacts: vec![contact], ..Default::default() }, &mut out)?;
        untouched.subtract(&mut out);
        clear.push(out.iter().zip(model.noise()).map(|(v, n)| v.abs() / n).fold(0.0, f64::max));
    }
    clear.sort_by(f64::total_cmp);
    let median = clear.get(clear.len() / 2).copied().unwrap_or_default();
    if !(median.is_finite() && median > 0.0) {
        bail!("the skin as it is feels nothing of 1 N in most locations: give a force with `--force`");
    }
    // Two digits say enough, and are written as such.
    let force = format!("{:.1e}", CLEAR / median);
    Ok(vec![force.parse().context("a force cannot be found: give one with `--force`")?])
}
