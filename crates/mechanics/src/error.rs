//! What can be wrong with a medium or a question to it.

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
}

/// `value`, if it is a positive finite number.
pub(crate) fn positive(quantity: &'static str, value: f64) -> Result<f64, MechanicsError> {
    if value.is_finite() && value > 0.0 {
        Ok(value)
    } else {
        Err(MechanicsError::Value { quantity, value, expected: "a positive number" })
    }
}
