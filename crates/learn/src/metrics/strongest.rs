//! One contact, read off the strongest points of a map of force vectors.
//!
//! Problem: how well does a map tell place, force and width of the one contact that presses? Method (thesis, section 6.4.2): its place is the
//! mean of the [`POINTS`](StrongestErrors::POINTS) points with the largest forces, its force the sum of all points, and its width that of the area whose points have
//! more than a threshold each ([`THRESHOLDS`](StrongestErrors::THRESHOLDS)). Errors are the distance of locations, the length of the difference of force vectors, the
//! difference of their lengths, and the angle between them; all are medians, by true force, too.
//!
//! Assumption: one contact presses, and all of its force is known; other frames are left out, and their share is reported. Points have areas, and a
//! contact area is as wide as the circle of the same area. Cost: one sort of the points a frame.

use dermis_skin::Surface;
use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};

use super::{FORCE_BINS, bin_of, median};
use crate::dataset::Truth;

/// Errors of one contact that is read off a map of force vectors.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StrongestErrors {
    /// Share of touched frames that were left out, because not one contact presses whose force is known.
    pub left_out: f64,
    /// Of all others.
    pub all: StrongestPart,
    /// By true normal force; empty bins are left out.
    pub by_force: Vec<StrongestPart>,
}

impl StrongestErrors {
    /// Points whose mean is the place of a contact (thesis, section 6.4.2).
    pub const POINTS: usize = 20;
    /// \[N\] from which on a point is part of the contact area (thesis, section 6.4.2 and Fig. 6.11).
    pub const THRESHOLDS: [f64; 2] = [0.02, 0.01];
}

/// Medians of some frames.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct StrongestPart {
    /// \[N\] least normal force.
    pub from: f64,
    /// Frames.
    pub frames: usize,
    /// \[m\] between the mean of the strongest points and the true place.
    pub position: f64,
    /// \[N\] length of the difference of both forces.
    pub force: f64,
    /// \[N\] difference of the lengths of both forces, without its sign.
    pub amplitude: f64,
    /// \[rad\] between both forces.
    pub angle: f64,
    /// \[m\] width of the contact area by each of [`THRESHOLDS`](StrongestErrors::THRESHOLDS).
    pub diameters: [f64; 2],
}

/// What one frame is off by.
#[derive(Debug, Clone, Copy)]
struct Errors {
    normal: f64,
    position: f64,
    force: f64,
    amplitude: f64,
    angle: f64,
    diameters: [f64; 2],
}

/// Compares maps of force vectors with the contact that is true, frame by frame.
#[derive(Debug, Clone)]
pub(super) struct StrongestPoints {
    points: Vec<Point3<f64>>,
    areas: Vec<f64>,
    found: Vec<Errors>,
    left_out: usize,
}

impl StrongestPoints {
    pub(super) fn new(surface: &Surface) -> Self {
        Self { points: surface.points.clone(), areas: surface.areas.clone(), found: Vec::new(), left_out: 0 }
    }

    /// Compares the map of a touched frame \[N\], three numbers a point.
    pub(super) fn push(&mut self, truth: &Truth, map: &[f64]) {
        let known = truth.single().and_then(|contact| Some((contact, contact.normal_force()?)));
        let known = known.filter(|(contact, _)| contact.force.iter().all(|f| f.is_finite()));
        let Some((contact, normal)) = known.filter(|_| map.len() == 3 * self.points.len()) else {
            self.left_out += 1;
            return;
        };
        let forces: Vec<Vector3<f64>> =
            map.as_chunks::<3>().0.iter().map(|f| Vector3::from_column_slice(f)).collect();
        let mut order: Vec<(f64, usize)> = forces.iter().map(Vector3::norm).zip(0..).collect();
        order.sort_by(|a, b| b.0.total_cmp(&a.0));
        let strongest = &order[..StrongestErrors::POINTS.min(order.len())];
        let place = strongest.iter().map(|(_, i)| self.points[*i].coords).sum::<Vector3<f64>>()
            / strongest.len().max(1) as f64;
        let sum: Vector3<f64> = forces.iter().sum();
        let width = |threshold: f64| {
            let within = order.iter().take_while(|(f, _)| *f > threshold);
            let area = within.fold(0.0, |sum, (_, i)| sum + self.areas[*i]);
            2.0 * (area / std::f64::consts::PI).sqrt()
        };
        self.found.push(Errors {
            normal,
            position: (place - contact.position.coords).norm(),
            force: (sum - contact.force).norm(),
            amplitude: (sum.norm() - contact.force.norm()).abs(),
            angle: sum.angle(&contact.force),
            diameters: StrongestErrors::THRESHOLDS.map(width),
        });
    }

    /// Sums up; `None` where nothing was compared.
    pub(super) fn finish(&self) -> Option<StrongestErrors> {
        let part = |from: f64, frames: &[&Errors]| {
            let of = |value: &dyn Fn(&Errors) -> f64| {
                median(&mut frames.iter().map(|errors| value(errors)).collect::<Vec<_>>())
            };
            StrongestPart {
                from,
                frames: frames.len(),
                position: of(&|e| e.position),
                force: of(&|e| e.force),
                amplitude: of(&|e| e.amplitude),
                angle: of(&|e| e.angle),
                diameters: [0, 1].map(|k| of(&|e| e.diameters[k])),
            }
        };
        let all: Vec<&Errors> = self.found.iter().collect();
        let bin = |(k, from): (usize, &f64)| {
            let within: Vec<&Errors> = self.found.iter().filter(|e| bin_of(e.normal) == k).collect();
            (!within.is_empty()).then(|| part(*from, &within))
        };
        (!all.is_empty()).then(|| StrongestErrors {
            left_out: self.left_out as f64 / (self.left_out + all.len()) as f64,
            all: part(0.0, &all),
            by_force: FORCE_BINS.iter().enumerate().filter_map(bin).collect(),
        })
    }
}

#[cfg(test)]
mod tests {
    use dermis_skin::SurfaceSpec;

    use super::*;
    use crate::dataset::tests::contact;

    #[test]
    fn a_contact_is_read_off_the_strongest_points() {
        let surface = Surface::from_spec(&SurfaceSpec::Rectangle { size: [0.02, 0.02], spacing: 0.001 });
        let mut scores = StrongestPoints::new(&surface);
        let mut one = contact(0.001, 0.0, 2.0);
        one.force = Vector3::new(0.0, 0.0, -2.0);
        let truth = Truth { press: 0, location: 0, idle: false, contacts: vec![one.clone()] };
        // 2 N, leaning by atan 0.1 along x, on the points within 3 mm of a place 1 mm beside the true one.
        let within = |p: &Point3<f64>| p.x.hypot(p.y) < 3e-3;
        let count = surface.points.iter().filter(|p| within(p)).count();
        assert!(count > StrongestErrors::POINTS);
        let share = 2.0 / count as f64;
        let on = |p: &Point3<f64>| if within(p) { [0.1 * share, 0.0, -share] } else { [0.0; 3] };
        let map: Vec<f64> = surface.points.iter().flat_map(on).collect();
        scores.push(&truth, &map);
        // Two contacts are left out, and so is one whose force is not known.
        let two = Truth { contacts: vec![one.clone(), contact(-0.005, 0.0, 1.0)], ..truth.clone() };
        scores.push(&two, &map);
        let errors = scores.finish().unwrap();
        assert_eq!((errors.left_out, errors.all.frames), (0.5, 1));
        approx::assert_relative_eq!(errors.all.force, 0.2, max_relative = 1e-9);
        approx::assert_relative_eq!(errors.all.amplitude, 2.0 * (1.01_f64.sqrt() - 1.0), max_relative = 1e-9);
        approx::assert_relative_eq!(errors.all.angle, 0.1_f64.atan(), max_relative = 1e-9);
        // The first twenty of equal points lie on one side.
        assert!((errors.all.position - 1e-3).abs() < 2e-3);
        let area: f64 =
            surface.points.iter().zip(&surface.areas).filter(|(p, _)| within(p)).map(|(_, a)| a).sum();
        let wide = 2.0 * (area / std::f64::consts::PI).sqrt();
        approx::assert_relative_eq!(errors.all.diameters[0], wide, max_relative = 1e-9);
        assert_eq!(errors.by_force.iter().map(|b| (b.from, b.frames)).collect::<Vec<_>>(), [(2.0, 1)]);
        assert!(StrongestPoints::new(&surface).finish().is_none());
    }
}
