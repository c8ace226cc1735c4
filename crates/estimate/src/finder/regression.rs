//! One contact from a function of the readings.

use dermis_skin::{Contact, ForceComponents, SkinDescription, Surface};
use nalgebra::Point3;

use super::{ConditionedFrame, ContactFinder, FindError};

/// Whitened readings (in deviations of the noise, 0 where a channel has none) → x, y, z \[m\] and the pressing force \[N\].
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
        let whitened = frame.signal.iter().zip(&self.noise);
        let row: Vec<f64> =
            whitened.map(|(v, n)| if v.is_finite() { f64::from(*v) / n } else { 0.0 }).collect();
        let answer = (self.regress)(&row).map_err(FindError::Regression)?;
        let [x, y, z, force] = answer[..] else {
            return Err(FindError::Regression(format!("gave {} numbers where 4 are expected", answer.len())));
        };
        let (position, normal) = self.surface.project(&Point3::new(x, y, z));
        let mut contact = Contact::at(position, normal);
        contact.force = -normal * force.max(0.0);
        contact.force_components = ForceComponents::Normal;
        Ok(vec![contact])
    }

    fn single(&self) -> bool {
        true
    }
}
