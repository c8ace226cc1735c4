//! What a shell is made of, and by which theory it bends.
//!
//! Kirchhoff and Love let the lines across the thickness stay normal to the middle surface; Reissner and Mindlin let them lean,
//! so that the shell shears across its thickness. A beam of length L whose ends do not turn gives way more by a share of
//! 2.4 (1 + ν) (h/L)² where one end moves against the other, which is 9 % for 12.5 mm of 2 mm; and a narrow beam of width b twists
//! more easily than Kirchhoff's, by 1 / (1 − 0.63 h/b) (Saint-Venant).

use nalgebra::Vector3;

use crate::MechanicsError;
use crate::error::positive;

/// Material and thickness of a piece of the shell.
#[derive(Debug, Clone, PartialEq)]
pub struct Section {
    /// \[Pa\]; along the direction of the orthotropy where there is one.
    pub young_modulus: f64,
    /// Strain across over strain along, at least 0 and below 0.5.
    pub poisson_ratio: f64,
    /// \[m\].
    pub thickness: f64,
    /// A material that is stiffer along one direction, as printed ones are.
    pub orthotropy: Option<Orthotropy>,
    /// Whether it shears across its thickness.
    pub theory: PlateTheory,
}

/// What becomes of the lines across the thickness that are normal to the middle surface.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum PlateTheory {
    /// They stay normal: for shells whose beams are thirty thicknesses long or more.
    #[default]
    KirchhoffLove,
    /// They may lean: the shell shears across its thickness, and narrow beams twist more easily. The transverse shear modulus is
    /// that in the plane.
    ReissnerMindlin,
}

/// How a material differs along and across.
///
/// The shear modulus is √(E₁E₂) / (2 (1 + √(ν₁₂ν₂₁))) (M. T. Huber's estimate for orthotropic plates), which is the
/// isotropic one for a ratio of 1.
#[derive(Debug, Clone, PartialEq)]
pub struct Orthotropy {
    /// Young's modulus across over the one along: E₂/E₁.
    pub ratio: f64,
    /// Direction of E₁ in the frame of the mesh, of any length; each triangle takes its part in the triangle's plane.
    pub direction: Vector3<f64>,
}

impl Section {
    /// A section of the same stiffness in all directions: Young's modulus \[Pa\], Poisson's ratio, thickness \[m\].
    #[must_use]
    pub const fn isotropic(young_modulus: f64, poisson_ratio: f64, thickness: f64) -> Self {
        let theory = PlateTheory::KirchhoffLove;
        Self { young_modulus, poisson_ratio, thickness, orthotropy: None, theory }
    }

    /// The same section by another theory.
    #[must_use]
    pub fn by(self, theory: PlateTheory) -> Self {
        Self { theory, ..self }
    }

    /// \[Pa\] in the plane.
    pub(super) fn shear_modulus(&self) -> f64 {
        let ratio = self.orthotropy.as_ref().map_or(1.0, |print| print.ratio);
        self.young_modulus * ratio.sqrt() / (2.0 * (1.0 + self.poisson_ratio * ratio.sqrt()))
    }

    pub(super) fn check(&self) -> Result<(), MechanicsError> {
        positive("Young's modulus [Pa]", self.young_modulus)?;
        positive("thickness of the shell [m]", self.thickness)?;
        let value = self.poisson_ratio;
        if !(0.0..0.5).contains(&value) {
            return Err(MechanicsError::Value {
                quantity: "Poisson's ratio of the shell",
                value,
                expected: "at least 0 and below 0.5",
            });
        }
        if let Some(print) = &self.orthotropy {
            positive("ratio of Young's moduli across and along", print.ratio)?;
            positive("length of the direction of the material", print.direction.norm())?;
            // Where this is not so, energy would be negative.
            let mixed = value * value * print.ratio;
            if mixed >= 1.0 {
                return Err(MechanicsError::Value {
                    quantity: "product of Poisson's ratios of the shell",
                    value: mixed,
                    expected: "below 1",
                });
            }
        }
        Ok(())
    }
}
