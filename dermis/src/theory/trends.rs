//! How a taxel's isoline changes with what it lies in and what presses: the questions of the thesis' Fig. 5.7.

use std::sync::Arc;

use anyhow::Result;
use dermis_skin::{ForwardModel, SkinDescription};
use dermis_theory::{Isoline, Path, Responses, force_ladder};
use nalgebra::{Point3, Vector3};
use serde::Serialize;

use crate::variation::Parameter;

/// \[N\] straight above the taxel, at which the nominal skin reads the value whose isolines are drawn.
const FORCE: f64 = 0.1;
/// Factors of the parameters of the skin; those that cannot be are left out.
const FACTORS: [f64; 5] = [0.4, 0.7, 1.0, 1.4, 1.8];
/// Poisson's ratio ends at one half.
const POISSON_FACTORS: [f64; 4] = [0.6, 0.8, 0.92, 1.0];
/// \[m\] diameters of tips.
const TIPS: [f64; 5] = [0.002, 0.004, 0.006, 0.010, 0.016];

/// Isolines of one taxel while one number varies.
#[derive(Serialize)]
pub struct Trend {
    /// What varies, with the unit of `curves`.
    pub label: &'static str,
    pub curves: Vec<TrendCurve>,
    /// S, in the unit of the skin.
    pub value: f64,
}

#[derive(Serialize)]
pub struct TrendCurve {
    /// Value of what varies, in the unit of the label.
    pub at: f64,
    pub nominal: bool,
    /// \[m\] from the foot of the taxel, \[N\].
    pub isoline: Vec<[f64; 2]>,
}

/// The isoline of the middle taxel for other depths, thicknesses, Poisson's ratios and tips.
pub fn trends(
    skin: &SkinDescription,
    model: &Arc<dyn ForwardModel>,
    feet: &[Point3<f64>],
    diameter: f64,
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
    let curve = |model: &dyn ForwardModel, tip: f64, value: f64| -> Result<Vec<[f64; 2]>> {
        let responses = Responses::of_model(model, &path.points, &force_ladder(1.5, 24), tip)?;
        let isoline = Isoline::of(&responses, &distances, channel, value);
        Ok(isoline.points.iter().map(|p| [p.distance, p.force]).collect())
    };
    let nominal = Responses::of_model(model.as_ref(), &[foot], &force_ladder(1.5, 24), diameter)?;
    let value = nominal.reading(0, channel, FORCE);
    let mut found = Vec::new();
    for parameter in [Parameter::Depth, Parameter::Thickness, Parameter::Poisson] {
        let Ok(at) = parameter.value(skin) else { continue };
        let factors: &[f64] = if parameter == Parameter::Poisson { &POISSON_FACTORS } else { &FACTORS };
        let mut curves = Vec::new();
        for &factor in factors {
            // A taxel below its medium, say.
            let Ok(varied) = crate::registry::family(skin)
                .and_then(|family| (family.model)(&parameter.scaled(skin, factor)?))
            else {
                continue;
            };
            curves.push(TrendCurve {
                at: parameter.shown(at * factor),
                nominal: factor == 1.0,
                isoline: curve(varied.as_ref(), diameter, value)?,
            });
        }
        if curves.len() > 1 {
            found.push(Trend { label: parameter.label(), curves, value });
        }
    }
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
