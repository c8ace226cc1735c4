//! Stimulus → channels.

use dermis_skin::{Image, ModelError, Surface};
use nalgebra::{Point3, Vector3};

use crate::{Memoryless, Trajectory};

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

    /// The picture that the skin's camera takes of `stimulus`, with the noise of its pixels made of `noise`, which gives standard
    /// normal numbers; `None` where the skin has no camera. [`response`](Self::response) is what [`observe`](Self::observe) makes
    /// of such a picture without noise.
    ///
    /// # Errors
    ///
    /// As [`response`](Self::response).
    fn capture(
        &self,
        stimulus: &Stimulus,
        noise: &mut dyn FnMut() -> f64,
    ) -> Result<Option<Image>, ModelError> {
        let _ = (stimulus, noise);
        Ok(None)
    }

    /// The numbers of a frame that are made of a picture, one a channel, written to `out`. `false`, and `out` of no use, where
    /// the picture is not one of this skin.
    fn observe(&self, image: &Image, out: &mut [f64]) -> bool {
        let _ = (image, out);
        false
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
