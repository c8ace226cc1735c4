//! One node API over two ROS 2 backends.
//!
//! A [`Node`] publishes, subscribes, serves, has parameters, a clock, a managed life and diagnostics. What
//! carries it is a [`Backend`]: [`HirozBackend`] speaks the wire of `rmw_zenoh` and needs neither a ROS
//! installation nor a router; the r2r backend (crate `dermis-node-r2r`) uses the ROS 2 that is sourced.
//! Both pass the same behaviour suite (module `suite`, feature `test-suite`).
//!
//! ```no_run
//! use dermis_msgs::msg::ContactArray;
//! use dermis_node::{HirozBackend, Node, NodeError, NodeOptions, Qos};
//!
//! # async fn run() -> Result<(), NodeError> {
//! let node = Node::open(NodeOptions::new("listener"), &HirozBackend::default())?;
//! let _contacts = node.subscribe("contacts", Qos::sensor_data(), |array: ContactArray, _| {
//!     println!("{} contacts", array.contacts.len());
//! })?;
//! node.wait_for_shutdown().await
//! # }
//! ```

pub mod backend;
mod clock;
mod diagnostics;
mod error;
mod executor;
#[cfg(feature = "hiroz")]
mod hiroz_backend;
mod lifecycle;
#[cfg(feature = "test-suite")]
pub mod memory;
mod names;
pub mod network;
mod node;
mod options;
mod parameters;
mod pubsub;
mod qos;
mod service;
#[cfg(feature = "test-suite")]
pub mod suite;
mod watch;

pub use backend::{Backend, BackendError, Publication};
pub use clock::{Clock, ClockJump, system_now};
pub use dermis_msgs::sequence::Losses;
pub use diagnostics::{Diagnostics, Level, Status};
pub use error::NodeError;
#[cfg(feature = "hiroz")]
pub use hiroz_backend::{HirozBackend, HirozConfig};
pub use lifecycle::{Lifecycle, State, Transition};
pub use names::parse_remapping;
pub use network::{Network, NetworkChoice, Reach};
pub use node::{LogLevel, Node, Timer, end_all_nodes, end_all_nodes_on_signal, end_of_all_nodes, signalled};
pub use options::NodeOptions;
pub use parameters::{ParameterDescriptor, ParameterRange, ParameterValue, Parameters};
pub use pubsub::{MessageInfo, PublicationCounter, Publisher, RawPublisher, Subscription, Unread};
pub use qos::{Durability, History, Qos, Reliability};
pub use service::{Client, ServiceServer};
pub use watch::{Problem, ProblemKind};
