//! What can be wrong with a medium or a question to it.

use dermis_skin::{ModelError, SkinError};

use crate::calculix::CalculixError;

/// A medium, load or question that cannot be.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum MechanicsError {
    /// A number is outside of what it can be.
    #[error("{quantity} is {value} and must be {expected}")]
    Value {
        /// Which number, with its unit.
        quantity: &'static str,
        /// What was given.
        value: f64,
        /// What would be right.
        expected: &'static str,
    },
    /// A depth that lies outside of the medium.
    #[error("depth is {depth} m and must lie between the surface and the base of the layer at {thickness} m")]
    Depth {
        /// What was given \[m\].
        depth: f64,
        /// \[m\]; infinite for a half-space.
        thickness: f64,
    },
    /// A cell of a mesh has no volume, or its corners are in the wrong order.
    #[error("cell {cell} of the mesh is turned inside out")]
    Mesh {
        /// Which cell.
        cell: usize,
    },
    /// A body that nothing holds.
    #[error(
        "the body can move without being deformed, or its numbers are too far apart to be solved: hold it somewhere"
    )]
    Singular,
    /// A triangle that cannot be one of a shell.
    #[error("triangle {triangle} of the shell {what}")]
    Triangle {
        /// Which one, counted from 0.
        triangle: usize,
        /// What is wrong with it.
        what: &'static str,
    },
    /// A node that cannot be one of a shell.
    #[error("node {node} of the shell {what}")]
    Node {
        /// Which one, counted from 0.
        node: usize,
        /// What is wrong with it.
        what: &'static str,
    },
    /// A part of a shell that could move as a rigid body.
    #[error(
        "nothing keeps the part of the shell around node {node} from moving or turning: hold more of its nodes"
    )]
    Loose {
        /// A node of that part.
        node: usize,
    },
    /// So many of something are none that could be.
    #[error("there are {got} {what}, and {expected} are needed")]
    Count {
        /// Of what.
        what: &'static str,
        /// How many there are.
        got: usize,
        /// How many there should be.
        expected: usize,
    },
    /// A gauge over nothing.
    #[error("the gauge at ({x}, {y}, {z}) m lies on no material: move it onto the shell")]
    NoMaterial {
        /// \[m\] of its centre.
        x: f64,
        /// \[m\].
        y: f64,
        /// \[m\].
        z: f64,
    },
    /// A rigid tip that rests on nothing.
    #[error("the tip has no contact: {reason}")]
    Contact {
        /// A sentence without its end.
        reason: String,
    },
    /// Newton's method that found no equilibrium.
    #[error(
        "no equilibrium at {share} of the load after {iterations} iterations: take more steps, or less load"
    )]
    Equilibrium {
        /// How much of the load, 0 to 1.
        share: f64,
        /// How many were tried.
        iterations: usize,
    },
}

/// `value`, if it is a positive finite number.
pub(crate) fn positive(quantity: &'static str, value: f64) -> Result<f64, MechanicsError> {
    if value.is_finite() && value > 0.0 {
        Ok(value)
    } else {
        Err(MechanicsError::Value { quantity, value, expected: "a positive number" })
    }
}

/// Why a family's validation cases cannot be computed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum VerifyError {
    /// One cannot be computed at all.
    #[error(transparent)]
    Mechanics(#[from] MechanicsError),
    /// CalculiX has no answer.
    #[error(transparent)]
    Calculix(#[from] CalculixError),
    /// The skin of a case cannot be.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// Its file cannot be read.
    #[error(transparent)]
    Skin(#[from] SkinError),
}
