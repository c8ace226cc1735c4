//! How a taxel's isoline changes with what it lies in and what presses: the questions of the thesis' Fig. 5.7.

use std::sync::Arc;

use anyhow::Result;
use dermis_model::{ForwardModel, in_parallel};
use dermis_skin::SkinDescription;
use dermis_theory::{Isoline, Path, Responses, force_ladder};
use nalgebra::{Point3, Vector3};
use serde::Serialize;

use crate::Families;
use crate::variation::Parameter;

/// \[N\] straight above the taxel, at which the nominal skin reads the value whose isolines are drawn.
const FORCE: f64 = 0.1;
/// Factors of the parameters of the skin; those that cannot be are left out.
const FACTORS: [f64; 4] = [0.5, 0.75, 1.0, 1.5];
/// Poisson's ratio ends at one half.
const POISSON_FACTORS: [f64; 3] = [0.6, 0.85, 1.0];
/// \[m\] diameters of tips.
const TIPS: [f64; 5] = [0.002, 0.004, 0.006, 0.010, 0.016];

/// Isolines of one taxel while one number varies.
#[derive(Serialize)]
pub struct Trend {
    /// What varies, with the unit of `curves`.
    pub label: &'static str,
    /// One for each value.
    pub curves: Vec<TrendCurve>,
    /// S, in the unit of the skin.
    pub value: f64,
}

/// The isoline for one value of what varies.
#[derive(Serialize)]
pub struct TrendCurve {
    /// Value of what varies, in the unit of the label.
    pub at: f64,
    /// Whether this is the skin as it is.
    pub nominal: bool,
    /// \[m\] from the foot of the taxel, \[N\].
    pub isoline: Vec<[f64; 2]>,
}

/// The isoline of the middle taxel for other depths, thicknesses, Poisson's ratios and tips.
///
/// # Errors
///
/// Where the nominal model cannot be pressed.
pub fn trends(
    skin: &SkinDescription,
    model: &Arc<dyn ForwardModel>,
    feet: &[Point3<f64>],
    diameter: f64,
    families: &Families,
) -> Result<Vec<Trend>> {
    let surface = model.surface();
    let middle = super::middle_of(surface);
    let near = |c: &usize| (feet[*c] - middle).norm();
    let Some(channel) = (0..feet.len()).min_by(|a, b| near(a).total_cmp(&near(b))) else {
        return Ok(Vec::new());
    };
    let foot = feet[channel];
    let normal = surface.project(&foot).1;
    let direction = if normal.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() };
    let path = Path::across(surface, &foot, &direction, 5e-4)?;
    let at_foot = path.foot(&foot);
    let distances: Vec<f64> = path.arc.iter().map(|a| a - at_foot).collect();
    let nominal = Responses::of_model(model.as_ref(), &[foot], &force_ladder(1.5, 24), diameter)?;
    let value = nominal.reading(0, channel, FORCE);
    let curve = |model: &dyn ForwardModel, tip: f64, value: f64| -> Result<Vec<[f64; 2]>> {
        let responses = Responses::of_model(model, &path.points, &force_ladder(1.5, 24), tip)?;
        let responses = responses.oriented_as(&nominal);
        let isoline = Isoline::of(&responses, &distances, channel, value);
        Ok(isoline.points.iter().map(|p| [p.distance, p.force]).collect())
    };
    let mut work = Vec::new();
    for parameter in [Parameter::Depth, Parameter::Thickness, Parameter::Poisson] {
        let Ok(at) = parameter.value(skin) else { continue };
        let factors: &[f64] = if parameter == Parameter::Poisson { &POISSON_FACTORS } else { &FACTORS };
        work.extend(factors.iter().map(|factor| (parameter, at * factor, *factor)));
    }
    // What cannot be, a taxel below its medium, say, is left out.
    let drawn = in_parallel(work.len(), |i| {
        let (parameter, at, factor) = work[i];
        let varied = if factor == 1.0 {
            Arc::clone(model)
        } else {
            families.model(&parameter.scaled(skin, factor).ok()?).ok()?
        };
        let isoline = curve(varied.as_ref(), diameter, value).ok()?;
        Some((parameter, TrendCurve { at: parameter.shown(at), nominal: factor == 1.0, isoline }))
    });
    let mut found: Vec<Trend> = Vec::new();
    for (parameter, curve) in drawn.into_iter().flatten() {
        match found.last_mut().filter(|t| t.label == parameter.label()) {
            Some(trend) => trend.curves.push(curve),
            None => found.push(Trend { label: parameter.label(), curves: vec![curve], value }),
        }
    }
    found.retain(|t| t.curves.len() > 1);
    let mut curves = Vec::new();
    for tip in TIPS {
        // A model may know spheres of some sizes only.
        if let Ok(isoline) = curve(model.as_ref(), tip, value) {
            curves.push(TrendCurve { at: tip * 1e3, nominal: (tip - diameter).abs() < 1e-9, isoline });
        }
    }
    found.push(Trend { label: "diameter of the tip [mm]", curves, value });
    Ok(found)
}
