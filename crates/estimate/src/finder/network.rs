//! One contact from a model that gives its position and force.

use dermis_inference::{Bundle, Outputs, Runtime};
use dermis_skin::{Contact, ForceComponents, ImageGrid, SkinDescription, Surface, SurfaceSpec};
use nalgebra::{Matrix3, Point3, Vector3};

use super::{ConditionedFrame, ContactFinder, FindError, GivenMaps};
use crate::models::{Pipeline, SetupError, UnpackedModel};

/// A contact as model outputs give it, and its pressing force \[N\] or, where no normal is known, the size of the force; NaN where
/// no force is given.
#[derive(Debug, Clone)]
pub(crate) struct Regressed {
    /// The contact.
    pub(crate) contact: Contact,
    /// Its force.
    pub(crate) magnitude: f64,
}

/// The contact that model outputs give: `get` answers with the value of an output, `sigma` with its error at a pressing force
/// \[N\] (NaN where unknown). `flat` skins know their own height and normal. Covariances are those of the errors.
pub(crate) fn regressed(
    get: impl Fn(&str) -> Option<f64>,
    sigma: impl Fn(&str, f64) -> f64,
    surface: &Surface,
    flat: bool,
) -> Regressed {
    let (position, normal) = match (get("position.x"), get("position.y"), get("position.z")) {
        (Some(x), Some(y), Some(z)) => surface.project(&Point3::new(x, y, z)),
        (Some(x), Some(y), None) if flat => surface.project(&Point3::new(x, y, 0.0)),
        // On a flat skin the normal is known without the position.
        _ if flat => (Point3::from(Vector3::repeat(f64::NAN)), Vector3::z()),
        _ => (Point3::from(Vector3::repeat(f64::NAN)), Vector3::repeat(f64::NAN)),
    };
    let mut contact = Contact::at(position, normal);
    let pressing = get("force.normal").or_else(|| get("force.z").filter(|_| flat).map(|z| -z));
    let magnitude = if let Some(force) = vector(&get, flat) {
        contact.force = force;
        contact.force_components = ForceComponents::Full;
        let along = contact.normal_force();
        let known = force.iter().filter(|v| v.is_finite()).map(|v| v * v).sum::<f64>().sqrt();
        let along = if along.is_nan() { known } else { along };
        contact.force_covariance = Matrix3::from_diagonal(&Vector3::new(
            sigma("force.x", along).powi(2),
            sigma("force.y", along).powi(2),
            sigma("force.z", along).powi(2),
        ));
        along
    } else if let Some(pressing) = pressing.filter(|_| !normal.x.is_nan()) {
        contact.force = -normal * pressing;
        contact.force_components = ForceComponents::Normal;
        let by_normal = sigma("force.normal", pressing);
        let sigma = if by_normal.is_nan() { sigma("force.z", pressing) } else { by_normal };
        contact.force_covariance = normal * normal.transpose() * sigma.powi(2);
        pressing
    } else {
        f64::NAN
    };
    if !position.x.is_nan() {
        let at = if magnitude.is_nan() { 0.0 } else { magnitude };
        contact.position_covariance = Matrix3::from_diagonal(&Vector3::new(
            sigma("position.x", at).powi(2),
            sigma("position.y", at).powi(2),
            // A flat skin knows its own height.
            if flat { 0.0 } else { sigma("position.z", at).powi(2) },
        ));
    }
    Regressed { contact, magnitude }
}

/// The force that model outputs give by components, NaN for those that they do not. `None` where it is known along the normal only:
/// that is a normal force.
fn vector(get: impl Fn(&str) -> Option<f64>, flat: bool) -> Option<Vector3<f64>> {
    let [x, y, z] = ["force.x", "force.y", "force.z"].map(&get);
    let pressing = get("force.normal");
    // On a flat skin the normal force is the third component.
    let third = z.or_else(|| pressing.filter(|_| flat).map(|pressing| -pressing));
    let some = x.is_some() || y.is_some();
    let all = x.is_some() && y.is_some() && z.is_some();
    let by_components = if flat { some } else { all || ((some || z.is_some()) && pressing.is_none()) };
    let or_unknown = |v: Option<f64>| v.unwrap_or(f64::NAN);
    by_components.then(|| Vector3::new(or_unknown(x), or_unknown(y), or_unknown(third)))
}

/// Whether the skin's outside is a plane.
pub(crate) fn is_flat(skin: &SkinDescription) -> bool {
    matches!(skin.surface, SurfaceSpec::Rectangle { .. })
}

/// One contact from a bundle that gives its position and force.
pub struct NetworkFinder {
    pipeline: Pipeline,
    surface: Surface,
    flat: bool,
}

impl NetworkFinder {
    /// A finder on a skin.
    ///
    /// # Errors
    ///
    /// [`SetupError`] where the bundle does not fit the surface, or cannot be loaded into the runtime.
    pub fn new(bundle: &Bundle, skin: &SkinDescription, runtime: &Runtime) -> Result<Self, SetupError> {
        let surface = skin.surface();
        Ok(Self::with(Pipeline::of(bundle, &surface, runtime)?, skin, surface))
    }

    /// A finder on a skin by a model that is no bundle yet.
    ///
    /// # Errors
    ///
    /// [`SetupError::Output`] where a map of the model does not fit the surface.
    pub fn unpacked(model: UnpackedModel, skin: &SkinDescription) -> Result<Self, SetupError> {
        let surface = skin.surface();
        Ok(Self::with(Pipeline::unpacked(model, &surface)?, skin, surface))
    }

    pub(super) fn with(pipeline: Pipeline, skin: &SkinDescription, surface: Surface) -> Self {
        Self { pipeline, surface, flat: is_flat(skin) }
    }

    /// The contact of a frame whatever the model gives: its place is NaN where the model gives none.
    ///
    /// # Errors
    ///
    /// As [`find`](ContactFinder::find).
    pub fn contact(&mut self, frame: &ConditionedFrame<'_>) -> Result<Contact, FindError> {
        self.pipeline.answer(frame)?;
        let outputs = &self.pipeline.outputs;
        let sigma = |name: &str, force: f64| outputs.sigma(name, force).unwrap_or(f64::NAN);
        Ok(regressed(|name| outputs.get(name), sigma, &self.surface, self.flat).contact)
    }

    /// What the model gave for the latest frame whose contact was requested.
    #[must_use]
    pub fn outputs(&self) -> &Outputs {
        &self.pipeline.outputs
    }
}

impl ContactFinder for NetworkFinder {
    /// Nothing where the model gives no position.
    fn find(&mut self, frame: &ConditionedFrame<'_>) -> Result<Vec<Contact>, FindError> {
        let contact = self.contact(frame)?;
        Ok(if contact.position.x.is_nan() { Vec::new() } else { vec![contact] })
    }

    fn given_maps(&self) -> GivenMaps {
        GivenMaps::of(&self.pipeline.outputs)
    }

    fn pass(&mut self, frame: &ConditionedFrame<'_>) -> Result<(), FindError> {
        self.pipeline.take(frame)
    }

    fn reset(&mut self) {
        self.pipeline.features.reset();
    }

    fn image(&self) -> Option<ImageGrid> {
        self.pipeline.features.config().image
    }

    fn single(&self) -> bool {
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn force_of(given: &[(&str, f64)], flat: bool) -> Contact {
        let surface = Surface::from_spec(&SurfaceSpec::Rectangle { size: [0.02, 0.02], spacing: 0.005 });
        let get = |name: &str| given.iter().find(|(n, _)| *n == name).map(|(_, v)| *v);
        let sigma = |name: &str, _: f64| if get(name).is_some() { 0.5 } else { f64::NAN };
        regressed(get, sigma, &surface, flat).contact
    }

    #[test]
    fn a_force_of_which_one_component_is_known_is_partly_nan() {
        let shear = force_of(&[("force.x", -3.0)], true);
        assert_eq!((shear.force_components, shear.force.x), (ForceComponents::Full, -3.0));
        assert!(shear.force.y.is_nan() && shear.force.z.is_nan() && shear.normal_force().is_nan());
        assert_eq!(shear.force_covariance[(0, 0)], 0.25);
        assert!(shear.force_covariance[(1, 1)].is_nan());
        // The normal force is the third component of a flat skin.
        let two = force_of(&[("force.x", -3.0), ("force.normal", 2.0)], true);
        assert_eq!((two.force.x, two.force.z, two.normal_force()), (-3.0, -2.0, 2.0));
        let normal = force_of(&[("force.z", -2.0)], true);
        assert_eq!((normal.force_components, normal.normal_force()), (ForceComponents::Normal, 2.0));
        let full = force_of(&[("force.x", 1.0), ("force.y", 0.0), ("force.z", -2.0)], false);
        assert_eq!((full.force_components, full.force.z), (ForceComponents::Full, -2.0));
        assert_eq!(force_of(&[("contact", 0.9)], true).force_components, ForceComponents::None);
    }
}
