//! What keeps a regression from being made.

/// Why there is no regression.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RegressError {
    /// Nothing to learn from.
    #[error("there are no rows to learn from")]
    Empty,
    /// Tables that do not belong together.
    #[error("{what} has {found} numbers where {expected} belong")]
    Size {
        /// Which table or row.
        what: &'static str,
        /// Its numbers.
        found: usize,
        /// What fits the others.
        expected: usize,
    },
    /// A number that is none.
    #[error("{what}, row {row}: holds a number that is not finite")]
    NotFinite {
        /// Which table.
        what: &'static str,
        /// Which row of it.
        row: usize,
    },
    /// A setting out of its range.
    #[error("setting `{name}` is {value} and must be {must}")]
    Setting {
        /// Its name.
        name: &'static str,
        /// What was given.
        value: f64,
        /// What is right.
        must: &'static str,
    },
}
