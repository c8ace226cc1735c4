//! A line along a surface.
//!
//! Problem: a row of taxels on a curved skin. Method: equal steps straight ahead, each projected onto the surface and turned with its
//! normal (a discrete geodesic). Assumptions: the step is small against the surface's radius. Cost: one projection a step.

use dermis_skin::Surface;
use nalgebra::{Point3, Vector3};

use crate::TheoryError;
use crate::surface::positive;

/// Locations that a path has at most.
const MOST: usize = 100_000;

/// The straightest line across a surface, as locations at equal steps.
#[derive(Debug, Clone, PartialEq)]
pub struct Path {
    /// \[m\] on the surface.
    pub points: Vec<Point3<f64>>,
    /// Unit, out of the skin, one a place.
    pub normals: Vec<Vector3<f64>>,
    /// \[m\] along the path from its first place, ascending from 0.
    pub arc: Vec<f64>,
    /// \[m\] all around, where the last place is followed by the first.
    pub around: Option<f64>,
}

impl Path {
    /// Goes from `through` along `direction` and against it, in steps of `step` \[m\], until the surface ends or the path
    /// comes back to where it began.
    ///
    /// # Errors
    ///
    /// [`TheoryError::NotPositive`] for a step that is not; [`TheoryError::Direction`] where `direction` leads out of the
    /// surface.
    pub fn across(
        surface: &Surface,
        through: &Point3<f64>,
        direction: &Vector3<f64>,
        step: f64,
    ) -> Result<Self, TheoryError> {
        let (points, closed) = Self::locations(surface, through, direction, step)?;
        let normals = points.iter().map(|p| surface.project(p).1).collect();
        // On a mesh the shortest way over its edges would be many times a step; locations that follow each other lie straight ahead.
        let exact = surface.has_closed_form();
        let apart =
            |a: &Point3<f64>, b: &Point3<f64>| if exact { surface.geodesic(a, b) } else { (b - a).norm() };
        let mut arc = Vec::with_capacity(points.len());
        let mut length = 0.0;
        for (i, point) in points.iter().enumerate() {
            if i > 0 {
                length += apart(&points[i - 1], point);
            }
            arc.push(length);
        }
        let around = match (closed, points.first(), points.last()) {
            (true, Some(first), Some(last)) => Some(length + apart(last, first)),
            _ => None,
        };
        Ok(Self { points, normals, arc, around })
    }

    /// The locations of a path, and whether it comes back to where it began.
    pub(crate) fn locations(
        surface: &Surface,
        through: &Point3<f64>,
        direction: &Vector3<f64>,
        step: f64,
    ) -> Result<(Vec<Point3<f64>>, bool), TheoryError> {
        positive("step of a path [m]", step)?;
        let (start, normal) = surface.project(through);
        let along = (direction - normal * normal.dot(direction)).try_normalize(1e-9);
        let along = along.ok_or(TheoryError::Direction)?;
        let (ahead, closed) = straight_ahead(surface, start, along, step);
        let behind = if closed { Vec::new() } else { straight_ahead(surface, start, -along, step).0 };
        Ok((behind.into_iter().rev().chain(std::iter::once(start)).chain(ahead).collect(), closed))
    }

    /// \[m\] from end to end, or all around.
    #[must_use]
    pub fn length(&self) -> f64 {
        self.around.or(self.arc.last().copied()).unwrap_or_default()
    }

    /// Index of the place that is nearest to a point, and how far it is \[m\].
    #[must_use]
    pub fn nearest(&self, point: &Point3<f64>) -> (usize, f64) {
        nearest(&self.points, point)
    }

    /// Where a point lies along the path \[m\]: the foot on its nearest piece.
    #[must_use]
    pub fn foot(&self, point: &Point3<f64>) -> f64 {
        let (nearest, _) = self.nearest(point);
        let around = nearest.saturating_sub(1)..(nearest + 1).min(self.points.len().saturating_sub(1));
        let feet = around.map(|i| {
            let piece = self.points[i + 1] - self.points[i];
            let share = ((point - self.points[i]).dot(&piece) / piece.norm_squared()).clamp(0.0, 1.0);
            let apart = (self.points[i] + piece * share - point).norm();
            (apart, self.arc[i] + share * (self.arc[i + 1] - self.arc[i]))
        });
        feet.min_by(|a, b| a.0.total_cmp(&b.0)).map_or(0.0, |f| f.1)
    }
}

/// Index of the point that is nearest to another one, and how far it is \[m\].
pub(crate) fn nearest(points: &[Point3<f64>], point: &Point3<f64>) -> (usize, f64) {
    let distances = points.iter().map(|p| (p - point).norm()).enumerate();
    distances.min_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or((0, f64::NAN))
}

/// Points that differ, in the order in which each comes first, and which of them each point is: many channels may belong to one
/// taxel.
pub(crate) fn distinct(points: &[Point3<f64>]) -> (Vec<Point3<f64>>, Vec<usize>) {
    let mut found: Vec<Point3<f64>> = Vec::new();
    let of = points.iter().map(|point| {
        found.iter().position(|p| p == point).unwrap_or_else(|| {
            found.push(*point);
            found.len() - 1
        })
    });
    let of = of.collect();
    (found, of)
}

/// Locations ahead of a start, and whether they come back to it.
fn straight_ahead(
    surface: &Surface,
    start: Point3<f64>,
    along: Vector3<f64>,
    step: f64,
) -> (Vec<Point3<f64>>, bool) {
    let (mut at, mut along) = (start, along);
    let mut locations = Vec::new();
    while locations.len() < MOST {
        let (next, normal) = surface.project(&(at + along * step));
        let moved = next - at;
        // What is left of a step at the edge is its last.
        if moved.norm() < 1e-3 * step {
            break;
        }
        locations.push(next);
        if locations.len() > 3 && (next - start).norm() < 0.75 * step {
            locations.pop();
            return (locations, true);
        }
        if moved.norm() < 0.5 * step || moved.dot(&along) < 0.5 * moved.norm() {
            break;
        }
        let Some(turned) = (along - normal * normal.dot(&along)).try_normalize(1e-9) else { break };
        (at, along) = (next, turned);
    }
    (locations, false)
}

#[cfg(test)]
mod tests {
    use dermis_skin::SurfaceSpec;

    use super::*;

    #[test]
    fn a_strip_is_crossed_from_end_to_end() {
        let surface = Surface::from_spec(&SurfaceSpec::Rectangle { size: [0.0325, 0.0002], spacing: 0.0005 });
        let path = Path::across(&surface, &Point3::origin(), &Vector3::x(), 0.0002).unwrap();
        approx::assert_relative_eq!(path.length(), 0.0325, max_relative = 1e-9);
        assert_eq!(path.points[0], Point3::new(-0.01625, 0.0, 0.0));
        assert!(path.arc.windows(2).all(|w| w[1] > w[0]));
        approx::assert_relative_eq!(
            path.foot(&Point3::new(0.00325, 0.0, -0.005)),
            0.0195,
            max_relative = 1e-9
        );
        assert!(Path::across(&surface, &Point3::origin(), &Vector3::z(), 0.0002).is_err());
    }

    #[test]
    fn a_dome_is_crossed_over_its_tip_and_gone_around() {
        let (radius, cylinder) = (0.010, 0.016);
        let surface = Surface::from_spec(&SurfaceSpec::Dome { radius, cylinder, spacing: 0.002 });
        let tip = Point3::new(0.0, 0.0, 0.026);
        let over = Path::across(&surface, &tip, &Vector3::x(), 0.0002).unwrap();
        let exact = std::f64::consts::PI * radius + 2.0 * cylinder;
        approx::assert_relative_eq!(over.length(), exact, max_relative = 1e-3);
        let around = Path::across(&surface, &Point3::new(0.01, 0.0, 0.008), &Vector3::y(), 0.0002).unwrap();
        approx::assert_relative_eq!(around.length(), std::f64::consts::TAU * radius, max_relative = 1e-2);
        assert!(around.around.is_some() && over.around.is_none());
    }
}
