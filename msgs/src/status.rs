//! What the status of a skin means.

use crate::msg::ContactArray;

impl ContactArray {
    /// Whether a skin with this status, or all skins of which it is the worst, can say what touches.
    #[must_use]
    pub fn feels(status: u8) -> bool {
        matches!(status, Self::STATUS_OK | Self::STATUS_DEGRADED)
    }
}
