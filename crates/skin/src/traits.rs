//! The two traits that every sensor implements: stimulus → channels, and frame → contacts.

use nalgebra::{Point3, Vector3};

use crate::{Estimate, Frame, Memoryless, Surface, Trajectory};

/// One indenter on the skin.
#[derive(Debug, Clone, PartialEq)]
pub struct Indentation {
    /// \[m\] centre of the contact on the undeformed surface.
    pub position: Point3<f64>,
    /// \[N\] exerted on the skin, in the link frame; the normal part points into the surface.
    pub force: Vector3<f64>,
    /// \[m\] diameter of the indenter's spherical tip.
    pub diameter: f64,
}

impl Indentation {
    /// \[m\] off the surface that a contact may lie: rounding of single precision, with room to spare.
    pub const OFF_SURFACE: f64 = 1e-4;
    /// \[m\] diameters of a tip that forward models speak of.
    pub const DIAMETERS: std::ops::RangeInclusive<f64> = 1e-4..=0.1;

    /// The outward normal under a contact that forward models can speak of; `index` is its place in the stimulus.
    ///
    /// # Errors
    ///
    /// [`ModelError::Stimulus`] where it is not a number, lies off `surface`, pulls, or has an impossible tip.
    pub fn check(&self, index: usize, surface: &Surface) -> Result<Vector3<f64>, ModelError> {
        let wrong = |reason: String| Err(ModelError::Stimulus { index, reason });
        let p = self.position;
        if !p.iter().chain(self.force.iter()).all(|v| v.is_finite()) {
            return wrong("its position or force is not a number".into());
        }
        let (nearest, normal) = surface.project(&p);
        let off = (p - nearest).norm();
        if off > Self::OFF_SURFACE {
            return wrong(format!("({}, {}, {}) m lies {off:.6} m off the surface", p.x, p.y, p.z));
        }
        let pressing = -self.force.dot(&normal);
        if pressing < 0.0 {
            return wrong(format!("it pulls with {} N, and this model knows no adhesion", -pressing));
        }
        if !Self::DIAMETERS.contains(&self.diameter) {
            let (low, high) = (Self::DIAMETERS.start().to_owned(), Self::DIAMETERS.end().to_owned());
            return wrong(format!("its diameter is {} m and must be {low} to {high} m", self.diameter));
        }
        Ok(normal)
    }
}

/// What touches the skin at one instant, and what it is surrounded by.
#[derive(Debug, Clone, PartialEq)]
pub struct Stimulus {
    /// All indenters; empty means "not touched".
    pub contacts: Vec<Indentation>,
    /// \[K\] of the skin.
    pub temperature: f64,
    /// \[Pa\] of the air around it.
    pub ambient_pressure: f64,
}

impl Default for Stimulus {
    /// Untouched at 20 °C and one standard atmosphere.
    fn default() -> Self {
        Self { contacts: Vec::new(), temperature: 293.15, ambient_pressure: 101_325.0 }
    }
}

/// Why a forward model has no answer.
#[derive(Debug, Clone, thiserror::Error)]
#[non_exhaustive]
pub enum ModelError {
    /// The stimulus cannot be: off the surface, or not a number.
    #[error("contact {index}: {reason}")]
    Stimulus {
        /// Which contact.
        index: usize,
        /// What is wrong with it.
        reason: String,
    },
    /// The skin description lacks something that the model needs, or asks for something it cannot do.
    #[error("skin `{skin}`: field `{field}`: {reason}")]
    Description {
        /// Name of the skin.
        skin: String,
        /// Path of the field.
        field: String,
        /// What is wrong with it.
        reason: String,
    },
}

impl ModelError {
    /// Whether it is about the table `medium` of a skin description.
    #[must_use]
    pub fn is_of_medium(&self) -> bool {
        matches!(self, Self::Description { field, .. } if field == "medium" || field.starts_with("medium."))
    }
}

/// What would the channels read for this stimulus? The one model behind data, bounds, training and diagnosis.
pub trait ForwardModel: Send + Sync {
    /// Number of channels.
    fn channels(&self) -> usize;

    /// Surface that stimuli lie on.
    fn surface(&self) -> &Surface;

    /// Noise-free readings, one a channel, in the unit of the skin description, written to `out`
    /// (`out.len()` must be [`channels`](Self::channels)).
    ///
    /// # Errors
    ///
    /// [`ModelError::Stimulus`] where a contact lies off the surface or is not a number.
    fn response(&self, stimulus: &Stimulus, out: &mut [f64]) -> Result<(), ModelError>;

    /// Standard deviation of each channel's noise, in the unit of the skin description.
    fn noise(&self) -> &[f64];

    /// How far every point of [`surface`](Self::surface) gives way \[m\], inwards along its normal, written to `out`
    /// (one a point). `false`, and `out` as it was, where the model knows no displacements.
    ///
    /// # Errors
    ///
    /// As [`response`](Self::response).
    fn displacement(&self, stimulus: &Stimulus, out: &mut [f64]) -> Result<bool, ModelError> {
        let _ = (stimulus, out);
        Ok(false)
    }

    /// What the effects of the skin remember from frame to frame, at its beginning: a device that has never been touched.
    /// [`response`](Self::response) holds the effects that remember nothing; this holds the others.
    fn trajectory(&self) -> Box<dyn Trajectory> {
        Box::new(Memoryless)
    }

    /// \[N\] that press a spherical tip of `diameter` \[m\] in by `depth` \[m\] at the point `at` of the surface; `None` where
    /// the model does not know, or where no force does.
    fn force_at(&self, at: &Point3<f64>, diameter: f64, depth: f64) -> Option<f64> {
        let _ = (at, diameter, depth);
        None
    }

    /// \[m\] that a spherical tip of `diameter` \[m\] sinks in at the point `at` of the surface when it presses with `force`
    /// \[N\]: the inverse of [`force_at`](Self::force_at).
    fn depth_at(&self, at: &Point3<f64>, diameter: f64, force: f64) -> Option<f64> {
        let _ = (at, diameter, force);
        None
    }
}

/// Why an estimator has no answer.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EstimateError {
    /// The frame does not belong to this skin.
    #[error("frame {sequence} has {found} channels where the skin has {expected}")]
    Channels {
        /// Sequence number of the frame.
        sequence: u64,
        /// Channels in the frame.
        found: usize,
        /// Channels of the skin.
        expected: usize,
    },
    /// The model failed.
    #[error("frame {sequence}: {reason}")]
    Model {
        /// Sequence number of the frame.
        sequence: u64,
        /// What the model said.
        reason: String,
    },
}

/// Frame → contacts. Estimators keep state (tare, filters, tracks), so frames come in order.
pub trait Estimator: Send {
    /// What this frame says.
    ///
    /// # Errors
    ///
    /// [`EstimateError::Channels`] for a frame of another skin, [`EstimateError::Model`] where inference fails.
    fn estimate(&mut self, frame: &Frame) -> Result<Estimate, EstimateError>;

    /// Forget everything that earlier frames left behind, e.g. before another recording.
    fn reset(&mut self);

    /// Take a new zero from the frames that follow: the caller knows that nothing touches the skin, whatever the
    /// readings look like. History that was seen with the zero before is forgotten.
    fn tare(&mut self) {
        self.reset();
    }
}
