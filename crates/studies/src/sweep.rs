//! What a skin would gain from being built otherwise, before anything is moulded.
//!
//! Method: each number of the design varies alone, with everything else as it is; for every variant the forward model is made
//! anew, and one contact is bounded over a coarser surface. The elasticity (relative change of a figure for a relative change
//! of the number) comes from the neighbours of the skin as it is. Interactions of numbers are not seen. Cost: one model and one
//! map of bounds for each variant, on all processors.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use anyhow::{Result, bail};
use clap::{Args, ValueEnum as _};
use dermis_figures::short;
use dermis_model::{ForwardModel, TipShape, Unknowns, WithNoise, in_parallel};
use dermis_skin::{SkinDescription, SurfaceSpec};
use dermis_theory::resolution::{along_line, on_surface};
use dermis_theory::{Responses, Summary, force_ladder, over_surface};
use serde::{Deserialize, Serialize, Serializer};
use serde_json::json;

use crate::variation::Parameter;
use crate::{Families, Progress};

/// Values of each parameter, relative to the one that the skin has.
const FACTORS: [f64; 9] = [0.5, 0.65, 0.8, 0.9, 1.0, 1.1, 1.25, 1.5, 2.0];
/// Poisson's ratio is below one half, and elastomers are near it.
const POISSON: [f64; 6] = [0.5, 0.7, 0.85, 0.95, 1.0, 1.015];
/// Points of the surface that are bounded at most.
const POINTS: f64 = 260.0;

/// What to vary.
#[derive(Debug, Clone, Args, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Request {
    /// Skin description.
    pub skin: PathBuf,
    /// Numbers to vary, one at a time; all that the skin has where absent.
    #[arg(long, value_delimiter = ',', value_enum)]
    pub vary: Vec<Parameter>,
    /// Pressing force [N].
    #[arg(long, default_value_t = Request::default().force)]
    pub force: f64,
    /// Diameter of the tip [m].
    #[arg(long, default_value_t = Request::default().diameter)]
    pub diameter: f64,
    /// Only x is unknown of the place: for taxels in a row.
    #[arg(long)]
    pub line: bool,
}

impl Default for Request {
    fn default() -> Self {
        Self { skin: PathBuf::new(), vary: Vec::new(), force: 0.3, diameter: 0.004, line: false }
    }
}

/// What a skin can do.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Figures {
    /// \[m\] Cramér–Rao bound of the position, over the surface.
    pub position: Summary,
    /// \[N\] of the pressing force.
    pub force: Summary,
    /// F_S \[N\] over the surface.
    pub minimum_force: Summary,
    /// Super-resolution factor, by the bound; NaN where the position is not determined everywhere.
    pub factor: f64,
}

/// A skin with one number changed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Variant {
    /// The number, in SI units.
    pub value: f64,
    /// Relative to the skin as it is.
    pub relative: f64,
    /// What it can do.
    pub figures: Figures,
}

/// All variants of one number.
#[derive(Debug, Serialize)]
pub struct Sweep {
    /// The number.
    pub parameter: Parameter,
    /// In ascending order.
    pub variants: Vec<Variant>,
    /// Per cent that a figure changes for one per cent of the parameter, at the skin as it is.
    pub elasticity: Elasticity,
    /// What could not be built, and why.
    pub refused: Vec<String>,
}

/// Per cent that each figure changes for one per cent of a number.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct Elasticity {
    /// Root mean square of the position error.
    pub position: f64,
    /// Its median.
    pub position_median: f64,
    /// Root mean square of the force error.
    pub force: f64,
    /// Median of F_S.
    pub minimum_force: f64,
    /// Super-resolution factor.
    pub factor: f64,
}

/// Everything that was found.
pub struct Findings {
    /// What was requested.
    pub request: Request,
    /// The skin, with a coarser surface.
    pub skin: SkinDescription,
    /// What it can do as it is.
    pub nominal: Figures,
    /// One for each number.
    pub sweeps: Vec<Sweep>,
}

impl Serialize for Findings {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        json!({
            "skin": self.skin.name,
            "force_n": self.request.force,
            "diameter_m": self.request.diameter,
            "as_it_is": self.nominal,
            "sweeps": self.sweeps,
        })
        .serialize(serializer)
    }
}

/// Varies each number of a skin alone.
///
/// # Errors
///
/// Where the skin or its model cannot be, or a number of the request.
pub fn sweep(request: &Request, families: &Families, progress: &dyn Progress) -> Result<Findings> {
    let skin = SkinDescription::load(&request.skin)?;
    if !(request.force.is_finite() && request.force > 0.0) {
        bail!("option `--force` is {} N and must be positive", request.force);
    }
    progress.begin(&skin.name);
    of_skin(skin, request, families, progress)
}

/// The same of a skin at hand.
///
/// # Errors
///
/// As [`sweep`].
pub fn of_skin(
    mut skin: SkinDescription,
    request: &Request,
    families: &Families,
    progress: &dyn Progress,
) -> Result<Findings> {
    coarsen(&mut skin);
    let parameters: Vec<Parameter> = if request.vary.is_empty() {
        Parameter::value_variants().iter().copied().filter(|p| p.value(&skin).is_ok()).collect()
    } else {
        // What was requested must be there.
        request.vary.iter().map(|p| p.value(&skin).map(|_| *p)).collect::<Result<_>>()?
    };
    let model = families.model_of_file(&request.skin, &skin)?;
    let nominal = figures(&skin, model.as_ref(), request)?;
    let sweeps = variants(&parameters, &skin, (&model, nominal), request, families, progress)?;
    Ok(Findings { request: request.clone(), skin, nominal, sweeps })
}

/// Few enough points that dozens of skins are bounded in seconds.
fn coarsen(skin: &mut SkinDescription) {
    let area: f64 = skin.surface().areas.iter().sum();
    let least = (area / POINTS).sqrt();
    match &mut skin.surface {
        // A strip is as fine along it as it was: it has few points anyway.
        SurfaceSpec::Rectangle { size, spacing } if size[0].min(size[1]) > least => {
            *spacing = spacing.max(least);
        }
        SurfaceSpec::Dome { spacing, .. } => *spacing = spacing.max(least),
        // The mesh of a shell is its model, too.
        SurfaceSpec::Rectangle { .. }
        | SurfaceSpec::Panel { .. }
        | SurfaceSpec::Mesh { .. }
        | SurfaceSpec::Family(_) => {}
    }
}

fn factors(parameter: Parameter) -> &'static [f64] {
    if parameter == Parameter::Poisson { &POISSON } else { &FACTORS }
}

/// What the skin can do with one number scaled.
fn varied(
    parameter: Parameter,
    relative: f64,
    skin: &SkinDescription,
    nominal: &Arc<dyn ForwardModel>,
    options: &Request,
    families: &Families,
) -> Result<Figures> {
    let scaled = parameter.scaled(skin, relative)?;
    // A model can take seconds to make, and noise is no part of it.
    if parameter == Parameter::Noise {
        let noisy = WithNoise::new(nominal.as_ref(), scaled.channel_noise());
        return figures(&scaled, &noisy, options);
    }
    let model = families.model(&scaled)?;
    figures(&scaled, model.as_ref(), options)
}

/// What a skin can do under the force in question.
fn figures(skin: &SkinDescription, model: &dyn ForwardModel, options: &Request) -> Result<Figures> {
    let surface = model.surface();
    let unknowns = if options.line { Unknowns::Line } else { Unknowns::Normal };
    let tip = TipShape::of_kind(skin.rated_press().tip, options.diameter);
    let map = over_surface(model, options.force, tip, unknowns)?;
    let noise = model.noise().iter().copied().fold(0.0, f64::max);
    let least = skin.condition.contact_threshold * noise;
    let needed = if options.line { 2 } else { 3 };
    let responses = Responses::of_model(model, &surface.points, &force_ladder(1.5, 20), options.diameter)?;
    let minimum_force =
        (0..surface.points.len()).map(|p| responses.minimum_force(p, least, needed).unwrap_or(f64::INFINITY));
    let rms = |k: usize| {
        let squares = map.bounds.iter().zip(&surface.areas).map(|(b, a)| b.along[k].powi(2) * a);
        (squares.sum::<f64>() / surface.areas.iter().sum::<f64>()).sqrt()
    };
    let factor = if options.line {
        let x = |of: fn(f64, f64) -> f64, from| surface.points.iter().map(|p| p.x).fold(from, of);
        along_line(x(f64::max, f64::NEG_INFINITY) - x(f64::min, f64::INFINITY), model.channels(), rms(0))
    } else {
        on_surface(surface.areas.iter().sum(), model.channels(), [rms(0), rms(1)])
    };
    Ok(Figures {
        position: map.position,
        force: map.normal_force,
        minimum_force: Summary::of(minimum_force, &surface.areas),
        // Over an infinite error it would be a 0 that looks like a result.
        factor: if map.position.rms.is_finite() { factor } else { f64::NAN },
    })
}

/// Varies each of the parameters alone.
fn variants(
    parameters: &[Parameter],
    skin: &SkinDescription,
    (model, nominal): (&Arc<dyn ForwardModel>, Figures),
    options: &Request,
    families: &Families,
    progress: &dyn Progress,
) -> Result<Vec<Sweep>> {
    let work: Vec<(Parameter, f64)> =
        parameters.iter().flat_map(|p| factors(*p).iter().map(move |f| (*p, *f))).collect();
    let done = AtomicUsize::new(0);
    let found = in_parallel(work.len(), |i| {
        let (parameter, relative) = work[i];
        let figures = if relative == 1.0 {
            Ok(nominal)
        } else {
            varied(parameter, relative, skin, model, options, families)
        };
        let done = 1 + done.fetch_add(1, Ordering::Relaxed);
        progress.at(done as f64 / work.len() as f64);
        figures
    });
    let mut found = work.iter().zip(found).peekable();
    let mut sweeps = Vec::new();
    for &parameter in parameters {
        let value = parameter.value(skin)?;
        let (mut variants, mut refused) = (Vec::new(), Vec::new());
        while let Some(((_, relative), figures)) = found.next_if(|((p, _), _)| *p == parameter) {
            match figures {
                Ok(figures) => {
                    variants.push(Variant { value: value * relative, relative: *relative, figures });
                }
                // A taxel below its medium, an incompressible layer.
                Err(error) => {
                    let shown = short(parameter.shown(value * relative));
                    refused.push(format!("{} of {shown}: {error}", parameter.name()));
                }
            }
        }
        sweeps.push(Sweep { parameter, elasticity: elasticity(&variants), variants, refused });
    }
    Ok(sweeps)
}

/// From the neighbours of the skin as it is, on logarithmic scales.
fn elasticity(variants: &[Variant]) -> Elasticity {
    let at = variants.iter().position(|v| v.relative == 1.0).unwrap_or_default();
    let (low, high) = (at.saturating_sub(1), (at + 1).min(variants.len().saturating_sub(1)));
    let of = |value: fn(&Figures) -> f64| match (variants.get(low), variants.get(high)) {
        (Some(a), Some(b)) if a.relative < b.relative => {
            (value(&b.figures) / value(&a.figures)).ln() / (b.relative / a.relative).ln()
        }
        _ => f64::NAN,
    };
    Elasticity {
        position: of(|f| f.position.rms),
        position_median: of(|f| f.position.median),
        force: of(|f| f.force.rms),
        minimum_force: of(|f| f.minimum_force.median),
        factor: of(|f| f.factor),
    }
}

#[cfg(test)]
mod tests {
    use dermis_fixtures::{Analytic, SkinFile};

    use super::*;

    #[test]
    fn points_of_a_skin_count_with_their_area() {
        let skin = SkinFile::four_barometers().rectangle([0.02, 0.02], 0.0025).read();
        let mut model = Analytic::of_skin(&skin, |c, taxel| {
            -2000.0 * c.force.z * (-(c.position - taxel).xy().norm_squared() / 7.2e-5).exp()
        });
        // One half reads less, and is three quarters of the skin.
        model.elements.iter_mut().filter(|e| e.at.x > 0.0).for_each(|e| e.gain = 0.3);
        for (point, area) in model.surface.points.iter().zip(&mut model.surface.areas) {
            *area *= if point.x > 0.0 { 3.0 } else { 1.0 };
        }
        let request = Request { force: 0.5, diameter: 0.004, line: false, ..Request::default() };
        let found = figures(&skin, &model, &request).unwrap();
        let map = over_surface(&model, 0.5, TipShape::Sphere { diameter: 0.004 }, Unknowns::Normal).unwrap();
        let all: f64 = model.surface.areas.iter().sum();
        let of = |areas: &dyn Fn(usize) -> f64| {
            let rms = |k: usize| {
                let (mut sum, mut weights) = (0.0, 0.0);
                for (i, bound) in map.bounds.iter().enumerate() {
                    sum += areas(i) * bound.along[k].powi(2);
                    weights += areas(i);
                }
                (sum / weights).sqrt()
            };
            all / (4.0 * std::f64::consts::PI * rms(0) * rms(1))
        };
        let weighed = of(&|i| model.surface.areas[i]);
        approx::assert_relative_eq!(found.factor, weighed, max_relative = 1e-9);
        assert!((weighed / of(&|_| 1.0) - 1.0).abs() > 0.02, "the areas make no difference: {weighed}");
    }
}
