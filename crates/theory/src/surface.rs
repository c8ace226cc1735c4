//! The bound over a whole skin, and of two contacts that come ever closer.

use dermis_model::{ForwardModel, Indentation, Stimulus, Tip, TipShape, Unknowns, Untouched, tangents};
use nalgebra::{Point3, Vector3};
use serde::Serialize;

use crate::bound::{Derivatives, bands, bounds, derivatives};
use crate::{BandBox, ContactBound, TheoryError, cramer_rao};

/// Bound of one contact at every point of a skin.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SurfaceBound {
    /// \[N\] pressing force.
    pub force: f64,
    /// \[m\] diameter of the tip, or its widest extent.
    pub diameter: f64,
    /// One for each point of the surface, in their order.
    pub bounds: Vec<ContactBound>,
    /// Of the position \[m\].
    pub position: Summary,
    /// Of the pressing force \[N\].
    pub normal_force: Summary,
}

/// Bounds over a surface, each weighted with its area.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Summary {
    /// Root mean square: what an estimator that reaches the bound everywhere would report.
    pub rms: f64,
    /// Half of the skin is better.
    pub median: f64,
    /// 95 % of the skin are better.
    pub p95: f64,
    /// At the worst point.
    pub max: f64,
    /// Share of the skin, 0 to 1, where the bound is infinite: the channels do not determine it there, and the root mean square is
    /// infinite.
    pub infinite: f64,
}

impl Summary {
    /// Summarises values with the area that each stands for.
    #[must_use]
    pub fn of(values: impl Iterator<Item = f64>, areas: &[f64]) -> Self {
        let mut weighted: Vec<(f64, f64)> = values.zip(areas.iter().copied()).collect();
        weighted.sort_by(|a, b| a.0.total_cmp(&b.0));
        let total: f64 = weighted.iter().map(|(_, area)| area).sum();
        let quantile = |share: f64| {
            let mut reached = 0.0;
            let found = weighted.iter().find(|(_, area)| {
                reached += area;
                reached >= share * total
            });
            found.or(weighted.last()).map_or(f64::NAN, |(value, _)| *value)
        };
        let squares: f64 = weighted.iter().map(|(value, area)| value * value * area).sum();
        Self {
            rms: (squares / total).sqrt(),
            median: quantile(0.5),
            p95: quantile(0.95),
            max: weighted.last().map_or(f64::NAN, |(value, _)| *value),
            // Sums of nothing are −0.
            infinite: weighted.iter().filter(|(v, _)| v.is_infinite()).fold(0.0, |sum, (_, area)| sum + area)
                / total,
        }
    }
}

pub(crate) fn positive(quantity: &'static str, value: f64) -> Result<f64, TheoryError> {
    if value.is_finite() && value > 0.0 {
        Ok(value)
    } else {
        Err(TheoryError::NotPositive { quantity, value })
    }
}

/// Bounds one contact that presses straight with `force` \[N\] and this tip, at every point of the skin.
///
/// # Errors
///
/// As [`cramer_rao`], where force or tip are not positive, and where the model does not know such a tip.
pub fn over_surface(
    model: &dyn ForwardModel,
    force: f64,
    tip: TipShape,
    unknowns: Unknowns,
) -> Result<SurfaceBound, TheoryError> {
    let each = |derivatives: &Derivatives, _: &Stimulus| Ok(bounds(derivatives, unknowns)[0]);
    let bounds = at_every_point(model, force, tip, unknowns, each)?;
    Ok(SurfaceBound::of(model, force, tip.extent(), bounds))
}

/// [`over_surface`], and the box of the [strongest bands](crate::strongest_bands) at every point: from the same derivatives.
///
/// # Errors
///
/// As [`over_surface`].
pub fn over_surface_and_bands(
    model: &dyn ForwardModel,
    force: f64,
    tip: TipShape,
    unknowns: Unknowns,
) -> Result<(SurfaceBound, Vec<BandBox>), TheoryError> {
    let untouched = Untouched::of(model)?;
    let mut signal = vec![0.0; model.channels()];
    let each = |derivatives: &Derivatives, stimulus: &Stimulus| {
        model.response(stimulus, &mut signal)?;
        untouched.subtract(&mut signal);
        Ok((bounds(derivatives, unknowns)[0], bands(derivatives, &signal, unknowns)))
    };
    let (bounds, bands) = at_every_point(model, force, tip, unknowns, each)?.into_iter().unzip();
    Ok((SurfaceBound::of(model, force, tip.extent(), bounds), bands))
}

/// What `of` makes of the derivatives for one contact at every point of a skin.
fn at_every_point<T>(
    model: &dyn ForwardModel,
    force: f64,
    tip: TipShape,
    unknowns: Unknowns,
    mut of: impl FnMut(&Derivatives, &Stimulus) -> Result<T, TheoryError>,
) -> Result<Vec<T>, TheoryError> {
    positive("force [N]", force)?;
    positive("diameter of the tip [m]", tip.extent())?;
    let surface = model.surface();
    let points = surface.points.iter().zip(&surface.normals);
    points
        .map(|(position, normal)| {
            let contact = straight(*position, normal, force, tip);
            let stimulus = Stimulus { contacts: vec![contact], ..Stimulus::default() };
            of(&derivatives(model, &stimulus, unknowns)?, &stimulus)
        })
        .collect()
}

/// A tip that stands straight on the skin.
fn straight(position: Point3<f64>, normal: &Vector3<f64>, force: f64, tip: TipShape) -> Indentation {
    Indentation { position, force: -normal * force, tip: Tip::standing(tip, normal) }
}

impl SurfaceBound {
    fn of(model: &dyn ForwardModel, force: f64, diameter: f64, bounds: Vec<ContactBound>) -> Self {
        let areas = &model.surface().areas;
        Self {
            force,
            diameter,
            position: Summary::of(bounds.iter().map(|b| b.position), areas),
            normal_force: Summary::of(bounds.iter().map(|b| b.normal_force), areas),
            bounds,
        }
    }
}

/// Two equal contacts at a distance.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct TwoContacts {
    /// \[m\] between them.
    pub distance: f64,
    /// \[m\] bound of the position of one of them, the worse.
    pub position: f64,
    /// \[N\] bound of its pressing force.
    pub normal_force: f64,
    /// Whether they can be distinguished: the bound of the position is below half of their distance.
    pub resolved: bool,
}

/// Bounds two equal contacts on either side of `centre`, along the first direction of the surface, at these distances
/// \[m\], each pressing with `force` \[N\].
///
/// # Errors
///
/// As [`over_surface`].
pub fn two_contacts(
    model: &dyn ForwardModel,
    centre: &Point3<f64>,
    distances: &[f64],
    force: f64,
    tip: TipShape,
    unknowns: Unknowns,
) -> Result<Vec<TwoContacts>, TheoryError> {
    positive("force [N]", force)?;
    positive("diameter of the tip [m]", tip.extent())?;
    let surface = model.surface();
    let (middle, normal) = surface.project(centre);
    let [along, _] = tangents(&normal);
    distances
        .iter()
        .map(|&distance| {
            positive("distance of two contacts [m]", distance)?;
            let contacts = [0.5, -0.5].map(|side| {
                let (position, normal) = surface.project(&(middle + along * (side * distance)));
                straight(position, &normal, force, tip)
            });
            let stimulus = Stimulus { contacts: contacts.to_vec(), ..Stimulus::default() };
            let bounds = cramer_rao(model, &stimulus, unknowns)?;
            let worst = |of: fn(&ContactBound) -> f64| bounds.iter().map(of).fold(0.0, f64::max);
            let position = worst(|b| b.position);
            Ok(TwoContacts {
                distance,
                position,
                normal_force: worst(|b| b.normal_force),
                resolved: position < distance / 2.0,
            })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const BALL: TipShape = TipShape::Sphere { diameter: 0.004 };

    #[test]
    fn summaries_weigh_by_area() {
        let summary = Summary::of([1.0, 2.0, 10.0].into_iter(), &[1.0, 8.0, 1.0]);
        assert_eq!((summary.median, summary.max), (2.0, 10.0));
        assert!((summary.rms - (133.0f64 / 10.0).sqrt()).abs() < 1e-12);
        let open = Summary::of([f64::INFINITY, 1.0].into_iter(), &[1.0, 3.0]);
        assert_eq!((open.rms, open.median, open.infinite), (f64::INFINITY, 1.0, 0.25));
        assert_eq!(summary.infinite, 0.0);
    }

    #[test]
    fn points_of_a_surface_count_with_their_area() {
        let mut model = crate::testing::grid();
        let even = over_surface(&model, 0.7, BALL, Unknowns::Normal).unwrap();
        for (point, area) in model.surface.points.iter().zip(&mut model.surface.areas) {
            *area *= if point.x.hypot(point.y) > 0.015 { 5.0 } else { 1.0 };
        }
        let uneven = over_surface(&model, 0.7, BALL, Unknowns::Normal).unwrap();
        assert_eq!(even.bounds, uneven.bounds);
        let all: f64 = model.surface.areas.iter().sum();
        let weighed = uneven.bounds.iter().zip(&model.surface.areas);
        let square: f64 = weighed.map(|(bound, area)| bound.position.powi(2) * area / all).sum();
        approx::assert_relative_eq!(uneven.position.rms, square.sqrt(), max_relative = 1e-9);
        // Outside of the taxels contacts are located worse, and now they are most of the skin.
        assert!(uneven.position.rms > 1.1 * even.position.rms, "{uneven:?} {even:?}");
    }

    #[test]
    fn impossible_presses_are_refused() {
        assert!(positive("force [N]", f64::NAN).is_err() && positive("force [N]", 0.0).is_err());
        insta::assert_snapshot!(positive("force [N]", -1.0).unwrap_err(), @"force [N] is -1 and must be positive");
    }
}
