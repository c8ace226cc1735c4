//! Contacts as peaks of a displacement map: k-Max.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use dermis_skin::Surface;
use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};

/// How peaks of a map become contacts. Serialised in the `[peaks]` table of a bundle's manifest.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PeakSettings {
    /// \[m\] along the surface within which a contact is the largest displacement.
    pub radius: f64,
    /// \[m\] of displacement below which nothing is a peak.
    pub least_displacement: f64,
    /// \[N\] below which a peak is no contact.
    pub least_force: f64,
    /// Share of the strongest contact's force below which a peak is taken for a ripple of the map.
    pub share: f64,
    /// Contacts at most.
    pub most: usize,
}

impl Default for PeakSettings {
    /// The thesis' radius and number of contacts; nothing is suppressed.
    fn default() -> Self {
        Self { radius: 0.010, least_displacement: 0.0, least_force: 0.0, share: 0.0, most: 4 }
    }
}

impl PeakSettings {
    /// Says what is impossible: field and reason.
    ///
    /// # Errors
    ///
    /// The name of the field, and what it must be.
    pub fn check(&self) -> Result<(), (&'static str, String)> {
        if !(self.radius.is_finite() && self.radius > 0.0) {
            return Err(("radius", format!("is {} and must be a positive length", self.radius)));
        }
        for (field, value) in
            [("least_displacement", self.least_displacement), ("least_force", self.least_force)]
        {
            if !(value.is_finite() && value >= 0.0) {
                return Err((field, format!("is {value} and must be 0 or positive")));
            }
        }
        if !(0.0..1.0).contains(&self.share) {
            return Err(("share", format!("is {} and must be at least 0 (off) and below 1", self.share)));
        }
        if !(1..=10).contains(&self.most) {
            return Err(("most", format!("is {} and must be 1 to 10", self.most)));
        }
        Ok(())
    }
}

/// One local maximum of a map.
#[derive(Debug, Clone, PartialEq)]
pub struct Peak {
    /// Index of the surface's point.
    pub point: usize,
    /// \[m\] where that is.
    pub position: Point3<f64>,
    /// Out of the surface there.
    pub normal: Vector3<f64>,
    /// \[m\] inwards.
    pub displacement: f64,
}

/// Finds the points that are pressed in farther than everything near them (k-Max: H. Sun and G. Martius, *Front. Neurorobot.* 13
/// (2019) 51). What is near lies within a radius along the edges of the triangulation, so that the two sides of a hole are as
/// far apart as the way around it.
#[derive(Debug, Clone)]
pub struct PeakFinder {
    points: Vec<Point3<f64>>,
    normals: Vec<Vector3<f64>>,
    /// Indices of the points near each, end to end.
    near: Vec<u32>,
    /// Where the neighbours of each point begin in `near`, and the end.
    starts: Vec<usize>,
}

impl PeakFinder {
    /// A finder for maps over the points of `surface`, of peaks that are `radius` \[m\] apart at least.
    #[must_use]
    pub fn new(surface: &Surface, radius: f64) -> Self {
        let mut edges: Vec<Vec<(u32, f64)>> = vec![Vec::new(); surface.points.len()];
        for t in &surface.triangles {
            for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
                let length = (surface.points[a as usize] - surface.points[b as usize]).norm();
                edges[a as usize].push((b, length));
                edges[b as usize].push((a, length));
            }
        }
        // Rounding must not drop a point that is exactly the radius away.
        let radius = radius * (1.0 + 1e-9);
        let (mut near, mut starts) = (Vec::new(), vec![0]);
        let mut distances = vec![f64::INFINITY; surface.points.len()];
        let mut heap = BinaryHeap::new();
        for from in 0..surface.points.len() {
            let mut reached = vec![from];
            distances[from] = 0.0;
            heap.push(QueueEntry { distance: 0.0, point: from });
            while let Some(QueueEntry { distance, point }) = heap.pop() {
                if distance > distances[point] {
                    continue;
                }
                for (next, step) in &edges[point] {
                    let (next, distance) = (*next as usize, distance + step);
                    if distance <= radius && distance < distances[next] {
                        if distances[next].is_infinite() {
                            reached.push(next);
                        }
                        distances[next] = distance;
                        heap.push(QueueEntry { distance, point: next });
                    }
                }
            }
            for point in reached {
                distances[point] = f64::INFINITY;
                if point != from {
                    near.push(point as u32);
                }
            }
            starts.push(near.len());
        }
        Self { points: surface.points.clone(), normals: surface.normals.clone(), near, starts }
    }

    /// Number of points of a map.
    #[must_use]
    pub fn points(&self) -> usize {
        self.points.len()
    }

    /// The points near one, itself left out.
    #[must_use]
    pub fn near(&self, point: usize) -> &[u32] {
        match (self.starts.get(point), self.starts.get(point + 1)) {
            (Some(from), Some(to)) => &self.near[*from..*to],
            _ => &[],
        }
    }

    /// Peaks of a `map` of displacements \[m\], one a point, that are above `least` \[m\]; the largest first. What is not a
    /// number is no peak. Empty for a map of another surface.
    #[must_use]
    pub fn find(&self, map: &[f64], least: f64) -> Vec<Peak> {
        if map.len() != self.points.len() {
            return Vec::new();
        }
        let mut peaks: Vec<Peak> = Vec::new();
        for (point, value) in map.iter().enumerate() {
            if !(value.is_finite() && *value > least) {
                continue;
            }
            // Of equal neighbours the first counts.
            let beaten = |other: &u32| {
                let other = *other as usize;
                map[other] > *value || (map[other] == *value && other < point)
            };
            if !self.near(point).iter().any(beaten) {
                peaks.push(Peak {
                    point,
                    position: self.points[point],
                    normal: self.normals[point],
                    displacement: *value,
                });
            }
        }
        peaks.sort_by(|a, b| b.displacement.total_cmp(&a.displacement));
        peaks
    }
}

/// Which of these forces \[N\] of peaks are contacts: the strongest ones that stand out, by index, the strongest first.
#[must_use]
pub fn suppress(forces: &[f64], settings: &PeakSettings) -> Vec<usize> {
    let mut order: Vec<usize> = (0..forces.len()).filter(|i| forces[*i].is_finite()).collect();
    order.sort_by(|a, b| forces[*b].total_cmp(&forces[*a]));
    let strongest = order.first().map_or(0.0, |i| forces[*i]);
    order.retain(|i| {
        forces[*i] > 0.0 && forces[*i] >= settings.least_force && forces[*i] >= settings.share * strongest
    });
    order.truncate(settings.most);
    order
}

/// A point in the queue of Dijkstra's search; the nearest comes out of the heap first.
struct QueueEntry {
    distance: f64,
    point: usize,
}

impl Ord for QueueEntry {
    fn cmp(&self, other: &Self) -> Ordering {
        other.distance.total_cmp(&self.distance).then(other.point.cmp(&self.point))
    }
}

impl PartialOrd for QueueEntry {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for QueueEntry {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for QueueEntry {}

#[cfg(test)]
mod tests {
    use dermis_skin::SurfaceSpec;

    use super::*;

    fn pad() -> Surface {
        Surface::from_spec(&SurfaceSpec::Rectangle { size: [0.1, 0.06], spacing: 0.002 })
    }

    fn bumps(surface: &Surface, bumps: &[(f64, f64, f64)]) -> Vec<f64> {
        let at = |p: &Point3<f64>| {
            let one = |(x, y, height): &(f64, f64, f64)| {
                height * (-((p.x - x).powi(2) + (p.y - y).powi(2)) / (2.0 * 0.006f64.powi(2))).exp()
            };
            bumps.iter().map(one).sum()
        };
        surface.points.iter().map(at).collect()
    }

    #[test]
    fn bumps_are_found_where_they_are() {
        let surface = pad();
        let finder = PeakFinder::new(&surface, 0.010);
        let all = [(0.02, 0.01, 1e-3), (-0.03, -0.01, 4e-4), (0.0, 0.02, 2e-4)];
        let peaks = finder.find(&bumps(&surface, &all), 5e-5);
        assert_eq!(peaks.len(), 3);
        for (peak, (x, y, height)) in peaks.iter().zip(all) {
            assert!((peak.position - Point3::new(x, y, 0.0)).norm() < 1e-9, "{peak:?}");
            assert!((peak.displacement / height - 1.0).abs() < 1e-2);
        }
        assert_eq!(finder.find(&bumps(&surface, &all), 3e-4).len(), 2);
    }

    #[test]
    fn a_plateau_has_one_peak_and_nothing_none() {
        let surface = pad();
        let finder = PeakFinder::new(&surface, 0.5);
        assert_eq!(finder.points(), surface.points.len());
        let plateau = finder.find(&vec![1e-3; surface.points.len()], 0.0);
        assert_eq!(plateau.iter().map(|peak| peak.point).collect::<Vec<_>>(), [0], "the first of equals");
        assert!(finder.find(&vec![0.0; surface.points.len()], 0.0).is_empty());
        assert!(finder.find(&vec![f64::NAN; surface.points.len()], 0.0).is_empty());
        assert!(finder.find(&[1.0], 0.0).is_empty(), "a map of another surface");
        let mut endless = vec![0.0; surface.points.len()];
        endless[7] = f64::INFINITY;
        assert!(finder.find(&endless, 0.0).is_empty());
    }

    #[test]
    fn what_is_near_lies_within_the_radius_along_the_surface() {
        let surface = pad();
        let finder = PeakFinder::new(&surface, 0.006);
        for point in [0, 777, surface.points.len() - 1] {
            let near = finder.near(point);
            assert!(!near.contains(&(point as u32)));
            for other in near {
                let distance = (surface.points[*other as usize] - surface.points[point]).norm();
                assert!(distance <= 0.006 + 1e-12);
            }
            // Along the grid's own lines the way is the distance.
            let straight = surface.points.iter().enumerate().filter(|(i, p)| {
                let d = **p - surface.points[point];
                *i != point && d.y.abs() < 1e-9 && d.x.abs() < 0.006 + 1e-9
            });
            for (i, _) in straight {
                assert!(near.contains(&(i as u32)), "{i}");
            }
        }
    }

    #[test]
    fn weak_peaks_are_suppressed() {
        let settings = PeakSettings { share: 0.2, least_force: 1.0, most: 2, ..PeakSettings::default() };
        assert_eq!(suppress(&[2.0, 10.0, 1.9, 5.0, f64::NAN], &settings), [1, 3]);
        // What is just strong enough counts: a fifth of the strongest, and one newton.
        let four = PeakSettings { most: 4, ..settings.clone() };
        assert_eq!(suppress(&[2.0, 10.0, 1.9, 5.0], &four), [1, 3, 0]);
        assert_eq!(suppress(&[1.0, 0.9, 4.0], &four), [2, 0]);
        assert_eq!(suppress(&[0.5], &settings), [] as [usize; 0]);
        assert_eq!(suppress(&[-1.0, 0.0], &PeakSettings::default()), [] as [usize; 0]);
    }

    #[test]
    fn settings_that_cannot_be_are_refused_by_field() {
        let settings = PeakSettings { share: 0.2, least_force: 1.0, most: 2, ..PeakSettings::default() };
        assert_eq!(settings.check(), Ok(()));
        assert_eq!(PeakSettings { share: 0.0, most: 10, ..settings.clone() }.check(), Ok(()));
        let refused = |s: PeakSettings| s.check().unwrap_err();
        let reason = |s: PeakSettings| refused(s).1;
        insta::assert_snapshot!(reason(PeakSettings { share: 1.0, ..settings.clone() }), @"is 1 and must be at least 0 (off) and below 1");
        insta::assert_snapshot!(reason(PeakSettings { radius: -1.0, ..settings.clone() }), @"is -1 and must be a positive length");
        for (field, wrong) in [
            ("radius", PeakSettings { radius: 0.0, ..settings.clone() }),
            ("radius", PeakSettings { radius: f64::INFINITY, ..settings.clone() }),
            ("least_displacement", PeakSettings { least_displacement: -1e-6, ..settings.clone() }),
            ("least_displacement", PeakSettings { least_displacement: f64::INFINITY, ..settings.clone() }),
            ("least_force", PeakSettings { least_force: f64::NAN, ..settings.clone() }),
            ("share", PeakSettings { share: -0.1, ..settings.clone() }),
            ("most", PeakSettings { most: 0, ..settings.clone() }),
            ("most", PeakSettings { most: 11, ..settings }),
        ] {
            assert_eq!(refused(wrong.clone()).0, field, "{wrong:?}");
        }
    }
}
