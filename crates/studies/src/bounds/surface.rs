//! What isolines and bounds say all over a surface.

use anyhow::Result;
use dermis_model::{ForwardModel, Indentation, Stimulus, Unknowns};
use dermis_skin::Surface;
use dermis_theory::resolution::{Testbed, on_surface};
use dermis_theory::{Isoline, Responses, Summary, force_ladder, strongest_bands};
use nalgebra::Point3;

use super::{BandBox, Request, Source, SurfaceBound, SurfaceFactor, SurfaceStudy, middle_of};

pub(super) fn surface_study(
    source: &Source,
    model: Option<&dyn ForwardModel>,
    surface: &Surface,
    feet: &[Point3<f64>],
    (least, options): (f64, &Request),
    (maps, known_boxes): (&[SurfaceBound], &[Vec<BandBox>]),
) -> Result<SurfaceStudy> {
    let forces = force_ladder(source.force_max(), 30);
    let spacing = crate::placement::candidates::point_spacing(surface);
    let responses: Responses =
        source.responses(surface, &surface.points, &forces, options.diameter(), 1.5 * spacing)?;
    let minimum_force: Vec<Option<f64>> =
        (0..surface.points.len()).map(|p| responses.minimum_force(p, least, 3)).collect();
    let known = minimum_force.iter().map(|f| f.unwrap_or(f64::INFINITY));
    let middle = middle_of(surface);
    let near = |c: &usize| (feet[*c] - middle).norm();
    let channel = (0..feet.len()).min_by(|a, b| near(a).total_cmp(&near(b))).unwrap_or_default();
    let distances = surface.geodesics(&feet[channel], &surface.points);
    let value = responses.reading(responses.peak(channel), channel, 0.1);
    let value = if value.is_finite() { value } else { least };
    let isoline = Isoline::of(&responses, &distances, channel, value);
    let inside = between(surface, feet);
    let areas: Vec<f64> = inside.iter().map(|i| surface.areas[*i]).collect();
    let area: f64 = areas.iter().sum();
    let mut factors = Vec::new();
    for (number, map) in maps.iter().enumerate() {
        let Some(model) = model else { break };
        let boxes = inside
            .iter()
            .map(|i| {
                if let Some(known) = known_boxes.get(number) {
                    return Ok(known[*i].along);
                }
                let force = -surface.normals[*i] * map.force;
                let contact = Indentation::sphere(surface.points[*i], force, map.diameter);
                let stimulus = Stimulus { contacts: vec![contact], ..Stimulus::default() };
                Ok(strongest_bands(model, &stimulus, Unknowns::Normal)?.along)
            })
            .collect::<Result<Vec<[f64; 2]>>>()?;
        let bound = [0, 1].map(|k| Summary::of(inside.iter().map(|i| map.bounds[*i].along[k]), &areas));
        let bands_median = [0, 1].map(|k| Summary::of(boxes.iter().map(|b| b[k]), &areas).median);
        let factor = |sigma| on_surface(area, feet.len(), sigma);
        let (rms, bound_median) = (bound.map(|b| b.rms), bound.map(|b| b.median));
        factors.push(SurfaceFactor {
            force: map.force,
            bound: rms,
            bound_median,
            bands_median,
            factor: factor(rms),
            factor_with_testbed: factor(rms.map(|s| Testbed::THESIS.position(s))),
            bound_median_factor: factor(bound_median),
            bands_median_factor: factor(bands_median),
        });
    }
    Ok(SurfaceStudy {
        minimum_force_summary: Summary::of(known, &surface.areas),
        minimum_force,
        channel,
        isoline,
        factors,
    })
}

/// Points of a flat surface within the rectangle around its taxels; all points of another one.
fn between(surface: &Surface, feet: &[Point3<f64>]) -> Vec<usize> {
    let level = surface.normals.iter().all(|n| n.z > 0.999);
    let span = |of: fn(&Point3<f64>) -> f64| {
        let ends =
            feet.iter().map(of).fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        move |p: &Point3<f64>| (ends.0 - 1e-9..=ends.1 + 1e-9).contains(&of(p))
    };
    let (x, y) = (span(|p| p.x), span(|p| p.y));
    let inside: Vec<usize> = (0..surface.points.len())
        .filter(|i| level && x(&surface.points[*i]) && y(&surface.points[*i]))
        .collect();
    if inside.is_empty() { (0..surface.points.len()).collect() } else { inside }
}
