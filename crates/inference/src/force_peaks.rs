//! A force map → contacts.

use dermis_inversion::ForcePeakFinder;
use dermis_model::tangents;
use dermis_skin::{Contact, ForceComponents, Surface};

mod section;

pub use section::{ForcePeakSection, MAP_NORMAL};

/// Reads contacts off force maps; the discs of the surface are found once.
#[derive(Debug)]
pub struct ForceMapContacts {
    finder: ForcePeakFinder,
    section: ForcePeakSection,
    surface: Surface,
}

impl ForceMapContacts {
    /// For maps over a surface.
    #[must_use]
    pub fn new(section: ForcePeakSection, surface: &Surface) -> Self {
        Self { finder: ForcePeakFinder::new(surface, section.disc), section, surface: surface.clone() }
    }

    /// \[N\] root mean square error of its forces, where it was measured.
    #[must_use]
    pub fn force_sigma(&self) -> Option<f64> {
        self.section.force_sigma
    }

    /// Contacts of a map \[N\], the strongest first; empty for a map of another surface.
    #[must_use]
    pub fn contacts(&self, map: &[f64]) -> Vec<Contact> {
        let square = |sigma: Option<f64>| sigma.map_or(f64::NAN, |s| s * s);
        let contact = |peak: dermis_inversion::ForcePeak| {
            let (position, normal) = self.surface.project(&peak.position);
            let mut contact = Contact::at(position, normal);
            contact.force = -normal * peak.force;
            contact.force_components = ForceComponents::Normal;
            contact.diameter = peak.diameter as f32;
            let along = tangents(&normal).map(|t| t * t.transpose() * square(self.section.position_sigma));
            contact.position_covariance = along[0] + along[1];
            contact.force_covariance = normal * normal.transpose() * square(self.section.force_sigma);
            contact
        };
        let peaks = self.finder.find(map, self.section.threshold);
        peaks.into_iter().take(self.section.most).map(contact).collect()
    }
}

#[cfg(test)]
mod tests {
    use dermis_skin::SurfaceSpec;

    use super::*;

    fn section() -> ForcePeakSection {
        ForcePeakSection {
            disc: 0.064,
            threshold: 5.0,
            most: 6,
            position_sigma: Some(0.01),
            force_sigma: None,
        }
    }

    #[test]
    fn two_presses_are_two_contacts_the_strongest_first() {
        let surface = Surface::from_spec(&SurfaceSpec::Rectangle { size: [0.4, 0.4], spacing: 0.02 });
        let reader = ForceMapContacts::new(section(), &surface);
        let mut map = vec![0.0; surface.points.len()];
        let nearest = |x: f64, y: f64| {
            let far = |i: &usize| (surface.points[*i].x - x).hypot(surface.points[*i].y - y);
            (0..surface.points.len()).min_by(|a, b| far(a).total_cmp(&far(b))).unwrap()
        };
        let (weak, strong, light) = (nearest(-0.1, 0.06), nearest(0.12, -0.04), nearest(0.0, 0.16));
        (map[weak], map[strong], map[light]) = (8.0, 20.0, 3.0);
        let contacts = reader.contacts(&map);
        assert_eq!(contacts.len(), 2);
        let off = |i: usize, point: usize| (contacts[i].position - surface.points[point]).norm();
        assert!(off(0, strong) < 1e-12 && off(1, weak) < 1e-12, "{contacts:?}");
        assert_eq!([contacts[0].normal_force(), contacts[1].normal_force()], [20.0, 8.0]);
        assert!((contacts[0].position_covariance[(0, 0)] - 1e-4).abs() < 1e-16);
        assert!(contacts[0].force_covariance[(2, 2)].is_nan());
        assert!(reader.contacts(&map[1..]).is_empty(), "a map of another surface");
        let one = ForceMapContacts::new(ForcePeakSection { most: 1, ..section() }, &surface);
        assert_eq!(one.contacts(&map).len(), 1);
    }

    #[test]
    fn what_cannot_be_is_refused_by_name() {
        let refused = |change: fn(&mut ForcePeakSection)| {
            let mut section = section();
            change(&mut section);
            section.check().unwrap_err().0
        };
        assert!(section().check().is_ok());
        assert_eq!(refused(|s| s.disc = 0.0), "disc");
        assert_eq!(refused(|s| s.most = 11), "most");
        assert_eq!(refused(|s| s.threshold = -1.0), "threshold");
        assert_eq!(refused(|s| s.position_sigma = Some(f64::NAN)), "position_sigma");
        assert_eq!(refused(|s| s.force_sigma = Some(-1.0)), "force_sigma");
    }
}
