//! Virtual testbed: stimulus plans and other people's recordings become labelled bags; a model stands behind a real transport.
//!
//! - [`Plan`] says what is done to a skin; [`Timeline`] is a plan carried out on a surface: what touches it at
//!   every instant.
//! - [`collect`] carries a plan out on a modelled skin and writes a labelled bag.
//! - [`VirtualDevice`] is a modelled skin, [`ReplayDevice`] a recording, that sends bytes like hardware.
//!
//! Nothing here knows a sensor by name: any [`ForwardModel`](dermis_model::ForwardModel) with its
//! [`SkinDescription`](dermis_skin::SkinDescription) will do.

mod collect;
mod device;
mod error;
pub mod import;
mod plan;
mod sampler;
#[cfg(test)]
mod testing;
mod timeline;

pub use collect::{CollectOptions, CollectReport, collect};
pub use dermis_skin::Phase;
pub use device::{DeviceStats, Outlet, PluggedDevice, ReplayDevice, ReplayOptions, VirtualDevice};
pub use error::TestbedError;
pub use plan::{
    Action, Drawn, ForceDistribution, HEX_ARMS, Level, Levels, Plan, PlanTip, PostureSet, PressProfile, Step,
    Strokes, Timing,
};
pub use sampler::Sampler;
pub use timeline::{GroundTruth, Timeline, Tip};
