//! Faults of a device that no channel shows by itself, but whole frames do.

use dermis_skin::Frame;

/// Part of a device that is out of order.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ElementFault {
    /// What, e.g. `electrode e07`.
    pub element: String,
    /// What is wrong with it and what to do, e.g. `is open: check its wire`.
    pub sentence: String,
    /// Channels that say nothing for as long as it is so, by their place in a frame.
    pub channels: Vec<usize>,
}

impl std::fmt::Display for ElementFault {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} {}", self.element, self.sentence)
    }
}

/// Looks for such faults in the frames of one device, in their order.
///
/// It sees readings as they come, before anything is taken for the zero, and must not take what any touch can read for a fault.
pub trait FrameCheck: Send {
    /// Appends what is wrong at this frame, in the unit of the skin; its values may be NaN.
    fn check(&mut self, frame: &Frame, faults: &mut Vec<ElementFault>);

    /// Forgets the frames before.
    fn reset(&mut self) {}
}
