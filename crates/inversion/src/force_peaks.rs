//! Contacts as peaks of a map of forces: where, how hard, how wide.
//!
//! Problem: a map gives the force on every point of a surface; how many contacts is that, and what are they? Method: a contact is a
//! point whose pressure is the largest within a disc around it (k-Max with a fixed neighbourhood, thesis section 4.3.2) and whose
//! disc bears a force of a threshold or more. Its force is the sum over the disc around its middle. Its diameter is the full width at half maximum: that of
//! the circle with the area of all points around the peak that bear half of its pressure or more. Its place is the centre of these
//! points' forces, because the largest point of a flat contact is any of them.
//!
//! A disc is the connected part of the surface, along the edges of its triangulation, that lies within a ball around the point. So a
//! hole or the back of a thin limb divides it. Pressures are compared, and not forces, because points at a rim stand for less area.
//!
//! Assumptions: contacts lie at least a disc's radius apart; discs that overlap share forces, and both count them. Cost: memory of all
//! discs, points × points in a disc; a map takes one pass over them.

use dermis_skin::Surface;
use nalgebra::{Point3, Vector3};

/// One contact of a map.
#[derive(Debug, Clone, PartialEq)]
pub struct ForcePeak {
    /// Index of the surface's point that bears the largest pressure.
    pub point: usize,
    /// \[m\] centre of the forces that are half of the largest pressure or more.
    pub position: Point3<f64>,
    /// \[N\] sum over the disc.
    pub force: f64,
    /// \[m\] full width at half maximum.
    pub diameter: f64,
}

/// Finds contacts in maps of pressing forces.
#[derive(Debug, Clone)]
pub struct ForcePeakFinder {
    points: Vec<Point3<f64>>,
    areas: Vec<f64>,
    /// Neighbours along edges, and the points of the disc around each, end to end.
    edges: Lists,
    discs: Lists,
    /// \[m\] of the discs.
    radius: f64,
}

/// Lists of indices, end to end.
#[derive(Debug, Clone, Default)]
struct Lists {
    values: Vec<u32>,
    /// Where each list begins in `values`, and the end.
    starts: Vec<usize>,
}

impl Lists {
    fn of(lists: impl Iterator<Item = Vec<u32>>) -> Self {
        let mut all = Self { values: Vec::new(), starts: vec![0] };
        for list in lists {
            all.values.extend(list);
            all.starts.push(all.values.len());
        }
        all
    }

    fn get(&self, index: usize) -> &[u32] {
        match (self.starts.get(index), self.starts.get(index + 1)) {
            (Some(from), Some(to)) => &self.values[*from..*to],
            _ => &[],
        }
    }
}

/// Indices that are reached from `from` over `edges` through such as `inside` takes, `from` first; `seen` is all false before and
/// after.
fn connected(from: u32, edges: &Lists, seen: &mut [bool], inside: impl Fn(u32) -> bool) -> Vec<u32> {
    let mut found = vec![from];
    seen[from as usize] = true;
    let mut next = 0;
    while let Some(at) = found.get(next).copied() {
        next += 1;
        for to in edges.get(at as usize) {
            if !seen[*to as usize] && inside(*to) {
                seen[*to as usize] = true;
                found.push(*to);
            }
        }
    }
    found.iter().for_each(|i| seen[*i as usize] = false);
    found
}

impl ForcePeakFinder {
    /// A finder for maps over the points of `surface`, with discs of `diameter` \[m\].
    #[must_use]
    pub fn new(surface: &Surface, diameter: f64) -> Self {
        let points = &surface.points;
        let mut neighbours: Vec<Vec<u32>> = vec![Vec::new(); points.len()];
        for t in &surface.triangles {
            for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
                neighbours[a as usize].push(b);
                neighbours[b as usize].push(a);
            }
        }
        let edges = Lists::of(neighbours.into_iter());
        // Rounding must not drop a point that is exactly the radius away.
        let radius = diameter / 2.0 * (1.0 + 1e-9);
        let mut seen = vec![false; points.len()];
        let disc = |i: usize| {
            let within = |other: u32| (points[other as usize] - points[i]).norm() <= radius;
            connected(i as u32, &edges, &mut seen, within)
        };
        let discs = Lists::of((0..points.len()).map(disc));
        Self { points: points.clone(), areas: surface.areas.clone(), edges, discs, radius }
    }

    /// Number of points of a map.
    #[must_use]
    pub fn points(&self) -> usize {
        self.points.len()
    }

    /// Contacts in a map of pressing forces \[N\], one a point, whose disc bears `threshold` \[N\] or more; the strongest first. What is
    /// not a number counts as 0. Empty for a map of another surface.
    #[must_use]
    pub fn find(&self, forces: &[f64], threshold: f64) -> Vec<ForcePeak> {
        if forces.len() != self.points.len() {
            return Vec::new();
        }
        let force = |i: u32| Some(forces[i as usize]).filter(|f| f.is_finite()).unwrap_or(0.0);
        let pressures: Vec<f64> =
            (0..forces.len()).map(|i| force(i as u32) / self.areas[i].max(f64::MIN_POSITIVE)).collect();
        let mut seen = vec![false; forces.len()];
        let mut peaks = Vec::new();
        for (point, pressure) in pressures.iter().enumerate() {
            let disc = self.discs.get(point);
            // Of equal neighbours the first counts.
            let beaten = |other: &u32| {
                let other = *other as usize;
                pressures[other] > *pressure || (pressures[other] == *pressure && other < point)
            };
            if *pressure <= 0.0 || disc.iter().any(beaten) {
                continue;
            }
            let half = self.half(point as u32, pressure / 2.0, &pressures, &mut seen);
            let (mut area, mut total, mut moment) = (0.0, 0.0, Vector3::zeros());
            for i in half.points.iter().map(|i| *i as usize) {
                area += self.areas[i];
                total += force(i as u32);
                moment += self.points[i].coords * force(i as u32);
            }
            let force: f64 = self.discs.get(half.middle as usize).iter().map(|i| force(*i)).sum();
            if force >= threshold {
                let diameter = 2.0 * (area / std::f64::consts::PI).sqrt();
                peaks.push(ForcePeak { point, position: Point3::from(moment / total), force, diameter });
            }
        }
        peaks.sort_by(|a, b| b.force.total_cmp(&a.force));
        peaks
    }
}

/// The points of a contact that bear half of its pressure or more.
struct Half {
    /// The one nearest to their centre.
    middle: u32,
    points: Vec<u32>,
}

/// Steps of a disc towards the middle of its contact.
const STEPS: usize = 6;

impl ForcePeakFinder {
    /// Connected points around `peak` of this pressure or more, within the disc around their own middle: of a flat contact the largest
    /// point is any, and may lie at its edge.
    fn half(&self, peak: u32, least: f64, pressures: &[f64], seen: &mut [bool]) -> Half {
        let mut half = Half { middle: peak, points: Vec::new() };
        for _ in 0..STEPS {
            let middle = half.middle;
            let about = self.points[middle as usize];
            let wide = |i: u32| {
                pressures[i as usize] >= least && (self.points[i as usize] - about).norm() <= self.radius
            };
            // A ring has no contact in its middle.
            let start = if pressures[middle as usize] >= least { middle } else { peak };
            half.points = connected(start, &self.edges, seen, wide);
            let weight = |i: &u32| pressures[*i as usize] * self.areas[*i as usize];
            let total: f64 = half.points.iter().map(weight).sum();
            let moment: Vector3<f64> =
                half.points.iter().map(|i| self.points[*i as usize].coords * weight(i)).sum();
            let away = |i: &u32| (self.points[*i as usize].coords - moment / total).norm();
            let nearest = half.points.iter().copied().min_by(|a, b| away(a).total_cmp(&away(b)));
            half.middle = nearest.unwrap_or(middle);
            if half.middle == middle {
                break;
            }
        }
        half
    }
}

#[cfg(test)]
mod tests {
    use dermis_skin::SurfaceSpec;

    use super::*;

    fn panel() -> Surface {
        Surface::from_spec(&SurfaceSpec::Rectangle { size: [0.54, 0.56], spacing: 0.005 })
    }

    /// Forces \[N\] spread evenly over discs of this diameter.
    fn discs(surface: &Surface, diameter: f64, contacts: &[(f64, f64, f64)]) -> Vec<f64> {
        let mut map = vec![0.0; surface.points.len()];
        for (x, y, force) in contacts {
            // Points that are exactly on the circle are in it.
            let inside = |p: &Point3<f64>| (p.x - x).hypot(p.y - y) <= diameter / 2.0 + 1e-9;
            let points: Vec<usize> = (0..map.len()).filter(|i| inside(&surface.points[*i])).collect();
            let area: f64 = points.iter().map(|i| surface.areas[*i]).sum();
            points.iter().for_each(|i| map[*i] += force * surface.areas[*i] / area);
        }
        map
    }

    #[test]
    fn flat_contacts_are_found_where_and_as_hard_and_wide_as_they_are() {
        let surface = panel();
        let finder = ForcePeakFinder::new(&surface, 0.064);
        let contacts = [(0.1, 0.05, 40.0), (-0.15, -0.2, 12.0), (-0.15, 0.0, 5.0), (0.0, -0.1, 4.0)];
        let map = discs(&surface, 0.04, &contacts);
        let found = finder.find(&map, 5.0);
        assert_eq!(found.len(), 3, "the last one is below the threshold");
        for (peak, (x, y, force)) in found.iter().zip(contacts) {
            // Contacts are centred on points, so that the discs are symmetric.
            assert!((peak.position - Point3::new(x, y, 0.0)).norm() < 1e-9, "{peak:?}");
            assert!((peak.force / force - 1.0).abs() < 1e-9, "{peak:?}");
            // A disc of 8 spacings has 49 points in place of 50.3.
            assert!((peak.diameter / 0.04 - 1.0).abs() < 0.02, "{peak:?}");
        }
        assert_eq!(finder.find(&map, 2.5).len(), 4);
        assert!(finder.find(&map[1..], 2.5).is_empty(), "a map of another surface");
        assert!(finder.find(&vec![f64::NAN; map.len()], 0.0).is_empty());
        assert!(finder.find(&vec![0.0; map.len()], 0.0).is_empty(), "nothing presses");
    }

    #[test]
    fn wide_flat_contacts_keep_their_force_and_place() {
        let surface = panel();
        let finder = ForcePeakFinder::new(&surface, 0.064);
        for diameter in [0.02, 0.03, 0.05, 0.06] {
            let found = finder.find(&discs(&surface, diameter, &[(0.05, -0.1, 20.0)]), 5.0);
            assert_eq!(found.len(), 1, "{diameter} m: {found:?}");
            assert!(
                (found[0].position - Point3::new(0.05, -0.1, 0.0)).norm() < 1e-9,
                "{diameter} m: {found:?}"
            );
            assert!((found[0].force - 20.0).abs() < 1e-9, "{diameter} m: {found:?}");
            assert!((found[0].diameter / diameter - 1.0).abs() < 0.05, "{diameter} m: {found:?}");
        }
    }

    #[test]
    fn a_rim_does_not_change_where_the_peak_is() {
        let surface = panel();
        let finder = ForcePeakFinder::new(&surface, 0.064);
        let found = finder.find(&discs(&surface, 0.03, &[(0.27, 0.0, 10.0)]), 5.0);
        assert_eq!(found.len(), 1);
        assert!((found[0].force - 10.0).abs() < 1e-9);
        // The centre of half a disc lies 4 r / (3 π) inside of the rim; points are 5 mm apart.
        let inside = 0.27 - found[0].position.x;
        assert!(inside > 0.004 && inside < 0.008 && found[0].position.y.abs() < 1e-9, "{found:?}");
    }

    #[test]
    fn contacts_closer_than_the_radius_are_one_and_farther_ones_are_two() {
        let surface = panel();
        let finder = ForcePeakFinder::new(&surface, 0.064);
        for (apart, number) in [(0.025, 1), (0.06, 2)] {
            let both = [(0.0, 0.0, 20.0), (apart, 0.0, 19.0)];
            assert_eq!(finder.find(&discs(&surface, 0.02, &both), 5.0).len(), number, "{apart} m");
        }
    }

    #[test]
    fn a_disc_is_round_and_ends_where_the_surface_does() {
        let surface = panel();
        let finder = ForcePeakFinder::new(&surface, 0.064);
        let middle = (0..surface.points.len()).min_by(|a, b| {
            let away = |i: &usize| surface.points[*i].coords.norm();
            away(a).total_cmp(&away(b))
        });
        let disc = finder.discs.get(middle.unwrap());
        // Points of a grid of 5 mm within 32 mm of one: the Gauss circle problem with a radius of 6.4 has 129.
        assert_eq!(disc.len(), 129);
        // On a finger of 20 mm a ball of 11 mm reaches around half of the wall, and not its back.
        let finger = Surface::from_spec(&SurfaceSpec::Dome { radius: 0.01, cylinder: 0.1, spacing: 0.002 });
        let thin = ForcePeakFinder::new(&finger, 0.022);
        let (front, back) = (nearest(&finger, [0.01, 0.0, 0.05]), nearest(&finger, [-0.01, 0.0, 0.05]));
        assert!(!thin.discs.get(front).contains(&(back as u32)));
        assert!(thin.discs.get(front).len() > 20);
    }

    fn nearest(surface: &Surface, at: [f64; 3]) -> usize {
        let away = |i: &usize| (surface.points[*i] - Point3::from(at)).norm();
        (0..surface.points.len()).min_by(|a, b| away(a).total_cmp(&away(b))).unwrap()
    }
}
