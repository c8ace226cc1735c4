//! The vocabulary that every other crate of dermis speaks.
//!
//! | word | type | what it is |
//! |---|---|---|
//! | skin description | [`SkinDescription`] | the file that says what a type of skin is: surface, taxels, channels, medium |
//! | instance | [`SkinDescription::into_instance`], [`Mount`] | a device of that type on a robot: its name, coordinate frame and place |
//! | surface | [`Surface`] | triangulated outside of the skin, in the frame of its link |
//! | frame | [`Frame`] | one reading of every channel at one instant |
//! | contact, maps | [`Contact`], [`ForceMap`], [`DisplacementMap`] | what an estimator answers |
//! | estimator | [`Estimator`] | frame → contacts |
//! | zero | [`ZeroTracker`] | tare, and drift while untouched |
//!
//! All quantities are in SI units and in the frame of the skin's link (z points out of the surface at a
//! taxel, REP-103). A force is what the environment exerts *on the skin*: pushing in means `force · normal < 0`.
//!
//! ```
//! use dermis_skin::SkinDescription;
//!
//! let skin = SkinDescription::from_toml(
//!     r#"
//!     schema = "dermis-skin/1"
//!     name = "pad"
//!     sensor = "taxels"
//!     frame_id = "pad_link"
//!     unit = "Pa"
//!     rate = 100.0
//!     noise = 20.0
//!     surface = { type = "rectangle", size = [0.02, 0.01], spacing = 0.005 }
//!     taxels = [
//!         { name = "t0", position = [-0.005, 0.0, -0.005] },
//!         { name = "t1", position = [0.005, 0.0, -0.005] },
//!     ]
//!     "#,
//!     "pad.toml",
//! )?;
//! assert_eq!(skin.channels().len(), 2);
//! assert!(skin.hash().starts_with("sha256:"));
//! # Ok::<(), dermis_skin::SkinError>(())
//! ```

mod assignment;
pub mod cache;
mod contact;
pub mod convert;
mod description;
mod effect;
mod error;
mod family;
mod frame;
mod image;
mod instance;
mod limits;
mod mesh;
mod panel;
mod phase;
mod rated;
mod surface;
#[cfg(test)]
mod testing;
mod traits;
mod zero;

pub use assignment::assign;
pub use contact::{Contact, DisplacementMap, Estimate, ForceComponents, ForceMap, ForceValues};
pub use convert::contact_array;
pub use description::{
    Channel, Condition, SensorKind, SkinDescription, SurfaceSpec, Taxel, Wire, WireProtocol, WireSamples,
};
pub use effect::{Effect, EffectInfo, ParameterInfo};
pub use error::SkinError;
pub use family::{Family, FamilyShape, FieldFault, register};
pub use frame::{ChannelFlags, Frame};
pub use image::{Image, ImageGrid, ImageGridError, PixelFormat};
pub use instance::{InstanceError, Mount, MountError, is_frame, is_name};
pub use mesh::{TriangleMesh, closest_on_triangle};
pub use phase::Phase;
pub use rated::{Rated, TipKind};
pub use surface::Surface;
pub use traits::{EstimateError, Estimator, ModelError};
pub use zero::{TareState, ZeroTracker};

/// Nanoseconds since the Unix epoch: the time at which something was measured.
pub type Stamp = i64;
