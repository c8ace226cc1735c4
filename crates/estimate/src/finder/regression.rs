//! One contact from a function of the readings.

use dermis_skin::{Contact, ForceComponents, SkinDescription, Surface};
use nalgebra::{Point3, Vector3};

use super::{ConditionedFrame, ContactFinder, FindError};

/// Whitened readings (in deviations of the noise, 0 where a channel has none) → x, y, z \[m\] and the pressing force \[N\], or
/// x, y and z of the force \[N\] on the skin.
pub type Regress = Box<dyn Fn(&[f64]) -> Result<Vec<f64>, String> + Send>;

/// One contact by regression from readings: support vectors, neighbours, a network.
pub struct RegressionFinder {
    regress: Regress,
    noise: Vec<f64>,
    surface: Surface,
}

impl RegressionFinder {
    /// A finder on a skin.
    #[must_use]
    pub fn new(skin: &SkinDescription, regress: Regress) -> Self {
        Self { regress, noise: skin.channel_noise(), surface: skin.surface() }
    }
}

impl ContactFinder for RegressionFinder {
    fn find(&mut self, frame: &ConditionedFrame<'_>) -> Result<Vec<Contact>, FindError> {
        let (found, expected) = (frame.signal.len(), self.noise.len());
        if found != expected {
            let reason = format!("was given {found} channels where its skin has {expected}");
            return Err(FindError::Regression(reason));
        }
        let whitened = frame.signal.iter().zip(&self.noise);
        let row: Vec<f64> =
            whitened.map(|(v, n)| if v.is_finite() { f64::from(*v) / n } else { 0.0 }).collect();
        let answer = (self.regress)(&row).map_err(FindError::Regression)?;
        let place = |x, y, z| {
            let (position, normal) = self.surface.project(&Point3::new(x, y, z));
            Contact::at(position, normal)
        };
        let contact = match answer[..] {
            [x, y, z, pressing] => {
                let mut contact = place(x, y, z);
                contact.force = -contact.normal * pressing.max(0.0);
                contact.force_components = ForceComponents::Normal;
                contact
            }
            [x, y, z, fx, fy, fz] => {
                let mut contact = place(x, y, z);
                contact.force = Vector3::new(fx, fy, fz);
                contact.force_components = ForceComponents::Full;
                contact
            }
            _ => {
                let got = answer.len();
                return Err(FindError::Regression(format!("gave {got} numbers where 4 or 6 are expected")));
            }
        };
        Ok(vec![contact])
    }

    fn single(&self) -> bool {
        true
    }
}
