//! What happens to a skin on a testbed.

use dermis_msgs::msg::Indentation;

/// What the testbed is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash, PartialOrd, Ord)]
pub enum Phase {
    /// Nothing is near.
    #[default]
    Idle,
    /// The indenter comes near; it does not touch yet.
    Approach,
    /// The force grows, across or along the surface.
    Load,
    /// The force is constant.
    Hold,
    /// The force is constant and the indenter moves along the surface.
    Slide,
    /// The force falls.
    Unload,
}

impl Phase {
    /// As `Indentation.phase` says it.
    #[must_use]
    pub fn code(self) -> u8 {
        match self {
            Self::Idle => Indentation::PHASE_IDLE,
            Self::Approach => Indentation::PHASE_APPROACH,
            Self::Load => Indentation::PHASE_LOAD,
            Self::Hold => Indentation::PHASE_HOLD,
            Self::Slide => Indentation::PHASE_SLIDE,
            Self::Unload => Indentation::PHASE_UNLOAD,
        }
    }

    /// Whether something touches in this phase.
    #[must_use]
    pub fn touched(self) -> bool {
        matches!(self, Self::Load | Self::Hold | Self::Slide | Self::Unload)
    }
}
