//! A force map → contacts.

use dermis_inversion::ForcePeakFinder;
use dermis_model::tangents;
use dermis_skin::{Contact, ForceComponents, Surface};
use serde::{Deserialize, Serialize};

/// Output of a bundle that gives the pressing force \[N\] on every point of the surface.
pub const MAP_NORMAL: &str = "map.normal";

/// How contacts are read off the force map that a bundle gives ([`MAP_NORMAL`]). The `[force_peaks]` table of its manifest.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ForcePeakSection {
    /// \[m\] diameter of the disc in which a contact is the largest pressure.
    pub disc: f64,
    /// \[N\] that a disc bears at least where it is a contact.
    pub threshold: f64,
    /// Contacts at most.
    pub most: usize,
    /// \[m\] root mean square error of locations along either tangent, where it was measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub position_sigma: Option<f64>,
    /// \[N\] root mean square error of forces, where it was measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub force_sigma: Option<f64>,
}

impl ForcePeakSection {
    /// Says what is impossible: field and reason.
    ///
    /// # Errors
    ///
    /// The field of this table, and what it must be.
    pub(crate) fn check(&self) -> Result<(), (&'static str, String)> {
        if !(self.disc.is_finite() && self.disc > 0.0) {
            return Err(("disc", format!("is {} m and must be a positive length", self.disc)));
        }
        if !(1..=10).contains(&self.most) {
            return Err(("most", format!("is {} and must be 1 to 10", self.most)));
        }
        let not_negative = [
            ("threshold", Some(self.threshold)),
            ("position_sigma", self.position_sigma),
            ("force_sigma", self.force_sigma),
        ];
        for (field, value) in not_negative {
            if value.is_some_and(|v| !(v.is_finite() && v >= 0.0)) {
                return Err((field, "must be 0 or positive".into()));
            }
        }
        Ok(())
    }
}

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
