//! Why there is no bound for a skin, a path or a table of forces: what is wrong with the model, its noise or
//! the numbers.

use dermis_skin::ModelError;

/// Why there is no bound.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TheoryError {
    /// The forward model has no answer.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// A channel without noise would know everything.
    #[error(
        "channel {channel}: its noise is {noise} and must be a positive number; set `noise` in the skin description"
    )]
    Noise {
        /// Which channel.
        channel: usize,
        /// Its standard deviation, in the unit of the skin.
        noise: f64,
    },
    /// A quantity that must be positive.
    #[error("{quantity} is {value} and must be positive")]
    NotPositive {
        /// What, with its unit.
        quantity: &'static str,
        /// Its value.
        value: f64,
    },
    /// A direction that leads out of the surface.
    #[error("the direction of a path leads out of the surface there")]
    Direction,
    /// Forces of a table.
    #[error("forces of a table must ascend from 0")]
    Forces,
    /// Presses of another skin.
    #[error("a press has {found} readings where the skin has {expected} channels")]
    Channels {
        /// Readings of the press.
        found: usize,
        /// Channels of the skin.
        expected: usize,
    },
    /// A line without isolines that could cross.
    #[error("{taxels} taxels lie on the line where at least two must: their isolines have to cross")]
    Line {
        /// Taxels on it.
        taxels: usize,
    },
    /// A decomposition that does not exist.
    #[error(
        "{what} cannot be decomposed: they hold numbers that are not finite or do not determine anything"
    )]
    Decomposition {
        /// Of what.
        what: &'static str,
    },
    /// A regression that cannot be fitted.
    #[error(transparent)]
    Regress(#[from] dermis_regress::RegressError),
}
