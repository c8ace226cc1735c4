//! Unknowns of a contact, which an inverse estimates.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use dermis_skin::ForceComponents;

/// What is not known of a contact, and is estimated or bounded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Unknowns {
    /// Where it is along the first direction of the surface (x on a flat one), and how hard it presses: taxels in a row.
    Line,
    /// Where it is on the surface, and how hard it presses; it is taken to press along the normal.
    #[default]
    Normal,
    /// Where it is on the surface, and all three components of its force.
    Full,
}

/// One number that is not known of a contact.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unknown {
    /// A coordinate along one of both [`tangents`].
    Along(usize),
    /// The pressing force.
    Pressing,
    /// The force along one of both [`tangents`].
    Shear(usize),
}

impl Unknowns {
    /// The numbers, in the order of every vector and matrix over them.
    #[must_use]
    pub fn list(self) -> &'static [Unknown] {
        use Unknown::{Along, Pressing, Shear};
        match self {
            Self::Line => &[Along(0), Pressing],
            Self::Normal => &[Along(0), Along(1), Pressing],
            Self::Full => &[Along(0), Along(1), Pressing, Shear(0), Shear(1)],
        }
    }

    /// How many numbers they are.
    #[must_use]
    pub fn count(self) -> usize {
        self.list().len()
    }

    /// Components of the force that an answer to them has.
    #[must_use]
    pub fn force_components(self) -> ForceComponents {
        match self {
            Self::Line | Self::Normal => ForceComponents::Normal,
            Self::Full => ForceComponents::Full,
        }
    }
}

/// Unit vectors along the surface that form a right-handed frame with its `normal`; x and y where that is z.
#[must_use]
pub fn tangents(normal: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let start = if normal.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() };
    let first = (start - normal * normal.dot(&start)).normalize();
    [first, normal.cross(&first)]
}
