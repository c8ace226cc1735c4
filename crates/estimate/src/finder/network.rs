//! One contact from a model that gives its position and force.

use dermis_inference::{Baseline, Bundle, Features, Model, Outputs, Runtime};
use dermis_skin::{Contact, ForceComponents, SkinDescription, Surface, SurfaceSpec};
use nalgebra::{Matrix3, Point3, Vector3};

use super::{ConditionedFrame, ContactFinder, FindError};

/// A contact as model outputs give it, and its pressing force \[N\] or, where no normal is known, the size of the force; NaN where
/// no force is given.
#[derive(Debug, Clone)]
pub struct Regressed {
    /// The contact.
    pub contact: Contact,
    /// Its force.
    pub magnitude: f64,
}

/// The contact that model outputs give: `get` answers with the value of an output, `sigma` with its error at a pressing force
/// \[N\] (NaN where unknown). `flat` skins know their own height and normal. Covariances are those of the errors.
pub fn regressed(
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
    let full = match (get("force.x"), get("force.y"), get("force.z")) {
        (Some(x), Some(y), Some(z)) => Some(Vector3::new(x, y, z)),
        _ => None,
    };
    let pressing = get("force.normal").or_else(|| get("force.z").filter(|_| flat).map(|z| -z));
    let magnitude = if let Some(force) = full {
        contact.force = force;
        contact.force_components = ForceComponents::Full;
        let along = -force.dot(&normal);
        let along = if along.is_nan() { force.norm() } else { along };
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

/// Whether the skin's outside is a plane.
pub(crate) fn is_flat(skin: &SkinDescription) -> bool {
    matches!(skin.surface, SurfaceSpec::Rectangle { .. })
}

/// One contact from a bundle that gives its position and force.
pub struct NetworkFinder {
    features: Features,
    baseline: Baseline,
    model: Model,
    outputs: Outputs,
    surface: Surface,
    flat: bool,
    raw: Vec<f32>,
}

impl NetworkFinder {
    /// A finder on a skin.
    ///
    /// # Errors
    ///
    /// [`FindError::Bundle`] where the bundle cannot be loaded into the runtime.
    pub fn new(bundle: &Bundle, skin: &SkinDescription, runtime: &Runtime) -> Result<Self, FindError> {
        Ok(Self {
            features: bundle.features(),
            baseline: bundle.manifest().baseline,
            model: bundle.session(runtime)?,
            outputs: bundle.outputs(),
            surface: skin.surface(),
            flat: is_flat(skin),
            raw: Vec::new(),
        })
    }

    /// The contact that the model gives for an input of its features; `None` where it gives no position.
    ///
    /// # Errors
    ///
    /// [`FindError`] where the model fails.
    pub fn infer(&mut self, input: &[f32]) -> Result<Option<Contact>, FindError> {
        self.model.run(input, &mut self.raw)?;
        self.outputs.decode(&self.raw)?;
        let outputs = &self.outputs;
        let sigma = |name: &str, force: f64| outputs.sigma(name, force).unwrap_or(f64::NAN);
        let contact = regressed(|name| outputs.get(name), sigma, &self.surface, self.flat).contact;
        Ok((!contact.position.x.is_nan()).then_some(contact))
    }
}

impl ContactFinder for NetworkFinder {
    fn find(&mut self, frame: &ConditionedFrame<'_>) -> Result<Vec<Contact>, FindError> {
        self.features.reset();
        let values = match self.baseline {
            Baseline::Raw => frame.reading,
            Baseline::Tared => frame.signal,
        };
        self.features.push(frame.stamp, values)?;
        let input = self.features.input().ok_or(FindError::History)?.to_vec();
        Ok(self.infer(&input)?.into_iter().collect())
    }

    fn single(&self) -> bool {
        true
    }
}
