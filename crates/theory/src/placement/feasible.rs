//! Which candidates can be built at all (thesis 2.2.2, Fig. 2.3b).

use dermis_skin::Surface;
use nalgebra::{Point3, Vector3};
use serde::Serialize;

/// What keeps a candidate from being built.
#[derive(Debug, Clone, Default)]
pub struct Feasibility {
    /// Points of the surface around a candidate that count, k.
    pub neighbours: usize,
    /// \[m\] that their centre may lie off the candidate, θ; further off, the candidate is at an edge.
    pub edge: f64,
    /// Locations where the skin is held.
    pub held: Vec<Point3<f64>>,
    /// \[m\] around them where only small deformations occur.
    pub margin: f64,
}

/// Whether a candidate can be built.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// It can.
    Feasible,
    /// It lies at an edge.
    Edge,
    /// It lies close to where the skin is held.
    Held,
}

/// Judges locations on a surface. A centre counts as far as it lies along the surface: that of points on a curved one lies below
/// it everywhere.
#[must_use]
pub fn feasible(surface: &Surface, locations: &[Point3<f64>], rule: &Feasibility) -> Vec<Verdict> {
    let count = rule.neighbours.min(surface.points.len());
    locations
        .iter()
        .map(|location| {
            if rule.held.iter().any(|held| (held - location).norm() < rule.margin) {
                return Verdict::Held;
            }
            if count == 0 {
                return Verdict::Feasible;
            }
            let mut around: Vec<(f64, usize)> =
                surface.points.iter().enumerate().map(|(i, p)| ((p - location).norm_squared(), i)).collect();
            // Those as far as the last one count, too: a grid has many at one distance, and any choice among them is lopsided.
            let (_, last, _) = around.select_nth_unstable_by(count - 1, |a, b| a.0.total_cmp(&b.0));
            let reach = last.0 * (1.0 + 1e-6) + 1e-18;
            let within: Vec<usize> = around.iter().filter(|(d, _)| *d <= reach).map(|(_, i)| *i).collect();
            let sum: Vector3<f64> = within.iter().map(|i| surface.points[*i] - location).sum();
            let off = sum / within.len() as f64;
            let normal = within.iter().map(|i| surface.normals[*i]).sum::<Vector3<f64>>();
            let normal = normal.try_normalize(1e-9).unwrap_or_else(Vector3::z);
            if (off - normal * off.dot(&normal)).norm() > rule.edge {
                Verdict::Edge
            } else {
                Verdict::Feasible
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use dermis_skin::SurfaceSpec;

    use super::*;

    #[test]
    fn edges_and_supports_are_left_out() {
        // 21 × 11 points, 2 mm apart.
        let surface = Surface::from_spec(&SurfaceSpec::Rectangle { size: [0.04, 0.02], spacing: 0.002 });
        let rule = Feasibility { neighbours: 9, edge: 0.0006, ..Feasibility::default() };
        let verdicts = feasible(&surface, &surface.points, &rule);
        for (p, v) in surface.points.iter().zip(&verdicts) {
            let rim = p.x.abs() > 0.0199 || p.y.abs() > 0.0099;
            assert_eq!(*v, if rim { Verdict::Edge } else { Verdict::Feasible }, "{p}");
        }
        let held = surface.points.iter().filter(|p| p.x.abs() > 0.0199).copied().collect();
        let verdicts = feasible(&surface, &surface.points, &Feasibility { held, margin: 0.005, ..rule });
        for (p, v) in surface.points.iter().zip(&verdicts) {
            assert_eq!(*v == Verdict::Held, p.x.abs() > 0.015 + 1e-9, "{p}");
        }
    }

    #[test]
    fn curvature_is_no_edge() {
        let spec = SurfaceSpec::Dome { radius: 0.01, cylinder: 0.016, spacing: 0.001 };
        let surface = Surface::from_spec(&spec);
        let rule = Feasibility { neighbours: 12, edge: 0.0005, ..Feasibility::default() };
        let verdicts = feasible(&surface, &surface.points, &rule);
        for (p, v) in surface.points.iter().zip(&verdicts) {
            if p.z > 0.003 {
                assert_eq!(*v, Verdict::Feasible, "{p}");
            }
        }
        assert!(verdicts.contains(&Verdict::Edge));
    }
}
