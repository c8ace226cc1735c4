//! One sense of touch for a whole robot: the contacts of all its skins, merged into contacts of its body.
//!
//! | module | question |
//! |---|---|
//! | [`Fuser`] | what does the whole body feel now? |
//! | `intake` | can what comes from one skin be used, and if not, why? |
//! | `group` | which contacts of skins that are rigidly connected are the same, and the same as before? |
//! | `track` | where is one contact, how does it move, how hard does it press? |
//! | `filter` | how certain is that, where errors of a skin stay? |
//! | `cause` | is a contact expected, or the robot's own? |
//! | [`Settings`] | what is assumed of skins and contacts? |

mod cause;
mod filter;
mod fuser;
mod group;
mod intake;
mod settings;
#[cfg(test)]
mod testing;
mod track;

pub use cause::{Cause, CauseError, Expected, SelfContact};
pub use fuser::{BodyState, BodyTouch, Fuser, FuserError, LinkLoad, SkinAt};
pub use intake::Health;
pub use settings::{SettingError, Settings};
