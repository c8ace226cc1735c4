//! Launch files: what to start, and keeping it running.
//!
//! [`load`] reads a launch file (YAML or TOML), its includes and its arguments into a [`Plan`], or says with
//! file and field all that is wrong, a sentence each. [`run`] starts the processes of a plan in order, gathers what they print, starts
//! again what fails, and stops everything in the reverse order. What a node or a command of the own program is, it asks
//! a [`Host`].
//!
//! ```yaml
//! arguments:
//!   skin: {default: skins/pad.toml, path: true, about: skin description}
//! namespace: left
//! processes:
//!   - name: device
//!     dermis: device simulate ${skin} --link ${tmp}/device
//!     ready: {file: "${tmp}/device"}
//!   - name: pad
//!     node: barometers
//!     config: {skin: "${skin}", source: "serial://${tmp}/device"}
//!     parameters: {force_threshold: 0.05}
//!     after: [device]
//!     restart: on-failure
//! ```

mod backoff;
mod error;
mod faults;
mod file;
mod guard;
mod lines;
mod log;
mod plan;
mod rate;
mod rotate;
mod substitute;
mod supervise;

pub use backoff::Backoff;
pub use error::{LaunchError, LaunchErrors};
pub use guard::guard;
pub use log::{Format, LogLimits, LogOptions};
pub use plan::{
    Declared, Host, NODE_SEPARATOR, NodeRequest, Plan, Process, Ready, Refusal, Restart, SharedNode, Stop,
    load,
};
pub use supervise::{Ended, run};
